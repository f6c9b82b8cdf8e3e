"""The entry point: finds the command, runs it, and turns every way it can end into an exit code and one line."""

from __future__ import annotations

import importlib
import os
import signal
import sys
import threading
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from types import FrameType, TracebackType
from typing import Any

import click

from vascval import __version__
from vascval.cli.console import State
from vascval.cli.interruption import interruption_behind
from vascval.cli.options import common_options
from vascval.core.errors import VascvalError

FAILED, BAD_INPUT, INTERRUPTED = 1, 2, 130

_COMMANDS = ("demo", "compare", "skeletonize", "analyze", "generate", "optimum", "twin", "ensemble", "view", "schema")


class _Commands(click.Group):
    """Commands that are imported when they are asked for; each also takes the options common to all."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return None
        command: click.Command = getattr(importlib.import_module(f"vascval.cli.{cmd_name}"), cmd_name)
        have = {parameter.name for parameter in command.params}
        command.params += [option for option in common_options() if option.name not in have]
        return command


@click.group(
    cls=_Commands,
    no_args_is_help=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="""\b
Examples:
  vascval demo                                        the whole job, no input needed
  vascval compare cast.nrrd tree.vtp -o comparison    a real cast against a synthetic tree
  vascval compare --help                              more on one command

\b
Exit codes: 0 done; 1 a computation failed; 2 bad input or usage; 130 interrupted.
""",
)
@click.version_option(__version__, prog_name="vascval", message="%(prog)s %(version)s")
def cli() -> None:
    """Hold synthetic vascular trees against real vessels.

    Turns a segmented volume (micro-CT of a corrosion cast, CT, MRI) into a tree, measures it generation by
    generation, and compares it with trees that an optimisation or another program made.
    """


cli.params += common_options()


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line and returns its exit code.

    :param argv: the arguments without the program's name; ``None`` takes those of the process, and then an error that
        nobody foresaw is reported in one line too.
    """
    state = State()
    _open_closed()
    if argv is None:
        sys.excepthook = _unforeseen(state)
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        with _termination():
            return _run(arguments, state)
    except (KeyboardInterrupt, VascvalError, click.ClickException, MemoryError, OSError) as error:
        if state.debug:
            traceback.print_exception(error)
        return _ending(error)


def _run(arguments: list[str], state: State) -> int:
    try:
        with cli.make_context("vascval", arguments, obj=state) as context:
            cli.invoke(context)
    except click.exceptions.Exit as ending:
        return ending.exit_code
    except SystemError as error:
        interruption = interruption_behind(error)
        if interruption is None:
            raise
        raise interruption from None
    finally:
        sys.stdout.flush()
    return 0


def _open_closed() -> None:
    """A stream that was closed before the start, as by ``>&-``, is one that nobody reads."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115 (for as long as the process lasts)


class Terminated(KeyboardInterrupt):
    """Another process asked this one to stop: files are cleaned up as after Ctrl-C."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.exit_code = 128 + number


@contextmanager
def _termination() -> Iterator[None]:
    """Makes the signals that ask for an end raise :class:`Terminated`, so that unfinished files are removed."""

    def stop(number: int, _frame: FrameType | None) -> None:
        raise Terminated(number)

    previous: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for name in ("SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) == signal.SIG_DFL:
                previous[number] = signal.signal(number, stop)
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _ending(error: BaseException) -> int:
    """Prints the one line that an error deserves and returns the exit code."""
    if isinstance(error, KeyboardInterrupt):
        _complain("interrupted; no unfinished file is left behind")
        return getattr(error, "exit_code", INTERRUPTED)
    if isinstance(error, VascvalError):
        _complain(f"error: {error}")
        return error.exit_code
    if isinstance(error, click.ClickException):
        context = getattr(error, "ctx", None)
        name = context.command_path if context is not None else "vascval"
        _complain(f"error: {error.format_message().rstrip('.')}; see '{name} --help'")
        return BAD_INPUT
    if isinstance(error, MemoryError):
        detail = f" ({error})" if str(error) else ""
        _complain(f"error: not enough memory{detail}; crop the volume, coarsen it, or free memory")
        return FAILED
    if isinstance(error, BrokenPipeError):  # whoever read the results has seen enough
        with suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    assert isinstance(error, OSError)
    named = f"{error.filename}: " if error.filename is not None else ""
    _complain(f"error: {named}{error.strerror or error}; check the path, its permissions and the space left")
    return FAILED if error.filename is None else BAD_INPUT


def _complain(text: str) -> None:
    print("vascval: " + " ".join(text.split()), file=sys.stderr)


def _unforeseen(state: State) -> Any:
    """An excepthook for errors that are the program's own fault: one line, or the traceback with ``--debug``."""

    def hook(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        if state.debug:
            traceback.print_exception(kind, error, trace)
        else:
            _complain(f"error: internal error, {kind.__name__}: {error}; run again with --debug and report the output")

    return hook
