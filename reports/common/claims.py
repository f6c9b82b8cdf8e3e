"""The README's table of what is reproduced: its lines come from the studies, and are written between two marks."""

from __future__ import annotations

import re
from pathlib import Path

from reports.common.pages import headline

REPORTS = Path(__file__).resolve().parents[1]
README = REPORTS.parent / "README.md"
BEGIN, END = "<!-- reports: begin -->", "<!-- reports: end -->"
CLAIMED = (
    "one_programme", "topology", "tested_topologies", "seeds_optimised", "computing_times", "portal_vein", "junctions",
    "beyond",
)  # fmt: skip


def block(reports: Path = REPORTS) -> str:
    """What stands between the marks."""
    lines = [f"* [{_title(reports / name)}](reports/{name}/README.md): {headline(reports / name)}" for name in CLAIMED]
    return "\n".join([BEGIN, *lines, END])


def _title(folder: Path) -> str:
    first = (folder / "README.md").read_text(encoding="utf-8").splitlines()[0]
    return re.sub(r"^# \d+\. ", "", first)


def rewrite_readme() -> None:
    """Put the present block into the README, whose marks are there."""
    text = README.read_text(encoding="utf-8")
    pattern = re.compile(re.escape(BEGIN) + ".*?" + re.escape(END), re.DOTALL)
    README.write_text(pattern.sub(lambda _: block(), text), encoding="utf-8")
