"""Bad input through the command line: one line that names the file, exit code 2, and nothing written."""

import gzip
import json
import os
import struct

import numpy as np
import pytest
from cli_files import contents, write_nrrd

from vascval.cli.main import main


def empty(folder, mask):
    path = folder / "bad.nrrd"
    path.write_bytes(b"")
    return path


def foreign(folder, mask):
    path = folder / "bad.nrrd"
    path.write_bytes(b"%PDF-1.7 no volume at all")
    return path


def truncated(folder, mask):
    path = write_nrrd(folder / "bad.nrrd", mask)
    path.write_bytes(path.read_bytes()[:-1000])
    return path


def truncated_gzip(folder, mask):
    path = write_nrrd(folder / "bad.nrrd", mask, encoding="gzip")
    header, data = path.read_bytes().split(b"\n\n", 1)
    path.write_bytes(header + b"\n\n" + gzip.compress(data)[:-200])
    return path


def flat(folder, mask):
    return write_nrrd(
        folder / "bad.nrrd", mask[40], spacing=(), space="", kinds="domain domain", space_directions="",
        space_origin="", spacings="0.5 0.5",
    )  # fmt: skip


def four_dimensional(folder, mask):
    return write_nrrd(
        folder / "bad.nrrd", np.stack([mask, mask]), kinds="domain domain domain time", space="", space_directions="",
        space_origin="", spacings="0.5 0.5 0.5 1",
    )  # fmt: skip


def not_a_number(folder, mask):
    values = mask.astype("float32")
    values[3, 2, 1] = np.nan
    return write_nrrd(folder / "bad.nrrd", values)


def background(folder, mask):
    return write_nrrd(folder / "bad.nrrd", np.zeros_like(mask))


def inverted(folder, mask):
    return write_nrrd(folder / "bad.nrrd", 1 - mask)


def detached_outside(folder, mask):
    (folder / "secret.raw").write_bytes(mask.tobytes())
    (folder / "sub").mkdir()
    path = write_nrrd(folder / "sub" / "bad.nhdr", mask, data_file="../secret.raw")
    path.write_bytes(path.read_bytes().split(b"\n\n")[0] + b"\n\n")
    return path


def absurd_spacing(folder, mask):
    return write_nrrd(folder / "bad.nrrd", mask, spacing=(1e9, 1e-9, 1.0))


def bomb(folder, mask):
    return write_nrrd(folder / "bad.nrrd", mask, sizes="90000 90000 90000", encoding="gzip")


def foreign_nifti(folder, mask):
    path = folder / "bad.nii"
    path.write_bytes(struct.pack("<i", 348) + bytes(100))
    return path


VOLUMES = {
    empty: "the file is empty",
    foreign: "is no image that can be read",
    foreign_nifti: "is no image that can be read",
    truncated: "truncated",
    truncated_gzip: "truncated",
    flat: "flat image",
    four_dimensional: "three axes are needed",
    not_a_number: r"voxel (1, 2, 3) is nan",
    background: "background",
    inverted: "inverted",
    detached_outside: "outside its folder",
    absurd_spacing: "absurd",
    bomb: "--max-memory",
}


def run(arguments, capsys) -> str:
    """The one error line of a command that must refuse its input."""
    assert main([str(argument) for argument in arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    lines = [line for line in err.splitlines() if not line.startswith("vascval: note: ")]
    assert len(lines) == 1
    assert lines[0].startswith("vascval: error: ")
    return lines[0]


@pytest.mark.parametrize(("make", "message"), VOLUMES.items(), ids=lambda value: getattr(value, "__name__", ""))
def test_bad_volume(make, message, tmp_path, mask, capsys, tree_file):
    path = make(tmp_path, mask)
    before = contents(tmp_path)
    for arguments in (
        ["skeletonize", path, "-o", tmp_path / "out.vtp", "--json", tmp_path / "out.json"],
        ["analyze", path, "-o", tmp_path / "report", "--json", tmp_path / "out.json"],
        ["compare", path, tree_file, "-o", tmp_path / "report", "--json", tmp_path / "out.json"],
    ):
        line = run(arguments, capsys)
        assert line.startswith(f"vascval: error: {path}: ")
        assert message in line
        assert "; " in line, "the remedy is missing"
        assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--label", "7"], "label 7"),
        (["--threshold", "300"], "300"),
        (["--root", "500,0,0"], "outside"),
        (["--max-memory", "1kB"], "--max-memory"),
        (["--spacing", "1e9"], "absurd"),
    ],
)
def test_bad_choice_from_a_volume(options, message, tmp_path, cast_file, capsys):
    before = contents(tmp_path)
    line = run(["skeletonize", cast_file, "-o", tmp_path / "out.vtp", *options], capsys)
    assert line.startswith(f"vascval: error: {cast_file}: ")
    assert message in line
    assert contents(tmp_path) == before


def test_label_that_is_not_there_lists_those_that_are(tmp_path, mask, capsys):
    path = write_nrrd(tmp_path / "labels.nrrd", mask * np.uint8(5) + (mask == 0) * np.uint8(9))
    line = run(["analyze", path, "--label", "7"], capsys)
    assert "5" in line.split("label 7")[1] and "9" in line.split("label 7")[1]


@pytest.mark.parametrize(
    ("shape", "said"),
    [
        ("cast", ""),
        ("inverted", "96% of the image is taken for vessels; if the mask is inverted, choose its other value"),
        ("lump", "of the volume of the voxels, so that these are hardly tubes"),
    ],
)
def test_what_is_hardly_a_cast_is_doubted(shape, said, tmp_path, mask, capsys):
    distance = np.linalg.norm(np.indices((40, 40, 40)) - 20, axis=0)
    values = {"cast": mask, "inverted": 1 - mask[14:], "lump": (distance < 14).astype(np.uint8)}
    path = write_nrrd(tmp_path / "volume.nrrd", values[shape])
    assert main(["analyze", str(path), "--json", str(tmp_path / "out.json")]) == 0
    notes = capsys.readouterr().err
    assert said in notes and (notes != "") == (said != "")
    assert said in "".join(json.loads((tmp_path / "out.json").read_text())["image"]["notes"])


HOSTILE = """<?xml version="1.0"?>
<!DOCTYPE x [<!ENTITY secret SYSTEM "file:///etc/hostname">]>
"""

TREES = {
    "empty.vtp": ("", "empty"),
    "foreign.vtp": ("%PDF-1.7", ""),
    "entities.vtp": (HOSTILE + '<VTKFile type="PolyData">&secret;</VTKFile>', "entit"),
    "entities.xml": (HOSTILE + "<gxl><graph>&secret;</graph></gxl>", "entit"),
    "surface.vtk": (
        "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\n"
        "POINTS 3 float\n0 0 0 1 0 0 0 1 0\nPOLYGONS 1 4\n3 0 1 2\n",
        "",
    ),
    "cycle.swc": ("1 0 0 0 0 1 2\n2 0 1 0 0 1 1\n", ""),
    "words.swc": ("this is no tree\n", ""),
    "nan.swc": ("1 0 0 0 0 1 -1\n2 0 nan 0 0 1 1\n", "nan"),
    "point.swc": ("1 0 0 0 0 1 -1\n", ""),
    "tree.docx": ("PK", "neither a volume nor a tree"),
}


@pytest.mark.parametrize("name", TREES)
def test_bad_tree(name, tmp_path, capsys, cast_file):
    text, message = TREES[name]
    path = tmp_path / name
    path.write_text(text)
    before = contents(tmp_path)
    for arguments in (
        ["analyze", path, "-o", tmp_path / "report", "--json", tmp_path / "out.json"],
        ["compare", path, path, "-o", tmp_path / "report"],
    ):
        line = run(arguments, capsys)
        assert line.startswith(f"vascval: error: {path}: ")
        assert message in line.lower()
        assert contents(tmp_path) == before
    if name != "point.swc":
        assert run(["view", path, "--screenshot", tmp_path / "x.png"], capsys).startswith(f"vascval: error: {path}: ")


@pytest.mark.parametrize(("factor", "doubted"), [(1e3, True), (1.0, False), (1e-6, True)])
def test_radii_in_another_unit_than_positions_are_doubted(factor, doubted, tmp_path, tree_file, capsys):
    rows = [line.split() for line in tree_file.read_text().splitlines()[1:]]
    scaled = [" ".join([*row[:5], str(factor * float(row[5])), row[6]]) for row in rows]
    (tmp_path / "scaled.swc").write_text("# unit: mm\n" + "\n".join(scaled) + "\n")
    assert main(["analyze", str(tmp_path / "scaled.swc"), "--json", str(tmp_path / "a.json")]) == 0
    assert ("check that radii and positions are in one unit" in capsys.readouterr().err) == doubted


@pytest.mark.parametrize(
    "arguments",
    [
        ["analyze", "{missing}"],
        ["skeletonize", "{missing}", "-o", "out.vtp"],
        ["view", "{missing}"],
        ["compare", "{missing}", "{tree}"],
        ["compare", "{cast}", "{missing}"],
        ["compare", "{cast}", "{tree}", "{missing}"],
        ["compare", "{cast}", "{tree}", "--reference", "{missing}"],
    ],
)
def test_missing_file(arguments, tmp_path, cast_file, tree_file, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    missing = tmp_path / "missing.nrrd"
    before = contents(tmp_path)
    names = {"missing": missing, "cast": cast_file, "tree": tree_file}
    line = run([argument.format(**names) for argument in arguments], capsys)
    assert line == f"vascval: error: {missing}: no such file; check the name"
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["skeletonize", "{tree}", "-o", "out.vtp"], "{tree}: is a tree, and a volume is needed here; "),
        (["view", "{cast}"], "{cast}: is a volume, and a tree is needed here; make one with: vascval skeletonize"),
        (["compare", "{cast}", "{cast}"], "{cast}: is a volume, and a tree is needed here; first: vascval skeletonize"),
        (["compare", "{cast}", "{tree}", "--reference", "{tree}"], "{tree}: is a tree, and a table is needed here; "),
        (["compare", "{cast}", "{tree}", "{tree}"], "{tree}: is given twice; name each tree once"),
        (["compare", "{tree}", "{tree}", "--label", "1"], "{tree}: is no volume, so --label cannot apply; "),
        (["analyze", "{tree}", "--root", "0,0,0"], "{tree}: is no volume, so --root cannot apply; "),
        (["skeletonize", "{cast}", "-o", "out.stl"], "out.stl ends in neither .vtp nor .swc"),
        (["skeletonize", "{cast}", "-o", "nowhere/out.vtp"], "nowhere/out.vtp: "),
        (["skeletonize", "{cast}", "-o", "folder.vtp"], "folder.vtp: is a directory; "),
        (["analyze", "{tree}", "-o", "{tree}"], "{tree}: is a file, not a directory; "),
        (["analyze", "{tree}", "--json", "{tree}"], "{tree}: is an input and would be overwritten; "),
        (["compare", "{cast}", "{tree}", "-o", "{cast}"], "{cast}: is a file, not a directory; "),
        (["compare", "{cast}", "{tree}", "--json", "nowhere/x.json"], "nowhere/x.json: "),
        (["skeletonize", "{cast}", "-o", "new.vtp", "--json", "new.vtp"], "new.vtp: is asked for as two outputs; "),
        (
            ["analyze", "{cast}", "--json", "pipe"],
            "pipe: is a device or a pipe, which a file would ",
        ),
        (["generate", "karch-box", "-o", "pipe.vtp"], "pipe.vtp: is a device or a pipe, "),
        (["view", "{tree}", "--screenshot", "out.jpg"], "out.jpg does not end in .png"),
        (["demo", "-o", "{tree}"], "{tree}: is a file, not a directory; "),
        (["schema", "nonsense"], "nonsense"),
    ],
)
def test_wrong_use(arguments, message, tmp_path, cast_file, tree_file, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.vtp").mkdir()
    for name in ("pipe", "pipe.vtp"):
        os.mkfifo(tmp_path / name)
    before = contents(tmp_path)
    names = {"cast": cast_file, "tree": tree_file}
    line = run([argument.format(**names) for argument in arguments], capsys)
    assert message.format(**names) in line
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["nowhere.toml"], "nowhere.toml"),
        (["karch-box", "--set", "n_terminals=0"], "n_terminals"),
        (["karch-box", "--set", "n_terminals=99999999999999999999"], "n_terminals"),
        (["karch-box", "--set", "domain.box_mm=1e-300,1,1"], "holds no vessels; give sides from 1 um"),
        (["karch-box", "--checkpoint-every", "nan"], "'nan' is not a finite number"),
        (["karch-box", "--set", "gamma=5"], "gamma"),
        (["karch-box", "--set", "colour=red"], "colour"),
        (["karch-box", "--set", "n_terminals"], "n_terminals"),
        (["karch-box", "--set", "root_mm=500,0,0"], "outside the domain"),
        (["karch-box", "--set", "domain.box_mm=90,0,16"], "box"),
        (["karch-box", "--set", "domain.file=nowhere.stl"], "nowhere.stl"),
    ],
)
def test_bad_configuration(options, message, tmp_path, capsys):
    line = run(["generate", *options, "-o", tmp_path / "out.vtp", "--json", tmp_path / "out.json"], capsys)
    assert message in line
    assert contents(tmp_path) == {}
