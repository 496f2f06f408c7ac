"""Where a curve begins: at a special point of another one, or where that has ended.

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

from fenics_crack.balance.problem import Problem
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.curves.family import Family
from fenics_crack.curves.harmonic_curve import HarmonicBifurcation, HarmonicCurve
from fenics_crack.errors import ConvergenceError, InputError
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.equations import DenseLinearisation, System
from fenics_crack.numerics.fourier import resized, stretched
from fenics_crack.numerics.newton import (
    PathPoint,
    Tangent,
    correct,
    distance,
    norm_at,
    point_on_path,
    tangent_of,
)
from fenics_crack.numerics.path import PathOptions

UNFINISHED = "a ResponseCurve that is not complete"


def same_problem(
    curve: HarmonicCurve, structure: Structure, omega: float, contact: ContactLaw
) -> Problem:
    """The problem of a curve to be resumed, with its structure and law given anew."""
    if not isinstance(curve, ResponseCurve):
        raise InputError("resume", type(curve).__name__, UNFINISHED)
    return replace(curve.problem, structure=structure, omega=omega, contact=contact)


def check_resumed(curve: HarmonicCurve, family: Family) -> None:
    """Raise InputError unless a curve is not complete and a family goes on where it ends."""
    if curve.complete:
        raise InputError("resume", type(curve).__name__, UNFINISHED)
    span = family.start, family.end
    pairs = family.problem.structure.n_pairs
    if curve.structure.n_pairs != pairs or curve.parameter != family.name:
        raise InputError("resume", f"curve in {curve.parameter}", "a curve of this problem")
    first, last = float(curve.values[0]), float(curve.values[-1])
    if curve.branch:
        if not min(span) < last < max(span):
            raise InputError("start, end", span, f"on either side of {last:g}")
    elif not math.isclose(span[0], first, rel_tol=1e-9):
        raise InputError("start", span[0], f"where the resumed curve starts, {first:g}")
    unknown, parameter = curve.unknown(-1), family.parameter(last)
    residual = float(np.linalg.norm(family.linearise(unknown, parameter).residual))
    if not residual <= max(1e-6, family.rounding(parameter)) * np.linalg.norm(unknown):
        raise InputError("resume", "a curve of another problem", "of this structure and law")


def directions(family: Family, curve: HarmonicCurve) -> tuple[Tangent | None, PathPoint | None]:
    """Where a curve goes on from its last point, and its first point as :mod:`path` has it.

    The latter only where both have the same harmonics.
    """
    if len(curve) < 2:
        return None, None
    towards, origin = chord(family, curve, -2, -1), None
    if len(curve.unknown(0)) == len(curve.unknown(-1)):
        away = chord(family, curve, 0, 1)
        parameter = family.parameter(float(curve.values[0]))
        origin = point_on_path(family, curve.unknown(0), parameter, away)
    return towards, origin


def chord(family: Family, curve: HarmonicCurve, first: int, second: int) -> Tangent:
    """From one point of a curve to another, with the family's harmonics."""
    count = family.problem.harmonics
    before, after = (resized(curve.unknown(place), count) for place in (first, second))
    rise = family.parameter(float(curve.values[second])) - family.parameter(
        float(curve.values[first])
    )
    return Tangent(after - before, rise, *norm_at(family, after))


def odd_rows(family: Family) -> np.ndarray:
    """Rows of the odd harmonics where the subharmonic is even, else none: (2H+1,) bool.

    They are zero in a response of half the period.
    """
    row = np.arange(2 * family.problem.harmonics + 1)
    even = family.problem.subharmonic % 2 == 0
    return ((row + 1) // 2) % 2 == 1 if even else np.zeros(len(row), dtype=bool)


def first_of_branch(
    family: Family, bifurcation: HarmonicBifurcation, longest_step: float
) -> PathPoint:
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
    if not doubled:
        return across(at, old)
    places = np.flatnonzero(np.repeat(odd_rows(family), unknown.shape[1]))
    found = np.zeros(unknown.size)
    found[places] = scipy.linalg.svd(at.jacobian[np.ix_(places, places)])[2][-1]
    return Tangent(found.reshape(unknown.shape) / math.sqrt(old.weight), 0.0, old.weight)


def across(at: DenseLinearisation, old: Tangent) -> Tangent:
    """Unit direction in the null space of [J, F_p] at a branch point, across the old branch."""
    size = math.sqrt(old.weight)  # the parameter in the units of the unknowns
    derivative = at.by_parameter.reshape(-1, 1)
    null = scipy.linalg.svd(np.hstack([at.jacobian, derivative * size]))[2][-2:]
    mix = null @ np.append(old.x.ravel(), old.p / size)
    vector = mix[1] * null[0] - mix[0] * null[1]
    slope = float(vector[-1]) * size
    length = math.sqrt(old.weight * float(vector[:-1] @ vector[:-1]) + slope**2)
    return Tangent(vector[:-1].reshape(old.x.shape) / length, slope / length, old.weight)
