"""What commands say: JSON on stdout and nothing else there, notes on what was guessed or mended, dashes for what does
not exist."""

import json

import numpy as np
import pytest
from cli_files import write_nrrd

from vascval.cli.main import main

SMALL = ["karch-box", "--set", "n_terminals=20"]


def said(arguments, capsys, code: int = 0) -> tuple[str, str]:
    capsys.readouterr()
    assert main([str(argument) for argument in arguments]) == code
    return capsys.readouterr()


@pytest.fixture(name="study", scope="module")
def _study(tmp_path_factory):
    """An ensemble of one tree that is there already."""
    folder = tmp_path_factory.mktemp("said") / "study"
    assert main(["ensemble", *SMALL, "--seeds", "1", "-o", str(folder), "--quiet"]) == 0
    return folder


@pytest.fixture(name="pieces")
def _pieces(tmp_path):
    """A domain with a speck beside it."""
    values = np.zeros((20, 20, 30), np.uint8)
    values[2:18, 2:18, 2:24] = 1
    values[4, 4, 28] = 1
    return write_nrrd(tmp_path / "pieces.nrrd", values, spacing=(1.0,) * 3)


def test_json_alone_on_stdout(tmp_path, cast_file, study, capsys):
    for arguments, key in (
        (["skeletonize", cast_file, "-o", tmp_path / "cast.vtp"], "image"),
        (["generate", *SMALL, "-o", tmp_path / "tree.vtp"], "stages"),
        (["ensemble", *SMALL, "--seeds", "1", "-o", study], "totals"),
    ):
        out, err = said([*arguments, "--json", "-"], capsys)
        assert key in json.loads(out)
        assert all(line.startswith("vascval: note: ") for line in err.splitlines())


def test_the_spread_of_one_tree_is_a_dash(study, capsys):
    out, err = said(["ensemble", *SMALL, "--seeds", "1", "-o", study], capsys)
    assert "note: 1 tree of 1 there already" in err
    header, *rows = (line.split() for line in out.split("\n\n")[0].splitlines())
    assert header[2:] == ["mean", "sd", "median", "least", "most"]
    assert [row[2] for row in rows] == ["-"] * len(rows)
    assert rows[0][:2] == ["n_terminals", "20"]


def test_what_was_done_to_an_image_is_shown(cast_file, capsys):
    out, _ = said(["analyze", cast_file], capsys)
    for words in ("components", "spurs", "loops"):
        assert words in out
    assert "report:" not in out


def test_what_was_guessed_of_a_tree_is_noted(tree_file, capsys):
    tree_file.write_text(tree_file.read_text().replace("# unit: mm\n", ""))
    _, err = said(["analyze", tree_file], capsys)
    assert f"vascval: note: {tree_file}: " in err and "unit" in err
    assert said(["analyze", tree_file, "--quiet"], capsys)[1] == ""


def test_a_spacing_that_contradicts_the_file_is_noted(cast_file, capsys):
    _, err = said(["analyze", cast_file, "--spacing", "0.6"], capsys)
    assert f"note: {cast_file}: spacing given as [0.6, 0.6, 0.6] mm, the file says [0.5, 0.5, 0.5]" in err


@pytest.mark.parametrize("command", ["generate", "ensemble"])
def test_what_was_mended_of_a_domain_is_noted(command, tmp_path, pieces, capsys):
    changes = ["--set", f"domain.file={pieces}", "--set", "root_mm=2,9,9", "--set", "domain.keep=largest"]
    more = ["-o", tmp_path / "tree.vtp"] if command == "generate" else ["-o", tmp_path / "study", "--seeds", "1"]
    _, err = said([command, *SMALL, *changes, *more], capsys)
    assert "note: 1 smaller pieces of the domain, 1 voxels, were dropped" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["generate", *SMALL, "-o", "tree.vtp", "--checkpoint", "tree.vtp"], "tree.vtp is the tree too"),
        (["analyze", "{tree}", "-o", "gone/report"], "gone/report: the directory {here}/gone does not exist; make it"),
        (["schema", "--write", "gone"], "gone: no such directory; make it first"),
    ],
)
def test_places_that_cannot_be(arguments, message, tmp_path, tree_file, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    out, err = said([argument.format(tree=tree_file) for argument in arguments], capsys, code=2)
    assert out == "" and err.count("\n") == 1
    assert message.format(here=tmp_path) in err
    assert list(tmp_path.iterdir()) == [tree_file]


def test_a_window_without_a_display(tree_file, monkeypatch, capsys):
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    _, err = said(["view", tree_file], capsys, code=1)
    assert "no window can be opened here (no display); pass --screenshot FILE.png" in err
