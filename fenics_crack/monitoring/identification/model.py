"""The forward model: natural frequencies and harmonics from the unknowns, and their covariance.

Prediction errors are correlated, since one sweep makes all predictions. Their covariance is a sum
of four. The interpolation covariance comes from leave-one-out errors in all quantities together.
The mesh covariance comes from the changes by a finer mesh, with half of the variance common to all
quantities. The contact covariance is a relative error of higher harmonics
(``identify.harmonic_deviation``). The last covariance comes from the priors
(:mod:`fenics_crack.monitoring.identification.nuisance`).

Shapes: m points x of d unknowns, q measurements, f features. A feature is an interpolated natural
frequency or harmonic (:class:`fenics_crack.monitoring.identification.interpolation.Feature`). Its
smooth form, a function of the unknowns without kinks and poles, is the feature times a factor.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from fenics_crack.monitoring.identification.interpolation import (
    Feature,
    Interpolation,
    SolvedCases,
    compute_smoothing_factors,
)
from fenics_crack.monitoring.identification.nuisance import (
    CRACK_SIZE_KEYS,
    UncrackedPlate,
    compute_crack_geometry_deviations,
)
from fenics_crack.scene.scene import Scene
from fenics_crack.study.key_figures import is_response_proportional_to_load


class ForwardModel:
    """Forward model: solved cases on a grid of the unknowns, and the plate's priors.

    It predicts measurements from the unknowns. The priors are the standard deviations in
    ``[identify]`` for uncertain properties of the plate.

    Parameters
    ----------
    scene : Scene
        Scene with the damping and the table ``[identify]``.
    uncracked_plate : UncrackedPlate
        Plate without its crack.
    coarse_finer_halfway_cases : three SolvedCases or None
        In this order: all cases, on the coarse mesh; a few cases on a finer mesh, which give the
        mesh error; a few cases halfway between grid values, which give the interpolation error. The
        last two may be None.
    text_value_by_unknown_key : dict of str to object
        Chosen value by key of each unknown with text values, such as "left" for crack.edge.
    """

    def __init__(
        self,
        scene: Scene,
        uncracked_plate: UncrackedPlate,
        coarse_finer_halfway_cases: Sequence[SolvedCases | None],
        *,
        text_value_by_unknown_key: Mapping[str, Any],
    ) -> None:
        self.scene = scene
        self.identify_table = scene.given("identify")
        self.uncracked_plate = uncracked_plate
        coarse_mesh_cases, self.finer_mesh_cases, self.halfway_cases = coarse_finer_halfway_cases
        assert coarse_mesh_cases is not None
        self.coarse_mesh_cases = coarse_mesh_cases
        self.text_value_by_unknown_key = dict(text_value_by_unknown_key)
        self.unknown_keys = coarse_mesh_cases.unknown_keys
        self.grid_of_solved_cases = coarse_mesh_cases.grid_of_solved_cases

    def get_damping_ratio_of_points(self, x: np.ndarray) -> np.ndarray:
        """Return the damping ratio at m values x (m, d) of the unknowns: (m, 1).

        If ``damping.ratio`` is an unknown, the ratios are a column of x. Otherwise all points have
        the scene's ``damping.ratio``, or the mean of ``damping.ratios``. Without both keys the
        ratio is 0.01.
        """
        if "damping.ratio" in self.unknown_keys:
            return x[:, [self.unknown_keys.index("damping.ratio")]]
        scene_damping_ratios, damping_table = None, self.scene.damping
        if damping_table is not None:
            scene_damping_ratios = (
                damping_table.ratios if damping_table.ratio is None else damping_table.ratio
            )
        return np.full(
            (len(x), 1), 0.01 if scene_damping_ratios is None else np.mean(scene_damping_ratios)
        )  # 0.01 if the damping is given as a matrix

    def compute_crack_sizes_relative_to_largest(self, x: np.ndarray) -> np.ndarray:
        """Return crack sizes at m values x (m, d) of the unknowns, 1 for the largest: (m,).

        If crack length or depth is an unknown, the size is the unknown over its upper bound. If
        both are unknowns, the size is the product of both ratios. If neither is an unknown, the
        size is 1.
        """
        size_unknown_indices = [
            unknown_index
            for unknown_index, key in enumerate(self.unknown_keys)
            if key in CRACK_SIZE_KEYS
        ]
        return np.asarray(
            np.prod(
                x[:, size_unknown_indices]
                / self.grid_of_solved_cases.upper_bounds[size_unknown_indices],
                axis=1,
            )
        )

    def compute_crack_geometry_deviations(self, x: np.ndarray) -> np.ndarray:
        """Return standard deviations of a real crack about its equivalent crack: (m, d).

        The equivalent crack is straight and sharp, and has the same effect on vibration. The model
        predicts vibration of equivalent cracks. The deviations are added to the uncertainty of the
        unknowns. ``x`` (m, d) are m points, each with values of the d unknowns; the result has
        their units.
        """
        return compute_crack_geometry_deviations(x, self.unknown_keys, self.scene)


class FeaturePrediction(NamedTuple):
    """Prediction of f features at m values of the unknowns.

    A feature is a natural frequency or a harmonic. Its smooth form is feature times smoothing
    factor; a smooth form is interpolated without kinks and poles.

    Attributes
    ----------
    damping_ratio_of_points : (m, 1)
        Damping ratios.
    frequency_drop_root_and_frequencies : (m, f, 1 + 2 modes)
        :attr:`SolvedCases.frequency_drop_root_and_frequencies` at the load of each feature.
    feature_to_smooth_form_factors : (m, f)
        Smoothing factors (:func:`compute_smoothing_factors`).
    feature_values : (m, f)
        Logarithms of natural frequencies [Hz], and complex harmonics [m].
    interpolation_variances : (m, f)
        Variances of the features due to interpolation.
    smooth_form_covariance : (m, 2f, 2f)
        Covariance of the smooth forms; real and imaginary parts alternate.
    """

    damping_ratio_of_points: np.ndarray
    frequency_drop_root_and_frequencies: np.ndarray
    feature_to_smooth_form_factors: np.ndarray
    feature_values: np.ndarray
    interpolation_variances: np.ndarray
    smooth_form_covariance: np.ndarray


class FeaturePredictor:
    """Predictor of natural frequencies and harmonics (features), with their covariance.

    Attributes
    ----------
    features : tuple of Feature
        f features: first the requested features. Then, for each natural frequency with the crack,
        the frequency of the same mode without the crack.
    is_feature_predictable : (f,) bool
        True for a feature that the solved cases can predict.
    cracked_frequency_feature_indices : list of int
        Indices of the natural frequencies with the crack.
    uncracked_frequency_feature_indices : list of int
        For each of ``cracked_frequency_feature_indices``, index of the same mode's frequency
        without the crack.
    solved_load_index_per_feature : list of int
        For each feature, index of its load among the solved loads.
    """

    def __init__(self, model: ForwardModel, features: Sequence[Feature]) -> None:
        uncracked_features = [
            feature.uncracked_frequency_feature
            for feature in features
            if feature.is_cracked_frequency
        ]
        self.model = model
        self.features = tuple(dict.fromkeys([*features, *uncracked_features]))
        self.cracked_frequency_feature_indices = [
            feature_index
            for feature_index, feature in enumerate(self.features)
            if feature.is_cracked_frequency
        ]
        self.uncracked_frequency_feature_indices = [
            self.features.index(self.features[cracked_feature_index].uncracked_frequency_feature)
            for cracked_feature_index in self.cracked_frequency_feature_indices
        ]
        coarse_mesh_cases = model.coarse_mesh_cases
        self.solved_load_index_per_feature = [
            coarse_mesh_cases.find_load_index(feature.load_frequency) for feature in self.features
        ]
        self._error_group_matrix = _build_error_group_matrix(self.features)
        self._mode_prior_sensitivities = np.stack(
            [
                model.uncracked_plate.compute_prior_sensitivities(speed_ratio)
                for speed_ratio in coarse_mesh_cases.swept_loads.rotor_speed_ratios
            ]
        )[self.solved_load_index_per_feature]
        split_and_frequencies_at_nodes = coarse_mesh_cases.frequency_drop_root_and_frequencies
        self._frequency_drop_interpolation = Interpolation(
            model.grid_of_solved_cases,
            split_and_frequencies_at_nodes.reshape(len(split_and_frequencies_at_nodes), -1),
        )
        self._coarse_mesh_interpolation = Interpolation(
            model.grid_of_solved_cases, self._evaluate_smooth_features(coarse_mesh_cases)
        )
        self._interpolation_error_factors = self._estimate_interpolation_error_factors()
        interpolations_of_meshes = [self._coarse_mesh_interpolation]
        # If elements smaller by a factor f change a quantity by d, an error of first order leaves
        # d / (f - 1), an error of high order nothing. The mean is added, and is the deviation, too.
        mesh_ratio = model.identify_table.finer
        self._remaining_error_per_mesh_difference = 0.5 / max(
            mesh_ratio - 1.0, 1.0 / mesh_ratio - 1.0, 0.1
        )
        self._mesh_correction: Interpolation | None = None
        if model.finer_mesh_cases is not None:
            grid_of_finer_mesh_cases = model.finer_mesh_cases.grid_of_solved_cases
            mesh_difference = self._evaluate_smooth_features(
                model.finer_mesh_cases
            ) - self._coarse_mesh_interpolation.interpolate(grid_of_finer_mesh_cases.nodes)
            self._mesh_correction = Interpolation(grid_of_finer_mesh_cases, mesh_difference)
            interpolations_of_meshes.append(self._mesh_correction)
        is_frequency_column = np.repeat(
            [feature.is_natural_frequency for feature in self.features], 2
        )
        predictable_column_masks = [
            mesh_interpolation.has_enough_known_nodes
            & (mesh_interpolation.are_failed_cases_between_known | is_frequency_column)
            for mesh_interpolation in interpolations_of_meshes
        ]
        self.is_feature_predictable = (
            np.all(predictable_column_masks, axis=0).reshape(-1, 2).all(axis=1)
        )
        self.is_feature_predictable[self.cracked_frequency_feature_indices] &= (
            self.is_feature_predictable[self.uncracked_frequency_feature_indices]
        )

    def __call__(self, x: np.ndarray) -> FeaturePrediction:
        """Predict natural frequencies and harmonics at values x (m, d) of the unknowns.

        The covariance has the errors by interpolation, mesh, contact and priors.
        """
        smooth_features = self._coarse_mesh_interpolation.interpolate(x)
        interpolation_errors = (
            self._interpolation_error_factors
            * self._coarse_mesh_interpolation.list_weighted_node_errors(x)
        )
        remaining_mesh_errors = np.zeros_like(smooth_features)
        if self._mesh_correction is not None:
            mesh_difference = self._mesh_correction.interpolate(x)
            remaining_mesh_errors = self._remaining_error_per_mesh_difference * mesh_difference
            smooth_features = smooth_features + mesh_difference + remaining_mesh_errors
            interpolation_errors = np.concatenate(
                [interpolation_errors, self._mesh_correction.list_weighted_node_errors(x)], axis=1
            )
        damping_ratio_of_points = self.model.get_damping_ratio_of_points(x)
        frequency_drop_root_and_frequencies = self._interpolate_frequency_split_and_frequencies(x)
        feature_to_smooth_form_factors = self._compute_smoothing_factors(
            x, frequency_drop_root_and_frequencies
        )
        feature_values = (
            smooth_features[:, ::2] + 1j * smooth_features[:, 1::2]
        ) / feature_to_smooth_form_factors
        prior_sensitivities = self.model.uncracked_plate.compute_feature_sensitivities(
            self.features,
            damping_ratio_of_points,
            frequency_drop_root_and_frequencies,
            self._mode_prior_sensitivities,
        )
        is_uncracked_feature = np.array(
            [feature.crack_state == "uncracked" for feature in self.features]
        )
        prior_errors = (
            prior_sensitivities
            * np.where(is_uncracked_feature, 1.0, feature_values * feature_to_smooth_form_factors)[
                ..., None
            ]
        )
        feature_values[:, self.cracked_frequency_feature_indices] += feature_values[
            :, self.uncracked_frequency_feature_indices
        ]
        squared_interpolation_errors = np.sum(interpolation_errors**2, axis=1)
        independent_error_columns = np.concatenate(
            [
                *_split_into_common_and_single_errors(interpolation_errors),
                *self._list_mesh_and_contact_errors(smooth_features, remaining_mesh_errors),
                split_complex_columns(prior_errors.transpose(0, 2, 1)).transpose(0, 2, 1),
            ],
            axis=2,
        )
        return FeaturePrediction(
            damping_ratio_of_points,
            frequency_drop_root_and_frequencies,
            feature_to_smooth_form_factors,
            feature_values,
            (squared_interpolation_errors[:, ::2] + squared_interpolation_errors[:, 1::2])
            / np.abs(feature_to_smooth_form_factors) ** 2,
            independent_error_columns @ independent_error_columns.transpose(0, 2, 1),
        )

    def interpolation_covariances_per_unknown(self, x: np.ndarray) -> list[np.ndarray]:
        """Return covariances due to interpolation, an array (m, 2f, 2f) for each unknown.

        Each covariance belongs to the smooth forms of f features (:class:`FeaturePrediction`). The
        error is due to interpolation along this unknown alone. ``x`` (m, d) has m values of the
        unknowns.
        """
        covariances = []
        for (
            node_errors_along_axis
        ) in self._coarse_mesh_interpolation.list_weighted_node_errors_along_axes(x)[: x.shape[1]]:
            independent_error_columns = np.concatenate(
                _split_into_common_and_single_errors(
                    self._interpolation_error_factors * node_errors_along_axis
                ),
                axis=2,
            )
            covariances.append(
                independent_error_columns @ independent_error_columns.transpose(0, 2, 1)
            )
        return covariances

    def _evaluate_smooth_features(self, solved_cases: SolvedCases) -> np.ndarray:
        """Return smooth forms of all f features at n grid nodes of solved cases: (n, 2f).

        Features are natural frequencies and harmonics. A smooth form is feature times factor
        (:func:`compute_smoothing_factors`). For a natural frequency with the crack, the feature
        here is the change of ln(frequency) by the crack. Real and imaginary parts alternate.
        """
        feature_values = np.stack(
            [feature.get_node_values(solved_cases) for feature in self.features], axis=1
        )
        feature_values[:, self.cracked_frequency_feature_indices] -= feature_values[
            :, self.uncracked_frequency_feature_indices
        ]
        return split_complex_columns(
            feature_values
            * self._compute_smoothing_factors(
                solved_cases.grid_of_solved_cases.nodes,
                self._interpolate_frequency_split_and_frequencies(
                    solved_cases.grid_of_solved_cases.nodes
                ),
            )
        )

    def _estimate_interpolation_error_factors(self) -> np.ndarray:
        """Return factors (>= 1) that enlarge the estimated interpolation errors: (2f,).

        Cases halfway between grid nodes show the real error of each of f features. The factor is
        the real root-mean-square error over the estimate there. Without halfway cases all factors
        are 1. The estimate is too small for a feature with more waves along an unknown than grid
        nodes. An example is a high mode over the height of the crack.
        """
        halfway_cases = self.model.halfway_cases
        if halfway_cases is None:
            return np.ones(2 * len(self.features))
        x = halfway_cases.grid_of_solved_cases.nodes
        squared_errors = (
            self._evaluate_smooth_features(halfway_cases)
            - self._coarse_mesh_interpolation.interpolate(x)
        ) ** 2
        estimated_interpolation_variances = np.sum(
            self._coarse_mesh_interpolation.list_weighted_node_errors(x) ** 2, axis=1
        )
        error_and_variance_sums = [
            np.nansum(squared_errors_or_variances, axis=0).reshape(-1, 2).sum(axis=1)
            for squared_errors_or_variances in (squared_errors, estimated_interpolation_variances)
        ]
        with np.errstate(divide="ignore", invalid="ignore"):
            variance_ratios = np.where(
                error_and_variance_sums[1] > 0.0,
                error_and_variance_sums[0] / error_and_variance_sums[1],
                1.0,
            )
        return np.repeat(np.sqrt(np.maximum(variance_ratios, 1.0)), 2)

    def _compute_smoothing_factors(
        self, x: np.ndarray, frequency_drop_root_and_frequencies: np.ndarray
    ) -> np.ndarray:
        """Return the factors that make f features smooth: (m, f).

        The function :func:`compute_smoothing_factors` is called with the damping and crack sizes of
        this model.

        Parameters
        ----------
        x : (m, d)
            m points, each with values of the d unknowns.
        frequency_drop_root_and_frequencies : (m, f, 1 + 2 modes)
            :attr:`SolvedCases.frequency_drop_root_and_frequencies` at the load of each feature.
            They are from the coarse mesh, also to smooth results on the finer mesh: both meshes
            then have the same factors.
        """
        return compute_smoothing_factors(
            self.features,
            self.model.get_damping_ratio_of_points(x),
            frequency_drop_root_and_frequencies,
            self.model.compute_crack_sizes_relative_to_largest(x),
        )

    def _interpolate_frequency_split_and_frequencies(self, x: np.ndarray) -> np.ndarray:
        """Interpolate the split and the frequencies for poles of harmonics: (m, f, 1 + 2 modes).

        They are :attr:`SolvedCases.frequency_drop_root_and_frequencies` at the load of each of f
        features. ``x`` (m, d) has m values of the unknowns. Quantities without enough solved cases
        are nan.
        """
        frequency_drop_root_and_frequencies = np.where(
            self._frequency_drop_interpolation.has_enough_known_nodes,
            self._frequency_drop_interpolation.interpolate(x),
            np.nan,
        )
        return frequency_drop_root_and_frequencies.reshape(
            len(x), *self.model.coarse_mesh_cases.frequency_drop_root_and_frequencies.shape[1:]
        )[:, self.solved_load_index_per_feature]

    def _list_mesh_and_contact_errors(
        self, smooth_features: np.ndarray, remaining_mesh_errors: np.ndarray
    ) -> list[np.ndarray]:
        """List independent errors of smooth forms by mesh and contact.

        Half of the mesh variance is an error common to all features. The second half is common to
        the features of a group (:attr:`Feature.error_group_key`). The contact model causes a
        relative error of harmonic k, with the standard deviation (k - 1) times
        ``identify.harmonic_deviation``. Half of its variance is common to a group, the second half
        belongs to a single harmonic.

        Parameters
        ----------
        smooth_features : (m, 2f)
            Smooth forms of f features (:class:`FeaturePrediction`) at m values of the unknowns.
            Real and imaginary parts alternate.
        remaining_mesh_errors : (m, 2f)
            Mesh errors of the smooth forms after the mesh correction.

        Returns
        -------
        list of (m, 2f, r)
            Each of the r columns is an independent error, with one standard deviation of each
            smooth form. r differs between the arrays.
        """
        root_of_half = np.sqrt(0.5)
        error_blocks = [
            root_of_half * remaining_mesh_errors[..., None],
            root_of_half * remaining_mesh_errors[..., None] * self._error_group_matrix,
        ]
        harmonic_deviation = self.model.identify_table.harmonic_deviation
        if harmonic_deviation:
            harmonic_order_minus_one = np.repeat(
                [max(feature.harmonic_order - 1, 0) for feature in self.features], 2
            )
            rotated_features = np.stack(
                [-smooth_features[:, 1::2], smooth_features[:, ::2]], axis=2
            ).reshape(smooth_features.shape)
            feature_of_real_and_imaginary_part = np.kron(
                np.eye(len(self.features)), np.ones((2, 1))
            )
            for original_or_rotated_features in (smooth_features, rotated_features):
                contact_errors = (
                    harmonic_deviation
                    * (original_or_rotated_features * harmonic_order_minus_one)[..., None]
                )
                error_blocks += [
                    root_of_half * contact_errors * self._error_group_matrix,
                    root_of_half * contact_errors * feature_of_real_and_imaginary_part,
                ]
        return error_blocks


def _split_into_common_and_single_errors(errors: np.ndarray) -> list[np.ndarray]:
    """Split the variance of errors into a correlated half and an independent half.

    ``errors`` (m, k, 2f) has k independent errors of 2f smooth forms (:class:`FeaturePrediction`),
    at m values of the unknowns.

    Returns
    -------
    common_errors : (m, 2f, k)
        Correlated half. Each of the k columns changes all smooth forms together.
    single_errors : (m, 2f, 2f)
        Independent half. Each column changes one smooth form alone.

    Both are returned in a list.
    """
    return [
        np.sqrt(0.5) * errors.transpose(0, 2, 1),
        np.sqrt(0.5 * np.sum(errors**2, axis=1))[:, None, :] * np.eye(errors.shape[2]),
    ]


def _build_error_group_matrix(features: Sequence[Feature]) -> np.ndarray:
    """Return the membership of features in groups with a common mesh error: (2f, groups).

    Each of the f features, a natural frequency or a harmonic, has two equal rows: for its real and
    its imaginary part. An entry is 1 if the feature is in the group
    (:attr:`Feature.error_group_key`), otherwise 0.
    """
    group_keys = list(dict.fromkeys(feature.error_group_key for feature in features))
    group_memberships = [
        [float(feature.error_group_key == group_key) for group_key in group_keys]
        for feature in features
    ]
    return np.repeat(group_memberships, 2, axis=0)


def split_complex_columns(complex_columns: np.ndarray) -> np.ndarray:
    """Split complex columns (..., f) into real and imaginary ones in turn: (..., 2f)."""
    return np.stack([complex_columns.real, complex_columns.imag], axis=-1).reshape(
        *complex_columns.shape[:-1], -1
    )


def has_load_independent_motion_shape(scene: Scene) -> bool:
    """Return True if the motion is proportional to the load's size.

    This holds for unilateral contact without rotation, clearance, preload and steady load
    (``excitation.force_mean``).
    """
    return is_response_proportional_to_load(scene) and not any(scene.excitation.force_mean)
