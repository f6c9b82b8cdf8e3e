"""Making a tree with a checkpoint: written now and then and when the run is asked to end, taken up again later."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from vascval.cli import sources
from vascval.cli.console import Observer, note
from vascval.cli.interruption import held_back
from vascval.core.errors import InputError

if TYPE_CHECKING:
    from generator.checkpoint import State
    from generator.framework import Run


class Kept(Protocol):
    """What can be kept: a run, or several."""

    def state(self) -> State: ...

    def restore(self, state: State) -> None: ...


class Keeping:
    """The checkpoint of a run.

    :param origin: what :func:`vascval.io.provenance.provenance` says of the run.
    :param every_s: seconds from one to the next.
    """

    def __init__(self, run: Kept, origin: Mapping[str, Any], path: Path, every_s: float) -> None:
        self.run, self.origin, self.path, self.every_s = run, origin, path, every_s
        self._last = time.monotonic()

    def begin(self, resume: Path | None) -> None:
        """Take up the run that is to be resumed; one that might be is not overwritten.

        :raises InputError: when it cannot be resumed, or there is a checkpoint that nobody asked to.
        """
        from generator import checkpoint

        if resume is None:
            check_is_free(self.path)
            return
        state = checkpoint.read(resume, self.origin)
        with sources.about(resume):
            self.run.restore(state)

    def write(self) -> bool:
        """Write it now. A disk that is full does not end the run: the last checkpoint stays, and a note is made."""
        from generator import checkpoint

        try:
            checkpoint.write(self.path, self.run.state(), self.origin)
        except InputError as error:
            note(f"no checkpoint: {error}")
            return False
        finally:
            self._last = time.monotonic()
        return True

    def write_if_due(self) -> None:
        if time.monotonic() - self._last >= self.every_s:
            self.write()

    def end(self) -> None:
        """The run is done, and its checkpoint not needed any more."""
        self.path.unlink(missing_ok=True)


def check_is_free(path: Path) -> None:
    """Refuses to overwrite a checkpoint."""
    if path.exists():
        raise InputError(f"{path}: is the checkpoint of an interrupted run; go on from it with --resume, or remove it")


def grow(run: Run, keeping: Keeping, observer: Observer | None) -> KeyboardInterrupt | None:
    """Runs all stages; an interruption ends them once something has grown, and is returned."""
    steps = run.steps()
    at_step = False
    with held_back(unless=lambda: run.settled or not run.growth.begun) as held:
        try:
            for name, step in steps:
                at_step = True
                if observer is not None:
                    observer(name, step.n_terminals, step.n_target)
                held.release()
                keeping.write_if_due()
                at_step = False
        except KeyboardInterrupt as interruption:
            if not run.growth.begun:
                raise
            if (at_step or run.settled) and keeping.write():
                note(f"go on from here with --resume {keeping.path}")
            steps.close()
            return interruption
    return None
