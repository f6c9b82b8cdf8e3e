"""The arrays of a VTK XML file: text, base64 or raw, packed by zlib, LZMA or LZ4, in the element or appended.

Read here and not by VTK, which ends the whole process when a damaged file claims an array of more than there is
memory. Nothing is allocated here before what a header says is held against the bytes that there are.
"""

from __future__ import annotations

import base64
import lzma
import math
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

_TYPES = {
    "Int8": "i1", "UInt8": "u1", "Int16": "i2", "UInt16": "u2", "Int32": "i4", "UInt32": "u4", "Int64": "i8",
    "UInt64": "u8", "Float32": "f4", "Float64": "f8", "String": "u1",
}  # fmt: skip
_DENSEST = 1100  # bytes out of one: zlib on zeros reaches 1032, LZ4 255
_BLOCK = 1 << 16  # VTK's blocks are 32 KiB, which LZMA may pack more densely


class Damaged(Exception):
    """An array cannot be what the file says it is."""


@dataclass(frozen=True)
class Encoding:
    """How the arrays of a file are stored: ``endian`` ("<" or ">"), ``header`` the type of the counts ("I" or "Q"),
    ``compressor`` VTK's class name or "", ``appended`` the bytes after the ``_``, raw or base64."""

    endian: str
    header: str
    compressor: str
    appended: memoryview
    appended_is_raw: bool


def decode(encoding: Encoding, attributes: Mapping[str, str], text: str) -> np.ndarray:
    """The values of a ``DataArray`` element, (n,) or (n, components).

    :raises Damaged: when they cannot be decoded.
    """
    code = _TYPES.get(attributes.get("type", ""))
    if code is None:
        raise Damaged(f"an array of type {attributes.get('type', '')[:20]!r}")
    kind = attributes.get("format", "ascii")
    dtype = np.dtype(code)
    try:
        if kind == "ascii":
            with np.errstate(over="ignore"):  # what is beyond single precision is not finite, which is looked for
                values = np.array(text.split(), dtype=np.float64 if code[0] == "f" else np.int64).astype(dtype)
        else:
            stored = _Stored(encoding, kind, attributes.get("offset", "0"), text)
            raw = stored.unpacked() if encoding.compressor else stored.plain()
            if len(raw) % dtype.itemsize:
                raise Damaged(f"{len(raw)} bytes for values of {dtype.itemsize}")
            values = np.frombuffer(raw, np.dtype(encoding.endian + code)).astype(dtype)
    except (ValueError, OverflowError, struct.error, zlib.error, lzma.LZMAError) as error:
        raise Damaged(str(error)) from error
    components = whole(attributes.get("NumberOfComponents", "").strip() or "1", "NumberOfComponents")
    if components == 1:
        return values
    if components < 1 or values.size % components:
        raise Damaged(f"{values.size} values for {components} components")
    return values.reshape(-1, components)


def whole(text: str, name: str) -> int:
    """The number that an attribute holds.

    :raises Damaged: when it is no whole number of up to 18 digits.
    """
    text = text.strip()
    if not (text.isascii() and text.isdigit() and len(text) <= 18):
        raise Damaged(f"{name} is {text[:20]!r}")
    return int(text)


class _Stored:
    """The bytes of one array, taken piece by piece from base64 or raw storage."""

    def __init__(self, encoding: Encoding, kind: str, offset: str, text: str) -> None:
        self._encoding = encoding
        self._raw = kind == "appended" and encoding.appended_is_raw
        if kind == "appended":
            begin = whole(offset, "offset")
            if begin >= max(len(encoding.appended), 1):
                raise Damaged(f"an offset of {begin}")
            self._data = encoding.appended[begin:]
        elif kind == "binary":
            self._data = memoryview("".join(text.split()).encode("ascii", "replace"))
        else:
            raise Damaged(f"the format {kind[:20]!r}")

    def _take(self, start: int, count: int) -> bytes:
        """``count`` bytes of a stream that begins at ``start`` (in stored units)."""
        stored = count if self._raw else self._stored(count)
        if start + stored > len(self._data):
            raise Damaged(f"{count} bytes where {max(len(self._data) - start, 0)} are left")
        piece = bytes(self._data[start : start + stored])
        return piece if self._raw else base64.b64decode(piece, validate=True)[:count]

    def _stored(self, count: int) -> int:
        """Stored units that ``count`` bytes take."""
        return count if self._raw else math.ceil(count / 3) * 4

    def _counts(self, start: int, n: int) -> tuple[int, ...]:
        size = struct.calcsize("=" + self._encoding.header)
        raw = self._take(start, n * size)
        return struct.unpack(f"{self._encoding.endian}{n}{self._encoding.header}", raw)

    def plain(self) -> bytes:
        """The bytes after a leading count, both in one stream."""
        size = struct.calcsize("=" + self._encoding.header)
        if len(self._data) == 0:
            return b""
        (count,) = self._counts(0, 1)
        return self._take(0, size + count)[size:]

    def unpacked(self) -> bytes:
        """The blocks after a header (number of blocks, their size, size of the last, packed sizes) of its own."""
        if len(self._data) == 0:
            return b""
        (n_blocks,) = self._counts(0, 1)
        if n_blocks == 0:
            return b""
        if n_blocks > len(self._data):
            raise Damaged(f"{n_blocks} blocks")
        _, size, last, *packed = self._counts(0, 3 + n_blocks)
        if sum(packed) > len(self._data) or last > size:
            raise Damaged(f"{n_blocks} blocks of {size} bytes, the last {last}, in {sum(packed)}")
        begin = self._stored((3 + n_blocks) * struct.calcsize("=" + self._encoding.header))
        data, at, blocks = self._take(begin, sum(packed)), 0, []
        for i, count in enumerate(packed):
            wanted = last if last and i == n_blocks - 1 else size
            if wanted > _BLOCK + _DENSEST * count:
                raise Damaged(f"a block of {wanted} bytes in {count}")
            blocks.append(_unpack(self._encoding.compressor, data[at : at + count], wanted))
            at += count
        return b"".join(blocks)


def _unpack(compressor: str, packed: bytes, size: int) -> bytes:
    if compressor == "vtkZLibDataCompressor":
        raw = zlib.decompressobj().decompress(packed, size + 1)
    elif compressor == "vtkLZMADataCompressor":
        raw = lzma.LZMADecompressor().decompress(packed, size + 1)
    elif compressor == "vtkLZ4DataCompressor":
        raw = _unpack_lz4(packed, size)
    else:
        raise Damaged(f"the compressor {compressor[:40]!r}")
    if len(raw) != size:
        raise Damaged(f"a block of {len(raw)} bytes for {size}")
    return raw


def _unpack_lz4(packed: bytes, size: int) -> bytes:
    from vascval.io import _lz4_kernels

    target = np.empty(size, dtype=np.uint8)
    if _lz4_kernels.unpack(np.frombuffer(packed, dtype=np.uint8), target) != size:
        raise Damaged("an LZ4 block that is cut short")
    return target.tobytes()
