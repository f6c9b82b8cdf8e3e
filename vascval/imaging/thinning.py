"""Distance-ordered homotopic thinning towards anchors."""

from __future__ import annotations

import numpy as np

from vascval.imaging import _thinning_kernels as kernels
from vascval.imaging.voxels import Voxels

LEVELS_PER_VOXEL = 8


def thin(voxels: Voxels, thickness_mm: np.ndarray, anchor: np.ndarray) -> np.ndarray:
    """(n,) bool: the voxels left when nothing can go without a change of topology.

    Voxels go in the order of the distance map, thinnest first (distance-ordered homotopic thinning, Pudney 1998), so
    that what is left follows the ridges of the map. The only end points are the given anchors: there are no spurs to
    prune, and no vessel vanishes whatever its direction, since its tip is an anchor and its voxels join it to the rest.

    :param thickness_mm: (n,) distance map.
    :param anchor: indices of the voxels that must stay.
    """
    held = np.zeros(voxels.n, dtype=bool)
    held[anchor] = True
    return kernels.thin(thickness_mm, LEVELS_PER_VOXEL / voxels.spacing_mm.min(), held, voxels.lattice)
