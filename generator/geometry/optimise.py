"""The geometry stage: optimise, contract what is degenerate, optimise again, until nothing is; then try to split."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np

from generator.geometry.admission import Admission, admitted, begun
from generator.geometry.full_space import solve_full
from generator.geometry.junctions import contracted, split
from generator.geometry.problem import Problem, Solution
from generator.geometry.reduced import ReducedOptions, solve_reduced
from vascval.core.errors import ComputationError

_CONTRACTIONS = 50
_SPLITS = 3
_COLD = ReducedOptions()
_ROUGH_COLD = ReducedOptions(smoothing=_COLD.smoothing[:-2], tolerance=_COLD.rough, violation=_COLD.rough)
_ROUGH = ReducedOptions(smoothing=(0.015,), tolerance=_COLD.rough, violation=_COLD.rough)
_CLOSE = ReducedOptions(smoothing=(0.005,), tolerance=1e-2, violation=1e-2)
_FINE = ReducedOptions(smoothing=(0.001,))
_WORTH = 1e-4
"""Smallest relative gain for which a round of splitting is kept."""
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
    ``splitting``: junctions whose splitting pays to first order are split, and what comes of it is kept if it is
    better.

    :raises ComputationError: when a solver fails, or the tree is not admissible at the start or at the end.
    """
    admission = admission or Admission()
    solution = _optimised(problem, solver, admission, contract, splitting)
    bad = np.flatnonzero(admission.offending(solution.problem, solution.tree))
    if bad.size:
        raise ComputationError(
            f"{bad.size} segments leave the domain once the geometry is optimised (first: segment {bad[0]}): segments "
            f"of {problem.physics.l_min_mm:g} mm or more do not fit everywhere; lower geometry.l_min_mm"
        )
    return solution


def _optimised(problem: Problem, solver: Solver, admission: Admission, contract: bool, splitting: bool) -> Solution:
    if not contract:
        return admitted(problem, admission, _solver(solver, _COLD))
    close, fine = (_solver(solver, options) for options in (_CLOSE, _FINE))
    solution = _contract(admitted(problem, admission, _solver(solver, _ROUGH_COLD)), close, admission, 2)
    for _ in range(_SPLITS if splitting else 0):
        trial = split(solution)
        if trial is None or (not admission.always and admission.offending(trial, begun(trial).tree).any()):
            break
        better = _contract(admitted(trial, admission, close), close, admission, 1)
        if not better.cost_mm3 < solution.cost_mm3 * (1.0 - _WORTH):
            break
        solution = better
    for solve in (close, fine):
        again = replace(solution.problem, position_mm=solution.position_mm, pull=solution.pull)
        solution = admitted(again, admission, solve)
        solution = _contract(solution, solve, admission, _CONTRACTIONS)
    if _admissible_contraction(solution, admission) is not None:
        raise ComputationError(
            f"segments are still degenerate after {_CONTRACTIONS} contractions of the geometry; check the tree for "
            "clusters of terminals that nearly coincide"
        )
    return solution


def relax(problem: Problem, *, solver: Solver = "reduced", admission: Admission | None = None) -> Solution:
    """A nearly optimal geometry of the same topology, for a tree that grows on."""
    return admitted(problem, admission or Admission(), _solver(solver, _ROUGH))


def _solver(solver: Solver, options: ReducedOptions) -> Callable[[Problem], Solution]:
    return solve_full if solver == "ipopt" else partial(solve_reduced, options=options)


def _contract(solution: Solution, solve: Callable[[Problem], Solution], admission: Admission, times: int) -> Solution:
    """Contract what is degenerate and optimise again, until nothing is, but at most so many times."""
    for _ in range(times):
        smaller = _admissible_contraction(solution, admission)
        if smaller is None:
            break
        solution = admitted(smaller, admission, solve)
    return solution


def _admissible_contraction(solution: Solution, admission: Admission) -> Problem | None:
    """The tree contracted as far as it stays admissible; ``None``: not at all."""
    keep = np.zeros(solution.problem.n_nodes, bool)
    while (made := contracted(solution, keep)) is not None:
        smaller, heir = made
        if admission.always:
            return smaller
        bad = np.flatnonzero(admission.offending(smaller, begun(smaller).tree))
        if bad.size == 0:
            return smaller
        touched = np.zeros(smaller.n_nodes, bool)
        touched[bad] = True
        touched[smaller.topology.parent[bad]] = True
        merged = np.bincount(heir, minlength=smaller.n_nodes) > 1
        members = (touched & merged)[heir] & ~keep
        keep |= members if members[1:].any() else True
    return None
