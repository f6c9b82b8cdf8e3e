"""Growth: time, memory, volume and evenness, and the volume on terminals that other programs chose.

``python -m tests.benchmarks.bench_growth [scaling|volumes|rivals|connections|liver|apart ...]`` prints tables; without
arguments all of them. The rivals' figures were measured once, on a machine of 2 cores (CPU seconds of the process).
"""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from generator.domain import Box, Domain
from generator.domain_shapes import ShapeDomain
from generator.growth.evenness import evenness
from generator.growth.growth import Growth, GrowthOptions
from generator.growth.insertion_order import spread_order
from generator.haemodynamics import Perfusion
from tests.benchmarks.tables import main, table
from vascval.core.tree import Tree
from vascval.core.units import MM3_S_PER_ML_MIN, PA_PER_MMHG, PA_S_PER_CP
from vascval.morphometry.overlaps import overlapping_pairs

KARCH = Perfusion(100 * PA_PER_MMHG, 60 * PA_PER_MMHG, 500 * MM3_S_PER_ML_MIN, 3.6 * PA_S_PER_CP, 2.55)
PORTAL = Perfusion(12 * PA_PER_MMHG, 8 * PA_PER_MMHG, 1000 * MM3_S_PER_ML_MIN, 3.6 * PA_S_PER_CP, 3.0)
BOX = Box((90.0, 70.0, 16.0))
CORNER = np.zeros(3)
PROTOTYPE = {500: (0.08, 900.0), 2000: (0.8, 1107.0), 6000: (4.9, 1288.0)}
"""CPU seconds and mean volume (mm^3) of a plain implementation with brute-force search."""
RIVALS = {500: (21.0, 3.5, 19.0), 2000: (49.0, 38.0, 362.0), 6000: (127.0, 328.0, 700.0)}
"""CPU seconds of svVascularize 0.0.57, OpenCCO and ccolab, the fastest of their runs."""
RIVAL_VOLUMES = {
    "svv_500": 908.8, "svv_2000": 1157.5, "svv_6000": 1390.9, "opencco_500": 927.0, "opencco_2000": 1128.9,
    "opencco_6000": 1315.9, "ccolab_500": 946.2, "ccolab_2000": 1146.7,
}  # fmt: skip
"""Volume (mm^3) of the other program's own tree on its own terminals."""
_BESIDE = Path(__file__).resolve().parents[3] / "shared" / "reference"
TERMINALS = Path(os.environ.get("VASCVAL_REFERENCE", _BESIDE)) / "karch_terminals"


def grow(
    n: int, *, seed: int = 1, domain: Domain = BOX, law: Perfusion = KARCH, root: np.ndarray = CORNER,
    terminals: np.ndarray | None = None, **options: object,
) -> tuple[Growth, float]:  # fmt: skip
    """A growth, finished, and the CPU seconds it took."""
    began = time.process_time()
    growth = Growth(
        domain, law, root, n, options=GrowthOptions(**options), rng=np.random.default_rng(seed), terminals_mm=terminals
    )
    for _ in growth.steps():
        pass
    return growth, time.process_time() - began


def terminals_of(tree: Tree) -> np.ndarray:
    return tree.position_mm[tree.topology.terminals]


def scaling(counts: Sequence[int] = (500, 2000, 6000, 24_000, 100_000)) -> str:
    """One run per number of terminals; the exponent is that of CPU time from the row before."""
    rows: list[list[object]] = []
    before: tuple[int, float] | None = None
    for n in counts:
        growth, seconds = grow(n)
        exponent = "" if before is None else f"{np.log(seconds / before[1]) / np.log(n / before[0]):.2f}"
        prototype, rivals = PROTOTYPE.get(n), RIVALS.get(n)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        rows.append(
            [f"{n:,}", f"{seconds:.2f}", exponent, f"{1e6 * seconds / n:.0f}", f"{growth.volume_mm3:.1f}",
             f"{peak:.0f}", "" if prototype is None else f"{seconds / prototype[0]:.2f}",
             "" if rivals is None else " / ".join(f"{value / seconds:.0f}" for value in rivals)]
        )  # fmt: skip
        before = n, seconds
    header = ("terminals", "CPU s", "exponent", "us each", "volume mm^3", "peak MB", "of prototype's time",
              "times faster than svv / OpenCCO / ccolab")  # fmt: skip
    return table(header, rows)


def volumes(counts: Sequence[int] = (500, 2000, 6000), seeds: Sequence[int] = (1, 2, 3, 4, 5)) -> str:
    """Mean volume and evenness over seeds."""
    rows = []
    for n in counts:
        trees = [grow(n, seed=seed)[0].tree() for seed in seeds]
        volume = np.array([tree.volume_mm3 for tree in trees])
        even = np.mean([evenness(BOX, terminals_of(tree)) for tree in trees])
        error = volume.std(ddof=1) / np.sqrt(len(seeds)) if len(seeds) > 1 else np.nan
        goal = PROTOTYPE[n][1] if n in PROTOTYPE else np.nan
        rows.append([f"{n:,}", f"{volume.mean():.1f}", f"{error:.1f}", f"{goal:.0f}",
                     f"{volume.mean() / goal - 1:+.1%}", f"{even:.3f}"])  # fmt: skip
    return table(("terminals", "volume mm^3", "standard error", "prototype", "difference", "evenness"), rows)


def rivals(names: Sequence[str] = tuple(RIVAL_VOLUMES), largest: int = 10_000) -> str:
    """Volumes on the terminals that other programs chose, by order of insertion."""
    rows = []
    for name in names:
        path = TERMINALS / f"{name}.csv"
        if not path.exists():
            rows.append([name, "terminals not there", *[""] * 4])
            continue
        points = np.loadtxt(path, delimiter=",", skiprows=1)[: largest + 1]
        root, points = points[0], points[1:]
        orders = {
            "given": [np.arange(len(points))],
            "random": [np.random.default_rng(seed).permutation(len(points)) for seed in range(3)],
            "spread": [spread_order(points, root, np.random.default_rng(1))],
        }
        found = {
            key: np.mean([grow(len(points), root=root, terminals=points[order])[0].volume_mm3 for order in several])
            for key, several in orders.items()
        }
        own = RIVAL_VOLUMES[name]
        best = f"{found['spread'] / own - 1:+.1%}"
        rows.append([name, own, *(f"{value:.1f}" for value in found.values()), best])
    return table(("terminals of", "its own tree", "given order", "random (mean of 3)", "spread", "spread - own"), rows)


def connections(n: int = 6000, counts: Sequence[int] = (2, 4, 8, 16, 32, 64, 128), seeds: int = 3) -> str:
    """The paper's study of the number of connections tried."""
    rows = []
    for n_connections in counts:
        runs = [grow(n, seed=seed, n_connections=n_connections) for seed in range(1, seeds + 1)]
        volume = np.mean([growth.volume_mm3 for growth, _ in runs])
        rows.append([n_connections, f"{volume:.1f}", f"{np.mean([seconds for _, seconds in runs]):.2f}"])
    return table(("connections", f"volume mm^3 at {n:,}", "CPU s"), rows)


def liver(counts: Sequence[int] = (6000, 24_000)) -> str:
    """The bundled liver-like shape."""
    domain = ShapeDomain("liver")
    rows = []
    for n in counts:
        growth, seconds = grow(n, domain=domain, law=PORTAL, root=domain.root_mm)
        rows.append([f"{n:,}", f"{seconds:.2f}", f"{growth.volume_mm3:.0f}"])
    return table(("terminals in the liver", "CPU s", "volume mm^3"), rows)


def apart(counts: Sequence[int] = (500, 2000, 6000)) -> str:
    """Overlapping pairs of vessels, with and without the rule."""
    rows = []
    for n in counts:
        for rule in (0.0, 1.0):
            growth, seconds = grow(n, apart=rule)
            tree = growth.tree()
            rows.append([f"{n:,}", rule, len(overlapping_pairs(tree)), f"{tree.volume_mm3:.1f}", f"{seconds:.2f}"])
    return table(("terminals", "apart", "overlapping pairs", "volume mm^3", "CPU s"), rows)


TABLES: dict[str, Callable[[], str]] = {
    "scaling": scaling, "volumes": volumes, "rivals": rivals, "connections": connections, "liver": liver,
    "apart": apart,
}  # fmt: skip


if __name__ == "__main__":
    grow(30)  # compiles, or loads what is compiled
    main(TABLES, "growth")
