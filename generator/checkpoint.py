"""A run on disk, from which it can be gone on with: ``vascval generate --resume``.

A checkpoint is one file of plain data: a line that names the format, the length of a JSON header, the header, the raw
bytes of the arrays that it lists, and the SHA-256 of all that. Nothing in it is executed, and nothing is larger in
memory than it is in the file. It is written aside and renamed: what bears the name is whole.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from generator.code_checksum import code_sha256
from vascval.core.errors import InputError
from vascval.io.atomic import atomic_file

CODE_SHA256 = code_sha256()
"""Of the sources as this is imported, when a run begins; they may change while it lasts."""
_MAGIC = b"vascval checkpoint 1\n"
_DIGEST = hashlib.sha256().digest_size
_TYPES = ("|u1", "|i1", "|b1", "<i4", "<i8", "<u8", "<f8")
_FILES = (("domain", "file"), ("root_tree",), ("terminals_file",))
"""The keys of a configuration that name files: their content decides the tree, not where they are."""


@dataclass(frozen=True, eq=False)
class State:
    """Where a run stands: ``record`` of plain JSON values and ``arrays`` by name, of types that :func:`write` takes."""

    record: dict[str, Any]
    arrays: dict[str, np.ndarray]


def write(path: Path, state: State, origin: Mapping[str, Any]) -> None:
    """Write a checkpoint; atomic, and on the disk when this returns.

    :param origin: what :func:`vascval.io.provenance.provenance` says of the run.
    :raises InputError: when the place cannot be written.
    """
    arrays = {name: np.ascontiguousarray(array) for name, array in state.arrays.items()}
    listed = [[name, array.dtype.newbyteorder("<").str, array.shape] for name, array in arrays.items()]
    hashes = {"code_sha256": CODE_SHA256, "config_sha256": _config_hash(origin)}
    header = {"origin": origin, **hashes, "record": state.record, "arrays": listed}
    text = json.dumps(header, allow_nan=False).encode()
    digest = hashlib.sha256()
    with atomic_file(path) as aside, aside.open("wb") as stream:
        blocks: list[bytes | memoryview] = [_MAGIC, len(text).to_bytes(8, "little"), text]
        for block in [*blocks, *map(_bytes_of, arrays.values())]:
            digest.update(block)
            stream.write(block)
        stream.write(digest.digest())
        stream.flush()
        os.fsync(stream.fileno())


def read(path: Path, origin: Mapping[str, Any]) -> State:
    """The state in a checkpoint of the same configuration, inputs and version as ``origin``, and the same sources.

    :raises InputError: when it is another's, no checkpoint, or damaged; the reason is given.
    """
    header, body = _unpacked(path)
    _require_same(path, header, origin)
    return State(header["record"], _arrays(path, header["arrays"], body))


def _bytes_of(array: np.ndarray) -> memoryview:
    kept = array.astype(array.dtype.newbyteorder("<"), copy=False)
    if kept.dtype.str not in _TYPES:
        raise TypeError(f"arrays of {array.dtype} are not kept")
    return kept.reshape(-1).view(np.uint8).data


def _unpacked(path: Path) -> tuple[dict[str, Any], memoryview]:
    """The header, and the bytes of the arrays."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); check the name") from error
    if not content.startswith(_MAGIC):
        if content[: len(_MAGIC) - 2] == _MAGIC[:-2]:
            raise InputError(f"{path}: is a checkpoint of another format, by another version of vascval; use that one")
        raise InputError(f"{path}: is no checkpoint of vascval; give the file that --checkpoint names")
    if hashlib.sha256(memoryview(content)[:-_DIGEST]).digest() != content[-_DIGEST:]:
        raise InputError(f"{path}: is damaged or only half there (its checksum is wrong); begin the run anew")
    start = len(_MAGIC) + 8
    end = start + int.from_bytes(content[len(_MAGIC) : start], "little")
    try:
        header = json.loads(content[start:end])
        shapes = {"origin": dict, "config_sha256": str, "record": dict, "arrays": list}
        sound = all(isinstance(header[name], kind) for name, kind in shapes.items())
    except (ValueError, TypeError, KeyError, RecursionError):
        sound = False
    if not sound:
        raise InputError(f"{path}: has no sound header; begin the run anew")
    return header, memoryview(content)[end:-_DIGEST]


def _arrays(path: Path, listed: list[Any], body: memoryview) -> dict[str, np.ndarray]:
    arrays: dict[str, np.ndarray] = {}
    at = 0
    for entry in listed:
        try:
            name, kind, shape = str(entry[0]), str(entry[1]), [int(size) for size in entry[2]]
            if kind not in _TYPES or any(size < 0 for size in shape):
                raise ValueError(kind)
            count = int(np.prod(shape, dtype=object))
            arrays[name] = np.frombuffer(body, kind, count, at).reshape(shape).astype(np.dtype(kind).newbyteorder("="))
        except (ValueError, TypeError, IndexError, OverflowError) as error:
            raise InputError(f"{path}: lists arrays that it does not hold; begin the run anew") from error
        at += arrays[name].nbytes
    return arrays


def _require_same(path: Path, header: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    """:raises InputError: when a checkpoint comes from another version, other sources or another configuration."""
    kept = header["origin"]
    if kept.get("version") != wanted["version"]:
        raise InputError(
            f"{path}: was written by vascval {kept.get('version')} and this is {wanted['version']}, which need not go "
            "on to the same tree; resume with the other or begin anew"
        )
    if header.get("code_sha256") != CODE_SHA256:
        raise InputError(
            f"{path}: was written by vascval {wanted['version']} with other sources than this one has, which need not "
            "go on to the same tree; resume with those or begin anew"
        )
    if header["config_sha256"] == _config_hash(wanted):
        return
    old, new = (_flat(_without_files(origin.get("config", {}))) for origin in (kept, wanted))
    differences = [
        f"{key} is {old.get(key, 'not set')} there and {new.get(key, 'not set')} here"
        for key in sorted({*old, *new})
        if old.get(key) != new.get(key)
    ]
    differences = differences or ["the content of the input files differs"]
    more = f" ({len(differences) - 1} more)" if len(differences) > 1 else ""
    raise InputError(
        f"{path}: is of another configuration: {differences[0]}{more}; give that configuration or begin anew"
    )


def _config_hash(origin: Mapping[str, Any]) -> str:
    """SHA-256 of the configuration and of the content of its files, wherever they are."""
    content = [entry["sha256"] for entry in origin["inputs"]]
    text = json.dumps([origin["version"], _without_files(origin["config"]), content], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _without_files(config: Any) -> Any:
    """The configuration with nothing but the presence of files in place of their names."""
    if not isinstance(config, Mapping):
        return {}
    result = json.loads(json.dumps(config))
    for *tables, key in _FILES:
        table = result
        for name in tables:
            table = table.get(name, {})
        if isinstance(table, dict) and table.get(key) is not None:
            table[key] = "a file"
    return result


def _flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """``{"table.key": value}``."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {prefix + key: value}
    return flat
