"""Every study runs, in small; facts are the paper's; the README claims no more than the studies say."""

import re

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from reports import make
from reports.common.pages import Facts, headline
from reports.common.tubes import radius_colours
from vascval.report.view import can_render

REPORTS = make.HERE
NEEDS_DATA = {"twin"}


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    if not can_render():
        pytest.skip("VTK cannot draw on this machine")
    folder = tmp_path_factory.mktemp("reports")
    assert make.main(["--small", "-o", str(folder)]) == 0
    return folder


@pytest.mark.parametrize("name", [name for name in make.STUDIES if name not in NEEDS_DATA])
def test_a_study_writes_its_page_table_and_figures(small, name):
    folder = small / name
    page = (folder / "README.md").read_text(encoding="utf-8")
    assert len(pd.read_csv(folder / "table.csv")) > 0
    for link in re.findall(r"\]\(([^)/]+)\)", page):
        assert (folder / link).stat().st_size > 0, link
    assert not re.search(r"\bnan\b", page)
    with Image.open(folder / "figure.png") as picture:
        grey = np.asarray(picture.convert("L"))
    assert grey.std() > 5  # an empty white picture has 0
    assert "<svg" in (folder / "figure.svg").read_text(encoding="utf-8")[:1000]


def test_the_index_names_every_study_that_was_made(small):
    index = (small / "README.md").read_text(encoding="utf-8")
    made = [name for name in make.STUDIES if (small / name / "README.md").exists()]
    assert len(made) >= len(make.STUDIES) - len(NEEDS_DATA)
    for name in made:
        assert f"({name}/README.md)" in index and headline(small / name) in index


def test_unknown_studies_are_refused(capsys):
    with pytest.raises(SystemExit):
        make.main(["nonsense"])
    assert "no study is named nonsense; they are connections" in capsys.readouterr().err


def test_facts_are_the_papers(shared_data):
    published = pd.read_csv(shared_data("..", "reference", "jessen2022.csv"), dtype=str)
    known = {tuple(row) for row in published.itertuples(index=False)}
    files = sorted(REPORTS.glob("*/paper.csv"))
    assert len(files) >= 5
    for file in files:
        for row in pd.read_csv(file, dtype=str).itertuples(index=False):
            assert tuple(row) in known, f"{file.parent.name}: {row}"


def test_radius_colours_can_be_read_in_grey():
    rgb = radius_colours()(np.linspace(0, 1, 50))[:, :3]
    assert (np.diff(rgb @ [0.299, 0.587, 0.114]) < 0).all()


def test_facts_carry_where_they_stand():
    row = Facts("one_programme").compared("volume reduction of one NLP after CCO at 6000 terminals", 4.0)
    assert (row.paper, row.unit, row.where) == (4.1, "percent", "section 2.3.1")
