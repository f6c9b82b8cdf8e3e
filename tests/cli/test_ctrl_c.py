"""Ctrl-C while an ensemble's workers start, as a terminal sends it: to all processes at once."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

INTERRUPTED = (130, -signal.SIGINT)  # Python ends itself by the signal where it came within an exec(); shells say 130


def begun_by(number):
    """(pid, command) of the processes of that group, but the one that it is named after."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, _, group = (folder / "stat").read_text().rpartition(")")[2].split()[:3]
            command = (folder / "cmdline").read_text()
        except OSError:  # ended meanwhile
            continue
        if int(group) == number != int(folder.name) and state != "Z":
            found.append((int(folder.name), command))
    return found


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks processes up in /proc")
@pytest.mark.parametrize("after_s", [0.0, 0.3, 1.0])
def test_while_workers_start(tmp_path, after_s):
    command = [sys.executable, "-m", "vascval.cli", "ensemble", "karch-box", "--seeds", "2", "--workers", "2"]
    command += ["--set", "n_terminals=300", "--set", "method=full", "-o", str(tmp_path / "study")]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    deadline = time.monotonic() + 60
    while not any("spawn_main" in line for _, line in begun_by(process.pid)):
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.02)
    time.sleep(after_s)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode in INTERRUPTED
    assert out == ""
    assert "Traceback" not in err
    assert err.splitlines()[-1] == "vascval: interrupted; no unfinished file is left behind"
    while begun_by(process.pid) and time.monotonic() < deadline:  # they may take a moment to go
        time.sleep(0.02)
    assert begun_by(process.pid) == []
