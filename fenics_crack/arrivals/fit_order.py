"""Synchronous vibration from arrival times: engine order and harmonics, at a speed or in a run-up.

The circumferential Fourier fit by least squares. At engine order p each probe at phi sees, in every
revolution, the same point of

    u = a0 + sum_k a_k cos(k p alpha) + b_k sin(k p alpha)

so the probes around the casing are what samples a period: K harmonics need 2K + 1 probes, and two
orders that agree at all probes cannot be distinguished. Heath and Imregun (Journal of Engineering
for Gas Turbines and Power 120, 1998, 784) survey such methods; Diamond and Heyns (Journal of
Vibration and Acoustics 140, 2018, 061003) choose the spacing of the probes. As in the improved fit
of Applied Sciences 10, 2020, 3675, alpha is the rotor's angle at the arrival itself, which depends
on the vibration, and not where the blade tip was expected.
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
"""Number of omitted harmonics, next to those of the fit, that may be folded onto it."""
FOLDED_RATIOS = np.array([0.0, *2.0 ** -np.arange(0.5, 8.0)])
"""Ratios of an omitted harmonic to the last one of the fit, to try."""
NEIGHBOURS = 16
"""Groups of revolutions on either side in which omitted harmonics have the same ratios."""


def fit_order(
    arrivals: ArrivalTimes,
    orders: Iterable[float] = ORDERS,
    *,
    harmonics: int = 1,
    subharmonic: int = 1,
    angle_deviation: float = 0.0,
) -> TipFit:
    """Find the engine order of a vibration, and its harmonics, by least squares.

    The mean of each probe over the revolutions is found beside vibrations that follow no order
    (``asynchronous`` of the fit), with errors of Student's t, so that single wrong arrivals have no
    weight. Each candidate is fitted to the means. All whose sum of squares is less than 9 variances
    above the least one fit equally well: the one with the smallest vibration is taken (within 20 %,
    the one of the least sum), and the others are reported. So are those whose columns are dependent
    at these probes, as hidden (:class:`Candidates`). The variance of a mean is that of the
    residuals and of the probe's angle; where the means are off by more (F test), it is that of the
    means, so that harmonics left out do not pass for information. Of these, what is significant is
    in the errors; what may be there without being so is in ``folded``.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Measured or simulated, at a constant speed. :func:`track_order` is for run-ups.
    orders : iterable of float
        Candidates: periods of the load in a revolution, whole numbers or fractions of small ones.
        Those that a Campbell diagram allows are distinguished most easily.
    harmonics : int
        K; 2 or more show a breathing crack by :meth:`TipFit.ratio`.
    subharmonic : int
        2: the response has twice the load's period, and harmonics 1/2, 1, ..., K/2 of the load.
    angle_deviation : float [rad]
        Standard deviation of the probes' angles, the same in every revolution.

    Returns
    -------
    TipFit
        The order, its harmonics with standard errors, and other orders that fit equally well.

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
    """Return the number of revolutions after which probes see the same."""
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
    """Least squares at one order.

    Attributes
    ----------
    order : float
        Periods of the load in a revolution.
    multiples : (K,)
        Harmonics, as multiples of its frequency.
    coefficients : (2K+1,) [m]
        a0, a1, b1, ....
    covariance : (2K+1, 2K+1) [m^2]
        Covariance of the coefficients.
    least : float
        Sum of squares of the residuals, in variances.
    slope : (g,)
        Residual of a value over its error, 1 + u' / R: a late blade tip moves meanwhile.
    """

    order: float
    multiples: np.ndarray
    coefficients: np.ndarray
    covariance: np.ndarray
    sum_of_squares: float
    slope: np.ndarray


class _Sample:
    """Displacements at angles of the rotor, with the covariance of their errors.

    Parameters
    ----------
    nominal, angle : (g,) [rad]
        Rotor's angles where the blade tip is expected, and where it is.
    values : (g,) [m]
        Displacements.
    covariance : (g, g) [m^2]
        Covariance of the values; of unknown scale if ``freedom`` is 0.
    freedom : int
        Degrees of freedom of this covariance, of arrivals within groups.
    radius : float [m]
        Radius of the blade tip.
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

        Returns None where probes cannot measure it, or where the blade tip would move backwards.
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
        """Divide columns (g, m) and values (g,) by slopes (g,) and standard deviations."""
        block = np.column_stack([columns, values]) / slope[:, None]
        block = solve_triangular(self._cholesky, block, lower=True)
        return block[:, :-1], block[:, -1]

    def fit_with_omitted(self, fit: _Fit) -> tuple[float, _Fit]:
        """Return -2 log likelihood (restricted) and fit, with omitted harmonics.

        The next N_FOLDED harmonics are normal random numbers of the variance that makes the values
        most likely. So far as they are significant, the errors hold what is folded from them onto
        the harmonics of the fit.
        """
        costs, fits = self.fit_omitted_sizes(fit, self._omitted_sizes(fit))
        choice = int(np.argmin(costs))
        return float(costs[choice]), fits[choice]

    def fit_omitted_sizes(self, fit: _Fit, sizes: np.ndarray) -> tuple[np.ndarray, list[_Fit]]:
        """Return costs (n,) and fits with omitted harmonics of standard deviations (n,) [m].

        Costs are -2 log likelihoods (restricted).
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

        The mean over all sizes of omitted harmonics, weighted by the likelihood of the values; for
        the worst amplitude. nan where errors are not known.
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
        """Return standard deviations of an omitted harmonic [m], by FOLDED_RATIOS."""
        sizes = np.hypot(*fit.coefficients[-2:]) * FOLDED_RATIOS
        return np.asarray(sizes[sizes < self.max_omitted_size])

    @property
    def max_omitted_size(self) -> float:
        """Maximum standard deviation [m] of an omitted harmonic, for well-conditioned squares."""
        return float(np.diag(self._cholesky).min() / np.sqrt(DEPENDENT))

    def _solve_with_omitted(
        self, fit: _Fit, sizes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Fit again with omitted harmonics of standard deviations (n, N_FOLDED) [m].

        They are further unknowns, which are 0 within these. Returns -2 log likelihoods (n,),
        coefficients (n, 2K+1) [m], covariances (n, 2K+1, 2K+1) [m^2] and sums of squares (n,).
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

        Returns the variance over the expected one, inf without degrees of freedom; the probability
        of a misfit as large, nan where unknown; and the degrees of freedom of the variance, inf
        where a misfit makes it, whose errors are no matter of chance.
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
    """Mean displacements of each probe, every so many revolutions, with their covariance.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Arrivals at a constant speed.
    period : int
        Revolutions after which a probe sees the same again.
    order : float
        Largest of the candidates, up to which vibrations that follow no order are sought.
    angle_deviation : float [rad]
        Standard deviation of the probes' angles.
    line_effects : (revolutions, probes) [m]
        Displacements of :meth:`compute_line_effects`, which are subtracted.

    Attributes
    ----------
    scatter : float [m]
        Scatter of a displacement about its mean; 1 where it is not known.
    values, angle : (g,) [m, rad]
        The means, and the rotor's angles where the blade tip then is.
    covariance : (g, g) [m^2]
        Covariance of the means.
    lines : tuple of TipFit
        Vibrations that follow no order.
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
        """Return the change of an order's displacements by the lines (revolutions, probes) [m].

        Lines move the blade tip along the order's wave, which becomes smaller, with lines at the
        sums and differences of the frequencies.
        """
        angle = np.full(arrivals.time.shape, np.nan)
        angle[np.isfinite(arrivals.time)] = self.angle[self._group]
        line_motion = sum(
            line.displacement(line.phases(arrivals)) - line.coefficients[0] for line in self.lines
        )
        displacement = fit.displacement(angle - line_motion / arrivals.tip_radius)
        return displacement - fit.displacement(angle)

    def wave_sum_of_squares(self, wave: np.ndarray, order: float, multiples: np.ndarray) -> float:
        """Return residual squares, in variances, of an order fitted to a wave (g,).

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
    """Harmonics of a vibration of known engine order, revolution by revolution.

    Attributes
    ----------
    order : float
        Periods of the load in a revolution.
    speed : (n,) [rad/s]
        Mean speed of each group of revolutions.
    multiples : (K,)
        Harmonics, as of :class:`TipFit`.
    coefficients : (n, 2K+1) [m]
        a0, a1, b1, ....
    amplitudes, amplitude_errors : (n, K) [m]
        And standard errors; nan where too many arrivals are missing, errors also where two arrivals
        or fewer are to spare.
    misfit : float
        Probability that residuals are as correlated from revolution to revolution by chance. If it
        is tiny, harmonics are missing, and folded onto those that are kept. nan where there are no
        more probes than unknowns, which fit anything.
    folded : float
        As of :class:`TipFit`, where the harmonics are largest.
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

        It does not fit, harmonics left out may be folded, or either is unknown, for instance with
        as many unknowns as probes.
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
    """Fit the harmonics of a known engine order to each few revolutions of a run-up.

    The fit of :func:`fit_order` with one candidate, to ``revolutions`` revolutions at a time. A
    vibration of twice the load's period and an odd order needs two or more. Its linear change
    within a group is subtracted; in which part of the group the amplitude is that of the fit, is in
    the errors. The variance of an arrival is that of
    differences between residuals of neighbouring fits. Residuals that repeat are
    a misfit, by harmonics that are left out: as in :func:`fit_order` they are further unknowns,
    with the same ratio to the vibration in neighbouring fits, so that what is folded from them is
    in the standard errors so far as it is significant, and else in ``folded``.

    Parameters
    ----------
    arrivals, harmonics, subharmonic, angle_deviation
        As of :func:`fit_order`.
    order : float
        Periods of the load in a revolution.
    revolutions : int
        Number of revolutions that are fitted together.

    Returns
    -------
    TipTrack
        Amplitudes and phases with their standard errors, and the speed of each fit.

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

    It looks like further harmonics.

    Parameters
    ----------
    values, position : (n, m)
        Displacements [m], and arrivals' distances behind the middle of the group, in its lengths.
    inverse, columns : (n, 2K+1, m), (n, m, 2K+1)
        Pseudoinverses of the columns, and columns of the fits.
    groups : (k,)
        Groups with enough arrivals.

    Returns
    -------
    values : (n, m) [m]
        Displacements without the change.
    changes : (n, 2K+1) [m]
        Change of the coefficients from the middle of the group to that of the arrivals.
    """
    rates = np.zeros(inverse.shape[:2])
    if len(groups) > 1:
        coefficients = (inverse @ values[..., None])[groups, :, 0].T
        rates[groups] = np.gradient([smooth_series(row) for row in coefficients], groups, axis=1).T
    changes = position * (columns @ rates[..., None])[..., 0]
    return values - changes, position.mean(axis=1, keepdims=True) * rates


def _fit_neighbours(groups: dict[int, tuple[_Sample, _Fit]]) -> dict[int, tuple[_Sample, _Fit]]:
    """Fit groups with omitted harmonics, in the ratio likeliest in neighbours.

    The ratio to the vibration is that of a group and its neighbours, as few probes of one group do
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
    """Return the variance of residuals (n, m) and its degrees of freedom.

    By differences between neighbouring groups without wrong arrivals. If there are none, the
    degrees are 0, and the variance is that of the residuals, or 1 without any.
    """
    total, pairs = freedom.sum(), mask[1:] & mask[:-1]
    freedom = np.minimum(freedom[1:], freedom[:-1])
    valid = freedom > 0
    if not np.any(valid):
        return (float((residuals**2).sum()) / total if total else 1.0), 0
    squares = 0.5 * (np.where(pairs, np.diff(residuals, axis=0), 0.0) ** 2).sum(axis=1)
    return _quartile_variance(squares[valid], freedom[valid]), int(freedom[valid].sum()) // 2


def _quartile_variance(squares: np.ndarray, freedom: np.ndarray) -> float:
    """Return the variance from sums of squares (n,) with degrees of freedom (n,).

    By their lower quartile: up to three quarters of them may have wrong arrivals.
    """
    return float(np.quantile(squares / chdtri(freedom, 0.75), 0.25))
