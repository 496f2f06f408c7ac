"""Branches that leave a curve at a bifurcation, and their junction with the curve.

The equations are F(x, p) = 0, with the derivatives J = dF/dx and F_p = dF/dp. At a branch point the
new tangent is a null vector of [J, F_p], orthogonal to the old tangent. At a period doubling the
new tangent is a null vector of J, from the equations with twice the period.

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
from fenics_crack.curves.orbits import Orbits
from fenics_crack.numerics.equations import System
from fenics_crack.numerics.newton import (
    PathPoint,
    Tangent,
    chord_length,
    norm_weights_at,
    predict_and_correct,
    tangent_of,
)
from fenics_crack.numerics.path import (
    MIN_EQUAL_DIRECTION_COSINE,
    MIN_RESOLVED_DISTANCE,
    BranchPoint,
    Event,
    Fold,
    PathOptions,
    PathSegment,
    SegmentEnds,
)


class ReturnToParent(Event):
    """Junction of a branch with its parent branch, which has half the period.

    At the junction the parent branch crosses or the parameter turns back, and the motion repeats
    itself after half its period.
    """

    is_terminal, description = True, "joined the branch that it left"

    def __init__(self, system: CurveSystem) -> None:
        self._system, self._crossing_events = system, (Fold(), BranchPoint())

    def detect(self, segment: PathSegment) -> np.ndarray:
        return np.asarray(
            np.any([event.detect(segment) for event in self._crossing_events], axis=0)
        )

    def locate(self, system: System, ends: SegmentEnds, rtol: float) -> PathPoint | None:
        for event in self._crossing_events:
            point = event.locate(system, ends, rtol)
            if point is not None:
                half_period_change = self._system.half_period_change(point.unknown, point.parameter)
                if half_period_change <= math.sqrt(MIN_RESOLVED_DISTANCE):
                    return point
        return None


def chord_ends(
    system: BalanceEquations | Orbits, curve: ResponseCurve, first_index: int, last_index: int
) -> tuple[PathPoint, PathPoint]:
    """Convert two curve points to path points.

    Both have the chord between them as tangent.
    """
    end_values = curve.values[[first_index, last_index]].tolist()
    end_states = curve.points[[first_index, last_index]]
    first_unknown, last_unknown = map(system.unknown, end_states, end_values)
    first_parameter, last_parameter = map(system.parameter, end_values)
    chord_vector = last_unknown - first_unknown, last_parameter - first_parameter
    chord = Tangent(*chord_vector, *norm_weights_at(system, last_unknown))
    first_point = PathPoint(first_unknown, first_parameter, 0, chord)
    return first_point, PathPoint(last_unknown, last_parameter, 0, chord)


def branch_start(
    system: BalanceEquations | Orbits,
    bifurcation: Bifurcation,
    longest_step: float,
    curve: ResponseCurve | None = None,
) -> PathPoint:
    """Return the first point of the branch that begins at a bifurcation.

    The point's tangent is the chord from the bifurcation to the point.

    Parameters
    ----------
    system : BalanceEquations or Orbits
    bifurcation : Bifurcation
    longest_step : float
        Longest step along the branch.
    curve : ResponseCurve, optional
        Parent branch; the points next to the bifurcation give the old tangent.

    Raises
    ------
    ConvergenceError
        No point of another branch was found.
    """
    kind, [state] = bifurcation.kind, bifurcation.point.points
    unknown = system.unknown(state, bifurcation.value)
    parameter, is_doubling = system.parameter(bifurcation.value), kind == "period_doubling"
    old_tangent = None
    if curve is not None:
        nearest_index, last_index = curve.nearest(bifurcation), len(curve) - 1
        neighbours = chord_ends(
            system, curve, max(nearest_index - 1, 0), min(nearest_index + 1, last_index)
        )
        old_tangent = neighbours[0].tangent
    branch_tangent = _branch_tangent(system, unknown, parameter, is_doubling, old_tangent)
    origin = PathPoint(unknown, parameter, 0, branch_tangent)
    tolerance = max(PathOptions.rtol, system.rounding(parameter))
    # Distances from the bifurcation to try, relative to the longest step.
    for step in (fraction * longest_step for fraction in (0.1, 0.03, 0.3, 0.01, 1.0)):
        with suppress(ConvergenceError):
            point = predict_and_correct(
                system, origin, step, tolerance, max_parameter_change=longest_step
            )
            if (
                point is None
                or MIN_EQUAL_DIRECTION_COSINE * chord_length(system, origin, point) > step
            ):
                continue
            # On a doubled branch (multiplier -1), half a period changes x by twice the step.
            is_new = (
                not is_doubling or system.half_period_change(point.unknown, point.parameter) > step
            )
            if is_new and 0.0 <= point.parameter <= 1.0:
                unknown_change = point.unknown - unknown
                parameter_change = point.parameter - parameter
                chord = replace(branch_tangent, x=unknown_change, p=parameter_change)
                return replace(point, tangent=chord)
    branch_words = f"branch from {kind} at {system.name} = {system.value(parameter):g}"
    raise ConvergenceError(f"{branch_words}: no point of another branch was found next to it")


def _branch_tangent(
    system: BalanceEquations | Orbits,
    unknown: np.ndarray,
    parameter: float,
    is_doubling: bool,
    old_tangent: Tangent | None,
) -> Tangent:
    """Return the unit tangent to the branch at a bifurcation.

    With the equations F(x, p) = 0, J = dF/dx and F_p = dF/dp: at a period doubling the tangent lies
    in the null space of J. Otherwise it lies in the null space of [J, F_p], orthogonal to the old
    tangent.
    """
    linearisation = system.linearise(unknown, parameter)
    old_tangent = old_tangent or tangent_of(system, unknown, linearisation)
    parameter_scale = math.sqrt(old_tangent.unknowns_weight)  # gives p the units of x
    if is_doubling:
        tangent_vector = np.append(scipy.linalg.svd(linearisation.jacobian)[2][-1], 0.0)
    else:
        parameter_derivative = linearisation.by_parameter.reshape(-1, 1)
        null_vectors = scipy.linalg.svd(
            np.hstack([linearisation.jacobian, parameter_derivative * parameter_scale])
        )[2][-2:]
        old_components = null_vectors @ np.append(
            old_tangent.x.ravel(), old_tangent.p / parameter_scale
        )
        tangent_vector = old_components[1] * null_vectors[0] - old_components[0] * null_vectors[1]
    parameter_component = float(tangent_vector[-1]) * parameter_scale
    tangent_length = math.sqrt(
        old_tangent.unknowns_weight * float(tangent_vector[:-1] @ tangent_vector[:-1])
        + parameter_component**2
    )
    return Tangent(
        tangent_vector[:-1].reshape(old_tangent.x.shape) / tangent_length,
        parameter_component / tangent_length,
        old_tangent.unknowns_weight,
    )
