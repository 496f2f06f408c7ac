"""One solution of a problem: its compliance, its equations, the search, and what was found."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from fenics_crack.balance.block import BlockSystem
from fenics_crack.balance.compliance import Compliance, FactoredCompliance
from fenics_crack.balance.condensed import (
    CondensedPoint,
    CondensedSystem,
    ConstraintSystem,
    default_weight,
)
from fenics_crack.balance.family import FrequencyFamily
from fenics_crack.balance.fourier import resized, stretched
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.search import Search
from fenics_crack.balance.solution import PeriodicSolution, solution_of
from fenics_crack.errors import ConvergenceError
from fenics_crack.model.contact import UnilateralConstraint, is_rigid
from fenics_crack.model.modal import is_small

__all__ = ["Solver"]


@dataclass(frozen=True)
class Solver:
    """How a problem is solved.

    Attributes
    ----------
    problem : Problem
        What is solved.
    residual_tolerance : float
        |F| / |x| at which a solution is accepted.
    throw : bool
        Raise if nothing converged; else return the last iterate.
    full : bool
        Solve for all degrees of freedom instead of the gaps: the reference.
    """

    problem: Problem
    residual_tolerance: float = 1e-10
    throw: bool = True
    full: bool = False

    def solve(self, initial: PeriodicSolution | None = None) -> PeriodicSolution:
        """Solve from a solution nearby, or from the linear one (collective).

        Raises
        ------
        ConvergenceError
            Nothing converged, and this is to be said so.
        """
        search, solution = self.attempt(initial)
        if self.throw and not search.converged:
            raise ConvergenceError(
                f"harmonic balance at {self.problem.omega:g} rad/s, "
                f"H = {self.problem.harmonics}: {search.status}; try other harmonics, a softer "
                "contact, or a solution nearby as initial",
                search.history,
            )
        return solution

    def attempt(self, initial: PeriodicSolution | None) -> tuple[Search, PeriodicSolution]:
        """The same; the search tells whether it converged."""
        search = Search(self.residual_tolerance)
        with self._compliance() as compliance:
            find = self._constrained if is_rigid(self.problem.contact) else self._penalised
            problem, at = find(search, compliance, initial)
            return search, solution_of(
                problem,
                at,
                status=search.status,
                converged=search.converged,
                iterations=search.iterations,
            )

    @contextmanager
    def _compliance(self) -> Iterator[Compliance]:
        problem = self.problem
        if self.full:
            compliance: Compliance = FactoredCompliance(
                problem.structure, problem.base_omega, problem.load
            )
        else:
            compliance = problem.compliance()
        try:
            yield compliance
        finally:
            compliance.destroy()

    def _start(self, initial: PeriodicSolution, name: str) -> np.ndarray:
        """Coefficients of a solution with the harmonics of this response."""
        factor = self.problem.subharmonic // initial.subharmonic
        return resized(stretched(getattr(initial, name), factor), self.problem.harmonics)

    def _constrained(
        self, search: Search, compliance: Compliance, initial: PeriodicSolution | None
    ) -> tuple[Problem, CondensedPoint]:
        contact = self.problem.contact
        assert isinstance(contact, UnilateralConstraint)
        weight = contact.weight or default_weight(compliance)
        system = ConstraintSystem(compliance, self.problem.harmonics, weight)
        start = None
        if initial is not None:
            start = system.from_force(self._start(initial, "force_coefficients"))
        at = search.constraint(system, start)
        assert isinstance(at, CondensedPoint)
        return replace(self.problem, contact=replace(contact, weight=weight)), at

    def _penalised(
        self, search: Search, compliance: Compliance, initial: PeriodicSolution | None
    ) -> tuple[Problem, CondensedPoint]:
        integrals = self.problem.integrals()
        system = CondensedSystem(compliance, integrals)
        if self.full:
            assert isinstance(compliance, FactoredCompliance)
            block = BlockSystem(compliance, integrals)
            start = block.linear
            if initial is not None:
                start = compliance.displacement(self._start(initial, "force_coefficients"))
            gap = block.gap(search.penalty(block, start).unknown)
            return self.problem, system.linearise(gap)
        start = system.linear
        if initial is not None:
            start = self._start(initial, "gap_coefficients")
        small = is_small(self.problem.structure)
        at = search.penalty(system, start, self._family_from if small else None)
        assert isinstance(at, CondensedPoint)
        return self.problem, at

    def _family_from(self, factor: float) -> FrequencyFamily:
        """The same equations along the frequency, from a factor of it to itself."""
        omega = self.problem.omega
        return FrequencyFamily(self.problem, factor * omega, omega)
