"""Response curves: solutions along a parameter, and where they bifurcate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar, Self

import numpy as np

from fenics_crack.balance.error_report import LARGE_ERROR
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.tables import (
    Described,
    Tabular,
    counted,
    frequency_axis,
    hertz_of,
    speed_axis,
    with_frequency,
)
from fenics_crack.curves.family import FAMILIES
from fenics_crack.curves.peak import Peak, Top, damping_by_width, top_of
from fenics_crack.curves.stability import floquet
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.rotation import RunUpStructure
from fenics_crack.model.structure import Structure
from fenics_crack.motion.motions import Observed
from fenics_crack.motion.orbit import PeriodicOrbit

PARAMETERS = {
    "omega": "load frequency [rad/s]",
    "load": "load, as a multiple of the scene's [-]",
    "stiffness": "contact stiffness, as a multiple of the scene's [-]",
    "damping": "damping, as a multiple of the scene's [-]",
    "clearance": "clearance added to the scene's [m]",
    "friction": "coefficient of friction, as a multiple of the scene's [-]",
    "speed": "rotor speed [rad/s]",
    "resonance": "load at resonance, as a multiple of the scene's [-]",
}
"""Parameters of a curve, by their names in :attr:`ResponseCurve.parameter`."""


PARTS = np.arange(256) / 256
"""Parts of the period at which points of a curve are evaluated."""


def parameter_axis(parameter: str, in_hertz: bool) -> tuple[float, str, str]:
    """Return factor, name and unit of a curve's parameter: in Hz and rpm, or in rad/s."""
    if parameter in ("omega", "speed"):
        return (frequency_axis if parameter == "omega" else speed_axis)(in_hertz)
    name, _, unit = PARAMETERS[parameter].removesuffix("]").rpartition(" [")
    return 1.0, name, unit


def leading(multipliers: np.ndarray) -> complex:
    """Return the multiplier that a curve keeps, of those with the largest modulus first."""
    first = complex(multipliers[0])
    return complex(first.real, abs(first.imag))


def kind_in_words(kind: str) -> str:
    """The kind of a bifurcation as it is printed."""
    return "Neimark-Sacker" if kind == "neimark_sacker" else kind.replace("_", " ")


@dataclass(frozen=True, repr=False)
class Bifurcation(Described):
    """A special point of a curve.

    Attributes
    ----------
    kind : str
        "fold": the curve turns back; "branch_point": another branch crosses; "period_doubling": a
        multiplier leaves the unit circle through -1; "neimark_sacker": a pair of them leaves it
        anywhere else. Of harmonic balance the last two are found with ``stability=True``, and only
        under laws without exact orbits.
    point : HarmonicCurve or OrbitCurve
        The curve that has no other point.
    multipliers : (m,) complex or None
        Leading Floquet multipliers of an exact orbit, largest modulus first; else None.
    """

    kind: str
    point: ResponseCurve
    multipliers: np.ndarray | None

    @property
    def value(self) -> float:
        """Value of the curve's parameter."""
        return float(self.point.values[0])

    @property
    def omega(self) -> float:
        """Load frequency [rad/s]."""
        return float(self.point.omega[0])

    frequency = hertz_of()

    @cached_property
    def problem(self) -> Problem:
        """Problem solved at the bifurcation."""
        return self.point.problem_of(0)

    @cached_property
    def solution(self) -> PeriodicSolution:
        """The solution there, with its displacement and error report."""
        return self.point.solution(0, search=False)

    @cached_property
    def orbit(self) -> PeriodicOrbit:
        """The exact orbit there; InputError on a curve of harmonic balance."""
        return self.point.orbit(0)

    def to_dict(self) -> dict[str, Any]:
        """Kind, value of the curve's parameter, and load frequency."""
        return with_frequency({"kind": self.kind, "value": self.value, "omega": self.omega})

    def _title(self) -> str:
        return f"{kind_in_words(self.kind)} at {self.value:.6g}, {self.point.method}"


@dataclass(frozen=True)
class CurvePoint:
    """A point of a curve as it comes.

    Attributes
    ----------
    value, omega : float
        Of the parameter, and load frequency [rad/s].
    unknown : (2H+1, n_pairs) [m]
        Gap coefficients, or the slow gap's (``HarmonicCurve.unknowns``).
    iterations : int
        Newton iterations.
    multipliers : (8,) complex or None
        The leading ones of exact orbits, largest modulus first.
    bifurcations : sequence of (str, float)
        Kinds and parameters of the special points since the point before.
    """

    value: float
    omega: float
    unknown: np.ndarray
    iterations: int
    multipliers: np.ndarray | None = None
    bifurcations: Sequence[tuple[str, float]] = field(default_factory=tuple)


@dataclass(frozen=True, repr=False, kw_only=True)
class ResponseCurve(Observed, Tabular):
    """Solutions along a curve, in the order in which it was followed.

    It is a :class:`HarmonicCurve` or an :class:`OrbitCurve`.

    Attributes
    ----------
    structure, contact : Structure, ContactLaw
        Whose solutions they are, small or reduced, and the law of all pairs: as given, not as the
        parameter varies them.
    parameter : str
        "omega", "load", "stiffness", "damping", "clearance", "friction", "speed", or "resonance".
    values : (n,)
        Of the parameter: load frequencies [rad/s], factors, clearances added [m], or speeds of the
        rotor [rad/s].
    omega : (n,) [rad/s]
        Load frequencies.
    iterations : (n,) int
        Newton iterations of each point.
    bifurcations : tuple of Bifurcation
        Special points, in order along the curve.
    complete : bool
        True if the curve reached the requested end, or closed.
    status : str
        Reason for the end.
    subharmonic : int
        The response has this many times the load's period.
    multipliers : (n,) complex or None
        Floquet multiplier of largest modulus at each point, of a pair the one with positive
        imaginary part; None: not known.
    branch : bool
        True if :func:`follow_branch` has followed it.
    """

    structure: Structure
    contact: ContactLaw
    parameter: str
    values: np.ndarray
    omega: np.ndarray
    iterations: np.ndarray
    bifurcations: tuple[Bifurcation, ...]
    complete: bool
    status: str
    subharmonic: int
    multipliers: np.ndarray | None = None
    branch: bool = False

    KIND: ClassVar[str] = "response curve"
    frequency = hertz_of()
    EXACT: ClassVar[bool] = False
    """True if its points are exact orbits."""
    FOUND: ClassVar[str]
    """Name of the attribute that holds the points, (n, ...)."""

    def __len__(self) -> int:
        return len(self.omega)

    # --- what each kind knows ---------------------------------------------------------------------

    @property
    def method(self) -> str:
        """Method by which the points were found, in words: "H = 5", "exact orbits"."""
        raise NotImplementedError

    @property
    def problem(self) -> Problem:
        """Problem solved at the first point."""
        raise NotImplementedError

    @cached_property
    def _structure(self) -> Structure:
        """Structure at the first point."""
        if self.parameter == "speed" and isinstance(self.structure, RunUpStructure):
            return self.structure.at_speed(float(self.values[0]))
        return self.structure

    @property
    def undecided(self) -> np.ndarray | None:
        """Points of undecided stability: (n,) bool; None: not requested."""
        raise NotImplementedError

    @property
    def gap_coefficients(self) -> np.ndarray:
        """Closing of the pairs: (n, 2H+1, n_pairs) [m]."""
        raise NotImplementedError

    def reason(self, index: int) -> str:
        """Why the stability is undecided at a point, and what to do; "" where it is decided."""
        raise NotImplementedError

    def problem_at(self, value: float) -> Problem:
        """Return the problem at a value of the parameter."""
        return FAMILIES[self.parameter].vary(self.problem, value)

    def problem_of(self, index: int) -> Problem:
        """Return the problem solved at a point, of the structure as the parameter varies it."""
        problem = self.problem_at(float(self.values[index]))
        return replace(problem, omega=float(self.omega[index]))

    def _structure_of(self, index: int) -> Structure:
        """The structure at a point."""
        return self.problem_of(index).structure

    def solution(self, index: int, *, search: bool = True) -> PeriodicSolution:
        """The solution at a point, with its displacement and error report; without ``search`` for
        its exact orbit the report is what one Newton step predicts."""
        raise NotImplementedError

    def orbit(self, index: int) -> PeriodicOrbit:
        """The exact orbit at a point; InputError on a curve of harmonic balance."""
        raise InputError("curve", self.method, "one of exact orbits")

    # --- stability --------------------------------------------------------------------------------

    @property
    def stable(self) -> np.ndarray:
        """True where the largest multiplier is surely within the unit circle: (n,) bool.

        Raises
        ------
        AttributeError
            The curve was followed without ``stability=True``.
        """
        if self.multipliers is None:
            raise AttributeError("stability: unknown of a curve followed with stability = False")
        return np.asarray((np.abs(self.multipliers) < 1.0) & ~self._open)

    @property
    def verdicts(self) -> np.ndarray:
        """Stable, unstable or undecided, at each point: (n,) str; raises as :attr:`stable`."""
        return np.where(self._open, "undecided", np.where(self.stable, "stable", "unstable"))

    @property
    def _open(self) -> np.ndarray:
        """Points of undecided stability: (n,) bool, never None."""
        return np.zeros(len(self), dtype=bool) if self.undecided is None else self.undecided

    # --- its points -------------------------------------------------------------------------------

    def part(self, places: Sequence[int] | slice) -> Self:
        """The points at some places, without the bifurcations."""
        columns = {name: column[places] for name, column in _arrays_of(self).items()}
        return replace(self, **columns, bifurcations=())

    def unjudged(self) -> Self:
        """As it was followed, without what has been requested since."""
        return self

    def bifurcation(
        self, kind: str, value: float, found: np.ndarray, multipliers: np.ndarray | None = None
    ) -> Bifurcation:
        """A special point of this curve, where the parameter has a value."""
        omega = self.problem_at(value).omega
        columns: dict[str, Any] = {"values": value, "omega": omega, "iterations": 0}
        columns |= {self.FOUND: found}
        columns |= {} if multipliers is None else {"multipliers": leading(multipliers)}
        rows = {name: np.array([entry]) for name, entry in columns.items()}
        return Bifurcation(kind, replace(self.unjudged().part([0]), **rows), multipliers)

    @cached_property
    def at_bifurcations(self) -> Self:
        """The first point, the bifurcations and the last point, to be measured: a curve of their
        own."""
        plain = self.unjudged()
        met = (one.point for one in self.bifurcations)
        return replace(plain, **_joined(plain.part([0]), *met, plain.part([-1])), bifurcations=())

    def nearest(self, bifurcation: Bifurcation) -> int:
        """The number of the point nearest to a bifurcation."""
        points, there = getattr(self, self.FOUND), getattr(bifurcation.point, self.FOUND)
        off = np.linalg.norm((points - there).reshape(len(self), -1), axis=1)
        off /= float(np.linalg.norm(there)) or 1.0
        wide = float(np.ptp(self.values)) or 1.0
        return int(np.argmin(np.hypot(off, (self.values - bifurcation.value) / wide)))

    def coefficients_at(self, dof: int | None = None) -> np.ndarray:
        """Coefficients of the displacement of a dof, or of the watched one, at every point:
        (n, 2H+1) [m]."""
        return self.observe([dof])[0][0].waves

    def _along(self, values: list[Any]) -> np.ndarray:
        return np.array(values)

    def top(self, dof: int | None = None) -> Top:
        """Find where the largest response of a dof, or of the watched one, is and how large;
        :meth:`peak` examines it, too."""
        amplitude = self.amplitude(dof)
        index = int(np.argmax(amplitude))
        return Top(index, *top_of(self.values, amplitude, index), index in (0, len(self) - 1))

    def peak(self, dof: int | None = None) -> Peak:
        """The largest response of a dof, or of the watched one: where, how large, how sure, whether
        stable, and the damping by its width."""
        top = self.top(dof)
        omega, solution = float(self.omega[top.index]), self.solution(top.index)
        error, damping = solution.report.displacement, _damping(self, top.index, dof)
        if self.parameter in ("omega", "speed"):
            omega *= top.value / float(self.values[top.index])
        if self.multipliers is None:
            verdict = floquet(solution.structure, solution).verdict
        else:
            verdict = str(self.verdicts[top.index])
        return Peak(**vars(top), omega=omega, error=error, verdict=verdict, damping=damping)

    @cached_property
    def displacement_errors(self) -> np.ndarray:
        """Estimated error of the displacement at the load at every point, relative to its root mean
        square, as ``displacement`` of :class:`fenics_crack.ErrorReport`: (n,).

        At points spread evenly along the curve, and at those on both sides of where a warning
        begins to be due, what one Newton step on the exact flow predicts, where there is one, of
        harmonics and modes left out, of exact orbits of modes; elsewhere it is interpolated.
        """
        known: dict[int, float] = {}
        asked = set(np.linspace(0, len(self) - 1, 40).astype(int).tolist())  # as a picture shows
        while asked:
            for place in asked:
                known[place] = self._displacement_error(place)
            asked = {
                (first + last) // 2
                for first, last in pairwise(sorted(known))
                if last - first > 1 and (known[first] > LARGE_ERROR) != (known[last] > LARGE_ERROR)
            }
        places = sorted(known)
        return np.interp(np.arange(len(self)), places, [known[place] for place in places])

    def _displacement_error(self, index: int) -> float:
        """The same at a point."""
        return self.solution(index, search=False).report.displacement

    # --- shown ------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Columns, a row for every point: multipliers where the curve has them, and the indicators
        of the watched dof (collective)."""
        found = {self.parameter: self.values.tolist(), "omega": self.omega.tolist()}
        found["iterations"] = self.iterations.tolist()
        if self.multipliers is not None:
            found["multiplier"] = np.abs(self.multipliers).tolist()
            found["verdict"] = self.verdicts.tolist()
        return with_frequency(found | self.indicators().to_dict())

    def _title(self) -> str:
        parts = [
            f"{self.parameter} {self.values[0]:.6g} to {self.values[-1]:.6g}",
            counted(len(self), "point"),
            self.method,
            counted(len(self.bifurcations), "bifurcation"),
        ]
        if self.multipliers is not None:
            parts.append(f"{np.mean(self.stable):.0%} stable")
        return ", ".join([*parts, "complete" if self.complete else "NOT COMPLETE"])


def _arrays_of(curve: ResponseCurve) -> dict[str, np.ndarray]:
    """The columns of a curve by the names of its fields."""
    known = {one.name: getattr(curve, one.name) for one in fields(curve)}
    return {name: column for name, column in known.items() if isinstance(column, np.ndarray)}


def _joined(*curves: ResponseCurve) -> dict[str, np.ndarray]:
    """Columns of curves of one kind, one after the other."""
    columns = [_arrays_of(one) for one in curves]
    return {name: np.concatenate([one[name] for one in columns]) for name in columns[0]}


def _damping(curve: ResponseCurve, index: int, dof: int | None) -> float:
    """By the half-power bandwidth next to a point; over a rotor's speed natural frequencies follow
    the load's, and it takes longer to pass them."""
    if curve.parameter not in ("omega", "speed"):
        return math.nan
    waves, structure = curve.coefficients_at(dof), curve.structure
    damping = damping_by_width(curve.values, waves, curve.subharmonic, index)
    if isinstance(structure, RunUpStructure):
        there = structure.at_speed(float(curve.values[index]))
        damping *= 1.0 - there.stiffening(float(curve.omega[index]))
    return damping
