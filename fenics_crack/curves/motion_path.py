"""Paths of free motions: steps in the parameter, that pass over tongues, and arc-length."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from fenics_crack.curves.free_motion import FreeMotion
from fenics_crack.numerics.bordered import PathPoint, point_on_path, solve_at
from fenics_crack.numerics.path import Ended, Path, PathOptions, Target

__all__ = ["MotionPath", "alike", "solve_motion"]

FAST = 0.5
"""Rate of the parameter along a path at which arc-length is left again."""


def solve_motion(family: FreeMotion, guess: np.ndarray, parameter: float) -> PathPoint | None:
    """The motion near a guess at a parameter, or None."""
    tolerance = max(1e-12, family.rounding(parameter))
    return solve_at(family, guess, parameter, tolerance=tolerance, iterations=11)


class MotionPath:
    """The motions that follow one, up to that at a parameter: iterate over it once.

    Steps in the parameter itself pass over tongues, unless these are to be followed; where there is
    none to a motion of the same shape, arc-length leads on. ``crosses_branch`` tells where a tongue
    was passed over.

    Attributes
    ----------
    family : FreeMotion
    end : float
        The parameter.
    last : PathPoint
        The last one so far.
    ended : Ended or None
        How it has ended, if it has.
    """

    def __init__(
        self,
        family: FreeMotion,
        start: PathPoint,
        end: float,
        *,
        lowest: float,
        max_step: float,
        max_steps: int,
        pass_over: bool = True,
    ) -> None:
        self.family, self.last, self.end = family, start, end
        self._lowest, self._max_step, self._left = lowest, max_step, max_steps
        self._pass_over = pass_over
        self.ended: Ended | None = None

    def run(self) -> PathPoint | None:
        """The motion at the end; None where the path does not lead there."""
        for _ in self:
            pass
        return self.last if self.ended is Ended.MET else None

    def __iter__(self) -> Iterator[PathPoint]:
        step = 0.2 * self._max_step
        while self.ended is None:
            before = self.last
            ahead = self._step(before, step) if self._pass_over else None
            if ahead is None:
                yield from self._along()
                continue
            self.last, self._left = ahead, self._left - 1
            step = ahead.parameter - before.parameter
            step = min(self._max_step, (1.7 if ahead.iterations <= 4 else 1.0) * step)
            if ahead.parameter == self.end:
                self.ended = Ended.MET
            elif not self._left:
                self.ended = Ended.MANY
            yield ahead

    def _along(self) -> Iterator[PathPoint]:
        """By arc-length, until steps in the parameter may lead on."""
        family, here = self.family, self.last
        options = PathOptions(
            initial_step=0.2 * self._max_step,
            max_step=self._max_step,
            min_step=1e-10,
            max_steps=self._left,
            span=(self._lowest, np.inf),
        )
        start = point_on_path(family, here.unknown, here.parameter)
        path = Path(family, start, options, [Target(self.end)])
        for point in path.points():
            self.last, self._left = point, self._left - 1
            yield point
            outside = point.tangent.p > FAST and point.parameter > here.parameter
            whole = family.is_fundamental(point.unknown)
            if self._pass_over and outside and whole and path.ended is None:
                return
        self.ended = path.ended

    def _step(self, here: PathPoint, step: float) -> PathPoint | None:
        """A motion of the same shape further on, about a step away; None where there is none.

        The sign of det J changes where an odd number of tongues has been passed.
        """
        family, left = self.family, self.end - here.parameter
        at = here.at or family.linearise(here.unknown, here.parameter)
        slope = -at.solve(at.by_parameter)
        near = family.near(here.unknown)
        # What grows on this side of a resonance has the opposite sign on the other one.
        across = np.where(near & (slope * here.unknown > 0.0), -here.unknown, here.unknown)
        slope[near] = 0.0
        steepness = math.sqrt(float(slope @ slope) / float(here.unknown @ here.unknown))
        step = min(step, self._max_step / math.hypot(1.0, steepness), left)
        trials = (
            *((here.unknown, factor, 0.99) for factor in (1.0, 0.5, 0.25)),
            *((across, factor, 0.95) for factor in (0.25, 0.5, 1.0, 2.0, 4.0)),
            *((here.unknown, factor, 0.99) for factor in (0.1, 0.03, 0.01)),
        )
        for base, factor, cosine in trials:
            rise = min(factor * step, left)
            parameter = self.end if rise == left else here.parameter + rise
            guess = base + rise * slope
            found = solve_motion(family, guess, parameter)
            if found is None or not family.is_fundamental(found.unknown):
                continue
            if alike(found.unknown, guess, cosine):
                assert found.at is not None
                return replace(found, crosses_branch=found.at.sign != at.sign)
        return None


def alike(unknown: np.ndarray, other: np.ndarray, cosine: float) -> bool:
    """Whether two motions have the same shape."""
    one, two = unknown[:-1], other[:-1]
    return bool(one @ two > cosine * np.linalg.norm(one) * np.linalg.norm(two))
