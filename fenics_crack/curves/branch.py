"""Branches that leave a curve at a bifurcation, and their junction with the curve.

The equations are F(x, p) = 0, with the derivatives J = dF/dx and F_p = dF/dp. At a branch point the
branch's tangent is a null vector of [J, F_p], orthogonal to the parent's tangent. At a period
doubling the branch's tangent is a null vector of J, from the equations with twice the period.

References
----------
Keller, in Applications of Bifurcation Theory, 1977.
Seydel, Practical Bifurcation and Stability Analysis, chapters 4, 5 and 7.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace

import numpy as np
import scipy.linalg

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.curves.balance_equations import BalanceEquations
from fenics_crack.curves.curve import Bifurcation, ResponseCurve
from fenics_crack.curves.curve_system import CurveSystem
from fenics_crack.curves.orbits import OrbitEquations
from fenics_crack.numerics.equations import System
from fenics_crack.numerics.newton import (
    PathPoint,
    Tangent,
    chord_length,
    norm_weights_of_unknowns_and_means,
    predict_and_correct,
    tangent_of,
)
from fenics_crack.numerics.path import (
    MIN_EQUAL_DIRECTION_COSINE,
    MIN_RESOLVED_DISTANCE,
    BranchPoint,
    ConsecutivePathPoints,
    Event,
    Fold,
    PathOptions,
    StepEnds,
)


class ReturnToParent(Event):
    """Event at which a branch with a doubled period joins its parent branch again.

    The motion then repeats itself after half its period. Either the parent branch crosses, or the
    parameter turns back.
    """

    is_terminal, description = True, "joined the branch that it left"

    def __init__(self, system: CurveSystem) -> None:
        self._system, self._crossing_events = system, (Fold(), BranchPoint())

    def mark_steps_with_event(self, segment: ConsecutivePathPoints) -> np.ndarray:
        return np.asarray(
            np.any(
                [
                    crossing_event.mark_steps_with_event(segment)
                    for crossing_event in self._crossing_events
                ],
                axis=0,
            )
        )

    def locate(self, system: System, ends: StepEnds, rtol: float) -> PathPoint | None:
        for crossing_event in self._crossing_events:
            crossing_point = crossing_event.locate(system, ends, rtol)
            if crossing_point is not None:
                motion_repetition_error = self._system.half_period_repetition_error(
                    crossing_point.unknown, crossing_point.parameter
                )
                if motion_repetition_error <= math.sqrt(MIN_RESOLVED_DISTANCE):
                    return crossing_point
        return None


def path_points_with_chord(
    system: BalanceEquations | OrbitEquations,
    curve: ResponseCurve,
    first_index: int,
    last_index: int,
) -> tuple[PathPoint, PathPoint]:
    """Convert two curve points to path points, with the chord between them as tangent.

    ``first_index`` and ``last_index`` are the points' indices on the curve. The path points are
    returned in this order.
    """
    end_values = curve.values[[first_index, last_index]].tolist()
    unscaled_chord_end_solutions = curve.points[[first_index, last_index]]
    chord_start_unknown, chord_end_unknown = map(
        system.unknown, unscaled_chord_end_solutions, end_values
    )
    chord_start_parameter, chord_end_parameter = map(system.parameter, end_values)
    unknown_and_parameter_change = (
        chord_end_unknown - chord_start_unknown,
        chord_end_parameter - chord_start_parameter,
    )
    chord_tangent = Tangent(
        *unknown_and_parameter_change,
        *norm_weights_of_unknowns_and_means(system, chord_end_unknown),
    )
    chord_start_point = PathPoint(chord_start_unknown, chord_start_parameter, 0, chord_tangent)
    return chord_start_point, PathPoint(chord_end_unknown, chord_end_parameter, 0, chord_tangent)


def find_branch_start_point(
    system: BalanceEquations | OrbitEquations,
    bifurcation: Bifurcation,
    longest_step: float,
    parent_curve: ResponseCurve | None = None,
) -> PathPoint:
    """Return the first point of the branch that begins at a bifurcation.

    The point's tangent is the chord from the bifurcation to the point.

    Parameters
    ----------
    system : BalanceEquations or OrbitEquations
        Equations of the branch.
    bifurcation : Bifurcation
        Period doubling or branch point.
    longest_step : float
        Longest step along the branch, in the tangent's norm. The point is searched at a hundredth
        of this distance from the bifurcation up to the whole distance.
    parent_curve : ResponseCurve, optional
        Curve with the bifurcation; its neighbouring points give the curve's tangent there.

    Raises
    ------
    ConvergenceError
        No point of another branch was found.
    """
    bifurcation_kind, [unscaled_bifurcation_solution] = (
        bifurcation.kind,
        bifurcation.single_point_curve.points,
    )
    bifurcation_unknown = system.unknown(unscaled_bifurcation_solution, bifurcation.value)
    bifurcation_parameter = system.parameter(bifurcation.value)
    is_doubling = bifurcation_kind == "period_doubling"
    parent_tangent = None
    if parent_curve is not None:
        nearest_index, last_parent_index = parent_curve.nearest(bifurcation), len(parent_curve) - 1
        neighbour_points = path_points_with_chord(
            system,
            parent_curve,
            max(nearest_index - 1, 0),
            min(nearest_index + 1, last_parent_index),
        )
        parent_tangent = neighbour_points[0].tangent
    branch_tangent = _branch_tangent(
        system, bifurcation_unknown, bifurcation_parameter, is_doubling, parent_tangent
    )
    bifurcation_point = PathPoint(bifurcation_unknown, bifurcation_parameter, 0, branch_tangent)
    residual_tolerance = max(PathOptions.rtol, system.rounding(bifurcation_parameter))
    # Distances from the bifurcation to try, relative to the longest step.
    for step_length in (
        fraction_of_longest_step * longest_step
        for fraction_of_longest_step in (0.1, 0.03, 0.3, 0.01, 1.0)
    ):
        with suppress(ConvergenceError):
            candidate_point = predict_and_correct(
                system,
                bifurcation_point,
                step_length,
                residual_tolerance,
                max_parameter_change=longest_step,
            )
            if (
                candidate_point is None
                or MIN_EQUAL_DIRECTION_COSINE
                * chord_length(system, bifurcation_point, candidate_point)
                > step_length
            ):
                continue
            # On a doubled branch (multiplier -1), half a period changes x by twice the step.
            is_on_new_branch = (
                not is_doubling
                or system.half_period_repetition_error(
                    candidate_point.unknown, candidate_point.parameter
                )
                > step_length
            )
            if is_on_new_branch and 0.0 <= candidate_point.parameter <= 1.0:
                unknown_change = candidate_point.unknown - bifurcation_unknown
                parameter_change = candidate_point.parameter - bifurcation_parameter
                branch_chord_tangent = replace(branch_tangent, x=unknown_change, p=parameter_change)
                return replace(candidate_point, tangent=branch_chord_tangent)
    branch_text = (
        f"branch from {bifurcation_kind} at {system.parameter_name}"
        f" = {system.value(bifurcation_parameter):g}"
    )
    raise ConvergenceError(
        f"{branch_text}: no point of the other branch was found nearby; use a smaller longest_step"
    )


def _branch_tangent(
    system: BalanceEquations | OrbitEquations,
    unknown: np.ndarray,
    parameter: float,
    is_doubling: bool,
    parent_tangent: Tangent | None,
) -> Tangent:
    """Return the unit tangent to the branch at a bifurcation.

    The equations are F(x, p) = 0, with J = dF/dx and F_p = dF/dp at the ``unknown`` x and path
    ``parameter`` p. At a period doubling (``is_doubling``) the tangent lies in the null space of J.
    Otherwise it lies in the null space of [J, F_p], orthogonal to the parent curve's tangent. If
    ``parent_tangent`` is None, the parent's tangent is computed here.
    """
    linearisation = system.linearise(unknown, parameter)
    parent_tangent = parent_tangent or tangent_of(system, unknown, linearisation)
    parameter_scale = math.sqrt(parent_tangent.unknowns_weight)  # gives p the units of x
    if is_doubling:
        tangent_vector = np.append(scipy.linalg.svd(linearisation.jacobian)[2][-1], 0.0)
    else:
        residual_by_parameter = linearisation.by_parameter.reshape(-1, 1)
        null_vectors_with_parameter = scipy.linalg.svd(
            np.hstack([linearisation.jacobian, residual_by_parameter * parameter_scale])
        )[2][-2:]
        parent_components = null_vectors_with_parameter @ np.append(
            parent_tangent.x.ravel(), parent_tangent.p / parameter_scale
        )
        tangent_vector = (
            parent_components[1] * null_vectors_with_parameter[0]
            - parent_components[0] * null_vectors_with_parameter[1]
        )
    parameter_component = float(tangent_vector[-1]) * parameter_scale
    tangent_length = math.sqrt(
        parent_tangent.unknowns_weight * float(tangent_vector[:-1] @ tangent_vector[:-1])
        + parameter_component**2
    )
    return Tangent(
        tangent_vector[:-1].reshape(parent_tangent.x.shape) / tangent_length,
        parameter_component / tangent_length,
        parent_tangent.unknowns_weight,
    )
