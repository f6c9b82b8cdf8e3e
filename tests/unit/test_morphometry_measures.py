"""Measures of trees whose values are known from a formula or from a publication."""

import math

import numpy as np
import pytest

from vascval.core.errors import ComputationError, InputError
from vascval.core.tree import Topology, Tree
from vascval.morphometry import Monopodial, analyze
from vascval.morphometry import analysis as analysis_module
from vascval.morphometry.overlaps import overlapping_pairs
from vascval.morphometry.preparation import prepare


def build(segments):
    """A tree from ``(parent, end, radius)`` per segment; node 0 is the origin."""
    parent, end, radius = zip(*segments)
    return Tree(Topology(np.array([-1, *parent])), np.array([(0, 0, 0), *end], float), np.array([0, *radius], float))


def in_plane(angle_deg):
    return np.array([math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg)), 0.0])


def symmetric(levels, *, gamma=3.0, shrink=0.8, angle_deg=35.0, n_last=2):
    """Every vessel splits into two at the same angle, radii by Murray's law; the last split is ``n_last``-fold."""
    parent, position, radius, heading = [-1, 0], [np.zeros(3), in_plane(0)], [0.0, 0.05], [0.0, 0.0]
    front = [1]
    for level in range(1, levels):
        n = n_last if level == levels - 1 else 2
        children = []
        for node in front:
            for k in range(n):
                turn = heading[node] + angle_deg * (2 * k / (n - 1) - 1)
                parent.append(node)
                position.append(position[node] + shrink**level * in_plane(turn))
                radius.append(radius[node] * n ** (-1 / gamma))
                heading.append(turn)
                children.append(len(parent) - 1)
        front = children
    return Tree(Topology(np.array(parent)), np.array(position), np.array(radius))


def test_symmetric_tree_has_the_ratios_it_was_made_with():
    analysis = analyze(symmetric(6, gamma=3.0, shrink=0.8), source="symmetric")
    assert analysis.generations["n_segments"].tolist() == [1, 2, 4, 8, 16, 32]
    assert analysis.generations["n_elements"].tolist() == [1, 2, 4, 8, 16, 32]
    assert analysis.summary["max_order"] == 6
    # sums of 32 equal numbers: round-off of a few units in the last place
    assert analysis.generations["branching_ratio_mean"].tolist()[:5] == pytest.approx([1.0] * 5, rel=1e-14)
    assert math.isnan(analysis.generations["branching_ratio_mean"].iloc[5])
    junctions = analysis.junctions
    assert junctions["murray_exponent"].to_numpy() == pytest.approx(3.0, rel=1e-12)
    assert junctions["area_ratio"].to_numpy() == pytest.approx(2 ** (1 / 3), rel=1e-13)
    assert junctions["angle_thickest_deg"].to_numpy() == pytest.approx(35.0, abs=1e-10)
    assert junctions["angle_thinnest_deg"].to_numpy() == pytest.approx(35.0, abs=1e-10)
    assert junctions["angle_between_deg"].to_numpy() == pytest.approx(70.0, abs=1e-10)
    horton = analysis.horton[analysis.horton["ordering"] == "strahler"]
    for _, of_range in horton.groupby("order_max"):
        ratio = of_range.set_index("quantity")["ratio"]
        assert ratio["number"] == pytest.approx(2.0, rel=1e-12)
        assert ratio["radius"] == pytest.approx(2 ** (1 / 3), rel=1e-12)
        assert ratio["length"] == pytest.approx(1 / 0.8, rel=1e-12)
        assert of_range["r_squared"].to_numpy() == pytest.approx(1.0, abs=1e-12)
    assert sorted(set(horton["order_max"])) == [5, 6]
    strahler = analysis.orders[analysis.orders["ordering"] == "strahler"].set_index("order")
    diameter = analysis.orders[analysis.orders["ordering"] == "diameter-defined"].set_index("order")
    assert diameter["n_segments"].tolist() == strahler["n_segments"].tolist()  # one diameter per order
    assert strahler["segments_per_element"].tolist() == [1.0] * 6


@pytest.mark.parametrize("gamma", [1.0, 2.0, 2.55, 3.0, 7.5, 60.0])
def test_murray_exponent_is_recovered(gamma):
    radii = np.array([0.9, 0.6, 0.4])
    own = (radii**gamma).sum() ** (1 / gamma)
    tree = build([(0, (30, 0, 0), own), (1, (40, 9, 0), 0.9), (1, (40, -9, 0), 0.6), (1, (40, 0, 9), 0.4)])
    exponent = analyze(tree, source="murray").junctions["murray_exponent"].iloc[0]
    # at an exponent of 60 the sum hangs on the last digits of 0.9 / own = 1 - 6e-13
    assert exponent == pytest.approx(gamma, rel=1e-10 if gamma < 10 else 2e-2)


def test_a_child_as_thick_as_its_parent_leaves_no_murray_exponent():
    tree = build([(0, (30, 0, 0), 1.0), (1, (40, 9, 0), 1.0), (1, (40, -9, 0), 0.2)])
    row = analyze(tree, source="x").junctions.iloc[0]
    assert math.isnan(row["murray_exponent"])
    assert row["murray_reason"] == "child-not-thinner"


@pytest.mark.parametrize("straighter", [1, -1])
def test_of_equal_children_the_straighter_one_goes_on(straighter):
    ends = [np.array([50, 0, 0]) + 40 * in_plane(angle_deg) for angle_deg in (10, -40)]
    tree = build([(0, (50, 0, 0), 1.0), *[(1, end, 0.8) for end in ends[::straighter]]])
    row = analyze(tree, source="x").junctions.iloc[0]
    assert row["angle_thickest_deg"] == pytest.approx(10, abs=1e-10)
    assert row["angle_thinnest_deg"] == pytest.approx(40, abs=1e-10)


def side_branch(ratio, angle_deg, straight_deg):
    return build(
        [
            (0, (50, 0, 0), 1.0),
            (1, np.array([50, 0, 0]) + 40 * in_plane(straight_deg), 0.9),
            (1, np.array([50, 0, 0]) + 40 * in_plane(-angle_deg), 0.9 * ratio),
        ]
    )


@pytest.mark.parametrize(
    ("ratio", "angle_deg", "straight_deg", "expected"),
    [
        (0.5, 90, 0, 1),
        (0.5001, 90, 0, 0),
        (0.3, 60.001, 29.999, 1),
        (0.3, 59.999, 0, 0),
        (0.3, 119.999, 0, 1),
        (0.3, 120.001, 0, 0),
        (0.3, 90, 30.001, 0),
    ],
)
def test_monopodial_thresholds(ratio, angle_deg, straight_deg, expected):
    analysis = analyze(side_branch(ratio, angle_deg, straight_deg), source="x")
    assert analysis.summary["n_monopodial"] == expected
    assert analysis.segments["monopodial"].tolist() == [False, False, bool(expected)]
    assert analysis.generations["n_monopodial"].iloc[0] == expected  # under the vessel that it springs from


def test_monopodial_sensitivity_grows_with_every_threshold():
    table = analyze(side_branch(0.45, 75, 20), source="x").monopodial_sensitivity
    assert len(table) == 45
    usual = table.query("ratio_max == 0.5 and angle_min_deg == 60 and straight_max_deg == 30")
    assert usual["n_monopodial"].tolist() == [1]
    found = (table["ratio_max"] >= 0.45) & (table["angle_min_deg"] <= 75) & (table["straight_max_deg"] >= 20)
    assert (table["n_monopodial"] == found).all()


def test_monopodial_parameters_out_of_range_are_refused():
    with pytest.raises(InputError, match=r"ratio for monopodial branches is 1\.0; it must lie between 0 and 1"):
        Monopodial(ratio_max=1.0)
    with pytest.raises(InputError, match=r"130 to 120 and 30\.0 degrees; ascending angles"):
        Monopodial(angle_min_deg=130, angle_max_deg=120)


def test_two_shared_orders_and_a_lesser_one_make_the_next_order():
    tree = build(
        [
            (0, (50, 0, 0), 1.0),
            (1, (80, 30, 0), 0.7),
            (1, (80, -30, 0), 0.7),
            (1, (80, 0, 30), 0.5),
            (2, (100, 40, 0), 0.5),
            (2, (100, 20, 0), 0.5),
            (3, (100, -40, 0), 0.5),
            (3, (100, -20, 0), 0.5),
        ]
    )
    analysis = analyze(tree, source="x")
    assert analysis.summary["max_order"] == 3
    assert analysis.generations["n_segments"].tolist() == [1, 2, 5]
    assert (analysis.summary["n_bifurcations"], analysis.summary["n_trifurcations"]) == (2, 1)


def test_trifurcations_beyond_the_seventh_generation_count_in_all_only():
    analysis = analyze(symmetric(9, n_last=3, shrink=0.95), source="x", diameters=0.0)
    assert analysis.summary["n_trifurcations"] == 128
    assert analysis.summary["n_trifurcations_first_7"] == 0
    assert analysis.generations["n_trifurcations"].tolist() == [0] * 7 + [128, 0]
    four = analyze(symmetric(9, n_last=4, shrink=0.95), source="x", diameters=0.0)
    assert (four.summary["n_trifurcations"], four.summary["n_multifurcations"]) == (0, 128)


SHORT_INNER = [
    (0, (10, 0, 0), 1.0),
    (1, (11.5, 0, 0), 0.8),
    (1, (10, 9, 0), 0.9),
    (2, (20, 5, 0), 0.9),
    (2, (20, -5, 0), 0.9),
]
"""An inner segment of 1.5 mm with a diameter of 1.6 mm."""


def test_contraction_makes_the_trifurcation_and_says_so():
    tree = build(SHORT_INNER)
    analysis = analyze(tree, source="x")
    assert (analysis.summary["n_trifurcations"], analysis.summary["n_contracted"]) == (1, 1)
    assert "1 inner segments shorter than 1 diameters were contracted" in analysis.notes
    assert analyze(tree, source="x", diameters=0.9).summary["n_trifurcations"] == 0


def tokunaga(order):
    """Tokunaga's self-similar tree with a = 1, c = 2: an element of order n bears ``2^(k-1)`` side elements of order
    n - k for each k, and two of order n - 1 at its end."""
    parent, order_of = [-1], []

    def grow(node, n):
        side = [n - k for k in range(1, n) for _ in range(2 ** (k - 1))]
        for m in side:
            parent.append(node)
            node = len(parent) - 1
            order_of.append(n)
            grow(node, m)
        parent.append(node)
        node = len(parent) - 1
        order_of.append(n)
        if n > 1:
            grow(node, n - 1)
            grow(node, n - 1)

    grow(0, order)
    rng = np.random.default_rng(1)
    position = rng.normal(scale=100, size=(len(parent), 3))  # far apart: nothing is contracted
    return Tree(Topology(np.array(parent)), position, np.array([0.0, *(0.01 * 2.0**n for n in order_of)])), order_of


def test_connectivity_of_the_self_similar_tree_of_tokunaga():
    tree, order_of = tokunaga(5)
    analysis = analyze(tree, source="tokunaga")
    assert analysis.segments["order"].tolist() == order_of
    strahler = analysis.connectivity[analysis.connectivity["ordering"] == "strahler"]
    matrix = strahler.pivot(index="order_child", columns="order_parent", values="mean").to_numpy()
    expected = [[0, 3, 2, 4, 8], [0, 0, 3, 2, 4], [0, 0, 0, 3, 2], [0, 0, 0, 0, 3], [0, 0, 0, 0, 0]]
    assert matrix.tolist() == expected
    assert (strahler["se"].dropna() == 0).all()  # all elements of an order bear the same
    assert strahler.query("order_parent == 5")["se"].isna().all()
    # N(n) = 3 N(n + 1) + 2 N(n + 2) + 4 N(n + 3) + ...: 1, 3, 11, 43, 171, towards the known ratio of 4
    orders = analysis.orders[analysis.orders["ordering"] == "strahler"]
    assert orders["n_elements"].tolist() == [171, 43, 11, 3, 1]
    # n - 1 orders below with 2^(k-1) sides each, and the end: 2^(n-1) segments
    assert orders["segments_per_element"].tolist() == [1, 2, 4, 8, 16]


def test_taper_along_an_element():
    trunk = [(0, (40, 0, 0), 1.0), (1, (100, 0, 0), 0.8)]
    tree = build([*trunk, (1, (40, 20, 0), 0.2), (2, (120, 5, 0), 0.5), (2, (120, -5, 0), 0.5)])
    elements = analyze(tree, source="x").elements
    assert elements["n_segments"].tolist() == [2, 1, 1, 1]
    assert elements["taper_per_mm"].isna().tolist() == [False, True, True, True]
    # falls by 0.2 of 1.0 over 20 + 30 mm between the middles
    assert elements["taper_per_mm"].iloc[0] == pytest.approx(0.2 / 50, rel=1e-13)
    assert elements["radius_mm"].iloc[0] == pytest.approx((40 * 1.0 + 60 * 0.8) / 100, rel=1e-13)
    assert elements["length_mm"].iloc[0] == pytest.approx(100.0, rel=1e-13)


def test_direction_is_measured_outside_the_common_lumen():
    """A branch whose centreline first runs along the trunk, as thinning draws it, and then leaves at a right angle."""
    position = np.array([[0, 0, 0], [50, 0, 0], [90, 0, 0], [51, 30, 0]], float)
    lines = [position[[0, 1]], position[[1, 2]], np.array([[50, 0, 0], [51, 0, 0], [51, 30, 0]], float)]
    tree = Tree(
        Topology(np.array([-1, 0, 1, 1])),
        position,
        np.array([0, 2.0, 2.0, 0.5]),
        polyline_mm=np.concatenate(lines),
        polyline_offset=np.array([0, 0, 2, 4, 7]),
    )
    assert analyze(tree, source="x").segments["branching_angle_deg"].iloc[2] == pytest.approx(90, abs=1e-10)
    inside = analyze(tree, source="x", angle_window_radii=(0.0, 0.5)).segments["branching_angle_deg"]
    assert inside.iloc[2] == pytest.approx(0, abs=1e-10)
    assert analyze(tree, source="x").segments["tortuosity"].iloc[2] == pytest.approx(31 / math.hypot(1, 30), rel=1e-13)


def cross(gap):
    """Two stems, of each of which a branch ends beside the end of the other's, ``gap`` apart."""
    return build(
        [
            (0, (-50, 0, 0), 1.0),
            (0, (50, 0, 0), 1.0),
            (1, (-gap / 2, 30, 0), 0.5),
            (1, (-80, 0, 0), 0.5),
            (2, (gap / 2, 30, 0), 0.5),
            (2, (80, 0, 0), 0.5),
        ]
    )


def test_overlap_is_counted_below_the_sum_of_radii_only():
    assert overlapping_pairs(cross(0.999)).tolist() == [[3, 5]]
    assert overlapping_pairs(cross(1.0)).tolist() == []  # touching
    assert analyze(cross(0.999), source="x").summary["n_overlaps"] == 1


def test_overlaps_before_and_after_contraction():
    summary = analyze(build(SHORT_INNER), source="x").summary
    # around the short segment, 1.5 mm long, siblings and nephews run into each other: contracted they share the node
    assert (summary["n_overlaps"], summary["n_overlaps_as_given"]) == (0, 4)


def test_several_stems_make_a_junction_of_generation_zero():
    analysis = analyze(cross(5.0), source="x")
    root = analysis.junctions.iloc[0]
    assert (root["node"], root["generation"], root["murray_reason"]) == (-1, 0, "no-parent")
    assert analysis.generations["n_junctions"].tolist() == [2, 0]
    assert analysis.summary["n_bifurcations"] == 3
    assert any("leave the root point" in note for note in analysis.notes)


def test_chains_are_merged_before_counting():
    tree = build([(0, (10, 0, 0), 1.0), (1, (20, 0, 0), 0.5), (2, (50, 9, 0), 0.4), (2, (50, -9, 0), 0.4)])
    analysis = analyze(tree, source="x")
    assert analysis.summary["n_segments"] == 3
    assert analysis.segments["radius_mm"].iloc[0] == pytest.approx(0.75, rel=1e-14)  # 10 mm of each
    assert "1 nodes with a single child were merged into the segments that run through them" in analysis.notes


def test_flows_survive_merging_and_derived_columns_do_not():
    tree = build([(0, (10, 0, 0), 1.0), (1, (20, 0, 0), 0.5), (2, (50, 9, 0), 0.4), (2, (50, -9, 0), 0.4)])
    tree = tree.with_columns(flow_mm3_s=np.array([0, 6.0, 6.0, 3.0, 3.0]), order=np.array([0, 2, 2, 1, 1]))
    merged = prepare(tree).tree
    assert set(merged.columns) == {"flow_mm3_s"}
    assert merged.columns["flow_mm3_s"].tolist() == [0, 6, 3, 3]


def test_a_single_vessel_has_a_complete_document():
    analysis = analyze(build([(0, (10, 0, 0), 1.0)]), source="one")
    document = analysis.document()
    assert document["summary"]["n_terminals"] == document["summary"]["n_segments"] == 1
    assert document["generations"][0]["radius_sd_mm"] is None
    assert document["generations"][0]["branching_ratio_mean"] is None
    assert document["coverage"] is None
    assert [row["ratio"] for row in document["horton"]] == [None] * 6
    assert "no coverage: the terminals span no volume and no tissue was given" in document["notes"]


def test_a_tree_that_cannot_be_measured_is_refused():
    with pytest.raises(InputError, match="the tree has no segment, only a root point"):
        analyze(Tree(Topology(np.array([-1])), np.zeros((1, 3)), np.zeros(1)), source="x")
    with pytest.raises(InputError, match=r"1 segments have radius 0 \(first: 2\)"):
        analyze(build([(0, (10, 0, 0), 1.0), (1, (20, 1, 0), 0.0), (1, (20, -1, 0), 0.5)]), source="x")


def test_zero_length_segments_are_noted_and_have_no_tortuosity():
    tree = build([(0, (10, 0, 0), 1.0), (1, (10, 0, 0), 0.5), (1, (20, -9, 0), 0.5)])
    analysis = analyze(tree, source="x")
    assert "input: 1 segments have length 0 (first: 2)" in analysis.notes
    assert math.isnan(analysis.segments["tortuosity"].iloc[1])
    assert math.isnan(analysis.segments["branching_angle_deg"].iloc[1])
    analysis.document()


def test_orders_that_do_not_converge_are_noted(monkeypatch):
    def never(*_, **__):
        raise ComputationError("diameter-defined orders still change after 200 rounds")

    monkeypatch.setattr(analysis_module, "diameter_defined_order", never)
    analysis = analyze(symmetric(4), source="x")
    assert "no diameter-defined orders: diameter-defined orders still change after 200 rounds" in analysis.notes
    assert set(analysis.orders["ordering"]) == {"strahler"}
    assert analysis.segments["diameter_order"].isna().all()
    assert analysis.summary["max_diameter_order"] is None
    analysis.document()
