"""The short tables that commands print: made from the JSON documents, so that both always say the same."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from vascval.cli.console import table

_TOTALS = {
    "n_terminals": "terminals",
    "n_segments": "segments",
    "n_bifurcations": "bifurcations",
    "n_trifurcations": "trifurcations",
    "n_trifurcations_first_7": "  in the first 7 generations",
    "n_monopodial": "monopodial branches",
    "n_overlaps": "overlapping pairs",
    "max_order": "Strahler order of the root",
    "total_length_mm": "total length (mm)",
    "volume_mm3": "volume (mm^3)",
}

_GENERATIONS = {
    "generation": "generation",
    "n_segments": "segments",
    "n_elements": "elements",
    "radius_mean_mm": "radius (mm)",
    "radius_sd_mm": "sd",
    "length_mean_mm": "length (mm)",
    "length_sd_mm": "sd",
    "branching_ratio_mean": "branching ratio",
}

_IMAGE = {
    "selection": "selected",
    "n_components": "components in the mask",
    "largest_component_fraction": "share of the largest",
    "n_cavities_filled": "cavities filled",
    "n_breaks_joined": "breaks joined",
    "n_loops_cut": "loops cut",
    "n_spurs_pruned": "spurs pruned",
}


def totals_table(documents: Mapping[str, Mapping[str, Any]]) -> str:
    """The totals of one or more trees side by side, by what each is called."""
    rows: list[list[object]] = [["", *documents]]
    for key, label in _TOTALS.items():
        rows.append([label, *(_number(document["summary"][key]) for document in documents.values())])
    return table(rows)


def generations_table(document: Mapping[str, Any]) -> str:
    """The statistics of one tree by generation."""
    rows = [list(_GENERATIONS.values())]
    rows += [[_number(row[key]) for key in _GENERATIONS] for row in document["generations"]]
    return table(rows)


def image_table(image: Mapping[str, Any]) -> str:
    """What skeletonization did to the image."""
    width = max(map(len, _IMAGE.values()))
    return "\n".join(f"{label:<{width}}  {_number(image[key])}" for key, label in _IMAGE.items() if key in image)


def comparison_tables(document: Mapping[str, Any]) -> str:
    """Cast and trees side by side: totals, numbers and radii by generation, and how far down places agree."""
    sides = [document["cast"], *document["trees"]]
    names = [side["source"] for side in sides]
    measured = {name: side for name, side in zip(names, sides) if "summary" in side}
    lines = [_matched(names[0], place) for place in document["location"]]
    return "\n\n".join([totals_table(measured), _by_generation(names, sides), *(["\n".join(lines)] if lines else [])])


def _matched(cast: str, place: Mapping[str, Any]) -> str:
    down_to = place["matched_down_to_generation"]
    depth = f"{cast} is matched down to generation {down_to}" if down_to else f"no generation of {cast} is matched"
    return f"{place['tree']}: {depth} (within {_number(place['tolerance_mm'])} mm or the local radius)"


def _by_generation(names: Sequence[str], sides: Sequence[Mapping[str, Any]]) -> str:
    found = [{row["generation"]: row for row in side["generations"]} for side in sides]
    rows: list[list[object]] = [["generation"], [""]]
    for name in names:
        rows[0] += ["", name]
        rows[1] += ["segments", "radius (mm)"]
    for generation in sorted(set().union(*found)):
        row: list[object] = [generation]
        for side in found:
            entry = side.get(generation, {})
            row += [_number(entry.get("n_segments")), _number(entry.get("radius_mean_mm"))]
        rows.append(row)
    return table(rows)


def _number(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, str):
        return value
    return f"{value:.4g}" if isinstance(value, float) and abs(value) < 1e4 else f"{value:.0f}"
