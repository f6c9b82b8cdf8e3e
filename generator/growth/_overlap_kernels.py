"""Do new vessels keep clear of those that are there?

Two vessels without a common node overlap where their axes come closer than the sum of their radii. Radii of the tree
are those of the last sweep; the caller asks for a margin.
"""

import numpy as np

from generator.growth._index_kernels import cell_of
from vascval.core.borrowing import borrowing


@borrowing
def square_between(ax, ay, az, bx, by, bz, r):
    """Square of the distance between the segment from ``a`` to ``b`` and the segment in record ``r``.

    The quadratic form of the distance is convex in the two parameters: its minimum over one, clamped, is put into the
    other, clamped, and back.
    """
    ux, uy, uz = bx - ax, by - ay, bz - az
    vx, vy, vz = r.bx - r.ax, r.by - r.ay, r.bz - r.az
    wx, wy, wz = ax - r.ax, ay - r.ay, az - r.az
    uu, vv = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz
    uv = ux * vx + uy * vy + uz * vz
    uw, vw = ux * wx + uy * wy + uz * wz, vx * wx + vy * wy + vz * wz
    det = uu * vv - uv * uv
    s = 0.0
    if det > 1e-12 * uu * vv:
        s = min(max((uv * vw - vv * uw) / det, 0.0), 1.0)
    t = (uv * s + vw) / vv if vv > 0.0 else 0.0
    t = min(max(t, 0.0), 1.0)
    if uu > 0.0:
        s = min(max((uv * t - uw) / uu, 0.0), 1.0)
    dx, dy, dz = wx + s * ux - t * vx, wy + s * uy - t * vy, wz + s * uz - t * vz
    return dx * dx + dy * dy + dz * dz


@borrowing
def meets(store, o, ax, ay, az, bx, by, bz, radius, node_a, node_b, skip, margin):
    """Does vessel ``o`` overlap one from ``a`` to ``b``, ``node_a`` to ``node_b``, that shares no node with it?"""
    r = store.segment[o]
    if o in (0, skip, node_a, node_b) or r.parent in (node_a, node_b):
        return False
    return square_between(ax, ay, az, bx, by, bz, r) < (margin * (radius + r.radius)) ** 2


@borrowing
def clear(store, grid, ax, ay, az, bx, by, bz, radius, node_a, node_b, skip, margin):
    """Does a vessel from ``a`` to ``b`` keep clear of all others?

    Thin ones are found in the cells around it; the few whose radius is beyond ``Store.thin`` are gone through one by
    one.
    """
    reach = (radius + store.thin[0]) * margin
    i0, j0, k0 = cell_of(grid, min(ax, bx) - reach, min(ay, by) - reach, min(az, bz) - reach)
    i1, j1, k1 = cell_of(grid, max(ax, bx) + reach, max(ay, by) + reach, max(az, bz) + reach)
    for i in range(i0, i1 + 1):
        for j in range(j0, j1 + 1):
            for k in range(k0, k1 + 1):
                e = grid.head[i, j, k]
                while e >= 0:
                    o = np.int64(grid.owner[e])
                    if meets(store, o, ax, ay, az, bx, by, bz, radius, node_a, node_b, skip, margin):
                        return False
                    e = grid.link[e]
    for c in range(store.counts[5]):
        if meets(store, np.int64(store.thick[c]), ax, ay, az, bx, by, bz, radius, node_a, node_b, skip, margin):
            return False
    return True


@borrowing
def keeps_apart(store, grid, s, bx, by, bz, x, y, z, found, margin):
    """Do the three segments of a bifurcation at ``b`` on segment ``s`` keep clear? New nodes have no number yet."""
    r = store.segment[s]
    none = np.int64(-2)
    return (
        clear(store, grid, bx, by, bz, x, y, z, found[9], none, none, s, margin)
        and clear(store, grid, r.ax, r.ay, r.az, bx, by, bz, found[7], np.int64(r.parent), none, s, margin)
        and clear(store, grid, bx, by, bz, r.bx, r.by, r.bz, found[8], none, s, s, margin)
    )


@borrowing
def springs_apart(store, grid, s, x, y, z, radius, margin):
    """Does a new terminal from the proximal node of ``s`` keep clear?"""
    r = store.segment[s]
    none = np.int64(-2)
    return clear(store, grid, r.ax, r.ay, r.az, x, y, z, radius, np.int64(r.parent), none, none, margin)


@borrowing
def smaller(store, s, o):
    """Of two vessels, the one that is easier to give up: not of the root tree, no stem, fewer terminals, younger."""
    if s < store.n_fixed or o < store.n_fixed:
        return max(s, o)
    s_top, o_top = store.segment[s].parent < store.n_fixed, store.segment[o].parent < store.n_fixed
    if s_top != o_top:
        return o if s_top else s
    n_s, n_o = store.segment[s].n, store.segment[o].n
    if n_s != n_o:
        return s if n_s < n_o else o
    return max(s, o)


@borrowing
def mark_smaller(store, s, o, lost, margin):
    """Mark the smaller of two vessels that overlap; 1 if they do."""
    r = store.segment[s]
    if o >= s or max(s, o) < store.n_fixed:
        return 0
    if not meets(store, o, r.ax, r.ay, r.az, r.bx, r.by, r.bz, r.radius, np.int64(r.parent), s, s, margin):
        return 0
    lost[smaller(store, s, o)] = True
    return 1


@borrowing
def mark_overlapping(store, grid, lost, margin):
    """Mark in ``lost`` the smaller vessel of every pair that overlaps; returns how many times one was met."""
    total = 0
    for s in range(1, store.counts[0]):
        r = store.segment[s]
        if r.radius > store.thin[0]:
            continue
        reach = margin * 2.0 * store.thin[0]
        i0, j0, k0 = cell_of(grid, min(r.ax, r.bx) - reach, min(r.ay, r.by) - reach, min(r.az, r.bz) - reach)
        i1, j1, k1 = cell_of(grid, max(r.ax, r.bx) + reach, max(r.ay, r.by) + reach, max(r.az, r.bz) + reach)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                for k in range(k0, k1 + 1):
                    e = grid.head[i, j, k]
                    while e >= 0:
                        total += mark_smaller(store, s, np.int64(grid.owner[e]), lost, margin)
                        e = grid.link[e]
    for c in range(store.counts[5]):
        for o in range(1, store.counts[0]):
            s = np.int64(store.thick[c])
            total += mark_smaller(store, max(s, o), min(s, o), lost, margin)
    return total


@borrowing
def sweep_radii(store, stem_radius):
    """All radii anew, root to leaf, from those of the stems (J,), and the list of thick vessels."""
    store.counts[5] = 0
    i = store.segment[0].child
    while i > 0:
        r = store.segment[i]
        if i >= store.n_fixed:
            if r.parent < store.n_fixed:
                r.radius = stem_radius[r.stem]
            else:
                p = store.segment[r.parent]
                r.radius = p.radius * (r.rho / p.base_rho) ** 0.25
        if r.radius > store.thin[0]:
            store.thick[store.counts[5]] = i
            store.counts[5] += 1
        if r.child >= 0:
            i = r.child
            continue
        while i > 0 and store.segment[i].sibling < 0:
            i = store.segment[i].parent
        if i > 0:
            i = store.segment[i].sibling
