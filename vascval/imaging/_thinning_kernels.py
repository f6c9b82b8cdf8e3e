"""Compiled homotopic thinning of a list of voxels towards given anchors; see :mod:`vascval.imaging.thinning`."""

import numpy as np

from vascval.core.jit import njit
from vascval.imaging._geodesic_kernels import neighbours


@njit
def adjacency_masks():
    """Bit masks of who touches whom among the 27 places: 26-adjacency, and 6-adjacency within the 18-neighbourhood."""
    near26 = np.zeros(27, np.int64)
    near6 = np.zeros(27, np.int64)
    for a in range(27):
        az, ay, ax = a // 9 - 1, (a // 3) % 3 - 1, a % 3 - 1
        for b in range(27):
            if a == b or a == 13 or b == 13:
                continue
            bz, by, bx = b // 9 - 1, (b // 3) % 3 - 1, b % 3 - 1
            dz, dy, dx = abs(az - bz), abs(ay - by), abs(ax - bx)
            if max(dz, max(dy, dx)) == 1:
                near26[a] |= 1 << b
            within = abs(az) + abs(ay) + abs(ax) <= 2 and abs(bz) + abs(by) + abs(bx) <= 2
            if dz + dy + dx == 1 and within:
                near6[a] |= 1 << b
    return near26, near6


@njit
def flood(mask, seed, near):
    """The part of ``mask`` that is connected to its bit ``seed`` (the bit itself, not its number)."""
    part = fringe = seed
    while fringe and part != mask:
        k = 0
        while (fringe >> k) & 1 == 0:
            k += 1
        fringe &= fringe - 1
        new = near[k] & mask & ~part
        part |= new
        fringe |= new
    return part


@njit
def is_one_piece(mask, near26):
    """Whether the places in ``mask`` are one 26-component."""
    return mask != 0 and flood(mask, mask & -mask, near26) == mask


STEPS = np.abs(np.arange(27) // 9 - 1) + np.abs(np.arange(27) // 3 % 3 - 1) + np.abs(np.arange(27) % 3 - 1)
EIGHTEEN = int(((STEPS > 0) & (STEPS <= 2)) @ (1 << np.arange(27)))
FACES = int((STEPS == 1) @ (1 << np.arange(27)))


@njit
def is_simple(mask, near26, near6):
    """Can the voxel go without a change of topology? ``mask`` holds its foreground 26-neighbours by code.

    Bertrand and Malandain (1994): one 26-component of foreground among the 26 neighbours, and one 6-component of
    background among the 18 neighbours that touches the voxel by a face.
    """
    background = EIGHTEEN & ~mask
    open_faces = FACES & ~mask
    if open_faces == 0 or open_faces & ~flood(background, open_faces & -open_faces, near6):
        return False
    return is_one_piece(mask, near26)


@njit
def level_of(thickness, scale):
    """Whole levels of thickness; infinite ones (no background anywhere) are of level 0."""
    return int(thickness * scale) if thickness < np.inf else 0


@njit
def thin(thickness, scale, anchor, lattice):
    """Remove simple voxels level by level (lowest first) until none but anchors could go.

    The level of a voxel is its ``thickness`` times ``scale`` (:func:`level_of`). Within a level voxels are taken first
    in, first out, so that a vessel is eroded from all sides alike. A voxel that could not go is tried again whenever
    one of its neighbours has gone.

    :param anchor: (n,) bool.
    :returns: (n,) bool, which voxels are left.
    """
    n = thickness.size
    near26, near6 = adjacency_masks()
    n_levels = 1
    for i in range(n):
        n_levels = max(n_levels, level_of(thickness[i], scale) + 1)
    alive = np.ones(n, np.bool_)
    queued = np.ones(n, np.bool_)
    head = np.full(n_levels, -1, np.int32)
    tail = np.full(n_levels, -1, np.int32)
    follow = np.full(n, -1, np.int32)
    for i in range(n):
        if anchor[i]:
            queued[i] = False
            continue
        k = level_of(thickness[i], scale)
        if head[k] < 0:
            head[k] = i
        else:
            follow[tail[k]] = i
        tail[k] = i
    out = np.empty(26, np.int64)
    code = np.empty(26, np.int64)
    current = 0
    while current < n_levels:
        i = head[current]
        if i < 0:
            current += 1
            continue
        head[current] = follow[i]
        follow[i] = -1
        queued[i] = False
        m = neighbours(i, lattice, out, code)
        mask = 0
        for t in range(m):
            if alive[out[t]]:
                mask |= 1 << code[t]
        if not is_simple(mask, near26, near6):
            continue
        alive[i] = False
        for t in range(m):
            j = out[t]
            if alive[j] and not queued[j] and not anchor[j]:
                k = max(level_of(thickness[j], scale), current)
                queued[j] = True
                if head[k] < 0:
                    head[k] = j
                else:
                    follow[tail[k]] = j
                tail[k] = j
    return alive
