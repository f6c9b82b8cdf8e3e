"""A look at an XML file before anything else parses it: no document type, no entities, bounded nesting, well formed.

Entities are what makes XML dangerous (files read from elsewhere, texts that grow without bound), and none of the tree
formats needs them: a file that declares a document type is refused.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.parsers import expat

from vascval.core.errors import InputError

MAX_DEPTH = 32
Start = Callable[[str, dict[str, str]], bool | None]


def parse(
    path: Path,
    start: Start,
    end: Callable[[str], Any] | None = None,
    text: Callable[[str], Any] | None = None,
) -> int | None:
    """Walk through an XML file.

    ``start(name, attributes)`` is called for each element and ends the walk by returning True (what follows may then
    be no XML at all, such as the raw data at the end of a VTP file); ``end(name)`` and ``text(characters)`` likewise.

    :returns: where ``start`` ended the walk, in bytes; None when it went to the end.
    :raises InputError: for a document type or entity declaration, more than ``MAX_DEPTH`` levels, and XML that is not
        well formed or breaks off.
    """
    parser = expat.ParserCreate()
    parser.buffer_text = True
    depth, over_at = 0, 0

    def on_start(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth, over_at
        depth += 1
        if depth > MAX_DEPTH:
            raise InputError(f"{path}: its XML is nested deeper than {MAX_DEPTH} levels; this is no tree file")
        if start(name, attributes):
            over_at = parser.CurrentByteIndex
            raise _Over

    def on_end(name: str) -> None:
        nonlocal depth
        depth -= 1
        if end is not None:
            end(name)

    def forbid(*_: object) -> None:
        raise InputError(f"{path}: declares a document type or entities, which is refused; remove the <!DOCTYPE part")

    parser.StartElementHandler = on_start
    parser.EndElementHandler = on_end
    parser.StartDoctypeDeclHandler = forbid
    parser.EntityDeclHandler = forbid
    if text is not None:
        parser.CharacterDataHandler = text
    try:
        with path.open("rb") as stream:
            parser.ParseFile(stream)
    except _Over:
        return over_at
    except expat.ExpatError as error:
        what = expat.ErrorString(error.code)
        raise InputError(f"{path}: is no sound XML (line {error.lineno}: {what}); it is damaged") from error
    return None


class _Over(Exception):
    """The part that had to be looked at has been seen."""
