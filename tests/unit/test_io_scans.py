"""Volumes that are read block by block: the same values, the same tree, and refusals in one line."""

from __future__ import annotations

import gzip
import json
import struct
import tracemalloc
from pathlib import Path

import h5py
import numpy as np
import pytest
import SimpleITK as sitk
import zarr

from tests.benchmarks.phantoms import phantom
from vascval.core.errors import InputError
from vascval.imaging import memory, skeletonize
from vascval.imaging.memory import budget
from vascval.io.scans import Scan, open_scan
from vascval.io.volumes import Volume, read_volume

SPACING = (0.5, 0.25, 2.0)


def sample(dtype: str = "uint8") -> np.ndarray:
    """(9, 14, 11) values, all different where the type has room."""
    return (np.arange(9 * 14 * 11).reshape(9, 14, 11) * 7 % 251).astype(dtype)


def ome(unit: str | None = "micrometer", axes: str = "zyx") -> dict:
    """OME metadata of an image in two resolutions, its voxels SPACING mm, the first at 1, 2, 3 mm."""
    per = {"micrometer": 1000.0, "millimeter": 1.0, None: 1.0}[unit]
    ones = [1.0] * (len(axes) - 3)
    steps = [
        {"type": "scale", "scale": ones + [s * per for s in SPACING[::-1]]},
        {"type": "translation", "translation": [0.0] * len(ones) + [3.0 * per, 2.0 * per, 1.0 * per]},
    ]
    named = [{"name": a, **({} if unit is None else {"unit": unit})} for a in axes]
    sets = [{"path": "0", "coordinateTransformations": steps}, {"path": "1", "coordinateTransformations": steps}]
    return {"version": "0.4", "axes": named, "datasets": sets}


def write_zarr(
    path: Path, values: np.ndarray, *, version: int = 2, chunks: tuple[int, ...] = (4, 5, 6), **more
) -> None:
    array = zarr.create_array(
        str(path), shape=values.shape, chunks=chunks, dtype=values.dtype, zarr_format=version, **more
    )
    array[...] = values


def write_ome(path: Path, values: np.ndarray, *, version: int = 2, unit: str | None = "micrometer") -> None:
    group = zarr.open_group(str(path), mode="w", zarr_format=version)
    for name in "01":
        array = group.create_array(name, shape=(1, *values.shape), chunks=(1, 4, 5, 6), dtype=values.dtype)
        array[...] = values[None]
    image = ome(unit, "czyx")
    group.attrs.update(
        {"multiscales": [image]} if version == 2 else {"ome": {"version": "0.5", "multiscales": [image]}}
    )


def write_nrrd(path: Path, values: np.ndarray, *, big: bool = False, packed: bool = False) -> None:
    names = {"u1": "uchar", "i2": "short", "u2": "uint16", "f4": "float", "f8": "double", "i4": "int"}
    axes = " ".join(str(tuple(float(v) for v in row)).replace(" ", "") for row in np.diag(SPACING))
    head = [
        "NRRD0004",
        f"type: {names[values.dtype.str[1:]]}",
        "dimension: 3",
        "space: left-posterior-superior",
        f"sizes: {' '.join(map(str, values.shape[::-1]))}",
        f"space directions: {axes}",
        "kinds: domain domain domain",
        f"endian: {'big' if big else 'little'}",
        f"encoding: {'gzip' if packed else 'raw'}",
        "space origin: (1,2,3)",
    ]
    data = values.astype(values.dtype.newbyteorder(">" if big else "<")).tobytes()
    if path.suffix == ".nrrd":
        path.write_bytes(("\n".join(head) + "\n\n").encode() + (gzip.compress(data) if packed else data))
        return
    half = len(data) // values.shape[0] * (values.shape[0] // 3)
    for k in range(3):
        part = data[k * half : (k + 1) * half]
        (path.parent / f"part{k}.raw").write_bytes(gzip.compress(part) if packed else part)
    path.write_text("\n".join([*head, "data file: part%d.raw 0 2 1 3"]) + "\n")


def write_image(path: Path, values: np.ndarray, *, packed: bool = False) -> None:
    image = sitk.GetImageFromArray(values)
    image.SetSpacing(SPACING)
    image.SetOrigin((1.0, 2.0, 3.0))
    sitk.WriteImage(image, str(path), useCompression=packed)


def write_slices(path: Path, values: np.ndarray) -> None:
    path.mkdir()
    for k, plane in enumerate(values):
        sitk.WriteImage(sitk.GetImageFromArray(plane), str(path / f"slice{k + 8}.tif"), useCompression=False)


def write_hdf5(path: Path, values: np.ndarray, *, chunks: tuple[int, ...] | None = (4, 5, 6)) -> None:
    with h5py.File(path, "w") as file:
        array = file.create_dataset("volume/cast", data=values, chunks=chunks, compression="gzip" if chunks else None)
        array.attrs["element_size_um"] = np.array(SPACING[::-1]) * 1000.0
        file["notes"] = np.zeros(3)


WRITERS = {
    "a.nrrd": write_nrrd,
    "big.nrrd": lambda path, values: write_nrrd(path, values, big=True),
    "a.nhdr": write_nrrd,
    "gz.nrrd": lambda path, values: write_nrrd(path, values, packed=True),
    "gz.nhdr": lambda path, values: write_nrrd(path, values, big=True, packed=True),
    "a.nii": write_image,
    "a.nii.gz": lambda path, values: write_image(path, values, packed=True),
    "a.mha": write_image,
    "a.mhd": write_image,
    "a.tif": write_image,
    "slices": write_slices,
    "a.zarr": write_zarr,
    "v3.zarr": lambda path, values: write_zarr(path, values, version=3),
    "sharded.zarr": lambda path, values: write_zarr(path, values, version=3, chunks=(2, 5, 6), shards=(4, 10, 12)),
    "ome.zarr": write_ome,
    "ome3.zarr": lambda path, values: write_ome(path, values, version=3),
    "a.h5": write_hdf5,
    "flat.hdf5": lambda path, values: write_hdf5(path, values, chunks=None),
}
PLACED = [name for name in WRITERS if name not in ("a.tif", "slices", "a.zarr", "v3.zarr", "sharded.zarr")]


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


def refused(path: Path, message: str, **options) -> None:
    with pytest.raises(InputError, match=message) as caught:
        scan = open_scan(path, **options)
        assert isinstance(scan, Scan)
        scan.load()
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)
    assert "; " in str(caught.value)


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


@pytest.mark.parametrize("name", ["gz.nrrd", "gz.nhdr", "a.nii.gz"])
def test_packed_files_are_read_in_slices_without_holding_the_rest(name: str, tmp_path: Path) -> None:
    values = np.random.default_rng(0).integers(0, 255, (81, 512, 1024)).astype(np.uint8)
    WRITERS[name](tmp_path / name, values)
    scan = open_scan(tmp_path / name)
    tracemalloc.start()
    last = 0
    for z, y, block in scan.blocks():
        assert y == 0
        assert np.array_equal(block, values[z : z + len(block)])
        last = z + len(block)
    assert last == len(values)
    assert tracemalloc.get_traced_memory()[1] < values.nbytes / 2
    tracemalloc.stop()


@pytest.mark.parametrize("name", ["gz.nrrd", "gz.nhdr", "a.nii.gz"])
def test_damaged_packed_files_are_refused(name: str, tmp_path: Path) -> None:
    WRITERS[name](tmp_path / name, sample())
    file = tmp_path / ("part2.raw" if name.endswith("nhdr") else name)
    data = file.read_bytes()
    checksum = len(data) - 8
    wrong = data[:checksum] + bytes([data[checksum] ^ 1]) + data[checksum + 1 :]
    for damaged in (data[:-100], data[:-4], wrong):
        file.write_bytes(damaged)
        with pytest.raises(InputError, match="truncated or damaged, get it again"):
            open_scan(tmp_path / name).load()
    file.write_bytes(data[:checksum] + data[checksum:] * 2)
    with pytest.raises(InputError, match="truncated or damaged, get it again"):
        open_scan(tmp_path / name).load()


@pytest.mark.parametrize(("place", "value"), [(112, 2.0), (80, -0.5), (108, 0.0), (108, 288.0)])
def test_nifti_with_a_scale_or_oddities_is_left_to_the_library(place: int, value: float, tmp_path: Path) -> None:
    """Slope, spacing, and beginning of the values."""
    write_image(tmp_path / "a.nii", sample("int16"))
    data = bytearray((tmp_path / "a.nii").read_bytes())
    struct.pack_into("<f", data, place, value)
    (tmp_path / "a.nii").write_bytes(data)
    volume = open_scan(tmp_path / "a.nii")
    assert isinstance(volume, Volume)
    if place != 108:
        assert np.array_equal(volume.values, sample("int16") * (2 if place == 112 else 1))


def test_values_of_a_nifti_are_those_of_its_own_file(tmp_path: Path) -> None:
    """The library takes those of ``a.nii``, wherever it lies beside ``a.nii.gz``."""
    write_image(tmp_path / "a.nii", sample("int16"))
    write_image(tmp_path / "a.nii.gz", sample("int16")[::-1], packed=True)
    assert np.array_equal(read_volume(tmp_path / "a.nii.gz").values, sample("int16")[::-1])
    assert np.array_equal(read_volume(tmp_path / "a.nii").values, sample("int16"))
    data = bytearray(gzip.decompress((tmp_path / "a.nii.gz").read_bytes()))
    struct.pack_into("<f", data, 112, 2.0)
    (tmp_path / "a.nii.gz").write_bytes(gzip.compress(data))
    with pytest.raises(InputError, match=r"lies beside a\.nii, whose values would be taken"):
        read_volume(tmp_path / "a.nii.gz")
    (tmp_path / "a.nii").unlink()
    assert np.array_equal(read_volume(tmp_path / "a.nii.gz").values, 2 * sample("int16")[::-1])


@pytest.mark.parametrize("sizes", ["4294967296 4294967296 2", "3 3 9223372036854775807", "65536 65536 65536"])
def test_packed_files_that_claim_too_much_are_refused_before_anything_is_allocated(sizes: str, tmp_path: Path) -> None:
    write_nrrd(tmp_path / "a.nrrd", sample(), packed=True)
    data = (tmp_path / "a.nrrd").read_bytes().replace(b"sizes: 11 14 9", b"sizes: " + sizes.encode())
    (tmp_path / "a.nrrd").write_bytes(data)
    refused(tmp_path / "a.nrrd", "allow more")


def test_nifti_of_another_name_than_content_is_refused(tmp_path: Path) -> None:
    write_image(tmp_path / "a.nii", sample())
    write_image(tmp_path / "b.nii.gz", sample(), packed=True)
    (tmp_path / "a.nii").rename(tmp_path / "a.nii.gz")
    (tmp_path / "b.nii.gz").rename(tmp_path / "b.nii")
    for name in ("a.nii.gz", "b.nii"):
        with pytest.raises(InputError, match="truncated"):
            open_scan(tmp_path / name)
