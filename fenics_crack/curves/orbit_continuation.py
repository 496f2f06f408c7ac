"""Curves of exact orbits that grow point by point: where they begin, and how they go on.

The path itself is :class:`fenics_crack.curves.orbit_path.OrbitPath`. A curve begins at an orbit
that harmonic balance with few harmonics leads to, at a given one, at the last orbit of a curve
that has not reached its end, or on a branch that leaves another curve.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from fenics_crack.balance.harmonic_balance import check_initial, initial_orbit
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.curves.beginnings import UNFINISHED, across, first_aside
from fenics_crack.curves.continuation import LONGEST_STEP, checked
from fenics_crack.curves.curve import parameter_axis
from fenics_crack.curves.orbit_curve import ExactBifurcation, OrbitCurve, leading
from fenics_crack.curves.orbit_family import OrbitFamily
from fenics_crack.curves.orbit_path import (
    OrbitBifurcation,
    OrbitCurvePoint,
    OrbitPath,
    OrbitStart,
    doubled_start,
)
from fenics_crack.errors import TOLERANCE, ConvergenceError, InputError, check_number
from fenics_crack.motion.flow import flow_of
from fenics_crack.motion.orbit import FORMED, KNOWN, PeriodicOrbit, too_slow
from fenics_crack.numerics.newton import PathPoint, distance, point_on_path
from fenics_crack.numerics.path import STRAIGHT, PathOptions
from fenics_crack.table import counted, in_unit

Beginning = (
    PeriodicSolution | PeriodicOrbit | OrbitCurve | tuple[OrbitCurve, ExactBifurcation] | None
)
"""Where a curve of exact orbits may begin."""


def has_orbits(problem: Problem, *frequencies: float) -> bool:
    """True if the exact orbits of a small structure can be followed: it has a flow, of so few modes
    that the monodromy matrix is formed, and the load is not too slow at frequencies [rad/s]."""
    flow = flow_of(problem.structure, problem.contact)
    if flow is None or flow.size > FORMED:
        return False
    return not any(too_slow(flow, omega, problem.subharmonic) for omega in frequencies)


class OrbitContinuation:
    """A curve of exact orbits that grows: as :class:`fenics_crack.Continuation`.

    Parameters
    ----------
    problem, parameter, start, end, longest_step, most_points, turning_back
        As of :class:`fenics_crack.Continuation`; the problem's harmonics play no part.
    initial : PeriodicSolution, PeriodicOrbit, OrbitCurve, (OrbitCurve, ExactBifurcation), optional
        Where to start: next to a solution; at an orbit at ``start``; at the last point of a curve
        that did not reach its end, whose ``start`` is then this one's, or for a branch ``start``
        and ``end`` bound the parameter; or on the branch that begins at a bifurcation of a curve,
        likewise.
    tolerance : float, optional
        As of :class:`OrbitCurve`; default: that of ``initial``, or 0.01.

    Attributes
    ----------
    complete, returned, status
        As of :class:`fenics_crack.Continuation`.

    Raises
    ------
    InputError
        An argument cannot be used, or there is no exact flow whose orbits can be followed.
    ConvergenceError
        No first orbit.
    """

    def __init__(
        self,
        problem: Problem,
        parameter: str,
        start: float,
        end: float,
        *,
        initial: Beginning = None,
        tolerance: float | None = None,
        longest_step: float = LONGEST_STEP,
        most_points: int = 50000,
        turning_back: float = 0.1,
    ) -> None:
        if tolerance is None:
            known = initial[0] if isinstance(initial, tuple) else initial
            tolerance = known.tolerance if isinstance(known, OrbitCurve) else TOLERANCE
        check_number("tolerance", tolerance, 0.0, above=True)
        problem, turning_back = checked(
            problem, parameter, start, end, longest_step, most_points, turning_back
        )
        self._problem, self._tolerance, self._branch = problem, tolerance, False
        self._family = family = OrbitFamily(problem, parameter, start, end)
        self._known: OrbitCurve | None = None
        options: dict[str, Any] = {
            "longest_step": longest_step, "most_points": most_points, "turning_back": turning_back
        }  # fmt: skip
        if isinstance(initial, OrbitCurve):
            options |= self._resumed(initial)
        elif isinstance(initial, tuple):
            begun = _branch_start(family, *initial, longest_step)
            self._branch = True
            options |= {"state": begun.state, "value": begun.value, "towards": begun.towards}
        else:
            options["state"] = _first_orbit(family.at(start), initial).state
        self._path = OrbitPath(family, **options, branch=self._branch)

    def _resumed(self, curve: OrbitCurve) -> dict[str, Any]:
        """Where the path begins that goes on where a curve ends; InputError where it does not."""
        family, first, last = self._family, float(curve.values[0]), float(curve.values[-1])
        if curve.complete:
            raise InputError("resume", type(curve).__name__, UNFINISHED)
        same = curve.structure.n_pairs == self._problem.structure.n_pairs
        if curve.parameter != family.name or not same:
            raise InputError("resume", f"curve in {curve.parameter}", "a curve of this problem")
        span = family.start, family.end
        if curve.branch and not min(span) < last < max(span):
            raise InputError("start, end", span, f"on either side of {last:g}")
        if not curve.branch and not math.isclose(span[0], first, rel_tol=1e-9):
            raise InputError("start", span[0], f"where the resumed curve starts, {first:g}")
        state, unknown = curve.states[-1], family.unknown(curve.states[-1], last)
        if state.shape != family.shape or not (
            family.orbit(unknown, family.parameter(last)).residual <= KNOWN
        ):
            raise InputError("resume", "a curve of another problem", "of this structure and law")
        self._known, self._branch = curve.part(slice(0, -1)), curve.branch
        self._known = replace(self._known, bifurcations=curve.bifurcations)
        begun: dict[str, Any] = {"state": state, "value": last}
        if len(curve) > 1:
            ends = [(float(curve.values[k]), curve.states[k]) for k in (0, 1, -2, -1)]
            begun["towards"] = family.direction(*ends[2:])
            there = family.unknown(ends[0][1], first), family.parameter(first)
            begun["origin"] = point_on_path(family, *there, family.direction(*ends[:2]))
        return begun

    @property
    def complete(self) -> bool:
        """Whether the end was reached, or the curve closed."""
        return self._path.complete

    @property
    def returned(self) -> bool:
        """Whether the curve came back to its start, or went past it."""
        return self._path.returned

    @property
    def status(self) -> str:
        """How it ended."""
        return self._path.status

    @status.setter
    def status(self, words: str) -> None:
        self._path.status = words

    @property
    def size(self) -> int:
        """Unknowns of a point."""
        return int(np.prod(self._family.shape))

    @property
    def curve(self) -> OrbitCurve:
        """All points so far."""
        problem, points = self._problem, self._path.points
        curve = OrbitCurve(
            structure=problem.structure,
            contact=problem.contact,
            parameter=self._family.name,
            values=np.array([one.value for one in points]),
            omega=np.array([one.omega for one in points]),
            iterations=np.array([one.iterations for one in points]),
            states=np.array([one.state for one in points]),
            multipliers=np.array([leading(one.multipliers) for one in points]),
            bifurcations=(),
            complete=self.complete,
            status=self.status,
            subharmonic=problem.subharmonic,
            branch=self._branch,
            tolerance=self._tolerance,
        )
        special = tuple(
            curve.bifurcation(one.kind, one.value, one.state, one.multipliers)
            for point in points
            for one in point.bifurcations
        )
        curve = replace(curve, bifurcations=special)
        return curve if self._known is None else self._known.followed_by(curve)

    followed = curve
    """The same: exact orbits have their verdicts."""

    def progress(self) -> float:
        """How much of the way from start to end has been gone, 0 to 1."""
        return self._path.progress()

    def how_far(self) -> str:
        """The same in words, with the range and how many points there are."""
        axis = parameter_axis(self._family.name, True)
        ends = in_unit(axis, self._family.start, self._family.end)
        points = counted(len(self._path.points), "point")
        return f"{self.progress():.0%} of the way between {ends}, {points}"

    def __iter__(self) -> Iterator[OrbitCurvePoint]:
        """Yield the first point, or the last one of a resumed curve, and all that follow."""
        return iter(self._path.points[-1:] if self.complete else self._path)

    def run(self) -> None:
        """Follow to the end, many points at once."""
        if not self.complete:
            self._path.run()


def _first_orbit(
    problem: Problem, initial: PeriodicSolution | PeriodicOrbit | None
) -> PeriodicOrbit:
    """The orbit at the start of a curve."""
    if isinstance(initial, PeriodicOrbit):
        return initial
    if initial is not None:
        check_initial(problem, initial)
    search = initial_orbit(problem, initial)
    if search.orbit is None:
        raise ConvergenceError(
            f"no exact orbit at {problem.omega:g} rad/s: {search.reason}; with harmonics in place "
            "of a tolerance the curve of harmonic balance is followed"
        )
    return search.orbit


def _branch_start(
    family: OrbitFamily, curve: OrbitCurve, bifurcation: ExactBifurcation, longest_step: float
) -> OrbitStart:
    """Enter the branch of twice the period at a period doubling of a curve, or the one that crosses
    it at a branch point.

    Raises
    ------
    ConvergenceError
        No orbit of another branch is found next to it.
    """
    if bifurcation.kind == "period_doubling":
        known = bifurcation.kind, bifurcation.value, bifurcation.state, bifurcation.multipliers
        return doubled_start(family, OrbitBifurcation(*known), longest_step)
    value, parameter = bifurcation.value, family.parameter(bifurcation.value)
    unknown = family.unknown(bifurcation.state, value)
    # J is singular: the old branch goes on as its points on both sides do.
    ends = curve.part(curve.around(bifurcation))
    before, after = zip(ends.values.tolist(), ends.states, strict=True)
    old = family.direction(before, after)
    start = PathPoint(unknown, parameter, 0, across(family.linearise(unknown, parameter), old))

    def near(found: PathPoint, step: float) -> bool:
        return STRAIGHT * distance(family, start, found) < step

    found = first_aside(family, start, longest_step, PathOptions.rtol, near)
    if found is None:
        raise ConvergenceError(
            f"branch from branch_point at {family.name} = {value:g}: no orbit of another branch "
            "was found next to it"
        )
    there = family.value(found.parameter)
    state = family.state(found.unknown, there)
    towards = family.direction((value, bifurcation.state), (there, state))
    return OrbitStart(there, state, towards)
