"""What is written reads back as it was, and the same tree gives the same bytes, for trees of any shape."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vascval.core.columns import COLUMNS
from vascval.core.ordering import generation, strahler_order
from vascval.core.tree import Topology, Tree
from vascval.io.assembly import Sketch, assemble
from vascval.io.trees import read_tree, write_swc, write_vtp
from vascval.io.volumes import Volume, read_volume, write_volume
from vascval.io.vtp_xml import read_vtp

_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=5,
)
_PLACEHOLDERS = ("radius_mm", "length_mm", "parent")


@st.composite
def trees(draw: st.DrawFn, *, branching: bool = False) -> Tree:
    """Trees of up to 40 segments; with ``branching``, inner nodes have two or more children."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    if branching:
        parent, open_ends = [-1, 0], [1]
        for _ in range(draw(st.integers(0, 12))):
            node = open_ends.pop(int(rng.integers(len(open_ends))))
            for _ in range(int(rng.integers(2, 4))):
                parent.append(node)
                open_ends.append(len(parent) - 1)
    else:
        parent = [-1] + [int(rng.integers(i)) for i in range(1, draw(st.integers(2, 41)))]
    n = len(parent)
    scale = 10.0 ** draw(st.integers(-3, 3))
    position = rng.normal(size=(n, 3)) * scale
    curves: dict[str, np.ndarray] = {}
    if draw(st.booleans()):
        size = rng.integers(2, 6, n - 1)
        offset = np.concatenate(([0, 0], np.cumsum(size)))
        polyline = rng.normal(size=(offset[-1], 3)) * scale
        polyline[offset[1:-1]] = position[parent[1:]]
        polyline[offset[2:] - 1] = position[1:]
        if (size > 2).any():
            curves = {"polyline_mm": polyline, "polyline_offset": offset}
    names = draw(st.sets(st.sampled_from(sorted(set(COLUMNS) - set(_PLACEHOLDERS)))))
    real = {name: COLUMNS[name].dtype == "float64" for name in sorted(names)}
    columns = {name: rng.normal(size=n) if is_real else rng.integers(-9, 9, n) for name, is_real in real.items()}
    meta = {"guesses": [], **draw(st.dictionaries(st.text(), _JSON, max_size=3))}
    return Tree(Topology(np.array(parent)), position, rng.random(n) * scale, columns, **curves, meta=meta)


def same(a: Tree, b: Tree) -> None:
    assert np.array_equal(a.parent, b.parent)
    assert np.array_equal(a.position_mm, b.position_mm)
    assert np.array_equal(a.radius_mm, b.radius_mm)
    assert (a.polyline_mm is None) == (b.polyline_mm is None)
    for segment in range(1, a.n_nodes):
        assert np.array_equal(a.polyline(segment), b.polyline(segment))


@settings(deadline=None, max_examples=80)
@given(trees())
def test_vtp_is_exact_and_deterministic(tree: Tree) -> None:
    with tempfile.TemporaryDirectory() as folder:
        first, second = Path(folder, "a.vtp"), Path(folder, "b.vtp")
        write_vtp(tree, first)
        back = read_tree(first)
        same(back, tree)
        assert dict(back.meta) == dict(tree.meta)
        assert set(back.columns) == set(tree.columns)
        for name, values in tree.columns.items():
            assert np.array_equal(back.columns[name], values)
            assert back.columns[name].dtype == values.dtype
        write_vtp(back, second)
        assert first.read_bytes() == second.read_bytes()
        write_vtp(tree, second, provenance={"seed": 1})
        assert read_tree(second).meta["provenance"] == {"seed": 1}


@settings(deadline=None, max_examples=40)
@given(trees())
def test_the_arrays_of_a_vtp_keep_the_contract(tree: Tree) -> None:
    with tempfile.TemporaryDirectory() as folder:
        write_vtp(tree, Path(folder, "a.vtp"))
        data = read_vtp(Path(folder, "a.vtp"))
    order = tree.columns.get("order", strahler_order(tree.topology))
    shown = {"length_mm": tree.length_mm, "radius_mm": tree.radius_mm, "order": order, "parent": tree.parent - 1,
             "generation": generation(tree.topology, order), **tree.columns}  # fmt: skip
    for name, values in shown.items():
        if COLUMNS[name].place == "segment":
            assert np.array_equal(data.cell_data[name], values[1:])
            assert name not in data.point_data
    assert np.array_equal(data.points[: tree.n_nodes], tree.position_mm)
    for segment, (start, end) in enumerate(zip(data.offsets, data.offsets[1:]), start=1):
        assert np.array_equal(data.points[data.connectivity[start:end]], tree.polyline(segment))
    if "pressure_pa" in tree.columns:
        pressure = data.point_data["pressure_pa"]
        assert np.array_equal(pressure[: tree.n_nodes], tree.columns["pressure_pa"])
        for start, end in zip(data.offsets, data.offsets[1:]):
            along = pressure[data.connectivity[start:end]]
            low, high = sorted((along[0], along[-1]))
            assert ((along >= low - 1e-12) & (along <= high + 1e-12)).all()  # interpolated: one rounding beyond


@settings(deadline=None, max_examples=60)
@given(trees(branching=True))
def test_swc_is_exact_where_inner_nodes_branch(tree: Tree) -> None:
    with tempfile.TemporaryDirectory() as folder:
        first, second = Path(folder, "a.swc"), Path(folder, "b.swc")
        write_swc(tree, first, provenance={"seed": 1})
        write_swc(tree, second, provenance={"seed": 1})
        assert first.read_bytes() == second.read_bytes()
        back = read_tree(first)
    assert np.array_equal(back.parent, tree.parent)
    assert np.array_equal(back.position_mm, tree.position_mm)
    # a run of n pieces of one radius has that radius but for the rounding of its weighted mean
    np.testing.assert_allclose(back.radius_mm, tree.radius_mm, rtol=1e-14, atol=0)
    for segment in range(1, tree.n_nodes):
        assert np.array_equal(back.polyline(segment), tree.polyline(segment))
    assert not [said for said in back.meta["guesses"] if "one unit" not in said]  # radii are of any size


@settings(deadline=None, max_examples=60)
@given(trees(branching=True), st.integers(0, 2**32 - 1))
def test_a_tree_is_put_together_from_its_pieces_in_any_order_and_direction(tree: Tree, seed: int) -> None:
    rng = np.random.default_rng(seed)
    shuffle = rng.permutation(tree.n_nodes)
    edges = shuffle[np.stack((tree.parent[1:], np.arange(1, tree.n_nodes)), axis=1)]
    flip = rng.random(len(edges)) < 0.5
    edges[flip] = edges[flip, ::-1]
    mixed = rng.permutation(len(edges))
    points = np.empty_like(tree.position_mm)
    points[shuffle] = tree.position_mm
    radius = tree.radius_mm[1:]
    back = assemble(Sketch(points, edges[mixed], radius[mixed], roots=[int(shuffle[0])]))
    where = {tuple(point): i for i, point in enumerate(tree.position_mm)}
    found = np.array([where[tuple(point)] for point in back.position_mm])
    assert sorted(found) == list(range(tree.n_nodes))
    assert np.array_equal(tree.parent[found[1:]], found[back.parent[1:]])
    assert np.array_equal(back.radius_mm[1:], tree.radius_mm[found[1:]])


@pytest.mark.parametrize("suffix", [".nrrd", ".mha"])
@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), dtype=st.sampled_from(["uint8", "int16", "uint32", "float32", "float64"]))
def test_volumes_keep_values_and_frame(suffix: str, seed: int, dtype: str) -> None:
    rng = np.random.default_rng(seed)
    values = (rng.normal(size=rng.integers(2, 9, 3)) * 100).astype(dtype)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    volume = Volume(values, 10.0 ** rng.uniform(-1.4, 1.4, 3), rng.normal(size=3) * 100, turn)
    with tempfile.TemporaryDirectory() as folder:
        write_volume(volume, Path(folder, f"a{suffix}"))
        back = read_volume(Path(folder, f"a{suffix}"))
    assert np.array_equal(back.values, values)
    # NRRD stores direction times spacing; MetaImage seventeen digits: some roundings of double precision
    np.testing.assert_allclose(back.spacing_mm, volume.spacing_mm, rtol=1e-13)
    np.testing.assert_allclose(back.origin_mm, volume.origin_mm, rtol=1e-13)
    np.testing.assert_allclose(back.direction, volume.direction, rtol=0, atol=1e-13)
    index = rng.normal(size=(5, 3)) * 50
    np.testing.assert_allclose(back.to_index(volume.to_world(index)), index, rtol=0, atol=1e-9)
