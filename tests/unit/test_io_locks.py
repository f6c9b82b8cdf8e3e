"""Claims of outputs: one run at a time, what killed runs left is removed; where there are no locks, no claims."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from vascval.core.errors import InputError
from vascval.io import locks

fcntl = pytest.importorskip("fcntl", reason="there are no such locks here")


def test_a_claim_holds_until_its_end(tmp_path: Path) -> None:
    path = tmp_path / "out.vtp"
    with locks.claimed(path):
        assert (tmp_path / ".out.vtp.lock").exists()
        with pytest.raises(InputError, match=r"out\.vtp: is being written by another run; wait"), locks.claimed(path):
            pass
        with locks.claimed(tmp_path / "other.vtp"):
            pass
    assert list(tmp_path.iterdir()) == []
    with locks.claimed(path):
        pass


def test_a_claim_ends_with_an_error_too(tmp_path: Path) -> None:
    with pytest.raises(KeyError), locks.claimed(tmp_path / "out"):
        raise KeyError("x")
    with locks.claimed(tmp_path / "out"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_what_killed_runs_left_is_removed_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / ".0123abcd-out").mkdir()
    (tmp_path / ".0123abcd-out" / "part").write_text("x")
    (tmp_path / ".89abcdef-out").write_text("x")
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "file").write_text("x")
    (tmp_path / ".00000000-out").symlink_to(tmp_path / "kept")  # the link goes, what it leads to stays
    others = (".0123abcd-out2", ".0123abc-out", ".0123ABCD-out", "0123abcd-out", "out")
    for name in others:
        (tmp_path / name).write_text("x")
    with locks.claimed(tmp_path / "out"):
        pass
    assert sorted(item.name for item in tmp_path.iterdir()) == sorted([*others, "kept"])
    assert (tmp_path / "kept" / "file").exists()


def test_a_folder_that_does_not_exist(tmp_path: Path) -> None:
    with (
        pytest.raises(InputError, match=r"cannot be written .*; choose another place"),
        locks.claimed(tmp_path / "a/b"),
    ):
        pass


def test_a_lock_that_its_last_owner_has_just_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The lock on a file without a name keeps nobody out: it is taken again on one that has."""
    lock, taken = tmp_path / ".out.lock", []
    plain = locks._lock

    def slow(stream: int) -> None:
        plain(stream)
        taken.append(stream)
        if len(taken) == 1:
            lock.unlink()
        if len(taken) == 2:
            lock.unlink()
            lock.write_text("")  # another run's

    monkeypatch.setattr(locks, "_lock", slow)
    with locks.claimed(tmp_path / "out"):
        assert len(taken) == 3
        assert lock.exists()


def test_where_there_are_no_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*_: object) -> None:
        raise OSError(errno.ENOLCK, "no locks available")

    monkeypatch.setattr(fcntl, "flock", none)
    with locks.claimed(tmp_path / "out"), locks.claimed(tmp_path / "out"):
        (tmp_path / "out").write_text("x")
    assert [item.name for item in tmp_path.iterdir()] == ["out"]
