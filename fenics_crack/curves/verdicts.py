"""Verdicts of the points of a harmonic-balance curve: by their nearest exact orbits, or by
the flow linearised along them.

Each point is assessed as a single solution is (:mod:`fenics_crack.balance.assessment`); its folds
and branch points are those of its own equations. Where none of its first, middle and last point has
an orbit of its own, none is sought at the others: the curve costs what its harmonic balance costs.
Of the points that are left open eight are followed, spread evenly. Where two neighbours of these
are irregular, so are the points between them, if all of these are open.

With laws without an exact flow it is the linearised flow. Between two points lies
a period doubling or a Neimark-Sacker point where the numbers of multipliers outside the unit circle
say so (:mod:`orbit_events`); it is located on the path between them
(:class:`fenics_crack.numerics.path.ZeroCrossing`).

Source: Seydel, Practical Bifurcation and Stability Analysis, chapters 4 and 7.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

from fenics_crack.balance.assessment import MAX_ERROR
from fenics_crack.balance.solution import Stability
from fenics_crack.basics.progress import begin
from fenics_crack.curves.branch import neighbours
from fenics_crack.curves.curve import ResponseCurve, leading
from fenics_crack.curves.orbit_events import (
    about_minus_one,
    beyond_circle,
    changes,
    leading_multipliers,
)
from fenics_crack.curves.stability import floquet, monodromy, stability_of
from fenics_crack.curves.waves import Waves
from fenics_crack.model.contact import is_unilateral
from fenics_crack.motion.orbit import eigenvalues
from fenics_crack.numerics.newton import PathPoint, point_on_path
from fenics_crack.numerics.path import ZeroCrossing

MAX_FOLLOWED_POINTS = 8
"""Points of a curve whose exact motion is followed. Each takes 0.05 to 0.5 s."""


def judge_curve(curve: ResponseCurve) -> ResponseCurve:
    """Assess the points of a curve over any parameter by their nearest exact orbits.

    Laws that are not linear in contact have no exact orbits: their points are assessed as
    :func:`floquet` does, and period doublings and Neimark-Sacker points are where multipliers of
    the linearised flow leave the unit circle.

    Parameters
    ----------
    curve : ResponseCurve
        Of harmonic balance, followed with or without ``stability=True``.

    Returns
    -------
    ResponseCurve
        The same points, with the multipliers of their orbits; "irregular", with the growth of a
        small disturbance, where exact motions are; else "undecided" (and nan) where the predicted
        error is above 0.1, or no orbit is accepted for its solution.

    Raises
    ------
    InputError
        As :func:`fenics_crack.shoot`.

    Examples
    --------
    >>> judged = fc.judge_curve(curve)
    >>> verdicts = judged.verdicts
    """
    if not is_unilateral(curve.contact):
        return judged_by_waves(curve)
    begin("stability by exact orbits")
    multipliers = np.full(len(curve), np.nan + 0j)
    first = {0, len(curve) // 2, len(curve) - 1}
    for places in map(sorted, (first, {*range(len(curve))} - first)):
        for place, known in zip(places, curve.assessments(places), strict=True):
            # With a larger error an orbit is seldom its own.
            if known.predicted_error <= MAX_ERROR and known.is_accepted:
                multipliers[place] = _deciding(stability_of(known))
        if np.isnan(multipliers).all():
            break
    growth = _growth_along(curve, np.isnan(multipliers))
    multipliers = np.where(growth > 1.0, growth, multipliers)
    return replace(curve, multipliers=multipliers, irregular=growth > 1.0)


def _growth_along(curve: ResponseCurve, is_open: np.ndarray) -> np.ndarray:
    """Measure the growth of disturbances at some of the open points (n,) bool of a curve.

    Returns
    -------
    (n,)
        In a period; between two irregular points geometric means, elsewhere nan.
    """
    growth, places = np.full(len(curve), np.nan), np.flatnonzero(is_open)
    steps = np.linspace(0, len(places) - 1, min(MAX_FOLLOWED_POINTS, len(places)))
    indices = places[steps.astype(int)].tolist()
    for place, assessment in zip(indices, curve.assessments(indices), strict=True):
        if motion := assessment.irregular_motion:
            growth[place] = motion.growth
    for start, end in pairwise(indices):
        if is_open[start : end + 1].all() and growth[start] * growth[end] > 0.0:
            growth[start : end + 1] = np.geomspace(growth[start], growth[end], end + 1 - start)
    return growth


def _deciding(stability: Stability) -> complex:
    """The leading multiplier; nan where the stability is undecided."""
    return math.nan if stability.verdict == "undecided" else leading(stability.multipliers)


def judged_by_waves(curve: ResponseCurve) -> ResponseCurve:
    """The same curve with verdicts, and with bifurcations where multipliers of the flow
    linearised along it leave the unit circle."""
    begin("stability of each point")
    solutions = (curve.solution(place, search=False) for place in range(len(curve)))
    found = [floquet(one.structure, one) for one in solutions]
    special = [one for one in curve.bifurcations if one.kind in ("fold", "branch_point")]
    values = np.array([one.multipliers for one in found])
    rows = leading_multipliers(values)
    crossed = changes(rows)[:, 1:] != 0.0
    crossed &= np.isfinite(values[1:] + values[:-1]).all(axis=1)[:, None]
    for place, which in np.argwhere(crossed).tolist():
        kind, pairs = ("period_doubling", "neimark_sacker")[which], rows[place : place + 2, -1]
        number = int(pairs.real.max()) - 1
        test = partial(beyond_circle, number=number) if which else about_minus_one
        special.append(curve.bifurcation(kind, *_located(curve, place, test)))
    special.sort(key=curve.nearest)
    multipliers = np.array([_deciding(one) for one in found], dtype=complex)
    return replace(curve, bifurcations=tuple(special), multipliers=multipliers)


def _located(
    curve: ResponseCurve, place: int, test: Callable[[np.ndarray], float]
) -> tuple[float, float, np.ndarray]:
    """Value of the parameter, load frequency and unknown behind a point where a function of
    multipliers is zero."""
    system = curve.system
    assert isinstance(system, Waves)
    ends = neighbours(system, curve, place, place + 1)
    first, last = (point_on_path(system, at.unknown, at.parameter, at.tangent) for at in ends)

    def value(at: PathPoint) -> float:
        problem = system.at(system.value(at.parameter))
        above, omega = problem.static_cutoff, problem.base_omega
        matrix = monodromy(problem.structure, problem.contact, at.unknown, omega, above)
        return test(eigenvalues(matrix))

    found = ZeroCrossing(value).locate(system, (first, last), system.rounding(last.parameter))
    assert found is not None
    there = system.value(found.parameter)
    return there, system.omega(there, found.unknown), found.unknown
