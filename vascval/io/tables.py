"""Tables as CSV."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from vascval.core.errors import ComputationError, InputError
from vascval.io.atomic import atomic_file

if TYPE_CHECKING:
    import pandas as pd


def write_table(frame: pd.DataFrame, path: Path | str) -> None:
    """The table as CSV without an index column: UTF-8, one header line, numbers that read back as they were; atomic.

    An empty field is the mark of a value that does not exist (NaN, ``None``); there is no other.

    :raises InputError: when the suffix is not .csv or the place cannot be written.
    :raises ComputationError: when a value is infinite: a measure that does not exist is no number at all.
    """
    path = Path(path)
    if path.suffix.lower() != ".csv":
        raise InputError(f"{path}: tables are written as CSV; let the name end in .csv")
    _require_finite(frame, path)
    with atomic_file(path) as aside:
        frame.to_csv(aside, index=False, lineterminator="\n", encoding="utf-8")


def _require_finite(frame: pd.DataFrame, path: Path) -> None:
    for name, column in frame.items():
        if column.dtype.kind not in "fO":
            continue
        bad = [k for k, value in enumerate(column) if isinstance(value, float) and math.isinf(value)]
        if bad:
            raise ComputationError(
                f"{path}: {len(bad)} values of {name} are infinite (first: row {bad[0] + 1}) and the table is not "
                "written; please report how it came about"
            )
