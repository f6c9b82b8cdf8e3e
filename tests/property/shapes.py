"""Trees of any shape for properties: random topology and positions, moved, scaled and numbered anew."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from hypothesis import strategies as st

from vascval.core.tree import Topology


@dataclass(frozen=True)
class Shape:
    """A topology and where its nodes are."""

    topology: Topology
    position_mm: np.ndarray


@st.composite
def shapes(draw: st.DrawFn, *, stems: int = 3, branching: bool = False, most: int = 30) -> Shape:
    """About ``most`` segments, up to ``stems`` of which leave the root; with ``branching`` none has a single child."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    parent = [-1] + [0] * draw(st.integers(1, stems))
    size = draw(st.integers(1, most))
    while len(parent) <= size:
        at = int(rng.integers(1, len(parent)))
        if branching and at not in parent:
            parent += [at] * int(rng.integers(2, 4))
        elif not branching or at in parent:
            parent.append(at)
    topology = Topology(np.array(parent))
    return Shape(topology, rng.normal(size=(topology.n_nodes, 3)) * 10.0 ** draw(st.floats(-1, 2)))


def turned(shape: Shape, rng: np.random.Generator) -> Shape:
    """The shape rotated, perhaps reflected, and shifted by about its own size."""
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    shift = rng.normal(size=3) * np.abs(shape.position_mm).max()
    return replace(shape, position_mm=shape.position_mm @ turn.T + shift)


def numbered_anew(shape: Shape, rng: np.random.Generator) -> tuple[Shape, np.ndarray]:
    """The shape in another root-first numbering, and the old node of each new one."""
    parent, n = shape.topology.parent, shape.topology.n_nodes
    open_ends, order = [0], []
    while open_ends:
        node = open_ends.pop(int(rng.integers(len(open_ends))))
        order.append(node)
        open_ends += [i for i in range(1, n) if parent[i] == node]
    back = np.array(order)
    rank = np.argsort(back)
    new = np.concatenate(([-1], rank[parent[back[1:]]]))
    return Shape(Topology(new), shape.position_mm[back]), back
