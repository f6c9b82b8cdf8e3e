"""The best of all topologies of a small tree, by branch and bound: an oracle for searches.

A bifurcating tree of N terminals has (2N - 3)!! topologies: each comes about in exactly one way when the terminals are
joined one after the other, each on one of the segments that are there. A branch of that search is cut off where a bound
shows that none of its trees can be better than the best one known.

**The bound.** Let ``W`` be the volume over pi of a subtree that spends the pressure 1 on a terminal flow of 1
(``kappa = 1``); where it spends ``p`` it is ``W / sqrt(p)``. A segment with ``n`` terminals below, length ``l`` and
subtrees at its end, spending ``p`` itself and leaving ``1 - p``, has the squared radius ``sqrt(n l / p)``, hence ::

    W = sqrt(n) l^(3/2) / sqrt(p) + (sum of W_c) / sqrt(1 - p)

since all children begin at the same pressure and all terminals end at the same one. Murray's law sets ``p``. Whatever
it says, by Hoelder's inequality ``X / sqrt(p) + Y / sqrt(1 - p) >= (X^(2/3) + Y^(2/3))^(3/2)``. With
``y = W^(2/3)`` and by induction from the leaves, as the right-hand side rises with every ``W_c``, ::

    y_i >= n_i^(1/3) l_i + (sum over children c of y_c^(3/2))^(2/3)

Call ``y`` the value with equality throughout. It rises with every length, every ``n`` and every further child; cutting
a terminal off and joining the two segments at its bifurcation, which shortens by the triangle inequality, makes it no
larger. So the least ``y`` over all places of the bifurcations of a tree of the first k terminals bounds all trees that
come from it, and ``pi sqrt(kappa Q_term / dp) y^(3/2)`` bounds their volume, ``Q_term`` being the flow of a terminal
of the whole tree.

**The least y** need not be found, only bounded. As a sum and composition of norms ``y`` is convex in the positions,
and so it is with the lengths ``sqrt(d^2 + eps^2) - eps <= d``. Projecting on the convex hull of root and terminals
shortens all lengths, so that the least value is taken there; from any point ``x`` with gradient ``g`` it is at least
``y(x)`` minus the sum over nodes of the largest ``g . (x - c)`` over the corners ``c`` of the hull.

**What is not proven**: the geometry of each topology that is not cut off is optimised locally, from the least ``y``;
that of the best ones once more, with terminals held at their shortest length by multipliers.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from generator.geometry.optimise import optimise
from generator.geometry.problem import Physics, Problem
from generator.growth.root_tree import RootTree
from generator.haemodynamics import Perfusion, perfused_tree
from generator.topology import _exhaustive_kernels as kernels
from generator.topology._relax_kernels import polish
from generator.topology.state import SHORTEST_MM, SearchTree
from vascval.core.errors import ComputationError, InputError
from vascval.core.tree import Topology, Tree

Observer = Callable[[str, float, float], None]
MOST = 10
"""Terminals beyond which the search is refused; each takes about ten times longer than the one before."""
_SAME = 1e-9
_CLOSE = 1e-3
"""Trees within this of the least volume are optimised once more."""


@dataclass(frozen=True)
class Optimum:
    """The best tree, how many topologies there are, how many partial ones were bounded, how many trees optimised."""

    tree: Tree
    n_topologies: int
    n_bounded: int
    n_optimised: int


def optimal_tree(
    root_mm: np.ndarray, terminals_mm: np.ndarray, perfusion: Perfusion, observer: Observer | None = None
) -> Optimum:
    """The tree of least volume from the root (3,) to 2 to 10 terminals (N, 3), over all topologies.

    :param observer: called with ``"topologies"``, how many are optimised or cut off, and how many there are.
    :raises InputError: when there are fewer or more terminals, or points coincide.
    """
    terminals = np.asarray(terminals_mm, dtype=np.float64)
    root = np.asarray(root_mm, dtype=np.float64)
    if terminals.ndim != 2 or terminals.shape[1] != 3 or root.shape != (3,):
        shapes = f"{root.shape} and {terminals.shape}"
        raise InputError(f"root and terminals have shapes {shapes}; (3,) and (N, 3) are needed")
    if not 2 <= len(terminals) <= MOST:
        raise InputError(f"{len(terminals)} terminals: all topologies can be searched for 2 to {MOST}; use annealing")
    points = np.vstack((root, terminals))
    if not np.isfinite(points).all() or len(np.unique(points, axis=0)) < len(points):
        raise InputError("root and terminals must be finite and all different; mend or drop some")
    search = _Search(_far_apart_first(points), perfusion, observer or (lambda stage, done, total: None))
    up = np.full(2 * len(terminals), -1, np.int64)
    up[1] = 0
    search.extend(up, 1)
    tree = search.best_tree()
    return Optimum(tree, search.n_topologies, search.n_bounded, search.n_optimised)


def _far_apart_first(points: np.ndarray) -> np.ndarray:
    """The root, then always the point that is farthest from those before: bounds are strong early."""
    order, nearest = [0], ((points - points[0]) ** 2).sum(axis=1)
    while len(order) < len(points):
        order.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, ((points - points[order[-1]]) ** 2).sum(axis=1))
    return points[order]


class _Search:
    def __init__(self, points: np.ndarray, perfusion: Perfusion, observer: Observer) -> None:
        self.points, self.perfusion, self.observer = points, perfusion, observer
        self.size_mm = float(np.ptp(points, axis=0).max())
        self.root_tree = RootTree.point(points[0])
        n_terminals = len(points) - 1
        flow = perfusion.flow_mm3_s / n_terminals
        self.scale = np.pi * np.sqrt(perfusion.kappa_pa_s * flow / perfusion.pressure_drop_pa)
        self.found: list[tuple[float, np.ndarray, np.ndarray]] = []
        self.volume = np.inf
        self.n_bounded = self.n_optimised = self._n_decided = 0
        self.n_topologies = self._n_from(1)

    @property
    def enough(self) -> float:
        """The ``y`` from which on a tree cannot be better than the best."""
        return float(np.cbrt(self.volume * (1.0 - _SAME) / self.scale) ** 2)

    def extend(self, up: np.ndarray, grown: int) -> None:
        """All trees that come from one of ``grown`` terminals, the most promising first."""
        if grown == len(self.points) - 1:
            self.optimise(up)
            self._decide(1)
            return
        edges, bounds = kernels.bounds_of_insertions(up, self.points, grown, self.size_mm, self.enough)
        self.n_bounded += len(bounds)
        for cut, k in enumerate(np.argsort(bounds, kind="stable")):
            if bounds[k] >= self.enough:
                self._decide((len(bounds) - cut) * self._n_from(grown + 1))
                break
            further = up.copy()
            kernels.insert(further, len(self.points) - 1, grown, edges[k])
            self.extend(further, grown + 1)

    def _n_from(self, grown: int) -> int:
        """Topologies that come from one of ``grown`` terminals: a new segment goes to each of ``2 grown - 1``."""
        return math.prod(range(2 * grown - 1, 2 * len(self.points) - 4, 2))

    def _decide(self, n_more: int) -> None:
        self._n_decided += n_more
        self.observer("topologies", self._n_decided, self.n_topologies)

    def optimise(self, up: np.ndarray) -> None:
        """The volume of a whole tree; it is kept if it is the best."""
        n_terminals = len(self.points) - 1
        order, parent = np.empty(2 * n_terminals, np.int64), np.empty(2 * n_terminals, np.int32)
        kernels.root_first(up, n_terminals, n_terminals, order, parent)
        _, position = kernels.bound_of(parent, order, self.points, n_terminals, self.size_mm, np.inf)
        tree = SearchTree(parent, position, self.root_tree, self.perfusion)
        cost = polish(tree.state, tree.flat, 0.3 * self.size_mm, 1e-7 * self.size_mm, 1e-6)
        self.n_optimised += 1
        volume = tree.volume_mm3(cost)
        if volume < (1.0 + _CLOSE) * self.volume:
            self.volume = min(self.volume, volume)
            self.found.append((volume, *tree.arrays()))

    def best_tree(self) -> Tree:
        """The best of the trees that came close to the least volume, their geometry optimised once more."""
        close = [(parent, at) for volume, parent, at in self.found if volume < (1.0 + _CLOSE) * self.volume]
        trees = [settled(perfused_tree(Topology(parent), at, self.perfusion), self.perfusion) for parent, at in close]
        return min(trees, key=lambda tree: tree.volume_mm3)


def settled(tree: Tree, perfusion: Perfusion) -> Tree:
    """The tree with the geometry of the reduced-space optimum where there is one that is better: the search keeps
    terminals at their shortest length by pushing bifurcations back, which may stop short of it."""
    problem = Problem(tree.topology, tree.position_mm, perfusion, Physics(l_min_mm=SHORTEST_MM))
    try:
        solved = optimise(problem, contract=False, splitting=False).tree
    except ComputationError:
        return tree
    return min(tree, solved, key=lambda each: each.volume_mm3)
