"""Refinement of a tree that differs from one refined already in some places alone.

Without it a single bump among a thousand vessels would have all of them refined anew.
"""

from __future__ import annotations

import numpy as np

from vascval.imaging import _refine_kernels as kernels
from vascval.imaging.first_guess import Nodes, Refined, first_guess
from vascval.imaging.graph import Branches
from vascval.imaging.refine import rounds
from vascval.imaging.voxels import Voxels


def renew(
    voxels: Voxels,
    tree: Branches,
    skeleton_voxel: np.ndarray,
    thickness_mm: np.ndarray,
    before: Branches,
    known: Refined,
) -> Refined:
    """Refine the branches near those that are new in ``tree``; the others keep the geometry ``known`` from ``before``.

    Nodes move where branches have come or gone and at the ends of new branches, and all branches that meet there are
    renewed.

    :param known: its ``owner`` is taken over and must not be used any more.
    """
    first, last = tree.first, tree.last
    old = np.full(skeleton_voxel.size, -1)
    old[before.last] = np.arange(before.n)
    same = (old[last] >= 0) & (before.first[old[last]] == first)
    moved = _degree(tree, skeleton_voxel.size) != _degree(before, skeleton_voxel.size)
    moved[first[~same]] = moved[last[~same]] = True
    new = moved[first] | moved[last]
    is_open = np.zeros(skeleton_voxel.size, dtype=bool)
    is_open[before.last] = True
    is_open[last[~new]] = False
    kernels.close(known.owner, is_open)

    part = np.flatnonzero(new)
    place = np.empty((skeleton_voxel.size, 3))
    place[np.append(before.first[:1], before.last)] = known.node_mm
    point, node = np.unique(np.concatenate((first[part], last[part])), return_inverse=True)
    nodes = Nodes(node[: part.size], node[part.size :], ~moved[point], known.clear_mm[old[last[part]]])
    drawn = first_guess(voxels, nodes, [tree.chain(b) for b in part.tolist()], skeleton_voxel, thickness_mm)
    drawn.node_mm[nodes.fixed] = place[point[nodes.fixed]]
    drawn = rounds(voxels, nodes, drawn, known.owner, last[part])
    place[point] = drawn.node_mm
    return _merged(new, drawn, old[last], known, place[np.append(first[:1], last)])


def _degree(tree: Branches, n_points: int) -> np.ndarray:
    return np.bincount(np.concatenate((tree.first, tree.last)), minlength=n_points)


def _merged(is_new: np.ndarray, new: Refined, of_old: np.ndarray, old: Refined, node_mm: np.ndarray) -> Refined:
    """Branch by branch the next of the ``new`` geometries where it ``is_new``, else the ``old`` one it names."""
    of_new = np.cumsum(is_new) - 1
    lines = [
        new.point_mm[new.offset[n] : new.offset[n + 1]] if own else old.point_mm[old.offset[o] : old.offset[o + 1]]
        for own, n, o in zip(is_new.tolist(), of_new.tolist(), of_old.tolist())
    ]
    return Refined(
        node_mm,
        np.concatenate(lines),
        np.concatenate(([0], np.cumsum([len(line) for line in lines]))).astype(np.int64),
        np.where(is_new, new.radius_mm[of_new], old.radius_mm[of_old]),
        np.where(is_new, new.radius_sd_mm[of_new], old.radius_sd_mm[of_old]),
        np.where(is_new[:, None], new.clear_mm[of_new], old.clear_mm[of_old]),
        new.owner,
    )
