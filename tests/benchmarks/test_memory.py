"""The benchmark of large volumes, at tiny sizes."""

import numpy as np
import pytest

from tests.benchmarks import bench_memory
from vascval.io.scans import open_scan


def test_blocks_and_scaling(tmp_path):
    limit = 2_000_000_000
    lines = bench_memory.blocks(96, 5, limit, tmp_path).splitlines()
    assert len(lines) == 5
    assert [line.split("|")[-2].strip() for line in lines[3:]] == ["equal", "equal"]
    lines = bench_memory.scaling([((60, 90, 80), 8)], limit, tmp_path, ".mhd").splitlines()
    assert len(lines) == 3
    assert "100.00% of 8 / 0.00%" in lines[2]


@pytest.mark.parametrize("name", ["a.mhd", "a.zarr"])
def test_casts_are_drawn_slab_by_slab_as_they_are_in_one_piece_and_leave_nothing(name, tmp_path):
    shape = (60, 40, 50)
    tree = bench_memory.forest_tree(6, shape)
    bench_memory.draw(tree, shape, tmp_path / name)
    whole = bench_memory.rasterize(tree, voxel_mm=1.0, shape=shape, origin_mm=(0.0, 0.0, 0.0)).values
    assert np.array_equal(open_scan(tmp_path / name).load().values, whole)
    assert tree.topology.n_terminals == 6
    assert whole.any()
    bench_memory._remove(tmp_path / name)
    assert not list(tmp_path.iterdir())
