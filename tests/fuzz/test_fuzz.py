"""A bounded run of the fuzzer, the same cases each time; and the fuzzer itself, held against readers with faults."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from tests.fuzz.mutate import LONGEST, mutated, words
from tests.fuzz.targets import TARGETS, Target
from tests.fuzz.watch import Finding, corpus, fuzz, replay
from tests.fuzz.worker import Coverage, Memory, fault
from vascval.core.errors import InputError

CASES = 60
"""Of each reader; more by ``python -m tests.fuzz``."""


def test_no_reader_has_a_fault_within_a_few_cases() -> None:
    records = list(fuzz(list(TARGETS), seed=2022, cases=CASES, seconds=60.0))
    findings = [item for item in records if isinstance(item, Finding)]
    assert not findings, [(item.target, item.said, item.data[:2000]) for item in findings]
    done = {item["done"]: item for item in records if isinstance(item, dict)}
    assert set(done) == set(TARGETS)
    for name, item in done.items():
        assert item["cases"] == CASES, f"{name} did not end in time"
        assert item["pool"] > len(TARGETS[name].seeds()), f"{name}: no case reached new code, so nothing was guided"


def test_findings_that_were_mended_stay_so() -> None:
    cases = corpus()
    if not cases:
        pytest.skip("the corpus of findings is empty: all of them are written as tests in code")
    assert not replay(cases)


def reader(read: object, tmp_path: Path) -> tuple[Target, Path]:
    path = tmp_path / "input.txt"
    path.write_bytes(b"seed 12")
    return Target("own", ".txt", read, lambda: (b"seed 12",)), path  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("message", "said"),
    [
        ("{path}: is wrong; mend it", None),
        ("is wrong; mend it", "does not name the file"),
        ("{path}: is wrong", "without a remedy"),
    ],
)
def test_refusals_are_judged(tmp_path: Path, message: str, said: str | None) -> None:
    def read(path: Path) -> None:
        raise InputError(message.format(path=path))

    found = fault(*reader(read, tmp_path))
    assert found is None if said is None else str(found).startswith(said)


def test_other_errors_and_warnings_are_faults(tmp_path: Path) -> None:
    def overflow(path: Path) -> None:
        np.exp(np.array([1000.0]))

    def lookup(path: Path) -> None:
        raise KeyError("radius")

    assert str(fault(*reader(overflow, tmp_path))).startswith("RuntimeWarning")
    assert str(fault(*reader(lookup, tmp_path))).startswith("KeyError")


def test_memory_of_a_case_is_seen() -> None:
    with Memory(tidy=True) as memory:
        block = np.ones(8_000_000)
        del block
    if memory.peak == 0:
        pytest.skip("this system does not tell the peak of resident memory")
    assert 60_000_000 < memory.peak < 100_000_000  # 64 MB, and what else the interpreter took or gave back


def test_new_code_is_seen() -> None:
    from vascval.io.length_units import unit_named

    coverage = Coverage()
    for text, new in (("mm", True), ("mm", False), ("furlong", True), ("furlong", False)):
        with coverage:
            unit_named(text)
        if text == "mm" or not new:
            assert coverage.is_new() is new
        else:
            coverage.is_new()


@pytest.mark.parametrize("name", TARGETS)
def test_mutations_are_many_small_and_reproducible(name: str) -> None:
    seeds = TARGETS[name].seeds()
    rows = []
    for _ in range(2):
        rng = np.random.default_rng(5)
        rows.append([mutated(rng, seeds[0], seeds[-1], words(seeds)) for _ in range(200)])
    assert rows[0] == rows[1]
    assert len(set(rows[0])) > 150
    assert max(map(len, rows[0])) <= LONGEST


def test_a_crash_and_a_hang_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    from tests.fuzz import watch

    monkeypatch.setattr(watch, "TIMEOUT_S", 1.0)
    monkeypatch.setattr(watch, "_COMMAND", ["-c", _STUB])
    begin = time.monotonic()
    found = [item for item in watch.fuzz(["crash", "hang"], seed=0, cases=9, seconds=9.0) if isinstance(item, Finding)]
    assert [item.said.split(":")[0] for item in found] == ["crash", "hang"]
    assert [item.target for item in found] == ["crash", "hang"]
    assert time.monotonic() - begin < 30


_STUB = """
import json, os, sys, time
order = json.loads(sys.argv[1])
for name in order["targets"]:
    print(json.dumps({"target": name, "case": 0}), flush=True)
    if order["seed"] == 0 and name == "crash":
        os.abort()
    if order["seed"] == 1 and name == "hang":
        time.sleep(60)
    print(json.dumps({"done": name, "cases": 1}), flush=True)
"""
