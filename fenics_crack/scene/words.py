"""Labels and units for the keys of a scene, and descriptions of how scenes differ."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

from fenics_crack.basics.tables import format_quantity
from fenics_crack.scene.keys import RESULT_SETTINGS_TABLE_NAMES, unit_of_key
from fenics_crack.scene.scene import Scene

AXIS_LABEL_BY_SCENE_KEY = {
    "excitation.omega": "load frequency",
    "excitation.frequency": "load frequency",
    "excitation.order": "engine order",
    "rotation.speed": "rotor speed",
    "rotation.rpm": "rotor speed",
    "excitation.point": "point of the load",
    "excitation.force_sin": "load",
    "excitation.force_cos": "load, cosine part",
    "excitation.force_mean": "load, mean",
    "geometry.width": "width of the plate",
    "geometry.height": "height of the plate",
    "geometry.thickness": "thickness",
    "crack.height": "height of the crack",
    "crack.first_omega": "first natural frequency",
    "crack.first_frequency": "first natural frequency",
    "material.young": "Young's modulus",
    "material.poisson": "Poisson's ratio",
    "material.density": "density",
    "harmonic_balance.harmonics": "harmonics",
    "reduction.modes": "modes kept",
    "mesh.size": "element size",
}
"""Labels for axes and titles, by full key; a key without a label is shown by its own words."""
SCENE_UNITS_WITHOUT_PREFIX = ("rad/s", "rpm", "Hz", "kg/m^3", "N/m^3", "1/m", "1/s", "s", "degrees")
"""Units printed without an SI prefix such as milli or kilo."""


def key_in_words(key: str) -> str:
    """Return the label for a full key on an axis: "crack length" for "crack.length"."""
    return AXIS_LABEL_BY_SCENE_KEY.get(key, key.replace(".", " ").replace("_", " "))


def value_in_words(key: str, value: Any) -> str:
    """Return a key's value with the unit: "35 mm".

    None gives "none". A list gives all numbers. A force in a plane along x or y gives only the
    component that is not zero.
    """
    unit = unit_of_key(key)
    if isinstance(value, list | tuple):
        nonzero_components = [component for component in value if component != 0]
        if len(value) == 2 and len(nonzero_components) == 1 and key.startswith("excitation.force"):
            return value_in_words(key, nonzero_components[0])
        return " ".join(filter(None, (str(list(value)), unit)))
    if isinstance(value, bool) or not isinstance(value, float | int):
        return "none" if value is None else str(value)
    if unit in ("", *SCENE_UNITS_WITHOUT_PREFIX) or value == 0:
        return f"{value:g} {unit}".rstrip()
    return format_quantity(float(value), unit)


def describe_differences(scenes: Sequence[Scene]) -> list[str]:
    """Describe how scenes differ from each other: "excitation.force_sin = 20 N".

    Keys in tables that only choose results (:data:`RESULT_SETTINGS_TABLE_NAMES`) count only if no
    other key differs.

    Returns
    -------
    list of str
        For each scene, the differing keys with the scene's values; empty texts if all are equal.
    """
    file_value_dicts = [file_value_by_key(scene) for scene in scenes]
    all_keys = list(dict.fromkeys(key for value_by_key in file_value_dicts for key in value_by_key))
    compared_value_dicts = [
        {key: value_by_key.get(key, _default_value(scene, key)) for key in all_keys}
        for scene, value_by_key in zip(scenes, file_value_dicts, strict=True)
    ]
    differing_keys = [
        key
        for key in all_keys
        if any(
            value_by_key[key] != compared_value_dicts[0][key]
            for value_by_key in compared_value_dicts
        )
    ]
    reported_keys = [
        key for key in differing_keys if key.split(".")[0] not in RESULT_SETTINGS_TABLE_NAMES
    ] or differing_keys
    return [
        ", ".join(f"{key} = {value_in_words(key, value_by_key[key])}" for key in reported_keys)
        for value_by_key in compared_value_dicts
    ]


def word_for_crack_faces(scene: Scene) -> str:
    """Return the noun for crack faces in printed texts.

    The noun is "pairs" for matrices from files without nodes (``structure.model``), otherwise
    "crack faces".
    """
    has_matrices_alone = scene.structure is not None and scene.structure.model is None
    return "pairs" if has_matrices_alone else "crack faces"


def file_value_by_key(scene: Scene) -> dict[str, Any]:
    """Return the values that a scene's file would hold, by full key: "cracks.1.length".

    Default and inferred values are left out.
    """
    return _flatten_tables(tomllib.loads(scene.as_toml()))


def _flatten_tables(nested_tables: Mapping[str, Any], key_prefix: str = "") -> dict[str, Any]:
    """Return the values in nested tables by full key: "cracks.1.length".

    Positions in lists of tables start at 1. ``key_prefix`` is put before every key, "cracks.".
    """
    value_by_key: dict[str, Any] = {}
    for key, value in nested_tables.items():
        subtable = value
        if isinstance(value, list) and value and isinstance(value[0], dict):
            subtable = {str(list_position): table for list_position, table in enumerate(value, 1)}
        if isinstance(subtable, dict):
            value_by_key |= _flatten_tables(subtable, f"{key_prefix}{key}.")
        else:
            value_by_key[f"{key_prefix}{key}"] = value
    return value_by_key


def _default_value(scene: Scene, key: str) -> Any:
    """Return the value for a full key, if the scene's file does not set the key.

    The value is the default, or inferred from other keys. None if the scene has no such table.
    Tuples become lists.
    """
    value: Any = scene
    for key_part in key.split("."):
        if key_part.isdecimal():  # of a list of tables
            value = dict(enumerate(value or (), 1)).get(int(key_part))
        else:
            value = getattr(value, key_part, None)
    return list(value) if isinstance(value, tuple) else value
