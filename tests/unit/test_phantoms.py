"""The phantoms keep their promises, the score counts what it says, the benchmark runs."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_fill_holes
from skimage.measure import euler_number, label

from tests.benchmarks import _growth_kernels as kernels
from tests.benchmarks import bench_memory, bench_skeletonize, shapes
from tests.benchmarks.phantoms import KINDS, Phantom, Rules, drawn_radius, grow, phantom, resampled, rough_image
from tests.benchmarks.score import score
from vascval.core.contraction import degenerate_segments
from vascval.core.errors import ComputationError
from vascval.core.ordering import n_terminals_below
from vascval.core.tree import Topology, Tree
from vascval.imaging import skeletonize
from vascval.imaging.rasterize import rasterize

SMALL = {"size": 128, "n_terminals": 20}


@pytest.fixture(scope="module", params=KINDS)
def small(request: pytest.FixtureRequest) -> Phantom:
    return phantom(request.param, 1, **SMALL)


def test_counts_and_radii_are_those_asked_for(small: Phantom) -> None:
    tree, n_children = small.truth, small.truth.topology.n_children
    n_three = round(20 / 15) if small.name.startswith("trifurcating") else 0
    assert tree.topology.n_terminals == 20
    assert np.bincount(n_children, minlength=4).tolist() == [20, 1, 19 - 2 * n_three, n_three]
    expected = 2.0 * n_terminals_below(tree.topology) ** (1 / 3)
    assert np.allclose(tree.radius_mm[1:], expected[1:], rtol=1e-12)
    assert degenerate_segments(tree).size == 0


@pytest.mark.parametrize("bend_mm", [0.0, 1.5])
def test_vessels_keep_the_rules(bend_mm: float) -> None:
    """By points along the centrelines, without the kernels that grew the tree."""
    rules = Rules()
    tree = grow(np.random.default_rng(4), bend_mm=bend_mm, n_trifurcations=2, **SMALL)
    lines = [np.zeros((0, 3)), *(resampled(tree.polyline(i), 0.25) for i in range(1, tree.n_nodes))]
    parent, radius = tree.parent, tree.radius_mm
    leaf = tree.topology.n_children == 0
    for i in range(1, tree.n_nodes):
        assert leaf[i] or tree.chord_mm[i] >= 2.0 * rules.min_aspect * radius[i]
        for j in range(1, tree.n_nodes):
            if i == j:
                continue
            apart = np.linalg.norm(lines[i][:, None] - lines[j][None], axis=2)
            if leaf[i]:
                assert apart[-1].min() > radius[j] + rules.min_stub_mm - 1e-9 - bend_mm
            if parent[i] not in (parent[j], j) and parent[j] != i:
                assert apart.min() > radius[i] + radius[j] + rules.clearance_mm - 1e-9
        for j in tree.topology.children(parent[i]):
            if j != i:
                u, v = (tree.position_mm[k] - tree.position_mm[parent[i]] for k in (i, j))
                cosine = u @ v / np.linalg.norm(u) / np.linalg.norm(v)
                assert math.degrees(math.acos(cosine)) >= rules.min_angle_deg - 1e-6


def test_images_are_sound(small: Phantom) -> None:
    mask = small.volume.values
    if small.name.startswith("rough"):
        pytest.skip("rough walls do make tunnels and islands")
    assert label(mask, connectivity=3).max() == 1
    assert euler_number(mask, connectivity=3) == 1 == kernels.euler_number(mask)
    assert mask[0].max() == mask[-1].max() == mask[:, 0].max() == mask[:, -1].max() == 0
    assert mask[:, :, 0].max() == mask[:, :, -1].max() == 0


def test_image_has_the_volume_of_its_vessels(small: Phantom) -> None:
    """Against a drawing of the same tree in eighth voxels; for the rough image with its own radii."""
    fine = rasterize(small.drawn, voxel_mm=0.5).values.sum() * 0.125
    found = small.volume.values.sum() * small.volume.spacing_mm.prod()
    # Smooth: counting noise of the some 10,000 voxels on the wall, 0.3 sqrt(10,000) / 20,000 = 0.15 %, three allowed.
    # Rough: junctions, which no segment's radius covers, and loose voxels come to a few per cent.
    assert abs(found / fine - 1.0) < (0.04 if small.name.startswith("rough") else 0.005)


@pytest.mark.parametrize("mask", [np.zeros((3, 3, 3)), np.ones((2, 3, 4)), np.eye(3)[None]])
def test_euler_number_of_easy_bodies(mask: np.ndarray) -> None:
    assert kernels.euler_number(mask.astype(np.uint8)) == euler_number(mask > 0, connectivity=3)


def test_euler_number_of_noise() -> None:
    mask = np.random.default_rng(0).random((9, 10, 11)) < 0.3
    assert kernels.euler_number(mask.view(np.uint8)) == euler_number(mask, connectivity=3)


def test_drawn_radius_of_known_displacement() -> None:
    straight = shapes.capsule((1.0, 2.0, 2.0), 4.0, shift_mm=(10.0, 10.0, 10.0)).truth
    flat = np.full((60, 60, 60), 0.7, dtype=np.float32)
    assert drawn_radius(straight, flat, np.zeros_like(flat))[1] == pytest.approx(3.3, rel=1e-6)
    within = np.full_like(flat, -1.0)  # every ray ends within another tube
    assert drawn_radius(straight, flat, within)[1] == 4.0


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_vessels_along_an_axis_survive(axis: int) -> None:
    """Thinning after Lee erases bars and tubes along an axis; ours must find one vessel in each."""
    for width, height in shapes.ERASED_BARS:
        found = skeletonize(shapes.bar(axis, width, height)).tree
        assert found.n_segments == 1
        assert 40 - max(width, height) - 1 <= found.length_mm[1] <= 40
    for radius_mm in (1.0, 1.5, 2.0, 2.5, 3.0):
        for shift in (0.0, 0.25, 0.5):
            tube = shapes.capsule(np.eye(3)[axis], radius_mm, shift_mm=(shift, shift, shift))
            found = skeletonize(tube.volume).tree
            assert found.n_segments == 1
            assert found.length_mm[1] == pytest.approx(40.0, abs=1.5)


def test_drawn_radius_has_the_volume_of_the_rough_image() -> None:
    line = shapes.capsule((0.3, 0.2, 1.0), 3.0, length_mm=120.0, shift_mm=(15.0, 15.0, 15.0)).truth
    volume, drawn = rough_image(line, np.random.default_rng(2), shape=(150, 60, 80))
    middle = volume.values[30:120].sum()  # away from both ends
    length = 90.0 * line.length_mm[1] / 120.0 * 120.0 / (line.position_mm[1] - line.position_mm[0])[2]
    radius = math.sqrt(middle / (math.pi * length))
    # Voxel counting is good to 0.2 %, and a quarter of the vessel is not in the slabs counted: its own mean differs by
    # about 0.6 mm / sqrt(560 mm^2 / patches of 28 mm^2) / 4, 1 % of the radius.
    assert abs(drawn.radius_mm[1] / radius - 1.0) < 0.015
    assert drawn.radius_mm[1] > 3.03


def test_a_phantom_is_the_same_every_time() -> None:
    first, second = (phantom("rough", 3, **SMALL) for _ in range(2))
    assert np.array_equal(first.volume.values, second.volume.values)
    assert np.array_equal(first.truth.position_mm, second.truth.position_mm)
    assert not np.array_equal(first.truth.position_mm, phantom("rough", 4, **SMALL).truth.position_mm)


def test_no_room_is_said() -> None:
    with pytest.raises(ComputationError, match="no room for terminal"):
        grow(np.random.default_rng(0), size=48, n_terminals=60)
    with pytest.raises(ValueError, match="no kind of phantom"):
        phantom("fluffy", 0)


def test_shapes_have_the_topology_that_they_promise() -> None:
    for made in (shapes.ring(), shapes.touching()):
        assert label(made.volume.values, connectivity=3).max() == 1
        assert euler_number(made.volume.values, connectivity=3) == 0  # one piece, one tunnel
    smooth = phantom("smooth", 0, size=128, n_terminals=10)
    islands = shapes.with_islands(smooth, np.random.default_rng(0), n=4)
    assert label(islands.volume.values, connectivity=3).max() == 5
    hollow = shapes.hollow(smooth).volume.values
    assert 0.5 < hollow.sum() / smooth.volume.values.sum() < 0.9  # most vessels are 2 mm thin
    assert np.array_equal(binary_fill_holes(hollow), smooth.volume.values)
    assert shapes.bar(0, 2, 3, length=9).values.shape == (11, 10, 17)
    assert [shapes.bar(axis, 2, 3, length=9).values.sum() for axis in range(3)] == [54, 54, 54]


@pytest.fixture(scope="module")
def truth() -> Tree:
    return grow(np.random.default_rng(7), n_trifurcations=3, **SMALL)


def test_the_truth_scores_full_marks(truth: Tree) -> None:
    s = score(truth, truth, 1.0, image={"n_loops_cut": 2})
    assert (s.n_tips, s.tips_found, s.tips_false, s.tip_offset, s.n_loops) == (20, 1.0, 0.0, 0.0, 2)
    assert (s.segments_matched, s.radius_error, s.length_error, s.total_length_bias) == (1.0, 0.0, 0.0, 0.0)
    assert (s.junctions_found, s.n_junctions_false, s.junction_offset) == (1.0, 0, 0.0)
    assert (s.n_trifurcations, s.trifurcations_found, s.n_trifurcations_false) == (3, 1.0, 0)
    assert s.elements_equal and s.elements_deviation == 0.0 and s.elements_found == s.elements_true
    assert s.centreline_offset < 0.03  # truth is sampled every tenth of a voxel


def test_scaled_radii_and_shifted_trees_are_measured(truth: Tree) -> None:
    s = score(replace(truth, radius_mm=0.9 * truth.radius_mm), truth, 1.0)
    assert s.radius_error == pytest.approx(0.1) and s.radius_bias == pytest.approx(-0.1)
    shifted = replace(truth, position_mm=truth.position_mm + np.array([0.0, 0.0, 3.0]))
    s = score(shifted, truth, 1.0)
    assert s.tips_found == 1.0 and [s.tip_offset, s.junction_offset] == pytest.approx([3.0, 3.0])
    assert s.length_error == pytest.approx(0.0, abs=1e-12)
    assert 1.0 < s.centreline_offset < 3.0  # less than the shift: it counts across the vessels alone
    assert score(shifted, truth, 0.5).tips_found == 0.0  # 6 voxels are beyond the tolerance of 5


def without(tree: Tree, tip: int) -> Tree:
    """The tree without a terminal whose parent has another two children or more, or one, which then goes on."""
    keep = np.arange(tree.n_nodes) != tip
    parent = np.cumsum(keep)[tree.parent[keep]] - 1
    parent[0] = -1
    return Tree(Topology(parent), tree.position_mm[keep], tree.radius_mm[keep])


def test_a_missed_tip_costs_its_junction(truth: Tree) -> None:
    three = np.flatnonzero(truth.topology.n_children == 3)
    tip = next(t for t in truth.topology.terminals if truth.parent[t] in three)
    s = score(without(truth, tip), truth, 1.0)
    assert s.tips_found == 19 / 20 and s.tips_false == 0.0
    assert s.trifurcations_found == pytest.approx(2 / 3) and s.n_trifurcations_false == 0
    assert s.segments_matched == (truth.n_segments - 1) / truth.n_segments
    assert not s.elements_equal and s.elements_true[0] == 20 and s.elements_found[0] == 19
    assert s.elements_deviation >= 1 / 20 and s.radius_error == 0.0


def test_a_false_tip_costs_precision(truth: Tree) -> None:
    spot = int(np.flatnonzero(truth.topology.n_children == 2)[0])
    parent = np.append(truth.parent, spot)
    position = np.vstack((truth.position_mm, truth.position_mm[spot] + [6.0, 6.0, 6.0]))
    s = score(Tree(Topology(parent), position, np.append(truth.radius_mm, 1.0)), truth, 1.0)
    assert s.tips_found == 1.0 and s.tips_false == 1 / 20
    assert s.n_trifurcations_false == 1 and s.n_junctions_false == 1 and s.trifurcations_found == 1.0
    assert s.segments_matched == 1.0 and s.elements_deviation >= 1 / 20


def test_exchanged_branches_are_no_match() -> None:
    """Two forks that swap a tip: all tips found, neither fork."""
    x, z = [0, 0, -20, 20, -30, -10, 10, 30], [0, 20, 40, 40, 60, 60, 60, 60]
    position = np.stack((x, np.zeros(8), z), axis=1)
    radius = np.array([3.0, 3, 2, 2, 1, 1, 1, 1])
    true = Tree(Topology(np.array([-1, 0, 1, 1, 2, 2, 3, 3])), position, radius)
    swapped = Tree(Topology(np.array([-1, 0, 1, 1, 2, 3, 2, 3])), position, radius)
    s = score(swapped, true, 1.0)
    assert s.tips_found == 1.0 and s.segments_matched == 5 / 7
    assert s.junctions_found == 0.0 and s.n_junctions_false == 3  # the root fork parts other tips, too
    assert s.elements_equal


def test_orders_are_compared_over_clear_terminals() -> None:
    """Four terminals, of which one may end at the wall of another."""
    position = np.array(
        [[0, 0, 0], [0, 0, 20], [40, 0, 40], [-40, 0, 40], [40, 0, 120], [90, 0, 60], [8, 0, 100], [-90, 0, 60]], float
    )
    radius = np.array([4.0, 4, 3, 3, 3, 1, 1, 1])
    tree = Tree(Topology(np.array([-1, 0, 1, 1, 2, 2, 3, 3])), position, radius)
    assert not bench_memory.blurred(tree).any()
    assert bench_memory.clear_tips(tree, tree) == (0, 0, True)
    position[6] = [36, 0, 100]  # less than a voxel from the wall of the vessel to node 4
    touching = Tree(tree.topology, position, radius)
    assert np.flatnonzero(bench_memory.blurred(touching)).tolist() == [4, 6]
    assert bench_memory.clear_tips(without(touching, 6), touching) == (1, 0, True)
    assert bench_memory.clear_tips(without(touching, 5), touching) == (1, 1, True)
    x, z = [0, 0, -20, 20, -30, -10, 10, 30], [0, 20, 40, 40, 60, 60, 60, 60]
    position = np.stack((x, np.zeros(8), z), axis=1)
    fork = Tree(Topology(np.array([-1, 0, 1, 1, 2, 2, 3, 3])), position, radius / 4)
    comb = Tree(Topology(np.array([-1, 0, 1, 1, 2, 2, 4, 4])), position[[0, 1, 2, 4, 3, 5, 6, 7]], radius / 4)
    assert bench_memory.clear_tips(comb, fork) == (0, 0, False)


def test_benchmark_runs_at_a_tiny_size(capsys: pytest.CaptureFixture[str]) -> None:
    rows = bench_skeletonize.main(["--size", "80", "--terminals", "4", "--seeds", "1", "--kinds", "smooth"])
    said = capsys.readouterr().out
    ours = next(row for row in rows if row["tool"] == "vascval")
    assert ours["tips_found"] == 1.0 and ours["radius_error"] < 0.05 and 0.0 < ours["wall_s"] < 60.0
    assert "| smooth | 0 | vascval |" in said
    assert "| smooth | 0 | skan |" in said or "skan left out" in said


def test_convergence_study_runs_at_a_tiny_size(capsys: pytest.CaptureFixture[str]) -> None:
    rows = bench_skeletonize.main(["--size", "120", "--terminals", "24", "--convergence", "--tools", "vascval"])
    assert [round(row["voxel_mm"], 3) for row in rows] == [1.0, 0.794, 0.63, 0.5]
    assert "| order |" in capsys.readouterr().out


def test_benchmark_refuses_unknown_names(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        bench_skeletonize.main(["--kinds", "fluffy"])
    assert "unknown: fluffy" in capsys.readouterr().err
