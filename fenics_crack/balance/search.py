"""Attempts to converge, the cheapest first, each recorded.

1. Full Newton steps from the given start, then shortened ones; without a start and with many
   unknowns, from the solution with half the harmonics, which comes from that with half of those.
2. From a start with fewer harmonics, a path in the compliance of the others
   (:class:`HigherHarmonics`).
3. A path in the contact stiffness k. Where k R is small the solution is unique and close to the
   linear one; from there the path of solutions is followed by arc-length, through its folds. It
   cannot return to soft contact, so it reaches every stiffness unless solutions grow without bound.
4. For small structures and a piecewise linear law: a path in the damping, from so much of it that
   the lips hardly move, and an orbit that has been marched.
5. For small or reduced structures: a path in the frequency, from the nearest one at which full
   steps converge.
6. For those of 4: all of this with half the harmonics; then the path of 3 again, with many more
   steps. Stiff pairs with little damping have thousands of folds on their way.

With :class:`UnilateralConstraint` and a weight, attempts 1 and 2 find the contact force of a stiff
penalty, from which full steps start; where these fail, solutions are followed from a soft penalty
to the constraint (:class:`ConstraintSystem`).

Pairs that are seen through a static compliance (:mod:`coupled`) start from an orbit that has been
marched, by full steps, then by shortened ones; then from half the harmonics, by full steps from the
linear solution, along a path in the softness in series with the pairs, which ends at none, and
along those in the frequency and in the damping.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from fenics_crack.balance.arclength import Stepping, follow_path
from fenics_crack.balance.bordered import PathPoint, Tangent, land, solve_in_plane
from fenics_crack.balance.compliance import Compliance
from fenics_crack.balance.condensed import (
    CondensedPoint,
    CondensedSystem,
    ConstraintSystem,
    HigherHarmonics,
)
from fenics_crack.balance.contact_integrals import ContactIntegrals, ExactIntegrals
from fenics_crack.balance.coupled import CoupledSystem
from fenics_crack.balance.family import DampingFamily, Family, FrequencyFamily
from fenics_crack.balance.fourier import balanced, resized
from fenics_crack.balance.linearisation import Linearisation
from fenics_crack.balance.newton import DistributedSystem, KernelNewton, Newton
from fenics_crack.balance.orbits import MarchedOrbits, recurrences
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.rounding import (
    ROUNDING,
    SOFT,
    check_stiffness,
    least_residual,
    stiffness_times_compliance,
)
from fenics_crack.errors import ConvergenceError
from fenics_crack.model.contact import UnilateralPenalty
from fenics_crack.model.flow import ExponentialFlow
from fenics_crack.model.modal import all_modes
from fenics_crack.stages import begin

__all__ = ["FEWEST", "Search"]

FAR = 5.0
"""Distance of the parameter from its end value at which a path is abandoned; a path that begins
farther away may go as far as its start."""
STIFF = 10.0
"""Stiffness of the penalty, relative to eps, from which full steps to the constraint start."""
NEARBY = (1.02, 0.98, 1.1, 0.9, 1.3, 0.75, 2.0, 0.5)
"""Where a path in the frequency may start, relative to the frequency wanted."""
FEWEST = 5
"""Harmonics with which a solution is sought first where pairs are coupled, or unknowns many."""
RUNG = 1e-5
"""|F| / |x| of a solution with few harmonics that others start from."""
SOFTNESS = (1.0, 10.0)
"""In series with coupled pairs where a path begins, in parts of what is enough."""
MARCHED, MOVING, ROUGHLY = 40, 40, 1e-6
"""Periods of a response that are marched for a start, modes that move in them, and how closely it
shall then repeat."""
DAMPED = (1e3, 1e4, 1e5)
"""Times the damping, where a path in it may start."""
RECURRENCES = 4
"""Periods after which the motion came nearest to where it had been, from which an orbit is sought
where the last one does not lead to any."""
RAMP = Stepping(first=0.2, longest=0.5, shortest=1e-5, most=100)
MANY = 150
"""Unknowns with which paths take long."""
UNHURRIED = 200
"""Unknowns up to which the last path has all its steps; beyond, fewer, as each takes longer."""
FIRST, FEW, LAST = 600, 200, 8000
"""Steps of a path in the stiffness where other attempts are left, of those others, and of a path
where there are none."""
WIDE, NARROW = Stepping(first=1.0, longest=2.0), Stepping(first=0.1, longest=0.3)
"""For paths in ln k, and for paths whose parameter runs from 0 to 1."""


class StiffnessSystem(DistributedSystem, Protocol):
    """Equations whose parameter is ln k, the contact stiffness relative to the law's."""

    compliance: Compliance
    integrals: ContactIntegrals
    linear: np.ndarray
    """The solution without contact."""


@dataclass
class Search:
    """The record of the attempts at one solution."""

    tolerance: float
    """|F| / |x| at which a solution is accepted; raised to what rounding allows."""
    converged: bool = False
    """Whether the last attempt met it."""
    iterations: int = 0
    """Newton iterations, all attempts together."""
    history: list[float] = field(default_factory=list)
    """|F| of every Newton iteration."""
    attempts: list[str] = field(default_factory=list)
    """What was tried and how it ended."""
    newton: type[Newton | KernelNewton] = Newton
    """By which a penalty is solved for."""
    patient: bool = True
    """Whether every attempt is made; else those near the start, and paths of few unknowns."""
    _rounding: float = ROUNDING
    _last_coupled: Any = None

    @property
    def status(self) -> str:
        """All attempts."""
        return "; then ".join(self.attempts)

    def penalty(
        self,
        system: CondensedSystem,
        start: np.ndarray,
        family_from: Callable[[float], FrequencyFamily] | None = None,
        name: str = "full Newton steps",
        problem: Problem | None = None,
        kept: int | None = None,
    ) -> Linearisation:
        """Solve for a law that gives the force from the gap; return the equations there.

        ``family_from`` makes the family of the same equations from a relative frequency to 1;
        ``name`` is that of the first attempt; ``problem`` is given where its motion can be marched;
        ``kept`` harmonics have been solved for at the start.
        Raises InputError where the contact is so stiff that rounding leaves nothing of its force.
        """
        product = self._allow_rounding(system)
        with self.newton(system) as newton:
            found = self._from_near(newton, system, start, name, kept, problem)
            if not self.converged and self._affordable(system):
                wide = WIDE if problem is None else replace(WIDE, most=FIRST)
                found = self._stiffness_path(newton, system.linear, product, wide)
            if not self.converged and problem is not None and self.patient:
                if problem.structure.damping is not None:
                    found = self._damping_path(problem)
                if not self.converged and kept is None:
                    found = self._from_marched(newton, problem, 0.0) or found
        if not self.converged and family_from is not None and self.patient:
            found = self._frequency_path(family_from)
        return found

    def rung(
        self, system: CondensedSystem, start: np.ndarray | None, kept: int | None
    ) -> np.ndarray | None:
        """The gap of a solution with few harmonics, from which others start: from one with still
        fewer, ``kept``, or without a start also along the path in the contact stiffness. By the
        loop of paths; None where it is not found."""
        product, name = self._allow_rounding(system), "full Newton steps"
        if kept is not None:
            name = f"from H = {kept} to {system.integrals.harmonics}"
        sharp, self.tolerance = self.tolerance, max(self.tolerance, RUNG)
        with KernelNewton(system) as newton:
            begun = system.linear if start is None else start
            found = self._from_near(newton, system, begun, name, kept)
            if not self.converged and start is None:
                wide = replace(WIDE, most=FEW)
                found = self._stiffness_path(newton, system.linear, product, wide)
        self.tolerance = sharp
        return found.unknown if self.converged else None

    def last_resort(
        self, system: CondensedSystem, fewer: np.ndarray | None, kept: int, problem: Problem
    ) -> Linearisation:
        """From a solution with fewer harmonics, if there is one; and along the path in the contact
        stiffness once more, with as many steps as it may take."""
        product = self._allow_rounding(system)
        with self.newton(system) as newton:
            if fewer is not None:
                name = f"from H = {kept}"
                found = self._from_near(newton, system, fewer, name, kept, problem)
                if self.converged:
                    return found
            most = int(LAST * min(1.0, (UNHURRIED / system.global_size) ** 2))
            return self._stiffness_path(newton, system.linear, product, replace(WIDE, most=most))

    def _from_near(
        self,
        newton: Newton | KernelNewton,
        system: CondensedSystem,
        start: np.ndarray,
        name: str,
        kept: int | None,
        problem: Problem | None = None,
    ) -> Linearisation:
        """By full steps and shortened ones; where some harmonics are new, along a path in those,
        and from a marched orbit."""
        found = self._newton(newton, start, 0.0, 20, name)
        if not self.converged and start is not system.linear:
            found = self._shortened(newton, start, 0.0) or found
        if not self.converged and kept and self._affordable(system):
            found = self._harmonics_path(newton, system, start, kept)
        if not self.converged and kept and problem:
            found = self._from_marched(newton, problem, 0.0) or found
        return found

    def _affordable(self, system: CondensedSystem) -> bool:
        """Whether paths are followed: one of many steps with many unknowns takes minutes."""
        return self.patient or system.global_size <= MANY

    def _allow_rounding(self, system: StiffnessSystem) -> float:
        """Raise the tolerance to what rounding allows; return k R."""
        law = system.integrals.law
        check_stiffness(system.compliance, law)
        product = stiffness_times_compliance(system.compliance, law)
        self._rounding = max(self._rounding, least_residual(product))
        if self._rounding > ROUNDING:
            self.tolerance = max(self.tolerance, self._rounding)
        return product

    def _harmonics_path(
        self, newton: Newton | KernelNewton, system: CondensedSystem, start: np.ndarray, kept: int
    ) -> Linearisation:
        """From a solution with fewer harmonics along the compliance of the others."""
        name = f"in the harmonics above {kept}"
        with Newton(HigherHarmonics(system, kept)) as few:
            found = self._newton(few, start, 0.0, 20)
            if self.converged:
                found = self._path(name, few, found, (0.0, 1.0), replace(NARROW, most=FEW))
            else:
                self._note(f"path {name}", "its start")
        if self.converged:
            return self._newton(newton, found.unknown, 0.0, 20)
        return system.linearise(found.unknown)

    def constraint(self, system: ConstraintSystem, start: np.ndarray | None) -> Linearisation:
        """Solve without penetration; return the equations there."""
        with Newton(system) as newton:
            if start is not None:
                at = self._newton(newton, start, 1.0, 20, "full Newton steps")
                if self.converged:
                    return at
            found = self._from_penalty(system, STIFF)
            if self.converged:
                at = self._newton(newton, found, 1.0, 30, "constraint from penalty")
                if self.converged:
                    return at
            at = system.linearise(self._from_penalty(system, 1.0), 0.0)
            if not self.converged:
                return system.linearise(at.unknown)
            return self._path("from penalty to constraint", newton, at, (0.0, 1.0), NARROW)

    def coupled(
        self,
        system_with: Callable[[int], CoupledSystem],
        problem: Problem,
        start: np.ndarray | None,
        family_from: Callable[[float], FrequencyFamily] | None = None,
        *,
        marched: bool = True,
    ) -> Linearisation:
        """Solve for pairs that are seen through a static compliance; return the equations there.

        Without a start, from a marched orbit; where that fails with half the harmonics first, down
        to a few.
        """
        marched = marched and problem.coupled_integrals().piecewise
        harmonics = problem.harmonics
        system = system_with(harmonics)
        with Newton(system) as newton:
            if start is not None:
                found = self._newton(newton, start, 1.0, 20, "full Newton steps")
                if self.converged:
                    return found
            elif marched:
                found = self._from_marched(newton, problem, 1.0) or system.linearise(system.linear)
                if self.converged:
                    self._last_coupled = found
                    return found
            fewer = harmonics // 2
            if fewer >= max(FEWEST, problem.subharmonic):
                self.coupled(system_with, problem.with_harmonics(fewer), None, marched=False)
                if self.converged:
                    below = self._last_coupled
                    slow = below.gap + below.force @ system.residual
                    name = f"from H = {fewer} to {harmonics}"
                    found = self._newton(newton, resized(slow, harmonics), 1.0, 20, name)
            if not self.converged:
                if start is None:
                    found = self._newton(newton, system.linear, 1.0, 12, "full Newton steps")
                if not self.converged:
                    found = self._softness_path(system)
        if not self.converged and family_from is not None:
            found = self._frequency_path(family_from)
        if not self.converged and start is None and problem.structure.damping is not None:
            found = self._damping_path(replace(problem, static_above=problem.cutoff))
        self._last_coupled = found
        return found

    def _from_marched(
        self, newton: Newton | KernelNewton, problem: Problem, parameter: float
    ) -> Linearisation | None:
        """From the wave of a marched orbit; None where it has none."""
        name = "from a marched orbit"
        try:
            guess = self._marched(problem)
        except ConvergenceError as error:
            self._note(name, str(error))
            return None
        found = self._newton(newton, guess, parameter, 12, name)
        if not self.converged:
            found = self._shortened(newton, guess, parameter) or found
        return found

    def _shortened(
        self, newton: Newton | KernelNewton, start: np.ndarray, parameter: float
    ) -> Linearisation | None:
        """The same by steps that are shortened where the residual would grow."""
        point = solve_in_plane(
            newton.system, start, parameter, None,
            tolerance=self.tolerance, iterations=30, least_damping=0.01, patience=8,
        )  # fmt: skip
        name = "shortened steps from there"
        if point is None:
            self._note(name, "up to 30 iterations")
            return None
        self.iterations += point.iterations
        return self._newton(newton, point.unknown, parameter, 3, name)

    def _marched(self, problem: Problem) -> np.ndarray:
        """The gap, the slow one where pairs are coupled, of a motion that has been marched for some
        periods and led to an orbit by shooting.

        Where the orbit is unstable the motion passes near it now and then: shooting begins where
        the motion comes nearest to repeating itself.
        """
        harmonics, periods = problem.harmonics, problem.subharmonic
        begin("cold start: an orbit marched in time")
        steps = 1 << max(8, (8 * harmonics // periods).bit_length())
        above = all_modes(problem.structure).above_lowest(MOVING)
        if problem.residual is not None:
            above = min(problem.cutoff, above)
        flow = ExponentialFlow(
            problem.structure, problem.omega, problem.contact, steps, static_above=above
        )
        with np.errstate(all="ignore"):  # of attempts that run away
            gap = self._orbit_of(flow, periods, problem)
        return balanced(gap, harmonics)

    @staticmethod
    def _orbit_of(flow: ExponentialFlow, periods: int, problem: Problem) -> np.ndarray:
        """What is transformed: the gap of an orbit of a flow, or of its last period."""
        steps = flow.steps
        passed = flow.advance(flow.steady[0], MARCHED * periods).states[:: steps * periods]
        orbit = None
        for place in recurrences(passed, RECURRENCES):
            orbits = MarchedOrbits(flow, passed[place], periods)
            orbit = solve_in_plane(
                orbits, orbits.start, 1.0, None,
                tolerance=ROUGHLY, iterations=12, least_damping=0.05, patience=6,
            )  # fmt: skip
            if orbit is not None:
                break
        last = orbits.steps(orbits.start if orbit is None else orbit.unknown, 1.0)
        gap = last.gap
        if problem.residual is not None:
            gap = gap + last.forces[:-1] @ problem.residual
        return np.asarray(gap)

    def _softness_path(self, system: CoupledSystem) -> Linearisation:
        """From pairs with a soft compliance in series, where the solution is close to the linear
        one, to none: a path with an end."""
        name = "in the softness"
        for factor in SOFTNESS:
            soft = system.softened(factor * system.enough)
            with Newton(soft) as newton:
                found = self._newton(newton, soft.linear, 0.0, 20)
                if self.converged:
                    found = self._path(name, newton, found, (0.0, 1.0), RAMP)
                    if self.converged:
                        break
                else:
                    self._note(f"path {name}", "its start")
        return system.linearise(found.unknown)

    def _from_penalty(self, system: ConstraintSystem, factor: float) -> np.ndarray:
        """The unknowns that stand for the contact force of a penalty, relative to the weight."""
        law = UnilateralPenalty(factor * system.weight)
        integrals = ExactIntegrals(law, system.integrals.harmonics)
        penalty = CondensedSystem(system.compliance, integrals)
        known = self.tolerance, self._rounding
        at = self.penalty(penalty, penalty.linear)
        self.tolerance, self._rounding = known  # only the penalty is rounded like that
        assert isinstance(at, CondensedPoint)
        return system.from_force(at.force)

    def _newton(
        self,
        newton: Newton | KernelNewton,
        start: np.ndarray,
        parameter: float,
        most: int,
        name: str = "",
    ) -> Linearisation:
        """One attempt, recorded if it has a name."""
        begin(name or "start of a path")
        before = len(newton.history)
        found, self.converged, count = newton.solve(start, parameter, self.tolerance, most)
        self.history += newton.history[before:]
        self.iterations += count
        if name:
            self._note(name, f"{count} iterations")
        return found

    def _note(self, attempt: str, details: str) -> None:
        outcome = "converged" if self.converged else "failed"
        self.attempts.append(f"{attempt}: {outcome} ({details})")

    def _stiffness_path(
        self, newton: Newton | KernelNewton, linear: np.ndarray, product: float, wide: Stepping
    ) -> Linearisation:
        """Along ln k from where contact is soft; ``product`` is k R."""
        name = "in the contact stiffness"
        soft = min(0.0, float(np.log(SOFT / product)))
        found = self._newton(newton, linear, soft, 20)
        if self.converged and soft < 0.0:
            return self._path(name, newton, found, (soft, 0.0), wide)
        self._note(f"path {name}", f"its start at {np.exp(soft):.2g} of the stiffness")
        return newton.system.linearise(found.unknown, 0.0)

    def _frequency_path(self, family_from: Callable[[float], FrequencyFamily]) -> Linearisation:
        for factor in NEARBY:
            family = family_from(factor)
            found = self.along_frequency(family, family.system(family.start).linear)
            if self.converged:
                return found
        self._note("path in the frequency", "from 0.5 to 2 of it")
        return family.linearise(found.unknown, 1.0)

    def _damping_path(self, problem: Problem) -> Linearisation:
        """From a damping so high that the lips hardly move, and the solution is the only one."""
        for factor in DAMPED:
            family = DampingFamily(problem, factor, 1.0)
            start, name = family.system(factor).linear, f"from {factor:g} times the damping"
            tried = len(self.attempts)
            found = self._along(name, family, start, 2 * FEW)
            if self.converged or len(self.attempts) > tried:
                return found
        self._note("path in the damping", "none to its end")
        return family.linearise(found.unknown, 1.0)

    def along_frequency(self, family: FrequencyFamily, start: np.ndarray) -> Linearisation:
        """Along a family in the frequency, from near a solution at its start; return the equations
        at its end."""
        return self._along(f"from {family.start:g} rad/s", family, start, 200)

    def _along(self, name: str, family: Family, start: np.ndarray, most: int) -> Linearisation:
        with Newton(family) as newton:
            found = self._newton(newton, start, 0.0, 20)
            if self.converged:
                found = self._path(name, newton, found, (0.0, 1.0), replace(NARROW, most=most))
        return found

    def _path(
        self,
        name: str,
        newton: Newton | KernelNewton,
        start: Linearisation,
        span: tuple[float, float],
        stepping: Stepping,
    ) -> Linearisation:
        """Follow a path until Newton's method lands at the end, from either side."""
        first, end = span
        steps, found = 0, start
        last = PathPoint(start.unknown, first, 0, Tangent(start.unknown, 0.0, 0.0))
        self.converged = False

        def at_end(nearby: np.ndarray) -> PathPoint | None:
            nonlocal found
            found = self._newton(newton, nearby, end, 20)
            return replace(last, unknown=found.unknown, parameter=end) if self.converged else None

        stepping = replace(stepping, rounding=self._rounding, span=span)
        for point in follow_path(newton.system, start.unknown, first, stepping):
            steps += 1
            self.iterations += point.iterations
            if max(point.parameter, last.parameter) >= end:
                land(last, point, end, at_end)
            if self.converged or abs(point.parameter - end) > max(FAR, end - first):
                break
            last = point
        self._note(f"path {name}", f"{steps} steps, {last.parameter:.3g} of {first:.3g} to {end:g}")
        return found if self.converged else newton.system.linearise(found.unknown, end)
