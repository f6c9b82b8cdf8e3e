"""What a report is about: one measured tree, or a cast (measured, or a published table) and trees beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pandas as pd

from vascval.io.documents import ReferenceTable
from vascval.report.style import Series, styled
from vascval.report.twin_section import Twin

if TYPE_CHECKING:
    from vascval.comparison import Comparison
    from vascval.imaging import Skeleton
    from vascval.morphometry import Analysis


@dataclass(frozen=True, eq=False)
class Side:
    """One of them: how it looks, its rows by generation and, unless it is a published table, its analysis."""

    series: Series
    source: str
    generations: pd.DataFrame
    analysis: Analysis | None
    short: str  #: what it is called where there is little room: cast, tree, tree 2, table
    citation: str = ""

    @property
    def label(self) -> str:
        return self.series.label


@dataclass(frozen=True, eq=False)
class Subject:
    """All ``sides``: the cast (or the only tree) first, the trees, a published reference last if there is one.

    ``twin``: what the trees were grown from, where they were grown after the cast.
    """

    sides: list[Side]
    comparison: Comparison | None
    skeleton: Skeleton | None
    provenance: Mapping[str, Any]
    twin: Twin | None = None

    @property
    def measured(self) -> list[tuple[Side, Analysis]]:
        """The sides that are no published tables, with their analyses."""
        return [(side, side.analysis) for side in self.sides if side.analysis is not None]

    @property
    def first(self) -> Side:
        return self.sides[0]

    @property
    def trees(self) -> list[Side]:
        """What stands against the cast; none in the report of a single tree."""
        return [side for side in self.sides if side.series.role == "tree"]


def of_comparison(
    comparison: Comparison, skeleton: Skeleton | None, provenance: Mapping[str, Any], twin: Twin | None = None
) -> Subject:
    reference = comparison.reference
    looks = styled(
        comparison.cast.source,
        [tree.source for tree in comparison.trees],
        None if reference is None else reference.source,
    )
    items = [comparison.cast, *comparison.trees, *([] if reference is None else [reference])]
    n = len(comparison.trees)
    short = ["cast", *(["tree"] if n == 1 else [f"tree {k}" for k in range(1, n + 1)]), "table"]
    sides = [_side(look, item, name) for look, item, name in zip(looks, items, short)]
    return Subject(sides, comparison, skeleton, provenance, twin)


def of_analysis(analysis: Analysis, skeleton: Skeleton | None, provenance: Mapping[str, Any]) -> Subject:
    return Subject([_side(styled(analysis.source, [])[0], analysis, "tree")], None, skeleton, provenance)


def _side(look: Series, item: Analysis | ReferenceTable, short: str) -> Side:
    if isinstance(item, ReferenceTable):
        return Side(look, item.source, item.generations, None, short, item.citation)
    return Side(look, item.source, item.generations, item, short)
