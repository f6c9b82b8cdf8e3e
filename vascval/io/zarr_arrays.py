"""Zarr arrays, versions 2 and 3, and OME-Zarr images.

The metadata are read and judged here before the library opens anything: a group may name arrays only inside itself,
and only codecs that do nothing but pack numbers are let through (a pickle would run whatever it holds).
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vascval.core.errors import InputError
from vascval.core.units import MM_PER
from vascval.io.stored_arrays import Stored, chosen, leading_ones, reader, require_numbers, said

_V2_CODECS = {"blosc", "zlib", "gzip", "zstd", "lz4", "lzma", "bz2", "delta", "shuffle", "bitround", "packbits"}
_V3_CODECS = {"bytes", "blosc", "gzip", "zstd", "crc32c", "transpose", "sharding_indexed"}
_FAILURES = (OSError, RuntimeError, ValueError, KeyError, TypeError, IndexError, EOFError, MemoryError, zlib.error)
_MARKS = ("zarr.json", ".zarray", ".zgroup")
_LONGEST_METADATA = 16 << 20


def is_zarr(path: Path) -> bool:
    """Whether a folder is a zarr group or array, by its name or by what is in it."""
    return path.is_dir() and (path.name.lower().endswith(".zarr") or any((path / mark).exists() for mark in _MARKS))


def open_array(path: Path, dataset: str | None) -> Stored:
    """The array of a zarr folder: itself, the finest of an OME-Zarr image, the only one of a group or ``dataset``.

    :raises InputError: when the metadata are damaged, foreign or not to be trusted, or there is no such array.
    """
    import zarr

    scale = None
    place = path
    if _is_array(path):
        if dataset is not None:
            raise InputError(f"{path}: is one zarr array and no group; leave out --dataset")
    else:
        image = _multiscale(path)
        if image is not None and dataset is None:
            name, scale = _finest(path, image), image
        else:
            name = chosen(path, _array_names(path), dataset)
        place = _inside(path, name)
        if not _is_array(place):
            raise InputError(f"{path}: has no array {name!r}, which its metadata name; the folder is incomplete")
    _require_codecs(path, place)
    try:
        array = zarr.open_array(str(place), mode="r")
        shape, dtype, chunks = tuple(int(n) for n in array.shape), np.dtype(array.dtype), tuple(array.chunks)
    except _FAILURES as error:
        raise InputError(f"{path}: cannot be read as zarr ({said(error)}); it is damaged or of another kind") from error
    require_numbers(path, dtype)
    extra = leading_ones(path, shape)
    spacing, origin = (None, np.zeros(3)) if scale is None else _frame(path, scale, len(shape))

    nz, ny, nx = shape[extra:]
    kind = "zarr" if scale is None else "OME-Zarr"
    chunk = (chunks[extra], chunks[extra + 1])
    return Stored(kind, (nz, ny, nx), dtype, chunk, reader(path, array, extra, _FAILURES), spacing, origin)


def _metadata(file: Path) -> dict[str, Any]:
    """A JSON file as a dictionary, empty where there is none."""
    if not file.is_file():
        return {}
    try:
        if file.stat().st_size > _LONGEST_METADATA:
            raise ValueError("too long")
        value = json.loads(file.read_text("utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{file}: is no zarr metadata ({said(error)}); the folder is damaged") from error
    if not isinstance(value, dict):
        raise InputError(f"{file}: is no zarr metadata (no object); the folder is damaged")
    return value


def _is_array(folder: Path) -> bool:
    return (folder / ".zarray").is_file() or _metadata(folder / "zarr.json").get("node_type") == "array"


def _array_names(path: Path) -> list[str]:
    """The arrays in a group, to a depth of three."""
    if not any((path / mark).exists() for mark in _MARKS):
        raise InputError(f"{path}: has no zarr metadata ({', '.join(_MARKS)}); it is incomplete or of another kind")
    names, level = [], [path]
    for _ in range(3):
        below = [item for folder in level for item in sorted(folder.iterdir()) if item.is_dir()]
        names += [item.relative_to(path).as_posix() for item in below if _is_array(item)]
        level = [item for item in below if not _is_array(item)]
    return sorted(names)


def _inside(path: Path, name: str) -> Path:
    place = path / name
    if Path(name).is_absolute() or ".." in Path(name).parts or not place.resolve().is_relative_to(path.resolve()):
        raise InputError(f"{path}: names the array {name!r}, which lies outside it; put it inside")
    return place


def _require_codecs(path: Path, place: Path) -> None:
    """Refuses codecs and chunk grids that are unknown here."""
    old, new = _metadata(place / ".zarray"), _metadata(place / "zarr.json")
    if old:
        packers = [old.get("compressor"), *(old.get("filters") or [])]
        names = [codec.get("id") if isinstance(codec, Mapping) else codec for codec in packers if codec is not None]
        known = _V2_CODECS
    else:
        names, known = _codec_names(new.get("codecs")), _V3_CODECS
    unknown = [str(name) for name in names if name not in known]
    if unknown:
        raise InputError(f"{path}: is packed with {unknown[0][:60]!r}, which is not read here; rewrite it with blosc")


def _codec_names(codecs: Any) -> list[Any]:
    names: list[Any] = []
    for codec in codecs if isinstance(codecs, list) else [None]:
        name = codec.get("name") if isinstance(codec, Mapping) else codec
        names.append(name)
        if name == "sharding_indexed" and isinstance(codec, Mapping):
            inner = codec.get("configuration")
            for part in ("codecs", "index_codecs"):
                names += _codec_names(inner.get(part) if isinstance(inner, Mapping) else None)
    return names


# --- OME-Zarr -----------------------------------------------------------------------------------------------------

_UNITS = {"nanometer": 1e-6, "micrometer": 1e-3, "millimeter": 1.0, "centimeter": 10.0, "meter": 1e3, **MM_PER}


def _multiscale(path: Path) -> dict[str, Any] | None:
    """The first image that the attributes of a group describe."""
    attributes: Any = _metadata(path / ".zattrs") or _metadata(path / "zarr.json").get("attributes") or {}
    attributes = attributes.get("ome", attributes) if isinstance(attributes, Mapping) else {}
    images = attributes.get("multiscales") if isinstance(attributes, Mapping) else None
    if images is None:
        return None
    if not isinstance(images, list) or not images or not isinstance(images[0], dict):
        raise InputError(f"{path}: its OME metadata describe no image; the folder is damaged")
    return images[0]


def _finest(path: Path, image: Mapping[str, Any]) -> str:
    try:
        name = image["datasets"][0]["path"]
    except (KeyError, IndexError, TypeError):
        name = None
    if not isinstance(name, str):
        raise InputError(f"{path}: its OME metadata name no data set; the folder is damaged")
    return name


def _frame(path: Path, image: Mapping[str, Any], n_axes: int) -> tuple[np.ndarray | None, np.ndarray]:
    """Spacing (``None`` without units) and origin in mm along x, y, z, by the transformations of the finest image."""
    damaged = InputError(f"{path}: the axes and scales of its OME metadata do not fit the array; mend them")
    try:
        axes = [axis if isinstance(axis, Mapping) else {"name": axis} for axis in image["axes"]]
        names = [str(axis["name"]).lower() for axis in axes]
        scale, shift = np.ones(n_axes), np.zeros(n_axes)
        for part in (image["datasets"][0], image):
            for step in part.get("coordinateTransformations", ()):
                if step["type"] == "scale":
                    scale, shift = scale * np.array(step["scale"], float), shift * np.array(step["scale"], float)
                elif step["type"] == "translation":
                    shift = shift + np.array(step["translation"], float)
        units = [axis.get("unit") for axis in axes[-3:]]
    except (KeyError, IndexError, TypeError, ValueError, AttributeError):
        raise damaged from None
    if None in units:
        return None, np.zeros(3)
    if len(axes) != n_axes or scale.shape != (n_axes,) or shift.shape != (n_axes,):
        raise damaged
    if names[-3:] != ["z", "y", "x"]:
        raise InputError(f"{path}: its axes are {', '.join(names)}; the last three must be z, y, x")
    unknown = [unit for unit in units if unit not in _UNITS]
    if unknown:
        raise InputError(f"{path}: the unit of its axes is {unknown[0]!r}; one of {', '.join(_UNITS)} is needed")
    mm = np.array([_UNITS[str(unit)] for unit in units])
    if not all(map(math.isfinite, shift)):
        raise damaged
    return (scale[-3:] * mm)[::-1].copy(), (shift[-3:] * mm)[::-1].copy()
