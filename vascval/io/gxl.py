"""GXL: graphs in XML as VascuSynth and OpenCCO write them, radii on the edges and positions in voxels."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vascval.core.errors import InputError
from vascval.core.units import MM_PER
from vascval.io import _graph_kernels as kernels
from vascval.io import xml_guard
from vascval.io.assembly import Sketch


def read_gxl(path: Path, unit: str | None) -> tuple[Sketch, str]:
    """What a GXL file says about a tree, in millimetres; and the unit that it was in (voxels are taken as mm).

    The root is the node that no edge leads to; the label ``root node`` decides only where that leaves a choice
    (OpenCCO labels the first branching point so).

    :raises InputError: when it is no GXL graph, or positions, radii or nodes are missing.
    """
    graph = _Graph(path)
    xml_guard.parse(path, graph.start, graph.end, graph.text)
    if not graph.is_gxl:
        raise InputError("is XML but no GXL graph; give a GXL file of VascuSynth or OpenCCO")
    if not graph.nodes or not graph.edges:
        raise InputError("its graph has no nodes or no edges; a tree needs both")
    index = {name: i for i, name in enumerate(graph.nodes)}
    lost = [name for edge in graph.edges for name in edge[:2] if name not in index]
    if lost:
        raise InputError(f"{len(lost)} ends of edges are no nodes (first: {lost[0]!r}); the file is damaged")
    points = np.array(list(graph.nodes.values()), dtype=np.float64)
    if not np.isfinite(points).all():
        raise InputError("a node has a position that is not finite; mend it")
    edges = np.array([[index[a], index[b]] for a, b, _ in graph.edges], dtype=np.int64)
    radius = np.array([edge[2] for edge in graph.edges])
    guesses: list[str] = []
    if unit is None:
        unit = "mm"
        guesses.append("GXL gives no unit, positions are in voxels of unknown size; taken as millimetres")
    roots = _roots(edges, len(points), [index[name] for name in graph.labelled], guesses)
    return Sketch(points * MM_PER[unit], edges, radius * MM_PER[unit], roots, guesses), unit


def _roots(edges: np.ndarray, n_points: int, labelled: list[int], guesses: list[str]) -> list[int]:
    fed = np.zeros(n_points, dtype=bool)
    fed[edges[:, 1]] = True
    sources = np.flatnonzero(~fed).tolist()
    kept, _ = kernels.spanning_forest(edges, np.arange(len(edges)), n_points)
    if len(sources) != n_points - np.count_nonzero(kept):
        return labelled
    if labelled and set(labelled) != set(sources):
        guesses.append("the root is the node that no edge leads to, not the one labelled 'root node'")
    return sources


class _Graph:
    """Collects nodes (name: position), edges (from, to, radius) and the names of nodes labelled as root."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.is_gxl = False
        self.nodes: dict[str, list[float]] = {}
        self.edges: list[tuple[str, str, float]] = []
        self.labelled: list[str] = []
        self._item: dict[str, str] | None = None
        self._attribute = ""
        self._values: dict[str, list[str]] = {}
        self._characters = ""

    def start(self, name: str, attributes: dict[str, str]) -> None:
        self._characters = ""
        if name == "gxl":
            self.is_gxl = True
        elif name in ("node", "edge"):
            self._item, self._values = attributes, {}
        elif name == "attr":
            self._attribute = attributes.get("name", "").strip()

    def text(self, characters: str) -> None:
        self._characters += characters

    def end(self, name: str) -> None:
        if name in ("float", "int", "string") and self._item is not None:
            self._values.setdefault(self._attribute, []).append(self._characters.strip())
        elif name == "node" and self._item is not None:
            self._end_node(self._item.get("id", ""))
        elif name == "edge" and self._item is not None:
            ends = (self._item.get("from", ""), self._item.get("to", ""))
            (radius,) = self._numbers("radius", 1, f"the edge from {ends[0]!r} to {ends[1]!r}")
            self.edges.append((*ends, radius))
            self._item = None
        self._characters = ""

    def _end_node(self, name: str) -> None:
        if name in self.nodes:
            raise InputError(f"node {name!r} is there twice; the file is damaged")
        self.nodes[name] = self._numbers("position", 3, f"node {name!r}")
        if self._values.get("nodeType", [""])[0].lower().startswith("root"):
            self.labelled.append(name)
        self._item = None

    def _numbers(self, attribute: str, count: int, owner: str) -> list[float]:
        words = self._values.get(attribute, [])
        try:
            numbers = [float(word) for word in words]
        except ValueError:
            raise InputError(f"{owner} has a {attribute} {words} that is no number; the file is damaged") from None
        if len(numbers) != count:
            raise InputError(f"{owner} has {len(numbers)} values for its {attribute}, not {count}; the file is damaged")
        return numbers
