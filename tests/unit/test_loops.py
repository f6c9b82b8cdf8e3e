"""Loops of vessels are opened at their thinnest vessel, wherever their thinnest voxel is."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from vascval.core.tree import Topology, Tree
from vascval.imaging import skeletonize
from vascval.imaging._graph_kernels import chains, spanning
from vascval.imaging.distance import distance_map
from vascval.imaging.graph import spanning_skeleton
from vascval.imaging.loops import _vessel_mm, open_loops
from vascval.imaging.rasterize import rasterize
from vascval.imaging.runs import components, keep
from vascval.imaging.selection import select
from vascval.imaging.thinning import thin
from vascval.imaging.tips import find_tips
from vascval.imaging.voxels import from_runs
from vascval.io.volumes import Volume

PARENT = np.array([-1, 0, 1, 1, 3, 3, 4, 4])
POSITION_MM = np.array(
    [[5.0, 30, 15], [30, 30, 15], [110, 30, 15], [35, 30, 45], [70, 30, 50], [35, 60, 48], [82, 30, 20], [90, 60, 52]]
)
RADIUS_MM = np.array([0.0, 9, 8.5, 2.7, 2.0, 2.0, 1.6, 1.6])


@pytest.mark.parametrize("seed", range(8))
def test_a_terminal_that_runs_into_the_trunk_is_cut_and_not_the_vessel_that_feeds_it(seed: int) -> None:
    shift = np.random.default_rng(seed).uniform(0.0, 1.0, 3)
    tree = Tree(Topology(PARENT), POSITION_MM + shift, RADIUS_MM)
    found = skeletonize(rasterize(tree, voxel_mm=1.0, shape=(70, 70, 120), origin_mm=(0.0, 0.0, 0.0)))
    assert found.image["n_loops_cut"] == 1
    way = tree.position_mm[6] - tree.position_mm[4]
    cut = found.loops_mm[0] - tree.position_mm[4]
    along = cut @ way / (way @ way)
    assert 0.0 < along <= 1.0
    assert np.linalg.norm(cut - along * way) < 2.0
    # the vessels beyond it stay with theirs: 7 with 5 and not with the trunk
    first, second = (np.linalg.norm(found.tree.position_mm - tree.position_mm[i], axis=1).argmin() for i in (5, 7))
    fork = _above(found.tree, int(first)) & _above(found.tree, int(second))
    assert np.linalg.norm(found.tree.position_mm[max(fork)] - tree.position_mm[3]) < 2.0


def _above(tree: Tree, node: int) -> set[int]:
    above = {node}
    while node > 0:
        node = int(tree.parent[node])
        above.add(node)
    return above


@pytest.mark.parametrize("seed", range(6))
def test_a_sponge_comes_out_as_a_tree_with_a_cut_for_every_loop(seed: int) -> None:
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=(40, 44, 48)), 2.0)
    sponge = Volume((noise > 0.3 * noise.std()).astype(np.uint8), np.ones(3), np.zeros(3), np.eye(3))
    runs = select(sponge).runs
    parts = components(runs)
    voxels = from_runs(keep(runs, parts.label, np.arange(parts.size_voxels.size) == 0), sponge.spacing_mm)
    thickness = distance_map(voxels)
    tips = find_tips(voxels, thickness)
    skeleton = spanning_skeleton(voxels, thin(voxels, thickness, tips.voxel), thickness)
    at = thickness[skeleton.voxel]
    ends = np.searchsorted(skeleton.voxel, tips.voxel)
    opened, loops = open_loops(skeleton, ends, voxels.index_xyz(skeleton.voxel) * 1.0, at, np.zeros(at.size))
    n = skeleton.voxel.size
    assert len(loops.cuts) + loops.n_pinholes == len(skeleton.cuts)
    assert len(loops.cuts) > 10
    assert len(opened.edges) == len(skeleton.edges) == n - 1
    joined = coo_matrix((np.ones(n - 1), opened.edges.T), shape=(n, n))
    assert connected_components(joined, directed=False)[0] == 1
    before, after = ({tuple(sorted(pair)) for pair in one.tolist()} for one in (skeleton.edges, opened.edges))
    cuts = [{tuple(sorted(pair)) for pair in one.tolist()} for one in (skeleton.cuts, loops.cuts)]
    assert after - before <= cuts[0]
    assert before - after <= cuts[1]


def test_chains_between_nodes() -> None:
    """A stem 0-1, a ring 1-2-3-4-1 with a side branch 3-5 and a loop 5-6-7-5 of one chain."""
    edges = [(0, 1), (1, 2), (2, 3), (3, 4), (4, 1), (3, 5), (5, 6), (6, 7), (7, 5)]
    a, b = np.array(edges).T.copy()
    degree = np.bincount(np.concatenate((a, b)))
    point, offset = chains(8, a, b, degree != 2)
    found = sorted(point[i:j].tolist() for i, j in pairwise(offset))
    assert found == [[0, 1], [1, 2, 3], [1, 4, 3], [3, 5], [5, 6, 7, 5]]


@pytest.mark.parametrize("seed", range(5))
def test_what_spans_is_what_kruskal_keeps(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 12
    a, b, rank = rng.integers(0, n, 30), rng.integers(0, n, 30), rng.permutation(30)
    group = [{i} for i in range(n)]
    kept = []
    for e in rank.tolist():
        one = next(g for g in group if a[e] in g)
        other = next(g for g in group if b[e] in g)
        if one is not other:
            kept.append(e)
            group.remove(other)
            one |= other
    assert np.flatnonzero(spanning(n, a, b, rank)).tolist() == sorted(kept)


def test_a_vessel_is_as_thick_as_it_is_outside_its_junctions_and_contact_as_its_narrowest_place() -> None:
    line = np.stack((np.arange(31.0), np.zeros(31), np.zeros(31)), axis=1)
    thickness = np.full(31, 2.0)
    thickness[:9], thickness[28:] = 8.0, 3.0
    thickness[10:12] = 1.0
    # clear of both balls: 9 to 26
    assert _vessel_mm(line, thickness) == pytest.approx((2 * 1.0 + 16 * 2.0) / 18)
    assert _vessel_mm(line[:12], thickness[:12] + 5.0) == 6.0
