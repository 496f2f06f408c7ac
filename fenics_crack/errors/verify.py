"""Verify a scene's numbers by two finer runs for each cause of error.

Each number is extrapolated with the observed order (:mod:`convergence`). The scene's value is the
coarsest of the three, and the uncertainty belongs to this value. Meshes coarser than the scene's
mesh would mostly be outside the asymptotic range.

Theory gives an order for each cause:

- *mesh* with a crack: 1. At distance r from a tip, displacements vary as r^(1/2). So frequencies
  and work converge as the element size h. This holds for elements with both orders, on equal cells
  and on cells graded by a fixed ratio (Strang and Fix, An Analysis of the Finite Element Method,
  1973, chapter 8).
- *mesh* without a crack: 3/2, at a clamp's ends. Williams' equation gives 1.52 for a right angle
  with a held side, nu = 0.3, plane stress.
- *modes*: 1. In a plane w_j^2 is proportional to j. A truncated mode j contributes w^2 / w_j^4 at
  the load frequency w; beyond N modes the sum decays as N^-1.
- *harmonics*: 1. When crack faces hit, velocities jump: the amplitude U_k of harmonic k decays as
  k^-2, and the remainder beyond H harmonics as H^-1. If only forces have kinks, the decay is H^-3,
  but the verification does not rely on this.
- *samples*: 2. N samples of a force with kinks have errors proportional to N^-2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from mpi4py import MPI

from fenics_crack.balance.contact_integrals import default_instants_per_period
from fenics_crack.basics.causes import ERROR_CAUSES, MESH_ERROR_CAUSES
from fenics_crack.basics.errors import MAX_CONTACT_SAMPLES_PER_PERIOD, ConvergenceError
from fenics_crack.basics.progress import prefix_stages
from fenics_crack.errors.case import (
    HARMONICS_NOT_VARIED_REASON,
    JudgedAnswer,
    add_error_parts,
    solve_without_stability,
)
from fenics_crack.errors.convergence import (
    CLAMP_CONVERGENCE_ORDER,
    TIP_CONVERGENCE_ORDER,
    CountAndValues,
    PartOrReason,
    estimate_error_part_from_runs,
)
from fenics_crack.errors.numbers import (
    add_changes,
    compute_numbers,
    find_accepted_orbit_or_none,
    find_bilinear_omega,
)
from fenics_crack.errors.verification import Verification
from fenics_crack.model.contact import is_unilateral
from fenics_crack.scene.scene import Scene
from fenics_crack.study.meshes import count_elements, has_similar_finer_mesh, refine_scene_or_none
from fenics_crack.study.prepare import (
    SINGLE_COMPUTATION_FAILURES,
    Study,
    modal_reduction_or_none,
    prepare,
    reduce_study,
)
from fenics_crack.study.solve import SolvedStudy, solve_study

REFINED_COUNT_FACTORS = (1, 2, 4)
"""Factors on a count of modes, harmonics or samples: the answer, and two finer runs."""
SAMPLING_CONVERGENCE_ORDER = 2.0
"""Theoretical order p of the error C / N^p with N samples of the contact force per period."""
SCENE_RUN_NAME = "the scene's settings"


def verify(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> Verification:
    """Verify the numbers of a scene's steady vibration and frequencies (collective).

    Mesh, modes, harmonics and samples are refined twice, each cause alone. Elements become 2 and 3
    times shorter. In layout "graded" the factors are 1.5 and 2 if a mesh with the same grading and
    elements 1.5 times shorter exists. Mode, harmonic and sample counts are multiplied by 2 and 4.
    The three values f_i of each quantity give the observed convergence order, the extrapolated
    value f and the uncertainty F abs(f_i - f). The factor of safety F is 1.25 or 3
    (:func:`fenics_crack.grid_convergence`; Roache 1994, Celik et al. 2008, ASME V&V 20-2009).

    If possible, the error due to harmonics is the distance to an exact orbit, a periodic motion in
    time without truncated harmonics. Two conditions must hold. The orbit's gaps must differ from
    the solution's gaps by at most 10 % of the motion, or 50 % if crack faces have no mass.
    ``harmonic_balance.samples`` must not be set. The error due to friction follows from exact
    orbits with and without friction.

    If the scene gives a tolerance, numbers of harmonics and modes are chosen first. A mesh from a
    file or matrices is not refined, and the result gives the reason. The result lists failed runs,
    and orbits not known to be stable.

    Parameters
    ----------
    scene : Scene
        Scene to solve and verify.
    comm : MPI.Comm
        Ranks that share each mesh.

    Returns
    -------
    Verification
        Part of each cause in each quantity's error, and the total errors.

    Raises
    ------
    InputError
        See :func:`fenics_crack.prepare`.
    ConvergenceError
        The scene itself does not converge.

    Examples
    --------
    >>> verification = fc.verify(scene)
    >>> error = verification.total("amplitude")
    """
    with prefix_stages(SCENE_RUN_NAME):
        unreduced_study = prepare(scene, comm, whole=True)
        run = solve_study(unreduced_study)
        if scene.harmonic_balance.tolerance is not None and run.result.converged:
            run = solve_study(replace(run, scene=_scene_with_chosen_counts(run)), run.result)
    answer = run.result
    if not answer.converged:
        raise ConvergenceError(f"{SCENE_RUN_NAME}: {answer.status}")
    unreduced_study = replace(unreduced_study, scene=_scene_with_chosen_counts(run))
    numbers = compute_numbers(run, answer)
    judged_answer = _AnswerJudgedByFinerRuns(
        run, answer, numbers.values_by_name, answer, numbers, unreduced_study
    )
    judged_answer.note_stability_verdict(SCENE_RUN_NAME, run)
    verification = Verification(unreduced_study.scene, numbers.values_by_name, numbers.unit_by_name)
    verification = add_error_parts(verification, {"mesh": judged_answer.estimate_error_by_mesh})
    part_function_by_cause: dict[str, Callable[[], PartOrReason]] = {
        "shift": partial(judged_answer.estimate_error_by_resonance_shift, verification)
    } | {
        cause: getattr(judged_answer, f"estimate_error_by_{cause}")
        for cause in ERROR_CAUSES
        if cause not in MESH_ERROR_CAUSES
    }
    verification = add_error_parts(verification, part_function_by_cause)
    return replace(
        verification,
        failures=tuple(judged_answer.failure_texts),
        verdicts=judged_answer.not_stable_verdict_by_run,
    )


def _scene_with_chosen_counts(run: SolvedStudy) -> Scene:
    """Return the solved scene with the harmonics and modes chosen by the solver.

    A tolerance is replaced by the solution's number of harmonics. The mode count becomes the
    solution's. If all modes are kept, the reduction is "off", so that a finer mesh keeps all modes,
    too. A disk's reduction stays unchanged.
    """
    scene, whole_structure = run.scene, run.structure.whole
    values_by_key: dict[str, Any] = {}
    if scene.harmonic_balance.tolerance is not None:
        values_by_key["harmonic_balance.tolerance"] = None
        values_by_key["harmonic_balance.harmonics"] = run.result.harmonics
    if scene.disk is not None:
        return scene.replace(values_by_key)
    modal_reduction = modal_reduction_or_none(scene, whole_structure)
    if modal_reduction is None or modal_reduction.n_modes >= whole_structure.n_dofs:
        values_by_key |= {"reduction.method": "off", "reduction.modes": None}
    else:
        values_by_key |= {
            "reduction.method": modal_reduction.method,
            "reduction.modes": modal_reduction.n_modes,
        }
    return scene.replace(values_by_key)


def _count_kept_and_possible_modes(study: Study) -> tuple[int, int] | str:
    """Count the kept modes, and all modes that could be kept.

    For a disk, both are counts per nodal diameter.

    Returns
    -------
    (int, int) or str
        Kept and possible mode counts. If modes cannot be varied, a text with the reason: no
        reduction, or all modes are kept.
    """
    disk_table, modal_reduction = (
        study.scene.disk,
        modal_reduction_or_none(study.scene, study.structure),
    )
    if disk_table is not None:
        return disk_table.families, study.structure.n_dofs // disk_table.sectors
    if modal_reduction is None:
        return "the structure is not reduced to modes"
    n_possible_modes = study.structure.n_dofs - study.structure.n_pairs
    return (
        "all modes are kept"
        if modal_reduction.n_modes >= n_possible_modes
        else (modal_reduction.n_modes, n_possible_modes)
    )


@dataclass(frozen=True)
class _AnswerJudgedByFinerRuns(JudgedAnswer):
    """Estimate each cause's part in an answer's error by finer runs.

    Attributes
    ----------
    unreduced_study : Study
        Study with the unreduced structure. The scene has fixed numbers of harmonics and modes
        (:func:`_scene_with_chosen_counts`).
    failure_texts : list of str
        Name and error of each failed finer run.
    not_stable_verdict_by_run : dict of str to str
        Verdict on stability by name of the run, "stable" runs excluded.
    """

    unreduced_study: Study
    failure_texts: list[str] = field(default_factory=list)
    not_stable_verdict_by_run: dict[str, str] = field(default_factory=dict)

    def note_stability_verdict(self, run_name: str, run: SolvedStudy) -> None:
        """Record a run's verdict on stability in ``not_stable_verdict_by_run``.

        The verdict "stable", or a missing verdict, is not recorded.
        """
        stability = run.result.stability
        if stability is not None and stability.verdict != "stable":
            self.not_stable_verdict_by_run[run_name] = stability.verdict

    def _estimate_error_by_finer_runs(
        self,
        cause: str,
        names_counts_and_finer_scenes: Sequence[tuple[str, int | None, Scene]],
        count: int,
        formal_order: float,
        *,
        shared_study: Study | None = None,
        scheme_order: float = math.inf,
    ) -> PartOrReason:
        """Estimate a cause's part in the error from finer runs (collective).

        Failed runs are recorded in ``failure_texts``.

        Parameters
        ----------
        cause : str
            Cause to judge.
        names_counts_and_finer_scenes : sequence of (name, count, scene)
            For each finer run: a name for messages, the mode, harmonic or sample count, and the
            scene. If the mesh is finer, the count is None: the elements are counted after meshing.
        count : int
            The answer's count: elements, modes, harmonics or samples.
        formal_order : float
            Convergence order expected by theory.
        scheme_order : float
            Largest possible order. If a larger order is observed, the values are called irregular.
        shared_study : Study, optional
            Study with the structure for all runs. If None, a structure is made for each run.

        Returns
        -------
        PartOrReason
            Counts in all runs, and the error by quantity name. If two runs have equally many
            elements, a text with this reason.

        Raises
        ------
        ConvergenceError
            All finer runs fail.
        """
        counts_and_values: list[CountAndValues] = [(count, self.balance_quantities.values_by_name)]
        for run_name, finer_count, scene in reversed(
            names_counts_and_finer_scenes
        ):  # few modes are among many
            with prefix_stages(run_name):
                try:
                    run = self._solve_finer_scene(scene, shared_study)
                except SINGLE_COMPUTATION_FAILURES as error:
                    self.failure_texts.append(f"{run_name}: {error}")
                    continue
            count_and_values = (
                finer_count or count_elements(run.structure),
                self._compute_run_values_by_name(run, cause),
            )
            counts_and_values.insert(1, count_and_values)
            self.note_stability_verdict(run_name, run)
        if len(counts_and_values) == 1:
            raise ConvergenceError(cause)
        if len({count_in_run for count_in_run, _ in counts_and_values}) < len(counts_and_values):
            return "finer meshes have as many elements: reduce mesh.size, now the size of the plate"
        return estimate_error_part_from_runs(
            cause,
            counts_and_values,
            self.unreduced_study.scene,
            formal_order=formal_order,
            scheme_order=scheme_order,
        )

    def _solve_finer_scene(self, scene: Scene, shared_study: Study | None) -> SolvedStudy:
        """Solve a finer scene (collective).

        Raise ConvergenceError if the solution does not converge.

        Parameters
        ----------
        scene : Scene
            Scene with a finer mesh, more modes, harmonics or samples.
        shared_study : Study or None
            Study with the structure to use. An unreduced structure is first reduced as ``scene``
            says. If this is the answer's study, the search starts from the answer. If None, a new
            mesh is made. Then the load frequency is scaled as the resonance, by the ratio between
            the bilinear frequencies on both meshes.
        """
        study, mode_number = self.study, self.balance_quantities.mode_number
        start_solution = self.answer if shared_study is study else None
        load_omega = self.answer.omega
        if shared_study is not None:
            finer_study = reduce_study(replace(shared_study, scene=scene), with_reference=False)
        else:
            finer_study = prepare(scene, study.structure.comm, judged=False)
            load_omega *= find_bilinear_omega(
                finer_study.structure, mode_number
            ) / find_bilinear_omega(study.structure, mode_number)
        run = solve_study(finer_study, start_solution, load_omega)
        if not run.result.converged:
            raise ConvergenceError(run.result.status)
        return run

    def _compute_run_values_by_name(self, run: SolvedStudy, cause: str) -> dict[str, float]:
        """Return a finer run's values by quantity name (collective).

        For the cause "modes", exact orbits are compared if possible. Answer and run must both have
        an orbit close enough (:func:`find_accepted_orbit_or_none`). The value is then the answer's
        value, plus the change from the answer's orbit to the run's orbit. The reason: a solution
        with few harmonics treats modes above the highest harmonic nearly as static.

        Parameters
        ----------
        run : SolvedStudy
            Finer run, with the study and the solution.
        cause : str
            Varied error cause, for example "mesh".
        """
        if cause == "modes" and self.orbit_values_by_name is not None:
            orbit = find_accepted_orbit_or_none(run.result)
            if orbit is not None:
                orbit_values_by_name = self.compute_values_by_name(orbit, run)
                return add_changes(
                    self.balance_quantities.values_by_name,
                    self.orbit_values_by_name,
                    orbit_values_by_name,
                )
        return self.compute_values_by_name(run.result, run)

    def _estimate_error_by_larger_counts(
        self,
        cause: str,
        shared_study: Study,
        scene: Scene,
        count_key: str,
        count: int,
        max_count: int,
        formal_order: float,
    ) -> PartOrReason:
        """Estimate a cause's error from runs with 2 and 4 times the count (collective).

        The count is a number of modes, harmonics or samples.

        Parameters
        ----------
        cause : str
            Cause to judge.
        shared_study : Study
            Study with the structure for all runs.
        scene : Scene
            Scene to refine.
        count_key : str
            Scene key with the count, for example "harmonic_balance.harmonics".
        count, max_count : int
            Count in the answer, and upper limit for finer runs.
        formal_order : float
            Convergence order expected by theory.

        Returns
        -------
        PartOrReason
            Counts in all runs, and the error by quantity name.
        """
        counts = sorted({min(factor * count, max_count) for factor in REFINED_COUNT_FACTORS})
        count_name = count_key.rpartition(".")[2]
        names_counts_and_finer_scenes = [
            (f"{finer_count} {count_name}", finer_count, scene.replace({count_key: finer_count}))
            for finer_count in counts[1:]
        ]
        return self._estimate_error_by_finer_runs(
            cause, names_counts_and_finer_scenes, count, formal_order, shared_study=shared_study
        )

    def estimate_error_by_mesh(self) -> PartOrReason:
        """Estimate the error due to the mesh from two finer meshes (collective).

        Elements become 1.5 and 2 times shorter if a similar finer mesh exists
        (:func:`has_similar_finer_mesh`), otherwise 2 and 3 times.

        Returns
        -------
        PartOrReason
            Element counts in all meshes, and the error by quantity name. Matrices and meshes from
            a file are not refined: then a text with the reason.
        """
        scene = self.unreduced_study.scene
        if scene.structure is not None:
            return "[structure] gives matrices, which have no finer mesh"
        refinement_factors = (1.5, 2.0) if has_similar_finer_mesh(scene) else (2.0, 3.0)
        names_counts_and_finer_scenes = [
            (f"a mesh {refinement_factor:g} times finer", None, finer_scene)
            for refinement_factor in refinement_factors
            if (finer_scene := refine_scene_or_none(scene, refinement_factor)) is not None
        ]
        if not names_counts_and_finer_scenes:
            return (
                "a mesh of mesh.file cannot be refined; solve estimates this error by "
                "mesh.coarser, and fc.grid_convergence compares several meshes"
            )
        formal_order = (
            TIP_CONVERGENCE_ORDER
            if self.unreduced_study.structure.n_pairs
            else CLAMP_CONVERGENCE_ORDER
        )
        n_elements_of_answer, scheme_order = (
            count_elements(self.study.structure),
            2.0 * scene.mesh.order,
        )
        return self._estimate_error_by_finer_runs(
            "mesh",
            names_counts_and_finer_scenes,
            n_elements_of_answer,
            formal_order,
            scheme_order=scheme_order,
        )

    def estimate_error_by_resonance_shift(self, verification: Verification) -> PartOrReason:
        """Estimate the error because a finer mesh would shift the resonance (collective).

        Instead of the resonance, the load frequency is moved on the answer's mesh, in the opposite
        direction. The response is solved at two or three load frequencies:

        - moved by half the resonance frequency's uncertainty,
        - moved by the whole uncertainty,
        - moved by the difference from the extrapolated resonance frequency, if known.

        A quantity's error is the largest change at the moved load frequencies. The smaller moves
        matter, as the response may have a peak in between.

        Parameters
        ----------
        verification : Verification
            Verification with the resonance frequency's error due to the mesh.

        Returns
        -------
        PartOrReason
            Element counts on the answer's mesh and on the finest mesh, and the error by quantity
            name. "" if ``verification`` has no errors due to the mesh.
        """
        if "mesh" not in verification.parts:
            return ""
        element_counts = verification.counts["mesh"]
        resonance_convergence = verification.parts["mesh"][self.balance_quantities.resonance_name]
        answer_resonance_frequency = self.balance_quantities.values_by_name[
            self.balance_quantities.resonance_name
        ]
        relative_error = resonance_convergence.uncertainty(-1) / answer_resonance_frequency
        is_resonance_extrapolated = math.isfinite(resonance_convergence.extrapolated)
        is_resonance_rising = (
            is_resonance_extrapolated
            and resonance_convergence.extrapolated > answer_resonance_frequency
        )
        load_frequency_shift_sign = -1.0 if is_resonance_rising else 1.0
        load_frequency_factors = [
            (1.0 + relative_error * fraction_of_resonance_error) ** load_frequency_shift_sign
            for fraction_of_resonance_error in (0.5, 1.0)
        ]
        if is_resonance_extrapolated:
            load_frequency_factors.append(
                answer_resonance_frequency / resonance_convergence.extrapolated
            )
        solution, values_at_load_frequencies = self.answer, []
        for load_frequency_factor in load_frequency_factors:  # each is sought from the one before
            load_omega = self.answer.omega * load_frequency_factor
            solution = solve_without_stability(
                self.study, load_omega, self.answer.harmonics, solution
            )
            values_at_load_frequencies.append(self.compute_values_by_name(solution))
        convergence_by_name = {}
        for quantity_name, value in self.balance_quantities.values_by_name.items():
            quantity_at_load_frequencies = [
                values_at_load_frequency.get(quantity_name, 0.0)
                for values_at_load_frequency in values_at_load_frequencies
            ]
            extreme_value = max(
                quantity_at_load_frequencies, key=lambda candidate: abs(candidate - value)
            )
            convergence_by_name[quantity_name] = replace(
                resonance_convergence,
                sizes=(resonance_convergence.sizes[0], resonance_convergence.sizes[-1]),
                factor=1.0,
                values=(extreme_value, value),
                behaviour="carried",
                extrapolated=quantity_at_load_frequencies[-1]
                if is_resonance_extrapolated
                else math.nan,
            )
        return element_counts[:: len(element_counts) - 1], convergence_by_name

    def estimate_error_by_modes(self) -> PartOrReason:
        """Estimate the error due to truncated modes from 2 and 4 times the modes (collective).

        Without truncated modes, return the reason as text.
        """
        unreduced_study = self.unreduced_study
        kept_and_possible_modes_or_reason = _count_kept_and_possible_modes(self.unreduced_study)
        if isinstance(kept_and_possible_modes_or_reason, str):
            return kept_and_possible_modes_or_reason
        return self._estimate_error_by_larger_counts(
            "modes",
            unreduced_study,
            unreduced_study.scene,
            unreduced_study.scene.modes_key,
            *kept_and_possible_modes_or_reason,
            TIP_CONVERGENCE_ORDER,
        )

    def estimate_error_by_harmonics(self) -> PartOrReason:
        """Estimate the error due to truncated harmonics (collective).

        The error is the distance to the answer's exact orbit, if one is close enough
        (:func:`find_accepted_orbit_or_none`). Without an orbit, or with
        ``harmonic_balance.samples`` in the scene, runs with 2 and 4 times the harmonics give the
        error. Without contact, return the reason as text.
        """
        scene = self.unreduced_study.scene
        balance_table = scene.harmonic_balance
        if self.study.contact is None:
            return HARMONICS_NOT_VARIED_REASON
        if balance_table.samples is not None:  # enough for all of them
            min_n_samples = 4 * REFINED_COUNT_FACTORS[-1] * balance_table.harmonics + 1
            n_samples = max(balance_table.samples, min_n_samples)
            scene = scene.replace({"harmonic_balance.samples": n_samples})
        elif self.orbit_values_by_name is not None:
            return self.estimate_harmonics_error_by_orbit(self.orbit_values_by_name)
        harmonics_key = "harmonic_balance.harmonics"
        return self._estimate_error_by_larger_counts(
            "harmonics",
            self.study,
            scene,
            harmonics_key,
            balance_table.harmonics,
            MAX_CONTACT_SAMPLES_PER_PERIOD,
            TIP_CONVERGENCE_ORDER,
        )

    def estimate_error_by_samples(self) -> PartOrReason:
        """Estimate the error due to sampled contact forces from more samples (collective).

        Use 2 and 4 times the samples per period. If forces are integrated exactly, or without
        contact, return the reason as text.
        """
        scene, contact_law = self.unreduced_study.scene, self.study.contact
        balance_table, samples_key = scene.harmonic_balance, "harmonic_balance.samples"
        if contact_law is None:
            return "without contact no contact force is sampled"
        if balance_table.samples is None and is_unilateral(contact_law):
            return "contact forces are integrated exactly, without samples"
        n_samples = balance_table.samples or default_instants_per_period(balance_table.harmonics)
        return self._estimate_error_by_larger_counts(
            "samples",
            self.study,
            scene,
            samples_key,
            n_samples,
            MAX_CONTACT_SAMPLES_PER_PERIOD,
            SAMPLING_CONVERGENCE_ORDER,
        )
