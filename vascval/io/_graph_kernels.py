"""Compiled loops of :mod:`vascval.io.assembly` and :mod:`vascval.io.paths`: arrays in, arrays out."""

import numpy as np

from vascval.core.jit import njit


@njit
def _find(leader, node):
    while leader[node] != node:
        leader[node] = leader[leader[node]]
        node = leader[node]
    return node


@njit
def spanning_forest(edges, order, n_nodes):
    """(E,) which edges Kruskal's algorithm keeps when it meets them in this order; (n,) the component of each node,
    named by its lowest node."""
    leader = np.arange(n_nodes)
    kept = np.zeros(edges.shape[0], dtype=np.bool_)
    for edge in order:
        a = _find(leader, edges[edge, 0])
        b = _find(leader, edges[edge, 1])
        if a != b:
            leader[max(a, b)] = min(a, b)
            kept[edge] = True
    for node in range(n_nodes):
        leader[node] = _find(leader, node)
    return kept, leader


@njit
def orient(offset, neighbour, via, root):
    """Breadth first from the root: (n,) nodes in that order, parent of each node and the edge to it (-1 at the root).

    The neighbours of node ``i`` are ``neighbour[offset[i]:offset[i + 1]]``, reached by the edges ``via``.
    """
    n = offset.size - 1
    parent = np.full(n, -1, dtype=np.int64)
    edge = np.full(n, -1, dtype=np.int64)
    order = np.empty(n, dtype=np.int64)
    order[0] = root
    count, done = 1, 0
    while done < count:
        node = order[done]
        done += 1
        for k in range(offset[node], offset[node + 1]):
            if via[k] != edge[node]:
                parent[neighbour[k]] = node
                edge[neighbour[k]] = via[k]
                order[count] = neighbour[k]
                count += 1
    return order, parent, edge


@njit
def stems(offset, neighbour, via, radius, length):
    """(n,) length-weighted mean radius of the run of edges from each end point to the next branching or end point
    (the largest radius where that run has no length); -1 where a node is no end point."""
    n = offset.size - 1
    mean = np.full(n, -1.0)
    for tip in range(n):
        if offset[tip + 1] - offset[tip] != 1:
            continue
        node, came = tip, -1
        total, weighted = 0.0, 0.0
        thickest = 0.0
        while True:
            k = offset[node]
            if via[k] == came:
                k += 1
            came = via[k]
            total += length[came]
            weighted += length[came] * radius[came]
            thickest = max(thickest, radius[came])
            node = neighbour[k]
            if offset[node + 1] - offset[node] != 2:
                break
        mean[tip] = weighted / total if total > 0 else thickest
    return mean


@njit
def chains(ends, parent, edge, kept, radius, length):
    """Runs of edges between kept nodes, one for each of ``ends``: its start, number of points and mean radius."""
    start = np.empty(ends.size, dtype=np.int64)
    size = np.empty(ends.size, dtype=np.int64)
    mean = np.empty(ends.size)
    for i in range(ends.size):
        node = ends[i]
        count, total, weighted = 1, 0.0, 0.0
        while True:
            total += length[edge[node]]
            weighted += length[edge[node]] * radius[edge[node]]
            node = parent[node]
            count += 1
            if kept[node]:
                break
        start[i], size[i] = node, count
        mean[i] = weighted / total if count > 2 else radius[edge[ends[i]]]
    return start, size, mean


@njit
def chain_points(ends, parent, offset):
    """The nodes along each chain, start first; chain ``i`` fills ``offset[i]:offset[i + 1]``."""
    nodes = np.empty(offset[-1], dtype=np.int64)
    for i in range(ends.size):
        node = ends[i]
        for k in range(offset[i + 1] - 1, offset[i] - 1, -1):
            nodes[k] = node
            node = parent[node]
    return nodes


@njit
def _distance2(a, b):
    return (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2


@njit
def _distance2_to_piece(point, a, b):
    span = _distance2(a, b)
    if span == 0.0:
        return _distance2(point, a)
    along = 0.0
    for k in range(3):
        along += (point[k] - a[k]) * (b[k] - a[k])
    along = min(max(along / span, 0.0), 1.0)
    total = 0.0
    for k in range(3):
        total += (point[k] - a[k] - along * (b[k] - a[k])) ** 2
    return total


@njit
def shared_beginning(points, group, tolerance, begin_a, end_a, begin_b, end_b):
    """How many points of path a, from its beginning, run along path b; and the point of b nearest to the last one.

    Point ``i`` of a does so when b passes within ``tolerance[i]``, or the point of b that it is beside, or the one
    before that, has the same group (groups below 0 say nothing; tracts repeat the point at which they meet).
    """
    beside = begin_b
    last = begin_b
    for i in range(begin_a, end_a):
        while beside + 1 < end_b and _distance2(points[i], points[beside + 1]) <= _distance2(points[i], points[beside]):
            beside += 1
        gap2 = _distance2(points[i], points[beside])
        if beside > begin_b:
            gap2 = min(gap2, _distance2_to_piece(points[i], points[beside - 1], points[beside]))
        if beside + 1 < end_b:
            gap2 = min(gap2, _distance2_to_piece(points[i], points[beside], points[beside + 1]))
        known = group[i] >= 0 and (group[i] == group[beside] or group[i] == group[max(beside - 1, begin_b)])
        if gap2 > tolerance[i] ** 2 and not known:
            return i - begin_a, last
        last = beside
    return end_a - begin_a, last


@njit
def merge_paths(points, offset, group, tolerance):
    """(P,) for each point of paths that start together, the point that stands for it; the first path stands for
    itself, a later one runs along an earlier one for as long as it can."""
    stands = np.arange(points.shape[0])
    for a in range(1, offset.size - 1):
        best, at = 1, 0
        for b in range(a):
            count, last = shared_beginning(points, group, tolerance, offset[a], offset[a + 1], offset[b], offset[b + 1])
            if count > best:
                best, at = count, last
        beside = stands[at]
        for i in range(offset[a], offset[a] + best):
            stands[i] = beside
    return stands
