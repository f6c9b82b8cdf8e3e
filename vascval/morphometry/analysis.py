"""All measures of one tree, cast or synthetic, by one definition each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pandas as pd

from vascval.core.errors import ComputationError
from vascval.core.ordering import diameter_defined_order, element, generation, n_terminals_below, strahler_order
from vascval.core.tree import Tree
from vascval.io.documents import AnalyzeDocument, plain
from vascval.morphometry.coverage import coverage
from vascval.morphometry.junctions import (
    Angles,
    Monopodial,
    angles,
    junction_table,
    monopodial_branches,
    monopodial_sensitivity,
)
from vascval.morphometry.orders import (
    connectivity_table,
    element_table,
    generation_table,
    horton_table,
    order_table,
)
from vascval.morphometry.organs import organ_table
from vascval.morphometry.overlaps import overlapping_pairs
from vascval.morphometry.preparation import Prepared, prepare
from vascval.morphometry.statistics import mean_or_nan


@dataclass(frozen=True, eq=False)
class Analysis:
    """The measures of one tree.

    * ``source``: where the tree comes from; ``tree``: the tree as measured, with its columns ``order``,
      ``generation``, ``element`` and, where it converged, ``diameter_order``;
    * ``summary``: totals (:class:`vascval.io.documents.Summary`);
    * tables with the columns of the row models in :mod:`vascval.io.rows`: ``generations``, ``orders``,
      ``elements``, ``segments``, ``junctions``, ``connectivity``, ``horton``, ``organs`` (the ratios of real organs
      beside the tree's), ``monopodial_sensitivity``;
    * ``coverage`` (``None`` when there is no tissue to speak of), ``image`` (``None`` unless the tree comes from a
      volume), ``parameters`` (the rules used) and ``notes`` (what was found, repaired or left out).
    """

    source: str
    tree: Tree
    summary: dict[str, Any]
    generations: pd.DataFrame
    orders: pd.DataFrame
    elements: pd.DataFrame
    segments: pd.DataFrame
    junctions: pd.DataFrame
    connectivity: pd.DataFrame
    horton: pd.DataFrame
    organs: pd.DataFrame
    monopodial_sensitivity: pd.DataFrame
    coverage: dict[str, Any] | None
    image: dict[str, Any] | None
    parameters: dict[str, Any]
    notes: list[str]

    def document(self) -> dict[str, Any]:
        """The JSON document of ``analyze``, checked against :class:`vascval.io.documents.AnalyzeDocument`.

        Tables by segment, element and junction are left to their CSV files.
        """
        content = {
            name: getattr(self, name)
            for name in AnalyzeDocument.model_fields
            if name != "image" or self.image is not None
        }
        document: dict[str, Any] = plain(content)
        AnalyzeDocument.model_validate(document)
        return document


def analyze(
    tree: Tree,
    *,
    source: str,
    image: Mapping[str, Any] | None = None,
    diameters: float = 1.0,
    monopodial: Monopodial | None = None,
    angle_window_radii: tuple[float, float] = (1.0, 3.0),
    tissue_mm: np.ndarray | None = None,
    tissue_volume_mm3: float | None = None,
) -> Analysis:
    """Measure a tree.

    The tree is validated, chains of single children are merged and degenerate segments contracted
    (:func:`vascval.morphometry.preparation.prepare`); everything is measured on what remains, but for
    ``n_overlaps_as_given``.

    :param image: what skeletonisation reported, carried along.
    :param diameters: inner segments shorter than this many diameters are contracted; 0 contracts none.
    :param monopodial: thresholds of monopodial branches, the usual ones by default.
    :param angle_window_radii: where directions are measured (:func:`vascval.morphometry.junctions.angles`).
    :param tissue_mm: (K, 3) points that fill the tissue evenly, ``tissue_volume_mm3`` its volume; the convex hull of
        the terminals by default (:func:`vascval.morphometry.coverage.coverage`).
    :raises InputError: on a tree without segments or with segments of radius 0, and on parameters out of range.
    """
    rule = monopodial or Monopodial()
    ready = prepare(tree, diameters=diameters)
    notes = list(ready.notes)
    orders = {"strahler": strahler_order(ready.tree.topology)}
    try:
        orders["diameter-defined"] = diameter_defined_order(ready.tree.topology, 2 * ready.tree.radius_mm)
    except ComputationError as error:
        notes.append(f"no diameter-defined orders: {error}")
    measured = _with_orders(ready.tree, orders)
    angle = angles(measured, window_radii=angle_window_radii)
    junctions = junction_table(measured, measured.columns["generation"], angle)
    segments = _segment_table(measured, angle, monopodial_branches(measured, junctions, angle, rule))
    elements = {name: element_table(measured, order) for name, order in orders.items()}
    by_order = {name: order_table(name, order, segments, elements[name]) for name, order in orders.items()}
    horton = pd.concat([horton_table(*item) for item in by_order.items()], ignore_index=True)
    covered = coverage(measured, tissue_mm=tissue_mm, tissue_volume_mm3=tissue_volume_mm3)
    if covered is None:
        notes.append("no coverage: the terminals span no volume and no tissue was given")
    if (junctions["node"] < 0).any():
        notes.append("several segments leave the root point: that junction has generation 0, in no row of generations")
    return Analysis(
        source=source,
        tree=measured,
        summary=_summary(ready, measured, segments, junctions, len(elements["strahler"])),
        generations=generation_table(segments, elements["strahler"], junctions),
        orders=pd.concat(by_order.values(), ignore_index=True),
        elements=elements["strahler"],
        segments=segments,
        junctions=junctions,
        connectivity=pd.concat([connectivity_table(*item) for item in elements.items()], ignore_index=True),
        horton=horton,
        organs=organ_table(horton),
        monopodial_sensitivity=monopodial_sensitivity(measured, junctions, angle),
        coverage=covered,
        image=None if image is None else dict(image),
        parameters={
            "contraction_diameters": diameters,
            "monopodial": asdict(rule),
            "angle_window_radii": list(angle_window_radii),
        },
        notes=notes,
    )


def _with_orders(tree: Tree, orders: Mapping[str, np.ndarray]) -> Tree:
    strahler = orders["strahler"]
    columns = {
        "order": strahler,
        "generation": generation(tree.topology, strahler),
        "element": element(tree.topology, strahler, tree.radius_mm),
    }
    if "diameter-defined" in orders:
        columns["diameter_order"] = orders["diameter-defined"]
    return tree.with_columns(**columns)


def _segment_table(tree: Tree, angle: Angles, monopodial: np.ndarray) -> pd.DataFrame:
    """One row per segment, root first (see :class:`vascval.io.rows.SegmentRow`)."""
    length, chord, radius = tree.length_mm[1:], tree.chord_mm[1:], tree.radius_mm[1:]
    parent = tree.parent[1:]
    diameter_order = tree.columns.get("diameter_order")
    spans = chord > 0
    table = {
        "segment": np.arange(tree.n_segments),
        "parent": parent - 1,
        "order": tree.columns["order"][1:],
        "generation": tree.columns["generation"][1:],
        "diameter_order": pd.array([None] * tree.n_segments, "Int64") if diameter_order is None else diameter_order[1:],
        "element": tree.columns["element"][1:],
        "radius_mm": radius,
        "length_mm": length,
        "chord_mm": chord,
        "tortuosity": np.where(spans, length / np.where(spans, chord, 1.0), np.nan),
        "length_to_diameter": length / (2 * radius),
        "volume_mm3": np.pi * radius**2 * length,
        "radius_to_parent": np.where(parent > 0, radius / tree.radius_mm[parent], np.nan),
        "branching_angle_deg": angle.branching_deg[1:],
        "monopodial": monopodial[1:],
        "n_terminals": n_terminals_below(tree.topology)[1:],
    }
    for end, node in (("proximal", parent), ("distal", np.arange(1, tree.n_nodes))):
        table |= {f"{end}_{axis}_mm": tree.position_mm[node, k] for k, axis in enumerate("xyz")}
    return pd.DataFrame(table)


def _summary(
    ready: Prepared, tree: Tree, segments: pd.DataFrame, junctions: pd.DataFrame, n_elements: int
) -> dict[str, Any]:
    children = junctions["n_children"].to_numpy()
    first_7 = junctions["generation"].to_numpy() <= 7
    murray = junctions["murray_exponent"].dropna()
    n_overlaps = len(overlapping_pairs(tree))
    diameter_order = tree.columns.get("diameter_order")
    return {
        "n_terminals": tree.topology.n_terminals,
        "n_segments": tree.n_segments,
        "n_bifurcations": int((children == 2).sum()),
        "n_trifurcations": int((children == 3).sum()),
        "n_trifurcations_first_7": int(((children == 3) & first_7).sum()),
        "n_multifurcations": int((children >= 4).sum()),
        "n_monopodial": int(segments["monopodial"].sum()),
        "n_elements": n_elements,
        "total_length_mm": float(tree.length_mm.sum()),
        "volume_mm3": tree.volume_mm3,
        "max_order": int(tree.columns["order"][1:].max()),
        "max_diameter_order": None if diameter_order is None else int(diameter_order[1:].max()),
        "n_overlaps": n_overlaps,
        "n_overlaps_as_given": len(overlapping_pairs(ready.merged)) if ready.n_contracted else n_overlaps,
        "n_contracted": ready.n_contracted,
        "murray_exponent_median": float(murray.median()) if len(murray) else None,
        "branching_angle_mean_deg": mean_or_nan(segments["branching_angle_deg"].to_numpy()),
        "tortuosity_mean": mean_or_nan(segments["tortuosity"].to_numpy()),
        "length_to_diameter_mean": mean_or_nan(segments["length_to_diameter"].to_numpy()),
    }
