"""What optimising changes in the generations: measures and errors, and that the page says what its table says."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from reports import make
from reports.common.pages import headline
from reports.common.trees import made
from reports.portal_vein.change import ALL, AS_GROWN, RADII, at_equal_flow, by_generation, change, changes, with_errors
from reports.portal_vein.trees import BEST, GROWN, ONCE, PAPERS, optimised, trees
from vascval.core.contraction import degenerate_segments

FOLDER = make.HERE / "portal_vein"


@pytest.fixture(scope="module")
def tree():
    return made("portal-vein", n_terminals=200).tree


def larger(tree, factor):
    return replace(tree, position_mm=factor * tree.position_mm, radius_mm=factor * tree.radius_mm)


@pytest.fixture(scope="module")
def rows(tree):
    twice = {GROWN: [tree, tree], BEST: [larger(tree, 1.1), larger(tree, 1.3)], ONCE: [tree, larger(tree, 0.5)]}
    twice[PAPERS] = twice[ONCE]
    return by_generation(twice, (1, 2))


@pytest.mark.parametrize("name", [name for name, (_, against) in RADII.items() if against == GROWN])
def test_a_tree_as_a_whole_larger_is_wider_in_all_generations_and_numbered_alike(rows, name):
    found = change(rows, RADII[name][0], BEST)
    for seed, percent in ((1, 10.0), (2, 30.0)):
        assert found[seed].dropna().to_numpy() == pytest.approx(0.0 if "numbering" in name else percent, abs=1e-9)


def test_the_radius_is_the_product_of_numbering_and_radius_at_equal_flow(rows):
    own = rows[rows["tree"] == GROWN]
    assert (own["root_of_terminals"] * own["radius_at_equal_flow"]).to_numpy() == pytest.approx(own["radius_mean_mm"])


def test_growth_not_contracted_has_more_segments(rows, tree):
    counts = rows[rows["seed"] == 1].groupby("tree")["n_segments"].sum()
    assert counts[AS_GROWN] == tree.n_segments
    assert counts[GROWN] == tree.n_segments - degenerate_segments(tree).size < tree.n_segments


def test_mean_error_and_number_leave_out_what_is_missing():
    rows = with_errors(pd.DataFrame({1: [1.0, 5.0], 2: [3.0, np.nan], 3: [8.0, np.nan]}))
    assert rows["change_percent"].tolist() == [4.0, 5.0] and rows["seeds"].tolist() == [3, 1]
    assert rows["error_percent"].iloc[0] == pytest.approx(np.sqrt(13 / 3)) and np.isnan(rows["error_percent"].iloc[1])


def test_classes_of_equal_flow(tree):
    found = at_equal_flow(tree, larger(tree, 1.25))
    assert found.index.tolist()[:4] == [1, 2, 4, 8] and found.index.max() <= tree.topology.n_terminals
    assert found.to_numpy() == pytest.approx(25.0)


def test_both_optimised_trees_feed_the_same_terminals_and_only_the_uncontracted_one_has_short_segments():
    best, once = optimised(150, 1, ("topology.at=60", "topology.tests=500"))
    asked = {"topology__at": 60, "topology__tests": 500, "geometry__contract": False}
    public = made("portal-vein", n_terminals=150, method="full", **asked).tree
    assert np.array_equal(once.position_mm, public.position_mm) and np.array_equal(once.radius_mm, public.radius_mm)
    ends = [np.sort(tree.position_mm[tree.topology.terminals], axis=0) for tree in (best, once)]
    assert np.array_equal(*ends)
    assert degenerate_segments(best).size == 0 < degenerate_segments(once).size


def test_there_is_a_tree_of_each_kind_for_every_seed_and_they_differ():
    made = trees(60, (1, 2), ("topology.at=40", "topology.tests=200"))
    volumes = [tree.volume_mm3 for by_seed in made.values() for tree in by_seed]
    assert len(made) == 4 and len(set(volumes)) == len(volumes) == 8


def test_the_page_says_what_its_generations_say():
    found = changes(pd.read_csv(FOLDER / "generations.csv"))
    written = pd.read_csv(FOLDER / "changes.csv")
    keys = ["tree", "measure", "generation"]
    assert found[keys].astype(str).equals(written[keys].astype(str))
    assert np.allclose(
        found[["change_percent", "error_percent"]],
        written[["change_percent", "error_percent"]],
        atol=1e-3,
        equal_nan=True,
    )
    said = headline(FOLDER)
    for kind in (BEST, ONCE, PAPERS):
        usual = written[(written["tree"] == kind) & (written["measure"] == "mean over segments")]
        row = usual[usual["generation"] == ALL].iloc[0]
        assert f"by {row['change_percent']:+.1f} ± {row['error_percent']:.1f} %" in said
