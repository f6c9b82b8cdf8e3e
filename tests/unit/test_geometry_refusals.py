"""What the geometry refuses, and how it says so."""

from dataclasses import replace

import numpy as np
import pytest

from generator.config import load
from generator.framework import Run
from generator.geometry.admission import Admission
from generator.geometry.full_space import FullOptions, solve_full
from generator.geometry.optimise import optimise
from generator.geometry.problem import Physics, Problem
from generator.geometry.reduced import ReducedOptions, solve_reduced
from generator.geometry.viscosity import fahraeus_lindqvist_pa_s
from generator.haemodynamics import Perfusion
from tests.oracle.geometry_oracle import grown, problem_of
from vascval.core.errors import ComputationError, InputError
from vascval.core.tree import Topology

NAN = np.nan
PERFUSION = Perfusion(13332.2, 7999.3, 8333.3, 3.6e-3, 2.55)
FORK = Topology(np.array([-1, 0, 1, 1]))
PLACES = np.array([[0.0, 0, 0], [5, 0, 0], [9, 3, 0], [9, -4, 0]])


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"position_mm": np.where(PLACES == 5, np.nan, PLACES)}, InputError, "1 nodes have a posi.*node 1"),
        ({"position_mm": PLACES[:3]}, InputError, r"shape \(3, 3\); \(4, 3\) is needed"),
        ({"topology": Topology(np.array([-1])), "position_mm": PLACES[:1]}, InputError, "no segment"),
        ({"fixed_radius_mm": [NAN, -1, NAN, NAN]}, InputError, "not positive .first: segment 1"),
        ({"fixed_radius_mm": [NAN, NAN, 1.0, NAN]}, InputError, "spring from a free one .first: segment 2"),
        ({"fixed_radius_mm": [NAN, 0.2, NAN, NAN]}, ComputationError, "root tree contradicts the flow"),
        ({"held": np.zeros(2, bool)}, InputError, "have shapes"),
    ],
)
def test_a_problem_that_makes_no_sense(changes, error, message):
    with pytest.raises(error, match=message):
        Problem(**{"topology": FORK, "position_mm": PLACES, "perfusion": PERFUSION, **changes})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"l_min_mm": -1.0}, "l_min_mm is -1.0"),
        ({"r_min_mm": np.nan}, "r_min_mm is nan"),
        ({"metabolic_pa_s": 0.0}, "a positive number is needed"),
        ({"gamma_by_generation": (2.5, 3.5)}, "from 2 to 3"),
    ],
)
def test_physics_that_makes_no_sense(changes, message):
    with pytest.raises(InputError, match=message):
        Physics(**changes)


def test_given_points_closer_than_the_bound():
    with pytest.raises(ComputationError, match=r"1 segments between two given points are shorter than l_min 9 mm"):
        Problem(Topology(np.array([-1, 0])), PLACES[:2], PERFUSION, Physics(l_min_mm=9.0))


def test_lengths_that_cannot_be_held():
    with pytest.raises(ComputationError, match=r"l_min 30 mm cannot be held: segments are allowed 11.31 mm"):
        Problem(FORK, PLACES, PERFUSION, Physics(l_min_mm=30.0))


def test_radii_that_are_too_thin():
    problem = problem_of(grown(100), r_min_mm=0.3)
    with pytest.raises(ComputationError, match=r"thinner than r_min 0.3 mm .segment \d+: 0\.\d+ mm.; lower r_min_mm"):
        solve_reduced(problem)


@pytest.mark.parametrize(("r_min_mm", "message"), [(9.0, "r_min 9 mm cannot be held: radii"), (0.9, "Ipopt found no")])
def test_a_bound_on_radii_that_contradicts_the_pressure(r_min_mm, message):
    with pytest.raises(ComputationError, match=message):
        solve_full(problem_of(grown(100), r_min_mm=r_min_mm, l_min_mm=0.2), FullOptions(max_iterations=200))


def test_a_search_that_is_cut_short():
    problem = problem_of(grown(100), l_min_mm=0.2)
    with pytest.raises(ComputationError, match=r"did not converge in .* steps: .* being asked for"):
        solve_reduced(problem, ReducedOptions(max_steps=2, smoothing=(0.5, 0.001), rough=0.1))
    with pytest.raises(ComputationError, match="Maximum_Iterations_Exceeded after 2 iterations"):
        solve_full(problem, FullOptions(max_iterations=2))


def test_viscosity_by_radius_with_power_is_left_to_the_full_space():
    problem = problem_of(grown(30), viscosity="fahraeus-lindqvist", objective="volume+power")
    with pytest.raises(InputError, match=r"geometry\.solver=ipopt"):
        solve_reduced(problem)


def test_a_tree_that_offends_at_the_start():
    problem = problem_of(grown(400))
    with pytest.raises(ComputationError, match="leave the domain or overlap others before the geometry is optimised"):
        optimise(problem, admission=Admission(apart=1.0))


def test_lengths_that_push_out_of_the_domain():
    """In a box 16 mm high; without them, nodes lie between their neighbours."""
    run = Run.of(load("karch-box", ["n_terminals=30", "method=geometry", "geometry.l_min_mm=20"]))
    with pytest.raises(ComputationError, match=r"segments leave the domain .* lower geometry\.l_min_mm"):
        list(run.steps())


def test_radii_beyond_the_formula_of_viscosity():
    with pytest.raises(InputError, match="beyond the formula of viscosity"):
        fahraeus_lindqvist_pa_s(np.array([0.1, 0.001]))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("viscosity=fahraeus-lindqvist", "growth alone knows constant viscosity"),
        ("geometry.solver=newton", "geometry.solver: input should be 'reduced' or 'ipopt'"),
        ("geometry.l_min_mm=-1", "geometry.l_min_mm: input should be greater"),
        ("geometry.every=0", "geometry.every: input should be greater"),
    ],
)
def test_configuration(change, message):
    with pytest.raises(InputError, match=message):
        load("karch-box", [change])


def test_terminals_that_coincide_with_the_node_have_no_length():
    places = PLACES.copy()
    places[1] = places[2]
    problem = Problem(FORK, places, PERFUSION, Physics(l_min_mm=0.0), held=np.ones(4, bool))
    with pytest.raises(InputError, match=r"1 terminals have no length .first: segment 2"):
        solve_reduced(replace(problem))
