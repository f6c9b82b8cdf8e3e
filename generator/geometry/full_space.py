"""Full space: the paper's nonlinear programme in positions, pressures, lengths and radii, by Ipopt with MUMPS.

The programme is that of :mod:`generator.geometry.problem`, with these equivalent changes of variables, without which
it stalls beyond some hundred terminals:

* every variable is measured in its value at the start: positions in mean lengths, lengths in their own, pressures in
  the pressure drop, radii as ``log(r / r_start)``, in which Murray's law and Poiseuille's are sums of exponentials;
* every row is divided by its size at the start; squares of lengths are compared, ``l^2 = |d|^2``, which is smooth
  where nodes meet;
* the objective counts segments, not cubic millimetres: the barrier of some 10^5 bounds must not drown it;
* the start is feasible but for lower bounds, and the barrier begins small, so that Ipopt stays near it.

Expressions are built over whole arrays; CasADi derives the sparse Jacobian and Hessian.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from generator.geometry._viscosity_kernels import DEPLETED_MM, PLASMA_CP
from generator.geometry.problem import Problem, Solution
from generator.geometry.reduced_model import evaluate
from vascval.core.errors import ComputationError
from vascval.core.tree import Tree
from vascval.core.units import PA_S_PER_CP

_SMALL_DROP = 1e-3
"""Rows of Poiseuille's law are divided by the segment's share of the pressure drop, but not by less than this."""
_AGREEMENT = 1e-5


@dataclass(frozen=True)
class FullOptions:
    """``smoothing`` of lengths, in mean lengths, where there is no lower bound on them; the rest is Ipopt's."""

    smoothing: float = 1e-3
    tolerance: float = 1e-7
    max_iterations: int = 500
    barrier: float = 0.01
    max_seconds: float = 1e6


def solve_full(problem: Problem, options: FullOptions | None = None) -> Solution:
    """The optimal geometry, from where the problem begins.

    :raises ComputationError: when Ipopt does not end with an optimal solution; its own word for it is given.
    """
    import casadi

    options = options or FullOptions()
    programme = Programme(problem, options.smoothing)
    settings: dict[str, Any] = {
        "print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.linear_solver": "mumps",
        "ipopt.mu_init": options.barrier, "ipopt.bound_push": 1e-8, "ipopt.bound_frac": 1e-8,
        "ipopt.tol": options.tolerance, "ipopt.max_iter": options.max_iterations,
        "ipopt.max_cpu_time": options.max_seconds,
    }  # fmt: skip
    solver = casadi.nlpsol("geometry", "ipopt", programme.expressions, settings)
    result = solver(x0=programme.start, lbx=programme.lower, ubx=programme.upper, lbg=0.0, ubg=programme.slack)
    status, count = solver.stats()["return_status"], int(solver.stats()["iter_count"])
    if status not in ("Solve_Succeeded", "Solved_To_Acceptable_Level"):
        raise ComputationError(
            f"Ipopt found no optimal geometry: {status} after {count} iterations ({problem.n_nodes - 1} segments); "
            "loosen l_min_mm and r_min_mm, raise the number of iterations, or use geometry.solver=reduced"
        )
    values, held, rows = (np.asarray(result[name]).ravel() for name in ("x", "lam_x", "lam_g"))
    return programme.solution(values, held, rows, count)


class Programme:
    """Variables, objective, constraints and bounds; see the module for the scales."""

    def __init__(self, problem: Problem, smoothing: float) -> None:
        import casadi

        self.problem = problem
        begin = evaluate(problem.at_given_pressure())
        tree = begin.tree
        self.segments = np.flatnonzero(problem.free)
        self.moving = np.flatnonzero(problem.moves)
        self.inner = np.flatnonzero(problem.free & (problem.topology.n_children > 0))
        self.eps = 0.0
        scale = float(tree.length_mm[self.segments].mean())
        if problem.physics.l_min_mm == 0.0:
            self.eps = smoothing * scale
        self.scale_mm = scale
        self.drop_pa = problem.perfusion.pressure_drop_pa
        smooth = np.sqrt(tree.length_mm[self.segments] ** 2 + self.eps**2)
        self.length_mm = np.maximum(smooth, max(problem.physics.l_min_mm, 1e-3 * scale))
        self.radius_mm = tree.radius_mm[self.segments]
        self.frees_pressure = problem.physics.objective != "volume"
        x = casadi.SX.sym("x", self.moving.size, 3)
        p = casadi.SX.sym("p", self.inner.size)
        root = casadi.SX.sym("root", int(self.frees_pressure))
        length = casadi.SX.sym("l", self.segments.size)
        radius = casadi.SX.sym("r", self.segments.size)
        rows = [self._lengths(x, length), self._poiseuille(tree, p, root, length, radius), self._murray(tree, radius)]
        walls = self._walls(x)
        self.n_walls = walls.size1()
        self.slack = np.concatenate((np.zeros(sum(row.size1() for row in rows)), np.full(self.n_walls, np.inf)))
        rows.append(walls)
        self.expressions = {
            "x": casadi.vertcat(casadi.vec(x), p, root, length, radius),
            "f": self._objective(length, radius, root),
            "g": casadi.vertcat(*rows),
        }
        self._set_start(tree, smooth)

    def _ends(self) -> tuple[list[int], list[int]]:
        return self.problem.topology.parent[self.segments].tolist(), self.segments.tolist()

    def _nodes(self, x: Any) -> Any:
        import casadi

        nodes = casadi.SX(casadi.DM(self.problem.position_mm))
        nodes[self.moving.tolist(), :] = casadi.DM(self.problem.position_mm[self.moving]) + self.scale_mm * x
        return nodes

    def _walls(self, x: Any) -> Any:
        """How far within their planes points are, in mean lengths."""
        import casadi

        walls = self.problem.walls
        if walls is None:
            return casadi.SX(0, 1)
        nodes, share = self._nodes(x), casadi.repmat(casadi.DM(walls.share), 1, 3)
        near, far = self.problem.topology.parent[walls.segment].tolist(), walls.segment.tolist()
        point = (1.0 - share) * nodes[near, :] + share * nodes[far, :]
        return (casadi.sum2(casadi.DM(walls.normal) * point) - casadi.DM(walls.offset_mm)) / self.scale_mm

    def _lengths(self, x: Any, length: Any) -> Any:
        import casadi

        nodes = self._nodes(x)
        above, end = self._ends()
        step = (nodes[end, :] - nodes[above, :]) / casadi.repmat(casadi.DM(self.length_mm), 1, 3)
        return 0.5 * (length**2 - casadi.sum2(step**2) - casadi.DM((self.eps / self.length_mm) ** 2))

    def _poiseuille(self, tree: Tree, p: Any, root: Any, length: Any, radius: Any) -> Any:
        import casadi

        problem = self.problem
        lost = problem.fixed_pressure_loss_pa / self.drop_pa
        above, end = self._ends()
        entry = root if self.frees_pressure else casadi.SX(1.0)
        pressure = entry - casadi.SX(casadi.DM(lost))
        pressure[self.segments.tolist()] = 0.0
        pressure[self.inner.tolist()] = p
        flow = problem.below[self.segments] * problem.terminal_flow_mm3_s
        share = problem.perfusion.kappa_pa_s * flow * self.length_mm / self.radius_mm**4 / self.drop_pa
        row = np.maximum(share, _SMALL_DROP)
        loss = casadi.DM(share / row) * self._thickness(radius) * length * casadi.exp(-4.0 * radius)
        return (pressure[above] - pressure[end]) / casadi.DM(row) - loss

    def _thickness(self, radius: Any) -> Any:
        """Viscosity relative to the constant one."""
        import casadi

        if self.problem.physics.viscosity == "constant":
            return 1.0
        r = casadi.DM(self.radius_mm) * casadi.exp(radius)
        k = (r / (r - DEPLETED_MM)) ** 2
        core = 6.0 * casadi.exp(-170.0 * r) - 2.44 * casadi.exp(-8.09 * r**0.64) + 2.2
        return PLASMA_CP * (k + k**2 * core) * PA_S_PER_CP / self.problem.perfusion.viscosity_pa_s

    def _murray(self, tree: Tree, radius: Any) -> Any:
        import casadi

        problem = self.problem
        number = np.full(problem.n_nodes, -1)
        number[self.segments] = np.arange(self.segments.size)
        child = self.segments[problem.free[problem.topology.parent[self.segments]]]
        above = problem.topology.parent[child]
        nodes, row = np.unique(above, return_inverse=True)
        gamma = problem.gamma[above]
        share = casadi.DM((tree.radius_mm[child] / tree.radius_mm[above]) ** gamma)
        terms = share * casadi.exp(casadi.DM(gamma) * (radius[number[child].tolist()] - radius[number[above].tolist()]))
        columns = list(range(child.size))
        gather = casadi.DM.triplet(row.tolist(), columns, casadi.DM.ones(child.size), nodes.size, child.size)
        return casadi.mtimes(gather, terms) - 1.0

    def _objective(self, length: Any, radius: Any, root: Any) -> Any:
        import casadi

        volume = np.pi * self.radius_mm**2 * self.length_mm
        self.unit_mm3 = float(volume.sum()) / self.segments.size
        cost = casadi.sum1(casadi.DM(volume / self.unit_mm3) * length * casadi.exp(2.0 * radius))
        if self.frees_pressure:
            power = self.problem.perfusion.flow_mm3_s * self.drop_pa / self.problem.physics.metabolic_pa_s
            cost += power / self.unit_mm3 * root
        return cost

    def _set_start(self, tree: Tree, smooth: np.ndarray) -> None:
        physics, free = self.problem.physics, self.problem.free
        pressure = (tree.columns["pressure_pa"] - self.problem.perfusion.terminal_pressure_pa) / self.drop_pa
        root = np.ones(int(self.frees_pressure))
        shortest = np.where(self.problem.bounded[self.segments], physics.l_min_mm, 0.0)
        length = np.maximum(smooth, shortest) / self.length_mm
        count = 3 * self.moving.size + self.inner.size
        unbounded = np.full(count, np.inf)
        thinnest = np.full(self.segments.size, -np.inf)
        if physics.r_min_mm > 0.0:
            thinnest = np.log(physics.r_min_mm / self.radius_mm)
        longest, thickest = 2.0 * tree.length_mm[free].max(), 2.0 * tree.radius_mm[free].max()
        widest = np.full(self.segments.size, np.inf) if self.frees_pressure else np.log(thickest / self.radius_mm)
        least = self.problem.stem_loss_pa.max() / self.drop_pa
        self.start = np.concatenate(
            (np.zeros(3 * self.moving.size), pressure[self.inner], root, length, np.zeros(self.segments.size))
        )
        self.lower = np.concatenate((-unbounded, np.full(root.size, least), shortest / self.length_mm, thinnest))
        if physics.r_min_mm > thickest and not self.frees_pressure:
            raise ComputationError(
                f"r_min {physics.r_min_mm:g} mm cannot be held: radii are allowed {thickest:.4g} mm, twice the largest "
                "at the start; lower r_min_mm, or raise the flow, or lower the pressure drop"
            )
        self.upper = np.concatenate((unbounded, root * np.inf, longest / self.length_mm, widest))

    def solution(self, values: np.ndarray, multipliers: np.ndarray, of_rows: np.ndarray, iterations: int) -> Solution:
        """The tree at Ipopt's positions, its radii once more by the recursion: both must agree.

        :raises ComputationError: when they do not.
        """
        problem, m, s = self.problem, self.moving.size, self.segments.size
        position = np.array(problem.position_mm)
        position[self.moving] += self.scale_mm * values[: 3 * m].reshape(3, m).T
        if self.frees_pressure:
            root = float(values[-2 * s - 1]) * self.drop_pa
            pressure = problem.perfusion.terminal_pressure_pa + root
            perfusion = replace(problem.perfusion, root_pressure_pa=pressure)
            given = replace(problem, perfusion=perfusion).at_given_pressure()
        else:
            given = problem
        if problem.walls is not None:
            push = np.maximum(0.0, -of_rows[of_rows.size - self.n_walls :]) * self.unit_mm3 / self.scale_mm
            given = replace(given, walls=replace(problem.walls, pull=push))
        pull = np.zeros(problem.n_nodes)
        pull[self.segments] = np.maximum(0.0, -multipliers[-2 * s : -s]) * self.unit_mm3 / self.length_mm
        found = evaluate(given.at(position), eps=self.eps, pull=pull, n_iterations=iterations)
        if self.eps == 0.0:
            gap = np.abs(self.radius_mm * np.exp(values[-s:]) / found.tree.radius_mm[self.segments] - 1.0).max()
            if gap > _AGREEMENT:
                raise ComputationError(
                    f"Ipopt's radii contradict Poiseuille's and Murray's laws by {gap:.2g}; lower its tolerance"
                )
        cost = found.cost_mm3
        if self.frees_pressure:
            cost += problem.perfusion.flow_mm3_s * root / problem.physics.metabolic_pa_s
        return replace(found, problem=replace(problem, walls=given.walls), cost_mm3=cost)
