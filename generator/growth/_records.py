"""What the kernels of growth work on: one record per segment, one per visit, and the settings."""

from typing import NamedTuple

import numpy as np

SEGMENT = np.dtype(
    [
        ("parent", "i4"),  # node at the proximal end; the segment that ends there has the same index
        ("child", "i4"),  # first of the segments that spring from the distal end, -1: none
        ("sibling", "i4"),  # next segment that springs from the same node, -1: none
        ("n", "i4"),  # terminals below
        ("stem", "i4"),  # which of the subtrees that hang off the root or the root tree it belongs to
        ("seen", "i4"),  # mark of the last search that met it
        ("ax", "f8"), ("ay", "f8"), ("az", "f8"),  # proximal end
        ("bx", "f8"), ("by", "f8"), ("bz", "f8"),  # distal end
        ("length", "f8"),
        ("rho", "f8"),  # resistance and volume of the subtree, generator.haemodynamics
        ("v", "f8"),
        ("q", "f8"),  # rho^(gamma/4), its part of the parent's s_sum
        ("t", "f8"),  # v sqrt(rho), its part of the parent's t_sum
        ("s_sum", "f8"),  # over the children: S
        ("t_sum", "f8"),
        ("base_rho", "f8"),  # rho and v of what hangs at the distal end: S^(4/gamma), T / S^(2/gamma)
        ("base_v", "f8"),
        ("radius", "f8"),  # as of the last sweep over the whole tree or of its insertion
    ],
    align=True,
)  # fmt: skip

VISIT = np.dtype(
    [
        ("mark", "i4"),  # the new terminal during whose tests it was visited
        ("below", "i4"),  # the segment below on the path of the last visit
        ("rho", "f8"), ("v", "f8"),  # values at that visit
        ("cost", "f8"), ("d_rho", "f8"), ("d_v", "f8"),  # F of the stem there, and its derivatives by rho and v
        ("rr", "f8"), ("vr", "f8"), ("vv", "f8"),  # of the one above by this: d rho/d rho, d v/d rho, d v/d v
    ],
    align=True,
)  # fmt: skip


class Store(NamedTuple):
    """The growing tree. Its first ``n_fixed`` nodes are the root and the root tree.

    ``counts``: nodes, terminals, mark of the last search, points used, points refused since the last terminal, entries
    of ``thick``. ``thick`` lists the vessels whose radius is beyond ``thin[0]``, if vessels must keep apart.
    """

    n_fixed: int
    gamma: float
    segment: np.ndarray
    visit: np.ndarray
    counts: np.ndarray
    thick: np.ndarray
    thin: np.ndarray


class Stems(NamedTuple):
    """The J subtrees that hang off the root tree: uppermost segment, terminals, F.

    ``drop_pa`` is the pressure drop from root to terminals, ``shared[i, j]`` the resistance, kappa l / r^4, of the
    root tree's segments that feed both ``i`` and ``j``: the pressure drop left for ``i`` is
    ``drop_pa - Q_term * sum_j shared[i, j] n[j]``. ``mark``, ``others`` and ``own`` are scratch.
    """

    top: np.ndarray
    n: np.ndarray
    cost: np.ndarray
    shared: np.ndarray
    drop_pa: float
    flow_mm3_s: float
    kappa_pa_s: float
    mark: np.ndarray
    others: np.ndarray
    own: np.ndarray


class Rules(NamedTuple):
    """What a connection must satisfy."""

    n_connections: int
    diameters: float  # shortest length of a segment in units of its diameter
    shortest_mm: float  # shortest length of a segment
    merge_mm: float  # a bifurcation this close to the proximal node becomes a connection to that node; < 0: never
    thinnest_mm: float  # smallest radius of a new terminal
    apart: float  # vessels keep apart by this times the sum of their radii; 0: no such rule
