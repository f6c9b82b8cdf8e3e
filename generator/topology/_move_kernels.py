"""Moves from topology to topology, and the places of the bifurcations they concern."""

from generator._fermat_kernels import NOWHERE, fermat
from generator.topology._state_kernels import child_slope, distance, keep_off, refresh, relength, save
from vascval.core.borrowing import borrowing


@borrowing
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
        x, y, z, corner = fermat(
            p.x, p.y, p.z, c.x, c.y, c.z, d.x, d.y, d.z, r.n * d_rho + d_v, c.n * c_rho + c_v, d.n * e_rho + e_v
        )
        part = 1.0 if corner == NOWHERE else 0.9
        r.x += part * (x - r.x)
        r.y += part * (y - r.y)
        r.z += part * (z - r.z)
        keep_off(state, i)
        relength(state, r.first)
        relength(state, r.second)
        r.length = distance(r, p)
    refresh(state, i)


@borrowing
def sibling(state, i):
    p = state.node[state.node[i].parent]
    return p.second if p.first == i else p.first


@borrowing
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


@borrowing
def is_below(state, i, top):
    """Whether node ``i`` is ``top`` or lies below it."""
    while i >= state.n_fixed:
        if i == top:
            return True
        i = state.node[i].parent
    return False


@borrowing
def may_graft(state, s, t):
    """Whether cutting ``s`` off and grafting it on segment ``t`` makes another tree."""
    p = state.node[s].parent
    return p >= state.n_fixed and t != p and state.node[t].parent != p and not is_below(state, t, s)


@borrowing
def first_place(r, u, e):
    """Where a bifurcation on the segment from ``u`` to ``r`` begins to be put right if ``e`` is to spring from it."""
    dx, dy, dz = u.x - r.x, u.y - r.y, u.z - r.z
    along = ((e.x - r.x) * dx + (e.y - r.y) * dy + (e.z - r.z) * dz) / max(r.length * r.length, 1e-300)
    along = min(max(along, 0.1), 0.9)
    x, y, z = r.x + along * dx, r.y + along * dy, r.z + along * dz
    return x + (e.x - x) / 3.0, y + (e.y - y) / 3.0, z + (e.z - z) / 3.0


@borrowing
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


@borrowing
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


@borrowing
def swap(state, a, b):
    """Exchange the proximal nodes of two segments."""
    p, q = state.node[a].parent, state.node[b].parent
    replace(state, p, a, b)
    replace(state, q, b, a)
