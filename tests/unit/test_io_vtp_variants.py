"""Every way in which VTK stores the arrays of a VTP file is read as VTK reads it, and ours is read by VTK."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkPoints, vtkStringArray
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
from vtkmodules.vtkIOLegacy import vtkPolyDataWriter
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLPolyDataWriter

from vascval.core.tree import Topology, Tree
from vascval.io.trees import read_tree, write_vtp
from vascval.io.vtk_legacy import read_legacy
from vascval.io.vtp_xml import read_vtp

N = 3000  # several blocks of 32 KiB


def poly_data(point_type: str, verts: int) -> Any:
    rng = np.random.default_rng(2)
    points = np.round(rng.random((N, 3)) * 100, 2).astype(point_type)
    parent = np.array([(i - 1) // 2 for i in range(1, N)])
    data = vtkPolyData()
    vtk_points = vtkPoints()
    vtk_points.SetData(numpy_to_vtk(points, deep=True))
    data.SetPoints(vtk_points)
    for setter, ids, size in (
        (data.SetVerts, np.arange(verts), 1),
        (data.SetLines, np.stack((parent, np.arange(1, N)), axis=1).ravel(), 2),
    ):
        cells = vtkCellArray()
        offsets = np.arange(0, len(ids) + 1, size)
        cells.SetData(numpy_to_vtkIdTypeArray(offsets, deep=True), numpy_to_vtkIdTypeArray(ids, deep=True))
        setter(cells)
    for name, values in (
        ("radius", np.concatenate((np.full(verts, -1.0), rng.random(N - 1)))),
        ("order", np.zeros(N - 1 + verts, dtype=np.int32)),
        ("normal", rng.random((N - 1 + verts, 3)).astype(np.float32)),
    ):
        array = numpy_to_vtk(np.ascontiguousarray(values), deep=True)
        array.SetName(name)
        data.GetCellData().AddArray(array)
    height = numpy_to_vtk(np.arange(N, dtype=np.uint8), deep=True)
    height.SetName("height")
    data.GetPointData().AddArray(height)
    text = vtkStringArray()
    text.SetName("units")
    text.InsertNextValue("µm")
    data.GetFieldData().AddArray(text)
    return data


@pytest.mark.parametrize("mode", ["Ascii", "Binary", "Appended", "AppendedRaw"])
@pytest.mark.parametrize("compressor", ["None", "ZLib", "LZ4", "LZMA"])
@pytest.mark.parametrize("header", ["UInt32", "UInt64"])
@pytest.mark.parametrize("order", ["LittleEndian", "BigEndian"])
@pytest.mark.parametrize(("point_type", "verts"), [("float32", 0), ("float64", 7)])
def test_storage(
    tmp_path: Path, mode: str, compressor: str, header: str, order: str, point_type: str, verts: int
) -> None:
    data = poly_data(point_type, verts)
    writer = vtkXMLPolyDataWriter()
    writer.SetInputData(data)
    writer.SetFileName(str(tmp_path / "a.vtp"))
    getattr(writer, f"SetDataModeTo{mode.removesuffix('Raw')}")()
    writer.SetEncodeAppendedData(mode != "AppendedRaw")
    getattr(writer, f"SetCompressorTypeTo{compressor}")()
    getattr(writer, f"SetHeaderTypeTo{header}")()
    getattr(writer, f"SetByteOrderTo{order}")()
    assert writer.Write() == 1
    read = read_vtp(tmp_path / "a.vtp")
    assert np.array_equal(read.points, vtk_to_numpy(data.GetPoints().GetData()))
    assert np.array_equal(read.connectivity, vtk_to_numpy(data.GetLines().GetConnectivityArray()))
    assert np.array_equal(read.offsets, vtk_to_numpy(data.GetLines().GetOffsetsArray()))
    for name in ("radius", "order", "normal"):
        stored = vtk_to_numpy(data.GetCellData().GetArray(name))[verts:]
        if mode == "Ascii":  # text of about eleven digits
            np.testing.assert_allclose(read.cell_data[name], stored, rtol=1e-5)
        else:
            assert np.array_equal(read.cell_data[name], stored)
        assert read.cell_data[name].dtype == stored.dtype
    assert np.array_equal(read.point_data["height"], np.arange(N, dtype=np.uint8))
    assert read.texts == {"units": "µm"}
    assert read_tree(tmp_path / "a.vtp").meta["unit"] == "um"


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("version", [42, 51])
@pytest.mark.parametrize(("point_type", "verts"), [("float32", 0), ("float64", 7)])
def test_legacy_storage(tmp_path: Path, binary: bool, version: int, point_type: str, verts: int) -> None:
    data = poly_data(point_type, verts)
    data.GetCellData().SetActiveScalars("order")  # written as SCALARS, the others as a FIELD
    data.GetCellData().SetActiveNormals("normal")
    writer = vtkPolyDataWriter()
    writer.SetInputData(data)
    writer.SetFileName(str(tmp_path / "a.vtk"))
    writer.SetFileVersion(version)
    writer.SetFileType(2 if binary else 1)
    assert writer.Write() == 1
    read = read_legacy(tmp_path / "a.vtk")
    if binary:
        assert np.array_equal(read.points, vtk_to_numpy(data.GetPoints().GetData()))
    else:  # text of six digits for float, more for double
        np.testing.assert_allclose(read.points, vtk_to_numpy(data.GetPoints().GetData()), rtol=1e-5)
    assert np.array_equal(read.connectivity, vtk_to_numpy(data.GetLines().GetConnectivityArray()))
    assert np.array_equal(read.offsets, vtk_to_numpy(data.GetLines().GetOffsetsArray()))
    for name in ("radius", "order", "normal"):
        stored = vtk_to_numpy(data.GetCellData().GetArray(name))[verts:]
        np.testing.assert_allclose(read.cell_data[name], stored, rtol=0 if binary else 1e-5)
        assert read.cell_data[name].dtype == stored.dtype
    assert np.array_equal(read.point_data["height"], np.arange(N, dtype=np.uint8))
    assert read.texts == {"units": "µm"}


def test_several_pieces(tmp_path: Path) -> None:
    piece = (
        '<Piece NumberOfPoints="2" NumberOfLines="1"><Points><DataArray type="Float32" NumberOfComponents="3" '
        'format="ascii">{}</DataArray></Points><Lines><DataArray type="Int32" Name="connectivity" format="ascii">0 1'
        '</DataArray><DataArray type="Int32" Name="offsets" format="ascii">2</DataArray></Lines><CellData><DataArray '
        'type="Float32" Name="radius" format="ascii">{}</DataArray></CellData></Piece>'
    )
    pieces = piece.format("0 0 0 0 0 1", 2) + '<Piece NumberOfPoints="0"/>' + piece.format("0 0 1 0 1 2", 1)
    (tmp_path / "a.vtp").write_text(
        f'<VTKFile type="PolyData" version="0.1" byte_order="LittleEndian"><PolyData>{pieces}</PolyData></VTKFile>'
    )
    data = read_vtp(tmp_path / "a.vtp")
    assert data.connectivity.tolist() == [0, 1, 2, 3]
    assert data.offsets.tolist() == [0, 2, 4]
    assert read_tree(tmp_path / "a.vtp").length_mm.sum() == pytest.approx(1 + 2**0.5, rel=1e-12)


def test_vtk_reads_what_we_write(tmp_path: Path) -> None:
    curve = np.array([[0, 0, 0], [0, 1, 5], [0, 0, 10], [0, 0, 10], [5, 0, 15], [0, 0, 10], [-5, 0, 15.0]])
    tree = Tree(
        Topology(np.array([-1, 0, 1, 1])),
        curve[[0, 2, 4, 6]],
        np.array([0, 2.0, 1.5, 1.0]),
        {"pressure_pa": np.array([9.0, 7.0, 5.0, 4.0]), "flow_mm3_s": np.array([0, 3.0, 2.0, 1.0])},
        curve,
        np.array([0, 0, 3, 5, 7]),
    )
    write_vtp(tree, tmp_path / "a.vtp", provenance={"version": "1"})
    reader = vtkXMLPolyDataReader()
    reader.SetFileName(str(tmp_path / "a.vtp"))
    reader.Update()
    data = reader.GetOutput()
    cells, points = data.GetCellData(), data.GetPointData()
    names = [cells.GetArrayName(i) for i in range(cells.GetNumberOfArrays())]
    assert names == ["radius_mm", "length_mm", "flow_mm3_s", "order", "generation", "parent"]
    assert vtk_to_numpy(cells.GetArray("parent")).tolist() == [-1, 0, 0]
    assert vtk_to_numpy(cells.GetArray("radius_mm")).tolist() == [2.0, 1.5, 1.0]
    assert vtk_to_numpy(cells.GetArray("generation")).tolist() == [1, 2, 2]
    assert vtk_to_numpy(data.GetPoints().GetData()).tolist() == [*curve[[0, 2, 4, 6]].tolist(), [0, 1, 5]]
    assert vtk_to_numpy(points.GetArray("pressure_pa")).tolist() == [9, 7, 5, 4, 8]  # the curve's point half way
    assert vtk_to_numpy(data.GetLines().GetConnectivityArray()).tolist() == [0, 4, 1, 1, 2, 1, 3]
    field = data.GetFieldData()
    assert '"provenance": {"version": "1"}' in field.GetAbstractArray("vascval").GetValue(0)
    assert '"flow_mm3_s": "mm^3/s"' in field.GetAbstractArray("units").GetValue(0)
