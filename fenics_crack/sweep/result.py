"""Sweeps: many cases for a scene, shared by ranks, in a file that a later run continues.

A sweep axis is a key in ``[sweep.over]`` with its values. The cases are all combinations of these
values, numbered with the last sweep axis fastest.

*Geometries.* A geometry is a combination of mesh, matrices, modes, damping and load position.
Frequency, force, contact law, clearance and truncation do not change it. A geometry is built once,
as a small structure in plain arrays for any rank.

*Chunks.* The cases for a geometry are cut into chunks of up to 16 along the frequency. Without a
swept frequency they are cut along the last sweep axis without effect on the geometry. The first
case in a chunk starts from the linear solution, each further case from its neighbour. Cases along
the frequency share their equations (:class:`fenics_crack.sweep.case.CaseSolver`). Chunks depend on
the scene alone, and so do the results, to the bit with the same number of BLAS threads. Neither
interruptions nor the number of ranks change them, if the ranks share cases and not a mesh.

*Jobs.* A job is a few chunks of one geometry. Rank 0 sends jobs to all ranks, solves jobs too and
writes the results (:mod:`fenics_crack.sweep.jobs`). Geometries with many pairs and long cracks come
first. A rank goes on with its present geometry. Towards the end the ranks share the remaining
chunks, so that all finish together.
"""

from __future__ import annotations

import itertools
import operator
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from mpi4py import MPI

from fenics_crack.balance.contact_system import default_projection_weight
from fenics_crack.balance.error_report import LARGE_ERROR, PART_NAMES_OF_TOTAL_ERROR
from fenics_crack.balance.harmonic_balance import slide_along_lines, solve_linear
from fenics_crack.balance.more_modes import ERROR_IF_UNKNOWN
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.atomic_files import make_folder_until_exit
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.observables import (
    IN_SWEEP_PICTURES,
    OBSERVABLES_BY_NAME,
    Place,
    observable_names,
)
from fenics_crack.basics.progress import add_progress_text
from fenics_crack.basics.ranks import StopRequest, on_root
from fenics_crack.basics.suggestions import check_calls, keep_old_attribute_names
from fenics_crack.basics.tables import (
    Conclusion,
    Tabular,
    format_count,
    format_error,
    format_quantity,
    import_optional,
)
from fenics_crack.files.results import rebuild_solution
from fenics_crack.files.store import StoredFile, read_result_file_without_numbers
from fenics_crack.model.structure import Structure
from fenics_crack.runs.conclusion import list_linearity_sentences
from fenics_crack.scene.fields import Axis
from fenics_crack.scene.keys import unit_of_key
from fenics_crack.scene.result_tables import Sweep
from fenics_crack.scene.scene import Scene
from fenics_crack.study.prepare import scene_contact_law
from fenics_crack.sweep.case import SharedCaseOptions, iterate_geometries_with_more_modes
from fenics_crack.sweep.file import (
    CONTRADICTION_STATUS_PREFIX,
    KIND,
    UNDECIDED_STATUS_PREFIX,
    CaseState,
    SweepFile,
    column_name_at_load,
    read_column_by_name,
    read_gap_and_force_coefficients,
    scene_of_sweep,
    unit_and_type_by_column,
)
from fenics_crack.sweep.jobs import Manager, Worker, serve_jobs
from fenics_crack.sweep.plan import Plan

SCENES_WITHOUT_PEAK_DESCRIPTION = "without contact or with [rotation]"
"""Description of scenes for which no largest response over the frequency is sought."""
CASE_STATE_NAMES = np.array([state.name.lower() for state in CaseState])
"""Names "pending", "converged" and "failed" of a case's state, by state (0, 1, 2)."""


def run_sweep(
    scene: Scene,
    path: str | Path | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    progress: bool = False,
    verdicts: bool = True,
    judged: bool = True,
    natural: Collection[int] = (),
) -> SweepResult:
    """Solve all cases in a scene's sweep by harmonic balance (collective).

    A case is one combination of swept values. If it cannot be solved, the reason is recorded.
    Ctrl-C stops after the present cases; the same call continues with the missing cases.

    Parameters
    ----------
    scene : Scene
        Scene with a table ``[sweep]``.
    path : path, optional
        File for the results. Default: a file that lasts as long as the program. An existing file
        must have the same scene and mesh files. All its tried cases are kept. If cases are missing,
        ``verdicts``, ``judged`` and ``natural`` must be the same, too.
    comm : MPI.Comm
        Ranks that share the cases.
    progress : bool
        Show a progress bar.
    verdicts : bool
        Assess the stability of each case. It takes a tenth to a third of the time if many cases
        share a structure. Otherwise the columns ``verdict`` and ``multiplier`` are empty.
    judged : bool
        Estimate the reduction error, with twice the modes. Otherwise the column ``reduction_error``
        is empty.
    natural : collection of int
        Positions, from 0, in the value list of the last key in ``[sweep.over]``. For these values
        only natural frequencies are computed. The cases count as failed.

    Returns
    -------
    SweepResult
        Table of all cases, on every rank; incomplete after Ctrl-C.

    Raises
    ------
    InputError
        The scene has no sweep, no combination of swept values gives a valid scene, a structure is
        not reduced and too large, or the file cannot be used.

    Examples
    --------
    >>> swept = scene.replace({"sweep.over": {"excitation.omega": [1900.0, 2000.0]}})
    >>> table = fc.run_sweep(swept, "sweep.h5").to_dict()
    """
    sweep_table: Sweep = scene.given("sweep")
    if sweep_table.at_resonance and not can_seek_resonance(scene):
        raise InputError("sweep.at_resonance", True, f"false {SCENES_WITHOUT_PEAK_DESCRIPTION}")
    last_axis_length = sweep_table.shape[-1]
    if positions_outside_last_axis := [
        last_axis_position
        for last_axis_position in natural
        if last_axis_position not in range(last_axis_length)
    ]:
        raise InputError(
            "natural",
            positions_outside_last_axis,
            f"numbers of values of the last axis, from 0 to {last_axis_length - 1}",
        )
    managers_on_root: list[Manager] = []

    def make_manager_and_case_options() -> SharedCaseOptions:
        """Open the file and append the sweep's manager to managers; return the case options."""
        plan = Plan(scene)
        option_by_name = {"verdicts": verdicts, "judged": judged}
        omitted_options = [name for name, is_wanted in option_by_name.items() if not is_wanted]
        omitted_options += [
            f"vibration_{last_axis_position}" for last_axis_position in sorted(natural)
        ]
        file_path = Path(path or make_folder_until_exit() / "sweep.h5")
        sweep_file = SweepFile(
            file_path,
            scene,
            plan.n_harmonics_upper_bound,
            plan.n_gap_rows_upper_bound,
            omitted_options,
        )
        managers_on_root.append(Manager(plan, sweep_file, comm.size, progress=progress))
        return SharedCaseOptions(
            plan.has_unit_loads,
            stops_sweep_if_structure_too_large=not plan.is_reduction_method_swept,
            at_resonance=sweep_table.at_resonance,
            assesses_stability=verdicts,
            estimates_reduction_error=judged,
            frequencies_only_flags_of_last_axis=tuple(
                last_axis_position in natural for last_axis_position in range(last_axis_length)
            ),
        )

    case_options = on_root(comm, make_manager_and_case_options)
    worker = Worker(case_options, managers_on_root[0].plan if managers_on_root else Plan(scene))
    job_message_comm = comm.Dup()
    with StopRequest() as stop_request:
        if managers_on_root:
            with add_progress_text(managers_on_root[0].progress_text):
                managers_on_root[0].run(worker, job_message_comm, stop_request)
        else:
            serve_jobs(worker, job_message_comm)
    worker.release_geometry(is_stopped=stop_request.is_requested(comm))
    job_message_comm.Free()
    return on_root(comm, lambda: SweepResult.from_stored_file(managers_on_root[0].sweep_header))


def can_seek_resonance(scene: Scene) -> bool:
    """Return True if this scene's sweep can solve each case at its resonance.

    The scene must have contact and no rotation.
    """
    return scene.contact is not None and scene.speed == 0.0


# --- the result -----------------------------------------------------------------------------------

VERDICTS_NOT_STABLE = "unstable", "irregular", "undecided"
"""Verdicts on stability with which a solution may not appear in reality."""


@keep_old_attribute_names(
    failed="failed_indices_and_reasons", undecided="undecided_indices_and_reasons",
    contradicted="cases_contradicted_by_more_modes", errors="error_parts",
)  # fmt: skip
@keep_old_attribute_names(contradicted_indices_and_verdicts="cases_contradicted_by_more_modes")
@dataclass(frozen=True, repr=False)
class SweepResult(Tabular):
    """Result of a sweep: a table of cases, read from a file.

    The Fourier coefficients of gaps and forces are read on request (:meth:`gap`, :meth:`solution`).

    Attributes
    ----------
    path : Path
        File.
    scene : Scene
        Scene with the sweep's axes.
    columns : dict of str to array
        Numbers and texts by name, in the shape of the axes; nan without a value.

        - ``response``: half the peak-to-peak displacement at the load, in its direction [m]
        - ``mean`` and so on: indicators of the same displacement, as in :class:`Indicators`
        - ``cosine_1`` to ``sine_6``: cosine and sine parts of its harmonics [m]
        - ``tip.ux.ratio_2_1``: the same for points in ``[output.points]``
        - ``opening`` and so on: indicators of the crack faces, as in :class:`Indicators`
        - ``omega_open`` to ``over_bilinear``: as in :meth:`BilinearFrequencies.nearest`
        - ``omega_open_1`` to ``omega_tied_6``: natural frequencies, crack open or bonded [rad/s]
        - ``omega_bilinear_1`` to ``omega_bilinear_6``: natural frequencies, breathing crack [rad/s]
        - ``multiplier``: largest modulus among Floquet multipliers, as in :class:`Stability`
        - ``verdict``: stability, as in :class:`Stability`; empty without a contact law
        - ``residual_error`` to ``reduction_error``: as in :class:`ErrorReport`
        - ``penetration_share``: as in :class:`ErrorReport`
        - ``harmonics``, ``iterations``: number of harmonics, number of Newton iterations
        - ``crack_length``: length of the first crack, given or found [m]
        - ``seconds``: wall-clock time for the case [s]
        - ``status``: how the case was solved, or why not
        - ``state``: 0 pending, 1 converged, 2 failed
        - ``omega``, ``frequency``: load frequency [rad/s], [Hz]
    """

    path: Path
    scene: Scene
    columns: dict[str, np.ndarray]

    KIND: ClassVar[str] = KIND

    @classmethod
    @check_calls
    def load(cls, path: str | Path) -> SweepResult:
        """Read a sweep's table from its file, also while the sweep runs.

        Nothing is computed.

        Raises
        ------
        InputError
            The file cannot be read, is damaged, or is no sweep's file.
        """
        return cls.from_stored_file(read_result_file_without_numbers(Path(path)))

    @classmethod
    def from_stored_file(cls, sweep_header: StoredFile) -> SweepResult:
        """Read a sweep's table from a file whose header was read already.

        Raises
        ------
        InputError
            The file cannot be read, is damaged, or is no sweep's file.
        """
        scene = scene_of_sweep(sweep_header)
        return cls(sweep_header.path, scene, read_column_by_name(sweep_header, scene))

    def __getitem__(self, name: str) -> np.ndarray:
        return self.columns[name]

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Swept keys, each with its values: the axes of the table."""
        return tuple(self.scene.given("sweep").over)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values on each sweep axis."""
        return tuple(self.scene.given("sweep").shape)

    @property
    def complete(self) -> bool:
        """True if no case is pending: each was solved or failed."""
        return not np.any(self["state"] == CaseState.PENDING)

    @property
    def converged(self) -> np.ndarray:
        """True for solved cases: bool array in the shape of the axes."""
        return self["state"] == CaseState.CONVERGED

    @property
    def error_parts(self) -> np.ndarray:
        """Estimated relative errors by cause and case: (4, n_1, n_2, ...).

        n_i is the number of values on axis i. The four causes are truncation, reduction, sampling
        and residual, as in :class:`ErrorReport`. The error is 0 in a case without a solution or an
        estimate.
        """
        return np.nan_to_num(
            [self[f"{error_part_name}_error"] for error_part_name in PART_NAMES_OF_TOTAL_ERROR]
        )

    @property
    def inexact(self) -> np.ndarray:
        """True for solved cases with a total error above 5 % (``LARGE_ERROR``).

        The total error is the sum of :attr:`error_parts` in a case. The bool array has the shape of
        the axes.
        """
        return self.converged & (self.error_parts.sum(axis=0) > LARGE_ERROR)

    @property
    def not_stable(self) -> np.ndarray:
        """True for cases with an unstable, irregular or undecided verdict.

        This bool array has the shape of the axes.
        """
        return np.isin(self["verdict"], VERDICTS_NOT_STABLE)

    @property
    def failed_indices_and_reasons(self) -> list[tuple[tuple[int, ...], str]]:
        """Index and reason for each case that could not be solved.

        The index is the position on each sweep axis. Cases for which only natural frequencies were
        requested are included, as they were not solved.
        """
        return self._find_indices_and_statuses(self["state"] == CaseState.FAILED)

    @property
    def undecided_indices_and_reasons(self) -> list[tuple[tuple[int, ...], str]]:
        """Index and reason for each case with undecided stability.

        The index is the position on each sweep axis.
        """
        indices_and_statuses = self._find_indices_and_statuses(
            self.converged & (self["verdict"] == "undecided")
        )
        return [
            (
                case_index,
                status.partition(UNDECIDED_STATUS_PREFIX)[2]
                or "the file does not state the reason",
            )
            for case_index, status in indices_and_statuses
        ]

    @property
    def cases_contradicted_by_more_modes(self) -> list[tuple[tuple[int, ...], str]]:
        """Index and text for each case whose verdict on stability changes with more modes.

        The index is the position on each sweep axis. The text describes the stability with more
        modes.

        Only crack faces without mass are checked, by one Newton step with twice the modes. The
        check finds about two in three of all such cases. To check a single case more exactly, use
        :func:`fenics_crack.solve`.
        """
        indices_and_statuses = self._find_indices_and_statuses(
            self.converged & (self["verdict"] != "undecided")
        )
        return [
            (case_index, contradiction_text)
            for case_index, status in indices_and_statuses
            if (contradiction_text := status.partition(CONTRADICTION_STATUS_PREFIX)[2])
        ]

    def _find_indices_and_statuses(
        self, is_selected: np.ndarray
    ) -> list[tuple[tuple[int, ...], str]]:
        """Return index (position on each sweep axis) and ``status`` of each selected case.

        ``is_selected`` is a bool array in the shape of the axes.
        """
        return [
            (tuple(map(int, case_index)), str(self["status"][tuple(case_index)]))
            for case_index in np.argwhere(is_selected)
        ]

    def gap(self, index: tuple[int, ...] | int) -> np.ndarray:
        """Return the normal gaps' Fourier coefficients for a converged case: (2H+1, n_pairs) [m].

        The rows are the mean, then cosine and sine for each of H harmonics.

        Parameters
        ----------
        index : tuple of int, or int
            Position on each axis, or case number (last axis fastest).

        Raises
        ------
        InputError
            There is no such case, or it was not solved.
        """
        case_index = self._find_converged_index(index)
        gap_coefficients = read_gap_and_force_coefficients(self.path, case_index)[0]
        case_scene = Plan(self.scene).scene_or_reason_at(case_index)
        assert isinstance(case_scene, Scene)
        return (
            gap_coefficients[:, : gap_coefficients.shape[1] // 2]
            if case_scene.has_friction
            else gap_coefficients
        )

    def solution(self, index: tuple[int, ...] | int) -> PeriodicSolution:
        """Return the solution of a converged case; its structure is built again.

        Parameters
        ----------
        index : tuple of int, or int
            Position on each axis, or number of the case (last axis fastest).

        Raises
        ------
        InputError
            There is no such case, it was not solved, or a mesh or matrix file has changed.
        """
        case_index = self._find_converged_index(index)
        read_result_file_without_numbers(self.path).check_files(self.scene)
        plan = Plan(self.scene)
        case_scene = plan.scene_or_reason_at(case_index)
        assert isinstance(case_scene, Scene)
        crack_length = float(self["crack_length"][case_index])
        if case_scene.crack is not None and case_scene.crack.first_omega is not None:
            case_scene = case_scene.replace(
                {"crack.length": crack_length, "crack.first_omega": None}
            )
        for geometry in iterate_geometries_with_more_modes(
            case_scene, SharedCaseOptions(plan.has_unit_loads)
        ):
            try:
                return self._restore_solution(
                    geometry.structure_of_case(case_scene), case_scene, case_index
                )
            except InputError as error:  # the file's waves may be of other modes
                last_error = error
        raise last_error

    def _restore_solution(
        self, structure: Structure, case_scene: Scene, case_index: tuple[int, ...]
    ) -> PeriodicSolution:
        """Return a case's stored solution in a structure that was built again.

        InputError if the stored Fourier coefficients do not fit the structure.

        Parameters
        ----------
        structure : Structure
            The case's structure, built again.
        case_scene : Scene
            The case's scene.
        case_index : tuple of int
            The case's position on each sweep axis.
        """
        omega = float(self["omega"][case_index])
        law = scene_contact_law(case_scene, structure)
        if law is None:
            return solve_linear(structure, omega, harmonics=case_scene.harmonic_balance.harmonics)
        law = slide_along_lines(structure, omega, law)
        gap_coefficients, force_coefficients = read_gap_and_force_coefficients(
            self.path, case_index
        )
        problem = Problem(structure, omega, law, len(gap_coefficients) // 2)
        # Without displacements: they follow from the forces.
        wave = problem.wave_of(
            np.zeros((len(gap_coefficients), 0)), gap_coefficients, force_coefficients
        )
        value_by_field = vars(wave) | {
            "status": str(self["status"][case_index]),
            "iterations": int(self["iterations"][case_index]),
            "error_penetration": float(self["penetration_share"][case_index]),
            "error_displacement": 0.0,
            **{
                f"error_{error_part_name}": float(self[f"{error_part_name}_error"][case_index])
                for error_part_name in PART_NAMES_OF_TOTAL_ERROR
            },
        }
        if problem.has_projected_constraint:
            value_by_field["weight"] = default_projection_weight(problem.compliance_model())
        return rebuild_solution(value_by_field, structure, law)

    def _find_converged_index(self, index: tuple[int, ...] | int) -> tuple[int, ...]:
        """Return a converged case's position on each sweep axis; InputError for other cases.

        ``index`` is this position, or the case number. In a case number, the position on the last
        axis changes fastest.
        """
        try:
            raw_index = index if isinstance(index, tuple) else np.unravel_index(index, self.shape)
            case_index = tuple(map(operator.index, raw_index))
            is_converged = (
                len(case_index) == len(self.shape)
                and min(case_index) >= 0
                and bool(self.converged[case_index])
            )
        except (IndexError, ValueError, TypeError):
            is_converged = False
        if not is_converged:
            raise InputError(
                "index",
                index,
                f"the index of a converged case in a sweep of shape {self.shape}; result.converged "
                "tells which are",
            )
        return case_index

    # --- shown ------------------------------------------------------------------------------------

    @property
    def quantities(self) -> dict[str, tuple[str, str]]:
        """Label and unit of the columns to draw and print, by column name.

        The scene's key ``output.quantities`` chooses the columns. Without this key, there is a
        default choice.
        """
        label_by_point, label_and_unit_by_column = self.scene.label_by_displacement_name, {}
        for quantity_name in self.scene.quantities or observable_names(
            required_flags=IN_SWEEP_PICTURES
        ):
            label = OBSERVABLES_BY_NAME[quantity_name].words
            unit = OBSERVABLES_BY_NAME[quantity_name].unit
            if OBSERVABLES_BY_NAME[quantity_name].place is not Place.WATCHED_POINT:
                label_and_unit_by_column[quantity_name] = label, unit
            elif label_by_point:
                label_and_unit_by_column |= {
                    f"{point_name}.{quantity_name}": (f"{label}, {point_label}", unit)
                    for point_name, point_label in label_by_point.items()
                }
            else:
                label_and_unit_by_column[column_name_at_load(quantity_name)] = (
                    f"{label} at the load's point",
                    unit,
                )
        return {
            quantity_name: label_and_unit
            for quantity_name, label_and_unit in label_and_unit_by_column.items()
            if quantity_name in self.columns
        }

    def to_dict(self) -> dict[str, Any]:
        """Return the table as lists by column name.

        The swept keys come first. Each list has one entry for each case.
        """
        axis_columns = zip(*itertools.product(*(axis.values for axis in self.axes)), strict=True)
        values_by_column = {
            axis.key: list(axis_column)
            for axis, axis_column in zip(self.axes, axis_columns, strict=True)
        }
        values_by_column["state"] = CASE_STATE_NAMES[self["state"]].ravel().tolist()
        column_names = (column_name for column_name in self.columns if column_name != "state")
        return values_by_column | {
            column_name: self[column_name].ravel().tolist() for column_name in column_names
        }

    def to_xarray(self) -> Any:
        """Return the columns of :meth:`to_dict` as an ``xarray.Dataset`` with units.

        The dimensions are the swept keys.

        Raises
        ------
        ImportError
            xarray is not installed: the package does without it.
        """
        dataset_class = import_optional("xarray", "to_xarray").Dataset
        unit_by_column = self._unit_by_name()
        values_by_key = {
            axis.key: [
                axis_value if np.isscalar(axis_value) else str(axis_value)
                for axis_value in axis.values
            ]
            for axis in self.axes
        }
        variable_by_name = {
            column_name: (
                [*values_by_key],
                np.reshape(column_values, self.shape),
                {"units": unit_by_column.get(column_name, "")},
            )
            for column_name, column_values in self.to_dict().items()
            if column_name not in values_by_key
        }
        return dataset_class(variable_by_name, values_by_key)

    def _unit_by_name(self) -> dict[str, str]:
        """Return the units of swept keys and columns, by name."""
        unit_by_key = {axis.key: unit_of_key(axis.key) for axis in self.axes}
        return unit_by_key | {
            column_name: unit
            for column_name, (unit, _) in unit_and_type_by_column(self.scene).items()
        }

    def build_conclusion(self) -> Conclusion:
        """Build the sweep's closing sentence: largest response, errors, verdicts.

        The command prints this sentence.
        """
        is_converged, clause_texts = self.converged, []
        total_error_of_converged_cases = self.error_parts.sum(axis=0)[is_converged]
        case_count_text = format_count(is_converged.size, "case")
        if np.any(
            np.isfinite(
                responses_nan_unless_converged := np.where(is_converged, self["response"], np.nan)
            )
        ):
            peak_index = np.unravel_index(
                int(np.nanargmax(responses_nan_unless_converged)),
                responses_nan_unless_converged.shape,
            )
            largest_response_text = format_quantity(
                float(responses_nan_unless_converged[peak_index]), "m"
            )
            clause_texts.append(
                f"the largest response is {largest_response_text} half peak-to-peak at "
            )
            clause_texts[0] += describe_swept_values(self.axes, [*map(int, peak_index)])
        largest_error = total_error_of_converged_cases.max(initial=0.0)
        n_unknown_errors = int(np.sum(total_error_of_converged_cases >= ERROR_IF_UNKNOWN))
        if not self.scene.harmonic_balance.error:
            clause_texts.append(
                "errors and stability are not estimated (harmonic_balance.error = false)"
            )
        elif largest_error > 0.0 and not n_unknown_errors:
            error_text = format_error(largest_error)
            clause_texts.append(
                f"the largest estimated error due to modes and harmonics is {error_text}"
            )
        verdict_names, verdict_counts = np.unique(self["verdict"][is_converged], return_counts=True)
        verdict_texts = [
            f"{verdict_count} {verdict_name}"
            for verdict_count, verdict_name in zip(verdict_counts, verdict_names, strict=True)
            if verdict_name
        ]
        return Conclusion(
            "sweep complete"
            if is_converged.all()
            else f"{is_converged.sum()} of {case_count_text} converged",
            ", ".join(clause_texts),
            f"it could not be estimated in {format_count(n_unknown_errors, 'case')}"
            if n_unknown_errors
            else "",
            [
                *list_linearity_sentences(self["closed_share"][is_converged]),
                ", ".join(verdict_texts),
            ],
        )

    def _repr_text(self) -> str:
        """Return a short description: number of values on each axis, number of cases in each state.

        The states are pending, converged and failed. A state without cases is not named.
        """
        state_names_and_case_counts = zip(
            CASE_STATE_NAMES, np.bincount(self["state"].ravel(), minlength=3), strict=True
        )
        axes_text = " x ".join(f"{len(axis.values)} {axis.key}" for axis in self.axes)
        return ", ".join(
            [
                axes_text,
                *(
                    f"{n_cases_in_state} {state_name}"
                    for state_name, n_cases_in_state in state_names_and_case_counts
                    if n_cases_in_state
                ),
            ]
        )


def has_omitted_options(sweep_header: StoredFile) -> bool:
    """Return True if a sweep was run with computations left out.

    The options ``verdicts``, ``judged`` and ``natural`` of :func:`run_sweep` leave out the
    stability, the reduction error, or the vibration of chosen cases. The command ``sweep`` leaves
    out none. ``sweep_header`` is the header of a result file; for another result than a sweep, the
    answer is False.
    """
    return sweep_header.kind == KIND and bool(sweep_header.attributes.get("omitted"))


# --- cases in words -------------------------------------------------------------------------------


def iterate_texts_by_reason(
    sweep_result: SweepResult,
    indices_and_reasons: Sequence[tuple[tuple[int, ...], str]],
    outcome_text: str,
) -> Iterator[str]:
    """Yield a text for each group of cases with the same reason.

    The largest group comes first. Reasons that differ only in numbers count as the same. Four
    groups are described; a last text counts all further cases.

    Parameters
    ----------
    sweep_result : SweepResult
        Source of the swept values.
    indices_and_reasons : sequence of (index, reason)
        Position on each sweep axis and reason for each case, as in
        :attr:`SweepResult.failed_indices_and_reasons`.
    outcome_text : str
        What happened to the cases, such as "failed". A group's text begins with
        "3 cases {outcome_text}, the first at ...".
    """
    indices_and_reasons_by_pattern: dict[str, list[tuple[tuple[int, ...], str]]] = {}
    for case_index, reason in indices_and_reasons:
        indices_and_reasons_by_pattern.setdefault(
            re.sub(r"[-+]?\d[\d.e+-]*", "#", reason), []
        ).append((case_index, reason))
    groups_largest_first = sorted(indices_and_reasons_by_pattern.values(), key=len, reverse=True)
    n_described_groups = 4
    for group_indices_and_reasons in groups_largest_first[:n_described_groups]:
        case_index, reason = group_indices_and_reasons[0]
        count_text = (
            f"{format_count(len(group_indices_and_reasons), 'case')} {outcome_text}, the first at"
        )
        yield f"{count_text} {describe_swept_values(sweep_result.axes, case_index)}: {reason}"
    if further_groups := groups_largest_first[n_described_groups:]:
        n_further_cases = sum(map(len, further_groups))
        yield (
            f"{format_count(n_further_cases, 'case')} {outcome_text} for other reasons: "
            "see the column status of the table"
        )


def describe_swept_values(axes: Sequence[Axis], index: Sequence[int]) -> str:
    """Return a case's swept values as text.

    An example is "omega = 1900.0, length = 0.02". ``index`` is the case's position on each sweep
    axis.
    """
    return ", ".join(
        f"{axis.key.rpartition('.')[2]} = {axis.values[value_index]}"
        for axis, value_index in zip(axes, index, strict=True)
    )
