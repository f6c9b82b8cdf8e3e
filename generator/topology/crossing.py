"""The best of several trees of the same terminals takes over subtrees of the others.

Trees that searches end with are equally good in different places. A subtree of another tree is put together in the best
one from the same terminals, the whole tree relaxed, and kept if its volume is less: the crossing of genetic algorithms
that prunes, deletes and grafts, as for phylogenetic trees (Matsuda 1996).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from generator._domain_kernels import Space
from generator.topology import _crossing_kernels as kernels
from generator.topology._relax_kernels import polish
from generator.topology._state_kernels import sweep
from generator.topology.state import SearchTree

_NEAREST = 2
"""Segments tried for a subtree to spring from, besides where it is."""
_EPS = 0.01
"""Smoothing of lengths, in mean lengths of a segment."""
_TOGETHER = 50


def cross(
    tree: SearchTree, space: Space, donors: Sequence[np.ndarray], most: int, rng: np.random.Generator
) -> Iterator[float]:
    """Subtrees of ``donors`` in ``tree``, in any order, at most so many; C every now and then, and in the end.

    :param tree: the best tree; it changes.
    :param donors: records of the other trees, numbered as those of ``tree``.
    """
    state, flat = tree.state, tree.flat
    size, eps = state.node.size, _EPS * tree.mean_length_mm
    below, place = np.zeros(size, np.int32), np.zeros(size, np.int32)
    nearest, apart = np.zeros(_NEAREST, np.int64), np.zeros(_NEAREST)
    cost = sweep(state, flat.order)
    subtrees = [
        (donor, top)
        for donor in donors
        for top in np.flatnonzero((donor["first"] >= 0) & (donor["parent"] >= state.n_fixed))
    ]
    for k, number in enumerate(rng.permutation(len(subtrees))[:most], 1):
        donor, top = subtrees[number]
        cost = kernels.cross(state, flat, space, donor, top, eps, below, place, nearest, apart, cost)
        if k % _TOGETHER == 0:
            yield cost
    if space.convex:
        cost = polish(state, flat, 0.3 * tree.mean_length_mm, 3e-4 * tree.mean_length_mm, 1e-5)
    yield cost
