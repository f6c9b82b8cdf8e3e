"""What an optimised tree may not do: leave the domain, or run through itself where growth was asked to avoid it.

The cost knows neither. Where segments leave the domain, the tree is optimised once more with the wall there as planes
(:mod:`generator.geometry.walls`), until none does. What still offends is mended from the start, a tree that is
admissible: each node goes as far towards its optimum as it may. Nodes of offending segments go back, half of the way
again and again, until nothing offends; then the others are optimised once more with those held, and so on. Where every
node is back, the tree is the one that it began with, so that this always ends in an admissible tree. Then all are
released and it begins anew from there, while that pays. It is a heuristic: what it ends in need not be the constrained
optimum.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from generator._domain_kernels import inside_along
from generator.domain import Domain
from generator.geometry import _clearance_kernels as kernels
from generator.geometry.problem import Problem, Solution
from generator.geometry.reduced_model import COINCIDENT_MM, evaluate
from generator.geometry.walls import walls_met
from vascval.core.errors import ComputationError
from vascval.core.tree import Tree

_PLANES = 20
"""Rounds of planes at the most."""
_SWEEPS = 10
_ROUNDS = 10
_HALVINGS = 6
_WORTH = 1e-4
"""Smallest relative gain of a sweep for which there is another."""


@dataclass(frozen=True)
class Admission:
    """``domain``: where every segment lies, ``None``: anywhere; ``apart``: vessels without a common node keep apart by
    this times the sum of their radii, 0: they may overlap."""

    domain: Domain | None = None
    apart: float = 0.0

    @property
    def always(self) -> bool:
        """Whether there is nothing to mend: without bounds on lengths, which may not fit in, a node's optimum lies in
        the convex hull of its neighbours."""
        return self.apart == 0.0 and (self.domain is None or self.domain.space.convex)

    def offending(self, problem: Problem, tree: Tree) -> np.ndarray:
        """(N,) bool: free segments that are not wholly inside or overlap another; the root tree may lie outside."""
        marked = np.zeros(tree.n_nodes, dtype=bool)
        if self.domain is not None:
            marked[1:] = ~inside_along(self.domain.space, tree.position_mm[tree.parent[1:]], tree.position_mm[1:])
        if self.apart > 0.0:
            start, end = tree.position_mm[tree.parent], tree.position_mm
            start = np.vstack((end[:1], start[1:]))
            wide = self.apart * tree.radius_mm[:, None]
            low, high = np.minimum(start, end) - wide, np.maximum(start, end) + wide
            order = 1 + np.argsort(low[1:, 0], kind="stable")
            kernels.mark_overlapping(
                tree.parent, tree.position_mm, tree.radius_mm, self.apart, order, low, high, marked
            )
        return marked & problem.free


def begun(problem: Problem, pull: np.ndarray | None = None) -> Solution:
    """The problem where it begins, also with nodes in one place, as a search of topologies may leave them."""
    return evaluate(problem, eps=COINCIDENT_MM, pull=pull)


def admitted(problem: Problem, admission: Admission, solve: Callable[[Problem], Solution]) -> Solution:
    """The optimum of ``problem`` as far as it is admissible.

    :raises ComputationError: when the tree at the start offends elsewhere.
    """
    if admission.always:
        return solve(problem)
    longer = _lengthened(problem)
    if not admission.offending(longer, begun(longer).tree).any():
        problem = longer
    begin = begun(problem)
    bad = np.flatnonzero(admission.offending(problem, begin.tree))
    if bad.size:
        raise ComputationError(
            f"{bad.size} segments leave the domain or overlap others before the geometry is optimised (first: segment "
            f"{bad[0]}); grow the tree inside the domain, without intersections if they are to be avoided"
        )
    solve = partial(_within_walls, admission=admission, solve=solve)
    optimum = solve(problem)
    if optimum.cost_mm3 <= begin.cost_mm3 and not admission.offending(problem, optimum.tree).any():
        return optimum
    best, steps = begin, 0
    for sweep in range(_SWEEPS):
        if sweep > 0:
            optimum = solve(replace(problem, position_mm=best.position_mm, pull=best.pull, walls=None))
        found = _sweep(problem.at(best.position_mm), optimum, admission, solve)
        steps += found.n_iterations
        gain = 1.0 - found.cost_mm3 / best.cost_mm3
        if gain > 0.0:
            best = found
        if gain < _WORTH:
            break
    return replace(best, problem=problem, n_iterations=steps)


def _lengthened(problem: Problem) -> Problem:
    """The problem begun with stems of half the bound at least: other nodes go towards their farthest branch.

    A search of topologies may put a bifurcation where the root tree ends; nodes that go back to where they began would
    leave it there.
    """
    position, limit = problem.position_mm.copy(), problem.physics.l_min_mm
    for stem in problem.stems[problem.lengths(position)[problem.stems] < 0.5 * limit]:
        branches = problem.topology.children(int(stem))
        if branches.size and problem.moves[stem]:
            root = position[problem.topology.parent[stem]]
            away = np.linalg.norm(position[branches] - root, axis=1)
            part = min(0.5, 1.001 * limit / away.max())
            position[stem] = root + part * (position[branches[away.argmax()]] - root)
    return problem.at(position)


def _within_walls(problem: Problem, *, admission: Admission, solve: Callable[[Problem], Solution]) -> Solution:
    """The optimum with planes for the wall where segments cross it; as far as that comes to an end.

    Planes that contradict each other have no optimum: then what there was without the last of them is given back.
    """
    optimum = _solved(problem, solve) or solve(replace(problem, walls=None))
    if admission.domain is None:
        return optimum
    inside = Admission(admission.domain)
    for _ in range(_PLANES):
        bad = np.flatnonzero(inside.offending(problem, optimum.tree))
        if bad.size == 0:
            break
        walls = walls_met(optimum.problem, optimum.position_mm, admission.domain, bad)
        found = _solved(replace(problem, position_mm=optimum.position_mm, pull=optimum.pull, walls=walls), solve)
        if found is None:
            break
        optimum = replace(found, n_iterations=found.n_iterations + optimum.n_iterations)
    return optimum


def _solved(problem: Problem, solve: Callable[[Problem], Solution]) -> Solution | None:
    """The optimum; ``None`` where walls contradict each other."""
    try:
        return solve(problem)
    except ComputationError:
        if problem.walls is None:
            raise
        return None


def _sweep(problem: Problem, target: Solution, admission: Admission, solve: Callable[[Problem], Solution]) -> Solution:
    """From an admissible start towards the optimum; nodes that cannot follow are held, the others optimised again."""
    position, held, steps = problem.position_mm, problem.held, target.n_iterations
    for _ in range(_ROUNDS):
        share = _retreat(problem.at(position), target, admission)
        position = position + share[:, None] * (target.position_mm - position)
        if (share == 1.0).all():
            break
        held = held | (share < 1.0)
        target = solve(replace(problem, position_mm=position, held=held, pull=target.pull, walls=None))
        steps += target.n_iterations
    return replace(begun(problem.at(position), target.pull), n_iterations=steps)


def _retreat(problem: Problem, optimum: Solution, admission: Admission) -> np.ndarray:
    """(N,) how far each node may go towards the optimum, 0 to 1, for the tree to be admissible."""
    share = np.ones(problem.n_nodes)
    parent, step = problem.topology.parent, optimum.position_mm - problem.position_mm
    while True:
        tree = begun(problem.at(problem.position_mm + share[:, None] * step)).tree
        bad = np.flatnonzero(admission.offending(problem, tree))
        if bad.size == 0:
            return share
        nodes = np.unique(np.concatenate((bad, parent[bad])))
        nodes = nodes[problem.moves[nodes] & (share[nodes] > 0.0)]
        if nodes.size == 0:  # they are where they were, but thicker, or the others are
            nodes = np.flatnonzero(problem.moves & (share > 0.0))
        share[nodes] *= 0.5
        share[share < 0.5**_HALVINGS] = 0.0
        if not (share[problem.moves] > 0.0).any():
            return np.where(problem.moves, 0.0, 1.0)
