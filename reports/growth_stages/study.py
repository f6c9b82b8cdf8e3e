"""One tree at several stages of its growth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from generator.config import load
from generator.framework import Run
from reports.common.pages import Compared, Page, percent, table, write_csv
from reports.common.trees import TRUNK, likeness
from reports.common.tubes import Layer, View, write_views
from vascval.core.tree import Tree

TITLE = "Stages of growth"
FULL = {"stages": (50, 500, 6000), "seed": 1}
SMALL = {"stages": (10, 30, 60), "seed": 1}


def study(folder: Path, stages: Sequence[int], seed: int) -> Page:
    run = Run.of(load("karch-box", [f"n_terminals={stages[-1]}", f"seed={seed}"]))
    trees = {n: at(run, n) for n in stages}
    kept = {n: likeness(tree, trees[stages[-1]]) for n, tree in trees.items()}
    rows = pd.DataFrame(
        {
            "terminals": stages,
            "volume_mm3": [tree.volume_mm3 for tree in trees.values()],
            "root_radius_mm": [tree.radius_mm[1] for tree in trees.values()],
            "terminal_radius_mean_mm": [tree.radius_mm[tree.topology.terminals].mean() for tree in trees.values()],
            "trunk_on_final_tree_share": [found for found, _ in kept.values()],
            "by_chance_share": [chance for _, chance in kept.values()],
        }
    )
    write_csv(rows, folder / "table.csv")
    views = [View(f"{n:,} terminals", [Layer(tree)]) for n, tree in trees.items()]
    write_views(folder, views, columns=3)
    first, (found, chance) = stages[0], kept[stages[0]]
    headline = (
        f"With {first} of {stages[-1]:,} terminals the structure is there, as in the paper: "
        f"{percent(found, 0)} of that tree's first "
        f"{TRUNK} generations lie on the final tree ({percent(chance, 0)} would by chance)."
    )
    text = f"""
One tree of the benchmark box, growth alone, at three moments. The paper calls the core structure at {first}
terminals "nearly identical" to that of the final tree; the table says how nearly: the share of the length of the
first {TRUNK} generations that lies within 1 % of the box's diagonal of vessels of like generation of the final
tree. What is missing is vessels whose generation shifted as the tree became deeper, and segments that later ones
have split.

{table(rows)}
"""
    said = 'core structure "nearly identical" (in words)'
    return Page(
        headline,
        [
            Compared(
                f"trunk at {first} terminals on that at {stages[-1]:,}", said, percent(found, 0), "", "section 2.2.2"
            )
        ],
        text,
    )


def at(run: Run, n_terminals: int) -> Tree:
    """The tree of a run when it has so many terminals."""
    for _ in run.growth.steps(n_terminals):
        pass
    tree = run.growth.tree()
    assert np.isclose(tree.topology.n_terminals, n_terminals)
    return tree
