"""Volumes that are read block by block: the same values, the same tree, and refusals in one line."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
import zarr
from scan_files import (
    PLACED,
    SPACING,
    WRITERS,
    ome,
    refused,
    sample,
    write_hdf5,
    write_nrrd,
    write_ome,
    write_zarr,
)

from tests.benchmarks.phantoms import phantom
from vascval.core.errors import InputError
from vascval.imaging import memory, skeletonize
from vascval.imaging.memory import budget
from vascval.io.scans import Scan, open_scan
from vascval.io.volumes import Volume, read_volume


@pytest.mark.parametrize("dtype", ["uint8", "int16", "uint16", "float32"])
@pytest.mark.parametrize("name", WRITERS)
def test_blocks_hold_the_values(name: str, dtype: str, tmp_path: Path) -> None:
    values = sample(dtype)
    WRITERS[name](tmp_path / name, values)
    scan = open_scan(tmp_path / name, spacing_mm=None if name in PLACED else SPACING)
    assert isinstance(scan, Scan)
    assert (scan.shape, scan.dtype) == (values.shape, values.dtype)
    assert np.array_equal(scan.load().values, values)
    assert np.array_equal(scan.read(2, 5, 3, 9), values[2:5, 3:9])
    assert scan.spacing_mm == pytest.approx(SPACING, rel=1e-12)
    if name in PLACED:
        first = [0.0, 0.0, 0.0] if name.endswith(("h5", "hdf5")) else [1.0, 2.0, 3.0]
        assert scan.to_world(np.zeros(3)) == pytest.approx(first, abs=1e-12)
    whole = read_volume(tmp_path / name, spacing_mm=None if name in PLACED else SPACING)
    assert np.array_equal(whole.values, values)
    for key in ("spacing_mm", "origin_mm", "direction"):
        assert np.array_equal(getattr(whole, key), getattr(scan, key))
    assert dict(whole.meta) == dict(scan.meta)


@pytest.mark.parametrize("chunk", [(1, 1), (4, 5), (9, 14), (3, 14), (20, 3)])
def test_blocks_cover_the_volume_once(chunk: tuple[int, int]) -> None:
    values = sample()
    frame = Volume(np.zeros((1, 1, 1)), np.ones(3))
    scan = Scan(frame, values.shape, values.dtype, chunk, lambda z0, z1, y0, y1: values[z0:z1, y0:y1])
    assert np.array_equal(scan.load().values, values)
    assert sum(block.size for _, _, block in scan.blocks()) == values.size


@pytest.fixture(scope="module")
def cast() -> Volume:
    """Rough, so that fragments, cavities and bumps are there."""
    return phantom("rough", 0, size=96, n_terminals=5).volume


def same(one, other) -> None:
    for name in ("parent", "position_mm", "radius_mm", "polyline_mm", "polyline_offset"):
        assert np.array_equal(getattr(one.tree, name), getattr(other.tree, name)), name
    for name in ("loops_mm", "spurs_mm", "breaks_mm"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name
    assert {k: v for k, v in one.image.items() if k != "notes"} == {
        k: v for k, v in other.image.items() if k != "notes"
    }


@pytest.mark.parametrize(
    "name", ["a.nrrd", "gz.nrrd", "a.nii.gz", "a.mha", "a.tif", "slices", "a.zarr", "sharded.zarr", "a.h5"]
)
def test_the_tree_is_that_of_the_array(name: str, cast: Volume, tmp_path: Path) -> None:
    values = np.ascontiguousarray(cast.values)
    WRITERS[name](tmp_path / name, values)
    scan = open_scan(tmp_path / name, spacing_mm=(1.0, 1.0, 1.0))
    assert isinstance(scan, Scan)
    same(skeletonize(scan), skeletonize(Volume(values, np.ones(3), scan.origin_mm)))


@pytest.mark.parametrize("choice", [{"label": 3}, {"threshold": 100}, {"threshold": "auto"}, {}])
@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_grey_values_and_labels_are_selected_alike(choice, dtype, cast: Volume, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 40, cast.shape)
    grey = np.where(cast.values == 1, 150 + rng.integers(0, 100, cast.shape), noise)
    values = np.where(cast.values == 1, 3, 5 * (noise > 30)) if "label" in choice else grey
    values = values.astype(dtype)
    write_zarr(tmp_path / "a.zarr", values, chunks=(32, 20, 50))
    scan = open_scan(tmp_path / "a.zarr", spacing_mm=(1.0, 1.0, 1.0))
    found, expected = skeletonize(scan, **choice), skeletonize(Volume(values, np.ones(3)), **choice)
    same(found, expected)
    assert found.image["n_voxels"] >= 0.9 * cast.values.sum()


def test_the_limit_is_known_before_the_work(cast: Volume, tmp_path: Path) -> None:
    """Less than the process holds, less than the blocks need, and less than the vessels need."""
    write_zarr(tmp_path / "a.zarr", cast.values)
    scan = open_scan(tmp_path / "a.zarr", spacing_mm=(1.0, 1.0, 1.0))
    with pytest.raises(InputError, match=r"96 x 96 x 96 voxels, read block by block, need .* \(--max-memory\)"):
        skeletonize(scan, max_memory_bytes=10_000_000)
    enough = budget(scan, None).held_bytes + (20 << 20)
    assert skeletonize(scan, max_memory_bytes=enough).tree.n_segments > 3
    n = int(cast.values.sum())
    short = memory.Budget(enough, enough - memory.PER_VOXEL * n)
    with pytest.raises(InputError, match=f"{n:,} vessel voxels need"):
        short.require_all(100, n, 0)
    with pytest.raises(InputError, match="vessel voxels in the first 7 slices need"):
        short.require_read(7, 100, n)


def test_a_crowded_volume_is_refused_while_it_is_read() -> None:
    """The reading ends at the slice where too much is vessel, long before the volume does."""
    asked: list[int] = []

    def read(z0: int, z1: int, y0: int, y1: int) -> np.ndarray:
        asked.append(z1)
        values = np.zeros((z1 - z0, y1 - y0, 500), dtype=np.uint8)
        values[:, :, ::2] = 1
        return values

    frame = Volume(np.zeros((1, 1, 1)), np.ones(3))
    scan = Scan(frame, (2000, 500, 500), np.dtype(np.uint8), (1, 500), read)
    allowed = budget(scan, None).held_bytes + (200 << 20)
    with pytest.raises(InputError, match=r"vessel voxels in the first \d+ slices need"):
        skeletonize(scan, label=1, max_memory_bytes=allowed)
    assert max(asked) < 100


def edit(file: Path, **entries) -> None:
    file.write_text(json.dumps({**json.loads(file.read_text()), **entries}))


def test_damaged_and_foreign_zarr_is_refused(tmp_path: Path) -> None:
    values, spacing = sample(), {"spacing_mm": (1.0, 1.0, 1.0)}
    folder = tmp_path / "none.zarr"
    folder.mkdir()
    refused(folder, "has no zarr metadata", **spacing)
    write_zarr(tmp_path / "a.zarr", values)
    refused(tmp_path / "a.zarr", "zarr gives no spacing")
    refused(tmp_path / "a.zarr", "the spacing .* is absurd", spacing_mm=(1e9, 1, 1))
    metadata = tmp_path / "a.zarr" / ".zarray"
    kept = metadata.read_text()
    for damage, message in (
        ({"compressor": {"id": "pickle"}}, "'pickle', which is not read here"),
        ({"filters": [{"id": "msgpack2"}]}, "'msgpack2', which is not read here"),
        ({"shape": [9, 14]}, "cannot be read as zarr|three axes z, y, x are needed"),
        ({"shape": [2, 9, 14, 11], "chunks": [1, 4, 5, 6]}, "take one frame or channel"),
        ({"shape": [9, 14, -1]}, "cannot be read as zarr|nothing in it"),
        ({"dtype": "<c8"}, "complex64|cannot be read as zarr"),
        ({"dtype": "|O"}, "type object|cannot be read as zarr"),
        ({"chunks": "many"}, "cannot be read as zarr"),
    ):
        edit(metadata, **damage)
        refused(tmp_path / "a.zarr", message, **spacing)
        metadata.write_text(kept)
    chunk = tmp_path / "a.zarr" / "1.1.1"
    chunk.write_bytes(chunk.read_bytes()[:20])
    refused(tmp_path / "a.zarr", "cannot be read .*; the folder is damaged", **spacing)
    metadata.write_text(kept[: len(kept) // 2])
    refused(tmp_path / "a.zarr", "is no zarr metadata", **spacing)


def test_ome_metadata_are_held_against_the_array(tmp_path: Path) -> None:
    path = tmp_path / "a.zarr"
    write_ome(path, sample())
    good = ome("micrometer", "czyx")
    swapped = [{"name": name, "unit": "micrometer"} for name in "cxyz"]
    for image, message in (
        ({**good, "datasets": [{"path": "../a.zarr/0"}]}, "lies outside it"),
        ({**good, "datasets": [{"path": "7"}]}, "has no array '7'"),
        ({**good, "datasets": []}, "name no data set"),
        ({**good, "axes": good["axes"][1:]}, "do not fit the array"),
        ({**good, "axes": [{**axis, "unit": "parsec"} for axis in good["axes"]]}, "'parsec'"),
        ({**good, "axes": swapped}, "the last three must be z, y, x"),
        ("picture", "describe no image"),
    ):
        edit(path / ".zattrs", multiscales=[image])
        refused(path, message)
    write_ome(tmp_path / "unitless.zarr", sample(), unit=None)
    refused(tmp_path / "unitless.zarr", "OME-Zarr gives no spacing")


def test_arrays_are_chosen_by_name(tmp_path: Path) -> None:
    group = zarr.open_group(str(tmp_path / "a.zarr"), mode="w", zarr_format=2)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for k, name in enumerate(("raw", "labels/cast")):
            array = group.create_array(name, shape=sample().shape, chunks=(4, 5, 6), dtype="u1")
            array[...] = sample() + np.uint8(k)
            file[name] = sample() + np.uint8(k)
    for name in ("a.zarr", "a.h5"):
        refused(tmp_path / name, "holds the arrays labels/cast, raw; choose one with --dataset", spacing_mm=(1, 1, 1))
        refused(tmp_path / name, "has no array 'ray'", spacing_mm=(1, 1, 1), dataset="ray")
        scan = open_scan(tmp_path / name, spacing_mm=(1, 1, 1), dataset="labels/cast")
        assert np.array_equal(scan.read(0, 9, 0, 14), sample() + np.uint8(1))
    write_nrrd(tmp_path / "a.nrrd", sample())
    refused(tmp_path / "a.nrrd", "leave out --dataset", dataset="raw")


def test_damaged_and_foreign_hdf5_is_refused(tmp_path: Path) -> None:
    (tmp_path / "foreign.h5").write_bytes(b"not at all")
    refused(tmp_path / "foreign.h5", "cannot be read as HDF5")
    refused(tmp_path / "absent.h5", "there is no such file")
    write_hdf5(tmp_path / "a.h5", sample())
    data = (tmp_path / "a.h5").read_bytes()
    (tmp_path / "a.h5").write_bytes(data[: len(data) // 2])
    refused(tmp_path / "a.h5", "cannot be read as HDF5")
    with h5py.File(tmp_path / "flat.h5", "w") as file:
        file["plane"] = np.zeros((4, 4))
    refused(tmp_path / "flat.h5", "holds no array with three axes")
    with h5py.File(tmp_path / "outside.h5", "w") as file:
        file.create_dataset("a", shape=(2, 2, 2), dtype="u1", external=[(str(tmp_path / "a.h5"), 0, 8)])
    refused(tmp_path / "outside.h5", "keeps its values in other files", spacing_mm=(1, 1, 1))


def test_values_that_are_not_finite_are_found_in_their_block(tmp_path: Path) -> None:
    values = sample("float32")
    values[7, 6, 4] = np.nan
    write_zarr(tmp_path / "a.zarr", values)
    with pytest.raises(InputError, match=r"voxel \(4, 6, 7\) is nan"):
        skeletonize(open_scan(tmp_path / "a.zarr", spacing_mm=(1, 1, 1)))


def test_a_file_that_shrinks_while_it_is_read_is_refused(tmp_path: Path) -> None:
    write_nrrd(tmp_path / "a.nrrd", sample())
    scan = open_scan(tmp_path / "a.nrrd")
    data = (tmp_path / "a.nrrd").read_bytes()
    (tmp_path / "a.nrrd").write_bytes(data[:-20])
    with pytest.raises(InputError, match="ends within slice 8; it is truncated"):
        scan.load()
