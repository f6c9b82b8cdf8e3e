"""Reduced space: the positions of the inner nodes are the only variables; everything else follows in one sweep.

Steps of :mod:`~generator.geometry.reduced_model`, shortened by Armijo's rule where needed, go down while the smoothing
of the lengths falls step by step, so that the search does not stall where nodes coincide. Once few nodes are left that
have not settled, they move alone (:mod:`~generator.geometry.network`): one late cluster in a large tree would otherwise
cost steps of the whole.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from generator.geometry import _reduced_kernels as kernels
from generator.geometry.problem import Problem, Solution
from generator.geometry.reduced_model import Model, evaluate
from vascval.core.errors import ComputationError

_ROUGH_STEPS = 12
"""At most so many before the last ``eps``: one cluster that is late must not hold up all others."""
_LARGE, _FEW = 1000, 100
"""Where at most one node in ``_FEW`` of a tree of ``_LARGE`` nodes or more is late, these move alone."""
_ROUNDS, _PART_STEPS = 10, 40
"""So often, with those that come to be late by it, and in so many steps each time."""
_UPSET = 0.3
"""Relative force at nodes that a step has thrown too far."""


@dataclass(frozen=True)
class ReducedOptions:
    """How the search goes.

    * ``smoothing``: the values of ``eps`` gone through, in mean lengths of a segment;
    * ``tolerance``: largest force left at a node, relative to those that pull at it; ``rough``: the same before the
      last ``eps``;
    * ``max_steps``: per value of ``eps``;
    * ``violation``: of the bound on lengths, relative.
    """

    smoothing: tuple[float, ...] = (0.5, 0.15, 0.05, 0.015, 0.005, 0.001)
    tolerance: float = 1e-4
    rough: float = 3e-2
    max_steps: int = 2000
    violation: float = 1e-6


def solve_reduced(problem: Problem, options: ReducedOptions | None = None) -> Solution:
    """The optimal geometry, from where the problem begins.

    :raises ComputationError: when the search does not converge, the lower bound on lengths cannot be held, or radii
        come out below theirs.
    """
    options = options or ReducedOptions()
    model = Model(problem)
    position = np.array(problem.position_mm)
    scale = float(problem.lengths(position)[problem.free].mean())
    steps = 0
    model.eps = options.smoothing[0] * scale
    model.cost(position)
    model.gradient(position)
    for factor in options.smoothing[:-1]:
        model.eps = factor * scale
        model.stiffen()
        found = _descend(model, position, options.rough, _ROUGH_STEPS)
        position, steps = found.position, steps + found.steps
        model.update_bounds(position)
    model.eps = options.smoothing[-1] * scale
    last = np.inf
    for _ in range(40):
        model.stiffen()
        found = _descend(model, position, options.tolerance, options.max_steps)
        position, steps = found.position, steps + found.steps
        violation, where = model.update_bounds(position)
        if not found.residual <= options.tolerance:
            break
        if violation <= options.violation:
            walls = None if model.walls is None else model.walls.found()
            there = replace(problem, position_mm=position, walls=walls)
            return _thick_enough(evaluate(there, eps=model.eps, pull=model.pull, n_iterations=steps))
        if violation > 0.25 * last:
            model.stiffening *= 4.0
        last = violation
    bound = f"; {where}" if violation > options.violation else ""
    raise ComputationError(
        f"the geometry of {problem.topology.n_terminals} terminals did not converge in {steps} steps: the forces at a "
        f"node are out of balance by {found.residual:.2g} of those that pull at it, {options.tolerance:g} being asked "
        f"for{bound}"
    )


def _thick_enough(solution: Solution) -> Solution:
    limit, free = solution.problem.physics.r_min_mm, solution.problem.free
    radius = solution.tree.radius_mm
    thin = np.flatnonzero(free & (radius < limit * (1.0 - 1e-9)))
    if thin.size:
        worst = thin[radius[thin].argmin()]
        raise ComputationError(
            f"{thin.size} segments of the optimal geometry are thinner than r_min {limit:g} mm (segment {worst}: "
            f"{radius[worst]:.4g} mm); lower r_min_mm, or use geometry.solver=ipopt, which "
            "can hold such a bound where that is possible"
        )
    return solution


@dataclass(frozen=True, eq=False)
class _Descent:
    position: np.ndarray
    steps: int
    residual: float


def _descend(model: Model, position: np.ndarray, tolerance: float, max_steps: int) -> _Descent:
    """Steps until the forces balance to ``tolerance``, or there is no way down, or they are ``max_steps``."""
    cost = model.cost(position)
    gradient = model.gradient(position)
    model.forget()
    for taken in range(max_steps):
        cost, gradient = _settle(model, position, cost, gradient, tolerance, _ROUNDS)
        if (residual := float(model.imbalance(gradient).max())) <= tolerance:
            return _Descent(position, taken, residual)
        direction = -model.step(position, gradient)
        slope = kernels.dot(gradient, direction)
        length = 1.0
        while True:
            trial = position + length * direction
            lower = model.cost(trial)
            enough = cost + 1e-4 * length * slope + 1e-13 * abs(cost)
            if length == 1.0 and enough < lower < np.inf:
                # a few clusters that are thrown too far must not shorten the step of all others
                lower, _ = _settle(model, trial, lower, model.gradient(trial), _UPSET, 1)
            if lower <= enough:
                break
            length *= 0.5
            if length < 1e-9:
                model.cost(position)
                model.gradient(position)
                return _Descent(position, taken, residual)
        position, cost = trial, lower
        gradient = model.gradient(position)
    return _Descent(position, max_steps, float(model.imbalance(gradient).max()))


def _settle(
    model: Model, position: np.ndarray, cost: float, gradient: np.ndarray, tolerance: float, rounds: int
) -> tuple[float, np.ndarray]:
    """Move nodes out of balance, if they are few, in place, and those that come to be so by it; cost and gradient.

    A part is settled in the same way, so that it must be smaller: on long ways to the root it may not be.
    """
    late = np.zeros(position.shape[0], bool)
    for _ in range(rounds if late.size >= _LARGE else 0):
        more = model.imbalance(gradient) > tolerance
        late |= more
        if not more.any() or late.sum() * _FEW > late.size or (found := model.around(late)) is None:
            break
        nodes, part = found
        if 10 * nodes.size > 9 * late.size:
            break
        moved = _descend(part, position[nodes], 0.3 * tolerance, _PART_STEPS)
        position[nodes] = moved.position
        cost, gradient = model.cost(position), model.gradient(position)
        if moved.residual > 0.3 * tolerance:
            break
    return cost, gradient
