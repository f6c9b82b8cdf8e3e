"""Small pictures of a line with its marker, for legends in the page."""

from __future__ import annotations

from dataclasses import dataclass

from vascval.report.page import Picture
from vascval.report.style import Series

_SHAPES = {
    "o": '<circle cx="22" cy="8" r="4.5"/>',
    "s": '<rect x="18" y="4" width="8" height="8"/>',
    "^": '<path d="M22 2.5 27 12H17z"/>',
    "v": '<path d="M22 13.5 27 4H17z"/>',
    "<": '<path d="M16.5 8 26 3v10z"/>',
    "D": '<path d="M22 2 28 8 22 14 16 8z"/>',
    "P": '<path d="M20 3h4v3h3v4h-3v3h-4v-3h-3V6h3z"/>',
    "X": '<path d="M18 3l4 3.5L26 3l1.5 2L24 8l3.5 3L26 13l-4-3.5L18 13l-1.5-2L20 8l-3.5-3z"/>',
}


@dataclass(frozen=True)
class Swatch:
    """An entry of the legend: a picture, the name and what it is."""

    picture: Picture
    label: str
    role: str


def swatch(series: Series, role: str) -> Swatch:
    """The line of a series as in the figures."""
    dash = ""
    if not isinstance(series.dash, str):
        dash = f' stroke-dasharray="{",".join(f"{2 * part:g}" for part in series.dash[1])}"'
    fill = series.colour if series.role == "cast" else "#fff"
    svg = (
        '<svg xmlns="http://www.w3.org/2000/svg" width="44" height="16">'
        f'<path d="M1 8H43" stroke="{series.colour}" stroke-width="2" fill="none"{dash}/>'
        f'<g fill="{fill}" stroke="{series.colour}" stroke-width="1.5">{_SHAPES[series.marker]}</g></svg>'
    )
    return Swatch(Picture("", "", svg.encode()), series.label, role)
