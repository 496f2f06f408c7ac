"""Paths of free motions, and where a backbone starts: from a linear mode, or next to a solution.

A path takes steps in the parameter, which pass over tongues, or by arc-length.

The path from a linear mode in the contact stiffness crosses internal resonances, the more of them
the more harmonics there are, and with stiff contact one of them may end it. Then the path is gone
with fewer harmonics, and the others are added at the whole stiffness: some at a time by Newton's
method, or all that are left together, by a path in the share with which they see the pairs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from fenics_crack.balance.contact_system import SOFT
from fenics_crack.balance.search import halved
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.curves.free_motion import (
    EnergyMotion,
    Equilibrium,
    FadedMotion,
    FreeMotion,
    StiffnessMotion,
)
from fenics_crack.errors import ConvergenceError, InputError
from fenics_crack.numerics.bordered import PathPoint, point_on_path, solve_at
from fenics_crack.numerics.fourier import resized, to_complex
from fenics_crack.numerics.path import NARROW, STRAIGHT, Ended, Path, PathOptions, Target

__all__ = ["ELSEWHERE", "MotionPath", "alike", "first_motion", "solve_motion"]

FAST = 0.5
"""Rate of the parameter along a path at which arc-length is left again."""
MORE = 1.25
"""How many harmonics there are after a step, relative to those before; one more at least."""
ELSEWHERE = "the path ended in the motion of another mode"


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


def first_motion(
    family: EnergyMotion, mode: int, energy: float, initial: PeriodicSolution | None
) -> tuple[PathPoint, str]:
    """Where a backbone starts: next to a solution, or where the linear mode leads; and what is to
    be said about it."""
    note = ""
    if initial is None:
        rest, integrals = family.rest, family.integrals
        stiff = StiffnessMotion(rest, integrals, family.reference, energy)
        try:
            found = _from_linear_mode(stiff, mode)
        except ConvergenceError:
            begun = _from_fewer_harmonics(stiff, mode)
            if begun is None:
                raise
            found, note = begun
    else:
        found = _next_to(family, initial, mode, energy)
    start = replace(found, parameter=math.log(energy), iterations=0, crosses_branch=False, at=None)
    return start, note


def _next_to(
    family: EnergyMotion, initial: PeriodicSolution, mode: int, energy: float
) -> PathPoint:
    """The motion next to a solution, whose mode is made a cosine in the first harmonic."""
    rest, order = family.rest, np.arange(family.harmonics + 1)
    if not isinstance(initial, PeriodicSolution):
        raise InputError("initial", initial, "a PeriodicSolution or None")
    rows, count = initial.displacement_coefficients, len(rest.frequencies)
    if rows.shape[1:] != (count,):
        raise InputError("initial", rows.shape[1:], f"of shape ({count},)")
    modal = to_complex(resized(rows, family.harmonics)) @ np.linalg.inv(rest.modes.shapes).T
    modal[0] -= rest.modal
    phase = np.angle(modal[1, mode - 1]) + (0.0 if _opens(rest, mode) else np.pi)
    z = (modal * np.exp(-1j * phase * order)[:, None]).real * rest.frequencies
    start = math.log(energy)
    guess = np.append(z.ravel() / math.sqrt(2.0 * energy), initial.base_omega / family.reference)
    ratio = 1.0 + float(family.linearise(guess, start).residual[-1])
    if ratio > 0.0:
        guess[:-1] /= math.sqrt(ratio)
        found = solve_motion(family, guess, start)
        if found is not None and alike(found.unknown, guess, 0.7):
            return found
    raise ConvergenceError(f"backbone of mode {mode}: no motion next to the initial solution")


def _opens(rest: Equilibrium, mode: int) -> bool:
    """Whether a mode opens the pairs where it is positive."""
    return bool(rest.modes.pairs[mode - 1].sum() <= 0.0)


def _from_linear_mode(family: StiffnessMotion, mode: int) -> PathPoint:
    """From the linear mode without contact to the whole contact stiffness at one energy."""
    rest, count = family.rest, len(family.rest.frequencies)
    unknown = np.zeros((family.harmonics + 1) * count + 1)
    unknown[count + mode - 1], unknown[-1] = (1.0 if _opens(rest, mode) else -1.0), 1.0
    soft = min(0.0, math.log(SOFT / max(rest.stiffness, SOFT)))
    first = solve_motion(family, unknown, soft)
    if first is None:
        raise ConvergenceError(f"backbone of mode {mode}: no motion with soft contact")
    if soft == 0.0:
        return first
    path = MotionPath(family, first, 0.0, lowest=soft - 5.0, max_step=1.0, max_steps=400)
    furthest = max((motion.parameter for motion in path), default=soft)
    if path.ended is Ended.MET:
        if not family.is_fundamental(path.last.unknown):
            raise ConvergenceError(f"backbone of mode {mode}: {ELSEWHERE}")
        return path.last
    raise ConvergenceError(
        f"backbone of mode {mode}: the path in the contact stiffness came as far as "
        f"{math.exp(furthest):.2g} of it; fewer harmonics have fewer internal resonances, "
        "and a solution given as initial starts elsewhere"
    )


def _from_fewer_harmonics(family: StiffnessMotion, mode: int) -> tuple[PathPoint, str] | None:
    """The motion to which the path with fewer harmonics leads, and with how many; None where none
    of these does."""
    begun: list[tuple[int, np.ndarray]] = []
    for fewer in halved(family.harmonics, 1)[:-1]:
        try:
            begun.append((fewer, _from_linear_mode(family.with_harmonics(fewer), mode).unknown))
        except ConvergenceError:
            continue
    for way in (_some_at_a_time, _all_together):
        for fewer, unknown in begun:
            found = way(family, unknown, fewer)
            if found is not None:
                return found, f", from the linear mode with {fewer} of its harmonics"
    return None


def _some_at_a_time(
    family: StiffnessMotion, unknown: np.ndarray, harmonics: int
) -> PathPoint | None:
    """A motion with all of its harmonics, from one with fewer, by Newton's method; numbers of
    harmonics with which there is none like it are left out."""
    count = harmonics
    while count < family.harmonics:
        count = min(max(count + 1, int(MORE * count)), family.harmonics)
        larger = family.with_harmonics(count)
        guess = _padded(unknown, larger)
        found = solve_motion(larger, guess, 0.0)
        if found is not None and _is_it(larger, found, guess):
            unknown = found.unknown
            if count == family.harmonics:
                return found
    return None


def _all_together(family: StiffnessMotion, unknown: np.ndarray, harmonics: int) -> PathPoint | None:
    """The same along a path in the share with which those that are added see the pairs."""
    faded = FadedMotion(family, harmonics)
    last = solve_motion(faded, _padded(unknown, faded), 0.0)
    if last is None:
        return None
    path = MotionPath(
        faded, last, 1.0, lowest=-0.5, max_step=NARROW.max_step, max_steps=NARROW.max_steps
    )
    landed = path.run()
    seen = landed and solve_motion(family, landed.unknown, 0.0)
    return seen if seen and _is_it(family, seen, seen.unknown) else None


def _padded(unknown: np.ndarray, family: FreeMotion) -> np.ndarray:
    """Unknowns with as many harmonics as a family has."""
    padded = np.zeros(family.scale.size + 1)
    padded[: len(unknown) - 1], padded[-1] = unknown[:-1], unknown[-1]
    return padded


def _is_it(family: FreeMotion, found: PathPoint, guess: np.ndarray) -> bool:
    """Whether a motion is that of a guess, and not another mode's."""
    return family.is_fundamental(found.unknown) and alike(found.unknown, guess, STRAIGHT)
