"""The foreground as a sorted list of voxels: everything after cleaning works on it and never on the whole volume."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vascval.imaging import _run_kernels as kernels
from vascval.imaging.runs import Runs


@dataclass(frozen=True, eq=False)
class Voxels:
    """Foreground voxels in the order of memory.

    * ``shape`` (nz, ny, nx) of the volume, ``spacing_mm`` (3,) along x, y, z.
    * ``x`` (n,), ``row`` (n,): voxel ``i`` is at ``x[i]`` of row ``row[i] = z * ny + y``.
    * ``offset`` (nz * ny + 1,): row ``r`` holds voxels ``offset[r]:offset[r + 1]``.
    * ``first`` (n, 8): where each of the eight neighbour rows reaches ``x - 1`` (-1 outside the volume), which makes
      walking through the 26 neighbours a matter of a few reads.
    """

    shape: tuple[int, int, int]
    spacing_mm: np.ndarray
    x: np.ndarray
    row: np.ndarray
    offset: np.ndarray
    first: np.ndarray

    @property
    def n(self) -> int:
        return int(self.x.size)

    def index_xyz(self, voxel: np.ndarray | slice | int = slice(None)) -> np.ndarray:
        """(k, 3) integer x, y, z of the given voxels (all by default)."""
        row = self.row[voxel]
        return np.stack((self.x[voxel], row % self.shape[1], row // self.shape[1]), axis=-1)

    def find(self, index_xyz: np.ndarray) -> np.ndarray:
        """(k,) the foreground voxel at each integer (k, 3) index, -1 where there is none."""
        nz, ny, nx = self.shape
        x, y, z = np.asarray(index_xyz, dtype=np.int64).T
        inside = (x >= 0) & (x < nx) & (y >= 0) & (y < ny) & (z >= 0) & (z < nz)
        key = self.row.astype(np.int64) * nx + self.x
        wanted = (z * ny + y) * nx + x
        at = np.minimum(np.searchsorted(key, wanted), self.n - 1)
        return np.where(inside & (key[at] == wanted), at, -1)


def from_runs(runs: Runs, spacing_mm: np.ndarray) -> Voxels:
    """List the voxels of the runs."""
    nz, ny, _ = runs.shape
    offset, x, row = kernels.expand(runs.row_offset, runs.start, runs.stop)
    first = kernels.neighbour_rows(offset, x, row, ny, nz)
    return Voxels(runs.shape, np.asarray(spacing_mm, dtype=np.float64), x, row, offset, first)
