"""The rows of every table that commands write, as models: one place for names, types, meanings and JSON schemas.

A row model describes one row of a table: its field names are the headers of the CSV file and the keys of the JSON
records. The unit is part of the name; what has none is a number or a ratio. A measure that does not exist for a row
(the standard deviation of one vessel, the branching ratio of a generation that feeds no junction) is ``null`` in JSON
and empty in CSV; a number that is not finite never appears.
"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

Number = float | None
Ordering = Literal["strahler", "diameter-defined"]


def _f(meaning: str, **options: Any) -> Any:
    return Field(description=meaning, **options)


class Row(BaseModel):
    """A row of a table; nothing but the named columns."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


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


class OrganRow(Row):
    """A Horton ratio of a real organ beside that of the tree, by regression over the orders without the highest.

    Third-party transcriptions of published tables, not checked against the papers: what is plausible, no pass mark.
    """

    organ: str = _f("species, organ and vessel")
    source: str = _f("key of the publication: first author and year")
    ordering: Ordering = _f("which orders its table has; the tree's ratio is for the same")
    quantity: Literal["number", "radius", "length"] = _f("number, mean radius or mean length of the elements")
    ratio: Number = _f("of the organ; null where its table does not have the quantity")
    r_squared: Number = _f("coefficient of determination of that")
    n_orders: int = _f("orders used for that")
    tree_ratio: Number = _f("of the tree; null where it has too few orders of that kind")
    relative: Number = _f("tree over organ, minus 1")


class SensitivityRow(Row):
    """How the count of monopodial branches moves with its thresholds."""

    ratio_max: float = _f("largest radius relative to the largest sibling")
    angle_min_deg: float = _f("smallest angle to the feeding segment")
    angle_max_deg: float = _f("largest angle to the feeding segment")
    straight_max_deg: float = _f("largest angle at which the largest sibling counts as going on")
    n_monopodial: int = _f("monopodial branches by these thresholds")


class TotalRow(Row):
    """A total of one tree beside that of the cast."""

    tree: int = _f("index of the tree, in the order given")
    measure: str = _f("key of the summary")
    cast_value: Number = _f("value of the cast")
    tree_value: Number = _f("value of the tree")
    difference: Number = _f("tree minus cast")
    relative: Number = _f("difference over the cast's value; null where that is 0")


class DistributionRow(Row):
    """Two distributions of one measure, of all vessels or of one generation."""

    tree: int = _f("index of the tree, in the order given")
    measure: str = _f("column of the table of segments or junctions")
    generation: int | None = _f("null for all; a junction belongs to the generation that feeds it")
    n_cast: int = _f("values of the cast")
    n_tree: int = _f("values of the tree")
    mean_cast: float = _f("mean of the cast's values")
    mean_tree: float = _f("mean of the tree's values")
    median_cast: float = _f("median of the cast's values")
    median_tree: float = _f("median of the tree's values")
    wasserstein: float = _f("Wasserstein distance, in the unit of the measure")
    wasserstein_relative: Number = _f("that over the standard deviation of the cast's values; null where that is 0")
    test: Literal["mann-whitney-u"] = _f("two-sided two-sample test, normal approximation with ties corrected")
    statistic: Number = _f("U of the tree's values; null with fewer values than the test asks for")
    p_value: Number = _f("tiny for large samples however small the difference: read the effect size")
    effect_size: Number = _f("Cliff's delta: P(tree > cast) - P(tree < cast), -1 to 1")


class LocationRow(Row):
    """How well one generation of the cast lies on the tree, and of the tree on the cast; null where one has none."""

    generation: int = _f("generation")
    cast_length_mm: float = _f("length of the cast's segments")
    cast_matched_share: Number = _f("share of that length within tolerance of the tree's segments of like generation")
    cast_matched_any_share: Number = _f("share within tolerance of any of the tree's segments")
    cast_distance_mean_mm: Number = _f("mean distance to the nearest segment of like generation")
    cast_distance_max_mm: Number = _f("largest such distance")
    cast_distance_any_mean_mm: Number = _f("mean distance to the nearest of all segments")
    cast_chance_share: Number = _f("share of the common hull within tolerance of like generation: matched by chance")
    tree_length_mm: float = _f("length of the tree's segments")
    tree_matched_share: Number = _f("share of that length within tolerance of the cast's segments of like generation")
    tree_matched_any_share: Number = _f("share within tolerance of any of the cast's segments")
    tree_distance_mean_mm: Number = _f("mean distance to the nearest segment of like generation")
    tree_distance_max_mm: Number = _f("largest such distance")
    tree_distance_any_mean_mm: Number = _f("mean distance to the nearest of all segments")


class SegmentLocationRow(Row):
    """How far one segment lies from the other tree."""

    segment: int = _f("cell index")
    generation: int = _f("generation")
    distance_mean_mm: Number = _f("mean distance along it to the nearest segment of like generation")
    distance_any_mean_mm: Number = _f("mean distance to the nearest of all segments")
    matched_share: float = _f("share of its length within tolerance of like generation")


class TerritoryRow(Row):
    """Overlap of the territories that the subtrees beginning at one generation perfuse."""

    generation: int = _f("subtrees begin at the first segment of this generation or a later one on each path")
    n_cast: int = _f("territories of the cast that hold a point")
    n_tree: int = _f("territories of the tree that hold a point")
    n_matched: int = _f("pairs matched, of maximum total overlap")
    dice: float = _f("2 x overlap of the matched pairs over the points of both partitions")
    dice_mean: float = _f("mean Dice of the matched pairs, each pair alike")


class ReferenceRow(Row):
    """One generation of a published table; only ``generation`` is obligatory."""

    generation: int = Field(ge=1, description="generation, root 1")
    n_segments: Number = Field(default=None, ge=0, description="number of segments")
    n_elements: Number = Field(default=None, ge=0, description="number of elements")
    radius_mean_mm: Number = Field(default=None, ge=0, description="mean radius")
    radius_sd_mm: Number = Field(default=None, ge=0, description="standard deviation of the radius")
    length_mean_mm: Number = Field(default=None, ge=0, description="mean length")
    length_sd_mm: Number = Field(default=None, ge=0, description="standard deviation of the length")
    branching_ratio_mean: Number = Field(default=None, ge=0, le=1, description="mean of thinnest over thickest child")
    branching_ratio_sd: Number = Field(default=None, ge=0, description="standard deviation of the branching ratio")
    n_trifurcations: Number = Field(default=None, ge=0, description="nodes with three children that it feeds")
    n_monopodial: Number = Field(default=None, ge=0, description="monopodial branches that spring from it")


class EnsembleTreeRow(Row):
    """One tree of an ensemble."""

    name: str = _f("of its files under trees")
    case: str = _f("the keys in which its configuration differs from the common one; empty without a grid")
    seed: int = _f("seed of its random numbers")
    n_terminals: int = _f("segments that end without children")
    n_segments: int = _f("segments")
    n_bifurcations: int = _f("nodes with exactly two children")
    n_trifurcations: int = _f("nodes with exactly three children")
    n_monopodial: int = _f("monopodial branches")
    n_overlaps: int = _f("pairs of segments without a common node whose capsules intersect")
    max_order: int = _f("Strahler order of the root segment")
    total_length_mm: float = _f("summed length")
    volume_mm3: float = _f("summed pi r^2 l")
    murray_exponent_median: Number = _f("median over the nodes that have one")
    branching_angle_mean_deg: Number = _f("mean angle of a child to the segment that feeds it")
    length_to_diameter_mean: Number = _f("mean of length over diameter")
    sha256: str = _f("checksum of the tree's file")


class EnsembleSpreadRow(Row):
    """A measure over the trees of one case, each tree counting alike."""

    case: str = _f("case of the grid; empty without a grid")
    generation: int | None = _f("generation, root 1; null for a total of the tree")
    measure: str = _f("what was measured, as the tables of single trees call it")
    n_trees: int = _f("trees that have a value")
    mean: float = _f("mean")
    sd: Number = _f("standard deviation (n - 1); null with a single tree")
    min: float = _f("least value")
    q1: float = _f("first quartile, interpolated between values")
    median: float = _f("median")
    q3: float = _f("third quartile")
    max: float = _f("greatest value")


class SearchStepRow(Row):
    """A step of a search for topologies by annealing: so many tests at one temperature."""

    n_tests: int = _f("topologies tested so far")
    n_accepted: int = _f("of those tested in this step, how many were accepted")
    temperature: float = _f("of the logarithm of the volume")
    volume_mm3: float = _f("volume of the present tree")
    best_mm3: float = _f("volume of the best tree so far")


TABLES: dict[str, type[Row]] = {
    "generations": GenerationRow,
    "orders": OrderRow,
    "segments": SegmentRow,
    "elements": ElementRow,
    "junctions": JunctionRow,
    "horton": HortonRow,
    "organs": OrganRow,
    "connectivity": ConnectivityRow,
    "monopodial-sensitivity": SensitivityRow,
    "totals": TotalRow,
    "distributions": DistributionRow,
    "location": LocationRow,
    "segment-location": SegmentLocationRow,
    "territories": TerritoryRow,
    "reference": ReferenceRow,
    "ensemble-trees": EnsembleTreeRow,
    "ensemble-spread": EnsembleSpreadRow,
    "search-history": SearchStepRow,
}
"""The row model of every table by name. ``differences`` follows from ``generations``: see the comparison."""
