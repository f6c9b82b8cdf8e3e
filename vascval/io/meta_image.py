"""MetaImage (.mha, .mhd): header and voxels.

Read here and not by ITK, whose reader writes beyond its arrays or never returns on some damaged files.
"""

from __future__ import annotations

import math
import re
import zlib
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from vascval.core.errors import InputError
from vascval.io.header_checks import (
    Flat,
    Header,
    Raster,
    confined,
    consecutive,
    integers,
    numbered_files,
    require_bytes,
    require_shape,
)

_LINE = re.compile(rb"\s*[A-Za-z]\w*\s*[=:]")
_TYPES = {
    "CHAR": "i1", "UCHAR": "u1", "SHORT": "i2", "USHORT": "u2", "INT": "i4", "UINT": "u4", "LONG": "i4", "ULONG": "u4",
    "LONG_LONG": "i8", "ULONG_LONG": "u8", "FLOAT": "f4", "DOUBLE": "f8",
}  # fmt: skip
_SPACING = ("ElementSpacing", "ElementSize")
_ORIGIN = ("Offset", "Position", "Origin")
_DIRECTION = ("TransformMatrix", "Rotation", "Orientation")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*([eE][-+]?\d+)?|\.\d+([eE][-+]?\d+)?|nan|inf)", re.IGNORECASE)
_BLOCK = 1 << 20


def is_header(head: bytes) -> bool:
    """Whether a file that begins so is MetaImage."""
    return bool(_LINE.match(head)) and b"ElementDataFile" in head


def read_header(path: Path, head: bytes) -> Header:
    """What the header says.

    :raises InputError: when it does not add up, or names data outside its own folder.
    """
    fields, data_at = _fields(path, head)
    sizes = integers(path, fields.get("DimSize", ""), "DimSize")
    _require_counts(path, fields, len(sizes))
    dtype = _TYPES.get(fields.get("ElementType", "").removeprefix("MET_").removesuffix("_ARRAY"))
    data = fields.get("ElementDataFile", "")
    if not sizes or dtype is None or not data:
        raise InputError(f"{path}: the MetaImage header lacks its size, type or data; the file is damaged")
    names: list[str] = []
    if data.upper().startswith("LIST"):
        names = [line.strip() for line in head[data_at:].decode("utf-8", "replace").splitlines() if line.strip()]
    elif data.upper() != "LOCAL":
        names = numbered_files(path, data)
    files = tuple(confined(path, name) for name in names) or (path,)
    itemsize = np.dtype(dtype).itemsize
    if not _is_true(fields, "CompressedData"):
        require_bytes(path, list(files), math.prod(sizes) * itemsize, 0 if names else data_at)
    return Header(
        "MetaImage",
        "",
        sizes=sizes,
        itemsize=itemsize,
        has_spacing=any(key in fields for key in _SPACING),
        texts=fields,
        files=files,
        data_at=0 if names else data_at,
        flat=_flat(fields, sizes, files, 0 if names else data_at),
    )


def _fields(path: Path, head: bytes) -> tuple[dict[str, str], int]:
    """The fields, and where the header ends."""
    fields: dict[str, str] = {}
    for match in re.finditer(rb"[ \t]*([^=:\r\n]*?)[ \t]*[=:][ \t]*([^\r\n]*)\r?\n?", head):
        key = match[1].decode("latin-1")
        if key in fields:
            raise InputError(f"{path}: the MetaImage header has {key[:40]} twice; the file is damaged")
        fields[key] = match[2].decode("utf-8", "replace").strip()
        if key == "ElementDataFile":
            return fields, match.end()
    return fields, len(head)


def _require_counts(path: Path, fields: dict[str, str], n: int) -> None:
    if fields.get("NDims") != str(n):
        raise InputError(f"{path}: NDims is {fields.get('NDims', 'absent')[:40]} for {n} sizes; the header is damaged")
    counts = {"ElementNumberOfChannels": 1, "HeaderSize": 1, **dict.fromkeys((*_SPACING, *_ORIGIN), n)}
    for key, count in {**counts, **dict.fromkeys(_DIRECTION, n * n)}.items():
        words = fields.get(key, "").split()
        if key in fields and (len(words) != count or not all(_NUMBER.fullmatch(word) for word in words)):
            raise InputError(f"{path}: {key} is {' '.join(words)[:60]!r} for {n} axes; the header is damaged")


def _is_true(fields: dict[str, str], key: str) -> bool:
    return fields.get(key, "False").lower() in ("true", "1")


def _numbers(fields: dict[str, str], keys: tuple[str, ...], default: np.ndarray) -> np.ndarray:
    text = next((fields[key] for key in keys if key in fields), None)
    return default if text is None else np.array([float(word) for word in text.split()]).reshape(default.shape)


def read_voxels(path: Path, header: Header) -> Raster:
    """The voxels that belong to a header, held once.

    :raises InputError: when there are not three axes of one value each, or the data are not all there.
    """
    raster = read_frame(path, header)
    flat = np.empty(math.prod(header.sizes), dtype=_dtype(header.texts))
    _fill(path, header, flat.view(np.uint8).data)
    values = flat if flat.dtype.isnative else flat.byteswap(inplace=True).view(flat.dtype.newbyteorder("="))
    return replace(raster, values=values.reshape(header.sizes[2::-1]))


def read_frame(path: Path, header: Header) -> Raster:
    """Place and notes of the volume, with a single voxel for its values.

    :raises InputError: when there are not three axes of one value each, or values are not binary.
    """
    fields, n = header.texts, len(header.sizes)
    notes = require_shape(path, header.sizes, False, int(float(fields.get("ElementNumberOfChannels", "1"))))
    if fields.get("BinaryData", "True").lower() in ("false", "0"):
        raise InputError(f"{path}: holds its values as text; save it with BinaryData = True")
    direction = _numbers(fields, _DIRECTION, np.eye(n)).T
    return Raster(
        values=np.zeros((1, 1, 1), dtype=np.uint8),
        spacing=_numbers(fields, _SPACING, np.ones(n))[:3],
        origin=_numbers(fields, _ORIGIN, np.zeros(n))[:3],
        direction=direction[:3, :3],
        notes=notes,
    )


def _dtype(fields: dict[str, str]) -> np.dtype:
    big = _is_true(fields, "BinaryDataByteOrderMSB") or _is_true(fields, "ElementByteOrderMSB")
    return np.dtype((">" if big else "<") + _TYPES[fields["ElementType"].removeprefix("MET_").removesuffix("_ARRAY")])


def _flat(fields: dict[str, str], sizes: tuple[int, ...], files: tuple[Path, ...], data_at: int) -> Flat | None:
    """Where uncompressed values of one channel lie."""
    channels = int(float(fields.get("ElementNumberOfChannels", "1")))
    if _is_true(fields, "CompressedData") or channels != 1:
        return None
    dtype, skip = _dtype(fields), int(float(fields.get("HeaderSize", "0")))
    share = math.prod(sizes) * dtype.itemsize // len(files)
    at_end = skip < 0 and data_at == 0
    skips = [max(file.stat().st_size - share, 0) if at_end else data_at + max(skip, 0) for file in files]
    return consecutive(dtype, sizes, files, skips)


def _fill(path: Path, header: Header, target: memoryview) -> None:
    """Fills the bytes of the voxels from the data files, one after the other."""
    packed = _is_true(header.texts, "CompressedData")
    skip = int(float(header.texts.get("HeaderSize", "0")))
    share, filled = len(target) // len(header.files), 0
    for file in header.files:
        with file.open("rb") as stream:
            at_end = skip < 0 and not packed and header.data_at == 0
            stream.seek(max(file.stat().st_size - share, 0) if at_end else header.data_at + max(skip, 0))
            if packed:
                filled += _unpack(path, stream, target[filled:])
            else:
                filled += stream.readinto(target[filled:])  # type: ignore[attr-defined]
    if filled < len(target):
        raise InputError(f"{path}: holds {filled:,} bytes of {len(target):,}; it is truncated or damaged")


def _unpack(path: Path, stream: BinaryIO, target: memoryview) -> int:
    """Unpacks a zlib stream into ``target`` and returns the number of bytes; its checksum must be right."""
    unpacker, filled = zlib.decompressobj(), 0
    try:
        while not unpacker.eof and (block := unpacker.unconsumed_tail or stream.read(_BLOCK)):
            piece = unpacker.decompress(block, len(target) - filled + 1)
            if filled + len(piece) > len(target):
                raise InputError(f"{path}: unpacks to more than its header says; the file is damaged")
            target[filled : filled + len(piece)] = piece
            filled += len(piece)
    except zlib.error as error:
        raise InputError(f"{path}: cannot be unpacked ({error}); it is truncated or damaged") from error
    if not unpacker.eof:
        raise InputError(f"{path}: its compressed data end early; it is truncated or damaged")
    return filled
