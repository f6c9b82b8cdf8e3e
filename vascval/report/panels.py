"""The figures by generation and by order: the key statistics of the paper's figure, and what goes with them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from vascval.report.page import Picture
from vascval.report.plots import handles, line, panel, whole_ticks
from vascval.report.subject import Side, Subject

KEY_STATISTICS = (
    ("n_segments", "Number of vessels", "segments", "log"),
    ("radius_mean_mm", "Mean radius", "radius (mm)", "linear"),
    ("branching_ratio_mean", "Mean branching ratio", "thinnest / thickest child", "linear"),
    ("length_mean_mm", "Mean length", "length (mm)", "linear"),
)


def key_statistics(subject: Subject, folder: Path) -> list[Picture]:
    """One panel per measure over the generations, all sides in each; bars are standard deviations."""
    return [_by_generation(subject, folder, *measure) for measure in KEY_STATISTICS]


def _by_generation(subject: Subject, folder: Path, column: str, title: str, unit: str, scale: str) -> Picture:
    shown = [side for side in subject.sides if _has(side.generations, column)]

    def draw(axes: Any) -> None:
        for k, side in enumerate(shown):
            _curve(axes, side, column, 0.1 * (k - (len(shown) - 1) / 2.0))
        axes.set(xlabel="generation (root 1)", ylabel=unit, yscale=scale)
        whole_ticks(axes.xaxis)
        if scale == "linear":
            axes.set_ylim(0, 1.02 if column == "branching_ratio_mean" else None)

    alt = f"{title} against generation. " + " ".join(_said(side, column) for side in shown)
    name = column.removesuffix("_mm").replace("_", "-")
    return panel(folder, name, title, alt, draw, legend=handles([side.series for side in shown]))


def _has(frame: pd.DataFrame, column: str) -> bool:
    return column in frame and bool(frame[column].notna().any())


def _curve(axes: Any, side: Side, column: str, shift: float) -> None:
    rows = side.generations.dropna(subset=[column])
    x, y = rows["generation"].to_numpy(float), rows[column].to_numpy(float)
    sd = column.replace("_mean", "_sd")
    if sd != column and sd in rows:
        spread = rows[sd].to_numpy(float)
        ok = np.isfinite(spread)
        low = np.minimum(spread[ok], y[ok])
        axes.errorbar(
            x[ok] + shift, y[ok], yerr=(low, spread[ok]), fmt="none", ecolor=side.series.colour, elinewidth=0.8,
            capsize=1.5, alpha=0.55,
        )
    axes.plot(x + shift * (sd != column), y, **line(side.series))


def _said(side: Side, column: str) -> str:
    rows = side.generations.dropna(subset=[column])
    first, last = rows.iloc[0], rows.iloc[-1]
    return (
        f"{side.label}: {first[column]:.3g} in generation {int(first['generation'])}, "
        f"{last[column]:.3g} in generation {int(last['generation'])}."
    )
