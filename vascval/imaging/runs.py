"""A mask as runs of foreground voxels along x: components and cavities in time and memory of the runs.

Vessels fill about one voxel in a hundred of a scan. A run-length code keeps them whole in a few megabytes, and
labelling or filling touches runs instead of voxels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from vascval.imaging import _run_kernels as kernels


@dataclass(frozen=True, eq=False)
class Runs:
    """Runs of a mask of ``shape`` (nz, ny, nx).

    Row ``z * ny + y`` holds runs ``row_offset[row]:row_offset[row + 1]``, ascending; each covers the voxels
    ``start <= x < stop``.
    """

    shape: tuple[int, int, int]
    row_offset: np.ndarray
    start: np.ndarray
    stop: np.ndarray

    @property
    def n_voxels(self) -> int:
        return int((self.stop.astype(np.int64) - self.start).sum())

    def slabs(self, begin: int = 0, end: int | None = None) -> Iterator[np.ndarray]:
        """The mask again, one boolean (ny, nx) slab after another, of the slices ``begin`` to ``end``."""
        nz, ny, nx = self.shape
        for z in range(begin, nz if end is None else end):
            slab = np.zeros((ny, nx), dtype=bool)
            for y in range(ny):
                row = z * ny + y
                for k in range(self.row_offset[row], self.row_offset[row + 1]):
                    slab[y, self.start[k] : self.stop[k]] = True
            yield slab


def from_slabs(shape: tuple[int, int, int], slab: Callable[[int], np.ndarray]) -> Runs:
    """Runs of a mask that is asked for slab by slab, so that it never stands in memory whole.

    :param shape: (nz, ny, nx).
    :param slab: gives the boolean (ny, nx) slab at each z.
    """
    nz, ny, nx = shape
    count = np.empty((nz, ny), dtype=np.int64)
    room = ny * ((nx + 1) // 2)
    start, stop = np.empty(room, dtype=np.int32), np.empty(room, dtype=np.int32)
    starts, stops = [], []
    for z in range(nz):
        mask = np.ascontiguousarray(slab(z)).view(np.uint8)
        n = kernels.find_runs(mask[None], count[z : z + 1], start, stop)
        starts.append(start[:n].copy())
        stops.append(stop[:n].copy())
    offset = np.concatenate(([0], np.cumsum(count)))
    return Runs(shape, offset, np.concatenate(starts), np.concatenate(stops))


@dataclass(frozen=True, eq=False)
class Components:
    """26-connected components, largest first: ``label`` of each run and ``size_voxels`` of each component."""

    label: np.ndarray
    size_voxels: np.ndarray


def components(runs: Runs) -> Components:
    """Label the 26-connected components; equal sizes are ordered by their first voxel."""
    nz, ny, _ = runs.shape
    first = kernels.components(runs.row_offset, runs.start, runs.stop, ny, nz, True)
    names, label = np.unique(first, return_inverse=True)
    size = np.bincount(label, weights=runs.stop - runs.start, minlength=names.size).astype(np.int64)
    rank = np.argsort(-size, kind="stable")
    position = np.empty_like(rank)
    position[rank] = np.arange(rank.size)
    return Components(position[label], size[rank])


def keep(runs: Runs, chosen: np.ndarray) -> Runs:
    """Only the runs marked in the boolean array ``chosen``."""
    total = np.concatenate(([0], np.cumsum(chosen)))
    return Runs(runs.shape, total[runs.row_offset], runs.start[chosen], runs.stop[chosen])


def fill_cavities(runs: Runs) -> tuple[Runs, int, int]:
    """Fill the background that is shut in by foreground (6-connected, not reaching the border of the volume).

    :returns: the filled runs, the number of cavities and the number of voxels that were filled.
    """
    nz, ny, nx = runs.shape
    offset, start, stop = kernels.background_runs(runs.row_offset, runs.start, runs.stop, nx)
    label = kernels.components(offset, start, stop, ny, nz, False)
    open_to_border = kernels.touches_border(label, offset, start, stop, nx, ny, nz)[label]
    if open_to_border.all():
        return runs, 0, 0
    holes = keep(Runs(runs.shape, offset, start, stop), ~open_to_border)
    return union(runs, holes), int(np.unique(label[~open_to_border]).size), holes.n_voxels


def from_voxels(shape: tuple[int, int, int], index_xyz: np.ndarray) -> Runs:
    """Runs of single voxels at the given (k, 3) indices; repeated ones count once, those outside are left out."""
    nz, ny, nx = shape
    x, y, z = np.asarray(index_xyz, dtype=np.int64).T
    inside = (x >= 0) & (x < nx) & (y >= 0) & (y < ny) & (z >= 0) & (z < nz)
    key = np.unique(((z * ny + y) * nx + x)[inside])
    count = np.bincount(key // nx, minlength=nz * ny)
    start = (key % nx).astype(np.int32)
    return Runs(shape, np.concatenate(([0], np.cumsum(count))), start, start + np.int32(1))


def union(runs: Runs, more: Runs) -> Runs:
    """The voxels of either."""
    return Runs(
        runs.shape,
        *kernels.merge_runs(runs.row_offset, runs.start, runs.stop, more.row_offset, more.start, more.stop),
    )
