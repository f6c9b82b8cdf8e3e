"""Topology as a stage of making a tree: once, where the grown tree has the size for it (Algorithm 1 of the paper)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import astuple, replace

import numpy as np

from generator.config import Config
from generator.domain import Domain
from generator.growth.root_tree import RootTree
from generator.kept import below, fits, with_prefix
from generator.topology.annealing import Annealing, AnnealingStep, anneal
from vascval.core.errors import InputError
from vascval.core.threads import threads

_RECORDED = 10_000


class TopologyStage:
    """What a configuration asks of the topology.

    Trees come and go as ``parent`` and ``position_mm`` with the root tree's nodes first. Viscosity counts as constant,
    and the branching exponent as the same everywhere. ``history`` has the steps of the first chain; steps shorter than
    a ten-thousandth of it are joined, so that it stays small however long the search.
    """

    def __init__(self, config: Config, domain: Domain, root_tree: RootTree, rng: np.random.Generator) -> None:
        self.config, self.domain, self.root_tree = config, domain, root_tree
        self._rngs = rng.spawn(config.topology.chains)
        self.history: list[AnnealingStep] = []
        self._chains: list[Annealing] = []

    @property
    def begun(self) -> bool:
        return bool(self._chains)

    @property
    def tests(self) -> int:
        """Topologies tried so far, by all chains."""
        return sum(chain.n_tests for chain in self._chains)

    @property
    def target(self) -> int:
        """Topologies to be tried by all chains."""
        return self.config.topology.tests * self.config.topology.chains

    @property
    def best_mm3(self) -> float:
        """Volume of the best tree so far, without the root tree's."""
        return min(chain.best_mm3 for chain in self._chains)

    def search(
        self, parent: np.ndarray, position_mm: np.ndarray, resume: dict[str, np.ndarray] | None = None
    ) -> Iterator[AnnealingStep]:
        """Anneal all chains; the best tree is :meth:`best` afterwards, or when left off.

        :param resume: what :meth:`state` gave of a search that began with the same tree.
        :raises InputError: when that is not sound.
        """
        options, shortest = self.config.topology.options(), self.config.geometry.l_min_mm
        self._chains = [
            Annealing(
                parent, position_mm, self.root_tree, self.config.flow(), space=self.domain.space, options=options,
                shortest_mm=shortest, rng=rng,
            )
            for rng in self._rngs
        ]  # fmt: skip
        if resume is not None:
            self._restore(resume)
        for step in anneal(self._chains, threads()):
            self._record(step)
            yield step

    def _record(self, step: AnnealingStep) -> None:
        if self.history and step.n_tests <= self.history[-1].n_tests:
            return  # of another chain: those follow the first one where there is one thread
        before = self.history[-2].n_tests if len(self.history) > 1 else 0
        if self.history and self.history[-1].n_tests - before < step.n_target / _RECORDED:
            step = replace(step, n_accepted=step.n_accepted + self.history.pop().n_accepted)
        self.history.append(step)

    def best(self) -> tuple[np.ndarray, np.ndarray]:
        """``parent`` and ``position_mm`` of the best tree found."""
        return min(self._chains, key=lambda chain: chain.best_mm3).arrays()

    def state(self, *, done: bool = False) -> dict[str, np.ndarray]:
        """All that decides how a search goes on that has begun, as plain arrays that are copies; the history alone of
        one that is ``done``."""
        kept = {"history": np.array([astuple(step) for step in self.history], np.float64).reshape(-1, 6)}
        for number, chain in enumerate([] if done else self._chains):
            kept |= with_prefix(f"chain{number}", chain.state())
        return kept

    def recall(self, kept: dict[str, np.ndarray]) -> None:
        """Take over the history.

        :raises InputError: when there is none that is sound.
        """
        if not fits(kept, {"history": ("float64", (None, 6))}):
            raise InputError("lacks a part of the search for topologies; begin the run anew")
        self.history = [
            AnnealingStep(int(tests), int(target), int(accepted), *numbers)
            for tests, target, accepted, *numbers in kept["history"].tolist()
        ]

    def _restore(self, kept: dict[str, np.ndarray]) -> None:
        self.recall(kept)
        for number, chain in enumerate(self._chains):
            chain.restore(below(f"chain{number}", kept))
