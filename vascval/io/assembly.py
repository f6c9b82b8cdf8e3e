"""From points and the pieces between them to one rooted tree.

What other programs write is seldom a tree: pieces of length 0, several trees in one file, loops, points along a vessel
that are no branch points. All of it is mended here, each time with a sentence in ``meta["guesses"]``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from vascval.core.errors import InputError
from vascval.core.ordering import root_first
from vascval.core.tree import Topology, Tree
from vascval.io import _graph_kernels as kernels

Keep = Literal["largest", "error"]
_FARTHEST_MM = 1e9


@dataclass(frozen=True)
class Sketch:
    """What a file says: ``points_mm`` (P, 3), ``edges`` (E, 2) between them, ``radius_mm`` (E,) of the edges, the
    points in ``roots`` that it calls roots, and ``guesses`` made so far."""

    points_mm: np.ndarray
    edges: np.ndarray
    radius_mm: np.ndarray
    roots: Sequence[int] = ()
    guesses: Sequence[str] = field(default_factory=tuple)


def edge_radius(edges: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """(E,) radii of edges (E, 2) from the radii (E, 2) at their ends: the mean of both.

    At a branching point (three or more edges) the radius is that of the thickest vessel there, or of the space
    between them: it is left out, and where both ends are such points the smaller value counts.

    :raises InputError: when a radius is negative or not finite.
    """
    _require_radii(radius.ravel(), "points")
    branching = (np.bincount(edges.ravel()) >= 3)[edges]
    alone = np.where(branching[:, 0], radius[:, 1], radius[:, 0])
    mixed = np.where(branching.any(axis=1), alone, radius.mean(axis=1))
    return np.where(branching.all(axis=1), radius.min(axis=1), mixed)


def assemble(sketch: Sketch, *, keep: Keep = "largest", meta: dict[str, Any] | None = None) -> Tree:
    """The rooted tree: the largest component, loops opened at their thinnest edge, pieces of length 0 contracted,
    oriented away from the root, runs without a branch merged into one segment with a curved centreline.

    The radius of a merged run is the length-weighted mean of its pieces. The root is the one that the file names, else
    the end of the thickest stem. Nodes keep the order of the file wherever that puts parents first.

    :param keep: what to do with several components: ``"largest"`` by length, or ``"error"``.
    :raises InputError: when there are no edges, or several components and ``keep="error"``.
    """
    guesses = list(sketch.guesses)
    sketch = replace(sketch, guesses=guesses)
    _require_radii(sketch.radius_mm, "pieces")
    require_near(sketch.points_mm, sketch.radius_mm)
    sketch = _without_doubles(sketch)
    sketch = _largest(sketch, keep)
    sketch = _without_loops(sketch)
    sketch = replace(sketch, roots=[_root(sketch)])
    sketch = _without_zero_length(sketch)
    return _tree(sketch, sketch.roots[0], {**(meta or {}), "guesses": guesses})


def _require_radii(radius: np.ndarray, what: str) -> None:
    bad = ~np.isfinite(radius) | (radius < 0)
    if bad.any():
        raise InputError(f"{what} have a radius that is negative or not finite (first: {radius[bad][0]}); mend them")


def require_near(points_mm: np.ndarray, radius_mm: np.ndarray) -> None:
    """Refuses sizes that no vessel has; squares of them would overflow."""
    largest = max(float(np.abs(values).max(initial=0.0)) for values in (points_mm, radius_mm))
    if largest > _FARTHEST_MM:
        raise InputError(f"has a position or radius of {largest:.3g} mm, which no vessel has; mend it or give the unit")


def _lengths(sketch: Sketch) -> np.ndarray:
    step = sketch.points_mm[sketch.edges[:, 1]] - sketch.points_mm[sketch.edges[:, 0]]
    return np.sqrt((step**2).sum(axis=1))


def _note(sketch: Sketch, sentence: str) -> None:
    sketch.guesses.append(sentence)  # type: ignore[attr-defined]


def _merged(sketch: Sketch, same: np.ndarray) -> Sketch:
    """The sketch with point ``i`` replaced by point ``same[i]``, unused points and double or empty edges dropped."""
    edges = np.sort(same[sketch.edges], axis=1)
    thick_first = np.lexsort((np.arange(len(edges)), -sketch.radius_mm))
    pair = edges[:, 0].astype(np.int64) * len(same) + edges[:, 1]
    _, first = np.unique(pair[thick_first], return_index=True)
    chosen = np.sort(thick_first[first])
    chosen = chosen[edges[chosen, 0] != edges[chosen, 1]]
    return _subset(replace(sketch, edges=same[sketch.edges], roots=[int(same[i]) for i in sketch.roots]), chosen)


def _subset(sketch: Sketch, chosen: np.ndarray) -> Sketch:
    """The sketch with these edges and the points they use, both in their old order."""
    edges = sketch.edges[chosen]
    used = np.unique(edges)
    new = np.full(len(sketch.points_mm), -1, dtype=np.int64)
    new[used] = np.arange(used.size)
    return replace(
        sketch,
        points_mm=sketch.points_mm[used],
        edges=new[edges],
        radius_mm=sketch.radius_mm[chosen],
        roots=[int(new[i]) for i in sketch.roots if new[i] >= 0],
    )


def _without_doubles(sketch: Sketch) -> Sketch:
    result = _merged(sketch, np.arange(len(sketch.points_mm)))
    if not _lengths(result).any():
        raise InputError("there is no piece of vessel with a length; a tree needs lines between different points")
    if len(result.edges) < len(sketch.edges):
        dropped = len(sketch.edges) - len(result.edges)
        _note(sketch, f"{dropped} pieces that join the same points as another, or one point to itself, were dropped")
    return result


def _without_zero_length(sketch: Sketch) -> Sketch:
    empty = np.flatnonzero(_lengths(sketch) == 0)
    if empty.size == 0:
        return sketch
    _, same = kernels.spanning_forest(sketch.edges, empty, len(sketch.points_mm))
    _note(sketch, f"{empty.size} pieces of length 0 were contracted")
    return _merged(sketch, same)


def _largest(sketch: Sketch, keep: Keep) -> Sketch:
    everything = np.arange(len(sketch.edges))
    _, component = kernels.spanning_forest(sketch.edges, everything, len(sketch.points_mm))
    of_edge = component[sketch.edges[:, 0]]
    length = _lengths(sketch)
    total = np.bincount(of_edge, weights=length)
    names = np.unique(of_edge)
    if names.size == 1:
        return sketch
    best = int(names[np.argmax(total[names])])
    rest = sorted((float(total[name]) for name in names if name != best), reverse=True)
    shown = ", ".join(f"{value:.4g}" for value in rest[:5]) + (", ..." if len(rest) > 5 else "")
    if keep == "error":
        raise InputError(
            f"holds {names.size} separate trees ({total[best]:.4g} mm, {shown} mm long); "
            "pass keep='largest' to drop all but the longest"
        )
    _note(
        sketch,
        f"kept the longest of {names.size} separate trees ({total[best]:.4g} mm of {total.sum():.4g} mm); "
        f"dropped: {shown} mm",
    )
    return _subset(sketch, np.flatnonzero(of_edge == best))


def _without_loops(sketch: Sketch) -> Sketch:
    thick_first = np.lexsort((np.arange(len(sketch.edges)), _lengths(sketch), -sketch.radius_mm))
    kept, _ = kernels.spanning_forest(sketch.edges, thick_first, len(sketch.points_mm))
    cut = np.flatnonzero(~kept)
    if cut.size == 0:
        return sketch
    middle = sketch.points_mm[sketch.edges[cut[:5]]].mean(axis=1)
    places = "; ".join("({:.4g}, {:.4g}, {:.4g})".format(*point) for point in middle)
    more = " and more" if cut.size > 5 else ""
    _note(sketch, f"{cut.size} loops were opened at their thinnest piece, at {places}{more} mm")
    return _subset(sketch, np.flatnonzero(kept))


def _adjacency(edges: np.ndarray, n_points: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Offsets, neighbours and the edges to them for each point, in ascending order of the edges."""
    ends = np.concatenate((edges[:, 0], edges[:, 1]))
    others = np.concatenate((edges[:, 1], edges[:, 0]))
    via = np.tile(np.arange(len(edges)), 2)
    order = np.lexsort((via, ends))
    offset = np.concatenate(([0], np.cumsum(np.bincount(ends, minlength=n_points))))
    return offset, others[order], via[order]


def _root(sketch: Sketch) -> int:
    named = sorted(set(sketch.roots))
    if len(named) == 1:
        return named[0]
    adjacency = _adjacency(sketch.edges, len(sketch.points_mm))
    stem = kernels.stems(*adjacency, sketch.radius_mm, _lengths(sketch))
    tips = np.flatnonzero(stem >= 0)
    last = sketch.radius_mm[adjacency[2][adjacency[0][tips]]]
    root = int(tips[np.lexsort((tips, -last, -stem[tips]))[0]])
    place = ", ".join(f"{value:.4g}" for value in sketch.points_mm[root])
    why = f"the file names {len(named)} roots" if named else "the file names no root"
    _note(
        sketch,
        f"{why}; taken is the end of the thickest stem, at ({place}) mm with a mean radius of {stem[root]:.4g} mm",
    )
    return root


def _tree(sketch: Sketch, root: int, meta: dict[str, Any]) -> Tree:
    n = len(sketch.points_mm)
    order, parent, edge = kernels.orient(*_adjacency(sketch.edges, n), root)
    n_children = np.bincount(parent[order[1:]], minlength=n)
    kept = n_children != 1
    kept[root] = True
    nodes = np.flatnonzero(kept)
    ends = nodes[nodes != root]
    start, size, radius = kernels.chains(ends, parent, edge, kept, sketch.radius_mm, _lengths(sketch))
    position = np.empty(n, dtype=np.int64)  # of a kept point among the kept ones, the root being put first
    position[np.concatenate(([root], ends))] = np.arange(nodes.size)
    above = np.concatenate(([-1], position[start]))
    if (above >= np.arange(nodes.size)).any():
        new = root_first(above)
        back = np.empty_like(new)
        back[new] = np.arange(new.size)
        above = np.concatenate(([-1], back[above[new[1:]]]))
        ends, size, radius = ends[new[1:] - 1], size[new[1:] - 1], radius[new[1:] - 1]
    offset = np.concatenate(([0], np.cumsum(size)))
    straight = bool((size == 2).all())
    return Tree(
        topology=Topology(above),
        position_mm=sketch.points_mm[np.concatenate(([root], ends))],
        radius_mm=np.concatenate(([0.0], radius)),
        polyline_mm=None if straight else sketch.points_mm[kernels.chain_points(ends, parent, offset)],
        polyline_offset=None if straight else np.concatenate(([0], offset)),
        meta=meta,
    )
