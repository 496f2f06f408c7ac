"""From measurements to the crack: one call.

The forward model is solved by sweeps over the unknowns
(:mod:`fenics_crack.monitoring.identification.sweeps`). A :class:`ForwardModel` interpolates between
their cases. Nuisance parameters have priors, and change the predictions to first order
(:mod:`fenics_crack.monitoring.identification.nuisance`).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.basics.errors import ConvergenceError, InputError
from fenics_crack.basics.progress import begin_stage
from fenics_crack.basics.ranks import MPI, on_root
from fenics_crack.basics.tables import RAD_PER_TURN
from fenics_crack.monitoring.identification.measurements import Measurements
from fenics_crack.monitoring.identification.model import has_load_independent_motion_shape
from fenics_crack.monitoring.identification.options import IDENTIFICATION_VALUES
from fenics_crack.monitoring.identification.posterior import (
    Likelihood,
    Posterior,
    PosteriorForTextValues,
)
from fenics_crack.monitoring.identification.predictor import MeasurementPredictor
from fenics_crack.monitoring.identification.result import Identification
from fenics_crack.monitoring.identification.sweeps import (
    SolvedForwardModels,
    find_vibration_ratio_to_solved_cracks,
    refine_by_interpolation_share_or_none,
    solve_forward,
    solve_uncracked_plate,
)
from fenics_crack.scene.fields import Axis
from fenics_crack.scene.result_tables import Identify
from fenics_crack.scene.scene import Scene
from fenics_crack.sweep.result import iterate_texts_by_reason


def identify(
    scene: Scene,
    measurements: Measurements | str | Path,
    unknown: Mapping[str, Any] | None = None,
    *,
    folder: str | Path = "output/identify",
    comm: MPI.Comm = MPI.COMM_WORLD,
    progress: bool = False,
) -> Identification:
    """Find a crack, or other keys of a scene, from measurements (collective).

    The scene is solved at all points of a grid of the unknowns, and with a finer mesh at a few
    points. The results are kept in files in ``folder``, from which a killed run continues. A
    rotor's natural frequencies may be measured at several speeds; all speeds are solved. Under a
    steady load or a clearance, the grid becomes denser around cracks that meet a resonance between
    grid points. The grid also becomes denser if interpolation causes more than a fifth of a
    measurement's variance. Points are then added around cracks that explain the measurements.

    Cross-validation, and a few cases halfway between the grid points, estimate the interpolation
    error. This error and the remaining mesh error are added to the measurement error. Suppose that
    elements smaller by a factor f change a quantity by d. A mesh error of first order is then still
    d / (f - 1) on the finer mesh; an error of high order is 0. The predictions are corrected by the
    mean, d + d / (2 f - 2), with the standard deviation d / (2 f - 2). Least squares from several
    starts find the estimate, and a posterior on a grid gives the credible regions. The evidence is
    the integral of the likelihood over the prior. It decides between crack and no crack.

    Parameters
    ----------
    scene : Scene
        Structure and load; the scene's own values of the unknowns do not matter.
    measurements : Measurements or path
        Measurements, or their file (:meth:`Measurements.read`).
    unknown : mapping, optional
        Keys of the scene with the values to solve, instead of the table ``[identify.unknown]``. The
        prior is uniform between the first and last value.
    folder : path
        Folder of the sweeps' files.
    comm : MPI.Comm
        Ranks that share the cases.
    progress : bool
        Show progress bars.

    Returns
    -------
    Identification
        Estimates, intervals and verdict, on every rank.

    Raises
    ------
    InputError
        There are no unknowns, a measurement does not fit the scene, or the cases cannot be solved
        (:func:`run_sweep`).
    ConvergenceError
        Too few cases were solved to predict any measurement made after the crack began.
    StoppedError
        Ctrl-C was pressed.

    Examples
    --------
    >>> found = fc.identify(scene, "measured.csv", {"crack.length": [0.02, 0.04]})  # doctest: +SKIP
    """
    scene = _scene_with_unknowns(scene, unknown)
    if not isinstance(measurements, Measurements):
        measurement_path = measurements
        measurements = on_root(comm, lambda: Measurements.read(measurement_path))
    measurements.check(scene)
    single_measurements = measurements.rows
    load_frequencies = [
        measurement.frequency
        for measurement in single_measurements
        if not measurement.is_natural_frequency
    ]
    frequency_only_loads = [
        load_frequency
        for measurement in single_measurements
        if measurement.is_natural_frequency
        and (load_frequency := measurement.get_load_frequency(scene))
    ]
    identify_table = scene.given("identify")
    uncracked_plate = solve_uncracked_plate(scene, comm)
    has_other_unknowns = any(
        not axis.key.startswith(("crack.", "contact.")) for axis in identify_table.unknown
    )
    scene_load_frequencies = (scene.excitation.omega / RAD_PER_TURN, *identify_table.frequencies)
    uncracked_plate.check_units_and_modes(
        measurements,
        [load_frequency for load_frequency in scene_load_frequencies if load_frequency > 0.0],
        may_be_other_plate=has_other_unknowns,
    )
    refined_axes: list[Axis] = []
    while True:
        forward_models = solve_forward(
            scene,
            load_frequencies,
            Path(folder),
            comm,
            frequency_only_loads=frequency_only_loads,
            uncracked_plate=uncracked_plate,
            refined_axes=refined_axes,
            progress=progress,
        )
        begin_stage("inference of the unknowns")
        identification = infer_unknowns(forward_models, measurements)
        if (
            name_shares_and_points := _find_most_interpolated_measurement_or_none(identification)
        ) is None:
            return identification
        measurement_name, shares_along_unknowns, explaining_points = name_shares_and_points
        if (
            refined_axis := refine_by_interpolation_share_or_none(
                forward_models, identification, shares_along_unknowns, explaining_points
            )
        ) is None:
            break
        refined_axes.append(refined_axis)
    remark_text = (
        f"interpolation between the solved cases causes {shares_along_unknowns.sum():.0%} of the "
        f"variance of {measurement_name}: more values in identify.unknown make intervals narrower"
    )
    return replace(identification, remarks=(*identification.remarks, remark_text))


def _scene_with_unknowns(scene: Scene, unknown: Mapping[str, Any] | None) -> Scene:
    """Return a scene with the given unknowns in its table ``[identify]``.

    ``unknown`` has the values to solve, by key of the scene. If it is None, the unknowns in the
    scene's own table stay.

    Raises
    ------
    InputError
        There are no unknowns, or all have text values.
    """
    if unknown is not None:
        identify_table = scene.identify or Identify.from_mapping({"unknown": unknown})
        changed_table = replace(identify_table, unknown=Identify.convert_value("unknown", unknown))
        scene = replace(scene, identify=changed_table)
    if scene.identify is None:
        raise InputError("identify", None, "given: a table [identify] with keys and values")
    word_keys = [axis.key for axis in scene.identify.unknown if isinstance(axis.values[0], str)]
    if len(word_keys) == len(scene.identify.unknown) and not scene.identify.meshes:
        raise InputError("identify.unknown", word_keys, "keys of which at least one has numbers")
    return scene


def infer_unknowns(
    forward_models: SolvedForwardModels, measurements: Measurements
) -> Identification:
    """Infer the unknowns from measurements, with solved forward models.

    Measurements that the models cannot predict are left out. ``doubts`` of the result name these
    measurements.

    Raises
    ------
    InputError
        A measurement does not fit the scene or the solved loads.
    ConvergenceError
        Too few cases were solved to predict any measurement made after the crack began.
    """
    measurements.check(forward_models.scene)
    measurements, doubt_texts = _select_predictable_measurements(forward_models, measurements)
    single_measurements = measurements.rows
    measurement_values, measured_standard_deviations = np.array(
        [(measurement.value, measurement.deviation) for measurement in single_measurements]
    ).T
    posterior_by_text_values, uncracked_branch_by_words = (
        {
            words_text: PosteriorForTextValues(
                Likelihood(
                    measurement_values,
                    measured_standard_deviations,
                    MeasurementPredictor(model, single_measurements),
                )
            )
            for words_text, model in forward_model_by_words.items()
        }
        for forward_model_by_words in (
            forward_models.cracked_model_by_text_values,
            forward_models.uncracked_model_by_text_values,
        )
    )
    remark_texts = (
        *list_measurement_shortcoming_remarks(forward_models.scene, measurements),
        *_yield_excessive_vibration_remarks(forward_models, measurements),
    )
    cracked_and_uncracked_posteriors = (
        Posterior(posterior_by_text_values),
        Posterior(uncracked_branch_by_words) if uncracked_branch_by_words else None,
    )
    return Identification(
        forward_models.scene,
        measurements,
        *cracked_and_uncracked_posteriors,
        remark_texts,
        doubt_texts,
    )


def _select_predictable_measurements(
    forward_models: SolvedForwardModels, measurements: Measurements
) -> tuple[Measurements, tuple[str, ...]]:
    """Select the measurements that all forward models can predict.

    The models with and without the crack are compared by the same measurements.

    Returns
    -------
    Measurements
        Predictable measurements.
    tuple of str
        Doubts: failed cases at the measured loads, and measurements that are left out.

    Raises
    ------
    ConvergenceError
        No measurement made after the crack began can be predicted.
    """
    cracked_and_uncracked_models = [
        *forward_models.cracked_model_by_text_values.values(),
        *forward_models.uncracked_model_by_text_values.values(),
    ]
    single_measurements = measurements.rows
    is_predictable = np.all(
        [
            MeasurementPredictor(model, single_measurements).is_predictable
            for model in cracked_and_uncracked_models
        ],
        axis=0,
    )
    solved_cases_by_path = {
        solved_cases.sweep_result.path: solved_cases
        for model in cracked_and_uncracked_models
        for solved_cases in (model.coarse_mesh_cases, model.finer_mesh_cases)
        if solved_cases
    }
    load_frequencies = {measurement.frequency for measurement in single_measurements}
    doubt_texts = []
    for sweep_path, solved_cases in solved_cases_by_path.items():
        sweep_result = solved_cases.sweep_result
        swept_frequencies = solved_cases.swept_loads.frequencies
        failed_cases_and_reasons = [
            (failed_case_index, reason_text)
            for failed_case_index, reason_text in sweep_result.failed_indices_and_reasons
            if swept_frequencies[failed_case_index[-1]] in load_frequencies
            or np.isnan(sweep_result["omega_open_1"][failed_case_index])
        ]
        doubt_texts += [
            f"{sweep_path.name}: {failed_cases_text}"
            for failed_cases_text in iterate_texts_by_reason(
                sweep_result, failed_cases_and_reasons, "failed"
            )
        ]
    predictable_rows = list(itertools.compress(single_measurements, is_predictable))
    if all(measurement.quantity == "frequency_uncracked" for measurement in predictable_rows):
        reason_text = "; ".join(doubt_texts) or (
            "no solved case has the measured quantities; give other values in identify.unknown"
        )
        raise ConvergenceError(f"no measurement can be predicted: {reason_text}")
    reason_text = (
        "too few cases with this quantity were solved, or only on one side of failed cases; "
        "give more values in identify.unknown"
    )
    doubt_texts += [
        f"{measurement.name} is not used: {reason_text}"
        for measurement in itertools.compress(single_measurements, ~is_predictable)
    ]
    return Measurements(tuple(predictable_rows)), tuple(doubt_texts)


def list_measurement_shortcoming_remarks(
    scene: Scene, measurements: Measurements
) -> tuple[str, ...]:
    """List remarks on what these measurements cannot determine, as sentences.

    Only the kinds of measurements matter, not the measured values. There are three possible
    remarks:

    - The edge with the crack cannot be found. This remark follows if all measurements are natural
      frequencies, and ``crack.edge`` is "left" or "right" and no unknown. Cracks from both edges
      have the same natural frequencies.
    - The intervals do not include the mesh error. This remark follows for mesh files.
    - The scene must have the real load. This remark follows for ratios and displacements, if the
      shape of the motion depends on the size of the load.
    """
    identify_table = scene.given("identify")
    crack, single_measurements = scene.crack, measurements.rows
    opposite_plate_edge = ""
    if crack is not None and not any(axis.key == "crack.edge" for axis in identify_table.unknown):
        opposite_plate_edge = {"left": "right", "right": "left"}.get(crack.edge or "", "")
    conditions_and_remarks = (
        (
            opposite_plate_edge
            and all(measurement.is_natural_frequency for measurement in single_measurements),
            f"a crack from the {opposite_plate_edge} edge has the same natural frequencies, "
            "which cannot "
            "distinguish the edges",
        ),
        (
            identify_table.meshes,
            "the intervals do not include the error of the mesh files: compare with the result of "
            "meshes twice as fine",
        ),
        (
            any(measurement.is_independent_of_load_size for measurement in single_measurements)
            and not has_load_independent_motion_shape(scene),
            "with a clearance or a steady load, the shape of the motion depends on the size of the "
            "load: check that the scene has the real load",
        ),
    )
    return tuple(
        remark_text for is_remark_needed, remark_text in conditions_and_remarks if is_remark_needed
    )


def _yield_excessive_vibration_remarks(
    forward_models: SolvedForwardModels, measurements: Measurements
) -> Iterator[str]:
    """Yield remarks on cracks that vibrate much more than all solved cracks.

    Such a crack lies between solved cracks, near a resonance. It may open and close in another way
    than all solved cracks, so that interpolation is wrong. A remark is a sentence with the load and
    the vibration. It follows if the vibration exceeds twice the largest of all solved cracks
    (:attr:`Options.max_unsolved_to_solved_vibration`). If the motion is proportional to the
    load, there is no remark.
    """
    if has_load_independent_motion_shape(forward_models.scene):
        return
    measured_loads_and_points = dict.fromkeys(
        (measurement.frequency, measurement.point)
        for measurement in measurements.rows
        if measurement.is_independent_of_load_size
    )
    for model, (load_frequency, point_name) in itertools.product(
        forward_models.cracked_model_by_text_values.values(), measured_loads_and_points
    ):
        ratio_to_largest_solved_vibration, unknown_values = find_vibration_ratio_to_solved_cracks(
            model, load_frequency, point_name
        )
        if (
            ratio_to_largest_solved_vibration
            > IDENTIFICATION_VALUES.max_unsolved_to_solved_vibration
        ):
            unknown_values_text = ", ".join(
                f"{key} = {unknown_value:.4g}"
                for key, unknown_value in zip(model.unknown_keys, unknown_values, strict=True)
            )
            yield (
                f"near {unknown_values_text}, the vibration at {load_frequency:.6g} Hz is up to "
                f"{ratio_to_largest_solved_vibration:.2g} times that of any solved case, and "
                "predictions are "
                "doubtful: add values there in identify.unknown, or measure at other frequencies"
            )


def _find_most_interpolated_measurement_or_none(
    identification: Identification,
) -> tuple[str, np.ndarray, np.ndarray] | None:
    """Find the measurement with the largest fraction of variance due to interpolation.

    Used to decide along which unknown the grid becomes denser. The fraction is the variance by
    interpolation over the variance of measurement plus prediction. It is averaged over the cracks
    that explain the measurements. All these cracks have equal weights: posterior weights would be
    too small at cracks with a large interpolation error.

    Returns
    -------
    measurement_name : str
        Name of the measurement.
    interpolation_shares : (d,)
        Fraction of its variance due to interpolation along each of d unknowns.
    explaining_points : (m, d)
        Unknowns of the m cracks that explain the measurements.

    None is returned instead if no crack explains the measurements. It is also returned if the d
    fractions sum to at most 0.2 (:attr:`Options.allowed_interpolation_share`).
    """
    points_and_interpolation_shares = [
        branch.find_explanations_and_interpolation_shares()
        for branch in identification.posterior.posterior_by_text_values.values()
    ]
    explaining_points, interpolation_shares = (
        np.vstack(points_or_shares_of_branches)
        for points_or_shares_of_branches in zip(*points_and_interpolation_shares, strict=True)
    )
    if not interpolation_shares.size:
        return None
    mean_shares = interpolation_shares.mean(axis=0)
    worst_row_index = int(mean_shares.sum(axis=0).argmax())
    shares_along_unknowns = mean_shares[:, worst_row_index]
    is_share_small = (
        shares_along_unknowns.sum() <= IDENTIFICATION_VALUES.allowed_interpolation_share
    )
    return (
        None
        if is_share_small
        else (
            identification.measurements.rows[worst_row_index].name,
            shares_along_unknowns,
            explaining_points,
        )
    )
