"""An ensemble of ten trees on one worker and on two: how much faster two are.

``python -m tests.benchmarks.bench_ensemble [workers] [large]`` prints tables. Wall times: measure on a machine with
nothing else to do and two free cores.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.benchmarks.tables import main, table


def workers(
    counts: Sequence[int] = (1, 2), n_trees: int = 10, n_terminals: int = 6000, method: str = "geometry"
) -> str:
    """Seconds of making the trees, from the first handed out to the last one back, and of the whole command.

    What a busy machine does not change is told too: the trees at work at once in the mean, and the CPU seconds of the
    command. Trees of the benchmark box; a first call compiles and is not counted.
    """
    with tempfile.TemporaryDirectory() as folder:
        _timed(Path(folder) / "first", 1, 2, 50, method)
        found = [_timed(Path(folder) / str(count), count, n_trees, n_terminals, method) for count in counts]
    rows = [
        [count, f"{one.making_s:.1f}", f"{found[0].making_s / one.making_s:.2f}", f"{one.command_s:.1f}",
         f"{found[0].command_s / one.command_s:.2f}", f"{one.at_once:.2f}", f"{one.cpu_s:.1f}"]
        for count, one in zip(counts, found, strict=True)
    ]  # fmt: skip
    header = ("workers", "trees s", "times as fast", "command s", "times as fast", "at once", "CPU s")
    return table(header, rows)


@dataclass(frozen=True)
class Timed:
    """Wall seconds of making the trees and of the command, its CPU seconds, and trees at work at once in the mean."""

    making_s: float
    command_s: float
    cpu_s: float
    at_once: float


def large() -> str:
    """As :func:`workers`, of trees with their topology searched as well, which take ten times as long."""
    return workers(n_terminals=12_000, method="full")


def _timed(folder: Path, count: int, n_trees: int, n_terminals: int, method: str) -> Timed:
    settings = ["--set", f"n_terminals={n_terminals}", "--set", f"method={method}"]
    file = folder.with_suffix(".json")
    command = [sys.executable, "-m", "vascval.cli", "ensemble", "karch-box", *settings, "--seeds", str(n_trees)]
    command += ["--workers", str(count), "-o", str(folder), "--json", str(file), "--quiet"]
    began, busy = time.perf_counter(), os.times()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    whole, after = time.perf_counter() - began, os.times()
    cpu = after.children_user + after.children_system - busy.children_user - busy.children_system
    document = json.loads(file.read_text())
    trees = sum(tree["seconds"] for tree in document["manifest"])
    return Timed(document["seconds"], whole, cpu, trees / document["seconds"])


TABLES: dict[str, Callable[[], str]] = {"workers": workers, "large": large}


if __name__ == "__main__":
    main(TABLES, "ensembles")
