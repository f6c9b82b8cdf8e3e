"""Reading and writing volumes: values, frame, units, and what it costs."""

from __future__ import annotations

import gzip
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk

from vascval.io.volumes import Volume, is_volume_path, read_volume, slices_of, write_volume

_TURN = np.array([[0.0, -1.0, 0.0], [0.6, 0.0, -0.8], [0.8, 0.0, 0.6]])


def sample(dtype: str = "uint8") -> np.ndarray:
    return np.random.default_rng(1).integers(0, 100, (4, 5, 6)).astype(dtype)


def volume(dtype: str = "uint8") -> Volume:
    return Volume(sample(dtype), np.array([0.5, 0.25, 2.0]), np.array([10.0, -20.0, 30.0]), _TURN, {"a": 'x\\n"\n'})


@pytest.mark.parametrize("suffix", [".nrrd", ".nii", ".nii.gz", ".mha"])
@pytest.mark.parametrize("dtype", ["bool", "int8", "uint8", "int16", "uint16", "int32", "float32", "float64", ">u2"])
def test_a_volume_reads_back_as_it_was_written(tmp_path: Path, suffix: str, dtype: str) -> None:
    written = volume(dtype)
    write_volume(written, tmp_path / f"a{suffix}")
    back = read_volume(tmp_path / f"a{suffix}")
    assert np.array_equal(back.values, written.values)
    assert back.values.dtype == (np.uint8 if dtype == "bool" else np.dtype(dtype).newbyteorder("="))
    # NIfTI stores its transforms in float32: 2^-24 relative, of numbers up to 30
    tolerance = {"rtol": 0, "atol": 4e-6 if "nii" in suffix else 1e-12}
    np.testing.assert_allclose(back.spacing_mm, written.spacing_mm, **tolerance)
    np.testing.assert_allclose(back.origin_mm, written.origin_mm, **tolerance)
    np.testing.assert_allclose(back.direction, written.direction, **tolerance)
    if "nii" not in suffix:
        assert back.meta["a"] == 'x\\n"\n'
    assert [item.name for item in tmp_path.iterdir()] == [f"a{suffix}"]


@pytest.mark.parametrize("suffix", [".nrrd", ".nii", ".nii.gz", ".mha"])
def test_the_same_volume_gives_the_same_bytes(tmp_path: Path, suffix: str) -> None:
    for name in "ab":
        write_volume(volume(), tmp_path / f"{name}{suffix}")
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


def test_what_we_write_as_nrrd_is_what_itk_reads(tmp_path: Path) -> None:
    write_volume(volume("int16"), tmp_path / "a.nrrd")
    image = sitk.ReadImage(str(tmp_path / "a.nrrd"))
    assert np.array_equal(sitk.GetArrayFromImage(image), sample("int16"))
    np.testing.assert_allclose(image.GetSpacing(), [0.5, 0.25, 2.0], rtol=1e-12)
    np.testing.assert_allclose(image.GetOrigin(), [10, -20, 30], rtol=1e-12)
    np.testing.assert_allclose(np.reshape(image.GetDirection(), (3, 3)), _TURN, atol=1e-12)


def test_voxel_indices_and_world_positions(tmp_path: Path) -> None:
    given = volume()
    image = sitk.GetImageFromArray(given.values)
    image.SetSpacing(given.spacing_mm.tolist())
    image.SetOrigin(given.origin_mm.tolist())
    image.SetDirection(given.direction.ravel().tolist())
    index = np.array([[0, 0, 0], [5, 4, 3], [1.5, 2.25, 0.5]])
    truth = np.array([image.TransformContinuousIndexToPhysicalPoint(row.tolist()) for row in index])
    np.testing.assert_allclose(given.to_world(index), truth, atol=1e-12)  # a few roundings of numbers up to 40
    np.testing.assert_allclose(given.to_index(truth), index, atol=1e-12)
    assert given.to_world(np.zeros((2, 7, 3))).shape == (2, 7, 3)


@pytest.mark.parametrize("suffix", [".nhdr", ".mhd"])
def test_detached_headers(tmp_path: Path, suffix: str) -> None:
    sitk.WriteImage(sitk.GetImageFromArray(sample("int16")), str(tmp_path / f"a{suffix}"))
    assert len(list(tmp_path.iterdir())) == 2
    assert np.array_equal(read_volume(tmp_path / f"a{suffix}").values, sample("int16"))
    (tmp_path / "elsewhere").symlink_to(tmp_path)
    assert np.array_equal(read_volume(tmp_path / "elsewhere" / f"a{suffix}").values, sample("int16"))


@pytest.mark.parametrize("data_file", ["LIST\ns1.raw\ns2.raw\ns3.raw\ns4.raw", "s%d.raw 1 4 1"])
def test_a_detached_header_over_several_files(tmp_path: Path, data_file: str) -> None:
    for number, plane in enumerate(sample(), start=1):
        (tmp_path / f"s{number}.raw").write_bytes(plane.tobytes())
    (tmp_path / "a.nhdr").write_text(
        f"NRRD0004\ntype: uchar\ndimension: 3\nsizes: 6 5 4\nspacings: 1 1 1\nencoding: raw\ndata file: {data_file}\n"
    )
    (tmp_path / "a.mhd").write_text(
        "ObjectType = Image\nNDims = 3\nElementSpacing = 1 1 1\nDimSize = 6 5 4\nElementType = MET_UCHAR\n"
        f"ElementDataFile = {data_file}\n"
    )
    for name in ("a.nhdr", "a.mhd"):
        assert np.array_equal(read_volume(tmp_path / name).values, sample())


@pytest.mark.parametrize("unit", ["um", "µm", "mm", "cm", "m"])
def test_nrrd_axis_units(tmp_path: Path, unit: str) -> None:
    mm = {"um": 1e-3, "µm": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1000.0}[unit]
    (tmp_path / "a.nrrd").write_bytes(
        "NRRD0004\ntype: uchar\ndimension: 3\nspace: right-anterior-superior\nsizes: 6 5 4\nencoding: raw\n"
        "space directions: (0.2,0,0) (0,0.2,0) (0,0,0.4)\nspace origin: (1,2,3)\n"
        f'space units: "{unit}" "{unit}" "{unit}"\n\n'.encode()
        + sample().tobytes()
    )
    read = read_volume(tmp_path / "a.nrrd")
    np.testing.assert_allclose(read.spacing_mm, np.array([0.2, 0.2, 0.4]) * mm, rtol=1e-12)
    np.testing.assert_allclose(read.origin_mm, np.array([-1.0, -2.0, 3.0]) * mm, rtol=1e-12)  # RAS to LPS
    np.testing.assert_allclose(read.direction, np.diag([-1.0, -1.0, 1.0]), atol=1e-12)


@pytest.mark.parametrize(("code", "mm"), [(0, 1.0), (1, 1000.0), (2, 1.0), (3, 1e-3)])
@pytest.mark.parametrize("transform", ["sform", "qform", "none"])
def test_nifti_units_hold_for_spacing_and_origin(tmp_path: Path, code: int, mm: float, transform: str) -> None:
    write_volume(Volume(sample(), np.array([0.1, 0.2, 0.4]), np.array([1.0, 2.0, 3.0])), tmp_path / "a.nii")
    head = bytearray((tmp_path / "a.nii").read_bytes())
    struct.pack_into("<B", head, 123, code)
    struct.pack_into("<hh", head, 252, int(transform == "qform"), int(transform == "sform"))
    (tmp_path / "a.nii").write_bytes(bytes(head))
    read = read_volume(tmp_path / "a.nii")
    np.testing.assert_allclose(read.spacing_mm, np.array([0.1, 0.2, 0.4]) * mm, rtol=1e-6)
    origin = np.zeros(3) if transform == "none" else np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(read.origin_mm, origin * mm, rtol=1e-6)


def test_nifti_intensities_are_rescaled(tmp_path: Path) -> None:
    write_volume(Volume(sample("int16"), np.ones(3)), tmp_path / "a.nii")
    head = bytearray((tmp_path / "a.nii").read_bytes())
    struct.pack_into("<ff", head, 112, 2.0, -7.0)
    (tmp_path / "a.nii").write_bytes(bytes(head))
    assert np.array_equal(read_volume(tmp_path / "a.nii").values, sample() * 2.0 - 7.0)


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_tiff_pages_and_slices(tmp_path: Path, compressed: bool, dtype: str) -> None:
    sitk.WriteImage(sitk.GetImageFromArray(sample(dtype)), str(tmp_path / "a.tif"), useCompression=compressed)
    (tmp_path / "stack").mkdir()
    for number, plane in enumerate(sample(dtype), start=8):
        sitk.WriteImage(sitk.GetImageFromArray(plane), str(tmp_path / "stack" / f"cast7_{number}.tiff"))
    (tmp_path / "stack" / "notes.txt").write_text("8 to 11")
    assert [item.name for item in slices_of(tmp_path / "stack")] == [f"cast7_{i}.tiff" for i in (8, 9, 10, 11)]
    for name in ("a.tif", "stack"):
        read = read_volume(tmp_path / name, spacing_mm=(0.02, 0.02, 0.05))
        assert np.array_equal(read.values, sample(dtype))
        assert read.values.dtype == np.dtype(dtype)
        assert read.spacing_mm.tolist() == [0.02, 0.02, 0.05]
        assert read.origin_mm.tolist() == [0, 0, 0]
        assert is_volume_path(tmp_path / name)


def test_a_compressed_nifti_of_several_members_is_complete(tmp_path: Path) -> None:
    write_volume(Volume(sample(), np.ones(3)), tmp_path / "a.nii")
    whole = (tmp_path / "a.nii").read_bytes()
    members = [gzip.compress(part) for part in (whole[:400], whole[400:450], whole[450:])]
    (tmp_path / "a.nii.gz").write_bytes(b"".join(members))
    assert np.array_equal(read_volume(tmp_path / "a.nii.gz").values, sample())


def test_a_spacing_that_is_given_replaces_that_of_the_file_and_is_noted(tmp_path: Path) -> None:
    write_volume(volume(), tmp_path / "a.nrrd")
    read = read_volume(tmp_path / "a.nrrd", spacing_mm=(1, 2, 3))
    assert read.spacing_mm.tolist() == [1, 2, 3]
    assert read.meta["notes"] == ["spacing given as [1.0, 2.0, 3.0] mm, the file says [0.5, 0.25, 2.0]"]


def test_values_are_read_only_and_outlive_their_volume(tmp_path: Path) -> None:
    write_volume(volume(), tmp_path / "a.nrrd")
    values = read_volume(tmp_path / "a.nrrd").values
    junk = [np.ones(values.size, dtype=np.uint8) for _ in range(100)]
    assert np.array_equal(values, sample())
    assert values.flags.c_contiguous
    assert len(junk) == 100
    with pytest.raises(ValueError, match="read-only"):
        values[0, 0, 0] = 1


_PEAK = """
import sys
import numpy as np
from vascval.io.volumes import Volume, read_volume, write_volume

def peak_kib():
    return int(open("/proc/self/status").read().split("VmHWM:")[1].split()[0])

write_volume(Volume(np.zeros((8, 8, 8), np.uint8), np.ones(3)), sys.argv[1])
read_volume(sys.argv[1])
before = peak_kib()
volume = read_volume(sys.argv[2])
print(peak_kib() - before)
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the peak of memory is read from /proc")
def test_the_voxels_are_held_once(tmp_path: Path) -> None:
    values = np.zeros((256, 512, 512), dtype=np.uint8)
    values[100:120] = 7
    write_volume(Volume(values, np.ones(3)), tmp_path / "big.nrrd")
    command = [sys.executable, "-c", _PEAK, str(tmp_path / "small.nrrd"), str(tmp_path / "big.nrrd")]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    grown_kib = int(run.stdout)
    # 65,536 KiB of voxels: once, and room for the library's buffers; two copies would be 131,072 KiB
    assert 60_000 < grown_kib < 90_000


@pytest.mark.parametrize(("name", "voxels"), [("portalvein", 103_533), ("venoussystem", 143_180), ("liver", 2_865_131)])
def test_the_ircad_masks(shared_data: Callable[..., Path], name: str, voxels: int) -> None:
    mask = read_volume(shared_data("ircad01", f"3Dircadb1.1_{name}_mask.nrrd"))
    assert mask.values.shape == (129, 512, 512)
    assert mask.values.dtype == np.uint8
    np.testing.assert_allclose(mask.spacing_mm, [0.57, 0.57, 1.6], rtol=1e-12)
    assert np.array_equal(mask.direction, np.eye(3))
    assert np.count_nonzero(mask.values) == voxels


def test_the_label_map_of_a_ct(shared_data: Callable[..., Path]) -> None:
    labels = read_volume(shared_data("totalsegmentator", "example_seg.nii.gz"))
    assert labels.values.shape == (30, 101, 122)
    assert labels.spacing_mm.tolist() == [3, 3, 3]
    np.testing.assert_allclose(labels.direction, np.diag([-1, -1, 1]), atol=1e-9)
    assert {5, 64} <= set(np.unique(labels.values).tolist())
