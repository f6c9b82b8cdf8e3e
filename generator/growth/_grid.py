"""The grid of segments, laid anew as the tree grows."""

from __future__ import annotations

import numpy as np

from generator.domain import Domain
from generator.growth._index_kernels import Grid, fill, follow
from generator.growth._records import Store
from generator.kept import fits

_CELL = 0.8
"""Side of a cell in units of the cube root of the domain's volume per terminal, where the grid is laid."""
_ENTRIES_PER_SEGMENT = 4
_DOUBLING = 2
_LISTS = ("head", "link", "owner", "free")
_KEPT: dict[str, tuple[str, tuple[int | None, ...]]] = {
    "size": ("int64", (2,)),
    "cell_mm": ("float64", (1,)),
    "head": ("int32", (None, None, None)),
    "link": ("int32", (None,)),
    "owner": ("int32", (None,)),
    "free": ("int64", (2,)),
}


class SegmentGrid:
    """Keeps the grid of a store fine enough for the number of terminals, and with room for entries."""

    def __init__(self, domain: Domain, store: Store) -> None:
        self._domain, self._store = domain, store
        self._entries = 1024
        self.renew()

    @property
    def good_until(self) -> int:
        """The number of terminals at which the grid should be laid anew."""
        return self._good_until

    @property
    def bounds_mm(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners of the domain's bounding box, a rounding error wider."""
        slack = 1e-9 * (self._domain.upper_mm - self._domain.lower_mm)
        return self._domain.lower_mm - slack, self._domain.upper_mm + slack

    def renew(self) -> None:
        """Lay the grid for the tree as it is now."""
        n_terminals = max(int(self._store.counts[1]), 1)
        self._good_until = _DOUBLING * n_terminals
        self.cell_mm = _CELL * (self._domain.volume_mm3 / n_terminals) ** (1 / 3)
        self._lay()

    def widen(self) -> None:
        """Make room for twice as many entries."""
        self._entries *= 2
        self._lay()

    def state(self) -> dict[str, np.ndarray]:
        """Everything, as plain arrays that are copies: the order in a cell decides between equal distances."""
        return {
            "size": np.array([self._good_until, self._entries]),
            "cell_mm": np.array([self.cell_mm]),
            **{name: getattr(self.grid, name).copy() for name in _LISTS},
        }

    def restore(self, kept: dict[str, np.ndarray]) -> bool:
        """Take over what :meth:`state` gave for the same segments; whether that is sound."""
        if not fits(kept, _KEPT):
            return False
        cell = float(kept["cell_mm"][0])
        if not (np.isfinite(cell) and cell > 0.0) or kept["head"].shape != tuple(self._shape(cell).tolist()):
            return False
        n, entries, met = int(self._store.counts[0]), kept["link"].size, np.zeros(kept["link"].size, bool)
        used = follow(kept["head"].ravel(), kept["link"], met)
        owner = kept["owner"][met]
        if used < 0 or kept["owner"].size != entries or not ((owner > 0) & (owner < n)).all():
            return False
        left = follow(kept["free"][:1], kept["link"], met)
        if left != kept["free"][1] or used + left != entries or kept["size"].tolist()[1:] != [entries]:
            return False
        self.cell_mm, self._good_until, self._entries = cell, int(kept["size"][0]), entries
        lists = {name: kept[name].copy() for name in _LISTS}
        self.grid = Grid(origin=np.ascontiguousarray(self._domain.lower_mm), cell=cell, **lists)
        return True

    def _shape(self, cell_mm: float) -> np.ndarray:
        size = self._domain.upper_mm - self._domain.lower_mm
        return np.maximum(np.ceil(size / cell_mm), 1.0)

    def _lay(self) -> None:
        shape = self._shape(self.cell_mm).astype(np.int64)
        self._entries = max(self._entries, _ENTRIES_PER_SEGMENT * int(self._store.counts[0]), 16 * int(shape.sum() + 3))
        while True:
            link = np.arange(1, self._entries + 1, dtype=np.int32)
            link[-1] = -1
            owner = np.full(self._entries, -1, np.int32)
            head = np.full(tuple(shape), -1, np.int32)
            free = np.array([0, self._entries], np.int64)
            self.grid = Grid(np.ascontiguousarray(self._domain.lower_mm), float(self.cell_mm), head, link, owner, free)
            size = int(self._store.counts[0])
            if fill(self.grid, self._store.segment, 1, size) == size:
                return
            self._entries *= 2
