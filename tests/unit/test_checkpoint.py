"""A run that is kept and gone on with ends in the same tree; a checkpoint that is not this run's is refused."""

import hashlib
import shutil
from types import SimpleNamespace

import numpy as np
import pytest

from generator import checkpoint
from generator.config import load
from generator.framework import Run
from generator.growth.growth import Growth
from vascval.cli.main import main
from vascval.core.errors import InputError
from vascval.io.provenance import provenance
from vascval.io.trees import read_tree, write_tree

FULL = ("method=full", "topology.at=60", "topology.tests=3000", "geometry.every=20")


def origin_of(run):
    return provenance(
        command="generate", config=run.config.model_dump(mode="json"), seed=run.config.seed, inputs=run.inputs()
    )


def begun(changes):
    return Run.of(load("karch-box", changes))


def exact(tree):
    columns = {name: values.tobytes() for name, values in tree.columns.items()}
    return tree.parent.tobytes(), tree.position_mm.tobytes(), tree.radius_mm.tobytes(), columns


@pytest.fixture(name="slow_steps")
def _slow_steps(monkeypatch):
    """Growth pauses every 50 terminals, so that there are many moments to choose from."""
    monkeypatch.setattr("generator.growth.growth._STEP_S", 0.0)


def files(folder, changes):
    rng = np.random.default_rng(4)
    points = np.vstack([[0, 0, 0], rng.random((300, 3)) * (90, 70, 16)])
    np.savetxt(folder / "points.csv", points, delimiter=",", header="x_mm,y_mm,z_mm", comments="")
    root = begun(["n_terminals=3", "perfusion.terminal_pressure_mmhg=90"])
    list(root.steps())
    write_tree(root.tree(), folder / "root.vtp")
    return [change.format(folder=folder) for change in changes]


@pytest.mark.usefixtures("slow_steps")
@pytest.mark.parametrize(
    "changes",
    [
        ("n_terminals=400",),
        ("n_terminals=400", "growth.merge_mm=1.0"),
        ("n_terminals=300", "growth.avoid_intersections=true", "perfusion.flow_ml_min=2000"),
        ("terminals_file={folder}/points.csv",),
        ("terminals_file={folder}/points.csv", "terminals_order=random", "growth.merge_mm=0.5"),
        ("n_terminals=400", "root_tree={folder}/root.vtp"),
        ("n_terminals=300", "domain.shape=horseshoe", "root_mm=none"),
        ("n_terminals=900", "growth.r_min_mm=0.08", "growth.at_r_min=stop"),
        ("n_terminals=120", "method=geometry", "geometry.every=20"),
        ("n_terminals=100", *FULL),
    ],
    ids=lambda changes: " ".join(changes[1:2]) or "plain",
)
def test_gone_on_with_from_any_step_it_is_the_same_tree(tmp_path, changes):
    changes = files(tmp_path, changes)
    run, kept = begun(changes), []
    for number, (_name, _step) in enumerate(run.steps()):
        if number % 3 == 0 or number < 3:
            path = tmp_path / f"{number}.checkpoint"
            checkpoint.write(path, run.state(), origin_of(run))
            kept.append(path)
    whole = exact(run.tree())
    assert len(kept) >= 4
    for path in kept:
        other = begun(changes)
        other.restore(checkpoint.read(path, origin_of(other)))
        list(other.steps())
        assert exact(other.tree()) == whole, path.name


def test_a_chain_that_is_at_its_end_is_not_ended_again(tmp_path, monkeypatch):
    """On one thread chains follow each other: those before the one at work are done when the run is kept."""
    monkeypatch.setenv("VASCVAL_THREADS", "1")
    changes = ("n_terminals=200", "method=full", "topology.at=200", "topology.tests=20000", "topology.chains=3")
    run, kept = begun(changes), {}
    for name, _step in run.steps():
        if name == "topology":
            n_ended = sum(chain.n_tests == 20_000 for chain in run.topology._now.chains)
            kept[n_ended] = tmp_path / str(n_ended)
            checkpoint.write(kept[n_ended], run.state(), origin_of(run))
    whole = exact(run.tree())
    assert sorted(kept) == [0, 1, 2, 3]
    for path in kept.values():
        other = begun(changes)
        other.restore(checkpoint.read(path, origin_of(other)))
        list(other.steps())
        assert exact(other.tree()) == whole, path.name


@pytest.fixture(name="half", scope="module")
def _half(tmp_path_factory):
    """A checkpoint in the middle of a run, with the run's own record."""
    run = begun(["n_terminals=300"])
    path = tmp_path_factory.mktemp("half") / "tree.vtp.checkpoint"
    for _name, step in run.steps():
        if step.n_terminals >= 100:
            checkpoint.write(path, run.state(), origin_of(run))
            break
    return path, origin_of(run)


def refused(path, changes=("n_terminals=300",), output="tree.vtp"):
    sets = [part for change in changes for part in ("--set", change)]
    return main(["generate", "karch-box", *sets, "-o", str(path.with_name(output)), "--resume", str(path), "--quiet"])


@pytest.mark.parametrize("change", ["seed=2", "n_terminals=301", "growth.spacing=0.41", "domain.box_mm=90,70,17"])
def test_another_configuration_is_refused(half, capsys, change):
    before = half[0].read_bytes()
    assert refused(half[0], ["n_terminals=300", change]) == 2
    error = capsys.readouterr().err
    assert "tree.vtp.checkpoint: is of another configuration" in error
    assert change.split("=")[0] in error
    assert half[0].read_bytes() == before
    assert not half[0].with_name("tree.vtp").exists()


def test_another_version_is_refused(half, capsys, monkeypatch):
    monkeypatch.setattr("vascval.__version__", "9.9")
    assert refused(half[0]) == 2
    assert "was written by vascval" in capsys.readouterr().err


def test_another_state_of_the_same_version_is_refused(half, capsys, monkeypatch):
    monkeypatch.setattr("generator.checkpoint.CODE_SHA256", "0" * 64)
    assert refused(half[0]) == 2
    assert "with other sources than this one has" in capsys.readouterr().err


def test_other_content_of_an_input_is_refused_and_another_place_is_not(tmp_path):
    changes = files(tmp_path, ["terminals_file={folder}/points.csv"])
    run = begun(changes)
    next(run.steps())
    path = tmp_path / "c"
    checkpoint.write(path, run.state(), origin_of(run))
    moved = tmp_path / "moved.csv"
    moved.write_bytes((tmp_path / "points.csv").read_bytes())
    checkpoint.read(path, origin_of(begun([f"terminals_file={moved}"])))
    moved.write_text(moved.read_text().replace("\n0.0", "\n1.0", 1))
    with pytest.raises(InputError, match="the content of the input files differs"):
        checkpoint.read(path, origin_of(begun([f"terminals_file={moved}"])))


def test_half_written_and_damaged_ones_are_refused(half, tmp_path, capsys):
    whole = half[0].read_bytes()
    rng = np.random.default_rng(0)
    cuts = [whole[: int(size)] for size in rng.integers(1, len(whole), 20)]
    flips = []
    for place in rng.integers(0, len(whole), 20):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << int(rng.integers(8))
        flips.append(bytes(damaged))
    path = tmp_path / "x.checkpoint"
    for content in [b"", b"\0" * len(whole), whole + b"\0", *cuts, *flips]:
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"damaged or only half there|no checkpoint|another format"):
            checkpoint.read(path, half[1])
    assert refused(path) == 2
    assert "x.checkpoint" in capsys.readouterr().err


def forged(path, target, change):
    """The checkpoint with other arrays and a right checksum."""
    state = checkpoint.read(path, begun_origin := origin_of(begun(["n_terminals=300"])))
    arrays = {name: array.copy() for name, array in state.arrays.items()}
    change(arrays, state.record)
    checkpoint.write(target, checkpoint.State(state.record, arrays), begun_origin)


def setting(name, place, value):
    def change(arrays, _record):
        arrays[name][place] = value

    return change


def in_segment(name, place, value):
    def change(arrays, _record):
        from generator.growth._records import SEGMENT

        arrays["growth.tree.segment"].view(SEGMENT)[name][place] = value

    return change


@pytest.mark.parametrize(
    "change",
    [
        in_segment("parent", 5, 10**8),
        in_segment("parent", 5, -7),
        in_segment("child", 1, 10**8),
        in_segment("child", 9, 9),
        in_segment("sibling", 9, 9),
        in_segment("stem", 4, 77),
        in_segment("bx", 4, np.nan),
        in_segment("bx", 4, 1e300),
        in_segment("rho", 4, np.inf),
        setting("growth.tree.counts", 0, 10**9),
        setting("growth.tree.counts", 3, 10**9),
        setting("growth.tree.counts", 3, -4),
        setting("growth.tree.grid.link", 3, 10**8),
        setting("growth.tree.grid.link", slice(None), 3),
        setting("growth.tree.grid.owner", slice(None), 10**6),
        setting("growth.tree.grid.head", slice(None), 10**8),
        setting("growth.tree.grid.free", 1, 10**8),
        setting("growth.tree.grid.cell_mm", 0, 1e-300),
        setting("growth.tree.grid.cell_mm", 0, np.nan),
        setting("growth.tree.stems.top", 0, 10**8),
        setting("growth.points", 0, np.nan),
        lambda arrays, record: arrays.pop("growth.outcome"),
        lambda arrays, record: arrays.update({"growth.rng": np.zeros(2, np.uint64)}),
        lambda arrays, record: arrays.update({"growth.points": np.zeros(7)}),
        lambda arrays, record: record.pop("until"),
        lambda arrays, record: record.update(until=10**9),
        lambda arrays, record: record.update(stages=[]),
        lambda arrays, record: record.update(stages=3),
    ],
)
def test_a_sound_checksum_over_unsound_content_is_refused(half, tmp_path, change):
    """Indices that lead out of an array would crash the kernels, lists that end in themselves would hang them."""
    path = tmp_path / "forged"
    forged(half[0], path, change)
    run = begun(["n_terminals=300"])
    with pytest.raises(InputError, match="begin the run anew"):
        run.restore(checkpoint.read(path, half[1]))


def test_a_header_that_announces_too_much_is_refused(half, tmp_path):
    content = half[0].read_bytes()
    for old, new in ((b'"<i8", [6]', b'"<i8", [99999999999]'), (b'"<i8", [6]', b'"|O8", [6]'), (b"{", b"[")):
        body = content[:-32]
        at, size = 21, int.from_bytes(content[21:29], "little")
        header = body[at + 8 : at + 8 + size].replace(old, new, 1)
        assert header != body[at + 8 : at + 8 + size]
        made = body[:at] + len(header).to_bytes(8, "little") + header + body[at + 8 + size :]
        path = tmp_path / "forged"
        path.write_bytes(made + hashlib.sha256(made).digest())
        with pytest.raises(InputError, match=r"lists arrays that it does not hold|no sound header"):
            checkpoint.read(path, half[1])


def interrupted_at(monkeypatch, count, action):
    advance = Growth._advance

    def interrupted(self, target):
        advance(self, target)
        if self.n_grown >= count:
            monkeypatch.setattr(Growth, "_advance", advance)
            action()

    monkeypatch.setattr(Growth, "_advance", interrupted)


@pytest.mark.parametrize(("signal_name", "code"), [("SIGINT", 130), ("SIGTERM", 143)])
def test_interrupted_and_resumed_the_command_writes_the_same_bytes(tmp_path, monkeypatch, capsys, signal_name, code):
    import json
    import os
    import signal

    command = ["generate", "karch-box", "--set", "n_terminals=800"]
    assert main([*command, "-o", str(tmp_path / "whole.vtp")]) == 0
    output, kept = tmp_path / "tree.vtp", tmp_path / "tree.vtp.checkpoint"
    interrupted_at(monkeypatch, 300, lambda: os.kill(os.getpid(), getattr(signal, signal_name)))
    assert main([*command, "-o", str(output)]) == code
    assert 300 <= read_tree(output).topology.n_terminals < 800
    assert f"go on from here with --resume {kept}" in capsys.readouterr().err
    assert main([*command, "-o", str(output)]) == 2
    assert "is the checkpoint of an interrupted run; go on from it with --resume" in capsys.readouterr().err
    assert main([*command, "-o", str(output), "--resume", str(kept), "--json", str(tmp_path / "j")]) == 0
    assert output.read_bytes() == (tmp_path / "whole.vtp").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["j", "tree.vtp", "whole.vtp"]
    assert json.loads((tmp_path / "j").read_text())["n_terminals"] == 800


def test_seconds_add_up_over_runs(half):
    run = begun(["n_terminals=300"])
    state = checkpoint.read(half[0], half[1])
    state.record["stages"][0]["seconds"] = 1000.0
    run.restore(state)
    list(run.steps())
    assert 1000.0 < run.stages[0].seconds < 1060.0  # what is left takes a moment


def test_an_interruption_leaves_an_older_tree_alone(tmp_path, monkeypatch, capsys):
    import os
    import signal

    output = tmp_path / "tree.vtp"
    assert main(["generate", "karch-box", "--set", "n_terminals=20", "-o", str(output)]) == 0
    before = output.read_bytes()
    interrupted_at(monkeypatch, 100, lambda: os.kill(os.getpid(), signal.SIGINT))
    assert main(["generate", "karch-box", "--set", "n_terminals=500", "-o", str(output)]) == 130
    assert output.read_bytes() == before
    assert f"{output} is left as it was" in capsys.readouterr().err


def test_a_geometry_that_is_interrupted_is_gone_on_with(tmp_path, monkeypatch):
    """While the geometry is computed, which may take long, an interruption does not wait for it."""
    import os
    import signal

    from generator.geometry.stage import GeometryStage

    command = ["generate", "karch-box", "--set", "n_terminals=100", "--set", "method=geometry", "--quiet"]
    assert main([*command, "-o", str(tmp_path / "whole.vtp")]) == 0
    for name in ("relax", "finish"):
        with monkeypatch.context() as patch:
            patch.setattr(GeometryStage, name, lambda *_: os.kill(os.getpid(), signal.SIGINT))
            assert main([*command, "-o", str(tmp_path / "tree.vtp")]) == 130
        again = [*command, "-o", str(tmp_path / "tree.vtp"), "--resume", str(tmp_path / "tree.vtp.checkpoint")]
        assert main(again) == 0
        assert (tmp_path / "tree.vtp").read_bytes() == (tmp_path / "whole.vtp").read_bytes()


def test_a_finished_tree_that_cannot_be_written_is_kept(tmp_path, monkeypatch, capsys):
    """The folder goes away while the tree grows: its checkpoint, in another place, holds all of it."""
    command = ["generate", "karch-box", "--set", "n_terminals=300", "--quiet"]
    assert main([*command, "-o", str(tmp_path / "whole.vtp")]) == 0
    folder, kept = tmp_path / "results", tmp_path / "kept"
    folder.mkdir()
    interrupted_at(monkeypatch, 300, lambda: shutil.rmtree(folder))
    assert main([*command, "-o", str(folder / "tree.vtp"), "--checkpoint", str(kept)]) == 2
    assert f"{folder / 'tree.vtp'}: folder {folder} does not exist" in capsys.readouterr().err
    folder.mkdir()
    there: list[int] = []
    monkeypatch.setattr(Growth, "_advance", lambda growth, _target: there.append(growth.n_grown))
    assert main([*command, "-o", str(folder / "tree.vtp"), "--resume", str(kept)]) == 0
    assert (folder / "tree.vtp").read_bytes() == (tmp_path / "whole.vtp").read_bytes()
    assert set(there) <= {300}  # nothing is grown again
    assert not kept.exists()


@pytest.mark.usefixtures("slow_steps")
def test_one_is_kept_each_minute_beside_the_tree(tmp_path, monkeypatch):
    """By a clock that goes on by 25 seconds with each step."""
    seconds, kept = [0.0], []
    write, advance = checkpoint.write, Growth._advance

    def noted(path, *others):
        kept.append((path, seconds[0]))
        write(path, *others)

    def timed(growth, target):
        advance(growth, target)
        seconds[0] += 25.0

    monkeypatch.setattr(checkpoint, "write", noted)
    monkeypatch.setattr(Growth, "_advance", timed)
    monkeypatch.setattr("vascval.cli.keeping.time", SimpleNamespace(monotonic=lambda: seconds[0]))
    command = ["generate", "karch-box", "--set", "n_terminals=500", "-o", str(tmp_path / "tree.vtp"), "--quiet"]
    assert main(command) == 0
    assert {path for path, _ in kept} == {tmp_path / "tree.vtp.checkpoint"}
    at = [when for _, when in kept]
    assert at[:3] == [75.0, 150.0, 225.0]
    assert [path.name for path in tmp_path.iterdir()] == ["tree.vtp"]
