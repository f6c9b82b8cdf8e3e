"""How much memory a skeletonisation takes, known before it is taken.

Memory goes with the vessel voxels and not with the volume. The figures below are upper bounds of what the stages hold
at once; ``python -m tests.benchmarks.bench_memory`` shows what was taken where they are the limit.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from pathlib import Path

from vascval.core.errors import InputError
from vascval.io.scans import Scan
from vascval.io.volumes import Volume, available_memory_bytes

PER_VOXEL = 44
PER_RUN = 64
PER_ROW = 32
PER_FRAGMENT_VOXEL = 200
FIXED = 300 << 20
"""Compiled kernels, libraries that are loaded on the way, and arrays of the size of the tree."""

_GIB = 1024.0**3


def resident_bytes() -> int:
    """What this process holds in memory now; where only the peak is known, the peak, and 0 where neither is."""
    try:
        match = re.search(r"VmRSS:\s+(\d+) kB", Path("/proc/self/status").read_text())
    except OSError:
        match = None
    if match:
        return int(match[1]) * 1024
    try:
        import resource
    except ImportError:  # Windows
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * 1024)


@dataclass(frozen=True)
class Budget:
    """``allowed_bytes`` for the whole process, of which ``held_bytes`` are needed whatever the vessels are like."""

    allowed_bytes: int
    held_bytes: int

    def require_read(self, n_slices: int, n_runs: int, n_voxels: int) -> None:
        """Stops the reading as soon as the voxels found so far are too many. A watch for ``from_blocks``."""
        self._require(f"{n_voxels:,} vessel voxels in the first {n_slices} slices", n_runs, n_voxels, 0)

    def require_all(self, n_runs: int, n_voxels: int, largest_fragment: int) -> None:
        """:raises InputError: when so many vessel voxels in so many runs need more than is allowed."""
        self._require(f"{n_voxels:,} vessel voxels", n_runs, n_voxels, largest_fragment)

    def _require(self, what: str, n_runs: int, n_voxels: int, largest_fragment: int) -> None:
        at_once = max(PER_VOXEL * n_voxels, PER_FRAGMENT_VOXEL * largest_fragment)
        _refuse(what, self.held_bytes + PER_RUN * n_runs + at_once, self.allowed_bytes)


def budget(volume: Volume | Scan, max_memory_bytes: int | None) -> Budget:
    """The budget for a volume; without a limit, the memory that this machine has.

    :raises InputError: when it is less than reading alone needs.
    """
    held = resident_bytes()
    allowed = held + available_memory_bytes() if max_memory_bytes is None else int(max_memory_bytes)
    nz, ny, nx = volume.shape
    needed = held + FIXED + PER_ROW * nz * ny + volume.block_voxels * (2 * volume.dtype.itemsize + 6)
    _refuse(f"{nx} x {ny} x {nz} voxels, read block by block,", needed, allowed)
    return Budget(allowed, needed)


def _refuse(what: str, needed: int, allowed: int) -> None:
    if needed > allowed:
        raise InputError(
            f"{what} need {needed / _GIB:.3g} GiB, {allowed / _GIB:.3g} GiB are allowed; "
            "crop or downsample the volume, select less, or allow more (--max-memory)"
        )
