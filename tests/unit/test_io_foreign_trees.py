"""Trees by other programs: each trap of the shared data, and each again in a small file of our own making."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from vascval.core.errors import InputError
from vascval.core.ordering import strahler_order
from vascval.core.tree import Tree
from vascval.core.validation import findings
from vascval.io.assembly import Sketch, assemble
from vascval.io.trees import read_tree

Shared = Callable[..., Path]


def guesses(tree: Tree) -> str:
    return " | ".join(tree.meta["guesses"])


def legacy(
    path: Path,
    points: np.ndarray,
    lines: Sequence[Sequence[int]],
    *,
    cells: dict[str, Sequence[float]] | None = None,
    at_points: dict[str, Sequence[float]] | None = None,
) -> Path:
    """A legacy VTK file in ASCII, written by hand."""
    out = ["# vtk DataFile Version 3.0", "by hand", "ASCII", "DATASET POLYDATA", f"POINTS {len(points)} double"]
    out += [" ".join(repr(float(value)) for value in point) for point in points]
    out += [f"LINES {len(lines)} {sum(len(line) + 1 for line in lines)}"]
    out += [" ".join(map(str, [len(line), *line])) for line in lines]
    for place, count, arrays in (("CELL", len(lines), cells), ("POINT", len(points), at_points)):
        if arrays:
            out += [f"{place}_DATA {count}", f"FIELD FieldData {len(arrays)}"]
            for name, values in arrays.items():
                out += [f"{name} 1 {count} double", " ".join(repr(float(value)) for value in values)]
    path.write_text("\n".join(out) + "\n")
    return path


Y = np.array([[0.0, 0, 0], [0, 0, 10], [5, 0, 15], [-5, 0, 15]])
Y_LINES = [[0, 1], [1, 2], [1, 3]]


# --- the shared data --------------------------------------------------------------------------------------------


def test_cco_tree_with_two_point_lines_and_a_stem_of_almost_no_length(shared_data: Shared) -> None:
    tree = read_tree(shared_data("ircad01", "cco_in_liver_2000.vtp"))
    assert (tree.n_segments, tree.topology.n_terminals) == (3999, 2000)
    assert tree.polyline_mm is None
    assert tree.radius_mm[1] == tree.radius_mm.max() == pytest.approx(3.12297, abs=1e-5)  # the stem, as in the file
    np.testing.assert_allclose(tree.position_mm[0], [120.27, 121.41, 116.8], atol=1e-6)  # as printed
    assert "taken as millimetres" in guesses(tree)
    assert "end of the thickest stem" in guesses(tree)


def test_simvascular_centreline_in_centimetres(shared_data: Shared) -> None:
    path = shared_data("centerlines", "simvascular_demo_centerlines.vtp")
    tree = read_tree(path)
    assert (tree.n_segments, tree.topology.n_terminals) == (3, 2)
    assert "SimVascular wrote it, which works in centimetres" in guesses(tree)
    assert "'MaximumInscribedSphereRadius' on points" in guesses(tree)
    assert np.ptp(tree.polyline_mm, axis=0).max() == pytest.approx(335.77, abs=0.01)  # 33.577 in the file
    assert tree.polyline_mm is not None
    assert len(tree.polyline_mm) == 1274 + 2  # every point once, the branching point three times
    same = read_tree(path, unit="mm")
    assert np.allclose(same.position_mm * 10, tree.position_mm, rtol=1e-12)
    assert np.allclose(same.radius_mm * 10, tree.radius_mm, rtol=1e-12)
    assert "centimetres" not in guesses(same)


def test_legacy_vtk_in_micrometres_with_radius_on_cells_or_diameter_on_points(shared_data: Shared) -> None:
    cells = read_tree(shared_data("vascpy", "penetrating_artery.vtk"))
    points = read_tree(shared_data("vascpy", "penetrating_artery_diameters_on_points.vtk"))
    for tree in (cells, points):
        assert tree.n_segments == 1
        assert "taken as micrometres" in guesses(tree)
        assert tree.chord_mm[1] == pytest.approx(np.linalg.norm([0.286399, 0.366047, 1.084798]), rel=2e-3)
    assert "halved" in guesses(points)
    assert "halved" not in guesses(cells)
    # one vessel, its radius once from the cells and once from the points between them
    assert points.radius_mm[1] == pytest.approx(cells.radius_mm[1], rel=5e-4)
    assert cells.radius_mm[1] == pytest.approx(0.0115, rel=0.01)


def test_a_forest_keeps_its_longest_tree(shared_data: Shared) -> None:
    path = shared_data("vascpy", "test_smaller_vasculature.vtk")
    tree = read_tree(path)
    assert "kept the longest of 15 separate trees (0.2635 mm of 0.8964 mm)" in guesses(tree)
    assert (tree.n_segments, tree.topology.n_terminals) == (9, 5)
    assert tree.length_mm.sum() == pytest.approx(0.26347, abs=1e-5)
    with pytest.raises(InputError, match=r"vasculature.vtk: holds 15 separate trees .* pass keep='largest'"):
        read_tree(path, keep="error")


def test_a_loop_is_opened_at_its_thinnest_piece(shared_data: Shared) -> None:
    tree = read_tree(shared_data("vascpy", "one_loop.vtk"))
    assert "1 loops were opened at their thinnest piece, at (1.32, 0.4353, 1.907) mm" in guesses(tree)
    assert findings(tree) == []


def test_swc_of_human_brain_arteries(shared_data: Shared) -> None:
    tree = read_tree(shared_data("swc", "BG07.CNG.swc"))
    assert tree.topology.n_terminals == 126
    assert np.array_equal(tree.position_mm[0], [85.87, -106.02, 103.54])
    assert "taken as millimetres" in guesses(tree)
    assert tree.polyline_mm is not None
    assert len(np.unique(tree.polyline_mm, axis=0)) <= 3419
    rows = np.loadtxt(shared_data("swc", "BG07.CNG.swc"))
    step = rows[1:, 2:5] - rows[rows[1:, 6].astype(int) - 1, 2:5]
    assert tree.length_mm.sum() == pytest.approx(np.sqrt((step**2).sum(axis=1)).sum(), rel=1e-12)


@pytest.mark.parametrize(
    ("name", "nodes", "tips", "root"),
    [
        ("OpenCCO_liver_tree_3D_N995.gxl.xml", 1990, 995, [43, 105, 93]),
        ("VascuSynth_N200.gxl.xml", 400, 200, [0, 50, 50]),
    ],
)
def test_gxl(shared_data: Shared, name: str, nodes: int, tips: int, root: list[int]) -> None:
    tree = read_tree(shared_data("opencco", name))
    assert (tree.n_nodes, tree.topology.n_terminals) == (nodes, tips)
    assert tree.position_mm[0].tolist() == root
    assert "GXL gives no unit" in guesses(tree)
    assert ("not the one labelled 'root node'" in guesses(tree)) == name.startswith("OpenCCO")
    assert findings(tree) == []


# --- the same traps by hand -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "factor"),
    [("radius", 1), ("Radius", 1), ("RADII", 1), ("radius_mm", 1), ("Radius [mm]", 1),
     ("MaximumInscribedSphereRadius", 1),
     ("diameter", 2), ("Diameters", 2), ("diam", 2), ("thickness", 2), ("diameter_mm", 2)],
)  # fmt: skip
@pytest.mark.parametrize("place", ["cells", "at_points"])
def test_names_of_radii(tmp_path: Path, name: str, factor: int, place: str) -> None:
    values = [2.0 * factor, 1.5 * factor, 1.0 * factor] + ([0.5 * factor] if place == "at_points" else [])
    safe = name.replace(" ", "%20").replace("[", "%5B").replace("]", "%5D")
    path = legacy(tmp_path / "a.vtk", Y, Y_LINES, **{place: {safe: values}})
    tree = read_tree(path)
    expected = [2.0, 1.5, 1.0] if place == "cells" else [2.0, 1.0, 0.5]
    assert tree.radius_mm[1:].tolist() == expected
    assert ("halved" in guesses(tree)) == (factor == 2)
    assert ("no unit is given" in guesses(tree)) == ("mm" not in name)


def test_no_radius_is_an_error_that_names_the_arrays(tmp_path: Path) -> None:
    path = legacy(tmp_path / "a.vtk", Y, Y_LINES, cells={"flow": [1, 1, 1]}, at_points={"height": [0, 1, 2, 3]})
    with pytest.raises(InputError, match=r"a.vtk: no array looks like a radius or diameter \(arrays: flow, height\)"):
        read_tree(path)


@pytest.mark.parametrize(("unit", "mm"), [("um", 1e-3), ("Micrometers", 1e-3), ("mm", 1), ("cm", 10), ("m", 1000)])
def test_an_explicit_unit_wins(tmp_path: Path, unit: str, mm: float) -> None:
    path = legacy(tmp_path / "a.vtk", Y * 1000, Y_LINES, cells={"radius_cm": [2, 1, 1]})
    tree = read_tree(path, unit=unit)
    np.testing.assert_allclose(tree.position_mm, Y * 1000 * mm, rtol=1e-15)
    np.testing.assert_allclose(tree.radius_mm[1:], np.array([2, 1, 1]) * mm, rtol=1e-15)
    assert "unit" not in guesses(tree)
    assert read_tree(path).position_mm[1, 2] == 100_000  # otherwise the name of the array
    with pytest.raises(InputError, match="'furlong' is no unit of length; choose one of m, cm, mm, um"):
        read_tree(path, unit="furlong")


@pytest.mark.parametrize(
    ("shift", "scale", "radius", "unit", "why"),
    [
        (0, 1, 1.0, "mm", "it is 15 mm wide, largest radius 1 mm"),
        (0, 100, 9.0, "um", "in millimetres it would be 1500 mm wide"),
        (5000, 1, 1.0, "um", "in millimetres it would lie 5015 mm from the origin"),
        (0, 10, 40.0, "um", "in millimetres its largest radius would be 40 mm"),
    ],
)
def test_a_unit_is_guessed_by_size(
    tmp_path: Path, shift: float, scale: float, radius: float, unit: str, why: str
) -> None:
    path = legacy(tmp_path / "a.vtk", Y * scale + shift, Y_LINES, cells={"radius": [radius] * 3})
    tree = read_tree(path)
    assert tree.meta["unit"] == unit
    assert why in guesses(tree)


def test_runs_of_points_become_one_curved_segment(tmp_path: Path) -> None:
    points = np.array([[0, 0, 0], [0, 0, 1], [0, 0, 4], [0, 3, 8], [3, 0, 8], [6, 0, 8]], dtype=float)
    lines = [[1, 0], [1, 2], [3, 2], [2, 4], [4, 5]]
    tree = read_tree(legacy(tmp_path / "a.vtk", points, lines, cells={"radius": [4, 2, 1, 1, 1]}))
    assert tree.n_segments == 3
    assert tree.polyline(1).tolist() == points[[0, 1, 2]].tolist()
    assert tree.radius_mm[1] == pytest.approx((4 * 1 + 2 * 3) / 4, rel=1e-15)  # weighted by length
    assert tree.length_mm[1:].tolist() == [4, 5, pytest.approx(5 + 3, rel=1e-15)]


def test_polylines_that_share_places_but_no_points(tmp_path: Path) -> None:
    points = np.concatenate((Y[[0]], Y[[1]], Y[[1]] + 1e-9, Y[[2]], Y[[1]], Y[[3]]))
    path = legacy(tmp_path / "a.vtk", points, [[0, 1], [2, 3], [4, 5]], at_points={"radius": [2, 2, 1.5, 1.5, 1, 1]})
    tree = read_tree(path)
    assert tree.radius_mm[1:].tolist() == [2, 1.5, 1]
    assert tree.parent.tolist() == [-1, 0, 1, 1]
    assert "2 points at the same place as another were joined" in guesses(tree)


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("wobble", [0.0, 0.05])
def test_overlapping_paths_are_merged(tmp_path: Path, backwards: bool, wobble: float) -> None:
    """Four paths from one root over two levels of branching, not quite at the same places where they overlap."""
    rng = np.random.default_rng(5)
    corners = {"": [0, 0, 0], "s": [0, 0, 20], "l": [-8, 0, 30], "r": [8, 0, 30], "ll": [-14, 0, 40], "lr": [-4, 0, 42],
               "rl": [4, 0, 44], "rr": [14, 0, 40]}  # fmt: skip
    points, lines, radius = [], [], []
    for tip in ("ll", "lr", "rl", "rr"):
        route = [np.array(corners[name], dtype=float) for name in ("", "s", tip[0], tip)]
        along = np.concatenate([np.linspace(a, b, 25)[:-1] for a, b in pairwise(route)] + [[route[-1]]])
        along[1:-1] += rng.uniform(-wobble, wobble, along[1:-1].shape)
        lines.append(list(range(len(points), len(points) + len(along))))
        points += along.tolist()
        radius += [2.0] * 24 + [1.5] * 24 + [1.0] * 25
    if backwards:
        lines = [line[::-1] for line in lines]
    tree = read_tree(legacy(tmp_path / "a.vtk", np.array(points), lines, at_points={"radius": radius}))
    assert "4 overlapping paths were merged; the root is where they all begin" in guesses(tree)
    assert tree.position_mm[0].tolist() == [0, 0, 0]
    assert (tree.n_segments, tree.topology.n_terminals) == (7, 4)
    assert strahler_order(tree.topology)[0] == 3
    # branch points lie where the paths part, within half a radius of the corners downstream; 0.1 for the wobble
    for name in ("s", "l", "r"):
        gap = np.linalg.norm(tree.position_mm - corners[name], axis=1).min()
        assert gap < 0.5 * 2.0 + 0.1
    # each vessel counts once: 20 + 2 sqrt(164) + 2 sqrt(136) + 2 sqrt(160 + ...) would be far more with overlaps
    truth = 20 + sum(
        np.linalg.norm(np.subtract(corners[a], corners[b]))
        for a, b in (("s", "l"), ("s", "r"), ("l", "ll"), ("l", "lr"), ("r", "rl"), ("r", "rr"))
    )
    assert tree.length_mm.sum() == pytest.approx(truth, rel=0.03)  # parting later makes the junctions 1 to 3 % shorter


def test_vmtk_tracts_are_put_together_by_their_groups(tmp_path: Path) -> None:
    """Two centre lines in three tracts each: a shared branch, a bifurcation region, a branch of its own."""
    stem = np.linspace([0, 0, 0], [0, 0, 20], 11)
    points, lines, data = [], [], {"CenterlineIds": [], "TractIds": [], "GroupIds": [], "Blanking": []}
    for centreline, side in enumerate((-1.0, 1.0)):
        apart = np.array([0.9 * side, 0, 0])  # farther apart than a quarter of the radius: only the group tells
        split = np.linspace([0, 0, 20], [2 * side, 0, 24], 5) + apart
        branch = np.linspace([2 * side, 0, 24], [8 * side, 0, 40], 12) + apart
        start = np.concatenate((stem[:1], stem[1:] + apart))
        for tract, (piece, group, blank) in enumerate(((start, 0, 0), (split, 1, 1), (branch, 2 + centreline, 0))):
            lines.append(list(range(len(points), len(points) + len(piece))))
            points += piece.tolist()
            for values, value in zip(data.values(), (centreline, tract, group, blank)):
                values.append(value)
    radius = {"MaximumInscribedSphereRadius": [1.0] * len(points)}
    path = legacy(tmp_path / "a.vtk", np.array(points), lines, cells=data, at_points=radius)
    tree = read_tree(path)
    assert (tree.n_segments, tree.topology.n_terminals) == (3, 2)
    assert "2 overlapping paths were merged" in guesses(tree)
    assert tree.position_mm[1, 2] == 20  # the end of the shared group


def test_pieces_of_length_zero_and_double_pieces(tmp_path: Path) -> None:
    points = np.concatenate((Y, Y[[1, 1]]))
    lines = [[0, 1], [1, 4], [4, 2], [1, 5], [5, 3], [2, 4], [3, 3]]
    tree = read_tree(legacy(tmp_path / "a.vtk", points, lines, cells={"radius": [2, 2, 1, 1, 1, 0.5, 1]}))
    assert tree.parent.tolist() == [-1, 0, 1, 1]
    assert tree.radius_mm[1:].tolist() == [2, 1, 1]
    assert "2 pieces of length 0 were contracted" in guesses(tree)
    assert "2 pieces that join the same points as another, or one point to itself, were dropped" in guesses(tree)


def test_the_root_is_the_end_of_the_thickest_stem_though_it_has_no_length(tmp_path: Path) -> None:
    points = np.concatenate((Y[[1]], Y[1:]))
    tree = read_tree(legacy(tmp_path / "a.vtk", points, Y_LINES, cells={"radius": [3, 1, 2]}))
    assert tree.position_mm[0].tolist() == [0, 0, 10]
    assert tree.parent.tolist() == [-1, 0, 0]


def test_loops_are_cut_where_they_are_thinnest_whatever_the_order() -> None:
    square = np.array([[0.0, 0, -5], [0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    edges = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [4, 1]])
    for thin in range(1, 5):
        radius = np.array([2.0, 1, 1, 1, 1])
        radius[thin] = 0.5
        tree = assemble(Sketch(square, edges, radius))
        assert tree.length_mm.sum() == pytest.approx(8, rel=1e-15)
        # 5 of radius 2 and three of 1 are left
        assert (tree.radius_mm * tree.length_mm).sum() == pytest.approx(13, rel=1e-15)
        assert "1 loops were opened" in guesses(tree)


def test_nodes_keep_the_order_of_the_file_where_parents_come_first() -> None:
    points = np.array([[0.0, 0, 0], [0, 0, 1], [1, 0, 2], [-1, 0, 2], [2, 0, 3], [1, 0, 3]])
    edges = np.array([[0, 1], [1, 2], [1, 3], [2, 4], [2, 5]])
    tree = assemble(Sketch(points, edges, np.ones(5), roots=[0]))
    assert np.array_equal(tree.position_mm, points)
    turned = assemble(Sketch(points[::-1], 5 - edges, np.ones(5), roots=[5]))
    assert turned.parent.tolist() == [-1, 0, 1, 1, 3, 3]
    assert turned.length_mm.sum() == pytest.approx(tree.length_mm.sum(), rel=1e-15)


def test_swc_comments_forest_and_separators(tmp_path: Path) -> None:
    path = tmp_path / "a.swc"
    path.write_text(
        "# ORIGINAL_SOURCE by hand\n# Units: um\n\n7 3 0 0 0 20 -1\n8,3,0,0,1000,10,7\n9 3 0\t500 1500 5 8\n"
        "10 3 0 -500 1500 5 8\n20 3 9 9 9 1 -1\n21 3 9 9 10 1 20\n"
    )
    tree = read_tree(path)
    assert tree.meta["unit"] == "um"
    assert tree.position_mm.tolist() == [[0, 0, 0], [0, 0, 1], [0, 0.5, 1.5], [0, -0.5, 1.5]]
    assert tree.radius_mm[1:].tolist() == [0.02, 0.005, 0.005]  # the radius at a branching point is left out
    assert "kept the longest of 2 separate trees" in guesses(tree)
    assert "names no root" not in guesses(tree)


def test_gxl_whose_edges_lead_to_the_root(tmp_path: Path) -> None:
    node = (
        '<node id="{}"><attr name=" nodeType"><string> {} </string></attr>'
        '<attr name=" position"><tup>{}</tup></attr></node>'
    )
    floats = ["".join(f"<float>{value}</float>" for value in point) for point in Y]
    nodes = "".join(node.format(f"n{i}", "root node" if i == 0 else "x", text) for i, text in enumerate(floats))
    edges = "".join(
        f'<edge id="e{b}" to="n{a}" from="n{b}"><attr name="radius"><float>{1 + a}</float></attr></edge>'
        for a, b in Y_LINES
    )
    path = tmp_path / "a.gxl"
    path.write_text(f"<gxl><graph>{nodes}{edges}</graph></gxl>")
    tree = read_tree(path, unit="um")
    assert np.allclose(tree.position_mm, Y / 1000, rtol=1e-15)
    assert tree.radius_mm[1:].tolist() == [0.001, 0.002, 0.002]
    assert tree.meta["guesses"] == []
