"""Volume of the tree against the number of connections tested for each new terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from reports.common.figures import LOOKS, PALE, counted, panels, save
from reports.common.pages import Facts, Page, percent, table, write_csv
from reports.common.trees import made

TITLE = "How many connections to test"
FULL = {"n_terminals": 6000, "connections": (2, 4, 8, 16, 32, 64, 128), "seeds": (1, 2, 3, 4, 5)}
SMALL = {"n_terminals": 60, "connections": (2, 8, 32), "seeds": (1, 2)}
HARDLY = 0.001
"""A further doubling that lowers the mean volume by less than this changes nothing worth its time."""


def study(folder: Path, n_terminals: int, connections: Sequence[int], seeds: Sequence[int]) -> Page:
    facts = Facts("connections")
    grown = {
        n: [made("karch-box", n_terminals=n_terminals, n_connections=n, seed=seed) for seed in seeds]
        for n in connections
    }
    volume = np.array([[tree.volume_mm3 for tree in trees] for trees in grown.values()])
    rows = pd.DataFrame(
        {
            "connections": connections,
            "volume_mean_mm3": volume.mean(axis=1),
            "volume_min_mm3": volume.min(axis=1),
            "volume_max_mm3": volume.max(axis=1),
            "processor_s": [np.mean([tree.cpu_s for tree in trees]) for trees in grown.values()],
        }
    )
    write_csv(rows, folder / "table.csv")
    draw(folder, rows, volume, n_terminals)
    mean = rows["volume_mean_mm3"].to_numpy()
    falls = 1 - mean[1:] / mean[:-1]
    enough = next((n for n, fall in zip(connections, falls) if fall < HARDLY), connections[-1])
    at = facts["connections tested beyond which the volume hardly falls"]
    beyond = 1 - mean[-1] / mean[min(np.searchsorted(connections, at), len(mean) - 1)]
    headline = (
        f"The paper takes {at:.0f} connections; here the volume stops falling at {enough}, and testing "
        f"{connections[-1]} instead of {at:.0f} changes it by {abs(100 * beyond):.2f} %."
    )
    text = f"""
Growth alone in the benchmark box, {n_terminals:,} terminals, {len(seeds)} seeds. "Hardly" is taken as: doubling the
number lowers the mean volume by less than {percent(HARDLY)}. The paper's curve has one tree for each number; the
band here shows that trees of different seeds differ by more than numbers beyond {enough} do.

Both find that a few dozen suffice. The values behind the paper's curve are not available, so that it cannot be said
whether its {at:.0f} has the margin that ours has; {at:.0f} is this project's default too.

{table(rows)}
"""
    return Page(
        headline,
        [facts.compared("connections tested beyond which the volume hardly falls", float(enough))],
        text,
    )


def draw(folder: Path, rows: pd.DataFrame, volume: np.ndarray, n_terminals: int) -> None:
    figure, (axes, clock) = panels(2)
    x = rows["connections"].to_numpy()
    axes.fill_between(x, volume.min(axis=1), volume.max(axis=1), color=PALE, label="lowest and highest of the seeds")
    axes.plot(x, rows["volume_mean_mm3"], label="mean", **LOOKS["cast"])
    axes.set(title="Volume of the tree", xlabel="connections tested", ylabel=f"mm³ at {n_terminals:,} terminals")
    axes.legend()
    clock.plot(x, rows["processor_s"], **LOOKS["cast"])
    clock.set(title="Time of growth", xlabel="connections tested", ylabel="processor seconds", ylim=(0, None))
    for place in (axes, clock):
        place.set_xscale("log")
        counted(place.xaxis, x)
    save(figure, folder)
