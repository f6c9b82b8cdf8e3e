"""The parts of a report: numbers in words, looks of trees, tubes and views in space, packing for the viewer."""

import base64
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from vascval.core.errors import ComputationError
from vascval.core.tree import Topology, Tree
from vascval.report import formats, scene, style, view, viewer
from vascval.report.page import Cell, Picture, Section, Table, Text, render, script_json
from vascval.report.plots import panel, plain_text
from vascval.report.swatches import swatch
from vascval.report.tree_sections import fitting

S, M, N = "\N{NARROW NO-BREAK SPACE}", "\N{MINUS SIGN}", "\N{EN DASH}"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (1.0, "1.00"),
        (0.24232, "0.242"),
        (9.999, "10.0"),
        (0.0009996, "0.00100"),
        (1234.5, f"1{S}234"),
        (-2.5, f"{M}2.50"),
        (3.3697e-5, f"3.37{S}×{S}10⁻⁵"),
        (1.5e6, f"1.50{S}×{S}10⁶"),
        (999999.0, f"1.00{S}×{S}10⁶"),
        (None, N),
        (float("nan"), N),
        (pd.NA, N),
        (np.float64(2.0), "2.00"),
    ],
)
def test_measure(value, text):
    assert formats.measure(value) == text


def test_a_spread_that_is_rounding_is_none():
    assert formats.spread(2.5, 2.6e-16) == "2.50 ± 0"
    assert formats.spread(0.0, 2.6e-16) == f"0 ± 2.6{S}×{S}10⁻¹⁶"
    assert formats.spread(2.5, 0.013) == "2.50 ± 0.013"


@pytest.mark.parametrize(
    ("form", "value", "text"),
    [
        (formats.count, 3880, f"3{S}880"),
        (formats.count, np.int64(7), "7"),
        (formats.count, pd.NA, N),
        (formats.percent, 0.061, f"6.1{S}%"),
        (formats.percent, 0.5, f"50{S}%"),
        (formats.percent, 0.0, f"0{S}%"),
        (formats.change, 0.0, f"0{S}%"),
        (formats.change, 0.0313, f"+3.1{S}%"),
        (formats.change, -0.7, f"{M}70{S}%"),
        (formats.change, 38.2, f"×{S}39"),
        (formats.change, 162.5, f"×{S}164"),
        (formats.change, None, N),
        (formats.p_value, 1e-9, "< 0.001"),
        (formats.p_value, 0.0064, "0.006"),
        (formats.p_value, 0.507, "0.51"),
        (formats.effect, -0.9933, f"{M}0.99"),
        (formats.effect, 0.35, "+0.35"),
        (formats.effect, float("nan"), N),
        (formats.effect, -0.004, "0.00"),
        (formats.effect, 0.0, "0.00"),
    ],
)
def test_other_formats(form, value, text):
    assert form(value) == text


def test_spread_and_several():
    assert formats.spread(4.8028, 1.6246) == "4.80 ± 1.6"
    assert formats.spread(5.15, float("nan")) == "5.15"
    assert formats.several(1, "branch", "es") == "1 branch" and formats.several(2, "branch", "es") == "2 branches"


def test_wide_tables_are_cut_between_measures():
    columns = {"a": 5, "b": 5, "c": 5, "d": 20, "e": 1}
    groups = [(name, [Cell(name)] * n, {}) for name, n in columns.items()]
    names = [[name for name, _, _ in run] for run in fitting(groups, 12)]
    assert names == [["a", "b"], ["c"], ["d"], ["e"]]
    assert fitting([], 12) == []


def test_labels_tell_sources_apart():
    trees = ["a/tree.vtp", "b/tree.vtp", "b/tree.swc", "twice.vtp", "twice.vtp"]
    labels = [one.label for one in style.styled("cast.nii.gz", trees, "table.csv")]
    assert labels == ["cast", "a/tree", "b/tree.vtp", "b/tree.swc", "twice.vtp", "twice.vtp (2)", "table"]


def test_trees_differ_in_colour_marker_and_dash():
    looks = style.styled("cast.vtp", [f"{k}.vtp" for k in range(6)], "table.csv")
    for attribute in ("colour", "marker", "dash"):
        assert len({getattr(one, attribute) for one in looks}) == len(looks), attribute
    drawn = [swatch(one, "tree").picture.data.decode() for one in looks]
    assert len(set(drawn)) == len(drawn)


def test_names_in_figures_are_printable_and_short():
    assert plain_text("_hidden") == " _hidden"
    assert plain_text("a\nb") == "a\N{REPLACEMENT CHARACTER}b"
    short = plain_text("x" * 60 + "end")
    assert len(short) == 30 and short.endswith("end")


def bent() -> Tree:
    """A stem with a curved centreline of three pieces, and two thinner straight children."""
    position = np.array([[0, 0, 0], [0, 0, 9], [6, 0, 15], [-6, 2, 15]], dtype=float)
    line = [[0, 0, 0], [1, 0, 3], [1, 0, 6], [0, 0, 9], [0, 0, 9], [6, 0, 15], [0, 0, 9], [-6, 2, 15]]
    radius, offset = np.array([0.0, 2.0, 1.0, 1.5]), np.array([0, 0, 4, 6, 8])
    return Tree(Topology(np.array([-1, 0, 1, 1])), position, radius, {}, np.array(line, dtype=float), offset)


LOOK = style.styled("tree.vtp", [])[0]


def test_tubes_follow_the_centreline_thickest_first():
    found = scene.tubes(bent(), LOOK)
    assert found.segment.tolist() == [1, 1, 1, 3, 2]
    assert found.radius_mm.tolist() == [2.0, 2.0, 2.0, 1.5, 1.0]
    assert found.start_mm[1].tolist() == [1, 0, 3] and found.end_mm[1].tolist() == [1, 0, 6]
    assert found.end_mm[3].tolist() == [-6, 2, 15]
    assert found.n_segments_left_out == 0


def test_tubes_beyond_the_limit_are_left_out_from_the_thinnest_and_counted():
    found = scene.tubes(bent(), LOOK, max_pieces=4)
    assert found.segment.tolist() == [1, 1, 1, 3]
    assert (found.n_segments_left_out, found.thinnest_drawn_mm) == (1, 1.5)


def test_straight_tubes_are_the_segments():
    straight = Tree(bent().topology, bent().position_mm, bent().radius_mm)
    found = scene.tubes(straight, LOOK)
    assert found.start_mm.tolist() == [[0, 0, 0], [0, 0, 9], [0, 0, 9]]
    assert found.end_mm.tolist() == [[0, 0, 9], [-6, 2, 15], [6, 0, 15]]


@pytest.mark.parametrize(
    ("extent", "towards", "words"),
    [
        ((9, 2, 9), (0, -1, 0), "along +y"),
        ((9, 9, 2), (0, 0, 1), f"along {M}z"),
        ((2, 9, 9), (1, 0, 0), f"along {M}x"),
        ((9, 9, 9), (0, -1, 0), "along +y"),
    ],
)
def test_view_is_along_the_flattest_axis(extent, towards, words):
    seen = scene.viewpoint(np.zeros(3), np.array(extent, float))
    assert seen.axes[2].tolist() == list(towards)
    assert np.allclose(seen.axes @ seen.axes.T, np.eye(3)) and np.linalg.det(seen.axes) > 0
    assert words in seen.words
    assert seen.half_width_mm >= 4.5 and seen.half_height_mm >= 4.5


@pytest.mark.parametrize(("width", "bar"), [(100.0, 20.0), (81.0, 20.0), (40.0, 10.0), (0.9, 0.2), (20.0, 5.0)])
def test_scale_bar_is_round_and_at_most_a_quarter(width, bar):
    assert scene.scale_bar_mm(width) == pytest.approx(bar, rel=1e-12)  # round-off of a power of ten


def test_coarse_surface_of_a_large_mask_keeps_thin_vessels(monkeypatch):
    from vascval.io.volumes import Volume

    monkeypatch.setattr(scene, "_MAX_RAW_TRIANGLES", 200)
    values = np.zeros((5, 5, 40), dtype="uint8")
    values[2, 2, 3:37] = 1
    surface = scene.mask_surface(Volume(values, np.ones(3)))
    assert "every 2 voxels" in surface.note and surface.voxel_mm == 2.0
    # a block of two voxels at each end, rounded by the smoothing
    assert abs(np.ptp(surface.points_mm[:, 0]) - 34) <= 2.5
    assert scene.mask_surface(Volume(np.zeros((3, 3, 3), "uint8"), np.ones(3))) is None


def test_packed_scene_gives_the_places_back():
    tree = bent()
    layers = [scene.tubes(tree, LOOK), viewer.dots(np.array([[1.0, 2.0, 3.0]]), LOOK, radius_mm=0.5)]
    points = np.array([[-7.0, -1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    text, named = viewer.pack(layers, scene.Surface(points, np.array([[0, 1, 2]]), 0.5), hidden=["tree"])
    data = json.loads(text)
    assert [layer.label for layer in named] == ["surface of the cast", "tree", "tree"]
    assert [layer.shown for layer in named] == [True, False, False]
    low, size = np.array(data["low"]), np.array(data["size"])
    rows = np.frombuffer(base64.b64decode(data["layers"][1]["data"]), "<u2").reshape(-1, 7) / 65535.0
    # half a step of the 16-bit grid
    tolerance = 0.51 * size.max() / 65535
    assert np.abs(low + rows[:, :3] * size - layers[0].start_mm).max() < tolerance
    assert np.abs(low + rows[:, 3:6] * size - layers[0].end_mm).max() < tolerance
    assert np.abs(rows[:, 6] * data["thickest"] - layers[0].radius_mm).max() < tolerance
    corners = np.frombuffer(base64.b64decode(data["layers"][0]["points"]), "<u2").reshape(-1, 3) / 65535.0
    assert np.abs(low + corners * size - points).max() < tolerance
    assert np.frombuffer(base64.b64decode(data["layers"][0]["triangles"]), "<u4").tolist() == [0, 1, 2]


def test_json_in_a_script_cannot_end_it():
    text = script_json(json.dumps({"a": "</script><!--&"}))
    assert "<" not in text and ">" not in text and "&" not in text
    assert json.loads(text) == {"a": "</script><!--&"}


def test_page_escapes_everything():
    bad = "<b>\"'&"
    blocks = [Text(bad), Table(bad, [[Cell(bad)]], [[Cell(bad, "head")]], bad)]
    text = render(bad, bad, [Section("one", bad, blocks)], version="1", legend=[])
    assert "<b>" not in text and text.count("&lt;b&gt;") == 11  # each once, title and caption twice
    assert "<script" not in text


def test_panel_writes_the_same_bytes_each_time(tmp_path: Path):
    def draw(axes):
        axes.plot([1, 2], [3, 4], label="$x^2$ \N{CJK UNIFIED IDEOGRAPH-4E2D}")
        axes.legend()

    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        made = panel(tmp_path / name, "one", "Title", "in words", draw)
        assert isinstance(made, Picture) and made.data == (tmp_path / name / "one.svg").read_bytes()
    for suffix in ("svg", "png"):
        assert (tmp_path / f"a/one.{suffix}").read_bytes() == (tmp_path / f"b/one.{suffix}").read_bytes()


def ink(path: Path) -> float:
    """Share of the picture, without its foot, that is not white."""
    from PIL import Image

    pixels = np.asarray(Image.open(path).convert("L"))[:1200]
    return float((pixels < 250).mean())


def test_flat_picture_shows_tubes_of_their_width(tmp_path: Path):
    layer = scene.tubes(bent(), LOOK)
    view.write_flat_picture(tmp_path / "flat.png", [layer])
    # seen along y, 12 x 15 mm and margins: about the area of the tubes, 9 x 4 + 8.5 x 3 + 8.5 x 2 mm^2, of 20 x 15
    assert 0.15 < ink(tmp_path / "flat.png") < 0.40


def test_screenshot(tmp_path: Path, capfd):
    if not view.can_render():
        pytest.skip("VTK cannot draw on this machine")
    view.view(bent(), screenshot=tmp_path / "tree.png")
    assert 0.15 < ink(tmp_path / "tree.png") < 0.40  # as above
    captured = capfd.readouterr()
    assert captured.out + captured.err == ""


def test_screenshot_where_nothing_can_be_drawn(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(view, "can_render", lambda: False)
    with pytest.raises(ComputationError, match="VTK cannot draw without a display here; install"):
        view.view(bent(), screenshot=tmp_path / "tree.png")
    assert list(tmp_path.iterdir()) == []


def test_window_needs_a_display(monkeypatch):
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(ComputationError, match=r"no display.*--screenshot"):
        view.view(bent())
