"""Kernels that borrow their arguments: they do what others do, count no references and hand out no arrays."""

import sys
from typing import NamedTuple

import numba
import numpy as np
import pytest
from numba import float64
from numba.core.errors import TypingError
from numba.core.runtime import _nrt_python, rtsys
from numba.typed import List

from vascval.core.borrowing import _Borrowing, borrowing

COMPILED = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="the compiler is off")


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
def raise_larger(pair, count):
    for i in range(count):
        larger = pair.values
        if pair.nested[1][i] > pair.values[i]:
            larger = pair.nested[1]
        larger[i] += 1.0


@borrowing
def larger_twice(first, second, count, times=2):
    """Begins with a loop; its arguments change places; it has a default value."""
    for _ in range(times):
        left = count
        while left > 0:
            left -= 1
            if second[left] > first[left]:
                first, second = second, first
            first[left] += 1.0
    return times, first.sum()


@borrowing
def with_own(values, count):
    """An array of its own takes the place of the one that was lent."""
    for _ in range(count):
        values = values + 1.0
    return values.sum()


@borrowing
def first_of(pair):
    return pair.scale, pair.values[:1]


@borrowing
def first_or_nothing(values, at):
    if at > 0:
        return values
    return None


@borrowing
def one_by_one(values):
    for k in range(values.size):
        yield values[k:]


@borrowing
def keep(values, kept):
    kept[1].append(values)


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


def test_arguments_that_are_replaced() -> None:
    first, second = np.array([1.0, 5.0]), np.array([2.0, 3.0])
    assert larger_twice(first, second, 2) == (2, 7.0)
    np.testing.assert_array_equal((first, second), [[1.0, 7.0], [4.0, 3.0]])
    assert with_own(first, 3) == 14.0
    assert with_own(first, 0) == 8.0
    np.testing.assert_array_equal(first, [1.0, 7.0])


@pytest.fixture
def counted():
    """How many arrays compiled code allocated and freed so far."""
    _nrt_python.memsys_enable_stats()
    yield lambda: (rtsys.get_allocation_stats().mi_alloc, rtsys.get_allocation_stats().mi_free)
    _nrt_python.memsys_disable_stats()


@COMPILED
def test_arrays_of_a_caller_that_is_compiled_are_let_go(counted) -> None:
    """As many as it allocates are freed, neither too few nor one twice."""

    @numba.njit
    def call(count):
        total = 0.0
        for i in range(count):
            values = np.full(100, float(i))
            total += with_own(values, i % 3) + larger_twice(values, values + 1.0, 100)[1]
        return total

    expected = call.py_func(50)
    call(1)
    before = counted()
    assert call(50) == expected
    allocated, freed = (now - then for now, then in zip(counted(), before))
    assert allocated == freed >= 100


@COMPILED
def test_no_references_are_counted() -> None:
    assert calls_of_counting(numba.njit(raise_larger.py_func), make(3), 3) > 0
    assert calls_of_counting(numba.njit(raise_larger.py_func, pipeline_class=_Borrowing), make(3), 3) == 0


@COMPILED
@pytest.mark.parametrize(
    ("kernel", "arguments", "said"),
    [
        (first_of, (make(1),), r"first_of returns array\("),
        (first_or_nothing, (np.zeros(1), 1), r"first_or_nothing returns \S*Option"),
        (one_by_one, (np.zeros(1),), "one_by_one returns .*generator"),
        (keep, (np.zeros(1), (1.0, List.empty_list(float64[::1]))), "keep takes ListType"),
    ],
)
def test_kernels_that_hand_out_arrays_are_refused(kernel, arguments, said) -> None:
    with pytest.raises(TypingError, match=f"kernel {said}.*: use @njit"):
        kernel(*arguments)
