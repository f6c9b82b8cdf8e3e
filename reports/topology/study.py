"""Geometry alone against geometry and topology at full size, and what each takes off the volume."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from generator.config import load
from reports.common.figures import GREEN, RED
from reports.common.pages import Facts, Page, table, write_csv
from reports.common.trees import likeness, made
from reports.common.tubes import Layer, View, write_views

TITLE = "Geometry alone against geometry and topology"
FULL = {
    "n_terminals": 6000, "seeds": (1, 2, 3), "search": {},
    "whole": {"topology__at": 6000, "topology__tests": 3_000_000, "topology__chains": 1, "topology__heat": 0.2},
}  # fmt: skip
SMALL = {
    "n_terminals": 60, "seeds": (1, 2), "search": {"topology__at": 30, "topology__tests": 500},
    "whole": {"topology__at": 60, "topology__tests": 1000, "topology__chains": 1},
}  # fmt: skip


def study(
    folder: Path, n_terminals: int, seeds: Sequence[int], search: Mapping[str, object], whole: Mapping[str, object]
) -> Page:
    facts = Facts("topology")
    at = load("karch-box", [f"{key.replace('__', '.')}={value}" for key, value in search.items()]).topology.at
    rows = []
    for seed in seeds:
        grown, geometry, full, at_the_end = (
            made("karch-box", n_terminals=n_terminals, seed=seed, **changes)
            for changes in ({}, {"method": "geometry"}, {"method": "full", **search}, {"method": "full", **whole})
        )
        volumes = [tree.volume_mm3 for tree in (grown, geometry, full, at_the_end)]
        found, chance = likeness(full.tree, geometry.tree)
        rows.append(
            (seed, *volumes, 100 * (1 - volumes[1] / volumes[0]), 100 * (1 - volumes[2] / volumes[1]),
             100 * (1 - volumes[2] / volumes[0]), 100 * (1 - volumes[3] / volumes[0]), found, chance)
        )  # fmt: skip
        if seed == seeds[0]:
            draw(folder, Layer(geometry.tree, RED, "geometry alone"), Layer(full.tree, GREEN, "geometry and topology"))
    volumes_of = [f"{name}_mm3" for name in ("growth", "geometry", "full", "searched_at_the_end")]
    less = [f"{name}_less_percent" for name in ("geometry", "topology", "total", "searched_at_the_end")]
    frame = pd.DataFrame(rows, columns=["seed", *volumes_of, *less, "trunk_alike_share", "by_chance_share"])
    write_csv(frame, folder / "table.csv")
    further, total = frame["topology_less_percent"].max(), frame["total_less_percent"].max()
    paper = [
        facts[name]
        for name in ("further reduction by topology optimisation (up to)", "total reduction against CCO (up to)")
    ]
    headline = (
        f"At {n_terminals:,} terminals the topology takes up to {further:.1f} % more off the volume (paper up to "
        f"{paper[0]:.0f} %), {total:.1f} % in all against growth alone (paper up to {paper[1]:.0f} %); searched at the "
        f"full size instead, {frame['searched_at_the_end_less_percent'].max():.1f} %."
    )
    text = f"""
Growth alone; with the geometry optimised while growing and at the end; and with the topology searched at {at:,}
terminals besides ({full.tests:,} tests in all), growth going on from what is found (the paper's Algorithm 1).

{table(frame)}

The percentages are not of the same thing. The paper compares with its own CCO trees; ours have less volume to begin
with, since each connection is weighed by the volume of the whole tree, so that a smaller reduction may end at a
better tree. What the search gains at {at:,} terminals it gains on the thick vessels; growing on to {n_terminals:,}
adds volume that no search has touched. "Searched at the end" is one search of {at_the_end.tests:,} tests at
{n_terminals:,} terminals, after growth alone, with one geometry programme after it. With the search on the final
size of {at:,} terminals the reductions are those of
[ten trees against tested topologies](../tested_topologies/README.md).
"""
    return Page(
        headline,
        [
            facts.compared("further reduction by topology optimisation (up to)", further),
            facts.compared("total reduction against CCO (up to)", total),
        ],
        text,
    )


def draw(folder: Path, red: Layer, green: Layer) -> None:
    views = [
        View("Geometry alone", [Layer(red.tree)]),
        View("Geometry and topology", [Layer(green.tree)]),
        View("Laid over each other", [red, green]),
        View("Part of it", [red, green], zoom=(0.3, 0.35, 3.5)),
    ]
    write_views(folder, views, columns=2, width_in=5.0)
