"""Compiled passes over runs of foreground voxels along x; see :mod:`vascval.imaging.runs`."""

import numpy as np

from vascval.core.jit import njit


@njit
def count_runs(slab):
    """Number of runs of non-zero voxels in each row of a (ny, nx) slab."""
    ny, nx = slab.shape
    count = np.zeros(ny, np.int64)
    for y in range(ny):
        inside = False
        for x in range(nx):
            on = slab[y, x] != 0
            if on and not inside:
                count[y] += 1
            inside = on
    return count


@njit
def write_runs(slab, start, stop):
    """Fill ``start`` and ``stop`` (exclusive) with the runs of a slab, row by row."""
    ny, nx = slab.shape
    k = 0
    for y in range(ny):
        inside = False
        for x in range(nx):
            on = slab[y, x] != 0
            if on and not inside:
                start[k] = x
            elif inside and not on:
                stop[k] = x
                k += 1
            inside = on
        if inside:
            stop[k] = nx
            k += 1


@njit
def find(up, i):
    root = i
    while up[root] != root:
        root = up[root]
    while up[i] != root:
        up[i], i = root, up[i]
    return root


@njit
def link_rows(up, start, stop, a, a_end, b, b_end, reach):
    """Unite the runs of one row with those of another that overlap when widened by ``reach``."""
    while a < a_end and b < b_end:
        if start[a] < stop[b] + reach and start[b] < stop[a] + reach:
            ra, rb = find(up, a), find(up, b)
            if ra < rb:
                up[rb] = ra
            elif rb < ra:
                up[ra] = rb
        if stop[a] < stop[b]:
            a += 1
        else:
            b += 1


@njit
def components(row_offset, start, stop, ny, nz, full):
    """Label of the component of each run: 26-connected if ``full``, else 6-connected; labels are first run indices."""
    up = np.arange(start.size)
    reach = 1 if full else 0
    for z in range(nz):
        for y in range(ny):
            row = z * ny + y
            a, a_end = row_offset[row], row_offset[row + 1]
            if a == a_end:
                continue
            for dz in range(-1, 1):
                for dy in range(-1, 2):
                    before = dz < 0 or dy < 0
                    straight = dz == 0 or dy == 0
                    if not before or not (full or straight):
                        continue
                    if z + dz < 0 or y + dy < 0 or y + dy >= ny:
                        continue
                    other = (z + dz) * ny + y + dy
                    link_rows(up, start, stop, a, a_end, row_offset[other], row_offset[other + 1], reach)
    for i in range(start.size):
        up[i] = find(up, i)
    return up


@njit
def background_runs(row_offset, start, stop, nx):
    """The runs of background: row offsets, starts and stops."""
    n_rows = row_offset.size - 1
    offset = np.zeros(n_rows + 1, np.int64)
    for row in range(n_rows):
        x, count = 0, 0
        for k in range(row_offset[row], row_offset[row + 1]):
            if start[k] > x:
                count += 1
            x = stop[k]
        if x < nx:
            count += 1
        offset[row + 1] = offset[row] + count
    begin = np.empty(offset[-1], np.int32)
    end = np.empty(offset[-1], np.int32)
    i = 0
    for row in range(n_rows):
        x = 0
        for k in range(row_offset[row], row_offset[row + 1]):
            if start[k] > x:
                begin[i] = x
                end[i] = start[k]
                i += 1
            x = stop[k]
        if x < nx:
            begin[i] = x
            end[i] = nx
            i += 1
    return offset, begin, end


@njit
def touches_border(label, row_offset, start, stop, nx, ny, nz):
    """For each run label: does the component reach the border of the volume?"""
    reached = np.zeros(label.size, np.bool_)
    for row in range(row_offset.size - 1):
        y, z = row % ny, row // ny
        edge = y == 0 or z == 0 or y == ny - 1 or z == nz - 1
        for k in range(row_offset[row], row_offset[row + 1]):
            if edge or start[k] == 0 or stop[k] == nx:
                reached[label[k]] = True
    return reached


@njit
def merge_runs(row_offset, start, stop, more_offset, more_start, more_stop):
    """Union of two sets of runs, adjacent and overlapping ones joined."""
    n_rows = row_offset.size - 1
    offset = np.zeros(n_rows + 1, np.int64)
    begin = np.empty(start.size + more_start.size, np.int32)
    end = np.empty(start.size + more_start.size, np.int32)
    n = 0
    for row in range(n_rows):
        a, b = row_offset[row], more_offset[row]
        first = n
        while a < row_offset[row + 1] or b < more_offset[row + 1]:
            if b >= more_offset[row + 1] or (a < row_offset[row + 1] and start[a] < more_start[b]):
                s, e = start[a], stop[a]
                a += 1
            else:
                s, e = more_start[b], more_stop[b]
                b += 1
            if n > first and end[n - 1] >= s:
                end[n - 1] = max(end[n - 1], e)
            else:
                begin[n] = s
                end[n] = e
                n += 1
        offset[row + 1] = n
    return offset, begin[:n].copy(), end[:n].copy()


@njit
def expand(row_offset, start, stop):
    """Voxel list of the runs: row offsets in voxels, the x index and the row of each voxel."""
    n_rows = row_offset.size - 1
    offset = np.zeros(n_rows + 1, np.int64)
    for row in range(n_rows):
        total = offset[row]
        for k in range(row_offset[row], row_offset[row + 1]):
            total += stop[k] - start[k]
        offset[row + 1] = total
    x = np.empty(offset[-1], np.int32)
    of_row = np.empty(offset[-1], np.int32)
    i = 0
    for row in range(n_rows):
        for k in range(row_offset[row], row_offset[row + 1]):
            for v in range(start[k], stop[k]):
                x[i] = v
                of_row[i] = row
                i += 1
    return offset, x, of_row


@njit
def neighbour_rows(offset, x, of_row, ny, nz):
    """(n, 8) for each voxel and each of its eight neighbour rows, where that row reaches x - 1; -1 outside."""
    n = x.size
    first = np.full((n, 8), -1, np.int32)
    n_rows = offset.size - 1
    for row in range(n_rows):
        a, a_end = offset[row], offset[row + 1]
        if a == a_end:
            continue
        y, z = row % ny, row // ny
        k = 0
        for dz in range(-1, 2):
            for dy in range(-1, 2):
                if dz == 0 and dy == 0:
                    continue
                if 0 <= y + dy < ny and 0 <= z + dz < nz:
                    other = row + dz * ny + dy
                    j, j_end = offset[other], offset[other + 1]
                    for i in range(a, a_end):
                        while j < j_end and x[j] < x[i] - 1:
                            j += 1
                        first[i, k] = j
                k += 1
    return first
