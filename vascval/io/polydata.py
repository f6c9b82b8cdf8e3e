"""VTK poly data as plain arrays: VTP and legacy VTK files, read with VTK behind a guard.

VTK believes what a header says and prints what goes wrong; so the counts in a file are held against its size before
VTK sees it, what VTK says is caught, and all indices are checked before they are used.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from vascval.core.errors import InputError
from vascval.io import xml_guard
from vascval.io.quiet import printed

_DENSEST = 1100  # bytes out of one byte in: zlib, the densest of VTK's compressors on zeros, reaches 1032


@dataclass(frozen=True)
class PolyData:
    """Points and lines of a file, in its own units.

    ``points`` (P, 3); the points of line ``i`` are ``connectivity[offsets[i]:offsets[i + 1]]``; ``point_data`` and
    ``cell_data`` by name (the cells being the lines); ``texts`` and ``field_data``: what stands beside them.
    """

    points: np.ndarray
    offsets: np.ndarray
    connectivity: np.ndarray
    point_data: Mapping[str, np.ndarray] = field(default_factory=dict)
    cell_data: Mapping[str, np.ndarray] = field(default_factory=dict)
    field_data: Mapping[str, np.ndarray] = field(default_factory=dict)
    texts: Mapping[str, str] = field(default_factory=dict)


def read_vtp(path: Path) -> PolyData:
    """A VTP file (XML PolyData).

    :raises InputError: when it is not one, is damaged, has a document type, or claims more than it can hold.
    """
    from vtkmodules.vtkIOXML import vtkXMLPolyDataReader

    _guard_xml(path)
    return _read(path, vtkXMLPolyDataReader())


def read_legacy(path: Path) -> PolyData:
    """A legacy VTK file (ASCII or binary) that holds poly data.

    :raises InputError: when it is not one, is damaged, or claims more than it can hold.
    """
    from vtkmodules.vtkIOLegacy import vtkPolyDataReader

    _guard_legacy(path)
    reader = vtkPolyDataReader()
    for switch in ("ReadAllScalarsOn", "ReadAllFieldsOn", "ReadAllVectorsOn"):
        getattr(reader, switch)()
    return _read(path, reader)


def _guard_xml(path: Path) -> None:
    size = path.stat().st_size
    kind: list[str] = []

    def start(name: str, attributes: dict[str, str]) -> bool:
        if not kind:
            kind.append(attributes.get("type", "") if name == "VTKFile" else "")
        for key, value in attributes.items():
            if key.startswith("NumberOf") and not (value.strip().isdigit() and int(value) <= size * _DENSEST):
                raise InputError(f"{path}: {key} is {value[:40]!r} in a file of {size:,} bytes; it is damaged")
        return name == "AppendedData" or kind != ["PolyData"]

    xml_guard.parse(path, start)
    if kind != ["PolyData"]:
        raise InputError(f"{path}: is XML but no VTK PolyData; save the tree as PolyData (.vtp)")
    with path.open("rb") as stream:  # raw data are no XML and their end was not looked at
        stream.seek(max(size - 256, 0))
        if not stream.read().rstrip().endswith(b"</VTKFile>"):
            raise InputError(f"{path}: does not end with </VTKFile>; it is truncated or damaged")


def _guard_legacy(path: Path) -> None:
    data = path.read_bytes()
    dataset = re.search(rb"^\s*DATASET\s+(\S+)", data[:4096], re.MULTILINE | re.IGNORECASE)
    if dataset is None or dataset[1].upper() != b"POLYDATA":
        found = dataset[1].decode("latin-1") if dataset else "no data set"
        raise InputError(f"{path}: is a VTK file with {found[:40]}; save the tree as POLYDATA")
    names = rb"^\s*(POINTS|LINES|VERTICES|POLYGONS|TRIANGLE_STRIPS|CELL_DATA|POINT_DATA)[ \t]+(-?\d+)(?:[ \t]+(-?\d+))?"
    for match in re.finditer(names, data, re.MULTILINE | re.IGNORECASE):
        if any(not 0 <= int(count) <= len(data) for count in match.groups()[1:] if count is not None):
            raise InputError(
                f"{path}: says {match[0].decode('latin-1').strip()[:60]} in {len(data):,} bytes; it is damaged"
            )


def _read(path: Path, reader: Any) -> PolyData:
    with vtk_messages() as messages:
        reader.SetFileName(str(path))
        reader.Update()
        data = reader.GetOutput()
        said = messages().replace(str(path), "it")
        result = _arrays(data) if not said and data.GetPoints() is not None else None
    if said:
        raise InputError(f"{path}: cannot be read as VTK poly data ({said}); it is truncated or damaged")
    if result is None or len(result.points) == 0 or len(result.offsets) < 2:
        raise InputError(f"{path}: holds no lines; a tree needs lines between its points")
    _check(path, result)
    return result


def _arrays(data: Any) -> PolyData:
    from vtkmodules.util.numpy_support import vtk_to_numpy

    lines = data.GetLines()
    n_points = data.GetNumberOfPoints()
    before, n_lines = data.GetNumberOfVerts(), data.GetNumberOfLines()
    offsets = vtk_to_numpy(lines.GetOffsetsArray()).astype(np.int64)
    field_data = data.GetFieldData()
    texts = {}
    for i in range(field_data.GetNumberOfArrays()):
        array = field_data.GetAbstractArray(i)
        if array.IsA("vtkStringArray") and array.GetNumberOfValues() == 1:
            texts[str(array.GetName())] = str(array.GetValue(0))
    cells = _named(data.GetCellData())
    return PolyData(
        points=vtk_to_numpy(data.GetPoints().GetData()).astype(np.float64).reshape(-1, 3),
        offsets=offsets,
        connectivity=vtk_to_numpy(lines.GetConnectivityArray()).astype(np.int64),
        point_data={
            name: values for name, values in _named(data.GetPointData()).items() if len(values) == n_points
        },
        cell_data={
            name: values[before : before + n_lines] for name, values in cells.items() if len(values) >= before + n_lines
        },
        field_data=_named(field_data),
        texts=texts,
    )


def _named(attributes: Any) -> dict[str, np.ndarray]:
    """Copies of the numerical arrays by name."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    arrays = (attributes.GetArray(i) for i in range(attributes.GetNumberOfArrays()))
    return {str(array.GetName()): vtk_to_numpy(array).copy() for array in arrays if array is not None}


def _check(path: Path, data: PolyData) -> None:
    offsets, ids = data.offsets, data.connectivity
    if offsets[0] != 0 or (np.diff(offsets) < 0).any() or offsets[-1] != len(ids):
        raise InputError(f"{path}: the offsets of its lines do not fit; it is damaged")
    outside = np.flatnonzero((ids < 0) | (ids >= len(data.points)))
    if outside.size:
        raise InputError(
            f"{path}: its lines name {outside.size} points that do not exist (first: {ids[outside[0]]} of "
            f"{len(data.points)}); it is damaged"
        )
    bad = np.flatnonzero(~np.isfinite(data.points).all(axis=1))
    if bad.size:
        raise InputError(f"{path}: {bad.size} points are not finite (first: point {bad[0]}); mend or drop them")


@contextmanager
def vtk_messages() -> Iterator[Callable[[], str]]:
    """Catches what VTK prints, by its window or past it; yields a function that tells the first line so far that
    speaks of an error, an empty text if none does."""
    from vtkmodules.vtkCommonCore import vtkOutputWindow, vtkStringOutputWindow

    window = vtkStringOutputWindow()
    before = vtkOutputWindow.GetInstance()
    vtkOutputWindow.SetInstance(window)
    try:
        with printed() as complaint:

            def first_error() -> str:
                lines = [complaint(), *(line for line in str(window.GetOutput()).splitlines() if "rror" in line)]
                said = next((line for line in lines if line), "")
                return _PREFIX.sub("", _COLOUR.sub("", said)).strip().rstrip(".")[:160]

            yield first_error
    finally:
        vtkOutputWindow.SetInstance(before)


_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_PREFIX = re.compile(r"^.*?(?:ERR|WARN)\|\s*(?:\w+ \(0x[0-9a-f]+\):\s*)?")
