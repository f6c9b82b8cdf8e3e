"""The weighted Fermat point of three points, where growth and the search put bifurcations."""

import numpy as np

from vascval.core.borrowing import borrowing

NOWHERE, AT_FIRST, AT_SECOND, AT_THIRD = 0, 1, 2, 3


@borrowing
def fermat(ax, ay, az, bx, by, bz, cx, cy, cz, wa, wb, wc):
    """The point whose weighted distances to three points sum to the least, and which of the three it falls on.

    In the triangle whose sides are the weights, of angles ``theta``, it has barycentric coordinates proportional to
    ``w_i d_jk / sin(alpha_i + theta_i)``, ``alpha`` being the angles of the triangle of points; a sine that is not
    positive means point ``i``. Both factors follow from the squares of the sides without trigonometry.
    """
    product = (wa + wb + wc) * (wb + wc - wa) * (wa + wc - wb) * (wa + wb - wc)
    if product <= 0.0:
        if wa >= wb and wa >= wc:
            return ax, ay, az, AT_FIRST
        if wb >= wc:
            return bx, by, bz, AT_SECOND
        return cx, cy, cz, AT_THIRD
    ab = (ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2
    ac = (ax - cx) ** 2 + (ay - cy) ** 2 + (az - cz) ** 2
    bc = (bx - cx) ** 2 + (by - cy) ** 2 + (bz - cz) ** 2
    area_w = np.sqrt(product)
    area = np.sqrt(max(4.0 * ab * ac - (ab + ac - bc) ** 2, 0.0))
    ka = (ab + ac - bc) * area_w + (wb * wb + wc * wc - wa * wa) * area
    kb = (ab + bc - ac) * area_w + (wa * wa + wc * wc - wb * wb) * area
    kc = (ac + bc - ab) * area_w + (wa * wa + wb * wb - wc * wc) * area
    if ka <= 0.0:
        return ax, ay, az, AT_FIRST
    if kb <= 0.0:
        return bx, by, bz, AT_SECOND
    if kc <= 0.0:
        return cx, cy, cz, AT_THIRD
    fa, fb, fc = kb * kc, ka * kc, ka * kb
    scale = 1.0 / (fa + fb + fc)
    fa, fb, fc = fa * scale, fb * scale, fc * scale
    return (
        fa * ax + fb * bx + fc * cx,
        fa * ay + fb * by + fc * cy,
        fa * az + fb * bz + fc * cz,
        NOWHERE,
    )
