"""Keys of a scene in words, with their units; and by what scenes differ."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

from fenics_crack.basics.tables import format_quantity
from fenics_crack.scene.scene import LOOKED_AT, Scene, unit_of

WORDS = {
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
"""Words of the keys whose own words are not enough."""
WHOLE = ("rad/s", "rpm", "Hz", "kg/m^3", "N/m^3", "1/m", "1/s", "s", "degrees")
"""Units that take no prefix here."""


def key_in_words(key: str) -> str:
    """A key as an axis is named: "crack length"."""
    return WORDS.get(key, key.replace(".", " ").replace("_", " "))


def value_in_words(key: str, value: Any) -> str:
    """A value of a key with its unit: "35 mm"."""
    unit = unit_of(key)
    if isinstance(value, list | tuple):
        parts = [part for part in value if part != 0]
        if len(value) == 2 and len(parts) == 1 and key.startswith("excitation.force"):
            return value_in_words(key, parts[0])
        return " ".join(filter(None, (str(list(value)), unit)))
    if isinstance(value, bool) or not isinstance(value, float | int):
        return "none" if value is None else str(value)
    if unit in ("", *WHOLE) or value == 0:
        return f"{value:g} {unit}".rstrip()
    return format_quantity(float(value), unit)


def differences(scenes: Sequence[Scene]) -> list[str]:
    """List for each scene the values that are not the same in all: "excitation.force_sin = 20 N".

    Empty where all are equal. What a curve, a motion in time or a sweep ranges over is left aside
    unless nothing else differs.
    """
    found = [given_values(scene) for scene in scenes]
    keys = list(dict.fromkeys(key for one in found for key in one))
    values = [
        {key: one.get(key, _default(scene, key)) for key in keys}
        for scene, one in zip(scenes, found, strict=True)
    ]
    differ = [key for key in keys if any(one[key] != values[0][key] for one in values)]
    chosen = [key for key in differ if key.split(".")[0] not in LOOKED_AT] or differ
    return [
        ", ".join(f"{key} = {value_in_words(key, one[key])}" for key in chosen) for one in values
    ]


def faces_in_words(scene: Scene) -> str:
    """Return the word for what closes: crack faces, or pairs of matrices from elsewhere."""
    matrices = scene.structure is not None and scene.structure.model is None
    return "pairs" if matrices else "crack faces"


def given_values(scene: Scene) -> dict[str, Any]:
    """Return the values that a scene gives, by whole keys, "cracks.1.length"; no defaults."""
    return _flat(tomllib.loads(scene.as_toml()))


def _flat(tables: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """The values of nested tables by their whole keys; lists of tables are numbered from 1."""
    found: dict[str, Any] = {}
    for name, value in tables.items():
        inner = value
        if isinstance(value, list) and value and isinstance(value[0], dict):
            inner = {str(number): one for number, one in enumerate(value, 1)}
        if isinstance(inner, dict):
            found |= _flat(inner, f"{above}{name}.")
        else:
            found[f"{above}{name}"] = value
    return found


def _default(scene: Scene, key: str) -> Any:
    """The value of a key that a scene does not write; None if it has none."""
    value: Any = scene
    for name in key.split("."):
        if name.isdecimal():  # of a list of tables
            value = dict(enumerate(value or (), 1)).get(int(name))
        else:
            value = getattr(value, name, None)
    return list(value) if isinstance(value, tuple) else value
