"""Where another branch begins at a special point of a curve.

Folds and branch points are found as the curve is followed (:mod:`fenics_crack.numerics.path`); the
latter by the sign of det J, so only where J is formed
(:data:`fenics_crack.balance.contact_system.MATRIX_FREE`). Where multipliers leave the unit circle
is asked when the curve is judged (:func:`judge_curve`).

Sources: Keller, in Applications of Bifurcation Theory, 1977; Seydel, Practical Bifurcation and
Stability Analysis, chapters 4, 5 and 7.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy.linalg

from fenics_crack.balance.family import Family
from fenics_crack.curves.curve import Bifurcation
from fenics_crack.errors import ConvergenceError
from fenics_crack.numerics.bordered import PathPoint, Tangent, correct, distance, tangent_of
from fenics_crack.numerics.fourier import stretched
from fenics_crack.numerics.linearisation import System
from fenics_crack.numerics.path import PathOptions

__all__ = ["first_aside", "first_of_branch", "odd_rows"]


def odd_rows(family: Family) -> np.ndarray:
    """Rows of the odd harmonics where the subharmonic is even, else none: (2H+1,) bool.

    They are zero in a response of half the period.
    """
    row = np.arange(2 * family.problem.harmonics + 1)
    even = family.problem.subharmonic % 2 == 0
    return ((row + 1) // 2) % 2 == 1 if even else np.zeros(len(row), dtype=bool)


def first_of_branch(family: Family, bifurcation: Bifurcation, longest_step: float) -> PathPoint:
    """The first point on the branch that begins at a bifurcation; its tangent is the way to it.

    The new direction is the null vector of the Jacobian [J, F_p] across the old branch; for a
    period doubling it lies in the odd harmonics of twice the period.

    Raises
    ------
    ConvergenceError
        No point of another branch was found.
    """
    factor = family.problem.harmonics // (len(bifurcation.unknown) // 2)
    unknown = stretched(bifurcation.unknown, factor)
    parameter = family.parameter(bifurcation.value)
    away = _across(family, unknown, parameter, doubled=factor > 1)
    start = PathPoint(unknown, parameter, 0, away)
    sharp = max(PathOptions.rtol, family.rounding(parameter))

    def near(found: PathPoint, step: float) -> bool:
        return distance(family, start, found) < 3.0 * step

    found = first_aside(family, start, longest_step, sharp, near)
    if found is not None:
        change, rise = found.unknown - unknown, found.parameter - parameter
        return replace(found, tangent=Tangent(change, rise, away.weight))
    raise ConvergenceError(
        f"branch from {bifurcation.kind} at {family.name} = {bifurcation.value:g}: "
        "no point of another branch was found next to it"
    )


def first_aside(
    system: System,
    start: PathPoint,
    longest_step: float,
    tolerance: float,
    is_new: Callable[[PathPoint, float], bool],
) -> PathPoint | None:
    """The first solution found across a branch, at a step from one of it along that one's tangent,
    that is on a new branch; None where there is none within the longest step."""
    for share in (0.1, 0.03, 0.3, 0.01, 1.0):
        step = share * longest_step
        found = correct(system, start, step, tolerance, reach=longest_step)
        if found is not None and is_new(found, step):
            return found
    return None


def _across(family: Family, unknown: np.ndarray, parameter: float, doubled: bool) -> Tangent:
    """Unit direction in the null space of [J, F_p], across the old branch."""
    at = family.linearise(unknown, parameter)
    old = tangent_of(family, unknown, at)
    if doubled:
        places = np.flatnonzero(np.repeat(odd_rows(family), unknown.shape[1]))
        across = np.zeros(unknown.size)
        across[places] = scipy.linalg.svd(at.jacobian[np.ix_(places, places)])[2][-1]
        slope = 0.0
    else:
        size = math.sqrt(old.weight)  # the parameter in the units of the gap
        derivative = at.by_parameter.reshape(-1, 1)
        null = scipy.linalg.svd(np.hstack([at.jacobian, derivative * size]))[2][-2:]
        mix = null @ np.append(old.x.ravel(), old.p / size)
        vector = mix[1] * null[0] - mix[0] * null[1]
        across, slope = vector[:-1], float(vector[-1]) * size
    away = Tangent(across.reshape(unknown.shape), slope, old.weight)
    length = math.sqrt(away.weight * family.inner(away.x, away.x) + away.p**2)
    return replace(away, x=away.x / length, p=away.p / length)
