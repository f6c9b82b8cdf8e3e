"""Trees that other programs wrote as VTK poly data: radii on points or cells, any unit, any lines."""

from __future__ import annotations

import re

import numpy as np

from vascval.core.errors import InputError
from vascval.core.units import MM_PER
from vascval.io import _graph_kernels as kernels
from vascval.io.assembly import Sketch, edge_radius
from vascval.io.length_units import guess_unit, unit_in_texts, unit_of_name
from vascval.io.paths import merged_edges, overlapping_paths
from vascval.io.polydata import PolyData

_RADIUS = ("radiusmm", "radiusum", "radiuscm", "radiusm", "radius", "radii", "maximuminscribedsphereradius", "misr")
_DIAMETER = ("diameter", "diameters", "diam", "thickness", "diametermm", "diameterum", "diametercm", "diameterm")


def sketch_of(data: PolyData, unit: str | None) -> tuple[Sketch, str]:
    """What the poly data say about a tree, in millimetres; and the unit that they were in.

    :param unit: the unit of positions and radii; guessed when None.
    :raises InputError: when no array looks like a radius or diameter.
    """
    guesses: list[str] = []
    name, place, radius = _radius(data, guesses)
    if unit is None:
        unit = unit_in_texts(data.texts) or unit_of_name(name)
    if unit is None:
        unit, why = guess_unit(data.points, radius, (*data.point_data, *data.cell_data))
        guesses.append(why)
    roots: list[int] = []
    edges, cell = _pieces(data)
    paths = overlapping_paths(data)
    if paths is not None:
        at_points = radius if place == "points" else _spread(edges, radius[cell], len(data.points))
        edges, root = merged_edges(paths, data.points, at_points)
        roots.append(root)
        guesses.append(f"{len(paths.offset) - 1} overlapping paths were merged; the root is where they all begin")
        of_edges = edge_radius(edges, at_points[edges])
    else:
        joined = _joined(data.points, edges, guesses)
        of_edges = edge_radius(joined, radius[edges]) if place == "points" else radius[cell]
        edges = joined
    scale = MM_PER[unit]
    return Sketch(data.points * scale, edges, of_edges * scale, roots, guesses), unit


def _radius(data: PolyData, guesses: list[str]) -> tuple[str, str, np.ndarray]:
    """Name and place ("cells" or "points") of the radius, and its values."""
    for wanted, factor in ((_RADIUS, 1.0), (_DIAMETER, 0.5)):
        for place, arrays in (("cells", data.cell_data), ("points", data.point_data)):
            known = {re.sub(r"[^a-z0-9]", "", name.lower()): name for name in arrays if arrays[name].ndim == 1}
            for plain in wanted:
                if plain in known:
                    name = known[plain]
                    if factor != 1.0:
                        guesses.append(f"array {name!r} on {place} is taken as the diameter and halved")
                    elif name != "radius":
                        guesses.append(f"array {name!r} on {place} is taken as the radius")
                    return name, place, arrays[name].astype(np.float64) * factor
    there = ", ".join(sorted({*data.cell_data, *data.point_data})) or "none"
    raise InputError(f"no array looks like a radius or diameter (arrays: {there}); name one of them 'radius'")


def _pieces(data: PolyData) -> tuple[np.ndarray, np.ndarray]:
    """(E, 2) pieces between successive points of each line, and the line of each."""
    size = np.diff(data.offsets)
    inside = np.ones(len(data.connectivity), dtype=bool)
    inside[data.offsets[1:][size > 0] - 1] = False
    at = np.flatnonzero(inside)
    if at.size == 0:
        raise InputError("its lines have a single point each; a tree needs lines between points")
    return np.stack((data.connectivity[at], data.connectivity[at + 1]), axis=1), np.repeat(
        np.arange(len(size)), np.maximum(size - 1, 0)
    )


def _joined(points: np.ndarray, edges: np.ndarray, guesses: list[str]) -> np.ndarray:
    """The edges with points at the same place made one, where the lines do not hang together without that."""
    used, edges_used = np.unique(edges, return_inverse=True)
    kept, _ = kernels.spanning_forest(edges_used.reshape(-1, 2), np.arange(len(edges)), used.size)
    if used.size - np.count_nonzero(kept) == 1:
        return edges
    same = same_place(points)
    joined = same[edges]
    moved = np.count_nonzero(same[used] != used)
    if moved:
        guesses.append(f"{moved} points at the same place as another were joined, as the lines share no points")
    return joined


def same_place(points: np.ndarray) -> np.ndarray:
    """(P,) the lowest point within a millionth of the extent of each, neighbours of neighbours included."""
    from scipy.spatial import cKDTree

    unique, first, inverse = np.unique(points, axis=0, return_index=True, return_inverse=True)
    near = cKDTree(unique).query_pairs(1e-6 * float(np.ptp(points, axis=0).max()), output_type="ndarray")
    pairs = first[near.reshape(-1, 2)]
    pairs.sort(axis=1)
    pairs = np.concatenate((pairs, np.stack((first[inverse.ravel()], np.arange(len(points))), axis=1)))
    _, component = kernels.spanning_forest(pairs.astype(np.int64), np.arange(len(pairs)), len(points))
    return component


def _spread(edges: np.ndarray, radius: np.ndarray, n_points: int) -> np.ndarray:
    """(P,) mean radius of the edges at each point."""
    ends = edges.ravel()
    count = np.maximum(np.bincount(ends, minlength=n_points), 1)
    return np.bincount(ends, weights=np.repeat(radius, 2), minlength=n_points) / count
