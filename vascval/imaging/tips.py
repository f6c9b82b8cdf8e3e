"""Tips of vessels: the maxima of the way from a source that stick out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vascval.imaging import _geodesic_kernels as kernels
from vascval.imaging.voxels import Voxels

SALIENCE_RADII = 1.0
SALIENCE_VOXELS = 2.5
NOTICE_VOXELS = 1.5


@dataclass(frozen=True, eq=False)
class Tips:
    """``voxel`` (t,): tips of vessels, the ends of the stem included. ``spur`` (u,): bumps that are no vessel."""

    voxel: np.ndarray
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
    whose persistence exceeds :func:`salience_mm`; lesser ones that stick out by more than ``NOTICE_VOXELS`` voxels are
    reported as spurs.
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
    salient = persistence > salience_mm(widest, spacing)
    noticed = ~salient & (persistence > NOTICE_VOXELS * float(np.cbrt(np.prod(spacing))))
    return Tips(np.union1d(tip[salient], [source]), np.sort(tip[noticed]))
