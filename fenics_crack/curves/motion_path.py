"""Paths of free motions: steps in the parameter, that pass over tongues, and arc-length."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from fenics_crack.curves.free_motion import FreeMotion
from fenics_crack.numerics.bordered import PathPoint, land, solve_at
from fenics_crack.numerics.path import Stepping, follow_path

__all__ = ["alike", "follow_motions", "land_motion", "solve_motion"]

FAST = 0.5
"""Rate of the parameter along a path at which arc-length is left again."""


def solve_motion(family: FreeMotion, guess: np.ndarray, parameter: float) -> PathPoint | None:
    """The motion near a guess at a parameter, or None."""
    tolerance = max(1e-12, family.rounding)
    return solve_at(family, guess, parameter, tolerance=tolerance, iterations=11)


def follow_motions(
    family: FreeMotion, here: PathPoint, longest_step: float, most_steps: int, pass_over: bool
) -> Iterator[PathPoint]:
    """Yield the points that follow a solution; ``crosses_branch`` where a tongue was passed over.

    Steps in the parameter itself pass over tongues; where there is none to a motion of the same
    shape, arc-length leads on.
    """
    count, step = 0, 0.2 * longest_step
    while count < most_steps:
        ahead = _step(family, here, step, longest_step) if pass_over else None
        if ahead is not None:
            count += 1
            step = ahead.parameter - here.parameter
            step = min(longest_step, (1.7 if ahead.iterations <= 4 else 1.0) * step)
            here = ahead
            yield here
            continue
        stepping = Stepping(
            first=0.2 * longest_step,
            longest=longest_step,
            shortest=1e-10,
            most=most_steps - count,
            tolerance=1e-10,
            least_cosine=0.85,
            rounding=family.rounding,
        )
        for point in follow_path(family, here.unknown, here.parameter, stepping):
            count += 1
            yield point
            outside = point.tangent.p > FAST and point.parameter > here.parameter
            whole = family.fundamental(point.unknown) > family.least_fundamental
            if pass_over and outside and whole:
                here = point
                break
        else:
            return


def _step(
    family: FreeMotion, here: PathPoint, step: float, longest_step: float
) -> PathPoint | None:
    """A motion of the same shape further on, about a step away; None where there is none.

    The sign of det J changes where an odd number of tongues has been passed.
    """
    at = here.at or family.linearise(here.unknown, here.parameter)
    slope = -at.solve(at.by_parameter)
    near = family.near(here.unknown)
    # What grows on this side of a resonance has the opposite sign on the other one.
    across = np.where(near & (slope * here.unknown > 0.0), -here.unknown, here.unknown)
    slope[near] = 0.0
    steepness = math.sqrt(float(slope @ slope) / float(here.unknown @ here.unknown))
    step = min(step, longest_step / math.hypot(1.0, steepness))
    trials = (
        *((here.unknown, factor, 0.99) for factor in (1.0, 0.5, 0.25)),
        *((across, factor, 0.95) for factor in (0.25, 0.5, 1.0, 2.0, 4.0)),
        *((here.unknown, factor, 0.99) for factor in (0.1, 0.03, 0.01)),
    )
    for base, factor, cosine in trials:
        guess = base + factor * step * slope
        found = solve_motion(family, guess, here.parameter + factor * step)
        if found is None or family.fundamental(found.unknown) < family.least_fundamental:
            continue
        if alike(found.unknown, guess, cosine):
            assert found.at is not None
            return replace(found, crosses_branch=found.at.sign != at.sign)
    return None


def alike(unknown: np.ndarray, other: np.ndarray, cosine: float) -> bool:
    """Whether two motions have the same shape."""
    one, two = unknown[:-1], other[:-1]
    return bool(one @ two > cosine * np.linalg.norm(one) * np.linalg.norm(two))


def land_motion(
    family: FreeMotion, before: PathPoint, after: PathPoint, end: float
) -> PathPoint | None:
    """The motion at a parameter between those of two others; None if not found."""

    def of_that_shape(nearby: np.ndarray) -> PathPoint | None:
        found = solve_motion(family, nearby, end)
        return found if found and alike(found.unknown, nearby, 0.9) else None

    landed = land(before, after, end, of_that_shape)
    return landed and replace(
        landed, iterations=after.iterations, crosses_branch=after.crosses_branch, at=None
    )
