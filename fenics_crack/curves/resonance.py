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
from fenics_crack.balance.solution import HarmonicBalanceSolver, PeriodicSolution
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
    require_run_up_structure,
)
from fenics_crack.curves.continuation import (
    ContinuationLimits,
    ContinuationLimitsKeywords,
    GrowingCurve,
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
from fenics_crack.numerics.equations import SPECIAL_POINT_TOLERANCE
from fenics_crack.numerics.newton import PathPoint, point_on_path, solve_by_full_or_damped_steps
from fenics_crack.numerics.path import (
    MIN_RESOLVED_DISTANCE,
    EndReason,
    Path,
    PathOptions,
    ZeroCrossing,
)

PATH_TO_RESONANCE_OPTIONS = PathOptions(
    0.05, 0.3, max_steps=300, max_path_points_per_call=8, parameter_range=(-4.0, 1.8)
)
"""Step options for the response curve to the first resonance.

The path parameter p gives the load frequency w_0 (1 - p / 2), with the start frequency w_0. The
curve may reach from w_0 / 10 to 3 w_0.
"""
MAX_DISTANCE_TO_PEAK_IN_WIDTHS = 0.1
"""Maximum distance, in half-power widths, from phase resonance to largest response of one mode.

Beyond, several modes answer together. At this distance the amplitude is 2 % below the top.
"""
SMALL_LOAD_FACTOR = 1e-3
"""Factor for a small load. Smaller factors would lose more to rounding beside a mean load."""
MAX_SPEED_CORRECTIONS = 20
"""Maximum number of secant steps to the speed at an engine order's resonance."""


@dataclass(frozen=True, repr=False)
class Resonance(Described):
    """Result of :func:`resonance_at`: phase resonance of a structure under its load.

    Attributes
    ----------
    value : float
        Load frequency, or speed of the rotor [rad/s].
    omega : float
        Load frequency [rad/s].
    harmonic : int
        Multiple of the load frequency that excites the resonance.
    width : float
        Half-power width, in the unit of ``value``.
    apart : float
        Estimated distance to the largest response, divided by the width. Positive if the largest
        response is at a higher frequency.
    solution : PeriodicSolution
        Motion at the resonance.
    error : float
        Estimated relative truncation error of the amplitude; inf if unknown, nan without a
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
        """True if the largest response is more than 0.1 half-power widths from the phase resonance.

        Several modes then answer together, and a response curve shows the largest response.
        """
        return not abs(self.apart) <= MAX_DISTANCE_TO_PEAK_IN_WIDTHS

    def to_dict(self) -> dict[str, Any]:
        """Return frequencies, width, distance to the largest response, error and amplitude."""
        names = "value", "omega", "harmonic", "width", "apart", "several", "error"
        columns_by_name = {name: getattr(self, name) for name in names}
        return add_frequency_entries(columns_by_name | {"amplitude": self.solution.amplitude()})


class _PhaseResonanceEvent(ZeroCrossing):
    """Event that ends a path at a phase resonance.

    The displacement at the load then has no part in phase with the load.
    """

    is_terminal, must_be_located, description = True, True, EndReason.TERMINAL_EVENT_REACHED.value


def first_phase_resonance(problem: Problem, from_omega: float) -> PhasePoint:
    """Return the first phase resonance on the response curve.

    The curve is followed upwards in frequency if displacement and load are in phase at
    ``from_omega`` [rad/s], else downwards. ``problem`` has a small structure.

    Raises
    ------
    InputError
        No damped mode answers to the load; or the problem has friction, a smooth law, or a
        subharmonic.
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
    balance_along_frequency = BalanceAlongFrequency(problem, start_omega, 0.5 * start_omega)
    start_unknown = (
        HarmonicBalanceSolver(balance_along_frequency.problem_at(start_omega))
        .solve()
        .gap_series_without_static_part
    )
    contact_point = balance_along_frequency.linearise(start_unknown, 0.0)
    n_load_harmonics = len(problem.structure.force) // 2
    exciting_harmonics = [
        ExcitingHarmonic.of_structure(problem.structure, harmonic_index + 1)
        for harmonic_index in range(n_load_harmonics)
    ]
    exciting_harmonic = max(
        exciting_harmonics,
        key=lambda exciting_harmonic: abs(exciting_harmonic.complex_work(contact_point).imag),
    )
    complex_work = exciting_harmonic.complex_work(contact_point)
    if not abs(complex_work.imag) > SPECIAL_POINT_TOLERANCE * abs(complex_work):
        load_requirement = "a load that excites a mode whose damping is not almost 0"
        raise InputError("load", float(abs(problem.structure.force).max()), load_requirement)

    def phase_cosine(path_point: PathPoint) -> float:
        """Return the cosine of the phase between load and displacement."""
        complex_work = exciting_harmonic.complex_work(
            balance_along_frequency.linearise(path_point.unknown, path_point.parameter)
        )
        return complex_work.real / abs(complex_work)

    start_path_point = point_on_path(balance_along_frequency, start_unknown, 0.0)
    if complex_work.real > 0.0:  # the resonance is above
        start_path_point = replace(start_path_point, tangent=start_path_point.tangent.reverse())
    resonance_path_point = Path(
        balance_along_frequency,
        start_path_point,
        PATH_TO_RESONANCE_OPTIONS,
        [_PhaseResonanceEvent(phase_cosine)],
    ).find_terminal_event_point_or_none()
    if resonance_path_point is None:
        raise ConvergenceError(
            f"no resonance was found on the curve from {from_omega:.6g} rad/s on; begin at a load "
            "frequency nearer to the resonance"
        )
    problem = replace(
        balance_along_frequency.problem,
        omega=balance_along_frequency.value(resonance_path_point.parameter),
    )
    resonance_system = ResonanceSystem(
        problem,
        exciting_harmonic,
        balance_along_frequency.linearise(
            resonance_path_point.unknown, resonance_path_point.parameter
        ),
    )
    return resonance_system.linearise(resonance_system.start_unknown, 0.0)


def _find_nearby_resonance(resonance_point: PhasePoint, **changes: Any) -> PhasePoint:
    """Return the resonance of a changed problem, searched from a known resonance.

    ``changes`` are :class:`Problem` fields with new contents. If Newton's method fails, the
    response curve of the changed problem is followed from the known frequency.
    """
    problem_fields = {"omega": resonance_point.omega, "static_above": None} | changes
    problem = replace(resonance_point.problem, **problem_fields)
    system = ResonanceSystem(
        problem, resonance_point.exciting_harmonic, resonance_point.linearised_balance
    )
    tolerance = max(SPECIAL_POINT_TOLERANCE, system.rounding(0.0))
    path_point = solve_by_full_or_damped_steps(
        system, system.start_unknown, 0.0, tolerance=tolerance
    )
    if path_point is None:
        return first_phase_resonance(problem, problem.omega)
    return system.linearise(path_point.unknown, 0.0)


def _refined_point_and_error(
    resonance_point: PhasePoint, tolerance: float
) -> tuple[PhasePoint, float]:
    """Double the harmonics of a resonance until the error meets a tolerance.

    The doubling also ends if several modes answer together, at 100 harmonics, or if no resonance is
    found. The error is the larger of two numbers:

    - The change from half as many harmonics: relative change of the amplitude, plus the amplitude
      loss due to the frequency shift, 2 (shift / half-power width)^2.
    - The displacement's relative error by omitted harmonics, predicted with the exact motion. Used
      as the change may be small by chance: many harmonics add nothing until a harmonic excites a
      mode.

    Returns
    -------
    resonance_point : PhasePoint
        Resonance with the harmonics reached.
    relative_amplitude_error : float
        Relative error of the amplitude; inf if unknown.
    """
    relative_amplitude_error, n_harmonics = math.inf, 2 * resonance_point.problem.harmonics
    while (
        relative_amplitude_error > tolerance
        and abs(resonance_point.distance_to_peak_in_widths) <= MAX_DISTANCE_TO_PEAK_IN_WIDTHS
        and n_harmonics <= MAX_HARMONIC_ORDER
    ):
        try:
            finer_point = _find_nearby_resonance(resonance_point, harmonics=n_harmonics)
        except ConvergenceError:
            break
        amplitude_change = (
            finer_point.solution.amplitude() / resonance_point.solution.amplitude() - 1.0
        )
        frequency_shift_in_widths = (
            finer_point.omega - resonance_point.omega
        ) / finer_point.half_power_width
        harmonics_error = abs(amplitude_change) + 2.0 * frequency_shift_in_widths**2
        relative_amplitude_error = max(harmonics_error, finer_point.solution.report.displacement)
        resonance_point, n_harmonics = finer_point, 2 * n_harmonics
    return resonance_point, relative_amplitude_error


def _find_order_crossing_and_speed_slope(
    resonance_point: PhasePoint, engine_order: float | None
) -> tuple[PhasePoint, float]:
    """Find the rotor speed at which an engine order meets the resonance.

    The load frequency is engine order times speed. The resonance frequency changes with the speed,
    too. The secant method varies the speed, at most 20 times.

    Parameters
    ----------
    resonance_point : PhasePoint
        Resonance at the structure's own speed.
    engine_order : float or None
        Load frequency divided by rotor speed; None: the speed does not change.

    Returns
    -------
    resonance_point : PhasePoint
        Resonance at the speed of the crossing; the given point without an order.
    resonance_rate : float
        d(w_r / m) / dW, with resonance frequency w_r, engine order m and rotor speed W; 0 without
        an order. Used to convert the half-power width from frequency to speed.

    Raises
    ------
    ConvergenceError
        No such speed was found.
    """
    if engine_order is None:
        return resonance_point, 0.0
    run_up_structure, resonance_omega = (
        require_run_up_structure(resonance_point.problem.structure),
        resonance_point.omega,
    )
    speed, resonance_speed_slope = (
        run_up_structure.speed,
        run_up_structure.stiffening_exponent(
            resonance_omega * resonance_point.exciting_harmonic.harmonic
        ),
    )
    for _ in range(MAX_SPEED_CORRECTIONS):
        next_speed = (resonance_omega / engine_order - resonance_speed_slope * speed) / (
            1.0 - resonance_speed_slope
        )
        if abs(next_speed - speed) <= MIN_RESOLVED_DISTANCE * speed:
            return resonance_point, resonance_speed_slope
        resonance_point = _find_nearby_resonance(
            resonance_point,
            structure=run_up_structure.at_speed(next_speed),
            omega=engine_order * next_speed,
        )
        resonance_speed_slope = (
            (resonance_point.omega - resonance_omega) / engine_order / (next_speed - speed)
        )
        speed, resonance_omega = next_speed, resonance_point.omega
    raise ConvergenceError(
        f"the engine order meets no resonance near the speed {speed:.6g} rad/s; begin at a speed "
        "nearer to the crossing, which fenics-crack campbell shows"
    )


def _small_problem_and_start_omega(
    problem: Problem, near_omega: float | None, tolerance: float | None
) -> tuple[Problem, float]:
    """Return the problem with a small structure, and the start frequency [rad/s].

    A structure with many dofs is replaced by a reduced model in which contact dofs carry no mass.
    The start frequency is ``near_omega``, or the problem's frequency if this is None. Raises
    InputError unless ``near_omega`` and ``tolerance`` are positive or None.
    """
    for argument_name, value in ("near", near_omega), ("tolerance", tolerance):
        if value is not None:
            check_number(argument_name, value, 0.0, excludes_bound=True)
    if not is_small(problem.structure):
        problem = replace(problem, structure=reduce_structure(problem.structure, method="massless"))
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
    test. The largest response is next to it, unless several modes answer together
    (:attr:`Resonance.several`). The response curve is followed upwards in frequency if displacement
    and load are in phase at the start, otherwise downwards.

    ``resonance_at(structure, law, omega)`` is short for a problem with 5 harmonics, or as many as
    the load has.

    Parameters
    ----------
    problem : Problem
        Structure, law, harmonics, and a load frequency. A structure with many dofs is first reduced
        to a model whose crack faces have no mass.
    near : float, optional
        Load frequency [rad/s] at which the search begins; default: the problem's.
    parameter : "omega" or "speed"
        Quantity in which the resonance is given: the load frequency; or the speed of a rotor from
        :func:`fenics_crack.run_up_structure`, whose modes change with the speed. The load frequency
        then keeps its ratio to the speed.
    tolerance : float, optional
        Double the harmonics until the estimated relative error of the amplitude is below this, or
        until several modes answer together: the response curve shows more then.

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
        if isinstance(parameter, str):
            raise InputError("omega", None, "given: fc.resonance_at(structure, contact, omega)")
        n_harmonics = max(Problem.harmonics, least_harmonics(problem, 1))
        problem = Problem(problem, parameter, near, n_harmonics)
        near, parameter = None, "omega"
    check_choice("parameter", parameter, ("omega", "speed"))
    engine_order, amplitude_error = None, math.nan
    if parameter == "speed":
        engine_order = problem.omega / require_run_up_structure(problem.structure).speed
    resonance_point = first_phase_resonance(
        *_small_problem_and_start_omega(problem, near, tolerance)
    )
    resonance_point, resonance_rate = _find_order_crossing_and_speed_slope(
        resonance_point, engine_order
    )
    if tolerance is not None:
        resonance_point, amplitude_error = _refined_point_and_error(resonance_point, tolerance)
        resonance_point, resonance_rate = _find_order_crossing_and_speed_slope(
            resonance_point, engine_order
        )
    omega, omega_per_value = resonance_point.omega, engine_order or 1.0
    width = resonance_point.half_power_width / omega_per_value / (1.0 - resonance_rate)
    return Resonance(
        omega / omega_per_value,
        omega,
        resonance_point.exciting_harmonic.harmonic,
        width,
        resonance_point.distance_to_peak_in_widths,
        resonance_point.solution,
        amplitude_error,
    )


def problem_at_small_load(problem: Problem) -> Problem:
    """Return a problem with a thousandth of the vibrating load; the mean load stays.

    Used to find the resonance at small amplitudes. A crack then stays open or closed if the mean
    load holds it so.
    """
    return EQUATIONS_CLASS_BY_PARAMETER["resonance"].vary_problem(problem, SMALL_LOAD_FACTOR)


def follow_resonance(
    problem: Problem,
    start: float,
    end: float,
    *,
    near: float | None = None,
    tolerance: float | None = None,
    progress: bool = False,
    throw: bool = True,
    **steps: Unpack[ContinuationLimitsKeywords],
) -> ResponseCurve:
    """Follow a phase resonance over a factor for the vibrating load.

    Parameters
    ----------
    problem : Problem
        Structure, law, harmonics, and a load frequency. A structure with many dofs is first reduced
        to a model whose crack faces have no mass.
    start, end : float
        First and last factor for the load without its mean, above 0.
    near : float, optional
        Load frequency [rad/s] at which the search begins; default: the problem's.
    tolerance : float, optional
        Relative error of the amplitude at the last factor, for which the harmonics are chosen.
    progress : bool
        Show a progress bar.
    throw : bool
        Raise if the end is not reached; otherwise return the points so far.
    **steps
        Keywords for :class:`ContinuationLimits`: longest_step, most_points, max_turn_back_fraction.

    Returns
    -------
    ResponseCurve
        Curve with the parameter "resonance": a factor and the load frequency at each point. If
        several modes answer together at some points, the status gives their number.

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
    problem, near = _small_problem_and_start_omega(problem, near, tolerance)
    problem_with_load_factor = EQUATIONS_CLASS_BY_PARAMETER["resonance"].vary_problem
    if tolerance is not None:
        resonance_at_end_factor = _refined_point_and_error(
            first_phase_resonance(problem_with_load_factor(problem, end), near), tolerance
        )[0]
        problem = problem.with_harmonics(resonance_at_end_factor.problem.harmonics)
    resonance_at_start_factor = first_phase_resonance(
        problem_with_load_factor(problem, start), near
    )
    start_problem = replace(
        resonance_at_start_factor.problem,
        structure=problem.structure,
        omega=resonance_at_start_factor.omega,
    )
    system = ResonanceSystem(
        start_problem,
        resonance_at_start_factor.exciting_harmonic,
        resonance_at_start_factor.linearised_balance,
        (start, end),
    )
    growing_curve = GrowingCurve(
        system,
        make_first_path_point(system, system.start_unknown, 0.0, 0),
        ContinuationLimits(**steps),
    )
    curve = run_to_end(growing_curve, progress, throw)
    resonance_points = (
        system.linearise(curve_point.unknown, system.parameter(curve_point.value))
        for curve_point in growing_curve.points
    )
    n_points_far_from_peak = sum(
        abs(resonance_point.distance_to_peak_in_widths) > MAX_DISTANCE_TO_PEAK_IN_WIDTHS
        for resonance_point in resonance_points
    )
    if n_points_far_from_peak:
        remark_text = (
            f"at {n_points_far_from_peak} of {format_count(len(curve), 'point')} several modes "
            "answer "
            "together: another response may be larger, which a curve over omega at this load shows"
        )
        curve = replace(curve, status=f"{curve.status}; {remark_text}")
    return curve
