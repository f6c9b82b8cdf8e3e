"""The sections that any report has: totals, key statistics, generations, junctions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from vascval.comparison import Location
from vascval.report import panels
from vascval.report.definitions import monopodial_rule
from vascval.report.formats import NONE, THIN, change, count, measure, missing, percent, several, spread
from vascval.report.page import Cell, Figure, Items, Section, Table, Text
from vascval.report.subject import Side, Subject

Format = Callable[[Any], str]
_Group = tuple[str, list[Cell], dict[int, list[Cell]]]  # a group of columns: name, head below it, cells by generation

_TOTALS: tuple[tuple[str, str, Format], ...] = (
    ("n_terminals", "terminals", count),
    ("n_segments", "segments", count),
    ("n_elements", "elements", count),
    ("n_bifurcations", "bifurcations", count),
    ("n_trifurcations", "trifurcations", count),
    ("n_trifurcations_first_7", "\N{EM SPACE}in the first 7 generations", count),
    ("n_multifurcations", "junctions of four and more", count),
    ("n_monopodial", "monopodial branches", count),
    ("max_order", "Strahler order of the root", count),
    ("max_diameter_order", "largest diameter-defined order", count),
    ("total_length_mm", "total length (mm)", measure),
    ("volume_mm3", "volume (mm³)", measure),
    ("murray_exponent_median", "median Murray exponent", measure),
    ("branching_angle_mean_deg", "mean branching angle (°)", measure),
    ("tortuosity_mean", "mean tortuosity", measure),
    ("length_to_diameter_mean", "mean length to diameter", measure),
    ("n_overlaps", "overlapping pairs of segments", count),
    ("n_contracted", "degenerate segments contracted", count),
)

_COVERAGE: tuple[tuple[str, str], ...] = (
    ("terminals_per_mm3", "terminals per volume (1/mm³)"),
    ("distance_mean_mm", "mean distance of tissue to a terminal (mm)"),
    ("evenness", "that over the same for random terminals"),
)


def summary(subject: Subject) -> Section:
    """What there is in a few sentences, and the totals side by side."""
    blocks: list[Any] = [Items([(side.label, _headline(subject, side)) for side in subject.sides], "lead")]
    if subject.measured:
        blocks.append(_totals(subject))
    return Section("summary", "Summary", blocks)


def _headline(subject: Subject, side: Side) -> str:
    if side.analysis is None:
        return f"A published table of {several(len(side.generations), 'generation')}."
    total = side.analysis.summary
    said = (
        f"{several(total['n_terminals'], 'terminal')} in {several(len(side.generations), 'generation')}, "
        f"{measure(total['total_length_mm'])}{THIN}mm of vessels, {measure(total['volume_mm3'])}{THIN}mm³; "
        f"{several(total['n_trifurcations'], 'trifurcation')} and "
        f"{several(total['n_monopodial'], 'monopodial branch', 'es')} at "
        f"{several(len(side.analysis.junctions), 'junction')}."
    )
    if side in subject.trees and subject.comparison is not None and subject.comparison.location:
        said += f" {_place(subject.comparison.location[subject.trees.index(side)])}"
    return said


def _place(place: Location) -> str:
    rows = place.generations
    length = rows["cast_length_mm"].sum()
    hit, by_chance = (
        (rows[name] * rows["cast_length_mm"]).sum(min_count=1) / length if length > 0 else None
        for name in ("cast_matched_share", "cast_chance_share")
    )
    down_to = place.matched_down_to_generation
    depth = f"it is matched down to generation {down_to}" if down_to else "not even its first generation is matched"
    return (
        f"Of the cast's length {percent(hit)} lies on it (within {measure(place.rule.tolerance_mm)}{THIN}mm or the "
        f"local radius, like generations), where a cast laid at random would show {percent(by_chance)}; {depth}."
    )


def _totals(subject: Subject) -> Table:
    sides = subject.measured
    paired = subject.comparison is not None and subject.first.analysis is not None
    head = [Cell("", "head")]
    for k, (side, _) in enumerate(sides):
        head += [Cell(side.short)] + ([Cell("difference", "delta")] if paired and k else [])
    body = []
    for key, label, form in _TOTALS:
        body.append(_total_row(label, [analysis.summary[key] for _, analysis in sides], form, paired))
    for key, label in _COVERAGE:
        found = [None if analysis.coverage is None else analysis.coverage[key] for _, analysis in sides]
        if not all(missing(value) for value in found):
            body.append(_total_row(label, found, measure, paired))
    beside = " side by side, and the difference of each tree to the cast: in percent, from tenfold on as a factor"
    caption = f"Totals{beside if paired else ''}."
    return Table(caption, [head], body, "tables/totals.csv" if paired else "report.json")


def _total_row(label: str, values: list[Any], form: Format, paired: bool) -> list[Cell]:
    row = [Cell(label, "head")]
    for k, value in enumerate(values):
        row.append(Cell(form(value)))
        if paired and k:
            row.append(Cell(change(_relative(value, values[0])), "delta"))
    return row


def _relative(value: Any, base: Any) -> Any:
    return None if missing(value) or missing(base) or base == 0 else (value - base) / base


def key_statistics(subject: Subject, figures: Path) -> Section:
    caption = (
        "Number of vessels (segments), mean radius, mean branching ratio and mean length by generation; thin bars are "
        "one standard deviation, as far as values can lie. The ratio is that of the junctions which a generation "
        "feeds, so that the last has none."
    )
    quoted = [Text(f"{side.label}: {side.citation}", "note") for side in subject.sides if side.citation]
    pictures = panels.key_statistics(subject, figures)
    return Section("key-statistics", "Key statistics", [Figure(caption, pictures, two=True), *quoted])


_BY_GENERATION: dict[str, tuple[tuple[str, str, str | None, Format], ...]] = {
    "Number and total length of the vessels by generation (root 1).": (
        ("n_segments", "segments", None, count),
        ("n_elements", "elements", None, count),
        ("total_length_mm", "total length (mm)", None, measure),
    ),
    "Size of the vessels by generation (root 1).": (
        ("radius_mean_mm", "radius (mm)", "radius_sd_mm", measure),
        ("length_mean_mm", "length (mm)", "length_sd_mm", measure),
        ("branching_ratio_mean", "branching ratio", "branching_ratio_sd", measure),
    ),
}


def generations(subject: Subject) -> Section:
    paired = bool(subject.trees)
    words = "Mean ± standard deviation of the segments" + (
        ", and the difference Δ of each tree to the cast; NAME marks what a side does not have." if paired else "."
    )
    blocks: list[Any] = [Text(words.replace("NAME", NONE))]
    for caption, measures in _BY_GENERATION.items():
        groups = [
            _generation_group(subject, column, label, sd, form)
            for column, label, sd, form in measures
            if any(column in side.generations for side in subject.sides)
        ]
        beside = 15 if all(sd is None for _, _, sd, _ in measures) else 12
        for part in fitting(groups, beside):
            more = "" if part[0] is groups[0] else f" Continued: {', '.join(label for label, _, _ in part)}."
            blocks.append(_joined(caption + more, part, subject))
    return Section("generations", "By generation", blocks)


def fitting(groups: list[_Group], beside: int) -> list[list[_Group]]:
    """The groups in runs of at most ``beside`` columns, so that a page takes them; a wider group stands alone."""
    runs: list[list[_Group]] = []
    for group in groups:
        if runs and sum(len(head) for _, head, _ in [*runs[-1], group]) <= beside:
            runs[-1].append(group)
        else:
            runs.append([group])
    return runs


def _generation_group(subject: Subject, column: str, label: str, sd: str | None, form: Format) -> _Group:
    """The columns of one measure, of every side and with the differences."""
    head: list[Cell] = []
    body: dict[int, list[Cell]] = {generation: [] for generation in _all_generations(subject)}
    base = _column(subject.first, column)
    for side in subject.sides:
        mean = _column(side, column)
        spreads = _column(side, sd) if sd else {}
        against = side.series.role == "tree"
        head += [Cell(side.short)] + ([Cell("Δ", "delta")] if against else [])
        for generation, cells in body.items():
            value = mean.get(generation)
            if value is None and column.startswith("n_") and side.analysis is not None:
                value = 0
            cells.append(Cell(spread(value, spreads.get(generation)) if sd else form(value)))
            if against:
                cells.append(Cell(change(_relative(value, base.get(generation))), "delta"))
    return label, head, body


def _joined(caption: str, groups: list[_Group], subject: Subject) -> Table:
    head = two_rows("generation", [(label, cells) for label, cells, _ in groups])
    body = [
        [Cell(str(generation), "head"), *(cell for _, _, rows in groups for cell in rows[generation])]
        for generation in _all_generations(subject)
    ]
    files = "tables/generations.csv" + (", tables/differences.csv" if subject.comparison is not None else "")
    return Table(caption, head, body, files)


def two_rows(first: str, groups: Sequence[tuple[str, Sequence[Cell]]]) -> list[list[Cell]]:
    """The head of a table of groups of columns below the name of each; one row where every group has one column."""
    if all(len(cells) == 1 for _, cells in groups):
        return [[Cell(first, "head"), *(Cell(label) for label, _ in groups)]]
    top = [Cell("", "head"), *(Cell(label, "group", len(cells)) for label, cells in groups)]
    return [top, [Cell(first, "head"), *(cell for _, cells in groups for cell in cells)]]


def _all_generations(subject: Subject) -> list[int]:
    return sorted({int(value) for side in subject.sides for value in side.generations["generation"]})


def _column(side: Side, column: str) -> dict[int, Any]:
    if column not in side.generations:
        return {}
    rows = zip(side.generations["generation"], side.generations[column])
    return {int(generation): value for generation, value in rows if not missing(value)}


def junctions(subject: Subject, figures: Path) -> Section:
    title = "Trifurcations and monopodial branches"
    if not subject.measured:
        return Section("junctions", title, [Text("There is no measured tree.", "empty")])
    moves = (
        "How the count of monopodial branches moves with its thresholds: with the ratio of radii along the axis, with "
        "the angle within which the sibling goes on (lines), and with the angle at which the branch leaves (bands: "
        "90 ± 20° to 90 ± 40°, the line 90 ± 30°). The upright line marks the ratio used; scales differ between trees."
    )
    blocks = [
        Text(monopodial_rule(subject.measured[0][1].parameters["monopodial"])),
        Figure("Trifurcations and monopodial branches per junction.", panels.junctions(subject, figures)),
        _junction_table(subject),
        Figure(moves, panels.sensitivity(subject, figures)),
        _threshold_table(subject),
    ]
    return Section("junctions", title, blocks)


def _junction_table(subject: Subject) -> Table:
    measures = ("n_junctions", "n_trifurcations", "n_monopodial")
    names = ("junctions", "trifurcations", "monopodial branches")
    tables = [_by_generation(analysis.generations) for _, analysis in subject.measured]
    head = two_rows("generation", [(name, [Cell(side.short) for side, _ in subject.measured]) for name in names])
    body = [
        [
            Cell(str(generation), "head"),
            *(Cell(count(table.get(generation, {}).get(name, 0))) for name in measures for table in tables),
        ]
        for generation in sorted(set().union(*tables))
    ]
    return Table("Junctions by the generation that feeds them.", head, body, "tables/generations.csv")


def _by_generation(frame: pd.DataFrame) -> dict[int, dict[Any, Any]]:
    return {int(row["generation"]): row for row in frame.to_dict("records")}


def _threshold_table(subject: Subject) -> Table:
    tables = [(side.short, analysis.monopodial_sensitivity) for side, analysis in subject.measured]
    head = [Cell("", "head"), *(Cell(name) for name, _ in tables)]
    body = [
        [Cell(words, "head"), *(Cell(count(getattr(table["n_monopodial"], how)())) for _, table in tables)]
        for words, how in (("fewest", "min"), ("median", "median"), ("most", "max"))
    ]
    caption = f"Monopodial branches over all {len(tables[0][1])} combinations of thresholds."
    return Table(caption, [head], body, "tables/monopodial-sensitivity.csv")
