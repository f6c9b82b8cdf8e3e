"""Atomic files and folders, provenance, tables."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import vascval
from vascval.core.errors import InputError
from vascval.io.atomic import atomic_directory, atomic_file
from vascval.io.provenance import plain, provenance, sha256
from vascval.io.tables import write_table
from vascval.io.trees import is_tree_path, is_volume_path


def test_a_file_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "a.nii.gz"
    path.write_text("old")
    with pytest.raises(ZeroDivisionError), atomic_file(path) as aside:
        aside.write_text("half")
        assert aside.parent == tmp_path
        assert aside.name.endswith("a.nii.gz")
        assert path.read_text() == "old"
        _ = 1 / 0
    assert path.read_text() == "old"
    with atomic_file(path) as aside:
        aside.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_was_never_written_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a.txt: cannot be written \(No such file"), atomic_file(tmp_path / "a.txt"):
        pass


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_file_does_not_take_the_place_of_a_device_or_pipe(tmp_path: Path) -> None:
    """A rename onto /dev/null would make a file of it."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    (tmp_path / "link").symlink_to(pipe)
    for path in (pipe, tmp_path / "link"):
        with pytest.raises(InputError, match=r"is a device or a pipe, .* give another name"), atomic_file(path):
            pass
    assert pipe.is_fifo()
    assert sorted(item.name for item in tmp_path.iterdir()) == ["link", "pipe"]


def test_a_folder_is_filled_at_the_end_or_not_at_all(tmp_path: Path) -> None:
    target = tmp_path / "x" / "out"
    with pytest.raises(ZeroDivisionError), atomic_directory(target) as aside:
        (aside / "a.txt").write_text("half")
        _ = 1 / 0
    assert list(tmp_path.iterdir()) == []
    with atomic_directory(target) as aside:
        (aside / "a.txt").write_text("1")
        (aside / "figures").mkdir()
        (aside / "figures" / "b.txt").write_text("2")
        assert not target.exists()
    with atomic_directory(target) as aside:
        (aside / "figures").mkdir()
        (aside / "figures" / "b.txt").write_text("3")
        (aside / "c.txt").write_text("4")
    names = sorted(str(item.relative_to(tmp_path)) for item in tmp_path.rglob("*") if item.is_file())
    assert names == ["x/out/a.txt", "x/out/c.txt", "x/out/figures/b.txt"]
    assert (target / "figures" / "b.txt").read_text() == "3"


def test_a_folder_refuses_to_be_a_file(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("")
    with pytest.raises(InputError, match="a: is a file; give the name of a folder"), atomic_directory(tmp_path / "a"):
        pass
    with pytest.raises(InputError, match=r"folder .* does not exist"), atomic_directory(tmp_path / "a" / "b"):
        pass


def test_provenance_is_plain_and_has_no_time(tmp_path: Path) -> None:
    @dataclass
    class Config:
        seed: np.int64
        box: np.ndarray

    (tmp_path / "cast.nrrd").write_bytes(b"abc")
    (tmp_path / "stack").mkdir()
    (tmp_path / "stack" / "s1.tif").write_bytes(b"abcd")
    config = {"grow": Config(np.int64(4), np.array([1.5, 2.0])), "path": Path("a/b"), "set": {3, 1}, "none": None}
    inputs = [tmp_path / "cast.nrrd", tmp_path / "stack"]
    record = provenance(command="compare", config=config, seed=np.int64(7), inputs=inputs)
    assert record == provenance(command="compare", config=config, seed=7, inputs=inputs)
    assert json.loads(json.dumps(record)) == record
    assert list(record) == ["version", "command", "config", "seed", "inputs"]
    assert record["version"] == vascval.__version__
    assert record["config"] == {"grow": {"seed": 4, "box": [1.5, 2.0]}, "path": "a/b", "set": [1, 3], "none": None}
    digest = hashlib.sha256(b"abc").hexdigest()
    assert record["inputs"][0] == {"name": "cast.nrrd", "sha256": digest, "bytes": 3}
    assert record["inputs"][1]["bytes"] == 4
    before = sha256(tmp_path / "stack")
    (tmp_path / "stack" / "s1.tif").rename(tmp_path / "stack" / "s2.tif")
    assert sha256(tmp_path / "stack") != before
    with pytest.raises(InputError, match=r"no.nrrd: cannot be read \(No such file or directory\)"):
        provenance(command="x", config={}, seed=None, inputs=[tmp_path / "no.nrrd"])


def test_plain_keeps_numbers_and_spells_the_rest() -> None:
    assert plain((np.float32(0.5), np.bool_(True), {"a": np.arange(2)})) == [0.5, True, {"a": [0, 1]}]


def test_tables_read_back_as_they_were(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    frame = pd.DataFrame({"order": [1, 2, 3], "radius_mean_mm": rng.random(3) * 10.0 ** rng.integers(-30, 30, 3)})
    write_table(frame, tmp_path / "a.csv")
    back = pd.read_csv(tmp_path / "a.csv", converters={"radius_mean_mm": float})
    pd.testing.assert_frame_equal(back, frame, check_exact=True)
    text = (tmp_path / "a.csv").read_bytes()
    assert text.startswith(b"order,radius_mean_mm\n1,")
    assert b"\r" not in text
    write_table(frame, tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_bytes() == text


@pytest.mark.parametrize(
    ("name", "tree", "volume"),
    [("a.vtp", True, False), ("A.VTK", True, False), ("a.swc", True, False), ("a.gxl.xml", True, False),
     ("a.nrrd", False, True), ("a.nii.gz", False, True), ("a.TIF", False, True), ("a.mhd", False, True),
     ("a.csv", False, False), ("a.gz", False, False)],
)  # fmt: skip
def test_kinds_of_names(name: str, tree: bool, volume: bool) -> None:
    assert (is_tree_path(name), is_volume_path(Path(name))) == (tree, volume)
