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

FREEDOMS = np.array([3.0, 5.0, 10.0, 30.0, 1e6])
"""Trial degrees of freedom."""
ROBUST_ROUNDS, ROBUST_SETTLED = 30, 1e-2
"""Maximum rounds of weights, and maximum change in the last round.

Both weights and scaled residuals change less in the end: by some hundredths of a standard error.
"""
DEPENDENT = 1e-12
"""Columns are dependent below this fraction of the largest eigenvalue."""


@dataclass(frozen=True)
class Confidence:
    """Hold levels of significance.

    Attributes
    ----------
    chance : float
        Maximum probability, in noise, of a significant vibration.
    gain : float
        Minimum reduction of -2 log likelihood by a significant resonance: some 1e5 are tried, each
        with six unknowns.
    misfit : float
        Probability of residuals below which a model does not explain them.
    scatter : float
        Probability of a misfit below which errors follow from the misfit, otherwise from the
        scatter.
    deviations : float
        Standard deviations within which candidates fit equally well, and correlation is
        insignificant.
    """

    chance: float = 1e-5
    gain: float = 60.0
    misfit: float = 1e-3
    scatter: float = 1e-2
    deviations: float = 3.0

    @property
    def equal(self) -> float:
        """Difference in sums of squares, in variances, between equally good candidates."""
        return self.deviations**2


LEVELS = Confidence()

Total = tuple[float, float]
"""Sum of products, and their number."""
Places = tuple[np.ndarray, np.ndarray]
"""Revolutions and probes of arrivals: two (n,)."""


class Noise:
    """Fit Student's t to residuals by maximum likelihood.

    Scale steps are 1 + 3 / nu times the steps of the weighted squares, since the information in
    Student's t is 2 nu / (nu + 3).

    Parameters
    ----------
    residuals : (n,)
        Residuals r.
    unknowns : int
        Number of unknowns in the fit.
    min_scale : float
        Minimum scale, by rounding.
    scales : (k,)
        Initial scales, one for each trial value in :data:`FREEDOMS`.

    Attributes
    ----------
    weights : (n,)
        Weights of the arrivals in the fit.
    scale, freedom : float
        Scale s and degrees of freedom nu.
    cost : float
        -2 log likelihood.
    """

    def __init__(
        self,
        residuals: np.ndarray,
        unknowns: int,
        min_scale: float,
        scales: np.ndarray | None = None,
    ) -> None:
        self.residuals, self.unknowns = residuals, unknowns
        squares, n_spare = residuals**2, max(len(residuals) - unknowns, 1)
        # As many arrivals as unknowns may be met exactly: few to spare have no tails.
        freedoms = FREEDOMS if n_spare > unknowns else FREEDOMS[-1:]
        if scales is None:
            scale = 1.5 * float(np.median(np.abs(residuals))) * np.sqrt(len(residuals) / n_spare)
            scales = np.full(len(freedoms), scale)
        scales, nu = np.maximum(scales, min_scale), freedoms[:, None]
        for _ in range(ROBUST_ROUNDS):
            ratios = squares / scales[:, None] ** 2
            variance_ratio = (nu + 1.0) / (nu + ratios) @ squares / (n_spare * scales**2)
            previous_scales = scales
            scales = np.maximum(scales * variance_ratio ** (0.5 + 1.5 / freedoms), min_scale)
            if np.all(np.abs(scales - previous_scales) < ROBUST_SETTLED * scales):
                break
        self.scales, ratios = scales, squares / scales[:, None] ** 2
        log_norms = 2.0 * (gammaln(0.5 * freedoms) - gammaln(0.5 * freedoms + 0.5) + np.log(scales))
        log_norms += np.log(freedoms * np.pi)
        costs = len(residuals) * log_norms + (freedoms + 1.0) * np.log1p(ratios / nu).sum(axis=1)
        # Tails are one unknown more, by which the likelihood has to gain (Akaike's criterion).
        best_index = int(np.argmin(costs + 2.0 * (freedoms < FREEDOMS[-1])))
        self.scale, self.freedom, self.cost = (
            float(quantity[best_index]) for quantity in (scales, freedoms, costs)
        )
        self.weights = (self.freedom + 1.0) / (self.freedom + ratios[best_index])

    @property
    def psi(self) -> np.ndarray:
        """Weighted residuals: (n,)."""
        return self.weights * self.residuals

    @property
    def slope(self) -> float:
        """Mean derivative of psi by the residual."""
        squares = (self.residuals / self.scale) ** 2
        change = (self.freedom + 1.0) * (self.freedom - squares) / (self.freedom + squares) ** 2
        return float(np.mean(change))

    @property
    def variance(self) -> float:
        """Variance of normal errors with the same effect on estimates."""
        n_spare = len(self.residuals) - self.unknowns
        return float(self.psi @ self.psi) / (n_spare * self.slope**2)

    def whiteness(self, places: Places, shares: np.ndarray) -> float:
        """Return the probability that noise alone leaves residuals as correlated.

        Noise comes from arrivals and marks. The correlation is between values of psi at one probe,
        from a revolution to the next with arrivals (:func:`_sum_neighbours`).

        An error e_n of mark n moves arrivals: at probe i in revolution n by sum_k S_ki e_(n+k),
        with the ``shares`` S (marks, probes). Products of psi at two probes in a revolution give
        the variance of e. Multiplied by sum_k S_ki S_(k+m)i, this variance is the covariance
        between arrivals at probe i, m revolutions apart. Shared errors also scatter the products
        themselves.
        """
        (same_probe, cross_probe), lag, ((total, count), lagged_cross) = _sum_neighbours(
            self.psi, places
        )
        variance = same_probe[0] / same_probe[1]
        if not count or not variance:
            return np.nan
        covariance = max(cross_probe[0] / cross_probe[1], 0.0) if cross_probe[1] else 0.0
        products = shares.T @ shares
        next_products = (shares[lag:] * shares[:-lag]).sum(axis=0)
        cross_products = products[~np.eye(len(products), dtype=bool)]
        mark_part = covariance / cross_products.mean() * next_products.mean() if covariance else 0.0
        deviation = variance * np.sqrt(count + (covariance / variance) ** 2 * lagged_cross[1])
        chance = float(ndtr((total - count * mark_part) / deviation))
        return 2.0 * min(chance, 1.0 - chance)

    def covariance(self, columns: np.ndarray, places: Places) -> np.ndarray:
        """Return the covariance (m, m) of coefficients from columns (n, m).

        Rows in ``columns`` belong to the arrivals; ``places`` are their revolutions and probes.
        """
        sizes = np.linalg.norm(columns, axis=0)
        columns = columns / sizes
        probe_columns = _arrange_by_revolution(columns, places)
        revolution_columns, gram = probe_columns.sum(axis=1), columns.T @ columns
        variance = float(self.psi @ self.psi) / (len(self.psi) - self.unknowns)
        psi_covariance = variance * gram
        covariances = self._find_covariances(variance, places)
        for lag, (probe_covariance, pair_covariance) in enumerate(covariances):
            tail, head = slice(lag, None), slice(len(revolution_columns) - lag)
            probe_products, products = (
                rows[tail].reshape(-1, len(gram)).T @ rows[head].reshape(-1, len(gram))
                for rows in (probe_columns, revolution_columns)
            )
            term = probe_covariance * probe_products + pair_covariance * (products - probe_products)
            psi_covariance += (1.0 - lag / len(covariances)) * (term if lag == 0 else term + term.T)
        # Correlation leaves a tenth or more of the variance by white errors.
        values, vectors = np.linalg.eigh(gram)
        basis = vectors * np.where(values > DEPENDENT * values[-1], values, np.inf) ** -0.5
        variances, axes = np.linalg.eigh(basis.T @ psi_covariance @ basis)
        basis = (basis @ axes) / sizes[:, None]
        return np.asarray((basis * np.maximum(variances, 0.1 * variance)) @ basis.T / self.slope**2)

    def _find_covariances(self, variance: float, places: Places) -> list[tuple[float, float]]:
        """Return significant covariances of psi at lags of 0, 1, ... revolutions.

        Each lag has two covariances: at one probe, 0 at lag 0, and between two probes. The list
        ends before the first lag > 0 without a significant covariance.
        """
        covariances: list[tuple[float, float]] = []
        for lag, products in enumerate(_sum_products(self.psi, itertools.count(), places)):
            lag_covariances = []
            for total, count in products:
                limit = LEVELS.deviations * variance * np.sqrt(count if lag else 2.0 * count)
                lag_covariances.append(total / count if count and abs(total) > limit else 0.0)
            if lag == 0:
                lag_covariances[0] = 0.0
            elif not any(lag_covariances):
                break
            covariances.append((lag_covariances[0], lag_covariances[1]))
        return covariances


def student(freedom: float) -> float:
    """Return the variance of Student's t over its squared scale.

    Squared errors from few residuals are larger by this factor; nan up to two degrees of freedom.
    """
    return 1.0 + 2.0 / (freedom - 2.0) if freedom > 2.0 else np.nan


def trend(values: np.ndarray, places: Places) -> float:
    """Return the probability that white values are at least as correlated.

    The correlation is between successive revolutions.
    ``values`` (n,) belong to the revolutions and probes in ``places``; nan for one revolution.
    """
    _, _, [(total, count), _] = _sum_neighbours(values, places)
    variance = float(values @ values) / len(values)
    return float(ndtr(-total / (variance * np.sqrt(count)))) if count and variance else np.nan


def _sum_neighbours(values: np.ndarray, places: Places) -> tuple[list[Total], int, list[Total]]:
    """Sum products of values (n,) within revolutions, and with the next ones.

    Returns
    -------
    unlagged_sums, lagged_sums : [Total at one probe, Total at two probes]
        Results of :func:`_sum_products` at lag 0, and at ``lag``.
    lag : int
        Distance to the next revolution: 1, or up to 5 if most revolutions between are missing.
    """
    unlagged_sums, *lagged_sums = _sum_products(values, range(6), places)
    lag = 1 + int(np.argmax([sums[1] / lag for lag, (sums, _) in enumerate(lagged_sums, 1)]))
    return unlagged_sums, lag, lagged_sums[lag - 1]


def _sum_products(values: np.ndarray, lags: Iterable[int], places: Places) -> Iterator[list[Total]]:
    """Yield sums of products in values (n,), by lag, at one probe and two."""
    arrays = [_arrange_by_revolution(part, places) for part in (values, np.ones(len(values)))]
    revolution_sums = [array.sum(axis=1) for array in arrays]
    for lag in lags:
        n_rows, sums = max(len(arrays[0]) - lag, 0), []
        for array, row_sums in zip(arrays, revolution_sums, strict=True):
            probe_sum = float((array[lag:] * array[:n_rows]).sum())
            sums.append((probe_sum, float(row_sums[lag:] @ row_sums[:n_rows]) - probe_sum))
        yield list(zip(*sums, strict=True))


def _arrange_by_revolution(values: np.ndarray, places: Places) -> np.ndarray:
    """Arrange values (n, ...) by revolution and probe, otherwise 0."""
    revolution, probe = places[0] - places[0].min(), places[1]
    table = np.zeros((int(revolution.max()) + 1, int(probe.max()) + 1, *values.shape[1:]))
    table[revolution, probe] = values
    return table


def reweighted(
    solve: Callable[[np.ndarray], np.ndarray], weights: np.ndarray, unknowns: int, min_scale: float
) -> Noise:
    """Find weights of arrivals, in turns with the residuals of a fit.

    Parameters
    ----------
    solve : callable
        Return residuals (n,) from a fit with weights (n,).
    weights : (n,)
        Initial weights.
    unknowns : int
        Number of coefficients in the fit.
    min_scale : float
        Minimum scale, by rounding.

    Returns
    -------
    Noise
        Residuals in the last round, with their weights.
    """
    previous_residuals, scales = np.inf, None
    for _ in range(ROBUST_ROUNDS):
        noise = Noise(solve(weights), unknowns, min_scale, scales)
        scales = noise.scales
        changes = (
            np.abs(noise.weights - weights).max(),
            np.abs(noise.residuals - previous_residuals).max(),
        )
        weights, previous_residuals = noise.weights, noise.residuals
        if changes[0] < ROBUST_SETTLED and changes[1] < ROBUST_SETTLED * noise.scale:
            break
    return noise


def refined(
    function: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    lower_bounds: Sequence[float] | np.ndarray,
    upper_bounds: Sequence[float] | np.ndarray,
    min_reduction: float = ROBUST_SETTLED,
) -> np.ndarray:
    """Return the least-squares residuals (n,), from unknowns (m,) = 0 on.

    Parameters
    ----------
    function : callable
        Return residuals (n,) and their derivatives (n, m) at unknowns with natural size 1. The last
        call is at the solution.
    lower_bounds, upper_bounds : (m,)
        Bounds of the unknowns, widened to include 0.
    min_reduction : float
        Relative reduction of the sum of squares, below which the search ends.
    """
    evaluate = lru_cache(maxsize=1)(lambda key: function(np.frombuffer(key)))
    solution = least_squares(
        lambda x: evaluate(x.tobytes())[0],
        np.zeros(len(lower_bounds)),
        lambda x: evaluate(x.tobytes())[1],
        bounds=(np.minimum(lower_bounds, 0.0), np.maximum(upper_bounds, 0.0)),
        method="dogbox",
        ftol=min_reduction,
        xtol=ROBUST_SETTLED,
        gtol=None,
    )
    return evaluate(solution.x.tobytes())[0]
