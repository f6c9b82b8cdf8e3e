"""An ensemble of ten trees on one worker and on two: how much faster two are.

``python -m tests.benchmarks.bench_ensemble [workers ...]`` prints a table. Wall times: measure on a machine with
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
from pathlib import Path

from tests.benchmarks.tables import main, table


def workers(counts: Sequence[int] = (1, 2), n_trees: int = 10, n_terminals: int = 6000) -> str:
    """Seconds of making the trees, from the first handed out to the last one back, and of the whole command.

    Trees of the benchmark box with their geometry optimised. The first call is there to compile and is not counted.
    """
    with tempfile.TemporaryDirectory() as folder:
        _timed(Path(folder) / "first", 1, 2, 50)
        found = [_timed(Path(folder) / str(count), count, n_trees, n_terminals) for count in counts]
    rows = [
        [
            count,
            f"{making:.1f}",
            f"{found[0][0] / making:.2f}",
            f"{whole:.1f}",
            f"{found[0][1] / whole:.2f}",
            f"{load:.1f}",
        ]
        for count, (making, whole, load) in zip(counts, found, strict=True)
    ]
    header = ("workers", "trees s", "times as fast", "command s", "times as fast", "load of others")
    return table(header, rows)


def _timed(folder: Path, count: int, n_trees: int, n_terminals: int) -> tuple[float, float, float]:
    """Seconds for the trees, for the command, and the processors that others kept busy meanwhile."""
    settings = ["--set", f"n_terminals={n_terminals}", "--set", "method=geometry"]
    document = folder.with_suffix(".json")
    command = [sys.executable, "-m", "vascval.cli", "ensemble", "karch-box", *settings, "--seeds", str(n_trees)]
    command += ["--workers", str(count), "-o", str(folder), "--json", str(document), "--quiet"]
    began, busy, ours = time.perf_counter(), _busy_s(), sum(os.times()[:4])
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    whole = time.perf_counter() - began
    load = (_busy_s() - busy - (sum(os.times()[:4]) - ours)) / whole
    return json.loads(document.read_text())["seconds"], whole, max(load, 0.0)


def _busy_s() -> float:
    """Seconds that all processors together have worked so far; 0 where the system does not say."""
    try:
        first = Path("/proc/stat").read_text().splitlines()[0].split()[1:]
    except OSError:
        return 0.0
    user, nice, system = (int(value) for value in first[:3])
    return (user + nice + system) / os.sysconf("SC_CLK_TCK")


TABLES: dict[str, Callable[[], str]] = {"workers": workers}


if __name__ == "__main__":
    main(TABLES, "ensembles")
