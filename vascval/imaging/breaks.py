"""Breaks: fragments that a rough or thin wall has torn off a vessel are joined to it again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from vascval.imaging import _run_kernels as kernels
from vascval.imaging.distance import distance_map
from vascval.imaging.runs import Components, Runs, crop, from_voxels, keep, union
from vascval.imaging.voxels import from_runs

MIN_VOXELS = 27
MAX_FRAGMENTS = 2000
MAX_ANGLE_DEG = 45.0
MAX_GAP_DIAMETERS = 1.5


@dataclass(frozen=True, eq=False)
class Joined:
    """``runs``: the body with the fragments that belong to it. ``breaks_xyz`` (k, 3): where they were joined (voxels).

    ``n_voxels_left``: how many voxels of other components were left out.
    """

    runs: Runs
    breaks_xyz: np.ndarray
    n_voxels_left: int


def join_breaks(runs: Runs, parts: Components, spacing_mm: np.ndarray) -> Joined:
    """The largest component, with the fragments that continue it across a break.

    A fragment of at least ``MIN_VOXELS`` voxels belongs to the body when its end faces it across a gap of at most
    ``MAX_GAP_DIAMETERS`` times the fragment's thickness: the way to the nearest voxel of the body leaves the fragment
    within ``MAX_ANGLE_DEG`` of its long axis and beyond its middle. The gap is closed by a thread of voxels. Fragments
    may continue other fragments. What lies beside a vessel, however near, is not joined.
    """
    candidates = np.flatnonzero(parts.size_voxels[1:] >= MIN_VOXELS)[:MAX_FRAGMENTS] + 1
    chosen = np.zeros(parts.size_voxels.size, dtype=bool)
    chosen[0] = True
    if candidates.size == 0:
        return Joined(keep(runs, parts.label, chosen), np.empty((0, 3)), int(parts.size_voxels[1:].sum()))
    wanted = np.zeros_like(chosen)
    wanted[candidates] = True
    box = kernels.boxes(runs.row_offset, runs.start, runs.stop, parts.label, wanted, runs.shape[1])
    fragments = {int(k): _Fragment(runs, parts, int(k), box[k], spacing_mm) for k in candidates}
    found = {k: gap for k, one in fragments.items() if (gap := one.gap_to(one.near_body(runs, parts))) is not None}
    threads: list[tuple[np.ndarray, np.ndarray]] = []
    while found:
        threads += found.values()
        chosen[list(found)] = True
        fresh = [cKDTree(fragments.pop(k).point) for k in found]
        found = {k: gap for k, one in fragments.items() if (gap := one.gap_to(fresh)) is not None}
    whole = keep(runs, parts.label, chosen)
    if threads:
        line = np.concatenate([_thread(near / spacing_mm, far / spacing_mm) for near, far in threads])
        whole = union(whole, from_voxels(runs.shape, line))
    middle = np.array([(near + far) / 2 / spacing_mm for near, far in threads]).reshape(-1, 3)
    left = int(parts.size_voxels.sum() - parts.size_voxels[chosen].sum())
    return Joined(whole, middle, left)


class _Fragment:
    """A component with its long axis and thickness."""

    def __init__(self, runs: Runs, parts: Components, label: int, box: np.ndarray, spacing_mm: np.ndarray) -> None:
        size = np.array(runs.shape[::-1])
        self.spacing_mm, self.box = spacing_mm, box
        # one voxel of margin tells the wall of the fragment from the border of the volume
        low, high = np.maximum(box[0] - 1, 0), np.minimum(box[1] + 2, size)
        voxels = from_runs(crop(runs, parts.label, label, low, high), spacing_mm)
        self.point = (voxels.index_xyz() + low) * spacing_mm
        self.centre = self.point.mean(axis=0)
        spread = np.linalg.eigh(np.cov((self.point - self.centre).T))
        self.axis = spread.eigenvectors[:, -1]
        self.half_voxel = float(spacing_mm.mean()) / 2
        self.thickness = 2 * float(distance_map(voxels).max()) - 2 * self.half_voxel

    @property
    def reach(self) -> float:
        """The widest gap that the fragment may have, mm."""
        return MAX_GAP_DIAMETERS * self.thickness + 2 * self.half_voxel

    def near_body(self, runs: Runs, parts: Components) -> list[cKDTree]:
        """The voxels of the body that may lie within reach of the fragment."""
        away = np.ceil(self.reach / self.spacing_mm).astype(np.int64)
        low = np.maximum(self.box[0] - away, 0)
        high = np.minimum(self.box[1] + away + 1, runs.shape[::-1])
        near = from_runs(crop(runs, parts.label, 0, low, high), self.spacing_mm)
        return [cKDTree((near.index_xyz() + low) * self.spacing_mm)] if near.n else []

    def gap_to(self, bodies: list[cKDTree]) -> tuple[np.ndarray, np.ndarray] | None:
        """The two voxels between which the fragment continues one of the bodies, if it does."""
        for body in bodies:
            distance, index = body.query(self.point, distance_upper_bound=self.reach)
            k = int(np.argmin(distance))
            if not np.isfinite(distance[k]):
                continue
            near, far = self.point[k], body.data[index[k]]
            gap = far - near
            along = float(gap @ self.axis)
            outward = float((near - self.centre) @ self.axis)
            ahead = abs(along) >= np.cos(np.radians(MAX_ANGLE_DEG)) * float(np.linalg.norm(gap))
            if ahead and along * outward > 0:
                return near, far
        return None


def _thread(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(k, 3) voxels within one voxel of a straight line between two voxels, ends included."""
    n = int(np.ceil(np.abs(end - start).max())) * 2 + 1
    line = np.rint(start + np.linspace(0, 1, n)[:, None] * (end - start)).astype(np.int64)
    cross = np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    return (line[:, None, :] + cross[None]).reshape(-1, 3)
