"""``vascval generate --history``: the table and the figure of the search, and when there is none."""

import signal

import jsonschema
import numpy as np
import pandas as pd
import pytest

from generator.growth.growth import Growth
from vascval.cli.main import main
from vascval.core.errors import ComputationError
from vascval.io import schemas
from vascval.io.documents import plain
from vascval.io.rows import SearchStepRow
from vascval.report.search_history import SUFFIXES, search_pictures, thinned, write_search_history

FULL = ("method=full", "n_terminals=40", "topology.tests=3000")


def generate(folder, changes, history, *arguments):
    settings = [word for change in changes for word in ("--set", change)]
    return main(
        ["generate", "karch-box", "-o", str(folder / "tree.vtp"), *settings, "--history", str(folder / history),
         *map(str, arguments)]
    )  # fmt: skip


def test_the_table_is_the_search(tmp_path):
    assert generate(tmp_path, FULL, "search.csv") == 0
    table = pd.read_csv(tmp_path / "search.csv")
    assert list(table) == list(SearchStepRow.model_fields)
    jsonschema.validate(plain(table), schemas.schema("table-search-history"))
    assert table["n_tests"].iloc[-1] == 3000
    steps = np.diff(table["n_tests"], prepend=0)
    assert (steps > 0).all()
    assert ((table["n_accepted"] >= 0) & (table["n_accepted"] <= steps)).all()
    assert (np.diff(table["temperature"]) < 0).all()
    assert (np.diff(table["best_mm3"]) <= 0).all()
    assert (table["best_mm3"] <= table["volume_mm3"] * (1 + 1e-12)).all()  # rounding
    before = (tmp_path / "search.csv").read_bytes()
    assert generate(tmp_path, FULL, "search.csv") == 0
    assert (tmp_path / "search.csv").read_bytes() == before


@pytest.mark.parametrize(("suffix", "begins"), [(".svg", b"<?xml"), (".png", b"\x89PNG"), (".pdf", b"%PDF")])
def test_figures(tmp_path, suffix, begins):
    assert generate(tmp_path, FULL, f"search{suffix}") == 0
    data = (tmp_path / f"search{suffix}").read_bytes()
    assert data.startswith(begins)
    assert generate(tmp_path, FULL, f"again{suffix}") == 0
    assert (tmp_path / f"again{suffix}").read_bytes() == data
    assert {path.name for path in tmp_path.iterdir()} == {"tree.vtp", f"search{suffix}", f"again{suffix}"}


@pytest.mark.parametrize(
    ("changes", "history", "message"),
    [
        (("n_terminals=20",), "h.csv", "method=cco has no search for topologies; set method=full"),
        (("n_terminals=20", "method=geometry"), "h.svg", "method=geometry has no search"),
        (("n_terminals=2", "method=full"), "h.svg", "2 terminals have one topology and no search"),
        (("n_terminals=20", "method=full", "topology.at=2"), "h.svg", "2 terminals have one topology"),
        (("n_terminals=20", "method=full"), "h.jpg", "a history is written as .csv, .svg, .png, .pdf"),
        (("n_terminals=20", "method=full"), "none/h.csv", "does not exist"),
    ],
)
def test_no_history_to_be_had_is_said_before_the_work(tmp_path, capsys, changes, history, message):
    assert generate(tmp_path, changes, history) == 2
    out, err = capsys.readouterr()
    assert out == "" and message in err and err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_history_of_a_run_that_was_interrupted_and_resumed(tmp_path, monkeypatch):
    """Interrupted in growth after the search: the checkpoint has its history still."""
    changes = (*FULL, "n_terminals=60", "topology.at=40")
    advance = Growth._advance

    def interrupted(self, target):
        advance(self, target)
        if self.n_grown >= 50:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Growth, "_advance", interrupted)
    assert generate(tmp_path, changes, "search.csv") == 130
    monkeypatch.undo()
    assert generate(tmp_path, changes, "again.csv", "--resume", tmp_path / "tree.vtp.checkpoint") == 0
    (tmp_path / "tree.vtp").unlink()
    assert generate(tmp_path, changes, "whole.csv") == 0
    whole = (tmp_path / "whole.csv").read_bytes()
    assert (tmp_path / "search.csv").read_bytes() == (tmp_path / "again.csv").read_bytes() == whole
    assert pd.read_csv(tmp_path / "whole.csv")["n_tests"].iloc[-1] == 3000


def test_interrupted_before_the_search(tmp_path, monkeypatch, capsys):
    advance = Growth._advance

    def interrupted(self, target):
        advance(self, target)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Growth, "_advance", interrupted)
    assert generate(tmp_path, FULL, "search.csv") == 130
    assert "the search has not begun, so" in capsys.readouterr().err
    assert not (tmp_path / "search.csv").exists()


@pytest.mark.parametrize("writable", [True, False])
def test_interrupted_in_the_search_goes_on_to_the_same_tree(tmp_path, monkeypatch, capsys, writable):
    """Also where the tree so far cannot be written: the checkpoint is that of the last step."""
    from generator.topology.annealing import Annealing
    from vascval.io import trees

    changes = (*FULL, "topology.chains=1")
    assert generate(tmp_path, changes, "whole.csv") == 0
    output = tmp_path / "tree.vtp"
    whole = output.read_bytes()
    output.unlink()
    block = Annealing._block

    def interrupted(chain):
        step = block(chain)
        if step.n_tests >= 1000:
            signal.raise_signal(signal.SIGINT)
        return step

    def refused(*arguments, **options):
        raise ComputationError("the disk is not to be had; get another")

    monkeypatch.setattr(Annealing, "_block", interrupted)
    if not writable:
        monkeypatch.setattr(trees, "write_tree", refused)
    assert generate(tmp_path, changes, "search.csv") == (130 if writable else 1)
    monkeypatch.undo()
    assert "go on from here with --resume" in capsys.readouterr().err
    assert output.exists() == writable
    assert generate(tmp_path, changes, "search.csv", "--resume", tmp_path / "tree.vtp.checkpoint") == 0
    assert output.read_bytes() == whole
    assert (tmp_path / "search.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()


def long_history(count):
    tests = 16 * np.arange(1, count + 1)
    rng = np.random.default_rng(0)
    volume = 100.0 + rng.random(count)
    return pd.DataFrame(
        {"n_tests": tests, "n_accepted": rng.integers(0, 17, count), "temperature": 1e-3 * 0.999 ** np.arange(count),
         "volume_mm3": volume, "best_mm3": np.minimum.accumulate(volume)}
    )  # fmt: skip


@pytest.mark.parametrize("count", [1, 299, 300, 301, 10_007])
def test_long_histories_are_drawn_by_means(count):
    history = long_history(count)
    drawn = thinned(history)
    assert min(count, 150) <= len(drawn) <= 300
    assert drawn["n_accepted"].sum() == history["n_accepted"].sum()
    for name in ("n_tests", "best_mm3"):
        assert drawn[name].iloc[-1] == history[name].iloc[-1]
    if count <= 300:
        assert drawn.to_numpy() == pytest.approx(history[list(drawn)].to_numpy(), rel=1e-15)  # means of one
    assert len(drawn) * 16 <= history["n_tests"].iloc[-1]
    assert drawn["volume_mm3"].between(history["volume_mm3"].min(), history["volume_mm3"].max()).all()


def test_pictures_of_the_report(tmp_path):
    pictures = search_pictures(long_history(500), tmp_path)
    assert [picture.name for picture in pictures] == ["search-volume", "search-acceptance"]
    assert {path.suffix for path in tmp_path.iterdir()} == {".svg", ".png"}
    assert "after 8,000" in pictures[0].alt


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_history_without_steps_is_refused(tmp_path, suffix):
    from vascval.core.errors import InputError

    with pytest.raises(InputError, match="the search made no step"):
        write_search_history(long_history(0), tmp_path / f"h{suffix}")
