"""Branches of twice the period by way of exact orbits, where harmonic balance does not lead there.

The equations of harmonic balance have their own period doubling, where the block of the odd
harmonics is singular. With stiff contact it lies elsewhere than that of the motion, or nowhere: few
harmonics do not tell the two halves of the doubled period apart. The exact orbits do. At their
doubling M v = -v, and with twice the period,

    F_2(x, p) = z(2 T; x, p) / |z_0| - x = 0,

a second branch leaves in the direction (v, 0). It is followed by arc-length, and at its points the
Fourier coefficients of the orbits are where Newton's method begins: with as many harmonics as were
asked for, then with twice as many, and so on. What is found is a start if it is nearer to the orbit
than half of what tells this from the old branch, the odd harmonics.

Source: Seydel, Practical Bifurcation and Stability Analysis, chapters 5 and 7.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from fenics_crack.balance.problem import Problem
from fenics_crack.curves.beginnings import first_aside, odd_rows
from fenics_crack.curves.curve import Bifurcation, ResponseCurve
from fenics_crack.curves.family import FrequencyFamily
from fenics_crack.curves.orbit_branch import ALIKE, TOLERANCE
from fenics_crack.errors import ConvergenceError
from fenics_crack.model.modal import SMALL
from fenics_crack.motion.flow import flow_of
from fenics_crack.motion.orbit import KNOWN, PeriodicOrbit
from fenics_crack.motion.shooting import FlowOrbits, orbit_next_to
from fenics_crack.numerics.bordered import (
    PathPoint,
    Tangent,
    distance,
    point_on_path,
    solve_in_plane,
)
from fenics_crack.numerics.path import STRAIGHT, Path, PathOptions

__all__ = ["DoubledStart", "next_to_doubled_orbits"]

NEAREST = 6
"""Points of the curve from which the orbit of the doubling is sought."""
MOST = 30
"""Orbits along the branch."""


@dataclass(frozen=True)
class DoubledStart:
    """A point of a branch of twice the period away from where it begins; its tangent leads on."""

    problem: Problem
    point: PathPoint


def next_to_doubled_orbits(
    curve: ResponseCurve,
    bifurcation: Bifurcation,
    problem: Problem,
    span: tuple[float, float],
    longest_step: float,
) -> DoubledStart | None:
    """Where the branch from a confirmed period doubling of a curve over the load's frequency can
    be entered; ``problem``: with twice the period. None where there is no exact flow.

    Raises
    ------
    ConvergenceError
        The exact orbits have the branch, and the equations have no solution next to it.
    """
    if not bifurcation.confirmed or curve.parameter != "omega":
        return None
    doubling = _at_doubling(curve, bifurcation)
    orbits = [] if doubling is None else list(_branch(doubling, longest_step, span))
    if not orbits:
        return None
    ladder = _ladder(problem)
    for harmonics in ladder:
        family = FrequencyFamily(problem.with_harmonics(harmonics), *span)
        for orbit, ahead in pairwise(orbits):
            found = _next_to(family, orbit)
            if found is not None:
                change = _rows(family, ahead) - _rows(family, orbit)
                rise = family.parameter(ahead.omega) - found.parameter
                weight = 1.0 / family.inner(found.unknown, found.unknown)
                towards = Tangent(change, rise, weight)
                return DoubledStart(family.problem, replace(found, tangent=towards))
    ends = sorted((orbits[0].omega, orbits[-1].omega))
    raise ConvergenceError(
        f"branch from period_doubling at omega = {bifurcation.value:g}: the exact orbits have it, "
        f"next to {ends[0]:g} to {ends[1]:g} rad/s, but no solution with up to {ladder[-1]} "
        "harmonics was found next to them"
    )


def _ladder(problem: Problem) -> list[int]:
    """Numbers of harmonics with which the branch is looked for."""
    counts = [problem.harmonics]
    pairs = problem.structure.n_pairs
    while problem.samples is None and 4 * counts[-1] * pairs <= SMALL:
        counts.append(2 * counts[-1])
    return counts


def _at_doubling(curve: ResponseCurve, one: Bifurcation) -> PeriodicOrbit | None:
    """The exact orbit of a doubling, from the motions of the curve next to it; None where there is
    no flow, or where these lead to other orbits."""
    flow = flow_of(curve.structure, curve.contact)
    if flow is None:
        return None
    near = np.argsort(np.abs(curve.omega - one.exact), kind="stable")[:NEAREST]
    for motion in curve.motions(near):
        orbit = orbit_next_to(flow, one.exact, flow.state(*motion), curve.subharmonic)
        if orbit is not None and np.abs(orbit.multipliers + 1.0).min() <= KNOWN:
            return orbit
    return None


def _branch(
    doubling: PeriodicOrbit, longest_step: float, span: tuple[float, float]
) -> Iterator[PeriodicOrbit]:
    """The exact orbits of twice the period that follow a doubling, within the frequencies asked
    for."""
    periods = 2 * doubling.subharmonic
    orbits = FlowOrbits(doubling.flow, doubling.omega, doubling.state, periods)
    monodromy = orbits.scale[:, None] * doubling.monodromy / orbits.scale
    across = np.linalg.svd(np.eye(len(monodromy)) + monodromy)[2][-1]
    begin = PathPoint(orbits.start, 1.0, 0, Tangent(across, 0.0, 1.0))

    def is_new(found: PathPoint, step: float) -> bool:
        omega, period = found.parameter * doubling.omega, doubling.period / found.parameter
        moved = doubling.flow.advance(orbits.state(found.unknown), omega, period).state
        return bool(np.linalg.norm(orbits.unknown(moved) - found.unknown) > step)

    try:
        found = first_aside(orbits, begin, longest_step, TOLERANCE, is_new)
        if found is None:
            return
        away = Tangent(found.unknown - begin.unknown, found.parameter - 1.0, 1.0)
        start = point_on_path(orbits, found.unknown, found.parameter, away)
        low, high = sorted(omega / doubling.omega for omega in span)
        away_by = distance(orbits, begin, found)
        options = PathOptions(
            away_by, longest_step, max_steps=MOST, min_cosine=STRAIGHT, span=(low, high)
        )
        for point in Path(orbits, start, options).points():
            if not is_new(point, TOLERANCE):
                return
            yield orbits.orbit(point)
    except ConvergenceError:  # pairs that chatter without end
        return


def _rows(family: FrequencyFamily, orbit: PeriodicOrbit) -> np.ndarray:
    """What an orbit is in the unknowns of a family."""
    known, residual = orbit.coefficients(family.problem.harmonics), family.problem.residual
    return known.gap if residual is None else known.gap + known.force @ residual


def _next_to(family: FrequencyFamily, orbit: PeriodicOrbit) -> PathPoint | None:
    """The solution of the equations next to an orbit, and not to one of half its period."""
    guess, parameter, odd = _rows(family, orbit), family.parameter(orbit.omega), odd_rows(family)
    found = solve_in_plane(
        family, guess, parameter, None,
        tolerance=max(PathOptions.rtol, family.rounding(parameter)), iterations=20, patience=6,
    )  # fmt: skip
    if found is None:
        return None
    off = float(np.linalg.norm(found.unknown - guess))
    return found if off < ALIKE * float(np.linalg.norm(guess[odd])) else None
