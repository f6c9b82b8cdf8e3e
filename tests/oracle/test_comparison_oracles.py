"""Location, territories and effect sizes against slow twins that follow their definitions word by word."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_trees import generations, trees
from scipy.spatial import cKDTree

from vascval.comparison.distributions import _row
from vascval.comparison.location import CHANCE_POINTS, LocationRule, locate, sample_centrelines
from vascval.comparison.territories import _overlap, territories
from vascval.core.ordering import generation
from vascval.core.tree import Topology, Tree
from vascval.morphometry.hull import convex_hull, grid_inside

few = settings(max_examples=40, deadline=None, derandomize=True)
branching = trees(max_segments=16, chains=False)


def with_generations(tree):
    return tree.with_columns(generation=generation(tree.topology))


def to_line(x, line):
    best = math.inf
    for a, b in itertools.pairwise(line):
        t = np.clip((x - a) @ (b - a) / max((b - a) @ (b - a), 1e-300), 0, 1)
        best = min(best, np.linalg.norm(x - a - t * (b - a)))
    return best


def along(line, arc):
    """The point at an arc length, walked piece by piece."""
    for a, b in itertools.pairwise(line):
        step = np.linalg.norm(b - a)
        if arc <= step:
            return a + (b - a) * arc / step
        arc -= step
    return line[-1]


@few
@given(trees(max_segments=10), st.floats(0.05, 3.0))
def test_samples_divide_each_segment_equally(tree, step):
    samples = sample_centrelines(tree, step)
    expected = []
    for i in range(1, tree.n_nodes):
        n = max(math.ceil(tree.length_mm[i] / step), 1)
        expected += [along(tree.polyline(i), (k + 0.5) * tree.length_mm[i] / n) for k in range(n)]
        assert (samples.segment == i).sum() == n
        assert samples.length_mm[samples.segment == i].sum() == pytest.approx(tree.length_mm[i], rel=1e-12)
    np.testing.assert_allclose(samples.points, expected, rtol=0, atol=1e-9)  # the arc runs over the whole array


@few
@given(branching, branching, st.integers(0, 2), st.floats(0.1, 2.0))
def test_location_by_its_definition(cast, tree, window, tolerance):
    cast, tree = with_generations(cast), with_generations(tree)
    rule = LocationRule(0.5, tolerance, window, 0.5)
    result = locate(cast, tree, rule)
    for name, one, other in (("cast", cast, tree), ("tree", tree, cast)):
        of_one, of_other = generations(one), generations(other)
        samples = sample_centrelines(one, 0.5)
        for row in result.generations.to_dict("records"):
            g = row["generation"]
            like = [i for i in range(1, other.n_nodes) if abs(of_other[i] - g) <= window]
            here = [k for k in range(len(samples.segment)) if of_one[samples.segment[k]] == g]
            length = samples.length_mm[here]
            assert row[f"{name}_length_mm"] == pytest.approx(length.sum(), rel=1e-12, abs=1e-12)
            if not here:
                assert math.isnan(row[f"{name}_matched_share"])
                continue
            near = [min((to_line(samples.points[k], other.polyline(i)) for i in like), default=math.inf) for k in here]
            hit = [d <= max(tolerance, one.radius_mm[samples.segment[k]]) for d, k in zip(near, here)]
            # sums of some tens of numbers of order 1
            assert row[f"{name}_matched_share"] == pytest.approx(np.average(hit, weights=length), abs=1e-12)
            if like:
                assert row[f"{name}_distance_mean_mm"] == pytest.approx(np.average(near, weights=length), abs=1e-9)
                assert row[f"{name}_distance_max_mm"] == pytest.approx(max(near), abs=1e-9)
            else:
                assert math.isnan(row[f"{name}_distance_mean_mm"])
    shares = result.generations["cast_matched_share"].tolist()
    down_to = 0
    while down_to < len(shares) and shares[down_to] >= 0.5:
        down_to += 1
    assert result.matched_down_to_generation == down_to


@pytest.mark.parametrize("window", [0, 1])
@pytest.mark.parametrize("seed", [1, 2])
def test_chance_by_its_definition(seed, window):
    rng = np.random.default_rng(seed)
    parent = np.array([-1, 0, *np.repeat(np.arange(1, 16), 2)])
    cast, tree = (
        with_generations(Tree(Topology(parent), rng.normal(size=(32, 3)), rng.uniform(0.05, 0.4, 32))) for _ in "ab"
    )
    tissue = grid_inside(*(convex_hull(side.position_mm) for side in (cast, tree)), n_points=CHANCE_POINTS)
    table = locate(cast, tree, LocationRule(0.5, 0.2, window, 0.5)).generations
    of_cast, of_tree = generations(cast), generations(tree)
    assert len(tissue) > 1000 and table["generation"].tolist() == [1, 2, 3, 4, 5]
    for row in table.to_dict("records"):
        near = np.full(len(tissue), np.inf)
        for i in range(1, 32):
            if abs(of_tree[i] - row["generation"]) <= window:
                begin, step = tree.position_mm[parent[i]], tree.position_mm[i] - tree.position_mm[parent[i]]
                t = np.clip((tissue - begin) @ step / (step @ step), 0, 1)[:, None]
                near = np.minimum(near, np.linalg.norm(tissue - begin - t * step, axis=1))
        here = [i for i in range(1, 32) if of_cast[i] == row["generation"]]
        share = [(near <= max(0.2, cast.radius_mm[i])).mean() for i in here]
        # a point or two of some thousand may lie within round-off of the tolerance
        assert row["cast_chance_share"] == pytest.approx(np.average(share, weights=cast.length_mm[here]), abs=1e-3)


@few
@given(branching, branching)
def test_territories_by_their_definition(cast, tree):
    cast, tree = with_generations(cast), with_generations(tree)
    result = territories(cast, tree, generations=3, n_points=300)
    hulls = [convex_hull(side.position_mm[side.topology.terminals]) for side in (cast, tree)]
    if None in hulls or not len(tissue := grid_inside(*hulls, n_points=300)):
        assert result is None
        return
    assert result is not None and result.n_points == len(tissue)
    for row in result.generations.to_dict("records"):
        owners = []
        for side in (cast, tree):
            of = generations(side)
            tips = side.topology.terminals
            owner = []
            for tip in tips[cKDTree(side.position_mm[tips]).query(tissue)[1]]:
                path = [int(tip)]
                while side.parent[path[0]] > 0:
                    path.insert(0, int(side.parent[path[0]]))
                owner.append(next(i for i in path if of[i] >= row["generation"]))
            owners.append(owner)
        sets = [{name: {k for k, o in enumerate(owner) if o == name} for name in owner} for owner in owners]
        assert (row["n_cast"], row["n_tree"]) == (len(sets[0]), len(sets[1]))
        fewer, more = sorted((list(s.values()) for s in sets), key=len)
        if len(more) > 6:
            continue
        best = max(sum(len(a & b) for a, b in zip(fewer, p)) for p in itertools.permutations(more, len(fewer)))
        assert row["dice"] == pytest.approx(best / len(tissue), rel=1e-12)


@few
@given(st.lists(st.integers(0, 5), min_size=5, max_size=30), st.lists(st.integers(0, 5), min_size=5, max_size=30))
def test_effect_size_counts_pairs(a, b):
    row = _row(np.array(a, float), np.array(b, float), 5)
    delta = sum((y > x) - (y < x) for x in a for y in b) / (len(a) * len(b))
    assert row[-1] == pytest.approx(delta, abs=1e-12)
    levels = range(6)
    cdf = [[sum(v <= level for v in values) / len(values) for level in levels] for values in (a, b)]
    area = sum(abs(x - y) for x, y in zip(*cdf))  # between the two distribution functions, steps of 1
    assert row[6] == pytest.approx(area, abs=1e-12)


def test_overlap_of_partitions_by_hand():
    a = np.array([1, 1, 1, 1, 2, 2, 2, 2])
    b = np.array([7, 7, 7, 9, 9, 9, 8, 8])
    # pairs 1-7 (3 points) and 2-8 or 2-9 (2 points): 5 of 8; Dice 6/7 and 4/6 (2-8) or 4/7 (2-9)
    n_cast, n_tree, n_matched, dice, dice_mean = _overlap(a, b)
    assert (n_cast, n_tree, n_matched, dice) == (2, 3, 2, 5 / 8)
    assert dice_mean in (pytest.approx((6 / 7 + 4 / 6) / 2), pytest.approx((6 / 7 + 4 / 7) / 2))
