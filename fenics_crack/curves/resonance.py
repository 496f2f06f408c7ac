"""Phase resonance: where the displacement at the load has no part in phase with the load.

What a modal test finds by its phase (:mod:`fenics_crack.balance.phase`). It is met on the response
curve, followed from a frequency upwards where the displacement is in phase with the load, else
downwards, through folds to the phase's zero. Over the load it is followed along p = ln v, v the
factor of all of the load but its mean, with the frequency among the unknowns: in the units of v, s
is constant where all is linear.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Unpack

import numpy as np

from fenics_crack.balance.compliance import ModalCompliance
from fenics_crack.balance.contact_system import ContactSystem
from fenics_crack.balance.phase import Drive, PhasePoint
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution, Solver, solution_of
from fenics_crack.basics.errors import ConvergenceError, InputError, check_choice, check_number
from fenics_crack.basics.tables import TURN, Described, counted, quantity, with_frequency
from fenics_crack.curves.continuation import GrowingCurve, StepOptions, Steps, first_point
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.curves.curve_system import CurveSystem
from fenics_crack.curves.follow import run_to_end
from fenics_crack.curves.waves import WAVES, FrequencyWaves
from fenics_crack.model.contact import is_unilateral
from fenics_crack.model.modal import is_small
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.rotation import RunUpStructure
from fenics_crack.numerics.equations import LOCATED
from fenics_crack.numerics.newton import PathPoint, point_on_path, solve_near
from fenics_crack.numerics.path import ARRIVED, Crossing, Ended, Path, PathOptions

SEVERAL = 0.1
"""Distance of the phase resonance from the top of the curve over the half-power width, from which
on several modes answer: the amplitude is then 2 % below the top."""
TOGETHER = "several modes answer together"
MAX_HARMONICS = 100
"""Maximum harmonics for a tolerance, as of a curve."""
TO_PHASE = PathOptions(0.05, 0.3, max_steps=300, at_once=8, span=(-4.0, 1.8))
"""Options of the response curve on which the first point is met. Its parameter is in halves of the
frequency, so that steps are parts of the motion; up to three times the frequency, or down to a
tenth."""
SMALL = 1e-3
"""Factor of a load that is a small one: less is lost in rounding beside a mean load."""
MEETINGS = 20
"""Maximum corrections by the secant of the speed at which an order meets a resonance."""


class ResonanceSystem(CurveSystem):
    """Phase resonance over the factor v of a load: unknowns s / (size v), and the frequency over
    the one where its equations of a given frequency start."""

    name, logarithmic = "resonance", True

    def __init__(
        self, waves: FrequencyWaves, drive: Drive, slow: np.ndarray,
        start: float = 1.0, end: float = 2.0,
    ) -> None:  # fmt: skip
        self.problem, self.drive, self.means, self._waves = waves.problem, drive, waves.means, waves
        self.start, self.end, self.shape = start, end, (slow.size + 1,)
        self._size = float(np.linalg.norm(slow[1:])) / start
        self._integrals = waves.system(waves.start).integrals

    def rounding(self, parameter: float) -> float:
        return self._waves.rounding(0.0)

    def omega(self, value: float, unknown: np.ndarray) -> float:
        return float(unknown[-1]) * self._waves.start

    def state(self, unknown: np.ndarray, value: float) -> np.ndarray:
        return self._size * value * unknown[:-1].reshape(-1, self.means)

    def linearise(self, unknown: np.ndarray, parameter: float) -> PhasePoint:
        value = self.value(parameter)
        return self.at(self.state(unknown, value), self.omega(value, unknown), value)

    def at(self, slow: np.ndarray, omega: float, value: float = 1.0) -> PhasePoint:
        """The point at s and a load frequency."""
        load = self.problem.load.copy()
        load[1:] *= value
        compliance = ModalCompliance(self.problem.seen, omega, load)
        at = ContactSystem(compliance, self._integrals).linearise(slow)
        units = self._size * value, self._waves.start
        return PhasePoint(self.drive, at, omega, *units, self.rate(value) / value)

    def met(self, slow: np.ndarray, omega: float) -> Met:
        """The resonance at s and a load frequency, under the load itself."""
        return Met(replace(self.problem, omega=omega), self.at(slow, omega))


@dataclass(frozen=True)
class Met:
    """A phase resonance: the problem that is balanced there, and its point."""

    problem: Problem
    point: PhasePoint

    @cached_property
    def solution(self) -> PeriodicSolution:
        """The motion, without a search for its exact orbit."""
        return solution_of(self.problem, self.point.at, status="phase resonance", search=False)

    def of_another(self, **changes: Any) -> Met:
        """That of the problem with some changes next to this one, or else on its response curve."""
        problem, here = replace(self.problem, static_above=None, **changes), self.point
        waves = FrequencyWaves(problem, here.omega, 0.5 * here.omega)
        slow = waves.system(here.omega).slow(here.at.gap, here.at.force)
        system, sharp = ResonanceSystem(waves, here.drive, slow), max(LOCATED, waves.rounding(0.0))
        found = solve_near(system, system.at(slow, here.omega).unknown, 0.0, tolerance=sharp)
        if found is None:
            return first_resonance(problem, here.omega)
        return system.met(system.state(found.unknown, 1.0), system.omega(1.0, found.unknown))


class _InPhase(Crossing):
    """Zero of the part of the displacement that is in phase with the load, where a path ends."""

    terminal, sought, words = True, True, Ended.MET.value


def first_resonance(problem: Problem, near: float) -> Met:
    """The phase resonance that the response curve meets from a load frequency on.

    Raises
    ------
    InputError
        No damped mode answers to the load.
    ConvergenceError
        There is no first solution, or the curve does not meet it.
    """
    begin = near * (1.0 - ARRIVED)  # the phase of what is linear is not 0 then
    waves = FrequencyWaves(problem, begin, 0.5 * begin)
    start = Solver(waves.at(begin)).solve(reported=False).slow_gap_coefficients
    first, count = waves.linearise(start, 0.0), len(problem.structure.force) // 2
    drives = [Drive.of(problem.structure, harmonic + 1) for harmonic in range(count)]
    drive = max(drives, key=lambda one: abs(one.power(first)))
    power = drive.power(first)
    if not abs(power.imag) > LOCATED * abs(power):
        raise InputError("load", "no damped mode answers to it", "one that moves a damped mode")

    def in_phase(point: PathPoint) -> float:
        power = drive.power(waves.linearise(point.unknown, point.parameter))
        return power.real / abs(power)

    here = point_on_path(waves, start, 0.0)
    if power.real > 0.0:  # upwards
        here = replace(here, tangent=here.tangent.reversed())
    met = Path(waves, here, TO_PHASE, [_InPhase(in_phase)]).run()
    if met is None:
        raise ConvergenceError(
            f"resonance: the response from {near:.6g} rad/s on always has a part in phase with the "
            "load: several modes answer together"
        )
    system = ResonanceSystem(waves, drive, met.unknown)
    return system.met(met.unknown, waves.value(met.parameter))


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
        together = f", {TOGETHER}: see the curve" * self.several
        error = "" if math.isnan(self.error) else f", error {self.error:.2g}"
        return (
            f"{self.omega / TURN:.6g} Hz ({self.omega:.6g} rad/s), half-power damping "
            f"{self.damping:.3g}, {quantity(self.solution.amplitude(), 'm')} half peak-to-peak, "
            f"H = {self.solution.harmonics}{error}{together}"
        )


def _usable(problem: Problem) -> Problem:
    """The problem with a small structure; InputError unless it can have a phase resonance."""
    if problem.friction or not is_unilateral(problem.contact) or problem.subharmonic != 1:
        allowed = "the penalty law or the constraint, without friction, and subharmonic = 1"
        raise InputError("contact", problem.contact, f"{allowed}, for a phase resonance")
    if is_small(problem.structure):
        return problem
    return replace(problem, structure=reduce_structure(problem.structure, method="massless"))


def _within(met: Met, tolerance: float) -> tuple[Met, float]:
    """The same with so many harmonics that its error is below a tolerance, or as many as a curve
    may have or as lead to a resonance; and that error, inf where it is not known.

    It is what half as many harmonics change, of the amplitude and of the frequency by what lowers
    that as much, or what the exact flow predicts of the displacement, if that is more: many
    harmonics may change nothing until one meets a mode."""
    error, more = math.inf, 2 * met.problem.harmonics
    while error > tolerance and more <= MAX_HARMONICS:
        try:
            finer = met.of_another(harmonics=more)
        except ConvergenceError:
            break
        change = finer.solution.amplitude() / met.solution.amplitude() - 1.0
        shift = (finer.point.omega - met.point.omega) / finer.point.width
        error = max(abs(change) + 2.0 * shift**2, finer.solution.report.displacement)
        met, more = finer, 2 * more
    return met, error


def _meeting(met: Met, order: float) -> tuple[Met, float]:
    """The resonance at the speed at which an order meets it, by the secant; and its rate, the
    change of the order's speed there with the rotor's."""
    rotor = met.problem.structure
    assert isinstance(rotor, RunUpStructure)
    speed, rate = rotor.speed, rotor.stiffening(met.point.omega * met.point.drive.harmonic)
    for _ in range(MEETINGS):
        ahead = (met.point.omega / order - rate * speed) / (1.0 - rate)
        if abs(ahead - speed) <= ARRIVED * speed:
            return met, rate
        found = met.of_another(structure=rotor.at_speed(ahead))
        rate = (found.point.omega - met.point.omega) / order / (ahead - speed)
        met, speed = found, ahead
    raise ConvergenceError(f"resonance: its order does not meet it next to {speed:.6g} rad/s")


def resonance_at(
    problem: Problem,
    near: float | None = None,
    parameter: str = "omega",
    *,
    tolerance: float | None = None,
) -> Resonance:
    """Find the phase resonance next to a load frequency, under the load as it is.

    There the displacement at the load has no part in phase with the load, as in a modal test: next
    to the largest response, unless several modes answer together, which is said. The response is
    followed upwards from a frequency at which it is in phase with the load, else downwards.

    Parameters
    ----------
    problem : Problem
        Structure, law, harmonics, and a load frequency. A structure with many dofs is reduced
        first, to crack faces without mass.
    near : float, optional
        Load frequency [rad/s] next to which it is sought; default: the problem's.
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
        No first solution, or the response from there on does not come to a resonance.

    Examples
    --------
    >>> found = fc.resonance_at(fc.Problem(structure, 2000.0, contact), tolerance=0.01)
    >>> found.omega, found.solution.amplitude(), found.several
    """
    check_choice("parameter", parameter, ("omega", "speed"))
    problem, order, rate, error = _usable(problem), 1.0, 0.0, math.nan
    met = first_resonance(problem, problem.omega if near is None else near)
    if parameter == "speed":
        WAVES["speed"].check(problem.structure, "near", met.point.omega)
        order = problem.omega / problem.structure.speed  # type: ignore[attr-defined]
        met, rate = _meeting(met, order)
    if tolerance is not None:
        met, error = _within(met, tolerance)
        if parameter == "speed":
            met, rate = _meeting(met, order)
    point = met.point
    return Resonance(
        point.omega / order, point.omega, point.drive.harmonic,
        point.width / order / (1.0 - rate), point.apart, met.solution, error,
    )  # fmt: skip


def frequency_at_rest(problem: Problem, near: float) -> float:
    """Load frequency [rad/s] of the resonance under a small load, next to one: a crack that the
    mean load holds open or closed stays so."""
    return first_resonance(WAVES["resonance"].vary(_usable(problem), SMALL), near).point.omega


def follow_resonance(
    problem: Problem,
    start: float,
    end: float,
    *,
    near: float | None = None,
    tolerance: float | None = None,
    progress: bool = False,
    throw: bool = True,
    **steps: Unpack[StepOptions],
) -> ResponseCurve:
    """Follow a phase resonance over the load.

    Parameters
    ----------
    problem, near
        As in :func:`resonance_at`.
    start, end : float
        Factors of all of the load but its mean, above 0.
    tolerance : float, optional
        Take as many harmonics as this error requires at the end.
    progress, throw, **steps
        As in :func:`continue_frequency`: longest_step, most_points, turning_back.

    Returns
    -------
    ResponseCurve
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
    problem, vary = _usable(problem), WAVES["resonance"].vary
    near = problem.omega if near is None else near
    if tolerance is not None:
        at_end = _within(first_resonance(vary(problem, end), near), tolerance)[0]
        problem = problem.with_harmonics(at_end.problem.harmonics)
    met = first_resonance(vary(problem, start), near)
    point, slow = met.point, met.point.at.unknown
    balanced = replace(met.problem, structure=problem.structure)
    waves = FrequencyWaves(balanced, point.omega, 0.5 * point.omega)
    system = ResonanceSystem(waves, point.drive, slow, start, end)
    here = first_point(system, system.at(slow, point.omega, start).unknown, 0.0, 0)
    growing = GrowingCurve(system, here, Steps(**steps))
    curve = run_to_end(growing, progress, throw)
    columns = zip(curve.points, curve.omega, curve.values, strict=True)
    several = sum(abs(system.at(*column).apart) > SEVERAL for column in columns)
    said = f"; at {several} of {counted(len(curve), 'point')} {TOGETHER}" if several else ""
    return replace(curve, status=curve.status + said)
