"""Synchronous vibration from arrival times: its engine order and harmonics by least squares, and
its harmonics along a run-up.

The circumferential Fourier fit. At engine order p each probe at phi sees, in every revolution, the
same point of

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
from fenics_crack.basics.tables import TURN, UNITS, counted, hertz_of, with_frequency
from fenics_crack.numerics.fourier import fourier_basis

N_FOLDED = 3
"""Number of harmonics beyond those kept that may be folded onto them."""
FOLDED_RATIOS = np.array([0.0, *2.0 ** -np.arange(0.5, 8.0)])
"""Ratios of a harmonic left out to the last one kept that are tried."""
NEIGHBOURS = 16
"""Groups of revolutions on either side whose harmonics left out have the same ratios."""


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
    tried, multiples = wanted(orders, harmonics, subharmonic)
    arrivals.check_places(angle_deviation)
    period, highest = _period(tried, multiples), float(tried.max())
    means = Means(arrivals, period, highest, angle_deviation)
    fit = _compared(arrivals, means, tried, multiples)
    if means.lines and not fit.does_not_fit:  # again at the angles to which lines move the tip
        moved = means.moved(arrivals, fit)
        means = Means(arrivals, period, highest, angle_deviation, moved)
        fit = _compared(arrivals, means, tried, multiples)
    return fit


def _compared(
    arrivals: ArrivalTimes, means: Means, tried: np.ndarray, multiples: np.ndarray
) -> TipFit:
    """Return the candidate that fits best, with the smallest vibration, and the others."""
    unknowns = 2 * len(multiples) + 1
    every = {place: means.fit(order, multiples) for place, order in enumerate(tried)}
    fits = {place: fit for place, fit in every.items() if fit is not None}
    if not fits:
        refuse_probes(arrivals, unknowns)
    hidden, (sums, sizes, costs) = np.full(len(tried), True), np.full((3, len(tried)), np.inf)
    for place, fit in fits.items():
        hidden[place], sums[place] = False, fit.least
        sizes[place] = np.linalg.norm(fit.coefficients[1:])
    lowest, misfit, freedom = means.tested(float(sums.min()), unknowns)
    equivalent, best = select_candidate(sums, sizes, LEVELS.equal * lowest)
    chosen = fits[best]
    # Arrivals that are not at the probes' angles distinguish aliases, but not reliably.
    wave = fourier_basis(tried[best] * means.nominal, multiples) @ chosen.coefficients
    left = np.array([means.unexplained(wave, one, multiples) for one in tried])
    equivalent |= left < LEVELS.equal * lowest
    known = lowest if np.isfinite(lowest) else np.nan
    if means.within > 0 and len(means.values) > unknowns + 1:
        # Nor do harmonics that are left out make another order less likely.
        for place, fit in fits.items():
            costs[place], fits[place] = means.beside_others(fit)
        equivalent |= costs - costs.min() < LEVELS.equal
        chosen = fits[best]
        known, _, freedom = means.tested(chosen.least, unknowns)
        known = max(known, 1.0)
    chosen = replace(chosen, covariance=known * student(freedom) * chosen.covariance)
    residuals = np.array([means.residual(order, multiples) for order in tried])
    conditions = [condition(fourier_basis(order * means.nominal, multiples)) for order in tried]
    return TipFit(
        order=float(tried[best]),
        order_error=0.0,
        speed=arrivals.mean_speed,
        multiples=multiples,
        coefficients=chosen.coefficients,
        covariance=chosen.covariance,
        scatter=means.scatter * float(np.sqrt(lowest if np.isfinite(lowest) else np.nan)),
        misfit=misfit,
        folded=means.folded(chosen),
        candidates=Candidates(tried, residuals, np.array(conditions), equivalent, hidden),
        spare=len(means.values) - unknowns,
        asynchronous=means.lines,
    )


def _period(orders: np.ndarray, multiples: np.ndarray) -> int:
    """Return the revolutions after which each probe sees the same again."""
    most = 24
    products = np.multiply.outer(orders, multiples).ravel()
    parts = [Fraction(product).limit_denominator(most) for product in products.tolist()]
    period = math.lcm(*(part.denominator for part in parts))
    if period > most or np.any(np.abs([float(part) for part in parts] - products) > 1e-9):
        allowed = f"whole numbers, or fractions that repeat within {most} revolutions"
        raise InputError("orders", orders.tolist(), f"{allowed}; fit_frequency finds others")
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
        Residual of a mean over its error, as the blade tip moves meanwhile.
    """

    order: float
    multiples: np.ndarray
    coefficients: np.ndarray
    covariance: np.ndarray
    least: float
    slope: np.ndarray


class _Seen:
    """Displacements at angles of the rotor, with the covariance of their errors.

    Parameters
    ----------
    nominal, angle : (g,) [rad]
        Rotor's angles where the blade tip is expected, and where it is.
    values : (g,) [m]
        Displacements.
    covariance : (g, g) [m^2]
        Covariance of the values; of unknown scale where ``within`` is 0.
    within : int
        Degrees of freedom of this covariance.
    radius : float [m]
        Radius of the blade tip.
    """

    def __init__(
        self,
        nominal: np.ndarray,
        values: np.ndarray,
        covariance: np.ndarray,
        within: int,
        radius: float,
    ) -> None:
        self.nominal, self.values, self.within, self._radius = nominal, values, within, radius
        self.angle = nominal - values / radius
        self.covariance = covariance
        # At two places of a wave the error of a probe's angle is the same.
        self._root = np.linalg.cholesky(covariance + DEPENDENT * np.diag(np.diag(covariance)))

    def fit(self, order: float, multiples: np.ndarray) -> _Fit | None:
        """Return least squares at an order; None where the probes cannot measure it, or the blade
        tip would move backwards."""
        columns = fourier_basis(order * self.angle, multiples)
        planned = fourier_basis(order * self.nominal, multiples)
        if np.isinf(condition(planned)) or np.isinf(condition(columns)):
            return None
        slope = np.ones(len(columns))
        # An arrival that is late by e leaves R W e (1 + u' / R): it is elsewhere, too.
        for _ in range(2):
            passed, (whitened, values) = slope, self._whitened(columns, self.values, slope)
            found = np.linalg.lstsq(whitened, values, rcond=None)[0]
            turned = columns[:, 1::2] * found[2::2] - columns[:, 2::2] * found[1::2]
            slope = 1.0 + order * turned @ multiples / self._radius
            if np.any(slope <= 0.0):
                return None
        left = values - whitened @ found
        covariance = np.linalg.inv(whitened.T @ whitened)
        return _Fit(order, multiples, found, covariance, float(left @ left), passed)

    def _whitened(
        self, columns: np.ndarray, values: np.ndarray, slope: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return columns (g, m) and values (g,), over slopes and in standard deviations."""
        both = np.column_stack([columns, values]) / slope[:, None]
        both = solve_triangular(self._root, both, lower=True)
        return both[:, :-1], both[:, -1]

    def beside_others(self, fit: _Fit) -> tuple[float, _Fit]:
        """Return -2 log likelihood (restricted) and fit with the next harmonics, which are left
        out, as normal numbers of the variance that makes the means most likely.

        So far as they are significant, the errors hold what is folded from them onto the
        harmonics kept.
        """
        costs, fits = self.beside_all(fit, self._sizes(fit))
        best = int(np.argmin(costs))
        return float(costs[best]), fits[best]

    def beside_all(self, fit: _Fit, sizes: np.ndarray) -> tuple[np.ndarray, list[_Fit]]:
        """Return the same for each standard deviation (n,) [m] of the next harmonics."""
        costs, *parts = self._beside(fit, np.repeat(sizes[:, None], N_FOLDED, axis=1))
        return costs, [
            replace(fit, coefficients=coefficients, covariance=covariance, least=float(least))
            for coefficients, covariance, least in zip(*parts, strict=True)
        ]

    def folded(self, fit: _Fit) -> float:
        """Return the probability that an amplitude is more than three of its errors off, for all
        sizes of the harmonics left out, weighted by the likelihood of the means; nan where errors
        are not known."""
        if self.within < 1:
            return np.nan
        sizes = np.array(list(product(self._sizes(fit), repeat=N_FOLDED)))
        costs, *others, _ = self._beside(fit, sizes)
        weights = np.exp(0.5 * (costs.min() - costs))
        middle, error = compute_amplitudes(fit.coefficients, fit.covariance)
        amplitudes, errors = compute_amplitudes(*others)
        far = LEVELS.deviations * error
        high, low = (ndtr((middle + end - amplitudes) / errors) for end in (far, -far))
        return 1.0 - float((weights @ (high - low)).min() / weights.sum())

    def _sizes(self, fit: _Fit) -> np.ndarray:
        """Return standard deviations of a harmonic left out [m]: 0, or up to the last one kept."""
        sizes = np.hypot(*fit.coefficients[-2:]) * FOLDED_RATIOS
        return np.asarray(sizes[sizes < self.widest])

    @property
    def widest(self) -> float:
        """Maximum standard deviation [m] of a harmonic left out, for well-conditioned squares."""
        return float(np.diag(self._root).min() / np.sqrt(DEPENDENT))

    def _beside(
        self, fit: _Fit, sizes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return fits with the next harmonics of standard deviations (n, N_FOLDED) [m], further
        unknowns that are 0 within these: -2 log likelihoods (n,), coefficients (n, 2K+1),
        covariances and sums of squares."""
        unknowns, multiples = len(fit.coefficients), fit.multiples
        others = multiples[-1] + multiples[0] * np.arange(1.0, N_FOLDED + 1.0)
        columns = fourier_basis(fit.order * self.angle, np.append(multiples, others))
        volume = np.linalg.slogdet(columns[:, :unknowns].T @ columns[:, :unknowns])[1]
        columns, values = self._whitened(columns, self.values, fit.slope)
        units = np.ones((len(sizes), columns.shape[1]))
        units[:, unknowns:] = np.repeat(sizes, 2, axis=1)
        square = units[:, :, None] * (columns.T @ columns) * units[:, None, :]
        square += np.diag(np.arange(columns.shape[1]) >= unknowns)
        covariance = np.linalg.inv(square)
        found = (covariance @ (units * (columns.T @ values))[..., None])[..., 0]
        left = values - (units * found) @ columns.T
        least = (left**2).sum(axis=1) + (found[:, unknowns:] ** 2).sum(axis=1)
        costs = least + np.linalg.slogdet(square)[1] - volume
        return costs, found[:, :unknowns], covariance[:, :unknowns, :unknowns], least

    def tested(self, least: float, unknowns: int) -> tuple[float, float, float]:
        """Return the variance over the expected one, inf where none is to spare.

        Then the probability of a misfit, nan where it is not known; and the degrees of freedom of
        the variance, inf where it is a misfit's, whose errors are no matter of chance.
        """
        between = len(self.values) - unknowns
        both = self.within + between
        if self.within < 1:
            return (least / between if between else np.inf), np.nan, both
        if between < 1:
            return 1.0, np.nan, both
        chance = float(fdtrc(between, self.within, least / between))
        if chance < LEVELS.scatter:
            return least / between, chance, np.inf
        return (self.within + least) / both, chance, both


class Means(_Seen):
    """Mean displacements of each probe, every so many revolutions, with their covariance.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Arrivals at a constant speed.
    period : int
        Revolutions after which a probe sees the same again.
    order : float
        Largest of the candidates; up to it vibrations that follow none are sought.
    angle_deviation : float [rad]
        Standard deviation of the probes' angles.
    moved : (revolutions, probes) [m]
        Displacements that are subtracted.

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
        moved: np.ndarray | float = 0.0,
    ) -> None:
        count, probes = arrivals.time.shape
        row = (arrivals.first + np.arange(count)) % period
        constants = row[:, None] * probes + np.arange(probes)
        self.lines, left = find_lines(arrivals, arrivals.displacement - moved, constants, order)
        seen = np.isfinite(left)
        places = np.nonzero(seen)
        groups, where = np.unique(constants[seen], return_inverse=True)
        self._data, self._where = left[seen], where
        nominal = arrivals.probes[groups % probes] + TURN * (groups // probes)
        within = len(where) - len(groups)

        def solve(weights: np.ndarray) -> np.ndarray:
            self.values = np.bincount(where, weights * self._data) / np.bincount(where, weights)
            return self._data - self.values[where]

        noise = reweighted(solve, np.ones(len(where)), len(groups), arrivals.rounding)
        own = np.eye(len(groups))[where]
        self.scatter, covariance = 1.0, np.diag(1.0 / np.bincount(where))
        if within > 0:
            self.scatter = max(float(np.sqrt(noise.variance)), arrivals.rounding)
            covariance = noise.covariance(own, places)
            covariance += np.eye(len(groups)) * arrivals.rounding**2
            place = groups % probes
            spread = (arrivals.tip_radius * angle_deviation) ** 2
            covariance += spread * (place[:, None] == place)
        super().__init__(nominal, self.values, covariance, within, arrivals.tip_radius)

    def moved(self, arrivals: ArrivalTimes, fit: TipFit) -> np.ndarray:
        """Return the displacements of an order because the lines move the blade tip past its wave:
        it becomes smaller, with lines at the sums and differences of the frequencies."""
        angle = np.full(arrivals.time.shape, np.nan)
        angle[np.isfinite(arrivals.time)] = self.angle[self._where]
        beside = sum(
            line.displacement(line.phases(arrivals)) - line.coefficients[0] for line in self.lines
        )
        passed = fit.displacement(angle - beside / arrivals.tip_radius)
        return passed - fit.displacement(angle)

    def unexplained(self, wave: np.ndarray, order: float, multiples: np.ndarray) -> float:
        """Return the residual of a wave at the nominal angles, fitted by an order, in variances."""
        columns = fourier_basis(order * self.nominal, multiples)
        columns, values = self._whitened(columns, wave, np.ones(len(wave)))
        left = values - columns @ np.linalg.lstsq(columns, values, rcond=1e-10)[0]
        return float(left @ left)

    def residual(self, order: float, multiples: np.ndarray) -> float:
        """Return the root mean square residual of an order [m]."""
        columns = fourier_basis(order * self.angle, multiples)
        found = np.linalg.lstsq(columns, self.values, rcond=1e-10)[0]
        left = self._data - (columns @ found)[self._where]
        return float(np.sqrt(np.mean(left**2)))


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
        """True if it does not fit, harmonics left out may be folded, also where that is not known,
        or it has as many unknowns as there are probes."""
        unknown = np.isnan([self.misfit, self.folded])
        return self.does_not_fit or self.may_be_folded or bool(np.any(unknown))

    frequency = hertz_of()

    @property
    def omega(self) -> np.ndarray:
        """Angular frequency of the load: (n,) [rad/s]."""
        return np.asarray(self.order * self.speed)

    def to_dict(self) -> dict[str, Any]:
        """Return columns, a row for every group of revolutions."""
        found = with_frequency({"speed": self.speed.tolist(), "omega": self.omega.tolist()})
        for place, multiple in enumerate(self.multiples):
            found[f"amplitude_{multiple:g}"] = self.amplitudes[:, place].tolist()
            found[f"amplitude_error_{multiple:g}"] = self.amplitude_errors[:, place].tolist()
        return found

    def _units(self) -> Mapping[str, str]:
        return UNITS | {n: "m" for n in self.to_dict() if n.startswith("amplitude")}

    def _title(self) -> str:
        speeds = f"{self.speed[0]:.6g} to {self.speed[-1]:.6g} rad/s"
        points = counted(len(self.speed), "point")
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
        part[: groups * revolutions].reshape(shape)
        for part in (arrivals.angle, arrivals.nominal_angle, arrivals.displacement)
    )
    seen = np.isfinite(values)
    count, values = seen.sum(axis=1), np.where(seen, values, 0.0)
    columns, planned = (
        np.where(seen[..., None], fourier_basis(order * np.nan_to_num(part), multiples), 0.0)
        for part in (angle, nominal)
    )
    enough = np.linalg.matrix_rank(planned, tol=1e-6) == unknowns
    inverse = np.linalg.pinv(columns)
    along = (nominal - nominal[:, :1] + arrivals.probes[0]) / (TURN * revolutions) - 0.5
    values, apart = _without_changes(values, inverse, columns, along, np.flatnonzero(enough))
    found = inverse @ values[..., None]
    left = np.where(seen & enough[:, None], values - (columns @ found)[..., 0], 0.0)
    places = np.nonzero(seen.reshape(-1, probes))
    own = probes * (subharmonic if revolutions > 1 else 1) - unknowns
    misfit = trend(left.reshape(-1, probes)[places], places) if own > 0 else np.nan
    variance, within = _variance(left, seen, np.where(enough, count - unknowns, 0))
    variance = max(variance, arrivals.rounding**2)
    place = np.tile(np.arange(probes), revolutions)
    spread = (arrivals.tip_radius * angle_deviation) ** 2 * (place[:, None] == place)
    covariance = variance * np.eye(len(place)) + spread
    found = np.full((groups, unknowns), np.nan)
    errors = np.full((groups, unknowns, unknowns), np.nan)
    parts = {}
    for group in np.flatnonzero(enough).tolist():
        there = seen[group]
        near = covariance[np.ix_(there, there)]
        part = _Seen(nominal[group, there], values[group, there], near, within, arrivals.tip_radius)
        if (fit := part.fit(order, multiples)) is not None:
            parts[group] = part, fit
    if own > 1 and within > 0:
        parts = _beside_all(parts)
    for group, (part, fit) in parts.items():
        found[group] = fit.coefficients
        if count[group] > unknowns:
            known, _, freedom = part.tested(fit.least, unknowns)
            known = max(known, 1.0) if within else known
            errors[group] = known * student(freedom) * fit.covariance
            errors[group] += np.outer(apart[group], apart[group])
    amplitudes, amplitude_errors = compute_amplitudes(found, errors)
    folded = np.nan
    if own > 1 and within > 0 and parts:
        largest = {int(np.nanargmax(sizes)) for sizes in amplitudes.T}
        folded = max(part.folded(fit) for part, fit in map(parts.__getitem__, largest))
    times = arrivals.marks[: groups * revolutions + 1 : revolutions]
    speed = 2.0 * np.pi * revolutions / np.diff(times)
    return TipTrack(order, speed, multiples, found, amplitudes, amplitude_errors, misfit, folded)


def _without_changes(
    values: np.ndarray, inverse: np.ndarray, columns: np.ndarray, along: np.ndarray, fit: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return displacements (n, m) without the linear change of the vibration within each group,
    which looks like further harmonics; and the change (n, 2K+1) of its coefficients from the middle
    of the arrivals to that of the group.

    ``inverse`` (n, 2K+1, m) is that of ``columns``, ``along`` (n, m) the part of the group that an
    arrival is behind its middle, ``fit`` the groups (k,) that have enough arrivals.
    """
    rates = np.zeros(inverse.shape[:2])
    if len(fit) > 1:
        alone = (inverse @ values[..., None])[fit, :, 0].T
        rates[fit] = np.gradient([smooth_series(part) for part in alone], fit, axis=1).T
    moved = along * (columns @ rates[..., None])[..., 0]
    return values - moved, along.mean(axis=1, keepdims=True) * rates


def _beside_all(parts: dict[int, tuple[_Seen, _Fit]]) -> dict[int, tuple[_Seen, _Fit]]:
    """Return fits of groups with the next harmonics, whose ratio to the vibration makes a group and
    its neighbours most likely: few probes of one group do not determine it."""
    costs, fits = [], []
    for part, fit in parts.values():
        sizes = np.minimum(np.linalg.norm(fit.coefficients[1:]) * FOLDED_RATIOS, part.widest)
        cost, beside = part.beside_all(fit, sizes)
        costs.append(cost)
        fits.append(beside)
    left = np.array([fit.least for _, fit in parts.values()])
    beyond = [len(part.values) - len(fit.coefficients) for part, fit in parts.values()]
    spare = np.maximum(beyond, 1)
    found = {}
    for place, (group, (part, _)) in enumerate(parts.items()):
        near = slice(max(place - NEIGHBOURS, 0), place + NEIGHBOURS + 1)
        most = _usual(left[near], spare[near]) * chdtri(spare[near], LEVELS.misfit)
        right = np.array(costs[near])[left[near] <= most]  # the others have wrong arrivals
        found[group] = part, fits[place][int(np.argmin(right.sum(axis=0)))]
    return found


def _variance(left: np.ndarray, seen: np.ndarray, spare: np.ndarray) -> tuple[float, int]:
    """Return the variance of differences between residuals of a group (n, m) and the next, by those
    without wrong arrivals, and its degrees of freedom.

    0 of them where there is nothing to compare: the variance of the residuals, or 1 without any.
    """
    total, both = spare.sum(), seen[1:] & seen[:-1]
    spare = np.minimum(spare[1:], spare[:-1])
    there = spare > 0
    if not np.any(there):
        return (float((left**2).sum()) / total if total else 1.0), 0
    squares = 0.5 * (np.where(both, np.diff(left, axis=0), 0.0) ** 2).sum(axis=1)
    return _usual(squares[there], spare[there]), int(spare[there].sum()) // 2


def _usual(squares: np.ndarray, spare: np.ndarray) -> float:
    """Return the variance of sums of squares (n,) with some degrees of freedom (n,), by their lower
    quartile: up to three quarters of them may have wrong arrivals."""
    return float(np.quantile(squares / chdtri(spare, 0.75), 0.25))
