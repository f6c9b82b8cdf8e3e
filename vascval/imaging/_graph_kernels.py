"""Compiled parts of the skeleton graph; see :mod:`vascval.imaging.graph`."""

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
def independent_loops(n, a, b, in_tree):
    """Edges outside the spanning tree that close a loop which is not filled by triangles of adjacent voxels.

    The voxels that touch each other span a complex with the homotopy of their union (nerve theorem: boxes that meet
    pairwise meet in common). An edge that closes a triangle with two known edges adds nothing; an edge that remains
    when no more triangles close is the generator of one more loop.
    """
    degree = np.zeros(n + 1, np.int64)
    for e in range(a.size):
        degree[a[e] + 1] += 1
        degree[b[e] + 1] += 1
    for i in range(n):
        degree[i + 1] += degree[i]
    fill = degree[:-1].copy()
    edge = np.empty(2 * a.size, np.int64)
    other = np.empty(2 * a.size, np.int64)
    for e in range(a.size):
        edge[fill[a[e]]] = e
        other[fill[a[e]]] = b[e]
        fill[a[e]] += 1
        edge[fill[b[e]]] = e
        other[fill[b[e]]] = a[e]
        fill[b[e]] += 1
    known = in_tree.copy()
    loops = np.empty(a.size, np.int64)
    n_loops = 0
    todo = np.flatnonzero(~in_tree)
    while True:
        changed = True
        while changed:
            changed = False
            for e in todo:
                if known[e]:
                    continue
                for s in range(degree[a[e]], degree[a[e] + 1]):
                    if not known[edge[s]]:
                        continue
                    closes = False
                    for t in range(degree[b[e]], degree[b[e] + 1]):
                        if known[edge[t]] and other[t] == other[s]:
                            closes = True
                    if closes:
                        known[e] = True
                        changed = True
                        break
        generator = -1
        for e in todo:
            if not known[e]:
                generator = e
                break
        if generator < 0:
            return loops[:n_loops].copy()
        known[generator] = True
        loops[n_loops] = generator
        n_loops += 1


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
def nearest_points(label, centre, radius, lattice, spacing):
    """For each voxel the skeleton point of least power distance ``|v - centre|^2 - radius^2``, spread from neighbour
    to neighbour; ``label`` holds the skeleton point of the voxels that are one and -1 elsewhere, and is overwritten.
    """
    n = label.size
    span, run, ny = lattice.span, lattice.run, lattice.ny
    best = np.full(n, np.inf)
    queue = np.empty(n + 1, np.int32)
    waiting = np.zeros(n, np.bool_)
    axis_x, axis_y, axis_z = np.arange(27) % 3, np.arange(27) // 3 % 3, np.arange(27) // 9
    square = np.empty((3, 3))
    head, tail, size = 0, 0, 0
    for i in range(n):
        if label[i] >= 0:
            best[i] = -(radius[label[i]] ** 2)
            queue[tail] = i
            tail += 1
            waiting[i] = True
            size += 1
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
        m = neighbours(i, lattice, out, code)
        for t in range(m):
            j, c = out[t], code[t]
            power = square[0, axis_x[c]] + square[1, axis_y[c]] + square[2, axis_z[c]] - radius[p] ** 2
            if power < best[j]:
                best[j] = power
                label[j] = p
                if not waiting[j]:
                    waiting[j] = True
                    queue[tail] = j
                    tail = tail + 1 if tail < n else 0
                    size += 1
    return label
