"""Plain arrays that are kept of a run and taken up again: their types and shapes, their names, random numbers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vascval.core.errors import InputError

_WORD = 2**64


def fits(kept: Mapping[str, np.ndarray], wanted: Mapping[str, tuple[str, tuple[int | None, ...]]]) -> bool:
    """Whether there is an array of the wanted type and shape under each wanted name; ``None`` is any size."""
    return all(
        name in kept
        and kept[name].dtype == kind
        and kept[name].ndim == len(shape)
        and all(size is None or size == have for size, have in zip(shape, kept[name].shape))
        for name, (kind, shape) in wanted.items()
    )


def with_prefix(prefix: str, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays under the names ``prefix.name``."""
    return {f"{prefix}.{name}": array for name, array in arrays.items()}


def below(prefix: str, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays whose names begin with ``prefix.``, without that."""
    return {name[len(prefix) + 1 :]: array for name, array in arrays.items() if name.startswith(prefix + ".")}


def words_of(rng: np.random.Generator) -> np.ndarray:
    """(6,) uint64: state and increment of PCG64, low and high word each; whether half a word is left over; that half.

    :raises InputError: for another bit generator than that of ``numpy.random.default_rng``.
    """
    if not isinstance(rng.bit_generator, np.random.PCG64):
        raise InputError(f"{type(rng.bit_generator).__name__} cannot be kept; use numpy.random.default_rng")
    known = rng.bit_generator.state
    state, increment = known["state"]["state"], known["state"]["inc"]
    words = (state % _WORD, state // _WORD, increment % _WORD, increment // _WORD)
    return np.array([*words, known["has_uint32"], known["uinteger"]], np.uint64)


def set_words(rng: np.random.Generator, words: np.ndarray) -> None:
    """Make ``rng`` go on as the one did that :func:`words_of` was asked about."""
    values = [int(word) for word in words]
    rng.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": values[0] + _WORD * values[1], "inc": values[2] + _WORD * values[3]},
        "has_uint32": values[4],
        "uinteger": values[5],
    }
