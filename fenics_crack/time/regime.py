"""Motion while no pair opens or closes: linear, in closed form, and when it ends.

The modal coordinates z = (s q, q') of a small structure obey, with one set of closed pairs,

    z(t) = z_p(t) + V exp(L (t - t0)) V^-1 (z0 - z_p(t0)),

z_p the steady response to the load with these pairs closed, V and L eigenvectors and eigenvalues
of the flow. The next instant at which a pair opens or closes is bracketed on a grid that resolves
the fastest mode, which also shows extremes between its points, and polished by Brent's method. The
error is that of the roots, about 1e-12.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import scipy.optimize

from fenics_crack.errors import ConvergenceError
from fenics_crack.model.modal import AllModes, flow_matrix
from fenics_crack.model.structure import Structure

__all__ = ["FreeMotion", "Gaps", "Regime", "next_event"]

BLOCK = 64


class FreeMotion:
    """What does not depend on the load's frequency with one set of closed pairs: the flow z' = A z
    (``matrix``) with its ``values`` L, ``vectors`` V and ``inverse`` V^-1, and the response q to
    the mean load (``static``)."""

    def __init__(
        self, structure: Structure, modes: AllModes, stiffness: np.ndarray, scale: float
    ) -> None:
        count = len(modes.squares)
        self.matrix = flow_matrix(modes, stiffness, scale)
        values, vectors = np.linalg.eig(self.matrix)
        mean = structure.force[0] @ modes.shapes + modes.pairs @ (stiffness * structure.clearance)
        self.static = np.linalg.lstsq(-scale * self.matrix[count:, :count], mean, rcond=None)[0]
        try:
            inverse = np.linalg.inv(vectors)
        except np.linalg.LinAlgError:
            raise ConvergenceError("events: a mode with exactly critical damping") from None
        self.values: np.ndarray = values
        self.vectors, self.inverse = vectors.astype(complex), inverse.astype(complex)
        fastest = np.abs(values.imag).max() or np.abs(values).max()
        self.step = 2.0 * np.pi / fastest / 12.0
        """A twelfth of the period of the fastest mode [s]."""
        self.powers = np.exp(np.outer(values, self.step * np.arange(BLOCK + 1)))
        """exp(L j step): (2n, BLOCK + 1)."""


class Regime:
    """The flow with one set of closed pairs under the load: z_p = mean + Re(harmonic e^(iwt))."""

    def __init__(
        self, free: FreeMotion, structure: Structure, modes: AllModes, omega: float, scale: float
    ) -> None:
        self.free, self.omega = free, omega
        count, matrix = len(modes.squares), free.matrix
        _, cosine, sine = structure.force @ modes.shapes
        response: np.ndarray = np.zeros(count, dtype=complex)
        if np.any(cosine) or np.any(sine):
            stiffness, damping = -scale * matrix[count:, :count], -matrix[count:, count:]
            impedance = stiffness - omega**2 * np.eye(count) + 1j * omega * damping
            response = np.linalg.solve(impedance, cosine - 1j * sine)
        self.mean = np.concatenate([scale * free.static, np.zeros(count)])
        self.harmonic = np.concatenate([scale * response, 1j * omega * response])

    def steady(self, time: float) -> np.ndarray:
        """z_p at an instant: (2n,)."""
        return self.mean + (np.exp(1j * self.omega * time) * self.harmonic).real

    def weights(self, state: np.ndarray, time: float) -> np.ndarray:
        """Modal weights of a state: V^-1 (z - z_p), (2n,)."""
        return self.free.inverse @ (state - self.steady(time))

    def sampled(
        self, rows: np.ndarray, weights: np.ndarray, start: float, times: np.ndarray
    ) -> np.ndarray:
        """``rows @ z`` at instants (m,), from the weights at ``start``: (m, n_rows)."""
        motion = np.exp(np.outer(times - start, self.free.values)) * weights
        turn = np.exp(1j * self.omega * times)[:, None]
        steady = self.mean + (turn * self.harmonic).real
        return (motion @ (rows @ self.free.vectors).T).real + steady @ rows.T


class Gaps:
    """Gaps in a regime from an instant on, signed: a pair leaves its state when its gap is > 0."""

    def __init__(
        self,
        regime: Regime,
        rows: np.ndarray,
        clearance: np.ndarray,
        closed: np.ndarray,
        weights: np.ndarray,
        start: float,
    ) -> None:
        self._regime, self._start, self._values = regime, start, regime.free.values
        self._side = np.where(closed, -1.0, 1.0)
        self._free = (rows @ regime.free.vectors) * weights
        self._rates = self._free * self._values
        self._offset = rows @ regime.mean - clearance
        self._forced = rows @ regime.harmonic
        sizes = np.abs(self._free).sum(axis=1) + np.abs(self._forced) + np.abs(self._offset)
        self.rounding = 1e-14 * sizes
        self.step = regime.free.step

    def value(self, pair: int, t: float) -> float:
        """Signed gap of a pair."""
        wave = np.exp(self._values * t) @ self._free[pair]
        steady = self._forced[pair] * np.exp(1j * self._regime.omega * (self._start + t))
        return float(self._side[pair] * (wave.real + steady.real + self._offset[pair]))

    def slope(self, pair: int, t: float) -> float:
        """Its derivative."""
        omega = self._regime.omega
        wave = np.exp(self._values * t) @ self._rates[pair]
        steady = 1j * omega * self._forced[pair] * np.exp(1j * omega * (self._start + t))
        return float(self._side[pair] * (wave.real + steady.real))

    def block(self, reached: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Instants of the grid from ``reached`` on, and all gaps and slopes there."""
        free, omega = self._regime.free, self._regime.omega
        times = reached + free.step * np.arange(BLOCK + 1)
        turn = np.exp(1j * omega * (self._start + times))
        carried = np.exp(self._values * reached)
        forced = self._forced[:, None] * turn
        values = ((self._free * carried) @ free.powers).real + forced.real
        slopes = ((self._rates * carried) @ free.powers).real
        slopes = slopes + (1j * omega * self._forced[:, None] * turn).real
        side = self._side[:, None]
        return times, side * (values + self._offset[:, None]), side * slopes


def next_event(gaps: Gaps, duration: float, switched: int) -> tuple[int, float]:
    """The first pair that changes its state, and when; -1 and the duration if none does.
    ``switched`` is the pair that has changed its state at the start, or -1."""
    reached = 0.0
    while reached < duration:
        times, values, slopes = gaps.block(reached)
        if reached == 0.0:  # all are in their states: what is outside is rounding
            values[:, 0] = np.minimum(values[:, 0], 0.0)
            if switched >= 0:
                values[switched, 0] = -0.0
        pair, root = _first_root(gaps, times, values, slopes, switched)
        if pair >= 0:
            return (pair, root) if root < duration else (-1, duration)
        reached += BLOCK * gaps.step
    return -1, duration


def _first_root(
    gaps: Gaps, times: np.ndarray, values: np.ndarray, slopes: np.ndarray, switched: int
) -> tuple[int, float]:
    """The first pair that leaves its state in a block, and when; -1 if none does."""
    first, found = np.inf, -1
    crosses = (values[:, :-1] <= 0.0) & (values[:, 1:] > 0.0)
    # Both ends inside, but a summit between them may reach out.
    summit = (slopes[:, :-1] > 0.0) & (slopes[:, 1:] < 0.0) & ~crosses
    reach = values[:, :-1] + gaps.step * slopes[:, :-1]
    for pair, cell in zip(*np.nonzero(crosses | (summit & (reach > 0.0))), strict=True):
        low, high = times[cell], times[cell + 1]
        if low >= first:
            continue
        gap, slope = partial(gaps.value, pair), partial(gaps.slope, pair)
        if not crosses[pair, cell]:
            if not slope(low) > 0.0 > slope(high):
                continue  # but for rounding
            high = scipy.optimize.brentq(slope, low, high)
            if gap(high) <= gaps.rounding[pair]:
                continue
        back = pair == switched and low == 0.0
        root = _return(gap, slope, high) if back else _root(gap, low, high)
        if root is not None and root < first:
            first, found = root, int(pair)
    return found, first


def _root(gap: Callable[[float], float], low: float, high: float) -> float:
    """Root of a gap that is inside at ``low`` and outside at ``high``."""
    if gap(low) >= 0.0:
        return low
    if gap(high) <= 0.0:  # but for rounding
        return high
    return float(scipy.optimize.brentq(gap, low, high, xtol=1e-18, rtol=1e-14))


def _return(
    gap: Callable[[float], float], slope: Callable[[float], float], high: float
) -> float | None:
    """When a pair that has switched at time 0 switches back before ``high``; None if it does not.
    It goes in first and comes out again, so there is an extreme between."""
    if slope(0.0) >= 0.0 or slope(high) <= 0.0:
        return None
    deepest = float(scipy.optimize.brentq(slope, 0.0, high))
    return _root(gap, deepest, high) if gap(deepest) < 0.0 < gap(high) else None
