"""Branch and bound against all topologies one by one, and annealing against branch and bound."""

import numpy as np
import pytest

from generator.domain import Box
from generator.growth.growth import Growth
from generator.growth.root_tree import RootTree
from generator.haemodynamics import Perfusion, perfused_tree
from generator.topology import _exhaustive_kernels as kernels
from generator.topology._relax_kernels import polish
from generator.topology.annealing import Annealing, AnnealingOptions, anneal
from generator.topology.exhaustive import optimal_tree
from generator.topology.state import SearchTree
from vascval.core.errors import InputError
from vascval.core.tree import Topology

LAW = Perfusion(13300.0, 8000.0, 8333.0, 0.0036, 2.55)
BOX = Box((90.0, 70.0, 16.0))
ROOT = np.zeros(3)


def all_topologies(n):
    """Parent arrays of all bifurcating trees, numbered 0 root, 1..n terminals, then bifurcations."""
    trees = [{1: 0}]
    for grown in range(1, n):
        b = n + grown
        trees = [{**tree, edge: b, b: tree[edge], grown + 1: b} for tree in trees for edge in tree]
    return trees


def root_first(tree, n):
    order, k = [0], 0
    while k < len(order):
        order += sorted(i for i, p in tree.items() if p == order[k])
        k += 1
    rank = {node: i for i, node in enumerate(order)}
    return np.array([-1] + [rank[tree[node]] for node in order[1:]], np.int32), order


def best_by_trying_all(points):
    """Volume of the best tree, each topology's geometry optimised from where bifurcations lie among their terminals."""
    n, best = len(points) - 1, np.inf
    for tree in all_topologies(n):
        parent, order = root_first(tree, n)
        position = np.zeros((len(order), 3))
        for i in range(len(order) - 1, 0, -1):
            members = position[np.flatnonzero(parent == i)]
            position[i] = points[order[i]] if order[i] <= n else members.mean(axis=0) * 0.8 + points[0] * 0.2
        position[0] = points[0]
        search = SearchTree(parent, position, RootTree.point(points[0]), LAW)
        cost = polish(search.state, search.flat, 30.0, 1e-5, 1e-6)
        best = min(best, search.volume_mm3(cost))
    return best


@pytest.mark.parametrize(("n", "count"), [(2, 1), (3, 3), (4, 15), (5, 105)])
def test_number_of_topologies(n, count):
    clades = {frozenset(frozenset(below(tree, i, n)) for i in tree) for tree in all_topologies(n)}
    assert len(clades) == count
    points = np.vstack((ROOT, BOX.sample(n, np.random.default_rng(n))))
    assert optimal_tree(points[0], points[1:], LAW).n_topologies == count


@pytest.mark.parametrize("n", [2, 3, 6, 7])
def test_every_topology_is_decided_once(n):
    """Optimised, or cut off with the branch that it is on; what is shown of it only rises."""
    points = np.vstack((ROOT, BOX.sample(n, np.random.default_rng(n))))
    told = []
    found = optimal_tree(points[0], points[1:], LAW, lambda *what: told.append(what))
    done = [count for _, count, _ in told]
    assert done == sorted(done)
    assert told[-1] == ("topologies", found.n_topologies, found.n_topologies)
    assert len(told) >= found.n_optimised


def below(tree, top, n):
    """The terminals below a node."""
    return {top} if top <= n else set().union(*(below(tree, i, n) for i, p in tree.items() if p == top))


@pytest.mark.parametrize(("n", "seed"), [(3, 1), (4, 2), (4, 3), (5, 4), (5, 5), (5, 6)])
def test_branch_and_bound_finds_the_best_of_all(n, seed):
    points = np.vstack((ROOT, BOX.sample(n, np.random.default_rng(seed))))
    found = optimal_tree(points[0], points[1:], LAW)
    # both end in a local optimum of the same geometry, to about 1e-8
    assert found.tree.volume_mm3 == pytest.approx(best_by_trying_all(points), rel=1e-7)
    assert found.n_optimised < found.n_topologies


@pytest.mark.parametrize("seed", range(10))
def test_bound_holds_for_any_tree(seed):
    """At any positions of the bifurcations, of all terminals and of the first ones alone."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 9))
    points = np.vstack((ROOT, BOX.sample(n, rng)))
    tree, bounds = {1: 0}, []
    up = np.full(2 * n, -1, np.int64)
    up[1] = 0
    for grown in range(1, n):
        edge = int(rng.choice(list(tree)))
        tree = {**tree, edge: n + grown, n + grown: tree[edge], grown + 1: n + grown}
        edges, found = kernels.bounds_of_insertions(up, points, grown, 90.0, np.inf)
        bounds.append(found[list(edges).index(edge)])
        kernels.insert(up, n, grown, edge)
    parent, order = root_first(tree, n)
    assert (np.diff(bounds) > -1e-3 * bounds[-1]).all()  # bounds themselves are right to about 1e-3 of the least value
    scale = np.pi * np.sqrt(LAW.kappa_pa_s * LAW.flow_mm3_s / n / LAW.pressure_drop_pa)
    for _ in range(20):
        position = np.array([points[i] if i <= n else BOX.sample(1, rng)[0] for i in order])
        volume = perfused_tree(Topology(parent), position, LAW).volume_mm3
        assert all(scale * bound**1.5 <= volume for bound in bounds)
    search = SearchTree(parent, position, RootTree.point(points[0]), LAW)
    cost = polish(search.state, search.flat, 30.0, 1e-5, 1e-6)
    # not above the least volume, and not uselessly far below: 3 % at most were seen
    assert 0.9 * search.volume_mm3(cost) < scale * bounds[-1] ** 1.5 <= search.volume_mm3(cost)


def annealed(points, rng):
    growth = Growth(BOX, LAW, points[0], len(points) - 1, rng=rng, terminals_mm=points[1:])
    for _ in growth.steps():
        pass
    options = AnnealingOptions(tests=5000, heat=2.0, cooling=1000.0)
    chains = [Annealing(*growth.snapshot(), growth.root_tree, LAW, options=options, rng=r) for r in rng.spawn(4)]
    for _ in anneal(chains):
        pass
    return min(chain.best_mm3 for chain in chains)


@pytest.mark.parametrize(
    ("n", "instances"),
    [(5, 10), (6, 5), (7, 2), *[pytest.param(n, k, marks=pytest.mark.slow) for n, k in ((5, 100), (6, 100), (7, 40))]],
)
def test_annealing_finds_the_optimum(n, instances):
    for seed in range(instances):
        rng = np.random.default_rng(1000 * n + seed)
        points = np.vstack((ROOT, BOX.sample(n, rng)))
        optimum = optimal_tree(points[0], points[1:], LAW).tree.volume_mm3
        # the geometry of both is right to about 1e-8
        assert annealed(points, rng) == pytest.approx(optimum, rel=1e-6), f"instance {seed}"


@pytest.mark.parametrize(
    ("terminals", "message"),
    [
        (np.zeros((1, 3)) + 1.0, "1 terminals: all topologies can be searched for 2 to 10"),
        (np.arange(33.0).reshape(11, 3) + 1.0, "11 terminals: all topologies can be searched for 2 to 10"),
        (np.ones((2, 3)), "root and terminals must be finite and all different"),
        (np.full((2, 3), np.nan), "root and terminals must be finite and all different"),
        (np.ones((2, 2)), r"shapes \(3,\) and \(2, 2\); \(3,\) and \(N, 3\) are needed"),
    ],
)
def test_terminals_that_make_no_sense(terminals, message):
    with pytest.raises(InputError, match=message):
        optimal_tree(ROOT, terminals, LAW)
