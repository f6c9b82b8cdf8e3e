"""Final volume against the number of geometry optimisations during growth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from reports.common.figures import LOOKS, PALE, panels, save
from reports.common.pages import Compared, Page, percent, table, write_csv
from reports.common.trees import made

TITLE = "Geometry optimisations during growth"
FULL = {"n_terminals": 1000, "every": (1000, 500, 200, 100, 50, 20, 10, 5), "seeds": (1, 2, 3, 4, 5)}
SMALL = {"n_terminals": 60, "every": (60, 20, 10), "seeds": (1, 2)}
CHOSEN = 20


def study(folder: Path, n_terminals: int, every: Sequence[int], seeds: Sequence[int]) -> Page:
    cco = [made("karch-box", n_terminals=n_terminals, seed=seed) for seed in seeds]
    alone = np.array([tree.volume_mm3 for tree in cco])
    rows = [("", 0, alone.mean(), alone.min(), alone.max(), 0.0, np.mean([tree.cpu_s for tree in cco]))]
    for interval in every:
        trees = [
            made(
                "karch-box",
                n_terminals=n_terminals,
                seed=seed,
                method="geometry",
                geometry__every=interval,
                geometry__every_at_most=interval,
            )
            for seed in seeds
        ]
        volume = np.array([tree.volume_mm3 for tree in trees])
        rows.append(
            (str(interval), trees[0].solves, volume.mean(), volume.min(), volume.max(),
             100 * (1 - volume.mean() / alone.mean()), np.mean([tree.cpu_s for tree in trees]))
        )  # fmt: skip
    columns = ["terminals_between_two", "optimisations", "volume_mean_mm3", "volume_min_mm3", "volume_max_mm3"]
    frame = pd.DataFrame(rows, columns=[*columns, "less_percent", "processor_s"])
    write_csv(frame, folder / "table.csv")
    draw(folder, frame, n_terminals)
    optimised = frame.iloc[1:]
    chosen = optimised[optimised["terminals_between_two"] == str(CHOSEN)].iloc[0]
    end, best = optimised.iloc[0], optimised["less_percent"].max()
    headline = (
        f"One optimisation at the end takes {end['less_percent']:.1f} % off the volume, one every {CHOSEN} "
        f"terminals (the paper's choice) "
        f"{chosen['less_percent']:.1f} %, the best interval tested {best:.1f} %."
    )
    text = f"""
{n_terminals:,} terminals in the benchmark box, mean of {len(seeds)} seeds, against growth alone
({alone.mean():.0f} mm³, from {alone.min():.0f} to {alone.max():.0f}). The paper shows the final volume against the
number of optimisations in a figure whose values are not available, and chooses one every {CHOSEN} terminals as the
compromise between volume and time.

{table(frame)}

An optimisation takes milliseconds here, so that time is no reason against more of them; what decides is that the
volume hardly changes from some tens of optimisations on.
"""
    return Page(
        headline,
        [Compared("terminals between two optimisations", float(CHOSEN), float(CHOSEN), "", "section 2.3.1"),
         Compared("less volume with it than by growth alone", None, percent(chosen["less_percent"] / 100)),
         Compared("less volume with one optimisation at the end", None, percent(end["less_percent"] / 100))],
        text,
    )  # fmt: skip


def draw(folder: Path, frame: pd.DataFrame, n_terminals: int) -> None:
    figure, (axes, clock) = panels(2)
    x = frame["optimisations"].to_numpy()
    axes.fill_between(
        x, frame["volume_min_mm3"], frame["volume_max_mm3"], color=PALE, label="lowest and highest of the seeds"
    )
    axes.plot(x, frame["volume_mean_mm3"], label="mean", **LOOKS["optimised"])
    axes.set(title="Final volume", ylabel=f"mm³ at {n_terminals:,} terminals")
    axes.legend()
    clock.plot(x, frame["processor_s"], **LOOKS["optimised"])
    clock.set(title="Time of it all", ylabel="processor seconds", ylim=(0, None))
    for place in (axes, clock):
        place.set(xlabel="optimisations during growth and at its end", xscale="symlog", xlim=(-0.3, 1.3 * x.max()))
        place.set_xticks([0, 1, 10, 100], labels=["0", "1", "10", "100"])
    save(figure, folder)
