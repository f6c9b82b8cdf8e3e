"""What kind of image a file holds, and whether its header may be trusted, before any library opens it.

Headers are read here as far as safety asks: a detached header may only name data inside its own folder, and the sizes
that a header claims must be held against the memory allowed and the bytes there are before anything is allocated.
"""

from __future__ import annotations

import gzip
import math
import os
import re
import struct
import zlib
from pathlib import Path

import numpy as np

from vascval.core.errors import InputError
from vascval.core.units import MM_PER
from vascval.io import meta_image, tiff_headers
from vascval.io.header_checks import (
    DENSEST,
    Flat,
    Header,
    confined,
    consecutive,
    first_bytes,
    gzipped,
    integers,
    numbered_files,
    positive,
    require_bytes,
)


def read_header(path: Path) -> Header:
    """The header of an image file, recognised by content.

    :raises InputError: when the file is missing, empty, of no known kind, or its header is not to be trusted.
    """
    head = first_bytes(path)
    if not head:
        raise InputError(f"{path}: the file is empty; check how it was written")
    if head.startswith(b"NRRD"):
        return _nrrd(path, head)
    if head[:4] in tiff_headers.MAGIC:
        pages = tiff_headers.read_pages(path)
        sizes = (pages.width, pages.height, pages.count)
        values = None
        if pages.dtype is not None:
            files = np.zeros(pages.count, dtype=np.int64)
            values = Flat(pages.dtype, sizes[::-1], (path,), files, np.array(pages.starts))
        itemsize = max(pages.bits // 8, 1)
        return Header("TIFF", "TIFFImageIO", sizes, itemsize=itemsize, has_spacing=False, flat=values)
    if meta_image.is_header(head):
        return meta_image.read_header(path, head)
    raw = _unzipped(head) if head[:2] == b"\x1f\x8b" else head
    for endian in "<>":
        if len(raw) >= 348 and struct.unpack(endian + "i", raw[:4])[0] in _NIFTI_SIZES:
            return _nifti(path, raw, endian, raw is not head)
    raise InputError(f"{path}: is no image that can be read; give NRRD, NIfTI, MetaImage or a TIFF stack")


# --- NRRD ---------------------------------------------------------------------------------------------------------

_LONGEST_FIELD = 1000  # the library writes beyond a buffer when it quotes a longer one in an error
_TEXT = ("txt", "text", "ascii")
_LONGEST_WORD = 64  # of values as text; the library writes beyond a buffer on longer ones
_NRRD_BYTES = {
    **dict.fromkeys(("signed char", "int8", "int8_t", "uchar", "unsigned char", "uint8", "uint8_t"), 1),
    **dict.fromkeys(("short", "short int", "signed short", "signed short int", "int16", "int16_t"), 2),
    **dict.fromkeys(("ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"), 2),
    **dict.fromkeys(("int", "signed int", "int32", "int32_t", "uint", "unsigned int", "uint32", "uint32_t"), 4),
    **dict.fromkeys(("longlong", "long long", "long long int", "signed long long", "signed long long int"), 8),
    **dict.fromkeys(("int64", "int64_t", "ulonglong", "unsigned long long", "unsigned long long int"), 8),
    **dict.fromkeys(("uint64", "uint64_t", "double"), 8),
    "float": 4,
}


def _nrrd(path: Path, head: bytes) -> Header:
    lines, data_at = _nrrd_lines(head)
    fields: dict[str, str] = {}
    texts: dict[str, str] = {}
    names: list[str] = []
    for number, line in enumerate(lines[1:], start=2):
        if line.startswith("#"):
            continue
        name, colon, value = line.partition(":")
        if not colon:
            raise InputError(f"{path}: line {number} of the NRRD header is no field; the file is damaged")
        if value.startswith("="):
            texts[name] = re.sub(r"\\(.)", lambda match: "\n" if match[1] == "n" else match[1], value[1:])
            continue
        if len(line) > _LONGEST_FIELD:
            raise InputError(f"{path}: line {number} of the NRRD header has {len(line):,} characters; it is damaged")
        key = re.sub(r"\s", "", name).lower()
        fields[key] = value.strip()
        if key == "datafile" and fields[key].upper().startswith("LIST"):
            names = [item.strip() for item in lines[number:] if item.strip()]
            break
    sizes = integers(path, fields.get("sizes", ""), "sizes")
    itemsize = _NRRD_BYTES.get(fields.get("type", "").lower())
    if not sizes or itemsize is None:
        raise InputError(f"{path}: the NRRD header lacks sizes or names an unknown type; the file is damaged")
    files = [path]
    if "datafile" in fields:
        files = [confined(path, name) for name in names or numbered_files(path, fields["datafile"])]
    encoding = fields.get("encoding", "").lower()
    if encoding in _TEXT:
        _require_short_words(path, files, 0 if "datafile" in fields else data_at)
    if encoding == "raw" and fields.get("byteskip", "0") in ("0", "-1"):
        require_bytes(path, files, math.prod(sizes) * itemsize, 0 if "datafile" in fields else data_at)
    return Header(
        "NRRD",
        "NrrdImageIO",
        sizes=sizes,
        itemsize=itemsize,
        has_spacing=_nrrd_spacing(path, fields),
        mm_per_unit=_nrrd_unit(path, fields.get("spaceunits", fields.get("units", ""))),
        texts=texts,
        files=tuple(files),
        least_bytes=_nrrd_least(path, encoding, math.prod(sizes), itemsize),
        flat=_nrrd_flat(fields, sizes, files, 0 if "datafile" in fields else data_at),
    )


def _nrrd_flat(fields: dict[str, str], sizes: tuple[int, ...], files: list[Path], data_at: int) -> Flat | None:
    """Where raw or packed values lie, if nothing in the files is to be skipped."""
    name = fields["type"].lower()
    kind = "f" if name in ("float", "double") else "u" if name.startswith("u") else "i"
    itemsize = _NRRD_BYTES[name]
    order = {"little": "<", "big": ">"}.get(fields.get("endian", "little" if itemsize == 1 else "").lower())
    skips = [fields.get(key, "0") for key in ("lineskip", "byteskip")]
    encoding = fields.get("encoding", "").lower()
    if encoding not in ("raw", "gz", "gzip") or order is None or skips != ["0", "0"]:
        return None
    dtype = np.dtype(f"{order}{kind}{itemsize}")
    if encoding == "raw":
        return consecutive(dtype, sizes, files, [data_at] * len(files))
    return gzipped(consecutive(dtype, sizes, files, [0] * len(files)), data_at)


def _require_short_words(path: Path, files: list[Path], data_at: int) -> None:
    if any(re.search(rb"\S{%d}" % _LONGEST_WORD, file.read_bytes()[data_at:]) for file in files):
        raise InputError(f"{path}: a value has {_LONGEST_WORD} characters or more; the file is damaged")


def _nrrd_least(path: Path, encoding: str, count: int, itemsize: int) -> int:
    """Bytes that so many values take at least; the library allocates and clears their memory before it looks."""
    if encoding == "raw":
        return count * itemsize
    if encoding in ("gz", "gzip"):
        return count * itemsize // DENSEST
    if encoding in _TEXT:
        return 2 * count - 1
    if encoding == "hex":
        return 2 * count * itemsize
    raise InputError(f"{path}: the encoding {encoding!r} of the NRRD is not read; save it as raw or gzip")


def _nrrd_lines(head: bytes) -> tuple[list[str], int]:
    """The header's lines, and where the data begin (at the first empty line, or at the end)."""
    end = re.search(rb"\r?\n\r?\n", head)
    text = head[: end.start()] if end else head
    return text.decode("utf-8", "replace").splitlines(), end.end() if end else len(head)


def _nrrd_spacing(path: Path, fields: dict[str, str]) -> bool:
    """Whether there is a spacing. Axes without one (``nan``, ``none``) are those of no space, such as channels."""
    vectors = re.findall(r"\(([^)]*)\)|(none)", fields.get("spacedirections", ""))
    words = fields.get("spacings", "").split()
    try:
        steps = [math.hypot(*(float(word) for word in vector.split(","))) for vector, none in vectors if not none]
        steps += [float(word) for word in words]
    except ValueError:
        raise InputError(f"{path}: the spacing is no list of numbers; the header is damaged") from None
    known = [step for step in steps if not math.isnan(step)]
    if any(not math.isfinite(step) or step <= 0 for step in known) or 0 < len(known) < 3 <= len(steps):
        raise InputError(f"{path}: the spacing {steps} is absurd; correct the header")
    return bool(known)


def _nrrd_unit(path: Path, units: str) -> float:
    names = {name.strip() for name in re.findall(r'"([^"]*)"', units)} - {""}
    if not names:
        return 1.0
    known = {**MM_PER, "µm": 1e-3, "micron": 1e-3, "microns": 1e-3, "millimeter": 1.0, "millimetre": 1.0}
    if len(names) > 1 or not names <= known.keys():
        raise InputError(f"{path}: the axes have units {sorted(names)}; one of {', '.join(MM_PER)} is needed on all")
    return known[names.pop()]


# --- NIfTI --------------------------------------------------------------------------------------------------------

_NIFTI_SIZES = (348, 540)
_NIFTI_TYPES = {
    2: "u1", 4: "i2", 8: "i4", 16: "f4", 64: "f8", 256: "i1", 512: "u2", 768: "u4", 1024: "i8", 1280: "u8",
}  # fmt: skip
_NIFTI_PIXDIM = {348: ("8f", 76), 540: ("8d", 104)}


def _nifti(path: Path, raw: bytes, endian: str, is_gzip: bool) -> Header:
    size = struct.unpack(endian + "i", raw[:4])[0]
    magic = raw[344:347] if size == 348 else raw[4:7]
    if magic not in (b"n+1", b"n+2"):
        raise InputError(f"{path}: is an Analyze or detached NIfTI header; convert it to a single .nii or .nii.gz file")
    if not path.name.lower().endswith((".nii", ".nii.gz")):
        raise InputError(f"{path}: holds NIfTI under another suffix; rename it to .nii or .nii.gz")
    dims = struct.unpack_from(endian + ("8h" if size == 348 else "8q"), raw, 40 if size == 348 else 16)
    bits = struct.unpack_from(endian + "h", raw, 72 if size == 348 else 14)[0]
    n = dims[0]
    if not 1 <= n <= 7 or bits <= 0:
        raise InputError(f"{path}: the NIfTI header claims {n} axes of {bits} bits; the file is damaged")
    sizes = positive(path, dims[1 : n + 1], "dim")
    code, offset = _NIFTI_PIXDIM[size]
    pixdim = struct.unpack_from(endian + code, raw, offset)[1:4]
    if not all(math.isfinite(value) and value != 0 for value in pixdim[: min(n, 3)]):
        raise InputError(f"{path}: the spacing {pixdim} is absurd; correct pixdim in the header")
    start = struct.unpack_from(endian + ("f" if size == 348 else "q"), raw, 108 if size == 348 else 168)[0]
    data_at = int(start) if math.isfinite(start) and start > 0 else 0
    is_packed = path.name.lower().endswith(".gz")
    if not is_packed:
        require_bytes(path, [path], math.prod(sizes) * bits // 8, data_at)
    unpacked = data_at + math.prod(sizes) * bits // 8 if is_packed else 0
    flat = _nifti_flat(path, raw, endian, sizes, bits, data_at)
    if is_packed != is_gzip or data_at < size or min(pixdim) < 0:  # the library knows what it makes of these
        flat = None
    elif is_packed:
        flat = gzipped(flat, 0)
    return Header("NIfTI", "NiftiImageIO", sizes=sizes, itemsize=max(bits // 8, 1), unpacked_bytes=unpacked, flat=flat)


def _nifti_flat(path: Path, raw: bytes, endian: str, sizes: tuple[int, ...], bits: int, data_at: int) -> Flat | None:
    """Where the values lie, if they are real numbers that mean what they say (no scale)."""
    second = struct.unpack_from(endian + "i", raw)[0] == 540
    code = struct.unpack_from(endian + "h", raw, 12 if second else 70)[0]
    slope, intercept = struct.unpack_from(endian + ("2d" if second else "2f"), raw, 176 if second else 112)
    plain = slope == 0 or (slope == 1 and intercept == 0)
    dtype = np.dtype(endian + _NIFTI_TYPES.get(code, "V0"))
    if not plain or dtype.itemsize * 8 != bits:
        return None
    return consecutive(dtype, sizes, [path], [data_at])


def _unzipped(head: bytes) -> bytes:
    try:
        return zlib.decompressobj(wbits=zlib.MAX_WBITS | 16).decompress(head, 1024)
    except zlib.error:
        return b""


def require_whole(path: Path, header: Header) -> None:
    """Refuses NRRD of fewer bytes than its values can take, and compressed NIfTI that ends early without a word from
    the library.

    The last four bytes of a complete file of one member hold the size (mod 2^32) of what was packed; only where that
    does not fit is the file unpacked to see, without keeping anything.
    """
    require_bytes(path, header.files, header.least_bytes, 0)
    if header.unpacked_bytes == 0:
        return
    with path.open("rb") as stream:
        stream.seek(-4, os.SEEK_END)
        if (struct.unpack("<I", stream.read(4))[0] - header.unpacked_bytes) % 2**32 < 1 << 16:
            return
    there = 0
    try:
        with gzip.open(path) as packed:
            while there < header.unpacked_bytes and (block := packed.read(1 << 20)):
                there += len(block)
    except (OSError, EOFError, zlib.error):
        there = 0
    if there < header.unpacked_bytes:
        raise InputError(f"{path}: its compressed data end early; it is truncated, get it again")
