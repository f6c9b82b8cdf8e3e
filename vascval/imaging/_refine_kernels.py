"""Compiled passes of the sub-voxel refinement; see :mod:`vascval.imaging.refine`.

Each branch has stations, evenly spaced along its centreline; branch ``b`` owns stations
``offset[b]:offset[b + 1]`` with position, unit tangent and arc length ``s``. Voxels know a station near them, or have
a negative number and are passed over.
"""

import numpy as np

from vascval.core.jit import njit


@njit
def reopen(label):
    """Take back the stations of all voxels that have one."""
    for i in range(label.size):
        label[i] = min(label[i], -1)


@njit
def name_owners(label, point):
    """The ``point`` of each voxel's station instead of the station; those coded ``-2 - point`` in clear; -1 stays."""
    for i in range(label.size):
        if label[i] >= 0:
            label[i] = point[label[i]]
        elif label[i] < -1:
            label[i] = -2 - label[i]


@njit
def close(owner, is_open):
    """Open the voxels whose owner is (-1), and close the others (``-2 - owner``)."""
    for i in range(owner.size):
        if owner[i] >= 0:
            owner[i] = -1 if is_open[owner[i]] else -2 - owner[i]


@njit
def relocate(station, branch, offset, position, tangent, arc, lattice, spacing):
    """Move each voxel's station along its branch to the one whose cross-section it lies in; give its arc length."""
    along = np.empty(station.size)
    for r in range(lattice.link.shape[0]):
        row, x, begin = lattice.span[r]
        py, pz = (row % lattice.ny) * spacing[1], (row // lattice.ny) * spacing[2]
        for i in range(begin, lattice.span[r + 1, 2]):
            k = station[i]
            if k < 0:
                along[i] = 0.0
                continue
            b = branch[k]
            px = (x + i - begin) * spacing[0]
            last = offset[b + 1] - 1
            first = offset[b]
            s = 0.0
            for _ in range(4):
                s = (
                    (px - position[k, 0]) * tangent[k, 0]
                    + (py - position[k, 1]) * tangent[k, 1]
                    + (pz - position[k, 2]) * tangent[k, 2]
                )
                here = arc[k] + s
                target = k
                while target < last and arc[target + 1] - here <= here - arc[target]:
                    target += 1
                while target > first and here - arc[target - 1] <= arc[target] - here:
                    target -= 1
                if target == k:
                    break
                # one station at a time on curves: a far target may lie around a bend
                k = target
            along[i] = (
                arc[k]
                + (px - position[k, 0]) * tangent[k, 0]
                + (py - position[k, 1]) * tangent[k, 1]
                + (pz - position[k, 2]) * tangent[k, 2]
            )
            station[i] = k
    return along


@njit
def centroids(station, n_stations, lattice, spacing):
    """Number of voxels in each station's slab and the sum of their positions."""
    count = np.zeros(n_stations)
    total = np.zeros((n_stations, 3))
    for r in range(lattice.link.shape[0]):
        row, x, begin = lattice.span[r]
        py, pz = (row % lattice.ny) * spacing[1], (row // lattice.ny) * spacing[2]
        for i in range(begin, lattice.span[r + 1, 2]):
            k = station[i]
            if k < 0:
                continue
            count[k] += 1.0
            total[k, 0] += (x + i - begin) * spacing[0]
            total[k, 1] += py
            total[k, 2] += pz
    return count, total


@njit
def inverse_distance(dx, dy, dz, tangent, core):
    """``1 / rho`` for the distance rho from a line through the origin; within ``core`` ``(4 - 3 rho / core) / core``,
    which is continuous and has the same integral over the core's disc, ``2 pi core``."""
    t = dx * tangent[0] + dy * tangent[1] + dz * tangent[2]
    rho = np.sqrt(max(0.0, dx * dx + dy * dy + dz * dz - t * t))
    return (4.0 - 3.0 * rho / core) / core if rho < core else 1.0 / rho


@njit
def section_sums(station, along, branch, position, tangent, low, high, ramp, near, lattice, spacing):
    """For each branch the sum of ``1 / rho`` over its voxels between ``low`` and ``high``, tapered over ``ramp`` at
    both ends; see :func:`vascval.imaging.refine._radii`. Voxels within ``near`` of the axis are averaged over 27 parts.
    """
    radius_sum = np.zeros(low.size)
    core = 0.25 * spacing.min()
    parts = (np.arange(3) - 1.0) / 3.0
    for r in range(lattice.link.shape[0]):
        row, x, begin = lattice.span[r]
        py, pz = (row % lattice.ny) * spacing[1], (row // lattice.ny) * spacing[2]
        for i in range(begin, lattice.span[r + 1, 2]):
            k = station[i]
            if k < 0:
                continue
            b = branch[k]
            s = along[i]
            if s <= low[b] or s >= high[b]:
                continue
            edge = min(s - low[b], high[b] - s)
            weight = 1.0 if edge >= ramp[b] else 0.5 - 0.5 * np.cos(np.pi * edge / ramp[b])
            dx = (x + i - begin) * spacing[0] - position[k, 0]
            dy = py - position[k, 1]
            dz = pz - position[k, 2]
            value = inverse_distance(dx, dy, dz, tangent[k], core)
            if value * near > 1.0:
                value = 0.0
                for u in parts:
                    for v in parts:
                        for w in parts:
                            value += inverse_distance(
                                dx + u * spacing[0], dy + v * spacing[1], dz + w * spacing[2], tangent[k], core
                            )
                value /= 27.0
            radius_sum[b] += weight * value
    return radius_sum


@njit
def make_stations(points, begin, step, half_width):
    """Evenly spaced stations along each polyline ``points[begin[b]:begin[b + 1]]``.

    :param half_width: (n_branches,) over how many mm to each side the tangent is taken.
    """
    n = begin.size - 1
    offset = np.zeros(n + 1, np.int64)
    total = np.zeros(n)
    for b in range(n):
        for k in range(begin[b] + 1, begin[b + 1]):
            total[b] += np.sqrt(((points[k] - points[k - 1]) ** 2).sum())
        offset[b + 1] = offset[b] + max(2, int(np.ceil(total[b] / step)) + 1)
    position = np.empty((offset[n], 3))
    tangent = np.empty((offset[n], 3))
    arc = np.empty(offset[n])
    branch = np.empty(offset[n], np.int32)
    for b in range(n):
        m = offset[b + 1] - offset[b]
        pitch = total[b] / (m - 1)
        k = begin[b]
        walked = 0.0
        here = np.sqrt(((points[k + 1] - points[k]) ** 2).sum())
        for j in range(m):
            s = j * pitch
            while s > walked + here and k + 2 < begin[b + 1]:
                walked += here
                k += 1
                here = np.sqrt(((points[k + 1] - points[k]) ** 2).sum())
            t = 0.0 if here == 0.0 else min(1.0, (s - walked) / here)
            position[offset[b] + j] = points[k] + t * (points[k + 1] - points[k])
            arc[offset[b] + j] = s
            branch[offset[b] + j] = b
        reach = 1 if pitch == 0.0 else max(1, round(half_width[b] / pitch))
        for j in range(m):
            # a chord from a point as far back as ahead, so that the tangent is centred
            span = min(reach, max(1, min(j, m - 1 - j)))
            lo, hi = max(0, j - span), min(m - 1, j + span)
            d = position[offset[b] + hi] - position[offset[b] + lo]
            size = np.sqrt((d**2).sum())
            tangent[offset[b] + j] = d / size if size > 0 else np.array([1.0, 0.0, 0.0])
    return offset, position, tangent, arc, branch


@njit
def clearance(out_direction, radius, node_offset, node_branch, node_end, low, high):
    """How far from each junction each branch comes clear of the others there; written to ``low`` and ``high``.

    Beside a branch of radius R at angle phi a branch of radius r is clear from ``(R + r cos phi) / sin phi`` on; if the
    other runs away from it (phi > 90 degrees) from R on at the latest. ``node_end`` is 0 where the branch begins at
    the node, 1 where it ends there; ``out_direction`` (n, 2, 3) points away from the node.
    """
    for v in range(node_offset.size - 1):
        for p in range(node_offset[v], node_offset[v + 1]):
            b, e = node_branch[p], node_end[p]
            far = 0.0
            for q in range(node_offset[v], node_offset[v + 1]):
                c, f = node_branch[q], node_end[q]
                if q == p:
                    continue
                cosine = (out_direction[b, e] * out_direction[c, f]).sum()
                sine = np.sqrt(max(1e-12, 1.0 - cosine * cosine))
                clear = (radius[c] + radius[b] * cosine) / sine
                if cosine < 0:
                    clear = min(clear, radius[c])
                else:
                    clear = min(clear, 4.0 * (radius[c] + radius[b]))
                far = max(far, clear)
            if e == 0:
                low[b] = far
            else:
                high[b] = far


@njit
def smooth_centres(count, total, offset, position, tangent, arc, low, high, width):
    """Centroid of each station's neighbourhood along its branch, by Gaussian weights of ``width`` mm; the shift along
    the tangent is taken out. Stations outside ``low..high`` keep their place.
    """
    result = position.copy()
    for b in range(offset.size - 1):
        first, last = offset[b], offset[b + 1]
        for k in range(first, last):
            if arc[k] < low[b] or arc[k] > high[b]:
                continue
            mass = 0.0
            shift = np.zeros(3)
            for j in range(first, last):
                if count[j] == 0 or arc[j] < low[b] or arc[j] > high[b]:
                    continue
                u = (arc[j] - arc[k]) / width[b]
                if abs(u) > 3.0:
                    continue
                w = np.exp(-0.5 * u * u) * count[j]
                mass += w
                shift += w * (total[j] / count[j] - position[j])
            if mass > 0:
                shift /= mass
                shift -= (shift * tangent[k]).sum() * tangent[k]
                result[k] = position[k] + shift
    return result


@njit
def regression(count, total, arc, first, last, a, z):
    """Weighted regression of slab centroids on arc length between ``a`` and ``z``, in orthogonal polynomials.

    With u the arc length from the mean: ``x = mean + slope u + bend (u^2 - skew u - spread)``.

    :returns: mean arc length, mean (3,), slope (3,), spread (0 below two slabs), bend (3,), skew, and the square of the
        t-value of the bend.
    """
    moments = np.zeros(5)
    middle, slabs = 0.0, 0
    mean, slope, bend = np.zeros(3), np.zeros(3), np.zeros(3)
    for k in range(first, last):
        if count[k] > 0 and a - 1e-9 <= arc[k] <= z + 1e-9:
            moments[0] += count[k]
            middle += count[k] * arc[k]
            mean += total[k]
            slabs += 1
    if slabs < 2:
        return 0.0, mean, slope, 0.0, bend, 0.0, 0.0
    mean /= moments[0]
    middle /= moments[0]
    for k in range(first, last):
        if count[k] > 0 and a - 1e-9 <= arc[k] <= z + 1e-9:
            u = arc[k] - middle
            slope += u * (total[k] - count[k] * mean)
            for m in range(2, 5):
                moments[m] += count[k] * u**m
    spread = moments[2] / moments[0]
    if moments[2] == 0.0:
        return middle, mean, slope, 0.0, bend, 0.0, 0.0
    slope /= moments[2]
    skew = moments[3] / moments[2]
    size = moments[4] - skew * moments[3] - spread * moments[2]
    if slabs < 6 or size <= 0.0:
        return middle, mean, slope, spread, bend, skew, 0.0
    rest = 0.0
    for k in range(first, last):
        if count[k] > 0 and a - 1e-9 <= arc[k] <= z + 1e-9:
            u = arc[k] - middle
            off = total[k] / count[k] - mean - slope * u
            bend += count[k] * (u * u - skew * u - spread) * off
            rest += count[k] * (off**2).sum()
    bend /= size
    bent = (bend**2).sum() * size
    t_square = bent * (slabs - 3) / max(rest - bent, 1e-12 * bent + 1e-300)
    return middle, mean, slope, spread, bend, skew, t_square


@njit
def end_lines(count, total, offset, arc, low, high, reach, at_end, bend_t):
    """A straight line next to one end of each branch, by regression of the slab centroids on arc length.

    Where the centroids over twice ``reach`` bend significantly (t-value above ``bend_t``) and cover at least twice the
    way to the end, the line is the tangent of the parabola at the branch's end.

    :param at_end: False for the proximal end, True for the distal one.
    :param reach: (n_branches,) how much of the window is used, mm.
    :returns: a point on each line, its unit direction (proximal to distal), and a weight, the root of the variance of
        arc length (0 where fewer than two slabs hold voxels).
    """
    n = offset.size - 1
    centre, direction, weight = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n)
    for b in range(n):
        first, last = offset[b], offset[b + 1]
        tip = arc[last - 1] if at_end else 0.0
        for factor in (2.0, 1.0):
            a = max(low[b], high[b] - factor * reach[b]) if at_end else low[b]
            z = high[b] if at_end else min(high[b], low[b] + factor * reach[b])
            middle, mean, slope, spread, bend, skew, t_square = regression(count, total, arc, first, last, a, z)
            gap = abs(tip - (z if at_end else a))
            curved = factor == 2.0 and t_square > bend_t * bend_t and z - a >= 2.0 * gap
            if curved or factor == 1.0:
                break
        u = tip - middle
        point = mean + slope * u + bend * (u * u - skew * u - spread) if curved else mean
        tangent = slope + bend * (2.0 * u - skew) if curved else slope
        size = np.sqrt((tangent**2).sum())
        if size > 0.0 and spread > 0.0:
            centre[b] = point
            direction[b] = tangent / size
            weight[b] = np.sqrt(spread)
    return centre, direction, weight


@njit
def voxels_beyond(along, station, branch, limit, sign, width):
    """Number of voxels of each branch beyond ``limit`` (at larger arc length for sign 1, smaller for -1), the limit
    being softened over ``width`` mm so that no layer of voxels falls in or out at once."""
    result = np.zeros(limit.size)
    for i in range(along.size):
        if station[i] < 0:
            continue
        b = branch[station[i]]
        if sign[b] != 0:
            result[b] += min(1.0, max(0.0, (along[i] - limit[b]) * sign[b] / width + 0.5))
    return result


@njit
def reaches_border(along, station, branch, limit, sign, lattice, nx, nz):
    """Does a branch touch the border of the volume beyond ``limit``?"""
    result = np.zeros(limit.size, np.bool_)
    for r in range(lattice.link.shape[0]):
        row, x, begin = lattice.span[r]
        y, z, end = row % lattice.ny, row // lattice.ny, lattice.span[r + 1, 2]
        side = y == 0 or z == 0 or y == lattice.ny - 1 or z == nz - 1
        for i in range(begin, end):
            if station[i] < 0:
                continue
            at_border = side or (i == begin and x == 0) or (i == end - 1 and x + end - begin == nx)
            b = branch[station[i]]
            if at_border and sign[b] != 0 and (along[i] - limit[b]) * sign[b] > 0:
                result[b] = True
    return result
