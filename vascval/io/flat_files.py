"""Volumes whose values lie uncompressed in files: read slice by slice at the places asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vascval.core.errors import InputError
from vascval.io import itk, meta_image
from vascval.io.header_checks import Flat, Header, Raster


def frame(path: Path, file: Path, header: Header) -> Raster | None:
    """Place and notes of the volume, with one voxel for its values; ``None`` where it is not as flat as it says."""
    if header.kind == "MetaImage":
        return meta_image.read_frame(path, header)
    if header.kind == "TIFF":
        return Raster(np.zeros((1, 1, 1), dtype=np.uint8), np.ones(3), np.zeros(3), np.eye(3), [])
    return itk.read_frame(path, file, header)


class FlatReader:
    """Reads slices and rows; see ``read`` of :class:`vascval.io.scans.Scan`."""

    def __init__(self, path: Path, flat: Flat) -> None:
        self.path, self.flat = path, flat
        self.dtype = flat.dtype.newbyteorder("=")

    def __call__(self, z0: int, z1: int, y0: int, y1: int) -> np.ndarray:
        flat, nx = self.flat, self.flat.shape[2]
        values = np.empty((z1 - z0, y1 - y0, nx), dtype=flat.dtype)
        row_bytes = nx * flat.dtype.itemsize
        for z in range(z0, z1):
            target = values[z - z0].view(np.uint8).reshape(-1)
            file = flat.files[int(flat.file[z])]
            try:
                with file.open("rb", buffering=0) as stream:
                    stream.seek(int(flat.start[z]) + y0 * row_bytes)
                    filled = 0
                    while filled < target.size and (n := stream.readinto(target[filled:].data)):
                        filled += n
            except OSError as error:
                raise InputError(f"{self.path}: {file.name} cannot be read ({error.strerror}); check it") from error
            if filled < target.size:
                raise InputError(f"{self.path}: {file.name} ends within slice {z}; it is truncated, get it again")
        return values.astype(self.dtype, copy=False)
