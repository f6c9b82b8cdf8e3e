"""``kill -9`` at random moments of ``vascval generate`` and ``twin``, then ``--resume``: the same, bit for bit."""

import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from cli_files import contents

from vascval.cli.main import main

METHODS = {
    "small": ["n_terminals=4000"],
    "cco": ["n_terminals=12000"],
    "geometry": ["n_terminals=500", "method=geometry"],
    "full": ["n_terminals=400", "method=full", "topology.at=200", "topology.tests=40000"],
}


def arguments(method, output):
    sets = [part for change in METHODS[method] for part in ("--set", change)]
    return ["generate", "karch-box", *sets, "-o", str(output), "--quiet", "--checkpoint-every", "0"]


def killed(command, kept, wait_s):
    """Starts a command and kills it so long after its checkpoint has appeared; whether it was still at work."""
    process = subprocess.Popen(
        [sys.executable, "-m", "vascval.cli", *command], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 120
    while not kept.exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.002)
    time.sleep(wait_s)
    os.kill(process.pid, signal.SIGKILL)
    _, error = process.communicate()
    assert process.returncode in (0, -signal.SIGKILL), error
    return process.returncode != 0


def same_after_kills(folder, method, n_kills, rng):
    whole, output = folder / "whole.vtp", folder / "tree.vtp"
    kept = folder / "tree.vtp.checkpoint"
    assert main(arguments(method, whole)) == 0  # which may compile kernels
    began = time.monotonic()
    assert main(arguments(method, whole)) == 0
    took_s = time.monotonic() - began
    n_resumed = 0
    for _ in range(n_kills):
        output.unlink(missing_ok=True)
        command = arguments(method, output)
        if killed(command, kept, float(rng.uniform(0.0, 0.7 * took_s))):
            assert not output.exists()
            command += ["--resume", str(kept)]
            n_resumed += 1
            assert main(command) == 0
        assert output.read_bytes() == whole.read_bytes()
        assert sorted(path.name for path in folder.iterdir()) == ["tree.vtp", "whole.vtp"]
    return n_resumed


def test_killed_and_resumed(tmp_path):
    assert same_after_kills(tmp_path, "small", 2, np.random.default_rng(3)) >= 1


@pytest.mark.slow
@pytest.mark.parametrize(("method", "n_kills"), [("cco", 8), ("geometry", 6), ("full", 6)])
def test_killed_at_random_moments_and_resumed(tmp_path, method, n_kills):
    assert same_after_kills(tmp_path, method, n_kills, np.random.default_rng(n_kills)) >= n_kills // 2


@pytest.mark.slow
def test_killed_again_and_again(tmp_path):
    """One tree that takes twelve processes, each but the last killed a moment after its first checkpoint."""
    whole, output, kept = tmp_path / "whole.vtp", tmp_path / "tree.vtp", tmp_path / "tree.vtp.checkpoint"
    assert main(arguments("full", whole)) == 0
    command, rng = arguments("full", output), np.random.default_rng(1)
    for _ in range(12):
        if not killed(command, kept, float(rng.uniform(1.5, 2.5)) if kept.exists() else 0.1):  # starting takes 1 s
            break
        command = [*arguments("full", output), "--resume", str(kept)]
    if not output.exists():
        assert main(command) == 0
    assert output.read_bytes() == whole.read_bytes()


TWIN = ["n_terminals=100", "topology.tests=20000", "topology.chains=1"]


def twin_arguments(cast, output):
    sets = [part for change in TWIN for part in ("--set", change)]
    return ["twin", str(cast), *sets, "-o", str(output), "--quiet", "--checkpoint-every", "0"]


def twins_after_kills(folder, cast, n_kills, rng):
    """How many of the killed twins were resumed, each to the same directory."""
    whole, output, kept = folder / "whole", folder / "twin", folder / "twin.checkpoint"
    assert main(twin_arguments(cast, whole)) == 0
    began = time.monotonic()
    assert main(twin_arguments(cast, output)) == 0
    took_s = time.monotonic() - began
    n_resumed = 0
    for _ in range(n_kills):
        shutil.rmtree(output)
        if killed(twin_arguments(cast, output), kept, float(rng.uniform(0.0, took_s))):
            assert main([*twin_arguments(cast, output), "--resume", str(kept)]) == 0
            n_resumed += 1
            assert contents(output) == contents(whole)
        assert not kept.exists()
    return n_resumed


def test_a_killed_twin_is_resumed(tmp_path, cast_file, monkeypatch):
    """Without the report, which takes longer than all else; the process that is killed would make it."""
    monkeypatch.setattr("vascval.report.write.write_compare_report", lambda *args, **options: None)
    assert twins_after_kills(tmp_path, cast_file, 2, np.random.default_rng(1)) >= 1


@pytest.mark.slow
def test_a_twin_killed_at_random_moments_is_resumed(tmp_path, cast_file):
    assert twins_after_kills(tmp_path, cast_file, 8, np.random.default_rng(2)) >= 4
