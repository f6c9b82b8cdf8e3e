"""What the page says, section by section."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from vascval.report import panels
from vascval.report.numbers import count, measure
from vascval.report.page import Cell, Figure, Items, Section, Table, Text
from vascval.report.subject import Subject


def title(subject: Subject) -> str:
    if subject.comparison is None:
        return f"Morphometry of {subject.first.label}"
    return f"{subject.first.label} against {', '.join(side.label for side in subject.trees)}"


def subtitle(subject: Subject) -> str:
    if subject.comparison is None:
        return "One vascular tree, measured"
    return "A vascular cast and synthetic trees, measured alike and held side by side"


def legend(subject: Subject) -> Sequence[Any]:
    return []


def sections(subject: Subject, figures: Path) -> list[Section]:
    """All sections in the order of the page; figures are written on the way."""
    return [
        Section("summary", "Summary", [totals(subject)]),
        Section(
            "key-statistics",
            "Key statistics",
            [
                Figure("By generation; bars are one standard deviation.", panels.key_statistics(subject, figures)),
                *(Text(f"{side.label}: {side.citation}", "note") for side in subject.sides if side.citation),
            ],
        ),
        Section("provenance", "Provenance", [Items([(k, str(v)) for k, v in subject.provenance.items()])]),
    ]


TOTALS = (
    ("n_terminals", "terminals", count),
    ("n_segments", "segments", count),
    ("n_bifurcations", "bifurcations", count),
    ("n_trifurcations", "trifurcations", count),
    ("n_trifurcations_first_7", "\N{EN SPACE}in the first 7 generations", count),
    ("n_multifurcations", "junctions of four and more", count),
    ("n_monopodial", "monopodial branches", count),
    ("n_elements", "elements", count),
    ("max_order", "Strahler order of the root", count),
    ("total_length_mm", "total length (mm)", measure),
    ("volume_mm3", "volume (mm³)", measure),
)


def totals(subject: Subject) -> Any:
    measured = subject.measured
    if not measured:
        return Text("There is no measured tree.", "empty")
    head = [Cell("", "head")] + [Cell(side.label) for side, _ in measured]
    body = []
    for key, label, form in TOTALS:
        body.append([Cell(label, "head")] + [Cell(form(analysis.summary[key])) for _, analysis in measured])
    return Table("Totals", [head], body, "tables/totals.csv")
