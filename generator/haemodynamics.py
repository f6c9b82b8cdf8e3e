"""Steady flow in a tree of rigid tubes: Poiseuille, Murray, equal terminal flow and pressure.

Units are g, mm and s, so that pressures are in Pa and Poiseuille's law, ``dp = kappa Q l / r^4`` with
``kappa = 8 eta / pi``, needs no factor. Given the positions, the radii follow: measured in units of its own radius and
of the flow of one terminal, a subtree has the resistance ``rho`` and, over pi, the volume ``v``, ::

    rho_i = n_i l_i + S_i^(4 / gamma)           S_i = sum over the children c of rho_c^(gamma / 4)
    v_i   = l_i + sum_c v_c sqrt(rho_c) / S_i^(2 / gamma)

because equal end pressure makes the radii of siblings proportional to ``rho_c^(1/4)`` and Murray's law fixes their
scale: ``r_c = r_i rho_c^(1/4) / S_i^(1 / gamma)``. The radius of the uppermost segment is then
``(kappa Q_term rho / dp)^(1/4)`` and the tree's volume ``pi sqrt(kappa Q_term / dp) sqrt(rho) v``. Any number of
children is allowed. Segments of length 0 are allowed inside the tree, not at its ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from generator import _haemodynamics_kernels as kernels
from vascval.core.errors import ComputationError, InputError
from vascval.core.ordering import n_terminals_below
from vascval.core.tree import Topology, Tree


@dataclass(frozen=True)
class Perfusion:
    """What drives the flow: pressures at the root and at all terminals, total flow, viscosity, branching exponent.

    :raises InputError: when the pressure does not fall, a value is not positive, or ``gamma`` lies outside 2 to 3.
    """

    root_pressure_pa: float
    terminal_pressure_pa: float
    flow_mm3_s: float
    viscosity_pa_s: float
    gamma: float

    def __post_init__(self) -> None:
        for name in ("root_pressure_pa", "terminal_pressure_pa", "flow_mm3_s", "viscosity_pa_s", "gamma"):
            if not math.isfinite(getattr(self, name)):
                raise InputError(f"{name} is {getattr(self, name)}; a finite number is needed")
        if not self.root_pressure_pa > self.terminal_pressure_pa:
            raise InputError(
                f"the pressure does not fall from the root ({self.root_pressure_pa:g} Pa) to the terminals "
                f"({self.terminal_pressure_pa:g} Pa); raise one or lower the other"
            )
        if not (self.flow_mm3_s > 0 and self.viscosity_pa_s > 0):
            raise InputError(
                f"flow ({self.flow_mm3_s:g} mm^3/s) and viscosity ({self.viscosity_pa_s:g} Pa s) must be positive"
            )
        if not 2.0 <= self.gamma <= 3.0:
            raise InputError(f"gamma is {self.gamma:g}; branching exponents from 2 to 3 are supported")

    @property
    def pressure_drop_pa(self) -> float:
        return self.root_pressure_pa - self.terminal_pressure_pa

    @property
    def kappa_pa_s(self) -> float:
        """Poiseuille's factor ``8 eta / pi``."""
        return 8.0 * self.viscosity_pa_s / math.pi


def perfused_tree(
    topology: Topology,
    position_mm: np.ndarray,
    perfusion: Perfusion,
    fixed_radius_mm: np.ndarray | None = None,
) -> Tree:
    """The tree with the radii that give every terminal the same flow at the same pressure.

    :param position_mm: (N, 3) nodes; segments are straight.
    :param fixed_radius_mm: (N,) radii that are given, NaN where they follow. What is given must be connected to the
        root: a given radius below a free segment is ignored. Murray's law does not hold where given and free meet.
    :returns: with columns ``length_mm``, ``flow_mm3_s``, ``pressure_drop_pa`` and ``pressure_pa``.
    :raises InputError: when the tree has no segment or a terminal has no length.
    :raises ComputationError: when the given radii use up the pressure before the free part begins.
    """
    if topology.n_segments == 0:
        raise InputError("the tree has no segment; there is nothing to perfuse")
    position = np.asarray(position_mm, dtype=np.float64)
    length = np.zeros(topology.n_nodes)
    length[1:] = np.sqrt(((position[1:] - position[topology.parent[1:]]) ** 2).sum(axis=1))
    stubs = topology.terminals[length[topology.terminals] <= 0.0]
    if stubs.size:
        raise InputError(f"{stubs.size} terminals have no length (first: segment {stubs[0]}); move or drop them")
    fixed = np.full(topology.n_nodes, np.nan) if fixed_radius_mm is None else np.asarray(fixed_radius_mm, np.float64)
    below = n_terminals_below(topology).astype(np.float64)
    terminal_flow = perfusion.flow_mm3_s / topology.n_terminals
    flow = below * terminal_flow
    rho, _, total_s = kernels.resistances(topology.parent, length, below, perfusion.gamma)
    kappa = perfusion.kappa_pa_s
    radius, pressure, starved = kernels.radii(
        topology.parent, length, flow, fixed, rho, total_s, terminal_flow, kappa, perfusion.gamma,
        perfusion.root_pressure_pa, perfusion.terminal_pressure_pa,
    )  # fmt: skip
    if starved >= 0:
        raise ComputationError(
            f"the given radii leave no pressure for segment {starved}, which springs at node "
            f"{topology.parent[starved]}; widen the root tree, lower the flow or raise the root pressure"
        )
    drop = np.zeros(topology.n_nodes)
    drop[1:] = kappa * flow[1:] * length[1:] / radius[1:] ** 4
    columns = {"length_mm": length, "flow_mm3_s": flow, "pressure_drop_pa": drop, "pressure_pa": pressure}
    return Tree(topology, position, radius, columns)
