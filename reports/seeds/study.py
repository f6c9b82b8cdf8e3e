"""The same terminals connected in the order of different seeds: how different the trees become."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd

from reports.common.pages import Compared, Page, percent, table, write_csv
from reports.common.trees import TRUNK, Made, likeness, made, write_terminals
from reports.common.tubes import Layer, View, write_views

TITLE = "Dependence on the seed"
FULL = {"n_terminals": 500, "seeds": tuple(range(1, 11)), "shown": 3}
SMALL = {"n_terminals": 40, "seeds": (1, 2, 3), "shown": 3}


def study(folder: Path, n_terminals: int, seeds: Sequence[int], shown: int) -> Page:
    trees = reordered(n_terminals, seeds)
    volume = np.array([tree.volume_mm3 for tree in trees.values()])
    rows = pd.DataFrame({"seed": list(trees), "volume_mm3": volume})
    pairs = pairwise(list(trees.values()))
    write_csv(rows, folder / "table.csv")
    write_csv(pairs, folder / "pairs.csv")
    views = [View(f"Seed {seed}", [Layer(trees[seed].tree)]) for seed in list(trees)[:shown]]
    write_views(folder, views, columns=3)
    found, chance = pairs["alike_share"].mean(), pairs["by_chance_share"].mean()
    spread = np.ptp(volume) / volume.mean()
    headline = (
        f"Very different trees, as in the paper: of the first {TRUNK} generations {percent(found, 0)} agree "
        f"between two seeds "
        f"({percent(chance, 0)} would by chance), and volumes differ by up to {percent(spread)}."
    )
    text = f"""
The same {n_terminals:,} terminals of the benchmark box, connected in {len(seeds)} random orders
(`terminals_order=random`), growth alone. The paper shows three such trees and calls them very different. What
agrees is measured on the first {TRUNK} generations: the share of their length within 1 % of the diagonal of vessels
of like generation of the other tree, over all pairs of seeds.

{table(rows)}
"""
    said = '"very different" (in words)'
    return Page(
        headline,
        [
            Compared("trees of different seeds", said, percent(found, 0) + " of the trunk agrees", "", "section 2.2.2"),
            Compared("spread of the volume", None, percent(spread)),
        ],
        text,
    )


def reordered(n_terminals: int, seeds: Sequence[int], **changes: object) -> dict[int, Made]:
    """Trees of one set of terminals, connected in the order of each seed."""
    with tempfile.TemporaryDirectory() as work:
        points = write_terminals(made("karch-box", n_terminals=n_terminals).tree, Path(work) / "terminals.csv")
        return {
            seed: made("karch-box", terminals_file=points, terminals_order="random", seed=seed, **changes)
            for seed in seeds
        }


def pairwise(trees: Sequence[Made]) -> pd.DataFrame:
    """How alike any two of the trees are, each way."""
    rows = []
    for a, b in combinations(range(len(trees)), 2):
        both = [likeness(trees[i].tree, trees[j].tree) for i, j in ((a, b), (b, a))]
        rows.append((a + 1, b + 1, *np.mean(both, axis=0)))
    return pd.DataFrame(rows, columns=["first", "second", "alike_share", "by_chance_share"])
