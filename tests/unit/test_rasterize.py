"""Rasterised trees against the definition, voxel by voxel, and against volumes known in closed form."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vascval.core.errors import InputError
from vascval.core.tree import Topology, Tree
from vascval.imaging.rasterize import grid_around, rasterize, wall_distance
from vascval.io.volumes import Volume


def random_tree(seed: int, n: int = 8, *, curved: bool = False) -> Tree:
    rng = np.random.default_rng(seed)
    parent = np.array([-1, *(rng.integers(0, i) for i in range(1, n))])
    position = rng.uniform(0.0, 12.0, (n, 3))
    radius = rng.uniform(0.3, 2.5, n)
    if not curved:
        return Tree(Topology(parent), position, radius)
    lines = [np.array([position[parent[i]], *rng.uniform(0.0, 12.0, (2, 3)), position[i]]) for i in range(1, n)]
    offset = np.concatenate(([0, 0], 4 * np.arange(1, n)))
    return Tree(Topology(parent), position, radius, polyline_mm=np.concatenate(lines), polyline_offset=offset)


def slow_wall_distance(tree: Tree, volume: Volume) -> np.ndarray:
    """Distance to the nearest tube wall at every voxel centre: every voxel against every piece."""
    index = np.stack(np.meshgrid(*(np.arange(n) for n in volume.values.shape), indexing="ij"), axis=-1)
    points = volume.to_world(index[..., ::-1])
    nearest = np.full(volume.values.shape, np.inf)
    for i in range(1, tree.n_nodes):
        line = tree.polyline(i)
        for a, b in pairwise(line):
            square = max(((b - a) ** 2).sum(), 1e-300)
            s = np.clip(((points - a) @ (b - a)) / square, 0.0, 1.0)
            distance = np.linalg.norm(points - a - s[..., None] * (b - a), axis=-1)
            nearest = np.minimum(nearest, distance - tree.radius_mm[i])
    return nearest


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    spacing=st.sampled_from([(1.0, 1.0, 1.0), (0.5, 0.8, 1.3), (1.0, 1.0, 2.0)]),
    curved=st.booleans(),
)
def test_every_voxel_follows_the_definition(seed: int, spacing: tuple[float, float, float], curved: bool) -> None:
    tree = random_tree(seed, curved=curved)
    mask = rasterize(tree, voxel_mm=spacing)
    wall = slow_wall_distance(tree, mask)
    clear = np.abs(wall) > 1e-9  # nearer than that, rounding decides
    assert clear.mean() > 0.99
    assert mask.values.dtype == np.uint8
    assert np.array_equal(mask.values[clear], (wall <= 0)[clear])
    banded = wall_distance(tree, voxel_mm=spacing, band_mm=1.5)
    assert np.abs(banded.values - np.minimum(wall, 1.5)).max() < 2e-6  # float32 of values up to 3 mm


def test_a_voxel_exactly_at_the_radius_belongs() -> None:
    tree = Tree(Topology(np.array([-1, 0])), np.array([[0.0, 0, 0], [5.0, 0, 0]]), np.array([2.0, 2.0]))
    values = rasterize(tree, voxel_mm=1.0, origin_mm=(-4, -4, -4), shape=(9, 9, 14)).values
    assert values[4, 4, 2] == 1 and values[4, 4, 1] == 0  # the cap ends at x = -2
    assert values[6, 4, 4] == 1 and values[7, 4, 4] == 0  # the side at z = 2
    assert values[4, 4, 11] == 1 and values[4, 4, 12] == 0


@pytest.mark.parametrize("voxel_mm", [0.5, 0.25])
def test_volume_of_a_rounded_tube(voxel_mm: float) -> None:
    end = np.array([7.0, 11.0, 16.0])
    tree = Tree(Topology(np.array([-1, 0])), np.array([[0.1, 0.2, 0.3], end]), np.array([3.0, 3.0]))
    exact = math.pi * 9.0 * tree.length_mm[1] + 4.0 / 3.0 * math.pi * 27.0
    found = rasterize(tree, voxel_mm=voxel_mm).values.sum() * voxel_mm**3
    # The wall cuts about area / voxel^2 = 1,900 voxels of 0.5 mm, each off by 0.3 voxels at random: a standard
    # deviation of 0.3 sqrt(1900) / 5,500 = 0.24 % of the volume, and half of it at half the voxel. Three are allowed.
    assert abs(found / exact - 1.0) < 0.0072 * (voxel_mm / 0.5)


def test_blocks_are_parts_of_the_whole() -> None:
    tree = random_tree(3, 30, curved=True)
    whole = rasterize(tree, voxel_mm=(0.3, 0.4, 0.5))
    nz, ny, nx = whole.values.shape
    together = np.zeros_like(whole.values)
    cuts = [(0, n // 3, n // 2, n) for n in (nz, ny, nx)]
    for z in pairwise(cuts[0]):
        for y in pairwise(cuts[1]):
            for x in pairwise(cuts[2]):
                part = rasterize(tree, voxel_mm=(0.3, 0.4, 0.5), block=(z, y, x))
                together[slice(*z), slice(*y), slice(*x)] = part.values
                assert np.allclose(part.origin_mm, whole.to_world(np.array([x[0], y[0], z[0]])), atol=1e-12)
    assert np.array_equal(together, whole.values)


def test_the_grid_encloses_the_tree_with_its_margin() -> None:
    tree = random_tree(5, 20)
    volume = rasterize(tree, voxel_mm=(0.5, 0.7, 0.9), margin_mm=2.0)
    filled = np.argwhere(volume.values)
    low, high = volume.to_world(filled.min(axis=0)[::-1]), volume.to_world(filled.max(axis=0)[::-1])
    first, last = volume.origin_mm, volume.to_world(np.array(volume.values.shape[::-1]) - 1)
    # The outermost voxel centre lies up to a voxel inside the wall, or a bit more where the wall is a round cap.
    assert ((low - first >= 2.0 - 1e-9) & (low - first < 2.0 + 2 * volume.spacing_mm)).all()
    assert ((last - high >= 2.0 - 1e-9) & (last - high < 2.0 + 3 * volume.spacing_mm)).all()


def test_a_given_grid_cuts_tubes_off_and_may_miss_the_tree() -> None:
    tree = random_tree(7)
    whole = rasterize(tree, voxel_mm=0.5, origin_mm=(-3, -3, -3), shape=(40, 40, 40)).values
    cut = rasterize(tree, voxel_mm=0.5, origin_mm=(2.0, 2.0, 2.0), shape=(12, 13, 14)).values
    assert cut.any() and np.array_equal(cut, whole[10:22, 10:23, 10:24])
    assert not rasterize(tree, voxel_mm=0.5, origin_mm=(100, 100, 100), shape=(4, 4, 4)).values.any()
    assert grid_around(tree, voxel_mm=0.5, origin_mm=(100, 100, 100)).shape == (1, 1, 1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"voxel_mm": 0.0}, "absurd"),
        ({"voxel_mm": float("nan")}, "absurd"),
        ({"voxel_mm": (1.0, 1.0)}, "one number or three"),
        ({"voxel_mm": 1.0, "margin_mm": -1.0}, "margin_mm is -1.0"),
        ({"voxel_mm": 1.0, "origin_mm": (0.0, float("inf"), 0.0)}, "origin_mm is .* three finite numbers"),
        ({"voxel_mm": 1.0, "shape": (10, 10)}, "three positive whole numbers"),
        ({"voxel_mm": 1.0, "shape": (10, 0, 10)}, "three positive whole numbers"),
        ({"voxel_mm": 1.0, "shape": (9, 9, 9), "block": ((0, 9), (0, 9), (5, 10))}, "no part of a grid"),
        ({"voxel_mm": 1.0, "shape": (9, 9, 9), "block": ((0, 9), (3, 3), (0, 9))}, "no part of a grid"),
        ({"voxel_mm": 1e-4}, "GiB allowed; take larger voxels"),
        ({"voxel_mm": 0.5, "max_memory_bytes": 1000}, "more than the 0.0 GiB allowed"),
    ],
)
def test_wrong_requests_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        rasterize(random_tree(0), **options)


def test_there_must_be_something_to_draw() -> None:
    bare = Tree(Topology(np.array([-1])), np.zeros((1, 3)), np.zeros(1))
    with pytest.raises(InputError, match="nothing to draw"):
        rasterize(bare, voxel_mm=1.0)
    with pytest.raises(InputError, match="band_mm is 0"):
        wall_distance(random_tree(0), voxel_mm=1.0, band_mm=0.0)
