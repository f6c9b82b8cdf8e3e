"""Legacy VTK files that hold poly data, ASCII or binary, versions 1 to 5.

Read here and not by VTK, which ends the whole process on some damaged files. No count in the file is believed before
it is held against the bytes that are left.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Literal
from urllib.parse import unquote

import numpy as np

from vascval.core.errors import InputError
from vascval.io.polydata import PolyData, require_sound

_TYPES = {
    "char": "i1", "unsigned_char": "u1", "short": "i2", "unsigned_short": "u2", "int": "i4", "unsigned_int": "u4",
    "long": "i8", "unsigned_long": "u8", "vtktypeint64": "i8", "vtktypeuint64": "u8", "float": "f4", "double": "f8",
    "vtkidtype": "i4",
}  # fmt: skip
_CELLS = ("VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS")
_WIDTH = {"VECTORS": 3, "NORMALS": 3, "TENSORS": 9, "TENSORS6": 6, "GLOBAL_IDS": 1, "PEDIGREE_IDS": 1, "EDGE_FLAGS": 1}
_LONGEST_LINE = 4096


class _Damaged(Exception):
    """The file cannot be what it says it is."""


def read_legacy(path: Path, kind: Literal["lines", "polygons"] = "lines") -> PolyData:
    """The lines, or polygons, of a legacy VTK file with ``DATASET POLYDATA``.

    :raises InputError: when it is not one, is damaged, or claims more than it can hold.
    """
    reader = _Reader(path.read_bytes())
    try:
        found = reader.head()
        if found != "POLYDATA":
            raise InputError(f"{path}: is a VTK file with {found}; save it as POLYDATA")
        with np.errstate(invalid="ignore", over="ignore"):  # values that are not finite are looked for below
            while reader.section():
                pass
            data = reader.poly_data(kind.upper())
    except (_Damaged, ValueError, OverflowError) as error:
        raise InputError(f"{path}: is no sound VTK file ({str(error)[:160]}); it is truncated or damaged") from error
    require_sound(path, data, kind)
    return data


class _Reader:
    def __init__(self, content: bytes) -> None:
        self._content = content
        self._at = 0
        self._binary = False
        self._place = "FIELD"
        self._n = 0
        self._points = np.zeros((0, 3))
        self._cells = {name: (np.zeros(1, dtype=np.int64), np.zeros(0, dtype=np.int64)) for name in _CELLS}
        self._arrays: dict[str, dict[str, np.ndarray]] = {"FIELD": {}, "POINT_DATA": {}, "CELL_DATA": {}}
        self._texts: dict[str, str] = {}

    def head(self) -> str:
        """Reads to the line that names the data set, and returns its name."""
        self._raw_line()
        self._raw_line()
        mode = self._words()
        self._binary = mode[:1] == ["BINARY"]
        words = self._words()
        return words[1].upper()[:40] if len(words) == 2 and words[0].upper() == "DATASET" else "no data set"

    def section(self) -> bool:
        """Reads one section; False at the end of the file."""
        words = self._words()
        if not words:
            return False
        key = words[0].upper()
        if key == "METADATA":
            self._skip_metadata()
        elif key == "POINTS":
            self._points = self._values(3 * self._count(words, 1), self._word(words, 2)).reshape(-1, 3)
        elif key in _CELLS:
            self._cells[key] = self._read_cells(self._count(words, 1), self._count(words, 2))
        elif key in ("CELL_DATA", "POINT_DATA"):
            self._place, self._n = key, self._count(words, 1)
        elif key == "FIELD":
            for _ in range(self._count(words, 2)):
                self._field_array()
        else:
            self._attribute(key, words)
        return True

    def poly_data(self, kind: str) -> PolyData:
        """Points, and the cells of one kind with their data."""
        offsets, connectivity = self._cells[kind]
        before = sum(len(self._cells[other][0]) - 1 for other in _CELLS[: _CELLS.index(kind)])
        n_lines, n_points = len(offsets) - 1, len(self._points)
        cells, points = self._arrays["CELL_DATA"], self._arrays["POINT_DATA"]
        return PolyData(
            points=self._points.astype(np.float64),
            offsets=offsets,
            connectivity=connectivity,
            point_data={name: values for name, values in points.items() if len(values) == n_points},
            cell_data={
                name: values[before : before + n_lines]
                for name, values in cells.items()
                if len(values) >= before + n_lines
            },
            texts=self._texts,
        )

    # --- sections ---

    def _read_cells(self, n: int, size: int) -> tuple[np.ndarray, np.ndarray]:
        """Offsets and connectivity: of version 5 as they stand, of older ones from ``size`` numbers ``k id .. id``."""
        before = self._at
        words = self._words()
        if words[:1] == ["OFFSETS"]:
            offsets = self._values(n, self._word(words, 1))
            words = self._words()
            if words[:1] != ["CONNECTIVITY"]:
                raise _Damaged("offsets without connectivity")
            return offsets.astype(np.int64), self._values(size, self._word(words, 1)).astype(np.int64)
        self._at = before
        flat = self._values(size, "int").astype(np.int64)
        starts, at = np.empty(n, dtype=np.int64), 0
        for i in range(n):
            if at >= size or flat[at] < 0:
                raise _Damaged(f"cell {i} of {n} is not all there")
            starts[i] = at
            at += int(flat[at]) + 1
        if at != size:
            raise _Damaged(f"{n} cells take {at} numbers, not {size}")
        return np.concatenate(([0], np.cumsum(flat[starts]))), np.delete(flat, starts)

    def _attribute(self, key: str, words: list[str]) -> None:
        name = unquote(self._word(words, 1))
        if key == "SCALARS":
            width = self._count(words, 3) if len(words) > 3 else 1
            before = self._at
            if self._words()[:1] != ["LOOKUP_TABLE"]:
                self._at = before
            self._keep(name, self._values(self._n * width, self._word(words, 2)), width)
        elif key in _WIDTH:
            self._keep(name, self._values(self._n * _WIDTH[key], self._word(words, 2)), _WIDTH[key])
        elif key == "TEXTURE_COORDINATES":
            width = self._count(words, 2)
            self._keep(name, self._values(self._n * width, self._word(words, 3)), width)
        elif key == "COLOR_SCALARS":
            self._values(self._n * self._count(words, 2), "unsigned_char" if self._binary else "float")
        elif key == "LOOKUP_TABLE":
            self._values(4 * self._count(words, 2), "unsigned_char" if self._binary else "float")
        else:
            raise _Damaged(f"unknown keyword {key[:40]!r}")

    def _field_array(self) -> None:
        words = self._words()
        if words[:1] == ["METADATA"]:
            self._skip_metadata()
            words = self._words()
        name, kind = unquote(self._word(words, 0)), self._word(words, 3)
        width, n = self._count(words, 1), self._count(words, 2)
        if kind == "string":
            strings = [self._string() for _ in range(width * n)]
            if len(strings) == 1:
                self._texts[name] = strings[0]
            return
        self._keep(name, self._values(width * n, kind), width)

    def _skip_metadata(self) -> None:
        """To the empty line that ends such a section."""
        end = re.compile(rb"\n[ \t\r]*\n").search(self._content, self._at - 1)
        self._at = end.end() if end else len(self._content)

    def _keep(self, name: str, values: np.ndarray, width: int) -> None:
        self._arrays[self._place][name] = values if width == 1 else values.reshape(-1, max(width, 1))

    # --- the stream ---

    def _raw_line(self) -> bytes:
        end = self._content.find(b"\n", self._at)
        end = len(self._content) if end < 0 else end
        line = self._content[self._at : min(end, self._at + _LONGEST_LINE)]
        self._at = end + 1
        return line

    def _words(self) -> list[str]:
        """The words of the next line that has any; none at the end of the file."""
        while self._at < len(self._content):
            line = self._raw_line().strip()
            if line:
                return line.decode("utf-8", "replace").split()
        return []

    def _word(self, words: list[str], i: int) -> str:
        if i >= len(words):
            raise _Damaged(f"the line {' '.join(words)[:60]!r} is cut short")
        return words[i]

    def _count(self, words: list[str], i: int) -> int:
        text = self._word(words, i)
        if not (text.isascii() and text.isdigit()) or len(text) > 18 or int(text) > len(self._content):
            raise _Damaged(f"{' '.join(words)[:60]!r} in {len(self._content):,} bytes")
        return int(text)

    def _values(self, count: int, kind: str) -> np.ndarray:
        kind = kind.lower()
        left = len(self._content) - self._at
        if kind == "bit":
            stored = math.ceil(count / 8) if self._binary else 2 * count - 1
        elif kind in _TYPES:
            stored = count * np.dtype(_TYPES[kind]).itemsize if self._binary else 2 * count - 1
        else:
            raise _Damaged(f"unknown type {kind[:40]!r}")
        if stored > left:
            raise _Damaged(f"{count} values where {max(left, 0)} bytes are left")
        code = _TYPES.get(kind, "u1")
        if self._binary:
            raw = self._content[self._at : self._at + stored]
            self._at += stored
            if kind == "bit":
                return np.unpackbits(np.frombuffer(raw, dtype=np.uint8))[:count]
            return np.frombuffer(raw, dtype=">" + code).astype(code)
        words = self._content[self._at :].split(None, count)
        if len(words) < count:
            raise _Damaged(f"{len(words)} of {count} values")
        self._at = len(self._content) - (len(words[count]) if len(words) > count else 0)
        numbers = np.array(words[:count], dtype=bytes)
        return numbers.astype(np.float64 if code[0] == "f" else np.int64).astype(code)

    def _string(self) -> str:
        if not self._binary:
            return unquote(self._raw_line().strip().decode("utf-8", "replace"))
        first = self._content[self._at : self._at + 1]
        if not first:
            raise _Damaged("a text is not all there")
        size = {3: 1, 2: 2, 1: 4, 0: 8}[first[0] >> 6]  # bytes of the length, by its two highest bits
        length = int.from_bytes(self._content[self._at : self._at + size], "big") & ((1 << (8 * size - 2)) - 1)
        self._at += size
        if self._at + length > len(self._content):
            raise _Damaged("a text is not all there")
        text = self._content[self._at : self._at + length].decode("utf-8", "replace")
        self._at += length
        return text
