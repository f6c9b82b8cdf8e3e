"""What is feared of the disk: full, read-only, gone, shared. A clear error, nothing by halves, the old file whole."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from generator.growth.growth import Growth
from vascval.cli.main import main
from vascval.io.atomic import atomic_directory
from vascval.io.locks import claimed
from vascval.io.trees import read_tree

DRIVER = Path(__file__).with_name("faults_driver.py")
OLD = {"file": {"out.vtp": "old tree"}, "folder": {"out/report.html": "old report", "out/mine.txt": "mine"}}


@pytest.fixture(name="commands")
def _commands(cast_file, tree_file):
    """Each command without its output, and what it makes: a file or a folder."""
    return {
        "generate": (["generate", "karch-box", "--set", "n_terminals=30"], "file"),
        "skeletonize": (["skeletonize", str(cast_file)], "file"),
        "analyze": (["analyze", str(tree_file)], "folder"),
        "compare": (["compare", str(cast_file), str(tree_file)], "folder"),
        "twin": (["twin", str(cast_file), "--set", "topology.tests=200", "--set", "topology.chains=1"], "folder"),
        "optimum": (["optimum", "karch-box", "--set", "n_terminals=4"], "file"),
        "demo": (["demo"], "folder"),
    }


ENSEMBLE = ["ensemble", "karch-box", "--seeds", "2", "--set", "n_terminals=20", "--workers", "1"]


def place(folder, kind):
    return folder / ("out.vtp" if kind == "file" else "out")


def contents(folder):
    return {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("*") if path.is_file()}


def filled(folder, old):
    for name, text in old.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


def on_small_disk(folder, cases):
    """What came of the commands on a file system of their own; skips where the system grants none."""
    launcher = ["unshare", "-rm"]
    try:
        subprocess.run([*launcher, "true"], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("needs user and mount namespaces (unshare -rm)")
    command = [*launcher, sys.executable, str(DRIVER), str(folder)]
    done = subprocess.run(command, input=json.dumps(cases), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_full_and_read_only_disks(tmp_path, commands):
    cases, names = [], []
    for name, (arguments, kind) in commands.items():
        output = ["-o", str(place(tmp_path / "disk", kind)), "--quiet"]
        sizes_kb = (4,) if kind == "file" else (8, 16, 64)  # room for what is there and little more
        for read_only, size_kb in ((True, 4096), *((False, size_kb) for size_kb in sizes_kb)):
            names.append((name, read_only, size_kb))
            cases.append(
                {"size_kb": size_kb, "read_only": read_only, "old": OLD[kind], "arguments": [*arguments, *output]}
            )
    for case, name, found in zip(cases, names, on_small_disk(tmp_path, cases)):
        assert found["code"] == 2, (name, found)
        assert found["files"] == case["old"], name
        assert found["err"].count("\n") == 1, (name, found["err"])
        reason = "not writable" if case["read_only"] else "cannot be written (No space left on device)"
        assert reason in found["err"], name
        assert f"error: {tmp_path / 'disk' / 'out'}" in found["err"], name  # what it is about, not an input


def test_an_ensemble_on_a_full_disk_keeps_the_trees_that_are_whole(tmp_path):
    sizes_kb, out = (64, 300), tmp_path / "disk" / "out"  # room for one tree, for both but no report
    arguments = [*ENSEMBLE, "-o", str(out), "--quiet"]
    cases = [
        {"size_kb": size_kb, "read_only": False, "old": OLD["folder"], "arguments": arguments} for size_kb in sizes_kb
    ]
    for found, n_trees in zip(on_small_disk(tmp_path, cases), (1, 2)):
        assert found["code"] == 2
        assert "cannot be written (No space left on device)" in found["err"]
        assert found["err"].count("\n") == 1
        files = found["files"]
        trees = {f"out/trees/seed-{seed}.{suffix}" for seed in range(1, n_trees + 1) for suffix in ("json", "vtp")}
        assert set(files) == {*OLD["folder"], "out/log", "out/manifest.json", *trees}
        assert {name: files[name] for name in OLD["folder"]} == OLD["folder"]


def test_a_checkpoint_that_finds_no_room_does_not_end_the_run(tmp_path):
    kept, output = tmp_path / "disk" / "c", tmp_path / "tree.vtp"
    arguments = ["generate", "karch-box", "--set", "n_terminals=300", "-o", str(output), "--checkpoint", str(kept)]
    case = {"size_kb": 4, "read_only": False, "old": {"x": "x"}, "arguments": [*arguments, "--checkpoint-every", "0"]}
    (found,) = on_small_disk(tmp_path, [case])
    assert found["code"] == 0
    assert "note: no checkpoint: " in found["err"]
    assert "No space left on device" in found["err"]
    assert found["files"] == {"x": "x"}
    assert read_tree(output).topology.n_terminals == 300


@pytest.mark.parametrize("name", ["generate", "skeletonize", "analyze", "compare", "twin", "optimum", "ensemble"])
def test_two_runs_on_one_output(tmp_path, commands, name, capsys):
    arguments, kind = {**commands, "ensemble": (ENSEMBLE, "folder")}[name]
    folder = tmp_path / "results"
    filled(folder, OLD[kind])
    output = place(folder, kind)
    with claimed(output):
        assert main([*arguments, "-o", str(output)]) == 2
        error = capsys.readouterr().err
        assert f"{output}: is being written by another run; wait for its end or choose another name" in error
    assert contents(folder) == OLD[kind]
    if name in ("generate", "analyze"):  # a file, a folder: free again
        assert main([*arguments, "-o", str(output), "--quiet"]) == 0
        assert not list(folder.glob(".*"))


def test_what_a_killed_run_left_is_removed_by_the_next(tmp_path, commands):
    """Names as atomic writing gives them; what only looks alike stays."""
    aside = tmp_path / ".0123abcd-out.vtp"
    aside.write_text("half")
    others = [tmp_path / ".0123abcd-else.vtp", tmp_path / ".0123abc-out.vtp", tmp_path / "0123abcd-out.vtp"]
    for path in others:
        path.write_text("not ours")
    (tmp_path / ".fedcba98-out").mkdir()
    (tmp_path / ".out.vtp.lock").write_text("")
    assert main([*commands["generate"][0], "-o", str(tmp_path / "out.vtp"), "--quiet"]) == 0
    assert not aside.exists()
    assert all(path.exists() for path in others)
    assert main([*commands["analyze"][0], "-o", str(tmp_path / "out"), "--quiet"]) == 0
    assert not (tmp_path / ".fedcba98-out").exists()
    assert not (tmp_path / ".out.vtp.lock").exists()


@pytest.mark.parametrize("name", ["skeletonize", "analyze", "compare", "twin"])
def test_an_input_that_vanishes_in_the_middle(tmp_path, commands, name, monkeypatch, capsys):
    """After all was checked and its checksum taken."""
    import vascval.io.provenance

    record = vascval.io.provenance.provenance

    def vanishing(*, inputs, **others):
        found = record(inputs=inputs, **others)
        for path in inputs:
            Path(path).unlink()
        return found

    monkeypatch.setattr(vascval.io.provenance, "provenance", vanishing)
    arguments, kind = commands[name]
    folder = tmp_path / "results"
    filled(folder, OLD[kind])
    assert main([*arguments, "-o", str(place(folder, kind)), "--quiet"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("vascval: error: ")
    assert error.count("\n") == 1
    assert contents(folder) == OLD[kind]


def test_a_folder_that_vanishes_in_the_middle(tmp_path, monkeypatch, capsys):
    folder = tmp_path / "results"
    folder.mkdir()
    advance = Growth._advance

    def vanishing(self, target):
        shutil.rmtree(folder, ignore_errors=True)
        advance(self, target)

    monkeypatch.setattr(Growth, "_advance", vanishing)
    assert main(["generate", "karch-box", "--set", "n_terminals=30", "-o", str(folder / "tree.vtp")]) == 2
    error = capsys.readouterr().err
    assert f"error: {folder / 'tree.vtp'}: folder {folder} does not exist" in error
    assert not folder.exists()


def test_a_folder_in_the_way_of_a_file_moves_nothing(tmp_path, commands, capsys):
    folder = tmp_path / "results"
    filled(folder, {"out/report.html": "old", "out/tables": "a file, and last of all", "out/report.json/x": "x"})
    before = contents(folder)
    assert main([*commands["analyze"][0], "-o", str(folder / "out"), "--quiet"]) == 2
    assert "report.json: is a folder where a file belongs; move it away" in capsys.readouterr().err
    assert contents(folder) == before


def test_a_new_folder_appears_at_once(tmp_path):
    """Never with a part of its files."""
    with atomic_directory(tmp_path / "a" / "out") as aside:
        (aside / "x").write_text("1")
        assert not (tmp_path / "a").exists()
    assert contents(tmp_path) == {"a/out/x": "1"}


@pytest.mark.parametrize("key", ["root_tree", "terminals_file"])
def test_generate_does_not_write_over_its_inputs(tmp_path, key, capsys):
    output = tmp_path / "input.vtp"
    assert main(["generate", "karch-box", "--set", "n_terminals=2", "-o", str(output), "--quiet"]) == 0
    if key == "terminals_file":
        output.write_text("x_mm,y_mm,z_mm\n0,0,0\n1,1,1\n2,3,4\n")
    before = output.read_bytes()
    changes = ["--set", f"{key}={output}", "--set", "perfusion.terminal_pressure_mmhg=40"]
    assert main(["generate", "karch-box", *changes, "-o", str(output), "--set", "n_terminals=20"]) == 2
    assert "is an input and would be overwritten" in capsys.readouterr().err
    assert output.read_bytes() == before
