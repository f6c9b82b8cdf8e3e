"""Volume of ten trees against the number of topologies tested."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from reports.common.figures import INK, PALE, panels, save
from reports.common.pages import Compared, Facts, Page, percent, table, write_csv
from reports.common.trees import made
from reports.seeds.study import reordered

TITLE = "Volume of ten trees against tested topologies"
FULL = {"n_terminals": 500, "tests": (1000, 3000, 10_000, 30_000, 100_000, 300_000), "seeds": tuple(range(1, 11))}
SMALL = {"n_terminals": 40, "tests": (100, 1000), "seeds": (1, 2, 3)}


def study(folder: Path, n_terminals: int, tests: Sequence[int], seeds: Sequence[int]) -> Page:
    facts = Facts("tested_topologies")
    search = {"method": "full", "topology__chains": 1, "topology__at": n_terminals}
    columns = {
        "growth": reordered(n_terminals, seeds),
        "geometry": reordered(n_terminals, seeds, method="geometry", geometry__during_growth=False),
        **{f"{n:,}": reordered(n_terminals, seeds, **search, topology__tests=n) for n in tests},
    }
    volume = pd.DataFrame({name: [tree.volume_mm3 for tree in trees.values()] for name, trees in columns.items()})
    write_csv(volume.assign(seed=list(seeds))[["seed", *volume.columns]], folder / "table.csv")
    draw(folder, volume)
    rows = pd.DataFrame(
        {
            "after": list(volume.columns),
            "median_mm3": volume.median().to_numpy(),
            "lowest_mm3": volume.min().to_numpy(),
            "highest_mm3": volume.max().to_numpy(),
            "spread_percent": (100 * (volume.max() - volume.min()) / volume.mean()).to_numpy(),
            "less_than_growth_percent": (100 * (1 - volume.mean() / volume["growth"].mean())).to_numpy(),
        }
    )
    last, geometry = volume.iloc[:, -1], volume["geometry"]
    further, total = (1 - last / geometry).max(), (1 - last / volume["growth"]).max()
    falls = percent(rows["spread_percent"].iloc[0] / 100), percent(rows["spread_percent"].iloc[-1] / 100)
    headline = (
        f"{tests[-1]:,} tests bring the volume {rows['less_than_growth_percent'].iloc[-1]:.1f} % below "
        f"growth on average and the spread of "
        f"{len(seeds)} trees from {falls[0]} to {falls[1]}."
    )
    n_swaps = facts["possible swaps at 500 terminals"]
    text = f"""
The same {n_terminals:,} terminals of the benchmark box connected in {len(seeds)} random orders; each tree's
topology is then searched by one chain of as many tests as stand below its box, cooling over just these tests.
"geometry" is the grown tree with its geometry optimised alone.

{table(rows)}

The paper shows a box plot without numbers: the volume falls significantly and so does the variance between trees.
It does not say how many tests its search had; of the {n_swaps:,.0f} possible swaps its filters leave
{facts["swaps left after the filters at 500 terminals"]:,.0f} for each step. Here a test moves a subtree anywhere
nearby or swaps two as in the paper, and is judged by the two paths to the root that it changes, which is why so
many can be afforded.

{free_terminals(n_terminals, seeds, search | {"topology__tests": tests[-1]})}
"""
    return Page(
        headline,
        [
            facts.compared("further reduction by topology optimisation (up to)", 100 * further),
            facts.compared("total reduction against CCO (up to)", 100 * total),
            Compared("spread of the volumes", "falls (in words)", " to ".join(falls), "", "section 2.3.2"),
        ],
        text,
    )


def free_terminals(n_terminals: int, seeds: Sequence[int], search: dict[str, object]) -> str:
    """The same where each seed draws its own terminals, whose volumes cannot become alike."""
    pairs = [
        [made("karch-box", n_terminals=n_terminals, seed=seed, **changes).volume_mm3 for changes in ({}, search)]
        for seed in seeds[:5]
    ]
    volume = np.array(pairs)
    less = 1 - volume[:, 1] / volume[:, 0]
    return (
        f"Where each seed draws terminals of its own, volumes stay apart ({volume[:, 1].min():.0f} to "
        f"{volume[:, 1].max():.0f} mm³), and the tree "
        f"ends {100 * less.min():.1f} to {100 * less.max():.1f} % below growth ({len(pairs)} seeds)."
    )


def draw(folder: Path, volume: pd.DataFrame) -> None:
    figure, (axes,) = panels(1, width_in=6.0, height_in=3.6)
    axes.boxplot(
        volume.to_numpy(), tick_labels=list(volume.columns), patch_artist=True, widths=0.55, whis=(0, 100),
        boxprops={"facecolor": PALE, "edgecolor": INK}, medianprops={"color": INK, "linewidth": 2.0},
        whiskerprops={"color": INK}, capprops={"color": INK},
    )  # fmt: skip
    for k, name in enumerate(volume.columns, 1):
        across = k + np.linspace(-0.18, 0.18, len(volume))
        axes.plot(across, volume[name], "o", markersize=2.5, color=INK, alpha=0.6)
    axes.set(title="Volume of the trees", xlabel="after growth, geometry, and so many tested topologies", ylabel="mm³")
    save(figure, folder)
