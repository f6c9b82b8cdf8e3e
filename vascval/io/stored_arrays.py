"""What arrays in zarr and HDF5 files have in common."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vascval.core.errors import InputError


@dataclass(frozen=True, eq=False)
class Stored:
    """An array (nz, ny, nx) of a file: ``chunk`` (dz, dy) is how it is cut, ``read`` as in a scan, ``origin_mm`` and
    ``spacing_mm`` (3,) along x, y, z, the latter ``None`` where the file has none."""

    kind: str
    shape: tuple[int, int, int]
    dtype: np.dtype
    chunk: tuple[int, int]
    read: Callable[[int, int, int, int], np.ndarray]
    spacing_mm: np.ndarray | None
    origin_mm: np.ndarray
    notes: Sequence[str] = ()


def require_numbers(path: Path, dtype: np.dtype) -> None:
    """Refuses what holds no real numbers."""
    if dtype.kind not in "biuf" or dtype.itemsize > 8:
        raise InputError(f"{path}: holds values of type {dtype}; whole or real numbers of up to 64 bits are needed")


def leading_ones(path: Path, shape: Sequence[int]) -> int:
    """How many axes of size 1 (time, channel) precede the three of the volume; refuses other shapes."""
    extra = len(shape) - 3
    if extra < 0 or any(n != 1 for n in shape[:extra]):
        size = " x ".join(map(str, shape))
        raise InputError(f"{path}: holds an array of {size}; three axes z, y, x are needed, take one frame or channel")
    if min(shape[extra:]) < 1:
        raise InputError(f"{path}: holds an array of {' x '.join(map(str, shape))}; there is nothing in it")
    return extra


def chosen(path: Path, names: Sequence[str], dataset: str | None) -> str:
    """The name of the array that is meant among those of a file.

    :raises InputError: when there is none, or several and no choice, or not the one that was chosen.
    """
    listed = ", ".join(names[:10]) + (" ..." if len(names) > 10 else "")
    if dataset is not None:
        if dataset.strip("/") not in names:
            raise InputError(f"{path}: has no array {dataset!r}; choose with --dataset among {listed or 'none'}")
        return dataset.strip("/")
    if not names:
        raise InputError(f"{path}: holds no array with three axes; give the file of the volume")
    if len(names) > 1:
        raise InputError(f"{path}: holds the arrays {listed}; choose one with --dataset")
    return names[0]


def reader(
    path: Path, array: Any, extra: int, failures: tuple[type[BaseException], ...]
) -> Callable[[int, int, int, int], np.ndarray]:
    """Reads an ``array`` of the library as a scan does, without its first ``extra`` axes; its ``failures`` are told."""
    native = np.dtype(array.dtype).newbyteorder("=")

    def read(z0: int, z1: int, y0: int, y1: int) -> np.ndarray:
        try:
            values = array[(0,) * extra + (slice(z0, z1), slice(y0, y1))]
        except failures as error:
            where, what = f"slices {z0} to {z1 - 1}", "folder" if path.is_dir() else "file"
            raise InputError(f"{path}: {where} cannot be read ({said(error)}); the {what} is damaged") from error
        return np.asarray(values).astype(native, copy=False)

    return read


def said(error: BaseException) -> str:
    """An error of the library in a line."""
    return " ".join(str(error).split())[:160] or type(error).__name__
