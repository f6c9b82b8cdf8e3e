"""Volumes: reading and writing images in three dimensions with their place in the world.

Headers are checked (:mod:`vascval.io.image_headers`) before SimpleITK is let near a file, and the memory that the
voxels need is known before they are read. MetaImage, zarr, HDF5 and the values of NIfTI without a scale are read
without it.
"""

from __future__ import annotations

import json
import math
import os
import re
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from vascval.core.errors import InputError
from vascval.io import hdf5_arrays, itk, meta_image, zarr_arrays
from vascval.io.atomic import atomic_file
from vascval.io.header_checks import Header, Raster, stacked
from vascval.io.image_headers import read_header, require_whole

SUFFIXES = (".nrrd", ".nhdr", ".nii", ".nii.gz", ".mha", ".mhd", ".tif", ".tiff")
_SHARE_OF_AVAILABLE = 0.5
_MAX_SPACING_MM = 1000.0
_MAX_SPACING_RATIO = 1000.0
_FARTHEST_MM = 1e9
_META_KEY = "vascval"
_GIB = 1024.0**3


@dataclass(frozen=True, eq=False)
class Volume:
    """Voxel values and where they lie.

    * ``values`` (nz, ny, nx), C order; read-only.
    * ``spacing_mm``, ``origin_mm`` (3,) in the order x, y, z: distances of neighbouring voxel centres along the axes
      of the grid, and the world position of the centre of voxel 0, 0, 0.
    * ``direction`` (3, 3): its columns are the axes of the grid in the world frame (LPS).
    * ``meta``: notes and provenance; plain JSON values.

    :raises InputError: when shapes are wrong, the spacing is absurd or the direction has no inverse.
    """

    values: np.ndarray
    spacing_mm: np.ndarray
    origin_mm: np.ndarray = field(default_factory=lambda: np.zeros(3))
    direction: np.ndarray = field(default_factory=lambda: np.eye(3))
    meta: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        values = np.ascontiguousarray(self.values).view()
        if values.ndim != 3:
            raise InputError(f"an array of shape {values.shape} is no volume; three axes (z, y, x) are needed")
        values.setflags(write=False)
        object.__setattr__(self, "values", values)
        for name, shape in (("spacing_mm", (3,)), ("origin_mm", (3,)), ("direction", (3, 3))):
            array = np.array(getattr(self, name), dtype=np.float64)
            if array.shape != shape or (name != "spacing_mm" and not (np.abs(array) <= _FARTHEST_MM).all()):
                raise InputError(f"{name} is {array.tolist()}; numbers of shape {shape} within 1e9 are needed")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        check_spacing(self.spacing_mm)
        with np.errstate(all="ignore"):  # of axes next to nothing the determinant is no number
            invertible = abs(np.linalg.det(self.direction)) >= 1e-6
        if not invertible:
            raise InputError(f"direction {self.direction.tolist()} has no inverse; three independent axes are needed")
        object.__setattr__(self, "meta", MappingProxyType(dict(self.meta)))

    @property
    def shape(self) -> tuple[int, int, int]:
        nz, ny, nx = self.values.shape
        return nz, ny, nx

    @property
    def dtype(self) -> np.dtype:
        return self.values.dtype

    @property
    def block_voxels(self) -> int:
        """How many voxels a block has."""
        return self.shape[1] * self.shape[2]

    def blocks(self) -> Iterator[tuple[int, int, np.ndarray]]:
        """The volume slice by slice: z, y = 0 and the values (1, ny, nx) of each; as :meth:`scans.Scan.blocks`."""
        for z in range(self.shape[0]):
            yield z, 0, self.values[z : z + 1]

    def to_world(self, index_xyz: np.ndarray) -> np.ndarray:
        """World positions (..., 3) in mm of voxel indices (..., 3) in the order x, y, z; whole indices are centres."""
        return (np.asarray(index_xyz, dtype=np.float64) * self.spacing_mm) @ self.direction.T + self.origin_mm

    def to_index(self, world_mm: np.ndarray) -> np.ndarray:
        """Voxel indices (..., 3) in the order x, y, z, with fractions, of world positions (..., 3) in mm."""
        inverse = np.linalg.inv(self.direction)
        return (np.asarray(world_mm, dtype=np.float64) - self.origin_mm) @ inverse.T / self.spacing_mm


def is_volume_path(path: Path | str) -> bool:
    """Whether the name is that of a volume, or of a folder (of slices, or zarr)."""
    return str(path).lower().endswith((*SUFFIXES, *hdf5_arrays.SUFFIXES)) or Path(path).is_dir()


def check_spacing(spacing_mm: np.ndarray) -> None:
    """:raises InputError: when a spacing is not finite, not positive, above 1 m or differs 1000-fold between axes."""
    spacing = np.asarray(spacing_mm, dtype=np.float64)
    sane = np.isfinite(spacing).all() and (spacing > 0).all()
    if not sane or spacing.max() > _MAX_SPACING_MM or spacing.max() > _MAX_SPACING_RATIO * spacing.min():
        raise InputError(f"the spacing {spacing.tolist()} mm is absurd; correct it or use --spacing X,Y,Z")


def default_memory_bytes() -> int:
    """What a volume may take when nothing is said: half of the memory that is available now."""
    return int(_SHARE_OF_AVAILABLE * available_memory_bytes())


def available_memory_bytes() -> int:
    """The memory that is available now, to this machine or to the control group that we are in."""
    available = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")] if hasattr(os, "sysconf") else [4 << 30]
    try:
        match = re.search(r"MemAvailable:\s+(\d+) kB", Path("/proc/meminfo").read_text())
        available += [int(match[1]) * 1024] if match else []
        limit = Path("/sys/fs/cgroup/memory.max").read_text().strip()
        used = int(Path("/sys/fs/cgroup/memory.current").read_text())
        available += [max(int(limit) - used, 0)] if limit.isdigit() else []
    except OSError:
        pass  # not Linux, or no control group: the figures so far stand
    return int(min(available))


def read_volume(
    path: Path | str, *, spacing_mm: Sequence[float] | None = None, max_memory_bytes: int | None = None
) -> Volume:
    """An image with three axes: NRRD, NIfTI, MetaImage, a TIFF of many pages, a folder of TIFF slices, zarr, HDF5.

    The values keep their type and are held once. Everything that was taken as given is noted in ``meta["notes"]``.

    :param spacing_mm: x, y, z; needed where the file has none (TIFF), otherwise replaces what the file says.
    :param max_memory_bytes: what the voxels may take; half of the memory available by default.
    :raises InputError: for whatever is no such image, with the name of the file, what is wrong and the remedy.
    """
    path = Path(path)
    allowed = default_memory_bytes() if max_memory_bytes is None else int(max_memory_bytes)
    stored = zarr_arrays.is_zarr(path) or hdf5_arrays.is_hdf5(path)
    described = None if stored else describe(path, given_spacing(spacing_mm))
    if described is None or (described.header.kind == "NIfTI" and described.header.flat is not None):
        from vascval.io.scans import read_stored

        return read_stored(path, spacing_mm, allowed)
    header = described.header
    require_memory(path, allowed, header.sizes, header.itemsize)
    require_whole(path, header)
    if header.kind == "NIfTI":
        _require_alone(path)
    if header.kind == "MetaImage":
        raster = meta_image.read_voxels(path, header)
    else:
        raster = itk.read_image(path, described.files, header, partial(require_memory, path, allowed))
    volume = place(described, raster)
    try:
        for z in range(volume.shape[0]):
            require_finite(volume.values[z : z + 1], z, 0)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return volume


def _require_alone(path: Path) -> None:
    """Refuses ``x.nii.gz`` beside ``x.nii``: the library takes the header of the one and the values of the other."""
    if path.name.lower().endswith(".gz") and path.with_suffix("").exists():
        raise InputError(f"{path}: lies beside {path.stem}, whose values would be taken for its own; move one away")


def given_spacing(spacing_mm: Sequence[float] | None) -> np.ndarray | None:
    """:raises InputError: when a spacing is given that is not three numbers."""
    given = None if spacing_mm is None else np.asarray(spacing_mm, dtype=np.float64)
    if given is not None and given.shape != (3,):
        raise InputError(f"the spacing {given.tolist()} is not three numbers; give X,Y,Z in mm")
    return given


@dataclass(frozen=True, eq=False)
class Described:
    """An image of which the header alone is read: its ``files`` (slices of a folder) and the spacing that was given."""

    path: Path
    files: list[Path]
    header: Header
    given_mm: np.ndarray | None


def describe(path: Path, given_mm: np.ndarray | None) -> Described:
    """The header of an image file or a folder of slices.

    :raises InputError: when it is no such image, or gives no spacing and none was given.
    """
    files = slices_of(path) if path.is_dir() else [path]
    header = read_header(files[0])
    if path.is_dir():
        header = _stack_header(path, files, header)
    if not header.has_spacing and given_mm is None:
        raise InputError(f"{path}: {header.kind} gives no spacing in three dimensions; use --spacing X,Y,Z (mm)")
    return Described(path, files, header, given_mm)


def place(described: Described, raster: Raster) -> Volume:
    """The values of a file in their place in the world, in millimetres."""
    path, header, given = described.path, described.header, described.given_mm
    if given is not None and header.has_spacing:
        raster.notes.append(f"spacing given as {given.tolist()} mm, the file says {raster.spacing.tolist()}")
    scale = header.mm_per_unit
    meta = {**_stored_meta(header), "source": path.name, "format": header.kind, "notes": raster.notes}
    try:
        return Volume(
            values=raster.values,
            spacing_mm=raster.spacing * scale if given is None else given,
            origin_mm=raster.origin * scale,
            direction=raster.direction,
            meta=meta,
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def slices_of(folder: Path) -> list[Path]:
    """The TIFF slices of a folder in the order of the last number in their names.

    :raises InputError: when there are none, or numbers are missing, double or absent.
    """
    found = [item for item in folder.iterdir() if item.suffix.lower() in (".tif", ".tiff")]
    if not found:
        raise InputError(f"{folder}: holds no TIFF slices; give a folder of numbered .tif files or one file")
    numbers: dict[int, list[Path]] = {}
    for item in sorted(found):
        digits = re.findall(r"\d+", item.stem)
        if not digits:
            raise InputError(f"{folder}: slice {item.name} has no number; number the slices or move it away")
        numbers.setdefault(int(digits[-1]), []).append(item)
    first, last = min(numbers), max(numbers)
    double = [names for names in numbers.values() if len(names) > 1]
    if double:
        raise InputError(f"{folder}: {double[0][0].name} and {double[0][1].name} are one slice; move one away")
    if last - first + 1 != len(numbers):
        gap = next(i for i in range(first, last) if i not in numbers)
        raise InputError(f"{folder}: slice {gap} is missing between {first} and {last}; complete the stack")
    return [numbers[i][0] for i in sorted(numbers)]


def _stack_header(folder: Path, files: list[Path], first: Header) -> Header:
    """The header of a stack of slices, all of which must be alike."""
    flats = []
    for file in files:
        other = read_header(file)
        if other.kind != "TIFF" or other.sizes != first.sizes or other.itemsize != first.itemsize:
            size = " x ".join(map(str, other.sizes[:2]))
            raise InputError(f"{folder}: slice {file.name} has {size} pixels of another kind; take it out or mend it")
        flats.append(other.flat)
    sizes = (*first.sizes[:2], first.sizes[2] * len(files))
    return replace(first, sizes=sizes, flat=stacked(flats))


def require_memory(path: Path, allowed: int, sizes: Sequence[int], itemsize: int) -> None:
    """Refuses values that need more memory than is allowed."""
    needed = math.prod(sizes) * itemsize
    if needed > allowed:
        raise InputError(
            f"{path}: {' x '.join(map(str, sizes))} voxels need {min(needed, 10**99) / _GIB:.3g} GiB, "
            f"{allowed / _GIB:.3g} GiB are allowed; crop or downsample it, or allow more (--max-memory)"
        )


def require_finite(values: np.ndarray, z: int, y: int) -> None:
    """Refuses a block (dz, dy, nx), which begins at slice z and row y, with a value that is not finite."""
    if not np.issubdtype(values.dtype, np.inexact) or np.isfinite(values).all():
        return
    at = np.argwhere(~np.isfinite(values))[0]
    where = f"({at[2]}, {at[1] + y}, {at[0] + z})"
    value = values[tuple(at)]
    raise InputError(f"voxel {where} is {value}; replace values that are not finite by background")


def _stored_meta(header: Header) -> dict[str, Any]:
    """What :func:`write_volume` stored beside the voxels; nothing when another program wrote the file."""
    try:
        stored = json.loads(header.texts.get(_META_KEY, "{}"))
    except ValueError:
        return {}
    return stored if isinstance(stored, dict) else {}


def write_volume(volume: Volume, path: Path | str) -> None:
    """The volume as NRRD (gzip), NIfTI or MetaImage by the suffix: .nrrd, .nii, .nii.gz or .mha; atomic.

    NRRD and MetaImage carry ``meta`` too. The same volume gives the same bytes.

    :raises InputError: for another suffix or a place that cannot be written.
    """
    path = Path(path)
    name = path.name.lower()
    if not name.endswith((".nrrd", ".nii", ".nii.gz", ".mha")):
        raise InputError(f"{path}: volumes are written as .nrrd, .nii, .nii.gz or .mha; choose one of these")
    values = volume.values.view(np.uint8) if volume.values.dtype == bool else volume.values
    if values.dtype.str[1:] not in _NRRD_TYPES:
        raise InputError(f"{path}: values of type {values.dtype} have no place in an image; convert them to float32")
    meta = json.dumps(dict(volume.meta), sort_keys=True)
    with atomic_file(path) as aside:
        if name.endswith(".nrrd"):
            _write_nrrd(volume, values, meta, aside)
            return
        texts = {_META_KEY: meta} if name.endswith(".mha") else {}
        try:
            itk.write_image(aside, values, volume.spacing_mm, volume.origin_mm, volume.direction, texts)
        except RuntimeError as error:
            said = str(error).strip().splitlines() or ["no reason given"]
            raise InputError(f"{path}: cannot be written ({said[-1][:160]}); choose another format or place") from error


_NRRD_TYPES = {
    "i1": "int8", "u1": "uint8", "i2": "int16", "u2": "uint16", "i4": "int32", "u4": "uint32",
    "i8": "int64", "u8": "uint64", "f4": "float", "f8": "double",
}  # fmt: skip


def _write_nrrd(volume: Volume, values: np.ndarray, meta: str, path: Path) -> None:
    """Slice by slice through the compressor, so that no second copy of the volume is made."""
    axes = " ".join(_vector(volume.direction[:, i] * volume.spacing_mm[i]) for i in range(3))
    escaped = meta.replace("\\", "\\\\")
    lines = [
        "NRRD0005",
        f"type: {_NRRD_TYPES[values.dtype.str[1:]]}",
        "dimension: 3",
        "space: left-posterior-superior",
        "sizes: " + " ".join(str(n) for n in values.shape[::-1]),
        f"space directions: {axes}",
        "kinds: domain domain domain",
        "endian: little",
        "encoding: gzip",
        'space units: "mm" "mm" "mm"',
        f"space origin: {_vector(volume.origin_mm)}",
        f"{_META_KEY}:={escaped}",
    ]
    compressor = zlib.compressobj(level=6, wbits=zlib.MAX_WBITS | 16)
    with path.open("wb") as stream:
        stream.write(("\n".join(lines) + "\n\n").encode())
        for plane in values:
            little = plane.astype(plane.dtype.newbyteorder("<"), copy=False)
            stream.write(compressor.compress(np.ascontiguousarray(little).tobytes()))
        stream.write(compressor.flush())


def _vector(values: np.ndarray) -> str:
    return "(" + ",".join(repr(float(value)) for value in values) + ")"
