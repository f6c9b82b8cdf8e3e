"""Simulated annealing over topologies (paper, section 2.3.2; Kirkpatrick 1983).

A test moves a subtree elsewhere (prune and regraft) or exchanges the proximal points of two segments (the paper's swap,
with its two filters), and is accepted with probability ``exp(-dC / T)``, ``C`` being the logarithm of the volume. The
bifurcations around a move are put right and ``C`` is exact, at the cost of two paths to the root
(:mod:`generator.topology._anneal_kernels`); now and then the whole tree is relaxed.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass

import numpy as np

from generator._domain_kernels import Space
from generator.domain import convex_space
from generator.growth.root_tree import RootTree
from generator.haemodynamics import Perfusion
from generator.kept import fits, set_words, words_of
from generator.topology import _anneal_kernels as kernels
from generator.topology._relax_kernels import polish
from generator.topology._state_kernels import NODE, sweep
from generator.topology.state import SHORTEST_MM, SearchTree
from vascval.core.errors import InputError

_BLOCK = 500
_BLOCK_PER_TERMINAL = (0.5, 4.0)
"""Tests at one temperature, after which the tree is relaxed, compared with the best, and proposals are drawn from its
new shape: so many, but at least and at most so many for each terminal."""
_SAMPLES = 400
_EPS_RELAX, _EPS_NEAR = 0.005, 0.05
"""Smoothing of lengths, in mean lengths of a segment."""
_SAMPLE_POINTS = 8


@dataclass(frozen=True)
class AnnealingOptions:
    """How topologies are searched.

    * ``tests``: topologies tried by each chain;
    * ``heat``: start temperature in units of the median rise of C over moves sampled at the start;
    * ``cooling``: start over end temperature; cooling is geometric in between;
    * ``lenience``: a move of n terminals is accepted at a temperature ``n**lenience`` times as high, so that the trunk
      still moves when the twigs have come to rest;
    * ``swaps``: share of the paper's swap among the moves, the others prune and regraft;
    * ``chains``: independent searches, of which the best counts.

    :raises InputError: when a value makes no sense.
    """

    tests: int = 300_000
    heat: float = 0.5
    cooling: float = 120.0
    lenience: float = 0.7
    swaps: float = 0.2
    chains: int = 2

    def __post_init__(self) -> None:
        if self.tests < 1 or self.chains < 1:
            raise InputError(f"tests and chains are {self.tests} and {self.chains}; at least one is needed")
        if not (np.isfinite(self.heat) and self.heat > 0.0 and np.isfinite(self.cooling) and self.cooling >= 1.0):
            raise InputError(f"heat and cooling are {self.heat} and {self.cooling}; above 0 and at least 1 is needed")
        if not 0.0 <= self.lenience <= 1.0:
            raise InputError(f"lenience is {self.lenience}; a power between 0 and 1 is needed")
        if not 0.0 <= self.swaps <= 1.0:
            raise InputError(f"swaps is {self.swaps}; a share between 0 and 1 is needed")


@dataclass(frozen=True)
class AnnealingStep:
    """Where a chain stands: tests done and asked for, of which accepted since the last step, temperature, volumes."""

    n_tests: int
    n_target: int
    n_accepted: int
    temperature: float
    volume_mm3: float
    best_mm3: float


class Annealing:
    """One chain. Iterate over :meth:`steps`; the best tree so far is :meth:`arrays`.

    :param parent, position_mm: as :class:`generator.topology.state.SearchTree` takes them.
    :param space: the domain as kernels see it; ``None``: all of space.
    :param shortest_mm: terminals are made no shorter than this.
    :param start: the :attr:`best` of another chain that was made of the same tree: the search begins there, and its own
        best is of what it finds itself.
    """

    def __init__(
        self, parent: np.ndarray, position_mm: np.ndarray, root_tree: RootTree, perfusion: Perfusion, *,
        space: Space | None = None, options: AnnealingOptions | None = None, shortest_mm: float = SHORTEST_MM,
        start: np.ndarray | None = None, rng: np.random.Generator,
    ) -> None:  # fmt: skip
        self.options, self.rng = options or AnnealingOptions(), rng
        self.space = convex_space() if space is None else space
        self.tree = SearchTree(parent, position_mm, root_tree, perfusion, shortest_mm)
        self._again = start is not None
        if start is not None:
            self.tree.adopt(start)
        self.cost = sweep(self.tree.state, self.tree.flat.order)
        self._eps = _EPS_RELAX * self.tree.mean_length_mm
        if self.space.convex:
            self.cost = self._polish(3.0)
        self._best, self._best_cost = self.tree.state.node.copy(), self.cost
        self._nearby = self._grid()
        self._rise = 0.0
        self._between_blocks = threading.Lock()
        self.n_tests = 0

    @property
    def best_mm3(self) -> float:
        """Volume of the best tree so far, without the root tree's."""
        return self.tree.volume_mm3(self._best_cost)

    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """The best tree so far, as :meth:`SearchTree.arrays` gives it."""
        return self.tree.arrays(self.best)

    @property
    def best(self) -> np.ndarray:
        """The records of the best tree so far, a copy."""
        with self._between_blocks:
            return self._best.copy()

    def steps(self) -> Iterator[AnnealingStep]:
        """All tests, a block at a time; trees of fewer than three terminals have no other topology and take none."""
        if self.tree.n_terminals < 3:
            return
        while self.n_tests < self.options.tests:
            with self._between_blocks:
                step = self._block()
                if self.n_tests == self.options.tests:
                    self._end()
            yield step

    def _end(self) -> None:
        """Once: a chain that is kept after this is not polished again when the others go on."""
        self.tree.state.node[:] = self._best
        self.cost = sweep(self.tree.state, self.tree.flat.order)
        if self.space.convex:
            self.cost = self._polish(0.3)
        self._note()

    def _block(self) -> AnnealingStep:
        """The tests up to the next step."""
        options, state, flat, done = self.options, self.tree.state, self.tree.flat, self.n_tests
        self._lay()
        if done == 0:
            self._rise = self._median_rise()
            if self._again:
                self._best_cost = np.inf
        temperature = options.heat * self._rise * options.cooling ** (-done / options.tests)
        least, most = (int(per * self.tree.n_terminals) for per in _BLOCK_PER_TERMINAL)
        count = min(max(_BLOCK, least), most, options.tests - done)
        tally = np.zeros((2, 3), np.int64)
        self.cost = kernels.run(
            state, flat, self.space, self._nearby, self.rng, self._rules(), count, temperature, self.cost, tally
        )
        self.cost = kernels.relax_inside(state, flat, self.space, self._eps, 1, self.cost)
        self._note()
        self.n_tests = done + count
        accepted = int(tally[:, kernels.ACCEPTED].sum())
        volume = self.tree.volume_mm3(self.cost)
        return AnnealingStep(self.n_tests, options.tests, accepted, temperature, volume, self.best_mm3)

    def state(self) -> dict[str, np.ndarray]:
        """All that decides how the chain goes on, as plain arrays that are copies; of any thread, between two steps."""
        with self._between_blocks:
            return {
                "rng": words_of(self.rng),
                "n_tests": np.array([self.n_tests], np.int64),
                "numbers": np.array([self.cost, self._best_cost, self._rise]),
                "node": bytes_of(self.tree.state.node),
                "best": bytes_of(self._best),
                "counts": self.tree.state.counts.copy(),
                "share": self.tree.state.share.copy(),
            }

    def restore(self, kept: dict[str, np.ndarray]) -> None:
        """Take over what :meth:`state` gave of a chain that began with the same tree and options.

        :raises InputError: when it is not sound; do not go on from here then.
        """
        state = self.tree.state
        size, wide = state.node.size, NODE.itemsize
        kinds: dict[str, tuple[str, tuple[int | None, ...]]] = {
            "rng": ("uint64", (6,)), "n_tests": ("int64", (1,)), "numbers": ("float64", (3,)),
            "node": ("uint8", (size, wide)), "best": ("uint8", (size, wide)), "counts": ("int64", (4,)),
            "share": ("float64", (state.share.size,)),
        }  # fmt: skip
        sound = fits(kept, kinds) and 0 <= kept["n_tests"][0] <= self.options.tests
        sound = sound and bool(np.isfinite(kept["numbers"]).all() and np.isfinite(kept["share"]).all())
        if not sound:
            raise InputError("lacks a part of the search for topologies; begin the run anew")
        node, best = (np.ascontiguousarray(kept[name]).view(NODE).ravel() for name in ("node", "best"))
        if not (self.tree.takes(node) and self.tree.takes(best)) or not 0 <= kept["counts"][1] < 2**31:
            raise InputError("holds a searched tree that is not sound; begin the run anew")
        set_words(self.rng, kept["rng"])
        state.node[:], self._best[:] = node, best
        state.counts[1], state.share[:] = kept["counts"][1], kept["share"]
        self.n_tests = int(kept["n_tests"][0])
        self.cost, self._best_cost, self._rise = (float(value) for value in kept["numbers"])

    def _rules(self) -> kernels.Rules:
        options = self.options
        return kernels.Rules(options.swaps, self._rise, _EPS_NEAR * self.tree.mean_length_mm, options.lenience)

    def _median_rise(self) -> float:
        """The median rise of C by a move, which temperatures are made of."""
        rise = np.zeros(_SAMPLES)
        count = kernels.sample(self.tree.state, self._nearby, self.rng, self._rules(), self.cost, rise)
        return max(float(np.median(rise[:count])) if count else 0.0, 1e-9)

    def _polish(self, coarse: float) -> float:
        """The geometry of the present topology to about 1e-8 of the volume."""
        mean = self.tree.mean_length_mm
        finest = 1e-6 if self.tree.n_terminals <= 20 else 3e-4
        return polish(self.tree.state, self.tree.flat, coarse * mean, finest * mean, 1e-5)

    def _note(self) -> None:
        if self.cost < self._best_cost:
            self._best_cost = self.cost
            self._best[:] = self.tree.state.node

    def _grid(self) -> kernels.Nearby:
        """Cells with room for about one terminal each."""
        node = self.tree.state.node
        at = np.column_stack([node[name] for name in ("x", "y", "z")])
        size = np.maximum(np.ptp(at, axis=0), 1e-6 * np.ptp(at, axis=0).max())
        cell = float(np.cbrt(size.prod() / self.tree.n_terminals))
        cell = max(cell, float(size.max()) / 200.0)
        shape = np.maximum(np.ceil(size / cell).astype(np.int64), 1)
        owner = np.zeros(_SAMPLE_POINTS * node.size, np.int32)
        return kernels.Nearby(at.min(axis=0), cell, shape, np.zeros(int(shape.prod()) + 1, np.int64), owner)

    def _lay(self) -> None:
        while not kernels.lay(self.tree.state, self._nearby):
            self._nearby = self._nearby._replace(owner=np.zeros(2 * self._nearby.owner.size, np.int32))


def anneal(chains: list[Annealing], workers: int = 1) -> Iterator[AnnealingStep]:
    """All chains to their end, on threads; each has its own random numbers, so that workers change nothing.

    Steps are those of the first chain that is running, for show; compare ``best_mm3`` of the chains in the end. When
    the iterator is closed the others stop too, after their present block.
    """
    first, rest = chains[0], chains[1:]
    if workers < 2 or not rest:
        for chain in chains:
            yield from chain.steps()
        return
    stop = threading.Event()
    with ThreadPoolExecutor(min(workers - 1, len(rest))) as pool:
        running = [pool.submit(_exhaust, chain, stop) for chain in rest]
        try:
            yield from first.steps()
            for future in running:
                while not future.done():
                    wait([future], 0.2)
                future.result()
        finally:
            stop.set()


def _exhaust(chain: Annealing, stop: threading.Event) -> None:
    for _ in chain.steps():
        time.sleep(0.0)  # lets a thread in that waits for the state of this chain
        if stop.is_set():
            break


def bytes_of(node: np.ndarray) -> np.ndarray:
    """(N, bytes) a copy of the records as plain bytes."""
    return node.view(np.uint8).reshape(node.size, -1).copy()
