"""Branches of twice the period by way of exact orbits, where harmonic balance does not lead there.

The equations of harmonic balance have their own period doubling, where the block of the odd
harmonics is singular. With stiff contact it lies elsewhere than that of the motion, or nowhere: few
harmonics do not tell the two halves of the doubled period apart. The exact orbits do. At their
doubling M v = -v, and with twice the period,

    F_2(x, p) = z(2 T; x, p) / |z_0| - x = 0,

a second branch leaves in the direction (v, 0). It is followed by arc-length, and at its points the
Fourier coefficients of the gap are where Newton's method begins: with as many harmonics as were
asked for, then with twice as many, and so on. What is found is a start if it is nearer to the orbit
than half of what tells this from the old branch, the odd harmonics.

Source: Seydel, Practical Bifurcation and Stability Analysis, chapters 5 and 7.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fenics_crack.balance.arclength import Stepping, follow_path
from fenics_crack.balance.bordered import PathPoint, Tangent, correct, distance, solve_in_plane
from fenics_crack.balance.family import FrequencyFamily
from fenics_crack.balance.fourier import balanced
from fenics_crack.balance.orbits import FlowOrbits
from fenics_crack.balance.problem import Problem
from fenics_crack.curves.bifurcations import attainable, odd_rows
from fenics_crack.curves.curve import Bifurcation, ResponseCurve
from fenics_crack.errors import ConvergenceError
from fenics_crack.motion.flow import flow_of
from fenics_crack.motion.orbit import PeriodicOrbit
from fenics_crack.stability.refinement import refine_bifurcation

__all__ = ["DoubledStart", "next_to_doubled_orbits"]

SAME = 1e-6
"""Of the frequency, relative: how far the doubling may move when it is located anew."""
NEAREST, REACH = 6, 0.03
"""Points of the curve from which it is, next to its own solution, and how far away."""
ASIDE = (1e-3, 3e-4, 3e-3, 1e-4, 1e-2)
"""Distances from the doubling at which the first orbit of twice the period is looked for."""
LONGEST, MOST, SHARP = 0.05, 30, 1e-9
"""Steps along the branch of exact orbits, how many, and |F| / |x| of these."""
JOINED = 1e-6
"""Share of the odd harmonics below which the orbit has half the period again."""
MOST_HARMONICS, MOST_UNKNOWNS = 320, 700
"""Of the equations that are tried: above, each would take a second."""
EVERY = 3
"""Orbits to the next one that is tried with more harmonics than were asked for."""
NEAR = 0.5
"""Distance from the orbit, relative to its odd harmonics."""


@dataclass(frozen=True)
class DoubledStart:
    """A point of a branch of twice the period away from where it begins, and the way on."""

    problem: Problem
    point: PathPoint
    towards: Tangent


@dataclass(frozen=True)
class _Orbit:
    """An exact orbit of twice the period: load frequency, and gap (n, n_pairs) [m] in time."""

    omega: float
    gap: np.ndarray


def next_to_doubled_orbits(
    curve: ResponseCurve, bifurcation: Bifurcation, problem: Problem, span: tuple[float, float]
) -> DoubledStart | None:
    """Where the branch from a confirmed period doubling of a curve over the load's frequency can
    be entered; ``problem``: with twice the period. None where the exact flow is not at hand.

    Raises
    ------
    ConvergenceError
        The exact orbits have the branch, and the equations have no solution next to it.
    """
    known = bifurcation.confirmed and bifurcation.kind == "period_doubling"
    if not known or curve.parameter != "omega" or not _has_flow(problem):
        return None
    family = FrequencyFamily(problem, *span)
    doubling = _located(curve, bifurcation)
    if family.problem.residual is not None or doubling is None:
        return None
    orbits = list(_branch(problem, *doubling, span))
    for harmonics in _ladder(problem):
        family = FrequencyFamily(problem.with_harmonics(harmonics), *span)
        tried = orbits[:: 1 if harmonics == problem.harmonics else EVERY]
        for number, orbit in enumerate(tried[:-1]):
            found = _next_to(family, orbit)
            if found is not None:
                ahead = _rows(family, tried[number + 1]), tried[number + 1].omega
                rise = family.parameter(ahead[1]) - found.parameter
                weight = 1.0 / family.inner(found.unknown, found.unknown)
                towards = Tangent(ahead[0] - _rows(family, orbit), rise, weight)
                return DoubledStart(family.problem, found, towards)
    if not orbits:
        return None
    ends = sorted(orbit.omega for orbit in (orbits[0], orbits[-1]))
    raise ConvergenceError(
        f"branch from period_doubling at omega = {bifurcation.value:g}: the exact orbits have it, "
        f"next to {ends[0]:g} to {ends[1]:g} rad/s, but no solution with up to "
        f"{_ladder(problem)[-1]} harmonics was found next to them"
    )


def _has_flow(problem: Problem) -> bool:
    return flow_of(problem.structure, problem.contact) is not None


def _ladder(problem: Problem) -> list[int]:
    """Numbers of harmonics with which the branch is looked for."""
    counts = [problem.harmonics]
    most = min(MOST_HARMONICS, MOST_UNKNOWNS // (2 * problem.structure.n_pairs))
    while problem.samples is None and 2 * counts[-1] <= most:
        counts.append(2 * counts[-1])
    return counts


def _located(curve: ResponseCurve, one: Bifurcation) -> tuple[float, PeriodicOrbit] | None:
    """Frequency and exact orbit of a doubling, from its own solution or from waves of the curve
    next to it; None where another one is found instead."""
    near = np.argsort(np.abs(curve.omega - one.exact), kind="stable")[:NEAREST]
    for place in (None, *map(int, near)):
        start = one
        if place is not None:
            known = one.kind, float(one.exact), curve.unknown(place)
            [start] = curve.expand_bifurcations([known])
        try:
            found = refine_bifurcation(start, reach=REACH)
        except ConvergenceError:
            continue
        if abs(found[0] / one.exact - 1.0) < SAME:
            return found
    return None


def _branch(
    problem: Problem, omega: float, orbit: PeriodicOrbit, span: tuple[float, float]
) -> Iterator[_Orbit]:
    """The exact orbits of twice the period that follow a doubling, within the frequencies asked
    for, until they have half the period again."""
    half = FlowOrbits(orbit.flow, omega, orbit.state, problem.subharmonic // 2)
    orbits = FlowOrbits(orbit.flow, omega, orbit.state, problem.subharmonic)
    monodromy = half.linearise(half.start, 1.0).monodromy
    across = np.linalg.svd(np.eye(len(monodromy)) + monodromy)[2][-1]
    begin = PathPoint(orbits.start, 1.0, 0, Tangent(across, 0.0, 1.0))
    try:
        for aside in ASIDE:
            found = correct(orbits, begin, aside, SHARP, reach=LONGEST)
            if found is not None and distance(orbits, begin, found) < 3.0 * aside:
                break
        else:
            return
        stepping = Stepping(0.5 * aside, LONGEST, 1e-9, MOST, SHARP, least_cosine=0.9)
        way = Tangent(found.unknown - orbits.start, found.parameter - 1.0, 1.0)
        for point in follow_path(orbits, found.unknown, found.parameter, stepping, way):
            gap = orbits.gap(point.unknown, point.parameter, 8 * MOST_HARMONICS)
            apart = np.linalg.norm(gap - np.roll(gap, len(gap) // 2, axis=0))
            at = point.parameter * omega
            if not min(span) < at < max(span) or apart < JOINED * np.linalg.norm(gap):
                return
            yield _Orbit(at, gap)
    except ConvergenceError:  # pairs that chatter without end
        return


def _rows(family: FrequencyFamily, orbit: _Orbit) -> np.ndarray:
    """Fourier coefficients of an orbit's gap with the harmonics of a family."""
    return balanced(orbit.gap, family.problem.harmonics)


def _next_to(family: FrequencyFamily, orbit: _Orbit) -> PathPoint | None:
    """The solution of the equations next to an orbit, and not to one of half its period."""
    guess, parameter, odd = _rows(family, orbit), family.parameter(orbit.omega), odd_rows(family)
    found = solve_in_plane(
        family, guess, parameter, None,
        tolerance=attainable(family, parameter, 1e-9), iterations=20, patience=6,
    )  # fmt: skip
    if found is None:
        return None
    off = float(np.linalg.norm(found.unknown - guess))
    return found if off < NEAR * float(np.linalg.norm(guess[odd])) else None
