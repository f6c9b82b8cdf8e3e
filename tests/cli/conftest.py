"""Inputs for the commands to work on."""

from pathlib import Path

import numpy as np
import pytest
from cli_files import draw, small_tree, write_nrrd

from vascval.core.tree import Tree


@pytest.fixture(scope="session")
def tree() -> Tree:
    return small_tree()


@pytest.fixture(scope="session")
def mask(tree) -> np.ndarray:
    return draw(tree, np.array([-18.0, -12.0, -5.0]), (84, 49, 73))


@pytest.fixture
def cast_file(tmp_path, mask) -> Path:
    """The small tree as a mask, ``cast.nrrd``."""
    return write_nrrd(tmp_path / "cast.nrrd", mask, origin=(-18.0, -12.0, -5.0))


@pytest.fixture
def tree_file(tmp_path, tree) -> Path:
    """The small tree as SWC, ``tree.swc``: a sample at each node with the radius of the segment that ends there."""
    rows = [
        f"{i + 1} 0 {x} {y} {z} {tree.radius_mm[i]} {p + 1 if p >= 0 else -1}"
        for i, ((x, y, z), p) in enumerate(zip(tree.position_mm, tree.parent))
    ]
    path = tmp_path / "tree.swc"
    path.write_text("# unit: mm\n" + "\n".join(rows) + "\n")
    return path
