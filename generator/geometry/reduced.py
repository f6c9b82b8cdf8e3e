"""Reduced space: the positions of the inner nodes are the only variables; everything else follows in one sweep.

With ``rho_i = n_i l_i f_i + S_i^(4/gamma)`` and ``S_i`` the sum of ``rho_c^(gamma/4)`` over the children
(:mod:`generator.haemodynamics`; ``f`` is the viscosity relative to the constant one) the radii follow from the lengths,
and a sweep back gives the derivative ``w_i`` of the cost by every length. At fixed weights ``w`` the problem is that of
a network of strings under tension; its Hessian, a tree Laplacian of 3 x 3 blocks, is solved without fill-in and gives
the step, which Armijo's rule shortens where needed. How the weights change with the lengths, which that Hessian leaves
out, is learnt segment by segment from the last step (a diagonal secant condition). Lengths are smoothed,
``sqrt(|d|^2 + eps^2)``, and ``eps`` falls step by step, so that the search does not stall where nodes coincide. Lower
bounds enter by augmented Lagrangians; those that a step would run into are put into a second solve.
One step costs O(N).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from generator.geometry import _reduced_kernels as kernels
from generator.geometry import _viscosity_kernels as viscosity
from generator.geometry.problem import Problem, Solution
from generator.geometry.walls import WallForces
from vascval.core.errors import ComputationError, InputError
from vascval.core.tree import Tree
from vascval.core.units import PA_S_PER_CP

COINCIDENT_MM = 1e-9
"""Smoothing of lengths by which forces are defined also at nodes in one place."""
_SWEEPS = 100
_ROUGH_STEPS = 12
"""At most so many before the last ``eps``: one cluster that is late must not hold up all others."""


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
        residual = model.residual(gradient)
        if residual <= tolerance:
            return _Descent(position, taken, residual)
        direction = -model.step(position, gradient)
        slope = kernels.dot(gradient, direction)
        length = 1.0
        while (lower := model.cost(position + length * direction)) > cost + 1e-4 * length * slope + 1e-13 * abs(cost):
            length *= 0.5
            if length < 1e-9:
                model.cost(position)
                return _Descent(position, taken, residual)
        position, cost = position + length * direction, lower
        gradient = model.gradient(position)
    return _Descent(position, max_steps, model.residual(gradient))


class Model:
    """Cost, gradient and step of a problem; ``eps`` is the smoothing of the lengths in mm."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.physics = problem, problem.physics
        self.variable = self.physics.viscosity != "constant"
        if self.variable and self.physics.objective != "volume":
            raise InputError(
                "viscosity by radius together with volume+power is left to the full space; use geometry.solver=ipopt"
            )
        self.eps, self.stiffening = 0.0, 20.0
        n = problem.n_nodes
        self.parent = problem.topology.parent
        self.constant_cp = problem.perfusion.viscosity_pa_s / PA_S_PER_CP
        self.drop_pa = problem.perfusion.pressure_drop_pa
        self.stem = np.zeros(n)
        self.chord, self.length, self.radius = np.zeros(n), np.zeros(n), np.zeros(n)
        self.rho, self.q = np.zeros(n), np.zeros(n)
        self.total, self.below, self.slope, self.stretch = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
        self.push, self.lift, self.hold, self.stiff = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
        self.pull, self.bound = np.array(problem.pull), np.zeros(n)
        self.factor, self.bend, self.feedback = np.ones(n), np.zeros(n), np.zeros(n)
        self.walls = None if problem.walls is None else WallForces(problem, problem.walls)
        self.seen_slope, self.seen_length, self.along = np.zeros(n), np.zeros(n), np.zeros(n)
        self._scratch, self._blocks = np.zeros(n), (np.zeros((n, 6)), np.zeros((n, 6)))

    def cost(self, position: np.ndarray) -> float:
        """Objective in mm^3, with what the bounds add; ``inf`` where the radii are not defined."""
        kernels.lengths(self.parent, position, self.eps, self.chord, self.length)
        self._find_radii()
        if not np.isfinite(self.radius).all():
            return np.inf
        total = kernels.cost(
            self.length, self.chord, self.radius, self.problem.free, self.physics.l_min_mm, self.pull, self.bound,
            self.push, self.lift, self.hold, self.stiff,
        )  # fmt: skip
        if self.walls is not None:
            total += self.walls.cost(position)
        return total + self._power_mm3()

    def _power_mm3(self) -> float:
        if self.physics.objective == "volume":
            return 0.0
        return self.problem.perfusion.flow_mm3_s * self.drop_pa / self.physics.metabolic_pa_s

    def _find_radii(self) -> None:
        self._set_drop(self.drop_pa)
        self._sweep()
        if self.physics.objective != "volume":
            self._set_drop(self._best_drop())
            self._sweep()
        if not self.variable:
            return
        for _ in range(_SWEEPS):
            before = self.factor.copy()
            fine = viscosity.factors(self.radius, self.problem.free, self.constant_cp, self.factor, self.bend)
            if not fine:
                self.radius[:] = np.nan
                return
            if np.abs(self.factor - before).max() <= 1e-14 * np.abs(before).max():
                return
            self._sweep()
        raise ComputationError(f"viscosity and radii did not settle in {_SWEEPS} sweeps; use constant viscosity")

    def _sweep(self) -> None:
        problem = self.problem
        kernels.radii(
            self.parent, self.length, problem.below, problem.gamma, self.factor, problem.fixed_radius_mm, self.stem,
            self.radius, self.rho, self.q, self.total,
        )  # fmt: skip

    def _set_drop(self, drop_pa: float) -> None:
        self.drop_pa = drop_pa
        left = drop_pa - self.problem.stem_loss_pa
        self.stem[self.problem.stems] = self.problem.perfusion.kappa_pa_s * self.problem.terminal_flow_mm3_s / left

    def _best_drop(self) -> float:
        """The pressure drop at which volume plus power is least.

        Each stem's volume falls with the root of what is left. The derivative
        ``Q / metabolic - sum_j V_j left_j^(-1) / 2`` rises with the drop; its root is bracketed and found by bisection
        in the logarithm of the pressure left for the stem that has least.
        """
        problem = self.problem
        loss = problem.stem_loss_pa
        volume = np.pi * self.radius**2 * self.length * problem.free
        for i in range(problem.n_nodes - 1, 0, -1):
            if problem.free[self.parent[i]]:
                volume[self.parent[i]] += volume[i]
        scaled = volume[problem.stems] * np.sqrt(self.drop_pa - loss)
        price = problem.perfusion.flow_mm3_s / self.physics.metabolic_pa_s
        low, high = np.log(1e-12), np.log(1e12)
        for _ in range(120):
            middle = 0.5 * (low + high)
            left = loss.max() - loss + np.exp(middle)
            if price > 0.5 * (scaled * left**-1.5).sum():
                high = middle
            else:
                low = middle
        return float(loss.max() + np.exp(0.5 * (low + high)))

    def gradient(self, position: np.ndarray) -> np.ndarray:
        """(N, 3) derivative of the cost where it was last evaluated.

        At the best pressure drop the cost is stationary in it. Viscosity follows the radii: its derivatives ``h`` solve
        ``h = A (push + bend h)``, by repeated sweeps.
        """
        for _ in range(_SWEEPS):
            kernels.adjoint(
                self.parent, self.length, self.problem.below, self.problem.gamma, self.factor, self.problem.free,
                self.rho, self.q, self.total, self.push + self.bend * self.feedback, self.lift, self.below, self.slope,
                self.stretch,
            )  # fmt: skip
            if not self.variable:
                break
            change = np.abs(self.stretch - self.feedback).max()
            self.feedback[:] = self.stretch
            if change <= 1e-13 * np.abs(self.push).max():
                break
        else:
            raise ComputationError(
                f"the adjoint of viscosity did not settle in {_SWEEPS} sweeps; use constant viscosity"
            )
        gradient = np.empty((self.problem.n_nodes, 3))
        kernels.pull(
            self.parent, position, self.problem.moves, self.chord, self.length, self.slope, self.hold, gradient
        )
        if self.walls is not None:
            self.walls.add_to(gradient)
        return gradient

    def residual(self, gradient: np.ndarray) -> float:
        return kernels.imbalance(self.parent, self.problem.moves, self.slope, gradient, self._scratch)

    def forget(self) -> None:
        """Let the next step know nothing of the last one."""
        self.seen_length[:] = 0.0

    def step(self, position: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """(N, 3) what to take off the positions to go down."""
        moves, across = self.problem.moves, self._scratch
        kernels.stiffness(
            self.slope, self.hold, self.length, self.seen_slope, self.seen_length, self.along, across
        )  # fmt: skip
        stiff, rhs, anchor = self.stiff + self.along, gradient.copy(), np.zeros_like(self._blocks[1])
        if self.walls is not None:
            self.walls.anchor(anchor)
        step = self._solve(position, across, stiff, anchor, gradient)
        runs_into = kernels.foresee(
            self.parent, position, moves, self.chord, step, self.pull, self.bound, self.physics.l_min_mm, self.stiff,
            stiff, rhs,
        )  # fmt: skip
        if self.walls is not None:
            runs_into |= self.walls.foresee(position, step, anchor, rhs)
        if runs_into:
            held = self._solve(position, across, stiff, anchor, rhs)
            if kernels.dot(gradient, held) > 0.0:
                return held
        return step

    def _solve(
        self, position: np.ndarray, weight: np.ndarray, stiff: np.ndarray, anchor: np.ndarray, rhs: np.ndarray
    ) -> np.ndarray:
        out = np.empty_like(rhs)
        block, diagonal = self._blocks
        diagonal[:] = anchor
        kernels.solve_anchored(
            self.parent, position, self.problem.moves, self.chord, self.length, weight, stiff, 1.0, rhs, block,
            diagonal, out,
        )  # fmt: skip
        return out

    def stiffen(self) -> None:
        """Stiffness of the bound in proportion to the force that presses on it."""
        if self.physics.l_min_mm > 0.0:
            pressing = np.maximum(self.slope, 1e-3 * self.slope.max() + 1e-12)
            stiff = np.maximum(self.stiffening * pressing / self.physics.l_min_mm, self.bound)
            self.bound = np.where(self.problem.bounded, stiff, 0.0)
        if self.walls is not None:
            self.walls.stiffen(self.slope, self.stiffening, float(self.length[self.problem.free].mean()))

    def update_bounds(self, position: np.ndarray) -> tuple[float, str]:
        """New multipliers; the largest relative violation and, in words, where it is.

        A bound that pushes where it is not reached is violated too.
        """
        beyond = 0.0 if self.walls is None else self.walls.update(position)
        short, where = self._update_lengths()
        return (short, where) if short >= beyond else (beyond, f"walls are crossed by {beyond:.2g} of their margin")

    def _update_lengths(self) -> tuple[float, str]:
        limit = self.physics.l_min_mm
        if limit == 0.0:
            return 0.0, ""
        gap = np.where(self.problem.bounded, limit - self.chord, 0.0)
        self.pull = np.maximum(0.0, self.pull + self.bound * gap)
        gap = np.where(self.pull > 0.0, np.abs(gap), gap)
        i = int(gap.argmax())
        where = f"segment {i} has length {self.chord[i]:.4g} mm, where l_min_mm={limit:g} is asked for: lower it"
        return max(0.0, float(gap[i]) / limit), where

    def tree(self, position: np.ndarray) -> Tree:
        """The tree at these positions, with exact lengths, radii, flows and pressures."""
        self.eps = 0.0
        kernels.lengths(self.parent, position, 0.0, self.chord, self.length)
        self._find_radii()
        return tree_of(self.problem, position, self.radius, self.factor, self.drop_pa)

    def plain_cost(self, tree: Tree) -> float:
        volume = float(np.pi * (tree.radius_mm[1:] ** 2 * tree.length_mm[1:])[self.problem.free[1:]].sum())
        return volume + self._power_mm3()


def tree_of(problem: Problem, position: np.ndarray, radius: np.ndarray, factor: np.ndarray, drop_pa: float) -> Tree:
    """A tree with its columns from positions, radii, viscosity factors and the pressure drop from root to terminals."""
    parent, length = problem.topology.parent, problem.lengths(position)
    stubs = problem.topology.terminals[length[problem.topology.terminals] <= 0.0]
    if stubs.size:
        raise InputError(f"{stubs.size} terminals have no length (first: segment {stubs[0]}); move or drop them")
    flow = problem.below * problem.terminal_flow_mm3_s
    drop = np.zeros(problem.n_nodes)
    drop[1:] = (problem.perfusion.kappa_pa_s * factor * flow * length)[1:] / radius[1:] ** 4
    fixed = ~problem.free
    lost = problem.fixed_pressure_loss_pa.copy()
    for i in range(1, problem.n_nodes):
        if fixed[i]:
            drop[i] = lost[i] - lost[parent[i]]
        else:
            lost[i] = lost[parent[i]] + drop[i]
    pressure = problem.perfusion.terminal_pressure_pa + drop_pa - lost
    columns = {"length_mm": length, "flow_mm3_s": flow, "pressure_drop_pa": drop, "pressure_pa": pressure}
    return Tree(problem.topology, position, np.where(np.arange(radius.size) > 0, radius, 0.0), columns)


def evaluate(problem: Problem, *, eps: float = 0.0, pull: np.ndarray | None = None, n_iterations: int = 0) -> Solution:
    """The problem where it begins, nothing moved: radii, tree, cost, and how far it is from an optimum.

    :param eps: smoothing of the lengths, in mm, that the forces are judged by.
    :param pull: (N,) forces with which bounds hold segments, in mm^2 as the derivatives of volume by length.
    """
    model = Model(problem)
    model.eps = eps
    pull = np.zeros(problem.n_nodes) if pull is None else pull
    position = np.array(problem.position_mm)
    model.cost(position)
    model.hold[:] = pull
    residual = model.residual(model.gradient(position))
    tree = model.tree(position)
    short = problem.physics.l_min_mm - tree.length_mm[problem.bounded]
    violation = float(short.max(initial=0.0)) / max(problem.physics.l_min_mm, 1e-300)
    return Solution(problem, position, tree, model.plain_cost(tree), residual, violation, n_iterations, pull)
