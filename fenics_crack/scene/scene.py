"""The scene: everything that defines a computation, validated, frozen, in SI units.

A scene is a TOML file (see ``demos/paper_plate.toml``) or a tree of the dataclasses in
:mod:`fenics_crack.scene.tables`. A value that a key may not hold raises :class:`InputError` with
key, value and requirement, before any computation.
"""

from __future__ import annotations

import dataclasses
import math
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

from fenics_crack.basics.errors import InputError, report_read_errors
from fenics_crack.basics.observables import OBSERVABLES_BY_NAME, Observable, ObservableFlag, Place
from fenics_crack.basics.suggestions import (
    check_calls,
    convert_to_unit_or_none,
    did_you_mean_text,
    find_similar_names,
    find_similar_or_longer_names,
    format_scene_value,
    with_old_names,
)
from fenics_crack.basics.tables import (
    RAD_PER_S_PER_RPM,
    RAD_PER_TURN,
    choose_frequency_factor_name_unit,
)
from fenics_crack.basics.untrusted_files import read_utf8_text
from fenics_crack.scene import tables as kinds
from fenics_crack.scene.fields import (
    Axis,
    NamedPoint,
    Table,
    describe_components,
    find_full_keys,
    use_table_name_in_errors,
)

MANY_SOLUTION_TABLE_NAMES = ("curve", "sweep", "growth", "identify")
"""Settings tables for the commands that solve a scene many times."""
RESULT_TABLE_NAMES = ("curve", "integration", "sweep", "growth", "identify", "tip_timing", "output")
"""Tables that only choose results and do not change the structure or its load."""

PLATE_TABLE_NAMES = (
    "geometry", "material", "mesh", "crack", "cracks", "loads", "base", "rotation", "disk",
)  # fmt: skip
"""Tables for a plate or solid; forbidden with [structure], whose matrices replace them."""
MAX_ALLOWED_SIDE_RATIO = 1e4
"""Maximum ratio of width or thickness to the height, or of the height to either side."""


@with_old_names(
    all_cracks="crack_by_name",
    at_rest="without_rotation",
    axis="axis_point_and_direction",
    damped_modes="n_damped_modes",
    has_element_lengths="has_graded_lengths",
    in_hertz="is_frequency_in_hertz",
    in_rpm="is_speed_in_rpm",
    point_names="label_by_point_name",
    points="output_points",
    swept="swept_values_by_key",
)
@dataclass(frozen=True, repr=False)
class Scene:
    """A cracked structure, the load, and the settings for computing the vibration.

    Each table in the file is an attribute, and each key an attribute of the table:
    ``scene.material.young``. All keys are under "Keys of a scene" in the reference. SI units;
    frequencies given in Hz are there in rad/s too. An omitted table is None or has default values.
    With the table ``structure`` the tables of a plate are None.

    Raises
    ------
    InputError
        A table is missing or has a key that cannot be used.
    """

    geometry: kinds.Geometry = None  # type: ignore[assignment]
    material: kinds.Material = None  # type: ignore[assignment]
    damping: kinds.Damping = None  # type: ignore[assignment]
    excitation: kinds.Excitation = None  # type: ignore[assignment]
    mesh: kinds.Mesh = None  # type: ignore[assignment]
    contact: kinds.Contact | None = None
    crack: kinds.Crack | None = None
    cracks: tuple[kinds.Crack, ...] = ()
    """Cracks in addition to ``crack``."""
    loads: tuple[kinds.Load, ...] = ()
    """Loads in addition to the excitation's force."""
    base: kinds.Base | None = None
    rotation: kinds.Rotation | None = None
    disk: kinds.Disk | None = None
    structure: kinds.Structure | None = None
    harmonic_balance: kinds.HarmonicBalance = field(default_factory=kinds.HarmonicBalance)
    reduction: kinds.Reduction | None = None
    curve: kinds.Curve | None = None
    integration: kinds.Integration | None = None
    sweep: kinds.Sweep | None = None
    growth: kinds.Growth | None = None
    identify: kinds.Identify | None = None
    tip_timing: kinds.TipTiming | None = None
    output: kinds.Output | None = None

    def __post_init__(self) -> None:
        for table_name, table_class in _TABLE_CLASS_BY_NAME.items():
            table = getattr(self, table_name)
            if table_name in _LIST_TABLE_NAMES:
                has_right_type = isinstance(table, tuple) and all(
                    isinstance(list_element, table_class) for list_element in table
                )
            else:
                may_be_missing = table is None and (
                    table_name in _OPTIONAL_TABLE_NAMES
                    or _is_replaced_by_matrices(self, table_name)
                )
                has_right_type = isinstance(table, table_class) or may_be_missing
            if not has_right_type:
                if table is None:
                    raise missing_table_error(table_name)
                raise InputError(table_name, table, _describe_table_type(table_name, table))
        if self.rotation is not None:
            self.rotation.check_axis_position(self.disk)
        if self.excitation.order is not None and (self.disk is None or self.speed > 0.0):
            requirement_text = "left out without a rotation.speed > 0"
            self.excitation.require(self.speed > 0.0, "order", requirement_text)
            object.__setattr__(self, "excitation", self.excitation.at_speed(self.speed))
        harmonic_balance = self.harmonic_balance.with_load_harmonics(self.highest_order)
        object.__setattr__(self, "harmonic_balance", harmonic_balance)
        contact_has_friction = self.contact is not None and bool(self.contact.friction)
        harmonic_balance.require(
            harmonic_balance.form == "condensed" or not contact_has_friction,
            "form",
            "'condensed' with contact.friction",
        )
        if self.curve is not None and self.curve.parameter_and_range[0] == "speed":
            requirement_text = (
                "used with excitation.order, by which the load's frequency follows the speed"
            )
            self.curve.require(self.excitation.order is not None, "parameter", requirement_text)
        if self.curve is not None and self.curve.parameter_and_range[0] == "load":
            requirement_text = (
                "another parameter with a rotation.speed > 0, as the mean load is partly "
                "centrifugal; or add curve.at = 'resonance', which keeps the mean load"
            )
            self.curve.require(self.speed == 0.0, "parameter", requirement_text)
        if self.integration is not None and self.rotation is not None:
            circumstance = "[rotation]: the mean load is partly centrifugal"
            self.integration.forbid_keys(("deflection", "free"), circumstance)
        if self.structure is not None:
            _check_tables_beside_matrices(self, self.structure)
        else:
            _check_dimension(self)
            if self.geometry.file is not None:
                _check_cad_part(self)
            else:
                (_forbid_keys_of_mesh_file if self.mesh.layout == "file" else _check_plate)(self)
            if self.disk is not None:
                _check_disk(self, self.disk)
        for quantity_name in self.quantities or ():
            refusal_reason = _reason_without_observable(self, OBSERVABLES_BY_NAME[quantity_name])
            refuse_for_reason(refusal_reason, "output.quantities", quantity_name)
        for table_name, axes_key in _AXES_TABLE_KEY_PAIRS:
            if (axes_table := getattr(self, table_name)) is not None:
                checked_axes = _check_and_convert_axes(
                    self, f"{table_name}.{axes_key}", getattr(axes_table, axes_key)
                )
                object.__setattr__(
                    self, table_name, dataclasses.replace(axes_table, **{axes_key: checked_axes})
                )
        if self.identify is not None and (self.mesh is None or self.mesh.layout != "file"):
            requirement_text = "left out without mesh.layout = 'file'"
            self.identify.require(not self.identify.meshes, "meshes", requirement_text)
            self.identify.forbid_keys(("uncracked",), "without mesh.layout = 'file'")

    def __repr__(self) -> str:
        return f"Scene({_describe_scene(self)})"

    @property
    def crack_by_name(self) -> dict[str, kinds.Crack]:
        """Cracks by name: "crack", "cracks.1", "cracks.2"."""
        first_crack_by_name = {} if self.crack is None else {"crack": self.crack}
        return first_crack_by_name | {
            f"cracks.{crack_number}": crack for crack_number, crack in enumerate(self.cracks, 1)
        }

    @classmethod
    @check_calls
    def from_mapping(
        cls,
        tables: Mapping[str, object],
        folder: Path = Path(),
        changes: Mapping[str, object] | None = None,
    ) -> Scene:
        """Make a scene from nested mappings.

        ``tables`` holds tables by name, as read from TOML. Relative paths in the tables are taken
        from ``folder``. ``changes`` are full keys and values as in :meth:`replace`, applied before
        any check; paths in ``changes`` stay unchanged.
        """
        changes = changes or {}
        tables = _with_changed_keys(tables, changes)
        for table_name, raw_table in tables.items():
            if table_name not in _TABLE_CLASS_BY_NAME:
                raise InputError(table_name, raw_table, _unknown_table_text(table_name))
        tables_by_name = {
            table_name: _make_table_or_tuple(table_name, raw_table)
            for table_name, raw_table in tables.items()
        }
        scene = with_file_paths(cls(**tables_by_name), lambda path: str(folder / path))
        return scene.replace(
            {
                changed_key: changes[changed_key]
                for changed_key in changes
                if changed_key in _KEYS_WITH_PATHS
            }
        )

    @classmethod
    @check_calls
    def load(cls, path: str | Path, changes: Mapping[str, object] | None = None) -> Scene:
        """Read a scene from a TOML file.

        ``changes`` are keys and values as in :meth:`replace`; they may replace wrong values in the
        file.

        Raises
        ------
        InputError
            The file cannot be read, is not TOML, or holds a value that cannot be used.
        """
        with report_read_errors("scene", path, "a TOML file"):
            return cls.from_text(read_utf8_text(path), str(path), Path(path).parent, changes)

    @classmethod
    def from_text(
        cls,
        text: str,
        name: str = "given as text",
        folder: Path = Path(),
        changes: Mapping[str, object] | None = None,
    ) -> Scene:
        """Make a scene from TOML text.

        Errors name the text by ``name``. Relative paths in the text are taken from ``folder``.
        ``changes`` are full keys and values as in :meth:`replace`.
        """
        with report_read_errors("scene", name, "a TOML file"):
            try:
                raw_table_by_name = tomllib.loads(text)
            except tomllib.TOMLDecodeError as error:
                requirement_text = f"a TOML file ({error}){_make_line_fix_text(text, str(error))}"
                raise InputError("scene", name, requirement_text) from error
        return cls.from_mapping(raw_table_by_name, folder, changes)

    @classmethod
    def schema(cls) -> dict[str, Any]:
        """Return all tables and keys as a JSON schema, for editors that check TOML.

        Examples
        --------
        >>> sorted(fc.Scene.schema()["properties"]["material"]["required"])
        ['density', 'poisson', 'young']
        """
        schema_by_table = {
            table_name: table_class.schema()
            for table_name, table_class in _TABLE_CLASS_BY_NAME.items()
        }
        list_schema_by_table = {
            table_name: {"type": "array", "items": schema_by_table[table_name]}
            for table_name in _LIST_TABLE_NAMES
        }
        return {
            "$schema": "http://json-schema.org/draft-07/schema#",
            "type": "object",
            "properties": schema_by_table | list_schema_by_table,
            "additionalProperties": False,
        }

    @property
    def dimension(self) -> int:
        """Number of space dimensions: 2 or 3.

        3 for a solid and for matrices with another program's model; 2 for a plate and for matrices
        without a model.
        """
        if self.structure is not None:
            return 2 if self.structure.model is None else 3
        return 2 if self.geometry is None else self.geometry.dimension

    @property
    def has_graded_lengths(self) -> bool:
        """True if element lengths follow from the distances to crack tips and corners.

        This holds for a solid, and for a bladed disk's sector with ``mesh.layout = "graded"``.
        """
        return self.dimension == 3 or (self.disk is not None and self.mesh.layout == "graded")

    @property
    def has_friction(self) -> bool:
        """True if ``contact.friction`` is above 0, also in a swept case only."""
        contact_has_friction = self.contact is not None and bool(self.contact.friction)
        return contact_has_friction or any(self.swept_values_by_key.get("contact.friction", ()))

    @property
    def highest_order(self) -> int:
        """Highest multiple of the excitation frequency in any load."""
        periodic_loads: list[kinds.PeriodicLoad | None] = [self.excitation, *self.loads, self.base]
        return max(
            periodic_load.highest_order
            for periodic_load in periodic_loads
            if periodic_load is not None
        )

    @property
    def has_other_loads(self) -> bool:
        """True if a load other than the force at ``excitation.point`` may act."""
        return bool(self.loads) or self.base is not None or self.structure is not None

    def given(self, name: str) -> Any:
        """Return the table ``name`` for a command that needs the table.

        Raises InputError if the table is missing, or if ``harmonic_balance.form`` is "block" and
        the command solves many times (:data:`MANY_SOLUTION_TABLE_NAMES`).
        """
        if getattr(self, name) is None:
            raise missing_table_error(name, ", which this command needs")
        has_condensed_form = self.harmonic_balance.form == "condensed"
        requirement_text = f"'condensed' for a command that uses [{name}]"
        self.harmonic_balance.require(
            has_condensed_form or name not in MANY_SOLUTION_TABLE_NAMES, "form", requirement_text
        )
        return getattr(self, name)

    @property
    def speed(self) -> float:
        """Rotor speed [rad/s]; 0 without [rotation]."""
        return 0.0 if self.rotation is None else self.rotation.speed

    def _is_key_given_or_varied(self, full_key: str) -> bool:
        """Return True if a full key is given, or varied by [curve] or [sweep]."""
        table_name, key_in_table = full_key.split(".")
        is_given = getattr(getattr(self, table_name), key_in_table, None) is not None
        is_curve_parameter = self.curve is not None and self.curve.parameter == key_in_table
        return is_given or is_curve_parameter or full_key in self.swept_values_by_key

    @property
    def is_speed_in_rpm(self) -> bool:
        """True if results show the rotor speed in revolutions per minute.

        The speed is given, swept or followed by a curve as ``rpm``.
        """
        return self._is_key_given_or_varied("rotation.rpm")

    @property
    def is_frequency_in_hertz(self) -> bool:
        """True if results show the load frequency in Hz.

        The frequency is given, swept or followed by a curve in Hz, or it follows from an engine
        order and a speed in rpm.
        """
        has_order_and_rpm = self.excitation.order is not None and self.is_speed_in_rpm
        return has_order_and_rpm or self._is_key_given_or_varied("excitation.frequency")

    @property
    def quantities(self) -> tuple[str, ...] | None:
        """Names in ``output.quantities``; None if the scene does not choose quantities."""
        return None if self.output is None else self.output.quantities

    @property
    def output_points(self) -> tuple[NamedPoint, ...]:
        """Points in ``[output.points]``; empty without such points."""
        return () if self.output is None else self.output.points

    @property
    def label_by_point_name(self) -> dict[str, str]:
        """Labels for output points: "x displacement of tip" for the name "tip.ux"."""
        return {
            f"{point.key}.u{axis_letter}": f"{axis_letter} displacement of {point.key}"
            for point in self.output_points
            for axis_letter in "xyz"[: self.dimension]
        }

    def without_rotation(self) -> Scene:
        """Return the scene at rest, with the same load frequency.

        The tables [rotation], [curve] and [sweep] are removed. A bladed disk keeps the engine
        order, which sets the load's phase on each blade.
        """
        value_by_changed_key: dict[str, object] = {"rotation": None, "curve": None, "sweep": None}
        if self.excitation.order is not None:
            value_by_changed_key["excitation.omega"] = self.excitation.omega
            if self.disk is not None:  # whose order gives the phases
                value_by_changed_key["excitation.order"] = self.excitation.order
        return self.replace(value_by_changed_key)

    @property
    def swept_values_by_key(self) -> dict[str, tuple[Any, ...]]:
        """Values on each axis in the sweep, by full key; empty without a sweep."""
        return {} if self.sweep is None else {axis.key: axis.values for axis in self.sweep.over}

    @property
    def swept_omegas(self) -> tuple[float, ...]:
        """Load frequencies in all cases of the sweep [rad/s].

        Without a sweep, or if the sweep keeps the frequency, only the excitation's frequency.
        """
        swept_values_by_key = self.swept_values_by_key
        if "excitation.frequency" in swept_values_by_key:
            return tuple(
                RAD_PER_TURN * frequency
                for frequency in swept_values_by_key["excitation.frequency"]
            )
        orders = swept_values_by_key.get("excitation.order", (self.excitation.order,))
        if None in orders or "excitation.omega" in swept_values_by_key:  # this in place of an order
            return swept_values_by_key.get("excitation.omega", (self.excitation.omega,))
        speeds = tuple(
            RAD_PER_S_PER_RPM * rpm for rpm in swept_values_by_key.get("rotation.rpm", ())
        ) or (self.speed,)
        speeds = swept_values_by_key.get("rotation.speed", speeds)
        return tuple(order * speed for order in orders for speed in speeds)

    @property
    def axis_point_and_direction(self) -> tuple[np.ndarray, np.ndarray]:
        """Point on the rotor axis [m] and the axis's unit vector, (3,) each.

        The scene has [rotation] or [disk].
        """
        if self.disk is None:
            assert self.rotation is not None
            geometry_sides = self.geometry.sides
            return self.rotation.locate_axis(
                0.5 * np.array(geometry_sides if len(geometry_sides) == 3 else np.zeros(3))
            )
        is_plane, direction = self.dimension == 2, np.array(self.disk.axis or (1.0, 0.0, 0.0))
        if self.mesh.layout == "file":
            axis_point = [*(self.disk.center or (0.0,)), 0.0, 0.0][:3]
        else:
            axis_y = -self.disk.given("outer_radius")
            blade_center_coordinate = 0.5 * self.geometry.circumferential_width
            axis_point = (
                [blade_center_coordinate, axis_y, 0.0]
                if is_plane
                else [0.0, axis_y, blade_center_coordinate]
            )
        if is_plane:
            direction = np.array([0.0, 0.0, 1.0])
        return np.array(axis_point), direction / np.linalg.norm(direction)

    @property
    def modes_key(self) -> str:
        """Key for the number of modes: "reduction.modes", or with [disk] "disk.families"."""
        return "reduction.modes" if self.disk is None else "disk.families"

    @property
    def n_damped_modes(self) -> int | str:
        """Number of damped modes; "all" for every mode and for a damping matrix."""
        return "all" if self.damping is None else self.damping.modes

    @partial(check_calls, find_scene_keys=lambda misspelt_name: suggest_full_keys(misspelt_name))
    def replace(self, values: Mapping[str, object]) -> Scene:
        """Return a scene with some keys changed: ``scene.replace({"contact.stiffness": 1e9})``.

        A missing optional table is made; ``{"crack": None}`` removes a table. Tables of a list are
        counted from 1, ``{"cracks.1.length": 0.02}``; the number after the last makes a new table.
        A frequency in Hz replaces the frequency in rad/s, and vice versa.
        """
        table_by_name = {
            scene_field.name: getattr(self, scene_field.name) for scene_field in fields(self)
        }
        changed_table_by_name = _with_changed_keys(
            {table_name: table for table_name, table in table_by_name.items() if table}, values
        )
        return Scene(
            **{
                table_name: _make_table_or_tuple(table_name, raw_table)
                for table_name, raw_table in changed_table_by_name.items()
            }
        )

    def as_toml(self) -> str:
        """Return the scene as a TOML text for :meth:`load`, with unchanged paths."""
        table_texts = []
        for table_name, table_class in _TABLE_CLASS_BY_NAME.items():
            tables = getattr(self, table_name)
            if table_name in _LIST_TABLE_NAMES:
                header = f"[{table_class.full_key()}]"
                table_texts += [
                    table.as_toml().replace(header, f"[[{table_name}]]", 1) for table in tables
                ]
            elif tables is not None:
                table_texts.append(tables.as_toml())
        return "\n".join(table_texts)


def _describe_table_type(table_name: str, table: object) -> str:
    """Return the requirement on a table's type, for an error about ``table``."""
    type_text = "a tuple of" if table_name in _LIST_TABLE_NAMES else "of the class"
    advice_text = "; to read the file of a scene, use Scene.load(path)"
    class_name = _TABLE_CLASS_BY_NAME[table_name].__name__
    return f"{type_text} {class_name}{advice_text * isinstance(table, str | Path)}"


def missing_table_error(table_name: str, circumstance: str = "") -> InputError:
    """Return the error for a missing table, which names the table's required keys.

    ``circumstance`` is appended to the requirement: ", which this command needs".
    """
    keys_text = ", ".join(_TABLE_CLASS_BY_NAME[table_name].required_keys())
    requirement_text = f"given: a table [{table_name}]{' with ' * bool(keys_text)}{keys_text}"
    return InputError(table_name, None, requirement_text + circumstance)


def _is_replaced_by_matrices(scene: Scene, table_name: str) -> bool:
    """Return True if [structure] replaces a table, which may then be None.

    ``structure.damping`` replaces the table [damping].
    """
    if scene.structure is None:
        return False
    return table_name in PLATE_TABLE_NAMES or (
        table_name == "damping" and scene.structure.damping is not None
    )


def reason_without_stress_intensity(scene: Scene) -> str:
    """Return why stress intensity factors cannot be computed; empty if they can."""
    if scene.structure is not None:
        return "with [structure]: stress intensities need a mesh"
    if scene.disk is not None:
        return "with [disk]: stress intensities are not computed for bladed disks"
    if not scene.crack_by_name and (scene.contact is None or scene.mesh.layout != "file"):
        return "without a crack: stress intensities belong to crack tips"
    if scene.has_friction:
        return "with contact.friction: stress intensities neglect friction forces on crack faces"
    if any(crack.clearance < 0.0 for crack in scene.crack_by_name.values()):
        return "with crack.clearance < 0: a wedge up to the tip makes K infinite"
    return ""


def reason_without_elliptical_growth(scene: Scene) -> str:
    """Return why a scene's crack cannot grow as an ellipse; empty if it can."""
    if scene.crack is None or not scene.crack.is_elliptical or scene.cracks:
        return "without a single crack that has crack.front = 'elliptical' or crack.point"
    return reason_without_stress_intensity(scene)


def reason_without_clamp_forces(scene: Scene) -> str:
    """Return why the forces on the clamp cannot be computed; empty if they can."""
    if scene.structure is not None:
        return "with [structure]: clamp forces need a mesh"
    if scene.disk is not None:
        return "with [disk]: clamp forces are not computed for bladed disks"
    if scene.rotation is not None:
        return "with [rotation]: clamp forces are computed without rotation only"
    return ""


def refuse_for_reason(reason: str, key: str, value: object = None) -> None:
    """Raise InputError for a key and value unless ``reason`` is an empty text.

    The reason begins with "with" or "without", as it follows "left out" in the error.
    """
    if reason:
        raise InputError(key, value, f"left out {reason}")


def _reason_without_observable(scene: Scene, observable: Observable) -> str:
    """Return why a scene cannot give an observable; an empty text if the scene can."""
    if ObservableFlag.REQUIRES_FRICTION in observable.flags and not scene.has_friction:
        return "without contact.friction"
    if ObservableFlag.REQUIRES_GROWTH_LAW in observable.flags and scene.growth is None:
        return "without a table [growth], whose exponent it needs"
    if ObservableFlag.REQUIRES_SOLID in observable.flags and (
        scene.structure is not None or scene.dimension == 2
    ):
        return "without geometry.kind = 'solid'"
    return (
        _REASON_FUNCTION_BY_PLACE[observable.place](scene)
        if observable.place in _REASON_FUNCTION_BY_PLACE
        else ""
    )


def list_requested_extra_quantities(scene: Scene) -> tuple[str, ...]:
    """Return the names in ``output.quantities`` that are computed only on request.

    The observable's place determines this (``Place.is_made_on_request``).
    """
    return tuple(
        quantity_name
        for quantity_name in scene.quantities or ()
        if OBSERVABLES_BY_NAME[quantity_name].place.is_made_on_request
    )


_REASON_FUNCTION_BY_PLACE: dict[Place, Callable[[Scene], str]] = {
    Place.TIPS: reason_without_stress_intensity,
    Place.ELLIPSE: reason_without_elliptical_growth,
    Place.CLAMP: reason_without_clamp_forces,
}
"""Functions by place of an observable: why a scene cannot give it, or an empty text."""


def file_keys_and_paths(scene: Scene) -> list[tuple[str, str]]:
    """Return (full key, path) for each file that defines the structure or its load.

    Paths in the sweep are included. Files in tables that only choose results
    (:data:`RESULT_TABLE_NAMES`) are left out.
    """
    keys_and_paths = [
        key_and_path
        for key_and_path in _path_by_key(scene).items()
        if not key_and_path[0].startswith(RESULT_TABLE_NAMES)
    ]
    for key, axis_values in scene.swept_values_by_key.items():
        if key in _PATH_KEYS:
            keys_and_paths += [(key, path) for path in axis_values if isinstance(path, str)]
    return keys_and_paths


def _path_by_key(scene: Scene) -> dict[str, str]:
    """Return a scene's file paths by full key.

    Paths in ``sweep.over``, ``identify.unknown`` and ``identify.meshes`` are left out.
    """
    split_keys = ((full_key, *full_key.split(".")) for full_key in _PATH_KEYS)
    path_or_none_by_key = {
        full_key: getattr(getattr(scene, table_name), key_in_table, None)
        for full_key, table_name, key_in_table in split_keys
    }
    return {
        full_key: path_or_none
        for full_key, path_or_none in path_or_none_by_key.items()
        if isinstance(path_or_none, str)
    }


def with_file_paths(scene: Scene, change_path: Callable[[str], str]) -> Scene:
    """Return the scene with every file path replaced by ``change_path(path)``.

    Paths in ``sweep.over``, ``identify.unknown`` and ``identify.meshes`` change, too.
    """
    path_by_key = _path_by_key(scene)
    if not path_by_key:
        return scene
    changes: dict[str, object] = {
        path_key: change_path(path) for path_key, path in path_by_key.items()
    }

    def change_axis_paths(axis: Axis) -> Axis:
        axis_values = (
            change_path(axis_value) if isinstance(axis_value, str) else axis_value
            for axis_value in axis.values
        )
        return Axis(axis.key, tuple(axis_values)) if axis.key in _PATH_KEYS else axis

    for table_name, axes_key in _AXES_TABLE_KEY_PAIRS:
        if (table := getattr(scene, table_name)) is not None:
            changes[f"{table_name}.{axes_key}"] = tuple(
                map(change_axis_paths, getattr(table, axes_key))
            )
    if scene.identify is not None and scene.identify.meshes:
        changed_mesh_files = (
            dataclasses.replace(mesh_file, key=change_path(mesh_file.key))
            for mesh_file in scene.identify.meshes
        )
        changes["identify.meshes"] = tuple(changed_mesh_files)
    return scene.replace(changes)


def _describe_scene(scene: Scene) -> str:
    """Describe the structure, its cracks, and the load frequency."""
    if scene.structure is not None:
        phrases = [f"matrices {scene.structure.stiffness!r}"]
    elif scene.mesh.layout == "file":
        phrases = [f"mesh {scene.mesh.file!r}"]
    elif scene.geometry.file is not None:
        phrases = [f"part {scene.geometry.file!r}"]
    else:
        sides_text = " x ".join(f"{side:g}" for side in scene.geometry.sides)
        phrases = [f"{scene.geometry.kind} of {sides_text} m"]
    for crack in scene.crack_by_name.values():
        phrases.append("crack" if crack.length is None else f"crack of {crack.length:g} m")
    if scene.contact is not None:
        phrases.append(scene.contact.law)
    frequency_factor, _, frequency_unit = choose_frequency_factor_name_unit(
        scene.is_frequency_in_hertz
    )
    return f"{', '.join(phrases)}, {frequency_factor * scene.excitation.omega:g} {frequency_unit}"


def _make_line_fix_text(toml_text: str, error_text: str) -> str:
    """Return a suggested correction for the line number in a TOML error.

    ``error_text`` contains "at line 3". The correction is a number in SI units, for "5 mm", or a
    word in quotes; the text is empty without a correction.
    """
    toml_lines, line_match = toml_text.splitlines(), re.search(r"at line (\d+)", error_text)
    if line_match is None or int(line_match[1]) > len(toml_lines):
        return ""
    lines_up_to_error = toml_lines[: int(line_match[1])]
    toml_line = toml_lines[int(line_match[1]) - 1]
    table_headers = [
        toml_line.strip("[ ]") for toml_line in lines_up_to_error if toml_line.startswith("[")
    ]
    key, _, value_text = (
        line_part.strip() for line_part in toml_line.partition("#")[0].partition("=")
    )
    si_value = convert_to_unit_or_none(
        value_text.strip("\"'"), unit_of_key(".".join([*table_headers[-1:], key]))
    )
    if si_value is None and not value_text.isidentifier():
        return ""
    corrected_value_text = f'"{value_text}"' if si_value is None else format_scene_value(si_value)
    return f"; {did_you_mean_text([f'{key} = {corrected_value_text}'])}".rstrip()


def known_keys() -> list[str]:
    """Return every full key that a scene may have.

    Keys in lists of tables are named for the first table: "cracks.1.length".
    """
    named_table_classes = [
        (f"{table_name}.1" if table_name in _LIST_TABLE_NAMES else table_name, table_class)
        for table_name, table_class in _TABLE_CLASS_BY_NAME.items()
    ]
    return [
        f"{table_name}.{key_in_table}"
        for table_name, table_class in named_table_classes
        for key_in_table in table_class.field_by_key()
    ]


def unit_of_key(full_key: str) -> str:
    """Return the unit for a full key, "cracks.1.length"; empty without a unit."""
    table_name, _, key_in_table = _split_key(full_key)
    field_by_key = (
        _TABLE_CLASS_BY_NAME[table_name].field_by_key()
        if table_name in _TABLE_CLASS_BY_NAME
        else {}
    )
    return str(field_by_key[key_in_table].metadata["unit"]) if key_in_table in field_by_key else ""


# --- what tables must not contradict --------------------------------------------------------------


def _check_tables_beside_matrices(scene: Scene, structure: kinds.Structure) -> None:
    """Check a scene's tables against the matrices in [structure].

    Vectors get the scene's dimension. Raises InputError for tables of a plate, for a missing load
    or contact table, and for keys that need contact pairs or a model.
    """
    _forbid_tables(scene, PLATE_TABLE_NAMES, "[structure]")
    if structure.damping is not None:
        _forbid_tables(scene, ("damping",), "structure.damping")
    if structure.model is None:
        force_key = scene.excitation.first_force_key
        requirement_text = (
            "left out with [structure] without structure.model: give the load by "
            "structure.force_sin, structure.force_cos or structure.force_mean"
        )
        has_no_force = not force_key and scene.excitation.point is None
        scene.excitation.require(has_no_force, force_key or "point", requirement_text)
        matrix_paths = structure.mass, structure.stiffness, structure.damping or ""
        if not any(
            Path(matrix_path).suffix.lower() in (".sti", ".mas") for matrix_path in matrix_paths
        ):
            structure.forbid_keys(
                ("dofs",), "without structure.model or CalculiX files (.sti, .mas)"
            )
    if structure.gap is None and (structure.model is None or scene.contact is None):
        pair_keys = ("clearance", "areas", "tangential")
        structure.forbid_keys(
            pair_keys, "without contact pairs: give structure.gap, or structure.model and [contact]"
        )
    _set_vector_dimension(scene)
    if scene.excitation.point is None:
        force_paths = (structure.force_sin, structure.force_cos, structure.force_mean)
        requirement_text = (
            "given: the point of the force [m]; or a load by structure.force_sin, "
            "structure.force_cos or structure.force_mean"
        )
        scene.excitation.require(
            any(force_paths) and not scene.excitation.first_force_key, "point", requirement_text
        )
    if structure.gap is not None and scene.contact is None:
        raise missing_table_error("contact", ", as structure.gap is given")
    if scene.contact is not None:
        requirement_text = "'all' with [structure]"
        scene.contact.require(scene.contact.pairs == "all", "pairs", requirement_text)
        if structure.areas is None and (structure.model is None or structure.gap is not None):
            scene.contact.forbid_keys(
                ("stiffness_per_area",), "without structure.areas: give contact.stiffness"
            )
        if structure.model is None and structure.gap is None:
            requirement_text = (
                "left out without contact pairs: give structure.gap or structure.model"
            )
            raise InputError("contact", "a table", requirement_text)


def _forbid_tables(scene: Scene, table_names: Iterable[str], circumstance: str) -> None:
    """Raise InputError for the first named table that the scene has.

    ``circumstance`` follows "left out with" in the error.
    """
    for table_name in table_names:
        if getattr(scene, table_name):
            requirement_text = f"left out with {circumstance}: remove the table [{table_name}]"
            raise InputError(table_name, "a table", requirement_text)


def _set_vector_dimension(scene: Scene) -> None:
    """Give zero vectors in all tables the scene's dimension.

    Changes the scene in place. Raises InputError if a nonzero vector or an output point has another
    number of components.
    """
    dimension = scene.dimension
    for table_name in _TABLE_CLASS_BY_NAME:
        tables = getattr(scene, table_name)
        if table_name in _LIST_TABLE_NAMES:
            converted_tables: Any = []
            for list_position, table in enumerate(tables, 1):
                with use_table_name_in_errors(f"{table_name}.{list_position}"):
                    converted_tables.append(table.with_dimension(dimension))
            object.__setattr__(scene, table_name, tuple(converted_tables))
        elif tables is not None:
            object.__setattr__(scene, table_name, tables.with_dimension(dimension))
    for point in scene.output_points:
        if len(point.values) != dimension:
            raise InputError(
                f"output.points.{point.key}", point.values, describe_components("", dimension)
            )


def _check_dimension(scene: Scene) -> None:
    """Check keys that depend on plate or solid, and set vector lengths.

    Raises InputError for keys that a plate, or a solid, cannot have, and for wrong vectors.
    """
    geometry, dimension = scene.geometry, scene.dimension
    if dimension == 2 and scene.rotation is not None:
        scene.rotation.forbid_keys(
            ("axis", "center"), "geometry.kind = 'plate': its rotor axis is parallel to x"
        )
    for crack_name, crack in scene.crack_by_name.items() if dimension == 2 else ():
        with use_table_name_in_errors(crack_name):
            crack.forbid_keys(kinds.PLANE_CRACK_KEYS, "geometry.kind = 'plate'")
    _set_vector_dimension(scene)
    mesh = scene.mesh
    if scene.contact is not None and scene.contact.pairs == "mouth":
        mesh.forbid_keys(("patches",), "contact.pairs = 'mouth', which keeps a single pair")
    if dimension == 3:
        requirement_text = (
            "2 with geometry.kind = 'solid': tetrahedra of order 1 are much too stiff"
        )
        mesh.require(mesh.order == 2, "order", requirement_text)
        requirement_text = "'graded' or 'file' with geometry.kind = 'solid'"
        mesh.require(mesh.layout != "grid", "layout", requirement_text)
        mesh.forbid_keys(("cells",), "geometry.kind = 'solid', which is meshed by tetrahedra")
        if scene.contact is not None and scene.contact.friction and scene.disk is not None:
            requirement_text = (
                "0, or left out, with [disk] and geometry.kind = 'solid', for which"
                " friction is not implemented"
            )
            scene.contact.require(False, "friction", requirement_text)
    if geometry.file is None:
        mesh.forbid_keys(("per_turn",), "without geometry.file: only such parts have curved faces")
    if dimension == 2 or (mesh.layout != "file" and geometry.file is None):
        geometry.given("thickness")


def _check_disk(scene: Scene, disk: kinds.Disk) -> None:
    """Raise InputError if a scene does not fit a bladed disk.

    Checked are excluded tables and keys, the load's engine order and frequency, and the rim's
    radii: blades must not overlap.
    """
    _forbid_tables(scene, ("base", "growth", "identify", "reduction"), "[disk]")
    scene.excitation.given(
        "order", "given: the engine order of the load on [disk], a whole number >= 1"
    )
    if scene.speed == 0.0:
        requirement_text = (
            "given: a finite number > 0 [rad/s], or excitation.frequency [Hz], as [disk] is at rest"
        )
        scene.excitation.given("omega", requirement_text)
    if scene.curve is not None:
        requirement_text = "another parameter with [disk], for example 'omega' or 'frequency'"
        scene.curve.require(
            scene.curve.parameter_and_range[0] != "speed", "parameter", requirement_text
        )
    for crack_name, crack in scene.crack_by_name.items():
        with use_table_name_in_errors(crack_name):
            crack.forbid_keys(("first_omega", "first_frequency"), "[disk]: give crack.length")
    radius_keys = ("inner_radius", "outer_radius")
    if scene.mesh.layout == "file":
        disk.forbid_keys(radius_keys, "mesh.layout = 'file'")
        return
    disk.forbid_keys(("center", "axis"), "without mesh.layout = 'file'")
    inner_radius, outer_radius = (disk.given(radius_key) for radius_key in radius_keys)
    disk.require(
        inner_radius < outer_radius,
        "inner_radius",
        f"less than disk.outer_radius = {outer_radius:g} m",
    )
    blade_width = scene.geometry.circumferential_width
    foot_spacing = 2.0 * outer_radius * math.sin(math.pi / disk.sectors)
    requirement_text = (
        f"larger, as blades {blade_width:g} m wide would overlap: "
        f"their roots are {foot_spacing:g} m apart"
    )
    disk.require(
        blade_width < foot_spacing * (1.0 - MIN_ALLOWED_RELATIVE_DISTANCE),
        "outer_radius",
        requirement_text,
    )
    foot_depth = outer_radius - math.sqrt(outer_radius**2 - 0.25 * blade_width**2)
    requirement_text = f"less than {outer_radius - foot_depth:g} m, where the blade meets the rim"
    disk.require(inner_radius < outer_radius - foot_depth, "inner_radius", requirement_text)


def _check_plate(scene: Scene) -> None:
    """Raise InputError if sides, load points or cracks of a plate or box are wrong."""
    geometry = scene.geometry
    _, height = (geometry.given(side_key) for side_key in ("width", "height"))
    for side_key in ("width", "thickness")[: scene.dimension - 1]:
        is_similar_size = (
            height / MAX_ALLOWED_SIDE_RATIO
            <= getattr(geometry, side_key)
            <= height * MAX_ALLOWED_SIDE_RATIO
        )
        requirement_text = (
            f"within a factor {MAX_ALLOWED_SIDE_RATIO:g} of geometry.height = {height:g} m"
        )
        geometry.require(is_similar_size, side_key, requirement_text)
    if not scene.has_other_loads:
        scene.excitation.given(
            "point", "given: the point of the force, [x, y], or [x, y, z] in a solid [m]"
        )
    if scene.excitation.point is None and (force_key := scene.excitation.first_force_key):
        scene.excitation.require(False, force_key, "left out without excitation.point")
    load_by_name = {f"loads.{load_number}": load for load_number, load in enumerate(scene.loads, 1)}
    for load_name, load in ({"excitation": scene.excitation} | load_by_name).items():
        sides = geometry.sides
        within_side_flags = [
            0.0 <= coordinate <= side
            for coordinate, side in zip(load.point or (), sides, strict=False)
        ]
        with use_table_name_in_errors(load_name):
            ranges_text = ", ".join(
                f"{axis_letter} from 0 to {side:g} m"
                for axis_letter, side in zip("xyz", sides, strict=False)
            )
            load.require(all(within_side_flags), "point", f"on the {geometry.kind}: {ranges_text}")
    if scene.crack_by_name:
        _check_cracks(scene)
        if scene.contact is None:
            raise missing_table_error("contact", ", as there is a crack")


def _check_cad_part(scene: Scene) -> None:
    """Raise InputError if tables do not fit a part from a CAD file.

    Required are a graded mesh without [disk], a load, and for each crack its plane.
    """
    scene.mesh.require(scene.mesh.layout == "graded", "layout", "'graded' with geometry.file")
    _forbid_tables(scene, ("disk",), "geometry.file")
    if not scene.has_other_loads:
        scene.excitation.given(
            "point", "given: the point of the force, [x, y, z], on the part or near it [m]"
        )
    if scene.crack_by_name:
        scene.mesh.given("lip_elements", LIP_ELEMENTS_TEXT)
        if scene.contact is None:
            raise missing_table_error("contact", ", as there is a crack")
    for crack_name, crack in scene.crack_by_name.items():
        with use_table_name_in_errors(crack_name):
            crack.given("point", "given: a point [x, y, z] of the crack [m], with geometry.file")
            crack.check_plane_keys()


def _forbid_keys_of_mesh_file(scene: Scene) -> None:
    """Raise InputError for sides and crack shapes, which the mesh file defines."""
    keys_in_file = ("width", "height", "thickness")[: scene.dimension]
    scene.geometry.forbid_keys(keys_in_file, "mesh.layout = 'file'")
    for crack_name, crack in scene.crack_by_name.items():
        with use_table_name_in_errors(crack_name):
            crack.forbid_keys(_CRACK_SHAPE_KEYS, "mesh.layout = 'file'")


# --- where the cracks of a plate may be -----------------------------------------------------------

LIP_ELEMENTS_TEXT = "given: a whole number >= 1, the elements along each crack face"
"""Error text for a missing ``mesh.lip_elements``."""
MIN_ALLOWED_RELATIVE_DISTANCE = 1e-4
"""Minimum distance between cracks, tips and edges, relative to the side along the distance."""
_CRACK_SHAPE_KEYS = (*kinds.BOX_CRACK_KEYS, "length", "depth", "front", *kinds.PLANE_CRACK_KEYS)
"""Keys for a crack's position and shape; forbidden with a mesh file, which has the cracks."""


def _check_cracks(scene: Scene) -> None:
    """Raise InputError if a crack of a plate or box has wrong keys.

    Checked are position, length, depth and the distances to edges and other cracks. Cracks around
    ``crack.point`` are only checked for consistent keys.
    """
    crack_by_name, geometry, mesh = scene.crack_by_name, scene.geometry, scene.mesh
    for crack_name, crack in crack_by_name.items():
        with use_table_name_in_errors(crack_name):
            if crack.point is not None:
                crack.check_plane_keys()
                continue
            crack.forbid_keys(kinds.PLANE_CRACK_KEYS, "without crack.point")
            crack.require(
                crack.front != "through", "front", "'straight' or 'elliptical' without crack.point"
            )
            _check_crack(crack, geometry, list(crack_by_name))
            _check_crack_front(crack, geometry)
            if mesh.layout == "grid":
                _check_crack_on_grid(crack, geometry, mesh)
    if mesh.layout == "graded":
        mesh.given("lip_elements", LIP_ELEMENTS_TEXT)
    for first_name, second_name in combinations(
        [crack_name for crack_name, crack in crack_by_name.items() if crack.point is None], 2
    ):
        _check_crack_distance(scene, first_name, second_name)


def _check_crack(crack: kinds.Crack, geometry: kinds.Geometry, crack_names: list[str]) -> None:
    """Raise InputError if a crack's keys contradict, or the crack leaves the plate.

    ``crack_names`` are the names of all cracks: only a single crack may have ``first_omega``.
    """
    width, height, *_ = geometry.sides
    geometry_kind = geometry.kind
    margin_text = f"and at least {MIN_ALLOWED_RELATIVE_DISTANCE:g} of this length from both"
    is_internal_crack = crack.center is not None
    if is_internal_crack:
        crack.forbid_keys(("edge",), "crack.center")
    else:
        crack.given(
            "edge", f"given: 'left' or 'right'; or center, for a crack inside the {geometry_kind}"
        )
    requirement_text = (
        f"inside the {geometry_kind}: between 0 and geometry.height = {height:g} m, {margin_text}"
    )
    crack.require(_is_inside_with_margin(crack.height or 0.0, height), "height", requirement_text)
    if len(crack_names) > 1:
        circumstance = "several cracks: it sets the length of a single crack"
        crack.forbid_keys(("first_frequency", "first_omega"), circumstance)
    requirement_text = (
        "given: a finite number > 0 [m]; or crack.first_omega or crack.first_frequency"
        if crack.length is None
        else "left out with crack.first_omega or crack.first_frequency: give one of them"
    )
    crack.require((crack.length is None) != (crack.first_omega is None), "length", requirement_text)
    requirement_text = (
        f"shorter than the {geometry_kind}: between 0 and geometry.width = {width:g} m, "
        f"{margin_text}"
    )
    crack.require(
        crack.length is None or _is_inside_with_margin(crack.length, width),
        "length",
        requirement_text,
    )
    if is_internal_crack:
        tip_positions = [crack.center] if crack.length is None else crack.span(width)
        requirement_text = (
            f"such that both tips are inside the {geometry_kind}: "
            f"between 0 and {width:g} m, {margin_text}"
        )
        crack.require(
            all(
                _is_inside_with_margin(tip_position or 0.0, width) for tip_position in tip_positions
            ),
            "center",
            requirement_text,
        )


def _check_crack_front(crack: kinds.Crack, geometry: kinds.Geometry) -> None:
    """Raise InputError if a crack's ``depth`` and ``front`` do not fit the geometry."""
    if geometry.dimension == 2:
        crack.forbid_keys(("depth", "front"), "geometry.kind = 'plate'")
    elif crack.depth is None:
        crack.forbid_keys(("front",), "without crack.depth: the crack goes through the thickness")
    else:
        thickness = geometry.sides[2]
        requirement_text = (
            f"less than geometry.thickness = {thickness:g} m, by at least "
            f"{MIN_ALLOWED_RELATIVE_DISTANCE:g} of it; or left out for a crack through it"
        )
        crack.require(_is_inside_with_margin(crack.depth, thickness), "depth", requirement_text)


def _check_crack_on_grid(crack: kinds.Crack, geometry: kinds.Geometry, mesh: kinds.Mesh) -> None:
    """Raise InputError unless a crack lies on a grid line and ends at grid lines.

    The tolerance is 1e-9 of the side. A crack keeps at least one cell from each end of a side.
    """
    crack.given("length", "given: a finite number > 0 [m]; a grid cannot have crack.first_omega")
    (width, height), n_columns = geometry.sides, mesh.given("columns")
    extent_and_cells_by_key = {"length": (width, n_columns), "height": (height, mesh.given("rows"))}
    for extent_key, (extent, n_cells) in extent_and_cells_by_key.items():
        n_crack_cells = getattr(crack, extent_key) / extent * n_cells
        cell_size_text = f"{extent / n_cells:g} m"
        is_on_grid_line = (
            0 < round(n_crack_cells) < n_cells
            and abs(n_crack_cells - round(n_crack_cells)) < 1e-9 * n_cells
        )
        requirement_text = (
            f"a whole number of grid cells of {cell_size_text}, at least one cell from each end"
        )
        crack.require(is_on_grid_line, extent_key, requirement_text)
    if crack.center is not None:
        tip_column = crack.span(width)[0] / width * n_columns
        requirement_text = (
            f"such that both tips are on grid lines, which are {width / n_columns:g} m apart"
        )
        crack.require(
            abs(tip_column - round(tip_column)) < 1e-9 * n_columns, "center", requirement_text
        )


def _check_crack_distance(scene: Scene, first_name: str, second_name: str) -> None:
    """Raise InputError if two cracks are closer than 1e-4 of a side.

    Cracks at the same height need this distance, relative to the width, between their tips; other
    cracks need it in height.
    """
    first_crack, second_crack = (
        scene.crack_by_name[crack_name] for crack_name in (first_name, second_name)
    )
    width, height, *_ = scene.geometry.sides
    height_distance = abs(first_crack.given("height") - second_crack.given("height"))
    if height_distance >= MIN_ALLOWED_RELATIVE_DISTANCE * height:
        return
    has_same_height = height_distance <= 1e-9 * height
    spans = sorted(crack.span(width) for crack in (first_crack, second_crack))
    ligament = spans[1][0] - spans[0][1]
    if not has_same_height or ligament < MIN_ALLOWED_RELATIVE_DISTANCE * width:
        min_distance_text = f"{MIN_ALLOWED_RELATIVE_DISTANCE * height:g} m above or below"
        if has_same_height:
            min_distance_text += (
                f", or with {MIN_ALLOWED_RELATIVE_DISTANCE * width:g} m between the tips"
            )
        requirement_text = (
            f"farther from {first_name}.height = {first_crack.height:g} m, as cracks "
            f"may not touch: at least {min_distance_text}"
        )
        raise InputError(f"{second_name}.height", second_crack.height, requirement_text)


def _is_inside_with_margin(coordinate: float, extent: float) -> bool:
    """Return True if a coordinate is inside the interval from 0 to ``extent``.

    The distance to both ends must be at least 1e-4 of the extent.
    """
    return (
        MIN_ALLOWED_RELATIVE_DISTANCE * extent
        <= coordinate
        <= (1.0 - MIN_ALLOWED_RELATIVE_DISTANCE) * extent
    )


# --- axes of keys ---------------------------------------------------------------------------------


def _check_and_convert_axes(
    scene: Scene, axes_key: str, axes: tuple[Axis, ...]
) -> tuple[Axis, ...]:
    """Return axes with values as the scene stores them.

    ``axes_key`` names the axes in errors: "sweep.over". Raises InputError for a key that is
    unknown, repeated or not sweepable, and for wrong or equal values. Combinations of values are
    checked later, in each case.
    """
    checked_axes, seen_keys = [], set()
    for axis in axes:
        table_name, list_position, key_in_table = _split_key(axis.key)
        table_exists = list_position is None or list_position <= len(getattr(scene, table_name))
        is_sweepable_key = (
            table_name in _SWEEPABLE_TABLE_NAMES
            and key_in_table in _TABLE_CLASS_BY_NAME[table_name].field_by_key()
        )
        if not (is_sweepable_key and table_exists) or axis.key in seen_keys:
            tables_text = ", ".join(_SWEEPABLE_TABLE_NAMES)
            requirement_text = (
                "a key of the scene with its table, as 'crack.length', given once; "
                f"the tables are {tables_text}"
            )
            if (
                suggestion_text := did_you_mean_text(_suggest_keys(axis.key))
            ) and axis.key not in seen_keys:
                requirement_text += f"; {suggestion_text}".rstrip()
            raise InputError(axes_key, axis.key, requirement_text)
        seen_keys.add(axis.key)
        for twin_pair in _TABLE_CLASS_BY_NAME[table_name].si_key_by_twin().items():
            table_name_text = axis.key.removesuffix(f".{key_in_table}")
            if seen_keys.issuperset(
                twin_keys := [f"{table_name_text}.{twin_key}" for twin_key in twin_pair]
            ):
                other_twin_key = twin_keys[0] if axis.key == twin_keys[1] else twin_keys[1]
                requirement_text = f"left out with {other_twin_key}: give one of the two"
                raise InputError(axes_key, axis.key, requirement_text)
        with use_table_name_in_errors(axis.key.removesuffix(f".{key_in_table}")):
            axis_values = tuple(
                _TABLE_CLASS_BY_NAME[table_name].convert_value(key_in_table, axis_value)
                for axis_value in axis.values
            )
        if len(set(axis_values)) != len(axis_values) or not axis_values:
            raise InputError(
                f'{axes_key}."{axis.key}"', axis_values, "one or more different values"
            )
        checked_axes.append(Axis(axis.key, axis_values))
    return tuple(checked_axes)


# --- lists of tables ------------------------------------------------------------------------------


def _split_key(full_key: str) -> tuple[str, int | None, str]:
    """Split a full key: "cracks.1.length" gives "cracks", 1, "length".

    The position is None for a table that is not in a list.
    """
    table_name, _, key_in_table = full_key.partition(".")
    position_text, _, key_after_position = key_in_table.partition(".")
    if (
        table_name in _LIST_TABLE_NAMES
        and position_text.isdecimal()
        and 0 < len(position_text) < 10
        and int(position_text) > 0
    ):
        return table_name, int(position_text), key_after_position
    return table_name, None, key_in_table


def _make_table_or_tuple(table_name: str, raw_tables: object) -> Any:
    """Return a table, or a tuple of tables for a list, from raw values.

    Raw values are mappings as read from TOML; tables that are objects already stay unchanged.
    """
    table_class = _TABLE_CLASS_BY_NAME[table_name]
    if table_name not in _LIST_TABLE_NAMES:
        return (
            raw_tables
            if isinstance(raw_tables, table_class)
            else table_class.from_mapping(raw_tables)
        )
    if not isinstance(raw_tables, list | tuple):
        raise InputError(table_name, raw_tables, f"a list of tables headed [[{table_name}]]")
    tables = []
    for list_position, raw_table in enumerate(raw_tables, 1):
        with use_table_name_in_errors(f"{table_name}.{list_position}"):
            tables.append(
                raw_table
                if isinstance(raw_table, table_class)
                else table_class.from_mapping(raw_table)
            )
    return tuple(tables)


def _split_changed_key(full_key: str, value: object) -> tuple[str, int | None, str]:
    """Split the full key of a change into table, position from 1 and key.

    The position is None for a table outside lists. The key is empty if the change, with the value
    None, removes the table. Raises InputError for an unknown key or a wrong removal.
    """
    table_name, list_position, key_in_table = _split_key(full_key)
    table_class = _TABLE_CLASS_BY_NAME.get(table_name)
    if table_class is None:
        raise InputError(full_key, value, _unknown_table_text(full_key))
    if not key_in_table and table_class.SHORTHAND_KEY is not None and isinstance(value, str):
        return table_name, None, table_class.SHORTHAND_KEY
    if not key_in_table:
        if (
            value is not None
            or list_position is not None
            or table_name not in (*_OPTIONAL_TABLE_NAMES, *_LIST_TABLE_NAMES)
        ):
            removable_names = ", ".join((*_OPTIONAL_TABLE_NAMES, *_LIST_TABLE_NAMES))
            first_key = next(key for key in known_keys() if key.startswith(f"{table_name}."))
            requirement_text = (
                f"changed key by key, as {first_key}=...; only these tables can be "
                f"removed, by TABLE=none (in Python None): {removable_names}"
            )
            raise InputError(full_key, "none" if value is None else value, requirement_text)
    elif (list_position is None) == (table_name in _LIST_TABLE_NAMES):
        known_keys_text = ", ".join(
            f"{table_name}.1.{subkey}" for subkey in table_class.field_by_key()
        )
        raise InputError(full_key, value, f"left out; known keys: {known_keys_text}")
    elif key_in_table not in table_class.field_by_key():
        parent_key, _, subkey = key_in_table.replace('"', "").partition(".")
        if parent_key in table_class.field_by_key() and subkey:
            raise InputError(
                full_key, value, f'changed as a whole: {table_name}.{parent_key}={{"{subkey}"=...}}'
            )
        raise InputError(full_key, value, table_class.unknown_key_text(key_in_table))
    return table_name, list_position, key_in_table


def _with_changed_keys(
    table_by_name: Mapping[str, Any], value_by_full_key: Mapping[str, object]
) -> dict[str, Any]:
    """Return tables by name, with values changed by full key.

    Changed tables are mappings, or tuples of them, without check of the values.
    """
    changed_tables = dict(table_by_name)
    changes_by_table: dict[tuple[str, int], dict[str, object]] = {}
    for full_key, raw_value in value_by_full_key.items():
        table_name, list_position, key_in_table = _split_changed_key(str(full_key), raw_value)
        if key_in_table:
            changes_by_table.setdefault((table_name, list_position or 0), {})[key_in_table] = (
                raw_value
            )
        else:
            changed_tables.pop(table_name, None)
    for (table_name, list_position), table_changes in sorted(
        changes_by_table.items(), key=lambda changes_item: changes_item[0][1]
    ):
        if list_position:
            changed_tables[table_name] = _merge_list_changes(
                table_name, changed_tables.get(table_name, ()), list_position, table_changes
            )
        else:
            changed_tables[table_name] = _merge_table_changes(
                table_name, changed_tables.get(table_name), table_changes
            )
    return changed_tables


def _merge_table_changes(table_name: str, table: Any, value_by_key: dict[str, object]) -> Any:
    """Return a table as a mapping, with changed values.

    If a changed quantity also has a key in another unit, this key becomes None.

    ``table`` is a Table, a mapping, a shorthand word or None; anything else is returned unchanged
    and refused later.
    """
    table_class = _TABLE_CLASS_BY_NAME[table_name]
    if isinstance(table, table_class):
        table = {
            key: getattr(table, key)
            for key in table_class.field_by_key().keys() - table.derived_keys
        }
    if table_class.SHORTHAND_KEY is not None and isinstance(table, str):
        table = {table_class.SHORTHAND_KEY: table}
    if table is None:
        return value_by_key
    if not isinstance(table, Mapping):  # refused when it is made
        return table
    return {**table, **table_class.make_changes_with_twins_removed(value_by_key, table)}


def _merge_list_changes(
    table_name: str, tables: Any, list_position: int, value_by_key: dict[str, object]
) -> tuple[Any, ...]:
    """Return a list of tables with one table changed or appended.

    ``list_position`` counts from 1; one more than the length appends a table.
    """
    if not isinstance(tables, list | tuple):
        raise InputError(table_name, tables, f"a list of tables headed [[{table_name}]]")
    if list_position > len(tables) + 1:
        first_changed_key = f"{table_name}.{list_position}.{next(iter(value_by_key))}"
        requirement_text = (
            f"in {table_name}.{len(tables) + 1}, the next number, as the scene has "
            f"{len(tables)} tables [[{table_name}]]"
        )
        raise InputError(first_changed_key, next(iter(value_by_key.values())), requirement_text)
    current_table = tables[list_position - 1] if list_position <= len(tables) else None
    with use_table_name_in_errors(f"{table_name}.{list_position}"):
        return (
            *tables[: list_position - 1],
            _merge_table_changes(table_name, current_table, value_by_key),
            *tables[list_position:],
        )


def _suggest_keys(misspelt_name: str) -> list[str]:
    """Return known keys and tables similar to a misspelt name; empty without any."""
    table_name, _, key_in_table = misspelt_name.partition(".")
    if table_name in _TABLE_CLASS_BY_NAME:
        return _TABLE_CLASS_BY_NAME[table_name].suggest_keys(key_in_table) if key_in_table else []
    if key_in_table:
        all_keys = {
            table_class.full_key_to_suggest(key_in_table)
            for table_class in _TABLE_CLASS_BY_NAME.values()
            for key_in_table in table_class.field_by_key()
        }
        return find_similar_names(misspelt_name, all_keys, 0.8) or sorted(
            full_key for full_key in all_keys if full_key.endswith(f".{key_in_table}")
        )
    return list(
        dict.fromkeys(find_full_keys(table_name, _TABLE_CLASS_BY_NAME.values()))
    ) or find_similar_names(table_name, _TABLE_CLASS_BY_NAME)


def suggest_full_keys(misspelt_name: str) -> list[str]:
    """Return full keys similar to a misspelt name or to a key without its table.

    Empty if no key is similar.
    """
    full_key_by_short_key = {key.rpartition(".")[2]: key for key in reversed(known_keys())}
    suggested_full_keys = _suggest_keys(misspelt_name) or [
        full_key_by_short_key[key]
        for key in find_similar_or_longer_names(misspelt_name, full_key_by_short_key)
    ]
    return suggested_full_keys or find_similar_or_longer_names(misspelt_name, known_keys())


def _unknown_table_text(table_name: str) -> str:
    """Return the requirement for an unknown table: suggestions and all table names."""
    suggestion_text = did_you_mean_text(_suggest_keys(table_name))
    return f"left out; {suggestion_text}known tables: {', '.join(_TABLE_CLASS_BY_NAME)}"


_TABLE_NAMES_AND_TYPE_HINTS = get_type_hints(Scene).items()
_TABLE_CLASS_BY_NAME: dict[str, type[Table]] = {
    name: (get_args(hint) or (hint,))[0] for name, hint in _TABLE_NAMES_AND_TYPE_HINTS
}
_LIST_TABLE_NAMES = tuple(
    name for name, hint in _TABLE_NAMES_AND_TYPE_HINTS if get_origin(hint) is tuple
)
_OPTIONAL_TABLE_NAMES = tuple(
    name for name, hint in _TABLE_NAMES_AND_TYPE_HINTS if type(None) in get_args(hint)
)
_PATH_KEYS = tuple(
    kind.full_key(key)
    for kind in _TABLE_CLASS_BY_NAME.values()
    for key, item in kind.field_by_key().items()
    if "path" in item.metadata
)
"""Full keys whose value is a file's path."""
_AXES_TABLE_KEY_PAIRS = ("sweep", "over"), ("identify", "unknown")
"""(table, key) pairs whose value is a tuple of :class:`Axis`."""
_KEYS_WITH_PATHS = (
    *_PATH_KEYS,
    *(f"{name}.{key}" for name, key in _AXES_TABLE_KEY_PAIRS),
    "identify.meshes",
)
"""Full keys whose values may contain paths: single paths, axes and mesh files."""
_SWEEPABLE_TABLE_NAMES = tuple(
    name for name in _TABLE_CLASS_BY_NAME if name not in RESULT_TABLE_NAMES
)
