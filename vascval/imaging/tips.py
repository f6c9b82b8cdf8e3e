"""Tips of vessels: the maxima of the way from a source that stick out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vascval.imaging import _geodesic_kernels as kernels
from vascval.imaging.voxels import Voxels

SALIENCE_RADII = 0.5
DECAY = 0.45
NOTICE_VOXELS = 1.5
EPOCH_VOXELS = 32


@dataclass(frozen=True, eq=False)
class Tips:
    """``voxel`` (t,): tips of vessels, the ends of the stem included. ``spur`` (u,): bumps that are no vessel.

    ``bump_mm``: how far the bumps of this wall may stick out.
    """

    voxel: np.ndarray
    spur: np.ndarray
    bump_mm: float


def salience_mm(thickness_mm: np.ndarray, bump_mm: float) -> np.ndarray:
    """How far a vessel of a given largest distance value must stick out to be one: farther than the bumps of the wall,
    and by ``SALIENCE_RADII`` of what it is thick from axis to wall."""
    return SALIENCE_RADII * thickness_mm + bump_mm


def find_tips(voxels: Voxels, thickness_mm: np.ndarray) -> Tips:
    """Find the tips of all vessels of a connected mask.

    The way through the mask from one of its ends (the place farthest from the thickest voxel) has a local maximum at
    every other tip, and at every bump of a rough wall. A maximum is followed down to the saddle where a farther one
    takes over; what hangs on it until there sticks out by its persistence, the difference in way. A tip is a maximum
    whose persistence exceeds :func:`salience_mm`; lesser ones that stick out by more than ``NOTICE_VOXELS`` voxels are
    reported as spurs.

    How far bumps may stick out is read off the wall itself (:func:`bump_voxels`), so that a smooth wall keeps its short
    vessels and a rough one does not sprout any.
    """
    spacing = voxels.spacing_mm
    code = np.arange(27)
    offset = np.stack((code % 3 - 1, code // 3 % 3 - 1, code // 9 - 1), axis=1)
    step = np.sqrt(((offset * spacing) ** 2).sum(axis=1))
    lattice = voxels.lattice
    width = EPOCH_VOXELS * float(spacing.max())
    way = np.full(voxels.n, np.inf)
    kernels.geodesic(int(np.argmax(thickness_mm)), lattice, step, width, way)
    source = int(np.argmax(way))
    way[:] = np.inf
    kernels.geodesic(source, lattice, step, width, way)
    scratch = np.full(voxels.n, -1, dtype=np.int32), np.empty(voxels.n, dtype=np.int32)
    tip, saddle, widest = kernels.maxima(kernels.descending(way), way, thickness_mm, lattice, *scratch)
    del scratch
    persistence = np.where(saddle < 0, np.inf, way[tip] - way[saddle])
    voxel_mm = float(np.cbrt(np.prod(spacing)))
    bump_mm = bump_voxels(persistence / voxel_mm) * voxel_mm
    salient = persistence > salience_mm(widest, bump_mm)
    noticed = ~salient & (persistence > NOTICE_VOXELS * voxel_mm)
    return Tips(np.union1d(tip[salient], [source]), np.sort(tip[noticed]), bump_mm)


def bump_voxels(persistence: np.ndarray) -> float:
    """The persistence in voxels that one bump of a wall is expected to exceed; 1 at least.

    Vessels stick out by more than a voxel, so that the maxima between a half and one voxel are bumps. From there their
    number falls to ``DECAY`` with each half voxel at the most (0.35 to 0.45 on phantoms with rough walls of several
    correlation lengths); of n of them ``n DECAY / (1 - DECAY) DECAY^(2 (p - 1))`` stick out by more than p.
    """
    n = max(1, int(np.count_nonzero((persistence > 0.5) & (persistence <= 1.0))))
    return 1.0 + max(0.0, 0.5 * float(np.log(n * DECAY / (1.0 - DECAY)) / -np.log(DECAY)))
