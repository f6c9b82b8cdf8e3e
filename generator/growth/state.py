"""The growing tree: the records that the kernels work on, what is read off them, and how a branch is taken out."""

from __future__ import annotations

import numpy as np

from generator.domain import Domain
from generator.growth import _growth_kernels as kernels
from generator.growth import _overlap_kernels as overlaps
from generator.growth._grid import SegmentGrid
from generator.growth._index_kernels import follow
from generator.growth._records import SEGMENT, VISIT, Stems, Store
from generator.growth.root_tree import RootTree
from generator.haemodynamics import Perfusion, perfused_tree
from generator.kept import below, fits, with_prefix
from vascval.core.errors import ComputationError
from vascval.core.ordering import root_first
from vascval.core.tree import Topology, Tree

_THICK = 0.5
"""Vessels with a radius beyond this many cells of the grid are listed instead of being looked for in it."""
_OF_STEMS = ("top", "n", "cost")


class GrowthState:
    """A root, or root tree, with room for ``capacity`` terminals; ``apart`` prepares for vessels that keep apart."""

    def __init__(
        self, domain: Domain, perfusion: Perfusion, root_tree: RootTree, capacity: int, *, apart: bool
    ) -> None:
        self.perfusion, self.root_tree, self.apart = perfusion, root_tree, apart
        n_fixed = root_tree.parent.size
        size = n_fixed + 2 * capacity
        self.store = Store(
            n_fixed=n_fixed,
            gamma=float(perfusion.gamma),
            segment=np.zeros(size, SEGMENT),
            visit=np.zeros(size, VISIT),
            counts=np.zeros(6, np.int64),
            thick=np.zeros(size if apart else 0, np.int32),
            thin=np.array([np.inf]),
        )
        self.stems = _empty_stems(root_tree, perfusion)
        self._fill(root_tree.parent, root_tree.position_mm)
        self.grid = SegmentGrid(domain, self.store)

    @property
    def n_terminals(self) -> int:
        return int(self.store.counts[1])

    @property
    def n_nodes(self) -> int:
        return int(self.store.counts[0])

    @property
    def begun(self) -> bool:
        """Whether a vessel has grown at every end of the root tree."""
        return bool((self.stems.top >= 0).all())

    @property
    def volume_mm3(self) -> float:
        """Volume of the vessels grown so far, without the root tree's; not finite where that uses up the pressure."""
        scale = np.pi * self._stem_scale()
        return float((scale * np.exp(self.stems.cost))[self.stems.n > 0].sum())

    def _stem_scale(self) -> np.ndarray:
        """(J,) ``sqrt(kappa Q_term / dp)`` of each stem; NaN without pressure."""
        flow = self.perfusion.flow_mm3_s / max(self.n_terminals, 1)
        drop = self.stems.drop_pa - flow * self.stems.shared @ self.stems.n
        return np.sqrt(self.stems.kappa_pa_s * flow / np.where(drop > 0.0, drop, np.nan))

    def begin(self, node: int, point_mm: np.ndarray) -> None:
        """A first terminal straight from an end of the root tree."""
        kernels.begin(self.store, self.stems, self.grid.grid, node, *point_mm)

    def require_pressure(self) -> None:
        """:raises ComputationError: when the root tree has used up the pressure at one of its ends."""
        if not np.isfinite(self.volume_mm3):
            raise ComputationError(
                "the root tree uses up the pressure before its ends; widen it, lower the flow or raise root_pressure"
            )

    def renew(self) -> None:
        """Lay the grid for the present number of terminals; radii anew where vessels keep apart."""
        self.grid.renew()
        if self.apart:
            self.measure_radii()

    def measure_radii(self) -> None:
        """All radii anew, and the list of those too thick for the grid."""
        self.store.thin[0] = _THICK * self.grid.cell_mm
        top = np.maximum(self.stems.top, 0)
        radius = np.sqrt(self._stem_scale()) * self.store.segment["rho"][top] ** 0.25
        overlaps.sweep_radii(self.store, radius)

    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """``parent`` (N,) and ``position_mm`` (N, 3), nodes in the order in which they came."""
        segment = self.store.segment[: self.n_nodes]
        return segment["parent"].copy(), np.column_stack([segment[name] for name in ("bx", "by", "bz")])

    def tree(self) -> Tree:
        """What has grown so far, root first and perfused; bifurcations in one place are one junction."""
        parent, position = _joined(*self.arrays(), self.store.n_fixed)
        order = root_first(parent)
        rank = np.empty(order.size, np.int32)
        rank[order] = np.arange(order.size)
        fixed = np.full(order.size, np.nan)
        fixed[rank[1 : self.store.n_fixed]] = self.root_tree.radius_mm[1:]
        topology = Topology(np.concatenate(([-1], rank[parent[order[1:]]])))
        return perfused_tree(topology, position[order], self.perfusion, fixed)

    def snapshot(self) -> tuple[np.ndarray, np.ndarray]:
        """``parent`` (N,) and ``position_mm`` (N, 3), root first, the nodes of the root tree before all others."""
        parent, position = self.arrays()
        return _without(parent, position, np.zeros(parent.size, bool), self.store.n_fixed)

    def put(self, parent: np.ndarray, position_mm: np.ndarray) -> None:
        """Go on from another tree with the same root tree and terminals, numbered as :meth:`snapshot` does."""
        self.store.counts[:2] = 0
        self._fill(parent, position_mm)
        self.renew()

    def drop_overlapping(self, margin: float) -> np.ndarray:
        """Take out the smaller of every two vessels that overlap, with all below it; (K, 3) terminals taken out."""
        self.renew()
        lost = np.zeros(self.n_nodes, dtype=bool)
        if not overlaps.mark_overlapping(self.store, self.grid.grid, lost, margin):
            return np.zeros((0, 3))
        parent, position = self.arrays()
        kernels.spread_down(self.store, lost)
        leaf = self.store.segment["child"][: self.n_nodes] < 0
        dropped = position[lost & leaf]
        self.put(*_without(parent, position, lost, self.store.n_fixed))
        return dropped

    def state(self) -> dict[str, np.ndarray]:
        """Everything that decides how growth goes on, as plain arrays that are copies."""
        store, stems = self.store, self.stems
        return {
            "segment": store.segment[: self.n_nodes].view(np.uint8).reshape(self.n_nodes, -1).copy(),
            "counts": store.counts.copy(),
            "thick": store.thick[: store.counts[5]].copy(),
            "thin": store.thin.copy(),
            **with_prefix("stems", {name: getattr(stems, name).copy() for name in _OF_STEMS}),
            **with_prefix("grid", self.grid.state()),
        }

    def restore(self, kept: dict[str, np.ndarray]) -> bool:
        """Take over what :meth:`state` gave for the same root tree; whether it is sound, and of no use if not.

        The kernels trust every index that they meet: so all are checked here, and that lists end.
        """
        store, stems = self.store, self.stems
        n_stems, wide = stems.top.size, SEGMENT.itemsize
        kinds: dict[str, tuple[str, tuple[int | None, ...]]] = {
            "segment": ("uint8", (None, wide)), "counts": ("int64", (6,)), "thick": ("int32", (None,)),
            "thin": ("float64", (1,)), "stems.top": ("int32", (n_stems,)), "stems.n": ("float64", (n_stems,)),
            "stems.cost": ("float64", (n_stems,)),
        }  # fmt: skip
        if not fits(kept, kinds) or len(kept["segment"]) > store.segment.size:
            return False
        segment = np.ascontiguousarray(kept["segment"]).view(SEGMENT).ravel()
        if not self._is_sound(segment, kept["counts"], kept["thick"], kept["stems.top"]):
            return False
        store.segment[: segment.size] = segment
        store.counts[:], store.thin[:] = kept["counts"], kept["thin"]
        store.thick[: kept["thick"].size] = kept["thick"]
        for name in _OF_STEMS:
            getattr(stems, name)[:] = kept[f"stems.{name}"]
        return self.grid.restore(below("grid", kept))

    def _is_sound(self, segment: np.ndarray, counts: np.ndarray, thick: np.ndarray, top: np.ndarray) -> bool:
        n, fixed = segment.size, self.root_tree
        numbers = [name for name in SEGMENT.names or () if SEGMENT[name] == np.float64]
        leaves = np.count_nonzero(segment["child"][self.store.n_fixed :] < 0)
        if n < self.store.n_fixed or counts[0] != n or counts[1] != leaves or (counts < 0).any():
            return False
        if counts[2] >= 2**31 or counts[5] != thick.size or thick.size > self.store.thick.size:
            return False
        if not all(np.isfinite(segment[name]).all() for name in numbers):
            return False
        if not (_within(thick, 1, n) and _within(top, -1, n) and _within(segment["stem"], 0, top.size)):
            return False
        met = np.zeros(n, bool)
        if follow(segment["child"], segment["sibling"], met) != n - 1 or met[0]:
            return False
        parent, child, sibling = segment["parent"], segment["child"], segment["sibling"]
        has, goes_on = np.flatnonzero(child >= 0), np.flatnonzero(sibling >= 0)
        kin = (parent[child[has]] == has).all() and (parent[sibling[goes_on]] == parent[goes_on]).all()
        if not kin or parent[0] != -1 or (parent[: fixed.parent.size] != fixed.parent).any():
            return False
        end = np.column_stack([segment[name] for name in ("bx", "by", "bz")])
        start = np.column_stack([segment[name] for name in ("ax", "ay", "az")])
        low, high = self.grid.bounds_mm
        inside = ((end[fixed.parent.size :] >= low) & (end[fixed.parent.size :] <= high)).all()
        same = (end[: fixed.parent.size] == fixed.position_mm).all() and (start[1:] == end[parent[1:]]).all()
        return bool(inside and same)

    def _fill(self, parent: np.ndarray, position_mm: np.ndarray) -> None:
        self.stems.top[:] = -1
        self.stems.n[:] = 0
        kernels.load(self.store, self.stems, parent.astype(np.int32), np.ascontiguousarray(position_mm))
        self.store.segment["radius"][: self.store.n_fixed] = self.root_tree.radius_mm


def _within(numbers: np.ndarray, first: int, end: int) -> bool:
    return bool(((numbers >= first) & (numbers < end)).all())


def _without(
    parent: np.ndarray, position_mm: np.ndarray, lost: np.ndarray, n_fixed: int
) -> tuple[np.ndarray, np.ndarray]:
    """The tree without the lost nodes and the nodes at which nothing branches any more, its fixed nodes first."""
    n_children = np.bincount(parent[1:][~lost[1:]], minlength=parent.size)
    node = np.arange(parent.size)
    was_leaf = np.bincount(parent[1:], minlength=parent.size) == 0
    bare = ~lost & (node >= n_fixed) & (n_children == 0) & ~was_leaf
    assert not bare.any()  # a bifurcation loses at most the smaller of its branches
    passed = ~lost & (node >= n_fixed) & (n_children == 1)
    proximal = parent.copy()
    while (again := passed[proximal] & (proximal >= 0)).any():
        proximal[again] = parent[proximal[again]]
    keep = np.flatnonzero(~lost & ~passed)
    order = root_first(np.where(proximal < 0, -1, np.searchsorted(keep, proximal))[keep])
    order = np.concatenate((np.arange(n_fixed), order[order >= n_fixed]))
    rank = np.empty(order.size, np.int32)
    rank[order] = np.arange(order.size)
    old = keep[order]
    above = np.concatenate(([-1], rank[np.searchsorted(keep, proximal[old[1:]])]))
    return above.astype(np.int32), position_mm[old]


def _joined(parent: np.ndarray, position_mm: np.ndarray, n_fixed: int) -> tuple[np.ndarray, np.ndarray]:
    """The tree without segments of length 0 between junctions, which a search for topologies leaves behind."""
    inner = np.bincount(parent[1:], minlength=parent.size) > 0
    fallen = inner & (position_mm == position_mm[parent]).all(axis=1) & (np.arange(parent.size) >= n_fixed)
    proximal = parent.copy()
    while (again := fallen[proximal] & (proximal >= 0)).any():
        proximal[again] = parent[proximal[again]]
    keep = np.flatnonzero(~fallen)
    return np.where(proximal < 0, -1, np.searchsorted(keep, proximal))[keep], position_mm[keep]


def _empty_stems(root_tree: RootTree, perfusion: Perfusion) -> Stems:
    shared = perfusion.kappa_pa_s * root_tree.shared_resistance()
    n = len(shared)
    return Stems(
        top=np.full(n, -1, np.int32),
        n=np.zeros(n),
        cost=np.zeros(n),
        shared=shared,
        drop_pa=float(perfusion.pressure_drop_pa),
        flow_mm3_s=float(perfusion.flow_mm3_s),
        kappa_pa_s=float(perfusion.kappa_pa_s),
        mark=np.full(n, -1, np.int64),
        others=np.zeros(n),
        own=np.zeros(n),
    )
