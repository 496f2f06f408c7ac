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
from typing import Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from fenics_crack.basics.errors import InputError
from fenics_crack.scene.fields import LARGEST
from fenics_crack.scene.scene import Scene

DataclassType = TypeVar("DataclassType")
Datasets = dict[str, Any]
DATASET_ERRORS = (
    LookupError, TypeError, ValueError, ArithmeticError, AttributeError, RecursionError,
    StopIteration,
)  # fmt: skip
"""Errors of a dataset that is not what its field is."""
_ARRAY_KINDS_BY_FIELD = {
    **dict.fromkeys(("multipliers", "bifurcation_multipliers", "forces"), "bifuc"),
    **dict.fromkeys(("indices", "indptr", "dofs", "cells", "cracks"), "iu"),
    **dict.fromkeys(("undecided", "irregular", "equivalent", "hidden"), "b"),
}
"""Kinds of the types of arrays by their fields, where not every real one is valid."""


def pack_dataclass(result: Any, *apart: str) -> Datasets:
    """Return the datasets of a dataclass, but for the fields ``apart``."""
    found: Datasets = {}
    for name in (item.name for item in fields(result) if item.name not in apart):
        value = getattr(result, name)
        if np.isscalar(value) or _is_array(value):
            found[name] = value
        elif value is not None and not isinstance(value, Scene) and not callable(value):
            found[name] = to_json_text(value, name, found)
    return found


def to_json_text(value: Any, name: str, arrays: Datasets) -> str:
    """Return a value as JSON text, without a scene in it; its arrays join some datasets, by names
    that begin with its own."""

    def plain(value: Any, name: str) -> Any:
        if is_dataclass(value):
            value = {item.name: getattr(value, item.name) for item in fields(value)}
        if isinstance(value, Mapping):
            items = ((key, one) for key, one in value.items() if not isinstance(one, Scene))
            return {str(key): plain(one, f"{name}.{key}") for key, one in items}
        if isinstance(value, tuple):
            return [plain(one, f"{name}.{place}") for place, one in enumerate(value)]
        if _is_array(value):
            arrays[name] = value
            return name
        return value.tolist() if isinstance(value, np.ndarray | np.generic) else value

    return json.dumps(plain(value, name))


def _is_array(value: Any) -> bool:
    """Return True if a value is an array of numbers; one of words may have more dimensions than a
    dataset of words."""
    return isinstance(value, np.ndarray) and value.dtype.kind != "U"


def unpack_dataclass(
    kind: type[DataclassType], parts: Mapping[str, Any], scene: Scene | None = None, **known: Any
) -> DataclassType:
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
    found: DataclassType = _DatasetReader(parts, scene).made(kind, parts, known)
    return found


def dataclass_from_json(kind: type[DataclassType], text: str, scene: Scene | None) -> DataclassType:
    """Return a dataclass from the JSON text of :func:`text_of`; raises as :func:`unpacked`."""
    found: DataclassType = _DatasetReader({}, scene).value(kind, text, "text")
    return found


_field_types = cache(get_type_hints)


class _DatasetReader(NamedTuple):
    """Values of declared types from the datasets and the scene of a file."""

    parts: Mapping[str, Any]
    scene: Scene | None

    def made(self, kind: Any, stored: Mapping[str, Any], known: Mapping[str, Any]) -> Any:
        """Return a dataclass from the values of its fields and those that are known."""
        found = dict(known)
        for item in fields(kind):
            needed = item.default is MISSING and item.default_factory is MISSING
            if item.name not in known and (needed or item.name in stored):
                value = stored.get(item.name)
                found[item.name] = self.value(_field_types(kind)[item.name], value, item.name)
        try:
            return kind(**found)
        except InputError as error:
            raise ValueError(str(error)) from None  # of the file, whose key is none of the scene's

    def value(self, kind: Any, stored: Any, name: str) -> Any:
        """Return the value of a field, or a part of it, from a dataset or what a text holds."""
        origin, inside = get_origin(kind), get_args(kind)
        composed = is_dataclass(kind) or origin in (dict, Mapping, tuple) or kind is np.ndarray
        if composed and isinstance(stored, str):
            stored = self.parts[stored] if stored in self.parts else json.loads(stored)
        if origin in (Union, UnionType):
            for one in inside:
                with suppress(*DATASET_ERRORS):
                    return self.value(one, stored, name)
        elif origin in (dict, Mapping) and isinstance(stored, dict):
            key, item = inside
            return {key(one): self.value(item, value, name) for one, value in stored.items()}
        elif origin is tuple and isinstance(stored, list):
            every = inside[:1] * len(stored) if inside[1:] == (...,) else inside
            pairs = zip(every, stored, strict=True)
            return tuple(self.value(one, value, name) for one, value in pairs)
        elif is_dataclass(kind) and isinstance(stored, dict):
            return self.made(kind, stored, {})
        elif kind is np.ndarray and isinstance(stored, list):
            return np.array(stored, dtype=str)
        elif origin is Literal and stored in inside:
            return stored
        elif kind is Scene:
            stored = self.scene
        elif kind is float and type(stored) is int:
            stored = float(stored)
        if kind is not Any and not (isinstance(kind, type) and isinstance(stored, kind)):
            raise ValueError(f"its {name} does not fit")
        return stored


def check_arrays(parts: Mapping[str, Any]) -> None:
    """Raise ValueError unless the numbers of all datasets are nan or can be computed with, of the
    kind of their field."""
    for name, array in parts.items():
        if isinstance(array, np.ndarray):
            kinds = _ARRAY_KINDS_BY_FIELD.get(name.rpartition(".")[2], "bifu")
            if array.dtype.kind not in kinds or np.any(np.abs(array) > LARGEST):
                raise ValueError(f"its {name} does not fit")
