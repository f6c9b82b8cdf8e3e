"""Bundled analytic shapes: level sets of a smooth function, turned into a fine closed surface of exact volume."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from generator.domain_surface import SurfaceDomain, enclosed_volume

_CELLS = 90


@dataclass(frozen=True)
class Shape:
    """``level(x, y, z)`` is negative inside; ``lower`` and ``upper`` bound it; ``root`` is a point inside."""

    level: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    root: tuple[float, float, float]
    volume_mm3: float


def _ellipsoid(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, centre: tuple[float, float, float], axes: tuple[float, float, float]
) -> np.ndarray:
    """About the distance to an ellipsoid, in mm: right to first order at its wall."""
    scaled = [(value - c) / a for value, c, a in zip((x, y, z), centre, axes)]
    squared = [(value - c) / a**2 for value, c, a in zip((x, y, z), centre, axes)]
    k = np.sqrt(sum(value**2 for value in scaled))
    return k * (k - 1.0) / np.maximum(np.sqrt(sum(value**2 for value in squared)), 1e-9)


def _union(a: np.ndarray, b: np.ndarray, blend_mm: float) -> np.ndarray:
    """Smooth minimum: two shapes grown together with a fillet."""
    h = np.clip(0.5 + 0.5 * (b - a) / blend_mm, 0.0, 1.0)
    return b + (a - b) * h - blend_mm * h * (1.0 - h)


def _liver(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """A wide right lobe, a flat left lobe, and the porta from below between them; x to the left, z upwards."""
    right = _ellipsoid(x, y, z, (-35.0, 0.0, 0.0), (68.0, 58.0, 72.0))
    left = _ellipsoid(x, y, z, (55.0, -18.0, 18.0), (72.0, 34.0, 34.0))
    porta = _ellipsoid(x, y, z, (18.0, 12.0, -48.0), (30.0, 44.0, 52.0))
    return -_union(-_union(right, left, 30.0), porta, 12.0)


def _horseshoe(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """A tube of radius 8 mm bent by half a turn of radius 30 mm, with legs of 40 mm."""
    along = np.clip(y, -40.0, 0.0)
    legs = np.sqrt((np.abs(x) - 30.0) ** 2 + (y - along) ** 2 + z**2)
    bend = np.sqrt((np.sqrt(x**2 + y**2) - 30.0) ** 2 + z**2)
    return np.where(y > 0.0, bend, legs) - 8.0


def _ball(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    return np.sqrt(x**2 + y**2 + z**2) - 30.0


SHAPES = {
    "liver": Shape(_liver, (-125, -80, -90), (145, 80, 90), (18.0, 6.0, 12.0), 1.5e6),
    "horseshoe": Shape(_horseshoe, (-45, -55, -15), (45, 45, 15), (30.0, -40.0, 0.0), 37_180.0),
    "ball": Shape(_ball, (-35, -35, -35), (35, 35, 35), (0.0, 0.0, -29.0), 4.0 / 3.0 * np.pi * 30.0**3),
}


class ShapeDomain(SurfaceDomain):
    """A bundled shape by name, scaled to its stated volume; ``root_mm`` is where blood enters by default."""

    def __init__(self, name: str) -> None:
        from skimage.measure import marching_cubes

        shape = SHAPES[name]
        lower, upper = np.array(shape.lower, dtype=np.float64), np.array(shape.upper, dtype=np.float64)
        step = float((upper - lower).max() / _CELLS)
        axes = [np.arange(low, high + step, step) for low, high in zip(lower, upper)]
        level = shape.level(*np.meshgrid(*axes, indexing="ij"))
        vertices, faces, _, _ = marching_cubes(level, 0.0, spacing=(step, step, step), gradient_direction="descent")
        vertices = vertices.astype(np.float64) + lower
        scale = np.cbrt(shape.volume_mm3 / abs(enclosed_volume(vertices[faces])))
        super().__init__(vertices * scale, faces)
        self.name = name
        self.root_mm = np.array(shape.root) * scale
