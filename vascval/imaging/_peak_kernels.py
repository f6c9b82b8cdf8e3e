"""Compiled persistence of the local maxima of a height on the foreground voxels; see :mod:`vascval.imaging.tips`.

Throughout, voxels come from high to low, of equal ones the smaller number first. A sweep in that order would visit the
whole volume again and again. But where the higher neighbours of a voxel hang together, nothing begins or meets: only
the others, the *events*, are swept, and every voxel belongs to the event to which its way up leads.
"""

import numpy as np

from vascval.core.jit import njit
from vascval.imaging._geodesic_kernels import neighbours
from vascval.imaging._run_kernels import find
from vascval.imaging._thinning_kernels import is_one_piece


@njit
def above(height, j, i):
    return height[j] > height[i] or (height[j] == height[i] and j < i)


@njit
def find_events(height, lattice, near26, up):
    """Write to ``up`` the highest neighbour of each voxel, or -1 where it is an event; returns the events."""
    event, n = np.empty(1024, np.int32), 0
    out, code = np.empty(26, np.int64), np.empty(26, np.int64)
    for i in range(height.size):
        m = neighbours(i, lattice, out, code)
        mask, highest = 0, i
        for t in range(m):
            if above(height, out[t], i):
                mask |= 1 << code[t]
                if above(height, out[t], highest):
                    highest = out[t]
        if is_one_piece(mask, near26):
            up[i] = highest
            continue
        up[i] = -1
        if n == event.size:
            event = np.concatenate((event, np.empty(n, np.int32)))
        event[n] = i
        n += 1
    return event[:n].copy()


@njit
def name_events(event, up):
    """The number of its event instead of each voxel's way ``up``."""
    for k in range(event.size):
        up[event[k]] = -1 - k
    for i in range(up.size):
        j = i
        while up[j] >= 0:
            j = up[j]
        name, j = up[j], i
        while up[j] >= 0:
            up[j], j = name, up[j]
    for i in range(up.size):
        up[i] = -1 - up[i]


@njit
def sweep(event, height, lattice, of_voxel):
    """Which events are overtaken where: for each the event at which its highest place meets a higher one, and that
    higher one (-1 if none does); and those that are overtaken, in order.

    :param event: voxels of the events in order; ``of_voxel`` (n,) the number of each voxel's event.
    """
    n = event.size
    part = np.arange(n).astype(np.int32)
    saddle, over = np.full(n, -1, np.int32), np.full(n, -1, np.int32)
    done, n_done = np.empty(n, np.int32), 0
    out, code = np.empty(26, np.int64), np.empty(26, np.int64)
    for k in range(n):
        mine = k
        for t in range(neighbours(event[k], lattice, out, code)):
            if not above(height, out[t], event[k]):
                continue
            other = find(part, of_voxel[out[t]])
            if other == mine:
                continue
            mine, lost = min(mine, other), max(mine, other)
            part[lost], over[lost], saddle[lost] = mine, mine, k
            done[n_done] = lost
            n_done += 1
    return saddle, over, done[:n_done].copy()


@njit
def most_above(value, event, height, of_voxel, saddle, over, done):
    """For each event the largest ``value`` of what hangs on it before it is overtaken."""
    most = value[event]
    for i in range(of_voxel.size):
        k = of_voxel[i]
        while saddle[k] >= 0 and above(height, event[saddle[k]], i):
            k = over[k]
        most[k] = max(most[k], value[i])
    for k in done:
        most[over[k]] = max(most[over[k]], most[k])
    return most
