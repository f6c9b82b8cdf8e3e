"""How one file becomes another that is nearly sound."""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence

import numpy as np

LONGEST = 1 << 16
_NUMBERS = (
    b"0", b"-1", b"1", b"2", b"3", b"127", b"255", b"256", b"32768", b"65536", b"2147483647", b"2147483648",
    b"-2147483649", b"4294967295", b"4294967296", b"9223372036854775807", b"9223372036854775808",
    b"-9223372036854775808", b"18446744073709551616", b"1" + b"0" * 40, b"9" * 400, b"1" * 5000, b"1e308",
    b"-1e308", b"1e309", b"1e-320", b"1e160", b"1.5", b"0.1", b"nan", b"-nan", b"inf", b"-inf", b"Infinity",
    b"NaN", b"0x10", b"1_000", b"1e", b"+1", b"--1", b"", "٣".encode(), "²".encode(), b"1,5", b"true", b"1j",
)  # fmt: skip
_TOKENS = (
    b"\0", b"\n", b"\r", b"\r\n", b" ", b"\t", b"\x0b", b"\x1c", "\u2028".encode(), b"\xff\xfe", b"\xfe\xff",
    b"\xef\xbb\xbf", b"\xff", b"\xc3\x28", b"\x1b[2J", "\u202e".encode(), b"#", b";", b",", b":", b"=", b":=",
    b"\"", b"'", b"<", b">", b"&", b"&amp;", b"&#0;", b"&#x41;", b"&lol;", b"<!DOCTYPE a [<!ENTITY b 'c'>]>",
    b"<!--", b"-->", b"<![CDATA[", b"]]>", b"<?xml version='1.1'?>", b"<a>", b"</a>", b"<a>" * 40, b"../",
    b"../../etc/passwd", b"/dev/zero", b"/dev/stdin", b"a.raw", b"%d", b"%s", b"%99999999d", b"LIST", b"..",
    b".", b"~", b"C:\\", b"file:///", b"[", b"]", b"[[", b"{", b"}", b"(", b")", b"none", b"[" * 2000,
    b"{a=" * 300, b"(" * 3000,
)  # fmt: skip
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z][A-Za-z0-9_]{2,}")


def words(seeds: Sequence[bytes]) -> list[bytes]:
    """What looks like a keyword in the seeds: they teach the format."""
    return sorted({match for seed in seeds for match in _WORD.findall(seed)})


def mutated(rng: np.random.Generator, data: bytes, other: bytes, known: Sequence[bytes]) -> bytes:
    """``data`` after one to six small changes; ``other``: a file to take parts of, ``known``: words of the format."""
    for _ in range(int(rng.integers(1, 7)) if rng.random() < 0.7 else 1):
        data = _CHANGES[int(rng.integers(len(_CHANGES)))](rng, data, other, known)
    return data[:LONGEST]


def _at(rng: np.random.Generator, data: bytes) -> int:
    return int(rng.integers(len(data) + 1))


def _span(rng: np.random.Generator, data: bytes) -> tuple[int, int]:
    start = _at(rng, data)
    return start, min(start + int(2 ** rng.uniform(0, 8)), len(data))


def _one(rng: np.random.Generator, items: Sequence[bytes]) -> bytes:
    return items[int(rng.integers(len(items)))] if items else b""


def _bit(rng: np.random.Generator, data: bytes, *_: object) -> bytes:
    at = _at(rng, data)
    return data[:at] + bytes([data[at] ^ (1 << int(rng.integers(8)))]) + data[at + 1 :] if at < len(data) else data


def _byte(rng: np.random.Generator, data: bytes, *_: object) -> bytes:
    at = _at(rng, data)
    return data[:at] + bytes([_one(rng, [b"\0", b"\xff", b"\x7f", b"\x80", bytes(rng.bytes(1))])[0]]) + data[at + 1 :]


def _binary(rng: np.random.Generator, data: bytes, *_: object) -> bytes:
    code = "bhiqfd"[int(rng.integers(6))]
    value: float | int
    if code in "fd":
        value = (0.0, -1.0, float("nan"), float("inf"), 1e30, 1e-40)[int(rng.integers(6))]
    else:
        top = 1 << (8 * struct.calcsize(code) - 1)
        value = (0, 1, -1, 2, top - 1, -top, top // 2, 255 % top)[int(rng.integers(8))]
    packed = struct.pack("<>"[int(rng.integers(2))] + code, value)
    at = _at(rng, data)
    if rng.random() < 0.7:
        at &= ~1
    return data[:at] + packed + data[at + len(packed) :]


def _number(rng: np.random.Generator, data: bytes, *_: object) -> bytes:
    found = list(_NUMBER.finditer(data))
    if not found:
        return data
    match = found[int(rng.integers(len(found)))]
    return data[: match.start()] + _one(rng, _NUMBERS) + data[match.end() :]


def _token(rng: np.random.Generator, data: bytes, _: bytes, known: Sequence[bytes]) -> bytes:
    start, end = _span(rng, data)
    piece = _one(rng, known if rng.random() < 0.5 else _TOKENS)
    return data[:start] + piece + data[start if rng.random() < 0.5 else end :]


def _word(rng: np.random.Generator, data: bytes, _: bytes, known: Sequence[bytes]) -> bytes:
    found = list(_WORD.finditer(data))
    if not found:
        return data
    match = found[int(rng.integers(len(found)))]
    return data[: match.start()] + _one(rng, known if rng.random() < 0.7 else _TOKENS) + data[match.end() :]


def _drop(rng: np.random.Generator, data: bytes, *_: object) -> bytes:
    start, end = _span(rng, data)
    return data[:start] + data[end:]


def _double(rng: np.random.Generator, data: bytes, *_: object) -> bytes:
    start, end = _span(rng, data)
    times = 1 if rng.random() < 0.8 else int(2 ** rng.uniform(1, 10))
    return (data[:end] + data[start:end] * times + data[end:])[:LONGEST]


def _cut(rng: np.random.Generator, data: bytes, *_: object) -> bytes:
    return data[: _at(rng, data)] if rng.random() < 0.5 else data


def _line(rng: np.random.Generator, data: bytes, *_: object) -> bytes:
    lines = data.split(b"\n")
    i, j = (int(k) for k in rng.integers(len(lines), size=2))
    kind = rng.random()
    if kind < 0.4:
        lines[i], lines[j] = lines[j], lines[i]
    elif kind < 0.7:
        lines.insert(i, lines[j])
    else:
        del lines[i]
    return b"\n".join(lines)


def _splice(rng: np.random.Generator, data: bytes, other: bytes, _: object) -> bytes:
    start, end = _span(rng, other)
    return data[: _at(rng, data)] + other[start:] if rng.random() < 0.3 else (
        data[: (at := _at(rng, data))] + other[start:end] + data[at:]
    )  # fmt: skip


_CHANGES = (
    _bit,
    _byte,
    _binary,
    _binary,
    _number,
    _number,
    _number,
    _token,
    _word,
    _drop,
    _double,
    _cut,
    _line,
    _splice,
)
