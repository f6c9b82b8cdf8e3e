"""The section on where the trees stand among those of real organs."""

from __future__ import annotations

from typing import Any

import pandas as pd

from vascval.morphometry import Analysis
from vascval.morphometry.organs import CAVEAT, SOURCES
from vascval.report import panels
from vascval.report.formats import NONE, measure, missing
from vascval.report.page import Cell, Items, Section, Table, Text
from vascval.report.subject import Subject

_QUANTITIES = {"number": "number ratio", "radius": "diameter ratio", "length": "length ratio"}


def organs(subject: Subject) -> Section:
    title = "Among other organs"
    if not subject.measured:
        return Section("organs", title, [Text("There is no measured tree.", "empty")])
    caveat = Text(
        f"{CAVEAT} Species, size and the range of vessels differ; the ratios are those of the section above, fitted "
        "without the highest order."
    )
    standing = Items([(side.label, _standing(analysis.organs)) for side, analysis in subject.measured])
    tables = [_table(subject.measured[0][1].organs)] + [_own(side.label, one) for side, one in subject.measured]
    return Section("organs", title, [caveat, standing, *tables])


def _standing(rows: pd.DataFrame) -> str:
    """Where the tree's ratios lie among the organs', in words; each organ has its say by its own kind of orders."""
    said = []
    for quantity, name in _QUANTITIES.items():
        known = rows[(rows["quantity"] == quantity) & rows["ratio"].notna() & rows["tree_ratio"].notna()]
        if known.empty:
            said.append(f"no {name}")
            continue
        above = int((known["tree_ratio"] > known["ratio"]).sum())
        low, high = known["ratio"].min(), known["ratio"].max()
        if above in (0, len(known)):
            place = f"{'above' if above else 'not above'} that of any of {len(known)} organs"
        else:
            place = f"above that of {above} of {len(known)} organs"
        said.append(f"{name} {place}, which go from {measure(low)} to {measure(high)}")
    text = "; ".join(said)
    return text[0].upper() + text[1:] + "."


def _table(rows: pd.DataFrame) -> Table:
    head = [Cell("organ", "head"), Cell("source", "text"), Cell("orders", "text"), *map(Cell, _QUANTITIES.values())]
    body = []
    for (organ, source, ordering), mine in rows.groupby(["organ", "source", "ordering"], sort=False):
        ratio = mine.set_index("quantity")["ratio"]
        label = [
            Cell(str(organ), "head"),
            Cell(SOURCES[str(source)], "text"),
            Cell(panels.ORDERINGS[str(ordering)], "text"),
        ]
        body.append([*label, *(Cell(measure(ratio[quantity])) for quantity in _QUANTITIES)])
    return Table("Horton ratios of the elements of real trees.", [head], body, "tables/organs.csv")


def _own(label: str, analysis: Analysis) -> Table:
    head = [Cell("orders", "head"), *map(Cell, _QUANTITIES.values())]
    own = analysis.organs.drop_duplicates(["ordering", "quantity"]).set_index(["ordering", "quantity"])["tree_ratio"]
    body = [
        [Cell(words, "head"), *(Cell(_ratio(own.get((ordering, quantity)))) for quantity in _QUANTITIES)]
        for ordering, words in panels.ORDERINGS.items()
    ]
    return Table(f"{label}.", [head], body, "tables/organs.csv", small=True)


def _ratio(value: Any) -> str:
    return NONE if missing(value) else measure(value)
