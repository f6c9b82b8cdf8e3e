"""``vascval compare``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vascval.cli import sources
from vascval.cli.console import progress, say, write_json
from vascval.cli.options import Finite, Selection, json_option, unit_option, volume_options
from vascval.cli.sources import Measured
from vascval.cli.summary import comparison_tables
from vascval.core.errors import InputError

if TYPE_CHECKING:
    from vascval.comparison import Comparison
    from vascval.io.documents import ReferenceTable

DIRECTORY = "vascval-compare"


@click.command(
    short_help="A cast against trees: the report",
    epilog=f"""\b
Examples:
  vascval compare cast.nrrd tree.vtp
  vascval compare ct.nii.gz --label 64 cco.vtp optimised.vtp -o report --json report.json
  vascval compare cast.vtp tree.vtp --reference published.csv
  vascval compare published.csv tree.vtp

\b
The report is a directory (default {DIRECTORY}, in the current one): report.html, one
file that opens offline; figures/ as SVG and PNG; tables/ as CSV; report.json; and
the tree of the cast as cast.vtp. With --json alone no directory is written.
""",
)
@click.argument("cast", type=click.Path(path_type=Path))
@click.argument("trees", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="TREE...")
@click.option(
    "-o", "--output", "directory", type=click.Path(path_type=Path), metavar="DIR", help="Where the report goes."
)
@json_option
@click.option(
    "--reference",
    type=click.Path(path_type=Path),
    metavar="CSV",
    help="A published table by generation, shown beside the cast.",
)
@click.option(
    "--tolerance",
    "tolerance_mm",
    type=Finite(min=0, min_open=True),
    metavar="MM",
    help="Vessels this near lie in one place.  [default: 1 % of the diagonal of the cast's bounding box]",
)
@volume_options
@unit_option
def compare(
    cast: Path,
    trees: tuple[Path, ...],
    directory: Path | None,
    json_file: str | None,
    reference: Path | None,
    tolerance_mm: float | None,
    selection: Selection,
    unit: str | None,
) -> None:
    """Report CAST against one or more TREEs, generation by generation and place by place.

    CAST is a segmented volume, a tree, or a published table by generation (CSV). Volume and trees must be in one
    world frame, in mm, for what compares positions; the rest holds in any frame.
    """
    if directory is None and json_file is None:
        directory = Path(DIRECTORY)
    inputs = [cast, *trees, *([reference] if reference else [])]
    _check(cast, trees, reference, selection)
    if directory is not None:
        sources.check_directory(directory)
    sources.check_json(json_file, inputs)
    from vascval.comparison import compare as run
    from vascval.io.documents import read_reference_table
    from vascval.io.provenance import provenance

    names = sources.names(trees)
    cast_name = cast.name if cast.name not in names else f"{cast.name} (cast)"
    config = {**selection.config(), "unit": unit, "tolerance_mm": tolerance_mm}
    origin = provenance(command="compare", config=config, seed=None, inputs=inputs)
    with progress() as observer:
        published = read_reference_table(reference) if reference else None
        found = [sources.measure(path, name, Selection(), unit, observer) for path, name in zip(trees, names)]
        against: ReferenceTable | Measured
        if sources.kind(cast) == "table":
            against = read_reference_table(cast)
        else:
            against = sources.measure(cast, cast_name, selection, unit, observer)
        comparison = run(
            against.analysis if isinstance(against, Measured) else against,
            [tree.analysis for tree in found],
            reference=published,
            tolerance_mm=tolerance_mm,
            observer=observer,
        )
        if directory is not None:
            write_report(comparison, directory, origin, against)
    announce(comparison, directory, json_file, origin)


def _check(cast: Path, trees: Sequence[Path], reference: Path | None, selection: Selection) -> None:
    """Refuses inputs of a wrong kind before any is read."""
    if sources.kind(cast) != "volume" and selection.given():
        raise InputError(f"{cast}: is no volume, so {', '.join(selection.given())} cannot apply; leave it out")
    for path in trees:
        sources.require(path, "tree", f"first: vascval skeletonize {path} -o {path.stem}.vtp")
    if reference is not None:
        sources.require(reference, "table", "give a CSV table by generation")


def write_report(
    comparison: Comparison, directory: Path, origin: Mapping[str, Any], against: Measured | ReferenceTable
) -> None:
    """The report and, unless the cast is a table, its tree: all of it or nothing."""
    from vascval.io.atomic import atomic_directory
    from vascval.io.trees import write_vtp
    from vascval.report.write import write_compare_report

    with atomic_directory(directory) as work:
        skeleton = against.skeleton if isinstance(against, Measured) else None
        write_compare_report(comparison, work, provenance=origin, skeleton=skeleton)
        if isinstance(against, Measured):
            write_vtp(against.analysis.tree, work / "cast.vtp", provenance=origin)


def announce(comparison: Comparison, directory: Path | None, json_file: str | None, origin: Mapping[str, Any]) -> None:
    """Prints the short tables and where the report is, or the JSON document."""
    document = comparison.document()
    if json_file != "-":
        say(comparison_tables(document))
        if directory is not None:
            say(f"\nreport: {directory / 'report.html'}")
    if json_file is not None:
        write_json({**document, "provenance": origin}, json_file)
