"""One process that mutates and reads; what it does is told line by line to the process that watches it.

Lines on the channel (JSON): ``{"target": .., "case": ..}`` before each case, ``{"finding": ..}`` for a fault and
``{"done": ..}`` with the counts of a target. A crash or a hang is seen from outside, the input being still there.
"""

from __future__ import annotations

import ctypes
import gc
import io
import json
import os
import resource
import sys
import time
import traceback
import warnings
from contextlib import suppress
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import numpy as np

from tests.fuzz.mutate import mutated, words
from tests.fuzz.targets import TARGETS, Target
from vascval.core.errors import InputError

SLOW_S = 3.0
"""CPU time of one case (a file of at most 64 KiB) that counts as a fault."""
LONGEST = 1000
"""Characters of a message."""
_KINDS = (
    "without a remedy", "not one printable line", "too long a message", "does not name the file", "memory", "slow",
    "printed",
)  # fmt: skip
_HEADROOM = 6 << 30
_ROOT = Path(__file__).resolve().parents[2]
_ROOMS = ("vascval/io/", "vascval/core/", "generator/")


class Coverage:
    """Pairs of successive lines, in functions of the project, that a call ran through."""

    def __init__(self) -> None:
        self.seen: set[tuple[int, int, int]] = set()
        self._run: set[tuple[int, int, int]] = set()
        self._wanted: dict[CodeType, bool] = {}

    def __enter__(self) -> Coverage:
        self._run = set()
        sys.settrace(self._enter)
        return self

    def __exit__(self, *_: object) -> None:
        sys.settrace(None)

    def is_new(self) -> bool:
        """Whether the last call ran where none had."""
        new = not self._run <= self.seen
        self.seen |= self._run
        return new

    def _enter(self, frame: FrameType, event: str, arg: Any) -> Any:
        code = frame.f_code
        wanted = self._wanted.get(code)
        if wanted is None:
            wanted = any(f"{_ROOT}/{room}" in code.co_filename for room in _ROOMS)
            self._wanted[code] = wanted
        if not wanted:
            return None
        before, key, run = 0, hash(code), self._run

        def step(frame: FrameType, event: str, arg: Any) -> Any:
            nonlocal before
            if event == "line":
                run.add((key, before, frame.f_lineno))
                before = frame.f_lineno
            return step

        return step


class Memory:
    """How much resident memory a call added at its peak; 0 where the system does not tell (not Linux).

    :param tidy: give back what was freed before, which takes some milliseconds.
    """

    def __init__(self, tidy: bool = False) -> None:
        self._tidy = tidy

    def __enter__(self) -> Memory:
        if self._tidy:  # what was freed before would else be used again and not be counted
            gc.collect()
            with suppress(OSError, AttributeError):
                ctypes.CDLL(None).malloc_trim(0)
        try:
            Path("/proc/self/clear_refs").write_text("5")
            self._before = self._status("VmRSS")
        except OSError:
            self._before = -1
        return self

    def __exit__(self, *_: object) -> None:
        self.peak = self._status("VmHWM") - self._before if self._before >= 0 else 0

    @staticmethod
    def _status(key: str) -> int:
        text = Path("/proc/self/status").read_text()
        return int(text.split(f"{key}:")[1].split()[0]) * 1024


def fault(target: Target, path: Path, *, refused: bool = True) -> str | None:
    """What is wrong with how ``path`` is read; None when it is read, or refused as it should be (if it may be)."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            target.read(path)
        except InputError as error:
            return _badly_said(str(error), path) if refused else f"refused: {error}"
        except Exception as error:  # noqa: BLE001
            return _where(error)
    return None


def _badly_said(message: str, path: Path) -> str | None:
    if not message.startswith(f"{path}: "):
        return f"does not name the file: {message[:200]!r}"
    if ";" not in message:
        return f"without a remedy: {message[:200]!r}"
    if not message.isprintable():
        return f"not one printable line: {message[:200]!r}"
    if len(message) > LONGEST:
        return f"too long a message: {message[:200]!r}"
    return None


def _where(error: BaseException) -> str:
    frames = traceback.extract_tb(error.__traceback__)
    ours = [f for f in frames if str(_ROOT) in f.filename and "/tests/" not in f.filename] or frames
    name = Path(ours[-1].filename)
    return f"{type(error).__name__} in {name.name}:{ours[-1].name}: {str(error)[:200]}"


def key_of(said: str) -> str:
    """Faults alike have the same key."""
    kind, _, rest = said.partition(":")
    return kind if kind in _KINDS else f"{kind}:{rest[:30]}"


class Worker:
    """Runs cases in a folder and reports on a channel."""

    def __init__(self, folder: Path, channel: io.TextIOBase) -> None:
        self._folder, self._channel = folder, channel
        self._spill = os.open(folder / "printed", os.O_RDWR | os.O_CREAT)
        self.slowest = 0.0

    def tell(self, **record: Any) -> None:
        self._channel.write(json.dumps(record) + "\n")
        self._channel.flush()

    def place(self, target: Target) -> Path:
        """Where the input of a target lies, its companions beside it."""
        folder = self._folder / target.name
        folder.mkdir(exist_ok=True)
        for name, content in target.companions.items():
            (folder / name).write_bytes(content)
        return folder / f"input{target.suffix}"

    def run(self, target: Target, path: Path, data: bytes, coverage: Coverage | None) -> str | None:
        """The fault of one case, if it has any."""
        path.write_bytes(data)
        os.ftruncate(self._spill, 0)
        begin = time.process_time()
        with Memory() as memory:
            if coverage is None:
                said = fault(target, path)
            else:
                with coverage:
                    said = fault(target, path)
        seconds = time.process_time() - begin
        self.slowest = max(self.slowest, seconds)
        sys.stdout.flush()
        sys.stderr.flush()
        if said is None and memory.peak > target.fixed + target.factor * len(data):
            said = f"memory: {memory.peak:,} bytes for a file of {len(data):,}"
        if said is None and seconds > SLOW_S:
            said = f"slow: {seconds:.1f} s for a file of {len(data):,} bytes"
        if said is None and os.fstat(self._spill).st_size:
            said = f"printed: {os.pread(self._spill, 200, 0)!r}"
        return said

    def warm(self, target: Target) -> None:
        """Reads the seeds once, so that loading libraries and compiling kernels count for no case."""
        self.tell(target=target.name, case=-2)
        for data in target.seeds():
            path = self.place(target)
            path.write_bytes(target.packed(data) if target.packed else data)
            said = fault(target, path, refused=False)
            if said is not None:
                self.tell(broken=f"a seed of {target.name}: {said}")

    def fuzz(self, target: Target, seed: int, cases: int, seconds: float, kept: list[bytes]) -> None:
        """Mutates seeds and whatever reached new code, for so many cases and so much time at most."""
        rng = np.random.default_rng([seed, *target.name.encode()])
        path, coverage = self.place(target), Coverage()
        pool = [*target.seeds(), *kept]
        known, faults, until, done = words(pool), set(), time.monotonic() + seconds, 0
        self.warm(target)
        for data in pool:
            whole = target.packed(data) if target.packed else data
            self.tell(target=target.name, case=-1)
            self._note(target, self.run(target, path, whole, coverage), whole, faults)
            coverage.is_new()
        n_seeds = len(pool)
        while done < cases and time.monotonic() < until:
            recent = len(pool) > n_seeds and rng.random() < 0.3
            pick = len(pool) - 1 - int(rng.integers(min(8, len(pool)))) if recent else int(rng.integers(len(pool)))
            data = mutated(rng, pool[pick], pool[int(rng.integers(len(pool)))], known)
            whole = target.packed(data) if target.packed and rng.random() < 0.8 else data
            self.tell(target=target.name, case=done)
            self._note(target, self.run(target, path, whole, coverage), whole, faults)
            done += 1
            if coverage.is_new() and len(data) < 1 << 14:
                pool.append(data)
        self.tell(done=target.name, cases=done, edges=len(coverage.seen), pool=len(pool), slowest_s=self.slowest)

    def _note(self, target: Target, said: str | None, data: bytes, faults: set[str]) -> None:
        if said is not None and key_of(said) not in faults:
            faults.add(key_of(said))
            self.tell(finding=said, target=target.name, input=data.hex())


def main(order: dict[str, Any]) -> None:
    """``order``: ``folder``, ``targets``, ``seed``, ``cases``, ``seconds`` (each of one target), ``corpus``; or
    ``replay``: a list of (target, file)."""
    channel = os.fdopen(os.dup(1), "w")
    worker = Worker(Path(order["folder"]), channel)
    for number in (1, 2):
        os.dup2(worker._spill, number)
    size = int(Path("/proc/self/statm").read_text().split()[0]) * 4096 if sys.platform == "linux" else 0
    if size:
        resource.setrlimit(resource.RLIMIT_AS, (size + _HEADROOM, size + _HEADROOM))
    for name in dict(order.get("replay", [])):
        worker.warm(TARGETS[name])
    for name, file in order.get("replay", []):
        worker.tell(target=name, case=file)
        said = worker.run(TARGETS[name], worker.place(TARGETS[name]), Path(file).read_bytes(), None)
        worker.tell(replayed=file, said=said)
    for name in order.get("targets", []):
        kept = [path.read_bytes() for path in sorted(Path(order["corpus"], name).glob("*"))]
        worker.fuzz(TARGETS[name], order["seed"], order["cases"], order["seconds"], kept)


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
