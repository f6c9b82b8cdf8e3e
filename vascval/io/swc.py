"""SWC: one point per row (number, type, x, y, z, radius, number of the parent or -1)."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import vascval
from vascval.core.errors import InputError
from vascval.core.tree import Tree
from vascval.core.units import MM_PER
from vascval.io import _graph_kernels as kernels
from vascval.io.assembly import Sketch, edge_radius
from vascval.io.atomic import atomic_file
from vascval.io.length_units import guess_unit, unit_named

_OF_SEGMENT = "# radius: of the segment that ends at each point"
_VESSEL = 3  # the type that published files of arteries use for every point but the root


def read_swc(path: Path, unit: str | None) -> tuple[Sketch, str]:
    """What an SWC file says about a tree, in millimetres; and the unit that it was in.

    SWC is in micrometres by its definition, but files of vessels are seldom: a comment ``# unit: mm`` counts, else the
    unit is guessed by size.

    :raises InputError: when the rows are not seven numbers, numbers are double, parents absent, or rows form a cycle.
    """
    comments, rows = _rows(path)
    number, parent = rows[:, 0], rows[:, 6]
    order = np.argsort(number, kind="stable")
    double = np.flatnonzero(np.diff(number[order]) == 0)
    if double.size:
        raise InputError(f"{double.size} points have a number twice (first: {number[order[double[0]]]:.0f}); mend it")
    child = np.flatnonzero(parent != -1)
    place = np.minimum(np.searchsorted(number[order], parent[child]), len(order) - 1)
    above = order[place]
    lost = child[number[above] != parent[child]]
    if lost.size:
        raise InputError(
            f"{lost.size} points have a parent that does not exist (first: point {number[lost[0]]:.0f}, parent "
            f"{parent[lost[0]]:.0f}); mend it"
        )
    if child.size == 0:
        raise InputError("no point has a parent; a tree needs points that are joined")
    edges = np.stack((above, child), axis=1).astype(np.int64)
    kept, _ = kernels.spanning_forest(edges, np.arange(len(edges)), len(rows))
    if not kept.all():
        on_cycle = child[~kept][0]
        raise InputError(f"its parents form a cycle (through point {number[on_cycle]:.0f}); mend it")
    guesses: list[str] = []
    points, radius = rows[:, 2:5], rows[:, 5]
    if unit is None:
        unit = _stated_unit(comments)
    if unit is None:
        unit, why = guess_unit(points, radius)
        guesses.append(why)
    own = _OF_SEGMENT in comments
    scale = MM_PER[unit]
    of_edges = radius[child] if own else edge_radius(edges, radius[edges])
    roots = np.flatnonzero(parent == -1).tolist()
    return Sketch(points * scale, edges, of_edges * scale, roots, guesses), unit


def _rows(path: Path) -> tuple[list[str], np.ndarray]:
    """The comments, and the rows (P, 7) of numbers."""
    try:
        lines = [line.strip() for line in path.read_text(encoding="utf-8", errors="replace").splitlines()]
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror}); check its name") from error
    plain = [(i, line.translate(_SEPARATORS)) for i, line in enumerate(lines, start=1) if not line.startswith("#")]
    numbered = [(i, line) for i, line in plain if line.strip()]
    if not numbered:
        raise InputError("holds no points; the file is truncated or no SWC")
    try:
        rows = np.loadtxt([line for _, line in numbered], usecols=range(7), ndmin=2, comments="#")
    except ValueError:
        raise _what_is_wrong(numbered) from None
    ids = rows[:, [0, 6]]
    wrong = np.flatnonzero(~np.isfinite(rows).all(axis=1) | (ids != np.trunc(ids)).any(axis=1))
    if wrong.size:
        raise InputError(f"line {numbered[wrong[0]][0]} has a value that is not finite or a broken id; mend it")
    return [line for line in lines if line.startswith("#")], rows


_SEPARATORS = str.maketrans(",;", "  ")


def _what_is_wrong(numbered: list[tuple[int, str]]) -> InputError:
    """The error for the first line, of its number and text, that does not hold seven numbers."""
    for i, line in numbered:
        words = line.partition("#")[0].split()[:7]
        if len(words) < 7:
            return InputError(f"line {i} has {len(words)} columns; SWC has seven, the file is truncated or no SWC")
        try:
            [float(word) for word in words]
        except ValueError:
            break
    return InputError(f"line {i} holds something that is no number; the file is damaged or no SWC")


def _stated_unit(comments: list[str]) -> str | None:
    for line in comments:
        match = re.search(r"\bunits?\s*[:=]\s*(\S+)", line, re.IGNORECASE)
        if match and unit_named(match[1]):
            return unit_named(match[1])
    return None


def write_swc(tree: Tree, path: Path | str, provenance: Mapping[str, Any] | None = None) -> None:
    """The tree as SWC in millimetres, curved centrelines point by point; atomic, the same bytes for the same tree.

    The radius of each point is that of the segment that it lies on, which a comment says; so the file reads back as
    the same positions, radii and curves where every inner node branches. Other columns have no place in SWC.

    :raises InputError: when the tree has no segment or the place cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() != ".swc":
        raise InputError(f"{path}: an SWC file ends in .swc; rename it")
    if tree.n_segments == 0:
        raise InputError(f"{path}: the tree has no segment; there is nothing to write")
    comments = [f"# vascval {vascval.__version__}", "# unit: mm", _OF_SEGMENT]
    if provenance is not None:
        comments.append(f"# provenance: {json.dumps(dict(provenance), sort_keys=True)}")
    rows = [_row(1, tree.position_mm[0], tree.radius_mm[0], -1)]
    node_number = np.ones(tree.n_nodes, dtype=np.int64)
    for segment in range(1, tree.n_nodes):
        before = int(node_number[tree.parent[segment]])
        for point in tree.polyline(segment)[1:]:
            number = len(rows) + 1
            rows.append(_row(number, point, tree.radius_mm[segment], before))
            before = number
        node_number[segment] = before
    with atomic_file(path) as aside:
        aside.write_text("\n".join([*comments, *rows]) + "\n", encoding="utf-8")


def _row(number: int, point: np.ndarray, radius: float, parent: int) -> str:
    x, y, z = point.tolist()
    return f"{number} {_VESSEL} {x!r} {y!r} {z!r} {float(radius)!r} {parent}"
