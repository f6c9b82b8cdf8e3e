"""A pytest plugin: a test that takes longer than ``BRANCHES_SECONDS`` of CPU is skipped there.

Without the compiler a kernel is a hundred times as slow; what a test reached before its time was up counts all the
same.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest

LIMIT_S = float(os.environ.get("BRANCHES_SECONDS", "60"))


def _stop(*_: object) -> None:
    signal.setitimer(signal.ITIMER_VIRTUAL, 1.0)  # once more, should something have swallowed it
    pytest.skip(f"takes more than {LIMIT_S:g} s without the compiler")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol() -> Iterator[None]:
    """Fixtures count too: those of a module are made within its first test."""
    before = signal.signal(signal.SIGVTALRM, _stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, LIMIT_S)
    try:
        return (yield)
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)
