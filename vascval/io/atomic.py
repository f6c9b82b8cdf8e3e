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

    :raises InputError: when the folder is missing or not writable, or ``path`` is a folder.
    """
    path = Path(path)
    _require_folder(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the name of a file")
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
    """A temporary folder to fill; its files are moved into ``path`` at the end, and dropped if anything is raised.

    ``path`` and its parents are made if they do not exist. Files already there are replaced where the names agree and
    left alone otherwise.

    :raises InputError: when ``path`` is a file or its first existing parent is not a writable folder.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: is a file; give the name of a folder")
    home = path.absolute().parent
    while not home.exists():
        home = home.parent
    _require_folder(home / path.name)
    aside = home / f".{secrets.token_hex(4)}-{path.absolute().name}"
    try:
        aside.mkdir()
        yield aside
        _move_into(aside, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error}); choose another place") from error
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def _move_into(source: Path, target: Path) -> None:
    target.mkdir(parents=True, exist_ok=True)
    for item in sorted(source.iterdir()):
        if item.is_dir():
            _move_into(item, target / item.name)
        else:
            os.replace(item, target / item.name)


def _require_folder(path: Path) -> None:
    folder = path.absolute().parent
    if not folder.is_dir():
        raise InputError(f"{path}: folder {folder} does not exist; make it first or choose another")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"{path}: folder {folder} is not writable; choose another")
