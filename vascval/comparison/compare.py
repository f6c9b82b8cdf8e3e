"""A cast, or a published table, against one or more synthetic trees."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pandas as pd

from vascval.comparison.differences import generation_differences, total_differences
from vascval.comparison.distributions import TEST, distribution_table
from vascval.comparison.location import Location, LocationRule, locate
from vascval.comparison.territories import Territories, territories
from vascval.core.errors import InputError
from vascval.core.tree import Tree
from vascval.io.documents import CompareDocument, ReferenceTable, plain
from vascval.io.rows import DistributionRow, TotalRow
from vascval.morphometry import Analysis

Observer = Callable[[str, float, float], None]


@dataclass(frozen=True, eq=False)
class Comparison:
    """A cast against trees.

    * ``cast``: the analysed cast or the published table in its stead; ``trees``; ``reference``: a published table
      beside the cast;
    * ``totals``: summary values side by side; ``differences``: per tree, tree minus cast by generation;
      ``reference_differences``: minus the reference, first of the cast (where analysed), then of each tree;
    * ``distributions``; ``location`` and ``territories``: one per tree. These three are empty when a published table
      stands in for the cast; an entry of ``territories`` is ``None`` where the two trees have no tissue in common;
    * ``parameters``, ``notes``.
    """

    cast: Analysis | ReferenceTable
    trees: list[Analysis]
    reference: ReferenceTable | None
    totals: pd.DataFrame
    differences: list[pd.DataFrame]
    reference_differences: list[pd.DataFrame]
    distributions: pd.DataFrame
    location: list[Location]
    territories: list[Territories | None]
    parameters: dict[str, Any]
    notes: list[str]

    def document(self) -> dict[str, Any]:
        """The JSON document of ``compare``, checked against :class:`vascval.io.documents.CompareDocument`."""
        sources = [tree.source for tree in self.trees]
        measured = ([self.cast.source] if isinstance(self.cast, Analysis) else []) + sources
        against = "" if self.reference is None else self.reference.source
        content = {
            "cast": self.cast.document(),
            "trees": [tree.document() for tree in self.trees],
            "totals": self.totals,
            "differences": [
                {"tree": name, "against": self.cast.source, "generations": rows}
                for name, rows in zip(sources, self.differences)
            ],
            "reference_differences": [
                {"tree": name, "against": against, "generations": rows}
                for name, rows in zip(measured, self.reference_differences)
            ],
            "distributions": self.distributions,
            "location": [item.document(name) for name, item in zip(sources, self.location)],
            "territories": [
                None if item is None else item.document(name) for name, item in zip(sources, self.territories)
            ],
            "parameters": self.parameters,
            "notes": self.notes,
        }
        if self.reference is not None:
            content["reference"] = self.reference.document()
        document: dict[str, Any] = plain(content)
        CompareDocument.model_validate(document)
        return document


def compare(
    cast: Analysis | ReferenceTable,
    trees: Sequence[Analysis],
    *,
    reference: ReferenceTable | None = None,
    tolerance_mm: float | None = None,
    step_mm: float = 0.5,
    generation_window: int = 1,
    matched_threshold: float = 0.5,
    minimum_for_test: int = 5,
    territory_generations: int = 5,
    territory_points: int = 20_000,
    observer: Observer | None = None,
) -> Comparison:
    """Compare trees with a cast: differences by generation, distributions, location, territories.

    :param cast: the analysed cast, or a published per-generation table, which has no places and no distributions.
    :param reference: a published table shown beside the cast.
    :param tolerance_mm: how near counts as matched, or the local radius where that is more; by default 1 % of the
        diagonal of the cast's bounding box, so that small and large organs are treated alike.
    :param step_mm: largest distance between the points compared along a centreline; made smaller than asked where it
        exceeds a quarter of the tolerance, so that a small organ is not compared at its ends alone.
    :param generation_window: generations that differ by at most this are alike.
    :param matched_threshold: share of the length from which on a generation counts as matched.
    :param minimum_for_test: values needed on either side for a test.
    :param territory_generations: territories are compared for as many first generations, on about
        ``territory_points`` points.
    :raises InputError: without trees, and on parameters out of range.
    """
    trees = list(trees)
    _check(trees, tolerance_mm, step_mm, generation_window, matched_threshold)
    tell = observer or (lambda stage, done, total: None)
    tell("differences", 0, 1)
    measured = ([cast] if isinstance(cast, Analysis) else []) + trees
    notes: list[str] = []
    parameters: dict[str, Any] = {"test": TEST, "minimum_for_test": minimum_for_test}
    totals = pd.DataFrame(columns=list(TotalRow.model_fields))
    distributions = pd.DataFrame(columns=list(DistributionRow.model_fields))
    location: list[Location] = []
    shared: list[Territories | None] = []
    if isinstance(cast, Analysis):
        rule = _location_rule(cast.tree, tolerance_mm, step_mm, generation_window, matched_threshold)
        parameters |= {"location": asdict(rule), "territory_generations": territory_generations}
        totals = total_differences(trees, cast)
        tell("distributions", 0, 1)
        distributions = distribution_table(cast, trees, minimum=minimum_for_test)
        notes.append(
            "p values fall with the number of vessels, whatever the size of the difference: read the effect size"
        )
        for index, tree in enumerate(trees):
            tell("location", index, len(trees))
            location.append(locate(cast.tree, tree.tree, rule))
            tell("territories", index, len(trees))
            overlap = territories(cast.tree, tree.tree, generations=territory_generations, n_points=territory_points)
            shared.append(overlap)
            notes += _frame_notes(cast, tree, overlap)
    else:
        notes.append(f"{cast.source} is a published table: no distributions, locations and territories")
    tell("done", 1, 1)
    return Comparison(
        cast=cast,
        trees=trees,
        reference=reference,
        totals=totals,
        differences=[generation_differences(tree, cast) for tree in trees],
        reference_differences=[] if reference is None else [generation_differences(t, reference) for t in measured],
        distributions=distributions,
        location=location,
        territories=shared,
        parameters=parameters,
        notes=notes,
    )


def _check(
    trees: list[Analysis], tolerance_mm: float | None, step_mm: float, generation_window: int, threshold: float
) -> None:
    if not trees:
        raise InputError("there is no tree to compare with the cast; give one or more")
    if tolerance_mm is not None and not (np.isfinite(tolerance_mm) and tolerance_mm > 0):
        raise InputError(f"the tolerance is {tolerance_mm} mm; a positive number is needed")
    if not (np.isfinite(step_mm) and step_mm > 0):
        raise InputError(f"the step is {step_mm} mm; a positive number is needed")
    if generation_window < 0 or not 0 < threshold <= 1:
        raise InputError(
            f"generations within {generation_window} and a share of {threshold}; 0 or more, and a share in (0, 1], "
            "are needed"
        )


def _location_rule(
    cast: Tree, tolerance_mm: float | None, step_mm: float, generation_window: int, threshold: float
) -> LocationRule:
    points = cast.position_mm if cast.polyline_mm is None else cast.polyline_mm
    tolerance = 0.01 * float(np.linalg.norm(np.ptp(points, axis=0))) if tolerance_mm is None else tolerance_mm
    return LocationRule(min(step_mm, tolerance / 4), tolerance, generation_window, threshold)


def _frame_notes(cast: Analysis, tree: Analysis, overlap: Territories | None) -> list[str]:
    a, b = cast.tree.position_mm, tree.tree.position_mm
    if (a.min(axis=0) > b.max(axis=0)).any() or (b.min(axis=0) > a.max(axis=0)).any():
        return [
            f"{tree.source} lies wholly outside the bounding box of {cast.source}: they do not share a frame, and "
            "location and territories mean nothing"
        ]
    if overlap is None:
        return [f"no territories for {tree.source}: its terminals and those of {cast.source} enclose no common volume"]
    return []
