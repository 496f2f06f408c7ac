"""Answer whose causes of error are varied one at a time, and the solutions that this takes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

from fenics_crack.balance.harmonic_balance import slide_along_lines, solve_linear
from fenics_crack.balance.problem import Problem, least_harmonics
from fenics_crack.balance.solution import PeriodicSolution, Solver
from fenics_crack.basics.causes import OTHER_RUNS
from fenics_crack.basics.errors import InputError
from fenics_crack.errors.convergence import GridConvergence, Varied
from fenics_crack.errors.numbers import (
    Numbers,
    accepted_orbit,
    many_harmonics,
    numbers_of,
    of_orbit,
)
from fenics_crack.errors.verification import Verification
from fenics_crack.motion.orbit import PeriodicOrbit
from fenics_crack.study.prepare import REFUSALS, Study

CAUSE_WITHOUT_CONTACT = "without contact there is one"
"""Reason why harmonics are not varied."""


@dataclass(frozen=True)
class Case:
    """Answer whose causes of error are varied.

    Attributes
    ----------
    study : Study
        Study of the answer, reduced as it was.
    answer : PeriodicSolution
        The answer.
    answer_numbers : dict of str to float
        Its numbers.
    wave : PeriodicSolution
        Solution by harmonic balance with as many harmonics, to which other solutions are compared.
        It is the answer if there is no such solution and the answer is an exact orbit.
    numbers : Numbers
        Numbers of the wave.
    """

    study: Study
    answer: PeriodicSolution
    answer_numbers: Mapping[str, float]
    wave: PeriodicSolution
    numbers: Numbers

    def values_of(
        self, motion: PeriodicSolution | PeriodicOrbit, study: Study | None = None
    ) -> dict[str, float]:
        """Return the numbers of a motion, by default of the answer's study (collective)."""
        study, mode = study or self.study, self.numbers.mode
        if isinstance(motion, PeriodicOrbit):
            return of_orbit(study, self.answer, motion, mode)
        return numbers_of(study, motion, mode).values

    @cached_property
    def orbit_values(self) -> dict[str, float] | None:
        """Numbers of the exact orbit that is accepted for the answer, or None (collective)."""
        orbit = accepted_orbit(self.answer)
        return None if orbit is None else self.values_of(orbit)

    def distance_to_orbit(self, orbit_values: Mapping[str, float]) -> Varied:
        """Return the part of harmonics by the numbers of the exact orbit."""
        counts = self.answer.harmonics, many_harmonics(self.answer)
        sizes = 1.0 / counts[1], 1.0 / counts[0]
        parts = {}
        for name, value in self.values_of(self.answer).items():
            limit = orbit_values.get(name, 0.0)
            parts[name] = GridConvergence(
                sizes, (limit, value), "exact orbit", factor=1.0, extrapolated=limit
            )
        return counts, parts


def vary(errors: Verification, causes: Mapping[str, Callable[[], Varied]]) -> Verification:
    """Add the part of each cause, or why it is not known (collective)."""
    for cause, find_part in causes.items():
        try:
            errors = errors.with_part(cause, find_part())
        except REFUSALS as error:
            other_run = OTHER_RUNS.get(cause, f"a run with more {cause}")
            errors = errors.with_unknown(cause, reason_of_failure(other_run, error))
    return errors


def reason_of_failure(run: str, error: Exception) -> str:
    """Return why another run gives no error: a key that it cannot have, or no solution."""
    if isinstance(error, InputError):
        return f"{run} cannot be used, for its {error.key}"
    return f"{run} has no solution"


def solve_again(
    study: Study, omega: float, harmonics: int, initial: PeriodicSolution | None = None
) -> PeriodicSolution:
    """Solve a reduced study without its stability; ConvergenceError if it fails."""
    if study.contact is None:
        return solve_linear(study.structure, omega, harmonics=harmonics)
    return _solver(study, omega, harmonics).solve(initial)


def solve_in_steps(
    study: Study, omega: float, harmonics: int, initial: PeriodicSolution | None = None
) -> PeriodicSolution:
    """Solve with half of the harmonics, and from there with all of them.

    Half of them find a motion from rest in less time. If no solution with all harmonics is next to
    it, the first solution is returned.
    """
    n_first = max(harmonics // 2, least_harmonics(study.structure, 1))
    solution = solve_again(study, omega, n_first, initial)
    if study.contact is None:
        return solution
    solver = _solver(study, omega, harmonics)
    search, finer_solution = solver.attempt(solution, wholly=False)
    return finer_solution if search.converged else solution


def _solver(study: Study, omega: float, harmonics: int) -> Solver:
    """Return the solver of a study, with friction along the lines of its own sliding."""
    assert study.contact is not None
    law = slide_along_lines(study.structure, omega, study.contact)
    return Solver(Problem(study.structure, omega, law, harmonics))
