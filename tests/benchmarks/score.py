"""How well a found tree agrees with the tree that its image was made of.

Tips are matched by place; everything else by the tips below it: a true segment and a found segment are the same
vessel when the same matched tips lie below both.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from vascval.core.contraction import contract_degenerate
from vascval.core.ordering import element, strahler_order
from vascval.core.tree import Topology, Tree

from .phantoms import resampled

TOLERANCE_VOXELS = 5.0
"""A found tip belongs to a true tip when it is no farther from it than this."""

Clade = tuple[int, int]


@dataclass(frozen=True)
class Score:
    """Agreement of a found tree with the truth; fractions are of 1, not per cent, lengths in the finest voxel edge.

    * ``tips_found``: true tips with a found one of their own within the tolerance, as a fraction; ``tips_false``: found
      tips left over, as a fraction of the true ones; ``tip_offset``: mean distance of the pairs.
    * ``n_loops``: loops that had to be cut.
    * ``segments_matched``: fraction of the true segments with a found counterpart; over these: ``radius_error`` mean
      absolute, ``radius_bias`` mean relative deviation of the radius; ``length_bias`` mean relative deviation of the
      length, ``length_error`` its mean absolute, ``total_length_bias`` relative deviation of the summed length;
      ``centreline_offset`` mean distance of the found centrelines from the true ones.
    * ``junctions_found`` as a fraction, ``n_junctions_false``: a junction is found when a found node parts the same
      tips in the same way; ``junction_offset`` mean distance of the pairs. ``n_trifurcations`` in truth,
      ``trifurcations_found`` as a fraction (1 if there are none), ``n_trifurcations_false``: found nodes of three
      branches that are none in truth.
    * ``elements_found``, ``elements_true``: elements of each Strahler order, from order 1; ``elements_equal``; the
      largest relative deviation of an order, ``elements_deviation``, and that of the sum over all orders of the
      absolute deviations, ``elements_total_deviation``.
    """

    n_tips: int
    tips_found: float
    tips_false: float
    tip_offset: float
    n_loops: int
    segments_matched: float
    radius_error: float
    radius_bias: float
    length_error: float
    length_bias: float
    total_length_bias: float
    centreline_offset: float
    junctions_found: float
    n_junctions_false: int
    junction_offset: float
    n_trifurcations: int
    trifurcations_found: float
    n_trifurcations_false: int
    elements_true: tuple[int, ...]
    elements_found: tuple[int, ...]
    elements_equal: bool
    elements_deviation: float
    elements_total_deviation: float

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def score(
    found: Tree,
    truth: Tree,
    voxel_mm: float,
    *,
    image: Mapping[str, Any] | None = None,
    tolerance_voxels: float = TOLERANCE_VOXELS,
) -> Score:
    """Measure ``found`` against ``truth``, which is contracted first; ``voxel_mm`` is the finest voxel edge.

    :param image: the record of the skeletonisation, for its ``n_loops_cut`` (0 without).
    """
    truth = contract_degenerate(truth)
    true_tip, found_tip, offset = match_tips(found, truth, tolerance_voxels * voxel_mm)
    true_clade, found_clade = _clades(truth, true_tip), _clades(found, found_tip)
    pairs = _match_segments(truth, true_clade, found, found_clade)
    n_true = truth.topology.n_terminals
    return Score(
        n_tips=n_true,
        tips_found=len(offset) / n_true,
        tips_false=(found.topology.n_terminals - len(offset)) / n_true,
        tip_offset=float(offset.mean() / voxel_mm) if len(offset) else float("nan"),
        n_loops=int((image or {}).get("n_loops_cut", 0)),
        **_segment_scores(truth, found, pairs, voxel_mm),
        **_junction_scores(truth, true_clade, found, found_clade, voxel_mm),
        **_element_scores(truth, found),
    )


def match_tips(found: Tree, truth: Tree, tolerance_mm: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pair true and found terminals one to one, as many as possible within the tolerance, at least total distance.

    :returns: (N_true,) and (N_found,) number of the pair at each node, -1 elsewhere, and (P,) distances in mm. Pairs
        are numbered in such an order that those below any true segment are consecutive.
    """
    rank = _tip_rank(truth)
    tips = truth.topology.terminals[np.argsort(rank[truth.topology.terminals])]
    candidates = found.topology.terminals
    rows, columns = _assigned(truth.position_mm[tips], found.position_mm[candidates], tolerance_mm)
    true_tip, found_tip = np.full(truth.n_nodes, -1), np.full(found.n_nodes, -1)
    true_tip[tips[rows]] = np.arange(rows.size)
    found_tip[candidates[columns]] = np.arange(rows.size)
    return (
        true_tip,
        found_tip,
        np.linalg.norm(truth.position_mm[tips[rows]] - found.position_mm[candidates[columns]], axis=1),
    )


def _assigned(one: np.ndarray, other: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows of ``one`` (n, 3) and ``other`` (m, 3) that are paired, ascending in ``one``.

    Points farther apart than the tolerance are never paired, so that each cluster of near ones is a problem of its own.
    """
    near = cKDTree(one).sparse_distance_matrix(cKDTree(other), tolerance, output_type="coo_matrix")
    n, m = near.shape
    link = coo_matrix((np.ones(near.nnz), (near.row, near.col + n)), shape=(n + m, n + m))
    _, cluster = connected_components(link, directed=False)
    members = np.argsort(cluster, kind="stable")
    pairs = []
    for group in np.split(members, np.flatnonzero(np.diff(cluster[members])) + 1):
        rows, columns = group[group < n], group[group >= n] - n
        if rows.size and columns.size:
            distance = cdist(one[rows], other[columns])
            far = distance > tolerance
            a, b = linear_sum_assignment(np.where(far, 1e3 * tolerance, distance))
            pairs += [(rows[i], columns[j]) for i, j in zip(a, b) if not far[i, j]]
    paired = np.array(sorted(pairs), dtype=np.int64).reshape(-1, 2)
    return paired[:, 0], paired[:, 1]


def _tip_rank(tree: Tree) -> np.ndarray:
    """(N,) rank of each terminal in a walk that finishes one branch before it begins the next."""
    rank, n, stack = np.full(tree.n_nodes, -1), 0, [0]
    while stack:
        node = stack.pop()
        children = tree.topology.children(node)
        if children.size == 0:
            rank[node], n = n, n + 1
        stack.extend(children[::-1].tolist())
    return rank


def _clades(tree: Tree, tip: np.ndarray) -> list[Clade | None]:
    """The matched tips below each node, if they are consecutive: (first, last); None when there is none or a gap.

    In truth they always are; a found node whose tips have a gap has no counterpart (Day, 1985). Exact, O(N).
    """
    first = np.where(tip >= 0, tip, np.iinfo(np.int64).max)
    last, count = tip.copy(), (tip >= 0).astype(int)
    for node in range(tree.n_nodes - 1, 0, -1):
        up = tree.parent[node]
        first[up], last[up] = min(first[up], first[node]), max(last[up], last[node])
        count[up] += count[node]
    consecutive = (count > 0) & (last - first + 1 == count)
    return [(int(first[i]), int(last[i])) if consecutive[i] else None for i in range(tree.n_nodes)]


def _match_segments(
    truth: Tree, true_clade: list[Clade | None], found: Tree, found_clade: list[Clade | None]
) -> np.ndarray:
    """(K, 2) true and found index of the same vessels.

    Where a missed or a false tip makes several segments in a row bear the same tips, they are paired in order if they
    are as many on both sides, and not at all if not.
    """
    rows: tuple[dict[Clade, list[int]], ...] = (defaultdict(list), defaultdict(list))
    for row, clades in zip(rows, (true_clade, found_clade)):
        for i, clade in enumerate(clades):
            if i > 0 and clade is not None:
                row[clade].append(i)
    pairs = [pair for clade, t in rows[0].items() if len(t) == len(f := rows[1].get(clade, [])) for pair in zip(t, f)]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def _segment_scores(truth: Tree, found: Tree, pairs: np.ndarray, voxel_mm: float) -> dict[str, Any]:
    t, f = pairs.T
    names = ("radius_error", "radius_bias", "length_error", "length_bias", "total_length_bias", "centreline_offset")
    if t.size == 0:
        return {"segments_matched": 0.0, **dict.fromkeys(names, float("nan"))}
    radius = found.radius_mm[f] / truth.radius_mm[t] - 1.0
    length = found.length_mm[f] / truth.length_mm[t] - 1.0
    total = found.length_mm[f].sum() / truth.length_mm[t].sum() - 1.0
    on_truth = cKDTree(_sampled(truth, range(1, truth.n_nodes), 0.1 * voxel_mm))
    offset, _ = on_truth.query(_sampled(found, f, 0.5 * voxel_mm))
    values = (
        *(np.abs(radius).mean(), radius.mean()),
        *(np.abs(length).mean(), length.mean(), total),
        offset.mean() / voxel_mm,
    )
    return {"segments_matched": t.size / truth.n_segments, **{k: float(v) for k, v in zip(names, values)}}


def _sampled(tree: Tree, segments: Any, step_mm: float) -> np.ndarray:
    """(S, 3) points along the centrelines of the segments, no more than a step apart."""
    return np.concatenate([resampled(tree.polyline(int(i)), step_mm) for i in segments])


def _junctions(tree: Tree, clades: list[Clade | None]) -> dict[int, frozenset[Clade] | None]:
    """How each branching node parts the matched tips; None where a branch has no clade of its own."""
    parted: dict[int, frozenset[Clade] | None] = {}
    for node in np.flatnonzero(tree.topology.n_children > 1):
        below = [clades[child] for child in tree.topology.children(node)]
        whole = [clade for clade in below if clade is not None]
        parted[int(node)] = frozenset(whole) if len(whole) == len(below) else None
    return parted


def _junction_scores(
    truth: Tree, true_clade: list[Clade | None], found: Tree, found_clade: list[Clade | None], voxel_mm: float
) -> dict[str, Any]:
    true_parts, found_parts = _junctions(truth, true_clade), _junctions(found, found_clade)
    in_truth, in_found = set(true_parts.values()) - {None}, set(found_parts.values()) - {None}
    place = {part: found.position_mm[node] for node, part in found_parts.items()}
    apart = [np.linalg.norm(truth.position_mm[i] - place[part]) for i, part in true_parts.items() if part in in_found]
    three = [part for node, part in true_parts.items() if truth.topology.n_children[node] == 3]
    found_three = [part for node, part in found_parts.items() if found.topology.n_children[node] == 3]
    return {
        "junctions_found": sum(part in in_found for part in true_parts.values()) / max(1, len(true_parts)),
        "n_junctions_false": sum(part not in in_truth for part in found_parts.values()),
        "junction_offset": float(np.mean(apart) / voxel_mm) if apart else float("nan"),
        "n_trifurcations": len(three),
        "trifurcations_found": sum(part in in_found for part in three) / len(three) if three else 1.0,
        "n_trifurcations_false": sum(part not in in_truth for part in found_three),
    }


def _element_scores(truth: Tree, found: Tree) -> dict[str, Any]:
    a, b = elements_per_order(truth), elements_per_order(found)
    n = max(len(a), len(b))
    true, got = np.pad(a, (0, n - len(a))), np.pad(b, (0, n - len(b)))
    miss = np.abs(got - true)
    return {
        "elements_true": tuple(a.tolist()),
        "elements_found": tuple(b.tolist()),
        "elements_equal": bool((miss == 0).all()),
        "elements_deviation": float((miss / np.maximum(true, 1)).max()),
        "elements_total_deviation": float(miss.sum() / true.sum()),
    }


def restricted(tree: Tree, kept: np.ndarray) -> Tree:
    """The tree without what bears none of the ``kept`` (N,) nodes; without any, its root and first vessel."""
    below = kept.copy()
    below[:2] = True
    for node in range(tree.n_nodes - 1, 0, -1):
        below[tree.parent[node]] |= below[node]
    parent = (np.cumsum(below) - 1)[tree.parent[below]]
    parent[0] = -1
    return Tree(Topology(parent.astype(np.int32)), tree.position_mm[below], tree.radius_mm[below])


def elements_per_order(tree: Tree) -> np.ndarray:
    """(n_orders,) number of elements of each Strahler order, from order 1."""
    order = strahler_order(tree.topology)
    _, first = np.unique(element(tree.topology, order, tree.radius_mm)[1:], return_index=True)
    return np.bincount(order[1:][first])[1:]
