"""Compiled parts of the skeleton graph; see :mod:`vascval.imaging.graph` and :mod:`vascval.imaging.loops`."""

import numpy as np

from vascval.core.jit import njit
from vascval.imaging._geodesic_kernels import neighbours


@njit
def skeleton_edges(voxel, number, lattice):
    """Pairs (a, b), a < b, of 26-adjacent skeleton voxels; ``number`` maps a voxel to its skeleton point or -1."""
    a = np.empty(13 * voxel.size, np.int32)
    b = np.empty(13 * voxel.size, np.int32)
    count = 0
    out = np.empty(26, np.int64)
    code = np.empty(26, np.int64)
    for p in range(voxel.size):
        m = neighbours(voxel[p], lattice, out, code)
        for t in range(m):
            q = number[out[t]]
            if q > p:
                a[count] = p
                b[count] = q
                count += 1
    return a[:count].copy(), b[:count].copy()


@njit
def incidence(n, a, b):
    """Edges ``edge[first[i]:first[i + 1]]`` at each of ``n`` points, and the points at their ``other`` ends."""
    first = np.zeros(n + 1, np.int64)
    for e in range(a.size):
        first[a[e] + 1] += 1
        first[b[e] + 1] += 1
    for i in range(n):
        first[i + 1] += first[i]
    fill = first[:-1].copy()
    edge, other = np.empty(2 * a.size, np.int32), np.empty(2 * a.size, np.int32)
    for e in range(a.size):
        edge[fill[a[e]]], other[fill[a[e]]] = e, b[e]
        fill[a[e]] += 1
        edge[fill[b[e]]], other[fill[b[e]]] = e, a[e]
        fill[b[e]] += 1
    return first, edge, other


@njit
def independent_loops(n, a, b, in_tree):
    """Edges outside the spanning tree that close a loop which is not filled by triangles of adjacent voxels.

    The voxels that touch each other span a complex with the homotopy of their union (nerve theorem: boxes that meet
    pairwise meet in common). An edge that closes a triangle with two known edges adds nothing; when no more triangles
    close, the first edge that remains is the generator of one more loop. An edge that becomes known can close the
    triangles that it is part of, and no others: these alone are looked at, so that the time goes with the edges.
    """
    first, edge, other = incidence(n, a, b)
    known = in_tree.copy()
    fresh = np.empty(a.size, np.int32)
    n_fresh = 0
    for e in range(a.size):
        if known[e]:
            fresh[n_fresh] = e
            n_fresh += 1
    loops = np.empty(a.size - n_fresh, np.int64)
    n_loops = 0
    for generator in range(a.size + 1):
        while n_fresh > 0:
            n_fresh -= 1
            e = fresh[n_fresh]
            for s in range(first[a[e]], first[a[e] + 1]):
                for t in range(first[b[e]], first[b[e] + 1]):
                    if other[s] != other[t] or known[edge[s]] == known[edge[t]]:
                        continue
                    closed = edge[t] if known[edge[s]] else edge[s]
                    known[closed] = True
                    fresh[n_fresh] = closed
                    n_fresh += 1
        if generator < a.size and not known[generator]:
            known[generator] = True
            loops[n_loops] = generator
            n_loops += 1
            fresh[0] = generator
            n_fresh = 1
    return loops[:n_loops].copy()


@njit
def climb(order, parent, kept, position):
    """Steps of each point from the root, its first ``kept`` ancestor (itself, or else the root) and the way there.

    :param order: (k,) points, parents first.
    """
    depth, base = np.zeros(parent.size, np.int32), np.arange(parent.size)
    way = np.zeros(parent.size)
    for i in order:
        above = parent[i]
        if above < 0:
            continue
        depth[i] = depth[above] + 1
        if not kept[i]:
            base[i] = base[above]
            way[i] = way[above] + np.sqrt(((position[i] - position[above]) ** 2).sum())
    return depth, base, way


@njit
def loop_sizes(parent, depth, u, v, position, thickness, enough):
    """Length and largest thickness of the loops that the edges ``u[c], v[c]`` close, followed until ``enough``."""
    length, widest = np.zeros(u.size), np.zeros(u.size)
    for c in range(u.size):
        i, j = u[c], v[c]
        length[c] = np.sqrt(((position[i] - position[j]) ** 2).sum())
        widest[c] = max(thickness[i], thickness[j])
        while i != j and length[c] <= enough:
            if depth[i] < depth[j]:
                i, j = j, i
            length[c] += np.sqrt(((position[i] - position[parent[i]]) ** 2).sum())
            i = parent[i]
            widest[c] = max(widest[c], thickness[i])
    return length, widest


@njit
def chains(n, a, b, is_node):
    """The chains between nodes of the graph of edges ``a[e], b[e]`` among ``n`` points; other points have two edges.

    :returns: chain ``c`` runs through ``point[offset[c]:offset[c + 1]]``, the nodes at both its ends included.
    """
    first, edge, other = incidence(n, a, b)
    is_done = np.zeros(a.size, np.bool_)
    point, offset = np.empty(2 * a.size, np.int32), np.zeros(a.size + 1, np.int64)
    size, count = 0, 0
    for p in range(n):
        if not is_node[p]:
            continue
        for s in range(first[p], first[p + 1]):
            if is_done[edge[s]]:
                continue
            point[size] = p
            at = s
            while True:
                is_done[edge[at]] = True
                q = other[at]
                size += 1
                point[size] = q
                if is_node[q]:
                    break
                at = first[q] + 1 if is_done[edge[first[q]]] else first[q]
            size += 1
            count += 1
            offset[count] = size
    return point[:size].copy(), offset[: count + 1].copy()


@njit
def spanning(n, a, b, rank):
    """Which of the edges ``a[e], b[e]`` among ``n`` points join what those before them in ``rank`` leave apart."""
    leader, joins = np.arange(n), np.zeros(a.size, np.bool_)
    for e in rank:
        i, j = a[e], b[e]
        while leader[i] != i:
            leader[i] = leader[leader[i]]
            i = leader[i]
        while leader[j] != j:
            leader[j] = leader[leader[j]]
            j = leader[j]
        joins[e] = i != j
        leader[i] = j
    return joins


@njit
def mark_paths(parent, ends):
    """Which points lie on the way from an end to the root."""
    kept = np.zeros(parent.size, np.bool_)
    for e in ends:
        i = e
        while i >= 0 and not kept[i]:
            kept[i] = True
            i = parent[i]
    return kept


@njit
def nearest_points(label, centre, radius, lattice, spacing, best):
    """For each voxel the skeleton point of least power distance ``|v - centre|^2 - radius^2``, spread from neighbour
    to neighbour; ``label`` holds the skeleton point of the voxels that are one and -1 elsewhere, and is overwritten.
    Voxels of a label below -1 keep it.

    :param best: (n,) infinite, becomes the least power distance.
    """
    n = label.size
    span, run, ny = lattice.span, lattice.run, lattice.ny
    queue = np.empty(n + 1, np.int32)
    waiting = np.zeros(n, np.bool_)
    square, power = np.empty((3, 3)), np.empty(27)
    head, tail, size = 0, 0, 0
    for i in range(n):
        if label[i] >= 0:
            best[i] = -(radius[label[i]] ** 2)
            queue[tail] = i
            tail += 1
            waiting[i] = True
            size += 1
        elif label[i] < -1:
            best[i] = -np.inf
    out = np.empty(26, np.int64)
    code = np.empty(26, np.int64)
    while size > 0:
        i = queue[head]
        head = head + 1 if head < n else 0
        size -= 1
        waiting[i] = False
        p = label[i]
        k = run[i]
        x, y, z = span[k, 1] + i - span[k, 2], span[k, 0] % ny, span[k, 0] // ny
        for c in range(3):
            square[0, c] = ((x + c - 1) * spacing[0] - centre[p, 0]) ** 2
            square[1, c] = ((y + c - 1) * spacing[1] - centre[p, 1]) ** 2
            square[2, c] = ((z + c - 1) * spacing[2] - centre[p, 2]) ** 2
        reach = radius[p] ** 2
        for c in range(9):
            ahead, across = square[2, c // 3], square[1, c % 3]
            for d in range(3):
                power[3 * c + d] = square[0, d] + across + ahead - reach
        for t in range(neighbours(i, lattice, out, code)):
            j = out[t]
            if power[code[t]] < best[j]:
                best[j] = power[code[t]]
                label[j] = p
                if not waiting[j]:
                    waiting[j] = True
                    queue[tail] = j
                    tail = tail + 1 if tail < n else 0
                    size += 1
