"""The page: blocks of content and the template that they go into."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Any


@dataclass(frozen=True)
class Cell:
    """A cell of a table: its text, how it looks (``num``, ``text``, ``head``, ``group``, ``delta``) and its columns."""

    text: str
    look: str = "num"
    span: int = 1


@dataclass(frozen=True)
class Table:
    """``head`` and ``body`` rows of cells; ``csv`` names the file with the numbers in full.

    ``small`` tables stand side by side where there is room.
    """

    caption: str
    head: Sequence[Sequence[Cell]]
    body: Sequence[Sequence[Cell]]
    csv: str = ""
    small: bool = False
    kind: str = "table"


@dataclass(frozen=True)
class Picture:
    """A figure of the page: its file name without suffix, what it shows (``alt``) and its bytes."""

    name: str
    alt: str
    data: bytes
    mime: str = "image/svg+xml"

    @property
    def uri(self) -> str:
        return f"data:{self.mime};base64,{base64.b64encode(self.data).decode()}"


def square(colour: str) -> str:
    """A square of one colour, as the address of an image."""
    svg = (
        '<svg xmlns="http://www.w3.org/2000/svg" width="14" height="14">'
        f'<rect width="14" height="14" rx="3" fill="{colour}"/></svg>'
    )
    return Picture("", "", svg.encode()).uri


@dataclass(frozen=True)
class Figure:
    """Pictures side by side under one caption, in up to three columns or up to ``two``."""

    caption: str
    pictures: Sequence[Picture]
    two: bool = False
    kind: str = "figure"

    @property
    def files(self) -> str:
        """The names of its files, in short where they are many."""
        names = [picture.name for picture in self.pictures]
        shown = ", ".join(names) if len(names) <= 4 else f"{names[0].split('-')[0]}-*"
        kinds = "png" if all(picture.mime == "image/png" for picture in self.pictures) else "svg, png"
        return f"figures/{shown} ({kinds})"


@dataclass(frozen=True)
class Text:
    """A paragraph; ``look`` is ``""``, ``note`` (an aside), ``empty`` (what there is not) or ``lead``."""

    text: str
    look: str = ""
    kind: str = "text"


@dataclass(frozen=True)
class Items:
    """A list; entries are texts, or pairs of a term and its explanation. ``look`` as of :class:`Text`."""

    entries: Sequence[Any]
    look: str = ""
    kind: str = "items"


@dataclass(frozen=True)
class Scene:
    """The interactive view: ``data`` for the viewer as JSON text, the layers that can be switched, a still picture."""

    data: str
    layers: Sequence[Any]
    still: Picture | None
    caption: str
    notes: Sequence[str] = ()
    kind: str = "scene"


@dataclass(frozen=True)
class Section:
    """A part of the page with its anchor ``key``."""

    key: str
    title: str
    blocks: Sequence[Any] = field(default_factory=list)


def render(title: str, subtitle: str, sections: Sequence[Section], *, version: str, legend: Sequence[Any]) -> str:
    """The page as text. Everything in it is escaped by the template; nothing is loaded from anywhere."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("vascval.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["swatch"] = square
    style, script = _asset("report.css"), _asset("viewer.js")
    return environment.get_template("report.html").render(
        title=title,
        subtitle=subtitle,
        sections=sections,
        version=version,
        legend=legend,
        style=style,
        script=script,
        has_scene=any(block.kind == "scene" for section in sections for block in section.blocks),
        policy=(
            f"default-src 'none'; img-src data:; style-src 'sha256-{_digest(style)}'; "
            f"script-src 'sha256-{_digest(script)}'; base-uri 'none'; form-action 'none'"
        ),
    )


def script_json(text: str) -> str:
    """JSON that may stand inside a script element: no ``<``, ``>`` or ``&`` as such."""
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _asset(name: str) -> str:
    return files("vascval.report").joinpath("templates", name).read_text(encoding="utf-8")


def _digest(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
