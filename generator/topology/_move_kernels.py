"""Moves from topology to topology, and the places of the bifurcations they concern."""

import numpy as np

from generator.topology._state_kernels import child_slope, distance, keep_off, refresh, relength, save
from vascval.core.jit import njit


@njit
def fermat(a, b, c, wa, wb, wc):
    """Weighted Fermat point of three nodes, and whether it falls on one of them."""
    return fermat_of(a.x, a.y, a.z, b.x, b.y, b.z, c.x, c.y, c.z, wa, wb, wc)


@njit
def fermat_of(ax, ay, az, bx, by, bz, cx, cy, cz, wa, wb, wc):
    """Weighted Fermat point of three points, and whether it falls on one of them.

    In the triangle whose sides are the weights, of angles ``theta``, the point has barycentric coordinates
    proportional to ``w_i d_jk / sin(alpha_i + theta_i)``, ``alpha`` being the angles of the triangle of nodes; a sine
    that is not positive means node ``i``. Both factors follow from the squares of the sides without trigonometry.
    """
    product = (wa + wb + wc) * (wb + wc - wa) * (wa + wc - wb) * (wa + wb - wc)
    if product <= 0.0:
        if wa >= wb and wa >= wc:
            return ax, ay, az, True
        if wb >= wc:
            return bx, by, bz, True
        return cx, cy, cz, True
    ab = (ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2
    ac = (ax - cx) ** 2 + (ay - cy) ** 2 + (az - cz) ** 2
    bc = (bx - cx) ** 2 + (by - cy) ** 2 + (bz - cz) ** 2
    area_w = np.sqrt(product)
    area = np.sqrt(max(4.0 * ab * ac - (ab + ac - bc) ** 2, 0.0))
    ka = (ab + ac - bc) * area_w + (wb * wb + wc * wc - wa * wa) * area
    kb = (ab + bc - ac) * area_w + (wa * wa + wc * wc - wb * wb) * area
    kc = (ac + bc - ab) * area_w + (wa * wa + wb * wb - wc * wc) * area
    if ka <= 0.0:
        return ax, ay, az, True
    if kb <= 0.0:
        return bx, by, bz, True
    if kc <= 0.0:
        return cx, cy, cz, True
    fa, fb, fc = kb * kc, ka * kc, ka * kb
    scale = 1.0 / (fa + fb + fc)
    fa, fb, fc = fa * scale, fb * scale, fc * scale
    return (
        fa * ax + fb * bx + fc * cx,
        fa * ay + fb * by + fc * cy,
        fa * az + fb * bz + fc * cz,
        False,
    )


@njit
def settle(state, i, d_rho, d_v, rounds):
    """Put bifurcation ``i`` where the three segments balance, given dC/drho and dC/dv of the one that feeds it.

    The node and its two children are brought up to date, nothing above.
    """
    r = state.node[i]
    save(state, i)
    save(state, r.first)
    save(state, r.second)
    p, c, d = state.node[r.parent], state.node[r.first], state.node[r.second]
    relength(state, r.first)
    relength(state, r.second)
    for _ in range(rounds):
        refresh(state, i)
        c_rho, c_v = child_slope(d_rho, d_v, r.s_sum, r.a, r.base_v, c.rho, c.v, c.q)
        e_rho, e_v = child_slope(d_rho, d_v, r.s_sum, r.a, r.base_v, d.rho, d.v, d.q)
        x, y, z, corner = fermat(p, c, d, r.n * d_rho + d_v, c.n * c_rho + c_v, d.n * e_rho + e_v)
        part = 0.9 if corner else 1.0
        r.x += part * (x - r.x)
        r.y += part * (y - r.y)
        r.z += part * (z - r.z)
        keep_off(state, i)
        relength(state, r.first)
        relength(state, r.second)
        r.length = distance(r, p)
    refresh(state, i)


@njit
def sibling(state, i):
    p = state.node[state.node[i].parent]
    return p.second if p.first == i else p.first


@njit
def replace(state, parent, old, new):
    """``new`` takes the place of ``old`` below ``parent``."""
    save(state, parent)
    save(state, new)
    r = state.node[parent]
    if r.first == old:
        r.first = new
    else:
        r.second = new
    state.node[new].parent = parent


@njit
def is_below(state, i, top):
    """Whether node ``i`` is ``top`` or lies below it."""
    while i >= state.n_fixed:
        if i == top:
            return True
        i = state.node[i].parent
    return False


@njit
def may_graft(state, s, t):
    """Whether cutting ``s`` off and grafting it on segment ``t`` makes another tree."""
    p = state.node[s].parent
    return p >= state.n_fixed and t != p and state.node[t].parent != p and not is_below(state, t, s)


@njit
def first_place(r, u, e):
    """Where a bifurcation on the segment from ``u`` to ``r`` begins to be put right if ``e`` is to spring from it."""
    dx, dy, dz = u.x - r.x, u.y - r.y, u.z - r.z
    along = ((e.x - r.x) * dx + (e.y - r.y) * dy + (e.z - r.z) * dz) / max(r.length * r.length, 1e-300)
    along = min(max(along, 0.1), 0.9)
    x, y, z = r.x + along * dx, r.y + along * dy, r.z + along * dz
    return x + (e.x - x) / 3.0, y + (e.y - y) / 3.0, z + (e.z - z) / 3.0


@njit
def graft(state, s, t, x, y, z):
    """Cut off segment ``s`` together with its proximal node, which is put at a point on segment ``t``.

    Returns the proximal node that is left behind, from which the tree has to be brought up to date.
    """
    p = state.node[s].parent
    other = sibling(state, s)
    g = state.node[p].parent
    replace(state, g, p, other)
    relength(state, other)
    u = state.node[t].parent
    replace(state, u, t, p)
    replace(state, p, other, t)
    r = state.node[p]
    r.x, r.y, r.z = x, y, z
    r.length = distance(r, state.node[u])
    return g


@njit
def may_swap(state, a, b):
    """The paper's filters: no cycle, and no new segment twice as long as it was."""
    p, q = state.node[a].parent, state.node[b].parent
    if p == q or p < state.n_fixed or q < state.n_fixed:
        return False
    if distance(state.node[a], state.node[q]) >= 2.0 * state.node[a].length:
        return False
    if distance(state.node[b], state.node[p]) >= 2.0 * state.node[b].length:
        return False
    return not (is_below(state, a, b) or is_below(state, b, a))


@njit
def swap(state, a, b):
    """Exchange the proximal nodes of two segments."""
    p, q = state.node[a].parent, state.node[b].parent
    replace(state, p, a, b)
    replace(state, q, b, a)
