"""A label volume as a domain: the union of its voxels, to the voxel."""

from __future__ import annotations

from functools import cached_property
from typing import Literal

import numpy as np

from generator._domain_kernels import Space
from generator.domain import Domain, _points
from vascval.core.errors import InputError
from vascval.io.volumes import Volume

_SPECKS = 1e-3
"""Pieces that together make up less than this share of the domain are noise, and dropped."""


class VoxelDomain(Domain):
    """The voxels of a label, or all that are not 0.

    :param closing_mm: gaps narrower than twice this, such as the vessels carved out of a liver mask, are closed first.
    :param keep: ``all`` refuses a domain in several pieces, ``largest`` takes the largest. Voxels hang together
        through faces. Specks of less than a thousandth of the domain in total are dropped either way.
    :raises InputError: when the label is absent, there is no voxel, or there are several pieces.
    """

    name = "volume"

    def __init__(
        self,
        volume: Volume,
        *,
        label: int | None = None,
        closing_mm: float = 0.0,
        keep: Literal["all", "largest"] = "all",
    ) -> None:
        mask = volume.values != 0 if label is None else volume.values == label
        if not mask.any():
            what = "only background" if label is None else f"no voxel of label {label} (labels: {_labels(volume)})"
            raise InputError(f"the volume holds {what}; the domain would have no volume")
        notes: list[str] = []
        if closing_mm > 0.0:
            mask = _closed(mask, np.maximum(np.round(closing_mm / volume.spacing_mm[::-1]), 1).astype(int))
        mask = _one_piece(mask, keep, notes)
        corner = np.array([int(np.flatnonzero(mask.any(axis=axes))[0]) for axes in ((0, 1), (0, 2), (1, 2))])
        for axis in range(3):
            used = np.flatnonzero(mask.any(axis=tuple({0, 1, 2} - {axis})))
            mask = mask.take(range(used[0], used[-1] + 1), axis=axis)
        self._state = np.ascontiguousarray(mask.transpose(2, 1, 0)).astype(np.uint8)
        self._to_world = volume.direction * volume.spacing_mm
        self._origin = volume.to_world(corner - 0.5)
        self.volume_mm3 = float(np.count_nonzero(mask) * abs(np.linalg.det(self._to_world)))
        grid = np.array(np.meshgrid(*[(0, n) for n in self._state.shape])).reshape(3, -1).T
        corners = grid @ self._to_world.T + self._origin
        self.lower_mm, self.upper_mm = corners.min(axis=0), corners.max(axis=0)
        self.notes = tuple(notes)

    @cached_property
    def space(self) -> Space:
        inverse = np.linalg.inv(self._to_world)
        to_cell = np.ascontiguousarray(np.column_stack([inverse, -inverse @ self._origin]))
        return Space(False, self._state, to_cell, np.zeros(1, np.int64), np.zeros(0, np.int32), np.zeros((0, 3, 3)))

    def contains(self, points_mm: np.ndarray) -> np.ndarray:
        points = _points(points_mm)
        finite = np.isfinite(points).all(axis=1)
        cell = np.floor(np.where(finite[:, None], points, 0.0) @ self.space.to_cell[:, :3].T + self.space.to_cell[:, 3])
        within = finite & ((cell >= 0) & (cell < self._state.shape)).all(axis=1)
        i, j, k = np.where(within[:, None], cell, 0).astype(np.int64).T
        return within & (self._state[i, j, k] == 1)

    def wall_distance_mm(self, points_mm: np.ndarray) -> np.ndarray:
        """To the nearest centre of a voxel at the wall: right to within a voxel."""
        points = _points(points_mm)
        return np.where(self.contains(points), 1.0, -1.0) * self._wall.query(points)[0]

    @cached_property
    def _wall(self):  # type: ignore[no-untyped-def]
        from scipy.ndimage import binary_erosion
        from scipy.spatial import cKDTree

        mask = self._state == 1
        return cKDTree((np.argwhere(mask & ~binary_erosion(mask)) + 0.5) @ self._to_world.T + self._origin)

    @cached_property
    def _inside(self) -> np.ndarray:
        return np.flatnonzero(self._state)

    def sample(self, count: int, rng: np.random.Generator) -> np.ndarray:
        voxel = self._inside[rng.integers(self._inside.size, size=count)]
        cell = np.column_stack(np.unravel_index(voxel, self._state.shape)) + rng.random((count, 3))
        return cell @ self._to_world.T + self._origin


def _labels(volume: Volume) -> str:
    found = np.unique(volume.values)
    return ", ".join(f"{value:g}" for value in found[:10]) + (", ..." if found.size > 10 else "")


def _closed(mask: np.ndarray, radius_zyx: np.ndarray) -> np.ndarray:
    import SimpleITK as sitk

    wide = np.pad(mask, [(r, r) for r in radius_zyx])
    image = sitk.GetImageFromArray(wide.astype(np.uint8))
    closed = sitk.BinaryMorphologicalClosing(image, [int(r) for r in radius_zyx[::-1]], sitk.sitkBall)
    inner = tuple(slice(r, -r) for r in radius_zyx)
    return sitk.GetArrayFromImage(closed)[inner] != 0


def _one_piece(mask: np.ndarray, keep: str, notes: list[str]) -> np.ndarray:
    from scipy.ndimage import label

    pieces, count = label(mask)
    if count == 1:
        return mask
    size = np.bincount(pieces.ravel())[1:]
    rest = size.sum() - size.max()
    if rest > _SPECKS * size.sum() and keep != "largest":
        listed = ", ".join(f"{n:,}" for n in np.sort(size)[::-1][:5]) + (", ..." if count > 5 else "")
        raise InputError(
            f"the domain is in {count} pieces of {listed} voxels; one is needed: join them (domain.closing_mm) or take "
            "the largest (domain.keep=largest)"
        )
    notes.append(f"{count - 1} smaller pieces of the domain, {rest:,} voxels, were dropped")
    return pieces == size.argmax() + 1
