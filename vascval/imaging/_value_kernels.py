"""Compiled passes over the values of a volume; see :mod:`vascval.imaging.selection`."""

import numpy as np

from vascval.core.jit import njit


@njit
def distinct(block, found, n):
    """Enter the values of a block (dz, dy, nx) into ``found``, of which ``n`` are there already, ascending.

    :returns: how many there are now; -1 as soon as they do not fit.
    """
    last = -1
    for plane in block:
        for row in plane:
            for value in row:
                if last >= 0 and found[last] == value:
                    continue
                k = np.searchsorted(found[:n], value)
                if k == n or found[k] != value:
                    if n == found.size:
                        return -1
                    for j in range(n, k, -1):
                        found[j] = found[j - 1]
                    found[k] = value
                    n += 1
                last = k
    return n
