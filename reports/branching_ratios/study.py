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
FULL = {"n_terminals": 6000, "seeds": tuple(range(1, 11))}
SMALL = {"n_terminals": 60, "seeds": (1, 2, 3)}
GROWN = "growth alone"
KINDS = {
    GROWN: ({"method": "cco"}, "cco"),
    "optimised while growing": ({"method": "geometry"}, "optimised"),
    "optimised once at the end": ({"method": "geometry", "geometry__during_growth": False}, "third"),
}
GENERATIONS = tuple(range(1, 8))
EVEN = 1.0
"""Distance of a new terminal from the tree, in mean spacings, of the paper's growth (Karch 1999)."""
DEFAULT = 0.4


def study(folder: Path, n_terminals: int, seeds: Sequence[int]) -> Page:
    rows, alike = compared(n_terminals, seeds, EVEN)
    loose, few = compared(n_terminals, seeds[:5], DEFAULT)
    write_csv(rows, folder / "table.csv")
    draw(folder, rows)
    (fall, less, many), (other, _, _) = summary(rows), summary(loose)
    verb = "lowers" if fall < 0 else "raises"
    headline = (
        f"Optimising while growing {verb} the branching ratio of generations 2 to 6 by {abs(fall):.0f} % on average, "
        f"and lowers it in {less} of {many} of them (in the paper in all)."
    )
    text = f"""
Mean over the junctions that a generation feeds, radius of the thinnest over the thickest child, then mean over
trees of {n_terminals:,} terminals in the benchmark box. The lower, the more asymmetric. Changes are against growth
alone with the same seed, with their standard errors. Generations count from the root's Strahler order, which
differs by one between some trees of one size; then all their vessels have other numbers. Only seeds that give all three
trees as many generations are compared, {alike} of {len(seeds)}. The paper's figure shows a single tree; in words,
optimising improves the asymmetry over generations 2 to 6, and both become more symmetric towards the last.

{table(rows)}

New terminals keep at least the mean spacing from the tree at first, as in the growth that the paper takes over, so that
they cover the box evenly. By default this project asks for {DEFAULT:g} of it; trees are then more asymmetric in the
last generation to begin with, and the change over generations 2 to 6 is {other:+.0f} % (mean of {few} of
{len(seeds[:5])} seeds). The sizes of the steps in the paper's figure are not available as numbers.
"""
    said = "lower over generations 2 to 6 (in words)"
    return Page(
        headline,
        [
            Compared("optimised against growth", said, f"lower in {less} of {many}", "", "section 2.3.1"),
            Compared("mean change over generations 2 to 6", None, f"{fall:+.0f} %"),
            Compared("the same with terminals less even", None, f"{other:+.0f} %"),
        ],
        text,
    )


def compared(n_terminals: int, seeds: Sequence[int], spacing: float) -> tuple[pd.DataFrame, int]:
    """By generation the mean ratio of each kind and its paired change, of seeds with as many generations in all."""
    ratios = {
        kind: np.array([of_tree(n_terminals, seed, {**changes, "growth__spacing": spacing}) for seed in seeds])
        for kind, (changes, _) in KINDS.items()
    }
    present = {kind: np.isfinite(found) for kind, found in ratios.items()}
    alike = np.all([(found == present[GROWN]).all(axis=1) for found in present.values()], axis=0)
    if not alike.any():
        alike[:] = True
    shown = np.all([found[alike].any(axis=0) for found in present.values()], axis=0)
    rows = pd.DataFrame({"generation": np.array(GENERATIONS)[shown]})
    ratios = {kind: found[alike][:, shown] for kind, found in ratios.items()}
    for kind, found in ratios.items():
        rows[name(kind)] = np.nanmean(found, axis=0)
    for kind in list(KINDS)[1:]:
        change = ratios[kind] - ratios[GROWN]
        rows[f"{name(kind)}_change"] = np.nanmean(change, axis=0)
        rows[f"{name(kind)}_change_se"] = _error(change)
    for kind, found in ratios.items():
        rows[f"{name(kind)}_se"] = _error(found)
    return rows, int(alike.sum())


def _error(found: np.ndarray) -> np.ndarray:
    """Standard error of the mean of each column; 0 of one value."""
    count = np.isfinite(found).sum(axis=0)
    return np.nanstd(found, axis=0) / np.sqrt(np.maximum(count - 1, 1))


def summary(rows: pd.DataFrame) -> tuple[float, int, int]:
    """Change of the mean over generations 2 to 6 in percent; in how many of how many it is lower."""
    some = rows[rows["generation"].between(2, 6)]
    lower = some["optimised_while_growing"] < some["growth_alone"]
    change = some["optimised_while_growing"].mean() / some["growth_alone"].mean() - 1
    return 100 * float(change), int(lower.sum()), len(some)


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
