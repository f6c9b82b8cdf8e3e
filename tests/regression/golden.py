"""Tables as they were when they were last looked at, one CSV file each, and how they are compared."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import pandas as pd

TABLES = Path(__file__).parent / "tables"
UPDATE = "VASCVAL_UPDATE_TABLES"
ROUND_OFF = 1e-8
"""Ten digits are kept; sums of some thousand numbers differ by less between machines."""


def check(
    table: pd.DataFrame,
    name: str,
    *,
    rtol: float = ROUND_OFF,
    columns: Mapping[str, float] | None = None,
    folder: Path = TABLES,
) -> None:
    """The table is that of the file, each number within ``rtol``, or within the share given for its column.

    With ``VASCVAL_UPDATE_TABLES=1`` the file is written anew, which continuous integration refuses.
    """
    path = folder / f"{name}.csv"
    if os.environ.get(UPDATE) == "1":
        assert "CI" not in os.environ, "continuous integration compares tables, it does not write them"
        folder.mkdir(exist_ok=True)
        table.to_csv(path, index=False, lineterminator="\n", float_format="%.10g")
    assert path.exists(), f"{path.name} is not there; write it with {UPDATE}=1 pytest tests/regression and look at it"
    expected = pd.read_csv(path)
    assert list(table.columns) == list(expected.columns)
    for column in table.columns:
        share = (columns or {}).get(column, rtol)
        pd.testing.assert_series_equal(
            table[column].reset_index(drop=True), expected[column], check_dtype=False, rtol=share, atol=1e-9, obj=column
        )
