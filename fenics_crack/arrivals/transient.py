"""Modes that a rotor sweeps through: the transient under an engine order, and its fit to arrivals.

A mode of natural frequency w_n and damping zeta under engine order p, on a rotor whose angle is
alpha(t) and whose speed is W = alpha', moves the blade tip by

    u = Re a(t) exp(i p alpha),     a' = (lambda - i p W) a + zeta w_n F,

where lambda = w_n (i sqrt(1 - zeta^2) - zeta) is the mode's root, a the envelope and F the
amplitude that it would have in a resonance that lasts. Where the speed changes by the resonance's
width in less time than the decay takes, 1 / (zeta w_n), the largest amplitude comes later, is
lower, and rings; a fit of steady vibrations then shifts the frequency, up in a run-up and down in a
run-down. With the speed W_j constant from each arrival to the next, as it follows from the marks,

    a_k = exp(lambda t_k - i p alpha_k) (b + zeta w_n F sum_j<k D_j / (i p W_j - lambda)),

D_j the change of exp(i p alpha - lambda t) from arrival j to j + 1 and b of the steady vibration
where the passage begins.

Where w_n itself follows the speed, as a blade's that rotation stiffens, with s = d ln w_n / d ln W
where the order meets it, lambda - i p W is (1 - s) times that of a constant w_n whose damping is
zeta / (1 - s): alpha and t in the exponents are, and zeta is (1 - s) times what is fitted.

The displacement is linear in the F of each mode and in a constant and a slope over the speed for
each probe, its place and the drift of the blade. The envelope is the averaged one of Lewis
(Transactions of the ASME 54, 1932, 253), who swept the first resonance.
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
from fenics_crack.basics.tables import TURN
from fenics_crack.numerics.equations import SMALLEST_NORMAL

WIDTH = 0.035
"""Relative half width of the speeds about a resonance that are fitted."""
DAMPED = 1e-5, WIDTH / 2.0
"""Bounds of the damping ratios; a wider resonance is not distinguished from drift."""

Follows = Callable[[float, float], float]
"""s as a function of speed and natural frequency [rad/s], as ``Campbell.stiffening``."""


class Run:
    """Revolutions of a record in which the speed is near a resonance: arrays (revolutions, probes).

    Parameters
    ----------
    record : Record
        The record.
    values : (revolutions, probes) [m]
        Displacements, without the vibrations that have been found.
    begin, end : int
        First revolution, and the one after the last.
    """

    def __init__(self, record: Record, values: np.ndarray, begin: int, end: int) -> None:
        arrivals, rows = record.arrivals, slice(begin, end)
        self.begin, self.end, self._stiffening = begin, end, record.stiffening
        self.seen = np.isfinite(values[rows])
        self.values = np.where(self.seen, values[rows], 0.0)
        self.path, self.time = arrivals.nominal_angle[rows], arrivals.expected[rows]
        self.angle = np.where(self.seen, arrivals.angle[rows], self.path)
        self.speed, self.least = record.speed[rows], arrivals.rounding
        self.along = (self.speed - self.speed.mean()) / (self.speed.max() - self.speed.min())

    @property
    def probes(self) -> int:
        """Number of probes with arrivals."""
        return int(self.seen.any(axis=0).sum())

    def waves(self, order: float, roots: np.ndarray) -> np.ndarray:
        """Return a(t) exp(i p alpha) at the arrivals, for F = 1 and roots lambda (m,) that are
        equally far apart: (m, R, P)."""
        time, path, turning, turned = self._turned(order)
        slower, roots = self._slower(order, roots), roots[:, None]
        envelope = np.empty((len(roots), len(time)), dtype=complex)
        envelope[:, :1] = 1.0 / (1j * turning[0] - roots)
        push = 1.0 / (1j * turning - roots)
        for part in self._parts(slower * roots.real.min()):
            passed = slower * (time[part] - time[part.start])
            grown = np.exp(1j * slower * (path[part] - path[part.start]) - roots[0] * passed)
            factor = np.exp((roots[0] - roots[-1]) / max(len(roots) - 1, 1) * passed)
            growth = np.cumprod([grown, *[factor] * (len(roots) - 1)], axis=0)
            pushed = (growth[:, 1:] - growth[:, :-1]) * push[:, part.start : part.stop - 1]
            np.cumsum(pushed, axis=1, out=pushed)
            pushed += envelope[:, [part.start]]
            envelope[:, part.start + 1 : part.stop] = pushed / growth[:, 1:]
        envelope *= -roots.real * turned
        return envelope.reshape(-1, *self.path.shape)

    def wave(self, mode: Mode) -> np.ndarray:
        """Return a(t) exp(i p alpha) of a mode at the arrivals, for F = 1: (R, P)."""
        return np.asarray(self.waves(mode.order, np.array([mode.root]))[0])

    def sloped(self, mode: Mode) -> np.ndarray:
        """Return a(t) exp(i p alpha) of a mode at the arrivals, for F = 1, and zeta w_n times the
        derivative of the rest of it by ln lambda: (2, R, P)."""
        order, root = mode.order, mode.root
        time, path, turning, turned = self._turned(order)
        slower = self._slower(order, np.array([root]))
        found, push = np.empty((2, len(time)), dtype=complex), 1.0 / (1j * turning - root)
        found[0, 0], found[1, 0] = push[0], push[0] ** 2
        for part in self._parts(slower * root.real):
            passed = slower * (time[part] - time[part.start])
            growth = np.exp(1j * slower * (path[part] - path[part.start]) - root * passed)
            both, pushes = np.stack([growth, -passed * growth]), push[part.start : part.stop - 1]
            pushed = (both[:, 1:] - both[:, :-1]) * pushes
            pushed[1] += pushed[0] * pushes
            now = (found[:, [part.start]] + np.cumsum(pushed, axis=1)) / growth[1:]
            now[1] += passed[1:] * now[0]
            found[:, part.start + 1 : part.stop] = now
        found *= -root.real * turned
        found[1] *= root
        return found.reshape(2, *self.path.shape)

    def _turned(self, order: float) -> tuple[np.ndarray, ...]:
        """Return times and p alpha without vibration, p W between them, and exp(i p alpha) of the
        arrivals: (n,) or (n - 1,), n = R P."""
        path, turned = order * self.path.ravel(), np.exp(1j * order * self.angle.ravel())
        return self._time, path, np.diff(path) / np.diff(self._time), turned

    @cached_property
    def _time(self) -> np.ndarray:
        return np.asarray((self.time - self.time[0, 0]).ravel())

    def _slower(self, order: float, roots: np.ndarray) -> float:
        """1 - s."""
        omega = float(np.abs(roots).mean())
        return 1.0 - self._stiffening(omega / order, omega)

    def _parts(self, rate: float) -> list[slice]:
        """Return parts of the arrivals, each from the last of the one before, over which exp does
        not overflow as the decay [1/s] is undone."""
        count = int(-rate * self._time[-1] // 300.0) + 1
        edges = [(len(self._time) - 1) * part // count for part in range(count + 1)]
        return [slice(begin, end + 1) for begin, end in itertools.pairwise(edges)]

    def _drifts(self, root: np.ndarray) -> np.ndarray:
        """Return a constant and a slope over the speed at each probe, times roots of weights
        (R, P), and orthonormal: (2, R, P)."""
        drifts = np.stack([root, root * self.along[:, None]])
        first, second = drifts
        first /= np.sqrt(np.maximum((first * first).sum(axis=0), SMALLEST_NORMAL))
        second -= first * (first * second).sum(axis=0)
        second /= np.sqrt(np.maximum((second * second).sum(axis=0), SMALLEST_NORMAL))
        return drifts

    def without_drifts(self, waves: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return waves (m, R, P) times the roots of weights (R, P), without the constant and the
        slope over the speed that are fitted to them at each probe."""
        root = np.sqrt(weights)
        found = root * waves
        for column in self._drifts(root):
            found -= column * (column * found).sum(axis=-2, keepdims=True)
        return np.asarray(found)

    def phased(self, wave: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return normal equations of a wave (R, P) of any phase at each probe, with weights (R, P):
        (P, 2, 2) and (P, 2), its parts (2, R, P), and the values (R, P) without drift."""
        given = np.stack([wave.real, -wave.imag, self.values])
        *parts, values = self.without_drifts(given, weights)
        square = np.einsum("arp,brp->pab", parts, parts)
        return square, np.einsum("arp,rp->pa", parts, values), np.array(parts), values

    def gains(self, orders: np.ndarray, roots: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return the reduction of the sum of squares with weights (R, P) by the vibration of each
        order (n,) and root lambda (n, m), with any F: (n, m) [m^2]. Roots of an order are equally
        far apart."""
        root, weight, found = np.sqrt(weights), weights.ravel(), []
        columns = root * self._drifts(root)
        left = (root * self.without_drifts(self.values, weights)).ravel()
        for order, every in zip(orders.tolist(), roots, strict=True):
            waves = self.waves(order, every)
            drifts = np.einsum("krp,mrp->mkp", columns, waves)
            waves = waves.reshape(len(every), -1)
            seen, both = waves @ left, waves**2 @ weight - (drifts**2).sum(axis=(1, 2))
            size = (waves.real**2 + waves.imag**2) @ weight
            size -= (drifts.real**2 + drifts.imag**2).sum(axis=(1, 2))
            gain = size * np.abs(seen) ** 2 - (both.conj() * seen**2).real
            found.append(2.0 * gain / (size**2 - np.abs(both) ** 2))
        return np.array(found)


@dataclass(frozen=True)
class Record:
    """Arrivals, and the dependence of natural frequencies on the speed in them."""

    arrivals: ArrivalTimes
    stiffening: Follows

    @cached_property
    def speed(self) -> np.ndarray:
        """Mean speed of each revolution [rad/s]."""
        return self.arrivals.speed

    def runs(self, values: np.ndarray, speed: float) -> list[Run]:
        """Return the parts of a record in which the speed is near one, and on both sides of it."""
        apart = self.speed / speed - 1.0
        near = np.flatnonzero(np.abs(apart) < WIDTH)
        found = []
        for rows in np.split(near, np.flatnonzero(np.diff(near) > FEWEST_REVOLUTIONS) + 1):
            if len(rows) >= FEWEST_REVOLUTIONS and apart[rows].min() < 0.0 < apart[rows].max():
                run = Run(self, values, int(rows[0]), int(rows[-1]) + 1)
                # A probe that has dropped out leaves the others.
                run.seen &= run.seen.sum(axis=0) >= FEWEST_REVOLUTIONS
                found += [run] * bool(np.any(run.seen))
        return found


def pole(omega: np.ndarray, damping: float) -> np.ndarray:
    """Return lambda [1/s] of natural frequencies [rad/s] and a damping ratio."""
    return omega * (1j * np.sqrt(1.0 - damping**2) - damping)


@dataclass(frozen=True)
class Mode:
    """A mode under an engine order: p, and lambda [1/s]."""

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

    def moved(self, step: np.ndarray) -> Mode:
        """Return the mode after a step of ln w_n, in units of zeta, and ln zeta."""
        omega = self.omega * math.exp(self.damping * step[0])
        return Mode(self.order, complex(pole(omega, self.damping * math.exp(step[1]))))

    def steps(self, omega: float, damping: float) -> list[float]:
        """Return the step to a natural frequency [rad/s] and a damping ratio."""
        apart = math.log(omega / self.omega) / self.damping
        return [apart, math.log(damping / self.damping)]


class Fit:
    """Least squares of frequencies and dampings, by turns with the weights of arrivals; what is
    linear is fitted within (variable projection).

    Parameters
    ----------
    runs : sequence of Run
        Fitted together, with forces and drifts of their own.
    modes : sequence of Mode
        To begin from, one or two neighbours.
    weights : sequence of (R, P)
        Weights of the arrivals of each run, to begin with.

    Attributes
    ----------
    modes : tuple of Mode
        Modes of the fit.
    forces : (modes, runs) complex [m]
        F.
    noise : Noise
        Residuals.
    """

    def __init__(
        self, runs: Sequence[Run], modes: Sequence[Mode], weights: Sequence[np.ndarray]
    ) -> None:
        self._runs, self.modes = runs, tuple(modes)
        self._omegas = [mode.omega for mode in modes]
        self._waves = lru_cache(maxsize=1)(self._waves_of)
        begin = np.concatenate([part[run.seen] for run, part in zip(runs, weights, strict=True)])
        unknowns = 2 * len(modes) + sum(2 * len(modes) + 2 * run.probes for run in runs)
        self.noise = reweighted(self._solve, begin, unknowns, runs[0].least)

    def _solve(self, weights: np.ndarray) -> np.ndarray:
        """Fit with weights (n,) of the arrivals, and return the residuals (n,)."""
        begin, spread = self.modes, self._spread(weights)
        ends = [
            [mode.steps(omega * (1.0 + side * WIDTH), DAMPED[side > 0]) for side in (-1, 1)]
            for mode, omega in zip(begin, self._omegas, strict=True)
        ]

        def residuals(steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            pairs = zip(begin, steps.reshape(-1, 2), strict=True)
            self.modes = tuple(mode.moved(step) if any(step) else mode for mode, step in pairs)
            units = np.array([unit for mode in begin for unit in (mode.damping, 1.0)])
            left, self._slopes = self._linear(spread)
            return left, self._slopes * units

        low, high = np.concatenate(ends, axis=1)
        return refined(residuals, low, high) / np.sqrt(weights)

    def _waves_of(self, modes: tuple[Mode, ...]) -> list[np.ndarray]:
        """Return the waves of modes in each run, and their slopes, by :meth:`Run.sloped`."""
        return [np.concatenate([*map(run.sloped, modes)]) for run in self._runs]

    def _linear(self, weights: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Fit the forces with weights (R, P), and return residuals (n,) and their derivatives by
        ln w_n and ln zeta of each mode (n, m), all times the roots of the weights."""
        forces, parts = [], []
        by_mode = np.array([(1.0, mode.root.real / mode.root) for mode in self.modes])
        for run, waves, weight in zip(self._runs, self._waves(self.modes), weights, strict=True):
            given = run.without_drifts(np.concatenate([run.values[None], waves]), weight)
            values, *waves = given[:, run.seen]
            pairs = np.stack([part for wave in waves for part in (wave.real, -wave.imag)])
            pairs = pairs.reshape(-1, 2, 2, len(values))  # mode, wave and slope, parts
            columns = pairs[:, 0].reshape(-1, len(values))
            both = np.vstack([values.real, pairs[:, 1].reshape(-1, len(values))])
            found = np.linalg.lstsq(columns @ columns.T, columns @ both.T, rcond=None)[0]
            both -= found.T @ columns
            forces.append(found[0::2, 0] + 1j * found[1::2, 0])
            turned = forces[-1][:, None] * by_mode  # by ln w_n, and by ln zeta
            slopes = turned[..., None] * (both[1::2] - 1j * both[2::2])[:, None]
            parts.append(np.vstack([both[:1], -slopes.real.reshape(-1, len(values))]).T)
        self.forces, both = np.array(forces).T, np.concatenate(parts)
        return both[:, 0], both[:, 1:]

    def _spread(self, values: np.ndarray) -> list[np.ndarray]:
        """Return values (n,) of the arrivals in each run, 0 where there is none: (R, P)."""
        counts = np.cumsum([int(run.seen.sum()) for run in self._runs])[:-1]
        found = [np.zeros(run.path.shape) for run in self._runs]
        for one, run, part in zip(found, self._runs, np.split(values, counts), strict=True):
            one[run.seen] = part
        return found

    @property
    def mode(self) -> Mode:
        """The first mode, or the only one."""
        return self.modes[0]

    @property
    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Revolutions and probes of the arrivals: two (n,)."""
        rows = [np.nonzero(run.seen) for run in self._runs]
        turns = [run.begin + row for run, (row, _) in zip(self._runs, rows, strict=True)]
        return np.concatenate(turns), np.concatenate([probe for _, probe in rows])

    @cached_property
    def errors(self) -> np.ndarray:
        """Standard errors of frequency [rad/s] and damping of the first mode."""
        columns = self._slopes / np.sqrt(self.noise.weights)[:, None]
        spread = self.noise.covariance(columns, self.places)
        return np.sqrt(np.diag(spread)[:2]) * [self.mode.omega, self.mode.damping]

    @cached_property
    def amplitude(self) -> float:
        """Largest amplitude of the first mode in the runs [m]."""
        pairs = zip(self.forces[0], self._runs, strict=True)
        return float(max(np.abs(force * run.wave(self.mode)).max() for force, run in pairs))

    def motion(self, record: Record, revolutions: int, place: int = 0) -> np.ndarray:
        """Return displacements by one of the modes (revolutions, probes), of each passage up to
        halfway to the next."""
        found = []
        halfway = [(one.end + after.begin) // 2 for one, after in itertools.pairwise(self._runs)]
        ends = itertools.pairwise([0, *halfway, revolutions])
        nothing = np.zeros(record.arrivals.time.shape)
        for (begin, end), force in zip(ends, self.forces[place], strict=True):
            wave = Run(record, nothing, begin, end).wave(self.modes[place])
            found.append((force * wave).real)
        return np.concatenate(found)

    @property
    def whiteness(self) -> float:
        """Probability that errors of arrivals and marks alone are left."""
        turns = np.arange(-4.0, 6.0)  # marks beyond hardly change the spline of the angle
        shares = between(turns, np.eye(len(turns)), self._runs[0].path[0] / TURN % 1.0).T
        return self.noise.whiteness(self.places, shares)

    @property
    def weights(self) -> list[np.ndarray]:
        """Weights of the arrivals of each run: (R, P)."""
        return self._spread(self.noise.weights)

    @property
    def blind(self) -> np.ndarray:
        """Probes (n,) at which the amplitude is less than half of the median, and five times
        farther from it than at any other probe: channels whose pulses are not those of the
        blade.

        A vibration of any phase is fitted at each probe.
        """
        count = self._runs[0].path.shape[1]
        square, seen, size = np.zeros((count, 2, 2)), np.zeros((count, 2)), np.ones(count)
        for run, force, weight in zip(self._runs, self.forces[0], self.weights, strict=True):
            more = run.phased(force * run.wave(self.mode), weight)
            square, seen = square + more[0], seen + more[1]
        there = square.any(axis=(1, 2))
        found = np.linalg.solve(square[there], seen[there, :, None])[..., 0]
        size[there] = np.hypot(*found.T) / np.median(found[:, 0])
        # Of 200 records with another mode within the width and 4 to 8 probes one had such a probe.
        off, apart = size < 0.5, np.abs(size - 1.0)
        if not 0 < np.count_nonzero(off) < np.count_nonzero(there & ~off):
            return np.array([], dtype=int)
        return np.flatnonzero(off & (apart[off].min() > 5.0 * apart[~off].max()))

    @cached_property
    def gain(self) -> float:
        """Reduction of -2 log likelihood by the vibration."""

        def solve(weights: np.ndarray) -> np.ndarray:
            parts = zip(self._runs, self._spread(weights), strict=True)
            left = [run.without_drifts(run.values, weight)[run.seen] for run, weight in parts]
            return np.asarray(np.concatenate(left) / np.sqrt(weights))

        unknowns = self.noise.unknowns - 2 * len(self.modes) * (1 + len(self._runs))
        empty = reweighted(solve, self.noise.weights, unknowns, self._runs[0].least)
        return empty.cost - self.noise.cost
