"""The sections on orders: elements by order, Horton ratios, connectivity."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from vascval.report import panels
from vascval.report.formats import NONE, count, measure, missing, spread
from vascval.report.page import Cell, Figure, Section, Table, Text
from vascval.report.subject import Subject
from vascval.report.tree_sections import two_rows


def orders(subject: Subject, figures: Path) -> Section:
    blocks: list[Any] = []
    for ordering, words in panels.ORDERINGS.items():
        pictures = panels.orders(subject, ordering, figures)
        if not pictures:
            blocks.append(Text(f"There are no {words} orders.", "empty"))
            continue
        caption = f"Elements by {words} order. On a logarithmic scale Horton's laws are straight lines."
        blocks.append(Figure(caption, pictures))
        blocks.append(_order_table(subject, ordering, words))
    return Section("orders", "By order", blocks)


def _order_table(subject: Subject, ordering: str, words: str) -> Table:
    measures = (
        ("elements", lambda row: count(row["n_elements"])),
        ("radius (mm)", lambda row: spread(row["element_radius_mean_mm"], row["element_radius_sd_mm"])),
        ("length (mm)", lambda row: spread(row["element_length_mean_mm"], row["element_length_sd_mm"])),
        ("segments per element", lambda row: measure(row["segments_per_element"])),
    )
    tables = {side.short: _indexed(analysis.orders, ordering) for side, analysis in subject.measured}
    every = sorted({order for rows in tables.values() for order in rows})
    head = two_rows("order", [(label, [Cell(name) for name in tables]) for label, _ in measures])
    body = [
        [
            Cell(str(order), "head"),
            *(Cell(form(rows[order]) if order in rows else NONE) for _, form in measures for rows in tables.values()),
        ]
        for order in every
    ]
    caption = f"Elements by {words} order (terminals 1), mean ± standard deviation."
    return Table(caption, head, body, "tables/orders.csv")


def _indexed(frame: pd.DataFrame, ordering: str) -> dict[int, dict[str, Any]]:
    rows: list[dict[Any, Any]] = frame[frame["ordering"] == ordering].to_dict("records")
    return {int(row["order"]): row for row in rows}


def horton(subject: Subject) -> Section:
    if not subject.measured:
        return Section("horton", "Horton ratios and connectivity", [Text("There is no measured tree.", "empty")])
    explained = Text(
        "Connectivity: the number of elements of order m (rows) that spring from one element of order n (columns), "
        "mean ± standard error."
    )
    words = Text(
        "A Horton ratio is the factor from order to order, by regression over the orders of the elements; it is fitted "
        "over all orders and without the highest, whose single element is cut off where the tree begins."
    )
    matrices = [
        _matrix(side.label, analysis.connectivity, ordering, kind)
        for ordering, kind in panels.ORDERINGS.items()
        for side, analysis in subject.measured
        if (analysis.connectivity["ordering"] == ordering).any()
    ]
    return Section("horton", "Horton ratios and connectivity", [words, _horton_table(subject), explained, *matrices])


def _horton_table(subject: Subject) -> Table:
    rows: dict[tuple[str, str, bool], dict[str, str]] = {}
    for side, analysis in subject.measured:
        highest = analysis.horton.groupby("ordering")["order_max"].max()
        for row in analysis.horton.to_dict("records"):
            whole = row["order_max"] == highest[row["ordering"]]
            fit = f"{row['order_min']} to {row['order_max']}; R² {measure(row['r_squared'], 2)}"
            text = NONE if missing(row["ratio"]) else f"{measure(row['ratio'])} ({fit})"
            rows.setdefault((row["ordering"], row["quantity"], whole), {})[side.short] = text
    names = [side.short for side, _ in subject.measured]
    head = [Cell("order", "head"), Cell("ratio", "text"), Cell("fitted", "text"), *(Cell(name) for name in names)]
    body = [
        [
            Cell(panels.ORDERINGS[ordering], "head"),
            Cell(quantity, "text"),
            Cell("all orders" if whole else "without the highest", "text"),
            *(Cell(found.get(name, NONE)) for name in names),
        ]
        for (ordering, quantity, whole), found in rows.items()
    ]
    return Table("Horton ratios, with the orders used and the fit.", [head], body, "tables/horton.csv")


def _matrix(label: str, frame: pd.DataFrame, ordering: str, words: str) -> Table:
    chosen = frame[frame["ordering"] == ordering]
    mean = chosen.pivot(index="order_child", columns="order_parent", values="mean")
    error = chosen.pivot(index="order_child", columns="order_parent", values="se")
    head = [Cell("m \\ n", "head"), *(Cell(str(n)) for n in mean.columns)]
    body = [
        [Cell(str(m), "head"), *(Cell(_mean(mean.at[m, n], error.at[m, n]) if m <= n else "") for n in mean.columns)]
        for m in mean.index
    ]
    caption = f"{label}, {words} orders."
    return Table(caption, [head], body, "tables/connectivity.csv", small=len(mean.columns) <= 4)


def _mean(mean: Any, error: Any) -> str:
    return "0" if mean == 0 else spread(mean, error)
