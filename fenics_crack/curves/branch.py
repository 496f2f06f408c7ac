"""Branches that leave another curve at a bifurcation: where they begin, and where they come back.

They are entered along the null vector of [J, F_p] across the old one; at a period doubling along
that of J of the equations of twice the period.

Source: Keller, in Applications of Bifurcation Theory, 1977; Seydel, Practical Bifurcation and
Stability Analysis, chapters 4, 5 and 7.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace

import numpy as np
import scipy.linalg

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.curves.curve import Bifurcation, ResponseCurve
from fenics_crack.curves.curve_system import CurveSystem
from fenics_crack.curves.orbits import Orbits
from fenics_crack.curves.waves import Waves
from fenics_crack.numerics.equations import System
from fenics_crack.numerics.newton import (
    PathPoint,
    Tangent,
    chord_length,
    norm_at,
    predict_and_correct,
    tangent_of,
)
from fenics_crack.numerics.path import (
    ARRIVAL_DISTANCE,
    MIN_DIRECTION_COSINE,
    BranchPoint,
    Event,
    Fold,
    PathOptions,
    PathSegment,
    SegmentEnds,
)


class Joined(Event):
    """Junction of a branch of twice the period with the one that it left: that crosses, the
    parameter turns back, and the motion repeats itself after half its period."""

    is_terminal, description = True, "joined the branch that it left"

    def __init__(self, system: CurveSystem) -> None:
        self._system, self._signs = system, (Fold(), BranchPoint())

    def detect(self, points: PathSegment) -> np.ndarray:
        return np.asarray(np.any([one.detect(points) for one in self._signs], axis=0))

    def locate(self, system: System, ends: SegmentEnds, rtol: float) -> PathPoint | None:
        for one in self._signs:
            found = one.locate(system, ends, rtol)
            if found is not None:
                off = self._system.half_off(found.unknown, found.parameter)
                if off <= math.sqrt(ARRIVAL_DISTANCE):
                    return found
        return None


def neighbours(
    system: Waves | Orbits, curve: ResponseCurve, first: int, last: int
) -> tuple[PathPoint, PathPoint]:
    """Return two points of a curve, with the chord from one to the other for a tangent."""
    values, points = curve.values[[first, last]].tolist(), curve.points[[first, last]]
    before, after = map(system.unknown, points, values)
    parameter, parameter_after = map(system.parameter, values)
    chord = Tangent(after - before, parameter_after - parameter, *norm_at(system, after))
    return PathPoint(before, parameter, 0, chord), PathPoint(after, parameter_after, 0, chord)


def branch_start(
    system: Waves | Orbits,
    bifurcation: Bifurcation,
    longest_step: float,
    curve: ResponseCurve | None = None,
) -> PathPoint:
    """The first point on the branch that begins at a bifurcation; its tangent is the way to it.

    Where the old branch is known it goes on as its points on both sides do.

    Raises
    ------
    ConvergenceError
        No point of another branch was found.
    """
    kind, [state] = bifurcation.kind, bifurcation.point.points
    unknown = system.unknown(state, bifurcation.value)
    parameter, doubled = system.parameter(bifurcation.value), kind == "period_doubling"
    old = None
    if curve is not None:
        place, last = curve.nearest(bifurcation), len(curve) - 1
        around = neighbours(system, curve, max(place - 1, 0), min(place + 1, last))
        old = around[0].tangent
    away = _away(system, unknown, parameter, doubled, old)
    start = PathPoint(unknown, parameter, 0, away)
    sharp = max(PathOptions.rtol, system.rounding(parameter))
    # Distances from the bifurcation, in longest steps, tried in turn.
    for step in (share * longest_step for share in (0.1, 0.03, 0.3, 0.01, 1.0)):
        with suppress(ConvergenceError):
            found = predict_and_correct(system, start, step, sharp, reach=longest_step)
            if found is None or MIN_DIRECTION_COSINE * chord_length(system, start, found) > step:
                continue
            # Of the way by +1 and by -1 half a period changes twice the step.
            new = not doubled or system.half_off(found.unknown, found.parameter) > step
            if new and 0.0 <= found.parameter <= 1.0:
                change, rise = found.unknown - unknown, found.parameter - parameter
                return replace(found, tangent=replace(away, x=change, p=rise))
    branch = f"branch from {kind} at {system.name} = {system.value(parameter):g}"
    raise ConvergenceError(f"{branch}: no point of another branch was found next to it")


def _away(
    system: Waves | Orbits,
    unknown: np.ndarray,
    parameter: float,
    doubled: bool,
    old: Tangent | None,
) -> Tangent:
    """Unit direction of the branch at a bifurcation: at a period doubling in the null space of J of
    the equations of twice the period, else in that of [J, F_p], across the old branch."""
    at = system.linearise(unknown, parameter)
    old = old or tangent_of(system, unknown, at)
    size = math.sqrt(old.weight)  # the parameter in the units of the unknowns
    if doubled:
        vector = np.append(scipy.linalg.svd(at.jacobian)[2][-1], 0.0)
    else:
        derivative = at.by_parameter.reshape(-1, 1)
        null = scipy.linalg.svd(np.hstack([at.jacobian, derivative * size]))[2][-2:]
        mix = null @ np.append(old.x.ravel(), old.p / size)
        vector = mix[1] * null[0] - mix[0] * null[1]
    slope = float(vector[-1]) * size
    length = math.sqrt(old.weight * float(vector[:-1] @ vector[:-1]) + slope**2)
    return Tangent(vector[:-1].reshape(old.x.shape) / length, slope / length, old.weight)
