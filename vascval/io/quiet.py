"""What C libraries print, caught: it is neither to reach the terminal nor to be lost, as some of them print an error
and then return whatever was in memory."""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

_ERROR = re.compile(r"[^\n]*(?:error|err\||fail|not read|cannot|can't|corrupt|truncat)[^\n]*", re.IGNORECASE)


@contextmanager
def printed() -> Iterator[Callable[[], str]]:
    """Catches what is written to the file descriptors of stdout and stderr; yields a function that tells the first
    line so far that speaks of an error, an empty text if none does."""
    with tempfile.TemporaryFile() as catch:
        saved = []
        for stream, number in ((sys.stdout, 1), (sys.stderr, 2)):
            with suppress(OSError, ValueError, AttributeError):
                stream.flush()
            with suppress(OSError):  # a closed descriptor cannot be printed to
                saved.append((number, os.dup(number)))
                os.dup2(catch.fileno(), number)

        def first_error() -> str:
            catch.seek(0)
            match = _ERROR.search(catch.read(1 << 16).decode("utf-8", "replace"))
            catch.seek(0, os.SEEK_END)
            return match[0].strip()[:1000] if match else ""

        try:
            yield first_error
        finally:
            for number, copy in saved:
                os.dup2(copy, number)
                os.close(copy)


@contextmanager
def vtk_messages() -> Iterator[Callable[[], str]]:
    """Catches what VTK prints, by its window or past it; yields a function that tells the first line so far that
    speaks of an error, an empty text if none does."""
    from vtkmodules.vtkCommonCore import vtkOutputWindow, vtkStringOutputWindow

    window = vtkStringOutputWindow()
    before = vtkOutputWindow.GetInstance()
    vtkOutputWindow.SetInstance(window)
    try:
        with printed() as complaint:

            def first_error() -> str:
                lines = [complaint(), *(line for line in str(window.GetOutput()).splitlines() if "rror" in line)]
                said = next((line for line in lines if line), "")
                return _PREFIX.sub("", _COLOUR.sub("", said)).strip().rstrip(".")[:160]

            yield first_error
    finally:
        vtkOutputWindow.SetInstance(before)


_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_PREFIX = re.compile(r"^.*?(?:ERR|WARN)\|\s*(?:\w+ \(0x[0-9a-f]+\):\s*)?")
