"""The geometry problem of the paper's section 2.3.1, for one topology, as both solvers take it.

Least volume over the positions of the inner nodes, the radii, the lengths and the pressures, ::

    min  sum over segments of pi l r^2
    l = |x_u - x_v|         r_p^gamma = sum over children of r_c^gamma         p_u - p_v = kappa Q l / r^4

at given flows, with the pressure given at the root and at all terminals, the terminals and the root at their places,
and a root tree, if there is one, with its nodes and radii. Murray's law is not asked for at the nodes of the root tree
nor at the root point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from generator.geometry.viscosity import fahraeus_lindqvist_pa_s
from generator.geometry.walls import Walls
from generator.haemodynamics import Perfusion
from vascval.core.errors import ComputationError, InputError
from vascval.core.ordering import generation, n_terminals_below
from vascval.core.tree import Topology, Tree


@dataclass(frozen=True)
class Physics:
    """What beside Poiseuille and Murray decides the geometry.

    * ``viscosity``: constant, or by radius (paper, formula (2));
    * ``gamma_by_generation``: branching exponents for the nodes at the end of segments of Strahler generation 1, 2,
      ..., the last for all later ones; empty: the perfusion's;
    * ``objective``: ``volume``, at given root pressure; or ``volume+power``, in which the root pressure is free and the
      power that moves the blood, ``Q (p_root - p_term)``, counts as ``power / metabolic_pa_s`` cubic millimetres. At a
      given root pressure that power is a constant and would change nothing.
    * ``metabolic_pa_s``: power that a volume of blood costs to keep (648 W/m^3 = 648 Pa/s).
    * ``l_min_mm``, ``r_min_mm``: lower bounds on free segments; 0: none.

    :raises InputError: when a value makes no sense.
    """

    viscosity: Literal["constant", "fahraeus-lindqvist"] = "constant"
    gamma_by_generation: tuple[float, ...] = ()
    objective: Literal["volume", "volume+power"] = "volume"
    metabolic_pa_s: float = 648.0
    l_min_mm: float = 0.2
    r_min_mm: float = 0.0

    def __post_init__(self) -> None:
        for name in ("l_min_mm", "r_min_mm"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise InputError(f"{name} is {value}; a finite number of 0 or more is needed")
        if not (np.isfinite(self.metabolic_pa_s) and self.metabolic_pa_s > 0.0):
            raise InputError(f"metabolic_pa_s is {self.metabolic_pa_s}; a positive number is needed")
        if not all(2.0 <= value <= 3.0 for value in self.gamma_by_generation):
            raise InputError(f"gamma_by_generation is {self.gamma_by_generation}; exponents from 2 to 3 are supported")


@dataclass(frozen=True, eq=False)
class Problem:
    """A tree whose geometry is to be optimised.

    * ``position_mm`` (N, 3): where the search begins, and where the nodes that stay are;
    * ``fixed_radius_mm`` (N,): the radii of the root tree, NaN elsewhere; ``None``: no root tree;
    * ``held`` (N,) bool: further nodes that stay where they are; ``None``: none;
    * ``pull`` (N,): a first guess of the forces, in mm^2, with which the lower bound on lengths holds segments;
      ``None``: zeros.
    * ``walls``: planes that segments keep to one side of; ``None``: none.

    :raises InputError: when shapes or values make no sense, or the root tree is not connected to the root.
    :raises ComputationError: when the root tree uses up the pressure.
    """

    topology: Topology
    position_mm: np.ndarray
    perfusion: Perfusion
    physics: Physics = Physics()
    fixed_radius_mm: np.ndarray = None  # type: ignore[assignment]
    held: np.ndarray = None  # type: ignore[assignment]
    pull: np.ndarray = None  # type: ignore[assignment]
    walls: Walls | None = None

    def __post_init__(self) -> None:
        n = self.topology.n_nodes
        if self.topology.n_segments == 0:
            raise InputError("the tree has no segment; there is no geometry to optimise")
        position = np.array(self.position_mm, dtype=np.float64)
        if position.shape != (n, 3):
            raise InputError(f"positions have shape {position.shape}; ({n}, 3) is needed")
        _refuse(~np.isfinite(position).all(axis=1), "nodes have a position that is not finite", "node")
        radius = np.full(n, np.nan) if self.fixed_radius_mm is None else np.array(self.fixed_radius_mm, np.float64)
        held = np.zeros(n, bool) if self.held is None else np.array(self.held, bool)
        pull = np.zeros(n) if self.pull is None else np.array(self.pull, np.float64)
        if radius.shape != (n,) or held.shape != (n,) or pull.shape != (n,):
            raise InputError(
                f"fixed_radius_mm, held and pull have shapes {radius.shape}, {held.shape} and {pull.shape}; "
                f"({n},) is needed"
            )
        radius[0] = np.nan
        _refuse(radius <= 0.0, "fixed radii are not positive", "segment")
        fixed = ~np.isnan(radius)
        loose = fixed & ~(fixed | (np.arange(n) == 0))[self.topology.parent]
        _refuse(loose, "fixed segments spring from a free one", "segment")
        for name, values in (("position_mm", position), ("fixed_radius_mm", radius), ("held", held), ("pull", pull)):
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        _ = self.stem_loss_pa
        longest = 2.0 * float(self.lengths(position).max())
        if self.physics.l_min_mm > longest:
            raise ComputationError(
                f"l_min {self.physics.l_min_mm:g} mm cannot be held: segments are allowed {longest:.4g} mm, twice the "
                "longest at the start; lower l_min_mm"
            )
        rigid = self.free & ~self.bounded & ~held & ~held[self.topology.parent]
        short = np.flatnonzero(rigid & (self.lengths(position) < self.physics.l_min_mm))
        if short.size:
            raise ComputationError(
                f"{short.size} segments between two given points are shorter than l_min {self.physics.l_min_mm:g} mm "
                f"(first: segment {short[0]}); lower l_min_mm or move the points"
            )

    @property
    def n_nodes(self) -> int:
        return self.topology.n_nodes

    @cached_property
    def below(self) -> np.ndarray:
        """(N,) number of terminals below each segment."""
        return n_terminals_below(self.topology).astype(np.float64)

    @property
    def terminal_flow_mm3_s(self) -> float:
        return self.perfusion.flow_mm3_s / self.topology.n_terminals

    @cached_property
    def free(self) -> np.ndarray:
        """(N,) bool: segments whose radius follows."""
        free = np.isnan(self.fixed_radius_mm)
        free[0] = False
        return free

    @cached_property
    def moves(self) -> np.ndarray:
        """(N,) bool: nodes whose position is a variable: inner ends of free segments that are not held."""
        return self.free & (self.topology.n_children > 0) & ~self.held

    @cached_property
    def bounded(self) -> np.ndarray:
        """(N,) bool: segments to whose length the lower bound applies: those that an end can change."""
        return self.free & (self.moves | self.moves[self.topology.parent])

    @cached_property
    def stems(self) -> np.ndarray:
        """(J,) free segments that spring from the root point or the root tree."""
        return np.flatnonzero(self.free & ~self.free[np.maximum(self.topology.parent, 0)])

    @cached_property
    def gamma(self) -> np.ndarray:
        """(N,) branching exponent at each node."""
        values = self.physics.gamma_by_generation or (self.perfusion.gamma,)
        index = np.clip(generation(self.topology), 1, len(values)) - 1
        return np.asarray(values, dtype=np.float64)[index]

    @cached_property
    def fixed_pressure_loss_pa(self) -> np.ndarray:
        """(N,) pressure lost from the root to each node of the root tree; 0 elsewhere."""
        loss = np.zeros(self.n_nodes)
        radius, parent = self.fixed_radius_mm, self.topology.parent
        for i in np.flatnonzero(~self.free)[1:]:
            eta = self.perfusion.viscosity_pa_s
            if self.physics.viscosity != "constant":
                eta = float(fahraeus_lindqvist_pa_s(radius[i]))
            length = float(np.sqrt(((self.position_mm[i] - self.position_mm[parent[i]]) ** 2).sum()))
            flow = self.below[i] * self.terminal_flow_mm3_s
            loss[i] = loss[parent[i]] + 8.0 * eta / np.pi * flow * length / radius[i] ** 4
        return loss

    @cached_property
    def stem_loss_pa(self) -> np.ndarray:
        """(J,) pressure lost in the root tree before each stem."""
        loss = self.fixed_pressure_loss_pa[self.topology.parent[self.stems]]
        short = np.flatnonzero(loss >= self.perfusion.pressure_drop_pa)
        if short.size and self.physics.objective == "volume":
            drop = self.perfusion.pressure_drop_pa
            raise ComputationError(
                f"the root tree contradicts the flow: it uses up {loss[short[0]]:.4g} of {drop:.4g} Pa before segment "
                f"{self.stems[short[0]]}; widen it, lower the flow or raise the root pressure"
            )
        return loss

    def lengths(self, position_mm: np.ndarray) -> np.ndarray:
        """(N,) lengths of the segments, entry 0 being 0."""
        length = np.zeros(self.n_nodes)
        length[1:] = np.sqrt(((position_mm[1:] - position_mm[self.topology.parent[1:]]) ** 2).sum(axis=1))
        return length

    def at(self, position_mm: np.ndarray) -> Problem:
        """The same problem, begun from elsewhere."""
        return replace(self, position_mm=position_mm)

    def at_given_pressure(self) -> Problem:
        """The same problem with volume alone as its objective."""
        return replace(self, physics=replace(self.physics, objective="volume"))


def _refuse(bad: np.ndarray | np.bool_, what: str, kind: str) -> None:
    ids: Sequence[int] = np.flatnonzero(bad).tolist()
    if ids:
        raise InputError(f"{len(ids)} {what} (first: {kind} {ids[0]}); mend the tree before its geometry is optimised")


@dataclass(frozen=True, eq=False)
class Solution:
    """An optimised geometry.

    ``cost_mm3`` is the objective (the volume, unless power counts too), ``residual`` the largest force left at a node
    relative to the sum of those that pull at it, ``violation`` the largest relative violation of the lower bound on
    lengths, ``pull`` (N,) the force, in mm^2, with which it holds each segment.
    """

    problem: Problem
    position_mm: np.ndarray
    tree: Tree
    cost_mm3: float
    residual: float
    violation: float
    n_iterations: int
    pull: np.ndarray
