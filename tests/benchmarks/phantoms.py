"""Trees with known truth and their images, to measure skeletonisation on.

A tree is grown in a box of ``size`` voxels of 1 mm: terminals, drawn at random, are joined one by one to the tree where
the vessel volume grows least, unless that breaks a rule that keeps the truth unambiguous (:class:`Rules`). Radii obey
Murray's law with exponent 3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from vascval.core.errors import ComputationError
from vascval.core.ordering import root_first
from vascval.core.tree import Topology, Tree
from vascval.imaging.rasterize import rasterize, wall_distance
from vascval.io.volumes import Volume

from . import _growth_kernels as kernels

KINDS = ("smooth", "trifurcating", "anisotropic", "rough")


@dataclass(frozen=True)
class Rules:
    """What every grown tree obeys; lengths in mm.

    * an inner segment is at least ``min_aspect`` of its diameters long, so that the contraction rule is not in doubt;
    * a terminal's tip is at least ``min_stub_mm`` away from the wall of every other segment;
    * the walls of segments without a common node are at least ``clearance_mm`` apart;
    * two segments that meet enclose at least ``min_angle_deg`` at their common node.
    """

    min_aspect: float = 1.3
    min_stub_mm: float = 6.0
    clearance_mm: float = 3.0
    min_angle_deg: float = 60.0

    def as_array(self) -> np.ndarray:
        cosine = math.cos(math.radians(self.min_angle_deg))
        return np.array([self.min_aspect, self.min_stub_mm, self.clearance_mm, cosine])


@dataclass(frozen=True, eq=False)
class Phantom:
    """An image and the tree that it shows; ``drawn`` is the same tree with the radii that the image really has.

    They differ on rough walls alone: over the few correlation lengths of a thin vessel's wall the noise does not
    average out, so that the vessel in the image is a few per cent thicker or thinner than the one meant.
    """

    name: str
    truth: Tree
    volume: Volume
    drawn: Tree


def phantom(kind: str, seed: int, *, size: int = 400, n_terminals: int = 300, bend_mm: float = 0.0) -> Phantom:
    """One of the four ``KINDS``, in a box of ``size`` mm with voxels of 1 mm.

    * smooth: the tree as it is;
    * trifurcating: 20 in 300 of the terminals spring from nodes that have two children already;
    * anisotropic: the smooth tree in voxels of 1 x 1 x 2 mm;
    * rough: the smooth tree, its wall displaced by 0.6 mm rms with correlation (:func:`rough_image`).

    All but the rough ones are free of tunnels (:func:`sound_image`).
    """
    if kind not in KINDS:
        raise ValueError(f"{kind!r} is no kind of phantom; the kinds are {', '.join(KINDS)}")
    rng = np.random.default_rng(seed)
    n_trifurcations = round(n_terminals / 15) if kind == "trifurcating" else 0
    tree = grow(rng, n_terminals=n_terminals, size=size, n_trifurcations=n_trifurcations, bend_mm=bend_mm)
    spacing = (1.0, 1.0, 2.0) if kind == "anisotropic" else (1.0, 1.0, 1.0)
    shape = (-(-size // int(spacing[2])), size, size)
    if kind == "rough":
        volume, drawn = rough_image(tree, rng, shape=shape)
    else:
        tree, volume = sound_image(tree, rng, spacing, shape)
        drawn = tree
    return Phantom(f"{kind}-{seed}", tree, volume, drawn)


def sound_image(
    tree: Tree, rng: np.random.Generator, voxel_mm: tuple[float, float, float], shape: tuple[int, int, int]
) -> tuple[Tree, Volume]:
    """The tree, shifted by less than half a millimetre, and an image of it in one piece without tunnels or cavities.

    In the crotch of a fork voxels may meet corner to corner past a gap: a tunnel that the vessels do not have. Where
    that happens depends on how the grid falls on the tree, which is drawn anew until the Euler number is 1.

    :raises ComputationError: when 50 shifts do not help.
    """
    for _ in range(50):
        shift = rng.uniform(-0.5, 0.5, 3)
        line = None if tree.polyline_mm is None else tree.polyline_mm + shift
        moved = replace(tree, position_mm=tree.position_mm + shift, polyline_mm=line)
        volume = rasterize(moved, voxel_mm=voxel_mm, shape=shape, origin_mm=(0.0, 0.0, 0.0))
        if kernels.euler_number(volume.values) == 1:
            return moved, volume
    raise ComputationError("no place on the grid makes an image without tunnels; take wider angles")


def rough_image(
    tree: Tree, rng: np.random.Generator, *, shape: tuple[int, int, int], rms_mm: float = 0.6, sigma_mm: float = 1.5
) -> tuple[Volume, Tree]:
    """The tree in voxels of 1 mm with a rough wall: distance to the wall + noise <= 0; and the tree as drawn.

    The noise is white noise under a Gaussian filter of ``sigma_mm``, scaled to ``rms_mm``; as the distance has slope 1,
    it displaces the wall along its normal by that much.
    """
    from scipy.ndimage import gaussian_filter

    noise = gaussian_filter(rng.standard_normal(shape, dtype=np.float32), sigma_mm, truncate=3.0)
    noise *= rms_mm / noise.std()
    wall = wall_distance(tree, band_mm=6.0 * rms_mm, voxel_mm=1.0, shape=shape, origin_mm=(0.0, 0.0, 0.0))
    drawn = replace(tree, radius_mm=drawn_radius(tree, noise, wall.values))
    noise += wall.values
    return replace(wall, values=(noise <= 0).view(np.uint8)), drawn


def drawn_radius(tree: Tree, noise: np.ndarray, wall: np.ndarray, *, n_around: int = 24) -> np.ndarray:
    """(N,) radius of equal cross-section of each segment after ``noise`` has displaced its ``wall`` (z, y, x; 1 mm).

    From every half millimetre of centreline, rays go out to where ``distance + noise`` is 0, by fixed-point iteration.
    Rays that end within another tube count for nothing; a segment without any keeps its radius.
    """
    from scipy.ndimage import map_coordinates

    radius = tree.radius_mm.copy()
    angle = 2.0 * np.pi * np.arange(n_around) / n_around
    for i in range(1, tree.n_nodes):
        line = resampled(tree.polyline(i), 0.5)
        along = np.gradient(line, axis=0)
        side = np.cross(along, np.eye(3)[np.abs(along).mean(axis=0).argmin()])
        side /= np.linalg.norm(side, axis=1)[:, None]
        other = np.cross(along, side) / np.linalg.norm(along, axis=1)[:, None]
        ray = np.cos(angle)[:, None, None] * side + np.sin(angle)[:, None, None] * other
        reach = np.full(ray.shape[:2], radius[i])
        for _ in range(6):
            at = (line + reach[..., None] * ray)[..., ::-1].transpose(2, 0, 1)
            reach = radius[i] - map_coordinates(noise, at, order=1, mode="nearest")
        at = (line + radius[i] * ray)[..., ::-1].transpose(2, 0, 1)
        free = map_coordinates(wall, at, order=1, mode="nearest") > -0.25
        if free.any():
            radius[i] = math.sqrt(np.mean(reach[free] ** 2))
    return radius


def resampled(line: np.ndarray, step_mm: float) -> np.ndarray:
    """(S, 3) points along a polyline (K, 3), ends included, at most a step apart and at least three."""
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))))
    s = np.linspace(0.0, along[-1], max(3, int(along[-1] / step_mm) + 2))
    return np.stack([np.interp(s, along, line[:, k]) for k in range(3)], axis=1)


def grow(
    rng: np.random.Generator,
    *,
    n_terminals: int = 300,
    size: int = 400,
    terminal_radius_mm: float = 2.0,
    n_trifurcations: int = 0,
    bend_mm: float = 0.0,
    rules: Rules | None = None,
) -> Tree:
    """A random tree in the box from 0 to ``size - 1`` mm, its root near the middle of the lower face.

    While it grows, each terminal stands for its share of the terminals to come, so that thick vessels find room.
    ``n_trifurcations`` of the terminals spring from nodes with two children. ``bend_mm`` > 0 bends the centrelines into
    half waves of at most that amplitude; the clearance is kept.

    :raises ComputationError: when the box has no room for that many terminals.
    """
    rules = rules or Rules()
    rules = replace(rules, clearance_mm=rules.clearance_mm + 2.0 * bend_mm)
    growth = _Growth(rng, n_terminals, size, terminal_radius_mm, rules)
    at_node = np.zeros(n_terminals, dtype=bool)
    at_node[rng.choice(np.arange(n_terminals // 3, n_terminals), n_trifurcations, replace=False)] = True
    for i in range(1, n_terminals):
        growth.add(at_node=bool(at_node[i]))
    tree = growth.tree()
    return bent(tree, rng, bend_mm) if bend_mm > 0 else tree


class _Growth:
    """The growing tree, nodes in the order of their making."""

    def __init__(self, rng: np.random.Generator, n: int, size: int, tip_mm: float, rules: Rules) -> None:
        self.rng, self.n, self.size, self.tip_mm = rng, n, size, tip_mm
        self.rules = rules.as_array()
        self.spread_mm = size / 3.0
        middle, low = (size - 1) / 2, tip_mm * n ** (1 / 3) + 4.0
        self.parent = np.array([-1, 0])
        self.position = np.array([[middle, middle, low], [middle, middle, 0.6 * size]])
        self.feeds = np.array([1, 1])

    def add(self, *, at_node: bool) -> None:
        """Add a terminal at a distance from the tree that shrinks when the search is long."""
        margin = self.tip_mm + 4.0
        for attempt in range(1, 20001):
            if attempt % 30 == 0:
                self.spread_mm *= 0.95
            point = self.rng.uniform(margin, self.size - 1 - margin, 3)
            distance = kernels.point_distance(point, self.parent, self.position)
            if distance.min() < self.spread_mm:
                continue
            near = np.argsort(distance, kind="stable")[:8]
            near = near[near > 0]
            tree = (self.parent, self.position, self.feeds, point)
            if at_node:
                branching = np.flatnonzero(np.bincount(self.parent[1:]) == 2)
                nodes = np.intersect1d(branching, np.concatenate((near, self.parent[near])))
                found = kernels.join_node(*tree, nodes, self.tip_mm, self.n, self.rules)
            else:
                found = kernels.join_segment(*tree, near, self.tip_mm, self.n, self.rules)
            if found[0] < math.inf:
                _, self.parent, self.position, self.feeds = found
                return
        raise ComputationError(f"no room for terminal {self.feeds[0] + 1} of {self.n} in a box of {self.size} mm")

    def tree(self) -> Tree:
        order = root_first(self.parent)
        new = np.empty_like(order)
        new[order] = np.arange(order.size)
        parent = np.concatenate(([-1], new[self.parent[order[1:]]]))
        radius = kernels.murray_radius(self.feeds, self.tip_mm, self.n)
        return Tree(Topology(parent), self.position[order], radius[order])


def bent(tree: Tree, rng: np.random.Generator, amplitude_mm: float, *, step_mm: float = 2.0) -> Tree:
    """The tree, its straight segments bent sideways into half waves: ``amplitude_mm`` or a twelfth of the length."""
    points, offset = [], [0, 0]
    for i in range(1, tree.n_nodes):
        ends = tree.polyline(i)
        direction = (ends[1] - ends[0]) / tree.chord_mm[i]
        side = np.cross(direction, rng.standard_normal(3))
        height = min(amplitude_mm, tree.chord_mm[i] / 12.0)
        s = np.linspace(0.0, 1.0, max(3, math.ceil(tree.chord_mm[i] / step_mm)))[:, None]
        line = ends[0] + s * (ends[1] - ends[0]) + height * np.sin(np.pi * s) * side / np.linalg.norm(side)
        line[[0, -1]] = ends
        points.append(line)
        offset.append(offset[-1] + len(line))
    return replace(tree, polyline_mm=np.concatenate(points), polyline_offset=np.array(offset))
