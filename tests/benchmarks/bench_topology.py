"""Search over topologies: volume by number of tests, tests per second, and the optimum of small trees.

``python -m tests.benchmarks.bench_topology [tests|optima|orders ...]`` prints tables; without arguments all of them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from generator.growth.growth import Growth
from generator.growth.insertion_order import spread_order
from generator.topology.annealing import Annealing, AnnealingOptions
from generator.topology.exhaustive import optimal_tree
from tests.benchmarks.bench_growth import BOX, CORNER, KARCH, TERMINALS
from tests.benchmarks.tables import main, table

KNOWN = {"opencco_500": 833.1, "ccolab_500": 833.8}
"""Best volumes (mm^3) of a plain implementation that relaxes the whole tree in each test, in six minutes."""


def grown(points: np.ndarray, root: np.ndarray, order: np.ndarray) -> Growth:
    growth = Growth(BOX, KARCH, root, len(points), rng=np.random.default_rng(1), terminals_mm=points[order])
    for _ in growth.steps():
        pass
    return growth


def annealed(growth: Growth, seed: int, **options: float) -> tuple[Annealing, float, float]:
    """A chain at its end, its volume at the beginning, after geometry alone, and CPU seconds."""
    settings = AnnealingOptions(**options)  # type: ignore[arg-type]
    chain = Annealing(*growth.snapshot(), growth.root_tree, KARCH, options=settings, rng=np.random.default_rng(seed))
    start, began = chain.best_mm3, time.process_time()
    for _ in chain.steps():
        pass
    return chain, start, time.process_time() - began


def terminals(name: str, largest: int) -> tuple[np.ndarray, np.ndarray]:
    points = np.loadtxt(TERMINALS / f"{name}.csv", delimiter=",", skiprows=1)[: largest + 1]
    return points[0], points[1:]


def tests(
    names: Sequence[str] = tuple(KNOWN), counts: Sequence[int] = (10_000, 100_000, 1_000_000), largest: int = 10_000
) -> str:
    """Volume by number of tests, on the terminals of other programs."""
    rows: list[list[object]] = []
    for name in names:
        if not (TERMINALS / f"{name}.csv").exists():
            rows.append([name, "terminals not there", *[""] * 6])
            continue
        root, points = terminals(name, largest)
        growth = grown(points, root, spread_order(points, root, np.random.default_rng(1)))
        for count in counts:
            chain, start, seconds = annealed(growth, 1, tests=count)
            rows.append(
                [name, f"{count:,}", f"{growth.volume_mm3:.1f}", f"{start:.1f}", f"{chain.best_mm3:.1f}",
                 f"{chain.best_mm3 / growth.volume_mm3 - 1:.1%}", KNOWN[name], f"{count / seconds:,.0f}"]
            )  # fmt: skip
    header = ("terminals of", "tests", "growth mm^3", "geometry", "topology", "less than growth", "best known",
              "tests per CPU s")  # fmt: skip
    return table(header, rows)


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
            best = min(chain.best_mm3 for chain, _, _ in runs)
            found += abs(best / optimum.tree.volume_mm3 - 1.0) <= 1e-6
            bounded += optimum.n_bounded
        rows.append([n, f"{found} of {instances}", f"{optimum.n_topologies:,}", f"{bounded / instances:,.0f}",
                     *(f"{value / instances:.3f}" for value in seconds)])  # fmt: skip
    header = ("terminals", "found", "topologies", "bounded", "branch and bound s", "annealing s")
    return table(header, rows)


def orders(name: str = "opencco_500", count: int = 10, n_tests: int = 300_000, largest: int = 10_000) -> str:
    """The same terminals connected in random orders: how far apart the volumes are before and after."""
    if not (TERMINALS / f"{name}.csv").exists():
        return table(("volumes of", "mean mm^3", "lowest", "highest", "spread"), [[name, *["terminals not there"] * 4]])
    root, points = terminals(name, largest)
    volumes = np.empty((3, count))
    for k in range(count):
        growth = grown(points, root, np.random.default_rng(k).permutation(len(points)))
        chain, start, _ = annealed(growth, k, tests=n_tests)
        volumes[:, k] = growth.volume_mm3, start, chain.best_mm3
    rows = [
        [what, f"{row.mean():.1f}", f"{row.min():.1f}", f"{row.max():.1f}", f"{np.ptp(row) / row.mean():.2%}"]
        for what, row in zip(("growth", "geometry", "topology"), volumes, strict=True)
    ]
    return table(("volumes of", "mean mm^3", "lowest", "highest", "spread"), rows)


TABLES: dict[str, Callable[[], str]] = {"tests": tests, "optima": optima, "orders": orders}


if __name__ == "__main__":
    main(TABLES, "topology")
