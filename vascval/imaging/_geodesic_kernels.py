"""Compiled walks over the foreground voxels: neighbours, geodesic distance, the nearest of them."""

import numpy as np

from vascval.core.jit import njit


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


TILE = 32
"""Rows and slices of a tile of :func:`geodesic`."""


@njit
def push(pool, head, slot, voxel, key, free):
    """Put an entry at the head of a list of the ``pool`` (voxel, key, next); returns the pool and its next free entry.

    ``free`` (2,) holds the first entry given back, or -1, and the number of entries ever used.
    """
    e = free[0]
    if e >= 0:
        free[0] = pool[e, 2]
    else:
        e = free[1]
        free[1] += 1
        if e == pool.shape[0]:
            pool = np.concatenate((pool, np.empty((e, 3), pool.dtype)))
    pool[e, 0], pool[e, 1], pool[e, 2] = voxel, key, head[slot]
    head[slot] = e
    return pool


@njit
def take_up(pool, later, tile, head, first, distance, shortest, free):
    """Move what waits in a tile to the buckets of this epoch, drop what is out of date; the first bucket in use."""
    low = head.size
    e, later[tile] = later[tile], -1
    while e >= 0:
        i, key, follow = pool[e]
        k = key - first
        if key != int(distance[i] / shortest):
            pool[e, 2], free[0] = free[0], e
        elif k < head.size:
            low = min(low, k)
            pool[e, 2], head[k] = head[k], e
        else:
            pool[e, 2], later[tile] = later[tile], e
        e = follow
    return low


@njit
def geodesic(source, lattice, step, width, distance):
    """Shortest-path distance from a voxel through 26-neighbours, ``step`` (27,) being the length of each step.

    The distances are settled epoch by epoch, each ``width`` mm farther; within an epoch, tile by tile of the (y, z)
    plane, which fits the cache where the front of a large tree does not; within a tile, in buckets no wider than the
    shortest step. A tile that a neighbour has brought nearer is taken up again. Nothing is left to improve at the
    end: the distances are those of Dijkstra's algorithm, whatever the tiles and the width.

    :param distance: (n,) infinite, is filled.
    """
    shortest = min(step[12], step[10], step[4])
    n_buckets = int(width / shortest) + 2
    ny = lattice.ny
    tiles_y = (ny - 1) // TILE + 1
    n_tiles = tiles_y * ((lattice.span[:-1, 0].max() // ny) // TILE + 1)
    later, head = np.full(n_tiles, -1, np.int32), np.full(n_buckets, -1, np.int32)
    is_due = np.zeros(n_tiles, np.bool_)
    due, n_due = np.empty(n_tiles, np.int32), 0
    pool, free = np.empty((1024, 3), np.int32), np.array([-1, 0])
    out, code = np.empty(26, np.int64), np.empty(26, np.int64)
    row = lattice.span[lattice.run[source], 0]
    pool = push(pool, later, row // ny // TILE * tiles_y + row % ny // TILE, source, 0, free)
    distance[source] = 0.0
    first = 0
    while True:
        # keys count from the beginning of the epoch's first bucket
        for tile in range(n_tiles):
            if later[tile] >= 0:
                due[n_due], is_due[tile] = tile, True
                n_due += 1
        if n_due == 0:
            return
        last = first + n_buckets
        while n_due > 0:
            n_due -= 1
            tile = due[n_due]
            is_due[tile] = False
            for bucket in range(take_up(pool, later, tile, head, first, distance, shortest, free), n_buckets):
                while head[bucket] >= 0:
                    e = head[bucket]
                    i, key, head[bucket] = pool[e]
                    pool[e, 2], free[0] = free[0], e
                    if key != int(distance[i] / shortest):
                        continue
                    row = lattice.span[lattice.run[i], 0]
                    y, z = row % ny, row // ny
                    for t in range(neighbours(i, lattice, out, code)):
                        j, c = out[t], code[t]
                        d = distance[i] + step[c]
                        if d >= distance[j]:
                            continue
                        distance[j] = d
                        key = int(d / shortest)
                        there = (z + c // 9 - 1) // TILE * tiles_y + (y + c // 3 % 3 - 1) // TILE
                        if there == tile and key < last:
                            pool = push(pool, head, key - first, j, key, free)
                            continue
                        pool = push(pool, later, there, j, key, free)
                        if key < last and not is_due[there] and there != tile:
                            due[n_due], is_due[there] = there, True
                            n_due += 1
        first = last
