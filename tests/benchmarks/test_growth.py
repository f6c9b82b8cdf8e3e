"""The benchmark of growth runs, at tiny sizes."""

import numpy as np
import pytest

from tests.benchmarks import bench_growth


@pytest.mark.parametrize(
    ("name", "arguments", "rows"),
    [
        ("scaling", {"counts": (20, 40)}, 2),
        ("volumes", {"counts": (20,), "seeds": (1, 2)}, 1),
        ("rivals", {"names": ("svv_500",), "largest": 20}, 1),
        ("connections", {"n": 20, "counts": (2, 4), "seeds": 1}, 2),
        ("liver", {"counts": (20,)}, 1),
        ("apart", {"counts": (20,)}, 2),
    ],
)
def test_tables(name, arguments, rows):
    lines = bench_growth.TABLES[name](**arguments).splitlines()
    assert len(lines) == rows + 2
    assert len({line.count("|") for line in lines}) == 1


def test_time_grows_nearly_linearly():
    bench_growth.grow(30)
    seconds = [min(bench_growth.grow(n)[1] for _ in range(2)) for n in (3000, 12_000)]
    # an exponent of 1.2 is promised; 1.5 leaves room for a loaded machine, a search of all segments would give 2
    assert np.log(seconds[1] / seconds[0]) / np.log(4) < 1.5
