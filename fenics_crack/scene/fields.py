"""Fields for the keys in a scene's tables, and the class :class:`Table` that checks the values.

A :class:`Table` is a frozen dataclass. The functions ``..._field`` below make its fields; each
field states once what a key may hold. The field's type selects the function that reads a value.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from copy import copy
from dataclasses import MISSING, Field, dataclass, field, fields
from functools import cache, partial
from numbers import Integral, Real
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from fenics_crack.basics.errors import (
    MAX_HARMONIC_ORDER,
    MAX_VALUES_OF_AXIS,
    InputError,
    describe_choices,
)
from fenics_crack.basics.suggestions import (
    did_you_mean_text,
    find_similar_names,
    format_scene_value,
    yield_candidate_values,
)
from fenics_crack.basics.tables import RAD_PER_TURN

Pair = tuple[float, float]
Vector = tuple[float, ...]
"""Vector with two components in a plane, three in space."""
MIN_ALLOWED_MAGNITUDE, MAX_ALLOWED_MAGNITUDE = 1e-30, 1e30
"""Limits for nonzero numbers in a scene; products and squares neither overflow nor underflow."""
ALLOWED_MAGNITUDES_TEXT = f"{MIN_ALLOWED_MAGNITUDE:g} to {MAX_ALLOWED_MAGNITUDE:g}"
ZERO_OR_MAGNITUDE_TEXT = f"(0, or of magnitude {ALLOWED_MAGNITUDES_TEXT})"


@dataclass(frozen=True)
class Axis:
    """Values for one key: an axis in a sweep.

    Attributes
    ----------
    key : str
        Full key, for example "crack.length".
    values : tuple
        Values in the given order.
    """

    key: str
    values: tuple[Any, ...]

    def as_toml(self) -> str:
        """Return the axis as a line of TOML: "crack.length" = [0.02, 0.03]."""
        return f"{_value_as_toml(self.key)} = {_value_as_toml(self.values)}"


class OutputPoint(Axis):
    """Point in ``[output.points]`` at which the displacement is reported.

    ``key`` is the name, ``values`` are the coordinates x, y and, in a solid, z [m].
    """


class NamedCadFace(Axis):
    """Named faces of a CAD part, in ``[geometry.faces]``.

    ``key`` is the name, ``values`` are points (x, y, z) [m] on the faces.
    """


class MeshFile(Axis):
    """Mesh file in ``[identify.meshes]``, with values for the unknowns of the identification.

    ``key`` is the file's path, ``values`` are pairs of name and number, such as
    ``(("crack.length", 0.005),)``.
    """

    @property
    def parameter_value_by_name(self) -> dict[str, float]:
        """Values of the unknowns by name."""
        return dict(self.values)

    def as_toml(self) -> str:
        """Return the mesh file as a line of TOML: "a.msh" = { "crack.length" = 0.005 }."""
        parameters_text = ", ".join(
            f"{_value_as_toml(parameter_name)} = {_value_as_toml(parameter_value)}"
            for parameter_name, parameter_value in self.values
        )
        return f"{_value_as_toml(self.key)} = {{ {parameters_text} }}"


@dataclass(frozen=True)
class Harmonic:
    """Harmonic of a periodic load: c cos(k omega t) + s sin(k omega t).

    Attributes
    ----------
    order : int
        k, the multiple of the load frequency omega.
    cos, sin : tuple of float
        Amplitudes c and s: components of a vector, or a single number for a pressure.
    """

    order: int
    cos: tuple[float, ...]
    sin: tuple[float, ...]


# --- how a value is read --------------------------------------------------------------------------


def _require_instance(allowed_type: Any, value: object) -> Any:
    """Return ``value`` unchanged; raise TypeError unless it is an instance of the type."""
    if not isinstance(value, allowed_type):
        raise TypeError
    return value


def _read_float(value: object) -> float:
    """Return a finite number as float, 0 or of magnitude 1e-30 to 1e30.

    Raises TypeError for other types, nan and infinity; OverflowError for other magnitudes.
    """
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
        raise TypeError
    number = float(value)
    if value != 0 and not MIN_ALLOWED_MAGNITUDE <= abs(number) <= MAX_ALLOWED_MAGNITUDE:
        raise OverflowError
    return number


def _read_int(value: object) -> int:
    """Return a whole number as int.

    Raises TypeError for other types, InputError for a magnitude of 2^31 or more.
    """
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise TypeError
    number = int(value)
    if abs(number) >= 2**31:  # gmsh and PETSc count with 32 bits
        raise InputError("", value, "a whole number below 2^31 = 2147483648")
    return number


def _read_string(value: object) -> str:
    """Return a string; raise TypeError for other types, or if UTF-8 cannot encode it."""
    if not isinstance(value, str) or any("\ud800" <= character <= "\udfff" for character in value):
        raise TypeError
    return value


def _read_floats(value: object) -> tuple[float, ...]:
    """Convert a list with finite numbers to a tuple of floats."""
    return tuple(map(_read_float, _require_instance(list | tuple, value)))


def _read_vector(value: object, lengths: tuple[int, ...] = (2, 3)) -> Vector:
    """Return a list of numbers as a vector; raise TypeError unless its length is allowed.

    ``lengths`` are the allowed numbers of components. Whether the scene has 2 or 3 dimensions is
    checked later, by :meth:`Table.with_dimension`.
    """
    if len(_require_instance(list | tuple, value)) not in lengths:
        raise TypeError
    return _read_floats(value)


def _read_number_or_numbers(value: object) -> float | tuple[float, ...]:
    """Return a number as float, or a list of numbers as a tuple.

    Raises TypeError for an empty list.
    """
    if not isinstance(value, list | tuple):
        return _read_float(value)
    if not value:
        raise TypeError
    return _read_floats(value)


def _make_axes_read_function(
    axis_class: type[Axis], read_axis_values: Callable[[str, object], tuple[Any, ...]]
) -> Callable[[object], tuple[Axis, ...]]:
    """Return a function that makes axes from a mapping as read from TOML.

    Each name in the mapping gives an axis. The returned function leaves a tuple of ``axis_class``
    objects unchanged.

    Parameters
    ----------
    axis_class : type
        Class of the result's objects: :class:`Axis`, or a subclass such as :class:`MeshFile`.
    read_axis_values : callable
        Converts the raw values of an axis: ``read_axis_values(name, raw_values)``.

    Returns
    -------
    callable
        Function from the mapping to a tuple of ``axis_class`` objects.
    """

    def read_axes(value: object) -> tuple[Axis, ...]:
        if isinstance(value, tuple) and all(isinstance(axis, axis_class) for axis in value):
            return value
        raw_value_items = _require_instance(Mapping, value).items()
        return tuple(
            axis_class(_read_string(name), read_axis_values(name, raw_values))
            for name, raw_values in raw_value_items
        )

    return read_axes


def _read_mesh_parameter_pairs(
    file_name: str, parameter_by_name: object
) -> tuple[tuple[str, float], ...]:
    """Return (name, number) pairs from the table of a mesh file: ("crack.length", 0.005).

    ``file_name`` is not used.
    """
    return tuple(
        (_read_string(parameter_name), _read_float(parameter_value))
        for parameter_name, parameter_value in _require_instance(Mapping, parameter_by_name).items()
    )


def _read_load_harmonics(value: object) -> tuple[Harmonic, ...]:
    """Convert a list of harmonic tables to a tuple of harmonics.

    Raises TypeError if two orders are equal.
    """
    harmonic_tables = _require_instance(list | tuple, value)
    harmonics = tuple(
        harmonic if isinstance(harmonic, Harmonic) else _read_harmonic(harmonic)
        for harmonic in harmonic_tables
    )
    _require_distinct([harmonic.order for harmonic in harmonics])
    return harmonics


def _read_harmonic(harmonic_table: object) -> Harmonic:
    """Return a harmonic from a table with cosine and sine, or with amplitude and phase.

    The phase is the lag [degrees] behind a cosine. A missing cosine or sine is zero. Raises
    TypeError for other keys, unequal lengths, or an order outside 1 to MAX_HARMONIC_ORDER.
    """
    if not isinstance(harmonic_table, Mapping) or "order" not in harmonic_table:
        raise TypeError
    order, keys_besides_order = (
        _read_int(harmonic_table["order"]),
        harmonic_table.keys() - {"order"},
    )
    if not 1 <= order <= MAX_HARMONIC_ORDER or not keys_besides_order:
        raise TypeError
    if keys_besides_order <= {"cos", "sin"}:
        components_by_key = {
            key: _read_load_components(harmonic_table[key]) for key in keys_besides_order
        }
        zero_components, *zeros_of_other_lengths = {
            (0.0,) * len(load_components) for load_components in components_by_key.values()
        }
        if zeros_of_other_lengths:
            raise TypeError
        return Harmonic(
            order,
            components_by_key.get("cos", zero_components),
            components_by_key.get("sin", zero_components),
        )
    if "amplitude" not in keys_besides_order or not keys_besides_order <= {"amplitude", "phase"}:
        raise TypeError
    phase = math.radians(_read_float(harmonic_table.get("phase", 0.0)))
    amplitude = _read_load_components(harmonic_table["amplitude"])
    return Harmonic(
        order, scale_numbers(amplitude, math.cos(phase)), scale_numbers(amplitude, math.sin(phase))
    )


def _read_load_components(value: object) -> tuple[float, ...]:
    """Return a vector of 1 to 3 numbers; a single number, for a pressure, becomes a tuple."""
    return _read_vector(value if isinstance(value, list | tuple) else [value], (1, 2, 3))


def _read_distinct_ints(value: object) -> tuple[int, ...]:
    """Return a whole number, or a list of distinct whole numbers, as a tuple."""
    return tuple(
        map(_read_int, _require_distinct(value if isinstance(value, list | tuple) else [value]))
    )


def _require_distinct(values: Any) -> Any:
    """Return ``values`` unchanged; raise TypeError if two values are equal."""
    if len(set(values)) != len(values):
        raise TypeError
    return values


def _read_axis_values(name: str, values_or_range: object) -> tuple[Any, ...]:
    """Return the values of an axis from a list, or from a table that defines a range.

    A range has the keys start, stop and count. The optional key spacing is "linear" or
    "logarithmic". ``name`` is the axis's key, for errors. Raises InputError for anything else.
    """
    if isinstance(values_or_range, list | tuple) and values_or_range:
        return tuple(values_or_range)
    range_table = values_or_range if isinstance(values_or_range, Mapping) else {}
    spacing = range_table.get("spacing", "linear")
    try:
        start = _read_float(range_table["start"])
        stop = _read_float(range_table["stop"])
        n_values = _read_int(range_table["count"])
        is_valid_range = (
            range_table.keys() <= {"start", "stop", "count", "spacing"}
            and 2 <= n_values <= MAX_VALUES_OF_AXIS
        )
    except (KeyError, TypeError, OverflowError, InputError):
        is_valid_range = False
    error_key_suffix = f'."{name}"'  # behind the name of the key: Table.convert_value
    if not is_valid_range or spacing not in ("linear", "logarithmic"):
        requirement_text = (
            "a list of values, or a table with start, stop, count (2 to 1e6) and, optionally,"
            " spacing = 'linear' or 'logarithmic'"
        )
        if range_table and not range_table.keys() & {"start", "stop", "count"}:
            requirement_text += f'; did you mean "{name}.{next(iter(range_table))}", in quotes?'
        raise InputError(error_key_suffix, values_or_range, requirement_text)
    if spacing == "linear":
        return tuple(map(float, np.linspace(start, stop, n_values)))
    if start * stop <= 0.0:
        raise InputError(
            error_key_suffix,
            values_or_range,
            "a range with start and stop both > 0 or both < 0, for that spacing",
        )
    return tuple(map(float, np.sign(start) * np.geomspace(abs(start), abs(stop), n_values)))


_READ_FUNCTION_BY_TYPE_NAME: dict[str, Callable[[object], Any]] = {
    "bool": partial(_require_instance, bool),
    "float": _read_float,
    "int": _read_int,
    "str": _read_string,
    "Pair": lambda value: _read_vector(value, (2,)),
    "Vector": _read_vector,
    "float | bool": lambda value: value is not False and _read_float(value),
    "float | str": lambda value: (
        _read_string(value) if isinstance(value, str) else _read_float(value)
    ),
    "float | tuple[float, ...]": _read_number_or_numbers,
    "int | str": lambda value: value if value == "all" else _read_int(value),
    "tuple[Axis, ...]": _make_axes_read_function(Axis, _read_axis_values),
    "tuple[NamedCadFace, ...]": _make_axes_read_function(
        NamedCadFace,
        lambda _, given: tuple(
            _read_vector(point, (3,)) for point in _require_instance(list | tuple, given)
        ),
    ),
    "tuple[MeshFile, ...]": _make_axes_read_function(MeshFile, _read_mesh_parameter_pairs),
    "tuple[OutputPoint, ...]": _make_axes_read_function(
        OutputPoint, lambda _, given: _read_vector(given)
    ),
    "tuple[Harmonic, ...]": _read_load_harmonics,
    "tuple[float, ...]": _read_floats,
    "tuple[int, ...]": _read_distinct_ints,
    "tuple[str, ...]": lambda value: tuple(
        map(_read_string, _require_distinct(_require_instance(list | tuple, value)))
    ),
}
"""Functions that check and convert a raw value, by the field's type without "| None"."""


_JSON_TYPE_BY_TYPE_NAME = {
    "bool": "boolean",
    "float": "number",
    "int": "integer",
    "str": "string",
    "tuple[Axis, ...]": "object",
    "tuple[NamedCadFace, ...]": "object",
    "tuple[MeshFile, ...]": "object",
    "tuple[OutputPoint, ...]": "object",
}
"""JSON types by Python types; all other types are arrays."""


def _find_read_function(key_field: Field[Any]) -> Callable[[object], Any]:
    """Return the function that checks and converts raw values for a field."""
    return _READ_FUNCTION_BY_TYPE_NAME[str(key_field.type).removesuffix(" | None")]


# --- what a key may hold --------------------------------------------------------------------------


def any_type_field(
    requirement_text: str,
    is_allowed: Callable[[Any], bool] = lambda value: True,
    default: Any = MISSING,
    unit: str = "",
    **more_metadata: Any,
) -> Any:
    """Return a dataclass field for a key; a function decides which values are allowed.

    Parameters
    ----------
    requirement_text : str
        Text in errors: what is allowed.
    is_allowed : callable
        Returns True for an allowed value, after conversion to the field's type.
    default
        Default value; MISSING if the key is required.
    unit : str
        Unit, empty without one.
    more_metadata
        Further metadata of the field, such as ``path=True`` for a file's path.
    """
    allowed_text = f"{requirement_text} [{unit}]".removesuffix(" []")
    metadata = {"allowed": allowed_text, "accepts": is_allowed, "unit": unit} | more_metadata
    return field(default=default, metadata=metadata)


def number_field(default: Any = MISSING, unit: str = "") -> Any:
    """Return a field for a finite number, 0 or of magnitude 1e-30 to 1e30."""
    return any_type_field(f"a finite number {ZERO_OR_MAGNITUDE_TEXT}", default=default, unit=unit)


def positive_field(default: Any = MISSING, unit: str = "") -> Any:
    """Return a field for a number > 0, from 1e-30 to 1e30."""
    return any_type_field(
        f"a finite number > 0 ({ALLOWED_MAGNITUDES_TEXT})", lambda value: value > 0, default, unit
    )


def nonnegative_field(default: Any = MISSING, unit: str = "") -> Any:
    """Return a field for a number >= 0, at most 1e30."""
    return any_type_field(
        f"a finite number >= 0 {ZERO_OR_MAGNITUDE_TEXT}", lambda value: value >= 0, default, unit
    )


def bounded_field(lower_text: str, upper_text: str, default: Any, unit: str = "") -> Any:
    """Return a field for a number between two bounds, both allowed.

    ``lower_text`` and ``upper_text`` are the bounds as texts, such as "1e-6". Errors show the texts
    unchanged.
    """
    lower_bound, upper_bound = float(lower_text), float(upper_text)
    return any_type_field(
        f"a number from {lower_text} to {upper_text}",
        lambda value: lower_bound <= value <= upper_bound,
        default,
        unit,
    )


def vector_key_field(
    component_name_prefix: str, default: Any = None, unit: str = "", *, of_solid: bool = False
) -> Any:
    """Return a field for a vector with 2 or 3 components.

    Errors name the components by ``component_name_prefix`` and x, y, z: "fx". If ``of_solid`` is
    True, errors ask for three components, since only solids have the key.
    """
    requirement_text = describe_components(component_name_prefix, 3 if of_solid else 2)
    if not of_solid:
        requirement_text += f", or {_format_component_names(component_name_prefix, 3)} in a solid"
    return any_type_field(
        requirement_text, default=default, unit=unit, letter=component_name_prefix
    )


def describe_components(component_name_prefix: str, dimension: int) -> str:
    """Describe an allowed vector in 2 or 3 dimensions: "[fx, fy], two finite numbers"."""
    count_word = ("two", "three")[dimension - 2]
    names_text = _format_component_names(component_name_prefix, dimension)
    return f"{names_text}, {count_word} finite numbers {ZERO_OR_MAGNITUDE_TEXT}"


def _format_component_names(component_name_prefix: str, dimension: int) -> str:
    """Return the component names as a text: "[fx, fy]"."""
    return (
        f"[{', '.join(component_name_prefix + axis_letter for axis_letter in 'xyz'[:dimension])}]"
    )


def load_harmonic_list_field() -> Any:
    """Return a field for a load's list of harmonics; the default is empty."""
    return any_type_field(
        f"a list of tables: each has a different order from 1 to {MAX_HARMONIC_ORDER}, and cos or"
        " sin or both, or amplitude and, optionally, phase (the lag in degrees)",
        default=(),
    )


def harmonic_order_field(default: int) -> Any:
    """Return a field for a whole number from 1 to MAX_HARMONIC_ORDER."""
    return any_type_field(
        f"a whole number from 1 to {MAX_HARMONIC_ORDER}",
        lambda value: 1 <= value <= MAX_HARMONIC_ORDER,
        default,
    )


def positive_int_field(default: Any = MISSING) -> Any:
    """Return a field for a whole number >= 1."""
    return any_type_field("a whole number >= 1", lambda value: value >= 1, default)


def choice_field(*words: str, default: Any = MISSING) -> Any:
    """Return a field for one of the given words."""
    return any_type_field(
        describe_choices(words), lambda value: value in words, default, words=words
    )


def hertz_field(
    omega_key: str,
    requirement_text: str = "a finite number > 0 (up to 1e29)",
    is_allowed: Callable[[Any], bool] = lambda value: 0 < value <= 1e29,
) -> Any:
    """Return a field for frequencies in Hz.

    The same quantity in rad/s has the key ``omega_key``. If the frequency in Hz is given,
    ``omega_key`` is set, too.
    """
    return twin_field(omega_key, RAD_PER_TURN, requirement_text, is_allowed, "Hz")


def twin_field(
    si_key: str, factor: float, requirement_text: str, is_allowed: Callable[[Any], bool], unit: str
) -> Any:
    """Return a field for a twin key: the quantity of ``si_key`` in another unit.

    Only one of the two keys may be given. If the twin is given, ``si_key`` is set to ``factor``
    times the twin's value.

    Parameters
    ----------
    si_key : str
        Key of the quantity in SI units.
    factor : float
        Factor from the twin's unit to the SI unit.
    requirement_text, is_allowed, unit
        As in :func:`any_type_field`, for the twin.
    """
    return any_type_field(requirement_text, is_allowed, None, unit, twin=si_key, factor=factor)


def path_field(requirement_text: str, default: Any = None, unit: str = "") -> Any:
    """Return a field for the path of a file.

    The path must not be empty. A relative path begins at the scene's folder. If the field's type
    has numbers, a number may replace the path.
    """
    return any_type_field(requirement_text, lambda value: value != "", default, unit, path=True)


def scale_numbers(number_or_tuple: Any, factor: float) -> Any:
    """Multiply a number, or each number in nested tuples, by a factor."""
    if isinstance(number_or_tuple, tuple):
        return tuple(scale_numbers(number, factor) for number in number_or_tuple)
    return factor * number_or_tuple


def _value_as_toml(value: object) -> str:
    """Return a value as TOML text; a harmonic becomes an inline table."""
    if isinstance(value, Harmonic):
        pairs_text = ", ".join(
            f"{harmonic_attribute_name} = {_value_as_toml(harmonic_attribute_value)}"
            for harmonic_attribute_name, harmonic_attribute_value in vars(value).items()
        )
        return f"{{ {pairs_text} }}"
    if isinstance(value, tuple):
        return f"[{', '.join(map(_value_as_toml, value))}]"
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


@contextmanager
def use_table_name_in_errors(table_name: str) -> Iterator[None]:
    """Change the table's name in InputErrors raised in the block: "cracks.1" for "crack"."""
    try:
        yield
    except InputError as error:
        key_without_table_name = error.key.partition(".")[2]
        raise InputError(
            f"{table_name}.{key_without_table_name}" if key_without_table_name else table_name,
            error.value,
            error.allowed,
        ) from None


class Rule(NamedTuple):
    """Keys that a condition excludes or restricts.

    Attributes
    ----------
    condition : str
        Condition, written as in errors. Examples: "[disk]", if the scene has the table;
        "geometry.file", if the scene has the key; "point", if the same table has the key;
        "mesh.layout = 'file'", if the key has the value. "without" before a condition makes the
        opposite: "without [disk]".
    keys : tuple
        Restricted keys in a table.
    reason : str
        Text after the condition in errors.
    allowed_choices : tuple
        Allowed values under the condition; empty: the keys must be left out.
    """

    condition: str
    keys: tuple[str, ...]
    reason: str = ""
    allowed_choices: tuple[Any, ...] = ()


@cache
def _split_condition(condition: str) -> tuple[str, str, str]:
    """Split the condition of a :class:`Rule` into table, key, and the value's text.

    "mesh.layout = 'file'" gives "mesh", "layout", "'file'". A missing part is "".
    """
    name, _, value_text = condition.removeprefix("without ").partition(" = ")
    table_name, _, key = name.strip("[]").partition(".")
    return table_name, key, value_text


def condition_holds(condition: str, table_by_name: Mapping[str, Any]) -> bool:
    """Return True if a condition in a :class:`Rule` holds for the given tables.

    Missing tables, and the values None, 0 and False, count as not given.
    """
    table_name, key, value_text = _split_condition(condition)
    value = table_by_name.get(table_name)
    if key:
        value = getattr(value, key, None)
    is_fulfilled = repr(value) == value_text if value_text else bool(value)
    return is_fulfilled != condition.startswith("without ")


def add_preposition(circumstance: str) -> str:
    """Return a circumstance with a preposition, for errors: "with [disk]".

    A text that begins with "without" stays unchanged.
    """
    return circumstance if circumstance.startswith("without ") else f"with {circumstance}"


class Table:
    """Base class for a scene's tables, with checks of all values.

    A wrong value raises InputError when the table is made. Subclasses are frozen dataclasses with
    one field for each key.
    """

    FIRST_TABLE_NAME: ClassVar[str | None] = None
    """Name of the first table, "loads.1", if all tables of the class stand in a list."""
    KEY_OF_BARE_VALUE: ClassVar[str | None] = None
    """Key whose value may replace the whole table: ``reduction = "off"``; None if not allowed."""
    _KEY_RULES: ClassVar[tuple[Rule, ...]] = ()
    """Rules for keys, with conditions on other keys in the table."""
    _ADVICE_TEXT_BY_MISTAKE: ClassVar[Mapping[str, str]] = {}
    """Advice for errors, by an unknown key, "name", or by a wrong value, "edge = top"."""

    def with_dimension(self, dimension: int) -> Any:
        """Return a copy of the table for a scene with 2 or 3 dimensions.

        Zero vectors, such as defaults, get as many components as dimensions.

        Raises
        ------
        InputError
            A nonzero vector has another number of components.
        """
        zero_vector_by_key = {}
        for key, key_field in self.field_by_key().items():
            component_name_prefix, vector = key_field.metadata.get("letter"), getattr(self, key)
            if (
                component_name_prefix is not None
                and vector is not None
                and len(vector) != dimension
            ):
                self.require(
                    not any(vector), key, describe_components(component_name_prefix, dimension)
                )
                zero_vector_by_key[key] = (0.0,) * dimension
        return self.with_unchecked_values(**zero_vector_by_key)

    def with_unchecked_values(self, **value_by_key: Any) -> Self:
        """Return a copy with other values by key, without checking the values."""
        changed_table = copy(self)
        vars(changed_table).update(value_by_key)
        return changed_table

    def __post_init__(self) -> None:
        for key, key_field in self.field_by_key().items():
            raw_value = getattr(self, key)
            if raw_value is not None or key_field.default is not None:
                object.__setattr__(self, key, self.convert_value(key, raw_value))
        for twin_key, si_key in self.si_key_by_twin().items():
            if (twin_value := getattr(self, twin_key)) is not None:
                si_value = scale_numbers(
                    twin_value, self.field_by_key()[twin_key].metadata["factor"]
                )
                if getattr(self, si_key) != si_value:
                    self.forbid_both_twins(vars(self))
                object.__setattr__(self, si_key, si_value)
        self.check_rules(self._KEY_RULES, {self.full_key(): self, **vars(self)})

    def check_rules(self, rules: Iterable[Rule], table_by_name: Mapping[str, Any]) -> None:
        """Raise InputError if keys of this table break a rule.

        ``table_by_name`` has the tables named in the conditions of the rules.
        """
        for rule in rules:
            if not condition_holds(rule.condition, table_by_name):
                continue
            circumstance = rule.condition + rule.reason
            if not rule.allowed_choices:
                self.forbid_keys(rule.keys, circumstance)
                continue
            allowed_values_text = " or ".join(map(repr, rule.allowed_choices))
            for key in rule.keys:
                self.require(
                    getattr(self, key) in (None, *rule.allowed_choices),
                    key,
                    f"{allowed_values_text} {add_preposition(circumstance)}",
                )

    @classmethod
    def convert_value(cls, key: str, value: object) -> Any:
        """Convert a key's raw value to its stored type; raise InputError if not allowed."""
        key_field = cls.field_by_key()[key]
        try:
            field_value = _find_read_function(key_field)(value)
            is_accepted = key_field.metadata["accepts"](field_value)
        except InputError as error:  # of one of its axes
            raise InputError(cls.full_key(key) + error.key, error.value, error.allowed) from None
        except (TypeError, OverflowError):
            is_accepted = False
        if not is_accepted:
            suggestion_text = cls._make_value_suggestion_text(key, value)
            raise InputError(
                cls.full_key(key), value, key_field.metadata["allowed"] + suggestion_text
            )
        return field_value

    @classmethod
    def _make_value_suggestion_text(cls, key: str, value: object) -> str:
        """Return text to append to the error about a refused value.

        The text is advice, or proposes an allowed value similar to ``value``. Without advice and
        similar values, it is empty.
        """
        key_field = cls.field_by_key()[key]
        value_suggestions: list[Any] = []
        if isinstance(value, str):
            if advice_text := cls._ADVICE_TEXT_BY_MISTAKE.get(f"{key} = {value}"):
                return f"; {advice_text}"
            value_suggestions = find_similar_names(value, key_field.metadata.get("words", ()))
        for candidate_value in yield_candidate_values(value, key_field.metadata["unit"]):
            with suppress(InputError, TypeError, OverflowError):
                if not value_suggestions and key_field.metadata["accepts"](
                    _find_read_function(key_field)(candidate_value)
                ):
                    value_suggestions.append(candidate_value)
        suggestion_texts = [
            format_scene_value(value_suggestion) for value_suggestion in value_suggestions
        ]
        return f"; {did_you_mean_text(suggestion_texts)}".rstrip("; ")

    @classmethod
    @cache
    def field_by_key(cls) -> dict[str, Field[Any]]:
        """Return the dataclass field of each key."""
        return {key_field.name: key_field for key_field in fields(cls)}  # type: ignore[arg-type]

    @classmethod
    def schema(cls) -> dict[str, Any]:
        """Return a JSON schema of the table's keys: types, choices, defaults, descriptions."""
        schema_by_key: dict[str, Any] = {}
        for key, key_field in cls.field_by_key().items():
            python_type_names = str(key_field.type).removesuffix(" | None").split(" | ")
            json_types = [
                _JSON_TYPE_BY_TYPE_NAME.get(python_type_name, "array")
                for python_type_name in python_type_names
            ]
            if "tuple[int, ...]" in python_type_names:  # one number stands for a list of it
                json_types.append("integer")
            schema_by_key[key] = {"type": json_types, "description": key_field.metadata["allowed"]}
            if "words" in key_field.metadata:
                schema_by_key[key]["enum"] = key_field.metadata["words"]
            if key_field.default not in (MISSING, None, ()):
                schema_by_key[key]["default"] = key_field.default
        table_schema: dict[str, Any] = {
            "type": "object",
            "properties": schema_by_key,
            "required": cls.required_keys(),
            "additionalProperties": False,
        }
        return (
            table_schema
            if cls.KEY_OF_BARE_VALUE is None
            else {"anyOf": [table_schema, schema_by_key[cls.KEY_OF_BARE_VALUE]]}
        )

    @classmethod
    def required_keys(cls) -> list[str]:
        """Return the keys without a default value."""
        return [
            key for key, key_field in cls.field_by_key().items() if key_field.default is MISSING
        ]

    @classmethod
    def si_key_by_twin(cls) -> dict[str, str]:
        """Return the SI key for each twin key: "omega" for "frequency", "speed" for "rpm".

        A twin key has the same quantity in another unit.
        """
        return {
            key: key_field.metadata["twin"]
            for key, key_field in cls.field_by_key().items()
            if "twin" in key_field.metadata
        }

    @classmethod
    def twin_key_by_key(cls) -> dict[str, str]:
        """Return the twin for each key with a twin: "rpm" for "speed", and "speed" for "rpm".

        A twin key has the same quantity in another unit.
        """
        si_key_by_twin = cls.si_key_by_twin()
        return si_key_by_twin | {si_key: twin_key for twin_key, si_key in si_key_by_twin.items()}

    @property
    def derived_keys(self) -> set[str]:
        """Keys whose values were not given.

        The values come from a twin key (the same quantity in another unit), or are defaults.
        :meth:`as_toml` leaves out the keys.
        """
        replaced_si_keys = {
            si_key
            for twin_key, si_key in self.si_key_by_twin().items()
            if getattr(self, twin_key) is not None
        }
        return replaced_si_keys | vars(self).get("_inferred_keys", set())

    @classmethod
    def full_key(cls, key: str = "") -> str:
        """Return a key with the table's name: "harmonic_balance.samples".

        An empty key gives the table's name alone.
        """
        table_name = "".join(
            "_" + character.lower() if character.isupper() else character
            for character in cls.__name__
        ).lstrip("_")
        return f"{table_name}.{key}" if key else table_name

    @classmethod
    def full_key_in_first_table(cls, key: str) -> str:
        """Return a full key as errors suggest it: "excitation.omega".

        For a list of tables, the key belongs to the first table: "loads.1.point".
        """
        return f"{cls.FIRST_TABLE_NAME}.{key}" if cls.FIRST_TABLE_NAME else cls.full_key(key)

    def as_toml(self) -> str:
        """Return the table as written in a file, without default and inferred values."""
        toml_lines, axes_lines = [f"[{self.full_key()}]"], []
        derived_keys = self.derived_keys
        for key, key_field in self.field_by_key().items():
            current_value = getattr(self, key)
            if (
                isinstance(current_value, tuple)
                and current_value
                and isinstance(current_value[0], Axis)
            ):
                axes_lines += [
                    "",
                    f"[{self.full_key(key)}]",
                    *(axis.as_toml() for axis in current_value),
                ]
            elif current_value != key_field.default and key not in derived_keys:
                toml_lines.append(f"{key} = {_value_as_toml(current_value)}")
        return "\n".join([*toml_lines, *axes_lines, ""])

    def require(self, condition: bool, key: str, requirement_text: str) -> None:
        """Raise InputError for a key unless ``condition`` is true.

        ``requirement_text`` completes "must be" in the error.
        """
        if not condition:
            raise InputError(self.full_key(key), getattr(self, key), requirement_text)

    def given(self, key: str, requirement_text: str = "") -> Any:
        """Return the value of a key; raise InputError if it is None.

        ``requirement_text`` replaces the error's text about allowed values.
        """
        value = getattr(self, key)
        allowed_text = self.field_by_key()[key].metadata["allowed"]
        self.require(value is not None, key, requirement_text or f"given: {allowed_text}")
        return value

    def forbid_keys(self, keys: Iterable[str], circumstance: str) -> None:
        """Raise InputError if a key has another value than None or the default.

        ``circumstance`` completes the error: "[disk]" gives "left out with [disk]". A circumstance
        that begins with "without" gets no "with".
        """
        for key in keys:
            is_absent = getattr(self, key) in (None, self.field_by_key()[key].default)
            self.require(is_absent, key, f"left out {add_preposition(circumstance)}")

    @classmethod
    def suggest_keys(cls, key: str) -> list[str]:
        """Return full keys to suggest for an unknown key; empty without a similar key.

        Returned are similar keys in this table; otherwise the same key in other tables; otherwise
        similar keys in other tables.
        """
        table_classes = [
            cls,
            *(table_class for table_class in Table.__subclasses__() if table_class is not cls),
        ]
        own_full_keys = [
            cls.full_key_in_first_table(known_key)
            for known_key in find_similar_names(key, cls.field_by_key())
        ]
        if suggested_full_keys := own_full_keys or find_full_keys(key, table_classes):
            return suggested_full_keys
        table_class_by_key = {
            known_key: table_class
            for table_class in table_classes[::-1]
            for known_key in table_class.field_by_key()
        }
        return [
            table_class_by_key[known_key].full_key_in_first_table(known_key)
            for known_key in find_similar_names(key, table_class_by_key, 0.8)
        ]

    @classmethod
    def unknown_key_text(cls, key: str) -> str:
        """Return the text of an error for an unknown key: advice or suggestions, and all keys."""
        advice_text = (
            cls._ADVICE_TEXT_BY_MISTAKE.get(key) or did_you_mean_text(cls.suggest_keys(key)).strip()
        )
        return f"left out; {advice_text} known keys: {', '.join(cls.field_by_key())}".replace(
            ";  ", "; "
        )

    @classmethod
    def make_changes_with_twins_removed(
        cls, changes: Mapping[str, object], _current_values: Mapping[str, object]
    ) -> dict[str, Any]:
        """Return changes by key, in which the twin of each changed key becomes None.

        The twin is the same quantity in another unit. ``changes`` has new values by key. The
        present values are used by subclasses alone. Raises InputError if a key and its twin are
        both changed.
        """
        cls.forbid_both_twins(changes)
        twin_key_by_key = cls.twin_key_by_key()
        none_by_twin_key = {
            twin_key_by_key[key]: None
            for key in changes
            if twin_key_by_key.get(key, key) not in changes
        }
        return {**none_by_twin_key, **changes}

    @classmethod
    def forbid_both_twins(cls, value_by_key: Mapping[str, object]) -> None:
        """Raise InputError if both a key and its twin in another unit have a value."""
        for twin_key, si_key in cls.si_key_by_twin().items():
            if value_by_key.get(twin_key) is not None and value_by_key.get(si_key) is not None:
                raise InputError(
                    cls.full_key(twin_key),
                    value_by_key[twin_key],
                    f"left out with {cls.full_key(si_key)} = {value_by_key[si_key]}: "
                    "give one of the two",
                )

    @classmethod
    def from_mapping(cls, raw_table: object) -> Any:
        """Make the table from a mapping of keys to values, as read from TOML.

        Raises InputError for an unknown, missing or wrong key.
        """
        field_by_key = cls.field_by_key()
        if cls.KEY_OF_BARE_VALUE is not None and isinstance(raw_table, str):
            raw_table = {cls.KEY_OF_BARE_VALUE: raw_table}
        if not isinstance(raw_table, Mapping):
            keys_text = ", ".join(field_by_key)
            raise InputError(cls.full_key(), raw_table, f"a table with the keys {keys_text}")
        for key, raw_value in raw_table.items():
            if key not in field_by_key:
                raise InputError(cls.full_key(str(key)), raw_value, cls.unknown_key_text(str(key)))
        for key in cls.required_keys():
            if key not in raw_table:
                allowed_text = field_by_key[key].metadata["allowed"]
                raise InputError(cls.full_key(key), None, f"given: {allowed_text}")
        cls.forbid_both_twins(raw_table)
        return cls(**raw_table)


def find_full_keys(key: str, table_classes: Iterable[type[Table]]) -> list[str]:
    """Return full keys for a key, from each table class that has the key.

    Classes in which the key holds a list (default ``()``) come last.
    """
    classes_with_key = [
        table_class for table_class in table_classes if key in table_class.field_by_key()
    ]
    classes_with_key.sort(key=lambda table_class: table_class.field_by_key()[key].default == ())
    return [table_class.full_key_in_first_table(key) for table_class in classes_with_key]
