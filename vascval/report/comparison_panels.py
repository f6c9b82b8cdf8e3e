"""The figures that hold a cast against trees: distributions, effect sizes, location, territories."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from vascval.comparison import Comparison, Location
from vascval.morphometry import Analysis
from vascval.report.formats import effect
from vascval.report.page import Picture
from vascval.report.plots import from_zero, handles, line, panel, plain_log, plain_text, whole_ticks
from vascval.report.style import MUTED, Series
from vascval.report.subject import Side, Subject

MEASURES = {
    "radius_mm": ("Radius", "radius (mm)", "log"),
    "length_mm": ("Length", "length (mm)", "log"),
    "length_to_diameter": ("Length to diameter", "length / diameter", "log"),
    "tortuosity": ("Tortuosity", "path / chord", "linear"),
    "radius_to_parent": ("Radius to parent", "radius / radius of the feeding segment", "linear"),
    "branching_angle_deg": ("Branching angle", "angle to the feeding segment (°)", "linear"),
    "angle_between_deg": ("Angle between children", "angle between the two thickest (°)", "linear"),
    "branching_ratio": ("Branching ratio", "thinnest / thickest child", "linear"),
    "area_ratio": ("Area ratio", "children's cross-section / parent's", "linear"),
    "murray_exponent": ("Murray exponent", "exponent fitted to the junction", "linear"),
}
_MOST = 400


def distributions(subject: Subject, folder: Path) -> list[Picture]:
    """Cumulative distributions of every measure: no bins to choose, and trees of any size on one scale."""
    pictures = []
    for name, words in MEASURES.items():
        found = [(side, data) for side, analysis in subject.measured if (data := values(analysis, name)).size]
        if found:
            pictures.append(_cumulative(found, folder, name, *words))
    return pictures


def values(analysis: Analysis, name: str) -> np.ndarray:
    """The values of a measure of segments or junctions that exist and that a generation feeds, ascending."""
    table = analysis.segments if name in analysis.segments else analysis.junctions
    chosen = table.loc[table["generation"] > 0, name].dropna()
    return np.sort(chosen.to_numpy(float))


def _cumulative(
    found: list[tuple[Side, np.ndarray]], folder: Path, name: str, title: str, unit: str, scale: str
) -> Picture:
    low, high = _window([data for _, data in found], scale)

    def draw(axes: Any) -> None:
        for side, data in found:
            share = np.arange(1, data.size + 1) / data.size
            if data.size > _MOST:
                share = np.linspace(1.0 / data.size, 1.0, _MOST)
                data = np.quantile(data, share)
            x, y = np.concatenate(([low], data, [max(high, data[-1])])), np.concatenate(([0.0], share, [1.0]))
            look = {**line(side.series), "marker": None, "drawstyle": "steps-post"}
            axes.plot(x, 100.0 * y, **look)
            at = np.searchsorted(share, (0.25, 0.5, 0.75))
            axes.plot(data[np.minimum(at, data.size - 1)], (25, 50, 75), **{**line(side.series), "linestyle": "none"})
        axes.set(xlabel=unit, ylabel="share of values up to here (%)", xscale=scale, xlim=(low, high), ylim=(-1, 102))
        if scale == "log":
            plain_log(axes.xaxis)

    alt = f"Cumulative distribution of {title.lower()}. " + " ".join(
        f"{side.label}: median {np.median(data):.3g} of {data.size} values." for side, data in found
    )
    file = f"distribution-{name.replace('_', '-').removesuffix('-mm').removesuffix('-deg')}"
    return panel(folder, file, title, alt, draw, legend=handles([side.series for side, _ in found]))


def _window(data: list[np.ndarray], scale: str) -> tuple[float, float]:
    """What is shown: all but the outermost half percent of each side, so that one outlier does not squeeze the rest."""
    low = min(float(np.quantile(each, 0.005)) for each in data)
    high = max(float(np.quantile(each, 0.995)) for each in data)
    if scale == "log":
        low = max(low, 1e-6)
        return low / 1.1, max(high, low * 1.01) * 1.1
    margin = 0.03 * (high - low) or 0.05 * max(abs(high), 1.0)
    return low - margin, high + margin


def effects(comparison: Comparison, trees: list[Side], folder: Path) -> list[Picture]:
    """Cliff's delta of every measure by generation, one panel per tree."""
    table = comparison.distributions
    return [
        _effects(rows, side, k, folder)
        for k, side in enumerate(trees)
        if (rows := table[table["tree"] == k])["effect_size"].notna().any()
    ]


def _effects(rows: pd.DataFrame, side: Side, index: int, folder: Path) -> Picture:
    grid = rows.assign(generation=rows["generation"].fillna(0)).pivot(
        index="measure", columns="generation", values="effect_size"
    )
    grid = grid.reindex([name for name in MEASURES if name in grid.index]).dropna(axis=1, how="all").astype(float)

    def draw(axes: Any) -> None:
        axes.imshow(grid.to_numpy(), cmap="PuOr_r", vmin=-1.0, vmax=1.0, aspect="auto")
        for (i, j), value in np.ndenumerate(grid.to_numpy()):
            if np.isfinite(value):
                ink = "white" if abs(value) > 0.7 else "black"
                axes.text(j, i, effect(value), ha="center", va="center", fontsize=7.5, color=ink)
        axes.set_yticks(range(len(grid)), [MEASURES[name][0] for name in grid.index])
        axes.set_xticks(range(grid.shape[1]), ["all" if g == 0 else f"{int(g)}" for g in grid.columns])
        axes.set_xlabel("generation")
        axes.grid(visible=False)
        axes.tick_params(length=0)

    alt = f"Cliff's delta of each measure by generation, {side.label} against the cast; the table gives the values."
    title = f"Effect size: {plain_text(side.label).strip()}"
    return panel(folder, f"effect-sizes-{index}", title, alt, draw, size_in=(5.4, 3.9))


def location(places: list[Location], trees: list[Side], cast: Side, folder: Path) -> list[Picture]:
    """Shares matched both ways with what chance would match, and mean distances: two panels per tree."""
    pictures = []
    for k, (place, side) in enumerate(zip(places, trees)):
        pictures.append(_matched(place, side, cast, k, folder))
        pictures.append(_distance(place, side, cast, k, folder))
    return pictures


def _way(series: Series, label: str) -> dict[str, Any]:
    return {**line(series), "label": label}


def _matched(place: Location, side: Side, cast: Side, index: int, folder: Path) -> Picture:
    from matplotlib.lines import Line2D

    rows = place.generations
    ways = [
        ("cast_matched_share", _way(cast.series, "cast on tree")),
        ("cast_chance_share", {"color": MUTED, "linestyle": ":", "marker": "x", "label": "cast at random on tree"}),
        ("tree_matched_share", _way(side.series, "tree on cast")),
    ]

    def draw(axes: Any) -> None:
        for column, look in ways:
            axes.plot(rows["generation"], 100.0 * rows[column], **look)
        axes.axhline(100.0 * place.rule.threshold, color=MUTED, linewidth=0.8, zorder=0)
        axes.set(xlabel="generation", ylabel="length matched (%)", ylim=(-3, 103))
        whole_ticks(axes.xaxis)

    alt = (
        f"Share of length matched by generation, cast and {side.label} both ways; the cast is matched down to "
        f"generation {place.matched_down_to_generation}."
    )
    legend = [Line2D([], [], **look) for _, look in ways]
    title = f"Matched: {plain_text(side.label).strip()}"
    return panel(folder, f"location-matched-{index}", title, alt, draw, legend=legend)


def _distance(place: Location, side: Side, cast: Side, index: int, folder: Path) -> Picture:
    from matplotlib.lines import Line2D

    rows = place.generations
    ways = [
        ("cast_distance_mean_mm", _way(cast.series, "cast to tree")),
        ("tree_distance_mean_mm", _way(side.series, "tree to cast")),
    ]

    def draw(axes: Any) -> None:
        for column, look in ways:
            axes.plot(rows["generation"], rows[column], **look)
        axes.axhline(place.rule.tolerance_mm, color=MUTED, linewidth=0.8, zorder=0)
        axes.set(xlabel="generation", ylabel="mean distance (mm)")
        from_zero(axes)
        whole_ticks(axes.xaxis)

    alt = f"Mean distance between the centrelines of like generation, cast and {side.label}, both ways."
    legend = [Line2D([], [], **look) for _, look in ways]
    title = f"Distance: {plain_text(side.label).strip()}"
    return panel(folder, f"location-distance-{index}", title, alt, draw, legend=legend)


def territories(comparison: Comparison, trees: list[Side], folder: Path) -> list[Picture]:
    """Dice overlap by generation, all trees in one panel."""
    found = [(side, item.generations) for side, item in zip(trees, comparison.territories) if item is not None]

    def draw(axes: Any) -> None:
        for side, rows in found:
            axes.plot(rows["generation"], rows["dice"], **line(side.series))
        axes.set(xlabel="generation at which the territories begin", ylabel="Dice overlap", ylim=(0, 1.03))
        whole_ticks(axes.xaxis)

    alt = "Overlap of perfusion territories by generation. " + " ".join(
        f"{side.label}: {rows['dice'].iloc[-1]:.2f} at generation {int(rows['generation'].iloc[-1])}."
        for side, rows in found
    )
    legend = handles([side.series for side, _ in found])
    return [panel(folder, "territories", "Overlap of territories", alt, draw, legend=legend)] if found else []
