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
_COOLER = 0.1
"""Heat of further rounds, where the first is 1: the trunk stays, of which few are good, and all else is found anew."""
_CROSSINGS = 0.6
"""At most so many in a tree for each test of a round, by the number of terminals: a part of the time that the tests
take."""


@dataclass(frozen=True)
class Found:
    """A tree that was found: its volume without the root tree's, and its records."""

    best_mm3: float
    node: np.ndarray


@dataclass(frozen=True)
class Round:
    """What was found in the rounds before, in the order in which it was, and the chains of this one."""

    number: int
    found: list[Found]
    chains: list[Annealing]


class TopologyStage:
    """What a configuration asks of the topology.

    Where it asks for more than one round, the best half of the trees that the chains of the first one end with go on,
    each with its share of the chains, and after every round the best half of these, down to one: which trunk is the
    best shows only as the rest comes to rest. Before a tree goes on it takes over subtrees of all that was found
    (:func:`generator.topology.crossing.cross`).

    Trees come and go as ``parent`` and ``position_mm`` with the root tree's nodes first. Viscosity counts as constant,
    and the branching exponent as the same everywhere. ``history`` has the steps of the first chain; steps shorter than
    a ten-thousandth of it are joined, so that it stays small however long the search.
    """

    def __init__(self, config: Config, domain: Domain, root_tree: RootTree, rng: np.random.Generator) -> None:
        self.config, self.domain, self.root_tree = config, domain, root_tree
        topology = config.topology
        self._rngs = rng.spawn((topology.chains + (topology.rounds > 1)) * topology.rounds)
        self.history: list[AnnealingStep] = []
        self._now = Round(0, [], [])
        """Exchanged at once, for threads that want the state."""
        self._crossed: list[Found] = []
        """After this round, once its chains have ended."""

    @property
    def begun(self) -> bool:
        return bool(self._now.chains)

    @property
    def tests(self) -> int:
        """Topologies tried so far, by all chains."""
        before = self._now.number * self.config.topology.chains * self.config.topology.tests
        return before + sum(chain.n_tests for chain in self._now.chains)

    @property
    def target(self) -> int:
        """Topologies to be tried by all chains."""
        return self.config.topology.tests * self.config.topology.chains * self.config.topology.rounds

    @property
    def best_mm3(self) -> float:
        """Volume of the best tree so far, without the root tree's."""
        now = self._now
        ends = [tree.best_mm3 for tree in now.found + self._crossed]
        return min(ends + [chain.best_mm3 for chain in now.chains])

    def search(
        self, parent: np.ndarray, position_mm: np.ndarray, resume: dict[str, np.ndarray] | None = None
    ) -> Iterator[AnnealingStep]:
        """Anneal all chains, round after round; the best tree is :meth:`best` afterwards, or when left off.

        :param resume: what :meth:`state` gave of a search that began with the same tree.
        :raises InputError: when that is not sound.
        """
        shortest = self.config.geometry.l_min_mm
        self._tree = SearchTree(parent, position_mm, self.root_tree, self.config.flow(), shortest)
        self._now = self._begin(parent, position_mm, 0, [])
        if resume is not None:
            self._restore(parent, position_mm, resume)
        while True:
            for step in anneal(self._now.chains, threads()):
                yield self._record(step)
            if self.config.topology.rounds == 1 or not self.history:
                break
            yield from self._cross()
            if self._now.number + 1 == self.config.topology.rounds:
                break
            self._now = self._begin(parent, position_mm, self._now.number + 1, self._all())
            self._crossed = []

    def _lines(self, number: int) -> int:
        """Trees that go on after a round."""
        return max(1, self.config.topology.chains >> (number + 1))

    def _begin(self, parent: np.ndarray, position_mm: np.ndarray, number: int, found: list[Found]) -> Round:
        """A round, its chains not yet begun."""
        options = self.config.topology.options()
        start: list[np.ndarray | None] = [None]
        if number > 0:
            start = [one.node for one in found[-self._lines(number - 1) :]]
            options = replace(options, heat=options.heat * _COOLER, cooling=max(options.cooling * _COOLER, 1.0))
        first = number * (options.chains + 1)
        chains = [
            Annealing(
                parent, position_mm, self.root_tree, self.config.flow(), space=self.domain.space, options=options,
                shortest_mm=self.config.geometry.l_min_mm, start=start[k % len(start)], rng=rng,
            )
            for k, rng in enumerate(self._rngs[first : first + options.chains])
        ]  # fmt: skip
        return Round(number, found, chains)

    def _all(self) -> list[Found]:
        """In this round and in those before."""
        return self._now.found + _ends(self._now.chains) + self._crossed

    def _cross(self) -> Iterator[AnnealingStep]:
        """The trees that go on after this round, the best one first."""
        self._crossed = []
        now, topology, tree = self._now, self.config.topology, self._tree
        ends = _ends(now.chains)
        most = int(_CROSSINGS * topology.tests * topology.chains / tree.n_terminals)
        rng = self._rngs[now.number * (topology.chains + 1) + topology.chains]
        done: list[Found] = []
        for head in self._heads(now, ends):
            tree.adopt(head.node)
            donors = [one.node for one in now.found + ends if one is not head]
            for cost in cross(tree, self.domain.space, donors, most, rng):
                self._crossed = sorted([*done, Found(tree.volume_mm3(cost), tree.state.node.copy())], key=_volume)
                yield replace(self.history[-1], best_mm3=self.best_mm3)
            done = self._crossed

    def _heads(self, now: Round, ends: list[Found]) -> list[Found]:
        """The best of each line: what it began the round with, and what its chains ended with; the best of these."""
        if now.number == 0:
            lines = [[end] for end in ends]
        else:
            count = self._lines(now.number - 1)
            lines = [[start, *ends[k::count]] for k, start in enumerate(now.found[-count:])]
        return sorted((min(line, key=_volume) for line in lines), key=_volume)[: self._lines(now.number)]

    def _record(self, step: AnnealingStep) -> AnnealingStep:
        now, topology = self._now, self.config.topology
        step = replace(
            step, n_tests=now.number * topology.tests + step.n_tests, n_target=topology.tests * topology.rounds,
            best_mm3=min([step.best_mm3, *(one.best_mm3 for one in now.found)]),
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
        return self._tree.arrays(min(self._all(), key=_volume).node)

    def state(self, *, done: bool = False) -> dict[str, np.ndarray]:
        """All that decides how a search goes on that has begun, as plain arrays that are copies; the history alone of
        one that is ``done``."""
        kept = {"history": np.array([astuple(step) for step in self.history], np.float64).reshape(-1, 6)}
        if done:
            return kept
        now = self._now
        kept["found_mm3"] = np.array([one.best_mm3 for one in now.found])
        kept["found"] = np.array([bytes_of(one.node) for one in now.found], np.uint8)
        for number, chain in enumerate(now.chains):
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
        number, found = self._kept_trees(kept)
        if number:
            self._now = self._begin(parent, position_mm, number, found)
        for number, chain in enumerate(self._now.chains):
            chain.restore(below(f"chain{number}", kept))

    def _kept_trees(self, kept: dict[str, np.ndarray]) -> tuple[int, list[Found]]:
        """How many rounds are over, and what was found in them."""
        topology = self.config.topology
        count = kept["found_mm3"].size if "found_mm3" in kept else 0
        shape = (count, self._tree.state.node.size, NODE.itemsize) if count else (0,)
        sound = fits(kept, {"found_mm3": ("float64", (count,)), "found": ("uint8", shape)})
        per_round = [topology.chains + self._lines(number) for number in range(topology.rounds - 1)]
        after = [sum(per_round[:number]) for number in range(topology.rounds)]
        if not sound or count not in after:
            raise InputError("lacks a round of the search for topologies; begin the run anew")
        nodes = [np.ascontiguousarray(one).view(NODE).ravel() for one in kept["found"]]
        if not (np.isfinite(kept["found_mm3"]).all() and all(self._tree.takes(node) for node in nodes)):
            raise InputError("holds a searched tree that is not sound; begin the run anew")
        found = [Found(float(volume), node) for volume, node in zip(kept["found_mm3"], nodes, strict=True)]
        return after.index(count), found


def _volume(one: Found) -> float:
    return one.best_mm3


def _ends(chains: list[Annealing]) -> list[Found]:
    return [Found(chain.best_mm3, chain.best) for chain in chains]
