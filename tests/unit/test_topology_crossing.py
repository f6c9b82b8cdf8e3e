"""Crossing of trees: subtrees of one put together in another of the same terminals; rounds of search."""

import numpy as np
import pytest

from generator._domain_kernels import segment_inside
from generator.config import load
from generator.domain import Box
from generator.domain_shapes import ShapeDomain
from generator.framework import Run
from generator.growth.growth import Growth
from generator.growth.root_tree import RootTree
from generator.haemodynamics import Perfusion
from generator.topology import _crossing_kernels as kernels
from generator.topology._state_kernels import begin, save, sweep, undo
from generator.topology.annealing import Annealing, AnnealingOptions
from generator.topology.crossing import cross
from vascval.core.errors import InputError

LAW = Perfusion(13300.0, 8000.0, 8333.0, 0.0036, 2.55)
BOX = Box((90.0, 70.0, 16.0))


def fork():
    """A root tree of one segment that divides in two."""
    position = np.array([[0.0, 0, 8], [20, 20, 8], [30, 40, 8], [45, 15, 8]])
    return RootTree(np.array([-1, 0, 1, 1], np.int32), position, np.array([0, 1.6, 1.25, 1.25]))


def searched(count, tests=1500, n=60, domain=BOX, root=(0.0, 0.0, 0.0), heat=0.5):
    """Chains from one tree, at their ends."""
    start = root if isinstance(root, RootTree) else np.array(root)
    growth = Growth(domain, LAW, start, n, rng=np.random.default_rng(1))
    for _ in growth.steps():
        pass
    chains = [
        Annealing(
            *growth.snapshot(), growth.root_tree, LAW, space=domain.space, rng=np.random.default_rng(seed),
            options=AnnealingOptions(tests=tests, heat=heat, chains=1),
        )
        for seed in range(count)
    ]  # fmt: skip
    for chain in chains:
        for _ in chain.steps():
            pass
    return chains


def subtrees(node, n_fixed):
    """The terminals below each inner free node, and the node."""
    children = {i: [c for c in (node["first"][i], node["second"][i]) if c >= 0] for i in range(n_fixed, node.size)}

    def below(i):
        return frozenset([i]).union(*map(below, children[i])) if not children[i] else frozenset().union(
            *map(below, children[i])
        )  # fmt: skip

    return {below(i): i for i in range(n_fixed, node.size) if children[i]}


@pytest.mark.parametrize("root", [(0.0, 0.0, 0.0), fork()], ids=["point", "root tree"])
def test_a_subtree_is_put_together_as_the_donor_has_it_and_the_rest_stays(root):
    one, other = searched(2, root=root)
    state, donor, fixed = one.tree.state, other.best, one.tree.state.n_fixed
    mine, theirs = subtrees(state.node, fixed), subtrees(donor, fixed)
    before = {name: state.node[name].copy() for name in ("parent", "x", "y", "z")}
    links = np.sort(np.column_stack([state.node["first"], state.node["second"]]), axis=1)
    below, place = np.zeros(state.node.size, np.int32), np.zeros(state.node.size, np.int32)
    made = 0
    for clade, top in theirs.items():
        if donor["parent"][top] < fixed:
            continue
        begin(state)
        grafts = kernels.assemble(state, donor, top, below, place)
        if grafts > 0:
            made += 1
            sweep(state, one.tree.flat.order)
            now = subtrees(state.node, fixed)
            assert {part for part in theirs if part <= clade} == {part for part in now if part <= clade}
            # of any other subtree there is what the clade left of it
            kept = {part - clade for part in mine if len(part - clade) > 1 and part & clade}
            assert kept <= {part - clade for part in now}
            at = place[top]
            assert state.node["n"][at] == len(clade)
            assert state.node["x"][at] == donor["x"][top]
        undo(state)
        sweep(state, one.tree.flat.order)
        for name, values in before.items():
            np.testing.assert_array_equal(state.node[name], values)
        np.testing.assert_array_equal(
            np.sort(np.column_stack([state.node["first"], state.node["second"]]), axis=1), links
        )
    assert made > 10


def test_the_segments_nearest_to_a_point():
    (chain,) = searched(1)
    state = chain.tree.state
    node, fixed = state.node, state.n_fixed
    rng = np.random.default_rng(3)
    nearest, apart = np.zeros(3, np.int64), np.zeros(3)
    clades = [i for i in range(fixed, node.size) if node["parent"][i] >= fixed]
    for clade in rng.choice(clades, 20):
        point = np.zeros(1, node.dtype)
        point["x"], point["y"], point["z"] = rng.random(3) * (90.0, 70.0, 16.0)
        kernels.find_nearest(state, point[0], clade, nearest, apart)
        feeding, away = node["parent"][clade], {}
        for i in range(fixed, node.size):
            above, ancestors = i, set()
            while above >= fixed:
                ancestors.add(above)
                above = node["parent"][above]
            if clade in ancestors or i == feeding or node["parent"][i] == feeding:
                continue
            a, b = ([node[axis][k] for axis in "xyz"] for k in (i, node["parent"][i]))
            along = np.linspace(0.0, 1.0, 2001)[:, None]
            on = np.array(a) + along * (np.array(b) - a)
            away[i] = ((on - [point[axis][0] for axis in "xyz"]) ** 2).sum(axis=1).min()
        best = sorted(away.values())[:3]
        # points 1/2000 of a segment apart, of segments of at most 90 mm
        np.testing.assert_allclose(np.sqrt(apart), np.sqrt(best), atol=0.03)
        np.testing.assert_allclose([np.sqrt(away[i]) for i in nearest], np.sqrt(best), atol=0.03)


def test_what_another_tree_does_better_is_taken_over():
    good, bad = searched(2, tests=20_000)
    if good.best_mm3 > bad.best_mm3:
        good, bad = bad, good
    volumes = [bad.tree.volume_mm3(cost) for cost in
               cross(bad.tree, bad.space, [good.best], 10_000, np.random.default_rng(5))]  # fmt: skip
    assert good.best_mm3 < bad.best_mm3
    assert (np.diff(volumes) <= 1e-9).all()
    # most of what the other does better, or more
    assert volumes[-1] < bad.best_mm3 - 0.5 * (bad.best_mm3 - good.best_mm3)
    assert volumes[-1] == pytest.approx(bad.tree.volume_mm3(sweep(bad.tree.state, bad.tree.flat.order)), rel=1e-12)


def test_crossing_stays_inside_and_keeps_terminals_long():
    horseshoe = ShapeDomain("horseshoe")
    chains = searched(4, domain=horseshoe, root=tuple(horseshoe.root_mm), tests=3000)
    chains.sort(key=lambda chain: -chain.best_mm3)
    tree, before = chains[0].tree, chains[0].best_mm3
    short = tree.state.node["length"][tree.state.node["first"] < 0][tree.state.n_fixed :].min()
    *_, cost = cross(tree, horseshoe.space, [chain.best for chain in chains[1:]], 10_000, np.random.default_rng(2))
    node = tree.state.node
    assert tree.volume_mm3(cost) < before
    for i in range(tree.state.n_fixed, node.size):
        p, r = node[node["parent"][i]], node[i]
        assert segment_inside(horseshoe.space, p["x"], p["y"], p["z"], r["x"], r["y"], r["z"])
    assert node["length"][node["first"] < 0][tree.state.n_fixed :].min() >= min(short, tree.state.shortest) - 1e-9


CHANGES = ["n_terminals=60", "method=full", "topology.tests=3000", "topology.at=60", "geometry.contract=false"]


def volume_after(*changes):
    run = Run.of(load("karch-box", [*CHANGES, *changes]))
    list(run.steps())
    return run


def stopped(changes, tests):
    """A run that has done so many tests, and its steps, which go on as long as somebody holds them."""
    run = Run.of(load("karch-box", changes))
    steps = run.steps()
    next(step for name, step in steps if name == "topology" and step.n_terminals >= tests)
    return run, steps


def test_further_rounds_find_better_trees():
    single, double = volume_after(), volume_after("topology.rounds=3")
    assert double.stages[1].tests == 3 * single.stages[1].tests == 18_000
    assert double.stages[1].volume_mm3 < single.stages[1].volume_mm3
    history = double.topology.history
    assert history[-1].n_tests == history[-1].n_target == 9000
    assert (np.diff([step.n_tests for step in history]) > 0).all()
    assert (np.diff([step.best_mm3 for step in history]) <= 0).all()


def test_half_of_the_trees_go_on_after_each_round_down_to_one():
    run, _running = stopped([*CHANGES, "topology.chains=5", "topology.rounds=4"], 5 * 3 * 3000 + 100)
    now = run.topology._now
    assert now.number == 3 and len(now.found) == (5 + 2) + (5 + 1) + (5 + 1)
    volumes = [one.best_mm3 for one in now.found]
    first, second, third = volumes[:7], volumes[7:13], volumes[13:]
    assert first[5:] == sorted(first[5:])
    # each line that goes on is at least as good as what it was made of; the best of all never gets worse
    assert first[5] <= min(first[:5]) and second[5] <= min(second[:5] + first[5:]) and third[5] <= second[5]
    assert run.topology.best_mm3 <= third[5]


def test_the_tests_of_another_search_do_not_count_as_ones_own():
    """Records say in which test they were written to the journal: what is not written there is not undone."""
    chain, other = searched(2, tests=20)
    tree = chain.tree
    theirs = other.best
    theirs["saved"] = theirs["seen"] = tree.state.counts[1] + 1  # a number that this search comes to as well
    tree.adopt(theirs)
    before = tree.state.node.copy()
    begin(tree.state)
    assert (tree.state.node["saved"] < tree.state.counts[1]).all()
    assert (tree.state.node["seen"] < tree.state.counts[1]).all()
    for i in range(tree.state.n_fixed, before.size):
        save(tree.state, i)
        tree.state.node[i]["x"] = 99.0
    undo(tree.state)
    np.testing.assert_array_equal(tree.state.node["x"], before["x"])


def test_chains_of_further_rounds_begin_with_the_trees_that_go_on():
    run, _running = stopped([*CHANGES, "topology.chains=4", "topology.rounds=2"], 4 * 3000 + 100)
    stage = run.topology
    parent, position = run.growth.snapshot()
    again = stage._begin(parent, position, 1, stage._now.found)
    for k, chain in enumerate(again.chains):
        begun = stage._now.found[-2:][k % 2]
        assert chain.tree.volume_mm3(chain.cost) == pytest.approx(begun.best_mm3, rel=1e-6)
        np.testing.assert_array_equal(chain.tree.state.node["parent"], begun.node["parent"])


@pytest.mark.parametrize(("chains", "rounds", "at"), [(2, 2, 1500), (2, 2, 4500), (2, 2, 5990), (4, 3, 7000)])
def test_a_search_resumed_in_any_round_ends_with_the_same_tree(chains, rounds, at, monkeypatch):
    searched = [f"topology.chains={chains}", f"topology.rounds={rounds}"]
    changes = [*CHANGES, *searched]
    trees = []
    for threads in ("1", "2"):
        monkeypatch.setenv("VASCVAL_THREADS", threads)
        run, _running = stopped(changes, chains * at)
        resumed = Run.of(load("karch-box", changes))
        resumed.restore(run.state())
        list(resumed.steps())
        trees.append(resumed.tree())
    whole = volume_after(*searched).tree()
    for tree in trees:
        np.testing.assert_array_equal(tree.parent, whole.parent)
        np.testing.assert_array_equal(tree.position_mm, whole.position_mm)


@pytest.mark.parametrize("wrong", ["count", "size", "number", "links"])
def test_trees_of_earlier_rounds_that_are_not_sound_are_refused(wrong):
    changes = [*CHANGES, "topology.rounds=2"]
    run, _running = stopped(changes, 9000)
    state = run.state()
    kept = state.arrays
    if wrong == "count":
        kept["topology.found_mm3"] = kept["topology.found_mm3"][:1]
        kept["topology.found"] = kept["topology.found"][:1]
    elif wrong == "size":
        kept["topology.found"] = kept["topology.found"][:, 1:]
    elif wrong == "number":
        kept["topology.found_mm3"][0] = np.nan
    else:
        kept["topology.found"][0, 5] = 255
    again = Run.of(load("karch-box", changes))
    with pytest.raises(InputError, match="begin the run anew"):
        again.restore(state)
        list(again.steps())


def test_two_terminals_have_nothing_to_cross():
    run = volume_after("n_terminals=2", "topology.at=2", "topology.rounds=2")
    assert run.tree().topology.n_terminals == 2
