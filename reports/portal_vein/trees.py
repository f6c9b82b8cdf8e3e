"""The trees of the portal vein: of each seed one by growth alone and three optimised ones."""

from __future__ import annotations

from functools import lru_cache

from generator.config import load
from generator.framework import Run
from generator.geometry.stage import GeometryStage
from reports.common.trees import made
from vascval.core.tree import Tree

PRESET = "portal-vein"
GROWN, BEST, ONCE, PAPERS = "growth alone", "optimised", "contracted once", "settings of the paper"
_PAPERS = (
    "topology.tests=7500", "topology.chains=1", "n_connections=30", "growth.merge_mm=0.2", "geometry.contract=false"
)  # fmt: skip
"""As near to the paper as can be known; by ``contract`` see :func:`optimised`."""


@lru_cache(maxsize=2)
def trees(n_terminals: int, seeds: tuple[int, ...], changes: tuple[str, ...]) -> dict[str, list[Tree]]:
    """By kind, the trees of the seeds; ``changes`` are those of the optimised trees' configuration."""
    pairs = [optimised(n_terminals, seed, changes) for seed in seeds]
    return {
        GROWN: [made(PRESET, n_terminals=n_terminals, seed=seed).tree for seed in seeds],
        BEST: [best for best, _ in pairs],
        ONCE: [once for _, once in pairs],
        PAPERS: [_run(n_terminals, seed, (*_PAPERS, *changes)).tree() for seed in seeds],
    }


def optimised(n_terminals: int, seed: int, changes: tuple[str, ...]) -> tuple[Tree, Tree]:
    """The tree of the whole framework, and the same without what is done by default after the last programme.

    By default segments shorter than their diameter are contracted, the geometry is optimised again and junctions are
    split where that pays. The second tree has none of that: measuring contracts it, once, which is how Algorithm 1
    of the paper ends.
    """
    run = _run(n_terminals, seed, changes)
    plain = run.config.model_copy(update={"geometry": run.config.geometry.model_copy(update={"contract": False})})
    stage = GeometryStage(plain, run.domain, run.growth.root_tree)
    return run.tree(), stage.finish(*run.growth.snapshot()).tree


def _run(n_terminals: int, seed: int, changes: tuple[str, ...]) -> Run:
    run = Run.of(load(PRESET, ["method=full", f"n_terminals={n_terminals}", f"seed={seed}", *changes]))
    for _ in run.steps():
        pass
    return run
