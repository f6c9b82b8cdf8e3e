"""Compiled sweep behind :mod:`vascval.core.contraction`."""

import numpy as np

from vascval.core.jit import njit


@njit
def degenerate(parent, n_children, position, shortest):
    """Root first: which segments are shorter than ``shortest``, and where each segment springs from afterwards."""
    n = parent.size
    removed = np.zeros(n, np.bool_)
    proximal = parent.copy()
    for i in range(1, n):
        p = parent[i]
        if removed[p]:
            proximal[i] = proximal[p]
            p = proximal[p]
        if n_children[i] == 0 or (p == 0 and n_children[0] < 2 and proximal[i] == parent[i]):
            continue
        square = 0.0
        for k in range(3):
            square += (position[i, k] - position[p, k]) ** 2
        removed[i] = square < shortest[i] ** 2
    return removed, proximal
