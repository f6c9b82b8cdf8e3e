"""Compiled sweeps behind :mod:`vascval.morphometry.junctions`: plain loops over nodes and centrelines."""

import math

import numpy as np

from vascval.core.jit import njit


@njit
def _walk(points, begin, step, count, arc, out):
    """The point at distance ``arc`` along a polyline walked from row ``begin`` in rows of ``step``."""
    left = arc
    for k in range(count - 1):
        a = begin + step * k
        b = a + step
        length = math.sqrt(
            (points[b, 0] - points[a, 0]) ** 2 + (points[b, 1] - points[a, 1]) ** 2 + (points[b, 2] - points[a, 2]) ** 2
        )
        if left <= length and length > 0.0:
            t = left / length
            for c in range(3):
                out[c] = points[a, c] + t * (points[b, c] - points[a, c])
            return
        left -= length
    for c in range(3):
        out[c] = points[begin + step * (count - 1), c]


@njit
def directions(parent, points, offset, length, junction_radius, near, far):
    """Unit directions in which each segment leaves its proximal node and arrives at its distal node, (N, 3) each.

    A direction is the chord between the centreline points ``near`` and ``far`` junction radii away from the node, at
    most half of the segment and all of it. Where both points coincide it is NaN.
    """
    n = parent.size
    leaves = np.full((n, 3), np.nan)
    arrives = np.full((n, 3), np.nan)
    a = np.empty(3)
    b = np.empty(3)
    for i in range(1, n):
        first, last = offset[i], offset[i + 1] - 1
        count = last - first + 1
        for end in range(2):
            node = parent[i] if end == 0 else i
            begin = first if end == 0 else last
            step = 1 if end == 0 else -1
            _walk(points, begin, step, count, min(near * junction_radius[node], 0.5 * length[i]), a)
            _walk(points, begin, step, count, min(far * junction_radius[node], length[i]), b)
            norm = math.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2)
            if norm > 0.0:
                for c in range(3):
                    if end == 0:
                        leaves[i, c] = (b[c] - a[c]) / norm
                    else:
                        arrives[i, c] = (a[c] - b[c]) / norm
    return leaves, arrives


@njit
def angle_deg(u, v):
    """Angle between two vectors in degrees, exact near 0 and 180."""
    x = u[1] * v[2] - u[2] * v[1]
    y = u[2] * v[0] - u[0] * v[2]
    z = u[0] * v[1] - u[1] * v[0]
    return math.degrees(math.atan2(math.sqrt(x * x + y * y + z * z), u[0] * v[0] + u[1] * v[1] + u[2] * v[2]))


@njit
def branching_angles(parent, leaves, arrives):
    """(N,) angle between each segment and the one that feeds it; NaN at the root."""
    result = np.full(parent.size, np.nan)
    for i in range(1, parent.size):
        if parent[i] > 0:
            result[i] = angle_deg(arrives[parent[i]], leaves[i])
    return result


@njit
def rank_children(nodes, child_offset, child_index, radius, angle):
    """Thickest, second and thinnest child of each node; among equals the one that goes straighter on is thicker."""
    rank = np.empty((nodes.size, 3), np.int64)
    for k in range(nodes.size):
        first, second, last = -1, -1, -1
        for c in child_index[child_offset[nodes[k]] : child_offset[nodes[k] + 1]]:
            if first < 0 or _thicker(c, first, radius, angle):
                second = first
                first = c
            elif second < 0 or _thicker(c, second, radius, angle):
                second = c
            if last < 0 or _thicker(last, c, radius, angle):
                last = c
        rank[k, 0], rank[k, 1], rank[k, 2] = first, second, last
    return rank


@njit
def _thicker(a, b, radius, angle):
    return radius[a] > radius[b] or (radius[a] == radius[b] and angle[a] < angle[b])


@njit
def pair_angles(first, second, leaves):
    """Angle between the directions of two lists of segments."""
    result = np.empty(first.size)
    for k in range(first.size):
        result[k] = angle_deg(leaves[first[k]], leaves[second[k]])
    return result


@njit
def murray_exponents(nodes, child_offset, child_index, radius):
    """g with ``sum((r_child / r)^g) = 1``; NaN where a child is as thick as its parent, or there is no parent.

    With all children thinner the sum falls from their number (two or more) at g = 0 towards 0, convex: Newton's
    iterates from 0 rise to the one solution without ever passing it.
    """
    result = np.full(nodes.size, np.nan)
    for k in range(nodes.size):
        node = nodes[k]
        if node == 0:
            continue
        children = child_index[child_offset[node] : child_offset[node + 1]]
        thinner = True
        for c in children:
            thinner = thinner and radius[c] < radius[node]
        if not thinner:
            continue
        g = 0.0
        for _ in range(200):
            value, slope = -1.0, 0.0
            for c in children:
                log = math.log(radius[c] / radius[node])
                power = math.exp(g * log)
                value += power
                slope += power * log
            step = -value / slope
            g += step
            if abs(step) <= 1e-13 * g:
                break
        result[k] = g
    return result
