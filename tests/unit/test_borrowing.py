"""Kernels that borrow their arguments: they do what others do, count no references and hand out no arrays."""

import sys
from typing import NamedTuple

import numba
import numpy as np
import pytest
from numba.core.errors import TypingError

from vascval.core.borrowing import _Borrowing, borrowing


class Pair(NamedTuple):
    scale: float
    values: np.ndarray
    nested: tuple[np.ndarray, np.ndarray]


@borrowing
def add(pair, at, value):
    if value > 0.0:
        pair.values[at] += pair.scale * value
        pair.nested[1][at] = value


@borrowing
def add_random(pair, rng, count):
    total = 0.0
    for i in range(count):
        value = rng.random()
        add(pair, i, value)
        total += value
    return total


@borrowing
def push(counts, values):
    if counts[0] != counts[1]:
        k = counts[2]
        values[2] = k
        counts[0] = k + 1


@borrowing
def first_of(pair):
    return pair.scale, pair.values[:1]


def make(size: int) -> Pair:
    return Pair(2.0, np.zeros(size), (np.zeros(1), np.zeros(size)))


def test_arrays_in_tuples_are_written_to() -> None:
    pair, rng = make(50), np.random.default_rng(1)
    total = add_random(pair, rng, 50)
    expected = np.random.default_rng(1)
    drawn = [expected.random() for _ in range(50)]
    assert total == sum(drawn)
    np.testing.assert_array_equal(pair.values, 2.0 * np.array(drawn))
    np.testing.assert_array_equal(pair.nested[1], drawn)
    assert rng.bit_generator.state == expected.bit_generator.state


def test_references_balance() -> None:
    pair, rng = make(3), np.random.default_rng(1)
    objects = (pair.values, *pair.nested, rng)
    add_random(pair, rng, 3)
    before = [sys.getrefcount(one) for one in objects]
    for _ in range(100):
        add_random(pair, rng, 3)
    assert [sys.getrefcount(one) for one in objects] == before


def calls_of_counting(kernel, *arguments):
    """In the kernel itself, compiled anew: what comes out of the cache cannot be looked at."""
    kernel(*arguments)
    compiled = kernel.inspect_llvm(kernel.signatures[0])
    own = compiled[compiled.index("define") :]
    return own[: own.index("\n}")].count("call void @NRT_")


@pytest.mark.skipif(not hasattr(add, "py_func"), reason="the compiler is off")
def test_no_references_are_counted() -> None:
    many, few = np.arange(4), np.zeros(4)
    assert calls_of_counting(numba.njit(push.py_func), many, few) > 0
    assert calls_of_counting(numba.njit(push.py_func, pipeline_class=_Borrowing), many, few) == 0


@pytest.mark.skipif(not hasattr(add, "py_func"), reason="the compiler is off")
def test_a_kernel_that_returns_an_array_is_refused() -> None:
    with pytest.raises(TypingError, match="kernel first_of returns an array"):
        first_of(make(1))
