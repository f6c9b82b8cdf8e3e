"""The tree: a parent array and named columns, frozen.

Node 0 is the root point. Segment ``i`` runs from node ``parent[i]`` to node ``i`` (``i >= 1``), so that segments and
nodes share their index and entry 0 of a segment column is a placeholder. ``parent[0] == -1`` and ``parent[i] < i``:
every sweep from root to leaves, or back, is one plain loop.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

from vascval.core.columns import as_column
from vascval.core.errors import InputError

NULL = -1


def _frozen(values: object, dtype: str) -> np.ndarray:
    array = np.array(values, dtype=dtype)
    array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False)
class Topology:
    """Who feeds whom: ``parent`` of shape (N,), int32, with ``parent[0] == -1`` and ``parent[i] < i``.

    :raises InputError: when the array breaks that rule; the first offending node is named.
    """

    parent: np.ndarray

    def __post_init__(self) -> None:
        given = np.asarray(self.parent)
        if given.ndim != 1 or given.size == 0:
            raise InputError(f"a parent array of shape {given.shape} is no tree; one entry per node is needed")
        if not np.issubdtype(given.dtype, np.integer):
            raise InputError(f"a parent array of type {given.dtype} is no tree; integers are needed")
        parent = _frozen(given, "int32")
        if parent[0] != NULL:
            raise InputError(f"node 0 has parent {parent[0]}; the root comes first and has parent {NULL}")
        rest = parent[1:]
        bad = np.flatnonzero((rest < 0) | (rest >= np.arange(1, parent.size))) + 1
        if bad.size:
            raise InputError(
                f"{bad.size} nodes do not come after their parent (first: node {bad[0]}, parent {parent[bad[0]]}); "
                "sort the nodes root first (vascval.core.ordering.root_first)"
            )
        object.__setattr__(self, "parent", parent)

    @property
    def n_nodes(self) -> int:
        return int(self.parent.size)

    @property
    def n_segments(self) -> int:
        return self.n_nodes - 1

    @cached_property
    def n_children(self) -> np.ndarray:
        """(N,) number of segments that leave each node."""
        return _frozen(np.bincount(self.parent[1:], minlength=self.n_nodes), "int32")

    @cached_property
    def child_offset(self) -> np.ndarray:
        """(N + 1,) children of node ``i`` are ``child_index[child_offset[i]:child_offset[i + 1]]``."""
        return _frozen(np.concatenate(([0], np.cumsum(self.n_children))), "int64")

    @cached_property
    def child_index(self) -> np.ndarray:
        """(N - 1,) children, grouped by parent, ascending within each."""
        return _frozen(np.argsort(self.parent[1:], kind="stable") + 1, "int32")

    def children(self, node: int) -> np.ndarray:
        """The children of ``node``, ascending."""
        return self.child_index[self.child_offset[node] : self.child_offset[node + 1]]

    @cached_property
    def terminals(self) -> np.ndarray:
        """The nodes without children, ascending; a tree without segments has none."""
        leaves = np.flatnonzero(self.n_children == 0)
        return _frozen(leaves[leaves > 0], "int32")

    @property
    def n_terminals(self) -> int:
        return int(self.terminals.size)


@dataclass(frozen=True, eq=False)
class Tree:
    """A tree in space. All arrays are read-only; change by copy (:meth:`with_columns`, ``dataclasses.replace``).

    * ``position_mm`` (N, 3): the nodes, in the world frame of the source (LPS for images).
    * ``radius_mm`` (N,): radius of the segment that ends at each node; entry 0 is the radius at the inlet (that of
      the thickest segment leaving the root, whatever was given).
    * ``columns``: further columns by registered name (:mod:`vascval.core.columns`), each (N,).
    * ``polyline_mm`` (M, 3), ``polyline_offset`` (N + 1,): curved centrelines. Segment ``i`` follows the points
      ``polyline_mm[polyline_offset[i]:polyline_offset[i + 1]]``, both ends included; entry 0 is empty. ``None`` when
      all segments are straight.
    * ``meta``: provenance and what a reader guessed; plain JSON values.

    :raises InputError: on wrong shapes, on values that are not finite, on negative radii, and where a polyline does
        not begin and end at its nodes.
    """

    topology: Topology
    position_mm: np.ndarray
    radius_mm: np.ndarray
    columns: Mapping[str, np.ndarray] = field(default_factory=dict)
    polyline_mm: np.ndarray | None = None
    polyline_offset: np.ndarray | None = None
    meta: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = self.topology.n_nodes
        position = _frozen(self.position_mm, "float64")
        if position.shape != (n, 3):
            raise InputError(f"positions have shape {position.shape}; ({n}, 3) is needed for {n} nodes")
        _refuse(~np.isfinite(position).all(axis=1), "nodes have a position that is not finite", "node")
        radius = np.array(self.radius_mm, dtype="float64")
        if radius.shape != (n,):
            raise InputError(f"radii have shape {radius.shape}; ({n},) is needed, entry 0 being a placeholder")
        stems = self.topology.children(0)
        radius[0] = radius[stems].max() if stems.size else 0.0
        _refuse(~np.isfinite(radius) | (radius < 0), "segments have a radius that is negative or not finite", "segment")
        radius.setflags(write=False)
        object.__setattr__(self, "position_mm", position)
        object.__setattr__(self, "radius_mm", radius)
        columns = {name: as_column(name, values, n) for name, values in self.columns.items()}
        object.__setattr__(self, "columns", MappingProxyType(columns))
        object.__setattr__(self, "meta", MappingProxyType(dict(self.meta)))
        if (self.polyline_mm is None) != (self.polyline_offset is None):
            raise InputError("polyline_mm and polyline_offset come together; give both or neither")
        if self.polyline_mm is not None:
            self._check_polylines()

    def _check_polylines(self) -> None:
        points = _frozen(self.polyline_mm, "float64")
        offset = _frozen(self.polyline_offset, "int64")
        n = self.topology.n_nodes
        if points.ndim != 2 or points.shape[1] != 3 or offset.shape != (n + 1,):
            shapes = f"{points.shape} and {offset.shape}"
            raise InputError(f"polylines have shapes {shapes}; (M, 3) and ({n + 1},) are needed")
        if offset[0] != 0 or offset[1] != 0 or offset[-1] != len(points):
            raise InputError("polyline_offset must begin with 0, 0 and end with the number of points")
        size = np.diff(offset)[1:]
        _refuse(np.concatenate(([False], size < 2)), "segments have a polyline of fewer than two points", "segment")
        _refuse(~np.isfinite(points).all(axis=1), "polyline points are not finite", "point")
        start, end = points[offset[1:-1]], points[offset[2:] - 1]
        parent = self.topology.parent[1:]
        gap = np.maximum(
            np.abs(start - self.position_mm[parent]).max(axis=1), np.abs(end - self.position_mm[1:]).max(axis=1)
        )
        scale = 1e-9 * max(1.0, float(np.abs(points).max()))
        _refuse(np.concatenate(([False], gap > scale)), "segments have a polyline that misses its nodes", "segment")
        object.__setattr__(self, "polyline_mm", points)
        object.__setattr__(self, "polyline_offset", offset)

    @property
    def parent(self) -> np.ndarray:
        return self.topology.parent

    @property
    def n_nodes(self) -> int:
        return self.topology.n_nodes

    @property
    def n_segments(self) -> int:
        return self.topology.n_segments

    @cached_property
    def chord_mm(self) -> np.ndarray:
        """(N,) straight distance between the ends of each segment; entry 0 is 0."""
        chord = np.zeros(self.n_nodes)
        step = self.position_mm[1:] - self.position_mm[self.parent[1:]]
        chord[1:] = np.sqrt((step**2).sum(axis=1))
        chord.setflags(write=False)
        return chord

    @cached_property
    def length_mm(self) -> np.ndarray:
        """(N,) length of each segment along its centreline; entry 0 is 0."""
        if self.polyline_mm is None or self.polyline_offset is None:
            return self.chord_mm
        steps = np.sqrt((np.diff(self.polyline_mm, axis=0) ** 2).sum(axis=1))
        along = np.concatenate(([0.0], np.cumsum(steps)))
        length = np.zeros(self.n_nodes)
        length[1:] = along[self.polyline_offset[2:] - 1] - along[self.polyline_offset[1:-1]]
        length.setflags(write=False)
        return length

    def polyline(self, segment: int) -> np.ndarray:
        """(K, 3) the points of a segment's centreline, proximal end first."""
        if self.polyline_mm is None or self.polyline_offset is None:
            return self.position_mm[[self.parent[segment], segment]]
        return self.polyline_mm[self.polyline_offset[segment] : self.polyline_offset[segment + 1]]

    @property
    def volume_mm3(self) -> float:
        """Sum of ``pi r^2 l`` over the segments."""
        return float(np.pi * (self.radius_mm[1:] ** 2 * self.length_mm[1:]).sum())

    def with_columns(self, **columns: np.ndarray) -> Tree:
        """A copy that carries these columns too."""
        return replace(self, columns={**self.columns, **columns})


def _refuse(bad: np.ndarray, what: str, kind: str) -> None:
    ids = np.flatnonzero(bad)
    if ids.size:
        raise InputError(f"{ids.size} {what} (first: {kind} {ids[0]}); mend the input or drop them")
