"""The errors of vascval. A message says what is wrong, where, and what to do about it."""

from __future__ import annotations


class VascvalError(Exception):
    """Base of every error raised on purpose; ``exit_code`` is what the command line ends with."""

    exit_code = 1


class InputError(VascvalError):
    """The input or a parameter is wrong: the user can mend it."""

    exit_code = 2


class ComputationError(VascvalError):
    """A computation failed honestly: it did not converge, or the problem has no solution."""

    exit_code = 1
