"""Phase resonance: where the displacement at the load has no part in phase with the load.

What a modal test finds by its phase (:mod:`fenics_crack.balance.phase`). It is met on the response
curve, followed from a frequency upwards where the displacement is in phase with the load, else
downwards, through folds to the phase's zero. Over the load it is followed along p = ln v, v the
factor of all of the load but its mean, with the frequency among the unknowns: in the units of v, s
is constant where all is linear.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Unpack, overload

import numpy as np

from fenics_crack.balance.contact_system import ContactPoint
from fenics_crack.balance.phase import MAX_DISTANCE_TO_PEAK, Drive, PhasePoint, Resonance
from fenics_crack.balance.problem import Problem, least_harmonics
from fenics_crack.balance.solution import Solver
from fenics_crack.basics.errors import (
    MOST_HARMONICS,
    ConvergenceError,
    InputError,
    check_choice,
    check_number,
)
from fenics_crack.basics.tables import counted
from fenics_crack.curves.continuation import (
    GrowingCurve,
    StepOptions,
    Steps,
    check_range,
    first_point,
)
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.curves.curve_system import CurveSystem
from fenics_crack.curves.follow import run_to_end
from fenics_crack.curves.waves import WAVES, FrequencyWaves, spinning
from fenics_crack.model.contact import ContactLaw, is_unilateral
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.equations import LOCATION_TOLERANCE
from fenics_crack.numerics.newton import PathPoint, point_on_path, solve_robustly
from fenics_crack.numerics.path import ARRIVAL_DISTANCE, EndReason, Path, PathOptions, ZeroCrossing

TO_PHASE = PathOptions(0.05, 0.3, max_steps=300, points_per_call=8, span=(-4.0, 1.8))
"""Options of the response curve on which the first point is met. Its parameter is in halves of the
frequency, so that steps are parts of the motion; up to three times the frequency, or down to a
tenth."""
SMALL_LOAD = 1e-3
"""Factor of a load that is a small one: less is lost in rounding beside a mean load."""
MEETINGS = 20
"""Maximum corrections by the secant of the speed at which an order meets a resonance."""


class ResonanceSystem(CurveSystem):
    """Phase resonance over the factor v of a load: unknowns s / (size v), and the frequency over
    that of the problem, next to whose solution at ``start`` it is sought, ``begin``."""

    name, logarithmic = "resonance", True

    def __init__(
        self, problem: Problem, drive: Drive, near: ContactPoint, span: tuple[float, float] = (1, 2)
    ) -> None:
        self.start, self.end = span
        self._waves = waves = FrequencyWaves(problem, problem.omega, 0.5 * problem.omega)
        slow = waves.system(problem.omega).slow_gap(near.gap, near.force) / self.start
        self._size = float(np.linalg.norm(slow[1:]))
        self.begin = np.append(slow / self._size, 1.0)
        self.problem, self.drive, self.means = waves.problem, drive, waves.means
        self.shape = self.begin.shape

    def rounding(self, parameter: float) -> float:
        return self._waves.rounding(0.0)

    def omega(self, value: float, unknown: np.ndarray) -> float:
        return float(unknown[-1]) * self.problem.omega

    def state(self, unknown: np.ndarray, value: float) -> np.ndarray:
        return self._size * value * unknown[:-1].reshape(-1, self.means)

    def linearise(self, unknown: np.ndarray, parameter: float) -> PhasePoint:
        value, omega = self.value(parameter), self.omega(1.0, unknown)
        at = self._waves.system(omega).linearise(self.state(unknown, 1.0))
        inverse, change = 1.0 / value, -self.rate(value) / value**2
        return PhasePoint(self.problem, self.drive, at, omega, self._size, inverse, change)


class _InPhase(ZeroCrossing):
    """Zero of the part of the displacement that is in phase with the load, where a path ends."""

    is_terminal, must_be_located, description = True, True, EndReason.REACHED.value


def first_resonance(problem: Problem, near: float) -> PhasePoint:
    """The phase resonance that the response curve meets from a load frequency on.

    Raises
    ------
    InputError
        No damped mode answers to the load.
    ConvergenceError
        There is no first solution, or the curve does not meet it.
    """
    if problem.friction or not is_unilateral(problem.contact) or problem.subharmonic != 1:
        allowed = "the penalty law or the constraint, without friction, and subharmonic = 1"
        raise InputError("contact", problem.contact, f"{allowed}, for a phase resonance")
    allowed = "one that moves a damped mode"
    if not all_modes(problem.structure).damping.any():
        raise InputError("load", "no damped mode answers to it", allowed)
    begin = near * (1.0 - ARRIVAL_DISTANCE)  # the phase of what is linear is not 0 then
    waves = FrequencyWaves(problem, begin, 0.5 * begin)
    start = Solver(waves.at(begin)).solve().slow_gap_coefficients
    first, count = waves.linearise(start, 0.0), len(problem.structure.force) // 2
    drives = [Drive.of_structure(problem.structure, harmonic + 1) for harmonic in range(count)]
    drive = max(drives, key=lambda one: abs(one.power(first).imag))
    power = drive.power(first)
    if not abs(power.imag) > LOCATION_TOLERANCE * abs(power):
        raise InputError("load", "no damped mode answers to it", allowed)

    def in_phase(point: PathPoint) -> float:
        power = drive.power(waves.linearise(point.unknown, point.parameter))
        return power.real / abs(power)

    here = point_on_path(waves, start, 0.0)
    if power.real > 0.0:  # upwards
        here = replace(here, tangent=here.tangent.reverse())
    met = Path(waves, here, TO_PHASE, [_InPhase(in_phase)]).run()
    if met is None:
        raise ConvergenceError(f"resonance: not met by the response from {near:.6g} rad/s on")
    problem = replace(waves.problem, omega=waves.value(met.parameter))
    system = ResonanceSystem(problem, drive, waves.linearise(met.unknown, met.parameter))
    return system.linearise(system.begin, 0.0)


def _next_to(here: PhasePoint, **changes: Any) -> PhasePoint:
    """The resonance of a problem with some changes next to one, or else on its response curve."""
    problem = replace(here.problem, **{"omega": here.omega, "static_above": None} | changes)
    system = ResonanceSystem(problem, here.drive, here.contact_point)
    sharp = max(LOCATION_TOLERANCE, system.rounding(0.0))
    found = solve_robustly(system, system.begin, 0.0, tolerance=sharp)
    if found is None:
        return first_resonance(problem, problem.omega)
    return system.linearise(found.unknown, 0.0)


def _within(point: PhasePoint, tolerance: float) -> tuple[PhasePoint, float]:
    """The same with so many harmonics that its error is below a tolerance, that several modes are
    seen to answer together, or as many as a curve may have or as lead to a resonance; and that
    error, inf where it is not known.

    It is what half as many harmonics change, of the amplitude and of the frequency by what lowers
    that as much, or what the exact flow predicts of the displacement, if that is more: many
    harmonics may change nothing until one meets a mode."""
    error, more = math.inf, 2 * point.problem.harmonics
    while (
        error > tolerance
        and abs(point.distance_to_peak) <= MAX_DISTANCE_TO_PEAK
        and more <= MOST_HARMONICS
    ):
        try:
            finer = _next_to(point, harmonics=more)
        except ConvergenceError:
            break
        change = finer.solution.amplitude() / point.solution.amplitude() - 1.0
        shift = (finer.omega - point.omega) / finer.width
        error = max(abs(change) + 2.0 * shift**2, finer.solution.report.displacement)
        point, more = finer, 2 * more
    return point, error


def _meeting(point: PhasePoint, order: float | None) -> tuple[PhasePoint, float]:
    """The resonance at the speed at which an order meets it, by the secant; and its rate, the
    change of the order's speed there with the rotor's. Without an order, as it is."""
    if order is None:
        return point, 0.0
    rotor, omega = spinning(point.problem.structure), point.omega
    speed, rate = rotor.speed, rotor.stiffening(omega * point.drive.harmonic)
    for _ in range(MEETINGS):
        ahead = (omega / order - rate * speed) / (1.0 - rate)
        if abs(ahead - speed) <= ARRIVAL_DISTANCE * speed:
            return point, rate
        point = _next_to(point, structure=rotor.at_speed(ahead), omega=order * ahead)
        rate = (point.omega - omega) / order / (ahead - speed)
        speed, omega = ahead, point.omega
    raise ConvergenceError(f"resonance: its order does not meet it next to {speed:.6g} rad/s")


def _begun(problem: Problem, near: float | None, tolerance: float | None) -> tuple[Problem, float]:
    """The problem with a structure that is small, or else reduced to crack faces without mass, and
    where a resonance of it is sought."""
    for key, value in ("near", near), ("tolerance", tolerance):
        if value is not None:
            check_number(key, value, 0.0, above=True)
    if not is_small(problem.structure):
        reduced = reduce_structure(problem.structure, method="massless")
        problem = replace(problem, structure=reduced)
    return problem, problem.omega if near is None else near


@overload
def resonance_at(
    problem: Problem,
    near: float | None = None,
    parameter: str = "omega",
    *,
    tolerance: float | None = None,
) -> Resonance: ...


@overload
def resonance_at(
    structure: Structure, contact: ContactLaw, omega: float, /, *, tolerance: float | None = None
) -> Resonance: ...


def resonance_at(
    problem: Problem | Structure,
    near: Any = None,
    parameter: Any = "omega",
    *,
    tolerance: float | None = None,
) -> Resonance:
    """Find the phase resonance next to a load frequency, under the load as it is.

    There the displacement at the load has no part in phase with the load, as in a modal test: next
    to the largest response, unless several modes answer together, which is said. The response is
    followed upwards from a frequency at which it is in phase with the load, else downwards.

    ``resonance_at(structure, law, omega)`` is short for a problem with 5 harmonics, or as many as
    the load has.

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
        below this, or several modes answer together: the curve shows more then.

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
    if isinstance(problem, Structure):
        harmonics = max(Problem.harmonics, least_harmonics(problem, 1))
        problem = Problem(problem, parameter, near, harmonics)
        near, parameter = None, "omega"
    check_choice("parameter", parameter, ("omega", "speed"))
    order, error = None, math.nan
    if parameter == "speed":
        order = problem.omega / spinning(problem.structure).speed
    point = first_resonance(*_begun(problem, near, tolerance))
    point, rate = _meeting(point, order)
    if tolerance is not None:
        point, error = _within(point, tolerance)
        point, rate = _meeting(point, order)
    omega, unit = point.omega, order or 1.0
    width, harmonic = point.width / unit / (1.0 - rate), point.drive.harmonic
    return Resonance(
        omega / unit, omega, harmonic, width, point.distance_to_peak, point.solution, error
    )


def frequency_at_rest(problem: Problem, near: float) -> float:
    """Load frequency [rad/s] of the resonance under a small load, next to one: a crack that the
    mean load holds open or closed stays so."""
    return first_resonance(WAVES["resonance"].vary(problem, SMALL_LOAD), near).omega


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
    check_range(problem, "resonance", start, end)
    (problem, near), vary = _begun(problem, near, tolerance), WAVES["resonance"].vary
    if tolerance is not None:
        at_end = _within(first_resonance(vary(problem, end), near), tolerance)[0]
        problem = problem.with_harmonics(at_end.problem.harmonics)
    point = first_resonance(vary(problem, start), near)
    balanced = replace(point.problem, structure=problem.structure, omega=point.omega)
    system = ResonanceSystem(balanced, point.drive, point.contact_point, (start, end))
    growing = GrowingCurve(system, first_point(system, system.begin, 0.0, 0), Steps(**steps))
    curve = run_to_end(growing, progress, throw)
    places = [(one.unknown, system.parameter(one.value)) for one in growing.points]
    several = sum(
        abs(system.linearise(*place).distance_to_peak) > MAX_DISTANCE_TO_PEAK for place in places
    )
    if several:
        said = f"at {several} of {counted(len(curve), 'point')} several modes answer together"
        curve = replace(curve, status=f"{curve.status}; {said}")
    return curve
