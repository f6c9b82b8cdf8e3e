"""Compiled sweep behind :mod:`vascval.comparison.territories`."""

import numpy as np

from vascval.core.jit import njit


@njit
def subtree_roots(parent, generation, first):
    """(N,) for each segment the first one on its path from the root of generation ``first`` or later; -1 before it."""
    result = np.full(parent.size, -1, np.int64)
    for i in range(1, parent.size):
        if result[parent[i]] >= 0:
            result[i] = result[parent[i]]
        elif generation[i] >= first:
            result[i] = i
    return result
