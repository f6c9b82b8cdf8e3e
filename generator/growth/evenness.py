"""How evenly terminals are spread."""

from __future__ import annotations

import numpy as np

from generator.domain import Domain

_PROBES = 20_000
_REPEATS = 4


def evenness(domain: Domain, terminals_mm: np.ndarray) -> float:
    """Mean distance from tissue to the nearest terminal, relative to that of as many uniformly random points.

    1 is random, less is more even. Volumes of trees compare only at equal evenness, as an uneven set is fed by less.
    Tissue is sampled at 20,000 points of a fixed seed, which makes the figure right to about 0.005.
    """
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(0)
    tissue = domain.sample(_PROBES, rng)
    random = [
        cKDTree(domain.sample(len(terminals_mm), rng)).query(tissue)[0].mean() for _ in range(_REPEATS)
    ]
    return float(cKDTree(terminals_mm).query(tissue)[0].mean() / np.mean(random))
