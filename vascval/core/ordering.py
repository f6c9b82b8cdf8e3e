"""Orders of a tree: root-first numbering, depth, subtree sums, Strahler orders, generations, elements."""

from __future__ import annotations

import numpy as np

from vascval.core import _ordering_kernels as kernels
from vascval.core.errors import ComputationError, InputError
from vascval.core.tree import NULL, Topology


def root_first(parent: np.ndarray) -> np.ndarray:
    """A numbering in which every node comes after its parent.

    :param parent: (N,) parent of each node in any numbering, -1 at the one root.
    :returns: (N,) the old index of each new node: breadth first, siblings in ascending old index.
    :raises InputError: when there is not exactly one root, or nodes hang on a cycle.
    """
    parent = np.asarray(parent)
    roots = np.flatnonzero(parent == NULL)
    if roots.size != 1:
        raise InputError(f"{roots.size} nodes have no parent (first: {roots[:3].tolist()}); a tree has one root")
    outside = np.flatnonzero((parent < NULL) | (parent >= parent.size))
    if outside.size:
        raise InputError(f"{outside.size} nodes have a parent that does not exist (first: node {outside[0]})")
    order = kernels.breadth_first(parent.astype(np.int64), int(roots[0]))
    if order.size < parent.size:
        lost = np.setdiff1d(np.arange(parent.size), order)
        raise InputError(
            f"{lost.size} nodes are unreachable from the root (first: node {lost[0]}); they lie on a cycle: cut it"
        )
    return order


def depth(topology: Topology) -> np.ndarray:
    """(N,) number of segments between the root and each node."""
    return kernels.depth(topology.parent)


def subtree_sum(topology: Topology, values: np.ndarray) -> np.ndarray:
    """(N,) sum of ``values`` (N,) over each node and all nodes below it."""
    return kernels.subtree_sum(topology.parent, np.asarray(values, dtype=np.float64))


def n_terminals_below(topology: Topology) -> np.ndarray:
    """(N,) number of terminals that each segment feeds; 1 at a terminal."""
    leaf = (topology.n_children == 0).astype(np.float64)
    return np.rint(subtree_sum(topology, leaf)).astype(np.int64)


def strahler_order(topology: Topology) -> np.ndarray:
    """(N,) int32 Strahler order of each segment.

    Terminals have order 1; a parent takes the largest order of its children, plus 1 if at least two children share
    that largest order (paper, Remark 1; Jiang 1994), so that children of orders (2, 2, 1) give 3. Entry 0 applies the
    rule to the segments that leave the root.
    """
    return kernels.strahler(topology.parent)


def root_order(topology: Topology, order: np.ndarray) -> int:
    """The order of the root segment; the largest among them if several leave the root, 0 without segments."""
    stems = topology.children(0)
    return int(order[stems].max()) if stems.size else 0


def generation(topology: Topology, order: np.ndarray | None = None) -> np.ndarray:
    """(N,) int32 generation of each segment: order of the root segment - order + 1 (paper, Remark 1).

    ``order`` defaults to the Strahler order; entry 0 is a placeholder, 0.
    """
    order = strahler_order(topology) if order is None else np.asarray(order)
    result = (root_order(topology, order) - order + 1).astype(np.int32)
    result[0] = 0
    return result


def diameter_defined_order(topology: Topology, diameter_mm: np.ndarray, *, max_iterations: int = 200) -> np.ndarray:
    """(N,) int32 diameter-defined Strahler order (Jiang, Kassab, Fung 1994).

    Starting from Strahler orders, a parent is one order above its largest child only if its diameter exceeds that
    order's upper bound. The bounds between neighbouring orders, from the mean ``D`` and standard deviation ``SD`` of
    the diameters of each order, are ``((D[n] + SD[n]) + (D[n+1] - SD[n+1])) / 2``; the first lower bound is 0, the
    last upper bound infinite. Diameters are classified anew by the bounds and the bounds computed anew by the
    classes, until fewer than 1 % of the vessels change.

    :param diameter_mm: (N,) diameter of each segment, entry 0 ignored.
    :raises ComputationError: when the orders still change after ``max_iterations``.
    """
    diameter = np.asarray(diameter_mm, dtype=np.float64)
    order = strahler_order(topology)
    if topology.n_segments == 0:
        return order
    for _ in range(max_iterations):
        upper = _upper_bounds(order[1:], diameter[1:])
        new = order.copy()
        new[1:] = np.searchsorted(upper, diameter[1:], side="left") + 1
        changed = np.count_nonzero(new[1:] != order[1:])
        order = _without_gaps(new)
        if changed < 0.01 * topology.n_segments:
            order[0] = root_order(topology, order)
            return order
    raise ComputationError(
        f"diameter-defined orders still change after {max_iterations} rounds (last: {changed} of "
        f"{topology.n_segments} segments); the diameters of neighbouring orders overlap too widely to be told apart"
    )


def _upper_bounds(order: np.ndarray, diameter: np.ndarray) -> np.ndarray:
    """(n_orders,) upper diameter bound of each order present (1..max, without gaps); the last is infinite."""
    n = int(order.max())
    count = np.bincount(order, minlength=n + 1)[1:]
    mean = np.bincount(order, weights=diameter, minlength=n + 1)[1:] / count
    square = np.bincount(order, weights=(diameter - mean[order - 1]) ** 2, minlength=n + 1)[1:]
    sd = np.sqrt(square / np.maximum(count - 1, 1))
    between = ((mean[:-1] + sd[:-1]) + (mean[1:] - sd[1:])) / 2
    return np.concatenate((np.maximum.accumulate(between), [np.inf]))


def _without_gaps(order: np.ndarray) -> np.ndarray:
    """Orders renumbered 1, 2, ... where a class came out empty; entry 0 is left as 0."""
    _, dense = np.unique(order[1:], return_inverse=True)
    return np.concatenate(([0], dense + 1)).astype(np.int32)


def element(topology: Topology, order: np.ndarray, radius_mm: np.ndarray) -> np.ndarray:
    """(N,) int32 index of the element of each segment, numbered root first; entry 0 is -1.

    An element is a run of segments of equal order in series. Where several children have their parent's order
    (possible for diameter-defined orders only), the thickest goes on and the others begin elements of their own.
    """
    return kernels.element(topology.parent, np.asarray(order, dtype=np.int32), np.asarray(radius_mm, dtype=np.float64))
