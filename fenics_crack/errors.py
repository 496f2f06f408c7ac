"""The two ways in which the package refuses: bad input, and a solver that did not converge."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["ConvergenceError", "InputError"]


class InputError(ValueError):
    """A value that cannot be used: names the key, the value and what is allowed.

    Attributes
    ----------
    key : str
        What was given, in the words of the scene file or of the argument list.
    value : object
        The value found there.
    allowed : str
        What may stand there.
    """

    def __init__(self, key: str, value: object, allowed: str) -> None:
        super().__init__(key, value, allowed)
        self.key = key
        self.value = value
        self.allowed = allowed

    def __str__(self) -> str:
        return f"{self.key} = {self.value!r}: must be {self.allowed}"


class ConvergenceError(RuntimeError):
    """A solver stopped before its tolerance was met.

    Attributes
    ----------
    history : tuple of float
        The residual norms of every attempt, in order.
    """

    def __init__(self, message: str, history: Sequence[float] = ()) -> None:
        super().__init__(message)
        self.history = tuple(history)
