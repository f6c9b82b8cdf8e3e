"""The sections that hold a cast against trees: distributions, location, territories."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd

from vascval.comparison import Comparison, Location, Territories
from vascval.report import comparison_panels as panels
from vascval.report.formats import count, effect, measure, p_value, percent
from vascval.report.page import Cell, Figure, Section, Table, Text
from vascval.report.subject import Side, Subject
from vascval.report.tree_sections import two_rows

_PUBLISHED = "The cast is a published table, which has no {}."


def distributions(subject: Subject, comparison: Comparison, figures: Path) -> Section:
    key, title = "distributions", "Distributions"
    if comparison.distributions.empty:
        return Section(key, title, [Text(_PUBLISHED.format("single vessels to compare"), "empty")])
    asked = comparison.parameters["minimum_for_test"]
    cumulative = (
        "Cumulative distributions over all segments or junctions; markers at the quartiles. The outermost half percent "
        "may lie outside the frame."
    )
    deltas = (
        "Cliff's delta: the probability that a value of the tree exceeds one of the cast, minus the converse. Orange: "
        f"the tree's values are the larger; violet: the cast's. Left out with fewer than {asked} values on a side."
    )
    pictures = panels.effects(comparison, subject.trees, figures)
    return Section(
        key,
        title,
        [
            Figure(cumulative, panels.distributions(subject, figures)),
            Figure(deltas, pictures) if pictures else Text("There are too few values for effect sizes.", "empty"),
            *(_distribution_table(comparison.distributions, k, side) for k, side in enumerate(subject.trees)),
            Text(
                "The Wasserstein distance is in the unit of the measure and, beside it, in standard deviations of "
                "the cast; p is that of the two-sided Mann-Whitney U test and is tiny for thousands of vessels "
                "however small the difference: read the effect size.",
                "note",
            ),
        ],
    )


def _distribution_table(frame: pd.DataFrame, index: int, side: Side) -> Table:
    rows = frame[(frame["tree"] == index) & frame["generation"].isna()].set_index("measure")
    columns = {
        "values": ("cast", side.short),
        "median": ("cast", side.short),
        "Wasserstein": ("distance", "in SD"),
        "Mann-Whitney": ("effect size", "p"),
    }
    head = two_rows("measure", [(label, [Cell(name) for name in names]) for label, names in columns.items()])
    body = []
    for name, (words, unit, _) in panels.MEASURES.items():
        if name in rows.index:
            row = rows.loc[name]
            label = f"{words} ({unit[unit.index('(') + 1 : -1]})" if unit.endswith(")") else words
            body.append(
                [
                    Cell(label, "head"),
                    *(Cell(count(row[key])) for key in ("n_cast", "n_tree")),
                    *(Cell(measure(row[key])) for key in ("median_cast", "median_tree", "wasserstein")),
                    Cell(measure(row["wasserstein_relative"])),
                    Cell(effect(row["effect_size"])),
                    Cell(p_value(row["p_value"])),
                ]
            )
    caption = f"{side.label} against the cast, all generations together."
    return Table(caption, head, body, "tables/distributions.csv")


def location(subject: Subject, comparison: Comparison, figures: Path) -> Section:
    key, title = "location", "Location"
    if not comparison.location:
        return Section(key, title, [Text(_PUBLISHED.format("places"), "empty")])
    rule = comparison.location[0].rule
    words = (
        f"A point of a centreline is matched when the other tree's centreline of like generation (within "
        f"{rule.generation_window}) lies within {measure(rule.tolerance_mm)} mm, or within the local radius where that "
        f"is more. Points are at most {measure(rule.step_mm, 2)} mm apart. A generation counts as matched from "
        f"{percent(rule.threshold)} of its length on (line in the figure). The share matched by chance is what a cast "
        "laid at random into the same tissue would show: only what exceeds it says anything."
    )
    blocks: list[Any] = [Text(words)]
    blocks += [Text(note) for note in comparison.notes if any(side.source in note for side in subject.trees)]
    blocks += [Text(_depth(place, side)) for place, side in zip(comparison.location, subject.trees)]
    caption = "Length matched, and mean distance of the centrelines of like generation with the tolerance as a line."
    pictures = panels.location(comparison.location, subject.trees, subject.first, figures)
    blocks.append(Figure(caption, pictures, two=True))
    for place, side in zip(comparison.location, subject.trees):
        blocks += [_location_table(place, side, "cast"), _location_table(place, side, "tree")]
    return Section(key, title, blocks)


def _depth(place: Location, side: Side) -> str:
    last = place.matched_down_to_generation
    if last == 0:
        return f"{side.label}: the first generation of the cast is not matched."
    return f"{side.label}: the cast is matched down to generation {last}."


def _location_table(place: Location, side: Side, way: str) -> Table:
    columns: list[tuple[str, str, Callable[[Any], str]]] = [
        (f"{way}_length_mm", "length (mm)", measure),
        (f"{way}_matched_share", "matched", percent),
        *([("cast_chance_share", "matched by chance", percent)] if way == "cast" else []),
        (f"{way}_matched_any_share", "on any generation", percent),
        (f"{way}_distance_mean_mm", "mean distance (mm)", measure),
        (f"{way}_distance_max_mm", "largest (mm)", measure),
        (f"{way}_distance_any_mean_mm", "mean to any (mm)", measure),
    ]
    body = [
        [Cell(str(int(row["generation"])), "head"), *(Cell(form(row[key])) for key, _, form in columns)]
        for row in place.generations.to_dict("records")
        if row[f"{way}_length_mm"] > 0
    ]
    head = [Cell("generation", "head"), *(Cell(name) for _, name, _ in columns)]
    direction = f"The cast on {side.label}" if way == "cast" else f"{side.label} on the cast"
    caption = f"{direction}: length matched, and distance to the nearest centreline of like generation."
    return Table(caption, [head], body, "tables/location.csv")


def territories(subject: Subject, comparison: Comparison, figures: Path) -> Section:
    key, title = "territories", "Territories"
    pairs = list(zip(comparison.territories, subject.trees))
    if not pairs:
        return Section(key, title, [Text(_PUBLISHED.format("territories"), "empty")])
    blocks: list[Any] = [
        Text(
            "Tissue in the part that the convex hulls of both trees' terminals have in common belongs to the nearest "
            "terminal, and so to the subtree of each first generation that feeds it. Subtrees are paired so that they "
            "overlap the most; Dice is twice that overlap over both. Generation 1 agrees by construction where each "
            "tree has one stem."
        )
    ]
    pictures = panels.territories(comparison, subject.trees, figures)
    if pictures:
        blocks.append(Figure("Overlap of the territories of cast and tree.", pictures))
    for item, side in pairs:
        blocks.append(
            Text(f"{side.label}: its terminals and those of the cast enclose no common volume.", "empty")
            if item is None
            else _territory_table(item, side)
        )
    return Section(key, title, blocks)


def _territory_table(item: Territories, side: Side) -> Table:
    names = ("generation", "territories, cast", "territories, tree", "pairs", "Dice", "mean Dice of the pairs")
    body = [
        [
            Cell(str(int(row["generation"])), "head"),
            *(Cell(count(row[key])) for key in ("n_cast", "n_tree", "n_matched")),
            *(Cell(measure(row[key])) for key in ("dice", "dice_mean")),
        ]
        for row in item.generations.to_dict("records")
    ]
    head = [Cell(names[0], "head"), *(Cell(name) for name in names[1:])]
    caption = f"{side.label}: overlap of territories, on {count(item.n_points)} points of tissue."
    return Table(caption, [head], body, "tables/territories.csv")
