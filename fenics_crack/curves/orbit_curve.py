"""Response curves of exact orbits: states at phase zero, and everything that follows from them.

A point is the state z = (q, q') at phase zero of the load, in the modes of the structure as the
parameter varies it; the motion over its period is followed anew wherever more is requested.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from fenics_crack.balance.harmonic_balance import solution_of_orbit, wave_of
from fenics_crack.balance.problem import Problem, least_harmonics
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.curves.curve import PARTS, ResponseCurve
from fenics_crack.motion.flow import ContactFlow, exact_flow
from fenics_crack.motion.motions import Record
from fenics_crack.motion.orbit import HARMONICS, KNOWN, PeriodicOrbit, orbit_from
from fenics_crack.motion.search import SearchOptions

MIN_HARMONICS = SearchOptions.harmonics[0]
"""Minimum harmonics of the load's frequency in a solution."""
RESOLUTION = 0.1
"""Width of a window that may be missed, over the longest step: steps are judged by an interpolation
between their ends, which is not right where orbits graze, or several multipliers meet in one."""


@dataclass(frozen=True, repr=False, kw_only=True)
class OrbitCurve(ResponseCurve):
    """Exact orbits along a curve.

    Attributes
    ----------
    structure, contact, parameter, values, omega, iterations, bifurcations, complete, status,
    subharmonic, multipliers, branch
        As of any :class:`ResponseCurve`.
    states : (n, 2 n_modes)
        Modal displacements and velocities at phase zero, in the modes of the structure as the
        parameter varies it.
    tolerance : float
        Error to which :meth:`solution` keeps an orbit's Fourier coefficients.
    resolution : float
        Width, in the unit of ``values``, of the unstable or doubled windows that the curve may
        miss between its points: a tenth of the longest step taken.
    """

    states: np.ndarray
    multipliers: np.ndarray
    tolerance: float

    EXACT, FOUND = True, "states"

    @property
    def method(self) -> str:
        return "exact orbits"

    @cached_property
    def problem(self) -> Problem:
        """Problem solved at the first point; its harmonics are the fewest of a solution."""
        omega = float(self.omega[0])
        fewest = MIN_HARMONICS * self.subharmonic
        least = max(fewest, least_harmonics(self._structure, self.subharmonic))
        return Problem(self._structure, omega, self.contact, least, subharmonic=self.subharmonic)

    @cached_property
    def _flow(self) -> ContactFlow:
        return exact_flow(self.structure, self.contact)

    def flow(self, value: float) -> ContactFlow:
        """The exact flow where the parameter has a value."""
        if self.parameter == "omega":
            return self._flow
        problem = self.problem_at(value)
        return exact_flow(problem.structure, problem.contact)

    def orbit(self, index: int) -> PeriodicOrbit:
        flow, omega = self.flow(float(self.values[index])), float(self.omega[index])
        iterations = int(self.iterations[index])
        return orbit_from(flow, omega, self.states[index], self.subharmonic, iterations)

    def solution(self, index: int, *, search: bool = True) -> PeriodicSolution:
        """Fourier series of the orbit at a point, as long as the tolerance requires, with its error
        report; nothing is searched for."""
        return solution_of_orbit(self.problem_of(index), self.orbit(index), self.tolerance)

    def _displacement_error(self, index: int) -> float:
        orbit, problem = self.orbit(index), self.problem_of(index)
        found = wave_of(problem, orbit, orbit.coefficients(problem.harmonics))
        more = found.assessment.more_modes
        errors = None if more is None else more.errors
        return super()._displacement_error(index) if errors is None else errors[1]

    @property
    def undecided(self) -> np.ndarray:
        """Points whose largest multiplier is on the unit circle to its accuracy: (n,) bool."""
        return np.asarray(np.abs(np.abs(self.multipliers) - 1.0) <= KNOWN)

    def reason(self, index: int) -> str:
        return "its largest multiplier is 1 to its accuracy" if self.undecided[index] else ""

    @property
    def resolution(self) -> float:
        """Width of the windows that the curve may miss between its points."""
        return RESOLUTION * float(np.abs(np.diff(self.values)).max(initial=0.0))

    @cached_property
    def gap_coefficients(self) -> np.ndarray:
        """Closing of the pairs, by the exact integrals of the orbits, with 40 harmonics of their
        period: (n, 81, n_pairs) [m]."""
        orbits = (self.orbit(index) for index in range(len(self)))
        count = self.structure.n_pairs
        return np.array([one.coefficients(HARMONICS).gap[:, :count] for one in orbits])

    def records(self, rows: np.ndarray) -> Iterator[Record]:
        for index in range(len(self)):
            [record] = self.orbit(index).records(rows, len(PARTS))
            yield replace(record, exact={}, structure=partial(self._structure_of, index))
