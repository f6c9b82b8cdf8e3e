"""Where a result comes from: version, command, configuration, seed and the checksums of what was read.

There is no time stamp: the same inputs give the same bytes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

import vascval
from vascval.core.errors import InputError


def sha256(path: Path | str) -> str:
    """Hexadecimal SHA-256 of a file; of a folder: of the names and checksums of what is in it, sorted by name.

    :raises InputError: when it cannot be read.
    """
    path = Path(path)
    try:
        if not path.is_dir():
            with path.open("rb") as stream:
                return _digest(stream)
        lines = [f"{item.name} {sha256(item)}\n" for item in sorted(path.iterdir())]
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); check its name") from error
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def _digest(stream: BinaryIO) -> str:
    digest = hashlib.sha256()
    while block := stream.read(1 << 20):
        digest.update(block)
    return digest.hexdigest()


def provenance(
    *, command: str, config: Mapping[str, Any], seed: int | None, inputs: Sequence[Path | str]
) -> dict[str, Any]:
    """The record that every output carries, of plain JSON values.

    :returns: ``version``, ``command``, ``config``, ``seed`` and ``inputs``, a list of ``name`` (without folders),
        ``sha256`` and ``bytes``.
    :raises InputError: when an input cannot be read.
    """
    return {
        "version": vascval.__version__,
        "command": command,
        "config": plain(config),
        "seed": None if seed is None else int(seed),
        "inputs": [_input(Path(path)) for path in inputs],
    }


def _input(path: Path) -> dict[str, Any]:
    files = [item for item in path.rglob("*") if item.is_file()] if path.is_dir() else [path]
    digest = sha256(path)
    return {"name": path.name, "sha256": digest, "bytes": sum(item.stat().st_size for item in files)}


def plain(value: Any) -> Any:
    """``value`` in terms of dict, list, str, int, float, bool and None, as JSON knows them."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if is_dataclass(value) and not isinstance(value, type):
        return plain(asdict(value))
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in (sorted(value) if isinstance(value, set | frozenset) else value)]
    if value is None or isinstance(value, str | int | float | bool):
        return value
    return str(value)
