"""State the errors of an answer by an additional run per cause.

The errors are expected values, not bounds. docs/notebook/stated_errors.md compares the errors with
runs on a mesh four times finer. Let f be a number of the answer, e the error and w the load
frequency. The causes are:

- *modes*. A second reduced structure, the reference, has more modes and gives the number f_ref.
  By assumption the added modes remove the fraction s of the truncation error: e = |f - f_ref| / s.
  If both solutions have a close exact orbit, f_ref - f is the change between orbits. The reason:
  with few harmonics, all modes above the harmonics seem static. A change may be small by chance,
  if the remaining modes have a different phase. So e is at least the motion's size of change
  (:mod:`numbers`) over s.
- *harmonics*. An exact orbit close enough to the answer gives e = |f - f_orbit|; limits in
  :func:`fenics_crack.errors.numbers.find_accepted_orbit_or_none`. Without an orbit, solve with
  twice the harmonics. If the report's truncation error is large, the difference may vanish by
  chance: solve with four times the harmonics, too, and take the larger error.
- *mesh*. A coarser mesh, with the ratio r of element lengths, gives f_r and e below.
- *friction* and further parameters. See :mod:`case`.

A coarser mesh mainly shifts the resonances. Near a resonance a small shift raises or lowers a
number much, so differences may vanish by chance. Hence no number is extrapolated across a
resonance, and two signed parts are added:

- The shape error: the change by the mesh at equal distance from the resonance. The coarse mesh is
  solved at w w_r / w_b, with the resonance w_r on the coarse mesh and w_b on the answer's mesh.
- The shift error: the change because the resonance moves. The answer's mesh is solved at
  w w_b / w_e, with the extrapolated resonance w_e. Several values of w_e are tried, each time from
  rest, as several motions may exist.

The resonance belongs to the mode with the largest effect on the watched points. At half a resonance
the second harmonic matters, and a different mode may be nearer to the load. Let f(x) be the number
at load frequency x. The order p lies between 1, the order at crack tips, and the elements' best
order:

    e = max over p of |(f - f_r) / (r^p - 1) + f(w w_b / w_e(p)) - f|.

Further parts are added as the root of the sum of squares:

- A tenth of the smaller part, as parts that cancel are uncertain.
- The change with a shifted clearance. Under a preload or mean load a crack closes pair by pair, and
  the closed part ends between two pairs. The shift is half the gap's step between pairs, times the
  part of the period with both open and closed pairs.
- The displacement added by half as long elements under a point force, which has no limit.
- For stress intensities K, the error of K_I computed while a solid's front is closed. In addition,
  e is at least the largest change of K along the front, extrapolated from both meshes.

All harmonics are kept on the coarser mesh: near half a resonance, half the harmonics may move the
answer as much as the mesh does.

The contact duty cycle is counted at equal instants in all runs. The exact orbit's switching
instants give the error; without an orbit the part of a single instant is added.

The total is the root of the sum of squares for independent causes, otherwise the sum.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from operator import methodcaller

import numpy as np

from fenics_crack.balance.error_report import (
    LARGE_ERROR,
    MIN_HARMONICS_FOR_MODAL_CHANGE,
    ErrorReport,
)
from fenics_crack.balance.more_modes import more_modes_structure_of
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.causes import ERROR_CAUSES_IF_REDUCED, STATED_ERROR_CAUSES
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.observables import Place, observable_names
from fenics_crack.basics.tables import choose_frequency_factor_name_unit
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.errors.case import (
    HARMONICS_NOT_VARIED_REASON,
    JudgedAnswer,
    add_error_parts,
    describe_failed_run,
    solve_by_orbit_or_harmonics,
    solve_without_stability,
)
from fenics_crack.errors.convergence import (
    MAX_RELATIVE_ROUNDING_SPREAD,
    TIP_CONVERGENCE_ORDER,
    GridConvergence,
    PartOrReason,
    estimate_error_part_from_runs,
)
from fenics_crack.errors.numbers import (
    add_changes,
    compute_numbers,
    find_bilinear_omega,
    measure_absolute_changes_by_name,
    natural_frequency_name,
)
from fenics_crack.errors.verification import Verification, displacement_added_by_halved_elements
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.modes import (
    BilinearFrequencies,
    Modes,
    bilinear_frequencies,
    solve_bonded_modes,
    solve_modes,
)
from fenics_crack.model.reduced import ReducedStructure
from fenics_crack.model.rotation import RunUpStructure
from fenics_crack.motion.orbit import PeriodicOrbit
from fenics_crack.study.meshes import prepare_coarser_study_or_reason
from fenics_crack.study.observer import (
    estimate_closed_front_and_mesh_errors,
    make_requested_rows_and_readers,
)
from fenics_crack.study.prepare import SINGLE_COMPUTATION_FAILURES, Study, prepare, reduce_study
from fenics_crack.study.resonance import (
    N_RESONANCE_SEARCH_MODES,
    UNSOUGHT_RESONANCE,
    ResonanceUnderLoad,
    find_study_resonance,
)

HARMONIC_COUNT_FACTORS = 2, 4
"""Factors on the answer's number of harmonics, for two runs to estimate the truncation error.

The second run is made only if the answer's error report has a truncation error above
:data:`LARGE_ERROR`, 5 %.
"""
MIN_NUMBER_OF_TRIED_RESONANCES, MAX_NUMBER_OF_TRIED_RESONANCES = 3, 8
"""Minimum and maximum number of extrapolated resonances w_e tried for the shift error."""
MOVED_ENERGY_WEIGHT = 0.6
"""Relative error of a displacement at a resonance per share of the energy that more modes move.

Between 20 and 160 modes, true errors of stable motions were 0.1 to 1.1 times the moved share times
the power factor (``benchmarks/energy.py``).
"""
MAX_MODES_FOR_MESH_ERROR = 50
"""Maximum number of modes in the runs for a mesh error.

With 120 modes the breathing plate's orbits take 14 times as long; the mesh error changes by less
than the modal error.
"""
ADDED_FRACTION_OF_CANCELLING_ERROR = 0.1
"""Fraction of the smaller error, shape or shift, added as uncertainty: both may cancel."""
Motion = PeriodicOrbit | PeriodicSolution
"""Motion with quantities to compare: an exact orbit or a harmonic-balance solution."""


def estimate_result_errors(study: Study, result: object) -> Verification | None:
    """Estimate the stated errors of a result (collective).

    Stated errors exist for three kinds:

    - natural modes,
    - a converged solution with an error report,
    - a curve over frequency or speed; the errors belong to the largest response.

    A largest response inside the curve is a peak, and moves with the resonance. For any further
    result, return None.
    """
    if isinstance(result, Modes):
        return estimate_frequency_mesh_errors(study, {"open": result.omega})
    if isinstance(result, ResponseCurve) and result.parameter in ("omega", "speed"):
        largest_response = result.top(study.watched[0].dof)
        solution = result.solution(largest_response.index)
        if not isinstance(solution.structure, RunUpStructure):
            return estimate_solution_errors(study, solution, is_peak=not largest_response.at_end)
        return _estimate_run_up_errors(
            study, solution, solution.structure, is_peak=not largest_response.at_end
        )
    if isinstance(result, PeriodicSolution) and result.converged and result.report.estimated:
        return estimate_solution_errors(study, result)
    return None


def _estimate_run_up_errors(
    study: Study, solution: PeriodicSolution, structure: RunUpStructure, *, is_peak: bool
) -> Verification:
    """Estimate the errors of a solution in a run-up (collective).

    In a run-up the load frequency follows the rotor speed W [rad/s]. The scene is solved again at
    the solution's speed, held constant, with as many modes as before. This second solution's errors
    are returned. A further quantity is added: "speed", the speed at resonance. The speed's error
    follows from the resonance frequency w. If w has the relative error e, the speed has the
    relative error e / (1 - s), with s = d ln w / d ln W.

    Parameters
    ----------
    study : Study
        Study for the run-up.
    solution : PeriodicSolution
        Solution at a speed in the run-up.
    structure : RunUpStructure
        The solution's structure, at the solution's speed.
    is_peak : bool
        True if the solution is the curve's peak and moves with the resonance.
    """
    speed, detuning_per_speed = structure.speed, 1.0 - structure.stiffening_exponent(solution.omega)
    changed_scene_values_by_key = {
        "rotation.speed": speed,
        "excitation.omega": solution.omega,
        "curve": None,
    }
    fixed_speed_study = prepare(
        study.scene.replace(changed_scene_values_by_key), structure.whole.comm, like=study
    )
    fixed_speed_solution = solve_without_stability(
        fixed_speed_study, solution.omega, solution.harmonics, solution
    )
    verification = estimate_solution_errors(
        fixed_speed_study, fixed_speed_solution, is_peak=is_peak
    )
    if (resonance_name := verification.resonance) not in verification.values:
        return verification
    resonance_value = verification.values[resonance_name]

    def speed_at_resonance(frequency: float) -> float:
        """Return the speed [rad/s] at resonance, for a changed resonance frequency."""
        return speed * (1.0 + (frequency / resonance_value - 1.0) / detuning_per_speed)

    def convert_to_speed(convergence: GridConvergence) -> GridConvergence:
        """Convert a resonance frequency's convergence to the speed's convergence."""
        extrapolated_speed = speed_at_resonance(convergence.extrapolated)
        return replace(
            convergence,
            values=tuple(map(speed_at_resonance, convergence.values)),
            extrapolated=extrapolated_speed,
        )

    return replace(
        verification,
        values=verification.values | {"speed": speed},
        units=verification.units | {"speed": "rad/s"},
        parts={
            cause: convergence_by_name
            | {"speed": convert_to_speed(convergence_by_name[resonance_name])}
            for cause, convergence_by_name in verification.parts.items()
        },
    )


def estimate_frequency_mesh_errors(
    study: Study,
    omega_by_kind: Mapping[str, np.ndarray],
    load_resonance: ResonanceUnderLoad = UNSOUGHT_RESONANCE,
    squared_omega_slopes: np.ndarray | None = None,
) -> Verification:
    """Estimate mesh errors of natural frequencies and the load's resonance (collective).

    All quantities are computed again on a coarser mesh. Without a coarser mesh, the cause "mesh" is
    unknown, and the result has the reason.

    Parameters
    ----------
    study : Study
        Study with the unreduced structure.
    omega_by_kind : dict of str to (m,) [rad/s]
        Natural frequencies for m modes, with crack faces "open" and "tied" (bonded).
    load_resonance : ResonanceUnderLoad
        Resonance under the load on the same structure. Frequency and amplitude at resonance
        (``load_resonance.numbers``) are included in the result.
    squared_omega_slopes : (m,), optional
        Slope d(w^2) / d(W^2) for each mode, with the natural frequency w and the rotor speed W,
        from :func:`find_key_figures`. If None, the load's resonance is not computed on the coarser
        mesh.
    """
    scene = study.scene
    unit_factor, _, unit = choose_frequency_factor_name_unit(scene.is_frequency_in_hertz)

    def name_frequencies(kind_omegas: Mapping[str, np.ndarray]) -> dict[str, float]:
        """Return frequencies by name, in the scene's unit; 0 and inf are left out."""
        return {
            natural_frequency_name(scene, kind, mode_number): unit_factor * float(omega)
            for kind, omega_of_modes in kind_omegas.items()
            for mode_number, omega in enumerate(omega_of_modes, 1)
            if 0.0 < omega < np.inf
        }

    def estimate_error_by_mesh() -> PartOrReason:
        """Estimate errors from the coarser mesh; without a coarser mesh, return the reason."""
        coarse_study_or_reason = prepare_coarser_study_or_reason(study)
        if isinstance(coarse_study_or_reason, str):
            return coarse_study_or_reason
        coarse_study, element_counts, length_ratio = coarse_study_or_reason
        n_modes = max(map(len, omega_by_kind.values()))
        n_computed_modes = n_modes  # those of the resonance search, at once
        if load_resonance.numbers:
            n_computed_modes = min(
                max(n_modes, N_RESONANCE_SEARCH_MODES), coarse_study.structure.n_modes
            )
        coarse_modes = solve_modes(coarse_study.structure, n_computed_modes)
        coarse_omega_by_kind = {"open": coarse_modes.omega[:n_modes]}
        if "tied" in omega_by_kind:
            coarse_omega_by_kind["tied"] = solve_bonded_modes(coarse_study.structure, n_modes).omega
        coarse_mesh_values = name_frequencies(coarse_omega_by_kind)
        if load_resonance.numbers and squared_omega_slopes is not None:
            coarse_bilinear = BilinearFrequencies(
                coarse_omega_by_kind["open"], coarse_omega_by_kind["tied"]
            )
            coarse_mesh_values |= find_study_resonance(
                coarse_study, coarse_bilinear.omega_bilinear, squared_omega_slopes
            ).numbers
        counts_and_values = zip(element_counts, (values_by_name, coarse_mesh_values), strict=True)
        return estimate_error_part_from_runs(
            "mesh", [*counts_and_values], scene, size_ratio=length_ratio
        )

    values_by_name = name_frequencies(omega_by_kind) | load_resonance.numbers
    verification = Verification(scene, values_by_name, dict.fromkeys(values_by_name, unit))
    return add_error_parts(verification, {"mesh": estimate_error_by_mesh})


def estimate_solution_errors(
    study: Study,
    answer: PeriodicSolution,
    *,
    is_peak: bool = False,
    causes: Sequence[str] = STATED_ERROR_CAUSES,
) -> Verification:
    """Estimate the expected errors of a solution's quantities by cause (collective).

    Parameters
    ----------
    study : Study
        Study of the solution, with the solution's structure.
    answer : PeriodicSolution
        Solution to judge.
    is_peak : bool
        True if the answer is a curve's peak over frequency, which moves with the resonance.
    causes : sequence of str
        Causes to vary, from :data:`STATED_ERROR_CAUSES`.

    Returns
    -------
    Verification
        Errors by cause and quantity. If a cause contributes nothing, the reason is in the attribute
        ``absent``. If a contribution is unknown, the reason is in ``unknown``. A cause without a
        meaning for the scene is left out. In two cases no errors are estimated: the structure is
        large and not reduced, or the answer's error report is unknown.
    """
    numbers = compute_numbers(study, answer)
    verification = Verification(study.scene, numbers.values_by_name, numbers.unit_by_name)
    if not is_small(study.structure):  # three more solutions take three times as long
        reason_by_cause = dict.fromkeys(
            ERROR_CAUSES_IF_REDUCED,
            "errors are estimated for reduced structures only; set reduction.method",
        )
        return replace(verification, unknown=reason_by_cause)
    if answer.report.unknown:  # other runs may agree by chance
        return verification.with_unknown("harmonics", describe_unknown_error_part(answer.report))
    balance_solution, balance_quantities = answer, numbers
    if answer.orbit is None:
        try:
            balance_solution = solve_without_stability(
                study, answer.omega, answer.harmonics, answer
            )
        except SINGLE_COMPUTATION_FAILURES as error:
            reason_text = describe_failed_run("harmonic balance from this solution", error)
            return verification.with_unknown("harmonics", reason_text)
        balance_quantities = compute_numbers(study, balance_solution, numbers.mode_number)
    judged_answer = AnswerJudgedByExtraRuns(
        study, answer, numbers.values_by_name, balance_solution, balance_quantities, is_peak
    )
    return add_error_parts(
        verification,
        {cause: getattr(judged_answer, f"estimate_error_by_{cause}") for cause in causes},
    )


def find_largest_modal_error(study: Study, solution: PeriodicSolution) -> float:
    """Return the largest relative error expected from truncated modes (collective).

    The maximum is over the crack opening and the amplitudes at watched points. The result is inf
    if the error is unknown, and 0 if no quantity has an error.
    """
    verification = estimate_solution_errors(study, solution, causes=["modes"])
    compared_names = [*(point.column_name("amplitude") for point in study.watched), "opening"]
    if verification.unknown:
        return math.inf
    stated_names = [
        name for name in compared_names if verification.parts and verification.values.get(name)
    ]
    return max((verification.stated(name)[0] for name in stated_names), default=0.0)


def describe_unknown_error_part(report: ErrorReport) -> str:
    """Describe in a phrase an error without an estimate.

    ``report`` is an error report with unknown error. The phrase names the largest cause in the
    report.
    """
    part_name = report.largest_part
    text_by_part = {"truncation": "truncated harmonics", "reduction": "truncated modes"}
    return f"the error due to the {text_by_part.get(part_name, part_name)} could not be estimated"


@dataclass(frozen=True)
class AnswerJudgedByExtraRuns(JudgedAnswer):
    """Estimate each cause's part in an answer's error by an additional run.

    Attributes
    ----------
    is_peak : bool
        True if the answer is a curve's peak, which moves with the resonance.
    """

    is_peak: bool

    def estimate_error_by_modes(self) -> PartOrReason:
        """Estimate the error due to truncated modes from a motion with more modes (collective).

        By assumption the added modes remove a fraction s of the truncation error. So a quantity's
        error is the change by the added modes, divided by s. A quantity may stay nearly equal by
        chance although the motion changes. So the change is at least the motion's size of change
        (:func:`measure_absolute_changes_by_name`).

        A solution with few harmonics treats added modes above the highest harmonic nearly as
        static. If both motions have few harmonics, the error is therefore at least the error due to
        harmonics.

        Returns
        -------
        PartOrReason
            Mode counts in both motions, and the error by quantity name. If all modes are kept, a
            text with this reason.
        """
        structure = self.study.structure
        structure_with_more_modes = more_modes_structure_of(self.balance_solution)
        if structure_with_more_modes is None:
            return "all modes are kept"
        assert isinstance(structure, ReducedStructure)
        larger_study = replace(self.study, structure=structure_with_more_modes)
        motion_with_kept_modes, motion_with_more_modes = (
            self._find_motions_with_kept_and_more_modes(larger_study)
        )
        has_truncated_harmonics = isinstance(motion_with_more_modes, PeriodicSolution)
        orbit_values_or_none = None if has_truncated_harmonics else self.orbit_values_by_name
        values_with_more_modes = add_changes(
            self.balance_quantities.values_by_name,
            orbit_values_or_none or self.compute_values_by_name(motion_with_kept_modes),
            self.compute_values_by_name(motion_with_more_modes, larger_study),
        )
        change_lower_bound_by_name = measure_absolute_changes_by_name(
            self.study, motion_with_kept_modes, motion_with_more_modes
        )
        share = structure.error_share_removed_by_reference
        for name, error in self._energy_errors(
            motion_with_kept_modes, motion_with_more_modes
        ).items():
            change_lower_bound_by_name[name] = max(
                change_lower_bound_by_name.get(name, 0.0), share * error
            )
        if (
            has_truncated_harmonics
            and self._can_search_massless_orbits
            and not isinstance(self.harmonics_error_part_or_reason, str)
        ):
            for quantity_name, convergence in self.harmonics_error_part_or_reason[1].items():
                change_lower_bound = (
                    structure.error_share_removed_by_reference * convergence.uncertainty(-1)
                )
                change_lower_bound_by_name[quantity_name] = max(
                    change_lower_bound_by_name.get(quantity_name, 0.0), change_lower_bound
                )
        mode_counts = (len(structure.omega), len(structure_with_more_modes.omega))
        remaining_error_fraction = 1.0 - structure.error_share_removed_by_reference
        counts_and_values = zip(
            mode_counts,
            (self.balance_quantities.values_by_name, values_with_more_modes),
            strict=True,
        )
        _, convergence_by_name = estimate_error_part_from_runs(
            "modes",
            [*counts_and_values],
            self.study.scene,
            size_ratio=max(remaining_error_fraction, MAX_RELATIVE_ROUNDING_SPREAD),
        )
        for quantity_name, change_lower_bound in change_lower_bound_by_name.items():
            error = (
                convergence_by_name[quantity_name].uncertainty(-1)
                if quantity_name in convergence_by_name
                else 0.0
            )
            if 0.0 < error < change_lower_bound / structure.error_share_removed_by_reference:
                convergence_by_name[quantity_name] = replace(
                    convergence_by_name[quantity_name],
                    factor=change_lower_bound / structure.error_share_removed_by_reference / error,
                )
        return mode_counts, convergence_by_name

    def _energy_errors(self, motion: Motion, larger_motion: Motion) -> dict[str, float]:
        """Return 0.6 W / S m |f| for each number f that grows with the motion, by name.

        m is the share of the load's work that added modes move elsewhere, W / S the power factor
        (:mod:`fenics_crack.motion.energy`).
        """
        budgets = [motion.energy_budget, larger_motion.energy_budget]
        if budgets[0] is None or budgets[1] is None or not budgets[0].load > 0.0:
            return {}
        moved_share = budgets[0].moved_share(budgets[1])
        error = MOVED_ENERGY_WEIGHT * budgets[0].power_factor * moved_share
        amplitude_names = [point.column_name("amplitude") for point in self.study.watched]
        values = self.balance_quantities.values_by_name
        names = [name for name in (*amplitude_names, "opening", "crack_force") if name in values]
        return {name: error * abs(values[name]) for name in names}

    def _find_motions_with_kept_and_more_modes(self, larger_study: Study) -> tuple[Motion, Motion]:
        """Find a motion with the kept modes, and a motion with more modes (collective).

        Used to compare both motions. If possible, both are exact orbits next to the answer:
        periodic motions without truncated harmonics. The second orbit may not be found. If the
        answer has less than 40 harmonics per load period (:data:`MIN_HARMONICS_FOR_MODAL_CHANGE`),
        a step of Newton's method from the first orbit replaces the second orbit.

        Without orbits, both motions are harmonic-balance solutions with equal numbers of harmonics.
        If crack faces have no mass and orbits are found quickly, the number is at least 40 per load
        period.

        Parameters
        ----------
        larger_study : Study
            Study with the larger number of modes.

        Returns
        -------
        base_motion : PeriodicOrbit or PeriodicSolution
            Motion with the kept modes.
        motion_with_more_modes : PeriodicOrbit or PeriodicSolution
            Motion with more modes.
        """
        balance_solution, assessment = self.balance_solution, self.answer.assessment
        min_harmonics = MIN_HARMONICS_FOR_MODAL_CHANGE * balance_solution.subharmonic
        if assessment.can_search_orbit and (larger_assessment := assessment.more_modes):
            has_few_harmonics = (
                self.answer.orbit is None and balance_solution.harmonics < min_harmonics
            )
            if (
                motion := larger_assessment.orbit_or_corrected_motion
                if has_few_harmonics
                else larger_assessment.orbit
            ):
                return larger_assessment.orbit_with_fewer_modes, motion
        if self._can_search_massless_orbits and balance_solution.harmonics < min_harmonics:
            balance_solution = solve_without_stability(
                self.study, balance_solution.omega, min_harmonics, balance_solution
            )
        start_solution = (
            balance_solution if self.study.structure.has_massless_crack_faces else None
        )  # else it has other coordinates
        return balance_solution, solve_without_stability(
            larger_study, balance_solution.omega, balance_solution.harmonics, start_solution
        )

    @property
    def _can_search_massless_orbits(self) -> bool:
        """True if crack faces have no mass, and a search for exact orbits does not take long."""
        return (
            self.answer.assessment.can_search_orbit
            and self.study.structure.has_massless_crack_faces
        )

    def estimate_error_by_harmonics(self) -> PartOrReason:
        """Estimate the error due to truncated harmonics (collective).

        The error is the distance to the answer's exact orbit, if one is close enough
        (:func:`~fenics_crack.errors.numbers.find_accepted_orbit_or_none`). Otherwise the error is
        the distance to a run with twice the harmonics. If the error report states a truncation
        error above 5 %, a run with four times the harmonics follows. The larger distance then
        counts.

        Returns
        -------
        PartOrReason
            Harmonic counts in both runs, and the error by quantity name. Without contact, a text
            with the reason for no error.
        """
        return self.harmonics_error_part_or_reason

    @cached_property
    def harmonics_error_part_or_reason(self) -> PartOrReason:
        """Result of :meth:`estimate_error_by_harmonics`, computed once (collective)."""
        if self.study.contact is None:
            return HARMONICS_NOT_VARIED_REASON
        if self.orbit_values_by_name is not None:
            return self.estimate_harmonics_error_by_orbit(self.orbit_values_by_name)
        n_harmonics_of_answer = self.balance_solution.harmonics
        solution = self.balance_solution
        convergences_of_factors = []
        n_runs = 2 if self.answer.report.truncation > LARGE_ERROR else 1
        for harmonic_count_factor in HARMONIC_COUNT_FACTORS[:n_runs]:
            solution = solve_without_stability(
                self.study,
                self.balance_solution.omega,
                harmonic_count_factor * n_harmonics_of_answer,
                solution,
            )
            counts_and_values = (
                (n_harmonics_of_answer, self.balance_quantities.values_by_name),
                (
                    harmonic_count_factor * n_harmonics_of_answer,
                    self.compute_values_by_name(solution),
                ),
            )
            _, convergence_by_name = estimate_error_part_from_runs(
                "harmonics",
                counts_and_values,
                self.study.scene,
                size_ratio=1.0 / harmonic_count_factor,
            )
            convergences_of_factors.append(convergence_by_name)
        select_largest_uncertainty = partial(max, key=methodcaller("uncertainty"))
        convergence_by_name = {
            name: select_largest_uncertainty(
                convergence_by_name[name] for convergence_by_name in convergences_of_factors
            )
            for name in self.balance_quantities.values_by_name
        }
        if "closed_share" in convergence_by_name:
            convergence = convergence_by_name[
                "closed_share"
            ]  # counted at instants, it is not known to one
            error = math.hypot(
                convergence.uncertainty(-1), 1.0 / len(self.balance_solution.instants())
            )
            convergence_by_name["closed_share"] = replace(
                convergence, extrapolated=convergence.values[-1] + error
            )
        return (n_harmonics_of_answer, 2 * n_harmonics_of_answer), convergence_by_name

    def estimate_error_by_mesh(self) -> PartOrReason:
        """Estimate the error due to the mesh from a coarser mesh, with few modes (collective).

        For a reduced plate or solid with more than 50 modes (:data:`MAX_MODES_FOR_MESH_ERROR`),
        both meshes are solved with 50. The absolute errors with 50 modes then hold for the answer.

        Returns
        -------
        PartOrReason
            Element counts in both meshes, and the error by quantity name. Without a coarser mesh,
            a text with the reason.
        """
        few_modes_answer = self._answer_with_few_modes_for_mesh_error()
        part_or_reason = few_modes_answer._estimate_error_by_coarser_mesh()
        if few_modes_answer is self or isinstance(part_or_reason, str):
            return part_or_reason
        element_counts, few_mode_convergence_by_name = part_or_reason
        convergence_by_name = {}
        for quantity_name, value in self.balance_quantities.values_by_name.items():
            if (convergence := few_mode_convergence_by_name.get(quantity_name)) is None:
                continue
            value_change_from_few_modes = (
                value - few_modes_answer.balance_quantities.values_by_name[quantity_name]
            )
            value_pair = (
                convergence.values[0] + value_change_from_few_modes,
                convergence.values[1] + value_change_from_few_modes,
            )
            convergence_by_name[quantity_name] = replace(
                convergence,
                values=value_pair,
                extrapolated=convergence.extrapolated + value_change_from_few_modes,
            )
        return element_counts, convergence_by_name

    def _answer_with_few_modes_for_mesh_error(self) -> AnswerJudgedByExtraRuns:
        """Solve again with at most 50 modes, :data:`MAX_MODES_FOR_MESH_ERROR` (collective).

        Return a copy of this object with the smaller study and solution. If the structure has no
        more than 50 modes, is not reduced, or is a disk, return this object itself.
        """
        study, scene = self.study, self.study.scene
        structure = study.structure
        if not isinstance(structure, ReducedStructure) or scene.disk is not None:
            return self
        if len(structure.omega) <= MAX_MODES_FOR_MESH_ERROR:
            return self
        scene = scene.replace({scene.modes_key: MAX_MODES_FOR_MESH_ERROR})
        study = reduce_study(
            replace(study, scene=scene, structure=structure.whole), with_reference=False
        )
        start_solution = (
            self.balance_solution if structure.has_massless_crack_faces else None
        )  # else it has other coordinates
        balance_solution = self._solve_run(study, self.balance_solution.omega, start_solution)
        balance_quantities = compute_numbers(
            study, balance_solution, self.balance_quantities.mode_number
        )
        return replace(
            self,
            study=study,
            balance_solution=balance_solution,
            balance_quantities=balance_quantities,
        )

    def _estimate_error_by_coarser_mesh(self) -> PartOrReason:
        """Estimate the error due to the mesh from a coarser mesh, modes unchanged (collective).

        The error is the root of the sum of squares of five contributions:

        - the main error, see below,
        - a tenth of the shape error or the shift error (see below), whichever is smaller,
        - the change if the cracks' clearances are shifted, since the end of a closed zone is known
          only to half the distance between contact pairs
          (:meth:`_compute_values_with_shifted_clearance`),
        - the error of K_I at closed crack fronts,
        - the increase of displacement under a point force if elements were half as long.

        The main error is the sum of two errors, with their signs:

        - the shape error: the change by the mesh at equal distance from the resonance,
        - the shift error: the change because the mesh moves the resonance. If the answer is a
          curve's peak, the shift error is 0, as the peak moves with the resonance.

        Both are extrapolated from the coarser mesh with an assumed convergence order p. Several p
        are tried, from 1 to the elements' best order. The largest absolute sum is the main error.

        A stress intensity's error is at least the largest change along a crack front.

        Returns
        -------
        PartOrReason
            Element counts in both meshes, and the error by quantity name. Without a coarser mesh, a
            text with the reason.
        """
        study, balance_solution = self.study, self.balance_solution
        coarse_study_or_reason = prepare_coarser_study_or_reason(study)
        if isinstance(coarse_study_or_reason, str):
            return coarse_study_or_reason
        coarse_study, element_counts, length_ratio = coarse_study_or_reason
        coarse_study = _without_refused_stress_intensities(coarse_study)
        most_influential_mode_number = self._find_mode_affecting_answer_most()
        resonance_ratio = find_bilinear_omega(coarse_study.structure, most_influential_mode_number)
        resonance_ratio /= find_bilinear_omega(study.structure, most_influential_mode_number)
        coarse_solution = self._solve_run(coarse_study, balance_solution.omega * resonance_ratio)
        coarse_mesh_values = self.compute_values_by_name(coarse_solution, coarse_study)
        counts_and_values = zip(
            element_counts,
            (self.balance_quantities.values_by_name, coarse_mesh_values),
            strict=True,
        )
        _, convergence_by_name = estimate_error_part_from_runs(
            "mesh", [*counts_and_values], study.scene, size_ratio=length_ratio
        )
        assumed_convergence_orders = 2.0 * study.scene.mesh.order, TIP_CONVERGENCE_ORDER
        end_factors = tuple(
            1.0 / (length_ratio**convergence_order - 1.0)
            for convergence_order in assumed_convergence_orders
        )
        relative_shift_range = abs(1.0 - resonance_ratio) * (end_factors[1] - end_factors[0])
        extrapolation_factors = np.linspace(
            *end_factors,
            self._choose_n_tried_resonance_shifts(
                relative_shift_range, most_influential_mode_number
            ),
        )
        values_at_shifts = self._compute_values_at_resonance_shifts(
            extrapolation_factors * (1.0 - resonance_ratio)
        )
        values_with_shifted_clearance = self._compute_values_with_shifted_clearance()
        relative_increase_by_halving = dict.fromkeys(
            observable_names(Place.WATCHED_POINT), self._relative_amplitude_added_by_halving
        )
        K_I_error_at_closed_front_by_name, K_change_along_front_by_name = (
            estimate_closed_front_and_mesh_errors(
                study, balance_solution, coarse_study, coarse_solution
            )
        )
        for quantity_name, convergence in convergence_by_name.items():
            value, coarse_mesh_value = convergence.values
            errors_without_resonance_shift = extrapolation_factors * (value - coarse_mesh_value)
            errors_by_resonance_shift = (
                np.array(
                    [values_by_name.get(quantity_name, 0.0) for values_by_name in values_at_shifts]
                )
                - value
            )
            smaller_error_part = np.minimum(
                np.abs(errors_without_resonance_shift), np.abs(errors_by_resonance_shift)
            ).max()
            error = math.hypot(
                np.abs(errors_without_resonance_shift + errors_by_resonance_shift).max(),
                ADDED_FRACTION_OF_CANCELLING_ERROR * smaller_error_part,
                values_with_shifted_clearance.get(quantity_name, value) - value,
                K_I_error_at_closed_front_by_name.get(quantity_name, 0.0),
                relative_increase_by_halving.get(quantity_name, 0.0) * value,
            )
            error = max(
                error,
                K_change_along_front_by_name.get(quantity_name, 0.0) * extrapolation_factors.max(),
            )
            convergence_by_name[quantity_name] = replace(convergence, extrapolated=value + error)
        return element_counts, convergence_by_name

    def _solve_run(
        self, study: Study, omega: float, start_solution: PeriodicSolution | None = None
    ) -> PeriodicSolution:
        """Solve a study at ``omega`` [rad/s] by the answer's method and harmonics (collective).

        If the answer has an exact orbit, an exact orbit is sought, otherwise a harmonic-balance
        solution. The search starts from ``start_solution``, by default from rest.
        """
        return solve_by_orbit_or_harmonics(
            study,
            omega,
            self.balance_solution.harmonics,
            start_solution,
            answer_orbit=self.answer.orbit,
        )

    def _compute_values_at_resonance_shifts(
        self, relative_shifts: np.ndarray
    ) -> list[dict[str, float]]:
        """Compute the quantities as if the resonance were shifted (collective).

        Instead of the resonance, the load frequency is moved: divided by 1 + shift. Each solution
        starts from rest, since a solution on a finer mesh would start from rest, too. So the
        solution may be far from the answer. If the answer is a curve's peak, a shift does not
        change the quantities.

        Parameters
        ----------
        relative_shifts : (n,)
            Changes in the resonance frequency, relative to the frequency on the answer's mesh.

        Returns
        -------
        list of dict of str to float
            For each shift, the values by quantity name.
        """
        if self.is_peak:
            return [self.balance_quantities.values_by_name] * len(relative_shifts)
        load_omegas = self.balance_solution.omega / (1.0 + relative_shifts)
        solutions = (self._solve_run(self.study, float(load_omega)) for load_omega in load_omegas)
        return [self.compute_values_by_name(solution) for solution in solutions]

    def _choose_n_tried_resonance_shifts(
        self, relative_shift_range: float, mode_number: int
    ) -> int:
        """Choose how many resonance frequencies to try in a range of shifts.

        Neighbouring frequencies are at most a quarter of the peak's half-power width apart. But the
        number is at least :data:`MIN_NUMBER_OF_TRIED_RESONANCES`, 3, and at most
        :data:`MAX_NUMBER_OF_TRIED_RESONANCES`, 8.

        Parameters
        ----------
        relative_shift_range : float
            Length of the range, relative to the resonance frequency.
        mode_number : int
            Resonant mode, counted from 1.
        """
        modal_properties = all_modes(self.study.structure)
        damping_rates = (
            modal_properties.damping
            if modal_properties.damping.ndim == 1
            else np.diag(modal_properties.damping)
        )
        natural_omega = math.sqrt(
            max(modal_properties.squares[mode_number - 1], sys.float_info.min)
        )
        n_intervals_between_shifts = math.ceil(
            4.0
            * relative_shift_range
            * natural_omega
            / max(damping_rates[mode_number - 1], MAX_RELATIVE_ROUNDING_SPREAD * natural_omega)
        )
        return min(
            max(1 + n_intervals_between_shifts, MIN_NUMBER_OF_TRIED_RESONANCES),
            MAX_NUMBER_OF_TRIED_RESONANCES,
        )

    def _find_mode_affecting_answer_most(self) -> int:
        """Find the mode with the most effect on the answer by a frequency shift (collective).

        Return the mode's number, from 1. A small relative shift in the mode's bilinear frequency
        w_j changes a displacement's harmonic k. The change is about 2 U_k / |1 - (k w / w_j)^2|
        times the shift. Here U_k is the harmonic's amplitude at a watched point, and w the load
        frequency. The mode with the largest factor, over all harmonics and watched points, is
        selected.
        """
        balance_solution = self.balance_solution
        watched_point_coefficients = balance_solution.coefficients_at(
            [point.dof for point in self.study.watched]
        )
        harmonic_amplitudes = np.hypot(
            watched_point_coefficients[1::2], watched_point_coefficients[2::2]
        ).max(axis=1)
        harmonic_orders = np.arange(1, balance_solution.harmonics + 1)
        bilinear_omega_of_modes = bilinear_frequencies(self.study.structure).omega_bilinear
        resonance_distances = np.abs(
            1.0 - (harmonic_orders * balance_solution.omega / bilinear_omega_of_modes[:, None]) ** 2
        )
        return (
            int(
                np.argmax(
                    (
                        harmonic_amplitudes
                        / np.maximum(resonance_distances, MAX_RELATIVE_ROUNDING_SPREAD)
                    ).max(axis=1)
                )
            )
            + 1
        )

    @property
    def _relative_amplitude_added_by_halving(self) -> float:
        """Relative increase of the amplitude at the load, if elements were half as long.

        Under a point force the displacement grows without limit as elements become smaller. The
        result is 0 without a point force, without motion, or if the scene has ``output.points``.
        """
        amplitude = self.balance_solution.amplitude(self.study.watched[0].dof)
        if self.study.scene.output_points or amplitude == 0.0:
            return 0.0
        return displacement_added_by_halved_elements(self.study.scene) / amplitude

    def _compute_values_with_shifted_clearance(self) -> dict[str, float]:
        """Compute the quantities with each crack's clearance shifted (collective).

        Used to estimate an error due to the distance between contact pairs. Along a crack, a closed
        zone ends between two pairs, so the end is known to half this distance. The clearance of a
        crack is therefore shifted by 0.5 D P [m]:

        - D is the mean difference in extreme gaps between neighbouring pairs. If every pair closes
          in the period, the extreme gap is a pair's smallest gap. Otherwise the extreme gap is a
          pair's largest gap.
        - P is the difference between the longest and the shortest closed time among the pairs, as a
          fraction of the period.

        Return values by quantity name; without cracks, the dict is empty.
        """
        study = self.study
        unshifted_solution = self.balance_solution
        times = self.balance_solution.instants()
        crack_index_of_pairs = study.structure.pairs.cracks
        if crack_index_of_pairs is None or not len(crack_index_of_pairs):
            return {}
        gap_samples = unshifted_solution.gap(times)
        is_closed_at_times = unshifted_solution.contact_force(times) > 0.0
        clearance_shifts = np.zeros(len(crack_index_of_pairs))
        for crack_index in np.unique(crack_index_of_pairs):
            is_pair_of_crack = crack_index_of_pairs == crack_index
            closed_share_of_pairs = is_closed_at_times[:, is_pair_of_crack].mean(axis=0)
            crack_gap_samples = gap_samples[:, is_pair_of_crack]
            extreme_gap_of_pairs = (
                crack_gap_samples.min(axis=0)
                if closed_share_of_pairs.all()
                else crack_gap_samples.max(axis=0)
            )
            n_pairs_along_crack = is_pair_of_crack.sum() ** (1.0 / (study.scene.dimension - 1))
            clearance_shifts[is_pair_of_crack] = (
                0.5
                * np.ptp(extreme_gap_of_pairs)
                / n_pairs_along_crack
                * np.ptp(closed_share_of_pairs)
            )
        shifted_study = replace(study, structure=study.structure.varied(clearance=clearance_shifts))
        solution_with_shifted_clearance = self._solve_run(
            shifted_study, unshifted_solution.omega, unshifted_solution
        )
        return self.compute_values_by_name(solution_with_shifted_clearance, shifted_study)


def _without_refused_stress_intensities(study: Study) -> Study:
    """Remove requested stress intensities if a study's elements are too long to compute them.

    Return a study without the stress intensities. If the elements are short enough, return the
    study itself.
    """
    try:
        make_requested_rows_and_readers(study)
    except InputError:
        refused_names = observable_names(
            Place.MOST_LOADED_TIP, Place.DEEPEST_PLACE_AND_ELLIPSE_ENDS
        )
        kept_names = [name for name in study.scene.quantities or () if name not in refused_names]
        return replace(study, scene=study.scene.replace({"output.quantities": kept_names or None}))
    return study
