"""Measures do not depend on where a tree lies, how large it is, or how its nodes are numbered."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from vascval.core.ordering import root_first
from vascval.core.tree import Topology, Tree
from vascval.morphometry import analyze


def random_tree(seed, n_terminals=120):
    """A tree of two- to four-fold splits with curved centrelines and radii of all sizes."""
    rng = np.random.default_rng(seed)
    parent, leaves = [-1, 0], [1]
    while len(leaves) < n_terminals:
        node = leaves.pop(int(rng.integers(len(leaves))))
        n = int(rng.choice([2, 2, 2, 3, 4]))
        leaves += range(len(parent), len(parent) + n)
        parent += [node] * n
    topology = Topology(np.array(parent))
    size = len(parent)
    weight = np.zeros(size)
    for i in range(size - 1, -1, -1):
        weight[i] = weight[i] or 1.0
        if i:
            weight[parent[i]] += weight[i]
    radius = 0.1 * weight ** (1 / 3) * rng.uniform(0.8, 1.2, size)
    position = np.zeros((size, 3))
    for i in range(1, size):
        position[i] = position[parent[i]] + rng.normal(size=3) * 4 * radius[i]
    middle = (position[parent[1:]] + position[1:]) / 2 + 0.3 * radius[1:, None] * rng.normal(size=(size - 1, 3))
    points = np.stack((position[parent[1:]], middle, position[1:]), axis=1).reshape(-1, 3)
    return Tree(
        topology, position, radius, polyline_mm=points, polyline_offset=np.concatenate(([0], 3 * np.arange(size)))
    )


def moved(tree, matrix, shift):
    position, polyline = (points @ matrix.T + shift for points in (tree.position_mm, tree.polyline_mm))
    return replace(tree, position_mm=position, polyline_mm=polyline)


def renumbered(tree, seed):
    """The same tree with its nodes in another order that is root first."""
    shuffle = np.random.default_rng(seed).permutation(tree.n_nodes)
    parent = np.full(tree.n_nodes, -1)
    parent[shuffle[1:]] = shuffle[tree.parent[1:]]
    order = root_first(parent)
    old = np.argsort(shuffle)[order]
    place = np.argsort(order)
    lines = [tree.polyline(i) for i in old[1:]]
    return Tree(
        Topology(np.where(parent[order] < 0, -1, place[parent[order]])),
        tree.position_mm[old],
        tree.radius_mm[old],
        polyline_mm=np.concatenate(lines),
        polyline_offset=np.concatenate(([0, 0], np.cumsum([len(line) for line in lines]))),
    )


def power_of_length(name):
    if name in ("terminals_per_mm3",):
        return -3
    if "per_mm" in name:
        return -1
    return 3 if name.endswith("_mm3") else 1 if name.endswith("_mm") else 0


def assert_same(one, two, scale=1.0):
    """Equal tables and totals, what is a length or a volume scaled.

    Sums of some hundred numbers in another order, angles from rounded coordinates: 1e-9 is far above their round-off
    and far below any change of a measure.
    """
    for name in ("generations", "orders", "connectivity", "monopodial_sensitivity"):
        a, b = getattr(one, name), getattr(two, name)
        factors = {column: scale ** power_of_length(column) for column in a.columns if a[column].dtype == float}
        pd.testing.assert_frame_equal(a.assign(**{c: a[c] * f for c, f in factors.items()}), b, rtol=1e-9, atol=1e-9)
    for name, value in one.summary.items():
        assert two.summary[name] == pytest.approx(value * scale ** power_of_length(name), rel=1e-9, abs=1e-12), name
    for name in ("murray_exponent", "branching_ratio", "angle_between_deg", "area_ratio"):
        a, b = (np.sort(side.junctions[name].to_numpy()) for side in (one, two))
        np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-8)


@pytest.fixture(scope="module")
def original():
    tree = random_tree(3)
    return tree, analyze(tree, source="x")


def test_the_example_has_something_to_lose(original):
    summary = original[1].summary
    assert min(summary[key] for key in ("n_trifurcations", "n_multifurcations", "n_overlaps")) >= 10
    assert min(summary[key] for key in ("n_contracted", "n_monopodial")) >= 1


@pytest.mark.parametrize("seed", [1, 2])
def test_rotation_reflection_translation(original, seed):
    tree, before = original
    matrix = Rotation.random(random_state=seed).as_matrix() @ np.diag([1, 1, -1])
    after = analyze(moved(tree, matrix, np.array([100.0, -50.0, 7.0])), source="x")
    assert_same(before, after)
    assert after.coverage["distance_mean_mm"] == pytest.approx(before.coverage["distance_mean_mm"], rel=1e-9)


def test_scaling(original):
    tree, before = original
    scaled = replace(
        tree, position_mm=tree.position_mm * 8, radius_mm=tree.radius_mm * 8, polyline_mm=tree.polyline_mm * 8
    )
    after = analyze(scaled, source="x")
    assert_same(before, after, scale=8.0)
    for name, value in before.coverage.items():
        if isinstance(value, float):
            assert after.coverage[name] == pytest.approx(value * 8.0 ** power_of_length(name), rel=1e-9)


@pytest.mark.parametrize("seed", [4, 5])
def test_numbering_of_the_nodes(original, seed):
    tree, before = original
    after = analyze(renumbered(tree, seed), source="x")
    assert_same(before, after)
    ours, theirs = (side.segments.sort_values(["distal_x_mm"], ignore_index=True) for side in (before, after))
    same = ["order", "generation", "diameter_order", "radius_mm", "length_mm", "branching_angle_deg", "n_terminals"]
    pd.testing.assert_frame_equal(ours[same], theirs[same], rtol=1e-9)


def test_running_twice_gives_the_same_bits(original):
    tree, before = original
    assert analyze(tree, source="x").document() == before.document()
