"""Sweeps of the forward models: the cases to solve, and their files.

The first sweep has all values of the unknowns, on the scene's mesh or a coarser one. A second one,
on a finer mesh at a few values, corrects it. A third one, at a few values halfway between, tests
the interpolation. All are repeated for the plate without its crack. A killed run continues from
their files.
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.basics.errors import StoppedError
from fenics_crack.basics.progress import begin_stage
from fenics_crack.basics.ranks import MPI, StopRequest, on_root
from fenics_crack.files.store import scene_text
from fenics_crack.monitoring.identification.interpolation import (
    MESH_FILE_AXIS_KEY,
    SolvedCases,
    SweptLoads,
)
from fenics_crack.monitoring.identification.measurements import (
    Measurement,
    get_crack_removal_changes_or_none,
)
from fenics_crack.monitoring.identification.model import (
    ForwardModel,
    has_load_independent_motion_shape,
)
from fenics_crack.monitoring.identification.nuisance import UncrackedPlate
from fenics_crack.monitoring.identification.options import IDENTIFICATION_VALUES
from fenics_crack.monitoring.identification.posterior import build_first_grid
from fenics_crack.monitoring.identification.predictor import MeasurementPredictor
from fenics_crack.monitoring.identification.result import Identification
from fenics_crack.scene.fields import Axis
from fenics_crack.scene.result_tables import MIN_GRID_VALUES_PER_UNKNOWN, Identify, Sweep
from fenics_crack.scene.scene import Scene
from fenics_crack.study.meshes import refine_scene_or_none
from fenics_crack.sweep.result import SweepResult, run_sweep

TABLES_WITHOUT_EFFECT_ON_FORWARD_MODEL = ("sweep", "curve", "integration", "identify", "tip_timing")
"""Tables of a scene that do not change the solutions in a forward model's sweep."""
ForwardSweeps = tuple[SweepResult, SweepResult | None, SweepResult | None]
"""Three sweeps: all cases, a few on a finer mesh, a few halfway between all cases.

The last two may be None.
"""


def find_vibration_ratio_to_solved_cracks(
    model: ForwardModel, load_frequency: float, point_name: str
) -> tuple[float, np.ndarray]:
    """Find the largest vibration of a point at cracks between solved cracks.

    Used to find resonances between grid points.

    Parameters
    ----------
    model : ForwardModel
        Model that interpolates between solved cracks.
    load_frequency : float [Hz]
        Load frequency of the vibration.
    point_name : str
        Point and direction, such as "tip.ux"; "" for the load's point.

    Returns
    -------
    vibration_ratio : float
        Largest interpolated amplitude of the first harmonic, divided by the largest amplitude at
        any solved crack. 0 if no amplitude is known.
    x : (d,)
        Values of the unknowns with the largest vibration.
    """
    first_harmonic_measurement = Measurement(
        "harmonic_1", 1.0, 1.0, frequency=load_frequency, point=point_name
    )
    trial_points = build_first_grid(model.grid_of_solved_cases).nodes
    interpolated_amplitudes = np.nan_to_num(
        MeasurementPredictor(model, [first_harmonic_measurement])(trial_points).values[:, 0]
    )
    largest_solved_amplitude = np.fmax.reduce(
        np.abs(model.coarse_mesh_cases.get_harmonic_amplitudes(point_name, load_frequency, 1))
    )
    largest_index = int(np.argmax(interpolated_amplitudes))
    vibration_ratio = (
        float(interpolated_amplitudes[largest_index] / largest_solved_amplitude)
        if largest_solved_amplitude > 0.0
        else 0.0
    )
    return vibration_ratio, trial_points[largest_index]


# --- the sweeps of the forward model --------------------------------------------------------------


@dataclass(frozen=True)
class SolvedForwardModels:
    """Solved forward models, with the crack and without.

    Attributes
    ----------
    scene : Scene
        Scene with its table ``[identify]``.
    axes : sequence of Axis
        Unknowns with their solved values.
    cracked_model_by_text_values : dict of str to ForwardModel
        Model with the crack for each choice of text values, as "right" for crack.edge. Keys are the
        values joined with ", "; "" if all unknowns are numbers.
    uncracked_model_by_text_values : dict of str to ForwardModel
        Models without the crack; empty if the crack cannot be removed.
    """

    scene: Scene
    axes: Sequence[Axis]
    cracked_model_by_text_values: dict[str, ForwardModel]
    uncracked_model_by_text_values: dict[str, ForwardModel]


def solve_uncracked_plate(scene: Scene, comm: MPI.Comm) -> UncrackedPlate:
    """Solve the modes of the plate without its crack (collective).

    Rank 0 solves for all ranks. A crack that cannot be removed is bonded.
    """
    identify_table = scene.given("identify")
    uncracked_scene = scene.replace(
        dict.fromkeys(TABLES_WITHOUT_EFFECT_ON_FORWARD_MODEL)
        | (get_crack_removal_changes_or_none(scene) or {})
    )
    begin_stage("plate without the crack")
    return on_root(comm, lambda: UncrackedPlate(uncracked_scene, identify_table))


def solve_forward(
    scene: Scene,
    load_frequencies: Sequence[float],
    folder: Path,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    frequency_only_loads: Sequence[float] = (),
    uncracked_plate: UncrackedPlate | None = None,
    refined_axes: Sequence[Axis] = (),
    progress: bool = False,
) -> SolvedForwardModels:
    """Solve the cases of the forward models, or read their files (collective).

    Parameters
    ----------
    scene : Scene
        Scene with its table ``[identify]``.
    load_frequencies : sequence of float
        Load frequencies [Hz] of measurements; ``identify.frequencies`` are added.
    folder : path
        Folder of the sweeps' files; file names depend on the scene and the frequencies.
    comm : MPI.Comm
        Ranks that share the cases.
    frequency_only_loads : sequence of float
        Load frequencies [Hz] for rotor speeds at which only natural frequencies are needed.
    uncracked_plate : UncrackedPlate, optional
        Plate without its crack; default: solved here.
    refined_axes : sequence of Axis
        Refinements of the grid, in this order. Each is an unknown with its old values and values to
        add.
    progress : bool
        Show progress bars.

    Raises
    ------
    InputError
        The sweeps cannot be run (:func:`run_sweep`).
    StoppedError
        Ctrl-C was pressed.
    """
    uncracked_plate = uncracked_plate or solve_uncracked_plate(scene, comm)
    identify_table = scene.given("identify")
    requested_frequencies = (*load_frequencies, *frequency_only_loads, *identify_table.frequencies)
    swept_loads = SweptLoads(scene, [float(frequency) for frequency in requested_frequencies])
    vibration_frequencies = (
        *load_frequencies,
        *identify_table.frequencies,
        swept_loads.frequencies[0],
    )
    frequency_only_load_indices = [
        load_index
        for load_index, frequency in enumerate(swept_loads.frequencies)
        if frequency not in vibration_frequencies
    ]
    scene_without_tables = scene.replace(dict.fromkeys(TABLES_WITHOUT_EFFECT_ON_FORWARD_MODEL))
    scene_pair = _list_coarse_and_fine_scenes(scene_without_tables, identify_table.finer)
    sweeper = _ForwardSweeper(
        *scene_pair,
        identify_table,
        swept_loads,
        frequency_only_load_indices,
        folder,
        comm,
        progress,
    )
    unknown_axes, refinements_to_apply = list(identify_table.unknown), [*refined_axes]
    sweep_result = sweeper.run_or_read_sweep(
        "forward", sweeper.scene_with_mesh_of_all_cases, [*sweeper.mesh_file_axes, *unknown_axes]
    )
    while True:
        model_by_words = _build_models(
            scene, uncracked_plate, swept_loads, (sweep_result, None, None)
        )
        refined_axis = _refine_axis_at_resonance_or_none(
            scene, model_by_words.values(), load_frequencies, unknown_axes
        )
        if refined_axis is None and not refinements_to_apply:
            break
        refined_axis = refined_axis or refinements_to_apply.pop(0)
        sweep_result = sweeper.run_and_join_added_values(sweep_result, unknown_axes, refined_axis)
        unknown_axes = [
            refined_axis if axis.key == refined_axis.key else axis for axis in unknown_axes
        ]
    cracked_sweeps = sweeper.run_check_sweeps(
        "forward", {}, [*sweeper.mesh_file_axes, *unknown_axes], sweep_result
    )
    crack_removal_value_by_key = get_crack_removal_changes_or_none(scene)
    if crack_removal_value_by_key is None:
        model_by_words = _build_models(scene, uncracked_plate, swept_loads, cracked_sweeps)
        return SolvedForwardModels(scene, unknown_axes, model_by_words, {})
    uncracked_axes = [
        axis for axis in unknown_axes if not axis.key.startswith(("crack.", "contact."))
    ]
    uncracked_sweep = sweeper.run_or_read_sweep(
        "uncracked",
        sweeper.scene_with_mesh_of_all_cases.replace(crack_removal_value_by_key),
        uncracked_axes,
    )
    uncracked_sweeps = sweeper.run_check_sweeps(
        "uncracked", crack_removal_value_by_key, uncracked_axes, uncracked_sweep
    )
    return SolvedForwardModels(
        scene,
        unknown_axes,
        _build_models(scene, uncracked_plate, swept_loads, cracked_sweeps, uncracked_sweeps),
        _build_models(scene, uncracked_plate, swept_loads, uncracked_sweeps),
    )


@dataclass(frozen=True)
class _ForwardSweeper:
    """Sweeps of a forward model over unknowns and loads, each in a file.

    Attributes
    ----------
    scene_with_mesh_of_all_cases : Scene
        Scene with the mesh for all cases.
    fine_scene : Scene or None
        Scene with a finer mesh for a few cases; None without a finer mesh.
    identify_table : Identify
        Table ``[identify]``.
    swept_loads : SweptLoads
        Loads of all sweeps.
    frequency_only_load_indices : list of int
        Indices of loads at which only natural frequencies are needed.
    folder : path
        Folder of the files.
    comm : MPI.Comm
        Ranks that share the cases.
    shows_progress : bool
        True to show progress bars.
    """

    scene_with_mesh_of_all_cases: Scene
    fine_scene: Scene | None
    identify_table: Identify
    swept_loads: SweptLoads
    frequency_only_load_indices: list[int]
    folder: Path
    comm: MPI.Comm
    shows_progress: bool

    @property
    def mesh_file_axes(self) -> list[Axis]:
        """Return the axis over the files of ``[identify.meshes]``; empty without the table."""
        identify_table = self.identify_table
        return (
            [Axis(MESH_FILE_AXIS_KEY, identify_table.mesh_files)] if identify_table.meshes else []
        )

    def run_or_read_sweep(
        self, sweep_name: str, case_scene: Scene, unknown_axes: Sequence[Axis]
    ) -> SweepResult:
        """Run a scene's sweep over unknowns and loads, or read its file (collective).

        ``sweep_name`` begins the file name.

        Raises
        ------
        StoppedError
            Ctrl-C was pressed.
        """
        swept_axes = (*unknown_axes, self.swept_loads.frequency_or_rpm_axis)
        swept_scene = replace(case_scene, sweep=Sweep(over=swept_axes))
        file_name_digest = hashlib.sha256(
            f"{scene_text(swept_scene)}{self.frequency_only_load_indices or ''}".encode()
        ).hexdigest()[:8]
        with StopRequest() as stop_request:
            sweep_result = run_sweep(
                swept_scene,
                self.folder / f"{sweep_name}_{file_name_digest}.h5",
                self.comm,
                progress=self.shows_progress,
                verdicts=False,
                judged=False,
                natural=self.frequency_only_load_indices,
            )
        if stop_request.is_requested(self.comm):
            raise StoppedError(
                "identification was stopped; run the same command again to continue it"
            )
        return sweep_result

    def run_and_join_added_values(
        self, sweep_result: SweepResult, unknown_axes: Sequence[Axis], refined_axis: Axis
    ) -> SweepResult:
        """Solve added values of an unknown, and join them with solved cases (collective).

        Parameters
        ----------
        sweep_result : SweepResult
            Sweep with the values solved before.
        unknown_axes : sequence of Axis
            Unknowns with the values solved before.
        refined_axis : Axis
            Unknown with old and added values.

        Returns
        -------
        SweepResult
            Old and new cases in one sweep.
        """
        added_axes = [*self.mesh_file_axes, *unknown_axes]
        axis_index = [axis.key for axis in added_axes].index(refined_axis.key)
        axis_values_to_solve = tuple(
            axis_value
            for axis_value in refined_axis.values
            if axis_value not in added_axes[axis_index].values
        )
        added_axes[axis_index] = Axis(refined_axis.key, axis_values_to_solve)
        added_sweep = self.run_or_read_sweep(
            "forward", self.scene_with_mesh_of_all_cases, added_axes
        )
        return _join_sweeps(sweep_result, added_sweep, axis_index)

    def run_check_sweeps(
        self,
        sweep_name: str,
        scene_changes: dict[str, Any],
        unknown_axes: Sequence[Axis],
        all_cases_sweep: SweepResult,
    ) -> ForwardSweeps:
        """Solve a few cases on the finer mesh, and a few halfway between all cases (collective).

        Parameters
        ----------
        sweep_name : str
            Beginning of the file names.
        scene_changes : dict
            Changes by key that remove the crack; empty to keep the crack.
        unknown_axes : sequence of Axis
            Unknowns with all solved values.
        all_cases_sweep : SweepResult
            Sweep of all cases.

        Returns
        -------
        three SweepResult or None
            ``all_cases_sweep``; the sweep on the finer mesh, None without ``fine_scene``; the sweep
            halfway between all cases, None with mesh files.
        """
        identify_table, unknown_axis_keys = self.identify_table, [axis.key for axis in unknown_axes]
        n_number_unknowns = sum(
            not isinstance(axis.values[0], str) for axis in identify_table.unknown
        )
        n_kept_values = MIN_GRID_VALUES_PER_UNKNOWN - (n_number_unknowns > 2)
        finer_sweep = halfway_sweep = None
        if self.fine_scene is not None:
            finer_mesh_sweep_axes = [
                axis
                for axis in (*self.mesh_file_axes, *identify_table.unknown)
                if axis.key in unknown_axis_keys
            ]
            finer_sweep = self.run_or_read_sweep(
                f"{sweep_name}_finer",
                self.fine_scene.replace(scene_changes),
                _thin_axes(finer_mesh_sweep_axes, n_kept_values),
            )
        if not identify_table.meshes:
            halfway_axes = [
                Axis(axis.key, _list_halfway_values(axis) or axis.values) for axis in unknown_axes
            ]
            halfway_sweep = self.run_or_read_sweep(
                sweep_name,
                self.scene_with_mesh_of_all_cases.replace(scene_changes),
                _thin_axes(halfway_axes, n_kept_values),
            )
        return all_cases_sweep, finer_sweep, halfway_sweep


def _join_sweeps(
    first_sweep: SweepResult, second_sweep: SweepResult, axis_index: int
) -> SweepResult:
    """Join two sweeps with different values on one axis, in ascending order."""
    axis_values = [*first_sweep.axes[axis_index].values, *second_sweep.axes[axis_index].values]
    sorted_value_indices = np.argsort(axis_values)
    column_by_name = {
        column_name: np.concatenate([column, second_sweep[column_name]], axis=axis_index).take(
            sorted_value_indices, axis=axis_index
        )
        for column_name, column in first_sweep.columns.items()
    }
    joined_axes = list(first_sweep.axes)
    joined_axes[axis_index] = Axis(
        joined_axes[axis_index].key,
        tuple(axis_values[value_index] for value_index in sorted_value_indices),
    )
    return replace(
        first_sweep,
        scene=replace(first_sweep.scene, sweep=Sweep(over=tuple(joined_axes))),
        columns=column_by_name,
    )


def _count_allowed_cases(scene: Scene) -> int:
    """Return the maximum number of cases to solve when the grid becomes denser.

    The result is 8 (:attr:`Options.max_solved_to_requested_case_ratio`) times the number of cases
    that ``[identify.unknown]`` requests.
    """
    unknown_axes = scene.given("identify").unknown
    return IDENTIFICATION_VALUES.max_solved_to_requested_case_ratio * math.prod(
        len(unknown_axis.values) for unknown_axis in unknown_axes
    )


def _refine_axis_at_resonance_or_none(
    scene: Scene,
    models: Iterable[ForwardModel],
    load_frequencies: Sequence[float],
    unknown_axes: Sequence[Axis],
) -> Axis | None:
    """Refine the unknown along which the vibration changes most between solved cracks.

    Return the unknown with old and added values. Return None if no crack between solved cracks
    vibrates more than twice as much as every solved crack. Return None also if the motion is
    proportional to the load, or if the cases would be too many.

    Parameters
    ----------
    scene : Scene
        Scene with its table ``[identify]``.
    models : iterable of ForwardModel
        Models for all choices of text values.
    load_frequencies : sequence of float
        Load frequencies [Hz] to look at.
    unknown_axes : sequence of Axis
        Unknowns with their solved values.
    """
    models_loads_points = itertools.product(
        models, load_frequencies, scene.label_by_displacement_name or ("",)
    )
    ratios_models_loads_points = (
        []
        if has_load_independent_motion_shape(scene)
        else [
            (
                find_vibration_ratio_to_solved_cracks(*model_load_point_tuple)[0],
                *model_load_point_tuple,
            )
            for model_load_point_tuple in models_loads_points
        ]
    )
    if (
        not ratios_models_loads_points
        or max(
            ratio_model_load_point_tuple[0]
            for ratio_model_load_point_tuple in ratios_models_loads_points
        )
        <= IDENTIFICATION_VALUES.max_unsolved_to_solved_vibration
    ):
        return None
    vibration_ratio, model, load_frequency, point_name = max(
        ratios_models_loads_points,
        key=lambda ratio_model_load_point_tuple: ratio_model_load_point_tuple[0],
    )
    log_amplitudes = np.log(
        np.abs(model.coarse_mesh_cases.get_harmonic_amplitudes(point_name, load_frequency, 1))
    ).reshape(model.grid_of_solved_cases.shape)
    largest_log_amplitude_step_by_key = {
        key: np.fmax.reduce(np.abs(np.diff(log_amplitudes, axis=axis_index)), axis=None)
        for axis_index, key in enumerate(model.unknown_keys)
    }
    n_cases = math.prod(len(unknown_axis.values) for unknown_axis in unknown_axes)
    number_axes = [
        unknown_axis
        for unknown_axis in unknown_axes
        if unknown_axis.key in largest_log_amplitude_step_by_key and _is_divisible(unknown_axis)
    ]
    for unknown_axis in sorted(
        number_axes, key=lambda unknown_axis: -largest_log_amplitude_step_by_key[unknown_axis.key]
    ):
        n_solved_axis_values = len(unknown_axis.values)
        max_parts_per_interval = (
            _count_allowed_cases(scene) * n_solved_axis_values // n_cases - 1
        ) // (n_solved_axis_values - 1)
        n_parts_per_interval = min(
            math.ceil(vibration_ratio / IDENTIFICATION_VALUES.max_unsolved_to_solved_vibration),
            max_parts_per_interval,
        )
        if n_parts_per_interval > 1:
            value_coordinates = (
                np.arange((n_solved_axis_values - 1) * n_parts_per_interval + 1)
                / n_parts_per_interval
            )
            refined_axis_values = np.interp(
                value_coordinates, np.arange(n_solved_axis_values), unknown_axis.values
            ).tolist()
            return Axis(unknown_axis.key, tuple(refined_axis_values))
    return None


def refine_by_interpolation_share_or_none(
    forward_models: SolvedForwardModels,
    identification: Identification,
    shares_along_unknowns: np.ndarray,
    explaining_points: np.ndarray,
) -> Axis | None:
    """Refine the unknown along which interpolation adds most to a measurement's variance.

    Return the unknown with old values and added values halfway between. Values are added around the
    cracks that explain the measurements. Return None if the cases would be too many, or if no
    unknown has real numbers.

    Parameters
    ----------
    forward_models : SolvedForwardModels
        Models with the solved values of the unknowns.
    identification : Identification
        Result with these models.
    shares_along_unknowns : (d,)
        Fraction of the variance due to interpolation along each unknown.
    explaining_points : (m, d)
        Unknowns of m cracks that explain the measurements.
    """
    axis_by_key = {unknown_axis.key: unknown_axis for unknown_axis in forward_models.axes}
    for unknown_index in np.argsort(-shares_along_unknowns):
        unknown_axis = axis_by_key.get(identification.unknown[unknown_index])
        if unknown_axis is not None and _is_divisible(unknown_axis):
            halfway_values = _list_halfway_values(
                unknown_axis,
                explaining_points[:, unknown_index].min(),
                explaining_points[:, unknown_index].max(),
            )
            refined_axis = Axis(
                unknown_axis.key, tuple(sorted({*unknown_axis.values, *halfway_values}))
            )
            n_cases = math.prod(
                len(axis_after_refinement.values)
                for axis_after_refinement in (
                    axis_by_key | {unknown_axis.key: refined_axis}
                ).values()
            )
            return refined_axis if n_cases <= _count_allowed_cases(forward_models.scene) else None
    return None


def _list_coarse_and_fine_scenes(scene: Scene, mesh_ratio: float) -> tuple[Scene, Scene | None]:
    """Return the scene with the coarse mesh for all cases, then with the fine mesh for a few.

    ``mesh_ratio`` is ``identify.finer``. Above 1, the scene's own mesh is the coarse mesh. Below 1,
    the scene's own mesh is the fine mesh. The second scene is None if the ratio is 1, or if neither
    mesh nor number of harmonics can be changed.
    """
    more_harmonics_value_by_key: dict[str, Any] = {}
    if scene.harmonic_balance.tolerance is None and mesh_ratio > 1.0:
        n_harmonics = min(100, math.ceil(mesh_ratio * scene.harmonic_balance.harmonics))
        more_harmonics_value_by_key = {
            "harmonic_balance.harmonics": n_harmonics,
            "harmonic_balance.samples": None,
        }
    scene_with_other_mesh = None if mesh_ratio == 1.0 else refine_scene_or_none(scene, mesh_ratio)
    if scene_with_other_mesh is None and not more_harmonics_value_by_key:
        return scene, None
    return (
        (scene, (scene_with_other_mesh or scene).replace(more_harmonics_value_by_key))
        if mesh_ratio > 1.0
        else (scene_with_other_mesh or scene, scene)
    )


def _thin_axes(unknown_axes: Sequence[Axis], n_kept_values: int) -> tuple[Axis, ...]:
    """Keep ``n_kept_values`` values of each unknown, equally spread, with both ends.

    Used for sweeps of a few cases. All values of an unknown with text values are kept.
    """
    thinned_axes = []
    for unknown_axis in unknown_axes:
        value_indices = np.unique(
            np.linspace(0, len(unknown_axis.values) - 1, n_kept_values).round().astype(int)
        )
        kept_axis_values = tuple(unknown_axis.values[value_index] for value_index in value_indices)
        thinned_axes.append(
            unknown_axis
            if isinstance(unknown_axis.values[0], str)
            else Axis(unknown_axis.key, kept_axis_values)
        )
    return tuple(thinned_axes)


def _is_divisible(unknown_axis: Axis) -> bool:
    """Return True if an unknown has real numbers, not text or whole numbers."""
    return any(isinstance(axis_value, float) for axis_value in unknown_axis.values)


def _list_halfway_values(
    unknown_axis: Axis, lower_limit: float = -np.inf, upper_limit: float = np.inf
) -> tuple[float, ...]:
    """Return the values halfway between neighbouring values of an unknown.

    Only intervals between values that overlap the range from ``lower_limit`` to ``upper_limit``
    count. The tuple is empty for text and whole numbers.
    """
    value_pairs = itertools.pairwise(unknown_axis.values) if _is_divisible(unknown_axis) else ()
    return tuple(
        0.5 * (lower_axis_value + upper_axis_value)
        for lower_axis_value, upper_axis_value in value_pairs
        if lower_axis_value < upper_limit and upper_axis_value > lower_limit
    )


def _build_models(
    scene: Scene,
    uncracked_plate: UncrackedPlate,
    swept_loads: SweptLoads,
    cracked_sweeps: ForwardSweeps,
    uncracked_sweeps: ForwardSweeps | None = None,
) -> dict[str, ForwardModel]:
    """Build a forward model for each choice of text values, from its sweeps.

    An unknown with text values is, for example, crack.edge, with "left" or "right". Keys of the
    result are the chosen values joined with ", "; "" if all unknowns are numbers.

    Parameters
    ----------
    scene : Scene
        Scene with its table ``[identify]``.
    uncracked_plate : UncrackedPlate
        Plate without its crack.
    swept_loads : SweptLoads
        Loads of all sweeps.
    cracked_sweeps : three SweepResult or None
        Sweeps with the crack; or without the crack, to build models without it.
    uncracked_sweeps : three SweepResult or None, optional
        The same cases without the crack. None if the crack cannot be removed, or if
        ``cracked_sweeps`` have no crack.
    """
    mesh_file_parameter_axes = scene.given("identify").mesh_parameter_axes
    axes = [
        axis
        for axis in cracked_sweeps[0].axes[:-1]
        if not (mesh_file_parameter_axes and axis.key == MESH_FILE_AXIS_KEY)
    ]
    words_by_key = {axis.key: axis.values for axis in axes if isinstance(axis.values[0], str)}
    model_by_words = {}
    for chosen_words in itertools.product(*words_by_key.values()):
        text_value_by_unknown_key = dict(zip(words_by_key, chosen_words, strict=True))
        coarse_finer_halfway_cases: list[SolvedCases | None] = []
        for sweep_result, uncracked_sweep in zip(
            cracked_sweeps, uncracked_sweeps or (None,) * 3, strict=True
        ):
            uncracked_cases = (
                None
                if uncracked_sweep is None
                else SolvedCases(uncracked_sweep, swept_loads, (), text_value_by_unknown_key)
            )
            coarse_finer_halfway_cases.append(
                None
                if sweep_result is None
                else SolvedCases(
                    sweep_result,
                    swept_loads,
                    mesh_file_parameter_axes,
                    text_value_by_unknown_key,
                    uncracked_cases,
                )
            )
        model_by_words[", ".join(chosen_words)] = ForwardModel(
            scene,
            uncracked_plate,
            coarse_finer_halfway_cases,
            text_value_by_unknown_key=text_value_by_unknown_key,
        )
    return model_by_words
