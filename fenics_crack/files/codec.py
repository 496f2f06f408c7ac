"""Convert dataclasses to datasets in a file, and back.

Each field is a dataset with the field's name. An array, a number and a text are stored unchanged.
Tuples, dicts and dataclasses within each other become JSON text. An array in the text is the name
of a separate dataset ("fits.1.candidates.orders"). None, functions and the scene, which the file
has, are left out. When a file is read, each value must have its field's declared type: no class is
named in a file.
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
from fenics_crack.scene.fields import MAX_ALLOWED_MAGNITUDE
from fenics_crack.scene.scene import Scene

DataclassType = TypeVar("DataclassType")
Datasets = dict[str, Any]
DATASET_ERROR_CLASSES = (
    LookupError, TypeError, ValueError, ArithmeticError, AttributeError, RecursionError,
    StopIteration,
)  # fmt: skip
"""Error classes for a dataset that does not fit its field."""
_DTYPE_KINDS_BY_FIELD = {
    **dict.fromkeys(("multipliers", "bifurcation_multipliers", "forces"), "bifuc"),
    **dict.fromkeys(("indices", "indptr", "dofs", "cells", "cracks"), "iu"),
    **dict.fromkeys(("undecided", "irregular", "equivalent", "hidden"), "b"),
}
"""NumPy kinds (``dtype.kind``) by field name; fields not listed allow "bifu", real numbers."""
_FIND_UNKNOWN_BY_FIELD: dict[str, Any] = {
    **dict.fromkeys(("arrivals", "multipliers", "bifurcation_multipliers"), np.isnan),
    **dict.fromkeys(("coefficients", "covariance", "amplitudes", "amplitude_errors"), np.isnan),
    **dict.fromkeys(("omega_errors", "damping_errors"), np.isnan),
    "conditions": np.isinf,
}
"""Functions that find the numbers of an array that are not finite on purpose, by field name."""


def pack_dataclass(instance: Any, *omitted_names: str) -> Datasets:
    """Return a dataclass as datasets by field name, without the fields ``omitted_names``.

    Arrays, numbers and words are unchanged. Other values become JSON text; arrays inside them
    become further datasets. Fields that are None, a function or a scene are left out.
    """
    datasets: Datasets = {}
    for field_name in (field.name for field in fields(instance) if field.name not in omitted_names):
        field_value = getattr(instance, field_name)
        if np.isscalar(field_value) or _is_array_without_words(field_value):
            datasets[field_name] = field_value
        elif (
            field_value is not None
            and not isinstance(field_value, Scene)
            and not callable(field_value)
        ):
            datasets[field_name] = to_json_text(field_value, field_name, datasets)
    return datasets


def to_json_text(value: Any, dataset_name: str, array_by_name: Datasets) -> str:
    """Return a value as JSON text, and store arrays in the value separately.

    In the text, an array is replaced by a dataset name. A scene is left out, together with its key.

    Parameters
    ----------
    value
        Dataclass, mapping, tuple, array, number, word or None. Dataclasses, mappings and tuples may
        contain each other.
    dataset_name : str
        Field name for this value. An array within the value is named "name.key" or "name.index".
    array_by_name : dict
        Output: arrays by dataset name are added to this dict.
    """

    def to_json_value(value: Any, dataset_name: str) -> Any:
        """Return a value with dicts, lists, numbers and words only, as JSON requires.

        A numeric array is stored in ``array_by_name`` under the name ``dataset_name``. In the
        result, this name replaces the array. Scenes in a dict are left out.
        """
        if is_dataclass(value):
            value = {field.name: getattr(value, field.name) for field in fields(value)}
        if isinstance(value, Mapping):
            key_entry_pairs = (
                (key, entry) for key, entry in value.items() if not isinstance(entry, Scene)
            )
            return {
                str(key): to_json_value(entry, f"{dataset_name}.{key}")
                for key, entry in key_entry_pairs
            }
        if isinstance(value, tuple):
            return [
                to_json_value(entry, f"{dataset_name}.{entry_index}")
                for entry_index, entry in enumerate(value)
            ]
        if _is_array_without_words(value):
            array_by_name[dataset_name] = value
            return dataset_name
        return value.tolist() if isinstance(value, np.ndarray | np.generic) else value

    return json.dumps(to_json_value(value, dataset_name))


def _is_array_without_words(value: Any) -> bool:
    """Return True for a numeric NumPy array, and False for any other value.

    A numeric array is saved as an HDF5 dataset, an array with texts as JSON.
    """
    return isinstance(value, np.ndarray) and value.dtype.kind != "U"


def unpack_dataclass(
    dataclass_type: type[DataclassType],
    datasets: Mapping[str, Any],
    scene: Scene | None = None,
    **other_fields: Any,
) -> DataclassType:
    """Return a dataclass from datasets by field name.

    Datasets with other names than the class's fields are ignored.

    Parameters
    ----------
    dataclass_type : type
        Class to return.
    datasets : mapping
        Datasets by name.
    scene : Scene, optional
        Value for fields with the type Scene.
    **other_fields
        Field values by name, for fields without a dataset. A value given here is used even if a
        dataset has the same name.

    Raises
    ------
    ValueError, LookupError and others in :data:`DATASET_ERROR_CLASSES`
        A dataset is missing, or does not fit the field's type.
    """
    instance: DataclassType = _DatasetReader(datasets, scene).build_dataclass(
        dataclass_type, datasets, other_fields
    )
    return instance


def dataclass_from_json(
    dataclass_type: type[DataclassType], text: str, scene: Scene | None
) -> DataclassType:
    """Return a dataclass from JSON text by :func:`to_json_text`, without arrays.

    ``scene`` is the value for fields with the type Scene. Raises as :func:`unpack_dataclass`.
    """
    instance: DataclassType = _DatasetReader({}, scene).convert_value(dataclass_type, text, "text")
    return instance


_get_field_types = cache(get_type_hints)


class _DatasetReader(NamedTuple):
    """Hold a file's datasets and scene, and convert them to declared types."""

    datasets: Mapping[str, Any]
    scene: Scene | None

    def build_dataclass(
        self,
        dataclass_type: Any,
        stored_content_by_field: Mapping[str, Any],
        known_value_by_field: Mapping[str, Any],
    ) -> Any:
        """Return a dataclass from stored contents and known values, both by field name.

        Parameters
        ----------
        dataclass_type : type
            Class to return.
        stored_content_by_field : mapping
            Datasets, or values from a JSON text. Each is converted by :meth:`convert_value`.
        known_value_by_field : mapping
            Final values. If a field also has a stored content, the known value is used.
        """
        field_value_by_name = dict(known_value_by_field)
        for field in fields(dataclass_type):
            is_required = field.default is MISSING and field.default_factory is MISSING
            if field.name not in known_value_by_field and (
                is_required or field.name in stored_content_by_field
            ):
                stored_content = stored_content_by_field.get(field.name)
                field_value_by_name[field.name] = self.convert_value(
                    _get_field_types(dataclass_type)[field.name], stored_content, field.name
                )
        try:
            return dataclass_type(**field_value_by_name)
        except InputError as error:
            raise ValueError(str(error)) from None  # of the file, whose key is none of the scene's

    def convert_value(self, declared_type: Any, stored_content: Any, field_name: str) -> Any:
        """Convert a stored content to a field's declared type.

        ``stored_content`` is a dataset, or a value from a JSON text. ``field_name`` names the field
        in the ValueError for a wrong type.
        """
        generic_type, inner_types = get_origin(declared_type), get_args(declared_type)
        is_composed = (
            is_dataclass(declared_type)
            or generic_type in (dict, Mapping, tuple)
            or declared_type is np.ndarray
        )
        if is_composed and isinstance(stored_content, str):
            stored_content = (
                self.datasets[stored_content]
                if stored_content in self.datasets
                else json.loads(stored_content)
            )
        if generic_type in (Union, UnionType):
            for inner_type in inner_types:
                with suppress(*DATASET_ERROR_CLASSES):
                    return self.convert_value(inner_type, stored_content, field_name)
        elif generic_type in (dict, Mapping) and isinstance(stored_content, dict):
            key_type, entry_type = inner_types
            return {
                key_type(key): self.convert_value(entry_type, entry, field_name)
                for key, entry in stored_content.items()
            }
        elif generic_type is tuple and isinstance(stored_content, list):
            entry_types = (
                inner_types[:1] * len(stored_content) if inner_types[1:] == (...,) else inner_types
            )
            types_and_entries = zip(entry_types, stored_content, strict=True)
            return tuple(
                self.convert_value(inner_type, entry, field_name)
                for inner_type, entry in types_and_entries
            )
        elif is_dataclass(declared_type) and isinstance(stored_content, dict):
            return self.build_dataclass(declared_type, stored_content, {})
        elif declared_type is np.ndarray and isinstance(stored_content, list):
            return np.array(stored_content, dtype=str)
        elif generic_type is Literal and stored_content in inner_types:
            return stored_content
        elif declared_type is Scene:
            stored_content = self.scene
        elif declared_type is float and type(stored_content) is int:
            stored_content = float(stored_content)
        if declared_type is not Any and not (
            isinstance(declared_type, type) and isinstance(stored_content, declared_type)
        ):
            raise ValueError(f"its entry '{field_name}' has the wrong type")
        return stored_content


def check_arrays(datasets: Mapping[str, Any]) -> None:
    """Raise ValueError if an array from a file has a wrong NumPy type, or numbers not finite.

    Values above ``MAX_ALLOWED_MAGNITUDE`` and nan are refused, but for missing arrivals and for
    :data:`_FIND_UNKNOWN_BY_FIELD`. Indices must be whole numbers, for example, and flags must be
    True or False. ``datasets`` has arrays and other values by field name; only arrays are checked.
    """
    for name, array in datasets.items():
        if isinstance(array, np.ndarray):
            field_name = name.rpartition(".")[2]
            find_unknown = _FIND_UNKNOWN_BY_FIELD.get(
                "arrivals" if name.startswith("arrivals.") else field_name, np.zeros_like
            )
            if array.dtype.kind not in _DTYPE_KINDS_BY_FIELD.get(field_name, "bifu") or not np.all(
                (np.abs(array) <= MAX_ALLOWED_MAGNITUDE) | (find_unknown(array) != 0)
            ):
                raise ValueError(
                    f"its entry '{name}' has numbers of a wrong type, too large or not finite"
                )
