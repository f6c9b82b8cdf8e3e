"""The tree that a search works on: made from a grown tree, read back as one."""

from __future__ import annotations

import numpy as np

from generator.growth.root_tree import RootTree
from generator.haemodynamics import Perfusion
from generator.topology._relax_kernels import Flat
from generator.topology._state_kernels import NODE, State
from vascval.core.errors import InputError
from vascval.core.ordering import root_first
from vascval.core.tree import Topology

SHORTEST_MM = 0.2


class SearchTree:
    """A tree whose topology may change, its root tree and terminals apart.

    Junctions of more than two branches are written as bifurcations joined by segments of length 0.

    :param parent: (N,) root first, the root tree's nodes before all others; ``position_mm``: (N, 3).
    :param shortest_mm: terminals are made no shorter than this, the paper's ``l_min``.
    :raises InputError: when a node has a single branch, or an end of the root tree none.
    """

    def __init__(
        self, parent: np.ndarray, position_mm: np.ndarray, root_tree: RootTree, perfusion: Perfusion,
        shortest_mm: float = SHORTEST_MM,
    ) -> None:  # fmt: skip
        Topology(parent)
        fixed = root_tree.parent.size
        links, position = _bifurcating(np.asarray(parent), np.asarray(position_mm, np.float64), fixed)
        size = links.shape[0]
        node = np.zeros(size, NODE)
        node["parent"], node["first"], node["second"] = links.T
        node["x"], node["y"], node["z"] = position.T
        ends = root_tree.open_nodes
        bare = ends[node["first"][ends] < 0]
        if bare.size:
            raise InputError(f"no vessel springs at end {bare[0]} of the root tree; let the tree grow first")
        self.n_terminals = int((node["first"][fixed:] < 0).sum())
        flow = perfusion.flow_mm3_s / self.n_terminals
        stem_at = np.full(fixed, -1, np.int32)
        stem_at[ends] = np.arange(ends.size)
        self._scale_mm3 = np.pi * np.sqrt(perfusion.kappa_pa_s * flow)
        self.state = State(
            n_fixed=fixed,
            gamma=float(perfusion.gamma),
            shortest=float(shortest_mm),
            node=node,
            ends=ends.astype(np.int32),
            stem_at=stem_at,
            drop_pa=float(perfusion.pressure_drop_pa),
            shared=perfusion.kappa_pa_s * flow * root_tree.shared_resistance(),
            share=np.zeros(ends.size),
            counts=np.zeros(4, np.int64),
            journal=np.zeros(size, NODE),
            journal_at=np.zeros(size, np.int32),
            path_a=np.zeros(size, np.int32),
            path_b=np.zeros(size, np.int32),
        )
        self.flat = _work_space(size)

    def volume_mm3(self, cost: float) -> float:
        """Volume of all but the root tree where C is ``cost``."""
        return float(self._scale_mm3 * np.exp(cost))

    @property
    def mean_length_mm(self) -> float:
        node = self.state.node[self.state.n_fixed :]
        return float(node["length"].mean())

    def adopt(self, node: np.ndarray) -> None:
        """Become the tree of these records, which another search of the same terminals may have made: the numbers of
        its tests mean nothing here."""
        self.state.node[:] = node
        self.state.node["saved"] = self.state.node["seen"] = 0

    def takes(self, node: np.ndarray) -> bool:
        """Whether these records are a sound tree of the same terminals and root tree: kernels trust their indices."""
        have, fixed, index = self.state.node, self.state.n_fixed, np.arange(node.size)
        parent, first, second = node["parent"], node["first"], node["second"]
        if not all(np.isfinite(node[name]).all() for name in NODE.names or () if NODE[name] == np.float64):
            return False
        for child in (first, second):
            named = np.flatnonzero(child >= 0)
            if child.min() < -1 or child.max() >= node.size or (parent[child[named]] != named).any():
                return False
        try:
            root_first(parent)
        except InputError:
            return False
        above = parent[fixed:]
        inner = have["first"] >= 0
        return bool(
            (parent[:fixed] == have["parent"][:fixed]).all()
            and ((first >= 0) == inner).all()
            and ((second >= 0)[fixed:] == inner[fixed:]).all()
            and (second[:fixed] < 0).all()
            and ((first[above] == index[fixed:]) | (second[above] == index[fixed:])).all()
            and (node["n"][fixed:] >= 1).all()
        )

    def arrays(self, node: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """``parent`` (N,) and ``position_mm`` (N, 3), root first, the root tree's nodes before all others; of the
        tree as it is, or as these records have it."""
        node = self.state.node if node is None else node
        fixed = self.state.n_fixed
        order = root_first(node["parent"])
        order = np.concatenate((np.arange(fixed), order[order >= fixed]))
        rank = np.empty(order.size, np.int32)
        rank[order] = np.arange(order.size)
        parent = node["parent"][order]
        parent[1:] = rank[parent[1:]]
        return parent, np.column_stack([node[name][order] for name in ("x", "y", "z")])


def _bifurcating(parent: np.ndarray, position: np.ndarray, fixed: int) -> tuple[np.ndarray, np.ndarray]:
    """(M, 3) parent, first and second child of every node, and (M, 3) positions, with nodes added where more branch."""
    children: list[list[int]] = [[] for _ in parent]
    for i in range(fixed, parent.size):
        children[parent[i]].append(i)
    single = [i for i in range(fixed, parent.size) if len(children[i]) == 1]
    if single:
        raise InputError(f"{len(single)} nodes have a single branch (first: node {single[0]}); join the two segments")
    links = np.full((parent.size, 3), -1, np.int32)
    links[:, 0] = parent
    added: list[tuple[int, int, int]] = []
    at: list[int] = []

    def add(above: int, members: list[int], place: int) -> int:
        """A node below ``above`` at ``place`` from which ``members`` spring."""
        new = parent.size + len(added)
        added.append((above, members[0], members[1]))
        at.append(place)
        for member in members:
            if member < parent.size:
                links[member, 0] = new
            else:
                added[member - parent.size] = (new, *added[member - parent.size][1:])
        return new

    for i, members in enumerate(children):
        room = 1 if i < fixed else 2
        while len(members) > room:
            members = [*members[:-2], add(i, members[-2:], i)]
        for k, member in enumerate(members):
            links[i, 1 + k] = member
    if added:
        links = np.vstack((links, np.array(added, np.int32)))
        position = np.vstack((position, position[at]))
    return links, position


def _work_space(size: int) -> Flat:
    kinds = {"order": np.int32, "room": np.int32, "rank": np.int32, "parent": np.int32, "moves": np.bool_}
    wide = {"position": 3, "trial": 3, "gradient": 3, "direction": 3, "block": 6, "diagonal": 6}
    return Flat(
        **{
            name: np.zeros((size, wide[name]) if name in wide else size, kinds.get(name, np.float64))
            for name in Flat._fields
        }
    )
