"""Watches a worker from outside: crashes and hangs are findings, after which a new worker goes on."""

from __future__ import annotations

import json
import selectors
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

CORPUS = Path(__file__).with_name("corpus")
TIMEOUT_S = 60.0
"""Wall time of one case after which the worker is taken for hanging; the machine may be loaded. See also ``SLOW_S``."""
_ROOT = Path(__file__).resolve().parents[2]
_COMMAND = ["-m", "tests.fuzz.worker"]


@dataclass(frozen=True)
class Finding:
    """A fault of a reader and the file that shows it."""

    target: str
    said: str
    data: bytes


def corpus() -> list[tuple[str, str]]:
    """(target, file) of every finding that is kept."""
    return [(path.parent.name, str(path)) for path in sorted(CORPUS.glob("*/*"))]


def replay(cases: Sequence[tuple[str, str]]) -> list[Finding]:
    """The faults that files still show."""
    return [item for item in _watched({"replay": list(cases)}) if isinstance(item, Finding)]


def fuzz(targets: Sequence[str], *, seed: int, cases: int, seconds: float) -> Iterator[Finding | dict[str, Any]]:
    """Findings as they come, and the counts of each target when it is done."""
    yield from _watched(
        {"targets": list(targets), "seed": seed, "cases": cases, "seconds": seconds, "corpus": str(CORPUS)}
    )


def _watched(order: dict[str, Any]) -> Iterator[Finding | dict[str, Any]]:
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        order = {**order, "folder": folder}
        while order.get("targets") or order.get("replay"):
            last: dict[str, Any] = {}
            for record in _records(order):
                if "finding" in record:
                    yield Finding(record["target"], record["finding"], bytes.fromhex(record["input"]))
                elif "done" in record:
                    yield record
                    order["targets"] = [name for name in order["targets"] if name != record["done"]]
                elif "replayed" in record:
                    order["replay"] = order["replay"][1:]
                    if record["said"] is not None:
                        file = Path(record["replayed"])
                        yield Finding(file.parent.name, record["said"], file.read_bytes())
                else:
                    last = record
            if "target" not in last:
                break
            if "died" in last:
                inputs = sorted(Path(folder, last["target"]).glob("input*"))
                yield Finding(last["target"], last["died"], inputs[0].read_bytes() if inputs else b"")
                if order.get("replay"):
                    order["replay"] = order["replay"][1:]
                else:
                    order["seed"] += 1
                    order["cases"] -= max(int(last["case"]), 0) + 1


def _records(order: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """What a worker says; in the end, when it did not end by itself, the last case once more with ``died``."""
    command = [sys.executable, *_COMMAND, json.dumps(order)]
    errors = Path(order["folder"], "errors")
    with errors.open("w") as stream, subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=stream, cwd=_ROOT, bufsize=0
    ) as process, selectors.DefaultSelector() as selector:  # fmt: skip
        assert process.stdout is not None
        selector.register(process.stdout, selectors.EVENT_READ)
        buffer, last, died = b"", {}, ""
        while True:
            if not selector.select(TIMEOUT_S):
                died = f"hang: no answer in {TIMEOUT_S:.0f} s"
                process.kill()
                break
            block = process.stdout.read(1 << 16)
            if not block:
                break
            *lines, buffer = (buffer + block).split(b"\n")
            for line in lines:
                record = json.loads(line)
                if "case" in record:
                    last = record
                elif "broken" in record:
                    raise RuntimeError(record["broken"])
                else:
                    yield record
        code = process.wait()
    if code != 0:
        if not last or code == 1:
            printed = Path(order["folder"], "printed").read_text(errors="replace")
            raise RuntimeError(f"the worker is broken: {errors.read_text()[-2000:]}{printed[-2000:]}")
        yield {**last, "died": died or f"crash: exit code {code} {errors.read_text()[-300:]}".strip()}
