"""Skeletonisation of images of some thirty voxels, each with one thing in it that must be noticed.

They are so small that they also run without the compiler, where branches of kernels are counted.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.benchmarks.shapes import capsule, ring
from vascval.core.tree import Topology, Tree
from vascval.imaging import skeletonize
from vascval.imaging.rasterize import rasterize
from vascval.io.scans import open_scan
from vascval.io.volumes import Volume, write_volume

TRUTH = Tree(
    Topology(np.array([-1, 0, 1, 1])),
    np.array([[0.0, 0, 0], [0, 0, 10], [9, 1, 21], [-9, -1, 21]]),
    np.array([0.0, 2.6, 2.1, 2.1]),
)
"""A stem that forks."""


@pytest.fixture(scope="module", name="image")
def _image() -> Volume:
    return rasterize(TRUTH, voxel_mm=1.0, margin_mm=3.0)


def require_fork(tree: Tree, voxel_mm: float = 1.0) -> None:
    assert tree.parent.tolist() == [-1, 0, 1, 1]
    away = np.linalg.norm(tree.position_mm[:, None] - TRUTH.position_mm, axis=2)
    assert (away.min(axis=0) < 1.5 * voxel_mm).all()  # ends are found to a voxel, a junction of thick vessels less well
    # some hundred voxels a vessel: their volume scatters by several per cent
    np.testing.assert_allclose(np.sort(tree.radius_mm[1:]), np.sort(TRUTH.radius_mm[1:]), rtol=0.1)


def at(image: Volume, *point_mm: float) -> tuple[int, int, int]:
    x, y, z = np.rint(image.to_index(np.array(point_mm))).astype(int)
    return z, y, x


def test_a_fork(image: Volume) -> None:
    found = skeletonize(image)
    require_fork(found.tree)
    assert (found.image["n_components"], found.image["n_loops_cut"], found.image["n_cavities_filled"]) == (1, 0, 0)
    turned = skeletonize(image, root_mm=TRUTH.position_mm[3])
    np.testing.assert_allclose(turned.tree.position_mm[0], TRUTH.position_mm[3], atol=1.5)
    assert turned.tree.topology.n_terminals == 2


def test_a_fork_in_longer_voxels() -> None:
    require_fork(skeletonize(rasterize(TRUTH, voxel_mm=(0.8, 0.8, 1.2), margin_mm=3.0)).tree, voxel_mm=1.2)


def test_a_fork_read_block_by_block(image: Volume, tmp_path: Path) -> None:
    write_volume(image, tmp_path / "fork.nrrd")
    whole, blocks = skeletonize(image).tree, skeletonize(open_scan(tmp_path / "fork.nrrd")).tree
    np.testing.assert_array_equal(blocks.position_mm, whole.position_mm)
    np.testing.assert_array_equal(blocks.radius_mm, whole.radius_mm)


def test_a_cavity_and_an_island(image: Volume) -> None:
    values = image.values.copy()
    values[at(image, 0, 0, 5)] = 0
    values[1:4, 1:3, 1:3] = 1
    found = skeletonize(replace(image, values=values))
    assert (found.image["n_components"], found.image["n_voxels_left_out"]) == (2, 12)
    assert (found.image["n_cavities_filled"], found.image["n_voxels_filled"]) == (1, 1)
    np.testing.assert_array_equal(found.tree.position_mm, skeletonize(image).tree.position_mm)


def test_a_bump_on_the_wall_is_no_vessel() -> None:
    values = np.pad(capsule((0, 0, 1), 2.5, length_mm=24.0).volume.values, ((0, 0), (0, 0), (0, 4)))
    values[18:21, 6:9, 6:13] = 1
    found = skeletonize(Volume(values, np.ones(3)))
    assert found.image["n_spurs_pruned"] == 1
    assert found.tree.n_segments == 1
    assert found.tree.length_mm[1] == pytest.approx(24.0, abs=1.5)


def test_a_torn_vessel() -> None:
    values = capsule((0, 0, 1), 2.0, length_mm=20.0).volume.values.copy()
    values[12:14] = 0
    found = skeletonize(Volume(values, np.ones(3)))
    assert found.image["n_breaks_joined"] == 1
    assert found.tree.n_segments == 1
    assert found.tree.length_mm[1] == pytest.approx(20.0, abs=1.0)


def test_a_loop() -> None:
    case = ring(loop_mm=7.0, vessel_mm=1.6)
    found = skeletonize(case.volume)
    assert found.image["n_loops_cut"] == 1
    assert found.tree.length_mm.sum() == pytest.approx(case.truth.length_mm.sum(), rel=0.1)
