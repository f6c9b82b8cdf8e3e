"""Cost, gradient and step of a geometry problem in the reduced space, for the whole tree or a part of it.

With ``rho_i = n_i l_i f_i + S_i^(4/gamma)`` and ``S_i`` the sum of ``rho_c^(gamma/4)`` over the children
(:mod:`generator.haemodynamics`; ``f`` is the viscosity relative to the constant one) the radii follow from the lengths,
and a sweep back gives the derivative ``w_i`` of the cost by every length. At fixed weights ``w`` the problem is that of
a network of strings under tension; its Hessian, a tree Laplacian of 3 x 3 blocks, is solved without fill-in and gives
the step. How the weights change with the lengths, which that Hessian leaves out, is learnt segment by segment from the
last step (a diagonal secant condition). Lengths are smoothed, ``sqrt(|d|^2 + eps^2)``. Lower bounds enter by augmented
Lagrangians; those that a step would run into are put into a second solve. All of it costs O(N).
"""

from __future__ import annotations

import numpy as np

from generator.geometry import _reduced_kernels as kernels
from generator.geometry import _viscosity_kernels as viscosity
from generator.geometry.network import Network
from generator.geometry.problem import Problem, Solution
from generator.geometry.walls import WallForces
from vascval.core.errors import ComputationError, InputError
from vascval.core.tree import Tree
from vascval.core.units import PA_S_PER_CP

COINCIDENT_MM = 1e-9
"""Smoothing of lengths by which forces are defined also at nodes in one place."""
_SWEEPS = 100


class Model:
    """Cost, gradient and step of a problem; ``eps`` is the smoothing of the lengths in mm.

    Of a part of the tree, where a ``network`` is given; its cost then lacks a constant.
    """

    def __init__(self, problem: Problem, network: Network | None = None) -> None:
        self.problem, self.physics = problem, problem.physics
        self.network = network or Network.whole(problem)
        self.variable = self.physics.viscosity != "constant"
        if self.variable and self.physics.objective != "volume":
            raise InputError(
                "viscosity by radius together with volume+power is left to the full space; use geometry.solver=ipopt"
            )
        self.eps, self.stiffening = 0.0, 20.0
        self.parent, self.moves, self.free = self.network.parent, self.network.moves, self.network.free
        n = self.parent.size
        self.constant_cp = problem.perfusion.viscosity_pa_s / PA_S_PER_CP
        self.drop_pa = problem.perfusion.pressure_drop_pa
        self.stem = np.zeros(n)
        self.chord, self.length, self.radius = np.zeros(n), np.zeros(n), np.zeros(n)
        self.rho, self.q = np.zeros(n), np.zeros(n)
        self.total, self.below, self.slope, self.stretch = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
        self.push, self.lift, self.hold, self.stiff = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
        self.pull, self.bound, self.lump = np.zeros(n), np.zeros(n), np.zeros(n)
        self.factor, self.bend, self.feedback = np.ones(n), np.zeros(n), np.zeros(n)
        self.walls = None
        if network is None:
            self.pull[:] = problem.pull
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
            self.length, self.chord, self.radius, self.total, self.network.gamma, self.network.bulk, self.free,
            self.physics.l_min_mm, self.pull, self.bound, self.lump, self.push, self.lift, self.hold, self.stiff,
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
            fine = viscosity.factors(self.radius, self.free, self.constant_cp, self.factor, self.bend)
            if not fine:
                self.radius[:] = np.nan
                return
            if np.abs(self.factor - before).max() <= 1e-14 * np.abs(before).max():
                return
            self._sweep()
        raise ComputationError(f"viscosity and radii did not settle in {_SWEEPS} sweeps; use constant viscosity")

    def _sweep(self) -> None:
        network = self.network
        kernels.radii(
            self.parent, self.length, network.below, network.gamma, self.factor, network.fixed_radius_mm, self.stem,
            network.base, self.radius, self.rho, self.q, self.total,
        )  # fmt: skip

    def _set_drop(self, drop_pa: float) -> None:
        self.drop_pa = drop_pa
        left = drop_pa - self.network.stem_loss_pa
        self.stem[self.network.stems] = self.problem.perfusion.kappa_pa_s * self.problem.terminal_flow_mm3_s / left

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
                self.parent, self.length, self.network.below, self.network.gamma, self.factor, self.free, self.rho,
                self.q, self.total, self.lump, self.push + self.bend * self.feedback, self.lift, self.below, self.slope,
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
        gradient = np.empty((self.parent.size, 3))
        kernels.pull(self.parent, position, self.moves, self.chord, self.length, self.slope, self.hold, gradient)
        if self.walls is not None:
            self.walls.add_to(gradient)
        return gradient

    def imbalance(self, gradient: np.ndarray) -> np.ndarray:
        """(N,) forces that are left on the nodes that move, relative to those that pull at them."""
        force = np.empty(self.parent.size)
        kernels.imbalance(self.parent, self.moves, self.slope, gradient, force)
        return force

    def around(self, late: np.ndarray) -> tuple[np.ndarray, Model] | None:
        """The part of the tree in which only ``late`` nodes (N,) bool and their neighbours move; and its nodes.

        ``None`` where what is far away counts: viscosity by radius, a root pressure that is sought, walls.
        """
        if self.variable or self.physics.objective != "volume" or self.walls is not None:
            return None
        volume = self.lift * self.length * self.free
        nodes, network = self.network.around(late, self.radius, self.total, self.q, volume, self.lump)
        part = Model(self.problem, network)
        part.eps, part.pull, part.bound = self.eps, self.pull[nodes], self.bound[nodes]
        return nodes, part

    def forget(self) -> None:
        """Let the next step know nothing of the last one."""
        self.seen_length[:] = 0.0

    def step(self, position: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """(N, 3) what to take off the positions to go down."""
        across = self._scratch
        kernels.stiffness(
            self.slope, self.hold, self.length, self.seen_slope, self.seen_length, self.along, across
        )  # fmt: skip
        stiff, rhs, anchor = self.stiff + self.along, gradient.copy(), np.zeros_like(self._blocks[1])
        if self.walls is not None:
            self.walls.anchor(anchor)
        step = self._solve(position, across, stiff, anchor, gradient)
        runs_into = kernels.foresee(
            self.parent, position, self.moves, self.chord, step, self.pull, self.bound, self.physics.l_min_mm,
            self.stiff, stiff, rhs,
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
            self.parent, position, self.moves, self.chord, self.length, weight, stiff, 1.0, rhs, block,
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
    residual = float(model.imbalance(model.gradient(position)).max())
    tree = model.tree(position)
    short = problem.physics.l_min_mm - tree.length_mm[problem.bounded]
    violation = float(short.max(initial=0.0)) / max(problem.physics.l_min_mm, 1e-300)
    return Solution(problem, position, tree, model.plain_cost(tree), residual, violation, n_iterations, pull)
