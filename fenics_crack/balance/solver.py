"""One solution of a problem: its compliance, its equations, the search, and what was found."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fenics_crack.balance.compliance import Compliance, narrowed
from fenics_crack.balance.condensed import (
    CondensedPoint,
    CondensedSystem,
    ConstraintSystem,
    default_weight,
)
from fenics_crack.balance.coupled import CoupledPoint, CoupledSystem
from fenics_crack.balance.family import Family
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.search import Search
from fenics_crack.balance.solution import PeriodicSolution, solution_of
from fenics_crack.errors import ConvergenceError
from fenics_crack.model.contact import is_rigid
from fenics_crack.numerics.fourier import resized, stretched
from fenics_crack.numerics.linearisation import Linearisation
from fenics_crack.numerics.newton import KernelNewton

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

    def solve(self, initial: PeriodicSolution | None = None) -> PeriodicSolution:
        """Solve from a solution nearby, or from the linear one (collective)."""
        search, solution = self.attempt(initial)
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
        at: Linearisation
        with self.compliance() as compliance:
            if self.problem.residual is not None:
                problem, at = self.problem, self._coupled(search, compliance, initial)
            elif is_rigid(self.problem.contact):
                problem, at = self._constrained(search, compliance, initial)
            else:
                problem, at = self.problem, self.penalised(search, compliance, initial)
            assert isinstance(at, CondensedPoint)
            found = solution_of(problem, at, status=search.status, reported=reported)
            return search, replace(found, converged=search.converged, iterations=search.iterations)

    def solve_in_kernel(
        self, family: Family, initial: PeriodicSolution | None
    ) -> tuple[np.ndarray, int] | None:
        """The unknowns at a family's start, where this problem is its own, and the iterations that
        they took: by the same attempts, compiled, without PETSc and an error report. None where the
        kernel does not have the equations, or does not find a solution."""
        system = family.system(family.start)
        if not (isinstance(system, CondensedSystem) and system.in_kernel):
            return None
        search = Search(self.residual_tolerance, KernelNewton)
        at = self.penalised(search, system.compliance, initial)
        return (at.unknown, search.iterations) if search.converged else None

    @contextmanager
    def compliance(self) -> Iterator[Compliance]:
        """Compliance of the structure, freed afterwards (collective)."""
        found = self.problem.compliance()
        try:
            yield found
        finally:
            found.destroy()

    def start(self, initial: PeriodicSolution, name: str) -> np.ndarray:
        """Coefficients of a solution, by their name, with the harmonics of this response."""
        factor = self.problem.subharmonic // initial.subharmonic
        return resized(stretched(getattr(initial, name), factor), self.problem.harmonics)

    def _constrained(
        self, search: Search, compliance: Compliance, initial: PeriodicSolution | None
    ) -> tuple[Problem, CondensedPoint]:
        contact: Any = self.problem.contact
        weight = contact.weight or default_weight(compliance)
        system = ConstraintSystem(compliance, self.problem.harmonics, weight)
        start = None
        if initial is not None:
            start = system.from_force(self.start(initial, "force_coefficients"))
        at = search.constraint(system, start)
        assert isinstance(at, CondensedPoint)
        return replace(self.problem, contact=replace(contact, weight=weight)), at

    def _coupled(
        self, search: Search, compliance: Compliance, initial: PeriodicSolution | None
    ) -> CoupledPoint:
        """Solve for pairs that are seen through a static compliance."""
        problem = self.problem

        def with_harmonics(harmonics: int) -> CoupledSystem:
            few = problem.with_harmonics(harmonics)
            system = few.system(narrowed(compliance, harmonics))
            assert isinstance(system, CoupledSystem)
            return system

        start = None
        if initial is not None:
            assert problem.residual is not None
            start = self.start(initial, "gap_coefficients")
            start = start + self.start(initial, "force_coefficients") @ problem.residual
        at = search.coupled(with_harmonics, problem, start)
        assert isinstance(at, CoupledPoint)
        return at

    def penalised(
        self, search: Search, compliance: Compliance, initial: PeriodicSolution | None
    ) -> Linearisation:
        """Solve for a law that gives the force from the gap."""
        problem = self.problem

        def with_harmonics(harmonics: int) -> CondensedSystem:
            few = problem.with_harmonics(harmonics)
            return CondensedSystem(narrowed(compliance, harmonics), few.integrals())

        start = None if initial is None else self.start(initial, "gap_coefficients")
        return search.penalty(with_harmonics(problem.harmonics), start, problem, with_harmonics)
