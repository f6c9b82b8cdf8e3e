"""The benchmark of ensembles runs, at a tiny size."""

from tests.benchmarks import bench_ensemble


def test_table():
    lines = bench_ensemble.workers(counts=(1, 2), n_trees=2, n_terminals=30).splitlines()
    assert [line.split("|")[1].strip() for line in lines[2:]] == ["1", "2"]
    assert float(lines[2].split("|")[3]) == 1.0
