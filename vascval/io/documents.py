"""The rows and documents that commands write, as models: one place for names, types, meanings and JSON schemas.

A row model describes one row of a table: its field names are the headers of the CSV file and the keys of the JSON
records. The unit is part of the name; what has none is a number or a ratio. A measure that does not exist for a row
(the standard deviation of one vessel, the branching ratio of a generation that feeds no junction) is ``null`` in JSON
and empty in CSV; a number that is not finite never appears.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
import pandas as pd
from pydantic import BaseModel, ConfigDict, Field

Number = float | None
Ordering = Literal["strahler", "diameter-defined"]


def _f(meaning: str, **options: Any) -> Any:
    return Field(description=meaning, **options)


class Row(BaseModel):
    """A row of a table; nothing but the named columns."""

    model_config = ConfigDict(extra="forbid")


class GenerationRow(Row):
    """Vessels of one generation: the root segment has generation 1, terminals the last one."""

    generation: int = _f("order of the root segment - order + 1")
    order: int = _f("Strahler order, terminals 1")
    n_segments: int = _f("segments: vessels between two junctions or ends")
    n_elements: int = _f("elements: runs of segments of equal order in series")
    radius_mean_mm: Number = _f("mean radius of the segments")
    radius_sd_mm: Number = _f("standard deviation (n - 1) of the radius; null below two segments")
    length_mean_mm: Number = _f("mean length of the segments along the centreline")
    length_sd_mm: Number = _f("standard deviation (n - 1) of the length")
    branching_ratio_mean: Number = _f("mean of thinnest over thickest child at the nodes that this generation feeds")
    branching_ratio_sd: Number = _f("standard deviation (n - 1) of the branching ratio")
    n_junctions: int = _f("nodes with two or more children that this generation feeds")
    n_trifurcations: int = _f("nodes with exactly three children that this generation feeds")
    n_monopodial: int = _f("monopodial branches that spring from this generation")
    tortuosity_mean: Number = _f("mean of path over chord")
    length_to_diameter_mean: Number = _f("mean of length over diameter")
    total_length_mm: float = _f("summed length")


class OrderRow(Row):
    """Vessels of one order, as segments and as elements, with their standard errors."""

    ordering: Ordering = _f("which order: Strahler, or diameter-defined (Jiang 1994)")
    order: int = _f("the order, terminals 1")
    n_segments: int = _f("number of segments")
    radius_mean_mm: Number = _f("mean radius of the segments")
    radius_sd_mm: Number = _f("its standard deviation (n - 1)")
    radius_se_mm: Number = _f("its standard error")
    length_mean_mm: Number = _f("mean length of the segments")
    length_sd_mm: Number = _f("its standard deviation (n - 1)")
    length_se_mm: Number = _f("its standard error")
    n_elements: int = _f("number of elements")
    element_radius_mean_mm: Number = _f("mean radius of the elements, each weighted by length over its segments")
    element_radius_sd_mm: Number = _f("its standard deviation (n - 1)")
    element_radius_se_mm: Number = _f("its standard error")
    element_length_mean_mm: Number = _f("mean length of the elements: the sum over their segments")
    element_length_sd_mm: Number = _f("its standard deviation (n - 1)")
    element_length_se_mm: Number = _f("its standard error")
    segments_per_element: Number = _f("mean number of segments of an element")
    taper_mean_per_mm: Number = _f("mean tapering of the elements of two or more segments")
    tortuosity_mean: Number = _f("mean of path over chord of the segments")
    length_to_diameter_mean: Number = _f("mean of length over diameter of the segments")


class SegmentRow(Row):
    """One segment; the row number is the cell index in the VTP file."""

    segment: int = _f("cell index, root first")
    parent: int = _f("cell index of the segment that feeds this one, -1 where it leaves the root")
    order: int = _f("Strahler order, terminals 1")
    generation: int = _f("generation, root segment 1")
    diameter_order: int | None = _f("diameter-defined order (Jiang 1994); null when the iteration did not converge")
    element: int = _f("index of its element")
    radius_mm: float = _f("radius")
    length_mm: float = _f("length along the centreline")
    chord_mm: float = _f("straight distance between its ends")
    tortuosity: Number = _f("length over chord; null when the ends coincide")
    length_to_diameter: float = _f("length over diameter")
    volume_mm3: float = _f("pi r^2 l")
    radius_to_parent: Number = _f("radius over that of the feeding segment; null at the root")
    branching_angle_deg: Number = _f("angle between its direction and that of the feeding segment, 0 straight on")
    monopodial: bool = _f("whether it is a monopodial branch by the thresholds of the analysis")
    n_terminals: int = _f("terminals that it feeds")
    proximal_x_mm: float = _f("proximal end, x")
    proximal_y_mm: float = _f("proximal end, y")
    proximal_z_mm: float = _f("proximal end, z")
    distal_x_mm: float = _f("distal end, x")
    distal_y_mm: float = _f("distal end, y")
    distal_z_mm: float = _f("distal end, z")


class ElementRow(Row):
    """One element of Strahler orders: a run of segments of equal order in series."""

    element: int = _f("index, root first")
    parent_element: int = _f("index of the element that it springs from, -1 at the root")
    order: int = _f("Strahler order")
    generation: int = _f("generation")
    n_segments: int = _f("number of its segments")
    radius_mm: float = _f("mean radius, weighted by length")
    length_mm: float = _f("summed length")
    taper_per_mm: Number = _f(
        "relative fall of the radius from its first to its last segment, per mm between their middles; "
        "null with a single segment"
    )


class JunctionRow(Row):
    """One node with two or more children, by the segment that feeds it."""

    node: int = _f("cell index of the segment that ends here, -1 at the root point")
    generation: int = _f("generation of the feeding segment, 0 at the root point")
    n_children: int = _f("number of segments that leave")
    radius_parent_mm: Number = _f("radius of the feeding segment; null at the root point")
    radius_thickest_mm: float = _f("radius of the thickest child")
    radius_thinnest_mm: float = _f("radius of the thinnest child")
    branching_ratio: float = _f("thinnest over thickest child")
    area_ratio: Number = _f("summed cross-section of the children over that of the feeding segment")
    murray_exponent: Number = _f("g that solves r^g = sum of r_child^g; null with the reason beside it")
    murray_reason: Literal["", "no-parent", "child-not-thinner"] = _f(
        "why there is no exponent: the root point has no feeding segment, or a child is as thick as it"
    )
    angle_thickest_deg: Number = _f("angle of the thickest child to the feeding segment, 0 straight on")
    angle_thinnest_deg: Number = _f("angle of the thinnest child to the feeding segment")
    angle_between_deg: Number = _f("angle between the two thickest children")
    x_mm: float = _f("position, x")
    y_mm: float = _f("position, y")
    z_mm: float = _f("position, z")


class HortonRow(Row):
    """A Horton ratio: the factor from order to order by regression of the logarithm over the orders of elements."""

    ordering: Ordering = _f("which order")
    quantity: Literal["number", "radius", "length"] = _f("number, mean radius or mean length of the elements")
    ratio: Number = _f("10^|slope|, above 1 when numbers fall and sizes grow with the order; null with one order")
    slope: Number = _f("slope of the decadic logarithm per order")
    r_squared: Number = _f("coefficient of determination; 1 with two orders, whatever they are")
    order_min: int = _f("first order used")
    order_max: int = _f("last order used")
    n_orders: int = _f("number of orders used")


class ConnectivityRow(Row):
    """C(m, n) of Jiang 1994: elements of order m that spring directly from one element of order n."""

    ordering: Ordering = _f("which order")
    order_child: int = _f("m")
    order_parent: int = _f("n")
    n_elements: int = _f("elements of order m that spring from elements of order n")
    n_parent_elements: int = _f("elements of order n")
    mean: float = _f("C(m, n) = n_elements / n_parent_elements")
    se: Number = _f("standard error over the parent elements; null with one of them")


class SensitivityRow(Row):
    """How the count of monopodial branches moves with its thresholds."""

    ratio_max: float = _f("largest radius relative to the largest sibling")
    angle_min_deg: float = _f("smallest angle to the feeding segment")
    angle_max_deg: float = _f("largest angle to the feeding segment")
    straight_max_deg: float = _f("largest angle at which the largest sibling counts as going on")
    n_monopodial: int = _f("monopodial branches by these thresholds")


class Document(BaseModel):
    """A JSON document; what is named is fixed, anything may be added."""

    model_config = ConfigDict(extra="allow")


class Summary(Document):
    """Totals of one tree."""

    n_terminals: int = _f("segments that end without children")
    n_segments: int = _f("segments")
    n_bifurcations: int = _f("nodes with exactly two children")
    n_trifurcations: int = _f("nodes with exactly three children")
    n_trifurcations_first_7: int = _f("those fed by generations up to 7")
    n_multifurcations: int = _f("nodes with four children or more")
    n_monopodial: int = _f("monopodial branches by the thresholds under parameters")
    n_elements: int = _f("elements")
    total_length_mm: float = _f("summed length")
    volume_mm3: float = _f("summed pi r^2 l")
    max_order: int = _f("Strahler order of the root segment")
    max_diameter_order: int | None = _f("largest diameter-defined order; null when the iteration did not converge")
    n_overlaps: int = _f("pairs of segments without a common node whose capsules intersect, after contraction")
    n_overlaps_as_given: int = _f("the same before contraction of degenerate segments")
    n_contracted: int = _f("degenerate segments contracted before measuring")
    murray_exponent_median: Number = _f("median over the nodes that have one")
    branching_angle_mean_deg: Number = _f("mean angle of a child to the segment that feeds it")
    tortuosity_mean: Number = _f("mean of path over chord")
    length_to_diameter_mean: Number = _f("mean of length over diameter")


class Coverage(Document):
    """How terminals fill the tissue."""

    domain: Literal["given points", "convex hull of the terminals"] = _f("what stands for the tissue")
    n_points: int = _f("points of the tissue")
    volume_mm3: Number = _f("volume of the tissue; null when only points were given")
    terminals_per_mm3: Number = _f("terminals over that volume")
    distance_mean_mm: float = _f("mean distance of a tissue point to the nearest terminal")
    distance_sd_mm: float = _f("its standard deviation")
    distance_median_mm: float = _f("its median")
    distance_q95_mm: float = _f("its 95 % quantile")
    distance_max_mm: float = _f("its maximum")
    evenness: Number = _f("mean distance over that of as many random terminals in infinite tissue, 0.554 (V / n)^(1/3)")


class Image(Document):
    """What skeletonisation did to the image."""

    n_components: int = _f("connected components of the mask")
    largest_component_fraction: float = _f("share of the voxels in the component kept")
    n_spurs_pruned: int = _f("spurs pruned")
    n_loops_cut: int = _f("loops cut")
    voxel_mm: list[float] = _f("voxel size, x y z")


class AnalyzeDocument(Document):
    """Output of ``vascval analyze --json``, and of each tree under ``compare``."""

    source: str = _f("file or description that the tree comes from")
    summary: Summary
    generations: list[GenerationRow]
    orders: list[OrderRow] = _f("per order, for each ordering that converged")
    horton: list[HortonRow]
    connectivity: list[ConnectivityRow]
    monopodial_sensitivity: list[SensitivityRow]
    coverage: Coverage | None = _f("null when the terminals span no volume")
    parameters: dict[str, Any] = _f("thresholds and rules used")
    notes: list[str] = _f("what was found, repaired or left out")
    image: Image | None = _f("only for a tree that comes from a volume", default=None)


class SkeletonizeDocument(Document):
    """Output of ``vascval skeletonize --json``."""

    source: str = _f("the volume")
    image: Image


class Stage(Document):
    """One stage of growing a tree."""

    name: Literal["growth", "topology", "geometry"]
    seconds: float = _f("wall time")
    volume_mm3: float = _f("volume of the tree after the stage")
    tests: int | None = _f("topology changes tested", default=None)
    solves: int | None = _f("geometry problems solved", default=None)


class GenerateDocument(Document):
    """Output of ``vascval generate --json``."""

    volume_mm3: float
    n_terminals: int
    n_segments: int
    n_trifurcations: int
    seed: int | None
    peak_memory_mb: float
    stages: list[Stage]


def plain(value: Any) -> Any:
    """``value`` as JSON knows it: NumPy and pandas scalars unwrapped, frames as records, not finite as ``None``."""
    if isinstance(value, pd.DataFrame):
        columns = {str(name): plain(series.tolist()) for name, series in value.items()}
        return [dict(zip(columns, row)) for row in zip(*columns.values())]
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if value is pd.NA or value is None:
        return None
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
