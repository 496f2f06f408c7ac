"""The scene: everything that defines a computation, validated, frozen, in SI units.

A scene is a TOML file (see ``demos/paper_plate.toml``) or a tree of the dataclasses below. Every
key states here, once, what it may hold; a value outside of that raises :class:`InputError` with
the key, the value and what is allowed, before anything is computed.
"""

from __future__ import annotations

import dataclasses
import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np

from fenics_crack.errors import MAX_SAMPLES, InputError, check_two_ratios
from fenics_crack.scene.fields import (
    OR_ZERO,
    Axis,
    Table,
    Vector,
    at_least_one,
    choice,
    holds,
    positive,
)

__all__ = [
    "Contact",
    "Crack",
    "Curve",
    "Damping",
    "Excitation",
    "Geometry",
    "HarmonicBalance",
    "Integration",
    "Material",
    "Mesh",
    "Reduction",
    "Scene",
    "Sweep",
]

EXTENT = "a number from 1e-6 to 1e6"
NUMBER = f"a finite number {OR_ZERO}"
NOT_NEGATIVE = f"a finite number >= 0 {OR_ZERO}"
FORCE = f"[fx, fy], two finite numbers {OR_ZERO}"
STEEPEST, THINNEST = 1e6, 1e4
"""Largest ``mesh.grading``, and largest ratio of the plate's sides."""
NEAREST = 1e-4
"""Least distance of the crack and its tip from the edges, relative to the plate's side."""

# --- the tables -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Geometry(Table):
    """Rectangle [0, width] x [0, height], clamped along y = 0; a mesh file has its own shape."""

    thickness: float = positive()
    """[m]"""
    width: float | None = holds(EXTENT, lambda value: 1e-6 <= value <= 1e6, None)
    """[m]"""
    height: float | None = holds(EXTENT, lambda value: 1e-6 <= value <= 1e6, None)
    """[m]"""


@dataclass(frozen=True)
class Crack(Table):
    """Straight horizontal edge crack: a slit whose two lips share only the tip."""

    edge: str | None = choice("left", "right", default=None)
    """Edge of the plate at the crack's mouth."""
    height: float | None = positive(None)
    """y of the crack [m]."""
    length: float | None = positive(None)
    """[m]; or let ``first_omega`` determine it."""
    first_omega: float | None = positive(None)
    """First natural frequency with the crack open [rad/s], from which the length is found."""
    clearance: float = holds(NUMBER, default=0.0)
    """g0 >= 0: opening that closes before the lips touch; < 0: preload [m]."""


@dataclass(frozen=True)
class Material(Table):
    """Isotropic linear elastic."""

    young: float = positive()
    """Young's modulus E [Pa]."""
    poisson: float = holds("a finite number with -1 < nu < 0.5", lambda nu: -1.0 < nu < 0.5)
    """Poisson's ratio [-]."""
    density: float = positive()
    """[kg/m^3]"""


@dataclass(frozen=True)
class Damping(Table):
    """Modal or Rayleigh damping, given in one of three ways.

    Modal: ``ratio``, xi_j of critical damping, for each of the lowest ``modes``. With ``modes =
    "all"`` and one ratio, all coordinates of a reduced structure are damped.

    Rayleigh, C = mass M + stiffness K: ``mass`` and ``stiffness``, or one of them; or ``ratios``,
    the ratios of damping at the two frequencies ``omegas``.
    """

    ratio: float | tuple[float, ...] | None = holds(
        "a number from 0 to 1 (0.02 for 2 %), or a list of them, one per mode",
        lambda ratio: np.min(ratio) >= 0 and np.max(ratio) <= 1,
        None,
    )
    modes: int | str = holds(
        "'all' or a whole number >= 1", lambda value: value == "all" or value >= 1, "all"
    )
    mass: float | None = holds(NOT_NEGATIVE, lambda value: value >= 0, None)
    """[1/s]"""
    stiffness: float | None = holds(NOT_NEGATIVE, lambda value: value >= 0, None)
    """[s]"""
    ratios: Vector | None = holds(
        "[xi_1, xi_2], two numbers from 0 to 1",
        lambda ratios: min(ratios) >= 0 and max(ratios) <= 1,
        None,
    )
    omegas: Vector | None = holds(
        "[omega_1, omega_2], two different numbers > 0",
        lambda omegas: min(omegas) > 0 and omegas[0] != omegas[1],
        None,
    )
    """[rad/s]"""

    def __post_init__(self) -> None:
        super().__post_init__()
        ways = [("ratio",), ("mass", "stiffness"), ("ratios", "omegas")]
        found = [(way, key) for way in ways for key in way if getattr(self, key) is not None]
        allowed = "given, or damping.mass or damping.stiffness, or damping.ratios with omegas"
        self.require(bool(found), "ratio", allowed)
        (chosen, key), *_ = found
        for way in ways:
            if way is not chosen:
                self.leave_out(way, f"{key} = {getattr(self, key)}")
        if self.ratio is None:
            self.require(self.modes == "all", "modes", f"left out with {key}: all are damped")
        elif isinstance(self.ratio, tuple):
            fits = self.modes in ("all", len(self.ratio))
            self.require(fits, "ratio", f"a list of damping.modes = {self.modes}")
        if chosen == ("ratios", "omegas"):
            ratios = self.given("ratios", f"given with omegas = {self.omegas}")
            omegas = self.given("omegas", f"given with ratios = {self.ratios}")
            check_two_ratios(self.name_of("ratios"), ratios, omegas)

    @property
    def of_all_modes(self) -> bool:
        """Whether every mode is damped, whatever the structure."""
        if self.ratio is None:
            return max(self.mass or 0.0, self.stiffness or 0.0, *(self.ratios or ())) > 0.0
        return self.modes == "all" and float(np.min(self.ratio)) > 0.0


@dataclass(frozen=True)
class Excitation(Table):
    """Point force f(t) = force_mean + force_cos cos(omega t) + force_sin sin(omega t)."""

    omega: float = positive()
    """Angular frequency [rad/s]."""
    point: Vector | None = holds(f"[x, y], two finite numbers {OR_ZERO}", default=None)
    """[m]; a mesh file may give it instead by a physical point named ``load``."""
    force_sin: Vector = holds(FORCE, default=(0.0, 0.0))
    """[N]"""
    force_cos: Vector = holds(FORCE, default=(0.0, 0.0))
    """[N]"""
    force_mean: Vector = holds(FORCE, default=(0.0, 0.0))
    """[N]"""


@dataclass(frozen=True)
class Contact(Table):
    """Contact between the lips, pair by pair of nodes."""

    stiffness: float | None = positive(None)
    """Penalty stiffness k of one pair [N/m]; or give it per area."""
    stiffness_per_area: float | None = positive(None)
    """Penalty stiffness per area of the lip [N/m^3]: independent of the mesh."""
    law: str = choice("penalty", "smoothed", "unilateral", default="penalty")
    """"unilateral": no penetration."""
    sharpness: float | None = positive(None)
    """s of the smoothed law [1/m]."""
    pairs: str = choice("all", "mouth", default="all")
    """Every pair of lip nodes, or only the one at the mouth."""

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


@dataclass(frozen=True)
class HarmonicBalance(Table):
    """Truncation of the Fourier series and sampling of the contact force."""

    harmonics: int = at_least_one(5)
    """H; with a tolerance, the fewest of a curve and of a sweep."""
    samples: int | None = at_least_one(None)
    """Instants per period at which contact is evaluated; chosen by the solver when left out."""
    tolerance: float | None = positive(None)
    """Choose H so that the estimated error stays below this: of one solution all of it, along a
    curve and in a sweep that of the truncation."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tolerance is not None:
            self.leave_out(("samples",), "a tolerance")
        least = 4 * self.harmonics + 1
        self.require(
            self.samples is None or least <= self.samples <= MAX_SAMPLES,
            "samples",
            f"a whole number from {least} (4 harmonics + 1) to {MAX_SAMPLES}, or left out",
        )


@dataclass(frozen=True)
class Mesh(Table):
    """How the plate is meshed.

    ``layout = "grid"``: columns x rows equal quadrilaterals (or twice as many triangles); the crack
    must run along grid lines. ``"graded"``: element size ``size`` away from the crack,
    ``lip_elements`` along each lip, the one at the tip ``grading`` times shorter than the one at
    the mouth. ``"file"``: any gmsh mesh of a plane region whose physical groups are named
    ``clamp``, ``lower_lip``, ``upper_lip`` (curves), ``load`` (a point) and, for the region
    itself, anything.
    """

    layout: str = choice("grid", "graded", "file")
    cells: str = choice("triangle", "quadrilateral", default="quadrilateral")
    order: int = holds("1 or 2", lambda value: value in (1, 2), default=1)
    """Polynomial order of the displacement."""
    columns: int | None = at_least_one(None)
    rows: int | None = at_least_one(None)
    size: float | None = positive(None)
    """[m]"""
    lip_elements: int | None = at_least_one(None)
    grading: float = holds(
        f"a number from 1 to {STEEPEST:g}", lambda value: 1 <= value <= STEEPEST, default=4.0
    )
    file: str | None = holds("the path of a .msh file", default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        keys = {"grid": ("columns", "rows"), "graded": ("size", "lip_elements"), "file": ("file",)}
        given = keys.pop(self.layout)
        for others in keys.values():
            self.leave_out(others, f"layout = {self.layout!r}")
        for key in given:
            if key != "lip_elements":  # an uncracked plate has no lips
                self.given(key, f"given with layout = {self.layout!r}")


@dataclass(frozen=True)
class Reduction(Table):
    """How the structure is reduced before it is solved (``reduce_structure``).

    Without this table a structure of up to 100 dofs is solved as it is, and a larger one is reduced
    with the default basis.
    """

    method: str | None = choice("massless", "free_interface", "craig_bampton", "off", default=None)
    """Default: "massless" (modes, and lips without mass) with contact, unless all modes are kept;
    without contact "free_interface"."""
    modes: int | None = at_least_one(None)
    """Lowest modes to keep; default: those that are damped, but 50 where all are."""


@dataclass(frozen=True)
class Curve(Table):
    """A response curve, followed through its folds by continuation."""

    start: float = holds(NUMBER)
    stop: float = holds(NUMBER)
    """Of the parameter: load frequencies [rad/s], factors of load, stiffness or damping, or
    clearances added [m]."""
    parameter: str = choice("omega", "load", "stiffness", "damping", "clearance", default="omega")
    stability: bool = holds("true or false", default=True)
    """Floquet multipliers and period doublings along the curve."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require(self.start != self.stop, "stop", f"other than curve.start = {self.start:g}")
        if self.parameter in ("omega", "stiffness"):
            for name in ("start", "stop"):
                allowed = f"a number > 0 with curve.parameter = {self.parameter!r}"
                self.require(getattr(self, name) > 0.0, name, allowed)


@dataclass(frozen=True)
class Integration(Table):
    """Direct integration in time, from rest."""

    method: str | None = choice(
        "exponential", "central_difference", "implicit", "events", default=None
    )
    """"events": exact from one switching instant to the next, for few pairs. Default: "exponential"
    where lips have no mass, else "central_difference"."""
    periods: int = at_least_one(400)
    """Load periods at most."""
    settle: float = positive(1e-3)
    """Relative change of the gaps from one period to the next at which to stop."""
    steps_per_period: int | None = at_least_one(None)
    """Default: 512; twice what is stable (central differences), 256 (events)."""


@dataclass(frozen=True)
class Sweep(Table):
    """Many cases: all combinations of the values of some keys of the scene.

    [sweep.over]
    "excitation.omega" = { start = 1000.0, stop = 4000.0, count = 61 }
    "crack.length" = [0.02, 0.03, 0.04]
    """

    over: tuple[Axis, ...] = holds(
        "a table of keys of the scene and the values that they take", lambda value: value
    )
    ranks: int = at_least_one(1)
    """Ranks that share the mesh of one case."""

    @property
    def n_cases(self) -> int:
        """How many cases."""
        return math.prod(len(axis.values) for axis in self.over)


@dataclass(frozen=True)
class Scene:
    """A cracked plate, its load, and how its vibration is computed.

    Raises
    ------
    InputError
        A table is missing or has a key that cannot be used.
    """

    geometry: Geometry
    material: Material
    damping: Damping
    excitation: Excitation
    mesh: Mesh
    contact: Contact | None = None
    crack: Crack | None = None
    harmonic_balance: HarmonicBalance = field(default_factory=HarmonicBalance)
    reduction: Reduction | None = None
    curve: Curve | None = None
    integration: Integration | None = None
    sweep: Sweep | None = None

    def __post_init__(self) -> None:
        for name, table in _TABLES.items():
            value = getattr(self, name)
            if not isinstance(value, table) and not (value is None and name in _OPTIONAL):
                raise InputError(name, value, f"a {table.__name__}")
        if self.mesh.layout == "file":
            self._check_file()
        else:
            self._check_plate()
        if self.sweep is not None:
            object.__setattr__(self, "sweep", self._checked_sweep(self.sweep))

    def _check_plate(self) -> None:
        geometry, crack = self.geometry, self.crack
        width, height = (geometry.given(key, f"given: {EXTENT}") for key in ("width", "height"))
        geometry.require(
            height / THINNEST <= width <= height * THINNEST,
            "width",
            f"within a factor {THINNEST:g} of geometry.height = {height:g}",
        )
        x, y = self.excitation.given("point", "given: [x, y] on the plate")
        on_plate = 0.0 <= x <= width and 0.0 <= y <= height
        self.excitation.require(on_plate, "point", f"on the plate: [0..{width:g}, 0..{height:g}]")
        if crack is None:
            return
        crack.given("edge", "given: 'left' or 'right'")
        margin = f"at least {NEAREST:g} of that from both"
        crack.require(
            crack.height is not None and _inside(crack.height, height),
            "height",
            f"inside the plate: between 0 and geometry.height = {height:g}, {margin}",
        )
        crack.require(
            (crack.length is None) != (crack.first_omega is None),
            "length",
            "given, or left out where crack.first_omega determines it",
        )
        crack.require(
            crack.length is None or _inside(crack.length, width),
            "length",
            f"shorter than the plate: between 0 and geometry.width = {width:g}, {margin}",
        )
        if self.contact is None:
            raise InputError("contact", None, "given where there is a crack: a table")
        if self.mesh.layout == "grid":
            self._check_grid(crack)
        else:
            self.mesh.given("lip_elements", "given where there is a crack")

    def _check_grid(self, crack: Crack) -> None:
        crack.given("length", "given with mesh.layout = 'grid'")
        for key, side, lines in (("length", "width", "columns"), ("height", "height", "rows")):
            extent, count = getattr(self.geometry, side), getattr(self.mesh, lines)
            cells = getattr(crack, key) / extent * count
            crack.require(
                0 < round(cells) < count and abs(cells - round(cells)) < 1e-9 * count,
                key,
                f"a whole number of grid cells of {extent / count:g} m, at least one from each end",
            )

    def _check_file(self) -> None:
        self.geometry.leave_out(("width", "height"), "mesh.layout = 'file'")
        if self.crack is not None:
            own = ("edge", "height", "length", "first_omega")
            self.crack.leave_out(own, "mesh.layout = 'file'")

    def _checked_sweep(self, sweep: Sweep) -> Sweep:
        """The sweep with values as their keys hold them; each case is checked when it is made."""
        axes, seen = [], set()
        for axis in sweep.over:
            table, _, key = axis.key.partition(".")
            if table not in _SWEPT or key not in _TABLES[table].keys() or axis.key in seen:
                known = ", ".join(_SWEPT)
                allowed = f"a table.key of the scene, given once, with a table of {known}"
                raise InputError("sweep.over", axis.key, allowed)
            seen.add(axis.key)
            values = tuple(_TABLES[table].checked(key, value) for value in axis.values)
            if len(set(values)) != len(values) or not values:
                raise InputError(f'sweep.over."{axis.key}"', values, "values, each given once")
            axes.append(Axis(axis.key, values))
        return dataclasses.replace(sweep, over=tuple(axes))

    @classmethod
    def from_mapping(cls, tables: Mapping[str, object], folder: Path = Path()) -> Scene:
        """Make a scene from nested mappings; a relative ``mesh.file`` is one of ``folder``."""
        for name, value in tables.items():
            if name not in _TABLES:
                raise InputError(name, value, f"left out; known tables: {', '.join(_TABLES)}")
        for item in fields(cls):
            if item.name not in tables and item.name not in (*_OPTIONAL, "harmonic_balance"):
                raise InputError(item.name, None, "given: a table")
        made = {name: _TABLES[name].from_mapping(value) for name, value in tables.items()}
        return cls(**made).with_mesh_files(lambda path: str(folder / path))

    @classmethod
    def load(cls, path: str | Path) -> Scene:
        """Read a scene from a TOML file.

        Raises
        ------
        InputError
            The file cannot be read, is not TOML, or holds a value that cannot be used.
        """
        try:
            text = Path(path).read_text(encoding="utf-8")
        except OSError as error:
            raise InputError("scene", str(path), f"a readable file ({error.strerror})") from None
        except ValueError as error:
            raise InputError("scene", str(path), f"a TOML file ({error})") from None
        return cls.from_text(text, str(path), Path(path).parent)

    @classmethod
    def from_text(cls, text: str, name: str = "given as text", folder: Path = Path()) -> Scene:
        """Make a scene from the text of a TOML file, which errors call ``name``."""
        try:
            tables = tomllib.loads(text)
        except (ValueError, RecursionError) as error:  # a nest too deep, a number too long
            raise InputError("scene", name, f"a TOML file ({error})") from None
        return cls.from_mapping(tables, folder)

    @property
    def mesh_files(self) -> list[str]:
        """The mesh files of the scene and its sweep."""
        axes = self.sweep.over if self.sweep is not None else ()
        swept = (axis.values for axis in axes if axis.key == "mesh.file")
        return [file for files in ([self.mesh.file], *swept) for file in files if file is not None]

    def with_mesh_files(self, change: Callable[[str], str]) -> Scene:
        """Return the scene with the paths of its mesh files changed."""
        if not self.mesh_files:
            return self
        file = None if self.mesh.file is None else change(self.mesh.file)
        changes: dict[str, object] = {"mesh.file": file}
        if self.sweep is not None:
            changes["sweep.over"] = tuple(
                Axis(axis.key, tuple(map(change, axis.values))) if axis.key == "mesh.file" else axis
                for axis in self.sweep.over
            )
        return self.replace(changes)

    def replace(self, values: Mapping[str, object]) -> Scene:
        """Return a scene with some keys changed: ``scene.replace({"contact.stiffness": 1e9})``.

        An optional table is made where it is missing, and removed by ``{"crack": None}``.
        """
        tables: dict[str, Any] = {item.name: getattr(self, item.name) for item in fields(self)}
        changes: dict[str, dict[str, object]] = {}
        for name, value in values.items():
            table, _, key = name.partition(".")
            known = _TABLES[table].keys() if table in _TABLES else {}
            if not key and value is None and table in _OPTIONAL:
                tables[table] = None
            elif not key and table in _TABLES:
                allowed = f"changed key by key; only {', '.join(_OPTIONAL)} can be removed, by none"
                raise InputError(name, value, allowed)
            elif key not in known:
                keys = f"keys: {', '.join(known)}" if known else f"tables: {', '.join(_TABLES)}"
                raise InputError(name, value, f"left out; known {keys}")
            else:
                changes.setdefault(table, {})[key] = value
        for table, change in changes.items():
            now, kind = tables[table], _TABLES[table]
            tables[table] = dataclasses.replace(now, **change) if now else kind.from_mapping(change)
        return Scene(**tables)

    def as_toml(self) -> str:
        """The scene as a file that :meth:`load` reads; paths as they are."""
        made = (getattr(self, name) for name in _TABLES)
        return "\n".join(table.as_toml() for table in made if table is not None)


def _inside(place: float, extent: float) -> bool:
    """Whether a place is between 0 and an extent, and not too near to either."""
    return NEAREST * extent <= place <= (1.0 - NEAREST) * extent


_TABLES: dict[str, type[Table]] = {
    name: (get_args(hint) or (hint,))[0] for name, hint in get_type_hints(Scene).items()
}
_OPTIONAL = tuple(item.name for item in fields(Scene) if item.default is None)
_SWEPT = tuple(name for name in _TABLES if name not in ("curve", "integration", "sweep"))
