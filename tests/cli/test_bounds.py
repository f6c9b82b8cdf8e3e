"""A kernel that reads beyond an array is found; ``python -m tests.bounds`` runs all there are."""

import pytest

from tests.bounds import checked, compiled, kernels

KERNEL = """
import sys
import numpy as np
from vascval.core.jit import njit

@njit
def entry(values, index):
    return values[index]

entry(np.zeros(3), int(sys.argv[1]))
"""


@pytest.mark.parametrize(("index", "fails"), [("2", False), ("3", True)])
def test_an_index_beyond_the_end(tmp_path, capfd, index, fails):
    (tmp_path / "room").mkdir()
    (tmp_path / "room" / "_some_kernels.py").write_text(KERNEL)
    code = checked(["room/_some_kernels.py", index], tmp_path, tmp_path / "cache")
    assert (code != 0) == fails
    assert ("IndexError: index is out of bounds" in capfd.readouterr().err) == fails
    assert compiled(tmp_path / "cache") == {"room/_some_kernels.entry"}


def test_all_kernels_are_listed():
    listed = kernels()
    assert {
        "topology/_anneal_kernels.pick_nearby",
        "core/_ordering_kernels.strahler",
        "io/_lz4_kernels.unpack",
    } <= listed
