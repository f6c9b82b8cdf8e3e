"""How evenly the terminals fill the tissue."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from vascval.core.errors import InputError
from vascval.core.tree import Tree

_RANDOM = math.gamma(4 / 3) * (4 * math.pi / 3) ** (-1 / 3)
"""Mean distance to the nearest of points scattered at random with density 1: 0.5540."""


def coverage(
    tree: Tree, *, tissue_mm: np.ndarray | None = None, tissue_volume_mm3: float | None = None, n_points: int = 20_000
) -> dict[str, Any] | None:
    """Terminals per volume and the distance of tissue points to the nearest terminal.

    The tissue is given as points that fill it evenly, ``tissue_mm`` (K, 3), with its volume if that is known. Without
    them it is the convex hull of the terminals, filled with about ``n_points`` points of a cubic grid: the hull ends
    at the outermost terminals, so that distances come out smaller than in the organ; the answer says which it was.

    ``None`` when no tissue is given and the terminals span no volume (fewer than four, or in one plane).

    :raises InputError: when the points are not (K, 3) finite numbers, K >= 1.
    """
    terminal = tree.position_mm[tree.topology.terminals]
    if tissue_mm is None:
        filled = hull_points(terminal, n_points=n_points)
        if filled is None:
            return None
        points, volume = filled
        domain = "convex hull of the terminals"
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


def hull_points(points: np.ndarray, *, n_points: int) -> tuple[np.ndarray, float] | None:
    """About ``n_points`` points of a cubic grid inside the convex hull of ``points`` (K, 3), and its volume in mm^3.

    The grid is centred in the bounding box. ``None`` when the points span no volume, or so little that no grid point
    falls inside.
    """
    if len(points) < 4:
        return None
    try:
        hull = ConvexHull(points)
    except QhullError:
        return None
    low, high = points.min(axis=0), points.max(axis=0)
    if hull.volume <= 1e-9 * float((high - low).max()) ** 3:
        return None
    pitch = (hull.volume / n_points) ** (1 / 3)
    count = np.maximum(np.ceil((high - low) / pitch).astype(int), 1)
    axes = [(low[k] + high[k]) / 2 + pitch * (np.arange(count[k]) - (count[k] - 1) / 2) for k in range(3)]
    plane = np.stack(np.meshgrid(axes[0], axes[1], indexing="ij"), axis=-1).reshape(-1, 2)
    normal, offset = hull.equations[:, :3], hull.equations[:, 3]
    # a vertical line meets a convex body in one interval: clip it by every facet
    rest = -(plane @ normal[:, :2].T + offset)
    with np.errstate(divide="ignore", invalid="ignore"):
        cut = rest / normal[:, 2]
    upper = np.where(normal[:, 2] > 0, cut, np.inf).min(axis=1)
    lower = np.where(normal[:, 2] < 0, cut, -np.inf).max(axis=1)
    inside = (axes[2][None, :] >= lower[:, None]) & (axes[2][None, :] <= upper[:, None])
    column, level = np.nonzero(inside)
    filled = np.column_stack((plane[column], axes[2][level]))
    return (filled, float(hull.volume)) if len(filled) else None
