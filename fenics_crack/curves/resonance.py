"""Phase resonance: where the displacement at the load has no part in phase with the load.

What a modal test finds by its phase. Of the damped structure under its own load, with contact: the
unknowns of the condensed equations F(s, v, w) = 0 (:mod:`contact_system`) and the load's frequency
w, along ln v, v the factor of all of the load but its mean,

    F(s, v, w) = 0,        Re P / Im P = 0,        P = f_k^H u_k,

f_k and u_k being the complex coefficients of the harmonic that excites, the load's (of a wheel what
acts on the watched blade) and the displacement's. Re P / Im P is linear in w next to a resonance of
one mode. In the units of v, s is constant where all is linear, and the Jacobian is bordered by one
row and one column.

The first point is met on the response curve, followed over the frequency from next to the mode
nearest to a frequency (:mod:`natural`): upwards where the displacement is in phase with the load,
else downwards, through folds to the phase's zero.

Other modes beside it, and other harmonics, shift the phase. U(w) being the displacement along the
load, on the response curve through the point,

    d ln U / dw = -2 i / D       of one mode with the half-power width D,

so that the real part beside the imaginary one is the distance to the top of the curve, over the
width: twice of what the others shift.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from fenics_crack.balance.compliance import ModalCompliance
from fenics_crack.balance.contact_system import ContactPoint, ContactSystem
from fenics_crack.balance.natural import Drive, NaturalResonance, nearest_mode
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution, Solver, solution_of
from fenics_crack.basics.errors import (
    INTERRUPTED,
    ConvergenceError,
    InputError,
    check_choice,
    check_number,
)
from fenics_crack.basics.tables import Described, counted, quantity, with_frequency
from fenics_crack.curves.family import FAMILIES, FrequencyFamily
from fenics_crack.curves.harmonic_curve import HarmonicCurve
from fenics_crack.model.contact import is_unilateral
from fenics_crack.model.modal import is_small
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.rotation import RunUpStructure
from fenics_crack.numerics.equations import LOCATED, Linearisation
from fenics_crack.numerics.newton import PathPoint, point_on_path, solve_near
from fenics_crack.numerics.path import ARRIVED, Crossing, Ended, Path, PathOptions, Target

SEVERAL = 0.1
"""Distance of the phase resonance from the top of the curve over the half-power width, from which
on several modes answer: the amplitude is then 2 % below the top."""
MAX_HARMONICS = 100
"""Maximum harmonics for a tolerance, as of a curve."""
TO_PHASE = PathOptions(0.05, 0.3, max_steps=300, at_once=8, span=(-1.0, 1.0))
"""Options of the response curve on which the first point is met. Its parameter is in halves of the
frequency, so that steps are parts of the motion: a stiff stop moves a resonance by a hundred times
its width."""
MEETINGS = 20
"""Maximum corrections by the secant of the speed at which an order meets a resonance."""


class ResonanceSystem:
    """Phase resonance along p = ln v: unknowns s / (size v), and the frequency over a reference.

    ``family``: equations of a load frequency, next to whose start it is sought.
    """

    def __init__(self, family: FrequencyFamily, drive: Drive, slow: np.ndarray) -> None:
        self.family, self.drive, self.omega = family, drive, family.start
        self.size = float(np.linalg.norm(slow[1:]))
        self.means = family.means
        self.load, self.integrals = family.problem.load, family.system(self.omega).integrals

    def rounding(self, parameter: float) -> float:
        """Return the rounding error of |F| / |x|."""
        return self.family.rounding(0.0)

    def linearise(self, unknown: np.ndarray, parameter: float) -> ResonancePoint:
        return ResonancePoint(self, unknown, math.exp(parameter))

    def point(self, slow: np.ndarray, omega: float) -> ResonancePoint:
        """The point at s, under the load itself."""
        return self.linearise(np.append(slow / self.size, omega / self.omega), 0.0)


class ResonancePoint(Linearisation):
    """:class:`ResonanceSystem` at a point, and the response curve through it."""

    def __init__(self, system: ResonanceSystem, unknown: np.ndarray, factor: float) -> None:
        self.system, self.unknown, self.factor = system, unknown, factor
        self.scale, self.omega = system.size * factor, float(unknown[-1]) * system.omega
        load = system.load.copy()
        load[1:] *= factor
        self.compliance = ModalCompliance(system.family.problem.seen, self.omega, load)
        self.at: ContactPoint = ContactSystem(self.compliance, system.integrals).linearise(
            self.scale * unknown[:-1].reshape(load.shape[0], -1)
        )
        self.power = self._power_of(self.at.force)

    @property
    def problem(self) -> Problem:
        """What it balances."""
        problem = self.system.family.at(self.omega)
        return problem if self.factor == 1.0 else FAMILIES["resonance"].vary(problem, self.factor)

    def _power_of(self, force: np.ndarray) -> complex:
        """P with contact forces (2H+1, n_pairs)."""
        drive = self.system.drive
        return drive.power(self.compliance.seen_through(drive.rows, force))

    def _lag(self, change: complex) -> float:
        """Change of Re P / Im P with P."""
        power = self.power
        return (change.real - power.real / power.imag * change.imag) / power.imag

    def _power_by(self, change: np.ndarray) -> complex:
        """Change of P with s, at a fixed frequency."""
        return self._power_of(self.at.force + self.at.force_of(change)) - self.power

    @cached_property
    def residual(self) -> np.ndarray:  # type: ignore[override]
        return np.append(self.at.residual / self.scale, self.power.real / self.power.imag)

    @cached_property
    def over_frequency(self) -> np.ndarray:
        """ds/dw along the response curve."""
        return -self.at.solve(self.compliance.derivative("omega", self.at.force))

    @cached_property
    def power_over_frequency(self) -> complex:
        """dP/dw along it."""
        drive, force = self.system.drive, self.at.force
        alone = drive.power(self.compliance.seen_by_omega(drive.rows, force))
        return alone + self._power_by(self.over_frequency)

    def solve(self, right: np.ndarray) -> np.ndarray:
        change = self.scale * self.at.solve(right[:-1].reshape(self.at.unknown.shape))
        left = right[-1] - self._lag(self._power_by(change))
        rise = left / self._lag(self.power_over_frequency)
        slow = (change + rise * self.over_frequency) / self.scale
        return np.append(slow, rise / self.system.omega)

    @cached_property
    def by_parameter(self) -> np.ndarray:  # type: ignore[override]
        at, still = self.at, np.zeros_like(self.at.force)
        by_load = self.compliance.derivative("load", still)
        by_load[0] = 0.0  # the mean load stays
        change = (at.apply(at.unknown) + by_load - at.residual) / self.scale
        return np.append(change, self._lag(self._power_by(at.unknown) + self._power_of(still)))

    @property
    def sign(self) -> float:
        return self.at.sign * float(np.sign(self._lag(self.power_over_frequency)))

    @property
    def width(self) -> float:
        """D, the half-power width of one mode that would answer like this [rad/s]."""
        return -2.0 / (self.power_over_frequency / self.power).imag

    @property
    def apart(self) -> float:
        """Distance from here to the top of the response curve, over the width, as two modes would
        have it."""
        return 0.25 * self.width * (self.power_over_frequency / self.power).real

    @cached_property
    def solution(self) -> PeriodicSolution:
        """The motion, without a search for its exact orbit."""
        return solution_of(self.problem, self.at, status="phase resonance", search=False)

    def nearby(self, problem: Problem) -> ResonancePoint | None:
        """The resonance of another problem next to this one, under its own load; None where it is
        not found."""
        family = FrequencyFamily(problem, self.omega, self.omega + self.width)
        slow = family.system(self.omega).slow(self.at.gap, self.at.force)
        system = ResonanceSystem(family, self.system.drive, slow)
        start = system.point(slow, self.omega).unknown
        found = solve_near(system, start, 0.0, tolerance=max(LOCATED, system.rounding(0.0)))
        return None if found is None else system.linearise(found.unknown, 0.0)


class _InPhase(Crossing):
    """Zero of the part of the displacement that is in phase with the load, where a path ends."""

    terminal, sought, words = True, True, Ended.MET.value


def resonance_of(problem: Problem, mode: NaturalResonance) -> ResonancePoint:
    """The phase resonance that the response curve meets from next to a mode.

    Raises
    ------
    ConvergenceError
        There is no first solution, or the curve does not meet it.
    """
    # From one width below the mode, where the phase has a sign if all is linear.
    begin, drive = mode.omega - mode.width, mode.drive
    family = FrequencyFamily(problem, begin, 0.5 * begin)

    def in_phase(point: PathPoint) -> float:
        at = family.linearise(point.unknown, point.parameter)
        assert isinstance(at.system.compliance, ModalCompliance)
        power = drive.power(at.system.compliance.seen_through(drive.rows, at.force))
        return power.real / abs(power)

    start = Solver(family.at(family.start)).solve(reported=False)
    here = point_on_path(family, start.slow_gap_coefficients, 0.0)
    if in_phase(here) > 0.0:  # upwards
        here = replace(here, tangent=here.tangent.reversed())
    met = Path(family, here, TO_PHASE, [_InPhase(in_phase)]).run()
    if met is None:
        raise ConvergenceError(
            f"resonance: the phase at the load does not pass through it next to {mode.omega:.6g} "
            "rad/s: several modes answer together"
        )
    return ResonanceSystem(family, drive, met.unknown).point(
        met.unknown, family.value(met.parameter)
    )


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


def _usable(problem: Problem) -> Problem:
    """The problem with a small structure; InputError unless it can have a phase resonance."""
    if problem.friction or not is_unilateral(problem.contact):
        allowed = "the penalty law or the constraint, without friction, for a phase resonance"
        raise InputError("contact", problem.contact, allowed)
    if problem.subharmonic != 1:
        raise InputError("subharmonic", problem.subharmonic, "1 for a phase resonance")
    if is_small(problem.structure):
        return problem
    return replace(problem, structure=reduce_structure(problem.structure, method="massless"))


def _within(point: ResonancePoint, tolerance: float) -> tuple[ResonancePoint, float]:
    """The same with so many harmonics that its error is below a tolerance, or as many as a curve
    may have or as lead to a resonance; and that error, inf where it is not known.

    It is what half as many harmonics change, of the amplitude and of the frequency by what lowers
    that as much, or what the exact flow predicts of the displacement, if that is more: many
    harmonics may change nothing until one meets a mode. Where no resonance is next to that with
    fewer harmonics, it is sought anew."""
    error, more = math.inf, 2 * point.problem.harmonics
    while error > tolerance and more <= MAX_HARMONICS:
        problem = replace(point.problem, harmonics=more, static_above=None)
        try:
            finer = _next_to(point, problem)
        except ConvergenceError:
            break
        change = finer.solution.amplitude() / point.solution.amplitude() - 1.0
        shift = (finer.omega - point.omega) / finer.width
        error = max(abs(change) + 2.0 * shift**2, finer.solution.report.displacement)
        point, more = finer, 2 * more
    return point, error


def _next_to(point: ResonancePoint, problem: Problem) -> ResonancePoint:
    """The resonance of another problem next to one, or else by its own response curve."""
    return point.nearby(problem) or _nearest(problem, point.omega)


def _nearest(problem: Problem, omega: float) -> ResonancePoint:
    """The resonance of the mode nearest to a load frequency."""
    return resonance_of(problem, nearest_mode(problem, omega))


def _meeting(point: ResonancePoint, order: float) -> tuple[ResonancePoint, float]:
    """The resonance at the speed at which an order meets it, by the secant; and its rate, the
    change of the order's speed there with the rotor's."""
    rotor = point.problem.structure
    assert isinstance(rotor, RunUpStructure)
    speed, rate = rotor.speed, rotor.stiffening(point.omega * point.system.drive.harmonic)
    for _ in range(MEETINGS):
        ahead = (point.omega / order - rate * speed) / (1.0 - rate)
        if abs(ahead - speed) <= ARRIVED * speed:
            return point, rate
        structure = rotor.at_speed(ahead)
        found = _next_to(point, replace(point.problem, structure=structure, static_above=None))
        rate = (found.omega - point.omega) / order / (ahead - speed)
        point, speed = found, ahead
    raise ConvergenceError(f"resonance: its order does not meet it next to {speed:.6g} rad/s")


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
    check_choice("parameter", parameter, ("omega", "speed"))
    problem, order, rate, error = _usable(problem), 1.0, 0.0, math.nan
    point = _nearest(problem, problem.omega if near is None else near)
    if parameter == "speed":
        FAMILIES["speed"].check(problem.structure, "near", point.omega)
        order = problem.omega / problem.structure.speed  # type: ignore[attr-defined]
        point, rate = _meeting(point, order)
    if tolerance is not None:
        point, error = _within(point, tolerance)
        if parameter == "speed":
            point, rate = _meeting(point, order)
    return Resonance(
        point.omega / order, point.omega, point.system.drive.harmonic,
        point.width / order / (1.0 - rate), point.apart, point.solution, error,
    )  # fmt: skip


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
    problem, vary = _usable(problem), FAMILIES["resonance"].vary
    near = problem.omega if near is None else near
    if tolerance is not None:
        at_end = _nearest(vary(problem, end), near)
        problem = problem.with_harmonics(_within(at_end, tolerance)[0].problem.harmonics)
    first = _nearest(vary(problem, start), near)
    family = first.system.family
    balanced = replace(family.problem, structure=problem.structure)
    family = FrequencyFamily(balanced, family.start, family.end)
    system = ResonanceSystem(family, first.system.drive, first.at.unknown / start)
    ends = math.log(start), math.log(end)
    here = point_on_path(system, first.unknown, ends[0])
    if end < start:
        here = replace(here, tangent=here.tangent.reversed())
    # One that goes on to e times as much, or as little, is left.
    options = PathOptions(
        0.2 * longest_step, longest_step, max_steps=most_points,
        span=(min(ends) - 1.0, max(ends) + 1.0),
    )  # fmt: skip
    path, points = Path(system, here, options, [Target(ends[1])]), [here]
    status = INTERRUPTED
    with suppress(KeyboardInterrupt):
        points += path.points()
        assert path.ended is not None
        status = path.ended.in_words(most_points)
    complete = path.event is not None
    curve = _curve_of(system, points, complete, status)
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
    problem = system.family.problem
    return HarmonicCurve(
        structure=problem.structure,
        contact=problem.contact,
        parameter="resonance",
        values=np.array([one.factor for one in found]),
        omega=np.array([one.omega for one in found]),
        iterations=np.array([one.iterations for one in points]),
        bifurcations=(),
        complete=complete,
        status=status,
        subharmonic=1,
        unknowns=np.array([one.at.unknown for one in found]),
        samples=problem.samples,
        static_above=problem.static_cutoff,
    )
