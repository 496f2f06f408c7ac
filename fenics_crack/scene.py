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
from dataclasses import MISSING, Field, dataclass, field, fields
from numbers import Integral, Real
from pathlib import Path
from typing import Any

from fenics_crack.errors import InputError

__all__ = [
    "Contact",
    "Crack",
    "Damping",
    "Excitation",
    "Geometry",
    "HarmonicBalance",
    "Material",
    "Mesh",
    "Scene",
]

Vector = tuple[float, float]


# --- what a key may hold --------------------------------------------------------------------------


def _real(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
        raise TypeError
    return float(value)


def _integer(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise TypeError
    number = int(value)
    if abs(number) >= 2**31:  # gmsh and PETSc count with 32 bits
        raise OverflowError
    return number


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError
    return value


def _vector(value: object) -> Vector:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise TypeError
    return _real(value[0]), _real(value[1])


def _ratio(value: object) -> float | tuple[float, ...]:
    return tuple(map(_real, value)) if isinstance(value, list | tuple) else _real(value)


def _count_or_all(value: object) -> int | str:
    return value if value == "all" else _integer(value)  # type: ignore[return-value]


def _key(
    convert: Callable[[object], Any],
    allowed: str,
    accepts: Callable[[Any], bool] = lambda value: True,
    default: Any = MISSING,
) -> Any:
    """Field that holds what ``convert`` makes of a value for which ``accepts`` is true."""
    return field(
        default=default, metadata={"convert": convert, "allowed": allowed, "accepts": accepts}
    )


def _positive(default: Any = MISSING) -> Any:
    return _key(_real, "a finite number > 0", lambda value: value > 0, default)


def _at_least_one(default: Any = MISSING) -> Any:
    return _key(_integer, "a whole number >= 1", lambda value: value >= 1, default)


def _choice(*words: str, default: Any = MISSING) -> Any:
    return _key(_text, "one of " + ", ".join(map(repr, words)), lambda v: v in words, default)


class _Table:
    """A table of the scene: checks each of its keys when it is made."""

    def __post_init__(self) -> None:
        for item in self._fields().values():
            value = getattr(self, item.name)
            if value is None and item.default is None:
                continue
            name, allowed = self._name(item.name), item.metadata["allowed"]
            try:
                converted = item.metadata["convert"](value)
            except (TypeError, OverflowError):
                raise InputError(name, value, allowed) from None
            if not item.metadata["accepts"](converted):
                raise InputError(name, value, allowed)
            object.__setattr__(self, item.name, converted)

    @classmethod
    def _fields(cls) -> dict[str, Field[Any]]:
        """The keys of the table."""
        return {item.name: item for item in fields(cls)}  # type: ignore[arg-type]

    @classmethod
    def _name(cls, key: str) -> str:
        """The key as it stands in a scene file: ``[harmonic_balance] samples``."""
        table = "".join("_" + c.lower() if c.isupper() else c for c in cls.__name__).lstrip("_")
        return f"{table}.{key}"

    def _require(self, condition: bool, key: str, allowed: str) -> None:
        if not condition:
            raise InputError(self._name(key), getattr(self, key), allowed)

    @classmethod
    def from_mapping(cls, values: object) -> Any:
        """Make the table from the mapping read in a file."""
        table = cls._name("").rstrip(".")
        known = cls._fields()
        if not isinstance(values, Mapping):
            raise InputError(table, values, f"a table with the keys {', '.join(known)}")
        for key, value in values.items():
            if key not in known:
                raise InputError(cls._name(key), value, f"left out; known keys: {', '.join(known)}")
        for key, item in known.items():
            if item.default is MISSING and key not in values:
                raise InputError(cls._name(key), None, f"given: {item.metadata['allowed']}")
        return cls(**values)


# --- the tables -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Geometry(_Table):
    """Rectangle [0, width] x [0, height], clamped along y = 0; a mesh file has its own shape."""

    thickness: float = _positive()
    """[m]"""
    width: float | None = _positive(None)
    """[m]"""
    height: float | None = _positive(None)
    """[m]"""


@dataclass(frozen=True)
class Crack(_Table):
    """Straight horizontal edge crack: a slit whose two lips share only the tip."""

    edge: str | None = _choice("left", "right", default=None)
    """Where the crack's mouth is."""
    height: float | None = _positive(None)
    """y of the crack [m]."""
    length: float | None = _positive(None)
    """[m]; or let ``first_omega`` determine it."""
    first_omega: float | None = _positive(None)
    """First natural frequency with the open crack [rad/s], from which to find the length."""
    clearance: float = _key(_real, "a finite number", default=0.0)
    """g0 >= 0: opening that must close before the lips touch; < 0: preload [m]."""


@dataclass(frozen=True)
class Material(_Table):
    """Isotropic linear elastic."""

    young: float = _positive()
    """Young's modulus E [Pa]."""
    poisson: float = _key(
        _real, "a finite number with -1 < nu < 0.5", lambda value: -1.0 < value < 0.5
    )
    """Poisson's ratio [-]."""
    density: float = _positive()
    """[kg/m^3]"""


@dataclass(frozen=True)
class Damping(_Table):
    """Modal damping: ratio xi_j of critical for each of the lowest modes."""

    ratio: float | tuple[float, ...] = _key(
        _ratio,
        "a finite number >= 0, or a list of them, one per mode",
        lambda value: min(value, default=-1.0) >= 0 if isinstance(value, tuple) else value >= 0,
    )
    modes: int | str = _key(
        _count_or_all,
        "'all' or a whole number >= 1",
        lambda value: value == "all" or value >= 1,
        default="all",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.ratio, tuple) and self.modes != "all":
            self._require(
                len(self.ratio) == self.modes, "ratio", f"a list of damping.modes = {self.modes}"
            )


@dataclass(frozen=True)
class Excitation(_Table):
    """Point force f(t) = force_mean + force_cos cos(omega t) + force_sin sin(omega t)."""

    omega: float = _positive()
    """Angular frequency [rad/s]."""
    point: Vector | None = _key(_vector, "[x, y], two finite numbers", default=None)
    """[m]; a mesh file may give it instead by a physical point named ``load``."""
    force_sin: Vector = _key(_vector, "[fx, fy], two finite numbers", default=(0.0, 0.0))
    """[N]"""
    force_cos: Vector = _key(_vector, "[fx, fy], two finite numbers", default=(0.0, 0.0))
    """[N]"""
    force_mean: Vector = _key(_vector, "[fx, fy], two finite numbers", default=(0.0, 0.0))
    """[N]"""


@dataclass(frozen=True)
class Contact(_Table):
    """Contact between the lips, pair by pair of nodes."""

    stiffness: float | None = _positive(None)
    """Penalty stiffness k of one pair [N/m]; or give it per area."""
    stiffness_per_area: float | None = _positive(None)
    """Penalty stiffness per area of the lip [N/m^3]: independent of the mesh."""
    law: str = _choice("penalty", "smoothed", "constraint", default="penalty")
    sharpness: float | None = _positive(None)
    """s of the smoothed law [1/m]."""
    pairs: str = _choice("all", "mouth", default="all")
    """Every pair of lip nodes, or only the one at the mouth."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.law == "constraint":
            for key in ("stiffness", "stiffness_per_area"):
                self._require(getattr(self, key) is None, key, "left out with law = 'constraint'")
        else:
            self._require(
                (self.stiffness is None) != (self.stiffness_per_area is None),
                "stiffness",
                f"given, or contact.stiffness_per_area, with law = {self.law!r}",
            )
        if self.law == "smoothed":
            self._require(self.sharpness is not None, "sharpness", "given with law = 'smoothed'")
        else:
            self._require(self.sharpness is None, "sharpness", f"left out with law = {self.law!r}")


@dataclass(frozen=True)
class HarmonicBalance(_Table):
    """Truncation of the Fourier series and sampling of the contact force."""

    harmonics: int = _at_least_one(5)
    samples: int | None = _at_least_one(None)
    """Instants per period at which contact is evaluated; chosen by the solver when left out."""

    def __post_init__(self) -> None:
        super().__post_init__()
        least = 4 * self.harmonics + 1
        self._require(
            self.samples is None or self.samples >= least,
            "samples",
            f"a whole number >= {least} (4 harmonics + 1) or left out",
        )


@dataclass(frozen=True)
class Mesh(_Table):
    """How the plate is meshed.

    ``layout = "grid"``: columns x rows equal quadrilaterals (or twice as many triangles); the crack
    must run along grid lines. ``"graded"``: element size ``size`` away from the crack,
    ``lip_elements`` along each lip, the one at the tip ``grading`` times shorter than the one at
    the mouth. ``"file"``: any gmsh mesh of a plane region whose physical groups are named
    ``clamp``, ``lower_lip``, ``upper_lip`` (curves), ``load`` (a point) and, for the region
    itself, anything.
    """

    layout: str = _choice("grid", "graded", "file")
    cells: str = _choice("triangle", "quadrilateral", default="quadrilateral")
    order: int = _key(_integer, "1 or 2", lambda value: value in (1, 2), default=1)
    """Polynomial order of the displacement."""
    columns: int | None = _at_least_one(None)
    rows: int | None = _at_least_one(None)
    size: float | None = _positive(None)
    """[m]"""
    lip_elements: int | None = _at_least_one(None)
    grading: float = _key(_real, "a finite number >= 1", lambda value: value >= 1, default=4.0)
    file: str | None = _key(_text, "the path of a .msh file", default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        needed = {
            "grid": ("columns", "rows"),
            "graded": ("size", "lip_elements"),
            "file": ("file",),
        }
        for layout, keys in needed.items():
            for key in keys:
                given = getattr(self, key) is not None
                if layout != self.layout:
                    self._require(not given, key, f"left out with layout = {self.layout!r}")
                elif key != "lip_elements":  # an uncracked plate has no lips
                    self._require(given, key, f"given with layout = {self.layout!r}")


@dataclass(frozen=True)
class Scene:
    """A cracked plate, how it is loaded, and how its vibration is to be computed.

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

    def __post_init__(self) -> None:
        for name, table in _TABLES.items():
            value = getattr(self, name)
            if not isinstance(value, table) and not (value is None and name in _OPTIONAL):
                raise InputError(name, value, f"a {table.__name__}")
        if self.mesh.layout == "file":
            self._check_file()
        else:
            self._check_plate()

    def _check_plate(self) -> None:
        geometry, crack, excitation = self.geometry, self.crack, self.excitation
        geometry._require(geometry.width is not None, "width", "a finite number > 0")
        geometry._require(geometry.height is not None, "height", "a finite number > 0")
        assert geometry.width is not None and geometry.height is not None
        excitation._require(excitation.point is not None, "point", "given: [x, y] on the plate")
        assert excitation.point is not None
        on_plate = (
            0.0 <= excitation.point[0] <= geometry.width
            and 0.0 <= excitation.point[1] <= geometry.height
        )
        excitation._require(
            on_plate, "point", f"on the plate: [0..{geometry.width:g}, 0..{geometry.height:g}]"
        )
        if crack is None:
            return
        crack._require(crack.edge is not None, "edge", "given: 'left' or 'right'")
        crack._require(
            crack.height is not None and crack.height < geometry.height,
            "height",
            f"inside the plate: between 0 and geometry.height = {geometry.height:g}",
        )
        crack._require(
            (crack.length is None) != (crack.first_omega is None),
            "length",
            "given, or left out where crack.first_omega determines it",
        )
        crack._require(
            crack.length is None or crack.length < geometry.width,
            "length",
            f"shorter than the plate: less than geometry.width = {geometry.width:g}",
        )
        if self.contact is None:
            raise InputError("contact", None, "given where there is a crack: a table")
        if self.mesh.layout == "grid":
            self._check_grid(crack)
        else:
            self.mesh._require(
                self.mesh.lip_elements is not None, "lip_elements", "given where there is a crack"
            )

    def _check_grid(self, crack: Crack) -> None:
        geometry, mesh = self.geometry, self.mesh
        assert geometry.width and geometry.height and mesh.columns and mesh.rows and crack.height
        crack._require(crack.length is not None, "length", "given with mesh.layout = 'grid'")
        assert crack.length is not None
        for key, value, extent, count in (
            ("length", crack.length, geometry.width, mesh.columns),
            ("height", crack.height, geometry.height, mesh.rows),
        ):
            cells = value / extent * count
            crack._require(
                0 < round(cells) < count and abs(cells - round(cells)) < 1e-9 * count,
                key,
                f"a whole number of grid cells of {extent / count:g} m, at least one from each end",
            )

    def _check_file(self) -> None:
        for key in ("width", "height"):
            self.geometry._require(
                getattr(self.geometry, key) is None, key, "left out with mesh.layout = 'file'"
            )
        for key in ("edge", "height", "length", "first_omega"):
            if self.crack is not None:
                self.crack._require(
                    getattr(self.crack, key) is None, key, "left out with mesh.layout = 'file'"
                )

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
        if made["mesh"].file is not None:
            made["mesh"] = dataclasses.replace(made["mesh"], file=str(folder / made["mesh"].file))
        return cls(**made)

    @classmethod
    def load(cls, path: str | Path) -> Scene:
        """Read a scene from a TOML file.

        Raises
        ------
        InputError
            The file cannot be read, is not TOML, or holds a value that cannot be used.
        """
        try:
            with open(path, "rb") as file:
                tables = tomllib.load(file)
        except OSError as error:
            raise InputError("scene", str(path), f"a readable file ({error.strerror})") from None
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise InputError("scene", str(path), f"a TOML file ({error})") from None
        return cls.from_mapping(tables, Path(path).parent)

    def replace(self, values: Mapping[str, object]) -> Scene:
        """Return a scene with some keys changed: ``scene.replace({"contact.stiffness": 1e9})``.

        A whole optional table is removed by ``{"crack": None}``.
        """
        tables: dict[str, Any] = {item.name: getattr(self, item.name) for item in fields(self)}
        changes: dict[str, dict[str, object]] = {}
        for name, value in values.items():
            table, _, key = name.partition(".")
            known = _TABLES[table]._fields() if table in _TABLES else {}
            if not key and value is None and table in _OPTIONAL:
                tables[table] = None
            elif key not in known or tables[table] is None:
                raise InputError(name, value, "a change of an existing table.key of the scene")
            else:
                changes.setdefault(table, {})[key] = value
        for table, change in changes.items():
            tables[table] = dataclasses.replace(tables[table], **change)
        return Scene(**tables)


_TABLES: dict[str, type[_Table]] = {
    "geometry": Geometry,
    "material": Material,
    "damping": Damping,
    "excitation": Excitation,
    "mesh": Mesh,
    "contact": Contact,
    "crack": Crack,
    "harmonic_balance": HarmonicBalance,
}
_OPTIONAL = ("contact", "crack")
