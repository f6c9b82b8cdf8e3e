"""Counts, means, standard deviations and standard errors by group, where values that are not numbers are left out;
straight lines through logarithms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Grouped:
    """(n_groups,) arrays. ``mean`` is NaN without values, ``sd`` (over n - 1) and ``se`` below two of them."""

    n: np.ndarray
    mean: np.ndarray
    sd: np.ndarray

    @property
    def se(self) -> np.ndarray:
        return self.sd / np.sqrt(np.maximum(self.n, 1))


def grouped(values: np.ndarray, group: np.ndarray, n_groups: int) -> Grouped:
    """Statistics of ``values`` (K,) by ``group`` (K,), integers from 0 to ``n_groups - 1``."""
    known = ~np.isnan(values)
    values, group = values[known], group[known]
    n = np.bincount(group, minlength=n_groups)
    mean = np.where(n > 0, np.bincount(group, weights=values, minlength=n_groups) / np.maximum(n, 1), np.nan)
    square = np.bincount(group, weights=(values - mean[group]) ** 2, minlength=n_groups)
    sd = np.where(n > 1, np.sqrt(square / np.maximum(n - 1, 1)), np.nan)
    return Grouped(n, mean, sd)


def mean_or_nan(values: np.ndarray) -> float:
    """The mean of the values that are numbers; NaN where there are none."""
    known = values[~np.isnan(values)]
    return float(known.mean()) if known.size else float("nan")


def log_line(x: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """Slope of ``log10(values)`` over ``x`` and R^2; NaN with one value or with one that has no logarithm."""
    if x.size < 2 or not (values > 0).all():
        return float("nan"), float("nan")
    y = np.log10(values)
    dx, dy = x - x.mean(), y - y.mean()
    slope = float(dx @ dy / (dx @ dx))
    total = float(dy @ dy)
    return slope, 1.0 - float(((dy - slope * dx) ** 2).sum()) / total if total > 0 else 1.0
