"""Convex hulls as stand-ins for tissue that nobody segmented."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError


@dataclass(frozen=True, eq=False)
class Hull:
    """A convex body: ``volume_mm3``; ``facets`` (F, 4), inside where ``facets[:, :3] @ x + facets[:, 3] <= 0``; the
    rows of ``axes`` (3, 3), its principal directions, shortest first; ``low`` and ``high`` (3,), its box along them.
    """

    volume_mm3: float
    facets: np.ndarray
    axes: np.ndarray
    low: np.ndarray
    high: np.ndarray


def convex_hull(points: np.ndarray) -> Hull | None:
    """The convex hull of ``points`` (K, 3); ``None`` when they span no volume to speak of (fewer than four points, or
    thinner than a thousandth of their extent)."""
    if len(points) < 4:
        return None
    _, axes = np.linalg.eigh(np.cov(points.T))
    along = points @ axes
    low, high = along.min(axis=0), along.max(axis=0)
    if (high - low).min() <= 1e-3 * (high - low).max():
        return None
    try:
        hull = ConvexHull(points)
    except QhullError:
        return None
    return Hull(float(hull.volume), hull.equations, axes.T, low, high)


def grid_inside(hull: Hull, *others: Hull, n_points: int) -> np.ndarray:
    """(K, 3) points of a cubic grid inside all hulls; the pitch gives about ``n_points`` in the first.

    The grid lies along the principal axes of the first hull, centred in its box, so that it turns and scales with it.
    Every line of the grid meets a convex body in one interval: it is clipped by the facets.
    """
    pitch = (hull.volume_mm3 / n_points) ** (1 / 3)
    count = np.maximum(np.ceil((hull.high - hull.low) / pitch).astype(int), 1)
    middle = (hull.low + hull.high) / 2
    u, v, w = [middle[k] + pitch * (np.arange(count[k]) - (count[k] - 1) / 2) for k in range(3)]
    plane = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
    bottom, top = np.full(len(plane), -np.inf), np.full(len(plane), np.inf)
    facets = np.concatenate([body.facets for body in (hull, *others)])
    for (nu, nv, nw), offset in zip(facets[:, :3] @ hull.axes.T, facets[:, 3]):
        rest = -(plane @ np.array([nu, nv]) + offset)  # inside: nw w <= rest
        if nw > 0:
            np.minimum(top, rest / nw, out=top)
        elif nw < 0:
            np.maximum(bottom, rest / nw, out=bottom)
        else:
            top[rest < 0] = -np.inf
    column, level = np.nonzero((w >= bottom[:, None]) & (w <= top[:, None]))
    return np.column_stack((plane[column], w[level])) @ hull.axes
