"""Grown trees obey the laws of flow: shown by solving the network of tubes anew, from its radii and lengths alone."""

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

from generator.domain import Box
from generator.domain_shapes import ShapeDomain
from generator.growth.growth import Growth, GrowthOptions
from generator.growth.root_tree import RootTree
from generator.haemodynamics import Perfusion, perfused_tree
from vascval.core.errors import ComputationError, InputError
from vascval.core.tree import Topology, Tree
from vascval.io.trees import read_tree, write_vtp

EXACT = 1e-9  # the bound that is promised; rounding along some 100 segments in series leaves about 1e-12


def perfusion(gamma: float = 2.55) -> Perfusion:
    return Perfusion(13332.2, 7999.3, 8333.3, 3.6e-3, gamma)


def grown(gamma: float = 2.55, n: int = 300, domain=None, root=None, **options) -> Tree:
    domain = domain or Box((90.0, 70.0, 16.0))
    root = np.zeros(3) if root is None else root
    growth = Growth(domain, perfusion(gamma), root, n, options=GrowthOptions(**options), rng=np.random.default_rng(3))
    for _ in growth.steps():
        pass
    return growth.tree()


def solved(tree: Tree, law: Perfusion) -> tuple[np.ndarray, np.ndarray]:
    """Pressure at every node and flow through every segment, from Kirchhoff's law with the end pressures given."""
    n = tree.n_nodes
    child, above = np.arange(1, n), np.asarray(tree.parent[1:])
    length = np.linalg.norm(tree.position_mm[child] - tree.position_mm[above], axis=1)
    conductance = np.pi * tree.radius_mm[1:] ** 4 / (8 * law.viscosity_pa_s * length)
    rows = np.concatenate((child, above, child, above))
    columns = np.concatenate((child, above, above, child))
    values = np.concatenate((conductance, conductance, -conductance, -conductance))
    matrix = coo_matrix((values, (rows, columns)), shape=(n, n)).tocsr()
    pressure = np.full(n, np.nan)
    pressure[0] = law.root_pressure_pa
    pressure[tree.topology.terminals] = law.terminal_pressure_pa
    known = np.flatnonzero(~np.isnan(pressure))
    free = np.flatnonzero(np.isnan(pressure))
    if free.size:
        pressure[free] = spsolve(matrix[free][:, free].tocsc(), -matrix[free][:, known] @ pressure[known])
    flow = np.zeros(n)
    flow[1:] = conductance * (pressure[above] - pressure[child])
    return pressure, flow


def check(tree: Tree, law: Perfusion, fixed=()) -> None:
    pressure, flow = solved(tree, law)
    terminals = tree.topology.terminals
    assert flow[terminals] == pytest.approx(law.flow_mm3_s / terminals.size, rel=EXACT)
    assert flow[1:] == pytest.approx(tree.columns["flow_mm3_s"][1:], rel=EXACT)
    assert pressure == pytest.approx(tree.columns["pressure_pa"], abs=EXACT * law.pressure_drop_pa)
    drop = pressure[tree.parent[1:]] - pressure[1:]
    assert drop == pytest.approx(tree.columns["pressure_drop_pa"][1:], abs=EXACT * law.pressure_drop_pa)
    powers = np.bincount(tree.parent[1:], weights=tree.radius_mm[1:] ** law.gamma, minlength=tree.n_nodes)
    junctions = np.setdiff1d(np.flatnonzero(tree.topology.n_children > 0), [0, *fixed])
    assert powers[junctions] == pytest.approx(tree.radius_mm[junctions] ** law.gamma, rel=EXACT)


@pytest.mark.parametrize("gamma", [2.0, 2.3, 2.55, 3.0])
def test_laws_hold_for_every_exponent(gamma):
    check(grown(gamma), perfusion(gamma))


@pytest.mark.parametrize("options", [{"merge_mm": 2.0}, {"apart": 1.0}, {"diameters": 0.0}, {"shortest_mm": 1.0}])
def test_laws_hold_whatever_the_rules(options):
    tree = grown(**options)
    assert tree.topology.n_terminals == 300
    check(tree, perfusion())


def test_laws_hold_in_a_bent_domain():
    domain = ShapeDomain("horseshoe")
    check(grown(domain=domain, root=domain.root_mm), perfusion())


def test_laws_hold_below_a_given_root_tree():
    root = RootTree(
        np.array([-1, 0, 1, 1]),
        np.array([[0.0, 35, 8], [20, 35, 8], [35, 50, 8], [35, 20, 8]]),
        np.array([0.0, 3.0, 2.2, 2.0]),
    )
    tree = grown(root=root)
    fixed = [int(np.flatnonzero((tree.position_mm == point).all(axis=1))[0]) for point in root.position_mm[1:]]
    assert tree.radius_mm[fixed] == pytest.approx([3.0, 2.2, 2.0], rel=0, abs=0)
    check(tree, perfusion(), fixed)


def test_laws_hold_in_the_file(tmp_path):
    write_vtp(grown(), tmp_path / "tree.vtp")
    check(read_tree(tmp_path / "tree.vtp"), perfusion())


def test_volume_is_least_at_the_bifurcation_that_growth_chose():
    """Moving the last bifurcation by 0.1 mm any way costs volume: its place is a minimum of the whole tree's volume."""
    growth = Growth(
        Box((90.0, 70.0, 16.0)), perfusion(), np.zeros(3), 60, options=GrowthOptions(diameters=0.0),
        rng=np.random.default_rng(1),
    )  # fmt: skip
    for _ in growth.steps():
        pass
    _, position = growth._state.arrays()
    tree = growth.tree()
    node = int(np.flatnonzero((tree.position_mm == position[-2]).all(axis=1))[0])
    assert tree.topology.n_children[node] == 2
    for step in 0.1 * np.vstack([np.eye(3), -np.eye(3)]):
        moved = tree.position_mm.copy()
        moved[node] += step
        assert perfused_tree(tree.topology, moved, perfusion()).volume_mm3 > tree.volume_mm3


def test_one_tube_is_poiseuilles():
    law = perfusion()
    tree = perfused_tree(Topology([-1, 0]), np.array([[0.0, 0, 0], [10.0, 0, 0]]), law)
    radius = (8 * law.viscosity_pa_s * law.flow_mm3_s * 10.0 / (np.pi * law.pressure_drop_pa)) ** 0.25
    assert tree.radius_mm[1] == pytest.approx(radius, rel=1e-14)  # the same product in another order


def test_volume_scales_with_flow_viscosity_and_pressure():
    """V is proportional to sqrt(Q eta / dp)."""
    tree = grown()
    law = perfusion()
    other = Perfusion(8000.0, 7000.0, 3 * law.flow_mm3_s, 2 * law.viscosity_pa_s, law.gamma)
    again = perfused_tree(tree.topology, tree.position_mm, other)
    factor = np.sqrt(3 * 2 * law.pressure_drop_pa / 1000.0)
    assert again.volume_mm3 == pytest.approx(factor * tree.volume_mm3, rel=1e-12)  # rounding


def test_a_root_tree_that_uses_up_the_pressure_is_infeasible():
    parent = np.array([-1, 0, 1])
    position = np.array([[0.0, 0, 0], [50, 0, 0], [60, 0, 0]])
    with pytest.raises(ComputationError, match=r"leave no pressure for segment 2, which springs at node 1"):
        perfused_tree(Topology(parent), position, perfusion(), np.array([np.nan, 0.1, np.nan]))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((1.0, 2.0, 1.0, 1.0, 2.5), "pressure does not fall"),
        ((2.0, 1.0, 0.0, 1.0, 2.5), "must be positive"),
        ((2.0, 1.0, 1.0, -1.0, 2.5), "must be positive"),
        ((2.0, 1.0, 1.0, 1.0, 3.5), "gamma is 3.5; branching exponents from 2 to 3"),
        ((np.nan, 1.0, 1.0, 1.0, 2.5), "root_pressure_pa is nan"),
    ],
)
def test_impossible_perfusions_are_refused(values, message):
    with pytest.raises(InputError, match=message):
        Perfusion(*values)


def test_a_terminal_without_length_is_refused():
    with pytest.raises(InputError, match=r"1 terminals have no length \(first: segment 2\)"):
        perfused_tree(Topology([-1, 0, 1, 1]), np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0], [2, 0, 0]]), perfusion())
