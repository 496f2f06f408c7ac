"""Fit synchronous vibration to arrival times: engine order and harmonics.

The circumferential Fourier fit by least squares, at constant speed or in a run-up. At engine order
p, each probe at angle phi sees the same point in every revolution. With displacement u, rotor angle
alpha, coefficients a_k and b_k, and harmonics k = 1 ... K,

    u = a0 + sum_k a_k cos(k p alpha) + b_k sin(k p alpha).

The probes around the casing therefore sample a period: K harmonics need 2K + 1 probes, and two
orders with equal values at all probes cannot be distinguished. Heath and Imregun (Journal of
Engineering for Gas Turbines and Power 120, 1998, 784) survey such methods; Diamond and Heyns
(Journal of Vibration and Acoustics 140, 2018, 061003) choose the probe spacing. As in the improved
fit (Applied Sciences 10, 2020, 3675), alpha is the rotor angle at the arrival itself. Unlike the
expected angle, alpha depends on the vibration.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import chdtri, fdtrc, ndtr

from fenics_crack.arrivals.arrival_times import ArrivalTimes, smooth_series
from fenics_crack.arrivals.fit_frequency import find_lines_and_residuals
from fenics_crack.arrivals.harmonics import (
    ORDERS,
    Candidates,
    HarmonicFit,
    TipFit,
    compute_amplitudes_and_errors,
    condition_number,
    make_orders_and_multiples,
    raise_too_few_probes,
    select_candidate,
)
from fenics_crack.arrivals.robust import (
    CONFIDENCE_LEVELS,
    DEPENDENT_EIGENVALUE_RATIO,
    correlation_p_value,
    fit_noise_by_reweighting,
    student_variance_ratio,
)
from fenics_crack.basics.errors import InputError, check_count
from fenics_crack.basics.tables import (
    RAD_PER_TURN,
    UNIT_BY_NAME,
    add_frequency_entries,
    format_count,
    hertz_property,
)
from fenics_crack.numerics.fourier import fourier_basis

N_OMITTED_HARMONICS_TO_FOLD = 3
"""Number of omitted harmonics, next above the fitted ones, that may be folded onto them."""
FOLDED_SIZE_RATIOS = np.array([0.0, *2.0 ** -np.arange(0.5, 8.0)])
"""Trial sizes of an omitted harmonic: 0, and 0.71 down to 0.0055.

Sizes are relative to the amplitude of the last fitted harmonic; in a run-up, to the norm of all
fitted coefficients.
"""
N_NEIGHBOURS_PER_SIDE = 16
"""Number of neighbouring groups on either side in a run-up.

A group and its neighbours share the size ratio of omitted harmonics.
"""


def fit_order(
    arrivals: ArrivalTimes,
    orders: Iterable[float] = ORDERS,
    *,
    harmonics: int = 1,
    subharmonic: int = 1,
    angle_deviation: float = 0.0,
) -> TipFit:
    """Find the engine order and harmonics of a vibration by least squares.

    First, each probe's mean over the revolutions is fitted, together with vibrations at no engine
    order (``asynchronous`` in the result). Errors follow Student's t, so that single wrong arrivals
    have hardly any weight. Each candidate is then fitted to the means. Candidates fit equally well
    if their sum of squares is less than 9 variances above the minimum. The result is the least sum
    among vibrations at most 20 % larger than the smallest; further candidates are ``ambiguous``.
    Candidates that these probes cannot measure are ``hidden``.

    The variance of a mean combines the residuals and the probe's angle. If the means differ from
    the fit by more (F test), the variance follows from these differences. Significant omitted
    harmonics increase the errors; ``folded`` is the probability of large errors by insignificant
    ones.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Measured or simulated, at a constant speed. :func:`track_order` is for run-ups.
    orders : iterable of float
        Candidates: periods of the load in a revolution, whole numbers or fractions with small
        denominators. Orders from a Campbell diagram are distinguished most easily.
    harmonics : int
        Number K; 2 or more show a breathing crack by :meth:`TipFit.ratio`.
    subharmonic : int
        For 2, the response has twice the load's period, and harmonics 1/2, 1, ..., K/2.
    angle_deviation : float [rad]
        Probe angles' standard deviation, the same in every revolution.

    Returns
    -------
    TipFit
        Order, harmonics with standard errors, and equally good orders.

    Raises
    ------
    InputError
        A value cannot be used, or these probes can measure none of the candidates.

    Examples
    --------
    >>> fit = fc.fit_order(arrivals, range(1, 13))
    """
    candidate_orders, multiples = make_orders_and_multiples(orders, harmonics, subharmonic)
    arrivals.check_places(angle_deviation)
    period_in_revolutions = _find_period_in_revolutions(candidate_orders, multiples)
    max_order = float(candidate_orders.max())
    means = ProbeMeans(arrivals, period_in_revolutions, max_order, angle_deviation)
    fit = _fit_best_order(arrivals, means, candidate_orders, multiples)
    if means.lines and not fit.does_not_fit:  # again at the angles to which lines move the tip
        line_displacement_changes = means.compute_displacement_changes_by_lines(arrivals, fit)
        means = ProbeMeans(
            arrivals, period_in_revolutions, max_order, angle_deviation, line_displacement_changes
        )
        fit = _fit_best_order(arrivals, means, candidate_orders, multiples)
    return fit


def _fit_best_order(
    arrivals: ArrivalTimes, means: ProbeMeans, orders: np.ndarray, multiples: np.ndarray
) -> TipFit:
    """Fit all candidate orders, and select the best.

    Among orders with equally small residuals, the smallest vibration is the best.

    Parameters
    ----------
    arrivals, means : ArrivalTimes, ProbeMeans
        Arrivals, and their means at each probe.
    orders, multiples : (n,), (K,)
        Candidates, and harmonics as multiples of the load's frequency.
    """
    n_unknowns = 2 * len(multiples) + 1
    fit_or_none_by_index = {
        index: means.fit_order_or_none(order, multiples) for index, order in enumerate(orders)
    }
    fit_by_index = {index: fit for index, fit in fit_or_none_by_index.items() if fit is not None}
    if not fit_by_index:
        raise_too_few_probes(arrivals, n_unknowns)
    is_hidden = np.full(len(orders), True)
    residual_square_sums, vibration_sizes, costs = np.full((3, len(orders)), np.inf)
    for order_index, fit in fit_by_index.items():
        is_hidden[order_index], residual_square_sums[order_index] = False, fit.sum_of_squares
        vibration_sizes[order_index] = np.linalg.norm(fit.coefficients[1:])
    variance_ratio, misfit, freedom = means.run_misfit_f_test(
        float(residual_square_sums.min()), n_unknowns
    )
    is_equivalent, best_index = select_candidate(
        residual_square_sums,
        vibration_sizes,
        CONFIDENCE_LEVELS.allowed_cost_difference * variance_ratio,
    )
    best_fit = fit_by_index[best_index]
    # Arrivals that are not at the probes' angles distinguish aliases, but not reliably.
    best_wave = (
        fourier_basis(orders[best_index] * means.nominal_angles, multiples) @ best_fit.coefficients
    )
    wave_residual_square_sums = np.array(
        [means.compute_wave_residual_square_sum(best_wave, order, multiples) for order in orders]
    )
    is_equivalent |= (
        wave_residual_square_sums < CONFIDENCE_LEVELS.allowed_cost_difference * variance_ratio
    )
    covariance_factor = finite_ratio = variance_ratio if np.isfinite(variance_ratio) else np.nan
    if means.freedom_within_groups > 0 and len(means.displacements) > n_unknowns + 1:
        # Nor do harmonics that are left out make another order less likely.
        for order_index, fit in fit_by_index.items():
            costs[order_index], fit_by_index[order_index] = means.find_cost_and_fit_with_omitted(
                fit
            )
        is_equivalent |= costs - costs.min() < CONFIDENCE_LEVELS.allowed_cost_difference
        best_fit = fit_by_index[best_index]
        covariance_factor, _, freedom = means.run_misfit_f_test(best_fit.sum_of_squares, n_unknowns)
        covariance_factor = max(covariance_factor, 1.0)
    best_fit = replace(
        best_fit,
        covariance=covariance_factor * student_variance_ratio(freedom) * best_fit.covariance,
    )
    rms_residuals = np.array([means.compute_rms_residual(order, multiples) for order in orders])
    condition_numbers = [
        condition_number(fourier_basis(order * means.nominal_angles, multiples)) for order in orders
    ]
    return TipFit(
        order=float(orders[best_index]),
        order_error=0.0,
        speed=arrivals.mean_speed,
        multiples=multiples,
        coefficients=best_fit.coefficients,
        covariance=best_fit.covariance,
        scatter=means.scatter * float(np.sqrt(finite_ratio)),
        misfit=misfit,
        folded=means.compute_folding_chance(best_fit),
        candidates=Candidates(
            orders, rms_residuals, np.array(condition_numbers), is_equivalent, is_hidden
        ),
        spare=len(means.displacements) - n_unknowns,
        asynchronous=means.lines,
    )


def _find_period_in_revolutions(orders: np.ndarray, multiples: np.ndarray) -> int:
    """Return the revolutions after which every probe sees the same motion.

    The result is the common period of all products of ``orders`` (n,) and ``multiples`` (K,).
    InputError if it is above 24 revolutions.
    """
    max_allowed_period = 24
    response_orders = np.multiply.outer(orders, multiples).ravel()
    order_fractions = [
        Fraction(response_order).limit_denominator(max_allowed_period)
        for response_order in response_orders.tolist()
    ]
    period_in_revolutions = math.lcm(
        *(order_fraction.denominator for order_fraction in order_fractions)
    )
    if period_in_revolutions > max_allowed_period or np.any(
        np.abs([float(order_fraction) for order_fraction in order_fractions] - response_orders)
        > 1e-9
    ):
        requirement_text = (
            f"whole numbers, or fractions that repeat within {max_allowed_period} revolutions"
        )
        raise InputError("orders", orders.tolist(), f"{requirement_text}; else use fit_frequency")
    return period_in_revolutions


@dataclass(frozen=True)
class _OrderFit:
    """Hold the least-squares fit of one order to g values.

    Attributes
    ----------
    order : float
        Periods of the load in a revolution.
    multiples : (K,)
        Harmonics, as multiples of the load's frequency.
    coefficients : (2K+1,) [m]
        a0, a1, b1, ....
    covariance : (2K+1, 2K+1) [m^2]
        Covariance for the coefficients.
    sum_of_squares : float
        Sum of squared residuals, in variances.
    residual_per_error : (g,)
        Residual over error of a value, 1 + u' / R, with tip radius R and u' = du / d alpha: a late
        blade tip moves meanwhile.
    """

    order: float
    multiples: np.ndarray
    coefficients: np.ndarray
    covariance: np.ndarray
    sum_of_squares: float
    residual_per_error: np.ndarray


class _Sample:
    """Hold displacements at rotor angles, with the covariance of their errors.

    Parameters
    ----------
    nominal_angles : (g,) [rad]
        Rotor angles at the expected blade tip.
    displacements : (g,) [m]
        Displacements.
    covariance : (g, g) [m^2]
        Covariance of the values; with an unknown scale if ``freedom_within_groups`` is 0.
    freedom_within_groups : int
        Degrees of freedom of this covariance, from arrivals within groups.
    tip_radius : float [m]
        Blade tip radius.

    Attributes
    ----------
    angles : (g,) [rad]
        Rotor angles at the displaced blade tip.
    """

    def __init__(
        self,
        nominal_angles: np.ndarray,
        displacements: np.ndarray,
        covariance: np.ndarray,
        freedom_within_groups: int,
        tip_radius: float,
    ) -> None:
        self.nominal_angles = nominal_angles
        self.displacements = displacements
        self.freedom_within_groups = freedom_within_groups
        self._radius = tip_radius
        self.angles = nominal_angles - displacements / tip_radius
        self.covariance = covariance
        # At two places of a wave the error of a probe's angle is the same.
        self._cholesky_factor = np.linalg.cholesky(
            covariance + DEPENDENT_EIGENVALUE_RATIO * np.diag(np.diag(covariance))
        )

    def fit_order_or_none(self, order: float, multiples: np.ndarray) -> _OrderFit | None:
        """Fit an order by least squares, with harmonics ``multiples`` (K,).

        Return None if these angles cannot determine the coefficients, or if the fitted blade tip
        would move backwards.
        """
        wave_columns = fourier_basis(order * self.angles, multiples)
        nominal_columns = fourier_basis(order * self.nominal_angles, multiples)
        if np.isinf(condition_number(nominal_columns)) or np.isinf(condition_number(wave_columns)):
            return None
        residual_per_error = np.ones(len(wave_columns))
        # An arrival that is late by e leaves R W e (1 + u' / R): it is elsewhere, too.
        for _ in range(2):
            fitted_residual_per_error = residual_per_error
            (whitened_columns, whitened_displacements) = self._whiten_columns_and_values(
                wave_columns, self.displacements, residual_per_error
            )
            coefficients = np.linalg.lstsq(whitened_columns, whitened_displacements, rcond=None)[0]
            quadrature_waves = (
                wave_columns[:, 1::2] * coefficients[2::2]
                - wave_columns[:, 2::2] * coefficients[1::2]
            )
            residual_per_error = 1.0 + order * quadrature_waves @ multiples / self._radius
            if np.any(residual_per_error <= 0.0):
                return None
        residuals = whitened_displacements - whitened_columns @ coefficients
        covariance = np.linalg.inv(whitened_columns.T @ whitened_columns)
        return _OrderFit(
            order,
            multiples,
            coefficients,
            covariance,
            float(residuals @ residuals),
            fitted_residual_per_error,
        )

    def _whiten_columns_and_values(
        self, columns: np.ndarray, values: np.ndarray, residual_per_error: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Scale columns and values so that their errors are independent, of variance 1.

        Both are divided by ``residual_per_error`` (g,), then by the Cholesky factor of the
        covariance. Columns are (g, m), values (g,).
        """
        columns_and_values = np.column_stack([columns, values]) / residual_per_error[:, None]
        columns_and_values = solve_triangular(self._cholesky_factor, columns_and_values, lower=True)
        return columns_and_values[:, :-1], columns_and_values[:, -1]

    def find_cost_and_fit_with_omitted(self, fit: _OrderFit) -> tuple[float, _OrderFit]:
        """Repeat a fit with omitted harmonics of the likeliest size.

        The next three harmonics (:data:`N_OMITTED_HARMONICS_TO_FOLD`) are normal random numbers.
        Their size is the likeliest trial size; 0 changes nothing.

        Returns
        -------
        cost : float
            Restricted -2 log likelihood.
        fit : _OrderFit
            Coefficients and covariance, with the errors by omitted harmonics.
        """
        costs, fits = self.list_costs_and_fits_by_omitted_size(
            fit, self._list_omitted_harmonic_sizes(fit)
        )
        best_index = int(np.argmin(costs))
        return float(costs[best_index]), fits[best_index]

    def list_costs_and_fits_by_omitted_size(
        self, fit: _OrderFit, omitted_sizes: np.ndarray
    ) -> tuple[np.ndarray, list[_OrderFit]]:
        """Repeat a fit for several sizes of omitted harmonics.

        ``omitted_sizes`` (n,) [m] are standard deviations.

        Returns
        -------
        costs : (n,)
            Restricted -2 log likelihoods.
        fits : list of _OrderFit
            The n fits.
        """
        costs, *estimate_arrays = self._solve_with_omitted_harmonics(
            fit, np.repeat(omitted_sizes[:, None], N_OMITTED_HARMONICS_TO_FOLD, axis=1)
        )
        return costs, [
            replace(
                fit,
                coefficients=coefficients,
                covariance=covariance,
                sum_of_squares=float(residual_square_sum),
            )
            for coefficients, covariance, residual_square_sum in zip(*estimate_arrays, strict=True)
        ]

    def compute_folding_chance(self, fit: _OrderFit) -> float:
        """Return the probability that an amplitude is off by over three standard errors.

        The error comes from three omitted harmonics. Each has several trial amplitudes (standard
        deviations). The probability is the mean over all trials, weighted with their likelihood,
        for the worst amplitude. nan if ``freedom_within_groups`` is 0: errors are then unknown.
        """
        if self.freedom_within_groups < 1:
            return np.nan
        omitted_size_rows = np.array(
            list(
                product(self._list_omitted_harmonic_sizes(fit), repeat=N_OMITTED_HARMONICS_TO_FOLD)
            )
        )
        costs, *estimate_arrays, _ = self._solve_with_omitted_harmonics(fit, omitted_size_rows)
        likelihood_weights = np.exp(0.5 * (costs.min() - costs))
        fitted_amplitudes, fitted_errors = compute_amplitudes_and_errors(
            fit.coefficients, fit.covariance
        )
        amplitudes, amplitude_errors = compute_amplitudes_and_errors(*estimate_arrays)
        allowed_deviations = CONFIDENCE_LEVELS.allowed_standard_errors * fitted_errors
        upper_cdf, lower_cdf = (
            ndtr((fitted_amplitudes + interval_end - amplitudes) / amplitude_errors)
            for interval_end in (allowed_deviations, -allowed_deviations)
        )
        return 1.0 - float(
            (likelihood_weights @ (upper_cdf - lower_cdf)).min() / likelihood_weights.sum()
        )

    def _list_omitted_harmonic_sizes(self, fit: _OrderFit) -> np.ndarray:
        """Return trial standard deviations (n,) [m] of an omitted harmonic.

        The deviations are :data:`FOLDED_SIZE_RATIOS` times the last amplitude of the fit, below
        :attr:`max_allowed_omitted_size`.
        """
        omitted_sizes = np.hypot(*fit.coefficients[-2:]) * FOLDED_SIZE_RATIOS
        return np.asarray(omitted_sizes[omitted_sizes < self.max_allowed_omitted_size])

    @property
    def max_allowed_omitted_size(self) -> float:
        """Maximum standard deviation [m] of an omitted harmonic, for accurate normal equations.

        1e6 times the smallest diagonal entry of the covariance's Cholesky factor.
        """
        return float(np.diag(self._cholesky_factor).min() / np.sqrt(DEPENDENT_EIGENVALUE_RATIO))

    def _solve_with_omitted_harmonics(
        self, fit: _OrderFit, omitted_size_rows: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Repeat a fit with omitted harmonics as further unknowns.

        Parameters
        ----------
        fit : _OrderFit
            Fit without them.
        omitted_size_rows : (n, N_FOLDED_HARMONICS) [m]
            Standard deviations of the omitted harmonics, whose expected value is 0, in n trials.

        Returns
        -------
        costs : (n,)
            Restricted -2 log likelihoods.
        coefficients : (n, 2K+1) [m]
            Coefficients for the fitted harmonics.
        covariances : (n, 2K+1, 2K+1) [m^2]
            Covariances for these coefficients.
        residual_square_sums : (n,)
            Sums of squared residuals and omitted coefficients, in variances.
        """
        n_unknowns, multiples = len(fit.coefficients), fit.multiples
        omitted_multiples = multiples[-1] + multiples[0] * np.arange(
            1.0, N_OMITTED_HARMONICS_TO_FOLD + 1.0
        )
        wave_columns = fourier_basis(
            fit.order * self.angles, np.append(multiples, omitted_multiples)
        )
        log_gram_determinant = np.linalg.slogdet(
            wave_columns[:, :n_unknowns].T @ wave_columns[:, :n_unknowns]
        )[1]
        wave_columns, whitened_displacements = self._whiten_columns_and_values(
            wave_columns, self.displacements, fit.residual_per_error
        )
        column_scales = np.ones((len(omitted_size_rows), wave_columns.shape[1]))
        column_scales[:, n_unknowns:] = np.repeat(omitted_size_rows, 2, axis=1)
        normal_matrices = (
            column_scales[:, :, None] * (wave_columns.T @ wave_columns) * column_scales[:, None, :]
        )
        normal_matrices += np.diag(np.arange(wave_columns.shape[1]) >= n_unknowns)
        covariances = np.linalg.inv(normal_matrices)
        coefficients = (
            covariances @ (column_scales * (wave_columns.T @ whitened_displacements))[..., None]
        )[..., 0]
        residuals = whitened_displacements - (column_scales * coefficients) @ wave_columns.T
        residual_square_sums = (residuals**2).sum(axis=1) + (coefficients[:, n_unknowns:] ** 2).sum(
            axis=1
        )
        costs = residual_square_sums + np.linalg.slogdet(normal_matrices)[1] - log_gram_determinant
        return (
            costs,
            coefficients[:, :n_unknowns],
            covariances[:, :n_unknowns, :n_unknowns],
            residual_square_sums,
        )

    def run_misfit_f_test(
        self, residual_square_sum: float, n_unknowns: int
    ) -> tuple[float, float, float]:
        """Test whether residuals exceed the errors within groups (F test).

        Parameters
        ----------
        residual_square_sum : float
            Sum of squared residuals, in variances.
        n_unknowns : int
            Number of fitted coefficients.

        Returns
        -------
        ratio : float
            Estimated over assumed variance; inf without degrees of freedom.
        chance : float
            Probability that residuals are as large; nan without a test.
        freedom : float
            Degrees of freedom of the estimate; inf for a significant misfit (probability below
            0.01).
        """
        n_spare = len(self.displacements) - n_unknowns
        total_freedom = self.freedom_within_groups + n_spare
        if self.freedom_within_groups < 1:
            return (residual_square_sum / n_spare if n_spare else np.inf), np.nan, total_freedom
        if n_spare < 1:
            return 1.0, np.nan, total_freedom
        chance = float(fdtrc(n_spare, self.freedom_within_groups, residual_square_sum / n_spare))
        if chance < CONFIDENCE_LEVELS.misfit_errors_significance_level:
            return residual_square_sum / n_spare, chance, np.inf
        return (
            (self.freedom_within_groups + residual_square_sum) / total_freedom,
            chance,
            total_freedom,
        )


class ProbeMeans(_Sample):
    """Hold mean displacements of each probe, with their covariance.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Arrivals at a constant speed.
    period_in_revolutions : int
        Revolutions after which a probe sees the same motion again.
    max_order : float
        Largest candidate. Vibrations without an order are sought up to one order above this or
        above the default orders.
    angle_deviation : float [rad]
        Probe angles' standard deviation.
    line_displacement_changes : (revolutions, probes) [m]
        Displacements by :meth:`compute_displacement_changes_by_lines`, which are subtracted.

    Attributes
    ----------
    scatter : float [m]
        Standard deviation of a displacement from the mean; 1 if no probe has two arrivals at a
        mean.
    displacements, angles : (g,) [m, rad]
        Means, and rotor angles at the displaced blade tip.
    covariance : (g, g) [m^2]
        Covariance of the means.
    lines : tuple of TipFit
        Vibrations without an order, with constant frequency.
    """

    def __init__(
        self,
        arrivals: ArrivalTimes,
        period_in_revolutions: int,
        max_order: float,
        angle_deviation: float,
        line_displacement_changes: np.ndarray | float = 0.0,
    ) -> None:
        n_revolutions, n_probes = arrivals.time.shape
        row_in_period = (arrivals.first + np.arange(n_revolutions)) % period_in_revolutions
        constant_numbers = row_in_period[:, None] * n_probes + np.arange(n_probes)
        self.lines, displacements = find_lines_and_residuals(
            arrivals, arrivals.displacement - line_displacement_changes, constant_numbers, max_order
        )
        has_arrival = np.isfinite(displacements)
        places = np.nonzero(has_arrival)
        group_numbers, group_indices = np.unique(constant_numbers[has_arrival], return_inverse=True)
        self._arrival_displacements, self._group_indices = displacements[has_arrival], group_indices
        nominal_angles = arrivals.probes[group_numbers % n_probes] + RAD_PER_TURN * (
            group_numbers // n_probes
        )
        freedom_within_groups = len(group_indices) - len(group_numbers)

        def solve(weights: np.ndarray) -> np.ndarray:
            self.displacements = np.bincount(
                group_indices, weights * self._arrival_displacements
            ) / np.bincount(group_indices, weights)
            return self._arrival_displacements - self.displacements[group_indices]

        student_noise = fit_noise_by_reweighting(
            solve, np.ones(len(group_indices)), len(group_numbers), arrivals.displacement_rounding
        )
        group_columns = np.eye(len(group_numbers))[group_indices]
        self.scatter, covariance = 1.0, np.diag(1.0 / np.bincount(group_indices))
        if freedom_within_groups > 0:
            self.scatter = max(
                float(np.sqrt(student_noise.variance)), arrivals.displacement_rounding
            )
            covariance = student_noise.coefficient_covariance(group_columns, places)
            covariance += np.eye(len(group_numbers)) * arrivals.displacement_rounding**2
            probe_indices = group_numbers % n_probes
            angle_variance = (arrivals.tip_radius * angle_deviation) ** 2
            covariance += angle_variance * (probe_indices[:, None] == probe_indices)
        super().__init__(
            nominal_angles,
            self.displacements,
            covariance,
            freedom_within_groups,
            arrivals.tip_radius,
        )

    def compute_displacement_changes_by_lines(
        self, arrivals: ArrivalTimes, fit: TipFit
    ) -> np.ndarray:
        """Return displacement changes by other vibrations: (revolutions, probes) [m].

        The vibrations, :attr:`lines` of the spectrum, have constant frequencies. They displace the
        blade tip, so a probe sees the tip at another angle, with another displacement by the engine
        order. ``fit`` is the engine order's fit.
        """
        group_angles = np.full(arrivals.time.shape, np.nan)
        group_angles[np.isfinite(arrivals.time)] = self.angles[self._group_indices]
        line_motion = sum(
            line_fit.displacement(line_fit.phases(arrivals)) - line_fit.coefficients[0]
            for line_fit in self.lines
        )
        moved_displacements = fit.displacement(group_angles - line_motion / arrivals.tip_radius)
        return moved_displacements - fit.displacement(group_angles)

    def compute_wave_residual_square_sum(
        self, wave: np.ndarray, order: float, multiples: np.ndarray
    ) -> float:
        """Return how much of a wave another order leaves unexplained.

        ``order`` with harmonics ``multiples`` (K,) is fitted to the wave (g,) [m] at the nominal
        angles. The result is the sum of squared residuals, in variances.
        """
        wave_columns = fourier_basis(order * self.nominal_angles, multiples)
        wave_columns, whitened_wave = self._whiten_columns_and_values(
            wave_columns, wave, np.ones(len(wave))
        )
        residuals = (
            whitened_wave
            - wave_columns @ np.linalg.lstsq(wave_columns, whitened_wave, rcond=1e-10)[0]
        )
        return float(residuals @ residuals)

    def compute_rms_residual(self, order: float, multiples: np.ndarray) -> float:
        """Return the root mean square residual of all arrivals for an order [m].

        The order, with harmonics ``multiples`` (K,), is fitted to the means without weights.
        """
        wave_columns = fourier_basis(order * self.angles, multiples)
        coefficients = np.linalg.lstsq(wave_columns, self.displacements, rcond=1e-10)[0]
        residuals = self._arrival_displacements - (wave_columns @ coefficients)[self._group_indices]
        return float(np.sqrt(np.mean(residuals**2)))


# --- run-ups --------------------------------------------------------------------------------------


@dataclass(frozen=True, repr=False)
class TipTrack(HarmonicFit):
    """Hold harmonics at a known engine order, revolution by revolution.

    Attributes
    ----------
    order : float
        Periods of the load in a revolution.
    speed : (n,) [rad/s]
        Mean speed of each group of revolutions.
    multiples : (K,)
        Harmonics, as in :class:`TipFit`.
    coefficients : (n, 2K+1) [m]
        a0, a1, b1, ....
    amplitudes, amplitude_errors : (n, K) [m]
        Amplitudes with standard errors. Both are nan if too many arrivals are missing; errors also
        without a spare arrival, or with two or fewer degrees of freedom in all.
    misfit : float
        Probability that chance correlates residuals as much between revolutions. If it is tiny,
        harmonics are missing, and folded onto the fitted ones. nan without more probes than
        unknowns, since anything then fits.
    folded : float
        As in :class:`TipFit`, for the groups with the largest amplitude of a harmonic.
    """

    order: float
    speed: np.ndarray
    multiples: np.ndarray
    coefficients: np.ndarray
    amplitudes: np.ndarray
    amplitude_errors: np.ndarray
    misfit: float
    folded: float = np.nan

    @property
    def in_doubt(self) -> bool:
        """True if a test of the fit fails, or cannot be made.

        A misfit has a probability below 0.001, or omitted harmonics may shift an amplitude. A
        probability is nan without a test, for instance with as many unknowns as probes.
        """
        is_chance_unknown = np.isnan([self.misfit, self.folded])
        return self.does_not_fit or self.may_be_folded or bool(np.any(is_chance_unknown))

    frequency = hertz_property()

    @property
    def omega(self) -> np.ndarray:
        """Angular frequency of the load for each group of revolutions: (n,) [rad/s]."""
        return np.asarray(self.order * self.speed)

    def to_dict(self) -> dict[str, Any]:
        """Return columns by name, with a row for every group of revolutions."""
        column_by_name = add_frequency_entries(
            {"speed": self.speed.tolist(), "omega": self.omega.tolist()}
        )
        for multiple_index, multiple in enumerate(self.multiples):
            column_by_name[f"amplitude_{multiple:g}"] = self.amplitudes[:, multiple_index].tolist()
            column_by_name[f"amplitude_error_{multiple:g}"] = self.amplitude_errors[
                :, multiple_index
            ].tolist()
        return column_by_name

    def _unit_by_name(self) -> Mapping[str, str]:
        return UNIT_BY_NAME | {name: "m" for name in self.to_dict() if name.startswith("amplitude")}

    def _repr_text(self) -> str:
        speeds_text = f"{self.speed[0]:.6g} to {self.speed[-1]:.6g} rad/s"
        points_text = format_count(len(self.speed), "point")
        return ", ".join([f"order {self.order:g}", speeds_text, points_text, *self._doubt_texts])


def track_order(
    arrivals: ArrivalTimes,
    order: float,
    *,
    harmonics: int = 1,
    subharmonic: int = 1,
    revolutions: int = 1,
    angle_deviation: float = 0.0,
) -> TipTrack:
    """Fit the harmonics of a known engine order in a run-up.

    :func:`fit_order` with one candidate is applied to groups of ``revolutions`` revolutions. A
    vibration with twice the load's period and an odd order needs two or more revolutions. Linear
    changes within a group are subtracted. The errors include the uncertain position of the fit
    within the group. Differences between residuals of neighbouring fits give the variance of an
    arrival.

    Residuals that repeat are a misfit by omitted harmonics. As in :func:`fit_order`, omitted
    harmonics are further unknowns, here with the same ratio to the vibration in neighbouring fits.
    If they are significant, the standard errors include their folding; otherwise ``folded`` is the
    risk.

    Parameters
    ----------
    arrivals, harmonics, subharmonic, angle_deviation
        As in :func:`fit_order`.
    order : float
        Periods of the load in a revolution.
    revolutions : int
        Number of revolutions in each fit.

    Returns
    -------
    TipTrack
        Amplitudes and phases with standard errors, and the speed of each fit.

    Raises
    ------
    InputError
        A value cannot be used, or these probes cannot measure this order in so few revolutions.

    Examples
    --------
    >>> track = fc.track_order(arrivals, 6)
    """
    _, multiples = make_orders_and_multiples([order], harmonics, subharmonic)
    check_count("revolutions", revolutions, 1)
    arrivals.check_places(angle_deviation)
    n_groups, n_unknowns = len(arrivals) // revolutions, 2 * len(multiples) + 1
    n_probes = len(arrivals.probes)
    if not n_groups:
        raise InputError("revolutions", revolutions, f"at most {len(arrivals)}, all of the record")
    first_phases = order * arrivals.nominal_angle[:revolutions].ravel()
    if np.isinf(condition_number(fourier_basis(first_phases, multiples))):
        raise_too_few_probes(arrivals, n_unknowns)
    angles, nominal_angles, displacements = (
        source_array[: n_groups * revolutions].reshape(n_groups, revolutions * n_probes)
        for source_array in (arrivals.angle, arrivals.nominal_angle, arrivals.displacement)
    )
    has_arrival = np.isfinite(displacements)
    n_arrivals, displacements = has_arrival.sum(axis=1), np.where(has_arrival, displacements, 0.0)
    wave_columns, nominal_columns = (
        np.where(has_arrival[..., None], fourier_basis(order * angle_array, multiples), 0.0)
        for angle_array in (np.nan_to_num(angles), nominal_angles)
    )
    has_fit = np.linalg.matrix_rank(nominal_columns, tol=1e-6) == n_unknowns
    column_pseudoinverses = np.linalg.pinv(wave_columns)
    group_angle = RAD_PER_TURN * revolutions
    positions = (nominal_angles - nominal_angles[:, :1] + arrivals.probes[0]) / group_angle - 0.5
    displacements, coefficient_changes = _subtract_linear_changes(
        displacements, column_pseudoinverses, wave_columns, positions, np.flatnonzero(has_fit)
    )
    coefficients = column_pseudoinverses @ displacements[..., None]
    residuals = np.where(
        has_arrival & has_fit[:, None], displacements - (wave_columns @ coefficients)[..., 0], 0.0
    )
    places = np.nonzero(has_arrival.reshape(-1, n_probes))
    n_spare = n_probes * (subharmonic if revolutions > 1 else 1) - n_unknowns
    misfit = np.nan
    if n_spare > 0:
        misfit = correlation_p_value(residuals.reshape(-1, n_probes)[places], places)
    variance, freedom = _estimate_variance_and_freedom(
        residuals, has_arrival, np.where(has_fit, n_arrivals - n_unknowns, 0)
    )
    variance = max(variance, arrivals.displacement_rounding**2)
    sample_fit_by_group = _fit_samples_by_group(
        arrivals, order, multiples, nominal_angles, displacements, has_arrival,
        np.flatnonzero(has_fit), variance, freedom, angle_deviation,
    )  # fmt: skip
    if n_spare > 1 and freedom > 0:
        sample_fit_by_group = _refit_groups_with_omitted_harmonics(sample_fit_by_group)
    coefficients, covariances = _find_coefficients_and_covariances(
        sample_fit_by_group, n_arrivals, coefficient_changes, freedom
    )
    amplitudes, errors = compute_amplitudes_and_errors(coefficients, covariances)
    fold_risk = np.nan
    if n_spare > 1 and freedom > 0 and sample_fit_by_group:
        peak_groups = {int(np.nanargmax(group_amplitudes)) for group_amplitudes in amplitudes.T}
        fold_risk = max(
            sample.compute_folding_chance(fit)
            for sample, fit in map(sample_fit_by_group.__getitem__, peak_groups)
        )
    group_marks = arrivals.marks[: n_groups * revolutions + 1 : revolutions]
    speeds = 2.0 * np.pi * revolutions / np.diff(group_marks)
    return TipTrack(order, speeds, multiples, coefficients, amplitudes, errors, misfit, fold_risk)


def _fit_samples_by_group(
    arrivals: ArrivalTimes,
    order: float,
    multiples: np.ndarray,
    nominal_angles: np.ndarray,
    displacements: np.ndarray,
    has_arrival: np.ndarray,
    fitted_groups: np.ndarray,
    variance: float,
    freedom: int,
    angle_deviation: float,
) -> dict[int, tuple[_Sample, _OrderFit]]:
    """Fit an order to each group of revolutions.

    There are n groups with up to m arrivals each.

    Parameters
    ----------
    arrivals, order, multiples, angle_deviation
        Record, order p, multiples (K,), and probe angles' standard deviation [rad].
    nominal_angles, displacements, has_arrival : (n, m)
        Rotor angles without vibration [rad], displacements [m], and True for an arrival.
    fitted_groups : (k,)
        Indices for groups with enough arrivals.
    variance, freedom : float [m^2], int
        Displacement variance, and its degrees of freedom.

    Returns
    -------
    dict of int to (_Sample, _OrderFit)
        Displacements and fit by group index, without groups of which the probes cannot measure the
        order.
    """
    probe_indices = np.arange(has_arrival.shape[1]) % len(arrivals.probes)
    shares_probe_matrix = probe_indices[:, None] == probe_indices
    covariance = variance * np.eye(len(probe_indices))
    covariance += (arrivals.tip_radius * angle_deviation) ** 2 * shares_probe_matrix
    sample_fit_by_group = {}
    for group_index in fitted_groups.tolist():
        is_used = has_arrival[group_index]
        sample = _Sample(
            nominal_angles[group_index, is_used],
            displacements[group_index, is_used],
            covariance[np.ix_(is_used, is_used)],
            freedom,
            arrivals.tip_radius,
        )
        if (fit := sample.fit_order_or_none(order, multiples)) is not None:
            sample_fit_by_group[group_index] = sample, fit
    return sample_fit_by_group


def _find_coefficients_and_covariances(
    sample_fit_by_group: dict[int, tuple[_Sample, _OrderFit]],
    n_arrivals: np.ndarray,
    coefficient_changes: np.ndarray,
    freedom: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Return coefficients and covariances of n groups; nan without a fit.

    Parameters
    ----------
    sample_fit_by_group : dict
        Samples and fits by group index.
    n_arrivals, coefficient_changes : (n,), (n, 2K+1) [m]
        Arrivals in each group, and changes by :func:`_subtract_linear_changes`.
    freedom : int
        Degrees of freedom of the displacement variance.

    Returns
    -------
    coefficients : (n, 2K+1) [m]
        a0, a1, b1, ....
    covariances : (n, 2K+1, 2K+1) [m^2]
        Covariances of the coefficients; nan also without a spare arrival.
    """
    coefficients = np.full(coefficient_changes.shape, np.nan)
    n_unknowns = coefficient_changes.shape[1]
    covariances = np.full((len(n_arrivals), n_unknowns, n_unknowns), np.nan)
    for group_index, (sample, fit) in sample_fit_by_group.items():
        coefficients[group_index] = fit.coefficients
        if n_arrivals[group_index] > n_unknowns:
            factor, _, total_freedom = sample.run_misfit_f_test(fit.sum_of_squares, n_unknowns)
            factor = max(factor, 1.0) if freedom else factor
            covariances[group_index] = (
                factor * student_variance_ratio(total_freedom) * fit.covariance
            )
            covariances[group_index] += np.outer(
                coefficient_changes[group_index], coefficient_changes[group_index]
            )
    return coefficients, covariances


def _subtract_linear_changes(
    displacements: np.ndarray,
    column_pseudoinverses: np.ndarray,
    wave_columns: np.ndarray,
    group_positions: np.ndarray,
    fitted_groups: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Subtract the linear change of the vibration within each group.

    The change would look like further harmonics. There are n groups with m arrivals each.

    Parameters
    ----------
    displacements, group_positions : (n, m)
        Displacements [m], and arrivals' distances behind the group's middle, in group lengths.
    column_pseudoinverses, wave_columns : (n, 2K+1, m), (n, m, 2K+1)
        Pseudoinverses of the columns, and columns of the fits.
    fitted_groups : (k,)
        Indices for groups with enough arrivals.

    Returns
    -------
    displacements : (n, m) [m]
        Displacements without the change.
    coefficient_changes : (n, 2K+1) [m]
        Change of the coefficients between the group's middle and the middle of its arrivals.
    """
    coefficient_rates = np.zeros(column_pseudoinverses.shape[:2])
    if len(fitted_groups) > 1:
        coefficient_rows = (column_pseudoinverses @ displacements[..., None])[fitted_groups, :, 0].T
        coefficient_rates[fitted_groups] = np.gradient(
            [smooth_series(coefficient_series) for coefficient_series in coefficient_rows],
            fitted_groups,
            axis=1,
        ).T
    displacement_changes = group_positions * (wave_columns @ coefficient_rates[..., None])[..., 0]
    return displacements - displacement_changes, group_positions.mean(
        axis=1, keepdims=True
    ) * coefficient_rates


def _refit_groups_with_omitted_harmonics(
    sample_fit_by_group: dict[int, tuple[_Sample, _OrderFit]],
) -> dict[int, tuple[_Sample, _OrderFit]]:
    """Repeat the fits of all groups with omitted harmonics.

    The size of omitted harmonics, relative to the vibration, is the likeliest in a group and 16
    neighbours on either side: few probes in one group do not determine the size. Neighbours with
    wrong arrivals do not count.
    """
    group_costs, group_fits = [], []
    for sample, fit in sample_fit_by_group.values():
        omitted_sizes = np.minimum(
            np.linalg.norm(fit.coefficients[1:]) * FOLDED_SIZE_RATIOS,
            sample.max_allowed_omitted_size,
        )
        size_costs, size_fits = sample.list_costs_and_fits_by_omitted_size(fit, omitted_sizes)
        group_costs.append(size_costs)
        group_fits.append(size_fits)
    residual_square_sums = np.array([fit.sum_of_squares for _, fit in sample_fit_by_group.values()])
    spare_counts = [
        len(sample.displacements) - len(fit.coefficients)
        for sample, fit in sample_fit_by_group.values()
    ]
    freedoms = np.maximum(spare_counts, 1)
    joint_fit_by_group = {}
    for sample_position, (group_index, (sample, _)) in enumerate(sample_fit_by_group.items()):
        window_slice = slice(
            max(sample_position - N_NEIGHBOURS_PER_SIDE, 0),
            sample_position + N_NEIGHBOURS_PER_SIDE + 1,
        )
        max_trusted_squares = _estimate_quartile_variance(
            residual_square_sums[window_slice], freedoms[window_slice]
        ) * chdtri(freedoms[window_slice], CONFIDENCE_LEVELS.misfit_significance_level)
        # Groups above the limit have wrong arrivals.
        trusted_cost_rows = np.array(group_costs[window_slice])[
            residual_square_sums[window_slice] <= max_trusted_squares
        ]
        joint_fit_by_group[group_index] = (
            sample,
            group_fits[sample_position][int(np.argmin(trusted_cost_rows.sum(axis=0)))],
        )
    return joint_fit_by_group


def _estimate_variance_and_freedom(
    residuals: np.ndarray, has_arrival: np.ndarray, freedoms: np.ndarray
) -> tuple[float, int]:
    """Estimate the variance of an arrival from the residuals of groups.

    The variance follows from differences between neighbouring groups, and wrong arrivals hardly
    change it. Without differences, it is the mean square per degree of freedom; 1 without degrees
    of freedom.

    Parameters
    ----------
    residuals, has_arrival : (n, m) [m]
        Residuals in n groups, and True for an arrival.
    freedoms : (n,)
        Arrivals less unknowns of each group.

    Returns
    -------
    variance : float [m^2]
        Displacement variance.
    freedom : int
        Degrees of freedom of the variance; 0 without differences.
    """
    total_freedom, has_arrival_pair = freedoms.sum(), has_arrival[1:] & has_arrival[:-1]
    freedoms = np.minimum(freedoms[1:], freedoms[:-1])
    is_usable = freedoms > 0
    if not np.any(is_usable):
        return (float((residuals**2).sum()) / total_freedom if total_freedom else 1.0), 0
    difference_square_sums = 0.5 * (
        np.where(has_arrival_pair, np.diff(residuals, axis=0), 0.0) ** 2
    ).sum(axis=1)
    return _estimate_quartile_variance(difference_square_sums[is_usable], freedoms[is_usable]), int(
        freedoms[is_usable].sum()
    ) // 2


def _estimate_quartile_variance(residual_square_sums: np.ndarray, freedoms: np.ndarray) -> float:
    """Estimate a variance from the lower quartile of sums of squares.

    ``residual_square_sums`` (n,) have degrees of freedom ``freedoms`` (n,). Nearly three quarters
    of the sums may have wrong arrivals.
    """
    return float(np.quantile(residual_square_sums / chdtri(freedoms, 0.75), 0.25))
