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
from fenics_crack.arrivals.fit_frequency import find_lines
from fenics_crack.arrivals.harmonics import (
    ORDERS,
    Candidates,
    HarmonicFit,
    TipFit,
    compute_amplitudes,
    condition,
    refuse_probes,
    select_candidate,
    wanted,
)
from fenics_crack.arrivals.robust import DEPENDENT, LEVELS, reweighted, student, trend
from fenics_crack.basics.errors import InputError, check_count
from fenics_crack.basics.tables import (
    RAD_PER_TURN,
    UNIT_BY_NAME,
    add_frequency_entries,
    format_count,
    hertz_property,
)
from fenics_crack.numerics.fourier import fourier_basis

N_FOLDED = 3
"""Number of omitted harmonics, next above the fitted ones, that may be folded onto them."""
FOLDED_RATIOS = np.array([0.0, *2.0 ** -np.arange(0.5, 8.0)])
"""Trial sizes of an omitted harmonic, relative to the last fitted harmonic.

In a run-up, neighbouring groups are compared relative to the whole vibration.
"""
NEIGHBOURS = 16
"""Number of groups on either side with the same ratios for omitted harmonics."""


def fit_order(
    arrivals: ArrivalTimes,
    orders: Iterable[float] = ORDERS,
    *,
    harmonics: int = 1,
    subharmonic: int = 1,
    angle_deviation: float = 0.0,
) -> TipFit:
    """Find the engine order and harmonics of a vibration by least squares.

    Each probe's mean over the revolutions is found beside vibrations without an order
    (``asynchronous`` in the fit). Errors follow Student's t, so that single wrong arrivals have
    hardly any weight. Each candidate is fitted to the means. Candidates fit equally well if their
    sum of squares is less than 9 variances above the minimum. The smallest such vibration is taken,
    or the least sum among sizes within 20 %; the other candidates are reported. Candidates with
    dependent columns at these probes are reported as hidden (:class:`Candidates`).

    The variance of a mean combines the residuals and the probe's angle. If the means are off by
    more (F test), their own misfit sets the variance, so that omitted harmonics do not pass for
    information. Significant omitted harmonics increase the errors; ``folded`` is the risk from the
    others.

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
        Standard deviation of the probes' angles, the same in every revolution.

    Returns
    -------
    TipFit
        The order, its harmonics with standard errors, and equally good orders.

    Raises
    ------
    InputError
        A value cannot be used, or these probes can measure none of the candidates.

    Examples
    --------
    >>> fit = fc.fit_order(arrivals, range(1, 13))
    """
    candidates, multiples = wanted(orders, harmonics, subharmonic)
    arrivals.check_places(angle_deviation)
    period, max_order = _find_period(candidates, multiples), float(candidates.max())
    means = Means(arrivals, period, max_order, angle_deviation)
    fit = _select_order(arrivals, means, candidates, multiples)
    if means.lines and not fit.does_not_fit:  # again at the angles to which lines move the tip
        line_effects = means.compute_line_effects(arrivals, fit)
        means = Means(arrivals, period, max_order, angle_deviation, line_effects)
        fit = _select_order(arrivals, means, candidates, multiples)
    return fit


def _select_order(
    arrivals: ArrivalTimes, means: Means, orders: np.ndarray, multiples: np.ndarray
) -> TipFit:
    """Fit all orders, and return the smallest of the best vibrations."""
    unknowns = 2 * len(multiples) + 1
    results = {place: means.fit(order, multiples) for place, order in enumerate(orders)}
    fits = {place: fit for place, fit in results.items() if fit is not None}
    if not fits:
        refuse_probes(arrivals, unknowns)
    hidden, (sums, sizes, costs) = np.full(len(orders), True), np.full((3, len(orders)), np.inf)
    for place, fit in fits.items():
        hidden[place], sums[place] = False, fit.sum_of_squares
        sizes[place] = np.linalg.norm(fit.coefficients[1:])
    ratio, misfit, freedom = means.test_misfit(float(sums.min()), unknowns)
    equivalent, choice = select_candidate(sums, sizes, LEVELS.equal * ratio)
    best_fit = fits[choice]
    # Arrivals that are not at the probes' angles distinguish aliases, but not reliably.
    wave = fourier_basis(orders[choice] * means.nominal, multiples) @ best_fit.coefficients
    distances = np.array([means.wave_sum_of_squares(wave, order, multiples) for order in orders])
    equivalent |= distances < LEVELS.equal * ratio
    factor = ratio if np.isfinite(ratio) else np.nan
    if means.within > 0 and len(means.values) > unknowns + 1:
        # Nor do harmonics that are left out make another order less likely.
        for place, fit in fits.items():
            costs[place], fits[place] = means.fit_with_omitted(fit)
        equivalent |= costs - costs.min() < LEVELS.equal
        best_fit = fits[choice]
        factor, _, freedom = means.test_misfit(best_fit.sum_of_squares, unknowns)
        factor = max(factor, 1.0)
    best_fit = replace(best_fit, covariance=factor * student(freedom) * best_fit.covariance)
    residuals = np.array([means.rms_residual(order, multiples) for order in orders])
    conditions = [condition(fourier_basis(order * means.nominal, multiples)) for order in orders]
    return TipFit(
        order=float(orders[choice]),
        order_error=0.0,
        speed=arrivals.mean_speed,
        multiples=multiples,
        coefficients=best_fit.coefficients,
        covariance=best_fit.covariance,
        scatter=means.scatter * float(np.sqrt(ratio if np.isfinite(ratio) else np.nan)),
        misfit=misfit,
        folded=means.folding_chance(best_fit),
        candidates=Candidates(orders, residuals, np.array(conditions), equivalent, hidden),
        spare=len(means.values) - unknowns,
        asynchronous=means.lines,
    )


def _find_period(orders: np.ndarray, multiples: np.ndarray) -> int:
    """Return the number of revolutions after which probes see the same motion.

    Raise InputError for products of ``orders`` and ``multiples`` with a period above 24
    revolutions.
    """
    limit = 24
    products = np.multiply.outer(orders, multiples).ravel()
    fractions = [Fraction(product).limit_denominator(limit) for product in products.tolist()]
    period = math.lcm(*(part.denominator for part in fractions))
    if period > limit or np.any(np.abs([float(part) for part in fractions] - products) > 1e-9):
        requirement = f"whole numbers, or fractions that repeat within {limit} revolutions"
        raise InputError("orders", orders.tolist(), f"{requirement}; fit_frequency finds others")
    return period


@dataclass(frozen=True)
class _Fit:
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
        Covariance of the coefficients.
    sum_of_squares : float
        Sum of squared residuals, in variances.
    slope : (g,)
        Residual over error of a value, 1 + u' / R, with tip radius R and u' = du / d alpha: a late
        blade tip moves meanwhile.
    """

    order: float
    multiples: np.ndarray
    coefficients: np.ndarray
    covariance: np.ndarray
    sum_of_squares: float
    slope: np.ndarray


class _Sample:
    """Hold displacements at rotor angles, with the covariance of their errors.

    Parameters
    ----------
    nominal : (g,) [rad]
        Rotor angles at the expected blade tip.
    values : (g,) [m]
        Displacements.
    covariance : (g, g) [m^2]
        Covariance of the values; with an unknown scale if ``freedom`` is 0.
    freedom : int
        Degrees of freedom of this covariance, from arrivals within groups.
    radius : float [m]
        Radius of the blade tip.

    Attributes
    ----------
    angle : (g,) [rad]
        Rotor angles at the displaced blade tip.
    within : int
        Degrees of freedom, as ``freedom``.
    """

    def __init__(
        self,
        nominal: np.ndarray,
        values: np.ndarray,
        covariance: np.ndarray,
        freedom: int,
        radius: float,
    ) -> None:
        self.nominal, self.values, self.within, self._radius = nominal, values, freedom, radius
        self.angle = nominal - values / radius
        self.covariance = covariance
        # At two places of a wave the error of a probe's angle is the same.
        self._cholesky = np.linalg.cholesky(covariance + DEPENDENT * np.diag(np.diag(covariance)))

    def fit(self, order: float, multiples: np.ndarray) -> _Fit | None:
        """Fit an order by least squares.

        Return None if the probes cannot measure the order, or if the blade tip would move
        backwards.
        """
        columns = fourier_basis(order * self.angle, multiples)
        nominal_columns = fourier_basis(order * self.nominal, multiples)
        if np.isinf(condition(nominal_columns)) or np.isinf(condition(columns)):
            return None
        slope = np.ones(len(columns))
        # An arrival that is late by e leaves R W e (1 + u' / R): it is elsewhere, too.
        for _ in range(2):
            fit_slope, (matrix, values) = slope, self._whiten(columns, self.values, slope)
            coefficients = np.linalg.lstsq(matrix, values, rcond=None)[0]
            quadratures = (
                columns[:, 1::2] * coefficients[2::2] - columns[:, 2::2] * coefficients[1::2]
            )
            slope = 1.0 + order * quadratures @ multiples / self._radius
            if np.any(slope <= 0.0):
                return None
        residuals = values - matrix @ coefficients
        covariance = np.linalg.inv(matrix.T @ matrix)
        return _Fit(
            order, multiples, coefficients, covariance, float(residuals @ residuals), fit_slope
        )

    def _whiten(
        self, columns: np.ndarray, values: np.ndarray, slope: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Divide columns and values by slopes and standard deviations.

        Columns are (g, m), values and slopes (g,).
        Correlated values are decorrelated, by the Cholesky factor of their covariance.
        """
        block = np.column_stack([columns, values]) / slope[:, None]
        block = solve_triangular(self._cholesky, block, lower=True)
        return block[:, :-1], block[:, -1]

    def fit_with_omitted(self, fit: _Fit) -> tuple[float, _Fit]:
        """Return the restricted -2 log likelihood and the fit with omitted harmonics.

        The next N_FOLDED harmonics are normal random numbers, with the most likely variance for the
        values. If they are significant, the errors include their folding onto the fitted harmonics.
        """
        costs, fits = self.fit_omitted_sizes(fit, self._omitted_sizes(fit))
        choice = int(np.argmin(costs))
        return float(costs[choice]), fits[choice]

    def fit_omitted_sizes(self, fit: _Fit, sizes: np.ndarray) -> tuple[np.ndarray, list[_Fit]]:
        """Return costs (n,) and fits for given sizes of the omitted harmonics.

        Sizes are standard deviations (n,) [m]. Costs are restricted -2 log likelihoods.
        """
        costs, *estimates = self._solve_with_omitted(
            fit, np.repeat(sizes[:, None], N_FOLDED, axis=1)
        )
        return costs, [
            replace(
                fit, coefficients=coefficients, covariance=covariance, sum_of_squares=float(squares)
            )
            for coefficients, covariance, squares in zip(*estimates, strict=True)
        ]

    def folding_chance(self, fit: _Fit) -> float:
        """Return the probability that an amplitude is off by over three errors.

        The probability is a mean over all sizes of omitted harmonics, weighted with the likelihood
        of the values, for the worst amplitude; nan for unknown errors.
        """
        if self.within < 1:
            return np.nan
        sizes = np.array(list(product(self._omitted_sizes(fit), repeat=N_FOLDED)))
        costs, *estimates, _ = self._solve_with_omitted(fit, sizes)
        weights = np.exp(0.5 * (costs.min() - costs))
        middle, error = compute_amplitudes(fit.coefficients, fit.covariance)
        amplitudes, errors = compute_amplitudes(*estimates)
        limit = LEVELS.deviations * error
        cdf_high, cdf_low = (ndtr((middle + end - amplitudes) / errors) for end in (limit, -limit))
        return 1.0 - float((weights @ (cdf_high - cdf_low)).min() / weights.sum())

    def _omitted_sizes(self, fit: _Fit) -> np.ndarray:
        """Return trial standard deviations (n,) [m] of an omitted harmonic, by FOLDED_RATIOS."""
        sizes = np.hypot(*fit.coefficients[-2:]) * FOLDED_RATIOS
        return np.asarray(sizes[sizes < self.max_omitted_size])

    @property
    def max_omitted_size(self) -> float:
        """Maximum standard deviation [m] of an omitted harmonic, for well-conditioned squares."""
        return float(np.diag(self._cholesky).min() / np.sqrt(DEPENDENT))

    def _solve_with_omitted(
        self, fit: _Fit, sizes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Repeat a fit with omitted harmonics as further unknowns.

        Their values are 0 within standard deviations ``sizes`` (n, N_FOLDED) [m].

        Returns
        -------
        costs : (n,)
            Restricted -2 log likelihoods.
        coefficients : (n, 2K+1) [m]
            Coefficients of the fitted harmonics.
        covariances : (n, 2K+1, 2K+1) [m^2]
            Covariances of these coefficients.
        squares : (n,)
            Sums of squares, in variances.
        """
        unknowns, multiples = len(fit.coefficients), fit.multiples
        omitted_multiples = multiples[-1] + multiples[0] * np.arange(1.0, N_FOLDED + 1.0)
        columns = fourier_basis(fit.order * self.angle, np.append(multiples, omitted_multiples))
        volume = np.linalg.slogdet(columns[:, :unknowns].T @ columns[:, :unknowns])[1]
        columns, values = self._whiten(columns, self.values, fit.slope)
        scales = np.ones((len(sizes), columns.shape[1]))
        scales[:, unknowns:] = np.repeat(sizes, 2, axis=1)
        square = scales[:, :, None] * (columns.T @ columns) * scales[:, None, :]
        square += np.diag(np.arange(columns.shape[1]) >= unknowns)
        covariance = np.linalg.inv(square)
        coefficients = (covariance @ (scales * (columns.T @ values))[..., None])[..., 0]
        residuals = values - (scales * coefficients) @ columns.T
        squares = (residuals**2).sum(axis=1) + (coefficients[:, unknowns:] ** 2).sum(axis=1)
        costs = squares + np.linalg.slogdet(square)[1] - volume
        return costs, coefficients[:, :unknowns], covariance[:, :unknowns, :unknowns], squares

    def test_misfit(self, squares: float, unknowns: int) -> tuple[float, float, float]:
        """Test the misfit of a sum of squares, in variances (F test).

        Returns
        -------
        ratio : float
            Variance over the expected variance; inf without degrees of freedom.
        chance : float
            Probability of a misfit as large; nan if unknown.
        freedom : float
            Degrees of freedom of the variance; inf for a significant misfit, which is not random.
        """
        spare = len(self.values) - unknowns
        total = self.within + spare
        if self.within < 1:
            return (squares / spare if spare else np.inf), np.nan, total
        if spare < 1:
            return 1.0, np.nan, total
        chance = float(fdtrc(spare, self.within, squares / spare))
        if chance < LEVELS.scatter:
            return squares / spare, chance, np.inf
        return (self.within + squares) / total, chance, total


class Means(_Sample):
    """Hold each probe's mean displacements, once per period, with their covariance.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Arrivals at a constant speed.
    period : int
        Revolutions after which a probe sees the same motion again.
    order : float
        Largest candidate. Vibrations without an order are sought up to one order above this or
        above the default orders.
    angle_deviation : float [rad]
        Standard deviation of the probes' angles.
    line_effects : (revolutions, probes) [m]
        Displacements by :meth:`compute_line_effects`, which are subtracted.

    Attributes
    ----------
    scatter : float [m]
        Scatter of a displacement about the mean; 1 if unknown.
    values, angle : (g,) [m, rad]
        Means, and rotor angles at the displaced blade tip.
    covariance : (g, g) [m^2]
        Covariance of the means.
    lines : tuple of TipFit
        Vibrations without an order, with constant frequency.
    """

    def __init__(
        self,
        arrivals: ArrivalTimes,
        period: int,
        order: float,
        angle_deviation: float,
        line_effects: np.ndarray | float = 0.0,
    ) -> None:
        count, probes = arrivals.time.shape
        row = (arrivals.first + np.arange(count)) % period
        constants = row[:, None] * probes + np.arange(probes)
        self.lines, values = find_lines(
            arrivals, arrivals.displacement - line_effects, constants, order
        )
        mask = np.isfinite(values)
        places = np.nonzero(mask)
        groups, group = np.unique(constants[mask], return_inverse=True)
        self._displacement, self._group = values[mask], group
        nominal = arrivals.probes[groups % probes] + RAD_PER_TURN * (groups // probes)
        freedom = len(group) - len(groups)

        def solve(weights: np.ndarray) -> np.ndarray:
            self.values = np.bincount(group, weights * self._displacement) / np.bincount(
                group, weights
            )
            return self._displacement - self.values[group]

        noise = reweighted(solve, np.ones(len(group)), len(groups), arrivals.rounding)
        columns = np.eye(len(groups))[group]
        self.scatter, covariance = 1.0, np.diag(1.0 / np.bincount(group))
        if freedom > 0:
            self.scatter = max(float(np.sqrt(noise.variance)), arrivals.rounding)
            covariance = noise.covariance(columns, places)
            covariance += np.eye(len(groups)) * arrivals.rounding**2
            probe = groups % probes
            angle_variance = (arrivals.tip_radius * angle_deviation) ** 2
            covariance += angle_variance * (probe[:, None] == probe)
        super().__init__(nominal, self.values, covariance, freedom, arrivals.tip_radius)

    def compute_line_effects(self, arrivals: ArrivalTimes, fit: TipFit) -> np.ndarray:
        """Return how the lines change an order's displacements: (revolutions, probes) [m].

        Lines move the blade tip along the order's wave. The wave becomes smaller, and further lines
        appear at the sums and differences of the frequencies.
        """
        angle = np.full(arrivals.time.shape, np.nan)
        angle[np.isfinite(arrivals.time)] = self.angle[self._group]
        line_motion = sum(
            line.displacement(line.phases(arrivals)) - line.coefficients[0] for line in self.lines
        )
        displacement = fit.displacement(angle - line_motion / arrivals.tip_radius)
        return displacement - fit.displacement(angle)

    def wave_sum_of_squares(self, wave: np.ndarray, order: float, multiples: np.ndarray) -> float:
        """Return the residual squares after fitting an order to a wave.

        The squares are in variances; the wave is (g,) [m].
        Both are at the nominal angles.
        """
        columns = fourier_basis(order * self.nominal, multiples)
        columns, values = self._whiten(columns, wave, np.ones(len(wave)))
        residuals = values - columns @ np.linalg.lstsq(columns, values, rcond=1e-10)[0]
        return float(residuals @ residuals)

    def rms_residual(self, order: float, multiples: np.ndarray) -> float:
        """Return the root mean square residual of an order [m]."""
        columns = fourier_basis(order * self.angle, multiples)
        coefficients = np.linalg.lstsq(columns, self.values, rcond=1e-10)[0]
        residuals = self._displacement - (columns @ coefficients)[self._group]
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
        As in :class:`TipFit`, at the largest harmonics.
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

        The fit has a misfit, omitted harmonics may be folded, or either test is impossible, for
        instance with as many unknowns as probes.
        """
        is_unknown = np.isnan([self.misfit, self.folded])
        return self.does_not_fit or self.may_be_folded or bool(np.any(is_unknown))

    frequency = hertz_property()

    @property
    def omega(self) -> np.ndarray:
        """Angular frequency of the load: (n,) [rad/s]."""
        return np.asarray(self.order * self.speed)

    def to_dict(self) -> dict[str, Any]:
        """Return columns, a row for every group of revolutions."""
        columns = add_frequency_entries(
            {"speed": self.speed.tolist(), "omega": self.omega.tolist()}
        )
        for index, multiple in enumerate(self.multiples):
            columns[f"amplitude_{multiple:g}"] = self.amplitudes[:, index].tolist()
            columns[f"amplitude_error_{multiple:g}"] = self.amplitude_errors[:, index].tolist()
        return columns

    def _units(self) -> Mapping[str, str]:
        return UNIT_BY_NAME | {name: "m" for name in self.to_dict() if name.startswith("amplitude")}

    def _title(self) -> str:
        speeds = f"{self.speed[0]:.6g} to {self.speed[-1]:.6g} rad/s"
        points = format_count(len(self.speed), "point")
        return ", ".join([f"order {self.order:g}", speeds, points, *self._doubts])


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
    _, multiples = wanted([order], harmonics, subharmonic)
    check_count("revolutions", revolutions, 1)
    arrivals.check_places(angle_deviation)
    groups, unknowns = len(arrivals) // revolutions, 2 * len(multiples) + 1
    probes = len(arrivals.probes)
    if not groups:
        raise InputError("revolutions", revolutions, f"at most {len(arrivals)}, what there is")
    phase = order * arrivals.nominal_angle[:revolutions].ravel()
    if np.isinf(condition(fourier_basis(phase, multiples))):
        refuse_probes(arrivals, unknowns)
    shape = (groups, revolutions * probes)
    angle, nominal, values = (
        array[: groups * revolutions].reshape(shape)
        for array in (arrivals.angle, arrivals.nominal_angle, arrivals.displacement)
    )
    mask = np.isfinite(values)
    count, values = mask.sum(axis=1), np.where(mask, values, 0.0)
    columns, nominal_columns = (
        np.where(mask[..., None], fourier_basis(order * np.nan_to_num(array), multiples), 0.0)
        for array in (angle, nominal)
    )
    has_fit = np.linalg.matrix_rank(nominal_columns, tol=1e-6) == unknowns
    inverse = np.linalg.pinv(columns)
    position = (nominal - nominal[:, :1] + arrivals.probes[0]) / (RAD_PER_TURN * revolutions) - 0.5
    values, changes = _subtract_changes(values, inverse, columns, position, np.flatnonzero(has_fit))
    coefficients = inverse @ values[..., None]
    residuals = np.where(mask & has_fit[:, None], values - (columns @ coefficients)[..., 0], 0.0)
    places = np.nonzero(mask.reshape(-1, probes))
    spare = probes * (subharmonic if revolutions > 1 else 1) - unknowns
    misfit = trend(residuals.reshape(-1, probes)[places], places) if spare > 0 else np.nan
    variance, freedom = _variance(residuals, mask, np.where(has_fit, count - unknowns, 0))
    variance = max(variance, arrivals.rounding**2)
    probe = np.tile(np.arange(probes), revolutions)
    angle_covariance = (arrivals.tip_radius * angle_deviation) ** 2 * (probe[:, None] == probe)
    covariance = variance * np.eye(len(probe)) + angle_covariance
    coefficients = np.full((groups, unknowns), np.nan)
    covariances = np.full((groups, unknowns, unknowns), np.nan)
    fits = {}
    for group in np.flatnonzero(has_fit).tolist():
        row = mask[group]
        cov = covariance[np.ix_(row, row)]
        sample = _Sample(nominal[group, row], values[group, row], cov, freedom, arrivals.tip_radius)
        if (fit := sample.fit(order, multiples)) is not None:
            fits[group] = sample, fit
    if spare > 1 and freedom > 0:
        fits = _fit_neighbours(fits)
    for group, (sample, fit) in fits.items():
        coefficients[group] = fit.coefficients
        if count[group] > unknowns:
            factor, _, total_freedom = sample.test_misfit(fit.sum_of_squares, unknowns)
            factor = max(factor, 1.0) if freedom else factor
            covariances[group] = factor * student(total_freedom) * fit.covariance
            covariances[group] += np.outer(changes[group], changes[group])
    amplitudes, errors = compute_amplitudes(coefficients, covariances)
    chance = np.nan
    if spare > 1 and freedom > 0 and fits:
        peaks = {int(np.nanargmax(sizes)) for sizes in amplitudes.T}
        chance = max(sample.folding_chance(fit) for sample, fit in map(fits.__getitem__, peaks))
    times = arrivals.marks[: groups * revolutions + 1 : revolutions]
    speed = 2.0 * np.pi * revolutions / np.diff(times)
    return TipTrack(order, speed, multiples, coefficients, amplitudes, errors, misfit, chance)


def _subtract_changes(
    values: np.ndarray,
    inverse: np.ndarray,
    columns: np.ndarray,
    position: np.ndarray,
    groups: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Subtract the linear change of the vibration within each group.

    The change would look like further harmonics. There are n groups with m arrivals each.

    Parameters
    ----------
    values, position : (n, m)
        Displacements [m], and arrivals' distances behind the group's middle, in group lengths.
    inverse, columns : (n, 2K+1, m), (n, m, 2K+1)
        Pseudoinverses of the columns, and columns of the fits.
    groups : (k,)
        Indices of groups with enough arrivals.

    Returns
    -------
    values : (n, m) [m]
        Displacements without the change.
    changes : (n, 2K+1) [m]
        Change of the coefficients between the group's middle and the middle of its arrivals.
    """
    rates = np.zeros(inverse.shape[:2])
    if len(groups) > 1:
        coefficients = (inverse @ values[..., None])[groups, :, 0].T
        rates[groups] = np.gradient([smooth_series(row) for row in coefficients], groups, axis=1).T
    changes = position * (columns @ rates[..., None])[..., 0]
    return values - changes, position.mean(axis=1, keepdims=True) * rates


def _fit_neighbours(groups: dict[int, tuple[_Sample, _Fit]]) -> dict[int, tuple[_Sample, _Fit]]:
    """Fit groups with omitted harmonics, in the likeliest ratio among neighbours.

    A group and its neighbours share the ratio to the vibration, since few probes in one group do
    not determine it.
    """
    costs, fits = [], []
    for sample, fit in groups.values():
        sizes = np.minimum(
            np.linalg.norm(fit.coefficients[1:]) * FOLDED_RATIOS, sample.max_omitted_size
        )
        cost, group_fits = sample.fit_omitted_sizes(fit, sizes)
        costs.append(cost)
        fits.append(group_fits)
    squares = np.array([fit.sum_of_squares for _, fit in groups.values()])
    spare = [len(sample.values) - len(fit.coefficients) for sample, fit in groups.values()]
    freedom = np.maximum(spare, 1)
    joint_fits = {}
    for place, (group, (sample, _)) in enumerate(groups.items()):
        window = slice(max(place - NEIGHBOURS, 0), place + NEIGHBOURS + 1)
        limit = _quartile_variance(squares[window], freedom[window]) * chdtri(
            freedom[window], LEVELS.misfit
        )
        # Groups above the limit have wrong arrivals.
        trusted_costs = np.array(costs[window])[squares[window] <= limit]
        joint_fits[group] = sample, fits[place][int(np.argmin(trusted_costs.sum(axis=0)))]
    return joint_fits


def _variance(residuals: np.ndarray, mask: np.ndarray, freedom: np.ndarray) -> tuple[float, int]:
    """Return the variance of residuals (n, m), and its degrees of freedom.

    The variance follows from differences between neighbouring groups, without wrong arrivals.
    Without such differences the degrees are 0, and the variance is the mean square per degree of
    freedom, or 1 without any.
    """
    total, pairs = freedom.sum(), mask[1:] & mask[:-1]
    freedom = np.minimum(freedom[1:], freedom[:-1])
    valid = freedom > 0
    if not np.any(valid):
        return (float((residuals**2).sum()) / total if total else 1.0), 0
    squares = 0.5 * (np.where(pairs, np.diff(residuals, axis=0), 0.0) ** 2).sum(axis=1)
    return _quartile_variance(squares[valid], freedom[valid]), int(freedom[valid].sum()) // 2


def _quartile_variance(squares: np.ndarray, freedom: np.ndarray) -> float:
    """Return the variance from sums of squares (n,).

    Each sum has degrees of freedom (n,).
    The lower quartile is robust: nearly three quarters of the sums may have wrong arrivals.
    """
    return float(np.quantile(squares / chdtri(freedom, 0.75), 0.25))
