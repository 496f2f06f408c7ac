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

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, ndtr

__all__ = ["Noise", "reweighted"]

FREEDOMS = np.array([3.0, 5.0, 10.0, 30.0, 1e6])
"""Degrees of freedom that are tried."""
ROUNDS = 30
SETTLED = 1e-3
"""Change of the weights below which they are final."""
SEEN = 3.0
"""A correlation counts from so many of its standard deviations on."""


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
        nu, square = self.freedom, (self.left / self.scale) ** 2
        each = 2.0 * (gammaln(0.5 * nu) - gammaln(0.5 * nu + 0.5) + np.log(self.scale))
        each += np.log(nu * np.pi)
        return float(len(square) * each + (nu + 1.0) * np.log1p(square / nu).sum())

    def correlations(self, turn: np.ndarray, probe: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Covariances of psi at a probe, and of two probes, of revolutions 0, 1, ... apart, up to
        the first that is not seen."""
        dense = np.zeros((int(turn.max()) + 1, int(probe.max()) + 1))
        there = dense.copy()
        dense[turn, probe], there[turn, probe] = self.psi, 1.0
        square = float(self.psi @ self.psi) / (len(self.psi) - self.unknowns)
        own, others = [square], []
        rows, counts = dense.sum(axis=1), there.sum(axis=1)
        for lag in range(len(dense)):
            end = len(dense) - lag
            same = float((dense[lag:] * dense[:end]).sum())
            pairs = float((there[lag:] * there[:end]).sum())
            cross = float(rows[lag:] @ rows[:end]) - same
            crossed = max(float(counts[lag:] @ counts[:end]) - pairs, 1.0)
            deviation = square / np.sqrt(0.5 * crossed if lag == 0 else crossed)
            seen = abs(cross / crossed) > SEEN * deviation
            if lag and abs(same / max(pairs, 1.0)) > SEEN * square / np.sqrt(max(pairs, 1.0)):
                own.append(same / pairs)
                seen = True
            elif lag:
                own.append(0.0)
            others.append(cross / crossed if seen else 0.0)
            if lag and not seen:
                break
        return np.array(own), np.array(others)

    def whiteness(self, turn: np.ndarray, probe: np.ndarray) -> float:
        """Probability that white errors are as correlated from revolution to revolution."""
        dense = np.full((int(turn.max()) + 1, int(probe.max()) + 1), np.nan)
        dense[turn, probe] = self.psi
        pairs = dense[1:] * dense[:-1]
        count = int(np.isfinite(pairs).sum())
        if not count:
            return np.nan
        score = float(np.nansum(pairs)) / float(self.psi @ self.psi) * len(self.psi)
        return float(2.0 * ndtr(-abs(score) / np.sqrt(count)))

    def covariance(self, columns: np.ndarray, turn: np.ndarray, probe: np.ndarray) -> np.ndarray:
        """Covariance (m, m) of the coefficients of columns (n, m)."""
        own, others = self.correlations(turn, probe)
        shape = int(turn.max()) + 1, int(probe.max()) + 1, columns.shape[1]
        dense = np.zeros(shape)
        dense[turn, probe] = columns
        rows = dense.sum(axis=1)
        total = np.zeros(2 * shape[2:])
        for lag, (mine, other) in enumerate(zip(own, others, strict=True)):
            end = len(rows) - lag
            part = other * (rows[lag:].T @ rows[:end])
            flat = dense[lag:].reshape(-1, shape[2]), dense[:end].reshape(-1, shape[2])
            part += (mine - other) * (flat[0].T @ flat[1])
            total += part if lag == 0 else part + part.T
        inverse = np.linalg.pinv(columns.T @ columns, hermitian=True) / self.slope
        return np.asarray(inverse @ total @ inverse)


def reweighted(
    solve: Callable[[np.ndarray], np.ndarray], count: int, unknowns: int, least: float
) -> Noise:
    """Weights of arrivals, by turns with what a fit with these weights leaves.

    Parameters
    ----------
    solve : callable
        Residuals (n,) of a fit with weights (n,), or of its next step.
    count, unknowns : int
        Of the arrivals and of the coefficients.
    least : float
        The scale is no smaller: rounding.
    """
    weights, before, scale = np.ones(count), np.inf, 0.0
    for _ in range(ROUNDS):
        noise = _noise(solve(weights), unknowns, scale, least)
        change = np.abs(noise.weights - weights).max(), np.abs(noise.left - before).max()
        weights, before, scale = noise.weights, noise.left, noise.scale
        if change[0] < SETTLED and change[1] < SETTLED * scale:
            break
    return noise


def _noise(left: np.ndarray, unknowns: int, scale: float, least: float) -> Noise:
    """Scale and degrees of freedom of residuals, by maximum likelihood."""
    square, spare = left**2, max(len(left) - unknowns, 1)
    # As many arrivals as unknowns may be met exactly: no tails are seen where few are to spare.
    freedoms = FREEDOMS if spare > unknowns else FREEDOMS[-1:]
    found = []
    begin = scale or 1.5 * float(np.median(np.abs(left))) * np.sqrt(len(left) / spare)
    for freedom in freedoms:
        value = max(begin, least)
        for _ in range(ROUNDS):
            weights = (freedom + 1.0) / (freedom + square / value**2)
            before, value = value, max(float(np.sqrt(weights @ square / spare)), least)
            if abs(value - before) < SETTLED * value:
                break
        weights = (freedom + 1.0) / (freedom + square / value**2)
        found.append(Noise(left, weights, value, float(freedom), unknowns))
    return min(found, key=lambda noise: noise.cost)
