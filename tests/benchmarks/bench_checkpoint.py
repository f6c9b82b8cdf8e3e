"""What it costs to keep a run: time to write a checkpoint, its size, its share of a minute, time to take it up again.

``python -m tests.benchmarks.bench_checkpoint`` prints a table. A minute lies between two checkpoints by default.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from generator import checkpoint
from generator.config import load
from generator.framework import Run
from tests.benchmarks.tables import main, table
from vascval.io.provenance import provenance

_REPEATS = 3


def cost(counts: Sequence[int] = (6000, 24_000, 100_000)) -> str:
    """Runs in the benchmark box, kept when all terminals have grown, which is when there is most to keep."""
    header = ("terminals", "MB", "write CPU s", "write wall s", "share of a minute %", "resume wall s")
    return table(header, [_row(count) for count in counts])


def _row(count: int) -> list[object]:
    config = load("karch-box", [f"n_terminals={count}"])
    run = Run.of(config)
    for _ in run.steps():
        pass
    origin = provenance(command="generate", config=config.model_dump(mode="json"), seed=config.seed, inputs=[])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "checkpoint"
        cpu, wall = time.process_time(), time.perf_counter()
        for _ in range(_REPEATS):
            checkpoint.write(path, run.state(), origin)
        cpu, wall = (time.process_time() - cpu) / _REPEATS, (time.perf_counter() - wall) / _REPEATS
        size = path.stat().st_size
        other = Run.of(config)
        began = time.perf_counter()
        other.restore(checkpoint.read(path, origin))
        resume = time.perf_counter() - began
    share = 100.0 * max(cpu, wall) / 60.0
    return [f"{count:,}", f"{size / 1e6:.1f}", f"{cpu:.3f}", f"{wall:.3f}", f"{share:.2f}", f"{resume:.3f}"]


if __name__ == "__main__":
    main({"cost": cost}, "checkpoints")
