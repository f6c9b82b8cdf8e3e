"""What optimising changes in the generations of a tree, by pairs of trees of one seed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from generator.config import load
from reports.common.trees import measured
from reports.portal_vein.trees import BEST, GROWN, ONCE, PAPERS, PRESET
from vascval.core.tree import Tree
from vascval.morphometry import Analysis, analyze

AS_GROWN = "growth not contracted"
FIRST = 6
"""Generations of which the paper speaks."""
ALL = f"1 to {FIRST}"
RADII = {
    "mean over segments": ("radius_mean_mm", GROWN),
    "mean over vessels": ("radius_of_vessels_mm", GROWN),
    "weighted by length": ("radius_by_length_mm", GROWN),
    "mean over segments, growth not contracted": ("radius_mean_mm", AS_GROWN),
    "of which numbering": ("root_of_terminals", GROWN),
    "of which radius at equal flow": ("radius_at_equal_flow", GROWN),
}
"""Measures of the radius of a generation, the usual one first: column, and the tree that it is held against."""


def by_generation(trees: Mapping[str, Sequence[Tree]], seeds: Sequence[int]) -> pd.DataFrame:
    """One row per kind of tree, seed and generation; ``AS_GROWN`` is the grown tree measured without contraction."""
    parts = [
        _rows(measured(tree)).assign(tree=kind, seed=seed)
        for kind, made in trees.items()
        for seed, tree in zip(seeds, made)
    ]
    for seed, tree in zip(seeds, trees[GROWN]):
        parts.append(_rows(analyze(tree, source="tree", diameters=0.0)).assign(tree=AS_GROWN, seed=seed))
    frame = pd.concat(parts, ignore_index=True)
    return frame[["tree", "seed", *frame.columns.drop(["tree", "seed"])]]


def _rows(side: Analysis) -> pd.DataFrame:
    """The generations of one tree.

    A segment that feeds n terminals carries n times the flow of one, so that its radius is about n^(1/gamma) times
    theirs (exactly, were they all alike). ``root_of_terminals`` is the mean of n^(1/gamma) over the segments: how the
    vessels are numbered, not how wide they are. ``radius_at_equal_flow`` is the mean radius over that, so that
    the mean radius is the product of both.
    """
    segments = side.segments
    vessels = side.elements.groupby("generation")["radius_mm"].mean()
    frame = side.generations.set_index("generation")[
        ["n_segments", "radius_mean_mm", "branching_ratio_mean", "total_length_mm"]
    ]
    generation, length = segments["generation"], segments["length_mm"]
    weighted = (segments["radius_mm"] * length).groupby(generation).sum()
    even = _even(segments).groupby(generation).mean()
    return frame.assign(
        radius_of_vessels_mm=vessels,
        radius_by_length_mm=weighted / length.groupby(generation).sum(),
        root_of_terminals=even,
        radius_at_equal_flow=frame["radius_mean_mm"] / even,
    ).reset_index()


def _even(segments: pd.DataFrame) -> pd.Series:
    return segments["n_terminals"].astype(float) ** (1 / load(PRESET).gamma)


def change(rows: pd.DataFrame, column: str, kind: str, against: str = GROWN) -> pd.DataFrame:
    """By generation (rows) and seed, percent by which a measure of ``kind`` differs from that of ``against``.

    The last row, ``ALL``, is the mean over the generations of which the paper speaks. NaN where one tree of a pair
    lacks the generation.
    """
    wide = rows.pivot(index="generation", columns=["tree", "seed"], values=column)
    percent = 100 * (wide[kind] / wide[against] - 1)
    every = percent[percent.index <= FIRST].mean()
    percent.index = percent.index.astype(str)
    percent.loc[ALL] = every
    return percent


def with_errors(percent: pd.DataFrame) -> pd.DataFrame:
    """Mean over the seeds (columns), its standard error (NaN below two) and their number, row by row."""
    n = percent.notna().sum(axis=1)
    error = percent.std(axis=1, ddof=1) / np.sqrt(n)
    return pd.DataFrame({"change_percent": percent.mean(axis=1), "error_percent": error, "seeds": n})


def changes(rows: pd.DataFrame) -> pd.DataFrame:
    """All measures of the radius, and the branching ratio, of the optimised trees: mean change, error, by generation.

    One row per tree, measure and generation; the last of each measure is ``ALL``.
    """
    measures = {**RADII, "branching ratio": ("branching_ratio_mean", GROWN)}
    parts = [
        with_errors(change(rows, column, kind, against)).rename_axis("generation").reset_index()
        .assign(tree=kind, measure=name)
        for kind in (BEST, ONCE, PAPERS)
        for name, (column, against) in measures.items()
    ]  # fmt: skip
    frame = pd.concat(parts, ignore_index=True)
    columns = ["tree", "measure", "generation", "change_percent", "error_percent", "seeds"]
    return frame[columns].dropna(subset="change_percent").reset_index(drop=True)


def at_equal_flow(grown: Tree, optimised: Tree) -> pd.Series:
    """Percent by which segments that feed as many terminals are wider in the optimised tree.

    Indexed by the least number of terminals of each class: 1, 2, 4, 8, ..., each up to the next.
    """
    means = []
    for tree in (grown, optimised):
        segments = measured(tree).segments
        classes = 2 ** np.floor(np.log2(segments["n_terminals"].astype(float))).astype(int)
        means.append((segments["radius_mm"] / _even(segments)).groupby(classes).mean())
    return 100 * (means[1] / means[0] - 1)
