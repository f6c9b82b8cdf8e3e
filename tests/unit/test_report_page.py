"""The report on disk: what is in it, that nothing is loaded from anywhere, that hostile names do no harm."""

import base64
import copy
import hashlib
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import jsonschema
import numpy as np
import pandas as pd
import pytest

from vascval.comparison import compare
from vascval.core.tree import Topology, Tree
from vascval.imaging import skeletonize
from vascval.imaging.rasterize import rasterize
from vascval.io import schemas
from vascval.io.documents import ReferenceTable
from vascval.io.volumes import Volume
from vascval.morphometry import analyze
from vascval.report import view
from vascval.report.write import write_analysis_report, write_compare_report

HOSTILE = "<script>alert(1)</script><img src=x onerror=alert(2)>\"' $x^2$ _\n.vtp"
ORIGIN = {
    "version": "1.2.3",
    "command": "compare",
    "config": {"label": None, "spacing_mm": [1.0, 1.0, 1.0]},
    "seed": 7,
    "inputs": [{"name": "cast.nrrd", "sha256": "ab" * 32, "bytes": 1234}],
}
SECTIONS = [
    "summary",
    "key-statistics",
    "overlay",
    "generations",
    "orders",
    "horton",
    "organs",
    "junctions",
    "image",
    "checks",
    "notes",
    "provenance",
    "definitions",
]
COMPARED = ["distributions", "location", "territories"]
VOID = {"meta", "img", "input", "br", "hr", "link", "wbr"}


def tree(*, turn=0.0, **meta) -> Tree:
    """Fifteen segments in four generations, Murray exponent 3, bent a little by ``turn``."""
    parent, position, radius = [-1, 0], [np.zeros(3), np.array([0.0, 0.0, 12.0])], [0.0, 2.5]
    for depth in range(3):
        for node in range(2**depth, 2 ** (depth + 1)):
            for side in (-1.0, 1.0):
                sideways = side * (12.0 - 3.0 * depth)
                step = (sideways, turn, 6.0 + side) if depth != 1 else (turn, sideways, 6.0 + 2 * side)
                parent.append(node)
                position.append(position[node] + step)
                radius.append(radius[node] * (0.8 + 0.01 * side))
    return Tree(Topology(np.array(parent)), np.array(position), np.array(radius), meta=meta)


@pytest.fixture(scope="module")
def cast():
    skeleton = skeletonize(rasterize(tree(), voxel_mm=0.5))
    places = np.array([[1.0, 2.0, 3.0]])
    return replace(skeleton, loops_mm=places, breaks_mm=np.empty((0, 3)))


@pytest.fixture(scope="module")
def comparison(cast):
    guessed = tree(turn=1.0, guesses=["the unit is <b>mm</b>"])
    image = {**cast.image, "notes": ["no <i>direction</i> is given"]}
    return compare(
        analyze(cast.tree, source="cast.nrrd", image=image),
        [analyze(guessed, source=HOSTILE), analyze(tree(), source="other/tree.vtp")],
    )


@pytest.fixture
def flat(monkeypatch):
    """As on a machine that cannot render."""
    monkeypatch.setattr(view, "can_render", lambda: False)


@pytest.fixture(scope="module")
def report(tmp_path_factory, comparison, cast):
    folder = tmp_path_factory.mktemp("module") / "report"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(view, "can_render", lambda: False)
        write_compare_report(comparison, folder, provenance=ORIGIN, skeleton=cast)
    return folder


class Page(HTMLParser):
    """The parts of a page: tags with their attributes, text, and the raw text of styles and scripts."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.raw: list[tuple[dict[str, str | None], str]] = []
        self.open: list[str] = []
        self.text = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] in ("style", "script"):
            self.raw.append((self.tags[-1][1], data))
        else:
            self.text += data

    def all(self, tag):
        return [attributes for name, attributes in self.tags if name == tag]


def page(folder) -> Page:
    return Page((folder / "report.html").read_text(encoding="utf-8"))


def test_every_section_is_there_and_linked(report):
    found = page(report)
    keys = [attributes["id"] for attributes in found.all("section")]
    assert keys == [*SECTIONS[:8], *COMPARED, *SECTIONS[8:]]
    assert [attributes["href"] for attributes in found.all("a")] == [f"#{key}" for key in keys]
    assert found.open == []
    assert len(found.all("table")) > 15
    assert len(found.all("h1")) == 1


def test_nothing_is_loaded_from_anywhere(report):
    found = page(report)
    assert not found.all("link") + found.all("iframe") + found.all("object") + found.all("form")
    for tag, attributes in found.tags:
        for name, value in attributes.items():
            assert not name.startswith("on") and name != "style", (tag, name)
            if name in ("src", "href", "srcset", "action", "data"):
                assert value.startswith(("data:image/", "#")), (tag, name)
    for _, text in found.raw:
        assert not re.search(r"https?:|url\(|@import|fetch\(|XMLHttpRequest|eval\(", text)


def test_policy_allows_this_script_and_style_alone(report):
    found = page(report)
    policy = next(meta["content"] for meta in found.all("meta") if meta.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none'; img-src data:; ") and "unsafe" not in policy
    hashes = set(re.findall(r"'sha256-([^']+)'", policy))
    run = [text for attributes, text in found.raw if attributes.get("type") != "application/json"]
    assert len(run) == 2
    assert {base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in run} == hashes


def test_hostile_names_are_text(report):
    found = page(report)
    assert len(found.all("script")) == 2  # the data of the scene and the viewer
    assert "alert" not in "".join(text for _, text in found.raw)
    assert all(
        "alert" not in value
        for name, value in ((n, v or "") for tag, a in found.tags for n, v in a.items() if tag == "script")
    )
    assert "<img src=x onerror=alert(2)>" in found.text
    assert all(image["src"] != "x" for image in found.all("img"))


def test_guesses_and_notes_are_shown(report):
    text = page(report).text
    assert "the unit is <b>mm</b>" in text
    assert "no <i>direction</i> is given" in text
    assert "read the effect size" in text


def test_provenance_is_shown(report):
    text = page(report).text
    for said in ("vascval 1.2.3", "ab" * 32, "cast.nrrd", "1\N{NARROW NO-BREAK SPACE}234", "[1.0, 1.0, 1.0]"):
        assert said in text
    assert re.search(r"seed\s*7", text)


def test_pictures_have_alternatives_and_are_whole(report):
    images = page(report).all("img")
    assert all("alt" in image for image in images)
    figures = [image for image in images if image["alt"]]
    assert len(figures) > 25
    for image in figures:
        kind, data = image["src"].removeprefix("data:image/").split(";base64,")
        start = {"svg+xml": b"<?xml", "jpeg": b"\xff\xd8\xff"}[kind]
        assert base64.b64decode(data, validate=True).startswith(start)


def test_figures_are_written_as_svg_and_png(report):
    svg = {path.stem for path in (report / "figures").glob("*.svg")}
    png = {path.stem for path in (report / "figures").glob("*.png")}
    assert png == svg | {"overlay"}
    wanted = {
        "n-segments",
        "radius-mean",
        "branching-ratio-mean",
        "strahler-n-elements",
        "distribution-radius",
        "effect-sizes-1",
        "monopodial-sensitivity-2",
        "location-matched-0",
        "territories",
    }
    assert svg >= wanted
    for path in (report / "figures").iterdir():
        start = b"\x89PNG\r\n" if path.suffix == ".png" else b"<?xml"
        assert path.read_bytes().startswith(start)
        assert b"<dc:date>" not in path.read_bytes()


def test_tables_have_the_columns_of_their_schemas(report):
    written = {path.stem: pd.read_csv(path) for path in (report / "tables").iterdir()}
    for name in (
        "generations",
        "orders",
        "segments",
        "elements",
        "junctions",
        "horton",
        "connectivity",
        "totals",
        "monopodial-sensitivity",
        "distributions",
        "location",
        "segment-location",
        "territories",
    ):
        properties = set(schemas.schema(f"table-{name}")["$defs"].popitem()[1]["properties"])
        assert set(written[name]) - {"source", "side"} == properties, name
        assert len(written[name]), name
    assert list(written["generations"]["source"].unique()) == ["cast.nrrd", HOSTILE, "other/tree.vtp"]
    assert written["image-positions"]["kind"].value_counts()["loop"] == 1


def test_json_is_the_document_with_provenance(report, comparison):
    written = json.loads((report / "report.json").read_text(encoding="utf-8"))
    jsonschema.validate(written, schemas.schema("compare"))
    assert written.pop("provenance") == ORIGIN
    assert written == comparison.document()


def test_numbers_of_the_page_are_those_of_the_analysis(report, comparison):
    text = re.sub(r"\s+", " ", page(report).text)
    total = comparison.cast.summary
    assert f"{total['n_terminals']} terminals in 4 generations" in text
    assert f"matched down to generation {comparison.location[1].matched_down_to_generation}" in text


def test_the_same_inputs_give_the_same_bytes(report, tmp_path, comparison, cast, flat):
    write_compare_report(comparison, tmp_path / "again", provenance=copy.deepcopy(ORIGIN), skeleton=cast)
    first = {path.relative_to(report): path.read_bytes() for path in report.rglob("*") if path.is_file()}
    again = {
        path.relative_to(tmp_path / "again"): path.read_bytes()
        for path in (tmp_path / "again").rglob("*")
        if path.is_file()
    }
    assert first.keys() == again.keys()
    assert [str(name) for name in first if first[name] != again[name]] == []


def test_the_page_says_that_the_picture_could_not_be_rendered(report):
    assert "could not be rendered on this machine" in page(report).text


def test_published_table_stands_in_for_the_cast(tmp_path, flat):
    rows = pd.DataFrame({"generation": [1, 2], "n_segments": [1.0, 2.0], "radius_mean_mm": [3.0, np.nan]})
    table = ReferenceTable("published.csv", "Someone <1999>, table 2", rows)
    found = compare(table, [analyze(tree(), source="tree.vtp")])
    write_compare_report(found, tmp_path / "report", provenance=ORIGIN)
    shown = page(tmp_path / "report")
    assert "Someone <1999>, table 2" in shown.text
    assert shown.text.count("The cast is a published table, which has no") == 3
    assert set(pd.read_csv(tmp_path / "report/tables/reference.csv")["source"]) == {"published.csv"}
    jsonschema.validate(json.loads((tmp_path / "report/report.json").read_text()), schemas.schema("compare"))


def test_report_of_one_tree(tmp_path, flat):
    write_analysis_report(analyze(tree(), source="tree.vtp"), tmp_path / "report", provenance=ORIGIN)
    shown = page(tmp_path / "report")
    assert [attributes["id"] for attributes in shown.all("section")] == SECTIONS
    assert "No tree comes from an image" in shown.text
    jsonschema.validate(json.loads((tmp_path / "report/report.json").read_text()), schemas.schema("analyze"))


def test_single_vessel_has_a_report(tmp_path, flat):
    single = Tree(Topology(np.array([-1, 0])), np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 9.0]]), np.array([0.0, 1.0]))
    alone = analyze(single, source="single.swc")
    write_compare_report(compare(alone, [alone]), tmp_path / "report", provenance={**ORIGIN, "inputs": []})
    shown = page(tmp_path / "report")
    assert "There are too few values for effect sizes." in shown.text
    assert "enclose no common volume" in shown.text
    assert "There are no input files." in shown.text
    assert not (tmp_path / "report/figures/branching-ratio-mean.svg").exists()


def test_nothing_is_left_when_writing_fails(tmp_path, comparison, monkeypatch):
    def broken(*_):
        raise MemoryError("no room")

    monkeypatch.setattr("vascval.report.write.write_tables", broken)
    with pytest.raises(MemoryError, match="no room"):
        write_compare_report(comparison, tmp_path / "report", provenance=ORIGIN)
    assert list(tmp_path.iterdir()) == []


def test_surface_of_a_ball_is_where_the_ball_is(cast):
    from vascval.report.scene import mask_surface

    index = np.indices((31, 31, 31))[::-1].transpose(1, 2, 3, 0)
    inside = ((index - 15.0) ** 2).sum(axis=-1) <= 100.0
    ball = Volume(inside.astype("uint8"), np.full(3, 0.5), np.array([1.0, 2.0, 3.0]), np.eye(3))
    surface = mask_surface(ball, max_triangles=1500)
    away = np.linalg.norm(surface.points_mm - (8.5, 9.5, 10.5), axis=1)
    # radius 5 mm; half a voxel is what a mask can tell
    assert 4.75 < away.min() <= away.max() < 5.25
    assert len(surface.triangles) <= 1500 and "simplified" in surface.note
