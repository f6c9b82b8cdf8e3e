"""Geometry as a stage of making a tree: now and then while it grows, and at the end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from generator.config import Config
from generator.domain import Domain
from generator.geometry.admission import Admission
from generator.geometry.optimise import optimise, relax
from generator.geometry.problem import Problem, Solution
from generator.growth.root_tree import RootTree
from vascval.core.tree import Topology


class GeometryStage:
    """What a configuration asks of the geometry; ``solves`` counts the optimisations.

    Trees come as ``parent`` and ``position_mm`` with the root tree's nodes first.
    """

    def __init__(self, config: Config, domain: Domain, root_tree: RootTree) -> None:
        self.config, self.root_tree = config, root_tree
        self.admission = Admission(domain, 1.0 if config.growth.avoid_intersections else 0.0)
        self.solves = 0

    def problem(self, parent: np.ndarray, position_mm: np.ndarray) -> Problem:
        radius = np.full(parent.size, np.nan)
        radius[: self.root_tree.radius_mm.size] = self.root_tree.radius_mm
        return Problem(Topology(parent), position_mm, self.config.flow(), self.config.physics(), fixed_radius_mm=radius)

    @property
    def during_growth(self) -> bool:
        """Where vessels keep apart, radii that change by optimisation would make too many overlap: only at the end."""
        return self.config.geometry.during_growth and self.admission.apart == 0.0

    def relax(self, parent: np.ndarray, position_mm: np.ndarray) -> np.ndarray:
        """Positions (N, 3) of nearly least volume for a tree that grows on; thin segments may yet become thick."""
        self.solves += 1
        problem = self.problem(parent, position_mm)
        problem = replace(problem, physics=replace(problem.physics, r_min_mm=0.0))
        return relax(problem, solver=self.config.geometry.solver, admission=self.admission).position_mm

    def finish(self, parent: np.ndarray, position_mm: np.ndarray) -> Solution:
        """The optimal geometry of the grown tree, its multifurcations found.

        :raises ComputationError: when it cannot be found, or the bounds cannot be held.
        """
        self.solves += 1
        given = self.config.geometry
        return optimise(
            self.problem(parent, position_mm), solver=given.solver, admission=self.admission, contract=given.contract,
            splitting=given.split,
        )  # fmt: skip
