"""Box plots over the trees of an ensemble, in total and by generation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from vascval.report.ensemble_tables import Ensemble
from vascval.report.page import Picture
from vascval.report.panels import KEY_STATISTICS
from vascval.report.plots import SIZE_IN, panel, plain_log, plain_text, whole_ticks
from vascval.report.style import INK, TREES

_CASES_PER_PANEL = len(TREES)
_TOTALS = (
    ("volume_mm3", "Volume", "volume (mm³)"),
    ("total_length_mm", "Total length", "length (mm)"),
    ("n_trifurcations", "Trifurcations", "number"),
)
_WIDTH = 0.8  # of the boxes of one generation together


def totals(ensemble: Ensemble, folder: Path) -> list[Picture]:
    """One panel per total: a box per case, a point per tree."""
    pictures = []
    for part, cases in _parts(ensemble.cases):
        for column, title, unit in _TOTALS:
            values = [_values(ensemble.trees, case, column) for case in cases]

            def draw(axes: Any, values: list[np.ndarray] = values, unit: str = unit, cases: Any = cases) -> None:
                for k, one in enumerate(values):
                    _box(axes, one, k, 0.5, TREES[k][0])
                    axes.plot(np.full(one.size, k), one, ".", color=INK, markersize=3, alpha=0.6)
                axes.set(ylabel=unit, xlim=(-0.7, len(cases) - 0.3))
                axes.set_xticks([])
                if unit == "number":
                    whole_ticks(axes.yaxis)

            name = f"ensemble-{column.removesuffix('_mm').removesuffix('_mm3').replace('_', '-')}{part}"
            pictures.append(panel(folder, name, title, _said(title, cases, values), draw, legend=_legend(cases)))
    return pictures


def generations(ensemble: Ensemble, folder: Path) -> list[Picture]:
    """One panel per key statistic: a box per generation and case."""
    pictures = []
    frame = ensemble.tree_generations
    last = int(frame["generation"].max())
    for part, cases in _parts(ensemble.cases):
        for column, title, unit, scale in KEY_STATISTICS:

            def draw(axes: Any, column: str = column, unit: str = unit, scale: str = scale, cases: Any = cases) -> None:
                width = _WIDTH / len(cases)
                for k, case in enumerate(cases):
                    for generation, rows in frame[frame["case"] == case].groupby("generation"):
                        at = generation + (k - (len(cases) - 1) / 2.0) * width
                        _box(axes, rows[column].dropna().to_numpy(float), at, 0.85 * width, TREES[k][0])
                axes.set(xlabel="generation (root 1)", ylabel=unit, yscale=scale, xlim=(0.4, last + 0.6))
                if scale == "log":
                    plain_log(axes.yaxis)
                axes.set_xticks(range(1, last + 1))
                whole_ticks(axes.xaxis)

            name = f"ensemble-{column.removesuffix('_mm').replace('_', '-')}-by-generation{part}"
            values = [_values(frame, case, column) for case in cases]
            alt = _said(f"{title} by generation, all generations", cases, values)
            size = (SIZE_IN[0] * 1.5, SIZE_IN[1]) if len(cases) > 2 else SIZE_IN
            pictures.append(panel(folder, name, title, alt, draw, legend=_legend(cases), size_in=size))
    return pictures


def _parts(cases: Sequence[str]) -> list[tuple[str, Sequence[str]]]:
    """The cases, so many at a time as there are colours, and how the names of their panels end."""
    starts = range(0, len(cases), _CASES_PER_PANEL)
    return [("" if len(starts) == 1 else f"-{k}", cases[i : i + _CASES_PER_PANEL]) for k, i in enumerate(starts, 1)]


def _values(frame: pd.DataFrame, case: str, column: str) -> np.ndarray:
    return frame.loc[frame["case"] == case, column].dropna().to_numpy(float)


def _box(axes: Any, values: np.ndarray, at: float, width: float, colour: str) -> None:
    if not values.size:
        return
    line = {"color": colour, "linewidth": 1.0}
    axes.boxplot(
        values, positions=[at], widths=width, manage_ticks=False, patch_artist=True, whiskerprops=line, capprops=line,
        boxprops={"facecolor": f"{colour}33", "edgecolor": colour, "linewidth": 1.0},
        medianprops={"color": colour, "linewidth": 1.8},
        flierprops={"marker": "o", "markersize": 2.5, "markerfacecolor": "none", "markeredgecolor": colour},
    )  # fmt: skip


def _legend(cases: Sequence[str]) -> list[Any]:
    from matplotlib.patches import Patch

    if len(cases) == 1 and not cases[0]:
        return []
    return [
        Patch(facecolor=f"{colour}33", edgecolor=colour, label=plain_text(case))
        for case, (colour, _, _) in zip(cases, TREES)
    ]


def _said(title: str, cases: Sequence[str], values: Sequence[np.ndarray]) -> str:
    parts = [
        f"{case or 'trees'}: median {np.median(one):.4g}, from {one.min():.4g} to {one.max():.4g}"
        for case, one in zip(cases, values)
        if one.size
    ]
    return f"{title}. {'; '.join(parts)}."
