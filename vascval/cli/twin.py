"""``vascval twin``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vascval.cli import sources
from vascval.cli.console import Observer, note, progress, say, write_json
from vascval.cli.keeping import Keeping
from vascval.cli.options import Finite, Selection, checkpoint_options, json_option, unit_option, volume_options
from vascval.cli.sources import Measured
from vascval.cli.summary import comparison_tables
from vascval.cli.twin_kept import Parts
from vascval.core.errors import InputError

if TYPE_CHECKING:
    from generator.config import Config

_LENGTH = Finite(min=0, min_open=True)


@dataclass(frozen=True)
class Wishes:
    """What was asked for, beside the cast."""

    domain: Path | None
    hull_radius_mm: float | None
    hull_margin_mm: float | None
    root_generations: int
    changes: tuple[str, ...]

    def config(self) -> dict[str, Any]:
        """For the provenance."""
        name = None if self.domain is None else self.domain.name
        return {**asdict(self), "domain": name, "changes": list(self.changes)}


@click.command(
    short_help="A cast against trees grown in its place",
    epilog="""\b
Examples:
  vascval twin cast.nrrd -o twin
  vascval twin portal-vein.nrrd --domain liver.nrrd -o twin --json twin.json
  vascval twin ct.nii.gz --label 64 --domain ct.nii.gz --set domain.label=5 -o twin
  vascval twin cast.vtp -o twin --root-generations 2 --set seed=7 --set n_terminals=500

\b
DIR holds the report (report.html opens offline; figures/, tables/, report.json), the
three trees as cast.vtp, cco.vtp and optimised.vtp, and the perfusion volume as
domain.nrrd (or as the surface that was given). Ctrl-C leaves a checkpoint beside DIR:
  vascval twin cast.nrrd -o twin --resume twin.checkpoint
It is removed when all is done.
""",
)
@click.argument("cast", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", "directory", type=click.Path(path_type=Path), required=True, metavar="DIR",
    help="Where everything goes.",
)  # fmt: skip
@click.option(
    "--domain", type=click.Path(path_type=Path), metavar="FILE",
    help="The perfusion volume: a mask or label volume, or a closed surface, in the world frame of the cast. Gaps in a "
    "volume that the cast's thickest vessel fits are closed (--set domain.closing_mm=0: none).  [default: a closed "
    "hull of the cast]",
)  # fmt: skip
@click.option(
    "--hull-radius", "hull_radius_mm", type=_LENGTH, metavar="MM",
    help="Concavities of the hull narrower than twice this are closed.  [default: 2 mean distances of terminals]",
)  # fmt: skip
@click.option(
    "--hull-margin", "hull_margin_mm", type=_LENGTH, metavar="MM",
    help="How far the hull goes beyond the vessels.  [default: half a mean distance of terminals]",
)  # fmt: skip
@click.option(
    "--root-generations", type=click.IntRange(min=0), default=0, metavar="K",
    help="The grown trees are given the first K generations of the cast, with their radii.  [default: 0, the root "
    "alone]",
)  # fmt: skip
@click.option(
    "--set", "changes", multiple=True, metavar="KEY=VALUE",
    help="Change a key of the portal-vein preset, such as seed=7, n_terminals=500 or perfusion.flow_ml_min=800; may "
    "be repeated.  [default of n_terminals: as many as the cast has]",
)  # fmt: skip
@checkpoint_options(
    "the measured cast and the trees are kept while they are made",
    "DIR.checkpoint, beside DIR",
    "give the same cast and options.",
)
@json_option
@volume_options
@unit_option
def twin(
    cast: Path,
    directory: Path,
    domain: Path | None,
    hull_radius_mm: float | None,
    hull_margin_mm: float | None,
    root_generations: int,
    changes: tuple[str, ...],
    checkpoint: Path | None,
    every_s: float,
    resume: Path | None,
    json_file: str | None,
    selection: Selection,
    unit: str | None,
) -> None:
    """Grow two trees in the place of CAST and compare all three.

    Perfusion volume, root and number of terminals are the cast's; flow and pressures those of the preset portal-vein.
    One tree is grown by constrained constructive optimisation alone, the other with geometry and topology optimised
    as well, with the same seed. CAST is a segmented volume or a tree.
    """
    from vascval.cli import twin_parts as parts
    from vascval.io.atomic import atomic_directory
    from vascval.io.provenance import provenance

    wishes = Wishes(domain, hull_radius_mm, hull_margin_mm, root_generations, changes)
    checkpoint = checkpoint or resume or directory.with_name(f"{directory.name}.checkpoint")
    inputs = [cast, *([] if domain is None else [domain])]
    chosen = {**selection.config(), "unit": unit, **wishes.config()}
    _check(cast, directory, json_file, wishes, selection)
    sources.check_file(checkpoint, inputs)
    configs = parts.configurations(changes, has_file=domain is not None)
    kept = Parts()
    keeping = Keeping(kept, provenance(command="twin", config=chosen, seed=None, inputs=inputs), checkpoint, every_s)
    keeping.begin(resume)
    try:
        with progress() as observer, atomic_directory(directory) as work:
            keeping.write()  # so that there is one from the first moment on
            with sources.about(cast):
                measured = kept.measured(cast.name)
            if measured is None:
                measured = sources.measure(cast, cast.name, selection, unit, observer)
                kept.keep(measured)
                keeping.write()
            document = _twin(inputs, measured, wishes, configs, kept, keeping, work, observer, chosen)
    except BaseException as error:
        if resume is None and not kept.helps(error):
            keeping.end()
        raise
    keeping.end()
    if json_file != "-":
        say(comparison_tables(document))
        say(f"\nreport: {directory / 'report.html'}")
    if json_file is not None:
        write_json(document, json_file)


def _check(cast: Path, directory: Path, json_file: str | None, wishes: Wishes, selection: Selection) -> None:
    """Refuses inputs of a wrong kind, and outputs that could not be written, before anything is read."""
    if sources.kind(cast) == "table":
        raise InputError(f"{cast}: is a table, and a volume or a tree is needed here; see vascval compare for tables")
    if sources.kind(cast) == "tree" and selection.given():
        raise InputError(f"{cast}: is no volume, so {', '.join(selection.given())} cannot apply; leave it out")
    inputs = [cast]
    if wishes.domain is not None:
        if not wishes.domain.exists():
            raise InputError(f"{wishes.domain}: no such file; check --domain")
        if wishes.hull_radius_mm is not None or wishes.hull_margin_mm is not None:
            raise InputError("--domain and --hull-radius or --hull-margin exclude each other; give one")
        inputs.append(wishes.domain)
    sources.check_directory(directory)
    for path in inputs:
        if directory.is_dir() and path.exists() and path.parent.samefile(directory) and path.name in _WRITTEN:
            raise InputError(f"{path}: is an input and would be overwritten; choose another directory with -o")
    sources.check_json(json_file, inputs)


_WRITTEN = ("cast.vtp", "cco.vtp", "optimised.vtp", "root-tree.vtp", "domain.nrrd", "domain.stl", "domain.obj",
            "domain.vtk", "domain.vtp")  # fmt: skip


def _twin(
    inputs: list[Path],
    measured: Measured,
    wishes: Wishes,
    configs: Mapping[str, Config],
    kept: Parts,
    keeping: Keeping,
    work: Path,
    observer: Observer | None,
    chosen: Mapping[str, Any],
) -> dict[str, Any]:
    """Everything into ``work``; the document of the result."""
    import numpy as np

    from vascval.cli import twin_parts as parts
    from vascval.cli.twin_outcome import Outcome
    from vascval.morphometry import analyze

    path, whole = inputs[0], measured.analysis.tree
    config = next(iter(configs.values()))
    if wishes.domain is not None:
        ground = parts.given_ground(wishes.domain, config, whole, work)
    else:
        ground = parts.hull_ground(whole, path, wishes.hull_radius_mm, wishes.hull_margin_mm, work)
    start = parts.start(whole, path, ground)
    for sentence in (*ground.domain.notes, *start.notes):
        note(sentence)
    tissue = ground.domain.sample(parts.TISSUE_POINTS, np.random.default_rng(0))
    filled: dict[str, Any] = {"tissue_mm": tissue, "tissue_volume_mm3": ground.domain.volume_mm3}
    name = f"{path.name} (cast)" if path.stem in configs else path.name
    cast = analyze(start.cast, source=name, image=measured.analysis.image, **filled)
    given = parts.root_tree(cast.tree, wishes.root_generations) if wishes.root_generations else None
    placed = parts.placed(configs, wishes.changes, ground, start, cast.summary["n_terminals"], given)
    runs = {name: parts.grown(name, config, kept, keeping, observer) for name, config in placed.items()}
    trees = [analyze(run.tree(), source=name, **filled) for name, run in runs.items()]
    outcome = Outcome(
        whole, measured.skeleton, cast, trees, runs, given, wishes.root_generations, ground, start, inputs
    )
    return outcome.write(work, chosen, observer)
