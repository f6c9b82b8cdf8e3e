"""``vascval twin`` on the small cast: what it leaves behind, what it refuses, and how it ends when it is stopped."""

import json
from types import SimpleNamespace

import jsonschema
import numpy as np
import pytest
from cli_files import contents, write_nrrd

from generator.growth.growth import Growth
from generator.topology.annealing import Annealing
from vascval import imaging
from vascval.cli import twin_outcome, twin_parts
from vascval.cli.main import main
from vascval.core.tree import Topology, Tree
from vascval.io import schemas
from vascval.io.trees import read_tree
from vascval.io.volumes import read_volume
from vascval.morphometry import analyze

QUICK = ["--set", "topology.tests=3000", "--set", "topology.chains=1"]
LEFT = {"report.html", "report.json", "cast.vtp", "cco.vtp", "optimised.vtp", "figures/twin-0.png", "tables/totals.csv",
        "figures/search-volume.svg", "tables/search-history.csv"}  # fmt: skip


def twin(*arguments, code: int = 0) -> None:
    assert main([str(argument) for argument in ("twin", *arguments, *QUICK)]) == code


def block(path, low, high, *, label: int = 1, spacing: float = 0.5):
    """A label volume: a block, all else 0, in a world where voxel 0 lies two voxels before ``low``."""
    size = np.round((np.array(high) - low) / spacing).astype(int)
    values = np.pad(np.full(size[::-1], label, np.uint8), 2)
    return write_nrrd(path, values, spacing=(spacing,) * 3, origin=np.array(low) - 1.5 * spacing)


@pytest.fixture
def unreported(monkeypatch):
    """No report, which takes longer than all else."""
    monkeypatch.setattr("vascval.report.write.write_compare_report", lambda *args, **options: None)


@pytest.fixture
def tissue(tmp_path):
    """A block around the small tree's branches: z from 6 on, so that the stem passes its wall."""
    return block(tmp_path / "tissue.nrrd", (-20, -14, 6), (20, 14, 38))


def inside(path, points: np.ndarray) -> np.ndarray:
    volume = read_volume(path)
    x, y, z = np.rint(volume.to_index(points)).astype(int).T
    return volume.values[z, y, x] == 1


def along(tree) -> np.ndarray:
    share = np.linspace(0, 1, 21)[:, None, None]
    return (tree.position_mm[tree.parent[1:]] * (1 - share) + tree.position_mm[1:] * share).reshape(-1, 3)


def test_in_the_hull(tmp_path, cast_file, capsys):
    out = tmp_path / "twin"
    twin(cast_file, "-o", out, "--json", tmp_path / "twin.json")
    said, notes = capsys.readouterr()
    assert "terminals" in said and f"report: {out / 'report.html'}" in said
    assert notes == ""
    assert set(contents(out)) >= {*LEFT, "domain.nrrd"}
    document = json.loads((tmp_path / "twin.json").read_text())
    jsonschema.validate(document, schemas.schema("twin"))
    jsonschema.validate(json.loads((out / "report.json").read_text()), schemas.schema("twin"))
    facts = document["twin"]
    assert facts["domain"]["kind"] == "hull"
    volume = read_volume(out / "domain.nrrd")
    assert facts["domain"]["volume_mm3"] == pytest.approx(volume.values.sum() * np.prod(volume.spacing_mm))
    assert facts["cast"]["length_inside_share"] == facts["cast"]["terminals_inside_share"] == 1.0
    assert [tree["method"] for tree in facts["trees"]] == ["cco", "full"]
    assert [stage["name"] for stage in facts["trees"][1]["stages"]] == ["growth", "topology", "geometry"]
    for tree in facts["trees"]:
        found = read_tree(out / tree["file"])
        assert found.topology.n_terminals == tree["n_terminals"] == 4
        assert inside(out / "domain.nrrd", along(found)).mean() > 0.98  # samples on the wall round either way
        assert np.linalg.norm(found.position_mm[0] - read_tree(out / "cast.vtp").position_mm[0]) < 1e-9
        assert found.volume_mm3 == pytest.approx(tree["volume_mm3"], rel=1e-9)
        # the law of Poiseuille: radii go with the fourth root of flow over pressure drop
        assert tree["pressure_drop_at_cast_root_mmhg"] == pytest.approx(4 * tree["root_radius_to_cast"] ** 4)
    assert facts["trees"][1]["volume_mm3"] <= facts["trees"][0]["volume_mm3"] * (1 + 1e-9)
    assert "<h2>Twin</h2>" in (out / "report.html").read_text()


@pytest.mark.usefixtures("unreported")
def test_the_same_again(tmp_path, cast_file, tissue):
    for name in ("a", "b"):
        twin(cast_file, "-o", tmp_path / name, "--domain", tissue)
    assert contents(tmp_path / "a") == contents(tmp_path / "b")


@pytest.mark.usefixtures("unreported")
def test_generate_grows_the_same_trees(tmp_path, cast_file, tissue):
    """What is recorded is what it takes: the configuration in a tree's file gives the tree."""
    out = tmp_path / "twin"
    twin(cast_file, "-o", out, "--domain", tissue, "--set", "seed=3")
    for name in ("cco", "optimised"):
        tree = read_tree(out / f"{name}.vtp")
        config = tree.meta["provenance"]["config"]
        root = ",".join(repr(x) for x in config["root_mm"])
        arguments = [
            f"domain.file={out / config['domain']['file']}", f"root_mm={root}", f"method={config['method']}",
            f"n_terminals={config['n_terminals']}", f"seed={config['seed']}", *QUICK[1::2],
        ]  # fmt: skip
        again = tmp_path / "again.vtp"
        assert main(["generate", "portal-vein", "-o", str(again), *(x for a in arguments for x in ("--set", a))]) == 0
        assert np.array_equal(read_tree(again).position_mm, tree.position_mm)
        assert np.array_equal(read_tree(again).radius_mm, tree.radius_mm)


@pytest.mark.usefixtures("unreported")
def test_in_given_tissue(tmp_path, cast_file, tissue, capsys):
    out = tmp_path / "twin"
    twin(cast_file, "-o", out, "--domain", tissue, "--json", tmp_path / "twin.json", "--set", "n_terminals=20")
    notes = capsys.readouterr().err
    assert "mm outside tissue.nrrd; the cast is taken from (" in notes and "0 of 4 terminals" in notes
    facts = json.loads((tmp_path / "twin.json").read_text())["twin"]
    assert facts["domain"]["volume_mm3"] == pytest.approx(40 * 28 * 32)
    assert facts["root"]["position_mm"][2] == pytest.approx(6.0, abs=0.1)  # the stem passes the wall there
    assert facts["root"]["radius_mm"] == pytest.approx(3.0, rel=0.05)
    assert facts["cast"]["length_inside_share"] == pytest.approx(1.0)
    assert facts["cast"]["length_inside_share_given"] < 0.97
    assert [tree["n_terminals"] for tree in facts["trees"]] == [20, 20]
    assert any("cco has 20 terminals and the cast 4" in note for note in facts["notes"])


@pytest.mark.parametrize(("stem_mm", "said"), [(0.2, True), (1.9, True), (2.1, False)])
def test_a_stem_shorter_than_thick_is_told_of(stem_mm, said):
    """A stem of 2 mm diameter: the tables count it as generation 1 whatever its length."""
    position = [[0, 0, 0], [0, 0, stem_mm], [9, 0, 9], [-9, 0, 9]]
    tree = Tree(Topology(np.array([-1, 0, 1, 1])), np.array(position), np.array([0, 1.0, 0.8, 0.8]))
    analysis = analyze(tree, source="optimised")
    assert analysis.document()["generations"][0]["n_segments"] == 1
    notes = twin_outcome.Outcome._stubs(SimpleNamespace(trees=[analysis]))
    told = f"the root vessel of optimised is {stem_mm} mm long and 2 mm thick"
    assert [told in note for note in notes] == [True] * said


@pytest.mark.usefixtures("unreported")
def test_vessels_carved_out_of_the_tissue_are_closed(tmp_path, cast_file, tissue):
    mask, whole = read_volume(cast_file), read_volume(tissue)
    points = whole.to_world(np.argwhere(whole.values == 1)[:, ::-1])
    x, y, z = np.clip(np.rint(mask.to_index(points)).astype(int), 0, np.array(mask.values.shape[::-1]) - 1).T
    carved = whole.values.copy()
    carved[carved == 1] = 1 - mask.values[z, y, x]
    path = write_nrrd(tmp_path / "carved.nrrd", carved, spacing=(0.5,) * 3, origin=whole.origin_mm)
    assert carved.sum() < 0.99 * whole.values.sum()
    twin(cast_file, "-o", tmp_path / "twin", "--domain", path)
    closed = read_volume(tmp_path / "twin" / "domain.nrrd").values.sum()
    assert closed == pytest.approx(whole.values.sum(), rel=0.01)  # but for the mouth of the stem


@pytest.mark.usefixtures("unreported")
def test_a_label_and_a_surface(tmp_path, cast_file, capsys):
    import pyvista

    labels = block(tmp_path / "labels.nrrd", (-20, -14, -4), (20, 14, 38), label=5)
    twin(cast_file, "-o", tmp_path / "a", "--domain", labels, "--set", "domain.label=5")
    pyvista.Box((-20, 20, -14, 14, -4, 38)).triangulate().save(tmp_path / "box.stl")
    twin(cast_file, "-o", tmp_path / "b", "--domain", tmp_path / "box.stl", "--json", tmp_path / "b.json")
    facts = json.loads((tmp_path / "b.json").read_text())["twin"]
    assert facts["domain"]["kind"] == "surface" and (tmp_path / "b" / "domain.stl").is_file()
    assert facts["domain"]["volume_mm3"] == pytest.approx(40 * 28 * 42)
    capsys.readouterr()
    twin(cast_file, "-o", tmp_path / "c", "--domain", labels, "--set", "domain.label=4", code=2)
    assert "no voxel of label 4 (labels: 0, 5)" in capsys.readouterr().err


@pytest.mark.usefixtures("unreported")
def test_first_generations_are_given(tmp_path, cast_file):
    out = tmp_path / "twin"
    twin(cast_file, "-o", out, "--root-generations", 2, "--json", tmp_path / "twin.json", "--set", "n_terminals=30")
    facts = json.loads((tmp_path / "twin.json").read_text())["twin"]
    cast, given = read_tree(out / "cast.vtp"), read_tree(out / "root-tree.vtp")
    first = cast.columns["generation"][1:] <= 2
    assert facts["root"]["n_segments_given"] == given.n_segments == first.sum() == 3
    for name in ("cco", "optimised"):
        tree = read_tree(out / f"{name}.vtp")
        for k in range(1, given.n_nodes):
            at = np.linalg.norm(tree.position_mm - given.position_mm[k], axis=1).argmin()
            assert tree.position_mm[at] == pytest.approx(given.position_mm[k], abs=1e-9)
            assert tree.radius_mm[at] == pytest.approx(given.radius_mm[k], rel=1e-9)


@pytest.mark.usefixtures("unreported")
def test_a_tree_as_cast(tmp_path, tree_file):
    twin(tree_file, "-o", tmp_path / "twin")
    assert read_tree(tmp_path / "twin" / "cast.vtp").topology.n_terminals == 4


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere.nrrd"], "nowhere.nrrd: no such file"),
        (["{table}"], "{table}: is a table, and a volume or a tree is needed here"),
        (["{empty}"], "{empty}: every voxel has the value 0"),
        (["{cast}", "--domain", "nowhere.nrrd"], "nowhere.nrrd: no such file; check --domain"),
        (["{cast}", "--domain", "{table}"], "{table}: neither a volume nor a surface by its name"),
        (["{cast}", "--domain", "{empty}"], "{empty}: the volume holds only background"),
        (["{cast}", "--domain", "{far}"], "{cast}: no vessel lies in the domain"),
        (["{cast}", "--domain", "{corner}"], "of the cast's length lies in corner.nrrd, and of its terminals"),
        (["{cast}", "--domain", "{far}", "--hull-radius", "3"], "--domain and --hull-radius or --hull-margin exclude"),
        (["{cast}", "--hull-radius", "0"], "Invalid value for '--hull-radius'"),
        (["{cast}", "--hull-margin", "0.01", "--hull-radius", "30"], "{cast}: the margin of 0.01 mm is too small"),
        (["{cast}", "--set", "method=cco"], "--set method=cco: method is decided by the twin; both methods are grown"),
        (["{cast}", "--set", "root_mm=0,0,0"], "use --root"),
        (["{cast}", "--set", "domain.file=x.nrrd"], "use --domain"),
        (["{cast}", "--set", "domain.label=5"], "--set domain.label=5: says how a perfusion volume is read"),
        (["{cast}", "--set", "domain.closing_mm=1"], "is the hull of the cast; give a file with --domain"),
        (["{cast}", "--set", "domain.keep=largest"], "--set domain.keep=largest: says how"),
        (["{cast}", "--set", "n_terminal=5"], "n_terminal is no key of the configuration"),
        (["{cast}", "--set", "perfusion.flow_ml_min=-1"], "flow_ml_min"),
        (["{cast}", "--set", "n_terminals=1", "--root-generations", "2"], "n_terminals is 1; at least 2 are needed"),
        (["{cast}", "--root", "900,0,0"], "{cast}: root 900, 0, 0 lies"),
        (["{tree}", "--label", "1"], "{tree}: is no volume, so --label cannot apply"),
        (["{line}"], "{line}: "),
    ],
)
def test_refusals(arguments, message, tmp_path, cast_file, tree_file, capsys):
    files = {
        "cast": cast_file,
        "tree": tree_file,
        "table": tmp_path / "table.csv",
        "line": tmp_path / "line.swc",
        "empty": write_nrrd(tmp_path / "empty.nrrd", np.zeros((9, 9, 9), np.uint8)),
        "far": block(tmp_path / "far.nrrd", (500, 0, 0), (520, 20, 20)),
        "corner": block(tmp_path / "corner.nrrd", (-20, -14, 9), (20, 14, 18)),
    }
    files["table"].write_text("generation,n_segments\n1,1\n")
    files["line"].write_text("# unit: mm\n1 0 0 0 0 1 -1\n2 0 0 0 9 1 1\n")
    twin(*(text.format(**files) for text in arguments), "-o", tmp_path / "twin", code=2)
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("vascval: error: ") and err.count("\n") == 1
    assert message.format(**files) in err
    assert not (tmp_path / "twin").exists()
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".") and path.is_dir()]


@pytest.mark.usefixtures("unreported")
def test_a_report_that_will_be_replaced_is_told_of(tmp_path, tree_file, capsys):
    folder = tmp_path / "twin"
    folder.mkdir()
    for name in ("report.html", "mine.txt"):
        (folder / name).write_text("mine")
    twin(tree_file, "-o", folder)
    assert f"note: {folder}: the report that is there will be replaced at the end" in capsys.readouterr().err
    assert (folder / "mine.txt").read_text() == "mine"
    twin(tree_file, "-o", tmp_path / "new")
    assert "will be replaced" not in capsys.readouterr().err


@pytest.mark.usefixtures("unreported")
def test_an_input_is_not_overwritten(tmp_path, tree_file, capsys):
    folder = tmp_path / "twin"
    twin(tree_file, "-o", folder)
    capsys.readouterr()
    twin(folder / "cast.vtp", "-o", folder, code=2)
    assert "cast.vtp: is an input and would be overwritten; choose another directory" in capsys.readouterr().err


def test_configurations_refuse_every_key_that_the_twin_decides():
    for key in twin_parts._DECIDED:
        with pytest.raises(Exception, match=f"{key} is decided by the twin"):
            twin_parts.configurations([f"{key}=x"], has_file=False)


def interrupted_at(monkeypatch, owner, name, count):
    """Ctrl-C in the middle of a call of that, the count-th."""
    whole, calls = getattr(owner, name), 0

    def stopped(*arguments, **options):
        nonlocal calls
        calls += 1
        if calls == count:
            raise KeyboardInterrupt
        return whole(*arguments, **options)

    monkeypatch.setattr(owner, name, stopped)


@pytest.mark.usefixtures("unreported")
def test_an_interrupted_twin_goes_on_from_its_checkpoint_to_the_same_trees(tmp_path, cast_file, monkeypatch, capsys):
    twin(cast_file, "-o", tmp_path / "whole")
    assert not (tmp_path / "whole.checkpoint").exists()
    out, kept = tmp_path / "twin", tmp_path / "twin.checkpoint"
    with monkeypatch.context() as patch:
        interrupted_at(patch, Annealing, "_block", 4)
        twin(cast_file, "-o", out, "--checkpoint-every", 0, code=130)
    assert not out.exists() and kept.exists()
    twin(cast_file, "-o", out, code=2)
    assert "go on from it with --resume, or remove it" in capsys.readouterr().err
    twin(cast_file, "-o", out, "--resume", kept, "--set", "seed=7", code=2)
    assert "seed=7" in capsys.readouterr().err
    with monkeypatch.context() as patch:  # what is in the checkpoint is not done again
        patch.delattr("vascval.imaging.skeletonize")
        patch.delattr(Growth, "_begin")
        twin(cast_file, "-o", out, "--resume", kept)
    assert not kept.exists()
    assert contents(out) == contents(tmp_path / "whole")


@pytest.mark.parametrize(
    ("owner", "name", "left"),
    [
        (imaging, "skeletonize", False),  # nothing to go on from
        (twin_parts, "hull_ground", True),
        (Growth, "_advance", True),
        (twin_outcome.Outcome, "write", True),
    ],
)
@pytest.mark.usefixtures("unreported")
def test_interrupted_at_any_stage(tmp_path, cast_file, monkeypatch, capsys, owner, name, left):
    out, kept = tmp_path / "twin", tmp_path / "twin.checkpoint"
    before = contents(tmp_path)
    with monkeypatch.context() as patch:
        interrupted_at(patch, owner, name, 1)
        twin(cast_file, "-o", out, code=130)
    assert capsys.readouterr().err.splitlines()[-1] == "vascval: interrupted; no unfinished file is left behind"
    assert kept.exists() == left
    kept.unlink(missing_ok=True)
    assert contents(tmp_path) == before


def test_a_checkpoint_that_is_not_of_a_cast_is_refused(tmp_path, cast_file, monkeypatch, capsys):
    from generator import checkpoint

    out, kept = tmp_path / "twin", tmp_path / "twin.checkpoint"
    with monkeypatch.context() as patch:
        interrupted_at(patch, twin_parts, "hull_ground", 1)
        twin(cast_file, "-o", out, code=130)
    header, body = checkpoint._unpacked(kept)
    arrays = checkpoint._arrays(kept, header["arrays"], body)
    del arrays["cast.start"]
    checkpoint.write(kept, checkpoint.State(header["record"], arrays), header["origin"])
    capsys.readouterr()
    twin(cast_file, "-o", out, "--resume", kept, code=2)
    assert "holds a cast that is not sound; begin the run anew" in capsys.readouterr().err
    assert kept.exists()


def test_a_checkpoint_of_another_twin_is_refused(tmp_path, cast_file, mask, monkeypatch, capsys):
    out, kept = tmp_path / "twin", tmp_path / "twin.checkpoint"
    with monkeypatch.context() as patch:
        interrupted_at(patch, twin_parts, "hull_ground", 1)
        twin(cast_file, "-o", out, code=130)
    before = kept.read_bytes()
    capsys.readouterr()
    twin(cast_file, "--root-generations", 1, "-o", out, "--resume", kept, code=2)
    assert "is of another configuration: root_generations is 0 there and 1 here" in capsys.readouterr().err
    mask = mask.copy()
    mask[0, 0, 0] = 1
    write_nrrd(cast_file, mask, origin=(-18.0, -12.0, -5.0))
    twin(cast_file, "-o", out, "--resume", kept, code=2)
    assert "is of another configuration: the content of the input files differs" in capsys.readouterr().err
    with monkeypatch.context() as patch:
        patch.setattr("vascval.__version__", "9.9")
        twin(cast_file, "-o", out, "--resume", kept, code=2)
    assert "was written by vascval" in capsys.readouterr().err
    assert kept.read_bytes() == before
    assert not out.exists()
