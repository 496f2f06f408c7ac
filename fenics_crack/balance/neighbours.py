"""Solutions of alike problems one after the other, each from the one before.

Where two problems differ in the frequency alone, the family of one serves the other: the modes, the
load in them and the compiled equations are made once. A solution g(w) is predicted along the
tangent at its neighbour,

    g(w + dw) = g(w) + dw dg/dw,        J dg/dw = -F_w,

and corrected by Newton's method at its own frequency, in the kernel where that has the equations;
where this fails, a path in the frequency leads from one to the other. Problems that differ
otherwise start from the neighbour as it is. Where the neighbour does not help, a solution is sought
without it (:mod:`search`).

With a tolerance of the truncation, a solution has as many harmonics as its neighbour, and then as
many more as its estimated error asks for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from fenics_crack.balance.family import FrequencyFamily
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution, Solver, solution_of
from fenics_crack.errors import MOST_HARMONICS, ConvergenceError
from fenics_crack.model.modal import all_modes
from fenics_crack.numerics.bordered import MAX_ITERATIONS, point_on_path, solve_at
from fenics_crack.numerics.path import SHARP, Ended, Path, PathOptions, Target

__all__ = ["Neighbours", "fewer_harmonics", "more_harmonics"]

WAY = PathOptions(0.1, max_step=0.3, max_steps=200)
"""From one frequency to the other; what takes more is sought without a neighbour."""
SMALL = 0.05
"""Part of a tolerance below which an error allows fewer harmonics."""


def more_harmonics(
    count: int, truncation: float, tolerance: float | None, most: int = MOST_HARMONICS
) -> int | None:
    """As many harmonics as an error that falls like H^-3 asks for; None where these are enough, or
    the most."""
    if tolerance is None or truncation <= tolerance or count >= most:
        return None
    factor = min(2.0, 1.1 * (truncation / tolerance) ** (1.0 / 3.0))
    return min(most, math.ceil(factor * count))


def fewer_harmonics(count: int, truncation: float, tolerance: float, least: int) -> int:
    """As many harmonics as a neighbour's error allows to begin with."""
    return max(least, math.floor(0.8 * count)) if truncation < SMALL * tolerance else count


@dataclass
class Neighbours:
    """Solves problems one after the other.

    Parameters
    ----------
    tolerance : float, optional
        Raise and lower H from one solution to the next so that the estimated truncation error stays
        below this, between the problem's ``harmonics`` and 100.
    """

    tolerance: float | None = None
    _last: PeriodicSolution | None = None
    _family: FrequencyFamily | None = None

    def solve(self, problem: Problem) -> PeriodicSolution:
        """Solve a problem of a small structure.

        Raises
        ------
        InputError
            The contact is so stiff that rounding leaves nothing of its force.
        ConvergenceError
            There is no solution, or not to the tolerance; the next problem has no neighbour.
        """
        last, self._last = self._last, None
        least, tolerance = problem.harmonics, self.tolerance
        if tolerance is not None and last is not None:
            fewer = fewer_harmonics(last.harmonics, last.report.truncation, tolerance, least)
            problem = problem.with_harmonics(fewer)
        found = self._from(problem, last)
        while (more := more_harmonics(problem.harmonics, _error(found), tolerance)) is not None:
            problem = problem.with_harmonics(more)
            found = self._from(problem, found)
        if tolerance is not None and _error(found) > tolerance:
            raise ConvergenceError(
                f"harmonic balance at {problem.omega:g} rad/s: the estimated truncation error, "
                f"{_error(found):.1e} with H = {problem.harmonics}, stays above {tolerance:g}"
            )
        self._last = found
        return found

    def _from(self, problem: Problem, last: PeriodicSolution | None) -> PeriodicSolution:
        """Solve from another solution."""
        if last is not None:
            alike = last.structure is problem.structure and last.contact is problem.contact
            if alike and last.omega != problem.omega and _can_be_followed(problem):
                found = self._along_frequency(problem, last)
            else:
                found = self._solver(problem).attempt(last)[1]
            if found is not None and found.converged:
                return found
        return self._solver(problem).solve()

    @property
    def _enough(self) -> float:
        """Truncation error with which a solution has too few harmonics."""
        return math.inf if self.tolerance is None else self.tolerance

    def _solver(self, problem: Problem) -> Solver:
        return Solver(problem, enough=self._enough)

    def _along_frequency(self, problem: Problem, last: PeriodicSolution) -> PeriodicSolution | None:
        """Solve from another frequency; None where that does not lead there."""
        family = self._family_of(problem, last)
        start, omega = family.system(last.omega).unknown(last), problem.omega
        near, end = family.parameter(last.omega), family.parameter(omega)
        sharp = max(SHARP, family.rounding(end))
        at = (family.compiled or family).linearise(start, near)
        guess = start - (end - near) * at.solve(at.by_parameter)
        found = solve_at(family, guess, end, tolerance=sharp, iterations=MAX_ITERATIONS)
        if found is not None:
            unknown, iterations = found.unknown, found.iterations
            status = f"from {last.omega:g} rad/s: converged ({iterations} iterations)"
        else:
            way = FrequencyFamily(family.problem, last.omega, omega)
            path = Path(way, point_on_path(way, start, 0.0), WAY, [Target(1.0)])
            iterations = sum(point.iterations for point in path.points())
            if path.ended is not Ended.MET:
                return None
            unknown = path.last.unknown
            status = f"path from {last.omega:g} rad/s: converged ({iterations} iterations)"
        at = family.system(omega).linearise(unknown)
        solution = solution_of(problem, at, status=status, enough=self._enough)
        return replace(solution, iterations=iterations)

    def _family_of(self, problem: Problem, last: PeriodicSolution) -> FrequencyFamily:
        """The equations along the frequency, those of the case before where they are the same."""
        above = np.inf if problem.residual is None else problem.cutoff
        known = self._family
        if known is not None:
            kept = known.problem
            same = kept.structure is problem.structure and kept.contact is problem.contact
            sizes = (kept.harmonics, kept.samples, kept.static_above)
            if same and sizes == (problem.harmonics, problem.samples, above):
                return known
        settled = replace(problem, static_above=above)
        self._family = FrequencyFamily(settled, last.omega, problem.omega)
        return self._family


def _error(solution: PeriodicSolution) -> float:
    """Estimated truncation error, infinite where it is unknown."""
    found = solution.report.truncation
    return found if math.isfinite(found) else math.inf


def _can_be_followed(problem: Problem) -> bool:
    """Whether the problem belongs to a family along the frequency."""
    return not problem.projected and not all_modes(problem.structure).ill_conditioned
