"""Outputs that one run at a time may write."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from vascval.core.errors import InputError


@contextmanager
def claimed(path: Path | str) -> Iterator[None]:
    """No other run that claims ``path`` may do so until the end; what killed runs left unfinished of it is removed.

    The claim is a lock on ``.NAME.lock`` beside the output (in it, if it is a folder and the one around it cannot be
    written), which the system drops when a process ends in whatever way. Where there are no such locks (Windows, some
    network drives) nothing is claimed; outputs still appear whole.

    :raises InputError: when another run has claimed it, or the folder cannot be written.
    """
    path = Path(os.path.abspath(path))
    place = path.parent if os.access(path.parent, os.W_OK | os.X_OK) or not path.is_dir() else path
    lock = place / f".{path.name}.lock"
    try:
        stream = _locked(lock)
    except BlockingIOError:
        raise InputError(f"{path}: is being written by another run; wait for its end or choose another name") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error}); choose another place") from error
    try:
        _sweep(place, path.name)
        yield
    finally:
        with suppress(OSError):
            lock.unlink()
        os.close(stream)


def _locked(lock: Path) -> int:
    """An open, locked file of that name; not one that its last owner has just removed."""
    while True:
        stream = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            _lock(stream)
            if lock.exists() and os.path.samestat(os.fstat(stream), lock.stat()):
                return stream
        except BaseException:
            os.close(stream)
            raise
        os.close(stream)


def _lock(stream: int) -> None:
    try:
        import fcntl
    except ImportError:  # Windows
        return
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:  # a file system without locks
        return


def _sweep(folder: Path, name: str) -> None:
    """Remove what runs that were killed had written aside; see :mod:`vascval.io.atomic`."""
    aside = re.compile(r"\.[0-9a-f]{8}-" + re.escape(name))
    for item in folder.iterdir():
        if aside.fullmatch(item.name):
            if item.is_dir() and not item.is_symlink():
                shutil.rmtree(item, ignore_errors=True)
            else:
                with suppress(OSError):
                    item.unlink()
