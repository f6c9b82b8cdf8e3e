"""What holds for the flow in any tree, whatever its shape, size, units and numbering."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from generator import _haemodynamics_kernels as kernels
from generator.haemodynamics import Perfusion, perfused_tree
from tests.property.shapes import Shape, numbered_anew, shapes, turned
from vascval.core.errors import ComputationError, InputError
from vascval.core.ordering import n_terminals_below
from vascval.core.tree import Topology, Tree

# Radii come from fourth roots of sums of a few dozen terms: some roundings of 1e-16 each. Powers down to 1/gamma and up
# to 4 of them stay within 1e-11.
SAME = {"rel": 1e-11, "abs": 0.0}


@st.composite
def laws(draw: st.DrawFn) -> Perfusion:
    end = draw(st.floats(-1e3, 1e4))
    return Perfusion(
        end + draw(st.floats(1.0, 1e4)), end, 10.0 ** draw(st.floats(-3, 4)), 10.0 ** draw(st.floats(-3, -1)),
        draw(st.floats(2.0, 3.0)),
    )  # fmt: skip


def perfused(shape: Shape, law: Perfusion) -> Tree:
    return perfused_tree(shape.topology, shape.position_mm, law)


@settings(deadline=None, max_examples=60)
@given(shapes(), laws())
def test_mass_pressure_and_murray(shape: Shape, law: Perfusion) -> None:
    tree = perfused(shape, law)
    flow, pressure, drop = (tree.columns[name] for name in ("flow_mm3_s", "pressure_pa", "pressure_drop_pa"))
    parent, ends = tree.parent, tree.topology.terminals
    for node in range(tree.n_nodes):
        children = [i for i in range(1, tree.n_nodes) if parent[i] == node]
        inflow = flow[node] if node else law.flow_mm3_s
        if children:
            assert sum(flow[children]) == pytest.approx(inflow, **SAME)
        if children and node:
            assert sum(tree.radius_mm[children] ** law.gamma) == pytest.approx(
                tree.radius_mm[node] ** law.gamma, **SAME
            )
    assert flow[ends] == pytest.approx(law.flow_mm3_s / len(ends), **SAME)
    assert pressure[0] == law.root_pressure_pa
    fall = law.root_pressure_pa - law.terminal_pressure_pa
    # each pressure is the root's less a sum of drops: roundings of the largest pressure, in units of the whole fall
    tiny = 1e-12 * (fall + abs(law.root_pressure_pa))
    assert pressure[ends] == pytest.approx(law.terminal_pressure_pa, rel=0, abs=tiny)
    for i in range(1, tree.n_nodes):
        length = math.dist(shape.position_mm[i], shape.position_mm[parent[i]])
        poiseuille = 8 * law.viscosity_pa_s * length * flow[i] / (math.pi * tree.radius_mm[i] ** 4)
        assert drop[i] == pytest.approx(poiseuille, **SAME)
        assert pressure[parent[i]] - pressure[i] == pytest.approx(poiseuille, rel=1e-11, abs=tiny)
        assert tree.columns["length_mm"][i] == pytest.approx(length, **SAME)
    assert (flow[0], drop[0], tree.columns["length_mm"][0]) == (pytest.approx(law.flow_mm3_s), 0.0, 0.0)


@settings(deadline=None, max_examples=60)
@given(shapes(stems=1), laws())
def test_volume_by_the_recursion(shape: Shape, law: Perfusion) -> None:
    """rho and v of the whole tree give its volume without any radius."""
    tree = perfused(shape, law)
    below = n_terminals_below(shape.topology).astype(float)
    rho, volume, total_s = kernels.resistances(shape.topology.parent, tree.columns["length_mm"], below, law.gamma)
    scale = law.kappa_pa_s * law.flow_mm3_s / below[0] / law.pressure_drop_pa
    assert law.pressure_drop_pa == law.root_pressure_pa - law.terminal_pressure_pa
    assert tree.volume_mm3 == pytest.approx(math.pi * math.sqrt(scale * rho[1]) * volume[1], **SAME)
    assert tree.radius_mm[1] == pytest.approx((scale * rho[1]) ** 0.25, **SAME)
    for node in range(1, tree.n_nodes):
        children = shape.topology.children(node)
        assert total_s[node] == pytest.approx(sum(rho[children] ** (law.gamma / 4)), abs=0, rel=1e-11)


@settings(deadline=None, max_examples=40)
@given(shapes(), laws(), st.integers(0, 2**32 - 1))
def test_place_and_numbering_do_not_matter(shape: Shape, law: Perfusion, seed: int) -> None:
    """Rotation, reflection and translation; root-first numbering and order of the children."""
    rng = np.random.default_rng(seed)
    tree = perfused(shape, law)
    moved = perfused(turned(shape, rng), law)
    assert moved.radius_mm == pytest.approx(tree.radius_mm, rel=1e-9, abs=0)  # moving rounds positions
    other, back = numbered_anew(shape, rng)
    relabelled = perfused(other, law)
    assert relabelled.radius_mm == pytest.approx(tree.radius_mm[back], **SAME)
    for name, values in tree.columns.items():
        span = float(np.abs(values).max())
        assert relabelled.columns[name] == pytest.approx(values[back], rel=1e-11, abs=1e-12 * span)


@settings(deadline=None, max_examples=40)
@given(shapes(), laws(), st.floats(0.01, 100.0))
def test_scaling(shape: Shape, law: Perfusion, s: float) -> None:
    """Radii grow with the fourth root of length, viscosity and flow, and fall with that of the pressure."""
    tree = perfused(shape, law)
    for other, power in (
        (perfused(replace(shape, position_mm=shape.position_mm * s), law), 0.25),
        (perfused(shape, replace(law, viscosity_pa_s=law.viscosity_pa_s * s)), 0.25),
        (perfused(shape, replace(law, flow_mm3_s=law.flow_mm3_s * s)), 0.25),
        (perfused(shape, replace(law, root_pressure_pa=law.terminal_pressure_pa + law.pressure_drop_pa * s)), -0.25),
    ):
        assert other.radius_mm == pytest.approx(tree.radius_mm * s**power, rel=1e-8, abs=0)  # the drop is a difference


@settings(deadline=None, max_examples=30)
@given(shapes(), laws())
def test_units(shape: Shape, law: Perfusion) -> None:
    """The same tree in kilogrammes, metres and seconds."""
    tree = perfused(shape, law)
    metres = perfused(
        replace(shape, position_mm=shape.position_mm * 1e-3), replace(law, flow_mm3_s=law.flow_mm3_s * 1e-9)
    )
    assert metres.radius_mm == pytest.approx(tree.radius_mm * 1e-3, rel=1e-10, abs=0)
    span = law.pressure_drop_pa + abs(law.root_pressure_pa)
    assert metres.columns["pressure_pa"] == pytest.approx(tree.columns["pressure_pa"], rel=0, abs=1e-11 * span)


@settings(deadline=None, max_examples=40)
@given(shapes(), laws(), st.integers(0, 2**32 - 1))
def test_given_radii(shape: Shape, law: Perfusion, seed: int) -> None:
    """A part at the root with its own radii given again changes nothing; a wider one lets the rest be thinner, and all
    ends keep their pressure; given radii that no given one feeds are ignored."""
    rng = np.random.default_rng(seed)
    tree, n = perfused(shape, law), shape.topology.n_nodes
    part = np.zeros(n, dtype=bool)
    part[0] = True
    for i in range(1, n):
        part[i] = part[shape.topology.parent[i]] and shape.topology.n_children[i] > 0 and rng.random() < 0.7
    own = np.where(part, tree.radius_mm, np.nan)
    orphan = ~part & ~part[np.maximum(shape.topology.parent, 0)]
    again = perfused_tree(shape.topology, shape.position_mm, law, np.where(orphan, 99.0, own))
    assert again.radius_mm == pytest.approx(tree.radius_mm, rel=1e-7, abs=0)  # the pressure left is a small difference
    wide = perfused_tree(shape.topology, shape.position_mm, law, own * 1.5)
    part[0] = False
    assert wide.radius_mm[part] == pytest.approx(1.5 * tree.radius_mm[part], abs=0, rel=0)
    part[0] = True
    assert (wide.radius_mm[~part] <= tree.radius_mm[~part] * (1 + 1e-7)).all()
    tiny = 1e-11 * (law.pressure_drop_pa + abs(law.root_pressure_pa))
    assert wide.columns["pressure_pa"][shape.topology.terminals] == pytest.approx(
        law.terminal_pressure_pa, rel=0, abs=tiny
    )


def test_given_radii_that_use_up_the_pressure_to_the_last() -> None:
    """A drop of nothing at all is refused too, and the segment named is the first that starves."""
    law = Perfusion(2.0, 1.0, 1.0, math.pi / 8, 3.0)  # kappa is 1: a drop of length over radius to the fourth
    topology = Topology(np.array([-1, 0, 1, 1, 0]))
    position = np.array([[0, 0, 0], [0, 0, 2.0], [0, 1, 2], [1, 0, 2], [5, 0, 0]])
    assert law.kappa_pa_s == 1.0
    flow = 2 / 3
    for radius, starves in (((flow * 2.0) ** 0.25, True), ((flow * 2.1) ** 0.25, False), (0.1, True)):
        fixed = np.array([np.nan, radius, np.nan, np.nan, np.nan])
        if starves and radius != 0.1:
            fixed[1] = np.nextafter(radius, 0)  # the root of the fourth power rounds: on the side that starves
        if starves:
            with pytest.raises(ComputationError, match="no pressure for segment 2, which springs at node 1; widen"):
                perfused_tree(topology, position, law, fixed)
        else:
            assert perfused_tree(topology, position, law, fixed).columns["pressure_pa"][2] == pytest.approx(
                1.0, rel=1e-9
            )
    exact = kernels.radii(
        np.array([-1, 0, 1]), np.array([0, 1.0, 1.0]), np.ones(3), np.array([np.nan, 1.0, np.nan]), np.ones(3),
        np.ones(3), 1.0, 1.0, 3.0, 2.0, 1.0,
    )  # fmt: skip
    assert exact[2] == 2  # the pressure at node 1 is the terminals' to the bit


def test_what_is_no_perfusion() -> None:
    for bad, match in (
        ((1.0, 1.0, 1.0, 1.0, 3.0), "does not fall"), ((1.0, 2.0, 1.0, 1.0, 3.0), "does not fall"),
        ((2.0, 1.0, 0.0, 1.0, 3.0), "must be positive"), ((2.0, 1.0, 1.0, 0.0, 3.0), "must be positive"),
        ((2.0, 1.0, -1.0, 1.0, 3.0), "must be positive"), ((2.0, 1.0, 1.0, -1.0, 3.0), "must be positive"),
        ((2.0, 1.0, 1.0, 1.0, 1.999), "from 2 to 3"), ((2.0, 1.0, 1.0, 1.0, 3.001), "from 2 to 3"),
        ((np.nan, 1.0, 1.0, 1.0, 3.0), "root_pressure_pa is nan"),
        ((2.0, -np.inf, 1.0, 1.0, 3.0), "terminal_pressure_pa"),
        ((2.0, 1.0, np.inf, 1.0, 3.0), "flow_mm3_s is inf"), ((2.0, 1.0, 1.0, np.nan, 3.0), "viscosity_pa_s is nan"),
        ((2.0, 1.0, 1.0, 1.0, np.nan), "gamma is nan"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=match):
            Perfusion(*bad)
    for gamma in (2.0, 3.0):
        assert Perfusion(1.5, 1.0, 0.5, 0.25, gamma).gamma == gamma
    with pytest.raises(AttributeError):
        Perfusion(1.5, 1.0, 0.5, 0.25, 2.5).gamma = 3.0  # type: ignore[misc]


def test_what_cannot_be_perfused() -> None:
    law = Perfusion(2.0, 1.0, 1.0, 1.0, 3.0)
    with pytest.raises(InputError, match="has no segment"):
        perfused_tree(Topology(np.array([-1])), np.zeros((1, 3)), law)
    topology = Topology(np.array([-1, 0, 1, 1]))
    position = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 0], [2, 0, 0.0]])
    with pytest.raises(InputError, match=r"1 terminals have no length \(first: segment 2\)"):
        perfused_tree(topology, position, law)
    inner = perfused_tree(topology, np.array([[0, 0, 0], [0, 0, 0], [1, 0, 0], [2, 0, 0.0]]), law)
    assert inner.columns["pressure_drop_pa"][1] == 0.0  # a segment without length inside the tree is allowed
    assert inner.radius_mm[1] > 0.0
