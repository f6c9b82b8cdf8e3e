"""A long run keeps its memory; ``python -m tests.soak`` waits an hour, this some seconds."""

import sys
from pathlib import Path

import pytest

from tests.soak import MAY_RISE_MB, Sample, rise_mb, soak, watched

pytestmark = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is read from /proc")


def test_memory_of_a_search(tmp_path):
    samples = soak(8.0, 0.5, ["n_terminals=60"], tmp_path)
    assert rise_mb(samples) <= MAY_RISE_MB
    assert 20.0 < samples[-1].memory_mb < 4000.0  # a Python with its libraries; compiling takes up to 700


def test_memory_that_rises_is_seen():
    hoarding = "import time\nkept = []\nwhile True: kept.append(bytearray(5_000_000)); time.sleep(0.2)"
    samples, code = watched([sys.executable, "-c", hoarding], 3.0, 0.1)
    assert code == -15
    assert rise_mb(samples) > MAY_RISE_MB


def test_rise_is_that_of_the_last_over_the_second_quarter():
    samples = [
        Sample(seconds, memory, 0.0) for seconds, memory in enumerate([1.0, 50.0, 7.0, 7.0, 9.0, 9.0, 12.0, 12.0])
    ]
    assert rise_mb(samples) == 5.0
