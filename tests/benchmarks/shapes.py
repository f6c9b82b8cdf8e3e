"""Small images with known truth that skeletonisation is known to stumble over; voxels of 1 mm throughout."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vascval.core.errors import ComputationError
from vascval.core.tree import Topology, Tree
from vascval.imaging.rasterize import rasterize, wall_distance
from vascval.io.volumes import Volume

from .phantoms import Phantom

ERASED_BARS = ((2, 2), (2, 4), (3, 6), (4, 3), (4, 4), (4, 6), (6, 2), (6, 3), (6, 6))
"""Cross-sections of straight bars that thinning after Lee in scikit-image 0.26.0 erases."""


def bar(axis: int, width: int, height: int, *, length: int = 40) -> Volume:
    """A bar along axis 0, 1, 2 (x, y, z), ``width`` x ``height`` voxels thick, 4 voxels of background on all sides."""
    values = np.ones((length, height, width), dtype=np.uint8)
    return Volume(np.pad(np.moveaxis(values, 0, 2 - axis), 4), np.ones(3))


def capsule(
    direction: Sequence[float], radius_mm: float, *, length_mm: float = 40.0, shift_mm: Sequence[float] = (0, 0, 0)
) -> Phantom:
    """A single straight vessel, its first end at ``shift_mm`` from the centre of a voxel."""
    start = np.asarray(shift_mm, dtype=np.float64)
    end = start + length_mm * np.asarray(direction) / np.linalg.norm(direction)
    tree = Tree(Topology(np.array([-1, 0])), np.array([start, end]), np.full(2, radius_mm))
    low = np.floor(np.minimum(start, end) - radius_mm - 3.0)
    return Phantom(f"capsule-{radius_mm:g}", tree, rasterize(tree, voxel_mm=1.0, origin_mm=low, margin_mm=3.0), tree)


def ring(*, loop_mm: float = 20.0, vessel_mm: float = 3.0) -> Phantom:
    """A vessel that parts into two half circles of radius ``loop_mm``, which meet again: one loop.

    In truth it is cut where the half circles meet; the second one ends there, the first one goes on.
    """
    angle = np.linspace(0.0, np.pi, 41)
    there = loop_mm * np.stack((np.zeros(41), np.sin(angle), -np.cos(angle)), axis=1)
    back = there * [1.0, -1.0, 1.0]
    inlet = np.array([[0.0, 0.0, -3.0 * loop_mm], there[0]])
    outlet = np.array([there[-1], [0.0, 0.0, 3.0 * loop_mm]])
    tree = _of_lines([-1, 0, 1, 1, 2], [inlet, there, back, outlet], [vessel_mm + 1, vessel_mm, vessel_mm, vessel_mm])
    return Phantom("ring", tree, rasterize(tree, voxel_mm=1.0), tree)


def touching(*, vessel_mm: float = 3.0) -> Phantom:
    """A fork whose branches lean back until their walls overlap by a fifth of a radius, and part again.

    The image has a loop; in truth there is none.
    """
    z = np.linspace(0.0, 100.0, 51)
    y = np.interp(z, [0.0, 15.0, 50.0, 85.0, 100.0], [0.0, 12.0, 0.9 * vessel_mm, 12.0, 16.0])
    lines = [np.stack((np.zeros(51), side * y, z), axis=1) for side in (1.0, -1.0)]
    stem = np.array([[0.0, 0.0, -30.0], [0.0, 0.0, 0.0]])
    tree = _of_lines([-1, 0, 1, 1], [stem, *lines], [vessel_mm * 2 ** (1 / 3), vessel_mm, vessel_mm])
    return Phantom("touching", tree, rasterize(tree, voxel_mm=1.0), tree)


def with_islands(phantom: Phantom, rng: np.random.Generator, *, n: int = 5, clearance_mm: float = 6.0) -> Phantom:
    """The phantom and ``n`` short vessels of 2 mm radius beside it that hang on nothing."""
    values = phantom.volume.values.copy()
    grid = {"voxel_mm": phantom.volume.spacing_mm, "shape": values.shape, "origin_mm": phantom.volume.origin_mm}
    wall = wall_distance(phantom.truth, band_mm=clearance_mm + 12.0, **grid).values
    size = np.array(values.shape[::-1])
    islands: list[np.ndarray] = []
    for _ in range(10000):
        if len(islands) == n:
            return replace(phantom, name=f"{phantom.name}-islands", volume=replace(phantom.volume, values=values))
        middle = rng.uniform(10.0, size * phantom.volume.spacing_mm - 10.0)
        i, j, k = np.floor(phantom.volume.to_index(middle + phantom.volume.origin_mm)).astype(int)
        if wall[k, j, i] > clearance_mm + 8.0 and all(np.linalg.norm(middle - other) > 25.0 for other in islands):
            islands.append(middle)
            ends = phantom.volume.origin_mm + middle + np.array([[-5.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
            island = Tree(Topology(np.array([-1, 0])), ends, np.array([2.0, 2.0]))
            values |= rasterize(island, **grid).values
    raise ComputationError(f"no room for {n} islands beside the vessels of {phantom.name}")


def hollow(phantom: Phantom, *, wall_mm: float = 1.5) -> Phantom:
    """The phantom with its vessels empty inside a wall of ``wall_mm``, as a cast is where the resin did not fill."""
    volume = phantom.volume
    grid = {"voxel_mm": volume.spacing_mm, "shape": volume.values.shape, "origin_mm": volume.origin_mm}
    inside = wall_distance(phantom.truth, band_mm=1.0, **grid).values < -wall_mm
    values = np.where(inside, 0, volume.values).astype(np.uint8)
    return replace(phantom, name=f"{phantom.name}-hollow", volume=replace(volume, values=values))


def _of_lines(parent: list[int], lines: list[np.ndarray], radius_mm: list[float]) -> Tree:
    position = np.array([lines[0][0], *(line[-1] for line in lines)])
    offset = np.concatenate(([0, 0], np.cumsum([len(line) for line in lines])))
    return Tree(
        Topology(np.array(parent)),
        position,
        np.array([0.0, *radius_mm]),
        polyline_mm=np.concatenate(lines),
        polyline_offset=offset,
    )
