"""Reports on disk: ``report.html``, ``figures/``, ``tables/`` and ``report.json``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from vascval.comparison import Comparison
from vascval.imaging import Skeleton
from vascval.io.atomic import atomic_directory
from vascval.morphometry import Analysis
from vascval.report import content
from vascval.report.files import write_tables
from vascval.report.page import render
from vascval.report.subject import Subject, of_analysis, of_comparison
from vascval.report.twin_section import Twin


def write_compare_report(
    comparison: Comparison,
    directory: Path,
    *,
    provenance: Mapping[str, Any],
    skeleton: Skeleton | None = None,
    twin: Twin | None = None,
) -> None:
    """The report of a cast against trees into ``directory``, all of it or nothing.

    :param provenance: :func:`vascval.io.provenance.provenance`; shown, and part of ``report.json``.
    :param skeleton: of the cast, where it is a volume: its surface and what was cut and pruned are shown.
    :param twin: what the trees were grown from, if they were grown after the cast.
    :raises InputError: when the directory cannot be written.
    """
    document = {**comparison.document(), "provenance": dict(provenance)}
    if twin is not None:
        document["twin"] = dict(twin.facts)
    _write(of_comparison(comparison, skeleton, provenance, twin), document, Path(directory))


def write_analysis_report(
    analysis: Analysis, directory: Path, *, provenance: Mapping[str, Any], skeleton: Skeleton | None = None
) -> None:
    """The report of one tree; see :func:`write_compare_report`."""
    document = {**analysis.document(), "provenance": dict(provenance)}
    _write(of_analysis(analysis, skeleton, provenance), document, Path(directory))


def _write(subject: Subject, document: Mapping[str, Any], directory: Path) -> None:
    with atomic_directory(directory) as work:
        figures, tables = work / "figures", work / "tables"
        figures.mkdir()
        tables.mkdir()
        write_tables(subject, tables)
        text = json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        (work / "report.json").write_text(text, encoding="utf-8")
        page = render(
            content.title(subject),
            content.subtitle(subject),
            content.sections(subject, figures),
            version=str(subject.provenance.get("version", "")),
            legend=content.legend(subject),
        )
        (work / "report.html").write_text(page, encoding="utf-8")
