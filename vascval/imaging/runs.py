"""A mask as runs of foreground voxels along x: components and cavities in time and memory of the runs.

Vessels fill about one voxel in a hundred of a scan. A run-length code keeps them whole in a few megabytes, and
labelling or filling touches runs instead of voxels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
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


def painted(runs: Runs, low: np.ndarray, high: np.ndarray, block: int = 1) -> np.ndarray:
    """The box from ``low`` to before ``high`` (x, y, z) as an image, uint8 (z, y, x), of blocks of ``block`` voxels
    along each axis: 1 where any voxel of the block is set. All runs must lie in the box."""
    image = np.zeros(-(-(high - low) // block)[::-1], dtype=np.uint8)
    kernels.paint(runs.row_offset, runs.start, runs.stop, runs.shape[1], low, block, image)
    return image


Watch = Callable[[int, int, int], None]


def from_blocks(
    shape: tuple[int, int, int], blocks: Iterable[tuple[int, int, np.ndarray]], watch: Watch | None = None
) -> Runs:
    """Runs of a mask that comes in blocks of whole rows, so that it never stands in memory whole.

    :param shape: (nz, ny, nx).
    :param blocks: z and y of the first row of each block, and its boolean values (dz, dy, nx); layers of equal z one
        after the other, the blocks of a layer by ascending y.
    :param watch: called after each layer with how many slices there are, and the runs and voxels in them.
    """
    nz, ny, nx = shape
    offset = np.zeros(nz * ny + 1, dtype=np.int64)
    count = offset[1:].reshape(nz, ny)
    starts: list[np.ndarray] = []
    stops: list[np.ndarray] = []
    layer: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    n_runs = n_voxels = 0
    start, stop = np.empty(0, dtype=np.int32), np.empty(0, dtype=np.int32)
    for z, y, values in blocks:
        mask = np.ascontiguousarray(values).view(np.uint8)
        depth, height, _ = mask.shape
        room = depth * height * ((nx + 1) // 2)
        if room > start.size:
            start, stop = np.empty(room, dtype=np.int32), np.empty(room, dtype=np.int32)
        own = np.empty((depth, height), dtype=np.int64)
        n = kernels.find_runs(mask, own, start, stop)
        count[z : z + depth, y : y + height] = own
        layer.append((np.concatenate(([0], np.cumsum(own.sum(axis=1)))), start[:n].copy(), stop[:n].copy()))
        n_runs, n_voxels = n_runs + n, n_voxels + int(stop[:n].sum(dtype=np.int64) - start[:n].sum(dtype=np.int64))
        if y + height < ny:
            continue
        for k in range(depth):
            starts += [first[at[k] : at[k + 1]] for at, first, _ in layer]
            stops += [end[at[k] : at[k + 1]] for at, _, end in layer]
        layer = []
        if watch is not None:
            watch(z + depth, n_runs, n_voxels)
    np.cumsum(offset, out=offset)
    first = np.concatenate(starts)
    starts.clear()
    return Runs(shape, offset, first, np.concatenate(stops))


@dataclass(frozen=True, eq=False)
class Components:
    """26-connected components, largest first: ``label`` of each run and ``size_voxels`` of each component."""

    label: np.ndarray
    size_voxels: np.ndarray


def components(runs: Runs) -> Components:
    """Label the 26-connected components; equal sizes are ordered by their first voxel."""
    nz, ny, _ = runs.shape
    first = kernels.components(runs.row_offset, runs.start, runs.stop, ny, nz, True)
    label, size = kernels.numbered(first, runs.start, runs.stop)
    rank = np.argsort(-size, kind="stable")
    position = np.empty(rank.size, dtype=np.int32)
    position[rank] = np.arange(rank.size, dtype=np.int32)
    return Components(position[label], size[rank])


def keep(runs: Runs, label: np.ndarray, wanted: np.ndarray) -> Runs:
    """Only the runs whose ``label`` (r,) is marked in the boolean array ``wanted`` (one for each label)."""
    return Runs(runs.shape, *kernels.keep_runs(runs.row_offset, runs.start, runs.stop, label, wanted))


def crop(runs: Runs, label: np.ndarray, wanted: int, low: np.ndarray, high: np.ndarray) -> Runs:
    """The part of one component in the box from ``low`` to before ``high`` (x, y, z), as a mask of the box."""
    nx, ny, nz = (int(n) for n in high - low)
    cut = kernels.crop_runs(runs.row_offset, runs.start, runs.stop, label, wanted, runs.shape[1], low, high)
    return Runs((nz, ny, nx), *cut)


def fill_cavities(runs: Runs) -> tuple[Runs, int, int]:
    """Fill the background that is shut in by foreground (6-connected, not reaching the border of the volume).

    :returns: the filled runs, the number of cavities and the number of voxels that were filled.
    """
    nz, ny, nx = runs.shape
    offset, start, stop = kernels.background_runs(runs.row_offset, runs.start, runs.stop, nx)
    label, size = kernels.numbered(kernels.components(offset, start, stop, ny, nz, False), start, stop)
    shut = ~kernels.touches_border(label, size.size, offset, start, stop, nx, ny, nz)
    if not shut.any():
        return runs, 0, 0
    holes = Runs(runs.shape, *kernels.keep_runs(offset, start, stop, label, shut))
    return union(runs, holes), int(shut.sum()), int(size[shut].sum())


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
