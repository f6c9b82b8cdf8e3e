"""The benchmark of checkpoints runs, at a small size, and they cost little."""

from tests.benchmarks import bench_checkpoint


def test_a_checkpoint_takes_less_than_two_per_cent_of_the_minute_between_two():
    lines = bench_checkpoint.cost((50, 20_000)).splitlines()
    assert len(lines) == 4
    for line in lines[2:]:
        assert float(line.split("|")[5]) < 2.0  # a fifth of a per cent is usual; a loaded disk needs room
