"""How terminals cover the tissue, against lattices and random points; the grid of points inside a hull."""

import math

import numpy as np
import pytest

from vascval.core.errors import InputError
from vascval.core.tree import Topology, Tree
from vascval.morphometry.coverage import coverage
from vascval.morphometry.hull import Hull, grid_inside


def test_coverage_of_a_lattice_of_terminals():
    """Terminals on a cubic lattice of pitch 10: tissue points are at most half a space diagonal away."""
    tips = np.stack(np.meshgrid(*[np.arange(6) * 10.0] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    position = np.vstack([[[-20, 0, 0], [-10, 0, 0]], tips])
    tree = Tree(Topology(np.array([-1, 0, *[1] * len(tips)])), position, np.full(len(position), 0.5))
    measured = coverage(tree)
    assert measured is not None
    assert measured["domain"] == "convex hull of the terminals"
    assert measured["volume_mm3"] == pytest.approx(50.0**3, rel=1e-12)
    assert measured["terminals_per_mm3"] == pytest.approx(216 / 50.0**3, rel=1e-12)
    # mean distance of a unit cube's points to its nearest corner is 0.4803 (that to the centre of one); the grid has
    # 28^3 points where 27.1^3 fit, and so too many of them near the faces
    assert measured["distance_mean_mm"] == pytest.approx(4.803, rel=3e-2)
    assert 8.0 < measured["distance_max_mm"] <= 10 * math.sqrt(3) / 2 + 1e-9
    # random tips of the same density: 0.554 / density^(1/3)
    assert measured["evenness"] == pytest.approx(4.803 / (0.55396 * (50.0**3 / 216) ** (1 / 3)), rel=3e-2)
    given = coverage(tree, tissue_mm=np.array([[5.0, 5.0, 5.0]]))
    assert given is not None
    assert given["distance_max_mm"] == pytest.approx(5 * math.sqrt(3), rel=1e-14)
    assert (given["domain"], given["volume_mm3"], given["evenness"]) == ("given points", None, None)


def unit_box(low):
    """A cube of side 1 along the axes, by its facets."""
    facets = [[*axis, -corner - 1] for axis, corner in zip(np.eye(3), low)]
    facets += [[*-axis, corner] for axis, corner in zip(np.eye(3), low)]
    return Hull(1.0, np.array(facets), np.eye(3), np.asarray(low, float), np.asarray(low, float) + 1)


def test_grid_is_clipped_by_facets_along_its_lines():
    alone = grid_inside(unit_box((0, 0, 0)), n_points=1000)
    assert len(alone) == 1000
    assert alone.min(axis=0) == pytest.approx([0.05] * 3) and alone.max(axis=0) == pytest.approx([0.95] * 3)
    both = grid_inside(unit_box((0, 0, 0)), unit_box((0.5, 0.7, -0.2)), n_points=1000)
    assert len(both) == 5 * 3 * 8
    assert both.min(axis=0) == pytest.approx([0.55, 0.75, 0.05])
    assert both.max(axis=0) == pytest.approx([0.95, 0.95, 0.75])
    assert len(grid_inside(unit_box((0, 0, 0)), unit_box((2, 0, 0)), n_points=1000)) == 0


def test_tissue_points_of_a_wrong_shape_are_refused():
    with pytest.raises(InputError, match=r"tissue points have shape \(3,\)"):
        coverage(Tree(Topology(np.array([-1, 0])), np.eye(3)[:2], np.full(2, 0.1)), tissue_mm=np.zeros(3))


def test_random_points_have_an_evenness_of_one():
    rng = np.random.default_rng(5)
    tips = rng.uniform(0, 100, (4000, 3))
    position = np.vstack([[[-20, 0, 0], [-10, 0, 0]], tips])
    tree = Tree(Topology(np.array([-1, 0, *[1] * len(tips)])), position, np.full(len(position), 0.01))
    measured = coverage(tree)
    assert measured is not None
    # points near the hull's surface see tips on one side only: some per cent more
    assert measured["evenness"] == pytest.approx(1.03, abs=0.04)
