"""The one log of an ensemble: what happened when, here and on the workers."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
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
    memory, warnings = MemoryHandler(capacity=1), MemoryHandler(capacity=1)
    warnings.setLevel(logging.WARNING)
    ours, dask = logging.getLogger("vascval.ensemble"), logging.getLogger("distributed")
    before = dask.handlers[:], dask.propagate
    ours.setLevel(logging.INFO)
    ours.propagate = False
    ours.addHandler(memory)
    dask.handlers, dask.propagate = [warnings], False
    try:
        yield Log(ours, (memory, warnings))
    finally:
        ours.removeHandler(memory)
        dask.handlers, dask.propagate = before
        for handler in (memory, warnings):
            if handler.target is not None:
                handler.target.close()
            handler.close()
