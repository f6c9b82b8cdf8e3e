"""Faults that fuzzing found, each by the smallest file that showed it."""

from __future__ import annotations

import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from generator.config import DomainConfig, load
from generator.domains import make_domain
from generator.framework import read_points
from tests.fuzz import seeds
from vascval.core.errors import InputError, VascvalError, printable
from vascval.io.documents import read_reference_table
from vascval.io.trees import read_tree
from vascval.io.volumes import Volume, read_volume


@pytest.fixture(autouse=True)
def _no_warnings() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def changed(data: bytes, old: bytes, new: bytes) -> bytes:
    assert old in data
    return data.replace(old, new, 1)


def given(tmp_path: Path, suffix: str, data: bytes) -> Path:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("size", ["1e160", "-1e308", "1.1e9"])
@pytest.mark.parametrize(("suffix", "old"), [(".swc", b" 5 0 15 3 "), (".vtp", b"5 0 15"), (".vtk", b"5 0 15")])
def test_positions_whose_squares_overflow(tmp_path: Path, suffix: str, old: bytes, size: str) -> None:
    """They gave segments of infinite length."""
    seed = {".swc": seeds.swc()[1].replace(b"um", b"mm"), ".vtp": seeds.vtp()[0], ".vtk": seeds.vtk()[0]}[suffix]
    path = given(tmp_path, suffix, changed(seed, old, old.replace(b"15", size.encode())))
    with pytest.raises(InputError, match=r"position or radius of .* mm, which no vessel has"):
        read_tree(path, unit="mm")


def test_our_own_file_with_such_positions(tmp_path: Path) -> None:
    path = given(tmp_path, ".vtp", seeds.vtp()[1])
    assert read_tree(path).n_segments == 3
    text = (
        '<VTKFile type="PolyData"><PolyData><Piece NumberOfPoints="2" NumberOfLines="1"><Points>'
        '<DataArray type="Float64" NumberOfComponents="3">0 0 0 0 0 {}</DataArray></Points><Lines>'
        '<DataArray type="Int64" Name="connectivity">0 1</DataArray>'
        '<DataArray type="Int64" Name="offsets">2</DataArray>'
        '</Lines><CellData><DataArray type="Int64" Name="parent">-1</DataArray>'
        '<DataArray type="Float64" Name="radius_mm">{}</DataArray></CellData></Piece></PolyData></VTKFile>'
    )
    path.write_text(text.format("9", "1"))
    assert read_tree(path).length_mm.tolist() == [0, 9]
    for far, thick in (("1e160", "1"), ("9", "1e160")):
        path.write_text(text.format(far, thick))
        with pytest.raises(InputError, match="which no vessel has"):
            read_tree(path)


@pytest.mark.parametrize("number", ["nan", "inf", "1e999"])
def test_ids_that_are_not_finite(tmp_path: Path, number: str) -> None:
    """The remainder of infinity warned on the terminal."""
    path = given(tmp_path, ".swc", changed(seeds.swc()[1], b"2 3 0 0 10", f"{number} 3 0 0 10".encode()))
    with pytest.raises(InputError, match="line 3 has a value that is not finite"):
        read_tree(path)


@pytest.mark.parametrize("field", ["endian: {}", "kinds: {}", "centerings: {}", "content: {}", "{}: 1"])
def test_long_fields_of_nrrd(tmp_path: Path, field: str) -> None:
    """The library ended the process when it quoted them; read in a process of its own."""
    path = given(tmp_path, ".nrrd", changed(seeds.nrrd()[0], b"endian: little", field.format("(" * 3000).encode()))
    code = f"from vascval.io.volumes import read_volume; read_volume({str(path)!r})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "characters; it is damaged" in done.stderr.splitlines()[-1]


@pytest.mark.parametrize("text", ["1" * 5000, "1," * 2000 + "1"])
def test_long_words_in_nrrd_of_text(tmp_path: Path, text: str) -> None:
    """The library ended the process."""
    path = given(tmp_path, ".nrrd", changed(seeds.nrrd()[2], b" 3 4 5 ", f" 3 {text} 5 ".encode()))
    with pytest.raises(InputError, match="a value has 64 characters or more"):
        read_volume(path)
    assert np.array_equal(read_volume(given(tmp_path, ".nrrd", seeds.nrrd()[2])).values, seeds.values())


def test_axes_next_to_nothing(tmp_path: Path) -> None:
    """Their determinant was no number, which passed for invertible."""
    matrix = b"1e-320 0 0 1e-320 0 0 0 0 1e-320"
    path = given(tmp_path, ".mha", changed(seeds.mha()[0], b"1 0 0 0 1 0 0 0 1", matrix))
    with pytest.raises(InputError, match="has no inverse"):
        read_volume(path)


@pytest.mark.parametrize("number", ["1" * 5000, "²", "٣", "-3", ""])
@pytest.mark.parametrize("old", [b'NumberOfPoints="4"', b'NumberOfComponents="3"'])
def test_counts_that_python_calls_digits(tmp_path: Path, old: bytes, number: str) -> None:
    new = old.split(b'"')[0] + f'"{number}"'.encode()
    with pytest.raises(InputError, match="an array cannot be decoded"):
        read_tree(given(tmp_path, ".vtp", changed(seeds.vtp()[0], old, new)))


def test_numbers_beyond_single_precision(tmp_path: Path) -> None:
    data = changed(seeds.vtk()[0], b"VECTORS v float\n1 0", b"VECTORS v float\n1e300 0")
    assert read_tree(given(tmp_path, ".vtk", data)).n_segments == 3
    single = changed(seeds.vtp()[0], b'type="Float64" Name="Points"', b'type="Float32" Name="Points"')
    with pytest.raises(InputError, match="1 points are not finite"):
        read_tree(given(tmp_path, ".vtp", changed(single, b"0 0 10", b"0 0 1e300")))
    data = changed(seeds.vtk()[0], b"POINTS 4 double\n0 0 0", b"POINTS 4 float\n0 0 1e300")
    with pytest.raises(InputError, match="1 points are not finite"):
        read_tree(given(tmp_path, ".vtk", data))


@pytest.mark.parametrize(("digits", "said"), [(400, "too large to convert"), (5000, "row 2 is not finite")])
def test_whole_numbers_beyond_double_precision(tmp_path: Path, digits: int, said: str) -> None:
    text = f"x_mm,y_mm,z_mm\n0,0,0\n{'1' * digits},2,3\n"
    with pytest.raises(InputError, match=said):
        read_points(given(tmp_path, ".csv", text.encode()))


@pytest.mark.parametrize("text", [",\n", " ; \n,,\n", "# a\n,\n"])
def test_rows_of_separators_alone(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match="holds no points"):
        read_tree(given(tmp_path, ".swc", text.encode()))


def test_sizes_beyond_all_numbers(tmp_path: Path) -> None:
    path = given(tmp_path, ".nrrd", changed(seeds.nrrd()[1], b"sizes: 4", b"sizes: " + b"9" * 400))
    with pytest.raises(InputError, match=r"voxels need .* GiB"):
        read_volume(path)


@pytest.mark.parametrize("width", ["99999999", "9" * 40, "٣"])
def test_data_file_patterns_of_great_width(tmp_path: Path, width: str) -> None:
    """Each name took as many bytes as the width says, or Python refused."""
    path = given(tmp_path, ".nhdr", changed(seeds.nhdr()[1], b"%03d", f"%{width}d".encode()))
    with pytest.raises(InputError, match=r"data file pattern .* is not understood"):
        read_volume(path)


@pytest.mark.parametrize("field", ["TransformMatrix = 1e308 0 0 0 1", "Offset = 1e308 1e308"])
def test_frames_that_overflow(tmp_path: Path, field: str) -> None:
    old = b"TransformMatrix = 1 0 0 0 1" if "Matrix" in field else b"Offset = 0 0"
    path = given(tmp_path, ".mha", changed(seeds.mha()[0], old, field.encode()))
    with pytest.raises(InputError, match=r"within 1e9 are needed"):
        read_volume(path)
    with pytest.raises(InputError, match=r"within 1e9 are needed"):
        Volume(seeds.values(), np.ones(3), origin_mm=np.array([0, 0, np.inf]))


def test_polygons_of_vertices_beyond_all_numbers(tmp_path: Path) -> None:
    path = given(tmp_path, ".obj", changed(seeds.obj()[0], b"f 2 3 4", b"f 2 3 " + b"9" * 40))
    with pytest.raises(InputError, match="a polygon names a vertex that is not there"):
        make_domain(DomainConfig(file=path))


def test_a_surface_all_of_whose_triangles_are_flat(tmp_path: Path) -> None:
    path = given(tmp_path, ".obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\n" + b"f 1 2 2\n" * 5)
    with pytest.raises(InputError, match="the surface has 0 triangles with an area"):
        make_domain(DomainConfig(file=path))


@pytest.mark.parametrize(
    "value", ["[" * 100_000, "1" * 5000, "{a=" * 20_000], ids=["nested", "digits", "tables"]
)  # fmt: skip
def test_configurations_that_the_parser_gives_up(tmp_path: Path, value: str) -> None:
    path = given(tmp_path, ".toml", changed(seeds.toml()[0], b"seed = 1", f"seed = {value}".encode()))
    with pytest.raises(InputError, match="is no valid TOML"):
        load(str(path))


def test_a_message_is_one_printable_line_of_bounded_length(tmp_path: Path) -> None:
    assert printable("µm, Ärger: 'x'; mend it") == "µm, Ärger: 'x'; mend it"
    assert printable("a\nb\x1b[2J\u202e\udcff") == "a\\nb\\x1b[2J\\u202e\\udcff"
    assert len(printable("x" * 5000)) <= 1000
    assert printable("x" * 5000).endswith("x" * 300)
    assert str(VascvalError("a\tb")) == "a\\tb"
    with pytest.raises(InputError, match=r"is a VTK file with FLOAT\\x1b\[2J"):
        read_tree(given(tmp_path, ".vtk", changed(seeds.vtk()[0], b"POLYDATA", b"FLOAT\x1b[2J")))
    with pytest.raises(InputError, match="unknown column") as caught:
        read_reference_table(given(tmp_path, ".csv", changed(seeds.reference_csv()[0], b"n_segments", b"x" * 9000)))
    assert len(str(caught.value)) <= 1000


def test_a_file_whose_name_has_control_characters(tmp_path: Path) -> None:
    """Its name stands once in the message, escaped."""
    path = tmp_path / "a\x1b[31m\n.vtp"
    path.write_bytes(b"")
    with pytest.raises(InputError) as caught:
        read_tree(path)
    assert str(caught.value) == f"{tmp_path}/a\\x1b[31m\\n.vtp: the file is empty; check how it was written"


def test_an_stl_file_as_short_as_fifty_bytes_less_than_its_header(tmp_path: Path) -> None:
    path = given(tmp_path, ".stl", b"solid".ljust(34, b"\0"))
    with pytest.raises(InputError, match=r"a\.stl: is 34 bytes long where 84 are announced; it is truncated"):
        make_domain(DomainConfig(file=path))
