"""Volumes packed with gzip and NIfTI: read slice by slice, their own values, refused when damaged."""

from __future__ import annotations

import gzip
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from scan_files import WRITERS, refused, sample, write_image, write_nrrd

from vascval.core.errors import InputError
from vascval.io.scans import open_scan
from vascval.io.volumes import Volume, read_volume


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
