"""Every tree file that is not read: one line, the file, what is wrong, the remedy; and nothing printed by a library."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from vascval.core.errors import InputError
from vascval.core.tree import Topology, Tree
from vascval.io.trees import read_tree, write_swc, write_table, write_tree, write_vtp
from vascval.io.xml_guard import MAX_DEPTH


def tree() -> Tree:
    position = np.array([[0, 0, 0], [0, 0, 10], [5, 0, 15], [-5, 0, 15]])
    return Tree(Topology(np.array([-1, 0, 1, 1])), position, np.array([0, 2.0, 1.5, 1.0]))


def refused(path: Path, capfd: pytest.CaptureFixture[str], match: str) -> None:
    with pytest.raises(InputError, match=match) as caught:
        read_tree(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert message.count(str(path)) == 1
    assert "\n" not in message
    assert ";" in message, "a remedy follows what is wrong"
    assert capfd.readouterr() == ("", "")


def vtp(body: str = "", *, points: str = "4", lines: str = "3", prolog: str = "", kind: str = "PolyData") -> str:
    array = '<DataArray type="{}" Name="{}" {} format="ascii">{}</DataArray>'
    three = 'NumberOfComponents="3"'
    body = body or (
        f"<Points>{array.format('Float64', 'Points', three, '0 0 0 0 0 10 5 0 15 -5 0 15')}</Points>"
        f"<Lines>{array.format('Int64', 'connectivity', '', '0 1 1 2 1 3')}"
        f"{array.format('Int64', 'offsets', '', '2 4 6')}</Lines>"
        f"<CellData>{array.format('Float64', 'radius', '', '2 1 1')}</CellData>"
    )
    return (
        f'<?xml version="1.0"?>{prolog}<VTKFile type="{kind}" version="1.0" byte_order="LittleEndian"><{kind}>'
        f'<Piece NumberOfPoints="{points}" NumberOfLines="{lines}">{body}</Piece></{kind}></VTKFile>'
    )


LEGACY = (
    "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 4 double\n0 0 0 0 0 10 5 0 15 -5 0 15\n"
    "LINES 3 9\n2 0 1\n2 1 2\n2 1 3\nCELL_DATA 3\nSCALARS radius double 1\nLOOKUP_TABLE default\n2 1 1\n"
)


def test_the_files_that_are_damaged_below_are_read_when_whole(tmp_path: Path) -> None:
    (tmp_path / "a.vtp").write_text(vtp())
    (tmp_path / "a.vtk").write_text(LEGACY)
    (tmp_path / "a.swc").write_text("1 3 0 0 0 1 -1\n2 3 0 0 1 1 1\n")
    assert read_tree(tmp_path / "a.vtp").n_segments == 3
    assert read_tree(tmp_path / "a.vtk").n_segments == 3
    assert read_tree(tmp_path / "a.swc").n_segments == 1


@pytest.mark.parametrize("suffix", [".vtp", ".vtk", ".swc", ".gxl"])
def test_missing_empty_folder_and_foreign(tmp_path: Path, capfd: pytest.CaptureFixture[str], suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    refused(path, capfd, "there is no such file")
    path.write_bytes(b"")
    refused(path, capfd, "the file is empty")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 4)
    refused(path, capfd, "is no tree that can be read")
    path.write_text("<html><body>not found</body></html>")
    refused(path, capfd, "no VTK PolyData")
    path.unlink()
    path.mkdir()
    refused(path, capfd, "is a folder")


@pytest.mark.parametrize("suffix", [".vtp", ".gxl", ".xml"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
@pytest.mark.parametrize(
    "prolog",
    ['<!DOCTYPE VTKFile [<!ENTITY x SYSTEM "file:///etc/passwd">]>', "<!DOCTYPE VTKFile>",
     '<!DOCTYPE VTKFile SYSTEM "http://localhost:1/x.dtd">',
     '<!DOCTYPE VTKFile [<!ENTITY a "aaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>'],
)  # fmt: skip
def test_document_types_and_entities(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], suffix: str, encoding: str, prolog: str
) -> None:
    path = tmp_path / f"a{suffix}"
    text = vtp(prolog=prolog) if suffix == ".vtp" else f"{prolog}<gxl><graph/></gxl>"
    path.write_bytes(text.replace('"1.0"?', f'"1.0" encoding="{encoding}"?').encode(encoding))
    refused(path, capfd, "declares a document type or entities, which is refused; remove the <!DOCTYPE part")


def test_an_entity_that_is_not_declared(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.vtp").write_text(vtp().replace("0 0 0 0 0 10", "&x; 0 0 0 0 10"))
    refused(tmp_path / "a.vtp", capfd, "is no sound XML .*undefined entity")


@pytest.mark.parametrize("name", ["a.vtp", "a.gxl"])
def test_deep_nesting(tmp_path: Path, capfd: pytest.CaptureFixture[str], name: str) -> None:
    inner = "<a>" * 100_000 + "</a>" * 100_000
    (tmp_path / name).write_text(vtp(inner) if name == "a.vtp" else f"<gxl>{inner}</gxl>")
    refused(tmp_path / name, capfd, f"nested deeper than {MAX_DEPTH} levels")


@pytest.mark.parametrize("kept", [0.1, 0.5, 0.9, 0.99])
def test_truncated_files(tmp_path: Path, capfd: pytest.CaptureFixture[str], kept: float) -> None:
    write_vtp(tree(), tmp_path / "a.vtp")
    (tmp_path / "a.gxl").write_text(_gxl())
    (tmp_path / "b.vtp").write_text(vtp())
    for name in ("a.vtp", "b.vtp", "a.gxl"):
        whole = (tmp_path / name).read_bytes()
        (tmp_path / name).write_bytes(whole[: int(kept * len(whole))])
        refused(tmp_path / name, capfd, "is no sound XML|truncated or damaged")


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("kept", [0.2, 0.5, 0.8, 0.97])
def test_truncated_legacy_files(tmp_path: Path, capfd: pytest.CaptureFixture[str], kept: float, binary: bool) -> None:
    whole = LEGACY.encode()
    if binary:
        whole = (
            b"# vtk DataFile Version 3.0\nx\nBINARY\nDATASET POLYDATA\nPOINTS 4 double\n"
            + np.array([0, 0, 0, 0, 0, 10, 5, 0, 15, -5, 0, 15], ">f8").tobytes()
            + b"\nLINES 3 9\n" + np.array([2, 0, 1, 2, 1, 2, 2, 1, 3], ">i4").tobytes()
            + b"\nCELL_DATA 3\nSCALARS radius double 1\nLOOKUP_TABLE default\n" + np.array([2, 1, 1], ">f8").tobytes()
        )  # fmt: skip
    (tmp_path / "a.vtk").write_bytes(whole)
    assert read_tree(tmp_path / "a.vtk").radius_mm[1:].tolist() == [2, 1, 1]
    (tmp_path / "a.vtk").write_bytes(whole[: int(kept * len(whole))])
    refused(tmp_path / "a.vtk", capfd, "truncated or damaged|holds no lines|no data set")


@pytest.mark.parametrize(
    ("old", "new"),
    [("POINTS 4", "POINTS 999999999999"), ("POINTS 4", "POINTS -4"), ("LINES 3 9", "LINES 3 99999999999"),
     ("LINES 3 9", "LINES 99999999 9"), ("CELL_DATA 3", "CELL_DATA 888888888888")],
)  # fmt: skip
def test_legacy_counts_beyond_the_file(tmp_path: Path, capfd: pytest.CaptureFixture[str], old: str, new: str) -> None:
    (tmp_path / "a.vtk").write_text(LEGACY.replace(old, new))
    refused(tmp_path / "a.vtk", capfd, r"bytes\); it is truncated or damaged")


@pytest.mark.parametrize("where", ["points", "lines"])
@pytest.mark.parametrize("count", ["99999999999999", "-4", "99999999999999999999999999", "four"])
def test_vtp_counts_beyond_the_file(tmp_path: Path, capfd: pytest.CaptureFixture[str], where: str, count: str) -> None:
    (tmp_path / "a.vtp").write_text(vtp(**{where: count}))  # type: ignore[arg-type]
    tracemalloc.start()
    refused(tmp_path / "a.vtp", capfd, "an array cannot be decoded .*; it is truncated or damaged")
    assert tracemalloc.get_traced_memory()[1] < 10_000_000
    tracemalloc.stop()


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [("0 1 1 2 1 3", "0 1 1 2 1 9", "points that do not exist"),
     ("0 1 1 2 1 3", "0 1 1 2 1 -3", "points that do not exist"),
     ("0 1 1 2 1 3", "0 1 1 2 1", "truncated or damaged|do not fit|do not exist"),
     (">2 4 6<", ">4 2 6<", "offsets of its lines do not fit|truncated or damaged"),
     (">2 4 6<", ">2 4 600<", "offsets of its lines do not fit|truncated or damaged"),
     ("0 0 10", "0 0 nan", "points are not finite|truncated or damaged"),
     (">2 1 1<", ">2 nan 1<", "radius that is negative or not finite|truncated or damaged"),
     (">2 1 1<", ">2 -1 1<", "radius that is negative or not finite"),
     ('Name="radius"', 'Name="height"', "no array looks like a radius"),
     ("Lines>", "Verts>", "0 lines for 4 and 3"),
     ("-5 0 15", "x 0 15", "truncated or damaged")],
)  # fmt: skip
def test_damaged_vtp(tmp_path: Path, capfd: pytest.CaptureFixture[str], old: str, new: str, match: str) -> None:
    assert old in vtp()
    (tmp_path / "a.vtp").write_text(vtp().replace(old, new))
    refused(tmp_path / "a.vtp", capfd, match)


def test_other_data_sets(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.vtp").write_text(vtp(kind="UnstructuredGrid"))
    refused(tmp_path / "a.vtp", capfd, "is XML but no VTK PolyData")
    (tmp_path / "a.vtk").write_text(LEGACY.replace("POLYDATA", "UNSTRUCTURED_GRID"))
    refused(tmp_path / "a.vtk", capfd, "is a VTK file with UNSTRUCTURED_GRID; save it as POLYDATA")
    (tmp_path / "a.vtk").write_text("# vtk DataFile Version 3.0\n")
    refused(tmp_path / "a.vtk", capfd, "is a VTK file with no data set")
    (tmp_path / "a.vtk").write_text(LEGACY.replace("LINES", "VERTICES"))
    refused(tmp_path / "a.vtk", capfd, "holds no lines")


def test_lines_without_any_length(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.vtk").write_text(LEGACY.replace("0 0 0 0 0 10 5 0 15 -5 0 15", "1 2 3 " * 4))
    refused(tmp_path / "a.vtk", capfd, "there is no piece of vessel with a length")


@pytest.mark.parametrize(
    ("text", "match"),
    [("1 3 0 0 0 1\n", "line 1 has 6 columns"),
     ("1 3 0 0 0 1 -1\n2 3 0 0 1 1 1\n3 3 0 0", "line 3 has 4 columns; SWC has seven, the file is truncated"),
     ("1 3 0 0 zero 1 -1\n", "line 1 holds something that is no number"),
     ("# nothing\n\n", "holds no points"),
     ("1 3 0 0 0 1 -1\n", "no point has a parent"),
     ("1 3 0 0 0 1 -1\n2 3 0 0 1 1 1\n2 3 0 0 2 1 1\n", r"1 points have a number twice \(first: 2\)"),
     ("1 3 0 0 0 1 -1\n2 3 0 0 1 1 7\n", r"1 points have a parent that does not exist \(first: point 2, parent 7\)"),
     ("1 3 0 0 0 1 -1\n2 3 0 0 1 1 3\n3 3 0 0 2 1 2\n", "its parents form a cycle"),
     ("1 3 0 0 0 1 -1\n2 3 0 0 nan 1 1\n", "line 2 has a value that is not finite"),
     ("1 3 0 0 0 1 -1\n2.5 3 0 0 1 1 1\n", "line 2 has a value that is not finite or a broken id"),
     ("1 3 0 0 0 1 -1\n2 3 0 0 1 -1 1\n", "points have a radius that is negative")],
)  # fmt: skip
def test_damaged_swc(tmp_path: Path, capfd: pytest.CaptureFixture[str], text: str, match: str) -> None:
    (tmp_path / "a.swc").write_text(text)
    refused(tmp_path / "a.swc", capfd, match)


def _gxl(node: str = "<float>0</float><float>0</float><float>9</float>", edge: str = "<float>1</float>") -> str:
    first = "<float>0</float>" * 3
    return (
        f'<gxl><graph><node id="a"><attr name="position"><tup>{first}</tup></attr></node>'
        f'<node id="b"><attr name="position"><tup>{node}</tup></attr></node>'
        f'<edge from="a" to="b"><attr name="radius">{edge}</attr></edge></graph></gxl>'
    )


@pytest.mark.parametrize(
    ("text", "match"),
    [("<gxl><graph/></gxl>", "has no nodes or no edges"),
     (_gxl().replace('to="b"', 'to="c"'), r"1 ends of edges are no nodes \(first: 'c'\)"),
     (_gxl().replace('id="b"', 'id="a"'), "node 'a' is there twice"),
     (_gxl(node="<float>0</float>"), "node 'b' has 1 values for its position, not 3"),
     (_gxl(node="<float>x</float>" * 3), "node 'b' has a position .* that is no number"),
     (_gxl(node="<float>nan</float>" * 3), "a position that is not finite"),
     (_gxl(edge=""), "the edge from 'a' to 'b' has 0 values for its radius"),
     (_gxl(edge="<float>-1</float>"), "radius that is negative"),
     (_gxl().replace("</graph>", ""), "is no sound XML")],
)  # fmt: skip
def test_damaged_gxl(tmp_path: Path, capfd: pytest.CaptureFixture[str], text: str, match: str) -> None:
    (tmp_path / "a.gxl").write_text(text)
    refused(tmp_path / "a.gxl", capfd, match)


def test_our_own_file_has_its_unit(tmp_path: Path) -> None:
    write_vtp(tree(), tmp_path / "a.vtp")
    assert read_tree(tmp_path / "a.vtp", unit="mm").n_segments == 3
    with pytest.raises(InputError, match=r"a.vtp: its arrays are in mm by their names, not um"):
        read_tree(tmp_path / "a.vtp", unit="um")


def test_writers_refuse_odd_names_and_places_and_leave_nothing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a.vtk: trees are written as .vtp or .swc"):
        write_tree(tree(), tmp_path / "a.vtk")
    with pytest.raises(InputError, match=r"a VTP file ends in .vtp"):
        write_vtp(tree(), tmp_path / "a.xml")
    with pytest.raises(InputError, match=r"an SWC file ends in .swc"):
        write_swc(tree(), tmp_path / "a.txt")
    with pytest.raises(InputError, match=r"let the name end in .csv"):
        write_table(pd.DataFrame({"a": [1]}), tmp_path / "a.xlsx")
    bare = Tree(Topology(np.array([-1])), np.zeros((1, 3)), np.zeros(1))
    for write, name in ((write_vtp, "a.vtp"), (write_swc, "a.swc")):
        with pytest.raises(InputError, match="the tree has no segment"):
            write(bare, tmp_path / name)
        with pytest.raises(InputError, match=r"folder .*none does not exist; make it first"):
            write(tree(), tmp_path / "none" / name)
        (tmp_path / name).mkdir()
        with pytest.raises(InputError, match="is a folder; give the name of a file"):
            write(tree(), tmp_path / name)
        (tmp_path / name).rmdir()
    assert list(tmp_path.iterdir()) == []
