"""Compiled walks over the foreground voxels: neighbours, geodesic distance, persistence of its maxima."""

import numpy as np

from vascval.core.jit import njit
from vascval.imaging._run_kernels import find


@njit
def neighbours(i, x, row, first, ny, out, code):
    """Write the foreground 26-neighbours of voxel ``i`` and their codes; return how many there are.

    The code is ``9 (dz + 1) + 3 (dy + 1) + (dx + 1)``; 13 would be the voxel itself.
    """
    n = 0
    xi = x[i]
    k = 0
    for q in range(9):
        if q == 4:
            if i > 0 and row[i - 1] == row[i] and x[i - 1] == xi - 1:
                out[n] = i - 1
                code[n] = 12
                n += 1
            if i + 1 < x.size and row[i + 1] == row[i] and x[i + 1] == xi + 1:
                out[n] = i + 1
                code[n] = 14
                n += 1
            continue
        j = first[i, k]
        k += 1
        if j < 0:
            continue
        target = row[i] + (q // 3 - 1) * ny + (q % 3 - 1)
        while j < x.size and row[j] == target and x[j] <= xi + 1:
            out[n] = j
            code[n] = 3 * q + x[j] - xi + 1
            n += 1
            j += 1
    return n


@njit
def geodesic(source, x, row, first, ny, step):
    """Shortest-path distance from a voxel through 26-neighbours, ``step`` (27,) being the length of each step.

    Dijkstra's algorithm with buckets no wider than the shortest step: within one bucket nothing can improve
    another, so the distances are exact.
    """
    n = x.size
    distance = np.full(n, np.inf)
    shortest = np.inf
    longest = 0.0
    for c in range(27):
        if c != 13:
            shortest = min(shortest, step[c])
            longest = max(longest, step[c])
    n_buckets = int(longest / shortest) + 3
    head = np.full(n_buckets, -1, np.int64)
    # a voxel is queued anew at each improvement; entries that a later one has overtaken are passed over
    entry, follow, key = np.empty(2 * n, np.int32), np.empty(2 * n, np.int64), np.empty(2 * n, np.int64)
    entry[0], follow[0], key[0] = source, -1, 0
    head[0] = 0
    used, waiting, bucket = 1, 1, 0
    distance[source] = 0.0
    out, code = np.empty(26, np.int64), np.empty(26, np.int64)
    while waiting > 0:
        slot = bucket % n_buckets
        e = head[slot]
        if e < 0:
            bucket += 1
            continue
        head[slot] = follow[e]
        waiting -= 1
        i = entry[e]
        if key[e] != int(distance[i] / shortest):
            continue
        for t in range(neighbours(i, x, row, first, ny, out, code)):
            j = out[t]
            d = distance[i] + step[code[t]]
            if d >= distance[j]:
                continue
            distance[j] = d
            if used == entry.size:
                entry = np.concatenate((entry, np.empty(used, np.int32)))
                follow = np.concatenate((follow, np.empty(used, np.int64)))
                key = np.concatenate((key, np.empty(used, np.int64)))
            slot = int(d / shortest) % n_buckets
            entry[used], follow[used], key[used] = j, head[slot], int(d / shortest)
            head[slot] = used
            used += 1
            waiting += 1
    return distance


@njit
def maxima(order, height, thickness, x, row, first, ny):
    """Local maxima of ``height`` and the saddles at which they are overtaken, by a sweep from high to low.

    :param order: voxels by descending height.
    :returns: for each maximum its voxel, the saddle's voxel (-1 for the highest of a component) and the largest
        ``thickness`` in what hung on it before the saddle.
    """
    n = order.size
    up = np.full(n, -1, np.int32)
    peak = np.empty(n, np.int32)
    thickest = np.empty(n)
    tip = np.empty(n, np.int32)
    saddle = np.empty(n, np.int32)
    widest = np.empty(n)
    count = 0
    out = np.empty(26, np.int64)
    code = np.empty(26, np.int64)
    for t in range(n):
        i = order[t]
        up[i] = i
        peak[i] = i
        thickest[i] = thickness[i]
        m = neighbours(i, x, row, first, ny, out, code)
        mine = i
        for s in range(m):
            j = out[s]
            if up[j] < 0:
                continue
            other = find(up, j)
            if other == mine:
                continue
            a, b = mine, other
            # keep the component of the higher peak; equal heights go to the smaller voxel number
            pa, pb = peak[a], peak[b]
            if height[pb] > height[pa] or (height[pb] == height[pa] and pb < pa):
                a, b = b, a
            if peak[b] != i:
                tip[count] = peak[b]
                saddle[count] = i
                widest[count] = thickest[b]
                count += 1
            up[b] = a
            thickest[a] = max(thickest[a], thickest[b])
            mine = a
    for i in range(n):
        if up[i] == i:
            tip[count] = peak[i]
            saddle[count] = -1
            widest[count] = thickest[i]
            count += 1
    return tip[:count].copy(), saddle[:count].copy(), widest[:count].copy()
