"""Three seeds before and after the topology is optimised, laid over each other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from reports.common.figures import GREEN, PURPLE, RED
from reports.common.pages import Compared, Page, percent, table, write_csv
from reports.common.trees import TRUNK
from reports.common.tubes import Layer, View, write_views
from reports.seeds.study import pairwise, reordered

TITLE = "Three seeds before and after topology optimisation"
FULL = {"n_terminals": 500, "seeds": (1, 2, 3), "chains": 12, "tests": 150_000, "rounds": 5}
SMALL = {"n_terminals": 40, "seeds": (1, 2, 3), "chains": 2, "tests": 500, "rounds": 2}
COLOURS = (GREEN, RED, PURPLE)


def study(folder: Path, n_terminals: int, seeds: Sequence[int], chains: int, tests: int, rounds: int) -> Page:
    before = reordered(n_terminals, seeds, method="geometry")
    after = reordered(
        n_terminals, seeds, method="full", topology__at=n_terminals, topology__chains=chains, topology__tests=tests,
        topology__rounds=rounds,
    )  # fmt: skip
    grown = reordered(n_terminals, seeds)
    rows = pd.DataFrame(
        {
            "seed": seeds,
            "growth_mm3": [grown[seed].volume_mm3 for seed in seeds],
            "geometry_mm3": [before[seed].volume_mm3 for seed in seeds],
            "topology_mm3": [after[seed].volume_mm3 for seed in seeds],
        }
    )
    rows["less_than_geometry_percent"] = 100 * (1 - rows["topology_mm3"] / rows["geometry_mm3"])
    rows["less_than_growth_percent"] = 100 * (1 - rows["topology_mm3"] / rows["growth_mm3"])
    write_csv(rows, folder / "table.csv")
    pairs = {name: pairwise(list(trees.values())) for name, trees in (("geometry", before), ("topology", after))}
    alike = pd.concat([frame.assign(after=name) for name, frame in pairs.items()])
    write_csv(alike[["after", *pairs["geometry"].columns]], folder / "pairs.csv")
    views = [
        View(f"Seed {seed}: {what}", [Layer(trees[seed].tree)])
        for seed in seeds
        for what, trees in (("geometry", before), ("geometry and topology", after))
    ]
    for what, trees in (("geometry", before), ("geometry and topology", after)):
        layers = [Layer(trees[s].tree, colour, f"seed {s}") for s, colour in zip(seeds, COLOURS)]
        views.append(View(f"All three: {what}", layers))
    write_views(folder, views, columns=2, width_in=4.2)
    shares = {name: frame["alike_share"].mean() for name, frame in pairs.items()}
    before_share, after_share = (percent(share, 0) for share in shares.values())
    chance = np.mean([frame["by_chance_share"].mean() for frame in pairs.values()])
    headline = (
        f"Of the first {TRUNK} generations {before_share} agree between seeds before the "
        f"topology is optimised and "
        f"{after_share} after ({percent(chance, 0)} by chance); the paper sees trees "
        f"become very similar."
    )
    text = f"""
The same {n_terminals:,} terminals of the benchmark box, connected in the order of three seeds, with the geometry
optimised while growing, and then with the topology too ({rounds} rounds of {chains} chains of {tests:,} tests,
about a minute of one core for each seed). What agrees is measured as in
[dependence on the seed](../seeds/README.md). Volumes:

{table(rows)}

Pairs of seeds:

{table(alike[["after", *pairs["geometry"].columns]])}

The volumes come much closer to each other than the places of the vessels. There are many topologies of nearly the
least volume: two trees whose volumes differ by a thousandth can still feed a corner of the box by different
trunks. The paper judges by eye.
"""
    return Page(
        headline,
        [
            Compared("trunk that agrees before", '"very different" (in words)', before_share, "", "section 2.2.2"),
            Compared("trunk that agrees after", '"very similar" (in words)', after_share, "", "section 2.3.3"),
        ],
        text,
    )
