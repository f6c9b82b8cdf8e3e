"""Slow, obvious twins of what the solvers of the geometry compute."""

import numpy as np
from scipy.optimize import brentq
from scipy.sparse import lil_matrix
from scipy.sparse.linalg import spsolve

from generator.config import load
from generator.framework import Run
from generator.geometry.problem import Physics, Problem
from generator.geometry.reduced_model import Model
from vascval.core.tree import Topology, Tree


def grown(n: int, seed: int = 1, *changes: str) -> Run:
    """A grown tree in the box of the benchmark."""
    run = Run.of(load("karch-box", [f"n_terminals={n}", f"seed={seed}", *changes]))
    for _ in run.steps():
        pass
    return run


def problem_of(run: Run, **physics) -> Problem:
    tree = run.growth.tree()
    settings = {"l_min_mm": 0.0, **physics}
    return Problem(tree.topology, tree.position_mm, run.config.flow(), Physics(**settings))


def random_problem(parent, rng: np.random.Generator, perfusion, **physics) -> Problem:
    position = rng.normal(size=(len(parent), 3))
    for i in range(1, len(parent)):
        position[i] += 3.0 * position[parent[i]]
    return Problem(Topology(np.array(parent)), position, perfusion, Physics(**{"l_min_mm": 0.0, **physics}))


def radii_by_search(problem: Problem, length: np.ndarray) -> np.ndarray:
    """Radii by bisection in the radius of one stem after the other, down the tree: equal end pressure and Murray's law.

    Given the pressure at its proximal end, a subtree's radii follow from that of its uppermost segment: each child must
    end at the terminal pressure, so its own radius is found the same way; the sum of their powers must match.
    """
    children = [problem.topology.children(i) for i in range(problem.n_nodes)]
    kappa, unit = problem.perfusion.kappa_pa_s, problem.terminal_flow_mm3_s
    radius = np.zeros(problem.n_nodes)

    def needed(i: int, drop: float) -> float:
        """The radius of ``i`` with which the whole pressure drop is used up at the terminals."""
        loss = kappa * unit * problem.below[i] * length[i]
        if children[i].size == 0:
            return (loss / drop) ** 0.25

        def excess(log_radius: float) -> float:
            r = np.exp(log_radius)
            left = drop - loss / r**4
            return r ** problem.gamma[i] - sum(needed(c, left) ** problem.gamma[i] for c in children[i])

        narrowest = 0.25 * np.log(loss / drop)
        return float(np.exp(brentq(excess, narrowest + 1e-12, narrowest + 6.0, xtol=1e-14, rtol=1e-14)))

    def settle(i: int, drop: float) -> None:
        radius[i] = needed(i, drop)
        for c in children[i]:
            settle(int(c), drop - kappa * unit * problem.below[i] * length[i] / radius[i] ** 4)

    for stem in children[0]:
        settle(int(stem), problem.perfusion.pressure_drop_pa)
    return radius


def weights(problem: Problem, tree: Tree) -> np.ndarray:
    """Derivative of the least volume by every length, from the multipliers of the laws of flow.

    The Lagrangian ``sum pi l r^2 + sum a (p_u - p_v - kappa Q l / r^4) + sum b (r_v^gamma - sum r_c^gamma)`` is
    stationary in all inner pressures and radii: a sparse linear system for the multipliers ``a``, ``b``.
    """
    n, parent = problem.n_nodes, problem.topology.parent
    inner = problem.topology.n_children > 0
    inner[0] = False
    row_of = np.cumsum(inner) - 1
    m = int(inner.sum())
    matrix = lil_matrix((n - 1 + m, n - 1 + m))
    right = np.zeros(n - 1 + m)
    flow = problem.below * problem.terminal_flow_mm3_s
    r, length = tree.radius_mm, tree.length_mm
    for i in range(1, n):
        p = parent[i]
        matrix[i - 1, i - 1] = 4 * problem.perfusion.kappa_pa_s * flow[i] * length[i] / r[i] ** 5
        right[i - 1] = -2 * np.pi * length[i] * r[i]
        if inner[i]:
            matrix[i - 1, n - 1 + row_of[i]] = problem.gamma[i] * r[i] ** (problem.gamma[i] - 1)
            matrix[n - 1 + row_of[i], i - 1] = -1.0
        if inner[p]:
            matrix[i - 1, n - 1 + row_of[p]] = -problem.gamma[p] * r[i] ** (problem.gamma[p] - 1)
            matrix[n - 1 + row_of[p], i - 1] = 1.0
    multiplier = spsolve(matrix.tocsc(), right)[: n - 1]
    weight = np.zeros(n)
    weight[1:] = np.pi * r[1:] ** 2 - multiplier * problem.perfusion.kappa_pa_s * flow[1:] / r[1:] ** 4
    return weight


def forces(
    problem: Problem, position: np.ndarray, weight: np.ndarray, hold: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) sum of the pulls at every node, and (N,) of their magnitudes."""
    total, size = np.zeros((problem.n_nodes, 3)), np.zeros(problem.n_nodes)
    for i in range(1, problem.n_nodes):
        p = problem.topology.parent[i]
        step = position[i] - position[p]
        pull = (weight[i] - hold[i]) * step / np.linalg.norm(step)
        total[i] += pull
        total[p] -= pull
        size[[i, p]] += weight[i]
    return total, size


def dense_laplacian(problem: Problem, position, length, weight, bend: float) -> np.ndarray:
    """The tree Laplacian over the nodes that move, as a full matrix."""
    n = problem.n_nodes
    full = np.zeros((n, 3, n, 3))
    for i in range(1, n):
        p = problem.topology.parent[i]
        d = (position[i] - position[p]) / length[i]
        block = weight[i] / length[i] * (np.eye(3) - bend * np.outer(d, d))
        for a, b, sign in ((i, i, 1), (p, p, 1), (i, p, -1), (p, i, -1)):
            full[a, :, b, :] += sign * block
    free = np.flatnonzero(problem.moves)
    return full[free][:, :, free].reshape(3 * free.size, 3 * free.size)


def dense_step(model: Model, position: np.ndarray, gradient: np.ndarray, across, along) -> np.ndarray:
    """What the solver takes off the positions, by full matrices: bounds that the first solve runs into join the second.

    A bound presses with ``pull + bound (shortest - |d|)`` where that is positive.
    """
    problem, parent = model.problem, model.problem.topology.parent
    free = problem.moves
    chord = problem.lengths(position)
    matrix = dense_laplacian(problem, position, np.sqrt(chord**2 + model.eps**2), across, 1.0)
    right = gradient[free].ravel()
    apart = np.zeros((problem.n_nodes, right.size))
    for i in range(1, problem.n_nodes):
        row = np.zeros((problem.n_nodes, 3))
        row[i] = (position[i] - position[parent[i]]) / chord[i]
        row[parent[i]] = -row[i]
        apart[i] = row[free].ravel()
    force = model.pull + model.bound * (problem.physics.l_min_mm - chord)
    pressing = (model.bound > 0.0) & (force > 0.0)
    matrix += apart.T @ ((along + model.bound * pressing)[:, None] * apart)
    first = np.linalg.solve(matrix, right)
    met = (model.bound > 0.0) & ~pressing & (force + model.bound * (apart @ first) > 0.0)
    matrix += apart.T @ ((model.bound * met)[:, None] * apart)
    second = np.linalg.solve(matrix, right - apart.T @ (force * met))
    step = np.zeros_like(gradient)
    step[free] = (second if right @ second > 0.0 else first).reshape(-1, 3)
    return step
