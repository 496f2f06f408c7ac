"""The tables of a scene: every key states here, once, what it may hold."""

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
    check_damping_ratios,
)
from fenics_crack.basics.observables import OBSERVABLES_BY_NAME
from fenics_crack.basics.tables import RAD_PER_S_PER_RPM, RAD_PER_TURN
from fenics_crack.scene.fields import (
    OR_ZERO,
    Axis,
    Face,
    Harmonic,
    MeshFile,
    Pair,
    Point,
    Table,
    Vector,
    at_least_one,
    between,
    choice,
    hertz,
    holds,
    not_negative,
    number,
    of_harmonics,
    order_of_load,
    path,
    positive,
    twin,
    vector,
)

FORCES = ("force_mean", "force_cos", "force_sin")
"""Parts of the excitation."""
LOAD_KINDS = ("force", "pressure", "traction")
"""Kinds of the loads at a point or on an edge."""
MOST_POINTS = 100
"""Points of ``[output.points]``: every quantity of each is computed, printed and written."""
MOST_FACES = 200
"""Points of ``[geometry.faces]``."""
MIN_VALUES = 4
"""Minimum values of an unknown, as its interpolation requires."""


@dataclass(frozen=True)
class Geometry(Table):
    """A plate [0, width] x [0, height] in plane stress, clamped along y = 0; or a solid, the box
    [0, width] x [0, height] x [0, thickness], clamped at y = 0, or a part from a CAD file. A mesh
    file has its own shape."""

    kind: str = choice("plate", "solid", default="plate")
    """Plane stress, or three dimensions."""
    thickness: float | None = positive(None, unit="m")
    """Thickness of a plate, whatever its mesh, and of a box along z."""
    width: float | None = between("1e-6", "1e6", None, unit="m")
    height: float | None = between("1e-6", "1e6", None, unit="m")
    file: str | None = holds(
        "the path of a .step, .stp or .brep file",
        lambda path: path.lower().endswith((".step", ".stp", ".brep")),
        None,
        path=True,
    )
    """A part without a crack, one solid, that is meshed here."""
    unit: str | None = choice("mm", "m", "inch", default=None)
    """Unit of length of a .brep file, which has none."""
    faces: tuple[Face, ...] = holds(
        f"names with lists of points [x, y, z] in m, one on each face, at most {MOST_FACES}",
        lambda faces: sum(len(face.values) for face in faces) <= MOST_FACES,
        (),
    )
    """Faces of a part: a point on, or near, each."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.file is None:
            self.leave_out(("unit", "faces"), "no geometry.file")
            return
        self.require(self.kind == "solid", "kind", "'solid' with geometry.file")
        self.leave_out(("width", "height", "thickness"), "geometry.file")
        clamped = any(face.key == "clamp" and face.values for face in self.faces)
        self.require(clamped, "faces", "names with lists of points, one of them clamp")
        if self.file.lower().endswith(".brep"):
            self.given("unit", "given: 'mm', 'm' or 'inch', as a .brep file has none")
        else:
            self.leave_out(("unit",), "a STEP file, which has one")

    @property
    def dimension(self) -> int:
        """2 for a plate, 3 for a solid."""
        return 3 if self.kind == "solid" else 2

    @property
    def sides(self) -> Vector:
        """Width, height and, of a solid, thickness [m], as far as they are given."""
        sides = (self.width, self.height, self.thickness)[: self.dimension]
        return tuple(side for side in sides if side is not None)

    @property
    def across(self) -> float:
        """Width of a plate or thickness of a box: of a blade, along the circumference [m]."""
        return self.sides[0 if self.dimension == 2 else 2]


OF_BOXES = ("edge", "center", "height", "first_frequency", "first_omega")
"""Keys of a crack in a plate, or in the plane y = height of a box; and its length and depth."""
OF_PLANES = ("point", "normal", "direction", "radii")
"""Keys of a crack in any plane of a solid."""


@dataclass(frozen=True)
class Crack(Table):
    """Straight horizontal crack: a slit whose two faces share only its tip, or its two tips.

    Of a solid: in the plane y = height, through the thickness, or as deep as ``depth`` from the
    face z = thickness. Or, of a box and of a part, in any plane: the part inside the solid of an
    ellipse around ``point``, or of the half-plane that ends there.
    """

    _ADVICE: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("edge = top", "edge = bottom"),
        "cracks run across the plate; one that does not comes in a mesh (mesh.layout = 'file')",
    )

    edge: str | None = choice("left", "right", default=None)
    """Edge of the plate at the crack's mouth; left out for a crack inside the plate."""
    center: float | None = positive(None, unit="m")
    """x of the middle of a crack inside the plate."""
    height: float | None = positive(None, unit="m")
    """y of the crack."""
    length: float | None = positive(None, unit="m")
    """Or let ``first_omega`` determine it."""
    depth: float | None = positive(None, unit="m")
    """Depth of a crack in a solid that does not go through it."""
    front: str | None = choice("straight", "elliptical", "through", default=None)
    """Shape of such a crack: a rectangle, or half of an ellipse; a quarter of one at an edge. Or
    "through": the half-plane that ends at ``point``."""
    point: Vector | None = vector("", unit="m", of_solid=True)
    """Middle of the ellipse; or where the half-plane ends or, with a length, where its mouth is."""
    normal: Vector | None = vector("n", of_solid=True)
    """Of the crack's plane."""
    direction: Vector | None = vector("d", of_solid=True)
    """Of the first radius, or in which a half-plane grows; as far as it is in the crack's plane."""
    radii: Pair | None = holds(
        "[a, b], two finite numbers > 0", lambda radii: min(radii) > 0, None, unit="m"
    )
    """Of the ellipse, along the direction and across; or half of ``length``, and ``depth``."""
    first_omega: float | None = positive(None, unit="rad/s")
    """First natural frequency with the crack open, from which the length is found."""
    first_frequency: float | None = hertz("first_omega")
    """The same in Hz."""
    clearance: float = number(0.0, unit="m")
    """g0 >= 0: opening that closes before the crack faces touch; < 0: preload."""

    def check_plane(self) -> None:
        """Raise InputError unless the crack of a solid is one around a point."""
        self.leave_out(OF_BOXES, "crack.point")
        normal = np.array(self.given("normal"))
        self.require(any(normal), "normal", "a vector that is not zero")
        self.require(self.front in (None, "through"), "front", "'through', or left out with radii")
        given = [key for key in ("length", "depth") if getattr(self, key) is not None]
        if self.front == "through":
            self.leave_out(("radii", "depth"), "front = 'through'")
        elif self.radii is not None:
            self.leave_out(given, "crack.radii")
        else:
            words = "given: [a, b]; or front = 'through', or crack.length and depth"
            self.require(len(given) == 2, "radii", words)
        if self.front == "through" or self.half_axes[0] != self.half_axes[1]:
            self.given("direction", "given: of the first radius, or in which a half-plane grows")
        if self.direction is not None:
            across = np.linalg.norm(np.cross(normal, self.direction))
            lengths = np.linalg.norm(normal) * np.linalg.norm(self.direction)
            self.require(across > 1e-3 * lengths, "direction", "a vector across crack.normal")

    @property
    def half_axes(self) -> Pair:
        """Radii of the ellipse around a point [m]."""
        return self.radii or (0.5 * self.given("length"), self.given("depth"))

    @property
    def is_elliptical(self) -> bool:
        """True of an ellipse, around a point or of a box."""
        return self.front == "elliptical" or (self.point is not None and self.front != "through")

    @property
    def frame(self) -> np.ndarray:
        """Rows: the direction and another one in the crack's plane, and the normal; (3, 3)."""
        normal = np.array(self.given("normal"), dtype=float)
        normal /= np.linalg.norm(normal)
        along = np.array(self.direction or np.eye(3)[np.abs(normal).argmin()], dtype=float)
        along -= (along @ normal) * normal
        along /= np.linalg.norm(along)
        return np.array([along, np.cross(normal, along), normal])

    def span(self, width: float) -> tuple[float, float]:
        """x of its left and its right end [m] in a plate of some width."""
        length = self.given("length")
        if self.edge is None:
            center = self.given("center")
            return center - 0.5 * length, center + 0.5 * length
        return (0.0, length) if self.edge == "left" else (width - length, width)


@dataclass(frozen=True)
class Material(Table):
    """Isotropic linear elastic."""

    _ADVICE: ClassVar[Mapping[str, str]] = {
        "name": "no material is known by its name: steel has young = 2.1e11, poisson = 0.3 and "
        "density = 7850.0;",
        "E": "did you mean material.young?",
        "nu": "did you mean material.poisson?",
        "rho": "did you mean material.density?",
    }

    young: float = positive(unit="Pa")
    """Young's modulus E."""
    poisson: float = holds("a finite number with -1 < nu < 0.5", lambda nu: -1.0 < nu < 0.5)
    """Poisson's ratio [-]."""
    density: float = positive(unit="kg/m^3")


@dataclass(frozen=True)
class Damping(Table):
    """Modal or Rayleigh damping, given in one of three ways.

    Modal: ``ratio``, xi_j of critical damping, for each of the lowest ``modes``. With ``modes =
    "all"`` and one ratio, all coordinates of a reduced structure are damped.

    Rayleigh, C = mass M + stiffness K: ``mass`` and ``stiffness``, or one of them; or ``ratios``,
    the ratios of damping at the two frequencies ``omegas`` or ``frequencies``.
    """

    ratio: float | tuple[float, ...] | None = holds(
        "a number from 0 to 1 (0.02 for 2 %), or a list of them, one per mode",
        lambda ratio: np.min(ratio) >= 0 and np.max(ratio) <= 1,
        None,
    )
    """Of critical damping, of each mode."""
    modes: int | str = holds(
        "'all' or a whole number >= 1", lambda value: value == "all" or value >= 1, "all"
    )
    """How many of the lowest modes are damped."""
    mass: float | None = not_negative(None, unit="1/s")
    stiffness: float | None = not_negative(None, unit="s")
    ratios: Pair | None = holds(
        "[xi_1, xi_2], two numbers from 0 to 1",
        lambda ratios: min(ratios) >= 0 and max(ratios) <= 1,
        None,
    )
    """Of critical damping, at two frequencies."""
    omegas: Pair | None = holds(
        "[omega_1, omega_2], two different numbers > 0",
        lambda omegas: min(omegas) > 0 and omegas[0] != omegas[1],
        None,
        unit="rad/s",
    )
    frequencies: Pair | None = hertz(
        "omegas",
        "[f_1, f_2], two different numbers > 0",
        lambda values: 0 < min(values) < max(values) <= 1e29,
    )
    """The same in Hz."""

    def __post_init__(self) -> None:
        super().__post_init__()
        ways = [("ratio",), ("mass", "stiffness"), ("ratios", "frequencies", "omegas")]
        found = [(way, key) for way in ways for key in way if getattr(self, key) is not None]
        allowed = "given, or damping.mass or damping.stiffness, or damping.ratios with omegas"
        self.require(bool(found), "ratio", f"{allowed} or frequencies")
        (chosen, key), *_ = found
        for way in ways:
            if way is not chosen:
                self.leave_out(way, f"{key} = {getattr(self, key)}")
        if self.ratio is None:
            self.require(self.modes == "all", "modes", f"left out with {key}: all are damped")
        elif isinstance(self.ratio, tuple):
            fits = self.modes in ("all", len(self.ratio))
            self.require(fits, "ratio", f"a list of damping.modes = {self.modes}")
        if "ratios" in chosen:
            ratios = self.given("ratios", f"given with omegas = {self.omegas}")
            omegas = self.given("omegas", f"given with ratios = {self.ratios}")
            check_damping_ratios(self.name_of("ratios"), ratios, omegas)

    @property
    def of_all_modes(self) -> bool:
        """True if every mode is damped, whatever the structure."""
        if self.ratio is None:
            return max(self.mass or 0.0, self.stiffness or 0.0, *(self.ratios or ())) > 0.0
        return self.modes == "all" and float(np.min(self.ratio)) > 0.0


class Periodic:
    """A load with further harmonics, and maybe a table of one period of it, "wave"."""

    harmonics: tuple[Harmonic, ...]
    wave: str | None = None
    wave_harmonics: int = 1

    @property
    def highest(self) -> int:
        """Highest order of its harmonics."""
        of_wave = self.wave_harmonics if self.wave is not None else 1
        return max(of_wave, *(one.order for one in self.harmonics), 1)


@dataclass(frozen=True)
class Excitation(Table, Periodic):
    """Point force f(t) = force_mean + force_cos cos(omega t) + force_sin sin(omega t), and
    ``[[excitation.harmonics]]`` of further orders k, cos cos(k omega t) + sin sin(k omega t); with
    an engine order n these act at k n times ``rotation.speed``."""

    omega: float = positive(None, unit="rad/s")
    """Angular frequency; with an engine order, the one that follows from it."""
    frequency: float | None = hertz("omega")
    """The same in Hz; one of the two is given, or an order."""
    order: int | None = at_least_one(None)
    """Engine order: omega is this many times ``rotation.speed``."""
    point: Vector | None = vector("", unit="m")
    """A mesh file may give it instead by a physical point named ``load``."""
    force_sin: Vector = vector("f", (0.0, 0.0), unit="N")
    force_cos: Vector = vector("f", (0.0, 0.0), unit="N")
    force_mean: Vector = vector("f", (0.0, 0.0), unit="N")
    harmonics: tuple[Harmonic, ...] = of_harmonics()
    """Further harmonics of the force [N]: ``order``, and ``cos`` and ``sin``, or ``amplitude`` and
    ``phase`` [degrees] by which it lags."""
    wave: str | None = path("a CSV file with a line of words, then rows of a time and forces")
    """A table of one period of a force that is added: a time, from its beginning to its end in any
    unit, and the components [N], linear in between; two rows of one time are a jump."""
    wave_harmonics: int = order_of_load(20)
    """Harmonics kept of it; what they leave out is stated."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.wave is None:
            self.leave_out(("wave_harmonics",), "no excitation.wave")
        if self.order is None:
            self.given("omega", "given [rad/s], or excitation.frequency [Hz]: a finite number > 0")

    def at_speed(self, speed: float) -> Excitation:
        """The same with the frequency that its order makes of a rotor's speed [rad/s]."""
        if "_follow" not in vars(self):
            self.leave_out(("frequency", "omega"), f"excitation.order = {self.order} and a speed")
        return self.with_values(omega=speed * (self.order or 0), _follow={"omega"})

    @classmethod
    def without_twins(
        cls, values: Mapping[str, object], held: Mapping[str, object]
    ) -> dict[str, Any]:
        """As of every table; a frequency takes the place of the order, or it of that."""
        both = ("omega", "frequency")
        others = {key for key in both if values.get(key) is not None}
        if held.get("order") is not None and any(held.get(key) is not None for key in both):
            pass  # of a bladed disk at rest, where neither makes the other
        elif others and "order" not in values:
            values = {"order": None, **values}
        elif values.get("order", held.get("order")) is not None:
            values = {"omega": None, **values}
        return super().without_twins(values, held)

    @property
    def force_given(self) -> str:
        """The first key of a force that is not zero; empty if there is none."""
        found = next((name for name in FORCES[::-1] if any(getattr(self, name))), "")
        return found or next((n for n in ("harmonics", "wave") if getattr(self, n)), "")


def add_harmonics(rows: list[Vector], harmonics: tuple[Harmonic, ...]) -> None:
    """Add harmonics to the components of a mean, and of cosine and sine of each order."""
    for harmonic in harmonics:
        for row, part in enumerate((harmonic.cos, harmonic.sin), 2 * harmonic.order - 1):
            rows[row] = tuple(a + b for a, b in zip_longest(rows[row], part, fillvalue=0.0))


@dataclass(frozen=True)
class Load(Table, Periodic):
    """A further load at the excitation's frequency: at a point a force, on an edge a pressure or a
    traction;
    q(t) = mean + cos cos(omega t - phase) + sin sin(omega t - phase).

    An edge is "top", "left" or "right" of a plate, or a curve that a mesh file names. A pressure
    pushes towards the plate.
    """

    FIRST = "loads.1"

    point: Vector | None = vector("", unit="m")
    edge: str | None = holds("'top', 'left', 'right', or a curve of the mesh file", default=None)
    force_sin: Vector | None = vector("f", unit="N")
    force_cos: Vector | None = vector("f", unit="N")
    force_mean: Vector | None = vector("f", unit="N")
    pressure_sin: float | None = number(None, unit="Pa")
    pressure_cos: float | None = number(None, unit="Pa")
    pressure_mean: float | None = number(None, unit="Pa")
    traction_sin: Vector | None = vector("t", unit="Pa")
    traction_cos: Vector | None = vector("t", unit="Pa")
    traction_mean: Vector | None = vector("t", unit="Pa")
    phase: float = number(0.0, unit="degrees")
    """Angle by which its cosine and sine lag."""
    harmonics: tuple[Harmonic, ...] = of_harmonics()
    """Further harmonics, ``[[loads.harmonics]]``, as of the excitation: of the force at a point; on
    an edge of the traction, or with one number of the pressure [Pa]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        forces, pressures, tractions = (self._names(kind) for kind in LOAD_KINDS)
        allowed, others = forces, pressures + tractions
        if self.point is not None:
            self.leave_out(("edge",), "point")
        else:
            self.given("edge", "given, or point: where the load acts")
            allowed, others = others, allowed
        self.leave_out(others, "edge" if self.point is None else "point")
        some = any(getattr(self, name) is not None for name in allowed) or bool(self.harmonics)
        vectors = self.point is None or all(len(one.cos) > 1 for one in self.harmonics)
        self.require(vectors, "harmonics", "vectors at a point: components of a force")
        self.require(some, allowed[-1], f"given, or another of {', '.join(allowed[:-1])}")
        if all(getattr(self, name) is None for name in allowed if not name.endswith("_mean")):
            self.leave_out(("phase",), "a mean load alone")

    @staticmethod
    def _names(kind: str) -> tuple[str, ...]:
        return tuple(f"{kind}_{part}" for part in ("mean", "cos", "sin"))

    def parts(self, kind: str) -> list[Vector]:
        """Mean, and cosine and sine part of each order, of the "force" or the "traction"; of the
        "pressure" (p,); without numbers where they are not given."""
        values = [getattr(self, name) for name in self._names(kind)]
        rows = [v if isinstance(v, tuple) else () if v is None else (v,) for v in values]
        mean, cosine, sine = rows
        c, s = math.cos(math.radians(self.phase)), math.sin(math.radians(self.phase))
        both = list(zip_longest(cosine, sine, fillvalue=0.0))
        first = [tuple(c * a - s * b for a, b in both), tuple(s * a + c * b for a, b in both)]
        rows = [mean, *first, *((),) * (2 * self.highest - 2)]
        scalar = kind == "pressure"
        add_harmonics(rows, tuple(h for h in self.harmonics if (len(h.cos) == 1) == scalar))
        return rows


@dataclass(frozen=True)
class Base(Table, Periodic):
    """A clamp that moves as a whole, as on a shaker: u(t) = cos (omega t) + sin (omega t) parts.

    Given by its acceleration, at the frequency of the excitation; displacements are then relative
    to the clamp. Of a clamp that moves by U it is -omega^2 U.
    """

    acceleration_sin: Vector | None = vector("a", unit="m/s^2")
    acceleration_cos: Vector | None = vector("a", unit="m/s^2")
    harmonics: tuple[Harmonic, ...] = of_harmonics()
    """Further harmonics of the acceleration, ``[[base.harmonics]]``, as of the excitation."""

    def __post_init__(self) -> None:
        super().__post_init__()
        given = (self.acceleration_cos, self.acceleration_sin)
        moving = bool(self.harmonics) or any(any(part) for part in given if part)
        self.require(moving, "acceleration_sin", "given, or acceleration_cos, not zero")

    @property
    def accelerations(self) -> list[Vector]:
        """Cosine and sine part of each order [m/s^2]."""
        parts = (self.acceleration_cos, self.acceleration_sin)
        size = max(len(part) for part in (*parts, *(h.cos for h in self.harmonics)) if part)
        zero = (0.0,) * size
        rows: list[Vector] = [zero] * (2 * self.highest + 1)
        rows[1:3] = [part or zero for part in parts]
        add_harmonics(rows, self.harmonics)
        return rows[1:]

    @property
    def direction(self) -> Vector:
        """(1, 0), (0, 1) or, of a solid, (0, 0, 1): the direction of the largest motion."""
        along = np.abs(self.accelerations).max(axis=0)
        return tuple(np.eye(len(along))[int(np.argmax(along))].tolist())


@dataclass(frozen=True)
class Rotation(Table):
    """The plate is a blade on a rotor, whose axis lies in its plane, parallel to the clamp.

    The radius is hub_radius + y. Vibration in the plane is then along x, parallel to the axis, and
    along the radius: Coriolis forces stand normal to the plane. Those of a solid are left out, and
    remarked where they matter; its axis may have any direction. It goes through the point at
    y = -hub_radius below the middle of a box's clamped face, of a mesh file through (0,
    -hub_radius, 0), or through another point.
    """

    hub_radius: float | None = not_negative(None, unit="m")
    """Radius of the clamp, if it is at y = 0: the axis is at y = -hub_radius."""
    axis: Vector | None = vector("a", of_solid=True)
    """Direction of a solid's axis; left out: x."""
    center: Vector | None = vector("", unit="m", of_solid=True)
    """Of a solid, instead of hub_radius: a point of the axis."""
    speed: float = holds(
        "a finite number >= 0 (0, or 1e-6 to 1e9)",
        lambda w: w == 0 or 1e-6 <= w <= 1e9,
        None,
        unit="rad/s",
    )
    """W, angular velocity of the rotor."""
    rpm: float | None = twin(
        "speed",
        RAD_PER_S_PER_RPM,
        "a finite number >= 0 (0, or 1e-5 to 9e9)",
        lambda w: w == 0 or 1e-5 <= w <= 9e9,
        "rpm",
    )
    """The same in revolutions per minute; one of the two is given."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.given("speed", "given [rad/s], or rotation.rpm: a finite number >= 0")
        if self.center is not None:
            self.leave_out(("hub_radius",), "center")
        self.require(self.axis is None or any(self.axis), "axis", "a vector that is not zero")

    def check_place(self, disk: Disk | None) -> None:
        """Raise InputError unless it is known where the axis is."""
        if disk is not None:
            self.leave_out(("hub_radius", "axis", "center"), "[disk], which has an axis")
        elif self.center is None:
            self.given("hub_radius", "given: a finite number >= 0")

    def place(self, middle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return a point of the axis in space [m] and its direction, of length 1: (3,) each.

        With ``hub_radius`` the axis is below the middle of a box (3,) [m], which has zeros of other
        shapes.
        """
        axis = np.array(self.axis or (1.0, 0.0, 0.0))
        axis_point = middle[0], -(self.hub_radius or 0.0), middle[2]
        return np.array(self.center or axis_point), axis / np.linalg.norm(axis)


@dataclass(frozen=True)
class Disk(Table):
    """A bladed disk: the mesh is that of one sector, and is copied; some of its blades are cracked.

    Sector j + 1 follows sector j in the direction that takes the side ``left`` of a sector to its
    side ``right``, in which the rotor turns. The load acts on every blade, in the directions of the
    blade; of an engine order E that on blade j leads the one on the first by 2 pi E (j - 1) /
    sectors.

    A plate or a solid made here is a blade on a rim: y = 0 of the blade is at the radius
    ``outer_radius`` in the middle of its width, or of a solid of its thickness. The rim is clamped
    at ``inner_radius``; that of a solid is as thick, along x and the axis, as the blade is wide. A
    mesh file of one sector names the sides ``left`` and ``right``, whose nodes match.
    """

    sectors: int = holds("a whole number from 3 to 1000", lambda count: 3 <= count <= 1000)
    cracked: tuple[int, ...] = holds(
        "the number of a sector, from 1, or a list of different ones",
        lambda numbers: min(numbers, default=1) >= 1,
        (1,),
    )
    """Sectors whose crack is one; in the others its faces are bonded."""
    mistuning: tuple[float, ...] | None = holds(
        "a list of numbers above -0.5 and below 1, one for each sector",
        lambda given: all(-0.5 < one < 1.0 for one in given),
        None,
    )
    """Relative deviation of the stiffness of each sector at rest."""
    deviation: float = between("0", "0.1", 0.0)
    """Or its standard deviation in a random pattern of independent normal numbers."""
    seed: int = holds("a whole number >= 0", lambda value: value >= 0, 0)
    """Of that pattern, by NumPy's default generator."""
    families: int = at_least_one(3)
    """Modes of each nodal diameter that are kept: those of the band in which the load vibrates;
    those of four more families, and static answers, assess what they leave out."""
    modes: int = holds("a whole number >= 0", lambda count: count >= 0, 0)
    """How many more modes, those that move the cracks most."""
    inner_radius: float | None = positive(None, unit="m")
    """Where the rim is clamped."""
    outer_radius: float | None = positive(None, unit="m")
    """Of the rim."""
    center: Vector | None = vector("", unit="m")
    """Of a mesh file: a point of the axis; default: the origin."""
    axis: Vector | None = vector("a", of_solid=True)
    """Of a mesh file of a solid: direction of the axis; default: x."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require(max(self.cracked, default=1) <= self.sectors, "cracked",
                     f"numbers of sectors, from 1 to disk.sectors = {self.sectors}")  # fmt: skip
        if self.mistuning is not None:
            allowed = f"one number for each of the {self.sectors} sectors"
            self.require(len(self.mistuning) == self.sectors, "mistuning", allowed)
            self.leave_out(("deviation", "seed"), "disk.mistuning")
        self.require(self.axis is None or any(self.axis), "axis", "a vector that is not zero")

    @property
    def deviations(self) -> np.ndarray:
        """Relative deviation of each sector's stiffness: (sectors,)."""
        if self.mistuning is not None:
            return np.array(self.mistuning)
        return np.random.default_rng(self.seed).normal(0.0, self.deviation, self.sectors)


@dataclass(frozen=True)
class Contact(Table):
    """Contact between the crack faces, pair by pair of nodes."""

    stiffness: float | None = positive(None, unit="N/m")
    """Penalty stiffness k of one pair; or give it per area."""
    stiffness_per_area: float | None = positive(None, unit="N/m^3")
    """Penalty stiffness per area of the crack face: independent of the mesh."""
    law: str = choice("penalty", "smoothed", "unilateral", default="penalty")
    """"unilateral": no penetration."""
    sharpness: float | None = positive(None, unit="1/m")
    """s of the smoothed law."""
    friction: float | None = not_negative(None)
    """Coefficient of Coulomb friction between the faces of a plate's cracks, at rest and in
    motion. Left out: 0, and what friction would change is stated."""
    friction_error: float | bool = holds(
        "a finite number > 0, or false", lambda mu: mu is False or mu > 0, 0.3
    )
    """Coefficient whose effect is stated among the errors where contact.friction is left out;
    false: it is not."""
    tangential_stiffness_per_area: float | None = positive(None, unit="N/m^3")
    """Stiffness of pairs that stick, per area of the crack face. Left out: infinite, of crack faces
    without mass."""
    pairs: str = choice("all", "mouth", default="all")
    """Every pair of crack-face nodes, or as many as mesh.patches; or of each crack only the one at
    the mouth, or in the middle of a crack inside the plate."""

    def __post_init__(self) -> None:
        super().__post_init__()
        law = f"law = {self.law!r}"
        if self.law == "unilateral":
            self.leave_out(("stiffness", "stiffness_per_area"), law)
        else:
            one = (self.stiffness is None) != (self.stiffness_per_area is None)
            self.require(one, "stiffness", f"given, or contact.stiffness_per_area, with {law}")
        if self.law == "smoothed":
            self.given("sharpness", f"given with {law}")
        else:
            self.leave_out(("sharpness",), law)
        if not self.friction:
            self.leave_out(("tangential_stiffness_per_area",), "contact.friction = 0")
        elif not self.is_unilateral:
            self.require(False, "friction", f"0, or left out, with {law}")

    @property
    def is_unilateral(self) -> bool:
        """True if a pair is open or closed and nothing between; forces of other laws are not
        proportional to gaps."""
        return self.law in ("penalty", "unilateral")


@dataclass(frozen=True)
class HarmonicBalance(Table):
    """Truncation of the Fourier series and sampling of the contact force."""

    harmonics: int = at_least_one(None)
    """H of plain harmonic balance; with a tolerance, the fewest of a solution. Default: 5."""
    samples: int | None = at_least_one(None)
    """Instants per period at which contact is evaluated; chosen by the solver when left out."""
    tolerance: float | None = positive(None)
    """Find the exact orbit, and keep so many of its harmonics, and modes, that the error stays
    below this; a curve is one of exact orbits. Default: 0.01, but none where harmonics or samples
    are given, or no error is requested."""
    form: str = choice("condensed", "block", default="condensed")
    """Unknowns of ``solve``: the gaps of the crack faces, or with "block" all displacements, by
    PETSc's SNES, which takes longer and needs a given number of harmonics. Nothing else changes."""
    error: bool = holds("true or false", default=True)
    """false: neither the error nor the stability of solutions is found, which takes longer than the
    solution itself where there are many pairs or modes."""

    def __post_init__(self) -> None:
        super().__post_init__()
        chosen = {"harmonics": 5, "tolerance": DEFAULT_ERROR_TOLERANCE}
        if self.harmonics is not None or self.samples is not None or not self.error:
            del chosen["tolerance"]
        if self.form == "block":
            self.leave_out(("tolerance",), "form = 'block'")
            chosen.pop("tolerance", None)
        follow = {key for key in chosen if getattr(self, key) is None}
        vars(self).update({key: chosen[key] for key in follow}, _follow=follow)
        if self.tolerance is not None:
            self.leave_out(("samples",), "a tolerance")
            self.require(self.error, "error", "true, or left out, with a tolerance")
        least = 4 * self.harmonics + 1
        fits = self.samples is None or least <= self.samples <= MAX_SAMPLES_PER_PERIOD
        allowed = f"a whole number from {least} (4 harmonics + 1) to "
        allowed += f"{MAX_SAMPLES_PER_PERIOD}, or left out"
        self.require(fits, "samples", allowed)

    def of_load(self, highest: int) -> HarmonicBalance:
        """The same with as many harmonics as a load has, unless fewer are given."""
        least = f"a whole number >= {highest}, the highest order of the load"
        fits = self.harmonics >= highest
        self.require(fits or "harmonics" in self.derived, "harmonics", least)
        return self if fits else self.with_values(harmonics=highest)


@dataclass(frozen=True)
class Mesh(Table):
    """Mesh of the plate.

    ``layout = "grid"``: columns x rows equal quadrilaterals (or twice as many triangles); the crack
    must run along grid lines. ``"graded"``: element size ``size`` away from the crack,
    ``lip_elements`` along each face, the one at the tip ``grading`` times shorter than the one at
    the mouth; along a crack inside half of them from its middle to each tip. Where cracks are above
    one another, crack faces may get more. The sector of a disk is meshed by triangles, graded
    towards the corners between blade and rim, too. ``"file"``: any gmsh mesh of a plane region
    whose physical groups are named ``clamp``, ``lower_lip`` and ``upper_lip`` or ``crack``
    (curves), ``load`` (a point) and, for the region itself, anything.

    A solid is meshed by tetrahedra of order 2, ``"graded"`` towards the fronts of its cracks; a
    file names surfaces, ``clamp`` and ``crack``.
    """

    layout: str = choice("grid", "graded", "file")
    """As above."""
    cells: str = choice("triangle", "quadrilateral", default="quadrilateral")
    """Cells of a plate; a mesh file and a graded sector have their own."""
    order: int = holds("1 or 2", lambda value: value in (1, 2), default=None)
    """Polynomial order of the displacement; default: 1, of a solid 2."""
    columns: int | None = at_least_one(None)
    """Columns of a grid."""
    rows: int | None = at_least_one(None)
    """Rows of a grid."""
    size: float | None = positive(None, unit="m")
    lip_elements: int | None = at_least_one(None)
    """Elements of a graded mesh along each crack face."""
    grading: float = between("1", "1e+06", 4.0)
    """Size of elements of a graded mesh at the mouth over that at the crack tip."""
    file: str | None = path("the path of a .msh file")
    """Beside the scene's file, or with its whole path."""
    coarser: str | None = path("the path of a .msh file")
    """The same part with fewer elements, for the errors due to those of ``file``."""
    per_turn: int = holds("a whole number from 4 to 200", lambda count: 4 <= count <= 200, 12)
    """Elements on a full turn of a curved face of a part."""
    patches: int | None = at_least_one(None)
    """Contact pairs of each crack, at most: means over several nodes, where the mesh is finer than
    contact needs. Default: all nodes; of a solid all corners of elements."""
    error: bool = holds("true or false", default=True)
    """true: a coarser mesh gives the error of each number due to this one."""

    def __post_init__(self) -> None:
        super().__post_init__()
        keys = {
            "grid": ("columns", "rows"),
            "graded": ("size", "lip_elements", "grading", "per_turn"),
            "file": ("file", "coarser"),
        }
        given = keys.pop(self.layout)
        for others in keys.values():
            self.leave_out(others, f"layout = {self.layout!r}")
        for key in given:
            if key not in ("lip_elements", "coarser"):  # an uncracked plate has no crack faces
                self.given(key, f"given with layout = {self.layout!r}")
        if self.layout == "file":
            self.leave_out(("cells",), "layout = 'file', whose mesh has its own")

    def with_vectors(self, dimension: int) -> Mesh:
        """The same in a plane or in space, of the order that is usual there."""
        order = self.order or dimension - 1
        return self.with_values(order=order, _follow={"order"} if order == 1 else set())


@dataclass(frozen=True)
class Structure(Table):
    """Matrices from elsewhere, in files beside the scene, instead of a plate.

    M u'' + C u' + K u + B lambda(g) = f(t), g = B^T u - g0. The tables [geometry], [material],
    [mesh], [crack] and [base] are then left out. Matrices are in Matrix Market files, or in those
    of CalculiX (.sti, .mas), Abaqus (.mtx) or Nastran (.pch, .op4); columns in Matrix Market files.
    With the model that they are of, the load may act at excitation.point, and where there is
    contact without a file of the gaps, the pairs are found.
    """

    mass: str = path("the path of a file: (n, n)", MISSING)
    """[kg]"""
    stiffness: str = path("the path of a file: (n, n)", MISSING)
    """[N/m]"""
    model: str | None = path("the path of the input file of the program that made the matrices")
    """Nodes and elements: of CalculiX or Abaqus (.inp), Nastran (.bdf, .dat, .nas), Ansys (.cdb),
    or a table of node, x, y, z [m] between commas."""
    dofs: str | None = path("the path of a file: node and direction of each row")
    """For Matrix Market files with a model: "12.3" or "7 12 UZ" on each line; of CalculiX the .dof
    beside the stiffness where it is left out."""
    gap: str | None = path("the path of a file: (n, n_pairs)")
    """B, which makes the gaps of the contact pairs of the displacements; left out: none, or those
    of the model."""
    tangential: str | None = path("the path of a file: (n, n_pairs)")
    """B_t of the tangential gaps, for friction."""
    damping: str | None = path("the path of a file: (n, n)")
    """C [N s/m]; or the table [damping]."""
    force_sin: str | None = path("the path of a Matrix Market file: (n, 1), or more columns")
    """[N]; column k has k times the load's frequency. Or the force of [excitation] at its point."""
    force_cos: str | None = path("the path of a Matrix Market file: (n, 1), or more columns")
    force_mean: str | None = path("the path of a Matrix Market file: (n, 1)")
    clearance: float | str = path(
        f"a finite number {OR_ZERO}, or the path of a Matrix Market file: (n_pairs, 1)", 0.0, "m"
    )
    """g0 of all pairs, or of each; < 0: preload."""
    areas: str | None = path("the path of a Matrix Market file: (n_pairs, 1)")
    """Area of each pair [m^2], for stiffnesses per area; those of the model's pairs are known."""

    def __post_init__(self) -> None:
        super().__post_init__()
        moved = any((self.force_sin, self.force_cos, self.force_mean, self.model))
        self.require(moved, "force_sin", "given, or force_cos or force_mean: what moves it")


@dataclass(frozen=True)
class Reduction(Table):
    """Reduction of the structure before it is solved (``reduce_structure``).

    Without this table a structure of up to 100 dofs is solved as it is, and a larger one is reduced
    with the default basis. ``reduction = "off"`` is short for ``reduction.method = "off"``.
    """

    WORD = "method"

    method: str | None = choice("massless", "free_interface", "off", default=None)
    """Default: "massless" (modes, and crack faces without mass) with contact, unless all modes are
    kept; without contact "free_interface"."""
    modes: int | None = at_least_one(None)
    """Lowest modes to keep. Default: with a tolerance few that meet it, else those that are damped,
    but 50 where all are."""


@dataclass(frozen=True)
class Curve(Table):
    """A response curve, followed through its folds by continuation."""

    start: float = number()
    """As ``stop``."""
    stop: float = number()
    """Of the parameter: load frequencies [rad/s] or, with "frequency", [Hz]; factors of load,
    stiffness, damping or friction; clearances added [m]; or, with an engine order, speeds of the
    rotor [rad/s] or, with "rpm", in revolutions per minute."""
    parameter: str = choice(
        "omega", "frequency", "load", "stiffness", "damping", "clearance", "friction", "speed",
        "rpm", default="omega",
    )  # fmt: skip
    """Parameter that changes along the curve."""
    at: str | None = choice("resonance", default=None)
    """With "load": follow the resonance next to the load's frequency over the load but its mean,
    the backbone of a forced and damped vibration; of a bladed disk that of the watched blade."""
    stability: bool = holds("true or false", default=True)
    """Floquet multipliers and period doublings along the curve."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require(self.start != self.stop, "stop", f"other than curve.start = {self.start:g}")
        if self.at is not None:
            self.require(self.parameter == "load", "at", "left out, or curve.parameter = 'load'")
        positive_ones = "omega", "frequency", "stiffness", "friction", "speed", "rpm"
        if self.parameter in positive_ones or self.at is not None:
            least = max(1e-12 * max(self.start, self.stop), 0.0)  # else rounding takes it to 0
            for name in ("start", "stop"):
                allowed = f"a number > 0 with curve.parameter = {self.parameter!r}"
                allowed += ", and 1e-12 of the other end" * (getattr(self, name) > 0.0)
                self.require(getattr(self, name) > least, name, allowed)

    @property
    def followed(self) -> tuple[str, float, float]:
        """The parameter of the equations, and its ends: "omega" and "speed" in rad/s where Hz or
        revolutions per minute are given; "resonance" over the load at resonance."""
        if self.parameter == "rpm":
            return "speed", RAD_PER_S_PER_RPM * self.start, RAD_PER_S_PER_RPM * self.stop
        if self.parameter == "frequency":
            return "omega", RAD_PER_TURN * self.start, RAD_PER_TURN * self.stop
        return self.at or self.parameter, self.start, self.stop


@dataclass(frozen=True)
class Integration(Table):
    """Direct integration in time: from rest, from the end of an earlier motion, or from a static
    deflection; under the load, or as a free decay."""

    method: str | None = choice("exponential", "central_difference", "events", default=None)
    """"events": exact from one switching instant to the next. Default: "exponential" where crack
    faces have no mass, else "central_difference"."""
    periods: int = at_least_one(600)
    """Maximum load periods."""
    settle: float = positive(1e-4)
    """Relative change from one period to the next at which to stop, of the gaps and of the
    displacement where the load acts, relative to what moves. The distance from the settled motion
    is reported; its mean and its higher harmonics, mostly below a thousandth of the first,
    show it most."""
    steps_per_period: int | None = at_least_one(None)
    """Default: 512; at least twice what is stable (central differences), 256 (events)."""
    initial: str | None = path("the path of the .h5 file of a solution or an integration")
    """Start at a solution's displacement and velocity at phase 0 of its load, or at those at the
    end of an integration, of the same mesh; under the scene's load."""
    deflection: float | None = positive(None)
    """Start at rest from the static deflection, with contact, under the mean load and so many times
    the sum of its cosine and sine parts."""
    free: bool = holds("true or false", default=False)
    """Free decay: the mean load acts alone. All periods are recorded."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.initial is not None:
            self.leave_out(("deflection",), "initial")


@dataclass(frozen=True)
class Sweep(Table):
    """Many cases: all combinations of the values of some keys of the scene.

    For example::

        [sweep.over]
        "excitation.omega" = { start = 1000.0, stop = 4000.0, count = 61 }
        "crack.length" = [0.02, 0.03, 0.04]
    """

    over: tuple[Axis, ...] = holds(
        "a table of keys of the scene and the values that they take", lambda value: value
    )
    """Keys with a list of values, or start, stop, count and ``spacing = "logarithmic"``."""
    at_resonance: bool = holds("true or false", default=False)
    """Solve each case at its own resonance, the one nearest to the excitation's frequency."""

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
    """Growth of a crack by fatigue, for ``fenics-crack grow``: in a cycle by

        rate sum_i (delta_K_i / ((1 - R_i)^(1 - ratio_exponent) 1 MPa m^0.5))^exponent

    over the cycles of K_I in one of the load, the ranges those of an open tip and
    R = max(K_min, 0) / K_max (Paris and Erdogan 1963; Walker 1970)."""

    until: float = positive(unit="m")
    """Length at which the growth ends, from ``crack.length`` on; of a half-ellipse the depth, from
    ``crack.depth`` on."""
    rate: float = positive(unit="m")
    """In a cycle, at an effective range of 1 MPa m^0.5 with R = 0."""
    exponent: float = between("0.1", "50", MISSING)
    """Exponent m."""
    ratio_exponent: float = between("0", "1", 1.0)
    """Walker's gamma; 1: the ratio does not matter but by closure, which is that of the crack
    faces."""
    threshold: float = not_negative(0.0, unit="Pa m^0.5")
    """Effective range below which the crack does not grow."""
    toughness: float | None = positive(None, unit="Pa m^0.5")
    """K_max at which the plate breaks."""
    drive: str = choice("frequency", "resonance", "spectrum", default="frequency")
    """The load keeps the excitation's frequency, follows the largest response, or passes
    through the ``frequencies`` again and again."""
    frequencies: tuple[float, ...] | None = holds(
        "a list of different numbers > 0",
        lambda given: len(set(given)) == len(given) > 0 and min(given) > 0.0,
        None,
        unit="Hz",
    )
    """Of the load in a spectrum."""
    cycles: tuple[float, ...] | None = holds(
        "a list of numbers > 0", lambda given: len(given) > 0 and min(given) > 0.0, None
    )
    """Of the load at each of the frequencies, in one repeat."""
    rate_deviation: float = between("0", "10", 0.0)
    """Relative standard deviation of the rate."""
    exponent_deviation: float = between("0", "10", 0.0)
    """Standard deviation of the exponent, the rate at 1 MPa m^0.5 being the same."""
    life_tolerance: float = between("1e-6", "1", 0.01)
    """Relative error of the number of cycles, by interpolation between the lengths that are
    solved."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.drive != "spectrum":
            self.leave_out(("frequencies", "cycles"), f"drive = {self.drive!r}")
            return
        for key in ("frequencies", "cycles"):
            self.given(key, "given with drive = 'spectrum': frequencies and cycles of the load")
        same = len(self.cycles or ()) == len(self.frequencies or ())
        self.require(same, "cycles", "as many numbers as there are frequencies")

    @property
    def repeat(self) -> tuple[float, float] | None:
        """Cycles of the load in one repeat of the spectrum, and how long it takes [s]; None without
        one."""
        if self.cycles is None or self.frequencies is None:
            return None
        lasting = sum(n / f for n, f in zip(self.cycles, self.frequencies, strict=True))
        return sum(self.cycles), lasting


@dataclass(frozen=True)
class Identify(Table):
    """Unknowns to be found from measurements, and their ranges.

    For example::

        [identify.unknown]
        "crack.length" = { start = 0.003, stop = 0.045, count = 8 }
        "crack.height" = { start = 0.02, stop = 0.2, count = 10 }

    or, with meshes of one's own::

        [identify.meshes]
        "blade_05.msh" = { "crack.length" = 0.005 }
        "blade_10.msh" = { "crack.length" = 0.010 }
        "blade_15.msh" = { "crack.length" = 0.015 }
        "blade_20.msh" = { "crack.length" = 0.020 }
    """

    unknown: tuple[Axis, ...] = holds(
        "a table of keys of the scene and the values between which they are looked for", default=()
    )
    """Keys with at least 4 numbers in ascending order, at which the forward model is solved, or
    start, stop, count and ``spacing = "logarithmic"``; or words: ``"crack.edge" = ["left",
    "right"]``. May be left out with ``meshes``."""
    meshes: tuple[MeshFile, ...] = holds(
        'a table of .msh files and their numbers, "blade_05.msh" = { "crack.length" = 0.005 }',
        default=(),
    )
    """Meshes of the structure with its crack, for ``mesh.layout = "file"``, and what is unknown of
    each: keys of the crack, or words of one's own for other numbers; at least 4 values of each, and
    a mesh for every combination."""
    uncracked: str | None = path("the path of a .msh file")
    """Mesh of the same structure without its crack, where it is read from a file."""
    frequencies: tuple[float, ...] = holds(
        "a list of finite numbers > 0", lambda values: min(values, default=1.0) > 0, ()
    )
    """Further load frequencies at which measuring is considered [Hz]."""
    finer: float = between("0.25", "4", 0.5)
    """How much finer the mesh is, and how many more harmonics there are, in the few cases that
    correct the model and give its error; 1: neither. Below 1 these few have the scene's own mesh,
    and the others one that is coarser: 0.5 has elements twice as long."""
    harmonic_deviation: float = between("0", "1", 0.05)
    """Least standard deviation of the computed second harmonic of the crack, over its value, and of
    the k-th k - 1 times as much: contact on a coarse mesh makes them uneven, and all of them
    together too large or too small."""
    young_deviation: float = between("0", "1", 0.03)
    """Standard deviations of what the scene says, over its value, and of the model: Young's
    modulus. That of structural steel: JCSS, Probabilistic Model Code, part 3.2, 2001."""
    density_deviation: float = between("0", "1", 0.01)
    """Density: the same, part 2.1."""
    thickness_deviation: float = between("0", "1", 0.01)
    """Thickness, which changes amplitudes: 0.2 mm of 10 mm (ISO 2768-1, medium) at most."""
    clamp_deviation: float = between("0", "1", 0.01)
    """What a soft clamp may take from the first natural frequency, over that. A beam that grows out
    of an elastic body as thick as itself is as if longer by 0.44 of its depth (W. J. O'Donnell,
    Journal of Applied Mechanics 27, 1960, 461), and loses 6 % if 15 times as long as deep: jaws
    are some times stiffer."""
    before_deviation: float = between("0", "1", 0.002)
    """What the clamp takes from the first natural frequency before there was a crack against what
    it takes since: one that was opened holds otherwise. Likewise what rotation adds, by the seat of
    a blade or the measured speed. Temperatures have keys of their own."""
    before_scatter: float = between("0", "1", 0.2)
    """Part of that change that each mode has by itself. Of plates clamped deeper, let go at an end
    of the clamp or on an elastic block, turning, moving and a common change leave up to 0.05 of the
    largest change if 15 times as tall as wide, 0.07 if five times, 0.12 if three, 0.18 if two and
    0.29 if square (benchmarks/identification_limits.py)."""
    temperature_deviation: float | None = holds(
        "a number from 0 to 1000", lambda value: 0.0 <= value <= 1000.0, None, unit="K"
    )
    """Temperature since there was a crack against before, where measurements do not state it.
    Default: 10 K at rest, which takes 0.2 % from all natural frequencies, and 25 K of a rotor,
    whose blades their gas or their drag warms (engineering judgement); 0: the same."""
    temperature_coefficient: float = between("-0.01", "0.01", -4e-4, unit="1/K")
    """Relative change of Young's modulus by a kelvin: of steel -2.6e-4 to -3e-4, of aluminium and
    titanium -5e-4 to -6e-4 at room temperature, of all more where they are hot."""
    coefficient_deviation: float = between("0", "1", 0.3)
    """Standard deviation of that, over its value, where temperatures are stated; of a metal whose
    coefficient is known 0.1."""
    thermometer_deviation: float = between("0", "100", 1.0, unit="K")
    """Standard deviation of the difference of the temperatures that are stated, before and since:
    of a thermocouple of class 1 (IEC 60584-1: 1.5 K) at the blade or its root."""
    damping_deviation: float = between("0", "10", 0.3)
    """Ratio of damping: of joints and air, it differs by so much between assemblies."""
    stiffening_deviation: float = between("0", "1", 0.05)
    """What rotation adds to the square of a natural frequency: beams and plates differ by so much
    in it."""
    angle_deviation: float = between("0", "45", 5.0, unit="degrees")
    """Angle of a crack with the horizontal, which moves its tip from the height of its mouth."""
    model_deviation: float = between("0", "1", 0.01)
    """Each natural frequency, the same with the crack and without it: models of spacecraft are to
    meet measured ones to 5 % (NASA-STD-5002), and the ratio of the first two of a plain beam is
    2 % off (docs/notebook/measured_beams.md)."""
    first_resonance_deviation: float = between("0", "1", 0.04)
    """Resonance of mode 1 with a breathing crack less the bilinear frequency, over the difference
    between the frequencies with the crack bonded and open (docs/identification.md)."""
    resonance_deviation: float = between("0", "1", 0.3)
    """The same of other modes, whose neighbours open and close the crack, too, and of a crack that
    is open for any part of the period; 12^-1/2 is that of a uniform distribution."""
    crack_deviation: float = between("0", "1", 0.15)
    """What a crack changes: two compliances in wide use, of the same crack from 0.1 to 0.3 of the
    depth, differ by 25 to 29 % (W. M. Ostachowicz and M. Krawczuk, Journal of Sound and Vibration
    150, 1991, 191; P. F. Rizos, N. Aspragathos and A. D. Dimarogonas, 138, 1990, 381); half of
    that. A slot changes more than a crack (P. Cawley and R. Ray, Journal of Vibration and
    Acoustics 110, 1988, 366)."""
    crack_correlation: float = between("0", "1", 0.9)
    """Correlation of that between modes, 1 for a compliance that is common to all."""
    confidence: float = between("0.5", "0.9999", 0.95)
    """Probability of the regions and intervals that are reported. A hypothesis explains the
    measurements where the p-value of chi^2 is at least one minus that."""
    log_bayes_factor: float = between("0", "1000", 3.0)
    """Logarithm of the ratio of evidences beyond which a hypothesis is preferred: 20 to 1."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.unknown and not self.meshes:
            allowed = f"given: {self.keys()['unknown'].metadata['allowed']}"
            raise InputError("identify.unknown", None, allowed)
        self._check_meshes()
        for axis in self.unknown:
            words = [isinstance(value, str) for value in axis.values]
            numbers = not any(words) and len(axis.values) >= MIN_VALUES
            if not (all(words) or (numbers and np.all(np.diff(axis.values) > 0))):
                allowed = f"words, or {MIN_VALUES} or more numbers in ascending order"
                raise InputError(f'identify.unknown."{axis.key}"', axis.values, allowed)

    def _check_meshes(self) -> None:
        """Raise InputError unless there is one mesh for every combination of enough numbers."""
        metres = [key for key, item in Crack.keys().items() if item.metadata["unit"] == "m"]
        named = {*map(Crack.name_of, metres)} - {axis.key for axis in self.unknown}
        for mesh in self.meshes:
            key, names = f'identify.meshes."{mesh.key}"', [name for name, _ in mesh.values]
            if not names or set(names) != {name for name, _ in self.meshes[0].values}:
                raise InputError(key, names, "the same numbers as of the others, one or more")
            for name in names:
                if not (name in named or name.isidentifier()):
                    allowed = f"a word, or one of {', '.join(sorted(named))}"
                    raise InputError(key, name, allowed)
        axes = self.mesh_axes
        for axis in axes:
            if len(axis.values) < MIN_VALUES:
                allowed = f"{MIN_VALUES} or more different ones"
                raise InputError(f"identify.meshes, {axis.key}", axis.values, allowed)
        there = Counter(tuple(dict(mesh.values)[a.key] for a in axes) for mesh in self.meshes)
        every = itertools.product(*(axis.values for axis in axes))
        for wanted in every if there else ():
            if (count := there[wanted]) != 1:
                pairs = zip(axes, wanted, strict=True)
                of = ", ".join(f"{axis.key} = {value:g}" for axis, value in pairs)
                allowed = "one mesh for every combination of its numbers"
                raise InputError("identify.meshes", f"{count or 'no'} files of {of}", allowed)

    @property
    def mesh_axes(self) -> tuple[Axis, ...]:
        """The numbers of the meshes, in ascending order, by their names."""
        names = [name for name, _ in self.meshes[0].values] if self.meshes else []
        values = {name: {dict(mesh.values)[name] for mesh in self.meshes} for name in names}
        return tuple(Axis(name, tuple(sorted(found))) for name, found in values.items())

    @property
    def mesh_files(self) -> tuple[str, ...]:
        """The meshes by their numbers, those of the last name fastest."""
        names = [axis.key for axis in self.mesh_axes]
        ordered = sorted(self.meshes, key=lambda one: [dict(one.values)[name] for name in names])
        return tuple(one.key for one in ordered)

    @property
    def priors(self) -> dict[str, Any]:
        """Priors and levels by their keys: all that does not define the forward model."""
        forward = {"unknown", "meshes", "uncracked", "frequencies", "finer"}
        return {key: getattr(self, key) for key in self.keys() if key not in forward}


@dataclass(frozen=True)
class TipTiming(Table):
    """Probes in the casing that see when the tip of a blade passes, and what is sought in that.

    [tip_timing]
    probes = [0.0, 17.0, 41.0, 58.0, 86.0, 113.0, 140.0, 178.0, 205.0, 251.0, 288.0, 330.0]
    tip_radius = 0.45
    """

    probes: tuple[float, ...] = holds(
        "a list of rising angles in degrees, from 0 to less than 360",
        lambda angles: (
            angles and 0.0 <= angles[0] and angles[-1] < 360.0 and bool(np.all(np.diff(angles) > 0))
        ),
    )
    """Angles of the probes [degrees], from the tip's place at a mark on the shaft, in the direction
    of rotation."""
    tip_radius: float = positive(unit="m")
    """Distance of the tip from the axis."""
    tangential: float | None = holds(
        f"a finite number other than 0 {OR_ZERO}", lambda share: share != 0.0, None
    )
    """Displacement of the tip in the direction of rotation over the one that is watched first (the
    load's, or that of the first of [output.points]): sin of the stagger; < 0: against it. Default:
    1; of a solid with [rotation] the circumferential motion of that node about the axis, which for
    identify has to be along x, y or z."""
    order: int | None = at_least_one(None)
    """Periods of the load in a revolution, without [rotation]."""
    revolutions: int = at_least_one(100)
    """Number of revolutions computed; of a run-up all together."""
    noise: float = not_negative(0.0, unit="s")
    """Standard deviation of normal errors of the computed arrivals."""
    clock: float = not_negative(0.0, unit="s")
    """Resolution of the computed arrivals; 0: none."""
    seed: int = holds("a whole number >= 0", lambda value: value >= 0, 0)
    """Seed of the noise."""
    angle_deviation: float = not_negative(0.0, unit="degrees")
    """Standard deviation of the probes' angles, the same in every revolution."""
    orders: tuple[float, ...] | None = holds(
        "a list of different whole numbers >= 1",
        lambda orders: (
            orders
            and all(order >= 1.0 and order % 1.0 == 0.0 for order in orders)
            and len(set(orders)) == len(orders)
        ),
        None,
    )
    """Engine orders that may be in the arrivals; default: the load's, or 1 to 24 where it is not
    known. Of a computed run-up it is known."""
    stiffening: float | None = between("-0.9", "0.9", None)
    """Of the resonances that a measured run-up passes: relative change of their natural frequencies
    for one of the speed, d ln f / d ln n, on which their damping depends. Default: with [rotation]
    that of each by the scene's Campbell diagram, else 0."""
    frequencies: tuple[float, ...] | None = holds(
        "two finite numbers > 0, the second one larger",
        lambda ends: len(ends) == 2 and 0.0 < ends[0] < ends[1],
        None,
    )
    """Instead of engine orders, at a speed that is held: ends of a range in which a frequency is
    sought that need be no multiple of the speed [Hz]."""
    fitted_harmonics: int = at_least_one(2)
    """Harmonics that are fitted; 2 or more show a breathing crack."""
    subharmonic: int = at_least_one(1)
    """2: the vibration has twice the load's period; the harmonics are those of half the load's
    frequency."""
    fitted_revolutions: int = at_least_one(1)
    """Revolutions of a run-up that are fitted together."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.frequencies is not None:
            self.require(self.subharmonic == 1, "subharmonic", "1 with tip_timing.frequencies")
            self.leave_out(("orders",), "tip_timing.frequencies")


@dataclass(frozen=True)
class Output(Table):
    """Printed and drawn quantities, and the points where the motion is watched.

    [output]
    quantities = ["amplitude", "ratio_2_1"]
    [output.points]
    tip = [0.1, 0.1]
    """

    quantities: tuple[str, ...] | None = holds(
        f"a list of some of {', '.join(OBSERVABLES_BY_NAME)}",
        lambda names: names and set(names) <= OBSERVABLES_BY_NAME.keys(),
        None,
    )
    """Default: a few of them. Files have them all."""
    points: tuple[Point, ...] = holds(
        "a table of points: a name of letters, digits and _, and [x, y], or [x, y, z] of a solid, "
        f"finite numbers; {MOST_POINTS} of them at most",
        lambda points: (
            len(points) <= MOST_POINTS
            and all(re.fullmatch(r"[A-Za-z]\w{0,29}", point.key, re.A) for point in points)
        ),
        (),
    )
    """[m]; the nearest node of each is watched in x and y. Default: the dof with most of the load.
    """
