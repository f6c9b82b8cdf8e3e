"""What the report of a twin says beyond the comparison: the set-up, how the trees fill it, and how far they scale."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vascval.report import view
from vascval.report.formats import THIN, count, measure, percent, point
from vascval.report.page import Cell, Figure, Items, Picture, Section, Table, Text
from vascval.report.plots import from_zero, handles, line, panel, whole_ticks
from vascval.report.scene import Surface, Tubes, bounds_mm, tubes, viewpoint
from vascval.report.search_history import search_pictures

if TYPE_CHECKING:
    import pandas as pd

    from vascval.report.subject import Subject


@dataclass(frozen=True, eq=False)
class Twin:
    """``facts``: :class:`vascval.io.twins.Twin` as plain values; ``surface`` of the perfusion volume; ``history`` of
    the search for topologies (:class:`vascval.io.rows.SearchStepRow`), without rows where there was none."""

    facts: Mapping[str, Any]
    surface: Surface | None
    history: pd.DataFrame


def twin(subject: Subject, given: Twin, figures: Path) -> Section:
    """The section: what the trees were grown from, each in the perfusion volume, how they fill it, and notes."""
    facts = given.facts
    blocks: list[Any] = [
        Text(
            "The grown trees have the cast's perfusion volume, root and number of terminals, and nothing else of it: "
            "where their vessels run is found by least volume of blood at the given flow and pressures."
        ),
        Figure(
            f"Cast and grown trees in the perfusion volume, {_words(given, subject)}.",
            _pictures(subject, given, figures),
            two=True,
        ),
        Items(_setup(facts)),
        _filling(subject),
        _size(subject, facts),
        *([] if facts["root"]["n_segments_given"] else [Text(_scaling(facts))]),
        Figure(
            "Mean radius by generation, over the radius of the root: what remains when the scale is taken out.",
            [_relative_radii(subject, facts, figures)],
        ),
        *([] if given.history.empty else [_search(given.history, figures)]),
        *([Items(list(facts["notes"]))] if facts["notes"] else []),
    ]
    return Section("twin", "Twin", blocks)


def _search(history: pd.DataFrame, figures: Path) -> Figure:
    caption = (
        "How topologies were searched by annealing, in the first chain: volume of the present and of the best tree; "
        "tests accepted and temperature. In full: tables/search-history.csv."
    )
    return Figure(caption, search_pictures(history, figures), two=True)


def _layers(subject: Subject) -> list[Tubes]:
    return [tubes(analysis.tree, side.series) for side, analysis in subject.measured]


def _words(given: Twin, subject: Subject) -> str:
    return viewpoint(*bounds_mm(given.surface, _layers(subject))).words


def _pictures(subject: Subject, given: Twin, figures: Path) -> list[Picture]:
    layers = _layers(subject)
    seen = viewpoint(*bounds_mm(given.surface, layers))
    draw = view.write_picture if view.can_render() else view.write_flat_picture
    pictures = []
    for k, (layer, (side, _)) in enumerate(zip(layers, subject.measured, strict=True)):
        path = figures / f"twin-{k}.png"
        draw(path, [layer], surface=given.surface, seen=seen, text=1.8)
        alt = f"{side.label} as tubes in the perfusion volume, {seen.words}"
        pictures.append(Picture(path.stem, alt, path.read_bytes(), "image/png"))
    return pictures


def _setup(facts: Mapping[str, Any]) -> list[tuple[str, str]]:
    domain, root, cast, flow = (facts[name] for name in ("domain", "root", "cast", "perfusion"))
    entries = [
        ("perfusion volume", f"{measure(domain['volume_mm3'] / 1000.0)}{THIN}ml, {_made(domain)}"),
        (
            "of the cast inside it",
            f"{percent(cast['length_inside_share'])} of the length, {percent(cast['volume_inside_share'])} of the "
            f"volume, {percent(cast['terminals_inside_share'])} of the terminals",
        ),
        ("root", f"{point(root['position_mm'])} mm; radius of the cast there {measure(root['radius_mm'])}{THIN}mm"),
    ]
    if cast["n_terminals_left_out"]:
        entries.append(
            (
                "left out of the cast",
                f"{count(cast['n_terminals_left_out'])} of {count(cast['n_terminals_given'])} terminals, on vessels "
                "before it enters the perfusion volume",
            )
        )
    if root["n_segments_given"]:
        entries.append(
            (
                "given of the cast",
                f"its first {root['generations_given']} generations, {count(root['n_segments_given'])} segments, with "
                "their radii",
            )
        )
    return [
        *entries,
        (
            "flow and pressures",
            f"{measure(flow['flow_ml_min'])}{THIN}ml/min through the root, {measure(flow['root_pressure_mmhg'])} mmHg "
            f"there and {measure(flow['terminal_pressure_mmhg'])} mmHg at every terminal (preset {flow['preset']})",
        ),
        ("blood", f"viscosity {measure(flow['viscosity_cp'])}{THIN}cP, branching exponent {measure(flow['gamma'])}"),
    ]


def _made(domain: Mapping[str, Any]) -> str:
    if domain["kind"] == "hull":
        return (
            f"a hull of the cast: its closing by balls of {measure(domain['closing_mm'])}{THIN}mm radius, and "
            f"{measure(domain['margin_mm'])}{THIN}mm around that"
        )
    gaps = f", gaps narrower than {measure(2 * domain['closing_mm'])}{THIN}mm closed" if domain["closing_mm"] else ""
    return f"{domain['source']}, a {domain['kind']}{gaps}"


def _heads(subject: Subject) -> list[Cell]:
    names = (side.label if side in subject.trees else side.short for side, _ in subject.measured)
    return [Cell("", "head"), *(Cell(name) for name in names)]


def _size(subject: Subject, facts: Mapping[str, Any]) -> Table:
    trees = facts["trees"]
    root = facts["root"]["radius_mm"]
    rows = [
        ["terminals", *(count(analysis.summary["n_terminals"]) for _, analysis in subject.measured)],
        ["root radius (mm)", measure(root), *(measure(tree["root_radius_mm"]) for tree in trees)],
        ["that over the cast's", "1", *(measure(tree["root_radius_to_cast"]) for tree in trees)],
        ["volume (ml)", *(measure(analysis.summary["volume_mm3"] / 1000.0) for _, analysis in subject.measured)],
        [
            "share of the perfusion volume",
            *(
                percent(analysis.summary["volume_mm3"] / facts["domain"]["volume_mm3"])
                for _, analysis in subject.measured
            ),
        ],
    ]
    body = [[Cell(row[0], "head"), *(Cell(text) for text in row[1:])] for row in rows]
    return Table("Size of the trees.", [_heads(subject)], body, "report.json")


def _filling(subject: Subject) -> Table:
    measures = (
        ("distance_mean_mm", "mean distance (mm)"),
        ("distance_median_mm", "median (mm)"),
        ("distance_q95_mm", "95 % quantile (mm)"),
        ("distance_max_mm", "farthest (mm)"),
        ("evenness", "mean over that of as many random terminals"),
    )
    body = [
        [Cell(label, "head"), *(Cell(measure((analysis.coverage or {}).get(key))) for _, analysis in subject.measured)]
        for key, label in measures
    ]
    caption = "How the terminals fill the perfusion volume: distance of its points to the nearest."
    return Table(caption, [_heads(subject)], body, "report.json")


def _scaling(facts: Mapping[str, Any]) -> str:
    flow = facts["perfusion"]
    end, drop = flow["root_pressure_mmhg"], flow["root_pressure_mmhg"] - flow["terminal_pressure_mmhg"]
    said = " and ".join(
        f"{measure(end - tree['pressure_drop_at_cast_root_mmhg'], 4)} mmHg for {tree['source']}"
        for tree in facts["trees"]
    )
    return (
        "Scale: in the model the radii of a tree go, all alike, with the fourth root of flow over pressure drop. A "
        "cast ends where its image or resin does, far from where blood has spent its pressure; grown trees of as many "
        f"terminals, with as many generations, spend all {measure(drop)} mmHg on these, and are thinner or thicker for "
        "it. Their roots would be as thick as the cast's if the pressure at the terminals was "
        f"{said} (perfusion.terminal_pressure_mmhg)."
    )


def _relative_radii(subject: Subject, facts: Mapping[str, Any], figures: Path) -> Picture:
    roots = [facts["root"]["radius_mm"], *(tree["root_radius_mm"] for tree in facts["trees"])]
    rows = [
        (side, side.generations["generation"], side.generations["radius_mean_mm"] / root)
        for (side, _), root in zip(subject.measured, roots, strict=True)
    ]

    def draw(axes: Any) -> None:
        for side, generation, ratio in rows:
            axes.plot(generation, ratio, **line(side.series))
        axes.set(xlabel="generation (root 1)", ylabel="mean radius / radius of the root")
        whole_ticks(axes.xaxis)
        from_zero(axes)

    alt = "Mean radius over the root's by generation. " + " ".join(
        f"{side.label}: {', '.join(f'{value:.2f}' for value in ratio)}." for side, _, ratio in rows
    )
    legend = handles([side.series for side, _, _ in rows])
    return panel(figures, "twin-relative-radius", "Relative radius", alt, draw, legend=legend)
