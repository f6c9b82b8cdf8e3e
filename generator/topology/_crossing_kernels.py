"""A subtree of one tree put together in another tree of the same terminals, which are numbered alike in both."""

import numpy as np

from generator.topology._anneal_kernels import stays_inside
from generator.topology._move_kernels import graft, is_below, may_graft
from generator.topology._relax_kernels import flatten, steps, write_back
from generator.topology._state_kernels import begin, long_enough, save, sweep, undo
from vascval.core.borrowing import borrowing

STEPS = 3  # of the whole tree, at each of three smoothings
WORSE, DOUBT = 1e-3, 3e-4  # how much it may cost more as it is put together, and after the first steps
LEAST = 1e-9  # gain


@borrowing
def list_below(node, top, below):
    """The nodes of the subtree that ends at ``top``, each after what feeds it; how many."""
    below[0] = top
    count, k = 1, 0
    while k < count:
        r = node[below[k]]
        if r.first >= 0:
            below[count], below[count + 1] = r.first, r.second
            count += 2
        k += 1
    return count


@borrowing
def assemble(state, donor, top, below, place):
    """Join the terminals below ``top`` as ``donor`` joins them, and put their bifurcations where it has them.

    Of two subtrees the smaller is grafted on the larger. ``place`` says which node is now which of the donor's. Returns
    how many grafts that took, -1 if a stem would have to be moved. The tree is to be swept afterwards.
    """
    made = 0
    for k in range(list_below(donor, top, below) - 1, -1, -1):
        i = below[k]
        d = donor[i]
        if d.first < 0:
            place[i] = i
            continue
        s, t = place[d.first], place[d.second]
        if state.node[s].parent != state.node[t].parent:
            if donor[d.first].n > donor[d.second].n:
                s, t = t, s
            if state.node[s].parent < state.n_fixed:
                s, t = t, s
            if state.node[s].parent < state.n_fixed:
                return -1
            graft(state, s, t, d.x, d.y, d.z)
            made += 1
        place[i] = state.node[s].parent
        save(state, place[i])
        r = state.node[place[i]]
        r.x, r.y, r.z = d.x, d.y, d.z
    return made


@borrowing
def find_nearest(state, point, clade, nearest, apart):
    """Into ``nearest`` the segments nearest to a point outside the subtree ``clade``, its own and its sibling's and the
    one that feeds them left out; -1 where there are fewer. ``apart`` are their distances squared."""
    nearest[:] = -1
    apart[:] = np.inf
    feeding = state.node[clade].parent
    for i in range(state.n_fixed, state.node.size):
        r = state.node[i]
        p = state.node[r.parent]
        dx, dy, dz = p.x - r.x, p.y - r.y, p.z - r.z
        ex, ey, ez = point.x - r.x, point.y - r.y, point.z - r.z
        along = (dx * ex + dy * ey + dz * ez) / max(dx * dx + dy * dy + dz * dz, 1e-300)
        along = min(max(along, 0.0), 1.0)
        away = (ex - along * dx) ** 2 + (ey - along * dy) ** 2 + (ez - along * dz) ** 2
        if away >= apart[-1] or i == feeding or r.parent == feeding or is_below(state, i, clade):
            continue
        k = nearest.size - 1
        while k > 0 and apart[k - 1] > away:
            nearest[k], apart[k] = nearest[k - 1], apart[k - 1]
            k -= 1
        nearest[k], apart[k] = i, away


@borrowing
def relaxed(state, flat, eps, cost):
    """C of the whole tree after some steps, none or a few if it is far above ``cost``."""
    found = sweep(state, flat.order)
    if found > cost + WORSE:
        return found
    view = flatten(state, flat, -1)
    steps(state, view, eps, STEPS, 0.0)
    found = write_back(state, view)
    if found < cost + DOUBT:
        steps(state, view, 0.2 * eps, STEPS, 0.0)
        steps(state, view, 0.04 * eps, STEPS, 0.0)
        found = write_back(state, view)
    return found


@borrowing
def cross(state, flat, space, donor, top, eps, below, place, nearest, apart, cost):
    """Put the subtree of ``donor`` that ends at ``top`` together in this tree; kept if it costs less. C.

    All of the tree is relaxed for that, but not in a domain with walls, which it would leave.
    It stays where the largest part of it was, or springs from one of the segments nearest to where it springs in the
    donor: the first of these that costs less than ``cost``, C of the tree as it is.
    """
    spring = donor[donor[top].parent]
    for choice in range(1 + nearest.size):
        begin(state)
        fits = assemble(state, donor, top, below, place) > 0
        changed = fits
        if fits and choice > 0:
            clade = place[top]
            if choice == 1:
                find_nearest(state, spring, clade, nearest, apart)
            on = nearest[choice - 1]
            fits = on >= 0 and may_graft(state, clade, on)
            if fits:
                graft(state, clade, on, spring.x, spring.y, spring.z)
        if fits:
            found = relaxed(state, flat, eps, cost) if space.convex else sweep(state, flat.order)
            if found < cost - LEAST and long_enough(state) and stays_inside(state, space):
                return sweep(state, flat.order)
        undo(state)
        sweep(state, flat.order)
        if not changed:
            break
    return cost
