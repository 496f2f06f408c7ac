"""Define the errors of the package, checks of values, and limits of input."""

from __future__ import annotations

import contextlib
import errno
import math
import pickle
import re
from collections.abc import Iterable, Iterator, Sequence
from enum import IntEnum
from numbers import Integral, Real
from typing import Any

N_NATURAL_MODES_PER_CRACK_STATE = 6
"""Number of natural frequencies that are computed for the open and for the bonded crack."""
MAX_CONTACT_SAMPLES_PER_PERIOD = 2**20
"""Maximum instants of a period at which the contact force may be evaluated."""
N_RECORDED_PERIODS_OF_INTEGRATION = 4
"""Number of final periods in a time integration that commands record; extremes come from them."""
MAX_HARMONIC_ORDER = 100
"""Maximum order of a load's harmonics, and maximum when a curve or a case adds harmonics.

A load has two rows for each order, each as long as the displacement.
"""
MAX_VALUES_OF_AXIS = 10**6
"""Maximum number of values on a sweep's axis, speeds of a diagram, or patterns of mistuning.

At one second a case, a computation takes 12 days.
"""
DEFAULT_ERROR_TOLERANCE = 1e-2
"""Default of the tolerated relative error.

Errors of modes and harmonics are then below most mesh errors.
"""
DISK_FULL_ERROR_NUMBERS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}
"""Numbers of errors of the disk, mostly a full one; all further errors come from the path."""


class Exit(IntEnum):
    """Exit codes of the program.

    DONE: success. PROGRAM_OR_DISK_FAULT: an error in the program or of the disk. BAD_INPUT: an
    InputError. NOT_CONVERGED: a result has not converged. TOLERANCE_MISSED: the error is unknown or
    above the tolerance. STOPPED_BY_CTRL_C: Ctrl-C. PIPE_READER_GONE: the reader of a pipe has
    ended. ``--help`` and docs/program.md explain them.
    """

    DONE = 0
    PROGRAM_OR_DISK_FAULT = 1
    BAD_INPUT = 2
    NOT_CONVERGED = 3
    TOLERANCE_MISSED = 4
    STOPPED_BY_CTRL_C = 130
    PIPE_READER_GONE = 141


class InputError(ValueError):
    """A value that cannot be used: one line with key, value and allowed values.

    The line is "key = value: must be ...", or "key is missing: must be ...".

    Attributes
    ----------
    key : str
        Name of the value: a key of the scene file, or an argument.
    value : object
        The value of this key; None if it is missing.
    allowed : str
        Description of the allowed values, printed after "must be". Two beginnings are printed
        differently. "must be left out with ..." becomes "not allowed with ...", and "must be given:
        a number" becomes "give a number".
    others : tuple of InputError
        Errors of further keys in the same scene.
    example : str or None
        Example lines for the scene's file, if a table is missing. None: lines from the template for
        new scenes.
    """

    others: tuple[InputError, ...] = ()
    example: str | None = None

    def __init__(self, key: str, value: object, allowed: str) -> None:
        super().__init__(key, value, allowed)
        self.key, self.value, self.allowed = key, value, allowed

    def __reduce__(self) -> tuple[Any, ...]:
        """Prepare the error to be sent to other ranks by ``pickle``.

        A value that cannot be pickled becomes a text.
        """
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
        key_and_value_text = f"{key} is missing" if self.value is None else f"{key} = {value}"
        text = f"{key_and_value_text}: must be {self.allowed}"
        text = text.replace("must be left out", "not allowed").replace("must be given: ", "give ")
        return text if text.isprintable() else " ".join(text.split())


class WriteError(InputError):
    """Error for a file that cannot be written to a usable path, mostly due to a full disk."""


class ConvergenceError(RuntimeError):
    """A solver stopped before the tolerance was met.

    Attributes
    ----------
    history : tuple of float
        The residual norms of all attempts, in order.
    found : object
        Result so far, such as an incomplete curve; None without a result.
    """

    def __init__(self, message: str, history: Sequence[float] = (), found: object = None) -> None:
        super().__init__(message)
        self.history, self.found = tuple(history), found


class StoppedError(ConvergenceError):
    """Error after Ctrl-C has stopped a computation; the same command continues the computation."""


INTERRUPTED_CURVE_STATUS = "interrupted"
"""Status of a curve that Ctrl-C ended early."""


@contextlib.contextmanager
def report_read_errors(key: str, path: object, requirement_text: str) -> Iterator[None]:
    """Turn any error of reading a file in the block into an InputError.

    Parameters
    ----------
    key, path
        Name of the option or argument with the file, and the file.
    requirement_text : str
        Description of an allowed file, for the error.
    """
    try:
        yield
    except InputError:
        raise
    except OSError as error:
        reason_text = error.strerror or str(error)
        raise InputError(key, str(path), f"a readable file ({reason_text})") from error
    except Exception as error:  # of whatever reads it
        reason_text = next(iter(str(error).splitlines()), "") or type(error).__name__
        raise InputError(key, str(path), f"{requirement_text} ({reason_text})") from error


def check_number(
    key: str, value: object, lower_bound: float = -math.inf, *, excludes_bound: bool = False
) -> None:
    """Raise InputError unless a value is a finite number >= ``lower_bound``.

    With ``excludes_bound`` the value must be > ``lower_bound``. ``key`` names the value in the
    error.
    """
    number = math.nan
    if isinstance(value, Real) and not isinstance(value, bool):
        with contextlib.suppress(OverflowError):
            number = float(value)
    if math.isfinite(number) and (
        number > lower_bound or (number == lower_bound and not excludes_bound)
    ):
        return
    bound_text = (
        f" {'>' if excludes_bound else '>='} {lower_bound:g}" if math.isfinite(lower_bound) else ""
    )
    raise InputError(key, value, f"a finite number{bound_text}")


MAX_OMEGA = 1e30
"""Largest angular frequency [rad/s], whose powers are finite."""


def check_omega(value: object, key: str = "omega") -> None:
    """Raise InputError unless a value is an angular frequency > 0, at most 1e30 [rad/s]."""
    check_number(key, value, 0.0, excludes_bound=True)
    if value > MAX_OMEGA:  # type: ignore[operator]
        raise InputError(key, value, f"at most {MAX_OMEGA:g} rad/s")


def check_count(key: str, value: object, lower_bound: int, upper_bound: int = 10**9) -> None:
    """Raise InputError unless a value is a whole number between two bounds, both allowed."""
    if isinstance(value, bool) or not isinstance(value, Integral) or int(value) < lower_bound:
        raise InputError(key, value, f"a whole number >= {lower_bound}")
    if int(value) > upper_bound:
        raise InputError(key, value, f"at most {upper_bound:g}")


def describe_choices(choices: Iterable[str]) -> str:
    """Return the allowed words as text: "one of 'a', 'b'"."""
    return "one of " + ", ".join(map(repr, choices))


def check_choice(key: str, value: object, choices: Iterable[str]) -> None:
    """Raise InputError unless a value is one of the allowed words."""
    if not isinstance(value, str) or value not in choices:
        raise InputError(key, value, describe_choices(choices))


def check_rayleigh_damping_ratios(
    key: str, damping_ratios: Sequence[float], omegas: Sequence[float]
) -> None:
    """Raise InputError unless Rayleigh damping can have two ratios at two frequencies [rad/s].

    Rayleigh damping has a coefficient for the mass and a coefficient for the stiffness; both must
    be >= 0. This holds if the higher damping ratio over the lower is at most the higher frequency
    over the lower. A relative excess up to 1e-15 is allowed.

    Parameters
    ----------
    key : str
        Name of the damping ratios, for the error.
    damping_ratios, omegas : two floats each
        Damping ratios, and the frequencies [rad/s] in the same order.
    """
    (low_omega, ratio_at_low_omega), (high_omega, ratio_at_high_omega) = sorted(
        zip(omegas, damping_ratios, strict=True)
    )
    min_ratio_at_high_omega = ratio_at_low_omega * (low_omega / high_omega)
    max_ratio_at_high_omega = ratio_at_low_omega * (high_omega / low_omega)
    if (
        not min_ratio_at_high_omega * (1.0 - 1e-15)
        <= ratio_at_high_omega
        <= max_ratio_at_high_omega * (1.0 + 1e-15)
    ):
        requirement_text = (
            "ratios with which both Rayleigh coefficients are >= 0: for "
            f"{ratio_at_low_omega:g} at {low_omega:g} rad/s, a ratio from "
            f"{min_ratio_at_high_omega:g} to "
            f"{max_ratio_at_high_omega:g} at {high_omega:g} rad/s"
        )
        raise InputError(key, tuple(damping_ratios), requirement_text)
