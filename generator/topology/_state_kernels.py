"""A tree that changes: records in one array, their sweep along a path to the root, and the journal that undoes it.

Nodes and the segments that end there share an index. The first ``n_fixed`` nodes are the root and the root tree; from
each of ``ends`` among them one stem springs. All other nodes are terminals or have two children; a junction of more is
written with segments of length 0, which change nothing in the recursion of :mod:`generator.haemodynamics`.

The cost is the logarithm of the volume of all stems, ::

    C = log sum_j exp(F_j) / sqrt(dp_j)        F_j = log(rho_j) / 2 + log(v_j)

up to a constant, with ``dp_j`` the pressure left at the stem.
"""

from typing import NamedTuple

import numpy as np

from vascval.core.borrowing import borrowing

NODE = np.dtype(
    [
        ("parent", "i4"),
        ("first", "i4"), ("second", "i4"),  # children, -1: none; the stem at an end of the root tree is its first
        ("saved", "i4"),  # the test in which it was written to the journal
        ("seen", "i4"),  # the test on whose path it lies
        ("n", "i4"),  # terminals below
        ("x", "f8"), ("y", "f8"), ("z", "f8"),
        ("length", "f8"),
        ("rho", "f8"), ("v", "f8"),
        ("q", "f8"),  # rho^(gamma/4)
        ("t", "f8"),  # v sqrt(rho)
        ("s_sum", "f8"),  # S: sum of q over the children
        ("a", "f8"),  # S^(2/gamma), so that rho = n l + a^2
        ("base_v", "f8"),  # sum of t over the children by a, so that v = l + base_v
        ("d_rho", "f8"), ("d_v", "f8"),  # dC/drho, dC/dv as of the last sweep that came by
        ("d_n", "f8"),  # dC by one terminal more below: sum of l dC/drho from here up
    ],
    align=True,
)  # fmt: skip
TINY = 1e-9  # a terminal's length is taken as no less, mm


class State(NamedTuple):
    """``counts``: entries of the journal, number of the test, lengths of ``path_a`` and ``path_b``.

    ``shared[j, k]`` is the pressure that a terminal below stem ``k`` costs stem ``j`` in the root tree; ``stem_at`` (of
    the fixed nodes) which stem springs there; ``share`` the stems' parts of the volume when it was last summed.
    Bifurcations keep ``shortest`` mm away from terminals: without it a trunk may lead through a terminal, whose vessel
    then has neither length nor radius and takes part in nothing.
    """

    n_fixed: int
    gamma: float
    shortest: float
    node: np.ndarray
    ends: np.ndarray
    stem_at: np.ndarray
    drop_pa: float
    shared: np.ndarray
    share: np.ndarray
    counts: np.ndarray
    journal: np.ndarray
    journal_at: np.ndarray
    path_a: np.ndarray
    path_b: np.ndarray


@borrowing
def save(state, i):
    """Note what node ``i`` is before it is changed, once per test."""
    if state.node[i].saved != state.counts[1]:
        state.node[i].saved = state.counts[1]
        k = state.counts[0]
        state.journal[k] = state.node[i]
        state.journal_at[k] = i
        state.counts[0] = k + 1


@borrowing
def begin(state):
    state.counts[0] = 0
    state.counts[1] += 1


@borrowing
def undo(state):
    for k in range(state.counts[0]):
        state.node[state.journal_at[k]] = state.journal[k]


@borrowing
def distance(a, b):
    return np.sqrt((a.x - b.x) ** 2 + (a.y - b.y) ** 2 + (a.z - b.z) ** 2)


@borrowing
def branch_power(gamma, rho):
    """``rho^(gamma/4)``, without a general power for the usual exponents."""
    if gamma == 3.0:
        root = np.sqrt(rho)
        return root * np.sqrt(root)
    return rho ** (0.25 * gamma)


@borrowing
def joined(gamma, s_sum):
    """``S^(2/gamma)``, likewise."""
    if gamma == 3.0:
        root = np.cbrt(s_sum)
        return root * root
    return s_sum ** (2.0 / gamma)


@borrowing
def relength(state, i):
    """``rho`` and ``v`` of segment ``i`` from its ends and from what hangs below."""
    r = state.node[i]
    r.length = distance(r, state.node[r.parent])
    if r.first < 0:
        r.length = max(r.length, TINY)
    r.rho = r.n * r.length + r.a * r.a
    r.v = r.length + r.base_v
    r.q = branch_power(state.gamma, r.rho)
    r.t = r.v * np.sqrt(r.rho)


@borrowing
def refresh(state, i):
    """``rho`` and ``v`` of an inner segment ``i`` of known length from its children's."""
    r = state.node[i]
    c, d = state.node[r.first], state.node[r.second]
    r.n = c.n + d.n
    r.s_sum = c.q + d.q
    r.a = joined(state.gamma, r.s_sum)
    r.base_v = (c.t + d.t) / r.a
    r.rho = r.n * r.length + r.a * r.a
    r.v = r.length + r.base_v
    r.q = branch_power(state.gamma, r.rho)
    r.t = r.v * np.sqrt(r.rho)


@borrowing
def total(state):
    """C; ``inf`` where the root tree uses up the pressure."""
    result = 0.0
    for j in range(state.ends.size):
        drop = state.drop_pa
        for k in range(state.ends.size):
            if state.shared[j, k] > 0.0:
                drop -= state.shared[j, k] * state.node[state.node[state.ends[k]].first].n
        if drop <= 0.0:
            return np.inf
        stem = state.node[state.node[state.ends[j]].first]
        state.share[j] = np.sqrt(stem.rho / drop) * stem.v
        result += state.share[j]
    for j in range(state.ends.size):
        state.share[j] /= result
    return np.log(result)


@borrowing
def keep_off(state, i):
    """Move bifurcation ``i`` away from a terminal that is too close, towards where it is fed from."""
    r = state.node[i]
    p = state.node[r.parent]
    for child in (r.first, r.second):
        c = state.node[child]
        if c.first < 0 and distance(r, c) < state.shortest:
            away = distance(p, c)
            part = min(1.0, 1.001 * state.shortest / away) if away > 0.0 else 0.0
            r.x, r.y, r.z = c.x + part * (p.x - c.x), c.y + part * (p.y - c.y), c.z + part * (p.z - c.z)


@borrowing
def long_enough(state):
    """Whether the terminals that were changed in this test are as long as they should be."""
    for k in range(state.counts[0]):
        i = state.journal_at[k]
        r = state.node[i]
        if i >= state.n_fixed and r.first < 0 and r.length < state.shortest and r.length < state.journal[k].length:
            return False
    return True


@borrowing
def find_paths(state, low_a, low_b):
    """The nodes from ``low_b`` up to the root tree, and those from ``low_a`` until they meet that path."""
    count, i = 0, low_b
    while i >= state.n_fixed:
        state.node[i].seen = state.counts[1]
        state.path_b[count] = i
        count += 1
        i = state.node[i].parent
    state.counts[3] = count
    count, i = 0, low_a
    while i >= state.n_fixed and state.node[i].seen != state.counts[1]:
        state.path_a[count] = i
        count += 1
        i = state.node[i].parent
    state.counts[2] = count


@borrowing
def climb(state):
    """All segments of both paths from their children's; C."""
    for k in range(state.counts[2]):
        save(state, state.path_a[k])
        refresh(state, state.path_a[k])
    for k in range(state.counts[3]):
        save(state, state.path_b[k])
        refresh(state, state.path_b[k])
    return total(state)


@borrowing
def slope_at(state, i):
    """``dC/drho`` and ``dC/dv`` of segment ``i`` from those of the segment that feeds it.

    ``d rho'/d rho = a^2 q / (S rho)``, ``d v'/d v = sqrt(rho) / a``, ``d v'/d rho = v / (2 sqrt(rho) a) - base_v q /
    (2 S rho)``, the primed being the feeding segment, to which ``a``, ``S`` and ``base_v`` belong.
    """
    r = state.node[i]
    if r.parent < state.n_fixed:
        share = state.share[state.stem_at[r.parent]]
        return 0.5 * share / r.rho, share / r.v
    p = state.node[r.parent]
    return child_slope(p.d_rho, p.d_v, p.s_sum, p.a, p.base_v, r.rho, r.v, r.q)


@borrowing
def child_slope(d_rho, d_v, s_sum, a, base_v, rho, v, q):
    root = np.sqrt(rho)
    part = q / (s_sum * rho)
    return d_rho * a * a * part + 0.5 * d_v * (v / (root * a) - base_v * part), d_v * root / a


@borrowing
def set_slopes(state, i):
    """``d_rho``, ``d_v`` and ``d_n`` of segment ``i`` from those of the segment that feeds it."""
    r = state.node[i]
    r.d_rho, r.d_v = slope_at(state, i)
    r.d_n = r.length * r.d_rho
    if r.parent >= state.n_fixed:
        r.d_n += state.node[r.parent].d_n


@borrowing
def descend(state):
    """``dC/drho`` and ``dC/dv`` along both paths."""
    for k in range(state.counts[3] - 1, -1, -1):
        set_slopes(state, state.path_b[k])
    for k in range(state.counts[2] - 1, -1, -1):
        set_slopes(state, state.path_a[k])


@borrowing
def root_first(state, order):
    """The free nodes, each after its parent; how many."""
    count = 0
    for j in range(state.ends.size):
        order[count] = state.node[state.ends[j]].first
        count += 1
    k = 0
    while k < count:
        r = state.node[order[k]]
        if r.first >= 0:
            order[count] = r.first
            order[count + 1] = r.second
            count += 2
        k += 1
    return count


@borrowing
def sweep(state, order):
    """Everything anew from topology and positions; C."""
    count = root_first(state, order)
    for k in range(count - 1, -1, -1):
        i = order[k]
        r = state.node[i]
        if r.first < 0:
            r.n = 1
            r.a = r.base_v = r.s_sum = 0.0
            relength(state, i)
        else:
            r.length = distance(r, state.node[r.parent])
            refresh(state, i)
    result = total(state)
    for k in range(count):
        set_slopes(state, order[k])
    return result
