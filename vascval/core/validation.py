"""Checks that every tree should pass before it is measured or written; each finding names the offending ids."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vascval.core.errors import InputError
from vascval.core.tree import Tree


@dataclass(frozen=True)
class Finding:
    """A rule that a tree breaks: ``rule`` is its short name, ``ids`` the nodes or segments, ``message`` a sentence."""

    rule: str
    ids: tuple[int, ...]
    message: str


def findings(tree: Tree, *, pressure_tolerance: float = 1e-9) -> list[Finding]:
    """Everything that is wrong with a tree whose arrays are already consistent (see :class:`~vascval.core.tree.Tree`).

    * ``no-segments``: the tree is a bare root point;
    * ``zero-radius``: segments without thickness;
    * ``zero-length``: segments whose two ends coincide;
    * ``single-child``: inner nodes (not the root) with one child, at which nothing branches: orders and ratios do
      not need them and counts of segments are inflated by them;
    * ``flow-balance``: where flows are carried, nodes whose inflow and outflow differ by more than
      ``pressure_tolerance`` of the inflow;
    * ``pressure-rise``: where pressures are carried, segments along which the pressure rises.
    """
    found: list[Finding] = []

    def note(rule: str, bad: np.ndarray, sentence: str) -> None:
        ids = np.flatnonzero(bad)
        if ids.size:
            found.append(Finding(rule, tuple(ids.tolist()), f"{ids.size} {sentence} (first: {ids[0]})"))

    if tree.n_segments == 0:
        return [Finding("no-segments", (0,), "the tree has no segment, only a root point")]
    inner = np.arange(tree.n_nodes) > 0
    note("zero-radius", inner & (tree.radius_mm <= 0), "segments have radius 0")
    note("zero-length", inner & (tree.length_mm <= 0), "segments have length 0")
    note("single-child", inner & (tree.topology.n_children == 1), "inner nodes have a single child")
    flow = tree.columns.get("flow_mm3_s")
    if flow is not None:
        outflow = np.bincount(tree.parent[1:], weights=flow[1:], minlength=tree.n_nodes)
        junction = inner & (tree.topology.n_children > 0)
        unbalanced = ~(np.abs(outflow - flow) <= pressure_tolerance * np.abs(flow))
        note("flow-balance", junction & unbalanced, "nodes where inflow and outflow differ")
    pressure = tree.columns.get("pressure_pa")
    if pressure is not None:
        rise = np.zeros(tree.n_nodes, dtype=bool)
        rise[1:] = ~(pressure[1:] <= pressure[tree.parent[1:]])
        note("pressure-rise", rise, "segments along which the pressure rises or is not a number")
    return found


def require_valid(tree: Tree, *, allow: frozenset[str] = frozenset()) -> Tree:
    """The tree itself, or :class:`~vascval.core.errors.InputError` with all findings whose rule is not in ``allow``."""
    bad = [finding.message for finding in findings(tree) if finding.rule not in allow]
    if bad:
        raise InputError("the tree is not valid: " + "; ".join(bad))
    return tree
