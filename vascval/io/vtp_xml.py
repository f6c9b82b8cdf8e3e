"""VTK XML poly data (.vtp): the elements of the file, put together to points, lines and their arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from vascval.core.errors import InputError
from vascval.io import xml_guard
from vascval.io.polydata import PolyData, require_sound
from vascval.io.vtp_arrays import Damaged, Encoding, decode, whole

_SECTIONS = ("FieldData", "PointData", "CellData", "Points", "Verts", "Lines", "Strips", "Polys")
_CELLS = ("Verts", "Lines", "Polys", "Strips")  # in the order of the cells' data
_MAX_ARRAYS = 100_000


@dataclass
class _Array:
    attributes: dict[str, str]
    text: list[str] = field(default_factory=list)


@dataclass
class _Piece:
    attributes: dict[str, str]
    sections: dict[str, list[_Array]] = field(default_factory=dict)


def read_vtp(path: Path, kind: Literal["lines", "polygons"] = "lines") -> PolyData:
    """The lines, or polygons, of a VTP file (XML PolyData) of one or more pieces.

    :raises InputError: when it is not one, is damaged, has a document type, or claims more than it can hold.
    """
    document = _Document(path)
    stopped_at = xml_guard.parse(path, document.start, document.end, document.text)
    if document.kind != "PolyData":
        raise InputError(f"{path}: is XML but no VTK PolyData; save it as PolyData (.vtp)")
    encoding = _encoding(document, _appended(path, stopped_at))
    try:
        data = _assembled(document, encoding, "Lines" if kind == "lines" else "Polys")
    except Damaged as error:
        raise InputError(f"{path}: an array cannot be decoded ({error}); it is truncated or damaged") from error
    require_sound(path, data, kind)
    return data


class _Document:
    """Collects the arrays of each piece, and those of the whole file in ``field_data``."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.kind = ""
        self.attributes: dict[str, str] = {}
        self.pieces: list[_Piece] = []
        self.field_data: list[_Array] = []
        self.appended: dict[str, str] = {}
        self._section: list[_Array] | None = None
        self._array: _Array | None = None
        self._count = 0

    def start(self, name: str, attributes: dict[str, str]) -> bool:
        if not self.kind:
            self.kind = attributes.get("type", "") if name == "VTKFile" else "other"
            self.attributes = attributes
            return self.kind != "PolyData"
        if name == "AppendedData":
            self.appended = attributes
            return True
        if name == "Piece":
            self.pieces.append(_Piece(attributes))
        elif name in _SECTIONS:
            outside = name == "FieldData" or not self.pieces
            self._section = self.field_data if outside else self.pieces[-1].sections.setdefault(name, [])
        elif name in ("DataArray", "Array") and self._section is not None:
            self._count += 1
            if self._count > _MAX_ARRAYS:
                raise InputError(f"{self._path}: holds more than {_MAX_ARRAYS:,} arrays; this is no tree file")
            self._array = _Array(attributes)
            self._section.append(self._array)
        elif self._array is not None:
            self._array = None  # elements inside an array describe it; what follows them is no data
        return False

    def end(self, name: str) -> None:
        if name in ("DataArray", "Array"):
            self._array = None
        elif name in _SECTIONS:
            self._section = None

    def text(self, characters: str) -> None:
        if self._array is not None:
            self._array.text.append(characters)


def _appended(path: Path, stopped_at: int | None) -> memoryview:
    """The appended bytes after their mark ``_``; nothing when the file has none."""
    if stopped_at is None:
        return memoryview(b"")
    content = path.read_bytes()
    mark = content.find(b"_", content.find(b">", stopped_at))
    end = content.rfind(b"</AppendedData>")
    if mark < 0 or end < mark or not content[-256:].rstrip().endswith(b"</VTKFile>"):
        raise InputError(f"{path}: its appended data are not all there; it is truncated or damaged")
    return memoryview(content)[mark + 1 : end]


def _encoding(document: _Document, appended: memoryview) -> Encoding:
    return Encoding(
        endian=">" if document.attributes.get("byte_order") == "BigEndian" else "<",
        header="Q" if document.attributes.get("header_type") == "UInt64" else "I",
        compressor=document.attributes.get("compressor", ""),
        appended=appended,
        appended_is_raw=document.appended.get("encoding") == "raw",
    )


def _assembled(document: _Document, encoding: Encoding, kind: str) -> PolyData:
    parts = [_piece(piece, encoding, kind) for piece in document.pieces if _number(piece, "Points") > 0]
    shift, offsets, connectivity = 0, [np.zeros(1, dtype=np.int64)], []
    for part in parts:
        offsets.append(part.offsets[1:] + (offsets[-1][-1] if len(offsets[-1]) else 0))
        connectivity.append(part.connectivity + shift)
        shift += len(part.points)
    texts = {}
    for array in document.field_data:
        if array.attributes.get("type") == "String":
            raw = decode(encoding, array.attributes, "".join(array.text)).tobytes()
            texts[array.attributes.get("Name", "")] = raw.split(b"\0")[0].decode("utf-8", "replace")
    empty = np.zeros(0, dtype=np.int64)
    return PolyData(
        points=np.concatenate([np.zeros((0, 3)), *(part.points for part in parts)]),
        offsets=np.concatenate(offsets),
        connectivity=np.concatenate([empty, *connectivity]),
        point_data=_joined([part.point_data for part in parts]),
        cell_data=_joined([part.cell_data for part in parts]),
        texts=texts,
    )


def _joined(parts: list[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """The arrays that all pieces have, one after the other."""
    names = [name for name in parts[0] if all(name in part for part in parts)] if parts else []
    return {name: np.concatenate([part[name] for part in parts]) for name in names}


def _piece(piece: _Piece, encoding: Encoding, kind: str) -> PolyData:
    lines = _named(piece, kind, encoding)
    n_points, n_lines = _number(piece, "Points"), _number(piece, kind)
    before = sum(_number(piece, other) for other in _CELLS[: _CELLS.index(kind)])
    points = next(iter(_named(piece, "Points", encoding).values()), np.zeros((0, 3)))
    ends = lines.get("offsets", np.zeros(0, dtype=np.int64)).astype(np.int64)
    if points.shape != (n_points, 3) or ends.shape != (n_lines,):
        raise Damaged(f"{points.shape} point values and {ends.size} lines for {n_points} and {n_lines}")
    cells = _named(piece, "CellData", encoding)
    return PolyData(
        points=points.astype(np.float64),
        offsets=np.concatenate((np.zeros(1, dtype=np.int64), ends)),
        connectivity=lines.get("connectivity", np.zeros(0)).astype(np.int64).ravel(),
        point_data={name: a for name, a in _named(piece, "PointData", encoding).items() if len(a) == n_points},
        cell_data={name: a[before : before + n_lines] for name, a in cells.items() if len(a) >= before + n_lines},
    )


def _number(piece: _Piece, what: str) -> int:
    return whole(piece.attributes.get(f"NumberOf{what}", "0"), f"NumberOf{what}")


def _named(piece: _Piece, section: str, encoding: Encoding) -> dict[str, np.ndarray]:
    arrays = piece.sections.get(section, [])
    return {
        array.attributes.get("Name", ""): decode(encoding, array.attributes, "".join(array.text))
        for array in arrays
        if array.attributes.get("type") != "String"
    }
