"""Contraction of degenerate segments: junctions closer than the vessel is thick are one junction.

The paper's rule (section 2.3.1) deletes a non-terminal segment shorter than its diameter, which makes trifurcations.
The generator and the analysis of casts both use this function, so that a difference in trifurcations is a difference
of the trees.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vascval.core import _contraction_kernels as kernels
from vascval.core.errors import InputError
from vascval.core.tree import Topology, Tree


def degenerate_segments(tree: Tree, *, diameters: float = 1.0) -> np.ndarray:
    """Indices of the segments that :func:`contract_degenerate` removes, ascending.

    A segment is degenerate when it joins two junctions and its chord is shorter than ``diameters`` times its diameter.
    Neither terminals nor a stem that springs alone from the root point qualify: they end where there is no junction.
    Segments are judged root first, each from where its proximal junction has moved to, so that a row of side branches
    on a thick trunk does not collapse into one point.

    :raises InputError: when ``diameters`` is negative or not finite.
    """
    if not (np.isfinite(diameters) and diameters >= 0):
        raise InputError(f"diameters is {diameters}; a number of diameters of 0 or more is needed")
    removed, _ = kernels.degenerate(
        tree.parent, tree.topology.n_children, tree.position_mm, 2.0 * diameters * tree.radius_mm
    )
    return np.flatnonzero(removed)


def contract_degenerate(tree: Tree, *, diameters: float = 1.0) -> Tree:
    """The tree without its degenerate segments: their children spring from the proximal junction instead.

    Radii, flows and other segment columns of the segments that stay are kept; a curved centreline of a moved child
    begins at the new junction. Orders and other derived columns (``order``, ``generation``, ``element``, ``parent``,
    ``diameter_order``, ``length_mm``, ``pressure_drop_pa``) no longer hold and are dropped if anything was contracted.
    A tree without degenerate segments is returned as it is.
    """
    gone = degenerate_segments(tree, diameters=diameters)
    if gone.size == 0:
        return tree
    removed, proximal = kernels.degenerate(
        tree.parent, tree.topology.n_children, tree.position_mm, 2.0 * diameters * tree.radius_mm
    )
    keep = np.flatnonzero(~removed)
    new_index = np.cumsum(~removed) - 1
    parent = np.concatenate(([-1], new_index[proximal[keep[1:]]]))
    columns = {name: values[keep] for name, values in tree.columns.items() if name not in _DERIVED}
    polyline, offset = _moved_polylines(tree, keep, proximal)
    return replace(
        tree,
        topology=Topology(parent),
        position_mm=tree.position_mm[keep],
        radius_mm=tree.radius_mm[keep],
        columns=columns,
        polyline_mm=polyline,
        polyline_offset=offset,
    )


_DERIVED = {"order", "generation", "element", "parent", "diameter_order", "length_mm", "pressure_drop_pa"}


def _moved_polylines(tree: Tree, keep: np.ndarray, proximal: np.ndarray) -> tuple[np.ndarray | None, np.ndarray | None]:
    if tree.polyline_mm is None or tree.polyline_offset is None:
        return None, None
    begin, size = tree.polyline_offset[keep], np.diff(tree.polyline_offset)[keep]
    offset = np.concatenate(([0], np.cumsum(size)))
    take = np.arange(offset[-1]) + np.repeat(begin - offset[:-1], size)
    points = tree.polyline_mm[take].copy()
    points[offset[1:-1]] = tree.position_mm[proximal[keep[1:]]]
    return points, offset
