"""What the core refuses, each with its reason; where compiled code is kept; numbers of threads."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest

from vascval.core import jit
from vascval.core.columns import as_column, column
from vascval.core.contraction import contract_degenerate, degenerate_segments
from vascval.core.errors import InputError
from vascval.core.threads import threads
from vascval.core.tree import Topology, Tree
from vascval.core.validation import Claims, checks, findings, require_valid

FORK = Topology(np.array([-1, 0, 1, 1]))
PLACES = np.array([[0, 0, 0], [0, 0, 5], [3, 0, 5], [0, 4, 5.0]])
RADII = np.array([0, 2.0, 1.0, 0.5])
CURVES = np.array([[0, 0, 0], [1, 0, 2], [0, 0, 5], [0, 0, 5], [3, 0, 5], [0, 0, 5], [0, 4, 5.0]])
OFFSET = np.array([0, 0, 3, 5, 7])


def fork(**changes: object) -> Tree:
    return Tree(**{"topology": FORK, "position_mm": PLACES, "radius_mm": RADII, **changes})  # type: ignore[arg-type]


def with_entry(array: np.ndarray, index: object, value: float) -> np.ndarray:
    changed = array.copy()
    changed[index] = value
    return changed


@pytest.mark.parametrize(
    ("parent", "match"),
    [
        ([], r"shape \(0,\) is no tree"), ([[-1, 0]], r"shape \(1, 2\) is no tree"),
        (np.array([-1.0, 0.0]), "type float64 is no tree"), ([0, 0], "node 0 has parent 0"),
        ([-1, 0, 2], "1 nodes do not come after their parent .first: node 2, parent 2"),
        ([-1, 0, -1, -1], "2 nodes do not come after their parent .first: node 2, parent -1"),
    ],
)  # fmt: skip
def test_parents_that_make_no_tree(parent: object, match: str) -> None:
    with pytest.raises(InputError, match=match):
        Topology(np.asarray(parent))


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"position_mm": PLACES[:3]}, r"positions have shape \(3, 3\); \(4, 3\) is needed"),
        ({"position_mm": with_entry(PLACES, (2, 1), np.inf)}, r"position that is not finite \(first: node 2\)"),
        ({"radius_mm": RADII[1:]}, r"radii have shape \(3,\)"),
        ({"radius_mm": with_entry(RADII, 3, -1e-9)}, r"1 segments have a radius .* \(first: segment 3\)"),
        ({"radius_mm": with_entry(RADII, 2, np.nan)}, r"1 segments have a radius .* \(first: segment 2\)"),
        ({"columns": {"flow": RADII}}, "no column is named 'flow'"),
        ({"columns": {"flow_mm3_s": RADII[1:]}}, r"'flow_mm3_s' has shape \(3,\)"),
        ({"polyline_mm": CURVES}, "come together"), ({"polyline_offset": OFFSET}, "come together"),
        ({"polyline_mm": CURVES[:, :2], "polyline_offset": OFFSET}, r"shapes \(7, 2\) and \(5,\)"),
        ({"polyline_mm": CURVES.ravel(), "polyline_offset": OFFSET}, r"shapes \(21,\) and \(5,\)"),
        ({"polyline_mm": CURVES, "polyline_offset": OFFSET[1:]}, r"shapes \(7, 3\) and \(4,\)"),
        ({"polyline_mm": CURVES, "polyline_offset": [1, 1, 3, 5, 7]}, "must begin with 0, 0"),
        ({"polyline_mm": CURVES, "polyline_offset": [0, 1, 3, 5, 7]}, "must begin with 0, 0"),
        ({"polyline_mm": CURVES, "polyline_offset": [0, 0, 3, 5, 6]}, "end with the number of points"),
        ({"polyline_mm": CURVES, "polyline_offset": [0, 0, 3, 6, 7]}, r"fewer than two points \(first: segment 3\)"),
        (
            {"polyline_mm": with_entry(CURVES, (1, 0), np.nan), "polyline_offset": OFFSET},
            r"points are not finite \(first: point 1\)",
        ),
        (
            {"polyline_mm": with_entry(CURVES, (4, 0), 3.1), "polyline_offset": OFFSET},
            r"misses its nodes \(first: segment 2\)",
        ),
        (
            {"polyline_mm": with_entry(CURVES, (5, 2), 5.1), "polyline_offset": OFFSET},
            r"misses its nodes \(first: segment 3\)",
        ),
    ],
)  # fmt: skip
def test_arrays_that_make_no_tree(changes: dict[str, object], match: str) -> None:
    with pytest.raises(InputError, match=match):
        fork(**changes)


def test_straight_and_curved_segments() -> None:
    straight, curved = fork(), fork(polyline_mm=CURVES, polyline_offset=OFFSET)
    assert straight.length_mm.tolist() == [0, 5, 3, 4]
    assert straight.polyline(2).tolist() == [[0, 0, 5], [3, 0, 5]]
    assert curved.chord_mm.tolist() == [0, 5, 3, 4]
    assert curved.length_mm.tolist() == pytest.approx([0, 5**0.5 + 10**0.5, 3, 4], rel=1e-15)
    assert curved.polyline(1).tolist() == [[0, 0, 0], [1, 0, 2], [0, 0, 5]]
    assert straight.volume_mm3 == pytest.approx(math.pi * (4 * 5 + 1 * 3 + 0.25 * 4), rel=1e-15)


def test_a_bare_root_point() -> None:
    bare = Tree(Topology(np.array([-1])), np.zeros((1, 3)), np.array([7.0]))
    assert (bare.n_segments, bare.topology.n_terminals, bare.volume_mm3) == (0, 0, 0.0)
    assert bare.radius_mm.tolist() == [0.0]
    assert [found.rule for found in findings(bare)] == ["no-segments"]


def test_columns_are_registered() -> None:
    assert (column("pressure_pa").place, column("pressure_pa").unit) == ("node", "Pa")
    with pytest.raises(InputError, match="no column is named 'presure_pa'; the columns are radius_mm, length_mm"):
        column("presure_pa")
    values = as_column("order", [0, 1, 2], 3)
    assert values.dtype == np.int32
    assert not values.flags.writeable


@pytest.mark.parametrize("diameters", [-0.5, np.nan, np.inf])
def test_numbers_of_diameters_that_mean_nothing(diameters: float) -> None:
    with pytest.raises(InputError, match="a number of diameters of 0 or more is needed"):
        degenerate_segments(fork(), diameters=diameters)


def test_contraction_moves_the_beginning_of_curved_children() -> None:
    """Segment 2, a diameter of 2 mm and 0.5 mm long, goes; its children then begin at node 1."""
    topology = Topology(np.array([-1, 0, 1, 1, 2, 2]))
    position = np.array([[0, 0, 0], [0, 0, 9], [0, 0, 9.5], [4, 0, 9], [0, 4, 9.5], [0, -4, 9.5]])
    ends = [np.array([position[p], (position[p] + position[i]) / 2 + [0, 0, 1], position[i]])
            for i, p in enumerate(topology.parent) if i]  # fmt: skip
    offset = np.array([0, 0, 3, 6, 9, 12, 15])
    radius = np.array([0, 1.5, 1.0, 0.5, 0.6, 0.7])
    tree = Tree(topology, position, radius, {"flow_mm3_s": np.arange(6.0)}, np.concatenate(ends), offset)
    found = contract_degenerate(tree.with_columns(order=np.ones(6)))
    assert found.parent.tolist() == [-1, 0, 1, 1, 1]
    assert list(found.columns) == ["flow_mm3_s"]
    assert found.columns["flow_mm3_s"].tolist() == [0, 1, 3, 4, 5]
    assert found.polyline(3).tolist() == [[0, 0, 9], [0, 2, 10.5], [0, 4, 9.5]]
    assert found.polyline(1).tolist() == ends[0].tolist()
    assert contract_degenerate(found) is found


def test_require_valid_lets_pass_what_is_allowed() -> None:
    tree = fork(position_mm=with_entry(PLACES, 2, PLACES[1]))
    assert require_valid(fork()).n_nodes == 4
    assert require_valid(tree, allow=frozenset({"zero-length"})) is tree
    with pytest.raises(InputError, match=r"1 segments have length 0 \(first: 2\)"):
        require_valid(tree)


def test_checks_of_values_that_are_none() -> None:
    """Without any pressure, or any flow at all, errors are absolute."""
    none = {name: np.full(4, np.nan) for name in ("pressure_pa", "pressure_drop_pa")}
    broken = [f.rule for f in findings(fork(columns=none), Claims(equal_pressure=True))]
    assert broken == ["pressure-rise", "pressure-drop", "terminal-pressure"]
    level = fork(columns={"pressure_pa": np.full(4, 3.0), "flow_mm3_s": np.zeros(4)})
    assert findings(level, Claims(equal_pressure=True)) == []
    assert [c.worst for c in checks(level) if c.rule == "flow-balance"] == [0.0]


def test_numbers_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VASCVAL_THREADS", " 3 ")
    assert threads() == 3
    monkeypatch.setenv("VASCVAL_THREADS", "")
    assert threads() >= 1
    monkeypatch.setattr("os.cpu_count", lambda: None)
    assert threads() == 1
    for bad in ("0", "-1", "two", "1.5"):
        monkeypatch.setenv("VASCVAL_THREADS", bad)
        with pytest.raises(InputError, match=f"VASCVAL_THREADS={bad}: is no number of threads"):
            threads()


def test_where_compiled_code_is_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "given"))
    assert jit._user_cache() == tmp_path / "given"
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "local"))
    for platform, place in (("linux", tmp_path / "xdg"), ("win32", tmp_path / "local")):
        monkeypatch.setattr(sys, "platform", platform)
        assert jit._user_cache() == place / "vascval"
    monkeypatch.setattr(sys, "platform", "darwin")
    assert jit._user_cache().parts[-3:] == ("Library", "Caches", "vascval")


def test_the_place_of_compiled_code_follows_the_kernels_of_the_room(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    room = tmp_path / "vascval" / "room"
    (room / "inner").mkdir(parents=True)
    (room / "inner" / "_a_kernels.py").write_text("a = 1")
    (room / "other.py").write_text("b = 1")
    (room / "__init__.py").write_text("c = 1")
    before = jit._cache_dir.__wrapped__(room)
    assert Path(before).name.startswith("room-")
    for name, changes in (("other.py", False), ("__init__.py", False), ("inner/_a_kernels.py", True)):
        (room / name).write_text("d = 2")
        assert (jit._cache_dir.__wrapped__(room) != before) == changes
    before = jit._cache_dir.__wrapped__(room)
    assert {path.name for path in jit._COMPILING} == {"jit.py", "borrowing.py"}
    for changed in jit._COMPILING:
        (tmp_path / "how.py").write_text(changed.read_text(encoding="utf-8") + "e = 1")
        how = tuple(tmp_path / "how.py" if path == changed else path for path in jit._COMPILING)
        with monkeypatch.context() as patched:
            patched.setattr(jit, "_COMPILING", how)
            assert jit._cache_dir.__wrapped__(room) != before
    assert jit._room(room / "inner" / "_a_kernels.py") == room
    assert jit._room(tmp_path / "generator" / "growth" / "_k.py") == tmp_path / "generator"
    assert jit._room(tmp_path / "elsewhere" / "_k.py") == tmp_path / "elsewhere"
