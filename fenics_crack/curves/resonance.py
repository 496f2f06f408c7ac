"""Phase resonance: the displacement at the load has no part in phase with the load.

A modal test finds the same resonance by phase (:mod:`fenics_crack.curves.phase`). The search
follows the response curve to the zero of the phase, through folds: upwards from a frequency with
the displacement in phase with the load, otherwise downwards.

Over the load the resonance is followed along p = ln v, with the frequency among the unknowns. The
factor v multiplies the load without its mean. Further unknowns are s / v, constant if all is
linear.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Unpack, overload

from fenics_crack.balance.problem import Problem, least_harmonics
from fenics_crack.balance.solution import PeriodicSolution, Solver
from fenics_crack.basics.errors import (
    MAX_HARMONIC_ORDER,
    ConvergenceError,
    InputError,
    check_choice,
    check_number,
)
from fenics_crack.basics.tables import Described, add_frequency_entries, format_count
from fenics_crack.curves.balance_equations import (
    EQUATIONS_CLASS_BY_PARAMETER,
    BalanceAlongFrequency,
    as_run_up_structure,
)
from fenics_crack.curves.continuation import (
    GrowingCurve,
    StepLimits,
    StepOptions,
    check_range,
    make_first_path_point,
)
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.curves.follow import run_to_end
from fenics_crack.curves.phase import ExcitingHarmonic, PhasePoint, ResonanceSystem
from fenics_crack.model.contact import ContactLaw, is_unilateral
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.equations import MAX_LOCATION_RESIDUAL
from fenics_crack.numerics.newton import PathPoint, point_on_path, solve_by_full_or_damped_steps
from fenics_crack.numerics.path import (
    MIN_RESOLVED_DISTANCE,
    EndReason,
    Path,
    PathOptions,
    ZeroCrossing,
)

PATH_TO_RESONANCE_OPTIONS = PathOptions(
    0.05, 0.3, max_steps=300, points_per_call=8, parameter_range=(-4.0, 1.8)
)
"""Options for the response curve to the first resonance.

The curve's parameter is in halves of the start frequency, so that steps are relative to the motion.
The curve reaches from a tenth of the frequency to three times the frequency.
"""
MAX_DISTANCE_TO_PEAK = 0.1
"""Distance to the top of the response curve, over the half-power width, at which several modes
count.

The amplitude is then 2 % below the top.
"""
SMALL_LOAD_FACTOR = 1e-3
"""Factor for a small load. Smaller factors would lose more to rounding beside a mean load."""
MAX_SPEED_CORRECTIONS = 20
"""Maximum number of secant steps to the speed at which an engine order meets a resonance."""


@dataclass(frozen=True, repr=False)
class Resonance(Described):
    """Phase resonance under the load of a structure.

    Attributes
    ----------
    value : float
        Load frequency, or speed of the rotor [rad/s].
    omega : float
        Load frequency [rad/s].
    harmonic : int
        Exciting harmonic in the load.
    width : float
        Half-power width in the unit of ``value``.
    apart : float
        Distance to the top of the response curve over the width, estimated at the resonance.
    solution : PeriodicSolution
        Motion at the resonance.
    error : float
        Estimated truncation error of the amplitude, relative to it; inf if unknown, nan without a
        tolerance.
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
        """True if several modes shift the phase by more than a tenth of the width.

        The response curve then shows the largest response.
        """
        return not abs(self.apart) <= MAX_DISTANCE_TO_PEAK

    def to_dict(self) -> dict[str, Any]:
        """Return frequencies, the width, the distance to the top, the error and the amplitude."""
        names = "value", "omega", "harmonic", "width", "apart", "several", "error"
        columns_by_name = {name: getattr(self, name) for name in names}
        return add_frequency_entries(columns_by_name | {"amplitude": self.solution.amplitude()})


class _PhaseResonanceEvent(ZeroCrossing):
    """Zero for the displacement in phase with the load; paths end there."""

    is_terminal, must_be_located, description = True, True, EndReason.REACHED.value


def first_phase_resonance(problem: Problem, from_omega: float) -> PhasePoint:
    """Return the first phase resonance on the response curve from a load frequency on.

    Raises
    ------
    InputError
        No damped mode answers to the load.
    ConvergenceError
        No first solution, or no resonance on the curve.
    """
    if problem.has_friction or not is_unilateral(problem.contact) or problem.subharmonic != 1:
        contact_requirement = (
            "of the law 'penalty' or 'unilateral', without friction and with subharmonic = 1,"
            " for a phase resonance"
        )
        raise InputError("contact", problem.contact, contact_requirement)
    if not all_modes(problem.structure).damping.any():
        raise InputError("damping", 0.0, "> 0, as it limits the amplitude at resonance")
    start_omega = from_omega * (1.0 - MIN_RESOLVED_DISTANCE)  # a linear phase is then not 0
    equations = BalanceAlongFrequency(problem, start_omega, 0.5 * start_omega)
    start_unknown = Solver(equations.problem_at(start_omega)).solve().slow_gap_coefficients
    contact_point = equations.linearise(start_unknown, 0.0)
    n_load_harmonics = len(problem.structure.force) // 2
    exciting_harmonics = [
        ExcitingHarmonic.of_structure(problem.structure, harmonic + 1)
        for harmonic in range(n_load_harmonics)
    ]
    exciting_harmonic = max(
        exciting_harmonics,
        key=lambda exciting_harmonic: abs(exciting_harmonic.complex_work(contact_point).imag),
    )
    complex_work = exciting_harmonic.complex_work(contact_point)
    if not abs(complex_work.imag) > MAX_LOCATION_RESIDUAL * abs(complex_work):
        load_requirement = "a load that excites a mode whose damping is not almost 0"
        raise InputError("load", float(abs(problem.structure.force).max()), load_requirement)

    def phase_cosine(path_point: PathPoint) -> float:
        complex_work = exciting_harmonic.complex_work(
            equations.linearise(path_point.unknown, path_point.parameter)
        )
        return complex_work.real / abs(complex_work)

    start_path_point = point_on_path(equations, start_unknown, 0.0)
    if complex_work.real > 0.0:  # the resonance is above
        start_path_point = replace(start_path_point, tangent=start_path_point.tangent.reverse())
    resonance_path_point = Path(
        equations, start_path_point, PATH_TO_RESONANCE_OPTIONS, [_PhaseResonanceEvent(phase_cosine)]
    ).find_terminal_point_or_none()
    if resonance_path_point is None:
        raise ConvergenceError(
            f"no resonance was found on the curve from {from_omega:.6g} rad/s on"
        )
    problem = replace(equations.problem, omega=equations.value(resonance_path_point.parameter))
    resonance_system = ResonanceSystem(
        problem,
        exciting_harmonic,
        equations.linearise(resonance_path_point.unknown, resonance_path_point.parameter),
    )
    return resonance_system.linearise(resonance_system.start_unknown, 0.0)


def _find_nearby_resonance(resonance_point: PhasePoint, **changes: Any) -> PhasePoint:
    """Return the resonance for a changed problem next to a given resonance.

    ``changes`` are fields of the problem. If Newton's method fails, the response curve is followed.
    """
    problem_fields = {"omega": resonance_point.omega, "static_above": None} | changes
    problem = replace(resonance_point.problem, **problem_fields)
    system = ResonanceSystem(
        problem, resonance_point.exciting_harmonic, resonance_point.contact_point
    )
    tolerance = max(MAX_LOCATION_RESIDUAL, system.rounding(0.0))
    path_point = solve_by_full_or_damped_steps(
        system, system.start_unknown, 0.0, tolerance=tolerance
    )
    if path_point is None:
        return first_phase_resonance(problem, problem.omega)
    return system.linearise(path_point.unknown, 0.0)


def _refined_point_and_error(point: PhasePoint, tolerance: float) -> tuple[PhasePoint, float]:
    """Double the harmonics until the error is below a tolerance.

    The search also ends if several modes answer together, at the maximum number of harmonics, or if
    no resonance is found. The error is the larger of two numbers:

    - The change from half as many harmonics: relative change of the amplitude, plus the amplitude
      loss that the frequency shift would cause.
    - The exact flow's prediction for the displacement. Many harmonics may change nothing until a
      harmonic meets a mode.

    Returns
    -------
    point : PhasePoint
        Resonance with the harmonics reached.
    error : float
        Relative error; inf if unknown.
    """
    error, n_harmonics = math.inf, 2 * point.problem.harmonics
    while (
        error > tolerance
        and abs(point.distance_to_peak_in_widths) <= MAX_DISTANCE_TO_PEAK
        and n_harmonics <= MAX_HARMONIC_ORDER
    ):
        try:
            finer_point = _find_nearby_resonance(point, harmonics=n_harmonics)
        except ConvergenceError:
            break
        amplitude_change = finer_point.solution.amplitude() / point.solution.amplitude() - 1.0
        frequency_shift_in_widths = (finer_point.omega - point.omega) / finer_point.half_power_width
        harmonics_error = abs(amplitude_change) + 2.0 * frequency_shift_in_widths**2
        error = max(harmonics_error, finer_point.solution.report.displacement)
        point, n_harmonics = finer_point, 2 * n_harmonics
    return point, error


def _find_order_crossing_and_resonance_rate(
    point: PhasePoint, order: float | None
) -> tuple[PhasePoint, float]:
    """Find the resonance that an engine order meets, over the rotor speed.

    The secant method varies the speed.

    Parameters
    ----------
    point : PhasePoint
        Resonance at the rotor's speed.
    order : float or None
        Load frequency over rotor speed.

    Returns
    -------
    point : PhasePoint
        Resonance at that speed; the given point without an order.
    resonance_rate : float
        Derivative, by the rotor's speed, of the resonance frequency divided by the order; 0
        without an order.
    """
    if order is None:
        return point, 0.0
    rotor, omega = as_run_up_structure(point.problem.structure), point.omega
    speed, resonance_rate = rotor.speed, rotor.stiffening(omega * point.exciting_harmonic.harmonic)
    for _ in range(MAX_SPEED_CORRECTIONS):
        next_speed = (omega / order - resonance_rate * speed) / (1.0 - resonance_rate)
        if abs(next_speed - speed) <= MIN_RESOLVED_DISTANCE * speed:
            return point, resonance_rate
        point = _find_nearby_resonance(
            point, structure=rotor.at_speed(next_speed), omega=order * next_speed
        )
        resonance_rate = (point.omega - omega) / order / (next_speed - speed)
        speed, omega = next_speed, point.omega
    raise ConvergenceError(f"the engine order meets no resonance near the speed {speed:.6g} rad/s")


def _small_problem_and_start_omega(
    problem: Problem, near_omega: float | None, tolerance: float | None
) -> tuple[Problem, float]:
    """Return the problem with a small structure, and the start frequency for the search.

    A structure with many dofs is reduced to crack faces without mass.
    """
    for key, value in ("near", near_omega), ("tolerance", tolerance):
        if value is not None:
            check_number(key, value, 0.0, excludes_bound=True)
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

    At the resonance the displacement at the load has no part in phase with the load, as in a modal
    test. The largest response is next to it, unless several modes answer together; the result says
    so. The response is followed upwards from a frequency with displacement and load in phase,
    otherwise downwards.

    ``resonance_at(structure, law, omega)`` is short for a problem with 5 harmonics, or as many as
    the load has.

    Parameters
    ----------
    problem : Problem
        Structure, law, harmonics, and a load frequency. A structure with many dofs is reduced
        first, to crack faces without mass.
    near : float, optional
        Load frequency [rad/s] at which the search begins; default: the problem's.
    parameter : "omega" or "speed"
        Quantity that follows the resonance: the load frequency, or the speed of a rotor from
        :func:`fenics_crack.run_up_structure`, with the modes at each speed.
    tolerance : float, optional
        Double the harmonics until the estimated error of the amplitude is below this, or until
        several modes answer together: the curve shows more then.

    Returns
    -------
    Resonance
        Frequency, width, and motion at the resonance.

    Raises
    ------
    InputError
        An argument cannot be used, or no damped mode answers to the load.
    ConvergenceError
        No first solution, or the response from there on has no resonance.

    Examples
    --------
    >>> found = fc.resonance_at(fc.Problem(structure, 2000.0, contact), tolerance=0.01)
    >>> found.omega, found.solution.amplitude(), found.several
    """
    if isinstance(problem, Structure):
        n_harmonics = max(Problem.harmonics, least_harmonics(problem, 1))
        problem = Problem(problem, parameter, near, n_harmonics)
        near, parameter = None, "omega"
    check_choice("parameter", parameter, ("omega", "speed"))
    order, error = None, math.nan
    if parameter == "speed":
        order = problem.omega / as_run_up_structure(problem.structure).speed
    point = first_phase_resonance(*_small_problem_and_start_omega(problem, near, tolerance))
    point, resonance_rate = _find_order_crossing_and_resonance_rate(point, order)
    if tolerance is not None:
        point, error = _refined_point_and_error(point, tolerance)
        point, resonance_rate = _find_order_crossing_and_resonance_rate(point, order)
    omega, omega_per_value = point.omega, order or 1.0
    width = point.half_power_width / omega_per_value / (1.0 - resonance_rate)
    harmonic = point.exciting_harmonic.harmonic
    return Resonance(
        omega / omega_per_value,
        omega,
        harmonic,
        width,
        point.distance_to_peak_in_widths,
        point.solution,
        error,
    )


def problem_at_small_load(problem: Problem) -> Problem:
    """Return a problem with a small load and the same mean load.

    Under a small load a crack stays open or closed if the mean load holds it.
    """
    return EQUATIONS_CLASS_BY_PARAMETER["resonance"].vary(problem, SMALL_LOAD_FACTOR)


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
        Factors for the load without its mean, above 0.
    tolerance : float, optional
        Take as many harmonics as this error requires at the end.
    progress, throw, **steps
        As in :func:`continue_frequency`: longest_step, most_points, turning_back.

    Returns
    -------
    ResponseCurve
        Curve with the parameter "resonance": a factor and the load frequency at each point. The
        status gives the number of points at which several modes answer together.

    Raises
    ------
    InputError
        An argument cannot be used.
    ConvergenceError
        No first point, or the end was not reached; the points so far are in the error's ``found``.

    Examples
    --------
    >>> curve = fc.follow_resonance(fc.Problem(structure, 2000.0, contact), 0.1, 10.0)
    """
    check_range(problem, "resonance", start, end)
    (problem, near), vary_load_factor = (
        _small_problem_and_start_omega(problem, near, tolerance),
        EQUATIONS_CLASS_BY_PARAMETER["resonance"].vary,
    )
    if tolerance is not None:
        end_point = _refined_point_and_error(
            first_phase_resonance(vary_load_factor(problem, end), near), tolerance
        )[0]
        problem = problem.with_harmonics(end_point.problem.harmonics)
    point = first_phase_resonance(vary_load_factor(problem, start), near)
    start_problem = replace(point.problem, structure=problem.structure, omega=point.omega)
    system = ResonanceSystem(
        start_problem, point.exciting_harmonic, point.contact_point, (start, end)
    )
    growing_curve = GrowingCurve(
        system, make_first_path_point(system, system.start_unknown, 0.0, 0), StepLimits(**steps)
    )
    curve = run_to_end(growing_curve, progress, throw)
    curve_unknowns_and_parameters = [
        (curve_point.unknown, system.parameter(curve_point.value))
        for curve_point in growing_curve.points
    ]
    n_multimode_points = sum(
        abs(system.linearise(*unknown_and_parameter).distance_to_peak_in_widths)
        > MAX_DISTANCE_TO_PEAK
        for unknown_and_parameter in curve_unknowns_and_parameters
    )
    if n_multimode_points:
        point_count_text = f"{n_multimode_points} of {format_count(len(curve), 'point')}"
        remark = (
            f"at {point_count_text} several modes answer together: another response may be larger"
        )
        curve = replace(curve, status=f"{curve.status}; {remark}")
    return curve
