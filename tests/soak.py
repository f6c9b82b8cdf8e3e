"""A long run and its memory: ``python -m tests.soak [--seconds N] [--every N] [--csv FILE] [--set KEY=VALUE ...]``.

``vascval generate`` searches for topologies, is asked to end when it has used so many seconds of CPU time, whatever the
load, and writes what it has. Its resident memory is read now and then from ``/proc`` (Linux). Exit code 1 when it rose.
"""

from __future__ import annotations

import argparse
import csv
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

SEARCH = ("n_terminals=500", "method=full", "topology.tests=1000000000")
"""More tests than are done in any time that one waits."""
MAY_RISE_MB = 8.0
"""From the second to the last quarter of the work: room for the allocator, none for a list that grows."""


@dataclass(frozen=True)
class Sample:
    """Seconds since the start, resident memory, CPU seconds used so far."""

    seconds: float
    memory_mb: float
    cpu_s: float


def watched(
    command: Sequence[str], cpu_s: float, every_s: float, begins: Path | None = None
) -> tuple[list[Sample], int]:
    """Runs a command, asks it to end when it has used so many CPU seconds since a file appeared; samples, exit code.

    One that stands still is asked to end too, after twenty times as long.
    """
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    samples = list[Sample]()
    try:
        while begins is not None and not begins.exists() and process.poll() is None:
            time.sleep(0.05)
        began = time.monotonic()
        while process.poll() is None:
            samples.append(Sample(time.monotonic() - began, *_use(process.pid)))
            if samples[-1].cpu_s - samples[0].cpu_s >= cpu_s or samples[-1].seconds > 20.0 * cpu_s:
                break
            time.sleep(every_s)
        process.send_signal(signal.SIGTERM)
        return samples, process.wait(timeout=600)
    finally:
        process.kill()


def rise_mb(samples: Sequence[Sample]) -> float:
    """The median memory of the last quarter of the work less that of the second: the first one loads and compiles."""
    begin, end = samples[0].cpu_s, samples[-1].cpu_s
    quarters: list[list[float]] = [[], [], [], []]
    for sample in samples:
        quarters[min(int(4.0 * (sample.cpu_s - begin) / (end - begin)), 3)].append(sample.memory_mb)
    return statistics.median(quarters[3]) - statistics.median(quarters[1])


def soak(cpu_s: float, every_s: float, changes: Sequence[str], folder: Path) -> list[Sample]:
    """A search that takes so many CPU seconds, with a checkpoint each sixtieth of that (of an hour, as by default); its
    samples, from the first checkpoint on. A short search before compiles the kernels.

    :raises AssertionError: when it did not work so long or end as asked, or left no valid tree or no checkpoint.
    """
    from vascval.io.trees import read_tree

    tree = folder / "tree.vtp"
    kept = tree.with_name("tree.vtp.checkpoint")
    settings = [part for change in (*SEARCH, *changes) for part in ("--set", change)]
    command = [sys.executable, "-m", "vascval.cli", "generate", "karch-box", *settings, "-o", str(tree), "--quiet"]
    subprocess.run([*command, "--set", "topology.tests=1"], check=True, stdout=subprocess.DEVNULL)
    tree.unlink()
    samples, code = watched([*command, "--checkpoint-every", str(cpu_s / 60)], cpu_s, every_s, begins=kept)
    assert code == 128 + signal.SIGTERM, f"the run ended with code {code}"
    assert samples[-1].cpu_s - samples[0].cpu_s >= cpu_s, "the run stood still"
    assert read_tree(tree).topology.n_terminals > 0
    assert kept.exists()
    return samples


def _use(pid: int) -> tuple[float, float]:
    status = Path(f"/proc/{pid}/status").read_text()
    kb = next(line.split()[1] for line in status.splitlines() if line.startswith("VmRSS"))
    ticks = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    return int(kb) / 1e3, sum(map(int, ticks)) / 100.0


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.soak", description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=3600.0, help="CPU time of it (default 3600)")
    parser.add_argument("--every", type=float, default=10.0, help="seconds between samples (default 10)")
    parser.add_argument("--csv", type=Path, help="where the samples go")
    parser.add_argument("--set", dest="changes", action="append", default=[], metavar="KEY=VALUE", help="see generate")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        samples = soak(given.seconds, given.every, given.changes, Path(folder))
    if given.csv is not None:
        with given.csv.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream)
            writer.writerow([field.name for field in fields(Sample)])
            writer.writerows(astuple(sample) for sample in samples)
    rise = rise_mb(samples)
    most, last = max(sample.memory_mb for sample in samples), samples[-1]
    print(f"{last.seconds:.0f} s, {last.cpu_s:.0f} CPU s, at most {most:.0f} MB, last - second quarter {rise:+.1f} MB")
    return 1 if rise > MAY_RISE_MB else 0


if __name__ == "__main__":
    sys.exit(main())
