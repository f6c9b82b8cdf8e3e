"""Volumes that are read block by block, from the command line."""

import json

import h5py
import numpy as np
import pytest
import zarr

from vascval.cli.main import main
from vascval.io.trees import read_tree


@pytest.fixture
def stores(tmp_path, mask):
    """The mask as zarr and among other arrays in HDF5; voxels of half a millimetre."""
    array = zarr.create_array(
        str(tmp_path / "cast.zarr"), shape=mask.shape, chunks=(20, 30, 40), dtype="u1", zarr_format=2
    )
    array[...] = mask
    with h5py.File(tmp_path / "cast.h5", "w") as file:
        file["raw"], file["labels"] = np.zeros((3, 3, 3), dtype="u1"), mask.astype("u1")
    return tmp_path


def refusal(arguments, capsys) -> str:
    assert main([str(argument) for argument in arguments]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    return lines[0]


def test_the_same_tree_from_every_format(stores, cast_file, capsys):
    options = ["--max-memory", "4GB", "--spacing", "0.5"]
    assert main(["skeletonize", str(cast_file), "-o", str(stores / "whole.vtp")]) == 0
    whole = read_tree(stores / "whole.vtp")
    for name, more in (("cast.zarr", []), ("cast.h5", ["--dataset", "labels"])):
        out = stores / f"{name}.vtp"
        document = stores / f"{name}.json"
        command = ["skeletonize", str(stores / name), "-o", str(out), "--json", str(document), *options, *more]
        assert main(command) == 0, capsys.readouterr().err
        found = read_tree(out)
        assert np.array_equal(found.parent, whole.parent)
        assert np.array_equal(found.radius_mm, whole.radius_mm)
        # the other file has an origin
        assert np.abs(found.position_mm - whole.position_mm + whole.position_mm[0] - found.position_mm[0]).max() < 1e-9
        source = json.loads(document.read_text())["provenance"]["inputs"][0]
        assert source["bytes"] == sum(
            file.stat().st_size for file in [*(stores / name).rglob("*"), stores / name] if file.is_file()
        )


def test_refusals_are_one_line_and_leave_nothing(stores, capsys):
    out = stores / "out.vtp"
    for name, options, message in (
        ("cast.zarr", [], "zarr gives no spacing"),
        ("cast.zarr", ["--spacing", "1", "--max-memory", "1MB"], "are allowed"),
        ("cast.zarr", ["--spacing", "1", "--dataset", "x"], "leave out --dataset"),
        ("cast.h5", ["--spacing", "1"], "choose one with --dataset"),
    ):
        line = refusal(["skeletonize", stores / name, "-o", out, *options], capsys)
        assert line.startswith(f"vascval: error: {stores / name}: ")
        assert message in line
        assert not out.exists()
    (stores / "cast.zarr" / ".zarray").write_text("{")
    assert "is no zarr metadata" in refusal(["skeletonize", stores / "cast.zarr", "-o", out, "--spacing", "1"], capsys)
