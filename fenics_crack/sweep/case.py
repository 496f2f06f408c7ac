"""Solve sweep cases that share a structure (a "geometry"): same mesh, matrices and modes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.balance.harmonic_balance import (
    lacks_modes,
    slide_along_lines,
    solve_from_neighbour,
    solve_linear,
)
from fenics_crack.balance.problem import Problem, check_memory
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.ranks import gather_rows
from fenics_crack.basics.tables import add_frequency_entries
from fenics_crack.curves.follow import continue_frequency
from fenics_crack.curves.resonance import resonance_at
from fenics_crack.curves.stability import floquet
from fenics_crack.fem.setting import clearance_of, list_mean_cos_and_sin_force_vectors
from fenics_crack.model.contact import is_rigid, is_unilateral
from fenics_crack.model.modal import is_small
from fenics_crack.model.modes import FREQUENCY_KIND_NAMES, BilinearFrequencies, bilinear_frequencies
from fenics_crack.model.structure import Structure
from fenics_crack.motion.motions import dof_selection_rows
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import FORCE_KEYS
from fenics_crack.study.key_figures import list_modal_damping_ratios
from fenics_crack.study.observer import make_requested_rows_and_readers
from fenics_crack.study.prepare import (
    SINGLE_COMPUTATION_FAILURES,
    Study,
    prepare,
    reduce_study,
    scene_contact_law,
)
from fenics_crack.study.solve import (
    MAX_MODES_FOR_MANY_SOLUTIONS,
    candidate_mode_counts,
    reduce_to_modes,
)
from fenics_crack.sweep.file import (
    CONTRADICTION_STATUS_PREFIX,
    UNDECIDED_STATUS_PREFIX,
    UNIT_BY_HARMONIC_PART,
    UNIT_BY_OUTPUT_POINT_QUANTITY,
    column_name_at_load,
)
from fenics_crack.sweep.plan import Chunk


@dataclass(frozen=True)
class SharedCaseOptions:
    """Options for all sweep cases (combinations of swept values).

    Attributes
    ----------
    has_unit_loads : bool
        True if shared structures are built with unit forces, and each case scales them by its own
        force.
    stops_sweep_if_structure_too_large : bool
        True if a structure too large to solve ends the sweep with an error. If False, only the
        cases with this structure fail.
    at_resonance : bool
        True if each case is solved at the resonance nearest to its frequency.
    assesses_stability : bool
        True if each case's stability is assessed.
    estimates_reduction_error : bool
        True if each case's reduction error is estimated.
    frequencies_only_flags_of_last_axis : tuple of bool
        A flag for each value of the last key in ``[sweep.over]``. True: cases with this value are
        not solved, and only have natural frequencies.
    """

    has_unit_loads: bool
    stops_sweep_if_structure_too_large: bool = False
    at_resonance: bool = False
    assesses_stability: bool = True
    estimates_reduction_error: bool = True
    frequencies_only_flags_of_last_axis: tuple[bool, ...] = (False,)


@dataclass(frozen=True)
class SweepGeometry:
    """Structure shared by sweep cases that have the same mesh and modes.

    These cases differ only in load, clearance, contact law and harmonics.

    Attributes
    ----------
    study : Study
        Study with this structure, without clearance. The structure is reduced, unless the mesh or
        the given matrices are small.
    has_unit_loads : bool
        True if the load has a sine part of 1 N in x and a cosine part of 1 N in y. A solid has a
        mean of 1 N in z, too.
    crack_length : float [m]
        First crack's length; nan if unknown.
    bilinear_frequencies : BilinearFrequencies
        Natural frequencies with the crack open and bonded.
    dof_weight_row_by_watched_name : dict of str to (n_dofs,)
        Rows R that give displacements [m] as R u, with the structure's displacements u (n_dofs,).
        Names are "tip.ux" for a named point, and "" for the load's point. If "" is missing, each
        case has its own row, in the direction of its load.
    unreduced_study : Study
        Study before reduction.
    ascending_mode_counts_to_try : tuple of int
        Number of modes in ``study``, then larger numbers to try if a case misses its tolerance.
        Empty if the scene sets the number of modes.
    """

    study: Study
    has_unit_loads: bool
    crack_length: float
    bilinear_frequencies: BilinearFrequencies
    dof_weight_row_by_watched_name: dict[str, np.ndarray]
    unreduced_study: Study
    ascending_mode_counts_to_try: tuple[int, ...] = ()

    @cached_property
    def geometry_with_more_modes(self) -> SweepGeometry | None:
        """The same structure with the next larger number of modes.

        The number is the second in ``ascending_mode_counts_to_try``. None if no larger number is
        left.
        """
        if len(self.ascending_mode_counts_to_try) < 2:
            return None
        study_with_more_modes = reduce_to_modes(
            self.unreduced_study, self.ascending_mode_counts_to_try[1]
        )
        return replace(
            self,
            study=study_with_more_modes,
            dof_weight_row_by_watched_name=_find_watched_row_by_name(study_with_more_modes),
            ascending_mode_counts_to_try=self.ascending_mode_counts_to_try[1:],
        )

    @property
    def structure(self) -> Structure:
        """Structure that the cases share, without clearance."""
        return self.study.structure

    def structure_of_case(self, scene: Scene) -> Structure:
        """Return the shared structure with a case's load and clearance."""
        unit_load_weight_matrix: float | np.ndarray = 1.0
        if self.has_unit_loads:
            unit_load_weight_matrix = np.zeros((len(FORCE_KEYS), len(FORCE_KEYS)))
            force_vectors = np.array(
                [getattr(scene.excitation, force_key) for force_key in FORCE_KEYS]
            )
            unit_load_weight_matrix[:, -scene.dimension :] = force_vectors[:, ::-1]
        clearance = clearance_of(scene, self.structure.pairs) if scene.crack_by_name else 0.0
        return self.structure.varied(load=unit_load_weight_matrix, clearance=clearance)


def build_sweep_geometry(
    scene: Scene,
    comm: MPI.Comm,
    case_options: SharedCaseOptions,
    last_geometry: SweepGeometry | None = None,
) -> SweepGeometry:
    """Build the structure shared by all sweep cases with a scene's mesh (collective).

    Parameters
    ----------
    scene : Scene
        Any case's scene. The crack clearances in it are replaced by 0.
    comm : MPI.Comm
        Ranks that share the structure.
    case_options : SharedCaseOptions
        Options of the sweep. With ``estimates_reduction_error`` and a tolerance, the structure has
        the first of several numbers of modes. With ``estimates_reduction_error`` alone, it keeps a
        reference structure with more modes.
    last_geometry : SweepGeometry, optional
        Structure at another rotor speed, whose mesh and matrices are used again.

    Returns
    -------
    SweepGeometry
        Shared structure, with natural frequencies and rows of watched displacements.

    Raises
    ------
    InputError
        The structure has too many dofs and is not reduced (key ``reduction.method``), or
        :func:`prepare` refuses the scene.
    """
    scene = scene.replace({f"{crack_key}.clearance": 0.0 for crack_key in scene.crack_by_name})
    if case_options.has_unit_loads:
        dimension = scene.dimension
        keys_and_unit_forces = zip(
            FORCE_KEYS,
            np.eye(len(FORCE_KEYS), dimension, dimension - len(FORCE_KEYS))[:, ::-1],
            strict=True,
        )
        scene = scene.replace(
            {
                f"excitation.{force_key}": tuple(unit_force)
                for force_key, unit_force in keys_and_unit_forces
            }
        )
    unreduced_study = prepare(
        scene, comm, whole=True, like=None if last_geometry is None else last_geometry.study
    )
    ascending_mode_counts_to_try = (
        candidate_mode_counts(unreduced_study, MAX_MODES_FOR_MANY_SOLUTIONS)
        if case_options.estimates_reduction_error
        else []
    )
    # Natural frequencies have no error of their own: they are of many modes.
    many_mode_study = reduce_study(
        unreduced_study,
        with_reference=case_options.estimates_reduction_error and not ascending_mode_counts_to_try,
    )
    structure = many_mode_study.structure
    if not is_small(structure):
        reduction_method = "off" if scene.reduction is None else scene.reduction.method
        requirement_text = (
            f"'massless' for a sweep of a structure with {structure.n_dofs} dofs; "
            "or 'free_interface' with fewer modes"
        )
        raise InputError("reduction.method", reduction_method, requirement_text)
    make_requested_rows_and_readers(many_mode_study)
    crack_lengths = [crack.length for crack in many_mode_study.scene.crack_by_name.values()]
    crack_length = crack_lengths[0] if crack_lengths and crack_lengths[0] is not None else np.nan
    natural_frequencies = bilinear_frequencies(structure)
    study = (
        reduce_to_modes(unreduced_study, ascending_mode_counts_to_try[0])
        if ascending_mode_counts_to_try
        else many_mode_study
    )
    dof_weight_row_by_watched_name = _find_watched_row_by_name(study)
    return SweepGeometry(
        study,
        case_options.has_unit_loads,
        crack_length,
        natural_frequencies,
        dof_weight_row_by_watched_name,
        unreduced_study,
        tuple(ascending_mode_counts_to_try),
    )


def iterate_geometries_with_more_modes(
    scene: Scene, case_options: SharedCaseOptions
) -> Iterator[SweepGeometry]:
    """Yield a case's structure with each number of modes that a sweep may use.

    Used to restore a stored case: a caller compares the stored solution with each structure, to
    find the structure that solved the case.

    If the number of modes is chosen by the tolerance, a last structure follows. It has the number
    of modes set in the scene, as in a sweep without reduction errors.

    Parameters
    ----------
    scene : Scene
        The case's scene.
    case_options : SharedCaseOptions
        Options of the sweep.
    """
    first_geometry = build_sweep_geometry(scene, MPI.COMM_SELF, case_options)
    geometry: SweepGeometry | None = first_geometry
    while geometry is not None:
        yield geometry
        geometry = geometry.geometry_with_more_modes
    if first_geometry.ascending_mode_counts_to_try:
        yield build_sweep_geometry(
            scene, MPI.COMM_SELF, replace(case_options, estimates_reduction_error=False)
        )


def _find_watched_row_by_name(study: Study) -> dict[str, np.ndarray]:
    """Return a row R (n_dofs,) for each watched displacement, by name (collective).

    R times the structure's displacements u (n_dofs,) is the watched displacement [m]. Names are
    "tip.ux" for points in ``[output.points]``, and "" for the load's point.
    """
    dof_by_name = {
        watched_displacement.name: watched_displacement.dof
        for watched_displacement in study.watched
        if watched_displacement.name
    }
    displacement_rows = dof_selection_rows(study.structure, [*dof_by_name.values()])
    return _find_load_point_row_by_name(study.scene, study.structure) | dict(
        zip(dof_by_name, displacement_rows, strict=True)
    )


def _find_load_point_row_by_name(scene: Scene, structure: Structure) -> dict[str, np.ndarray]:
    """Return a row R (n_dofs,) for the displacement at the load's point (collective).

    R times the structure's displacements u (n_dofs,) is the displacement [m]. The result is a
    dictionary with the key "". If the structure names no displacement to watch, given matrices have
    the row for the dof with the largest load. A mesh then has an empty dictionary.
    """
    whole_structure = structure.whole
    if whole_structure.watched is not None:
        dof_weights = gather_rows(whole_structure.comm, whole_structure.watched)
    elif scene.structure is not None:
        dof_weights = np.zeros(whole_structure.n_dofs)
        dof_weights[whole_structure.find_most_loaded_dof()] = 1.0
    else:
        return {}
    dofs = np.flatnonzero(dof_weights)
    return {"": dof_weights[dofs] @ dof_selection_rows(structure, dofs.tolist())}


# --- a case ---------------------------------------------------------------------------------------


FREQUENCIES_ONLY_STATUS = "only natural frequencies were computed"
"""Text in the column ``status`` for a case with natural frequencies only."""
CaseValues = dict[str, Any]
"""Values of a sweep case by column name.

A converged case also has the Fourier coefficients "gap" [m] and "force" [N]: (2H+1, n_rows).
"""


def solve_chunk(
    geometry: SweepGeometry,
    chunk: Chunk,
    case_options: SharedCaseOptions,
    may_continue: Callable[[], bool],
) -> list[CaseValues]:
    """Solve the cases in a chunk one after the other.

    Parameters
    ----------
    geometry : SweepGeometry
        Structure that the cases share.
    chunk : Chunk
        Up to 16 neighbouring cases.
    case_options : SharedCaseOptions
        Options; ``at_resonance`` solves at resonances in place of the given frequencies.
    may_continue : callable
        Called before each case; False ends the chunk.

    Returns
    -------
    list of dict
        Values by column name for each case tried, in the order of the chunk. A failed case has the
        reason in the column ``status``.
    """
    solver, result_values_of_chunk_cases = CaseSolver(geometry), []
    frequencies_only_flags = case_options.frequencies_only_flags_of_last_axis
    for case_number, case in zip(chunk.case_numbers.tolist(), chunk.scenes_or_reasons, strict=True):
        if not may_continue():
            break
        if isinstance(case, str):
            result_values_of_chunk_cases.append({"status": case})
            solver.forget_last_case()
            continue
        start_time = time.perf_counter()
        value_by_column: CaseValues = {
            "crack_length": geometry.crack_length,
            "harmonics": case.harmonic_balance.harmonics,
            **_load_and_nearest_frequency_by_column(
                case.excitation.omega, geometry.bilinear_frequencies
            ),
            **_natural_frequency_by_column(geometry.bilinear_frequencies),
        }
        try:
            if frequencies_only_flags[case_number % len(frequencies_only_flags)]:
                value_by_column["status"] = FREQUENCIES_ONLY_STATUS
            else:
                value_by_column |= solver.solve_and_observe(case, case_options)
        except SINGLE_COMPUTATION_FAILURES as error:
            solver.forget_last_case()
            value_by_column["status"] = str(error)
        result_values_of_chunk_cases.append(
            value_by_column | {"seconds": time.perf_counter() - start_time}
        )
    return result_values_of_chunk_cases


class CaseSolver:
    """Solver for sweep cases with a shared structure.

    Each solution is the initial guess for the next case. Cases that differ only in frequency share
    structure, contact law and equations. If a case misses its tolerance, the structure gets more
    modes, for this case and all further cases.
    """

    def __init__(self, geometry: SweepGeometry) -> None:
        self._geometry = geometry
        self.forget_last_case()

    def forget_last_case(self) -> None:
        """Forget the last solution, so that the next case starts from the linear solution."""
        self._last_case_without_frequency: Scene | None = None
        self._last_solution: PeriodicSolution | None = None

    def solve_and_observe(self, case: Scene, case_options: SharedCaseOptions) -> CaseValues:
        """Solve a case at its frequency or, if requested, at resonance; return its values.

        Parameters
        ----------
        case : Scene
            The case's scene.
        case_options : SharedCaseOptions
            Options; ``at_resonance`` requests the resonance.

        Returns
        -------
        dict
            Values by column name, with the Fourier coefficients "gap" [m] and "force" [N].

        Raises
        ------
        InputError, ConvergenceError, LinAlgError
            The computation has failed.
        """
        solve = (
            self.solve_at_resonance if case_options.at_resonance else self.solve_at_given_frequency
        )
        solution, tolerance = solve(case), case.harmonic_balance.tolerance
        while (
            tolerance
            and lacks_modes(solution, tolerance)
            and (geometry_with_more_modes := self._geometry.geometry_with_more_modes)
        ):
            self._geometry = geometry_with_more_modes
            self.forget_last_case()
            solution = solve(case)
        value_by_column = (
            _observe_value_by_column(solution, case, self._geometry)
            | _load_and_nearest_frequency_by_column(
                solution.omega, self._geometry.bilinear_frequencies
            )
            | solution.to_dict()
            | {"gap": solution.row_gap_coefficients, "force": solution.row_force_coefficients}
        )
        if not case_options.estimates_reduction_error:
            value_by_column.pop("reduction_error")
        if case_options.assesses_stability and case.harmonic_balance.error:
            value_by_column |= self.assess_stability_by_name(solution)
            value_by_column["status"] += value_by_column.pop("remark", "")
        return value_by_column

    def solve_at_given_frequency(self, case: Scene) -> PeriodicSolution:
        """Solve a case at its own load frequency, by harmonic balance.

        A case without contact has a linear solution. If the computation fails, an exception from
        :data:`SINGLE_COMPUTATION_FAILURES` is raised: InputError, ConvergenceError or LinAlgError.
        """
        omega, balance_table = case.excitation.omega, case.harmonic_balance
        self._set_structure_and_law(case)
        structure, law = self._structure, self._law
        if law is None:
            return solve_linear(structure, omega, harmonics=balance_table.harmonics)
        law = slide_along_lines(structure, omega, law)
        check_memory(structure, balance_table.harmonics)
        problem = Problem(structure, omega, law, balance_table.harmonics, balance_table.samples)
        neighbour_solution, self._last_solution = self._last_solution, None
        self._last_solution = solve_from_neighbour(
            problem, neighbour_solution, balance_table.tolerance, with_errors=balance_table.error
        )
        return self._last_solution

    def _set_structure_and_law(self, case: Scene) -> None:
        """Set structure and contact law for a case.

        Both stay the same if only the load frequency differs from the last case.
        """
        case_without_frequency = case.replace({"excitation.omega": 1.0, "curve": None})
        if self._last_case_without_frequency != case_without_frequency:
            self._last_case_without_frequency = case_without_frequency
            self._structure = self._geometry.structure_of_case(case)
            self._law = scene_contact_law(case, self._structure)

    def solve_at_resonance(self, case: Scene) -> PeriodicSolution:
        """Solve a case at the resonance nearest to its frequency.

        The mode is chosen whose bilinear frequency, the natural frequency with a breathing crack,
        is nearest to the case's frequency. Usually the resonance is this mode's phase resonance.
        With friction, with a smooth contact law, or if several modes respond together, the
        resonance is the response curve's peak.

        Raises
        ------
        InputError, ConvergenceError, LinAlgError
            The computation has failed (:data:`SINGLE_COMPUTATION_FAILURES`).
        """
        balance_table = case.harmonic_balance
        self._set_structure_and_law(case)
        omega = case.excitation.omega
        assert self._law is not None
        law = slide_along_lines(self._structure, omega, self._law)
        problem = Problem(
            self._structure, omega, law, balance_table.harmonics, balance_table.samples
        )
        resonance = None
        if is_unilateral(law) and not problem.has_friction:
            nearest_mode_value_by_name = self._geometry.bilinear_frequencies.nearest(omega)
            bilinear_omega = float(nearest_mode_value_by_name["omega_bilinear"])
            resonance = resonance_at(problem, bilinear_omega, tolerance=balance_table.tolerance)
        if resonance is None or resonance.several:
            omega, self._last_solution = self._find_peak_omega_and_solution(problem)
        else:
            omega, self._last_solution = resonance.omega, resonance.solution
        return self.solve_at_given_frequency(case.replace({"excitation.omega": omega}))

    def _find_peak_omega_and_solution(self, problem: Problem) -> tuple[float, PeriodicSolution]:
        """Return frequency and solution at the peak of a response curve.

        The curve belongs to the mode whose bilinear frequency, the natural frequency with a
        breathing crack, is nearest to the problem's frequency. With the mode's damping ratio xi,
        the curve goes from (1 - 2 xi) omega_open to (1 + 2 xi) omega_tied. The natural frequencies
        omega_open and omega_tied have the crack open and bonded.

        Returns
        -------
        omega : float
            Frequency at the peak [rad/s].
        solution : PeriodicSolution
            Solution at the curve point nearest to the peak.

        Raises
        ------
        InputError
            xi is not between 0 and 0.5.
        """
        natural_frequencies = self._geometry.bilinear_frequencies
        nearest_mode_value_by_name = natural_frequencies.nearest(problem.omega)
        mode_damping_ratios = list_modal_damping_ratios(
            self._geometry.structure.whole, natural_frequencies.omega_open
        )
        nearest_mode_damping_ratio = float(
            mode_damping_ratios[int(nearest_mode_value_by_name["mode"]) - 1]
        )
        if (
            not 0.0 < 2.0 * nearest_mode_damping_ratio < 1.0
        ):  # widths to either side where it is looked for
            requirement_text = (
                "above 0 and below 0.5 for the mode whose resonance is sought; change [damping]"
            )
            raise InputError("damping", nearest_mode_damping_ratio, requirement_text)
        start_omega = (1.0 - 2.0 * nearest_mode_damping_ratio) * float(
            nearest_mode_value_by_name["omega_open"]
        )
        stop_omega = (1.0 + 2.0 * nearest_mode_damping_ratio) * float(
            nearest_mode_value_by_name["omega_tied"]
        )
        response_curve = continue_frequency(
            problem.structure, start_omega, stop_omega, problem.contact,
            harmonics=problem.harmonics, samples=problem.samples, stability=False,
        )  # fmt: skip
        peak = response_curve.top()
        return peak.value, response_curve.solution(peak.index)

    def assess_stability_by_name(self, solution: PeriodicSolution) -> CaseValues:
        """Assess a solution's stability for the sweep's columns.

        Returns
        -------
        dict
            "verdict": stable, unstable, irregular or undecided. "multiplier": largest modulus among
            the Floquet multipliers, missing if they could not be computed. "remark": why stability
            is undecided, or how a computation with more modes contradicts the verdict; else "". The
            dict is empty without a contact law, and for rigid contact between crack faces with
            mass.
        """
        structure, law, remark_text = solution.structure, solution.contact, ""
        if law is None or (is_rigid(law) and not structure.has_massless_crack_faces):
            return {}
        try:
            stability = floquet(structure, solution)
        except SINGLE_COMPUTATION_FAILURES:
            return {
                "verdict": "undecided",
                "remark": (
                    f"; {UNDECIDED_STATUS_PREFIX}the Floquet multipliers could not be computed"
                ),
            }
        if stability.reason:
            remark_text = f"; {stability.verdict}: {stability.reason}"
        elif structure.has_massless_crack_faces and (
            more_modes_assessment := solution.assessment.more_modes
        ):
            contradiction_text = more_modes_assessment.describe_contradiction(stability.verdict)
            remark_text = (
                CONTRADICTION_STATUS_PREFIX + contradiction_text if contradiction_text else ""
            )
        return {
            "verdict": stability.verdict,
            "multiplier": abs(stability.multipliers[0]),
            "remark": remark_text,
        }


def _load_and_nearest_frequency_by_column(
    omega: float, natural_frequencies: BilinearFrequencies
) -> CaseValues:
    """Return load frequency and natural frequencies of the nearest mode, by column name.

    The nearest mode has the bilinear frequency, the natural frequency with a breathing crack,
    nearest to the load frequency.

    Parameters
    ----------
    omega : float [rad/s]
        Load frequency.
    natural_frequencies : BilinearFrequencies
        The structure's natural frequencies.
    """
    return add_frequency_entries({"omega": omega}) | natural_frequencies.nearest(omega)


def _natural_frequency_by_column(natural_frequencies: BilinearFrequencies) -> CaseValues:
    """Return the lowest natural frequencies [rad/s] by column name, such as "omega_open_1".

    For modes 1 to 6 there is a frequency with the crack open ("omega_open"), one with the crack
    bonded ("omega_tied"), and one with a breathing crack ("omega_bilinear").
    """
    omegas_of_kinds = (
        natural_frequencies.omega_open,
        np.sort(natural_frequencies.omega_tied),
        natural_frequencies.omega_bilinear,
    )
    kinds_and_omegas = zip(FREQUENCY_KIND_NAMES, omegas_of_kinds, strict=True)
    return {
        f"omega_{kind}_{mode_number}": omega
        for kind, omegas in kinds_and_omegas
        for mode_number, omega in enumerate(omegas, 1)
    }


def _observe_value_by_column(
    solution: PeriodicSolution, case: Scene, geometry: SweepGeometry
) -> CaseValues:
    """Return values for the sweep's columns from a case's solution, by column name.

    Values describe the displacement at the load's point, and at points in ``[output.points]``:
    amplitude, mean and further indicators, and cosine and sine parts of harmonics. Crack faces have
    indicators, too, such as the opening. Quantities at crack tips and at the clamp are included if
    the scene requests them.

    Parameters
    ----------
    solution : PeriodicSolution
        The case's solution.
    case : Scene
        The case's scene, with the load's direction.
    geometry : SweepGeometry
        Shared structure, with rows for the watched displacements.
    """
    dof_weight_row_by_point_name = (
        _find_load_direction_row_by_name(solution, case) | geometry.dof_weight_row_by_watched_name
    )
    dof_weight_rows = np.reshape(
        [*dof_weight_row_by_point_name.values()],
        (len(dof_weight_row_by_point_name), solution.structure.n_dofs),
    )
    observed_displacements, value_by_column = solution.observe_rows(
        dof_weight_rows, make_requested_rows_and_readers(geometry.study)
    )
    for point_name, observed_displacement in zip(
        dof_weight_row_by_point_name, observed_displacements, strict=True
    ):
        value_by_quantity = {
            quantity: getattr(observed_displacement.indicators, quantity)
            for quantity in UNIT_BY_OUTPUT_POINT_QUANTITY
        }
        value_by_quantity |= zip(
            UNIT_BY_HARMONIC_PART,
            observed_displacement.real_fourier_coefficients[1:].tolist(),
            strict=False,
        )
        value_by_column |= {
            f"{point_name}.{quantity}"
            if point_name
            else column_name_at_load(quantity): quantity_value
            for quantity, quantity_value in value_by_quantity.items()
        }
    return value_by_column


def _find_load_direction_row_by_name(
    solution: PeriodicSolution, case: Scene
) -> dict[str, np.ndarray]:
    """Return a row R (n_dofs,) for the displacement along the load, at the load's point.

    R times the structure's displacements u (n_dofs,) is the displacement [m]. The load's mean,
    cosine and sine parts may have different directions. R has the direction of the largest cosine
    or sine part. If the load has neither, R has the mean's direction.

    For the chosen part, F is the force vector [N] at the load's point, and f is the structure's
    load vector. Then R = f / |F|. The result is a dictionary with the key ""; it is empty without a
    force.
    """
    force_norms_of_fourier_parts = np.linalg.norm(list_mean_cos_and_sin_force_vectors(case), axis=1)
    mean_cos_or_sin_index = (
        len(force_norms_of_fourier_parts) - 1 - int(np.argmax(force_norms_of_fourier_parts[:0:-1]))
        if np.any(force_norms_of_fourier_parts[1:])
        else 0
    )
    force_norm = force_norms_of_fourier_parts[mean_cos_or_sin_index]
    return {"": solution.structure.force[mean_cos_or_sin_index] / force_norm} if force_norm else {}
