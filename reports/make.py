"""Makes the studies, and the index of them, anew.

``python -m reports.make`` makes all; ``python -m reports.make seeds topology`` some; ``--small`` tiny ones, into a
temporary directory unless ``-o`` names one, to see that they run.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from reports.common import claims
from reports.common.figures import style
from reports.common.pages import Skipped, headline, write_page
from reports.common.trees import machine
from reports.tour import make as tour
from vascval.report.formats import measure

HERE = Path(__file__).resolve().parent
STUDIES = (
    "connections", "growth_stages", "seeds", "one_programme", "branching_ratios", "programmes_during_growth",
    "tested_topologies", "seeds_optimised", "topology", "computing_times", "portal_vein", "junctions", "twin", "beyond",
)  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m reports.make", description="Make the studies and their index anew."
    )
    parser.add_argument("studies", nargs="*", metavar="STUDY", help=f"which ({', '.join(STUDIES)}); all by default")
    parser.add_argument("--small", action="store_true", help="tiny trees, to see that everything runs")
    parser.add_argument(
        "-o", "--output", type=Path, help="where to; by default here, with --small a temporary directory"
    )
    given = parser.parse_args(arguments)
    unknown = sorted(set(given.studies) - set(STUDIES))
    if unknown:
        parser.error(f"no study is named {unknown[0]}; they are {', '.join(STUDIES)}")
    wanted = [name for name in STUDIES if name in (given.studies or STUDIES)]
    output = given.output or (Path(tempfile.mkdtemp(prefix="reports-")) if given.small else HERE)
    return make(wanted, output, small=given.small)


def make(studies: Sequence[str], output: Path, *, small: bool) -> int:
    """Make the studies into folders of ``output`` and the index beside them; 1 if none could be made."""
    began = time.process_time()
    left = 0
    for name in studies:
        try:
            seconds = make_study(name, output / name, small=small)
            print(f"{name}: {seconds:.1f} s of processor time", flush=True)
        except Skipped as reason:
            print(f"{name}: left as it is: {reason}", file=sys.stderr, flush=True)
            left += 1
    write_index(output)
    if output == HERE and not small:
        claims.rewrite_readme()
        if len(studies) == len(STUDIES):
            tour.main()
    print(f"{output / 'README.md'} ({time.process_time() - began:.0f} s of processor time in all)")
    return int(left == len(studies))


def make_study(name: str, folder: Path, *, small: bool) -> float:
    """One study; the processor seconds it took.

    :raises Skipped: when something it needs is not there.
    """
    module = importlib.import_module(f"reports.{name}.study")
    folder.mkdir(parents=True, exist_ok=True)
    began = time.process_time()
    with style():
        page = module.study(folder, **(module.SMALL if small else module.FULL))
    seconds = time.process_time() - began
    size = (
        "with tiny trees, to see that it runs" if small else f"({measure(seconds, 2)} s of processor time, {machine()})"
    )
    write_page(folder, name, STUDIES.index(name) + 1, module.TITLE, page, size)
    return seconds


def write_index(output: Path) -> None:
    """The index of all studies that are there."""
    lines = [INTRODUCTION]
    for number, name in enumerate(STUDIES, 1):
        title = importlib.import_module(f"reports.{name}.study").TITLE
        if not (output / name / "README.md").exists():
            lines.append(f"## {number}. {title}\n\nNot made here.")
            continue
        picture = f'<a href="{name}/README.md"><img src="{name}/figure.png" height="220" alt="{title}"></a>'
        shown = picture if (output / name / "figure.png").exists() else ""
        lines.append(f"## {number}. [{title}]({name}/README.md)\n\n{headline(output / name)}\n\n{shown}".rstrip())
    (output / "README.md").write_text("\n\n".join(lines) + "\n", encoding="utf-8")


INTRODUCTION = """# The paper, reproduced

Each table and figure of Jessen, Steinbach, Debbaut and Schillinger, *Rigorous mathematical optimization of
synthetic hepatic vascular trees* (2022), made anew with the public interface of this project, with the paper's
number beside ours and the reason where they differ. All pages, tables, figures and this index are written by

```
python -m reports.make
```

which takes twenty minutes of processor time; `python -m reports.make --small` runs everything on tiny trees in
seconds. The paper states few numbers, and the values behind its figures are not available: where a page has no
number of the paper, it says what the paper describes in words.

In all pictures of vessels colour is radius, on one scale, unless trees are laid over each other: then the colours are
the paper's, red, green and purple, and each picture names what they stand for."""


if __name__ == "__main__":
    sys.exit(main())
