"""A closed triangle surface as a domain."""

from __future__ import annotations

from functools import cached_property
from typing import Literal

import numpy as np

from generator import _surface_kernels as kernels
from generator._domain_kernels import INSIDE, OUTSIDE, WALL, Space
from generator.domain import Domain, _points
from generator.surface_mending import mended
from vascval.core.errors import InputError

_CELLS = 400_000
"""Cells of the grid that sorts the triangles, at most."""
_JITTER = 0.2


class SurfaceDomain(Domain):
    """What a closed surface encloses; cavities are outside.

    :param points_mm: (P, 3) vertices; ``faces``: (T, 3) triangles of them. Doubled vertices, holes, turned triangles
        and inward normals are mended as described in :mod:`generator.surface_mending`.
    :param keep: ``all`` refuses several separate bodies, ``largest`` takes the largest.
    :raises InputError: when it cannot be mended or encloses nothing.
    """

    name = "surface"

    def __init__(self, points_mm: np.ndarray, faces: np.ndarray, *, keep: Literal["all", "largest"] = "all") -> None:
        vertices, triangles, notes = mended(points_mm, faces, keep)
        self._triangle = np.ascontiguousarray(vertices[triangles])
        self.notes = tuple(notes)
        self.volume_mm3 = float(enclosed_volume(self._triangle))
        self.lower_mm, self.upper_mm = vertices.min(axis=0), vertices.max(axis=0)
        size = self.upper_mm - self.lower_mm
        if not self.volume_mm3 > 1e-9 * float(np.prod(np.maximum(size, 1e-300))):
            raise InputError("the surface encloses no volume; is it a flat sheet?")
        edge = np.sqrt(((self._triangle[:, 1] - self._triangle[:, 0]) ** 2).sum(axis=1)).mean()
        self._cell = float(max(edge, (size.prod() / _CELLS) ** (1 / 3), size.max() / 1000.0))
        self._lower = self.lower_mm - self._cell
        self._sort()

    def _sort(self) -> None:
        """Cells with their triangles, and a reference point in each of which it is known whether it is inside."""
        shape = np.ceil((self.upper_mm - self._lower) / self._cell).astype(np.int64) + 1
        offset = np.zeros(int(shape.prod()) + 1, np.int64)
        none = np.zeros(0, np.int32)
        kernels.entries(self._triangle, self._lower, self._cell, shape, offset, none, True)
        offset = np.cumsum(offset)
        wall = np.empty(int(offset[-1]), np.int32)
        kernels.entries(self._triangle, self._lower, self._cell, shape, offset, wall, False)
        index = np.column_stack(np.unravel_index(np.arange(offset.size - 1), shape))
        jitter = _JITTER * (np.random.default_rng(0).random(index.shape) - 0.5)
        self._reference = self._lower + (index + 0.5 + jitter) * self._cell
        self._known = np.full(len(index), -1, np.int8)
        kernels.classify(self._triangle, offset, wall, self._reference, tuple(shape.tolist()), self._known)
        state = np.where(np.diff(offset) > 0, WALL, np.where(self._known == 1, INSIDE, OUTSIDE)).astype(np.uint8)
        to_cell = np.column_stack([np.eye(3) / self._cell, -self._lower / self._cell])
        self._space = Space(False, state.reshape(shape), to_cell, offset, wall, self._triangle)

    @property
    def space(self) -> Space:
        return self._space

    def contains(self, points_mm: np.ndarray) -> np.ndarray:
        points = _points(points_mm)
        finite = np.isfinite(points).all(axis=1)
        inside = kernels.points_inside(
            self._space, self._lower, self._cell, self._reference, self._known,
            np.where(finite[:, None], points, self._lower - 1.0),
        )  # fmt: skip
        return inside & finite

    def wall_distance_mm(self, points_mm: np.ndarray) -> np.ndarray:
        points = _points(points_mm)
        distance = np.array([abs(self._locator.EvaluateFunction(point)) for point in points.tolist()])
        return np.where(self.contains(points), distance, -distance)

    @cached_property
    def _locator(self):  # type: ignore[no-untyped-def]
        import pyvista
        from vtkmodules.vtkFiltersCore import vtkImplicitPolyDataDistance

        count = len(self._triangle)
        faces = np.column_stack([np.full(count, 3), np.arange(3 * count).reshape(-1, 3)])
        function = vtkImplicitPolyDataDistance()
        function.SetInput(pyvista.PolyData(self._triangle.reshape(-1, 3), faces.ravel()).clean())
        return function

    @cached_property
    def _cells(self) -> np.ndarray:
        return np.flatnonzero(self._space.state != OUTSIDE)

    def sample(self, count: int, rng: np.random.Generator) -> np.ndarray:
        found: list[np.ndarray] = []
        missing = count
        while missing > 0:
            cell = self._cells[rng.integers(self._cells.size, size=2 * missing + 16)]
            corner = np.column_stack(np.unravel_index(cell, self._space.state.shape))
            points = self._lower + (corner + rng.random(corner.shape)) * self._cell
            points = points[self.contains(points)][:missing]
            found.append(points)
            missing -= len(points)
        return np.concatenate(found)


def enclosed_volume(triangle: np.ndarray) -> float:
    """Volume that triangles (T, 3, 3), turned outward, enclose; relative to their mean, for accuracy."""
    a, b, c = (triangle - triangle.reshape(-1, 3).mean(axis=0)).transpose(1, 0, 2)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)
