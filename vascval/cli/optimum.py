"""``vascval optimum``."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vascval.cli import sources
from vascval.cli.console import note, progress, say, table, write_json
from vascval.cli.options import json_option
from vascval.core.errors import ComputationError, InputError

if TYPE_CHECKING:
    from generator.config import Config
    from generator.framework import Run
    from generator.topology.exhaustive import Optimum
    from vascval.core.tree import Tree

FEWEST = 2
_SAME = 1e-8
"""Volumes that differ by less, relatively, are the same: geometries are optimised so far."""
_TOGETHER = 1e-6
"""Bifurcations nearer to each other than so many diameters are one junction."""


@click.command(
    short_help="The proven optimum of a small tree",
    epilog="""\b
Examples:
  vascval optimum karch-box -o best.vtp --set n_terminals=8
  vascval optimum karch-box -o best.vtp --set n_terminals=7 --set seed=3 --json best.json
  vascval optimum my.toml -o best.vtp --set terminals_file=points.csv

\b
Eight terminals take a second or two; each one more, about ten times as long.
""",
)
@click.argument("config", metavar="PRESET_OR_TOML")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), required=True, metavar="TREE.vtp",
    help="The tree of least volume; a name in .swc writes SWC instead.",
)  # fmt: skip
@click.option(
    "--set", "changes", multiple=True, metavar="KEY=VALUE",
    help="Change a key of the configuration, as of 'vascval generate', such as n_terminals=8 or seed=3; may be "
    "repeated.",
)  # fmt: skip
@json_option
def optimum(config: str, output: Path, changes: tuple[str, ...], json_file: str | None) -> None:
    """Find the tree of least volume over all topologies that join the root with 2 to 10 terminals.

    Root and terminals are those that 'vascval generate' has for the same configuration and seed. Topologies are cut
    off where a bound proves that none of their trees can be better. The volume that the search of generate
    (--set method=full) reaches on the same terminals stands beside.
    """
    if output.suffix.lower() not in (".vtp", ".swc"):
        raise click.BadParameter(f"{output} ends in neither .vtp nor .swc", param_hint="-o")
    sources.check_file(output)
    sources.check_json(json_file)
    from generator.config import load
    from vascval.io.provenance import provenance
    from vascval.io.trees import write_tree

    chosen = load(config, changes)
    run = _covered(config, chosen)
    for path in (output, *([] if json_file in (None, "-") else [Path(json_file or "")])):
        sources.check_is_no_input(path, run.inputs())
    origin = provenance(command="optimum", config=chosen.model_dump(mode="json"), seed=chosen.seed, inputs=run.inputs())
    outcome = _found(run)
    if outcome.search_was_better:
        note("the search has a better geometry than the enumeration (see enumerated_mm3); its tree is taken")
    write_tree(outcome.tree, output, provenance=origin, claims=run.claims(outcome.tree))
    document = outcome.document()
    if json_file != "-":
        say(table(_rows(document)))
        say(f"\n{document['certificate']}\n\ntree: {output}")
    if json_file is not None:
        write_json({**document, "provenance": origin}, json_file)


def _covered(name: str, config: Config) -> Run:
    """The run that grows and searches the tree which the optimum is held against.

    :raises InputError: when the configuration asks for what the proof does not cover.
    """
    from generator.framework import Run
    from generator.topology.exhaustive import MOST
    from generator.topology.state import SHORTEST_MM

    if config.geometry.l_min_mm != SHORTEST_MM:
        raise InputError(
            f"{name}: geometry.l_min_mm={config.geometry.l_min_mm:g} is not covered by the proof of the optimum; leave "
            f"it at {SHORTEST_MM:g}"
        )
    for key, applies, remedy in _NOT_COVERED:
        if applies(config):
            raise InputError(f"{name}: {key} is not covered by the proof of the optimum; {remedy}")
    run = Run.of(config.model_copy(update={"method": "full"}))
    count = run.growth.n_terminals
    if not FEWEST <= count <= MOST:
        many = f"{count:,} terminal{'' if count == 1 else 's'}"
        raise InputError(
            f"{name}: {many}: the optimum can be proven for {FEWEST} to {MOST}; choose fewer, such as --set "
            "n_terminals=8, or search with vascval generate --set method=full"
        )
    if config.topology.at < count:
        raise InputError(
            f"{name}: topology.at={config.topology.at} searches before all {count} terminals are there; set it to "
            f"{count} or more"
        )
    if config.method == "geometry" and config.geometry.during_growth and config.geometry.interval(count) < count:
        raise InputError(
            f"{name}: geometry.every={config.geometry.every} moves the tree before all {count} terminals are drawn; "
            f"set it to {count} or more"
        )
    if not run.domain.space.convex:
        raise InputError(
            f"{name}: the domain is not known to be convex, and the proof holds for convex ones alone; give a box "
            "around the terminals, domain.box_mm=X,Y,Z"
        )
    return run


_NOT_COVERED: tuple[tuple[str, Callable[[Config], bool], str], ...] = (
    ("root_tree", lambda config: config.root_tree is not None, "give a root point, root_mm=X,Y,Z"),
    ("a viscosity that is not constant", lambda config: config.viscosity != "constant", "set viscosity=constant"),
    (
        "growth.avoid_intersections",
        lambda config: config.growth.avoid_intersections,
        "set growth.avoid_intersections=false",
    ),
    (
        "a smallest radius",
        lambda config: config.growth.r_min_mm > 0.0 or config.geometry.r_min_mm > 0.0,
        "set growth.r_min_mm=0 and geometry.r_min_mm=0",
    ),
    (
        "an objective other than the volume",
        lambda config: config.geometry.objective != "volume",
        "set geometry.objective=volume",
    ),
    (
        "geometry.gamma_by_generation",
        lambda config: bool(config.geometry.gamma_by_generation),
        "leave it out and set gamma",
    ),
)
"""What is asked for, whether a configuration does, and what to do about it."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What was found: ``enumerated`` by branch and bound, ``searched`` by the run; ``tree`` is the better one."""

    run: Run
    searched: Tree
    enumerated: Optimum
    seconds: float

    @property
    def search_was_better(self) -> bool:
        """Whether the search has the better geometry of a topology that was not cut off. What was cut off stays so:
        it has a higher bound than the tree of the enumeration."""
        return self.searched.volume_mm3 < self.enumerated.tree.volume_mm3 * (1.0 - _SAME)

    @cached_property
    def tree(self) -> Tree:
        """The best tree, bifurcations that fall together being one junction.

        :raises ComputationError: when they fall on the root.
        """
        from generator.haemodynamics import perfused_tree
        from vascval.core.contraction import contract_degenerate

        best = self.searched if self.search_was_better else self.enumerated.tree
        if not best.length_mm[1] > 0.0:
            raise ComputationError(
                "the first bifurcation of the best tree lies on the root itself, where one vessel is to begin; move "
                "the root away from the middle of the terminals"
            )
        joined = contract_degenerate(best, diameters=_TOGETHER)
        if joined is best:
            return best
        return perfused_tree(joined.topology, joined.position_mm, self.run.growth.perfusion)

    def document(self) -> dict[str, Any]:
        """:class:`vascval.io.documents.OptimumDocument` as plain values."""
        from vascval.io.documents import OptimumDocument

        stage = next(stage for stage in self.run.stages if stage.name == "topology")
        found, volume = self.enumerated, self.tree.volume_mm3
        shortest = float(self.tree.length_mm[1:].min())
        document = {
            "volume_mm3": volume,
            "enumerated_mm3": found.tree.volume_mm3,
            "n_terminals": self.tree.topology.n_terminals,
            "shortest_mm": shortest,
            "seed": self.run.config.seed,
            "n_topologies": found.n_topologies,
            "n_bounded": found.n_bounded,
            "n_optimised": found.n_optimised,
            "seconds": self.seconds,
            "search": {"volume_mm3": self.searched.volume_mm3, "tests": stage.tests, "seconds": stage.seconds},
            "ratio": self.searched.volume_mm3 / volume,
            "certificate": _certificate(found, shortest),
        }
        OptimumDocument.model_validate(document)
        return document


def _found(run: Run) -> Outcome:
    """Grows and searches the tree, then finds the optimum for its terminals."""
    from generator.topology.exhaustive import optimal_tree

    with progress() as observer:
        with closing(run.steps()) as steps:
            for name, step in steps:
                if name == "geometry":  # the search is done; what follows is no longer about the topology
                    break
                if observer is not None:
                    observer(name, step.n_terminals, step.n_target)
        searched = run.tree()
        terminals = searched.position_mm[searched.topology.terminals]
        began = time.perf_counter()
        best = optimal_tree(searched.position_mm[0], terminals, run.growth.perfusion, observer)
    return Outcome(run, searched, best, time.perf_counter() - began)


def _certificate(best: Optimum, shortest_mm: float) -> str:
    return (
        f"Proven, to 1e-9: no tree of a topology that was cut off, among all {best.n_topologies:,}, has less volume. "
        f"Not proven: that the geometry of a topology that was not cut off ({best.n_optimised:,}) is more than a local "
        f"optimum. Not asked for: shortest lengths (the shortest vessel has {shortest_mm:.3g} mm), and vessels that do "
        "not overlap."
    )


def _rows(document: dict[str, Any]) -> list[list[object]]:
    search = document["search"]
    return [
        ["", "value"],
        ["volume_mm3", f"{document['volume_mm3']:,.6f}"],
        ["n_terminals", document["n_terminals"]],
        ["n_topologies", f"{document['n_topologies']:,}"],
        ["n_bounded", f"{document['n_bounded']:,}"],
        ["n_optimised", f"{document['n_optimised']:,}"],
        ["seconds", f"{document['seconds']:,.2f}"],
        ["search: volume_mm3", f"{search['volume_mm3']:,.6f}"],
        ["search: tests", f"{search['tests']:,}"],
        ["search: seconds", f"{search['seconds']:,.2f}"],
        ["search / optimum", f"{document['ratio']:.9f}"],
    ]
