"""The benchmark of the geometry runs, at tiny sizes."""

import pytest

from tests.benchmarks import bench_geometry


@pytest.mark.parametrize(
    ("name", "arguments", "rows"),
    [
        ("after_cco", {"counts": (40,), "seeds": (1, 2)}, 2),
        ("solvers", {"counts": (40,), "seeds": (1,)}, 1),
        ("scaling", {"counts": (40, 80)}, 2),
        ("domains", {"counts": (40,)}, 3),
    ],
)
def test_tables(name, arguments, rows):
    lines = bench_geometry.TABLES[name](**arguments).splitlines()
    assert len(lines) == rows + 2
    assert len({line.count("|") for line in lines}) == 1


def test_time_grows_linearly():
    problems = [bench_geometry.grown(n)[0] for n in (1500, 6000)]
    found = [min((bench_geometry.timed(bench_geometry.solve_reduced, p) for _ in range(2)), key=lambda f: f[1])
             for p in problems]  # fmt: skip
    per_step = [seconds / solution.n_iterations for solution, seconds in found]
    # four times the nodes: 4 if linear; beyond 8 something looks at all pairs, below 2 the clock is at fault
    assert 2.0 < per_step[1] / per_step[0] < 8.0


def test_the_number_of_steps_is_bounded():
    for n in (500, 2000, 6000):
        steps = bench_geometry.solve_reduced(bench_geometry.grown(n)[0]).n_iterations
        # 29, 41 and 63; hundreds where a step does not foresee the bounds or mistakes the curvature along segments
        assert 10 < steps < 120
