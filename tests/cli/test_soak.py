"""A long run keeps its memory; ``python -m tests.soak`` takes an hour, this some seconds."""

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
    hoarding = "import time\nkept = []\nwhile True:\n    kept.append(bytearray(5_000_000))\n"
    hoarding += "    begun = time.process_time()\n    while time.process_time() < begun + 0.1: pass"
    samples, code = watched([sys.executable, "-c", hoarding], 1.5, 0.1)
    assert code == -15
    assert samples[-1].cpu_s - samples[0].cpu_s >= 1.5
    assert rise_mb(samples) > MAY_RISE_MB


def test_a_run_that_stands_still_is_ended():
    samples, code = watched([sys.executable, "-c", "import time; time.sleep(600)"], 0.1, 0.1)
    assert code == -15
    assert samples[-1].seconds > 2.0


def test_rise_is_that_of_the_last_over_the_second_quarter():
    samples = [Sample(0.0, memory, cpu_s) for cpu_s, memory in enumerate([1.0, 50.0, 7.0, 7.0, 9.0, 9.0, 12.0, 12.0])]
    assert rise_mb(samples) == 5.0
