"""Resonances that a rotor passes, from arrival times: frequency, damping and order of a transient.

A mode of natural frequency w_n and damping zeta under engine order p, on a rotor whose angle is
alpha(t) and whose speed is W = alpha', moves the tip by

    u = Re a(t) exp(i p alpha),     a' = (lambda - i p W) a + zeta w_n F,

where lambda = w_n (i sqrt(1 - zeta^2) - zeta) is the mode's root, a the envelope and F the
amplitude that it would have in a resonance that lasts. Where the speed changes by the resonance's
width in less time than the decay takes, 1 / (zeta w_n), the largest amplitude comes later, is
lower, and rings; a fit of steady vibrations then shifts the frequency, up in a run-up and down in a
run-down. With the speed W_j constant from each arrival to the next, as the marks tell it,

    a_k = exp(lambda t_k - i p alpha_k) (b + zeta w_n F sum_j<k D_j / (i p W_j - lambda)),

D_j the change of exp(i p alpha - lambda t) from arrival j to j + 1 and b of the steady vibration
where the passage begins.

Where w_n itself follows the speed, as a blade's that rotation stiffens, with s = d ln w_n / d ln W
where the order meets it, lambda - i p W is (1 - s) times that of a constant w_n whose damping is
zeta / (1 - s): alpha and t in the exponents are, and zeta is (1 - s) times what is fitted.

The displacement is linear in F and in a constant and a slope over the
speed for each probe, which are its place and the blade's drift. Frequency and damping are found by
Gauss-Newton from the best of a grid, the order by comparison, all passages of a resonance together;
errors are those of :mod:`fenics_crack.arrivals.robust`. The envelope is the averaged one of Lewis
(Transactions of the ASME 54, 1932, 253), who swept the first resonance.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from fenics_crack.arrivals.arrival_times import FEWEST_REVOLUTIONS, ArrivalTimes
from fenics_crack.arrivals.fit_frequency import LOWEST, find_lines
from fenics_crack.arrivals.harmonics import AS_GOOD, MISFIT, ORDERS, TipFit, rounding, wanted
from fenics_crack.arrivals.robust import FREEDOMS, ROBUST_ROUNDS, ROBUST_SETTLED, SEEN, reweighted
from fenics_crack.errors import InputError, check_count, check_number
from fenics_crack.stages import begin as begin_stage
from fenics_crack.table import RPM, TURN, Tabular, quantity

WIDTH = 0.035
"""Of the speed, on both sides of a resonance, that is fitted."""
SHIFTS = np.linspace(-0.01, 0.01, 11)
"""Relative shifts of the frequency with which the fit begins."""
REFINED = 4
"""Orders whose fits are refined."""
STRIDE = 2e-3, 0.5
"""Longest steps of Gauss-Newton, relative."""
DAMPED = 1e-5, WIDTH / 2.0
"""Ends of the damping ratios; a wider resonance is not told from drift."""
PASSAGE_STEP = 1e-6
"""Relative differences by frequency and damping."""
SPACING, TYPICAL = 0.003, 0.004
"""Relative distance of the speeds at which resonances are sought, and their damping there and where
the fit begins."""
MEDIAN = 0.954
"""Median of the difference of two normal numbers, in their standard deviations."""
PASSAGE_ROUNDS = 3
"""Of weights, there, without which single wrong arrivals look like resonances."""
PASSAGE_TURNS, PASSAGE_SETTLED = 5, 0.1
"""Of neighbours, each fitted beside the others, at most; and the change that is none, in standard
errors."""
STIFFEST = 0.9
"""Of d ln w_n / d ln W: an order hardly meets a frequency that follows it more closely."""
CLEAR = 60.0
"""Difference of -2 log likelihood from which on a vibration is no chance: some 1e5 of them are
tried, each of six numbers."""
BLIND, DISTINCT = 0.5, 5.0
"""Of the median vibration of all probes, less than this at one; and how much farther from it that
is than at any other probe. A mode of another order within the same width may cancel at a probe: of
200 such records with 4 to 8 probes one had a channel taken for blind, of 60 with 3 probes three."""


Follows = Callable[[float, float], float]
"""s of a speed and a natural frequency [rad/s], as ``Campbell.stiffening``."""


class _Run:
    """A stretch of a record in which the speed is near a resonance: arrays (revolutions, probes).

    Parameters
    ----------
    arrivals : ArrivalTimes
        The record.
    values : (revolutions, probes) [m]
        Its displacements, without what has been found in them.
    begin, end : int
        First revolution, and the one after the last.
    stiffening : function
        s of a speed and a frequency.
    """

    def __init__(
        self, arrivals: ArrivalTimes, values: np.ndarray, begin: int, end: int, stiffening: Follows
    ) -> None:
        self.begin, self.end, self._stiffening = begin, end, stiffening
        rows = slice(begin, end)
        self.seen = np.isfinite(values[rows])
        self.values = np.where(self.seen, values[rows], 0.0)
        self.path, self.time = arrivals.nominal_angle[rows], arrivals.expected[rows]
        self.angle = np.where(self.seen, arrivals.angle[rows], self.path)
        self.speed = arrivals.speed[rows]
        self.along = (self.speed - self.speed.mean()) / np.ptp(self.speed)
        self.least = rounding(arrivals)

    @property
    def probes(self) -> int:
        """How many probes see it."""
        return int(self.seen.any(axis=0).sum())

    def waves(self, order: float, roots: np.ndarray, *, steady: bool = False) -> np.ndarray:
        """a(t) exp(i p alpha) at the arrivals, of F = 1 and roots lambda (m,): (m, R, P)."""
        time, path = (self.time - self.time[0, 0]).ravel(), order * self.path.ravel()
        turning, omega = np.diff(path) / np.diff(time), float(np.abs(roots).mean())
        slower, roots = 1.0 - self._stiffening(omega / order, omega), roots[:, None]
        if steady:
            speed = np.interp(time, 0.5 * (time[1:] + time[:-1]), turning)
            envelope = 1.0 / (1j * speed - roots)
        else:
            envelope = np.empty((len(roots), len(time)), dtype=complex)
            envelope[:, :1] = 1.0 / (1j * turning[0] - roots)
            # In parts, over which exp does not overflow.
            parts = int(-roots.real.min() * slower * time[-1] // 300.0) + 1
            edges = np.linspace(0, len(turning), parts + 1).astype(int)
            for begin, end in itertools.pairwise(edges):
                here = slice(begin, end + 1)
                passed = slower * (time[here] - time[begin])
                phase = slower * (path[here] - path[begin]) - roots.imag * passed
                wave = np.exp(-roots.real * passed) * (np.cos(phase) + 1j * np.sin(phase))
                pushed = np.cumsum(np.diff(wave) / (1j * turning[begin:end] - roots), axis=1)
                envelope[:, begin + 1 : end + 1] = (envelope[:, [begin]] + pushed) / wave[:, 1:]
        found = -roots.real * envelope * np.exp(1j * order * self.angle.ravel())
        return np.asarray(found.reshape(-1, *self.path.shape))

    def _drifts(self, weights: np.ndarray) -> np.ndarray:
        """A constant and a slope over the speed at each probe, orthonormal under weights (R, P):
        (2, R, P)."""
        tiny = np.finfo(float).tiny
        total = np.maximum(weights.sum(axis=0), tiny)
        along = self.along[:, None] - (weights * self.along[:, None]).sum(axis=0) / total
        size = np.maximum((weights * along**2).sum(axis=0), tiny)
        return np.stack([np.ones_like(weights) / np.sqrt(total), along / np.sqrt(size)])

    def without_drifts(self, waves: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Waves (m, R, P) times the roots of weights (R, P), and without what a constant and a
        slope over the speed explain of them at each probe."""
        root = np.sqrt(weights)
        found = root * waves
        for column in root * self._drifts(weights):
            found = found - column * (column * found).sum(axis=-2, keepdims=True)
        return np.asarray(found)

    def gains(self, order: float, roots: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """What the vibration of each root lambda (m,), with any F, takes off the sum of squares
        with weights (R, P): (m,) [m^2]."""
        waves, columns = self.waves(order, roots), self._drifts(weights)
        weighted = weights * waves
        drifts = np.einsum("krp,mrp->mkp", columns, weighted)
        left = np.sqrt(weights) * self.without_drifts(self.values, weights)
        seen = np.einsum("mrp,rp->m", waves, left)
        both = np.einsum("mrp,mrp->m", weighted, waves) - (drifts**2).sum(axis=(1, 2))
        size = np.einsum("mrp,mrp->m", weighted, waves.conj()).real
        size -= (np.abs(drifts) ** 2).sum(axis=(1, 2))
        gain = size * np.abs(seen) ** 2 - (both.conj() * seen**2).real
        return np.asarray(2.0 * gain / (size**2 - np.abs(both) ** 2))


@dataclass(frozen=True)
class _Record:
    """Arrivals, and how natural frequencies follow the speed in them."""

    arrivals: ArrivalTimes
    stiffening: Follows

    def run(self, values: np.ndarray, begin: int, end: int) -> _Run:
        """Revolutions of displacements (revolutions, probes)."""
        return _Run(self.arrivals, values, begin, end, self.stiffening)

    def runs(self, values: np.ndarray, speed: float) -> list[_Run]:
        """Stretches in which the speed is near one, and on both sides of it."""
        apart = self.arrivals.speed / speed - 1.0
        near = np.flatnonzero(np.abs(apart) < WIDTH)
        found = []
        for rows in np.split(near, np.flatnonzero(np.diff(near) > FEWEST_REVOLUTIONS) + 1):
            if len(rows) >= FEWEST_REVOLUTIONS and apart[rows].min() < 0.0 < apart[rows].max():
                run = self.run(values, int(rows[0]), int(rows[-1]) + 1)
                # A probe that has dropped out leaves the others.
                run.seen &= run.seen.sum(axis=0) >= FEWEST_REVOLUTIONS
                found += [run] * bool(np.any(run.seen))
        return found


def _pole(omega: np.ndarray, damping: float) -> np.ndarray:
    """lambda [1/s] of natural frequencies [rad/s] and a ratio of damping."""
    return omega * (1j * np.sqrt(1.0 - damping**2) - damping)


class _Fit:
    """Gauss-Newton of frequency, damping and what is linear, by turns with weights.

    Parameters
    ----------
    runs : sequence of _Run
        Fitted together, with forces and drifts of their own.
    order : float
        p.
    root : complex
        lambda to begin from [1/s].
    weights : sequence of (R, P)
        Of the arrivals of each run, to begin with.
    steady : bool
        Whether the vibration is taken to be steady at each speed, with these weights.

    Attributes
    ----------
    root : complex
        lambda of the fit.
    forces : (runs,) complex [m]
        F.
    noise : Noise
        What is left.
    """

    def __init__(
        self,
        runs: Sequence[_Run],
        order: float,
        root: complex,
        weights: Sequence[np.ndarray],
        *,
        steady: bool = False,
    ) -> None:
        self._runs, self.order, self._next, self._steady = runs, order, root, steady
        self._around = root.imag * (1.0 - WIDTH), root.imag * (1.0 + WIDTH)
        pairs = zip(runs, weights, strict=True)
        begin = np.concatenate([weight[run.seen] for run, weight in pairs])
        unknowns = 2 + sum(2 + 2 * run.probes for run in runs)
        if not steady:
            self.noise = reweighted(self._solve, begin, unknowns, runs[0].least)
            return
        for _ in range(ROBUST_ROUNDS):
            self._solve(begin)
            if abs(self._next - self.root) < ROBUST_SETTLED * abs(self.root.real):
                break

    def _solve(self, weights: np.ndarray) -> np.ndarray:
        """Residuals (n,) of the linear fit, after a step of frequency and damping."""
        self.root = self._next
        shifted = self.root + PASSAGE_STEP * np.array([0.0, self.root, self.root.real])
        forces, left, columns = [], [], []
        for run, weight in zip(self._runs, self._spread(weights), strict=True):
            wave = run.waves(self.order, shifted, steady=self._steady)
            *wave, values = run.without_drifts(np.append(wave, run.values[None], axis=0), weight)
            parts = np.stack([wave[0].real, -wave[0].imag], axis=-1)[run.seen]
            found = np.linalg.solve(parts.T @ parts, parts.T @ values[run.seen].real)
            forces.append(complex(*found))
            left.append(values[run.seen].real - parts @ found)
            changes = (forces[-1] * (np.array(wave[1:]) - wave[0]) / PASSAGE_STEP).real
            columns.append((changes[:, run.seen].T, parts))
        self.forces, total = np.array(forces), np.concatenate(left)
        changed, parts = (list(kind) for kind in zip(*columns, strict=True))
        self._columns = np.column_stack([np.concatenate(changed), block_diag(*parts)])
        step = np.linalg.lstsq(self._columns, total, rcond=None)[0]
        omega = self.omega * (1.0 + float(np.clip(step[0], -STRIDE[0], STRIDE[0])))
        damping = self.damping * np.exp(float(np.clip(step[1], -STRIDE[1], STRIDE[1])))
        self._next = _pole(np.clip(omega, *self._around), np.clip(damping, *DAMPED))
        return np.asarray(total / np.sqrt(weights))

    def _spread(self, values: np.ndarray) -> list[np.ndarray]:
        """Values (n,) of the arrivals in each run, 0 where there is none: (R, P)."""
        counts = np.cumsum([int(run.seen.sum()) for run in self._runs])[:-1]
        found = [np.zeros(run.path.shape) for run in self._runs]
        for one, run, part in zip(found, self._runs, np.split(values, counts), strict=True):
            one[run.seen] = part
        return found

    @property
    def omega(self) -> float:
        """[rad/s]."""
        return abs(self.root)

    @property
    def damping(self) -> float:
        """Ratio of critical damping."""
        return -self.root.real / abs(self.root)

    @property
    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Revolutions and probes of the arrivals: two (n,)."""
        rows = [np.nonzero(run.seen) for run in self._runs]
        turns = [run.begin + row for run, (row, _) in zip(self._runs, rows, strict=True)]
        return np.concatenate(turns), np.concatenate([probe for _, probe in rows])

    @cached_property
    def errors(self) -> np.ndarray:
        """Standard errors of frequency [rad/s] and damping."""
        columns = self._columns / np.sqrt(self.noise.weights)[:, None]
        spread = self.noise.covariance(columns, self.places)
        return np.sqrt(np.diag(spread)[:2]) * [self.omega, self.damping]

    @cached_property
    def amplitude(self) -> float:
        """Largest amplitude in the runs [m]."""
        root = np.array([self.root])
        waves = [run.waves(self.order, root) for run in self._runs]
        sizes = [np.abs(force * wave) for force, wave in zip(self.forces, waves, strict=True)]
        return float(max(size.max() for size in sizes))

    @property
    def weights(self) -> list[np.ndarray]:
        """Of the arrivals of each run: (R, P)."""
        return self._spread(self.noise.weights)

    @property
    def blind(self) -> np.ndarray:
        """Probes (n,) that see none, or little, of what the others see alike: a channel whose
        pulses are not those of the blade. Fitted is a vibration of any phase at each probe."""
        root, count = np.array([self.root]), self._runs[0].path.shape[1]
        square, seen = np.zeros((count, 2, 2)), np.zeros((count, 2))
        for run, force, weight in zip(self._runs, self.forces, self.weights, strict=True):
            wave = force * run.waves(self.order, root)[0]
            given = np.stack([wave.real, -wave.imag, run.values])
            *parts, values = run.without_drifts(given, weight).real
            square = square + np.einsum("arp,brp->pab", parts, parts)
            seen = seen + np.einsum("arp,rp->pa", parts, values)
        there = square.any(axis=(1, 2))
        found, size = np.linalg.solve(square[there], seen[there, :, None])[..., 0], np.ones(count)
        size[there] = np.hypot(*found.T) / np.median(found[:, 0])
        off, apart = size < BLIND, np.abs(size - 1.0)
        if not 0 < np.count_nonzero(off) < np.count_nonzero(there & ~off):
            return np.array([], dtype=int)
        distinct = apart[off].min() > DISTINCT * apart[~off].max()
        return np.flatnonzero(off & distinct)

    @cached_property
    def gain(self) -> float:
        """Difference of -2 log likelihood from no vibration."""

        def solve(weights: np.ndarray) -> np.ndarray:
            parts = zip(self._runs, self._spread(weights), strict=True)
            left = [run.without_drifts(run.values, weight)[run.seen] for run, weight in parts]
            return np.asarray(np.concatenate(left) / np.sqrt(weights))

        unknowns, weights = self.noise.unknowns - 2 - 2 * len(self._runs), self.noise.weights
        return reweighted(solve, weights, unknowns, self._runs[0].least).cost - self.noise.cost


@dataclass(frozen=True, repr=False)
class PassageFit(Tabular):
    """A resonance of one mode with an engine order, from all passages of it in a record.

    Attributes
    ----------
    order : float
        Periods of the load in a revolution, of the candidate that fits best.
    omega, omega_error : float [rad/s]
        Natural frequency and its standard error.
    damping, damping_error : float
        Ratio of critical damping, and its standard error. By a constant natural frequency it is
        1 / (1 - s) times as large as by one that follows the speed.
    amplitude : float [m]
        Largest amplitude in the passages.
    forces : (passages,) complex [m]
        F of each passage, the amplitude in a resonance that lasts.
    ends : (passages, 2) int
        First revolution of each, and the one after its last, counted from 0.
    omegas, omega_errors : (passages,) [rad/s]
        Frequencies and errors of each passage by itself.
    steady_omegas : (passages,) [rad/s]
        What a fit of steady vibrations finds in each: too high in a run-up, too low in a run-down.
    orders : (n,)
        Candidates.
    margins : (n,)
        By how much each fits worse than the best: difference of -2 log likelihood.
    scatter : float [m]
        Standard deviation of a displacement about the fit.
    whiteness : float
        Probability that errors without correlation from revolution to revolution leave what is
        left. The standard errors hold with the correlation that is seen, not with what a vibration
        beside it shifts (:attr:`in_doubt`).
    asynchronous : tuple of TipFit
        Vibrations of constant frequency, which follow no order, found in the record.
    blind : tuple of float [rad]
        Angles of probes that see nothing of what the others see alike, and are left out.
    stiffening : float
        s = d ln w_n / d ln W.
    """

    order: float
    omega: float
    omega_error: float
    damping: float
    damping_error: float
    amplitude: float
    forces: np.ndarray
    ends: np.ndarray
    omegas: np.ndarray
    omega_errors: np.ndarray
    steady_omegas: np.ndarray
    orders: np.ndarray
    margins: np.ndarray
    scatter: float
    whiteness: float
    asynchronous: tuple[TipFit, ...] = ()
    blind: tuple[float, ...] = ()
    stiffening: float = 0.0

    @property
    def speed(self) -> float:
        """Speed at which the order meets the frequency [rad/s]."""
        return self.omega / self.order

    @property
    def margin(self) -> float:
        """By how much the second best order fits worse; inf where only one was tried."""
        return float(np.min(self.margins[self.orders != self.order], initial=np.inf))

    @property
    def ambiguous(self) -> tuple[float, ...]:
        """Other orders that explain the arrivals as well: within three standard deviations."""
        alike = (self.margins < AS_GOOD) & (self.orders != self.order)
        return tuple(self.orders[alike].tolist())

    @property
    def apart(self) -> float:
        """Relative difference of the passages' own frequencies, the largest from the least."""
        return float(np.ptp(self.omegas)) / self.omega

    @property
    def disagree(self) -> bool:
        """Tell whether passages by themselves differ by more than three of their errors."""
        apart = np.abs(self.omegas[:, None] - self.omegas)
        return bool(np.any(apart > 3.0 * np.hypot(self.omega_errors[:, None], self.omega_errors)))

    @property
    def in_doubt(self) -> bool:
        """Tell whether something beside it, which is not chance, is left of the arrivals: another
        vibration near this speed, drift, or a blade that is no linear mode. Frequency, damping and
        order may then be off by more than is stated."""
        return self.whiteness < MISFIT

    @property
    def deviation(self) -> float:
        """Standard deviation of the frequency for whoever goes on with it [rad/s]: its error, and
        no less than half of what passages differ by that disagree, as those of a crack that opens
        and shuts may, and than half of the resonance's width, zeta w, where something is beside
        it."""
        apart = 0.5 * float(np.ptp(self.omegas)) if self.disagree else 0.0
        beside = self.damping * self.omega if self.in_doubt else 0.0
        return max(self.omega_error, apart, beside)

    @property
    def steady_bias(self) -> float:
        """Largest relative error that fits of steady vibrations make of the frequency."""
        return float(np.abs(self.steady_omegas / self.omega - 1.0).max())

    def compared(self, arrivals: ArrivalTimes) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Of each passage the speeds (R,) [rad/s], and the displacements (R, P) [m], seen without
        drift (nan where none was seen) and of the fit; without blind probes."""
        arrivals = arrivals.without(np.flatnonzero(np.isin(arrivals.probes, self.blind)))
        root = np.array([_pole(self.omega, self.damping / (1.0 - self.stiffening))])
        record, found = _Record(arrivals, _checked(self.stiffening)), []
        for (begin, end), force in zip(self.ends, self.forces, strict=True):
            run = record.run(arrivals.displacement, int(begin), int(end))
            motion = (force * run.waves(self.order, root)[0]).real
            left = run.without_drifts(run.values - motion, run.seen.astype(float))
            found.append((run.speed, np.where(run.seen, left + motion, np.nan), motion))
        return found

    def to_dict(self) -> dict[str, Any]:
        """Numbers by name."""
        return {
            "speed": self.speed,
            "rpm": self.speed / RPM,
            "order": self.order,
            "margin": self.margin,
            "frequency": self.omega / TURN,
            "frequency_error": self.omega_error / TURN,
            "damping": self.damping,
            "damping_error": self.damping_error,
            "stiffening": self.stiffening,
            "amplitude": self.amplitude,
            "passages": len(self.ends),
            "apart": self.apart,
            "steady_bias": self.steady_bias,
            "whiteness": self.whiteness,
        }

    def _title(self) -> str:
        parts = [f"order {self.order:g}, {self.speed / RPM:.6g} rpm"]
        error = self.omega_error / TURN
        parts.append(f"{self.omega / TURN:.6g} ± {error:.2g} Hz")
        parts.append(f"damping {self.damping:.3g} ± {self.damping_error:.2g}")
        parts.append(quantity(self.amplitude, "m"))
        if self.ambiguous:
            parts.append(f"as well: {', '.join(f'{one:g}' for one in self.ambiguous)}")
        parts += ["something is beside it"] * self.in_doubt
        return ", ".join(parts)


# --- search ---------------------------------------------------------------------------------------


def fit_passage(
    arrivals: ArrivalTimes,
    speed: float,
    orders: Iterable[float] = ORDERS,
    *,
    stiffening: float | Follows = 0.0,
) -> PassageFit:
    """Fit a mode to all passages of a resonance near a speed.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Of run-ups and run-downs.
    speed : float [rad/s]
        About where the resonance is, to 1 %.
    orders : iterable of float
        Candidates: periods of the load in a revolution.
    stiffening : float or function
        s = d ln w_n / d ln W, the slope of a Campbell diagram over w_n / W, from -0.9 to 0.9, or it
        as a function of W and w_n [rad/s], as :meth:`Campbell.stiffening`: by a frequency that
        stays where it is dampings are 1 / (1 - s) times the true ones.

    Returns
    -------
    PassageFit
        Frequency, damping and order.

    Raises
    ------
    InputError
        A value cannot be used, or the rotor does not pass this speed.

    Examples
    --------
    >>> fit = fc.fit_passage(record[1], 98.6, range(6, 10))
    """
    check_number("speed", speed, 0.0, above=True)
    tried, _ = wanted(orders, 1, 1)
    record = _Record(arrivals, _checked(stiffening))
    runs = record.runs(arrivals.displacement, speed)
    if not runs:
        ends = arrivals.speed.min(), arrivals.speed.max()
        allowed = f"one that is passed in {FEWEST_REVOLUTIONS} revolutions or more, from "
        raise InputError("speed", speed, f"{allowed}{ends[0]:.6g} to {ends[1]:.6g} rad/s")
    found = _Compared(runs, speed, tried)
    if len(blind := found.best.blind):
        others = arrivals.without(blind)
        fit = fit_passage(others, speed, tried, stiffening=stiffening)
        return replace(fit, blind=(*arrivals.probes[blind].tolist(), *fit.blind))
    return found.described(record)


def find_passages(
    arrivals: ArrivalTimes,
    orders: Iterable[float] = ORDERS,
    *,
    most: int = 8,
    asynchronous: int = 1,
    stiffening: float | Follows = 0.0,
) -> tuple[PassageFit, ...]:
    """Find the resonances that a record passes, about the largest one first.

    Along the speed, vibrations of any phase at each probe are fitted. Where they explain most, the
    fit of :func:`fit_passage` finds the mode, which is subtracted before the next one is looked
    for, until what is found could be chance; beside vibrations of constant frequency, if there are.
    Probes that see nothing of the first one, where more others see it alike, are left out
    (``blind`` of the fit): what they do not see would be taken for further resonances.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Of run-ups and run-downs.
    orders : iterable of float
        Candidates: periods of the load in a revolution.
    most : int
        So many at most.
    asynchronous : int
        So many vibrations of constant frequency at most are looked for beside them. They pass
        every order, and look like resonances of little damping there.
    stiffening : float or function
        As of :func:`fit_passage`, a number of all modes.

    Returns
    -------
    tuple of PassageFit
        Empty where nothing stands out.

    Raises
    ------
    InputError
        A value cannot be used.

    Examples
    --------
    >>> for fit in fc.find_passages(record[1], range(6, 10), most=2):
    ...     print(fit)
    """
    tried, _ = wanted(orders, 1, 1)
    check_count("most", most, 1)
    check_count("asynchronous", asynchronous, 0)
    record, values = _Record(arrivals, _checked(stiffening)), arrivals.displacement
    constants = np.arange(values.shape[1]) * np.ones(values.shape, dtype=int)
    found: list[_Compared] = []
    lines: tuple[TipFit, ...] = ()
    steady = np.zeros_like(values)
    # A line looks like a resonance everywhere, and a resonance like a line: beside the clearest of
    # them lines are found, then the others, by turns until they are the same.
    for turn in range(PASSAGE_ROUNDS):
        before, few = found, 1 if asynchronous and not turn else most
        found, left = _search(record, values - steady, tried, few)
        if found and not turn and len(blind := found[0].best.blind):
            fits = find_passages(
                arrivals.without(blind), tried, most=most, asynchronous=asynchronous,
                stiffening=stiffening,
            )  # fmt: skip
            angles = arrivals.probes[blind].tolist()
            return tuple(replace(fit, blind=(*angles, *fit.blind)) for fit in fits)
        if not asynchronous or (turn and _alike(found, before)):
            break
        begin_stage("vibrations of constant frequency")
        lines, rest = find_lines(arrivals, left + steady, constants, tried.max(), most=asynchronous)
        steady += left - rest
        if turn and not lines:
            break
    return tuple(one.described(record, lines) for one in found)


def _checked(stiffening: float | Follows) -> Follows:
    """s where the order meets the frequency from below."""
    if callable(stiffening):

        def told(speed: float, omega: float) -> float:
            value = float(np.clip(stiffening(speed, omega), -STIFFEST, STIFFEST))
            check_number(f"stiffening({speed:.6g}, {omega:.6g})", value)
            return value

        return told
    check_number("stiffening", stiffening)
    if abs(value := float(stiffening)) > STIFFEST:
        raise InputError("stiffening", stiffening, f"a number from -{STIFFEST} to {STIFFEST}")
    return lambda speed, omega: value


def _search(
    record: _Record, values: np.ndarray, orders: np.ndarray, most: int
) -> tuple[list[_Compared], np.ndarray]:
    """Resonances in displacements (revolutions, probes), and what they leave."""
    left, speeds = np.array(values), record.arrivals.speed
    count = int(np.log(speeds.max() / speeds.min()) / SPACING)
    centres = speeds.min() * np.exp(SPACING * (0.5 + np.arange(count)))
    begin_stage("scan of the speeds")
    gains = np.array([_clearness(record, left, centre) for centre in centres]).reshape(-1, 2)
    found: list[_Compared] = []
    while len(found) < most and np.any(gains[:, 0] > CLEAR):
        begin_stage(f"resonance {len(found) + 1}")
        centre = centres[int(np.where(gains[:, 0] > CLEAR, gains[:, 1], 0.0).argmax())]
        gains[np.abs(centres / centre - 1.0) < 1.5 * SPACING] = 0.0
        if _clearness(record, left, centre, PASSAGE_ROUNDS)[0] < CLEAR:
            continue
        new = _Compared(record.runs(left, centre), centre, orders)
        if not new.clear:
            continue
        found.append(new)
        new.add(record, left, -1.0)
        _settle(record, left, found)
        near = (np.abs(centres / centre - 1.0) < 2.0 * WIDTH) & (gains[:, 1] > 0.0)
        for place in np.flatnonzero(near)[: len(near) * (len(found) < most)]:
            gains[place] = _clearness(record, left, centres[place])
    for place, one in enumerate(found):  # of all orders, beside the others
        if any(one.near(other) for other in found):
            one.add(record, left, 1.0)
            if runs := record.runs(left, one.speed):
                found[place] = _Compared(runs, one.speed, orders)
            found[place].add(record, left, -1.0)
    _settle(record, left, found)
    return found, left


def _settle(record: _Record, left: np.ndarray, found: list[_Compared]) -> None:
    """Fit neighbours each beside the others, by turns until their frequencies settle; those that
    are no more then, or one with a larger one, are taken out."""
    crowd = [one for one in found if any(one.near(other) for other in found)]
    for _ in range(PASSAGE_TURNS):
        moved = False
        for one in sorted(crowd, key=lambda one: -one.best.amplitude):
            before = one.best.root
            one.add(record, left, 1.0)
            if not one.again(record, left) or any(one.within(other) for other in found):
                found.remove(one)
                crowd.remove(one)
                moved = True
                continue
            one.add(record, left, -1.0)
            moved |= abs(one.best.root - before) > PASSAGE_SETTLED * float(one.best.errors[0])
        if not moved:
            break


def _alike(found: Sequence[_Compared], before: Sequence[_Compared]) -> bool:
    """Tell whether two searches have found the same resonances."""
    places = ([(one.best.order, one.speed) for one in some] for some in (found, before))
    pairs = itertools.zip_longest(*map(sorted, places), fillvalue=(0.0, 0.0))
    return all(np.allclose(one, other, rtol=SPACING) for one, other in pairs)


def _clearness(
    record: _Record, values: np.ndarray, speed: float, turns: int = 1
) -> tuple[float, float]:
    """What a steady vibration of any phase at each probe takes off the sum of squares near a speed,
    in units of the variance of differences from one arrival at a probe to its next, less what the
    further phases take off noise; and in m^2. From the second turn on with the weights that
    arrivals have in Student's t by what is left of them."""
    total = energy = 0.0
    for run in record.runs(values, speed):
        pairs = zip(run.values.T, run.seen.T, strict=True)
        changes = np.concatenate([np.abs(np.diff(column[seen])) for column, seen in pairs])
        scale = max(float(np.median(changes)) / MEDIAN, run.least)
        wave = 1.0 / (TYPICAL + 1j * (run.speed / speed - 1.0))
        given = [part[:, None] * run.seen for part in (wave.real, wave.imag)]
        weights = run.seen.astype(float)
        for _ in range(turns):
            *parts, left = run.without_drifts(np.stack([*given, run.values]), weights)
            square = np.einsum("arp,brp->pab", parts, parts)
            seen = np.einsum("arp,rp->pa", parts, left)
            found = (np.linalg.pinv(square) @ seen[..., None])[..., 0]
            gain = float((seen * found).sum())
            left = left - np.einsum("arp,pa->rp", parts, found)
            square = left[run.seen] ** 2 / weights[run.seen]
            weights[run.seen] = (FREEDOMS[0] + 1.0) / (FREEDOMS[0] + square / scale**2)
        total += gain / scale**2 - 2.0 * (run.probes - 1)
        energy += gain
    return total, energy


class _Compared:
    """Fits of some orders to the passages of a resonance.

    Parameters
    ----------
    runs : sequence of _Run
        The passages.
    speed : float [rad/s]
        About where the resonance is.
    orders : (n,)
        Candidates.

    Attributes
    ----------
    best : _Fit
        The order that explains most.
    margins : dict of float to float
        By how much each order fits worse, in -2 log likelihood.
    """

    best: _Fit

    def __init__(self, runs: Sequence[_Run], speed: float, orders: np.ndarray) -> None:
        self._runs = runs
        weights = [run.seen.astype(float) for run in runs]
        self.margins: dict[float, float] = {}
        tried = [(0.0, float(order), 0j) for order in orders]
        fits: dict[tuple[float, complex], _Fit] = {}
        # First without weights, where single wrong arrivals may hide the order; then with those of
        # the best fit, until it is the one that they make the best.
        for last in (False, False, True):
            for place, (_, order, _) in enumerate(tried):
                roots = _pole(order * speed * (1.0 + SHIFTS), TYPICAL)
                found = zip(runs, weights, strict=True)
                gains = sum(run.gains(order, roots, weight) for run, weight in found)
                tried[place] = float(gains.max()), order, roots[int(gains.argmax())]
            tried.sort(key=lambda one: -one[0])
            last = last or (len(fits) > 0 and tried[0][1] == self.best.order)
            for gain, order, root in tried[: REFINED if last else 1]:
                if gain > LOWEST * tried[0][0] and (order, root) not in fits:
                    fits[order, root] = _Fit(runs, order, root, weights)
            self.best = min(fits.values(), key=lambda fit: fit.noise.cost)
            if last:
                break
            weights = self.best.weights
        if not self.clear:
            return
        best, scale = tried[0][0], self.best.noise.scale
        self.margins = {order: (best - gain) / scale**2 for gain, order, _ in tried}
        for fit in sorted(fits.values(), key=lambda fit: -fit.noise.cost):
            self.margins[fit.order] = fit.noise.cost - self.best.noise.cost

    @property
    def clear(self) -> bool:
        """Whether it is a resonance: no chance, and neither a line, of no damping within its
        errors, nor as wide as drift."""
        best = self.best
        if not best.gain > CLEAR:
            return False
        return SEEN * float(best.errors[1]) < best.damping < 0.5 * DAMPED[1]

    @property
    def speed(self) -> float:
        """At which the order meets the frequency [rad/s]."""
        return self.best.omega / self.best.order

    def near(self, other: _Compared) -> bool:
        """Whether another one is in the speeds that are fitted."""
        return other is not self and abs(other.speed / self.speed - 1.0) < 2.0 * WIDTH

    def within(self, other: _Compared) -> bool:
        """Whether it is no more than what is left of a larger one: of its order, nearer than its
        width."""
        larger, root = other.best, other.best.root
        near = abs(root.imag - self.best.root.imag) < 2.0 * abs(root.real)
        return near and larger.order == self.best.order and larger.amplitude > self.best.amplitude

    def again(self, record: _Record, values: np.ndarray) -> bool:
        """Fit it to other displacements (revolutions, probes), and tell whether it is clear."""
        self._runs = record.runs(values, self.speed)
        if not self._runs:
            return False
        weights = [run.seen.astype(float) for run in self._runs]
        self.best = _Fit(self._runs, self.best.order, self.best.root, weights)
        return self.clear

    def add(self, record: _Record, values: np.ndarray, factor: float) -> None:
        """Add the vibration, times a factor, to displacements (revolutions, probes): that of each
        passage up to halfway to the next."""
        root, best = np.array([self.best.root]), self.best
        halfway = [(one.end + after.begin) // 2 for one, after in itertools.pairwise(self._runs)]
        ends = itertools.pairwise([0, *halfway, len(values)])
        for (begin, end), force in zip(ends, best.forces, strict=True):
            wave = record.run(values, begin, end).waves(best.order, root)[0]
            values[begin:end] += factor * (force * wave).real

    def described(self, record: _Record, lines: tuple[TipFit, ...] = ()) -> PassageFit:
        """The best fit in numbers, beside those of each run by itself."""
        best, runs = self.best, self._runs
        stiffening = record.stiffening(self.speed, best.omega)
        each = [
            ([run], best.order, best.root, [own])
            for run, own in zip(runs, best.weights, strict=True)
        ]
        alone = [_Fit(*one) for one in each] if len(runs) > 1 else [best]
        steady = [_Fit(*one, steady=True) for one in each]
        errors, orders = best.errors, np.array(sorted(self.margins))
        return PassageFit(
            order=best.order,
            omega=best.omega,
            omega_error=float(errors[0]),
            damping=(1.0 - stiffening) * best.damping,
            damping_error=(1.0 - stiffening) * float(errors[1]),
            amplitude=best.amplitude,
            forces=best.forces,
            ends=np.array([(run.begin, run.end) for run in runs]),
            omegas=np.array([fit.omega for fit in alone]),
            omega_errors=np.array([fit.errors[0] for fit in alone]),
            steady_omegas=np.array([fit.omega for fit in steady]),
            orders=orders,
            margins=np.array([self.margins[order] for order in orders]),
            scatter=float(np.sqrt(best.noise.variance)),
            whiteness=best.noise.whiteness(best.places),
            asynchronous=lines,
            stiffening=stiffening,
        )
