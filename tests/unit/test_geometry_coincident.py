"""Bifurcations in one place, as a search of topologies may leave them."""

import numpy as np
import pytest

from generator.domain_volume import VoxelDomain
from generator.geometry.admission import Admission
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
