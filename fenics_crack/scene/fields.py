"""What a key of a scene may hold, and the tables that check it.

A :class:`Table` is a frozen dataclass whose fields are made by the functions below: each states
once what is allowed. How a value is read follows from the field's type.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields
from numbers import Integral, Real
from typing import Any

import numpy as np

from fenics_crack.errors import InputError

__all__ = ["OR_ZERO", "Axis", "Table", "Vector", "at_least_one", "choice", "holds", "positive"]

Vector = tuple[float, float]
SMALLEST, LARGEST = 1e-30, 1e30
"""Magnitudes allowed in a scene: their products and squares neither overflow nor underflow."""
SIZES = f"{SMALLEST:g} to {LARGEST:g}"
OR_ZERO = f"(0, or of size {SIZES})"
MAX_VALUES = 1_000_000
"""Values of one axis, at most."""


@dataclass(frozen=True)
class Axis:
    """One quantity of a sweep.

    Attributes
    ----------
    key : str
        A key of the scene, for example "crack.length".
    values : tuple
        In order.
    """

    key: str
    values: tuple[Any, ...]


# --- how a value is read --------------------------------------------------------------------------


def _bool(value: object) -> bool:
    if not isinstance(value, bool):
        raise TypeError
    return value


def _float(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
        raise TypeError
    number = float(value)
    if value != 0 and not SMALLEST <= abs(number) <= LARGEST:
        raise OverflowError
    return number


def _int(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise TypeError
    number = int(value)
    if abs(number) >= 2**31:  # gmsh and PETSc count with 32 bits
        raise OverflowError
    return number


def _str(value: object) -> str:
    """A string that can be written as UTF-8."""
    if not isinstance(value, str) or any("\ud800" <= c <= "\udfff" for c in value):
        raise TypeError
    return value


def _vector(value: object) -> Vector:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise TypeError
    return _float(value[0]), _float(value[1])


def _one_or_more(value: object) -> float | tuple[float, ...]:
    if not isinstance(value, list | tuple):
        return _float(value)
    if not value:
        raise TypeError
    return tuple(map(_float, value))


def _axes(value: object) -> tuple[Axis, ...]:
    """Axes of a mapping from keys to a list, or to start, stop, count and spacing."""
    if isinstance(value, tuple) and all(isinstance(axis, Axis) for axis in value):
        return value
    if not isinstance(value, Mapping):
        raise TypeError
    return tuple(Axis(str(name), _values(str(name), given)) for name, given in value.items())


def _values(name: str, given: object) -> tuple[Any, ...]:
    if isinstance(given, list | tuple) and given:
        return tuple(given)
    span = given if isinstance(given, Mapping) else {}
    spacing = span.get("spacing", "linear")
    try:
        start, stop, count = _float(span["start"]), _float(span["stop"]), _int(span["count"])
        right = span.keys() <= {"start", "stop", "count", "spacing"} and 2 <= count <= MAX_VALUES
    except (KeyError, TypeError, OverflowError):
        right = False
    full_name = f'sweep.over."{name}"'
    if not right or spacing not in ("linear", "logarithmic"):
        allowed = (
            "a list of values, or a table of start, stop, count (>= 2) and, if wanted, "
            "spacing = 'linear' or 'logarithmic'"
        )
        raise InputError(full_name, given, allowed)
    if spacing == "linear":
        return tuple(map(float, np.linspace(start, stop, count)))
    if start * stop <= 0.0:
        raise InputError(full_name, given, "of one sign from start to stop with that spacing")
    return tuple(map(float, np.sign(start) * np.geomspace(abs(start), abs(stop), count)))


_READERS: dict[str, Callable[[object], Any]] = {
    "bool": _bool,
    "float": _float,
    "int": _int,
    "str": _str,
    "Vector": _vector,
    "float | tuple[float, ...]": _one_or_more,
    "int | str": lambda value: value if value == "all" else _int(value),
    "tuple[Axis, ...]": _axes,
}
"""By the type of a field that is not None."""

# --- what a key may hold --------------------------------------------------------------------------


def holds(
    allowed: str, accepts: Callable[[Any], bool] = lambda value: True, default: Any = MISSING
) -> Any:
    """Field of values for which ``accepts`` is true, ``allowed`` in words."""
    return field(default=default, metadata={"allowed": allowed, "accepts": accepts})


def positive(default: Any = MISSING) -> Any:
    """Field of a number > 0."""
    return holds(f"a finite number > 0 ({SIZES})", lambda value: value > 0, default)


def at_least_one(default: Any = MISSING) -> Any:
    """Field of a whole number >= 1."""
    return holds("a whole number >= 1", lambda value: value >= 1, default)


def choice(*words: str, default: Any = MISSING) -> Any:
    """Field of one of some words."""
    return holds("one of " + ", ".join(map(repr, words)), lambda v: v in words, default)


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
        """A value as a key holds it; raises InputError if the key may not hold it."""
        item = cls.keys()[key]
        try:
            found = _READERS[str(item.type).removesuffix(" | None")](value)
            accepted = item.metadata["accepts"](found)
        except (TypeError, OverflowError):
            accepted = False
        if not accepted:
            raise InputError(cls.name_of(key), value, item.metadata["allowed"])
        return found

    @classmethod
    def keys(cls) -> dict[str, Field[Any]]:
        """The keys of the table."""
        return {item.name: item for item in fields(cls)}  # type: ignore[arg-type]

    @classmethod
    def name_of(cls, key: str = "") -> str:
        """A key as it stands in a scene file: ``harmonic_balance.samples``; or the table alone."""
        table = "".join("_" + c.lower() if c.isupper() else c for c in cls.__name__).lstrip("_")
        return f"{table}.{key}" if key else table

    def as_toml(self) -> str:
        """The table as it would stand in a file; what has its default is left out."""
        lines, after = [f"[{self.name_of()}]"], []
        for name, item in self.keys().items():
            value = getattr(self, name)
            if isinstance(value, tuple) and value and isinstance(value[0], Axis):
                after = ["", f"[{self.name_of(name)}]"]
                after += [f"{_as_toml(a.key)} = {_as_toml(a.values)}" for a in value]
            elif value != item.default:
                lines.append(f"{name} = {_as_toml(value)}")
        return "\n".join([*lines, *after, ""])

    def require(self, condition: bool, key: str, allowed: str) -> None:
        """Raise InputError for a key unless a condition holds."""
        if not condition:
            raise InputError(self.name_of(key), getattr(self, key), allowed)

    def given(self, key: str, allowed: str) -> Any:
        """The value of a key that may not be left out."""
        self.require(getattr(self, key) is not None, key, allowed)
        return getattr(self, key)

    def leave_out(self, keys: Iterable[str], why: str) -> None:
        """Raise InputError if one of the keys is given."""
        for key in keys:
            self.require(getattr(self, key) is None, key, f"left out with {why}")

    @classmethod
    def from_mapping(cls, values: object) -> Any:
        """Make the table from the mapping read in a file."""
        known = cls.keys()
        keys = ", ".join(known)
        if not isinstance(values, Mapping):
            raise InputError(cls.name_of(), values, f"a table with the keys {keys}")
        for key, value in values.items():
            if key not in known:
                raise InputError(cls.name_of(key), value, f"left out; known keys: {keys}")
        for key, item in known.items():
            if item.default is MISSING and key not in values:
                raise InputError(cls.name_of(key), None, f"given: {item.metadata['allowed']}")
        return cls(**values)
