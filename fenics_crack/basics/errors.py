"""The errors of the package, for bad input and for a solver that did not converge; and checks."""

from __future__ import annotations

import contextlib
import math
import pickle
import re
from collections.abc import Iterable, Iterator, Sequence
from enum import IntEnum
from numbers import Integral, Real
from typing import Any

N_LOWEST_MODES = 6
"""Lowest modes whose frequencies, crack open and bonded, are computed."""
MAX_SAMPLES_PER_PERIOD = 2**20
"""Samples of a period at which the contact force may be evaluated."""
N_RECORDED_PERIODS = 4
"""Periods of a time integration that commands keep, and from which its extremes are."""
MAX_HARMONIC_ORDER = 100
"""Maximum order of a scene's load, each of which takes two rows as long as the displacement, and
maximum to which harmonics are raised for a curve or from case to case."""
MAX_CASES = 10**6
"""Maximum values of an axis of a sweep, speeds of a diagram, and patterns of mistuning: with a
second for each, 12 days."""
DEFAULT_ERROR_TOLERANCE = 1e-2
"""Default relative error: that of modes and harmonics is then below what meshes usually leave."""


class Exit(IntEnum):
    """Exit codes of the program; ``--help`` and docs/program.md explain them."""

    DONE = 0
    FAULT = 1
    BAD_INPUT = 2
    NOT_CONVERGED = 3
    MISSED = 4
    STOPPED = 130
    READER_GONE = 141


class InputError(ValueError):
    """A value that cannot be used: names the key, the value and what is allowed, in one line.

    Attributes
    ----------
    key : str
        Name of the value, in the words of the scene file or of the argument list.
    value : object
        The value found there.
    allowed : str
        Description of the allowed values.
    others : tuple of InputError
        Errors of further keys of the same scene.
    example : str or None
        Lines for the scene's file, of a missing table; None: those of a new scene.
    """

    others: tuple[InputError, ...] = ()
    example: str | None = None

    def __init__(self, key: str, value: object, allowed: str) -> None:
        super().__init__(key, value, allowed)
        self.key, self.value, self.allowed = key, value, allowed

    def __reduce__(self) -> tuple[Any, ...]:
        """For other ranks: what cannot be sent, such as a nest too deep, goes as words."""
        try:
            pickle.dumps(value := self.value)
        except Exception:
            value = f"({type(self.value).__name__} that cannot be shown)"
        return type(self), (self.key, value, self.allowed)

    def __str__(self) -> str:
        key = self.key if self.key.isprintable() else repr(self.key)
        try:
            value = repr(self.value)
        except (ValueError, RecursionError):  # a number of thousands of digits, or such a nest
            value = f"({type(self.value).__name__} too long to be shown)"
        key, value = (re.sub("(?s)(.{1000}).+", r"\1...", text) for text in (key, value))
        given = f"{key} is missing" if self.value is None else f"{key} = {value}"
        text = f"{given}: must be {self.allowed}".replace("must be left out", "not allowed")
        return text if text.isprintable() else " ".join(text.split())


class WriteError(InputError):
    """A file that cannot be written though its name can be used, mostly for a full disk."""


class ConvergenceError(RuntimeError):
    """A solver stopped before its tolerance was met.

    Attributes
    ----------
    history : tuple of float
        The residual norms of every attempt, in order.
    found : object
        Result so far, such as a curve that is not complete; else None.
    """

    def __init__(self, message: str, history: Sequence[float] = (), found: object = None) -> None:
        super().__init__(message)
        self.history, self.found = tuple(history), found


class StoppedError(ConvergenceError):
    """Ctrl-C has ended what the same command goes on with."""


INTERRUPTED_STATUS = "interrupted"
"""Status of a curve that Ctrl-C has ended."""


@contextlib.contextmanager
def report_read_errors(key: str, path: object, allowed: str) -> Iterator[None]:
    """Read a file; whatever goes wrong with it is an InputError, which the cause stays with."""
    try:
        yield
    except InputError:
        raise
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(key, str(path), f"a readable file ({reason})") from error
    except Exception as error:  # of whatever reads it
        reason = next(iter(str(error).splitlines()), "") or type(error).__name__
        raise InputError(key, str(path), f"{allowed} ({reason})") from error


def check_number(key: str, value: object, least: float = -math.inf, *, above: bool = False) -> None:
    """Raise InputError unless a value is a finite number >= ``least`` (or > with ``above``)."""
    number = math.nan
    if isinstance(value, Real) and not isinstance(value, bool):
        with contextlib.suppress(OverflowError):
            number = float(value)
    if math.isfinite(number) and (number > least or (number == least and not above)):
        return
    bound = f" {'>' if above else '>='} {least:g}" if math.isfinite(least) else ""
    raise InputError(key, value, f"a finite number{bound}")


def check_omega(value: object, key: str = "omega") -> None:
    """Raise InputError unless a value can be an angular frequency."""
    check_number(key, value, 0.0, above=True)


def check_count(key: str, value: object, least: int, most: int = 10**9) -> None:
    """Raise InputError unless a value is a whole number between two."""
    if isinstance(value, bool) or not isinstance(value, Integral) or int(value) < least:
        raise InputError(key, value, f"a whole number >= {least}")
    if int(value) > most:
        raise InputError(key, value, f"at most {most:g}")


def describe_choices(words: Iterable[str]) -> str:
    """Return the text "one of" with the allowed words."""
    return "one of " + ", ".join(map(repr, words))


def check_choice(key: str, value: object, words: Iterable[str]) -> None:
    """Raise InputError unless a value is one of some words."""
    if not isinstance(value, str) or value not in words:
        raise InputError(key, value, describe_choices(words))


def check_damping_ratios(key: str, ratios: Sequence[float], omegas: Sequence[float]) -> None:
    """Raise InputError unless Rayleigh damping can have two ratios at two frequencies [rad/s].

    Both coefficients are >= 0 where the ratios of damping differ by no larger factor than the
    frequencies; to rounding, as one coefficient may be 0.
    """
    (low, at_low), (high, at_high) = sorted(zip(omegas, ratios, strict=True))
    least, most = at_low * (low / high), at_low * (high / low)
    if not least * (1.0 - 1e-15) <= at_high <= most * (1.0 + 1e-15):
        allowed = f"such that no coefficient is negative: with {at_low:g} at {low:g} rad/s,"
        allowed += f" from {least:g} to {most:g} at {high:g} rad/s"
        raise InputError(key, tuple(ratios), allowed)
