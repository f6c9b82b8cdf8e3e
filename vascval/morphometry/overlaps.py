"""Vessels that run through each other: pairs of segments whose capsules intersect."""

from __future__ import annotations

import numpy as np

from vascval.core.tree import Tree
from vascval.morphometry import _piece_kernels as kernels
from vascval.morphometry.pieces import pieces


def overlapping_pairs(tree: Tree) -> np.ndarray:
    """(K, 2) pairs of segments that intersect without being adjacent, the smaller index first, sorted.

    The body of a segment is the set of points nearer to its centreline than its radius: a capsule, or for a curved
    centreline the union of the capsules of its pieces. Two bodies intersect when the distance between the centrelines
    is less than the sum of the radii; touching does not count. Segments are adjacent, and never counted, when they
    share a node: siblings, and a segment with the one that feeds it. A pair counts once however often it intersects.
    """
    body = pieces(tree, widened=True)
    pairs = kernels.intersecting(body.start, body.end, tree.radius_mm, body.segment, tree.parent, *body.boxes)
    return np.unique(pairs, axis=0)
