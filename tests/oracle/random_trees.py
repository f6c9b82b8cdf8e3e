"""Random trees that hypothesis makes and shrinks: any shape, half of them with curved centrelines."""

import numpy as np
from hypothesis import strategies as st

from vascval.core.tree import Topology, Tree


@st.composite
def trees(draw, *, max_segments=24, chains=True):
    """A tree of 1 to ``max_segments`` segments; without ``chains`` every inner node has two children or more."""
    n = draw(st.integers(1, max_segments))
    parent = [-1, *(draw(st.integers(0, i - 1)) for i in range(1, n + 1))]
    if not chains:
        parent = [-1, 0]
        while len(parent) <= n:
            leaf = draw(st.sampled_from([i for i in range(1, len(parent)) if i not in parent]))
            parent += [leaf] * draw(st.integers(2, 4))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    size = len(parent)
    position = rng.normal(size=(size, 3))
    for i in range(1, size):
        position[i] += position[parent[i]]
    radius = rng.uniform(0.05, 0.4, size)
    if not draw(st.booleans()):
        return Tree(Topology(np.array(parent)), position, radius)
    points, offset = [], [0, 0]
    for i in range(1, size):
        inner = rng.integers(0, 5)
        along = np.linspace(0, 1, inner + 2)[1:-1, None]
        bent = position[parent[i]] * (1 - along) + position[i] * along + 0.2 * rng.normal(size=(inner, 3))
        points.append(np.vstack([position[parent[i]], bent, position[i]]))
        offset.append(offset[-1] + inner + 2)
    return Tree(
        Topology(np.array(parent)),
        position,
        radius,
        polyline_mm=np.concatenate(points),
        polyline_offset=np.array(offset),
    )


def children(tree, node):
    return [i for i in range(1, tree.n_nodes) if tree.parent[i] == node]


def order(tree, node):
    """Strahler order by its definition."""
    below = sorted((order(tree, child) for child in children(tree, node)), reverse=True)
    if not below:
        return 1
    return below[0] + (len(below) > 1 and below[0] == below[1])


def generations(tree):
    """Generation of each segment by its definition; 0 at the root point."""
    orders = [order(tree, i) for i in range(tree.n_nodes)]
    top = max(orders[i] for i in children(tree, 0))
    return np.array([0] + [top - orders[i] + 1 for i in range(1, tree.n_nodes)])
