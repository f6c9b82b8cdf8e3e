"""Measures of junctions: ratios of radii and areas, Murray exponents, angles, monopodial branches."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pandas as pd

from vascval.core.errors import InputError
from vascval.core.tree import Tree
from vascval.morphometry import _junction_kernels as kernels
from vascval.morphometry.preparation import polylines


@dataclass(frozen=True)
class Monopodial:
    """When a branch is monopodial: a child with radius at most ``ratio_max`` of its largest sibling, leaving at
    ``angle_min_deg`` to ``angle_max_deg`` to the feeding segment, while that sibling goes on within
    ``straight_max_deg``. Bounds are included.

    :raises InputError: on a ratio outside (0, 1) or angles that are not an ascending range within 0 to 180 degrees.
    """

    ratio_max: float = 0.5
    angle_min_deg: float = 60.0
    angle_max_deg: float = 120.0
    straight_max_deg: float = 30.0

    def __post_init__(self) -> None:
        if not 0 < self.ratio_max < 1:
            raise InputError(f"the ratio for monopodial branches is {self.ratio_max}; it must lie between 0 and 1")
        if not (0 <= self.angle_min_deg <= self.angle_max_deg <= 180 and 0 <= self.straight_max_deg <= 180):
            raise InputError(
                f"the angles for monopodial branches are {self.angle_min_deg} to {self.angle_max_deg} and "
                f"{self.straight_max_deg} degrees; ascending angles from 0 to 180 are needed"
            )


@dataclass(frozen=True)
class Angles:
    """``branching_deg`` (N,): angle of each segment to the one that feeds it; ``leaves`` (N, 3): unit directions."""

    branching_deg: np.ndarray
    leaves: np.ndarray


def angles(tree: Tree, *, window_radii: tuple[float, float]) -> Angles:
    """Angles from directions measured along the centreline, away from the junction.

    The direction of a segment at a junction is the chord between the points of its centreline at the two distances of
    ``window_radii`` from the node, in radii of the thickest segment that meets there: nearer, the centreline runs
    inside the common lumen and tells nothing. A segment shorter than that is measured from at most its middle to at
    most its end. For straight segments the window makes no difference. A segment whose points coincide has no
    direction and its angles are NaN.
    """
    points, offset = polylines(tree)
    thickest = tree.radius_mm.copy()
    np.maximum.at(thickest, tree.parent[1:], tree.radius_mm[1:])
    leaves, arrives = kernels.directions(tree.parent, points, offset, tree.length_mm, thickest, *window_radii)
    return Angles(kernels.branching_angles(tree.parent, leaves, arrives), leaves)


def junction_table(tree: Tree, generation: np.ndarray, measured: Angles) -> pd.DataFrame:
    """One row per node with two or more children (see :class:`vascval.io.rows.JunctionRow`), ascending.

    The generation is that of the segment that feeds the node, 0 at the root point. Thickest and thinnest child: among
    equal radii the child that goes straighter on counts as the thicker one.
    """
    topology = tree.topology
    node = np.flatnonzero(topology.n_children >= 2)
    rank = kernels.rank_children(
        node, topology.child_offset, topology.child_index, tree.radius_mm, measured.branching_deg
    )
    radius = tree.radius_mm
    inner = node > 0
    fed = np.where(inner, radius[node], np.nan)
    area = np.bincount(tree.parent[1:], weights=radius[1:] ** 2, minlength=tree.n_nodes)[node]
    murray = kernels.murray_exponents(node, topology.child_offset, topology.child_index, radius)
    return pd.DataFrame(
        {
            "node": node - 1,
            "generation": generation[node],
            "n_children": topology.n_children[node],
            "radius_parent_mm": fed,
            "radius_thickest_mm": radius[rank[:, 0]],
            "radius_thinnest_mm": radius[rank[:, 2]],
            "branching_ratio": radius[rank[:, 2]] / radius[rank[:, 0]],
            "area_ratio": area / fed**2,
            "murray_exponent": murray,
            "murray_reason": np.where(np.isnan(murray), np.where(inner, "child-not-thinner", "no-parent"), ""),
            "angle_thickest_deg": measured.branching_deg[rank[:, 0]],
            "angle_thinnest_deg": measured.branching_deg[rank[:, 2]],
            "angle_between_deg": kernels.pair_angles(rank[:, 0], rank[:, 1], measured.leaves),
            "x_mm": tree.position_mm[node, 0],
            "y_mm": tree.position_mm[node, 1],
            "z_mm": tree.position_mm[node, 2],
        }
    )


def monopodial_branches(tree: Tree, junctions: pd.DataFrame, measured: Angles, rule: Monopodial) -> np.ndarray:
    """(N,) whether each segment is a monopodial branch (see :class:`Monopodial`); never at the root point."""
    thickest = np.full(tree.n_nodes, np.nan)
    straight = np.full(tree.n_nodes, np.nan)
    node = junctions["node"].to_numpy() + 1
    thickest[node] = junctions["radius_thickest_mm"]
    straight[node] = junctions["angle_thickest_deg"]
    result = np.zeros(tree.n_nodes, dtype=bool)
    parent, angle = tree.parent[1:], measured.branching_deg[1:]
    result[1:] = (
        (tree.radius_mm[1:] <= rule.ratio_max * thickest[parent])
        & (angle >= rule.angle_min_deg)
        & (angle <= rule.angle_max_deg)
        & (straight[parent] <= rule.straight_max_deg)
    )
    return result


def monopodial_sensitivity(tree: Tree, junctions: pd.DataFrame, measured: Angles) -> pd.DataFrame:
    """The count of monopodial branches over a grid of all three thresholds around the usual ones."""
    rows = []
    for ratio, half_width, straight in itertools.product(
        (0.3, 0.4, 0.5, 0.6, 0.7), (20.0, 30.0, 40.0), (15.0, 30.0, 45.0)
    ):
        rule = Monopodial(ratio, 90.0 - half_width, 90.0 + half_width, straight)
        count = int(monopodial_branches(tree, junctions, measured, rule).sum())
        rows.append((rule.ratio_max, rule.angle_min_deg, rule.angle_max_deg, rule.straight_max_deg, count))
    names = ["ratio_max", "angle_min_deg", "angle_max_deg", "straight_max_deg", "n_monopodial"]
    return pd.DataFrame(rows, columns=names)
