"""Topology as a stage of making a tree: once, where the grown tree has the size for it (Algorithm 1 of the paper)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import astuple, dataclass, replace

import numpy as np

from generator.config import Config
from generator.domain import Domain
from generator.growth.root_tree import RootTree
from generator.kept import below, fits, with_prefix
from generator.topology.annealing import Annealing, AnnealingStep, anneal, bytes_of
from generator.topology.crossing import cross
from generator.topology.state import NODE, SearchTree
from vascval.core.errors import InputError
from vascval.core.threads import threads

_RECORDED = 10_000
_COOLER = 0.2
"""Heat of further rounds, where the first is 1: the trunk stays, of which few are good, and all else is found anew."""
_CROSSINGS = 0.5
"""At most so many for each test of all chains, by the number of terminals: a part of the time that the tests take."""


@dataclass(frozen=True)
class Found:
    """A tree that was found: its volume without the root tree's, and its records."""

    best_mm3: float
    node: np.ndarray


class TopologyStage:
    """What a configuration asks of the topology.

    Trees come and go as ``parent`` and ``position_mm`` with the root tree's nodes first. Viscosity counts as constant,
    and the branching exponent as the same everywhere. ``history`` has the steps of the first chain; steps shorter than
    a ten-thousandth of it are joined, so that it stays small however long the search.
    """

    def __init__(self, config: Config, domain: Domain, root_tree: RootTree, rng: np.random.Generator) -> None:
        self.config, self.domain, self.root_tree = config, domain, root_tree
        topology = config.topology
        self._rngs = rng.spawn(topology.chains * topology.rounds + (topology.rounds > 1))
        self.history: list[AnnealingStep] = []
        self._now: tuple[list[Found], list[Annealing]] = [], []
        """Trees found in earlier rounds, chains of this one: exchanged at once, for threads that want the state."""
        self._crossed: list[Found] = []

    @property
    def begun(self) -> bool:
        return bool(self._now[1])

    @property
    def tests(self) -> int:
        """Topologies tried so far, by all chains."""
        found, chains = self._now
        return len(found) * self.config.topology.tests + sum(chain.n_tests for chain in chains)

    @property
    def target(self) -> int:
        """Topologies to be tried by all chains."""
        return self.config.topology.tests * self.config.topology.chains * self.config.topology.rounds

    @property
    def best_mm3(self) -> float:
        """Volume of the best tree so far, without the root tree's."""
        found, chains = self._now
        return min([tree.best_mm3 for tree in found + self._crossed] + [chain.best_mm3 for chain in chains])

    def search(
        self, parent: np.ndarray, position_mm: np.ndarray, resume: dict[str, np.ndarray] | None = None
    ) -> Iterator[AnnealingStep]:
        """Anneal all chains, round after round; the best tree is :meth:`best` afterwards, or when left off.

        After more than one round subtrees of all that was found are tried in the best
        (:func:`generator.topology.crossing.cross`).

        :param resume: what :meth:`state` gave of a search that began with the same tree.
        :raises InputError: when that is not sound.
        """
        shortest = self.config.geometry.l_min_mm
        self._tree = SearchTree(parent, position_mm, self.root_tree, self.config.flow(), shortest)
        self._now = [], self._begin(parent, position_mm, [])
        if resume is not None:
            self._restore(parent, position_mm, resume)
        while True:
            for step in anneal(self._now[1], threads()):
                yield self._record(step)
            found = self._all()
            if len(found) == self.config.topology.chains * self.config.topology.rounds:
                break
            self._now = found, self._begin(parent, position_mm, found)
        if self.config.topology.rounds > 1 and self.history:
            yield from self._cross(found)

    def _begin(self, parent: np.ndarray, position_mm: np.ndarray, found: list[Found]) -> list[Annealing]:
        """The chains of the next round; further ones begin with the best tree of those before."""
        options, start = self.config.topology.options(), None
        if found:
            start = _best(found).node
            options = replace(options, heat=options.heat * _COOLER, cooling=max(options.cooling * _COOLER, 1.0))
        return [
            Annealing(
                parent, position_mm, self.root_tree, self.config.flow(), space=self.domain.space, options=options,
                shortest_mm=self.config.geometry.l_min_mm, start=start, rng=rng,
            )
            for rng in self._rngs[len(found) : len(found) + options.chains]
        ]  # fmt: skip

    def _all(self) -> list[Found]:
        """By the chains of this round and of those before."""
        found, chains = self._now
        return found + [Found(chain.best_mm3, chain.best) for chain in chains]

    def _cross(self, found: list[Found]) -> Iterator[AnnealingStep]:
        tree, trees = self._tree, sorted(found, key=lambda one: one.best_mm3)
        tree.state.node[:] = trees[0].node
        most = int(_CROSSINGS * self.target / tree.n_terminals)
        for cost in cross(tree, self.domain.space, [one.node for one in trees[1:]], most, self._rngs[-1]):
            self._crossed = [Found(tree.volume_mm3(cost), tree.state.node.copy())]
            yield replace(self.history[-1], best_mm3=self.best_mm3)

    def _record(self, step: AnnealingStep) -> AnnealingStep:
        found, topology = self._now[0], self.config.topology
        step = replace(
            step, n_tests=len(found) // topology.chains * topology.tests + step.n_tests,
            n_target=topology.tests * topology.rounds,
            best_mm3=min([step.best_mm3, *(one.best_mm3 for one in found)]),
        )  # fmt: skip
        if self.history and step.n_tests <= self.history[-1].n_tests:
            return step  # of another chain: those follow the first one where there is one thread
        before = self.history[-2].n_tests if len(self.history) > 1 else 0
        if self.history and self.history[-1].n_tests - before < step.n_target / _RECORDED:
            step = replace(step, n_accepted=step.n_accepted + self.history.pop().n_accepted)
        self.history.append(step)
        return step

    def best(self) -> tuple[np.ndarray, np.ndarray]:
        """``parent`` and ``position_mm`` of the best tree found."""
        return self._tree.arrays(_best(self._all() + self._crossed).node)

    def state(self, *, done: bool = False) -> dict[str, np.ndarray]:
        """All that decides how a search goes on that has begun, as plain arrays that are copies; the history alone of
        one that is ``done``."""
        kept = {"history": np.array([astuple(step) for step in self.history], np.float64).reshape(-1, 6)}
        if done:
            return kept
        found, chains = self._now
        kept["found_mm3"] = np.array([one.best_mm3 for one in found])
        kept["found"] = np.array([bytes_of(one.node) for one in found], np.uint8)
        for number, chain in enumerate(chains):
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

    def _restore(self, parent: np.ndarray, position_mm: np.ndarray, kept: dict[str, np.ndarray]) -> None:
        self.recall(kept)
        found = self._kept_trees(kept)
        if found:
            self._now = found, self._begin(parent, position_mm, found)
        for number, chain in enumerate(self._now[1]):
            chain.restore(below(f"chain{number}", kept))

    def _kept_trees(self, kept: dict[str, np.ndarray]) -> list[Found]:
        """What was found in the rounds before."""
        topology = self.config.topology
        count = kept["found_mm3"].size if "found_mm3" in kept else 0
        shape = (count, self._tree.state.node.size, NODE.itemsize) if count else (0,)
        sound = fits(kept, {"found_mm3": ("float64", (count,)), "found": ("uint8", shape)})
        if not sound or count not in range(0, topology.chains * topology.rounds, topology.chains):
            raise InputError("lacks a round of the search for topologies; begin the run anew")
        nodes = [np.ascontiguousarray(one).view(NODE).ravel() for one in kept["found"]]
        if not (np.isfinite(kept["found_mm3"]).all() and all(self._tree.takes(node) for node in nodes)):
            raise InputError("holds a searched tree that is not sound; begin the run anew")
        return [Found(float(volume), node) for volume, node in zip(kept["found_mm3"], nodes, strict=True)]


def _best(found: list[Found]) -> Found:
    return min(found, key=lambda one: one.best_mm3)
