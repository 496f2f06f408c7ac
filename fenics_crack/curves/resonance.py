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
    StepLimits,
    StepOptions,
    check_range,
    first_point,
)
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.curves.curve_system import CurveSystem
from fenics_crack.curves.follow import run_to_end
from fenics_crack.curves.waves import WAVES, FrequencyWaves, require_run_up_structure
from fenics_crack.model.contact import ContactLaw, is_unilateral
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.equations import LOCATION_TOLERANCE
from fenics_crack.numerics.newton import PathPoint, point_on_path, solve_robustly
from fenics_crack.numerics.path import ARRIVAL_DISTANCE, EndReason, Path, PathOptions, ZeroCrossing

PHASE_SEARCH_OPTIONS = PathOptions(0.05, 0.3, max_steps=300, points_per_call=8, span=(-4.0, 1.8))
"""Options of the response curve on which the first point is met. Its parameter is in halves of the
frequency, so that steps are parts of the motion; up to three times the frequency, or down to a
tenth."""
SMALL_LOAD_FACTOR = 1e-3
"""Factor of a load that is a small one: less is lost in rounding beside a mean load."""
MAX_SPEED_CORRECTIONS = 20
"""Maximum corrections by the secant of the speed at which an order meets a resonance."""


class ResonanceSystem(CurveSystem):
    """Phase resonance over the factor v of a load: unknowns s / (size v), and the frequency over
    that of the problem, next to whose solution at ``start`` it is sought, ``begin``."""

    name, logarithmic = "resonance", True

    def __init__(
        self,
        problem: Problem,
        drive: Drive,
        nearby_point: ContactPoint,
        factor_range: tuple[float, float] = (1, 2),
    ) -> None:
        self.start, self.end = factor_range
        self._waves = waves = FrequencyWaves(problem, problem.omega, 0.5 * problem.omega)
        slow_gap = waves.system(problem.omega).slow_gap(nearby_point.gap, nearby_point.force)
        slow_gap = slow_gap / self.start
        self._slow_gap_size = float(np.linalg.norm(slow_gap[1:]))
        self.start_unknown = np.append(slow_gap / self._slow_gap_size, 1.0)
        self.problem, self.drive, self.means = waves.problem, drive, waves.means
        self.shape = self.start_unknown.shape

    def rounding(self, parameter: float) -> float:
        return self._waves.rounding(0.0)

    def omega(self, value: float, unknown: np.ndarray) -> float:
        return float(unknown[-1]) * self.problem.omega

    def state(self, unknown: np.ndarray, value: float) -> np.ndarray:
        return self._slow_gap_size * value * unknown[:-1].reshape(-1, self.means)

    def linearise(self, unknown: np.ndarray, parameter: float) -> PhasePoint:
        value, omega = self.value(parameter), self.omega(1.0, unknown)
        contact_point = self._waves.system(omega).linearise(self.state(unknown, 1.0))
        inverse_load, inverse_load_rate = 1.0 / value, -self.value_rate(value) / value**2
        size = self._slow_gap_size
        return PhasePoint(
            self.problem, self.drive, contact_point, omega, size, inverse_load, inverse_load_rate
        )


class _PhaseZero(ZeroCrossing):
    """Zero of the part of the displacement that is in phase with the load, where a path ends."""

    is_terminal, must_be_located, description = True, True, EndReason.REACHED.value


def first_resonance(problem: Problem, near_omega: float) -> PhasePoint:
    """The phase resonance that the response curve meets from a load frequency on.

    Raises
    ------
    InputError
        No damped mode answers to the load.
    ConvergenceError
        There is no first solution, or the curve does not meet it.
    """
    if problem.friction or not is_unilateral(problem.contact) or problem.subharmonic != 1:
        requirement = "the penalty law or the constraint, without friction, and subharmonic = 1"
        raise InputError("contact", problem.contact, f"{requirement}, for a phase resonance")
    requirement = "one that moves a damped mode"
    if not all_modes(problem.structure).damping.any():
        raise InputError("load", "no damped mode answers to it", requirement)
    start_omega = near_omega * (1.0 - ARRIVAL_DISTANCE)  # the phase of what is linear is not 0 then
    waves = FrequencyWaves(problem, start_omega, 0.5 * start_omega)
    start_unknown = Solver(waves.problem_at(start_omega)).solve().slow_gap_coefficients
    contact_point = waves.linearise(start_unknown, 0.0)
    n_harmonics = len(problem.structure.force) // 2
    drives = [
        Drive.of_structure(problem.structure, harmonic + 1) for harmonic in range(n_harmonics)
    ]
    drive = max(drives, key=lambda drive: abs(drive.power(contact_point).imag))
    power = drive.power(contact_point)
    if not abs(power.imag) > LOCATION_TOLERANCE * abs(power):
        raise InputError("load", "no damped mode answers to it", requirement)

    def in_phase(point: PathPoint) -> float:
        power = drive.power(waves.linearise(point.unknown, point.parameter))
        return power.real / abs(power)

    start_point = point_on_path(waves, start_unknown, 0.0)
    if power.real > 0.0:  # upwards
        start_point = replace(start_point, tangent=start_point.tangent.reverse())
    zero_point = Path(waves, start_point, PHASE_SEARCH_OPTIONS, [_PhaseZero(in_phase)]).run()
    if zero_point is None:
        raise ConvergenceError(f"resonance: not met by the response from {near_omega:.6g} rad/s on")
    problem = replace(waves.problem, omega=waves.value(zero_point.parameter))
    system = ResonanceSystem(
        problem, drive, waves.linearise(zero_point.unknown, zero_point.parameter)
    )
    return system.linearise(system.start_unknown, 0.0)


def _find_nearby_resonance(resonance_point: PhasePoint, **changes: Any) -> PhasePoint:
    """The resonance of a problem with some changes next to one, or else on its response curve."""
    problem_fields = {"omega": resonance_point.omega, "static_above": None} | changes
    problem = replace(resonance_point.problem, **problem_fields)
    system = ResonanceSystem(problem, resonance_point.drive, resonance_point.contact_point)
    tolerance = max(LOCATION_TOLERANCE, system.rounding(0.0))
    path_point = solve_robustly(system, system.start_unknown, 0.0, tolerance=tolerance)
    if path_point is None:
        return first_resonance(problem, problem.omega)
    return system.linearise(path_point.unknown, 0.0)


def _refine_to_tolerance(point: PhasePoint, tolerance: float) -> tuple[PhasePoint, float]:
    """The same with so many harmonics that its error is below a tolerance, that several modes are
    seen to answer together, or as many as a curve may have or as lead to a resonance; and that
    error, inf where it is not known.

    It is what half as many harmonics change, of the amplitude and of the frequency by what lowers
    that as much, or what the exact flow predicts of the displacement, if that is more: many
    harmonics may change nothing until one meets a mode."""
    error, n_harmonics = math.inf, 2 * point.problem.harmonics
    while (
        error > tolerance
        and abs(point.distance_to_peak) <= MAX_DISTANCE_TO_PEAK
        and n_harmonics <= MOST_HARMONICS
    ):
        try:
            finer_point = _find_nearby_resonance(point, harmonics=n_harmonics)
        except ConvergenceError:
            break
        amplitude_change = finer_point.solution.amplitude() / point.solution.amplitude() - 1.0
        frequency_shift = (finer_point.omega - point.omega) / finer_point.width
        harmonics_error = abs(amplitude_change) + 2.0 * frequency_shift**2
        error = max(harmonics_error, finer_point.solution.report.displacement)
        point, n_harmonics = finer_point, 2 * n_harmonics
    return point, error


def _find_order_crossing(point: PhasePoint, order: float | None) -> tuple[PhasePoint, float]:
    """The resonance at the speed at which an order meets it, by the secant; and its rate, the
    change of the order's speed there with the rotor's. Without an order, as it is."""
    if order is None:
        return point, 0.0
    rotor, omega = require_run_up_structure(point.problem.structure), point.omega
    speed, resonance_rate = rotor.speed, rotor.stiffening(omega * point.drive.harmonic)
    for _ in range(MAX_SPEED_CORRECTIONS):
        next_speed = (omega / order - resonance_rate * speed) / (1.0 - resonance_rate)
        if abs(next_speed - speed) <= ARRIVAL_DISTANCE * speed:
            return point, resonance_rate
        point = _find_nearby_resonance(
            point, structure=rotor.at_speed(next_speed), omega=order * next_speed
        )
        resonance_rate = (point.omega - omega) / order / (next_speed - speed)
        speed, omega = next_speed, point.omega
    raise ConvergenceError(f"resonance: its order does not meet it next to {speed:.6g} rad/s")


def _prepare_search(
    problem: Problem, near_omega: float | None, tolerance: float | None
) -> tuple[Problem, float]:
    """The problem with a structure that is small, or else reduced to crack faces without mass, and
    where a resonance of it is sought."""
    for key, value in ("near", near_omega), ("tolerance", tolerance):
        if value is not None:
            check_number(key, value, 0.0, above=True)
    if not is_small(problem.structure):
        reduced_structure = reduce_structure(problem.structure, method="massless")
        problem = replace(problem, structure=reduced_structure)
    return problem, problem.omega if near_omega is None else near_omega


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
        order = problem.omega / require_run_up_structure(problem.structure).speed
    point = first_resonance(*_prepare_search(problem, near, tolerance))
    point, resonance_rate = _find_order_crossing(point, order)
    if tolerance is not None:
        point, error = _refine_to_tolerance(point, tolerance)
        point, resonance_rate = _find_order_crossing(point, order)
    omega, omega_per_value = point.omega, order or 1.0
    width, harmonic = point.width / omega_per_value / (1.0 - resonance_rate), point.drive.harmonic
    return Resonance(
        omega / omega_per_value,
        omega,
        harmonic,
        width,
        point.distance_to_peak,
        point.solution,
        error,
    )


def resonance_under_small_load(problem: Problem, near_omega: float) -> float:
    """Load frequency [rad/s] of the resonance under a small load, next to one: a crack that the
    mean load holds open or closed stays so."""
    return first_resonance(WAVES["resonance"].vary(problem, SMALL_LOAD_FACTOR), near_omega).omega


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
    (problem, near), vary_load = _prepare_search(problem, near, tolerance), WAVES["resonance"].vary
    if tolerance is not None:
        end_point = _refine_to_tolerance(first_resonance(vary_load(problem, end), near), tolerance)[
            0
        ]
        problem = problem.with_harmonics(end_point.problem.harmonics)
    point = first_resonance(vary_load(problem, start), near)
    start_problem = replace(point.problem, structure=problem.structure, omega=point.omega)
    system = ResonanceSystem(start_problem, point.drive, point.contact_point, (start, end))
    growing_curve = GrowingCurve(
        system, first_point(system, system.start_unknown, 0.0, 0), StepLimits(**steps)
    )
    curve = run_to_end(growing_curve, progress, throw)
    path_positions = [
        (curve_point.unknown, system.parameter(curve_point.value))
        for curve_point in growing_curve.points
    ]
    n_multimode_points = sum(
        abs(system.linearise(*position).distance_to_peak) > MAX_DISTANCE_TO_PEAK
        for position in path_positions
    )
    if n_multimode_points:
        point_count = f"{n_multimode_points} of {counted(len(curve), 'point')}"
        remark = f"at {point_count} several modes answer together"
        curve = replace(curve, status=f"{curve.status}; {remark}")
    return curve
