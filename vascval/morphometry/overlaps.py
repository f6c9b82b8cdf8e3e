"""Vessels that run through each other: pairs of segments whose capsules intersect."""

from __future__ import annotations

import numpy as np

from vascval.core.tree import Tree
from vascval.morphometry import _overlap_kernels as kernels
from vascval.morphometry.preparation import polylines


def overlapping_pairs(tree: Tree) -> np.ndarray:
    """(K, 2) pairs of segments that intersect without being adjacent, the smaller index first, sorted.

    The body of a segment is the set of points nearer to its centreline than its radius: a capsule, or for a curved
    centreline the union of the capsules of its pieces. Two bodies intersect when the distance between the centrelines
    is less than the sum of the radii; touching does not count. Segments are adjacent, and never counted, when they
    share a node: siblings, and a segment with the one that feeds it. A pair counts once however often it intersects.
    """
    points, offset = polylines(tree)
    step = np.ones(len(points), dtype=bool)
    step[offset[2:] - 1] = False  # the last point of each segment begins no piece
    first = np.flatnonzero(step)
    segment = np.repeat(np.arange(1, tree.n_nodes), np.diff(offset)[1:])[first]
    start, end = points[first], points[first + 1]
    reach = tree.radius_mm[segment][:, None]
    low, high = np.minimum(start, end) - reach, np.maximum(start, end) + reach
    order = np.argsort(_morton_code((low + high) / 2), kind="stable")
    n_leaves = 1 << max(int(first.size - 1).bit_length(), 1)
    box_low, box_high = kernels.box_tree(low, high, order, n_leaves)
    pairs = kernels.intersecting(
        start, end, tree.radius_mm, segment, tree.parent, order, box_low, box_high, n_leaves
    )
    return np.unique(pairs, axis=0)


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
