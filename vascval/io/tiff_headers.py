"""The directories of a TIFF file: page sizes, and whether all of its data are there.

The library that reads TIFF fills pages which are missing with zeros and says nothing; so they are looked for here.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from vascval.core.errors import InputError

MAGIC = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_MAX_PAGES = 200_000
_KIND, _WIDTH, _HEIGHT, _BITS, _PACKING, _SAMPLES, _ROWS_PER_STRIP = 254, 256, 257, 258, 259, 277, 278
_PLACES = ((273, 279), (324, 325))  # offsets and byte counts of strips, of tiles
_FORMAT, _LIGHT, _ORDER, _ORIENTATION = 339, 262, 266, 274
_USUAL = {_PACKING: 1, _SAMPLES: 1, _LIGHT: 1, _ORDER: 1, _ORIENTATION: 1}
_KINDS = {
    **{(1, bits): f"u{bits // 8}" for bits in (8, 16, 32)},
    **{(2, bits): f"i{bits // 8}" for bits in (8, 16, 32)},
    **{(3, bits): f"f{bits // 8}" for bits in (32, 64)},
}
_CODES = {1: "B", 3: "H", 4: "I", 16: "Q"}


@dataclass(frozen=True)
class Pages:
    """``width``, ``height`` and ``bits`` per value of all pages, and how many there are; ``dtype`` and ``starts`` where
    the values of each page lie uncompressed in one piece, else ``None``."""

    width: int
    height: int
    bits: int
    count: int
    dtype: np.dtype | None
    starts: list[int]


def read_pages(path: Path) -> Pages:
    """What the directories of a TIFF file (classic or big) say.

    :raises InputError: when pages differ in size, or directories or data lie beyond the end of the file.
    """
    sizes: list[tuple[int, int, int]] = []
    kinds: set[str | None] = set()
    starts: list[int] = []
    try:
        with path.open("rb") as stream:
            reader = _Reader(stream)
            at, seen = reader.first(), set()
            while at and len(sizes) < _MAX_PAGES:
                if at in seen:
                    raise InputError(f"{path}: its TIFF directories form a cycle; the file is damaged")
                seen.add(at)
                tags, at = reader.directory(at)
                sizes.append((tags.get(_WIDTH, [0])[0], tags.get(_HEIGHT, [0])[0], tags.get(_BITS, [1])[0]))
                _require_page(path, len(sizes) - 1, tags, reader.size)
                kinds.add(_plain(tags, reader.endian))
                starts.append(tags.get(_PLACES[0][0], [0])[0])
    except (_Missing, struct.error, OSError):
        what = f"page {len(sizes)} of the TIFF is not all there"
        raise InputError(f"{path}: {what}; it is truncated, get it again") from None
    if not sizes or min(sizes[0]) < 1:
        raise InputError(f"{path}: the TIFF has no page with a size; the file is damaged")
    other = next((i for i, size in enumerate(sizes) if size != sizes[0]), None)
    if other is not None:
        raise InputError(f"{path}: page {other} of the TIFF differs from page 0 in size or type; separate them")
    kind = kinds.pop() if len(kinds) == 1 else None
    return Pages(*sizes[0], len(sizes), None if kind is None else np.dtype(kind), starts)


def _plain(tags: dict[int, Sequence[int]], endian: str) -> str | None:
    """The type of the values of a page that lie uncompressed, black being 0, in strips one after the other."""
    if _PLACES[0][0] not in tags or any(tags.get(tag, [usual])[0] != usual for tag, usual in _USUAL.items()):
        return None
    kind = _KINDS.get((tags.get(_FORMAT, [1])[0], tags.get(_BITS, [1])[0]))
    starts, counts = tags[_PLACES[0][0]], tags[_PLACES[0][1]]
    ends = [start + count for start, count in zip(starts, counts)]
    return None if kind is None or list(starts[1:]) != ends[:-1] else endian + kind


def _require_page(path: Path, page: int, tags: dict[int, Sequence[int]], size: int) -> None:
    """Refuses a page whose data are not where it says, or not as many as its size needs.

    The library takes the number of strips and their sizes as they stand and writes beyond its buffers.
    """
    if tags.get(_KIND, [0])[0] not in (0, 2):  # neither a whole image nor a page of many
        raise InputError(f"{path}: page {page} of the TIFF is a thumbnail or a mask; export the plain slices")
    damaged = InputError(f"{path}: the tags of page {page} of the TIFF do not fit together; the file is damaged")
    bits, samples = tags.get(_BITS, [1]), tags.get(_SAMPLES, [1])[0]
    if set(bits) - {1, 8, 16, 32, 64} or len(set(bits)) > 1 or len(bits) not in (1, samples):
        raise damaged
    places = [(tags[a], tags[n]) for a, n in _PLACES if a in tags and n in tags and len(tags[a]) == len(tags[n])]
    if len(places) != 1 or not places[0][0]:
        raise damaged
    if max(a + n for a, n in zip(*places[0])) > size:
        raise _Missing
    if _PLACES[0][0] in tags:
        height = tags.get(_HEIGHT, [0])[0]
        rows = min(max(tags.get(_ROWS_PER_STRIP, [height])[0], 1), max(height, 1))
        n_strips = -(-height // rows)
        if len(places[0][0]) not in (n_strips, n_strips * samples):
            raise damaged
        needed = height * -(-tags.get(_WIDTH, [0])[0] * bits[0] * samples // 8)
        if tags.get(_PACKING, [1])[0] == 1 and sum(places[0][1]) < needed:
            raise damaged


class _Missing(Exception):
    """Something lies beyond the end of the file."""


class _Reader:
    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self.size = os.fstat(stream.fileno()).st_size
        magic = stream.read(4)
        self.endian = "<" if magic[:2] == b"II" else ">"
        self._big = b"+" in magic

    def first(self) -> int:
        return self._number("Q", 8) if self._big else self._number("I", 4)

    def directory(self, at: int) -> tuple[dict[int, Sequence[int]], int]:
        """The tags of a page that are of interest, and where the next directory is."""
        count_code, entry_code, value_code = ("Q", "HHQ8s", "Q") if self._big else ("H", "HHI4s", "I")
        count = self._number(count_code, at)
        start = at + struct.calcsize("=" + count_code)
        entry_size = struct.calcsize("=" + entry_code)
        if count > 65535:
            raise _Missing
        raw = self._bytes(start, count * entry_size)
        plain = (_KIND, _WIDTH, _HEIGHT, _BITS, _ROWS_PER_STRIP, _FORMAT, *_USUAL)
        wanted = {*plain, *(tag for pair in _PLACES for tag in pair)}
        tags: dict[int, Sequence[int]] = {}
        for tag, kind, n, value in struct.iter_unpack(self.endian + entry_code, raw):
            if tag in wanted and kind in _CODES and n > 0:
                code = f"{self.endian}{n}{_CODES[kind]}"
                size = n * struct.calcsize("=" + _CODES[kind])
                if size > len(value):
                    value = self._bytes(struct.unpack(self.endian + value_code, value)[0], size)
                tags[tag] = struct.unpack(code, value[:size])
        return tags, self._number(value_code, start + count * entry_size)

    def _number(self, code: str, at: int) -> int:
        return struct.unpack(self.endian + code, self._bytes(at, struct.calcsize("=" + code)))[0]

    def _bytes(self, at: int, count: int) -> bytes:
        if at + count > self.size:
            raise _Missing
        self._stream.seek(at)
        return self._stream.read(count)
