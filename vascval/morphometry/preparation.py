"""What is done to a tree before it is measured, the same for a cast and for a synthetic tree."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vascval.core.contraction import contract_degenerate
from vascval.core.tree import Topology, Tree
from vascval.core.validation import findings, require_valid

_MEASURABLE = frozenset({"single-child", "zero-length", "flow-balance", "pressure-rise"})


@dataclass(frozen=True)
class Prepared:
    """A tree ready to be measured: ``merged`` without single-child nodes, ``tree`` also without degenerate segments.

    ``n_merged`` nodes and ``n_contracted`` segments went; ``notes`` says so, and what else was found.
    """

    tree: Tree
    merged: Tree
    n_merged: int
    n_contracted: int
    notes: tuple[str, ...]


def prepare(tree: Tree, *, diameters: float = 1.0) -> Prepared:
    """Validate, merge chains of single children, contract degenerate segments.

    :param diameters: see :func:`vascval.core.contraction.contract_degenerate`.
    :raises InputError: on a tree without segments or with segments of radius 0.
    """
    require_valid(tree, allow=_MEASURABLE)
    notes = [f"input: {finding.message}" for finding in findings(tree)]
    merged = merge_chains(tree)
    contracted = contract_degenerate(merged, diameters=diameters)
    n_merged = tree.n_segments - merged.n_segments
    n_contracted = merged.n_segments - contracted.n_segments
    if n_merged:
        notes.append(f"{n_merged} nodes with a single child were merged into the segments that run through them")
    if n_contracted:
        notes.append(f"{n_contracted} inner segments shorter than {diameters:g} diameters were contracted")
    return Prepared(contracted, merged, n_merged, n_contracted, tuple(notes))


def merge_chains(tree: Tree) -> Tree:
    """The tree without inner nodes that have a single child: the segments that meet there become one.

    The merged centreline runs through the nodes left out. Its radius is the mean over the pieces, weighted by their
    length (unweighted where the whole has none). Values at nodes and flows are those of the distal end; columns that
    no longer hold (orders, lengths, pressure drops, spread of the radius) are dropped. A tree without such nodes is
    returned as it is.
    """
    through = tree.topology.n_children == 1
    through[0] = False
    if not through.any():
        return tree
    keep = np.flatnonzero(~through)
    new_index = np.cumsum(~through) - 1
    start = tree.parent.copy()  # where the merged segment that each node ends begins
    owner = np.arange(tree.n_nodes)  # the node that ends the merged segment which each segment is part of
    for i in range(1, tree.n_nodes):
        if through[start[i]]:
            start[i] = start[start[i]]
    for i in range(tree.n_nodes - 1, 0, -1):
        if through[tree.parent[i]]:
            owner[tree.parent[i]] = owner[i]
    points, offset = polylines(tree)
    order = np.lexsort((np.arange(1, tree.n_nodes), owner[1:])) + 1  # segments by owner, proximal first
    skip = through[tree.parent[order]]  # a piece that goes on repeats the point where the last one ended
    size = np.diff(offset)[order] - skip
    begin = np.concatenate(([0], np.cumsum(size)))
    take = np.arange(begin[-1]) + np.repeat(offset[order] + skip - begin[:-1], size)
    merged_size = np.bincount(owner[order], weights=size, minlength=tree.n_nodes)[keep].astype(np.int64)
    weight = np.where(_sum_by(owner, tree.length_mm)[owner] > 0, tree.length_mm, 1.0)
    radius = (_sum_by(owner, weight * tree.radius_mm) / np.maximum(_sum_by(owner, weight), 1e-300))[keep]
    return replace(
        tree,
        topology=Topology(np.concatenate(([-1], new_index[start[keep[1:]]]))),
        position_mm=tree.position_mm[keep],
        radius_mm=radius,
        columns={name: values[keep] for name, values in tree.columns.items() if name in _KEPT},
        polyline_mm=points[take],
        polyline_offset=np.concatenate(([0], np.cumsum(merged_size))),
    )


def _sum_by(owner: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Sum of the segments' ``values`` (N,) by owner; the placeholder at 0 is left out."""
    return np.bincount(owner[1:], weights=values[1:], minlength=owner.size)


_KEPT = {"flow_mm3_s", "pressure_pa"}


def polylines(tree: Tree) -> tuple[np.ndarray, np.ndarray]:
    """Centrelines of all segments, straight ones as two points: ``(M, 3)`` points and ``(N + 1,)`` offsets."""
    if tree.polyline_mm is not None and tree.polyline_offset is not None:
        return tree.polyline_mm, tree.polyline_offset
    n = tree.n_nodes
    points = np.empty((2 * (n - 1), 3))
    points[0::2] = tree.position_mm[tree.parent[1:]]
    points[1::2] = tree.position_mm[1:]
    return points, np.concatenate(([0], 2 * np.arange(n)))
