"""The page of a study: what the paper says beside what we find, as README.md, and both as CSV."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from vascval.report.formats import THIN, measure, missing

HEADLINE = "> "
_REPORTS = Path(__file__).resolve().parents[1]


class Skipped(Exception):
    """A study cannot be made here; the message says why."""


@dataclass(frozen=True)
class Compared:
    """One quantity: what the paper states (``None``: nothing) and what is found here. ``where``: in the paper."""

    quantity: str
    paper: float | str | None
    ours: float | str | None
    unit: str = ""
    where: str = ""


@dataclass(frozen=True)
class Page:
    """``headline``: one line for the index; ``comparison`` and the ``text``, Markdown, below it."""

    headline: str
    comparison: Sequence[Compared]
    text: str


class Facts:
    """What the paper states, as far as a study needs it: its ``paper.csv``, taken word for word from the paper."""

    def __init__(self, study: str) -> None:
        self._rows = pd.read_csv(_REPORTS / study / "paper.csv", dtype={"unit": str}).set_index("quantity")

    def __getitem__(self, quantity: str) -> float:
        return float(self._rows.loc[quantity, "value"])  # type: ignore[arg-type]

    def compared(self, quantity: str, ours: float | str | None, name: str | None = None) -> Compared:
        """That quantity of the paper beside ours."""
        row = self._rows.loc[quantity]
        unit = "" if missing(row["unit"]) or row["unit"] == "count" else str(row["unit"])
        return Compared(name or quantity, float(row["value"]), ours, unit, str(row["where"]))


def write_page(folder: Path, name: str, number: int, title: str, page: Page, note: str) -> None:
    """``README.md`` and ``comparison.csv``; ``note`` says what it was made with."""
    rows = pd.DataFrame([vars(row) for row in page.comparison], columns=list(Compared.__dataclass_fields__))
    write_csv(rows, folder / "comparison.csv")
    pictures = sorted(path.name for path in folder.glob("*.png"))
    files = [f"[{file}]({file})" for file in sorted(path.name for path in folder.glob("*.csv")) if file != "paper.csv"]
    files += [f"[{Path(file).stem} as vector]({Path(file).stem}.svg)" for file in pictures]
    parts = [
        f"# {number}. {title}",
        HEADLINE + page.headline,
        *(f"![{title}]({file})" for file in pictures),
        markdown(
            ["", "paper", "here", "in the paper"],
            [[row.quantity, *(_value(value, row.unit) for value in (row.paper, row.ours)), row.where]
             for row in page.comparison],
        ),
        page.text.strip(),
        f"Numbers in full: {', '.join(files)}.",
        f"Made by `python -m reports.make {name}` {note}.",
    ]  # fmt: skip
    (folder / "README.md").write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def headline(folder: Path) -> str:
    """The headline of a page that was written."""
    lines = (folder / "README.md").read_text(encoding="utf-8").splitlines()
    return next(line.removeprefix(HEADLINE) for line in lines if line.startswith(HEADLINE))


def write_csv(frame: pd.DataFrame, path: Path) -> None:
    """A table, numbers to seven digits: what a rerun on another machine repeats."""
    frame.to_csv(path, index=False, lineterminator="\n", float_format="%.7g")


def markdown(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)


def table(frame: pd.DataFrame, digits: int = 4) -> str:
    """A frame as a Markdown table, underscores of its column names as spaces."""
    return markdown(
        [str(name).replace("_", " ") for name in frame.columns],
        [[_cell(value, digits) for value in row] for row in frame.itertuples(index=False)],
    )


def percent(share: float, digits: int = 1) -> str:
    return f"{100 * share:.{digits}f} %"


def _cell(value: Any, digits: int) -> str:
    if isinstance(value, str):
        return value
    if missing(value):
        return ""
    return f"{value:,.0f}" if float(value).is_integer() else _number(value, digits)


def _number(value: float, digits: int) -> str:
    """With commas between thousands, as whole numbers have them here."""
    text = measure(value, digits)
    return text if "\N{MULTIPLICATION SIGN}" in text else text.replace(THIN, ",")


def _value(value: float | str | None, unit: str) -> str:
    if value is None or value == "":
        return ""
    if isinstance(value, str):
        return value
    text = f"{value:,.0f}" if float(value).is_integer() else _number(value, 3)
    return f"{text} {'%' if unit == 'percent' else unit}".strip()
