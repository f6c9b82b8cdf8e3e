"""Compiled walks over the foreground voxels: neighbours, geodesic distance, persistence of its maxima."""

import numpy as np

from vascval.core.jit import njit
from vascval.imaging._run_kernels import find


@njit
def neighbours(i, lattice, out, code):
    """Write the foreground 26-neighbours of voxel ``i`` and their codes; return how many there are.

    The code is ``9 (dz + 1) + 3 (dy + 1) + (dx + 1)``; 13 would be the voxel itself.
    """
    span, ny = lattice.span, lattice.ny
    k = lattice.run[i]
    row = span[k, 0]
    x = span[k, 1] + i - span[k, 2]
    n = 0
    slot = 0
    for q in range(9):
        if q == 4:
            if i > span[k, 2]:
                out[n] = i - 1
                code[n] = 12
                n += 1
            if i + 1 < span[k + 1, 2]:
                out[n] = i + 1
                code[n] = 14
                n += 1
            continue
        j = lattice.link[k, slot]
        slot += 1
        if j < 0:
            continue
        target = row + (q // 3 - 1) * ny + (q % 3 - 1)
        while span[j, 0] == target and span[j, 1] <= x + 1:
            shift = span[j, 2] - span[j, 1]
            last = min(x + 1, span[j + 1, 2] - 1 - shift)
            for v in range(max(x - 1, span[j, 1]), last + 1):
                out[n] = v + shift
                code[n] = 3 * q + v - x + 1
                n += 1
            j += 1
    return n


@njit
def nearest_voxel(point, lattice, spacing):
    """The voxel nearest to a point (x, y, z in mm along the axes of the grid), and how far it is."""
    nearest, least = -1, np.inf
    for r in range(lattice.link.shape[0]):
        row, x, begin = lattice.span[r]
        y, z = row % lattice.ny, row // lattice.ny
        across = (y * spacing[1] - point[1]) ** 2 + (z * spacing[2] - point[2]) ** 2
        if across >= least:
            continue
        for i in range(begin, lattice.span[r + 1, 2]):
            square = ((x + i - begin) * spacing[0] - point[0]) ** 2 + across
            if square < least:
                nearest, least = i, square
    return nearest, np.sqrt(least)


@njit
def geodesic(source, lattice, step):
    """Shortest-path distance from a voxel through 26-neighbours, ``step`` (27,) being the length of each step.

    Dijkstra's algorithm with buckets no wider than the shortest step: within one bucket nothing can improve
    another, so the distances are exact. The queue is as long as the front is wide.
    """
    distance = np.full(lattice.run.size, np.inf)
    shortest = np.inf
    longest = 0.0
    for c in range(27):
        if c != 13:
            shortest = min(shortest, step[c])
            longest = max(longest, step[c])
    n_buckets = int(longest / shortest) + 3
    head = np.full(n_buckets, -1, np.int64)
    # a voxel is queued anew at each improvement; entries that a later one has overtaken are passed over
    entry, follow, key = np.empty(1024, np.int32), np.empty(1024, np.int64), np.empty(1024, np.int64)
    entry[0], follow[0], key[0] = source, -1, 0
    head[0] = 0
    used, free, waiting, bucket = 1, -1, 1, 0
    distance[source] = 0.0
    out, code = np.empty(26, np.int64), np.empty(26, np.int64)
    while waiting > 0:
        slot = bucket % n_buckets
        e = head[slot]
        if e < 0:
            bucket += 1
            continue
        head[slot] = follow[e]
        follow[e] = free
        free = e
        waiting -= 1
        i = entry[e]
        if key[e] != int(distance[i] / shortest):
            continue
        for t in range(neighbours(i, lattice, out, code)):
            j = out[t]
            d = distance[i] + step[code[t]]
            if d >= distance[j]:
                continue
            distance[j] = d
            if free < 0:
                if used == entry.size:
                    entry = np.concatenate((entry, np.empty(used, np.int32)))
                    follow = np.concatenate((follow, np.empty(used, np.int64)))
                    key = np.concatenate((key, np.empty(used, np.int64)))
                follow[used] = -1
                free = used
                used += 1
            e = free
            free = follow[e]
            k = int(d / shortest)
            slot = k % n_buckets
            entry[e], follow[e], key[e] = j, head[slot], k
            head[slot] = e
            waiting += 1
    return distance


@njit
def bin_of(height, top, scale, n_bins):
    return 0 if height >= top else min(n_bins - 1, int((top - height) * scale))


@njit
def descending(height):
    """(n,) int32, the order from high to low, the smaller number first among equals: sorted in bins of height."""
    n = height.size
    n_bins = n // 16 + 1
    top, low = -np.inf, np.inf
    for h in height:
        if h < np.inf:
            top, low = max(top, h), min(low, h)
    scale = n_bins / (top - low) if top > low else 0.0
    end = np.zeros(n_bins, np.int64)
    for h in height:
        end[bin_of(h, top, scale, n_bins)] += 1
    for k in range(1, n_bins):
        end[k] += end[k - 1]
    order = np.empty(n, np.int32)
    for i in range(n - 1, -1, -1):
        k = bin_of(height[i], top, scale, n_bins)
        end[k] -= 1
        order[end[k]] = i
    for k in range(n_bins):
        a = end[k]
        b = end[k + 1] if k + 1 < n_bins else n
        if b - a > 1:
            own = order[a:b].copy()
            order[a:b] = own[np.argsort(-height[own], kind="mergesort")]
    return order


@njit
def maxima(order, height, thickness, lattice):
    """Local maxima of ``height`` and the saddles at which they are overtaken, by a sweep from high to low.

    :param order: voxels by descending height, the smaller number first among equals.
    :returns: for each maximum its voxel, the saddle's voxel (-1 for the highest of a component) and the largest
        ``thickness`` in what hung on it before the saddle.
    """
    n = order.size
    # the root of each component is its peak, which the sweep reached first
    up = np.full(n, -1, np.int32)
    thickest = np.empty(n, np.int32)
    tip, saddle, widest = np.empty(1024, np.int32), np.empty(1024, np.int32), np.empty(1024)
    count = 0
    out = np.empty(26, np.int64)
    code = np.empty(26, np.int64)
    for t in range(n):
        i = order[t]
        up[i] = i
        thickest[i] = i
        m = neighbours(i, lattice, out, code)
        mine = i
        for s in range(m):
            j = out[s]
            if up[j] < 0:
                continue
            other = find(up, j)
            if other == mine:
                continue
            a, b = mine, other
            # keep the higher peak; equal heights go to the smaller voxel number
            if height[b] > height[a] or (height[b] == height[a] and b < a):
                a, b = b, a
            if b != i:
                if count == tip.size:
                    tip = np.concatenate((tip, np.empty(count, np.int32)))
                    saddle = np.concatenate((saddle, np.empty(count, np.int32)))
                    widest = np.concatenate((widest, np.empty(count)))
                tip[count] = b
                saddle[count] = i
                widest[count] = thickness[thickest[b]]
                count += 1
            up[b] = a
            if thickness[thickest[b]] > thickness[thickest[a]]:
                thickest[a] = thickest[b]
            mine = a
    n_alone = 0
    for i in range(n):
        n_alone += up[i] == i
    alone = np.empty(n_alone, np.int64)
    n_alone = 0
    for i in range(n):
        if up[i] == i:
            alone[n_alone] = i
            n_alone += 1
    tip = np.concatenate((tip[:count], alone.astype(np.int32)))
    saddle = np.concatenate((saddle[:count], np.full(alone.size, -1, np.int32)))
    return tip, saddle, np.concatenate((widest[:count], thickness[thickest[alone]]))
