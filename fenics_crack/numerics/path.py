"""Pseudo-arc-length continuation of solutions F(x, p) = 0 along a parameter p, through folds.

A step of length h from the point (x, p) with the tangent (t_x, t_p):

1. The next point is predicted: (x, p) + h (t_x, t_p), plus cubic terms from the previous point and
   tangent.
2. Newton's method corrects the prediction in the plane orthogonal to the tangent (:mod:`newton`).
3. The next step is longer after few iterations. If the iterations fail or leave the path, the step
   is repeated with half the length.

A large angle between the new and the old tangent shows that the path was left. A point has two
tangents, of opposite directions. The correct tangent keeps the sign of t_p det J, since that sign
changes only at a crossing with another branch.

If J is not formed, det J is unknown. Then

- The tangent with the smaller angle to the previous tangent is taken.
- The chord must agree with both tangents, or a step across a narrow turn might lead back.
- Crossings with other branches go unnoticed.
- A system may give some unknowns less weight in these angles (``angle_weights``).

The steps run in the kernel (``kernel/path.c``), many of them in one call for compiled equations
(:mod:`equations`). An :class:`Event` may lie between two points: a fold, a wanted parameter, a
closed loop, a crossing with a branch, or a zero of any function. Terminal events end the path. A
:class:`StepRejectionRule` may reject steps by control values of the points.

References
----------
Keller, in Applications of Bifurcation Theory, 1977.
Seydel, Practical Bifurcation and Stability Analysis, chapter 4.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import Enum
from typing import overload

import numpy as np

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.kernel import NULL, Struct, kernel, pointer
from fenics_crack.numerics.equations import (
    MACHINE_EPSILON,
    ROUNDING,
    SPECIAL_POINT_TOLERANCE,
    Linearisation,
    System,
    equations_of,
)
from fenics_crack.numerics.newton import (
    MAX_PARAMETER_CHANGE_IN_STEPS,
    PathPoint,
    Tangent,
    chord_length,
    correction_struct,
    solve_at_parameter,
    solve_in_plane,
    tangent_of,
    try_step,
)

MIN_EQUAL_DIRECTION_COSINE = 0.9
"""Minimum cosine of the angle between two equal directions, for the closed-loop test."""
POINTS_PER_CALL_AFTER_HALVING = 3
"""Maximum points per kernel call after a step control halved a step. Once steps have their full
length again, the number doubles from call to call."""
MIN_RESOLVED_DISTANCE = math.sqrt(MACHINE_EPSILON)
"""Distance on a path below which two points count as equal, and default minimum step: 1.5e-8. At a
fold the parameter is then accurate to the square, machine epsilon."""


@dataclass(frozen=True)
class PathOptions:
    """Options for path following. Step lengths are in the norm of the tangent.

    The norm is w |x|^2 + p^2, with unknowns x, parameter p and w = 1 / |x|^2 at the point.
    """

    initial_step: float
    """Length of the first step."""
    max_step: float
    """Maximum step length."""
    min_step: float = MIN_RESOLVED_DISTANCE
    """Minimum step length. If a step would be shorter, the path ends."""
    max_steps: int = 1000
    """Maximum number of new points."""
    rtol: float = 1e-9
    """Maximum relative residual |F| / |x| of a point. Short steps get a smaller limit."""
    min_cosine: float = 0.85
    """Minimum cosine of the angle between neighbouring tangents. Below, the step is halved."""
    rounding: float = ROUNDING
    """Rounding error of the relative residual |F| / |x|, for a system without ``rounding``."""
    max_path_points_per_call: int = 64
    """Maximum points per kernel call."""
    parameter_range: tuple[float, float] = (-np.inf, np.inf)
    """Smallest and largest parameter. The path ends before a point outside."""


HOMOTOPY_OPTIONS = PathOptions(0.3, 0.3, min_cosine=0.5, parameter_range=(0.0, 2.0))
"""Options for homotopy paths with a parameter from 0 to 1. A path ends if the parameter leaves the
range from 0 to 2."""


class EndReason(Enum):
    """Reason for the end of a path. The values are texts for messages.

    TERMINAL_EVENT_REACHED: at a terminal event. EVENT_NOT_LOCATED: an event with
    ``must_be_located`` was not located. RANGE_LEFT: the parameter left its range.
    """

    TERMINAL_EVENT_REACHED = "reached the end"
    EVENT_NOT_LOCATED = "no solution was found at the very end: move the end a little"
    RANGE_LEFT = "it turned back past its start: move the start, or exchange start and end"
    TOO_MANY_POINTS = "the end was not reached within {max_points} points: give a shorter range"
    STEPS_TOO_SHORT = (
        "no further point was found with the shortest step: "
        "lower contact.stiffness, or change reduction.modes"
    )

    def describe(self, max_points: int) -> str:
        """Return the reason in words. ``max_points`` was the allowed number of points."""
        return str(self.value).format(max_points=max_points)


SEGMENT_FIELD_NAMES_NOT_IN_KERNEL = "located_events", "step_control_values"
"""Fields of :class:`ConsecutivePathPoints` that the kernel's struct ``path`` lacks."""


class ConsecutivePathPoints(Sequence[PathPoint]):
    """Consecutive points of a path, stored in arrays for the kernel.

    Access by index creates a :class:`PathPoint`, by slice another segment.

    Attributes
    ----------
    unknowns, unknown_tangents : (n, *shape)
        Unknowns x, and part t_x of the unit tangent (t_x, t_p).
    parameters, parameter_tangents : (n,)
        Parameter p, and part t_p of the tangent.
    unknowns_weights, time_mean_weights : (n,)
        Weights of the norm w |x|^2 + p^2 (:func:`norm_weights_of_unknowns_and_means`).
    chord_lengths : (n,)
        Distance from the previous point, in the previous point's norm.
    iterations : (n,) int
        Newton iterations.
    crosses_branch : (n,) int
        1 if another branch crosses between the previous point and this point.
    located_events : list of (Event, PathPoint)
        Events located between the last two points, each with the located point.
    records : (n, n_record_entries), optional
        Numbers from each point's linearisation, for a step control.
    step_control_values : (n, ...), optional
        Values computed from ``records`` by the system.
    """

    step_control_values: np.ndarray

    def __init__(
        self, start_points: Sequence[PathPoint], capacity: int, n_record_entries: int = 0
    ) -> None:
        unknown_shape = start_points[0].unknown.shape
        if n_record_entries:
            self.records = np.zeros((capacity, n_record_entries))
        self.unknowns, self.unknown_tangents = (
            np.zeros((capacity, *unknown_shape)),
            np.zeros((capacity, *unknown_shape)),
        )
        self.parameters, self.parameter_tangents, self.chord_lengths = np.zeros((3, capacity))
        self.unknowns_weights, self.time_mean_weights = np.zeros((2, capacity))
        self.iterations, self.crosses_branch = (
            np.zeros(capacity, np.intc),
            np.zeros(capacity, np.int8),
        )
        self.located_events: list[tuple[Event, PathPoint]] = []
        for point_index_in_segment, point in enumerate(start_points):
            self.set_point(point_index_in_segment, point)

    def set_point(self, point_index: int, point: PathPoint) -> None:
        """Overwrite the point at an index with another point's data."""
        self.unknowns[point_index], self.unknown_tangents[point_index] = (
            point.unknown,
            point.tangent.x,
        )
        self.parameters[point_index], self.parameter_tangents[point_index] = (
            point.parameter,
            point.tangent.p,
        )
        self.unknowns_weights[point_index], self.time_mean_weights[point_index] = (
            point.tangent.unknowns_weight,
            point.tangent.time_mean_weight,
        )
        self.chord_lengths[point_index] = point.chord_length_from_previous
        if "records" in vars(self) and point.record is not None:
            self.records[point_index] = point.record
        if "step_control_values" in vars(self):
            self.step_control_values[point_index] = point.step_control_values
        self.iterations[point_index], self.crosses_branch[point_index] = (
            point.iterations,
            point.crosses_branch,
        )

    def struct(self, n_known: int, **scalars: float) -> Struct:
        """Return the kernel's struct ``path`` with pointers to the arrays.

        The first ``n_known`` points are known; the kernel fills the others. ``scalars`` are the
        fields ``step``, the length of the first step, and ``orientation``, the sign of t_p det J.
        """
        array_by_name = {
            name: array
            for name, array in vars(self).items()
            if name not in SEGMENT_FIELD_NAMES_NOT_IN_KERNEL
        }
        return Struct("path", capacity=len(self), n_known=n_known, **array_by_name, **scalars)

    def __len__(self) -> int:
        return len(self.parameters)

    def yield_one_point_segments(self) -> Iterator[ConsecutivePathPoints]:
        """Yield each point as a segment of length 1. The last segment keeps the located events."""
        for point_index in range(len(self)):
            segment = self[point_index : point_index + 1]
            segment.located_events = self.located_events if point_index == len(self) - 1 else []
            yield segment

    @overload
    def __getitem__(self, index: int) -> PathPoint: ...
    @overload
    def __getitem__(self, index: slice) -> ConsecutivePathPoints: ...
    def __getitem__(self, index: int | slice) -> PathPoint | ConsecutivePathPoints:
        if isinstance(index, slice):
            segment = object.__new__(ConsecutivePathPoints)
            array_by_name = {
                name: array for name, array in vars(self).items() if name != "located_events"
            }
            vars(segment).update(
                {name: array[index] for name, array in array_by_name.items()}, located_events=[]
            )
            return segment
        norm_weights = float(self.unknowns_weights[index]), float(self.time_mean_weights[index])
        tangent = Tangent(
            self.unknown_tangents[index], float(self.parameter_tangents[index]), *norm_weights
        )
        return PathPoint(
            self.unknowns[index], float(self.parameters[index]), int(self.iterations[index]),
            tangent, bool(self.crosses_branch[index]),
            chord_length_from_previous=float(self.chord_lengths[index]),
            record=self.records[index] if "records" in vars(self) else None,
            step_control_values=(
                self.step_control_values[index] if "step_control_values" in vars(self) else None
            ),
        )  # fmt: skip


# --- events ---------------------------------------------------------------------------------------

StepEnds = tuple[PathPoint, PathPoint]
"""Start and end of a step: two neighbouring points of a path."""


class Event(ABC):
    """Base class for kinds of special points, located between neighbouring points of a path.

    Attributes
    ----------
    is_terminal : bool
        True if the path ends at the event.
    must_be_located : bool
        True if the path goes back and takes a shorter step after a failure to locate the event. A
        long step may have jumped to another part of the path.
    description : str
        For a terminal event, reason for the path's end in words.
    kind : str
        Name of the special point in results; "" if results do not name it.
    """

    is_terminal, must_be_located, description, kind = False, False, "", ""

    @abstractmethod
    def mark_steps_with_event(self, segment: ConsecutivePathPoints) -> np.ndarray:
        """Mark steps between neighbouring points with a possible event: (n-1,) bool.

        ``segment`` has n points. Only for marked steps, :meth:`locate` then searches the event.
        """

    @abstractmethod
    def locate(self, system: System, ends: StepEnds, rtol: float) -> PathPoint | None:
        """Locate the event between two neighbouring points, to |F| / |x| <= ``rtol``.

        ``ends`` has the two points, and F(x, p) = 0 are the equations of ``system``. The result is
        None without an event between the points, or if the search fails.
        """


class BranchPoint(Event):
    """Branch point: another branch of solutions crosses, and t_p det J changes sign.

    t_p is the tangent's parameter part, J the Jacobian dF/dx. The step is bisected down to a length
    of ``MIN_RESOLVED_DISTANCE``, or as far as Newton's method succeeds.
    """

    kind = "branch_point"

    def mark_steps_with_event(self, segment: ConsecutivePathPoints) -> np.ndarray:
        return np.asarray(segment.crosses_branch[1:] > 0)

    def locate(self, system: System, ends: StepEnds, rtol: float) -> PathPoint | None:
        start, end = ends
        step_length_before_crossing, step_length_beyond_crossing = (
            0.0,
            chord_length(system, start, end),
        )
        start_orientation = _sign_of_tangent_part_times_determinant(system, start)
        while step_length_beyond_crossing - step_length_before_crossing > MIN_RESOLVED_DISTANCE:
            middle_length = 0.5 * (step_length_before_crossing + step_length_beyond_crossing)
            point = try_step(system, start, middle_length, rtol)
            if point is None:
                break
            if _sign_of_tangent_part_times_determinant(system, point) == start_orientation:
                step_length_before_crossing = middle_length
            else:
                end, step_length_beyond_crossing = point, middle_length
        return end


def _sign_of_tangent_part_times_determinant(system: System, point: PathPoint) -> float:
    """Return the sign of t_p det J, +1 or -1.

    t_p is the tangent's parameter part, J the Jacobian dF/dx at the point.
    """
    linearisation = point.linearisation or system.linearise(point.unknown, point.parameter)
    return float(linearisation.sign * np.sign(point.tangent.p))


class ZeroCrossing(Event):
    """Event at a sign change of a given function f(point).

    :func:`find_zero_point_and_function_value` locates the zero.
    """

    def __init__(self, function: Callable[[PathPoint], float]) -> None:
        self._function = function

    def mark_steps_with_event(self, segment: ConsecutivePathPoints) -> np.ndarray:
        function_values = np.array([self._function(point) for point in segment])
        return np.asarray(function_values[1:] * function_values[:-1] < 0.0)

    def locate(self, system: System, ends: StepEnds, rtol: float) -> PathPoint | None:
        return find_zero_point_and_function_value(system, ends, self._function, rtol)[0]


def find_zero_point_and_function_value(
    system: System, ends: StepEnds, point_function: Callable[[PathPoint], float], rtol: float
) -> tuple[PathPoint, float]:
    """Find the zero of a function f(point) between two points of a path.

    The Illinois method (a regula falsi) chooses the fraction s along the chord, 0 to 1. With the
    chord (dx, dp) and the tangents t_0 and t_1 at both ends, the guess at s is Hermite's cubic

        x_0 + s^2 (3 - 2 s) dx + s (1 - s) l [(1 - s) t_0 - s t_1],    l = length of the chord,

    likewise for p. Newton's method corrects the guess in the plane orthogonal to the chord, to
    |F| / |x| <= ``rtol``. (SciPy has similar methods, but its import takes longer than many
    curves.)

    Returns
    -------
    point : PathPoint
        Point with the smallest |f| so far: the zero, unless a correction failed.
    residual : float
        Value f(point).

    References
    ----------
    Dowell and Jarratt, BIT 11, 1971, 168.
    """
    start, end = ends
    unknown_change_between_ends, parameter_change_between_ends = (
        end.unknown - start.unknown,
        end.parameter - start.parameter,
    )
    full_chord_length = chord_length(system, start, end) or 1.0
    chord_tangent = replace(
        start.tangent,
        x=unknown_change_between_ends / full_chord_length,
        p=parameter_change_between_ends / full_chord_length,
    )
    points_and_values_by_fraction = {
        fraction: (point, point_function(point))
        for fraction, point in zip((0.0, 1.0), ends, strict=True)
    }

    def function_value_at(fraction: float) -> float:
        """Return f at a fraction along the chord, with the corrected point kept."""
        if fraction not in points_and_values_by_fraction:
            scale = fraction * (1.0 - fraction) * full_chord_length
            tangent_weights = scale * np.array([1.0 - fraction, -fraction])
            chord_weight = fraction * fraction * (3.0 - 2.0 * fraction)
            x = start.unknown + chord_weight * unknown_change_between_ends
            x = x + tangent_weights[0] * start.tangent.x + tangent_weights[1] * end.tangent.x
            p = start.parameter + chord_weight * parameter_change_between_ends
            p += tangent_weights[0] * start.tangent.p + tangent_weights[1] * end.tangent.p
            corrected_point = solve_in_plane(
                system,
                x,
                p,
                chord_tangent,
                tolerance=rtol,
                max_parameter_change=MAX_PARAMETER_CHANGE_IN_STEPS * full_chord_length,
            )
            if corrected_point is None or corrected_point.linearisation is None:
                raise ConvergenceError(
                    "path: no solution was found between two neighbouring points: move the start "
                    "a little, which moves all points"
                )
            linearisation = corrected_point.linearisation
            tangent = tangent_of(system, corrected_point.unknown, linearisation, chord_tangent)
            point = replace(
                corrected_point,
                tangent=tangent,
                step_control_values=step_control_values_or_none(system, linearisation),
            )
            points_and_values_by_fraction[fraction] = point, point_function(point)
        return points_and_values_by_fraction[fraction][1]

    fraction_at_kept_end, last_fraction = 0.0, 1.0
    function_value_at_kept_end = function_value_at(fraction_at_kept_end)
    last_function_value = function_value_at(last_fraction)
    with suppress(ConvergenceError):
        while (
            function_value_at_kept_end * last_function_value < 0.0
            and abs(last_fraction - fraction_at_kept_end) > 1e-12
        ):
            fraction_width = last_fraction - fraction_at_kept_end
            fraction = last_fraction - last_function_value * fraction_width / (
                last_function_value - function_value_at_kept_end
            )
            if fraction in (fraction_at_kept_end, last_fraction):
                break
            new_function_value = function_value_at(fraction)
            if new_function_value * last_function_value < 0.0:
                fraction_at_kept_end, function_value_at_kept_end = (
                    last_fraction,
                    last_function_value,
                )
            else:  # the Illinois method: halve the value at the end that stays
                function_value_at_kept_end *= 0.5
            last_fraction, last_function_value = fraction, new_function_value
    return min(points_and_values_by_fraction.values(), key=lambda entry: abs(entry[1]))


class Fold(ZeroCrossing):
    """Turning point in the parameter, where the tangent's parameter part t_p changes sign."""

    kind = "fold"

    def __init__(self) -> None:
        super().__init__(lambda point: point.tangent.p)

    def mark_steps_with_event(self, segment: ConsecutivePathPoints) -> np.ndarray:
        return np.asarray(segment.parameter_tangents[1:] * segment.parameter_tangents[:-1] < 0.0)

    def locate(self, system: System, ends: StepEnds, rtol: float) -> PathPoint | None:
        point = _find_fold_or_target(system, ends, None, rtol)
        ends_chord_length = chord_length(system, *ends)
        if point is None and ends_chord_length > 4.0 * MIN_RESOLVED_DISTANCE:  # try shorter steps
            short_step_options = PathOptions(
                0.25 * ends_chord_length, 0.25 * ends_chord_length, max_steps=8
            )
            for segment in Path(system, ends[0], short_step_options, [Fold()]):
                if segment.located_events:
                    return segment.located_events[0][1]
        return point or super().locate(system, ends, rtol)


@dataclass(frozen=True)
class Target(Event):
    """Point with a given value of the parameter, the terminal event of a path."""

    parameter: float
    is_terminal, must_be_located, description = True, True, EndReason.TERMINAL_EVENT_REACHED.value

    def mark_steps_with_event(self, segment: ConsecutivePathPoints) -> np.ndarray:
        difference = segment.parameters - self.parameter
        return np.asarray((difference[:-1] != 0.0) & (difference[1:] * difference[:-1] <= 0.0))

    def locate(self, system: System, ends: StepEnds, rtol: float) -> PathPoint | None:
        estimated_point = _find_fold_or_target(system, ends, self.parameter, rtol)
        if estimated_point is None:
            return None
        point = solve_at_parameter(system, estimated_point.unknown, self.parameter, tolerance=rtol)
        return point and replace(point, tangent=estimated_point.tangent)


@dataclass(frozen=True)
class ClosedLoop(Event):
    """Return of a path to the point ``origin``, the terminal event of a closed path.

    The path must pass within 1e-5 of the origin in the tangent's norm, in the same direction
    (cosine at least ``MIN_EQUAL_DIRECTION_COSINE``).
    """

    origin: PathPoint
    system: System
    is_terminal, description = True, "closed loop"

    def mark_steps_with_event(self, segment: ConsecutivePathPoints) -> np.ndarray:
        step_chord_lengths = segment.chord_lengths[1:]
        may_return_in_step = (
            np.abs(segment.parameters[:-1] - self.origin.parameter)
            <= step_chord_lengths / MIN_EQUAL_DIRECTION_COSINE
        )
        for index in np.flatnonzero(may_return_in_step):
            point = segment[int(index)]
            point_tangent, vector_from_point_to_origin = (
                point.tangent,
                self.origin.unknown - point.unknown,
            )
            distance_along_tangent = point_tangent.inner_product(
                self.system, vector_from_point_to_origin, point_tangent.x
            )
            distance_along_tangent += point_tangent.p * (self.origin.parameter - point.parameter)
            may_return_in_step[index] = 0.0 < distance_along_tangent <= step_chord_lengths[index]
        return np.asarray(may_return_in_step)

    def locate(self, system: System, ends: StepEnds, rtol: float) -> PathPoint | None:
        start, origin = ends[0], self.origin
        distance_to_origin = chord_length(system, start, origin)
        vector_from_start_to_origin = origin.unknown - start.unknown
        parameter_change_to_origin = origin.parameter - start.parameter
        to_origin_cosine = replace(
            start.tangent, x=vector_from_start_to_origin, p=parameter_change_to_origin
        ).cosine_to(start.tangent, system)
        if to_origin_cosine < MIN_EQUAL_DIRECTION_COSINE:
            return None
        point = try_step(system, start, to_origin_cosine * distance_to_origin, rtol)
        if (
            point is None
            or point.tangent.cosine_to(origin.tangent, system) < MIN_EQUAL_DIRECTION_COSINE
        ):
            return None
        difference = point.unknown - origin.unknown
        return (
            origin if origin.tangent.inner_product(system, difference, difference) < 1e-10 else None
        )


def _find_fold_or_target(
    system: System, ends: StepEnds, target_parameter: float | None, rtol: float
) -> PathPoint | None:
    """Find a fold or a given parameter between two points; None if the search fails.

    Hermite's cubic for p, through both points and tangents, yields the step along the first
    tangent. Newton's method corrects the guess after the step, and the search goes on between
    closer points.

    Parameters
    ----------
    system : System
        Equations F(x, p) = 0 of the path.
    ends : (PathPoint, PathPoint)
        Neighbouring points on either side of the fold or of the given parameter.
    target_parameter : float or None
        Parameter p to find; None: find the fold.
    rtol : float
        Maximum |F| / |x| of the result.
    """
    system_equations, segment = (
        equations_of(system, ends[0].unknown.shape),
        ConsecutivePathPoints(ends, 3),
    )
    stepping_struct = Struct(
        "stepping",
        min_step=MIN_RESOLVED_DISTANCE,
        correction=correction_struct(rtol, MAX_PARAMETER_CHANGE_IN_STEPS),
    )
    target_parameter_pointer = (
        NULL if target_parameter is None else pointer(np.array([target_parameter]))
    )
    segment_struct = segment.struct(2)
    outcome_code = system_equations.run_unchecked(
        kernel.find_point_between,
        stepping_struct.address,
        target_parameter_pointer,
        segment_struct.address,
    )
    return (
        segment[segment_struct.address.n_known]
        if system_equations.has_found_solution(outcome_code)
        else None
    )


# --- the path -------------------------------------------------------------------------------------


class StepRejectionRule(ABC):
    """Rule to reject steps of a path as too long.

    The rule compares ``step_control_values`` of neighbouring points. The system computes the
    values, for example Floquet multipliers.
    """

    @abstractmethod
    def mark_rejected_steps(
        self, segment: ConsecutivePathPoints, first_index: int = 0
    ) -> np.ndarray:
        """Mark steps as too long by True: (n-1-first_index,) bool.

        ``segment`` has n points, with n-1 steps between them. Steps before the point
        ``first_index`` are not judged, and have no entry in the result.
        """


def step_control_values_or_none(system: System, linearisation: Linearisation) -> np.ndarray | None:
    """Return a point's values for a :class:`StepRejectionRule`, or None.

    None: the system has no values. Otherwise the system computes the values from the
    :attr:`Linearisation.record` of ``linearisation``, the equations linearised at the point.
    """
    values_function_or_none = getattr(system, "step_control_values", None)
    return (
        None
        if values_function_or_none is None
        else np.asarray(values_function_or_none(linearisation.record[None])[0])
    )


class Path:
    """Path of solutions F(x, p) = 0 from a start point.

    Iteration follows the path and yields new points in segments. A path can be iterated only once.
    Each segment (:class:`ConsecutivePathPoints`) ends at an event, or with the last point of a
    kernel call.

    Parameters
    ----------
    system : System
        Equations F(x, p) = 0.
    start : PathPoint
        First point; the tangent sets the direction.
    options : PathOptions
        Step lengths, tolerances and limits.
    events : sequence of Event
        Special points to locate.
    step_control : StepRejectionRule, optional
        Rule to reject long steps. The system must have ``n_record_entries`` and
        ``step_control_values``.

    Attributes
    ----------
    last_point : PathPoint
        The last point so far.
    end_reason : EndReason or None
        None until the path has ended.
    terminal_event : Event or None
        Terminal event at the path's end; None before, or without a terminal event.
    """

    def __init__(
        self, system: System, start: PathPoint, options: PathOptions, events: Sequence[Event] = (),
        step_control: StepRejectionRule | None = None,
    ) -> None:  # fmt: skip
        self._system, self._options, self._events = system, options, events
        self._equations, self._step_control = (
            equations_of(system, start.unknown.shape),
            step_control,
        )
        self._max_step = options.max_step
        max_points_per_call = options.max_path_points_per_call
        self._points_per_call = (
            max_points_per_call
            if step_control is None
            else min(POINTS_PER_CALL_AFTER_HALVING, max_points_per_call)
        )
        self.last_point = start = self._with_record_and_step_control_values(start)
        self.end_reason: EndReason | None = None
        self.terminal_event: Event | None = None
        self._restart(start, options.initial_step)

    def points(self) -> Iterator[PathPoint]:
        """Follow the path and yield the new points in order, without the start."""
        for segment in self:
            yield from segment

    def find_terminal_event_point_or_none(self) -> PathPoint | None:
        """Follow the whole path to the terminal event and return the last point.

        None if the path ended without a terminal event; ``end_reason`` tells why.
        """
        for _ in self:
            pass
        return self.last_point if self.end_reason is EndReason.TERMINAL_EVENT_REACHED else None

    def __iter__(self) -> Iterator[ConsecutivePathPoints]:
        n_remaining_points, retry_step = self._options.max_steps, math.inf
        while self.end_reason is None:
            if not n_remaining_points:
                self.end_reason = EndReason.TOO_MANY_POINTS
                return
            segment = self._follow_in_one_kernel_call(n_remaining_points)
            if segment is None:
                continue
            if len(segment) == 1:
                self.end_reason = EndReason.STEPS_TOO_SHORT
                return
            for segment_part, retry_point_index in self._yield_parts_and_retry_indices(segment):
                n_remaining_points -= len(segment_part)
                if retry_point_index is None:
                    self._start_points[:] = [*self._start_points, *segment_part[-2:]][-2:]
                else:
                    retry_step = 0.25 * min(
                        retry_step, float(segment.chord_lengths[retry_point_index + 1])
                    )
                    if retry_step < self._options.min_step:
                        self.end_reason = EndReason.EVENT_NOT_LOCATED
                    else:
                        self._restart(segment[retry_point_index], retry_step)
                if len(segment_part):
                    self.last_point = segment_part[-1]
                    yield segment_part
                if retry_point_index is not None or self.end_reason is not None:
                    break

    def _yield_parts_and_retry_indices(
        self, segment: ConsecutivePathPoints
    ) -> Iterator[tuple[ConsecutivePathPoints, int | None]]:
        """Split a segment of new points after each point with a located event.

        Yields
        ------
        part : ConsecutivePathPoints
            New points up to the next event. The point of a terminal event replaces the last point.
        retry_index : int or None
            If an event with ``must_be_located`` was not located: index in ``segment`` of the point
            from which to retry with a shorter step. Otherwise None.
        """
        min_allowed_parameter, max_allowed_parameter = self._options.parameter_range
        is_outside = (segment.parameters[1:] < min_allowed_parameter) | (
            segment.parameters[1:] > max_allowed_parameter
        )
        may_occur_by_event_and_step = np.array(
            [event.mark_steps_with_event(segment) for event in self._events], dtype=bool
        )
        may_occur_by_event_and_step = may_occur_by_event_and_step.reshape(
            len(self._events), len(segment) - 1
        )
        part_start_point_index = 1
        for step_index_in_segment in map(
            int, np.flatnonzero(may_occur_by_event_and_step.any(axis=0) | is_outside)
        ):
            step_ends = segment[step_index_in_segment], segment[step_index_in_segment + 1]
            event_location_tolerance = max(
                SPECIAL_POINT_TOLERANCE, self._relative_residual_rounding_at(step_ends[1])
            )
            segment_part = segment[part_start_point_index : step_index_in_segment + 2]
            for event, event_may_occur in zip(
                self._events, may_occur_by_event_and_step[:, step_index_in_segment], strict=True
            ):
                event_point_or_none = (
                    event.locate(self._system, step_ends, event_location_tolerance)
                    if event_may_occur
                    else None
                )
                if event_point_or_none is not None:
                    event_point_or_none = self._with_record_and_step_control_values(
                        event_point_or_none
                    )
                    segment_part.located_events.append((event, event_point_or_none))
                if event_point_or_none is not None and event.is_terminal:
                    if event_point_or_none is step_ends[0]:
                        segment_part = segment[part_start_point_index : step_index_in_segment + 1]
                    else:
                        segment_part.set_point(-1, event_point_or_none)
                    self.end_reason, self.terminal_event = EndReason.TERMINAL_EVENT_REACHED, event
                    yield segment_part, None
                    return
                if event_may_occur and event_point_or_none is None and event.must_be_located:
                    yield (
                        segment[part_start_point_index : step_index_in_segment + 1],
                        step_index_in_segment,
                    )
                    return
            if is_outside[step_index_in_segment]:
                self.end_reason = EndReason.RANGE_LEFT
                yield segment[part_start_point_index : step_index_in_segment + 1], None
                return
            if segment_part.located_events:
                yield segment_part, None
                part_start_point_index = step_index_in_segment + 2
        if part_start_point_index < len(segment):
            yield segment[part_start_point_index:], None

    # --- its steps --------------------------------------------------------------------------------

    def _with_record_and_step_control_values(self, point: PathPoint) -> PathPoint:
        """Return a point with the numbers for the step control.

        The numbers are ``record`` and ``step_control_values`` from the system. Without a step
        control the point is returned unchanged.
        """
        if self._step_control is None or point.step_control_values is not None:
            return point
        linearisation = point.linearisation or self._system.linearise(
            point.unknown, point.parameter
        )
        return replace(
            point,
            record=linearisation.record.ravel(),
            step_control_values=step_control_values_or_none(self._system, linearisation),
        )

    def _relative_residual_rounding_at(self, point: PathPoint) -> float:
        """Return the rounding error of the relative residual |F| / |x| at a point.

        The value comes from the system's ``rounding``, else from the options.
        """
        system_rounding_function = getattr(self._system, "rounding", None)
        return (
            self._options.rounding
            if system_rounding_function is None
            else float(system_rounding_function(point.parameter))
        )

    def _restart(self, point: PathPoint, step_length: float) -> None:
        """Let the next kernel call start at a point, with a first step of the given length.

        The known sign of t_p det J is discarded: t_p is the tangent's parameter part, J = dF/dx.
        """
        self._start_points, self._next_step_length, self._orientation = [point], step_length, 0.0

    def _cut_at_rejected_step(
        self, segment: ConsecutivePathPoints, n_known_points: int, first_step_length: float
    ) -> ConsecutivePathPoints | None:
        """Cut a segment before the step control's first rejected step, and halve the step.

        Without a rejected step, step length and points per kernel call may grow again.

        Parameters
        ----------
        segment : ConsecutivePathPoints
            Points from earlier kernel calls, then the new points.
        n_known_points : int
            Number of points from earlier kernel calls.
        first_step_length : float
            Length requested for the first new step.

        Returns
        -------
        ConsecutivePathPoints or None
            The last earlier point and the accepted new points; None if no new point is accepted.
        """
        assert self._step_control is not None
        new_step_control_values = self._system.step_control_values(segment.records[n_known_points:])  # type: ignore[attr-defined]
        segment.step_control_values = np.concatenate(
            [
                [
                    earlier_path_point.step_control_values
                    for earlier_path_point in self._start_points
                ],
                new_step_control_values,
            ]
        )
        new_step_lengths = segment.chord_lengths[n_known_points:].copy()
        new_step_lengths[0] = min(
            new_step_lengths[0], first_step_length
        )  # a chord across a jump is no step
        can_be_halved = new_step_lengths > 2.0 * self._options.min_step
        rejected_step_indices = np.flatnonzero(
            self._step_control.mark_rejected_steps(segment, n_known_points - 1) & can_be_halved
        )
        if not len(rejected_step_indices):
            self._max_step = min(2.0 * self._max_step, self._options.max_step)
            if self._max_step == self._options.max_step:
                self._points_per_call = min(
                    2 * self._points_per_call, self._options.max_path_points_per_call
                )
            return segment[n_known_points - 1 :]
        last_accepted_index = n_known_points - 1 + int(rejected_step_indices[0])
        if segment.crosses_branch[last_accepted_index + 1 :].sum() % 2:
            self._orientation = -self._orientation
        self._next_step_length = self._max_step = 0.5 * float(
            new_step_lengths[rejected_step_indices[0]]
        )
        self._points_per_call = min(
            POINTS_PER_CALL_AFTER_HALVING, self._options.max_path_points_per_call
        )
        return (
            segment[n_known_points - 1 : last_accepted_index + 1]
            if last_accepted_index >= n_known_points
            else None
        )

    def _follow_in_one_kernel_call(self, n_remaining_points: int) -> ConsecutivePathPoints | None:
        """Add points to the path in a single kernel call.

        Parameters
        ----------
        n_remaining_points : int
            Maximum number of new points.

        Returns
        -------
        ConsecutivePathPoints or None
            The last earlier point and the new points. None: the step control rejects the first
            step, to be repeated with half the length. A segment with the earlier point alone: the
            steps became too short.
        """
        path_options, start_points = self._options, self._start_points
        start_parameter, residual_rounding = (
            start_points[-1].parameter,
            self._relative_residual_rounding_at(start_points[-1]),
        )
        target_parameters = [event.parameter for event in self._events if isinstance(event, Target)]
        parameter_bounds = [*path_options.parameter_range, *target_parameters]
        max_new_points = min(
            n_remaining_points, self._points_per_call if self._equations.follows_many_points else 1
        )
        n_record_entries = (
            0
            if self._step_control is None
            else int(self._equations.function_table.n_record_entries)
        )
        segment = ConsecutivePathPoints(
            start_points, len(start_points) + max_new_points, n_record_entries
        )
        segment_struct = segment.struct(
            len(start_points), step=self._next_step_length, orientation=self._orientation
        )
        stepping_struct = Struct(
            "stepping", max_step=self._max_step, min_step=path_options.min_step,
            min_cosine=path_options.min_cosine, rounding=residual_rounding,
            correction=correction_struct(
                max(path_options.rtol, residual_rounding), MAX_PARAMETER_CHANGE_IN_STEPS
            ),
            min_parameter=max(bound for bound in parameter_bounds if bound <= start_parameter),
            max_parameter=min(bound for bound in parameter_bounds if bound >= start_parameter),
        )  # fmt: skip
        first_step_length = self._next_step_length
        outcome_code = self._equations.run_unchecked(
            kernel.follow_path, stepping_struct.address, segment_struct.address
        )
        self._orientation, self._next_step_length = (
            segment_struct.address.orientation,
            segment_struct.address.step,
        )
        if segment_struct.address.n_known == len(start_points):
            self._equations.has_found_solution(outcome_code)
        if segment_struct.address.n_known == len(start_points) or self._step_control is None:
            return segment[len(start_points) - 1 : segment_struct.address.n_known]
        return self._cut_at_rejected_step(
            segment[: segment_struct.address.n_known], len(start_points), first_step_length
        )
