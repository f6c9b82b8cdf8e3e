"""The grid of segments, laid anew as the tree grows."""

from __future__ import annotations

import numpy as np

from generator.domain import Domain
from generator.growth._index_kernels import Grid, fill
from generator.growth._records import Store

_CELL = 0.8
"""Side of a cell in units of the cube root of the domain's volume per terminal, where the grid is laid."""
_ENTRIES_PER_SEGMENT = 4
_DOUBLING = 2


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

    def _lay(self) -> None:
        size = self._domain.upper_mm - self._domain.lower_mm
        shape = np.maximum(np.ceil(size / self.cell_mm).astype(np.int64), 1)
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
