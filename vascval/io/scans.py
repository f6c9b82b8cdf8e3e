"""Scans: volumes that stay in their files and are read block by block, so that memory does not go with their size.

Zarr (OME-Zarr too), HDF5, NRRD and NIfTI (with gzip or without), and MetaImage, TIFF and folders of slices where they
are not compressed. Plain files are read at the places asked for and not mapped, as mapped pages would count as memory
of the process.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from vascval.core.errors import InputError
from vascval.io import flat_files, hdf5_arrays, packed_files, zarr_arrays
from vascval.io.stored_arrays import Stored
from vascval.io.volumes import Volume, describe, given_spacing, place, read_volume, require_finite, require_memory

_BLOCK_BYTES = 8 << 20
Read = Callable[[int, int, int, int], np.ndarray]


@dataclass(frozen=True, eq=False)
class Scan:
    """A volume that is read piece by piece.

    * ``frame``: a volume of one voxel, with the place in the world and the notes of the whole.
    * ``shape`` (nz, ny, nx) and ``dtype`` of the values.
    * ``block_shape`` (dz, dy): the slices and rows that are best read at once.
    * ``read(z0, z1, y0, y1)`` gives the values (z1 - z0, y1 - y0, nx) of these slices and rows.
    """

    frame: Volume
    shape: tuple[int, int, int]
    dtype: np.dtype
    block_shape: tuple[int, int]
    read: Read

    @property
    def spacing_mm(self) -> np.ndarray:
        return self.frame.spacing_mm

    @property
    def origin_mm(self) -> np.ndarray:
        return self.frame.origin_mm

    @property
    def direction(self) -> np.ndarray:
        return self.frame.direction

    @property
    def meta(self) -> Mapping[str, Any]:
        return self.frame.meta

    def to_world(self, index_xyz: np.ndarray) -> np.ndarray:
        """As :meth:`vascval.io.volumes.Volume.to_world`."""
        return self.frame.to_world(index_xyz)

    def to_index(self, world_mm: np.ndarray) -> np.ndarray:
        """As :meth:`vascval.io.volumes.Volume.to_index`."""
        return self.frame.to_index(world_mm)

    @property
    def block_voxels(self) -> int:
        """How many voxels a block has."""
        return self.block_shape[0] * self.block_shape[1] * self.shape[2]

    def blocks(self) -> Iterator[tuple[int, int, np.ndarray]]:
        """z and y of the first row of each block and its values (dz, dy, nx), layer by layer, by ascending y in each.

        :raises InputError: when a block cannot be read or holds a value that is not finite.
        """
        (nz, ny, _), (dz, dy) = self.shape, self.block_shape
        for z in range(0, nz, dz):
            for y in range(0, ny, dy):
                values = self.read(z, min(z + dz, nz), y, min(y + dy, ny))
                require_finite(values, z, y)
                yield z, y, values

    def load(self) -> Volume:
        """The whole volume in memory."""
        values = np.empty(self.shape, dtype=self.dtype)
        for z, y, block in self.blocks():
            values[z : z + block.shape[0], y : y + block.shape[1]] = block
        return replace(self.frame, values=values)


def open_scan(
    path: Path | str,
    *,
    spacing_mm: Sequence[float] | None = None,
    dataset: str | None = None,
    max_memory_bytes: int | None = None,
) -> Volume | Scan:
    """A volume for reading block by block where its format allows it, else (compressed MetaImage and TIFF) read whole.

    :param spacing_mm: as for :func:`vascval.io.volumes.read_volume`.
    :param dataset: which array of a zarr group or an HDF5 file; needed where there are several.
    :param max_memory_bytes: what the voxels may take that are read whole.
    :raises InputError: for whatever is no volume, with the name of the file, what is wrong and the remedy.
    """
    path = Path(path)
    given = given_spacing(spacing_mm)
    if zarr_arrays.is_zarr(path):
        return _stored(path, zarr_arrays.open_array(path, dataset), given)
    if hdf5_arrays.is_hdf5(path):
        return _stored(path, hdf5_arrays.open_array(path, dataset), given)
    if dataset is not None:
        raise InputError(f"{path}: is neither zarr nor HDF5 and has one data set only; leave out --dataset")
    described = describe(path, given)
    flat = described.header.flat
    raster = None if flat is None else flat_files.frame(path, described.files[0], described.header)
    if flat is None or raster is None:
        return read_volume(path, spacing_mm=spacing_mm, max_memory_bytes=max_memory_bytes)
    packed = flat.packed_at is not None
    read = (packed_files.PackedReader if packed else flat_files.FlatReader)(path, flat)
    block_shape = _block_shape(flat.shape, read.dtype, (1, flat.shape[1] if packed else 1))
    return Scan(place(described, raster), flat.shape, read.dtype, block_shape, read)


def read_stored(path: Path, spacing_mm: Sequence[float] | None, allowed_bytes: int) -> Volume:
    """A volume that can be read block by block, held whole."""
    scan = open_scan(path, spacing_mm=spacing_mm)
    if isinstance(scan, Volume):
        return scan
    require_memory(path, allowed_bytes, scan.shape[::-1], scan.dtype.itemsize)
    try:
        return scan.load()
    except InputError as error:
        raise error if str(error).startswith(str(path)) else InputError(f"{path}: {error}") from error


def _stored(path: Path, stored: Stored, given: np.ndarray | None) -> Scan:
    spacing, notes = stored.spacing_mm, list(stored.notes)
    if spacing is None and given is None:
        raise InputError(f"{path}: {stored.kind} gives no spacing in three dimensions; use --spacing X,Y,Z (mm)")
    if spacing is not None and given is not None:
        notes.append(f"spacing given as {given.tolist()} mm, the file says {spacing.tolist()}")
    if min(stored.shape) < 2:
        size = " x ".join(map(str, stored.shape[::-1]))
        raise InputError(f"{path}: is a flat image of {size} voxels; a volume with three axes is needed")
    meta = {"source": path.name, "format": stored.kind, "notes": notes}
    try:
        voxel = np.zeros((1, 1, 1), dtype=np.uint8)
        frame = Volume(voxel, spacing if given is None else given, stored.origin_mm, meta=meta)  # type: ignore[arg-type]
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    native = stored.dtype.newbyteorder("=")
    return Scan(frame, stored.shape, native, _block_shape(stored.shape, native, stored.chunk), stored.read)


def _block_shape(shape: tuple[int, int, int], dtype: np.dtype, chunk: tuple[int, int]) -> tuple[int, int]:
    """(dz, dy) whole chunks, as many as come to some megabytes: rows first, then slices."""
    nz, ny, nx = shape
    dz, dy = min(chunk[0], nz), min(chunk[1], ny)
    more = max(1, _BLOCK_BYTES // (dz * dy * nx * dtype.itemsize))
    rows = min(ny, dy * more)
    more = max(1, more // math.ceil(rows / dy)) if rows == ny else 1
    return min(nz, dz * more), rows
