"""Vary the causes of an answer's error, each alone.

:mod:`stated` and :mod:`verify` judge two causes equally. The part of *harmonics* is the distance
to the exact orbit's numbers, if the answer has an accepted exact orbit. *Friction* has two cases:

- If the answer has no friction, the part is the change from a frictionless exact orbit to an
  orbit with friction. Both orbits have few modes, and crack faces without mass. Extremes may agree
  by chance: so the part is at least the root mean square of the motion's change. The difference to
  the same change with half the modes is added.
- If a solid has friction along a line at each pair, the part is 2 r times the change by friction.
  Here r is the frictionless motion's ratio of sliding across the lines to sliding along them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from fenics_crack.balance.harmonic_balance import (
    find_line_angles_and_turning,
    law_along_lines,
    motion_without_friction,
    search_initial_orbit,
    slide_along_lines,
    solve_linear,
    truncated_orbit_solution,
)
from fenics_crack.balance.problem import Problem, least_harmonics
from fenics_crack.balance.solution import PeriodicSolution, Solver
from fenics_crack.basics.causes import RUN_WORDS_BY_CAUSE
from fenics_crack.basics.errors import InputError
from fenics_crack.errors.convergence import GridConvergence, Varied
from fenics_crack.errors.numbers import (
    Numbers,
    accepted_orbit,
    many_harmonics,
    numbers_of,
    of_orbit,
    sizes_of_change,
)
from fenics_crack.errors.verification import Verification
from fenics_crack.model.contact import CoulombFriction, friction_of
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.structure import Structure
from fenics_crack.motion.orbit import PeriodicOrbit
from fenics_crack.study.prepare import REFUSAL_EXCEPTIONS, Study, scene_contact_law

FRICTION_MODES = 20, 10
"""Numbers of modes with which the effect of friction is computed, the first for the part itself.

With 40 modes an orbit takes three times as long, and ten times if the search is hard.
"""
TURNING_FACTOR = 2.0
"""Safety factor, 2, on the error r |change by friction| due to sliding across friction lines.

Measured in seven cases, against time steps with Coulomb's cone: true errors were 0.03 to 1.2 times
the stated error.
"""
SLIDING_QUANTITIES = ("K_II_max", "K_III_max")
"""Stress intensities that friction at the tip itself changes."""
START_HARMONICS = 10
"""Harmonics per load period of the solutions that start the search for both orbits."""
CAUSE_WITHOUT_CONTACT = "without contact there is one"
"""Reason why harmonics are not varied."""


@dataclass(frozen=True)
class Case:
    """Hold an answer whose causes of error are varied.

    Attributes
    ----------
    study : Study
        Study of the answer, with the answer's reduced structure.
    answer : PeriodicSolution
        Solution whose errors are sought.
    answer_numbers : dict of str to float
        Numbers of the answer.
    wave : PeriodicSolution
        Solution by harmonic balance with the answer's number of harmonics, the base of comparisons.
        :mod:`verify` uses the answer itself; :mod:`stated`, too, if harmonic balance fails and the
        answer is an exact orbit.
    numbers : Numbers
        Numbers of the wave.
    """

    study: Study
    answer: PeriodicSolution
    answer_numbers: Mapping[str, float]
    wave: PeriodicSolution
    numbers: Numbers

    def compute_values(
        self, motion: PeriodicSolution | PeriodicOrbit, study: Study | None = None
    ) -> dict[str, float]:
        """Return a motion's numbers, by default in the answer's study (collective)."""
        study, mode = study or self.study, self.numbers.mode
        if isinstance(motion, PeriodicOrbit):
            return of_orbit(study, self.answer, motion, mode)
        return numbers_of(study, motion, mode).values

    @cached_property
    def orbit_values(self) -> dict[str, float] | None:
        """Numbers of the answer's accepted exact orbit, or None (collective)."""
        orbit = accepted_orbit(self.answer)
        return None if orbit is None else self.compute_values(orbit)

    def distance_to_orbit(self, orbit_values: Mapping[str, float]) -> Varied:
        """Return the part of harmonics from the exact orbit's numbers."""
        counts = self.answer.harmonics, many_harmonics(self.answer)
        sizes = 1.0 / counts[1], 1.0 / counts[0]
        parts = {}
        for name, value in self.compute_values(self.answer).items():
            limit = orbit_values.get(name, 0.0)
            parts[name] = GridConvergence(
                sizes, (limit, value), "exact orbit", factor=1.0, extrapolated=limit
            )
        return counts, parts

    def friction(self) -> Varied:
        """Judge friction by exact orbits with and without friction (collective).

        With friction along lines, judge by the sliding across the lines instead. There is no part
        with any further friction law, with a coefficient in the scene, or without contact.
        """
        study, scene, answer = self.study, self.study.scene, self.answer
        law, structure = study.contact, study.structure
        if law is None or not np.any(answer.contact_force(answer.instants()) > 0.0):
            return ""
        if (friction := friction_of(law)) is not None:
            return "" if friction.direction is None else self._sliding_across_lines(friction)
        table = scene.given("contact")
        if table.friction is not None:
            return ""
        if not (coefficient := table.friction_error):
            return "contact.friction_error = false"
        tangential_structure = structure.whole.with_tangents()
        if scene.disk is not None or tangential_structure.tangential is None:
            return "not estimated, only of single plates and solids"
        keys: dict[str, Any] = {"contact.friction": coefficient, "output.quantities": None}
        keys["harmonic_balance.form"] = "condensed"
        if not structure.light_lips:  # faces with mass, in contact as stiff along them as across
            keys["contact.tangential_stiffness_per_area"] = table.stiffness_per_area
        (orbits, numbers), (coarse_orbits, coarse_numbers) = (
            self._orbits_without_and_with(count, tangential_structure, keys)
            for count in FRICTION_MODES
        )
        if len(orbits) < 2:
            return f"not estimated, no exact orbit next to {START_HARMONICS} harmonics"
        if len(coarse_orbits) < 2:
            coarse_numbers = numbers
        sizes = sizes_of_change(study, *orbits)
        coefficients, parts = (0.0, float(coefficient)), {}
        for name, value in self.answer_numbers.items():
            if name in SLIDING_QUANTITIES:
                continue
            change = _relative_change(name, *numbers)
            error = abs(change) + abs(change - _relative_change(name, *coarse_numbers))
            if size := abs(numbers[0].get(name, 0.0)):
                error = max(error, sizes.get(name, 0.0) / size)
            values = value, value * (1.0 + change)
            factor = error / abs(change) if change else 1.0
            parts[name] = GridConvergence(coefficients, values, "two coefficients", factor=factor)
        return FRICTION_MODES[:1] * 2, parts

    def _orbits_without_and_with(
        self, count: int, whole_structure: Structure, keys: Mapping[str, Any]
    ) -> tuple[list[PeriodicOrbit], list[dict[str, float]]]:
        """Find exact orbits without and with friction (collective).

        The structure is reduced to ``count`` modes, or half its dofs. ``keys`` of the scene
        describe the friction.

        Returns
        -------
        list of PeriodicOrbit
            Orbits without and with friction; the list ends before the first failed search.
        list of dict of str to float
            Numbers of each orbit.
        """
        study, answer, periods = self.study, self.answer, self.answer.subharmonic
        count = min(count, whole_structure.n_dofs // 2)
        reduced_structure = reduce_structure(
            whole_structure, modes=count, method="massless", reference=False
        )
        orbits, numbers = list[PeriodicOrbit](), list[dict[str, float]]()
        for law in (study.contact, scene_contact_law(study.scene.replace(keys), reduced_structure)):
            assert law is not None
            contact_law = law_along_lines(reduced_structure, law, lambda _: orbits[0])
            problem = Problem(
                reduced_structure,
                answer.omega,
                contact_law,
                START_HARMONICS * periods,
                subharmonic=periods,
            )
            orbit = Solver(problem).solve(answer).assessment.nearest_orbit
            if orbit is None:
                break
            twin = replace(study, structure=reduced_structure, contact=contact_law)
            orbits.append(orbit)
            numbers.append(self.compute_values(orbit, twin))
        return orbits, numbers

    def _sliding_across_lines(self, friction: CoulombFriction) -> Varied:
        """Return the part due to sliding across a solid's friction lines (collective)."""
        study, answer = self.study, self.answer
        structure, periods = study.structure, answer.subharmonic
        frictionless_motion = motion_without_friction(
            structure, answer.omega, friction.law, periods
        )
        frictionless_numbers = self.compute_values(
            frictionless_motion, replace(study, contact=friction.law)
        )
        turning_ratio = find_line_angles_and_turning(frictionless_motion, friction.direction)[1]
        parts = {}
        for name, value in self.answer_numbers.items():
            value_with_turning = value + turning_ratio * (
                frictionless_numbers.get(name, 0.0) - value
            )
            parts[name] = GridConvergence(
                (0.0, 1.0), (value, value_with_turning), "two coefficients", factor=TURNING_FACTOR
            )
        return (structure.n_modes, structure.n_modes), parts


def _relative_change(
    name: str, numbers: Mapping[str, float], other_numbers: Mapping[str, float]
) -> float:
    """Return a number's relative change between motions, or 0 from 0."""
    value = numbers.get(name, 0.0)
    return other_numbers.get(name, 0.0) / value - 1.0 if value else 0.0


def vary(errors: Verification, causes: Mapping[str, Callable[[], Varied]]) -> Verification:
    """Add each cause's part to the errors, or the reason for failure (collective)."""
    for cause, find_part in causes.items():
        try:
            errors = errors.with_part(cause, find_part())
        except REFUSAL_EXCEPTIONS as error:
            other_run = RUN_WORDS_BY_CAUSE.get(cause, f"a run with more {cause}")
            errors = errors.with_unknown(cause, reason_of_failure(other_run, error))
            if cause == "mesh":
                errors = replace(errors, failed_causes=(cause,))
    return errors


def reason_of_failure(run: str, error: Exception) -> str:
    """Describe why a run gives no error (key refused or no solution)."""
    if isinstance(error, InputError):
        return f"{run} cannot be used, for its {error.key}"
    return f"{run} has no solution"


def solve_again(
    study: Study, omega: float, harmonics: int, initial: PeriodicSolution | None = None
) -> PeriodicSolution:
    """Solve a reduced study without stability (ConvergenceError without a solution)."""
    if study.contact is None:
        return solve_linear(study.structure, omega, harmonics=harmonics)
    return _solver(study, omega, harmonics).solve(initial)


def solve_orbit_or_in_steps(
    study: Study,
    omega: float,
    harmonics: int,
    initial: PeriodicSolution | None = None,
    *,
    by_orbit: bool,
) -> PeriodicSolution:
    """Solve a reduced study, by an exact orbit if ``by_orbit`` and if the search finds one.

    Otherwise solve with half the harmonics, and start all harmonics from this solution. Half the
    harmonics find a motion from rest in less time. If all harmonics do not converge, the first
    solution is returned.
    """
    if by_orbit:
        problem = _solver(study, omega, harmonics).problem
        if (orbit := search_initial_orbit(problem, initial).orbit) is not None:
            return truncated_orbit_solution(problem, orbit, orbit.coefficients(harmonics))
    n_first = max(harmonics // 2, least_harmonics(study.structure, 1))
    solution = solve_again(study, omega, n_first, initial)
    if study.contact is None:
        return solution
    solver = _solver(study, omega, harmonics)
    search, finer_solution = solver.search_and_solution(solution, with_whole_budget=False)
    return finer_solution if search.has_converged else solution


def _solver(study: Study, omega: float, harmonics: int) -> Solver:
    """Return a study's solver, with friction along the sliding directions."""
    assert study.contact is not None
    law = slide_along_lines(study.structure, omega, study.contact)
    return Solver(Problem(study.structure, omega, law, harmonics))
