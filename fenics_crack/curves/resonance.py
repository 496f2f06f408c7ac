"""Phase resonance: where the displacement at the load has no part in phase with the load.

What a modal test finds by its phase. Of the damped structure under its own load, with contact: the
unknowns of the condensed equations F(s, v, w) = 0 (:mod:`contact_system`) and the load's frequency
w, or the rotor's speed that it follows, along ln v, v the factor of all of the load but its mean,

    F(s, v, w) = 0,        Re P / Im P = 0,        P = f_k^H u_k,

f_k and u_k being the complex coefficients of the harmonic that excites, the load's (of a wheel what
acts on the watched blade) and the displacement's. Re P / Im P is linear in w next to a resonance of
one mode. In the units of e^p, s is constant where all is linear, and the Jacobian is bordered by
one row and one column.

Where it begins: under a small load a crack that the mean load holds open or closed stays so, and
the structure is linear. Pairs that touch at rest without a force breathe under any load; contact is
conewise linear then, and one solution is that at any load. The mode is the one nearest to a
frequency that shows at the load, by the natural frequencies about the state of rest, breathing
pairs at the bilinear one; from there the response is followed over the frequency to where the phase
passes.

Other modes beside it, and other harmonics, shift the phase. U(w) being the displacement along the
load, on the response curve through the point,

    d ln U / dw = -2 i / D       of one mode with the half-power width D,

so that the real part beside the imaginary one is the distance to the top of the curve, over the
width: twice of what the others shift.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np

from fenics_crack.balance.compliance import ModalCompliance
from fenics_crack.balance.contact_system import ContactPoint, ContactSystem
from fenics_crack.balance.problem import Problem, Search
from fenics_crack.balance.solution import PeriodicSolution, Solver, solution_of
from fenics_crack.basics.errors import INTERRUPTED, ConvergenceError, InputError, check_number
from fenics_crack.basics.tables import Described, counted, quantity, with_frequency
from fenics_crack.curves.family import FAMILIES, Family
from fenics_crack.curves.harmonic_curve import HarmonicCurve
from fenics_crack.model.contact import is_unilateral, solve_complementarity, springs_of
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.rotation import RunUpStructure
from fenics_crack.model.structure import Structure
from fenics_crack.model.wheel import Wheel
from fenics_crack.numerics.equations import CENTRAL_STEP, LOCATED, Linearisation, least_residual
from fenics_crack.numerics.newton import PathPoint, point_on_path, solve_near
from fenics_crack.numerics.path import Crossing, Ended, Path, PathOptions, Target

SEVERAL = 0.1
"""Distance of the phase resonance from the top of the curve over the half-power width, from which
on several modes answer: the amplitude is then 2 % below the top."""


MEETINGS = 3
"""Corrections of the speed at which an order meets a mode, each by a quarter of the one before."""


LONGEST = 0.5
"""Longest step over the logarithm of the load, relative to the size of the motion, where the end is
all that is sought."""
MAX_HARMONICS = 100
"""Maximum harmonics for a tolerance, as of a curve."""


def _spinning(structure: Structure) -> RunUpStructure:
    """A structure that knows itself at every speed."""
    assert isinstance(structure, RunUpStructure)
    return structure


# --- the load and its phase -----------------------------------------------------------------------


@dataclass(frozen=True)
class Drive:
    """The harmonic of a load that excites.

    Attributes
    ----------
    harmonic : int
        k.
    rows : (2, n_dofs) [N]
        Its cosine and sine parts; of a wheel those on the watched blade.
    """

    harmonic: int
    rows: np.ndarray

    @classmethod
    def of(cls, structure: Structure, harmonic: int) -> Drive:
        """That of a structure."""
        part, whole = slice(2 * harmonic - 1, 2 * harmonic + 1), structure.whole
        if not isinstance(whole, Wheel):
            return cls(harmonic, structure.force[part])
        numbers = whole.own_numbers(whole.first)
        force = whole.force[part, numbers[numbers >= 0]]
        loaded = np.flatnonzero(np.any(force, axis=0))
        dofs = numbers[numbers >= 0][loaded].tolist()
        seen = structure.values_at(np.eye(structure.n_dofs), dofs)
        return cls(harmonic, force[:, loaded] @ seen.T)

    def power(self, compliance: ModalCompliance, force: np.ndarray) -> complex:
        """P of contact forces (2H+1, n_pairs) [N m]."""
        return self.of_waves(compliance.seen_through(self.rows, force))

    def of_waves(self, waves: np.ndarray) -> complex:
        """P of coefficients (2H+1, 2) of the products of both rows with the displacement."""
        parts = waves[2 * self.harmonic - 1] - 1j * waves[2 * self.harmonic]
        return complex(parts[0] + 1j * parts[1])


def lag(power: complex) -> float:
    """Re P / Im P."""
    return power.real / power.imag


def change_of_lag(power: complex, change: complex) -> float:
    """Its change with P."""
    return (change.real - lag(power) * change.imag) / power.imag


# --- the equations --------------------------------------------------------------------------------


class LoadedEquations:
    """F(s, v, w), the condensed equations at values of a family's parameter, the load's frequency
    or a rotor's speed, under a load with all but its mean multiplied."""

    def __init__(self, family: Family, drive: Drive) -> None:
        self.family, self.drive = family, drive

    def system(self, value: float, factor: float) -> ContactSystem:
        """The equations."""
        whole = self.family.system(value)
        assert isinstance(whole.compliance, ModalCompliance)
        return ContactSystem(whole.compliance.driven(factor), whole.integrals)

    def by_value(self, value: float, factor: float, at: ContactPoint) -> tuple[np.ndarray, complex]:
        """dF/dw and dP/dw for fixed s: over the speed, with which modes change, by central
        differences."""
        if self.family.name == "omega":
            compliance = compliance_of(at)
            by_omega = compliance.derivative("omega", at.force)
            return by_omega, self.drive.of_waves(
                compliance.seen_by_omega(self.drive.rows, at.force)
            )
        step = CENTRAL_STEP * value
        ends = []
        for there in (value - step, value + step):
            point = self.system(there, factor).linearise(at.unknown)
            ends.append((point.residual, self.power(point)))
        (before, low), (after, high) = ends
        return (after - before) / (2.0 * step), (high - low) / (2.0 * step)

    def power(self, at: ContactPoint) -> complex:
        """P."""
        return self.drive.power(compliance_of(at), at.force)

    def power_by(self, at: ContactPoint, change: np.ndarray) -> complex:
        """Change of P with s, at a fixed frequency."""
        compliance, force = compliance_of(at), at.force_of(change)
        return self.drive.power(compliance, force) - self.power_of_load(at)

    def power_of_load(self, at: ContactPoint) -> complex:
        """P without contact forces, dP / d ln v."""
        return self.drive.power(compliance_of(at), np.zeros_like(at.force))


def compliance_of(at: ContactPoint) -> ModalCompliance:
    """That of a small structure."""
    assert isinstance(at.system.compliance, ModalCompliance)
    return at.system.compliance


class ResonanceSystem:
    """Phase resonance along p = ln v: unknowns s / (size e^p), and the frequency or speed over a
    reference."""

    def __init__(self, equations: LoadedEquations, value: float, size: float) -> None:
        self.equations, self.value, self.size = equations, value, size
        first = equations.system(value, 1.0)
        self.rows = first.shape
        self.means = int(first.shape[1])
        self._steepest = first.steepest_force(first.integrals.law)

    def unknown(self, slow: np.ndarray, value: float, parameter: float) -> np.ndarray:
        """Unknowns of s and a frequency or speed."""
        return np.append(slow / (self.size * math.exp(parameter)), value / self.value)

    def parts(self, unknown: np.ndarray, parameter: float) -> tuple[np.ndarray, float]:
        """s, and the frequency or speed."""
        slow = unknown[:-1].reshape(self.rows) * (self.size * math.exp(parameter))
        return slow, float(unknown[-1]) * self.value

    def linearise(self, unknown: np.ndarray, parameter: float) -> ResonancePoint:
        slow, value = self.parts(unknown, parameter)
        at = self.equations.system(value, math.exp(parameter)).linearise(slow)
        return ResonancePoint(self, unknown, parameter, at)

    def rounding(self, parameter: float) -> float:
        """Return the rounding error of |F| / |x|."""
        system = self.equations.system(self.value, 1.0)
        largest = float(np.abs(system.moving).sum(axis=2).max())
        return least_residual(4.0 * largest * self._steepest)


class ResonancePoint(Linearisation):
    """:class:`ResonanceSystem` at a point."""

    def __init__(
        self, system: ResonanceSystem, unknown: np.ndarray, parameter: float, at: ContactPoint
    ) -> None:
        self.system, self.unknown, self.at = system, unknown, at
        self.scale, self.factor = system.size * math.exp(parameter), math.exp(parameter)
        self.value = float(unknown[-1]) * system.value
        self.power = system.equations.power(at)

    @property
    def problem(self) -> Problem:
        """What it balances."""
        problem = self.system.equations.family.at(self.value)
        return problem if self.factor == 1.0 else FAMILIES["resonance"].vary(problem, self.factor)

    @cached_property
    def residual(self) -> np.ndarray:  # type: ignore[override]
        return np.append(self.at.residual / self.scale, lag(self.power))

    @cached_property
    def _column(self) -> tuple[np.ndarray, complex]:
        """dF/dw and dP/dw."""
        return self.system.equations.by_value(self.value, self.factor, self.at)

    @cached_property
    def over_frequency(self) -> np.ndarray:
        """ds/dw along the response curve through the point."""
        return -self.at.solve(self._column[0])

    @cached_property
    def power_over_frequency(self) -> complex:
        """dP/dw along it."""
        return self._column[1] + self.system.equations.power_by(self.at, self.over_frequency)

    def solve(self, right: np.ndarray) -> np.ndarray:
        change = self.at.solve(right[:-1].reshape(self.at.unknown.shape)) * self.scale
        left = right[-1] - self._row(change)
        rise = left / change_of_lag(self.power, self.power_over_frequency)
        slow = (change + rise * self.over_frequency) / self.scale
        return np.append(slow, rise / self.system.value)

    def _row(self, change: np.ndarray) -> float:
        return change_of_lag(self.power, self.system.equations.power_by(self.at, change))

    @cached_property
    def by_parameter(self) -> np.ndarray:  # type: ignore[override]
        at, compliance = self.at, compliance_of(self.at)
        by_load = compliance.derivative("load", np.zeros_like(at.force))
        by_load[0] = 0.0  # the mean load stays
        change = (at.apply(at.unknown) + by_load - at.residual) / self.scale
        of_power = self.system.equations.power_of_load(at)
        lean = self._row(at.unknown) + change_of_lag(self.power, of_power)
        return np.append(change, lean)

    @property
    def sign(self) -> float:
        rise = change_of_lag(self.power, self.power_over_frequency)
        return self.at.sign * float(np.sign(rise))

    # --- what there is to see ---------------------------------------------------------------------

    @property
    def width(self) -> float:
        """D, the half-power width of one mode that would answer like this, in the unit of the
        frequency or speed."""
        return -2.0 / (self.power_over_frequency / self.power).imag

    @property
    def apart(self) -> float:
        """Distance from here to the top of the response curve, over the width, as two modes would
        have it."""
        return 0.25 * self.width * (self.power_over_frequency / self.power).real


# --- at rest --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class AtRest:
    """State of rest of a small structure under its mean load, and the natural frequencies about it.

    Attributes
    ----------
    pressed, idle : (n_pairs,) of bool
        Pairs that are pressed, and that touch without a force; the others are open.
    rest : (n_pairs,)
        Forces of pressed pairs [N], openings of the others [m].
    """

    problem: Problem
    pressed: np.ndarray
    idle: np.ndarray
    rest: np.ndarray

    @classmethod
    def of(cls, problem: Problem) -> AtRest:
        """That of a problem."""
        static = [ModalCompliance(problem.seen, 0.0, row[None]) for row in problem.structure.force]
        (gap,), count = static[0].linear_gap, problem.structure.n_pairs
        still = static[0].matrices[0].real + np.diag(springs_of(problem.contact, count))
        force = np.zeros(count)
        clearance = problem.structure.clearance
        moved = max(float(np.abs(one.linear_gap + clearance).max()) for one in static[1:])
        if np.any(gap > LOCATED * moved):
            force = solve_complementarity(still, gap)
        pressed = force > 0.0
        opening = still @ force - gap
        idle = ~pressed & (opening <= LOCATED * moved)
        return cls(problem, pressed, idle, np.where(pressed, force, opening))

    def modes(self, bonded: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Natural frequencies (n,) [rad/s], and shapes in modal coordinates (n_modes, n), with some
        pairs bonded, through the springs of their law."""
        modes = all_modes(self.problem.structure)
        found, tie = np.diag(modes.squares), modes.pairs[:, bonded]
        if bonded.any():
            found = found + tie @ self._between(bonded) @ tie.T
        squares, shapes = np.linalg.eigh(found)
        return np.sqrt(np.maximum(squares, 0.0)), shapes

    def _between(self, bonded: np.ndarray) -> np.ndarray:
        """Stiffness of bonded pairs against what moves with the modes."""
        modes, count = all_modes(self.problem.structure), self.problem.structure.n_pairs
        soft = np.diag(springs_of(self.problem.contact, count))
        if modes.residual is not None:
            soft = soft + modes.residual
        return np.linalg.pinv(soft[np.ix_(bonded, bonded)])

    def held_to(self, shape: np.ndarray, amplitude: float) -> float:
        """Factor of the load up to which a mode (n_modes,) of an amplitude changes no pair but idle
        ones."""
        modes = all_modes(self.problem.structure)
        motion = modes.pairs.T @ shape * amplitude
        change = np.abs(motion)
        change[self.pressed] = np.abs(self._between(self.pressed) @ motion[self.pressed])
        kept = ~self.idle & (change > 0.0)
        return float((self.rest[kept] / change[kept]).min(initial=math.inf))


@dataclass(frozen=True)
class Guess:
    """A resonance as the natural frequencies about the state of rest have it.

    Attributes
    ----------
    omega, range : float [rad/s]
        Of the load, and a distance within which it is sought.
    harmonic : int
        Of the load that excites.
    factor : float
        Of the load, up to which no pair changes but those that touch at rest.
    """

    omega: float
    range: float
    harmonic: int
    factor: float


def nearest_mode(problem: Problem, omega: float) -> Guess:
    """The resonance nearest to a load frequency of those that show in the phase at the load.

    A mode shows if its own response at its resonance is above what all others answer there.
    """
    rest, modes = AtRest.of(problem), all_modes(problem.structure)
    natural, shapes = rest.modes(rest.pressed)
    bonded, others = rest.modes(rest.pressed | rest.idle)
    partner = np.argmax((shapes.T @ others) ** 2, axis=1)
    breathing = 2.0 * natural * bonded[partner] / (natural + bonded[partner])
    damping = modes.damping if modes.damping.ndim == 1 else np.diag(modes.damping)
    rates = damping @ shapes**2  # 2 xi w
    found: list[Guess] = []
    for harmonic in range(1, len(problem.structure.force) // 2 + 1):
        drive = Drive.of(problem.structure, harmonic)
        own = Drive(harmonic, problem.structure.force[2 * harmonic - 1 : 2 * harmonic + 1])
        pull = (own.rows[0] - 1j * own.rows[1]) @ modes.shapes @ shapes
        seen = (drive.rows[0] + 1j * drive.rows[1]) @ modes.shapes @ shapes
        for mode in np.flatnonzero(pull * seen).tolist():
            if natural[mode] == 0.0 or rates[mode] <= 0.0:
                continue
            answers = pull * seen / (natural**2 - natural[mode] ** 2 + 1j * natural[mode] * rates)
            if abs(answers.sum() - answers[mode]) > 0.5 * abs(answers[mode]):
                continue
            amplitude = abs(pull[mode]) / (natural[mode] * rates[mode])
            factor = rest.held_to(shapes[:, mode], amplitude)
            wide = 4.0 * rates[mode] + 2.0 * abs(bonded[partner[mode]] - natural[mode])
            wide = min(wide, 0.5 * breathing[mode])
            found.append(Guess(breathing[mode] / harmonic, wide / harmonic, harmonic, factor))
    if not found:
        raise InputError("load", "no mode answers to it", "one that moves a damped mode")
    return min(found, key=lambda one: abs(one.omega - omega))


# --- where it begins ------------------------------------------------------------------------------


class _OverFrequency:
    """F at a fixed factor of the load along p = (w - w_0) / range, to find where the phase
    passes."""

    def __init__(
        self, equations: LoadedEquations, factor: float, value: float, wide: float
    ) -> None:
        self.equations, self.factor, self.origin, self.range = equations, factor, value, wide
        self.means = int(equations.system(value, factor).shape[1])

    def value(self, parameter: float) -> float:
        """Frequency or speed."""
        return self.origin + parameter * self.range

    def linearise(self, unknown: np.ndarray, parameter: float) -> ContactPoint:
        value = self.value(parameter)

        def by_parameter(at: ContactPoint) -> np.ndarray:
            return self.range * self.equations.by_value(value, self.factor, at)[0]

        return self.equations.system(value, self.factor).along(unknown, by_parameter)

    def phase(self, point: PathPoint) -> complex:
        """P / |P|: -i at resonance, its parts as large as each other at the half power."""
        power = self.equations.power(self.linearise(point.unknown, point.parameter))
        return power / abs(power)


class _Passing(Crossing):
    """Resonance between two points, where a path ends."""

    terminal, sought, words = True, True, Ended.MET.value


def first_resonances(
    equations: LoadedEquations, value: float, wide: float, factor: float
) -> Iterator[tuple[np.ndarray, float]]:
    """s and the frequency or speed within the half-power width of the phase resonance next to a
    guess, under a part of the load, followed over the frequency in the direction that the phase
    shows; the last ones are at the resonance itself.

    Raises
    ------
    ConvergenceError
        No solution was found next to the guess.
    """
    family = _OverFrequency(equations, factor, value, wide)
    system, problem = equations.system(value, factor), equations.family.at(value)
    search = Search(system, problem, Solver.residual_tolerance, 1.0)
    start = search.solve().unknown
    if not search.converged:
        raise ConvergenceError(f"resonance: no solution next to it: {search.status}")
    here = point_on_path(family, start, 0.0)
    if family.phase(here).real < 0.0:
        here = replace(here, tangent=here.tangent.reversed())
    passing = _Passing(lambda point: family.phase(point).real)
    path = Path(family, here, PathOptions(0.05, 0.3, span=(-1.0, 1.0)), [passing])
    for point in chain([here], path.points()):
        phase = family.phase(point)
        if abs(phase.real) <= -phase.imag:
            yield point.unknown, family.value(point.parameter)


# --- the resonance --------------------------------------------------------------------------------


@dataclass(frozen=True, repr=False)
class Resonance(Described):
    """The phase resonance of a structure under its load.

    Attributes
    ----------
    value : float
        Load frequency, or speed of the rotor [rad/s].
    omega : float
        Load frequency [rad/s].
    harmonic : int
        Harmonic of the load that excites.
    width : float
        Half-power width in the unit of ``value``.
    apart : float
        Distance to the top of the response curve over the width, as far as the point shows it.
    solution : PeriodicSolution
        The motion there.
    error : float
        Estimated truncation error of the amplitude, relative to it; inf where it is not known,
        nan without a tolerance.
    """

    value: float
    omega: float
    harmonic: int
    width: float
    apart: float
    solution: PeriodicSolution
    error: float = math.nan

    @property
    def several(self) -> bool:
        """True if several modes shift the phase by more than a tenth of the width: the curve shows
        where the largest response is."""
        return not abs(self.apart) <= SEVERAL

    @property
    def damping(self) -> float:
        """Ratio of critical damping by the width; over a speed it is that over 1 - d ln w / d ln W,
        as of any width there."""
        return self.width / (2.0 * self.value)

    def to_dict(self) -> dict[str, Any]:
        """Frequencies, the width, the distance to the top, the amplitude and its error."""
        found = {"value": self.value, "omega": self.omega, "harmonic": self.harmonic}
        found |= {"width": self.width, "apart": self.apart, "several": self.several}
        found |= {"amplitude": self.solution.amplitude(), "error": self.error}
        return with_frequency(found)

    def _title(self) -> str:
        parts = [
            f"{self.omega / (2.0 * math.pi):.6g} Hz ({self.omega:.6g} rad/s)",
            f"half-power damping {self.damping:.3g}",
            f"{quantity(self.solution.amplitude(), 'm')} half peak-to-peak",
            f"H = {self.solution.harmonics}",
        ]
        if not math.isnan(self.error):
            parts.append(f"error {self.error:.2g}" if self.error < math.inf else "error unknown")
        several = ["several modes answer together: see the curve"] * self.several
        return ", ".join([*parts, *several])


@dataclass(frozen=True)
class Begun:
    """Where the path over the load begins: a small load, or the structure's own."""

    system: ResonanceSystem
    here: PathPoint

    @classmethod
    def of(
        cls,
        problem: Problem,
        near: float | None = None,
        parameter: str = "omega",
        factor: float = 1.0,
    ) -> Begun:
        """At the mode nearest to a load frequency, by default the problem's, under a part of the
        load, or less where that changes the pairs."""
        if problem.friction or not is_unilateral(problem.contact):
            allowed = "the penalty law or the constraint, without friction, for a phase resonance"
            raise InputError("contact", problem.contact, allowed)
        if problem.subharmonic != 1:
            raise InputError("subharmonic", problem.subharmonic, "1 for a phase resonance")
        if not is_small(problem.structure):
            reduced = reduce_structure(problem.structure, method="massless")
            problem = replace(problem, structure=reduced)
        near = problem.omega if near is None else near
        guess = nearest_mode(problem, near)
        for _ in range(MEETINGS if parameter == "speed" else 0):
            speed = _spinning(problem.structure).speed * guess.omega / problem.omega
            problem = FAMILIES[parameter].vary(problem, speed)
            guess = nearest_mode(problem, guess.omega)
        omega, wide = guess.omega, guess.range
        equations = LoadedEquations(
            FAMILIES["omega"](problem, omega - wide, omega + wide),
            Drive.of(problem.structure, guess.harmonic),
        )
        factor = min(factor, guess.factor)
        for slow, there in first_resonances(equations, omega, wide, factor):
            with suppress(ConvergenceError):
                return cls.at(equations, slow, there, factor)
        raise ConvergenceError(
            f"resonance: the phase at the load does not pass through it next to {omega:.6g} rad/s: "
            "several modes answer together"
        )

    @classmethod
    def at(cls, equations: LoadedEquations, slow: np.ndarray, value: float, factor: float) -> Begun:
        """Next to a solution under a part of the load."""
        size = float(np.linalg.norm(slow[1:])) / factor
        system, begin = ResonanceSystem(equations, value, size), math.log(factor)
        sharp = max(LOCATED, system.rounding(begin))
        start = solve_near(system, system.unknown(slow, value, begin), begin, tolerance=sharp)
        if start is None:
            raise ConvergenceError("resonance: lost next to its first point")
        return cls(system, point_on_path(system, start.unknown, begin))

    def followed(self, end: float) -> Begun:
        """At the logarithm of another factor of the load."""
        if self.here.parameter == end:
            return self
        options = PathOptions(0.1, LONGEST)
        path = self.path(end, options)
        if path.run() is None:
            assert path.ended is not None
            raise ConvergenceError(
                f"resonance: {path.ended.in_words(options.max_steps)} at the load times "
                f"{math.exp(path.last.parameter):.3g}"
            )
        return replace(self, here=path.last)

    def over_speed(self) -> Begun:
        """The same where the rotor's speed, and with it the modes, follow the frequency."""
        problem = self.system.equations.family.problem  # of the order at its own speed
        speed = _spinning(problem.structure).speed
        value = speed * self._point.value / problem.omega
        ends = sorted((speed, 2.0 * value - speed))
        return self._with(FAMILIES["speed"](problem, *ends), value)

    def with_harmonics(self, harmonics: int) -> Begun:
        """The same with other harmonics."""
        family, point = self.system.equations.family, self._point
        problem = replace(family.problem, harmonics=harmonics, static_above=None)
        return self._with(type(family)(problem, family.start, family.end), point.value)

    def within(
        self, tolerance: float, near: float | None, error: float = math.inf
    ) -> tuple[Begun, float]:
        """The same with so many harmonics that its error is below a tolerance, or as many as a
        curve may have or as lead to a resonance; and that error, inf where it is not
        known.

        It is what half as many harmonics change, of the amplitude and of the frequency by what
        lowers that as much, or what the exact flow predicts of the displacement, if that is more:
        many harmonics may change nothing until one meets a mode. Where no resonance is next to
        that with fewer harmonics, it is sought anew."""
        problem, end = self.system.equations.family.problem, self.here.parameter
        harmonics = 2 * problem.harmonics
        if harmonics > MAX_HARMONICS:
            return self, error
        more = None
        with suppress(ConvergenceError):
            more = self.with_harmonics(harmonics)
        if more is None:
            again = replace(problem, harmonics=harmonics, static_above=None)
            with suppress(ConvergenceError):
                more = Begun.of(again, near, factor=math.exp(end)).followed(end)
        if more is None:
            return self, error
        before, behind = self.resonance, more.resonance
        change = abs(behind.solution.amplitude() / before.solution.amplitude() - 1.0)
        change += 2.0 * ((behind.value - before.value) / behind.width) ** 2
        change = max(float(change), behind.solution.report.displacement)
        return (more, change) if change <= tolerance else more.within(tolerance, near, change)

    def _with(self, family: Family, value: float) -> Begun:
        """With the equations of another family at a value of its parameter."""
        equations = LoadedEquations(family, self.system.equations.drive)
        factor, at = math.exp(self.here.parameter), self._point.at
        slow = equations.system(value, factor).slow(at.gap, at.force)
        return Begun.at(equations, slow, value, factor)

    @cached_property
    def _point(self) -> ResonancePoint:
        return self.system.linearise(self.here.unknown, self.here.parameter)

    def path(self, end: float, options: PathOptions) -> Path:
        """To a factor of the load, by its logarithm."""
        here, ends = self.here, sorted((self.here.parameter, end))
        if end < here.parameter:
            here = replace(here, tangent=here.tangent.reversed())
        # One that goes on to e times as much, or as little, is left.
        options = replace(options, span=(ends[0] - 1.0, ends[1] + 1.0))
        return Path(self.system, here, options, [Target(end)])

    @cached_property
    def resonance(self) -> Resonance:
        """The resonance here."""
        at, equations = self._point, self.system.equations
        return Resonance(
            at.value, at.problem.omega, equations.drive.harmonic, at.width, at.apart,
            solution_of(at.problem, at.at, status="phase resonance", search=False),
        )  # fmt: skip


def resonance_at(
    problem: Problem,
    near: float | None = None,
    parameter: str = "omega",
    *,
    tolerance: float | None = None,
) -> Resonance:
    """Find the phase resonance of the mode nearest to a load frequency, under the load as it is.

    There the displacement at the load has no part in phase with the load, as in a modal test: next
    to the largest response, unless several modes answer together, which is said.

    Parameters
    ----------
    problem : Problem
        Structure, law, harmonics, and a load frequency. A structure with many dofs is reduced
        first, to crack faces without mass.
    near : float, optional
        Load frequency [rad/s]; default: the problem's.
    parameter : "omega" or "speed"
        What follows the resonance: the load's frequency, or the speed of a rotor of
        :func:`fenics_crack.run_up_structure`, whose modes are those of each speed.
    tolerance : float, optional
        Take more harmonics, twice as many each time, until the estimated error of the amplitude is
        below this.

    Returns
    -------
    Resonance
        Its frequency, its width, and the motion there.

    Raises
    ------
    InputError
        An argument cannot be used, or no damped mode answers to the load.
    ConvergenceError
        The phase at the load does not pass next to the mode, or the path over the load ended.

    Examples
    --------
    >>> found = fc.resonance_at(fc.Problem(structure, 2000.0, contact), tolerance=0.01)
    >>> found.omega, found.solution.amplitude(), found.several
    """
    begun, error = Begun.of(problem, near, parameter).followed(0.0), math.nan
    if tolerance is not None:
        begun, error = begun.within(tolerance, near)
    if parameter == "speed":
        begun = begun.over_speed()
    return replace(begun.resonance, error=error)


def follow_resonance(
    problem: Problem,
    start: float,
    end: float,
    *,
    near: float | None = None,
    tolerance: float | None = None,
    longest_step: float = 0.1,
    most_points: int = 1000,
    throw: bool = True,
) -> HarmonicCurve:
    """Follow the phase resonance of a mode over the load.

    Parameters
    ----------
    problem, near
        As in :func:`resonance_at`.
    tolerance : float, optional
        Take as many harmonics as this error requires at the end.
    start, end : float
        Factors of all of the load but its mean, above 0.
    longest_step : float
        Relative to the size of the motion, and of the logarithm of the load.
    most_points : int
        Give up after so many.
    throw : bool
        Raise if the end is not reached; else return what was found, ``complete`` being False.
        Ctrl-C always returns what was found.

    Returns
    -------
    HarmonicCurve
        With the parameter "resonance": a factor and the load frequency of each point. Its status
        says at how many points several modes answer together.

    Raises
    ------
    InputError
        An argument cannot be used.
    ConvergenceError
        No first point, or the end was not reached; what was found is its ``found``.

    Examples
    --------
    >>> curve = fc.follow_resonance(fc.Problem(structure, 2000.0, contact), 0.1, 10.0)
    """
    for name, value in ("start", start), ("end", end):
        check_number(name, value, 0.0, above=True)
    if start == end:
        raise InputError("end", end, "different from start")
    begun = Begun.of(problem, near, factor=start).followed(math.log(start))
    if tolerance is not None:
        enough = begun.followed(math.log(end)).within(tolerance, near)[0]
        harmonics = enough.system.equations.family.problem.harmonics
        begun = Begun.of(problem.with_harmonics(harmonics), near, factor=start)
        begun = begun.followed(math.log(start))
    options = PathOptions(0.2 * longest_step, longest_step, max_steps=most_points)
    path, points = begun.path(math.log(end), options), [begun.here]
    status = INTERRUPTED
    with suppress(KeyboardInterrupt):
        points += path.points()
        assert path.ended is not None
        status = path.ended.in_words(most_points)
    complete = path.event is not None
    curve = _curve_of(begun.system, points, complete, status)
    if throw and not complete and status != INTERRUPTED:
        raise ConvergenceError(
            f"resonance over the load from {start:g} to {end:g}: {status} at "
            f"{curve.values[-1]:g} after {len(curve)} points; they are the error's .found",
            found=curve,
        )
    return curve


def _curve_of(
    system: ResonanceSystem, points: list[PathPoint], complete: bool, status: str
) -> HarmonicCurve:
    """Points as a curve."""
    found = [system.linearise(one.unknown, one.parameter) for one in points]
    several = sum(abs(one.apart) > SEVERAL for one in found)
    if several:
        status += f"; at {several} of {counted(len(found), 'point')} several modes answer together"
    problem = system.equations.family.problem
    return HarmonicCurve(
        structure=problem.structure,
        contact=problem.contact,
        parameter="resonance",
        values=np.array([one.factor for one in found]),
        omega=np.array([one.value for one in found]),
        iterations=np.array([one.iterations for one in points]),
        bifurcations=(),
        complete=complete,
        status=status,
        subharmonic=1,
        unknowns=np.array([one.at.unknown for one in found]),
        samples=problem.samples,
        static_above=problem.static_cutoff,
    )
