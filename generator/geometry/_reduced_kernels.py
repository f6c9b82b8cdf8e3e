"""Compiled sweeps behind :mod:`generator.geometry.reduced`: radii, volume, gradient, and the tree Laplacian.

All loops run over a root-first parent array; ``i`` is a node and the segment that ends there. ``n`` is the number of
terminals below, ``gamma`` the branching exponent at the node, ``factor`` the viscosity of the segment relative to the
constant one.
"""

import math

from vascval.core.borrowing import borrowing

TINY_MM = 1e-12


@borrowing
def lengths(parent, position, eps, chord, length):
    """True lengths ``|d|`` and smoothed ones ``sqrt(|d|^2 + eps^2)``."""
    for i in range(1, parent.size):
        p = parent[i]
        dx = position[i, 0] - position[p, 0]
        dy = position[i, 1] - position[p, 1]
        dz = position[i, 2] - position[p, 2]
        square = dx * dx + dy * dy + dz * dz
        chord[i] = math.sqrt(square)
        length[i] = math.sqrt(square + eps * eps)


@borrowing
def radii(parent, length, n, gamma, factor, fixed_radius, stem, base, radius, rho, q, total):
    """Leaf to root ``rho``, its power ``q = rho^(gamma/4)`` and their sums ``total`` at each node; then the radii.

    ``base`` (N,) is what ``total`` holds of segments that are left out.
    ``fixed_radius`` (N,) is NaN where the radius follows; ``stem`` (N,) holds ``kappa Q_term / dp`` for the segments
    that spring from a fixed node, ``dp`` being the pressure left there, and 0 for all others.
    """
    size = parent.size
    for i in range(size):
        total[i] = base[i]
    for i in range(size - 1, 0, -1):
        p = parent[i]
        rho[i] = n[i] * length[i] * factor[i]
        if total[i] > 0.0:
            rho[i] += total[i] ** (4.0 / gamma[i])
        q[i] = rho[i] ** (0.25 * gamma[p])
        total[p] += q[i]
    for i in range(1, size):
        if fixed_radius[i] == fixed_radius[i]:
            radius[i] = fixed_radius[i]
        elif stem[i] > 0.0:
            radius[i] = (stem[i] * rho[i]) ** 0.25
        else:
            p = parent[i]
            radius[i] = radius[p] * math.sqrt(math.sqrt(rho[i])) / total[p] ** (1.0 / gamma[p])


@borrowing
def adjoint(parent, length, n, gamma, factor, free, rho, q, total, lump, push, lift, below, slope, stretch):
    """Derivatives of a cost by the lengths and by the viscosity factors, given those by radii and lengths.

    With ``rho_i = n_i l_i f_i + S_i^(4/gamma)``, ``log r_c = log r_i + log(rho_c) / 4 - log(S_i) / gamma``: leaf to
    root ``g_i``, the derivative by ``log r_i`` when all below scales along; root to leaf that by ``log rho_i``.

    :param lump: (N,) volume of what is left out at each node; it goes with the square of ``r_i / S_i^(1/gamma)``.
    :param push: (N,) derivative of the cost by ``log r_i``, all else fixed.
    :param lift: (N,) derivative of the cost by ``l_i``, all else fixed.
    :param below: (N,) out: sum of ``g`` over the segments that spring from each node.
    :param slope: (N,) out: derivative by ``l_i``.
    :param stretch: (N,) out: derivative by ``log factor_i``.
    """
    size = parent.size
    for i in range(size):
        below[i] = 2.0 * lump[i]
    for i in range(size - 1, 0, -1):
        if free[i]:
            below[parent[i]] += push[i] + below[i]
    for i in range(1, size):
        if not free[i]:
            slope[i] = 0.0
            stretch[i] = 0.0
            continue
        p = parent[i]
        by_rho = 0.25 * (push[i] + below[i])
        if free[p]:
            by_rho += slope[p] * 0.25 * gamma[p] * q[i] / total[p]
        stretch[i] = by_rho * n[i] * length[i] * factor[i] / rho[i]
        # until its children have been met, slope[i] holds the derivative by log S_i
        slope[i] = (by_rho * 4.0 * (1.0 - n[i] * length[i] * factor[i] / rho[i]) - below[i]) / gamma[i]
    for i in range(1, size):
        if free[i]:
            slope[i] = lift[i] + stretch[i] / length[i]


@borrowing
def pull(parent, position, moves, chord, length, slope, hold, gradient):
    """Derivatives by the positions from those by the lengths, ``slope`` by the smoothed, ``-hold`` by the true ones."""
    size = parent.size
    for i in range(size):
        gradient[i, 0] = 0.0
        gradient[i, 1] = 0.0
        gradient[i, 2] = 0.0
    for i in range(1, size):
        p = parent[i]
        c = slope[i] / length[i]
        if hold[i] > 0.0:
            c -= hold[i] / max(chord[i], TINY_MM)
        for k in range(3):
            f = c * (position[i, k] - position[p, k])
            gradient[i, k] += f
            gradient[p, k] -= f
    for i in range(size):
        if not moves[i]:
            gradient[i, 0] = 0.0
            gradient[i, 1] = 0.0
            gradient[i, 2] = 0.0


@borrowing
def cost(length, chord, radius, total, gamma, bulk, free, shortest, pull, bound, lump, push, lift, hold, stiff):
    """Volume of the free segments, of what is left out, and the augmented Lagrangian of ``|d| >= shortest``.

    A bound with multiplier ``m = pull_i`` and stiffness ``k = bound_i`` adds ``(t^2 - m^2) / (2 k)`` with
    ``t = max(0, m + k (shortest - |d|))``; where ``k`` is 0 there is none.

    :param bulk: (N,) volume of what is left out, by the square of ``r / total^(1/gamma)``; ``lump`` (N,) out: itself.
    :param push, lift: (N,) out: derivatives of the volume by ``log r`` and by ``l``.
    :param hold, stiff: (N,) out: ``t``, the force of the bound, and the curvature that it adds.
    """
    volume = 0.0
    for i in range(1, length.size):
        if not free[i]:
            continue
        if bulk[i] > 0.0:
            lump[i] = bulk[i] * (radius[i] / total[i] ** (1.0 / gamma[i])) ** 2
            volume += lump[i]
        lift[i] = math.pi * radius[i] * radius[i]
        push[i] = 2.0 * lift[i] * length[i]
        volume += lift[i] * length[i]
        hold[i], stiff[i] = 0.0, 0.0
        if bound[i] > 0.0:
            hold[i] = max(0.0, pull[i] + bound[i] * (shortest - chord[i]))
            volume += (hold[i] * hold[i] - pull[i] * pull[i]) / (2.0 * bound[i])
            if hold[i] > 0.0:
                stiff[i] = bound[i]
    return volume


@borrowing
def imbalance(parent, moves, weight, gradient, force):
    """The largest force on a node that moves, relative to the sum of the weights of its segments; ``force``: all."""
    for i in range(parent.size):
        force[i] = 0.0
    for i in range(1, parent.size):
        force[i] += abs(weight[i])
        force[parent[i]] += abs(weight[i])
    worst = 0.0
    for i in range(parent.size):
        if moves[i]:
            square = gradient[i, 0] ** 2 + gradient[i, 1] ** 2 + gradient[i, 2] ** 2
            force[i] = math.sqrt(square) / force[i]
            worst = max(worst, force[i])
        else:
            force[i] = 0.0
    return worst


@borrowing
def leave_out(parent, kept, q, volume, base, rest):
    """Keep all that lies between the root and what is ``kept`` (N,) bool; sum up what is not, where it springs from.

    :param volume: (N,) of each segment; out: with all below it.
    :param base, rest: (N,) sums of ``q`` and ``volume`` over the segments left out at each node are added to these.
    """
    for i in range(parent.size - 1, 0, -1):
        p = parent[i]
        volume[p] += volume[i]
        if kept[i]:
            kept[p] = True
        else:
            base[p] += q[i]
            rest[p] += volume[i]


@borrowing
def dot(a, b):
    total = 0.0
    for i in range(a.shape[0]):
        total += a[i, 0] * b[i, 0] + a[i, 1] * b[i, 1] + a[i, 2] * b[i, 2]
    return total


@borrowing
def stiffness(slope, hold, length, seen_slope, seen_length, along, across):
    """How much segments resist, as the Laplacian takes it: ``across`` as a weight, ``along`` as a stiffness.

    Across it is the tension, the slope less what a bound takes of it, but not less than a twentieth of the slope. Along
    it is the change of the slope by the length that the last step has shown, within limits; where that cannot be told
    it stays, and before a first step (``seen_length`` 0) it is a tenth of that across.
    """
    for i in range(1, length.size):
        weight = max(slope[i], 1e-9)
        across[i] = max(weight - hold[i], 0.05 * weight)
        weight /= length[i]
        change = length[i] - seen_length[i]
        if seen_length[i] == 0.0:
            along[i] = 0.1 * weight
        elif abs(change) > 1e-7 * length[i]:
            along[i] = min(max((slope[i] - seen_slope[i]) / change, 0.01 * weight), 2.0 * weight)
        seen_slope[i], seen_length[i] = slope[i], length[i]


@borrowing
def foresee(parent, position, moves, chord, step, pull, bound, shortest, on, stiff, rhs):
    """Whether a ``step`` takes segments below a bound that does not press yet; it is then put into the next solve.

    Their stiffness is added to ``stiff`` and the force of the bound as it is now, which is negative, to ``rhs``.

    :param step: (N, 3) what is taken off the positions; ``on`` (N,): positive where the bound presses already.
    """
    found = False
    for i in range(1, parent.size):
        if bound[i] <= 0.0 or on[i] > 0.0:
            continue
        p = parent[i]
        away = 1.0 / max(chord[i], TINY_MM)
        shorter = 0.0
        for k in range(3):
            shorter += away * (position[i, k] - position[p, k]) * (step[i, k] - step[p, k])
        force = pull[i] + bound[i] * (shortest - chord[i])
        if force + bound[i] * shorter <= 0.0:
            continue
        found = True
        stiff[i] += bound[i]
        for k in range(3):
            f = -force * away * (position[i, k] - position[p, k])
            if moves[i]:
                rhs[i, k] += f
            if moves[p]:
                rhs[p, k] -= f
    return found


@borrowing
def solve_laplacian(parent, position, moves, chord, length, weight, stiff, bend, rhs, block, diagonal, out):
    """``out`` with ``H out = rhs`` at the nodes that move, 0 elsewhere; ``H`` is a tree Laplacian of 3 x 3 blocks.

    Segment ``i`` adds ``w_i / l_i (I - bend d d^T / l_i^2) + stiff_i d d^T / |d|^2``: with ``bend`` 0 the majoriser of
    the weighted lengths, with 1 their Hessian at fixed weights; ``stiff`` is the curvature along the segment that a
    bound adds. Eliminating leaf to root makes no fill-in.

    :param block, diagonal: (N, 6) scratch: 3 x 3 blocks as xx, xy, xz, yy, yz, zz.
    """
    diagonal[:] = 0.0
    solve_anchored(parent, position, moves, chord, length, weight, stiff, bend, rhs, block, diagonal, out)


@borrowing
def solve_anchored(parent, position, moves, chord, length, weight, stiff, bend, rhs, block, diagonal, out):
    """The same, with the stiffness that ``diagonal`` holds already, of what ties single nodes to their places."""
    size = parent.size
    for i in range(size):
        for k in range(3):
            out[i, k] = rhs[i, k]
    for i in range(1, size):
        segment_block(parent, position, chord, length, weight, stiff, bend, i, block[i])
    for i in range(size - 1, 0, -1):
        p = parent[i]
        c = block[i]
        for k in range(6):
            diagonal[i, k] += c[k]
            diagonal[p, k] += c[k]
        if not moves[i]:
            continue
        invert(diagonal[i])
        if not moves[p]:
            continue
        # the parent's block loses C D^-1 C, its right-hand side gains C D^-1 b
        m00, m01, m02, m10, m11, m12, m20, m21, m22 = product(c, diagonal[i])
        diagonal[p, 0] -= m00 * c[0] + m01 * c[1] + m02 * c[2]
        diagonal[p, 1] -= m00 * c[1] + m01 * c[3] + m02 * c[4]
        diagonal[p, 2] -= m00 * c[2] + m01 * c[4] + m02 * c[5]
        diagonal[p, 3] -= m10 * c[1] + m11 * c[3] + m12 * c[4]
        diagonal[p, 4] -= m10 * c[2] + m11 * c[4] + m12 * c[5]
        diagonal[p, 5] -= m20 * c[2] + m21 * c[4] + m22 * c[5]
        x, y, z = out[i, 0], out[i, 1], out[i, 2]
        out[p, 0] += m00 * x + m01 * y + m02 * z
        out[p, 1] += m10 * x + m11 * y + m12 * z
        out[p, 2] += m20 * x + m21 * y + m22 * z
    for i in range(size):
        if not moves[i]:
            out[i, 0] = 0.0
            out[i, 1] = 0.0
            out[i, 2] = 0.0
            continue
        p = parent[i]
        x, y, z = out[i, 0], out[i, 1], out[i, 2]
        if moves[p]:
            c = block[i]
            x += c[0] * out[p, 0] + c[1] * out[p, 1] + c[2] * out[p, 2]
            y += c[1] * out[p, 0] + c[3] * out[p, 1] + c[4] * out[p, 2]
            z += c[2] * out[p, 0] + c[4] * out[p, 1] + c[5] * out[p, 2]
        d = diagonal[i]
        out[i, 0] = d[0] * x + d[1] * y + d[2] * z
        out[i, 1] = d[1] * x + d[3] * y + d[4] * z
        out[i, 2] = d[2] * x + d[4] * y + d[5] * z


@borrowing
def segment_block(parent, position, chord, length, weight, stiff, bend, i, block):
    """What segment ``i`` adds to the Laplacian; a weight that is not positive counts as a small one."""
    p = parent[i]
    c = max(weight[i], 1e-9) / length[i]
    b = c * bend / (length[i] * length[i])
    if stiff[i] > 0.0:
        b -= stiff[i] / max(chord[i], TINY_MM) ** 2
    x, y, z = position[i, 0] - position[p, 0], position[i, 1] - position[p, 1], position[i, 2] - position[p, 2]
    block[0] = c - b * x * x
    block[1] = -b * x * y
    block[2] = -b * x * z
    block[3] = c - b * y * y
    block[4] = -b * y * z
    block[5] = c - b * z * z


@borrowing
def invert(a):
    """Inverse, in place, of a symmetric 3 x 3 matrix (xx, xy, xz, yy, yz, zz)."""
    c0 = a[3] * a[5] - a[4] * a[4]
    c1 = a[2] * a[4] - a[1] * a[5]
    c2 = a[1] * a[4] - a[2] * a[3]
    scale = 1.0 / (a[0] * c0 + a[1] * c1 + a[2] * c2)
    c3 = a[0] * a[5] - a[2] * a[2]
    c4 = a[1] * a[2] - a[0] * a[4]
    c5 = a[0] * a[3] - a[1] * a[1]
    a[0], a[1], a[2] = c0 * scale, c1 * scale, c2 * scale
    a[3], a[4], a[5] = c3 * scale, c4 * scale, c5 * scale


@borrowing
def product(a, b):
    """Product of two symmetric 3 x 3 matrices, row by row."""
    return (
        a[0] * b[0] + a[1] * b[1] + a[2] * b[2],
        a[0] * b[1] + a[1] * b[3] + a[2] * b[4],
        a[0] * b[2] + a[1] * b[4] + a[2] * b[5],
        a[1] * b[0] + a[3] * b[1] + a[4] * b[2],
        a[1] * b[1] + a[3] * b[3] + a[4] * b[4],
        a[1] * b[2] + a[3] * b[4] + a[4] * b[5],
        a[2] * b[0] + a[4] * b[1] + a[5] * b[2],
        a[2] * b[1] + a[4] * b[3] + a[5] * b[4],
        a[2] * b[2] + a[4] * b[4] + a[5] * b[5],
    )
