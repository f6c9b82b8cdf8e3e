"""The tables by order and generation of small trees, every number by hand."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest

from vascval.core.ordering import strahler_order
from vascval.core.tree import Topology, Tree
from vascval.morphometry import orders


def bent() -> Tree:
    """A trunk of three segments (1, 2, 3) with side branches 4 and 5, and a fork of 6 and 7 at its end."""
    parent = np.array([-1, 0, 1, 2, 1, 2, 3, 3])
    position = np.array([[0, 0, 0], [0, 0, 4], [0, 0, 6], [0, 0, 9], [1, 0, 4], [0, 2, 6], [3, 0, 9], [0, 4, 9.0]])
    return Tree(Topology(parent), position, np.array([0, 2.0, 1.8, 1.0, 0.5, 0.4, 0.6, 0.8]))


@pytest.fixture
def table() -> pd.DataFrame:
    tree = bent()
    return orders.element_table(tree, strahler_order(tree.topology))


def test_elements(table: pd.DataFrame) -> None:
    assert table["element"].tolist() == [0, 1, 2, 3, 4]
    assert table["parent_element"].tolist() == [-1, 0, 0, 0, 0]
    assert table["order"].tolist() == [2, 1, 1, 1, 1]
    assert table["generation"].tolist() == [1, 2, 2, 2, 2]
    assert table["n_segments"].tolist() == [3, 1, 1, 1, 1]
    assert table["length_mm"].tolist() == [9, 1, 2, 3, 4]
    trunk = (4 * 2.0 + 2 * 1.8 + 3 * 1.0) / 9
    assert table["radius_mm"].tolist() == pytest.approx([trunk, 0.5, 0.4, 0.6, 0.8], rel=1e-15)
    # from the middle of the first segment to that of the last: 9 - (4 + 3) / 2 = 5.5 mm, over which half is lost
    assert table["taper_per_mm"][0] == pytest.approx(0.5 / 5.5, rel=1e-15)
    assert table["taper_per_mm"][1:].isna().all()


def test_elements_of_less_than_a_millimetre(table: pd.DataFrame) -> None:
    """The same tree a hundredth as long: radii are weighted all the same, and tapers a hundred times as steep."""
    tree = bent()
    small = Tree(tree.topology, tree.position_mm / 100, tree.radius_mm)
    found = orders.element_table(small, strahler_order(tree.topology))
    assert found["radius_mm"].tolist() == pytest.approx(table["radius_mm"].tolist(), rel=1e-12)
    assert found["length_mm"].tolist() == pytest.approx((table["length_mm"] / 100).tolist(), rel=1e-12)
    assert found["taper_per_mm"][0] == pytest.approx(100 * table["taper_per_mm"][0], rel=1e-12)


def test_an_element_of_two_segments_tapers() -> None:
    parent, z = np.array([-1, 0, 1, 1, 2, 2]), [0, 2.0, 6.0]
    position = np.array([[0, 0, z[0]], [0, 0, z[1]], [0, 0, z[2]], [1, 0, 2], [1, 0, 6], [0, 1, 6.0]])
    tree = Tree(Topology(parent), position, np.array([0, 2.0, 1.5, 0.4, 0.5, 0.6]))
    table = orders.element_table(tree, strahler_order(tree.topology))
    assert table["n_segments"].tolist() == [2, 1, 1, 1]
    assert table["taper_per_mm"][0] == pytest.approx(0.25 / 3.0, rel=1e-15)  # a quarter over (2 + 4) / 2 mm


def test_elements_of_no_length() -> None:
    """Radii of segments without length count alike; there is no taper over no distance."""
    parent = np.array([-1, 0, 1, 2, 2])
    position = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [1, 0, 0], [0, 1, 0.0]])
    tree = Tree(Topology(parent), position, np.array([0, 3.0, 1.0, 0.5, 0.4]))
    table = orders.element_table(tree, strahler_order(tree.topology))
    assert table["n_segments"].tolist() == [2, 1, 1]
    assert table["radius_mm"].tolist() == [2.0, 0.5, 0.4]
    assert table["length_mm"].tolist() == [0, 1, 1]
    assert table["taper_per_mm"].isna().all()


def segments_of(tree: Tree) -> pd.DataFrame:
    order = strahler_order(tree.topology)
    return pd.DataFrame(
        {
            "parent": tree.parent[1:] - 1, "generation": 3 - order[1:], "radius_mm": tree.radius_mm[1:],
            "length_mm": tree.length_mm[1:], "tortuosity": np.arange(1.0, tree.n_nodes),
            "length_to_diameter": np.arange(10.0, 10 * tree.n_nodes, 10),
            "monopodial": [False, False, False, True, True, False, False],
        }
    )  # fmt: skip


def test_orders_and_generations(table: pd.DataFrame) -> None:
    tree = bent()
    order, segments = strahler_order(tree.topology), segments_of(bent())
    found = orders.order_table("strahler", order, segments, table)
    assert found["ordering"].tolist() == ["strahler"] * 2
    assert found["order"].tolist() == [1, 2]
    assert found["n_segments"].tolist() == [4, 3]
    assert found["n_elements"].tolist() == [4, 1]
    thin, thick = [0.5, 0.4, 0.6, 0.8], [2.0, 1.8, 1.0]
    assert found["radius_mean_mm"].tolist() == pytest.approx([np.mean(thin), np.mean(thick)])
    assert found["radius_sd_mm"].tolist() == pytest.approx([np.std(thin, ddof=1), np.std(thick, ddof=1)])
    assert found["radius_se_mm"].tolist() == pytest.approx([np.std(thin, ddof=1) / 2, np.std(thick, ddof=1) / 3**0.5])
    assert found["length_mean_mm"].tolist() == pytest.approx([2.5, 3.0])
    assert found["element_length_mean_mm"].tolist() == pytest.approx([2.5, 9.0])
    assert found["element_radius_mean_mm"][0] == pytest.approx(np.mean(thin))
    assert found["segments_per_element"].tolist() == [1, 3]
    assert found["taper_mean_per_mm"][1] == pytest.approx(0.5 / 5.5)
    assert math.isnan(found["taper_mean_per_mm"][0])
    assert found["tortuosity_mean"].tolist() == [5.5, 2.0]
    assert found["length_to_diameter_mean"].tolist() == [55.0, 20.0]
    junctions = pd.DataFrame(
        {"generation": [0, 1, 1, 1], "branching_ratio": [0.1, 0.25, 0.4, 0.75], "n_children": [3, 3, 2, 2]}
    )
    rows = orders.generation_table(segments, table, junctions)
    assert rows["generation"].tolist() == [1, 2]
    assert rows["order"].tolist() == [2, 1]
    assert rows["n_segments"].tolist() == [3, 4]
    assert rows["n_elements"].tolist() == [1, 4]
    assert rows["radius_mean_mm"].tolist() == pytest.approx([np.mean(thick), np.mean(thin)])
    assert rows["radius_sd_mm"].tolist() == pytest.approx([np.std(thick, ddof=1), np.std(thin, ddof=1)])
    assert rows["length_mean_mm"].tolist() == pytest.approx([3.0, 2.5])
    assert rows["length_sd_mm"].tolist() == pytest.approx([1.0, np.std([1, 2, 3, 4], ddof=1)])
    assert rows["branching_ratio_mean"][0] == pytest.approx(1.4 / 3)
    assert rows["branching_ratio_sd"][0] == pytest.approx(np.std([0.25, 0.4, 0.75], ddof=1))
    assert rows["n_junctions"].tolist() == [3, 0]
    assert rows["n_trifurcations"].tolist() == [1, 0]
    assert rows["n_monopodial"].tolist() == [2, 0]
    assert rows["tortuosity_mean"].tolist() == [2.0, 5.5]
    assert rows["length_to_diameter_mean"].tolist() == [20.0, 55.0]
    assert rows["total_length_mm"].tolist() == [9.0, 10.0]


def test_the_root_segment_alone_has_the_highest_order() -> None:
    parent = np.array([-1, 0, 1, 1])
    position = np.array([[0, 0, 0], [0, 0, 5], [1, 0, 5], [0, 2, 5.0]])
    tree = Tree(Topology(parent), position, np.array([0, 2.0, 0.5, 0.7]))
    order = strahler_order(tree.topology)
    elements = orders.element_table(tree, order)
    segments = pd.DataFrame(
        {
            "radius_mm": tree.radius_mm[1:], "length_mm": tree.length_mm[1:], "tortuosity": [1.0, 2.0, 3.0],
            "length_to_diameter": [1.0, 2.0, 3.0],
        }
    )  # fmt: skip
    found = orders.order_table("strahler", order, segments, elements)
    assert found["n_segments"].tolist() == [2, 1]
    assert found["radius_mean_mm"].tolist() == pytest.approx([0.6, 2.0])
    assert found["length_mean_mm"].tolist() == [1.5, 5.0]


def test_horton_ratios_of_exact_series() -> None:
    """Numbers fall by 4, radii rise by 1.5, lengths by 2; the highest order is off the line."""
    radius, length = [1, 1.5, 2.25, 9.0], [1, 2, 4, 5.0]
    table = pd.DataFrame(
        {"n_elements": [64, 16, 4, 2], "element_radius_mean_mm": radius, "element_length_mean_mm": length}
    )
    found = orders.horton_table("strahler", table)
    assert found["quantity"].tolist() == ["number", "radius", "length"] * 2
    assert found["order_min"].tolist() == [1] * 6
    assert found["order_max"].tolist() == [4] * 3 + [3] * 3
    assert found["n_orders"].tolist() == [4] * 3 + [3] * 3
    assert found["ratio"][3:].tolist() == pytest.approx([4, 1.5, 2])
    assert found["slope"][3:].tolist() == pytest.approx([-math.log10(4), math.log10(1.5), math.log10(2)])
    assert found["r_squared"][3:].tolist() == pytest.approx([1, 1, 1])
    slope, _ = np.polyfit([1, 2, 3, 4], np.log10([64, 16, 4, 2]), 1)
    assert found["slope"][0] == pytest.approx(slope)
    assert found["ratio"][0] == pytest.approx(10 ** abs(slope))
    assert found["ordering"].tolist() == ["strahler"] * 6
    assert orders.horton_table("x", table[:3])["n_orders"].tolist() == [3] * 3 + [2] * 3
    assert orders.horton_table("x", table[:2])["n_orders"].tolist() == [2] * 3


@pytest.mark.filterwarnings("error")
def test_connectivity_by_hand() -> None:
    """Two elements of order 2 with three and one daughters of order 1; one of order 3 feeds both and one of order 1."""
    elements = pd.DataFrame({"order": [3, 2, 2, 1, 1, 1, 1, 1], "parent_element": [-1, 0, 0, 1, 1, 1, 2, 0]})
    found = orders.connectivity_table("strahler", elements).set_index(["order_child", "order_parent"])
    assert len(found) == 9
    assert found.loc[(1, 2), ["n_elements", "n_parent_elements", "mean", "se"]].tolist() == [4, 2, 2.0, 1.0]
    assert found.loc[(1, 3), ["n_elements", "n_parent_elements", "mean"]].tolist() == [1, 1, 1.0]
    assert math.isnan(found.loc[(1, 3), "se"])
    assert found.loc[(2, 3), ["n_elements", "mean"]].tolist() == [2, 2.0]
    assert found.loc[(2, 2), ["n_elements", "mean", "se"]].tolist() == [0, 0.0, 0.0]
    assert found.loc[(1, 1), ["n_elements", "n_parent_elements", "mean", "se"]].tolist() == [0, 5, 0.0, 0.0]
    assert (found["ordering"] == "strahler").all()
    assert found.reset_index()["order_parent"].tolist() == [1, 1, 1, 2, 2, 2, 3, 3, 3]
