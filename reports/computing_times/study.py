"""Seconds of each stage of the framework, in the paper's three cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from reports.common.figures import INK, LOOKS, PALE, panels, save
from reports.common.pages import Compared, Facts, Page, table, write_csv
from reports.common.trees import machine, made
from vascval.report.plots import plain_log

TITLE = "Computing times"
FULL = {"sizes": {"karch-box": (500, 6000), "portal-vein": (24_000,)}, "topology": {}}
SMALL = {
    "sizes": {"karch-box": (50, 80), "portal-vein": (80,)},
    "topology": {"topology__at": 40, "topology__tests": 500},
}
STAGES = {"growth": "CCO growth", "geometry": "geometry", "topology": "topology"}
PAPERS = (("karch-box", 500), ("karch-box", 6000), ("portal-vein", 24_000))
"""The cases of table 2, in the order in which our sizes stand for them."""


def study(folder: Path, sizes: Mapping[str, Sequence[int]], topology: Mapping[str, object]) -> Page:
    facts = Facts("computing_times")
    cases = [(preset, n) for preset, counts in sizes.items() for n in counts]
    rows, compared = [], []
    for (preset, n), (_, size) in zip(cases, PAPERS):
        tree = made(preset, n_terminals=n, method="full", **topology)
        for stage, words in STAGES.items():
            fact = f"time {words} {size} terminals"
            rows.append((preset, n, stage, facts[fact], tree.stage_s[stage], facts[fact] / tree.stage_s[stage]))
            compared.append(facts.compared(fact, tree.stage_s[stage]))
    frame = pd.DataFrame(rows, columns=["case", "terminals", "stage", "paper_s", "here_s", "times_faster"])
    write_csv(frame, folder / "table.csv")
    draw(folder, frame)
    preset, n = cases[-1]
    one = made(preset, n_terminals=n, method="geometry", geometry__during_growth=False).stage_s["geometry"]
    compared.append(facts.compared("time of one NLP at 24000 terminals", one))
    totals = frame.groupby(["case", "terminals"], sort=False)[["paper_s", "here_s"]].sum().reset_index()
    large = totals.iloc[-1]
    minutes = large["paper_s"] / 60
    compared.append(Compared("all of it, portal vein", large["paper_s"], large["here_s"], "s", "table 2"))
    headline = (
        f"The portal vein of {n:,} terminals takes {large['here_s']:.0f} s of processor time on {machine()}, where "
        f"the paper's took {minutes // 60:.0f} h {minutes % 60:.0f} min."
    )
    text = f"""
Processor seconds of the stages of `method=full` on {machine()}, kernels compiled: wall seconds on an idle machine, but
for the topology, whose chains run on a thread each and whose seconds are those of all threads together. The paper's are
wall seconds on an i9-9900K at 5 GHz with 16 threads and 32 GB (section 2.3.3).

{table(frame, 3)}

Three things make the difference. Growth carries the derivatives of the total volume up to the root once for each
candidate, and finds the nearest segments through a grid, instead of solving a programme for each connection. The
geometry is optimised in reduced space, where the radii and pressures follow from the positions and a step costs one
sweep over the tree. A tested topology is judged by the two paths to the root that it changes, not by a programme of
the whole tree. One programme at {n:,} terminals takes {one:.2f} s here, contraction of short segments included
(paper {facts["time of one NLP at 24000 terminals"]:.0f} s).
"""
    return Page(headline, compared, text)


def draw(folder: Path, frame: pd.DataFrame) -> None:
    cases = list(frame[["case", "terminals"]].drop_duplicates().itertuples(index=False))
    figure, axes = panels(len(cases), width_in=3.3, height_in=3.0)
    for place, (case, n) in zip(axes, cases):
        mine = frame[(frame["case"] == case) & (frame["terminals"] == n)]
        at = np.arange(len(mine))
        place.bar(at - 0.2, mine["paper_s"], 0.38, color=PALE, edgecolor=INK, linewidth=0.7, label="paper")
        place.bar(
            at + 0.2,
            mine["here_s"],
            0.38,
            color=LOOKS["optimised"]["color"],
            edgecolor=INK,
            linewidth=0.7,
            label="here",
        )
        place.set(title=f"{case}, {n:,}", yscale="log", ylabel="seconds" if place is axes[0] else "")
        place.set_xticks(at, labels=list(mine["stage"]))
    low = frame["here_s"].min() / 2
    for place in axes:
        place.set_ylim(low, 2 * frame["paper_s"].max())
        place.grid(False, axis="x")
        plain_log(place.yaxis)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower left", ncols=2)
    save(figure, folder)
