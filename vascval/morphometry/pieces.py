"""Straight pieces of centrelines in a tree of bounding boxes, for exact distances in logarithmic time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vascval.core.tree import Tree
from vascval.morphometry import _piece_kernels as kernels
from vascval.morphometry.preparation import polylines


@dataclass(frozen=True, eq=False)
class Pieces:
    """(P, 3) ``start`` and ``end`` of straight pieces, the ``segment`` (P,) that each belongs to, and what its box is
    widened by, ``reach_mm`` (P,)."""

    start: np.ndarray
    end: np.ndarray
    segment: np.ndarray
    reach_mm: np.ndarray

    @cached_property
    def boxes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
        """Order of the pieces along a space-filling curve, low and high corners of the box tree, number of leaves."""
        reach = self.reach_mm[:, None]
        low, high = np.minimum(self.start, self.end) - reach, np.maximum(self.start, self.end) + reach
        order = np.argsort(_morton_code((low + high) / 2), kind="stable")
        n_leaves = 1 << max(int(order.size - 1).bit_length(), 1)
        return order, *kernels.box_tree(low, high, order, n_leaves), n_leaves

    def distance_mm(self, points: np.ndarray) -> np.ndarray:
        """(K,) distance of each of ``points`` (K, 3) from the nearest piece, exact; infinite where there is none."""
        if not len(self.segment):
            return np.full(len(points), np.inf)
        return np.sqrt(kernels.nearest(np.ascontiguousarray(points), self.start, self.end, *self.boxes))


def pieces(tree: Tree, segments: np.ndarray | None = None, *, widened: bool = False) -> Pieces:
    """The straight pieces of all segments, or of those where ``segments`` (N,) is true.

    ``widened`` makes the boxes hold the capsules, as a search for intersections needs it.
    """
    points, offset = polylines(tree)
    begins = np.ones(len(points), dtype=bool)
    begins[offset[2:] - 1] = False  # the last point of each segment begins no piece
    first = np.flatnonzero(begins)
    segment = np.repeat(np.arange(1, tree.n_nodes), np.diff(offset)[1:])[first]
    if segments is not None:
        first, segment = first[segments[segment]], segment[segments[segment]]
    reach = tree.radius_mm[segment] if widened else np.zeros(segment.size)
    return Pieces(points[first], points[first + 1], segment, reach)


def _morton_code(points: np.ndarray) -> np.ndarray:
    """(K,) place of each point on a curve that keeps neighbours together: the bits of x, y, z in turn, 20 of each."""
    span = max(float(np.ptp(points, axis=0).max()), 1e-300)
    cell = ((points - points.min(axis=0)) / span * (2**20 - 1)).astype(np.uint64)
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        cell = (cell | (cell << np.uint64(shift))) & np.uint64(mask)
    return cell[:, 0] | (cell[:, 1] << np.uint64(1)) | (cell[:, 2] << np.uint64(2))
