"""Tips of vessels: the maxima of the way from a source that stick out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vascval.imaging import _geodesic_kernels, _peak_kernels
from vascval.imaging._thinning_kernels import adjacency_masks
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
    width = EPOCH_VOXELS * float(spacing.max())
    way = np.full(voxels.n, np.inf)
    _geodesic_kernels.geodesic(int(np.argmax(thickness_mm)), voxels.lattice, step, width, way)
    source = int(np.argmax(way))
    way[:] = np.inf
    _geodesic_kernels.geodesic(source, voxels.lattice, step, width, way)
    tip, saddle, widest = maxima(voxels, way, thickness_mm)
    persistence = np.where(saddle < 0, np.inf, way[tip] - way[saddle])
    voxel_mm = float(np.cbrt(np.prod(spacing)))
    bump_mm = bump_voxels(persistence / voxel_mm) * voxel_mm
    salient = persistence > salience_mm(widest, bump_mm)
    noticed = ~salient & (persistence > NOTICE_VOXELS * voxel_mm)
    return Tips(np.union1d(tip[salient], [source]), np.sort(tip[noticed]), bump_mm)


def maxima(voxels: Voxels, height: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Local maxima of ``height`` (n,), of equal ones the voxel of the smaller number being the higher.

    :returns: for each maximum its voxel, the saddle's voxel at which a higher one takes over (-1 for the highest of a
        component) and the largest ``value`` (n,) in what hung on it before the saddle.
    """
    near, _ = adjacency_masks()
    of_voxel = np.empty(voxels.n, dtype=np.int32)
    event = _peak_kernels.find_events(height, voxels.lattice, near, of_voxel)
    event = event[np.argsort(-height[event], kind="stable")]
    _peak_kernels.name_events(event, of_voxel)
    saddle, over, done = _peak_kernels.sweep(event, height, voxels.lattice, of_voxel)
    most = _peak_kernels.most_above(value, event, height, of_voxel, saddle, over, done)
    peak = np.flatnonzero(saddle != np.arange(event.size))
    return event[peak], np.where(saddle < 0, -1, event[saddle])[peak], most[peak]


def bump_voxels(persistence: np.ndarray) -> float:
    """The persistence in voxels that one bump of a wall is expected to exceed; 1 at least.

    Vessels stick out by more than a voxel, so that the maxima between a half and one voxel are bumps. From there their
    number falls to ``DECAY`` with each half voxel at the most (0.35 to 0.45 on phantoms with rough walls of several
    correlation lengths); of n of them ``n DECAY / (1 - DECAY) DECAY^(2 (p - 1))`` stick out by more than p.
    """
    n = max(1, int(np.count_nonzero((persistence > 0.5) & (persistence <= 1.0))))
    return 1.0 + max(0.0, 0.5 * float(np.log(n * DECAY / (1.0 - DECAY)) / -np.log(DECAY)))
