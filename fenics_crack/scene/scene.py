"""The scene: everything that defines a computation, validated, frozen, in SI units.

A scene is a TOML file (see ``demos/paper_plate.toml``) or a tree of the dataclasses in
:mod:`fenics_crack.scene.tables`. A value that a key may not hold raises :class:`InputError` with
the key, the value and what is allowed, before anything is computed.
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
    convert_number,
    did_you_mean_text,
    find_similar_names,
    find_similar_or_longer_names,
    format_scene_value,
)
from fenics_crack.basics.tables import RAD_PER_S_PER_RPM, RAD_PER_TURN, frequency_axis
from fenics_crack.basics.untrusted_files import read_utf8_text
from fenics_crack.scene import tables as kinds
from fenics_crack.scene.fields import Axis, Point, Table, components, named, with_key

SOLVED_OFTEN = ("curve", "sweep", "growth", "identify")
"""Tables by which a scene is solved many times."""
LOOKED_AT = ("curve", "integration", "sweep", "growth", "identify", "tip_timing", "output")
"""Tables that choose results, and change nothing of the structure and its load."""

PLATE_TABLES = (
    "geometry", "material", "mesh", "crack", "cracks", "loads", "base", "rotation", "disk",
)  # fmt: skip
"""Tables of a plate, which matrices from elsewhere take the place of."""
THINNEST = 1e4
"""Largest ratio of the plate's sides."""


@dataclass(frozen=True, repr=False)
class Scene:
    """A cracked plate, its load, and how its vibration is computed; or matrices from elsewhere.

    Each table of the file is an attribute, and each of its keys an attribute of that:
    ``scene.material.young``; all of them are under "Keys of a scene" in the reference. SI units;
    frequencies given in Hz are there in rad/s too. A table that is left out is None or has its
    defaults. With the table ``structure`` the tables of a plate are None.

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
    """Further cracks."""
    loads: tuple[kinds.Load, ...] = ()
    """Loads beside the force of the excitation."""
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
        for name, table in _TABLES.items():
            value = getattr(self, name)
            if name in _LISTS:
                fine = isinstance(value, tuple) and all(isinstance(one, table) for one in value)
            else:
                missing = value is None and (name in _OPTIONAL or _not_needed(self, name))
                fine = isinstance(value, table) or missing
            if not fine:
                allowed = "given: a table" if value is None else f"a {table.__name__}"
                if isinstance(value, str | Path):
                    allowed += "; Scene.load(path) reads the file of a scene"
                raise InputError(name, value, allowed)
        if self.rotation is not None:
            self.rotation.check_place(self.disk)
        if self.excitation.order is not None and (self.disk is None or self.speed > 0.0):
            allowed = "left out without a rotation.speed > 0"
            self.excitation.require(self.speed > 0.0, "order", allowed)
            object.__setattr__(self, "excitation", self.excitation.at_speed(self.speed))
        balance = self.harmonic_balance.of_load(self.highest_order)
        object.__setattr__(self, "harmonic_balance", balance)
        rubs = self.contact is not None and bool(self.contact.friction)
        allowed = "'condensed' with contact.friction"
        balance.require(balance.form == "condensed" or not rubs, "form", allowed)
        if self.curve is not None and self.curve.followed[0] == "speed":
            allowed = "another one without an excitation.order, which needs a rotation"
            self.curve.require(self.excitation.order is not None, "parameter", allowed)
        if self.curve is not None and self.curve.followed[0] == "load":
            allowed = "another one with a rotation.speed > 0: the mean load is partly centrifugal"
            allowed += "; or curve.at = 'resonance', where it stays"
            self.curve.require(self.speed == 0.0, "parameter", allowed)
        if self.integration is not None and self.rotation is not None:
            why = "[rotation]: the mean load is partly centrifugal"
            self.integration.leave_out(("deflection", "free"), why)
        if self.structure is not None:
            _check_matrices(self, self.structure)
        else:
            _check_dimension(self)
            if self.geometry.file is not None:
                _check_part(self)
            else:
                (_check_file if self.mesh.layout == "file" else _check_plate)(self)
            if self.disk is not None:
                _check_disk(self, self.disk)
        for name in self.quantities or ():
            check_known(_without(self, OBSERVABLES_BY_NAME[name]), "output.quantities", name)
        for name, key in _AXES:
            if (chosen := getattr(self, name)) is not None:
                axes = _checked_axes(self, f"{name}.{key}", getattr(chosen, key))
                object.__setattr__(self, name, dataclasses.replace(chosen, **{key: axes}))
        if self.identify is not None and (self.mesh is None or self.mesh.layout != "file"):
            allowed = "left out without mesh.layout = 'file'"
            self.identify.require(not self.identify.meshes, "meshes", allowed)
            self.identify.leave_out(("uncracked",), "a mesh that is not a file")

    def __repr__(self) -> str:
        return f"Scene({_in_short(self)})"

    @property
    def all_cracks(self) -> dict[str, kinds.Crack]:
        """Every crack by its name: "crack", "cracks.1", "cracks.2"."""
        first = {} if self.crack is None else {"crack": self.crack}
        return first | {f"cracks.{number}": c for number, c in enumerate(self.cracks, 1)}

    @classmethod
    @check_calls
    def from_mapping(
        cls,
        tables: Mapping[str, object],
        folder: Path = Path(),
        changes: Mapping[str, object] | None = None,
    ) -> Scene:
        """Make a scene from nested mappings; a relative ``mesh.file`` is one of ``folder``.

        ``changes`` are those of :meth:`replace`, made before anything is checked; their files are
        as they stand.
        """
        changes = changes or {}
        tables = _with_changes(tables, changes)
        for name, value in tables.items():
            if name not in _TABLES:
                raise InputError(name, value, _instead_of(name))
        made = {name: _made(name, value) for name, value in tables.items()}
        scene = with_files(cls(**made), lambda path: str(folder / path))
        return scene.replace({name: changes[name] for name in changes if name in _WITH_FILES})

    @classmethod
    @check_calls
    def load(cls, path: str | Path, changes: Mapping[str, object] | None = None) -> Scene:
        """Read a scene from a TOML file, with the changes of :meth:`replace`: what is wrong in the
        file and changed does no harm.

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
        """Make a scene from the text of a TOML file, which errors call ``name``."""
        with report_read_errors("scene", name, "a TOML file"):
            try:
                tables = tomllib.loads(text)
            except tomllib.TOMLDecodeError as error:
                allowed = f"a TOML file ({error}){_hint_in(text, str(error))}"
                raise InputError("scene", name, allowed) from error
        return cls.from_mapping(tables, folder, changes)

    @classmethod
    def schema(cls) -> dict[str, Any]:
        """All tables and keys as a JSON schema, by which editors of TOML complete and check them.

        Examples
        --------
        >>> sorted(fc.Scene.schema()["properties"]["material"]["required"])
        ['density', 'poisson', 'young']
        """
        tables = {name: kind.schema() for name, kind in _TABLES.items()}
        lists = {name: {"type": "array", "items": tables[name]} for name in _LISTS}
        return {
            "$schema": "http://json-schema.org/draft-07/schema#",
            "type": "object",
            "properties": tables | lists,
            "additionalProperties": False,
        }

    @property
    def dimension(self) -> int:
        """3 for a solid, and for a model of another program; else 2."""
        if self.structure is not None:
            return 2 if self.structure.model is None else 3
        return 2 if self.geometry is None else self.geometry.dimension

    @property
    def has_element_lengths(self) -> bool:
        """True if elements are as long as their distance from crack tips and corners allows: of a
        solid, and of a sector that is graded."""
        return self.dimension == 3 or (self.disk is not None and self.mesh.layout == "graded")

    @property
    def has_friction(self) -> bool:
        """True if there is friction between crack faces, in a case of the sweep at least."""
        own = self.contact is not None and bool(self.contact.friction)
        return own or any(self.swept.get("contact.friction", ()))

    @property
    def highest_order(self) -> int:
        """Highest multiple of the excitation's frequency at which a load acts."""
        tables: list[kinds.Periodic | None] = [self.excitation, *self.loads, self.base]
        return max(table.highest for table in tables if table is not None)

    @property
    def has_other_loads(self) -> bool:
        """True if there is a load beside the force at ``excitation.point``."""
        return bool(self.loads) or self.base is not None or self.structure is not None

    def given(self, name: str) -> Any:
        """A table that a command cannot do without; InputError where there is none."""
        if getattr(self, name) is None:
            raise InputError(name, None, "given for this command: a table")
        condensed = self.harmonic_balance.form == "condensed"
        allowed = f"'condensed' for this command, by the table [{name}]"
        self.harmonic_balance.require(condensed or name not in SOLVED_OFTEN, "form", allowed)
        return getattr(self, name)

    @property
    def speed(self) -> float:
        """Rotor speed [rad/s]; 0 where there is none."""
        return 0.0 if self.rotation is None else self.rotation.speed

    def _asks_in(self, name: str) -> bool:
        """Return True if a key in another unit than SI is given, followed or swept."""
        table, key = name.split(".")
        given = getattr(getattr(self, table), key, None) is not None
        followed = self.curve is not None and self.curve.parameter == key
        return given or followed or name in self.swept

    @property
    def in_rpm(self) -> bool:
        """True if the rotor's speed is given, or swept, in revolutions per minute."""
        return self._asks_in("rotation.rpm")

    @property
    def in_hertz(self) -> bool:
        """True if the load's frequency is given, followed or swept in Hz, and so to be shown."""
        by_order = self.excitation.order is not None and self.in_rpm
        return by_order or self._asks_in("excitation.frequency")

    @property
    def quantities(self) -> tuple[str, ...] | None:
        """Quantities of ``[output]``; None where it does not choose."""
        return None if self.output is None else self.output.quantities

    @property
    def points(self) -> tuple[Point, ...]:
        """Points of ``[output.points]``."""
        return () if self.output is None else self.output.points

    @property
    def point_names(self) -> dict[str, str]:
        """The points in each direction, "tip.ux", "tip.uy", and their words."""
        return {
            f"{point.key}.u{axis}": f"{axis} displacement of {point.key}"
            for point in self.points
            for axis in "xyz"[: self.dimension]
        }

    def at_rest(self) -> Scene:
        """The scene without rotation, its load at the same frequency."""
        changes: dict[str, object] = {"rotation": None, "curve": None, "sweep": None}
        if self.excitation.order is not None:
            changes["excitation.omega"] = self.excitation.omega
            if self.disk is not None:  # whose order gives the phases
                changes["excitation.order"] = self.excitation.order
        return self.replace(changes)

    @property
    def swept(self) -> dict[str, tuple[Any, ...]]:
        """The keys of a sweep, and their values."""
        return {} if self.sweep is None else {axis.key: axis.values for axis in self.sweep.over}

    @property
    def swept_omegas(self) -> tuple[float, ...]:
        """The load frequencies of a sweep [rad/s]; without one, or where it is the same for all
        cases, that of the excitation."""
        swept = self.swept
        if "excitation.frequency" in swept:
            return tuple(RAD_PER_TURN * hertz for hertz in swept["excitation.frequency"])
        orders = swept.get("excitation.order", (self.excitation.order,))
        if None in orders or "excitation.omega" in swept:  # this in place of an order
            return swept.get("excitation.omega", (self.excitation.omega,))
        speeds = tuple(RAD_PER_S_PER_RPM * rpm for rpm in swept.get("rotation.rpm", ())) or (
            self.speed,
        )
        speeds = swept.get("rotation.speed", speeds)
        return tuple(order * speed for order in orders for speed in speeds)

    @property
    def axis(self) -> tuple[np.ndarray, np.ndarray]:
        """A point of the rotor's axis in space [m], and its direction, of length 1."""
        if self.disk is None:
            assert self.rotation is not None
            sides = self.geometry.sides
            return self.rotation.place(0.5 * np.array(sides if len(sides) == 3 else np.zeros(3)))
        plane, axis = self.dimension == 2, np.array(self.disk.axis or (1.0, 0.0, 0.0))
        if self.mesh.layout == "file":
            point = [*(self.disk.center or (0.0,)), 0.0, 0.0][:3]
        else:
            below, middle = -self.disk.given("outer_radius"), 0.5 * self.geometry.across
            point = [middle, below, 0.0] if plane else [0.0, below, middle]
        if plane:
            axis = np.array([0.0, 0.0, 1.0])
        return np.array(point), axis / np.linalg.norm(axis)

    @property
    def modes_key(self) -> str:
        """The key by which more modes are kept."""
        return "reduction.modes" if self.disk is None else "disk.families"

    @property
    def damped_modes(self) -> int | str:
        """``damping.modes``; "all" where the damping is a matrix."""
        return "all" if self.damping is None else self.damping.modes

    @partial(check_calls, find_scene_keys=lambda name: meant_keys(name))
    def replace(self, values: Mapping[str, object]) -> Scene:
        """Return a scene with some keys changed: ``scene.replace({"contact.stiffness": 1e9})``.

        An optional table is made where it is missing, and removed by ``{"crack": None}``. Tables of
        a list are counted from 1, ``{"cracks.1.length": 0.02}``; the next one is made. A frequency
        in Hz takes the place of the one in rad/s, and the other way round.
        """
        given = {item.name: getattr(self, item.name) for item in fields(self)}
        tables = _with_changes({name: one for name, one in given.items() if one}, values)
        return Scene(**{name: _made(name, table) for name, table in tables.items()})

    def as_toml(self) -> str:
        """The scene as a file that :meth:`load` reads; paths as they are."""
        parts = []
        for name, kind in _TABLES.items():
            tables = getattr(self, name)
            if name in _LISTS:
                header = f"[{kind.name_of()}]"
                parts += [table.as_toml().replace(header, f"[[{name}]]", 1) for table in tables]
            elif tables is not None:
                parts.append(tables.as_toml())
        return "\n".join(parts)


def _not_needed(scene: Scene, name: str) -> bool:
    """Return True if a table that a plate needs may be missing, for there are matrices instead."""
    if scene.structure is None:
        return False
    return name in PLATE_TABLES or (name == "damping" and scene.structure.damping is not None)


def without_tips(scene: Scene) -> str:
    """Why no stress intensities are known of a scene; "" of a plate with a crack."""
    if scene.structure is not None:
        return "with [structure]: stress intensities take a mesh"
    if scene.disk is not None:
        return "with [disk]: stress intensities are of one structure"
    if not scene.all_cracks and (scene.contact is None or scene.mesh.layout != "file"):
        return "without a crack, which has a stress intensity"
    if scene.has_friction:
        return "with contact.friction: stress intensities leave out what friction does at the faces"
    if any(crack.clearance < 0.0 for crack in scene.all_cracks.values()):
        return "with crack.clearance < 0: a wedge up to the tip, where K grows without limit"
    return ""


def without_ellipse(scene: Scene) -> str:
    """Why a scene's crack does not grow as half of an ellipse; "" where it does."""
    if scene.crack is None or not scene.crack.is_elliptical or scene.cracks:
        return "without one crack with crack.front = 'elliptical', or around a point"
    return without_tips(scene)


def without_clamp(scene: Scene) -> str:
    """Why the forces of the clamp are not known; "" where they are."""
    if scene.structure is not None:
        return "with [structure]: matrices have no clamp, a mesh has"
    if scene.disk is not None:
        return "with [disk]: reactions are of the clamp of one structure"
    if scene.rotation is not None:
        return "with [rotation]: reactions are of what vibrates at rest"
    return ""


def check_known(without: str, key: str, value: object = None) -> None:
    """Raise InputError, of a key and its value, where there is a reason why it cannot be known."""
    if without:
        raise InputError(key, value, f"left out {without}")


def _without(scene: Scene, one: Observable) -> str:
    """Why an observable is not known of a scene; "" where it is."""
    if ObservableFlag.REQUIRES_FRICTION in one.flags and not scene.has_friction:
        return "without contact.friction"
    if ObservableFlag.REQUIRES_GROWTH_LAW in one.flags and scene.growth is None:
        return "without a table [growth], which has its exponent"
    if ObservableFlag.REQUIRES_SOLID in one.flags and (
        scene.structure is not None or scene.dimension == 2
    ):
        return "without geometry.kind = 'solid'"
    return _WITHOUT[one.place](scene) if one.place in _WITHOUT else ""


def asked_quantities(scene: Scene) -> tuple[str, ...]:
    """Return the quantities of ``output.quantities`` at places of rows of their own."""
    return tuple(
        name for name in scene.quantities or () if OBSERVABLES_BY_NAME[name].place.on_request
    )


_WITHOUT: dict[Place, Callable[[Scene], str]] = {
    Place.TIPS: without_tips,
    Place.ELLIPSE: without_ellipse,
    Place.CLAMP: without_clamp,
}
"""Why there is nothing at a place of a scene; "" where there is."""


def files_of(scene: Scene) -> list[tuple[str, str]]:
    """The keys that name files, mesh or matrices, of the scene and its sweep, and the files."""
    found = [item for item in _paths(scene).items() if not item[0].startswith(LOOKED_AT)]
    for key, values in scene.swept.items():
        if key in _PATHS:
            found += [(key, value) for value in values if isinstance(value, str)]
    return found


def _paths(scene: Scene) -> dict[str, str]:
    """Keys that name files, and the files."""
    named = ((key, *key.split(".")) for key in _PATHS)
    found = {key: getattr(getattr(scene, table), name, None) for key, table, name in named}
    return {key: value for key, value in found.items() if isinstance(value, str)}


def with_files(scene: Scene, change: Callable[[str], str]) -> Scene:
    """The scene with the paths of its files changed."""
    paths = _paths(scene)
    if not paths:
        return scene
    changes: dict[str, object] = {key: change(path) for key, path in paths.items()}

    def moved(axis: Axis) -> Axis:
        values = (change(v) if isinstance(v, str) else v for v in axis.values)
        return Axis(axis.key, tuple(values)) if axis.key in _PATHS else axis

    for name, key in _AXES:
        if (table := getattr(scene, name)) is not None:
            changes[f"{name}.{key}"] = tuple(map(moved, getattr(table, key)))
    if scene.identify is not None and scene.identify.meshes:
        meshes = (dataclasses.replace(mesh, key=change(mesh.key)) for mesh in scene.identify.meshes)
        changes["identify.meshes"] = tuple(meshes)
    return scene.replace(changes)


def _in_short(scene: Scene) -> str:
    """Describe the structure, its cracks, and the load's frequency."""
    if scene.structure is not None:
        parts = [f"matrices {scene.structure.stiffness!r}"]
    elif scene.mesh.layout == "file":
        parts = [f"mesh {scene.mesh.file!r}"]
    elif scene.geometry.file is not None:
        parts = [f"part {scene.geometry.file!r}"]
    else:
        sides = " x ".join(f"{side:g}" for side in scene.geometry.sides)
        parts = [f"{scene.geometry.kind} of {sides} m"]
    for crack in scene.all_cracks.values():
        parts.append("crack" if crack.length is None else f"crack of {crack.length:g} m")
    if scene.contact is not None:
        parts.append(scene.contact.law)
    factor, _, unit = frequency_axis(scene.in_hertz)
    return f"{', '.join(parts)}, {factor * scene.excitation.omega:g} {unit}"


def _hint_in(text: str, error: str) -> str:
    """Suggest the value to write in the line that an error of TOML names, a number in SI units or a
    word in quotes; or ""."""
    lines, place = text.splitlines(), re.search(r"at line (\d+)", error)
    if place is None or int(place[1]) > len(lines):
        return ""
    above, line = lines[: int(place[1])], lines[int(place[1]) - 1]
    headers = [one.strip("[ ]") for one in above if one.startswith("[")]
    key, _, value = (part.strip() for part in line.partition("#")[0].partition("="))
    number = convert_number(value.strip("\"'"), unit_of(".".join([*headers[-1:], key])))
    if number is None and not value.isidentifier():
        return ""
    right = f'"{value}"' if number is None else format_scene_value(number)
    return f"; {did_you_mean_text([f'{key} = {right}'])}".rstrip()


def known_keys() -> list[str]:
    """Every key of a scene; of a list of tables those of the first."""
    tables = [(f"{name}.1" if name in _LISTS else name, kind) for name, kind in _TABLES.items()]
    return [f"{name}.{key}" for name, kind in tables for key in kind.keys()]


def unit_of(name: str) -> str:
    """The unit of the values of a key, "cracks.1.length"; empty if they have none."""
    table, _, key = _parts(name)
    known = _TABLES[table].keys() if table in _TABLES else {}
    return str(known[key].metadata["unit"]) if key in known else ""


# --- what tables must not contradict --------------------------------------------------------------


def _check_matrices(scene: Scene, structure: kinds.Structure) -> None:
    _check_absent(scene, PLATE_TABLES, "[structure]")
    if structure.damping is not None:
        _check_absent(scene, ("damping",), "structure.damping")
    if structure.model is None:
        force = scene.excitation.force_given
        allowed = "left out with [structure], which has files, or has no model with the places"
        absent = not force and scene.excitation.point is None
        scene.excitation.require(absent, force or "point", allowed)
        matrices = structure.mass, structure.stiffness, structure.damping or ""
        if not any(Path(file).suffix.lower() in (".sti", ".mas") for file in matrices):
            structure.leave_out(("dofs",), "matrices that have no model, and are not CalculiX's")
    if structure.gap is None and (structure.model is None or scene.contact is None):
        per_pair = ("clearance", "areas", "tangential")
        structure.leave_out(per_pair, "no pairs: no gap, nor a model with [contact]")
    _check_vectors(scene)
    if scene.excitation.point is None:
        files = (structure.force_sin, structure.force_cos, structure.force_mean)
        allowed = "given: where the force acts; or a file structure.force_sin, _cos or _mean"
        scene.excitation.require(any(files) and not scene.excitation.force_given, "point", allowed)
    if structure.gap is not None and scene.contact is None:
        raise InputError("contact", None, "given with structure.gap: a table")
    if scene.contact is not None:
        allowed = "'all' with [structure]"
        scene.contact.require(scene.contact.pairs == "all", "pairs", allowed)
        if structure.areas is None and (structure.model is None or structure.gap is not None):
            scene.contact.leave_out(("stiffness_per_area",), "[structure], which has no areas")
        if structure.model is None and structure.gap is None:
            allowed = "left out without structure.gap or model: there are no pairs"
            raise InputError("contact", "a table", allowed)


def _check_absent(scene: Scene, tables: Iterable[str], why: str) -> None:
    """Raise InputError for the first of some tables that is there."""
    for name in tables:
        if getattr(scene, name):
            raise InputError(name, "a table", f"left out with {why}")


def _check_vectors(scene: Scene) -> None:
    """Give all tables vectors of the plane or of space; InputError where they are not."""
    dimension = scene.dimension
    for name in _TABLES:
        held = getattr(scene, name)
        if name in _LISTS:
            found: Any = []
            for number, table in enumerate(held, 1):
                with named(f"{name}.{number}"):
                    found.append(table.with_vectors(dimension))
            object.__setattr__(scene, name, tuple(found))
        elif held is not None:
            object.__setattr__(scene, name, held.with_vectors(dimension))
    for point in scene.points:
        if len(point.values) != dimension:
            raise InputError(f"output.points.{point.key}", point.values, components("", dimension))


def _check_dimension(scene: Scene) -> None:
    """Raise InputError where a table is not one of a plate, or of a solid."""
    geometry, dimension = scene.geometry, scene.dimension
    if dimension == 2 and scene.rotation is not None:
        scene.rotation.leave_out(("axis", "center"), "a plate: its axis is parallel to x")
    for name, crack in scene.all_cracks.items() if dimension == 2 else ():
        with named(name):
            crack.leave_out(kinds.OF_PLANES, "geometry.kind = 'plate'")
    _check_vectors(scene)
    mesh = scene.mesh
    if scene.contact is not None and scene.contact.pairs == "mouth":
        mesh.leave_out(("patches",), "contact.pairs = 'mouth', which keeps one")
    if dimension == 3:
        reason = "2 with geometry.kind = 'solid': tetrahedra of order 1 are much too stiff"
        mesh.require(mesh.order == 2, "order", reason)
        allowed = "'graded' or 'file' with geometry.kind = 'solid'"
        mesh.require(mesh.layout != "grid", "layout", allowed)
        mesh.leave_out(("cells",), "geometry.kind = 'solid', which is meshed by tetrahedra")
        if scene.contact is not None and scene.contact.friction and scene.disk is not None:
            allowed = "0, or left out, with [disk] and geometry.kind = 'solid': not there yet"
            scene.contact.require(False, "friction", allowed)
    if geometry.file is None:
        mesh.leave_out(("per_turn",), "no geometry.file: it has no curved faces")
    if dimension == 2 or (mesh.layout != "file" and geometry.file is None):
        geometry.given("thickness", "given: a finite number > 0")


def _check_disk(scene: Scene, disk: kinds.Disk) -> None:
    """Raise InputError for what a bladed disk is not, or is not there yet."""
    _check_absent(scene, ("base", "growth", "identify", "reduction"), "[disk]")
    scene.excitation.given("order", "given with [disk]: the engine order, a whole number >= 1")
    if scene.speed == 0.0:
        allowed = "given [rad/s] with [disk] at rest, or excitation.frequency [Hz]"
        scene.excitation.given("omega", allowed)
    if scene.curve is not None:
        allowed = "another one with [disk]: the load's frequency, for example"
        scene.curve.require(scene.curve.followed[0] != "speed", "parameter", allowed)
    for name, crack in scene.all_cracks.items():
        with named(name):
            crack.leave_out(("first_omega", "first_frequency"), "[disk]")
    radii = ("inner_radius", "outer_radius")
    if scene.mesh.layout == "file":
        disk.leave_out(radii, "mesh.layout = 'file'")
        return
    disk.leave_out(("center", "axis"), "a blade on a rim that is made here")
    inner, outer = (disk.given(key) for key in radii)
    disk.require(inner < outer, "inner_radius", f"less than disk.outer_radius = {outer:g}")
    across = scene.geometry.across
    room = 2.0 * outer * math.sin(math.pi / disk.sectors)
    allowed = f"so large that blades {across:g} m across stand apart: their feet have {room:g} m"
    disk.require(across < room * (1.0 - LEAST_DISTANCE), "outer_radius", allowed)
    low = outer - math.sqrt(outer**2 - 0.25 * across**2)
    allowed = f"less than the {outer - low:g} m at which the blade meets the rim"
    disk.require(inner < outer - low, "inner_radius", allowed)


def _check_plate(scene: Scene) -> None:
    geometry = scene.geometry
    _, height = (geometry.given(key) for key in ("width", "height"))
    for key in ("width", "thickness")[: scene.dimension - 1]:
        near = height / THINNEST <= getattr(geometry, key) <= height * THINNEST
        allowed = f"within a factor {THINNEST:g} of geometry.height = {height:g}"
        geometry.require(near, key, allowed)
    if not scene.has_other_loads:
        scene.excitation.given("point", "given: [x, y] on the plate")
    if scene.excitation.point is None and (force := scene.excitation.force_given):
        scene.excitation.require(False, force, "left out without excitation.point")
    loads = {f"loads.{number}": load for number, load in enumerate(scene.loads, 1)}
    for name, load in ({"excitation": scene.excitation} | loads).items():
        sides = geometry.sides
        within = [0.0 <= x <= side for x, side in zip(load.point or (), sides, strict=False)]
        with named(name):
            where = ", ".join(f"0..{side:g}" for side in sides)
            load.require(all(within), "point", f"on the {geometry.kind}: [{where}]")
    if scene.all_cracks:
        _check_cracks(scene)
        if scene.contact is None:
            raise InputError("contact", None, "given where there is a crack: a table")


def _check_part(scene: Scene) -> None:
    """Raise InputError where a part from a CAD file cannot be meshed as the scene says."""
    scene.mesh.require(scene.mesh.layout == "graded", "layout", "'graded' with geometry.file")
    if scene.disk is not None:
        raise InputError("disk", "a table", "left out with geometry.file")
    if not scene.has_other_loads:
        scene.excitation.given("point", "given: [x, y, z], on the part or near it")
    if scene.all_cracks:
        scene.mesh.given("lip_elements", "given where there is a crack")
        if scene.contact is None:
            raise InputError("contact", None, "given where there is a crack: a table")
    for name, crack in scene.all_cracks.items():
        with named(name):
            crack.given("point", "given with geometry.file: [x, y, z]")
            crack.check_plane()


def _check_file(scene: Scene) -> None:
    of_file = ("width", "height", "thickness")[: scene.dimension]
    scene.geometry.leave_out(of_file, "mesh.layout = 'file'")
    for name, crack in scene.all_cracks.items():
        with named(name):
            crack.leave_out(_OF_SHAPES, "mesh.layout = 'file'")


# --- where the cracks of a plate may be -----------------------------------------------------------

LEAST_DISTANCE = 1e-4
"""Minimum distance of cracks and crack tips from the edges and each other, relative to the side."""
_OF_SHAPES = (*kinds.OF_BOXES, "length", "depth", "front", *kinds.OF_PLANES)
"""Keys of a crack that a mesh file defines itself."""


def _check_cracks(scene: Scene) -> None:
    """Raise InputError where a crack cannot be in a plate, by the crack's name in the scene."""
    cracks, geometry, mesh = scene.all_cracks, scene.geometry, scene.mesh
    for name, crack in cracks.items():
        with named(name):
            if crack.point is not None:
                crack.check_plane()
                continue
            crack.leave_out(kinds.OF_PLANES, "no crack.point")
            crack.require(crack.front != "through", "front", "another one without crack.point")
            _check_crack(crack, geometry, list(cracks))
            _check_front(crack, geometry)
            if mesh.layout == "grid":
                _check_grid(crack, geometry, mesh)
    if mesh.layout == "graded":
        mesh.given("lip_elements", "given where there is a crack")
    for first, second in combinations([n for n, c in cracks.items() if c.point is None], 2):
        _check_apart(scene, first, second)


def _check_crack(crack: kinds.Crack, geometry: kinds.Geometry, names: list[str]) -> None:
    width, height, *_ = geometry.sides
    kind, margin = geometry.kind, f"at least {LEAST_DISTANCE:g} of that from both"
    inside = crack.center is not None
    if inside:
        crack.leave_out(("edge",), "crack.center")
    else:
        crack.given("edge", f"given: 'left' or 'right'; or center, for a crack inside the {kind}")
    allowed = f"inside the {kind}: between 0 and geometry.height = {height:g}, {margin}"
    crack.require(_inside(crack.height or 0.0, height), "height", allowed)
    if len(names) > 1:
        why = "several cracks: it finds the length of the only one"
        crack.leave_out(("first_frequency", "first_omega"), why)
    allowed = "given, or left out where crack.first_omega determines it, or first_frequency"
    crack.require((crack.length is None) != (crack.first_omega is None), "length", allowed)
    allowed = f"shorter than the {kind}: between 0 and geometry.width = {width:g}, {margin}"
    crack.require(crack.length is None or _inside(crack.length, width), "length", allowed)
    if inside:
        ends = [crack.center] if crack.length is None else crack.span(width)
        allowed = f"such that both tips are inside the {kind}: between 0 and {width:g}, {margin}"
        crack.require(all(_inside(end or 0.0, width) for end in ends), "center", allowed)


def _check_front(crack: kinds.Crack, geometry: kinds.Geometry) -> None:
    if geometry.dimension == 2:
        crack.leave_out(("depth", "front"), "geometry.kind = 'plate'")
    elif crack.depth is None:
        crack.leave_out(("front",), "a crack through the thickness: there is no crack.depth")
    else:
        thickness = geometry.sides[2]
        words = f"geometry.thickness = {thickness:g}"
        allowed = f"less than {words}, by {LEAST_DISTANCE:g} of that; left out: through it"
        crack.require(_inside(crack.depth, thickness), "depth", allowed)


def _check_grid(crack: kinds.Crack, geometry: kinds.Geometry, mesh: kinds.Mesh) -> None:
    crack.given("length", "given with mesh.layout = 'grid'")
    (width, height), columns = geometry.sides, mesh.given("columns")
    sides = {"length": (width, columns), "height": (height, mesh.given("rows"))}
    for key, (extent, count) in sides.items():
        cells, size = getattr(crack, key) / extent * count, f"{extent / count:g} m"
        whole = 0 < round(cells) < count and abs(cells - round(cells)) < 1e-9 * count
        allowed = f"a whole number of grid cells of {size}, at least one from each end"
        crack.require(whole, key, allowed)
    if crack.center is not None:
        tip = crack.span(width)[0] / width * columns
        allowed = f"such that both tips are on grid lines, {width / columns:g} m apart"
        crack.require(abs(tip - round(tip)) < 1e-9 * columns, "center", allowed)


def _check_apart(scene: Scene, first: str, second: str) -> None:
    """Raise InputError unless two cracks are far enough from each other."""
    one, other = (scene.all_cracks[name] for name in (first, second))
    width, height, *_ = scene.geometry.sides
    distance = abs(one.given("height") - other.given("height"))
    if distance >= LEAST_DISTANCE * height:
        return
    same = distance <= 1e-9 * height
    spans = sorted(crack.span(width) for crack in (one, other))
    ligament = spans[1][0] - spans[0][1]
    if not same or ligament < LEAST_DISTANCE * width:
        least = f"{LEAST_DISTANCE * height:g} m above or below"
        if same:
            least += f", or with {LEAST_DISTANCE * width:g} m between their tips"
        allowed = f"apart from that of {first}: cracks may not touch; at least {least}"
        raise InputError(f"{second}.height", other.height, allowed)


def _inside(place: float, extent: float) -> bool:
    """Return True if a place is between 0 and an extent, and not too close to either."""
    return LEAST_DISTANCE * extent <= place <= (1.0 - LEAST_DISTANCE) * extent


# --- axes of keys ---------------------------------------------------------------------------------


def _checked_axes(scene: Scene, name: str, given: tuple[Axis, ...]) -> tuple[Axis, ...]:
    """Axes with values as their keys hold them; each case is checked when it is made."""
    axes, seen = [], set()
    for axis in given:
        table, number, key = _parts(axis.key)
        there = number is None or number <= len(getattr(scene, table))
        known_key = table in _SWEPT and key in _TABLES[table].keys()
        if not (known_key and there) or axis.key in seen:
            allowed = f"a table.key of the scene, given once, with a table of {', '.join(_SWEPT)}"
            if (question := did_you_mean_text(_meant(axis.key))) and axis.key not in seen:
                allowed += f"; {question}".rstrip()
            raise InputError(name, axis.key, allowed)
        seen.add(axis.key)
        for twins in _TABLES[table].twins().items():
            at = axis.key.removesuffix(f".{key}")
            if seen.issuperset(both := [f"{at}.{name}" for name in twins]):
                allowed = f"without {both[0] if axis.key == both[1] else both[1]}: one of them"
                raise InputError(name, axis.key, allowed)
        with named(axis.key.removesuffix(f".{key}")):
            values = tuple(_TABLES[table].checked(key, value) for value in axis.values)
        if len(set(values)) != len(values) or not values:
            raise InputError(f'{name}."{axis.key}"', values, "values, each given once")
        axes.append(Axis(axis.key, values))
    return tuple(axes)


# --- lists of tables ------------------------------------------------------------------------------


def _parts(name: str) -> tuple[str, int | None, str]:
    """Table, place in a list counted from 1, and key of "cracks.1.length"; without a list None."""
    table, _, key = name.partition(".")
    place, _, rest = key.partition(".")
    if table in _LISTS and place.isdecimal() and 0 < len(place) < 10 and int(place) > 0:
        return table, int(place), rest
    return table, None, key


def _made(name: str, value: object) -> Any:
    """A table, or the tuple of a list of tables, from what a file holds; one that is made stays."""
    kind = _TABLES[name]
    if name not in _LISTS:
        return value if isinstance(value, kind) else kind.from_mapping(value)
    if not isinstance(value, list | tuple):
        raise InputError(name, value, f"a list of tables: [[{name}]]")
    made = []
    for number, table in enumerate(value, 1):
        with named(f"{name}.{number}"):
            made.append(table if isinstance(table, kind) else kind.from_mapping(table))
    return tuple(made)


def _changed_key(name: str, value: object) -> tuple[str, int | None, str]:
    """Table, place in a list and key of what is changed; without a key the table is removed."""
    table, number, key = _parts(name)
    kind = _TABLES.get(table)
    if kind is None:
        raise InputError(name, value, _instead_of(name))
    if not key and kind.WORD is not None and isinstance(value, str):
        return table, None, kind.WORD
    if not key:
        if value is not None or number is not None or table not in (*_OPTIONAL, *_LISTS):
            gone = ", ".join((*_OPTIONAL, *_LISTS))
            allowed = f"changed key by key; only {gone} can be removed, by none"
            raise InputError(name, value, allowed)
    elif (number is None) == (table in _LISTS):
        known = ", ".join(f"{table}.1.{own}" for own in kind.keys())
        raise InputError(name, value, f"left out; known keys: {known}")
    elif key not in kind.keys():
        whole, _, own = key.partition(".")
        if whole in kind.keys() and own:
            raise InputError(name, value, f"changed as a whole: {table}.{whole}={{{own}=...}}")
        raise InputError(name, value, kind.instead_of(key))
    return table, number, key


def _with_changes(tables: Mapping[str, Any], values: Mapping[str, object]) -> dict[str, Any]:
    """Tables, or what a file holds of them, with some keys changed."""
    found = dict(tables)
    changes: dict[tuple[str, int], dict[str, object]] = {}
    for name, value in values.items():
        table, number, key = _changed_key(str(name), value)
        if key:
            changes.setdefault((table, number or 0), {})[key] = value
        else:
            found.pop(table, None)
    for (table, number), change in sorted(changes.items(), key=lambda item: item[0][1]):
        if number:
            found[table] = _changed_list(table, found.get(table, ()), number, change)
        else:
            found[table] = _changed(table, found.get(table), change)
    return found


def _changed(name: str, table: Any, change: dict[str, object]) -> Any:
    """A table, or the mapping of one that is to be made, with other values; a new one."""
    kind = _TABLES[name]
    if isinstance(table, kind):
        table = {key: getattr(table, key) for key in kind.keys().keys() - table.derived}
    if kind.WORD is not None and isinstance(table, str):
        table = {kind.WORD: table}
    if table is None:
        return change
    if not isinstance(table, Mapping):  # refused when it is made
        return table
    return {**table, **kind.without_twins(change, table)}


def _changed_list(
    name: str, tables: Any, number: int, change: dict[str, object]
) -> tuple[Any, ...]:
    if not isinstance(tables, list | tuple):
        raise InputError(name, tables, f"a list of tables: [[{name}]]")
    if number > len(tables) + 1:
        key = f"{name}.{number}.{next(iter(change))}"
        allowed = f"one of the {len(tables)} [[{name}]], or of the next one"
        raise InputError(key, next(iter(change.values())), allowed)
    old = tables[number - 1] if number <= len(tables) else None
    with named(f"{name}.{number}"):
        return (*tables[: number - 1], _changed(name, old, change), *tables[number:])


def _meant(name: str) -> list[str]:
    """The keys and tables of a scene that a misspelt name may stand for."""
    table, _, key = name.partition(".")
    if table in _TABLES:
        return _TABLES[table].meant_by(key) if key else []
    if key:
        every = {kind.proposed(key) for kind in _TABLES.values() for key in kind.keys()}
        return find_similar_names(name, every, 0.8) or sorted(
            full for full in every if full.endswith(f".{key}")
        )
    return list(dict.fromkeys(with_key(table, _TABLES.values()))) or find_similar_names(
        table, _TABLES
    )


def meant_keys(name: str) -> list[str]:
    """The keys with their tables that a name without one may stand for."""
    first = {key.rpartition(".")[2]: key for key in reversed(known_keys())}
    own = _meant(name) or [first[key] for key in find_similar_or_longer_names(name, first)]
    return own or find_similar_or_longer_names(name, known_keys())


def _instead_of(name: str) -> str:
    """Return the error text for a table that the scene does not have."""
    return f"left out; {did_you_mean_text(_meant(name))}known tables: {', '.join(_TABLES)}"


_HINTS = get_type_hints(Scene).items()
_TABLES: dict[str, type[Table]] = {name: (get_args(hint) or (hint,))[0] for name, hint in _HINTS}
_LISTS = tuple(name for name, hint in _HINTS if get_origin(hint) is tuple)
_OPTIONAL = tuple(name for name, hint in _HINTS if type(None) in get_args(hint))
_PATHS = tuple(
    kind.name_of(key)
    for kind in _TABLES.values()
    for key, item in kind.keys().items()
    if "path" in item.metadata
)
"""Keys that hold the path of a file."""
_AXES = ("sweep", "over"), ("identify", "unknown")
"""Tables and their keys that hold axes."""
_WITH_FILES = (*_PATHS, *(f"{name}.{key}" for name, key in _AXES), "identify.meshes")
"""Keys that may hold paths."""
_SWEPT = tuple(name for name in _TABLES if name not in LOOKED_AT)
