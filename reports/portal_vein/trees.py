"""The trees of the portal vein: of each seed one by growth alone and two optimised ones, alike but for their end."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from generator.config import load
from generator.framework import Run
from generator.geometry.stage import GeometryStage
from reports.common.trees import made
from vascval.core.tree import Tree

PRESET = "portal-vein"
GROWN, BEST, ONCE = "growth alone", "optimised", "contracted once"


def trees(n_terminals: int, seeds: Sequence[int], changes: tuple[str, ...]) -> dict[str, list[Tree]]:
    """By kind, the trees of the seeds; ``changes`` are those of the optimised trees' configuration."""
    pairs = [optimised(n_terminals, seed, changes) for seed in seeds]
    return {
        GROWN: [made(PRESET, n_terminals=n_terminals, seed=seed).tree for seed in seeds],
        BEST: [best for best, _ in pairs],
        ONCE: [once for _, once in pairs],
    }


@lru_cache(maxsize=64)
def optimised(n_terminals: int, seed: int, changes: tuple[str, ...]) -> tuple[Tree, Tree]:
    """The tree of the whole framework, and the same without what is done by default after the last programme.

    By default segments shorter than their diameter are contracted, the geometry is optimised again and junctions are
    split where that pays. The second tree has none of that: measuring contracts it, once, which is how Algorithm 1
    of the paper ends.
    """
    keys = ["method=full", f"n_terminals={n_terminals}", f"seed={seed}", *changes]
    run = Run.of(load(PRESET, keys))
    for _ in run.steps():
        pass
    plain = GeometryStage(load(PRESET, [*keys, "geometry.contract=false"]), run.domain, run.growth.root_tree)
    return run.tree(), plain.finish(*run.growth.snapshot()).tree
