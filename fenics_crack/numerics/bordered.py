"""Newton's method bordered by a plane: for solutions of F(x, p) = 0 along a path, and at a given p.

A point of a path has a unit tangent (t_x, t_p) in the norm w |x|^2 + p^2, w = 1 / |x_0|^2. In the
plane orthogonal to a tangent Newton's method solves

    [ J    F_p ] [dx]     [F]
    [ t_x  t_p ] [dp] = - [0],     by two solutions with J:

    dx = a + dp b,    J a = -F,    J b = -F_p,    dp = - w <t_x, a> / (w <t_x, b> + t_p),

or by one with the bordered matrix where J is not formed (GMRES needs two iterations more for it).
At a fixed parameter the plane is p = const. (t_x = 0, t_p = 1), one solution is enough, and the
method is Newton's own. Where the residual would grow, as where lips begin to touch and the Jacobian
changes like a square root, the step is shortened.

All paths are followed with this loop: response curves, paths to a cold start, backbones, and
branches of exact orbits; refined curves take its step. Single solutions go through PETSc's SNES
(:mod:`newton`), so that PETSc's options reach them; the first one of a curve goes through this loop
where the kernel has its equations. Curves do not: SNES knows no border, and at
given parameters, where none is needed, an iteration by SNES takes ten times as long as one by the
compiled loop (``benchmarks/curves.py --only newton``, 21 unknowns).

For systems that the kernel has (:mod:`compiled`) it takes the same steps, compiled.

Sources: those of :mod:`path`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
import scipy.optimize

from fenics_crack.errors import ConvergenceError
from fenics_crack.numerics.linearisation import Linearisation, System

__all__ = [
    "MIN_DAMPING",
    "Compiled",
    "PathPoint",
    "Tangent",
    "compiled",
    "correct",
    "distance",
    "find_between",
    "land",
    "locate",
    "solve_at",
    "solve_in_plane",
    "step_along",
    "step_in_plane",
    "tangent_of",
]

MAX_ITERATIONS = 8
"""Of one correction."""
MAX_BETWEEN = 30
"""Points tried between two others."""
MIN_DAMPING = 0.05
"""Of a Newton step."""
NEAR = 1e-8
"""Distance to a point of a path at which it counts as found: where the parameter turns, it is then
known to the square of that."""
REACH = 3.0
"""How far from its prediction the parameter may go, in steps."""


@dataclass(frozen=True)
class Tangent:
    """Unit tangent (t_x, t_p) in the norm weight |x|^2 + p^2."""

    x: np.ndarray
    p: float
    weight: float

    def reversed(self) -> Tangent:
        """The opposite direction."""
        return Tangent(-self.x, -self.p, self.weight)

    def along(self, other: Tangent, system: System) -> float:
        """Cosine of the angle to another tangent, in that one's norm."""
        product = other.weight * system.inner(self.x, other.x) + self.p * other.p
        length = other.weight * system.inner(self.x, self.x) + self.p**2
        # No direction where the Jacobian is singular to rounding: the slope has overflowed.
        return product / float(np.sqrt(length)) if length > 0.0 else 0.0


@dataclass(frozen=True)
class PathPoint:
    """A point of a path, and the iterations that it took."""

    unknown: np.ndarray
    parameter: float
    iterations: int
    tangent: Tangent
    """``tangent.p`` > 0 where the parameter grows along the path; the sign changes at folds."""
    crosses_branch: bool = False
    """Whether another branch has been crossed since the point before."""
    at: Linearisation | None = field(default=None, repr=False, compare=False)
    length: float = float("nan")
    """Of the chord from the point before in that one's norm, where it is known."""


class Compiled(Protocol):
    """What the compiled kernel does along a path."""

    def solve_in_plane(
        self,
        unknown: np.ndarray,
        parameter: float,
        plane: Tangent | None,
        *,
        tolerance: float,
        iterations: int,
        reach: float,
        least_damping: float | None,
        patience: int | None,
    ) -> PathPoint | None:
        """As :func:`solve_in_plane`."""

    def follow(
        self, known: list[PathPoint], orientation: float, step: float, stepping: Any
    ) -> tuple[Sequence[PathPoint], float, float]:
        """Many steps of :func:`fenics_crack.numerics.path.follow_path`."""

    def find_between(
        self, ends: tuple[PathPoint, PathPoint], target: float | None, tolerance: float, near: float
    ) -> PathPoint | None:
        """As :func:`find_between`."""

    def linearise(self, unknown: np.ndarray, parameter: float) -> Linearisation:
        """The equations at a point."""


def compiled(system: System) -> Compiled | None:
    """The same equations in the compiled kernel, None where it does not have them."""
    found: Compiled | None = getattr(system, "compiled", None)
    return found


def tangent_of(system: System, unknown: np.ndarray, at: Linearisation) -> Tangent:
    """Tangent at a solution, towards growing p."""
    slope = -at.solve(at.by_parameter)
    weight = 1.0 / max(system.inner(unknown, unknown), 1e-300)
    length = float(np.sqrt(weight * system.inner(slope, slope) + 1.0))
    return Tangent(slope / length, 1.0 / length, weight)


def solve_in_plane(
    system: System,
    unknown: np.ndarray,
    parameter: float,
    plane: Tangent | None,
    *,
    tolerance: float,
    iterations: int = MAX_ITERATIONS,
    reach: float = np.inf,
    least_damping: float | None = MIN_DAMPING,
    patience: int | None = None,
    history: list[float] | None = None,
) -> PathPoint | None:
    """Newton's method in the plane across a tangent, or at a given parameter; None where it fails.

    ``tolerance`` is |F| / |x| of the solution, |x| that of the tangent's point; ``reach``: how far
    from the guess the parameter may go; ``least_damping``: how much a step may be shortened where
    the residual would grow, None for full steps whatever it does; ``patience``: steps that may
    together fail to halve |F| / |x|; ``history`` gets |F| / |x| of the guess and after each step,
    except the one that meets the tolerance.
    """
    kernel = compiled(system)
    if kernel is not None and history is None:
        return kernel.solve_in_plane(
            unknown, parameter, plane,
            tolerance=tolerance, iterations=iterations, reach=reach, least_damping=least_damping,
            patience=patience,
        )  # fmt: skip
    guess = parameter
    change, shift, damping, before = np.zeros_like(unknown), 0.0, 1.0, np.inf
    linearised, history = 0, [] if history is None else history
    for _ in range(4 * iterations):
        at = system.linearise(unknown, parameter)
        square = system.inner(at.residual, at.residual)
        if plane is None:
            size = float(np.sqrt(square / max(system.inner(unknown, unknown), 1e-300)))
        else:
            size = float(np.sqrt(plane.weight * square))
        if size <= tolerance:
            flat = plane or Tangent(np.zeros_like(unknown), 1.0, 0.0)
            return PathPoint(unknown, parameter, linearised, flat, at=at)
        if not np.isfinite(size):
            return None
        if least_damping is not None and not size < before:
            damping *= 0.5
            if damping < least_damping:
                return None
            unknown, parameter = unknown - damping * change, parameter - damping * shift
            continue
        history.append(size)
        stalls = patience is not None and 0.5 * min(history[:-patience], default=np.inf) < size
        if linearised == iterations or stalls:
            return None
        change, shift = _newton_step(system, at, plane)
        if not abs(parameter + shift - guess) <= reach:
            return None  # another branch, or none
        damping, before = 1.0, size
        linearised += 1
        unknown, parameter = unknown + change, parameter + shift
    return None


def _newton_step(
    system: System, at: Linearisation, plane: Tangent | None
) -> tuple[np.ndarray, float]:
    """Newton's step (dx, dp) in a plane, or at a given parameter."""
    if plane is None:
        return -at.solve(at.residual), 0.0
    change, slope = -at.solve(at.residual), -at.solve(at.by_parameter)
    return step_in_plane(plane, change, slope, system.inner)


def step_in_plane(
    plane: Tangent,
    change: np.ndarray,
    slope: np.ndarray,
    inner: Callable[[np.ndarray, np.ndarray], Any],
) -> tuple[np.ndarray, Any]:
    """Newton's step (dx, dp) from a = -J^-1 F and b = -J^-1 F_p, of many points at once where the
    plane holds arrays and ``inner`` gives one number for each."""
    along = plane.weight * inner(plane.x, slope) + plane.p + 1e-300  # not 0
    shift = -plane.weight * inner(plane.x, change) / along
    return change + shift * slope, shift


def correct(
    system: System,
    start: PathPoint,
    step: float,
    tolerance: float,
    *,
    tangent: Tangent | None = None,
    bend: tuple[np.ndarray, float] | None = None,
    reach: float | None = None,
) -> PathPoint | None:
    """The point of a path at a distance from another one; None where it is not found.

    The prediction goes along ``tangent``, by default the point's own, plus ``bend``, a change of x
    and of p. The parameter may then change by ``reach``, by default 3 steps.
    """
    tangent = tangent or start.tangent
    unknown, parameter = start.unknown + step * tangent.x, start.parameter + step * tangent.p
    if bend is not None:
        unknown, parameter = unknown + bend[0], parameter + bend[1]
    return solve_in_plane(
        system, unknown, parameter, tangent, tolerance=tolerance, reach=reach or REACH * step
    )


def step_along(
    system: System, start: PathPoint, step: float, tolerance: float = 1e-8
) -> PathPoint | None:
    """The same with the tangent there, which keeps its direction."""
    found = correct(system, start, step, tolerance)
    if found is None:
        return None
    assert found.at is not None
    ahead = tangent_of(system, found.unknown, found.at)
    onwards = ahead.along(start.tangent, system) >= 0.0
    return replace(found, tangent=ahead if onwards else ahead.reversed())


def solve_at(
    system: System, unknown: np.ndarray, parameter: float, *, tolerance: float, iterations: int = 20
) -> PathPoint | None:
    """Full Newton steps from a guess at a given parameter; None where they do not converge."""
    return solve_in_plane(
        system, unknown, parameter, None,
        tolerance=tolerance, iterations=iterations, least_damping=None,
    )  # fmt: skip


def land(
    before: PathPoint, after: PathPoint, end: float, solve: Callable[[np.ndarray], PathPoint | None]
) -> PathPoint | None:
    """The solution where the parameter is ``end``, between two points of a path; None if not found.

    ``solve`` finds it from a guess: from the chord, or, where the path bends, from one of the two.
    """
    share = (end - before.parameter) / (after.parameter - before.parameter)
    between = before.unknown + share * (after.unknown - before.unknown)
    for nearby in (between, before.unknown, after.unknown):
        if (found := solve(nearby)) is not None:
            return replace(found, tangent=after.tangent)
    return None


def distance(system: System, before: PathPoint, after: PathPoint) -> float:
    """Length of the chord between two points in the norm of the first one."""
    change = after.unknown - before.unknown
    square = before.tangent.weight * system.inner(change, change)
    return float(np.sqrt(square + (after.parameter - before.parameter) ** 2))


def find_between(
    system: System,
    ends: tuple[PathPoint, PathPoint],
    target: float | None,
    tolerance: float,
    near: float = NEAR,
) -> PathPoint | None:
    """The point between two others of a path where the parameter turns back, or where it is a
    ``target``, to a distance; None where it is not found.

    Where the next point is looked for follows from Hermite's cubic polynomial p(s) through the two
    points that enclose it, with s along the tangent of the first one.
    """
    kernel = compiled(system)
    if kernel is not None:
        return kernel.find_between(ends, target, tolerance, near)
    first, last = ends
    halve = False
    for count in range(MAX_BETWEEN):
        tangent, rise = first.tangent, last.parameter - first.parameter
        length = tangent.weight * system.inner(last.unknown - first.unknown, tangent.x)
        length += rise * tangent.p
        onwards = tangent.weight * system.inner(last.tangent.x, tangent.x)
        onwards += last.tangent.p * tangent.p
        if not (length > 0.0 and onwards > 0.0):
            return None
        begin, end = length * tangent.p, length * last.tangent.p / onwards  # dp / d(s / length)
        third, second = begin + end - 2.0 * rise, 3.0 * rise - 2.0 * begin - end
        if target is None:
            cubic = (0.0, 3.0 * third, 2.0 * second, begin)
        else:
            cubic = (third, second, begin, first.parameter - target)
        share = _root_within(cubic)
        if min(share, 1.0 - share) * length <= near:
            return first if share < 0.5 else last
        share = 0.5 if halve else share
        found = step_along(system, first, share * length, tolerance)
        if found is None:
            return None
        is_before = found.tangent.p * first.tangent.p > 0.0
        if target is not None:
            is_before = (found.parameter - target) * (first.parameter - target) > 0.0
        first, last = (found, last) if is_before else (first, found)
        left = 1.0 - share if is_before else share
        halve = count >= 3 and left > 0.5 and not halve
    return None


def _root_within(cubic: tuple[float, float, float, float]) -> float:
    """A root of a cubic polynomial between 0 and 1; the nearer end where rounding has hidden the
    change of sign."""
    begin, end = _polynomial(0.0, *cubic), _polynomial(1.0, *cubic)
    if begin * end >= 0.0:
        return 0.0 if abs(begin) < abs(end) else 1.0
    return float(scipy.optimize.brentq(_polynomial, 0.0, 1.0, cubic))


def _polynomial(at: float, a: float, b: float, c: float, d: float) -> float:
    return ((a * at + b) * at + c) * at + d


def locate(
    system: System,
    before: PathPoint,
    after: PathPoint,
    test: Callable[[PathPoint], float],
    tolerance: float,
) -> PathPoint:
    """Point between two others of a path where a test function vanishes, by Brent's method; where
    that fails, the point met at which the function is smallest."""
    met: list[tuple[float, PathPoint]] = []

    def value(step: float) -> float:
        point = before if step == 0.0 else step_along(system, before, step, tolerance)
        if point is None:
            raise ConvergenceError("path: lost between two points")
        met.append((test(point), point))
        return met[-1][0]

    length = distance(system, before, after)
    for reach in (1.0, 1.2, 0.8, 1.5):  # along the tangent the other point is not quite as far
        try:
            scipy.optimize.brentq(value, 0.0, reach * length, xtol=1e-12, rtol=1e-12)
            break
        except (ConvergenceError, ValueError):
            continue
    else:
        met.append((test(after), after))
    return min(met, key=lambda found: abs(found[0]))[1]
