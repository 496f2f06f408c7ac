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
from fenics_crack.balance.family import Family, FrequencyFamily
from fenics_crack.balance.fourier import resized, stretched
from fenics_crack.balance.newton import KernelNewton
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.search import Search
from fenics_crack.balance.solution import PeriodicSolution, solution_of
from fenics_crack.errors import ConvergenceError
from fenics_crack.model.contact import is_piecewise_linear, is_rigid
from fenics_crack.model.modal import is_small

__all__ = ["Solver"]

LADDER = 100
"""Unknowns from which a solution without a start is sought with few harmonics first."""


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
                f"H = {self.problem.harmonics}: {search.status}; try other harmonics, a softer "
                "contact, or a solution nearby as initial",
                search.history,
            )
        return solution

    def attempt(
        self, initial: PeriodicSolution | None, *, patient: bool = True, reported: bool = True
    ) -> tuple[Search, PeriodicSolution]:
        """The same, whether or not it converged, and the record of the search; its errors are
        estimated unless they are not asked for."""
        search = Search(self.residual_tolerance, patient=patient)
        at: CondensedPoint
        with self.compliance() as compliance:
            if self.problem.residual is not None:
                problem, at = self.problem, self._coupled(search, compliance, initial)
            elif is_rigid(self.problem.contact):
                problem, at = self._constrained(search, compliance, initial)
            else:
                problem, at = self.problem, self.penalised(search, compliance, initial)
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
        search = Search(self.residual_tolerance, newton=KernelNewton)
        start, kept = None, None
        if initial is not None:
            start = self.start(initial, "gap_coefficients")
        elif system.global_size > LADDER:
            start, kept = self._climb(search, system.compliance, self.problem)
        found = search.penalty(system, system.linear if start is None else start, kept=kept)
        return (found.unknown, search.iterations) if search.converged else None

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
            fewer = problem if harmonics == problem.harmonics else problem.with_harmonics(harmonics)
            system = fewer.system(narrowed(compliance, harmonics))
            assert isinstance(system, CoupledSystem)
            return system

        def family_from(factor: float) -> FrequencyFamily:
            same = replace(problem, static_above=problem.cutoff)
            return FrequencyFamily(same, factor * problem.omega, problem.omega)

        start = None
        if initial is not None:
            assert problem.residual is not None
            start = self.start(initial, "gap_coefficients")
            start = start + self.start(initial, "force_coefficients") @ problem.residual
        at = search.coupled(with_harmonics, problem, start, family_from)
        assert isinstance(at, CoupledPoint)
        return at

    def penalised(
        self, search: Search, compliance: Compliance, initial: PeriodicSolution | None
    ) -> CondensedPoint:
        """Solve for a law that gives the force from the gap."""
        start, kept = None, None
        if initial is not None:
            start = self.start(initial, "gap_coefficients")
            alike = initial.omega == self.problem.omega and initial.contact is self.problem.contact
            fewer = initial.harmonics * self.problem.subharmonic // initial.subharmonic
            kept = fewer if alike and fewer < self.problem.harmonics else None
        return self._by_harmonics(search, compliance, self.problem, start, kept)

    def _by_harmonics(
        self,
        search: Search,
        compliance: Compliance,
        problem: Problem,
        start: np.ndarray | None,
        kept: int | None = None,
    ) -> CondensedPoint:
        """The same; without a start, and with many unknowns, with few harmonics first."""
        harmonics, name = problem.harmonics, "full Newton steps"
        system = CondensedSystem(narrowed(compliance, harmonics), problem.integrals())
        if start is None and system.global_size > LADDER:
            start, kept = self._climb(search, compliance, problem)
            if kept is not None:
                name = f"from H = {kept} to {harmonics}"

        def family_from(factor: float) -> FrequencyFamily:
            return FrequencyFamily(problem, factor * problem.omega, problem.omega)

        small = is_small(problem.structure)
        marched = problem if small and is_piecewise_linear(problem.contact) else None
        ways = family_from if small else None
        begin = system.linear if start is None else start
        at = search.penalty(system, begin, ways, name, marched, kept)
        if search.converged or not marched or not search.patient:
            assert isinstance(at, CondensedPoint)
            return at
        fewer, half = None, harmonics // 2
        if (kept is None or kept < half) and half >= problem.subharmonic:
            below = self._by_harmonics(search, compliance, problem.with_harmonics(half), None)
            fewer = resized(below.gap, harmonics) if search.converged else None
        if fewer is not None or harmonics == self.problem.harmonics:
            at = search.last_resort(system, fewer, half, marched)
        assert isinstance(at, CondensedPoint)
        return at

    @staticmethod
    def _climb(
        search: Search, compliance: Compliance, problem: Problem
    ) -> tuple[np.ndarray | None, int | None]:
        """The solution with half the harmonics, which comes from that with half of those, and so
        on: its gap with all harmonics, and how many of them it has. Where one is not found, that
        with the most harmonics that is; None where there is none."""
        found, kept = None, None
        rungs = [(problem.harmonics + 1) // 2]
        while rungs[-1] > problem.subharmonic:
            rungs.append(max((rungs[-1] + 1) // 2, problem.subharmonic))
        for harmonics in reversed(rungs):
            few = problem.with_harmonics(harmonics)
            system = CondensedSystem(narrowed(compliance, harmonics), few.integrals())
            there = search.rung(system, None if found is None else resized(found, harmonics), kept)
            if there is not None:
                found, kept = there, harmonics
        return None if found is None else resized(found, problem.harmonics), kept
