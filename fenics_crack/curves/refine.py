"""More points on a curve, and its bifurcations without truncation.

Between the points that were followed others are interpolated by a cubic spline over the distance
along the curve, whose error falls like the fourth power of the distance. From there Newton's method
in the plane across the curve (:mod:`fenics_crack.numerics.newton`) makes a few steps: most points
need one or two. Those that are not solutions after a fixed number of steps are left out.

Harmonic balance locates a bifurcation as well as its solution is resolved: with stiff contact and
few harmonics, to some per cent. Here the branch of exact orbits is followed from there
(:mod:`orbit_path`), in both directions by turns, to a bifurcation of this kind.

Source: Kuznetsov, Elements of Applied Bifurcation Theory, chapter 10; Seydel, Practical
Bifurcation and Stability Analysis, chapters 4 and 7.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain, pairwise, zip_longest
from typing import Protocol

import numpy as np
from scipy.interpolate import CubicSpline

from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.curves.curve import SPREAD, ResponseCurve
from fenics_crack.curves.exact import judge_curve
from fenics_crack.curves.family import Family
from fenics_crack.curves.harmonic_curve import CurvePoint, HarmonicCurve, columns
from fenics_crack.curves.orbit_curve import OrbitCurve, leading, orbit_from
from fenics_crack.curves.orbit_family import OrbitFamily
from fenics_crack.curves.orbit_path import OrbitBifurcation, OrbitPath
from fenics_crack.errors import (
    ConvergenceError,
    InputError,
    check_choice,
    check_count,
    check_kind,
    check_number,
)
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.structure import Structure
from fenics_crack.motion.flow import exact_flow
from fenics_crack.motion.orbit import PeriodicOrbit, find_orbit
from fenics_crack.numerics.equations import CLOSE
from fenics_crack.numerics.newton import (
    FULL_STEPS,
    LEAST_STEP,
    PathPoint,
    Tangent,
    norm_at,
    solve_in_plane,
    tangent_of,
)
from fenics_crack.numerics.path import PathOptions
from fenics_crack.time.march import initial_state


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
        The curve is too short; more points are asked for than a path may take steps.
    ConvergenceError
        A point lies at an undamped resonance that the load drives.

    Examples
    --------
    >>> finer = fc.refine_curve(curve, between=2)
    """
    check_kind("curve", curve, ResponseCurve)
    if between is not None:
        check_count("between", between, 1)
        if between > (most := PathOptions.max_steps):
            raise InputError("between", between, f"at most {most}")
    if len(curve) < 4:
        raise InputError("curve", f"{len(curve)} points", "at least 4")
    if isinstance(curve, OrbitCurve):
        return _more_orbits(curve, between)
    assert isinstance(curve, HarmonicCurve)
    return _more_solutions(curve, between)


def _more_solutions(curve: HarmonicCurve, between: int | None) -> HarmonicCurve:
    """The same of harmonic balance."""
    whole = curve.equations(int(curve.harmonics[0]))
    parameters = np.array([whole.parameter(value) for value in curve.values])
    flat = curve.unknowns.reshape(len(curve), -1)
    norms = [Tangent(row, 0.0, *norm_at(whole, row)) for row in flat]
    size = float(np.mean([one.weight**-0.5 for one in norms]))
    place = np.hstack([flat / size, parameters[:, None]])
    # Equal neighbours would have no distance.
    distance = np.maximum(np.linalg.norm(np.diff(place, axis=0), axis=1), 1e-12)
    along = np.concatenate([[0.0], np.cumsum(distance)])
    added = np.full(len(distance), between or 0)
    if between is None:
        added = _for_a_picture(whole, norms, parameters)
    spline, points = CubicSpline(along, place), list[CurvePoint]()
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
    merged = replace(curve, **columns(points), multipliers=None, undecided=None)
    return merged if curve.multipliers is None else judge_curve(merged)


def _more_orbits(curve: OrbitCurve, between: int | None) -> OrbitCurve:
    """The same of exact orbits, at values of the parameter between those of the points."""
    first = curve.orbit(0)
    weights = first.flow.weights(first.omega / first.subharmonic)
    size = float(np.linalg.norm(weights * curve.states, axis=1).max()) or 1.0
    wide = float(np.ptp(curve.values)) or 1.0
    place = np.column_stack([weights * curve.states / size, curve.values / wide])
    distance = np.maximum(np.linalg.norm(np.diff(place, axis=0), axis=1), 1e-12)
    along = np.concatenate([[0.0], np.cumsum(distance)])
    added = np.full(len(distance), between or 0)
    if between is None:
        added = np.ceil(distance * SPREAD).astype(int) - 1
    spline, found = CubicSpline(along, place), list[tuple[int, float, PeriodicOrbit]]()
    for index, more in enumerate(added):
        for at in along[index] + np.arange(1, more + 1) / (more + 1) * distance[index]:
            guess = spline(at)
            value, state = wide * float(guess[-1]), size * guess[:-1] / weights
            omega = curve.problem_at(value).omega
            orbit = find_orbit(curve.flow(value), omega, state, subharmonic=curve.subharmonic)
            if orbit is not None:
                off = np.linalg.norm(weights * (orbit.state - state)) / size
                found += [(index + 1, value, orbit)] * bool(off <= distance[index])
    places = [place for place, _, _ in found]
    columns = {
        "values": [value for _, value, _ in found],
        "omega": [orbit.omega for _, _, orbit in found],
        "iterations": [orbit.iterations for _, _, orbit in found],
        "states": [orbit.state for _, _, orbit in found],
        "multipliers": [leading(orbit.multipliers) for _, _, orbit in found],
    }
    return replace(
        curve,
        **{
            name: np.insert(getattr(curve, name), places, np.array(column), axis=0)
            for name, column in columns.items()
            if found
        },
    )


def _split(place: np.ndarray, family: Family) -> tuple[np.ndarray, float]:
    """Unknowns, of their size, and parameter of a place along the spline."""
    rows, pairs = family.shape
    return place[:-1].reshape(-1, pairs)[:rows], float(place[-1])


def _for_a_picture(system: Family, norms: list[Tangent], parameter: np.ndarray) -> np.ndarray:
    """How many points a picture needs between each two of n, (n-1,), by their distance relative to
    the range of the frequencies, and in the norm of the larger one of the solutions there."""
    squares = []
    for ends in pairwise(norms):
        larger, change = min(ends, key=lambda one: one.weight), ends[1].x - ends[0].x
        squares.append(larger.product(system, change, change))
    distance = np.hypot(np.sqrt(squares), np.diff(parameter))
    return np.maximum(np.ceil(distance * SPREAD).astype(int) - 1, 0)


KINDS = "fold", "period_doubling", "neimark_sacker"
"""Of bifurcations that are located on exact orbits."""


class _Special(Protocol):
    """What is asked of a bifurcation: as :class:`fenics_crack.curves.curve.Bifurcation`."""

    @property
    def kind(self) -> str: ...

    @property
    def solution(self) -> PeriodicSolution: ...


def refine_bifurcation(
    bifurcation: _Special,
    structure: Structure | None = None,
    contact: ContactLaw | None = None,
    *,
    reach: float = 0.05,
    longest_step: float = 0.02,
) -> tuple[float, PeriodicOrbit]:
    """Locate a bifurcation found by harmonic balance on the branch of exact orbits.

    Parameters
    ----------
    bifurcation : Bifurcation
        Of a curve; or anything with ``kind`` and ``solution``.
    structure : Structure, optional
        Default: the solution's; at most 600 dofs.
    contact : UnilateralPenalty, optional
        Default: the solution's.
    reach : float
        How far to look, relative to the frequency of the solution; at most 0.5.
    longest_step : float
        Along the branch, relative to the solution's size and frequency.

    Returns
    -------
    omega : float [rad/s]
        Load frequency of the bifurcation nearest along the branch.
    orbit : PeriodicOrbit
        The orbit there.

    Raises
    ------
    InputError
        The kind is another, or as :func:`fenics_crack.integrate_events`.
    ConvergenceError
        No exact orbit near the solution, or no bifurcation of this kind within reach of it.

    Notes
    -----
    With few harmonics a curve has special points that are not there on exact orbits, or several
    where these have one: several of them may lead to the same point, or to none.

    Examples
    --------
    >>> omega, orbit = fc.refine_bifurcation(doubling.bifurcations[0])
    """
    kind = getattr(bifurcation, "kind", type(bifurcation).__name__)
    check_choice("bifurcation", kind, KINDS)
    solution = bifurcation.solution
    check_number("reach", reach, 0.0, above=True)
    if reach > 0.5:
        raise InputError("reach", reach, "at most 0.5")
    check_number("longest_step", longest_step, 0.0, above=True)
    omega, law = solution.omega, solution.contact if contact is None else contact
    assert law is not None
    structure = structure or solution.structure
    flow = exact_flow(structure, law)
    problem = Problem(structure, omega, law, subharmonic=solution.subharmonic)
    family = OrbitFamily(problem, "omega", (1.0 - reach) * omega, (1.0 + reach) * omega)
    start = family.unknown(flow.state(*initial_state(structure, solution)), omega)
    begun = _orbit_next_to(family, start, family.parameter(omega))
    if begun is None:
        raise ConvergenceError(f"refinement: no exact orbit near the solution at {omega:g} rad/s")
    ways = begun.tangent, begun.tangent.reversed()
    sides = [_met(family, replace(begun, tangent=way), longest_step) for way in ways]
    for met in chain.from_iterable(zip_longest(*sides, fillvalue=())):
        for one in met:
            if one.kind == kind:
                periods, count = solution.subharmonic, begun.iterations
                return one.value, orbit_from(flow, one.value, one.state, periods, count)
    raise ConvergenceError(
        f"refinement: no {kind.replace('_', ' ')} of exact orbits within "
        f"{100.0 * reach:g} % of {omega:g} rad/s"
    )


def _orbit_next_to(family: OrbitFamily, start: np.ndarray, parameter: float) -> PathPoint | None:
    """The orbit next to a motion, across the curve, as beside a fold there may be none at its own
    frequency; None where it is farther away than half its size."""
    try:
        ahead = tangent_of(family, start, family.linearise(start, parameter))
        found = solve_in_plane(
            family, start, parameter, ahead,
            tolerance=CLOSE, iterations=FULL_STEPS, least_damping=LEAST_STEP,
        )  # fmt: skip
    except ConvergenceError:  # pairs chatter without end
        return None
    if found is None or not np.linalg.norm(found.unknown - start) <= 0.5 * np.linalg.norm(start):
        return None
    assert found.at is not None
    return replace(found, tangent=tangent_of(family, found.unknown, found.at))


def _met(
    family: OrbitFamily, begun: PathPoint, longest_step: float
) -> Iterator[tuple[OrbitBifurcation, ...]]:
    """Bifurcations between the points of the curve from an orbit along its tangent, until it leaves
    the family's range."""
    value = family.value(begun.parameter)
    path = OrbitPath(
        family, family.state(begun.unknown, value), longest_step=longest_step,
        most_points=PathOptions.max_steps, turning_back=0.0, value=value, towards=begun.tangent,
        branch=True,
    )  # fmt: skip
    try:
        for point in path:
            yield point.bifurcations
    except ConvergenceError:  # pairs chatter without end
        return
