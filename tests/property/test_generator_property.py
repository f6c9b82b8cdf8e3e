"""What holds for every grown tree, whatever the configuration."""

import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from generator.domain import Box
from generator.growth.growth import Growth, GrowthOptions
from generator.haemodynamics import Perfusion
from vascval.core.validation import findings

side = st.floats(1.0, 200.0)


@settings(max_examples=25, deadline=None)
@given(
    n=st.integers(1, 120),
    gamma=st.floats(2.0, 3.0),
    size=st.tuples(side, side, side),
    n_connections=st.integers(1, 64),
    spacing=st.floats(0.0, 1.0),
    merge_mm=st.none() | st.floats(0.0, 2.0),
    diameters=st.floats(0.0, 1.0),
    seed=st.integers(0, 2**32),
)
def test_a_grown_tree_is_valid(n, gamma, size, n_connections, spacing, merge_mm, diameters, seed):
    box = Box(size)
    options = GrowthOptions(n_connections=n_connections, spacing=spacing, merge_mm=merge_mm, diameters=diameters)
    # a flow that gives thin vessels in a box of any size: radii grow with the fourth root of flow times length
    law = Perfusion(2000.0, 1000.0, 1e-3 * min(size) ** 3, 3.6e-3, gamma)
    growth = Growth(box, law, box.lower_mm, n, options=options, rng=np.random.default_rng(seed))
    for _ in growth.steps():
        pass
    tree = growth.tree()
    assert tree.topology.n_terminals == n
    assert not findings(tree)
    assert box.contains(tree.position_mm).all()
    assert tree.columns["pressure_pa"][tree.topology.terminals] == pytest.approx(1000.0, rel=1e-9)
    assert tree.columns["flow_mm3_s"][tree.topology.children(0)].sum() == pytest.approx(law.flow_mm3_s, rel=1e-9)


def test_same_bytes_at_any_number_of_threads(tmp_path):
    for threads in ("1", "2"):
        environment = {**os.environ} | dict.fromkeys(
            ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), threads
        )
        words = ["generate", "portal-vein", "-o", str(tmp_path / f"{threads}.vtp"), "--set", "n_terminals=300", "-q"]
        subprocess.run([sys.executable, "-m", "vascval.cli", *words], env=environment, check=True)
    assert (tmp_path / "1.vtp").read_bytes() == (tmp_path / "2.vtp").read_bytes()
