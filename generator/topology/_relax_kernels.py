"""The geometry of the whole tree at once, for a topology under search: a few steps in between, or down to the optimum.

The steps are those of :mod:`generator.geometry.reduced`: at fixed weights ``w = n dC/drho + dC/dv`` the lengths make a
tree Laplacian, whose solution is shortened until the cost falls. Lengths are smoothed, ``sqrt(|d|^2 + eps^2)``.
"""

from typing import NamedTuple

import numpy as np

from generator.geometry._reduced_kernels import dot, imbalance, lengths, pull, solve_laplacian
from generator.topology._state_kernels import begin, child_slope, keep_off, refresh, relength, save, sweep, total, undo
from vascval.core.borrowing import borrowing
from vascval.core.jit import njit

BEND = 0.97
ARMIJO = 1e-4


class Flat(NamedTuple):
    """Work space: the ends of the root tree, then free nodes root first, all or some; arrays (N,), (N, 3) and (N, 6).

    ``nothing`` is zero: there are no bounds.
    """

    order: np.ndarray
    room: np.ndarray
    rank: np.ndarray
    parent: np.ndarray
    n: np.ndarray
    moves: np.ndarray
    position: np.ndarray
    trial: np.ndarray
    gradient: np.ndarray
    direction: np.ndarray
    block: np.ndarray
    diagonal: np.ndarray
    chord: np.ndarray
    length: np.ndarray
    rho: np.ndarray
    v: np.ndarray
    q: np.ndarray
    s_sum: np.ndarray
    a: np.ndarray
    base_v: np.ndarray
    d_rho: np.ndarray
    d_v: np.ndarray
    weight: np.ndarray
    pulls: np.ndarray
    nothing: np.ndarray


@borrowing
def gather(state, order, room, reach):
    """The segments of a subproblem, root first, in ``order``; how many.

    ``room`` (N,) says for each how many more levels below it may move: of the nodes on the paths of this test, and of
    all if ``reach`` is negative, as many as ``reach``; with none left the node stays, a boundary.
    """
    count = 0
    for j in range(state.ends.size):
        order[count] = state.node[state.ends[j]].first
        room[count] = 0
        count += 1
    k = 0
    while k < count:
        r = state.node[order[k]]
        if reach < 0 or r.seen == state.counts[1]:
            room[k] = abs(reach) + 1
        if r.first < 0:
            room[k] = 0
        if room[k] > 0:
            for child in (r.first, r.second):
                order[count] = child
                room[count] = room[k] - 1
                count += 1
        k += 1
    return count


@njit
def view(flat, size):
    """The first ``size`` rows of the work space."""
    return Flat(
        flat.order[:size], flat.room[:size], flat.rank, flat.parent[:size], flat.n[:size], flat.moves[:size],
        flat.position[:size], flat.trial[:size], flat.gradient[:size], flat.direction[:size], flat.block[:size],
        flat.diagonal[:size], flat.chord[:size], flat.length[:size], flat.rho[:size], flat.v[:size], flat.q[:size],
        flat.s_sum[:size], flat.a[:size], flat.base_v[:size], flat.d_rho[:size], flat.d_v[:size], flat.weight[:size],
        flat.pulls[:size], flat.nothing[:size],
    )  # fmt: skip


@njit
def flatten(state, whole, reach):
    """The subproblem as arrays, its order, parents, counts and positions filled in."""
    ends = state.ends.size
    flat = view(whole, ends + gather(state, whole.order, whole.room, reach))
    for j in range(ends):
        r = state.node[state.ends[j]]
        flat.rank[state.ends[j]] = j
        flat.parent[j] = 0 if j > 0 else -1
        flat.n[j] = 0.0
        flat.moves[j] = False
        flat.position[j, 0], flat.position[j, 1], flat.position[j, 2] = r.x, r.y, r.z
    for k in range(flat.parent.size - ends):
        i = flat.order[k]
        r = state.node[i]
        flat.rank[i] = ends + k
        flat.parent[ends + k] = flat.rank[r.parent]
        flat.n[ends + k] = r.n
        flat.moves[ends + k] = flat.room[k] > 0
        flat.position[ends + k, 0], flat.position[ends + k, 1], flat.position[ends + k, 2] = r.x, r.y, r.z
    return flat


@borrowing
def flat_cost(state, flat, position, eps):
    """C with smoothed lengths."""
    ends, size = state.ends.size, flat.parent.size
    lengths(flat.parent, position, eps, flat.chord, flat.length)
    flat.s_sum[:] = 0.0
    flat.base_v[:] = 0.0
    for i in range(size - 1, ends - 1, -1):
        if flat.moves[i]:
            flat.a[i] = flat.s_sum[i] ** (2.0 / state.gamma)
            flat.base_v[i] /= flat.a[i]
        else:
            below = state.node[flat.order[i - ends]]
            flat.a[i], flat.base_v[i] = below.a, below.base_v
        flat.rho[i] = flat.n[i] * flat.length[i] + flat.a[i] * flat.a[i]
        flat.v[i] = flat.length[i] + flat.base_v[i]
        flat.q[i] = flat.rho[i] ** (0.25 * state.gamma)
        p = flat.parent[i]
        if p >= ends:
            flat.s_sum[p] += flat.q[i]
            flat.base_v[p] += flat.v[i] * np.sqrt(flat.rho[i])
    total = 0.0
    for j in range(ends):
        drop = state.drop_pa
        for k in range(ends):
            drop -= state.shared[j, k] * flat.n[ends + k]
        if drop <= 0.0:
            return np.inf
        state.share[j] = np.sqrt(flat.rho[ends + j] / drop) * flat.v[ends + j]
        total += state.share[j]
    for j in range(ends):
        state.share[j] /= total
    return np.log(total)


@borrowing
def flat_weights(state, flat):
    """dC/dl of all segments where the cost was last evaluated."""
    ends = state.ends.size
    for i in range(ends, flat.parent.size):
        p = flat.parent[i]
        if p < ends:
            flat.d_rho[i], flat.d_v[i] = 0.5 * state.share[p] / flat.rho[i], state.share[p] / flat.v[i]
        else:
            flat.d_rho[i], flat.d_v[i] = child_slope(
                flat.d_rho[p], flat.d_v[p], flat.s_sum[p], flat.a[p], flat.base_v[p], flat.rho[i], flat.v[i], flat.q[i]
            )
        flat.weight[i] = flat.n[i] * flat.d_rho[i] + flat.d_v[i]


@borrowing
def steps(state, flat, eps, count, tolerance):
    """At most ``count`` steps at one smoothing, until forces balance to ``tolerance``; how many were taken."""
    cost = flat_cost(state, flat, flat.position, eps)
    for taken in range(count):
        flat_weights(state, flat)
        pull(flat.parent, flat.position, flat.moves, flat.chord, flat.length, flat.weight, flat.nothing, flat.gradient)
        if tolerance > 0.0 and imbalance(flat.parent, flat.moves, flat.weight, flat.gradient, flat.pulls) < tolerance:
            return taken
        solve_laplacian(
            flat.parent, flat.position, flat.moves, flat.chord, flat.length, flat.weight, flat.nothing, BEND,
            flat.gradient, flat.block, flat.diagonal, flat.direction,
        )  # fmt: skip
        slope = -dot(flat.gradient, flat.direction)
        length = 1.0
        while True:
            for i in range(flat.parent.size):
                for k in range(3):
                    flat.trial[i, k] = flat.position[i, k] - length * flat.direction[i, k]
            found = flat_cost(state, flat, flat.trial, eps)
            if found <= cost + ARMIJO * length * slope + 1e-15:
                break
            length *= 0.5
            if length < 1e-6:
                flat_cost(state, flat, flat.position, eps)
                return taken
        flat.position[:] = flat.trial
        cost = found
    return count


@borrowing
def write_back(state, flat):
    """Positions of the nodes that moved, and all that follows from them, into the state; C."""
    ends = state.ends.size
    for i in range(flat.parent.size - 1, ends - 1, -1):
        node = flat.order[i - ends]
        save(state, node)
        if flat.moves[i]:
            r = state.node[node]
            r.x, r.y, r.z = flat.position[i, 0], flat.position[i, 1], flat.position[i, 2]
    for i in range(ends, flat.parent.size):
        if flat.moves[i]:
            keep_off(state, flat.order[i - ends])
    for i in range(flat.parent.size - 1, ends - 1, -1):
        node = flat.order[i - ends]
        relength(state, node)
        if flat.moves[i]:
            refresh(state, node)
    return total(state)


@borrowing
def relax_near(state, whole, reach, eps, count):
    """A few steps for the nodes on the paths of this test and ``reach`` levels below them; C. The state follows."""
    flat = flatten(state, whole, reach)
    steps(state, flat, eps, count, 0.0)
    return write_back(state, flat)


@borrowing
def relax(state, whole, eps, count):
    """A few steps for the whole tree; the state follows if its exact cost falls. C."""
    before = sweep(state, whole.order)
    begin(state)
    flat = flatten(state, whole, -1)
    steps(state, flat, eps, count, 0.0)
    if write_back(state, flat) > before:
        undo(state)
    return sweep(state, whole.order)


@borrowing
def polish(state, whole, eps, finest, tolerance):
    """Down to the nearest optimum, ``eps`` falling to ``finest``; C."""
    best = sweep(state, whole.order)
    begin(state)
    flat = flatten(state, whole, -1)
    kept = flat.position.copy()
    while eps >= finest:
        steps(state, flat, eps, 60, tolerance)
        found = flat_cost(state, flat, flat.position, 0.0)
        if found < best:
            best = found
            kept[:] = flat.position
        eps *= 0.3
    flat.position[:] = kept
    write_back(state, flat)
    return sweep(state, whole.order)
