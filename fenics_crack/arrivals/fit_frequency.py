"""Fit asynchronous vibration to arrival times: scan frequencies by least squares.

At a frequency that is no multiple of the speed, each revolution sees another point in the period,
so few probes suffice. A single probe samples once per revolution, and cannot distinguish the orders
p, p + 1, p + 2, ... and their mirror images 1 - p, 2 - p, .... Probes at other angles see these
aliases with other phases. Two probes suffice (Lacaze, arXiv:1711.06135), unless they are opposite
each other: every second alias then has the same phase. With displacement u, time t, angular
frequency w, a constant c_j for probe j, coefficients a_k and b_k, and harmonics k = 1 ... K, the
vibration is

    u = c_j + sum_k a_k cos(k w t) + b_k sin(k w t).

The speed may vary, since the model is a function of time. The constant is common to all probes,
apart from errors in their angles. Alternatively, each probe has a free constant, which then absorbs
everything synchronous.

The scan is a periodogram after subtracting the constants, summed over the harmonics (Lomb,
Astrophysics and Space Science 39, 1976, 447). At unevenly spaced times the FFT computes the sums
(Greengard and Lee, SIAM Review 46, 2004, 443). Least squares then fit frequency, harmonics and
constants to the best peaks (Zechmeister and Kürster, Astronomy and Astrophysics 496, 2009, 577).
The best peak is fitted again with the weights in :mod:`fenics_crack.arrivals.robust`.
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
from fenics_crack.basics.tables import RAD_PER_TURN
from fenics_crack.numerics.fourier import fourier_basis

MAX_FREQUENCIES = 10**8
"""Maximum number of frequencies in a scan, as for 1e6 revolutions and orders up to 24."""
MAX_PEAKS, LOWEST = 40, 0.5
"""Maximum number of refined peaks in a scan; minimum power relative to the highest peak."""


def fit_frequency(
    arrivals: ArrivalTimes,
    low: float,
    high: float,
    *,
    harmonics: int = 1,
    angle_deviation: float = 0.0,
) -> TipFit:
    """Find a vibration of any frequency by least squares.

    Among frequencies that fit equally well, within errors, the smallest vibration is taken and the
    others are reported, as by :func:`fit_order`. Give no more harmonics than needed: with two, half
    the true frequency may fit by its second harmonic.

    Parameters
    ----------
    arrivals : ArrivalTimes
        The speed may vary.
    low, high : float [rad/s]
        Range of the load's frequency.
    harmonics : int
        Number K.
    angle_deviation : float [rad]
        Standard deviation of the probes' angles, the same in every revolution.

    Returns
    -------
    TipFit
        The order is any number, frequency over mean speed, with a standard error.

    Raises
    ------
    InputError
        A value cannot be used, there are too few arrivals, or arrivals are not at the probes. Also
        if a single probe's arrivals do not vary: to one probe, whole orders look like no vibration.

    Examples
    --------
    >>> fit = fc.fit_frequency(arrivals, 1800.0, 2200.0)
    """
    check_number("low", low, 0.0, excludes_bound=True)
    check_number("high", high, low, excludes_bound=True)
    check_count("harmonics", harmonics, 1)
    arrivals.check_places(angle_deviation)
    is_seen = np.isfinite(arrivals.time)
    count = int(is_seen.sum())
    n_constants = int(is_seen.any(axis=0).sum()) if angle_deviation else 1
    if count <= (unknowns := 2 * harmonics + 1 + n_constants):
        raise InputError("arrivals", f"{count} arrivals", f"more than {unknowns}")
    shape = arrivals.time.shape
    constants = np.arange(shape[1]) * bool(angle_deviation) * np.ones(shape, dtype=int)
    values, ends = arrivals.displacement, (low, high)
    fit, chance = _FrequencySearch(
        arrivals, values, constants, harmonics, angle_deviation, ends
    ).find_best()
    if len(arrivals.probes) == 1 and chance > LEVELS.chance:
        problem = f"one at {np.degrees(arrivals.probes[0]):g} degrees, whose arrivals do not vary"
        requirement = "two or more: to one a vibration of a whole order is no vibration"
        raise InputError("probes", problem, requirement)
    return fit


def find_lines(
    arrivals: ArrivalTimes,
    values: np.ndarray,
    constants: np.ndarray,
    max_order: float,
    max_lines: int = 3,
) -> tuple[tuple[TipFit, ...], np.ndarray]:
    """Find significant vibrations of constant frequency, beside constants.

    The constants absorb everything synchronous.

    Parameters
    ----------
    arrivals : ArrivalTimes
        The speed may vary.
    values : (revolutions, probes) [m]
        Displacements to search for vibrations, one after the other.
    constants : (revolutions, probes) int
        Number of the constant for each displacement.
    max_order : float
        Frequencies range from half the mean speed to one order above ``max_order``, or above the
        largest default order if larger.
    max_lines : int
        Maximum number of vibrations.

    Returns
    -------
    lines : tuple of TipFit
        Vibrations.
    residuals : (revolutions, probes) [m]
        Displacements without the vibrations.
    """
    lines: list[TipFit] = []
    speed = arrivals.mean_speed
    ends = 0.5 * speed, speed * (max(max_order, ORDERS[-1]) + 1.0)
    residuals, count = np.array(values), len(np.unique(constants[np.isfinite(values)]))
    while len(lines) < max_lines and np.isfinite(residuals).sum() > 2 * (count + 3):
        fit, chance = _FrequencySearch(arrivals, residuals, constants, 1, np.inf, ends).find_best()
        if chance > LEVELS.chance:
            break
        lines.append(fit)
        residuals -= fit.displacement(fit.phases(arrivals)) - fit.coefficients[0]
    return tuple(lines), residuals


class _FrequencySearch:
    """Fit a vibration in time, and constants, by least squares.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Record with the times and probes.
    values : (revolutions, probes) [m]
        Displacements; nan without an arrival.
    constants : (revolutions, probes) int
        Number of the constant for each displacement.
    harmonics : int
        Number K.
    deviation : float [rad]
        Standard deviation of the constants, as angles; inf for free constants.
    ends : (float, float) [rad/s]
        Range of the frequency.

    Attributes
    ----------
    omega : float [rad/s]
        Frequency.
    coefficients, columns : (2K,) [m], (n, 2K+1)
        Coefficients and derivatives by :meth:`_fit`.
    noise : Noise
        Residuals and weights.
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
        mask = np.isfinite(values)
        self._places, self._ends = np.nonzero(mask), ends
        self._arrivals, self._values = arrivals, values[mask]
        self._time = arrivals.time[mask] - arrivals.marks[0]
        self._expected_time = arrivals.expected[mask] - arrivals.marks[0]
        self._multiples = np.arange(1.0, harmonics + 1.0)
        turn, _ = self._places
        self._span = float(arrivals.marks[turn.max() + 1] - arrivals.marks[turn.min()])
        self._constants = (constants[mask][:, None] == np.unique(constants[mask])).astype(float)
        self._unknowns = 2 * harmonics + 1 + self._constants.shape[1]
        self._rounding, self._tip_deviation = arrivals.rounding, deviation * arrivals.tip_radius
        self._stiffness = 0.0
        self._stiffen(float(np.std(self._eliminate(self._values, np.ones(len(turn))))))
        self._null_noise = reweighted(
            lambda weights: self._eliminate(self._values, weights),
            np.ones(len(turn)), self._constants.shape[1], self._rounding,
        )  # fmt: skip

    def _stiffen(self, scatter: float) -> None:
        """Set the stiffness that couples the probes' constants, for a scatter [m]."""
        if self._constants.shape[1] > 1:
            self._stiffness = (scatter / self._tip_deviation) ** 2

    def _eliminate(self, values: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Subtract the weighted best constants from values (n,) or (n, m)."""
        columns, count = weights[:, None] * self._constants, self._constants.shape[1]
        square = self._constants.T @ columns + self._stiffness * (np.eye(count) - 1.0 / count)
        return np.asarray(values - self._constants @ np.linalg.solve(square, columns.T @ values))

    def _fit(
        self, omega: float, weights: np.ndarray, values: np.ndarray, time: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Fit harmonics and constants to values (n,) [m] at a frequency [rad/s].

        Returns
        -------
        coefficients : (2K,) [m]
            a1, b1, ....
        residuals : (n,) [m]
            Values less the fit.
        columns : (n, 2K+1)
            Derivatives of the fit by the coefficients and by the frequency.
        """
        waves, root = fourier_basis(omega * time, self._multiples)[:, 1:], np.sqrt(weights)[:, None]
        block = self._eliminate(np.column_stack([waves, values]), weights)
        columns, target = block[:, :-1], block[:, -1]
        coefficients = np.linalg.lstsq(root * columns, root[:, 0] * target, rcond=1e-10)[0]
        quadratures = waves[:, 0::2] * coefficients[1::2] - waves[:, 1::2] * coefficients[0::2]
        slope = self._eliminate(time * (quadratures @ self._multiples), weights)
        return coefficients, target - columns @ coefficients, np.column_stack([columns, slope])

    def _refine(self, omega: float, weights: np.ndarray) -> tuple[float, Any]:
        """Return a frequency [rad/s] refined by least squares, and its fit."""
        unit, root = np.pi / self._span, np.sqrt(weights)[:, None]
        best_omega, fit = omega, None

        def evaluate(step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            nonlocal best_omega, fit
            best_omega = omega + unit * float(step[0])
            _, residuals, columns = fit = self._fit(best_omega, weights, self._values, self._time)
            vibration, slope = root * columns[:, :-1], -unit * root * columns[:, -1:]
            slope -= vibration @ np.linalg.lstsq(vibration, slope, rcond=1e-10)[0]
            return root[:, 0] * residuals, slope

        min_step, max_step = ([(limit - omega) / unit] for limit in self._ends)
        refined(evaluate, min_step, max_step, ROBUST_SETTLED**2)  # peaks are compared by their sums
        return best_omega, fit

    def find_best(self) -> tuple[TipFit, float]:
        """Return the best vibration, and the probability of its size in noise.

        Among vibrations that explain the displacements equally well, the smallest is the best.
        """
        trials: list[tuple[bool, float, float]] = []
        weights = self._null_noise.weights
        for start in self._find_peaks().tolist():
            omega, (_, residuals, columns) = self._refine(start, weights)
            trials.append((self._is_hidden(columns), float(weights @ residuals**2), omega))
        peaks: list[float] = []
        for _, _, omega in sorted(trials):  # nearer to a higher one they are its side lobes
            if all(abs(omega - peak) >= 2.0 * RAD_PER_TURN / self._span for peak in peaks):
                peaks.append(omega)
        self.omega = peaks[0]
        self._settle()
        candidates, self.omega = self._compare(np.sort([self.omega, *peaks[1:]]))
        self._settle()
        # Errors of a mark are common to all arrivals of a revolution, which are worth less.
        covariance = self.noise.covariance(self.columns, self._places)[:-1, :-1]
        wald = float(
            self.coefficients @ np.linalg.lstsq(covariance, self.coefficients, rcond=1e-10)[0]
        )
        gain = max(min(self._null_noise.cost - self.noise.cost, wald), 0.0)
        cells = max(float(np.ptp(self._ends)) * self._span / RAD_PER_TURN, 1.0)
        chance = min(cells * float(chdtrc(2 * len(self._multiples) + 1, gain)), 1.0)
        return self._describe(candidates), 1.0 if self._is_hidden(self.columns) else chance

    def _is_hidden(self, columns: np.ndarray) -> bool:
        """Return True if constants absorb half of some vibration's squares or more."""
        waves = columns[:, :-1]
        return bool(np.linalg.eigvalsh(waves.T @ waves)[0] < 0.25 * len(columns))

    def _find_peaks(self) -> np.ndarray:
        """Return the frequencies (n,) [rad/s] of the highest peaks in a periodogram."""
        min_omega, max_omega = self._ends
        step = RAD_PER_TURN / (4.0 * self._span)  # of the resolution a quarter
        begin, end = int(np.ceil(min_omega / step)), int(np.floor(max_omega / step)) + 1
        if not 0 < end - begin < MAX_FREQUENCIES:
            requirement = f"between {step:.3g} and {MAX_FREQUENCIES * step:.3g} rad/s"
            raise InputError("high - low", max_omega - min_omega, requirement)
        values, steps, power = self._null_noise.psi, np.arange(begin, end), np.zeros(end - begin)
        size = 10**6  # at once, for the memory
        for multiple, offset in itertools.product(self._multiples, range(0, end - begin, size)):
            band = power[offset : offset + size]
            phase = multiple * step * self._time
            band += np.abs(_spectrum(phase, values, begin + offset, len(band))) ** 2
        padded_power = np.concatenate([[-np.inf], power, [-np.inf]])
        peaks = np.flatnonzero((power >= padded_power[:-2]) & (power >= padded_power[2:]))
        peaks = peaks[np.argsort(-power[peaks])[:MAX_PEAKS]]
        if power[peaks[0]] < np.log(len(steps)) * float(values @ values):
            peaks = peaks[:1]  # as high as in noise: exponentially distributed
        return np.asarray(step * steps[peaks[power[peaks] > LOWEST * power[peaks[0]]]])

    def _settle(self) -> None:
        """Fit frequency, harmonics and constants in turns with weights."""

        def solve(weights: np.ndarray) -> np.ndarray:
            self.omega, (self.coefficients, residuals, self.columns) = self._refine(
                self.omega, weights
            )
            return np.asarray(residuals)

        self.noise = reweighted(solve, np.ones(len(self._values)), self._unknowns, self._rounding)
        self._stiffen(self.noise.scale)

    def _compare(self, omegas: np.ndarray) -> tuple[Candidates, float]:
        """Compare frequencies (n,) [rad/s] with the weights of the best fit.

        Return all as candidates, and the frequency to take [rad/s].
        """
        weights, limit = self.noise.weights, LEVELS.equal * self.noise.scale**2
        fits = [self._fit(omega, weights, self._values, self._time) for omega in omegas]
        sums = np.array([weights @ residuals**2 for _, residuals, _ in fits])
        sizes = np.array([np.linalg.norm(coefficients) for coefficients, _, _ in fits])
        conditions = np.array([condition(columns[:, :-1]) for _, _, columns in fits])
        hidden = np.array([self._is_hidden(columns) for _, _, columns in fits])
        equivalent, index = select_candidate(sums, sizes, limit, ~hidden)
        # Arrivals that are not where they were expected distinguish aliases, but not reliably.
        wave = (
            fourier_basis(omegas[index] * self._expected_time, self._multiples)[:, 1:]
            @ fits[index][0]
        )
        misfits = [self._fit(omega, weights, wave, self._expected_time)[1] for omega in omegas]
        equivalent |= np.array([weights @ residuals**2 for residuals in misfits]) < limit
        rms = np.sqrt(sums / len(self._values))
        orders = omegas / self._arrivals.mean_speed
        return Candidates(orders, rms, conditions, equivalent, hidden), float(omegas[index])

    def _describe(self, candidates: Candidates) -> TipFit:
        """Return the fit, with its order in place of the nearest candidate."""
        speed, count = self._arrivals.mean_speed, 2 * len(self._multiples) + 1
        order = self.omega / speed
        orders = candidates.orders.copy()
        orders[np.abs(orders - order).argmin()] = order
        spare = len(self._values) - self._unknowns
        fit_covariance = student(spare) * self.noise.covariance(self.columns, self._places)
        covariance = np.zeros((count, count))
        covariance[1:, 1:] = fit_covariance[:-1, :-1]
        covariance[0, 0] = student(spare) * self.noise.variance / len(self._values)
        wave = fourier_basis(self.omega * self._time, self._multiples)[:, 1:] @ self.coefficients
        weights = self.noise.weights
        mean = float(weights @ (self._values - wave) / weights.sum())
        return TipFit(
            order=order,
            order_error=float(np.sqrt(fit_covariance[-1, -1])) / speed,
            speed=speed,
            multiples=self._multiples,
            coefficients=np.append(mean, self.coefficients),
            covariance=covariance,
            scatter=float(np.sqrt(self.noise.variance)),
            misfit=np.nan,
            spare=spare,
            candidates=replace(candidates, orders=orders),
            asynchronous=(),
        )


def _spectrum(phase: np.ndarray, values: np.ndarray, first_mode: int, count: int) -> np.ndarray:
    """Return sum_n values_n exp(-i m phase_n) at unevenly spaced phases (n,) [rad].

    The m are ``count`` whole numbers from ``first_mode`` on. A Gaussian spreads each value over
    neighbours on a grid; the spectrum is divided by the Gaussian's transform.
    """
    reach = 8  # neighbours on each side, for eleven digits
    modes = 2 * (count // 2 + 1)
    middle, size = modes // 2, 2 * modes
    width = np.pi * reach / (modes**2 * 3.0)  # of Greengard and Lee, twice as fine a grid
    terms = values * np.exp(-1j * (first_mode + middle) * phase)
    place = np.floor(phase * size / RAD_PER_TURN).astype(int)
    grid = np.zeros(size, dtype=complex)
    for offset in range(1 - reach, reach + 1):
        cells = place + offset
        share = terms * np.exp(-((phase - RAD_PER_TURN * cells / size) ** 2) / (4.0 * width))
        grid += np.bincount(cells % size, share.real, size)
        grid += 1j * np.bincount(cells % size, share.imag, size)
    order = np.arange(modes) - middle
    spectrum = np.fft.fft(grid)[order] / size
    return np.asarray(spectrum * np.sqrt(np.pi / width) * np.exp(order**2 * width))[:count]
