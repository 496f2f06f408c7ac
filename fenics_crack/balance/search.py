"""Attempts to converge, the cheapest first, each on record.

1. Full Newton steps from the given start.
2. A path in the contact stiffness k. Where k R is small the solution is unique and close to the
   linear one; from there the path of solutions is followed by arc-length, through its folds. It
   cannot come back to soft contact, so as long as solutions stay bounded it reaches every
   stiffness.
3. A path in the frequency, where a small or reduced structure makes it cheap: from the nearest
   frequency at which full steps converge.

Without penetration at all, attempts 1 and 2 lead to the contact force of a stiff penalty, from
which full steps start; where these fail, solutions are followed from a soft penalty to the
constraint (:class:`ConstraintSystem`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from fenics_crack.balance.arclength import ParametricSystem, follow_path
from fenics_crack.balance.block import BlockSystem
from fenics_crack.balance.condensed import CondensedSystem, ConstraintSystem
from fenics_crack.balance.contact_integrals import ExactIntegrals
from fenics_crack.balance.family import FrequencyFamily
from fenics_crack.balance.newton import Newton, System
from fenics_crack.balance.rounding import (
    EPSILON,
    MOST_ROUNDING,
    ROUNDING,
    stiffness_times_compliance,
)
from fenics_crack.errors import InputError
from fenics_crack.model.contact import ContactLaw, UnilateralPenalty

__all__ = [
    "Search",
]

SOFT = 0.05
"""k R where the path in the stiffness starts."""
FAR = 5.0
"""A path is given up that far from its end, unless it began farther away."""
STIFF = 10.0
"""k / eps of the penalty from which full steps to the constraint start."""
NEARBY = (1.02, 0.98, 1.1, 0.9, 1.3, 0.75, 2.0, 0.5)
"""Frequencies, relative to the one wanted, from which a path in the frequency may start."""


@dataclass
class Search:
    """The record of the attempts at one solution.

    Attributes
    ----------
    tolerance : float
        |F| / |x| at which a solution is accepted; raised to what rounding lets be reached.
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
    _rounding: float = ROUNDING

    @property
    def status(self) -> str:
        """The attempts in words."""
        return "; then ".join(self.attempts)

    def penalty(
        self,
        system: CondensedSystem | BlockSystem,
        start: np.ndarray,
        family_from: Callable[[float], FrequencyFamily] | None = None,
    ) -> np.ndarray:
        """Solve for a law that gives the force from the gap.

        ``family_from`` makes the family of the same equations from a relative frequency to 1.
        A gap rounded to eps |g| makes a force rounded to eps k |g|: no residual is asked to be
        smaller than that.
        """
        law = system.integrals.law
        stiffest = float(np.max(law.stiffness))
        static = float(np.abs(system.compliance.matrices[0]).sum(axis=1).max())
        if not EPSILON * stiffest * static < MOST_ROUNDING:
            raise InputError(
                "contact stiffness",
                stiffest,
                f"at most {MOST_ROUNDING / (EPSILON * static):.2g} N/m on this structure, beyond "
                "which rounding leaves nothing; UnilateralConstraint is the limit",
            )
        # In an undamped resonance R itself may be as large as that.
        least = min(MOST_ROUNDING, EPSILON * stiffness_times_compliance(system, law))
        if least > self._rounding:
            self._rounding = least
            self.tolerance = max(self.tolerance, least)
        found = self._newton(system, start, 20, "full Newton steps")
        if not self.converged:
            found = self._stiffness_path(system)
        if not self.converged and family_from is not None:
            found = self._frequency_path(family_from)
        return found

    def constraint(self, system: ConstraintSystem, start: np.ndarray | None) -> np.ndarray:
        """Solve without penetration."""
        if start is not None:
            found = self._newton(system, start, 20, "full Newton steps")
            if self.converged:
                return found
        harmonics = system.integrals.harmonics
        penalty = CondensedSystem(
            system.compliance, ExactIntegrals(UnilateralPenalty(STIFF * system.weight), harmonics)
        )
        known = self.tolerance, self._rounding
        gap = self.penalty(penalty, penalty.linear)
        self.tolerance, self._rounding = known  # only the penalty is rounded like that
        found = system.from_force(penalty.gap_and_force(gap)[1])
        if self.converged:
            found = self._newton(system, found, 30, "constraint from penalty")
            if self.converged:
                return found
        penalty.with_law(UnilateralPenalty(system.weight))
        gap = self.penalty(penalty, penalty.linear)
        self.tolerance, self._rounding = known
        found = system.from_force(penalty.gap_and_force(gap)[1])
        if not self.converged:
            return found
        return self._path(
            "from penalty to constraint", system, lambda: system, found, 0.0, 1.0, 0.1, 0.3
        )

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
        if name:
            self._note(name, f"{count} iterations")
        return found

    def _note(self, attempt: str, details: str) -> None:
        outcome = "converged" if self.converged else "failed"
        self.attempts.append(f"{attempt}: {outcome} ({details})")

    def _stiffness_path(self, system: CondensedSystem | BlockSystem) -> np.ndarray:
        name = "in the contact stiffness"
        law = system.integrals.law
        path = _StiffnessPath(system, law)
        soft = min(0.0, float(np.log(SOFT / stiffness_times_compliance(system, law))))
        path.set_parameter(soft)
        found = self._newton(system, system.linear, 20, "")
        if self.converged and soft < 0.0:
            return self._path(name, path, lambda: system, found, soft, 0.0, 1.0, 2.0)
        path.set_parameter(0.0)
        self._note(f"path {name}", f"its start at {np.exp(soft):.2g} of the stiffness")
        return found

    def _frequency_path(self, family_from: Callable[[float], FrequencyFamily]) -> np.ndarray:
        for factor in NEARBY:
            name = f"{factor:g} of the frequency"
            family = family_from(factor)
            found = self._newton(family.system, family.system.linear, 20, "")
            if self.converged:
                there = partial(getattr, family, "system")
                found = self._path(f"from {name}", family, there, found, 0.0, 1.0, 0.1, 0.3, 200)
                if self.converged:
                    return found
        self._note("path in the frequency", "from 0.5 to 2 of it")
        return found

    def _path(
        self,
        name: str,
        path: ParametricSystem,
        at_end: Callable[[], System],
        start: np.ndarray,
        parameter: float,
        end: float,
        step: float,
        longest_step: float,
        most_steps: int = 1000,
    ) -> np.ndarray:
        """Follow a path until Newton's method lands at the end, from either side."""
        found, steps, last = start, 0, (start, parameter)
        self.converged = False
        for point in follow_path(
            path,
            start,
            parameter,
            step=step,
            longest_step=longest_step,
            most_steps=most_steps,
            rounding=self._rounding,
        ):
            steps += 1
            self.iterations += point.iterations
            if max(point.parameter, last[1]) >= end:
                path.set_parameter(end)
                share = (end - last[1]) / (point.parameter - last[1])
                between = last[0] + share * (point.unknown - last[0])
                # Where the path bends between the two, one of them may be nearer than the chord.
                for nearby in (between, last[0], point.unknown):
                    found = self._newton(at_end(), nearby, 20, "")
                    if self.converged:
                        break
            if self.converged or abs(point.parameter - end) > max(FAR, end - parameter):
                break
            last = (point.unknown, point.parameter)
        path.set_parameter(end)
        self._note(f"path {name}", f"{steps} steps, {last[1]:.3g} of {parameter:.3g} to {end:g}")
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

    def set_parameter(self, parameter: float) -> None:
        """Set ln (k / k wanted)."""
        if parameter != self._parameter:
            self._system.with_law(self._law.scaled(float(np.exp(parameter))))
            self._parameter = parameter
