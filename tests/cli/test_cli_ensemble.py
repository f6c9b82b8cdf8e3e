"""``vascval ensemble``: the trees of ``generate``, whatever the workers; what is missing is made, and nothing else."""

import json
import os
import re
import signal
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import jsonschema
import numpy as np
import pandas as pd
import pytest
from cli_files import contents

from generator.ensemble import running
from generator.ensemble.log import logged
from generator.ensemble.manifest import Manifest
from generator.ensemble.plan import plan
from generator.ensemble.work import Failed, Grown
from vascval.cli import ensemble as command
from vascval.cli.main import main
from vascval.io import schemas

VASCVAL = [sys.executable, "-m", "vascval.cli"]
GRID = ["ensemble", "karch-box", "--set", "n_terminals=30", "--vary", "gamma=2.5,3"]
SLOW = ["ensemble", "karch-box", "--set", "n_terminals=1000", "--set", "method=geometry"]
"""Trees of some two seconds: long enough to be caught in the middle."""


def ensemble(*arguments: object) -> dict:
    """Runs the command; its document."""
    folder = Path(str(arguments[-1]))
    assert main([*map(str, arguments), "--json", str(folder.with_suffix(".json"))]) == 0
    return json.loads(folder.with_suffix(".json").read_text())


def same_everywhere(folder: Path) -> dict[str, str]:
    """What must not depend on the workers: all but the log, the times and who made what."""
    return {
        name: digest
        for name, digest in contents(folder).items()
        if name not in ("log", "manifest.json") and not re.fullmatch(r"trees/.*\.json", name)
    }


def log_of(folder: Path) -> str:
    path = folder / "log"
    return path.read_text(encoding="utf-8") if path.exists() else ""


def wait_for(pattern: str, folder: Path, process: subprocess.Popen, count: int = 1) -> list[str]:
    """What the log says of that, once it says it so many times."""
    limit = time.monotonic() + 120.0
    while time.monotonic() < limit:
        found = re.findall(pattern, log_of(folder))
        if len(found) >= count:
            return found
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    raise AssertionError(f"{pattern} is not in the log:\n{log_of(folder)}")


@contextmanager
def cluster(folder: Path, n_workers: int) -> Iterator[tuple[str, list[subprocess.Popen]]]:
    """A Dask scheduler and workers as processes of their own, in another directory; its address, and they."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    dask = [sys.executable, "-m", "dask"]
    commands = [[*dask, "scheduler", "--host", "127.0.0.1", "--port", str(port), "--dashboard-address", "127.0.0.1:0"]]
    commands += [[*dask, "worker", address, "--nthreads", "1", "--no-dashboard"]] * n_workers
    (folder / "elsewhere").mkdir()
    with (folder / "output").open("w") as output:
        processes = [
            subprocess.Popen(command, cwd=folder / "elsewhere", stdout=output, stderr=output) for command in commands
        ]
        try:
            yield address, processes
        finally:
            for process in reversed(processes):
                process.terminate()
            for process in processes:
                process.wait(timeout=60)


def error_line(capsys) -> str:
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("vascval: error: ")
    return err


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """Two cases of three seeds on two local processes."""
    folder = tmp_path_factory.mktemp("ensemble") / "made"
    document = ensemble(*GRID, "--seeds", 3, "--workers", 2, "-o", folder)
    assert document["n_made"] == document["n_done"] == 6
    assert document["n_workers"] == 2
    return folder


@pytest.mark.parametrize(("gamma", "seed"), [("2.5", 1), ("3", 3)])
def test_trees_are_those_of_generate(gamma, seed, made, tmp_path):
    tree = tmp_path / "tree.vtp"
    settings = ["n_terminals=30", f"gamma={gamma}", f"seed={seed}"]
    assert main(["generate", "karch-box", "-o", str(tree), *(f"--set={one}" for one in settings)]) == 0
    assert tree.read_bytes() == (made / "trees" / f"gamma-{gamma}_seed-{seed}.vtp").read_bytes()


def test_documents_hold_to_their_schemas(made):
    jsonschema.validate(json.loads(made.with_suffix(".json").read_text()), schemas.schema("ensemble"))
    jsonschema.validate(json.loads((made / "manifest.json").read_text()), schemas.schema("ensemble-manifest"))
    trees = pd.read_csv(made / "tables" / "trees.csv", keep_default_na=False).to_dict("records")
    jsonschema.validate(trees, schemas.schema("table-ensemble-trees"))
    for path in (made / "trees").glob("*.json"):
        jsonschema.validate(json.loads(path.read_text()), schemas.schema("analyze"))


def test_spread_is_that_of_the_trees(made):
    """Against plain Python, from the files of the trees."""
    generations = pd.read_csv(made / "tables" / "generations.csv")
    totals = pd.read_csv(made / "tables" / "totals.csv")
    documents = [json.loads((made / "trees" / f"gamma-3_seed-{k}.json").read_text()) for k in (1, 2, 3)]
    lengths = [
        row["length_mean_mm"] for document in documents for row in document["generations"] if row["generation"] == 2
    ]
    row = generations.query("case == 'gamma=3' and generation == 2 and measure == 'length_mean_mm'").iloc[0]
    volumes = [document["summary"]["volume_mm3"] for document in documents]
    total = totals.query("case == 'gamma=3' and measure == 'volume_mm3'").iloc[0]
    for values, found in ((lengths, row), (volumes, total)):
        assert found["n_trees"] == len(values) == 3
        q1, median, q3 = statistics.quantiles(values, n=4, method="inclusive")
        expected = [min(values), q1, median, q3, max(values), statistics.fmean(values), statistics.stdev(values)]
        names = ["min", "q1", "median", "q3", "max", "mean", "sd"]
        assert found[names].tolist() == pytest.approx(expected, rel=1e-12)  # sums of three in another order


def test_the_report_is_one_file_that_loads_nothing(made):
    page = (made / "report.html").read_text(encoding="utf-8")
    assert "default-src &#39;none&#39;; img-src data:" in page
    assert not re.findall(r'(?:src|href)="(?!data:|#)', page)
    for words in ("Ensemble of 6 trees", "gamma=2.5", "By generation", "gamma-3_seed-2", "option vary.gamma"):
        assert words in page
    assert page.count("data:image/svg+xml") == 7  # three totals and four statistics by generation
    assert "option gamma<" not in page and "option n_connections<" in page  # what is varied has no value of its own
    assert re.search(r">terminals</th>\s*(<td[^>]*>3</td>)\s*<td[^>]*>30 ± 0</td>(\s*<td[^>]*>30</td>){5}", page)
    assert "Monopodial: radius at most 0.5 " in page and "connectivity matrix" not in page  # what it has is defined


def test_a_second_call_makes_only_what_is_missing(made):
    before, manifest = contents(made), json.loads((made / "manifest.json").read_text())
    again = ensemble(*GRID, "--seeds", 3, "-o", made)
    assert (again["n_made"], again["n_done"]) == (0, 6)
    assert {name: text for name, text in contents(made).items() if name != "log"} == {
        name: text for name, text in before.items() if name != "log"
    }
    (made / "trees" / "gamma-3_seed-2.vtp").write_bytes(b"damaged")
    mended = ensemble(*GRID, "--seeds", 3, "--workers", 1, "-o", made)
    assert mended["n_made"] == 1
    assert same_everywhere(made) == {name: before[name] for name in same_everywhere(made)}
    now = json.loads((made / "manifest.json").read_text())
    assert [tree["sha256"] for tree in now["trees"]] == [tree["sha256"] for tree in manifest["trees"]]


def test_two_workers_of_a_scheduler_in_processes_of_their_own(made, tmp_path):
    """What a cluster runs, started by the commands that start it there."""
    with cluster(tmp_path, 2) as (address, _processes):
        document = ensemble(*GRID, "--seeds", 3, "--scheduler", address, "-o", tmp_path / "cluster")
    assert document["n_made"] == 6
    assert same_everywhere(tmp_path / "cluster") == same_everywhere(made)


def test_a_worker_killed_in_the_middle_costs_its_own_tree(tmp_path):
    folder = tmp_path / "killed"
    command = [*VASCVAL, *SLOW, "--seeds", "5", "--workers", "2", "-o", str(folder)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    name, number = wait_for(r"(seed-\d): begun on \S+:(\d+)", folder, process, 3)[-1]
    os.kill(int(number), signal.SIGKILL)
    _out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    log = log_of(folder)
    assert re.findall(r"(seed-\d): begun again", log) == [name]
    assert sorted(re.findall(r"(seed-\d): begun on", log)) == [f"seed-{k}" for k in range(1, 6)]
    assert sorted(re.findall(r"(seed-\d): done", log)) == [f"seed-{k}" for k in range(1, 6)]
    tree = tmp_path / "tree.vtp"
    settings = ["n_terminals=1000", "method=geometry", f"seed={name[5:]}"]
    assert main(["generate", "karch-box", "-o", str(tree), *(f"--set={one}" for one in settings)]) == 0
    assert tree.read_bytes() == (folder / "trees" / f"{name}.vtp").read_bytes()


def test_ctrl_c_keeps_what_is_done(tmp_path):
    folder, manifest = tmp_path / "stopped", tmp_path / "stopped.manifest"
    options = ["--workers", "2", "--checkpoint", str(manifest), "-o", str(folder)]
    process = subprocess.Popen(
        [*VASCVAL, *SLOW, "--seeds", "5", *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    workers = {int(number) for number in wait_for(r"begun on \S+:(\d+)", folder, process, 2)}
    wait_for("done on", folder, process)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to all of them
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert out == ""
    assert err.splitlines()[-1] == "vascval: interrupted; no unfinished file is left behind"
    assert "Traceback" not in err
    assert not any(Path(f"/proc/{number}").exists() for number in workers)
    states = [tree["state"] for tree in json.loads(manifest.read_text())["trees"]]
    n_done = states.count("done")
    assert 1 <= n_done < 5 and n_done + states.count("missing") == 5
    assert len(list((folder / "trees").iterdir())) == 2 * n_done
    assert ensemble(*SLOW, "--seeds", 5, *options)["n_made"] == 5 - n_done


@pytest.mark.parametrize("at", ["seed-1.vtp", "seed-1.json", "manifest.json"])
def test_ctrl_c_while_a_tree_is_kept(at, tmp_path, monkeypatch):
    """Wherever it comes among the files, all of them are written before it is heard."""
    wanted = plan("karch-box", ("n_terminals=20",), (), 2)
    manifest = Manifest.of(wanted, tmp_path / "manifest.json", tmp_path)
    grown = Grown(b"tree", {"summary": {"n_terminals": 20, "volume_mm3": 1.0}}, "a", 1.0)
    monkeypatch.setattr(running, "run", lambda *_: (running.Finished(order, grown) for order in wanted.orders))
    write = os.replace

    def interrupted(source, target):
        if Path(target).name == at:
            os.kill(os.getpid(), signal.SIGINT)
        write(source, target)

    monkeypatch.setattr(os, "replace", interrupted)
    with logged() as log, pytest.raises(KeyboardInterrupt):
        log.begin(tmp_path / "log")
        command._drive(None, list(wanted.orders), 2, manifest, log, None)
    assert sorted(path.name for path in (tmp_path / "trees").iterdir()) == ["seed-1.json", "seed-1.vtp"]
    assert Manifest.of(wanted, tmp_path / "manifest.json", tmp_path).missing(wanted) == list(wanted.orders[1:])
    assert len(log_of(tmp_path).splitlines()) == 1


@pytest.mark.slow
def test_killed_at_random_moments_and_called_again(tmp_path):
    """``kill -9`` of the command: its workers end too, and what it has made stays."""
    whole, folder, rng = tmp_path / "whole", tmp_path / "killed", np.random.default_rng(5)
    trees = ensemble(*SLOW, "--seeds", 12, "--workers", 2, "-o", whole)["manifest"]
    tree_s = statistics.fmean(tree["seconds"] for tree in trees)
    for _ in range(3):
        count = log_of(folder).count("begun on")
        process = subprocess.Popen(
            [*VASCVAL, *SLOW, "--seeds", "12", "--workers", "2", "-o", str(folder)],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        workers = {int(number) for number in wait_for(r"begun on \S+:(\d+)", folder, process, count + 2)[count:]}
        time.sleep(tree_s * float(rng.uniform(0.5, 1.8)))
        process.kill()
        process.wait()
        limit = time.monotonic() + 30.0
        while any(map(running_now, workers)) and time.monotonic() < limit:
            time.sleep(0.1)
        assert not any(map(running_now, workers))
    n_done = log_of(folder).count("done on")
    assert 1 <= n_done < 12
    assert ensemble(*SLOW, "--seeds", 12, "-o", folder)["n_made"] <= 12 - n_done
    assert same_everywhere(folder) == same_everywhere(whole)


def running_now(number: int) -> bool:
    """Whether there is such a process; one that has ended has no command line."""
    path = Path(f"/proc/{number}/cmdline")
    return path.exists() and path.read_bytes() != b""


def test_a_scheduler_lost_in_the_middle(tmp_path):
    folder = tmp_path / "lost"
    with cluster(tmp_path, 1) as (address, (scheduler, _worker)):
        command = [*VASCVAL, *SLOW, "--seeds", "3", "--scheduler", address, "-o", str(folder)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        wait_for("done on", folder, process)
        scheduler.kill()
        _out, err = process.communicate(timeout=120)
    assert process.returncode == 1
    assert err == f"vascval: error: {running._SCHEDULER_LOST}\n"
    assert [tree["state"] for tree in json.loads((folder / "manifest.json").read_text())["trees"]].count("done") == 1


def test_trees_that_fail_do_not_stop_the_others(tmp_path, capsys):
    folder = tmp_path / "some"
    arguments = ["ensemble", "karch-box", "--set", "n_terminals=30", "--vary", "growth.r_min_mm=0,2", "--seeds", "2"]
    assert main([*arguments, "-o", str(folder), "--json", str(tmp_path / "some.json")]) == 1
    _out, err = capsys.readouterr()
    assert err.startswith("vascval: error: 2 trees of 4 failed; growth.r_min_mm-2_seed-1: ")
    document = json.loads((tmp_path / "some.json").read_text())
    assert (document["n_done"], document["cases"]) == (2, ["growth.r_min_mm=0"])
    assert "2 trees of 4 could not be made" in (folder / "report.html").read_text(encoding="utf-8")
    assert main(["ensemble", "karch-box", "--set", "growth.r_min_mm=2", "--seeds", "1", "-o", str(tmp_path / "x")]) == 1
    assert "1 tree of 1 failed; seed-1: " in error_line(capsys)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["karch-box"], "Missing option '--seeds'"),
        (["karch-box", "--seeds", "0"], "--seeds 0: no tree would be made"),
        (["karch-box", "--seeds", "2", "--workers", "0"], "Invalid value for '--workers'"),
        (["karch-box", "--seeds", "2", "--workers", "1", "--scheduler", "tcp://a:1"], "exclude each other"),
        (["karch-boxes", "--seeds", "2"], "karch-boxes: neither a file nor a preset"),
        (["karch-box", "--seeds", "2", "--set", "gamma=9"], "karch-box: gamma: input should be"),
        (["karch-box", "--seeds", "2", "--vary", "gamma=2,9"], "karch-box: gamma: input should be"),
        (["karch-box", "--seeds", "2", "--vary", "gamma"], "--vary gamma: is not key=v1,v2"),
        (["karch-box", "--seeds", "2", "--set", "root_mm=-5,0,0"], "root"),
        (["karch-box", "--seeds", "2", "--set", "terminals_file=gone.csv"], "gone.csv: cannot be read"),
        (["karch-box", "--seeds", "2", "--scheduler", "here"], "--scheduler here: is no address"),
        (["karch-box", "--seeds", "2", "--checkpoint", "gone/manifest"], "gone/manifest: the directory gone does not"),
        (["karch-box", "--seeds", "2", "--json", "gone/a.json"], "gone/a.json: the directory gone does not exist"),
    ],
)
def test_bad_input_leaves_nothing(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["ensemble", *arguments, "-o", "study"]) == 2
    assert message in error_line(capsys)
    assert list(tmp_path.iterdir()) == []


def test_a_scheduler_that_does_not_answer(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("generator.ensemble.workers._SECONDS_TO_CONNECT", 1)
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        assert main([*GRID, "--seeds", "2", "--scheduler", address, "-o", str(tmp_path / "study")]) == 2
    assert f"--scheduler {address}: no Dask scheduler answers" in error_line(capsys)
    assert list(tmp_path.iterdir()) == []


def test_another_configuration_is_refused(made, capsys):
    before = contents(made)
    assert main([*GRID, "--seeds", "3", "--set", "n_terminals=31", "-o", str(made)]) == 2
    assert "is of another ensemble: n_terminals was 30 and is 31; choose another -o" in error_line(capsys)
    assert contents(made) == before


def test_where_the_directory_is_a_file(tmp_path, capsys):
    (tmp_path / "study").write_text("mine")
    assert main([*GRID, "--seeds", "2", "-o", str(tmp_path / "study")]) == 2
    assert "is a file, not a directory" in error_line(capsys)


def test_one_bar_for_all_workers(tmp_path, monkeypatch):
    """The trees done and the shares of those at work, and nothing counted twice when a worker is lost."""
    orders = plan("karch-box", ("n_terminals=20",), (), 3).orders
    events = [
        running.Begun("seed-2", "a"),
        running.Begun("seed-3", "b"),
        running.Share("seed-2", 0.5),
        running.Share("seed-3", 0.25),
        running.Begun("seed-2", "b", again=True),
        running.Finished(orders[2], Failed("no room")),
        running.Finished(orders[1], Failed("no room")),
    ]
    shown: list[tuple] = []
    monkeypatch.setattr(running, "run", lambda *_: (event for event in events))
    manifest = Manifest.of(plan("karch-box", ("n_terminals=20",), (), 3), tmp_path / "manifest.json", tmp_path)
    with logged() as log:
        log.begin(tmp_path / "log")
        assert command._drive(None, list(orders[1:]), 3, manifest, log, lambda *what: shown.append(what)) == 0
    assert shown == [("trees", done, 3) for done in (1.0, 1.0, 1.5, 1.75, 1.25, 2.0, 3.0)]
    lines = [line.split(" ", 2)[2] for line in log_of(tmp_path).splitlines()]
    assert lines[2:4] == ["seed-2: begun again, its worker was lost on b", "seed-3: failed: no room"]
