"""The cost of a connection, exactly, and the best place for its bifurcation.

A new terminal changes ``rho`` and ``v`` along one path to the root alone. Let segment ``s``, from node ``p``, be cut at
the bifurcation ``b``. ``rho`` and ``v`` of the segment ``p b`` are carried up that path, and on the way down again the
derivatives of the cost ``F = log(rho)/2 + log(v)`` at the stem. What was found at a segment during the tests of this
terminal is kept (``Store.visit``): the paths of neighbours run together soon, and where one meets a visited segment
with values that differ by less than ``NEAR`` relatively, the rest of the way is ``F`` to first order. What is neglected
is of second order, about ``NEAR`` times the difference in cost between the two candidates: it can only swap candidates
that are as good as equal. What is then inserted is computed exactly. Half of the time is saved at 6,000 terminals.

With the derivatives fixed, F changes with the three lengths at ``b`` by the weights ``w = n dF/drho + dF/dv``, and the
best ``b`` is the weighted Fermat point of three points, known in closed form; a few such rounds converge.
"""

import numpy as np

from generator._fermat_kernels import NOWHERE, fermat
from vascval.core.borrowing import borrowing

NEAR = 1e-2
TINY = 1e-30


@borrowing
def climb(r, q_before, t_before, rho, v, gamma):
    """``rho`` and ``v`` of segment ``r`` with one more terminal, when a child's become ``rho``, ``v``; derivatives.

    With ``q = rho^(gamma/4)``: ``d rho'/d rho = base_rho q / (S rho)``, ``d v'/d v = sqrt(rho) / S^(2/gamma)`` and
    ``d v'/d rho = v / (2 sqrt(rho) S^(2/gamma)) - base_v q / (2 S rho)``.
    """
    q = rho ** (0.25 * gamma)
    root = np.sqrt(rho)
    s_sum = r.s_sum - q_before + q
    t_sum = r.t_sum - t_before + v * root
    a = s_sum ** (2.0 / gamma)
    base_rho = a * a
    base_v = t_sum / a
    part = q / (s_sum * rho)
    new_rho = (r.n + 1) * r.length + base_rho
    return new_rho, r.length + base_v, base_rho * part, v / (2.0 * root * a) - 0.5 * base_v * part, root / a


@borrowing
def walk(store, start, rho, v):
    """Cost of the stem, and its derivatives by ``rho`` and ``v`` of segment ``start``, when they take these values."""
    mark = store.counts[2]
    below = -1
    i = start
    while True:
        visit = store.visit[i]
        if visit.mark == mark and abs(rho - visit.rho) <= NEAR * rho and abs(v - visit.v) <= NEAR * v:
            cost = visit.cost + visit.d_rho * (rho - visit.rho) + visit.d_v * (v - visit.v)
            d_rho, d_v = visit.d_rho, visit.d_v
            break
        visit.mark = mark
        visit.below = below
        visit.rho = rho
        visit.v = v
        p = store.segment[i].parent
        if p < store.n_fixed:
            cost = 0.5 * np.log(rho) + np.log(v)
            d_rho, d_v = 0.5 / rho, 1.0 / v
            visit.cost, visit.d_rho, visit.d_v = cost, d_rho, d_v
            break
        r = store.segment[i]
        rho, v, visit.rr, visit.vr, visit.vv = climb(store.segment[p], r.q, r.t, rho, v, store.gamma)
        below = i
        i = p
    while below >= 0:
        visit = store.visit[below]
        d_rho = d_rho * visit.rr + d_v * visit.vr
        d_v = d_v * visit.vv
        visit.cost, visit.d_rho, visit.d_v = cost, d_rho, d_v
        below = visit.below
    return cost, d_rho, d_v


@borrowing
def length_between(ax, ay, az, bx, by, bz):
    return np.sqrt((ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2)


@borrowing
def joined(store, r, lp, ls, lt):
    """The new bifurcation's numbers, from the lengths to the proximal, distal and terminal point.

    ``rho_s, v_s, q_s, rho_t = v_t, q_t, S, S^(2/gamma), base_v`` and ``rho, v`` of the segment that feeds it.
    """
    ls, lt = max(ls, TINY), max(lt, TINY)
    rho_s = r.n * ls + r.base_rho
    v_s = ls + r.base_v
    q_s = rho_s ** (0.25 * store.gamma)
    q_t = lt ** (0.25 * store.gamma)
    s_sum = q_s + q_t
    a = s_sum ** (2.0 / store.gamma)
    base_v = (v_s * np.sqrt(rho_s) + lt * np.sqrt(lt)) / a
    return rho_s, v_s, q_s, lt, q_t, s_sum, a, base_v, (r.n + 1) * lp + a * a, lp + base_v


@borrowing
def feed(store, s, rho, v):
    """Cost and its derivatives by ``rho`` and ``v`` of a new segment that takes the place of ``s`` at its parent."""
    r = store.segment[s]
    p = np.int64(r.parent)
    if p < store.n_fixed:
        return 0.5 * np.log(rho) + np.log(v), 0.5 / rho, 1.0 / v
    up_rho, up_v, rr, vr, vv = climb(store.segment[p], r.q, r.t, rho, v, store.gamma)
    cost, d_rho, d_v = walk(store, p, up_rho, up_v)
    return cost, d_rho * rr + d_v * vr, d_v * vv


@borrowing
def weights(n, values, d_rho, d_v):
    """dF/dl of the proximal, distal and terminal segment at the bifurcation."""
    rho_s, v_s, q_s, rho_t, q_t, s_sum, a, base_v, _, _ = values
    root_s, root_t = np.sqrt(rho_s), np.sqrt(rho_t)
    part_s, part_t = q_s / (s_sum * rho_s), q_t / (s_sum * rho_t)
    ws = d_rho * a * a * part_s + d_v * (v_s / (2.0 * root_s * a) - 0.5 * base_v * part_s)
    wt = d_rho * a * a * part_t + d_v * (root_t / (2.0 * a) - 0.5 * base_v * part_t)
    return (n + 1) * d_rho + d_v, n * ws + d_v * root_s / a, wt + d_v * root_t / a


@borrowing
def beside(ox, oy, oz, ax, ay, az, wa, bx, by, bz, wb, distance):
    """The point ``distance`` from ``o`` towards where the pulls ``wa`` of ``a`` and ``wb`` of ``b`` add up to."""
    la, lb = length_between(ox, oy, oz, ax, ay, az), length_between(ox, oy, oz, bx, by, bz)
    wa, wb = wa / max(la, 1e-300), wb / max(lb, 1e-300)
    dx = wa * (ax - ox) + wb * (bx - ox)
    dy = wa * (ay - oy) + wb * (by - oy)
    dz = wa * (az - oz) + wb * (bz - oz)
    scale = distance / max(np.sqrt(dx * dx + dy * dy + dz * dz), 1e-300)
    return ox + scale * dx, oy + scale * dy, oz + scale * dz


@borrowing
def first_guess(r, x, y, z):
    """A third of the way from the segment's nearest point, kept off its ends, to the new terminal."""
    dx, dy, dz = r.bx - r.ax, r.by - r.ay, r.bz - r.az
    along = ((x - r.ax) * dx + (y - r.ay) * dy + (z - r.az) * dz) / max(r.length * r.length, 1e-300)
    along = min(max(along, 0.1), 0.9)
    bx, by, bz = r.ax + along * dx, r.ay + along * dy, r.az + along * dz
    return bx + (x - bx) / 3.0, by + (y - by) / 3.0, bz + (z - bz) / 3.0


@borrowing
def assess(store, s, bx, by, bz, x, y, z, scale):
    """Cost with the bifurcation at ``b``, the three lengths, the three weights and the three radii.

    ``scale`` is ``sqrt(kappa Q_term / dp)`` of the stem: as ``dF/dv = (r / r_stem)^2 / v_stem``, the squared radius of
    the segment that feeds the bifurcation is ``scale dF/dv exp(F)``.
    """
    r = store.segment[s]
    lp = length_between(bx, by, bz, r.ax, r.ay, r.az)
    ls = length_between(bx, by, bz, r.bx, r.by, r.bz)
    lt = length_between(bx, by, bz, x, y, z)
    values = joined(store, r, lp, ls, lt)
    cost, d_rho, d_v = feed(store, s, values[8], values[9])
    wp, ws, wt = weights(r.n, values, d_rho, d_v)
    rp = np.sqrt(scale * d_v * np.exp(cost))
    unit = rp / np.sqrt(values[6])
    return cost, lp, ls, lt, wp, ws, wt, rp, unit * values[0] ** 0.25, unit * values[3] ** 0.25, d_rho, d_v


@borrowing
def refine(store, s, bx, by, bz, x, y, z, d_rho, d_v, rounds):
    """Fermat rounds with the path's derivatives held; the last weights and the corner it fell on are returned too.

    Corners are the proximal end, the distal one, and the terminal.
    """
    r = store.segment[s]
    corner = NOWHERE
    wp = ws = wt = 0.0
    for _ in range(rounds):
        lp = length_between(bx, by, bz, r.ax, r.ay, r.az)
        ls = length_between(bx, by, bz, r.bx, r.by, r.bz)
        lt = length_between(bx, by, bz, x, y, z)
        wp, ws, wt = weights(r.n, joined(store, r, lp, ls, lt), d_rho, d_v)
        fx, fy, fz, corner = fermat(r.ax, r.ay, r.az, r.bx, r.by, r.bz, x, y, z, wp, ws, wt)
        part = 1.0 if corner == NOWHERE else 0.8
        bx, by, bz = bx + part * (fx - bx), by + part * (fy - by), bz + part * (fz - bz)
    return bx, by, bz, corner, wp, ws, wt
