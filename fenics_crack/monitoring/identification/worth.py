"""Worth of one more measurement: its information about the unknowns.

With predictions s and the covariance V of measurements and predictions, the Fisher information of
the unknowns x is

    F = (ds / dx)^T V^-1 (ds / dx) + P,

with the prior's information P. One more measurement changes F to F', and adds in nats

    log(det F' / det F) / 2

(A. C. Atkinson, A. N. Donev and R. D. Tobias, Optimum Experimental Designs, 2007, chapter 11:
D-optimality).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fenics_crack.basics.errors import check_number
from fenics_crack.basics.suggestions import keep_old_attribute_names
from fenics_crack.basics.tables import Tabular
from fenics_crack.monitoring.identification.measurements import Measurement
from fenics_crack.monitoring.identification.model import ForwardModel
from fenics_crack.monitoring.identification.options import IDENTIFICATION_VALUES
from fenics_crack.monitoring.identification.posterior import (
    Likelihood,
    add_uniform_prior_information,
    compute_scaled_covariance,
)
from fenics_crack.monitoring.identification.predictor import (
    MeasurementPredictor,
    ProbeDisplacements,
)
from fenics_crack.scene.keys import unit_of_key
from fenics_crack.scene.words import key_in_words, value_in_words
from fenics_crack.sweep.file import STORED_MODE_NUMBER_RANGE


@keep_old_attribute_names(
    information="information_gains", deviations="improved_deviations_by_key",
    now="current_deviation_by_key",
)  # fmt: skip
@dataclass(frozen=True, repr=False)
class Worth(Tabular):
    """Result of :meth:`Identification.where_to_measure`: candidates, most informative first.

    Attributes
    ----------
    measurements : tuple of Measurement
        n candidates for one more measurement, with predicted values and assumed standard
        deviations.
    information_gains : (n,) [nats]
        Information that each candidate adds.
    improved_deviations_by_key : dict of str to (n,)
        Standard deviation of each unknown by key, with each candidate measured.
    current_deviation_by_key : dict of str to float
        Standard deviation of each unknown by key, without a further measurement.
    """

    measurements: tuple[Measurement, ...]
    information_gains: np.ndarray
    improved_deviations_by_key: dict[str, np.ndarray]
    current_deviation_by_key: dict[str, float]

    def to_dict(self) -> dict[str, Any]:
        """Return columns by name, with a row for every candidate."""
        return {
            "measurement": [measurement.name for measurement in self.measurements],
            "value": [measurement.value for measurement in self.measurements],
            "deviation": [measurement.deviation for measurement in self.measurements],
            "information": self.information_gains.tolist(),
            **{
                f"left_of_{key}": deviation_array.tolist()
                for key, deviation_array in self.improved_deviations_by_key.items()
            },
        }

    def _unit_by_name(self) -> Mapping[str, str]:
        return {
            "information": "nats",
            **{f"left_of_{key}": unit_of_key(key) for key in self.current_deviation_by_key},
        }

    def _repr_text(self) -> str:
        if not self.measurements:
            return "nothing to measure"
        return f"{self.measurements[0].name} adds {self.information_gains[0]:.3g} nats"


def rank_measurements_by_information(
    likelihood: Likelihood,
    x: np.ndarray,
    measurements: Sequence[Measurement] | None,
    default_relative_deviations: tuple[float, float],
) -> Worth:
    """Rank candidates for one more measurement by the information that each adds.

    Parameters
    ----------
    likelihood : Likelihood
        Likelihood of the measurements made, with their predictor.
    x : (d,)
        Estimate of the unknowns.
    measurements : sequence of Measurement, optional
        Candidates. Default: natural frequencies, ratios of harmonics, and displacements at further
        phases (:func:`_list_default_candidates`).
    default_relative_deviations : (float, float)
        Relative standard deviations of the default candidates: first of natural frequencies, then
        of ratios of harmonics.

    Raises
    ------
    InputError
        A standard deviation is not > 0, or a measurement does not fit the forward model.
    """
    deviation_argument_names = ("frequency_deviation", "harmonic_deviation")
    for argument_name, relative_deviation in zip(
        deviation_argument_names, default_relative_deviations, strict=True
    ):
        check_number(argument_name, relative_deviation, 0.0, excludes_bound=True)
    model, measurements_made = likelihood.predictor.model, likelihood.predictor.rows
    candidate_measurements = tuple(measurements or ())
    for measurement in candidate_measurements:
        measurement.check(model.scene)
    if measurements is None:
        candidate_measurements = tuple(_list_default_candidates(model, measurements_made))
    n_measured_rows = len(measurements_made)
    predictor = likelihood.predictor.make_predictor(measurements_made, candidate_measurements)
    predictions = predictor(x[None]).values[0]
    candidate_measurement_deviations = np.array(
        [measurement.deviation for measurement in candidate_measurements]
    )
    if measurements is None:
        candidate_measurement_deviations = _assume_candidate_deviations(
            candidate_measurements, predictions[n_measured_rows:], default_relative_deviations
        )
    is_usable = np.isfinite(predictions[n_measured_rows:]) & (
        candidate_measurement_deviations > 0.0
    )
    all_measurement_deviations = np.concatenate(
        [
            likelihood.measurement_deviations,
            np.where(is_usable, candidate_measurement_deviations, 1.0),
        ]
    )
    covariance_and_slopes = _compute_scaled_covariance_and_slopes(
        predictor, x, all_measurement_deviations
    )
    measured_row_indices = np.arange(n_measured_rows)
    measured_log_information, current_unknown_deviation_by_key = (
        _compute_information_and_deviations(model, x, covariance_and_slopes, measured_row_indices)
    )
    candidate_results = [
        _compute_information_and_deviations(
            model,
            x,
            covariance_and_slopes,
            np.append(measured_row_indices, n_measured_rows + candidate_index),
        )
        for candidate_index in range(len(candidate_measurements))
    ]
    log_information_with_each_candidate = np.array(
        [log_information_with_candidate for log_information_with_candidate, _ in candidate_results]
    )
    # Below 0 by rounding.
    information_gains = 0.5 * np.maximum(
        log_information_with_each_candidate - measured_log_information, 0.0
    )
    ranked_indices = [
        int(candidate_index)
        for candidate_index in np.argsort(-information_gains, kind="stable")
        if is_usable[candidate_index]
    ]
    return Worth(
        tuple(
            replace(
                candidate_measurements[candidate_index],
                value=float(predictions[n_measured_rows + candidate_index]),
                deviation=float(candidate_measurement_deviations[candidate_index]),
            )
            for candidate_index in ranked_indices
        ),
        information_gains[ranked_indices],
        {
            key: np.array(
                [candidate_results[candidate_index][1][key] for candidate_index in ranked_indices]
            )
            for key in model.unknown_keys
        },
        current_unknown_deviation_by_key,
    )


def _assume_candidate_deviations(
    candidate_rows: Sequence[Measurement],
    predictions: np.ndarray,
    relative_deviations: tuple[float, float],
) -> np.ndarray:
    """Return the standard deviations of default candidates: (n,).

    A displacement keeps the standard deviation in ``candidate_rows``. Frequencies and ratios have a
    standard deviation relative to ``predictions`` (n,). ``relative_deviations`` has the factor for
    frequencies, then the factor for ratios of harmonics.
    """
    frequency_deviation, ratio_deviation = relative_deviations
    return np.array(
        [
            measurement.deviation
            if measurement.quantity == "displacement"
            else (frequency_deviation if measurement.is_natural_frequency else ratio_deviation)
            * prediction
            for measurement, prediction in zip(candidate_rows, predictions, strict=True)
        ]
    )


def list_advice_texts(likelihood: Likelihood, x: np.ndarray, worth: Worth) -> list[str]:
    """List advice on the next measurements, as sentences.

    The advice names missing frequencies of the uncracked plate, and the most informative candidate
    in ``worth``. An advice is left out if the printed standard deviations of all unknowns stay the
    same. ``x`` (d,) is the estimate of the unknowns.
    """
    model, measured_rows = likelihood.predictor.model, likelihood.predictor.rows
    measured_modes = {
        measurement.mode for measurement in measured_rows if measurement.is_natural_frequency
    } or {1, 2}
    calibrated_modes = {
        measurement.mode
        for measurement in measured_rows
        if measurement.quantity == "frequency_uncracked"
    }
    advice_texts, relative_deviation = (
        [],
        IDENTIFICATION_VALUES.relative_frequency_deviation_in_advice,
    )
    if model.coarse_mesh_cases.uncracked_cases is not None and (
        modes_without_uncracked_frequency := sorted(measured_modes - calibrated_modes)
    ):
        missing_measurements = [
            Measurement(
                "frequency_uncracked",
                natural_frequency,
                relative_deviation * natural_frequency,
                mode=mode,
            )
            for mode, natural_frequency in enumerate(
                model.uncracked_plate.natural_frequencies_hz.tolist(), 1
            )
            if mode in modes_without_uncracked_frequency
        ]
        modes_text = (
            f"{'ies' if len(modes_without_uncracked_frequency) > 1 else 'y'} "
            f"{', '.join(map(str, modes_without_uncracked_frequency))}"
        )
        missing_frequencies_text = (
            f"natural frequenc{modes_text} without the crack (frequency_uncracked)"
        )
        if deviation_reduction_text := _describe_gain_or_empty(
            worth.current_deviation_by_key,
            _compute_deviation_by_key_with(likelihood, x, missing_measurements),
        ):
            advice_texts.append(
                f"{missing_frequencies_text}, with a standard deviation of "
                f"{relative_deviation:.1%}: {deviation_reduction_text}"
            )
    if worth.measurements:
        deviation_by_key = {
            key: float(deviations[0])
            for key, deviations in worth.improved_deviations_by_key.items()
        }
        if deviation_reduction_text := _describe_gain_or_empty(
            worth.current_deviation_by_key, deviation_by_key
        ):
            advice_texts.append(f"{worth.measurements[0].name}: {deviation_reduction_text}")
    return advice_texts


def _describe_gain_or_empty(
    current_deviation_by_key: Mapping[str, float], improved_deviation_by_key: Mapping[str, float]
) -> str:
    """Describe how a measurement reduces the standard deviations of the unknowns.

    An example is "crack length then ± 0.2 mm instead of ± 1 mm". An unknown is left out if both
    rounded numbers are the same. If all unknowns are left out, return "".

    Parameters
    ----------
    current_deviation_by_key : mapping of str to float
        Standard deviation of each unknown, by key, without the measurement.
    improved_deviation_by_key : mapping of str to float
        Standard deviation of each unknown, by key, with the measurement.
    """
    keys_and_deviation_texts = (
        (
            key,
            value_in_words(key, improved_deviation_by_key[key]),
            value_in_words(key, current_deviation_by_key[key]),
        )
        for key in current_deviation_by_key
    )
    return ", ".join(
        f"{key_in_words(key)} then ± {improved_deviation_text} instead of ± "
        f"{current_deviation_text}"
        for key, improved_deviation_text, current_deviation_text in keys_and_deviation_texts
        if improved_deviation_text != current_deviation_text
    )


def _compute_deviation_by_key_with(
    likelihood: Likelihood, x: np.ndarray, further_measurements: Sequence[Measurement]
) -> dict[str, float]:
    """Return the standard deviation of each unknown by key, with all further measurements.

    ``x`` (d,) is the estimate.
    """
    model = likelihood.predictor.model
    predictor = likelihood.predictor.make_predictor(likelihood.predictor.rows, further_measurements)
    all_measurement_deviations = np.concatenate(
        [
            likelihood.measurement_deviations,
            [measurement.deviation for measurement in further_measurements],
        ]
    )
    return _compute_information_and_deviations(
        model,
        x,
        _compute_scaled_covariance_and_slopes(predictor, x, all_measurement_deviations),
        np.arange(len(all_measurement_deviations)),
    )[1]


def _compute_information_and_deviations(
    model: ForwardModel,
    x: np.ndarray,
    covariance_and_slopes: tuple[np.ndarray, np.ndarray],
    row_indices: np.ndarray,
) -> tuple[float, dict[str, float]]:
    """Return the logarithm of the information, and standard deviations of the unknowns.

    Parameters
    ----------
    model : ForwardModel
        Model with the unknowns.
    x : (d,)
        Estimate of the unknowns.
    covariance_and_slopes : (q, q), (q, d)
        Scaled covariance of q measurements, and scaled slopes of their predictions
        (:func:`_compute_scaled_covariance_and_slopes`).
    row_indices : (n,)
        Indices of the measurements to take into account.

    Returns
    -------
    float
        log(det F) of the Fisher information F, with the prior.
    dict of str to float
        Standard deviation of each unknown by key, for the real crack. It includes the deviation
        from the equivalent straight, sharp crack.
    """
    selected_measurement_covariance = covariance_and_slopes[0][np.ix_(row_indices, row_indices)]
    selected_slopes = covariance_and_slopes[1][row_indices]
    fisher_information = add_uniform_prior_information(
        selected_slopes.T @ np.linalg.solve(selected_measurement_covariance, selected_slopes)
    )
    deviations_of_equivalent_crack = np.sqrt(np.diag(np.linalg.inv(fisher_information))) * (
        model.grid_of_solved_cases.upper_bounds - model.grid_of_solved_cases.lower_bounds
    )
    deviations_of_real_crack = np.hypot(
        deviations_of_equivalent_crack, model.compute_crack_geometry_deviations(x[None])[0]
    )
    log_information = float(np.linalg.slogdet(fisher_information)[1])
    return log_information, dict(
        zip(model.unknown_keys, deviations_of_real_crack.tolist(), strict=True)
    )


def _list_default_candidates(
    model: ForwardModel, measured_rows: Sequence[Measurement]
) -> list[Measurement]:
    """List default candidates for further measurements.

    Candidates are natural frequencies of all modes, and the ratios of harmonics "ratio_2_1" and
    "ratio_3_1" at all points and solved load frequencies. If a point's displacements were measured
    at a load frequency, more of them are added, at 24 phases of the load's period. Their standard
    deviation is the median of the measured ones.
    """
    coarse_mesh_cases = model.coarse_mesh_cases
    quantity_names = ["frequency_open", "frequency_tied", "frequency_resonance"]
    if coarse_mesh_cases.uncracked_cases is not None:
        quantity_names.append("frequency_uncracked")
    candidates = [
        Measurement(quantity_name, 1.0, 1.0, mode)
        for quantity_name in quantity_names
        for mode in STORED_MODE_NUMBER_RANGE
    ]
    point_names = ["", *coarse_mesh_cases.sweep_result.scene.label_by_displacement_name]
    candidates += [
        Measurement(ratio_name, 1.0, 1.0, frequency=load_frequency, point=point_name)
        for load_frequency in coarse_mesh_cases.swept_loads.frequencies
        for point_name in point_names
        for ratio_name in ("ratio_2_1", "ratio_3_1")
    ]
    phases = 2.0 * np.pi * np.arange(24) / 24
    for displacement_group in ProbeDisplacements.group_displacements_by_load_and_point(
        measured_rows, ()
    ):
        group_rows = [measured_rows[row_index] for row_index in displacement_group.row_indices]
        median_deviation = float(np.median([measurement.deviation for measurement in group_rows]))
        displacement_candidate_template = replace(
            group_rows[0], value=0.0, deviation=median_deviation
        )
        candidates += [
            replace(displacement_candidate_template, phase=phase) for phase in phases.tolist()
        ]
    return candidates


def _compute_scaled_covariance_and_slopes(
    predictor: MeasurementPredictor, x: np.ndarray, deviations: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the scaled covariance of q measurements, and scaled slopes of predictions.

    ``x`` (d,) are values of the unknowns. ``deviations`` (q,) are the standard deviations e of the
    measurements.

    Returns
    -------
    covariance : (q, q)
        V_ij / (e_i e_j), with the covariance V of measurements and predictions.
    slopes : (q, d)
        Change of each prediction over e_i, per change of an unknown over its range; 0 without a
        prediction.
    """
    prediction, grid_of_solved_cases = predictor(x[None]), predictor.model.grid_of_solved_cases
    scaled_measurement_covariance = compute_scaled_covariance(
        prediction, np.nan_to_num(prediction.values[0]), deviations
    )[0]
    difference_step_matrix = np.diag(
        1e-3 * (grid_of_solved_cases.upper_bounds - grid_of_solved_cases.lower_bounds)
    )
    upper_points = np.minimum(x + difference_step_matrix, grid_of_solved_cases.upper_bounds)
    lower_points = np.maximum(x - difference_step_matrix, grid_of_solved_cases.lower_bounds)
    difference_steps_over_ranges = np.diag(upper_points - lower_points) / (
        grid_of_solved_cases.upper_bounds - grid_of_solved_cases.lower_bounds
    )
    value_differences = predictor(upper_points).values - predictor(lower_points).values
    scaled_slopes = (value_differences / difference_steps_over_ranges[:, None]).T / deviations[
        :, None
    ]
    scaled_slopes[~np.isfinite(scaled_slopes).all(axis=1)] = 0.0
    return scaled_measurement_covariance, scaled_slopes
