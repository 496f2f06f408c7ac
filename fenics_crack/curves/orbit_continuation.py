"""Curves of exact periodic orbits that grow point by point.

A path (:mod:`growing`) of the equations of :class:`fenics_crack.curves.orbit_family.OrbitFamily`.
Newton's method forms the monodromy matrix of each point for its tangent: multipliers, steps that
resolve them, and all bifurcations (:mod:`orbit_events`) cost its eigenvalues. A curve begins at an
orbit that harmonic balance with few harmonics leads to, at a given one, or on a branch that leaves
another curve.
"""

from __future__ import annotations

from typing import Any, Unpack

import numpy as np

from fenics_crack.balance.harmonic_balance import check_initial, initial_orbit
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import TOLERANCE, ConvergenceError, check_number
from fenics_crack.curves.curve import Bifurcation, leading
from fenics_crack.curves.family import FAMILIES
from fenics_crack.curves.growing import Growing, Steps, check_range, chord, points_of
from fenics_crack.curves.orbit_curve import MIN_HARMONICS, OrbitCurve
from fenics_crack.curves.orbit_events import MultiplierControl, NeimarkSacker, PeriodDoubling
from fenics_crack.curves.orbit_family import OrbitFamily
from fenics_crack.motion.flow import flow_of
from fenics_crack.motion.orbit import FORMED, PeriodicOrbit, too_slow
from fenics_crack.numerics.path import BranchPoint, Fold

Beginning = PeriodicSolution | PeriodicOrbit | tuple[OrbitCurve, Bifurcation]
"""Possible beginnings of a curve of exact orbits."""


def has_orbits(problem: Problem, parameter: str, start: float, end: float) -> bool:
    """True if exact orbits can be followed along a parameter: a small structure has a flow, of so
    few modes that the monodromy matrix is formed, and the load is not too slow."""
    check_range(problem, parameter, start, end)
    flow = flow_of(problem.structure, problem.contact)
    if flow is None or flow.count > FORMED:
        return False
    ends = [FAMILIES[parameter].vary(problem, value).omega for value in (start, end)]
    return not any(too_slow(flow, omega, problem.subharmonic) for omega in ends)


class OrbitContinuation(Growing):
    """A curve of exact orbits that grows: as :class:`fenics_crack.Continuation`.

    Parameters
    ----------
    problem, parameter, start, end, longest_step, most_points, turning_back
        As of :class:`fenics_crack.Continuation`; the problem's harmonics play no part.
    initial : PeriodicSolution, PeriodicOrbit or (OrbitCurve, Bifurcation), optional
        Where to start, likewise; or at an orbit at ``start``.
    tolerance : float, optional
        As of :class:`OrbitCurve`; default: that of ``initial``, or 0.01.

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
        initial: Beginning | None = None,
        tolerance: float | None = None,
        **steps: Unpack[Steps],
    ) -> None:
        if tolerance is None:
            tolerance = initial[0].tolerance if isinstance(initial, tuple) else TOLERANCE
        check_number("tolerance", tolerance, 0.0, above=True)
        problem = problem.with_harmonics(problem.few_harmonics(MIN_HARMONICS))
        super().__init__(problem, parameter, start, end, **steps)
        self._tolerance = tolerance
        self._family = family = OrbitFamily(self._problem, parameter, start, end)
        self._control = MultiplierControl(self._longest)
        if isinstance(initial, tuple):
            curve, at = initial
            # J is singular: the old branch goes on as its points on both sides do.
            around = np.clip(curve.nearest(at) + np.array([-1, 1]), 0, len(curve) - 1).tolist()
            old = chord(family, *points_of(family, curve, around))
            [(_, unknown)] = points_of(family, at.point, [0])
            self._begin_on_branch(at.kind, at.value, unknown, old)
        else:
            orbit = _first_orbit(family.at(start), initial)
            self._begin(start, family.unknown(orbit.state, start), orbit.iterations)

    _family: OrbitFamily
    _kind, _events = OrbitCurve, (Fold, BranchPoint, PeriodDoubling, NeimarkSacker)

    @property
    def _own(self) -> dict[str, Any]:
        multipliers = np.array([leading(point.multipliers) for point in self.points])
        return {"multipliers": multipliers, "tolerance": self._tolerance}

    @property
    def _at_once(self) -> int:
        # Monodromy matrices of 8192 numbers together: those behind a rejected step are lost, and
        # of large ones few pay for the time between calls.
        return 2**13 // self._family.records


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
