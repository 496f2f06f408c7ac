"""Model the transient of modes that a rotor sweeps through, and fit it.

A mode has the natural frequency w_n and the damping ratio zeta. Under engine order p, on a rotor
with angle alpha(t) and speed W = alpha', the mode moves the blade tip by

    u = Re a(t) exp(i p alpha),     a' = (lambda - i p W) a + zeta w_n F,

with the root lambda = w_n (i sqrt(1 - zeta^2) - zeta), the envelope a, and the amplitude F in a
resonance without end. A decay takes 1 / (zeta w_n). If the speed changes by the resonance's width
in less time, the largest amplitude comes later, is lower, and rings. A fit of steady vibrations
then shifts the frequency, up in a run-up and down in a run-down. The marks give the speed W_j from
arrival j to the next, as a constant. With the change D_j of exp(i p alpha - lambda t) from arrival
j to j + 1, and b from the steady vibration at the start, the envelope at arrival k is

    a_k = exp(lambda t_k - i p alpha_k) (b + zeta w_n F sum_j<k D_j / (i p W_j - lambda)).

Rotation may stiffen the blade, so that w_n follows the speed with s = d ln w_n / d ln W at the
resonance. Then lambda - i p W is (1 - s) times the value for a constant w_n with the damping
zeta / (1 - s). Therefore alpha and t in the exponents are multiplied by (1 - s), and zeta is
(1 - s) times the fitted ratio.

The displacement is linear in each mode's F, and in a constant and a slope over the speed for each
probe, by its place and the blade's drift. The averaged envelope is due to Lewis (Transactions of
the ASME 54, 1932, 253), who swept the first resonance.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from fenics_crack.arrivals.arrival_times import FEWEST_REVOLUTIONS, ArrivalTimes, between
from fenics_crack.arrivals.robust import refined, reweighted
from fenics_crack.basics.tables import RAD_PER_TURN
from fenics_crack.numerics.equations import SMALLEST_NORMAL

WIDTH = 0.035
"""Half width of the fitted speeds about a resonance, relative to its speed."""
DAMPING_BOUNDS = 1e-5, WIDTH / 2.0
"""Bounds of the damping ratios; a wider resonance is not distinguished from drift."""

Follows = Callable[[float, float], float]
"""Function s of speed and natural frequency [rad/s], as ``Campbell.stiffening``."""


class Run:
    """Hold revolutions of a record with speeds near a resonance.

    Arrays have the shape (R, P), for R revolutions and P probes.

    Parameters
    ----------
    record : Record
        Arrivals, and the stiffening of modes.
    values : (revolutions, probes) [m]
        Displacements in the whole record, without the vibrations found before.
    begin, end : int
        First revolution, and the one after the last.
    """

    def __init__(self, record: Record, values: np.ndarray, begin: int, end: int) -> None:
        arrivals, rows = record.arrivals, slice(begin, end)
        self.begin, self.end, self._stiffening = begin, end, record.stiffening
        self.has_arrival = np.isfinite(values[rows])
        self.values = np.where(self.has_arrival, values[rows], 0.0)
        self.nominal_angle, self.time = arrivals.nominal_angle[rows], arrivals.expected[rows]
        self.angle = np.where(self.has_arrival, arrivals.angle[rows], self.nominal_angle)
        self.speed, self.rounding = record.speed[rows], arrivals.rounding
        self.scaled_speed = (self.speed - self.speed.mean()) / (self.speed.max() - self.speed.min())

    @property
    def probes(self) -> int:
        """Number of probes with arrivals."""
        return int(self.has_arrival.any(axis=0).sum())

    def waves(self, order: float, roots: np.ndarray) -> np.ndarray:
        """Return waves a(t) exp(i p alpha) at the arrivals for F = 1: (m, R, P).

        The roots lambda (m,) [1/s] are equally far apart.
        """
        time, phase, phase_rate, rotation = self._phases(order)
        factor, roots = self._stiffening_factor(order, roots), roots[:, None]
        envelope = np.empty((len(roots), len(time)), dtype=complex)
        envelope[:, :1] = 1.0 / (1j * phase_rate[0] - roots)
        response = 1.0 / (1j * phase_rate - roots)
        for part in self._parts(factor * roots.real.min()):
            duration = factor * (time[part] - time[part.start])
            growth = np.exp(1j * factor * (phase[part] - phase[part.start]) - roots[0] * duration)
            growth_ratio = np.exp((roots[0] - roots[-1]) / max(len(roots) - 1, 1) * duration)
            growths = np.cumprod([growth, *[growth_ratio] * (len(roots) - 1)], axis=0)
            sums = (growths[:, 1:] - growths[:, :-1]) * response[:, part.start : part.stop - 1]
            np.cumsum(sums, axis=1, out=sums)
            sums += envelope[:, [part.start]]
            envelope[:, part.start + 1 : part.stop] = sums / growths[:, 1:]
        envelope *= -roots.real * rotation
        return envelope.reshape(-1, *self.nominal_angle.shape)

    def wave(self, mode: Mode) -> np.ndarray:
        """Return the wave a(t) exp(i p alpha) of a mode for F = 1: (R, P)."""
        return np.asarray(self.waves(mode.order, np.array([mode.root]))[0])

    def wave_and_slope(self, mode: Mode) -> np.ndarray:
        """Return a mode's wave a(t) exp(i p alpha) for F = 1, and its slope: (2, R, P).

        The slope is the derivative by ln lambda, with the factor zeta w_n held constant.
        """
        order, root = mode.order, mode.root
        time, phase, phase_rate, rotation = self._phases(order)
        factor = self._stiffening_factor(order, np.array([root]))
        envelopes = np.empty((2, len(time)), dtype=complex)
        response = 1.0 / (1j * phase_rate - root)
        envelopes[0, 0], envelopes[1, 0] = response[0], response[0] ** 2
        for part in self._parts(factor * root.real):
            duration = factor * (time[part] - time[part.start])
            growth = np.exp(1j * factor * (phase[part] - phase[part.start]) - root * duration)
            growths = np.stack([growth, -duration * growth])
            responses = response[part.start : part.stop - 1]
            changes = (growths[:, 1:] - growths[:, :-1]) * responses
            changes[1] += changes[0] * responses
            part_envelopes = (envelopes[:, [part.start]] + np.cumsum(changes, axis=1)) / growth[1:]
            part_envelopes[1] += duration[1:] * part_envelopes[0]
            envelopes[:, part.start + 1 : part.stop] = part_envelopes
        envelopes *= -root.real * rotation
        envelopes[1] *= root
        return envelopes.reshape(2, *self.nominal_angle.shape)

    def _phases(self, order: float) -> tuple[np.ndarray, ...]:
        """Return times and phases of n = R P arrivals under an order.

        Returns
        -------
        time, phase, phase_rate : (n,) [s], (n,) [rad], (n - 1,) [rad/s]
            Times and p alpha without vibration, and p W to the next arrival.
        rotation : (n,)
            exp(i p alpha) with vibration.
        """
        phase = order * self.nominal_angle.ravel()
        rotation = np.exp(1j * order * self.angle.ravel())
        return self._time, phase, np.diff(phase) / np.diff(self._time), rotation

    @cached_property
    def _time(self) -> np.ndarray:
        return np.asarray((self.time - self.time[0, 0]).ravel())

    def _stiffening_factor(self, order: float, roots: np.ndarray) -> float:
        """Return 1 - s at the speed where an order excites the roots lambda."""
        omega = float(np.abs(roots).mean())
        return 1.0 - self._stiffening(omega / order, omega)

    def _parts(self, rate: float) -> list[slice]:
        """Split arrivals into parts without overflow in exp.

        The exponential undoes the decay.
        The decay rate [1/s] is negative; each part begins with the last arrival of the previous
        part.
        """
        count = int(-rate * self._time[-1] // 300.0) + 1
        edges = [(len(self._time) - 1) * part // count for part in range(count + 1)]
        return [slice(begin, end + 1) for begin, end in itertools.pairwise(edges)]

    def _drifts(self, root_weights: np.ndarray) -> np.ndarray:
        """Return the drifts of each probe, weighted and orthonormal: (2, R, P).

        Drifts are a constant and a slope over the speed, times roots of weights (R, P).
        """
        drifts = np.stack([root_weights, root_weights * self.scaled_speed[:, None]])
        constant, slope = drifts
        constant /= np.sqrt(np.maximum((constant * constant).sum(axis=0), SMALLEST_NORMAL))
        slope -= constant * (constant * slope).sum(axis=0)
        slope /= np.sqrt(np.maximum((slope * slope).sum(axis=0), SMALLEST_NORMAL))
        return drifts

    def without_drifts(self, waves: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return waves (m, R, P) times roots of weights (R, P), without :meth:`_drifts`."""
        root_weights = np.sqrt(weights)
        residuals = root_weights * waves
        for drift in self._drifts(root_weights):
            residuals -= drift * (drift * residuals).sum(axis=-2, keepdims=True)
        return np.asarray(residuals)

    def phase_equations(self, wave: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return normal equations of a wave with any phase at each probe.

        Returns
        -------
        matrices, vectors : (P, 2, 2), (P, 2)
            Equations for the amplitude's parts, with weights (R, P) for the arrivals.
        parts, values : (2, R, P), (R, P)
            Parts of the wave, and displacements, weighted and without drifts.
        """
        waves_and_values = np.stack([wave.real, -wave.imag, self.values])
        *parts, values = self.without_drifts(waves_and_values, weights)
        matrices = np.einsum("arp,brp->pab", parts, parts)
        return matrices, np.einsum("arp,rp->pa", parts, values), np.array(parts), values

    def gains(self, orders: np.ndarray, roots: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return reductions of the weighted sum of squares: (n, m) [m^2].

        Vibrations have orders (n,), equidistant roots lambda (n, m), any F; weights are (R, P).
        """
        root_weights, weight_vector, reductions = np.sqrt(weights), weights.ravel(), []
        weighted_drifts = root_weights * self._drifts(root_weights)
        residuals = (root_weights * self.without_drifts(self.values, weights)).ravel()
        for order, order_roots in zip(orders.tolist(), roots, strict=True):
            waves = self.waves(order, order_roots)
            drift_products = np.einsum("krp,mrp->mkp", weighted_drifts, waves)
            waves = waves.reshape(len(order_roots), -1)
            products = waves @ residuals
            bilinear_squares = waves**2 @ weight_vector - (drift_products**2).sum(axis=(1, 2))
            squares = (waves.real**2 + waves.imag**2) @ weight_vector
            squares -= (drift_products.real**2 + drift_products.imag**2).sum(axis=(1, 2))
            numerators = (
                squares * np.abs(products) ** 2 - (bilinear_squares.conj() * products**2).real
            )
            reductions.append(2.0 * numerators / (squares**2 - np.abs(bilinear_squares) ** 2))
        return np.array(reductions)


@dataclass(frozen=True)
class Record:
    """Hold arrivals, and the stiffening of natural frequencies with the speed."""

    arrivals: ArrivalTimes
    stiffening: Follows

    @cached_property
    def speed(self) -> np.ndarray:
        """Mean speed of each revolution: (revolutions,) [rad/s]."""
        return self.arrivals.speed

    def runs(self, values: np.ndarray, speed: float) -> list[Run]:
        """Return the runs through a speed [rad/s].

        Each has 10 revolutions or more.
        ``values`` (revolutions, probes) [m] are displacements.
        """
        offsets = self.speed / speed - 1.0
        rows = np.flatnonzero(np.abs(offsets) < WIDTH)
        runs = []
        for part in np.split(rows, np.flatnonzero(np.diff(rows) > FEWEST_REVOLUTIONS) + 1):
            if len(part) >= FEWEST_REVOLUTIONS and offsets[part].min() < 0.0 < offsets[part].max():
                run = Run(self, values, int(part[0]), int(part[-1]) + 1)
                # A probe that has dropped out leaves the others.
                run.has_arrival &= run.has_arrival.sum(axis=0) >= FEWEST_REVOLUTIONS
                runs += [run] * bool(np.any(run.has_arrival))
        return runs


def pole(omega: np.ndarray, damping: float) -> np.ndarray:
    """Return lambda [1/s] of natural frequencies [rad/s] and a damping ratio."""
    return omega * (1j * np.sqrt(1.0 - damping**2) - damping)


@dataclass(frozen=True)
class Mode:
    """Hold an engine order p, and a mode's root lambda [1/s]."""

    order: float
    root: complex

    @property
    def omega(self) -> float:
        """Natural frequency [rad/s]."""
        return abs(self.root)

    @property
    def damping(self) -> float:
        """Ratio of critical damping."""
        return -self.root.real / abs(self.root)

    @property
    def speed(self) -> float:
        """Speed at which the order meets the frequency [rad/s]."""
        return self.omega / self.order

    def with_step(self, step: np.ndarray) -> Mode:
        """Return the mode after a step (2,) in ln w_n, over zeta, and ln zeta."""
        omega = self.omega * math.exp(self.damping * step[0])
        return Mode(self.order, complex(pole(omega, self.damping * math.exp(step[1]))))

    def steps(self, omega: float, damping: float) -> list[float]:
        """Return the step for :meth:`with_step` to a frequency [rad/s] and a damping ratio."""
        frequency_step = math.log(omega / self.omega) / self.damping
        return [frequency_step, math.log(damping / self.damping)]


class Fit:
    """Fit frequencies and dampings by least squares, in turns with weights.

    Forces and drifts are linear, and fitted again at each step of the others (variable projection).

    Parameters
    ----------
    runs : sequence of Run
        Runs with common modes; each run has separate forces and drifts.
    modes : sequence of Mode
        Initial modes, at most two neighbours in a comparison, or more in a final fit.
    weights : sequence of (R, P)
        Initial weights of the arrivals in each run.

    Attributes
    ----------
    modes : tuple of Mode
        Fitted modes.
    forces : (modes, runs) complex [m]
        Amplitudes F.
    noise : Noise
        Residuals and their weights.
    """

    def __init__(
        self, runs: Sequence[Run], modes: Sequence[Mode], weights: Sequence[np.ndarray]
    ) -> None:
        self._runs, self.modes = runs, tuple(modes)
        self._omegas = [mode.omega for mode in modes]
        self._waves = lru_cache(maxsize=1)(self._waves_of)
        initial_weights = np.concatenate(
            [part[run.has_arrival] for run, part in zip(runs, weights, strict=True)]
        )
        unknowns = 2 * len(modes) + sum(2 * len(modes) + 2 * run.probes for run in runs)
        self.noise = reweighted(self._solve, initial_weights, unknowns, runs[0].rounding)

    def _solve(self, weights: np.ndarray) -> np.ndarray:
        """Fit with weights (n,) of the arrivals, and return the residuals (n,) [m]."""
        initial_modes, run_weights = self.modes, self._split_by_run(weights)
        bounds = [
            [mode.steps(omega * (1.0 + end * WIDTH), DAMPING_BOUNDS[end > 0]) for end in (-1, 1)]
            for mode, omega in zip(initial_modes, self._omegas, strict=True)
        ]

        def residuals(steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            pairs = zip(initial_modes, steps.reshape(-1, 2), strict=True)
            self.modes = tuple(mode.with_step(step) if any(step) else mode for mode, step in pairs)
            units = np.array([unit for mode in initial_modes for unit in (mode.damping, 1.0)])
            residual_vector, self._slopes = self._fit_forces(run_weights)
            return residual_vector, self._slopes * units

        lower_bounds, upper_bounds = np.concatenate(bounds, axis=1)
        return refined(residuals, lower_bounds, upper_bounds) / np.sqrt(weights)

    def _waves_of(self, modes: tuple[Mode, ...]) -> list[np.ndarray]:
        """Return waves and slopes of modes in each run, by :meth:`Run.wave_and_slope`."""
        return [np.concatenate([*map(run.wave_and_slope, modes)]) for run in self._runs]

    def _fit_forces(self, weights: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Fit the forces with weights (R, P) of the arrivals in each run.

        Returns
        -------
        residuals, slopes : (n,), (n, m)
            Residuals [m], and derivatives by ln w_n and ln zeta for each mode; times roots of
            weights.
        """
        forces, parts = [], []
        log_root_slopes = np.array([(1.0, mode.root.real / mode.root) for mode in self.modes])
        for run, waves, weight in zip(self._runs, self._waves(self.modes), weights, strict=True):
            values_and_waves = run.without_drifts(np.concatenate([run.values[None], waves]), weight)
            values, *waves = values_and_waves[:, run.has_arrival]
            wave_parts = np.stack([part for wave in waves for part in (wave.real, -wave.imag)])
            wave_parts = wave_parts.reshape(-1, 2, 2, len(values))  # mode, wave and slope, parts
            columns = wave_parts[:, 0].reshape(-1, len(values))
            residuals = np.vstack([values.real, wave_parts[:, 1].reshape(-1, len(values))])
            amplitudes = np.linalg.lstsq(columns @ columns.T, columns @ residuals.T, rcond=None)[0]
            residuals -= amplitudes.T @ columns
            forces.append(amplitudes[0::2, 0] + 1j * amplitudes[1::2, 0])
            force_slopes = forces[-1][:, None] * log_root_slopes  # by ln w_n, and by ln zeta
            slopes = force_slopes[..., None] * (residuals[1::2] - 1j * residuals[2::2])[:, None]
            parts.append(np.vstack([residuals[:1], -slopes.real.reshape(-1, len(values))]).T)
        self.forces, residual_columns = np.array(forces).T, np.concatenate(parts)
        return residual_columns[:, 0], residual_columns[:, 1:]

    def _split_by_run(self, values: np.ndarray) -> list[np.ndarray]:
        """Split values (n,) of the arrivals by run: (R, P), 0 without an arrival."""
        counts = np.cumsum([int(run.has_arrival.sum()) for run in self._runs])[:-1]
        run_values = [np.zeros(run.nominal_angle.shape) for run in self._runs]
        for array, run, part in zip(run_values, self._runs, np.split(values, counts), strict=True):
            array[run.has_arrival] = part
        return run_values

    @property
    def mode(self) -> Mode:
        """First mode, or the only one."""
        return self.modes[0]

    @property
    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Revolutions and probes of the arrivals: two (n,)."""
        rows = [np.nonzero(run.has_arrival) for run in self._runs]
        turns = [run.begin + row for run, (row, _) in zip(self._runs, rows, strict=True)]
        return np.concatenate(turns), np.concatenate([probe for _, probe in rows])

    @cached_property
    def errors(self) -> np.ndarray:
        """Standard errors of the first mode's frequency [rad/s] and damping: (2,)."""
        columns = self._slopes / np.sqrt(self.noise.weights)[:, None]
        covariance = self.noise.covariance(columns, self.places)
        return np.sqrt(np.diag(covariance)[:2]) * [self.mode.omega, self.mode.damping]

    @cached_property
    def amplitude(self) -> float:
        """Largest amplitude [m] of the first mode in the runs."""
        pairs = zip(self.forces[0], self._runs, strict=True)
        return float(max(np.abs(force * run.wave(self.mode)).max() for force, run in pairs))

    def motion(self, record: Record, revolutions: int, mode_index: int = 0) -> np.ndarray:
        """Return the displacements by one of the modes: (revolutions, probes) [m].

        The motion in each run extends halfway to the next run.
        """
        motions = []
        halfway = [
            (run.end + next_run.begin) // 2 for run, next_run in itertools.pairwise(self._runs)
        ]
        ends = itertools.pairwise([0, *halfway, revolutions])
        no_displacements = np.zeros(record.arrivals.time.shape)
        for (begin, end), force in zip(ends, self.forces[mode_index], strict=True):
            wave = Run(record, no_displacements, begin, end).wave(self.modes[mode_index])
            motions.append((force * wave).real)
        return np.concatenate(motions)

    @property
    def whiteness(self) -> float:
        """Probability that noise alone leaves residuals as correlated: :meth:`Noise.whiteness`."""
        marks = np.arange(-4.0, 6.0)  # those beyond hardly change the spline of the angle
        shares = between(
            marks, np.eye(len(marks)), self._runs[0].nominal_angle[0] / RAD_PER_TURN % 1.0
        ).T
        return self.noise.whiteness(self.places, shares)

    @property
    def weights(self) -> list[np.ndarray]:
        """Weights of the arrivals in each run: (R, P)."""
        return self._split_by_run(self.noise.weights)

    @property
    def blind_probes(self) -> np.ndarray:
        """Indices (n,) of probes with pulses from another source than the blade.

        A vibration of any phase is fitted at each probe, in units of the first mode's motion. Blind
        probes are a minority with less than half the median in-phase amplitude. Their amplitudes
        are over five times farther from the median than all others.
        """
        count = self._runs[0].nominal_angle.shape[1]
        matrices, vectors = np.zeros((count, 2, 2)), np.zeros((count, 2))
        size_ratios = np.ones(count)
        for run, force, weight in zip(self._runs, self.forces[0], self.weights, strict=True):
            equations = run.phase_equations(force * run.wave(self.mode), weight)
            matrices, vectors = matrices + equations[0], vectors + equations[1]
        is_live = matrices.any(axis=(1, 2))
        amplitudes = np.linalg.solve(matrices[is_live], vectors[is_live, :, None])[..., 0]
        size_ratios[is_live] = np.hypot(*amplitudes.T) / np.median(amplitudes[:, 0])
        # Of 200 records with another mode within the width and 4 to 8 probes one had such a probe.
        is_small, offsets = size_ratios < 0.5, np.abs(size_ratios - 1.0)
        if not 0 < np.count_nonzero(is_small) < np.count_nonzero(is_live & ~is_small):
            return np.array([], dtype=int)
        return np.flatnonzero(is_small & (offsets[is_small].min() > 5.0 * offsets[~is_small].max()))

    @cached_property
    def gain(self) -> float:
        """Reduction of -2 log likelihood by the fitted modes."""

        def solve(weights: np.ndarray) -> np.ndarray:
            parts = zip(self._runs, self._split_by_run(weights), strict=True)
            residuals = [
                run.without_drifts(run.values, weight)[run.has_arrival] for run, weight in parts
            ]
            return np.asarray(np.concatenate(residuals) / np.sqrt(weights))

        unknowns = self.noise.unknowns - 2 * len(self.modes) * (1 + len(self._runs))
        drift_noise = reweighted(solve, self.noise.weights, unknowns, self._runs[0].rounding)
        return drift_noise.cost - self.noise.cost
