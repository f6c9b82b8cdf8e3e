"""``vascval generate``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vascval.cli import sources
from vascval.cli.console import note, progress, say, table, write_json
from vascval.cli.keeping import Keeping, grow
from vascval.cli.options import checkpoint_options, json_option
from vascval.core.errors import InputError, VascvalError

if TYPE_CHECKING:
    from generator.framework import Run
    from vascval.core.tree import Tree


@click.command(
    short_help="Grow a tree",
    epilog="""\b
Examples:
  vascval generate karch-box -o tree.vtp --set n_terminals=500
  vascval generate portal-vein -o portal.vtp --set seed=7 --json portal.json
  vascval generate portal-vein -o tree.vtp --set domain.file=liver.nrrd --set root_mm=-12,40,88
  vascval generate karch-box -o tree.vtp --set method=full --history search.svg
  vascval generate my.toml -o tree.vtp

\b
Presets: karch-box (the benchmark box) and portal-vein (a liver-like shape of 1,500 cm^3).
Ctrl-C writes what has grown so far to TREE.vtp, if there is no such file yet, and all
that it takes to go on to the checkpoint, as is done every minute:
  vascval generate my.toml -o tree.vtp --resume tree.vtp.checkpoint
The checkpoint is removed when the tree is done.
""",
)
@click.argument("config", metavar="PRESET_OR_TOML")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), required=True, metavar="TREE.vtp",
    help="The tree; a name in .swc writes SWC instead.",
)  # fmt: skip
@click.option(
    "--set", "changes", multiple=True, metavar="KEY=VALUE",
    help="Change a key of the configuration, such as n_terminals=500 or domain.box_mm=90,70,16; may be repeated.",
)  # fmt: skip
@checkpoint_options("the run is kept while it lasts", "TREE.vtp.checkpoint", "give the same configuration.")
@click.option(
    "--history", type=click.Path(path_type=Path), metavar="FILE",
    help="How the search for topologies went (method=full, its first chain): a table where FILE ends in .csv, a figure "
    "in .svg, .png or .pdf.",
)  # fmt: skip
@json_option
def generate(
    config: str,
    output: Path,
    changes: tuple[str, ...],
    checkpoint: Path | None,
    every_s: float,
    resume: Path | None,
    history: Path | None,
    json_file: str | None,
) -> None:
    """Grow a tree by constrained constructive optimisation: least volume at given flow and pressures.

    The tree holds Poiseuille's and Murray's laws, equal flow and equal pressure at all terminals. The same
    configuration and seed give the same tree, however often the run was interrupted and resumed.
    """
    if output.suffix.lower() not in (".vtp", ".swc"):
        raise click.BadParameter(f"{output} ends in neither .vtp nor .swc", param_hint="-o")
    checkpoint = checkpoint or resume or output.with_name(f"{output.name}.checkpoint")
    if checkpoint.absolute() == output.absolute():
        raise click.BadParameter(f"{checkpoint} is the tree too", param_hint="--checkpoint")
    sources.check_file(output)
    sources.check_file(checkpoint)
    sources.check_json(json_file)
    if history is not None:
        sources.check_file(history)
    from generator.config import load
    from generator.framework import Run
    from vascval.io.provenance import provenance

    run = Run.of(load(config, changes))
    for path in (output, checkpoint, *([] if history is None else [history])):
        sources.check_is_no_input(path, run.inputs())
    for sentence in run.domain.notes:
        note(sentence)
    origin = provenance(
        command="generate", config=run.config.model_dump(mode="json"), seed=run.config.seed, inputs=run.inputs()
    )
    keeping = Keeping(run, origin, checkpoint, every_s)
    keeping.begin(resume)
    if history is not None:
        _check_history(run, history)
    had = output.exists()
    with progress() as observer:
        interrupted = grow(run, keeping, observer)
    if interrupted is not None and had:
        note(f"interrupted at {run.growth.n_grown:,} terminals; {output} is left as it was")
        raise interrupted
    try:
        _write(run, output, origin, history, json_file)
    except VascvalError:
        if interrupted is None:  # else it is written, and the run was left off since: not where to go on from
            keeping.write()
        raise
    if interrupted is not None:
        note(f"interrupted at {run.growth.n_grown:,} terminals; they are in {output}")
        raise interrupted
    keeping.end()


def _check_history(run: Run, path: Path) -> None:
    """Refuses the history of a search that will not be, before the work begins."""
    from vascval.report.search_history import SUFFIXES

    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: a history is written as {', '.join(SUFFIXES)}; choose one of these")
    if run.config.method != "full":
        raise InputError(
            f"--history {path}: method={run.config.method} has no search for topologies; set method=full, or leave "
            "--history out"
        )
    count = min(run.growth.n_terminals, run.config.topology.at)
    if count < 3:
        raise InputError(
            f"--history {path}: {count} terminals have one topology and no search; leave --history out, or let there "
            "be 3 or more (n_terminals, topology.at)"
        )


def _write(run: Run, output: Path, origin: Mapping[str, Any], history: Path | None, json_file: str | None) -> None:
    from vascval.io.trees import write_tree

    tree = run.tree()
    write_tree(tree, output, provenance=origin, claims=run.claims(tree))
    if history is not None:
        _write_history(run, history)
    document = _document(run, tree)
    if json_file != "-":
        say(table([["", "value"], *([name, _shown(document[name])] for name in _SHOWN)]))
        say(f"\ntree: {output}")
    if json_file is not None:
        write_json({**document, "provenance": origin}, json_file)


def _write_history(run: Run, path: Path) -> None:
    from vascval.report.search_history import history_table, write_search_history

    steps = run.topology.history
    if not steps:  # interrupted before
        note(f"the search has not begun, so {path} is not written")
        return
    write_search_history(history_table([asdict(step) for step in steps]), path)


_SHOWN = ("n_terminals", "n_segments", "n_trifurcations", "volume_mm3", "evenness", "seconds", "peak_memory_mb")


def _shown(value: Any) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:,.2f}"


def _document(run: Run, tree: Tree) -> dict[str, Any]:
    from generator.growth.evenness import evenness

    children = tree.topology.n_children
    return {
        "volume_mm3": tree.volume_mm3,
        "n_terminals": tree.topology.n_terminals,
        "n_segments": tree.n_segments,
        "n_trifurcations": int((children[1:] >= 3).sum()),
        "seed": run.config.seed,
        "peak_memory_mb": _peak_memory_mb(),
        "evenness": evenness(run.domain, tree.position_mm[tree.topology.terminals]),
        "seconds": sum(stage.seconds for stage in run.stages),
        "stages": [{name: value for name, value in asdict(stage).items() if value is not None} for stage in run.stages],
    }


def _peak_memory_mb() -> float:
    """Largest memory of this process so far."""
    import resource
    import sys

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == "darwin" else 1e3)
