"""Distributions of one measure in cast and tree: how far apart, and how surely."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.stats import mannwhitneyu, wasserstein_distance

from vascval.io.rows import DistributionRow
from vascval.morphometry import Analysis

SEGMENT_MEASURES = (
    "radius_mm",
    "length_mm",
    "tortuosity",
    "length_to_diameter",
    "radius_to_parent",
    "branching_angle_deg",
)
JUNCTION_MEASURES = ("branching_ratio", "area_ratio", "murray_exponent", "angle_between_deg")
TEST = "mann-whitney-u"


def distribution_table(cast: Analysis, trees: list[Analysis], *, minimum: int) -> pd.DataFrame:
    """One row per tree, measure and generation, first of all generations (:class:`vascval.io.rows.DistributionRow`).

    The test is Mann-Whitney's U, two-sided, by its normal approximation with ties corrected; its effect size is
    Cliff's delta, ``2 U / (n m) - 1``, positive where the tree's values are the larger. Both see a shift of the
    values, hardly a change of their spread; the Wasserstein distance sees either. With thousands of vessels p values
    are tiny for differences of no consequence.

    Values that do not exist (a Murray exponent without solution) are left out of the counts. Rows of which a side has
    no value are left out; below ``minimum`` values on a side there is no test. For the test, values within about a
    millionth of the largest are ties: exponents of 3 up to round-off differ in nothing that a rank should see.
    """
    rows = []
    for index, tree in enumerate(trees):
        for name in (*SEGMENT_MEASURES, *JUNCTION_MEASURES):
            theirs, ours = _values(cast, name), _values(tree, name)
            generations = np.intersect1d(theirs["generation"], ours["generation"])
            for generation in (None, *generations.tolist()):
                a = _of(theirs, name, generation)
                b = _of(ours, name, generation)
                if a.size and b.size:
                    rows.append((index, name, generation, *_row(a, b, minimum)))
    return pd.DataFrame(rows, columns=list(DistributionRow.model_fields)).astype({"generation": "Int64"})


def _values(analysis: Analysis, name: str) -> pd.DataFrame:
    """Values that exist, with their generation; the junction at a root point, which nothing feeds, has none."""
    table = analysis.segments if name in SEGMENT_MEASURES else analysis.junctions
    return table.loc[table["generation"] > 0, ["generation", name]].dropna()


def _of(values: pd.DataFrame, name: str, generation: int | None) -> np.ndarray:
    chosen = values if generation is None else values[values["generation"] == generation]
    return chosen[name].to_numpy(float)


def _row(a: np.ndarray, b: np.ndarray, minimum: int) -> tuple[object, ...]:
    distance = float(wasserstein_distance(a, b))
    spread = float(a.std(ddof=1)) if a.size > 1 else 0.0
    relative = distance / spread if spread > 1e-6 * np.abs(a).max() else np.nan  # below that, round-off
    statistic = p_value = effect = np.nan
    middle = (a.mean(), b.mean(), np.median(a), np.median(b))
    if min(a.size, b.size) >= minimum:
        a, b = _without_round_off(a, b)
        if a.min() == a.max() == b.min() == b.max():
            statistic, p_value = a.size * b.size / 2, 1.0  # all values tied: the variance of U is 0
        else:
            test = mannwhitneyu(b, a, alternative="two-sided", method="asymptotic")
            statistic, p_value = float(test.statistic), float(test.pvalue)
        effect = 2 * statistic / (a.size * b.size) - 1
    return (a.size, b.size, *middle, distance, relative, TEST, statistic, p_value, effect)


def _without_round_off(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    scale = max(np.abs(a).max(), np.abs(b).max()) or 1.0
    return np.round(a / scale, 6), np.round(b / scale, 6)
