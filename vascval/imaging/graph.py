"""The skeleton as a rooted tree of branches; its loops are opened in :mod:`vascval.imaging.loops`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

from vascval.imaging import _graph_kernels as kernels
from vascval.imaging.voxels import Voxels


@dataclass(frozen=True, eq=False)
class SkeletonGraph:
    """Skeleton voxels joined to one tree.

    * ``voxel`` (k,): index of each skeleton point into the list of foreground voxels.
    * ``edges`` (e, 2): the pairs that the spanning tree keeps.
    * ``cuts`` (c, 2): the pairs at which a loop was opened, one for each independent loop.
    """

    voxel: np.ndarray
    edges: np.ndarray
    cuts: np.ndarray


@dataclass(frozen=True, eq=False)
class Branches:
    """A rooted tree of chains of skeleton points.

    * ``parent`` (s,): the branch that feeds each branch, -1 where it springs from the root point; parents come first.
    * ``point`` (m,), ``offset`` (s + 1,): branch ``b`` runs through the skeleton points
      ``point[offset[b]:offset[b + 1]]``, both junctions included, proximal end first.
    """

    parent: np.ndarray
    point: np.ndarray
    offset: np.ndarray

    @property
    def n(self) -> int:
        return int(self.parent.size)

    @property
    def first(self) -> np.ndarray:
        """(s,) the point in which each branch begins."""
        return self.point[self.offset[:-1]]

    @property
    def last(self) -> np.ndarray:
        """(s,) the point in which each branch ends; of one branch alone."""
        return self.point[self.offset[1:] - 1]

    def chain(self, branch: int) -> np.ndarray:
        return self.point[self.offset[branch] : self.offset[branch + 1]]


def spanning_skeleton(voxels: Voxels, left: np.ndarray, thickness_mm: np.ndarray) -> SkeletonGraph:
    """Join the voxels that thinning left to a tree that keeps the thickest connections.

    The maximum spanning tree by the thickness of the thinner of two neighbours opens every loop at its thinnest place.

    :param left: (n,) bool, from :func:`vascval.imaging.thinning.thin`.
    :param thickness_mm: (n,) distance map.
    """
    voxel = np.flatnonzero(left).astype(np.int32)
    number = np.full(voxels.n, -1, dtype=np.int32)
    number[voxel] = np.arange(voxel.size, dtype=np.int32)
    a, b = kernels.skeleton_edges(voxel, number, voxels.lattice)
    thickness = thickness_mm[voxel]
    index = voxels.index_xyz(voxel) * voxels.spacing_mm
    step = np.sqrt(((index[a] - index[b]) ** 2).sum(axis=1))
    # least weight = thickest; among equals the shorter step
    weight = 1.0 + thickness.max() - np.minimum(thickness[a], thickness[b]) + 1e-6 * step / step.max(initial=1e-300)
    graph = coo_matrix((weight, (a, b)), shape=(voxel.size, voxel.size)).tocsr()
    tree = minimum_spanning_tree(graph).tocoo()
    pair = a.astype(np.int64) * voxel.size + b
    kept = np.isin(pair, tree.row.astype(np.int64) * voxel.size + tree.col)
    rank = np.argsort(weight, kind="stable")
    loops = rank[kernels.independent_loops(voxel.size, a[rank], b[rank], kept[rank])]
    ends = np.stack((a, b), axis=1)
    return SkeletonGraph(voxel, ends[kept], ends[loops])


def rooted(skeleton: SkeletonGraph, root: int) -> tuple[np.ndarray, np.ndarray]:
    """Breadth-first order of the skeleton points from a root, and the parent of each (-1 at the root)."""
    n = skeleton.voxel.size
    ends = skeleton.edges
    graph = coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(n, n)).tocsr()
    order, parent = breadth_first_order(graph, root, directed=False)
    parent = parent.astype(np.int32)
    parent[root] = -1
    return order, parent


def branches(order: np.ndarray, parent: np.ndarray, ends: np.ndarray) -> Branches:
    """Cut the tree of skeleton points into branches between root, junctions and the given end points.

    Points that lie on no way from an end to the root are left out; an end on another's way is no end of its own.
    """
    kept = kernels.mark_paths(parent, ends.astype(np.int32))
    n_children = np.bincount(parent[kept & (parent >= 0)], minlength=parent.size)
    of_point = np.full(parent.size, -1, dtype=np.int64)
    parents: list[int] = []
    chains: list[list[int]] = []
    for point in order[1:].tolist():
        if not kept[point]:
            continue
        above = int(parent[point])
        inside = above >= 0 and parent[above] >= 0 and n_children[above] == 1
        if inside:
            branch = int(of_point[above])
            chains[branch].append(point)
        else:
            branch = len(chains)
            parents.append(int(of_point[above]))
            chains.append([above, point])
        of_point[point] = branch
    offset = np.concatenate(([0], np.cumsum([len(chain) for chain in chains]))).astype(np.int64)
    point = np.concatenate([np.asarray(chain) for chain in chains]) if chains else np.empty(0)
    return Branches(np.asarray(parents, dtype=np.int32), point.astype(np.int32), offset)


def thickest_end(skeleton: SkeletonGraph, ends: np.ndarray, thickness_mm: np.ndarray) -> int:
    """The end point whose branch is the thickest: where the vessel enters.

    The thickness of an end's branch is the median of the distance map between the end and the next junction; equal ones
    are told apart by the mean.
    """
    order, parent = rooted(skeleton, int(ends[0]))
    tree = branches(order, parent, ends)
    at = thickness_mm[skeleton.voxel]
    n_children = np.bincount(tree.parent[tree.parent >= 0], minlength=tree.n)
    best, best_thickness = int(ends[0]), (-1.0, -1.0)
    for branch in range(tree.n):
        chain = tree.chain(branch)
        from_root = tree.parent[branch] == -1 and chain[0] == ends[0]
        if n_children[branch] and not from_root:
            continue
        thickness = (float(np.median(at[chain])), float(np.mean(at[chain])))
        end = int(chain[0]) if from_root else int(chain[-1])
        if thickness > best_thickness:
            best, best_thickness = end, thickness
    return best
