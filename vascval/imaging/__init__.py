"""From a segmented volume to a tree: mask, distance map, centreline, graph, radii."""

from vascval.imaging.skeletonization import Skeleton, skeletonize

__all__ = ["Skeleton", "skeletonize"]
