"""Geometry: reduction of the volume, time, and agreement of the two solvers.

``python -m tests.benchmarks.bench_geometry [after_cco|solvers|scaling|domains ...]`` prints tables, all of them without
arguments. Times are CPU seconds of one process. The paper's own studies are in ``reports``.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from generator.config import load
from generator.domain import Domain
from generator.framework import Run
from generator.geometry.admission import Admission
from generator.geometry.full_space import solve_full
from generator.geometry.optimise import optimise
from generator.geometry.problem import Problem, Solution
from generator.geometry.reduced import solve_reduced
from generator.geometry.reduced_model import evaluate
from tests.benchmarks.tables import main, table
from vascval.core.errors import ComputationError

COLUMNS = Sequence[str]


def made(n: int, *changes: str, seed: int = 1, preset: str = "karch-box") -> Run:
    run = Run.of(load(preset, [f"n_terminals={n}", f"seed={seed}", *changes]))
    for _ in run.steps():
        pass
    return run


def grown(n: int, *, seed: int = 1, preset: str = "karch-box", changes: Sequence[str] = ()) -> tuple[Problem, Domain]:
    """The geometry problem of a tree grown by CCO alone, under the defaults."""
    run = made(n, *changes, seed=seed, preset=preset)
    tree = run.growth.tree()
    return Problem(tree.topology, tree.position_mm, run.config.flow(), run.config.physics()), run.domain


def timed(solve: Callable[..., Solution], *given: object, **options: object) -> tuple[Solution, float]:
    began = time.process_time()
    found = solve(*given, **options)
    return found, time.process_time() - began


def less(solution: Solution, begin: Solution) -> str:
    return f"{100 * (1 - solution.cost_mm3 / begin.cost_mm3):.2f}"


def after_cco(counts: Sequence[int] = (500, 2000, 6000, 24_000), seeds: Sequence[int] = (1, 2, 3, 4, 5)) -> str:
    """One geometry stage after growth: the programme alone, contracted to a fixed point, and with splits too."""
    optimise(grown(60)[0])
    rows = []
    for n in counts:
        for seed in seeds:
            problem, _ = grown(n, seed=seed)
            begin = evaluate(problem)
            cells = [f"{n:,}", str(seed), f"{begin.cost_mm3:.1f}"]
            for options in ({"contract": False}, {"splitting": False}, {}):
                found, seconds = timed(optimise, problem, **options)
                many = int((found.problem.topology.n_children[1:] > 2).sum())
                cells += [less(found, begin), str(many), f"{seconds:.2f}"]
            rows.append(cells)
    kinds = ("programme", "contracted", "split")
    head = [f"{kind}: {what}" for kind in kinds for what in ("less volume %", "multifurcations", "s")]
    return table(["terminals", "seed", "CCO mm^3", *head], rows)


def solvers(counts: Sequence[int] = (500, 2000, 6000, 24_000), seeds: Sequence[int] = (1, 2, 3, 4, 5)) -> str:
    """The same programme, with the paper's bound on lengths, by both solvers from the same start; then contracted."""
    rows = []
    for n in counts:
        for seed in seeds if n <= 2000 else seeds[:1]:
            problem, _ = grown(n, seed=seed)
            reduced, quick = timed(solve_reduced, problem)
            full, slow = timed(solve_full, problem)
            both = [f"{found.cost_mm3:.4f}" for found in (reduced, full)]
            end = apart(optimise(problem), optimise(problem, solver="ipopt")) if n <= 2000 else ""
            times = [f"{quick:.2f}", f"{slow:.2f}", str(full.n_iterations)]
            rows.append([f"{n:,}", str(seed), *both, apart(reduced, full), f"{full.residual:.0e}", *times, end])
    head = ["reduced mm^3", "Ipopt mm^3", "apart", "forces, Ipopt", "s", "s, Ipopt", "iterations, Ipopt"]
    return table(["terminals", "seed", *head, "apart, contracted"], rows)


def apart(first: Solution, second: Solution) -> str:
    return f"{abs(first.cost_mm3 / second.cost_mm3 - 1):.1e}"


def scaling(counts: Sequence[int] = (1000, 6000, 24_000, 100_000, 1_000_000)) -> str:
    """Time of one programme against the number of terminals; memory is the process's peak so far.

    The bound on lengths is 0.2 mm at 6,000 terminals and goes with their spacing, so that all sizes are one problem:
    held at 0.2 mm it would bind for 3 % of the segments at 6,000 terminals and for 15 % at 100,000.
    """
    solve_reduced(grown(60)[0])
    rows = []
    for n in counts:
        problem, _ = grown(n)
        spaced = replace(problem.physics, l_min_mm=problem.physics.l_min_mm * (6000 / n) ** (1 / 3))
        problem = replace(problem, physics=spaced)
        begin = evaluate(problem)
        began = time.perf_counter()
        found, seconds = timed(solve_reduced, problem)
        wall = time.perf_counter() - began
        each = 1e6 * seconds / n
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        costs = [f"{seconds:.2f}", f"{wall:.2f}", f"{each:.0f}", f"{peak:.2f}"]
        rows.append([f"{n:,}", less(found, begin), str(found.n_iterations), *costs])
    head = ["terminals", "less volume %", "steps of the whole", "CPU s", "wall s", "us per terminal"]
    return table([*head, "peak GiB"], rows)


def domains(counts: Sequence[int] = (500, 2000)) -> str:
    """What staying inside, and apart, costs: the optimum with it against the optimum without."""
    cases = {
        "horseshoe": ("portal-vein", ("domain.shape=horseshoe",)),
        "liver": ("portal-vein", ("domain.shape=liver",)),
        "box, apart": ("karch-box", ("growth.avoid_intersections=true",)),
    }
    rows = []
    for name, (preset, changes) in cases.items():
        for n in counts:
            problem, domain = grown(n, preset=preset, changes=changes)
            begin = evaluate(problem)
            free, quick = timed(optimise, problem)
            admission = Admission(domain, 1.0 if "apart" in name else 0.0)
            try:
                kept, slow = timed(optimise, problem, admission=admission)
            except ComputationError as error:
                rows.append([name, f"{n:,}", less(free, begin), str(error)[:40], "", "", "", ""])
                continue
            wrong = [int(admission.offending(found.problem, found.tree).sum()) for found in (free, kept)]
            rows.append(
                [name, f"{n:,}", less(free, begin), less(kept, begin), *map(str, wrong), f"{quick:.2f}", f"{slow:.2f}"]
            )
    head = ["less % without", "with", "offending without", "with", "s without", "with"]
    return table(["domain", "terminals", *head], rows)


TABLES: dict[str, Callable[..., str]] = {
    function.__name__: function for function in (after_cco, solvers, scaling, domains)
}


if __name__ == "__main__":
    main(TABLES, "geometry")
