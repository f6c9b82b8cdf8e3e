"""The sweeps of the geometry against slow twins: radii, gradients, the tree Laplacian, splits, overlaps."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from generator.geometry import _reduced_kernels as kernels
from generator.geometry.admission import Admission
from generator.geometry.junctions import split_gains
from generator.geometry.optimise import optimise
from generator.geometry.problem import Physics, Problem
from generator.geometry.reduced import solve_reduced
from generator.geometry.reduced_model import Model, evaluate
from generator.haemodynamics import Perfusion
from tests.oracle.geometry_oracle import (
    dense_laplacian,
    dense_step,
    forces,
    grown,
    problem_of,
    radii_by_search,
    random_problem,
    weights,
)
from vascval.core.tree import Topology
from vascval.morphometry.overlaps import overlapping_pairs

PERFUSION = Perfusion(13332.2, 7999.3, 8333.3, 3.6e-3, 2.55)
PHYSICS = [
    {},
    {"viscosity": "fahraeus-lindqvist"},
    {"gamma_by_generation": (2.1, 2.6, 3.0)},
    {"objective": "volume+power"},
]


@st.composite
def parents(draw, largest=14):
    """Trees whose inner nodes have two to four children; the root has one or more."""
    parent = [-1] + [0] * draw(st.integers(1, 2))
    while len(parent) <= largest and draw(st.booleans()):
        leaf = draw(st.sampled_from([i for i in range(1, len(parent)) if i not in parent]))
        parent += [leaf] * draw(st.integers(2, 4))
    return parent


@settings(deadline=None, max_examples=25)
@given(parents(largest=9), st.integers(0, 999), st.sampled_from([(), (2.0, 2.4, 3.0)]))
def test_radii_are_those_that_use_up_the_pressure(parent, seed, gammas):
    problem = random_problem(parent, np.random.default_rng(seed), PERFUSION, gamma_by_generation=gammas)
    tree = evaluate(problem).tree
    expected = radii_by_search(problem, problem.lengths(problem.position_mm))
    # bisection to 1e-14 at every level, each divided by what is left of the pressure: 1e-8 is met with room
    assert tree.radius_mm[1:] == pytest.approx(expected[1:], rel=1e-8)


@settings(deadline=None, max_examples=30)
@given(parents(), st.integers(0, 999), st.sampled_from(PHYSICS), st.sampled_from([0.0, 0.3]))
def test_gradient_is_the_central_difference(parent, seed, physics, eps):
    rng = np.random.default_rng(seed)
    problem = random_problem(parent, rng, PERFUSION, **physics)
    model = Model(problem)
    model.eps = eps
    position = np.array(problem.position_mm)
    model.cost(position)
    gradient = model.gradient(position).copy()
    direction = rng.normal(size=position.shape) * problem.moves[:, None]
    h = 1e-6
    slope = (model.cost(position + h * direction) - model.cost(position - h * direction)) / (2 * h)
    # truncation, of the order of h^2, stays below 1e-6 of the terms that are summed; rounding is 1e-15 of the cost
    slack = 3e-6 * np.abs(gradient * direction).sum() + 1e-15 * model.cost(position) / h
    assert (gradient * direction).sum() == pytest.approx(slope, abs=slack)


@settings(deadline=None, max_examples=25)
@given(parents(), st.integers(0, 999))
def test_weights_are_the_multipliers_of_the_laws_of_flow(parent, seed):
    problem = random_problem(parent, np.random.default_rng(seed), PERFUSION)
    model = Model(problem)
    position = np.array(problem.position_mm)
    model.cost(position)
    model.gradient(position)
    expected = weights(problem, model.tree(position))
    # two exact methods; the sparse solve loses some digits to scales of r^-5
    assert model.slope[1:] == pytest.approx(expected[1:], rel=1e-6, abs=1e-9 * expected.max())


@settings(deadline=None, max_examples=30)
@given(parents(), st.integers(0, 999), st.sampled_from([0.0, 0.9]))
def test_laplacian_is_solved_without_fill_in(parent, seed, bend):
    rng = np.random.default_rng(seed)
    problem = random_problem(parent, rng, PERFUSION)
    n, position = problem.n_nodes, np.array(problem.position_mm)
    length, weight = problem.lengths(position), rng.uniform(0.1, 2.0, n)
    chord, rhs, out = length.copy(), rng.normal(size=(n, 3)), np.zeros((n, 3))
    kernels.solve_laplacian(
        problem.topology.parent, position, problem.moves, chord, length, weight, np.zeros(n), bend, rhs,
        np.zeros((n, 6)), np.zeros((n, 6)), out,
    )  # fmt: skip
    assert (out[~problem.moves] == 0.0).all()
    if problem.moves.any():
        matrix = dense_laplacian(problem, position, length, weight, bend)
        expected = np.linalg.solve(matrix, rhs[problem.moves].ravel()).reshape(-1, 3)
        # direct solves of matrices of condition below 1e6
        assert out[problem.moves] == pytest.approx(expected, rel=1e-8, abs=1e-8)


@settings(deadline=None, max_examples=40)
@given(parents(), st.integers(0, 999), st.sampled_from([0.3, 1.0, 3.0]))
def test_step_is_that_of_full_matrices(parent, seed, shortest):
    """From a first step on, so that along segments the change of the slope counts that it has shown."""
    problem = random_problem(parent, np.random.default_rng(seed), PERFUSION)
    limit = min(shortest, 1.9 * problem.lengths(problem.position_mm).max())
    held = problem.topology.n_children == 0
    problem = replace(problem, physics=Physics(l_min_mm=limit), held=held)
    if not problem.moves.any() or (problem.lengths(problem.position_mm)[~problem.bounded][1:] < limit).any():
        return
    model, position = Model(problem), np.array(problem.position_mm)
    model.eps = 0.1
    model.cost(position)
    model.gradient(position)
    model.stiffen()
    model.cost(position)
    first = model.step(position, model.gradient(position))
    length, slope = model.length.copy(), model.slope.copy()
    further = position - 0.1 * first
    model.cost(further)
    gradient = model.gradient(further)
    step = model.step(further, gradient)
    stiff = np.maximum(model.slope, 1e-9) / np.maximum(model.length, 1e-300)
    moved = np.abs(model.length - length) > 1e-7 * model.length
    change = (model.slope - slope)[moved] / (model.length - length)[moved]
    along = model.along.copy()
    along[moved] = np.clip(change, 0.01 * stiff[moved], 2.0 * stiff[moved])
    across = np.maximum(model.slope - model.hold, 0.05 * model.slope)
    expected = dense_step(model, further, gradient, across, along)
    # bounds are stiff: matrices of condition up to 1e8
    assert step == pytest.approx(expected, rel=1e-6, abs=1e-6 * np.abs(expected).max())


def test_forces_balance_at_every_free_node():
    """First-order optimality, with weights and forces by the slow twins."""
    problem = problem_of(grown(200), l_min_mm=0.2)
    found = solve_reduced(problem)
    weight = weights(problem, found.tree)
    total, size = forces(problem, found.position_mm, weight, found.pull)
    held = found.pull > 0.0
    # what a bound pushes with is only where the bound is reached, to the tolerance of the bound
    assert (found.tree.length_mm[held] <= 0.2 * (1 + 1e-5)).all()
    assert found.tree.length_mm[1:].min() >= 0.2 * (1 - 2e-6)
    # the solver's tolerance is 1e-4, and its lengths are smoothed by 1e-3 of their mean
    assert (np.linalg.norm(total, axis=1) / size)[problem.moves].max() < 3e-4


def test_subgradient_at_merged_nodes():
    """Where a segment has vanished the others at its end pull no harder than its own tension could hold.

    Without lower bounds; with the weights of the slow twin, taken at the true lengths.
    """
    problem = problem_of(grown(500), l_min_mm=0.0)
    found = solve_reduced(problem)
    length, parent = found.tree.length_mm, problem.topology.parent
    vanished = (length < 0.02 * length[1:].mean()) & (problem.topology.n_children > 0)
    vanished[0] = False
    alone = vanished & ~np.isin(np.arange(parent.size), parent[vanished])
    alone &= ~(vanished[parent] | (np.bincount(parent[1:][length[1:] < 0.05], minlength=parent.size) > 0))
    assert alone.sum() > 10
    weight = weights(problem, found.tree)
    direction = (found.position_mm - found.position_mm[parent]) / np.maximum(length, 1e-300)[:, None]
    for i in np.flatnonzero(alone):
        children = problem.topology.children(i)
        pull = np.linalg.norm((weight[children, None] * direction[children]).sum(axis=0))
        # forces are balanced to 1e-4 of their sum, some three times the weight; smoothing changes weights by less
        assert pull <= weight[i] * (1 + 2e-3)


def test_gain_of_a_split_is_the_derivative():
    """Splitting off a group by a short new segment changes the volume by the stated gain per millimetre."""
    solution = optimise(problem_of(grown(150)), splitting=False)
    gains = split_gains(solution)
    assert len(gains) > 5
    problem, tested = solution.problem, 0
    for v, group, gain, radius in gains[:10]:
        force = np.zeros(3)
        weight = weights(problem, solution.tree)
        for c in group:
            step = solution.position_mm[c] - solution.position_mm[v]
            force += weight[c] * step / np.linalg.norm(step)
        length = 1e-4
        parent = np.insert(problem.topology.parent, v + 1, v).astype(int)
        parent[v + 2 :] = np.where(parent[v + 2 :] > v, parent[v + 2 :] + 1, parent[v + 2 :])
        for c in group:
            parent[c + 1] = v + 1
        start = solution.position_mm[v] + length * force / np.linalg.norm(force)
        position = np.insert(solution.position_mm, v + 1, start, axis=0)
        split = evaluate(Problem(Topology(parent), position, problem.perfusion, problem.physics))
        # one-sided difference over 1e-4 mm: curvature 1 / (shortest branch, above 0.1 mm) leaves per mille of the force
        assert split.cost_mm3 - solution.cost_mm3 == pytest.approx(
            -gain * length, abs=2e-3 * length * np.linalg.norm(force)
        )
        assert split.tree.radius_mm[v + 1] == pytest.approx(radius, rel=1e-3)
        tested += 1
    assert tested == min(10, len(gains))


def test_overlaps_are_those_that_the_analysis_counts():
    run = grown(400)
    tree, problem = run.tree(), problem_of(run)
    expected = np.zeros(tree.n_nodes, bool)
    expected[np.unique(overlapping_pairs(tree))] = True
    assert expected.sum() > 20
    assert (Admission(apart=1.0).offending(problem, tree) == expected).all()
