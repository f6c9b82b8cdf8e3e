"""Which tissue the first branches perfuse, and how far cast and tree agree on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from vascval.comparison import _territory_kernels as kernels
from vascval.core.tree import Tree
from vascval.morphometry.hull import convex_hull, grid_inside


@dataclass(frozen=True, eq=False)
class Territories:
    """``generations``: one :class:`vascval.io.rows.TerritoryRow` each; measured on ``n_points`` of tissue."""

    n_points: int
    generations: pd.DataFrame

    def document(self, tree: str) -> dict[str, Any]:
        return {"tree": tree, "n_points": self.n_points, "generations": self.generations}


def territories(cast: Tree, tree: Tree, *, generations: int, n_points: int) -> Territories | None:
    """Overlap of the territories of cast and tree, for subtrees that begin at generation 1, 2, ...

    Tissue points fill the part that the convex hulls of both trees' terminals have in common. A point belongs to its
    nearest terminal, and for generation g to the subtree that begins with the first segment of generation g or later
    on the path to that terminal: every point has one owner in either tree. Subtrees of cast and tree are paired one
    to one so that the paired overlaps sum to the most (Hungarian method). ``dice`` is twice that sum over the points
    of both partitions, so that large territories weigh more; ``dice_mean`` lets each pair count alike. Generation 1
    agrees by construction where a single stem leaves each root.

    :param generations: as many at most, and no more than either tree has.
    :returns: ``None`` when the terminals of a tree span no volume or the hulls have nothing in common.
    """
    hulls = [convex_hull(side.position_mm[side.topology.terminals]) for side in (cast, tree)]
    if hulls[0] is None or hulls[1] is None:
        return None
    tissue = grid_inside(hulls[0], hulls[1], n_points=n_points)
    if not len(tissue):
        return None
    terminal = [_nearest_terminal(side, tissue) for side in (cast, tree)]
    last = min(generations, *(int(side.columns["generation"].max()) for side in (cast, tree)))
    rows = []
    for first in range(1, last + 1):
        owner = [
            kernels.subtree_roots(side.parent, side.columns["generation"], first)[nearest]
            for side, nearest in zip((cast, tree), terminal)
        ]
        rows.append((first, *_overlap(*owner)))
    names = ["generation", "n_cast", "n_tree", "n_matched", "dice", "dice_mean"]
    return Territories(len(tissue), pd.DataFrame(rows, columns=names))


def _nearest_terminal(tree: Tree, points: np.ndarray) -> np.ndarray:
    terminals = tree.topology.terminals
    return terminals[cKDTree(tree.position_mm[terminals]).query(points)[1]]


def _overlap(a: np.ndarray, b: np.ndarray) -> tuple[int, int, int, float, float]:
    """Sizes of two partitions of the same points, pairs matched, Dice of all and mean Dice of the pairs."""
    (_, left), (_, right) = np.unique(a, return_inverse=True), np.unique(b, return_inverse=True)
    table = np.zeros((left.max() + 1, right.max() + 1), dtype=np.int64)
    np.add.at(table, (left, right), 1)
    row, column = linear_sum_assignment(table, maximize=True)
    shared = table[row, column]
    row, column, shared = row[shared > 0], column[shared > 0], shared[shared > 0]
    dice = 2 * shared / (table.sum(axis=1)[row] + table.sum(axis=0)[column])
    return (*table.shape, shared.size, float(shared.sum() / a.size), float(dice.mean()))
