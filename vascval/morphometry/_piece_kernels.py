"""Compiled searches behind :mod:`vascval.morphometry.pieces`: pieces of centrelines in a tree of bounding boxes."""

import numpy as np

from vascval.core.jit import njit


@njit
def segment_distance_squared(p, q, r, s):
    """Squared distance between the line pieces p-q and r-s, exact also where they are parallel or points.

    The unconstrained minimiser on one line is clamped to its piece, the best point for it on the other found and
    clamped in turn; the closest pair of two pieces is always of that form.
    """
    d1 = q - p
    d2 = s - r
    w = p - r
    a = d1[0] * d1[0] + d1[1] * d1[1] + d1[2] * d1[2]
    e = d2[0] * d2[0] + d2[1] * d2[1] + d2[2] * d2[2]
    f = d2[0] * w[0] + d2[1] * w[1] + d2[2] * w[2]
    c = d1[0] * w[0] + d1[1] * w[1] + d1[2] * w[2]
    b = d1[0] * d2[0] + d1[1] * d2[1] + d1[2] * d2[2]
    t1 = 0.0
    if a > 0.0:
        spread = a * e - b * b
        if spread > 1e-14 * a * e:
            t1 = min(max((b * f - c * e) / spread, 0.0), 1.0)
    t2 = 0.0
    if e > 0.0:
        t2 = (b * t1 + f) / e
    if t2 < 0.0 or t2 > 1.0 or e == 0.0:
        t2 = min(max(t2, 0.0), 1.0)
        if a > 0.0:
            t1 = min(max((b * t2 - c) / a, 0.0), 1.0)
    total = 0.0
    for k in range(3):
        gap = w[k] + t1 * d1[k] - t2 * d2[k]
        total += gap * gap
    return total


@njit
def box_tree(low, high, order, n_leaves):
    """Bounding boxes of a complete binary tree over the pieces in the given order; node 1 is the root.

    Leaf ``k`` is node ``n_leaves + k`` (``n_leaves`` a power of two); leaves without a piece are empty boxes.
    """
    box_low = np.full((2 * n_leaves, 3), np.inf)
    box_high = np.full((2 * n_leaves, 3), -np.inf)
    for k in range(order.size):
        box_low[n_leaves + k] = low[order[k]]
        box_high[n_leaves + k] = high[order[k]]
    for k in range(n_leaves - 1, 0, -1):
        for c in range(3):
            box_low[k, c] = min(box_low[2 * k, c], box_low[2 * k + 1, c])
            box_high[k, c] = max(box_high[2 * k, c], box_high[2 * k + 1, c])
    return box_low, box_high


@njit
def intersecting(start, end, radius, segment, parent, order, box_low, box_high, n_leaves):
    """Pairs of segments, without a node in common, of which two pieces intersect; a pair may come more than once."""
    pairs = np.empty((1024, 2), np.int64)
    found = 0
    stack = np.empty(128, np.int64)
    for k in range(order.size):
        i = order[k]
        leaf = n_leaves + k
        stack[0] = 1
        top = 1
        while top > 0:
            top -= 1
            node = stack[top]
            apart = False
            for c in range(3):
                apart = apart or box_low[node, c] > box_high[leaf, c] or box_high[node, c] < box_low[leaf, c]
            if apart:
                continue
            if node < n_leaves:
                # only leaves after this one: every pair is met once
                for child in (2 * node, 2 * node + 1):
                    last = child
                    while last < n_leaves:
                        last = 2 * last + 1
                    if last > leaf:
                        stack[top] = child
                        top += 1
                continue
            if node <= leaf:
                continue
            j = order[node - n_leaves]
            a, b = segment[i], segment[j]
            if a == b or parent[a] == parent[b] or parent[a] == b or parent[b] == a:
                continue
            reach = radius[a] + radius[b]
            if segment_distance_squared(start[i], end[i], start[j], end[j]) < reach * reach:
                if found == pairs.shape[0]:
                    grown = np.empty((2 * found, 2), np.int64)
                    grown[:found] = pairs
                    pairs = grown
                pairs[found, 0] = min(a, b)
                pairs[found, 1] = max(a, b)
                found += 1
    return pairs[:found]


@njit
def point_distance_squared(x, p, q):
    """Squared distance of a point from the line piece p-q."""
    d = q - p
    w = x - p
    square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
    t = 0.0
    if square > 0.0:
        t = min(max((d[0] * w[0] + d[1] * w[1] + d[2] * w[2]) / square, 0.0), 1.0)
    total = 0.0
    for k in range(3):
        total += (w[k] - t * d[k]) ** 2
    return total


@njit
def _box_distance_squared(x, low, high):
    total = 0.0
    for k in range(3):
        gap = max(low[k] - x[k], x[k] - high[k], 0.0)
        total += gap * gap
    return total


@njit
def nearest(points, start, end, order, box_low, box_high, n_leaves):
    """(K,) squared distance of each point from the nearest piece.

    The piece that was nearest to the point before bounds the search from the start: points come along centrelines.
    """
    result = np.empty(len(points))
    stack = np.empty(128, np.int64)
    bound = np.empty(128)
    last = order[0]
    for k in range(len(points)):
        x = points[k]
        best = point_distance_squared(x, start[last], end[last])
        stack[0] = 1
        bound[0] = 0.0
        top = 1
        while top > 0:
            top -= 1
            node = stack[top]
            if bound[top] >= best:
                continue
            if node >= n_leaves:
                j = order[node - n_leaves]
                square = point_distance_squared(x, start[j], end[j])
                if square < best:
                    best = square
                    last = j
                continue
            near, far = 2 * node, 2 * node + 1
            near_bound = _box_distance_squared(x, box_low[near], box_high[near])
            far_bound = _box_distance_squared(x, box_low[far], box_high[far])
            if far_bound < near_bound:
                near, far = far, near
                near_bound, far_bound = far_bound, near_bound
            if far_bound < best:
                stack[top] = far
                bound[top] = far_bound
                top += 1
            if near_bound < best:
                stack[top] = near
                bound[top] = near_bound
                top += 1
        result[k] = best
    return result
