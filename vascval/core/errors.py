"""The errors of vascval. A message says what is wrong, where, and what to do about it."""

from __future__ import annotations

_LONGEST = 1000


class VascvalError(Exception):
    """Base of every error raised on purpose; ``exit_code`` is what the command line ends with.

    Its text is one printable line (see :func:`printable`), whatever pieces of a foreign file the message quotes.
    """

    exit_code = 1

    def __init__(self, message: str = "") -> None:
        super().__init__(printable(message))


class InputError(VascvalError):
    """The input or a parameter is wrong: the user can mend it."""

    exit_code = 2


class ComputationError(VascvalError):
    """A computation failed honestly: it did not converge, or the problem has no solution."""

    exit_code = 1


def printable(text: str) -> str:
    """``text`` as one line that a terminal shows as it stands: line ends and control characters escaped, and what is
    longer than 1,000 characters cut in the middle."""
    if not text.isprintable():
        text = "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 305]} ... {text[-300:]}"
