"""The tables of a structure, its load and its solution, with each key's allowed values."""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass
from itertools import zip_longest
from typing import Any, ClassVar

import numpy as np

from fenics_crack.basics.errors import (
    DEFAULT_ERROR_TOLERANCE,
    MAX_CONTACT_SAMPLES_PER_PERIOD,
    check_rayleigh_damping_ratios,
)
from fenics_crack.basics.tables import RAD_PER_S_PER_RPM
from fenics_crack.scene.fields import (
    ZERO_OR_MAGNITUDE_TEXT,
    Harmonic,
    NamedCadFace,
    Pair,
    Rule,
    Table,
    Vector,
    any_type_field,
    bounded_field,
    choice_field,
    harmonic_order_field,
    hertz_field,
    load_harmonic_list_field,
    nonnegative_field,
    number_field,
    path_field,
    positive_field,
    positive_int_field,
    twin_field,
    vector_key_field,
)

LOAD_KINDS = ("force", "pressure", "traction")
"""Kinds of [[loads]]: a force acts at a point, pressure and traction on an edge."""
KEYS_BY_LOAD_KIND = {
    load_kind: (f"{load_kind}_mean", f"{load_kind}_cos", f"{load_kind}_sin")
    for load_kind in LOAD_KINDS
}
"""Keys for mean, cosine and sine by kind of load."""
FORCE_KEYS = KEYS_BY_LOAD_KIND["force"]
EDGE_LOAD_KEYS = KEYS_BY_LOAD_KIND["pressure"] + KEYS_BY_LOAD_KIND["traction"]
"""Keys for loads on an edge."""
MAX_TOTAL_POINTS_ON_NAMED_FACES = 200
"""Maximum number of points in ``[geometry.faces]``."""


@dataclass(frozen=True)
class Geometry(Table):
    """A plate [0, width] x [0, height] in plane stress, clamped along y = 0, or a solid.

    A solid is a box [0, width] x [0, height] x [0, thickness], clamped at y = 0, or a part from a
    CAD file. A mesh file has its own shape.
    """

    _KEY_RULES = (
        Rule("without geometry.file", ("unit", "faces")),
        Rule("geometry.file", ("kind",), allowed_choices=("solid",)),
        Rule("geometry.file", ("width", "height", "thickness")),
    )

    kind: str = choice_field("plate", "solid", default="plate")
    """"plate": plane stress; "solid": three dimensions."""
    thickness: float | None = positive_field(None, unit="m")
    """Thickness of a plate, also with a mesh file, or of a box along z."""
    width: float | None = bounded_field("1e-6", "1e6", None, unit="m")
    height: float | None = bounded_field("1e-6", "1e6", None, unit="m")
    file: str | None = any_type_field(
        "the path of a .step, .stp or .brep file",
        lambda path: path.lower().endswith((".step", ".stp", ".brep")),
        None,
        path=True,
    )
    """CAD file with a part without a crack, one solid, for meshing."""
    unit: str | None = choice_field("mm", "m", "inch", default=None)
    """Length unit of a .brep file, which does not state the unit."""
    faces: tuple[NamedCadFace, ...] = any_type_field(
        "a table of face names, each with a list of points [x, y, z] in m on faces of the part; "
        f"at most {MAX_TOTAL_POINTS_ON_NAMED_FACES} points",
        lambda faces: sum(len(face.values) for face in faces) <= MAX_TOTAL_POINTS_ON_NAMED_FACES,
        (),
    )
    """Names of a part's faces, each with points [m] on the face or near it."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.file is None:
            return
        self.require(
            any(
                face_with_points.key == "clamp" and face_with_points.values
                for face_with_points in self.faces
            ),
            "faces",
            "a table with points on the clamped faces, clamp = [[x, y, z]]",
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
        """Width and height [m], and thickness [m] for a solid.

        A side not given in the scene is left out.
        """
        side_lengths = (self.width, self.height, self.thickness)[: self.dimension]
        return tuple(side_length for side_length in side_lengths if side_length is not None)

    @property
    def circumferential_width(self) -> float:
        """Side along the circumference in a bladed disk [m].

        This is the width of a plate, or the thickness of a box.
        """
        return self.sides[0 if self.dimension == 2 else 2]


PLATE_OR_BOX_CRACK_KEYS = ("edge", "center", "height", "first_frequency", "first_omega")
"""Keys of a crack in a plate, or in the plane y = height of a box; length and depth are further
keys."""
ARBITRARY_PLANE_CRACK_KEYS = ("point", "normal", "direction", "radii")
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
    point: Vector | None = vector_key_field("", unit="m", of_solid=True)
    """Middle of the ellipse, or point on the half-plane's end.

    With "through" and a length: point at the mouth.
    """
    normal: Vector | None = vector_key_field("n", of_solid=True)
    """Normal of the crack's plane."""
    direction: Vector | None = vector_key_field("d", of_solid=True)
    """Direction of the first radius, or of growth for a half-plane.

    Only the component in the crack's plane counts.
    """
    radii: Pair | None = any_type_field(
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

    @property
    def half_axes(self) -> Pair:
        """Half axes of the elliptical crack [m]: along ``direction``, and across."""
        return self.radii or (0.5 * self.given("length"), self.given("depth"))

    @property
    def is_elliptical(self) -> bool:
        """True for an elliptical crack, in a box or around a point of any solid."""
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
    poisson: float = any_type_field(
        "a finite number with -1 < nu < 0.5", lambda nu: -1.0 < nu < 0.5
    )
    """Poisson's ratio [-]."""
    density: float = positive_field(unit="kg/m^3")


@dataclass(frozen=True)
class Damping(Table):
    """Modal or Rayleigh damping, given in one of three ways.

    - Modal damping: ``ratio`` is the damping relative to critical damping, for each of the lowest
      ``modes``. With ``modes = "all"`` and one ratio, all coordinates of a reduced structure are
      damped. ``stiffness`` may be added: a mode of frequency omega then has the ratio
      ratio + stiffness omega / 2.
    - Rayleigh damping by ``mass`` and ``stiffness``, or one of both: the factors in C = mass M +
      stiffness K. C, M and K are the matrices of damping, mass and stiffness.
    - Rayleigh damping by ``ratios``: the damping ratios at the two frequencies ``omegas`` or
      ``frequencies``.
    """

    ratio: float | tuple[float, ...] | None = any_type_field(
        "a number from 0 to 1 (0.02 for 2 %), or a list of them, one per mode",
        lambda ratio: np.min(ratio) >= 0 and np.max(ratio) <= 1,
        None,
    )
    """Ratio to critical damping, for all modes or for each mode."""
    modes: int | str = any_type_field(
        "'all' or a whole number >= 1", lambda value: value == "all" or value >= 1, "all"
    )
    """Number of damped modes, from the lowest; "all": every mode."""
    mass: float | None = nonnegative_field(None, unit="1/s")
    stiffness: float | None = nonnegative_field(None, unit="s")
    ratios: Pair | None = any_type_field(
        "[xi_1, xi_2], two numbers from 0 to 1",
        lambda ratios: min(ratios) >= 0 and max(ratios) <= 1,
        None,
    )
    """Ratios to critical damping at two frequencies."""
    omegas: Pair | None = any_type_field(
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
        self.require(
            bool(given_groups_and_keys),
            "ratio",
            "given; or damping.mass or damping.stiffness; or damping.ratios with damping.omegas or "
            "damping.frequencies",
        )
        (chosen_key_group, key), *_ = given_groups_and_keys
        for key_group in key_groups:
            if key_group is not chosen_key_group:
                forbidden_keys = [
                    group_key
                    for group_key in key_group
                    if (key, group_key) != ("ratio", "stiffness")
                ]
                self.forbid_keys(forbidden_keys, f"damping.{key} = {getattr(self, key)}")
        if self.ratio is None:
            self.require(
                self.modes == "all", "modes", f"left out with damping.{key}, which damps all modes"
            )
        elif self.stiffness:
            self.require(self.modes == "all", "modes", "'all' with damping.stiffness")
        if isinstance(self.ratio, tuple):
            self.require(
                self.modes in ("all", len(self.ratio)),
                "ratio",
                f"a list with damping.modes = {self.modes} ratios",
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
    """Base class for tables with a periodic load.

    ``harmonics`` are further harmonics of the load. Only an excitation has ``wave``, the path of a
    file with one period of a force. The first ``wave_harmonics`` harmonics are kept from the file.
    """

    harmonics: tuple[Harmonic, ...]
    wave: str | None = None
    wave_harmonics: int = 1

    @property
    def highest_load_harmonic(self) -> int:
        """Highest multiple of the load frequency in this load, at least 1."""
        highest_wave_order = self.wave_harmonics if self.wave is not None else 1
        return max(highest_wave_order, *(harmonic.order for harmonic in self.harmonics), 1)


@dataclass(frozen=True)
class Excitation(Table, PeriodicLoad):
    """Point force f(t) = force_mean + force_cos cos(omega t) + force_sin sin(omega t).

    ``[[excitation.harmonics]]`` adds c cos(k omega t) + s sin(k omega t) for further orders k. The
    amplitudes c and s are the keys ``cos`` and ``sin``. With an engine order n the frequency is n
    times ``rotation.speed``.
    """

    _KEY_RULES = (Rule("without excitation.wave", ("wave_harmonics",)),)

    omega: float = positive_field(None, unit="rad/s")
    """Angular frequency; with an engine order it follows from the speed."""
    frequency: float | None = hertz_field("omega")
    """``omega`` in Hz; give either key, or an order."""
    order: int | None = positive_int_field(None)
    """Engine order: omega is the order times ``rotation.speed``."""
    point: Vector | None = vector_key_field("", unit="m")
    """Point of the force; a mesh file may have a physical point ``load`` instead."""
    force_sin: Vector = vector_key_field("f", (0.0, 0.0), unit="N")
    force_cos: Vector = vector_key_field("f", (0.0, 0.0), unit="N")
    force_mean: Vector = vector_key_field("f", (0.0, 0.0), unit="N")
    harmonics: tuple[Harmonic, ...] = load_harmonic_list_field()
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
        if self.order is None:
            self.given("omega", "given: a finite number > 0 [rad/s], or excitation.frequency [Hz]")

    def at_speed(self, speed: float) -> Excitation:
        """Return the excitation with the load frequency at a rotor speed [rad/s].

        The frequency omega is ``order`` times the speed. Raises InputError if ``frequency`` or
        ``omega`` was given, too.
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
        """Return changes by key, in which contradicting keys become None.

        A changed frequency in Hz removes the frequency in rad/s, and vice versa. A changed
        frequency removes the engine order, and a changed order the frequency. If ``current_values``
        have both, as for a bladed disk at rest, both stay.
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
        force_keys = (*FORCE_KEYS[::-1], "harmonics", "wave")
        return next((key for key in force_keys if any(getattr(self, key) or ())), "")


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

    The load over time is

        q(t) = q_mean + q_cos cos(omega t - phase) + q_sin sin(omega t - phase)

    with the excitation's frequency omega. The amplitudes q_mean, q_cos and q_sin are the keys with
    these endings, such as ``pressure_mean``, ``pressure_cos`` and ``pressure_sin``.

    An edge is "top", "left" or "right" of a plate, or a curve named in a mesh file. A pressure
    pushes towards the plate.
    """

    FIRST_TABLE_NAME = "loads.1"
    _KEY_RULES = (
        Rule("point", ("edge",), ": a load acts on an edge or at a point"),
        Rule("point", EDGE_LOAD_KEYS, ": pressures and tractions need edge"),
        Rule("edge", FORCE_KEYS, ": a force needs point"),
    )

    point: Vector | None = vector_key_field("", unit="m")
    edge: str | None = any_type_field(
        "'top', 'left', 'right', or a curve of the mesh file", default=None
    )
    force_sin: Vector | None = vector_key_field("f", unit="N")
    force_cos: Vector | None = vector_key_field("f", unit="N")
    force_mean: Vector | None = vector_key_field("f", unit="N")
    pressure_sin: float | None = number_field(None, unit="Pa")
    pressure_cos: float | None = number_field(None, unit="Pa")
    pressure_mean: float | None = number_field(None, unit="Pa")
    traction_sin: Vector | None = vector_key_field("t", unit="Pa")
    traction_cos: Vector | None = vector_key_field("t", unit="Pa")
    traction_mean: Vector | None = vector_key_field("t", unit="Pa")
    phase: float = number_field(0.0, unit="degrees")
    """Phase lag in cos(omega t - phase) and sin(omega t - phase)."""
    harmonics: tuple[Harmonic, ...] = load_harmonic_list_field()
    """Further harmonics, ``[[loads.harmonics]]``, as in the excitation.

    At a point they are forces; on an edge tractions or, with one number, pressures [Pa].
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.point is None:
            self.given("edge", "given: 'top', 'left', 'right' or a curve of the mesh; or point")
        self.require(
            self.point is None or all(len(harmonic.cos) > 1 for harmonic in self.harmonics),
            "harmonics",
            "a list with forces at a point, as cos = [fx, fy]",
        )
        allowed_keys = EDGE_LOAD_KEYS if self.point is None else FORCE_KEYS
        self.require(
            any(getattr(self, key) not in (None, ()) for key in ("harmonics", *allowed_keys)),
            allowed_keys[-1],
            f"given, or one of {', '.join(allowed_keys[:-1])}",
        )
        if all(getattr(self, key) is None for key in allowed_keys if not key.endswith("_mean")):
            self.forbid_keys(("phase",), "a mean load alone, which has no phase")

    def harmonic_components(self, load_kind: str) -> list[Vector]:
        """Return the Fourier vectors of one kind of load; ``phase`` has been applied.

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
        values = (getattr(self, key) for key in KEYS_BY_LOAD_KIND[load_kind])
        mean_vector, cosine_vector, sine_vector = (
            value if isinstance(value, tuple) else () if value is None else (value,)
            for value in values
        )
        phase_factor = cmath.rect(1.0, math.radians(self.phase))
        lagged_components = [
            phase_factor * complex(cosine_component, sine_component)
            for cosine_component, sine_component in zip_longest(
                cosine_vector, sine_vector, fillvalue=0.0
            )
        ]
        harmonic_vectors = [
            mean_vector,
            tuple(component.real for component in lagged_components),
            tuple(component.imag for component in lagged_components),
            *((),) * (2 * self.highest_load_harmonic - 2),
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

    acceleration_sin: Vector | None = vector_key_field("a", unit="m/s^2")
    acceleration_cos: Vector | None = vector_key_field("a", unit="m/s^2")
    harmonics: tuple[Harmonic, ...] = load_harmonic_list_field()
    """Further harmonics of the acceleration, ``[[base.harmonics]]``, as in the excitation."""

    def __post_init__(self) -> None:
        super().__post_init__()
        first_order_accelerations = (self.acceleration_cos or (), self.acceleration_sin or ())
        self.require(
            bool(self.harmonics) or any(map(any, first_order_accelerations)),
            "acceleration_sin",
            "given and not zero, or base.acceleration_cos or base.harmonics given",
        )

    @property
    def accelerations(self) -> list[Vector]:
        """Acceleration vectors [m/s^2]: cosine, then sine, for each order from 1."""
        first_order_vectors = (self.acceleration_cos, self.acceleration_sin)
        n_components = max(
            len(vector)
            for vector in (*first_order_vectors, *(harmonic.cos for harmonic in self.harmonics))
            if vector
        )
        zero_vector = (0.0,) * n_components
        harmonic_vectors: list[Vector] = [zero_vector] * (2 * self.highest_load_harmonic + 1)
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

    _KEY_RULES = (Rule("rotation.center", ("hub_radius",), ", which places the axis"),)

    hub_radius: float | None = nonnegative_field(None, unit="m")
    """Radius at y = 0, the clamp: the axis is at y = -hub_radius."""
    axis: Vector | None = vector_key_field("a", of_solid=True)
    """Axis direction for a solid; default: x."""
    center: Vector | None = vector_key_field("", unit="m", of_solid=True)
    """Point on the rotor axis, for a solid, instead of hub_radius."""
    speed: float = any_type_field(
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
        self.require(self.axis is None or any(self.axis), "axis", "a vector that is not zero")


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

    _KEY_RULES = (Rule("disk.mistuning", ("deviation", "seed")),)

    sectors: int = any_type_field("a whole number from 3 to 1000", lambda count: 3 <= count <= 1000)
    cracked: tuple[int, ...] = any_type_field(
        "the number of a sector, from 1, or a list of different numbers",
        lambda numbers: min(numbers, default=1) >= 1,
        (1,),
    )
    """Sectors with a crack; in other sectors the crack faces are bonded."""
    mistuning: tuple[float, ...] | None = any_type_field(
        "a list of numbers above -0.5 and below 1, one for each sector",
        lambda deviations: all(-0.5 < deviation < 1.0 for deviation in deviations),
        None,
    )
    """Relative deviation of each sector's stiffness at rest."""
    deviation: float = bounded_field("0", "0.1", 0.0)
    """Standard deviation of a random mistuning pattern, instead of ``mistuning``.

    The sectors' relative stiffness deviations are then independent normal numbers.
    """
    seed: int = any_type_field("a whole number >= 0", lambda value: value >= 0, 0)
    """Seed of the random pattern, for NumPy's default generator."""
    families: int = positive_int_field(3)
    """Number of lowest modes kept for each nodal diameter; the load's band must be among them.

    Four more modes for each nodal diameter, and static solutions, serve to assess the neglected
    modes.
    """
    modes: int = any_type_field("a whole number >= 0", lambda count: count >= 0, 0)
    """Number of further modes of the wheel: the modes that open the cracks most."""
    inner_radius: float | None = positive_field(None, unit="m")
    """Radius at which the rim is clamped."""
    outer_radius: float | None = positive_field(None, unit="m")
    """Outer radius of the rim."""
    center: Vector | None = vector_key_field("", unit="m")
    """With a mesh file: point on the rotor axis; default: the origin."""
    axis: Vector | None = vector_key_field("a", of_solid=True)
    """With a mesh file of a solid: direction of the rotor axis; default: x."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require(
            max(self.cracked, default=1) <= self.sectors,
            "cracked",
            f"sector numbers from 1 to disk.sectors = {self.sectors}",
        )
        self.require(
            self.mistuning is None or len(self.mistuning) == self.sectors,
            "mistuning",
            f"one number for each of the {self.sectors} sectors",
        )
        self.require(self.axis is None or any(self.axis), "axis", "a vector that is not zero")

    @property
    def deviations(self) -> np.ndarray:
        """Relative stiffness deviation of each sector: (sectors,).

        The key ``mistuning`` has the deviations. Without this key, they are random: normally
        distributed with standard deviation ``deviation``, from the random seed ``seed``.
        """
        if self.mistuning is not None:
            return np.array(self.mistuning)
        return np.random.default_rng(self.seed).normal(0.0, self.deviation, self.sectors)


@dataclass(frozen=True)
class Contact(Table):
    """Settings for contact between the crack faces, at pairs of opposite nodes."""

    _KEY_RULES = (
        Rule(
            "contact.law = 'unilateral'",
            ("stiffness", "stiffness_per_area", "sharpness", "layer_depth", "layer_share"),
        ),
        Rule("contact.law = 'penalty'", ("sharpness",)),
        Rule("contact.law = 'smoothed'", ("layer_depth", "layer_share")),
        Rule("without contact.friction", ("tangential_stiffness_per_area",), " > 0"),
    )

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
    layer_share: float | None = any_type_field(
        "a number between 0 and 1", lambda share: 0.0 < share < 1.0, None
    )
    """Share a of the stiffness that acts from the first contact on; the rest beyond the depth p."""
    friction: float | None = nonnegative_field(None)
    """Coefficient of Coulomb friction between crack faces, static and kinetic.

    Left out: no friction; the error report then states the effect that friction would have, but not
    with a contact layer or the law "smoothed".
    """
    friction_error: float | bool = any_type_field(
        "a finite number > 0, or false", lambda mu: mu is False or mu > 0, 0.3
    )
    """Friction coefficient for which the error of neglecting friction is computed.

    It counts only if ``contact.friction`` is left out; false: this error is not computed.
    """
    tangential_stiffness_per_area: float | None = positive_field(None, unit="N/m^3")
    """Tangential stiffness of sticking pairs, per area of crack face.

    Left out: sticking pairs do not move, which requires crack faces without mass
    (``reduction.method = "massless"``) and no contact layer.
    """
    pairs: str = choice_field("all", "mouth", default="all")
    """"all": every pair of crack-face nodes, or mesh.patches pairs.

    "mouth": for each crack only the pair at the mouth, or in the middle of an internal crack.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        law_text = f"contact.law = {self.law!r}"
        has_one_stiffness = (self.stiffness is None) != (self.stiffness_per_area is None)
        self.require(
            has_one_stiffness or self.law == "unilateral",
            "stiffness",
            f"given, or contact.stiffness_per_area, but not both, with {law_text}",
        )
        if self.law == "smoothed":
            self.given("sharpness", "given: a finite number > 0 [1/m], for the smoothed law")
        if self.layer_depth is not None or self.layer_share is not None:
            self.given("layer_depth", "given: a finite number > 0 [m], with contact.layer_share")
            self.given("layer_share", "given: a number between 0 and 1, with contact.layer_depth")
            if self.friction:
                tangential_requirement = "with contact.friction and contact.layer_depth"
                self.given(
                    "tangential_stiffness_per_area",
                    f"given: a stiffness [N/m^3], {tangential_requirement}",
                )
        self.require(
            self.has_force_only_when_closed or not self.friction,
            "friction",
            f"0, or left out, with {law_text}",
        )

    @property
    def has_force_only_when_closed(self) -> bool:
        """True for the laws "penalty" and "unilateral": a pair is either open or closed.

        With the law "smoothed", a pair has a contact force at every gap.
        """
        return self.law in ("penalty", "unilateral")


@dataclass(frozen=True)
class HarmonicBalance(Table):
    """Settings for harmonic balance: harmonics, contact sampling and tolerance."""

    _KEY_RULES = (
        Rule("harmonic_balance.form = 'block'", ("tolerance",)),
        Rule("harmonic_balance.tolerance", ("samples",)),
    )

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
    error: bool = any_type_field("true or false", default=True)
    """false: neither error nor stability is computed.

    With many pairs or modes, error and stability take longer than the solution.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        default_by_key: dict[str, Any] = {"harmonics": 5}
        has_given_size = self.harmonics is not None or self.samples is not None
        if self.error and self.form == "condensed" and not has_given_size:
            default_by_key["tolerance"] = DEFAULT_ERROR_TOLERANCE
        inferred_keys = {key for key in default_by_key if getattr(self, key) is None}
        vars(self).update(
            {key: default_by_key[key] for key in inferred_keys}, _inferred_keys=inferred_keys
        )
        self.require(
            self.error or self.tolerance is None,
            "error",
            "true, or left out, with harmonic_balance.tolerance",
        )
        min_samples = 4 * self.harmonics + 1
        self.require(
            self.samples is None or min_samples <= self.samples <= MAX_CONTACT_SAMPLES_PER_PERIOD,
            "samples",
            f"a whole number from {min_samples} (4 times harmonics + 1) to "
            f"{MAX_CONTACT_SAMPLES_PER_PERIOD}, or left out",
        )

    def with_load_harmonics(self, highest_order: int) -> HarmonicBalance:
        """Return the table with at least as many harmonics as the load.

        ``highest_order`` is the highest harmonic of any load. If necessary, the default number of
        harmonics is increased. Raises InputError if the scene gives a smaller number.
        """
        has_enough_harmonics = self.harmonics >= highest_order
        self.require(
            has_enough_harmonics or "harmonics" in self.derived_keys,
            "harmonics",
            f"a whole number >= {highest_order}, the highest order of the load",
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

    _GRID_LAYOUT_KEYS: ClassVar = ("columns", "rows")
    _GRADED_LAYOUT_KEYS: ClassVar = ("size", "lip_elements", "grading", "per_turn")
    _FILE_LAYOUT_KEYS: ClassVar = ("file", "coarser")
    _KEY_RULES = (
        Rule("mesh.layout = 'grid'", (*_GRADED_LAYOUT_KEYS, *_FILE_LAYOUT_KEYS)),
        Rule("mesh.layout = 'graded'", (*_GRID_LAYOUT_KEYS, *_FILE_LAYOUT_KEYS)),
        Rule("mesh.layout = 'file'", (*_GRID_LAYOUT_KEYS, *_GRADED_LAYOUT_KEYS)),
        Rule("mesh.layout = 'file'", ("cells",), ": the mesh file has the cells"),
    )

    layout: str = choice_field("grid", "graded", "file")
    """Layout: "grid", equal cells; "graded", finer at cracks; "file", a mesh file."""
    cells: str = choice_field("triangle", "quadrilateral", default="quadrilateral")
    """Cells in a plate; a mesh file and a graded sector have their own."""
    order: int = any_type_field("1 or 2", lambda value: value in (1, 2), default=None)
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
    per_turn: int = any_type_field(
        "a whole number from 4 to 200", lambda count: 4 <= count <= 200, 12
    )
    """Number of elements on a full turn around a curved face of a CAD part."""
    patches: int | None = positive_int_field(None)
    """Maximum number of contact pairs in each crack.

    Pairs are means over several nodes, if the mesh is finer than contact needs. Default: all nodes;
    in a solid all corners of elements.
    """
    error: bool = any_type_field("true or false", default=True)
    """true: a coarser mesh gives the mesh error of each number."""

    def __post_init__(self) -> None:
        super().__post_init__()
        required_keys = {"grid": self._GRID_LAYOUT_KEYS, "graded": ("size",), "file": ("file",)}
        for key in required_keys[self.layout]:  # an uncracked plate has no lip_elements
            allowed_text = self.field_by_key()[key].metadata["allowed"]
            self.given(key, f"given: {allowed_text}, with layout = {self.layout!r}")

    def with_dimension(self, dimension: int) -> Mesh:
        """Return the table with the polynomial order of the elements set.

        A given order stays. The default order is 1 if ``dimension`` is 2, and 2 if ``dimension`` is
        3.
        """
        polynomial_order = self.order or dimension - 1
        return self.with_unchecked_values(
            order=polynomial_order, _inferred_keys={"order"} if polynomial_order == 1 else set()
        )


@dataclass(frozen=True)
class Structure(Table):
    """Matrices in files beside the scene, instead of a plate.

    The equations are

        M u'' + C u' + K u + B lambda(g) = f(t), g = B^T u - g0

    with displacements u, mass M, damping C, stiffness K, load f, gaps g of contact pairs, contact
    forces lambda, gap matrix B and clearance g0. The tables [geometry], [material], [mesh], [crack]
    and [base] are left out.

    The files for M, C and K have the formats of Matrix Market, CalculiX (.sti, .mas), Abaqus (.mtx)
    or Nastran (.pch, .op4). The files for gap matrices, load, clearance and areas are Matrix Market
    files. With the ``model`` that belongs to the matrices, the load may act at excitation.point. If
    there is contact without a file for the gaps, the contact pairs are found in the model.
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
        self.require(
            any((self.force_sin, self.force_cos, self.force_mean, self.model)),
            "force_sin",
            "given, or structure.force_cos, structure.force_mean or structure.model",
        )


@dataclass(frozen=True)
class Reduction(Table):
    """Reduction of the structure before the solution (``reduce_structure``).

    Without this table a structure with up to 100 dofs is not reduced, and a larger one is reduced
    with the default basis. ``reduction = "off"`` is short for ``reduction.method = "off"``.
    """

    KEY_OF_BARE_VALUE = "method"

    method: str | None = choice_field("massless", "free_interface", "off", default=None)
    """Default with contact: "massless", modes and crack faces without mass.

    Default without contact, or if all modes are kept: "free_interface".
    """
    modes: int | None = positive_int_field(None)
    """Number of lowest modes. Default with a tolerance: few modes that meet it.

    Default otherwise: the damped modes, or 50 if all are damped.
    """
