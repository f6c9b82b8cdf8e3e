"""Growth of a dozen terminals where something is in the way; small enough to run without the compiler."""

import numpy as np
import pytest

from generator.domain import Box
from generator.domain_shapes import ShapeDomain
from generator.growth import _index_kernels as index
from generator.growth import _overlap_kernels as overlaps
from generator.growth.growth import Growth, GrowthOptions
from generator.growth.root_tree import RootTree
from generator.haemodynamics import Perfusion
from vascval.core.errors import ComputationError, InputError
from vascval.morphometry.overlaps import overlapping_pairs

LAW = Perfusion(13332.2, 7999.3, 8333.3, 3.6e-3, 2.55)
THICK = Perfusion(13332.2, 7999.3, 1e6, 3.6e-3, 2.55)
BOX = Box((90.0, 70.0, 16.0))
CORNER = np.zeros(3)


def growth_of(n, *, domain=BOX, law=LAW, root=CORNER, seed=1, terminals=None, **options):
    return Growth(
        domain, law, root, n, options=GrowthOptions(**options), rng=np.random.default_rng(seed), terminals_mm=terminals
    )


def grown(growth):
    for _ in growth.steps():
        pass
    return growth.tree()


def root_tree():
    position = np.array([[0.0, 35, 8], [20, 35, 8], [35, 50, 8], [35, 20, 8]])
    return RootTree(np.array([-1, 0, 1, 1]), position, np.array([0.0, 3.0, 2.8, 2.8]))


def ends(store, n_nodes):
    """(N - 1, 2, 3) ends of all segments."""
    segment = store.segment[1:n_nodes]
    return np.stack([np.column_stack([segment[c + x] for x in "xyz"]) for c in "ab"], axis=1)


def overlapping(store, n_nodes, margin):
    """Pairs of segments without a common node that come closer than ``margin`` times the sum of their radii."""
    segment, end = store.segment, ends(store, n_nodes)
    pairs = []
    for s in range(1, n_nodes):
        for o in range(1, s):
            if segment["parent"][s] in (o, segment["parent"][o]) or segment["parent"][o] == s:
                continue
            near = np.sqrt(overlaps.square_between(*end[s - 1].ravel(), segment[o]))
            if near < margin * (segment["radius"][s] + segment["radius"][o]):
                pairs.append((s, o))
    return pairs


def test_before_the_first_vessel_there_is_no_tree():
    with pytest.raises(ComputationError, match="nothing has grown yet"):
        growth_of(3).tree()


def test_points_that_can_never_be_joined_end_growth():
    with pytest.raises(InputError, match="points in a row could not be joined to the tree of 2 terminals"):
        grown(growth_of(12, shortest_mm=60.0))


def test_a_root_that_sees_no_terminal_is_named():
    domain = ShapeDomain("horseshoe")
    other_leg = np.array([[29.0, -35.0, 0.0], [29.0, -34.0, 0.0]])
    with pytest.raises(InputError, match=r"no terminal can be placed at the root .* move the root away"):
        grown(growth_of(2, domain=domain, root=np.array([-29.0, -35.0, 0.0]), terminals=other_leg))


def test_of_two_ends_in_one_place_one_cannot_grow():
    position = np.array([[0.0, 35, 8], [20, 35, 8], [40, 35, 8], [40, 35, 8]])
    root = RootTree(np.array([-1, 0, 1, 1]), position, np.array([0.0, 3.0, 2.2, 2.0]))
    with pytest.raises(InputError, match=r"no terminal can be placed at the root \[40.0, 35.0, 8.0\]"):
        grown(growth_of(4, root=root))


@pytest.mark.parametrize("seed", [1, 2, 5])
def test_long_vessels_stay_in_the_box(seed):
    """Bifurcations are moved off the ends of short vessels, but not out of the domain."""
    tree = grown(growth_of(20, seed=seed, shortest_mm=15.0))
    assert tree.topology.n_terminals == 20
    assert BOX.contains(tree.position_mm).all()


def test_vessels_that_overlap_after_all_are_grown_anew(monkeypatch):
    """With less room left for growing radii than they take."""
    monkeypatch.setattr("generator.growth.growth._SLACK", 0.5)
    growth = growth_of(14, law=THICK, seed=1, apart=1.0)
    tree = grown(growth)
    assert growth.state()["progress"][1] > 1  # it did happen here
    assert len(overlapping_pairs(tree)) == 0
    points = BOX.sample(14, np.random.default_rng(5))
    growth = growth_of(14, law=THICK, terminals=points, seed=5, apart=1.0)
    tree = grown(growth)
    assert growth.state()["progress"][1] > 1
    assert len(overlapping_pairs(tree)) == 0
    found = tree.position_mm[tree.topology.terminals]
    np.testing.assert_array_equal(found[np.lexsort(found.T)], points[np.lexsort(points.T)])


def test_vessels_that_overlap_again_and_again_are_given_up(monkeypatch):
    monkeypatch.setattr("generator.growth.growth._SLACK", 0.5)
    points = BOX.sample(14, np.random.default_rng(1))
    with pytest.raises(ComputationError, match="terminals still overlap other vessels after 40 rounds"):
        grown(growth_of(14, law=THICK, terminals=points, apart=1.0))


def smaller(store, s, o):
    """The root tree stays, then stems, then what feeds more terminals, then what is older."""
    parent, n = store.segment["parent"], store.segment["n"]
    return max(s, o, key=lambda i: (i >= store.n_fixed, parent[i] >= store.n_fixed, -n[i], i))


@pytest.mark.parametrize("cells", [0.5, 0.1, 0.0])
@pytest.mark.parametrize("root", [CORNER, root_tree()], ids=["point", "root tree"])
def test_overlaps_are_those_of_all_pairs(monkeypatch, cells, root):
    """Also where vessels are thicker than so many cells of the grid, so that they are listed instead."""
    growth = growth_of(16, law=THICK, root=root, apart=1e-9)
    grown(growth)
    state, store = growth._state, growth._state.store
    monkeypatch.setattr("generator.growth.state._THICK", cells)
    state.measure_radii()
    assert store.counts[5] == (store.segment["radius"][1 : state.n_nodes] > store.thin[0]).sum()
    n_met = []
    for margin in (0.05, 1.0, 3.0):
        pairs = overlapping(store, state.n_nodes, margin)
        lost = np.zeros(state.n_nodes, dtype=bool)
        n_met.append(overlaps.mark_overlapping(store, state.grid.grid, lost, margin))
        assert (n_met[-1] > 0) == (len(pairs) > 0)
        assert set(np.flatnonzero(lost)) == {smaller(store, s, o) for s, o in pairs}
    assert n_met[0] < n_met[1] < n_met[2]


@pytest.mark.parametrize("cells", [0.5, 0.1, 0.0])
def test_a_vessel_is_clear_if_it_is_clear_of_each(monkeypatch, cells):
    growth = growth_of(16, law=THICK, apart=1e-9)
    grown(growth)
    state, store = growth._state, growth._state.store
    monkeypatch.setattr("generator.growth.state._THICK", cells)
    state.measure_radii()
    none, n_clear = np.int64(-2), 0
    for a, b in BOX.sample(60, np.random.default_rng(2)).reshape(-1, 2, 3):
        near = [np.sqrt(overlaps.square_between(*a, *b, store.segment[o])) for o in range(1, state.n_nodes)]
        expected = all(near >= 0.5 * (1.0 + store.segment["radius"][1 : state.n_nodes]))
        found = overlaps.clear(store, state.grid.grid, *a, *b, 1.0, none, none, none, 0.5)
        assert found == expected
        n_clear += expected
    assert 0 < n_clear < 30


def test_a_grid_with_no_room_for_a_star_is_laid_with_more():
    """A hundred long vessels cross more cells than the grid had room for at first."""
    growth = growth_of(100)
    grown(growth)
    far = BOX.sample(99, np.random.default_rng(0)) * (0.1, 0.2, 1.0) + (80, 55, 0)
    growth.put(np.array([-1, 0, *[1] * 99], np.int32), np.vstack([CORNER, [1, 1, 1], far]))
    store, grid = growth._state.store, growth._state.grid.grid
    near, distance = np.zeros(5, np.int32), np.zeros(5)
    for mark, x in enumerate(BOX.sample(10, np.random.default_rng(3)), start=10**6):
        expected = sorted(index.square_distance(store.segment[o], *x) for o in range(1, growth._state.n_nodes))[:5]
        assert index.nearest(grid, store.segment, *x, mark, near, distance) == 5
        assert distance == pytest.approx(expected, rel=1e-9)
