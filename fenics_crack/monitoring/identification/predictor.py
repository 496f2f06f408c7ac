"""Predictions of measurements at values of the unknowns, and their correlated errors.

A measurement is a natural frequency, a harmonic, a ratio of harmonics, or a displacement at a
probe. All are predicted from interpolated features
(:mod:`fenics_crack.monitoring.identification.model`), with the motion of the crack faces at
resonances, and the load that fits measured displacements.

Shapes: m points x of d unknowns, q measurements, f features.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from fenics_crack.basics.errors import MAX_HARMONIC_ORDER, N_NATURAL_MODES_PER_CRACK_STATE
from fenics_crack.monitoring.identification.interpolation import (
    CRACK_STATES_AT_RESONANCE,
    Feature,
    SolvedCases,
    find_frequency_ratios_and_pole_factors,
)
from fenics_crack.monitoring.identification.measurements import Measurement
from fenics_crack.monitoring.identification.model import (
    FeaturePrediction,
    FeaturePredictor,
    ForwardModel,
    has_load_independent_motion_shape,
    split_complex_columns,
)
from fenics_crack.monitoring.identification.nuisance import BaselineChanges
from fenics_crack.study.key_figures import is_response_proportional_to_load
from fenics_crack.sweep.file import STORED_MODE_NUMBER_RANGE

# --- displacements at probes ----------------------------------------------------------------------


class ProbeDisplacements:
    """Displacements of a point at phases of the load's period, as probes measure.

    Under a steady vibration the displacement is, at a phase theta of the load's period,

        u = A Re sum_k U_k exp(i k (theta - psi)) + c.

    The forward model gives the harmonics U_k. The load's size A and phase psi are unknown. So is
    the constant c, due to probe angles and steady forces. For each value of the crack's unknowns,
    A, psi and c are fitted to the measured displacements. The fitted u is the prediction. After the
    fit, A, psi and c remain uncertain. This uncertainty changes all predicted displacements
    together.

    Besides measurements there are candidates: possible further measurements, predicted to find out
    which is worth making.

    Parameters
    ----------
    row_indices : sequence of int
        Indices of these displacements in the list of all measurements and candidates. Measured
        displacements come first.
    measured_rows : sequence of Measurement
        All measurements.
    candidate_rows : sequence of Measurement
        All candidates.
    """

    def __init__(
        self,
        row_indices: Sequence[int],
        measured_rows: Sequence[Measurement],
        candidate_rows: Sequence[Measurement],
    ) -> None:
        self.row_indices, measurements_and_candidates = (
            list(row_indices),
            (*measured_rows, *candidate_rows),
        )
        measurements_in_group = [
            measured_rows[row_index]
            for row_index in self.row_indices
            if row_index < len(measured_rows)
        ]
        self._probe_phases = np.array(
            [measurements_and_candidates[row_index].phase for row_index in self.row_indices]
        )
        self._n_measured = len(measurements_in_group)
        self._measured_displacements = np.array(
            [measurement.value for measurement in measurements_in_group]
        )
        self._inverse_deviations = 1.0 / np.array(
            [measurement.deviation for measurement in measurements_in_group]
        )

    @classmethod
    def group_displacements_by_load_and_point(
        cls, measured_rows: Sequence[Measurement], candidate_rows: Sequence[Measurement]
    ) -> list[ProbeDisplacements]:
        """Group the displacements among measurements and candidates by load and point.

        Return an object for each load frequency and point; an empty list without displacements.
        """
        indices_by_load_and_point: dict[tuple[float, str], list[int]] = {}
        for row_index, measurement in enumerate((*measured_rows, *candidate_rows)):
            if measurement.quantity == "displacement":
                indices_by_load_and_point.setdefault(
                    (measurement.frequency, measurement.point), []
                ).append(row_index)
        return [
            cls(row_indices, measured_rows, candidate_rows)
            for row_indices in indices_by_load_and_point.values()
        ]

    def compute_random_phase_covariances(self, harmonic_orders: np.ndarray) -> np.ndarray:
        """Return covariances of n displacements by harmonics of random phase: (k, n, n).

        Used for harmonics above the solved orders: their size is estimated, but not their phase.
        Each of the k ``harmonic_orders`` gives a covariance, for a harmonic with the mean square
        amplitude 1.
        """
        phase_differences = self._probe_phases[:, None] - self._probe_phases
        return np.asarray(0.5 * np.cos(np.multiply.outer(harmonic_orders, phase_differences)))

    def fit_load_to_displacements(
        self, model_harmonics: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Fit the load's size A, its phase psi and a constant c to measured displacements.

        ``model_harmonics`` (m, K) [m] has the harmonics U_k of the model, k = 1 to K, for m values
        of the unknowns. This group has n displacements: measured displacements, then candidates for
        further measurements.

        Returns
        -------
        displacements : (m, n) [m]
            Predicted displacements.
        displacement_slopes : (m, n, K)
            Slopes t_k by the harmonics: u = Re sum_k t_k U_k + c.
        changes_per_fitted_load_deviation : (m, n, 3) [m]
            Changes of the displacements by one prior standard deviation of A, psi and c.
        load_sizes : (m,)
            Fitted size A; 1 if no displacement in the group is measured.
        """
        harmonic_orders = np.arange(1, model_harmonics.shape[1] + 1)
        phase_factors = np.exp(1j * np.multiply.outer(self._probe_phases, harmonic_orders))
        load_sizes = np.ones(len(model_harmonics))
        load_phases = np.zeros(len(model_harmonics))
        fitted_constant_displacements = np.zeros(len(model_harmonics))
        if self._n_measured:
            load_sizes, load_phases, fitted_constant_displacements = self._fit_load_and_constant(
                model_harmonics, phase_factors[: self._n_measured], harmonic_orders
            )
        displacement_slopes = (
            phase_factors
            * (load_sizes[:, None] * np.exp(-1j * np.outer(load_phases, harmonic_orders)))[
                :, None, :
            ]
        )
        harmonic_terms = displacement_slopes * model_harmonics[:, None, :]
        displacements = harmonic_terms.sum(axis=2).real
        # Wide priors: standard deviations of 100 % for the size, of a uniform phase over the
        # period, and of ten times the largest displacement for the constant.
        phase_induced_changes = (
            np.pi / np.sqrt(3.0) * (harmonic_orders * harmonic_terms).sum(axis=2).imag
        )
        constant_change = 10.0 * np.max(np.abs(self._measured_displacements), initial=0.0)
        changes_per_fitted_load_deviation = np.stack(
            [displacements, phase_induced_changes, np.full_like(displacements, constant_change)],
            axis=2,
        )
        return (
            displacements + fitted_constant_displacements[:, None],
            displacement_slopes,
            changes_per_fitted_load_deviation,
            load_sizes,
        )

    def _fit_load_and_constant(
        self, model_harmonics: np.ndarray, phase_factors: np.ndarray, harmonic_orders: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Fit A > 0, psi [rad] and c [m] by least squares: (m,) each.

        The best of 64 phases is refined by four damped Gauss-Newton steps, for all m values of the
        unknowns at once.

        Parameters
        ----------
        model_harmonics : (m, K) [m]
            Harmonics U_k.
        phase_factors : (n, K)
            exp(i k theta) at the n measured phases.
        harmonic_orders : (K,)
            Orders k.
        """
        tried_phases = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
        harmonics_at_tried_load_phases = model_harmonics[:, None, :] * np.exp(
            -1j * np.multiply.outer(tried_phases, harmonic_orders)
        )
        displacements = (harmonics_at_tried_load_phases @ phase_factors.T).real  # (m, tried, n)
        weight_shares = self._inverse_deviations**2 / np.sum(self._inverse_deviations**2)
        centred_measurements = (
            self._measured_displacements - weight_shares @ self._measured_displacements
        )
        centred_displacements = displacements - (displacements @ weight_shares)[..., None]
        model_times_measured_displacements = centred_displacements @ (
            weight_shares * centred_measurements
        )
        displacement_squared_norms = np.maximum(
            (centred_displacements**2) @ weight_shares, np.finfo(float).tiny
        )
        explained_squares = np.where(
            model_times_measured_displacements > 0.0,
            model_times_measured_displacements**2 / displacement_squared_norms,
            0.0,
        )
        best_phase_indices = explained_squares.argmax(axis=1)
        best_indices = np.arange(len(model_harmonics)), best_phase_indices
        load_sizes = (
            model_times_measured_displacements[best_indices]
            / displacement_squared_norms[best_indices]
        )
        load_phases = tried_phases[best_phase_indices]
        fitted_constant_displacements = (
            weight_shares @ self._measured_displacements
            - load_sizes * (displacements[best_indices] @ weight_shares)
        )
        constant_scale = np.max(np.abs(self._measured_displacements)) + np.finfo(float).tiny
        for _ in range(4):
            harmonic_terms = (
                model_harmonics[:, None, :]
                * phase_factors
                * np.exp(-1j * np.outer(load_phases, harmonic_orders))[:, None, :]
            )
            displacements = harmonic_terms.sum(axis=2).real
            phase_slopes = load_sizes[:, None] * (harmonic_orders * harmonic_terms).sum(axis=2).imag
            weighted_residuals = self._inverse_deviations * (
                self._measured_displacements
                - load_sizes[:, None] * displacements
                - fitted_constant_displacements[:, None]
            )
            parameter_slopes = np.stack(
                [
                    load_sizes[:, None] * displacements,
                    phase_slopes,
                    np.full_like(displacements, constant_scale),
                ],
                axis=2,
            )
            weighted_jacobian = parameter_slopes * self._inverse_deviations[:, None]
            transposed_jacobian = weighted_jacobian.transpose(0, 2, 1)
            newton_steps = np.linalg.solve(
                transposed_jacobian @ weighted_jacobian + 1e-3 * np.eye(3),
                transposed_jacobian @ weighted_residuals[..., None],
            )[..., 0]
            load_sizes = load_sizes * np.exp(np.clip(newton_steps[:, 0], -1.0, 1.0))
            load_phases = load_phases + np.clip(newton_steps[:, 1], -0.1, 0.1)
            fitted_constant_displacements = (
                fitted_constant_displacements + constant_scale * newton_steps[:, 2]
            )
        return load_sizes, load_phases, fitted_constant_displacements


# --- the model ------------------------------------------------------------------------------------


class CrackFaceState(NamedTuple):
    """Motion of the crack faces at resonances: breathing, always open or always closed.

    Each motion has a frequency for each mode. The standard deviations below describe resonances
    about this frequency. They are relative to the difference between the mode's bonded and open
    frequency.

    Attributes
    ----------
    resonance_state_name : str
        "bilinear" (breathing), "open" or "tied" (closed), from :data:`CRACK_STATES_AT_RESONANCE`.
    common_resonance_deviation : float
        Standard deviation of an error common to all resonances.
    independent_resonance_deviation : float
        Standard deviation of an error that each resonance has alone. For breathing faces, each mode
        has a further error, with the standard deviation in ``[identify]``.
    prior_weight : float
        Prior probability, up to a common factor.
    """

    resonance_state_name: str
    common_resonance_deviation: float = 0.0
    independent_resonance_deviation: float = 0.0
    prior_weight: float = 1.0


BREATHING_FACE_STATE = CrackFaceState("bilinear")
"""Crack faces that are open for half of the period: bilinear frequencies."""


@dataclass(frozen=True)
class MeasurementPredictions:
    """Prediction of q measurements, at m values of the unknowns.

    Attributes
    ----------
    values : (m, q)
        Predicted values; nan without a prediction.
    covariance : (m, q, q)
        Covariance of the errors of the values.
    changes_per_fitted_load_deviation : (m, q, s)
        Changes of the values by one standard deviation of the fitted load. The s columns are size,
        phase and constant for each group of displacements (:class:`ProbeDisplacements`).
    is_predictable : (q,) bool
        True for a measurement with a prediction.
    """

    values: np.ndarray
    covariance: np.ndarray
    changes_per_fitted_load_deviation: np.ndarray
    is_predictable: np.ndarray


class MeasurementPredictor:
    """Predictor of measurements, and of candidates for further measurements.

    Attributes
    ----------
    rows : tuple of Measurement
        q measurements, then candidates.
    is_predictable : (q,) bool
        True for a measurement or candidate that the solved cases can predict.
    plate_changes_since_baseline : BaselineChanges
        Possible changes of the plate since it was measured without the crack.
    """

    def __init__(
        self,
        model: ForwardModel,
        measured_rows: Sequence[Measurement],
        candidate_rows: Sequence[Measurement] = (),
    ) -> None:
        self.model, self.rows = model, (*measured_rows, *candidate_rows)
        features_by_row = [
            Feature.list_features_of_measurement(measurement, model.scene)
            for measurement in self.rows
        ]
        self._feature_predictor = FeaturePredictor(
            model, list(itertools.chain.from_iterable(features_by_row))
        )
        self._predicted_features = self._feature_predictor.features
        index_by_feature = {
            feature: feature_index for feature_index, feature in enumerate(self._predicted_features)
        }
        self._feature_indices_by_row = [
            [index_by_feature[feature] for feature in row_features]
            for row_features in features_by_row
        ]
        self.is_predictable = np.array(
            [
                self._feature_predictor.is_feature_predictable[feature_indices].all()
                for feature_indices in self._feature_indices_by_row
            ],
            dtype=bool,
        )
        self._all_false_feature_mask = np.zeros(len(self._predicted_features), dtype=bool)
        self._displacement_groups = ProbeDisplacements.group_displacements_by_load_and_point(
            measured_rows, candidate_rows
        )
        solved_load_index_per_feature = self._feature_predictor.solved_load_index_per_feature
        speed_ratios = model.coarse_mesh_cases.swept_loads.rotor_speed_ratios
        row_speed_ratios = [
            speed_ratios[solved_load_index_per_feature[feature_indices[0]]]
            for feature_indices in self._feature_indices_by_row
        ]
        self.plate_changes_since_baseline = BaselineChanges(
            self.rows, row_speed_ratios, model.uncracked_plate
        )
        self._higher_harmonic_masks, non_breathing_grid_by_load = (
            _find_loads_and_nodes_without_breathing(
                model.coarse_mesh_cases, self._predicted_features, solved_load_index_per_feature
            )
        )
        self._non_breathing_probability_interpolator = (
            RegularGridInterpolator(model.grid_of_solved_cases.axes, non_breathing_grid_by_load)
            if len(non_breathing_grid_by_load)
            else None
        )
        self._possible_face_states = (
            _list_possible_face_states(model)
            if any(measurement.is_resonant for measurement in self.rows)
            else (BREATHING_FACE_STATE,)
        )
        self._is_proportional_to_load_at_rest = is_response_proportional_to_load(
            model.scene.without_rotation()
        )

    def make_predictor(
        self, measured_rows: Sequence[Measurement], candidate_rows: Sequence[Measurement] = ()
    ) -> MeasurementPredictor:
        """Make a predictor for measurements, and for candidates for further measurements."""
        return MeasurementPredictor(self.model, measured_rows, candidate_rows)

    def with_change_deviation_factors(
        self, *, clamp_factor: float, temperature_factor: float
    ) -> MeasurementPredictor:
        """Return a copy with larger or smaller changes of clamp and temperature.

        The changes happen between the measurements without the crack and later ones.
        ``clamp_factor`` multiplies the prior standard deviation of frequency changes by the clamp.
        ``temperature_factor`` does so for an unknown temperature difference.
        """
        changed_predictor = copy(self)
        changed_predictor.plate_changes_since_baseline = (
            self.plate_changes_since_baseline.with_change_deviation_factors(
                clamp_factor, temperature_factor
            )
        )
        return changed_predictor

    def iterate_face_state_predictions(
        self, x: np.ndarray
    ) -> Iterator[tuple[np.ndarray, np.ndarray, MeasurementPredictions]]:
        """Yield predictions for each possible motion of the crack faces.

        At loads away from a resonance, a crack breathes, or stays open or closed. It may stay open
        or closed under a steady load, a preload or a clearance. The motion then has no higher
        harmonics. The solved cracks show if a crack breathes. Between a solved crack that breathes
        and a neighbour that does not, both motions are possible.

        At a resonance, the crack may be open for half of the period, for an unknown part of the
        period, always, or never (:func:`_list_possible_face_states`). All possible motions have the
        same probability. An unknown part may be common to all resonances, or differ between
        resonances, with half of this probability each. If the motion is proportional to the load,
        the crack is open for half of the period.

        Parameters
        ----------
        x : (m, d)
            m points, each with values of the d unknowns.

        Yields
        ------
        point_indices : (n,)
            Indices of the points for which this motion is possible.
        probabilities : (n,)
            Probability of the motion at these points.
        predictions : MeasurementPredictions
            Predictions at these points, with this motion.
        """
        non_breathing_probabilities = np.zeros((len(x), 0))
        if self._non_breathing_probability_interpolator is not None:
            non_breathing_probabilities = self._non_breathing_probability_interpolator(
                np.clip(
                    x,
                    self.model.grid_of_solved_cases.lower_bounds,
                    self.model.grid_of_solved_cases.upper_bounds,
                )
            )
        for is_non_breathing_by_load in itertools.product(
            (False, True), repeat=non_breathing_probabilities.shape[1]
        ):
            probabilities = np.prod(
                np.where(
                    is_non_breathing_by_load,
                    non_breathing_probabilities,
                    1.0 - non_breathing_probabilities,
                ),
                axis=1,
            )
            point_indices = np.flatnonzero(probabilities > 0.0)
            is_zero_feature = np.any(
                [
                    self._all_false_feature_mask,
                    *itertools.compress(self._higher_harmonic_masks, is_non_breathing_by_load),
                ],
                axis=0,
            )
            if len(point_indices):
                feature_prediction = self._feature_predictor(x[point_indices])
                for face_state in self._possible_face_states:
                    yield (
                        point_indices,
                        face_state.prior_weight * probabilities[point_indices],
                        self._predict_measurements(feature_prediction, is_zero_feature, face_state),
                    )

    def __call__(self, x: np.ndarray) -> MeasurementPredictions:
        """Return predictions at m points x (m, d), each with values of the d unknowns.

        At resonances, several motions of the crack faces may be possible. The predictions are for
        the first motion in :func:`_list_possible_face_states`: the motion with the largest standard
        deviation.
        """
        return self._predict_measurements(
            self._feature_predictor(x), self._all_false_feature_mask, self._possible_face_states[0]
        )

    def compute_interpolation_and_total_variances(
        self, x: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return variances of predictions by interpolation, and in total.

        ``x`` (m, d) are values of the unknowns.

        Returns
        -------
        (m, d, q)
            Variances of q predictions by interpolation along each of the d unknowns.
        (m, q)
            Total variances.
        """
        feature_prediction = self._feature_predictor(x)

        def propagate_to_variances(covariance: np.ndarray) -> np.ndarray:
            changed_prediction = feature_prediction._replace(smooth_form_covariance=covariance)
            prediction = self._predict_measurements(
                changed_prediction, self._all_false_feature_mask, self._possible_face_states[0]
            )
            return np.diagonal(prediction.covariance, axis1=1, axis2=2)

        variances_without_interpolation = propagate_to_variances(
            np.zeros_like(feature_prediction.smooth_form_covariance)
        )
        interpolation_variances_by_unknown = [
            propagate_to_variances(covariance) - variances_without_interpolation
            for covariance in self._feature_predictor.interpolation_covariances_per_unknown(x)
        ]
        return np.stack(interpolation_variances_by_unknown, axis=1), propagate_to_variances(
            feature_prediction.smooth_form_covariance
        )

    def _predict_measurements(
        self,
        feature_prediction: FeaturePrediction,
        is_zero_feature: np.ndarray,
        face_state: CrackFaceState,
    ) -> MeasurementPredictions:
        """Predict all measurements from features, for a motion of the crack faces.

        Parameters
        ----------
        feature_prediction : FeaturePrediction
            Prediction of f natural frequencies and harmonics.
        is_zero_feature : (f,) bool
            True for features that are set to 0: higher harmonics of faces that stay open or closed.
        face_state : CrackFaceState
            Motion of the crack faces at resonances.
        """
        feature_to_smooth_form_factors = feature_prediction.feature_to_smooth_form_factors
        feature_values, feature_interpolation_variances = (
            np.where(is_zero_feature, 0.0, feature_values_or_variances)
            for feature_values_or_variances in (
                feature_prediction.feature_values,
                feature_prediction.interpolation_variances,
            )
        )
        predictions, prediction_slopes_by_smooth_forms, common_errors, independent_variances = (
            self._predict_all_but_displacements(
                feature_prediction.damping_ratio_of_points,
                feature_values,
                feature_to_smooth_form_factors,
                face_state,
            )
        )
        predictions *= self.plate_changes_since_baseline.temperature_frequency_factors
        load_change_blocks = [np.zeros((*predictions.shape, 0))]
        covariance_by_omitted_harmonics = np.zeros(
            (len(feature_values), len(self.rows), len(self.rows))
        )
        for displacement_group in self._displacement_groups:
            row_indices = displacement_group.row_indices
            feature_indices = self._feature_indices_by_row[row_indices[0]]
            predictions[:, row_indices], displacement_slopes, load_induced_changes, load_sizes = (
                displacement_group.fit_load_to_displacements(feature_values[:, feature_indices])
            )
            harmonic_mean_squares = (
                np.abs(feature_values[:, feature_indices]) ** 2
                + feature_interpolation_variances[:, feature_indices]
            )
            omitted_harmonic_orders, omitted_harmonic_mean_squares = (
                self._estimate_omitted_orders_and_squares(
                    self._predicted_features[feature_indices[0]],
                    harmonic_mean_squares,
                    feature_prediction.damping_ratio_of_points,
                    feature_prediction.frequency_drop_root_and_frequencies[:, feature_indices[:1]],
                )
            )
            group_block_index = np.ix_(range(len(feature_values)), row_indices, row_indices)
            order_covariances = displacement_group.compute_random_phase_covariances(
                omitted_harmonic_orders
            )
            covariance_by_omitted_harmonics[group_block_index] = load_sizes[
                :, None, None
            ] ** 2 * np.tensordot(omitted_harmonic_mean_squares, order_covariances, axes=1)
            prediction_slopes_by_smooth_forms[
                :, np.array(row_indices)[:, None], feature_indices
            ] = displacement_slopes / feature_to_smooth_form_factors[:, None, feature_indices]
            all_row_changes_by_unknown_load = np.zeros(
                (*predictions.shape, load_induced_changes.shape[2])
            )
            all_row_changes_by_unknown_load[:, row_indices] = load_induced_changes
            load_change_blocks.append(all_row_changes_by_unknown_load)
        prediction_slopes_by_smooth_forms[:, ~self.is_predictable] = 0.0
        prediction_slopes_by_smooth_forms[..., is_zero_feature] = 0.0
        slopes_by_real_and_imaginary_parts = split_complex_columns(
            prediction_slopes_by_smooth_forms.conj()
        )
        covariance = covariance_by_omitted_harmonics + (
            slopes_by_real_and_imaginary_parts
            @ feature_prediction.smooth_form_covariance
            @ slopes_by_real_and_imaginary_parts.transpose(0, 2, 1)
        )
        shared_errors = np.concatenate(
            [
                predictions[..., None] * self.plate_changes_since_baseline.frequency_changes,
                common_errors,
            ],
            axis=2,
        )
        covariance += shared_errors @ shared_errors.transpose(0, 2, 1) + independent_variances[
            :, :, None
        ] * np.eye(len(self.rows))
        predictions = np.where(self.is_predictable, predictions, np.nan)
        return MeasurementPredictions(
            predictions, covariance, np.concatenate(load_change_blocks, axis=2), self.is_predictable
        )

    def _estimate_omitted_orders_and_squares(
        self,
        first_harmonic_feature: Feature,
        mean_squares: np.ndarray,
        damping_ratio_of_points: np.ndarray,
        frequency_drop_root_and_frequencies: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Estimate the mean squares of harmonics above the solved orders.

        Displacements at probes contain all harmonics. The omitted harmonics are an error of the
        prediction, with this variance.

        Harmonics of the contact force fall like 1 / k. They act on modes with natural frequencies
        w_j, damping ratio z and static compliances 1 / w_j^2, at the load frequency W:

            |U_k|^2 = c^2 sum_j |w_j^2 - (k W)^2 + 2 i z w_j k W|^-2 / k^2.

        The constant c^2 is fitted as the mean over the upper half of the known harmonics.

        Parameters
        ----------
        first_harmonic_feature : Feature
            First harmonic of a point.
        mean_squares : (m, K) [m^2]
            Mean squares of the K known harmonics of this point, at m values of the unknowns.
        damping_ratio_of_points : (m, 1)
            Damping ratios z.
        frequency_drop_root_and_frequencies : (m, 1, 1 + 2 modes)
            :attr:`SolvedCases.frequency_drop_root_and_frequencies` at the load.

        Returns
        -------
        omitted_orders : (n,)
            Orders of the n omitted harmonics.
        omitted_mean_squares : (m, n) [m^2]
            Mean squares of the omitted harmonics.
        """
        coarse_mesh_cases, load_frequency = (
            self.model.coarse_mesh_cases,
            first_harmonic_feature.load_frequency,
        )
        n_known_harmonics = min(
            coarse_mesh_cases.find_smallest_harmonic_count(load_frequency), mean_squares.shape[1]
        )
        highest_natural_frequency = np.nanmax(
            coarse_mesh_cases.frequency_drop_root_and_frequencies[..., STORED_MODE_NUMBER_RANGE],
            initial=0.0,
        )
        n_harmonics = min(
            max(2 * n_known_harmonics, math.ceil(highest_natural_frequency / load_frequency)),
            MAX_HARMONIC_ORDER,
        )
        harmonic_features = [
            replace(first_harmonic_feature, harmonic_order=harmonic_order)
            for harmonic_order in range(1, n_harmonics + 1)
        ]
        squared_compliances = (
            np.nan_to_num(
                frequency_drop_root_and_frequencies[..., STORED_MODE_NUMBER_RANGE], nan=np.inf
            )
            ** -4.0
        )
        squares_for_unit_force_constant = np.sum(
            squared_compliances
            / np.abs(
                find_frequency_ratios_and_pole_factors(
                    harmonic_features, damping_ratio_of_points, frequency_drop_root_and_frequencies
                )[1]
            )
            ** 2,
            axis=2,
        )
        squares_for_unit_force_constant /= np.arange(1.0, n_harmonics + 1.0) ** 2
        upper_half_slice = slice(n_known_harmonics // 2, n_known_harmonics)
        with np.errstate(divide="ignore", invalid="ignore"):
            force_squares = np.nan_to_num(
                np.mean(
                    mean_squares[:, upper_half_slice]
                    / squares_for_unit_force_constant[:, upper_half_slice],
                    axis=1,
                )
            )
        return np.arange(n_known_harmonics + 1, n_harmonics + 1), force_squares[
            :, None
        ] * squares_for_unit_force_constant[:, n_known_harmonics:]

    def _predict_all_but_displacements(
        self,
        damping_ratio_of_points: np.ndarray,
        feature_values: np.ndarray,
        feature_to_smooth_form_factors: np.ndarray,
        face_state: CrackFaceState,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Predict all measurements but displacements, for a motion of the crack faces.

        Parameters
        ----------
        damping_ratio_of_points : (m, 1)
            Damping ratio at each of m values of the unknowns.
        feature_values : (m, f)
            Logarithms of natural frequencies [Hz], and complex harmonics [m].
        feature_to_smooth_form_factors : (m, f)
            Factors by which features are multiplied to become smooth forms S.
        face_state : CrackFaceState
            Motion of the crack faces.

        Returns
        -------
        predictions : (m, q)
            Predicted values; 0 for displacements and without a prediction.
        complex_slopes : (m, q, f)
            Slopes t of the predictions by the smooth forms: a prediction changes by Re sum t dS.
        common_errors : (m, q, 1 + modes)
            Errors common to all resonances (column 0), and to the resonances of each mode.
        independent_variances : (m, q)
            Variances of errors that each measurement has alone.
        """
        feature_sizes, feature_size_slopes = _compute_feature_sizes_and_slopes(
            self._predicted_features, feature_values, feature_to_smooth_form_factors
        )
        predictions, independent_variances = np.zeros((2, len(feature_values), len(self.rows)))
        common_errors = np.zeros((*predictions.shape, 1 + N_NATURAL_MODES_PER_CRACK_STATE))
        complex_slopes = np.zeros(
            (*predictions.shape, len(self._predicted_features)), dtype=complex
        )
        identify_table = self.model.identify_table
        for row_index, (row, feature_indices) in enumerate(
            zip(self.rows, self._feature_indices_by_row, strict=True)
        ):
            if row.quantity == "displacement" or not self.is_predictable[row_index]:
                continue
            row_state = (
                BREATHING_FACE_STATE
                if row.rpm == 0.0 and self._is_proportional_to_load_at_rest
                else face_state
            )
            state_index = (
                CRACK_STATES_AT_RESONANCE.index(row_state.resonance_state_name)
                if row.is_resonant
                else 0
            )
            predictions[:, row_index], row_slopes_by_feature_sizes = _combine_features_with_slopes(
                row, feature_sizes[:, feature_indices], state_index
            )
            complex_slopes[:, row_index, feature_indices] = (
                row_slopes_by_feature_sizes * feature_size_slopes[:, feature_indices]
            )
            if row.is_resonant:
                _, open_frequencies, bonded_frequencies = feature_sizes[:, feature_indices].T
                frequency_split = bonded_frequencies - open_frequencies
                frequency_shift_by_damping = (
                    predictions[:, row_index] * damping_ratio_of_points[:, 0] ** 2
                )
                common_errors[:, row_index, 0] = (
                    row_state.common_resonance_deviation * frequency_split
                )
                relative_mode_resonance_deviation = (
                    identify_table.first_resonance_deviation
                    if row.mode == 1
                    else identify_table.resonance_deviation
                )
                common_errors[:, row_index, row.mode] = (
                    (state_index == 0) * relative_mode_resonance_deviation * frequency_split
                )
                independent_variances[:, row_index] = (
                    row_state.independent_resonance_deviation * frequency_split
                ) ** 2 + frequency_shift_by_damping**2
        for cracked_feature_index, uncracked_feature_index in zip(
            self._feature_predictor.cracked_frequency_feature_indices,
            self._feature_predictor.uncracked_frequency_feature_indices,
            strict=True,
        ):
            complex_slopes[:, :, uncracked_feature_index] += (
                complex_slopes[:, :, cracked_feature_index]
                * feature_to_smooth_form_factors[:, None, cracked_feature_index]
            )
        return predictions, complex_slopes, common_errors, independent_variances


def _find_loads_and_nodes_without_breathing(
    solved_cases: SolvedCases, features: Sequence[Feature], load_index_of_features: Sequence[int]
) -> tuple[list[np.ndarray], np.ndarray]:
    """Find the loads under which some, but not all solved cracks breathe.

    The faces of a crack that does not breathe stay open or closed. Its higher harmonics are zero.
    Under such a load, it must be estimated which of the cracks between grid nodes breathe.

    Parameters
    ----------
    solved_cases : SolvedCases
        Cases on the grid of the unknowns.
    features : sequence of Feature
        f natural frequencies and harmonics.
    load_index_of_features : (f,)
        Index of the load of each feature.

    Returns
    -------
    harmonic_masks : list of (f,) bool
        For each of the n loads, True for features that are higher harmonics under this load.
    motionless_grids : (n_1, ..., n_d, n)
        For each of the n loads, 1 at grid nodes with a crack that does not breathe, otherwise 0.
        The grid has d unknowns. An empty array without loads.
    """
    higher_harmonic_masks_by_load, non_breathing_grids_by_load = [], []
    is_higher_harmonic = np.array([feature.harmonic_order > 1 for feature in features], dtype=bool)
    for load_index in np.unique(np.array(load_index_of_features)[is_higher_harmonic]):
        is_higher_harmonic_of_load = is_higher_harmonic & (
            np.array(load_index_of_features) == load_index
        )
        node_values_of_load_harmonics = [
            features[feature_index].get_node_values(solved_cases)
            for feature_index in np.flatnonzero(is_higher_harmonic_of_load)
        ]
        largest_amplitude_at_nodes = np.fmax.reduce(np.abs(node_values_of_load_harmonics))
        is_node_without_breathing = largest_amplitude_at_nodes <= 1e-9 * np.fmax.reduce(
            largest_amplitude_at_nodes
        )  # rounding
        if is_node_without_breathing.any() and not is_node_without_breathing.all():
            higher_harmonic_masks_by_load.append(is_higher_harmonic_of_load)
            non_breathing_grids_by_load.append(
                is_node_without_breathing.reshape(solved_cases.grid_of_solved_cases.shape)
            )
    return higher_harmonic_masks_by_load, np.moveaxis(
        np.array(non_breathing_grids_by_load, dtype=float), 0, -1
    ) if higher_harmonic_masks_by_load else np.zeros(0)


def _list_possible_face_states(model: ForwardModel) -> tuple[CrackFaceState, ...]:
    """List the possible motions of the crack faces at resonances, with prior weights.

    The weights sum to 1. If the motion is proportional to the load, the only motion is breathing,
    open for half of the period. Otherwise the faces may also be open for an unknown part of the
    period. They may stay open if any solved crack is open for some time. They may stay closed if
    any solved crack is closed for some time.
    """
    if has_load_independent_motion_shape(model.scene):
        return (BREATHING_FACE_STATE,)
    relative_resonance_deviation = model.identify_table.resonance_deviation
    closed_time_share_of_cases = model.coarse_mesh_cases.sweep_result["closed_share"][
        model.coarse_mesh_cases.sweep_slices_for_text_values
    ]
    smallest_closed_time_share, largest_closed_time_share = (
        minimum_or_maximum_function.reduce(closed_time_share_of_cases, axis=None)
        for minimum_or_maximum_function in (np.fmin, np.fmax)
    )
    always_open_or_closed_states = itertools.compress(
        (CrackFaceState("open"), CrackFaceState("tied")),
        (smallest_closed_time_share < 1.0, largest_closed_time_share > 0.0),
    )
    # Open for an unknown part of the period: another part at each resonance, or a common part.
    states_open_part_of_the_period = (
        CrackFaceState(
            "bilinear",
            independent_resonance_deviation=relative_resonance_deviation,
            prior_weight=0.5,
        ),
        CrackFaceState(
            "bilinear", common_resonance_deviation=relative_resonance_deviation, prior_weight=0.5
        ),
    )
    possible_face_states = (
        *states_open_part_of_the_period,
        BREATHING_FACE_STATE,
        *always_open_or_closed_states,
    )
    total_weight = sum(face_state.prior_weight for face_state in possible_face_states)
    return tuple(
        face_state._replace(prior_weight=face_state.prior_weight / total_weight)
        for face_state in possible_face_states
    )


def _compute_feature_sizes_and_slopes(
    features: Sequence[Feature],
    feature_values: np.ndarray,
    feature_to_smooth_form_factors: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return sizes of f features, and slopes of the sizes by smooth forms: (m, f) each.

    Sizes are natural frequencies [Hz], and amplitudes of harmonics [m].

    Parameters
    ----------
    features : sequence of Feature
        f natural frequencies and harmonics.
    feature_values : (m, f)
        Logarithms of natural frequencies [Hz], and complex harmonics [m].
    feature_to_smooth_form_factors : (m, f)
        Factors by which features are multiplied to become smooth forms.
    """
    is_natural_frequency = np.array([feature.is_natural_frequency for feature in features])
    frequencies = np.exp(np.where(is_natural_frequency, feature_values.real, 0.0))
    harmonic_feature_amplitudes = np.abs(feature_values)
    with np.errstate(divide="ignore", invalid="ignore"):
        amplitude_slopes = (
            np.where(
                harmonic_feature_amplitudes > 0.0,
                np.conj(feature_values) / harmonic_feature_amplitudes,
                1.0,
            )
            / feature_to_smooth_form_factors
        )
    return (
        np.where(is_natural_frequency, frequencies, harmonic_feature_amplitudes),
        np.where(
            is_natural_frequency, frequencies / feature_to_smooth_form_factors, amplitude_slopes
        ),
    )


def _combine_features_with_slopes(
    measurement: Measurement, feature_sizes: np.ndarray, state_index: int
) -> tuple[np.ndarray, np.ndarray]:
    """Compute a measured quantity from the sizes of its features, with slopes.

    Parameters
    ----------
    measurement : Measurement
        Natural frequency, harmonic, or ratio of two harmonics.
    feature_sizes : (m, k)
        Natural frequencies [Hz], or amplitudes [m], of the k features from
        :meth:`Feature.list_features_of_measurement`.
    state_index : int
        For a resonance, index of the crack faces' motion in :data:`CRACK_STATES_AT_RESONANCE`;
        otherwise 0.

    Returns
    -------
    (m,)
        Predicted quantity.
    (m, k)
        Derivatives of the quantity by the sizes.
    """
    if measurement.is_natural_frequency or feature_sizes.shape[1] == 1:
        return feature_sizes[:, state_index], np.eye(1, feature_sizes.shape[1], state_index).repeat(
            len(feature_sizes), axis=0
        )
    numerator_amplitudes, denominator_amplitudes = feature_sizes.T
    return numerator_amplitudes / denominator_amplitudes, np.column_stack(
        [1.0 / denominator_amplitudes, -numerator_amplitudes / denominator_amplitudes**2]
    )
