"""Model errors of arrivals by Student's t, and define confidence levels.

Some arrivals are wrong by far more than the general scatter. Residuals r then follow Student's t,
with fitted degrees of freedom nu and scale s; nu is large for normal residuals (Lange, Little and
Taylor, Journal of the American Statistical Association 84, 1989, 881). Least squares have the
weights

    w = (nu + 1) / (nu + r^2 / s^2),

found in turns with the residuals. With psi = w r and the fit's columns X, the coefficients have the
covariance H^-1 M H^-1, where H = mean(psi') X^T X and M = X^T C X (an M-estimator: Huber, Robust
Statistics, 1981). The matrix C is the covariance of psi, with significant correlations between
revolutions, and between probes in a revolution, which share marks.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.optimize import least_squares
from scipy.special import gammaln, ndtr

TRIAL_STUDENT_FREEDOMS = np.array([3.0, 5.0, 10.0, 30.0, 1e6])
"""Trial degrees of freedom nu of Student's t; 1e6 stands for normal errors."""
MAX_WEIGHTING_ROUNDS, WEIGHT_CHANGE_TOLERANCE = 30, 1e-2
"""Maximum rounds of weights, and maximum change in the last round.

Changes of weights, and of residuals over their scale, are below 0.01 at the end.
"""
MAX_DEPENDENT_EIGENVALUE_RATIO = 1e-12
"""Eigenvalue, relative to the largest, below which columns are dependent."""


@dataclass(frozen=True)
class SignificanceLimits:
    """Hold limits of probability and likelihood for decisions in fits.

    Attributes
    ----------
    vibration_significance_level : float
        A vibration is significant if noise alone gives one as large with at most this probability.
    min_resonance_likelihood_gain : float
        A resonance is significant if it reduces -2 log likelihood by this or more. The limit is
        high, since about 1e5 resonances are tried, each with six unknowns.
    misfit_significance_level : float
        The model is wrong if chance alone makes residuals as large as measured with a lower
        probability than this.
    errors_from_misfit_significance_level : float
        Limit for the same probability. Below, standard errors follow from the difference between
        means and fit. Above, errors follow from the arrivals' scatter.
    n_standard_errors_of_equal_fits : float
        Number of standard deviations within which candidates fit equally well, and a correlation is
        insignificant.
    """

    vibration_significance_level: float = 1e-5
    min_resonance_likelihood_gain: float = 60.0
    misfit_significance_level: float = 1e-3
    errors_from_misfit_significance_level: float = 1e-2
    n_standard_errors_of_equal_fits: float = 3.0

    @property
    def allowed_cost_difference(self) -> float:
        """Maximum difference in -2 log likelihood between equally good candidates.

        The value is ``n_standard_errors_of_equal_fits`` squared, 9. Sums of squared residuals have
        the same limit, if each residual is divided by the standard deviation.
        """
        return self.n_standard_errors_of_equal_fits**2


SIGNIFICANCE_LIMITS = SignificanceLimits()
"""Levels of significance in all fits to arrivals."""

RevolutionsAndProbes = tuple[np.ndarray, np.ndarray]
"""Indices of revolutions and probes for n arrivals: two arrays (n,)."""


class StudentNoise:
    """Fit Student's t distribution to residuals by maximum likelihood.

    The scale s is found by iteration for several degrees of freedom nu, and the best nu is kept by
    Akaike's criterion. The usual step multiplies s^2 by the mean of w (r / s)^2, with residuals r
    and weights w = (nu + 1) / (nu + (r / s)^2). In this class, the step in ln s is multiplied by 1
    + 3 / nu, for faster convergence.

    Parameters
    ----------
    residuals : (n,)
        Residuals r of n arrivals.
    n_unknowns : int
        Number of unknowns in the fit with these residuals.
    min_scale : float
        Minimum of the scale s, from rounding.
    trial_scales : (k,)
        Initial scales, one for each value in :data:`TRIAL_STUDENT_FREEDOMS`. Default: from the
        median size of the residuals.

    Attributes
    ----------
    weights : (n,)
        Weights w of the arrivals in the next fit.
    scale, freedom : float
        Scale s and degrees of freedom nu.
    cost : float
        -2 log likelihood.
    """

    def __init__(
        self,
        residuals: np.ndarray,
        n_unknowns: int,
        min_scale: float,
        trial_scales: np.ndarray | None = None,
    ) -> None:
        self.residuals, self.n_unknowns = residuals, n_unknowns
        squared_residuals, n_spare = residuals**2, max(len(residuals) - n_unknowns, 1)
        # A fit may pass exactly through as many arrivals as unknowns. With few more arrivals, the
        # tails cannot be estimated: assume normal errors.
        trial_freedoms = (
            TRIAL_STUDENT_FREEDOMS if n_spare > n_unknowns else TRIAL_STUDENT_FREEDOMS[-1:]
        )
        if trial_scales is None:
            initial_scale = (
                1.5 * float(np.median(np.abs(residuals))) * np.sqrt(len(residuals) / n_spare)
            )
            trial_scales = np.full(len(trial_freedoms), initial_scale)
        trial_scales, freedom_column = np.maximum(trial_scales, min_scale), trial_freedoms[:, None]
        for _ in range(MAX_WEIGHTING_ROUNDS):
            squared_ratios = squared_residuals / trial_scales[:, None] ** 2
            new_to_old_squared_scales = (
                (freedom_column + 1.0)
                / (freedom_column + squared_ratios)
                @ squared_residuals
                / (n_spare * trial_scales**2)
            )
            previous_trial_scales = trial_scales
            trial_scales = np.maximum(
                trial_scales * new_to_old_squared_scales ** (0.5 + 1.5 / trial_freedoms), min_scale
            )
            if np.all(
                np.abs(trial_scales - previous_trial_scales)
                < WEIGHT_CHANGE_TOLERANCE * trial_scales
            ):
                break
        self.trial_scales = trial_scales
        squared_ratios = squared_residuals / trial_scales[:, None] ** 2
        trial_log_norms = 2.0 * (
            gammaln(0.5 * trial_freedoms)
            - gammaln(0.5 * trial_freedoms + 0.5)
            + np.log(trial_scales)
        )
        trial_log_norms += np.log(trial_freedoms * np.pi)
        trial_costs = len(residuals) * trial_log_norms + (trial_freedoms + 1.0) * np.log1p(
            squared_ratios / freedom_column
        ).sum(axis=1)
        # Tails are one further unknown: -2 log L must fall by more than 2 (Akaike's criterion).
        best_freedom_index = int(
            np.argmin(trial_costs + 2.0 * (trial_freedoms < TRIAL_STUDENT_FREEDOMS[-1]))
        )
        self.scale, self.freedom, self.cost = (
            float(trial_values[best_freedom_index])
            for trial_values in (trial_scales, trial_freedoms, trial_costs)
        )
        self.weights = (self.freedom + 1.0) / (self.freedom + squared_ratios[best_freedom_index])

    @property
    def psi(self) -> np.ndarray:
        """Weighted residuals psi = w r, with weights w: (n,), in the unit of the residuals r."""
        return self.weights * self.residuals

    @property
    def mean_psi_slope(self) -> float:
        """Mean derivative of the weighted residual w r by the residual r."""
        squared_ratios = (self.residuals / self.scale) ** 2
        psi_derivatives = (
            (self.freedom + 1.0)
            * (self.freedom - squared_ratios)
            / (self.freedom + squared_ratios) ** 2
        )
        return float(np.mean(psi_derivatives))

    @property
    def equivalent_normal_variance(self) -> float:
        """Variance of normal errors that would give the fit the same standard errors.

        Used in formulas for normal errors. The unit is the residuals' unit squared.
        """
        n_spare = len(self.residuals) - self.n_unknowns
        return float(self.psi @ self.psi) / (n_spare * self.mean_psi_slope**2)

    def compute_whiteness_p_value(
        self,
        revolution_and_probe_indices: RevolutionsAndProbes,
        arrival_shift_per_mark_error: np.ndarray,
    ) -> float:
        """Return the probability that the residuals are as correlated by errors alone.

        Errors are in arrivals and shaft marks. A small probability means a vibration or drift in
        the residuals. The tested correlation is between the weighted residuals psi at a probe in
        successive revolutions. The result is nan if no revolution has a next one with arrivals, or
        all residuals are 0.

        An error in a mark moves all arrivals around this mark: residuals become correlated, too.
        With errors e, the arrival at probe i in revolution n moves by sum_k S_ki e_(n+k). Products
        of psi at two probes in a revolution give the variance of e. Multiplied by sum_k S_ki
        S_(k+m)i, this variance is the covariance between arrivals at probe i, m revolutions apart.
        Mark errors also increase the scatter of the products.

        Parameters
        ----------
        revolution_and_probe_indices : pair of (n,) int
            Each arrival's revolution index and probe index.
        arrival_shift_per_mark_error : (marks, probes)
            S: shift of an arrival by an error of 1 in each of the marks around it.
        """
        (
            ((same_probe_sum, n_same_probe_products), (cross_probe_sum, n_cross_probe_products)),
            lag,
            ((lagged_sum, n_lagged_products), (_, n_lagged_cross_products)),
        ) = _sum_products_with_next_revolution(self.psi, revolution_and_probe_indices)
        psi_variance = same_probe_sum / n_same_probe_products
        if not n_lagged_products or not psi_variance:
            return np.nan
        mark_error_covariance = max(cross_probe_sum / max(n_cross_probe_products, 1.0), 0.0)
        mark_shift_products = arrival_shift_per_mark_error.T @ arrival_shift_per_mark_error
        lagged_mark_shift_products = (
            arrival_shift_per_mark_error[lag:] * arrival_shift_per_mark_error[:-lag]
        ).sum(axis=0)
        cross_probe_mark_shift_products = mark_shift_products[
            ~np.eye(len(mark_shift_products), dtype=bool)
        ]
        lagged_mark_covariance = (
            mark_error_covariance
            / cross_probe_mark_shift_products.mean()
            * lagged_mark_shift_products.mean()
            if mark_error_covariance
            else 0.0
        )
        lagged_sum_deviation = psi_variance * np.sqrt(
            n_lagged_products
            + (mark_error_covariance / psi_variance) ** 2 * n_lagged_cross_products
        )
        lower_tail_probability = float(
            ndtr((lagged_sum - n_lagged_products * lagged_mark_covariance) / lagged_sum_deviation)
        )
        return 2.0 * min(lower_tail_probability, 1.0 - lower_tail_probability)

    def coefficient_covariance(
        self, columns: np.ndarray, revolution_and_probe_indices: RevolutionsAndProbes
    ) -> np.ndarray:
        """Return the covariance (m, m) of fitted coefficients.

        Significant correlations between residuals are included.

        Parameters
        ----------
        columns : (n, m)
            Derivatives of the fit at n arrivals by m coefficients.
        revolution_and_probe_indices : pair of (n,) int
            Each arrival's revolution index and probe index.
        """
        column_norms = np.linalg.norm(columns, axis=0)
        columns = columns / column_norms
        columns_by_revolution_and_probe = _arrange_by_revolution_and_probe(
            columns, revolution_and_probe_indices
        )
        revolution_column_sums, gram_matrix = (
            columns_by_revolution_and_probe.sum(axis=1),
            columns.T @ columns,
        )
        psi_variance = float(self.psi @ self.psi) / (len(self.psi) - self.n_unknowns)
        score_covariance = psi_variance * gram_matrix
        psi_covariances_by_lag = self._list_psi_covariances_by_lag(
            psi_variance, revolution_and_probe_indices
        )
        for lag, (same_probe_covariance, cross_probe_psi_covariance) in enumerate(
            psi_covariances_by_lag
        ):
            tail_slice, head_slice = slice(lag, None), slice(len(revolution_column_sums) - lag)
            same_probe_column_products, revolution_products = (
                columns_or_column_sums[tail_slice].reshape(-1, len(gram_matrix)).T
                @ columns_or_column_sums[head_slice].reshape(-1, len(gram_matrix))
                for columns_or_column_sums in (
                    columns_by_revolution_and_probe,
                    revolution_column_sums,
                )
            )
            lag_term = (
                same_probe_covariance * same_probe_column_products
                + cross_probe_psi_covariance * (revolution_products - same_probe_column_products)
            )
            score_covariance += (1.0 - lag / len(psi_covariances_by_lag)) * (
                lag_term if lag == 0 else lag_term + lag_term.T
            )
        # Estimated correlations must not reduce a variance below a tenth of that by white errors.
        gram_eigenvalues, gram_eigenvectors = np.linalg.eigh(gram_matrix)
        coefficient_basis = (
            gram_eigenvectors
            * np.where(
                gram_eigenvalues > MAX_DEPENDENT_EIGENVALUE_RATIO * gram_eigenvalues[-1],
                gram_eigenvalues,
                np.inf,
            )
            ** -0.5
        )
        axis_variances, principal_axes = np.linalg.eigh(
            coefficient_basis.T @ score_covariance @ coefficient_basis
        )
        coefficient_basis = (coefficient_basis @ principal_axes) / column_norms[:, None]
        return np.asarray(
            (coefficient_basis * np.maximum(axis_variances, 0.1 * psi_variance))
            @ coefficient_basis.T
            / self.mean_psi_slope**2
        )

    def _list_psi_covariances_by_lag(
        self, psi_variance: float, revolution_and_probe_indices: RevolutionsAndProbes
    ) -> list[tuple[float, float]]:
        """Return covariances of weighted residuals psi for arrivals 0, 1, ... revolutions apart.

        Each entry has two covariances: between arrivals at the same probe (0 in the first entry),
        and between arrivals at two probes. A covariance within three standard deviations of 0
        becomes 0. The list ends before the first entry with two zeros; the first entry always
        stays.

        Parameters
        ----------
        psi_variance : float
            Variance of psi.
        revolution_and_probe_indices : pair of (n,) int
            Each arrival's revolution index and probe index.
        """
        psi_covariances_by_lag: list[tuple[float, float]] = []
        for lag, sums_and_counts in enumerate(
            _yield_product_sums_by_lag(self.psi, itertools.count(), revolution_and_probe_indices)
        ):
            product_sums, counts = sums_and_counts.T
            max_insignificant_sums = (
                SIGNIFICANCE_LIMITS.n_standard_errors_of_equal_fits
                * psi_variance
                * np.sqrt(counts if lag else 2.0 * counts)
            )
            same_probe_covariance, cross_probe_psi_covariance = np.where(
                np.abs(product_sums) > max_insignificant_sums,
                product_sums / np.maximum(counts, 1.0),
                0.0,
            ).tolist()
            if lag == 0:
                same_probe_covariance = 0.0
            elif not (same_probe_covariance or cross_probe_psi_covariance):
                break
            psi_covariances_by_lag.append((same_probe_covariance, cross_probe_psi_covariance))
        return psi_covariances_by_lag


def student_variance_ratio(freedom: float) -> float:
    """Return the variance of Student's t distribution divided by its squared scale.

    ``freedom`` is the number of degrees of freedom of an estimated variance. With few, squared
    standard errors are larger by this ratio; nan for two or fewer degrees of freedom.
    """
    return 1.0 + 2.0 / (freedom - 2.0) if freedom > 2.0 else np.nan


def correlation_p_value(
    values: np.ndarray, revolution_and_probe_indices: RevolutionsAndProbes
) -> float:
    """Return the probability that uncorrelated values look as correlated by chance.

    The correlation is a sum of products: each of ``values`` (n,) times the value at the same probe
    in the next revolution. Only a positive correlation counts. ``revolution_and_probe_indices`` are
    the revolution index and probe index of each value, two arrays (n,). nan for a single
    revolution, or if all values are 0.
    """
    _, _, [(lagged_sum, n_lagged_products), _] = _sum_products_with_next_revolution(
        values, revolution_and_probe_indices
    )
    value_variance = float(values @ values) / len(values)
    return (
        float(ndtr(-lagged_sum / (value_variance * np.sqrt(n_lagged_products))))
        if n_lagged_products and value_variance
        else np.nan
    )


def _sum_products_with_next_revolution(
    values: np.ndarray, revolution_and_probe_indices: RevolutionsAndProbes
) -> tuple[np.ndarray, int, np.ndarray]:
    """Sum products of values (n,) within revolutions, and with the next revolution.

    ``revolution_and_probe_indices`` are each value's revolution index and probe index, two arrays
    (n,).

    Returns
    -------
    unlagged_sums : (2, 2)
        Products of values in the same revolution. Row 0 has the sum of products at the same probe
        and their number, row 1 the same for two probes.
    lag : int
        Distance to the next revolution: 1, or up to 5 if most revolutions between are missing.
    lagged_sums : (2, 2)
        The same for products of values ``lag`` revolutions apart.
    """
    sums_and_counts = np.array(
        [*_yield_product_sums_by_lag(values, range(6), revolution_and_probe_indices)]
    )
    lag = 1 + int(np.argmax(sums_and_counts[1:, 0, 1] / np.arange(1, 6)))
    return sums_and_counts[0], lag, sums_and_counts[lag]


def _yield_product_sums_by_lag(
    values: np.ndarray, lags: Iterable[int], revolution_and_probe_indices: RevolutionsAndProbes
) -> Iterator[np.ndarray]:
    """Yield sums of products of values (n,), for each distance in revolutions.

    Each of ``lags``, a distance, gives an array (2, 2). Row 0 has the sum of products at the same
    probe and their number, row 1 the same for products at two probes.
    ``revolution_and_probe_indices`` are the revolution index and probe index of each value, two
    arrays (n,).
    """
    tables = np.stack(
        [
            _arrange_by_revolution_and_probe(values_or_ones, revolution_and_probe_indices)
            for values_or_ones in (values, np.ones(len(values)))
        ]
    )
    probe_sums_by_revolution = tables.sum(axis=2)
    for lag in lags:
        n_rows = max(probe_sums_by_revolution.shape[1] - lag, 0)
        same_probe_sums = (tables[:, lag:] * tables[:, :n_rows]).sum(axis=(1, 2))
        all_sums = (probe_sums_by_revolution[:, lag:] * probe_sums_by_revolution[:, :n_rows]).sum(
            axis=1
        )
        yield np.array([same_probe_sums, all_sums - same_probe_sums])


def _arrange_by_revolution_and_probe(
    values: np.ndarray, revolution_and_probe_indices: RevolutionsAndProbes
) -> np.ndarray:
    """Return values (n, ...) as a table (revolutions, probes, ...), with 0 for a missing value.

    ``revolution_and_probe_indices`` are each value's revolution index and probe index, two arrays
    (n,). The first row of the table is the first revolution with a value.
    """
    revolution_indices, probe_indices = (
        revolution_and_probe_indices[0] - revolution_and_probe_indices[0].min(),
        revolution_and_probe_indices[1],
    )
    value_table = np.zeros(
        (int(revolution_indices.max()) + 1, int(probe_indices.max()) + 1, *values.shape[1:])
    )
    value_table[revolution_indices, probe_indices] = values
    return value_table


def fit_noise_by_reweighting(
    residual_function: Callable[[np.ndarray], np.ndarray],
    weights: np.ndarray,
    n_unknowns: int,
    min_scale: float,
) -> StudentNoise:
    """Repeat a fit with small weights for wrong arrivals, until the weights settle.

    A round fits with the weights, and finds new weights from the residuals. The rounds end if no
    weight changes by 0.01, and no residual by 0.01 times the scale; or after 30 rounds.

    Parameters
    ----------
    residual_function : callable
        Return residuals (n,) from a fit with weights (n,).
    weights : (n,)
        Initial weights.
    n_unknowns : int
        Number of coefficients in the fit.
    min_scale : float
        Minimum residual scale, from rounding.

    Returns
    -------
    StudentNoise
        Residuals in the last round, with their weights.
    """
    previous_residuals, trial_scales = np.inf, None
    for _ in range(MAX_WEIGHTING_ROUNDS):
        student_noise = StudentNoise(
            residual_function(weights), n_unknowns, min_scale, trial_scales
        )
        trial_scales = student_noise.trial_scales
        largest_changes = (
            np.abs(student_noise.weights - weights).max(),
            np.abs(student_noise.residuals - previous_residuals).max(),
        )
        weights, previous_residuals = student_noise.weights, student_noise.residuals
        if (
            largest_changes[0] < WEIGHT_CHANGE_TOLERANCE
            and largest_changes[1] < WEIGHT_CHANGE_TOLERANCE * student_noise.scale
        ):
            break
    return student_noise


def find_least_squares_residuals(
    residuals_and_slopes_function: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    lower_bounds: Sequence[float] | np.ndarray,
    upper_bounds: Sequence[float] | np.ndarray,
    min_squares_reduction: float = WEIGHT_CHANGE_TOLERANCE,
) -> np.ndarray:
    """Minimise a sum of squares, and return the residuals (n,) at the solution.

    The search begins with all unknowns 0.

    Parameters
    ----------
    residuals_and_slopes_function : callable
        Return residuals (n,) and their derivatives (n, m) at unknowns (m,), which are scaled to
        size 1. The last call is at the solution.
    lower_bounds, upper_bounds : (m,)
        Bounds of the unknowns, widened to include 0.
    min_squares_reduction : float
        Relative reduction in the sum of squares, below which the search ends.
    """
    cached_function = lru_cache(maxsize=1)(
        lambda unknowns_bytes: residuals_and_slopes_function(np.frombuffer(unknowns_bytes))
    )
    solution = least_squares(
        lambda x: cached_function(x.tobytes())[0],
        np.zeros(len(lower_bounds)),
        lambda x: cached_function(x.tobytes())[1],
        bounds=(np.minimum(lower_bounds, 0.0), np.maximum(upper_bounds, 0.0)),
        method="dogbox",
        ftol=min_squares_reduction,
        xtol=WEIGHT_CHANGE_TOLERANCE,
        gtol=None,
    )
    return cached_function(solution.x.tobytes())[0]
