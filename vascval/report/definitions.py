"""The measures in words: one definition each, used for cast and synthetic tree alike."""

from __future__ import annotations

from collections.abc import Mapping

MEASURED = (
    ("segment", "A vessel between two junctions, or between a junction and an end."),
    ("element", "A run of segments of equal order in series."),
    (
        "degenerate segment",
        "A segment between two junctions that is shorter than its diameter: its two junctions count as one, "
        "in cast and synthetic tree alike. This is what makes trifurcations comparable.",
    ),
    (
        "Strahler order",
        "Terminals have order 1; a parent takes the largest order of its children, plus 1 if at least two "
        "children share it.",
    ),
    (
        "generation",
        "Order of the root segment minus order plus 1: the root has generation 1, terminals the last.",
    ),
    (
        "diameter-defined order",
        "Strahler orders corrected by diameter (Jiang 1994): with mean D and standard deviation SD of the "
        "diameters, the bound between orders n − 1 and n is the mean of D + SD of the lower and D − SD of the "
        "higher; repeated until fewer than 1 % of the vessels change.",
    ),
    (
        "branching ratio",
        "Radius of the thinnest over that of the thickest child of a junction, under the generation of the "
        "segment that feeds it.",
    ),
    ("area ratio", "Summed cross-section of the children over that of the feeding segment."),
    (
        "Murray exponent",
        "The g that solves r^g = sum of r_child^g at a junction; none where a child is as thick as its parent.",
    ),
    (
        "branching angle",
        "Angle between the direction of a segment and that of the segment that feeds it, 0 straight on; "
        "directions are measured along the centreline, away from the common lumen.",
    ),
    ("tortuosity", "Length along the centreline over the straight distance between its ends."),
    ("length to diameter", "Length of a segment over its diameter."),
    ("trifurcation", "A junction with exactly three children, once degenerate segments are contracted."),
    (
        "monopodial branch",
        "A child much thinner than its largest sibling that leaves sideways while the sibling goes straight "
        "on, by three thresholds that stand where such branches are counted.",
    ),
    (
        "Horton ratio",
        "Factor by which number, mean radius or mean length of the elements change from order to order, from "
        "a straight line through their logarithms.",
    ),
    (
        "connectivity matrix",
        "C(m, n): elements of order m that spring from one element of order n, on average.",
    ),
    (
        "coverage",
        "Distance of points of the tissue to the nearest terminal; the tissue is the convex hull of the "
        "terminals unless it is given. Its ratio to the same for as many random terminals is below 1 where "
        "terminals are spread evenly.",
    ),
    ("overlapping pairs", "Segments without a common junction whose tubes intersect."),
)

COMPARED = (
    ("difference", "Tree minus cast; in percent of the cast's value."),
    (
        "Wasserstein distance",
        "How far, on average, the values of one distribution must be moved to become the other; in the unit "
        "of the measure.",
    ),
    (
        "Cliff's delta",
        "Probability that a value of the tree exceeds one of the cast minus that of the converse, −1 to 1.",
    ),
    (
        "length matched",
        "Share of the length of a generation whose centreline lies within tolerance of the other tree's "
        "centreline of like generation.",
    ),
    ("matched by chance", "The share of the common tissue that lies within tolerance of the tree."),
    (
        "Dice overlap",
        "Twice the tissue that paired territories of cast and tree share, over the tissue of both; 1 for "
        "equal territories.",
    ),
)


def monopodial_rule(rule: Mapping[str, float]) -> str:
    """The thresholds (:class:`vascval.morphometry.Monopodial`) in words."""
    return (
        f"Monopodial: radius at most {rule['ratio_max']:g} of the largest sibling, leaving at "
        f"{rule['angle_min_deg']:g} to {rule['angle_max_deg']:g}° while that sibling goes on within "
        f"{rule['straight_max_deg']:g}°."
    )
