"""Tips of vessels: the maxima of the way from a source that stick out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from vascval.imaging import _geodesic_kernels as kernels
from vascval.imaging._graph_kernels import skeleton_edges
from vascval.imaging.voxels import Voxels

SALIENCE_RADII = 1.0
SALIENCE_VOXELS = 2.5
NOTICE_VOXELS = 1.5


@dataclass(frozen=True, eq=False)
class Tips:
    """``voxel`` (t,): tips of vessels, the ends of the stem included; ``leaves`` (t,): which of them are vessels that
    leave the volume. ``spur`` (u,): bumps that are no vessel."""

    voxel: np.ndarray
    leaves: np.ndarray
    spur: np.ndarray


def salience_mm(thickness_mm: np.ndarray, spacing_mm: np.ndarray) -> np.ndarray:
    """How far a vessel of a given largest distance value must stick out to be one: as far as it is thick from axis to
    wall (``SALIENCE_RADII``), and ``SALIENCE_VOXELS`` voxels that roughness and the grid may feign."""
    return SALIENCE_RADII * thickness_mm + SALIENCE_VOXELS * np.cbrt(np.prod(spacing_mm))


def find_tips(voxels: Voxels, thickness_mm: np.ndarray) -> Tips:
    """Find the tips of all vessels of a connected mask.

    The way through the mask from one of its ends (the place farthest from the thickest voxel) has a local maximum at
    every other tip, and at every bump of a rough wall. A maximum is followed down to the saddle where a farther one
    takes over; what hangs on it until there sticks out by its persistence, the difference in way. A tip is a maximum
    whose persistence exceeds :func:`salience_mm`. Where a vessel leaves the volume it goes on unseen: of the maxima
    on each patch of voxels on the border the one of largest persistence is a tip if that is ``SALIENCE_VOXELS`` voxels.
    Lesser maxima that stick out by more than ``NOTICE_VOXELS`` are reported as spurs.
    """
    spacing = voxels.spacing_mm
    code = np.arange(27)
    offset = np.stack((code % 3 - 1, code // 3 % 3 - 1, code // 9 - 1), axis=1)
    step = np.sqrt(((offset * spacing) ** 2).sum(axis=1))
    walk = (voxels.x, voxels.row, voxels.first, voxels.shape[1])
    source = int(np.argmax(kernels.geodesic(int(np.argmax(thickness_mm)), *walk, step)))
    way = kernels.geodesic(source, *walk, step)
    order = np.argsort(-way, kind="stable")
    tip, saddle, widest = kernels.maxima(order, way, thickness_mm, *walk)
    persistence = np.where(saddle < 0, np.inf, way[tip] - way[saddle])
    # the source is a tip itself, the lowest point of the way
    tip, persistence, widest = np.append(tip, source), np.append(persistence, np.inf), np.append(widest, 0.0)
    leaves = _exits(voxels, tip, persistence)
    salient = persistence > salience_mm(np.where(leaves, 0.0, widest), spacing)
    noticed = ~salient & (persistence > NOTICE_VOXELS * float(np.cbrt(np.prod(spacing))))
    found, first = np.unique(tip[salient], return_index=True)
    return Tips(found, leaves[salient][first], np.sort(tip[noticed]))


def _exits(voxels: Voxels, tip: np.ndarray, persistence: np.ndarray) -> np.ndarray:
    """(t,) bool: the maximum of largest persistence on each connected patch of voxels at the border of the volume."""
    nz, ny, nx = voxels.shape
    y, z = voxels.row % ny, voxels.row // ny
    border = (voxels.x == 0) | (voxels.x == nx - 1) | (y == 0) | (y == ny - 1) | (z == 0) | (z == nz - 1)
    at = np.flatnonzero(border).astype(np.int32)
    number = np.full(voxels.n, -1, dtype=np.int32)
    number[at] = np.arange(at.size, dtype=np.int32)
    a, b = skeleton_edges(at, number, voxels.x, voxels.row, voxels.first, ny)
    _, patch = connected_components(coo_matrix((np.ones(a.size), (a, b)), shape=(at.size, at.size)), directed=False)
    exits = np.zeros(tip.size, dtype=bool)
    on_border = np.flatnonzero(number[tip] >= 0)
    ranked = on_border[np.argsort(-persistence[on_border], kind="stable")]
    _, first = np.unique(patch[number[tip[ranked]]], return_index=True)
    exits[ranked[first]] = True
    return exits
