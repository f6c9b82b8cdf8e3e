"""The scene as the page's viewer takes it: layers of tubes and a surface, packed as 16-bit numbers."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vascval.report.page import script_json
from vascval.report.scene import Surface, Tubes, bounds_mm, viewpoint
from vascval.report.style import SURFACE, Series

_STEPS = 65535


@dataclass(frozen=True)
class Layer:
    """An entry of the list of layers: its name and colour, and whether it is seen at first."""

    label: str
    colour: str
    shown: bool = True


def dots(points_mm: np.ndarray, series: Series, *, radius_mm: float) -> Tubes:
    """Balls at ``points_mm`` (K, 3), as tubes of no length."""
    points = np.asarray(points_mm, dtype="float64").reshape(-1, 3)
    radius = np.full(len(points), radius_mm)
    return Tubes(series, points, points, radius, np.zeros(len(points), dtype="int64"), 0, radius_mm)


def pack(layers: Sequence[Tubes], surface: Surface | None, *, hidden: Sequence[str] = ()) -> tuple[str, list[Layer]]:
    """JSON for the viewer, safe inside a script element, and its layers in the order of the switches.

    Positions are kept to 1/65535 of the scene's extent and radii to that part of the thickest: far below a pixel.
    ``hidden`` names the layers that are off at first.
    """
    low, high = bounds_mm(surface, layers)
    seen = viewpoint(low, high)
    size = np.maximum(high - low, 1e-9)
    thickest = max((float(layer.radius_mm.max()) for layer in layers if len(layer.radius_mm)), default=1.0)
    packed: list[dict[str, Any]] = []
    named: list[Layer] = []
    if surface is not None:
        packed.append(
            {
                "kind": "surface",
                "colour": _rgb(SURFACE),
                "nearer": surface.voxel_mm,
                "points": _base64(_grid(surface.points_mm, low, size)),
                "triangles": _base64(surface.triangles.astype("<u4")),
            }
        )
        named.append(Layer("surface of the cast", SURFACE))
    for layer in layers:
        radius = np.rint(layer.radius_mm / thickest * _STEPS).astype("<u2")
        rows = np.column_stack((_grid(layer.start_mm, low, size), _grid(layer.end_mm, low, size), radius))
        packed.append({"kind": "tubes", "colour": _rgb(layer.series.colour), "data": _base64(rows.astype("<u2"))})
        named.append(Layer(layer.series.label, layer.series.colour))
    scene = {
        "low": low.tolist(),
        "size": size.tolist(),
        "axes": seen.axes.tolist(),
        "half": [seen.half_width_mm, seen.half_height_mm],
        "thickest": thickest,
        "layers": packed,
    }
    named = [replace(layer, shown=layer.label not in hidden) for layer in named]
    return script_json(json.dumps(scene, separators=(",", ":"))), named


def _grid(points_mm: np.ndarray, low: np.ndarray, size: np.ndarray) -> np.ndarray:
    return np.rint((points_mm - low) / size * _STEPS).astype("<u2")


def _rgb(colour: str) -> list[float]:
    return [int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]


def _base64(values: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()
