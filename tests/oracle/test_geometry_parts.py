"""Parts of a tree that move alone, against the whole."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from generator.geometry import network, reduced
from generator.geometry.reduced import solve_reduced
from generator.geometry.reduced_model import Model
from generator.haemodynamics import Perfusion
from tests.oracle.geometry_oracle import grown, problem_of, random_problem

PERFUSION = Perfusion(13332.2, 7999.3, 8333.3, 3.6e-3, 2.55)


def at_work(model: Model, position: np.ndarray) -> tuple[float, np.ndarray]:
    return model.cost(position), model.gradient(position)


@settings(deadline=None, max_examples=60)
@given(
    st.integers(0, 9999), st.integers(0, 2), st.sampled_from([(), (2.0, 2.4, 3.0)]), st.sampled_from([0, 2]),
    st.sampled_from([0.0, 1.0]),
)  # fmt: skip
def test_a_part_changes_as_the_whole_does(seed, hops, gammas, n_fixed, shortest):
    """Gradients and differences of the cost, also of a part of a part, below a root tree, with bounds that press."""
    rng = np.random.default_rng(seed)
    parent = [-1, 0] + [int(rng.integers(1, 12)) for _ in range(11)] + [int(rng.integers(2, 13)) for _ in range(30)]
    parent = [-1, 0, *(min(p, i) for i, p in enumerate(parent[2:], 1))]
    problem = random_problem(parent, rng, PERFUSION, gamma_by_generation=gammas)
    fixed = np.full(problem.n_nodes, np.nan)
    fixed[1 : 1 + n_fixed] = 3.0
    fixed[[i for i in range(2, 1 + n_fixed) if parent[i] > n_fixed]] = np.nan
    problem = replace(problem, fixed_radius_mm=fixed)
    model, position = Model(problem), np.array(problem.position_mm)
    model.eps = 0.1
    at_work(model, position)
    if shortest:
        model.physics = replace(model.physics, l_min_mm=float(np.median(model.chord)))
        model.stiffen()
        at_work(model, position)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(network, "_HOPS", hops)
        for depth in (1, 2):
            late = model.moves & (rng.random(model.moves.size) < 0.3)
            if not late.any():
                return
            nodes, part = model.around(late)
            part.physics = model.physics
            assert part.moves.sum() <= model.moves.sum() and late[nodes[part.moves]].sum() == late.sum()
            before, own = at_work(model, position), at_work(part, position[nodes])
            assert own[1][part.moves] == pytest.approx(before[1][nodes[part.moves]], rel=1e-9, abs=1e-11 * before[0])
            moved = position.copy()
            moved[nodes[part.moves]] += rng.normal(scale=0.3, size=(int(part.moves.sum()), 3))
            after, own_after = at_work(model, moved), at_work(part, moved[nodes])
            assert own_after[0] - own[0] == pytest.approx(after[0] - before[0], abs=1e-11 * before[0]), depth
            at = nodes[part.moves]
            assert own_after[1][part.moves] == pytest.approx(after[1][at], rel=1e-8, abs=1e-10 * before[0])
            model, position = part, moved[nodes]


@pytest.mark.parametrize(("n", "large", "few"), [(40, 20, 5), (700, reduced._LARGE, reduced._FEW)])
def test_parts_lead_to_the_optimum_of_the_whole(n, large, few, monkeypatch):
    problem = problem_of(grown(n, 3), l_min_mm=0.3)
    monkeypatch.setattr(reduced, "_LARGE", large)
    monkeypatch.setattr(reduced, "_FEW", few)
    with_parts = solve_reduced(problem)
    monkeypatch.setattr(reduced, "_LARGE", 10**9)
    whole = solve_reduced(problem)
    assert with_parts.n_iterations < whole.n_iterations
    assert with_parts.residual <= 1e-4 >= whole.residual
    # two optima of one start that is not convex, to the tolerance of the forces
    assert with_parts.cost_mm3 == pytest.approx(whole.cost_mm3, rel=1e-6)
