"""Signals that ask a long run to end: held back until it is at a step, and told from faults of kernels."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any


class Held:
    """A signal that came and waits."""

    def __init__(self) -> None:
        self._waiting: Callable[[], object] | None = None

    def release(self) -> None:
        """Let the signal do now what it would have done then, if one came."""
        if self._waiting is not None:
            self._waiting()

    def wait(self, action: Callable[[], object]) -> bool:
        """Hold this one back, unless another is waiting already."""
        free = self._waiting is None
        self._waiting = self._waiting or action
        return free


@contextmanager
def held_back(unless: Callable[[], bool]) -> Iterator[Held]:
    """Ctrl-C and SIGTERM wait for :meth:`Held.release`; a second one, and any while ``unless()`` is true, does not.

    Signals that are ignored, or end the process without notice, are left as they are.
    """
    held = Held()
    previous: dict[int, Any] = {}

    def hold(number: int, frame: FrameType | None) -> None:
        def action() -> object:
            return previous[number](number, frame)

        if unless() or not held.wait(action):
            action()

    if threading.current_thread() is threading.main_thread():
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)
            if number is not None and callable(signal.getsignal(number)):
                previous[number] = signal.getsignal(number)
                signal.signal(number, hold)
    try:
        yield held
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def interruption_behind(error: SystemError) -> KeyboardInterrupt | None:
    """The signal that is the cause of an error, if one is: it may come while compiled code calls Python, which can say
    no more than that there was an exception."""
    cause: BaseException | None = error
    while cause is not None and not isinstance(cause, KeyboardInterrupt):
        cause = cause.__cause__
    return cause
