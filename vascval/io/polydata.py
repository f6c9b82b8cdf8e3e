"""VTK poly data as plain arrays, whichever file they come from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from vascval.core.errors import InputError


@dataclass(frozen=True)
class PolyData:
    """Points and lines (or polygons instead, where these were asked for) of a file, in its own units.

    ``points`` (P, 3); the points of line ``i`` are ``connectivity[offsets[i]:offsets[i + 1]]``; ``point_data`` and
    ``cell_data`` by name (the cells being the lines); ``texts``: the strings that stand beside them.
    """

    points: np.ndarray
    offsets: np.ndarray
    connectivity: np.ndarray
    point_data: Mapping[str, np.ndarray] = field(default_factory=dict)
    cell_data: Mapping[str, np.ndarray] = field(default_factory=dict)
    texts: Mapping[str, str] = field(default_factory=dict)


def require_sound(path: Path, data: PolyData, kind: str = "lines") -> None:
    """Refuses poly data without lines (or polygons, the ``kind`` wanted), with indices of points that do not exist, or
    with points that are not finite."""
    if len(data.points) == 0 or len(data.offsets) < 2:
        need = "a tree needs lines between its points" if kind == "lines" else "save the closed surface as polygons"
        raise InputError(f"{path}: holds no {kind}; {need}")
    offsets, ids = data.offsets, data.connectivity
    if offsets[0] != 0 or (np.diff(offsets) < 0).any() or offsets[-1] != len(ids):
        raise InputError(f"{path}: the offsets of its {kind} do not fit; it is damaged")
    outside = np.flatnonzero((ids < 0) | (ids >= len(data.points)))
    if outside.size:
        raise InputError(
            f"{path}: its {kind} name {outside.size} points that do not exist (first: {ids[outside[0]]} of "
            f"{len(data.points)}); it is damaged"
        )
    bad = np.flatnonzero(~np.isfinite(data.points).all(axis=1))
    if bad.size:
        raise InputError(f"{path}: {bad.size} points are not finite (first: point {bad[0]}); mend or drop them")
