"""The compiled passes over sparse voxels against slow or library twins on dense arrays."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree
from skimage.measure import euler_number

from vascval.imaging import _geodesic_kernels, _graph_kernels, _thinning_kernels, graph, runs, voxels
from vascval.imaging.distance import distance_map
from vascval.imaging.thinning import thin
from vascval.imaging.tips import maxima

EVERY_NEIGHBOUR = np.ones((3, 3, 3))
SPACING = np.array([0.5, 0.7, 1.6])


def random_mask(seed: int, share: float, smooth: float = 1.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(4, 17, size=3))
    field = ndimage.gaussian_filter(rng.normal(size=shape), smooth)
    mask = field >= np.quantile(field, 1 - share)
    mask[tuple(size // 2 for size in shape)] = True
    return mask


def as_runs(mask: np.ndarray) -> runs.Runs:
    return runs.from_blocks(mask.shape, ((z, 0, mask[z : z + 1]) for z in range(len(mask))))


def as_mask(code: runs.Runs) -> np.ndarray:
    nz, ny, nx = code.shape
    return runs.painted(code, np.zeros(3, dtype=np.int64), np.array([nx, ny, nz])).astype(bool)


def step_lengths(spacing: np.ndarray) -> np.ndarray:
    code = np.arange(27)
    offset = np.stack((code % 3 - 1, code // 3 % 3 - 1, code // 9 - 1), axis=1)
    return np.sqrt(((offset * spacing) ** 2).sum(axis=1))


masks = st.builds(random_mask, st.integers(0, 10**6), st.floats(0.02, 0.9), st.sampled_from([0.0, 0.7, 1.5]))


@settings(deadline=None, max_examples=60)
@given(masks)
def test_runs_components_and_cavities_are_those_of_the_dense_mask(mask: np.ndarray) -> None:
    code = as_runs(mask)
    assert np.array_equal(as_mask(code), mask)
    labels, n = ndimage.label(mask, EVERY_NEIGHBOUR)
    parts = runs.components(code)
    assert parts.size_voxels.tolist() == sorted(np.bincount(labels.ravel())[1:].tolist(), reverse=True)
    assert n == parts.size_voxels.size
    largest = as_mask(runs.keep(code, parts.label, np.arange(parts.size_voxels.size) == 0))
    assert np.unique(labels[largest]).size == 1
    filled, n_cavities, n_filled = runs.fill_cavities(code)
    expected = ndimage.binary_fill_holes(mask)
    assert np.array_equal(as_mask(filled), expected)
    assert n_filled == expected.sum() - mask.sum()
    assert n_cavities == ndimage.label(expected & ~mask)[1]


@settings(deadline=None, max_examples=40)
@given(masks, st.integers(0, 10**6))
def test_union_and_single_voxels(mask: np.ndarray, seed: int) -> None:
    rng = np.random.default_rng(seed)
    index = rng.integers(-1, np.array(mask.shape)[::-1] + 1, size=(30, 3))
    inside = ((index >= 0) & (index < np.array(mask.shape)[::-1])).all(axis=1)
    more = np.zeros_like(mask)
    more[tuple(index[inside].T[::-1])] = True
    single = runs.from_voxels(mask.shape, index)
    assert np.array_equal(as_mask(single), more)
    assert np.array_equal(as_mask(runs.union(as_runs(mask), single)), mask | more)


@settings(deadline=None, max_examples=60)
@given(masks)
def test_distance_map_is_exact(mask: np.ndarray) -> None:
    listed = voxels.from_runs(as_runs(mask), SPACING)
    found = distance_map(listed)
    background = np.argwhere(~mask)[:, ::-1] * SPACING
    if background.size == 0:
        assert np.isinf(found).all()
        return
    expected, _ = cKDTree(background).query(listed.index_xyz() * SPACING)
    assert np.abs(found - expected).max() < 1e-12 * expected.max() + 1e-12  # rounding of a sum of three squares


@settings(deadline=None, max_examples=40)
@given(masks, st.sampled_from([0.4, 2.0, 50.0]))
def test_neighbours_and_geodesic_distance_are_those_of_the_voxel_graph(mask: np.ndarray, width: float) -> None:
    listed = voxels.from_runs(as_runs(mask), SPACING)
    at = listed.index_xyz()
    number = np.full(mask.shape, -1)
    number[mask] = np.arange(listed.n)
    assert np.array_equal(listed.find(at), np.arange(listed.n))
    pairs, lengths = [], []
    step = step_lengths(SPACING)
    out, code = np.empty(26, np.int64), np.empty(26, np.int64)
    for i in range(listed.n):
        m = _geodesic_kernels.neighbours(i, listed.lattice, out, code)
        near = np.abs(at - at[i]).max(axis=1) == 1
        assert sorted(out[:m].tolist()) == np.flatnonzero(near).tolist()
        pairs += [(i, j) for j in out[:m].tolist()]
        lengths += step[code[:m]].tolist()
    way = np.full(listed.n, np.inf)
    _geodesic_kernels.geodesic(0, listed.lattice, step, width, way)
    if not pairs:
        assert way.tolist()[0] == 0.0
        return
    row, column = np.array(pairs).T
    table = coo_matrix((lengths, (row, column)), shape=(listed.n, listed.n)).tocsr()
    expected = dijkstra(table, indices=0)
    reached = np.isfinite(expected)
    assert np.array_equal(np.isfinite(way), reached)
    assert np.abs(way[reached] - expected[reached]).max() < 1e-9  # sums of the same steps in another order


def test_geodesic_distance_is_the_same_bit_for_bit_across_tiles() -> None:
    """A lump, a sheet and threads over several tiles, against relaxation of all edges until nothing changes."""
    rng = np.random.default_rng(1)
    mask = ndimage.gaussian_filter(rng.normal(size=(100, 90, 12)), 2.0) > 0.02
    mask[60] = True
    parts = runs.components(as_runs(mask))
    listed = voxels.from_runs(runs.keep(as_runs(mask), parts.label, np.arange(parts.size_voxels.size) == 0), SPACING)
    at, step = listed.index_xyz(), step_lengths(SPACING)
    offset = np.stack((np.arange(27) % 3 - 1, np.arange(27) // 3 % 3 - 1, np.arange(27) // 9 - 1), axis=1)
    near = {c: listed.find(at + offset[c]) for c in range(27) if c != 13}
    expected = np.full(listed.n + 1, np.inf)
    expected[listed.n // 3] = 0.0
    while True:
        nearer = np.min([expected[neighbour] + step[c] for c, neighbour in near.items()], axis=0)
        nearer = np.minimum(nearer, expected[:-1])
        if np.array_equal(nearer, expected[:-1]):
            break
        expected[:-1] = nearer
    for width in (1.0, 20.0):
        way = np.full(listed.n, np.inf)
        _geodesic_kernels.geodesic(listed.n // 3, listed.lattice, step, width, way)
        assert np.array_equal(way, nearer)


@settings(deadline=None, max_examples=300)
@given(st.integers(0, 2**26 - 1))
def test_simple_voxels_are_those_whose_removal_keeps_the_topology(bits: int) -> None:
    """A voxel is simple if parts, cavities and the Euler number, hence tunnels, are the same without it."""
    mask = 0
    block = np.zeros((5, 5, 5), dtype=bool)
    for k, code in enumerate(c for c in range(27) if c != 13):
        if bits >> k & 1:
            mask |= 1 << code
            block[1 + code // 9, 1 + code // 3 % 3, 1 + code % 3] = True
    without, with_it = block.copy(), block.copy()
    with_it[2, 2, 2] = True

    def shape(image: np.ndarray) -> tuple[int, int, int]:
        return (
            ndimage.label(image, EVERY_NEIGHBOUR)[1],
            ndimage.label(~image)[1],
            euler_number(image, connectivity=3),
        )

    near26, near6 = _thinning_kernels.adjacency_masks()
    assert _thinning_kernels.is_simple(mask, near26, near6) == (shape(without) == shape(with_it))


@settings(deadline=None, max_examples=60)
@given(masks)
def test_thinning_keeps_the_topology_and_loops_are_counted_right(mask: np.ndarray) -> None:
    code = as_runs(mask)
    parts = runs.components(code)
    code = runs.keep(code, parts.label, np.arange(parts.size_voxels.size) == 0)
    code, _, _ = runs.fill_cavities(code)
    listed = voxels.from_runs(code, np.ones(3))
    thickness = distance_map(listed)
    left = thin(listed, thickness, np.array([0, listed.n - 1]))
    assert left[0] and left[-1]
    skeleton = np.zeros(mask.shape, dtype=bool)
    skeleton[tuple(listed.index_xyz(np.flatnonzero(left)).T[::-1])] = True
    padded = np.pad(as_mask(code), 1)
    euler = euler_number(padded, connectivity=3)
    assert euler_number(np.pad(skeleton, 1), connectivity=3) == euler
    assert ndimage.label(skeleton, EVERY_NEIGHBOUR)[1] == 1
    joined = graph.spanning_skeleton(listed, left, np.where(np.isfinite(thickness), thickness, 1.0))
    # in one piece without cavities the Euler number is 1 - number of tunnels
    assert len(joined.cuts) == 1 - euler
    assert len(joined.edges) == left.sum() - 1


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10**6), st.integers(3, 14), st.floats(0.1, 0.9))
def test_generators_of_loops_are_those_of_the_slow_closure(seed: int, n: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    pairs = [(i, j) for i in range(n) for j in range(i + 1, n) if j == i + 1 or rng.random() < share]
    pairs = [pairs[k] for k in rng.permutation(len(pairs))]
    known = {pair for pair in pairs if pair[1] == pair[0] + 1}
    in_tree = np.array([pair in known for pair in pairs])
    expected = []
    while len(known) < len(pairs):
        for i, j in pairs:
            third = ({tuple(sorted((i, k))), tuple(sorted((j, k)))} <= known for k in range(n) if k not in (i, j))
            if (i, j) not in known and any(third):
                known.add((i, j))
                break
        else:
            expected.append(next(k for k, pair in enumerate(pairs) if pair not in known))
            known.add(pairs[expected[-1]])
    a, b = np.array(pairs, dtype=np.int32).T.copy()
    assert _graph_kernels.independent_loops(n, a, b, in_tree).tolist() == expected


def test_many_loops_take_time_in_proportion() -> None:
    def ladder_s(n: int) -> float:
        """CPU seconds for a ladder of n rungs, of which the first alone is in the tree."""
        foot = np.arange(n, dtype=np.int32)
        a = np.concatenate((foot[:-1], n + foot[:-1], foot))
        b = np.concatenate((foot[1:], n + foot[1:], n + foot))
        in_tree = np.arange(a.size) <= 2 * (n - 1)
        taken = []
        for _ in range(5):
            begin = time.process_time()
            found = _graph_kernels.independent_loops(2 * n, a, b, in_tree)
            taken.append(time.process_time() - begin)
            assert found.size == n - 1
        return min(taken)

    assert ladder_s(128_000) < 4 * 32 * ladder_s(4_000)  # quadratic: 1,024 times


@settings(deadline=None, max_examples=100)
@given(masks, st.integers(0, 10**6), st.integers(1, 60))
def test_maxima_are_those_of_a_sweep_from_high_to_low(mask: np.ndarray, seed: int, different: int) -> None:
    """Every voxel in turn joins the parts that it touches, and the one with the lower peak ends there."""
    listed = voxels.from_runs(as_runs(mask), SPACING)
    rng = np.random.default_rng(seed)
    height, value = rng.choice(rng.normal(size=different), listed.n), rng.normal(size=listed.n)
    rank = np.argsort(np.argsort(-height, kind="stable"))
    at = listed.index_xyz()
    parts: list[list[int]] = []
    expected = set()
    for i in np.argsort(-height, kind="stable").tolist():
        touched = [part for part in parts if np.abs(at[part] - at[i]).max(axis=1).min() == 1]
        # parts meet in the order of their first voxels around i, which decides whose the value of i itself is
        touched.sort(key=lambda part: min(j for j in part if np.abs(at[j] - at[i]).max() == 1))
        mine = [i]
        for other in touched:
            parts.remove(other)
            kept, ended = sorted((mine, other), key=lambda part: rank[part].min())
            if ended != [i]:
                expected.add((ended[0], i, value[ended].max()))
            mine = kept + ended
        parts.append(mine)
    expected |= {(part[0], -1, value[part].max()) for part in parts}
    found = maxima(listed, height, value)
    assert len(expected) == found[0].size
    assert set(zip(*(values.tolist() for values in found))) == expected


@settings(deadline=None, max_examples=30)
@given(masks, st.sampled_from([1, 2, 4]))
def test_painted_blocks_are_those_that_hold_a_voxel(mask: np.ndarray, block: int) -> None:
    code, size = as_runs(mask), np.array(mask.shape[::-1])
    found = runs.painted(code, np.zeros(3, dtype=np.int64), size, block)
    padded = np.pad(mask, [(0, -n % block) for n in mask.shape])
    nz, ny, nx = (n // block for n in padded.shape)
    assert np.array_equal(found, padded.reshape(nz, block, ny, block, nx, block).any(axis=(1, 3, 5)))


@settings(deadline=None, max_examples=30)
@given(masks)
def test_voxels_are_found_where_they_are_and_nowhere_else(mask: np.ndarray) -> None:
    listed = voxels.from_runs(as_runs(mask), np.ones(3))
    places = np.stack(np.meshgrid(*(np.arange(-1, n + 1) for n in mask.shape[::-1]), indexing="ij"), axis=-1)
    places = places.reshape(-1, 3)
    found = listed.find(places)
    inside = np.pad(mask, 1)[tuple(places.T[::-1] + 1)]
    assert np.array_equal(found >= 0, inside)
    assert np.array_equal(listed.index_xyz(found[inside]), places[inside])
    assert np.array_equal(listed.index_xyz(slice(1, None, 3)), listed.index_xyz()[1::3])


def test_persistence_of_maxima_by_hand() -> None:
    mask = np.zeros((3, 12, 30), dtype=bool)
    mask[1, 2, 2:28] = True  # a trunk along x
    mask[1, 2:9, 15] = True  # a side branch of 6
    listed = voxels.from_runs(as_runs(mask), np.ones(3))
    way = listed.index_xyz()[:, :2].sum(axis=1).astype(np.float64)
    tip, saddle, _ = maxima(listed, way, np.ones(listed.n))
    found = {tuple(listed.index_xyz(t)): (way[t] - way[s] if s >= 0 else np.inf) for t, s in zip(tip, saddle)}
    assert set(found) == {(27, 2, 1), (15, 8, 1)}
    assert found[27, 2, 1] == np.inf
    # the side branch touches the trunk corner to corner at (16, 2, 1), of way 18
    assert found[15, 8, 1] == pytest.approx(23 - 18)
