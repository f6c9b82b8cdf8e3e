"""Kernels of :mod:`vascval.imaging.rasterize`: voxels near rounded tubes.

Throughout: P straight pieces from ``start`` to ``end`` (P, 3) with ``radius`` (P,), x y z; a grid whose voxel (0, 0, 0)
has its centre at ``origin`` (3,), with ``spacing`` (3,); and a block ``values`` (z, y, x) of it, whose first voxel has
the index ``offset`` (3,), x y z.
"""

from __future__ import annotations

import math

import numpy as np

from vascval.core.jit import njit

SLACK = 1.0 + 1e-9
"""Widens the search a little, so that rounding in it never loses a voxel; the distance itself decides."""


@njit(inline="always")
def _clip(begin, end, start, step, centre, reach):
    """The part of the parameter interval [begin, end] in which ``|start + s step - centre| <= reach``."""
    if step == 0.0:
        if abs(start - centre) > reach:
            return 1.0, 0.0
        return begin, end
    a = (centre - reach - start) / step
    b = (centre + reach - start) / step
    return max(begin, min(a, b)), min(end, max(a, b))


@njit(inline="always")
def _span(a, b, reach, origin, spacing, offset, size):
    """First and last index of the block within ``reach`` of the stretch from a to b along one axis."""
    first = math.floor((min(a, b) - reach - origin) / spacing) - offset
    last = math.ceil((max(a, b) + reach - origin) / spacing) - offset
    return max(0, first), min(size - 1, last)


@njit(inline="always")
def _slab(k, start, end, reach, origin, spacing, offset, ny):
    """Rows of slab ``k`` that come within ``reach`` of a piece, and the stretch of the piece (parameters) that matters.

    A point within reach has its foot on the piece where every single coordinate differs by at most the reach, so
    that slab by slab and row by row only a stretch of the piece counts.
    """
    dy, dz = end[1] - start[1], end[2] - start[2]
    a, b = _clip(0.0, 1.0, start[2], dz, origin[2] + (k + offset[2]) * spacing[2], reach)
    first, last = _span(start[1] + a * dy, start[1] + b * dy, reach, origin[1], spacing[1], offset[1], ny)
    return a, b, first, (last if a <= b else -1)


@njit(inline="always")
def _row(j, a, b, start, end, reach, origin, spacing, offset, nx):
    """First and last voxel of row ``j`` that come within ``reach`` of the stretch a to b of a piece."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    c, d = _clip(a, b, start[1], dy, origin[1] + (j + offset[1]) * spacing[1], reach)
    first, last = _span(start[0] + c * dx, start[0] + d * dx, reach, origin[0], spacing[0], offset[0], nx)
    return first, (last if c <= d else -1)


@njit(inline="always")
def _square_distance(x, y, z, dx, dy, dz, square):
    """Squared distance of a point, given from the start of a piece, to that piece; ``square = d.d``."""
    s = 0.0
    if square > 0.0:
        s = min(1.0, max(0.0, (x * dx + y * dy + z * dz) / square))
    x -= s * dx
    y -= s * dy
    z -= s * dz
    return x * x + y * y + z * z


@njit
def mark(values, start, end, radius, origin, spacing, offset):
    """Set to 1 the voxels of the block whose centre lies within ``radius`` of its piece."""
    nz, ny, nx = values.shape
    for piece in range(radius.size):
        p, q, r = start[piece], end[piece], radius[piece] * SLACK
        dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        square, limit = dx * dx + dy * dy + dz * dz, radius[piece] * radius[piece]
        first_k, last_k = _span(p[2], q[2], r, origin[2], spacing[2], offset[2], nz)
        for k in range(first_k, last_k + 1):
            z = origin[2] + (k + offset[2]) * spacing[2] - p[2]
            a, b, first_j, last_j = _slab(k, p, q, r, origin, spacing, offset, ny)
            for j in range(first_j, last_j + 1):
                y = origin[1] + (j + offset[1]) * spacing[1] - p[1]
                first, last = _row(j, a, b, p, q, r, origin, spacing, offset, nx)
                for i in range(first, last + 1):
                    x = origin[0] + (i + offset[0]) * spacing[0] - p[0]
                    if _square_distance(x, y, z, dx, dy, dz, square) <= limit:
                        values[k, j, i] = 1


@njit
def lower_distance(values, start, end, radius, origin, spacing, offset, band):
    """Lower the block to the distance from the nearest tube wall, negative inside, wherever that is below ``band``."""
    nz, ny, nx = values.shape
    for piece in range(radius.size):
        p, q, r = start[piece], end[piece], (radius[piece] + band) * SLACK
        dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        square = dx * dx + dy * dy + dz * dz
        first_k, last_k = _span(p[2], q[2], r, origin[2], spacing[2], offset[2], nz)
        for k in range(first_k, last_k + 1):
            z = origin[2] + (k + offset[2]) * spacing[2] - p[2]
            a, b, first_j, last_j = _slab(k, p, q, r, origin, spacing, offset, ny)
            for j in range(first_j, last_j + 1):
                y = origin[1] + (j + offset[1]) * spacing[1] - p[1]
                first, last = _row(j, a, b, p, q, r, origin, spacing, offset, nx)
                for i in range(first, last + 1):
                    x = origin[0] + (i + offset[0]) * spacing[0] - p[0]
                    wall = math.sqrt(_square_distance(x, y, z, dx, dy, dz, square)) - radius[piece]
                    if wall < values[k, j, i]:
                        values[k, j, i] = np.float32(wall)
