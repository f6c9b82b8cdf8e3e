"""Options that several commands share, and the types of their values."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar, cast

import click

from vascval.cli.console import State

F = TypeVar("F", bound=Callable[..., Any])


class Numbers(click.ParamType):
    """``X,Y,Z``: three finite numbers; a single one stands for all three where ``broadcast`` says so."""

    name = "x,y,z"

    def __init__(self, *, broadcast: bool = False, positive: bool = False) -> None:
        self.broadcast = broadcast
        self.positive = positive

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        if isinstance(value, tuple):
            return value
        try:
            numbers = tuple(float(part) for part in str(value).split(","))
        except ValueError:
            numbers = ()
        if self.broadcast and len(numbers) == 1:
            numbers *= 3
        if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
            self.fail(f"{value!r} is not three numbers joined by commas, such as 12.5,0,-3", param, ctx)
        if self.positive and min(numbers) <= 0:
            self.fail(f"{value!r} has a number that is not above 0", param, ctx)
        return numbers


class Finite(click.FloatRange):
    """A number in a range, and one indeed: NaN passes every comparison unnoticed."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number", param, ctx)
        return number


class Threshold(click.ParamType):
    """A finite grey value, or ``auto`` (``otsu`` says the same) for an automatic one."""

    name = "value|auto"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float | str:
        if isinstance(value, float):
            return value
        if str(value).lower() in ("auto", "otsu"):
            return "auto"
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            self.fail(f"{value!r} is neither a grey value nor 'auto'", param, ctx)
        return number


class Memory(click.ParamType):
    """A number of bytes with an optional unit: ``800MB``, ``2GB``, ``1.5GiB``; decimal units, binary ones with an i."""

    name = "size"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        if isinstance(value, int):
            return value
        match = re.fullmatch(r"([0-9]*\.?[0-9]+)\s*([kmgt]?)(i?)b?", str(value).strip().lower())
        if match is None:
            self.fail(f"{value!r} is not a size such as 800MB or 2GB", param, ctx)
        base = 1024 if match[3] else 1000
        size = int(float(match[1]) * base ** " kmgt".index(match[2] or " "))
        if size <= 0:
            self.fail(f"{value!r} leaves no memory at all", param, ctx)
        return size


def common_options() -> list[click.Option]:
    """``--quiet`` and ``--debug``, which the program and every command take."""

    def store(name: str) -> Callable[[click.Context, click.Parameter, bool], None]:
        def callback(context: click.Context, _parameter: click.Parameter, value: bool) -> None:
            if value:  # given before or after the command's name
                setattr(context.ensure_object(State), name, True)

        return callback

    return [
        click.Option(
            ["--quiet", "-q"],
            is_flag=True,
            expose_value=False,
            callback=store("quiet"),
            help="No progress and no notes on stderr; errors are still shown.",
        ),
        click.Option(
            ["--debug"],
            is_flag=True,
            is_eager=True,
            expose_value=False,
            callback=store("debug"),
            help="Show the traceback of an error.",
        ),
    ]


@dataclass(frozen=True)
class Selection:
    """How a volume is read and what in it is vessel: the options shared by all commands that read one."""

    label: int | None = None
    threshold: float | str | None = None
    root_mm: tuple[float, float, float] | None = None
    spacing_mm: tuple[float, float, float] | None = None
    dataset: str | None = None
    max_memory_bytes: int | None = None

    def __post_init__(self) -> None:
        if self.label is not None and self.threshold is not None:
            raise click.UsageError("--label and --threshold exclude each other; give one", click.get_current_context())

    def config(self) -> dict[str, Any]:
        """What was chosen, for the provenance of the outputs."""
        chosen = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "max_memory_bytes"}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in chosen.items()}

    def given(self) -> list[str]:
        """The options that were given, as they are typed."""
        names = {"label": "--label", "threshold": "--threshold", "root_mm": "--root", "spacing_mm": "--spacing"}
        names["dataset"] = "--dataset"
        return [option for name, option in names.items() if getattr(self, name) is not None]


_VOLUME_OPTIONS = (
    click.option("--label", type=int, metavar="N", help="Vessels are the voxels with this label of a label map."),
    click.option(
        "--threshold",
        type=Threshold(),
        help="Vessels are the voxels of at least this grey value; 'auto' finds it by Otsu's method.",
    ),
    click.option(
        "--root",
        "root_mm",
        type=Numbers(),
        metavar="X,Y,Z",
        help="Where blood enters, in mm in the file's world frame.  [default: the end of the thickest stem]",
    ),
    click.option(
        "--spacing",
        "spacing_mm",
        type=Numbers(broadcast=True, positive=True),
        metavar="X[,Y,Z]",
        help="Voxel size in mm where the file states none.",
    ),
    click.option(
        "--dataset", metavar="NAME", help="Which array of a zarr group or an HDF5 file, where there are several."
    ),
    click.option(
        "--max-memory",
        "max_memory_bytes",
        type=Memory(),
        metavar="SIZE",
        help="Keep below this, such as 2GB; what needs more is refused before the work begins.",
    ),
)


def volume_options(function: F) -> F:
    """The options of :class:`Selection`, handed to the command as one argument ``selection``."""

    @wraps(function)
    def command(**arguments: Any) -> Any:
        chosen = {field.name: arguments.pop(field.name) for field in fields(Selection)}
        return function(selection=Selection(**chosen), **arguments)

    for option in reversed(_VOLUME_OPTIONS):
        command = option(command)
    return cast(F, command)


def json_option(function: F) -> F:
    """``--json FILE``."""
    return click.option(
        "--json", "json_file", metavar="FILE", help="Also write the result as JSON; '-' writes it to stdout alone."
    )(function)


def unit_option(function: F) -> F:
    """``--unit``, for tree files."""
    return click.option(
        "--unit",
        type=click.Choice(["mm", "um", "cm", "m"]),
        help="Length unit of tree files that do not state theirs.  [default: guessed, with a note]",
    )(function)


def checkpoint_options(kept: str, default: str, resumed: str) -> Callable[[F], F]:
    """``--checkpoint``, ``--checkpoint-every`` and ``--resume``: what is kept, where by default, what to give."""
    path = click.Path(path_type=Path)
    options = (
        click.option("--checkpoint", type=path, metavar="FILE", help=f"Where {kept}.  [default: {default}]"),
        click.option(
            "--checkpoint-every", "every_s", type=Finite(min=0), default=60.0, metavar="SECONDS",
            help="How often.  [default: 60]",
        ),
        click.option("--resume", type=path, metavar="FILE", help=f"Go on from this checkpoint; {resumed}"),
    )  # fmt: skip

    def decorate(function: F) -> F:
        for option in reversed(options):
            function = option(function)
        return function

    return decorate
