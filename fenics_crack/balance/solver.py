"""One solution of a problem: its compliance, its equations, the search, and what was found."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache

from fenics_crack.balance.compliance import Compliance, ResizedCompliance
from fenics_crack.balance.contact_system import ContactPoint, ContactSystem
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.search import Search
from fenics_crack.balance.solution import PeriodicSolution, solution_of
from fenics_crack.errors import ConvergenceError

__all__ = ["Solver"]

HURRIED = 0.25
"""Of a search's iterations, where other ways are left."""


@dataclass(frozen=True)
class Solver:
    """How a problem is solved."""

    problem: Problem
    residual_tolerance: float = 1e-10
    """|F| / |x| at which a solution is accepted."""
    throw: bool = True
    """Raise ConvergenceError if nothing converged; else return the last iterate."""
    enough: float = math.inf
    """Truncation error above which no other is estimated."""

    def solve(
        self, initial: PeriodicSolution | None = None, *, reported: bool = True
    ) -> PeriodicSolution:
        """Solve from a solution nearby, or from the linear one (collective)."""
        search, solution = self.attempt(initial, reported=reported)
        if self.throw and not search.converged:
            raise ConvergenceError(
                f"harmonic balance at {self.problem.omega:g} rad/s, "
                f"H = {self.problem.harmonics}: {search.status}",
                search.history,
            )
        return solution

    def attempt(
        self, initial: PeriodicSolution | None, *, patient: bool = True, reported: bool = True
    ) -> tuple[Search, PeriodicSolution]:
        """The same, whether or not it converged, and the record of the search; its errors are
        estimated unless they are not asked for."""
        search = Search(self.residual_tolerance, share=1.0 if patient else HURRIED)
        with self.compliance() as compliance:
            problem = self.problem.weighted(compliance)
            at = replace(self, problem=problem).find(search, compliance, initial)
            found = solution_of(
                problem, at, status=search.status, converged=search.converged, enough=self.enough,
                reported=reported, orbit=search.orbit,
            )  # fmt: skip
            return search, replace(found, iterations=search.iterations)

    @contextmanager
    def compliance(self) -> Iterator[Compliance]:
        """Compliance of the structure, freed afterwards (collective)."""
        found = self.problem.compliance()
        try:
            yield found
        finally:
            found.destroy()

    def find(
        self, search: Search, compliance: Compliance, initial: PeriodicSolution | None
    ) -> ContactPoint:
        """The equations where a search arrives."""
        problem, start = self.problem, None

        @cache
        def with_harmonics(harmonics: int) -> ContactSystem:
            few = ResizedCompliance(compliance, harmonics)
            return problem.with_harmonics(harmonics).system(few)

        system = with_harmonics(problem.harmonics)
        if initial is not None:
            start = system.unknown(initial, problem.subharmonic // initial.subharmonic)
        at = (
            search.penalty(system, start, problem, with_harmonics)
            if system.residual is None
            else search.coupled(with_harmonics, problem, start)
        )
        # The kernel's points do not know the forces.
        return at if isinstance(at, ContactPoint) else system.linearise(at.unknown)
