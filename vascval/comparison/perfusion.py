"""Which part of a cast lies in a perfusion volume, and where the cast enters it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vascval.comparison.location import Samples, sample_centrelines
from vascval.core.errors import InputError
from vascval.core.tree import Topology, Tree
from vascval.morphometry.preparation import polylines

Contains = Callable[[np.ndarray], np.ndarray]
"""From points (K, 3) in mm to whether each is inside (K,)."""

_STEPS = 1000
"""Points along the diagonal of a cast's bounding box."""


@dataclass(frozen=True)
class Shares:
    """How much of a tree is inside, from 0 to 1: of its length, of its vessels' volume, of its terminals."""

    length: float
    volume: float
    terminals: float


@dataclass(frozen=True, eq=False)
class Entry:
    """The part of a cast that a perfusion volume holds.

    * ``tree``: the cast from where it enters on; the cast itself if its root is inside;
    * ``cut``: whether something was cut off; ``at_wall``: whether the new root lies inside, where a vessel passes the
      wall. Otherwise the stem of ``tree`` ends outside, in front of the volume, and several of its branches enter.
    """

    tree: Tree
    cut: bool
    at_wall: bool


def shares_inside(tree: Tree, contains: Contains) -> Shares:
    """How much of ``tree`` is inside, from points along its centrelines."""
    samples = _samples(tree)
    inside = contains(samples.points)
    lumen = samples.length_mm * tree.radius_mm[samples.segment] ** 2
    ends = contains(tree.position_mm[tree.topology.terminals])
    length = samples.length_mm
    return Shares(
        float(length[inside].sum() / length.sum()), float(lumen[inside].sum() / lumen.sum()), float(ends.mean())
    )


def _samples(tree: Tree) -> Samples:
    """Points at most a thousandth of the tree's extent apart."""
    points, _ = polylines(tree)
    return sample_centrelines(tree, float(np.linalg.norm(np.ptp(points, axis=0))) / _STEPS)


def enter(tree: Tree, contains: Contains) -> Entry:
    """The cast from where it enters the volume on.

    Of all places where the tree could be cut, the one is taken beyond which length inside less length outside is
    most: vessels that lead there, and their branches elsewhere, are left out. Where the stem itself passes the wall it
    is cut there; a stem that forks in front of the volume is kept whole, so that its radius counts.

    :raises InputError: when the root is outside and no vessel is inside, or none branches.
    """
    if contains(tree.position_mm[:1])[0]:
        return Entry(tree, cut=False, at_wall=True)
    samples = _samples(tree)
    inside = contains(samples.points)
    if not inside.any():
        raise InputError("no vessel lies in the domain; check that both are in one world frame, in mm")
    gain = np.where(inside, samples.length_mm, -samples.length_mm)
    below = np.bincount(samples.segment, weights=gain, minlength=tree.n_nodes)
    whole = below.copy()
    for node in range(tree.n_nodes - 1, 0, -1):  # children come after their parents
        below[tree.parent[node]] += below[node]
    start, best = _best_suffix(samples, gain, inside, tree.n_nodes)
    branches = tree.topology.n_children > 0
    branches[0] = False
    if not branches.any():
        raise InputError("the cast has no branches; a tree of vessels is needed")
    stem = int(np.argmax(np.where(branches, below - whole + best, -np.inf)))
    at_wall = bool(start[stem] >= 0)
    kept = subtree(tree, stem, _arc_mm(samples, start[stem]) if at_wall else 0.0)
    return Entry(kept, cut=True, at_wall=at_wall)


def _best_suffix(samples: Samples, gain: np.ndarray, inside: np.ndarray, n_nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Of each segment, the sample inside from which on most is gained (-1 for none), and the gain (0 for none)."""
    start, best = np.full(n_nodes, -1), np.zeros(n_nodes)
    suffix = 0.0
    for k in range(len(gain) - 1, -1, -1):
        segment = samples.segment[k]
        last = k + 1 == len(gain) or samples.segment[k + 1] != segment
        suffix = gain[k] + (0.0 if last else suffix)
        if inside[k] and suffix > best[segment]:
            start[segment], best[segment] = k, suffix
    return start, best


def _arc_mm(samples: Samples, k: int) -> float:
    """How far along its segment a sample lies."""
    first = np.searchsorted(samples.segment, samples.segment[k])
    return float((k - first + 0.5) * samples.length_mm[k])


def subtree(tree: Tree, segment: int, from_mm: float = 0.0) -> Tree:
    """The segment, from ``from_mm`` along its centreline on, and all that it feeds. Columns are left out."""
    kept = np.zeros(tree.n_nodes, dtype=bool)
    kept[segment] = True
    for node in range(segment + 1, tree.n_nodes):
        kept[node] = kept[tree.parent[node]]
    nodes = np.flatnonzero(kept)
    new = np.full(tree.n_nodes, -1)
    new[nodes] = np.arange(1, nodes.size + 1)
    parent = np.concatenate(([-1], np.maximum(new[tree.parent[nodes]], 0)))
    points, offset = polylines(tree)
    lines = [points[offset[node] : offset[node + 1]] for node in nodes]
    lines[0] = _from(lines[0], from_mm)
    chosen = np.concatenate(([0], nodes))
    curved = tree.polyline_mm is not None
    return Tree(
        Topology(parent),
        np.concatenate((lines[0][:1], tree.position_mm[nodes])),
        tree.radius_mm[chosen],
        polyline_mm=np.concatenate(lines) if curved else None,
        polyline_offset=np.concatenate(([0, 0], np.cumsum([len(line) for line in lines]))) if curved else None,
        meta=tree.meta,
    )


def _from(line: np.ndarray, from_mm: float) -> np.ndarray:
    """A polyline without its first ``from_mm``."""
    arc = np.concatenate(([0.0], np.cumsum(np.sqrt((np.diff(line, axis=0) ** 2).sum(axis=1)))))
    if from_mm <= 0:
        return line
    begin = [np.interp(from_mm, arc, line[:, k]) for k in range(3)]
    return np.concatenate(([begin], line[arc > from_mm]))
