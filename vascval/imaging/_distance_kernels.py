"""Compiled exact Euclidean distance map on a list of foreground voxels; see :mod:`vascval.imaging.distance`."""

import numpy as np

from vascval.core.jit import njit


@njit
def along_x(span, nx, spacing, square):
    """First pass: squared distance along x to the nearest background voxel of the row."""
    for k in range(span.shape[0] - 1):
        first, size = span[k, 1], span[k + 1, 2] - span[k, 2]
        for v in range(size):
            left = v + 1.0 if first > 0 else np.inf
            right = float(size - v) if first + size < nx else np.inf
            square[span[k, 2] + v] = (min(left, right) * spacing) ** 2


@njit
def envelope(order, place, begin, end, open_low, open_high, spacing, square, site, value, bound):
    """Lower envelope of parabolas over the voxels ``order[begin:end]``, a run on one line; its two ends are background
    unless open."""
    lowest = place[begin]
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
def along_lines(span, row_offset, n_planes, plane_step, n_rows, row_step, nx, spacing, square):
    """Pass along a further axis. Plane ``p`` consists of the rows ``p * plane_step + t * row_step``, ``t`` being the
    coordinate along the axis; its voxels are taken line by line in the order of x."""
    site = np.empty(n_rows + 2)
    value = np.empty(n_rows + 2)
    bound = np.empty(n_rows + 2)
    count = np.empty(nx + 1, np.int64)
    order, place = np.empty(1024, np.int64), np.empty(1024, np.int32)
    for plane in range(n_planes):
        count[:] = 0
        for t in range(n_rows):
            row = plane * plane_step + t * row_step
            for k in range(row_offset[row], row_offset[row + 1]):
                for x in range(span[k, 1], span[k, 1] + span[k + 1, 2] - span[k, 2]):
                    count[x + 1] += 1
        for x in range(nx):
            count[x + 1] += count[x]
        n = count[nx]
        if n > order.size:
            order, place = np.empty(2 * n, np.int64), np.empty(2 * n, np.int32)
        for t in range(n_rows):
            row = plane * plane_step + t * row_step
            for k in range(row_offset[row], row_offset[row + 1]):
                shift = span[k, 1] - span[k, 2]
                for i in range(span[k, 2], span[k + 1, 2]):
                    order[count[i + shift]] = i
                    place[count[i + shift]] = t
                    count[i + shift] += 1
        # count[x] is now where line x ends
        a = 0
        for x in range(nx):
            while a < count[x]:
                b = a + 1
                while b < count[x] and place[b] == place[b - 1] + 1:
                    b += 1
                open_low = place[a] == 0
                open_high = place[b - 1] == n_rows - 1
                envelope(order, place, a, b, open_low, open_high, spacing, square, site, value, bound)
                a = b
