"""Where a tree may grow. A domain answers: volume, contains, segment inside, uniform sample, distance to the wall."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from generator import _domain_kernels as kernels
from generator._domain_kernels import Space
from vascval.core.errors import InputError


class Domain(ABC):
    """A bounded, connected part of space, in mm in the world frame.

    Points are arrays of shape (K, 3). The wall belongs to the domain or not as rounding has it.
    """

    name: str
    volume_mm3: float
    lower_mm: np.ndarray
    upper_mm: np.ndarray
    notes: tuple[str, ...] = ()

    @property
    @abstractmethod
    def space(self) -> Space:
        """The domain as the compiled kernels see it."""

    @abstractmethod
    def contains(self, points_mm: np.ndarray) -> np.ndarray:
        """(K,) whether each point is inside."""

    @abstractmethod
    def wall_distance_mm(self, points_mm: np.ndarray) -> np.ndarray:
        """(K,) distance to the wall, positive inside and negative outside."""

    @abstractmethod
    def sample(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """(count, 3) points, uniform in the domain."""

    def segments_inside(self, start_mm: np.ndarray, end_mm: np.ndarray) -> np.ndarray:
        """(K,) whether each straight segment is inside as a whole."""
        start, end = _points(start_mm), _points(end_mm)
        inside = self.contains(start) & self.contains(end)
        inside[inside] = kernels.inside_along(self.space, start[inside], end[inside])
        return inside

    def require_inside(self, point_mm: np.ndarray, what: str) -> None:
        """:raises InputError: when the point is not finite or outside; the distance to the wall is stated."""
        point = np.asarray(point_mm, dtype=np.float64)
        at = ", ".join(f"{value:g}" for value in point)
        if point.shape != (3,) or not np.isfinite(point).all():
            raise InputError(f"{what} ({at}) is no point; three finite coordinates in mm are needed")
        if not self.contains(point[None])[0]:
            away = -float(self.wall_distance_mm(point[None])[0])
            low, high = np.round(self.lower_mm, 3).tolist(), np.round(self.upper_mm, 3).tolist()
            raise InputError(
                f"{what} ({at}) lies outside the domain, {away:.3g} mm from it; choose a point inside, "
                f"between {low} and {high} mm"
            )


def _points(points_mm: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(points_mm, dtype=np.float64).reshape(-1, 3)


_SIDES_MM = (1e-3, 1e6)


class Box(Domain):
    """An axis-parallel box from ``origin_mm`` with sides ``size_mm``; the wall is inside.

    :raises InputError: when a side is not positive and finite, or absurd.
    """

    name = "box"

    def __init__(self, size_mm: ArrayLike, origin_mm: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        size, origin = np.asarray(size_mm, dtype=np.float64), np.asarray(origin_mm, dtype=np.float64)
        if size.shape != (3,) or not (np.isfinite(size).all() and (size > 0).all()):
            raise InputError(f"a box with sides {size.tolist()} mm has no volume; three positive sides are needed")
        if size.min() < _SIDES_MM[0] or size.max() > _SIDES_MM[1]:
            raise InputError(f"a box with sides {size.tolist()} mm holds no vessels; give sides from 1 um to 1 km")
        if origin.shape != (3,) or not np.isfinite(origin).all():
            raise InputError(f"the corner of the box, {origin.tolist()}, is no point; give three finite coordinates")
        self.lower_mm, self.upper_mm = origin, origin + size
        self.volume_mm3 = float(size.prod())

    @cached_property
    def space(self) -> Space:
        size = self.upper_mm - self.lower_mm
        return convex_space(np.column_stack([np.diag(1.0 / size), -self.lower_mm / size]))

    def contains(self, points_mm: np.ndarray) -> np.ndarray:
        points = _points(points_mm)
        return np.all((points >= self.lower_mm) & (points <= self.upper_mm), axis=1)

    def wall_distance_mm(self, points_mm: np.ndarray) -> np.ndarray:
        points = _points(points_mm)
        beyond = np.maximum(self.lower_mm - points, points - self.upper_mm)
        outside = np.sqrt((np.maximum(beyond, 0.0) ** 2).sum(axis=1))
        return np.where(outside > 0.0, -outside, -beyond.max(axis=1))

    def sample(self, count: int, rng: np.random.Generator) -> np.ndarray:
        return self.lower_mm + rng.random((count, 3)) * (self.upper_mm - self.lower_mm)


def convex_space(to_cell: np.ndarray | None = None) -> Space:
    """A domain of which every two points see each other: one cell, or all space where it is not given."""
    return Space(
        True, np.ones((1, 1, 1), np.uint8), np.zeros((3, 4)) if to_cell is None else to_cell, np.zeros(2, np.int64),
        np.zeros(0, np.int32), np.zeros((0, 3, 3)),
    )  # fmt: skip
