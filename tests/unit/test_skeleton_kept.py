"""A skeleton that goes through a checkpoint comes back as it was."""

import dataclasses

import numpy as np
import pytest

from generator import checkpoint
from generator.checkpoint import State
from tests.benchmarks.shapes import ring
from vascval.core.errors import InputError
from vascval.imaging import skeletonize
from vascval.imaging.kept import kept, taken_up

ORIGIN = {"version": "1", "config": {}, "inputs": []}


def same(one, other) -> None:
    """All that is in one is in the other, arrays with their types."""
    if dataclasses.is_dataclass(one):
        for field in dataclasses.fields(one):
            same(getattr(one, field.name), getattr(other, field.name))
    elif isinstance(one, np.ndarray):
        np.testing.assert_array_equal(one, other)
        assert one.dtype == other.dtype
    elif hasattr(one, "keys"):
        assert list(one) == list(other)
        for name in one:
            same(one[name], other[name])
    else:
        assert one == other


@pytest.fixture(scope="module")
def skeleton():
    return skeletonize(ring().volume)


def test_there_and_back(tmp_path, skeleton):
    checkpoint.write(tmp_path / "kept", State(*kept(skeleton)), ORIGIN)
    state = checkpoint.read(tmp_path / "kept", ORIGIN)
    again = taken_up(state.record, state.arrays)
    same(skeleton, again)
    same(skeleton.mask(), again.mask())
    assert len(again.loops_mm) == 1


@pytest.mark.parametrize("name", ["parent", "polyline_offset", "row_offset", "origin_mm"])
def test_what_lacks_a_part_is_refused(skeleton, name):
    record, arrays = kept(skeleton)
    del arrays[name]
    with pytest.raises((KeyError, InputError)):
        taken_up(record, arrays)
