"""The figures by generation and by order: the key statistics of the paper's figure, and what goes with them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from vascval.report.page import Picture
from vascval.report.plots import from_zero, handles, line, panel, plain_log, plain_text, whole_ticks
from vascval.report.style import MUTED
from vascval.report.subject import Side, Subject

if TYPE_CHECKING:
    from vascval.morphometry import Analysis

KEY_STATISTICS = (
    ("n_segments", "Number of vessels", "segments", "log"),
    ("radius_mean_mm", "Mean radius", "radius (mm)", "linear"),
    ("branching_ratio_mean", "Mean branching ratio", "thinnest / thickest child", "linear"),
    ("length_mean_mm", "Mean length", "length (mm)", "linear"),
)


def key_statistics(subject: Subject, folder: Path) -> list[Picture]:
    """One panel per measure over the generations, all sides in each; bars are standard deviations."""
    pictures = []
    for column, title, unit, scale in KEY_STATISTICS:
        shown = [side for side in subject.sides if _has(side.generations, column)]
        if shown:
            pictures.append(_by_generation(shown, folder, column, title, unit, scale))
    return pictures


def _by_generation(shown: list[Side], folder: Path, column: str, title: str, unit: str, scale: str) -> Picture:
    def draw(axes: Any) -> None:
        for k, side in enumerate(shown):
            _curve(axes, side, column, 0.1 * (k - (len(shown) - 1) / 2.0))
        axes.set(xlabel="generation (root 1)", ylabel=unit, yscale=scale)
        if scale == "log":
            plain_log(axes.yaxis)
        whole_ticks(axes.xaxis)
        if scale == "linear":
            from_zero(axes)

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
        below = np.minimum(spread[ok], y[ok])
        above = np.minimum(spread[ok], 1.0 - y[ok]) if column == "branching_ratio_mean" else spread[ok]
        look = {"ecolor": side.series.colour, "elinewidth": 0.8, "capsize": 1.5, "alpha": 0.55}
        axes.errorbar(x[ok] + shift, y[ok], yerr=(below, above), fmt="none", **look)
    axes.plot(x + shift * (sd != column), y, **line(side.series))


def _said(side: Side, column: str) -> str:
    rows = side.generations.dropna(subset=[column])
    first, last = rows.iloc[0], rows.iloc[-1]
    return (
        f"{side.label}: {first[column]:.3g} in generation {int(first['generation'])}, "
        f"{last[column]:.3g} in generation {int(last['generation'])}."
    )


ORDER_MEASURES = (
    ("n_elements", "Number of elements", "elements"),
    ("element_radius_mean_mm", "Mean radius of elements", "radius (mm)"),
    ("element_length_mean_mm", "Mean length of elements", "length (mm)"),
)


def orders(subject: Subject, ordering: str, folder: Path) -> list[Picture]:
    """Numbers, radii and lengths of the elements over the orders, logarithmic: Horton's laws are straight lines."""
    shown = [(side, table) for side, analysis in subject.measured if len(table := _ordered(analysis.orders, ordering))]
    return [_by_order(shown, ordering, folder, *measure) for measure in ORDER_MEASURES] if shown else []


def _ordered(frame: pd.DataFrame, ordering: str) -> pd.DataFrame:
    return frame[frame["ordering"] == ordering]


def _by_order(
    shown: list[tuple[Side, pd.DataFrame]], ordering: str, folder: Path, column: str, title: str, unit: str
) -> Picture:
    def draw(axes: Any) -> None:
        for side, table in shown:
            axes.plot(table["order"], table[column], **line(side.series))
        axes.set(xlabel=f"{ORDERINGS[ordering]} order (terminals 1)", ylabel=unit, yscale="log")
        plain_log(axes.yaxis)
        whole_ticks(axes.xaxis)

    last = [(side, table.iloc[0], table.iloc[-1]) for side, table in shown]
    alt = f"{title} against {ORDERINGS[ordering]} order. " + " ".join(
        f"{side.label}: {a[column]:.3g} in order {int(a['order'])}, {b[column]:.3g} in order {int(b['order'])}."
        for side, a, b in last
    )
    name = f"{ordering}-{column.removesuffix('_mm').replace('_', '-')}"
    return panel(folder, name, title, alt, draw, legend=handles([side.series for side, _ in shown]))


ORDERINGS = {"strahler": "Strahler", "diameter-defined": "diameter-defined"}

JUNCTION_SHARES = (
    ("n_trifurcations", "Trifurcations", "share of the junctions (%)"),
    ("n_monopodial", "Monopodial branches", "branches per 100 junctions"),
)


def junctions(subject: Subject, folder: Path) -> list[Picture]:
    """Trifurcations and monopodial branches over the generations, per junction so that sizes of trees do not matter."""
    shown = [side for side, _ in subject.measured]
    return [_per_junction(shown, folder, *measure) for measure in JUNCTION_SHARES] if shown else []


def _per_junction(shown: list[Side], folder: Path, column: str, title: str, unit: str) -> Picture:
    def draw(axes: Any) -> None:
        for side in shown:
            rows = side.generations[side.generations["n_junctions"] > 0]
            axes.plot(rows["generation"], 100.0 * rows[column] / rows["n_junctions"], **line(side.series))
        axes.set(xlabel="generation that feeds the junction", ylabel=unit)
        from_zero(axes)
        whole_ticks(axes.xaxis)

    alt = f"{title} per junction against generation. " + " ".join(
        f"{side.label}: {int(side.generations[column].sum())} in all." for side in shown
    )
    name = f"{column.removeprefix('n_')}-per-junction"
    return panel(folder, name, title, alt, draw, legend=handles([side.series for side in shown]))


def sensitivity(subject: Subject, folder: Path) -> list[Picture]:
    """How the count of monopodial branches moves with its thresholds: one panel per tree, all on one scale."""
    return [_sensitivity(side, analysis, k, folder) for k, (side, analysis) in enumerate(subject.measured)]


_STRAIGHT = (("#9cc3de", "v", ":"), ("#3f86b5", "o", "-"), ("#123f5c", "^", "--"))


def _sensitivity(side: Side, analysis: Analysis, index: int, folder: Path) -> Picture:
    from matplotlib.lines import Line2D

    table, usual = analysis.monopodial_sensitivity, analysis.parameters["monopodial"]["ratio_max"]
    straight = sorted(table["straight_max_deg"].unique())
    looks = dict(zip(straight, _STRAIGHT))

    def draw(axes: Any) -> None:
        for value, (colour, marker, dash) in looks.items():
            by_ratio = table[table["straight_max_deg"] == value].groupby("ratio_max")["n_monopodial"]
            low, middle, high = by_ratio.min(), by_ratio.median(), by_ratio.max()
            axes.fill_between(low.index, low, high, color=colour, alpha=0.25, linewidth=0)
            axes.plot(middle.index, middle, color=colour, marker=marker, linestyle=dash)
        axes.axvline(usual, color=MUTED, linewidth=0.8, zorder=0)
        axes.set(xlabel="largest radius relative to the sibling", ylabel="monopodial branches")
        axes.set_xticks(sorted(table["ratio_max"].unique()))
        axes.set_ylim(0, max(1.0, 1.08 * table["n_monopodial"].max()))
        whole_ticks(axes.yaxis)

    legend = [
        Line2D([], [], color=colour, marker=marker, linestyle=dash, label=f"sibling within {value:g}°")
        for value, (colour, marker, dash) in looks.items()
    ]
    alt = (
        f"Monopodial branches of {side.label} by thresholds: from {table['n_monopodial'].min()} "
        f"to {table['n_monopodial'].max()} over all {len(table)} combinations."
    )
    return panel(folder, f"monopodial-sensitivity-{index}", plain_text(side.label), alt, draw, legend=legend)
