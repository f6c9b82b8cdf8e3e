"""How a search for topologies went: the table of its steps, and a figure of volume, acceptance and temperature."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from vascval.core.errors import InputError
from vascval.io.atomic import atomic_file
from vascval.io.rows import SearchStepRow
from vascval.io.tables import write_table
from vascval.report.page import Picture
from vascval.report.plots import panel
from vascval.report.style import INK, rc

_METADATA: dict[str, dict[str, None]] = {
    ".svg": {"Date": None, "Creator": None},
    ".png": {"Software": None},
    ".pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}
SUFFIXES = (".csv", *_METADATA)
_DRAWN = 300
"""Points of a curve; a longer history is drawn as means over as many groups of steps."""
_TITLES = ("Volume", "Acceptance")
_LOOKS: dict[str, dict[str, Any]] = {
    "volume": {"label": "volume", "color": "#8d99a6", "linestyle": "-", "linewidth": 1.0},
    "best": {"label": "best so far", "color": INK, "linestyle": "-", "linewidth": 1.8},
    "accepted": {"label": "accepted (left)", "color": "#5b8fb9", "linestyle": "-", "linewidth": 1.2},
    "temperature": {"label": "temperature (right)", "color": "#7a1712", "linestyle": (0, (5, 1.6)), "linewidth": 1.8},
}


def history_table(steps: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """The table of a search from what its steps hold, with the columns of :class:`vascval.io.rows.SearchStepRow`."""
    return pd.DataFrame(list(steps), columns=list(SearchStepRow.model_fields))


def write_search_history(history: pd.DataFrame, path: Path) -> None:
    """The table, or a figure of it, as the suffix has it: .csv, .svg, .png or .pdf; atomic.

    :raises InputError: for another suffix, a history without steps, or a place that cannot be written.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: a history is written as {', '.join(SUFFIXES)}; choose one of these")
    if history.empty:
        raise InputError(f"{path}: the search made no step, so there is no history; leave it out")
    if suffix == ".csv":
        write_table(history, path)
        return
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(rc()):
        figure = Figure(figsize=(8.4, 3.4), layout="constrained")
        panels = zip(figure.subplots(1, 2), _TITLES, (_volumes(history), _acceptance(history)), _legends(), strict=True)
        for axes, title, draw, legend in panels:
            axes.set_title(title)
            draw(axes)
            axes.legend(handles=legend, loc="upper left", bbox_to_anchor=(0.0, -0.17), ncols=2, borderaxespad=0.0)
        with atomic_file(path) as aside:
            figure.savefig(aside, format=suffix[1:], dpi=200, metadata=_METADATA[suffix])


def search_pictures(history: pd.DataFrame, folder: Path) -> list[Picture]:
    """The two panels of the figure as pictures for a page."""
    first, last = history.iloc[0], history.iloc[-1]
    share = 100.0 * _accepted(history)
    alts = (
        f"Volume against topologies tested: best {first['best_mm3']:.4g} mm^3 after {first['n_tests']:,.0f} tests, "
        f"{last['best_mm3']:.4g} mm^3 after {last['n_tests']:,.0f}.",
        f"Share of tests accepted, from {share.iloc[0]:.3g} % to {share.iloc[-1]:.3g} %, and temperature, from "
        f"{first['temperature']:.3g} to {last['temperature']:.3g}, against topologies tested.",
    )
    draws = (_volumes(history), _acceptance(history))
    return [
        panel(folder, f"search-{title.lower()}", title, alt, draw, legend=legend)
        for title, alt, draw, legend in zip(_TITLES, alts, draws, _legends(), strict=True)
    ]


def _accepted(history: pd.DataFrame) -> pd.Series:
    """Share of the tests of each step that were accepted."""
    return history["n_accepted"] / history["n_tests"].diff().fillna(history["n_tests"])


def thinned(history: pd.DataFrame) -> pd.DataFrame:
    """At most 300 steps: neighbours as one, with their mean volume and temperature."""
    every = -(-len(history) // _DRAWN)
    groups = history.reset_index(drop=True).groupby(lambda row: row // every)
    return groups.agg(
        {"n_tests": "last", "n_accepted": "sum", "temperature": "mean", "volume_mm3": "mean", "best_mm3": "last"}
    )


def _volumes(history: pd.DataFrame) -> Callable[[Any], None]:
    steps = thinned(history)

    def draw(axes: Any) -> None:
        axes.plot(steps["n_tests"], steps["volume_mm3"], **_LOOKS["volume"])
        axes.plot(steps["n_tests"], steps["best_mm3"], **_LOOKS["best"])
        axes.set(xlabel="topologies tested", ylabel="volume (mm³)")
        axes.ticklabel_format(axis="y", style="plain", useOffset=False)
        _tests(axes)

    return draw


def _acceptance(history: pd.DataFrame) -> Callable[[Any], None]:
    steps = thinned(history)

    def draw(axes: Any) -> None:
        axes.plot(steps["n_tests"], 100.0 * _accepted(steps), **_LOOKS["accepted"])
        axes.set(xlabel="topologies tested", ylabel="tests accepted (%)")
        axes.set_ylim(bottom=0.0)
        _tests(axes)
        right = axes.twinx()
        right.plot(steps["n_tests"], steps["temperature"], **_LOOKS["temperature"])
        right.set(ylabel="temperature (of ln volume)", yscale="log")
        right.spines["right"].set_visible(True)
        right.grid(False)
        _powers(right.yaxis)

    return draw


def _legends() -> tuple[list[Any], list[Any]]:
    from matplotlib.lines import Line2D

    def entries(*names: str) -> list[Any]:
        return [Line2D([], [], **_LOOKS[name]) for name in names]

    return entries("volume", "best"), entries("accepted", "temperature")


def _powers(axis: Any) -> None:
    """Logarithmic ticks at 1, 2 and 5 times powers of ten, which are written out."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=12))
    axis.set_major_formatter(FuncFormatter(lambda value, _: _scientific(value)))
    axis.set_minor_locator(NullLocator())
    axis.set_minor_formatter(NullFormatter())


def _scientific(value: float) -> str:
    digits, exponent = f"{value:.0e}".split("e")
    return f"{digits}·10{str(int(exponent)).translate(_SUPERSCRIPT)}"


_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def _tests(axes: Any) -> None:
    """Few ticks with thousands set apart, from zero on."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    axes.set_xlim(left=0.0)
    axes.xaxis.set_major_locator(MaxNLocator(4, integer=True))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}".replace(",", " ")))
