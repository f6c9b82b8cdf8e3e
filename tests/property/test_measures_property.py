"""Measures and comparisons of any tree: rotation, translation, scale, units, numbering, and order of the children."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.property.shapes import Shape, numbered_anew, shapes, turned
from vascval.comparison import compare
from vascval.core.tree import Tree
from vascval.morphometry import Analysis, analyze

TREES = shapes(stems=2, branching=True, most=18)
LENGTHS = {"total_length_mm": 1, "volume_mm3": 3}


def tree_of(shape: Shape, seed: int) -> Tree:
    """Radii that thin out and are small beside the lengths: nothing is contracted."""
    rng = np.random.default_rng(seed)
    scale = np.abs(shape.position_mm).max()
    weight = 1e-3 * scale * (1 + rng.random(shape.topology.n_nodes))
    return Tree(shape.topology, shape.position_mm, weight)


def measured(tree: Tree) -> Analysis:
    return analyze(tree, source="x")


def same(one: pd.DataFrame, two: pd.DataFrame, scale: float = 1.0) -> None:
    """Equal tables, lengths being ``scale`` times as long; angles from rounded positions agree to 1e-6."""
    assert list(one.columns) == list(two.columns)
    for name in one.columns:
        if one[name].dtype.kind != "f":
            assert one[name].tolist() == two[name].tolist(), name
            continue
        power = -1 if "per_mm" in name else 3 if name.endswith("_mm3") else 1 if name.endswith("_mm") else 0
        np.testing.assert_allclose(two[name], one[name] * scale**power, rtol=1e-6, atol=1e-9, err_msg=name)


@settings(deadline=None, max_examples=15)
@given(TREES, st.integers(0, 2**32 - 1), st.sampled_from([0.001, 0.3, 10.0, 1000.0]))
def test_measures_of_a_tree(shape: Shape, seed: int, s: float) -> None:
    """Moved, numbered anew and scaled, as by another unit: orders and counts are the same, lengths go with the size."""
    rng = np.random.default_rng(seed)
    tree = tree_of(shape, seed)
    before = measured(tree)
    moved = measured(Tree(shape.topology, turned(shape, rng).position_mm, tree.radius_mm))
    other, back = numbered_anew(shape, rng)
    relabelled = measured(Tree(other.topology, other.position_mm, tree.radius_mm[back]))
    scaled = measured(Tree(shape.topology, shape.position_mm * s, tree.radius_mm * s))
    for after, factor in ((moved, 1.0), (relabelled, 1.0), (scaled, s)):
        for name in ("generations", "orders", "connectivity"):
            same(getattr(before, name), getattr(after, name), factor)
        for name, value in before.summary.items():
            if value is None:  # orders by diameter that do not settle
                assert after.summary[name] is None
                continue
            power = LENGTHS.get(name, 0)
            assert after.summary[name] == pytest.approx(value * factor**power, rel=1e-6, abs=1e-9, nan_ok=True), name


@settings(deadline=None, max_examples=6)
@given(TREES, st.integers(0, 2**32 - 1))
def test_a_tree_against_itself(shape: Shape, seed: int) -> None:
    """No difference, all of it matched, every territory its own; numbered anew it is still itself."""
    rng = np.random.default_rng(seed)
    tree = tree_of(shape, seed)
    other, back = numbered_anew(shape, rng)
    for twin in (tree, Tree(other.topology, other.position_mm, tree.radius_mm[back])):
        found = compare(measured(tree), [measured(twin)])
        for name, values in found.differences[0].items():
            if name != "generation":
                given_values = pd.to_numeric(values).dropna()
                assert np.abs(given_values).max() < 1e-9 if len(given_values) else True, name
        table = found.location[0].generations
        assert table["cast_matched_share"].to_numpy() == pytest.approx(1.0, abs=1e-12)
        assert table["cast_distance_max_mm"].to_numpy() == pytest.approx(
            0.0, abs=1e-6 * np.abs(shape.position_mm).max()
        )
        if found.territories[0] is not None:
            assert (found.territories[0].generations["dice"] == 1.0).all()


@settings(deadline=None, max_examples=6)
@given(TREES, TREES, st.integers(0, 2**32 - 1), st.sampled_from([0.01, 100.0]))
def test_two_trees(one: Shape, two: Shape, seed: int, s: float) -> None:
    """Differences change their sign with the sides, and location its direction; both moved alike, or both scaled with
    the tolerance, nothing changes but the unit."""
    size = np.abs(one.position_mm).max()
    two = replace(two, position_mm=two.position_mm * size / np.abs(two.position_mm).max())
    rule = {"tolerance_mm": 0.2 * size, "step_mm": 0.05 * size}
    a, b = tree_of(one, seed), tree_of(two, seed + 1)
    there, back = (compare(measured(x), [measured(y)], **rule) for x, y in ((a, b), (b, a)))
    for name in there.differences[0].columns:
        if name != "generation" and not name.endswith("_relative"):
            forth, other = (pd.to_numeric(side.differences[0][name]).to_numpy(float) for side in (there, back))
            np.testing.assert_allclose(forth, -other, rtol=1e-9, atol=1e-12, err_msg=name)
    rows, swapped = there.location[0].generations, back.location[0].generations
    for name in rows.columns:
        if name.startswith("cast_") and name.replace("cast_", "tree_", 1) in rows.columns:
            np.testing.assert_allclose(rows[name], swapped[name.replace("cast_", "tree_", 1)], rtol=1e-9, err_msg=name)
    matrix, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    moved = [Tree(t.topology, t.position_mm @ matrix.T + size, t.radius_mm) for t in (a, b)]
    scaled = [Tree(t.topology, t.position_mm * s, t.radius_mm * s) for t in (a, b)]
    larger = {name: value * s for name, value in rule.items()}
    for (x, y), asked, factor in ((moved, rule, 1.0), (scaled, larger, s)):
        again = compare(measured(x), [measured(y)], **asked)
        columns = [name for name in rows.columns if name.startswith(("cast_distance", "tree_distance"))]
        same(rows[columns], again.location[0].generations[columns], factor)
