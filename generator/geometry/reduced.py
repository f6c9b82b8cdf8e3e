"""Reduced space: the positions of the inner nodes are the only variables; everything else follows in one sweep.

With ``rho_i = n_i l_i f_i + S_i^(4/gamma)`` and ``S_i`` the sum of ``rho_c^(gamma/4)`` over the children
(:mod:`generator.haemodynamics`; ``f`` is the viscosity relative to the constant one) the radii follow from the lengths,
and a sweep back gives the derivative ``w_i`` of the cost by every length. At fixed weights ``w`` the problem is that of
a network of strings under tension; its Hessian, a tree Laplacian of 3 x 3 blocks, is solved without fill-in and gives
the step, which Armijo's rule shortens where needed. Lengths are smoothed, ``sqrt(|d|^2 + eps^2)``, and ``eps`` falls
step by step, so that the search does not stall where nodes coincide. Lower bounds enter by augmented Lagrangians.
One step costs O(N).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from generator.geometry import _reduced_kernels as kernels
from generator.geometry import _viscosity_kernels as viscosity
from generator.geometry.problem import Problem, Solution
from vascval.core.errors import ComputationError, InputError
from vascval.core.tree import Tree
from vascval.core.units import PA_S_PER_CP

_BEND = 0.97
"""How much of the Hessian's negative part the step uses: 0 is the majoriser, 1 the Hessian at fixed weights."""
_SWEEPS = 100


@dataclass(frozen=True)
class ReducedOptions:
    """``smoothing``: the values of ``eps`` gone through, in mean lengths of a segment; ``tolerance``: largest force left
    at a node, relative to those that pull at it; ``rough`` the same before the last ``eps``; ``max_steps`` per value of
    ``eps``; ``violation``: relative, of a bound."""

    smoothing: tuple[float, ...] = (0.5, 0.15, 0.05, 0.015, 0.005, 0.001)
    tolerance: float = 1e-4
    rough: float = 3e-2
    max_steps: int = 600
    violation: float = 1e-6


def solve_reduced(problem: Problem, options: ReducedOptions | None = None) -> Solution:
    """The optimal geometry, from where the problem begins.

    :raises ComputationError: when the search does not converge or the lower bounds cannot be held.
    """
    options = options or ReducedOptions()
    model = Model(problem)
    position = np.array(problem.position_mm)
    scale = float(problem.lengths(position)[problem.free].mean())
    bounded = problem.physics.l_min_mm > 0.0 or problem.physics.r_min_mm > 0.0
    steps = 0
    for factor in options.smoothing[:-1]:
        model.eps = factor * scale
        model.stiffen()
        position, taken, _ = _descend(model, position, options.rough, 60, strict=False)
        model.update_bounds()
        steps += taken
    model.eps = options.smoothing[-1] * scale
    if problem.physics.l_min_mm > 0.0:
        model.eps = min(model.eps, 1e-3 * problem.physics.l_min_mm)
    last = np.inf
    for _ in range(40 if bounded else 1):
        model.stiffen()
        position, taken, residual = _descend(model, position, options.tolerance, options.max_steps, strict=True)
        steps += taken
        violation, where = model.update_bounds()
        if violation <= options.violation:
            tree = model.tree(position)
            return Solution(problem, position, tree, model.plain_cost(tree), residual, violation, steps)
        if violation > 0.25 * last:
            model.stiffening *= 4.0
        last = violation
    raise ComputationError(
        f"the lower bounds cannot be held: {where} (in {problem.n_nodes - 1} segments); lower geometry.l_min_mm or "
        "geometry.r_min_mm, ask for fewer terminals, or lower the pressure drop"
    )


def _descend(
    model: Model, position: np.ndarray, tolerance: float, max_steps: int, *, strict: bool
) -> tuple[np.ndarray, int, float]:
    """Steps until the forces balance; ``strict``: not getting there is an error."""
    cost = model.cost(position)
    for taken in range(max_steps + 1):
        gradient = model.gradient(position)
        residual = model.residual(gradient)
        if residual <= tolerance:
            return position, taken, residual
        direction = -model.step(position, gradient)
        slope = kernels.dot(gradient, direction)
        length = 1.0
        while taken < max_steps:
            trial = position + length * direction
            found = model.cost(trial)
            if found <= cost + 1e-4 * length * slope + 1e-13 * abs(cost):
                break
            length *= 0.5
            if length < 1e-9:
                taken = max_steps
        if taken == max_steps:
            break
        position, cost = trial, found
    if strict:
        raise ComputationError(
            f"the geometry did not converge: the forces at a node are out of balance by {residual:.2g} of those that pull "
            f"at it, where {tolerance:g} is asked for, after {max_steps} steps; begin from another tree"
        )
    model.cost(position)
    model.gradient(position)
    return position, max_steps, residual


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
        self.length, self.radius, self.rho, self.q = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
        self.total, self.below, self.slope, self.stretch = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
        self.push, self.lift, self.stiff = np.zeros(n), np.zeros(n), np.zeros(n)
        self.l_pull, self.l_stiff, self.r_pull, self.r_stiff = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
        self.factor, self.bend, self.feedback = np.ones(n), np.zeros(n), np.zeros(n)
        self._scratch, self._blocks = np.zeros(n), np.zeros((n, 6))

    def cost(self, position: np.ndarray) -> float:
        """Objective in mm^3, with what the bounds add; ``inf`` where the radii are not defined."""
        kernels.lengths(self.parent, position, self.eps, self.length)
        self._find_radii()
        if not np.isfinite(self.radius).all():
            return np.inf
        r_min = self.physics.r_min_mm
        total = kernels.cost(
            self.parent, self.length, self.radius, self.problem.free, self.physics.l_min_mm, self.l_pull, self.l_stiff,
            np.log(r_min) if r_min > 0.0 else 0.0, self.r_pull, self.r_stiff, self.push, self.lift, self.stiff,
        )  # fmt: skip
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
        """The pressure drop at which volume plus power is least: each stem's volume falls with the root of what is left.

        The derivative ``Q / metabolic - sum_j V_j left_j^(-1) / 2`` rises with the drop; its root is bracketed and
        found by bisection in the logarithm of the pressure left for the stem that has least.
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
            raise ComputationError(f"the adjoint of viscosity did not settle in {_SWEEPS} sweeps; use constant viscosity")
        gradient = np.empty((self.problem.n_nodes, 3))
        kernels.pull(self.parent, position, self.problem.moves, self.length, self.slope, gradient)
        return gradient

    @property
    def weight(self) -> np.ndarray:
        """(N,) derivative of the objective by the lengths, without the force of the bound on the length."""
        return self.slope + np.where(self.problem.free, np.pi * self.radius**2 - self.lift, 0.0)

    def residual(self, gradient: np.ndarray) -> float:
        return kernels.imbalance(self.parent, self.problem.moves, self.weight, gradient, self._scratch)

    def step(self, position: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        out = np.empty_like(gradient)
        kernels.solve_laplacian(
            self.parent, position, self.problem.moves, self.length, self.weight, self.stiff, _BEND, gradient,
            self._blocks, out,
        )  # fmt: skip
        return out

    def stiffen(self) -> None:
        """Stiffness of the bounds in proportion to the forces that press on them."""
        if self.physics.l_min_mm > 0.0:
            pressing = np.where(self.problem.free, np.maximum(self.weight, 0.0), 0.0)
            floor = 1e-3 * pressing.max() + 1e-12
            stiff = self.stiffening * np.maximum(pressing, floor) / self.physics.l_min_mm
            self.l_stiff = np.where(self.problem.free, np.maximum(stiff, self.l_stiff), 0.0)
        if self.physics.r_min_mm > 0.0:
            stiff = self.stiffening * np.maximum(self.push, 1e-3 * self.push.max() + 1e-12)
            self.r_stiff = np.where(self.problem.free, np.maximum(stiff, self.r_stiff), 0.0)

    def update_bounds(self) -> tuple[float, str]:
        """New multipliers; the largest relative violation and, in words, where it is."""
        worst, where = 0.0, ""
        free = self.problem.free
        for limit, value, pull, stiff, what in (
            (self.physics.l_min_mm, self.length, self.l_pull, self.l_stiff, "length"),
            (self.physics.r_min_mm, self.radius, self.r_pull, self.r_stiff, "radius"),
        ):
            if limit <= 0.0:
                continue
            gap = limit - value if what == "length" else np.log(limit / np.where(free, value, limit))
            pull[:] = np.where(free, np.maximum(0.0, pull + stiff * gap), 0.0)
            relative = np.where(free, 1.0 - value / limit, 0.0)
            i = int(relative.argmax())
            if relative[i] > worst:
                worst, where = float(relative[i]), f"segment {i} has {what} {value[i]:.4g} mm where {limit:g} is asked for"
        return worst, where

    def tree(self, position: np.ndarray) -> Tree:
        """The tree at these positions, with exact lengths, radii, flows and pressures."""
        self.eps = 0.0
        kernels.lengths(self.parent, position, 0.0, self.length)
        self._find_radii()
        return tree_of(self.problem, position, self.radius, self.factor, self.drop_pa)

    def plain_cost(self, tree: Tree) -> float:
        volume = float(np.pi * (tree.radius_mm[1:] ** 2 * tree.length_mm[1:])[self.problem.free[1:]].sum())
        return volume + self._power_mm3()


def tree_of(
    problem: Problem, position: np.ndarray, radius: np.ndarray, factor: np.ndarray, drop_pa: float
) -> Tree:
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


def evaluate(problem: Problem) -> Solution:
    """The problem where it begins, nothing moved: radii, tree and cost."""
    model = Model(problem)
    position = np.array(problem.position_mm)
    model.cost(position)
    residual = model.residual(model.gradient(position))
    tree = model.tree(position)
    limit = replace(problem.physics)
    violation = max(
        (1.0 - tree.length_mm[problem.free] / limit.l_min_mm).max() if limit.l_min_mm > 0 else 0.0,
        (1.0 - tree.radius_mm[problem.free] / limit.r_min_mm).max() if limit.r_min_mm > 0 else 0.0,
        0.0,
    )
    return Solution(problem, position, tree, model.plain_cost(tree), residual, float(violation), 0)
