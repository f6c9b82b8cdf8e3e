"""Bifurcations in one place, as a search of topologies may leave them."""

import numpy as np
import pytest

from generator.domain_volume import VoxelDomain
from generator.geometry.admission import Admission, admitted, begun
from generator.geometry.optimise import optimise
from generator.geometry.problem import Physics, Problem
from generator.haemodynamics import Perfusion
from vascval.core.tree import Topology
from vascval.io.volumes import Volume


def test_coincident_bifurcations_are_optimised_in_a_domain_with_walls():
    parent = np.array([-1, 0, 1, 1, 2, 2])
    position = np.array([[0, 5, 5], [4, 5, 5], [4, 5, 5], [9, 1, 5], [9, 9, 4], [9, 6, 6]], dtype=float)
    domain = VoxelDomain(Volume(np.ones((11, 11, 11), np.uint8), np.ones(3)))
    assert not domain.space.convex
    problem = Problem(Topology(parent), position, Perfusion(1600.0, 1066.0, 16_000.0, 0.0036, 3.0), Physics())
    found = optimise(problem, solver="reduced", admission=Admission(domain), contract=False, splitting=False)
    free = optimise(problem, solver="reduced", admission=Admission(), contract=False, splitting=False)
    assert found.tree.length_mm[1:].min() >= 0.0
    # the walls are far from the optimum, so that it is the same with and without them
    assert found.cost_mm3 == pytest.approx(free.cost_mm3, rel=1e-6)


def test_contraction_and_splitting_leave_what_stays_in_one_place():
    parent = np.array([-1, 0, 1, 2, 3, 1, 2, 3, 4, 4])
    position = np.array(
        [[0, 5, 5], [3, 5, 5], [3, 5, 5], [7, 5, 5], [7.01, 5, 5],
         [4, 9, 5], [4, 1, 5], [9, 7, 5], [9, 4, 6.7], [9, 4, 3.3]], dtype=float,
    )  # fmt: skip
    domain = VoxelDomain(Volume(np.ones((11, 11, 11), np.uint8), np.ones(3)))
    held = np.isin(np.arange(10), (1, 2))
    perfusion = Perfusion(1600.0, 1066.0, 16_000.0, 0.0036, 3.0)
    problem = Problem(Topology(parent), position, perfusion, Physics(), held=held)
    found = optimise(problem, solver="reduced", admission=Admission(domain))
    assert found.problem.n_nodes == 9  # 3 and 4 are one, 1 and 2 still two
    assert found.tree.length_mm[2] == 0.0
    assert np.isfinite(found.cost_mm3)


def test_a_bifurcation_where_the_root_tree_ends_leaves_it_though_it_may_not_go_to_its_optimum():
    parent = np.array([-1, 0, 1, 1])
    position = np.array([[0.2, 5, 5], [0.2, 5, 5], [9, 1, 5], [9, 9, 4]], dtype=float)
    domain = VoxelDomain(Volume(np.ones((11, 11, 11), np.uint8), np.ones(3)))
    perfusion = Perfusion(1600.0, 1066.0, 16_000.0, 0.0036, 3.0)
    problem = Problem(Topology(parent), position, perfusion, Physics(l_min_mm=0.2))
    outside = np.array([[0.2, 5, 5], [-60, 5, 5], [9, 1, 5], [9, 9, 4]], dtype=float)
    found = admitted(problem, Admission(domain), lambda given: begun(given.at(outside)))
    assert found.tree.length_mm[1] == pytest.approx(0.2, rel=0.01)
