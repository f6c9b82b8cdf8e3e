"""The picture in space, and where everything comes from: image, assumptions, provenance, definitions."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vascval.report import view
from vascval.report.definitions import COMPARED, MEASURED
from vascval.report.formats import count, measure, percent, point
from vascval.report.page import Cell, Items, Picture, Scene, Section, Table, Text
from vascval.report.scene import Surface, Tubes, bounds_mm, mask_surface, tubes
from vascval.report.style import BREAK_COLOUR, LOOP_COLOUR, SPUR_COLOUR, Series
from vascval.report.subject import Subject
from vascval.report.viewer import dots, pack

_MOST_POSITIONS = 60


def overlay(subject: Subject, figures: Path) -> Section:
    """The interactive view with all trees, the surface of the cast and what was cut, and a still picture of them."""
    title = "In space"
    layers = [tubes(analysis.tree, side.series) for side, analysis in subject.measured]
    if not layers:
        return Section("overlay", title, [Text("There is no measured tree to show.", "empty")])
    surface = None if subject.skeleton is None else mask_surface(subject.skeleton.mask())
    still, words = _still(figures / "overlay.png", layers, surface)
    marks = _marks(subject, surface, layers)
    data, named = pack([*layers, *marks], surface, hidden=[mark.series.label for mark in marks])
    trees = ", ".join(layer.series.label for layer in layers)
    caption = (
        f"{trees}, in one world frame (mm), as tubes of their radii; vessels thinner than about a pixel are drawn one "
        f"pixel wide. {words}"
    )
    return Section("overlay", title, [Scene(data, named, still, caption, _drawing_notes(layers, surface))])


def _still(path: Path, layers: list[Tubes], surface: Surface | None) -> tuple[Picture, str]:
    if view.can_render():
        seen = view.write_picture(path, layers, surface=surface)
        words = f"The still picture, figures/overlay.png, is {seen}."
    else:
        seen = view.write_flat_picture(path, layers, surface=surface)
        words = (
            "A shaded still picture could not be rendered on this machine; figures/overlay.png is a flat projection, "
            f"{seen}."
        )
    alt = f"Trees and cast as tubes, {seen}"
    return Picture("overlay", alt, _jpeg(path), "image/jpeg"), words


def _jpeg(path: Path) -> bytes:
    """The picture as the page carries it, a fifth of the size."""
    from PIL import Image

    stream = io.BytesIO()
    Image.open(path).convert("RGB").save(stream, format="JPEG", quality=88, optimize=True)
    return stream.getvalue()


def _marks(subject: Subject, surface: Surface | None, layers: list[Tubes]) -> list[Tubes]:
    if subject.skeleton is None:
        return []
    low, high = bounds_mm(surface, layers)
    radius = 0.006 * float(np.linalg.norm(high - low))
    kinds = (
        ("loops cut", LOOP_COLOUR, subject.skeleton.loops_mm),
        ("spurs pruned", SPUR_COLOUR, subject.skeleton.spurs_mm),
        ("breaks joined", BREAK_COLOUR, subject.skeleton.breaks_mm),
    )
    plain = Series("", "mark", "", "o", "-")
    return [
        dots(places, replace(plain, label=f"{words} ({len(places)})", colour=colour), radius_mm=radius)
        for words, colour, places in kinds
        if len(places)
    ]


def _drawing_notes(layers: list[Tubes], surface: Surface | None) -> list[str]:
    notes = [
        f"{layer.series.label}: the {count(layer.n_segments_left_out)} thinnest segments, below a radius of "
        f"{measure(layer.thinnest_drawn_mm)} mm, are left out of the picture, which would be too large with them; all "
        "numbers include them."
        for layer in layers
        if layer.n_segments_left_out
    ]
    if surface is not None:
        notes.append(f"Surface of the cast: {surface.note}.")
    return notes


_IMAGE = (
    ("selection", "selected", str),
    ("voxel_mm", "voxel size x, y, z (mm)", lambda value: " × ".join(measure(size) for size in value)),
    ("n_voxels", "voxels of the vessels", count),
    ("n_components", "components in the mask", count),
    ("largest_component_fraction", "share of the largest", percent),
    ("component_voxels", "largest components (voxels)", lambda value: ", ".join(count(size) for size in value)),
    ("n_voxels_left_out", "voxels left out with the other components", count),
    ("n_breaks_joined", "breaks joined", count),
    ("n_cavities_filled", "cavities filled", count),
    ("n_voxels_filled", "voxels filled", count),
    ("n_loops_cut", "loops cut", count),
    ("n_pinholes_opened", "pinholes in the wall passed over", count),
    ("n_spurs_pruned", "spurs pruned", count),
    ("n_junctions_contracted", "segments contracted into one junction", count),
)


def image(subject: Subject) -> Section:
    """What was done to the image, with the places of what was cut, pruned and joined."""
    found = [(side, analysis.image) for side, analysis in subject.measured if analysis.image is not None]
    if not found:
        return Section("image", "Image", [Text("No tree comes from an image: all were read as trees.", "empty")])
    blocks: list[Any] = []
    for side, record in found:
        entries = [(label, form(record[key])) for key, label, form in _IMAGE if record.get(key) is not None]
        blocks += [Text(f"From the image of {side.label} to its tree:"), Items(entries)]
        blocks += [Text(str(note), "note") for note in record.get("notes", ())]
    if subject.skeleton is not None:
        blocks += [
            _positions("Loops cut", subject.skeleton.loops_mm, "No loop was found."),
            _positions("Spurs pruned", subject.skeleton.spurs_mm, "No spur was found."),
            _positions("Breaks joined", subject.skeleton.breaks_mm, "No break was joined."),
        ]
    return Section("image", "Image", blocks)


def _positions(caption: str, places: np.ndarray, none: str) -> Table | Text:
    if not len(places):
        return Text(none, "empty")
    shown = places[:_MOST_POSITIONS]
    head = [Cell("", "head"), Cell("x (mm)"), Cell("y (mm)"), Cell("z (mm)")]
    body = [
        [Cell(str(k), "head"), *(Cell(point((value,))) for value in place)] for k, place in enumerate(shown, start=1)
    ]
    more = f", the first {len(shown)} of {count(len(places))}" if len(shown) < len(places) else ""
    return Table(f"{caption}, positions in the world frame{more}.", [head], body, "tables/image-positions.csv")


def notes(subject: Subject) -> Section:
    """What was assumed, found or left out: guesses of the readers, notes of the analyses and of the comparison."""
    blocks: list[Any] = []
    for side, analysis in subject.measured:
        said = [f"assumed: {text}" for text in analysis.tree.meta.get("guesses", ())]
        said += [str(text) for text in analysis.tree.meta.get("notes", ())]
        said += analysis.notes
        if said:
            blocks += [Text(f"{side.label}:"), Items(said)]
    if subject.comparison is not None and subject.comparison.notes:
        blocks += [Text("Comparison:"), Items(subject.comparison.notes)]
    return Section("notes", "Notes", blocks or [Text("There is nothing to note.", "empty")])


def provenance(subject: Subject) -> Section:
    """Version, command, configuration, seed and checksums of the inputs; the rules of the analysis."""
    origin = subject.provenance
    entries = origin_entries(origin)
    rules = subject.comparison.parameters if subject.comparison is not None else {}
    if subject.measured:
        rules = {**subject.measured[0][1].parameters, **rules}
    entries += [(f"rule {key}", _value(value)) for key, value in _flat(rules)]
    inputs = origin.get("inputs", ())
    head = [Cell("input", "head"), Cell("bytes"), Cell("SHA-256", "text")]
    body = [[Cell(item["name"], "head"), Cell(count(item["bytes"])), Cell(item["sha256"], "text")] for item in inputs]
    table = Table("Inputs.", [head], body, "report.json") if body else Text("There are no input files.", "empty")
    return Section("provenance", "Provenance", [table, Items(entries)])


def origin_entries(origin: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Program, command, seed and options of a provenance record, as terms and what they are."""
    seed = origin.get("seed")
    return [
        ("program", f"vascval {origin.get('version', '')}"),
        ("command", str(origin.get("command", ""))),
        ("seed", "none: nothing is random" if seed is None else str(seed)),
        *((f"option {key}", _value(value)) for key, value in _flat(origin.get("config", {}))),
    ]


def _flat(values: Mapping[str, Any], before: str = "") -> list[tuple[str, Any]]:
    rows: list[tuple[str, Any]] = []
    for key, value in values.items():
        rows += _flat(value, f"{before}{key}.") if isinstance(value, Mapping) else [(f"{before}{key}", value)]
    return rows


def _value(value: Any) -> str:
    if value is None:
        return "not given"
    if isinstance(value, float):
        return f"{value:.6g}"
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def definitions(subject: Subject) -> Section:
    """Every measure in words."""
    measures = MEASURED if subject.comparison is None else MEASURED + COMPARED
    return Section("definitions", "Definitions", [Items(measures)])
