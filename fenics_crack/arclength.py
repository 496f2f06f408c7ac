"""Pseudo-arc-length continuation of solutions F(x, p) = 0 along a parameter p, through its folds.

With the unit tangent (t_x, t_p) of the path in the norm |x|^2 / |x_0|^2 + p^2, a step of length h

1. predicts   (x, p) + h (t_x, t_p),
2. corrects by Newton's method in the plane orthogonal to the tangent:

       [ J    F_p ] [dx]     [F]
       [ t_x  t_p ] [dp] = - [0],     by two solutions with J,

3. is lengthened where few iterations were needed, and halved where they failed or where the path
   was left. It is left where the new tangent makes a large angle with the old one. Of the two
   tangents at a point the right one keeps the sign of t_p det J, which changes neither along a path
   nor at its folds.

Source: Keller, in Applications of Bifurcation Theory, 1977; Seydel, Practical Bifurcation and
Stability Analysis, chapter 4.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

__all__ = ["ParametricSystem", "PathPoint", "follow_path"]

LEAST_COSINE = 0.5
"""Of the angle between the tangents of neighbouring points."""


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
    """A point of the path, and the iterations that it took."""

    unknown: np.ndarray
    parameter: float
    iterations: int


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
) -> Iterator[PathPoint]:
    """Yield points of the path from a solution on, towards growing p first.

    It ends after ``most_steps`` or where the steps have become too short.
    """
    here = PathPoint(start, parameter, 0)
    system.set_parameter(parameter)
    tangent = _tangent(system, start)
    orientation = system.determinant_sign()
    for _ in range(most_steps):
        while True:
            found = _correct(system, here, tangent, step, tolerance)
            if found is not None:
                # The determinant of the bordered matrix keeps its sign along a path: it tells where
                # the path goes on, and the angle tells a step that has left it.
                ahead = _tangent(system, found.unknown)
                if system.determinant_sign() != orientation:
                    ahead = ahead.reversed()
                if ahead.along(tangent, system) > LEAST_COSINE:
                    break
            step *= 0.5
            if step < shortest_step:
                return
        here, tangent = found, ahead
        yield here
        if here.iterations <= 3:
            step = min(longest_step, 1.7 * step)
        elif here.iterations > 5:
            step *= 0.7


@dataclass(frozen=True)
class _Tangent:
    """Unit tangent (t_x, t_p) in the norm weight |x|^2 + p^2."""

    x: np.ndarray
    p: float
    weight: float

    def reversed(self) -> _Tangent:
        return _Tangent(-self.x, -self.p, self.weight)

    def along(self, other: _Tangent, system: ParametricSystem) -> float:
        """Cosine of the angle to another tangent, in that one's norm."""
        product = other.weight * system.inner(self.x, other.x) + self.p * other.p
        length = other.weight * system.inner(self.x, self.x) + self.p**2
        return product / float(np.sqrt(length))


def _tangent(system: ParametricSystem, unknown: np.ndarray) -> _Tangent:
    """Tangent towards growing p."""
    system.linearise(unknown)
    slope = -system.solve_jacobian(system.parameter_derivative(unknown))
    weight = 1.0 / max(system.inner(unknown, unknown), 1e-300)
    length = float(np.sqrt(weight * system.inner(slope, slope) + 1.0))
    return _Tangent(slope / length, 1.0 / length, weight)


def _correct(
    system: ParametricSystem, start: PathPoint, tangent: _Tangent, step: float, tolerance: float
) -> PathPoint | None:
    """Newton's method orthogonal to the tangent; None where it does not converge in 8 steps."""
    unknown = start.unknown + step * tangent.x
    predicted = parameter = start.parameter + step * tangent.p
    before = np.inf
    for iterations in range(9):
        system.set_parameter(parameter)
        residual = system.residual(unknown)
        size = float(np.sqrt(tangent.weight * system.inner(residual, residual)))
        if not np.isfinite(size) or size > 10.0 * before:
            return None
        before = min(before, max(size, 1e-3))
        if size <= tolerance:
            return PathPoint(unknown, parameter, iterations)
        system.linearise(unknown)
        change = -system.solve_jacobian(residual)
        slope = -system.solve_jacobian(system.parameter_derivative(unknown))
        along = tangent.weight * system.inner(tangent.x, slope) + tangent.p
        shift = -tangent.weight * system.inner(tangent.x, change) / along if along else np.inf
        if not abs(parameter + shift - predicted) <= 3.0 * step:
            return None  # another branch, or none
        unknown = unknown + change + shift * slope
        parameter += shift
    return None
