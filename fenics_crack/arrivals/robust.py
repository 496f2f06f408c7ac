"""Errors of arrivals: Student's t instead of a normal distribution, and confidence levels.

Some arrivals are wrong by far more than the others scatter. Residuals r then follow Student's t
with nu degrees of freedom and a scale s, both fitted to them (Lange, Little and Taylor, Journal of
the American Statistical Association 84, 1989, 881); nu is large where they are normal. The
estimate is that of least squares with the weights

    w = (nu + 1) / (nu + r^2 / s^2)

by turns with the residuals that it leaves. Its covariance is that of an M-estimator (Huber, Robust
Statistics, 1981), H^-1 M H^-1, with H = mean(psi') X^T X and psi = w r; M = X^T C X holds the
correlation of psi between the probes of a revolution, whose marks they share, and between
revolutions, as far as it is significant in the residuals.
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
"""Degrees of freedom that are tried."""
ROBUST_ROUNDS, ROBUST_SETTLED = 30, 1e-2
"""Maximum rounds of weights, and their change, and that of residuals over their scale, below which
they are final: some hundredths of a standard error."""
DEPENDENT = 1e-12
"""Columns are dependent below this fraction of the largest eigenvalue."""


@dataclass(frozen=True)
class Confidence:
    """Levels of significance.

    Attributes
    ----------
    chance : float
        Probability in noise below which a vibration is significant.
    gain : float
        Reduction of -2 log likelihood above which a resonance is: some 1e5 are tried, each with six
        unknowns.
    misfit : float
        Probability of residuals below which a model does not explain them.
    scatter : float
        Probability of a misfit above which errors follow from the scatter, else from the misfit.
    deviations : float
        Standard deviations within which candidates fit equally well, and correlation is none.
    """

    chance: float = 1e-5
    gain: float = 60.0
    misfit: float = 1e-3
    scatter: float = 1e-2
    deviations: float = 3.0

    @property
    def equal(self) -> float:
        """Difference of sums of squares, in variances, within which candidates fit equally well."""
        return self.deviations**2


LEVELS = Confidence()

Pair = tuple[float, float]
Places = tuple[np.ndarray, np.ndarray]
"""Revolutions and probes of arrivals: two (n,)."""


class Noise:
    """Residuals of a fit, as errors from Student's t of the most likely scale and degrees of
    freedom.

    Steps of the scale are 1 + 3 / nu times those of the weighted squares, as the information of
    Student's t, 2 nu / (nu + 3), has it.

    Parameters
    ----------
    left : (n,)
        Residuals.
    unknowns : int
        Number of unknowns of the fit.
    least : float
        Minimum of the scale: rounding.
    scales : (k,)
        Scales of all degrees that are tried, of the residuals before, from which these begin.

    Attributes
    ----------
    weights : (n,)
        Weights of the arrivals in the fit.
    scale, freedom : float
        s and nu.
    cost : float
        -2 log likelihood.
    """

    def __init__(
        self, left: np.ndarray, unknowns: int, least: float, scales: np.ndarray | None = None
    ) -> None:
        self.left, self.unknowns = left, unknowns
        square, spare = left**2, max(len(left) - unknowns, 1)
        # As many arrivals as unknowns may be met exactly: few to spare have no tails.
        freedoms = FREEDOMS if spare > unknowns else FREEDOMS[-1:]
        if scales is None:
            scale = 1.5 * float(np.median(np.abs(left))) * np.sqrt(len(left) / spare)
            scales = np.full(len(freedoms), scale)
        value, nu = np.maximum(scales, least), freedoms[:, None]
        for _ in range(ROBUST_ROUNDS):
            scaled = square / value[:, None] ** 2
            ratio = (nu + 1.0) / (nu + scaled) @ square / (spare * value**2)
            before, value = value, np.maximum(value * ratio ** (0.5 + 1.5 / freedoms), least)
            if np.all(np.abs(value - before) < ROBUST_SETTLED * value):
                break
        self.scales, scaled = value, square / value[:, None] ** 2
        each = 2.0 * (gammaln(0.5 * freedoms) - gammaln(0.5 * freedoms + 0.5) + np.log(value))
        each += np.log(freedoms * np.pi)
        costs = len(left) * each + (freedoms + 1.0) * np.log1p(scaled / nu).sum(axis=1)
        # Tails are one unknown more, by which the likelihood has to gain (Akaike's criterion).
        best = int(np.argmin(costs + 2.0 * (freedoms < FREEDOMS[-1])))
        self.scale, self.freedom, self.cost = (float(one[best]) for one in (value, freedoms, costs))
        self.weights = (self.freedom + 1.0) / (self.freedom + scaled[best])

    @property
    def psi(self) -> np.ndarray:
        """Weighted residuals: (n,)."""
        return self.weights * self.left

    @property
    def slope(self) -> float:
        """Mean of psi'."""
        square = (self.left / self.scale) ** 2
        change = (self.freedom + 1.0) * (self.freedom - square) / (self.freedom + square) ** 2
        return float(np.mean(change))

    @property
    def variance(self) -> float:
        """Variance of the errors of an estimate by as many normal errors as there are residuals."""
        spare = len(self.left) - self.unknowns
        return float(self.psi @ self.psi) / (spare * self.slope**2)

    def whiteness(self, places: Places, shares: np.ndarray) -> float:
        """Probability that errors of the arrivals and of the marks alone are as correlated at a
        probe from each revolution to the next one with arrivals (:func:`_neighbours`).

        An error e_n of a mark turns all arrivals around it: probe i in revolution n has the sum of
        shares_ki e_(n+k), ``shares`` (marks, probes). The variance of e is that which products of
        two probes in a revolution have; a probe's with its next ones then have the same times
        shares_ki shares_(k+1)i, or with those m revolutions later shares_ki shares_(k+m)i. What
        probes have in common scatters their products likewise.
        """
        (own, common), lag, ((total, count), others) = _neighbours(self.psi, places)
        square = own[0] / own[1]
        if not count or not square:
            return np.nan
        shared = max(common[0] / common[1], 0.0) if common[1] else 0.0
        now, after = shares.T @ shares, (shares[lag:] * shares[:-lag]).sum(axis=0)
        apart = now[~np.eye(len(now), dtype=bool)]
        by_marks = shared / apart.mean() * after.mean() if shared else 0.0
        scatter = square * np.sqrt(count + (shared / square) ** 2 * others[1])
        chance = float(ndtr((total - count * by_marks) / scatter))
        return 2.0 * min(chance, 1.0 - chance)

    def covariance(self, columns: np.ndarray, places: Places) -> np.ndarray:
        """Return the covariance (m, m) of the coefficients of columns (n, m), of arrivals at
        places."""
        sizes = np.linalg.norm(columns, axis=0)
        columns = columns / sizes
        dense = _dense(columns, places)
        rows, white = dense.sum(axis=1), columns.T @ columns
        variance = float(self.psi @ self.psi) / (len(self.psi) - self.unknowns)
        total = variance * white
        lags = self._correlated(variance, places)
        for lag, (own, other) in enumerate(lags):
            ahead, behind = slice(lag, None), slice(len(rows) - lag)
            at_one, all_of = (
                part[ahead].reshape(-1, len(white)).T @ part[behind].reshape(-1, len(white))
                for part in (dense, rows)
            )
            part = own * at_one + other * (all_of - at_one)
            total += (1.0 - lag / len(lags)) * (part if lag == 0 else part + part.T)
        # Correlation leaves a tenth or more of the variance by white errors.
        scale, turned = np.linalg.eigh(white)
        root = turned * np.where(scale > DEPENDENT * scale[-1], scale, np.inf) ** -0.5
        values, axes = np.linalg.eigh(root.T @ total @ root)
        root = (root @ axes) / sizes[:, None]
        return np.asarray((root * np.maximum(values, 0.1 * variance)) @ root.T / self.slope**2)

    def _correlated(self, variance: float, places: Places) -> list[tuple[float, float]]:
        """Return covariances of psi at a probe (of revolution 0 beyond its variance), and at two,
        of revolutions 0, 1, ... apart, up to the first that are not significant."""
        found: list[tuple[float, float]] = []
        for lag, products in enumerate(_products(self.psi, itertools.count(), places)):
            seen = []
            for total, count in products:
                limit = LEVELS.deviations * variance * np.sqrt(count if lag else 2.0 * count)
                seen.append(total / count if count and abs(total) > limit else 0.0)
            if lag == 0:
                seen[0] = 0.0
            elif not any(seen):
                break
            found.append((seen[0], seen[1]))
        return found


def student(freedom: float) -> float:
    """Return the variance of Student's t over the square of its scale, by which squares of errors
    are larger whose scale is that of few residuals; nan where it has none."""
    return 1.0 + 2.0 / (freedom - 2.0) if freedom > 2.0 else np.nan


def trend(values: np.ndarray, places: Places) -> float:
    """Return the probability that white values (n,) of revolutions and probes are as correlated
    from each revolution to the next as these, or more; nan where there is one revolution."""
    _, _, [(total, count), _] = _neighbours(values, places)
    square = float(values @ values) / len(values)
    return float(ndtr(-total / (square * np.sqrt(count)))) if count and square else np.nan


def _neighbours(values: np.ndarray, places: Places) -> tuple[list[Pair], int, list[Pair]]:
    """Return :func:`_products` of revolutions with themselves and with their next ones, and the
    distance of these: 1, or up to 5 where most revolutions between are missing."""
    now, *later = _products(values, range(6), places)
    lag = 1 + int(np.argmax([own[1] / lag for lag, (own, _) in enumerate(later, 1)]))
    return now, lag, later[lag - 1]


def _products(values: np.ndarray, lags: Iterable[int], places: Places) -> Iterator[list[Pair]]:
    """Yield for each lag of revolutions the sums of products of values (n,), and their numbers: at
    the same probe, and at two."""
    parts = [_dense(part, places) for part in (values, np.ones(len(values)))]
    totals = [dense.sum(axis=1) for dense in parts]
    for lag in lags:
        end, found = max(len(parts[0]) - lag, 0), []
        for dense, rows in zip(parts, totals, strict=True):
            own = float((dense[lag:] * dense[:end]).sum())
            found.append((own, float(rows[lag:] @ rows[:end]) - own))
        yield list(zip(*found, strict=True))


def _dense(values: np.ndarray, places: Places) -> np.ndarray:
    """Return values (n, ...) by revolution and probe, 0 where there are none."""
    turn, probe = places[0] - places[0].min(), places[1]
    found = np.zeros((int(turn.max()) + 1, int(probe.max()) + 1, *values.shape[1:]))
    found[turn, probe] = values
    return found


def reweighted(
    solve: Callable[[np.ndarray], np.ndarray], weights: np.ndarray, unknowns: int, least: float
) -> Noise:
    """Find the weights of arrivals, by turns with the residuals of a fit with these weights.

    Parameters
    ----------
    solve : callable
        Residuals (n,) of a fit with weights (n,).
    weights : (n,)
        To begin with.
    unknowns : int
        Number of coefficients of the fit.
    least : float
        Minimum of the scale: rounding.
    """
    before, scales = np.inf, None
    for _ in range(ROBUST_ROUNDS):
        noise = Noise(solve(weights), unknowns, least, scales)
        scales = noise.scales
        change = np.abs(noise.weights - weights).max(), np.abs(noise.left - before).max()
        weights, before = noise.weights, noise.left
        if change[0] < ROBUST_SETTLED and change[1] < ROBUST_SETTLED * noise.scale:
            break
    return noise


def refined(
    function: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    low: Sequence[float] | np.ndarray,
    high: Sequence[float] | np.ndarray,
    gain: float = ROBUST_SETTLED,
) -> np.ndarray:
    """Find unknowns (m,) by least squares, from 0 on, and return their residuals (n,).

    Parameters
    ----------
    function : callable
        Residuals (n,) and their derivatives (n, m) at unknowns, whose natural size is 1; called
        with those that are found last.
    low, high : (m,)
        Bounds of the unknowns.
    gain : float
        Relative reduction of the sum of squares by the last step.
    """
    both = lru_cache(maxsize=1)(lambda key: function(np.frombuffer(key)))
    found = least_squares(
        lambda x: both(x.tobytes())[0],
        np.zeros(len(low)),
        lambda x: both(x.tobytes())[1],
        bounds=(np.minimum(low, 0.0), np.maximum(high, 0.0)),
        method="dogbox",
        ftol=gain,
        xtol=ROBUST_SETTLED,
        gtol=None,
    )
    return both(found.x.tobytes())[0]
