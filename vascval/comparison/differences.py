"""Generation by generation, tree minus cast."""

from __future__ import annotations

import numpy as np
import pandas as pd

from vascval.io.documents import ReferenceTable
from vascval.io.rows import TotalRow
from vascval.morphometry import Analysis

_COUNTS = ("n_segments", "n_elements", "n_junctions", "n_trifurcations", "n_monopodial", "total_length_mm")


def generation_differences(tree: Analysis | ReferenceTable, cast: Analysis | ReferenceTable) -> pd.DataFrame:
    """Tree minus cast on the union of their generations: each measure that both have, and ``<measure>_relative``.

    The relative difference is over the cast's value, NaN where that is 0 or unknown. A generation that an analysed
    tree does not have counts 0 vessels in it and has no means; one that a published table does not list is unknown.
    """
    measures = [
        name
        for name in cast.generations.columns
        if name not in ("generation", "order") and name in tree.generations.columns
    ]
    union = np.union1d(cast.generations["generation"], tree.generations["generation"]).astype(int)
    ours, theirs = _on(union, tree, measures), _on(union, cast, measures)
    columns: dict[str, np.ndarray] = {"generation": union}
    for name in measures:
        difference = ours[name].to_numpy() - theirs[name].to_numpy()
        base = theirs[name].to_numpy()
        columns[name] = difference
        columns[f"{name}_relative"] = np.where(base > 0, difference / np.where(base > 0, base, 1.0), np.nan)
    return pd.DataFrame(columns)


def _on(union: np.ndarray, side: Analysis | ReferenceTable, measures: list[str]) -> pd.DataFrame:
    table = side.generations.set_index("generation")[measures].astype(float).reindex(union)
    if isinstance(side, Analysis):
        counts = [name for name in measures if name in _COUNTS]
        table[counts] = table[counts].fillna(0.0)
    return table


def total_differences(trees: list[Analysis], cast: Analysis) -> pd.DataFrame:
    """The totals of each tree beside those of the cast (:class:`vascval.io.rows.TotalRow`)."""
    rows = []
    for index, tree in enumerate(trees):
        for name, theirs in cast.summary.items():
            a = np.nan if theirs is None else float(theirs)
            b = np.nan if tree.summary[name] is None else float(tree.summary[name])
            rows.append((index, name, a, b, b - a, (b - a) / a if a else np.nan))
    return pd.DataFrame(rows, columns=list(TotalRow.model_fields))
