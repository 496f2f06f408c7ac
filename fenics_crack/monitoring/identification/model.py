"""The forward model: predictions of measurements from the unknowns, and their covariance.

Prediction errors are not independent, since a single sweep makes all predictions. Their covariance
is a sum of three. The interpolation's part comes from leave-one-out errors in all quantities at
once. The mesh's part comes from the changes by a finer mesh, with half the variance common to all
quantities. The third part comes from the priors
(:mod:`fenics_crack.monitoring.identification.nuisance`).

Shapes: m points x of d unknowns, q measurements, f features. A feature is an interpolated natural
frequency or harmonic (:class:`fenics_crack.monitoring.identification.interpolation.Feature`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from fenics_crack.basics.errors import MAX_HARMONIC_ORDER, N_LOWEST_MODES
from fenics_crack.monitoring.identification.interpolation import (
    RESONANCE_STATES,
    Feature,
    Interpolation,
    SolvedCases,
    compute_ratios_and_poles,
    compute_smoothing_factors,
)
from fenics_crack.monitoring.identification.measurements import Measurement
from fenics_crack.monitoring.identification.nuisance import (
    CRACK_SIZE_KEYS,
    BaselineChanges,
    UncrackedPlate,
    compute_crack_deviations,
)
from fenics_crack.scene.scene import Scene
from fenics_crack.study.plausibility import is_response_proportional_to_load
from fenics_crack.sweep.file import KEPT_MODE_NUMBERS

# --- displacements at probes ----------------------------------------------------------------------


class ProbeDisplacements:
    """Displacements of a point under a load with unknown size and phase.

    Under a steady load the blade tip is, at a phase theta of the load's period,

        u = A Re sum_k U_k exp(i k (theta - psi)) + c,

    with the harmonics U_k of the model and three unknowns of a blade in operation. These are the
    load's size A and phase psi, and a constant c due to probe angles and steady forces. For each
    value of the unknowns the three are fitted to the displacements, by all harmonics of the model.
    The predictions are the fit; the likelihood gets their derivatives by the three as common errors
    of all displacements.

    Parameters
    ----------
    row_indices : sequence of int
        Indices of the displacements among all measurements, the measured ones first.
    measured_rows : sequence of Measurement
        All measurements made.
    candidate_rows : sequence of Measurement
        Possible further measurements.
    """

    def __init__(
        self,
        row_indices: Sequence[int],
        measured_rows: Sequence[Measurement],
        candidate_rows: Sequence[Measurement],
    ) -> None:
        self.row_indices, all_rows = list(row_indices), (*measured_rows, *candidate_rows)
        own_rows = [
            all_rows[row_index] for row_index in self.row_indices if row_index < len(measured_rows)
        ]
        self._phases = np.array([all_rows[row_index].phase for row_index in self.row_indices])
        self._n_measured = len(own_rows)
        self._measurement_values = np.array([measurement.value for measurement in own_rows])
        self._weights = 1.0 / np.array([measurement.deviation for measurement in own_rows])

    @classmethod
    def group_measurements(
        cls, measured_rows: Sequence[Measurement], candidate_rows: Sequence[Measurement]
    ) -> list[ProbeDisplacements]:
        """Group displacements by load and point."""
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

    def compute_harmonic_covariances(self, harmonic_orders: np.ndarray) -> np.ndarray:
        """Return covariances of displacements by harmonics of random phase: (k, n, n).

        Each of the orders (k,) has mean square 1.
        """
        phase_differences = self._phases[:, None] - self._phases
        return np.asarray(0.5 * np.cos(np.multiply.outer(harmonic_orders, phase_differences)))

    def fit_harmonics(
        self, harmonics: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Fit harmonics U_k (m, K) [m] to the measured displacements.

        Returns
        -------
        displacements : (m, n) [m]
            All displacements, those of candidates, too.
        displacement_slopes : (m, n, K)
            Their slopes t by the harmonics: u = Re sum_k t_k U_k + c.
        load_changes : (m, n, 3) [m]
            Their changes by a standard deviation of A, psi and c.
        load_sizes : (m,)
            A.
        """
        harmonic_orders = np.arange(1, harmonics.shape[1] + 1)
        phase_factors = np.exp(1j * np.multiply.outer(self._phases, harmonic_orders))
        load_sizes = np.ones(len(harmonics))
        load_phases = np.zeros(len(harmonics))
        constants = np.zeros(len(harmonics))
        if self._n_measured:
            load_sizes, load_phases, constants = self._fit_load_and_constant(
                harmonics, phase_factors[: self._n_measured], harmonic_orders
            )
        displacement_slopes = (
            phase_factors
            * (load_sizes[:, None] * np.exp(-1j * np.outer(load_phases, harmonic_orders)))[
                :, None, :
            ]
        )
        harmonic_parts = displacement_slopes * harmonics[:, None, :]
        displacements = harmonic_parts.sum(axis=2).real
        # Priors that are wide: all of the size, a phase anywhere in the period, a constant of ten
        # times the largest displacement.
        phase_changes = np.pi / np.sqrt(3.0) * (harmonic_orders * harmonic_parts).sum(axis=2).imag
        constant_change = 10.0 * np.max(np.abs(self._measurement_values), initial=0.0)
        load_changes = np.stack(
            [displacements, phase_changes, np.full_like(displacements, constant_change)], axis=2
        )
        return displacements + constants[:, None], displacement_slopes, load_changes, load_sizes

    def _fit_load_and_constant(
        self, harmonics: np.ndarray, phase_factors: np.ndarray, harmonic_orders: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Fit A > 0, psi and c by least squares: (m,) each, all m at once.

        The best of 64 phases is refined by four damped steps of Gauss and Newton.
        """
        tried_phases = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
        shifted_harmonics = harmonics[:, None, :] * np.exp(
            -1j * np.multiply.outer(tried_phases, harmonic_orders)
        )
        displacements = (shifted_harmonics @ phase_factors.T).real  # (m, tried, n)
        weight_shares = self._weights**2 / np.sum(self._weights**2)
        centred_measurements = self._measurement_values - weight_shares @ self._measurement_values
        centred_displacements = displacements - (displacements @ weight_shares)[..., None]
        projections = centred_displacements @ (weight_shares * centred_measurements)
        squared_norms = np.maximum((centred_displacements**2) @ weight_shares, np.finfo(float).tiny)
        explained_squares = np.where(projections > 0.0, projections**2 / squared_norms, 0.0)
        best_phase_indices = explained_squares.argmax(axis=1)
        all_indices = np.arange(len(harmonics))
        load_sizes = (
            projections[all_indices, best_phase_indices]
            / squared_norms[all_indices, best_phase_indices]
        )
        load_phases = tried_phases[best_phase_indices]
        constants = weight_shares @ self._measurement_values - load_sizes * (
            displacements[all_indices, best_phase_indices] @ weight_shares
        )
        for _ in range(4):
            harmonic_parts = (
                harmonics[:, None, :]
                * phase_factors
                * np.exp(-1j * np.outer(load_phases, harmonic_orders))[:, None, :]
            )
            displacements = harmonic_parts.sum(axis=2).real
            phase_slopes = load_sizes[:, None] * (harmonic_orders * harmonic_parts).sum(axis=2).imag
            weighted_residuals = self._weights * (
                self._measurement_values - load_sizes[:, None] * displacements - constants[:, None]
            )
            parameter_scales = np.array(
                [1.0, 1.0, np.max(np.abs(self._measurement_values)) + np.finfo(float).tiny]
            )
            weighted_columns = np.stack(
                [displacements * load_sizes[:, None], phase_slopes, np.ones_like(displacements)],
                axis=2,
            )
            weighted_columns = weighted_columns * parameter_scales * self._weights[:, None]
            squared_norms = weighted_columns.transpose(0, 2, 1) @ weighted_columns + 1e-3 * np.eye(
                3
            )
            newton_steps = np.linalg.solve(
                squared_norms, weighted_columns.transpose(0, 2, 1) @ weighted_residuals[..., None]
            )[..., 0]
            load_sizes = load_sizes * np.exp(np.clip(newton_steps[:, 0], -1.0, 1.0))
            load_phases = load_phases + np.clip(newton_steps[:, 1], -0.1, 0.1)
            constants = constants + parameter_scales[2] * newton_steps[:, 2]
        return load_sizes, load_phases, constants


# --- the model ------------------------------------------------------------------------------------


class CrackFaceState(NamedTuple):
    """State of the crack faces at resonances: they breathe, stay open or stay closed.

    Attributes
    ----------
    resonance_state : str
        One of RESONANCE_STATES.
    common_deviation, independent_deviation : float
        Standard deviation of resonances from the frequency of that state, relative to the
        difference between frequencies with the crack bonded and open. The first is common to all
        resonances, the second independent. For breathing faces those of each mode are added.
    prior_weight : float
        Prior probability, up to a common factor.
    """

    resonance_state: str
    common_deviation: float = 0.0
    independent_deviation: float = 0.0
    prior_weight: float = 1.0


BREATHING_FACES = CrackFaceState("bilinear")
"""Crack faces that are open for half of the period."""


class ForwardModel:
    """Predictions of measurements, with their covariance.

    Parameters
    ----------
    scene : Scene
        Scene with the damping and the table ``[identify]``.
    uncracked_plate : UncrackedPlate
        The plate without its crack.
    case_sets : (coarse, finer, halfway)
        Solved cases of the sweep; of the finer mesh, or None; and halfway between the nodes, or
        None.
    word_by_key : mapping of str to object
        Values of the unknowns that are words.
    """

    def __init__(
        self,
        scene: Scene,
        uncracked_plate: UncrackedPlate,
        case_sets: Sequence[SolvedCases | None],
        *,
        word_by_key: Mapping[str, Any],
    ) -> None:
        self.scene = scene
        self.identify_table = scene.given("identify")
        self.uncracked_plate = uncracked_plate
        coarse_cases, self.finer_cases, self.halfway_cases = case_sets
        assert coarse_cases is not None
        self.coarse_cases = coarse_cases
        self.word_by_key = dict(word_by_key)
        self.unknown_keys = coarse_cases.unknown_keys
        self.unknown_grid = coarse_cases.unknown_grid

    def make_predictor(
        self, rows: Sequence[Measurement], candidate_rows: Sequence[Measurement] = ()
    ) -> MeasurementPredictor:
        """Make a predictor for measurements, and for candidates."""
        return MeasurementPredictor(self, rows, candidate_rows)

    def get_damping_ratios(self, x: np.ndarray) -> np.ndarray:
        """Return the damping ratio at values x (m, d) of the unknowns: (m, 1)."""
        if "damping.ratio" in self.unknown_keys:
            return x[:, [self.unknown_keys.index("damping.ratio")]]
        scene_ratios, damping_table = None, self.scene.damping
        if damping_table is not None:
            scene_ratios = (
                damping_table.ratios if damping_table.ratio is None else damping_table.ratio
            )
        return np.full(
            (len(x), 1), 0.01 if scene_ratios is None else np.mean(scene_ratios)
        )  # of a matrix

    def compute_crack_sizes(self, x: np.ndarray) -> np.ndarray:
        """Return the crack size at values x (m, d), relative to the largest: (m,).

        It is the product of relative length and depth; 1 if neither is an unknown.
        """
        key_indices = [
            key_index for key_index, key in enumerate(self.unknown_keys) if key in CRACK_SIZE_KEYS
        ]
        return np.asarray(
            np.prod(x[:, key_indices] / self.unknown_grid.upper_bounds[key_indices], axis=1)
        )

    def compute_crack_deviations(self, x: np.ndarray) -> np.ndarray:
        """Return standard deviations (m, d) of a crack from the equivalent one.

        They are for values x (m, d) of the unknowns.
        """
        return compute_crack_deviations(x, self.unknown_keys, self.scene)

    def list_candidates(self) -> tuple[Measurement, ...]:
        """List possible measurements: natural frequencies, and ratios of harmonics.

        The ratios are at all points and load frequencies of the sweep.
        """
        quantity_names = ["frequency_open", "frequency_tied", "frequency_resonance"]
        if self.coarse_cases.uncracked_cases is not None:
            quantity_names.append("frequency_uncracked")
        candidate_rows = [
            Measurement(quantity_name, 1.0, 1.0, mode + 1)
            for quantity_name in quantity_names
            for mode in range(N_LOWEST_MODES)
        ]
        load_frequencies = self.coarse_cases.swept_loads.frequencies
        ratio_names = ("ratio_2_1", "ratio_3_1")
        point_names = ["", *self.coarse_cases.sweep_result.scene.point_names]
        for load_frequency, point_name, ratio_name in itertools.product(
            load_frequencies, point_names, ratio_names
        ):
            candidate_rows.append(
                Measurement(ratio_name, 1.0, 1.0, frequency=load_frequency, point=point_name)
            )
        return tuple(candidate_rows)


@dataclass(frozen=True)
class MeasurementPrediction:
    """Prediction of q measurements, at m values of the unknowns.

    Attributes
    ----------
    values : (m, q)
        Predicted values.
    covariance : (m, q, q)
        Covariance of their errors.
    load_changes : (m, q, s)
        Their changes by a standard deviation of each unknown of the load and the probes.
    is_predictable : (q,) bool
        True for a measurement that can be predicted.
    """

    values: np.ndarray
    covariance: np.ndarray
    load_changes: np.ndarray
    is_predictable: np.ndarray


class FeaturePrediction(NamedTuple):
    """Features at m values of the unknowns.

    Attributes
    ----------
    damping_ratios : (m, 1)
    scale_and_frequencies : (m, f, 1 + 2 modes)
        :attr:`SolvedCases.scale_and_frequencies` there at the load of each feature.
    smoothing_factors : (m, f)
        Factors that make features smooth.
    feature_values : (m, f)
        The features: logarithms of natural frequencies, and complex harmonics.
    interpolation_variances : (m, f)
        Mean squares of their errors by the interpolation.
    smooth_covariance : (m, 2f, 2f)
        Covariance of their smooth forms, real and imaginary parts in turn.
    """

    damping_ratios: np.ndarray
    scale_and_frequencies: np.ndarray
    smoothing_factors: np.ndarray
    feature_values: np.ndarray
    interpolation_variances: np.ndarray
    smooth_covariance: np.ndarray


class MeasurementPredictor:
    """Predictions of measurements, and of candidates for further measurements, by a model.

    Attributes
    ----------
    is_predictable : (q,) bool
        True for a measurement that can be predicted.
    baseline_changes : BaselineChanges
        Possible changes since there was no crack.
    """

    def __init__(
        self,
        model: ForwardModel,
        rows: Sequence[Measurement],
        candidate_rows: Sequence[Measurement] = (),
    ) -> None:
        self.model, self.rows = model, (*rows, *candidate_rows)
        self._index_features()
        self._probe_groups = ProbeDisplacements.group_measurements(rows, candidate_rows)
        self._error_groups = _build_error_groups(self._features)
        self._is_uncracked = np.array(
            [feature.crack_state == "uncracked" for feature in self._features]
        )
        node_data = model.coarse_cases.scale_and_frequencies
        self._node_data_interpolation = Interpolation(
            model.unknown_grid, node_data.reshape(len(node_data), -1)
        )
        self._highest_frequency = float(np.nanmax(node_data[..., KEPT_MODE_NUMBERS], initial=0.0))
        self._load_indices = [
            model.coarse_cases.find_load_index(feature.load_frequency) for feature in self._features
        ]
        speed_ratios = model.coarse_cases.swept_loads.speed_ratios
        self._prior_sensitivities = np.stack(
            [model.uncracked_plate.compute_prior_sensitivities(ratio) for ratio in speed_ratios]
        )[self._load_indices]
        row_speed_ratios = [
            speed_ratios[self._load_indices[feature_indices[0]]]
            for feature_indices in self._feature_indices_by_row
        ]
        self.baseline_changes = BaselineChanges(self.rows, row_speed_ratios, model.uncracked_plate)
        self._higher_harmonic_masks, is_motionless = _find_motionless_nodes(
            model.coarse_cases, self._features, self._load_indices
        )
        self._motionless_interpolator = (
            RegularGridInterpolator(model.unknown_grid.axes, is_motionless)
            if len(is_motionless)
            else None
        )
        self._face_states = (
            _list_face_states(model)
            if any(measurement.resonance for measurement in self.rows)
            else (BREATHING_FACES,)
        )
        self._is_free_at_rest = is_response_proportional_to_load(model.scene.at_rest())
        self._interpolate_features()

    def _index_features(self) -> None:
        """List the features, their indices in each row, and pairs with and without a crack."""
        features_by_row = [
            Feature.list_for_measurement(measurement, self.model.scene) for measurement in self.rows
        ]
        features = [feature for row_features in features_by_row for feature in row_features]
        features += [
            feature.uncracked_feature for feature in features if feature.is_cracked_frequency
        ]
        self._features = tuple(dict.fromkeys(features))
        index_by_feature = {
            feature: feature_index for feature_index, feature in enumerate(self._features)
        }
        self._feature_indices_by_row = [
            [index_by_feature[feature] for feature in row_features]
            for row_features in features_by_row
        ]
        index_pairs = [
            (index_by_feature[feature], index_by_feature[feature.uncracked_feature])
            for feature in index_by_feature
            if feature.is_cracked_frequency
        ]
        self._cracked_indices, self._uncracked_indices = (
            map(list, zip(*index_pairs, strict=True)) if index_pairs else ([], [])
        )

    def _interpolate_features(self) -> None:
        """Interpolate the features, and the correction by the finer mesh."""
        model = self.model
        self._coarse_interpolation = Interpolation(
            model.unknown_grid, self._evaluate_smooth_features(model.coarse_cases)
        )
        self._error_scales = self._estimate_error_scales()
        is_harmonic_column = np.repeat(
            [not feature.is_natural_frequency for feature in self._features], 2
        )
        has_known_column = self._coarse_interpolation.has_enough_nodes & (
            self._coarse_interpolation.is_between_known | ~is_harmonic_column
        )
        # An error of the first order leaves d / (f - 1) where a mesh finer by f changes d, one of
        # high order nothing: half of the former is added, and may be wrong.
        self._mesh_correction: Interpolation | None = None
        mesh_ratio = model.identify_table.finer
        self._remaining_mesh_fraction = 0.5 / max(mesh_ratio - 1.0, 1.0 / mesh_ratio - 1.0, 0.1)
        if model.finer_cases is not None:
            finer_cases = model.finer_cases
            mesh_difference = self._evaluate_smooth_features(
                finer_cases
            ) - self._coarse_interpolation.interpolate(finer_cases.unknown_grid.nodes)
            self._mesh_correction = Interpolation(finer_cases.unknown_grid, mesh_difference)
            has_known_column &= self._mesh_correction.has_enough_nodes & (
                self._mesh_correction.is_between_known | ~is_harmonic_column
            )
        is_known_feature = has_known_column.reshape(-1, 2).all(axis=1)
        is_known_feature[self._cracked_indices] &= is_known_feature[self._uncracked_indices]
        self.is_predictable = np.array(
            [
                bool(is_known_feature[feature_indices].all())
                for feature_indices in self._feature_indices_by_row
            ]
        )

    def with_change_factors(
        self, *, clamp_factor: float, temperature_factor: float
    ) -> MeasurementPredictor:
        """Return a copy with the priors of changes since the baseline multiplied.

        The factors are for the clamp and for an unknown temperature.
        """
        changed_predictor = copy(self)
        changed_predictor.baseline_changes = self.baseline_changes.with_change_factors(
            clamp_factor, temperature_factor
        )
        return changed_predictor

    def iterate_face_states(
        self, x: np.ndarray
    ) -> Iterator[tuple[np.ndarray, np.ndarray, MeasurementPrediction]]:
        """Iterate over possible states of the crack faces at x (m, d).

        Under a steady load, a preload or a clearance a crack may stay open or closed. The motion
        then has no higher harmonics. Between a node with such a motion and one without, both are
        possible.

        At a resonance four cases have the same probability: the crack stays open, stays closed,
        breathes for half of the period, or breathes for another part of it. The last is split
        equally: the same part at all resonances, or another at each.

        Yields
        ------
        point_indices : (n,)
            Points among x at which the state is possible.
        probabilities : (n,)
            Its probability there.
        prediction : MeasurementPrediction
            Predictions there.
        """
        motionless_fractions = np.zeros((len(x), 0))
        if self._motionless_interpolator is not None:
            motionless_fractions = self._motionless_interpolator(
                np.clip(
                    x, self.model.unknown_grid.lower_bounds, self.model.unknown_grid.upper_bounds
                )
            )
        for is_group_motionless in itertools.product(
            (False, True), repeat=motionless_fractions.shape[1]
        ):
            probabilities = np.prod(
                np.where(is_group_motionless, motionless_fractions, 1.0 - motionless_fractions),
                axis=1,
            )
            point_indices = np.flatnonzero(probabilities > 0.0)
            group_masks = list(itertools.compress(self._higher_harmonic_masks, is_group_motionless))
            is_zero_feature = np.any(group_masks, axis=0) if group_masks else None
            if len(point_indices):
                feature_prediction = self._predict_features(x[point_indices])
                for face_state in self._face_states:
                    yield (
                        point_indices,
                        face_state.prior_weight * probabilities[point_indices],
                        self._predict_measurements(feature_prediction, is_zero_feature, face_state),
                    )

    def _evaluate_smooth_features(self, solved_cases: SolvedCases) -> np.ndarray:
        """Return smooth forms of all features at the nodes of a sweep: (n, 2f).

        Real and imaginary parts alternate.
        """
        feature_values = np.stack(
            [feature.get_node_values(solved_cases) for feature in self._features], axis=1
        )
        feature_values[:, self._cracked_indices] -= feature_values[:, self._uncracked_indices]
        return _split_complex_columns(
            feature_values
            * self._compute_smoothing_factors(
                solved_cases.unknown_grid.nodes,
                self._interpolate_node_data(solved_cases.unknown_grid.nodes),
            )
        )

    def _estimate_error_scales(self) -> np.ndarray:
        """Return factors (2f,), at least 1, by which interpolation errors are understated.

        They compare the errors halfway between nodes with the estimated errors. Features with more
        waves than nodes look smooth, as higher modes along the height do.
        """
        halfway_cases = self.model.halfway_cases
        if halfway_cases is None:
            return np.ones(2 * len(self._features))
        x = halfway_cases.unknown_grid.nodes
        squared_errors = (
            self._evaluate_smooth_features(halfway_cases)
            - self._coarse_interpolation.interpolate(x)
        ) ** 2
        stated_variances = np.sum(
            self._coarse_interpolation.compute_weighted_errors(x) ** 2, axis=1
        )
        error_and_variance_sums = [
            np.nansum(squared_columns, axis=0).reshape(-1, 2).sum(axis=1)
            for squared_columns in (squared_errors, stated_variances)
        ]
        with np.errstate(divide="ignore", invalid="ignore"):
            variance_ratios = np.where(
                error_and_variance_sums[1] > 0.0,
                error_and_variance_sums[0] / error_and_variance_sums[1],
                1.0,
            )
        return np.repeat(np.sqrt(np.maximum(variance_ratios, 1.0)), 2)

    def _compute_smoothing_factors(
        self, x: np.ndarray, scale_and_frequencies: np.ndarray
    ) -> np.ndarray:
        """Return factors (m, f) that make features smooth.

        Both meshes take them from the coarse one.
        """
        return compute_smoothing_factors(
            self._features,
            self.model.get_damping_ratios(x),
            scale_and_frequencies,
            self.model.compute_crack_sizes(x),
        )

    def _interpolate_node_data(self, x: np.ndarray) -> np.ndarray:
        """Return :attr:`SolvedCases.scale_and_frequencies` at x (m, d): (m, f, 1 + 2 modes).

        It is at the load of each feature.
        """
        node_data = np.where(
            self._node_data_interpolation.has_enough_nodes,
            self._node_data_interpolation.interpolate(x),
            np.nan,
        )
        return node_data.reshape(len(x), *self.model.coarse_cases.scale_and_frequencies.shape[1:])[
            :, self._load_indices
        ]

    def __call__(self, x: np.ndarray) -> MeasurementPrediction:
        """Return predictions at x (m, d) in the first state of the faces.

        If several states are possible at resonances, that is the least certain one.
        """
        return self._predict_measurements(self._predict_features(x), None, self._face_states[0])

    def compute_interpolation_variances(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the variances of predictions at x (m, d) by interpolation.

        Returns
        -------
        (m, d, q)
            Variances by interpolation along each unknown.
        (m, q)
            Total variances.
        """
        feature_prediction = self._predict_features(x)
        zero_features = np.zeros((len(x), 2 * len(self._features)))

        def propagate_covariance(covariance: np.ndarray) -> np.ndarray:
            changed_prediction = feature_prediction._replace(smooth_covariance=covariance)
            prediction = self._predict_measurements(changed_prediction, None, self._face_states[0])
            return np.diagonal(prediction.covariance, axis1=1, axis2=2)

        other_variances = propagate_covariance(np.zeros_like(feature_prediction.smooth_covariance))
        variances_by_unknown = []
        for weighted_errors in self._coarse_interpolation.compute_weighted_errors_by_axis(x)[
            : x.shape[1]
        ]:
            feature_errors = self._collect_feature_errors(
                zero_features, zero_features, [self._error_scales * weighted_errors]
            )
            variances_by_unknown.append(
                propagate_covariance(feature_errors @ feature_errors.transpose(0, 2, 1))
                - other_variances
            )
        return np.stack(variances_by_unknown, axis=1), propagate_covariance(
            feature_prediction.smooth_covariance
        )

    def _predict_features(self, x: np.ndarray) -> FeaturePrediction:
        """Return the features at x (m, d)."""
        smooth_features = self._coarse_interpolation.interpolate(x)
        interpolation_errors = [
            self._error_scales * self._coarse_interpolation.compute_weighted_errors(x)
        ]
        remaining_mesh_errors = np.zeros_like(smooth_features)
        if self._mesh_correction is not None:
            mesh_difference = self._mesh_correction.interpolate(x)
            remaining_mesh_errors = self._remaining_mesh_fraction * mesh_difference
            smooth_features = smooth_features + mesh_difference + remaining_mesh_errors
            interpolation_errors.append(self._mesh_correction.compute_weighted_errors(x))
        damping_ratios = self.model.get_damping_ratios(x)
        scale_and_frequencies = self._interpolate_node_data(x)
        smoothing_factors = self._compute_smoothing_factors(x, scale_and_frequencies)
        feature_values = (
            smooth_features[:, ::2] + 1j * smooth_features[:, 1::2]
        ) / smoothing_factors
        uncracked_plate = self.model.uncracked_plate
        prior_sensitivities = uncracked_plate.compute_feature_sensitivities(
            self._features, damping_ratios, scale_and_frequencies, self._prior_sensitivities
        )
        prior_sensitivities = (
            prior_sensitivities
            * np.where(self._is_uncracked, 1.0, feature_values * smoothing_factors)[..., None]
        )
        feature_values[:, self._cracked_indices] += feature_values[:, self._uncracked_indices]
        interpolation_variances = sum(
            np.sum(feature_errors**2, axis=1) for feature_errors in interpolation_errors
        )
        interpolation_variances = (
            interpolation_variances[:, ::2] + interpolation_variances[:, 1::2]
        ) / np.abs(smoothing_factors) ** 2
        prior_errors = _split_complex_columns(prior_sensitivities.transpose(0, 2, 1)).transpose(
            0, 2, 1
        )
        feature_errors = np.concatenate(
            [
                self._collect_feature_errors(
                    smooth_features, remaining_mesh_errors, interpolation_errors
                ),
                prior_errors,
            ],
            axis=2,
        )
        return FeaturePrediction(
            damping_ratios,
            scale_and_frequencies,
            smoothing_factors,
            feature_values,
            interpolation_variances,
            feature_errors @ feature_errors.transpose(0, 2, 1),
        )

    def _predict_measurements(
        self,
        feature_prediction: FeaturePrediction,
        is_zero_feature: np.ndarray | None,
        face_state: CrackFaceState,
    ) -> MeasurementPrediction:
        """Predict all measurements from features and a state of the crack faces.

        Features with ``is_zero_feature`` (f,) are 0.
        """
        smoothing_factors = feature_prediction.smoothing_factors
        feature_values = feature_prediction.feature_values
        interpolation_variances = feature_prediction.interpolation_variances
        if is_zero_feature is not None:
            feature_values, interpolation_variances = (
                np.where(is_zero_feature, 0.0, feature_array)
                for feature_array in (feature_values, interpolation_variances)
            )
        predictions, complex_slopes, common_errors, independent_variances = (
            self._predict_all_but_displacements(
                feature_prediction.damping_ratios, feature_values, smoothing_factors, face_state
            )
        )
        predictions *= self.baseline_changes.temperature_factors
        load_change_blocks = [np.zeros((*predictions.shape, 0))]
        omitted_covariance = np.zeros((len(feature_values), len(self.rows), len(self.rows)))
        for probe_group in self._probe_groups:
            row_indices = probe_group.row_indices
            feature_indices = self._feature_indices_by_row[row_indices[0]]
            predictions[:, row_indices], real_slopes, load_changes, load_sizes = (
                probe_group.fit_harmonics(feature_values[:, feature_indices])
            )
            mean_squares = (
                np.abs(feature_values[:, feature_indices]) ** 2
                + interpolation_variances[:, feature_indices]
            )
            omitted_orders, omitted_squares = self._estimate_omitted_harmonics(
                self._features[feature_indices[0]],
                mean_squares,
                feature_prediction.damping_ratios,
                feature_prediction.scale_and_frequencies[:, feature_indices[:1]],
            )
            group_block = np.ix_(range(len(feature_values)), row_indices, row_indices)
            squared_sizes = load_sizes[:, None, None] ** 2
            omitted_covariance[group_block] = squared_sizes * np.tensordot(
                omitted_squares, probe_group.compute_harmonic_covariances(omitted_orders), axes=1
            )
            complex_slopes[:, np.array(row_indices)[:, None], feature_indices] = (
                real_slopes / smoothing_factors[:, None, feature_indices]
            )
            group_changes = np.zeros((*predictions.shape, load_changes.shape[2]))
            group_changes[:, row_indices] = load_changes
            load_change_blocks.append(group_changes)
        complex_slopes[:, ~self.is_predictable] = 0.0
        if is_zero_feature is not None:
            complex_slopes[..., is_zero_feature] = 0.0
        real_slopes = _split_complex_columns(complex_slopes.conj())
        covariance = (
            real_slopes @ feature_prediction.smooth_covariance @ real_slopes.transpose(0, 2, 1)
            + omitted_covariance
        )
        shared_errors = np.concatenate(
            [predictions[..., None] * self.baseline_changes.all_changes, common_errors], axis=2
        )
        covariance += shared_errors @ shared_errors.transpose(0, 2, 1) + independent_variances[
            :, :, None
        ] * np.eye(len(self.rows))
        predictions = np.where(self.is_predictable, predictions, np.nan)
        return MeasurementPrediction(
            predictions, covariance, np.concatenate(load_change_blocks, axis=2), self.is_predictable
        )

    def _estimate_omitted_harmonics(
        self,
        first_harmonic: Feature,
        mean_squares: np.ndarray,
        damping_ratios: np.ndarray,
        scale_and_frequencies: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Estimate the harmonics that not all cases have, as far as modes resonate there.

        Harmonics of the contact force fall like 1 / k. They act on modes with static compliances 1
        / w_j^2: |U_k|^2 = c^2 sum_j |w_j^2 - (k W)^2 + 2 i z w_j k W|^-2 / k^2. Here c^2 is the
        mean over the upper half of the known harmonics. For 150 cracks under loads of 120 to 1500
        Hz, what twelve and six of 30 harmonics omit is 1.0 and 1.3 times this, in root mean square.

        Parameters
        ----------
        first_harmonic : Feature
            First harmonic of a point.
        mean_squares : (m, K) [m^2]
            Mean squares of its known harmonics.
        damping_ratios : (m, 1)
        scale_and_frequencies : (m, 1, 1 + 2 modes)

        Returns
        -------
        (k,)
            Omitted orders.
        (m, k) [m^2]
            Mean squares of these harmonics.
        """
        n_kept = self.model.coarse_cases.count_harmonics(first_harmonic.load_frequency)
        highest_frequency = self._highest_frequency
        n_kept = min(n_kept, mean_squares.shape[1])
        n_harmonics = min(
            max(2 * n_kept, math.ceil(highest_frequency / first_harmonic.load_frequency)),
            MAX_HARMONIC_ORDER,
        )
        harmonic_features = [
            replace(first_harmonic, harmonic_order=harmonic_order)
            for harmonic_order in range(1, n_harmonics + 1)
        ]
        squared_compliances = (
            np.nan_to_num(scale_and_frequencies[..., KEPT_MODE_NUMBERS], nan=np.inf) ** -4.0
        )
        relative_squares = np.sum(
            squared_compliances
            / np.abs(
                compute_ratios_and_poles(harmonic_features, damping_ratios, scale_and_frequencies)[
                    1
                ]
            )
            ** 2,
            axis=2,
        )
        relative_squares /= np.arange(1.0, n_harmonics + 1.0) ** 2
        upper_half = slice(n_kept // 2, n_kept)
        with np.errstate(divide="ignore", invalid="ignore"):
            force_squares = np.nan_to_num(
                np.mean(mean_squares[:, upper_half] / relative_squares[:, upper_half], axis=1)
            )
        return np.arange(n_kept + 1, n_harmonics + 1), force_squares[:, None] * relative_squares[
            :, n_kept:
        ]

    def _predict_all_but_displacements(
        self,
        damping_ratios: np.ndarray,
        feature_values: np.ndarray,
        smoothing_factors: np.ndarray,
        face_state: CrackFaceState,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Predict all measurements but displacements, with errors of the state of the crack faces.

        Returns
        -------
        values : (m, q)
        complex_slopes : (m, q, f)
            Slopes t by the smooth forms S: the change of a value is Re sum t dS.
        common_errors : (m, q, 1 + modes)
            Errors that are common to all resonances, and to each mode.
        independent_variances : (m, q)
        """
        is_natural_frequency = np.array(
            [feature.is_natural_frequency for feature in self._features]
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            feature_sizes = np.where(
                is_natural_frequency,
                np.exp(np.where(is_natural_frequency, feature_values.real, 0.0)),
                np.abs(feature_values),
            )
            size_slopes = (
                np.where(
                    np.abs(feature_values) > 0.0,
                    np.conj(feature_values) / np.abs(feature_values),
                    1.0,
                )
                / smoothing_factors
            )
        size_slopes = np.where(is_natural_frequency, feature_sizes / smoothing_factors, size_slopes)
        predictions, independent_variances = np.zeros((2, len(feature_values), len(self.rows)))
        common_errors = np.zeros((*predictions.shape, 1 + N_LOWEST_MODES))
        complex_slopes = np.zeros((*predictions.shape, len(self._features)), dtype=complex)
        identify_table = self.model.identify_table
        resonance_deviation = self.model.identify_table.resonance_deviation
        for row_index, (row, feature_indices) in enumerate(
            zip(self.rows, self._feature_indices_by_row, strict=True)
        ):
            if row.quantity == "displacement" or not self.is_predictable[row_index]:
                continue
            row_face_state = (
                BREATHING_FACES if row.rpm == 0.0 and self._is_free_at_rest else face_state
            )
            state_index = (
                RESONANCE_STATES.index(row_face_state.resonance_state) if row.resonance else 0
            )
            predictions[:, row_index], row_size_slopes = _combine_features(
                row, feature_sizes[:, feature_indices], state_index
            )
            complex_slopes[:, row_index, feature_indices] = (
                row_size_slopes * size_slopes[:, feature_indices]
            )
            if row.resonance:
                _, open_frequencies, bonded_frequencies = feature_sizes[:, feature_indices].T
                frequency_split = bonded_frequencies - open_frequencies
                damping_shift = predictions[:, row_index] * damping_ratios[:, 0] ** 2
                common_errors[:, row_index, 0] = row_face_state.common_deviation * frequency_split
                mode_deviation = (
                    identify_table.first_resonance_deviation
                    if row.mode == 1
                    else resonance_deviation
                )
                common_errors[:, row_index, row.mode] = (
                    (state_index == 0) * mode_deviation * frequency_split
                )
                independent_variances[:, row_index] = (
                    row_face_state.independent_deviation * frequency_split
                ) ** 2 + damping_shift**2
        for row_face_state, uncracked_index in zip(
            self._cracked_indices, self._uncracked_indices, strict=True
        ):
            complex_slopes[:, :, uncracked_index] += (
                complex_slopes[:, :, row_face_state] * smoothing_factors[:, None, row_face_state]
            )
        return predictions, complex_slopes, common_errors, independent_variances

    def _collect_feature_errors(
        self,
        smooth_features: np.ndarray,
        remaining_mesh_errors: np.ndarray,
        interpolation_errors: list[np.ndarray],
    ) -> np.ndarray:
        """Collect independent errors of the smooth forms: (m, 2f, r).

        Half of each variance is common to several forms.

        Parameters
        ----------
        smooth_features : (m, 2f)
            Smooth forms as pairs of columns.
        remaining_mesh_errors : (m, 2f)
            Remaining errors of the mesh.
        interpolation_errors : list of (m, k, 2f)
            Errors at the nodes around, for each sweep.
        """
        half_root = np.sqrt(0.5)
        all_errors = np.concatenate(interpolation_errors, axis=1)
        identity_matrix = np.eye(smooth_features.shape[1])
        error_blocks = [
            half_root * all_errors.transpose(0, 2, 1),
            half_root * np.sqrt(np.sum(all_errors**2, axis=1))[:, None, :] * identity_matrix,
            half_root * remaining_mesh_errors[..., None],
            half_root * remaining_mesh_errors[..., None] * self._error_groups,
        ]
        harmonic_deviation = self.model.identify_table.harmonic_deviation
        if harmonic_deviation:
            order_excess = np.repeat(
                [max(feature.harmonic_order - 1, 0) for feature in self._features], 2
            )
            rotated_features = np.stack(
                [-smooth_features[:, 1::2], smooth_features[:, ::2]], axis=2
            ).reshape(smooth_features.shape)
            feature_columns = np.kron(np.eye(len(self._features)), np.ones((2, 1)))
            for feature_part in (smooth_features, rotated_features):
                contact_errors = harmonic_deviation * (feature_part * order_excess)[..., None]
                error_blocks += [
                    half_root * contact_errors * self._error_groups,
                    half_root * contact_errors * feature_columns,
                ]
        return np.concatenate(error_blocks, axis=2)


def _find_motionless_nodes(
    solved_cases: SolvedCases, features: Sequence[Feature], load_indices: Sequence[int]
) -> tuple[list[np.ndarray], np.ndarray]:
    """Find nodes at which the crack faces neither touch nor part under a load.

    Only loads with both kinds of nodes count.

    Returns
    -------
    harmonic_masks : list of (f,) bool
        Higher harmonics of each such load.
    motionless_grids : (..., n)
        1 at nodes without these harmonics, on the grid; empty without such loads.
    """
    harmonic_masks, motionless_grids = [], []
    is_higher_harmonic = np.array([feature.harmonic_order > 1 for feature in features], dtype=bool)
    for load_index in np.unique(np.array(load_indices)[is_higher_harmonic]):
        is_group_member = is_higher_harmonic & (np.array(load_indices) == load_index)
        group_values = [
            features[feature_index].get_node_values(solved_cases)
            for feature_index in np.flatnonzero(is_group_member)
        ]
        largest_amplitudes = np.fmax.reduce(np.abs(group_values))
        is_motionless = largest_amplitudes <= 1e-9 * np.fmax.reduce(largest_amplitudes)  # rounding
        if is_motionless.any() and not is_motionless.all():
            harmonic_masks.append(is_group_member)
            motionless_grids.append(is_motionless.reshape(solved_cases.unknown_grid.shape))
    return harmonic_masks, np.moveaxis(
        np.array(motionless_grids, dtype=float), 0, -1
    ) if harmonic_masks else np.zeros(0)


def _build_error_groups(features: Sequence[Feature]) -> np.ndarray:
    """Return groups of columns with a common mesh error: (2f, groups).

    A member has 1, others 0.
    """
    group_keys = list(dict.fromkeys(feature.error_group for feature in features))
    group_memberships = [
        [float(feature.error_group == group_key) for group_key in group_keys]
        for feature in features
    ]
    return np.repeat(group_memberships, 2, axis=0)


def _split_complex_columns(complex_columns: np.ndarray) -> np.ndarray:
    """Split complex columns (..., f) into alternating real and imaginary ones (..., 2f)."""
    return np.stack([complex_columns.real, complex_columns.imag], axis=-1).reshape(
        *complex_columns.shape[:-1], -1
    )


def _list_face_states(model: ForwardModel) -> tuple[CrackFaceState, ...]:
    """List possible states of the crack faces at resonances, with weights that sum to 1.

    The faces breathe. If the motion's shape depends on the load's size, they breathe for any part
    of the period. They may stay open if any solved case is ever open, and closed if any is ever
    closed.
    """
    if has_load_independent_shape(model.scene):
        return (BREATHING_FACES,)
    resonance_deviation = model.identify_table.resonance_deviation
    closed_shares = model.coarse_cases.sweep_result["closed_share"][model.coarse_cases.word_index]
    min_closed_share, max_closed_share = (
        ufunc.reduce(closed_shares, axis=None) for ufunc in (np.fmin, np.fmax)
    )
    held_states = itertools.compress(
        (CrackFaceState("open"), CrackFaceState("tied")),
        (min_closed_share < 1.0, max_closed_share > 0.0),
    )
    # Breathing for another part of the period at each resonance, or for the same at all.
    partly_open_states = (
        CrackFaceState("bilinear", independent_deviation=resonance_deviation, prior_weight=0.5),
        CrackFaceState("bilinear", common_deviation=resonance_deviation, prior_weight=0.5),
    )
    face_states = (*partly_open_states, BREATHING_FACES, *held_states)
    total_weight = sum(face_state.prior_weight for face_state in face_states)
    return tuple(
        face_state._replace(prior_weight=face_state.prior_weight / total_weight)
        for face_state in face_states
    )


def has_load_independent_shape(scene: Scene) -> bool:
    """Return True if a motion's shape does not depend on the load's size."""
    return is_response_proportional_to_load(scene) and not any(scene.excitation.force_mean)


def _combine_features(
    measurement: Measurement, feature_sizes: np.ndarray, state_index: int
) -> tuple[np.ndarray, np.ndarray]:
    """Combine feature sizes (m, k) to a measured quantity.

    Returns the quantity (m,) and its slopes (m, k) by the sizes. A resonance is near the frequency
    with the state's index.
    """
    if measurement.natural or feature_sizes.shape[1] == 1:
        return feature_sizes[:, state_index], np.eye(1, feature_sizes.shape[1], state_index).repeat(
            len(feature_sizes), axis=0
        )
    numerators, denominators = feature_sizes.T
    return numerators / denominators, np.column_stack(
        [1.0 / denominators, -numerators / denominators**2]
    )
