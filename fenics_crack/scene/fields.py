"""Keys of a scene, their allowed values, and the tables that check them.

A :class:`Table` is a frozen dataclass whose fields are made by the functions below: each states
once what is allowed. How a value is read follows from the field's type.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from copy import copy
from dataclasses import MISSING, Field, dataclass, field, fields
from functools import partial
from numbers import Integral, Real
from typing import Any, ClassVar, Self

import numpy as np

from fenics_crack.basics.errors import MAX_CASES, MAX_HARMONIC_ORDER, InputError, describe_choices
from fenics_crack.basics.suggestions import (
    did_you_mean_text,
    find_similar_names,
    format_scene_value,
    yield_candidate_values,
)
from fenics_crack.basics.tables import RAD_PER_TURN

Pair = tuple[float, float]
Vector = tuple[float, ...]
"""In a plane two numbers, in space three."""
SMALLEST, LARGEST = 1e-30, 1e30
"""Magnitudes allowed in a scene: their products and squares neither overflow nor underflow."""
SIZES = f"{SMALLEST:g} to {LARGEST:g}"
OR_ZERO = f"(0, or of size {SIZES})"


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

    def as_toml(self) -> str:
        """As a line of a file."""
        return f"{_as_toml(self.key)} = {_as_toml(self.values)}"


class Point(Axis):
    """A named point: its key is the name, its values are x and y, of a solid z too [m]."""


class Face(Axis):
    """A named face of a part: its key is the name, its values are points (x, y, z) on it [m]."""


class MeshFile(Axis):
    """A mesh with the numbers that it has: its key is the file, its values are names and numbers,
    ``("crack.length", 0.005)``."""

    def as_toml(self) -> str:
        """As a line of a file."""
        pairs = ", ".join(f"{_as_toml(name)} = {_as_toml(value)}" for name, value in self.values)
        return f"{_as_toml(self.key)} = {{ {pairs} }}"


@dataclass(frozen=True)
class Harmonic:
    """A harmonic of a periodic load, cos cos(k omega t) + sin sin(k omega t).

    Attributes
    ----------
    order : int
        k.
    cos, sin : tuple of float
        Components; one number of a pressure.
    """

    order: int
    cos: tuple[float, ...]
    sin: tuple[float, ...]


# --- how a value is read --------------------------------------------------------------------------


def _of(kind: Any, value: object) -> Any:
    """The value, if it is of a kind."""
    if not isinstance(value, kind):
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
        raise InputError("", value, "a whole number below 2^31 = 2147483648")
    return number


def _str(value: object) -> str:
    """A string that can be written as UTF-8."""
    if not isinstance(value, str) or any("\ud800" <= c <= "\udfff" for c in value):
        raise TypeError
    return value


def _floats(value: object) -> tuple[float, ...]:
    return tuple(map(_float, _of(list | tuple, value)))


def _vector(value: object, lengths: tuple[int, ...] = (2, 3)) -> Vector:
    """In a plane or in space: of which of them a scene is, it says itself."""
    if len(_of(list | tuple, value)) not in lengths:
        raise TypeError
    return _floats(value)


def _in_space(value: object) -> Vector:
    return _vector(value, (3,))


def _one_or_more(value: object) -> float | tuple[float, ...]:
    if not isinstance(value, list | tuple):
        return _float(value)
    if not value:
        raise TypeError
    return _floats(value)


def _axes(
    kind: type[Axis], values: Callable[[str, object], tuple[Any, ...]]
) -> Callable[[object], tuple[Axis, ...]]:
    """Reader of axes, or what else is a name with its values, from a mapping."""

    def read(value: object) -> tuple[Axis, ...]:
        if isinstance(value, tuple) and all(isinstance(one, kind) for one in value):
            return value
        pairs = _of(Mapping, value).items()
        return tuple(kind(_str(name), values(name, given)) for name, given in pairs)

    return read


def _numbers_of_mesh(file: str, given: object) -> tuple[tuple[str, float], ...]:
    return tuple((_str(name), _float(number)) for name, number in _of(Mapping, given).items())


def _harmonics(value: object) -> tuple[Harmonic, ...]:
    """Harmonics of different orders, each by its cosine and sine or by amplitude and phase."""
    given = _of(list | tuple, value)
    harmonics = tuple(one if isinstance(one, Harmonic) else _harmonic(one) for one in given)
    _different([one.order for one in harmonics])
    return harmonics


def _harmonic(given: object) -> Harmonic:
    if not isinstance(given, Mapping) or "order" not in given:
        raise TypeError
    order, keys = _int(given["order"]), given.keys() - {"order"}
    if not 1 <= order <= MAX_HARMONIC_ORDER or not keys:
        raise TypeError
    if keys <= {"cos", "sin"}:
        parts = {key: _components(given[key]) for key in keys}
        zero, *others = {(0.0,) * len(part) for part in parts.values()}
        if others:
            raise TypeError
        return Harmonic(order, parts.get("cos", zero), parts.get("sin", zero))
    if "amplitude" not in keys or not keys <= {"amplitude", "phase"}:
        raise TypeError
    lag = math.radians(_float(given.get("phase", 0.0)))
    size = _components(given["amplitude"])
    return Harmonic(order, scaled(size, math.cos(lag)), scaled(size, math.sin(lag)))


def _components(value: object) -> tuple[float, ...]:
    """A vector, or the one number of a pressure."""
    return _vector(value if isinstance(value, list | tuple) else [value], (1, 2, 3))


def _ints(value: object) -> tuple[int, ...]:
    """A whole number, or a list of different ones."""
    return tuple(map(_int, _different(value if isinstance(value, list | tuple) else [value])))


def _different(values: Any) -> Any:
    """Refuse values of which two are the same."""
    if len(set(values)) != len(values):
        raise TypeError
    return values


def _values(name: str, given: object) -> tuple[Any, ...]:
    """A list of them, or those from start to stop, by count and spacing."""
    if isinstance(given, list | tuple) and given:
        return tuple(given)
    span = given if isinstance(given, Mapping) else {}
    spacing = span.get("spacing", "linear")
    try:
        start, stop, count = _float(span["start"]), _float(span["stop"]), _int(span["count"])
        right = span.keys() <= {"start", "stop", "count", "spacing"} and 2 <= count <= MAX_CASES
    except (KeyError, TypeError, OverflowError, InputError):
        right = False
    full_name = f'."{name}"'  # behind the name of the key: Table.checked
    if not right or spacing not in ("linear", "logarithmic"):
        allowed = "a list of values, or a table of start, stop, count (2 to 1e6) and, if wanted,"
        allowed += " spacing = 'linear' or 'logarithmic'"
        if span and not span.keys() & {"start", "stop", "count"}:
            allowed += f'; did you mean "{name}.{next(iter(span))}", in quotes?'
        raise InputError(full_name, given, allowed)
    if spacing == "linear":
        return tuple(map(float, np.linspace(start, stop, count)))
    if start * stop <= 0.0:
        raise InputError(full_name, given, "of one sign from start to stop with that spacing")
    return tuple(map(float, np.sign(start) * np.geomspace(abs(start), abs(stop), count)))


_READERS: dict[str, Callable[[object], Any]] = {
    "bool": partial(_of, bool),
    "float": _float,
    "int": _int,
    "str": _str,
    "Pair": lambda value: _vector(value, (2,)),
    "Vector": _vector,
    "float | bool": lambda value: value is not False and _float(value),
    "float | str": lambda value: _str(value) if isinstance(value, str) else _float(value),
    "float | tuple[float, ...]": _one_or_more,
    "int | str": lambda value: value if value == "all" else _int(value),
    "tuple[Axis, ...]": _axes(Axis, _values),
    "tuple[Face, ...]": _axes(
        Face, lambda _, given: tuple(map(_in_space, _of(list | tuple, given)))
    ),
    "tuple[MeshFile, ...]": _axes(MeshFile, _numbers_of_mesh),
    "tuple[Point, ...]": _axes(Point, lambda _, given: _vector(given)),
    "tuple[Harmonic, ...]": _harmonics,
    "tuple[float, ...]": _floats,
    "tuple[int, ...]": _ints,
    "tuple[str, ...]": lambda value: tuple(map(_str, _different(_of(list | tuple, value)))),
}
"""Function that reads a value, by the type of a field that is not None."""


_BY_NAME = ("tuple[Axis, ...]", "tuple[Face, ...]", "tuple[MeshFile, ...]", "tuple[Point, ...]")
_JSON = {"bool": "boolean", "float": "number", "int": "integer", "str": "string"}
_JSON |= dict.fromkeys(_BY_NAME, "object")
"""JSON's words for types; all others are arrays."""


def _reader(item: Field[Any]) -> Callable[[object], Any]:
    """Return the function that reads a key's value, by its type."""
    return _READERS[str(item.type).removesuffix(" | None")]


# --- what a key may hold --------------------------------------------------------------------------


def holds(
    allowed: str,
    accepts: Callable[[Any], bool] = lambda value: True,
    default: Any = MISSING,
    unit: str = "",
    **more: Any,
) -> Any:
    """Field of values for which ``accepts`` is true, ``allowed`` in words, with a unit."""
    metadata = {"allowed": allowed, "accepts": accepts, "unit": unit} | more
    return field(default=default, metadata=metadata)


def number(default: Any = MISSING, unit: str = "") -> Any:
    """Field of a finite number."""
    return holds(f"a finite number {OR_ZERO}", default=default, unit=unit)


def positive(default: Any = MISSING, unit: str = "") -> Any:
    """Field of a number > 0."""
    return holds(f"a finite number > 0 ({SIZES})", lambda value: value > 0, default, unit)


def not_negative(default: Any = MISSING, unit: str = "") -> Any:
    """Field of a number >= 0."""
    return holds(f"a finite number >= 0 {OR_ZERO}", lambda value: value >= 0, default, unit)


def between(least: str, most: str, default: Any, unit: str = "") -> Any:
    """Field of a number between two, given as an error writes them."""
    low, high = float(least), float(most)
    allowed = f"a number from {least} to {most}"
    return holds(allowed, lambda value: low <= value <= high, default, unit)


def vector(letter: str, default: Any = None, unit: str = "", *, of_solid: bool = False) -> Any:
    """Field of a vector, which an error calls by a letter, and by x and y, or z, too; of one that
    only solids have always."""
    allowed = components(letter, 3 if of_solid else 2)
    if not of_solid:
        allowed += f", or {_names(letter, 3)} of a solid"
    return holds(allowed, default=default, unit=unit, letter=letter)


def components(letter: str, dimension: int) -> str:
    """Describe the allowed components of a vector."""
    count = ("two", "three")[dimension - 2]
    return f"{_names(letter, dimension)}, {count} finite numbers {OR_ZERO}"


def _names(letter: str, dimension: int) -> str:
    """Return the names of a vector's numbers."""
    return f"[{', '.join(letter + axis for axis in 'xyz'[:dimension])}]"


def of_harmonics() -> Any:
    """Field of harmonics of a load."""
    allowed = f"a list of tables with an order, a whole number from 1 to {MAX_HARMONIC_ORDER} and"
    allowed += " another in each, and cos or sin, or amplitude and phase [degrees] by which it lags"
    return holds(allowed, default=())


def order_of_load(default: int) -> Any:
    """Field of the order of a harmonic of a load."""
    allowed = f"a whole number from 1 to {MAX_HARMONIC_ORDER}"
    return holds(allowed, lambda value: 1 <= value <= MAX_HARMONIC_ORDER, default)


def at_least_one(default: Any = MISSING) -> Any:
    """Field of a whole number >= 1."""
    return holds("a whole number >= 1", lambda value: value >= 1, default)


def choice(*words: str, default: Any = MISSING) -> Any:
    """Field of one of some words."""
    return holds(describe_choices(words), lambda value: value in words, default, words=words)


def hertz(
    omega: str,
    allowed: str = "a finite number > 0 (up to 1e29)",
    accepts: Callable[[Any], bool] = lambda value: 0 < value <= 1e29,
) -> Any:
    """Field of frequencies [Hz], the twin of the key ``omega`` in rad/s."""
    return twin(omega, RAD_PER_TURN, allowed, accepts, "Hz")


def twin(key: str, factor: float, allowed: str, accepts: Callable[[Any], bool], unit: str) -> Any:
    """Field of the same quantity as ``key`` in another unit: that key is ``factor`` times it.

    One of the two may be given; a table that is given the twin holds the other, too.
    """
    return holds(allowed, accepts, None, unit, twin=key, factor=factor)


def path(allowed: str, default: Any = None, unit: str = "") -> Any:
    """Field of the path of a file, relative to the scene's."""
    return holds(allowed, lambda value: value != "", default, unit, path=True)


def scaled(value: Any, factor: float) -> Any:
    """A number times a factor, or each of a tuple."""
    if isinstance(value, tuple):
        return tuple(scaled(one, factor) for one in value)
    return factor * value


def _as_toml(value: object) -> str:
    """A value as TOML: JSON but for DEL, and for inline tables."""
    if isinstance(value, Harmonic):
        pairs = ", ".join(f"{key} = {_as_toml(held)}" for key, held in vars(value).items())
        return f"{{ {pairs} }}"
    if isinstance(value, tuple):
        return f"[{', '.join(map(_as_toml, value))}]"
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


@contextmanager
def named(name: str) -> Iterator[None]:
    """Call the table whose keys are refused by its name in the file: "cracks.1" for a Crack."""
    try:
        yield
    except InputError as error:
        key = error.key.partition(".")[2]
        raise InputError(f"{name}.{key}" if key else name, error.value, error.allowed) from None


class Table:
    """A table of the scene: checks each of its keys when it is made."""

    FIRST: ClassVar[str | None] = None
    """The first table of its kind, "loads.1", where all stand in a list."""
    WORD: ClassVar[str | None] = None
    """The key for which a word may stand instead of the table: ``reduction = "off"``."""
    _ADVICE: ClassVar[Mapping[str, str]] = {}
    """Advice for keys that people look for and the table does not have, "name", and for values that
    a key does not take, "edge = top"."""

    def with_vectors(self, dimension: int) -> Any:
        """The same in a plane or in space, its vectors of zeros as long as that requires.

        Raises
        ------
        InputError
            Another vector is longer or shorter.
        """
        zeros = {}
        for key, item in self.keys().items():
            letter, value = item.metadata.get("letter"), getattr(self, key)
            if letter is not None and value is not None and len(value) != dimension:
                self.require(not any(value), key, components(letter, dimension))
                zeros[key] = (0.0,) * dimension
        return self.with_values(**zeros)

    def with_values(self, **values: Any) -> Self:
        """The same with other values, which are not checked."""
        made = copy(self)
        vars(made).update(values)
        return made

    def __post_init__(self) -> None:
        for name, item in self.keys().items():
            value = getattr(self, name)
            if value is not None or item.default is not None:
                object.__setattr__(self, name, self.checked(name, value))
        for name, key in self.twins().items():
            if (given := getattr(self, name)) is not None:
                value = scaled(given, self.keys()[name].metadata["factor"])
                allowed = f"left out with {self.name_of(key)} = {getattr(self, key)}"
                self.require(getattr(self, key) in (None, value), name, allowed)
                object.__setattr__(self, key, value)

    @classmethod
    def checked(cls, key: str, value: object) -> Any:
        """A value as a key holds it; raises InputError if the key may not hold it."""
        item = cls.keys()[key]
        try:
            found = _reader(item)(value)
            accepted = item.metadata["accepts"](found)
        except InputError as error:  # of one of its axes
            raise InputError(cls.name_of(key) + error.key, error.value, error.allowed) from None
        except (TypeError, OverflowError):
            accepted = False
        if not accepted:
            allowed = item.metadata["allowed"] + cls._hint(key, value)
            raise InputError(cls.name_of(key), value, allowed)
        return found

    @classmethod
    def _hint(cls, key: str, value: object) -> str:
        """Suggest a value instead of one that a key may not hold; or ""."""
        item = cls.keys()[key]
        words: list[Any] = []
        if isinstance(value, str):
            if advice := cls._ADVICE.get(f"{key} = {value}"):
                return f"; {advice}"
            words = find_similar_names(value, item.metadata.get("words", ()))
        for other in yield_candidate_values(value, item.metadata["unit"]):
            with suppress(InputError, TypeError, OverflowError):
                if not words and item.metadata["accepts"](_reader(item)(other)):
                    words.append(other)
        return f"; {did_you_mean_text([format_scene_value(word) for word in words])}".rstrip("; ")

    @classmethod
    def keys(cls) -> dict[str, Field[Any]]:
        """The keys of the table."""
        return {item.name: item for item in fields(cls)}  # type: ignore[arg-type]

    @classmethod
    def schema(cls) -> dict[str, Any]:
        """The table as a JSON schema."""
        found: dict[str, Any] = {}
        for name, item in cls.keys().items():
            kinds = str(item.type).removesuffix(" | None").split(" | ")
            types = [_JSON.get(kind, "array") for kind in kinds]
            if "tuple[int, ...]" in kinds:  # one number stands for a list of it
                types.append("integer")
            words = f"{item.metadata['allowed']} [{item.metadata['unit']}]"
            found[name] = {"type": types, "description": words.removesuffix(" []")}
            if "words" in item.metadata:
                found[name]["enum"] = item.metadata["words"]
            if item.default not in (MISSING, None, ()):
                found[name]["default"] = item.default
        needed = [name for name, item in cls.keys().items() if item.default is MISSING]
        table: dict[str, Any] = {"type": "object", "properties": found, "required": needed}
        table["additionalProperties"] = False
        return table if cls.WORD is None else {"anyOf": [table, found[cls.WORD]]}

    @classmethod
    def twins(cls) -> dict[str, str]:
        """The keys in another unit, as Hz, and those in SI units that stand for the same."""
        held = {name: item.metadata for name, item in cls.keys().items()}
        return {name: known["twin"] for name, known in held.items() if "twin" in known}

    @property
    def derived(self) -> set[str]:
        """The keys whose values follow from those of others, or are not given and chosen."""
        given = {key for name, key in self.twins().items() if getattr(self, name) is not None}
        return given | vars(self).get("_follow", set())

    @classmethod
    def name_of(cls, key: str = "") -> str:
        """A key as it stands in a scene file: ``harmonic_balance.samples``; or the table alone."""
        table = "".join("_" + c.lower() if c.isupper() else c for c in cls.__name__).lstrip("_")
        return f"{table}.{key}" if key else table

    @classmethod
    def proposed(cls, key: str) -> str:
        """A key as it is proposed, and taken by ``replace``; of a list of tables, of its first."""
        return f"{cls.FIRST}.{key}" if cls.FIRST else cls.name_of(key)

    def as_toml(self) -> str:
        """The table as it would stand in a file; what has its default is left out."""
        lines, after = [f"[{self.name_of()}]"], []
        found = self.derived
        for name, item in self.keys().items():
            value = getattr(self, name)
            if isinstance(value, tuple) and value and isinstance(value[0], Axis):
                after += ["", f"[{self.name_of(name)}]", *(axis.as_toml() for axis in value)]
            elif value != item.default and name not in found:
                lines.append(f"{name} = {_as_toml(value)}")
        return "\n".join([*lines, *after, ""])

    def require(self, condition: bool, key: str, allowed: str) -> None:
        """Raise InputError for a key unless a condition holds."""
        if not condition:
            raise InputError(self.name_of(key), getattr(self, key), allowed)

    def given(self, key: str, allowed: str = "") -> Any:
        """The value of a key that may not be left out."""
        allowed = allowed or f"given: {self.keys()[key].metadata['allowed']}"
        self.require(getattr(self, key) is not None, key, allowed)
        return getattr(self, key)

    def leave_out(self, keys: Iterable[str], why: str) -> None:
        """Raise InputError if one of the keys is given, other than by default."""
        for key in keys:
            unsaid = getattr(self, key) in (None, self.keys()[key].default)
            self.require(unsaid, key, f"left out with {why}")

    @classmethod
    def meant_by(cls, key: str) -> list[str]:
        """The keys of the scene that may be meant by one that the table does not have.

        It is misspelt, or belongs to another table.
        """
        tables = [cls, *(table for table in Table.__subclasses__() if table is not cls)]
        own = [cls.proposed(name) for name in find_similar_names(key, cls.keys())]
        if found := own or with_key(key, tables):
            return found
        every = {name: table for table in tables[::-1] for name in table.keys()}
        return [every[name].proposed(name) for name in find_similar_names(key, every, 0.8)]

    @classmethod
    def instead_of(cls, key: str) -> str:
        """Return the error text for a missing key: the suggested keys, and all known ones."""
        advice = cls._ADVICE.get(key) or did_you_mean_text(cls.meant_by(key)).strip()
        return f"left out; {advice} known keys: {', '.join(cls.keys())}".replace(";  ", "; ")

    @classmethod
    def without_twins(
        cls, values: Mapping[str, object], _held: Mapping[str, object]
    ) -> dict[str, Any]:
        """Changes of some keys of what a table holds, and None for what they take the place of."""
        cls.check_twins(values)
        others = {key: twin for pair in cls.twins().items() for key, twin in (pair, pair[::-1])}
        gone = {others[key]: None for key in values if others.get(key, key) not in values}
        return {**gone, **values}

    @classmethod
    def check_twins(cls, values: Mapping[str, object]) -> None:
        """Raise InputError if a key and its twin in another unit are given."""
        for name, omega in cls.twins().items():
            if values.get(name) is not None and values.get(omega) is not None:
                allowed = f"left out with {cls.name_of(omega)} = {values[omega]}: one of the two"
                raise InputError(cls.name_of(name), values[name], allowed)

    @classmethod
    def from_mapping(cls, values: object) -> Any:
        """Make the table from the mapping read in a file."""
        known = cls.keys()
        keys = ", ".join(known)
        if cls.WORD is not None and isinstance(values, str):
            values = {cls.WORD: values}
        if not isinstance(values, Mapping):
            raise InputError(cls.name_of(), values, f"a table with the keys {keys}")
        for key, value in values.items():
            if key not in known:
                raise InputError(cls.name_of(str(key)), value, cls.instead_of(str(key)))
        for key, item in known.items():
            if item.default is MISSING and key not in values:
                raise InputError(cls.name_of(key), None, f"given: {item.metadata['allowed']}")
        cls.check_twins(values)
        return cls(**values)


def with_key(key: str, tables: Iterable[type[Table]]) -> list[str]:
    """A key with the tables that have it; those last where it is a list of tables."""
    known = [table for table in tables if key in table.keys()]
    known.sort(key=lambda table: table.keys()[key].default == ())
    return [table.proposed(key) for table in known]
