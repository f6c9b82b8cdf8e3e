"""One terminal after the other: test the nearest segments, take the best connection, bring the tree up to date.

Indices and flags are passed as ``np.int64`` and ``np.bool_``: for literals and narrower integers the compiler would
compile every callee once more.
"""

import numpy as np

from generator._domain_kernels import segment_inside
from generator._fermat_kernels import AT_FIRST, AT_SECOND, AT_THIRD, NOWHERE
from generator.growth._candidate_kernels import (
    assess,
    beside,
    climb,
    first_guess,
    length_between,
    refine,
    walk,
)
from generator.growth._index_kernels import anything_within, nearest, register
from generator.growth._overlap_kernels import keeps_apart, springs_apart
from vascval.core.borrowing import borrowing

PLACED, REFUSED, TOO_THIN = 1, 2, 3
DONE, NO_MORE_POINTS, NO_ROOM, STUCK = 0, 1, 2, 3
STRANDED = 5000  # points refused in a row after which growth gives up


@borrowing
def prepare_stem(store, stems, j):
    """What a new terminal below stem ``j`` means to all stems: the others' volume and this one's scale, ``inf``: none.

    Volumes are divided by ``pi sqrt(kappa Q_term)``: stem ``i`` has ``exp(F_i) / sqrt(dp_i)``.
    """
    if stems.mark[j] == store.counts[2]:
        return
    stems.mark[j] = store.counts[2]
    flow = stems.flow_mm3_s / (store.counts[1] + 1)
    stems.others[j] = 0.0
    stems.own[j] = np.inf
    for i in range(stems.top.size):
        drop = stems.drop_pa - flow * stems.shared[i, j]
        for k in range(stems.top.size):
            drop -= flow * stems.shared[i, k] * stems.n[k]
        if drop <= 0.0:
            stems.others[j] = np.inf
            return
        if i == j:
            stems.own[j] = 1.0 / np.sqrt(drop)
        else:
            stems.others[j] += np.exp(stems.cost[i]) / np.sqrt(drop)


@borrowing
def merged(store, s, x, y, z, scale):
    """Cost and radius of a terminal that springs from the proximal node of ``s``, with no new bifurcation."""
    r = store.segment[s]
    lt = length_between(x, y, z, r.ax, r.ay, r.az)
    p = store.segment[r.parent]
    rho, v, _, _, _ = climb(p, 0.0, 0.0, lt, lt, store.gamma)
    cost, _, d_v = walk(store, np.int64(r.parent), rho, v)
    radius = np.sqrt(scale * d_v * np.exp(cost)) * lt**0.25
    return cost, radius / (rho - (p.n + 1) * p.length) ** 0.25


@borrowing
def moved_off(store, rules, s, x, y, z, found, bx, by, bz, corner):
    """The bifurcation moved as far as the shortest lengths ask, and whether it was moved at all."""
    _, lp, ls, lt, wp, ws, wt, rp, rs, rt, _, _ = found
    r = store.segment[s]
    shortest_p = max(2.0 * rules.diameters * rp, rules.shortest_mm)
    shortest_s = max(2.0 * rules.diameters * rs, rules.shortest_mm)
    shortest_t = max(2.0 * rules.diameters * rt, rules.shortest_mm)
    if corner == AT_FIRST or lp < shortest_p:
        shortest_p = max(1.02 * shortest_p, 1e-3 * r.length)
        return beside(r.ax, r.ay, r.az, r.bx, r.by, r.bz, ws, x, y, z, wt, shortest_p), True
    if corner == AT_SECOND or ls < shortest_s:
        shortest_s = max(1.02 * shortest_s, 1e-3 * r.length)
        return beside(r.bx, r.by, r.bz, r.ax, r.ay, r.az, wp, x, y, z, wt, shortest_s), True
    if corner == AT_THIRD or lt < shortest_t:
        shortest_t = max(1.02 * shortest_t, 1e-3 * r.length)
        return beside(x, y, z, r.ax, r.ay, r.az, wp, r.bx, r.by, r.bz, ws, shortest_t), True
    return (bx, by, bz), False


@borrowing
def long_enough(rules, found):
    _, lp, ls, lt, _, _, _, rp, rs, rt, _, _ = found
    d = 2.0 * rules.diameters
    shortest = rules.shortest_mm
    return (
        lp >= max(d * rp, shortest)
        and ls >= max(d * rs, shortest)
        and lt >= max(d * rt, shortest)
        and lp * ls * lt > 0.0
    )


@borrowing
def propose(store, rules, s, x, y, z, scale):
    """The best bifurcation on segment ``s`` that keeps to the shortest lengths.

    Is there one? Its numbers (:func:`assess`), its place, and whether it wants to merge with the proximal node.
    """
    bx, by, bz = first_guess(store.segment[s], x, y, z)
    found = assess(store, s, bx, by, bz, x, y, z, scale)
    for rounds in (3, 2):
        bx, by, bz, corner, _, _, _ = refine(store, s, bx, by, bz, x, y, z, found[10], found[11], rounds)
        found = assess(store, s, bx, by, bz, x, y, z, scale)
    merge = corner == AT_FIRST or (corner == NOWHERE and found[1] <= rules.merge_mm)
    (bx, by, bz), moved = moved_off(store, rules, s, x, y, z, found, bx, by, bz, corner)
    if moved:
        found = assess(store, s, bx, by, bz, x, y, z, scale)
    return long_enough(rules, found), found, bx, by, bz, merge


@borrowing
def fits(store, rules, grid, space, s, bx, by, bz, x, y, z, found):
    """Does the connection stay inside the domain and clear of other vessels?"""
    r = store.segment[s]
    return (
        segment_inside(space, bx, by, bz, x, y, z)
        and segment_inside(space, r.ax, r.ay, r.az, bx, by, bz)
        and segment_inside(space, bx, by, bz, r.bx, r.by, r.bz)
        and (rules.apart <= 0.0 or keeps_apart(store, grid, s, bx, by, bz, x, y, z, found, rules.apart))
    )


@borrowing
def connect(store, stems, rules, grid, space, x, y, z, near, distance):
    """Test the segments nearest to the point and take the best connection; ``PLACED``, ``REFUSED`` or ``TOO_THIN``."""
    store.counts[2] += 1
    n_near = nearest(grid, store.segment, x, y, z, store.counts[2], near, distance)
    best, best_s, best_x, best_y, best_z = np.inf, np.int64(-1), 0.0, 0.0, 0.0
    best_p, best_d, best_radius = 0.0, 0.0, 0.0
    merge, thin = False, False
    for c in range(n_near):
        s = np.int64(near[c])
        r = store.segment[s]
        prepare_stem(store, stems, np.int64(r.stem))
        own, others = stems.own[r.stem], stems.others[r.stem]
        if s < store.n_fixed or not np.isfinite(own):
            continue
        scale = np.sqrt(stems.kappa_pa_s * stems.flow_mm3_s / (store.counts[1] + 1)) * own
        fine, found, bx, by, bz, at_node = propose(store, rules, s, x, y, z, scale)
        if at_node and rules.merge_mm >= 0.0 and r.parent >= store.n_fixed:
            cost, radius = merged(store, s, x, y, z, scale)
            total = others + own * np.exp(cost)
            lt = length_between(r.ax, r.ay, r.az, x, y, z)
            if total < best and lt >= max(2.0 * rules.diameters * radius, rules.shortest_mm):
                if radius < rules.thinnest_mm:
                    thin = True
                elif segment_inside(space, r.ax, r.ay, r.az, x, y, z) and (
                    rules.apart <= 0.0 or springs_apart(store, grid, s, x, y, z, radius, rules.apart)
                ):
                    best, best_s, merge, best_radius = total, s, True, radius
            continue
        total = others + own * np.exp(found[0])
        if not fine or not total < best:
            continue
        if found[9] < rules.thinnest_mm:
            thin = True
        elif fits(store, rules, grid, space, s, bx, by, bz, x, y, z, found):
            best, best_s, merge, best_x, best_y, best_z = total, s, False, bx, by, bz
            best_p, best_d, best_radius = found[7], found[8], found[9]
    if best_s < 0:
        return TOO_THIN if thin else REFUSED
    if merge:
        attach(store, grid, np.int64(store.segment[best_s].parent), x, y, z, best_radius)
    else:
        cut(store, grid, best_s, best_x, best_y, best_z, best_p, best_d)
        attach(store, grid, store.counts[0] - 1, x, y, z, best_radius)
    add_one(store, stems)
    return PLACED


@borrowing
def new_segment(store, parent, ax, ay, az, bx, by, bz, stem, radius):
    """A segment without children, entered among those of its parent node; returns its index."""
    i = store.counts[0]
    store.counts[0] += 1
    r = store.segment[i]
    r.parent, r.child, r.stem, r.seen, r.n = parent, -1, stem, 0, 0
    r.sibling = store.segment[parent].child
    store.segment[parent].child = i
    r.ax, r.ay, r.az, r.bx, r.by, r.bz = ax, ay, az, bx, by, bz
    r.length = length_between(ax, ay, az, bx, by, bz)
    r.radius = radius
    if radius > store.thin[0]:
        store.thick[store.counts[5]] = i
        store.counts[5] += 1
    return i


@borrowing
def cut(store, grid, s, bx, by, bz, radius_above, radius_below):
    """Cut segment ``s`` at the bifurcation, a new node; what was below stays with ``s``."""
    r = store.segment[s]
    register(grid, r, s, np.bool_(False))
    p = np.int64(r.parent)
    b = new_segment(store, p, r.ax, r.ay, r.az, bx, by, bz, r.stem, radius_above)
    i = b
    while store.segment[i].sibling != s:
        i = store.segment[i].sibling
    store.segment[i].sibling = r.sibling
    r.parent, r.sibling = b, -1
    store.segment[b].child = s
    store.segment[b].n = r.n
    r.ax, r.ay, r.az = bx, by, bz
    r.length = length_between(bx, by, bz, r.bx, r.by, r.bz)
    r.radius = radius_below
    update(r, store.gamma)
    register(grid, r, s, np.bool_(True))
    register(grid, store.segment[b], b, np.bool_(True))


@borrowing
def attach(store, grid, p, x, y, z, radius):
    """A new terminal that springs from node ``p``."""
    above = store.segment[p]
    t = new_segment(store, p, above.bx, above.by, above.bz, x, y, z, above.stem, radius)
    store.counts[1] += 1
    register(grid, store.segment[t], t, np.bool_(True))


@borrowing
def update(r, gamma):
    """``rho`` and ``v`` of a segment, and what they add to its parent's sums, from its length and its own sums."""
    r.rho = r.n * r.length + r.base_rho
    r.v = r.length + r.base_v
    r.q = r.rho ** (0.25 * gamma)
    r.t = r.v * np.sqrt(r.rho)


@borrowing
def gather(store, i):
    """The sums of segment ``i`` over its children, anew, and all that follows from them."""
    r = store.segment[i]
    s_sum, t_sum = 0.0, 0.0
    c = r.child
    while c >= 0:
        s_sum += store.segment[c].q
        t_sum += store.segment[c].t
        c = store.segment[c].sibling
    r.s_sum, r.t_sum = s_sum, t_sum
    r.base_rho, r.base_v = 0.0, 0.0
    if s_sum > 0.0:
        a = s_sum ** (2.0 / store.gamma)
        r.base_rho, r.base_v = a * a, t_sum / a
    update(r, store.gamma)


@borrowing
def add_one(store, stems):
    """Bring the path from the newest terminal to its stem up to date: one terminal more."""
    i = store.counts[0] - 1
    while i >= store.n_fixed:
        store.segment[i].n += 1
        gather(store, i)
        top = i
        i = store.segment[i].parent
    r = store.segment[top]
    stems.top[r.stem] = top
    stems.n[r.stem] += 1
    stems.cost[r.stem] = 0.5 * np.log(r.rho) + np.log(r.v)


@borrowing
def grow(store, stems, rules, grid, space, points, outcome, spacing_mm, target, near, distance):
    """Place points, from ``count[3]`` on, until there are ``target`` terminals; see the return codes above.

    :param outcome: (M,) what became of each point.
    :param spacing_mm: the distance that the k-th terminal must keep from all segments is ``spacing_mm / k^(1/3)``,
        times 0.9 after every 10 points refused; negative for given points, each of which is tried once.
    """
    nx, ny, nz = grid.head.shape
    room = 4 * (nx + ny + nz + 3)
    while store.counts[1] < target:
        at = store.counts[3]
        if at >= len(points):
            return NO_MORE_POINTS
        if grid.free[1] < room:
            return NO_ROOM
        x, y, z = points[at]
        store.counts[3] += 1
        if spacing_mm >= 0.0:
            apart = spacing_mm / (store.counts[1] + 1) ** (1.0 / 3.0) * 0.9 ** (store.counts[4] // 10)
            if anything_within(grid, store.segment, x, y, z, apart):
                store.counts[4] += 1
                continue
        outcome[at] = connect(store, stems, rules, grid, space, x, y, z, near, distance)
        if outcome[at] == PLACED:
            store.counts[4] = 0
        else:
            store.counts[4] += 1
            if outcome[at] == TOO_THIN or (spacing_mm >= 0.0 and store.counts[4] > STRANDED):
                return STUCK
    return DONE


@borrowing
def begin(store, stems, grid, node, x, y, z):
    """A first terminal straight from a node of the root tree, or the root: a new stem, if none springs there."""
    t = new_segment(
        store, node, store.segment[node].bx, store.segment[node].by, store.segment[node].bz, x, y, z, 0, 0.0
    )
    j = 0
    while stems.top[j] >= 0:
        j += 1
    store.segment[t].stem = j
    store.counts[1] += 1
    register(grid, store.segment[t], t, np.bool_(True))
    add_one(store, stems)


@borrowing
def load(store, stems, parent, position):
    """Fill the store with a tree: ``parent`` (N,), root first, the fixed nodes before all; ``position`` (N, 3)."""
    size = parent.size
    store.counts[0] = size
    for i in range(size):
        r = store.segment[i]
        p = max(parent[i], 0)
        r.parent, r.child, r.sibling, r.n, r.seen = parent[i], -1, -1, 0, 0
        r.ax, r.ay, r.az = position[p]
        r.bx, r.by, r.bz = position[i]
        r.length = length_between(r.ax, r.ay, r.az, r.bx, r.by, r.bz)
    for i in range(size - 1, 0, -1):
        r = store.segment[i]
        if r.child < 0 and i >= store.n_fixed:
            r.n = 1
            store.counts[1] += 1
        gather(store, i)
        r.sibling = store.segment[r.parent].child
        store.segment[r.parent].child = i
        store.segment[r.parent].n += r.n
    inner = np.zeros(store.n_fixed, np.bool_)
    for i in range(1, store.n_fixed):
        inner[parent[i]] = True
    stem = np.cumsum(~inner) - 1  # stems are numbered as the ends of the root tree that they spring from
    for i in range(store.n_fixed, size):
        r = store.segment[i]
        if r.parent < store.n_fixed:
            j = stem[r.parent]
            r.stem = j
            stems.top[j], stems.n[j] = i, r.n
            stems.cost[j] = 0.5 * np.log(r.rho) + np.log(r.v)
        else:
            r.stem = store.segment[r.parent].stem


@borrowing
def spread_down(store, lost):
    """All that springs below a lost segment is lost too; so is a bifurcation both of whose branches are."""
    changed = True
    while changed:
        changed = False
        i = store.segment[0].child
        while i > 0:
            r = store.segment[i]
            if lost[r.parent] and not lost[i]:
                lost[i] = True
            if r.child >= 0:
                i = r.child
                continue
            while i > 0 and store.segment[i].sibling < 0:
                i = store.segment[i].parent
                bare = i >= store.n_fixed and not lost[i]
                c = store.segment[i].child
                while bare and c >= 0:
                    bare = lost[c]
                    c = store.segment[c].sibling
                if bare:
                    lost[i] = True
                    changed = True
            if i > 0:
                i = store.segment[i].sibling
