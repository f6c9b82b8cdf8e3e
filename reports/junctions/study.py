"""Trifurcations and monopodial branches of the portal vein."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from reports.common.figures import LOOKS, panels, plain_counts, save
from reports.common.pages import Compared, Facts, Page, table, write_csv
from reports.common.trees import measured
from reports.portal_vein.study import trees
from vascval.morphometry import Analysis
from vascval.report.plots import whole_ticks

TITLE = "Trifurcations and monopodial branches"
FULL = {"n_terminals": 24_000, "topology": {}}
SMALL = {"n_terminals": 80, "topology": {"topology__at": 40, "topology__tests": 500}}

KEYS = (
    "n_bifurcations", "n_trifurcations", "n_trifurcations_first_7", "n_multifurcations", "n_monopodial", "n_contracted",
)  # fmt: skip


def study(folder: Path, n_terminals: int, topology: Mapping[str, object]) -> Page:
    facts = Facts("junctions")
    sides = dict(zip(("growth alone", "optimised"), (measured(tree.tree) for tree in trees(n_terminals, topology))))
    totals = pd.DataFrame([{"tree": name, **{key: side.summary[key] for key in KEYS}} for name, side in sides.items()])
    write_csv(totals, folder / "table.csv")
    moves = sensitivity(sides)
    write_csv(moves, folder / "sensitivity.csv")
    by_generation = pd.concat(
        [side.generations[["generation", "n_junctions", "n_trifurcations", "n_monopodial"]].assign(tree=name)
         for name, side in sides.items()]
    )  # fmt: skip
    write_csv(by_generation, folder / "generations.csv")
    draw(folder, by_generation)
    cco, best = (sides[name].summary for name in sides)
    ratio = best["n_monopodial"] / max(cco["n_monopodial"], 1)
    papers = facts["monopodial branches optimised tree"] / facts["monopodial branches standard CCO"]
    first_7 = facts["trifurcations of the optimised tree in the first seven generations"]
    headline = (
        f"{best['n_trifurcations_first_7']:,} trifurcations in the first seven generations (paper "
        f"{first_7:.0f}); monopodial branches from "
        f"{cco['n_monopodial']:,} to {best['n_monopodial']:,} by optimising, {ratio:.2f}-fold (paper "
        f"{papers:.2f}-fold)."
    )
    return Page(
        headline,
        [
            facts.compared("trifurcations of the cast", None),
            facts.compared(
                "trifurcations of the optimised tree in the first seven generations", best["n_trifurcations_first_7"]
            ),
            facts.compared("monopodial branches standard CCO", cco["n_monopodial"]),
            facts.compared("monopodial branches optimised tree", best["n_monopodial"]),
            Compared("monopodial branches, optimised over grown", papers, ratio, "", "section 3.2"),
        ],
        words(facts, sides["optimised"], first_7, totals, moves),
    )


def words(facts: Facts, optimised: Analysis, first_7: float, totals: pd.DataFrame, moves: pd.DataFrame) -> str:
    """What the counts mean, and what they do not."""
    running = optimised.generations["n_trifurcations"].cumsum()
    reached = int((running < first_7).sum())
    n_generations = len(running)
    rule = optimised.parameters["monopodial"]
    return f"""
The trees of [the portal vein](../portal_vein/README.md). A trifurcation is a junction of three children after every
segment shorter than its diameter is contracted, a rule applied to both trees: `n contracted` segments of the tree
as grown are that short, so that even growth alone, which makes bifurcations only, has some when it is measured as a
cast would be.

{table(totals)}

A monopodial branch is taken as a child of at most {rule["ratio_max"]:g} of the radius of its largest sibling,
leaving at {rule["angle_min_deg"]:g} to {rule["angle_max_deg"]:g} degrees while that sibling goes on within
{rule["straight_max_deg"]:g} degrees. The paper counts them but does not say by which thresholds, and its numbers
follow them closely, as ours do:

{table(moves)}

So the absolute counts cannot be compared, only their change. As to trifurcations, our tree has {n_generations}
generations where the paper speaks of up to 11, so that our first seven hold most of it; summed up from the root
it has {running.iloc[max(reached - 1, 0)]:,} down to generation {max(reached, 1)} and
{running.iloc[min(reached, n_generations - 1)]:,} down to generation {min(reached + 1, n_generations)}. The paper's rule
counts segments shorter than their diameter too, but it does not say whether it was applied once or to the end, on
which the number depends ([growth against one geometry programme](../one_programme/README.md)). Nor can it be compared
with the cast's
{facts["trifurcations of the cast"]:.0f}, since how many an image shows depends on its resolution.
"""


def sensitivity(sides: Mapping[str, Analysis]) -> pd.DataFrame:
    """Monopodial branches of both trees by the threshold of the ratio, the other thresholds as usual."""
    columns = []
    for name, side in sides.items():
        rule, rows = side.parameters["monopodial"], side.monopodial_sensitivity
        usual = rows
        for key in ("angle_min_deg", "angle_max_deg", "straight_max_deg"):
            usual = usual[usual[key] == rule[key]]
        columns.append(usual.set_index("ratio_max")["n_monopodial"].rename(name.replace(" ", "_")))
    frame = pd.concat(columns, axis=1).rename_axis("largest_ratio").reset_index()
    frame["optimised_over_grown"] = frame["optimised"] / frame["growth_alone"].where(frame["growth_alone"] > 0)
    return frame


def draw(folder: Path, rows: pd.DataFrame) -> None:
    figure, axes = panels(2)
    looks = {"growth alone": LOOKS["cco"], "optimised": LOOKS["optimised"]}
    for place, key, title in zip(axes, ("n_trifurcations", "n_monopodial"), ("Trifurcations", "Monopodial branches")):
        for name, look in looks.items():
            mine = rows[rows["tree"] == name]
            place.plot(mine["generation"], mine[key], label=name, **look)
        place.set(title=title, xlabel="generation", yscale="symlog", ylim=(0, None))
        whole_ticks(place.xaxis)
        plain_counts(place.yaxis)
    axes[0].legend()
    save(figure, folder)
