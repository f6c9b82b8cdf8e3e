"""The tissue that a cast stands for, where nobody segmented it: a closed hull of its vessels that follows concavities.

The hull is a morphological closing with balls: a point belongs to it when no ball of the closing radius can reach it
without touching a vessel. An infinite radius gives the convex hull, a small one the vessels themselves. What is left
of the tips' sharp corners is rounded by a margin: the hull is all that lies within ``margin_mm`` of the closing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vascval.core.errors import InputError
from vascval.core.tree import Tree
from vascval.imaging.rasterize import wall_distance
from vascval.io.volumes import Volume

RADIUS_SPACINGS, MARGIN_SPACINGS = 2.0, 0.5
"""The defaults, in mean distances of terminals (the cube root of convex hull over number)."""
_VOXELS, _MOST_VOXELS = 4_000_000, 16_000_000
_DIAGONAL = float(np.sqrt(3.0) / 2.0)


@dataclass(frozen=True, eq=False)
class PerfusionVolume:
    """``mask`` (uint8, 1 inside, in one piece and without voids), its ``volume_mm3``, and how it was found:
    ``radius_mm`` of the closing, ``margin_mm`` around it, ``n_voids_filled``."""

    mask: Volume
    volume_mm3: float
    radius_mm: float
    margin_mm: float
    n_voids_filled: int


def perfusion_volume(
    tree: Tree, *, radius_mm: float | None = None, margin_mm: float | None = None, voxel_mm: float | None = None
) -> PerfusionVolume:
    """The hull of a tree's vessels: their closing with balls of ``radius_mm``, widened by ``margin_mm``.

    All vessels are inside, by the margin or more. A concavity wider than twice the radius stays one. By default the
    radius is two mean distances of terminals, so that the gaps between terminals close and those between lobes do
    not, and the margin half of one, what a terminal supplies beyond its end.

    :param voxel_mm: edge of the voxels; at most half of the margin. By default an eighth of it, or more where the grid
        would have more than four million voxels.
    :raises InputError: when a length is not positive or the voxels are too large; when the margin is too small for any
        grid; when the terminals span no volume and no radius is given.
    """
    if radius_mm is None or margin_mm is None:
        spacing = terminal_spacing_mm(tree)
        radius_mm = RADIUS_SPACINGS * spacing if radius_mm is None else radius_mm
        margin_mm = min(MARGIN_SPACINGS * spacing, radius_mm) if margin_mm is None else margin_mm
    for name, value in (("radius", radius_mm), ("margin", margin_mm)):
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"the {name} of the hull is {value} mm; a positive number is needed")
    points = tree.position_mm if tree.polyline_mm is None else tree.polyline_mm
    around = radius_mm + 2.0 * margin_mm
    if voxel_mm is None:
        size = np.ptp(points, axis=0) + 2.0 * (around + float(tree.radius_mm.max()))
        voxel_mm = min(max(margin_mm / 8.0, float(np.cbrt(size.prod() / _VOXELS))), margin_mm / 2.0)
        least = 2.0 * float(np.cbrt(size.prod() / _MOST_VOXELS))
        if margin_mm < least:
            raise InputError(
                f"the margin of {margin_mm:g} mm is too small for a hull of this size: it would need more than "
                f"{_MOST_VOXELS:,} voxels; give {least:.2g} mm or more"
            )
    if not 0 < voxel_mm <= 0.5 * margin_mm:
        raise InputError(
            f"voxels of {voxel_mm:g} mm cannot show a margin of {margin_mm:g} mm; take voxels of half of it or less"
        )
    distance = wall_distance(tree, band_mm=3.0 * voxel_mm, voxel_mm=voxel_mm, margin_mm=around)
    inside, n_voids = _filled(closing(distance, radius_mm, margin_mm=margin_mm))
    mask = _cropped(Volume(inside, distance.spacing_mm, distance.origin_mm, distance.direction))
    volume = float(np.count_nonzero(inside) * voxel_mm**3)
    return PerfusionVolume(mask, volume, float(radius_mm), float(margin_mm), n_voids)


def terminal_spacing_mm(tree: Tree) -> float:
    """Mean distance of terminals: the cube root of the volume of their convex hull over their number.

    :raises InputError: when they span no volume.
    """
    from scipy.spatial import ConvexHull, QhullError

    terminals = tree.position_mm[tree.topology.terminals]
    extent = np.linalg.svd(terminals - terminals.mean(axis=0), compute_uv=False) if len(terminals) > 3 else np.zeros(3)
    try:
        volume = float(ConvexHull(terminals).volume) if extent[-1] > 1e-3 * extent[0] else 0.0
    except QhullError:
        volume = 0.0
    if not volume > 0:
        raise InputError(
            f"the {len(terminals)} ends of vessels span no volume, so that none can be guessed; give a domain, or the "
            "radius and the margin of the hull"
        )
    return float(np.cbrt(volume / len(terminals)))


def closing(distance: Volume, radius_mm: float, *, margin_mm: float = 0.0) -> np.ndarray:
    """(nz, ny, nx) whether each voxel's centre lies within ``margin_mm`` (at most the radius) of the closing of a body
    by balls of ``radius_mm``.

    :param distance: signed distance to the body's wall, negative inside, right near the wall; cubic voxels. Around
        the body the grid has room for radius and margin.

    The body grown by the radius, then shrunk by radius less margin. Either distance is measured from the nearest
    voxel's centre near the wall and corrected by that centre's own distance to the wall. As the way over that centre
    is not quite straight, it is too long, by a tenth of a voxel in the mean.
    """
    voxel = float(distance.spacing_mm[0])
    grown = _distance_to(np.asarray(distance.values, dtype=np.float64), voxel)
    away = _distance_to(radius_mm - grown, voxel)
    inside: np.ndarray = away >= radius_mm - margin_mm
    return inside


def _distance_to(signed_mm: np.ndarray, voxel_mm: float) -> np.ndarray:
    """Distance of every voxel to the set where ``signed_mm``, a distance near its wall, is not positive."""
    from scipy.ndimage import distance_transform_edt

    near = signed_mm <= _DIAGONAL * voxel_mm
    away, index = distance_transform_edt(~near, sampling=voxel_mm, return_indices=True)
    corrected: np.ndarray = away + signed_mm[tuple(index)]
    return corrected


def _filled(inside: np.ndarray) -> tuple[np.ndarray, int]:
    """Without voids, as uint8, and how many there were."""
    from scipy.ndimage import binary_fill_holes, label

    whole = binary_fill_holes(inside)
    return whole.astype(np.uint8), int(label(whole & ~inside)[1])


def _cropped(volume: Volume) -> Volume:
    """Without the empty borders."""
    used = [np.flatnonzero(volume.values.any(axis=axes)) for axes in ((1, 2), (0, 2), (0, 1))]
    low = np.array([axis[0] for axis in used])
    values = volume.values[tuple(slice(axis[0], axis[-1] + 1) for axis in used)]
    return Volume(values, volume.spacing_mm, volume.to_world(low[::-1]), volume.direction)
