"""Files that appear whole or not at all: written aside and renamed when they are complete."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from vascval.core.errors import InputError


@contextmanager
def atomic_file(path: Path | str) -> Iterator[Path]:
    """A temporary path beside ``path`` to write to; renamed to ``path`` at the end, removed if anything is raised.

    The temporary name ends like the real one, so that libraries which choose a format by the suffix choose the same.

    :raises InputError: when the folder is missing or not writable, or ``path`` is a folder, a device or a pipe.
    """
    path = Path(path)
    _require_folder(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the name of a file")
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is a device or a pipe, which a file would take the place of; give another name")
    aside = path.with_name(f".{secrets.token_hex(4)}-{path.name}")
    try:
        yield aside
        os.replace(aside, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error}); choose another place") from error
    finally:
        with suppress(OSError):
            aside.unlink()


@contextmanager
def atomic_directory(path: Path | str) -> Iterator[Path]:
    """A temporary folder to fill; it becomes ``path`` at the end, and is dropped if anything is raised.

    Where ``path`` exists, the files are moved into it: those of the same name are replaced, others left alone, and
    nothing is moved if one cannot be. Parents are made if they do not exist.

    :raises InputError: when ``path`` is a file, it or its first existing parent is not writable, or a folder of that
        name is where a file belongs or the other way round.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: is a file; give the name of a folder")
    home = path.absolute()
    while not home.exists():
        home = home.parent
    _require_folder(home / path.name)
    aside = home / f".{secrets.token_hex(4)}-{path.absolute().name}"
    try:
        aside.mkdir()
        yield aside
        if path.exists():
            _require_room(aside, path)
            _move_into(aside, path)
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            os.rename(aside, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error}); choose another place") from error
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def _require_room(source: Path, target: Path) -> None:
    """:raises InputError: when something in ``source`` cannot take its place in ``target``."""
    if not os.access(target, os.W_OK | os.X_OK):
        raise InputError(f"{target}: is not writable; choose another place")
    for item in sorted(source.iterdir()):
        place = target / item.name
        if place.exists() and place.is_dir() != item.is_dir():
            kinds = ("a file", "a folder") if item.is_dir() else ("a folder", "a file")
            raise InputError(f"{place}: is {kinds[0]} where {kinds[1]} belongs; move it away or choose another place")
        if item.is_dir() and place.exists():
            _require_room(item, place)


def _move_into(source: Path, target: Path) -> None:
    for item in sorted(source.iterdir()):
        if item.is_dir() and (target / item.name).exists():
            _move_into(item, target / item.name)
        else:
            os.replace(item, target / item.name)


def _require_folder(path: Path) -> None:
    folder = path.absolute().parent
    if not folder.is_dir():
        raise InputError(f"{path}: folder {folder} does not exist; make it first or choose another")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"{path}: folder {folder} is not writable; choose another")
