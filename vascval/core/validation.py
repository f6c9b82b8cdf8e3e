"""Checks that every tree should pass before it is measured or written; each finding names the offending ids."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from vascval.core.errors import ComputationError, InputError
from vascval.core.tree import Tree

_LIMIT = 1e-9
"""Largest relative error of what holds but for round-off; grown and optimised trees stay below 1e-14."""


@dataclass(frozen=True)
class Finding:
    """A rule that a tree breaks: ``rule`` is its short name, ``ids`` the nodes or segments, ``message`` a sentence."""

    rule: str
    ids: tuple[int, ...]
    message: str


@dataclass(frozen=True, eq=False)
class Claims:
    """What a tree is said to hold by those who made it.

    * ``gamma``: Murray's law with this exponent at every inner junction, but those at ``given`` nodes;
    * ``equal_pressure``: one pressure at all terminals;
    * ``given``: (N,) bool, nodes of a root tree, whose radii were given; at its ends a single vessel goes on.
    """

    gamma: float | None = None
    equal_pressure: bool = False
    given: np.ndarray | None = None


@dataclass(frozen=True)
class Check:
    """A rule, looked into at ``n_checked`` places: ``ids`` break it. ``worst`` is the largest error, at most ``limit``
    where it holds; both are ``None`` where the rule is no matter of size."""

    rule: str
    subject: str
    n_checked: int
    ids: tuple[int, ...]
    worst: float | None = None
    limit: float | None = None
    said: str = field(default="", compare=False)

    @property
    def holds(self) -> bool:
        return not self.ids


def checks(tree: Tree, claims: Claims | None = None) -> list[Check]:
    """All checks that can be made of a tree whose arrays are consistent (see :class:`~vascval.core.tree.Tree`).

    * ``no-segments``: the tree is a bare root point; nothing else is checked then;
    * ``zero-radius``: segments without thickness;
    * ``zero-length``: segments whose two ends coincide;
    * ``single-child``: inner nodes (not the root) with one child, at which nothing branches: orders and ratios do
      not need them and counts of segments are inflated by them; ``given`` nodes may have one;
    * ``flow-balance``: where flows are carried, nodes whose inflow and outflow differ, relative to the inflow;
    * ``pressure-rise``: where pressures are carried, segments along which the pressure rises;
    * ``pressure-drop``: where pressures and drops are carried, segments whose drop is not that between their ends,
      relative to the largest pressure difference in the tree;
    * ``murray``, ``terminal-pressure``: what is claimed; relative to the radius to the power gamma, and to the largest
      pressure difference.

    A value that is not a number breaks every rule that it enters.
    """
    if tree.n_segments == 0:
        return [Check("no-segments", "tree", 1, (0,), said="the tree has no segment, only a root point")]
    claims = claims or Claims()
    inner = np.arange(tree.n_nodes) > 0
    children = tree.topology.n_children
    junction = inner & (children > 0)
    branching = junction if claims.given is None else junction & ~claims.given
    found = [
        Check("no-segments", "tree", 1, ()),
        _plain("zero-radius", "segments", inner, ~(tree.radius_mm > 0), "segments have radius 0"),
        _plain("zero-length", "segments", inner, ~(tree.length_mm > 0), "segments have length 0"),
        _plain("single-child", "inner nodes", branching, children == 1, "inner nodes have a single child"),
    ]
    flow, pressure = tree.columns.get("flow_mm3_s"), tree.columns.get("pressure_pa")
    if flow is not None:
        error = np.abs(_sum_over_children(tree, flow) - flow) / np.abs(np.where(flow == 0, 1.0, flow))
        found.append(_sized("flow-balance", "junctions", junction, error, "nodes where inflow and outflow differ"))
    if pressure is not None:
        found += _of_pressure(tree, pressure, claims)
    if claims.gamma is not None:
        power = tree.radius_mm**claims.gamma
        error = np.abs(_sum_over_children(tree, power) - power) / np.where(power == 0, 1.0, power)
        said = f"junctions break Murray's law with exponent {claims.gamma:g}"
        found.append(_sized("murray", "junctions", branching, error, said))
    return found


def _of_pressure(tree: Tree, pressure: np.ndarray, claims: Claims) -> list[Check]:
    inner = np.arange(tree.n_nodes) > 0
    step = np.zeros(tree.n_nodes)
    step[1:] = pressure[tree.parent[1:]] - pressure[1:]
    range_pa = float(np.nanmax(pressure, initial=-np.inf) - np.nanmin(pressure, initial=np.inf))
    range_pa = range_pa if np.isfinite(range_pa) and range_pa > 0.0 else 1.0
    said = "segments along which the pressure rises or is not a number"
    found = [_plain("pressure-rise", "segments", inner, ~(step >= 0.0), said)]
    drop = tree.columns.get("pressure_drop_pa")
    if drop is not None:
        said = "segments whose pressure drop is not that between their ends"
        found.append(_sized("pressure-drop", "segments", inner, np.abs(drop - step) / range_pa, said))
    if claims.equal_pressure:
        ends = np.zeros(tree.n_nodes, dtype=bool)
        ends[tree.topology.terminals] = True
        error = np.abs(pressure - np.median(pressure[ends])) / range_pa
        said = "terminals whose pressure is not that of the others"
        found.append(_sized("terminal-pressure", "terminals", ends, error, said))
    return found


def _sum_over_children(tree: Tree, values: np.ndarray) -> np.ndarray:
    return np.bincount(tree.parent[1:], weights=values[1:], minlength=tree.n_nodes)


def _plain(rule: str, subject: str, where: np.ndarray, bad: np.ndarray, said: str) -> Check:
    ids = np.flatnonzero(where & bad)
    return Check(rule, subject, int(where.sum()), tuple(ids.tolist()), said=_counted(ids, said))


def _sized(rule: str, subject: str, where: np.ndarray, error: np.ndarray, said: str) -> Check:
    ids = np.flatnonzero(where & ~(error <= _LIMIT))
    worst = float(error[where].max(initial=0.0))
    return Check(rule, subject, int(where.sum()), tuple(ids.tolist()), worst, _LIMIT, _counted(ids, said))


def _counted(ids: np.ndarray, said: str) -> str:
    return f"{ids.size} {said} (first: {ids[0]})" if ids.size else ""


def findings(tree: Tree, claims: Claims | None = None) -> list[Finding]:
    """Everything that is wrong with a tree: what of :func:`checks` does not hold."""
    return [Finding(check.rule, check.ids, check.said) for check in checks(tree, claims) if not check.holds]


def require_valid(tree: Tree, *, allow: frozenset[str] = frozenset()) -> Tree:
    """The tree itself, or :class:`~vascval.core.errors.InputError` with all findings whose rule is not in ``allow``."""
    bad = [finding.message for finding in findings(tree) if finding.rule not in allow]
    if bad:
        raise InputError(f"the tree is not valid: {'; '.join(bad)}; mend it")
    return tree


def require_made_well(tree: Tree, claims: Claims | None = None) -> None:
    """For a tree that was made here: it holds to all rules and claims, or what made it has failed.

    :raises ComputationError: with all findings; such a tree is not to be written.
    """
    bad = [finding.message for finding in findings(tree, claims)]
    if bad:
        raise ComputationError(
            f"the tree that was made is not valid and not written: {'; '.join(bad)}; please report how it was made"
        )
