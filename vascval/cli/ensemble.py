"""``vascval ensemble``."""

from __future__ import annotations

import os
import threading
import time
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vascval.cli import sources
from vascval.cli.console import Observer, note, progress, say, table, write_json
from vascval.cli.interruption import held_back
from vascval.cli.options import json_option
from vascval.core.errors import ComputationError

if TYPE_CHECKING:
    from distributed import Client

    from generator.config import Config
    from generator.ensemble.log import Log
    from generator.ensemble.manifest import Manifest
    from generator.ensemble.plan import Order, Plan
    from generator.ensemble.work import Failed, Grown
    from vascval.core.tree import Tree


@click.command(
    short_help="Grow many trees: seeds and grids of parameters",
    epilog="""\b
Examples:
  vascval ensemble karch-box --seeds 10 --set n_terminals=500 -o study
  vascval ensemble karch-box --seeds 5 --vary gamma=2.5,3 --vary method=cco,geometry -o study
  vascval ensemble my.toml --seeds 200 -o study --scheduler tcp://10.0.0.1:8786

\b
DIR holds trees/, tables/, report.html, report.json, log and manifest.json. The same call again makes
only the trees that are missing; with more seeds or values it adds to what is there.
Ctrl-C keeps the trees that are done.
""",
)
@click.argument("config", metavar="PRESET_OR_TOML")
@click.option("--seeds", type=int, required=True, metavar="N", help="So many seeds, from the configuration's on.")
@click.option(
    "-o", "--output", "directory", type=click.Path(path_type=Path), required=True, metavar="DIR",
    help="Where everything goes.",
)  # fmt: skip
@click.option(
    "--set", "changes", multiple=True, metavar="KEY=VALUE",
    help="Change a key of the configuration, as of 'vascval generate'; may be repeated.",
)  # fmt: skip
@click.option(
    "--vary", multiple=True, metavar="KEY=V1,V2,...",
    help="All seeds for each of these values; several of them make a grid. Values with commas are set apart by ';'.",
)  # fmt: skip
@click.option("--scheduler", metavar="ADDRESS", help="Workers of this Dask scheduler, such as tcp://10.0.0.1:8786.")
@click.option(
    "--workers", type=click.IntRange(min=1), metavar="N",
    help="Processes on this machine.  [default: one per processor]",
)  # fmt: skip
@click.option(
    "--checkpoint", type=click.Path(path_type=Path), metavar="FILE",
    help="Where the manifest is.  [default: manifest.json in DIR]",
)  # fmt: skip
@json_option
def ensemble(
    config: str, seeds: int, directory: Path, changes: tuple[str, ...], vary: tuple[str, ...], scheduler: str | None,
    workers: int | None, checkpoint: Path | None, json_file: str | None,
) -> None:  # fmt: skip
    """Grow many trees, on local processes or a Dask cluster, and report how they spread.

    Each tree is what 'vascval generate' makes of the same configuration and seed, whatever the workers.
    """
    if scheduler is not None and workers is not None:
        raise click.UsageError("--scheduler and --workers exclude each other; give one")
    sources.check_directory(directory, adds=True)
    sources.check_json(json_file)
    if checkpoint is not None:
        sources.check_file(checkpoint)
    from generator.ensemble.log import logged
    from generator.ensemble.manifest import Manifest
    from generator.ensemble.plan import plan

    planned = plan(config, changes, vary, seeds)
    _check_inputs(planned)
    manifest = Manifest.of(planned, checkpoint or directory / "manifest.json", directory)
    with logged() as log:
        effort = _make(planned, manifest, log, scheduler, workers)
        document = _report(planned, manifest, effort, directory)
        log.say(f"report of {document['n_done']} trees")
    if json_file != "-":
        say(_summary(document))
        say(f"\nreport: {directory / 'report.html'}")
    if json_file is not None:
        write_json(document, json_file)
    if document["n_done"] < document["n_trees"]:
        raise _failure(planned, manifest)


@dataclass
class Effort:
    """What a call took: trees made, seconds of wall time, trees made at once."""

    n_made: int = 0
    seconds: float = 0.0
    n_workers: int = 0


def _check_inputs(planned: Plan) -> None:
    """Refuses wrong files and values before anything starts; each domain is tried once."""
    from generator.framework import Run

    seen: set[str] = set()
    for order in planned.orders:
        config = order.config
        where = repr((config.domain, config.root_mm, config.root_tree, config.terminals_file))
        if where not in seen:
            seen.add(where)
            for sentence in Run.of(config).domain.notes:
                note(sentence)


def _make(planned: Plan, manifest: Manifest, log: Log, scheduler: str | None, workers: int | None) -> Effort:
    """Makes what is missing; an interruption leaves the manifest as it should be."""
    from generator.ensemble.running import warm
    from generator.ensemble.workers import connected, n_threads

    missing, effort = manifest.missing(planned), Effort()
    there = len(planned.orders) - len(missing)
    if there:
        note(f"{_trees(there)} of {len(planned.orders)} there already")
    if not missing:
        log.begin(manifest.folder / "log")
        return effort
    with progress() as observer, ExitStack() as stack:
        if observer is not None:
            observer("starting workers", 0, len(missing))
        threading.Thread(target=_load_report).start()
        with held_back(unless=lambda: scheduler is not None) as held:  # what has half begun cannot be closed
            try:
                client = stack.enter_context(connected(scheduler, min(workers or os.cpu_count() or 1, len(missing))))
            finally:
                held.release()
        manifest.folder.mkdir(exist_ok=True)
        log.begin(manifest.folder / "log")
        manifest.write()
        effort.n_workers = n_threads(client)
        at = "here" if scheduler is None else f"at {scheduler}"
        log.say(f"{len(missing)} of {len(planned.orders)} trees to make, {effort.n_workers} at once, {at}")
        for reason in warm(client, missing[0], measured):
            log.say(f"kernels were not compiled beforehand: {reason}")
        began = time.perf_counter()
        try:
            effort.n_made = _drive(client, missing, len(planned.orders), manifest, log, observer)
        except KeyboardInterrupt:
            left = len(manifest.missing(planned))
            log.say(f"interrupted, {left} trees missing")
            note(f"{_trees(len(planned.orders) - left)} of {len(planned.orders)} there; call again for the rest")
            raise
        effort.seconds = time.perf_counter() - began
    return effort


def _load_report() -> None:
    """Loads what the report is made by, which takes a second, while others work."""
    import matplotlib.figure  # noqa: F401

    import vascval.report.ensemble  # noqa: F401


_SHOWN = ("n_terminals", "n_segments", "n_trifurcations", "total_length_mm", "volume_mm3")


def _drive(
    client: Client, missing: list[Order], n_trees: int, manifest: Manifest, log: Log, observer: Observer | None
) -> int:
    """Keeps each tree as it comes, with the bar and the log; how many were made."""
    from generator.ensemble.running import Begun, Deserted, Share, run
    from generator.ensemble.work import Grown

    shares: dict[str, float] = {}
    n_made, n_there = 0, n_trees - len(missing)
    with closing(run(client, missing, measured)) as events:
        for event in events:
            if isinstance(event, Begun):
                again = " again, its worker was lost" if event.again else ""
                log.say(f"{event.name}: begun{again} on {event.worker}")
                shares[event.name] = 0.0
            elif isinstance(event, Deserted):
                log.say("no workers left, waiting for some")
                note("no workers left; waiting for some")
            elif isinstance(event, Share):
                shares[event.name] = event.share
            else:
                with held_back(unless=lambda: False) as held:  # files without an entry in the manifest are lost
                    manifest.keep(event.order, event.result)
                    log.say(f"{event.order.name}: {_said(event.result)}")
                held.release()
                shares[event.order.name] = 1.0
                n_made += isinstance(event.result, Grown)
            if observer is not None:
                observer("trees", n_there + sum(shares.values()), n_trees)
    return n_made


def _said(result: Grown | Failed) -> str:
    from generator.ensemble.work import Failed

    if isinstance(result, Failed):
        return f"failed: {result.reason} {result.trace}"
    summary = result.document["summary"]
    return (
        f"done on {result.worker} in {result.seconds:.1f} s: {summary['n_terminals']} terminals, "
        f"{summary['volume_mm3']:.6g} mm^3"
    )


def _report(planned: Plan, manifest: Manifest, effort: Effort, directory: Path) -> dict[str, Any]:
    """Gathers the tables of the trees that are there, writes the report and returns the document."""
    from vascval.io.ensembles import EnsembleDocument
    from vascval.io.provenance import provenance
    from vascval.report.ensemble import document, write_ensemble_report
    from vascval.report.ensemble_tables import Member, gather

    entries = [(order, manifest.tree(order)) for order in planned.orders]
    members = [
        Member(tree.name, tree.case, tree.seed, tree.sha256, manifest.document(order))
        for order, tree in entries
        if tree.sha256 is not None
    ]
    if not members:
        raise _failure(planned, manifest)
    ensemble = gather(members, n_asked=len(planned.orders))
    config = {**_common(planned), "vary": planned.vary, "seeds": planned.n_seeds}
    origin = provenance(command="ensemble", config=config, seed=planned.config.seed, inputs=planned.inputs())
    write_ensemble_report(ensemble, directory, provenance=origin)
    found = {
        **document(ensemble),
        "n_made": effort.n_made,
        "seconds": effort.seconds,
        "n_workers": effort.n_workers,
        "manifest": [tree.model_dump(mode="json") for _, tree in entries],
        "provenance": origin,
    }
    EnsembleDocument.model_validate(found)
    return found


def _common(planned: Plan) -> dict[str, Any]:
    """The configuration without the keys that the grid varies; the seed is the first."""
    from generator.ensemble.plan import flattened

    def dumped(config: Config) -> dict[str, Any]:
        return config.model_dump(mode="json")

    def without(values: dict[str, Any], before: str = "") -> dict[str, Any]:
        kept = {key: value for key, value in values.items() if before + key not in varied}
        return {k: without(v, f"{before}{k}.") if isinstance(v, dict) else v for k, v in kept.items()}

    base = flattened(dumped(planned.config))
    cases = [flattened(dumped(order.config)) for order in planned.orders]
    varied = {key for key in base if key != "seed" and any(case[key] != base[key] for case in cases)}
    return without(dumped(planned.config))


def _failure(planned: Plan, manifest: Manifest) -> ComputationError:
    """What to say of trees that failed."""
    failed = [tree for order in planned.orders if (tree := manifest.tree(order)).state == "failed"]
    return ComputationError(
        f"{_trees(len(failed))} of {len(planned.orders)} failed; {failed[0].name}: {failed[0].error}"
    )


def _summary(document: dict[str, Any]) -> str:
    """The spread of the totals, a block per case."""
    blocks = []
    for case in document["cases"]:
        rows: list[list[object]] = [[case or f"{document['n_done']} trees", "mean", "sd", "median", "least", "most"]]
        for row in document["totals"]:
            if row["case"] == case and row["measure"] in _SHOWN:
                values = (row[name] for name in ("mean", "sd", "median", "min", "max"))
                rows.append([row["measure"], *(_shown(row["measure"], value) for value in values)])
        blocks.append(table(rows))
    return "\n\n".join(blocks)


def _shown(measure: str, value: float | None) -> str:
    """A number; one of things without decimals where it is whole."""
    if value is None:
        return "-"
    return f"{value:,.0f}" if measure.startswith("n_") and value == int(value) else f"{value:,.2f}"


def measured(tree: Tree, source: str) -> dict[str, Any]:
    """What is measured on each tree, by the worker that made it."""
    from vascval.morphometry import analyze

    return analyze(tree, source=source).document()


def _trees(n: int) -> str:
    return f"{n:,} tree{'' if n == 1 else 's'}"
