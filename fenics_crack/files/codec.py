"""Dataclasses as the datasets of a file, and back.

A field is a dataset of its name: an array, a number or a text as it is; all else, tuples, dicts and
dataclasses within each other, as JSON text, in which an array is the name of a dataset of its own
("fits.1.candidates.orders"). None, functions and the scene, which the file has, are left out. What
is read has the types that the fields declare, and is nothing else: no class is named in a file.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from types import UnionType
from typing import (
    Any,
    Literal,
    NamedTuple,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

from fenics_crack.basics.errors import InputError
from fenics_crack.scene.fields import LARGEST
from fenics_crack.scene.scene import Scene

T = TypeVar("T")
Parts = dict[str, Any]
WRONG = (LookupError, TypeError, ValueError, ArithmeticError, AttributeError, RecursionError)
"""Errors of a dataset that is not what its field is."""
_ARRAYS = {
    **dict.fromkeys(("multipliers", "bifurcation_multipliers", "forces", "fundamental"), "bifuc"),
    **dict.fromkeys(("undecided", "jumps", "equivalent", "hidden"), "b"),
}
"""Kinds of the types of arrays by their fields, where not every real one is valid."""


def packed(result: Any, *apart: str) -> Parts:
    """Return the datasets of a dataclass, but for the fields ``apart``."""
    found: Parts = {}
    for name in (item.name for item in fields(result) if item.name not in apart):
        value = getattr(result, name)
        if (isinstance(value, np.ndarray) and value.dtype.kind != "U") or np.isscalar(value):
            found[name] = value
        elif value is not None and not isinstance(value, Scene) and not callable(value):
            found[name] = text_of(value, name, found)
    return found


def text_of(value: Any, name: str = "", arrays: Parts | None = None) -> str:
    """Return a value as JSON text; its arrays join some datasets, by names that begin with its own.

    A scene in it is left out.
    """

    def plain(value: Any, name: str) -> Any:
        if is_dataclass(value):
            kept = (item.name for item in fields(value))
            value = {one: getattr(value, one) for one in kept}
        if isinstance(value, Mapping):
            items = {str(one): item for one, item in value.items() if not isinstance(item, Scene)}
            return {one: plain(item, f"{name}.{one}") for one, item in items.items()}
        if isinstance(value, tuple | list):
            return [plain(item, f"{name}.{place}") for place, item in enumerate(value)]
        if not isinstance(value, np.ndarray):
            return value.item() if isinstance(value, np.generic) else value
        if value.dtype.kind == "U" or arrays is None:
            return value.tolist()
        arrays[name] = value
        return name

    return json.dumps(plain(value, name))


def unpacked(
    kind: type[T], parts: Mapping[str, Any], scene: Scene | None = None, **known: Any
) -> T:
    """Return a dataclass from the datasets of its fields; those of others are left alone.

    Parameters
    ----------
    kind : type
        Its class.
    parts : mapping
        Datasets by their names.
    scene : Scene, optional
        That of the file.
    **known
        Fields that are not in the file.

    Raises
    ------
    ValueError, LookupError and others of :data:`WRONG`
        A dataset is missing, or is not what its field is.
    """
    stored, declaring = {}, cast("Any", kind)
    for name, declared in _types(declaring).items():
        if name in parts:
            value = parts[name]
            is_json = isinstance(value, str) and not _is_text(declared)
            stored[name] = json.loads(value) if is_json else value
    found: T = _Reader(parts, scene).made(kind, stored, known)
    return found


def from_text(kind: type[T], text: str, scene: Scene | None = None) -> T:
    """Return a dataclass from the JSON text of :func:`text_of`; raises as :func:`unpacked`."""
    found: T = _Reader({}, scene).made(kind, json.loads(text), {})
    return found


def _is_text(kind: Any) -> bool:
    """Return True if a text of a type is a dataset as it is."""
    union = get_origin(kind) in (Union, UnionType)
    return kind is str or get_origin(kind) is Literal or (union and str in get_args(kind))


@cache
def _types(kind: Any) -> dict[str, Any]:
    """Return the declared types of a dataclass by its fields."""
    return get_type_hints(kind)


class _Reader(NamedTuple):
    """Values of declared types from the datasets and the scene of a file."""

    parts: Mapping[str, Any]
    scene: Scene | None

    def made(self, kind: Any, stored: Mapping[str, Any], known: Mapping[str, Any]) -> Any:
        """Return a dataclass from the values of its fields and those that are known."""
        found = dict(known)
        for item in fields(kind):
            name, declared = item.name, _types(kind)[item.name]
            needed = item.default is MISSING and item.default_factory is MISSING
            if name not in known and (needed or name in stored):
                found[name] = self.value(declared, stored.get(name), name)
        try:
            return kind(**found)
        except InputError as error:
            raise ValueError(str(error)) from None  # of the file, whose key is none of the scene's

    def value(self, kind: Any, stored: Any, name: str) -> Any:
        """Return the value of a field, or a part of it."""
        origin, inside = get_origin(kind), get_args(kind)
        if origin in (Union, UnionType):
            for one in inside:
                with suppress(*WRONG):
                    return self.value(one, stored, name)
        elif kind is np.ndarray:
            return _array(self.parts[stored] if isinstance(stored, str) else stored, name)
        elif origin in (dict, Mapping) and isinstance(stored, dict):
            key, item = inside
            return {key(one): self.value(item, value, name) for one, value in stored.items()}
        elif origin is tuple and isinstance(stored, list):
            every = inside[:1] * len(stored) if inside[1:] == (...,) else inside
            pairs = zip(every, stored, strict=True)
            return tuple(self.value(one, value, name) for one, value in pairs)
        elif kind is Scene:
            stored = self.scene
        elif is_dataclass(kind) and isinstance(stored, dict):
            return self.made(kind, stored, {})
        elif origin is Literal and stored in inside:
            return stored
        elif kind is float and type(stored) is int:
            stored = float(stored)
        if kind is not Any and not (isinstance(kind, type) and isinstance(stored, kind)):
            raise ValueError(f"its {name} does not fit")
        return stored


def _array(stored: Any, name: str) -> np.ndarray:
    """Return an array of a field, or of words."""
    if isinstance(stored, list):
        return np.array(stored, dtype=str)
    if not isinstance(stored, np.ndarray):
        raise ValueError(f"its {name} does not fit")
    return stored


def check_arrays(parts: Mapping[str, Any]) -> None:
    """Raise ValueError unless the numbers of all datasets are nan or can be computed with, of the
    kind of their field."""
    for name, array in parts.items():
        if isinstance(array, np.ndarray):
            kinds = _ARRAYS.get(name.rpartition(".")[2], "bifu")
            if array.dtype.kind not in kinds or np.any(np.abs(array) > LARGEST):
                raise ValueError(f"its {name} does not fit")
