"""The portal vein: vessels, radii and branching ratios by generation, grown against optimised."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from reports.common.figures import INK, LOOKS, panels, save
from reports.common.pages import Compared, Facts, Page, table, write_csv
from reports.common.trees import measured
from reports.common.tubes import Layer, View, write_views
from reports.portal_vein.change import (
    ALL,
    AS_GROWN,
    FIRST,
    RADII,
    at_equal_flow,
    by_generation,
    change,
    changes,
    with_errors,
)
from reports.portal_vein.trees import BEST, GROWN, ONCE, PAPERS, trees
from vascval.core.tree import Tree
from vascval.io.documents import ReferenceTable, read_reference_table
from vascval.report.formats import missing
from vascval.report.plots import plain_log, whole_ticks

TITLE = "The portal vein"
FULL = {"n_terminals": 24_000, "seeds": tuple(range(1, 11)), "topology": ()}
SMALL = {"n_terminals": 80, "seeds": (1, 2, 3), "topology": ("topology.at=40", "topology.tests=500")}
CAST_TABLE = "VASCVAL_CAST_TABLE"
"""Environment variable with the file of a published table by generation, for whoever has one."""
CAST = "cast"
MEASURES = {
    "n_segments": "Number of vessels",
    "radius_mean_mm": "Mean radius (mm)",
    "branching_ratio_mean": "Mean branching ratio",
}
LOOK: dict[str, dict[str, Any]] = {
    GROWN: LOOKS["cco"], BEST: LOOKS["optimised"], ONCE: LOOKS["third"], CAST: LOOKS["cast"],
}  # fmt: skip
SHOWN = [*(str(g) for g in range(1, FIRST + 1)), ALL]
USUAL, SAME_FLOW = next(iter(RADII)), "of which radius at equal flow"


def study(folder: Path, n_terminals: int, seeds: tuple[int, ...], topology: tuple[str, ...]) -> Page:
    made = trees(n_terminals, seeds, topology)
    rows = by_generation(made, seeds)
    write_csv(rows, folder / "generations.csv")
    cast = cast_table()
    frame = side_by_side(rows, cast)
    write_csv(frame, folder / "table.csv")
    moved = changes(rows)
    write_csv(moved, folder / "changes.csv")
    draw(folder, rows, cast, made)
    views = [
        View("Growth alone", [Layer(made[GROWN][0])]),
        View("Geometry and topology optimised", [Layer(made[BEST][0])]),
    ]
    write_views(folder, views, columns=2, width_in=5.0, name="vessels")
    best = rows[rows["tree"] == BEST]
    n_generations = int(best["generation"].max())
    last_mm = float(frame["radius_mean_mm_optimised"].dropna().iloc[-1])
    facts = Facts("portal_vein")
    said = "up to {:.0f}".format(facts["generations of the optimised tree (up to)"])
    volume = pd.Series([100 * (b.volume_mm3 / g.volume_mm3 - 1) for g, b in zip(made[GROWN], made[BEST])])
    headline = (
        f"At {n_terminals:,} terminals {n_generations} generations (paper {said}) and {-volume.mean():.1f} % less "
        f"volume than growth alone; radii of generations {ALL} (paper: larger) change by "
        f"{spread(moved, BEST, USUAL)} %, contracted only once by {spread(moved, ONCE, USUAL)} %, with the paper's "
        f"settings by {spread(moved, PAPERS, USUAL)} %, branching ratios by "
        f"{spread(moved, BEST, 'branching ratio')} %: means of {len(seeds)} seeds and their standard errors."
    )
    text = f"""
`portal-vein`: the paper's parameters (table 3) with the {n_terminals:,} terminals of its text, in the bundled
liver-like shape of 1,500 cm³, since the perfusion volume of the paper's liver is not published. All measures by the
definitions of `vascval analyze`, the same for all trees. For each of {len(seeds)} seeds there is a tree of growth
alone and two of the whole framework, which differ in what comes after the last geometry programme: "{BEST}" is what
this project does by default (contract, optimise again, split junctions where that pays), "{ONCE}" what
the paper's Algorithm 1 says (contract). Means over the seeds, and bands of one standard deviation in the upper row of
the figure; the pictures of vessels are of seed {seeds[0]}.

{table(frame)}

{cast_words(cast)}

The paper's figures are not available as numbers; in words, the number of vessels differs little between grown and
optimised tree, mean radii of generations {ALL} are larger when optimised, and branching ratios of generations 4 to
6 lower. The mean radius of its cast at generation 13 is {facts["mean radius of the cast at generation 13"]:g} mm;
our trees end at generation {n_generations} with a mean of {last_mm:.3f} mm, having {n_terminals:,} terminals where the
cast has all of its vessels down to the lobules. The number of Strahler generations of a tree is fixed by its number
of terminals and by how symmetric it is: one generation more needs {number_ratio(made[BEST]):.1f} times
the terminals, by the number ratio of its elements.

{radius_words(rows, moved, n_seeds=len(seeds))}
"""
    return Page(headline, compared(facts, n_generations, last_mm, volume, moved), text)


def number_ratio(made: Sequence[Tree]) -> float:
    """Terminals of a tree with one generation more over those of a tree like these."""
    horton = [measured(tree).horton.query("ordering == 'strahler' and quantity == 'number'") for tree in made]
    return float(np.mean([rows["ratio"].iloc[-1] for rows in horton]))


def radius_words(rows: pd.DataFrame, moved: pd.DataFrame, n_seeds: int) -> str:
    """Whether radii of the first generations grow, by which measure, and why."""
    single = change(rows, "radius_mean_mm", BEST).loc[ALL]
    said = "\n".join(f"* {kind}: {verdict(rows, moved, kind)};" for kind in (BEST, ONCE, PAPERS))
    return f"""## Are the radii of generations {ALL} larger?

Per cent by which the two trees of a seed differ: mean over the seeds and its standard error. The first measure, the
mean over the segments of a generation, is the one of `vascval analyze` and of the headline; the others show how much
hangs on it. In the fourth, growth is not contracted before it is measured, as in the paper. A third optimised tree of
each seed has the "{PAPERS}" as far as they are known: 7,500 topologies tested by one chain (as many swaps as the
filters of the paper leave; how many were tested is not said), 30 connections, no bifurcation closer than 0.2 mm to
the node before it, and one contraction.

{changes_table(moved)}

Is the paper's finding met? By the first measure, and beyond two standard errors, radii of these {FIRST} generations are

{said[:-1]}.

Where it comes from is in the last two rows of each tree, whose product is the first. At equal flow, that is among
vessels that feed as many terminals, radii of generations {ALL} change by {spread(moved, BEST, SAME_FLOW)} %
({spread(moved, ONCE, SAME_FLOW)} % contracted once), nearly the same in all generations and all seeds. It cannot be
otherwise: with the exponent 3 of this tree the cube of a radius is the sum of the cubes of the radii of the
terminals that it feeds, so that no generation can widen on its own, and shorter ways to the terminals at the same
drop of pressure need narrower vessels. The paper supposes that shorter intermediate generations lead to larger
radii; Poiseuille's law has it the other way.

All the rest is numbering, the number of terminals that a vessel of a generation feeds, and so is nearly all of the
scatter between seeds. Two things move it. Asymmetry: optimised trees have fewer and thus larger subtrees in the
intermediate generations, while the trunk goes on farther, giving off smaller branches, before its order falls.
And contraction: where children of orders 1, 1 and 2 meet in one point their parent has order 2, where two
bifurcations can give 3, so that in a contracted tree vessels of the same order feed more terminals. Splitting
junctions where that pays, as is done by default, takes most of this back.

One pair of trees cannot decide it. Of these {n_seeds} pairs the change in generations {ALL} goes from
{single.min():+.1f} to {single.max():+.1f} % ({BEST}). And where the root of one tree of a pair has one order more than
the other's, every generation is compared with another one. That is so in

* {BEST}: {depths(rows, BEST, GROWN)};
* {ONCE}: {depths(rows, ONCE, GROWN)};
* {PAPERS}: {depths(rows, PAPERS, GROWN)};
* {PAPERS}, growth not contracted, which is what the paper compares: {depths(rows, PAPERS, AS_GROWN)}.
"""


def depths(rows: pd.DataFrame, kind: str, against: str) -> str:
    """The pairs whose trees differ in their number of generations, the change of the radius there and in the rest."""
    deepest = rows.groupby(["tree", "seed"])["generation"].max().unstack("tree")
    uneven = deepest[kind] != deepest[against]
    percent = change(rows, "radius_mean_mm", kind, against).loc[[ALL]]
    if not uneven.any():
        return f"none of {len(uneven)} pairs"
    found = ", ".join(f"{percent.loc[ALL, seed]:+.1f} %" for seed in deepest.index[uneven])
    rest = with_errors(percent.loc[:, list(deepest.index[~uneven])]).loc[ALL]
    others = "" if missing(rest["change_percent"]) else f"; {cell(*rest.iloc[:2])} % in the others"
    return f"{uneven.sum()} of {len(uneven)} pairs ({found}{others})"


def verdict(rows: pd.DataFrame, moved: pd.DataFrame, kind: str) -> str:
    """In which generations the usual measure grows or falls by more than two standard errors, in how many pairs."""
    pairs = change(rows, "radius_mean_mm", kind).loc[ALL]
    mine = moved[(moved["tree"] == kind) & (moved["measure"] == USUAL)].set_index("generation")
    errors = mine["change_percent"] / mine["error_percent"]
    first = errors[errors.index.isin(SHOWN[:-1])]
    up, down = (", ".join(first.index[which]) or "none" for which in (first > 2, first < -2))
    average = "larger" if errors[ALL] > 2 else "smaller" if errors[ALL] < -2 else "not changed"
    return (
        f"larger in {up}, smaller in {down}, {average} on average; in {(pairs > 0).sum()} of {len(pairs)} pairs larger "
        "on average"
    )


def changes_table(moved: pd.DataFrame) -> str:
    """Changes of the radius by tree and measure (rows) and generation."""
    shown = moved[moved["generation"].isin(SHOWN)]
    wide = shown.assign(text=[cell(*pair) for pair in zip(shown["change_percent"], shown["error_percent"])])
    frame = wide.pivot(index=["tree", "measure"], columns="generation", values="text").fillna("")
    order = [(kind, measure) for kind in (BEST, ONCE, PAPERS) for measure in RADII]
    return table(frame.loc[order, [*frame.columns.drop(ALL), ALL]].reset_index())


def cell(mean: float, error: float) -> str:
    return f"{mean:+.1f}" + ("" if missing(error) else f" ± {error:.{1 if error >= 0.05 else 2}f}")


def spread(moved: pd.DataFrame, kind: str, measure: str) -> str:
    """The change of a measure over the first generations, with its standard error."""
    row = moved[(moved["tree"] == kind) & (moved["measure"] == measure) & (moved["generation"] == ALL)].iloc[0]
    return cell(row["change_percent"], row["error_percent"])


def compared(
    facts: Facts, n_generations: int, last_mm: float, volume: pd.Series, moved: pd.DataFrame
) -> list[Compared]:
    """Beside the paper: generations, mean radius of the last one, and percent by which optimising changes the rest."""
    larger, where = "larger (in words)", "section 3.2"
    radius = f"mean radius, generations {ALL}, against growth"
    return [
        facts.compared("generations of the optimised tree (up to)", n_generations),
        facts.compared(
            "mean radius of the cast at generation 13",
            last_mm,
            f"mean radius at the last generation (cast: 13, here: {n_generations})",
        ),
        Compared("volume against growth alone", None, f"{cell(volume.mean(), volume.sem())} %"),
        Compared(radius, larger, f"{spread(moved, BEST, USUAL)} %", "", where),
        *(
            Compared(f"{radius}, {kind}", larger, f"{spread(moved, kind, USUAL)} %", "", where)
            for kind in (ONCE, PAPERS)
        ),
        Compared(
            f"branching ratio, generations {ALL}, against growth",
            "lower, 4 to 6 most (in words)",
            f"{spread(moved, BEST, 'branching ratio')} %",
            "",
            where,
        ),
    ]


def cast_table() -> ReferenceTable | None:
    name = os.environ.get(CAST_TABLE)
    return read_reference_table(Path(name)) if name else None


def cast_words(cast: ReferenceTable | None) -> str:
    if cast is None:
        return (
            "The tables of the paper's cast are not published with it. Whoever has them, or those of another cast, "
            f"names the file in `{CAST_TABLE}` (columns as of `vascval schema table-reference`) and finds it in table "
            "and figure."
        )
    return f"Cast: {cast.source}. {cast.citation}"


def side_by_side(rows: pd.DataFrame, cast: ReferenceTable | None) -> pd.DataFrame:
    """One row per generation, one column per measure and tree: means over the seeds."""
    parts = []
    for measure in MEASURES:
        for name in (GROWN, BEST, ONCE):
            mean = rows[rows["tree"] == name].groupby("generation")[measure].mean()
            parts.append(mean.rename(f"{measure}_{name.replace(' ', '_')}"))
        if cast is not None and measure in cast.generations:
            parts.append(cast.generations.set_index("generation")[measure].rename(f"{measure}_{CAST}"))
    return pd.concat(parts, axis=1).sort_index().rename_axis("generation").reset_index()


def draw(folder: Path, rows: pd.DataFrame, cast: ReferenceTable | None, made: Mapping[str, Sequence[Tree]]) -> None:
    figure, axes = panels(3, 2, width_in=3.6)
    for place, (measure, title) in zip(axes, MEASURES.items()):
        draw_measure(place, rows, cast, measure)
        place.set(title=title, xlabel="generation")
    largest = (
        draw_changes(axes[3], rows, "radius_mean_mm", seeds=True),
        draw_changes(axes[4], rows, "root_of_terminals"),
    )
    axes[3].set(title="Mean radius, change (%)", xlabel="generation")
    axes[4].set(title="By numbering alone, change (%)", xlabel="generation")
    for kind in (BEST, ONCE):
        seen = with_errors(pd.concat([at_equal_flow(*pair) for pair in zip(made[GROWN], made[kind])], axis=1))
        axes[5].errorbar(seen.index, seen["change_percent"], seen["error_percent"], capsize=2.0, **LOOK[kind])
    axes[5].set(title="Radius at equal flow, change (%)", xlabel="terminals fed", xscale="log")
    plain_log(axes[5].xaxis)
    for place in axes[3:]:
        place.axhline(0.0, color=INK, linewidth=0.8)
        place.set_ylim(-1.1 * max(largest), 1.1 * max(largest))
    axes[0].legend()
    save(figure, folder)


def draw_measure(place: Any, rows: pd.DataFrame, cast: ReferenceTable | None, measure: str) -> None:
    """Means over the seeds, and a band of one standard deviation to both sides."""
    for name in (GROWN, BEST, ONCE):
        by = rows[rows["tree"] == name].groupby("generation")[measure]
        mean, sd = by.mean().dropna(), by.std(ddof=1)
        sd = sd.loc[mean.index].fillna(0.0)
        place.plot(mean.index, mean, label=name, **LOOK[name])
        place.fill_between(
            mean.index, np.maximum(mean - sd, mean / 3), mean + sd, color=LOOK[name]["color"], alpha=0.15
        )
    if cast is not None and measure in cast.generations:
        shown = cast.generations[np.isfinite(cast.generations[measure].astype(float))]
        place.plot(shown["generation"], shown[measure], label=CAST, **LOOK[CAST])
    whole_ticks(place.xaxis)
    if measure == "branching_ratio_mean":
        place.set_ylim(0, 1)
    else:
        place.set_yscale("log")
        plain_log(place.yaxis)


def draw_changes(place: Any, rows: pd.DataFrame, measure: str, *, seeds: bool = False) -> float:
    """Changes by generation with standard errors, those of single seeds behind them; how far the bars reach."""
    reach = 0.0
    for kind, shift in ((BEST, -0.12), (ONCE, 0.12)):
        percent = change(rows, measure, kind).drop(index=ALL).dropna(how="all")
        at = percent.index.astype(int).to_numpy() + shift
        if seeds:
            for seed in percent:
                place.plot(at, percent[seed], ".", color=LOOK[kind]["color"], alpha=0.35, markersize=4)
        mean = with_errors(percent)
        place.errorbar(at, mean["change_percent"], mean["error_percent"], capsize=2.0, **LOOK[kind])
        reach = max(reach, float((mean["change_percent"].abs() + mean["error_percent"].fillna(0.0)).max()))
    whole_ticks(place.xaxis)
    return reach
