"""Compiled geometry behind :mod:`generator.domain`: is this segment inside?

A domain is cut into cells, voxels of an image or the boxes of a grid, each ``OUTSIDE``, ``INSIDE`` or ``WALL``. A wall
cell lists the triangles that touch it. A segment whose first end is inside lies inside as a whole when it enters no
outside cell and crosses no triangle of the wall cells on its way.
"""

from typing import NamedTuple

import numpy as np

from vascval.core.borrowing import borrowing
from vascval.core.jit import njit

OUTSIDE, INSIDE, WALL = 0, 1, 2
GRAZE = 1e-9  # a segment that touches the wall is not inside


class Space(NamedTuple):
    """``state`` (nx, ny, nz) uint8; ``to_cell`` (3, 4) world to cell coordinates (cell ``i`` spans ``i`` to ``i + 1``);
    triangles of cell ``c`` (C order): ``wall[offset[c]:offset[c + 1]]`` into ``triangle`` (K, 3, 3) world points.

    ``convex`` spares all of it: between two points of a convex domain everything is inside. It is one cell then, and
    what is in the cell is inside.
    """

    convex: bool
    state: np.ndarray
    to_cell: np.ndarray
    offset: np.ndarray
    wall: np.ndarray
    triangle: np.ndarray


@borrowing
def crosses(triangle, ax, ay, az, dx, dy, dz, slack):
    """Does the segment from ``a`` along ``d`` meet the triangle (3, 3), widened by ``slack`` (Moeller and Trumbore)?"""
    e1x, e1y, e1z = triangle[1, 0] - triangle[0, 0], triangle[1, 1] - triangle[0, 1], triangle[1, 2] - triangle[0, 2]
    e2x, e2y, e2z = triangle[2, 0] - triangle[0, 0], triangle[2, 1] - triangle[0, 1], triangle[2, 2] - triangle[0, 2]
    px, py, pz = dy * e2z - dz * e2y, dz * e2x - dx * e2z, dx * e2y - dy * e2x
    det = e1x * px + e1y * py + e1z * pz
    if det == 0.0:
        return False
    sx, sy, sz = ax - triangle[0, 0], ay - triangle[0, 1], az - triangle[0, 2]
    u = (sx * px + sy * py + sz * pz) / det
    if u < -slack or u > 1.0 + slack:
        return False
    qx, qy, qz = sy * e1z - sz * e1y, sz * e1x - sx * e1z, sx * e1y - sy * e1x
    v = (dx * qx + dy * qy + dz * qz) / det
    if v < -slack or u + v > 1.0 + slack:
        return False
    t = (e2x * qx + e2y * qy + e2z * qz) / det
    return -slack <= t <= 1.0 + slack


@borrowing
def crosses_wall(space, cell, ax, ay, az, dx, dy, dz):
    for k in range(space.offset[cell], space.offset[cell + 1]):
        if crosses(space.triangle[space.wall[k]], ax, ay, az, dx, dy, dz, GRAZE):
            return True
    return False


@borrowing
def first_crossing(start, step):
    """Along one axis: direction of travel, parameter of the first cell face ahead and parameter from face to face."""
    if step > 0.0:
        return 1, (np.floor(start) + 1.0 - start) / step, 1.0 / step
    if step < 0.0:
        return -1, (np.floor(start) - start) / step, -1.0 / step
    return 0, np.inf, np.inf


@borrowing
def segment_inside(space, ax, ay, az, bx, by, bz):
    """Is the straight segment from ``a``, which is inside, to ``b`` inside? Walks through the cells that it crosses."""
    m = space.to_cell
    if space.convex:
        x = m[0, 0] * bx + m[0, 1] * by + m[0, 2] * bz + m[0, 3]
        y = m[1, 0] * bx + m[1, 1] * by + m[1, 2] * bz + m[1, 3]
        z = m[2, 0] * bx + m[2, 1] * by + m[2, 2] * bz + m[2, 3]
        return min(x, y, z) >= -GRAZE and max(x, y, z) <= 1.0 + GRAZE
    dx, dy, dz = bx - ax, by - ay, bz - az
    sx = m[0, 0] * ax + m[0, 1] * ay + m[0, 2] * az + m[0, 3]
    sy = m[1, 0] * ax + m[1, 1] * ay + m[1, 2] * az + m[1, 3]
    sz = m[2, 0] * ax + m[2, 1] * ay + m[2, 2] * az + m[2, 3]
    ux, tx, gx = first_crossing(sx, m[0, 0] * dx + m[0, 1] * dy + m[0, 2] * dz)
    uy, ty, gy = first_crossing(sy, m[1, 0] * dx + m[1, 1] * dy + m[1, 2] * dz)
    uz, tz, gz = first_crossing(sz, m[2, 0] * dx + m[2, 1] * dy + m[2, 2] * dz)
    i, j, k = int(np.floor(sx)), int(np.floor(sy)), int(np.floor(sz))
    nx, ny, nz = space.state.shape
    while True:
        if i < 0 or j < 0 or k < 0 or i >= nx or j >= ny or k >= nz:
            return False
        state = space.state[i, j, k]
        if state == OUTSIDE:
            return False
        if state == WALL and crosses_wall(space, (i * ny + j) * nz + k, ax, ay, az, dx, dy, dz):
            return False
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
        if t > 1.0:
            return True


@njit
def inside_along(space, a, b):
    """:func:`segment_inside` for arrays of segments ``a``, ``b`` (K, 3)."""
    result = np.empty(len(a), np.bool_)
    for i in range(len(a)):
        result[i] = segment_inside(space, a[i, 0], a[i, 1], a[i, 2], b[i, 0], b[i, 1], b[i, 2])
    return result
