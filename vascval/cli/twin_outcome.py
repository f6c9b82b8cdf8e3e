"""What ``vascval twin`` leaves behind: the facts, the trees and the report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vascval.cli.console import Observer
from vascval.cli.twin_parts import PRESET, TREES, Ground, Start

if TYPE_CHECKING:
    from generator.config import Config
    from generator.framework import Run
    from vascval.core.tree import Tree
    from vascval.imaging import Skeleton
    from vascval.morphometry import Analysis


@dataclass(frozen=True, eq=False)
class Outcome:
    """Cast and grown trees: ``whole`` is the cast as it was given, ``cast`` what of it is compared, ``given`` the part
    of it that the grown ``trees`` (from ``runs``) were given, its first ``generations_given``."""

    whole: Tree
    skeleton: Skeleton | None
    cast: Analysis
    trees: list[Analysis]
    runs: Mapping[str, Run]
    given: Tree | None
    generations_given: int
    ground: Ground
    start: Start
    inputs: list[Path]

    def write(self, folder: Path, chosen: Mapping[str, Any], observer: Observer | None) -> dict[str, Any]:
        """Trees and report into ``folder``, which holds the perfusion volume already; the document of the result."""
        from vascval.comparison import compare
        from vascval.io.provenance import provenance
        from vascval.io.trees import write_tree, write_vtp
        from vascval.report.search_history import history_table
        from vascval.report.twin_section import Twin
        from vascval.report.write import write_compare_report

        config = next(iter(self.runs.values())).config
        recorded = _recorded(config, without=("method",))
        origin = provenance(command="twin", config={**chosen, "grown": recorded}, seed=config.seed, inputs=self.inputs)
        write_vtp(self.cast.tree, folder / "cast.vtp", provenance=origin)
        for name, run in self.runs.items():
            own = provenance(
                command="twin", config=_recorded(run.config), seed=config.seed, inputs=[*self.inputs, *run.inputs()]
            )
            tree = run.tree()
            write_tree(tree, folder / f"{name}.vtp", provenance=own, claims=run.claims(tree))
        comparison = compare(self.cast, self.trees, observer=observer)
        facts = self.facts()
        steps = [asdict(step) for run in self.runs.values() for step in run.topology.history]
        twin = Twin(facts, self.ground.surface, history_table(steps))
        write_compare_report(comparison, folder, provenance=origin, skeleton=self.skeleton, twin=twin)
        for tree, run in zip(facts["trees"], self.runs.values(), strict=True):
            tree["stages"] = [
                {key: value for key, value in asdict(stage).items() if value is not None} for stage in run.stages
            ]
        return {**comparison.document(), "twin": facts, "provenance": origin}

    def facts(self) -> dict[str, Any]:
        """:class:`vascval.io.twins.Twin` as plain values, without times."""
        from vascval.io.provenance import plain

        config = next(iter(self.runs.values())).config
        radius = float(self.start.cast.radius_mm[0])
        drop = config.perfusion.root_pressure_mmhg - config.perfusion.terminal_pressure_mmhg
        n_whole, n_compared = self.whole.topology.n_terminals, self.start.cast.topology.n_terminals
        facts: dict[str, Any] = plain(
            {
                "domain": self.ground.facts,
                "root": {
                    "position_mm": self.start.root_mm if self.given is None else self.given.position_mm[0],
                    "cast_position_mm": self.start.cast.position_mm[0],
                    "given_position_mm": self.whole.position_mm[0],
                    "moved_mm": self.start.moved_mm if self.given is None else 0.0,
                    "radius_mm": radius,
                    "generations_given": self.generations_given,
                    "n_segments_given": 0 if self.given is None else self.given.n_segments,
                },
                "cast": {
                    "n_terminals_given": n_whole,
                    "n_terminals_left_out": n_whole - n_compared,
                    **self.start.shares,
                },
                "perfusion": {"preset": PRESET, **config.perfusion.model_dump(), "gamma": config.gamma},
                "seed": config.seed,
                "trees": [_tree(analysis, radius, drop) for analysis in self.trees],
                "notes": [*self.ground.domain.notes, *self.start.notes, *self._numbers(), *self._stubs()],
            }
        )
        return facts

    def _numbers(self) -> list[str]:
        """A sentence where the trees have other numbers of terminals than the cast."""
        compared = self.cast.summary["n_terminals"]
        return [
            f"{analysis.source} has {analysis.summary['n_terminals']:,} terminals and the cast {compared:,}: "
            "generations count from the root, so that those beyond the cast's have nothing beside them"
            for analysis in self.trees
            if analysis.summary["n_terminals"] != compared
        ]

    def _stubs(self) -> list[str]:
        """A sentence where the first branching of a tree has moved to its root."""
        return [
            f"the root vessel of {analysis.source} is {length:.2g} mm long and {diameter:.2g} mm thick: its first "
            "branching has moved to where the blood enters. It is the root segment all the same and counts in "
            "generation 1; what can be compared with vessels of a cast begins in the generation after it"
            for analysis in self.trees
            if (length := float(analysis.tree.length_mm[1])) < (diameter := 2.0 * float(analysis.tree.radius_mm[1]))
            and analysis.tree.topology.n_children[0] == 1
        ]


def _tree(analysis: Analysis, cast_radius_mm: float, drop_mmhg: float) -> dict[str, Any]:
    ratio = float(analysis.tree.radius_mm[0]) / cast_radius_mm
    return {
        "source": analysis.source,
        "file": f"{analysis.source}.vtp",
        "method": TREES[analysis.source],
        "n_terminals": analysis.summary["n_terminals"],
        "volume_mm3": analysis.summary["volume_mm3"],
        "root_radius_mm": ratio * cast_radius_mm,
        "root_radius_to_cast": ratio,
        "pressure_drop_at_cast_root_mmhg": drop_mmhg * ratio**4,
    }


def _recorded(config: Config, without: tuple[str, ...] = ()) -> dict[str, Any]:
    """A configuration for the provenance: files by name, as they lie beside the report."""
    record = {key: value for key, value in config.model_dump(mode="json").items() if key not in without}
    record["domain"]["file"] = Path(record["domain"]["file"]).name
    if record["root_tree"] is not None:
        record["root_tree"] = Path(record["root_tree"]).name
    return record
