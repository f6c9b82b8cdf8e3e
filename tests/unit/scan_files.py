"""Volumes in the files that are read block by block, and how such files are refused."""

from __future__ import annotations

import gzip
from pathlib import Path

import h5py
import numpy as np
import pytest
import SimpleITK as sitk
import zarr

from vascval.core.errors import InputError
from vascval.io.scans import Scan, open_scan

SPACING = (0.5, 0.25, 2.0)


def sample(dtype: str = "uint8") -> np.ndarray:
    """(9, 14, 11) values, all different where the type has room."""
    return (np.arange(9 * 14 * 11).reshape(9, 14, 11) * 7 % 251).astype(dtype)


def ome(unit: str | None = "micrometer", axes: str = "zyx") -> dict:
    """OME metadata of an image in two resolutions, its voxels SPACING mm, the first at 1, 2, 3 mm."""
    per = {"micrometer": 1000.0, "millimeter": 1.0, None: 1.0}[unit]
    ones = [1.0] * (len(axes) - 3)
    steps = [
        {"type": "scale", "scale": ones + [s * per for s in SPACING[::-1]]},
        {"type": "translation", "translation": [0.0] * len(ones) + [3.0 * per, 2.0 * per, 1.0 * per]},
    ]
    named = [{"name": a, **({} if unit is None else {"unit": unit})} for a in axes]
    sets = [{"path": "0", "coordinateTransformations": steps}, {"path": "1", "coordinateTransformations": steps}]
    return {"version": "0.4", "axes": named, "datasets": sets}


def write_zarr(
    path: Path, values: np.ndarray, *, version: int = 2, chunks: tuple[int, ...] = (4, 5, 6), **more
) -> None:
    array = zarr.create_array(
        str(path), shape=values.shape, chunks=chunks, dtype=values.dtype, zarr_format=version, **more
    )
    array[...] = values


def write_ome(path: Path, values: np.ndarray, *, version: int = 2, unit: str | None = "micrometer") -> None:
    group = zarr.open_group(str(path), mode="w", zarr_format=version)
    for name in "01":
        array = group.create_array(name, shape=(1, *values.shape), chunks=(1, 4, 5, 6), dtype=values.dtype)
        array[...] = values[None]
    image = ome(unit, "czyx")
    group.attrs.update(
        {"multiscales": [image]} if version == 2 else {"ome": {"version": "0.5", "multiscales": [image]}}
    )


def write_nrrd(path: Path, values: np.ndarray, *, big: bool = False, packed: bool = False) -> None:
    names = {"u1": "uchar", "i2": "short", "u2": "uint16", "f4": "float", "f8": "double", "i4": "int"}
    axes = " ".join(str(tuple(float(v) for v in row)).replace(" ", "") for row in np.diag(SPACING))
    head = [
        "NRRD0004",
        f"type: {names[values.dtype.str[1:]]}",
        "dimension: 3",
        "space: left-posterior-superior",
        f"sizes: {' '.join(map(str, values.shape[::-1]))}",
        f"space directions: {axes}",
        "kinds: domain domain domain",
        f"endian: {'big' if big else 'little'}",
        f"encoding: {'gzip' if packed else 'raw'}",
        "space origin: (1,2,3)",
    ]
    data = values.astype(values.dtype.newbyteorder(">" if big else "<")).tobytes()
    if path.suffix == ".nrrd":
        path.write_bytes(("\n".join(head) + "\n\n").encode() + (gzip.compress(data) if packed else data))
        return
    half = len(data) // values.shape[0] * (values.shape[0] // 3)
    for k in range(3):
        part = data[k * half : (k + 1) * half]
        (path.parent / f"part{k}.raw").write_bytes(gzip.compress(part) if packed else part)
    path.write_text("\n".join([*head, "data file: part%d.raw 0 2 1 3"]) + "\n")


def write_image(path: Path, values: np.ndarray, *, packed: bool = False) -> None:
    image = sitk.GetImageFromArray(values)
    image.SetSpacing(SPACING)
    image.SetOrigin((1.0, 2.0, 3.0))
    sitk.WriteImage(image, str(path), useCompression=packed)


def write_slices(path: Path, values: np.ndarray) -> None:
    path.mkdir()
    for k, plane in enumerate(values):
        sitk.WriteImage(sitk.GetImageFromArray(plane), str(path / f"slice{k + 8}.tif"), useCompression=False)


def write_hdf5(path: Path, values: np.ndarray, *, chunks: tuple[int, ...] | None = (4, 5, 6)) -> None:
    with h5py.File(path, "w") as file:
        array = file.create_dataset("volume/cast", data=values, chunks=chunks, compression="gzip" if chunks else None)
        array.attrs["element_size_um"] = np.array(SPACING[::-1]) * 1000.0
        file["notes"] = np.zeros(3)


WRITERS = {
    "a.nrrd": write_nrrd,
    "big.nrrd": lambda path, values: write_nrrd(path, values, big=True),
    "a.nhdr": write_nrrd,
    "gz.nrrd": lambda path, values: write_nrrd(path, values, packed=True),
    "gz.nhdr": lambda path, values: write_nrrd(path, values, big=True, packed=True),
    "a.nii": write_image,
    "a.nii.gz": lambda path, values: write_image(path, values, packed=True),
    "a.mha": write_image,
    "a.mhd": write_image,
    "a.tif": write_image,
    "slices": write_slices,
    "a.zarr": write_zarr,
    "v3.zarr": lambda path, values: write_zarr(path, values, version=3),
    "sharded.zarr": lambda path, values: write_zarr(path, values, version=3, chunks=(2, 5, 6), shards=(4, 10, 12)),
    "ome.zarr": write_ome,
    "ome3.zarr": lambda path, values: write_ome(path, values, version=3),
    "a.h5": write_hdf5,
    "flat.hdf5": lambda path, values: write_hdf5(path, values, chunks=None),
}
PLACED = [name for name in WRITERS if name not in ("a.tif", "slices", "a.zarr", "v3.zarr", "sharded.zarr")]


def refused(path: Path, message: str, **options) -> None:
    with pytest.raises(InputError, match=message) as caught:
        scan = open_scan(path, **options)
        assert isinstance(scan, Scan)
        scan.load()
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)
    assert "; " in str(caught.value)
