"""Arrays in HDF5 files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from vascval.core.errors import InputError
from vascval.io.stored_arrays import Stored, chosen, leading_ones, reader, require_numbers, said

SUFFIXES = (".h5", ".hdf5", ".hdf")
_FAILURES = (OSError, RuntimeError, ValueError, KeyError, TypeError)


def is_hdf5(path: Path) -> bool:
    """Whether the name is that of an HDF5 file."""
    return path.name.lower().endswith(SUFFIXES)


def open_array(path: Path, dataset: str | None) -> Stored:
    """The one array of three axes in the file, or the one named ``dataset``; the file stays open while it is in use.

    The voxel size is read from the attribute ``element_size_um`` (z, y, x in micrometres) where there is one.

    :raises InputError: when it is no HDF5 file, or its data lie in other files, or there is no such array.
    """
    import h5py

    if not path.is_file():
        raise InputError(f"{path}: there is no such file; check the name")
    try:
        file = h5py.File(path, "r")
        names: list[str] = []

        def collect(name: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset) and len(item.shape or ()) >= 3 and item.dtype.kind in "biuf":
                names.append(name)

        file.visititems(collect)
        array = file[chosen(path, sorted(names), dataset)]
        size_um = array.attrs.get("element_size_um")
        elsewhere = array.is_virtual or array.external
        shape, dtype, chunks = tuple(int(n) for n in array.shape), array.dtype, array.chunks
    except _FAILURES as error:
        raise InputError(f"{path}: cannot be read as HDF5 ({said(error)}); it is damaged or of another kind") from error
    if elsewhere:
        raise InputError(f"{path}: keeps its values in other files; copy them into one (h5repack)")
    require_numbers(path, dtype)
    extra = leading_ones(path, shape)
    spacing = None
    if size_um is not None:
        if np.shape(size_um) != (3,) or np.asarray(size_um).dtype.kind not in "iuf":
            raise InputError(f"{path}: element_size_um is {size_um!r}; three numbers z, y, x are needed")
        spacing = np.asarray(size_um, dtype=np.float64)[::-1] / 1000.0

    nz, ny, nx = shape[extra:]
    chunk = (1, 1) if chunks is None else (chunks[extra], chunks[extra + 1])
    return Stored("HDF5", (nz, ny, nx), dtype, chunk, reader(path, array, extra, _FAILURES), spacing, np.zeros(3))
