"""Horton ratios of real organs, and where a tree stands among them."""

import numpy as np
import pandas as pd
import pytest

from vascval.io.rows import OrganRow
from vascval.morphometry.orders import horton_table
from vascval.morphometry.organs import CAVEAT, SOURCES, organ_table, organs
from vascval.report import organ_section


def orders(n=6, branching=3.0, widening=1.5, lengthening=2.0):
    order = np.arange(1, n + 1)
    return pd.DataFrame(
        {
            "order": order,
            "n_elements": branching ** (n - order.astype(float)),
            "element_radius_mean_mm": 0.1 * widening**order,
            "element_length_mean_mm": 1.0 * lengthening**order,
        }
    )


def test_tables_are_whole():
    table = organs()
    assert table.groupby("organ")["order"].apply(lambda order: (np.diff(order) == 1).all()).all()
    assert set(table["ordering"]) == {"strahler", "diameter-defined"}
    assert set(table["source"]) == set(SOURCES)
    assert table["order"].min() == 1 and table["radius_mm"].notna().all()
    for _, organ in table.groupby("organ"):  # orders are of diameters, and there is less of what is thicker
        assert (np.diff(organ["radius_mm"]) > 0).all()
        counts = organ["n_elements"].dropna()
        assert (np.diff(counts) < 0).all()


def test_ratios_are_the_slopes_of_numpys_line():
    found = organ_table(horton_table("strahler", orders())).set_index(["organ", "quantity"])
    kidney = organs().query("organ == 'rat kidney, arteries'").iloc[:-1]
    slope = np.polyfit(kidney["order"], np.log10(kidney["n_elements"]), 1)[0]
    # both are double precision least squares over eleven points
    assert found.loc[("rat kidney, arteries", "number"), "ratio"] == pytest.approx(10**-slope, rel=1e-9)


def test_a_tree_stands_beside_organs_of_its_kind_of_orders():
    found = organ_table(horton_table("strahler", orders()))
    kidney, others = (found[(found["ordering"] == kind)] for kind in ("strahler", "diameter-defined"))
    ratio = kidney.set_index("quantity")
    assert ratio["tree_ratio"].tolist() == pytest.approx([3.0, 1.5, 2.0])
    assert ratio.loc["number", "relative"] == pytest.approx(3.0 / ratio.loc["number", "ratio"] - 1)
    assert others["tree_ratio"].isna().all() and others["relative"].isna().all()
    assert found[found["organ"] == "human lung, arteries"].set_index("quantity")["ratio"].notna().tolist() == [
        False, True, False,
    ]  # fmt: skip
    assert list(found.columns) == list(OrganRow.model_fields)


def test_published_magnitudes():
    """Kassab et al. and Jiang et al. state number ratios of about 3 and diameter ratios of about 1.6 to 1.9."""
    found = organ_table(horton_table("strahler", orders()))
    known = found[found["ratio"].notna()].groupby("quantity")["ratio"]
    assert known.min()["number"] > 2.2 and known.max()["number"] < 4.0
    assert known.min()["radius"] > 1.2 and known.max()["radius"] < 2.2


def test_the_report_says_where_and_with_what_caveat():
    rows = organ_table(pd.concat([horton_table(kind, orders()) for kind in ("strahler", "diameter-defined")]))
    words = organ_section._standing(rows)
    number = rows[(rows["quantity"] == "number") & rows["ratio"].notna()]
    assert f"Number ratio above that of {(number['ratio'] < 3).sum()} of {len(number)} organs" in words
    assert "no pass mark" in CAVEAT
    none = organ_section._standing(rows.assign(tree_ratio=rows["tree_ratio"] / 100))
    assert f"Number ratio not above that of any of {len(number)} organs" in none
    every = organ_section._standing(rows.assign(tree_ratio=rows["tree_ratio"] * 100))
    assert f"Number ratio above that of any of {len(number)} organs" in every


def test_one_order_has_no_ratio_and_stands_nowhere():
    rows = organ_table(horton_table("strahler", orders(n=1)))
    assert rows["tree_ratio"].isna().all()
    assert organ_section._standing(rows) == "No number ratio; no diameter ratio; no length ratio."
