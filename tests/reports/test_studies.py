"""Every study runs, in small; facts are the paper's; the README claims no more than the studies say."""

import re

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from reports import make
from reports.common import claims
from reports.common.pages import Facts, headline
from reports.common.tubes import radius_colours
from vascval.report.view import can_render

REPORTS = make.HERE


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    if not can_render():
        pytest.skip("VTK cannot draw on this machine")
    folder = tmp_path_factory.mktemp("reports")
    assert make.main(["--small", "-o", str(folder)]) == 0
    return folder


@pytest.mark.parametrize("name", make.STUDIES)
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
    assert len(made) == len(make.STUDIES)
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


def table(study):
    return pd.read_csv(REPORTS / study / "table.csv")


def test_the_readme_says_what_the_studies_say():
    assert claims.block() in claims.README.read_text(encoding="utf-8"), "python -m reports.make writes it"


def test_headlines_are_their_tables():
    """The numbers of the pages that the README quotes, computed again from the tables beside them."""
    once = table("one_programme").groupby("kind").mean(numeric_only=True)
    said = headline(REPORTS / "one_programme")
    assert f"takes {once.loc['the programme, its topology kept', 'less_percent']:.1f} % off" in said
    assert f"makes {once.loc['contracted once', 'trifurcations']:,.0f} trifurcations" in said
    topology, said = table("topology"), headline(REPORTS / "topology")
    assert f"up to {topology['topology_less_percent'].max():.1f} % more" in said
    assert f"{topology['total_less_percent'].max():.1f} % in all" in said
    times = table("computing_times")
    largest = times[times["terminals"] == times["terminals"].max()]["here_s"].sum()
    assert f"takes {largest:.0f} s of" in headline(REPORTS / "computing_times")
    monopodial = table("junctions").groupby("tree")["n_monopodial"].mean().round()
    said = f"from {monopodial['growth alone']:,.0f} to {monopodial['optimised']:,.0f} by optimising"
    assert said in headline(REPORTS / "junctions")
    volumes = table("tested_topologies").drop(columns="seed").mean()
    assert f"{100 * (1 - volumes.iloc[-1] / volumes['growth']):.1f} % below growth" in headline(
        REPORTS / "tested_topologies"
    )


def test_volumes_of_growth_in_the_readme_are_those_of_the_stages():
    rows = re.findall(r"^\| ([\d,]+) \| [\d.]+ s \| ([\d,]+) mm\^3 \|$", claims.README.read_text("utf-8"), re.MULTILINE)
    quoted = {int(n.replace(",", "")): float(volume.replace(",", "")) for n, volume in rows}
    stages = table("growth_stages").set_index("terminals")["volume_mm3"]
    both = set(quoted) & set(stages.index)
    assert {500, 6000} <= both
    for n in both:
        assert quoted[n] == round(stages[n])


def test_every_page_is_there_and_indexed():
    index = (REPORTS / "README.md").read_text(encoding="utf-8")
    for number, name in enumerate(make.STUDIES, 1):
        assert (REPORTS / name / "README.md").read_text(encoding="utf-8").startswith(f"# {number}. ")
        assert headline(REPORTS / name) in index
