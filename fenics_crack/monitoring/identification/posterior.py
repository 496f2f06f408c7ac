"""Posterior of the unknowns: maxima of the likelihood by least squares, and values on a grid.

Measured numbers m with standard deviations e are compared with predictions s(x), whose own errors
have a covariance T(x):

    log L(x) = - (m - s)^T V^-1 (m - s) / 2 - log(det V) / 2,    V(x) = diag(e^2) + T(x)

Since det V is at least det diag(e^2), both terms are squares, and least squares find the maxima. If
a crack may breathe or not, L is the sum over both, each with its probability
(:meth:`fenics_crack.monitoring.identification.predictor.MeasurementPredictor.iterate_face_state_predictions`).

The prior is uniform between the bounds. A crack differs from the equivalent straight and sharp
crack. L is convolved on the grid with the distribution of the difference
(:func:`fenics_crack.monitoring.identification.nuisance.compute_crack_geometry_deviations`).
Regions hold a share of the posterior's mass, the densest parts first. The integral of L over the
prior is the evidence of a hypothesis (D. J. C. MacKay, Information Theory, Inference, and Learning
Algorithms, 2003, chapter 28).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import product
from typing import Any

import numpy as np
from scipy.integrate import trapezoid
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import label, maximum_filter
from scipy.optimize import least_squares
from scipy.special import chdtrc, logsumexp

from fenics_crack.monitoring.identification.interpolation import UnknownGrid
from fenics_crack.monitoring.identification.options import IDENTIFICATION_VALUES
from fenics_crack.monitoring.identification.predictor import (
    MeasurementPredictions,
    MeasurementPredictor,
)

FIRST_GRID_COUNT_BY_DIMENSION = {1: 200, 2: 45, 3: 17}
"""Values per unknown in the posterior's first grid, by number of unknowns; else 9."""
REFINED_GRID_COUNT_BY_DIMENSION = {1: 101, 2: 31, 3: 13}
"""Values per unknown added around an optimum, by number of unknowns; else 7."""


def add_uniform_prior_information(fisher_information: np.ndarray) -> np.ndarray:
    """Add the information of a uniform prior to the Fisher information (d, d).

    The unknowns are divided by their ranges; a uniform distribution on (0, 1) has variance 1/12,
    which adds 12 on the diagonal.
    """
    return np.asarray(
        fisher_information + 12.0 * np.eye(len(fisher_information))
    )  # 1 / variance of a uniform


@dataclass(frozen=True)
class Likelihood:
    """Likelihood L of the unknowns, given q measurements.

    Attributes
    ----------
    measurement_values, measurement_deviations : (q,)
        Measured values, and their standard deviations.
    predictor : MeasurementPredictor
        Predictor of the measurements.
    """

    measurement_values: np.ndarray
    measurement_deviations: np.ndarray
    predictor: MeasurementPredictor

    def compute_residuals(self, x: np.ndarray) -> np.ndarray:
        """Return residuals at m values x (m, d) of the unknowns: (m, q + 1).

        The sum of their squares is -2 times the log-likelihood, up to a constant.

        Measured values y have standard deviations e; predictions are s. The covariance of
        measurements and predictions together is V = diag(e) C C^T diag(e), with a lower triangular
        C. The first q residuals are C^-1 ((y - s) / e); their squares sum to chi^2. The last
        residual is the root of log(det(C C^T) / p^2). Here p is the probability of the motion of
        the crack faces: breathing, open or closed. At each value of the unknowns, the motion with
        the smallest sum of squares is taken.
        """
        residual_rows = np.full((len(x), len(self.measurement_values) + 1), np.inf)
        for point_indices, state_residuals, _ in self._yield_residuals_per_face_state(x):
            is_more_probable = np.sum(state_residuals**2, axis=1) < np.sum(
                residual_rows[point_indices] ** 2, axis=1
            )
            residual_rows[point_indices[is_more_probable]] = state_residuals[is_more_probable]
        return residual_rows

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Return the log-likelihood at m values x (m, d) of the unknowns: (m,).

        An additive constant is left out.
        """
        log_likelihoods = np.full(len(x), -np.inf)
        for point_indices, state_residuals, _ in self._yield_residuals_per_face_state(x):
            log_likelihoods[point_indices] = np.logaddexp(
                log_likelihoods[point_indices], -0.5 * np.sum(state_residuals**2, axis=1)
            )
        return log_likelihoods

    def predict_for_likeliest_face_state(self, x: np.ndarray) -> MeasurementPredictions:
        """Return predictions at values x (d,) of the unknowns.

        The predictions are for the most probable motion of the crack faces: breathing, open or
        closed.
        """
        states_with_residuals = self._yield_residuals_per_face_state(x[None])
        return min(
            states_with_residuals,
            key=lambda indices_residuals_prediction: np.sum(indices_residuals_prediction[1] ** 2),
        )[2]

    def _yield_residuals_per_face_state(
        self, x: np.ndarray
    ) -> Iterator[tuple[np.ndarray, np.ndarray, MeasurementPredictions]]:
        """Yield residuals for each possible motion of the crack faces.

        ``x`` (m, d) are m values of the unknowns.

        Yields
        ------
        point_indices : (n,)
            Indices in x for which the motion is possible.
        residuals : (n, q + 1)
            Residuals of q measurements at these values; then the residual of the determinant
            (:meth:`compute_residuals`).
        prediction : MeasurementPredictions
            Predictions at these values.
        """
        for (
            point_indices,
            probabilities,
            prediction,
        ) in self.predictor.iterate_face_state_predictions(x):
            cholesky_factor = np.linalg.cholesky(
                compute_scaled_covariance(
                    prediction, self.measurement_values, self.measurement_deviations
                )
            )
            differences_over_deviations = (
                self.measurement_values - prediction.values
            ) / self.measurement_deviations
            half_log_determinants = np.log(np.diagonal(cholesky_factor, axis1=1, axis2=2)).sum(
                axis=1
            ) - np.log(probabilities)
            determinant_residual = np.sqrt(
                2.0 * np.maximum(half_log_determinants, 0.0)
            )  # below 0 by rounding alone
            measurement_residuals = np.linalg.solve(
                cholesky_factor, differences_over_deviations[..., None]
            )[..., 0]
            yield (
                point_indices,
                np.column_stack([measurement_residuals, determinant_residual]),
                prediction,
            )

    def compute_normalised_temperature_change(self, x: np.ndarray) -> float:
        """Return the posterior mean of an unknown temperature change of the plate.

        The change is from the measurements without the crack to the later ones, positive if the
        plate is warmer now. Its unit is the prior standard deviation. ``x`` (d,) are values of the
        unknowns.
        """
        prediction = self.predict_for_likeliest_face_state(x)
        temperature_slopes = (
            prediction.values[0]
            * self.predictor.plate_changes_since_baseline.unknown_temperature_frequency_changes[
                :, 0
            ]
            / self.measurement_deviations
        )
        differences_over_deviations = (
            self.measurement_values - prediction.values[0]
        ) / self.measurement_deviations
        covariance = compute_scaled_covariance(
            prediction, self.measurement_values, self.measurement_deviations
        )[0]
        return float(temperature_slopes @ np.linalg.solve(covariance, differences_over_deviations))

    def explains_measurements(self, x: np.ndarray) -> np.ndarray:
        """Return True for values x (m, d) that explain the measurements: (m,).

        The p-value of chi^2 must be at least 1 - ``identify.confidence``. The degrees of freedom
        are not reduced by the unknowns, since x need not be the optimum.
        """
        return np.asarray(
            self._compute_point_chi_squares_and_p_values(x, 0)[1]
            >= 1.0 - self.predictor.model.identify_table.confidence
        )

    def compute_chi_square_and_p_value(self, x: np.ndarray) -> tuple[float, float]:
        """Return (chi^2, p-value) at the fitted values x (d,) of the unknowns.

        The degrees of freedom are the number of measurements, less the d unknowns. Each group of
        displacements subtracts 3 more, for the load's size and phase and a constant. The minimum is
        1.
        """
        chi_squares_of_single_point, p_values_of_single_point = (
            self._compute_point_chi_squares_and_p_values(x[None], len(x))
        )
        return float(chi_squares_of_single_point[0]), float(p_values_of_single_point[0])

    def _compute_point_chi_squares_and_p_values(
        self, x: np.ndarray, n_fitted_unknowns: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return chi^2 and its p-values at m values x (m, d) of the unknowns: (m,) each.

        ``n_fitted_unknowns`` is subtracted from the number of measurements in the degrees of
        freedom.
        """
        chi_squares = np.sum(self.compute_residuals(x)[:, :-1] ** 2, axis=1)
        degrees_of_freedom = (
            len(self.measurement_values)
            - n_fitted_unknowns
            - self.predictor(x[:1]).changes_per_fitted_load_deviation.shape[2]
        )
        return chi_squares, np.asarray(chdtrc(max(degrees_of_freedom, 1), chi_squares))

    def without_measurement(self, omitted_row_index: int) -> Likelihood:
        """Return the likelihood without the measurement at index ``omitted_row_index``."""
        is_kept = np.arange(len(self.measurement_values)) != omitted_row_index
        kept_rows = [
            measurement
            for measurement, is_kept_row in zip(self.predictor.rows, is_kept, strict=True)
            if is_kept_row
        ]
        predictor = self.predictor.make_predictor(kept_rows)
        return Likelihood(
            self.measurement_values[is_kept], self.measurement_deviations[is_kept], predictor
        )


def compute_scaled_covariance(
    prediction: MeasurementPredictions,
    measurement_values: np.ndarray,
    measurement_deviations: np.ndarray,
) -> np.ndarray:
    """Return the covariance V of measurements and predictions, scaled: (m, q, q).

    The entry i, j is V_ij / (e_i e_j), with the standard deviations e of the q measurements at m
    values of the unknowns. A measurement that cannot be predicted gets a large prediction error:
    ten times the sum of its absolute value and its standard deviation.
    """
    is_predictable_pair = np.outer(prediction.is_predictable, prediction.is_predictable)
    prediction_covariance = (
        prediction.covariance
        + prediction.changes_per_fitted_load_deviation
        @ prediction.changes_per_fitted_load_deviation.transpose(0, 2, 1)
    )
    deviations_of_unpredictable_rows = np.where(
        prediction.is_predictable, 0.0, 10.0 * (np.abs(measurement_values) + measurement_deviations)
    )
    prediction_covariance = np.where(is_predictable_pair, prediction_covariance, 0.0) + np.diag(
        deviations_of_unpredictable_rows**2
    )
    return np.asarray(
        np.eye(len(measurement_values))
        + prediction_covariance / np.outer(measurement_deviations, measurement_deviations)
    )


@dataclass(frozen=True)
class Optimum:
    """Maximum of the likelihood, found by least squares.

    Attributes
    ----------
    x : (d,)
        Values of the unknowns at the maximum.
    log_likelihood : float
        Log-likelihood at the maximum.
    covariance : (d, d)
        Covariance of the unknowns, from the slopes of the residuals and the prior.
    """

    x: np.ndarray
    log_likelihood: float
    covariance: np.ndarray

    @property
    def deviations(self) -> np.ndarray:
        """Return the standard deviations of the unknowns: (d,)."""
        return np.sqrt(np.diag(self.covariance))


class PosteriorForTextValues:
    """Posterior on a grid of the numerical unknowns, for one choice of text values.

    An unknown with text values is, for example, crack.edge, with "left" or "right". Each choice of
    text values has an object of this class. The grid has more points around the best optima.

    Attributes
    ----------
    likelihood : Likelihood
        Likelihood of the unknowns.
    optima : list of Optimum
        Distinct maxima of the likelihood, best first.
    axes : tuple of (n_i,)
        Grid values of each unknown.
    grid_log_likelihood : (n_1, ..., n_d)
        Log-likelihood of real cracks at the grid points. The likelihood of the equivalent straight,
        sharp crack is convolved with the distribution of a real crack about it.
    grid_prior_probabilities : (n_1, ..., n_d)
        Prior probability of each grid point; the sum is 1.
    """

    def __init__(self, likelihood: Likelihood) -> None:
        self.likelihood, grid_of_solved_cases = (
            likelihood,
            likelihood.predictor.model.grid_of_solved_cases,
        )
        n_unknowns = len(grid_of_solved_cases.axes)
        self.axes: tuple[np.ndarray, ...] = ()
        if n_unknowns == 0:
            self.grid_log_likelihood = likelihood(np.zeros((1, 0))).reshape(())
            self.grid_prior_probabilities = np.ones(())
            self.optima = [Optimum(np.zeros(0), float(self.grid_log_likelihood), np.zeros((0, 0)))]
            return
        first_grid = build_first_grid(grid_of_solved_cases)
        first_grid_log_likelihood = _evaluate_log_likelihood(likelihood, first_grid.nodes).reshape(
            first_grid.shape
        )
        self.optima = _find_optima(likelihood, first_grid, first_grid_log_likelihood)
        model = likelihood.predictor.model
        best_optima = self.optima[:3]
        offsets_over_half_width = np.linspace(
            -1.0, 1.0, REFINED_GRID_COUNT_BY_DIMENSION.get(n_unknowns, 7)
        )
        refined_axis_value_arrays = []
        for optimum in best_optima:
            crack_deviations = model.compute_crack_geometry_deviations(optimum.x[None])[0]
            for deviations in (optimum.deviations, np.hypot(optimum.deviations, crack_deviations)):
                refined_region_half_widths = (
                    IDENTIFICATION_VALUES.refined_half_width_in_deviations * deviations
                )
                refined_axis_value_arrays.append(
                    optimum.x + np.outer(offsets_over_half_width, refined_region_half_widths)
                )
        self.axes = tuple(
            np.unique(np.concatenate([axis, values[(values > axis[0]) & (values < axis[-1])]]))
            for axis, values in zip(
                first_grid.axes, np.vstack(refined_axis_value_arrays).T, strict=True
            )
        )
        axis_weights = [trapezoid(np.eye(len(axis)), axis) / np.ptp(axis) for axis in self.axes]
        self.grid_prior_probabilities = reduce(np.multiply.outer, axis_weights)
        grid_points = UnknownGrid(self.axes).nodes
        # Far below the maximum, log L is interpolated on the first grid, not computed again.
        neighbourhood_maxima = maximum_filter(first_grid_log_likelihood, size=3, mode="nearest")
        log_likelihood_limit = (
            self.optima[0].log_likelihood
            - IDENTIFICATION_VALUES.max_log_drop_below_best_to_evaluate
        )
        is_evaluated = (
            RegularGridInterpolator(first_grid.axes, neighbourhood_maxima)(grid_points)
            > log_likelihood_limit
        )
        for optimum in best_optima:
            refined_region_half_widths = (
                IDENTIFICATION_VALUES.refined_half_width_in_deviations * optimum.deviations
            )
            is_evaluated |= np.all(
                np.abs(grid_points - optimum.x) < refined_region_half_widths, axis=1
            )
        refined_log_likelihood = RegularGridInterpolator(
            first_grid.axes, first_grid_log_likelihood
        )(grid_points)
        refined_log_likelihood[is_evaluated] = _evaluate_log_likelihood(
            likelihood, grid_points[is_evaluated]
        )
        self.grid_log_likelihood = _convolve_with_crack_deviations(
            refined_log_likelihood.reshape(self.grid_prior_probabilities.shape),
            self.axes,
            axis_weights,
            model.compute_crack_geometry_deviations(grid_points),
        )

    @property
    def log_evidence(self) -> float:
        """Return the log of the evidence, the integral of the likelihood over the prior."""
        return float(logsumexp(self.grid_log_likelihood, b=self.grid_prior_probabilities))

    def get_unknown_values_by_key(self, x: np.ndarray) -> dict[str, Any]:
        """Return the values of all unknowns by key.

        ``x`` (d,) are the numbers. This branch adds the text values, such as "left" for crack.edge.
        """
        model = self.likelihood.predictor.model
        return model.text_value_by_unknown_key | dict(
            zip(model.unknown_keys, x.tolist(), strict=True)
        )

    def interpolate_log_likelihood(self, x: np.ndarray) -> float:
        """Interpolate the log-likelihood on the grid to values x (d,).

        Values outside the bounds move to the bounds.
        """
        if not self.axes:
            return float(self.grid_log_likelihood)
        grid = UnknownGrid(self.axes)
        bounded_x = np.clip(x, grid.lower_bounds, grid.upper_bounds)
        return float(RegularGridInterpolator(self.axes, self.grid_log_likelihood)(bounded_x)[0])

    def find_explanations_and_interpolation_shares(self) -> tuple[np.ndarray, np.ndarray]:
        """Find cracks that explain the measurements, and fractions of variance by interpolation.

        Candidates are the points of the first grid (:func:`build_first_grid`) and the optima.

        Returns
        -------
        explaining_points : (m, d)
            m cracks that explain the measurements (:meth:`Likelihood.explains_measurements`):
            values of the d unknowns.
        interpolation_shares : (m, d, q)
            For each of q measurements, a fraction of the variance of measurement plus prediction:
            the part by interpolation along each of the d unknowns.
        """
        likelihood_function, explaining_point_arrays = (
            self.likelihood,
            [np.zeros((0, len(self.axes)))],
        )
        interpolation_share_arrays = [
            np.zeros((0, len(self.axes), len(likelihood_function.measurement_values)))
        ]
        grid_points_and_optima = np.vstack(
            [
                build_first_grid(likelihood_function.predictor.model.grid_of_solved_cases).nodes,
                *(optimum.x for optimum in self.optima),
            ]
        )
        for point_batch in _split_points_into_batches(grid_points_and_optima):
            if len(x := point_batch[likelihood_function.explains_measurements(point_batch)]):
                interpolation_variances_by_unknown, total_prediction_variances = (
                    likelihood_function.predictor.compute_interpolation_and_total_variances(x)
                )
                explaining_point_arrays.append(x)
                interpolation_share_arrays.append(
                    interpolation_variances_by_unknown
                    / (total_prediction_variances + likelihood_function.measurement_deviations**2)[
                        :, None
                    ]
                )
        return np.vstack(explaining_point_arrays), np.vstack(interpolation_share_arrays)


def _convolve_with_crack_deviations(
    log_likelihood: np.ndarray,
    axes: Sequence[np.ndarray],
    axis_weights: list[np.ndarray],
    crack_deviations: np.ndarray,
) -> np.ndarray:
    """Convolve the likelihood on a grid with normal distributions along the axes.

    The likelihood belongs to an equivalent straight, sharp crack. The convolution turns it into the
    likelihood of a real crack, with a distribution about the equivalent crack.

    Parameters
    ----------
    log_likelihood : (n_1, ..., n_d)
        Log-likelihood at the grid points.
    axes : list of (n_i,)
        Grid values of each unknown.
    axis_weights : list of (n_i,)
        Integration weights of the grid values.
    crack_deviations : (n, d)
        Standard deviations of the normal distributions at all n grid points
        (:func:`compute_crack_geometry_deviations`).

    Returns
    -------
    (n_1, ..., n_d)
        Logarithm of the convolved likelihood.
    """
    largest_log_likelihood = log_likelihood.max()
    relative_likelihood = np.exp(log_likelihood - largest_log_likelihood)
    for unknown_index, (axis_values, weights_along_axis) in enumerate(
        zip(axes, axis_weights, strict=True)
    ):
        kernel_widths = np.moveaxis(
            crack_deviations[:, unknown_index].reshape(log_likelihood.shape), unknown_index, -1
        )
        if not kernel_widths.any():
            continue
        kernel_widths = np.maximum(kernel_widths, 0.1 * np.gradient(axis_values))[
            ..., None
        ]  # narrower kernels fall to 0 before the next grid point
        kernel_matrix = weights_along_axis * np.exp(
            -0.5 * ((axis_values - axis_values[:, None]) / kernel_widths) ** 2
        )
        kernel_matrix /= kernel_matrix.sum(axis=-1, keepdims=True)
        weighted_relative_likelihood = (
            np.moveaxis(relative_likelihood, unknown_index, -1) * weights_along_axis
        )
        relative_likelihood = np.moveaxis(
            np.einsum("...j,...ji->...i", weighted_relative_likelihood, kernel_matrix)
            / weights_along_axis,
            -1,
            unknown_index,
        )
    return np.asarray(
        np.log(np.maximum(relative_likelihood, np.finfo(float).tiny)) + largest_log_likelihood
    )


def build_first_grid(grid_of_solved_cases: UnknownGrid) -> UnknownGrid:
    """Return the posterior's first grid, equally spaced along each unknown.

    The bounds are those of ``grid_of_solved_cases``. The number of values of each unknown is
    :data:`FIRST_GRID_COUNT_BY_DIMENSION` (9 if not listed there).
    """
    n_values = FIRST_GRID_COUNT_BY_DIMENSION.get(len(grid_of_solved_cases.axes), 9)
    return UnknownGrid(
        tuple(
            np.linspace(axis_values[0], axis_values[-1], n_values)
            for axis_values in grid_of_solved_cases.axes
        )
    )


def _evaluate_log_likelihood(likelihood: Likelihood, points: np.ndarray) -> np.ndarray:
    """Return the log-likelihood at points (n, d): (n,), evaluated in batches."""
    return np.concatenate(
        [likelihood(point_batch) for point_batch in _split_points_into_batches(points)]
    )


def _split_points_into_batches(points: np.ndarray) -> list[np.ndarray]:
    """Split points (n, d) into batches (..., d), to limit the memory.

    A batch has at most :attr:`Options.points_per_batch` points.
    """
    return np.array_split(points, -(-len(points) // IDENTIFICATION_VALUES.points_per_batch))


def _find_optima(
    likelihood: Likelihood, first_grid: UnknownGrid, log_likelihood: np.ndarray
) -> list[Optimum]:
    """Find maxima of the likelihood by least squares.

    Least squares start at the best 8 local maxima of ``log_likelihood``, given on ``first_grid``.
    An optimum is left out if a better optimum is within one standard deviation in every unknown. It
    is also left out if its log-likelihood is more than 8 below the best.
    """
    local_maximum_indices = np.flatnonzero(
        log_likelihood == maximum_filter(log_likelihood, size=3, mode="nearest")
    )
    start_indices = sorted(
        local_maximum_indices, key=lambda node_index: -log_likelihood.flat[node_index]
    )[: IDENTIFICATION_VALUES.max_least_squares_starts]
    optima: list[Optimum] = []
    grid_of_solved_cases = likelihood.predictor.model.grid_of_solved_cases
    lower_bounds = grid_of_solved_cases.lower_bounds
    unknown_ranges = grid_of_solved_cases.upper_bounds - lower_bounds

    def compute_residuals_at_fractions(fractions: np.ndarray) -> np.ndarray:
        return likelihood.compute_residuals((lower_bounds + unknown_ranges * fractions)[None])[0]

    def compute_slopes_at_fractions(fractions: np.ndarray) -> np.ndarray:
        fraction_steps = np.diag(np.where(fractions < 0.5, 1e-6, -1e-6))  # of the ranges, inwards
        residual_rows = likelihood.compute_residuals(
            lower_bounds + unknown_ranges * np.vstack([fractions, fractions + fraction_steps])
        )
        return np.asarray((residual_rows[1:] - residual_rows[0]).T / np.diag(fraction_steps))

    for start_point in first_grid.nodes[start_indices]:
        fractions = np.clip((start_point - lower_bounds) / unknown_ranges, 1e-6, 1.0 - 1e-6)
        least_squares_fit = least_squares(
            compute_residuals_at_fractions,
            fractions,
            compute_slopes_at_fractions,
            bounds=(0.0, 1.0),
            x_scale=0.1,
            ftol=1e-5,
        )
        covariance = np.linalg.inv(
            add_uniform_prior_information(least_squares_fit.jac.T @ least_squares_fit.jac)
        ) * np.outer(unknown_ranges, unknown_ranges)
        optima.append(
            Optimum(
                lower_bounds + unknown_ranges * least_squares_fit.x,
                -float(least_squares_fit.cost),
                covariance,
            )
        )
    optima.sort(key=lambda optimum: -optimum.log_likelihood)
    distinct_optima: list[Optimum] = []
    for optimum in optima:
        is_near_better_optimum = any(
            np.all(np.abs(optimum.x - better_optimum.x) < better_optimum.deviations)
            for better_optimum in distinct_optima
        )
        log_drop = optima[0].log_likelihood - optimum.log_likelihood
        if (
            log_drop < IDENTIFICATION_VALUES.max_log_drop_of_kept_optima
            and not is_near_better_optimum
        ):
            distinct_optima.append(optimum)
    return distinct_optima


class Posterior:
    """Posterior of all unknowns: one branch for each choice of text values.

    An unknown with text values is, for example, crack.edge, with "left" or "right". All choices
    have the same prior probability.

    Parameters
    ----------
    posterior_by_text_values : dict of str to PosteriorForTextValues
        Branch for each choice. Keys are the text values, joined with ", "; "" if all unknowns are
        numbers.
    """

    def __init__(self, posterior_by_text_values: Mapping[str, PosteriorForTextValues]) -> None:
        self.posterior_by_text_values = dict(posterior_by_text_values)
        log_evidences = [branch.log_evidence for branch in self.posterior_by_text_values.values()]
        log_evidence_sum = logsumexp(log_evidences)
        self.log_evidence = float(log_evidence_sum - np.log(len(log_evidences)))
        self.grid_probabilities_by_words = {
            words_text: np.exp(branch.grid_log_likelihood - log_evidence_sum)
            * branch.grid_prior_probabilities
            for words_text, branch in self.posterior_by_text_values.items()
        }
        """Probability of each grid point, by text values; the sum over all is 1."""
        self._log_likelihoods_at_all_nodes = np.concatenate(
            [
                branch.grid_log_likelihood.ravel()
                for branch in self.posterior_by_text_values.values()
            ]
        )
        self._mass_of_points = np.concatenate(
            [point_masses.ravel() for point_masses in self.grid_probabilities_by_words.values()]
        )

    @property
    def best_words_and_unknowns(self) -> tuple[str, np.ndarray]:
        """Return the text values, and the numbers (d,), with the largest likelihood.

        The first item has the values of unknowns such as crack.edge, joined with ", ". It is "" if
        all unknowns are numbers. The second item has the values of the d unknowns with numbers.
        """
        words_text = max(
            self.posterior_by_text_values,
            key=lambda words_text: (
                self.posterior_by_text_values[words_text].optima[0].log_likelihood
            ),
        )
        return words_text, self.posterior_by_text_values[words_text].optima[0].x

    @property
    def _likelihood_function_and_best_unknowns(self) -> tuple[Likelihood, np.ndarray]:
        """Return the likelihood, and the unknowns (d,) at its maximum."""
        words_text, x = self.best_words_and_unknowns
        return self.posterior_by_text_values[words_text].likelihood, x

    @cached_property
    def misfit_chi_square_and_p_value(self) -> tuple[float, float]:
        """Return (chi^2, p-value) at the maximum of the likelihood."""
        likelihood, x = self._likelihood_function_and_best_unknowns
        return likelihood.compute_chi_square_and_p_value(x)

    @cached_property
    def misfits_without_each_measurement(self) -> list[tuple[float, float]]:
        """Return (chi^2, p-value) with one measurement left out, for each measurement.

        Entry i leaves out measurement i. The unknowns are not fitted again: they stay at the
        maximum of the likelihood for all measurements.
        """
        likelihood, x = self._likelihood_function_and_best_unknowns
        return [
            likelihood.without_measurement(row_index).compute_chi_square_and_p_value(x)
            for row_index in range(len(likelihood.measurement_values))
        ]

    def compute_misfit_with_change_factors(
        self, *, clamp_factor: float = 1.0, temperature_factor: float = 1.0
    ) -> tuple[float, float]:
        """Return (chi^2, p-value) for more or less likely changes of clamp and temperature.

        Used to decide if the measurements can be explained without such a change. The changes
        happen between the measurements without the crack and later ones. The unknowns stay at the
        maximum of the likelihood with both factors 1.

        ``clamp_factor`` multiplies the prior standard deviation of frequency changes by the clamp.
        ``temperature_factor`` multiplies the prior standard deviation of an unknown temperature
        difference. The factor 0 excludes a change.
        """
        likelihood, x = self._likelihood_function_and_best_unknowns
        predictor = likelihood.predictor.with_change_deviation_factors(
            clamp_factor=clamp_factor, temperature_factor=temperature_factor
        )
        return replace(likelihood, predictor=predictor).compute_chi_square_and_p_value(x)

    @cached_property
    def mean_normalised_temperature_change(self) -> float:
        """Return the posterior mean of an unknown temperature change of the plate.

        The change is from the measurements without the crack to the later ones, positive if the
        plate is warmer now. Its unit is the prior standard deviation. The unknowns are at the
        maximum of the likelihood.
        """
        likelihood, x = self._likelihood_function_and_best_unknowns
        return likelihood.compute_normalised_temperature_change(x)

    @cached_property
    def unresolved_probability(self) -> float:
        """Return the probability at points that the grid does not resolve.

        At such points the log-likelihood falls by more than 2 to both neighbouring points along an
        unknown, as on a thin ridge.
        """
        unresolved_sum = 0.0
        for words_text, branch in self.posterior_by_text_values.items():
            is_unresolved = np.zeros(branch.grid_log_likelihood.shape, dtype=bool)
            for unit_vector in np.eye(is_unresolved.ndim, dtype=int):
                neighbour_filter_mask = np.reshape([1, 0, 1], 1 + 2 * unit_vector)
                neighbour_log_likelihood_maxima = maximum_filter(
                    branch.grid_log_likelihood,
                    None,
                    neighbour_filter_mask,
                    None,
                    "constant",
                    -np.inf,
                )
                is_unresolved |= branch.grid_log_likelihood - neighbour_log_likelihood_maxima > 2.0
            unresolved_sum += float(
                np.sum(self.grid_probabilities_by_words[words_text][is_unresolved])
            )
        return unresolved_sum

    def find_region_border_log_likelihood(self, probability: float) -> float:
        """Return the log-likelihood at the border of a credible region.

        The region consists of the grid points with the largest likelihood. Their posterior
        probability sums to at least ``probability``.
        """
        indices_most_likely_first = np.argsort(-self._log_likelihoods_at_all_nodes)
        cumulative_masses = np.cumsum(self._mass_of_points[indices_most_likely_first])
        border_index = min(
            int(np.searchsorted(cumulative_masses, probability)), len(indices_most_likely_first) - 1
        )
        return float(self._log_likelihoods_at_all_nodes[indices_most_likely_first[border_index]])

    def iterate_reached_bounds(self, probability: float) -> Iterator[tuple[int, str, float]]:
        """Yield the bounds of the unknowns that a credible region reaches.

        ``probability`` is the posterior probability of the region.

        Yields
        ------
        unknown_index : int
            Position of the unknown.
        side : str
            "below" for a lower bound, "above" for an upper bound.
        bound : float
            Value of the bound.
        """
        border_log_likelihood = self.find_region_border_log_likelihood(probability)
        branches = [*self.posterior_by_text_values.values()]
        for unknown_index, end_index in product(range(len(branches[0].axes)), (0, -1)):
            if any(
                np.any(
                    branch.grid_log_likelihood.take(end_index, axis=unknown_index)
                    >= border_log_likelihood
                )
                for branch in branches
            ):
                yield (
                    unknown_index,
                    "above" if end_index else "below",
                    float(branches[0].axes[unknown_index][end_index]),
                )

    def compute_marginal_values_and_masses(
        self, unknown_index: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the grid values of an unknown, and their probabilities: (n,) each.

        Values are in ascending order. The probabilities are summed over all remaining unknowns with
        numbers. With several choices of text values, each choice has its own grid values.
        """
        unknown_values = np.concatenate(
            [branch.axes[unknown_index] for branch in self.posterior_by_text_values.values()]
        )
        value_masses = np.concatenate(
            [
                np.moveaxis(point_masses, unknown_index, 0)
                .reshape(point_masses.shape[unknown_index], -1)
                .sum(axis=1)
                for point_masses in self.grid_probabilities_by_words.values()
            ]
        )
        sorted_value_indices = np.argsort(unknown_values, kind="stable")
        return unknown_values[sorted_value_indices], value_masses[sorted_value_indices]

    def compute_interval(self, unknown_index: int, probability: float) -> tuple[float, float]:
        """Return lower and upper end of an unknown's credible interval.

        The unknown is in the interval with the given ``probability``. Both tails outside have the
        same probability.
        """
        unknown_values, value_masses = self.compute_marginal_values_and_masses(unknown_index)
        cumulative_masses = np.cumsum(value_masses) - 0.5 * value_masses
        tail_probability = 0.5 * (1.0 - probability)
        lower_interval_end, upper_interval_end = np.interp(
            [tail_probability, 1.0 - tail_probability], cumulative_masses, unknown_values
        )
        return float(lower_interval_end), float(upper_interval_end)

    def find_region_parts(
        self, probability: float, min_probability: float
    ) -> list[tuple[str, np.ndarray, float]]:
        """Return the separate parts of a credible region, most probable first.

        The region has the given ``probability``. Parts with less than ``min_probability`` are left
        out.

        Returns
        -------
        list of (str, (d,), float)
            For each part: text, middle and probability. The text joins the unknowns' text values,
            such as "left" for crack.edge, by ", "; it is "" if all unknowns are numbers. The middle
            is the posterior mean of the d unknowns in the part. If a bent part does not contain the
            mean, the middle is the part's grid point nearest to the mean.
        """
        border_log_likelihood = self.find_region_border_log_likelihood(probability)
        region_parts = []
        for words_text, branch in self.posterior_by_text_values.items():
            is_inside = branch.grid_log_likelihood >= border_log_likelihood
            part_numbers, n_parts = label(is_inside, structure=np.ones((3,) * is_inside.ndim))
            for part_number in range(1, n_parts + 1):
                is_part_point = part_numbers == part_number
                point_masses = self.grid_probabilities_by_words[words_text][is_part_point]
                if point_masses.sum() >= min_probability:
                    part_points = UnknownGrid(branch.axes).nodes[is_part_point.ravel()]
                    part_middle = point_masses @ part_points / point_masses.sum()
                    if branch.interpolate_log_likelihood(part_middle) < border_log_likelihood:
                        part_widths = np.ptp(part_points, axis=0) + np.finfo(float).tiny
                        part_middle = part_points[
                            np.argmin(
                                np.sum(((part_points - part_middle) / part_widths) ** 2, axis=1)
                            )
                        ]
                    region_parts.append((words_text, part_middle, float(point_masses.sum())))
        return sorted(region_parts, key=lambda part: -part[2])

    def compute_deviation(self, unknown_index: int) -> float:
        """Return the posterior standard deviation of an unknown."""
        unknown_values, value_masses = self.compute_marginal_values_and_masses(unknown_index)
        return float(np.sqrt(np.cov(unknown_values, aweights=value_masses, ddof=0)))

    def compute_pair_mass_and_density(
        self, words_text: str, first_unknown_index: int, second_unknown_index: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return posterior probability and density over two unknowns.

        Used to draw the posterior over a pair of unknowns.

        Parameters
        ----------
        words_text : str
            Values of the unknowns with text, joined with ", ", such as "left" for crack.edge. The
            results hold for this choice alone.
        first_unknown_index, second_unknown_index : int
            Positions of the two unknowns among the unknowns with numbers.

        Returns
        -------
        mass : (n_first, n_second)
            Posterior probability at each pair of grid values, summed over all remaining unknowns.
        density : (n_first, n_second)
            Posterior probability divided by prior probability.
        """
        pair_mass, pair_prior = (
            np.moveaxis(
                probabilities_on_grid, (first_unknown_index, second_unknown_index), (0, 1)
            ).sum(axis=tuple(range(2, probabilities_on_grid.ndim)))
            for probabilities_on_grid in (
                self.grid_probabilities_by_words[words_text],
                self.posterior_by_text_values[words_text].grid_prior_probabilities,
            )
        )
        return pair_mass, pair_mass / pair_prior
