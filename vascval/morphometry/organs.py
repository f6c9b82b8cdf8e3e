"""Where a tree stands among the trees of real organs: its Horton ratios beside theirs.

The tables, ``organs.csv``, are third-party transcriptions of published ones and were not checked against the papers.
They give ranges of what is plausible and are no pass mark.
"""

from __future__ import annotations

from functools import lru_cache
from importlib.resources import files

import numpy as np
import pandas as pd

from vascval.morphometry.statistics import log_line

CAVEAT = (
    "The organs' tables are third-party transcriptions of published ones, not checked against the papers: they show "
    "what is plausible and are no pass mark."
)
SOURCES = {
    "kassab1993": "Kassab et al. 1993, Am J Physiol 265:H350",
    "nordsletten2006": "Nordsletten et al. 2006, Am J Physiol 291:H296",
    "jiang1994": "Jiang et al. 1994, J Appl Physiol 76:882",
    "huang1996": "Huang et al. 1996, J Appl Physiol 81:2123",
}
"""The publications by their key in the tables."""
_COLUMNS = {"number": "n_elements", "radius": "radius_mm", "length": "length_mm"}


@lru_cache(maxsize=1)
def organs() -> pd.DataFrame:
    """The elements of each organ by order: ``organ``, ``source``, ``ordering``, ``order``, ``radius_mm``,
    ``length_mm``, ``n_elements``; NaN where the table has no value."""
    with files("vascval.morphometry").joinpath("organs.csv").open(encoding="utf-8") as stream:
        return pd.read_csv(stream, comment="#")


def organ_table(horton: pd.DataFrame) -> pd.DataFrame:
    """Horton ratios of the organs beside those of a tree (see :class:`vascval.io.rows.OrganRow`).

    Each is fitted as :func:`vascval.morphometry.orders.horton_table` does without the highest order, over the orders
    for which the organ's table has the quantity, and is set beside the tree's ratio for the same kind of orders:
    NaN where the tree has none.
    """
    rows = []
    for (organ, source, ordering), table in organs().groupby(["organ", "source", "ordering"], sort=False):
        for quantity, column in _COLUMNS.items():
            given = table[(table["order"] < table["order"].max()) & table[column].notna()]
            slope, r_squared = log_line(given["order"].to_numpy(), given[column].to_numpy(float))
            ratio, own = 10 ** abs(slope), _of_tree(horton, str(ordering), quantity)
            rows.append((organ, source, ordering, quantity, ratio, r_squared, len(given), own, own / ratio - 1))
    names = ["organ", "source", "ordering", "quantity", "ratio", "r_squared", "n_orders", "tree_ratio", "relative"]
    return pd.DataFrame(rows, columns=names)


def _of_tree(horton: pd.DataFrame, ordering: str, quantity: str) -> float:
    """The tree's ratio, without the highest order where that is fitted too."""
    found = horton[(horton["ordering"] == ordering) & (horton["quantity"] == quantity)]
    return float(found.sort_values("n_orders")["ratio"].iloc[0]) if len(found) else float(np.nan)
