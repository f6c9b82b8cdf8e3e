"""What a user would do instead: scikit-image's thinning and skan's graph, or kimimaro's paths (GPL, so never needed
here), and a clean-up that gives either a fair chance.

The clean-up is the common one: largest component, loops opened at their thinnest branch, tips that do not stick out of
their parent removed, radii from the distance map, junctions contracted as everywhere.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from vascval.core.contraction import contract_degenerate
from vascval.core.tree import Topology, Tree
from vascval.io.volumes import Volume


@dataclass(eq=False)
class Branch:
    """A path between two graph nodes ``ends``: its points (K, 3) in mm and the distances (K,) to the wall there."""

    ends: tuple[int, int]
    points: np.ndarray
    wall: np.ndarray

    @property
    def length(self) -> float:
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())

    @property
    def radius(self) -> float:
        return float(np.median(self.wall))

    def reversed(self) -> Branch:
        return Branch(self.ends[::-1], self.points[::-1], self.wall[::-1])

    def joined(self, other: Branch) -> Branch:
        """This branch and ``other``, which begins where it ends."""
        points, wall = np.vstack((self.points, other.points[1:])), np.append(self.wall, other.wall[1:])
        return Branch((self.ends[0], other.ends[1]), points, wall)


def skan_tree(volume: Volume, root_mm: np.ndarray) -> tuple[Tree, dict[str, float]]:
    """Tree and record of the run: ``n_loops_cut``, ``n_spurs_pruned``, wall seconds of each stage.

    :param root_mm: the end nearest to this point becomes the root.
    """
    from scipy.ndimage import distance_transform_edt
    from skan import Skeleton, summarize
    from skimage.measure import label
    from skimage.morphology import skeletonize

    begin = time.perf_counter()
    labels = label(volume.values > 0, connectivity=3)
    mask = labels == np.bincount(labels.ravel())[1:].argmax() + 1
    del labels
    ready = time.perf_counter()
    thin = skeletonize(mask)
    thinned = time.perf_counter()
    skeleton = Skeleton(thin, spacing=volume.spacing_mm[::-1])
    summarize(skeleton, separator="-")
    graphed = time.perf_counter()
    distance = distance_transform_edt(mask, sampling=volume.spacing_mm[::-1])
    measured = time.perf_counter()
    branches = []
    for i in range(skeleton.n_paths):
        nodes, index = skeleton.path(i), skeleton.path_coordinates(i).astype(int)
        ends = (int(nodes[0]), int(nodes[-1]))
        branches.append(Branch(ends, volume.to_world(index[:, ::-1]), distance[tuple(index.T)]))
    branches, n_loops = _spanning(branches)
    branches, root, n_spurs = _pruned(branches, root_mm)
    tree = contract_degenerate(_as_tree(branches, root))
    record = {
        "n_loops_cut": n_loops,
        "n_spurs_pruned": n_spurs,
        "component_s": ready - begin,
        "thinning_s": thinned - ready,
        "graph_s": graphed - thinned,
        "radii_s": measured - graphed,
    }
    return tree, record


def kimimaro_tree(volume: Volume, root_mm: np.ndarray) -> tuple[Tree, dict[str, float]]:
    """Tree and record of a run of kimimaro (TEASAR); as :func:`skan_tree`. Its paths have no loops.

    A path claims what lies within ``TEASAR["scale"]`` radii and ``TEASAR["const"]`` voxels of it.
    """
    import kimimaro

    begin = time.perf_counter()
    spacing = volume.spacing_mm[::-1]
    params = {**TEASAR, "const": TEASAR["const"] * float(spacing.min())}
    mask = (volume.values > 0).astype(np.uint8)
    made = kimimaro.skeletonize(mask, params, anisotropy=tuple(spacing), progress=False, parallel=1)[1]
    traced = time.perf_counter()
    points = volume.to_world((made.vertices / spacing)[:, ::-1])
    branches, n_loops = _spanning(_chains(made.edges, points, np.asarray(made.radius, dtype=np.float64)))
    branches, root, n_spurs = _pruned(_largest(branches), root_mm)
    record = {"n_loops_cut": n_loops, "n_spurs_pruned": n_spurs, "thinning_s": traced - begin, "graph_s": 0.0}
    return contract_degenerate(_as_tree(branches, root)), record


TEASAR = {"scale": 1.5, "const": 3.0}


def _chains(edges: np.ndarray, points: np.ndarray, wall: np.ndarray) -> list[Branch]:
    """The paths between ends and junctions of a graph of points."""
    at: dict[int, list[int]] = {}
    for a, b in edges.tolist():
        at.setdefault(a, []).append(b)
        at.setdefault(b, []).append(a)
    nodes = {point for point, near in at.items() if len(near) != 2}
    chains = []
    for node in sorted(nodes):
        for step in at[node]:
            chain = [node, step]
            while chain[-1] not in nodes:
                chain.append(next(point for point in at[chain[-1]] if point != chain[-2]))
            if chain[0] < chain[-1]:
                chains.append(Branch((chain[0], chain[-1]), points[chain], wall[chain]))
    return chains


def _largest(branches: list[Branch]) -> list[Branch]:
    """The branches that hang together, those of the greatest length in all."""
    table = np.array([branch.ends for branch in branches])
    graph = coo_matrix((np.ones(len(table)), table.T), shape=(table.max() + 1,) * 2)
    part = connected_components(graph, directed=False)[1][table[:, 0]]
    best = np.bincount(part, weights=[branch.length for branch in branches]).argmax()
    return [branch for branch, own in zip(branches, part) if own == best]


def _spanning(branches: list[Branch]) -> tuple[list[Branch], int]:
    """The branches without those that close a loop, thinnest first to go; and how many went."""
    leader: dict[int, int] = {}

    def find(node: int) -> int:
        while leader.setdefault(node, node) != node:
            node = leader[node]
        return node

    kept = []
    for branch in sorted(branches, key=lambda b: -b.radius):
        a, b = find(branch.ends[0]), find(branch.ends[1])
        if a != b:
            leader[a] = b
            kept.append(branch)
    return kept, len(branches) - len(kept)


def _pruned(branches: list[Branch], root_mm: np.ndarray) -> tuple[list[Branch], int, int]:
    """Without tips shorter than the vessel that they leave is thick; the root's node; the number of tips removed.

    The shortest goes first; branches that meet at a node where nothing else is left are joined.
    """
    degree = _degree(branches)
    ends = {n: (b.points[0] if n == b.ends[0] else b.points[-1]) for b in branches for n in b.ends if degree[n] == 1}
    root = min(ends, key=lambda n: float(np.linalg.norm(ends[n] - root_mm)))
    n_spurs = 0
    while True:
        branches = _without_pairs(branches, root)
        degree = _degree(branches)
        spurs = []
        for branch in branches:
            for b in (branch, branch.reversed()):
                tip, junction = b.ends
                if degree[tip] == 1 and tip != root and degree[junction] > 2 and b.length < b.wall[-1]:
                    spurs.append((b.length, len(spurs), branch))
        if not spurs:
            return branches, root, n_spurs
        branches.remove(min(spurs)[2])
        n_spurs += 1


def _degree(branches: list[Branch]) -> dict[int, int]:
    nodes, count = np.unique([b.ends for b in branches], return_counts=True)
    return dict(zip(nodes.tolist(), count.tolist()))


def _without_pairs(branches: list[Branch], root: int) -> list[Branch]:
    """Branches joined wherever exactly two meet."""
    at: dict[int, list[Branch]] = {}
    for branch in branches:
        for node in branch.ends:
            at.setdefault(node, []).append(branch)
    for node in list(at):
        if len(at[node]) != 2 or node == root:
            continue
        first, second = at[node]
        first_on = first if first.ends[1] == node else first.reversed()
        joined = first_on.joined(second if second.ends[0] == node else second.reversed())
        for end, old in ((joined.ends[0], first), (joined.ends[1], second)):
            at[end] = [joined if b is old else b for b in at[end]]
        del at[node]
    return list(dict.fromkeys(branch for meeting in at.values() for branch in meeting))


def _as_tree(branches: list[Branch], root: int) -> Tree:
    at: dict[int, list[Branch]] = {}
    for branch in branches:
        for b in (branch, branch.reversed()):
            at.setdefault(b.ends[0], []).append(b)
    start = at[root][0].points[0]
    parent, position, radius, lines, queue = [-1], [start], [0.0], [], [(root, 0, -1)]
    for node, index, came_from in queue:
        for branch in at[node]:
            if branch.ends[1] != came_from:
                queue.append((branch.ends[1], len(parent), node))
                parent.append(index)
                position.append(branch.points[-1])
                radius.append(branch.radius)
                lines.append(branch.points)
    offset = np.concatenate(([0, 0], np.cumsum([len(line) for line in lines])))
    return Tree(
        Topology(np.array(parent)),
        np.array(position),
        np.array(radius),
        polyline_mm=np.concatenate(lines),
        polyline_offset=offset,
    )
