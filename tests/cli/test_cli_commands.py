"""What the commands promise: names of files and keys, what goes to stdout, and nothing twice or by halves."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import jsonschema
import numpy as np
import pandas as pd
import pytest
from cli_files import contents, write_nrrd

from vascval.cli.main import main
from vascval.io import schemas
from vascval.io.trees import read_tree

SUMMARY = {
    "n_terminals", "n_segments", "n_bifurcations", "n_trifurcations", "n_trifurcations_first_7", "n_monopodial",
    "total_length_mm", "volume_mm3", "max_order", "n_overlaps",
}  # fmt: skip
GENERATION = {
    "generation", "order", "n_segments", "n_elements", "radius_mean_mm", "radius_sd_mm", "length_mean_mm",
    "length_sd_mm", "branching_ratio_mean",
}  # fmt: skip
IMAGE = {"n_components", "largest_component_fraction", "n_spurs_pruned", "n_loops_cut", "voxel_mm"}
REPORT = {"report.html", "report.json", "tables/generations.csv"}


def run(arguments, capsys) -> str:
    """What a command that succeeds prints."""
    assert main([str(argument) for argument in arguments]) == 0
    out, err = capsys.readouterr()
    assert all(line.startswith("vascval: note: ") for line in err.splitlines())
    return out


def check_analysis(document, source, *, image: bool) -> None:
    assert document["source"] == source
    assert set(document["summary"]) >= SUMMARY
    assert all(set(row) >= GENERATION for row in document["generations"])
    assert ("image" in document) == image
    if image:
        assert set(document["image"]) >= IMAGE
    jsonschema.validate(document, schemas.schema("analyze"))


def test_skeletonize(tmp_path, cast_file, tree, capsys):
    out = run(["skeletonize", cast_file, "-o", tmp_path / "cast.vtp", "--json", tmp_path / "cast.json"], capsys)
    assert "7 segments, 4 terminals" in out
    found = read_tree(tmp_path / "cast.vtp")
    assert found.topology.n_terminals == 4
    # a centreline ends within a radius of the tip of a rounded tube; the thinnest here is 1.74 mm
    ends = found.position_mm[found.topology.terminals]
    wanted = tree.position_mm[tree.topology.terminals]
    assert np.linalg.norm(ends[:, None] - wanted, axis=2).min(axis=1).max() < 1.74
    document = json.loads((tmp_path / "cast.json").read_text())
    jsonschema.validate(document, schemas.schema("skeletonize"))
    assert document["source"] == "cast.nrrd"
    assert set(document["image"]) >= IMAGE
    assert document["image"]["n_components"] == 1


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
@pytest.mark.parametrize("quiet", [False, True])
def test_progress_is_drawn_on_a_terminal_only(quiet, tmp_path, cast_file):
    command = [sys.executable, "-m", "vascval.cli", "skeletonize", str(cast_file), "-o", str(tmp_path / "cast.vtp")]
    ours, theirs = os.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "120"}
    process = subprocess.Popen(
        [*command, *(["--quiet"] if quiet else [])], stdout=subprocess.PIPE, stderr=theirs, text=True, env=environment
    )
    os.close(theirs)
    drawn = b""
    while True:
        try:
            piece = os.read(ours, 65536)
        except OSError:  # how Linux says that the other side has closed
            break
        if not piece:
            break
        drawn += piece
    out, _ = process.communicate()
    os.close(ours)
    assert process.returncode == 0
    assert out.startswith("selected")
    assert out.isascii()
    assert (drawn == b"") == quiet


def test_skeletonize_to_swc_from_a_label(tmp_path, mask, capsys):
    path = write_nrrd(tmp_path / "labels.nrrd", np.where(mask > 0, 64, 1).astype(np.uint8))
    run(["skeletonize", path, "--label", "64", "-o", tmp_path / "cast.swc"], capsys)
    assert read_tree(tmp_path / "cast.swc").topology.n_terminals == 4


@pytest.mark.parametrize("threshold", ["auto", "100"])
def test_threshold_of_a_grey_volume(threshold, tmp_path, mask, capsys):
    ripple = np.arange(mask.size).reshape(mask.shape) % 7
    grey = (np.where(mask > 0, 200, 20) + ripple).astype(np.int16)
    path = write_nrrd(tmp_path / "grey.nrrd", grey)
    out = run(["skeletonize", path, "--threshold", threshold, "-o", tmp_path / "cast.vtp"], capsys)
    assert "7 segments, 4 terminals" in out


def test_root_that_is_given_is_the_root(tmp_path, cast_file, capsys):
    run(["skeletonize", cast_file, "--root", "-14,-8,32", "-o", tmp_path / "cast.vtp"], capsys)
    root = read_tree(tmp_path / "cast.vtp").position_mm[0]
    assert np.linalg.norm(root - (-14, -8, 32)) < 1.74  # the radius there


def test_analyze_a_tree(tmp_path, tree_file, capsys):
    out = run(["analyze", tree_file, "-o", tmp_path / "report", "--json", tmp_path / "tree.json"], capsys)
    assert re.search(r"^terminals +4$", out, re.MULTILINE)
    assert out.rstrip().endswith(f"report: {tmp_path / 'report' / 'report.html'}")
    document = json.loads((tmp_path / "tree.json").read_text())
    check_analysis(document, "tree.swc", image=False)
    assert document["summary"]["n_segments"] == 7
    assert [row["n_segments"] for row in document["generations"]] == [1, 2, 4]
    assert set(contents(tmp_path / "report")) >= REPORT


def test_analyze_a_volume(tmp_path, cast_file, capsys):
    out = run(["analyze", cast_file, "--json", "-"], capsys)
    document = json.loads(out)
    check_analysis(document, "cast.nrrd", image=True)
    assert document["summary"]["n_terminals"] == 4
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cast.nrrd"]


@pytest.fixture
def comparison(tmp_path, cast_file, tree_file, capsys):
    out = run(["compare", cast_file, tree_file, "-o", tmp_path / "report", "--json", tmp_path / "c.json"], capsys)
    return out, json.loads((tmp_path / "c.json").read_text()), tmp_path / "report"


def test_compare_a_volume_with_a_tree(comparison, tree):
    out, document, report = comparison
    check_analysis(document["cast"], "cast.nrrd", image=True)
    check_analysis(document["trees"][0], "tree.swc", image=False)
    jsonschema.validate(document, schemas.schema("compare"))
    assert document["location"][0]["matched_down_to_generation"] == 3
    for row in document["differences"][0]["generations"]:
        assert row["n_segments"] == 0
        # half a voxel (0.25 mm): what the image cannot tell
        assert abs(row["radius_mean_mm"]) < 0.25
    assert set(contents(report)) >= {*REPORT, "cast.vtp"}
    assert any(name.endswith(".svg") for name in contents(report))
    assert any(name.endswith(".png") for name in contents(report))
    assert read_tree(report / "cast.vtp").topology.n_terminals == 4
    assert "cast.nrrd" in out and "tree.swc" in out and "report.html" in out
    table = pd.read_csv(report / "tables" / "generations.csv")
    assert set(table) >= GENERATION


def test_report_json_is_the_document(comparison):
    _, document, report = comparison
    written = json.loads((report / "report.json").read_text())
    assert {key: written[key] for key in document} == document


def test_compare_again_gives_the_same_bytes(comparison, tmp_path, cast_file, tree_file, capsys):
    *_, report = comparison
    (report / "mine.txt").write_text("not of the report")
    before = contents(report)
    run(["compare", cast_file, tree_file, "-o", report], capsys)
    assert contents(report) == before


def test_compare_writes_to_its_own_directory_by_default(tmp_path, cast_file, tree_file, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run(["compare", cast_file, tree_file], capsys)
    assert (tmp_path / "vascval-compare" / "report.html").is_file()


def test_compare_to_stdout_alone(tmp_path, tree_file, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    out = run(["compare", tree_file, tree_file, "--json", "-"], capsys)
    document = json.loads(out)
    assert document["cast"]["source"] == "tree.swc (cast)"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["tree.swc"]
    for row in document["differences"][0]["generations"]:
        assert row["radius_mean_mm"] == 0


def test_trees_of_one_name_are_told_apart(tmp_path, tree_file, capsys):
    (tmp_path / "other").mkdir()
    twin = tmp_path / "other" / "tree.swc"
    twin.write_bytes(tree_file.read_bytes())
    document = json.loads(run(["compare", tree_file, tree_file, twin, "--json", "-"], capsys))
    assert [tree["source"] for tree in document["trees"]] == [f"{tmp_path.name}/tree.swc", "other/tree.swc"]


TABLE = "# Someone 1999, table 2\ngeneration,n_segments,radius_mean_mm\n1,1,3.1\n2,2,2.4\n3,5,1.8\n"


def test_published_table_stands_in_for_the_cast(tmp_path, tree_file, capsys):
    path = tmp_path / "published.csv"
    path.write_text(TABLE)
    out = run(["compare", path, tree_file, "-o", tmp_path / "report", "--json", tmp_path / "c.json"], capsys)
    assert "published.csv" in out
    document = json.loads((tmp_path / "c.json").read_text())
    jsonschema.validate(document, schemas.schema("compare"))
    assert "Someone 1999" in document["cast"]["citation"]
    # 4 terminals against the 5 of the table
    assert document["differences"][0]["generations"][2]["n_segments"] == -1
    assert "cast.vtp" not in contents(tmp_path / "report")
    assert "Someone 1999" in (tmp_path / "report" / "report.html").read_text(encoding="utf-8")


def test_published_table_beside_the_cast(tmp_path, tree_file, capsys):
    path = tmp_path / "published.csv"
    path.write_text(TABLE)
    document = json.loads(run(["compare", tree_file, tree_file, "--reference", path, "--json", "-"], capsys))
    assert document["reference"]["source"] == "published.csv"


def test_view(tmp_path, tree_file, capsys):
    run(["view", tree_file, "--screenshot", tmp_path / "tree.png"], capsys)
    assert (tmp_path / "tree.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("name", ["analyze", "compare", "skeletonize"])
def test_schema(name, capsys):
    document = json.loads(run(["schema", name], capsys))
    jsonschema.Draft202012Validator.check_schema(document)
    assert name in run(["schema"], capsys).splitlines()


def test_schemas_on_disk_are_those_of_the_code(tmp_path, capsys):
    run(["schema", "--write", tmp_path], capsys)
    folder = Path(__file__).resolve().parents[2] / "data_schemas"
    on_disk = {path.name: path.read_text(encoding="utf-8") for path in folder.iterdir()}
    assert {path.name: path.read_text(encoding="utf-8") for path in tmp_path.iterdir()} == on_disk, (
        "run: vascval schema --write data_schemas"
    )


def test_units_of_a_tree_file(tmp_path, tree_file, capsys):
    plain = json.loads(run(["analyze", tree_file, "--unit", "mm", "--json", "-"], capsys))
    large = json.loads(run(["analyze", tree_file, "--unit", "cm", "--json", "-"], capsys))
    assert large["summary"]["total_length_mm"] == pytest.approx(10 * plain["summary"]["total_length_mm"], rel=1e-12)


def test_interrupted_growth_is_kept(tmp_path, capsys, monkeypatch):
    from generator.growth.growth import Growth

    steps = Growth.steps

    def interrupted(growth, *arguments, **options):
        for step in steps(growth, *arguments, **options):
            yield step
            if step.n_terminals >= 100:
                raise KeyboardInterrupt

    monkeypatch.setattr(Growth, "steps", interrupted)
    assert main(["generate", "karch-box", "--set", "n_terminals=100000", "-o", str(tmp_path / "tree.vtp")]) == 130
    assert "vascval: interrupted" in capsys.readouterr().err.splitlines()[-1]
    assert 100 <= read_tree(tmp_path / "tree.vtp").topology.n_terminals < 100_000


def test_generate(tmp_path, capsys):
    arguments = ["generate", "karch-box", "--set", "n_terminals=30", "--set", "seed=5"]
    out = run([*arguments, "-o", tmp_path / "tree.vtp", "--json", tmp_path / "tree.json"], capsys)
    assert str(tmp_path / "tree.vtp") in out
    document = json.loads((tmp_path / "tree.json").read_text())
    jsonschema.validate(document, schemas.schema("generate"))
    assert (document["n_terminals"], document["n_segments"], document["seed"]) == (30, 59, 5)
    assert [stage["name"] for stage in document["stages"]] == ["growth"]
    grown = read_tree(tmp_path / "tree.vtp")
    assert grown.topology.n_terminals == 30
    assert {"flow_mm3_s", "pressure_pa"} <= set(grown.columns)
    run([*arguments, "-o", tmp_path / "again.vtp"], capsys)
    assert (tmp_path / "again.vtp").read_bytes() == (tmp_path / "tree.vtp").read_bytes()


def test_demo(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    out = run(["demo"], capsys)
    assert set(contents(tmp_path / "vascval-demo")) >= {*REPORT, "cast.nrrd", "tree.vtp", "cast.vtp"}
    again = json.loads(run(["compare", "vascval-demo/cast.nrrd", "vascval-demo/tree.vtp", "--json", "-"], capsys))
    assert again["trees"][0]["summary"]["n_terminals"] == 100
    # a tip whose vessel runs along its sibling is none in the image
    assert 95 <= again["cast"]["summary"]["n_terminals"] <= 100
    assert re.search(rf"^terminals +{again['cast']['summary']['n_terminals']} +100$", out, re.MULTILINE)
