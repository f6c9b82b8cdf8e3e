"""Our own trees on disk: VTP poly data, the contract that other programs may rely on.

* one polyline cell per segment, root first; points: the nodes, root first, then the inner points of the curves;
* cell arrays ``radius_mm``, ``length_mm``, ``parent`` (cell index of the feeding segment, -1 at the root), ``order``,
  ``generation``, and every further column of the tree that belongs to segments;
* point arrays: the columns that belong to nodes, interpolated along the curves;
* field data: ``vascval`` (a JSON text: metadata, and the root's entries of the columns), ``units`` (a JSON text).

A file is ours when its ``parent`` array agrees with its lines; it then reads back as it was, value for value.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vascval.core.columns import COLUMNS
from vascval.core.errors import InputError
from vascval.core.ordering import generation, strahler_order
from vascval.core.tree import Topology, Tree
from vascval.io.assembly import require_near
from vascval.io.atomic import atomic_file
from vascval.io.polydata import PolyData
from vascval.io.quiet import vtk_messages

_STRUCTURE = ("radius_mm", "length_mm", "parent")
_TEXT = "vascval"


def write_vtp(tree: Tree, path: Path | str, provenance: Mapping[str, Any] | None = None) -> None:
    """The tree as VTP; atomic, and the same bytes for the same tree.

    :param provenance: stored as ``meta["provenance"]``.
    :raises InputError: when the tree has no segment or the place cannot be written.
    """
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

    path = Path(path)
    if path.suffix.lower() != ".vtp":
        raise InputError(f"{path}: a VTP file ends in .vtp; rename it")
    if tree.n_segments == 0:
        raise InputError(f"{path}: the tree has no segment; there is nothing to write")
    meta = dict(tree.meta) if provenance is None else {**tree.meta, "provenance": dict(provenance)}
    writer = vtkXMLPolyDataWriter()
    writer.SetInputData(_poly_data(tree, meta))
    writer.SetDataModeToAppended()
    writer.EncodeAppendedDataOn()
    writer.SetHeaderTypeToUInt64()
    writer.WriteToOutputStringOn()
    with vtk_messages() as messages:
        if not writer.Write() or messages():
            raise InputError(f"{path}: cannot be written ({messages() or 'VTK refused'}); choose another place")
    with atomic_file(path) as aside:
        aside.write_text(writer.GetOutputString(), encoding="ascii", newline="")


def _poly_data(tree: Tree, meta: Mapping[str, Any]) -> Any:
    from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
    from vtkmodules.vtkCommonCore import vtkPoints, vtkStringArray
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData

    points, offsets, connectivity, along = _layout(tree)
    data = vtkPolyData()
    vtk_points = vtkPoints()
    vtk_points.SetData(numpy_to_vtk(points, deep=True))
    data.SetPoints(vtk_points)
    lines = vtkCellArray()
    lines.SetData(numpy_to_vtkIdTypeArray(offsets, deep=True), numpy_to_vtkIdTypeArray(connectivity, deep=True))
    data.SetLines(lines)
    for name, values in _cell_columns(tree).items():
        _add(data.GetCellData(), name, values)
    for name, values in tree.columns.items():
        if COLUMNS[name].place == "node":
            _add(data.GetPointData(), name, _at_points(tree, values, along))
    root = {name: _json_number(values[0]) for name, values in tree.columns.items()}
    units = {name: COLUMNS[name].unit for name in (*_cell_columns(tree), *tree.columns)}
    for name, record in ((_TEXT, {"meta": dict(meta), "root": root}), ("units", {"points": "mm", **units})):
        text = vtkStringArray()
        text.SetName(name)
        text.InsertNextValue(json.dumps(record, sort_keys=True))
        data.GetFieldData().AddArray(text)
    return data


def _add(attributes: Any, name: str, values: np.ndarray) -> None:
    from vtkmodules.util.numpy_support import numpy_to_vtk

    array = numpy_to_vtk(np.ascontiguousarray(values), deep=True)
    array.SetName(name)
    attributes.AddArray(array)


def _json_number(value: np.generic) -> float | int | None:
    number = value.item()
    return number if np.isfinite(number) else None


def _cell_columns(tree: Tree) -> dict[str, np.ndarray]:
    """The cell arrays in the order of the registry, without the root's entry."""
    order = tree.columns["order"] if "order" in tree.columns else strahler_order(tree.topology)
    values: dict[str, np.ndarray] = {
        "generation": generation(tree.topology, order),
        **tree.columns,
        "radius_mm": tree.radius_mm,
        "length_mm": tree.length_mm,
        "order": order,
        "parent": tree.parent - 1,
    }
    return {
        name: values[name][1:].astype(spec.dtype)
        for name, spec in COLUMNS.items()
        if name in values and spec.place == "segment"
    }


def _layout(tree: Tree) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Points (nodes, then inner curve points), offsets and connectivity of the lines; and, for each inner point, its
    segment and the fraction of the segment's length at which it lies."""
    n = tree.n_nodes
    if tree.polyline_mm is None or tree.polyline_offset is None:
        ends = np.stack((tree.parent[1:], np.arange(1, n)), axis=1)
        nothing = (np.zeros(0, dtype=np.int64), np.zeros(0))
        return tree.position_mm, np.arange(0, 2 * n - 1, 2), ends.astype(np.int64).ravel(), nothing
    offsets = tree.polyline_offset[1:]
    ids = np.full(offsets[-1], -1, dtype=np.int64)
    ids[offsets[:-1]] = tree.parent[1:]
    ids[offsets[1:] - 1] = np.arange(1, n)
    inner = ids < 0
    ids[inner] = n + np.arange(np.count_nonzero(inner))
    segment = np.repeat(np.arange(1, n), np.diff(offsets))
    step = np.sqrt((np.diff(tree.polyline_mm, axis=0, prepend=tree.polyline_mm[:1]) ** 2).sum(axis=1))
    step[offsets[:-1]] = 0.0
    total = np.cumsum(step)
    length = np.maximum(tree.length_mm[segment], np.finfo(float).tiny)
    fraction = np.clip((total - total[offsets[:-1]][segment - 1]) / length, 0.0, 1.0)
    points = np.concatenate((tree.position_mm, tree.polyline_mm[inner]))
    return points, offsets, ids, (segment[inner], fraction[inner])


def _at_points(tree: Tree, values: np.ndarray, along: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """A node column at every point: as it is at the nodes, linear along the curves."""
    segment, fraction = along
    start, end = values[tree.parent[segment]], values[segment]
    return np.concatenate((values, start + fraction * (end - start))).astype(values.dtype)


def is_own(data: PolyData) -> bool:
    """Whether the poly data keep our contract: ``radius_mm``, and a ``parent`` array that agrees with the lines."""
    parent = data.cell_data.get("parent")
    if parent is None or "radius_mm" not in data.cell_data or parent.ndim != 1:
        return False
    cells = np.arange(len(parent))
    if not ((parent >= -1) & (parent < cells)).all() or (np.diff(data.offsets) < 2).any():
        return False
    first, last = data.connectivity[data.offsets[:-1]], data.connectivity[data.offsets[1:] - 1]
    before = np.where(parent < 0, first[0], last[parent])
    return bool((data.points[before] == data.points[first]).all())


def own_tree(data: PolyData) -> Tree:
    """The tree that :func:`write_vtp` wrote, for poly data of which :func:`is_own` is true."""
    require_near(data.points, data.cell_data["radius_mm"])
    n = len(data.offsets)
    last = data.connectivity[data.offsets[1:] - 1]
    nodes = np.concatenate((data.connectivity[:1], last))
    record = _record(data)
    root = record.get("root")
    columns = {}
    for name, spec in COLUMNS.items():
        source = data.cell_data.get(name) if spec.place == "segment" else data.point_data.get(name)
        listed = name in root if isinstance(root, dict) else name not in _STRUCTURE
        if source is None or source.ndim != 1 or not listed:
            continue
        if spec.place == "node":
            columns[name] = source[nodes].astype(spec.dtype)
        else:
            columns[name] = np.concatenate((_placeholder(spec.dtype, root, name), source.astype(spec.dtype)))
    straight = bool((np.diff(data.offsets) == 2).all())
    return Tree(
        topology=Topology(np.concatenate(([-1], data.cell_data["parent"].astype(np.int64) + 1))),
        position_mm=data.points[nodes],
        radius_mm=np.concatenate(([0.0], data.cell_data["radius_mm"])),
        columns=columns,
        polyline_mm=None if straight else data.points[data.connectivity],
        polyline_offset=None if straight else np.concatenate(([0], data.offsets)),
        meta={"guesses": [], **record.get("meta", {})} if n else {},
    )


def _placeholder(dtype: str, root: object, name: str) -> np.ndarray:
    value = root.get(name) if isinstance(root, dict) else 0
    if not isinstance(value, int | float):
        value = np.nan if dtype.startswith("float") else 0
    return np.array([value]).astype(dtype)


def _record(data: PolyData) -> dict[str, Any]:
    try:
        record = json.loads(data.texts.get(_TEXT, "{}"))
    except ValueError:
        return {}
    sound = isinstance(record, dict) and isinstance(record.get("meta", {}), dict)
    return record if sound else {}
