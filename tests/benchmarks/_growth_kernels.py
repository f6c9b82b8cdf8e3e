"""Kernels of the growth of phantoms: the cheapest way to join a point to a tree within the rules.

A tree is ``parent`` (N,) in any numbering, node 0 the root, and ``position`` (N, 3). ``feeds`` (N,) counts the
terminals below each node. A terminal has the radius ``tip`` x (``share`` / terminals now)^(1/3) and every other
segment follows Murray's law. ``rules`` are min_aspect, min_stub, clearance, cosine of min_angle.
"""

from __future__ import annotations

import math

import numpy as np

from vascval.core.jit import njit

ALONG = (0.15, 0.3, 0.5, 0.7, 0.85)
TOWARD = (0.0, 0.1, 0.2, 0.35)


@njit(inline="always")
def _unit(value):
    return min(1.0, max(0.0, value))


@njit
def segment_distance(p, q, u, v):
    """Smallest distance between the points of segment p-q and those of segment u-v; each point (3,)."""
    a = b = c = f = g = 0.0
    for k in range(3):
        d, e, w = q[k] - p[k], v[k] - u[k], p[k] - u[k]
        a, b, c, f, g = a + d * d, b + d * e, c + e * e, f + d * w, g + e * w
    denominator = a * c - b * b
    s = _unit((b * g - c * f) / denominator) if denominator > 1e-12 * a * c else 0.0
    t = (b * s + g) / c if c > 0.0 else 0.0
    if t < 0.0 or t > 1.0:
        t = _unit(t)
        s = _unit((b * t - f) / a) if a > 0.0 else 0.0
    square = 0.0
    for k in range(3):
        square += (p[k] + s * (q[k] - p[k]) - u[k] - t * (v[k] - u[k])) ** 2
    return math.sqrt(square)


@njit
def point_distance(point, parent, position):
    """(N,) distance of a point to each segment; infinite at entry 0."""
    distance = np.full(parent.size, np.inf)
    for i in range(1, parent.size):
        distance[i] = segment_distance(point, point, position[parent[i]], position[i])
    return distance


@njit
def _cosine(position, node, a, b):
    """Cosine of the angle at ``node`` between the directions to ``a`` and ``b``."""
    dot = aa = bb = 0.0
    for k in range(3):
        u, v = position[a, k] - position[node, k], position[b, k] - position[node, k]
        dot, aa, bb = dot + u * v, aa + u * u, bb + v * v
    return dot / math.sqrt(aa * bb)


@njit
def pair_breaks_rules(i, j, parent, position, radius, leaf, rules):
    """Whether segments i and j enclose too small an angle, come too close, or one's tip hides in the other."""
    if parent[i] == parent[j]:
        if _cosine(position, parent[i], i, j) > rules[3]:
            return True
    elif parent[i] == j:
        if _cosine(position, j, i, parent[j]) > rules[3]:
            return True
    elif parent[j] == i:
        if _cosine(position, i, j, parent[i]) > rules[3]:
            return True
    else:
        gap = segment_distance(position[parent[i]], position[i], position[parent[j]], position[j])
        if gap < radius[i] + radius[j] + rules[2]:
            return True
    for tip, other in ((i, j), (j, i)):
        if leaf[tip]:
            out = segment_distance(position[tip], position[tip], position[parent[other]], position[other])
            if out < radius[other] + rules[1]:
                return True
    return False


@njit
def breaks_rules(parent, position, radius, changed, rules):
    """Whether any pair with a changed segment, or the length of any inner segment, breaks the rules."""
    leaf = np.ones(parent.size, dtype=np.bool_)
    for i in range(1, parent.size):
        leaf[parent[i]] = False
    for i in range(1, parent.size):
        if not leaf[i]:
            length = segment_distance(position[i], position[i], position[parent[i]], position[parent[i]])
            if length < 2.0 * rules[0] * radius[i]:
                return True
    for i in range(1, parent.size):
        if changed[i]:
            for j in range(1, parent.size):
                if j != i and pair_breaks_rules(i, j, parent, position, radius, leaf, rules):
                    return True
    return False


@njit
def murray_radius(feeds, tip, share):
    """(N,) radii; ``share`` is the number of terminals of the tree to be."""
    return tip * (feeds * (share / feeds[0])) ** (1.0 / 3.0)


@njit
def _try(parent, position, feeds, touched, tip, share, rules, base_volume):
    """Vessel volume gained by the tree whose last node is a new terminal, or infinity if it breaks the rules.

    ``feeds`` is brought up to date for the new terminal; ``touched`` is a segment that changed beside its path.
    """
    changed = np.zeros(parent.size, dtype=np.bool_)
    changed[touched] = touched > 0
    node = parent.size - 1
    while node != -1:
        changed[node] = True
        feeds[node] += 1
        node = parent[node]
    radius = murray_radius(feeds, tip, share)
    volume = 0.0
    for i in range(1, parent.size):
        length = segment_distance(position[i], position[i], position[parent[i]], position[parent[i]])
        volume += radius[i] ** 2 * length
    if volume >= base_volume or breaks_rules(parent, position, radius, changed, rules):
        return np.inf
    return volume


@njit
def join_segment(parent, position, feeds, point, near, tip, share, rules):
    """Split one of the segments ``near`` by a joint from which ``point`` is fed; return the new tree and its volume.

    Joints lie on the segment or a little toward the point; the volume is infinite if none keeps the rules.
    """
    n = parent.size
    best = np.inf
    best_parent, best_position, best_feeds = parent, position, feeds
    for segment in near:
        for along in ALONG:
            for toward in TOWARD:
                new_parent = np.append(parent, np.array([parent[segment], n]))
                new_parent[segment] = n
                new_feeds = np.append(feeds, np.array([feeds[segment], 0]))
                new_position = np.zeros((n + 2, 3))
                new_position[:n] = position
                joint = position[parent[segment]] + along * (position[segment] - position[parent[segment]])
                new_position[n] = joint + toward * (point - joint)
                new_position[n + 1] = point
                volume = _try(new_parent, new_position, new_feeds, segment, tip, share, rules, best)
                if volume < best:
                    best, best_parent, best_position, best_feeds = volume, new_parent, new_position, new_feeds
    return best, best_parent, best_position, best_feeds


@njit
def join_node(parent, position, feeds, point, nodes, tip, share, rules):
    """Feed ``point`` from one of ``nodes``; return the new tree and its volume, infinite if none keeps the rules."""
    n = parent.size
    best = np.inf
    best_parent, best_position, best_feeds = parent, position, feeds
    new_position = np.zeros((n + 1, 3))
    new_position[:n] = position
    new_position[n] = point
    for node in nodes:
        new_parent = np.append(parent, np.array([node]))
        new_feeds = np.append(feeds, np.array([0]))
        volume = _try(new_parent, new_position, new_feeds, 0, tip, share, rules, best)
        if volume < best:
            best, best_parent, best_position, best_feeds = volume, new_parent, new_position, new_feeds
    return best, best_parent, best_position, best_feeds


@njit
def euler_number(mask):
    """Pieces - tunnels + cavities of the closed voxels of ``mask`` (z, y, x), that touch by faces, edges or corners.

    Vertices - edges + faces - cubes of the complex of unit cubes, each counted at its lowest corner.
    """
    nz, ny, nx = mask.shape
    euler = 0
    around = np.zeros((2, 2, 2), dtype=np.bool_)
    for k in range(nz + 1):
        for j in range(ny + 1):
            for i in range(nx + 1):
                some = False
                for c in range(max(0, k - 1), min(nz, k + 1)):
                    for b in range(max(0, j - 1), min(ny, j + 1)):
                        for a in range(max(0, i - 1), min(nx, i + 1)):
                            some = some or mask[c, b, a] != 0
                if not some:
                    continue
                for c in range(2):
                    for b in range(2):
                        for a in range(2):
                            z, y, x = k + c - 1, j + b - 1, i + a - 1
                            inside = 0 <= z < nz and 0 <= y < ny and 0 <= x < nx
                            around[c, b, a] = inside and mask[z, y, x] != 0
                euler += 1 - around[1].any() - around[:, 1].any() - around[:, :, 1].any()
                euler += around[1, 1].any() + around[1, :, 1].any() + around[:, 1, 1].any() - around[1, 1, 1]
    return euler
