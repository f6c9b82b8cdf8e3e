"""Where the refinement begins: the branches as smoothed chains of voxels, and the nodes where they meet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from vascval.imaging.voxels import Voxels


@dataclass(frozen=True, eq=False)
class Refined:
    """Geometry of the branches, in mm along the axes of the grid (voxel centre 0, 0, 0 at the origin).

    * ``node_mm`` (s + 1, 3): node 0 is the root, node ``b + 1`` the distal end of branch ``b``.
    * ``point_mm`` (m, 3), ``offset`` (s + 1,): the centreline of each branch, both nodes included.
    * ``radius_mm``, ``radius_sd_mm`` (s,).
    * ``clear_mm`` (s, 2): how far from its two nodes each branch comes clear of the others there.
    * ``owner`` (n,) int32: for each voxel the skeleton point in which its branch ends.
    """

    node_mm: np.ndarray
    point_mm: np.ndarray
    offset: np.ndarray
    radius_mm: np.ndarray
    radius_sd_mm: np.ndarray
    clear_mm: np.ndarray
    owner: np.ndarray


class Nodes:
    """Which branches meet where: branch ``b`` runs from node ``proximal[b]`` to node ``distal[b]``.

    ``degree`` (n,): branches at each node; ``fixed`` (n,): nodes whose place is known and does not change. There the
    branches are clear of others from ``clear_mm`` (s, 2) on.
    """

    def __init__(self, proximal: np.ndarray, distal: np.ndarray, fixed: np.ndarray, clear_mm: np.ndarray) -> None:
        self.proximal, self.distal, self.fixed, self.clear_mm = proximal, distal, fixed, clear_mm
        n = proximal.size
        node = np.concatenate((proximal, distal))
        branch = np.concatenate((np.arange(n), np.arange(n)))
        end = np.concatenate((np.zeros(n, dtype=np.int64), np.ones(n, dtype=np.int64)))
        order = np.argsort(node, kind="stable")
        self.branch, self.end = branch[order], end[order]
        self.degree = np.bincount(node, minlength=fixed.size)
        self.offset = np.concatenate(([0], np.cumsum(self.degree)))
        self.tip = (self.degree == 1) & ~fixed

    @property
    def n(self) -> int:
        return int(self.degree.size)

    @property
    def n_branches(self) -> int:
        return int(self.proximal.size)

    def thickest(self, radius_mm: np.ndarray) -> np.ndarray:
        """(n,) the largest radius among the branches that meet at each node."""
        result = np.zeros(self.n)
        np.maximum.at(result, self.proximal, radius_mm)
        np.maximum.at(result, self.distal, radius_mm)
        return result


def first_guess(
    voxels: Voxels, nodes: Nodes, chains: Sequence[np.ndarray], skeleton_voxel: np.ndarray, thickness_mm: np.ndarray
) -> Refined:
    """The voxel chains, smoothed over a few voxels between their fixed ends, and without their last stretch to a tip.

    A chain begins or ends at a tip in the surface voxel that is farthest away, on a blunt end in a corner; there it is
    taken only as far as :func:`_full` holds.
    """
    size = np.array(voxels.shape[::-1])
    step = float(voxels.spacing_mm.min())
    radius, lines = np.zeros(nodes.n_branches), []
    for b, chain in enumerate(chains):
        at = skeleton_voxel[chain]
        index, thickness = voxels.index_xyz(at), thickness_mm[at]
        centre = index * voxels.spacing_mm
        to_border = (np.minimum(index, size - 1 - index) * voxels.spacing_mm).min(axis=1)
        radius[b] = np.median(thickness)
        first = _full(thickness, to_border, radius[b], step) if nodes.tip[nodes.proximal[b]] else 0
        last = _full(thickness[::-1], to_border[::-1], radius[b], step) if nodes.tip[nodes.distal[b]] else 0
        line = centre[first : chain.size - last] if first + last < chain.size - 1 else centre
        smooth = gaussian_filter1d(line, sigma=2.0, axis=0, mode="nearest")
        smooth[0], smooth[-1] = line[0], line[-1]
        lines.append(smooth)
    offset = np.concatenate(([0], np.cumsum([len(line) for line in lines]))).astype(np.int64)
    point = np.concatenate(lines)
    node = np.empty((nodes.n, 3))
    node[nodes.proximal], node[nodes.distal] = point[offset[:-1]], point[offset[1:] - 1]
    return Refined(node, point, offset, radius, np.zeros(nodes.n_branches), nodes.clear_mm, np.empty(0, dtype=np.int32))


def _full(thickness: np.ndarray, to_border: np.ndarray, typical: float, step_mm: float) -> int:
    """How many points of a chain, seen from its tip, to leave out.

    Up to where the distance map reaches half its typical value, but no more than that value; and, where the vessel
    leaves the volume, up to where its inscribed ball fits in.
    """
    blunt = min(int(np.argmax(thickness >= 0.5 * typical)), int(typical / step_mm))
    if to_border[0] > 0:
        return blunt
    return max(blunt, int(np.argmax(to_border >= np.minimum(thickness, 0.5 * to_border.max()))))
