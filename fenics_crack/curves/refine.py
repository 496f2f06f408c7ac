"""More points on a curve of harmonic balance.

Between the points that were followed others are interpolated by a cubic spline over the distance
along the curve, whose error falls like the fourth power of the distance. From there Newton's method
in the plane across the curve (:mod:`fenics_crack.numerics.newton`) makes a few steps: most points
need one or two. Those that are not solutions after a fixed number of steps are left out.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from fenics_crack.curves.curve import SPREAD, ResponseCurve
from fenics_crack.curves.exact import judge_curve
from fenics_crack.curves.family import Family
from fenics_crack.curves.harmonic_curve import HarmonicCurve
from fenics_crack.curves.orbit_curve import OrbitCurve
from fenics_crack.errors import ConvergenceError, InputError, check_count, check_kind
from fenics_crack.numerics.newton import PathPoint, Tangent, norm_at, solve_in_plane
from fenics_crack.numerics.path import PathOptions


def filled(curve: ResponseCurve) -> ResponseCurve:
    """A curve for a picture: with the points of :func:`refine_curve`, or as it is where that cannot
    put any, and where each of them would ask for its stability, as exact orbits have it."""
    if not isinstance(curve, HarmonicCurve) or curve.multipliers is not None:
        return curve
    try:
        return refine_curve(curve)
    except (InputError, ConvergenceError):
        return curve


def refine_curve(curve: HarmonicCurve, between: int | None = None) -> HarmonicCurve:
    """Return a curve of harmonic balance with more points between each two; judged if it was.

    Parameters
    ----------
    curve : HarmonicCurve
        With at least four points. Exact orbits are followed with a shorter ``longest_step``
        instead.
    between : int, optional
        Points to put between each two; default: as many as a picture needs, few or none where the
        curve has been followed by short steps. Those that Newton's method does not reach at once
        are left out.

    Returns
    -------
    HarmonicCurve
        With the points of the first one among its own.

    Raises
    ------
    InputError
        The curve is too short, or one of exact orbits; more points are asked for than a path may
        take steps.
    ConvergenceError
        A point lies at an undamped resonance that the load drives.

    Examples
    --------
    >>> finer = fc.refine_curve(curve, between=2)
    """
    if isinstance(curve, OrbitCurve):
        raise InputError("curve", curve.method, "of harmonic balance; or give longest_step")
    check_kind("curve", curve, HarmonicCurve)
    if between is not None:
        check_count("between", between, 1)
        if between > (most := PathOptions.max_steps):
            raise InputError("between", between, f"at most {most}")
    if len(curve) < 4:
        raise InputError("curve", f"{len(curve)} points", "at least 4")
    family = curve.equations
    parameters = np.array([family.parameter(value) for value in curve.values])
    flat = curve.unknowns.reshape(len(curve), -1)
    norms = [Tangent(row, 0.0, *norm_at(family, row)) for row in flat]
    size = float(np.mean([one.weight**-0.5 for one in norms]))
    place = np.hstack([flat / size, parameters[:, None]])
    # Equal neighbours would have no distance.
    distance = np.maximum(np.linalg.norm(np.diff(place, axis=0), axis=1), 1e-12)
    along = np.concatenate([[0.0], np.cumsum(distance)])
    added = np.full(len(distance), between or 0)
    if between is None:
        added = _for_a_picture(family, norms, parameters)
    spline, found = CubicSpline(along, place), list[tuple[int, PathPoint]]()
    for index in np.flatnonzero(added):
        sharp, more = max(PathOptions.rtol, family.rounding(parameters[index])), added[index]
        for at in along[index] + np.arange(1, more + 1) / (more + 1) * distance[index]:
            (*unknown, parameter), (*x, p) = spline(at), spline(at, 1)
            guess, way = (size * np.reshape(one, family.shape) for one in (unknown, x))
            near = solve_in_plane(
                family, guess, parameter, Tangent(way, p, size**-2, 1.0), tolerance=sharp
            )
            found += [] if near is None else [(int(index) + 1, near)]
    values = [family.value(point.parameter) for _, point in found]
    columns: dict[str, Any] = {
        "values": values,
        "omega": [family.omega(value) for value in values],
        "unknowns": [point.unknown for _, point in found],
        "iterations": [point.iterations for _, point in found],
    }
    places = [index for index, _ in found]
    if places:
        columns = {n: np.insert(getattr(curve, n), places, new, 0) for n, new in columns.items()}
        curve = replace(curve, **columns)
    plain = replace(curve, multipliers=None, undecided=None)
    return plain if curve.multipliers is None else judge_curve(plain)


def _for_a_picture(system: Family, norms: list[Tangent], parameter: np.ndarray) -> np.ndarray:
    """How many points a picture needs between each two of n, (n-1,), by their distance relative to
    the range of the frequencies, and in the norm of the larger one of the solutions there."""
    squares = []
    for ends in pairwise(norms):
        larger, change = min(ends, key=lambda one: one.weight), ends[1].x - ends[0].x
        squares.append(larger.product(system, change, change))
    distance = np.hypot(np.sqrt(squares), np.diff(parameter))
    return np.maximum(np.ceil(distance * SPREAD).astype(int) - 1, 0)
