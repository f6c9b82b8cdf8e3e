"""What the page says: its title, its legend and its sections in order."""

from __future__ import annotations

from pathlib import Path

from vascval.report import (
    check_section,
    comparison_sections,
    order_sections,
    organ_section,
    origin_sections,
    tree_sections,
    twin_section,
)
from vascval.report.page import Section
from vascval.report.subject import Side, Subject
from vascval.report.swatches import Swatch, swatch


def title(subject: Subject) -> str:
    if subject.comparison is None:
        return f"Morphometry of {subject.first.label}"
    return f"{subject.first.label} against {', '.join(side.label for side in subject.trees)}"


def subtitle(subject: Subject) -> str:
    if subject.comparison is None:
        return "One vascular tree, measured"
    return "A vascular cast and synthetic trees, measured by one definition each and held side by side"


def legend(subject: Subject) -> list[Swatch]:
    """What each colour, line and marker stands for; none where there is only one tree."""
    if subject.comparison is None:
        return []
    return [swatch(side.series, _role(side)) for side in subject.sides]


def _role(side: Side) -> str:
    if side.analysis is not None:
        return side.short
    return "published table" if side.short == "table" else f"{side.short}: a published table"


def sections(subject: Subject, figures: Path) -> list[Section]:
    """All sections in the order of the page; their figures are written into ``figures`` on the way."""
    found = [
        tree_sections.summary(subject),
        *([] if subject.twin is None else [twin_section.twin(subject, subject.twin, figures)]),
        tree_sections.key_statistics(subject, figures),
        origin_sections.overlay(subject, figures),
        tree_sections.generations(subject),
        order_sections.orders(subject, figures),
        order_sections.horton(subject),
        organ_section.organs(subject),
        tree_sections.junctions(subject, figures),
    ]
    if subject.comparison is not None:
        found += [
            comparison_sections.distributions(subject, subject.comparison, figures),
            comparison_sections.location(subject, subject.comparison, figures),
            comparison_sections.territories(subject, subject.comparison, figures),
        ]
    return [
        *found,
        origin_sections.image(subject),
        check_section.section(subject),
        origin_sections.notes(subject),
        origin_sections.provenance(subject),
        origin_sections.definitions(subject),
    ]
