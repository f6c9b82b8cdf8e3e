"""``vascval generate`` through the command line."""

import json
import os
import signal

import numpy as np
import pytest
import pyvista

from generator.growth.growth import Growth
from vascval.cli.main import main
from vascval.io import schemas
from vascval.io.trees import read_tree

SMALL = ["--set", "n_terminals=60"]


def generate(folder, *arguments, preset="karch-box", name="tree.vtp"):
    return main(["generate", preset, "-o", str(folder / name), "--quiet", *map(str, arguments)])


def test_json_and_tree(tmp_path, capsys):
    jsonschema = pytest.importorskip("jsonschema")
    assert generate(tmp_path, *SMALL, "--json", tmp_path / "out.json") == 0
    document = json.loads((tmp_path / "out.json").read_text())
    jsonschema.validate(document, schemas.schema("generate"))
    tree = read_tree(tmp_path / "tree.vtp")
    assert document["n_terminals"] == tree.topology.n_terminals == 60
    assert document["n_segments"] == tree.n_segments == 119
    assert document["n_trifurcations"] == 0
    assert document["seed"] == 1
    assert document["volume_mm3"] == pytest.approx(tree.volume_mm3, rel=1e-12)  # rounding
    assert [stage["name"] for stage in document["stages"]] == ["growth"]
    assert document["stages"][0]["volume_mm3"] == document["volume_mm3"]
    assert 0 < document["stages"][0]["seconds"] < 120
    assert 50 < document["peak_memory_mb"] < 4000
    assert document["provenance"]["config"]["perfusion"]["flow_ml_min"] == 500.0
    surface = pyvista.read(tmp_path / "tree.vtp")
    arrays = {"radius_mm", "length_mm", "flow_mm3_s", "pressure_drop_pa", "order", "generation", "parent"}
    assert arrays <= set(surface.cell_data)
    assert "pressure_pa" in surface.point_data
    assert "volume_mm3" in capsys.readouterr().out


def test_same_command_same_bytes(tmp_path):
    assert generate(tmp_path, *SMALL, name="a.vtp") == generate(tmp_path, *SMALL, name="b.vtp") == 0
    assert (tmp_path / "a.vtp").read_bytes() == (tmp_path / "b.vtp").read_bytes()
    assert generate(tmp_path, *SMALL, "--set", "seed=2", name="c.vtp") == 0
    assert (tmp_path / "a.vtp").read_bytes() != (tmp_path / "c.vtp").read_bytes()


def test_terminals_of_a_file(tmp_path):
    points = np.vstack([[0, 0, 0], np.random.default_rng(0).random((50, 3)) * (90, 70, 16)])
    np.savetxt(tmp_path / "points.csv", points, delimiter=",", header="x_mm,y_mm,z_mm", comments="")
    for order in ("spread", "given", "random"):
        changes = ["--set", f"terminals_file={tmp_path / 'points.csv'}", "--set", f"terminals_order={order}"]
        assert generate(tmp_path, *changes) == 0
        tree = read_tree(tmp_path / "tree.vtp")
        found = tree.position_mm[tree.topology.terminals]
        assert np.sort(found, axis=0) == pytest.approx(np.sort(points[1:], axis=0), rel=1e-12)  # text to 18 digits
        assert (tree.position_mm[0] == 0).all()


def test_a_root_tree_from_a_file(tmp_path):
    assert generate(tmp_path, "--set", "n_terminals=2", name="root.vtp") == 0
    root = read_tree(tmp_path / "root.vtp")
    changes = [*SMALL, "--set", f"root_tree={tmp_path / 'root.vtp'}"]
    assert generate(tmp_path, *changes) == 1  # its own terminals are at 60 mmHg: nothing is left below them
    assert generate(tmp_path, *changes, "--set", "perfusion.terminal_pressure_mmhg=40") == 0
    tree = read_tree(tmp_path / "tree.vtp")
    assert tree.topology.n_terminals == 60
    for position, radius in zip(root.position_mm[1:], root.radius_mm[1:]):
        here = np.flatnonzero((tree.position_mm == position).all(axis=1))
        assert tree.radius_mm[here] == pytest.approx([radius], rel=0, abs=0)


def test_ctrl_c_keeps_what_is_grown(tmp_path, monkeypatch, capsys):
    advance = Growth._advance

    def interrupted(self, target):
        advance(self, target)
        if self.n_grown >= 500:
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(Growth, "_advance", interrupted)
    assert main(["generate", "karch-box", "-o", str(tmp_path / "tree.vtp"), "--set", "n_terminals=100000"]) == 130
    assert 500 <= read_tree(tmp_path / "tree.vtp").topology.n_terminals < 100000
    assert "interrupted at" in capsys.readouterr().err


def test_ctrl_c_before_anything_has_grown_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(Growth, "_begin", lambda self: os.kill(os.getpid(), signal.SIGINT))
    assert generate(tmp_path) == 130
    assert not list(tmp_path.iterdir())


def box_surface(folder):
    pyvista.Box((0, 50, 0, 50, 0, 50)).triangulate().save(folder / "box.stl")
    return folder / "box.stl"


def two_boxes(folder):
    both = pyvista.Box((0, 50, 0, 50, 0, 50)).merge(pyvista.Box((80, 120, 0, 50, 0, 50)))
    both.extract_surface(algorithm="dataset_surface").triangulate().save(folder / "two.stl")
    return folder / "two.stl"


def cut(folder):
    path = box_surface(folder)
    path.write_bytes(path.read_bytes()[:-30])
    return path


def text(folder):
    (folder / "points.csv").write_text("x_mm,y_mm,z_mm\n0,0,0\n1,a,2\n")
    return folder / "points.csv"


def columns(folder):
    (folder / "points.csv").write_text("a,b\n0,0\n")
    return folder / "points.csv"


def outside(folder):
    (folder / "points.csv").write_text("x_mm,y_mm,z_mm\n0,0,0\n10,10,99\n")
    return folder / "points.csv"


@pytest.mark.parametrize(
    ("key", "make", "changes", "message"),
    [
        ("domain.file", two_boxes, (), "two.stl: the surface encloses 2 separate bodies"),
        ("domain.file", cut, (), "box.stl: is 654 bytes long where 684 are announced"),
        ("domain.file", box_surface, ("root_mm=60,0,0",), "the root (60, 0, 0) lies outside the domain, 10 mm from it"),
        ("terminals_file", text, (), "points.csv: holds text where numbers are needed"),
        ("terminals_file", columns, (), "points.csv: has no column x_mm, y_mm, z_mm"),
        ("terminals_file", outside, (), "1 terminals lie outside the domain (first: number 1 at [10.0, 10.0, 99.0])"),
        ("terminals_file", lambda folder: folder / "none.csv", (), "none.csv: no such file; check terminals_file"),
        ("root_tree", lambda folder: folder / "none.vtp", (), "none.vtp"),
        ("domain.box_mm", lambda folder: "90,0,16", (), "a box with sides [90.0, 0.0, 16.0] mm has no volume"),
        ("domain.box_mm", lambda folder: "90,nan,16", (), "domain.box_mm.1: input should be a finite number"),
        ("domain.shape", lambda folder: "ball", ("root_mm=0,0,31",), "the root (0, 0, 31) lies outside the domain"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(tmp_path, capsys, key, make, changes, message):
    value = make(tmp_path)
    before = sorted(tmp_path.iterdir())
    settings = [word for change in (f"{key}={value}", *changes) for word in ("--set", change)]
    assert generate(tmp_path, *settings, "--json", tmp_path / "out.json") == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("vascval: error: ")
    assert message in lines[0]
    assert sorted(tmp_path.iterdir()) == before


def test_what_cannot_hold_is_a_failed_computation(tmp_path, capsys):
    assert generate(tmp_path, "--set", "growth.r_min_mm=0.3") == 1
    assert "would be thinner than r_min 0.3 mm" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_file_name_that_is_no_tree(tmp_path, capsys):
    assert generate(tmp_path, name="tree.stl") == 2
    assert "ends in neither .vtp nor .swc" in capsys.readouterr().err
