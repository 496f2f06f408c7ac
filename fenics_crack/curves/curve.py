"""Response curves: solutions along a parameter, and where they bifurcate."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar, Self

import numpy as np

from fenics_crack.balance.assessment import Assessment
from fenics_crack.balance.contact_system import ContactPoint
from fenics_crack.balance.error_report import LARGE_ERROR
from fenics_crack.balance.harmonic_balance import solution_of_orbit, wave_of
from fenics_crack.balance.more_modes import UNKNOWN
from fenics_crack.balance.problem import Problem, least_harmonics
from fenics_crack.balance.solution import PeriodicSolution, solution_of
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
from fenics_crack.curves.orbits import Orbits, system_along
from fenics_crack.curves.peak import Peak, Top, damping_by_width, top_and_damping
from fenics_crack.curves.stability import floquet
from fenics_crack.curves.waves import WAVES, ResonanceWaves, Waves
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.rotation import RunUpStructure
from fenics_crack.model.structure import Structure
from fenics_crack.motion.flow import ContactFlow, flow_of
from fenics_crack.motion.motions import ObservedMotion, Record
from fenics_crack.motion.orbit import (
    MULTIPLIER_TOLERANCE,
    OBSERVED_HARMONICS,
    PeriodicOrbit,
    orbit_from,
)
from fenics_crack.motion.search import SearchOptions

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

MIN_HARMONICS = SearchOptions.harmonics[0]
"""Minimum harmonics of the load's frequency in a solution of exact orbits."""
CURVE_INSTANTS = 256
"""Instants of the period at which points of a curve are evaluated."""
RESOLUTION = 0.1
"""Width of a window that may be missed, over the longest step: steps are judged by an interpolation
between their ends, which is not right where orbits graze, or several multipliers meet in one."""


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
    point : ResponseCurve
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
        Gap coefficients, or the slow gap's (``ResponseCurve.points``); of exact orbits
        (2 n_modes,) in units of their own.
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
class ResponseCurve(ObservedMotion, Tabular):
    """Solutions along a curve, in the order in which it was followed: of harmonic balance, or exact
    periodic orbits.

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
    points : (n, 2H+1, n_pairs) [m], or (n, 2 n_modes)
        Of harmonic balance the gap coefficients, or those of the slow gap s = g + R_inf lambda
        where pairs are seen through R_inf; with friction (n, 2H+1, 2 n_pairs), tangential gaps
        behind the normal ones. Of exact orbits modal displacements and velocities at phase zero, in
        the modes of the structure as the parameter varies it.
    tolerance : float or None
        Error to which :meth:`solution` keeps the Fourier coefficients of exact orbits; None: the
        points solve the truncated equations of harmonic balance.
    samples : int or None
        As given when it was followed.
    static_above : float or None
        Of harmonic balance with a residual flexibility R_inf, the same for all points: the
        frequency [rad/s] above which modes are quasi-static (:class:`fenics_crack.Problem`).
    multipliers : (n,) complex or None
        Floquet multiplier of largest modulus at each point, of a pair the one with positive
        imaginary part, of an irregular motion the growth of a small disturbance; nan where it does
        not decide the stability (:func:`judge_curve`); None: not assessed.
    irregular : (n,) bool or None
        True where no orbit was found and the exact motion is irregular; None: nowhere.
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
    points: np.ndarray
    tolerance: float | None = None
    samples: int | None = None
    static_above: float | None = None
    multipliers: np.ndarray | None = None
    irregular: np.ndarray | None = None
    branch: bool = False

    KIND: ClassVar[str] = "response curve"
    frequency = hertz_of()

    def __len__(self) -> int:
        return len(self.omega)

    @property
    def exact(self) -> bool:
        """True if its points are exact orbits."""
        return self.tolerance is not None

    @property
    def harmonics(self) -> int:
        """H; of exact orbits the fewest of a solution."""
        if not self.exact:
            return self.points.shape[1] // 2
        least = least_harmonics(self.structure, self.subharmonic)
        return max(MIN_HARMONICS * self.subharmonic, least)

    @property
    def method(self) -> str:
        """Method by which the points were found, in words: "H = 5", "exact orbits"."""
        return "exact orbits" if self.exact else f"H = {self.harmonics}"

    @cached_property
    def problem(self) -> Problem:
        """Problem solved at the first point."""
        structure = self.structure
        if self.parameter == "speed" and isinstance(structure, RunUpStructure):
            structure = structure.at_speed(float(self.values[0]))
        return Problem(
            structure, float(self.omega[0]), self.contact, self.harmonics,
            self.samples, self.subharmonic, self.static_above,
        )  # fmt: skip

    @cached_property
    def system(self) -> Waves | Orbits:
        """The equations along the parameter: from its value at the first point to the one farthest
        from there."""
        farthest = int(np.argmax(np.abs(self.values - self.values[0])))
        ends = float(self.values[0]), float(self.values[farthest])
        return system_along(self.exact, self.problem, self.parameter, *ends)

    # --- its points -------------------------------------------------------------------------------

    def problem_at(self, value: float) -> Problem:
        """Return the problem at a value of the parameter."""
        return WAVES[self.parameter].vary(self.problem, value)

    def problem_of(self, index: int) -> Problem:
        """Return the problem solved at a point, of the structure as the parameter varies it."""
        problem, omega = self.problem_at(float(self.values[index])), float(self.omega[index])
        return problem if problem.omega == omega else replace(problem, omega=omega)

    def solution(self, index: int, *, search: bool = True) -> PeriodicSolution:
        """The solution at a point, with its displacement and error report; without ``search`` for
        its exact orbit the report is what one Newton step predicts. Of an exact orbit its Fourier
        series, as long as the tolerance requires; nothing is searched for."""
        if self.tolerance is not None:
            if index not in self._solutions:
                problem, orbit = self.problem_of(index), self.orbit(index)
                self._solutions[index] = solution_of_orbit(problem, orbit, self.tolerance)
            return self._solutions[index]
        problem, at = self._balanced(index)
        known = Assessment(problem.wave(at), flow=self._flow)
        return solution_of(problem, at, status="point of a curve", search=search, known=known)

    @cached_property
    def _solutions(self) -> dict[int, PeriodicSolution]:
        """Solutions of exact orbits that have been asked for, by point."""
        return {}

    def _balanced(self, index: int) -> tuple[Problem, ContactPoint]:
        """The problem at a point of harmonic balance, and its equations there."""
        problem, along = self.problem_of(index), self.system
        if isinstance(along, ResonanceWaves) or not isinstance(along, Waves):
            system = problem.system(problem.compliance())
        else:
            system = along.system(float(self.values[index]))
        return problem, system.linearise(self.points[index])

    @cached_property
    def _flow(self) -> ContactFlow | None:
        """The exact flow of all points where the parameter leaves the structure and its load."""
        fixed = self.parameter == "omega"
        return flow_of(self.structure, self.contact) if fixed else None

    def orbit(self, index: int) -> PeriodicOrbit:
        """The exact orbit at a point; InputError on a curve of harmonic balance."""
        if not isinstance(self.system, Orbits):
            raise InputError("curve", self.method, "one of exact orbits")
        flow, omega = self.system.flow(float(self.values[index])), float(self.omega[index])
        iterations = int(self.iterations[index])
        return orbit_from(flow, omega, self.points[index], self.subharmonic, iterations)

    def assessment(self, index: int) -> Assessment:
        """Return the assessment of a point of harmonic balance by the exact flow; no error is
        estimated."""
        return next(self.assessments([index]))

    def assessments(self, places: Sequence[int]) -> Iterator[Assessment]:
        """The same of some points; over the frequency their motions are computed at once."""
        if self._flow is None or not isinstance(self.system, Waves):
            for problem, at in map(self._balanced, places):
                yield Assessment(problem.wave(at))
            return
        along = self.system
        first, some = along.system(along.start), max(1, along.at_once)
        for part in (places[at : at + some] for at in range(0, len(places), some)):
            slow, omega = self.points[part], self.omega[part]
            forces = np.stack([first.integrals.force(one) for one in slow], axis=1)
            moved = along.compliance(along.start).displacements(omega / self.subharmonic, forces)
            for place, unknown in enumerate(slow):
                force = np.ascontiguousarray(forces[:, place])
                wave = along.problem.wave_of(moved[:, place], first.gap(unknown, force), force)
                yield Assessment(replace(wave, omega=float(omega[place])), flow=self._flow)

    @cached_property
    def gap_coefficients(self) -> np.ndarray:
        """Closing of the pairs: (n, 2H+1, n_pairs) [m]; of exact orbits by their exact integrals,
        with 40 harmonics of their period."""
        count, places = self.structure.n_pairs, range(len(self))
        if self.exact:
            found = [self.orbit(place).coefficients(OBSERVED_HARMONICS).gap for place in places]
            return np.array(found)[..., :count]
        if self.static_above is None:
            return self.points[..., :count]
        return np.array([known.wave.gap_coefficients for known in self.assessments(places)])

    def records(self, rows: np.ndarray) -> Iterator[Record]:
        places = range(len(self))
        motions: Iterator[PeriodicOrbit | PeriodicSolution]
        if self.exact:
            motions = map(self.orbit, places)
        else:
            every = self.assessments(places)
            motions = (PeriodicSolution(**vars(one.wave), assessment=one) for one in every)
        for motion in motions:
            yield from motion.records(rows, CURVE_INSTANTS)

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
            raise AttributeError(
                "stability: unknown of a curve followed with stability = False; "
                "fc.judge_curve(curve) returns the curve with it"
            )
        return np.asarray(np.abs(self.multipliers) < 1.0 - MULTIPLIER_TOLERANCE)

    @property
    def undecided(self) -> np.ndarray | None:
        """Points of undecided stability, for a :meth:`reason`: (n,) bool; None: not assessed."""
        if self.multipliers is None:
            return None
        return np.asarray(~(np.abs(np.abs(self.multipliers) - 1.0) > MULTIPLIER_TOLERANCE))

    @property
    def verdicts(self) -> np.ndarray:
        """Stable, unstable, irregular or undecided, at each point: (n,) str; raises as
        :attr:`stable`."""
        decided = np.where(self.stable, "stable", "unstable")
        if self.irregular is not None:
            decided = np.where(self.irregular, "irregular", decided)
        return np.where(self.undecided, "undecided", decided)

    def reason(self, index: int) -> str:
        """Why the stability is undecided at a point, as :func:`fenics_crack.floquet` says of the
        point's solution by itself; "" where it is decided."""
        if self.undecided is None or not self.undecided[index]:
            return ""
        if self.exact:
            return "its largest multiplier is 1 to its accuracy"
        if self.undecided.all():
            return "no exact orbit is accepted for any point of the curve"
        return self.assessment(index).reason or "its largest multiplier is 1 to rounding"

    @property
    def resolution(self) -> float:
        """Width, in the unit of ``values``, of the unstable or doubled windows that a curve of
        exact orbits may miss between its points: a tenth of the longest step taken."""
        return RESOLUTION * float(np.abs(np.diff(self.values)).max(initial=0.0))

    # --- parts of it ------------------------------------------------------------------------------

    def part(self, places: Sequence[int] | slice) -> Self:
        """The points at some places, without the bifurcations."""
        columns = {name: column[places] for name, column in _arrays_of(self).items()}
        return replace(self, **columns, bifurcations=())

    def bifurcation(
        self, kind: str, value: float, omega: float, point: np.ndarray,
        multipliers: np.ndarray | None = None,
    ) -> Bifurcation:  # fmt: skip
        """A special point of this curve, by its value of the parameter and its load frequency."""
        columns = {"values": value, "omega": omega, "iterations": 0, "points": point}
        rows = {name: np.array([entry]) for name, entry in columns.items()}
        first = None if multipliers is None else np.array([leading(multipliers)])
        alone = replace(self, **rows, multipliers=first, irregular=None, bifurcations=())
        return Bifurcation(kind, alone, multipliers)

    @cached_property
    def at_bifurcations(self) -> Self:
        """The first point, the bifurcations and the last point, to be measured: a curve of their
        own, with multipliers if it has exact orbits."""
        whole = self if self.exact else replace(self, multipliers=None, irregular=None)
        special = [one.point for one in self.bifurcations]
        points: list[ResponseCurve] = [whole.part([0]), *special, whole.part([-1])]
        columns = [_arrays_of(one) for one in points]
        joined = {name: np.concatenate([one[name] for one in columns]) for name in columns[0]}
        return replace(whole, **joined, bifurcations=())

    def nearest(self, bifurcation: Bifurcation) -> int:
        """The number of the point nearest to a bifurcation."""
        there = bifurcation.point.points
        off = np.linalg.norm((self.points - there).reshape(len(self), -1), axis=1)
        off /= float(np.linalg.norm(there)) or 1.0
        wide = float(np.ptp(self.values)) or 1.0
        return int(np.argmin(np.hypot(off, (self.values - bifurcation.value) / wide)))

    def coefficients_at(self, dof: int | None = None) -> np.ndarray:
        """Coefficients of the displacement of a dof, or of the watched one, at every point:
        (n, 2H+1) [m]."""
        return self.observe([dof])[0][0].coefficients

    def _gather(self, values: list[Any]) -> np.ndarray:
        return np.array(values)

    def top(self, dof: int | None = None) -> Top:
        """Find where the largest response of a dof, or of the watched one, is and how large;
        :meth:`peak` examines it, too."""
        amplitude = self.amplitude(dof)
        index = int(np.argmax(amplitude))
        value, height, _ = top_and_damping(self.values, amplitude, index)
        return Top(index, value, height, index in (0, len(self) - 1))

    def peak(self, dof: int | None = None) -> Peak:
        """The largest response of a dof, or of the watched one: where, how large, how sure, whether
        stable, and the damping by its width."""
        top = self.top(dof)
        omega, solution, damping = float(self.omega[top.index]), self.solution(top.index), math.nan
        if self.parameter in ("omega", "speed"):
            waves, structure = self.coefficients_at(dof), self.structure
            damping = damping_by_width(self.values, waves, self.subharmonic, top.index)
            if isinstance(structure, RunUpStructure):
                # Natural frequencies follow the load's, and it takes longer to pass them.
                there = structure.at_speed(float(self.values[top.index]))
                damping *= 1.0 - there.stiffening(omega)
            omega *= top.value / float(self.values[top.index])
        if self.multipliers is None:
            verdict = floquet(solution.structure, solution).verdict
        else:
            verdict = str(self.verdicts[top.index])
        error = solution.report.displacement
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
        if self.exact:
            orbit, problem = self.orbit(index), self.problem_of(index)
            wave = wave_of(problem, orbit, orbit.coefficients(problem.harmonics))
            more = wave.assessment.more_modes
            if more is not None:
                return UNKNOWN if more.errors is None else more.errors[1]
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
