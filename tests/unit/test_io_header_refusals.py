"""Headers that say what cannot be, and outputs whose place is taken."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from vascval.core.errors import ComputationError, InputError
from vascval.io.atomic import atomic_directory
from vascval.io.header_checks import stacked
from vascval.io.image_headers import read_header
from vascval.io.stored_arrays import leading_ones, require_numbers
from vascval.io.tables import write_table
from vascval.io.volumes import read_volume

NRRD = "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 4 3 2\nspacings: 1 2 3\nencoding: raw\nendian: little\n"
VALUES = np.arange(24, dtype=np.uint8)


def test_comments_and_texts_of_nrrd(tmp_path: Path) -> None:
    text = NRRD + "# a comment: of no matter\nsaid:=one\\ntwo\n\n"
    (tmp_path / "a.nrrd").write_bytes(text.encode() + VALUES.tobytes())
    volume = read_volume(tmp_path / "a.nrrd")
    assert volume.values.ravel().tolist() == VALUES.tolist()
    assert volume.spacing_mm.tolist() == [1, 2, 3]
    assert read_header(tmp_path / "a.nrrd").texts["said"] == "one\ntwo"


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("sizes: 4 3 2", "sizes 4 3 2", "line 4 of the NRRD header is no field"),
        ("encoding: raw", "encoding: bzip2", "the encoding 'bzip2' of the NRRD is not read"),
        ("spacings: 1 2 3", "spacings: 1 two 3", "the spacing is no list of numbers"),
        ("spacings: 1 2 3", "spacings: 1 nan 3", "the spacing .* is absurd"),
        ("encoding: raw", "encoding: hex", "bytes|truncated|damaged"),
        ("encoding: raw", "encoding: txt", "bytes|truncated|damaged"),
    ],
)  # fmt: skip
def test_damaged_nrrd(tmp_path: Path, old: str, new: str, match: str) -> None:
    (tmp_path / "a.nrrd").write_bytes((NRRD.replace(old, new) + "\n").encode() + VALUES.tobytes())
    with pytest.raises(InputError, match=match):
        read_volume(tmp_path / "a.nrrd")


@pytest.mark.parametrize("endian", ["<", ">"])
@pytest.mark.parametrize(
    ("at", "code", "value", "match"),
    [(40, "h", 9, "claims 9 axes"), (40, "h", 0, "claims 0 axes"), (72, "h", 0, "of 0 bits"),
     (344, "3s", b"ni1", "detached NIfTI header; convert it")],
)  # fmt: skip
def test_damaged_nifti(tmp_path: Path, endian: str, at: int, code: str, value: object, match: str) -> None:
    head = bytearray(400)
    struct.pack_into(endian + "i", head, 0, 348)
    struct.pack_into(endian + "8h", head, 40, 3, 4, 3, 2, 1, 1, 1, 1)
    struct.pack_into(endian + "h", head, 72, 8)
    head[344:347] = b"n+1"
    struct.pack_into(endian + code, head, at, value)
    (tmp_path / "a.nii").write_bytes(head)
    with pytest.raises(InputError, match=match):
        read_volume(tmp_path / "a.nii")


def test_nifti_under_another_suffix(tmp_path: Path) -> None:
    head = bytearray(400)
    struct.pack_into("<i", head, 0, 348)
    head[344:347] = b"n+1"
    (tmp_path / "a.img").write_bytes(head)
    with pytest.raises(InputError, match=r"holds NIfTI under another suffix; rename it to \.nii"):
        read_volume(tmp_path / "a.img")


def test_arrays_that_are_no_volumes() -> None:
    path = Path("a.h5")
    require_numbers(path, np.dtype("int64"))
    for bad in ("complex64", "S3", "longdouble", "datetime64[s]"):
        with pytest.raises(InputError, match="whole or real numbers of up to 64 bits are needed"):
            require_numbers(path, np.dtype(bad))
    assert [leading_ones(path, shape) for shape in ((2, 3, 4), (1, 2, 3, 4), (1, 1, 2, 3, 4))] == [0, 1, 2]
    for shape in ((3, 4), (2, 2, 3, 4)):
        with pytest.raises(InputError, match="three axes z, y, x are needed"):
            leading_ones(path, shape)
    with pytest.raises(InputError, match="an array of 2 x 0 x 4; there is nothing in it"):
        leading_ones(path, (2, 0, 4))
    assert stacked([None, None]) is None


def test_a_folder_where_a_file_belongs(tmp_path: Path) -> None:
    """Nothing is moved then; folders of one name are merged."""
    target = tmp_path / "out"
    (target / "table.csv").mkdir(parents=True)
    (target / "parts").mkdir()
    (target / "parts" / "old").write_text("old")

    def fill(name: str) -> None:
        with atomic_directory(target) as aside:
            (aside / "parts").mkdir()
            (aside / "parts" / "new").write_text("new")
            (aside / name).write_text("x")

    with pytest.raises(InputError, match=r"table\.csv: is a folder where a file belongs; move it away"):
        fill("table.csv")
    assert [item.name for item in (target / "parts").iterdir()] == ["old"]
    fill("other.csv")
    assert sorted(item.name for item in (target / "parts").iterdir()) == ["new", "old"]
    (target / "parts2").write_text("a file")
    with (
        pytest.raises(InputError, match="parts2: is a file where a folder belongs"),
        atomic_directory(target) as aside,
    ):
        (aside / "parts2").mkdir()
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="is a file; give the name of a folder"), atomic_directory(tmp_path / "file"):
        pass
    assert sorted(item.name for item in tmp_path.iterdir()) == ["file", "out"]


def test_tables_of_infinite_values_are_not_written(tmp_path: Path) -> None:
    frame = pd.DataFrame({"a": [1.0, np.nan, np.inf], "b": [1, 2, 3]})
    with pytest.raises(ComputationError, match=r"1 values of a are infinite \(first: row 3\)"):
        write_table(frame, tmp_path / "a.csv")
    assert list(tmp_path.iterdir()) == []
