"""``vascval analyze``."""

from __future__ import annotations

from pathlib import Path

import click

from vascval.cli import sources
from vascval.cli.console import progress, say, write_json
from vascval.cli.options import Selection, json_option, unit_option, volume_options
from vascval.cli.summary import generations_table, image_table, totals_table


@click.command(
    short_help="Statistics of one tree or volume",
    epilog="""\b
Examples:
  vascval analyze tree.vtp
  vascval analyze cast.nrrd --label 1 -o cast-statistics --json cast.json
  vascval analyze tree.swc --unit um --json - | jq .summary
""",
)
@click.argument("source", metavar="VOLUME_OR_TREE", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    "directory",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Write the report there: report.html, figures, tables as CSV, report.json.",
)
@json_option
@volume_options
@unit_option
def analyze(
    source: Path, directory: Path | None, json_file: str | None, selection: Selection, unit: str | None
) -> None:
    """Measure one tree: totals, and statistics by generation, order, segment and junction.

    A volume is skeletonized first. The totals and the table by generation are printed; -o writes everything.
    """
    sources.kind(source)
    if directory is not None:
        sources.check_directory(directory)
    sources.check_json(json_file, [source])
    from vascval.io.provenance import provenance

    origin = provenance(command="analyze", config={**selection.config(), "unit": unit}, seed=None, inputs=[source])
    with progress() as observer:
        measured = sources.measure(source, source.name, selection, unit, observer)
        if directory is not None:
            from vascval.report.write import write_analysis_report

            write_analysis_report(measured.analysis, directory, provenance=origin, skeleton=measured.skeleton)
    document = measured.analysis.document()
    if json_file != "-":
        say(totals_table({source.name: document}))
        say("\n" + generations_table(document))
        if measured.skeleton is not None:
            say("\n" + image_table(document["image"]))
        if directory is not None:
            say(f"\nreport: {directory / 'report.html'}")
    if json_file is not None:
        write_json({**document, "provenance": origin}, json_file)
