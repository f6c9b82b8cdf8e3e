"""A tree as the sweeps of the reduced space take it: the whole, or a part in which the rest stands still.

Few nodes are late to settle, far from each other, in any large tree, and all else in it has settled. The rest then
enters exactly, by two numbers at each node that it springs from: the sum ``base`` of its ``rho^(gamma/4)``, which its
lengths decide, and its volume, which goes with the square of ``r / S^(1/gamma)`` there (every radius in a subtree
scales with that of its first segment).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from generator.geometry import _reduced_kernels as kernels
from generator.geometry.problem import Problem

_HOPS = 4
"""Neighbours of late nodes that move with them: what moves one node moves those so many segments away hardly at all."""


@dataclass(frozen=True, eq=False)
class Network:
    """Root-first arrays of N nodes, named as in :class:`~generator.geometry.problem.Problem`.

    ``base`` (N,) and ``bulk`` (N,), in mm, are what was left out: the sum of ``rho^(gamma/4)`` of the segments that
    spring from a node, and the volume that hangs on them by the square of ``r / S^(1/gamma)``.
    """

    parent: np.ndarray
    moves: np.ndarray
    free: np.ndarray
    below: np.ndarray
    gamma: np.ndarray
    fixed_radius_mm: np.ndarray
    stems: np.ndarray
    stem_loss_pa: np.ndarray
    base: np.ndarray
    bulk: np.ndarray

    @classmethod
    def whole(cls, problem: Problem) -> Network:
        nothing = np.zeros(problem.n_nodes)
        return cls(
            problem.topology.parent, problem.moves, problem.free, problem.below, problem.gamma,
            problem.fixed_radius_mm, problem.stems, problem.stem_loss_pa, nothing, nothing,
        )  # fmt: skip

    def around(
        self, late: np.ndarray, radius: np.ndarray, total: np.ndarray, q: np.ndarray, volume: np.ndarray,
        lump: np.ndarray,
    ) -> tuple[np.ndarray, Network]:  # fmt: skip
        """The part in which ``late`` nodes (N,) bool and their neighbours move; and its nodes' indices here.

        :param radius, total, q, volume, lump: (N,) of a sweep: radii, ``S``, ``rho^(gamma/4)``, the volumes of the
            segments and those of what this network leaves out.
        """
        up = np.maximum(self.parent, 0)
        core = late.copy()
        for _ in range(_HOPS):
            core[up[core]] = True
            core |= core[up]
        core &= self.moves
        kept = core | core[up]
        kept[0] = True
        base, rest = self.base.copy(), lump.copy()
        kernels.leave_out(self.parent, kept, q, volume + lump, base, rest)
        nodes = np.flatnonzero(kept)
        index = np.full(kept.size, -1, np.int32)
        index[nodes] = np.arange(nodes.size, dtype=np.int32)
        parent = index[self.parent[nodes]]
        parent[0] = -1
        bulk = np.zeros(nodes.size)
        held = np.flatnonzero((rest[nodes] > 0.0) & self.free[nodes])
        at = nodes[held]
        bulk[held] = rest[at] * total[at] ** (2.0 / self.gamma[at]) / radius[at] ** 2
        stems = kept[self.stems]
        return nodes, Network(
            parent, core[nodes], self.free[nodes], self.below[nodes], self.gamma[nodes], self.fixed_radius_mm[nodes],
            index[self.stems[stems]], self.stem_loss_pa[stems], base[nodes], bulk,
        )  # fmt: skip
