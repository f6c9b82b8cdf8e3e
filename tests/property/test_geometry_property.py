"""What holds for the optimal geometry of any tree."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from generator.geometry.junctions import contracted
from generator.geometry.optimise import optimise
from generator.geometry.problem import Physics, Problem
from generator.geometry.reduced import solve_reduced
from generator.geometry.reduced_model import evaluate
from generator.haemodynamics import Perfusion, perfused_tree
from vascval.core.tree import Topology


@st.composite
def problems(draw):
    """Trees of 2 to 16 terminals in a unit box of 40 mm, two to four branches at each node, gamma from 2 to 3."""
    parent = [-1, 0, 1, 1]
    while len(parent) < 24 and draw(st.integers(0, 3)):
        leaf = draw(st.sampled_from([i for i in range(2, len(parent)) if i not in parent]))
        parent += [leaf] * draw(st.integers(2, 4))
    rng = np.random.default_rng(draw(st.integers(0, 9999)))
    position = 40.0 * rng.random((len(parent), 3))
    law = Perfusion(13332.2, 7999.3, 8333.3, 3.6e-3, draw(st.floats(2.0, 3.0)))
    return Problem(Topology(np.array(parent)), position, law, Physics(l_min_mm=draw(st.sampled_from([0.0, 0.5]))))


@settings(deadline=None, max_examples=40)
@given(problems())
def test_least_volume(problem):
    """The optimum is no worse than the start nor than small moves away from it, and moves no given point."""
    begin, found = evaluate(problem), solve_reduced(problem)
    stay = ~problem.moves
    assert (found.position_mm[stay] == problem.position_mm[stay]).all()
    if problem.physics.l_min_mm == 0.0:
        assert found.cost_mm3 <= begin.cost_mm3 * (1 + 1e-9)
    assert found.violation <= 2e-6
    lower, upper = problem.position_mm[stay].min(axis=0), problem.position_mm[stay].max(axis=0)
    if problem.physics.l_min_mm == 0.0:  # strings under tension stay in the hull of what holds them
        assert (found.position_mm >= lower - 1e-3).all()
        assert (found.position_mm <= upper + 1e-3).all()
    rng = np.random.default_rng(0)
    for _ in range(5):
        step = rng.normal(size=(problem.n_nodes, 3)) * problem.moves[:, None]
        moved = problem.lengths(found.position_mm + 0.1 * step)
        if problem.physics.l_min_mm == 0.0 and moved[1:].min() > 0.0:
            other = evaluate(problem.at(found.position_mm + 0.1 * step)).cost_mm3
            assert other > found.cost_mm3 * (1 - 1e-4)  # the smoothing of 1e-3 mean lengths and forces of 1e-4


@settings(deadline=None, max_examples=25)
@given(problems())
def test_contraction_ends(problem):
    """After the whole stage nothing is degenerate, all terminals are there, and growth's recursion finds the radii."""
    found = optimise(problem)
    assert contracted(found) is None
    terminals = found.position_mm[found.tree.topology.terminals]
    given_ends = problem.position_mm[problem.topology.terminals]
    assert sorted(map(tuple, terminals)) == sorted(map(tuple, given_ends))
    again = perfused_tree(found.problem.topology, found.position_mm, problem.perfusion)
    assert np.allclose(found.tree.radius_mm, again.radius_mm, rtol=1e-12, atol=0.0)
