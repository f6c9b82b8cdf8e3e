"""Comparisons whose result is known beforehand."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from vascval.comparison import compare
from vascval.core.errors import InputError
from vascval.core.tree import Topology, Tree
from vascval.io.documents import read_reference_table
from vascval.morphometry import analyze


def grown(levels=6, seed=0):
    """A symmetric binary tree in space, its splits in changing planes."""
    rng = np.random.default_rng(seed)
    parent, position, radius, heading = [-1, 0], [np.zeros(3), np.array([40.0, 0, 0])], [0.0, 3.0], [None, np.eye(3)[0]]
    front = [1]
    for level in range(1, levels):
        children = []
        for node in front:
            side = np.cross(heading[node], rng.normal(size=3))
            side /= np.linalg.norm(side)
            for sign in (-1, 1):
                way = heading[node] + sign * side * rng.uniform(0.5, 0.9)
                way /= np.linalg.norm(way)
                parent.append(node)
                position.append(position[node] + way * 40 * 0.8**level)
                radius.append(radius[node] * rng.uniform(0.7, 0.8))
                heading.append(way)
                children.append(len(parent) - 1)
        front = children
    return Tree(Topology(np.array(parent)), np.array(position), np.array(radius))


def shifted(tree, shift):
    return replace(tree, position_mm=tree.position_mm + np.asarray(shift, float))


@pytest.fixture(scope="module")
def cast():
    return analyze(grown(), source="cast")


def test_a_tree_agrees_with_itself(cast):
    result = compare(cast, [cast])
    differences = result.differences[0].drop(columns="generation").to_numpy()
    assert np.nanmax(np.abs(differences)) == 0.0
    assert (result.totals["difference"].dropna() == 0).all()
    assert (result.distributions["wasserstein"] == 0).all()
    assert (result.distributions["effect_size"].dropna() == 0).all()
    assert result.distributions["p_value"].dropna().min() == pytest.approx(1.0, abs=1e-12)
    location = result.location[0]
    assert location.matched_down_to_generation == 6
    for side in ("cast", "tree"):
        assert (location.generations[f"{side}_matched_share"] == 1.0).all()
        assert location.generations[f"{side}_distance_max_mm"].max() < 1e-12  # round-off of coordinates up to 150 mm
    territories = result.territories[0]
    assert territories is not None
    assert territories.generations["dice"].tolist() == [1.0] * 5
    assert territories.generations["dice_mean"].tolist() == [1.0] * 5
    assert territories.generations["n_cast"].tolist()[:3] == [1, 2, 4]


def test_a_shifted_tree_is_off_by_no_more_than_the_shift(cast):
    tree = analyze(shifted(grown(), [0, 0, 2.0]), source="shifted")
    table = compare(cast, [tree], tolerance_mm=2.1, generation_window=0).location[0].generations
    # the root runs along x: its image is exactly 2 mm away
    assert table["cast_distance_mean_mm"].iloc[0] == pytest.approx(2.0, rel=1e-12)
    assert (table["cast_distance_max_mm"] <= 2.0 + 1e-12).all()
    assert (table["cast_matched_share"] == 1.0).all()
    strict = compare(cast, [tree], tolerance_mm=0.1, generation_window=0).location[0]
    # the radius of the root, 3 mm, is more than the tolerance and than the shift; that of the tips is not
    assert strict.generations["cast_matched_share"].iloc[0] == 1.0
    assert strict.generations["cast_matched_share"].iloc[-1] < 0.6
    assert strict.matched_down_to_generation < 6


def test_location_tells_generations_apart():
    """Of the two branches of the cast one lies on the tree's trunk, which goes on with generation 1."""
    spine = [[0, 0, 0], [10, 0, 0], [20, 5, 0], [20, -5, 0]]
    cast = analyze(Tree(Topology(np.array([-1, 0, 1, 1])), np.array(spine, float), np.full(4, 0.1)), source="cast")
    twigs = [[30, 8, 0], [30, 2, 0], [30, -8, 0], [30, -2, 0], [40, 9, 0], [40, 7, 0], [40, 3, 0], [40, 1, 0]]
    parent = np.array([-1, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5])
    tree = analyze(Tree(Topology(parent), np.array(spine + twigs, float), np.full(12, 0.1)), source="tree")
    assert tree.segments["generation"].tolist()[:5] == [1, 1, 2, 2, 2]
    apart = compare(cast, [tree], tolerance_mm=0.05, generation_window=0).location[0]
    assert apart.generations["cast_matched_any_share"].tolist()[:2] == [1.0, 1.0]
    # of the branch on the trunk, 11.18 mm, the ends are within its radius, 0.1 mm, of generation 2: 0.125 mm where it
    # parts from the other branch at 53.13 degrees, 0.1 mm before the tree's next junction; in steps of 0.0125 mm
    stray = 0.225 / 11.18
    assert apart.generations["cast_matched_share"].tolist()[:2] == pytest.approx([1.0, 0.5 + stray / 2], abs=6e-4)
    assert apart.cast_segments["matched_share"].tolist() == pytest.approx([1.0, stray, 1.0], abs=1.2e-3)
    alike = compare(cast, [tree], tolerance_mm=0.05, generation_window=1).location[0]
    assert alike.generations["cast_matched_share"].tolist()[:2] == [1.0, 1.0]


def test_differences_cover_the_union_of_generations(cast):
    small = analyze(grown(levels=4), source="small")
    rows = compare(cast, [small]).differences[0].set_index("generation")
    assert rows.index.tolist() == [1, 2, 3, 4, 5, 6]
    assert rows["n_segments"].tolist() == [0, 0, 0, 0, -16, -32]
    assert rows["n_segments_relative"].tolist() == [0, 0, 0, 0, -1, -1]
    assert rows["radius_mean_mm"].isna().tolist() == [False] * 4 + [True] * 2
    back = compare(small, [cast]).differences[0].set_index("generation")
    assert back["n_segments"].tolist() == [0, 0, 0, 0, 16, 32]
    assert back["n_segments_relative"].isna().tolist() == [False] * 4 + [True] * 2
    expected = cast.generations["radius_mean_mm"][1] - small.generations["radius_mean_mm"][1]
    assert back["radius_mean_mm"].loc[2] == pytest.approx(expected, rel=1e-14)
    assert back["radius_mean_mm_relative"].loc[2] == pytest.approx(
        expected / small.generations["radius_mean_mm"][1], rel=1e-14
    )


def test_effect_size_points_to_the_larger_side(cast):
    thick = analyze(replace(grown(), radius_mm=grown().radius_mm * 1.2), source="thick", diameters=0)
    result = compare(cast, [thick]).distributions
    radius = result[(result["measure"] == "radius_mm") & result["generation"].isna()].iloc[0]
    assert 0 < radius["effect_size"] <= 1
    # every radius is 1.2 times its own: the sorted values pair up
    assert radius["wasserstein"] == pytest.approx(0.2 * radius["mean_cast"], rel=1e-12)
    last = result[(result["measure"] == "radius_mm") & (result["generation"] == 1)].iloc[0]
    assert (last["n_cast"], last["n_tree"]) == (1, 1)
    assert math.isnan(last["p_value"])


def test_exponents_equal_up_to_round_off_are_ties(cast):
    tree = grown()
    radius = np.array(tree.radius_mm)
    for i in range(tree.n_nodes - 1, 0, -1):
        kids = tree.topology.children(i)
        if kids.size:
            radius[i] = (radius[kids] ** 3).sum() ** (1 / 3)
    murray = analyze(replace(tree, radius_mm=radius), source="a", diameters=0)
    scaled = analyze(replace(tree, radius_mm=radius * 1.1), source="b", diameters=0)
    table = compare(murray, [scaled]).distributions.set_index("measure")
    row = table[table["generation"].isna()].loc["murray_exponent"]
    assert (row["effect_size"], row["p_value"]) == (0.0, 1.0)
    assert math.isnan(row["wasserstein_relative"])


def test_trees_in_other_frames_are_noted(cast):
    far = analyze(shifted(grown(), [1000, 0, 0]), source="far")
    result = compare(cast, [far])
    assert result.territories == [None]
    assert result.location[0].matched_down_to_generation == 0
    assert "far lies wholly outside the bounding box of cast: they do not share a frame" in " ".join(result.notes)
    json.dumps(result.document(), allow_nan=False)


def test_a_published_table_stands_in_for_the_cast(cast, tmp_path):
    path = tmp_path / "published.csv"
    path.write_text("# A paper\ngeneration,n_segments,radius_mean_mm\n1,1,3.0\n2,4,\n9,100,0.1\n")
    table = read_reference_table(path)
    result = compare(table, [cast])
    rows = result.differences[0].set_index("generation")
    assert set(rows.columns) == {"n_segments", "n_segments_relative", "radius_mean_mm", "radius_mean_mm_relative"}
    assert rows.index.tolist() == [1, 2, 3, 4, 5, 6, 9]
    assert rows["n_segments"].loc[[1, 2, 9]].tolist() == [0, -2, -100]
    assert rows["n_segments"].loc[[3, 4, 5, 6]].isna().all()  # the table does not say
    assert rows["n_segments_relative"].loc[2] == -0.5
    assert (result.location, result.territories, len(result.distributions)) == ([], [], 0)
    document = result.document()
    assert document["cast"]["citation"] == "A paper"
    beside = compare(cast, [cast], reference=table)
    assert len(beside.reference_differences) == 2
    assert [item["tree"] for item in beside.document()["reference_differences"]] == ["cast", "cast"]
    assert beside.reference_differences[0]["n_segments"].equals(rows["n_segments"].reset_index(drop=True))


def test_stages_are_reported_to_the_observer(cast):
    seen = []
    compare(cast, [cast, cast], observer=lambda stage, done, total: seen.append((stage, done, total)))
    assert seen[0] == ("differences", 0, 1)
    assert ("location", 1, 2) in seen
    assert seen[-1] == ("done", 1, 1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tolerance_mm": 0.0}, "the tolerance is 0.0 mm; a positive number is needed"),
        ({"step_mm": math.nan}, "the step is nan mm; a positive number is needed"),
        ({"matched_threshold": 1.5}, r"generations within 1 and a share of 1.5; 0 or more, and a share in \(0, 1\]"),
        ({"generation_window": -1}, "generations within -1 and a share of 0.5"),
    ],
)
def test_parameters_out_of_range_are_refused(cast, options, message):
    with pytest.raises(InputError, match=message):
        compare(cast, [cast], **options)


def test_a_comparison_needs_a_tree(cast):
    with pytest.raises(InputError, match="there is no tree to compare with the cast; give one or more"):
        compare(cast, [])


def test_default_tolerance_scales_with_the_cast(cast):
    tree = grown()
    small = analyze(replace(tree, position_mm=tree.position_mm / 10, radius_mm=tree.radius_mm / 10), source="small")
    large, little = compare(cast, [cast]), compare(small, [small])
    diagonal = np.linalg.norm(np.ptp(cast.tree.position_mm, axis=0))
    assert large.location[0].rule.tolerance_mm == pytest.approx(0.01 * diagonal, rel=1e-14)
    assert little.location[0].rule.tolerance_mm == pytest.approx(0.001 * diagonal, rel=1e-12)
    assert little.location[0].rule.step_mm == pytest.approx(0.00025 * diagonal, rel=1e-12)


def test_matched_by_chance_is_the_share_of_common_tissue_near_like_vessels(cast):
    """With a tolerance beyond every distance all tissue is near; with a tiny one hardly any."""
    everywhere = compare(cast, [cast], tolerance_mm=1000.0).location[0].generations["cast_chance_share"]
    assert everywhere.to_numpy() == pytest.approx(1.0, abs=1e-12)
    nowhere = compare(cast, [cast], tolerance_mm=1e-3, step_mm=5.0).location[0].generations["cast_chance_share"]
    # a tube of the local radius, 0.7 mm, around 31 vessels of 13 mm is a small part of the hull
    assert 0 <= nowhere.iloc[-1] < 0.05
