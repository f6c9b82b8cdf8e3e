"""Trifurcations and monopodial branches of the portal vein."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from reports.common.figures import panels, plain_counts, save
from reports.common.pages import Compared, Facts, Page, table, write_csv
from reports.common.trees import measured
from reports.portal_vein.study import LOOK
from reports.portal_vein.trees import BEST, GROWN, ONCE, PAPERS, trees
from vascval.morphometry import Analysis
from vascval.report.plots import whole_ticks

TITLE = "Trifurcations and monopodial branches"
FULL = {"n_terminals": 24_000, "seeds": tuple(range(1, 11)), "topology": ()}
SMALL = {"n_terminals": 80, "seeds": (1, 2, 3), "topology": ("topology.at=40", "topology.tests=500")}

KEYS = (
    "n_bifurcations", "n_trifurcations", "n_trifurcations_first_7", "n_multifurcations", "n_monopodial", "n_contracted",
)  # fmt: skip
COUNTED = {"n_trifurcations": "Trifurcations", "n_monopodial": "Monopodial branches"}


def study(folder: Path, n_terminals: int, seeds: tuple[int, ...], topology: tuple[str, ...]) -> Page:
    facts = Facts("junctions")
    made = trees(n_terminals, seeds, topology)
    sides = {kind: [measured(tree) for tree in by_seed] for kind, by_seed in made.items()}
    totals = pd.DataFrame(
        [{"tree": kind, "seed": seed, **{key: side.summary[key] for key in KEYS}}
         for kind, by_seed in sides.items() for seed, side in zip(seeds, by_seed)]
    )  # fmt: skip
    write_csv(totals, folder / "table.csv")
    moves = sensitivity(sides)
    write_csv(moves, folder / "sensitivity.csv")
    rows = by_generation(sides, seeds)
    write_csv(rows, folder / "generations.csv")
    draw(folder, rows)
    means = totals.groupby("tree")[list(KEYS)].mean()
    monopodial = totals.pivot(index="seed", columns="tree", values="n_monopodial")
    ratios = monopodial[BEST] / monopodial[GROWN].clip(lower=1)
    papers = facts["monopodial branches optimised tree"] / facts["monopodial branches standard CCO"]
    first_7 = "trifurcations of the optimised tree in the first seven generations"
    forks, grown, best = (
        round(means.loc[kind, key])
        for kind, key in ((BEST, "n_trifurcations_first_7"), (GROWN, "n_monopodial"), (BEST, "n_monopodial"))
    )
    headline = (
        f"{forks:,} trifurcations in the first seven generations (paper {facts[first_7]:.0f}); monopodial branches "
        f"from {grown:,} to {best:,} by optimising, {ratios.mean():.2f}-fold (paper {papers:.2f}-fold): mean of "
        f"{len(seeds)} seeds."
    )
    said = f"{ratios.mean():.2f} ({ratios.min():.2f} to {ratios.max():.2f})"
    return Page(
        headline,
        [
            facts.compared("trifurcations of the cast", None),
            facts.compared(first_7, forks),
            facts.compared("monopodial branches standard CCO", grown),
            facts.compared("monopodial branches optimised tree", best),
            Compared("monopodial branches, optimised over grown (by seed)", papers, said, "", "section 3.2"),
        ],
        words(facts, sides[BEST][0].parameters["monopodial"], facts[first_7], totals, moves, rows),
    )


def words(
    facts: Facts, rule: Mapping[str, float], first_7: float, totals: pd.DataFrame, moves: pd.DataFrame,
    rows: pd.DataFrame,
) -> str:  # fmt: skip
    """What the counts mean, and what they do not."""
    running = rows[rows["tree"] == BEST].groupby("generation")["n_trifurcations"].mean().cumsum()
    reached = int((running < first_7).sum())
    n_generations = len(running)
    return f"""
The trees of [the portal vein](../portal_vein/README.md), {totals["seed"].nunique()} of each kind. A trifurcation is a
junction of three children after every segment shorter than its diameter is contracted, a rule applied to all trees:
`n contracted` segments of the tree as made are that short, so that even growth alone, which makes bifurcations only,
has some when it is measured as a cast would be. "{ONCE}" is the optimised tree without what this project does
after the paper's last programme, "{PAPERS}" another that is also searched and grown as near to the paper as is known.
Means over the seeds and, below each, the standard deviation:

{table(means_and_deviations(totals))}

A monopodial branch is taken as a child of at most {rule["ratio_max"]:g} of the radius of its largest sibling,
leaving at {rule["angle_min_deg"]:g} to {rule["angle_max_deg"]:g} degrees while that sibling goes on within
{rule["straight_max_deg"]:g} degrees. The paper counts them but does not say by which thresholds, and its numbers
follow them closely, as ours do (means over the seeds):

{table(moves)}

So the absolute counts cannot be compared, only their change. As to trifurcations, our tree has {n_generations}
generations where the paper speaks of up to 11, so that our first seven hold most of it; summed up from the root
it has {running.iloc[max(reached - 1, 0)]:,.0f} down to generation {max(reached, 1)} and
{running.iloc[min(reached, n_generations - 1)]:,.0f} down to generation {min(reached + 1, n_generations)}. The paper's
rule counts segments shorter than their diameter too, and the number depends on how often it is applied ([growth
against one geometry programme](../one_programme/README.md)). Nor can it be compared with the cast's
{facts["trifurcations of the cast"]:.0f}, since how many an image shows depends on its resolution.
"""


def means_and_deviations(totals: pd.DataFrame) -> pd.DataFrame:
    """Two rows for each kind of tree: means over the seeds, standard deviations."""
    parts = []
    for kind in (GROWN, BEST, ONCE, PAPERS):
        counts = totals[totals["tree"] == kind][list(KEYS)]
        parts += [
            {"tree": kind, **{key: f"{value:,.0f}" for key, value in counts.mean().items()}},
            {"tree": "", **{key: f"± {value:,.0f}" for key, value in counts.std(ddof=1).items()}},
        ]
    return pd.DataFrame(parts)


def by_generation(sides: Mapping[str, Sequence[Analysis]], seeds: Sequence[int]) -> pd.DataFrame:
    """Junctions by tree, seed and generation."""
    columns = ["generation", "n_junctions", "n_trifurcations", "n_monopodial"]
    frame = pd.concat(
        [side.generations[columns].assign(tree=kind, seed=seed)
         for kind, by_seed in sides.items() for seed, side in zip(seeds, by_seed)]
    )  # fmt: skip
    return frame[["tree", "seed", *columns]]


def sensitivity(sides: Mapping[str, Sequence[Analysis]]) -> pd.DataFrame:
    """Monopodial branches by the threshold of the ratio, the other thresholds as usual: means over the seeds."""
    columns = [
        pd.concat([usual(side) for side in by_seed], axis=1).mean(axis=1).rename(kind.replace(" ", "_"))
        for kind, by_seed in sides.items()
    ]
    frame = pd.concat(columns, axis=1).rename_axis("largest_ratio").reset_index()
    frame["optimised_over_grown"] = frame["optimised"] / frame["growth_alone"].where(frame["growth_alone"] > 0)
    return frame


def usual(side: Analysis) -> pd.Series:
    """Monopodial branches of one tree by the threshold of the ratio."""
    rule, rows = side.parameters["monopodial"], side.monopodial_sensitivity
    for key in ("angle_min_deg", "angle_max_deg", "straight_max_deg"):
        rows = rows[rows[key] == rule[key]]
    return rows.set_index("ratio_max")["n_monopodial"]


def draw(folder: Path, rows: pd.DataFrame) -> None:
    """Means over the seeds, with a band from the lowest to the highest."""
    figure, axes = panels(2)
    for place, (key, title) in zip(axes, COUNTED.items()):
        for kind in (GROWN, BEST, ONCE):
            by = rows[rows["tree"] == kind].groupby("generation")[key]
            look: dict[str, Any] = LOOK[kind]
            place.plot(by.mean().index, by.mean(), label=kind, **look)
            place.fill_between(by.mean().index, by.min(), by.max(), color=look["color"], alpha=0.15)
        place.set(title=title, xlabel="generation", yscale="symlog", ylim=(0, None))
        whole_ticks(place.xaxis)
        plain_counts(place.yaxis)
    axes[0].legend()
    save(figure, folder)
