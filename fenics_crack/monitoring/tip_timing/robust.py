"""Errors of arrivals: Student's t instead of a normal distribution, and what follows from it.

Some arrivals are wrong by far more than the others scatter. Residuals r then follow Student's t
with nu degrees of freedom and a scale s, both fitted to them (Lange, Little and Taylor, Journal of
the American Statistical Association 84, 1989, 881); nu is large where they are normal. The
estimate is that of least squares with the weights

    w = (nu + 1) / (nu + r^2 / s^2)

by turns with the residuals that it leaves. Its covariance is that of an M-estimator (Huber, Robust
Statistics, 1981), H^-1 M H^-1, with H = mean(psi') X^T X and psi = w r; M = X^T C X holds the
correlation of psi between the probes of a revolution, whose marks they share, and between
revolutions, as far as it is seen in the residuals.
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
ROBUST_ROUNDS = 30
ROBUST_SETTLED = 1e-3
"""Change of the weights below which they are final."""
EPSILON = 1e-12
"""Columns are dependent below this share of the largest eigenvalue."""
FLOOR = 0.1
"""Of the variance by white errors, the least that correlation leaves."""
SEEN = 3.0
"""A correlation counts from so many of its standard deviations on."""


Pair = tuple[float, float]
Places = tuple[np.ndarray, np.ndarray]
"""Revolutions and probes of arrivals: two (n,)."""


@dataclass(frozen=True)
class Noise:
    """What a fit leaves, as errors from Student's t.

    Attributes
    ----------
    left : (n,)
        Residuals.
    weights : (n,)
        Of the arrivals in the fit.
    scale, freedom : float
        s and nu.
    unknowns : int
        Of the fit.
    """

    left: np.ndarray
    weights: np.ndarray
    scale: float
    freedom: float
    unknowns: int

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

    @property
    def cost(self) -> float:
        """-2 log likelihood."""
        square = (self.left / self.scale) ** 2
        return float(_cost(square[None], np.array([self.scale]), np.array([self.freedom]))[0])

    def whiteness(self, places: Places, shares: np.ndarray) -> float:
        """Probability that errors of the arrivals and of the marks alone are as correlated at a
        probe from each revolution to the next.

        An error e_n of a mark turns all arrivals around it: probe i in revolution n has the sum of
        shares_ki e_(n+k), ``shares`` (marks, probes). The variance of e is that which products of
        two probes in a revolution have; a probe's with its next ones then have the same times
        shares_ki shares_(k+1)i. What probes have in common scatters their products likewise.
        """
        (own, common), (later, others) = _products(self.psi, [0, 1], places)
        square, (total, count) = own[0] / own[1], later
        if not count or not square:
            return np.nan
        alike = max(common[0] / common[1], 0.0) if common[1] else 0.0
        now, after = shares.T @ shares, (shares[1:] * shares[:-1]).sum(axis=0)
        apart = now[~np.eye(len(now), dtype=bool)]
        by_marks = alike / apart.mean() * after.mean() if alike else 0.0
        scatter = square * np.sqrt(count + (alike / square) ** 2 * others[1])
        chance = float(ndtr((total - count * by_marks) / scatter))
        return 2.0 * min(chance, 1.0 - chance)

    def covariance(self, columns: np.ndarray, places: Places) -> np.ndarray:
        """Covariance (m, m) of the coefficients of columns (n, m), of arrivals at such places."""
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
        # No direction is known much better than by white errors.
        scale, turned = np.linalg.eigh(white)
        root = turned * np.where(scale > EPSILON * scale[-1], scale, np.inf) ** -0.5
        values, axes = np.linalg.eigh(root.T @ total @ root)
        root = (root @ axes) / sizes[:, None]
        return np.asarray((root * np.maximum(values, FLOOR * variance)) @ root.T / self.slope**2)

    def _correlated(self, variance: float, places: Places) -> list[tuple[float, float]]:
        """Covariances of psi at a probe (of revolution 0 beyond its variance), and at two, of
        revolutions 0, 1, ... apart, up to the first that are not seen."""
        found: list[tuple[float, float]] = []
        for lag, products in enumerate(_products(self.psi, itertools.count(), places)):
            seen = []
            for total, count in products:
                deviation = variance * np.sqrt(count if lag else 2.0 * count)
                seen.append(total / count if count and abs(total) > SEEN * deviation else 0.0)
            if lag == 0:
                seen[0] = 0.0
            elif not any(seen):
                break
            found.append((seen[0], seen[1]))
        return found


def student(freedom: float) -> float:
    """Variance of Student's t with so many degrees of freedom over the square of its scale: so much
    larger are squares of errors whose scale is that of few residuals. nan where it has none."""
    return 1.0 + 2.0 / (freedom - 2.0) if freedom > 2.0 else np.nan


def trend(values: np.ndarray, places: Places) -> float:
    """Probability that white values (n,) of revolutions and probes are as alike as these from each
    revolution to the next, or more; nan where there is one revolution."""
    [[(total, count), _]] = _products(values, [1], places)
    square = float(values @ values) / len(values)
    return float(ndtr(-total / (square * np.sqrt(count)))) if count and square else np.nan


def _products(values: np.ndarray, lags: Iterable[int], places: Places) -> Iterator[list[Pair]]:
    """Sums of products of values (n,) in revolutions that are some apart, and how many they are: at
    the same probe, and at two; of each lag."""
    parts = [_dense(part, places) for part in (values, np.ones(len(values)))]
    totals = [dense.sum(axis=1) for dense in parts]
    for lag in lags:
        end, found = max(len(parts[0]) - lag, 0), []
        for dense, rows in zip(parts, totals, strict=True):
            own = float((dense[lag:] * dense[:end]).sum())
            found.append((own, float(rows[lag:] @ rows[:end]) - own))
        yield list(zip(*found, strict=True))


def _dense(values: np.ndarray, places: Places) -> np.ndarray:
    """Values (n, ...) by revolution and probe, 0 where there are none."""
    turn, probe = places[0] - places[0].min(), places[1]
    found = np.zeros((int(turn.max()) + 1, int(probe.max()) + 1, *values.shape[1:]))
    found[turn, probe] = values
    return found


def reweighted(
    solve: Callable[[np.ndarray], np.ndarray],
    weights: np.ndarray,
    unknowns: int,
    least: float,
    settled: float = ROBUST_SETTLED,
) -> Noise:
    """Weights of arrivals, by turns with what a fit with these weights leaves.

    Parameters
    ----------
    solve : callable
        Residuals (n,) of a fit with weights (n,), or of its next step.
    weights : (n,)
        To begin with.
    unknowns : int
        Coefficients of the fit.
    least : float
        The scale is no smaller: rounding.
    settled : float
        Change of the weights, and of the residuals over their scale, below which they are final.
    """
    before, scales = np.inf, None
    for _ in range(ROBUST_ROUNDS):
        noise, scales = _noise(solve(weights), unknowns, scales, least)
        change = np.abs(noise.weights - weights).max(), np.abs(noise.left - before).max()
        weights, before = noise.weights, noise.left
        if change[0] < settled and change[1] < settled * noise.scale:
            break
    return noise


def refined(
    function: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    low: Sequence[float] | np.ndarray,
    high: Sequence[float] | np.ndarray,
    settled: float = ROBUST_SETTLED,
) -> np.ndarray:
    """Return the unknowns (m,) of least squares, from 0 on.

    Parameters
    ----------
    function : callable
        Residuals (n,) and their derivatives (n, m) at unknowns, whose natural size is 1.
    low, high : (m,)
        Bounds of the unknowns.
    settled : float
        Relative change of the unknowns, and root of that of the sum of squares, below which they
        are final.
    """
    both = lru_cache(maxsize=1)(lambda key: function(np.frombuffer(key)))
    found = least_squares(
        lambda x: both(x.tobytes())[0],
        np.zeros(len(low)),
        lambda x: both(x.tobytes())[1],
        bounds=(np.minimum(low, 0.0), np.maximum(high, 0.0)),
        method="dogbox",
        ftol=settled**2,
        xtol=settled,
        gtol=None,
    )
    return np.asarray(found.x)


def _cost(square: np.ndarray, scale: np.ndarray, freedom: np.ndarray) -> np.ndarray:
    """-2 log likelihood of squares of residuals over scales, (k, n), by scales and degrees of
    freedom (k,)."""
    each = 2.0 * (gammaln(0.5 * freedom) - gammaln(0.5 * freedom + 0.5) + np.log(scale))
    each += np.log(freedom * np.pi)
    tails = np.log1p(square / freedom[:, None]).sum(axis=1)
    return np.asarray(square.shape[1] * each + (freedom + 1.0) * tails)


def _noise(
    left: np.ndarray, unknowns: int, scales: np.ndarray | None, least: float
) -> tuple[Noise, np.ndarray]:
    """Scale and degrees of freedom of residuals, by maximum likelihood; and the scales by all that
    are tried, from which those of the next residuals begin.

    What the scale was too small by in the weighted squares is 1 + 3 / nu times less than in its own
    square where residuals follow Student's t (its information is 2 nu / (nu + 3)); where they do
    not, steps that much longer still come nearer each time.
    """
    square, spare = left**2, max(len(left) - unknowns, 1)
    # As many arrivals as unknowns may be met exactly: no tails are seen where few are to spare.
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
    scaled = square / value[:, None] ** 2
    # Tails are one unknown more, by which the likelihood has to gain (Akaike's criterion).
    costs = _cost(scaled, value, freedoms) + 2.0 * (freedoms < FREEDOMS[-1])
    best = int(np.argmin(costs))
    freedom = float(freedoms[best])
    weights = (freedom + 1.0) / (freedom + scaled[best])
    return Noise(left, weights, float(value[best]), freedom, unknowns), value
