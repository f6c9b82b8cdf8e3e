"""What tells two states of the program apart that bear the same version."""

import shutil
from pathlib import Path

import pytest

from generator import code_checksum
from generator.code_checksum import code_sha256

FRESH = code_sha256.__wrapped__


@pytest.fixture(name="copy")
def _copy(tmp_path, monkeypatch):
    """A copy of the sources that may be changed."""
    root = Path(code_checksum.__file__).parents[1]
    for package in ("vascval", "generator"):
        shutil.copytree(root / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(code_checksum, "_ROOT", tmp_path)
    return tmp_path


def test_it_is_that_of_the_sources_wherever_they_are(copy):
    assert FRESH() == code_sha256()
    (copy / "generator/__pycache__").mkdir()
    (copy / "generator/__pycache__/config.pyc").write_bytes(b"compiled")
    assert FRESH() == code_sha256()


@pytest.mark.parametrize(
    "path", ["generator/growth/growth.py", "vascval/core/tree.py", "vascval/imaging/graph.py", "vascval/io/swc.py"]
)
def test_a_line_more_is_another_state(copy, path):
    with (copy / path).open("a") as stream:
        stream.write("# changed\n")
    assert FRESH() != code_sha256()


def test_a_module_that_moved_is_another_state(copy):
    (copy / "vascval/core/units.py").rename(copy / "vascval/core/lengths.py")
    assert FRESH() != code_sha256()
    (copy / "vascval/core/lengths.py").rename(copy / "vascval/core/units.py")
    (copy / "vascval/report/page.py").unlink()  # decides nothing that is kept
    assert FRESH() == code_sha256()
