"""The benchmark of topology runs, at tiny sizes."""

import pytest

from tests.benchmarks import bench_topology


@pytest.mark.parametrize(
    ("name", "arguments", "rows"),
    [
        ("tests", {"names": ("opencco_500",), "counts": (200,), "orders": (0,), "largest": 20}, (1, 2)),
        ("reduction", {"seeds": 2, "count": 200, "n_terminals": 20}, 3),
        ("optima", {"counts": (3, 4), "instances": 2}, 2),
        ("orders", {"count": 2, "n_tests": 200, "largest": 20}, (1, 3)),
        ("rounds", {"names": ("opencco_500",), "searches": ((1, 500, 2, 1),)}, 1),
    ],
)
def test_tables(name, arguments, rows):
    lines = bench_topology.TABLES[name](**arguments).splitlines()
    assert len(lines) - 2 in (rows if isinstance(rows, tuple) else (rows,))
    assert len({line.count("|") for line in lines}) == 1
