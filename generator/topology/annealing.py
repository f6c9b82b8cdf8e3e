"""Simulated annealing over topologies (paper, section 2.3.2; Kirkpatrick 1983).

A test moves a subtree elsewhere (prune and regraft) or exchanges the proximal points of two segments (the paper's swap,
with its two filters), and is accepted with probability ``exp(-dC / T)``, ``C`` being the logarithm of the volume. The
bifurcations around a move are put right and ``C`` is exact, at the cost of two paths to the root
(:mod:`generator.topology._anneal_kernels`); now and then the whole tree is relaxed.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from generator._domain_kernels import Space
from generator.domain import convex_space
from generator.growth.root_tree import RootTree
from generator.haemodynamics import Perfusion
from generator.topology import _anneal_kernels as kernels
from generator.topology._relax_kernels import polish
from generator.topology._state_kernels import sweep
from generator.topology.state import SearchTree
from vascval.core.errors import InputError

_BLOCK = 500
_BLOCK_PER_TERMINAL = 4
"""Tests at one temperature, after which the tree is relaxed, compared with the best, and proposals are drawn from its
new shape: so many, but at most so many for each terminal."""
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
    * ``swaps``: share of the paper's swap among the moves, the others prune and regraft;
    * ``chains``: independent searches, of which the best counts.

    :raises InputError: when a value makes no sense.
    """

    tests: int = 300_000
    heat: float = 1.0
    cooling: float = 60.0
    swaps: float = 0.2
    chains: int = 2

    def __post_init__(self) -> None:
        if self.tests < 1 or self.chains < 1:
            raise InputError(f"tests and chains are {self.tests} and {self.chains}; at least one is needed")
        if not (np.isfinite(self.heat) and self.heat > 0.0 and np.isfinite(self.cooling) and self.cooling >= 1.0):
            raise InputError(f"heat and cooling are {self.heat} and {self.cooling}; above 0 and at least 1 is needed")
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
    """

    def __init__(
        self, parent: np.ndarray, position_mm: np.ndarray, root_tree: RootTree, perfusion: Perfusion, *,
        space: Space | None = None, options: AnnealingOptions | None = None, rng: np.random.Generator,
    ) -> None:  # fmt: skip
        self.options, self.rng = options or AnnealingOptions(), rng
        self.space = convex_space() if space is None else space
        self.tree = SearchTree(parent, position_mm, root_tree, perfusion)
        self.cost = sweep(self.tree.state, self.tree.flat.order)
        self._eps = _EPS_RELAX * self.tree.mean_length_mm
        if self.space.convex:
            self.cost = self._polish(3.0)
        self._best, self._best_cost = self.tree.state.node.copy(), self.cost
        self._nearby = self._grid()
        self.n_tests = 0

    @property
    def best_mm3(self) -> float:
        """Volume of the best tree so far, without the root tree's."""
        return self.tree.volume_mm3(self._best_cost)

    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """The best tree so far, as :meth:`SearchTree.arrays` gives it."""
        present = self.tree.state.node.copy()
        self.tree.state.node[:] = self._best
        result = self.tree.arrays()
        self.tree.state.node[:] = present
        return result

    def steps(self) -> Iterator[AnnealingStep]:
        """All tests, a block at a time; trees of fewer than three terminals have no other topology and take none."""
        if self.tree.n_terminals < 3:
            return
        options, state, flat = self.options, self.tree.state, self.tree.flat
        start, rise = self._start_temperature()
        rules = kernels.Rules(options.swaps, 2.0 * rise, 20.0 * rise, _EPS_NEAR * self.tree.mean_length_mm)
        tally = np.zeros((2, 3), np.int64)
        done = 0
        while done < options.tests:
            temperature = start * options.cooling ** (-done / options.tests)
            count = min(_BLOCK, _BLOCK_PER_TERMINAL * self.tree.n_terminals, options.tests - done)
            self._lay()
            tally[:] = 0
            self.cost = kernels.run(
                state, flat, self.space, self._nearby, self.rng, rules, count, temperature, self.cost, tally
            )
            self.cost = kernels.relax_inside(state, flat, self.space, self._eps, 1, self.cost)
            self._note()
            done += count
            self.n_tests = done
            volume = self.tree.volume_mm3(self.cost)
            accepted = int(tally[:, kernels.ACCEPTED].sum())
            yield AnnealingStep(done, options.tests, accepted, temperature, volume, self.best_mm3)
        state.node[:] = self._best
        self.cost = sweep(state, flat.order)
        if self.space.convex:
            self.cost = self._polish(0.3)
        self._note()

    def _start_temperature(self) -> tuple[float, float]:
        """The start temperature and the median rise of C that it is made of."""
        self._lay()
        rise = np.zeros(_SAMPLES)
        count = kernels.sample(self.tree.state, self._nearby, self.rng, self.options.swaps, self.cost, rise)
        median = max(float(np.median(rise[:count])) if count else 0.0, 1e-9)
        return self.options.heat * median, median

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

    Steps are those of the first chain that is running, for show; compare ``best_mm3`` of the chains in the end.
    """
    first, rest = chains[0], chains[1:]
    if workers < 2 or not rest:
        for chain in chains:
            yield from chain.steps()
        return
    with ThreadPoolExecutor(workers - 1) as pool:
        running = [pool.submit(_exhaust, chain) for chain in rest]
        yield from first.steps()
        for future in running:
            future.result()


def _exhaust(chain: Annealing) -> None:
    for _ in chain.steps():
        pass
