"""What the headers of all image formats have in common: what they say, and checks before they are believed."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from vascval.core.errors import InputError

_HEADER_BYTES = 1 << 20
_MAX_FILES = 100_000
_MAX_SLICES = 1_000_000
DENSEST = 1100
"""Bytes that gzip may make of one: zlib on zeros reaches 1032."""


@dataclass(frozen=True, eq=False)
class Flat:
    """Values that lie in files slice after slice: ``dtype`` with its byte order, ``shape`` (nz, ny, nx), and for each
    slice the number of its file, ``file`` (nz,), and where it begins there in bytes, ``start`` (nz,). Where the files
    are packed with gzip, from byte ``packed_at`` on, that is the place in what they unpack to."""

    dtype: np.dtype
    shape: tuple[int, int, int]
    files: tuple[Path, ...]
    file: np.ndarray
    start: np.ndarray
    packed_at: int | None = None


def consecutive(dtype: np.dtype, sizes: Sequence[int], files: Sequence[Path], skips: Sequence[int]) -> Flat | None:
    """Values in the order of memory, in files of equally many slices, after some bytes to skip in each.

    ``None`` where there are not three axes, the sizes are beyond belief, or the files do not end with a slice.
    """
    if len(sizes) != 3 or min(sizes) < 2 or sizes[2] % len(files):
        return None
    if sizes[2] > _MAX_SLICES or math.prod(sizes) * dtype.itemsize + max(skips) >= 2**62:
        return None
    nx, ny, nz = sizes
    each = nz // len(files)
    start = np.array(skips)[:, None] + np.arange(each) * (nx * ny * dtype.itemsize)
    return Flat(dtype, (nz, ny, nx), tuple(files), np.repeat(np.arange(len(files)), each), start.ravel())


def gzipped(flat: Flat | None, at: int) -> Flat | None:
    """The same in what the files unpack to from byte ``at`` on; ``None`` if they cannot hold so much."""
    if flat is None:
        return None
    there = sum(file.stat().st_size for file in flat.files)
    return replace(flat, packed_at=at) if math.prod(flat.shape) * flat.dtype.itemsize <= DENSEST * there else None


def stacked(flats: Sequence[Flat | None]) -> Flat | None:
    """The slices of several files as one volume; ``None`` if they are not all alike."""
    parts = [part for part in flats if part is not None]
    if len(parts) < len(flats) or len({(part.dtype, part.shape) for part in parts}) > 1:
        return None
    nz, ny, nx = parts[0].shape
    files = tuple(part.files[0] for part in parts)
    file = np.repeat(np.arange(len(parts)), nz)
    return Flat(parts[0].dtype, (nz * len(parts), ny, nx), files, file, np.concatenate([part.start for part in parts]))


@dataclass(frozen=True)
class Header:
    """What a header says: ``reader`` is the name of the ITK reader, ``sizes`` the axis lengths as stored (empty where
    only the library knows), ``itemsize`` the bytes per value, ``mm_per_unit`` what the spacing and origin that the
    library reports are to be multiplied by, ``unpacked_bytes`` what compressed NIfTI must unpack to, ``texts`` the
    key-value pairs of the writer, ``files`` and ``data_at`` where MetaImage keeps its data, ``least_bytes`` what the
    ``files`` of NRRD must hold at least, however densely they are packed, ``flat`` where values lie that can be read
    slice by slice."""

    kind: str
    reader: str
    sizes: tuple[int, ...] = ()
    itemsize: int = 1
    has_spacing: bool = True
    mm_per_unit: float = 1.0
    unpacked_bytes: int = 0
    texts: dict[str, str] = field(default_factory=dict)
    files: tuple[Path, ...] = ()
    data_at: int = 0
    least_bytes: int = 0
    flat: Flat | None = None


@dataclass(frozen=True)
class Raster:
    """Voxels as a file has them: ``values`` (nz, ny, nx), ``spacing``, ``origin`` (3,) and ``direction`` (3, 3) in its
    own unit, and ``notes`` on what was taken as given."""

    values: np.ndarray
    spacing: np.ndarray
    origin: np.ndarray
    direction: np.ndarray
    notes: list[str]


def first_bytes(path: Path, count: int = _HEADER_BYTES) -> bytes:
    """The first bytes of a file.

    :raises InputError: when it is missing, no regular file, or cannot be read.
    """
    try:
        if path.is_dir():
            raise InputError(f"{path}: is a folder; give a file")
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: is not a regular file; give a file")
        with path.open("rb") as stream:
            return stream.read(count)
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file; check the name") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({error}); check the name and its rights") from error


def require_shape(path: Path, size: Sequence[int], is_stack: bool, components: int) -> list[str]:
    """Refuses what has not three axes of one value each; returns a note where further axes of size 1 are dropped."""
    shape = " x ".join(map(str, size))
    if components != 1:
        raise InputError(f"{path}: has {components} values per voxel; one is needed, take one channel of it")
    if any(n != 1 for n in size[2 if is_stack else 3 :]):
        need = "slices have two axes" if is_stack else "three axes are needed, take one frame of it"
        raise InputError(f"{path}: is an image of {shape} voxels; {need}")
    if not is_stack and (len(size) < 3 or 1 in size[:3]):
        raise InputError(f"{path}: is a flat image of {shape} voxels; a volume with three axes is needed")
    return [f"trailing axes of size 1 dropped from {shape}"] if not is_stack and len(size) > 3 else []


def integers(path: Path, text: str, name: str) -> tuple[int, ...]:
    try:
        values = tuple(int(word) for word in text.split())
    except ValueError:
        raise InputError(f"{path}: {name} is {text!r}, not whole numbers; the header is damaged") from None
    return positive(path, values, name)


def positive(path: Path, values: tuple[int, ...], name: str) -> tuple[int, ...]:
    if any(value < 1 for value in values):
        raise InputError(f"{path}: {name} is {values}; sizes of at least 1 are needed, the header is damaged")
    return values


def numbered_files(path: Path, text: str) -> list[str]:
    """The file names that a data-file field stands for: one name, or ``pattern first last step``."""
    number = r"\s+(-?\d{1,9})"
    pattern = re.fullmatch(rf"(\S*%0?\d{{0,2}}[du]\S*){number}{number}{number}(\s+\d+)?", text, re.ASCII)
    if pattern is None:
        if "%" in text:
            raise InputError(f"{path}: the data file pattern {text!r} is not understood; name one file or LIST them")
        return [text]
    first, last, step = (int(pattern[i]) for i in (2, 3, 4))
    if step == 0 or not 0 <= (last - first) // step < _MAX_FILES or pattern[1].count("%") != 1:
        raise InputError(f"{path}: the data file pattern {text!r} counts no files; correct its range")
    return [pattern[1] % number for number in range(first, last + (1 if step > 0 else -1), step)]


def confined(header: Path, name: str) -> Path:
    """The data file that a detached header names, which must lie in the header's own folder or below."""
    outside = InputError(
        f"{header}: its data file {name!r} lies outside its folder; put both into one folder and name it without a path"
    )
    if os.path.isabs(name) or "\\" in name or re.match(r"[A-Za-z]:", name) or "\0" in name:
        raise outside
    file = header.parent / name
    try:
        if ".." in Path(name).parts or not file.resolve().is_relative_to(header.parent.resolve()):
            raise outside
        there = file.is_file()
    except OSError:  # the name is too long, or links lead in a circle
        there = False
    if not there:
        raise InputError(f"{header}: its data file {name!r} is missing; put it beside the header")
    return file


def require_bytes(path: Path, files: Sequence[Path], needed: int, skipped: int) -> None:
    there = sum(file.stat().st_size for file in files) - skipped
    if there < needed:
        raise InputError(f"{path}: holds {max(there, 0):,} bytes of {needed:,}; it is truncated, get it again")
