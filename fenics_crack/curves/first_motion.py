"""Where a backbone starts: from a linear mode, or next to a solution.

The path from a linear mode in the contact stiffness crosses internal resonances, the more of them
the more harmonics there are, and with stiff contact one of them may end it. Then the path is gone
with fewer harmonics, and the others are added at the whole stiffness: some at a time by Newton's
method, or all that are left together, by a path in the share with which they see the pairs.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fenics_crack.balance.rounding import SOFT
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.curves.free_motion import (
    EnergyMotion,
    Equilibrium,
    FadedMotion,
    FreeMotion,
    StiffnessMotion,
)
from fenics_crack.curves.motion_path import MotionPath, alike, solve_motion
from fenics_crack.errors import ConvergenceError, InputError
from fenics_crack.numerics.bordered import PathPoint
from fenics_crack.numerics.fourier import resized, to_complex
from fenics_crack.numerics.path import Ended

__all__ = ["ELSEWHERE", "first_motion"]

ELSEWHERE = "the path ended in the motion of another mode"
FEWER = (1, 2, 3, 5, 10)
"""Harmonics with which the path in the contact stiffness is tried again."""
MORE = 1.25
"""How many harmonics there are after a step, relative to those before; one more at least."""
LONGEST, MOST = 0.2, 200
"""Longest step in the share with which harmonics see the pairs, and how many."""
SAME = 0.9
"""Cosine of the angle between a motion and the same with more harmonics."""


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
    for fewer in FEWER:
        if fewer >= family.harmonics:
            break
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
    path = MotionPath(faded, last, 1.0, lowest=-0.5, max_step=LONGEST, max_steps=MOST)
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
    return family.is_fundamental(found.unknown) and alike(found.unknown, guess, SAME)
