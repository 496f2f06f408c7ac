"""Vary the causes of an answer's error, each alone.

The causes are named in :mod:`fenics_crack.basics.causes`. The contribution to an error is called
the cause's part. :mod:`stated` and :mod:`verify` use the estimates in this module:

*Harmonics.* If an exact orbit is close enough to the answer, the part is the distance to the
orbit's numbers. The limits are in :func:`fenics_crack.errors.numbers.find_accepted_orbit_or_none`.

*Friction.*

- If the answer has no friction, two exact orbits are compared, without and with friction. Both have
  few modes, and crack faces without mass. The part is 1.2 (c^2 + (s / 2)^2)^(1/2), but at least s,
  with a number's change c from orbit to orbit. s is the size of the motion's change, since extremes
  of both orbits may agree by chance
  (:func:`fenics_crack.errors.numbers.measure_absolute_changes_by_name`).
- If a solid has friction along a line at each pair, the part is 2 r times the change by friction.
  Here r is the frictionless motion's ratio of sliding across the lines to sliding along them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from fenics_crack.balance.harmonic_balance import (
    find_line_angles_and_turning,
    law_along_lines,
    motion_without_friction,
    search_orbit_by_harmonic_balance,
    slide_along_lines,
    solve_linear,
    truncated_orbit_solution,
)
from fenics_crack.balance.problem import Problem, least_harmonics
from fenics_crack.balance.solution import HarmonicBalanceSolver, PeriodicSolution
from fenics_crack.basics.causes import ERROR_CAUSES
from fenics_crack.basics.errors import InputError
from fenics_crack.errors.convergence import GridConvergence, PartOrReason
from fenics_crack.errors.numbers import (
    MotionQuantities,
    choose_n_orbit_harmonics,
    compute_numbers,
    compute_orbit_values_by_name,
    find_accepted_orbit_or_none,
    measure_absolute_changes_by_name,
)
from fenics_crack.errors.verification import Verification
from fenics_crack.model.contact import CoulombFriction, friction_of
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.structure import Structure
from fenics_crack.motion.orbit import PeriodicOrbit
from fenics_crack.study.prepare import SINGLE_COMPUTATION_FAILURES, Study, scene_contact_law

MODE_COUNT_FOR_FRICTION_EFFECT = 20
"""Number of modes to compute the effect of friction.

With 40 modes an orbit takes three times as long, and ten times if the search is hard.
"""
FRICTION_EFFECT_SAFETY_FACTOR = 1.2
"""Safety factor on a number's change by friction.

Chosen on 56 random scenes, and measured on 30 others against orbits with 80 modes: 86 true changes
were up to 1.14 times the stated error, 0.75 in the median.
"""
MOTION_CHANGE_WEIGHT = 0.5
"""Weight on the size of the motion's change in a number's error by friction."""
TRANSVERSE_SLIDING_SAFETY_FACTOR = 2.0
"""Safety factor on the error r |f_0 - f| due to sliding across friction lines.

A friction line is the direction along which a pair's friction acts. f is a quantity of the answer,
f_0 of the motion without friction; r is the ratio of sliding across the lines to sliding along
them. Measured in seven cases, against time steps with Coulomb's cone: true errors were 0.03 to 1.2
times the stated error.
"""
QUANTITY_NAMES_WITHOUT_FRICTION_ERROR = (
    "K_II_max", "K_III_max", "K_II_leading", "K_III_leading", "K_II_ratio",
)  # fmt: skip
"""Quantities without an estimated friction error: friction at the tip itself changes K_II, K_III.
"""
HARMONICS_NOT_VARIED_REASON = "without contact the motion has the harmonics of the load alone"
"""Printed reason why harmonics are not varied without contact."""


@dataclass(frozen=True)
class JudgedAnswer:
    """Hold a solution, the answer, and the data to estimate the errors of all quantities.

    A quantity is a number read from a motion, for example "amplitude". Subclasses estimate the
    errors by further runs: solutions with another mesh, more modes or more harmonics.

    Attributes
    ----------
    study : Study
        Study of the answer, with the answer's reduced structure.
    answer : PeriodicSolution
        Solution whose errors are sought.
    answer_values_by_name : dict of str to float
        Values of the answer's quantities by name.
    balance_solution : PeriodicSolution
        Solution to compare with further runs, with as many harmonics as the answer. In
        :mod:`verify`, and for an answer made from an exact orbit (:meth:`orbit_values_by_name`),
        this is the answer itself. Otherwise harmonic balance is solved again, starting from the
        answer.
    balance_quantities : Numbers
        Quantities of ``balance_solution``.
    """

    study: Study
    answer: PeriodicSolution
    answer_values_by_name: Mapping[str, float]
    balance_solution: PeriodicSolution
    balance_quantities: MotionQuantities

    def compute_values_by_name(
        self, motion: PeriodicSolution | PeriodicOrbit, study: Study | None = None
    ) -> dict[str, float]:
        """Return the values of a motion's quantities by name (collective).

        ``study`` must have the motion's structure; the default is the answer's study. Quantities
        equal to zero, except for rounding, are left out.
        """
        study, mode_number = study or self.study, self.balance_quantities.mode_number
        if isinstance(motion, PeriodicOrbit):
            return compute_orbit_values_by_name(study, self.answer, motion, mode_number)
        return compute_numbers(study, motion, mode_number).values_by_name

    @cached_property
    def orbit_values_by_name(self) -> dict[str, float] | None:
        """Values of the answer's exact orbit by quantity name (collective).

        An exact orbit is a periodic motion in time, without truncated harmonics. None if no orbit
        is close enough to the answer (:func:`find_accepted_orbit_or_none`).
        """
        orbit = find_accepted_orbit_or_none(self.answer)
        return None if orbit is None else self.compute_values_by_name(orbit)

    def estimate_harmonics_error_by_orbit(
        self, orbit_values_by_name: Mapping[str, float]
    ) -> PartOrReason:
        """Take the distance to the exact orbit as the error due to truncated harmonics.

        For a quantity, let f be the answer's value, and f_orbit the orbit's value. With safety
        factor 1, the error is abs(f - f_orbit).

        Parameters
        ----------
        orbit_values_by_name : mapping of str to float
            The orbit's values f_orbit by quantity name. A missing quantity counts as 0.

        Returns
        -------
        PartOrReason
            Harmonic counts in the answer and in the orbit; and the error by quantity name.
        """
        harmonic_counts_of_answer_and_orbit = (
            self.answer.harmonics,
            choose_n_orbit_harmonics(self.answer),
        )
        reciprocal_counts = (
            1.0 / harmonic_counts_of_answer_and_orbit[1],
            1.0 / harmonic_counts_of_answer_and_orbit[0],
        )
        convergence_by_name = {}
        for name, value in self.compute_values_by_name(self.answer).items():
            orbit_value = orbit_values_by_name.get(name, 0.0)
            convergence_by_name[name] = GridConvergence(
                reciprocal_counts,
                (orbit_value, value),
                "exact orbit",
                factor=1.0,
                extrapolated=orbit_value,
            )
        return harmonic_counts_of_answer_and_orbit, convergence_by_name

    def estimate_error_by_friction(self) -> PartOrReason:
        """Estimate the error due to neglected friction (collective).

        If the answer has no friction, two exact orbits are compared. The first orbit has no
        friction, the second has the friction coefficient ``contact.friction_error``. A solid's
        answer may include friction along a fixed line at each contact pair. Then the error follows
        from the sliding across these lines.

        Returns
        -------
        PartOrReason
            Mode counts in both runs, and the error by quantity name. Without an error estimate, the
            result is a text with the reason. The text is empty in two cases: no pair touches, or
            the scene sets ``contact.friction`` and the answer has no friction lines.
        """
        study, scene, answer = self.study, self.study.scene, self.answer
        contact_law, structure = study.contact, study.structure
        if contact_law is None or not np.any(answer.contact_force(answer.instants()) > 0.0):
            return ""
        if (friction_law_of_answer := friction_of(contact_law)) is not None:
            return (
                ""
                if friction_law_of_answer.direction is None
                else self._estimate_sliding_across_lines(friction_law_of_answer)
            )
        contact_table = scene.given("contact")
        if contact_table.friction is not None:
            return ""
        if not (friction_coefficient := contact_table.friction_error):
            return "contact.friction_error = false"
        if contact_table.layer_depth is not None:
            return "the effect of friction is not estimated with contact.layer_depth"
        tangential_structure = structure.whole.with_tangents()
        if scene.disk is not None or tangential_structure.tangential is None:
            return "the effect of friction is estimated for single plates and solids only"
        scene_changes_for_friction: dict[str, Any] = {
            "contact.friction": friction_coefficient,
            "output.quantities": None,
        }
        scene_changes_for_friction["harmonic_balance.form"] = "condensed"
        if (
            not structure.has_massless_crack_faces
        ):  # faces with mass, in contact as stiff along them as across
            scene_changes_for_friction["contact.tangential_stiffness_per_area"] = (
                contact_table.stiffness_per_area
            )
        orbits, values_of_orbits = self._find_orbits_without_and_with_friction(
            tangential_structure, scene_changes_for_friction
        )
        if len(orbits) < 2:
            return "no exact orbit was found from solutions with 5 to 40 harmonics"
        change_by_name = measure_absolute_changes_by_name(study, *orbits)
        friction_coefficients, convergence_by_name = (0.0, float(friction_coefficient)), {}
        for quantity_name, value in self.answer_values_by_name.items():
            if quantity_name in QUANTITY_NAMES_WITHOUT_FRICTION_ERROR:
                continue
            relative_change = _relative_change(quantity_name, *values_of_orbits)
            motion_change = change_by_name.get(quantity_name, 0.0)
            frictionless_size = abs(values_of_orbits[0].get(quantity_name, 0.0)) or np.inf
            motion_change /= frictionless_size
            relative_error_of_quantity = max(
                FRICTION_EFFECT_SAFETY_FACTOR
                * math.hypot(relative_change, MOTION_CHANGE_WEIGHT * motion_change),
                motion_change,
            )
            answer_and_changed_value = value, value * (1.0 + relative_change)
            safety_factor = (
                relative_error_of_quantity / abs(relative_change) if relative_change else 1.0
            )
            convergence_by_name[quantity_name] = GridConvergence(
                friction_coefficients,
                answer_and_changed_value,
                "two parameter values",
                factor=safety_factor,
            )
        n_modes = orbits[0].flow.n_modes
        return (n_modes, n_modes), convergence_by_name

    def _find_orbits_without_and_with_friction(
        self, whole_structure: Structure, scene_changes_for_friction: Mapping[str, Any]
    ) -> tuple[list[PeriodicOrbit], list[dict[str, float]]]:
        """Find exact orbits without and with friction (collective).

        The orbits have 20 modes (:data:`MODE_COUNT_FOR_FRICTION_EFFECT`), or half the structure's
        dofs if these are fewer.

        Parameters
        ----------
        whole_structure : Structure
            Unreduced structure with tangential gaps at the contact pairs.
        scene_changes_for_friction : dict of str to object
            Changed values by scene key, for the orbit with friction.

        Returns
        -------
        orbits : list of PeriodicOrbit
            Orbit without friction, then with friction. If the second search fails, only the first
            orbit; if the first search fails, an empty list.
        values_of_orbits : list of dict of str to float
            For each orbit, the values by quantity name.
        """
        study, answer, n_periods = self.study, self.answer, self.answer.subharmonic
        n_modes = min(MODE_COUNT_FOR_FRICTION_EFFECT, whole_structure.n_dofs // 2)
        reduced_structure = reduce_structure(
            whole_structure, modes=n_modes, method="massless", reference=False
        )
        orbits, values_of_orbits = list[PeriodicOrbit](), list[dict[str, float]]()
        for unaligned_law in (
            study.contact,
            scene_contact_law(study.scene.replace(scene_changes_for_friction), reduced_structure),
        ):
            assert unaligned_law is not None
            contact_law = law_along_lines(reduced_structure, unaligned_law, lambda _: orbits[0])
            balance_problem = Problem(
                reduced_structure, answer.omega, contact_law, n_periods, subharmonic=n_periods
            )
            orbit = search_orbit_by_harmonic_balance(balance_problem, answer).orbit
            if orbit is None:
                break
            orbit_study = replace(study, structure=reduced_structure, contact=contact_law)
            orbits.append(orbit)
            values_of_orbits.append(self.compute_values_by_name(orbit, orbit_study))
        return orbits, values_of_orbits

    def _estimate_sliding_across_lines(self, friction_law: CoulombFriction) -> PartOrReason:
        """Estimate the error due to sliding across a solid's friction lines (collective).

        A friction line is the fixed direction in which friction acts at a contact pair. Sliding
        across the line is neglected. Let f be the answer's quantity, and f_0 the quantity in the
        motion without friction. In this frictionless motion, r is the ratio of sliding across the
        lines to sliding along the lines. The error is 2 r |f_0 - f|.

        Parameters
        ----------
        friction_law : CoulombFriction
            The answer's friction law, with the friction lines.

        Returns
        -------
        PartOrReason
            Mode counts for both motions, two equal numbers; and the error by quantity name.
        """
        study, answer = self.study, self.answer
        structure, n_periods = study.structure, answer.subharmonic
        frictionless_motion = motion_without_friction(
            structure, answer.omega, friction_law.law, n_periods
        )
        frictionless_values = self.compute_values_by_name(
            frictionless_motion, replace(study, contact=friction_law.law)
        )
        across_to_along_sliding_ratio = find_line_angles_and_turning(
            frictionless_motion, friction_law.direction
        )[1]
        convergence_by_name = {}
        for quantity_name, value in self.answer_values_by_name.items():
            value_with_turning = value + across_to_along_sliding_ratio * (
                frictionless_values.get(quantity_name, 0.0) - value
            )
            convergence_by_name[quantity_name] = GridConvergence(
                (0.0, 1.0),
                (value, value_with_turning),
                "two parameter values",
                factor=TRANSVERSE_SLIDING_SAFETY_FACTOR,
            )
        return (structure.n_modes, structure.n_modes), convergence_by_name


def _relative_change(
    quantity_name: str,
    values_by_name: Mapping[str, float],
    other_values_by_name: Mapping[str, float],
) -> float:
    """Return the relative change of a quantity from one motion to another.

    The change is f_2 / f_1 - 1, with f_1 in ``values_by_name`` and f_2 in
    ``other_values_by_name``; 0 if f_1 is 0. A missing value counts as 0.
    """
    value = values_by_name.get(quantity_name, 0.0)
    return other_values_by_name.get(quantity_name, 0.0) / value - 1.0 if value else 0.0


def add_error_parts(
    verification: Verification, part_function_by_cause: Mapping[str, Callable[[], PartOrReason]]
) -> Verification:
    """Return a verification with each cause's error part added (collective).

    A cause's part is the contribution to each quantity's error. If the run for a cause is refused
    or does not converge, the contribution is recorded as unknown. If the run for "mesh" fails, all
    total errors become unknown.

    Parameters
    ----------
    verification : Verification
        Verification to extend; stays unchanged.
    part_function_by_cause : mapping of str to callable
        Function by cause in :data:`ERROR_CAUSES`. Each returns the part, or a text with the reason
        for no part.
    """
    for cause, find_part_or_reason in part_function_by_cause.items():
        try:
            verification = verification.with_part(cause, find_part_or_reason())
        except SINGLE_COMPUTATION_FAILURES as error:
            verification = verification.with_unknown(
                cause, describe_failed_run(ERROR_CAUSES[cause].varied_run_text, error)
            )
            if cause == "mesh":
                verification = replace(verification, failed_causes=(cause,))
    return verification


def describe_failed_run(run_text: str, error: Exception) -> str:
    """Describe a failed run: refused because of a scene key, or not converged.

    ``run_text`` names the run, such as "a run with more modes".
    """
    if isinstance(error, InputError):
        return f"{run_text} is refused because of {error.key}"
    return f"{run_text} did not converge"


def solve_without_stability(
    study: Study, omega: float, n_harmonics: int, start_solution: PeriodicSolution | None = None
) -> PeriodicSolution:
    """Solve a study by harmonic balance, without a verdict on stability (collective).

    Without contact the linear solution is returned. ConvergenceError if nothing converges.

    Parameters
    ----------
    study : Study
        Study with a reduced structure.
    omega : float [rad/s]
        Load frequency, in place of the scene's.
    n_harmonics : int
        Number of harmonics.
    start_solution : PeriodicSolution, optional
        Start for the search; by default the linear response.
    """
    if study.contact is None:
        return solve_linear(study.structure, omega, harmonics=n_harmonics)
    return _make_solver(study, omega, n_harmonics).solve(start_solution)


def solve_by_orbit_or_harmonics(
    study: Study,
    omega: float,
    n_harmonics: int,
    start_solution: PeriodicSolution | None = None,
    *,
    answer_orbit: PeriodicOrbit | None,
) -> PeriodicSolution:
    """Solve a reduced study by an exact orbit, or by harmonic balance (collective).

    An exact orbit is a periodic motion in time, without truncated harmonics. If ``answer_orbit`` is
    given, an exact orbit of the study is sought first. If the search succeeds, the solution has the
    Fourier coefficients of this orbit.

    Otherwise harmonic balance is solved twice: with half the harmonics, then with all, starting
    from the first solution. From rest this takes less time than a single solution with all
    harmonics. If the second step does not converge, return the first solution.

    Parameters
    ----------
    study : Study
        Study with a reduced structure.
    omega : float [rad/s]
        Load frequency, in place of the scene's.
    n_harmonics : int
        The solution's number of harmonics.
    start_solution : PeriodicSolution, optional
        Start for the search; by default the linear response.
    answer_orbit : PeriodicOrbit or None
        The answer's exact orbit. If this orbit is stable, the search prefers a stable orbit.
    """
    if answer_orbit is not None:
        problem = _make_solver(study, omega, n_harmonics).problem
        orbit = search_orbit_by_harmonic_balance(
            problem, start_solution, prefer_stable=answer_orbit.is_stable
        ).orbit
        if orbit is not None:
            return truncated_orbit_solution(problem, orbit, orbit.coefficients(n_harmonics))
    n_first_harmonics = max(n_harmonics // 2, least_harmonics(study.structure, 1))
    half_harmonics_solution = solve_without_stability(
        study, omega, n_first_harmonics, start_solution
    )
    if study.contact is None:
        return half_harmonics_solution
    balance_solver = _make_solver(study, omega, n_harmonics)
    search_outcome, all_harmonics_solution = balance_solver.search_and_solution(
        half_harmonics_solution, with_whole_budget=False
    )
    return all_harmonics_solution if search_outcome.has_converged else half_harmonics_solution


def _make_solver(study: Study, omega: float, n_harmonics: int) -> HarmonicBalanceSolver:
    """Make the harmonic-balance solver for a study at ``omega`` [rad/s].

    In a solid, friction acts along each pair's main sliding direction (:func:`slide_along_lines`).
    """
    assert study.contact is not None
    contact_law = slide_along_lines(study.structure, omega, study.contact)
    return HarmonicBalanceSolver(Problem(study.structure, omega, contact_law, n_harmonics))
