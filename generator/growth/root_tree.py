"""What growth starts from: a root point, or a root tree whose segments and radii are given (paper, section 2.3.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from generator.domain import Domain
from vascval.core.errors import InputError
from vascval.core.tree import Tree


@dataclass(frozen=True, eq=False)
class RootTree:
    """``parent`` (N,) root first, ``position_mm`` (N, 3), ``radius_mm`` (N,) with entry 0 a placeholder.

    Growth begins at its ends, one new vessel at each; its own segments are neither cut nor moved.
    """

    parent: np.ndarray
    position_mm: np.ndarray
    radius_mm: np.ndarray

    @classmethod
    def point(cls, position_mm: np.ndarray) -> RootTree:
        """A bare root point (depth 0)."""
        position = np.asarray(position_mm, dtype=np.float64).reshape(1, -1)
        return cls(np.array([-1], np.int32), position, np.zeros(1))

    @classmethod
    def of(cls, tree: Tree) -> RootTree:
        """All segments of a tree, straight, with its radii.

        :raises InputError: when a segment has no thickness or no length.
        """
        bad = np.flatnonzero((tree.radius_mm[1:] <= 0.0) | (tree.chord_mm[1:] <= 0.0)) + 1
        if bad.size or tree.n_segments == 0:
            what = f"{bad.size} segments without thickness or length (first: {bad[0]})" if bad.size else "no segment"
            raise InputError(f"the root tree has {what}; mend it or give a root point")
        return cls(np.asarray(tree.parent), np.asarray(tree.position_mm), np.asarray(tree.radius_mm))

    @property
    def open_nodes(self) -> np.ndarray:
        """The nodes at which growth begins: the ends, or the root point."""
        return np.setdiff1d(np.arange(self.parent.size), self.parent[1:])

    def require_inside(self, domain: Domain) -> None:
        """:raises InputError: when the root or, of a root tree, an end at which growth begins lies outside."""
        if self.parent.size == 1:
            domain.require_inside(self.position_mm[0], "the root")
        else:
            for node in self.open_nodes:
                domain.require_inside(self.position_mm[node], f"end {node} of the root tree")

    def shared_resistance(self) -> np.ndarray:
        """(J, J) sum of ``l / r^4`` over the segments that feed both of two ends."""
        ends = self.open_nodes
        feeds = np.zeros((len(ends), self.parent.size), dtype=bool)
        for row, node in zip(feeds, ends, strict=True):
            while node > 0:
                row[node] = True
                node = self.parent[node]
        length = np.zeros(self.parent.size)
        length[1:] = np.sqrt(((self.position_mm[1:] - self.position_mm[self.parent[1:]]) ** 2).sum(axis=1))
        resistance = np.zeros(self.parent.size)
        resistance[1:] = length[1:] / self.radius_mm[1:] ** 4
        return (feeds * resistance) @ feeds.T.astype(np.float64)
