"""Compiled search for vessels that run through each other, behind :mod:`generator.geometry.admission`."""

import numpy as np

from vascval.core.borrowing import borrowing
from vascval.core.jit import njit


@borrowing
def square_between(a, b, c, d):
    """Square of the distance between the segments from ``a`` to ``b`` and from ``c`` to ``d``.

    It is a convex quadratic in the two parameters: the minimum over one, clamped, is put into the other and back.
    """
    uu, vv, uv, uw, vw = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        u, v, w = b[k] - a[k], d[k] - c[k], a[k] - c[k]
        uu += u * u
        vv += v * v
        uv += u * v
        uw += u * w
        vw += v * w
    det = uu * vv - uv * uv
    s = 0.0
    if det > 1e-12 * uu * vv:
        s = min(max((uv * vw - vv * uw) / det, 0.0), 1.0)
    t = min(max((uv * s + vw) / vv, 0.0), 1.0) if vv > 0.0 else 0.0
    if uu > 0.0:
        s = min(max((uv * t - uw) / uu, 0.0), 1.0)
    total = 0.0
    for k in range(3):
        total += (a[k] - c[k] + s * (b[k] - a[k]) - t * (d[k] - c[k])) ** 2
    return total


@borrowing
def mark_overlapping(parent, position, radius, margin, order, low, high, marked):
    """Mark the segments that come closer than ``margin`` times the sum of radii to one with which they share no node.

    :param order: segments by their lowest x; ``low``, ``high`` (N, 3) boxes around them, widened by their radii.
    """
    for a in range(order.size):
        i = order[a]
        p = parent[i]
        for b in range(a + 1, order.size):
            j = order[b]
            if low[j, 0] > high[i, 0]:
                break
            if low[j, 1] > high[i, 1] or high[j, 1] < low[i, 1] or low[j, 2] > high[i, 2] or high[j, 2] < low[i, 2]:
                continue
            q = parent[j]
            if p == q:
                continue
            if p == j or q == i:
                continue
            reach = margin * (radius[i] + radius[j])
            if square_between(position[p], position[i], position[q], position[j]) < reach * reach:
                marked[i] = True
                marked[j] = True


@njit
def heirs(parent, removed):
    """(N,) for each node the node that it is merged into when the segments ``removed`` vanish."""
    heir = np.arange(parent.size)
    for i in range(1, parent.size):
        if removed[i]:
            heir[i] = heir[parent[i]]
    return heir
