"""Which trees an ensemble has, and the manifest that knows which of them there are."""

import json
import random
import re

import pytest

from generator.ensemble.manifest import DONE, FAILED, Manifest
from generator.ensemble.plan import identity, plan
from generator.ensemble.work import Failed, Grown
from vascval.core.errors import InputError
from vascval.core.threads import threads

SMALL = ("n_terminals=20",)


def grown(text="tree", seconds=1.0):
    return Grown(text.encode(), {"summary": {"volume_mm3": 1.0}}, "host:1", seconds)


def kept(folder, planned, results):
    """A manifest with these results for the first trees of the plan."""
    manifest = Manifest.of(planned, folder / "manifest.json", folder)
    for order, result in zip(planned.orders, results):
        manifest.keep(order, result)
    return manifest


def reread(folder, planned):
    return Manifest.of(planned, folder / "manifest.json", folder)


def missing(folder, planned):
    return [order.name for order in reread(folder, planned).missing(planned)]


def test_seeds_count_from_the_configuration_on():
    planned = plan("karch-box", ("n_terminals=20", "seed=7"), (), 3)
    assert [(order.name, order.case, order.config.seed) for order in planned.orders] == [
        ("seed-7", "", 7),
        ("seed-8", "", 8),
        ("seed-9", "", 9),
    ]
    assert {order.config.n_terminals for order in planned.orders} == {20}
    assert len({order.digest for order in planned.orders}) == 3


def test_a_grid_has_every_combination():
    planned = plan("karch-box", SMALL, ("gamma=2.5,3", "domain.box_mm=10,10,10;20,10,10"), 2)
    found = [(order.config.gamma, order.config.domain.box_mm[0], order.config.seed) for order in planned.orders]
    assert found == [(g, b, s) for g in (2.5, 3.0) for b in (10.0, 20.0) for s in (1, 2)]
    assert planned.orders[0].case == "gamma=2.5 domain.box_mm=10,10,10"
    assert planned.orders[0].name == "gamma-2.5_domain.box_mm-10-10-10_seed-1"


def test_names_that_files_cannot_tell_apart_are_told_apart(tmp_path):
    for name in ("a b.csv", "a-b.csv"):
        (tmp_path / name).write_text(f"x_mm,y_mm,z_mm\n0,0,0\n5,5,{len(name)}\n9,9,{ord(name[1])}\n")
    files = ",".join(str(tmp_path / name) for name in ("a b.csv", "a-b.csv"))
    names = [order.name for order in plan("karch-box", SMALL, (f"terminals_file={files}",), 2).orders]
    assert len(set(names)) == 4


@pytest.mark.parametrize(
    ("vary", "message"),
    [
        ("gamma", "--vary gamma: is not key=v1,v2"),
        ("gamma=", "is not key=v1,v2"),
        ("=2,3", "is not key=v1,v2"),
        ("gamma=2.5,,3", "is not key=v1,v2"),
        ("seed=1,2", "seeds are counted by --seeds"),
        ("gamma=2.5,2.5", "a value comes twice"),
        ("gamma=2.5,2.50", "--vary: gamma=2.5 is the same as another case"),
        ("gamme=2.5,3", "karch-box: gamme is no key"),
        ("gamma=2.5,7", "karch-box: gamma: input should be less than or equal to 3"),
    ],
)
def test_grids_that_make_no_sense(vary, message):
    with pytest.raises(InputError, match=re.escape(message)):
        plan("karch-box", SMALL, (vary,), 2)
    with pytest.raises(InputError, match="gamma comes twice"):
        plan("karch-box", SMALL, ("gamma=2,3", "gamma=2.5"), 2)


def test_no_seeds():
    with pytest.raises(InputError, match="--seeds 0: no tree would be made"):
        plan("karch-box", SMALL, (), 0)


def test_identity_has_contents_in_place_of_file_names(tmp_path):
    points = "x_mm,y_mm,z_mm\n0,0,0\n5,5,5\n9,9,9\n"
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text(points)
    first, second = (plan("karch-box", (f"terminals_file={tmp_path / name}",), (), 1) for name in ("a.csv", "b.csv"))
    assert first.base == second.base
    (tmp_path / "b.csv").write_text(points + "3,3,3\n")
    assert identity(second.config) != identity(first.config)


def test_only_what_is_missing(tmp_path):
    planned = plan("karch-box", SMALL, (), 4)
    kept(tmp_path, planned, [grown(), Failed("no room"), grown("other")])
    again = reread(tmp_path, planned)
    assert [again.tree(order).state for order in planned.orders] == [DONE, FAILED, DONE, "missing"]
    assert again.tree(planned.orders[1]).error == "no room"
    assert missing(tmp_path, planned) == ["seed-2", "seed-4"]
    assert again.document(planned.orders[0]) == {"summary": {"volume_mm3": 1.0}}


@pytest.mark.parametrize("file", ["seed-1.vtp", "seed-1.json"])
@pytest.mark.parametrize("damage", ["gone", "changed"])
def test_damaged_trees_are_missing(file, damage, tmp_path):
    planned = plan("karch-box", SMALL, (), 2)
    kept(tmp_path, planned, [grown(), grown("b")])
    path = tmp_path / "trees" / file
    path.unlink() if damage == "gone" else path.write_bytes(path.read_bytes()[:-1])
    assert missing(tmp_path, planned) == ["seed-1"]


def test_more_seeds_and_values_are_added(tmp_path):
    few = plan("karch-box", SMALL, ("gamma=2.5",), 2)
    kept(tmp_path, few, [grown("a"), grown("b")])
    more = plan("karch-box", SMALL, ("gamma=2.5,3",), 3)
    assert missing(tmp_path, more) == ["gamma-2.5_seed-3", *(f"gamma-3_seed-{k}" for k in (1, 2, 3))]
    manifest = reread(tmp_path, more)
    manifest.write()
    assert missing(tmp_path, few) == []  # fewer again: nothing was forgotten


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        (("n_terminals=30",), "n_terminals was 20 and is 30"),
        (("n_terminals=20", "domain.box_mm=9,9,9"), "domain.box_mm was [90.0, 70.0, 16.0] and is [9.0, 9.0, 9.0]"),
        (("n_terminals=30", "gamma=3"), "n_terminals was 20 and is 30 (1 more)"),
    ],
)
def test_another_configuration_is_refused(changes, reason, tmp_path):
    kept(tmp_path, plan("karch-box", SMALL, (), 1), [grown()])
    with pytest.raises(InputError, match=re.escape(f"is of another ensemble: {reason}; choose another -o")):
        reread(tmp_path, plan("karch-box", changes, (), 1))


def test_another_file_or_version_is_refused(tmp_path, monkeypatch):
    points = tmp_path / "points.csv"
    points.write_text("x_mm,y_mm,z_mm\n0,0,0\n5,5,5\n9,9,9\n")
    kept(tmp_path, plan("karch-box", (f"terminals_file={points}",), (), 1), [grown()])
    points.write_text("x_mm,y_mm,z_mm\n0,0,0\n5,5,5\n9,9,8\n")
    with pytest.raises(InputError, match="the file of terminals_file was another one"):
        reread(tmp_path, plan("karch-box", (f"terminals_file={points}",), (), 1))
    monkeypatch.setattr("vascval.__version__", "99")
    with pytest.raises(InputError, match=r"version was .* and is 99"):
        reread(tmp_path, plan("karch-box", (f"terminals_file={points}",), (), 1))


def test_trees_of_other_sources_are_not_mixed(tmp_path, monkeypatch):
    kept(tmp_path, plan("karch-box", SMALL, (), 1), [grown()])
    monkeypatch.setattr("generator.ensemble.plan.code_sha256", lambda: "0" * 64)
    with pytest.raises(InputError, match=r"another ensemble: its trees were made by other sources of vascval .* -o"):
        reread(tmp_path, plan("karch-box", SMALL, (), 1))


@pytest.mark.parametrize("text", ["", "{}", "[1]", "not json", '{"version": "1"}'])
def test_what_is_no_manifest(text, tmp_path):
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(InputError, match="is no manifest of an ensemble; move it away"):
        reread(tmp_path, plan("karch-box", SMALL, (), 1))


def test_an_edited_manifest_is_refused(tmp_path):
    kept(tmp_path, plan("karch-box", SMALL, (), 1), [grown()])
    document = json.loads((tmp_path / "manifest.json").read_text())
    document["config_sha256"] = "".join(random.Random(1).sample(document["config_sha256"], 64))
    (tmp_path / "manifest.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match="its checksum is not that of its configuration"):
        reread(tmp_path, plan("karch-box", SMALL, (), 1))


def test_threads(monkeypatch):
    monkeypatch.setenv("VASCVAL_THREADS", "3")
    assert threads() == 3
    monkeypatch.delenv("VASCVAL_THREADS")
    assert threads() >= 1
    for wrong in ("0", "-1", "two", "1.5"):
        monkeypatch.setenv("VASCVAL_THREADS", wrong)
        with pytest.raises(InputError, match=f"VASCVAL_THREADS={wrong}: is no number of threads"):
            threads()
