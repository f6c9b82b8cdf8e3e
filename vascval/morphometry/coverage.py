"""How evenly the terminals fill the tissue."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from vascval.core.errors import InputError
from vascval.core.tree import Tree
from vascval.morphometry.hull import convex_hull, grid_inside

_RANDOM = math.gamma(4 / 3) * (4 * math.pi / 3) ** (-1 / 3)
"""Mean distance to the nearest of points scattered at random with density 1: 0.5540."""


def coverage(
    tree: Tree, *, tissue_mm: np.ndarray | None = None, tissue_volume_mm3: float | None = None, n_points: int = 20_000
) -> dict[str, Any] | None:
    """Terminals per volume and the distance of tissue points to the nearest terminal
    (:class:`vascval.io.documents.Coverage`).

    The tissue is given as points that fill it evenly, ``tissue_mm`` (K, 3), with its volume if that is known. Without
    them it is the convex hull of the terminals, filled with about ``n_points`` points of a cubic grid: the hull ends
    at the outermost terminals, so that the organ is larger; the answer says which it was.

    ``None`` when no tissue is given and the terminals span no volume (fewer than four, or in one plane).

    :raises InputError: when the points are not (K, 3) finite numbers, K >= 1.
    """
    terminal = tree.position_mm[tree.topology.terminals]
    volume: float | None
    if tissue_mm is None:
        hull = convex_hull(terminal)
        if hull is None:
            return None
        points = grid_inside(hull, n_points=n_points)
        volume, domain = hull.volume_mm3, "convex hull of the terminals"
    else:
        points, volume, domain = np.asarray(tissue_mm, dtype=float), tissue_volume_mm3, "given points"
        if points.ndim != 2 or points.shape[1] != 3 or not len(points) or not np.isfinite(points).all():
            raise InputError(f"tissue points have shape {points.shape}; (K, 3) finite coordinates in mm are needed")
    distance, _ = cKDTree(terminal).query(points)
    random_mm = None if volume is None else _RANDOM * (volume / len(terminal)) ** (1 / 3)
    return {
        "domain": domain,
        "n_points": len(points),
        "volume_mm3": volume,
        "terminals_per_mm3": None if volume is None else len(terminal) / volume,
        "distance_mean_mm": float(distance.mean()),
        "distance_sd_mm": float(distance.std()),
        "distance_median_mm": float(np.median(distance)),
        "distance_q95_mm": float(np.quantile(distance, 0.95)),
        "distance_max_mm": float(distance.max()),
        "evenness": None if random_mm is None else float(distance.mean() / random_mm),
    }
