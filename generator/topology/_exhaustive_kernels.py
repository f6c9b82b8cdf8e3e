"""Lower bounds on the volume of a topology, behind :mod:`generator.topology.exhaustive`, where they are derived.

Nodes are numbered 0 root, 1 to N terminals, from N + 1 on bifurcations in the order in which they are made; ``up`` has
the node above each.
"""

import numpy as np

from generator.geometry._reduced_kernels import dot, pull, solve_laplacian
from vascval.core.borrowing import borrowing
from vascval.core.jit import njit

BEND = 0.97
COARSE, FINE = 1e-2, 3e-4  # smoothing in parts of the size of the tree
TIGHT = 1e-3  # relative distance of bound and value that is good enough


@borrowing
def insert(up, n_terminals, grown, edge):
    """Join terminal ``grown + 1`` by a new bifurcation on the segment that ends at node ``edge``."""
    b = n_terminals + grown
    up[b] = up[edge]
    up[edge] = b
    up[grown + 1] = b


@borrowing
def root_first(up, n_terminals, grown, order, parent):
    """The nodes of a tree of ``grown`` terminals, each after its parent, and their parents in that numbering."""
    size = 2 * grown
    rank = np.full(up.size, -1)
    order[0] = 0
    rank[0] = 0
    count, k = 1, 0
    while k < count:
        for i in range(1, n_terminals + grown):
            if (i <= grown or i > n_terminals) and up[i] == order[k]:
                order[count] = i
                rank[i] = count
                parent[count] = k
                count += 1
        k += 1
    parent[0] = -1
    return size


@borrowing
def value(parent, n, position, eps, below, chord, length, y, slope):
    """The relaxed cost ``y`` of the stem with lengths ``sqrt(d^2 + eps^2) - eps``, and its derivatives by them."""
    size = parent.size
    below[:] = 0.0
    for i in range(size - 1, 0, -1):
        p = parent[i]
        square = 0.0
        for k in range(3):
            square += (position[i, k] - position[p, k]) ** 2
        chord[i] = np.sqrt(square)
        length[i] = np.sqrt(square + eps * eps)
        y[i] = np.cbrt(n[i]) * (length[i] - eps) + np.cbrt(below[i]) ** 2
        below[p] += y[i] * np.sqrt(y[i])
    slope[1] = 1.0
    for i in range(2, size):
        slope[i] = slope[parent[i]] * np.sqrt(y[i]) / max(np.cbrt(below[parent[i]]), 1e-300)
    for i in range(1, size):
        slope[i] = slope[i] * np.cbrt(n[i])
    return y[1]


@borrowing
def lower_bound(parent, n, position, moves, corners, size_mm, enough):
    """A number that ``y`` cannot fall below; ``position`` ends where it was found. Stops at ``enough``."""
    size = parent.size
    below, chord, length, y, slope = np.zeros(size), np.zeros(size), np.zeros(size), np.zeros(size), np.zeros(size)
    nothing, block, diagonal = np.zeros(size), np.zeros((size, 6)), np.zeros((size, 6))
    gradient, direction, trial = np.zeros((size, 3)), np.zeros((size, 3)), np.zeros((size, 3))
    best = 0.0
    for part in (COARSE, FINE):
        eps = part * size_mm
        cost = value(parent, n, position, eps, below, chord, length, y, slope)
        for _ in range(40):
            pull(parent, position, moves, chord, length, slope, nothing, gradient)
            best = max(best, cost - room_to_fall(position, gradient, moves, corners))
            if best >= enough or best >= cost * (1.0 - TIGHT):
                break
            solve_laplacian(
                parent, position, moves, chord, length, slope, nothing, BEND, gradient, block, diagonal, direction
            )
            step, found = 1.0, cost
            while step > 1e-4:
                trial[:] = position - step * direction
                found = value(parent, n, trial, eps, below, chord, length, y, slope)
                if found <= cost - 1e-4 * step * dot(gradient, direction):
                    break
                step *= 0.5
            if step <= 1e-4:
                break
            position[:] = trial
            cost = found
        if best >= enough:
            break
    return best


@borrowing
def room_to_fall(position, gradient, moves, corners):
    """How much a convex function with this gradient can fall while every node stays in the hull of the corners."""
    total = 0.0
    for i in range(position.shape[0]):
        if moves[i]:
            farthest = 0.0
            for c in range(corners.shape[0]):
                fall = 0.0
                for k in range(3):
                    fall += gradient[i, k] * (position[i, k] - corners[c, k])
                farthest = max(farthest, fall)
            total += farthest
    return total


@njit
def bounds_of_insertions(up, points, grown, size_mm, enough):
    """(2 grown - 1,) bounds with terminal ``grown + 1`` on each segment, and (...) the nodes these end at.

    ``points`` (N + 1, 3): root and terminals.
    """
    n_terminals = points.shape[0] - 1
    edges = np.empty(2 * grown - 1, np.int64)
    count = 0
    for i in range(1, n_terminals + grown):
        if i <= grown or i > n_terminals:
            edges[count] = i
            count += 1
    result = np.empty(count)
    order, parent = np.empty(2 * n_terminals, np.int64), np.empty(2 * n_terminals, np.int32)
    for e in range(count):
        made = up.copy()
        insert(made, n_terminals, grown, edges[e])
        size = root_first(made, n_terminals, grown + 1, order, parent)
        result[e], _ = bound_of(parent[:size], order[:size], points, grown + 1, size_mm, enough)
    return edges, result


@njit
def bound_of(parent, order, points, grown, size_mm, enough):
    """Bound of one topology, and positions (size, 3) near the least value of the relaxed cost."""
    size = parent.size
    n, moves, position = np.zeros(size), np.zeros(size, np.bool_), np.zeros((size, 3))
    middle = np.zeros((size, 3))
    for i in range(size - 1, -1, -1):
        if order[i] < points.shape[0]:
            position[i] = points[order[i]]
            if i > 0:
                n[i] = 1.0
                middle[i] = points[order[i]]
        else:
            moves[i] = True
            for k in range(3):
                position[i, k] = 0.7 * middle[i, k] / n[i] + 0.3 * points[0, k]
        if i > 0:
            n[parent[i]] += n[i]
            middle[parent[i]] += middle[i]
    found = lower_bound(parent, n, position, moves, points[: grown + 1], size_mm, enough)
    return found, position
