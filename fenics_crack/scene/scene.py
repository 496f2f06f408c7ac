"""The scene: everything that defines a computation, validated, frozen, in SI units.

A scene is a TOML file (see ``demos/paper_plate.toml``) or a tree of the dataclasses in
:mod:`fenics_crack.scene.tables`. A value that a key may not hold raises :class:`InputError` with
key, value and requirement, before any computation.
"""

from __future__ import annotations

import dataclasses
import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.basics.errors import InputError, report_read_errors
from fenics_crack.basics.observables import (
    OBSERVABLES_BY_NAME,
    Observable,
    ObservableTableFlag,
    Place,
)
from fenics_crack.basics.suggestions import (
    check_calls,
    convert_to_unit_or_none,
    did_you_mean_text,
    format_scene_value,
    keep_old_attribute_names,
)
from fenics_crack.basics.tables import (
    RAD_PER_S_PER_RPM,
    RAD_PER_TURN,
    choose_frequency_factor_name_unit,
)
from fenics_crack.basics.untrusted_files import read_utf8_text
from fenics_crack.scene.cross_checks import check_tables
from fenics_crack.scene.fields import Axis, MeshFile, add_preposition, condition_holds
from fenics_crack.scene.keys import (
    AXES_TABLE_KEY_PAIRS,
    KEYS_THAT_MAY_CONTAIN_PATHS,
    LIST_TABLE_NAMES,
    PATH_KEYS,
    RESULT_SETTINGS_TABLE_NAMES,
    TABLE_CLASS_BY_NAME,
    SceneTables,
    check_and_convert_axes,
    make_tables,
    missing_table_error,
    suggest_full_keys,
    unit_of_key,
    with_changed_keys,
)
from fenics_crack.scene.tables import Rotation

MANY_SOLUTION_TABLE_NAMES = ("curve", "sweep", "growth", "identify")
"""Settings tables for the commands that solve a scene many times."""
LONG_NAME_PATTERN = re.compile(r"""(?<![\w-])(([\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*){50}""")
"""A name with more than 50 parts: tomllib's time grows with the square of their number."""


@keep_old_attribute_names(
    label_by_point_name="label_by_displacement_name",
    all_cracks="crack_by_name",
    at_rest="without_rotation",
    axis="axis_point_and_direction",
    damped_modes="n_damped_modes_or_all",
    has_element_lengths="has_graded_lengths",
    in_hertz="is_frequency_in_hertz",
    in_rpm="is_speed_in_rpm",
    point_names="label_by_displacement_name",
    points="output_points",
    swept="swept_values_by_key",
)
@dataclass(frozen=True, repr=False)
class Scene(SceneTables):
    """A cracked structure, the load, and the settings for computing the vibration.

    Each table in the file is an attribute, and each key an attribute of the table:
    ``scene.material.young``. All keys are under "Keys of a scene" in the reference. Units are SI
    units. A frequency given in Hz is stored in rad/s, too, under the key in rad/s. An omitted table
    is None or has default values. If the scene has the table ``structure``, the tables of a plate
    are None.

    Raises
    ------
    InputError
        A table is missing or has a key that cannot be used.
    """

    def __post_init__(self) -> None:
        check_tables(self)
        for quantity_name in self.quantities or ():
            reason = _reason_without_observable(self, OBSERVABLES_BY_NAME[quantity_name])
            refuse_for_reason(reason, "output.quantities", quantity_name)
        for table_name, axes_key in AXES_TABLE_KEY_PAIRS:
            if (axes_table := getattr(self, table_name)) is not None:
                checked_axes = check_and_convert_axes(
                    self, f"{table_name}.{axes_key}", getattr(axes_table, axes_key)
                )
                object.__setattr__(
                    self, table_name, dataclasses.replace(axes_table, **{axes_key: checked_axes})
                )

    def __repr__(self) -> str:
        return f"Scene({_describe_scene(self)})"

    @classmethod
    @check_calls
    def from_mapping(
        cls,
        tables: Mapping[str, object],
        folder: Path = Path(),
        changes: Mapping[str, object] | None = None,
    ) -> Scene:
        """Make a scene from nested mappings.

        Parameters
        ----------
        tables : mapping
            Tables by name, as read from TOML.
        folder : Path
            Folder at which relative paths in ``tables`` begin.
        changes : mapping, optional
            Values by full key as in :meth:`replace`, set before any check. Paths in them stay
            unchanged.
        """
        changes = changes or {}
        scene = cls(**make_tables(with_changed_keys(tables, changes)))
        return with_file_paths(scene, lambda path: str(folder / path)).replace(
            {
                changed_key: changes[changed_key]
                for changed_key in changes
                if changed_key in KEYS_THAT_MAY_CONTAIN_PATHS
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

        Parameters
        ----------
        text : str
            TOML text.
        name : str
            Name of the text in errors.
        folder : Path
            Folder at which relative paths in the text begin.
        changes : mapping, optional
            Values by full key as in :meth:`replace`.
        """
        with report_read_errors("scene", name, "a TOML file"):
            if LONG_NAME_PATTERN.search(text):
                raise InputError("scene", name, "a TOML file whose names have at most 50 parts")
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
            table_name: {"type": "array", "items": table_class.schema()}
            if table_name in LIST_TABLE_NAMES
            else table_class.schema()
            for table_name, table_class in TABLE_CLASS_BY_NAME.items()
        }
        return {
            "$schema": "http://json-schema.org/draft-07/schema#",
            "type": "object",
            "properties": schema_by_table,
            "additionalProperties": False,
        }

    def given(self, name: str) -> Any:
        """Return the table ``name`` for a command that needs the table.

        Raises
        ------
        InputError
            The table is missing. Or ``harmonic_balance.form`` is "block", and the command for the
            table solves many times (``MANY_SOLUTION_TABLE_NAMES``).
        """
        if getattr(self, name) is None:
            raise missing_table_error(name, ", which this command needs")
        self.harmonic_balance.require(
            self.harmonic_balance.form == "condensed" or name not in MANY_SOLUTION_TABLE_NAMES,
            "form",
            f"'condensed' for a command that uses [{name}]",
        )
        return getattr(self, name)

    def _is_key_given_or_varied(self, full_key: str) -> bool:
        """Return True if a full key is given, or varied by [curve] or [sweep]."""
        table_name, key_in_table = full_key.split(".")
        is_given = getattr(getattr(self, table_name), key_in_table, None) is not None
        is_curve_parameter = self.curve is not None and self.curve.parameter == key_in_table
        return is_given or is_curve_parameter or full_key in self.swept_values_by_key

    @property
    def is_speed_in_rpm(self) -> bool:
        """True if results show the rotor speed in revolutions per minute.

        This holds if ``rpm`` is given, swept, or the parameter of a curve.
        """
        return self._is_key_given_or_varied("rotation.rpm")

    @property
    def is_frequency_in_hertz(self) -> bool:
        """True if results show the load frequency in Hz.

        This holds if the frequency in Hz is given, swept, or the parameter of a curve. It also
        holds for an engine order with a rotor speed in rpm.
        """
        has_order_and_rpm = self.excitation.order is not None and self.is_speed_in_rpm
        return has_order_and_rpm or self._is_key_given_or_varied("excitation.frequency")

    @property
    def quantities(self) -> tuple[str, ...] | None:
        """Names in ``output.quantities``; None if the scene does not choose quantities.

        Without a crack the names that need one are left out.
        """
        dropped_names = list_dropped_quantities(self)
        chosen_names = (self.output and self.output.quantities) or ()
        return tuple(name for name in chosen_names if name not in dropped_names) or None

    @property
    def label_by_displacement_name(self) -> dict[str, str]:
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
    def swept_omegas(self) -> tuple[float, ...]:
        """Load frequencies in all cases of the sweep [rad/s].

        If no sweep changes the frequency, only the excitation's frequency is returned.
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
        """Point on the rotor axis [m], and unit vector along the axis: (3,) each.

        The scene must have [rotation] or [disk].
        """
        axis_table = self.rotation if self.disk is None else self.disk
        assert axis_table is not None
        sides, direction = self.geometry.sides, axis_table.axis or (1.0, 0.0, 0.0)
        if isinstance(axis_table, Rotation):
            middle = 0.5 * np.array(sides) if len(sides) == 3 else np.zeros(3)
            point = axis_table.center or (middle[0], -(axis_table.hub_radius or 0.0), middle[2])
        elif self.mesh.layout == "file":
            point = (*(axis_table.center or (0.0,)), 0.0, 0.0)[:3]
        else:
            half_blade_width = 0.5 * self.geometry.circumferential_width
            axis_point_x, axis_point_z = (
                (half_blade_width, 0.0) if self.dimension == 2 else (0.0, half_blade_width)
            )
            point = (axis_point_x, -axis_table.given("outer_radius"), axis_point_z)
        if self.disk is not None and self.dimension == 2:
            direction = (0.0, 0.0, 1.0)
        return np.array(point), np.array(direction) / np.linalg.norm(direction)

    @property
    def modes_key(self) -> str:
        """Key for the number of modes: "reduction.modes", or with [disk] "disk.families"."""
        return "reduction.modes" if self.disk is None else "disk.families"

    @property
    def n_damped_modes_or_all(self) -> int | str:
        """Number of damped modes; "all" for every mode and for a damping matrix."""
        return "all" if self.damping is None else self.damping.modes

    @partial(check_calls, find_scene_keys=lambda misspelt_name: suggest_full_keys(misspelt_name))
    def replace(self, values: Mapping[str, object]) -> Scene:
        """Return a scene with some keys changed: ``scene.replace({"contact.stiffness": 1e9})``.

        A missing optional table is made; ``{"crack": None}`` removes a table. Tables in a list are
        counted from 1: ``{"cracks.1.length": 0.02}``. The number after the last makes a new table.
        A frequency in Hz replaces the frequency in rad/s, and vice versa.
        """
        present_table_by_name = {
            table_name: table for table_name, table in vars(self).items() if table
        }
        return Scene(**make_tables(with_changed_keys(present_table_by_name, values)))

    def as_toml(self) -> str:
        """Return the scene as a TOML text for :meth:`load`, with unchanged paths."""
        table_texts = []
        for name, table in self.table_by_name.items():
            list_name, dot_or_empty, _ = name.partition(".")
            header = f"[[{list_name}]]" if dot_or_empty else f"[{name}]"
            table_texts.append(table.as_toml().replace(f"[{table.full_key()}]", header, 1))
        return "\n".join(table_texts)


def _find_excluding_condition(scene: Scene, reason_by_condition: Mapping[str, str]) -> str:
    """Return the first condition that a scene fulfils, with the reason, as text.

    Used to say why a quantity cannot be computed: "with [disk]: stress intensities are not computed
    for bladed disks". The text is empty if no condition holds. ``reason_by_condition`` has the
    reason for each condition; conditions are written as in :class:`Rule`.
    """
    for excluding_condition, reason in reason_by_condition.items():
        if condition_holds(excluding_condition, vars(scene)):
            return f"{add_preposition(excluding_condition)}: {reason}"
    return ""


def _has_crack(scene: Scene) -> bool:
    """Return True for a crack in the scene's tables, or in its mesh file (with [contact])."""
    return bool(scene.crack_by_name) or (scene.contact is not None and scene.mesh.layout == "file")


def reason_without_stress_intensity(scene: Scene) -> str:
    """Return why stress intensity factors cannot be computed; empty if they can."""
    if reason := _find_excluding_condition(scene, _NO_STRESS_INTENSITY_REASON_BY_CONDITION):
        return reason
    if not _has_crack(scene):
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
    return _find_excluding_condition(scene, _NO_CLAMP_FORCES_REASON_BY_CONDITION)


def refuse_for_reason(reason: str, key: str, value: object = None) -> None:
    """Raise InputError for a key and value; do nothing if ``reason`` is empty.

    The error asks to leave out the key: "left out" and the reason. So the reason begins with "with"
    or "without".
    """
    if reason:
        raise InputError(key, value, f"left out {reason}")


def _reason_without_observable(scene: Scene, observable: Observable) -> str:
    """Return why a number cannot be computed for a scene; "" if it can.

    ``observable`` describes the number, for example K_max at a crack tip.
    """
    if ObservableTableFlag.REQUIRES_FRICTION in observable.flags and not scene.has_friction:
        return "without contact.friction"
    if ObservableTableFlag.REQUIRES_GROWTH_LAW in observable.flags and scene.growth is None:
        return "without a table [growth], whose exponent it needs"
    if ObservableTableFlag.REQUIRES_SOLID in observable.flags and (
        scene.structure is not None or scene.dimension == 2
    ):
        return "without geometry.kind = 'solid'"
    return (
        _REASON_FUNCTION_BY_OBSERVABLE_PLACE[observable.place](scene)
        if observable.place in _REASON_FUNCTION_BY_OBSERVABLE_PLACE
        else ""
    )


def list_dropped_quantities(scene: Scene) -> tuple[str, ...]:
    """Return the names in ``output.quantities`` that need a crack, if the scene has none."""
    if scene.output is None or scene.structure is not None or _has_crack(scene):
        return ()
    return tuple(
        quantity_name
        for quantity_name in scene.output.quantities or ()
        if OBSERVABLES_BY_NAME[quantity_name].needs_crack
    )


def list_requested_extra_quantities(scene: Scene) -> tuple[str, ...]:
    """Return the names in ``output.quantities`` that are computed only on request.

    Examples are stress intensities at crack tips, and forces on the clamp. Numbers of
    displacements, crack faces and the mode nearest to the load frequency are left out: they are
    always computed.
    """
    return tuple(
        quantity_name
        for quantity_name in scene.quantities or ()
        if OBSERVABLES_BY_NAME[quantity_name].place.is_made_on_request
    )


_NO_STRESS_INTENSITY_REASON_BY_CONDITION: Mapping[str, str] = {
    "[structure]": "stress intensities need a mesh",
    "[disk]": "stress intensities are not computed for bladed disks",
}
"""Conditions that exclude stress intensity factors, with reasons."""
_NO_CLAMP_FORCES_REASON_BY_CONDITION: Mapping[str, str] = {
    "[structure]": "clamp forces need a mesh",
    "[disk]": "clamp forces are not computed for bladed disks",
    "[rotation]": "clamp forces are computed without rotation only",
}
"""Conditions that exclude forces on the clamp, with reasons."""
_REASON_FUNCTION_BY_OBSERVABLE_PLACE: dict[Place, Callable[[Scene], str]] = {
    Place.MOST_LOADED_TIP: reason_without_stress_intensity,
    Place.DEEPEST_PLACE_AND_ELLIPSE_ENDS: reason_without_elliptical_growth,
    Place.CLAMP: reason_without_clamp_forces,
}
"""Functions of a scene, by place: return why numbers at this place cannot be computed, or ""."""


def file_keys_and_paths(scene: Scene) -> list[tuple[str, str]]:
    """Return (full key, path) for each file that defines the structure or its load.

    Paths in the sweep are included. Files in tables that only choose results
    (:data:`RESULT_SETTINGS_TABLE_NAMES`) are left out.
    """
    keys_and_paths = [
        (key, path)
        for key, path in _find_values_with_paths(scene).items()
        if isinstance(path, str) and not key.startswith(RESULT_SETTINGS_TABLE_NAMES)
    ]
    for key, axis_values in scene.swept_values_by_key.items():
        if key in PATH_KEYS:
            keys_and_paths += [(key, path) for path in axis_values if isinstance(path, str)]
    return keys_and_paths


def _find_values_with_paths(scene: Scene) -> dict[str, Any]:
    """Return file paths, and tuples that may have paths (sweep axes, mesh files), by full key."""
    full_keys_with_parts = (
        (full_key, *full_key.split(".")) for full_key in KEYS_THAT_MAY_CONTAIN_PATHS
    )
    value_by_key = {
        full_key: getattr(getattr(scene, table_name), key_in_table, None)
        for full_key, table_name, key_in_table in full_keys_with_parts
    }
    return {key: value for key, value in value_by_key.items() if isinstance(value, str | tuple)}


def with_file_paths(scene: Scene, change_path: Callable[[str], str]) -> Scene:
    """Return the scene with every file path replaced by ``change_path(path)``.

    Paths in lists change, too: in ``sweep.over``, ``identify.unknown`` and ``identify.meshes``.
    """

    def change_paths(value: Any) -> Any:
        """Return a value of the scene with all paths in it changed."""
        if isinstance(value, tuple):
            return tuple(map(change_paths, value))
        if isinstance(value, MeshFile):
            return MeshFile(change_path(value.key), value.values)
        if isinstance(value, Axis):
            return Axis(value.key, change_paths(value.values)) if value.key in PATH_KEYS else value
        return change_path(value) if isinstance(value, str) else value

    changes = {key: change_paths(value) for key, value in _find_values_with_paths(scene).items()}
    return scene.replace(changes) if changes else scene


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
    """Return a suggested correction for a line in which TOML text has an error.

    ``error_text`` has the line number, "at line 3". For "5 mm" the correction is the number in SI
    units; for a word, the word in quotes. The text is empty without a correction.
    """
    given_toml_lines, line_match = toml_text.splitlines(), re.search(r"at line (\d+)", error_text)
    if line_match is None or int(line_match[1]) > len(given_toml_lines):
        return ""
    lines_up_to_error = given_toml_lines[: int(line_match[1])]
    toml_line = given_toml_lines[int(line_match[1]) - 1]
    table_headers = [
        toml_line.strip("[ ]") for toml_line in lines_up_to_error if toml_line.startswith("[")
    ]
    key, _, value_text = (
        toml_line_part.strip() for toml_line_part in toml_line.partition("#")[0].partition("=")
    )
    si_value = convert_to_unit_or_none(
        value_text.strip("\"'"), unit_of_key(".".join([*table_headers[-1:], key]))
    )
    if si_value is None and not value_text.isidentifier():
        return ""
    corrected_value_text = f'"{value_text}"' if si_value is None else format_scene_value(si_value)
    return f"; {did_you_mean_text([f'{key} = {corrected_value_text}'])}".rstrip()
