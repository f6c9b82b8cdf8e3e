"""Tests of topologies one after the other, and the grid that proposes them.

A test is scored in stages, each for those that the one before leaves a chance: by an estimate to first order; exactly,
along the two paths to the root that it changes, with the moved bifurcation put right; with the bifurcations around it
put right too; and where a big subtree was moved, with a few steps for all bifurcations around both paths.
"""

from typing import NamedTuple

import numpy as np

from generator._domain_kernels import segment_inside
from generator.topology._estimate_kernels import estimate_graft, estimate_swap
from generator.topology._move_kernels import first_place, graft, may_graft, may_swap, settle, swap
from generator.topology._relax_kernels import relax, relax_near
from generator.topology._state_kernels import begin, climb, descend, find_paths, long_enough, slope_at, sweep, undo
from vascval.core.borrowing import borrowing

NO_MOVE, REJECTED, ACCEPTED = 0, 1, 2
GRAFT, SWAP = 0, 1
BIG = 6  # subtrees of so many terminals need room below and above to come to rest
REACH = 2  # levels below the paths that get it
ROUNDS = 4
DOUBT, DOUBT_BY_SIZE = 0.25, 0.05  # how much an estimate may be above the cost, in rises
HOPE = 0.15  # how much a stage may gain for each terminal moved, in rises
UPWARDS, LEVELS = 0.2, 8  # share of proposals that begin further up, and by how much at most


class Rules(NamedTuple):
    """``swaps``: share of swaps among the moves proposed; ``rise``: median rise of C by a move at the start; ``eps``:
    smoothing of lengths (mm) in the third stage; ``lenience``: the temperature of a move of n terminals is
    ``n**lenience`` times as high as that of a move of one."""

    swaps: float
    rise: float
    eps: float
    lenience: float


class Nearby(NamedTuple):
    """Grid of sample points of the segments: those of cell ``c`` are ``owner[start[c]:start[c + 1]]``."""

    lower: np.ndarray
    cell: float
    shape: np.ndarray
    start: np.ndarray
    owner: np.ndarray


@borrowing
def cell_of(near, x, y, z):
    i = min(max(int((x - near.lower[0]) / near.cell), 0), near.shape[0] - 1)
    j = min(max(int((y - near.lower[1]) / near.cell), 0), near.shape[1] - 1)
    k = min(max(int((z - near.lower[2]) / near.cell), 0), near.shape[2] - 1)
    return (i * near.shape[1] + j) * near.shape[2] + k


@borrowing
def sample_segments(state, near, write):
    """Count the sample points of each cell, one per cell length, or write them."""
    for i in range(state.n_fixed, state.node.size):
        r = state.node[i]
        p = state.node[r.parent]
        points = 1 + int(r.length / near.cell)
        for k in range(points):
            along = (k + 0.5) / points
            c = cell_of(near, r.x + along * (p.x - r.x), r.y + along * (p.y - r.y), r.z + along * (p.z - r.z))
            if write:
                near.start[c] -= 1
                near.owner[near.start[c]] = i
            else:
                near.start[c] += 1


@borrowing
def lay(state, near):
    """The grid anew; False: ``owner`` is too short."""
    near.start[:] = 0
    sample_segments(state, near, False)
    for c in range(1, near.start.size):
        near.start[c] += near.start[c - 1]
    if near.start[-1] > near.owner.size:
        return False
    sample_segments(state, near, True)
    return True


@borrowing
def pick_nearby(near, rng, x, y, z):
    """A segment with a sample point in the 27 cells around a point, drawn evenly; -1: there is none."""
    ci = min(max(int((x - near.lower[0]) / near.cell), 0), near.shape[0] - 1)
    cj = min(max(int((y - near.lower[1]) / near.cell), 0), near.shape[1] - 1)
    k0 = int((z - near.lower[2]) / near.cell)
    k0, k1 = max(k0 - 1, 0), min(k0 + 1, near.shape[2] - 1)
    if k0 > k1:  # the point lies above or below the grid
        return -1
    count = 0
    for i in range(max(ci - 1, 0), min(ci + 2, near.shape[0])):
        for j in range(max(cj - 1, 0), min(cj + 2, near.shape[1])):
            row = (i * near.shape[1] + j) * near.shape[2]
            count += near.start[row + k1 + 1] - near.start[row + k0]
    if count <= 0:
        return -1
    left = int(rng.random() * count)
    for i in range(max(ci - 1, 0), min(ci + 2, near.shape[0])):
        for j in range(max(cj - 1, 0), min(cj + 2, near.shape[1])):
            row = (i * near.shape[1] + j) * near.shape[2]
            size = near.start[row + k1 + 1] - near.start[row + k0]
            if left < size:
                return near.owner[near.start[row + k0] + left]
            left -= size
    return -1


@borrowing
def propose(state, near, rng):
    """A segment and another near a point of it; -1, -1: none was found.

    Half of all segments are terminals: some proposals begin further up, and look as far as what hangs below is wide.
    """
    s = state.n_fixed + int(rng.random() * (state.node.size - state.n_fixed))
    if rng.random() < UPWARDS:
        for _ in range(1 + int(rng.random() * LEVELS)):
            if state.node[s].parent < state.n_fixed:
                break
            s = state.node[s].parent
    r = state.node[s]
    if r.parent < state.n_fixed:
        return -1, -1
    p = state.node[r.parent]
    along = rng.random()
    reach = near.cell * (r.n ** (1.0 / 3.0) - 1.0)
    x = r.x + along * (p.x - r.x) + reach * (2.0 * rng.random() - 1.0)
    y = r.y + along * (p.y - r.y) + reach * (2.0 * rng.random() - 1.0)
    z = r.z + along * (p.z - r.z) + reach * (2.0 * rng.random() - 1.0)
    t = pick_nearby(near, rng, x, y, z)
    if t < 0 or t == s:
        return -1, -1
    return s, t


@borrowing
def try_graft(state, s, t):
    """Graft ``s`` on ``t``, its bifurcation put right; C."""
    begin(state)
    r, u = state.node[t], state.node[state.node[t].parent]
    e = state.node[s]
    d_rho, d_v = r.d_rho, r.d_v
    low = graft(state, s, t, *first_place(r, u, e))
    settle(state, e.parent, d_rho, d_v, 3)
    find_paths(state, low, e.parent)
    return low, e.parent, climb(state)


@borrowing
def try_swap(state, a, b):
    """Exchange the proximal nodes of ``a`` and ``b``, which are put right; C."""
    begin(state)
    p, q = state.node[a].parent, state.node[b].parent
    swap(state, a, b)
    settle(state, p, state.node[p].d_rho, state.node[p].d_v, 2)
    settle(state, q, state.node[q].d_rho, state.node[q].d_v, 2)
    find_paths(state, p, q)
    return p, q, climb(state)


@borrowing
def settle_around(state, i, rounds):
    """Put right the bifurcations below ``i``, ``i`` itself and the one above."""
    if i < state.n_fixed:
        return
    for child in (state.node[i].first, state.node[i].second):
        if state.node[child].first >= 0:
            d_rho, d_v = slope_at(state, child)
            settle(state, child, d_rho, d_v, rounds)
    settle(state, i, state.node[i].d_rho, state.node[i].d_v, rounds)
    p = state.node[i].parent
    if p >= state.n_fixed:
        settle(state, p, state.node[p].d_rho, state.node[p].d_v, rounds)


@borrowing
def stays_inside(state, space):
    """Whether all segments that were changed lie in the domain."""
    if space.convex:
        return True
    for k in range(state.counts[0]):
        i = state.journal_at[k]
        if i < state.n_fixed:
            continue
        r, old = state.node[i], state.journal[k]
        if r.length == old.length and r.parent == old.parent:
            continue
        p = state.node[r.parent]
        if not segment_inside(space, p.x, p.y, p.z, r.x, r.y, r.z):
            return False
    return True


@borrowing
def draw(state, near, rng, rules):
    """A move to a topology that is near: its kind, the two segments, and the terminals moved, 0 if there is none."""
    kind = SWAP if rng.random() < rules.swaps else GRAFT
    s, t = propose(state, near, rng)
    if s < 0 or not (may_swap(state, s, t) if kind == SWAP else may_graft(state, s, t)):
        return kind, s, t, 0
    n = state.node[s].n
    return kind, s, t, max(n, state.node[t].n) if kind == SWAP else n


@borrowing
def estimate(state, kind, s, t):
    return estimate_swap(state, s, t) if kind == SWAP else estimate_graft(state, s, t)


@borrowing
def make(state, kind, s, t):
    """First stage: the move made and its bifurcations put right; where the paths begin, and C."""
    return try_swap(state, s, t) if kind == SWAP else try_graft(state, s, t)


@borrowing
def put_right(state, low_a, low_b):
    """Second stage: the bifurcations around the moved ones; C."""
    descend(state)
    settle_around(state, low_a, 2)
    settle_around(state, low_b, 2)
    return climb(state)


@borrowing
def test(state, flat, space, near, rng, rules, cost, above):
    """One test; its outcome, the kind of move and, if it was accepted, the new C."""
    kind, s, t, n = draw(state, near, rng, rules)
    if n == 0:
        return NO_MOVE, kind, cost
    bound = cost + above * n**rules.lenience
    if n < BIG and cost + estimate(state, kind, s, t) > bound + rules.rise * (DOUBT + DOUBT_BY_SIZE * n * n):
        return REJECTED, kind, cost
    low_a, low_b, found = make(state, kind, s, t)
    hope = rules.rise * HOPE * n
    if found < bound + hope:
        found = put_right(state, low_a, low_b)
        if n >= BIG and bound < found < bound + hope:
            found = relax_near(state, flat, REACH, rules.eps, ROUNDS)
        if found <= bound and long_enough(state) and stays_inside(state, space):
            descend(state)
            return ACCEPTED, kind, found
    undo(state)
    return REJECTED, kind, cost


@borrowing
def run(state, flat, space, near, rng, rules, n_tests, temperature, cost, tally):
    """``n_tests`` tests at one temperature; C, and in ``tally`` (2, 3) outcomes by kind of move."""
    for _ in range(n_tests):
        above = -temperature * np.log(1.0 - rng.random())
        outcome, kind, found = NO_MOVE, GRAFT, cost
        for _ in range(1000):
            outcome, kind, found = test(state, flat, space, near, rng, rules, cost, above)
            if outcome != NO_MOVE:
                break
        tally[kind, outcome] += 1
        if outcome == ACCEPTED:
            cost = found
    return cost


@borrowing
def sample(state, near, rng, rules, cost, rise):
    """What moves from here would add to C, none of them made; how many of ``rise`` were filled."""
    count = 0
    for _ in range(2000 * rise.size):
        if count == rise.size:
            break
        kind, s, t, n = draw(state, near, rng, rules)
        if n > 0:
            low_a, low_b, _ = make(state, kind, s, t)
            rise[count] = put_right(state, low_a, low_b) - cost
            count += 1
            undo(state)
    return count


@borrowing
def relax_inside(state, flat, space, eps, steps, cost):
    """A few steps for the whole tree, taken back if a segment leaves the domain; C."""
    found = relax(state, flat, eps, steps)
    if stays_inside(state, space):
        return found
    undo(state)
    return sweep(state, flat.order)
