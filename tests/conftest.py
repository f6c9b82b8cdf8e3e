"""What all tests share: where the real data lie."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

_ROOT = Path(__file__).resolve().parents[1]

if os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
    import numpy as np

    from generator.growth import _records
    from generator.topology import _state_kernels

    # fields of a record are its attributes in compiled code; in plain Python those of numpy.record alone are
    for _module, _name in ((_records, "SEGMENT"), (_records, "VISIT"), (_state_kernels, "NODE")):
        setattr(_module, _name, np.dtype((np.record, getattr(_module, _name))))


def shared_data(*parts: str) -> Path:
    """A file of the shared data (``$VASCVAL_DATA``, else ``../shared/data`` beside the repository); skips without."""
    folder = Path(os.environ.get("VASCVAL_DATA", _ROOT.parent / "shared" / "data"))
    path = folder.joinpath(*parts)
    if not path.exists():
        pytest.skip(f"{'/'.join(parts)} is not there; set VASCVAL_DATA to the folder of the shared data")
    return path


@pytest.fixture(name="shared_data")
def _shared_data() -> object:
    return shared_data
