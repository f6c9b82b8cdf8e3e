"""Where the vessels lie: distances between the centrelines of cast and tree, generation by generation, both ways."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from vascval.core.tree import Tree
from vascval.morphometry.hull import convex_hull, grid_inside
from vascval.morphometry.pieces import pieces
from vascval.morphometry.preparation import polylines

CHANCE_POINTS = 5_000


@dataclass(frozen=True)
class LocationRule:
    """When a point of a centreline counts as matched.

    * ``step_mm``: points are compared at most this far apart along each segment;
    * ``tolerance_mm``: matched within this distance of the other tree's centreline, or within the radius of the
      segment that the point lies on where that is more;
    * ``generation_window``: segments are of like generation when theirs differ by at most this;
    * ``threshold``: a generation counts as matched from this share of its length on.
    """

    step_mm: float
    tolerance_mm: float
    generation_window: int
    threshold: float


@dataclass(frozen=True, eq=False)
class Location:
    """``generations``: :class:`vascval.io.rows.LocationRow`; ``cast_segments`` and ``tree_segments``:
    :class:`vascval.io.rows.SegmentLocationRow`; ``matched_down_to_generation``: the last generation up to which every
    one of the cast reaches the threshold, 0 where the first does not."""

    rule: LocationRule
    generations: pd.DataFrame
    cast_segments: pd.DataFrame
    tree_segments: pd.DataFrame
    matched_down_to_generation: int

    def document(self, tree: str) -> dict[str, Any]:
        return {
            "tree": tree,
            "tolerance_mm": self.rule.tolerance_mm,
            "step_mm": self.rule.step_mm,
            "generation_window": self.rule.generation_window,
            "matched_threshold": self.rule.threshold,
            "matched_down_to_generation": self.matched_down_to_generation,
            "generations": self.generations,
        }


@dataclass(frozen=True, eq=False)
class Samples:
    """Points along the centrelines (K, 3): the ``segment`` of each, and the length it stands for."""

    points: np.ndarray
    segment: np.ndarray
    length_mm: np.ndarray


def sample_centrelines(tree: Tree, step_mm: float) -> Samples:
    """Each segment in equal parts of at most ``step_mm``, of each the middle; one point for a segment of length 0."""
    points, offset = polylines(tree)
    along = np.concatenate(([0.0], np.cumsum(np.sqrt((np.diff(points, axis=0) ** 2).sum(axis=1)))))
    length = tree.length_mm[1:]
    count = np.maximum(np.ceil(length / step_mm), 1).astype(np.int64)
    segment = np.repeat(np.arange(1, tree.n_nodes), count)
    within = np.arange(segment.size) - np.repeat(np.cumsum(count) - count, count)
    part = (length / count)[segment - 1]
    arc = along[offset[segment]] + (within + 0.5) * part
    place = np.column_stack([np.interp(arc, along, points[:, k]) for k in range(3)])
    return Samples(place, segment, part)


def locate(cast: Tree, tree: Tree, rule: LocationRule) -> Location:
    """Distances from cast to tree and back. Both carry the column ``generation`` and lie in one frame.

    Distances are exact from point to centreline. The share matched by chance is the share of points, evenly spread
    over the part of the trees' convex hulls that is common, that lie within tolerance of the tree's segments of like
    generation: what a cast laid at random into a tree so dense would show.
    """
    sides = {"cast": _one_way(cast, tree, rule), "tree": _one_way(tree, cast, rule)}
    generations = np.union1d(*[side["generation"] for side in sides.values()]).astype(int)
    table: dict[str, Any] = {"generation": generations}
    for name, side in sides.items():
        by_generation = dict(iter(side.groupby("generation")))
        rows = [_generation_row(by_generation.get(generation)) for generation in generations]
        table |= {f"{name}_{key}": [row[key] for row in rows] for key in rows[0]}
        if name == "cast":
            table["cast_chance_share"] = _chance(cast, tree, side, generations, rule)
    frame = pd.DataFrame(table)
    matched = (frame["cast_matched_share"] >= rule.threshold).to_numpy()
    down_to = int(generations[: int(np.argmin(matched)) if not matched.all() else matched.size].max(initial=0))
    return Location(rule, frame, _segment_rows(sides["cast"]), _segment_rows(sides["tree"]), down_to)


def _one_way(tree: Tree, other: Tree, rule: LocationRule) -> pd.DataFrame:
    """One row per sample point of ``tree``: segment, generation, length, tolerance, distances, matched or not."""
    samples = sample_centrelines(tree, rule.step_mm)
    generation = tree.columns["generation"][samples.segment]
    of_other = other.columns["generation"]
    like = np.full(generation.size, np.inf)
    for value in np.unique(generation):
        here = generation == value
        chosen = (np.abs(of_other - value) <= rule.generation_window) & (of_other > 0)
        like[here] = pieces(other, chosen).distance_mm(samples.points[here])
    whole = pieces(other).distance_mm(samples.points)
    tolerance = np.maximum(rule.tolerance_mm, tree.radius_mm[samples.segment])
    return pd.DataFrame(
        {
            "segment": samples.segment,
            "generation": generation,
            "length": samples.length_mm,
            "tolerance": tolerance,
            "like": like,
            "any": whole,
            "matched": samples.length_mm * (like <= tolerance),
            "matched_any": samples.length_mm * (whole <= tolerance),
        }
    )


def _generation_row(part: pd.DataFrame | None) -> dict[str, float]:
    if part is None:
        return {"length_mm": 0.0} | dict.fromkeys(_UNKNOWN, np.nan)
    length = part["length"].sum()
    return {
        "length_mm": length,
        "matched_share": part["matched"].sum() / length if length > 0 else np.nan,
        "matched_any_share": part["matched_any"].sum() / length if length > 0 else np.nan,
        "distance_mean_mm": _weighted(part["like"], part["length"]),
        "distance_max_mm": _finite(part["like"].max()),
        "distance_any_mean_mm": _weighted(part["any"], part["length"]),
    }


_UNKNOWN = ("matched_share", "matched_any_share", "distance_mean_mm", "distance_max_mm", "distance_any_mean_mm")


def _weighted(values: pd.Series, length: pd.Series) -> float:
    """Mean by length; NaN where the other tree has no segment to measure to, or there is no length."""
    total = length.sum()
    return _finite((values * length).sum() / total) if total > 0 and np.isfinite(values).all() else np.nan


def _finite(value: float) -> float:
    return float(value) if np.isfinite(value) else np.nan


def _chance(cast: Tree, tree: Tree, side: pd.DataFrame, generations: np.ndarray, rule: LocationRule) -> np.ndarray:
    """Per generation of the cast, the mean over its length of the share of common tissue within its tolerance."""
    result = np.full(generations.size, np.nan)
    hulls = convex_hull(cast.position_mm), convex_hull(tree.position_mm)
    if hulls[0] is None or hulls[1] is None:
        return result
    tissue = grid_inside(hulls[0], hulls[1], n_points=CHANCE_POINTS)
    of_tree = tree.columns["generation"]
    for k, value in enumerate(generations):
        part = side[side["generation"] == value]
        if len(tissue) and part["length"].sum() > 0:
            chosen = (np.abs(of_tree - value) <= rule.generation_window) & (of_tree > 0)
            distance = np.sort(pieces(tree, chosen).distance_mm(tissue))
            share = np.searchsorted(distance, part["tolerance"], side="right") / len(tissue)
            result[k] = np.average(share, weights=part["length"])
    return result


def _segment_rows(side: pd.DataFrame) -> pd.DataFrame:
    """Means along each segment; its points stand for equal lengths, so that they count alike."""
    hit = side.assign(hit=side["like"] <= side["tolerance"]).groupby("segment")
    mean = hit[["generation", "like", "any", "hit"]].mean()
    return pd.DataFrame(
        {
            "segment": mean.index.to_numpy() - 1,
            "generation": mean["generation"].to_numpy().astype(int),
            "distance_mean_mm": mean["like"].replace(np.inf, np.nan).to_numpy(),
            "distance_any_mean_mm": mean["any"].to_numpy(),
            "matched_share": mean["hit"].to_numpy(float),
        }
    )
