"""Legacy VTK files (ASCII or binary), read with VTK behind a guard.

VTK believes what a header says and prints what goes wrong; so the counts in a file are held against its size before
VTK sees it, and what VTK says is caught.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from vascval.core.errors import InputError
from vascval.io.polydata import PolyData, require_sound
from vascval.io.quiet import vtk_messages


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
    if result is None:
        raise InputError(f"{path}: holds no points; it is truncated or damaged")
    require_sound(path, result)
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
        texts=texts,
    )


def _named(attributes: Any) -> dict[str, np.ndarray]:
    """Copies of the numerical arrays by name."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    arrays = (attributes.GetArray(i) for i in range(attributes.GetNumberOfArrays()))
    return {str(array.GetName()): vtk_to_numpy(array).copy() for array in arrays if array is not None}


