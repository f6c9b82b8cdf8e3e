"""What was checked of the trees in a report, and with what outcome."""

from __future__ import annotations

from typing import Any

from vascval.core.tree import Tree
from vascval.core.validation import Check, Claims, checks
from vascval.report.formats import NONE, count, measure
from vascval.report.page import Cell, Section, Table, Text
from vascval.report.subject import Subject

_MEANING = {
    "no-segments": "there is a tree",
    "zero-radius": "every segment has a thickness",
    "zero-length": "every segment has a length",
    "single-child": "something branches at every inner node",
    "flow-balance": "what flows in flows out",
    "pressure-rise": "pressure falls along every segment",
    "pressure-drop": "pressure drops are those between the ends",
    "murray": "Murray's law with the exponent that the tree was made with",
    "terminal-pressure": "one pressure at all terminals",
}
_PHYSICAL = ("flow-balance", "pressure-rise", "pressure-drop", "murray", "terminal-pressure")


def section(subject: Subject) -> Section:
    """A table for each tree: rule, places looked at, places that break it, largest relative error and its limit."""
    blocks: list[Any] = []
    for side, analysis in subject.measured:
        found = checks(analysis.tree, claimed(analysis.tree))
        head = [Cell("check", "head"), Cell("looked at"), Cell("broken"), Cell("largest error"), Cell("limit")]
        blocks.append(Table(f"{side.label}, as measured: {_outcome(found)}.", [head], [_row(check) for check in found]))
        made = {check.rule for check in found}
        missing = [_MEANING[rule] for rule in _PHYSICAL if rule not in made]
        if missing:
            blocks.append(
                Text(f"Not checked, as the tree carries or claims nothing to check: {'; '.join(missing)}.", "note")
            )
    return Section("checks", "Checks", blocks or [Text("There is no measured tree to check.", "empty")])


def claimed(tree: Tree) -> Claims:
    """What a tree grown by this program is said to hold, by its own record; nothing for any other.

    Radii given by a root tree are exempt from Murray's law and cannot be told apart here: then it is not claimed.
    """
    record = tree.meta.get("provenance")
    config = record.get("config") if isinstance(record, dict) else None
    if not isinstance(config, dict) or not isinstance(config.get("perfusion"), dict):
        return Claims()
    gamma, geometry = config.get("gamma"), config.get("geometry")
    one = config.get("root_tree") is None and not (isinstance(geometry, dict) and geometry.get("gamma_by_generation"))
    if not one or not isinstance(gamma, int | float) or not 1.0 <= gamma <= 10.0:  # it may come from elsewhere
        return Claims(equal_pressure=True)
    return Claims(float(gamma), equal_pressure=True)


def _outcome(found: list[Check]) -> str:
    broken = sum(not check.holds for check in found)
    return f"{len(found)} checks, " + (f"{broken} of them not passed" if broken else "all passed")


def _row(check: Check) -> list[Cell]:
    sized = check.worst is not None
    return [
        Cell(_MEANING[check.rule], "head"),
        Cell(f"{count(check.n_checked)} {check.subject}"),
        Cell(count(len(check.ids)) if check.ids else "none"),
        Cell(measure(check.worst) if sized else NONE),
        Cell(measure(check.limit) if sized else NONE),
    ]
