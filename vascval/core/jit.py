"""The one place where the compiler's switches are set.

Kernels are lazily compiled (eager signatures refuse read-only arrays), cached on disk between runs, release the
interpreter lock so that threads may drive them, and use strict IEEE arithmetic: no ``fastmath``, so that a result is
the same bit for bit from run to run.
"""

from __future__ import annotations

from typing import Any, TypeVar

import numba

F = TypeVar("F")


def njit(function: F | None = None, **options: Any) -> Any:
    """:func:`numba.njit` with ``cache=True`` and ``nogil=True``; use as ``@njit`` or ``@njit(inline="always")``."""
    merged: dict[str, Any] = {"cache": True, "nogil": True, **options}
    if function is None:
        return numba.njit(**merged)
    return numba.njit(**merged)(function)
