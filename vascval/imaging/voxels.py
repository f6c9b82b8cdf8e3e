"""The foreground as a numbered list of voxels: everything after cleaning works on it and never on the whole volume.

Nothing is kept for each voxel but the run it belongs to (4 bytes); places and neighbours follow from the runs, which
are several times fewer.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vascval.core.errors import InputError
from vascval.imaging import _run_kernels as kernels
from vascval.imaging.runs import Runs

MAX_VOXELS = 2**31 - 64


class Lattice(NamedTuple):
    """What the kernels need to walk from voxel to voxel; run ``k`` covers voxels ``span[k, 2]`` to ``span[k + 1, 2]``.

    * ``span`` (r + 1, 3) int32: row ``z * ny + y``, first x and first voxel of each run; the last line has row -1.
    * ``run`` (n,) int32: the run of each voxel.
    * ``link`` (r, 8) int32: the first run of each of the eight neighbour rows that touches the run; -1 if none does.
    * ``ny``: rows per slice.
    """

    span: np.ndarray
    run: np.ndarray
    link: np.ndarray
    ny: int


@dataclass(frozen=True, eq=False)
class Voxels:
    """Foreground voxels, numbered in the order of memory.

    * ``shape`` (nz, ny, nx) of the volume, ``spacing_mm`` (3,) along x, y, z.
    * ``lattice``: the voxels; ``row_offset`` (nz * ny + 1,): row ``r`` holds runs ``row_offset[r]:row_offset[r + 1]``.
    """

    shape: tuple[int, int, int]
    spacing_mm: np.ndarray
    lattice: Lattice
    row_offset: np.ndarray

    @property
    def n(self) -> int:
        return int(self.lattice.run.size)

    def index_xyz(self, voxel: np.ndarray | slice | int = slice(None)) -> np.ndarray:
        """(k, 3) integer x, y, z of the given voxels (all by default)."""
        number = np.arange(self.n)[voxel] if isinstance(voxel, slice) else np.asarray(voxel, dtype=np.int64)
        span = self.lattice.span[self.lattice.run[voxel]]
        row = span[..., 0]
        return np.stack((span[..., 1] + (number - span[..., 2]), row % self.shape[1], row // self.shape[1]), axis=-1)

    def find(self, index_xyz: np.ndarray) -> np.ndarray:
        """(k,) the foreground voxel at each integer (k, 3) index, -1 where there is none."""
        x, y, z = np.asarray(index_xyz, dtype=np.int64).T.copy()
        nz, ny, nx = self.shape
        inside = (x >= 0) & (x < nx) & (y >= 0) & (y < ny) & (z >= 0) & (z < nz)
        row = np.where(inside, z * ny + y, -1)
        return kernels.find_voxels(row, x, self.row_offset, self.lattice.span)


def from_runs(runs: Runs, spacing_mm: np.ndarray) -> Voxels:
    """Number the voxels of the runs.

    :raises InputError: when there are more than 32 bits can count.
    """
    nz, ny, _ = runs.shape
    if runs.n_voxels > MAX_VOXELS:
        raise InputError(f"{runs.n_voxels:,} voxels are selected, of {MAX_VOXELS:,} that can be; crop or downsample")
    # arrays of the size of the foreground are NumPy's, which asks for huge pages: the kernels' own would be slower
    span, run = np.empty((runs.start.size + 1, 3), dtype=np.int32), np.empty(runs.n_voxels, dtype=np.int32)
    link = np.full((runs.start.size, 8), -1, dtype=np.int32)
    kernels.spans(runs.row_offset, runs.start, runs.stop, span, run)
    kernels.links(runs.row_offset, runs.start, runs.stop, ny, nz, link)
    return Voxels(runs.shape, np.asarray(spacing_mm, dtype=np.float64), Lattice(span, run, link, ny), runs.row_offset)
