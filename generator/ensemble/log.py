"""The one log of an ensemble: what happened when, here and on the workers."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from logging.handlers import MemoryHandler
from pathlib import Path

from vascval.core.errors import InputError


@dataclass(frozen=True)
class Log:
    """Lines are kept in mind until there is a file for them."""

    logger: logging.Logger
    memories: tuple[MemoryHandler, ...]

    def say(self, text: str) -> None:
        """A line with the time before it."""
        self.logger.info(" ".join(text.split()))

    def begin(self, path: Path) -> None:
        """From now on to the end of that file, what was said before included.

        :raises InputError: when it cannot be written.
        """
        try:
            file = logging.FileHandler(path, encoding="utf-8")
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror}); choose another directory") from error
        file.setFormatter(logging.Formatter("%(asctime)s %(message)s"))
        for memory in self.memories:
            memory.setTarget(file)
            memory.flush()


@contextmanager
def logged() -> Iterator[Log]:
    """A log; what Dask warns of meanwhile goes there too, and nowhere else."""
    import_module("distributed")  # gives its loggers their handlers
    ours, warnings = MemoryHandler(capacity=1), MemoryHandler(capacity=1)
    warnings.setLevel(logging.WARNING)
    logger = logging.getLogger("vascval.ensemble")
    logger.setLevel(logging.INFO)
    logger.propagate = False
    logger.handlers = [ours]
    theirs = [one for one in map(logging.getLogger, _names()) if one.handlers]
    before = [one.handlers for one in theirs]
    for one in theirs:
        one.handlers = [warnings]
    try:
        yield Log(logger, (ours, warnings))
    finally:
        logger.handlers = []
        for one, handlers in zip(theirs, before):
            one.handlers = handlers
        for memory in (ours, warnings):
            if memory.target is not None:
                memory.target.close()
            memory.close()


def _names() -> list[str]:
    """The loggers of Dask and what it stands on."""
    return [name for name in logging.root.manager.loggerDict if name.split(".")[0] in ("distributed", "tornado")]
