"""Fit synchronous vibration to arrival times: engine order and harmonics.

The circumferential Fourier fit by least squares, at constant speed; :mod:`track_order` is for
run-ups. At engine order p, each probe at angle phi sees the same point in every revolution. With
displacement u, rotor angle alpha, coefficients a_k and b_k, and harmonics k = 1 ... K,

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
from collections.abc import Iterable
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import product

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import fdtrc, ndtr

from fenics_crack.arrivals.arrival_times import ArrivalTimes
from fenics_crack.arrivals.fit_frequency import find_lines_and_residuals
from fenics_crack.arrivals.harmonics import (
    DEFAULT_TRIAL_ORDERS,
    Candidates,
    TipFit,
    compute_amplitudes_and_errors,
    condition_number,
    make_orders_and_multiples,
    raise_too_few_probes,
    select_candidate,
)
from fenics_crack.arrivals.robust import (
    MAX_DEPENDENT_EIGENVALUE_RATIO,
    SIGNIFICANCE_LIMITS,
    fit_noise_by_reweighting,
    student_variance_ratio,
)
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.tables import RAD_PER_TURN
from fenics_crack.numerics.fourier import fourier_basis

N_OMITTED_HARMONICS_TO_FOLD = 3
"""Number of omitted harmonics, next above the fitted ones, that may be folded onto them."""
TRIAL_OMITTED_HARMONIC_RATIOS = np.array([0.0, *2.0 ** -np.arange(0.5, 8.0)])
"""Trial sizes of an omitted harmonic: 0, and 0.71 down to 0.0055.

Sizes are relative to the amplitude of the last fitted harmonic; in a run-up, to the norm of all
fitted coefficients.
"""


def fit_order(
    arrivals: ArrivalTimes,
    orders: Iterable[float] = DEFAULT_TRIAL_ORDERS,
    *,
    harmonics: int = 1,
    subharmonic: int = 1,
    angle_deviation: float = 0.0,
) -> TipFit:
    """Find the engine order and harmonics of a vibration by least squares.

    First, the displacements are averaged at each probe over the revolutions. Vibrations at no
    engine order are fitted, too (``asynchronous`` in the result). Single wrong arrivals have hardly
    any weight, since errors follow Student's t distribution. Each candidate order is then fitted to
    the means.

    An order fits equally well if the sum of squared residuals exceeds the least sum by less than 9
    variances of a mean. The result is one of the equally good orders. Orders with a vibration more
    than 20 % larger than the smallest are excluded; then the least sum decides. The result has the
    other equally good orders in ``ambiguous_orders``, and orders that these probes cannot measure
    in ``hidden``.

    The variance of a mean combines the arrivals' scatter and the probe angle's error. If the means
    differ from the fit by more (F test), the variance follows from these differences. Harmonics
    above the fitted ones may change the fitted coefficients. If this change is significant, the
    standard errors include it. Otherwise ``folded`` is the probability of a large change.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Measured or simulated, at a constant speed. :func:`track_order` is for run-ups.
    orders : iterable of float
        Candidates: periods of the load in a revolution, whole numbers or fractions with small
        denominators. Orders from a Campbell diagram are distinguished most easily.
    harmonics : int
        Number K of fitted harmonics. With 2 or more, :meth:`TipFit.ratio` shows a breathing crack.
    subharmonic : int
        Response period divided by the load's period. For 2, harmonics are 1/2, 1, ..., K/2 times
        the load's frequency.
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
    if means.lines and not fit.does_not_fit:  # repeat: lines displace the tip to other angles
        line_displacement_changes = means.compute_changes_by_spectral_lines(arrivals, fit)
        means = ProbeMeans(
            arrivals, period_in_revolutions, max_order, angle_deviation, line_displacement_changes
        )
        fit = _fit_best_order(arrivals, means, candidate_orders, multiples)
    return fit


def _fit_best_order(
    arrivals: ArrivalTimes, means: ProbeMeans, orders: np.ndarray, multiples: np.ndarray
) -> TipFit:
    """Fit all candidate orders, and select the best.

    Among orders with equally small residuals, the one with the smallest vibration is the best.

    Parameters
    ----------
    arrivals, means : ArrivalTimes, ProbeMeans
        Arrivals, and their means at each probe.
    orders, multiples : (n,), (K,)
        Candidate orders, and the fitted harmonics as multiples of the load's frequency.
    """
    n_unknowns = 2 * len(multiples) + 1
    fit_by_index = {
        index: fit
        for index, order in enumerate(orders)
        if (fit := means.fit_order_or_none(order, multiples)) is not None
    }
    if not fit_by_index:
        raise_too_few_probes(arrivals, n_unknowns)
    residual_square_sums, vibration_sizes, costs = np.full((3, len(orders)), np.inf)
    for order_index, fit in fit_by_index.items():
        residual_square_sums[order_index] = fit.sum_of_squares
        vibration_sizes[order_index] = np.linalg.norm(fit.coefficients[1:])
    estimated_to_assumed_variance, misfit, freedom = means.run_misfit_f_test(
        float(residual_square_sums.min()), n_unknowns
    )
    is_equivalent, best_index = select_candidate(
        residual_square_sums,
        vibration_sizes,
        SIGNIFICANCE_LIMITS.allowed_cost_difference * estimated_to_assumed_variance,
    )
    best_fit = fit_by_index[best_index]
    # Displaced arrivals distinguish aliases, but not reliably: compare at the probes' angles.
    best_wave = (
        fourier_basis(orders[best_index] * means.rotor_angles_without_vibration, multiples)
        @ best_fit.coefficients
    )
    wave_residual_square_sums = np.array(
        [means.compute_wave_residual_square_sum(best_wave, order, multiples) for order in orders]
    )
    is_equivalent |= (
        wave_residual_square_sums
        < SIGNIFICANCE_LIMITS.allowed_cost_difference * estimated_to_assumed_variance
    )
    covariance_factor = finite_variance_ratio = (
        estimated_to_assumed_variance if np.isfinite(estimated_to_assumed_variance) else np.nan
    )
    if means.covariance_degrees_of_freedom > 0 and len(means.displacements) > n_unknowns + 1:
        # An order is not excluded if omitted harmonics explain the difference.
        for order_index, fit in fit_by_index.items():
            costs[order_index], fit_by_index[order_index] = means.refit_with_higher_harmonics(fit)
        is_equivalent |= costs - costs.min() < SIGNIFICANCE_LIMITS.allowed_cost_difference
        best_fit = fit_by_index[best_index]
        covariance_factor, _, freedom = means.run_misfit_f_test(best_fit.sum_of_squares, n_unknowns)
        covariance_factor = max(covariance_factor, 1.0)
    best_fit = replace(
        best_fit,
        covariance=covariance_factor * student_variance_ratio(freedom) * best_fit.covariance,
    )
    return TipFit(
        order=float(orders[best_index]),
        order_error=0.0,
        speed=arrivals.mean_speed,
        multiples=multiples,
        coefficients=best_fit.coefficients,
        covariance=best_fit.covariance,
        scatter=means.scatter * float(np.sqrt(finite_variance_ratio)),
        misfit=misfit,
        folded=means.compute_amplitude_error_probability(best_fit),
        candidates=_make_candidates(
            means, orders, multiples, is_equivalent, np.isinf(residual_square_sums)
        ),
        spare=len(means.displacements) - n_unknowns,
        asynchronous=means.lines,
    )


def _make_candidates(
    means: ProbeMeans,
    orders: np.ndarray,
    multiples: np.ndarray,
    is_equivalent: np.ndarray,
    is_hidden: np.ndarray,
) -> Candidates:
    """Return the table of candidate orders, with residuals and condition numbers.

    Parameters
    ----------
    means : ProbeMeans
        Mean displacements at the probes.
    orders, multiples : (n,), (K,)
        Candidate orders, and the harmonics as multiples of the load's frequency.
    is_equivalent, is_hidden : (n,) bool
        True for orders that fit as well as the best, and for orders without a fit.
    """
    condition_numbers = [
        condition_number(fourier_basis(order * means.rotor_angles_without_vibration, multiples))
        for order in orders
    ]
    rms_residuals = [means.compute_rms_residual(order, multiples) for order in orders]
    return Candidates(
        orders, np.array(rms_residuals), np.array(condition_numbers), is_equivalent, is_hidden
    )


def _find_period_in_revolutions(orders: np.ndarray, multiples: np.ndarray) -> int:
    """Return the number of revolutions after which every probe sees the same motion.

    The motion has all frequencies order times multiple, relative to the speed. ``orders`` (n,) are
    engine orders; ``multiples`` (K,) are harmonics of the load's frequency. InputError if the
    motion does not repeat within 24 revolutions.
    """
    max_allowed_period = 24
    response_orders = np.multiply.outer(orders, multiples).ravel()
    orders_as_fractions = [
        Fraction(response_order).limit_denominator(max_allowed_period)
        for response_order in response_orders.tolist()
    ]
    period_in_revolutions = math.lcm(
        *(order_as_fraction.denominator for order_as_fraction in orders_as_fractions)
    )
    if period_in_revolutions > max_allowed_period or np.any(
        np.abs(
            [float(order_as_fraction) for order_as_fraction in orders_as_fractions]
            - response_orders
        )
        > 1e-9
    ):
        requirement_text = (
            f"whole numbers, or fractions that repeat within {max_allowed_period} revolutions"
        )
        raise InputError("orders", orders.tolist(), f"{requirement_text}; else use fit_frequency")
    return period_in_revolutions


@dataclass(frozen=True)
class OrderFit:
    """Hold the least-squares fit of one engine order with K harmonics to g displacements.

    Attributes
    ----------
    order : float
        Periods of the load in a revolution.
    multiples : (K,)
        Harmonics, as multiples of the load's frequency.
    coefficients : (2K+1,) [m]
        Constant, and cosine and sine coefficients of the harmonics: a0, a1, b1, ....
    covariance : (2K+1, 2K+1) [m^2]
        Covariance of the coefficients.
    sum_of_squares : float
        Sum of squared residuals, each in units of the standard deviation.
    residual_slope_by_displacement : (g,)
        Derivative of each residual by the measured displacement: 1 + u' / R. Here u is the fitted
        displacement, alpha the rotor angle, u' = du / d alpha, and R the tip radius. The term u' /
        R arises because the measured displacement also changes alpha.
    """

    order: float
    multiples: np.ndarray
    coefficients: np.ndarray
    covariance: np.ndarray
    sum_of_squares: float
    residual_slope_by_displacement: np.ndarray


class Sample:
    """Hold g displacements at rotor angles, with the covariance of their errors.

    Parameters
    ----------
    rotor_angles_without_vibration : (g,) [rad]
        Rotor angles when the blade tip without vibration passes the probes.
    displacements : (g,) [m]
        Displacements.
    covariance : (g, g) [m^2]
        Covariance of the errors of the displacements, estimated before the fit.
    covariance_degrees_of_freedom : int
        Degrees of freedom of this estimate. For means of arrivals: number of arrivals less number
        of means. 0 without an estimate: the covariance is then known but for a factor.
    tip_radius : float [m]
        Blade tip radius.

    Attributes
    ----------
    arrival_rotor_angles : (g,) [rad]
        Rotor angles when the displaced blade tip passes the probes.
    """

    def __init__(
        self,
        rotor_angles_without_vibration: np.ndarray,
        displacements: np.ndarray,
        covariance: np.ndarray,
        covariance_degrees_of_freedom: int,
        tip_radius: float,
    ) -> None:
        self.rotor_angles_without_vibration = rotor_angles_without_vibration
        self.displacements = displacements
        self.covariance_degrees_of_freedom = covariance_degrees_of_freedom
        self._tip_radius = tip_radius
        self.arrival_rotor_angles = rotor_angles_without_vibration - displacements / tip_radius
        self.covariance = covariance
        # The error of a probe's angle is common to all means of the probe: nearly singular.
        self._covariance_cholesky_factor = np.linalg.cholesky(
            covariance + MAX_DEPENDENT_EIGENVALUE_RATIO * np.diag(np.diag(covariance))
        )

    def fit_order_or_none(self, order: float, multiples: np.ndarray) -> OrderFit | None:
        """Fit an engine order by least squares, with harmonics ``multiples`` (K,).

        The harmonics are multiples of the load's frequency. Return None if the angles cannot
        determine the coefficients. Also None if the fitted vibration is so fast that the blade tip
        would move backwards past the probe.
        """
        wave_columns = fourier_basis(order * self.arrival_rotor_angles, multiples)
        nominal_columns = fourier_basis(order * self.rotor_angles_without_vibration, multiples)
        if np.isinf(condition_number(nominal_columns)) or np.isinf(condition_number(wave_columns)):
            return None
        residual_slope_by_displacement = np.ones(len(wave_columns))
        # An arrival late by e [s] has a residual of the size R W e (1 + u' / R): the fit is
        # evaluated at a rotor angle larger by W e.
        for _ in range(2):
            fitted_residual_per_error = residual_slope_by_displacement
            (whitened_columns, whitened_displacements) = self._whiten_columns_and_values(
                wave_columns, self.displacements, residual_slope_by_displacement
            )
            coefficients = np.linalg.lstsq(whitened_columns, whitened_displacements, rcond=None)[0]
            harmonic_derivatives_by_phase = (
                wave_columns[:, 1::2] * coefficients[2::2]
                - wave_columns[:, 2::2] * coefficients[1::2]
            )
            residual_slope_by_displacement = (
                1.0 + order * harmonic_derivatives_by_phase @ multiples / self._tip_radius
            )
            if np.any(residual_slope_by_displacement <= 0.0):
                return None
        residuals = whitened_displacements - whitened_columns @ coefficients
        covariance = np.linalg.inv(whitened_columns.T @ whitened_columns)
        return OrderFit(
            order,
            multiples,
            coefficients,
            covariance,
            float(residuals @ residuals),
            fitted_residual_per_error,
        )

    def _whiten_columns_and_values(
        self, columns: np.ndarray, values: np.ndarray, residual_slope_by_displacement: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Scale least-squares equations to make errors independent with variance 1.

        There are g equations, one for each displacement, and m unknowns. Each equation is divided
        by an entry of ``residual_slope_by_displacement``. All equations are then multiplied by the
        inverse Cholesky factor for the attribute ``covariance``.

        Parameters
        ----------
        columns : (g, m)
            Derivatives of the fitted displacements by the unknowns.
        values : (g,) [m]
            Right-hand sides of the equations.
        residual_slope_by_displacement : (g,)
            Derivative of each residual by the displacement.

        Returns
        -------
        columns, values : (g, m), (g,)
            The scaled equations.
        """
        columns_and_values = (
            np.column_stack([columns, values]) / residual_slope_by_displacement[:, None]
        )
        columns_and_values = solve_triangular(
            self._covariance_cholesky_factor, columns_and_values, lower=True
        )
        return columns_and_values[:, :-1], columns_and_values[:, -1]

    def refit_with_higher_harmonics(self, fit: OrderFit) -> tuple[float, OrderFit]:
        """Repeat a fit with the three next higher harmonics as further unknowns.

        Used to include errors by harmonics omitted in ``fit``. The further coefficients have the
        expected value 0, and a standard deviation. Several standard deviations are tried, 0 among
        them, and the likeliest is used. With 0, the fit is unchanged. The number three is
        :data:`N_OMITTED_HARMONICS_TO_FOLD`.

        Returns
        -------
        cost : float
            Restricted -2 log likelihood.
        fit : OrderFit
            New coefficients and covariance, with the errors by omitted harmonics.
        """
        costs, fits_by_omitted_size = self.list_refits_by_harmonic_size(
            fit, self._list_omitted_harmonic_deviations(fit)
        )
        best_index = int(np.argmin(costs))
        return float(costs[best_index]), fits_by_omitted_size[best_index]

    def list_refits_by_harmonic_size(
        self, fit: OrderFit, omitted_sizes: np.ndarray
    ) -> tuple[np.ndarray, list[OrderFit]]:
        """Repeat a fit for several sizes of omitted harmonics.

        ``omitted_sizes`` (n,) [m] are standard deviations of the three omitted harmonics'
        coefficients.

        Returns
        -------
        costs : (n,)
            Restricted -2 log likelihood for each size.
        fits : list of OrderFit
            Fit for each size.
        """
        costs, *estimate_arrays = self._refit_with_omitted_harmonics(
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

    def compute_amplitude_error_probability(self, fit: OrderFit) -> float:
        """Return the probability that omitted harmonics make an amplitude wrong.

        An amplitude is wrong if it is off by over three standard errors; the worst amplitude of the
        fit counts. Each of three omitted harmonics has several trial sizes (standard deviations).
        The probability is the mean over all combinations of sizes, weighted with their likelihood.
        nan if ``covariance_degrees_of_freedom`` is 0: errors are then unknown.
        """
        if self.covariance_degrees_of_freedom < 1:
            return np.nan
        harmonic_sizes_by_trial = np.array(
            list(
                product(
                    self._list_omitted_harmonic_deviations(fit), repeat=N_OMITTED_HARMONICS_TO_FOLD
                )
            )
        )
        costs, *estimate_arrays, _ = self._refit_with_omitted_harmonics(
            fit, harmonic_sizes_by_trial
        )
        trial_likelihoods = np.exp(0.5 * (costs.min() - costs))
        amplitudes_of_given_fit, fitted_amplitude_errors = compute_amplitudes_and_errors(
            fit.coefficients, fit.covariance
        )
        trial_amplitudes, trial_amplitude_errors = compute_amplitudes_and_errors(*estimate_arrays)
        allowed_amplitude_deviations = (
            SIGNIFICANCE_LIMITS.n_standard_errors_of_equal_fits * fitted_amplitude_errors
        )
        cdf_at_upper_amplitude_bound, cdf_at_lower_amplitude_bound = (
            ndtr(
                (amplitudes_of_given_fit + amplitude_deviation_bound - trial_amplitudes)
                / trial_amplitude_errors
            )
            for amplitude_deviation_bound in (
                allowed_amplitude_deviations,
                -allowed_amplitude_deviations,
            )
        )
        return 1.0 - float(
            (
                trial_likelihoods @ (cdf_at_upper_amplitude_bound - cdf_at_lower_amplitude_bound)
            ).min()
            / trial_likelihoods.sum()
        )

    def _list_omitted_harmonic_deviations(self, fit: OrderFit) -> np.ndarray:
        """Return trial standard deviations (n,) [m] of an omitted harmonic's coefficients.

        They are :data:`TRIAL_OMITTED_HARMONIC_RATIOS` times the amplitude of the highest fitted
        harmonic. Values above :attr:`max_trial_deviation_for_accuracy` are left out.
        """
        trial_deviations = np.hypot(*fit.coefficients[-2:]) * TRIAL_OMITTED_HARMONIC_RATIOS
        return np.asarray(
            trial_deviations[trial_deviations < self.max_trial_deviation_for_accuracy]
        )

    @property
    def max_trial_deviation_for_accuracy(self) -> float:
        """Maximum trial size [m] of harmonics above the fitted ones.

        The trial size is the assumed standard deviation of a harmonic's coefficients. The
        maximum keeps the normal equations accurate: 1e6 times the smallest diagonal entry of the
        Cholesky factor of ``covariance``.
        """
        return float(
            np.diag(self._covariance_cholesky_factor).min()
            / np.sqrt(MAX_DEPENDENT_EIGENVALUE_RATIO)
        )

    def _refit_with_omitted_harmonics(
        self, fit: OrderFit, harmonic_sizes_by_trial: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Repeat a fit with omitted harmonics as further unknowns, in n trials.

        Parameters
        ----------
        fit : OrderFit
            Fit without omitted harmonics.
        harmonic_sizes_by_trial : (n, N_OMITTED_HARMONICS_TO_FOLD) [m]
            Standard deviation of each omitted harmonic's coefficients; the expected value is 0.

        Returns
        -------
        costs : (n,)
            Restricted -2 log likelihoods.
        coefficients : (n, 2K+1) [m]
            Coefficients for the fitted harmonics.
        covariances : (n, 2K+1, 2K+1) [m^2]
            Covariances for these coefficients.
        residual_square_sums : (n,)
            Sums of squared residuals and omitted coefficients, over the standard deviations.
        """
        n_unknowns, multiples = len(fit.coefficients), fit.multiples
        omitted_multiples = multiples[-1] + multiples[0] * np.arange(
            1.0, N_OMITTED_HARMONICS_TO_FOLD + 1.0
        )
        wave_columns = fourier_basis(
            fit.order * self.arrival_rotor_angles, np.append(multiples, omitted_multiples)
        )
        log_gram_determinant = np.linalg.slogdet(
            wave_columns[:, :n_unknowns].T @ wave_columns[:, :n_unknowns]
        )[1]
        wave_columns, whitened_displacements = self._whiten_columns_and_values(
            wave_columns, self.displacements, fit.residual_slope_by_displacement
        )
        column_scales = np.ones((len(harmonic_sizes_by_trial), wave_columns.shape[1]))
        column_scales[:, n_unknowns:] = np.repeat(harmonic_sizes_by_trial, 2, axis=1)
        normal_matrices_by_trial = (
            column_scales[:, :, None] * (wave_columns.T @ wave_columns) * column_scales[:, None, :]
        )
        normal_matrices_by_trial += np.diag(np.arange(wave_columns.shape[1]) >= n_unknowns)
        covariances = np.linalg.inv(normal_matrices_by_trial)
        coefficients = (
            covariances @ (column_scales * (wave_columns.T @ whitened_displacements))[..., None]
        )[..., 0]
        residuals = whitened_displacements - (column_scales * coefficients) @ wave_columns.T
        residual_square_sums = (residuals**2).sum(axis=1) + (coefficients[:, n_unknowns:] ** 2).sum(
            axis=1
        )
        costs = (
            residual_square_sums
            + np.linalg.slogdet(normal_matrices_by_trial)[1]
            - log_gram_determinant
        )
        return (
            costs,
            coefficients[:, :n_unknowns],
            covariances[:, :n_unknowns, :n_unknowns],
            residual_square_sums,
        )

    def run_misfit_f_test(
        self, residual_square_sum: float, n_unknowns: int
    ) -> tuple[float, float, float]:
        """Test whether residuals exceed the assumed errors of the displacements (F test).

        Parameters
        ----------
        residual_square_sum : float
            Sum of squared residuals, each in units of the assumed standard deviation.
        n_unknowns : int
            Number of fitted coefficients.

        Returns
        -------
        ratio : float
            Estimated variance divided by the assumed variance; inf without degrees of freedom.
        chance : float
            Probability of residuals as large by chance; nan without a test.
        freedom : float
            Degrees of freedom of the estimated variance; inf for a significant misfit (probability
            below 0.01).
        """
        n_spare = len(self.displacements) - n_unknowns
        total_freedom = self.covariance_degrees_of_freedom + n_spare
        if self.covariance_degrees_of_freedom < 1:
            return (residual_square_sum / n_spare if n_spare else np.inf), np.nan, total_freedom
        if n_spare < 1:
            return 1.0, np.nan, total_freedom
        chance = float(
            fdtrc(n_spare, self.covariance_degrees_of_freedom, residual_square_sum / n_spare)
        )
        if chance < SIGNIFICANCE_LIMITS.errors_from_misfit_significance_level:
            return residual_square_sum / n_spare, chance, np.inf
        return (
            (self.covariance_degrees_of_freedom + residual_square_sum) / total_freedom,
            chance,
            total_freedom,
        )


class ProbeMeans(Sample):
    """Hold each probe's mean displacements over the revolutions, with their covariance.

    The motion repeats after a period in revolutions. A probe has a mean for each revolution in
    this period: g means in all.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Arrivals at a constant speed.
    period_in_revolutions : int
        Revolutions after which a probe sees the same motion again.
    max_order : float
        Largest candidate order. Vibrations at no engine order are searched, too, at frequencies up
        to the speed times this order + 1, or times 25 if larger.
    angle_deviation : float [rad]
        Probe angles' standard deviation.
    line_displacement_changes : (revolutions, probes) [m]
        Changes to subtract from the measured displacements, from
        :meth:`compute_changes_by_spectral_lines`; 0 in the first fit.

    Attributes
    ----------
    scatter : float [m]
        Standard deviation of a displacement from its mean; 1 if every mean has a single arrival.
    displacements, angles : (g,) [m, rad]
        Means, and rotor angles when the displaced blade tip passes the probes.
    covariance : (g, g) [m^2]
        Covariance of the means.
    lines : tuple of TipFit
        Vibrations with constant frequency at no engine order, found in the same arrivals.
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
        constant_indices = row_in_period[:, None] * n_probes + np.arange(n_probes)
        self.lines, displacements = find_lines_and_residuals(
            arrivals, arrivals.displacement - line_displacement_changes, constant_indices, max_order
        )
        has_arrival = np.isfinite(displacements)
        revolution_and_probe_indices = np.nonzero(has_arrival)
        group_numbers, group_indices = np.unique(constant_indices[has_arrival], return_inverse=True)
        self._arrival_displacements, self._group_indices = displacements[has_arrival], group_indices
        rotor_angles_without_vibration = arrivals.probes[
            group_numbers % n_probes
        ] + RAD_PER_TURN * (group_numbers // n_probes)
        covariance_degrees_of_freedom = len(group_indices) - len(group_numbers)

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
        if covariance_degrees_of_freedom > 0:
            self.scatter = max(
                float(np.sqrt(student_noise.equivalent_normal_variance)),
                arrivals.displacement_rounding,
            )
            covariance = student_noise.coefficient_covariance(
                group_columns, revolution_and_probe_indices
            )
            covariance += np.eye(len(group_numbers)) * arrivals.displacement_rounding**2
            probe_indices = group_numbers % n_probes
            angle_variance = (arrivals.tip_radius * angle_deviation) ** 2
            covariance += angle_variance * (probe_indices[:, None] == probe_indices)
        super().__init__(
            rotor_angles_without_vibration,
            self.displacements,
            covariance,
            covariance_degrees_of_freedom,
            arrivals.tip_radius,
        )

    def compute_changes_by_spectral_lines(self, arrivals: ArrivalTimes, fit: TipFit) -> np.ndarray:
        """Return how :attr:`lines` change the displacements by an engine order.

        The lines are vibrations with constant frequencies. Lines displace the blade tip, and the
        tip passes a probe at another rotor angle. The displacement at the engine order then
        differs. Used to correct the measured displacements before a second fit.

        Parameters
        ----------
        arrivals : ArrivalTimes
            The averaged arrivals.
        fit : TipFit
            Vibration at the engine order.

        Returns
        -------
        (revolutions, probes) [m]
            Displacement by ``fit`` with the lines, less the displacement without; nan without an
            arrival.
        """
        rotor_angles_at_means = np.full(arrivals.time.shape, np.nan)
        rotor_angles_at_means[np.isfinite(arrivals.time)] = self.arrival_rotor_angles[
            self._group_indices
        ]
        spectral_line_motion = sum(
            spectral_line_fit.displacement(spectral_line_fit.angles_at_arrivals(arrivals))
            - spectral_line_fit.coefficients[0]
            for spectral_line_fit in self.lines
        )
        displacements_at_moved_angles = fit.displacement(
            rotor_angles_at_means - spectral_line_motion / arrivals.tip_radius
        )
        return displacements_at_moved_angles - fit.displacement(rotor_angles_at_means)

    def compute_wave_residual_square_sum(
        self, wave: np.ndarray, order: float, multiples: np.ndarray
    ) -> float:
        """Fit an engine order to a given motion, and return the sum of squared residuals.

        A small sum means: the order looks like the best order at these probes.

        Parameters
        ----------
        wave : (g,) [m]
            Displacements by the best order, at the rotor angles without vibration.
        order : float
            Other engine order.
        multiples : (K,)
            Fitted harmonics, as multiples of the load's frequency.

        Returns
        -------
        float
            Sum of squared residuals, each divided by the standard deviation.
        """
        wave_columns = fourier_basis(order * self.rotor_angles_without_vibration, multiples)
        wave_columns, whitened_wave = self._whiten_columns_and_values(
            wave_columns, wave, np.ones(len(wave))
        )
        wave_residuals = (
            whitened_wave
            - wave_columns @ np.linalg.lstsq(wave_columns, whitened_wave, rcond=1e-10)[0]
        )
        return float(wave_residuals @ wave_residuals)

    def compute_rms_residual(self, order: float, multiples: np.ndarray) -> float:
        """Return the root mean square residual of all arrivals for an order [m].

        The order, with harmonics ``multiples`` (K,), is fitted to the means without weights.
        """
        wave_columns = fourier_basis(order * self.arrival_rotor_angles, multiples)
        coefficients = np.linalg.lstsq(wave_columns, self.displacements, rcond=1e-10)[0]
        residuals = self._arrival_displacements - (wave_columns @ coefficients)[self._group_indices]
        return float(np.sqrt(np.mean(residuals**2)))
