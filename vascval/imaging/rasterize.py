"""A tree drawn into voxels: the union of rounded tubes around its centrelines.

The inverse of skeletonisation. A voxel belongs to the tree when its centre lies no farther from the centreline of a
segment than that segment's radius, ends included, so that junctions are covered by spheres and tips are round.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vascval.core.errors import InputError
from vascval.core.tree import Tree
from vascval.imaging import _rasterize_kernels as kernels
from vascval.io.volumes import Volume, check_spacing, default_memory_bytes

Block = tuple[tuple[int, int], tuple[int, int], tuple[int, int]]


@dataclass(frozen=True, eq=False)
class Grid:
    """Where the voxels are: ``shape`` (nz, ny, nx); ``spacing_mm`` and ``origin_mm`` (3,), x y z, the origin being
    the centre of voxel (0, 0, 0)."""

    shape: tuple[int, int, int]
    spacing_mm: np.ndarray
    origin_mm: np.ndarray


def grid_around(
    tree: Tree,
    *,
    voxel_mm: float | Sequence[float],
    margin_mm: float | None = None,
    shape: Sequence[int] | None = None,
    origin_mm: Sequence[float] | None = None,
) -> Grid:
    """The grid around the tree's tubes with ``margin_mm`` on all sides (default: two of the largest voxel edges).

    :param voxel_mm: edge of the voxels, one number or x, y, z.
    :param shape: (nz, ny, nx), if it is not to follow from the tree.
    :param origin_mm: centre of the first voxel, if it is not to follow from the tree.
    :raises InputError: when a number is not finite or out of range, or the tree has no segment.
    """
    if np.shape(voxel_mm) not in ((), (3,)):
        raise InputError(f"voxel_mm is {voxel_mm}; one number or three (x, y, z) are needed")
    spacing = np.broadcast_to(np.asarray(voxel_mm, dtype=np.float64), (3,)).copy()
    check_spacing(spacing)
    margin = 2.0 * float(spacing.max()) if margin_mm is None else float(margin_mm)
    if not (np.isfinite(margin) and margin >= 0):
        raise InputError(f"margin_mm is {margin_mm}; a number of 0 or more is needed")
    start, end, radius = _pieces(tree)
    low = (np.minimum(start, end) - radius[:, None]).min(axis=0) - margin
    high = (np.maximum(start, end) + radius[:, None]).max(axis=0) + margin
    origin = low if origin_mm is None else np.asarray(origin_mm, dtype=np.float64)
    if origin.shape != (3,) or not np.isfinite(origin).all():
        raise InputError(f"origin_mm is {origin_mm}; three finite numbers (x, y, z) are needed")
    if shape is None:
        count = np.ceil((high - origin) / spacing - 1e-9) + 1
        shape = [int(n) for n in np.maximum(count, 1)[::-1]]
    if len(shape) != 3 or any(int(n) != n or n < 1 for n in shape):
        raise InputError(f"shape is {tuple(shape)}; three positive whole numbers (nz, ny, nx) are needed")
    return Grid((int(shape[0]), int(shape[1]), int(shape[2])), spacing, origin.copy())


def rasterize(
    tree: Tree,
    *,
    voxel_mm: float | Sequence[float],
    margin_mm: float | None = None,
    shape: Sequence[int] | None = None,
    origin_mm: Sequence[float] | None = None,
    block: Block | None = None,
    max_memory_bytes: int | None = None,
) -> Volume:
    """The tree as a mask, uint8, 1 inside.

    The grid is that of :func:`grid_around`, axes along the world's. ``block`` ((z0, z1), (y0, y1), (x0, x1)) asks for
    that part of it alone, equal bit for bit to the same part of the whole, its origin being that of the block's
    first voxel: a grid larger than memory is drawn block by block. Tubes that leave a grid of given shape are cut off.

    :raises InputError: as :func:`grid_around`; when the block does not lie in the grid; when the mask would need more
        than ``max_memory_bytes`` (half of the available memory by default), which is found before it is tried.
    """
    grid = grid_around(tree, voxel_mm=voxel_mm, margin_mm=margin_mm, shape=shape, origin_mm=origin_mm)
    offset, size = _block(grid, block)
    _refuse_size(size, 1, max_memory_bytes)
    values = np.zeros(size, dtype=np.uint8)
    kernels.mark(values, *_pieces(tree), grid.origin_mm, grid.spacing_mm, offset)
    return _volume(values, grid, offset)


def wall_distance(
    tree: Tree,
    *,
    band_mm: float,
    voxel_mm: float | Sequence[float],
    margin_mm: float | None = None,
    shape: Sequence[int] | None = None,
    origin_mm: Sequence[float] | None = None,
    block: Block | None = None,
    max_memory_bytes: int | None = None,
) -> Volume:
    """Signed distance to the vessel wall in mm, float32: negative inside, ``band_mm`` where it is that or more.

    Where tubes overlap it is the smallest of their distances: exact outside, a bound inside. ``rasterize`` is
    ``values <= 0`` up to rounding. Parameters and errors are those of :func:`rasterize`.

    :raises InputError: also when ``band_mm`` is not a positive number.
    """
    if not (np.isfinite(band_mm) and band_mm > 0):
        raise InputError(f"band_mm is {band_mm}; a positive number is needed")
    grid = grid_around(tree, voxel_mm=voxel_mm, margin_mm=margin_mm, shape=shape, origin_mm=origin_mm)
    offset, size = _block(grid, block)
    _refuse_size(size, 4, max_memory_bytes)
    values = np.full(size, band_mm, dtype=np.float32)
    kernels.lower_distance(values, *_pieces(tree), grid.origin_mm, grid.spacing_mm, offset, float(band_mm))
    return _volume(values, grid, offset)


def _pieces(tree: Tree) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(P, 3) start, (P, 3) end, (P,) radius of the straight pieces of all centrelines."""
    if tree.n_segments == 0:
        raise InputError("the tree has no segment, only a root point; there is nothing to draw")
    if tree.polyline_mm is None or tree.polyline_offset is None:
        return tree.position_mm[tree.parent[1:]], tree.position_mm[1:], tree.radius_mm[1:]
    n_pieces = np.diff(tree.polyline_offset)[1:] - 1
    inside = np.ones(len(tree.polyline_mm), dtype=bool)
    inside[tree.polyline_offset[2:] - 1] = False
    first = np.flatnonzero(inside)
    return tree.polyline_mm[first], tree.polyline_mm[first + 1], np.repeat(tree.radius_mm[1:], n_pieces)


def _block(grid: Grid, block: Block | None) -> tuple[np.ndarray, tuple[int, int, int]]:
    """(3,) index x y z of the first voxel, and the shape (nz, ny, nx) of the block, the whole grid if it is None."""
    if block is None:
        return np.zeros(3, dtype=np.int64), grid.shape
    bounds = np.asarray(block)
    inside = np.issubdtype(bounds.dtype, np.integer) and bounds.shape == (3, 2)
    if inside:
        begin, end = bounds.T
        inside = bool((begin >= 0).all() and (begin < end).all() and (end <= grid.shape).all())
    if not inside:
        raise InputError(f"block {block} is no part of a grid of {grid.shape} voxels; give (begin, end) for z, y, x")
    nz, ny, nx = (int(n) for n in bounds[:, 1] - bounds[:, 0])
    return bounds[::-1, 0].astype(np.int64), (nz, ny, nx)


def _refuse_size(size: tuple[int, int, int], item_bytes: int, max_memory_bytes: int | None) -> None:
    needed = item_bytes * size[0] * size[1] * size[2]
    allowed = default_memory_bytes() if max_memory_bytes is None else max_memory_bytes
    if needed > allowed:
        raise InputError(
            f"a grid of {size[2]} x {size[1]} x {size[0]} voxels needs {needed / 2**30:.1f} GiB, more than the "
            f"{allowed / 2**30:.1f} GiB allowed; take larger voxels, draw it block by block, or allow more"
        )


def _volume(values: np.ndarray, grid: Grid, offset: np.ndarray) -> Volume:
    return Volume(
        values=values,
        spacing_mm=grid.spacing_mm,
        origin_mm=grid.origin_mm + offset * grid.spacing_mm,
        direction=np.eye(3),
        meta={},
    )
