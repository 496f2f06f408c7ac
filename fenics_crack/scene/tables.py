"""The tables of a scene: each field states once what a key may hold."""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import MISSING, dataclass
from itertools import zip_longest
from typing import Any, ClassVar

import numpy as np

from fenics_crack.basics.errors import (
    DEFAULT_ERROR_TOLERANCE,
    MAX_SAMPLES_PER_PERIOD,
    InputError,
    check_rayleigh_damping_ratios,
)
from fenics_crack.basics.observables import OBSERVABLES_BY_NAME
from fenics_crack.basics.tables import RAD_PER_S_PER_RPM, RAD_PER_TURN
from fenics_crack.scene.fields import (
    ALLOWED_MAGNITUDES_TEXT,
    ZERO_OR_MAGNITUDE_TEXT,
    Axis,
    FacePoints,
    Harmonic,
    MeshFile,
    NamedPoint,
    Pair,
    Table,
    Vector,
    bounded_field,
    choice_field,
    harmonic_order_field,
    harmonics_field,
    hertz_field,
    nonnegative_field,
    number_field,
    path_field,
    positive_field,
    positive_int_field,
    twin_field,
    value_field,
    vector_value_field,
)

FORCE_KEYS = ("force_mean", "force_cos", "force_sin")
"""Keys for the parts of the excitation's force."""
LOAD_KINDS = ("force", "pressure", "traction")
"""Kinds of [[loads]]: a force acts at a point, pressure and traction on an edge."""
MAX_ALLOWED_OUTPUT_POINTS = 100
"""Maximum number of points in ``[output.points]``: each is computed, printed and written."""
MAX_ALLOWED_FACE_POINTS = 200
"""Maximum number of points in ``[geometry.faces]``."""
MIN_ALLOWED_VALUES_PER_UNKNOWN = 4
"""Minimum number of values for an unknown in [identify], for interpolation between them."""


@dataclass(frozen=True)
class Geometry(Table):
    """A plate [0, width] x [0, height] in plane stress, clamped along y = 0, or a solid.

    A solid is a box [0, width] x [0, height] x [0, thickness], clamped at y = 0, or a part from a
    CAD file. A mesh file has its own shape.
    """

    kind: str = choice_field("plate", "solid", default="plate")
    """"plate": plane stress; "solid": three dimensions."""
    thickness: float | None = positive_field(None, unit="m")
    """Thickness of a plate, also with a mesh file, or of a box along z."""
    width: float | None = bounded_field("1e-6", "1e6", None, unit="m")
    height: float | None = bounded_field("1e-6", "1e6", None, unit="m")
    file: str | None = value_field(
        "the path of a .step, .stp or .brep file",
        lambda path: path.lower().endswith((".step", ".stp", ".brep")),
        None,
        path=True,
    )
    """CAD file with a part without a crack, one solid, for meshing."""
    unit: str | None = choice_field("mm", "m", "inch", default=None)
    """Length unit of a .brep file, which does not state the unit."""
    faces: tuple[FacePoints, ...] = value_field(
        "a table of face names, each with a list of points [x, y, z] in m on faces of the part; "
        f"at most {MAX_ALLOWED_FACE_POINTS} points",
        lambda faces: sum(len(face.values) for face in faces) <= MAX_ALLOWED_FACE_POINTS,
        (),
    )
    """Names of a part's faces, each with points [m] on the face or near it."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.file is None:
            self.forbid_keys(("unit", "faces"), "without geometry.file")
            return
        self.require(self.kind == "solid", "kind", "'solid' with geometry.file")
        self.forbid_keys(("width", "height", "thickness"), "geometry.file")
        has_clamp = any(face.key == "clamp" and face.values for face in self.faces)
        self.require(
            has_clamp, "faces", "a table with points on the clamped faces, clamp = [[x, y, z]]"
        )
        if self.file.lower().endswith(".brep"):
            self.given("unit", "given: 'mm', 'm' or 'inch', as a .brep file does not state it")
        else:
            self.forbid_keys(("unit",), "a STEP file, which states the unit")

    @property
    def dimension(self) -> int:
        """2 for a plate, 3 for a solid."""
        return 3 if self.kind == "solid" else 2

    @property
    def sides(self) -> Vector:
        """Width, height and, for a solid, thickness [m]; keys left out are omitted."""
        side_lengths = (self.width, self.height, self.thickness)[: self.dimension]
        return tuple(side_length for side_length in side_lengths if side_length is not None)

    @property
    def circumferential_width(self) -> float:
        """Width of a plate, or thickness of a box [m].

        In a bladed disk this side lies along the circumference.
        """
        return self.sides[0 if self.dimension == 2 else 2]


BOX_CRACK_KEYS = ("edge", "center", "height", "first_frequency", "first_omega")
"""Keys of a crack in a plate, or in the plane y = height of a box; length and depth are further
keys."""
PLANE_CRACK_KEYS = ("point", "normal", "direction", "radii")
"""Keys of a crack in an arbitrary plane of a solid."""


@dataclass(frozen=True)
class Crack(Table):
    """Straight horizontal crack: a slit whose two faces share only the tip, or both tips.

    In a box the crack lies in the plane y = height, through the thickness, or with a ``depth`` from
    the face z = thickness. In a box or a part, a crack may lie in any plane. The crack is then the
    part inside the solid of an ellipse around ``point``, or of the half-plane ending at ``point``.
    """

    _ADVICE_TEXT_BY_MISTAKE: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("edge = top", "edge = bottom"),
        "cracks of a plate are horizontal; for other directions use mesh.layout = 'file'",
    )

    edge: str | None = choice_field("left", "right", default=None)
    """Plate edge at the crack's mouth; left out for a crack inside the plate."""
    center: float | None = positive_field(None, unit="m")
    """x of the middle, for a crack inside the plate."""
    height: float | None = positive_field(None, unit="m")
    """Coordinate y of the crack."""
    length: float | None = positive_field(None, unit="m")
    """Length of the crack; computed if ``first_omega`` is given instead."""
    depth: float | None = positive_field(None, unit="m")
    """Depth of a crack that does not go through a solid."""
    front: str | None = choice_field("straight", "elliptical", "through", default=None)
    """Shape of a crack with a depth: a rectangle, half an ellipse, or a quarter at an edge.

    "through": the half-plane that ends at ``point``.
    """
    point: Vector | None = vector_value_field("", unit="m", of_solid=True)
    """Middle of the ellipse, or point on the half-plane's end.

    With "through" and a length: point at the mouth.
    """
    normal: Vector | None = vector_value_field("n", of_solid=True)
    """Normal of the crack's plane."""
    direction: Vector | None = vector_value_field("d", of_solid=True)
    """Direction of the first radius, or of growth for a half-plane.

    Only the component in the crack's plane counts.
    """
    radii: Pair | None = value_field(
        "[a, b], two finite numbers > 0", lambda radii: min(radii) > 0, None, unit="m"
    )
    """Radii of the ellipse, along the direction and across.

    Or give ``length``, twice the first radius, and ``depth``, the second radius.
    """
    first_omega: float | None = positive_field(None, unit="rad/s")
    """First natural frequency with the crack open, from which the length is computed."""
    first_frequency: float | None = hertz_field("first_omega")
    """``first_omega`` in Hz."""
    clearance: float = number_field(0.0, unit="m")
    """g0 >= 0: opening to be closed before the crack faces touch; < 0: preload."""

    def check_plane_keys(self) -> None:
        """Raise InputError unless the keys define a crack around a point in a solid."""
        self.forbid_keys(BOX_CRACK_KEYS, "crack.point")
        normal = np.array(self.given("normal"))
        self.require(any(normal), "normal", "a vector that is not zero")
        self.require(
            self.front in (None, "through"), "front", "'through', or left out, with crack.point"
        )
        given_keys = [
            given_key for given_key in ("length", "depth") if getattr(self, given_key) is not None
        ]
        if self.front == "through":
            self.forbid_keys(("radii", "depth"), "crack.front = 'through'")
        elif self.radii is not None:
            self.forbid_keys(given_keys, "crack.radii")
        else:
            requirement_text = (
                "given: [a, b] [m]; or crack.length and crack.depth; or crack.front = 'through'"
            )
            self.require(len(given_keys) == 2, "radii", requirement_text)
        if self.front == "through" or self.half_axes[0] != self.half_axes[1]:
            self.given(
                "direction", "given: [dx, dy, dz], the direction of the first radius or of growth"
            )
        if self.direction is not None:
            cross_norm = np.linalg.norm(np.cross(normal, self.direction))
            norm_product = np.linalg.norm(normal) * np.linalg.norm(self.direction)
            self.require(
                cross_norm > 1e-3 * norm_product, "direction", "a vector not along crack.normal"
            )

    @property
    def half_axes(self) -> Pair:
        """Radii of the ellipse around ``point`` [m]: along ``direction``, and across."""
        return self.radii or (0.5 * self.given("length"), self.given("depth"))

    @property
    def is_elliptical(self) -> bool:
        """True for an elliptical crack, around a point or in a box."""
        return self.front == "elliptical" or (self.point is not None and self.front != "through")

    @property
    def frame(self) -> np.ndarray:
        """Unit vectors of the crack as rows (3, 3): two in the plane, and the normal.

        The first row is ``direction`` projected into the plane. Without ``direction`` it is the
        projection of the coordinate axis farthest from the normal.
        """
        normal = np.array(self.given("normal"), dtype=float)
        normal /= np.linalg.norm(normal)
        first_axis = np.array(self.direction or np.eye(3)[np.abs(normal).argmin()], dtype=float)
        first_axis -= (first_axis @ normal) * normal
        first_axis /= np.linalg.norm(first_axis)
        return np.array([first_axis, np.cross(normal, first_axis), normal])

    def span(self, width: float) -> tuple[float, float]:
        """Return x at the crack's left and right end [m].

        ``width`` [m] is the plate's width, needed for a crack from the right edge.
        """
        crack_length = self.given("length")
        if self.edge is None:
            crack_center = self.given("center")
            return crack_center - 0.5 * crack_length, crack_center + 0.5 * crack_length
        return (0.0, crack_length) if self.edge == "left" else (width - crack_length, width)


@dataclass(frozen=True)
class Material(Table):
    """Isotropic linear elastic material."""

    _ADVICE_TEXT_BY_MISTAKE: ClassVar[Mapping[str, str]] = {
        "name": "give the numbers of the material, for steel young = 2.1e11, poisson = 0.3 and "
        "density = 7850.0;",
        "E": "did you mean material.young?",
        "nu": "did you mean material.poisson?",
        "rho": "did you mean material.density?",
    }

    young: float = positive_field(unit="Pa")
    """Young's modulus E."""
    poisson: float = value_field("a finite number with -1 < nu < 0.5", lambda nu: -1.0 < nu < 0.5)
    """Poisson's ratio [-]."""
    density: float = positive_field(unit="kg/m^3")


@dataclass(frozen=True)
class Damping(Table):
    """Modal or Rayleigh damping, given in one of three ways.

    Modal: ``ratio``, xi_j relative to critical damping, for each of the lowest ``modes``. With
    ``modes = "all"`` and one ratio, all coordinates of a reduced structure are damped.

    Rayleigh, C = mass M + stiffness K: ``mass`` and ``stiffness``, or one of them. Or ``ratios``,
    the damping ratios at the two frequencies ``omegas`` or ``frequencies``.
    """

    ratio: float | tuple[float, ...] | None = value_field(
        "a number from 0 to 1 (0.02 for 2 %), or a list of them, one per mode",
        lambda ratio: np.min(ratio) >= 0 and np.max(ratio) <= 1,
        None,
    )
    """Ratio to critical damping, for all modes or for each mode."""
    modes: int | str = value_field(
        "'all' or a whole number >= 1", lambda value: value == "all" or value >= 1, "all"
    )
    """Number of damped modes, from the lowest; "all": every mode."""
    mass: float | None = nonnegative_field(None, unit="1/s")
    stiffness: float | None = nonnegative_field(None, unit="s")
    ratios: Pair | None = value_field(
        "[xi_1, xi_2], two numbers from 0 to 1",
        lambda ratios: min(ratios) >= 0 and max(ratios) <= 1,
        None,
    )
    """Ratios to critical damping at two frequencies."""
    omegas: Pair | None = value_field(
        "[omega_1, omega_2], two different numbers > 0",
        lambda omegas: min(omegas) > 0 and omegas[0] != omegas[1],
        None,
        unit="rad/s",
    )
    frequencies: Pair | None = hertz_field(
        "omegas",
        "[f_1, f_2], two different numbers > 0",
        lambda values: 0 < min(values) < max(values) <= 1e29,
    )
    """``omegas`` in Hz."""

    def __post_init__(self) -> None:
        super().__post_init__()
        key_groups = [("ratio",), ("mass", "stiffness"), ("ratios", "frequencies", "omegas")]
        given_groups_and_keys = [
            (key_group, key)
            for key_group in key_groups
            for key in key_group
            if getattr(self, key) is not None
        ]
        requirement_text = (
            "given; or damping.mass or damping.stiffness; or damping.ratios with damping.omegas or "
            "damping.frequencies"
        )
        self.require(bool(given_groups_and_keys), "ratio", requirement_text)
        (chosen_key_group, key), *_ = given_groups_and_keys
        for key_group in key_groups:
            if key_group is not chosen_key_group:
                self.forbid_keys(key_group, f"damping.{key} = {getattr(self, key)}")
        if self.ratio is None:
            self.require(
                self.modes == "all", "modes", f"left out with damping.{key}, which damps all modes"
            )
        elif isinstance(self.ratio, tuple):
            has_right_length = self.modes in ("all", len(self.ratio))
            self.require(
                has_right_length, "ratio", f"a list with damping.modes = {self.modes} ratios"
            )
        if "ratios" in chosen_key_group:
            ratios = self.given("ratios", f"given: [xi_1, xi_2] at damping.omegas = {self.omegas}")
            omegas = self.given(
                "omegas",
                "given: [omega_1, omega_2] [rad/s], or damping.frequencies, for "
                f"damping.ratios = {self.ratios}",
            )
            check_rayleigh_damping_ratios(self.full_key("ratios"), ratios, omegas)

    @property
    def damps_all_modes(self) -> bool:
        """True if damping acts on every mode, whatever the number of modes in the structure."""
        if self.ratio is None:
            return max(self.mass or 0.0, self.stiffness or 0.0, *(self.ratios or ())) > 0.0
        return self.modes == "all" and float(np.min(self.ratio)) > 0.0


class PeriodicLoad:
    """Base class for tables with periodic loads.

    ``harmonics`` are the load's further harmonics. Only an excitation has ``wave``, the path of a
    file with one period of a force, from which ``wave_harmonics`` harmonics are kept.
    """

    harmonics: tuple[Harmonic, ...]
    wave: str | None = None
    wave_harmonics: int = 1

    @property
    def highest_order(self) -> int:
        """Highest multiple of the load frequency in this load, at least 1."""
        wave_order = self.wave_harmonics if self.wave is not None else 1
        return max(wave_order, *(harmonic.order for harmonic in self.harmonics), 1)


@dataclass(frozen=True)
class Excitation(Table, PeriodicLoad):
    """Point force f(t) = force_mean + force_cos cos(omega t) + force_sin sin(omega t).

    ``[[excitation.harmonics]]`` adds further orders k, cos cos(k omega t) + sin sin(k omega t).
    With an engine order n the frequency is n times ``rotation.speed``.
    """

    omega: float = positive_field(None, unit="rad/s")
    """Angular frequency; with an engine order it follows from the speed."""
    frequency: float | None = hertz_field("omega")
    """``omega`` in Hz; give either key, or an order."""
    order: int | None = positive_int_field(None)
    """Engine order: omega is the order times ``rotation.speed``."""
    point: Vector | None = vector_value_field("", unit="m")
    """Point of the force; a mesh file may have a physical point ``load`` instead."""
    force_sin: Vector = vector_value_field("f", (0.0, 0.0), unit="N")
    force_cos: Vector = vector_value_field("f", (0.0, 0.0), unit="N")
    force_mean: Vector = vector_value_field("f", (0.0, 0.0), unit="N")
    harmonics: tuple[Harmonic, ...] = harmonics_field()
    """Further harmonics of the force [N]: ``order`` with ``cos`` and ``sin``.

    Or ``order`` with ``amplitude`` and ``phase``, the lag [degrees].
    """
    wave: str | None = path_field(
        "the path of a CSV file: headings, then rows of a time and forces"
    )
    """File with one period of a force, which is added.

    Each row has a time, in any unit, and the force components [N]. Values are linear in between;
    two rows with the same time are a jump.
    """
    wave_harmonics: int = harmonic_order_field(20)
    """Number of harmonics kept from ``wave``; a remark states the neglected part."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.wave is None:
            self.forbid_keys(("wave_harmonics",), "without excitation.wave")
        if self.order is None:
            self.given("omega", "given: a finite number > 0 [rad/s], or excitation.frequency [Hz]")

    def at_speed(self, speed: float) -> Excitation:
        """Return the excitation with omega = order * speed, for a rotor speed [rad/s].

        Raises InputError if ``frequency`` or ``omega`` was given, too.
        """
        if "_inferred_keys" not in vars(self):
            self.forbid_keys(
                ("frequency", "omega"),
                f"excitation.order = {self.order}: the rotor speed sets the frequency",
            )
        return self.with_unchecked_values(omega=speed * (self.order or 0), _inferred_keys={"omega"})

    @classmethod
    def make_changes_with_twins_removed(
        cls, changes: Mapping[str, object], current_values: Mapping[str, object]
    ) -> dict[str, Any]:
        """Return changes that also set contradicting keys to None.

        Twins are removed as in all tables. A new frequency removes the engine order, and a new
        order the frequency. A table with both, for a bladed disk at rest, keeps both.
        """
        frequency_keys = ("omega", "frequency")
        changed_frequency_keys = {key for key in frequency_keys if changes.get(key) is not None}
        if current_values.get("order") is not None and any(
            current_values.get(key) is not None for key in frequency_keys
        ):
            pass  # of a bladed disk at rest, where neither makes the other
        elif changed_frequency_keys and "order" not in changes:
            changes = {"order": None, **changes}
        elif changes.get("order", current_values.get("order")) is not None:
            changes = {"omega": None, **changes}
        return super().make_changes_with_twins_removed(changes, current_values)

    @property
    def first_force_key(self) -> str:
        """First key with a nonzero force; empty without a force.

        Keys are tried in the order force_sin, force_cos, force_mean, harmonics, wave.
        """
        force_key = next((key for key in FORCE_KEYS[::-1] if any(getattr(self, key))), "")
        return force_key or next((key for key in ("harmonics", "wave") if getattr(self, key)), "")


def add_harmonics(harmonic_vectors: list[Vector], harmonics: tuple[Harmonic, ...]) -> None:
    """Add a load's harmonics to the load's Fourier vectors, in place.

    ``harmonic_vectors`` are the mean, then cosine and sine for each order from 1.
    """
    for harmonic in harmonics:
        for row_index, vector in enumerate((harmonic.cos, harmonic.sin), 2 * harmonic.order - 1):
            harmonic_vectors[row_index] = tuple(
                present_component + added_component
                for present_component, added_component in zip_longest(
                    harmonic_vectors[row_index], vector, fillvalue=0.0
                )
            )


@dataclass(frozen=True)
class Load(Table, PeriodicLoad):
    """Further load: a force at a point, or a pressure or traction on an edge.

    q(t) = mean + cos cos(omega t - phase) + sin sin(omega t - phase), at the excitation's
    frequency.

    An edge is "top", "left" or "right" of a plate, or a curve named in a mesh file. A pressure
    pushes towards the plate.
    """

    FIRST_TABLE_NAME = "loads.1"

    point: Vector | None = vector_value_field("", unit="m")
    edge: str | None = value_field(
        "'top', 'left', 'right', or a curve of the mesh file", default=None
    )
    force_sin: Vector | None = vector_value_field("f", unit="N")
    force_cos: Vector | None = vector_value_field("f", unit="N")
    force_mean: Vector | None = vector_value_field("f", unit="N")
    pressure_sin: float | None = number_field(None, unit="Pa")
    pressure_cos: float | None = number_field(None, unit="Pa")
    pressure_mean: float | None = number_field(None, unit="Pa")
    traction_sin: Vector | None = vector_value_field("t", unit="Pa")
    traction_cos: Vector | None = vector_value_field("t", unit="Pa")
    traction_mean: Vector | None = vector_value_field("t", unit="Pa")
    phase: float = number_field(0.0, unit="degrees")
    """Phase lag in cos(omega t - phase) and sin(omega t - phase)."""
    harmonics: tuple[Harmonic, ...] = harmonics_field()
    """Further harmonics, ``[[loads.harmonics]]``, as in the excitation.

    At a point they are forces; on an edge tractions or, with one number, pressures [Pa].
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        force_keys, pressure_keys, traction_keys = (
            self._component_keys(load_kind) for load_kind in LOAD_KINDS
        )
        allowed_keys, forbidden_keys = force_keys, pressure_keys + traction_keys
        if self.point is not None:
            self.forbid_keys(("edge",), "point: a load acts on an edge or at a point")
        else:
            self.given("edge", "given: 'top', 'left', 'right' or a curve of the mesh; or point")
            allowed_keys, forbidden_keys = forbidden_keys, allowed_keys
        self.forbid_keys(
            forbidden_keys,
            "edge: a force needs point"
            if self.point is None
            else "point: pressures and tractions need edge",
        )
        has_load = any(getattr(self, key) is not None for key in allowed_keys) or bool(
            self.harmonics
        )
        has_valid_harmonic_vectors = self.point is None or all(
            len(harmonic.cos) > 1 for harmonic in self.harmonics
        )
        self.require(
            has_valid_harmonic_vectors,
            "harmonics",
            "a list with forces at a point, as cos = [fx, fy]",
        )
        self.require(has_load, allowed_keys[-1], f"given, or one of {', '.join(allowed_keys[:-1])}")
        if all(getattr(self, key) is None for key in allowed_keys if not key.endswith("_mean")):
            self.forbid_keys(("phase",), "a mean load alone, which has no phase")

    @staticmethod
    def _component_keys(load_kind: str) -> tuple[str, ...]:
        """Return the keys for mean, cosine and sine of a kind of load."""
        return tuple(f"{load_kind}_{part_name}" for part_name in ("mean", "cos", "sin"))

    def harmonic_components(self, load_kind: str) -> list[Vector]:
        """Return the Fourier vectors of one kind of load, with the lag ``phase``.

        Parameters
        ----------
        load_kind : str
            "force", "traction" or "pressure".

        Returns
        -------
        list of tuple
            Mean, then cosine and sine for each order from 1: vectors [N] or [Pa], or tuples with
            one number for a pressure. Missing vectors are empty tuples.
        """
        component_values = [
            getattr(self, component_key) for component_key in self._component_keys(load_kind)
        ]
        harmonic_vectors = [
            component_value
            if isinstance(component_value, tuple)
            else ()
            if component_value is None
            else (component_value,)
            for component_value in component_values
        ]
        mean_vector, cosine_vector, sine_vector = harmonic_vectors
        phase = math.radians(self.phase)
        cos_phase, sin_phase = math.cos(phase), math.sin(phase)
        cosine_sine_pairs = list(zip_longest(cosine_vector, sine_vector, fillvalue=0.0))
        first_order_vectors = [
            tuple(cos_phase * cosine - sin_phase * sine for cosine, sine in cosine_sine_pairs),
            tuple(sin_phase * cosine + cos_phase * sine for cosine, sine in cosine_sine_pairs),
        ]
        harmonic_vectors = [
            mean_vector,
            *first_order_vectors,
            *((),) * (2 * self.highest_order - 2),
        ]
        is_pressure = load_kind == "pressure"
        add_harmonics(
            harmonic_vectors,
            tuple(
                harmonic for harmonic in self.harmonics if (len(harmonic.cos) == 1) == is_pressure
            ),
        )
        return harmonic_vectors


@dataclass(frozen=True)
class Base(Table, PeriodicLoad):
    """Clamp that moves as a whole, as on a shaker.

    The acceleration is given, at the excitation's frequency. Displacements are relative to the
    clamp. A clamp that moves by U has the acceleration -omega^2 U.
    """

    acceleration_sin: Vector | None = vector_value_field("a", unit="m/s^2")
    acceleration_cos: Vector | None = vector_value_field("a", unit="m/s^2")
    harmonics: tuple[Harmonic, ...] = harmonics_field()
    """Further harmonics of the acceleration, ``[[base.harmonics]]``, as in the excitation."""

    def __post_init__(self) -> None:
        super().__post_init__()
        accelerations = (self.acceleration_cos, self.acceleration_sin)
        has_acceleration = bool(self.harmonics) or any(
            any(acceleration) for acceleration in accelerations if acceleration
        )
        self.require(
            has_acceleration,
            "acceleration_sin",
            "given and not zero, or base.acceleration_cos or base.harmonics given",
        )

    @property
    def accelerations(self) -> list[Vector]:
        """Vectors of cosine, then sine acceleration for each order from 1 [m/s^2]."""
        first_order_vectors = (self.acceleration_cos, self.acceleration_sin)
        n_components = max(
            len(vector)
            for vector in (*first_order_vectors, *(harmonic.cos for harmonic in self.harmonics))
            if vector
        )
        zero_vector = (0.0,) * n_components
        harmonic_vectors: list[Vector] = [zero_vector] * (2 * self.highest_order + 1)
        harmonic_vectors[1:3] = [vector or zero_vector for vector in first_order_vectors]
        add_harmonics(harmonic_vectors, self.harmonics)
        return harmonic_vectors[1:]

    @property
    def dominant_unit_vector(self) -> Vector:
        """Unit vector along the coordinate axis with the largest acceleration."""
        component_sizes = np.abs(self.accelerations).max(axis=0)
        return tuple(np.eye(len(component_sizes))[int(np.argmax(component_sizes))].tolist())


@dataclass(frozen=True)
class Rotation(Table):
    """Rotation of the plate as a blade of a rotor.

    The axis lies in the plate's plane, parallel to the clamp. The radius is hub_radius + y.
    Vibration in the plane is along x, parallel to the axis, and along the radius. Coriolis forces
    are then normal to the plane. For a solid they are neglected, with a remark if they matter.

    The axis of a solid may have any direction. It goes through the point at y = -hub_radius below
    the middle of a box's clamped face, or through ``center``. With a mesh file the point is (0,
    -hub_radius, 0).
    """

    hub_radius: float | None = nonnegative_field(None, unit="m")
    """Radius at y = 0, the clamp: the axis is at y = -hub_radius."""
    axis: Vector | None = vector_value_field("a", of_solid=True)
    """Axis direction for a solid; default: x."""
    center: Vector | None = vector_value_field("", unit="m", of_solid=True)
    """Point on the axis, for a solid, instead of hub_radius."""
    speed: float = value_field(
        "a finite number >= 0 (0, or 1e-6 to 1e9)",
        lambda w: w == 0 or 1e-6 <= w <= 1e9,
        None,
        unit="rad/s",
    )
    """W, angular velocity of the rotor."""
    rpm: float | None = twin_field(
        "speed",
        RAD_PER_S_PER_RPM,
        "a finite number >= 0 (0, or 1e-5 to 9e9)",
        lambda w: w == 0 or 1e-5 <= w <= 9e9,
        "rpm",
    )
    """``speed`` in revolutions per minute; give one of the two."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.given("speed", "given: a finite number >= 0 [rad/s], or rotation.rpm")
        if self.center is not None:
            self.forbid_keys(("hub_radius",), "rotation.center, which places the axis")
        self.require(self.axis is None or any(self.axis), "axis", "a vector that is not zero")

    def check_axis_position(self, disk: Disk | None) -> None:
        """Raise InputError unless the rotor axis is defined exactly once.

        A bladed disk defines the axis itself; otherwise ``center`` or ``hub_radius`` is required.
        """
        if disk is not None:
            self.forbid_keys(("hub_radius", "axis", "center"), "[disk], which defines the axis")
        elif self.center is None:
            self.given("hub_radius", "given: a finite number >= 0 [m]")

    def locate_axis(self, box_center: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return a point on the rotor axis [m] and the axis's unit vector: (3,) each.

        The point is ``center``; with ``hub_radius`` it has y = -hub_radius, and x and z of
        ``box_center`` (3,) [m]. For shapes other than a box, ``box_center`` is zero.
        """
        direction = np.array(self.axis or (1.0, 0.0, 0.0))
        axis_point = box_center[0], -(self.hub_radius or 0.0), box_center[2]
        return np.array(self.center or axis_point), direction / np.linalg.norm(direction)


@dataclass(frozen=True)
class Disk(Table):
    """Bladed disk: copies of a meshed sector; some blades are cracked.

    Sector j + 1 follows sector j in the direction from the side ``left`` of a sector to the side
    ``right``. The rotor turns in this direction. The load acts on each blade, in the blade's
    directions. With an engine order E the load on blade j leads the load on blade 1 by 2 pi E (j -
    1) / sectors.

    A plate or a solid made here is a blade on a rim. At the radius ``outer_radius`` the blade has y
    = 0, in the middle of the plate's width or the solid's thickness. The rim is clamped at
    ``inner_radius``. The rim of a solid is as thick, along x and the axis, as the blade is wide. A
    mesh file of one sector names the sides ``left`` and ``right``, whose nodes match.
    """

    sectors: int = value_field("a whole number from 3 to 1000", lambda count: 3 <= count <= 1000)
    cracked: tuple[int, ...] = value_field(
        "the number of a sector, from 1, or a list of different numbers",
        lambda numbers: min(numbers, default=1) >= 1,
        (1,),
    )
    """Sectors with a crack; in other sectors the crack faces are bonded."""
    mistuning: tuple[float, ...] | None = value_field(
        "a list of numbers above -0.5 and below 1, one for each sector",
        lambda deviations: all(-0.5 < deviation < 1.0 for deviation in deviations),
        None,
    )
    """Relative deviation of each sector's stiffness at rest."""
    deviation: float = bounded_field("0", "0.1", 0.0)
    """Standard deviation of a random mistuning pattern, instead of ``mistuning``.

    The sectors' relative stiffness deviations are then independent normal numbers.
    """
    seed: int = value_field("a whole number >= 0", lambda value: value >= 0, 0)
    """Seed of the random pattern, for NumPy's default generator."""
    families: int = positive_int_field(3)
    """Number of lowest modes kept for each nodal diameter; the load's band must be among them.

    Four more modes for each nodal diameter, and static solutions, serve to assess the neglected
    modes.
    """
    modes: int = value_field("a whole number >= 0", lambda count: count >= 0, 0)
    """Number of further modes of the wheel: the modes that open the cracks most."""
    inner_radius: float | None = positive_field(None, unit="m")
    """Radius at which the rim is clamped."""
    outer_radius: float | None = positive_field(None, unit="m")
    """Outer radius of the rim."""
    center: Vector | None = vector_value_field("", unit="m")
    """With a mesh file: point on the axis; default: the origin."""
    axis: Vector | None = vector_value_field("a", of_solid=True)
    """With a mesh file of a solid: axis direction; default: x."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require(max(self.cracked, default=1) <= self.sectors, "cracked",
                     f"sector numbers from 1 to disk.sectors = {self.sectors}")  # fmt: skip
        if self.mistuning is not None:
            requirement_text = f"one number for each of the {self.sectors} sectors"
            self.require(len(self.mistuning) == self.sectors, "mistuning", requirement_text)
            self.forbid_keys(("deviation", "seed"), "disk.mistuning")
        self.require(self.axis is None or any(self.axis), "axis", "a vector that is not zero")

    @property
    def deviations(self) -> np.ndarray:
        """Relative stiffness deviation of each sector: (sectors,).

        From ``mistuning`` if given, otherwise random with ``deviation`` and ``seed``.
        """
        if self.mistuning is not None:
            return np.array(self.mistuning)
        return np.random.default_rng(self.seed).normal(0.0, self.deviation, self.sectors)


@dataclass(frozen=True)
class Contact(Table):
    """Settings for contact between the crack faces, at pairs of opposite nodes."""

    stiffness: float | None = positive_field(None, unit="N/m")
    """Penalty stiffness k of one pair; or give the stiffness per area."""
    stiffness_per_area: float | None = positive_field(None, unit="N/m^3")
    """Penalty stiffness per area of crack face: independent of the mesh."""
    law: str = choice_field("penalty", "smoothed", "unilateral", default="penalty")
    """Contact law of a pair: "penalty", a spring in contact; "unilateral", no penetration.

    "smoothed": a penalty law without a corner, which has a force at every gap.
    """
    sharpness: float | None = positive_field(None, unit="1/m")
    """s in the smoothed law lambda = k g (1/2 + arctan(s g) / pi)."""
    layer_depth: float | None = positive_field(None, unit="m")
    """Depth p of a soft layer on the crack faces, in the law "penalty".

    The contact force is lambda = a k max(0, g) + (1 - a) k max(0, g - p), with the total stiffness
    k and the share a = ``layer_share``. Left out: no layer.
    """
    layer_share: float | None = value_field(
        "a number between 0 and 1", lambda share: 0.0 < share < 1.0, None
    )
    """Share a of the stiffness that acts from the first contact on; the rest beyond the depth p."""
    friction: float | None = nonnegative_field(None)
    """Coefficient of Coulomb friction between crack faces, static and kinetic.

    Left out: no friction; the error report then states the effect that friction would have.
    """
    friction_error: float | bool = value_field(
        "a finite number > 0, or false", lambda mu: mu is False or mu > 0, 0.3
    )
    """Friction coefficient for which the error of neglecting friction is computed.

    It counts only if ``contact.friction`` is left out; false: this error is not computed.
    """
    tangential_stiffness_per_area: float | None = positive_field(None, unit="N/m^3")
    """Tangential stiffness of sticking pairs, per area of crack face.

    Left out: sticking pairs do not move, which requires crack faces without mass
    (``reduction.method = "massless"``).
    """
    pairs: str = choice_field("all", "mouth", default="all")
    """"all": every pair of crack-face nodes, or mesh.patches pairs.

    "mouth": for each crack only the pair at the mouth, or in the middle of an internal crack.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        law_text = f"contact.law = {self.law!r}"
        if self.law == "unilateral":
            self.forbid_keys(("stiffness", "stiffness_per_area"), law_text)
        else:
            has_one_stiffness = (self.stiffness is None) != (self.stiffness_per_area is None)
            self.require(
                has_one_stiffness,
                "stiffness",
                f"given, or contact.stiffness_per_area, but not both, with {law_text}",
            )
        if self.law == "smoothed":
            self.given("sharpness", "given: a finite number > 0 [1/m], for the smoothed law")
        else:
            self.forbid_keys(("sharpness",), law_text)
        if self.law != "penalty":
            self.forbid_keys(("layer_depth", "layer_share"), law_text)
        elif self.layer_depth is not None or self.layer_share is not None:
            self.given("layer_depth", "given: a finite number > 0 [m], with contact.layer_share")
            self.given("layer_share", "given: a number between 0 and 1, with contact.layer_depth")
            self.require(not self.friction, "friction", "0, or left out, with contact.layer_depth")
        if not self.friction:
            self.forbid_keys(("tangential_stiffness_per_area",), "without contact.friction > 0")
        elif not self.is_unilateral:
            self.require(False, "friction", f"0, or left out, with {law_text}")

    @property
    def is_unilateral(self) -> bool:
        """True for the laws "penalty" and "unilateral": a pair is either open or closed.

        With the law "smoothed", a pair has a contact force at every gap.
        """
        return self.law in ("penalty", "unilateral")


@dataclass(frozen=True)
class HarmonicBalance(Table):
    """Settings for harmonic balance: harmonics, contact sampling and tolerance."""

    harmonics: int = positive_int_field(None)
    """Number of harmonics H; with a tolerance, the minimum. Default: 5."""
    samples: int | None = positive_int_field(None)
    """Instants per period for evaluating contact; default: chosen by the solver."""
    tolerance: float | None = positive_field(None)
    """Relative error of the solution that truncated harmonics and modes may cause.

    Harmonics and modes are added until the error against the exact orbit is below this tolerance.
    A curve then consists of exact orbits. Default: 0.01, but no tolerance if ``harmonics`` or
    ``samples`` is given, or ``error`` is false.
    """
    form: str = choice_field("condensed", "block", default="condensed")
    """Unknowns for ``solve``: "condensed", the gaps; "block", all displacements.

    "block" uses PETSc's SNES, takes longer and has no tolerance. Nothing else changes.
    """
    error: bool = value_field("true or false", default=True)
    """false: neither error nor stability is computed.

    With many pairs or modes, error and stability take longer than the solution.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        default_by_key = {"harmonics": 5, "tolerance": DEFAULT_ERROR_TOLERANCE}
        if self.harmonics is not None or self.samples is not None or not self.error:
            del default_by_key["tolerance"]
        if self.form == "block":
            self.forbid_keys(("tolerance",), "harmonic_balance.form = 'block'")
            default_by_key.pop("tolerance", None)
        inferred_keys = {key for key in default_by_key if getattr(self, key) is None}
        vars(self).update(
            {key: default_by_key[key] for key in inferred_keys}, _inferred_keys=inferred_keys
        )
        if self.tolerance is not None:
            self.forbid_keys(("samples",), "harmonic_balance.tolerance")
            self.require(self.error, "error", "true, or left out, with harmonic_balance.tolerance")
        min_samples = 4 * self.harmonics + 1
        has_allowed_samples = (
            self.samples is None or min_samples <= self.samples <= MAX_SAMPLES_PER_PERIOD
        )
        requirement_text = (
            f"a whole number from {min_samples} (4 times harmonics + 1) to "
            f"{MAX_SAMPLES_PER_PERIOD}, or left out"
        )
        self.require(has_allowed_samples, "samples", requirement_text)

    def with_load_harmonics(self, highest_order: int) -> HarmonicBalance:
        """Return the table with at least ``highest_order`` harmonics.

        ``highest_order`` is the highest harmonic of any load. Raises InputError if a given number
        of harmonics is smaller; only the default number is increased.
        """
        requirement_text = f"a whole number >= {highest_order}, the highest order of the load"
        has_enough_harmonics = self.harmonics >= highest_order
        self.require(
            has_enough_harmonics or "harmonics" in self.derived_keys, "harmonics", requirement_text
        )
        return self if has_enough_harmonics else self.with_unchecked_values(harmonics=highest_order)


@dataclass(frozen=True)
class Mesh(Table):
    """Settings for the mesh of the plate or solid.

    ``layout = "grid"``: columns x rows equal quadrilaterals, or twice as many triangles. The crack
    must run along grid lines.

    ``"graded"``: element size ``size`` away from the crack and ``lip_elements`` along each face.
    The element at the tip is ``grading`` times shorter than at the mouth. In an internal crack half
    of the elements are on each side of the middle. With cracks above one another, faces may get
    more elements. A disk's sector has triangles, graded also towards the corners between blade and
    rim.

    ``"file"``: any gmsh mesh of a plane region. The physical groups are named ``clamp``,
    ``lower_lip`` and ``upper_lip`` or ``crack`` (curves), ``load`` (a point) and anything for the
    region.

    A solid has tetrahedra of order 2, ``"graded"`` towards the crack fronts. A file names surfaces,
    ``clamp`` and ``crack``.
    """

    layout: str = choice_field("grid", "graded", "file")
    """Layout: "grid", equal cells; "graded", finer at cracks; "file", a mesh file."""
    cells: str = choice_field("triangle", "quadrilateral", default="quadrilateral")
    """Cells in a plate; a mesh file and a graded sector have their own."""
    order: int = value_field("1 or 2", lambda value: value in (1, 2), default=None)
    """Polynomial order of the displacement; default: 1 in a plate, 2 in a solid."""
    columns: int | None = positive_int_field(None)
    """Columns of a grid."""
    rows: int | None = positive_int_field(None)
    """Rows of a grid."""
    size: float | None = positive_field(None, unit="m")
    lip_elements: int | None = positive_int_field(None)
    """Elements of a graded mesh along each crack face."""
    grading: float = bounded_field("1", "1e+06", 4.0)
    """Ratio of element sizes along a crack face in a graded mesh, mouth over tip."""
    file: str | None = path_field("the path of a .msh file")
    """Mesh file, relative to the scene's folder, or with a full path."""
    coarser: str | None = path_field("the path of a .msh file")
    """Mesh file with the same part and fewer elements, for estimating the mesh error."""
    per_turn: int = value_field("a whole number from 4 to 200", lambda count: 4 <= count <= 200, 12)
    """Number of elements on a full turn around a curved face of a CAD part."""
    patches: int | None = positive_int_field(None)
    """Maximum number of contact pairs in each crack.

    Pairs are means over several nodes, if the mesh is finer than contact needs. Default: all nodes;
    in a solid all corners of elements.
    """
    error: bool = value_field("true or false", default=True)
    """true: a coarser mesh gives the mesh error of each number."""

    def __post_init__(self) -> None:
        super().__post_init__()
        keys_by_layout = {
            "grid": ("columns", "rows"),
            "graded": ("size", "lip_elements", "grading", "per_turn"),
            "file": ("file", "coarser"),
        }
        layout_keys = keys_by_layout.pop(self.layout)
        for other_keys in keys_by_layout.values():
            self.forbid_keys(other_keys, f"mesh.layout = {self.layout!r}")
        for key in layout_keys:
            if key not in ("lip_elements", "coarser"):  # an uncracked plate has no crack faces
                allowed_text = self.field_by_key()[key].metadata["allowed"]
                self.given(key, f"given: {allowed_text}, with layout = {self.layout!r}")
        if self.layout == "file":
            self.forbid_keys(("cells",), "mesh.layout = 'file': the mesh file has the cells")

    def with_dimension(self, dimension: int) -> Mesh:
        """Return the table with an order for 2 or 3 dimensions.

        A given order stays; the default is 1 in a plane and 2 in space.
        """
        polynomial_order = self.order or dimension - 1
        return self.with_unchecked_values(
            order=polynomial_order, _inferred_keys={"order"} if polynomial_order == 1 else set()
        )


@dataclass(frozen=True)
class Structure(Table):
    """Matrices in files beside the scene, instead of a plate.

    M u'' + C u' + K u + B lambda(g) = f(t), g = B^T u - g0. The tables [geometry], [material],
    [mesh], [crack] and [base] are then left out. Files have the formats of Matrix Market, CalculiX
    (.sti, .mas), Abaqus (.mtx) or Nastran (.pch, .op4); columns are in Matrix Market files. With
    the matrices' model, the load may act at excitation.point. The model's contact pairs are found
    if there is contact without a file for the gaps.
    """

    mass: str = path_field("the path of a file with an (n, n) matrix", MISSING)
    """M, the mass matrix [kg]."""
    stiffness: str = path_field("the path of a file with an (n, n) matrix", MISSING)
    """K, the stiffness matrix [N/m]."""
    model: str | None = path_field(
        "the path of the input file of the program that made the matrices"
    )
    """Model file with nodes and elements, from the program that made the matrices.

    CalculiX or Abaqus (.inp), Nastran (.bdf, .dat, .nas), Ansys (.cdb), or a table with node, x, y,
    z [m], separated by commas.
    """
    dofs: str | None = path_field("the path of a file with node and direction of each row")
    """File with the node and direction of each matrix row, for Matrix Market files with a model.

    A line is "12.3", node 12 and direction 3, or "7 12 UZ", row 7. Default for CalculiX: the .dof
    file beside the stiffness.
    """
    gap: str | None = path_field("the path of a file with an (n, n_pairs) matrix")
    """B, which gives the gaps of contact pairs from displacements.

    Left out: no gaps, or those of the model.
    """
    tangential: str | None = path_field("the path of a file with an (n, n_pairs) matrix")
    """B_t for the tangential gaps, for friction."""
    damping: str | None = path_field("the path of a file with an (n, n) matrix")
    """C, the damping matrix [N s/m]; or give the table [damping]."""
    force_sin: str | None = path_field("the path of a Matrix Market file with n rows")
    """Sine parts of the load [N]: column k acts at k times the load frequency.

    With a model, a point force in [excitation] may act instead.
    """
    force_cos: str | None = path_field("the path of a Matrix Market file with n rows")
    force_mean: str | None = path_field("the path of a Matrix Market file with n rows and a column")
    clearance: float | str = path_field(
        f"a finite number {ZERO_OR_MAGNITUDE_TEXT}, "
        "or the path of a Matrix Market file with n_pairs rows",
        0.0,
        "m",
    )
    """Clearance g0 of all contact pairs, or a file with a value for each; < 0: preload."""
    areas: str | None = path_field("the path of a Matrix Market file with n_pairs rows")
    """Area of each contact pair [m^2], for stiffnesses per area; computed for a model's pairs."""

    def __post_init__(self) -> None:
        super().__post_init__()
        has_load = any((self.force_sin, self.force_cos, self.force_mean, self.model))
        self.require(
            has_load,
            "force_sin",
            "given, or structure.force_cos, structure.force_mean or structure.model",
        )


@dataclass(frozen=True)
class Reduction(Table):
    """Reduction of the structure before the solution (``reduce_structure``).

    Without this table a structure with up to 100 dofs is not reduced, and a larger one is reduced
    with the default basis. ``reduction = "off"`` is short for ``reduction.method = "off"``.
    """

    SHORTHAND_KEY = "method"

    method: str | None = choice_field("massless", "free_interface", "off", default=None)
    """Default with contact: "massless", modes and crack faces without mass.

    Default without contact, or if all modes are kept: "free_interface".
    """
    modes: int | None = positive_int_field(None)
    """Number of lowest modes. Default with a tolerance: few modes that meet it.

    Default otherwise: the damped modes, or 50 if all are damped.
    """


@dataclass(frozen=True)
class Curve(Table):
    """Settings for a response curve, followed through folds by continuation."""

    start: float = number_field()
    """First value of the parameter, in the units of ``stop``."""
    stop: float = number_field()
    """Last value of the parameter.

    Units are rad/s for the load frequency, or Hz with "frequency". Load, stiffness, damping and
    friction are factors, clearances are added [m]. With an engine order: rotor speed [rad/s], or
    "rpm".
    """
    parameter: str = choice_field(
        "omega", "frequency", "load", "stiffness", "damping", "clearance", "friction", "speed",
        "rpm", default="omega",
    )  # fmt: skip
    """Parameter that changes along the curve."""
    at: str | None = choice_field("resonance", default=None)
    """With ``parameter = "load"``: follow the resonance while the load grows.

    The curve is the backbone of a forced and damped vibration, from the resonance near the load
    frequency. The load factor leaves the mean load unchanged. In a bladed disk the watched blade is
    at resonance.
    """
    stability: bool = value_field("true or false", default=True)
    """Compute Floquet multipliers and period doublings along the curve."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require(
            self.start != self.stop, "stop", f"different from curve.start = {self.start:g}"
        )
        if self.at is not None:
            self.require(self.parameter == "load", "at", "left out unless curve.parameter = 'load'")
        names_of_positive_parameters = "omega", "frequency", "stiffness", "friction", "speed", "rpm"
        if self.parameter in names_of_positive_parameters or self.at is not None:
            # Rounding would take a smaller end to 0.
            lower_bound = max(1e-12 * max(self.start, self.stop), 0.0)
            for end_key in ("start", "stop"):
                requirement_text = f"a number > 0 with curve.parameter = {self.parameter!r}"
                requirement_text += ", and above 1e-12 of the other end" * (
                    getattr(self, end_key) > 0.0
                )
                self.require(getattr(self, end_key) > lower_bound, end_key, requirement_text)

    @property
    def parameter_and_range(self) -> tuple[str, float, float]:
        """Parameter's name in the equations, and start and stop of its range.

        "frequency" becomes "omega", and "rpm" becomes "speed", both in rad/s. With
        ``at = "resonance"`` the name is "resonance", and the range is that of the load factor.
        """
        if self.parameter == "rpm":
            return "speed", RAD_PER_S_PER_RPM * self.start, RAD_PER_S_PER_RPM * self.stop
        if self.parameter == "frequency":
            return "omega", RAD_PER_TURN * self.start, RAD_PER_TURN * self.stop
        return self.at or self.parameter, self.start, self.stop


@dataclass(frozen=True)
class Integration(Table):
    """Settings for direct integration in time, under the load or as a free decay.

    Integration starts at rest, at the end of an earlier motion, or at a static deflection.
    """

    method: str | None = choice_field("exponential", "central_difference", "events", default=None)
    """Method: "exponential" or "central_difference" with time steps, or "events".

    "events" is exact from one switching instant to the next. Default: "exponential" for crack faces
    without mass, otherwise "central_difference".
    """
    periods: int = positive_int_field(600)
    """Maximum number of load periods to integrate."""
    settle: float = positive_field(1e-4)
    """Relative change from one period to the next at which integration stops.

    The change is that of the gaps and of the displacement at the load, relative to the motion.
    Results state the remaining distance from the settled motion. This distance matters most for
    the mean and the higher harmonics, mostly below a thousandth of the first harmonic.
    """
    steps_per_period: int | None = positive_int_field(None)
    """Number of time steps, or of stored instants, in a load period.

    Default: 512 for "exponential", 256 for "events". For "central_difference" 512, or twice the
    smallest stable number if larger.
    """
    initial: str | None = path_field("the path of the .h5 file of a solution or an integration")
    """File with a solution or an integration on the same mesh, as the start.

    From a solution come displacement and velocity at phase 0 of the load, from an integration the
    final displacement and velocity. The scene's load acts.
    """
    deflection: float | None = positive_field(None)
    """Start at rest from the static deflection, with contact.

    The static load is the mean plus the sum of cosine and sine parts times this factor.
    """
    free: bool = value_field("true or false", default=False)
    """Free decay: only the mean load acts. All periods are recorded."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.initial is not None:
            self.forbid_keys(("deflection",), "integration.initial")


@dataclass(frozen=True)
class Sweep(Table):
    """Settings for a sweep: all combinations of values for some keys of the scene.

    For example::

        [sweep.over]
        "excitation.omega" = { start = 1000.0, stop = 4000.0, count = 61 }
        "crack.length" = [0.02, 0.03, 0.04]
    """

    over: tuple[Axis, ...] = value_field(
        "a table with keys of the scene and lists of values, 'crack.length' = [0.02, 0.03]",
        lambda value: value,
    )
    """Keys with lists of values, or start, stop, count and ``spacing = "logarithmic"``."""
    at_resonance: bool = value_field("true or false", default=False)
    """Solve each case at the resonance nearest to the excitation's frequency."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values on each axis."""
        return tuple(len(axis.values) for axis in self.over)

    @property
    def n_cases(self) -> int:
        """Number of cases."""
        return math.prod(self.shape)


@dataclass(frozen=True)
class Growth(Table):
    """Settings for crack growth by fatigue, for the command ``fenics-crack grow``.

    Growth in a cycle of the load is

        rate sum_i (delta_K_i / ((1 - R_i)^(1 - ratio_exponent) 1 MPa m^0.5))^exponent

    over the K_I cycles in the load cycle. The ranges delta_K_i count K_I > 0 only, an open tip, and
    R = max(K_min, 0) / K_max (Paris and Erdogan 1963; Walker 1970).
    """

    until: float = positive_field(unit="m")
    """Length at which growth ends, from ``crack.length`` on.

    For a half-ellipse the depth, from ``crack.depth`` on.
    """
    rate: float = positive_field(unit="m")
    """Growth in a load cycle with one K_I range delta_K = 1 MPa m^0.5 and R = 0."""
    exponent: float = bounded_field("0.1", "50", MISSING)
    """Exponent of the growth law."""
    ratio_exponent: float = bounded_field("0", "1", 1.0)
    """Walker's exponent gamma for the influence of R; 1: no influence except by closure."""
    threshold: float = nonnegative_field(0.0, unit="Pa m^0.5")
    """Effective range of K_I, delta_K / (1 - R)^(1 - gamma), below which the crack stops."""
    toughness: float | None = positive_field(None, unit="Pa m^0.5")
    """Fracture toughness: K_max at which the structure breaks; left out: no limit."""
    drive: str = choice_field("frequency", "resonance", "spectrum", default="frequency")
    """"frequency": the load keeps the excitation's frequency.

    "resonance": the load follows the largest response. "spectrum": the load passes through the
    ``frequencies`` again and again.
    """
    frequencies: tuple[float, ...] | None = value_field(
        "a list of different numbers > 0",
        lambda frequencies: (
            len(set(frequencies)) == len(frequencies) > 0 and min(frequencies) > 0.0
        ),
        None,
        unit="Hz",
    )
    """Load frequencies of the spectrum [Hz], with ``drive = "spectrum"``."""
    cycles: tuple[float, ...] | None = value_field(
        "a list of numbers > 0", lambda cycles: len(cycles) > 0 and min(cycles) > 0.0, None
    )
    """Number of load cycles at each frequency, in one repeat of the spectrum."""
    rate_deviation: float = bounded_field("0", "10", 0.0)
    """Relative standard deviation of ``rate``, for the scatter of the life."""
    exponent_deviation: float = bounded_field("0", "10", 0.0)
    """Standard deviation of ``exponent``; the rate at 1 MPa m^0.5 stays the same."""
    life_tolerance: float = bounded_field("1e-6", "1", 0.01)
    """Relative error of the life that interpolation between solved crack lengths may cause."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.drive != "spectrum":
            self.forbid_keys(("frequencies", "cycles"), f"growth.drive = {self.drive!r}")
            return
        for spectrum_key in ("frequencies", "cycles"):
            allowed_text = self.field_by_key()[spectrum_key].metadata["allowed"]
            self.given(spectrum_key, f"given: {allowed_text}, with drive = 'spectrum'")
        has_equal_lengths = len(self.cycles or ()) == len(self.frequencies or ())
        self.require(
            has_equal_lengths,
            "cycles",
            f"as many numbers as growth.frequencies, {len(self.frequencies or ())}",
        )

    @property
    def repeat_cycles_and_duration(self) -> tuple[float, float] | None:
        """Number of load cycles and duration [s] for one repeat of the spectrum.

        None without ``cycles`` or ``frequencies``, which only ``drive = "spectrum"`` has.
        """
        if self.cycles is None or self.frequencies is None:
            return None
        repeat_duration = sum(
            n_cycles / frequency
            for n_cycles, frequency in zip(self.cycles, self.frequencies, strict=True)
        )
        return sum(self.cycles), repeat_duration


@dataclass(frozen=True)
class Identify(Table):
    """Settings for identification: unknowns, their ranges, and uncertainties of the model.

    The keys ``..._deviation`` are standard deviations of what the model does not know.

    For example::

        [identify.unknown]
        "crack.length" = { start = 0.003, stop = 0.045, count = 8 }
        "crack.height" = { start = 0.02, stop = 0.2, count = 10 }

    or, with meshes of the user::

        [identify.meshes]
        "blade_05.msh" = { "crack.length" = 0.005 }
        "blade_10.msh" = { "crack.length" = 0.010 }
        "blade_15.msh" = { "crack.length" = 0.015 }
        "blade_20.msh" = { "crack.length" = 0.020 }
    """

    unknown: tuple[Axis, ...] = value_field(
        "a table with keys of the scene and the values between which these are sought", default=()
    )
    """Unknown keys, each with at least 4 ascending numbers at which the model is solved.

    Instead of numbers: start, stop, count and ``spacing = "logarithmic"``, or words,
    ``"crack.edge" = ["left", "right"]``. May be left out with ``meshes``.
    """
    meshes: tuple[MeshFile, ...] = value_field(
        'a table of .msh files and their numbers, "blade_05.msh" = { "crack.length" = 0.005 }',
        default=(),
    )
    """Meshes of the cracked structure, with the unknowns of each, for ``mesh.layout = "file"``.

    The names are keys of the crack, or free names for other unknowns. Each name has at least 4
    values, and every combination of values has a mesh.
    """
    uncracked: str | None = path_field("the path of a .msh file")
    """Mesh of the same structure without the crack, if meshes are read from files."""
    frequencies: tuple[float, ...] = value_field(
        "a list of finite numbers > 0", lambda values: min(values, default=1.0) > 0, ()
    )
    """Load frequencies [Hz], besides the excitation's, for which measurements are planned."""
    finer: float = bounded_field("0.25", "4", 0.5)
    """Ratio of element lengths between the few fine cases and all other cases.

    Fine cases correct the model and give its error; 1: no fine cases. Below 1, fine cases have the
    scene's mesh and harmonics, and other cases coarser ones: 0.5 doubles the element length.
    """
    harmonic_deviation: float = bounded_field("0", "1", 0.05)
    """Minimum relative standard deviation of the computed second harmonic due to the crack.

    For the k-th harmonic it is k - 1 times as large. The cause is contact on a coarse mesh, which
    changes harmonics separately and all together.
    """
    young_deviation: float = bounded_field("0", "1", 0.03)
    """Relative standard deviation of Young's modulus.

    Structural steel: JCSS, Probabilistic Model Code, part 3.2, 2001.
    """
    density_deviation: float = bounded_field("0", "1", 0.01)
    """Relative standard deviation of the density (JCSS, Probabilistic Model Code, part 2.1)."""
    thickness_deviation: float = bounded_field("0", "1", 0.01)
    """Relative standard deviation of the thickness, which changes amplitudes.

    Tolerances are at most 0.2 mm in 10 mm (ISO 2768-1, medium).
    """
    clamp_deviation: float = bounded_field("0", "1", 0.01)
    """Standard deviation of the relative decrease of the first frequency by a soft clamp.

    A beam on an elastic body of the same thickness acts as if longer by 0.44 times the depth (W. J.
    O'Donnell, Journal of Applied Mechanics 27, 1960, 461). At a length of 15 depths the frequency
    is 6 % lower; jaws are several times stiffer.
    """
    before_deviation: float = bounded_field("0", "1", 0.002)
    """Standard deviation of the clamp's change between measurements without and with the crack.

    It is relative to the first natural frequency. A clamp that was opened holds differently; on a
    rotor the blade's seat or the measured speed changes. Temperatures have separate keys.
    """
    before_scatter: float = bounded_field("0", "1", 0.2)
    """Part of the clamp's change (``before_deviation``) that each mode has by itself.

    Evidence: in plates clamped deeper, partly released or on an elastic block, a turning clamp, a
    moving clamp and a common change explain all but this part of the largest change. The part is up
    to 0.05 for plates 15 times as tall as wide, 0.07 for five times, 0.12 for three, 0.18 for two
    and 0.29 for squares (benchmarks/identification_limits.py in commit 981867df).
    """
    temperature_deviation: float | None = value_field(
        "a number from 0 to 1000", lambda value: 0.0 <= value <= 1000.0, None, unit="K"
    )
    """Standard deviation of the temperature difference since the measurement without a crack.

    It counts if measurements do not state temperatures; 0: equal temperatures. Default at rest:
    10 K, which takes 0.2 % from all natural frequencies. Default for a rotor: 25 K, since gas or
    drag warms blades (engineering judgement).
    """
    temperature_coefficient: float = bounded_field("-0.01", "0.01", -4e-4, unit="1/K")
    """Relative change of Young's modulus per kelvin.

    Steel -2.6e-4 to -3e-4, aluminium and titanium -5e-4 to -6e-4 at room temperature; more if hot.
    """
    coefficient_deviation: float = bounded_field("0", "1", 0.3)
    """Relative standard deviation of ``temperature_coefficient``.

    It counts if measurements state temperatures; 0.1 for a metal with a known coefficient.
    """
    thermometer_deviation: float = bounded_field("0", "100", 1.0, unit="K")
    """Standard deviation of a stated temperature difference between the measurements.

    For a thermocouple of class 1 (IEC 60584-1: 1.5 K) at the blade or its root.
    """
    damping_deviation: float = bounded_field("0", "10", 0.3)
    """Relative standard deviation of the damping ratio.

    Joints and air change damping so much between assemblies.
    """
    stiffening_deviation: float = bounded_field("0", "1", 0.05)
    """Relative standard deviation of the part of omega^2 that rotation adds.

    Beam and plate models differ by so much.
    """
    angle_deviation: float = bounded_field("0", "45", 5.0, unit="degrees")
    """Standard deviation of the angle between crack and horizontal.

    The angle moves the tip away from the height of the mouth.
    """
    model_deviation: float = bounded_field("0", "1", 0.01)
    """Relative standard deviation of each natural frequency, equal with and without the crack.

    Spacecraft models shall meet measured frequencies to 5 % (NASA-STD-5002). The ratio of the first
    two frequencies of a plain beam is 2 % off (docs/notebook/measured_beams.md).
    """
    first_resonance_deviation: float = bounded_field("0", "1", 0.04)
    """Standard deviation of the first resonance around the bilinear frequency.

    The crack breathes. The deviation is relative to the difference between bonded and open natural
    frequency (docs/identification.md).
    """
    resonance_deviation: float = bounded_field("0", "1", 0.3)
    """Standard deviation of higher resonances around the bilinear frequency.

    It is relative as ``first_resonance_deviation``. Neighbouring modes also open and close the
    crack, which may be open for any part of the period: 12^-1/2 for a uniform distribution.
    """
    crack_deviation: float = bounded_field("0", "1", 0.15)
    """Relative standard deviation of a crack's computed effect on natural frequencies.

    Two common compliances for one crack, from 0.1 to 0.3 of the depth, differ by 25 to 29 %; half
    is taken (W. M. Ostachowicz and M. Krawczuk, Journal of Sound and Vibration 150, 1991, 191; P.
    F. Rizos, N. Aspragathos and A. D. Dimarogonas, 138, 1990, 381). A slot changes more than a
    crack (P. Cawley and R. Ray, Journal of Vibration and Acoustics 110, 1988, 366).
    """
    crack_correlation: float = bounded_field("0", "1", 0.9)
    """Correlation between modes of the errors with ``crack_deviation``.

    1: the crack's compliance has one error, common to all modes.
    """
    confidence: float = bounded_field("0.5", "0.9999", 0.95)
    """Probability that reported regions and intervals contain the true values.

    A hypothesis explains the measurements if the p-value of chi^2 is at least 1 - ``confidence``.
    """
    log_bayes_factor: float = bounded_field("0", "1000", 3.0)
    """Natural logarithm of the evidence ratio above which a hypothesis is preferred.

    3 is a ratio of 20 to 1.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.unknown and not self.meshes:
            requirement_text = f"given: {self.field_by_key()['unknown'].metadata['allowed']}"
            raise InputError("identify.unknown", None, requirement_text)
        self._check_meshes()
        for axis in self.unknown:
            word_flags = [isinstance(value, str) for value in axis.values]
            has_enough_numbers = (
                not any(word_flags) and len(axis.values) >= MIN_ALLOWED_VALUES_PER_UNKNOWN
            )
            if not (all(word_flags) or (has_enough_numbers and np.all(np.diff(axis.values) > 0))):
                requirement_text = (
                    f"words, or {MIN_ALLOWED_VALUES_PER_UNKNOWN} or more numbers in ascending order"
                )
                raise InputError(f'identify.unknown."{axis.key}"', axis.values, requirement_text)

    def _check_meshes(self) -> None:
        """Raise InputError if ``meshes`` is not a full grid of parameter values.

        All meshes have the same parameters, each with 4 or more values; every combination of values
        has exactly one mesh.
        """
        length_keys = [
            crack_key
            for crack_key, key_field in Crack.field_by_key().items()
            if key_field.metadata["unit"] == "m"
        ]
        allowed_names = {*map(Crack.full_key, length_keys)} - {axis.key for axis in self.unknown}
        for mesh_file in self.meshes:
            error_key = f'identify.meshes."{mesh_file.key}"'
            parameter_names = [parameter_name for parameter_name, _ in mesh_file.values]
            if not parameter_names or set(parameter_names) != {
                parameter_name for parameter_name, _ in self.meshes[0].values
            }:
                raise InputError(
                    error_key, parameter_names, "one or more names, the same for all meshes"
                )
            for parameter_name in parameter_names:
                if not (parameter_name in allowed_names or parameter_name.isidentifier()):
                    requirement_text = (
                        f"a single word, or one of {', '.join(sorted(allowed_names))}"
                    )
                    raise InputError(error_key, parameter_name, requirement_text)
        axes = self.mesh_axes
        for axis in axes:
            if len(axis.values) < MIN_ALLOWED_VALUES_PER_UNKNOWN:
                requirement_text = f"at least {MIN_ALLOWED_VALUES_PER_UNKNOWN} different values"
                raise InputError(f"identify.meshes, {axis.key}", axis.values, requirement_text)
        n_meshes_by_values = Counter(
            tuple(dict(mesh_file.values)[axis.key] for axis in axes) for mesh_file in self.meshes
        )
        value_combinations = itertools.product(*(axis.values for axis in axes))
        for value_combination in value_combinations if n_meshes_by_values else ():
            if (n_meshes := n_meshes_by_values[value_combination]) != 1:
                axes_and_values = zip(axes, value_combination, strict=True)
                combination_text = ", ".join(
                    f"{axis.key} = {parameter_value:g}" for axis, parameter_value in axes_and_values
                )
                requirement_text = "a table with one mesh file for every combination of the numbers"
                raise InputError(
                    "identify.meshes",
                    f"{n_meshes or 'no'} files of {combination_text}",
                    requirement_text,
                )

    @property
    def mesh_axes(self) -> tuple[Axis, ...]:
        """Parameters of ``meshes``, each with its sorted values; empty without meshes."""
        parameter_names = (
            [parameter_name for parameter_name, _ in self.meshes[0].values] if self.meshes else []
        )
        values_by_name = {
            parameter_name: {dict(mesh_file.values)[parameter_name] for mesh_file in self.meshes}
            for parameter_name in parameter_names
        }
        return tuple(
            Axis(parameter_name, tuple(sorted(parameter_values)))
            for parameter_name, parameter_values in values_by_name.items()
        )

    @property
    def mesh_files(self) -> tuple[str, ...]:
        """Paths of ``meshes`` in the order of :attr:`mesh_axes`, the last parameter fastest."""
        parameter_names = [axis.key for axis in self.mesh_axes]
        ordered_mesh_files = sorted(
            self.meshes,
            key=lambda mesh_file: [
                dict(mesh_file.values)[parameter_name] for parameter_name in parameter_names
            ],
        )
        return tuple(mesh_file.key for mesh_file in ordered_mesh_files)

    @property
    def inference_setting_by_key(self) -> dict[str, Any]:
        """Values by key of the settings for inference: deviations and confidence.

        Keys that define the forward model are left out.
        """
        forward_model_keys = {"unknown", "meshes", "uncracked", "frequencies", "finer"}
        return {
            key: getattr(self, key) for key in self.field_by_key() if key not in forward_model_keys
        }


@dataclass(frozen=True)
class TipTiming(Table):
    """Settings for blade tip timing: probes in the casing, and the fit to tip arrivals.

    [tip_timing]
    probes = [0.0, 17.0, 41.0, 58.0, 86.0, 113.0, 140.0, 178.0, 205.0, 251.0, 288.0, 330.0]
    tip_radius = 0.45
    """

    probes: tuple[float, ...] = value_field(
        "a list of rising angles in degrees, from 0 to less than 360",
        lambda angles: (
            angles and 0.0 <= angles[0] and angles[-1] < 360.0 and bool(np.all(np.diff(angles) > 0))
        ),
    )
    """Probe angles [degrees] in the direction of rotation.

    An angle is 0 at the tip's position when the shaft's once-per-revolution mark passes its sensor.
    """
    tip_radius: float = positive_field(unit="m")
    """Distance between tip and axis."""
    tangential: float | None = value_field(
        f"a finite number other than 0 (of magnitude {ALLOWED_MAGNITUDES_TEXT})",
        lambda share: share != 0.0,
        None,
    )
    """Ratio of the tip's displacement along the rotation to the first watched displacement.

    Watched first is the load's dof, or the first point in [output.points]. The ratio is the sine of
    the stagger; < 0: against the rotation. Default: 1. For a solid with [rotation] the default is
    no ratio, but the circumferential motion of the watched node. For ``identify``, the rotor axis
    must then be parallel to x, y or z.
    """
    order: int | None = positive_int_field(None)
    """Number of load periods in a revolution, for a scene without [rotation]."""
    revolutions: int = positive_int_field(100)
    """Number of revolutions for which arrivals are computed; in a run-up the total number."""
    noise: float = nonnegative_field(0.0, unit="s")
    """Standard deviation of the normal errors that are added to computed arrival times."""
    clock: float = nonnegative_field(0.0, unit="s")
    """Step of the clock to which computed arrival times are rounded; 0: not rounded."""
    seed: int = value_field("a whole number >= 0", lambda value: value >= 0, 0)
    """Seed for the random errors with ``noise``."""
    angle_deviation: float = nonnegative_field(0.0, unit="degrees")
    """Standard deviation of the probe angles' errors, which a fit takes as constant."""
    orders: tuple[float, ...] | None = value_field(
        "a list of different whole numbers >= 1",
        lambda orders: (
            orders
            and all(order >= 1.0 and order % 1.0 == 0.0 for order in orders)
            and len(set(orders)) == len(orders)
        ),
        None,
    )
    """Engine orders among which the fit chooses for the vibration in the arrivals.

    Default: the load's order, or 1 to 24 if the order is unknown.
    """
    stiffening: float | None = bounded_field("-0.9", "0.9", None)
    """Relative change of natural frequencies f per relative change of the speed n, d ln f / d ln n.

    It is used for resonances in a measured run-up, and affects the fitted damping. Default with
    [rotation]: computed for each mode by the Campbell diagram; otherwise 0.
    """
    frequencies: tuple[float, ...] | None = value_field(
        "two finite numbers > 0, the second one larger",
        lambda ends: len(ends) == 2 and 0.0 < ends[0] < ends[1],
        None,
    )
    """Range for a frequency that need not be a multiple of the speed [Hz].

    It replaces engine orders, at constant speed.
    """
    fitted_harmonics: int = positive_int_field(2)
    """Number of fitted harmonics; 2 or more show a breathing crack."""
    subharmonic: int = positive_int_field(1)
    """2: the vibration has twice the load's period.

    Harmonics are then multiples of half the load frequency.
    """
    fitted_revolutions: int = positive_int_field(1)
    """Number of consecutive revolutions of a run-up that are fitted together."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.frequencies is not None:
            self.require(self.subharmonic == 1, "subharmonic", "1 with tip_timing.frequencies")
            self.forbid_keys(("orders",), "tip_timing.frequencies")


@dataclass(frozen=True)
class Output(Table):
    """Settings for the output: printed and drawn quantities, and watched points.

    [output]
    quantities = ["amplitude", "ratio_2_1"]
    [output.points]
    tip = [0.1, 0.1]
    """

    quantities: tuple[str, ...] | None = value_field(
        f"a list of names out of {', '.join(OBSERVABLES_BY_NAME)}",
        lambda names: names and set(names) <= OBSERVABLES_BY_NAME.keys(),
        None,
    )
    """Names of printed and drawn quantities; files have all. Default: a short selection."""
    points: tuple[NamedPoint, ...] = value_field(
        f"a table with at most {MAX_ALLOWED_OUTPUT_POINTS} points: a name of letters, digits and "
        "_, and finite numbers [x, y], or [x, y, z] in a solid",
        lambda points: (
            len(points) <= MAX_ALLOWED_OUTPUT_POINTS
            and all(re.fullmatch(r"[A-Za-z]\w{0,29}", point.key, re.A) for point in points)
        ),
        (),
    )
    """Points [m]: the nearest node to each is watched in each direction.

    Default: the dof with the largest load.
    """
