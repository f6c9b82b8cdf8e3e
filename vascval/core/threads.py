"""How many threads one computation may use."""

from __future__ import annotations

import os

from vascval.core.errors import InputError

VARIABLE = "VASCVAL_THREADS"


def threads() -> int:
    """``VASCVAL_THREADS``, else the number of processors. Results never depend on it.

    :raises InputError: when the variable is no whole number from 1 on.
    """
    given = os.environ.get(VARIABLE, "").strip()
    if not given:
        return os.cpu_count() or 1
    if not given.isdecimal() or int(given) < 1:
        raise InputError(f"{VARIABLE}={given}: is no number of threads; set a whole number from 1 on, or unset it")
    return int(given)
