"""Many more points on a curve in frequency.

Between the points that were followed others are interpolated by a cubic spline over the distance
along the curve, whose error falls like the fourth power of the distance. From there Newton's method
in the plane across the curve (:mod:`fenics_crack.numerics.bordered`) makes a few steps: most points
need one or two. Those that are not solutions after a fixed number of steps are left out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from fenics_crack.balance.family import FrequencyFamily
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.curves.exact import verified
from fenics_crack.errors import ConvergenceError, InputError, check_count
from fenics_crack.numerics.bordered import Tangent, solve_in_plane
from fenics_crack.numerics.path import PathOptions

__all__ = ["filled", "refine_curve"]

STEPS, MAX_BETWEEN = 4, 1000
PICTURE = 0.025
"""Largest distance between neighbours in a picture, relative to the range of the frequencies and to
the size of the solutions there."""


def filled(curve: ResponseCurve) -> ResponseCurve:
    """A curve for a picture: with the points of :func:`refine_curve`, or as it is where that cannot
    put any, and where each of them would ask for its stability."""
    if curve.multipliers is not None:
        return curve
    try:
        return refine_curve(curve)
    except (InputError, ConvergenceError):
        return curve


def refine_curve(curve: ResponseCurve, between: int | None = None) -> ResponseCurve:
    """Return a curve in frequency with more points between each two; judged if it was.

    Parameters
    ----------
    curve : ResponseCurve
        In the parameter "omega", with at least four points.
    between : int, optional
        Points to put between each two; default: as many as a picture needs, few or none where the
        curve has been followed by short steps. Those that Newton's method does not reach at once
        are left out.

    Returns
    -------
    ResponseCurve
        With the points of the first one among its own.

    Raises
    ------
    InputError
        The curve is in another parameter, or is too short.
    ConvergenceError
        A point lies at an undamped resonance that the load drives.

    Examples
    --------
    >>> finer = fc.refine_curve(curve, between=2)
    """
    if between is not None:
        check_count("between", between, 1)
        if between > MAX_BETWEEN:
            raise InputError("between", between, f"at most {MAX_BETWEEN}")
    if curve.parameter != "omega":
        raise InputError("curve", f"in {curve.parameter!r}", "in 'omega'")
    if len(curve) < 4:
        raise InputError("curve", f"{len(curve)} points", "at least 4")
    span = float(np.ptp(curve.omega)) or 1.0
    flat = curve.unknowns.reshape(len(curve), -1)
    size = float(np.linalg.norm(flat, axis=1).mean()) or 1.0
    place = np.hstack([flat / size, curve.omega[:, None] / span])
    # Equal neighbours would have no distance.
    distance = np.maximum(np.linalg.norm(np.diff(place, axis=0), axis=1), 1e-12)
    along = np.concatenate([[0.0], np.cumsum(distance)])
    added = np.full(len(distance), between or 0)
    if between is None:
        added = np.minimum(_for_a_picture(flat, curve.omega / span), MAX_BETWEEN)
    gap = np.repeat(np.arange(len(added)), added)
    number = np.arange(1, len(gap) + 1) - (np.cumsum(added) - added)[gap]
    wanted = along[gap] + number / (added[gap] + 1) * distance[gap]
    counts = np.maximum(curve.harmonics[:-1], curve.harmonics[1:])[gap]

    spline, pairs = CubicSpline(along, place), curve.unknowns.shape[2]
    unknowns = np.zeros((len(wanted), curve.unknowns.shape[1], pairs))
    omegas, iterations = np.full(len(wanted), np.nan), np.zeros(len(wanted), dtype=int)
    for count in np.unique(counts):
        rows = 2 * int(count) + 1
        problem = curve.problem.with_harmonics(int(count))
        family = FrequencyFamily(problem, problem.omega, problem.omega + span)
        sharp = max(PathOptions.rtol, family.rounding(0.5))
        for number in np.flatnonzero(counts == count):
            guess, slope = (spline(wanted[number], order) for order in (0, 1))
            unknown, across = (size * one[:-1].reshape(-1, pairs)[:rows] for one in (guess, slope))
            found = solve_in_plane(
                family, unknown, family.parameter(span * guess[-1]),
                Tangent(across, float(slope[-1]), size**-2), tolerance=sharp, iterations=STEPS,
            )  # fmt: skip
            if found is not None:
                omegas[number] = family.value(found.parameter)
                unknowns[number, :rows], iterations[number] = found.unknown, found.iterations
    return _merged(curve, (along, wanted), unknowns, omegas, counts, iterations)


def _for_a_picture(flat: np.ndarray, parameter: np.ndarray) -> np.ndarray:
    """How many points a picture needs between each two of n: (n-1,)."""
    lengths = np.linalg.norm(flat, axis=1)
    sizes = np.maximum(np.maximum(lengths[1:], lengths[:-1]), 1e-300)
    change = np.linalg.norm(np.diff(flat, axis=0), axis=1) / sizes
    distance = np.hypot(change, np.diff(parameter))
    return np.maximum(np.ceil(distance / PICTURE).astype(int) - 1, 0)


def _merged(
    curve: ResponseCurve,
    along: tuple[np.ndarray, np.ndarray],
    unknowns: np.ndarray,
    omegas: np.ndarray,
    counts: np.ndarray,
    iterations: np.ndarray,
) -> ResponseCurve:
    """The old and the new points in order; ``along``: where they lie."""
    good = np.isfinite(omegas)
    order = np.argsort(np.concatenate([along[0], along[1][good]]), kind="stable")

    def both(old: np.ndarray, new: np.ndarray) -> np.ndarray:
        return np.concatenate([old, new])[order]

    omega = both(curve.omega, omegas[good])
    merged = replace(
        curve,
        values=omega,
        omega=omega,
        unknowns=both(curve.unknowns, unknowns[good]),
        harmonics=both(curve.harmonics, counts[good]),
        iterations=both(curve.iterations, iterations[good]),
        truncation=both(curve.truncation, np.full(good.sum(), np.nan)),
        multipliers=None,
        undecided=None,
    )
    return merged if curve.multipliers is None else verified(merged)
