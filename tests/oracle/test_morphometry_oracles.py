"""Each compiled or vectorised measure against a slow twin that follows its definition word by word."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_trees import children, generations, order, trees
from scipy.optimize import brentq
from scipy.spatial import Delaunay

from vascval.core.ordering import strahler_order
from vascval.morphometry import Monopodial, analyze
from vascval.morphometry.hull import convex_hull, grid_inside
from vascval.morphometry.junctions import angles
from vascval.morphometry.overlaps import overlapping_pairs
from vascval.morphometry.pieces import pieces
from vascval.morphometry.preparation import merge_chains

few = settings(max_examples=60, deadline=None, derandomize=True)
branching = trees(chains=False)


def measured(tree, **options):
    """The analysis without contraction, so that its segments are those of the tree."""
    return analyze(tree, source="random", diameters=0.0, **options)


def mean(values):
    return sum(values) / len(values) if values else math.nan


def sd(values):
    return math.sqrt(sum((v - mean(values)) ** 2 for v in values) / (len(values) - 1)) if len(values) > 1 else math.nan


def piece_distance(p, q, r, s):
    """Distance of two line pieces: the closest pair is inside both, or has an end of one of them."""

    def to_piece(x, a, b):
        t = np.clip((x - a) @ (b - a) / max((b - a) @ (b - a), 1e-300), 0, 1)
        return np.linalg.norm(x - a - t * (b - a))

    found = [to_piece(p, r, s), to_piece(q, r, s), to_piece(r, p, q), to_piece(s, p, q)]
    matrix = np.column_stack((q - p, r - s))
    (t, u), *_ = np.linalg.lstsq(matrix, r - p, rcond=None)
    if 0 <= t <= 1 and 0 <= u <= 1:
        found.append(np.linalg.norm(p + t * (q - p) - r - u * (s - r)))
    return min(found)


@few
@given(trees(max_segments=14))
def test_overlaps_are_those_of_all_pairs(tree):
    expected = []
    for a, b in itertools.combinations(range(1, tree.n_nodes), 2):
        if {a, int(tree.parent[a])} & {b, int(tree.parent[b])}:
            continue
        one, two = tree.polyline(a), tree.polyline(b)
        distance = min(
            piece_distance(one[i], one[i + 1], two[j], two[j + 1])
            for i in range(len(one) - 1)
            for j in range(len(two) - 1)
        )
        if distance < tree.radius_mm[a] + tree.radius_mm[b]:
            expected.append([a, b])
    assert overlapping_pairs(tree).tolist() == expected


@few
@given(trees(), st.integers(0, 2**32 - 1))
def test_distances_are_those_to_all_pieces(tree, seed):
    points = np.random.default_rng(seed).normal(scale=3, size=(20, 3))
    expected = [
        min(
            piece_distance(x, x, line[k], line[k + 1])
            for i in range(1, tree.n_nodes)
            for line in [tree.polyline(i)]
            for k in range(len(line) - 1)
        )
        for x in points
    ]
    # both are a handful of operations on numbers of order 1 to 10: round-off stays below 1e-12
    np.testing.assert_allclose(pieces(tree).distance_mm(points), expected, rtol=0, atol=1e-12)


@few
@given(trees(max_segments=3))
def test_distance_to_no_piece_is_infinite(tree):
    assert pieces(tree, np.zeros(tree.n_nodes, bool)).distance_mm(np.zeros((2, 3))).tolist() == [math.inf] * 2


@few
@given(branching)
def test_generation_rows_are_plain_averages(tree):
    analysis = measured(tree)
    of = generations(tree)
    for row in analysis.generations.to_dict("records"):
        here = [i for i in range(1, tree.n_nodes) if of[i] == row["generation"]]
        radii = [tree.radius_mm[i] for i in here]
        lengths = [sum(np.linalg.norm(np.diff(tree.polyline(i), axis=0), axis=1)) for i in here]
        kids = [[tree.radius_mm[c] for c in children(tree, i)] for i in here]
        ratios = [min(k) / max(k) for k in kids if len(k) > 1]
        expected = {
            "n_segments": len(here),
            "radius_mean_mm": mean(radii),
            "radius_sd_mm": sd(radii),
            "length_mean_mm": mean(lengths),
            "length_sd_mm": sd(lengths),
            "branching_ratio_mean": mean(ratios),
            "branching_ratio_sd": sd(ratios),
            "n_trifurcations": sum(len(k) == 3 for k in kids),
            "n_elements": sum(of[tree.parent[i]] != of[i] or of[i] == 0 for i in here),
            "total_length_mm": sum(lengths),
        }
        for name, value in expected.items():
            assert row[name] == pytest.approx(value, rel=1e-9, abs=1e-12, nan_ok=True), name  # sums of a few numbers


@few
@given(branching, st.sampled_from([(0.0, 1.0), (1.0, 3.0), (0.5, 20.0)]))
def test_junctions_by_their_definitions(tree, window):
    analysis = measured(tree, angle_window_radii=window)

    def direction(line, reach):
        """Chord between two points at given distances along a line that begins at the junction."""
        steps = np.linalg.norm(np.diff(line, axis=0), axis=1)
        along = np.concatenate(([0.0], np.cumsum(steps)))
        near, far = min(window[0] * reach, along[-1] / 2), min(window[1] * reach, along[-1])
        ends = [np.array([np.interp(s, along, line[:, k]) for k in range(3)]) for s in (near, far)]
        return ends[1] - ends[0]

    def angle(u, v):
        return math.degrees(math.acos(np.clip(u @ v / np.linalg.norm(u) / np.linalg.norm(v), -1, 1)))

    for row in analysis.junctions.to_dict("records"):
        node = row["node"] + 1
        kids = children(tree, node)
        radii = sorted(tree.radius_mm[kids])
        assert (row["n_children"], row["generation"]) == (len(kids), generations(tree)[node])
        assert row["branching_ratio"] == pytest.approx(radii[0] / radii[-1], rel=1e-12)
        if node == 0:
            assert row["murray_reason"] == "no-parent" and math.isnan(row["area_ratio"])
            continue
        own = tree.radius_mm[node]
        assert row["area_ratio"] == pytest.approx(sum(r * r for r in radii) / own**2, rel=1e-12)
        if radii[-1] < own:
            solution = brentq(lambda g: sum((r / own) ** g for r in radii) - 1, 0, 1e5, xtol=1e-12, rtol=1e-14)  # noqa: B023
            assert row["murray_exponent"] == pytest.approx(solution, rel=1e-8)  # bisection of a flat function
        else:
            assert math.isnan(row["murray_exponent"]) and row["murray_reason"] == "child-not-thinner"
        reach = max(own, radii[-1])
        arrives = -direction(tree.polyline(node)[::-1], reach)
        by_radius = sorted(kids, key=lambda c: -tree.radius_mm[c])
        leaves = [direction(tree.polyline(c), reach) for c in by_radius]
        expected = angle(arrives, leaves[0]), angle(arrives, leaves[-1]), angle(leaves[0], leaves[1])
        got = row["angle_thickest_deg"], row["angle_thinnest_deg"], row["angle_between_deg"]
        assert got == pytest.approx(expected, abs=1e-5)  # the arc cosine of the twin loses half the digits near 0


@few
@given(branching, st.floats(0.2, 0.9), st.floats(0, 80), st.floats(20, 120))
def test_monopodial_branches_by_their_definition(tree, ratio, low, straight):
    rule = Monopodial(ratio, low, low + 60, straight)
    analysis = measured(tree, monopodial=rule)
    angle = analysis.segments["branching_angle_deg"].to_numpy()
    for i in range(1, tree.n_nodes):
        siblings = [c for c in children(tree, tree.parent[i]) if c != i]
        expected = False
        if siblings and tree.parent[i] > 0:
            largest = max(siblings, key=lambda c: tree.radius_mm[c])
            expected = (
                tree.radius_mm[i] <= ratio * tree.radius_mm[largest]
                and low <= angle[i - 1] <= low + 60
                and angle[largest - 1] <= straight
            )
        assert bool(analysis.segments["monopodial"].to_numpy()[i - 1]) is bool(expected)


@few
@given(branching)
def test_elements_and_connectivity_by_walking_up(tree):
    analysis = measured(tree)
    orders = [order(tree, i) for i in range(tree.n_nodes)]

    def first(i):
        while tree.parent[i] > 0 and orders[tree.parent[i]] == orders[i]:
            i = tree.parent[i]
        return i

    runs = {}
    for i in range(1, tree.n_nodes):
        runs.setdefault(first(i), []).append(i)
    assert len(analysis.elements) == len(runs)
    for row, begin in zip(analysis.elements.to_dict("records"), sorted(runs)):
        run = runs[begin]
        length = sum(tree.length_mm[i] for i in run)
        assert (row["order"], row["n_segments"]) == (orders[begin], len(run))
        assert row["length_mm"] == pytest.approx(length, rel=1e-12)
        assert row["radius_mm"] == pytest.approx(
            sum(tree.length_mm[i] * tree.radius_mm[i] for i in run) / length, rel=1e-12
        )
        assert math.isnan(row["taper_per_mm"]) == (len(run) == 1)
    strahler = analysis.connectivity[analysis.connectivity["ordering"] == "strahler"]
    for row in strahler.to_dict("records"):
        m, n = row["order_child"], row["order_parent"]
        of_n = [begin for begin in runs if orders[begin] == n]
        mothers = [first(tree.parent[b]) for b in runs if orders[b] == m and tree.parent[b] > 0]
        each = [mothers.count(begin) for begin in of_n]
        assert (row["n_elements"], row["n_parent_elements"]) == (sum(each), len(each))
        assert row["mean"] == pytest.approx(mean(each), rel=1e-12)
        assert row["se"] == pytest.approx(sd(each) / math.sqrt(len(each)), rel=1e-9, nan_ok=True)


@few
@given(trees(max_segments=30))
def test_merged_chains_are_the_same_vessels(tree):
    merged = merge_chains(tree)
    assert not [i for i in range(1, merged.n_nodes) if len(children(merged, i)) == 1]
    kept = [i for i in range(tree.n_nodes) if i == 0 or len(children(tree, i)) != 1]
    np.testing.assert_array_equal(merged.position_mm, tree.position_mm[kept])
    for new, old in enumerate(kept):
        if new == 0:
            continue
        run = [old]
        while tree.parent[run[0]] > 0 and len(children(tree, tree.parent[run[0]])) == 1:
            run.insert(0, int(tree.parent[run[0]]))
        line = np.vstack([tree.polyline(run[0]), *(tree.polyline(i)[1:] for i in run[1:])])
        np.testing.assert_array_equal(merged.polyline(new), line)
        weight = tree.length_mm[run]
        assert merged.radius_mm[new] == pytest.approx(np.average(tree.radius_mm[run], weights=weight), rel=1e-12)
        assert kept[merged.parent[new]] == tree.parent[run[0]]
    assert order(merged, 0) == strahler_order(tree.topology)[0]


@few
@given(st.integers(0, 2**32 - 1), st.integers(5, 40))
def test_grid_points_are_those_inside_both_hulls(seed, n):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(n, 3)), rng.normal(size=(n, 3)) + 0.3
    one, two = convex_hull(a), convex_hull(b)
    assert one is not None and two is not None
    alone = grid_inside(one, n_points=2000)
    # the number of grid points in a body differs from its volume by those near its surface: of 2000 points in a thin
    # hull of few corners, up to a quarter
    assert 1500 <= len(alone) <= 2500
    assert (Delaunay(a).find_simplex(alone, tol=1e-9) >= 0).all()
    both = grid_inside(one, two, n_points=2000)
    expected = alone[Delaunay(b).find_simplex(alone) >= 0]
    differ = {tuple(x) for x in np.round(both, 9)} ^ {tuple(x) for x in np.round(expected, 9)}
    assert len(differ) <= 2  # points on a facet, where round-off decides


@few
@given(trees())
def test_window_makes_no_difference_to_straight_segments(tree):
    if tree.polyline_mm is None:
        a, b = (angles(tree, window_radii=w).branching_deg for w in ((0.0, 1.0), (1.0, 3.0)))
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-6)  # chords of one line, by different points
