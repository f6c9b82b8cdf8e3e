"""The report of an ensemble: how its trees spread, in total and by generation."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd

from vascval.io.atomic import atomic_directory
from vascval.io.documents import plain
from vascval.io.tables import write_table
from vascval.morphometry import Monopodial
from vascval.report import ensemble_panels
from vascval.report.definitions import MEASURED, monopodial_rule
from vascval.report.ensemble_tables import Ensemble
from vascval.report.formats import THIN, count, measure, missing, several, spread
from vascval.report.origin_sections import origin_entries
from vascval.report.page import Cell, Figure, Items, Section, Table, Text, render

_NAMES = {
    "n_terminals": "terminals",
    "n_segments": "segments",
    "n_bifurcations": "bifurcations",
    "n_trifurcations": "trifurcations",
    "n_monopodial": "monopodial branches",
    "n_overlaps": "overlapping pairs of segments",
    "max_order": "Strahler order of the root",
    "total_length_mm": "total length (mm)",
    "volume_mm3": "volume (mm³)",
    "murray_exponent_median": "median Murray exponent",
    "branching_angle_mean_deg": "mean branching angle (°)",
    "length_to_diameter_mean": "mean length to diameter",
}
_BY_GENERATION = {
    "n_segments": "segments",
    "radius_mean_mm": "mean radius (mm)",
    "length_mean_mm": "mean length (mm)",
    "branching_ratio_mean": "mean branching ratio",
}
_DEFINED = (
    "segment", "degenerate segment", "Strahler order", "generation", "branching ratio", "Murray exponent",
    "branching angle", "length to diameter", "trifurcation", "monopodial branch", "overlapping pairs",
)  # fmt: skip


def document(ensemble: Ensemble) -> dict[str, Any]:
    """The tables as JSON, with what they are of; nothing in it depends on who made the trees."""
    found: dict[str, Any] = plain(
        {
            "n_trees": ensemble.n_asked,
            "n_done": len(ensemble.trees),
            "cases": ensemble.cases,
            "trees": ensemble.trees,
            "totals": ensemble.totals,
            "generations": ensemble.generations,
        }
    )
    return found


def write_ensemble_report(ensemble: Ensemble, directory: Path, *, provenance: Mapping[str, Any]) -> None:
    """``report.html``, ``report.json``, ``figures/`` and ``tables/`` into ``directory``, all of it or nothing.

    :raises InputError: when the directory cannot be written.
    """
    with atomic_directory(directory) as work:
        figures, tables = work / "figures", work / "tables"
        figures.mkdir()
        tables.mkdir()
        for name, table in ensemble.tables().items():
            write_table(table, tables / f"{name}.csv")
        text = json.dumps({**document(ensemble), "provenance": dict(provenance)}, indent=1, allow_nan=False) + "\n"
        (work / "report.json").write_text(text, encoding="utf-8")
        sections = [
            _summary(ensemble),
            _totals(ensemble, figures),
            _generations(ensemble, figures),
            _trees(ensemble),
            Section("provenance", "Provenance", [Items(origin_entries(provenance))]),
            Section("definitions", "Definitions", [Items([one for one in MEASURED if one[0] in _DEFINED])]),
        ]
        page = render(
            f"Ensemble of {several(len(ensemble.trees), 'tree')}",
            "Trees that differ in their random numbers" + (", and in parameters" if len(ensemble.cases) > 1 else ""),
            sections,
            version=str(provenance.get("version", "")),
            legend=[],
        )
        (work / "report.html").write_text(page, encoding="utf-8")


def _summary(ensemble: Ensemble) -> Section:
    entries = []
    for case in ensemble.cases:
        rows = ensemble.totals[ensemble.totals["case"] == case].set_index("measure")
        volume, length = rows.loc["volume_mm3"], rows.loc["total_length_mm"]
        n = int((ensemble.trees["case"] == case).sum())
        said = (
            f"{several(n, 'tree')}: volume {spread(volume['mean'], volume['sd'])}{THIN}mm³, "
            f"length {spread(length['mean'], length['sd'])}{THIN}mm (mean ± standard deviation)."
        )
        entries.append((case or "all trees", said))
    blocks: list[Any] = [Items(entries, "lead")]
    lost = ensemble.n_asked - len(ensemble.trees)
    if lost:
        blocks.append(Text(f"{several(lost, 'tree')} of {ensemble.n_asked} could not be made and are missing here."))
    return Section("summary", "Summary", blocks)


def _totals(ensemble: Ensemble, figures: Path) -> Section:
    head = [Cell("", "head"), *(Cell(name) for name in ("trees", "mean ± sd", "least", "q1", "median", "q3", "most"))]
    tables = []
    for case in ensemble.cases:
        rows = ensemble.totals[ensemble.totals["case"] == case].to_dict("records")
        body = [[Cell(_NAMES[row["measure"]], "head"), Cell(count(row["n_trees"])), *_cells(row)] for row in rows]
        tables.append(Table(f"{_named(case)}Totals over the trees.", [head], body, "tables/totals.csv"))
    figure = Figure(f"A point per tree. {_boxes(ensemble)}", ensemble_panels.totals(ensemble, figures))
    return Section("totals", "Totals", [figure, *tables, Text(monopodial_rule(asdict(Monopodial())))])


def _boxes(ensemble: Ensemble) -> str:
    order = "; cases from left to right in the order of the legend" if len(ensemble.cases) > 1 else ""
    return (
        "Boxes from the first to the third quartile with the median; whiskers to the last value within 1.5 box "
        f"lengths, rings beyond{order}."
    )


def _cells(row: Mapping[Any, Any]) -> list[Cell]:
    return [Cell(_mean(row)), *(Cell(_number(row, name)) for name in ("min", "q1", "median", "q3", "max"))]


def _number(row: Mapping[Any, Any], name: str) -> str:
    """A value of a row; a whole number of things without decimals."""
    counted = row["measure"].startswith("n_") or row["measure"] == "max_order"
    return count(row[name]) if counted and float(row[name]).is_integer() else measure(row[name])


def _mean(row: Mapping[Any, Any]) -> str:
    """With the standard deviation, if there are several trees."""
    if missing(row["sd"]):
        return _number(row, "mean")
    return f"{_number(row, 'mean')} ± 0" if row["sd"] == 0.0 else spread(row["mean"], row["sd"])


def _generations(ensemble: Ensemble, figures: Path) -> Section:
    pictures = ensemble_panels.generations(ensemble, figures)
    caption = f"Key statistics by generation over the trees. {_boxes(ensemble)}"
    tables = [_generation_table(ensemble.generations, case) for case in ensemble.cases]
    return Section("generations", "By generation", [Figure(caption, pictures, two=True), *tables])


def _generation_table(frame: pd.DataFrame, case: str) -> Table:
    rows = {(row["generation"], row["measure"]): row for row in frame[frame["case"] == case].to_dict("records")}
    generations = sorted({generation for generation, _ in rows})
    head = [
        [Cell("", "head"), Cell(""), *(Cell(name, "group", 2) for name in _BY_GENERATION.values())],
        [
            Cell("generation", "head"),
            Cell("trees"),
            *[Cell("mean ± sd"), Cell("median [q1, q3]")] * len(_BY_GENERATION),
        ],
    ]
    body = []
    for generation in generations:
        cells = [Cell(str(generation), "head"), Cell(count(rows[generation, "n_segments"]["n_trees"]))]
        for name in _BY_GENERATION:
            row = rows.get((generation, name))
            cells += [Cell(""), Cell("")] if row is None else _mean_and_median(row)
        body.append(cells)
    caption = f"{_named(case)}By generation; only trees that have the generation count."
    return Table(caption, head, body, "tables/generations.csv")


def _mean_and_median(row: Mapping[Any, Any]) -> list[Cell]:
    quartiles = f"{_number(row, 'median')} [{_number(row, 'q1')}, {_number(row, 'q3')}]"
    return [Cell(_mean(row)), Cell(quartiles)]


def _trees(ensemble: Ensemble) -> Section:
    shown = ("n_terminals", "n_segments", "n_trifurcations", "total_length_mm", "volume_mm3")
    head = [Cell("tree", "head"), Cell("seed"), *(Cell(_NAMES[name]) for name in shown), Cell("SHA-256", "text")]
    body = [
        [
            Cell(row["name"], "head"),
            Cell(str(row["seed"])),
            *(Cell(count(row[name]) if name.startswith("n_") else measure(row[name], 5)) for name in shown),
            Cell(row["sha256"][:16], "text"),
        ]
        for row in ensemble.trees.to_dict("records")
    ]
    return Section("trees", "Trees", [Table("The trees, in trees/.", [head], body, "tables/trees.csv")])


def _named(case: str) -> str:
    return f"{case}. " if case else ""
