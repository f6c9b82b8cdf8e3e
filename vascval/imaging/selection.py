"""Which voxels are vessel: a label of a label map, or a threshold of a grey volume."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vascval.core.errors import InputError
from vascval.io.volumes import Volume

MAX_LABELS = 128
"""A whole-numbered volume with at most this many different values is taken for a label map, one with more for grey."""

_BINS = 1024


@dataclass(frozen=True, eq=False)
class Selection:
    """``slab(z)`` gives the boolean (ny, nx) mask of a slice; ``rule`` says in words what was selected."""

    slab: Callable[[int], np.ndarray]
    rule: str


def select(volume: Volume, *, label: int | None = None, threshold: float | str | None = None) -> Selection:
    """The rule for vessel voxels.

    With a ``label``, the voxels of exactly that value; with a ``threshold``, those at or above it (``"auto"``: Otsu's).
    With neither: of a volume with two values the larger, which is a mask; of grey values those above Otsu's
    threshold. A label map of several labels needs a choice.

    :raises InputError: for an absent label, a threshold that selects nothing or everything, a volume of one value,
        and a label map without a choice; the message lists what is there.
    """
    if label is not None and threshold is not None:
        raise InputError("both a label and a threshold are given; choose one")
    values = volume.values
    if label is not None:
        present = _distinct(values, MAX_LABELS)
        if present is not None and not np.any(present == label):
            raise InputError(f"label {label} is not there; the volume holds {_listed(present)}")
        if present is None and not any(np.any(slab == label) for slab in values):
            low, high = values.min(), values.max()
            raise InputError(f"label {label} is not there; the volume holds values from {low} to {high}")
        return Selection(lambda z: values[z] == label, f"voxels of label {label}")
    if threshold is not None:
        if isinstance(threshold, str):
            return _above(values, _otsu(values), " (Otsu)")
        return _above(values, float(threshold), "")
    present = _distinct(values, MAX_LABELS)
    if present is None or not np.equal(present, np.rint(present)).all():
        return _above(values, _otsu(values), " (Otsu)")
    if present.size == 1:
        raise InputError(f"every voxel has the value {present[0]:g}: nothing tells a vessel; check the file")
    if present.size == 2:
        high = present[1]
        return Selection(lambda z: values[z] == high, f"voxels of value {high:g} (the rest is {present[0]:g})")
    raise InputError(f"the volume holds {_listed(present)}; choose one with --label, or grey values with --threshold")


def _above(values: np.ndarray, level: float, how: str) -> Selection:
    low, high = float(values.min()), float(values.max())
    if not low < level <= high:
        amount = "everything" if level <= low else "nothing"
        raise InputError(f"threshold {level:g} selects {amount}; values run from {low:g} to {high:g}")
    return Selection(lambda z: values[z] >= level, f"voxels at or above {level:g}{how}")


def _distinct(values: np.ndarray, limit: int) -> np.ndarray | None:
    """The different values, ascending; ``None`` if there are more than ``limit``. Looks slice by slice."""
    if values.dtype.kind in "iub" and values.dtype.itemsize == 1:
        seen = np.zeros(256, dtype=np.int64)
        for slab in values:
            seen += np.bincount(slab.ravel().view(np.uint8), minlength=256)
        found = np.flatnonzero(seen).astype(np.uint8).view(values.dtype if values.dtype != bool else np.uint8)
        return np.sort(found) if found.size <= limit else None
    found = np.empty(0, dtype=values.dtype)
    for slab in values:
        found = np.union1d(found, slab)
        if found.size > limit:
            return None
    return found


def _otsu(values: np.ndarray) -> float:
    """Otsu's threshold from a histogram gathered slice by slice."""
    from skimage.filters import threshold_otsu

    low, high = float(values.min()), float(values.max())
    if low == high:
        raise InputError(f"every voxel has the value {low:g}: nothing tells a vessel; check the file")
    edges = np.linspace(low, high, _BINS + 1)
    counts = np.zeros(_BINS, dtype=np.int64)
    for slab in values:
        counts += np.histogram(slab, bins=edges)[0]
    return float(threshold_otsu(hist=(counts, (edges[:-1] + edges[1:]) / 2)))


def _listed(present: np.ndarray) -> str:
    shown = ", ".join(f"{value:g}" for value in present[:20])
    return f"the values {shown}" + (f" and {present.size - 20} more" if present.size > 20 else "")
