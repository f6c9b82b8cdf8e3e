"""Junctions of more than two branches: made by contraction of degenerate segments, tested by splitting them again."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from generator.geometry import _clearance_kernels as kernels
from generator.geometry.problem import Problem, Solution
from generator.geometry.reduced_model import COINCIDENT_MM, Model
from vascval.core.contraction import contract_degenerate, degenerate_segments
from vascval.core.ordering import root_first
from vascval.core.tree import Topology, Tree

_ALL_GROUPS = 5
"""Up to this many branches all groups of them are tested, beyond it pairs alone."""


def contracted(solution: Solution, keep: np.ndarray | None = None) -> tuple[Problem, np.ndarray] | None:
    """The problem without its degenerate segments (paper, section 2.3.1), or ``None`` if there are none.

    Degenerate is a segment between two junctions that is shorter than its diameter
    (:mod:`vascval.core.contraction`), or that nothing but the lower bound keeps from vanishing. Segments of the root
    tree and those that spring from it, or from the root point, stay: there is no Murray's law at their proximal end.

    :param keep: (N,) bool: further segments that stay.
    :returns: the problem, begun at the remaining positions, and (N,) the node into which each old one has gone.
    """
    problem, tree = solution.problem, solution.tree
    shortest = tree.radius_mm.copy()
    pressed = (solution.pull > 0.0) & (tree.length_mm <= problem.physics.l_min_mm * (1.0 + 1e-3))
    shortest[pressed] = np.maximum(shortest[pressed], 0.51 * problem.physics.l_min_mm)
    shortest[~problem.free] = 0.0
    shortest[problem.stems] = 0.0
    shortest[problem.held] = 0.0
    if keep is not None:
        shortest[keep] = 0.0
    judged = Tree(problem.topology, solution.position_mm, shortest)
    gone = degenerate_segments(judged)
    if gone.size == 0:
        return None
    topology = contract_degenerate(judged).topology
    removed = np.zeros(problem.n_nodes, bool)
    removed[gone] = True
    stay = np.flatnonzero(~removed)
    number = np.cumsum(~removed) - 1
    smaller = Problem(
        topology, solution.position_mm[stay], problem.perfusion, problem.physics, problem.fixed_radius_mm[stay],
        problem.held[stay], solution.pull[stay],
    )  # fmt: skip
    return smaller, number[kernels.heirs(problem.topology.parent, removed)]


def split_gains(solution: Solution) -> list[tuple[int, tuple[int, ...], float, float]]:
    """At every junction of three or more branches the group of them whose split lowers the cost most, if any does.

    A group that leaves the junction ``v`` by a new segment of length ``l`` changes the cost by
    ``l (w - |sum of w_c u_c|)`` to first order: ``w``, ``w_c`` are the derivatives of the cost by the lengths of the
    new segment and of the branches ``c`` of the group, ``u_c`` their directions. A merged node is optimal if and only
    if this is nowhere negative (the subgradient condition).

    :returns: (junction, group, gain of the cost per mm in mm^2, radius of the new segment in mm), by junction.
    """
    problem = solution.problem
    model = Model(problem.at(solution.position_mm).at_given_pressure())
    model.eps = COINCIDENT_MM
    model.cost(solution.position_mm)
    model.gradient(solution.position_mm)
    parent, length = problem.topology.parent, np.maximum(model.length, 1e-300)
    force = model.slope[:, None] / length[:, None] * (solution.position_mm - solution.position_mm[parent])
    found = []
    for v in np.flatnonzero(problem.topology.n_children > 2):
        if not problem.free[v]:
            continue
        branches = problem.topology.children(int(v))
        sizes = range(2, branches.size if branches.size <= _ALL_GROUPS else 3)
        best: tuple[float, tuple[int, ...], float] | None = None
        for group in (g for size in sizes for g in combinations(branches.tolist(), size)):
            weight, radius = _weight_of_group(model, int(v), list(group))
            gain = float(np.linalg.norm(force[list(group)].sum(axis=0))) - weight
            if best is None or gain > best[0]:
                best = gain, group, radius
        if best is not None and best[0] > 1e-6 * model.slope[v]:
            found.append((int(v), best[1], best[0], best[2]))
    return found


def _weight_of_group(model: Model, v: int, group: list[int]) -> tuple[float, float]:
    """Derivative of the cost by the length, at 0, of a segment from ``v`` that would feed the group; its radius.

    It has ``q`` and ``n`` the sums of those of the group, and ``rho = q^(4/gamma)``.
    """
    problem = model.problem
    gamma = problem.gamma[v]
    own = problem.below[v] * model.length[v] * model.factor[v] / model.rho[v]
    by_rho = model.stretch[v] / own
    by_sum = (by_rho * 4.0 * (1.0 - own) - model.below[v]) / gamma
    q = model.q[group].sum()
    rho = q ** (4.0 / gamma)
    radius = (model.radius[group] ** gamma).sum() ** (1.0 / gamma)
    scaled = 0.25 * (model.push[group] + model.below[group]).sum() + by_sum * 0.25 * gamma * q / model.total[v]
    resistance = problem.below[group].sum() * model.factor[v]
    return float(np.pi * radius**2 + scaled * resistance / rho), float(radius)


def split(solution: Solution) -> Problem | None:
    """The problem with every junction split whose splitting pays to first order; ``None``: there is none.

    The root tree's nodes keep their place in the numbering, the others are numbered breadth first. A new node
    is put two diameters, or twice the lower bound, away along the force, but not past half of the group's shortest
    branch.
    """
    problem, position = solution.problem, solution.position_mm
    splits = split_gains(solution)
    if not splits:
        return None
    n = problem.n_nodes
    parent = np.concatenate((problem.topology.parent, np.zeros(len(splits), np.int32)))
    new_position = np.vstack((position, np.zeros((len(splits), 3))))
    for k, (v, group, _, width) in enumerate(splits):
        steps = position[list(group)] - position[v]
        length = np.maximum(np.linalg.norm(steps, axis=1), 1e-300)
        pull = (solution.tree.radius_mm[list(group)] ** 2 / length) @ steps
        away = min(max(4.0 * width, 2.0 * problem.physics.l_min_mm), 0.5 * length.min())
        parent[list(group)] = n + k
        parent[n + k] = v
        new_position[n + k] = position[v] + away * pull / max(float(np.linalg.norm(pull)), 1e-300)
    rooted = np.concatenate((~problem.free, np.zeros(len(splits), bool)))
    order = root_first(parent)
    order = np.concatenate((np.flatnonzero(rooted), order[~rooted[order]]))
    rank = np.empty(order.size, np.int64)
    rank[order] = np.arange(order.size)
    radius = np.concatenate((problem.fixed_radius_mm, np.full(len(splits), np.nan)))
    held = np.concatenate((problem.held, np.zeros(len(splits), bool)))
    held_by = np.concatenate((solution.pull, np.zeros(len(splits))))
    topology = Topology(np.concatenate(([-1], rank[parent[order[1:]]])).astype(np.int32))
    return replace(
        problem, topology=topology, position_mm=new_position[order], fixed_radius_mm=radius[order], held=held[order],
        pull=held_by[order], walls=None,
    )  # fmt: skip
