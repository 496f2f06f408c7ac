"""Pseudo-arc-length continuation of solutions F(x, p) = 0 along a parameter p, through its folds.

With the unit tangent (t_x, t_p) of the path in the norm |x|^2 / |x_0|^2 + p^2, a step of length h

1. predicts   (x, p) + h (t_x, t_p) + the cubic terms that follow from the point before and its
   tangent,
2. corrects by Newton's method in the plane orthogonal to the tangent:

       [ J    F_p ] [dx]     [F]
       [ t_x  t_p ] [dp] = - [0],     by two solutions with J,

3. is lengthened where few iterations were needed, and halved where they failed or where the path
   was left. It is left where the new tangent makes a large angle with the old one. Of the two
   tangents at a point the right one keeps the sign of t_p det J, which changes neither along a path
   nor at its folds, but where another branch crosses.

Source: Keller, in Applications of Bifurcation Theory, 1977; Seydel, Practical Bifurcation and
Stability Analysis, chapter 4.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

__all__ = [
    "ParametricSystem",
    "PathPoint",
    "Tangent",
    "correct",
    "follow_path",
    "land",
    "step_along",
    "tangent_at",
]

MOST_ITERATIONS, MOST_EVALUATIONS = 8, 30
"""Of one corrector."""
BRANCHING_STEP = 1e-3
"""Relative to the longest step: with shorter ones, a sign that changes straight ahead is
believed."""


class ParametricSystem(Protocol):
    """F(x, p) = 0 for unknowns in arrays; the Jacobian is inverted by the system itself."""

    def set_parameter(self, parameter: float) -> None:
        """Set p."""

    def residual(self, unknown: np.ndarray) -> np.ndarray:
        """F(x, p)."""

    def linearise(self, unknown: np.ndarray) -> None:
        """Evaluate J = dF/dx at (x, p)."""

    def solve_jacobian(self, residual: np.ndarray) -> np.ndarray:
        """J^-1 r."""

    def parameter_derivative(self, unknown: np.ndarray) -> np.ndarray:
        """dF/dp at (x, p)."""

    def determinant_sign(self) -> float:
        """Sign of det J where :meth:`solve_jacobian` was called last."""

    def inner(self, first: np.ndarray, second: np.ndarray) -> float:
        """Inner product over all ranks."""


@dataclass(frozen=True)
class PathPoint:
    """A point of the path, the iterations that it took, and the tangent there.

    The sign of ``tangent.p`` says whether the parameter grows along the path; it changes at folds.
    ``crosses_branch`` says that another branch has been crossed since the point before.
    """

    unknown: np.ndarray
    parameter: float
    iterations: int
    tangent: Tangent
    crosses_branch: bool = False


def follow_path(
    system: ParametricSystem,
    start: np.ndarray,
    parameter: float,
    *,
    step: float,
    tolerance: float = 1e-8,
    most_steps: int = 1000,
    longest_step: float = 1.0,
    shortest_step: float = 1e-7,
    least_cosine: float = 0.5,
    rounding: float = 1e-13,
    towards: Tangent | None = None,
) -> Iterator[PathPoint]:
    """Yield points of the path from a solution on, towards growing p first or along ``towards``.

    It ends after ``most_steps`` or where the steps have become too short. Neighbouring tangents
    make an angle whose cosine is at least ``least_cosine``. Residuals relative to the unknowns do
    not fall below ``rounding``.
    """
    system.set_parameter(parameter)
    tangent = tangent_at(system, start)
    here = PathPoint(start, parameter, 0, tangent)
    before: PathPoint | None = None
    orientation = system.determinant_sign()
    if towards is not None and tangent.along(towards, system) < 0.0:
        tangent, orientation = tangent.reversed(), -orientation
        here = PathPoint(start, parameter, 0, tangent)
    for _ in range(most_steps):
        while True:
            # Points must be known better than the steps between them are long.
            sharp = max(rounding, min(tolerance, 1e-4 * step))
            bend = _bend(system, before, here, step)
            found = correct(system, here, tangent, step, sharp, bend)
            if found is not None:
                # The determinant of the bordered matrix keeps its sign along a path: it tells where
                # the path goes on, and the angle tells a step that has left it.
                ahead = tangent_at(system, found.unknown)
                if system.determinant_sign() != orientation:
                    ahead = ahead.reversed()
                cosine = ahead.along(tangent, system)
                if cosine > least_cosine:
                    break
                if cosine < -0.999 and step < BRANCHING_STEP * longest_step:
                    # A short step straight on, but the sign has changed: another branch crosses.
                    ahead, orientation = ahead.reversed(), -orientation
                    found = replace(found, crosses_branch=True)
                    break
            step *= 0.5
            if step < shortest_step:
                turned = _round_corner(system, here, tangent, orientation, longest_step, rounding)
                if turned is None:
                    return
                found, ahead, step = turned
                break
        tangent = ahead
        before, here = here, replace(found, tangent=ahead)
        yield here
        if here.iterations <= 3:
            step = min(longest_step, 1.7 * step)
        elif here.iterations > 5:
            step *= 0.7


@dataclass(frozen=True)
class Tangent:
    """Unit tangent (t_x, t_p) in the norm weight |x|^2 + p^2."""

    x: np.ndarray
    p: float
    weight: float

    def reversed(self) -> Tangent:
        return Tangent(-self.x, -self.p, self.weight)

    def along(self, other: Tangent, system: ParametricSystem) -> float:
        """Cosine of the angle to another tangent, in that one's norm."""
        product = other.weight * system.inner(self.x, other.x) + self.p * other.p
        length = other.weight * system.inner(self.x, self.x) + self.p**2
        # No direction where the Jacobian is singular to rounding: the slope has overflowed.
        return product / float(np.sqrt(length)) if length > 0.0 else 0.0


def tangent_at(system: ParametricSystem, unknown: np.ndarray) -> Tangent:
    """Tangent at a solution, towards growing p."""
    system.linearise(unknown)
    slope = -system.solve_jacobian(system.parameter_derivative(unknown))
    weight = 1.0 / max(system.inner(unknown, unknown), 1e-300)
    length = float(np.sqrt(weight * system.inner(slope, slope) + 1.0))
    return Tangent(slope / length, 1.0 / length, weight)


def _round_corner(
    system: ParametricSystem,
    here: PathPoint,
    tangent: Tangent,
    orientation: float,
    longest_step: float,
    rounding: float,
) -> tuple[PathPoint, Tangent, float] | None:
    """Leave a point where the path turns more sharply than steps can resolve.

    Where stiff contact begins to graze, the Jacobian changes by orders of magnitude over the
    smallest distance. The direction in which the path goes on is that of the Jacobian just behind
    the point.
    """
    for step in longest_step * 10.0 ** np.arange(-7.0, -1.5, 0.5):
        system.set_parameter(here.parameter + step * tangent.p)
        turned = tangent_at(system, here.unknown + step * tangent.x)
        if system.determinant_sign() != orientation:
            turned = turned.reversed()
        found = correct(system, here, turned, step, max(rounding, 1e-4 * step))
        if found is None:
            continue
        ahead = tangent_at(system, found.unknown)
        if system.determinant_sign() != orientation:
            ahead = ahead.reversed()
        if ahead.along(turned, system) > 0.5:
            return found, ahead, step
    return None


def step_along(
    system: ParametricSystem, start: PathPoint, step: float, tolerance: float = 1e-8
) -> PathPoint | None:
    """Point of the path at a distance from another one, along its tangent; None where not found."""
    found = correct(system, start, start.tangent, step, tolerance)
    if found is None:
        return None
    ahead = tangent_at(system, found.unknown)
    if ahead.along(start.tangent, system) < 0.0:
        ahead = ahead.reversed()
    return replace(found, tangent=ahead)


def _bend(
    system: ParametricSystem, before: PathPoint | None, here: PathPoint, step: float
) -> tuple[np.ndarray, float] | None:
    """Quadratic and cubic terms of the prediction, from two points and their tangents.

    Hermite's polynomial in the distance along the last tangent, so that the prediction stays in the
    plane in which it will be corrected. None where it could not help.
    """
    if before is None:
        return None
    tangent = here.tangent
    chord, rise = here.unknown - before.unknown, here.parameter - before.parameter
    back = tangent.weight * system.inner(chord, tangent.x) + rise * tangent.p
    along = before.tangent.along(tangent, system)
    if not (back > 0.0 and along > 0.5):
        return None
    size = np.sqrt(
        tangent.weight * system.inner(before.tangent.x, before.tangent.x) + before.tangent.p**2
    )
    # x(s) = x + s t + s^2 A + s^2 (s + back) B, by divided differences with double nodes.
    both = []
    for moved, last, first in (
        (chord, tangent.x, before.tangent.x),
        (rise, tangent.p, before.tangent.p),
    ):
        mean = moved / back
        second = (last - mean) / back
        third = (second - (mean - first / (size * along)) / back) / back
        both.append(step**2 * (second + (step + back) * third))
    bend, shift = both
    far = tangent.weight * system.inner(bend, bend) + shift**2
    return (bend, shift) if far < 0.1 * step**2 else None


def correct(
    system: ParametricSystem,
    start: PathPoint,
    tangent: Tangent,
    step: float,
    tolerance: float,
    bend: tuple[np.ndarray, float] | None = None,
    reach: float | None = None,
) -> PathPoint | None:
    """Damped Newton's method orthogonal to the tangent; None where it does not converge.

    Parameters
    ----------
    start, tangent, step : PathPoint, Tangent, float
        Where the prediction starts, where to, and how far.
    tolerance : float
        |F| / |x| of the solution.
    bend : array and float, optional
        Added to the prediction.
    reach : float, optional
        How far from the prediction the parameter may go; default: 3 steps.
    """
    unknown = start.unknown + step * tangent.x
    predicted = parameter = start.parameter + step * tangent.p
    if bend is not None:
        unknown, parameter = unknown + bend[0], parameter + bend[1]
    change, shift, damping, before = np.zeros_like(unknown), 0.0, 1.0, np.inf
    linearised = 0
    for _ in range(MOST_EVALUATIONS):
        system.set_parameter(parameter)
        residual = system.residual(unknown)
        size = float(np.sqrt(tangent.weight * system.inner(residual, residual)))
        if size <= tolerance:
            return PathPoint(unknown, parameter, linearised, tangent)
        if not size < before:
            # Where lips begin to touch the Jacobian changes like a square root: shorten the step.
            damping *= 0.5
            if damping < 0.05 or not np.isfinite(size):
                return None
            unknown, parameter = unknown - damping * change, parameter - damping * shift
            continue
        if linearised == MOST_ITERATIONS:
            return None
        system.linearise(unknown)
        free = -system.solve_jacobian(residual)
        slope = -system.solve_jacobian(system.parameter_derivative(unknown))
        along = tangent.weight * system.inner(tangent.x, slope) + tangent.p
        shift = -tangent.weight * system.inner(tangent.x, free) / along if along else np.inf
        if not abs(parameter + shift - predicted) <= (reach or 3.0 * step):
            return None  # another branch, or none
        change, damping, before = free + shift * slope, 1.0, size
        linearised += 1
        unknown, parameter = unknown + change, parameter + shift
    return None


def land(
    system: ParametricSystem,
    before: PathPoint,
    after: PathPoint,
    end: float,
    tolerance: float = 1e-10,
) -> PathPoint | None:
    """The solution at a value of the parameter between two points of the path; None if not found.

    Newton's method from the chord; where the path bends, one of the two points may be nearer.
    """
    share = (end - before.parameter) / (after.parameter - before.parameter)
    between = before.unknown + share * (after.unknown - before.unknown)
    system.set_parameter(end)
    for start in (between, before.unknown, after.unknown):
        unknown = start
        for iterations in range(20):
            residual = system.residual(unknown)
            size = system.inner(unknown, unknown)
            if system.inner(residual, residual) <= tolerance**2 * size:
                return PathPoint(unknown, end, iterations, after.tangent)
            system.linearise(unknown)
            unknown = unknown - system.solve_jacobian(residual)
    return None
