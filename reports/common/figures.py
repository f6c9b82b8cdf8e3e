"""Figures of the studies: each as SVG and PNG, alike in type and colours, readable in grey."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from vascval.report.style import rc

RED, GREEN, PURPLE = "#c4302b", "#4fae6b", "#4a1f6b"
"""The paper's colours of overlaid trees, of three different lightnesses. Red: before (growth alone), green: after."""
INK, PALE = "#1d2126", "#d7dbdf"
LOOKS = {
    "cco": {"color": RED, "marker": "s", "linestyle": (0, (5, 1.6))},
    "optimised": {"color": GREEN, "marker": "^", "linestyle": (0, (1.2, 1.2))},
    "third": {"color": PURPLE, "marker": "D", "linestyle": (0, (6, 1.5, 1.2, 1.5))},
    "cast": {"color": INK, "marker": "o", "linestyle": "-"},
}
_PNG_DPI, _PNG_COLOURS = 160, 256


def style() -> Any:
    """A context in which figures are drawn: the look of the reports of ``vascval``."""
    from matplotlib import rc_context

    return rc_context(rc())


def panels(n_columns: int, n_rows: int = 1, *, width_in: float = 4.0, height_in: float = 3.0) -> tuple[Any, list[Any]]:
    """A figure and its axes, row by row."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in * n_columns, height_in * n_rows), layout="constrained")
    return figure, [figure.add_subplot(n_rows, n_columns, k + 1) for k in range(n_columns * n_rows)]


def save(figure: Any, folder: Path, name: str = "figure") -> None:
    """``name``.svg and ``name``.png in the folder; the same bytes for the same figure."""
    from PIL import Image

    svg, png = io.BytesIO(), io.BytesIO()
    figure.savefig(svg, format="svg", dpi=_PNG_DPI, metadata={"Date": None, "Creator": None})
    figure.savefig(png, format="png", dpi=_PNG_DPI, metadata={"Software": None})
    text = re.sub(r"(?<=data:image/png;base64,)[^\"]+", _smaller, svg.getvalue().decode())
    (folder / f"{name}.svg").write_text(re.sub(r"[ \t]+$", "", text, flags=re.M), encoding="utf-8")
    with Image.open(png) as picture:
        picture.convert("RGB").quantize(_PNG_COLOURS).save(folder / f"{name}.png", optimize=True)


def _smaller(match: re.Match[str]) -> str:
    """A picture within an SVG in fewer colours: a fifth of the bytes."""
    from PIL import Image

    small = io.BytesIO()
    with Image.open(io.BytesIO(base64.b64decode(match[0]))) as picture:
        white = Image.new("RGBA", picture.size, "white")
        white.alpha_composite(picture.convert("RGBA"))
        white.convert("RGB").quantize(_PNG_COLOURS).save(small, format="png", optimize=True)
    return base64.b64encode(small.getvalue()).decode()


def plain_counts(axis: Any) -> None:
    """A symmetric logarithmic axis of counts, its ticks 0 and the powers of ten as plain numbers."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    axis.set_major_locator(FixedLocator([0.0, *(10.0**k for k in range(7))]))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
    axis.set_minor_locator(NullLocator())


def counted(axis: Any, values: Sequence[float]) -> None:
    """A logarithmic axis whose ticks are the values themselves."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    axis.set_major_locator(FixedLocator(list(values)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
    axis.set_minor_locator(NullLocator())
