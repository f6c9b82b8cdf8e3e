"""Which voxels are vessel: a label of a label map, or a threshold of a grey volume."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from vascval.core.errors import InputError
from vascval.imaging import _value_kernels as kernels
from vascval.imaging.runs import Runs, Watch, from_blocks
from vascval.io.scans import Scan
from vascval.io.volumes import Volume

MAX_LABELS = 128
"""A whole-numbered volume with at most this many different values is taken for a label map, one with more for grey."""

_BINS = 1024


@dataclass(frozen=True, eq=False)
class Selection:
    """The ``runs`` of vessel voxels; ``rule`` says in words what was selected."""

    runs: Runs
    rule: str


def select(
    volume: Volume | Scan,
    *,
    label: int | None = None,
    threshold: float | str | None = None,
    watch: Watch | None = None,
) -> Selection:
    """The vessel voxels of a volume, which is read block by block: once where the rule is given, else twice; a third
    time for Otsu's threshold.

    With a ``label``, the voxels of exactly that value; with a ``threshold``, those at or above it (``"auto"``: Otsu's).
    With neither: of a volume with two values the larger, which is a mask; of grey values those above Otsu's
    threshold. A label map of several labels needs a choice.

    :param watch: see :func:`vascval.imaging.runs.from_blocks`.
    :raises InputError: for an absent label, a threshold that selects nothing or everything, a volume of one value,
        and a label map without a choice; the message lists what is there.
    """
    if label is not None and threshold is not None:
        raise InputError("both a label and a threshold are given; choose one")
    if label is not None:
        runs = _runs(volume, lambda values: values == label, watch)
        if runs.start.size == 0:
            there = _survey(volume)
            values = f"values from {there.low} to {there.high}" if there.present is None else _listed(there.present)
            raise InputError(f"label {label} is not there; the volume holds {values}")
        return Selection(runs, f"voxels of label {label}")
    if threshold is not None and not isinstance(threshold, str):
        return _above(volume, float(threshold), "", watch)
    there = _survey(volume)
    grey = there.present is None or not np.equal(there.present, np.rint(there.present)).all()
    if threshold is not None or grey:
        return _above(volume, _otsu(volume, there), " (Otsu)", watch)
    present = there.present
    assert present is not None
    if present.size == 1:
        raise InputError(f"every voxel has the value {present[0]:g}: nothing tells a vessel; check the file")
    if present.size == 2:
        high = present[1]
        runs = _runs(volume, lambda values: values == high, watch)
        return Selection(runs, f"voxels of value {high:g} (the rest is {present[0]:g})")
    raise InputError(f"the volume holds {_listed(present)}; choose one with --label, or grey values with --threshold")


def _runs(volume: Volume | Scan, is_vessel: Callable[[np.ndarray], np.ndarray], watch: Watch | None) -> Runs:
    def masks() -> Iterator[tuple[int, int, np.ndarray]]:
        for z, y, values in volume.blocks():
            yield z, y, is_vessel(values)

    return from_blocks(volume.shape, masks(), watch)


def _above(volume: Volume | Scan, level: float, how: str, watch: Watch | None) -> Selection:
    runs = _runs(volume, lambda values: values >= level, watch)
    n_selected = runs.n_voxels
    if n_selected in (0, math.prod(volume.shape)):
        there = _survey(volume)
        amount = "everything" if n_selected else "nothing"
        raise InputError(
            f"threshold {level:g} selects {amount}; values run from {float(there.low):g} to {float(there.high):g}"
        )
    return Selection(runs, f"voxels at or above {level:g}{how}")


@dataclass(frozen=True, eq=False)
class _Survey:
    """The least and the largest value, and the different ones, ascending; ``None`` if more than ``MAX_LABELS``."""

    low: np.generic
    high: np.generic
    present: np.ndarray | None


def _survey(volume: Volume | Scan) -> _Survey:
    dtype = np.dtype(np.uint8) if volume.dtype == bool else volume.dtype
    found, n = np.empty(MAX_LABELS, dtype=dtype), 0
    low = high = None
    for _, _, values in volume.blocks():
        if n >= 0:
            n = kernels.distinct(values.view(dtype), found, n)
        if n < 0:
            least, most = values.min(), values.max()
            low, high = least if low is None else min(low, least), most if high is None else max(high, most)
    if n >= 0:
        return _Survey(found[0], found[n - 1], found[:n])
    # what came before the values were too many
    assert low is not None
    return _Survey(min(low, found.min()), max(high, found.max()), None)


def _otsu(volume: Volume | Scan, there: _Survey) -> float:
    """Otsu's threshold from a histogram gathered block by block."""
    from skimage.filters import threshold_otsu

    low, high = float(there.low), float(there.high)
    if low == high:
        raise InputError(f"every voxel has the value {low:g}: nothing tells a vessel; check the file")
    edges = np.linspace(low, high, _BINS + 1)
    counts = np.zeros(_BINS, dtype=np.int64)
    for _, _, values in volume.blocks():
        counts += np.histogram(values, bins=_BINS, range=(low, high))[0]
    return float(threshold_otsu(hist=(counts, (edges[:-1] + edges[1:]) / 2)))


def _listed(present: np.ndarray) -> str:
    shown = ", ".join(f"{value:g}" for value in present[:20])
    return f"the values {shown}" + (f" and {present.size - 20} more" if present.size > 20 else "")
