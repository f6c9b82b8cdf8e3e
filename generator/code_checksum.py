"""The checksum of the program itself, which tells two states of one version apart."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

from vascval.io.provenance import sha256

_ROOT = Path(__file__).resolve().parents[1]
_ROOMS = ("cli", "comparison", "core", "imaging", "io", "morphometry")
_DECIDING = ("generator", *(f"vascval/{room}" for room in _ROOMS))


@cache
def code_sha256() -> str:
    """Hexadecimal SHA-256 of the sources that decide results, as they are at the first call. Reports do not count."""
    digest = hashlib.sha256()
    for package in _DECIDING:
        for path in sorted((_ROOT / package).rglob("*.py")):
            digest.update(f"{path.relative_to(_ROOT).as_posix()} {sha256(path)}\n".encode())
    return digest.hexdigest()
