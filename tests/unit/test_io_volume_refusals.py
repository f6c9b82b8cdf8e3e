"""Every image that is not read: one line, the file, what is wrong, the remedy; and nothing printed by a library."""

from __future__ import annotations

import gzip
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk

from vascval.core.errors import InputError
from vascval.io.volumes import Volume, read_volume, write_volume

NRRD = (
    "NRRD0004\ntype: {type}\ndimension: {dimension}\nsizes: {sizes}\nspacings: {spacings}\n"
    "encoding: {encoding}\nendian: little\n"
)


def nrrd(path: Path, data: bytes = b"", *, extra: str = "", **fields: str) -> Path:
    given = {"type": "uchar", "dimension": "3", "sizes": "4 3 2", "spacings": "1 1 1", "encoding": "raw", **fields}
    path.write_bytes((NRRD.format(**given) + extra + "\n").encode() + data)
    return path


def refused(path: Path, capfd: pytest.CaptureFixture[str], match: str, **options: object) -> None:
    with pytest.raises(InputError, match=match) as caught:
        read_volume(path, **options)  # type: ignore[arg-type]
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    assert ";" in message, "a remedy follows what is wrong"
    assert capfd.readouterr() == ("", "")


def sample(dtype: str = "uint8") -> np.ndarray:
    return np.random.default_rng(1).integers(0, 250, (30, 31, 32)).astype(dtype)


def test_missing_empty_and_folder(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    refused(tmp_path / "no.nrrd", capfd, "no such file")
    (tmp_path / "empty.nrrd").write_bytes(b"")
    refused(tmp_path / "empty.nrrd", capfd, "the file is empty")
    (tmp_path / "folder").mkdir()
    refused(tmp_path / "folder", capfd, "holds no TIFF slices")


@pytest.mark.parametrize(
    "content",
    [b"hello\n" * 100, b"\x89PNG\r\n\x1a\n" + bytes(500), bytes(1000), b"\x1f\x8b" + bytes(400), b"# vtk DataFile\n"],
)
def test_a_foreign_file(tmp_path: Path, capfd: pytest.CaptureFixture[str], content: bytes) -> None:
    path = tmp_path / "a.nrrd"
    path.write_bytes(content)
    refused(path, capfd, "is no image that can be read")


@pytest.mark.parametrize("suffix", [".nrrd", ".nii", ".nii.gz", ".mha", ".tif"])
@pytest.mark.parametrize("kept", [0.02, 0.3, 0.6, 0.98])
def test_a_truncated_file(tmp_path: Path, capfd: pytest.CaptureFixture[str], suffix: str, kept: float) -> None:
    path = tmp_path / f"a{suffix}"
    sitk.WriteImage(sitk.GetImageFromArray(sample()), str(path))
    whole = path.read_bytes()
    path.write_bytes(whole[: int(kept * len(whole))])
    refused(path, capfd, "truncated|damaged|no image|no spacing", spacing_mm=(1, 1, 1))


@pytest.mark.parametrize("suffix", [".nrrd", ".nii.gz", ".mha"])
def test_a_truncated_compressed_file(tmp_path: Path, capfd: pytest.CaptureFixture[str], suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    write_volume(Volume(sample(), np.ones(3)), path)
    whole = path.read_bytes()
    for kept in (len(whole) // 2, len(whole) - 20):
        path.write_bytes(whole[:kept])
        refused(path, capfd, "truncated|damaged")


@pytest.mark.parametrize("suffix", [".nrrd", ".nii.gz", ".mha"])
def test_a_flipped_byte_in_compressed_data(tmp_path: Path, capfd: pytest.CaptureFixture[str], suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    write_volume(Volume(sample(), np.ones(3)), path)
    whole = bytearray(path.read_bytes())
    whole[len(whole) // 2] ^= 0xFF
    path.write_bytes(bytes(whole))
    refused(path, capfd, "damaged")


@pytest.mark.parametrize("suffix", [".nrrd", ".nii", ".mha", ".tif"])
def test_two_axes(tmp_path: Path, capfd: pytest.CaptureFixture[str], suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    sitk.WriteImage(sitk.GetImageFromArray(sample()[0]), str(path))
    refused(path, capfd, "is a flat image of 32 x 31", spacing_mm=(1, 1, 1))


@pytest.mark.parametrize("suffix", [".nrrd", ".nii", ".mha"])
def test_four_axes_and_a_fourth_of_size_one(tmp_path: Path, capfd: pytest.CaptureFixture[str], suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    frames = np.stack([sample(), sample()])
    sitk.WriteImage(sitk.GetImageFromArray(frames, isVector=False), str(path))
    refused(path, capfd, "is an image of 32 x 31 x 30 x 2 voxels; three axes are needed")
    if suffix == ".nii":
        return  # the writer drops the axis itself
    sitk.WriteImage(sitk.GetImageFromArray(frames[:1], isVector=False), str(path))
    volume = read_volume(path)
    assert np.array_equal(volume.values, sample())
    assert volume.meta["notes"] == ["trailing axes of size 1 dropped from 32 x 31 x 30 x 1"]


def test_nifti_with_a_fourth_axis_of_size_one(tmp_path: Path) -> None:
    path = tmp_path / "a.nii"
    write_volume(Volume(sample(), np.ones(3)), path)
    head = bytearray(path.read_bytes())
    struct.pack_into("<8h", head, 40, 4, 32, 31, 30, 1, 1, 1, 1)
    path.write_bytes(bytes(head))
    assert np.array_equal(read_volume(path).values, sample())


@pytest.mark.parametrize("suffix", [".nrrd", ".nii", ".mha", ".tif"])
def test_several_values_per_voxel(tmp_path: Path, capfd: pytest.CaptureFixture[str], suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    rgb = np.stack([sample()] * 3, axis=-1)
    sitk.WriteImage(sitk.GetImageFromArray(rgb, isVector=True), str(path))
    refused(path, capfd, "has 3 values per voxel", spacing_mm=(1, 1, 1))


@pytest.mark.parametrize("suffix", [".nrrd", ".mha"])
def test_complex_values(tmp_path: Path, capfd: pytest.CaptureFixture[str], suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    sitk.WriteImage(sitk.GetImageFromArray(sample("complex64")), str(path))
    refused(path, capfd, "has complex values|2 values per voxel")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite(tmp_path: Path, capfd: pytest.CaptureFixture[str], value: float) -> None:
    values = sample("float32")
    values[3, 4, 5] = value
    write_volume(Volume(values, np.ones(3)), tmp_path / "a.nrrd")
    refused(tmp_path / "a.nrrd", capfd, r"voxel \(5, 4, 3\) is -?(nan|inf)")


@pytest.mark.parametrize(
    "spacings",
    ["0 1 1", "-1 1 1", "nan 1 1", "inf 1 1", "1e-300 1 1", "2000 2000 2000", "1 1 1001", "1e300 1e300 1e300"],
)
def test_absurd_spacing(tmp_path: Path, capfd: pytest.CaptureFixture[str], spacings: str) -> None:
    refused(nrrd(tmp_path / "a.nrrd", bytes(24), spacings=spacings), capfd, "spacing|truncated or damaged")


def test_absurd_spacing_in_nifti_and_meta_image(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_volume(Volume(sample(), np.ones(3)), tmp_path / "a.nii")
    for value in (0.0, float("nan"), float("inf"), -1e30, 1e30):
        head = bytearray((tmp_path / "a.nii").read_bytes())
        struct.pack_into("<f", head, 80, value)
        struct.pack_into("<hh", head, 252, 0, 0)  # without the transforms, which would override the spacing
        (tmp_path / "b.nii").write_bytes(bytes(head))
        refused(tmp_path / "b.nii", capfd, "spacing .* is absurd")
    for text in ("0 1 1", "nan 1 1", "1 1 1e9"):
        path = tmp_path / "a.mha"
        path.write_bytes(
            f"ObjectType = Image\nNDims = 3\nElementSpacing = {text}\nDimSize = 4 3 2\n"
            "ElementType = MET_UCHAR\nElementDataFile = LOCAL\n".encode()
            + bytes(24)
        )
        refused(path, capfd, "spacing .* is absurd|truncated or damaged")


@pytest.mark.parametrize(
    ("tag", "value", "match"),
    [(254, 1, "page 1 of the TIFF is a thumbnail or a mask"), (256, 9, "page 1 of the TIFF differs from page 0"),
     (258, 12, "tags of page 1 of the TIFF do not fit"), (273, 10**6, "page 2 of the TIFF is not all there"),
     (278, 3, "tags of page 1 of the TIFF do not fit"), (279, 5, "tags of page 1 of the TIFF do not fit")],
)  # fmt: skip
def test_tiff_pages_that_do_not_fit(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], tag: int, value: int, match: str
) -> None:
    """The library writes beyond its buffers for some of these."""
    path = tmp_path / "a.tif"
    sitk.WriteImage(sitk.GetImageFromArray(sample()), str(path))
    content = bytearray(path.read_bytes())
    first = struct.unpack_from("<I", content, 4)[0]
    n_tags = struct.unpack_from("<H", content, first)[0]
    second = struct.unpack_from("<I", content, first + 2 + 12 * n_tags)[0]
    at = next(i for i in range(second + 2, second + 200, 12) if struct.unpack_from("<H", content, i)[0] == tag)
    kind = struct.unpack_from("<H", content, at + 2)[0]
    struct.pack_into("<H" if kind == 3 else "<I", content, at + 8, value)
    path.write_bytes(bytes(content))
    refused(path, capfd, match, spacing_mm=(1, 1, 1))


def test_no_spacing_asks_for_it(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = nrrd(tmp_path / "a.nrrd", bytes(24))
    path.write_bytes(path.read_bytes().replace(b"spacings: 1 1 1\n", b""))
    refused(path, capfd, "gives no spacing in three dimensions; use --spacing")
    assert read_volume(path, spacing_mm=(1, 2, 3)).spacing_mm.tolist() == [1, 2, 3]
    sitk.WriteImage(sitk.GetImageFromArray(sample()), str(tmp_path / "a.tif"))
    refused(tmp_path / "a.tif", capfd, "TIFF gives no spacing in three dimensions; use --spacing")
    with pytest.raises(InputError, match="is not three numbers"):
        read_volume(path, spacing_mm=(1, 2))


@pytest.mark.parametrize(
    "sizes",
    ["100000 100000 100000", "4294967296 4294967296 4294967296", "9223372036854775807 3 3", "1" + "0" * 40 + " 1 1"],
)
def test_more_than_memory_allows_is_said_before_reading(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], sizes: str
) -> None:
    path = nrrd(tmp_path / "a.nrrd", gzip.compress(bytes(24)), sizes=sizes, encoding="gzip")
    refused(path, capfd, r"voxels need .* GiB, .* GiB are allowed; crop")
    meta = tmp_path / "a.mha"
    meta.write_text(
        f"ObjectType = Image\nNDims = 3\nElementSpacing = 1 1 1\nDimSize = {sizes}\nCompressedData = True\n"
        "ElementType = MET_UCHAR\nElementDataFile = LOCAL\n"
    )
    refused(meta, capfd, r"voxels need .* GiB, .* GiB are allowed; crop")


def test_the_memory_allowed_is_a_parameter(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.nrrd"
    write_volume(Volume(sample("uint16"), np.ones(3)), path)
    refused(path, capfd, "32 x 31 x 30 voxels need", max_memory_bytes=2 * 32 * 31 * 30 - 1)
    assert read_volume(path, max_memory_bytes=2 * 32 * 31 * 30).values.dtype == np.uint16


@pytest.mark.parametrize("sizes", ["0 3 2", "-4 3 2", "4 three 2", "", "4 3"])
def test_damaged_sizes(tmp_path: Path, capfd: pytest.CaptureFixture[str], sizes: str) -> None:
    refused(nrrd(tmp_path / "a.nrrd", bytes(24), sizes=sizes), capfd, "damaged")


@pytest.mark.parametrize(
    ("old", "new"),
    [("NDims = 3", "NDims = 700"), ("NDims = 3", "NDims = 2"), ("NDims = 3", "NDims = 3\nNDims = 700"),
     ("ElementSpacing = 1 1 1", "ElementSpacing = 1 1 1 1"), ("ElementSpacing = 1 1 1", "ElementSpacing = 1 x 1"),
     ("DimSize = 4 3 2", "DimSize = 4 3 2 1 1 1 1 1 1 1 1 1 1"), ("NDims = 3", "NDims = 3\nTransformMatrix = 1 0"),
     ("NDims = 3", "NDims = 3\nHeaderSize = 9 9"), ("NDims = 3\n", "")],
)  # fmt: skip
def test_meta_image_headers_that_do_not_add_up(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], old: str, new: str
) -> None:
    path = tmp_path / "a.mha"
    header = (
        "ObjectType = Image\nNDims = 3\nElementSpacing = 1 1 1\nDimSize = 4 3 2\n"
        "ElementType = MET_UCHAR\nElementDataFile = LOCAL\n"
    )
    path.write_bytes(header.encode() + bytes(24))
    assert read_volume(path).values.shape == (2, 3, 4)
    path.write_bytes(header.replace(old, new).encode() + bytes(24))
    refused(path, capfd, "damaged")


def _mhd(path: Path, data_file: str) -> None:
    path.write_text(
        "ObjectType = Image\nNDims = 3\nElementSpacing = 1 1 1\nDimSize = 4 3 2\n"
        f"ElementType = MET_UCHAR\nElementDataFile = {data_file}\n"
    )


def _nhdr(path: Path, data_file: str) -> None:
    nrrd(path, extra=f"data file: {data_file}\n")


WRITERS: dict[str, Callable[[Path, str], None]] = {".nhdr": _nhdr, ".mhd": _mhd}


@pytest.mark.parametrize("suffix", WRITERS)
@pytest.mark.parametrize(
    "name", ["{outside}", "../secret.raw", "sub/../../secret.raw", "link.raw", "LIST\n{outside}", "LIST\n../secret.raw",
             "../s%03d.raw 1 2 1", "linked/secret.raw", "C:\\secret.raw", "..\\secret.raw"],
)  # fmt: skip
def test_a_detached_header_may_not_point_outside_its_folder(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], suffix: str, name: str
) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    (tmp_path / "secret.raw").write_bytes(bytes(24))
    (folder / "link.raw").symlink_to(tmp_path / "secret.raw")
    (folder / "linked").symlink_to(tmp_path)
    header = folder / f"a{suffix}"
    WRITERS[suffix](header, name.format(outside=tmp_path / "secret.raw"))
    refused(header, capfd, "lies outside its folder")


@pytest.mark.parametrize("suffix", WRITERS)
def test_a_detached_header_without_its_data(tmp_path: Path, capfd: pytest.CaptureFixture[str], suffix: str) -> None:
    WRITERS[suffix](tmp_path / f"a{suffix}", "a.raw")
    refused(tmp_path / f"a{suffix}", capfd, "its data file 'a.raw' is missing")
    (tmp_path / "a.raw").write_bytes(bytes(23))
    refused(tmp_path / f"a{suffix}", capfd, "holds 23 bytes of 24; it is truncated")
    (tmp_path / "a.raw").write_bytes(bytes(24))
    assert read_volume(tmp_path / f"a{suffix}").values.shape == (2, 3, 4)
    WRITERS[suffix](tmp_path / f"a{suffix}", "a" * 600)
    refused(tmp_path / f"a{suffix}", capfd, "its data file 'a+' is missing")


@pytest.mark.parametrize(
    "pattern", ["s%s.raw 1 2 1", "s%03d%d.raw 1 2 1", "s%d.raw 1 2 0", "s%d.raw 1 99999999999 1", "%n"]
)
@pytest.mark.parametrize("suffix", WRITERS)
def test_odd_data_file_patterns(tmp_path: Path, capfd: pytest.CaptureFixture[str], suffix: str, pattern: str) -> None:
    WRITERS[suffix](tmp_path / f"a{suffix}", pattern)
    refused(tmp_path / f"a{suffix}", capfd, "data file pattern")


def test_unknown_axis_units(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = nrrd(tmp_path / "a.nrrd", bytes(24), extra='units: "furlong" "furlong" "furlong"\n')
    refused(path, capfd, r"the axes have units \['furlong'\]")


def test_slices_that_do_not_make_a_stack(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for number in (1, 2, 4):
        sitk.WriteImage(sitk.GetImageFromArray(sample()[number]), str(tmp_path / f"s{number}.tif"))
    refused(tmp_path, capfd, "slice 3 is missing between 1 and 4", spacing_mm=(1, 1, 1))
    sitk.WriteImage(sitk.GetImageFromArray(sample()[3, :5]), str(tmp_path / "s3.tif"))
    refused(tmp_path, capfd, "slice s3.tif has 32 x 5 pixels", spacing_mm=(1, 1, 1))
    sitk.WriteImage(sitk.GetImageFromArray(sample()[3]), str(tmp_path / "s3.tif"))
    (tmp_path / "s03.tif").write_bytes(b"")
    refused(tmp_path, capfd, "s03.tif and s3.tif are one slice", spacing_mm=(1, 1, 1))
    (tmp_path / "s03.tif").rename(tmp_path / "x.tif")
    refused(tmp_path, capfd, "slice x.tif has no number", spacing_mm=(1, 1, 1))


@pytest.mark.parametrize("name", ["a.png", "a.nhdr", "a", "a.raw"])
def test_volumes_are_not_written_under_other_suffixes(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"volumes are written as .nrrd"):
        write_volume(Volume(sample(), np.ones(3)), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_types_that_images_do_not_have(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="values of type float16 have no place in an image"):
        write_volume(Volume(sample("float16"), np.ones(3)), tmp_path / "a.nrrd")
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_written_into_a_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"folder .*none does not exist; make it first"):
        write_volume(Volume(sample(), np.ones(3)), tmp_path / "none" / "a.nrrd")


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"values": np.zeros((2, 2))}, r"shape \(2, 2\) is no volume"),
        ({"spacing_mm": [0, 1, 1]}, "is absurd"),
        ({"spacing_mm": [1, 1]}, "spacing_mm is"),
        ({"origin_mm": [np.nan, 0, 0]}, "origin_mm is"),
        ({"direction": np.zeros((3, 3))}, "has no inverse"),
    ],
)
def test_a_volume_refuses_what_is_none(changes: dict[str, object], match: str) -> None:
    with pytest.raises(InputError, match=match):
        Volume(**{"values": np.zeros((2, 2, 2)), "spacing_mm": np.ones(3), **changes})  # type: ignore[arg-type]
