"""What all tests share: where the real data lie."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

_ROOT = Path(__file__).resolve().parents[1]


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
