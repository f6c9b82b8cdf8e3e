"""From a segmented volume to a tree: mask, distance map, centreline, graph, radii."""
