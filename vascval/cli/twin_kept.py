"""What ``vascval twin`` keeps in its checkpoint: the cast that was measured, and the trees, each as far as it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from vascval.cli.sources import Measured

if TYPE_CHECKING:
    from generator.checkpoint import State
    from generator.framework import Run

_CAST = "cast"


class Parts:
    """Parts by name, each a state of its own: the cast, where it came from a volume, and the grown trees."""

    def __init__(self) -> None:
        self._parts: dict[str, State] = {}
        self._at_work: tuple[str, Run] | None = None

    def helps(self, error: BaseException) -> bool:
        """Whether a run that ended so can go on from here: what cannot be done goes wrong before a tree is begun."""
        return any(name != _CAST or isinstance(error, KeyboardInterrupt) for name in self._parts)

    def state(self) -> State:
        """All parts as one."""
        from generator.checkpoint import State
        from generator.kept import with_prefix

        self._look()
        arrays = [with_prefix(name, part.arrays) for name, part in self._parts.items()]
        record = {name: part.record for name, part in self._parts.items()}
        return State(record, {name: values for part in arrays for name, values in part.items()})

    def restore(self, state: State) -> None:
        """Take over what :meth:`state` gave."""
        from generator.checkpoint import State
        from generator.kept import below

        self._parts = {name: State(record, below(name, state.arrays)) for name, record in state.record.items()}

    def measured(self, name: str) -> Measured | None:
        """The cast, if it is kept, analysed under that name.

        :raises InputError: when it is not sound.
        """
        from vascval.core.errors import InputError
        from vascval.imaging.kept import taken_up
        from vascval.morphometry import analyze

        part = self._parts.get(_CAST)
        if part is None:
            return None
        try:
            skeleton = taken_up(part.record, part.arrays)
        except (KeyError, ValueError, TypeError) as error:
            raise InputError("holds a cast that is not sound; begin the run anew") from error
        return Measured(analyze(skeleton.tree, source=name, image=skeleton.image), skeleton)

    def keep(self, cast: Measured) -> None:
        """Keep the cast if it came from a volume; a tree is read again in no time."""
        from generator.checkpoint import State
        from vascval.imaging.kept import kept

        if cast.skeleton is not None:
            self._parts[_CAST] = State(*kept(cast.skeleton))

    def go_on(self, name: str, run: Run) -> None:
        """From now on that tree is at work; it goes on from where it was, if it was begun.

        :raises InputError: when what is kept of it is not sound.
        """
        self._look()
        if name in self._parts:
            run.restore(self._parts[name])
        self._at_work = (name, run)

    def _look(self) -> None:
        if self._at_work is not None:
            name, run = self._at_work
            if run.growth.begun:
                self._parts[name] = run.state()
