"""The geometry stage: optimise, contract what is degenerate, optimise again, until nothing is; then try to split."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from generator.geometry.admission import Admission, admitted
from generator.geometry.full_space import solve_full
from generator.geometry.junctions import contracted, split
from generator.geometry.problem import Problem, Solution
from generator.geometry.reduced import ReducedOptions, evaluate, solve_reduced
from vascval.core.errors import ComputationError

_CONTRACTIONS = 50
_SPLITS = 3
_WARM = ReducedOptions(smoothing=(0.015, 0.001))
Solver = Literal["reduced", "ipopt"]


def optimise(
    problem: Problem,
    *,
    solver: Solver = "reduced",
    admission: Admission | None = None,
    contract: bool = True,
    splitting: bool = True,
) -> Solution:
    """The optimal geometry with its multifurcations.

    ``contract``: degenerate segments are contracted and the geometry is optimised again to a fixed point;
    ``splitting``: junctions whose splitting pays to first order are split, and what comes of it is kept if it is better.

    :raises ComputationError: when a solver fails, or the tree is not admissible at the start.
    """
    admission = admission or Admission()
    solution = admitted(problem, admission, _solve(solver, warm=False))
    if not contract:
        return solution
    solution = _fixed_point(solution, solver, admission)
    for _ in range(_SPLITS if splitting else 0):
        trial = split(solution)
        if trial is None or admission.offending(evaluate(trial).tree).any():
            break
        better = _fixed_point(admitted(trial, admission, _solve(solver, warm=True)), solver, admission)
        if not better.cost_mm3 < solution.cost_mm3 * (1.0 - 1e-7):
            break
        solution = better
    return solution


def _solve(solver: Solver, *, warm: bool) -> Callable[[Problem], Solution]:
    if solver == "ipopt":
        return solve_full
    return lambda problem: solve_reduced(problem, _WARM if warm else None)


def _fixed_point(solution: Solution, solver: Solver, admission: Admission) -> Solution:
    for _ in range(_CONTRACTIONS):
        smaller = _admissible_contraction(solution, admission)
        if smaller is None:
            return solution
        solution = admitted(smaller, admission, _solve(solver, warm=True))
    raise ComputationError(
        f"segments still degenerate after {_CONTRACTIONS} contractions of the geometry; check the tree for clusters of "
        "terminals that nearly coincide"
    )


def _admissible_contraction(solution: Solution, admission: Admission) -> Problem | None:
    """The tree contracted as far as it stays admissible; ``None``: not at all."""
    keep = np.zeros(solution.problem.n_nodes, bool)
    while (made := contracted(solution, keep)) is not None:
        smaller, heir = made
        if admission.always:
            return smaller
        bad = np.flatnonzero(admission.offending(evaluate(smaller).tree))
        if bad.size == 0:
            return smaller
        touched = np.zeros(smaller.n_nodes, bool)
        touched[bad] = True
        touched[smaller.topology.parent[bad]] = True
        merged = np.bincount(heir, minlength=smaller.n_nodes) > 1
        members = (touched & merged)[heir] & ~keep
        keep |= members if members[1:].any() else True
    return None
