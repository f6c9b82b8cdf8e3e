"""Where a cast enters its perfusion volume, on trees and half-spaces small enough to work out by hand."""

import numpy as np
import pytest

from vascval.comparison.perfusion import enter, shares_inside, subtree
from vascval.core.errors import InputError
from vascval.core.tree import Topology, Tree


def beyond(x_mm: float):
    """The half-space x >= x_mm."""
    return lambda points: points[:, 0] >= x_mm


def fork() -> Tree:
    """A stem of 10 along x, which forks into 20 along x and 10 along -y; the former forks into two of 10."""
    parent = [-1, 0, 1, 1, 2, 2]
    position = [(0, 0, 0), (10, 0, 0), (30, 0, 0), (10, -10, 0), (40, 0, 0), (30, 10, 0)]
    return Tree(Topology(np.array(parent)), np.array(position, float), np.array([0, 3.0, 2.5, 1.0, 2.0, 2.0]))


def curved() -> Tree:
    """The same with centrelines of many points."""
    tree = fork()
    lines = [np.linspace(*tree.position_mm[[tree.parent[i], i]], 11) for i in range(1, tree.n_nodes)]
    offset = np.concatenate(([0, 0], np.cumsum([len(line) for line in lines])))
    return Tree(tree.topology, tree.position_mm, tree.radius_mm, {}, np.concatenate(lines), offset)


@pytest.mark.parametrize("tree", [fork(), curved()], ids=["straight", "curved"])
def test_cut_where_the_stem_passes_the_wall(tree):
    entry = enter(tree, beyond(15.0))
    assert entry.cut and entry.at_wall
    step = 41.3 / 1000  # a thousandth of the diagonal: what the wall is found to
    assert entry.tree.position_mm[0] == pytest.approx([15.0, 0.0, 0.0], abs=step)
    assert entry.tree.position_mm[0, 0] >= 15.0
    assert entry.tree.parent.tolist() == [-1, 0, 1, 1]
    assert entry.tree.radius_mm.tolist() == [2.5, 2.5, 2.0, 2.0]
    assert entry.tree.length_mm.sum() == pytest.approx(35.0, abs=step)
    assert (entry.tree.polyline_mm is None) == (tree.polyline_mm is None)


def test_a_root_inside_keeps_the_cast_whole():
    tree = fork()
    entry = enter(tree, beyond(-1.0))
    assert entry.tree is tree and not entry.cut


def test_branches_before_the_entry_are_left_out_and_those_after_it_stay():
    entry = enter(fork(), beyond(5.0))
    assert entry.tree.topology.n_terminals == 3  # the fork is inside
    assert enter(fork(), beyond(12.0)).tree.topology.n_terminals == 2


def test_a_stem_that_forks_in_front_is_kept_whole():
    """Both branches of the second fork enter, the fork itself does not."""
    inside = lambda points: (points[:, 0] >= 33.0) | (points[:, 1] >= 3.0)  # noqa: E731
    entry = enter(fork(), inside)
    assert entry.cut and not entry.at_wall
    assert entry.tree.position_mm[0].tolist() == [10, 0, 0]
    assert entry.tree.position_mm[1].tolist() == [30, 0, 0]
    assert entry.tree.topology.n_terminals == 2
    shares = shares_inside(entry.tree, inside)
    assert shares.length == pytest.approx(14.0 / 40.0, abs=2e-3)
    assert shares.volume == pytest.approx(14.0 * 4 / (20 * 2.5**2 + 20 * 4), abs=2e-3)
    assert shares.terminals == 1.0


def test_a_wall_that_flickers_does_not_cut_too_late():
    """A gap of 1 mm in the volume, on the way in, is crossed."""
    inside = lambda points: (points[:, 0] >= 15.0) & ((points[:, 0] < 18.0) | (points[:, 0] > 19.0))  # noqa: E731
    assert enter(fork(), inside).tree.position_mm[0, 0] == pytest.approx(15.0, abs=0.05)


def test_shares_of_a_half():
    shares = shares_inside(fork(), beyond(25.0))
    assert shares.length == pytest.approx(25.0 / 60.0, abs=2e-3)
    assert shares.terminals == pytest.approx(2 / 3)


def test_nothing_inside():
    with pytest.raises(InputError, match="no vessel lies in the domain; check that both are in one world frame"):
        enter(fork(), beyond(100.0))


def test_an_end_alone_inside_keeps_the_fork_before_it():
    entry = enter(fork(), beyond(35.0))
    assert entry.tree.topology.n_terminals == 2 and not entry.at_wall
    assert shares_inside(entry.tree, beyond(35.0)).length == pytest.approx(5.0 / 40.0, abs=2e-3)


def test_no_branches():
    line = Tree(Topology(np.array([-1, 0])), np.array([[0.0, 0, 0], [9, 0, 0]]), np.array([0, 1.0]))
    with pytest.raises(InputError, match="the cast has no branches"):
        enter(line, beyond(5.0))


def test_subtree_of_the_stem_is_the_tree():
    tree = curved()
    again = subtree(tree, 1)
    assert again.parent.tolist() == tree.parent.tolist()
    assert np.array_equal(again.polyline_mm, tree.polyline_mm)
    assert again.volume_mm3 == pytest.approx(tree.volume_mm3)
