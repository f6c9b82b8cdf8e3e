"""Loops of the skeleton: which are loops of vessels, which of their vessels is opened, and what is left of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vascval.imaging import _graph_kernels as kernels
from vascval.imaging.graph import SkeletonGraph, rooted

PINHOLE_RADII = 3 * np.pi


@dataclass(frozen=True, eq=False)
class Loops:
    """``cuts`` (c, 2): the pairs of skeleton points at which a loop of vessels was opened; ``n_pinholes``: loops too
    small to be one; ``stub`` (u,): skeleton points at cuts that end a vessel of their own."""

    cuts: np.ndarray
    n_pinholes: int
    stub: np.ndarray


def open_loops(
    skeleton: SkeletonGraph,
    ends: np.ndarray,
    position_mm: np.ndarray,
    thickness_mm: np.ndarray,
    salience_mm: np.ndarray,
) -> tuple[SkeletonGraph, Loops]:
    """Tell loops of vessels from pinholes, open them at their thinnest vessel, and find what is left of that.

    A loop whose length is at most ``PINHOLE_RADII`` = 3 pi times the largest distance value on it goes round a hole
    narrower than half its vessel's radius: voxels that fail to meet in a crotch, or a pit through a wall. It is opened
    without being a finding. The arms of a true loop end at the cut; an arm that sticks out of its junction by its
    salience (:func:`vascval.imaging.tips.salience_mm`) stays as a branch, a lesser one is dropped.

    :param ends: tips of vessels among the skeleton points.
    :param position_mm: (k, 3); ``thickness_mm``, ``salience_mm`` (k,) distance map and salience at the skeleton points.
    :returns: the skeleton with the connections that stay, and its loops.
    """
    order, parent = rooted(skeleton, int(ends[0]))
    depth = kernels.climb(order, parent, np.zeros(order.size, dtype=bool), position_mm)[0]
    enough = PINHOLE_RADII * float(thickness_mm.max())
    u, v = np.ascontiguousarray(skeleton.cuts.T)
    length, widest = kernels.loop_sizes(parent, depth, u, v, position_mm, thickness_mm, enough)
    true = length > PINHOLE_RADII * widest
    opened = _at_thinnest(replace(skeleton, cuts=skeleton.cuts[true]), parent, ends, position_mm, thickness_mm)
    order, parent = rooted(opened, int(ends[0]))
    kept = kernels.mark_paths(parent, ends.astype(np.int32))
    _, base, way = kernels.climb(order, parent, kept, position_mm)
    cuts = opened.cuts
    sticks_out = way[cuts] > thickness_mm[base[cuts]] + salience_mm[cuts]
    return opened, Loops(cuts, int(true.size - true.sum()), np.unique(cuts[sticks_out]))


def _at_thinnest(
    skeleton: SkeletonGraph, parent: np.ndarray, ends: np.ndarray, position_mm: np.ndarray, thickness_mm: np.ndarray
) -> SkeletonGraph:
    """The skeleton with each loop opened at its thinnest vessel, and there at the thinnest place.

    The thinnest voxel of a loop tells little: of two vessels whose radii differ by a fraction of a voxel either may
    hold it. The vessels, the chains between junctions and ends, are therefore told apart by :func:`_vessel_mm`.
    """
    cuts, n = skeleton.cuts, parent.size
    if len(cuts) == 0:
        return skeleton
    kept = kernels.mark_paths(parent, np.append(ends, cuts).astype(np.int32)) & (parent >= 0)
    below = np.flatnonzero(kept)
    is_node = np.bincount(np.concatenate((below, parent[below], cuts.ravel())), minlength=n) != 2
    is_node[ends] = True
    near = np.flatnonzero(kernels.mark_paths(parent, cuts.ravel().astype(np.int32)) & (parent >= 0))
    a, b = np.concatenate((near, cuts[:, 0])), np.concatenate((parent[near], cuts[:, 1]))
    point, offset = kernels.chains(n, a, b, is_node)
    vessels = np.split(point, offset[1:-1])
    thick = np.array([_vessel_mm(position_mm[chain], thickness_mm[chain]) for chain in vessels])
    rank = np.argsort(-thick, kind="stable")
    stays = kernels.spanning(n, point[offset[:-1]], point[offset[1:] - 1], rank)
    known = np.sort(_codes(cuts, n))
    opened = np.array([_opening(vessels[c], thickness_mm, known, n) for c in np.flatnonzero(~stays)])
    gone, back = _codes(opened, n), ~np.isin(_codes(cuts, n), _codes(opened, n))
    edges = np.concatenate((skeleton.edges[~np.isin(_codes(skeleton.edges, n), gone)], cuts[back]))
    return replace(skeleton, edges=edges, cuts=opened)


def _codes(pair: np.ndarray, n: int) -> np.ndarray:
    """(p,) a number for each pair of ``n`` points, in whatever order."""
    return pair.min(axis=1).astype(np.int64) * n + pair.max(axis=1)


def _vessel_mm(position_mm: np.ndarray, thickness_mm: np.ndarray) -> float:
    """How thick the vessel of a chain is: the mean of the distance map outside the inscribed balls of its two ends.

    What does not come out of them is no vessel but the contact of two, as thick as its narrowest place.
    """
    clear = np.ones(thickness_mm.size, dtype=bool)
    for end in (0, -1):
        clear &= ((position_mm - position_mm[end]) ** 2).sum(axis=1) > thickness_mm[end] ** 2
    return float(thickness_mm[clear].mean() if clear.any() else thickness_mm.min())


def _opening(chain: np.ndarray, thickness_mm: np.ndarray, cuts: np.ndarray, n: int) -> np.ndarray:
    """The pair of neighbours on a chain at which it is opened: the cut that it holds, else the thinnest.

    :param cuts: (c,) sorted codes of the cuts that there are.
    """
    pairs = np.stack((chain[:-1], chain[1:]), axis=1)
    is_cut = np.isin(_codes(pairs, n), cuts)
    return pairs[np.argmax(is_cut) if is_cut.any() else np.argmin(thickness_mm[pairs].min(axis=1))]
