"""Walls that segments may not cross, as planes that one point of a segment each keeps to one side of.

The optimum without walls shows which segments leave the domain and where they do so most. There the wall is replaced
by its tangent plane; the optimum under these planes shows others, or that the planes lie elsewhere by now, and so on.
A plane acts on both ends of its segment in the shares of the point, so that nodes slide along the wall.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from generator.domain import Domain

if TYPE_CHECKING:
    from generator.geometry.problem import Problem

_SAMPLES = 33
_MARGIN = 0.03
"""Distance that planes keep from the wall, in mean lengths: walls are curved, and sampled."""
_PROBE_MM = 1e-2


@dataclass(frozen=True, eq=False)
class Walls:
    """``normal @ y >= offset_mm`` for the point ``y`` at ``share`` (0 to 1) of each ``segment``.

    ``segment`` (K,), ``share`` (K,), ``normal`` (K, 3) into the domain, ``offset_mm`` (K,), and ``pull`` (K,), a first
    guess of the forces in mm^2 with which they hold. ``margin_mm`` is what a violation is measured in.
    """

    segment: np.ndarray
    share: np.ndarray
    normal: np.ndarray
    offset_mm: np.ndarray
    pull: np.ndarray
    margin_mm: float

    def gap_mm(self, parent: np.ndarray, position_mm: np.ndarray) -> np.ndarray:
        """(K,) how far each point is beyond its plane; negative within."""
        far, near = position_mm[self.segment], position_mm[parent[self.segment]]
        point = near + self.share[:, None] * (far - near)
        return self.offset_mm - (self.normal * point).sum(axis=1)


def walls_met(problem: Problem, position_mm: np.ndarray, domain: Domain, offending: np.ndarray) -> Walls:
    """The problem's walls, and those of ``offending`` segments, where they are deepest now.

    Ends that stay are no such places, and where they are close to the wall the margin is half of that.

    :param offending: (M,) segments that are not wholly inside.
    """
    known = problem.walls
    segment = offending if known is None else np.union1d(known.segment, offending)
    pull = np.zeros(segment.size)
    if known is not None:
        pull[np.searchsorted(segment, known.segment)] = known.pull
    ends = np.stack((problem.topology.parent[segment], segment), axis=1)
    near, far = position_mm[ends[:, 0]], position_mm[ends[:, 1]]
    share = np.linspace(0.0, 1.0, _SAMPLES)
    points = near[:, None] + share[:, None] * (far - near)[:, None]
    inside_mm = domain.wall_distance_mm(points.reshape(-1, 3)).reshape(segment.size, _SAMPLES)
    widest = _MARGIN * float(problem.lengths(position_mm)[problem.free].mean())
    at_ends = inside_mm[:, [0, -1]]
    margin = np.minimum(widest, 0.5 * np.where(problem.moves[ends], np.inf, at_ends).min(axis=1))
    inside_mm[:, [0, -1]] = np.where(problem.moves[ends], at_ends, np.inf)
    deepest = inside_mm.argmin(axis=1)
    each = np.arange(segment.size)
    point = points[each, deepest]
    normal = np.empty_like(point)
    for k, probe in enumerate(_PROBE_MM * np.eye(3)):
        normal[:, k] = domain.wall_distance_mm(point + probe) - domain.wall_distance_mm(point - probe)
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
    offset = (normal * point).sum(axis=1) - inside_mm[each, deepest] + margin
    return Walls(segment, share[deepest], normal, offset, pull, widest)


class WallForces:
    """Walls in the reduced space: augmented Lagrangians, as for the bounds on lengths.

    A wall with multiplier ``pull`` and stiffness ``bound`` pushes with ``hold = max(0, pull + bound gap)``.
    """

    def __init__(self, problem: Problem, walls: Walls) -> None:
        self.walls, self.parent = walls, problem.topology.parent
        ends = np.concatenate((walls.segment, self.parent[walls.segment]))
        parts = np.concatenate((walls.share, 1.0 - walls.share))
        self._ends, self._parts = ends, np.where(problem.moves[ends], parts, 0.0)
        self.pull = np.array(walls.pull)
        self.hold, self.bound = self.pull.copy(), np.zeros(self.pull.size)

    def cost(self, position: np.ndarray) -> float:
        """What the walls add to the cost."""
        self.hold = np.maximum(0.0, self.pull + self.bound * self.walls.gap_mm(self.parent, position))
        on = self.bound > 0.0
        return float(((self.hold**2 - self.pull**2)[on] / (2.0 * self.bound[on])).sum())

    def add_to(self, gradient: np.ndarray, force: np.ndarray | None = None) -> None:
        """Add the derivative of that by the positions (N, 3); of another ``force`` (K,) if one is given."""
        push = (self.hold if force is None else force)[:, None] * self.walls.normal
        np.subtract.at(gradient, self._ends, self._parts[:, None] * np.tile(push, (2, 1)))

    def stiffen(self, slope: np.ndarray, stiffening: float, length_mm: float) -> None:
        """Stiffness in proportion to the tension of the segments."""
        pressing = np.maximum(slope[self.walls.segment], 1e-3 * slope.max() + 1e-12)
        self.bound = np.maximum(self.bound, stiffening * pressing / length_mm)

    def anchor(self, diagonal: np.ndarray) -> None:
        """Add the stiffness of the walls that push to the blocks of the nodes (N, 6)."""
        self._stiffen_nodes(diagonal, self.hold > 0.0)

    def foresee(self, position: np.ndarray, step: np.ndarray, diagonal: np.ndarray, rhs: np.ndarray) -> bool:
        """Whether a step (N, 3), to be taken off, runs into walls that do not push yet; puts them into the next."""
        force = self.pull + self.bound * self.walls.gap_mm(self.parent, position)
        after = self.pull + self.bound * self.walls.gap_mm(self.parent, position - step)
        met = (force <= 0.0) & (after > 0.0)
        self._stiffen_nodes(diagonal, met)
        self.add_to(rhs, np.where(met, force, 0.0))
        return bool(met.any())

    def _stiffen_nodes(self, diagonal: np.ndarray, on: np.ndarray) -> None:
        """``(s a + (1 - s) b)^2`` is at most ``s a^2 + (1 - s) b^2``: no block couples the two ends."""
        x, y, z = self.walls.normal.T
        blocks = np.stack((x * x, x * y, x * z, y * y, y * z, z * z), axis=1) * (self.bound * on)[:, None]
        np.add.at(diagonal, self._ends, self._parts[:, None] * np.tile(blocks, (2, 1)))

    def update(self, position: np.ndarray) -> float:
        """New multipliers; the largest violation, relative to the margin."""
        gap = self.walls.gap_mm(self.parent, position)
        self.pull = np.maximum(0.0, self.pull + self.bound * gap)
        gap = np.where(self.pull > 0.0, np.abs(gap), gap)
        return max(0.0, float(gap.max()) / self.walls.margin_mm)

    def found(self) -> Walls:
        """The walls with the forces that were found."""
        return replace(self.walls, pull=self.pull)
