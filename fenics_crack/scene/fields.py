"""What a key of a scene may hold, and the tables that check it.

A :class:`Table` is a frozen dataclass whose fields are made by the functions below: each states
once how its value is read and what is allowed.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields
from numbers import Integral, Real
from typing import Any

import numpy as np

from fenics_crack.errors import InputError

__all__ = [
    "OR_ZERO",
    "Axis",
    "Table",
    "Vector",
    "at_least_one",
    "axes",
    "boolean",
    "choice",
    "count_or_all",
    "holds",
    "integer",
    "positive",
    "ratio",
    "real",
    "text",
    "vector",
]

Vector = tuple[float, float]
SMALLEST, LARGEST = 1e-30, 1e30
"""Magnitudes allowed in a scene: their products and squares neither overflow nor underflow."""
SIZES = f"{SMALLEST:g} to {LARGEST:g}"
OR_ZERO = f"(0, or of size {SIZES})"


# --- what a key may hold --------------------------------------------------------------------------


def boolean(value: object) -> bool:
    """true or false."""
    if not isinstance(value, bool):
        raise TypeError
    return value


def real(value: object) -> float:
    """A number, zero or of an allowed magnitude."""
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
        raise TypeError
    number = float(value)
    if value != 0 and not SMALLEST <= abs(number) <= LARGEST:
        raise OverflowError
    return number


def integer(value: object) -> int:
    """A whole number of at most 32 bits."""
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise TypeError
    number = int(value)
    if abs(number) >= 2**31:  # gmsh and PETSc count with 32 bits
        raise OverflowError
    return number


def text(value: object) -> str:
    """A string that can be written as UTF-8."""
    if not isinstance(value, str) or any("\ud800" <= c <= "\udfff" for c in value):
        raise TypeError
    return value


def vector(value: object) -> Vector:
    """Two numbers."""
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise TypeError
    return real(value[0]), real(value[1])


def ratio(value: object) -> float | tuple[float, ...]:
    """A number, or a list of them."""
    return tuple(map(real, value)) if isinstance(value, list | tuple) else real(value)


def count_or_all(value: object) -> int | str:
    """A whole number or 'all'."""
    return value if value == "all" else integer(value)  # type: ignore[return-value]


@dataclass(frozen=True)
class Axis:
    """One quantity of a sweep.

    Attributes
    ----------
    key : str
        Of the scene, for example "crack.length".
    values : tuple
        What it takes, in order.
    """

    key: str
    values: tuple[Any, ...]


MOST_VALUES = 1_000_000
"""Values of one axis, at most."""


def axes(value: object) -> tuple[Axis, ...]:
    """Axes of a mapping from keys to a list, or to start, stop, count and spacing."""
    if isinstance(value, tuple) and all(isinstance(axis, Axis) for axis in value):
        return value
    if not isinstance(value, Mapping):
        raise TypeError
    return tuple(Axis(str(name), _values(str(name), given)) for name, given in value.items())


def _values(name: str, given: object) -> tuple[Any, ...]:
    allowed = (
        "a list of values, or a table of start, stop, count (>= 2) and, if wanted, "
        "spacing = 'linear' or 'logarithmic'"
    )
    full_name = f'sweep.over."{name}"'
    if isinstance(given, list | tuple) and given:
        return tuple(given)
    if not isinstance(given, Mapping) or not {"start", "stop", "count"} <= set(given):
        raise InputError(full_name, given, allowed)
    try:
        start, stop, count = real(given["start"]), real(given["stop"]), integer(given["count"])
    except (TypeError, OverflowError):
        raise InputError(full_name, given, allowed) from None
    spacing = given.get("spacing", "linear")
    known = set(given) <= {"start", "stop", "count", "spacing"}
    if not known or spacing not in ("linear", "logarithmic") or not 2 <= count <= MOST_VALUES:
        raise InputError(full_name, given, allowed)
    if spacing == "linear":
        return tuple(map(float, np.linspace(start, stop, count)))
    if start * stop <= 0.0:
        raise InputError(full_name, given, "of one sign from start to stop with that spacing")
    return tuple(map(float, np.sign(start) * np.geomspace(abs(start), abs(stop), count)))


def holds(
    convert: Callable[[object], Any],
    allowed: str,
    accepts: Callable[[Any], bool] = lambda value: True,
    default: Any = MISSING,
) -> Any:
    """Field that holds what ``convert`` makes of a value for which ``accepts`` is true."""
    return field(
        default=default, metadata={"convert": convert, "allowed": allowed, "accepts": accepts}
    )


def positive(default: Any = MISSING) -> Any:
    """Field of a number > 0."""
    return holds(real, f"a finite number > 0 ({SIZES})", lambda value: value > 0, default)


def at_least_one(default: Any = MISSING) -> Any:
    """Field of a whole number >= 1."""
    return holds(integer, "a whole number >= 1", lambda value: value >= 1, default)


def choice(*words: str, default: Any = MISSING) -> Any:
    """Field of one of some words."""
    return holds(text, "one of " + ", ".join(map(repr, words)), lambda v: v in words, default)


def _as_toml(value: object) -> str:
    """A value as TOML, which is JSON but for DEL."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


class Table:
    """A table of the scene: checks each of its keys when it is made."""

    def __post_init__(self) -> None:
        for name, item in self.keys().items():
            value = getattr(self, name)
            if value is not None or item.default is not None:
                object.__setattr__(self, name, self.checked(name, value))

    @classmethod
    def checked(cls, key: str, value: object) -> Any:
        """What a key holds when it is given a value.

        Raises
        ------
        InputError
            It may not hold that.
        """
        rule = cls.keys()[key].metadata
        try:
            converted = rule["convert"](value)
        except (TypeError, OverflowError):
            raise InputError(cls.name_of(key), value, rule["allowed"]) from None
        if not rule["accepts"](converted):
            raise InputError(cls.name_of(key), value, rule["allowed"])
        return converted

    @classmethod
    def keys(cls) -> dict[str, Field[Any]]:
        """The keys of the table."""
        return {item.name: item for item in fields(cls)}  # type: ignore[arg-type]

    @classmethod
    def name_of(cls, key: str) -> str:
        """The key as it stands in a scene file: ``[harmonic_balance] samples``."""
        table = "".join("_" + c.lower() if c.isupper() else c for c in cls.__name__).lstrip("_")
        return f"{table}.{key}"

    def as_toml(self) -> str:
        """The table as it would stand in a file; what has its default is left out."""
        lines, after = [f"[{self.name_of('').rstrip('.')}]"], []
        for name, item in self.keys().items():
            value = getattr(self, name)
            if isinstance(value, tuple) and value and isinstance(value[0], Axis):
                after = ["", f"[{self.name_of(name)}]"]
                after += [f"{_as_toml(a.key)} = {_as_toml(a.values)}" for a in value]
            elif value != item.default:
                lines.append(f"{name} = {_as_toml(value)}")
        return "\n".join([*lines, *after, ""])

    def require(self, condition: bool, key: str, allowed: str) -> None:
        if not condition:
            raise InputError(self.name_of(key), getattr(self, key), allowed)

    @classmethod
    def from_mapping(cls, values: object) -> Any:
        """Make the table from the mapping read in a file."""
        table = cls.name_of("").rstrip(".")
        known = cls.keys()
        if not isinstance(values, Mapping):
            raise InputError(table, values, f"a table with the keys {', '.join(known)}")
        for key, value in values.items():
            if key not in known:
                raise InputError(
                    cls.name_of(key), value, f"left out; known keys: {', '.join(known)}"
                )
        for key, item in known.items():
            if item.default is MISSING and key not in values:
                raise InputError(cls.name_of(key), None, f"given: {item.metadata['allowed']}")
        return cls(**values)
