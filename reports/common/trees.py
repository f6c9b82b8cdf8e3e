"""The trees that studies are about, each made once however many studies ask for it."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import pandas as pd

from generator.config import load
from generator.framework import Run
from vascval.comparison import compare
from vascval.core.tree import Tree
from vascval.morphometry import Analysis, analyze

TRUNK = 4
"""Generations whose places are compared: those that decide the shape of the whole tree."""


@dataclass(frozen=True, eq=False)
class Made:
    """A tree, processor seconds of it all and of each stage by name, problems solved and topologies tested.

    Seconds of a processor, of all threads together, are what a busy machine does not change. Growth and geometry, which
    take turns, share theirs in the proportion of their wall seconds.
    """

    tree: Tree
    cpu_s: float
    stage_s: Mapping[str, float]
    solves: int
    tests: int

    @property
    def volume_mm3(self) -> float:
        return self.tree.volume_mm3


def made(preset: str, **changes: object) -> Made:
    """The tree of a preset with changed keys; ``__`` in a key stands for the dot, as in ``topology__tests=1000``."""
    every = {"seed": 1, "method": "cco", **changes}
    return _made(preset, tuple(f"{key.replace('__', '.')}={_text(every[key])}" for key in sorted(every)))


@lru_cache(maxsize=256)
def _made(preset: str, changes: tuple[str, ...]) -> Made:
    _compile()
    return _run(preset, changes)


def _run(preset: str, changes: tuple[str, ...]) -> Made:
    began = now = time.process_time()
    searched, before = 0.0, ""
    run = Run.of(load(preset, changes))
    for name, _ in run.steps():
        then, now = now, time.process_time()
        searched += now - then if "topology" in (name, before) else 0.0
        before = name
    tree = run.tree()
    cpu = time.process_time() - began
    wall = {stage.name: stage.seconds for stage in run.stages if stage.name != "topology"}
    share = (cpu - searched) / max(sum(wall.values()), 1e-9)
    stages = {name: seconds * share for name, seconds in wall.items()} | {"topology": searched}
    solves, tests = (sum(getattr(stage, name) or 0 for stage in run.stages) for name in ("solves", "tests"))
    return Made(tree, cpu, stages, solves, tests)


@lru_cache(maxsize=1)
def _compile() -> None:
    """Compiled kernels are loaded once, on a small tree, so that no study's seconds hold it."""
    for preset in ("karch-box", "portal-vein"):
        small = ("n_terminals=60", "topology.at=40", "topology.tests=200")
        for method in ("geometry", "full"):
            _run(preset, (f"method={method}", *small))


def _text(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (tuple, list)):
        return ",".join(map(str, value))
    return str(value)


def write_terminals(tree: Tree, path: Path) -> Path:
    """The root and the terminals of a tree as ``terminals_file`` wants them."""
    points = tree.position_mm[[0, *tree.topology.terminals]]
    pd.DataFrame(points, columns=["x_mm", "y_mm", "z_mm"]).to_csv(path, index=False)
    return path


@lru_cache(maxsize=64)
def measured(tree: Tree) -> Analysis:
    """All measures of a tree."""
    return analyze(tree, source="tree")


def likeness(first: Tree, second: Tree, generations: int = TRUNK) -> tuple[float, float]:
    """How much of the first tree's trunk lies on the second, and how much a trunk laid at random would.

    Shares of the length of the first generations that lie within 1 % of the diagonal of the tree (or within the
    local radius) of vessels of like generation, :func:`vascval.comparison.compare`.
    """
    place = compare(measured(first), [measured(second)], territory_generations=1, territory_points=200)
    rows = place.location[0].generations
    rows = rows[rows["generation"] <= generations]
    length = rows["cast_length_mm"]
    found, chance = (
        float((rows[name] * length).sum() / length.sum()) for name in ("cast_matched_share", "cast_chance_share")
    )
    return found, chance


def machine() -> str:
    """What the seconds were measured on."""
    model = platform.processor() or platform.machine()
    listed = Path("/proc/cpuinfo")
    if listed.exists():
        names = [line.partition(":")[2].strip() for line in listed.read_text().splitlines() if "model name" in line]
        model = names[0] if names else model
    return f"{model} with {os.cpu_count()} cores"
