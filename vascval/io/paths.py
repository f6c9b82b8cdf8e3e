"""Overlapping paths: centrelines given as one polyline from the root to each tip, as VMTK writes them.

The beginnings that they share are there as many times as there are paths, and not quite at the same places. Each path
is followed from the root along those before it for as long as it stays within a quarter of the vessel's radius of one
of them (or VMTK's group says that it is the same vessel), and branches off there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vascval.io import _graph_kernels as kernels
from vascval.io.polydata import PolyData

_WITHIN_RADII = 0.25


@dataclass(frozen=True)
class Paths:
    """``ids``: the points of all paths in turn, path ``i`` being ``ids[offset[i]:offset[i + 1]]``, root first;
    ``group``: for each of them the vessel by VMTK's groups, -1 where unknown."""

    ids: np.ndarray
    offset: np.ndarray
    group: np.ndarray


def overlapping_paths(data: PolyData) -> Paths | None:
    """The paths of a file, or None if its lines are none: two or more, of three or more points, that all begin (or
    all end) at one place. Paths that VMTK has cut into tracts are put together again by their numbers."""
    size = np.diff(data.offsets)
    if len(size) < 2 or np.median(size) < 3 or size.min() < 2:
        return None
    lines = np.split(data.connectivity, data.offsets[1:-1])
    groups = np.split(np.repeat(_group_of_lines(data), size), data.offsets[1:-1])
    tracts = _tracts(data)
    if tracts is not None:
        lines = [np.concatenate([lines[i] for i in run]) for run in tracts]
        groups = [np.concatenate([groups[i] for i in run]) for run in tracts]
    if len(lines) < 2:
        return None
    extent = float(np.ptp(data.points, axis=0).max())
    if not _at_one_place(data.points[[line[0] for line in lines]], extent):
        if not _at_one_place(data.points[[line[-1] for line in lines]], extent):
            return None
        lines, groups = [line[::-1] for line in lines], [group[::-1] for group in groups]
    offset = np.concatenate(([0], np.cumsum([len(line) for line in lines])))
    return Paths(np.concatenate(lines), offset, np.concatenate(groups))


def merged_edges(paths: Paths, points: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, int]:
    """(E, 2) pieces between the points of the file, each vessel once, and the root point.

    :param radius: (P,) radius at each point of the file.
    """
    extent = float(np.ptp(points, axis=0).max())
    tolerance = np.maximum(_WITHIN_RADII * radius[paths.ids], 1e-6 * extent)
    stands = kernels.merge_paths(points[paths.ids], paths.offset, paths.group, tolerance)
    first = np.zeros(len(paths.ids), dtype=bool)
    first[paths.offset[:-1]] = True
    later = np.flatnonzero(~first)
    new = later[stands[later] == later]
    edges = np.stack((paths.ids[stands[new - 1]], paths.ids[new]), axis=1)
    return edges, int(paths.ids[0])


def _at_one_place(points: np.ndarray, extent: float) -> bool:
    return bool(np.ptp(points, axis=0).max() <= 1e-4 * extent)


def _group_of_lines(data: PolyData) -> np.ndarray:
    """VMTK's group of each line; -1 in bifurcations (blanked), where one group holds diverging paths."""
    n = len(data.offsets) - 1
    group = data.cell_data.get("GroupIds")
    if group is None or group.ndim != 1:
        return np.full(n, -1)
    blanking = data.cell_data.get("Blanking", np.zeros(n))
    return np.where(blanking == 0, group, -1)


def _tracts(data: PolyData) -> list[np.ndarray] | None:
    """For each of VMTK's centre lines the lines of the file that make it up, in order; None without such numbers."""
    centreline, tract = data.cell_data.get("CenterlineIds"), data.cell_data.get("TractIds")
    if centreline is None or tract is None or centreline.ndim != 1 or tract.ndim != 1:
        return None
    order = np.lexsort((tract, centreline))
    return np.split(order, np.flatnonzero(np.diff(centreline[order])) + 1)
