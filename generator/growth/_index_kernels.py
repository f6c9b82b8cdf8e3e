"""Which segments are near this point? A uniform grid of cells, each with a linked list of the segments that cross it.

Segments are entered in all the cells that they cross, so that a search around a point looks at the cells around it
alone, however long the segments are. The grid is laid anew with smaller cells when the tree has grown.
"""

from typing import NamedTuple

import numpy as np

from generator._domain_kernels import first_crossing
from vascval.core.borrowing import borrowing


class Grid(NamedTuple):
    """``head`` (nx, ny, nz): first entry of each cell; ``link``, ``owner``: next entry and segment; -1 ends a list.

    ``free`` (2,): first entry of the list of unused entries, and their number.
    """

    origin: np.ndarray
    cell: float
    head: np.ndarray
    link: np.ndarray
    owner: np.ndarray
    free: np.ndarray


@borrowing
def enter(grid, i, j, k, s):
    e = grid.free[0]
    grid.free[0] = grid.link[e]
    grid.free[1] -= 1
    grid.owner[e] = s
    grid.link[e] = grid.head[i, j, k]
    grid.head[i, j, k] = e


@borrowing
def leave(grid, i, j, k, s):
    before = -1
    e = grid.head[i, j, k]
    while e >= 0:
        if grid.owner[e] == s:
            if before < 0:
                grid.head[i, j, k] = grid.link[e]
            else:
                grid.link[before] = grid.link[e]
            grid.link[e] = grid.free[0]
            grid.free[0] = e
            grid.free[1] += 1
            return
        before = e
        e = grid.link[e]


@borrowing
def cell_of(grid, x, y, z):
    nx, ny, nz = grid.head.shape
    i = min(max(int((x - grid.origin[0]) / grid.cell), 0), nx - 1)
    j = min(max(int((y - grid.origin[1]) / grid.cell), 0), ny - 1)
    k = min(max(int((z - grid.origin[2]) / grid.cell), 0), nz - 1)
    return i, j, k


@borrowing
def register(grid, r, s, add):
    """Enter segment ``s`` with the ends in record ``r`` in all cells that it crosses, or take it out of them."""
    h = grid.cell
    ax, ay, az = (r.ax - grid.origin[0]) / h, (r.ay - grid.origin[1]) / h, (r.az - grid.origin[2]) / h
    ux, tx, gx = first_crossing(ax, (r.bx - r.ax) / h)
    uy, ty, gy = first_crossing(ay, (r.by - r.ay) / h)
    uz, tz, gz = first_crossing(az, (r.bz - r.az) / h)
    i, j, k = int(np.floor(ax)), int(np.floor(ay)), int(np.floor(az))
    nx, ny, nz = grid.head.shape
    t = 0.0
    while t <= 1.0:
        ci, cj, ck = min(max(i, 0), nx - 1), min(max(j, 0), ny - 1), min(max(k, 0), nz - 1)
        if add:
            enter(grid, ci, cj, ck, s)
        else:
            leave(grid, ci, cj, ck, s)
        if tx <= ty and tx <= tz:
            t = tx
            i += ux
            tx += gx
        elif ty <= tz:
            t = ty
            j += uy
            ty += gy
        else:
            t = tz
            k += uz
            tz += gz


@borrowing
def fill(grid, segment, first, last):
    """Enter the segments ``first`` to ``last - 1``; returns the first that found no room, ``last`` if all did."""
    nx, ny, nz = grid.head.shape
    room = nx + ny + nz + 3
    for s in range(first, last):
        if grid.free[1] < room:
            return s
        register(grid, segment[s], np.int64(s), np.bool_(True))
    return last


@borrowing
def square_distance(r, x, y, z):
    """Square of the distance between a point and the segment in record ``r``."""
    dx, dy, dz = r.bx - r.ax, r.by - r.ay, r.bz - r.az
    px, py, pz = x - r.ax, y - r.ay, z - r.az
    square = r.length * r.length
    along = 0.0
    if square > 0.0:
        along = min(max((px * dx + py * dy + pz * dz) / square, 0.0), 1.0)
    px -= along * dx
    py -= along * dy
    pz -= along * dz
    return px * px + py * py + pz * pz


@borrowing
def anything_within(grid, segment, x, y, z, distance):
    """Is there a segment within ``distance`` of the point?"""
    ci, cj, ck = cell_of(grid, x, y, z)
    nx, ny, nz = grid.head.shape
    square = distance * distance
    rings = int(np.ceil(distance / grid.cell))
    for ring in range(rings + 1):
        for i in range(max(ci - ring, 0), min(ci + ring, nx - 1) + 1):
            for j in range(max(cj - ring, 0), min(cj + ring, ny - 1) + 1):
                face = abs(i - ci) == ring or abs(j - cj) == ring
                for k in range(ck - ring, ck + ring + 1, 1 if face else max(2 * ring, 1)):
                    if k < 0 or k >= nz:
                        continue
                    e = grid.head[i, j, k]
                    while e >= 0:
                        if square_distance(segment[grid.owner[e]], x, y, z) <= square:
                            return True
                        e = grid.link[e]
    return False


@borrowing
def insert_sorted(near, distance, found, s, d):
    """Keep ``near``/``distance`` the sorted list of the nearest; returns how many it holds."""
    room = near.size
    if found == room and d >= distance[room - 1]:
        return found
    at = min(found, room - 1)
    while at > 0 and distance[at - 1] > d:
        distance[at] = distance[at - 1]
        near[at] = near[at - 1]
        at -= 1
    distance[at] = d
    near[at] = s
    return min(found + 1, room)


@borrowing
def nearest(grid, segment, x, y, z, mark, near, distance):
    """The ``near.size`` segments nearest to the point, nearest first; returns how many were found.

    Rings of cells are searched until what was found is nearer than anything beyond them can be. ``mark`` must differ
    from that of all earlier searches: a segment lies in many cells and is looked at once.
    """
    ci, cj, ck = cell_of(grid, x, y, z)
    nx, ny, nz = grid.head.shape
    fx = (x - grid.origin[0]) / grid.cell - ci
    fy = (y - grid.origin[1]) / grid.cell - cj
    fz = (z - grid.origin[2]) / grid.cell - ck
    margin = min(fx, 1.0 - fx, fy, 1.0 - fy, fz, 1.0 - fz)
    found = 0
    for ring in range(max(nx, ny, nz)):
        for i in range(max(ci - ring, 0), min(ci + ring, nx - 1) + 1):
            for j in range(max(cj - ring, 0), min(cj + ring, ny - 1) + 1):
                face = abs(i - ci) == ring or abs(j - cj) == ring
                for k in range(ck - ring, ck + ring + 1, 1 if face else max(2 * ring, 1)):
                    if k < 0 or k >= nz:
                        continue
                    e = grid.head[i, j, k]
                    while e >= 0:
                        s = grid.owner[e]
                        e = grid.link[e]
                        if segment[s].seen == mark:
                            continue
                        segment[s].seen = mark
                        found = insert_sorted(near, distance, found, s, square_distance(segment[s], x, y, z))
        safe = (ring + margin) * grid.cell
        if found == near.size and safe > 0.0 and distance[found - 1] <= safe * safe:
            break
    return found


@borrowing
def follow(head, link, met):
    """Mark in ``met`` the entries on all lists that begin at ``head`` (K,) and go on by ``link``; their number.

    -1 if a list leads out of ``met`` or to an entry that was met already: then these are no lists.
    """
    found = 0
    for e in head:
        while e != -1:
            if e < 0 or e >= met.size or met[e]:
                return -1
            met[e] = True
            found += 1
            e = link[e]
    return found
