"""Compiled geometry behind :mod:`generator.domain_surface`."""

import numpy as np

from generator._domain_kernels import INSIDE, WALL, crosses
from vascval.core.jit import njit


@njit
def entries(triangle, lower, cell, shape, offset, wall, count_only):
    """List the triangles in every cell that their bounding box touches; first counted, then entered."""
    fill = offset.copy()
    first = np.empty(3, np.int64)
    last = np.empty(3, np.int64)
    for t in range(len(triangle)):
        for axis in range(3):
            low = min(triangle[t, 0, axis], triangle[t, 1, axis], triangle[t, 2, axis])
            high = max(triangle[t, 0, axis], triangle[t, 1, axis], triangle[t, 2, axis])
            first[axis] = max(int((low - lower[axis]) / cell - 1e-6), 0)
            last[axis] = min(int((high - lower[axis]) / cell + 1e-6), shape[axis] - 1)
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                for k in range(first[2], last[2] + 1):
                    c = (i * shape[1] + j) * shape[2] + k
                    if count_only:
                        offset[c + 1] += 1
                    else:
                        wall[fill[c]] = t
                        fill[c] += 1


@njit
def crossings(triangle, listed, ax, ay, az, bx, by, bz):
    """How many of the listed triangles the segment from ``a`` to ``b`` meets."""
    total = 0
    for t in listed:
        if crosses(triangle[t], ax, ay, az, bx - ax, by - ay, bz - az, 0.0):
            total += 1
    return total


@njit
def classify(triangle, offset, wall, reference, shape, inside):
    """Which cells' reference points (C, 3) are inside, from the outermost corner, cell by cell.

    The step from one cell's reference point to its neighbour's stays within the two cells: it changes sides when it
    crosses the surface an odd number of times. ``inside`` (C,) int8 comes in as -1.
    """
    queue = np.empty(inside.size, np.int64)
    queue[0] = 0
    inside[0] = 0
    end = 1
    begin = 0
    seen = np.full(len(triangle), -1, np.int64)
    stride = (shape[1] * shape[2], shape[2], 1)
    while begin < end:
        c = queue[begin]
        begin += 1
        at = (c // stride[0], (c // shape[2]) % shape[1], c % shape[2])
        for axis in range(3):
            for step in (-1, 1):
                if at[axis] + step < 0 or at[axis] + step >= shape[axis]:
                    continue
                n = c + step * stride[axis]
                if inside[n] >= 0:
                    continue
                total = 0
                for cell in (c, n):
                    for k in range(offset[cell], offset[cell + 1]):
                        t = wall[k]
                        if seen[t] == n:
                            continue
                        seen[t] = n
                        a, b = reference[c], reference[n]
                        if crosses(triangle[t], a[0], a[1], a[2], b[0] - a[0], b[1] - a[1], b[2] - a[2], 0.0):
                            total += 1
                inside[n] = (inside[c] + total) % 2
                queue[end] = n
                end += 1


@njit
def points_inside(space, lower, cell, reference, inside, points):
    """(K,) whether each point is inside: on the side of its cell's reference point, as far as crossings tell."""
    shape = space.state.shape
    result = np.zeros(len(points), np.bool_)
    for q in range(len(points)):
        i = int(np.floor((points[q, 0] - lower[0]) / cell))
        j = int(np.floor((points[q, 1] - lower[1]) / cell))
        k = int(np.floor((points[q, 2] - lower[2]) / cell))
        if i < 0 or j < 0 or k < 0 or i >= shape[0] or j >= shape[1] or k >= shape[2]:
            continue
        c = (i * shape[1] + j) * shape[2] + k
        if space.state[i, j, k] != WALL:
            result[q] = space.state[i, j, k] == INSIDE
            continue
        listed = space.wall[space.offset[c] : space.offset[c + 1]]
        x, y, z = points[q]
        n = crossings(space.triangle, listed, x, y, z, reference[c, 0], reference[c, 1], reference[c, 2])
        result[q] = (inside[c] + n) % 2 == 1
    return result
