"""Compiled passes over runs of foreground voxels along x; see :mod:`vascval.imaging.runs`."""

import numpy as np

from vascval.core.jit import njit


@njit
def find_runs(block, count, start, stop):
    """Number of runs of non-zero voxels in each row of a block (nz, ny, nx), and the runs one after another.

    :param count: (nz, ny), written.
    :param start: with ``stop`` (exclusive), written; they have room for ``(nx + 1) // 2`` runs of each row.
    :returns: how many runs there are.
    """
    nz, ny, nx = block.shape
    n = 0
    for z in range(nz):
        for y in range(ny):
            first = n
            x = 0
            while x < nx:
                while x < nx and block[z, y, x] == 0:
                    x += 1
                if x == nx:
                    break
                start[n] = x
                while x < nx and block[z, y, x] != 0:
                    x += 1
                stop[n] = x
                n += 1
            count[z, y] = n - first
    return n


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
    up = np.arange(start.size).astype(np.int32)
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
def numbered(first, start, stop):
    """The labels of :func:`components` as numbers from 0 in the order of first runs, and each component's voxels."""
    n = 0
    for i in range(first.size):
        n += first[i] == i
    label = np.empty(first.size, np.int32)
    size = np.zeros(n, np.int64)
    n = 0
    for i in range(first.size):
        if first[i] == i:
            label[i] = n
            n += 1
        else:
            label[i] = label[first[i]]
        size[label[i]] += stop[i] - start[i]
    return label, size


@njit
def keep_runs(row_offset, start, stop, label, wanted):
    """The runs whose ``label`` is ``wanted`` (a boolean for each label): row offsets, starts and stops."""
    offset = np.zeros(row_offset.size, np.int64)
    n = 0
    for row in range(row_offset.size - 1):
        for k in range(row_offset[row], row_offset[row + 1]):
            n += wanted[label[k]]
        offset[row + 1] = n
    begin, end = np.empty(n, np.int32), np.empty(n, np.int32)
    n = 0
    for k in range(start.size):
        if wanted[label[k]]:
            begin[n], end[n] = start[k], stop[k]
            n += 1
    return offset, begin, end


@njit
def boxes(row_offset, start, stop, label, wanted, ny):
    """(n_labels, 2, 3) the first and last x, y, z of each wanted component; others are left empty (first > last)."""
    box = np.empty((wanted.size, 2, 3), np.int64)
    box[:, 0] = 2**62
    box[:, 1] = -1
    for row in range(row_offset.size - 1):
        y, z = row % ny, row // ny
        for k in range(row_offset[row], row_offset[row + 1]):
            c = label[k]
            if wanted[c]:
                box[c, 0, 0], box[c, 1, 0] = min(box[c, 0, 0], start[k]), max(box[c, 1, 0], stop[k] - 1)
                box[c, 0, 1], box[c, 1, 1] = min(box[c, 0, 1], y), max(box[c, 1, 1], y)
                box[c, 0, 2], box[c, 1, 2] = min(box[c, 0, 2], z), max(box[c, 1, 2], z)
    return box


@njit
def crop_runs(row_offset, start, stop, label, wanted, ny, low, high):
    """The parts of the runs labelled ``wanted`` (one number) in the box from ``low`` to before ``high`` (x, y, z)."""
    size_y, size_z = high[1] - low[1], high[2] - low[2]
    offset = np.zeros(size_y * size_z + 1, np.int64)
    begin, end = np.empty(64, np.int32), np.empty(64, np.int32)
    n = 0
    for z in range(size_z):
        for y in range(size_y):
            row = (z + low[2]) * ny + y + low[1]
            for k in range(row_offset[row], row_offset[row + 1]):
                a, b = max(start[k], low[0]), min(stop[k], high[0])
                if label[k] == wanted and a < b:
                    if n == begin.size:
                        begin = np.concatenate((begin, np.empty(n, np.int32)))
                        end = np.concatenate((end, np.empty(n, np.int32)))
                    begin[n], end[n] = a - low[0], b - low[0]
                    n += 1
            offset[z * size_y + y + 1] = n
    return offset, begin[:n].copy(), end[:n].copy()


@njit
def paint(row_offset, start, stop, ny, low, block, image):
    """Set the blocks of ``image`` (z, y, x), whose first voxel is at ``low`` (x, y, z), that the runs touch."""
    for row in range(row_offset.size - 1):
        y, z = (row % ny - low[1]) // block, (row // ny - low[2]) // block
        for k in range(row_offset[row], row_offset[row + 1]):
            image[z, y, (start[k] - low[0]) // block : (stop[k] - 1 - low[0]) // block + 1] = 1


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
def touches_border(label, n_labels, row_offset, start, stop, nx, ny, nz):
    """For each label: does the component reach the border of the volume?"""
    reached = np.zeros(n_labels, np.bool_)
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
def spans(row_offset, start, stop, span, run):
    """Write ``span`` and ``run`` of :class:`vascval.imaging.voxels.Lattice`."""
    n_rows = row_offset.size - 1
    n = 0
    for row in range(n_rows):
        for k in range(row_offset[row], row_offset[row + 1]):
            span[k, 0] = row
            span[k, 1] = start[k]
            span[k, 2] = n
            n += stop[k] - start[k]
    span[start.size, 0] = -1
    span[start.size, 1] = 0
    span[start.size, 2] = n
    for k in range(start.size):
        run[span[k, 2] : span[k + 1, 2]] = k


@njit
def links(row_offset, start, stop, ny, nz, link):
    """Write to ``link`` (r, 8), which is -1, the first run of each of the eight neighbour rows that touches each run,
    corners included."""
    for row in range(row_offset.size - 1):
        a, a_end = row_offset[row], row_offset[row + 1]
        if a == a_end:
            continue
        y, z = row % ny, row // ny
        q = 0
        for dz in range(-1, 2):
            for dy in range(-1, 2):
                if dz == 0 and dy == 0:
                    continue
                if 0 <= y + dy < ny and 0 <= z + dz < nz:
                    other = row + dz * ny + dy
                    j, j_end = row_offset[other], row_offset[other + 1]
                    for k in range(a, a_end):
                        while j < j_end and stop[j] < start[k]:
                            j += 1
                        if j < j_end and start[j] <= stop[k]:
                            link[k, q] = j
                q += 1


@njit
def find_voxels(row, x, row_offset, span):
    """The voxel at each place ``x`` of ``row`` (-1: outside the volume), -1 where there is none; by bisection."""
    found = np.full(row.size, -1, np.int64)
    for i in range(row.size):
        if row[i] < 0:
            continue
        low, high = row_offset[row[i]], row_offset[row[i] + 1]
        end = low
        while low < high:
            middle = (low + high) // 2
            if span[middle, 1] <= x[i]:
                low = middle + 1
            else:
                high = middle
        k = low - 1
        if k >= end:
            voxel = span[k, 2] + x[i] - span[k, 1]
            if voxel < span[k + 1, 2]:
                found[i] = voxel
    return found
