"""The tables of a report as CSV, with the column names of the JSON documents."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from vascval.comparison import Comparison
from vascval.imaging import Skeleton
from vascval.io.tables import write_table
from vascval.report.subject import Subject

_PER_TREE = {
    "generations": "generations",
    "orders": "orders",
    "segments": "segments",
    "elements": "elements",
    "junctions": "junctions",
    "horton": "horton",
    "organs": "organs",
    "connectivity": "connectivity",
    "monopodial-sensitivity": "monopodial_sensitivity",
}


def write_tables(subject: Subject, folder: Path) -> None:
    """Every table into ``folder``; where several trees share one, the first column ``source`` names the tree."""
    for name, table in tables(subject).items():
        write_table(table, folder / f"{name}.csv")


def tables(subject: Subject) -> dict[str, pd.DataFrame]:
    """The tables by name. A table without rows keeps its header."""
    found = {
        name: _stacked([(side.source, getattr(analysis, attribute)) for side, analysis in subject.measured])
        for name, attribute in _PER_TREE.items()
    }
    published = [(side.source, side.generations) for side in subject.sides if side.analysis is None]
    if published:
        found["reference"] = _stacked(published)
    if subject.skeleton is not None:
        found["image-positions"] = _positions(subject.skeleton)
    if subject.comparison is not None:
        found |= _of_comparison(subject, subject.comparison)
    if subject.twin is not None and not subject.twin.history.empty:
        found["search-history"] = subject.twin.history
    return found


def _of_comparison(subject: Subject, comparison: Comparison) -> dict[str, pd.DataFrame]:
    sources = [tree.source for tree in comparison.trees]
    measured = [side.source for side, _ in subject.measured]
    found = {
        "totals": comparison.totals,
        "differences": _stacked(list(zip(sources, comparison.differences))),
        "distributions": comparison.distributions,
        "location": _stacked([(name, item.generations) for name, item in zip(sources, comparison.location)]),
        "segment-location": _stacked(
            [
                (name, frame.assign(side=side)[["side", *frame.columns]])
                for name, item in zip(sources, comparison.location)
                for side, frame in (("cast", item.cast_segments), ("tree", item.tree_segments))
            ]
        ),
        "territories": _stacked(
            [(name, item.generations) for name, item in zip(sources, comparison.territories) if item is not None]
        ),
    }
    if comparison.reference_differences:
        found["reference-differences"] = _stacked(list(zip(measured, comparison.reference_differences)))
    return {name: table for name, table in found.items() if len(table.columns) > 1}


def _positions(skeleton: Skeleton) -> pd.DataFrame:
    """Where loops were cut, spurs pruned and breaks joined, one row each."""
    kinds = (("loop", skeleton.loops_mm), ("spur", skeleton.spurs_mm), ("break", skeleton.breaks_mm))
    rows = [(kind, *place) for kind, places in kinds for place in places.tolist()]
    return pd.DataFrame(rows, columns=["kind", "x_mm", "y_mm", "z_mm"])


def _stacked(parts: list[tuple[str, pd.DataFrame]]) -> pd.DataFrame:
    filled = [frame.assign(source=source)[["source", *frame.columns]] for source, frame in parts]
    if not filled:
        return pd.DataFrame(columns=["source"])
    return filled[0] if len(filled) == 1 else pd.concat(filled, ignore_index=True)
