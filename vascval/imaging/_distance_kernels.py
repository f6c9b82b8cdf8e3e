"""Compiled exact Euclidean distance map on a list of foreground voxels; see :mod:`vascval.imaging.distance`."""

import numpy as np

from vascval.core.jit import njit


@njit
def along_x(offset, x, nx, spacing, square):
    """First pass: squared distance along x to the nearest background voxel of the row."""
    for row in range(offset.size - 1):
        a = offset[row]
        while a < offset[row + 1]:
            b = a
            while b + 1 < offset[row + 1] and x[b + 1] == x[b] + 1:
                b += 1
            for i in range(a, b + 1):
                left = x[i] - x[a] + 1.0 if x[a] > 0 else np.inf
                right = x[b] - x[i] + 1.0 if x[b] < nx - 1 else np.inf
                square[i] = (min(left, right) * spacing) ** 2
            a = b + 1


@njit
def envelope(order, place, begin, end, open_low, open_high, spacing, square, site, value, bound):
    """Lower envelope of parabolas over one run ``order[begin:end]``; the run's two ends are background unless open."""
    lowest = place[order[begin]]
    m = end - begin
    if open_low and open_high:
        any_finite = False
        for t in range(m):
            if square[order[begin + t]] < np.inf:
                any_finite = True
        if not any_finite:
            return
    top = -1
    for t in range(-1, m + 1):
        if t == -1:
            if open_low:
                continue
            f = 0.0
        elif t == m:
            if open_high:
                continue
            f = 0.0
        else:
            f = square[order[begin + t]]
            if f == np.inf:
                continue
        q = (lowest + t) * spacing
        crossing = -np.inf
        while top >= 0:
            p = site[top]
            crossing = ((f + q * q) - (value[top] + p * p)) / (2.0 * (q - p))
            if crossing > bound[top]:
                break
            top -= 1
        if top < 0:
            crossing = -np.inf
        top += 1
        site[top] = q
        value[top] = f
        bound[top] = crossing
    k = 0
    for t in range(m):
        q = (lowest + t) * spacing
        while k < top and bound[k + 1] <= q:
            k += 1
        square[order[begin + t]] = value[k] + (q - site[k]) ** 2


@njit
def along_lines(order, line, place, size, spacing, square):
    """Pass along a further axis: ``order`` lists the voxels line by line, ``place`` is the coordinate on the line."""
    site = np.empty(size + 2)
    value = np.empty(size + 2)
    bound = np.empty(size + 2)
    a = 0
    while a < order.size:
        b = a + 1
        while b < order.size and line[order[b]] == line[order[a]] and place[order[b]] == place[order[b - 1]] + 1:
            b += 1
        open_low = place[order[a]] == 0
        open_high = place[order[b - 1]] == size - 1
        envelope(order, place, a, b, open_low, open_high, spacing, square, site, value, bound)
        a = b


@njit
def counting_order(key, n_keys):
    """Stable order by key."""
    count = np.zeros(n_keys + 1, np.int64)
    for i in range(key.size):
        count[key[i] + 1] += 1
    for k in range(n_keys):
        count[k + 1] += count[k]
    order = np.empty(key.size, np.int32)
    for i in range(key.size):
        order[count[key[i]]] = i
        count[key[i]] += 1
    return order


@njit
def order_within_slices(offset, x, ny, nz, nx):
    """Voxels of each slice ordered by x, then y."""
    order = np.empty(x.size, np.int32)
    count = np.zeros(nx + 1, np.int64)
    for z in range(nz):
        a, b = offset[z * ny], offset[(z + 1) * ny]
        if a == b:
            continue
        count[:] = 0
        for i in range(a, b):
            count[x[i] + 1] += 1
        for k in range(nx):
            count[k + 1] += count[k]
        for i in range(a, b):
            order[a + count[x[i]]] = i
            count[x[i]] += 1
    return order
