"""Topology as a stage of making a tree: once, where the grown tree has the size for it (Algorithm 1 of the paper)."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np

from generator.config import Config
from generator.domain import Domain
from generator.growth.root_tree import RootTree
from generator.topology.annealing import Annealing, AnnealingStep, anneal


class TopologyStage:
    """What a configuration asks of the topology.

    Trees come and go as ``parent`` and ``position_mm`` with the root tree's nodes first. Viscosity counts as constant,
    and the branching exponent as the same everywhere. ``history`` has the steps of the chain that was shown.
    """

    def __init__(self, config: Config, domain: Domain, root_tree: RootTree, rng: np.random.Generator) -> None:
        self.config, self.domain, self.root_tree, self.rng = config, domain, root_tree, rng
        self.tests = 0
        self.history: list[AnnealingStep] = []
        self._best: Annealing | None = None

    def search(self, parent: np.ndarray, position_mm: np.ndarray) -> Iterator[AnnealingStep]:
        """Anneal all chains; the best tree is :meth:`best` afterwards, or when left off."""
        options = self.config.topology.options()
        chains = [
            Annealing(
                parent, position_mm, self.root_tree, self.config.flow(), space=self.domain.space, options=options,
                rng=rng,
            )
            for rng in self.rng.spawn(options.chains)
        ]
        self._best = chains[0]
        for step in anneal(chains, os.cpu_count() or 1):
            self.history.append(step)
            yield step
        self._best = min(chains, key=lambda chain: chain.best_mm3)
        self.tests = sum(chain.n_tests for chain in chains)

    def best(self) -> tuple[np.ndarray, np.ndarray]:
        """``parent`` and ``position_mm`` of the best tree found."""
        assert self._best is not None
        return self._best.arrays()
