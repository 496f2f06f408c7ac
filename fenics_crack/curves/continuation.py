"""Response curves: solutions followed over a parameter, through resonances, folds and branches.

Pseudo-arc-length continuation (:mod:`fenics_crack.numerics.path`) follows a system
(:mod:`curve_system`): the condensed equations of harmonic balance (:mod:`balance_equations`), or
exact periodic orbits (:mod:`orbits`). A point takes the small or reduced structure alone, in closed
form. A curve therefore costs the same on any mesh.

With harmonic balance, root finding locates folds. The sign of det J, the Jacobian determinant,
shows branch points, and shrinking steps locate them. If J is not formed
(:data:`fenics_crack.balance.contact_system.MAX_UNKNOWNS_WITH_JACOBIAN`), branch points go
unnoticed. Verdicts follow after the curve (:mod:`verdicts`).

Along orbits, Newton's method forms the monodromy matrix at each point for the tangent.
Multipliers, steps that resolve them, and all bifurcations (:mod:`orbit_events`) then cost only the
matrix's eigenvalues.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TypedDict, Unpack

import numpy as np

from fenics_crack.balance.harmonic_balance import (
    check_initial,
    search_orbit_by_harmonic_balance,
    solve_from_neighbour,
)
from fenics_crack.balance.problem import Problem, check_memory
from fenics_crack.balance.solution import HarmonicBalanceSolver, PeriodicSolution
from fenics_crack.basics.errors import (
    DEFAULT_ERROR_TOLERANCE,
    ConvergenceError,
    InputError,
    check_choice,
    check_count,
    check_number,
)
from fenics_crack.basics.suggestions import (
    check_argument_class_or_unwrap_run,
    keep_old_attribute_names,
)
from fenics_crack.basics.tables import format_count, format_in_unit
from fenics_crack.curves.balance_equations import EQUATIONS_CLASS_BY_PARAMETER
from fenics_crack.curves.branch import ReturnToParent, find_branch_start_point
from fenics_crack.curves.curve import (
    MIN_ORBIT_HARMONICS,
    Bifurcation,
    CurvePoint,
    ResponseCurve,
    axis_factor_name_and_unit,
    leading_multiplier_in_upper_half,
)
from fenics_crack.curves.curve_system import CurveSystem
from fenics_crack.curves.orbits import system_along
from fenics_crack.curves.verdicts import judge_curve
from fenics_crack.model.contact import is_rigid
from fenics_crack.model.modal import is_small
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.motion.flow import exact_flow_or_error, exact_flow_or_none
from fenics_crack.motion.orbit import MAX_MODES_FOR_MONODROMY, PeriodicOrbit, is_load_too_slow
from fenics_crack.numerics.newton import PathPoint, Tangent, tangent_of
from fenics_crack.numerics.path import (
    MIN_RESOLVED_DISTANCE,
    ClosedLoop,
    ConsecutivePathPoints,
    EndReason,
    Event,
    Path,
    PathOptions,
    Target,
    step_control_values_or_none,
)


class ContinuationLimitsKeywords(TypedDict, total=False):
    """Keyword arguments for the steps along a curve.

    longest_step, most_points and max_turn_back_fraction, as in :class:`ContinuationLimits`.
    """

    longest_step: float
    most_points: int
    max_turn_back_fraction: float


@dataclass(frozen=True)
class ContinuationLimits:
    """Step limits for a curve.

    Attributes
    ----------
    longest_step : float
        Longest step, relative to the parameter range and to the solution's size; at most 1.
    most_points : int
        Maximum number of points.
    max_turn_back_fraction : float
        How far the curve may turn back past its start, relative to the parameter range.
    """

    longest_step: float = 0.05
    most_points: int = 50_000
    max_turn_back_fraction: float = 0.1

    def __post_init__(self) -> None:
        check_number("longest_step", self.longest_step, 0.0, excludes_bound=True)
        if self.longest_step > 1.0:
            raise InputError("longest_step", self.longest_step, "at most 1")
        check_count("most_points", self.most_points, 1)
        check_number("max_turn_back_fraction", self.max_turn_back_fraction, 0.0)


@keep_old_attribute_names(describe_values="describe_parameter_and_point_count")
class GrowingCurve:
    """Curve that grows from a first point, by iteration or by :meth:`run`.

    Parameters
    ----------
    system : CurveSystem
        Equations, followed from the first point to the path parameter p = 1; a branch may also end
        at p = 0.
    start_point : PathPoint
        First point, with the direction.
    continuation_limits : ContinuationLimits
        Longest step, most points, and allowed turning back.
    tolerance : float, optional
        Error tolerance for solutions from exact orbits; None: harmonic balance.
    is_branch : bool
        True if the curve leaves another curve at a bifurcation.

    Attributes
    ----------
    system : CurveSystem
    points : list of CurvePoint
        Points so far.
    most_points : int
        Maximum number of points.
    complete : bool
        True if the curve reached the end, or closed.
    has_returned : bool
        True if the curve closed or went past its start, instead of reaching the end.
    status : str
        Reason for the end.
    """

    def __init__(
        self, system: CurveSystem, start_point: PathPoint, continuation_limits: ContinuationLimits,
        tolerance: float | None = None, is_branch: bool = False,
    ) -> None:  # fmt: skip
        self.system, self._continuation_limits = system, continuation_limits
        self._tolerance, self._is_branch = tolerance, is_branch
        self.most_points = continuation_limits.most_points
        self._start_path_point = self._last_path_point = start_point
        self.points = [self._convert_path_point(start_point)]
        self._kinds_and_special_points: list[tuple[str, CurvePoint]] = []
        self.complete, self.has_returned, self.status = False, False, "not begun"

    def _convert_path_point(self, point: PathPoint) -> CurvePoint:
        """Convert a path point to a point of the curve."""
        return self._make_curve_point(
            point.parameter, point.unknown, point.iterations, point.step_control_values
        )

    def _make_curve_point(
        self,
        parameter: float,
        unknown: np.ndarray,
        iterations: int,
        multipliers_and_counts: np.ndarray | None,
    ) -> CurvePoint:
        """Make a curve point from a path point's numbers.

        Parameters
        ----------
        parameter : float
            Path parameter, 0 at the curve's start and 1 at the end.
        unknown : array of ``system.shape``
            Solution.
        iterations : int
            Newton iterations.
        multipliers_and_counts : (k + 3,) complex or None
            An exact orbit's k leading multipliers, then three counts of multipliers outside the
            unit circle: real above 1, real below -1, complex pairs. None: harmonic balance.
        """
        value = self.system.value(parameter)
        omega = self.system.omega(value, unknown)
        multipliers = None if multipliers_and_counts is None else multipliers_and_counts[:-3]
        return CurvePoint(value, omega, unknown, iterations, multipliers)

    # --- what there is so far ---------------------------------------------------------------------

    @property
    def unjudged_curve(self) -> ResponseCurve:
        """Points so far as a curve; for harmonic balance, without stability."""
        system, points = self.system, self.points
        problem, is_exact = system.problem, self._tolerance is not None
        leading_multipliers = [
            leading_multiplier_in_upper_half(point.multipliers)
            for point in points
            if point.multipliers is not None
        ]
        curve = ResponseCurve(
            structure=problem.structure,
            contact=problem.contact,
            parameter=system.parameter_name,
            values=np.array([point.value for point in points]),
            omega=np.array([point.omega for point in points]),
            iterations=np.array([point.iterations for point in points]),
            bifurcations=(),
            complete=self.complete,
            status=self.status,
            subharmonic=problem.subharmonic,
            points=np.array(
                [system.unscaled_solution(point.unknown, point.value) for point in points]
            ),
            tolerance=self._tolerance,
            samples=problem.samples,
            static_above=None if is_exact else problem.static_cutoff,
            multipliers=np.array(leading_multipliers) if is_exact else None,
            branch=self._is_branch,
        )
        bifurcations = []
        for bifurcation_kind, curve_point in self._kinds_and_special_points:
            unscaled_point_solution = system.unscaled_solution(
                curve_point.unknown, curve_point.value
            )
            bifurcations.append(
                curve.bifurcation(
                    bifurcation_kind,
                    curve_point.value,
                    curve_point.omega,
                    unscaled_point_solution,
                    curve_point.multipliers,
                )
            )
        return replace(curve, bifurcations=tuple(bifurcations))

    @property
    def curve(self) -> ResponseCurve:
        """Points so far as a curve; a subclass adds the stability if requested."""
        return self.unjudged_curve

    def progress_fraction(self) -> float:
        """Return the completed fraction of the path from start to end.

        The fraction is the path parameter at the last point, limited to the range from 0 to 1.
        """
        return min(1.0, max(0.0, self._last_path_point.parameter))

    def describe_progress(self) -> str:
        """Return a progress text: completed percentage, parameter range and number of points."""
        requested_start_and_end_values = self.system.start, self.system.end
        return (
            f"{self.progress_fraction():.0%} of the way between "
            f"{self.describe_parameter_and_point_count(*requested_start_and_end_values)}"
        )

    def describe_parameter_and_point_count(self, *values: float) -> str:
        """Return parameter values in their unit, and the number of points, as text.

        Without ``values``, the value at the last point is described.
        """
        axis = axis_factor_name_and_unit(self.system.parameter_name, True)
        point_count_text = format_count(len(self.points), "point")
        return f"{format_in_unit(axis, *(values or (self.points[-1].value,)))}, {point_count_text}"

    # --- how it goes on ---------------------------------------------------------------------------

    def __iter__(self) -> Iterator[CurvePoint]:
        """Yield the last point so far, then each further point."""
        yield self.points[-1]
        for segment in self._yield_segments():
            for one_point_segment in segment.yield_one_point_segments():
                yield self._append_segment(one_point_segment)

    def run(self) -> None:
        """Follow the curve to its end.

        Used instead of iteration, as it is faster: whole segments without events are recorded
        together.
        """
        for segment in self._yield_segments():
            self._append_segment(segment)

    def _yield_segments(self) -> Iterator[ConsecutivePathPoints]:
        """Follow the path from the last point to the end, and yield it in segments.

        Sets ``status``, ``complete`` and ``has_returned``.
        """
        if self.complete:
            return
        system = self.system
        last_point = self._last_path_point
        longest_step = self._continuation_limits.longest_step
        self.status = "under way"
        watched_events: list[Event] = [event_class() for event_class in system.event_classes]
        watched_events += [Target(1.0), ClosedLoop(self._start_path_point, system)]
        if self._is_branch:
            watched_events.append(Target(0.0))
            if system.problem.subharmonic % 2 == 0:
                watched_events.insert(0, ReturnToParent(system))
        path_options = PathOptions(
            initial_step=0.2 * longest_step,
            max_step=longest_step,
            min_step=max(MIN_RESOLVED_DISTANCE, system.rounding(last_point.parameter)),
            max_steps=self.most_points + 1 - len(self.points),
            max_path_points_per_call=max(
                1, min(PathOptions.max_path_points_per_call, system.max_path_points_per_call)
            ),
            parameter_range=(-self._continuation_limits.max_turn_back_fraction, np.inf),
        )
        path = Path(
            system, last_point, path_options, watched_events, system.make_step_control(longest_step)
        )
        yield from path
        assert path.end_reason is not None
        self.complete = path.terminal_event is not None
        self.status = (
            path.terminal_event.description
            if path.terminal_event
            else path.end_reason.describe(self.most_points)
        )
        self.has_returned = path.end_reason is EndReason.RANGE_LEFT or isinstance(
            path.terminal_event, ClosedLoop
        )

    def _append_segment(self, segment: ConsecutivePathPoints) -> CurvePoint:
        """Append a path segment's points and special points to the curve.

        Returns the segment's last point.
        """
        kinds_and_special_points = [
            (event.kind, self._convert_path_point(path_point))
            for event, path_point in segment.located_events
            if event.kind
        ]
        self._kinds_and_special_points += kinds_and_special_points
        multipliers_and_counts = (
            segment.step_control_values
            if "step_control_values" in vars(segment)
            else [None] * len(segment)
        )
        parameters, iterations_of_segment_points = (
            segment.parameters.tolist(),
            segment.iterations.tolist(),
        )
        self.points += map(
            self._make_curve_point,
            parameters,
            segment.unknowns,
            iterations_of_segment_points,
            multipliers_and_counts,
        )
        self._last_path_point = segment[-1]
        kinds_and_values = tuple(
            (kind, curve_point.value) for kind, curve_point in kinds_and_special_points
        )
        self.points[-1] = replace(self.points[-1], bifurcations=kinds_and_values)
        return self.points[-1]


@keep_old_attribute_names(progress="progress_fraction")
class Continuation(GrowingCurve):
    """Curve that grows point by point, in a loop; ``curve`` has the points so far.

        for point in Continuation(Problem(plate, 1000.0, law), "omega", 1000.0, 3000.0):
            ...

    Parameters
    ----------
    problem : Problem
        Problem at the first point. A structure with many dofs is first reduced to a model whose
        crack faces have no mass (``reduce_structure(structure, method="massless")``). The
        problem's ``omega`` is the load frequency, unless the parameter is "omega". All points have
        the same quasi-static modes: those above ``static_above``. Default: 2 H times the response's
        highest frequency on the curve, with the first point's H.
    parameter : str
        "omega": load frequency [rad/s]. "load", "stiffness", "damping", "friction": factor of the
        load, the contact stiffness, the structure's damping, or the coefficient of friction.
        "clearance": clearance added to every pair [m]. "speed": rotor speed [rad/s], which
        ``omega`` follows.
    start, end : float
        Values of the parameter; the end may be below the start.
    exact : bool
        Follow exact periodic orbits. The problem's harmonics are then ignored.
    initial : PeriodicSolution, PeriodicOrbit or Bifurcation, optional
        A solution near the first point; for exact orbits, the orbit at ``start`` is allowed, too.
        From a bifurcation the curve is the branch that begins there. ``start`` and ``end`` then
        bound the parameter on either side (:func:`follow_branch`).
    branch_of : ResponseCurve, optional
        Curve with the bifurcation ``initial``.
    tolerance : float, optional
        Harmonic balance: choose the number of harmonics, from the problem's ``harmonics`` to 500.
        The truncation error at the first point is then below the tolerance; ``samples`` must be
        None. Exact orbits: the curve's ``tolerance``; default: the value of ``branch_of``, or
        0.01.
    stability : bool
        Assess ``curve`` on each access (:func:`judge_curve`). Exact orbits always have their
        stability.
    longest_step : float
        Longest step, relative to the parameter range and to the solution's size; at most 1;
        default: 0.05.
    most_points : int
        Maximum number of points; default: 50,000.
    max_turn_back_fraction : float
        How far the curve may turn back past its start, relative to the parameter range; default:
        0.1. A frequency, damping or speed of zero is never reached. A closed curve is recognised
        only within this distance.

    Attributes
    ----------
    complete : bool
        True if the curve reached the end, or closed.
    has_returned : bool
        True if the curve closed or went past its start, instead of reaching the end.
    status : str
        Reason for the end.

    Raises
    ------
    InputError
        An argument cannot be used, or there is no exact flow whose orbits can be followed.
    ConvergenceError
        No first point.
    """

    def __init__(
        self,
        problem: Problem,
        parameter: str,
        start: float,
        end: float,
        *,
        exact: bool = False,
        initial: PeriodicSolution | PeriodicOrbit | Bifurcation | None = None,
        branch_of: ResponseCurve | None = None,
        tolerance: float | None = None,
        stability: bool = False,
        **steps: Unpack[ContinuationLimitsKeywords],
    ) -> None:
        if parameter == "resonance":
            raise InputError("parameter", parameter, "another parameter: use follow_resonance")
        continuation_limits = ContinuationLimits(**steps)
        check_argument_class_or_unwrap_run("problem", problem, "Problem", ("Problem",))
        check_argument_class_or_unwrap_run("stability", stability, "bool", ())
        if exact and tolerance is None:
            tolerance = DEFAULT_ERROR_TOLERANCE if branch_of is None else branch_of.tolerance
        if tolerance is not None:
            check_number("tolerance", tolerance, 0.0, excludes_bound=True)
        if problem.samples is not None:
            check_count("samples", problem.samples, 4 * problem.harmonics + 1)
            if tolerance is not None:
                raise InputError("samples", problem.samples, "left out with a tolerance")
        check_range(problem, parameter, start, end)
        if 0.0 < start < end and parameter in ("omega", "damping", "speed"):  # may not reach 0
            allowed_turn_back_fraction = min(
                continuation_limits.max_turn_back_fraction, 0.9 * start / (end - start)
            )
            continuation_limits = replace(
                continuation_limits, max_turn_back_fraction=allowed_turn_back_fraction
            )
        if exact:
            problem = problem.with_harmonics(problem.response_harmonics(MIN_ORBIT_HARMONICS))
        if parameter in ("omega", "speed"):
            problem = EQUATIONS_CLASS_BY_PARAMETER[parameter].vary_problem(problem, start)
        if not is_small(problem.structure):
            reduced_structure = reduce_structure(problem.structure, method="massless")
            problem = replace(problem, structure=reduced_structure)
            if isinstance(initial, PeriodicSolution) and not exact:  # only its gaps are used
                initial = replace(initial, structure=reduced_structure)
        self._needs_verdicts = stability and not exact
        if self._needs_verdicts and is_rigid(problem.contact):
            exact_flow_or_error(problem.structure, problem.contact)

        start_problem = EQUATIONS_CLASS_BY_PARAMETER[parameter].vary_problem(problem, start)
        is_branch = isinstance(initial, Bifurcation)
        if not (exact or is_branch):
            if initial is not None:
                check_initial(start_problem, initial)  # type: ignore[arg-type]
            if tolerance is not None:
                initial = solve_from_neighbour(start_problem, initial, tolerance)  # type: ignore[arg-type]
                problem = problem.with_harmonics(initial.harmonics)
            check_memory(problem.structure, problem.harmonics)
        system = system_along(exact, problem, parameter, start, end)
        if isinstance(initial, Bifurcation):
            point = find_branch_start_point(
                system, initial, continuation_limits.longest_step, branch_of
            )
            start_point = make_first_path_point(
                system, point.unknown, point.parameter, point.iterations, point.tangent
            )
        elif exact:
            orbit = _find_start_orbit(start_problem, initial)
            start_point = make_first_path_point(
                system, system.unknown(orbit.state, start), 0.0, orbit.iterations
            )
        else:
            solution = HarmonicBalanceSolver(system.problem_at(start)).solve(initial)  # type: ignore[arg-type]
            start_point = make_first_path_point(
                system, solution.gap_series_without_static_part, 0.0, solution.iterations
            )
        super().__init__(
            system, start_point, continuation_limits, tolerance if exact else None, is_branch
        )

    @property
    def curve(self) -> ResponseCurve:
        """Points so far as a curve; with ``stability=True``, with their stability."""
        return judge_curve(self.unjudged_curve) if self._needs_verdicts else self.unjudged_curve


def make_first_path_point(
    system: CurveSystem, unknown: np.ndarray, parameter: float, iterations: int,
    direction: Tangent | None = None,
) -> PathPoint:  # fmt: skip
    """Return a solution with its tangent, as the first point of a curve.

    Parameters
    ----------
    system : CurveSystem
        Equations of the curve.
    unknown : array of ``system.shape``
        Solution.
    parameter : float
        Path parameter of the solution, 0 at the curve's start and 1 at the end.
    iterations : int
        Newton iterations that found the solution; the point keeps their number.
    direction : Tangent, optional
        The tangent's angle to this direction is below 90 degrees; default: the path parameter
        grows.

    Returns
    -------
    PathPoint
        An exact orbit also has its monodromy matrix and multipliers, for step control.
    """
    linearisation = system.linearise(unknown, parameter)
    tangent = tangent_of(system, unknown, linearisation, direction)
    step_control_values = step_control_values_or_none(system, linearisation)
    record = None if step_control_values is None else linearisation.record.ravel()
    return PathPoint(
        unknown,
        parameter,
        iterations,
        tangent,
        record=record,
        step_control_values=step_control_values,
    )


def can_follow_orbits(problem: Problem, parameter: str, start: float, end: float) -> bool:
    """Return True if exact orbits can be followed along a parameter.

    The structure must be small, and the law must have an exact flow with at most 120 modes. At
    ``start`` and ``end``, the load must not be too slow for time integration. InputError: the curve
    cannot run from ``start`` to ``end`` (:func:`check_range`).
    """
    check_range(problem, parameter, start, end)
    flow = exact_flow_or_none(problem.structure, problem.contact)
    if flow is None or flow.n_modes > MAX_MODES_FOR_MONODROMY:
        return False
    end_frequencies = [
        EQUATIONS_CLASS_BY_PARAMETER[parameter].vary_problem(problem, value).omega
        for value in (start, end)
    ]
    return not any(is_load_too_slow(flow, omega, problem.subharmonic) for omega in end_frequencies)


def check_range(problem: Problem, parameter: str, start: float, end: float) -> None:
    """Raise InputError unless a curve can run from ``start`` to ``end`` of a parameter.

    The values must differ and suit the structure. Without clearance, load factors must not be zero
    or change their sign. A rigid contact has no stiffness to vary.
    """
    structure = problem.structure
    check_choice("parameter", parameter, EQUATIONS_CLASS_BY_PARAMETER)
    if is_rigid(problem.contact) and parameter == "stiffness":
        raise InputError(
            "parameter", parameter, "another parameter: rigid contact has no stiffness"
        )
    end_keys = ("omega_start", "omega_end") if parameter == "omega" else ("start", "end")
    for end_key, value in zip(end_keys, (start, end), strict=True):
        EQUATIONS_CLASS_BY_PARAMETER[parameter].check_value(structure, end_key, value)
    if start == end:
        raise InputError(end_keys[1], end, f"different from {end_keys[0]}")
    if parameter == "load" and start * end <= 0.0 and not np.any(structure.clearance):
        requirement = "both > 0 or both < 0, as without clearance the motion vanishes at 0"
        raise InputError("start, end", (start, end), requirement)


def _find_start_orbit(
    problem: Problem, initial: PeriodicSolution | PeriodicOrbit | None
) -> PeriodicOrbit:
    """Return the exact orbit at the start of a curve.

    If ``initial`` is an orbit, it is returned unchanged. If it is a solution, the search begins
    there; if None, at harmonic-balance solutions. Raises ConvergenceError without an orbit.
    """
    if isinstance(initial, PeriodicOrbit):
        return initial
    if initial is not None:
        check_initial(problem, initial)
    search_result = search_orbit_by_harmonic_balance(problem, initial)
    if search_result.orbit is None:
        failure_words = (
            f"no exact orbit was found at {problem.omega:g} rad/s: {search_result.outcome_text}"
        )
        advice_words = (
            "give harmonics instead of a tolerance to follow the curve by harmonic balance"
        )
        raise ConvergenceError(f"{failure_words}; {advice_words}")
    return search_result.orbit
