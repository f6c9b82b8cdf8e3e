"""What a move would add to the cost, to first order in what it changes further up, at a cost that is free of depth.

The segments whose children change are computed exactly, with the new bifurcation put in its place; above them the
slopes of the last sweep stand for the rest of the tree. Most tests are settled by this alone.
"""

import numpy as np

from generator._fermat_kernels import NOWHERE, fermat
from generator.topology._move_kernels import first_place, is_below, sibling
from generator.topology._state_kernels import TINY, branch_power, child_slope, distance, joined
from vascval.core.borrowing import borrowing

ROUNDS = 3


@borrowing
def changed_above(state, i, old, rho, v, extra):
    """Rise of C if child ``old`` of ``i`` had ``rho`` and ``v`` instead, and ``extra`` terminals more were below."""
    c = state.node[old]
    if i < state.n_fixed:
        return c.d_rho * (rho - c.rho) + c.d_v * (v - c.v)
    r = state.node[i]
    s_sum = r.s_sum - c.q + branch_power(state.gamma, rho)
    a = joined(state.gamma, s_sum)
    base_v = (r.base_v * r.a - c.t + v * np.sqrt(rho)) / a
    rise = r.d_rho * ((r.n + extra) * r.length + a * a - r.rho) + r.d_v * (base_v - r.base_v)
    if r.parent >= state.n_fixed:
        rise += extra * state.node[r.parent].d_n
    return rise


@borrowing
def reach(r, length):
    """``rho`` and ``v`` of the segment to node ``r`` if its length were ``length``."""
    if r.first < 0:
        length = max(length, TINY)
    return r.n * length + r.a * r.a, length + r.base_v


@borrowing
def fork(state, s, t, extra):
    """``rho`` and ``v`` of the segment that would feed ``s`` and ``t`` from where ``t`` is fed, at its best place.

    ``extra`` terminals would be below it that are not below ``t`` now: none if ``s`` is.
    """
    r, e = state.node[t], state.node[s]
    u = state.node[r.parent]
    gamma = state.gamma
    x, y, z = first_place(r, u, e)
    n = r.n + extra
    n_r = n - e.n
    aa = r.a * r.a
    rho, v = 0.0, 0.0
    for k in range(ROUNDS + 1):
        rho_e, v_e = reach(e, np.sqrt((e.x - x) ** 2 + (e.y - y) ** 2 + (e.z - z) ** 2))
        l_r = np.sqrt((r.x - x) ** 2 + (r.y - y) ** 2 + (r.z - z) ** 2)
        if r.first < 0:
            l_r = max(l_r, TINY)
        rho_r, v_r = n_r * l_r + aa, l_r + r.base_v
        q_e, q_r = branch_power(gamma, rho_e), branch_power(gamma, rho_r)
        s_sum = q_e + q_r
        a = joined(gamma, s_sum)
        base_v = (v_e * np.sqrt(rho_e) + v_r * np.sqrt(rho_r)) / a
        length = np.sqrt((u.x - x) ** 2 + (u.y - y) ** 2 + (u.z - z) ** 2)
        rho, v = n * length + a * a, length + base_v
        if k == ROUNDS:
            break
        e_rho, e_v = child_slope(r.d_rho, r.d_v, s_sum, a, base_v, rho_e, v_e, q_e)
        c_rho, c_v = child_slope(r.d_rho, r.d_v, s_sum, a, base_v, rho_r, v_r, q_r)
        px, py, pz, corner = fermat(
            u.x, u.y, u.z, r.x, r.y, r.z, e.x, e.y, e.z, n * r.d_rho + r.d_v, n_r * c_rho + c_v, e.n * e_rho + e_v
        )
        part = 1.0 if corner == NOWHERE else 0.9
        x, y, z = x + part * (px - x), y + part * (py - y), z + part * (pz - z)
    return rho, v


@borrowing
def estimate_graft(state, s, t):
    """Rise of C by grafting ``s`` on ``t``."""
    e = state.node[s]
    p = e.parent
    g = state.node[p].parent
    o = state.node[sibling(state, s)]
    rho, v = reach(o, distance(o, state.node[g]))
    rise = changed_above(state, g, p, rho, v, -e.n)
    extra = 0 if is_below(state, s, t) else e.n
    rho, v = fork(state, s, t, extra)
    return rise + changed_above(state, state.node[t].parent, t, rho, v, extra)


@borrowing
def estimate_swap(state, a, b):
    """Rise of C by exchanging the proximal nodes of ``a`` and ``b``, which stay where they are."""
    r, e = state.node[a], state.node[b]
    p, q = r.parent, e.parent
    rho, v = reach(e, distance(e, state.node[p]))
    rise = changed_above(state, p, a, rho, v, e.n - r.n)
    rho, v = reach(r, distance(r, state.node[q]))
    return rise + changed_above(state, q, b, rho, v, r.n - e.n)
