"""Tables as CSV."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from vascval.core.errors import InputError
from vascval.io.atomic import atomic_file

if TYPE_CHECKING:
    import pandas as pd


def write_table(frame: pd.DataFrame, path: Path | str) -> None:
    """The table as CSV without an index column: UTF-8, one header line, numbers that read back as they were; atomic.

    :raises InputError: when the suffix is not .csv or the place cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() != ".csv":
        raise InputError(f"{path}: tables are written as CSV; let the name end in .csv")
    with atomic_file(path) as aside:
        frame.to_csv(aside, index=False, lineterminator="\n", encoding="utf-8")
