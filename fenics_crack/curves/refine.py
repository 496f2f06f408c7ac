"""Many more points on a curve.

Between the points that were followed others are interpolated by a cubic spline over the distance
along the curve, whose error falls like the fourth power of the distance. From there Newton's method
in the plane across the curve (:mod:`fenics_crack.numerics.bordered`) makes a few steps: most points
need one or two. Those that are not solutions after a fixed number of steps are left out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from fenics_crack.balance.family import Family
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.curves.exact import verified
from fenics_crack.curves.points import CurvePoint, Points
from fenics_crack.errors import ConvergenceError, InputError, check_count
from fenics_crack.numerics.bordered import Tangent, solve_in_plane
from fenics_crack.numerics.path import PathOptions

__all__ = ["filled", "refine_curve"]

MAX_BETWEEN = 1000
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
    """Return a curve with more points between each two; judged if it was.

    Parameters
    ----------
    curve : ResponseCurve
        With at least four points.
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
        The curve is too short.
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
    if len(curve) < 4:
        raise InputError("curve", f"{len(curve)} points", "at least 4")
    whole = curve.equations(int(curve.harmonics[0]))
    parameters = np.array([whole.parameter(value) for value in curve.values])
    flat = curve.unknowns.reshape(len(curve), -1)
    size = float(np.linalg.norm(flat, axis=1).mean()) or 1.0
    place = np.hstack([flat / size, parameters[:, None]])
    # Equal neighbours would have no distance.
    distance = np.maximum(np.linalg.norm(np.diff(place, axis=0), axis=1), 1e-12)
    along = np.concatenate([[0.0], np.cumsum(distance)])
    added = np.full(len(distance), between or 0)
    if between is None:
        added = np.minimum(_for_a_picture(flat, parameters), MAX_BETWEEN)
    spline, points = CubicSpline(along, place), Points()
    for index, more in enumerate(added):
        points.append(curve.point(index))
        if not more:
            continue
        family = curve.equations(int(curve.harmonics[index : index + 2].max()))
        sharp = max(PathOptions.rtol, family.rounding(parameters[index]))
        for at in along[index] + np.arange(1, more + 1) / (more + 1) * distance[index]:
            (unknown, parameter), (x, p) = (_split(spline(at, order), family) for order in (0, 1))
            found = solve_in_plane(
                family, size * unknown, parameter, Tangent(size * x, p, size**-2),
                tolerance=sharp,
            )  # fmt: skip
            if found is not None:
                value = family.value(found.parameter)
                points.append(
                    CurvePoint(value, family.omega(value), found.unknown, found.iterations)
                )
    points.append(curve.point(len(curve) - 1))
    merged = replace(curve, **points.columns(), multipliers=None, undecided=None)
    return merged if curve.multipliers is None else verified(merged)


def _split(place: np.ndarray, family: Family) -> tuple[np.ndarray, float]:
    """Unknowns, of their size, and parameter of a place along the spline."""
    rows, pairs = family.shape
    return place[:-1].reshape(-1, pairs)[:rows], float(place[-1])


def _for_a_picture(flat: np.ndarray, parameter: np.ndarray) -> np.ndarray:
    """How many points a picture needs between each two of n: (n-1,)."""
    lengths = np.linalg.norm(flat, axis=1)
    sizes = np.maximum(np.maximum(lengths[1:], lengths[:-1]), 1e-300)
    change = np.linalg.norm(np.diff(flat, axis=0), axis=1) / sizes
    distance = np.hypot(change, np.diff(parameter))
    return np.maximum(np.ceil(distance / PICTURE).astype(int) - 1, 0)
