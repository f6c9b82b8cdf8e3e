"""Geometries that are known: one bifurcation, symmetric trees, scaling laws, Murray's angle."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from generator.config import load
from generator.geometry.full_space import solve_full
from generator.geometry.junctions import contracted, split
from generator.geometry.optimise import optimise
from generator.geometry.problem import Physics, Problem
from generator.geometry.reduced import ReducedOptions, solve_reduced
from generator.geometry.reduced_model import evaluate
from generator.geometry.viscosity import fahraeus_lindqvist_pa_s
from generator.haemodynamics import Perfusion
from tests.oracle.geometry_oracle import grown, problem_of
from vascval.core.contraction import degenerate_segments
from vascval.core.tree import Topology

FINE = ReducedOptions(smoothing=(0.1, 0.01, 1e-6), tolerance=1e-9)
FREE = Physics(l_min_mm=0.0)
SOLVERS = [lambda problem: solve_reduced(problem, FINE), solve_full]


def perfusion(gamma: float, **changes) -> Perfusion:
    given = {
        "root_pressure_pa": 13332.2, "terminal_pressure_pa": 7999.3, "flow_mm3_s": 8333.3, "viscosity_pa_s": 3.6e-3,
    }  # fmt: skip
    return Perfusion(**{**given, **changes}, gamma=gamma)


def fork(gamma: float, a, b, start=(4.0, 0.5, 0.3)) -> Problem:
    places = np.array([(0.0, 0.0, 0.0), start, a, b])
    return Problem(Topology(np.array([-1, 0, 1, 1])), places, perfusion(gamma), FREE)


@pytest.mark.parametrize("solve", SOLVERS)
def test_murray_angles_of_a_symmetric_fork(solve):
    """At gamma 3 each branch leaves at arccos(2^(-1/3)), 37.5 degrees, from the axis (Murray 1926)."""
    found = solve(fork(3.0, (20.0, 6.0, 0.0), (20.0, -6.0, 0.0)))
    # flat at the minimum: a tolerance of 1e-9 in the forces is 1e-7 in the place; Ipopt smooths by 1e-3 of the length
    assert found.position_mm[1] == pytest.approx([20 - 6 / np.tan(np.arccos(2 ** (-1 / 3))), 0.0, 0.0], abs=1e-4)


@pytest.mark.parametrize("solve", SOLVERS)
@pytest.mark.parametrize("gamma", [2.0, 2.55, 3.0])
def test_one_fork_against_its_formula(solve, gamma):
    """The volume of a fork written out, minimised over the place of the node by a general method."""
    ends = np.array([(20.0, 6.0, 0.0), (14.0, -9.0, 2.0)])
    problem = fork(gamma, *ends)

    def volume(place: np.ndarray) -> float:
        l0, (l1, l2) = np.linalg.norm(place), np.linalg.norm(ends - place, axis=1)
        s = l1 ** (gamma / 4) + l2 ** (gamma / 4)
        law = problem.perfusion
        scale = np.pi * np.sqrt(law.kappa_pa_s * problem.terminal_flow_mm3_s / law.pressure_drop_pa)
        return scale * np.sqrt(2 * l0 + s ** (4 / gamma)) * (l0 + (l1**1.5 + l2**1.5) / s ** (2 / gamma))

    best = minimize(volume, problem.position_mm[1], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12})
    found = solve(problem)
    # both stop where the volume is flat to rounding, 1e-8 of the place; Ipopt smooths lengths by 1e-3 of their mean
    assert found.cost_mm3 == pytest.approx(best.fun, rel=1e-7)
    assert found.position_mm[1] == pytest.approx(best.x, abs=1e-3)


@pytest.mark.parametrize("solve", SOLVERS)
def test_a_symmetric_tree_stays_symmetric(solve):
    """Four terminals at the corners of a rectangle: two mirror planes, from a start that breaks both."""
    places = np.array(
        [(0.0, 0, 0), (4, 1, 0), (7, 4, 1), (8, -5, -1), (20, 9, 3), (20, 9, -3), (20, -9, 3), (20, -9, -3)]
    )
    problem = Problem(Topology(np.array([-1, 0, 1, 1, 2, 2, 3, 3])), places, perfusion(2.55), FREE)
    found = solve(problem).position_mm
    # flat at the minimum, see above
    assert found[1, 1:] == pytest.approx([0.0, 0.0], abs=1e-3)
    assert found[2] == pytest.approx(found[3] * [1, -1, 1], abs=1e-3)
    assert found[2, 2] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(
    ("flow", "viscosity", "pressure", "size"), [(4.0, 1, 1, 1), (1, 9.0, 1, 1), (1, 1, 4.0, 1), (1, 1, 1, 4.0)]
)
def test_scaling(flow, viscosity, pressure, size):
    """The volume goes with the root of flow and viscosity, against that of pressure, and with length^1.5."""
    problem = problem_of(grown(120))
    law = problem.perfusion
    changed = replace(
        law, flow_mm3_s=flow * law.flow_mm3_s, viscosity_pa_s=viscosity * law.viscosity_pa_s,
        root_pressure_pa=law.terminal_pressure_pa + pressure * law.pressure_drop_pa,
    )  # fmt: skip
    factor = np.sqrt(flow * viscosity / pressure) * size**1.5
    scaled = Problem(problem.topology, size * problem.position_mm, changed, FREE)
    assert evaluate(scaled).cost_mm3 == pytest.approx(factor * evaluate(problem).cost_mm3, rel=1e-12)
    # forces are balanced to 1e-4, the cost is then least to about its square; the line search may round otherwise
    assert solve_reduced(scaled).cost_mm3 == pytest.approx(factor * solve_reduced(problem).cost_mm3, rel=1e-5)


def test_volume_plus_power_has_the_geometry_of_volume_alone():
    """With one stem the least cost over the pressure goes with (rho v^2)^(1/3): its minimum is that of rho v^2.

    There power costs half of what the volume does.
    """
    problem = problem_of(grown(80), l_min_mm=0.2)
    volume = solve_reduced(problem)
    both = solve_reduced(replace(problem, physics=replace(problem.physics, objective="volume+power")))
    # each solved to forces of 1e-4: errors of the place of 1e-3, of the cost of its square
    assert both.position_mm == pytest.approx(volume.position_mm, abs=2e-2)
    assert both.cost_mm3 == pytest.approx(1.5 * both.tree.volume_mm3, rel=1e-9)
    drop = both.tree.columns["pressure_pa"][0] - problem.perfusion.terminal_pressure_pa
    power = problem.perfusion.flow_mm3_s * drop / problem.physics.metabolic_pa_s
    assert both.cost_mm3 == pytest.approx(both.tree.volume_mm3 + power, rel=1e-9)


def test_viscosity():
    """The formula: 3.6 cP in wide vessels, a fall as they narrow, a rise where cells no longer fit."""
    radius = np.array([50.0, 1.0, 0.1, 0.02, 0.003])
    k = (radius / (radius - 0.00055)) ** 2
    expected = 1.125 * (k + k**2 * (6 * np.exp(-170 * radius) - 2.44 * np.exp(-8.09 * radius**0.64) + 2.2))
    assert fahraeus_lindqvist_pa_s(radius) == pytest.approx(expected * 1e-3, rel=1e-12)
    assert fahraeus_lindqvist_pa_s(np.array([50.0]))[0] == pytest.approx(3.6e-3, rel=1e-3)
    assert expected[1] > expected[2] > expected[3] < expected[4]


def test_a_degenerate_segment_is_contracted_and_split_again():
    """Two nodes that lie on top of each other become one; its best split is found again, or there is none."""
    places = np.array([(0.0, 0, 0), (10, 0, 0), (10.01, 0.01, 0), (30, 9, 0), (30, 0, 1), (30, -9, 0)])
    problem = Problem(Topology(np.array([-1, 0, 1, 1, 2, 2])), places, perfusion(3.0), FREE)
    begin = evaluate(problem)
    made = contracted(begin)
    assert made is not None
    smaller, heir = made
    assert smaller.topology.parent.tolist() == [-1, 0, 1, 1, 1]
    assert heir.tolist() == [0, 1, 1, 2, 3, 4]
    merged = solve_reduced(smaller)
    again = split(merged)
    assert again is not None
    assert again.n_nodes == 6
    assert solve_reduced(again).cost_mm3 < merged.cost_mm3


def test_optimised_trees_have_no_degenerate_segments():
    for solver in ("reduced", "ipopt"):
        found = optimise(problem_of(grown(150), l_min_mm=0.2), solver=solver)
        assert degenerate_segments(found.tree).size == 0
        assert (found.tree.topology.n_children[1:] > 2).sum() >= 5
        assert found.tree.topology.n_terminals == 150


def test_interval_of_optimisations_during_growth():
    given = load("karch-box").geometry
    assert [given.interval(n) for n in (1, 999, 1000, 5000, 25_000, 10**6)] == [20, 20, 20, 100, 500, 500]
