"""Drawing with matplotlib: one panel per file, alike in size, type and colours, the same bytes for the same data."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from vascval.io.atomic import atomic_file
from vascval.report.page import Picture
from vascval.report.style import Series, rc

SIZE_IN = (4.0, 3.0)
_LONGEST = 30


def panel(
    folder: Path,
    name: str,
    title: str,
    alt: str,
    draw: Callable[[Any], None],
    *,
    legend: Sequence[Any] = (),
    size_in: tuple[float, float] = SIZE_IN,
) -> Picture:
    """Draw one axes by ``draw`` and write ``name``.svg and ``name``.png into ``folder``; the picture for the page.

    ``legend``: handles shown below the axes.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(rc()), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=r"Glyph .* missing")
        figure = Figure(figsize=size_in, layout="constrained")
        axes = figure.add_subplot()
        axes.set_title(title)
        draw(axes)
        if legend:
            widest = max(len(handle.get_label()) for handle in legend)
            columns = max(1, min(len(legend), int(62 / (widest + 8))))
            figure.legend(handles=list(legend), loc="outside lower left", ncols=columns)
        svg = io.BytesIO()
        figure.savefig(svg, format="svg", metadata={"Date": None, "Creator": None})
        figure.set_layout_engine("none")  # both files are laid out alike, once
        with atomic_file(folder / f"{name}.png") as aside:
            figure.savefig(aside, format="png", dpi=200, metadata={"Software": None})
    with atomic_file(folder / f"{name}.svg") as aside:
        aside.write_bytes(svg.getvalue())
    return Picture(name, alt, svg.getvalue())


def plain_text(text: str) -> str:
    """A name as it may stand in a figure: printable, not too long, and never taken for a hidden label."""
    text = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)
    if len(text) > _LONGEST:
        text = text[: _LONGEST - 9] + "\N{HORIZONTAL ELLIPSIS}" + text[-8:]
    return f" {text}" if text.startswith("_") else text


def handles(series: Sequence[Series]) -> list[Any]:
    """Legend entries of lines with markers."""
    from matplotlib.lines import Line2D

    return [Line2D([], [], **line(one)) for one in series]


def line(one: Series) -> dict[str, Any]:
    """The look of a line of that series, its label fit for a figure."""
    return {**one.line, "label": plain_text(one.label)}


def whole_ticks(axis: Any) -> None:
    """Ticks at whole numbers alone."""
    from matplotlib.ticker import MaxNLocator

    axis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))


def from_zero(axes: Any) -> None:
    """The y axis from zero on, with room for the markers that lie on it, where all values are above."""
    axes.set_ylim(bottom=-0.03 * axes.get_ylim()[1])


def plain_log(axis: Any) -> None:
    """Logarithmic ticks as plain numbers, at 1, 2 and 5 where there are few decades."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axis.get_view_interval()
    few = high / low < 60
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,), numticks=12))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.6g}".replace(",", " ")))
    axis.set_minor_formatter(NullFormatter())
