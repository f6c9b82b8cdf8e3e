"""The benchmark of ensembles runs, at a tiny size."""

from tests.benchmarks import bench_ensemble


def test_table():
    lines = bench_ensemble.workers(counts=(2,), n_trees=2, n_terminals=30).splitlines()
    assert len(lines) == 3
    cells = [float(cell) for cell in lines[2].strip("| ").split("|")]
    assert cells[0] == 2
    assert (cells[2], cells[4]) == (1.0, 1.0)  # the first is as fast as itself
    assert 0.0 < cells[5] <= 2.0  # trees at work at once on two workers
