from dataclasses import replace

import numpy as np
import pytest

from vascval.core.contraction import contract_degenerate, degenerate_segments
from vascval.core.errors import ComputationError, InputError
from vascval.core.ordering import (
    depth,
    diameter_defined_order,
    element,
    generation,
    n_terminals_below,
    root_first,
    strahler_order,
)
from vascval.core.tree import Topology, Tree
from vascval.core.validation import Claims, checks, findings, require_made_well


def test_children_with_orders_2_2_1_make_order_3() -> None:
    topology = Topology(np.array([-1, 0, 1, 1, 1, 2, 2, 3, 3]))
    order = strahler_order(topology)
    assert order[[2, 3, 4]].tolist() == [2, 2, 1]
    assert order[1] == 3
    assert generation(topology).tolist() == [0, 1, 2, 2, 3, 3, 3, 3, 3]


def test_a_monopodial_row_of_side_branches_stays_at_order_two() -> None:
    topology = Topology(np.array([-1, 0, 1, 1, 2, 2, 4, 4]))
    assert strahler_order(topology)[[1, 2, 4]].tolist() == [2, 2, 2]
    assert element(topology, strahler_order(topology), np.ones(8))[[1, 2, 4]].tolist() == [0, 0, 0]


def test_root_first_sorts_any_numbering_and_names_what_is_unreachable() -> None:
    parent = np.array([3, -1, 1, 1, 0])
    order = root_first(parent)
    position = np.argsort(order)
    assert order[0] == 1
    assert all(position[parent[i]] < position[i] for i in range(5) if parent[i] >= 0)
    with pytest.raises(InputError, match=r"2 nodes are unreachable from the root \(first: node 1\)"):
        root_first(np.array([-1, 2, 1]))
    with pytest.raises(InputError, match="2 nodes have no parent"):
        root_first(np.array([-1, -1]))


def test_topology_refuses_what_is_not_root_first() -> None:
    with pytest.raises(InputError, match=r"first: node 1, parent 2"):
        Topology(np.array([-1, 2, 0]))
    with pytest.raises(InputError, match="node 0 has parent 1"):
        Topology(np.array([1, 0]))


def test_sweeps_agree_with_counting_by_hand() -> None:
    topology = Topology(np.array([-1, 0, 1, 1, 2, 2]))
    assert depth(topology).tolist() == [0, 1, 2, 2, 3, 3]
    assert n_terminals_below(topology).tolist() == [3, 3, 2, 1, 1, 1]


def test_arrays_are_frozen_and_inputs_are_copied() -> None:
    radius = np.array([0.0, 1.0])
    tree = Tree(Topology(np.array([-1, 0])), np.array([[0, 0, 0], [1, 0, 0]]), radius)
    radius[1] = 5.0
    assert tree.radius_mm.tolist() == [1.0, 1.0]
    with pytest.raises(ValueError, match="read-only"):
        tree.radius_mm[1] = 2.0


def test_a_short_inner_segment_becomes_a_trifurcation() -> None:
    parent = np.array([-1, 0, 1, 1, 2, 2])
    position = np.array([[0, 0, 0], [10, 0, 0], [11.5, 0, 0], [10, 9, 0], [20, 5, 0], [20, -5, 0]], dtype=float)
    tree = Tree(Topology(parent), position, np.array([0, 1, 0.8, 0.5, 0.5, 0.5]))
    assert degenerate_segments(tree).tolist() == [2]
    contracted = contract_degenerate(tree)
    assert contracted.topology.n_children.tolist() == [1, 3, 0, 0, 0]
    assert contracted.position_mm[1].tolist() == [10, 0, 0]
    assert degenerate_segments(tree, diameters=0.9).size == 0


def test_a_row_of_close_side_branches_does_not_collapse_into_one_point() -> None:
    x = [0, 10, 11, 12, 13, 14, 30]
    position = np.array([[v, 0, 0] for v in x] + [[v, 8, 0] for v in (10, 11, 12, 13, 14)], dtype=float)
    tree = Tree(Topology(np.array([-1, 0, 1, 2, 3, 4, 5, 1, 2, 3, 4, 5])), position, np.full(12, 0.6))
    left = contract_degenerate(tree)
    assert sorted(left.position_mm[:, 0][left.topology.n_children > 1].tolist()) == [10, 12, 14]


def test_diameter_defined_orders_split_a_trunk_that_strahler_leaves_whole() -> None:
    # a trunk that halves its diameter: three orders by size
    topology = Topology(np.array([-1, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5]))
    diameter = np.array([0, 8, 4, 4.2, 2, 2.1, 2, 2.2, 1, 1, 1.1, 1])
    order = diameter_defined_order(topology, diameter)
    assert order[1] == order.max()
    assert order[[8, 9, 10, 11]].tolist() == [1, 1, 1, 1]


def test_validation_names_the_offending_ids() -> None:
    tree = Tree(
        Topology(np.array([-1, 0, 1, 2, 2])),
        np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 0, 0], [3, 1, 0]], dtype=float),
        np.array([0, 1, 1, 1, 0.0]),
        {"flow_mm3_s": np.array([0, 2.0, 2.0, 1.0, 0.9])},
    )
    rules = {finding.rule: finding.ids for finding in findings(tree)}
    assert rules == {"zero-radius": (4,), "zero-length": (3,), "single-child": (1,), "flow-balance": (2,)}


def perfused() -> Tree:
    """Two terminals below a stem: Murray's law with exponent 3, flow and pressure by hand."""
    radius = np.array([0, 2.0 ** (1 / 3), 1, 1])
    columns = {
        "flow_mm3_s": np.array([2.0, 2, 1, 1]),
        "pressure_pa": np.array([10.0, 8, 5, 5]),
        "pressure_drop_pa": np.array([0.0, 2, 3, 3]),
    }
    position = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 2], [-1, 0, 2]], dtype=float)
    return Tree(Topology(np.array([-1, 0, 1, 1])), position, radius, columns)


CLAIMS = Claims(gamma=3.0, equal_pressure=True)


def test_all_checks_of_a_sound_tree_hold_and_have_figures() -> None:
    found = {check.rule: check for check in checks(perfused(), CLAIMS)}
    assert all(check.holds for check in found.values())
    sized = {"flow-balance": 1, "pressure-drop": 3, "terminal-pressure": 2, "murray": 1}
    assert {rule: check.n_checked for rule, check in found.items() if check.worst is not None} == sized
    assert all(found[rule].worst < 1e-15 for rule in sized)  # one rounding of the cube root
    require_made_well(perfused(), CLAIMS)


@pytest.mark.parametrize(
    ("column", "node", "value", "rules"),
    [
        ("flow_mm3_s", 2, 1.001, {"flow-balance"}),
        ("flow_mm3_s", 2, np.nan, {"flow-balance"}),
        ("pressure_pa", 2, 5.01, {"pressure-drop", "terminal-pressure"}),
        ("pressure_pa", 3, 9.0, {"pressure-drop", "terminal-pressure", "pressure-rise"}),
        ("pressure_pa", 2, np.nan, {"pressure-drop", "terminal-pressure", "pressure-rise"}),
        ("pressure_drop_pa", 3, 3.1, {"pressure-drop"}),
        ("pressure_drop_pa", 3, np.nan, {"pressure-drop"}),
        ("radius_mm", 3, 1.001, {"murray"}),
    ],
)
def test_each_physical_check_can_fail(column: str, node: int, value: float, rules: set[str]) -> None:
    tree = perfused()
    if column == "radius_mm":
        radius = tree.radius_mm.copy()
        radius[node] = value
        tree = replace(tree, radius_mm=radius)
    else:
        values = tree.columns[column].copy()
        values[node] = value
        tree = tree.with_columns(**{column: values})
    assert {finding.rule for finding in findings(tree, CLAIMS)} == rules
    with pytest.raises(ComputationError, match="the tree that was made is not valid and not written"):
        require_made_well(tree, CLAIMS)


def test_a_given_junction_is_free_of_murrays_law() -> None:
    radius = np.array([0, 3.0, 1, 1])
    tree = replace(perfused(), radius_mm=radius)
    assert [finding.rule for finding in findings(tree, CLAIMS)] == ["murray"]
    given = np.array([True, True, False, False])
    assert findings(tree, Claims(gamma=3.0, given=given)) == []
