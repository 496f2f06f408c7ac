"""Pseudo-arc-length continuation of solutions F(x, p) = 0 along a parameter p, through its folds.

A step of length h

1. predicts   (x, p) + h (t_x, t_p) + the cubic terms that follow from the point before and its
   tangent,
2. corrects by Newton's method in the plane orthogonal to the tangent (:mod:`bordered`),
3. is lengthened where few iterations were needed, and halved where they failed or where the path
   was left, which a large angle between the new tangent and the old one shows. Of the two tangents
   at a point the right one keeps the sign of t_p det J, which changes only where another branch
   crosses. Where J is not formed its determinant is unknown: the tangent is taken that goes on at
   the smaller angle, the chord must agree with both tangents, lest a step across a narrow turn
   leads back, and branches that cross go unnoticed. There a system may judge angles by an inner
   product of its own (``turning``).

Source: Keller, in Applications of Bifurcation Theory, 1977; Seydel, Practical Bifurcation and
Stability Analysis, chapter 4.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fenics_crack.numerics.bordered import (
    PathPoint,
    Tangent,
    compiled,
    correct,
    distance,
    tangent_of,
)
from fenics_crack.numerics.linearisation import Linearisation, System

__all__ = ["Stepping", "follow_path", "follow_stretches"]

BRANCHING_STEP = 1e-3
"""Share of the longest step below which a change of sign straight ahead means a branch crosses."""

BACK = 0.9
"""Cosine of an angle above which the opposite direction leads back."""


@dataclass(frozen=True)
class Stepping:
    """How a path is stepped along, with steps measured in the norm of the tangent."""

    first: float
    longest: float = 1.0
    shortest: float = 1e-7
    """The path ends where steps would be shorter."""
    most: int = 1000
    """Number of steps."""
    tolerance: float = 1e-8
    """|F| / |x| of the points; where steps are short, they are solved for more sharply."""
    least_cosine: float = 0.5
    """Of the angle between neighbouring tangents."""
    rounding: float = 1e-13
    """Below which |F| / |x| does not fall."""
    chunk: int = 16
    """Points that the compiled kernel follows in one call at most."""
    span: tuple[float, float] = (0.0, 1.0)
    """Of the parameter: where it is left, such a call ends."""

    def sharp(self, step: float) -> float:
        """Tolerance of a step: points must be known better than the steps between them are long."""
        return max(self.rounding, min(self.tolerance, 1e-4 * step))


def follow_path(
    system: System,
    start: np.ndarray,
    parameter: float,
    stepping: Stepping,
    towards: Tangent | None = None,
) -> Iterator[PathPoint]:
    """Yield points of the path from a solution on, towards growing p first or along ``towards``."""
    for found in follow_stretches(system, start, parameter, stepping, towards):
        yield from found


def follow_stretches(
    system: System,
    start: np.ndarray,
    parameter: float,
    stepping: Stepping,
    towards: Tangent | None = None,
) -> Iterator[Sequence[PathPoint]]:
    """The same, as many points at once as come together."""
    kernel = compiled(system)
    at = (kernel or system).linearise(start, parameter)
    tangent, orientation = tangent_of(system, start, at), at.sign
    if towards is not None and tangent.along(towards, system) < 0.0:
        tangent, orientation = tangent.reversed(), -orientation
    known = [PathPoint(start, parameter, 0, tangent)]
    step, taken = stepping.first, 0
    found: Sequence[PathPoint]
    while taken < stepping.most:
        if kernel is None:
            found, orientation, step = _advance(system, known, orientation, step, stepping)
        else:
            found, orientation, step = kernel.follow(known, orientation, step, stepping)
        if not found:
            turned = _round_corner(system, known[-1], orientation, stepping)
            if turned is None:
                return
            found, step = [turned[0]], _next_step(turned[0], turned[1], stepping)
        found = found[: stepping.most - taken]
        taken += len(found)
        known = [*known, *found[-2:]][-2:]
        yield found


def _advance(
    system: System, known: list[PathPoint], orientation: float, step: float, stepping: Stepping
) -> tuple[list[PathPoint], float, float]:
    """The next point behind the last one or two, or none where steps would be too short; the sign
    of the determinant along the path, and the next step."""
    here = known[-1]
    while True:
        bend = _bend(system, known, step)
        found = correct(system, here, step, stepping.sharp(step), bend=bend)
        if found is not None:
            # The determinant of the bordered matrix keeps its sign along a path: it tells where
            # the path goes on, and the angle whether the step has left it.
            ahead = _oriented(system, found.unknown, found.at, orientation, here.tangent)
            cosine = _cosine(ahead, here.tangent, system)
            sure = not np.isnan(orientation)
            if cosine > stepping.least_cosine and (
                sure or _straight(system, here, found, ahead, stepping.least_cosine)
            ):
                break
            if cosine < -0.999 and step < BRANCHING_STEP * stepping.longest:
                # A short step straight on, but the sign has changed: another branch crosses.
                ahead, orientation = ahead.reversed(), -orientation
                found = replace(found, crosses_branch=True)
                break
        step *= 0.5
        if step < stepping.shortest:
            return [], orientation, step
    found = replace(found, tangent=ahead, length=distance(system, here, found))
    return [found], orientation, _next_step(found, step, stepping)


def _next_step(point: PathPoint, step: float, stepping: Stepping) -> float:
    """Longer where few iterations were needed, shorter where many were."""
    if point.iterations <= 3:
        return min(stepping.longest, 1.7 * step)
    return 0.7 * step if point.iterations > 5 else step


def _oriented(
    system: System,
    unknown: np.ndarray,
    at: Linearisation | None,
    orientation: float,
    before: Tangent,
) -> Tangent:
    """The tangent at a point along which the path goes on, behind one with another tangent."""
    assert at is not None
    tangent, sign = tangent_of(system, unknown, at), at.sign
    if np.isnan(sign):  # unknown: not back again
        onwards = _cosine(tangent, before, system) >= 0.0
    else:
        onwards = sign == orientation
    return tangent if onwards else tangent.reversed()


def _straight(
    system: System, here: PathPoint, found: PathPoint, ahead: Tangent, least_cosine: float
) -> bool:
    """Whether the chord between two points agrees with the tangents at both."""
    change, rise = found.unknown - here.unknown, found.parameter - here.parameter
    chord = Tangent(change, rise, here.tangent.weight)
    return all(_cosine(chord, way, system) > least_cosine for way in (here.tangent, ahead))


def _cosine(first: Tangent, second: Tangent, system: System) -> float:
    """Of the angle between two directions, by the inner product by which a system judges turns: its
    own, or its ``turning``."""
    inner = getattr(system, "turning", system.inner)

    def product(one: Tangent, other: Tangent) -> float:
        return float(second.weight * inner(one.x, other.x) + one.p * other.p)

    sizes = product(first, first) * product(second, second)
    return product(first, second) / math.sqrt(sizes) if sizes > 0.0 else 0.0


def _round_corner(
    system: System, here: PathPoint, orientation: float, stepping: Stepping
) -> tuple[PathPoint, float] | None:
    """Leave a point where the path turns more sharply than steps can resolve.

    Where stiff contact begins to graze, the Jacobian changes by orders of magnitude over the
    smallest distance. The direction in which the path goes on is that of the Jacobian just behind
    the point; where the sign of its determinant is unknown, that or its opposite, unless this leads
    straight back.
    """
    steps = stepping.longest * 10.0 ** np.arange(-7.0, -1.5, 0.5)
    for step in steps[steps >= stepping.shortest]:
        behind = here.unknown + step * here.tangent.x
        at = system.linearise(behind, here.parameter + step * here.tangent.p)
        turned = _oriented(system, behind, at, orientation, here.tangent)
        ways = [turned]
        if np.isnan(orientation) and _cosine(turned, here.tangent, system) < BACK:
            ways.append(turned.reversed())
        sharp = max(stepping.rounding, 1e-4 * step)
        for way in ways:
            found = correct(system, here, step, sharp, tangent=way)
            if found is not None:
                ahead = _oriented(system, found.unknown, found.at, orientation, way)
                if _cosine(ahead, way, system) > 0.5:
                    length = distance(system, here, found)
                    return replace(found, tangent=ahead, length=length), step
    return None


def _bend(system: System, known: list[PathPoint], step: float) -> tuple[np.ndarray, float] | None:
    """Quadratic and cubic terms of the prediction, from two points and their tangents; None where
    these could not help.

    It is Hermite's polynomial in the distance along the last tangent, so that the prediction stays
    in the plane in which it will be corrected.
    """
    if len(known) == 1:
        return None
    before, here = known
    tangent, old = here.tangent, before.tangent
    chord, rise = here.unknown - before.unknown, here.parameter - before.parameter
    back = tangent.weight * system.inner(chord, tangent.x) + rise * tangent.p
    along = old.along(tangent, system)
    if not (back > 0.0 and along > 0.5):
        return None
    size = np.sqrt(tangent.weight * system.inner(old.x, old.x) + old.p**2)
    # x(s) = x + s t + s^2 A + s^2 (s + back) B, by divided differences with double nodes.
    both = []
    for moved, last, first in ((chord, tangent.x, old.x), (rise, tangent.p, old.p)):
        mean = moved / back
        second = (last - mean) / back
        third = (second - (mean - first / (size * along)) / back) / back
        both.append(step**2 * (second + (step + back) * third))
    bend, shift = both
    far = tangent.weight * system.inner(bend, bend) + shift**2
    return (bend, shift) if far < 0.1 * step**2 else None
