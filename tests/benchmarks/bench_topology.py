"""Search over topologies: volume by number of tests, tests per second, and the optimum of small trees.

``python -m tests.benchmarks.bench_topology [tests|reduction|optima|orders|rounds ...]`` prints tables; all of them
without arguments.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from itertools import permutations

import numpy as np

from generator.config import load
from generator.framework import Run
from generator.growth.growth import Growth
from generator.haemodynamics import perfused_tree
from generator.topology.annealing import Annealing, AnnealingOptions
from generator.topology.exhaustive import optimal_tree, settled
from generator.topology.state import SHORTEST_MM
from tests.benchmarks.bench_growth import BOX, CORNER, KARCH, TERMINALS
from tests.benchmarks.tables import main, table
from vascval.comparison.location import sample_centrelines
from vascval.core.tree import Topology, Tree
from vascval.morphometry.pieces import pieces

KNOWN = {"opencco_500": 833.1, "ccolab_500": 833.8}
"""Best volumes (mm^3) of a plain implementation that relaxes the whole tree in each test, in six minutes."""


def grown(points: np.ndarray, root: np.ndarray, order: np.ndarray) -> Growth:
    growth = Growth(BOX, KARCH, root, len(points), rng=np.random.default_rng(1), terminals_mm=points[order])
    for _ in growth.steps():
        pass
    return growth


def annealed(
    growth: Growth, seed: int, shortest_mm: float = SHORTEST_MM, **options: float
) -> tuple[Annealing, float, float]:
    """A chain at its end, its volume at the beginning, after geometry alone, and CPU seconds."""
    settings = AnnealingOptions(**options)  # type: ignore[arg-type]
    chain = Annealing(
        *growth.snapshot(), growth.root_tree, KARCH, options=settings, shortest_mm=shortest_mm,
        rng=np.random.default_rng(seed),
    )  # fmt: skip
    start, began = chain.best_mm3, time.process_time()
    for _ in chain.steps():
        pass
    return chain, start, time.process_time() - began


def terminals(name: str, largest: int) -> tuple[np.ndarray, np.ndarray]:
    points = np.loadtxt(TERMINALS / f"{name}.csv", delimiter=",", skiprows=1)[: largest + 1]
    return points[0], points[1:]


def tests(
    names: Sequence[str] = tuple(KNOWN), counts: Sequence[int] = (10_000, 100_000, 1_000_000, 10_000_000),
    orders: Sequence[int] = (0, 1, 2), shortest: Sequence[float] = (SHORTEST_MM, 0.0), largest: int = 10_000,
) -> str:  # fmt: skip
    """Volume by number of tests, on the terminals of other programs, connected in random orders."""
    rows: list[list[object]] = []
    annealed(grown(BOX.sample(20, np.random.default_rng(1)), CORNER, np.arange(20)), 1, tests=100)  # compiles
    for name in names:
        if not (TERMINALS / f"{name}.csv").exists():
            rows.append([name, "terminals not there", *[""] * 9])
            continue
        root, points = terminals(name, largest)
        grows = [grown(points, root, np.random.default_rng(order).permutation(len(points))) for order in orders]
        for bound in shortest:
            for count in counts:
                ends = [annealed(each, 1, bound, tests=count) for each in grows]
                volumes = [chain.best_mm3 for chain, _, _ in ends]
                seconds = float(np.mean([seconds for _, _, seconds in ends]))
                before = float(np.mean([each.volume_mm3 for each in grows]))
                rows.append(
                    [name, bound, f"{count:,}", f"{before:.1f}", f"{np.mean([start for _, start, _ in ends]):.1f}",
                     f"{np.mean(volumes):.1f}", f"{min(volumes):.2f}", f"{np.mean(volumes) / before - 1:.1%}",
                     KNOWN[name], f"{seconds:.1f}", f"{count / seconds:,.0f}"]
                )  # fmt: skip
    header = ("terminals of", "l_min mm", "tests", "growth mm^3", "geometry", "topology", "best", "less than growth",
              "known before", "CPU s", "tests per CPU s")  # fmt: skip
    return table(header, rows)


def rounds(
    names: Sequence[str] = tuple(KNOWN),
    searches: Sequence[tuple[int, int, int, int]] = ((12, 150_000, 5, 6),),
) -> str:
    """Volume after several rounds of several chains of so many tests, for so many seeds, on the same terminals."""
    rows: list[list[object]] = []
    compiled = ("n_terminals=20", "method=full", "topology.at=20", "topology.tests=500", "topology.rounds=2")
    list(Run.of(load("karch-box", compiled)).steps())
    for name in names:
        if not (TERMINALS / f"{name}.csv").exists():
            rows.append([name, "terminals not there", *[""] * 6])
            continue
        for chains, count, times, seeds in searches:
            for seed in range(1, seeds + 1):
                changes = [
                    f"terminals_file={TERMINALS / name}.csv", "method=full", f"seed={seed}", "geometry.l_min_mm=0",
                    "geometry.contract=false", "topology.cooling=400", "topology.lenience=0.85",
                    f"topology.chains={chains}", f"topology.tests={count}", f"topology.rounds={times}",
                ]  # fmt: skip
                run, began = Run.of(load("karch-box", changes)), time.process_time()
                for _ in run.steps():
                    pass
                rows.append(
                    [name, chains, f"{count:,}", times, seed, f"{run.tree().volume_mm3:.2f}", KNOWN[name],
                     f"{time.process_time() - began:.0f}"]
                )  # fmt: skip
    return table(("terminals of", "chains", "tests each", "rounds", "seed", "mm^3", "known before", "CPU s"), rows)


def reduction(seeds: int = 10, count: int = 1_000_000, n_terminals: int = 500) -> str:
    """How much less volume than growth trees of sampled terminals have after geometry and after topology."""
    volumes = np.empty((seeds, 3))
    for seed in range(seeds):
        growth = Growth(BOX, KARCH, CORNER, n_terminals, rng=np.random.default_rng(seed))
        for _ in growth.steps():
            pass
        chain, start, _ = annealed(growth, seed, tests=count)
        volumes[seed] = growth.volume_mm3, start, chain.best_mm3
    less = 1.0 - volumes / volumes[:, :1]
    rows = [
        [what, f"{volumes[:, k].mean():.1f}", *(f"{f(less[:, k]):.1%}" for f in (np.mean, np.min, np.max))]
        for k, what in enumerate(("growth", "geometry", "topology"))
    ]  # fmt: skip
    return table(("after", "mean mm^3", "less: mean", "least", "most"), rows)


def optima(counts: Sequence[int] = (5, 6, 7, 8), instances: int = 100) -> str:
    """How often annealing finds the proven optimum, to 1e-6."""
    rows = []
    for n in counts:
        found, bounded, seconds = 0, 0, [0.0, 0.0]
        for number in range(instances):
            rng = np.random.default_rng(1000 * n + number)
            points = BOX.sample(n, rng)
            began = time.process_time()
            optimum = optimal_tree(CORNER, points, KARCH)
            seconds[0] += time.process_time() - began
            began = time.process_time()
            growth = grown(points, CORNER, np.arange(n))
            runs = [annealed(growth, seed, tests=5000, heat=2.0, cooling=1000.0) for seed in range(4)]
            seconds[1] += time.process_time() - began
            ends = [
                perfused_tree(Topology(parent), at, KARCH) for parent, at in (chain.arrays() for chain, _, _ in runs)
            ]
            best = min(settled(tree, KARCH).volume_mm3 for tree in ends)
            found += abs(best / optimum.tree.volume_mm3 - 1.0) <= 1e-6
            bounded += optimum.n_bounded
        rows.append([n, f"{found} of {instances}", f"{optimum.n_topologies:,}", f"{bounded / instances:,.0f}",
                     *(f"{value / instances:.3f}" for value in seconds)])  # fmt: skip
    header = ("terminals", "found", "topologies", "bounded", "branch and bound s", "annealing s")
    return table(header, rows)


def orders(name: str = "opencco_500", count: int = 10, n_tests: int = 1_000_000, largest: int = 10_000) -> str:
    """The same terminals connected in random orders: how far apart volumes and vessels are before and after."""
    header = ("volumes of", "mean mm^3", "lowest", "highest", "spread", "thick vessels apart, mm", "within 1 mm")
    if not (TERMINALS / f"{name}.csv").exists():
        return table(header, [[name, *["terminals not there"] * 6]])
    root, points = terminals(name, largest)
    volumes, trees = np.empty((3, count)), [[], [], []]  # type: tuple[np.ndarray, list[list[Tree]]]
    for k in range(count):
        growth = grown(points, root, np.random.default_rng(k).permutation(len(points)))
        start = Annealing(*growth.snapshot(), growth.root_tree, KARCH, rng=np.random.default_rng(k))
        chain, _, _ = annealed(growth, k, tests=n_tests)
        volumes[:, k] = growth.volume_mm3, start.best_mm3, chain.best_mm3
        for stage, (parent, position) in enumerate((growth.snapshot(), start.arrays(), chain.arrays())):
            trees[stage].append(perfused_tree(Topology(parent), position, KARCH))
    rows = []
    for what, row, made in zip(("growth", "geometry", "topology"), volumes, trees, strict=True):
        apart = np.array([overlay(one, other) for one, other in permutations(made, 2)]).mean(axis=0)
        rows.append(
            [what, f"{row.mean():.1f}", f"{row.min():.1f}", f"{row.max():.1f}", f"{np.ptp(row) / row.mean():.2%}",
             f"{apart[0]:.2f}", f"{apart[1]:.0%}"]
        )  # fmt: skip
    return table(header, rows)


def overlay(tree: Tree, other: Tree, thick: float = 1.0 / 3.0) -> tuple[float, float]:
    """Mean distance (mm) of the vessels of at least ``thick`` root radii from those of the other tree, by length; and
    the share of that length that is within 1 mm."""
    samples = sample_centrelines(tree, 0.5)
    kept = tree.radius_mm[samples.segment] >= thick * tree.radius_mm[1:].max()
    chosen = other.radius_mm >= thick * other.radius_mm[1:].max()
    chosen[0] = False
    distance = pieces(other, chosen).distance_mm(samples.points[kept])
    weight = samples.length_mm[kept]
    return float(np.average(distance, weights=weight)), float(np.average(distance <= 1.0, weights=weight))


TABLES: dict[str, Callable[[], str]] = {
    "tests": tests, "reduction": reduction, "optima": optima, "orders": orders, "rounds": rounds
}  # fmt: skip


if __name__ == "__main__":
    main(TABLES, "topology")
