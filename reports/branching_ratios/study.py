"""Branching ratios of the first seven generations, grown against optimised."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from reports.common.figures import LOOKS, panels, save
from reports.common.pages import Compared, Page, table, write_csv
from reports.common.trees import made, measured
from vascval.report.plots import whole_ticks

TITLE = "Branching ratios by generation"
FULL = {"n_terminals": 6000, "seeds": (1, 2, 3, 4, 5)}
SMALL = {"n_terminals": 60, "seeds": (1, 2)}
KINDS = {
    "growth alone": ({"method": "cco"}, "cco"),
    "optimised while growing": ({"method": "geometry"}, "optimised"),
    "optimised once at the end": ({"method": "geometry", "geometry__during_growth": False}, "third"),
}
GENERATIONS = tuple(range(1, 8))


def study(folder: Path, n_terminals: int, seeds: Sequence[int]) -> Page:
    ratios = {
        kind: np.array([of_tree(n_terminals, seed, changes) for seed in seeds]) for kind, (changes, _) in KINDS.items()
    }
    present = [k for k in GENERATIONS if all(np.isfinite(found[:, k - 1]).any() for found in ratios.values())]
    columns = np.array(present) - 1
    mean = {kind: np.nanmean(found[:, columns], axis=0) for kind, found in ratios.items()}
    rows = pd.DataFrame({"generation": present, **{name(kind): values for kind, values in mean.items()}})
    for kind, found in ratios.items():
        error = np.nanstd(found[:, columns], axis=0, ddof=1) / np.sqrt(np.isfinite(found[:, columns]).sum(axis=0))
        rows[f"{name(kind)}_se"] = error
    write_csv(rows, folder / "table.csv")
    draw(folder, rows)
    lower = rows[rows["generation"].between(2, 6)]
    fall = 1 - lower["optimised_while_growing"].mean() / lower["growth_alone"].mean()
    less = int((lower["optimised_while_growing"] < lower["growth_alone"]).sum())
    verb = "lowers" if fall > 0 else "raises"
    headline = (
        f"Optimising while growing {verb} the branching ratio of generations 2 to 6 by {100 * abs(fall):.0f} "
        f"% on average, and "
        f"lowers it in {less} of {len(lower)} of them (in the paper in all)."
    )
    text = f"""
Mean over the junctions that a generation feeds, radius of the thinnest over the thickest child, then mean over
{len(seeds)} trees of {n_terminals:,} terminals in the benchmark box (standard error beside it). The lower, the more
asymmetric. Generation 1 has one element, so that its value, and that of the next, is the mean of few junctions per
tree; the paper's figure shows a single tree. It describes its curves in words: optimising improves the asymmetry
over generations 2 to 6, and both become more symmetric towards the last.

{table(rows)}

The sizes of the steps in the paper's figure are not available as numbers. A reason for smaller
steps here may be that our grown trees are more asymmetric to begin with: they connect a terminal where the volume of
the whole tree is least, which sends thin vessels straight to thick ones.
"""
    said = "lower over generations 2 to 6 (in words)"
    return Page(
        headline,
        [
            Compared("optimised against growth", said, f"lower in {less} of {len(lower)}", "", "section 2.3.1"),
            Compared("mean change over generations 2 to 6", None, f"{-100 * fall:+.0f} %"),
        ],
        text,
    )


def of_tree(n_terminals: int, seed: int, changes: dict[str, object]) -> np.ndarray:
    """The ratios of the first seven generations; NaN where there is no such generation."""
    tree = made("karch-box", n_terminals=n_terminals, seed=seed, **changes).tree
    rows = measured(tree).generations
    found = np.full(len(GENERATIONS), np.nan)
    shown = rows[rows["generation"] <= len(GENERATIONS)]
    found[shown["generation"].to_numpy() - 1] = shown["branching_ratio_mean"]
    return found


def name(kind: str) -> str:
    return kind.replace(" ", "_")


def draw(folder: Path, rows: pd.DataFrame) -> None:
    figure, (axes,) = panels(1, width_in=5.0, height_in=3.6)
    for k, (kind, (_, look)) in enumerate(KINDS.items()):
        axes.errorbar(
            rows["generation"] + 0.06 * (k - 1), rows[name(kind)], rows[f"{name(kind)}_se"], label=kind,
            elinewidth=0.8, capsize=2, **LOOKS[look],
        )  # fmt: skip
    axes.set(title="Branching ratio", xlabel="generation", ylabel="thinnest over thickest child", ylim=(0, 1))
    whole_ticks(axes.xaxis)
    axes.legend()
    save(figure, folder)
