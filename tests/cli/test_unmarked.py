"""A value that does not exist is marked where it is shown: empty field, ``null``, dash; never ``nan`` or ``inf``."""

import csv
import json
import re

import numpy as np
import pandas as pd
import pytest

from vascval.cli.main import main
from vascval.core.errors import ComputationError
from vascval.core.tree import Topology, Tree
from vascval.io import rows
from vascval.io.tables import write_table
from vascval.io.trees import write_vtp
from vascval.report.check_section import claimed

NO_NUMBER = re.compile(r"(?i)(?<![a-z-])[-+]?(nan|inf|infinity)(?![a-z])")
ROWS = {
    "generations": rows.GenerationRow, "orders": rows.OrderRow, "segments": rows.SegmentRow,
    "elements": rows.ElementRow, "junctions": rows.JunctionRow, "horton": rows.HortonRow,
}  # fmt: skip


def tree(kind):
    """Trees of which many measures do not exist."""
    shapes = {
        "one segment": ([-1, 0], [(0, 0, 0), (0, 0, 9)], [0, 1]),
        "one fork": ([-1, 0, 1, 1], [(0, 0, 0), (0, 0, 9), (3, 0, 15), (-3, 0, 15)], [0, 1, 0.8, 0.8]),
        "back to its start": ([-1, 0, 1, 1], [(0, 0, 0), (0, 0, 9), (0, 0, 0), (-3, 0, 15)], [0, 1, 0.8, 0.8]),
        "thin below thick": ([-1, 0, 1, 1], [(0, 0, 0), (0, 0, 9), (3, 0, 15), (-3, 0, 15)], [0, 1e-150, 1, 1e-150]),
    }
    parent, position, radius = shapes[kind]
    return Tree(Topology(np.array(parent)), np.array(position, dtype=float), np.array(radius, dtype=float))


def nullable(model, name):
    return type(None) in getattr(model.model_fields[name].annotation, "__args__", ())


def text_of(page):
    return re.sub(r"<(script|style)\b.*?</\1>|<[^>]*>", " ", page.read_text(), flags=re.DOTALL)


@pytest.mark.parametrize("kind", ["one segment", "one fork", "back to its start", "thin below thick"])
def test_analyze(tmp_path, kind, capsys):
    write_vtp(tree(kind), tmp_path / "tree.vtp")
    assert (
        main(["analyze", str(tmp_path / "tree.vtp"), "-o", str(tmp_path / "out"), "--json", str(tmp_path / "j")]) == 0
    )
    shown, _ = capsys.readouterr()
    assert not NO_NUMBER.search(shown)
    json.loads((tmp_path / "j").read_text(), parse_constant=pytest.fail)
    empty = 0
    for path in sorted((tmp_path / "out" / "tables").glob("*.csv")):
        assert not NO_NUMBER.search(path.read_text()), path.name
        model = ROWS.get(path.stem)
        with path.open(newline="") as stream:
            for row in csv.DictReader(stream):
                for name in (name for name, value in row.items() if value == "" and model is not None):
                    assert nullable(model, name) or name == "murray_reason", (path.name, name)
                    empty += 1
    assert empty > 0
    assert not NO_NUMBER.search(text_of(tmp_path / "out" / "report.html"))


def nothing_unmarked(folder, capsys):
    """In the tables, documents and page of a report, and in what was printed."""
    assert not NO_NUMBER.search(capsys.readouterr().out)
    tables = sorted((folder / "tables").glob("*.csv"))
    assert tables
    for path in tables:
        assert not NO_NUMBER.search(path.read_text()), path.name
    for path in folder.rglob("*.json"):
        json.loads(path.read_text(), parse_constant=pytest.fail)
    assert not NO_NUMBER.search(text_of(folder / "report.html"))


def test_compare(tmp_path, capsys):
    for name in ("one segment", "one fork"):
        write_vtp(tree(name), tmp_path / f"{name}.vtp")
    files = [str(tmp_path / f"{name}.vtp") for name in ("one fork", "one segment")]
    assert main(["compare", *files, "-o", str(tmp_path / "out"), "--quiet"]) == 0
    nothing_unmarked(tmp_path / "out", capsys)


def test_twin(tmp_path, tree_file, capsys):
    """Of four terminals, with a root tree of one vessel."""
    quick = ["--set", "topology.tests=100", "--set", "topology.chains=1"]
    assert (
        main(["twin", str(tree_file), "--root-generations", "1", *quick, "-o", str(tmp_path / "out"), "--quiet"]) == 0
    )
    nothing_unmarked(tmp_path / "out", capsys)


def test_ensemble(tmp_path, capsys):
    """Of one tree of two terminals, where nothing spreads."""
    small = ["--set", "n_terminals=2", "--workers", "1"]
    assert main(["ensemble", "karch-box", "--seeds", "1", *small, "-o", str(tmp_path / "out"), "--quiet"]) == 0
    nothing_unmarked(tmp_path / "out", capsys)


def test_an_infinite_value_is_refused_and_a_missing_one_is_an_empty_field(tmp_path):
    path = tmp_path / "a.csv"
    write_table(pd.DataFrame({"a_mm": [1.0, np.nan], "b": ["x", None], "c": pd.array([1, None], "Int64")}), path)
    assert path.read_text() == "a_mm,b,c\n1.0,x,1\n,,\n"
    for values in ([1.0, np.inf], np.array([1.0, -np.inf], dtype=object)):
        with pytest.raises(ComputationError, match=r"1 values of a_mm are infinite \(first: row 2\)"):
            write_table(pd.DataFrame({"a_mm": values}), path)
    assert path.read_text().startswith("a_mm,b,c")


def test_a_report_states_its_checks(tmp_path):
    grown, out = tmp_path / "tree.vtp", tmp_path / "out"
    assert main(["generate", "karch-box", "--set", "n_terminals=30", "-o", str(grown), "--quiet"]) == 0
    assert main(["analyze", str(grown), "-o", str(out), "--quiet"]) == 0
    page = (out / "report.html").read_text()
    section = page[page.index('id="checks"') :]
    section = section[: section.index("</section>")]
    for words in ("what flows in flows out", "Murray", "one pressure at all terminals", "checks, all passed"):
        assert words in section
    figures = re.findall(r"(\d\.\d\d)\s×\s10⁻¹[⁴⁵⁶⁷]", section)
    assert len(figures) >= 2  # round-off, not a word


def test_a_foreign_record_claims_nothing_it_cannot(tmp_path):
    sound = {"config": {"perfusion": {}, "gamma": 3.0}}
    for record in (None, 3, {}, {"config": 3}, {"config": {"gamma": 3.0}}, {"config": {"perfusion": 1, "gamma": 3.0}}):
        found = claimed(tree_with(record))
        assert found.gamma is None and not found.equal_pressure
    assert claimed(tree_with(sound)).gamma == 3.0
    for gamma in (1e300, float("nan"), -1, "3", None):
        assert claimed(tree_with({"config": {"perfusion": {}, "gamma": gamma}})).gamma is None
    for more in ({"root_tree": "a.vtp"}, {"geometry": {"gamma_by_generation": [3.0]}}):
        assert claimed(tree_with({"config": {**sound["config"], **more}})).gamma is None


def tree_with(record):
    made = tree("one fork")
    return Tree(made.topology, made.position_mm, made.radius_mm, meta={"provenance": record})
