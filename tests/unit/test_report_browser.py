"""The report in a browser: hostile names, labels and metadata stay text, and the content policy is never tripped.

Chromium is asked for the page as it stands after all scripts have run, and for its log. A copy in which the same texts
are not escaped and no policy stands shows that the test would see an attack that works.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from vascval.cli.main import main
from vascval.comparison import compare
from vascval.core.tree import Topology, Tree
from vascval.io.trees import read_tree, write_vtp
from vascval.io.volumes import Volume, read_volume, write_volume
from vascval.morphometry import analyze
from vascval.report import view
from vascval.report.page import Section, Text, render
from vascval.report.write import write_analysis_report, write_compare_report

ATTACK = "document.documentElement.setAttribute('data-attacked','yes')"
ATTACKS = (
    f"<script>{ATTACK}</script>",
    f"</script><script>{ATTACK}</script>",
    f"</title></style></textarea><script>{ATTACK}</script>",
    f"<img src=x onerror=\"{ATTACK}\">",
    f"\"><svg onload=\"{ATTACK}\">",
    f"' autofocus tabindex=1 onfocus=\"{ATTACK}\" x='",
    f"<a href=\"javascript:{ATTACK}\">open</a>",
    "<iframe src=\"javascript:parent.document.documentElement.setAttribute('data-attacked','yes')\"></iframe>",
    "<meta http-equiv=\"refresh\" content=\"0;url=data:text/html,attacked\">",
    "<link rel=stylesheet href=\"file:///a.css\"><base href=\"file:///\"><form action=\"//localhost:1\"><input></form>",
    "<!--", "-->", "<![CDATA[", "{{ 7 * 191 }}{% raw %}", "${7*191}", "&lt;script&gt;", "\\u003cscript\\u003e",
    "\u202egnp.exe", "a\x00b\x1b[2J", "]]></script>", "$x^2_{", "\ud7ff\U0001f600", "=cmd|' /C calc'!A0",
)  # fmt: skip
ALL = " ".join(ATTACKS)


@pytest.fixture(scope="module")
def chromium() -> str:
    found = next(
        (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
    )
    if found is None:
        pytest.skip("there is no Chromium here; install it to see the report in a browser")
    return found


class Tags(HTMLParser):
    """Every start tag of a page with its attributes."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))


def opened(chromium: str, page: Path, folder: Path) -> tuple[str, str]:
    """The page as it stands in the browser after two seconds of its clock, and the console but for the graphics."""
    quiet = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder}", "--enable-logging=stderr"]
    command = [chromium, *quiet, "--v=0", "--virtual-time-budget=2000", "--dump-dom", page.as_uri()]
    done = subprocess.run(command, capture_output=True, timeout=120, check=False)
    text = done.stdout.decode("utf-8", "replace")
    if "<html" not in text:
        pytest.skip(f"Chromium does not run here: {done.stderr.decode('utf-8', 'replace')[-300:]}")
    lines = done.stderr.decode("utf-8", "replace").splitlines()
    return text, "\n".join(line for line in lines if "CONSOLE" in line and not re.search("WebGL|GL Driver|GPU", line))


def hostile_tree(source: str = "") -> Tree:
    parent = np.array([-1, 0, 1, 1, 2, 2, 3, 3])
    position = np.array(
        [[0, 0, 0], [0, 0, 9], [5, 0, 15], [-5, 0, 15], [7, 3, 19], [6, -4, 20], [-8, 2, 20], [-6, -5, 19]]
    )
    meta = {"guesses": [*ATTACKS], "source": source, ALL: ALL, "notes": [ALL]}
    return Tree(Topology(parent), position.astype(float), np.array([0, 2, 1.5, 1.4, 1, 1.1, 1.2, 0.9]), meta=meta)


PROVENANCE = {"version": ALL, "command": ALL, "config": {ALL: ALL, "label": ALL}, "seed": 7,
              "inputs": [{"name": ALL, "sha256": ALL, "bytes": 1234}]}  # fmt: skip


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A report of one tree and one of a comparison, whatever can be named in them being hostile."""
    folder = tmp_path_factory.mktemp("pages")
    image = {"n_components": 1, "largest_component_fraction": 1.0, "n_spurs_pruned": 0, "n_loops_cut": 0,
             "voxel_mm": [1.0, 1.0, 1.0], "notes": [ALL], ALL: ALL}  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(view, "can_render", lambda: False)
        one = analyze(hostile_tree(ALL), source=ALL, image=image)
        write_analysis_report(one, folder / "one", provenance=PROVENANCE)
        others = [analyze(hostile_tree(ALL), source=f"{k} {ALL}") for k in range(2)]
        write_compare_report(compare(one, others), folder / "many", provenance=PROVENANCE)
    return {name: folder / name / "report.html" for name in ("one", "many")}


@pytest.mark.parametrize("name", ["one", "many"])
def test_hostile_texts_do_nothing_in_a_browser(
    chromium: str, pages: dict[str, Path], tmp_path: Path, name: str
) -> None:
    given = Tags(pages[name].read_text("utf-8"))
    dom, log = opened(chromium, pages[name], tmp_path)
    found = Tags(dom)
    assert "data-attacked" not in found.tags[0][1]
    assert not [tag for tag, attributes in found.tags if "data-attacked" in attributes]
    assert not log, "the page's console is empty: no violation of the policy, no error of the viewer"
    for tag, attributes in found.tags:
        assert tag not in ("iframe", "object", "embed", "base", "form", "link"), tag
        assert not [a for a in attributes if a.startswith("on")], (tag, attributes)
        for address in ("href", "src", "action"):
            value = attributes.get(address) or "#"
            assert value.startswith(("#", "data:image/")), (tag, address, value[:80])
    counts = {
        tag: sum(t == tag for t, _ in given.tags) for tag in ("script", "style", "meta", "title", "img", "svg", "input")
    }
    assert counts["script"] == 2
    for tag, count in counts.items():
        if tag != "img":  # the viewer takes its still picture away
            assert sum(t == tag for t, _ in found.tags) == count, f"{tag}: a text became an element"


@pytest.mark.parametrize("name", ["one", "many"])
def test_hostile_texts_are_shown_as_they_are(pages: dict[str, Path], name: str) -> None:
    page = pages[name].read_text("utf-8")
    assert "&lt;script&gt;document.documentElement" in page
    assert "{{ 7 * 191 }}" in page
    assert "1337" not in re.sub(r"base64,[^\"]*|<script.*?</script>", "", page, flags=re.DOTALL)
    policy = next(
        a["content"] or "" for tag, a in Tags(page).tags if (a.get("http-equiv") or "").startswith("Content-Sec")
    )
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert "unsafe" not in policy
    assert "*" not in policy
    assert re.fullmatch(r"'sha256-[^']+'", rules["script-src"])


def test_the_browser_would_tell(chromium: str, tmp_path: Path) -> None:
    """The same texts unescaped and without a policy do attack; with the policy they are stopped, as the log says."""
    bare = tmp_path / "bare.html"
    page = f"<html><head><meta charset=utf-8></head><body><p>{ATTACKS[0]}{ATTACKS[3]}</p></body></html>"
    bare.write_text(page, "utf-8")
    dom, _ = opened(chromium, bare, tmp_path / "a")
    assert 'data-attacked="yes"' in dom
    safe = render("title", "", [Section("a", "A", [Text("body")])], version="1", legend=[])
    guarded = tmp_path / "guarded.html"
    guarded.write_text(safe.replace("body</p>", f"{ATTACKS[0]}{ATTACKS[3]}</p>"), "utf-8")
    assert ATTACK in guarded.read_text("utf-8")
    dom, log = opened(chromium, guarded, tmp_path / "b")
    assert 'data-attacked="yes"' not in dom
    assert "Content Security Policy" in log


def test_from_files_to_the_page(chromium: str, tmp_path: Path) -> None:
    """The whole way: a VTP and an NRRD with hostile names and metadata, read, compared and shown."""
    name = "<img src=x onerror=alert(1)>&\"' {{7*191}}.vtp"
    write_vtp(hostile_tree(), tmp_path / name)
    tree = read_tree(tmp_path / name)
    grid = np.zeros((6, 7, 8), dtype=np.uint8)
    write_volume(Volume(grid, np.ones(3), meta={ALL: ALL, "notes": [ALL]}), tmp_path / "<b>cast.nrrd")
    meta = dict(read_volume(tmp_path / "<b>cast.nrrd").meta)
    assert meta[ALL] == ALL
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(view, "can_render", lambda: False)
        provenance = {**PROVENANCE, "config": meta, "inputs": [{"name": name, "sha256": "ab" * 32, "bytes": 1}]}
        write_analysis_report(analyze(tree, source=str(tmp_path / name)), tmp_path / "out", provenance=provenance)
    dom, log = opened(chromium, tmp_path / "out" / "report.html", tmp_path / "profile")
    assert "data-attacked" not in Tags(dom).tags[0][1]
    assert not log
    assert not [a for tag, a in Tags(dom).tags if tag == "img" and (a.get("src") or "").startswith("x")]


NAMES = (f'<img src=x onerror="{ATTACK}">', f'"><svg onload="{ATTACK}">&\' {{{{7*191}}}}')
"""Of files: what fits into a name."""


@pytest.mark.parametrize("command", ["analyze", "compare", "twin", "ensemble"])
def test_hostile_file_names_through_the_commands(chromium: str, tmp_path: Path, command: str) -> None:
    folder = tmp_path / NAMES[0]
    folder.mkdir()
    files = [folder / f"{name}{suffix}" for name, suffix in zip(NAMES, (".vtp", ".vtp"))]
    for file in files:
        write_vtp(hostile_tree(), file)
    blocks = [folder / f"{name}.nrrd" for name in NAMES]
    for size, file in zip((20, 24), blocks):
        write_volume(Volume(np.ones((size, size, size), np.uint8), np.ones(3), meta={ALL: ALL}), file)
    arguments = {
        "analyze": files[:1],
        "compare": files,
        "twin": [*files[:1], "--set", "topology.tests=200", "--set", "topology.chains=1"],
        "ensemble": ["karch-box", "--seeds", "2", "--workers", "1", "--set", "n_terminals=12", "--set", "root_mm=1,1,1",
                     "--vary", f"domain.file={blocks[0]};{blocks[1]}"],
    }[command]  # fmt: skip
    output = tmp_path / "out"
    assert main([command, *map(str, arguments), "-o", str(output), "--quiet"]) == 0
    page = (output / "report.html").read_text("utf-8")
    assert "&lt;img src=x onerror=" in page  # the names are there
    dom, log = opened(chromium, output / "report.html", tmp_path / "profile")
    assert not log
    found = Tags(dom)
    assert "data-attacked" not in found.tags[0][1]
    for tag, attributes in found.tags:
        assert not [a for a in attributes if a.startswith("on")], (tag, attributes)
        assert (attributes.get("src") or "data:image/").startswith("data:image/")
