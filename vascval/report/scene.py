"""The geometry behind the 3-D pictures: the surface of a mask, and trees as tapering tubes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vascval.core.tree import Tree
from vascval.report.formats import count
from vascval.report.style import Series

MAX_TRIANGLES = 60_000
MAX_PIECES = 60_000
_MAX_RAW_TRIANGLES = 1_500_000


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles: ``points_mm`` (P, 3) and ``triangles`` (T, 3), int. ``note`` says how it was simplified.

    Where tubes fit their image, tube and surface lie within a voxel and would show in patches: the surface is drawn
    ``voxel_mm`` nearer to the viewer, which does not move it on a parallel view. ``label``: what legends call it;
    ``opacity``: how much of what is behind it hides.
    """

    points_mm: np.ndarray
    triangles: np.ndarray
    voxel_mm: float = 0.0
    note: str = ""
    label: str = "surface of the cast"
    opacity: float = 0.35


@dataclass(frozen=True, eq=False)
class Tubes:
    """A tree as straight pieces, thickest first: ``start_mm``, ``end_mm`` (K, 3), ``radius_mm`` and ``segment`` (K,).

    ``n_segments_left_out`` counts the thinnest segments, dropped where the pieces would be too many to draw;
    ``thinnest_drawn_mm`` is the radius of the thinnest one that stayed.
    """

    series: Series
    start_mm: np.ndarray
    end_mm: np.ndarray
    radius_mm: np.ndarray
    segment: np.ndarray
    n_segments_left_out: int
    thinnest_drawn_mm: float


def tubes(tree: Tree, series: Series, *, max_pieces: int = MAX_PIECES) -> Tubes:
    """The segments of ``tree`` as pieces, one for each step of a curved centreline.

    Segments are taken from the thickest on until ``max_pieces`` is reached. A tree without segments has no pieces.
    """
    polyline, offset = tree.polyline_mm, tree.polyline_offset
    if polyline is None or offset is None:
        polyline = np.stack((tree.position_mm[tree.parent], tree.position_mm), axis=1).reshape(-1, 3)[2:]
        offset = np.concatenate(([0], 2 * np.arange(tree.n_nodes)))
    n_pieces = np.maximum(np.diff(offset) - 1, 0)
    thickest = 1 + np.argsort(-tree.radius_mm[1:], kind="stable")
    kept = thickest[np.cumsum(n_pieces[thickest]) <= max_pieces]
    segment = np.repeat(kept, n_pieces[kept])
    within = np.arange(segment.size) - np.repeat(np.cumsum(n_pieces[kept]) - n_pieces[kept], n_pieces[kept])
    first = offset[segment] + within
    return Tubes(
        series=series,
        start_mm=polyline[first],
        end_mm=polyline[first + 1],
        radius_mm=tree.radius_mm[segment],
        segment=segment,
        n_segments_left_out=tree.n_segments - kept.size,
        thinnest_drawn_mm=float(tree.radius_mm[kept].min()) if kept.size else 0.0,
    )


def mask_surface(volume: Any, *, max_triangles: int = MAX_TRIANGLES) -> Surface | None:
    """The surface of a mask in its world frame, smoothed and simplified to about ``max_triangles``.

    ``volume`` is a :class:`vascval.io.volumes.Volume` whose values are true or non-zero inside. Marching cubes at half
    height; stairs are taken off by a Taubin filter (which does not shrink), then quadric decimation. A surface beyond
    1.5 million triangles is taken from blocks of voxels, a block counting as inside when any of its voxels is, so that
    no thin vessel is lost. ``None`` when the mask is empty.
    """
    from pyvista import PolyData
    from skimage.measure import marching_cubes

    mask = np.asarray(volume.values) != 0
    if not mask.any():
        return None
    low, high = _bounds(mask)
    mask = mask[tuple(slice(a, b) for a, b in zip(low, high))]
    block = 1
    while 2 * _n_faces(np.pad(mask, 1)) > _MAX_RAW_TRIANGLES:
        mask, block = _coarser(mask), 2 * block
    corners, triangles, _, _ = marching_cubes(np.pad(mask, 1).astype("float32"), 0.5)
    index_zyx = (corners - 1.0) * block + (block - 1) / 2.0 + low
    mesh = PolyData.from_regular_faces(volume.to_world(index_zyx[:, ::-1].astype("float64")), triangles)
    mesh = mesh.smooth_taubin(n_iter=20, pass_band=0.1)
    every = block * volume.meta.get("block", 1)
    note = f"every {every} voxels" if every > 1 else "at full resolution"
    if mesh.n_cells > max_triangles:
        note += f", simplified from {count(mesh.n_cells)} to about {count(max_triangles)} triangles"
        mesh = mesh.decimate(1.0 - max_triangles / mesh.n_cells)
    voxel = block * float(np.max(volume.spacing_mm))
    points, faces = np.asarray(mesh.points, dtype="float64"), np.asarray(mesh.regular_faces, dtype="int64")
    return Surface(points, faces, voxel, note)


def _bounds(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    spans = []
    for axis in range(mask.ndim):
        hit = np.flatnonzero(mask.any(axis=tuple(a for a in range(mask.ndim) if a != axis)))
        spans.append((hit[0], hit[-1] + 1))
    low, high = np.array(spans).T
    return low, high


def _n_faces(mask: np.ndarray) -> int:
    return sum(int(np.count_nonzero(np.diff(mask, axis=axis))) for axis in range(mask.ndim))


def _coarser(mask: np.ndarray) -> np.ndarray:
    padded = np.pad(mask, [(0, n % 2) for n in mask.shape])
    z, y, x = (n // 2 for n in padded.shape)
    coarse: Any = padded.reshape(z, 2, y, 2, x, 2).any(axis=(1, 3, 5))
    return np.asarray(coarse)


def bounds_mm(surface: Surface | None, layers: Sequence[Tubes]) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner (3,), (3,) of everything that is drawn; a unit cube about 0 when nothing is."""
    points = [layer.start_mm for layer in layers] + [layer.end_mm for layer in layers]
    points += [surface.points_mm] if surface is not None else []
    points = [p for p in points if len(p)]
    if not points:
        return np.full(3, -0.5), np.full(3, 0.5)
    return np.min([p.min(axis=0) for p in points], axis=0), np.max([p.max(axis=0) for p in points], axis=0)


_VIEWS = (
    # forward, up, in words: x is to the right, except in the side view
    ((-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), "seen along \N{MINUS SIGN}x, y to the right, z up"),
    ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), "seen along +y, x to the right, z up"),
    ((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), "seen along \N{MINUS SIGN}z, x to the right, y up"),
)


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """A parallel view: ``axes`` (3, 3) rows right, up, towards the viewer; the region shown; the view in words."""

    axes: np.ndarray
    centre_mm: np.ndarray
    half_width_mm: float
    half_height_mm: float
    words: str


def viewpoint(low_mm: np.ndarray, high_mm: np.ndarray) -> Viewpoint:
    """The view along the axis in which the scene is flattest (y, the front view of an LPS image, when in doubt)."""
    extent = high_mm - low_mm
    axis = 1 if extent[1] <= 1.1 * extent.min() else int(np.argmin(extent))
    forward, up, words = _VIEWS[axis]
    right = np.cross(forward, up)
    axes = np.array((right, up, -np.array(forward)))
    half = np.abs(axes @ extent) / 2.0
    margin = 1.04
    return Viewpoint(axes, (low_mm + high_mm) / 2.0, margin * max(half[0], 1e-6), margin * max(half[1], 1e-6), words)


def scale_bar_mm(width_mm: float) -> float:
    """A round length (1, 2 or 5 times a power of ten) of at most a quarter of ``width_mm``."""
    target = width_mm / 4.0
    power = 10.0 ** np.floor(np.log10(target))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= target * (1 + 1e-12)))
