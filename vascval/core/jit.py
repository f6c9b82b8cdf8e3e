"""The one place where the compiler's switches are set.

Kernels are marked ``@njit``, or ``@borrowing`` of :mod:`vascval.core.borrowing` where they take arrays, return numbers
alone and are called often. They are lazily compiled (eager signatures refuse read-only arrays), release the interpreter
lock so that threads may drive them, and use strict IEEE arithmetic: no ``fastmath``, so that a result is the same bit
for bit from run to run.

They are cached on disk between runs. numba renews a cached function when its own file changes, but not when a function
that it calls does, or the way it is compiled. The cache therefore lies in a folder named by a digest of all kernel
files of the room (kernels call none of other rooms) and of the files that say how they are compiled, in the user's
cache directory or ``NUMBA_CACHE_DIR``; where that cannot be written numba falls back to its own places.
"""

from __future__ import annotations

import hashlib
import os
import sys
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numba

F = TypeVar("F")
_COMPILING = (Path(__file__), Path(__file__).with_name("borrowing.py"))


def njit(function: F | None = None, **options: Any) -> Any:
    """:func:`numba.njit` with ``cache=True`` and ``nogil=True``; use as ``@njit`` or ``@njit(inline="always")``."""
    if function is None:
        return lambda decorated: njit(decorated, **options)
    settings: Any = numba.config
    before = settings.CACHE_DIR
    settings.CACHE_DIR = _cache_dir(_room(Path(function.__code__.co_filename)))  # type: ignore[attr-defined]
    try:
        return numba.njit(cache=True, nogil=True, **options)(function)
    finally:
        settings.CACHE_DIR = before


def _room(file: Path) -> Path:
    """The folder whose kernels may call each other: the generator as a whole, else one room."""
    for parent in file.parents:
        if parent.name == "generator" or parent.parent.name == "vascval":
            return parent
    return file.parent


@lru_cache
def _cache_dir(room: Path) -> str:
    digest = hashlib.sha256()
    for path in (*_COMPILING, *sorted(room.rglob("_[!_]*.py"))):
        digest.update(path.read_bytes())
    return str(_user_cache() / f"{room.name}-{digest.hexdigest()[:16]}")


def _user_cache() -> Path:
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        return Path(given)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local")) / "vascval"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "vascval"
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "vascval"
