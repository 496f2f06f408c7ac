"""Cold starts: one start after the other, until Newton's method arrives or the work is done.

A start gives guesses, and from each of them full Newton steps are taken:

near       a given solution, or the linear one; and where shortened steps lead from there
fewer      instead of the linear one, with many unknowns or pairs that are seen through a static
           compliance (:mod:`contact_system`): the solution with half the harmonics, which comes
           from that with half of those, and so on
marched    a motion after 40, 160 and 520 periods of exponential steps in time: with it pairs begin
           that are seen through a static compliance, where their law is piecewise linear. Many
           harmonics come from a solution with few: twice as many from itself, more from the exact
           orbit next to it, which is near whatever their number, or step by step
path       where a path of solutions has the problem, followed by arc-length through its folds,
           from where the solution is unique and close to the linear one: in the contact stiffness,
           or in the softness in series with pairs that are seen through a static compliance

A path in the stiffness cannot return to soft contact: with enough steps it reaches every stiffness,
unless solutions grow without bound. Several stiff pairs with little damping have thousands of folds
on their way. So all starts together take a certain number of iterations and no more, the same on
every machine: a search that finds nothing ends within seconds, and says what was tried.

No search can undo what rounding does: a gap rounded to eps |g| makes a contact force rounded to
eps k |g|, which moves the gap by eps k R |g|, and no residual can be smaller than that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field, replace

import numpy as np

from fenics_crack.balance.compliance import Compliance
from fenics_crack.balance.contact_system import ContactPoint, ContactSystem
from fenics_crack.balance.orbits import orbit_next_to, wave_states
from fenics_crack.balance.problem import NARROW, NEARLY_SOLVED, Problem
from fenics_crack.errors import ConvergenceError, InputError
from fenics_crack.kernel import kernel
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.flow import ExponentialFlow
from fenics_crack.model.modal import all_modes
from fenics_crack.motion.flow import flow_of
from fenics_crack.motion.orbit import PeriodicOrbit, affordable
from fenics_crack.numerics.bordered import FULL_STEPS, PATIENCE, point_on_path, solve_at, solve_near
from fenics_crack.numerics.fourier import balanced
from fenics_crack.numerics.linearisation import (
    EPSILON,
    MAX_ROUNDING,
    ROUNDING,
    Linearisation,
    least_residual,
)
from fenics_crack.numerics.newton import DistributedSystem, Newton, kernel_solves
from fenics_crack.numerics.path import Ended, Path, PathOptions, Target
from fenics_crack.stages import begin

__all__ = ["SOFT", "Search", "check_stiffness", "stiffness_times_compliance"]

SOFT = 0.05
"""k R up to which contact is so soft that the solution is unique and close to the linear one."""
COMPILED, INTERPRETED = 5000, 1000
"""Iterations of all starts together, with 300 unknowns in the kernel, and in Python: 5 to 8 s."""
PERIODS, MARCHED, MOVING, BALANCED = 40, (1, 3, 9), 40, 20
"""Periods of a response that are marched at a time, how many times for one guess after the other,
modes that move in them, and harmonics of the load that are balanced from there: with fewer, 10 and
5, 6 of 36 solutions were not found, and with more the steps are dear that fail."""
WIDE = PathOptions(1.0, 2.0, min_cosine=0.5)
"""For paths in ln k."""

Start = tuple[str, Iterator[np.ndarray]]
"""What a start is called, and its guesses."""


def stiffness_times_compliance(compliance: Compliance, law: ContactLaw) -> float:
    """Largest k R over the harmonics."""
    largest = np.abs(compliance.matrices).sum(axis=2).max()
    return float(largest * np.max(law.stiffness))


def check_stiffness(compliance: Compliance, law: ContactLaw) -> None:
    """Raise InputError where rounding would leave nothing of the contact force."""
    stiffest = float(np.max(law.stiffness))
    static = float(np.abs(compliance.matrices[0]).sum(axis=1).max())
    if not EPSILON * stiffest * static < MAX_ROUNDING:
        raise InputError(
            "contact stiffness",
            stiffest,
            f"at most {MAX_ROUNDING / (EPSILON * static):.2g} N/m on this structure, beyond "
            "which rounding leaves nothing; UnilateralConstraint is the limit",
        )


@dataclass
class Search:
    """The record of the attempts at one solution."""

    tolerance: float
    """|F| / |x| at which a solution is accepted; raised to what rounding allows."""
    share: float = 1.0
    """Of the iterations that may be taken."""
    converged: bool = False
    """Whether the last attempt met the tolerance."""
    iterations: int = 0
    """Newton iterations, all attempts together."""
    history: list[float] = field(default_factory=list)
    """|F| of every iteration by SNES: where the kernel has the equations, of a last attempt that
    failed."""
    attempts: list[str] = field(default_factory=list)
    """What was tried and how it ended."""
    orbit: PeriodicOrbit | None = None
    """From which a guess was taken."""
    _rounding: float = ROUNDING
    _most: float = 0.0

    @property
    def status(self) -> str:
        """All attempts, and what to do where none led to a solution."""
        told = "; then ".join(self.attempts)
        if self.converged:
            return told
        return (
            f"{told}; none found in {self.iterations} iterations: try other harmonics, a softer "
            "contact, more damping, or a solution nearby as initial"
        )

    # --- what is solved ---------------------------------------------------------------------------

    def penalty(
        self,
        system: ContactSystem,
        start: np.ndarray | None = None,
        problem: Problem | None = None,
        with_harmonics: Callable[[int], ContactSystem] | None = None,
    ) -> Linearisation:
        """Solve for a law that gives the force from the gap; return the equations there.

        ``problem`` is given with the same equations ``with_harmonics`` of another number.
        Raises InputError where the contact is so stiff that rounding leaves nothing of its force.
        """
        law = system.integrals.law
        check_stiffness(system.compliance, law)
        product = stiffness_times_compliance(system.compliance, law)
        self._rounding = max(self._rounding, least_residual(product))
        if self._rounding > ROUNDING:
            self.tolerance = max(self.tolerance, self._rounding)
        starts = []
        if start is None and system.global_size > kernel.MANY and with_harmonics and problem:
            starts.append(self._fewer(with_harmonics, problem, 0.0))
        else:
            starts.append(self._full(system, system.linear if start is None else start, 0.0))
        soft = float(np.log(SOFT / max(product, SOFT)))
        path = self._path(system, system.linear, (soft, 0.0), WIDE)
        starts.append(("path in the contact stiffness", path))
        return self._solve(system, 0.0, starts)

    def coupled(
        self,
        with_harmonics: Callable[[int], ContactSystem],
        problem: Problem,
        start: np.ndarray | None,
    ) -> Linearisation:
        """Solve for pairs that are seen through a static compliance; return the equations there."""
        system = with_harmonics(problem.harmonics)
        starts = [] if start is None else [self._full(system, start, 1.0)]
        if system.integrals.coupled and system.integrals.exact:
            starts.append(self._marched(with_harmonics, problem))
        starts.append(self._fewer(with_harmonics, problem, 1.0))
        soft = system.softened()
        path = self._path(soft, soft.linear, (0.0, 1.0), NARROW)
        return self._solve(system, 1.0, [*starts, ("path in the softness", path)])

    def _solve(
        self, system: DistributedSystem, parameter: float, starts: list[Start]
    ) -> Linearisation:
        """The equations where Newton's method arrives, or where it was last."""
        self._most = self.share * _iterations(system)
        at: Linearisation | None = None
        with ExitStack() as held:
            snes = None
            if not kernel_solves(system):
                snes = held.enter_context(Newton(system, self.history))
            for name, guesses in starts:
                begin(name)
                before = self.iterations
                for guess in guesses:
                    at, count = self._newton(snes, system, guess, parameter)
                    self.iterations += count
                    if self.converged or self._spent:
                        break
                outcome = "converged" if self.converged else "failed"
                self.attempts.append(f"{name}: {outcome} ({self.iterations - before} iterations)")
                if self.converged:
                    break
        at = at or system.linearise(np.zeros(system.shape), parameter)
        if not self.converged and snes is None:  # for the record
            with Newton(system, self.history) as snes:
                at, _ = self._newton(snes, system, at.unknown, parameter)
        return at

    def _newton(
        self, snes: Newton | None, system: DistributedSystem, guess: np.ndarray, parameter: float
    ) -> tuple[Linearisation, int]:
        """Full steps of SNES, or else of the kernel: where they lead, and how many they were."""
        if snes is not None:
            at, self.converged, count = snes.solve(guess, parameter, self.tolerance, FULL_STEPS)
            return at, count
        found = solve_at(system, guess, parameter, tolerance=self.tolerance)
        self.converged = found is not None
        if found is None:
            return system.linearise(guess, parameter), FULL_STEPS
        assert found.at is not None
        return found.at, found.iterations

    @property
    def _spent(self) -> bool:
        return self.iterations >= self._most

    # --- the starts -------------------------------------------------------------------------------

    def _full(self, system: DistributedSystem, guess: np.ndarray, parameter: float) -> Start:
        return "full Newton steps", self._near(system, guess, parameter)

    def _near(
        self, system: DistributedSystem, guess: np.ndarray, parameter: float
    ) -> Iterator[np.ndarray]:
        """A guess, and where steps from there lead that are shortened where the residual would
        grow."""
        yield guess
        point = solve_near(system, guess, parameter, tolerance=self.tolerance, full=False)
        self.iterations += PATIENCE if point is None else point.iterations
        if point is not None:
            yield point.unknown

    def _fewer(
        self, with_harmonics: Callable[[int], ContactSystem], problem: Problem, parameter: float
    ) -> Start:
        """The solution with half the harmonics, which comes from that with half of those, down to
        the load's own."""
        counts = _halved(problem.harmonics, problem.subharmonic)
        return "from fewer harmonics", self._climb(with_harmonics, counts, parameter)

    def _climb(
        self,
        with_harmonics: Callable[[int], ContactSystem],
        counts: list[int],
        parameter: float,
        at: ContactPoint | None = None,
    ) -> Iterator[np.ndarray]:
        """Guesses for the last of some numbers of harmonics: with each of them the solution of the
        one before, the first from a given one; where one is not found it is left out."""
        for count in counts:
            system = with_harmonics(count)
            start = system.linear if at is None else system.slow(at.gap, at.force)
            guesses = self._near(system, start, parameter)
            if count == counts[-1]:
                yield from guesses
            else:
                at = self._nearly(system, guesses, parameter) or at

    def _nearly(
        self, system: ContactSystem, guesses: Iterator[np.ndarray], parameter: float
    ) -> ContactPoint | None:
        """Where full steps lead from one of some guesses; None where they do not arrive."""
        for guess in guesses:
            tolerance = max(self.tolerance, NEARLY_SOLVED)
            point = solve_at(system, guess, parameter, tolerance=tolerance)
            self.iterations += FULL_STEPS if point is None else point.iterations
            if point is not None:
                return system.linearise(point.unknown)
        return None

    def _marched(self, with_harmonics: Callable[[int], ContactSystem], problem: Problem) -> Start:
        """The slow gap of a motion after more and more periods; or of the exact orbit next to the
        solution with few harmonics that it leads to."""

        def guesses() -> Iterator[np.ndarray]:
            few, *more = _halved(problem.harmonics, BALANCED * problem.subharmonic)
            lowest = problem.with_harmonics(few)
            system = lowest.system(lowest.compliance())
            if not more:
                yield from self._slow_gaps(system, lowest)
                return
            at = self._nearly(system, self._slow_gaps(system, lowest), 1.0)
            if at is None:
                return
            climb = self._climb(with_harmonics, more, 1.0, at)
            orbit = self._next_to_orbit(with_harmonics(more[-1]), lowest, at)
            for way in (orbit, climb) if len(more) > 1 else (climb, orbit):
                yield from way

        return "from a marched motion", guesses()

    def _next_to_orbit(
        self, system: ContactSystem, lowest: Problem, at: ContactPoint
    ) -> Iterator[np.ndarray]:
        """The slow gap of the exact orbit next to a solution with few harmonics."""
        self.orbit = _orbit_next_to(lowest, at)
        if self.orbit is not None:
            known = self.orbit.coefficients(system.integrals.harmonics)
            yield from self._near(system, system.slow(known.gap, known.force), 1.0)

    def _slow_gaps(self, system: ContactSystem, problem: Problem) -> Iterator[np.ndarray]:
        """Of a motion that is marched."""
        harmonics, periods = problem.harmonics, problem.subharmonic
        steps = 1 << max(8, (4 * harmonics // periods).bit_length())
        above = min(problem.cutoff, all_modes(problem.structure).above_lowest(MOVING))
        try:
            flow = ExponentialFlow(
                problem.structure, problem.omega, problem.contact, steps, static_above=above
            )
            state = flow.steady[0]
            for more in MARCHED:
                with np.errstate(all="ignore"):  # of motions that run away
                    for _ in range(more):
                        state = flow.advance(state, PERIODS * periods).states[-1]
                    last = flow.advance(state, periods)
                    assert system.residual is not None
                    slow = last.gap + last.forces[:-1] @ system.residual
                if not np.all(np.isfinite(slow)):
                    return
                yield from self._near(system, balanced(slow, harmonics), 1.0)
        except ConvergenceError:
            return

    def _path(
        self,
        system: DistributedSystem,
        start: np.ndarray,
        span: tuple[float, float],
        options: PathOptions,
    ) -> Iterator[np.ndarray]:
        """Where the path from near a start has its end; one that goes as far beyond is left."""
        first, end = span
        begun = solve_at(system, start, first, tolerance=self.tolerance)
        self.iterations += FULL_STEPS if begun is None else begun.iterations
        if begun is None:
            return
        options = replace(
            options, rounding=self._rounding, max_steps=int(self._most),
            span=(first, 2.0 * end - first),
        )  # fmt: skip
        path = Path(system, point_on_path(system, begun.unknown, first), options, [Target(end)])
        for point in path.points():
            self.iterations += point.iterations
            if self._spent:
                return
        if path.ended is Ended.MET:
            yield path.last.unknown


def _halved(harmonics: int, enough: int) -> list[int]:
    """Numbers of harmonics, each about half of the next, down to one that is enough."""
    counts = [harmonics]
    while counts[0] > enough:
        counts.insert(0, max((counts[0] + 1) // 2, enough))
    return counts


def _orbit_next_to(problem: Problem, at: ContactPoint) -> PeriodicOrbit | None:
    """The exact orbit next to a solution, where it does not take long to find."""
    flow, omega, periods = (
        flow_of(problem.structure, problem.contact),
        problem.omega,
        problem.subharmonic,
    )
    if flow is None or not affordable(flow, omega, periods):
        return None
    states = wave_states(flow, problem.wave(at).displacement_coefficients, problem.base_omega)
    return orbit_next_to(flow, omega, states[0], periods, patient=False)


def _iterations(system: DistributedSystem) -> float:
    """How many a search may take: they cost like the square of the unknowns where the kernel has
    them."""
    dense = COMPILED * (300.0 / max(kernel.MANY, system.global_size)) ** 2
    if getattr(system, "compiled", None) is not None:
        return dense
    return INTERPRETED if system.matrix_free else min(INTERPRETED, dense)
