"""Arrays of VTK files, byte by byte: LZ4 blocks, encoded arrays of XML files, sections of legacy files."""

from __future__ import annotations

import base64
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from vascval.core.errors import InputError
from vascval.io._lz4_kernels import unpack
from vascval.io.vtk_legacy import read_legacy
from vascval.io.vtp_arrays import Damaged, Encoding, decode, whole

# --- LZ4 ------------------------------------------------------------------------------------------------------------


def lz4(packed: bytes, room: int) -> bytes | None:
    target = np.zeros(room, dtype=np.uint8)
    size = unpack(np.frombuffer(packed, dtype=np.uint8), target)
    return None if size < 0 else target[:size].tobytes()


def test_lz4_by_hand() -> None:
    many = bytes(range(256)) + bytes(59)
    assert lz4(b"\x50hello", 5) == b"hello"
    assert lz4(b"\xf0\xff\x2d" + many, 400) == many  # 15 + 255 + 45 literals
    assert lz4(b"\x1fa\x01\x00\xff\x03\x50hello", 283) == b"a" * 278 + b"hello"  # 1 + (15 + 255 + 3 + 4) copies
    assert lz4(b"\x31abc\x02\x00\x10.", 9) == b"abcbcbcb."  # five from two back
    assert lz4(b"\x00", 9) == b""


@pytest.mark.parametrize(
    "packed",
    [
        b"", b"\xf0", b"\xf0\xff", b"\xf0\x00abc", b"\x50hell", b"\x1fa\x01", b"\x1fa\x01\x00", b"\x1fa\x01\x00\xff",
        b"\x10a\x00\x00\x10b", b"\x10a\x02\x00\x10b", b"\x50hello\x01\x00\x60world!", b"\xf0\xff\x2d" + bytes(315),
    ],
)  # fmt: skip
def test_damaged_lz4(packed: bytes) -> None:
    """Nothing at all; cut in lengths, literals, offsets; copies from nowhere; more than there is room for."""
    assert lz4(packed, 12) is None


# --- arrays of XML files --------------------------------------------------------------------------------------------


def encoding(compressor: str = "", appended: bytes = b"", raw: bool = True) -> Encoding:
    return Encoding("<", "I", compressor, memoryview(appended), raw)


def base(*counts: int, after: bytes = b"") -> str:
    return base64.b64encode(struct.pack(f"<{len(counts)}I", *counts) + after).decode()


def blocks(*counts: int, data: bytes = b"") -> str:
    """A header of its own and the blocks after it."""
    return base(*counts) + base64.b64encode(data).decode()


FLOATS = {"type": "Float32", "format": "binary"}
BYTES = {"type": "UInt8", "format": "binary"}
ZLIB, LZ4 = "vtkZLibDataCompressor", "vtkLZ4DataCompressor"


def test_arrays_by_hand() -> None:
    assert decode(encoding(), FLOATS, base(8, after=struct.pack("<2f", 1.5, -2))).tolist() == [1.5, -2]
    assert decode(encoding(), FLOATS, "").tolist() == []
    assert decode(encoding(ZLIB), FLOATS, "").tolist() == []
    assert decode(encoding(ZLIB), BYTES, base(0)).tolist() == []
    packed = [zlib.compress(b"abcd"), zlib.compress(b"ef")]
    text = blocks(2, 4, 2, len(packed[0]), len(packed[1]), data=b"".join(packed))
    assert decode(encoding(ZLIB), BYTES, text).tobytes() == b"abcdef"
    full = blocks(1, 4, 0, len(packed[0]), data=packed[0])  # 0 for a last block as long as the others
    assert decode(encoding(ZLIB), BYTES, full).tobytes() == b"abcd"
    appended = struct.pack("<I", 3) + b"xyz" + struct.pack("<I", 2) + b"uv"
    place = {"type": "UInt8", "format": "appended", "offset": "7", "NumberOfComponents": "2"}
    assert decode(encoding(appended=appended), place, "").tolist() == [[ord("u"), ord("v")]]


@pytest.mark.parametrize(
    ("compressor", "attributes", "text", "match"),
    [
        ("", {"type": "Float128"}, "1", "type 'Float128'"), ("", {}, "1", "type ''"),
        ("", {"type": "Int8", "format": "hex"}, "1", "format 'hex'"),
        ("", {"type": "Int8", "format": "appended", "offset": "7"}, "", "offset of 7"),
        ("", {"type": "Int8", "format": "appended", "offset": "-1"}, "", "offset is '-1'"),
        ("", FLOATS, base(5, after=b"abcde"), "5 bytes for values of 4"),
        ("", FLOATS, base(400, after=b"abcd"), "404 bytes where"),
        ("", FLOATS, "????????", "(?i)base64"),
        ("", {"type": "Int8", "NumberOfComponents": "0"}, "1 2", "2 values for 0 components"),
        ("", {"type": "Int8", "NumberOfComponents": "3"}, "1 2 3 4", "4 values for 3 components"),
        ("", {"type": "Int8", "NumberOfComponents": "x"}, "1 2", "NumberOfComponents is 'x'"),
        (ZLIB, BYTES, base(1 << 30), "1073741824 blocks"),
        (ZLIB, BYTES, blocks(1, 4, 0, 900, data=b"abc"), "1 blocks of 4 bytes, the last 0, in 900"),
        (ZLIB, BYTES, blocks(1, 4, 5, 3, data=b"abc"), "the last 5"),
        (ZLIB, BYTES, blocks(1, 1 << 20, 0, 3, data=b"abc"), "a block of 1048576 bytes in 3"),
        (ZLIB, BYTES, blocks(1, 9, 0, 12, data=zlib.compress(b"abcd")), "a block of 4 bytes for 9"),
        (ZLIB, BYTES, blocks(1, 9, 0, 3, data=b"abc"), "header"),
        ("vtkOddCompressor", BYTES, blocks(1, 9, 0, 3, data=b"abc"), "the compressor 'vtkOddCompressor'"),
        (LZ4, BYTES, blocks(1, 9, 0, 6, data=b"\x50hello"), "an LZ4 block that is cut short"),
    ],
)  # fmt: skip
def test_damaged_arrays(compressor: str, attributes: dict[str, str], text: str, match: str) -> None:
    with pytest.raises(Damaged, match=match):
        decode(encoding(compressor), attributes, text)


@pytest.mark.parametrize("text", ["", "1.0", "+1", "²", "1" * 19])
def test_what_is_no_whole_number(text: str) -> None:
    assert whole(" 12 ", "n") == 12
    with pytest.raises(Damaged, match="n is "):
        whole(text, "n")


# --- sections of legacy files ---------------------------------------------------------------------------------------

HEAD = "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 4 double\n0 0 0 0 0 10 5 0 15 -5 0 15\n"
LINES = "LINES 3 9\n2 0 1\n2 1 2\n2 1 3\n"


def legacy(tmp_path: Path, text: str | bytes) -> Path:
    path = tmp_path / "a.vtk"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_every_section(tmp_path: Path) -> None:
    sections = (
        "METADATA\nINFORMATION 0\n\n" + LINES + "CELL_DATA 3\nSCALARS radius double\n2 1 0.5\nSCALARS mask bit 1\n"
        "LOOKUP_TABLE default\n1 0 1\nTEXTURE_COORDINATES uv 2 float\n0 1 2 3 4 5\nCOLOR_SCALARS rgb 3\n"
        "0 0 0 1 1 1 .5 .5 .5\nLOOKUP_TABLE table 2\n0 0 0 1 1 1 1 1\nSCALARS pair int 2\nLOOKUP_TABLE table\n"
        "1 2 3 4 5 6\nFIELD FieldData 4\nnames 1 2 string\nfirst\nsecond\nids 1 3 long\n7 8 9\n"
        "METADATA\nINFORMATION 0\n\nmore 2 3 float\n1 2 3 4 5 6\nsaid%20by 1 1 string\na%20text\n"
        "POINT_DATA 4\nVECTORS v float\n0 1 2 3 4 5 6 7 8 9 10 11\n"
    )
    data = read_legacy(legacy(tmp_path, HEAD + sections))
    cells = {name: values.tolist() for name, values in data.cell_data.items()}
    assert cells == {
        "radius": [2, 1, 0.5], "mask": [1, 0, 1], "uv": [[0, 1], [2, 3], [4, 5]], "pair": [[1, 2], [3, 4], [5, 6]],
        "ids": [7, 8, 9], "more": [[1, 2], [3, 4], [5, 6]],
    }  # fmt: skip
    assert data.point_data["v"].tolist() == np.arange(12.0).reshape(4, 3).tolist()
    assert data.texts == {"said by": "a text"}
    assert data.connectivity.tolist() == [0, 1, 1, 2, 1, 3]
    assert data.offsets.tolist() == [0, 2, 4, 6]


@pytest.mark.parametrize(
    ("size", "begin"), [(1, b"\xc5"), (2, b"\x80\x05"), (4, b"\x40\0\0\x05"), (8, bytes(7) + b"\5")]
)
def test_binary_sections(tmp_path: Path, size: int, begin: bytes) -> None:
    """Bits are packed, colours are bytes, the length of a text takes one, two, four or eight."""
    assert len(begin) == size
    content = (
        HEAD.split("POINTS")[0].replace("ASCII", "BINARY").encode()
        + b"POINTS 4 float\n" + np.arange(12, dtype=">f4").tobytes()
        + b"\nLINES 3 9\n" + np.array([2, 0, 1, 2, 1, 2, 2, 1, 3], ">i4").tobytes()
        + b"\nCELL_DATA 3\nSCALARS mask bit 1\nLOOKUP_TABLE default\n" + np.packbits([1, 0, 1]).tobytes()
        + b"\nCOLOR_SCALARS rgb 3\n" + bytes(9) + b"\nLOOKUP_TABLE t 2\n" + bytes(8)
        + b"\nFIELD FieldData 1\nunits 1 1 string\n" + begin + b"about\n"
    )  # fmt: skip
    data = read_legacy(legacy(tmp_path, content))
    assert data.cell_data["mask"].tolist() == [1, 0, 1]
    assert data.points.ravel().tolist() == list(range(12))
    assert data.texts == {"units": "about"}
    for kept in (len(content) - 2, len(content) - 6 - size):  # the text is cut, or all of it is missing
        with pytest.raises(InputError, match="a text is not all there"):
            read_legacy(legacy(tmp_path, content[:kept]))


@pytest.mark.parametrize(
    ("sections", "match"),
    [
        ("LINES 4 6\nOFFSETS vtktypeint64\n0 2 4 6\nRADII vtktypeint64\n0 1 1 2 1 3\n", "offsets without connectivity"),
        ("LINES 4 9\n2 0 1 2 1 2 2 1 3\n", "cell 3 of 4 is not all there"),
        ("LINES 3 9\n2 0 1 -2 1 2 2 1 3\n", "cell 1 of 3 is not all there"),
        ("LINES 2 9\n2 0 1 2 1 2 2 1 3\n", "2 cells take 6 numbers, not 9"),
        (LINES + "CELL_DATA 3\nODD_THINGS radius double\n1 2 3\n", "unknown keyword 'ODD_THINGS'"),
        (LINES + "CELL_DATA 3\nSCALARS radius quad\n1 2 3\n", "unknown type 'quad'"),
        (LINES + "CELL_DATA 3\nSCALARS radius\n1 2 3\n", "is cut short"),
        (LINES + "CELL_DATA 3\nSCALARS radius double\n1 22.5\n", "2 of 3 values"),
        (LINES + "CELL_DATA 3\nSCALARS radius double\n1\n", "3 values where 2 bytes are left"),
        (LINES + "CELL_DATA three\n", "'CELL_DATA three' in"),
    ],
)  # fmt: skip
def test_damaged_sections(tmp_path: Path, sections: str, match: str) -> None:
    with pytest.raises(InputError, match=match):
        read_legacy(legacy(tmp_path, HEAD + sections))
