"""Verdicts on a harmonic-balance curve, by exact orbits or by the linear flow.

Each point is assessed like a single solution (:mod:`fenics_crack.balance.assessment`) by its
nearest exact orbit. Folds and branch points are those of the truncated equations. If no orbit
decides at the first, the middle and the last point, the other points are not assessed. Up to eight
points without a verdict, evenly spread, are followed in time. If two successive ones are irregular,
the points between them count as irregular, provided that none of them has a verdict.

Under laws without an exact flow, points are assessed by the linear flow along the solution. Between
two points there is a period doubling or a Neimark-Sacker point if numbers of multipliers outside
the unit circle change as in :mod:`orbit_events`. This point is located on the path between both
points (:class:`fenics_crack.numerics.path.ZeroCrossing`).

References
----------
Seydel, Practical Bifurcation and Stability Analysis, chapters 4 and 7.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

from fenics_crack.balance.assessment import MAX_ORBIT_DISTANCE
from fenics_crack.balance.solution import Stability
from fenics_crack.basics.progress import begin_stage
from fenics_crack.curves.balance_equations import BalanceEquations
from fenics_crack.curves.branch import path_points_with_chord
from fenics_crack.curves.curve import ResponseCurve, leading_multiplier_in_upper_half
from fenics_crack.curves.orbit_events import (
    changes_of_multiplier_counts,
    complex_pair_modulus_excess,
    leading_multipliers_and_counts,
    period_doubling_test_value,
)
from fenics_crack.curves.stability import floquet, monodromy_of_linear_flow, stability_of
from fenics_crack.model.contact import is_unilateral
from fenics_crack.motion.orbit import eigenvalues
from fenics_crack.numerics.newton import PathPoint, point_on_path
from fenics_crack.numerics.path import ZeroCrossing

MAX_FOLLOWED_POINTS = 8
"""Maximum number of points without a verdict whose exact motion is integrated.

A motion takes 0.05 to 0.5 s of computation.
"""


def judge_curve(curve: ResponseCurve) -> ResponseCurve:
    """Assess the stability along a curve by nearest exact orbits.

    Smooth laws, not piecewise linear, have no exact orbits. Each point is then assessed like a
    solution in :func:`floquet`. Period doublings and Neimark-Sacker points are found from the
    multipliers of the linear flow.

    Parameters
    ----------
    curve : ResponseCurve
        Harmonic-balance curve over any parameter, followed with or without ``stability=True``.

    Returns
    -------
    ResponseCurve
        Same points, with the multipliers of their orbits. Points with an irregular exact motion are
        "irregular", with the growth of a small disturbance. Points are "undecided" (nan) if the
        predicted error is above 0.1, or if no orbit is accepted for the solution. They are also
        undecided if the largest multiplier's modulus differs from 1 by at most 1e-6.

    Raises
    ------
    InputError
        The law is smooth, and its tangent is not the slope of its force.

    Examples
    --------
    >>> judged = fc.judge_curve(curve)
    >>> verdicts = judged.verdicts
    """
    if not is_unilateral(curve.contact):
        return judge_by_linear_flow(curve)
    begin_stage("stability by exact orbits")
    multipliers = np.full(len(curve), np.nan + 0j)
    first_middle_and_last_indices = {0, len(curve) // 2, len(curve) - 1}
    for indices in map(
        sorted,
        (first_middle_and_last_indices, {*range(len(curve))} - first_middle_and_last_indices),
    ):
        for index, assessment in zip(indices, curve.assessments(indices), strict=True):
            # With a larger error, the nearest orbit is seldom accepted.
            if assessment.predicted_error <= MAX_ORBIT_DISTANCE and assessment.is_accepted:
                multipliers[index] = _leading_multiplier_if_decided(stability_of(assessment))
        if np.isnan(multipliers).all():
            break
    growth_factors = _growth_factors_of_irregular_motions(curve, np.isnan(multipliers))
    multipliers = np.where(growth_factors > 1.0, growth_factors, multipliers)
    return replace(curve, multipliers=multipliers, irregular=growth_factors > 1.0)


def _growth_factors_of_irregular_motions(
    curve: ResponseCurve, is_undecided: np.ndarray
) -> np.ndarray:
    """Measure the growth of small disturbances at points with undecided stability.

    At most 8 points, evenly spread, are integrated in time. ``is_undecided`` (n,) is True at
    these points.

    Returns
    -------
    (n,)
        At integrated points with irregular motion: factor by which a disturbance grows per period.
        Points between two of them are interpolated geometrically, if all of these are undecided. At
        other points nan.
    """
    growth_factors, undecided_indices = np.full(len(curve), np.nan), np.flatnonzero(is_undecided)
    positions_in_undecided_indices = np.linspace(
        0, len(undecided_indices) - 1, min(MAX_FOLLOWED_POINTS, len(undecided_indices))
    )
    followed_indices = undecided_indices[positions_in_undecided_indices.astype(int)].tolist()
    for index, assessment in zip(
        followed_indices, curve.assessments(followed_indices), strict=True
    ):
        if irregular_attractor := assessment.irregular_attractor:
            growth_factors[index] = irregular_attractor.growth
    for stretch_start_index, stretch_end_index in pairwise(followed_indices):
        stretch_slice = slice(stretch_start_index, stretch_end_index + 1)
        growth_factors_at_stretch_ends = growth_factors[[stretch_start_index, stretch_end_index]]
        if is_undecided[stretch_slice].all() and np.prod(growth_factors_at_stretch_ends) > 0.0:
            growth_factors[stretch_slice] = np.geomspace(
                *growth_factors_at_stretch_ends, stretch_end_index + 1 - stretch_start_index
            )
    return growth_factors


def _leading_multiplier_if_decided(stability: Stability) -> complex:
    """Return the Floquet multiplier of largest modulus; nan if the stability is undecided."""
    if stability.verdict == "undecided":
        return math.nan
    return leading_multiplier_in_upper_half(stability.multipliers)


def judge_by_linear_flow(curve: ResponseCurve) -> ResponseCurve:
    """Return a curve with stability and bifurcations by the linear flow.

    The flow is linearised along each solution, for laws without exact orbits. A period doubling or
    Neimark-Sacker point is located wherever multipliers cross the unit circle between two points.
    """
    begin_stage("stability of each point")
    solutions = (curve.solution(point_index, search=False) for point_index in range(len(curve)))
    stabilities = [floquet(solution.structure, solution) for solution in solutions]
    bifurcations = [
        bifurcation
        for bifurcation in curve.bifurcations
        if bifurcation.kind in ("fold", "branch_point")
    ]
    multipliers = np.array([stability.multipliers for stability in stabilities])
    multipliers_and_counts = leading_multipliers_and_counts(multipliers)
    has_crossing = changes_of_multiplier_counts(multipliers_and_counts)[:, 1:] != 0.0
    has_crossing &= np.isfinite(multipliers[1:] + multipliers[:-1]).all(axis=1)[:, None]
    for point_index, kind_index in np.argwhere(has_crossing).tolist():
        bifurcation_kind = ("period_doubling", "neimark_sacker")[kind_index]
        n_complex_pairs_outside_circle = multipliers_and_counts[point_index : point_index + 2, -1]
        multiplier_pair_index = int(n_complex_pairs_outside_circle.real.max()) - 1
        pair_modulus_excess_function = partial(
            complex_pair_modulus_excess, multiplier_pair_index=multiplier_pair_index
        )
        test_function = pair_modulus_excess_function if kind_index else period_doubling_test_value
        bifurcation_location = _locate_bifurcation(curve, point_index, test_function)
        bifurcations.append(curve.bifurcation(bifurcation_kind, *bifurcation_location))
    bifurcations.sort(key=curve.nearest)
    curve_multipliers = np.array(
        [_leading_multiplier_if_decided(stability) for stability in stabilities], dtype=complex
    )
    return replace(curve, bifurcations=tuple(bifurcations), multipliers=curve_multipliers)


def _locate_bifurcation(
    curve: ResponseCurve, index: int, test_function: Callable[[np.ndarray], float]
) -> tuple[float, float, np.ndarray]:
    """Locate a bifurcation between two neighbouring points of a harmonic-balance curve.

    Parameters
    ----------
    curve : ResponseCurve
        Harmonic-balance curve.
    index : int
        Index of the point before the bifurcation.
    test_function : callable
        Function of the Floquet multipliers (2 n_modes,) that is zero at the bifurcation.

    Returns
    -------
    value, omega : float
        Parameter value, and load frequency [rad/s].
    unknown : (2H+1, n_pairs) [m]
        Fourier coefficients of the gaps. With a residual flexibility: of the slow gaps, gap plus
        residual flexibility times contact force.
    """
    system = curve.system
    assert isinstance(system, BalanceEquations)
    chord_ends = path_points_with_chord(system, curve, index, index + 1)
    first_end_point, last_end_point = (
        point_on_path(system, path_point.unknown, path_point.parameter, path_point.tangent)
        for path_point in chord_ends
    )

    def test_value_at(path_point: PathPoint) -> float:
        """Return the test function at a point of the path."""
        problem = system.problem_at(system.value(path_point.parameter))
        static_cutoff, omega = problem.static_cutoff, problem.base_omega
        monodromy_matrix = monodromy_of_linear_flow(
            problem.structure, problem.contact, path_point.unknown, omega, static_cutoff
        )
        return test_function(eigenvalues(monodromy_matrix))

    zero_point = ZeroCrossing(test_value_at).locate(
        system, (first_end_point, last_end_point), system.rounding(last_end_point.parameter)
    )
    assert zero_point is not None
    value, unknown = system.value(zero_point.parameter), zero_point.unknown
    return value, system.omega(value, unknown), unknown
