"""The tables of an ensemble: a row per tree, and the spread over the trees in total and by generation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from vascval.io.rows import EnsembleSpreadRow, EnsembleTreeRow, GenerationRow

TOTALS = tuple(name for name in EnsembleTreeRow.model_fields if name not in ("name", "case", "seed", "sha256"))
BY_GENERATION = tuple(name for name in GenerationRow.model_fields if name not in ("generation", "order"))


@dataclass(frozen=True)
class Member:
    """A tree of an ensemble: what it is called, its case of the grid (empty without), its seed, the checksum of its
    file and its document as of ``vascval analyze``."""

    name: str
    case: str
    seed: int
    sha256: str
    document: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Ensemble:
    """``n_asked`` trees in ``cases``, of which some may be missing.

    ``trees`` has a row per tree (:class:`vascval.io.rows.EnsembleTreeRow`), ``tree_generations`` one per tree and
    generation, ``totals`` and ``generations`` the spread (:class:`vascval.io.rows.EnsembleSpreadRow`).
    """

    n_asked: int
    cases: list[str]
    trees: pd.DataFrame
    tree_generations: pd.DataFrame
    totals: pd.DataFrame
    generations: pd.DataFrame

    def tables(self) -> dict[str, pd.DataFrame]:
        """The tables by the names of their files."""
        return {
            "trees": self.trees,
            "tree-generations": self.tree_generations,
            "totals": self.totals,
            "generations": self.generations,
        }


def gather(members: Sequence[Member], *, n_asked: int) -> Ensemble:
    """The tables of one or more trees, in the order given."""
    trees = pd.DataFrame([_tree(member) for member in members])
    rows = [
        {"name": member.name, "case": member.case, "seed": member.seed, **row}
        for member in members
        for row in member.document["generations"]
    ]
    by_generation = pd.DataFrame(rows)
    cases = list(dict.fromkeys(member.case for member in members))
    totals, generations = [], []
    for case in cases:
        totals += _spread(case, None, trees[trees["case"] == case], TOTALS)
        for generation, part in by_generation[by_generation["case"] == case].groupby("generation"):
            generations += _spread(case, generation, part, BY_GENERATION)
    return Ensemble(n_asked, cases, trees, by_generation, _frame(totals), _frame(generations))


def _tree(member: Member) -> dict[str, Any]:
    named = {"name": member.name, "case": member.case, "seed": member.seed, "sha256": member.sha256}
    row = {**member.document["summary"], **named}
    return {name: row[name] for name in EnsembleTreeRow.model_fields}


def _spread(case: str, generation: Any, part: pd.DataFrame, measures: Sequence[str]) -> list[dict[str, Any]]:
    """A row per measure that any tree has a value of."""
    rows = []
    for measure in measures:
        values = part[measure].dropna().to_numpy(float)
        if not values.size:
            continue
        quartiles = np.percentile(values, [0, 25, 50, 75, 100])
        sd = float(values.std(ddof=1)) if values.size > 1 else None
        rows.append(
            {"case": case, "generation": generation, "measure": measure, "n_trees": values.size}
            | {"mean": float(values.mean()), "sd": sd}
            | dict(zip(("min", "q1", "median", "q3", "max"), quartiles.tolist()))
        )
    return rows


def _frame(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    frame = pd.DataFrame(rows, columns=list(EnsembleSpreadRow.model_fields))
    return frame.astype({"generation": "Int64", "sd": float})
