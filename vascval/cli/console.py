"""What a command says and where: results on stdout, notes and progress on stderr."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

Observer = Callable[[str, float, float], None]
"""Called with the stage, how much of it is done, and the total."""


@dataclass
class State:
    """What the options common to all commands set."""

    quiet: bool = False
    debug: bool = False


def _state() -> State:
    return click.get_current_context().ensure_object(State)


def note(text: str) -> None:
    """One line for the user's information on stderr; silent with ``--quiet``."""
    if not _state().quiet:
        click.echo("vascval: note: " + " ".join(text.split()), err=True)


def say(text: str) -> None:
    """A result, on stdout."""
    click.echo(text)


@contextmanager
def progress() -> Iterator[Observer | None]:
    """An observer that draws a bar for the stage at work; ``None`` with ``--quiet`` and where stderr is no terminal."""
    if _state().quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = [TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}")]
    times = [TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn()]
    with Progress(*columns, *times, console=Console(stderr=True), transient=True) as bars:
        task = bars.add_task("", total=None, rate="")

        def observe(stage: str, done: float, total: float) -> None:
            if stage != bars.tasks[0].description:
                bars.reset(task, description=stage, total=total, rate="")
            speed = bars.tasks[0].speed
            rate = "" if not speed or total <= 100 else f"{speed:,.0f}/s"
            bars.update(task, completed=done, total=total, rate=rate)

        yield observe


def write_json(document: Mapping[str, Any], destination: str) -> None:
    """Writes a JSON document to a file, whole or not at all, or to stdout where ``destination`` is ``-``."""
    text = json.dumps(document, indent=2, allow_nan=False)
    if destination == "-":
        say(text)
        return
    from vascval.io.atomic import atomic_file

    with atomic_file(Path(destination)) as temporary:
        Path(temporary).write_text(text + "\n", encoding="utf-8")


def table(rows: Sequence[Sequence[object]]) -> str:
    """Aligned plain text, the first column to the left and the others to the right; the first row is the header."""
    cells = [["" if value is None else str(value) for value in row] for row in rows]
    widths = [max(len(row[k]) for row in cells) for k in range(len(cells[0]))]
    lines = [
        "  ".join([row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:]))]).rstrip()
        for row in cells
    ]
    return "\n".join(lines)
