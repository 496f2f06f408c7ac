"""Attempts to converge, the cheapest first, each on record.

1. Full Newton steps from the given start.
2. A path in the contact stiffness k. Where k R is small the solution is unique and close to the
   linear one; from there the path of solutions is followed by arc-length, through its folds. It
   cannot come back to soft contact, so as long as solutions stay bounded it reaches every
   stiffness.

Without penetration at all, path 2 leads to a stiff penalty, whose contact force starts the
constraint.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fenics_crack.arclength import PathPoint, follow_path
from fenics_crack.block import BlockSystem
from fenics_crack.condensed import CondensedSystem, ConstraintSystem
from fenics_crack.contact import ContactLaw, UnilateralPenalty
from fenics_crack.contact_integrals import ExactIntegrals
from fenics_crack.newton import Newton, System

__all__ = ["Search"]

SOFT = 0.05
"""k R where the path in the stiffness starts."""
STIFF = 10.0
"""k / eps of the penalty from which the constraint starts; then ten times that, and so on."""


@dataclass
class Search:
    """The record of the attempts at one solution.

    Attributes
    ----------
    tolerance : float
        |F| / |x| at which a solution is accepted.
    converged : bool
        Whether the last attempt met it.
    iterations : int
        Newton iterations, all attempts together.
    history : list of float
        |F| of every Newton iteration.
    attempts : list of str
        What was tried and how it ended.
    """

    tolerance: float
    converged: bool = False
    iterations: int = 0
    history: list[float] = field(default_factory=list)
    attempts: list[str] = field(default_factory=list)

    @property
    def status(self) -> str:
        """The attempts in words."""
        return "; then ".join(self.attempts)

    def penalty(self, system: CondensedSystem | BlockSystem, start: np.ndarray) -> np.ndarray:
        """Solve for a law that gives the force from the gap."""
        found = self._newton(system, start, 20, "full Newton steps")
        return found if self.converged else self._stiffness_path(system)

    def constraint(self, system: ConstraintSystem, start: np.ndarray | None) -> np.ndarray:
        """Solve without penetration, starting from ever stiffer penalties."""
        if start is not None:
            found = self._newton(system, start, 20, "full Newton steps")
            if self.converged:
                return found
        harmonics = system.integrals.harmonics
        penalty = CondensedSystem(
            system.compliance, ExactIntegrals(UnilateralPenalty(STIFF * system.weight), harmonics)
        )
        gap = penalty.linear
        found = system.from_force(np.zeros_like(gap))
        for _ in range(4):
            gap = self.penalty(penalty, gap)
            if not self.converged:
                break
            force = penalty.gap_and_force(gap)[1]
            found = self._newton(system, system.from_force(force), 30, "constraint from penalty")
            if self.converged:
                break
            penalty.with_law(penalty.integrals.law.scaled(10.0))
        return found

    def _newton(
        self, system: System, start: np.ndarray, most_iterations: int, name: str
    ) -> np.ndarray:
        newton = Newton(system, self.tolerance)
        try:
            found, self.converged, count = newton.solve(start, most_iterations)
        finally:
            self.history += newton.history
            newton.free()
        self.iterations += count
        self._note(name, f"{count} iterations")
        return found

    def _note(self, attempt: str, details: str) -> None:
        outcome = "converged" if self.converged else "failed"
        self.attempts.append(f"{attempt}: {outcome} ({details})")

    def _stiffness_path(self, system: CondensedSystem | BlockSystem) -> np.ndarray:
        law = system.integrals.law
        path = _StiffnessPath(system, law)
        newton = Newton(system, self.tolerance)
        steps = 0
        try:
            soft = min(0.0, float(np.log(SOFT / path.stiffness_times_compliance)))
            path.set_parameter(soft)
            found, self.converged, count = newton.solve(system.linear, 20)
            self.iterations += count
            last = (found, soft)
            if self.converged and soft < 0.0:
                self.converged = False
                for point in follow_path(path, found, soft, step=1.0, longest_step=2.0):
                    steps += 1
                    self.iterations += point.iterations
                    if point.parameter >= 0.0:
                        found = self._land(path, newton, last, point)
                        if self.converged:
                            break
                    last = (point.unknown, point.parameter)
        finally:
            path.set_parameter(0.0)
            self.history += newton.history
            newton.free()
        end = "" if self.converged else f", last at {np.exp(last[1]):.2g} of the stiffness"
        self._note("path in the contact stiffness", f"{steps} steps{end}")
        return found

    def _land(
        self,
        path: _StiffnessPath,
        newton: Newton,
        before: tuple[np.ndarray, float],
        after: PathPoint,
    ) -> np.ndarray:
        """Solve at the full stiffness, from between two points of the path."""
        unknown, parameter = before
        share = parameter / (parameter - after.parameter)
        between = unknown + share * (after.unknown - unknown)
        path.set_parameter(0.0)
        found, self.converged, count = newton.solve(between, 20)
        self.iterations += count
        return found


class _StiffnessPath:
    """A system whose parameter is ln of the contact stiffness relative to the wanted one."""

    def __init__(self, system: CondensedSystem | BlockSystem, law: ContactLaw) -> None:
        self._system = system
        self._law = law
        self._parameter = 0.0
        self.residual = system.residual
        self.linearise = system.linearise
        self.solve_jacobian = system.solve_jacobian
        self.parameter_derivative = system.stiffness_derivative
        self.determinant_sign = system.determinant_sign
        self.inner = system.inner

    @property
    def stiffness_times_compliance(self) -> float:
        """Largest k R over the harmonics."""
        largest = np.abs(self._system.compliance.matrices).sum(axis=2).max()
        return float(largest * np.max(self._law.stiffness))

    def set_parameter(self, parameter: float) -> None:
        """Set ln (k / k wanted)."""
        if parameter != self._parameter:
            self._system.with_law(self._law.scaled(float(np.exp(parameter))))
            self._parameter = parameter
