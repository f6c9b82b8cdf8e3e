"""``vascval optimum``: the certificate, the terminals of generate, and what is refused."""

import json
import signal

import jsonschema
import numpy as np
import pytest

from generator.topology import _exhaustive_kernels as kernels
from vascval.cli.main import main
from vascval.io import schemas
from vascval.io.trees import read_tree

SMALL = ["--set", "n_terminals=6", "--set", "topology.tests=2000"]


def optimum(folder, *arguments, preset="karch-box", name="best.vtp"):
    return main(["optimum", preset, "-o", str(folder / name), *map(str, arguments)])


def terminals(path):
    tree = read_tree(path)
    return np.unique(tree.position_mm[tree.topology.terminals], axis=0)


@pytest.mark.parametrize("changes", [("seed=1",), ("seed=4", "gamma=3"), ("seed=2", "method=geometry")])
def test_optimum_beside_the_search_of_generate(tmp_path, capsys, changes):
    settings = [*SMALL, *(word for change in changes for word in ("--set", change))]
    assert optimum(tmp_path, *settings, "--json", tmp_path / "best.json") == 0
    document = json.loads((tmp_path / "best.json").read_text())
    jsonschema.validate(document, schemas.schema("optimum"))
    assert (document["n_terminals"], document["n_topologies"]) == (6, 945)  # 9!! = 945
    assert 0 < document["n_optimised"] <= 945
    assert document["n_bounded"] > document["n_optimised"]
    tree = read_tree(tmp_path / "best.vtp")
    assert document["volume_mm3"] == pytest.approx(tree.volume_mm3, rel=1e-12)  # rounding
    for method in ("cco", "full"):
        path = tmp_path / f"{method}.vtp"
        generated = ["generate", "karch-box", *settings, "--set", f"method={method}", "-o", str(path)]
        assert main([*generated, "--json", str(tmp_path / "full.json")]) == 0
        assert np.array_equal(terminals(path), terminals(tmp_path / "best.vtp"))
    stages = {stage["name"]: stage for stage in json.loads((tmp_path / "full.json").read_text())["stages"]}
    assert document["search"]["volume_mm3"] == stages["topology"]["volume_mm3"]
    assert document["search"]["tests"] == stages["topology"]["tests"] == 4000
    assert document["ratio"] == document["search"]["volume_mm3"] / document["volume_mm3"]
    # the search ends in a local optimum of 1e-8 or so, and with six terminals finds the best topology
    assert 1 - 1e-8 < document["ratio"] < 1 + 1e-6
    assert document["volume_mm3"] < (1 - 1e-4) * stages["growth"]["volume_mm3"]
    out = capsys.readouterr().out
    assert "Proven" in out and "Not proven" in out and "best.vtp" in out


def test_a_search_that_hardly_tries_is_shown_up(tmp_path):
    settings = ["--set", "n_terminals=8", "--set", "topology.tests=1", "--set", "topology.chains=1"]
    assert optimum(tmp_path, *settings, "--json", tmp_path / "best.json") == 0
    document = json.loads((tmp_path / "best.json").read_text())
    assert document["search"]["tests"] == 1
    assert document["ratio"] > 1.001


def test_same_bytes_again_and_json_on_stdout_alone(tmp_path, capsys):
    assert optimum(tmp_path, *SMALL, name="a.vtp") == 0
    capsys.readouterr()
    assert optimum(tmp_path, *SMALL, "--json", "-", name="b.vtp") == 0
    assert json.loads(capsys.readouterr().out)["certificate"].startswith("Proven")
    assert (tmp_path / "a.vtp").read_bytes() == (tmp_path / "b.vtp").read_bytes()


def test_terminals_of_a_file(tmp_path):
    points = np.random.default_rng(0).random((5, 3)) * (90, 70, 16)
    path = tmp_path / "points.csv"
    np.savetxt(path, points, delimiter=",", header="x_mm,y_mm,z_mm", comments="")
    assert (
        optimum(tmp_path, "--set", f"terminals_file={path}", "--set", "root_mm=none", "--set", "topology.tests=99") == 0
    )
    assert terminals(tmp_path / "best.vtp") == pytest.approx(np.unique(points[1:], axis=0), rel=1e-12)  # as text
    assert read_tree(tmp_path / "best.vtp").position_mm[0] == pytest.approx(points[0], rel=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ((), "karch-box: 6,000 terminals: the optimum can be proven for 2 to 10; choose fewer"),
        (("n_terminals=11",), "karch-box: 11 terminals: "),
        (("n_terminals=1",), "karch-box: 1 terminal: "),
        (("n_terminals=6", "root_tree=x.vtp"), "root_tree is not covered by the proof"),
        (("n_terminals=6", "domain.shape=liver", "root_mm=none"), "the domain is not known to be convex"),
        (
            ("n_terminals=6", "method=geometry", "viscosity=fahraeus-lindqvist"),
            "a viscosity that is not constant is not covered by the proof",
        ),
        (("n_terminals=6", "growth.avoid_intersections=true"), "growth.avoid_intersections is not covered"),
        (("n_terminals=6", "growth.r_min_mm=0.1"), "a smallest radius is not covered"),
        (("n_terminals=6", "geometry.r_min_mm=0.1"), "a smallest radius is not covered"),
        (("n_terminals=6", "geometry.objective=volume+power"), "an objective other than the volume is not covered"),
        (("n_terminals=6", "geometry.gamma_by_generation=2.5,3"), "geometry.gamma_by_generation is not covered"),
        (("n_terminals=6", "geometry.l_min_mm=1"), "geometry.l_min_mm=1 is not covered by the proof"),
        (("n_terminals=6", "topology.at=5"), "topology.at=5 searches before all 6 terminals are there"),
        (("n_terminals=6", "method=geometry", "geometry.every=5"), "geometry.every=5 moves the tree before all 6"),
    ],
)
def test_what_is_not_covered_is_refused_in_one_line(tmp_path, capsys, changes, message):
    settings = [word for change in changes for word in ("--set", change)]
    assert optimum(tmp_path, *settings) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("vascval: error: ") and message in err and err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_outputs_that_cannot_be_are_refused(tmp_path, capsys):
    assert optimum(tmp_path, *SMALL, name="best.txt") == 2
    assert "ends in neither .vtp nor .swc" in capsys.readouterr().err
    path = tmp_path / "points.csv"
    path.write_text("x_mm,y_mm,z_mm\n0,0,0\n10,10,5\n20,4,5\n")
    before = path.read_bytes()
    assert optimum(tmp_path, "--set", f"terminals_file={path}", "--json", path) == 2
    assert "is an input and would be overwritten" in capsys.readouterr().err
    assert path.read_bytes() == before


def test_bifurcations_that_fall_together_are_one_junction(tmp_path):
    """With exponent 2 thick trunks cost little more than thin ones, and the best tree has a trifurcation."""
    assert optimum(tmp_path, *SMALL, "--set", "gamma=2", "--set", "seed=8", "--json", tmp_path / "best.json") == 0
    tree = read_tree(tmp_path / "best.vtp")
    assert (tree.topology.n_children == 3).any()
    document = json.loads((tmp_path / "best.json").read_text())
    assert document["shortest_mm"] == pytest.approx(tree.length_mm[1:].min(), rel=1e-6) and document["shortest_mm"] > 0
    assert tree.volume_mm3 == pytest.approx(document["enumerated_mm3"], rel=1e-9)  # rounding of what fell together


def test_a_better_geometry_of_the_search_is_taken(tmp_path, capsys):
    """Terminals at their least length are where the local optimisation of the enumeration is not exact."""
    assert optimum(tmp_path, *SMALL, "--set", "gamma=2", "--json", tmp_path / "best.json") == 0
    document = json.loads((tmp_path / "best.json").read_text())
    tree = read_tree(tmp_path / "best.vtp")
    least = min(document["enumerated_mm3"], document["search"]["volume_mm3"])
    assert document["volume_mm3"] == pytest.approx(least, rel=1e-8)
    assert tree.volume_mm3 == pytest.approx(least, rel=1e-8)
    assert document["ratio"] >= 1 - 1e-8
    better = document["search"]["volume_mm3"] < document["enumerated_mm3"] * (1 - 1e-8)
    assert ("the search has a better geometry" in capsys.readouterr().err) == better


def test_a_bifurcation_on_the_root_is_said(tmp_path, capsys):
    path = tmp_path / "points.csv"
    path.write_text("x_mm,y_mm,z_mm\n40,40,5\n10,40,5\n70,40,5\n40,10,5\n40,70,5\n")
    settings = [f"terminals_file={path}", "root_mm=none", "gamma=2", "topology.tests=500"]
    assert optimum(tmp_path, "--quiet", *(word for text in settings for word in ("--set", text))) == 1
    assert "lies on the root itself" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_it(tmp_path, monkeypatch, capsys, number, code):
    bounds = kernels.bounds_of_insertions

    def interrupted(*arguments):
        if arguments[2] == 4:  # terminals that are there
            signal.raise_signal(number)
        return bounds(*arguments)

    monkeypatch.setattr(kernels, "bounds_of_insertions", interrupted)
    assert optimum(tmp_path, *SMALL) == code
    assert capsys.readouterr() == ("", "vascval: interrupted; no unfinished file is left behind\n")
    assert not list(tmp_path.iterdir())
