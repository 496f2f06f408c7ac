"""Asynchronous vibration from arrival times: its frequency by a scan of least-squares fits.

At a frequency that is no multiple of the speed each revolution sees another point of the period,
so few probes suffice; but a probe alone samples once per revolution, and orders p, p + 1, p + 2,
... and their mirror images 1 - p, 2 - p, ... look the same to it. Probes at other angles see the
aliases with other phases: two suffice (Lacaze, arXiv:1711.06135), though not two opposite each
other, which see every second alias with the same phase. The vibration is one in time,

    u = c_j + sum_k a_k cos(k w t) + b_k sin(k w t)

so the speed may vary. Its constant is that of all probes, but for errors of their angles; or each
probe's own, which then holds all that follows the speed. The scan is a periodogram of what the
constants leave, summed over the harmonics (Lomb, Astrophysics and Space Science 39, 1976, 447), at
unevenly spaced times by the FFT (Greengard and Lee, SIAM Review 46, 2004, 443). Least squares then
fit frequency, harmonics and constants to its best peaks (Zechmeister and Kürster, Astronomy and
Astrophysics 496, 2009, 577), and the best of them with the weights of
:mod:`fenics_crack.arrivals.robust`.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import chdtrc

from fenics_crack.arrivals.arrival_times import ArrivalTimes
from fenics_crack.arrivals.harmonics import ORDERS, Candidates, TipFit, condition, select_candidate
from fenics_crack.arrivals.robust import LEVELS, ROBUST_SETTLED, refined, reweighted, student
from fenics_crack.basics.errors import InputError, check_count, check_number
from fenics_crack.basics.tables import TURN
from fenics_crack.numerics.fourier import fourier_basis

MOST_FREQUENCIES = 10**8
"""Maximum number in a scan: a record of a million revolutions has as many for orders up to 24."""
PEAKS, LOWEST = 40, 0.5
"""Maximum number of peaks of a scan that are refined, and their height over the highest."""


def fit_frequency(
    arrivals: ArrivalTimes,
    low: float,
    high: float,
    *,
    harmonics: int = 1,
    angle_deviation: float = 0.0,
) -> TipFit:
    """Find a vibration of any frequency by least squares.

    Of frequencies that fit equally well, within errors, the one with the smallest vibration is
    taken and the others are reported, as by :func:`fit_order`. Give no more harmonics than needed:
    with two, half a frequency may explain it by its second harmonic, too.

    Parameters
    ----------
    arrivals : ArrivalTimes
        The speed may vary.
    low, high : float [rad/s]
        Range in which the frequency of the load is sought.
    harmonics : int
        K.
    angle_deviation : float [rad]
        Standard deviation of the probes' angles, the same in every revolution.

    Returns
    -------
    TipFit
        Its order is any number, frequency over mean speed, with a standard error.

    Raises
    ------
    InputError
        A value cannot be used, there are too few arrivals, they are not where the probes are, or
        those of a probe alone do not vary: a vibration of a whole order looks like none to it.

    Examples
    --------
    >>> fit = fc.fit_frequency(arrivals, 1800.0, 2200.0)
    """
    check_number("low", low, 0.0, above=True)
    check_number("high", high, low, above=True)
    check_count("harmonics", harmonics, 1)
    arrivals.check_places(angle_deviation)
    seen = np.isfinite(arrivals.time)
    count, own = int(seen.sum()), int(seen.any(axis=0).sum()) if angle_deviation else 1
    if count <= (unknowns := 2 * harmonics + 1 + own):
        raise InputError("arrivals", f"{count} arrivals", f"more than {unknowns}")
    shape = arrivals.time.shape
    constants = np.arange(shape[1]) * bool(angle_deviation) * np.ones(shape, dtype=int)
    values, ends = arrivals.displacement, (low, high)
    fit, chance = _Sought(arrivals, values, constants, harmonics, angle_deviation, ends).best()
    if len(arrivals.probes) == 1 and chance > LEVELS.chance:
        found = f"one at {np.degrees(arrivals.probes[0]):g} degrees, whose arrivals do not vary"
        allowed = "two or more: to one a vibration of a whole order is no vibration"
        raise InputError("probes", found, allowed)
    return fit


def find_lines(
    arrivals: ArrivalTimes, values: np.ndarray, constants: np.ndarray, highest: float, most: int = 3
) -> tuple[tuple[TipFit, ...], np.ndarray]:
    """Find significant vibrations of constant frequency, beside constants that hold all that
    follows the speed; return them, and the displacements without them.

    Parameters
    ----------
    arrivals : ArrivalTimes
        The speed may vary.
    values : (revolutions, probes) [m]
        Displacements in which they are sought, one after the other.
    constants : (revolutions, probes) int
        Number of the constant of each displacement.
    highest : float
        Order up to which they are sought, from half the speed on; no lower than the orders that are
        tried where none are given.
    most : int
        Maximum number of vibrations.
    """
    found: list[TipFit] = []
    speed = arrivals.mean_speed
    ends = 0.5 * speed, speed * (max(highest, ORDERS[-1]) + 1.0)
    left, count = np.array(values), len(np.unique(constants[np.isfinite(values)]))
    while len(found) < most and np.isfinite(left).sum() > 2 * (count + 3):
        fit, chance = _Sought(arrivals, left, constants, 1, np.inf, ends).best()
        if chance > LEVELS.chance:
            break
        found.append(fit)
        left -= fit.displacement(fit.phases(arrivals)) - fit.coefficients[0]
    return tuple(found), left


class _Sought:
    """Least squares of a vibration in time, and a constant for each probe.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Record with the times and probes.
    values : (revolutions, probes) [m]
        Displacements; nan where there is none.
    constants : (revolutions, probes) int
        Number of the constant of each of them.
    harmonics : int
        K.
    deviation : float [rad]
        Standard deviation of the constants, as angles; inf: they are free.
    ends : (float, float) [rad/s]
        Range in which the frequency is sought.
    """

    def __init__(
        self,
        arrivals: ArrivalTimes,
        values: np.ndarray,
        constants: np.ndarray,
        harmonics: int,
        deviation: float,
        ends: tuple[float, float],
    ) -> None:
        seen = np.isfinite(values)
        self._places, self._ends = np.nonzero(seen), ends
        self._arrivals, self._values = arrivals, values[seen]
        self._time = arrivals.time[seen] - arrivals.marks[0]
        self._expected = arrivals.expected[seen] - arrivals.marks[0]
        self._multiples = np.arange(1.0, harmonics + 1.0)
        turn, _ = self._places
        self._span = float(arrivals.marks[turn.max() + 1] - arrivals.marks[turn.min()])
        self._own = (constants[seen][:, None] == np.unique(constants[seen])).astype(float)
        self._unknowns = 2 * harmonics + 1 + self._own.shape[1]
        self._least, self._spread = arrivals.rounding, deviation * arrivals.tip_radius
        self._stiffness = 0.0
        self._stiffen(float(np.std(self._without(self._values, np.ones(len(turn))))))
        self._none = reweighted(
            lambda weights: self._without(self._values, weights),
            np.ones(len(turn)), self._own.shape[1], self._least,
        )  # fmt: skip

    def _stiffen(self, scatter: float) -> None:
        """Set the stiffness by which the probes' constants are held together, for a scatter [m]."""
        if self._own.shape[1] > 1:
            self._stiffness = (scatter / self._spread) ** 2

    def _without(self, values: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return values (n,) or (n, m) without the constants that are fitted to them."""
        weighted, count = weights[:, None] * self._own, self._own.shape[1]
        square = self._own.T @ weighted + self._stiffness * (np.eye(count) - 1.0 / count)
        return np.asarray(values - self._own @ np.linalg.solve(square, weighted.T @ values))

    def _fitted(
        self, omega: float, weights: np.ndarray, values: np.ndarray, time: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return coefficients a1, b1, ..., residuals (n,), and the columns (n, 2K+1), the last one
        by the frequency."""
        raw, root = fourier_basis(omega * time, self._multiples)[:, 1:], np.sqrt(weights)[:, None]
        both = self._without(np.column_stack([raw, values]), weights)
        columns, left = both[:, :-1], both[:, -1]
        found = np.linalg.lstsq(root * columns, root[:, 0] * left, rcond=1e-10)[0]
        turned = raw[:, 0::2] * found[1::2] - raw[:, 1::2] * found[0::2]
        slope = self._without(time * (turned @ self._multiples), weights)
        return found, left - columns @ found, np.column_stack([columns, slope])

    def _refined(self, omega: float, weights: np.ndarray) -> tuple[float, Any]:
        """Return the frequency near one with the least sum of squares, and its fit."""
        unit, root = np.pi / self._span, np.sqrt(weights)[:, None]
        moved, fit = omega, None

        def residuals(step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            nonlocal moved, fit
            moved = omega + unit * float(step[0])
            _, left, columns = fit = self._fitted(moved, weights, self._values, self._time)
            given, slope = root * columns[:, :-1], -unit * root * columns[:, -1:]
            slope -= given @ np.linalg.lstsq(given, slope, rcond=1e-10)[0]
            return root[:, 0] * left, slope

        low, high = ([(end - omega) / unit] for end in self._ends)
        refined(residuals, low, high, ROBUST_SETTLED**2)  # peaks are compared by their sums
        return moved, fit

    def best(self) -> tuple[TipFit, float]:
        """Return the vibration that explains most, or as much with the smallest amplitude; and the
        probability that noise has one as large."""
        tried: list[tuple[bool, float, float]] = []
        weights = self._none.weights
        for peak in self._peaks().tolist():
            omega, (_, left, columns) = self._refined(peak, weights)
            tried.append((self._held(columns), float(weights @ left**2), omega))
        kept: list[float] = []
        for _, _, omega in sorted(tried):  # nearer to a higher one they are its side lobes
            if all(abs(omega - other) >= 2.0 * TURN / self._span for other in kept):
                kept.append(omega)
        self.omega = kept[0]
        self._settle()
        candidates, self.omega = self._compared(np.sort([self.omega, *kept[1:]]))
        self._settle()
        # Errors of a mark are common to all arrivals of a revolution, which are worth less.
        spread = self.noise.covariance(self.columns, self._places)[:-1, :-1]
        seen = float(self.found @ np.linalg.lstsq(spread, self.found, rcond=1e-10)[0])
        gain = max(min(self._none.cost - self.noise.cost, seen), 0.0)
        cells = max(float(np.ptp(self._ends)) * self._span / TURN, 1.0)
        chance = min(cells * float(chdtrc(2 * len(self._multiples) + 1, gain)), 1.0)
        return self._described(candidates), 1.0 if self._held(self.columns) else chance

    def _held(self, columns: np.ndarray) -> bool:
        """Return True if the constants hold half of some vibration or more."""
        given = columns[:, :-1]
        return bool(np.linalg.eigvalsh(given.T @ given)[0] < 0.25 * len(columns))

    def _peaks(self) -> np.ndarray:
        """Return the frequencies at which a periodogram is highest [rad/s]."""
        low, high = self._ends
        step = TURN / (4.0 * self._span)  # of the resolution a quarter
        begin, end = int(np.ceil(low / step)), int(np.floor(high / step)) + 1
        if not 0 < end - begin < MOST_FREQUENCIES:
            allowed = f"between {step:.3g} and {MOST_FREQUENCIES * step:.3g} rad/s"
            raise InputError("high - low", high - low, allowed)
        values, places, power = self._none.psi, np.arange(begin, end), np.zeros(end - begin)
        size = 10**6  # at once, for the memory
        for multiple, first in itertools.product(self._multiples, range(0, end - begin, size)):
            band = power[first : first + size]
            phase = multiple * step * self._time
            band += np.abs(_spectrum(phase, values, begin + first, len(band))) ** 2
        padded = np.concatenate([[-np.inf], power, [-np.inf]])
        peaks = np.flatnonzero((power >= padded[:-2]) & (power >= padded[2:]))
        peaks = peaks[np.argsort(-power[peaks])[:PEAKS]]
        if power[peaks[0]] < np.log(len(places)) * float(values @ values):
            peaks = peaks[:1]  # as high as in noise: exponentially distributed
        return np.asarray(step * places[peaks[power[peaks] > LOWEST * power[peaks[0]]]])

    def _settle(self) -> None:
        """Fit frequency, harmonics and constants by turns with weights."""

        def solve(weights: np.ndarray) -> np.ndarray:
            self.omega, (self.found, left, self.columns) = self._refined(self.omega, weights)
            return np.asarray(left)

        self.noise = reweighted(solve, np.ones(len(self._values)), self._unknowns, self._least)
        self._stiffen(self.noise.scale)

    def _compared(self, omegas: np.ndarray) -> tuple[Candidates, float]:
        """Return candidates of some frequencies, with the weights of the best; and the one to be
        taken."""
        weights, limit = self.noise.weights, LEVELS.equal * self.noise.scale**2
        fits = [self._fitted(omega, weights, self._values, self._time) for omega in omegas]
        sums = np.array([weights @ left**2 for _, left, _ in fits])
        sizes = np.array([np.linalg.norm(found) for found, _, _ in fits])
        conditions = np.array([condition(columns[:, :-1]) for _, _, columns in fits])
        hidden = np.array([self._held(columns) for _, _, columns in fits])
        equivalent, best = select_candidate(sums, sizes, limit, ~hidden)
        # Arrivals that are not where they were expected distinguish aliases, but not reliably.
        wave = fourier_basis(omegas[best] * self._expected, self._multiples)[:, 1:] @ fits[best][0]
        lefts = [self._fitted(omega, weights, wave, self._expected)[1] for omega in omegas]
        equivalent |= np.array([weights @ left**2 for left in lefts]) < limit
        residuals = np.sqrt(sums / len(self._values))
        orders = omegas / self._arrivals.mean_speed
        return Candidates(orders, residuals, conditions, equivalent, hidden), float(omegas[best])

    def _described(self, candidates: Candidates) -> TipFit:
        """Return the fit in numbers; its order stands in the place of its candidate."""
        speed, count = self._arrivals.mean_speed, 2 * len(self._multiples) + 1
        order = self.omega / speed
        orders = candidates.orders.copy()
        orders[np.abs(orders - order).argmin()] = order
        spare = len(self._values) - self._unknowns
        spread = student(spare) * self.noise.covariance(self.columns, self._places)
        covariance = np.zeros((count, count))
        covariance[1:, 1:] = spread[:-1, :-1]
        covariance[0, 0] = student(spare) * self.noise.variance / len(self._values)
        wave = fourier_basis(self.omega * self._time, self._multiples)[:, 1:] @ self.found
        weights = self.noise.weights
        mean = float(weights @ (self._values - wave) / weights.sum())
        return TipFit(
            order=order,
            order_error=float(np.sqrt(spread[-1, -1])) / speed,
            speed=speed,
            multiples=self._multiples,
            coefficients=np.append(mean, self.found),
            covariance=covariance,
            scatter=float(np.sqrt(self.noise.variance)),
            misfit=np.nan,
            spare=spare,
            candidates=replace(candidates, orders=orders),
            asynchronous=(),
        )


def _spectrum(phase: np.ndarray, values: np.ndarray, first: int, count: int) -> np.ndarray:
    """Return sum_n values_n exp(-i m phase_n) for `count` whole m from the first on, of phases (n,)
    [rad]: each value is spread over its neighbours on a grid by a Gaussian, whose transform is
    taken out again."""
    near = 8  # neighbours on each side: eleven digits
    modes = 2 * (count // 2 + 1)
    middle, size = modes // 2, 2 * modes
    width = np.pi * near / (modes**2 * 3.0)  # of Greengard and Lee, twice as fine a grid
    turned = values * np.exp(-1j * (first + middle) * phase)
    place = np.floor(phase * size / TURN).astype(int)
    grid = np.zeros(size, dtype=complex)
    for cell in range(1 - near, near + 1):
        at = place + cell
        share = turned * np.exp(-((phase - TURN * at / size) ** 2) / (4.0 * width))
        grid += np.bincount(at % size, share.real, size)
        grid += 1j * np.bincount(at % size, share.imag, size)
    order = np.arange(modes) - middle
    found = np.fft.fft(grid)[order] / size
    return np.asarray(found * np.sqrt(np.pi / width) * np.exp(order**2 * width))[:count]
