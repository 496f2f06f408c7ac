"""Model the transient of modes that a rotor sweeps through, and fit it.

A mode has the natural frequency w_n and the damping ratio zeta. Under engine order p, on a rotor
with angle alpha(t) and speed W = alpha', the mode moves the blade tip by

    u = Re a(t) exp(i p alpha),     a' = (lambda - i p W) a + zeta w_n F,

with the pole lambda = w_n (i sqrt(1 - zeta^2) - zeta), the envelope a, and the amplitude F in a
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
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from fenics_crack.arrivals.arrival_times import (
    MIN_REVOLUTIONS_FOR_SPEED_OR_RESONANCE,
    ArrivalTimes,
    interpolate_by_splines,
)
from fenics_crack.arrivals.robust import find_least_squares_residuals, fit_noise_by_reweighting
from fenics_crack.basics.errors import InputError, check_number
from fenics_crack.basics.tables import RAD_PER_TURN
from fenics_crack.numerics.equations import SMALLEST_NORMAL

FITTED_SPEEDS_RELATIVE_HALF_WIDTH = 0.035
"""Half width of the fitted speeds about a resonance, relative to the resonance's speed."""
DAMPING_RATIO_BOUNDS = 1e-5, FITTED_SPEEDS_RELATIVE_HALF_WIDTH / 2.0
"""Minimum and maximum of fitted damping ratios; a wider resonance looks like drift."""
MAX_STIFFENING_EXPONENT = 0.9
"""Maximum of |d ln w_n / d ln W|: orders hardly meet frequencies with a steeper dependence."""

StiffeningFunction = Callable[[float, float], float]
"""Function s(speed, natural frequency), both in rad/s, as ``Campbell.stiffening``.

s = d ln w_n / d ln W is the stiffening of a blade by rotation.
"""


class Run:
    """Hold successive revolutions during a passage through a resonance.

    Arrays have the shape (R, P), for R revolutions and P probes.

    Parameters
    ----------
    record : ArrivalsWithStiffeningLaw
        Arrivals, and the stiffening of modes.
    displacements : (revolutions, probes) [m]
        Displacements in the whole record, without the vibrations found before.
    begin_revolution, end_revolution : int
        Row of the first revolution, and of the revolution after the last.
    """

    def __init__(
        self,
        record: ArrivalsWithStiffeningLaw,
        displacements: np.ndarray,
        begin_revolution: int,
        end_revolution: int,
    ) -> None:
        arrivals, revolution_slice = record.arrivals, slice(begin_revolution, end_revolution)
        self.begin_revolution, self.end_revolution = begin_revolution, end_revolution
        self.record = record
        self.has_arrival = np.isfinite(displacements[revolution_slice])
        self.displacements = np.where(self.has_arrival, displacements[revolution_slice], 0.0)
        self.rotor_angles_without_vibration = arrivals.rotor_angle_without_vibration[
            revolution_slice
        ]
        self.expected_arrival_times = arrivals.expected[revolution_slice]
        self.arrival_rotor_angles = np.where(
            self.has_arrival, arrivals.angle[revolution_slice], self.rotor_angles_without_vibration
        )
        self.revolution_speeds = arrivals.speed[revolution_slice]
        self.displacement_rounding = arrivals.displacement_rounding
        self.centred_relative_speeds = (self.revolution_speeds - self.revolution_speeds.mean()) / (
            self.revolution_speeds.max() - self.revolution_speeds.min()
        )

    @property
    def n_probes(self) -> int:
        """Number of probes with arrivals in this run."""
        return int(self.has_arrival.any(axis=0).sum())

    def compute_waves(self, order: float, poles: np.ndarray) -> np.ndarray:
        """Return waves a(t) exp(i p alpha) at the arrivals, for several modes.

        The wave is the complex displacement [m] of the blade tip at time t, for the load amplitude
        F = 1 m. Here a is the slowly varying envelope, and alpha the rotor angle.

        Parameters
        ----------
        order : float
            Engine order p.
        poles : (m,) complex [1/s]
            Poles lambda of m modes, at equal distances.

        Returns
        -------
        (m, R, P) complex
            Wave of each mode in R revolutions at P probes.
        """
        poles_as_column = poles[:, None]
        steady_responses = 1.0 / (1j * order * self._expected_speeds - poles_as_column)
        envelopes = np.empty((len(poles), self.arrival_rotor_angles.size), dtype=complex)
        envelopes[:, 0] = steady_responses[:, 0]
        for part_slice, _, growth_factors in self._yield_growth_factors_by_part(order, poles):
            part_responses = steady_responses[:, part_slice.start : part_slice.stop - 1]
            response_sums = np.cumsum(
                (growth_factors[:, 1:] - growth_factors[:, :-1]) * part_responses, axis=1
            )
            response_sums += envelopes[:, [part_slice.start]]
            envelopes[:, part_slice.start + 1 : part_slice.stop] = (
                response_sums / growth_factors[:, 1:]
            )
        envelopes *= -poles_as_column.real * np.exp(1j * order * self.arrival_rotor_angles.ravel())
        return envelopes.reshape(-1, *self.arrival_rotor_angles.shape)

    def compute_wave(self, mode: Mode) -> np.ndarray:
        """Return the wave a(t) exp(i p alpha) of a mode at the arrivals: (R, P) complex.

        The wave is the complex displacement of the blade tip at time t, for the load amplitude F =
        1. Here a is the slowly varying envelope, p the order, and alpha the rotor angle.
        """
        return np.asarray(self.compute_waves(mode.order, np.array([mode.pole]))[0])

    def compute_wave_and_slope(self, mode: Mode) -> np.ndarray:
        """Return a mode's wave a(t) exp(i p alpha), then its slope: (2, R, P) complex.

        The wave is the complex displacement at time t, for the load amplitude F = 1. Here a is the
        slowly varying envelope, p the order, and alpha the rotor angle. The slope is the wave's
        derivative by ln lambda, with the mode's pole lambda. The wave is proportional to zeta w_n,
        the damping ratio times the natural frequency; the derivative holds this factor constant.
        """
        order, mode_pole = mode.order, mode.pole
        steady_responses = 1.0 / (1j * order * self._expected_speeds - mode_pole)
        envelopes = np.empty((2, self.arrival_rotor_angles.size), dtype=complex)
        envelopes[:, 0] = steady_responses[0], steady_responses[0] ** 2
        for part_slice, durations, [growth_factors] in self._yield_growth_factors_by_part(
            order, np.array([mode_pole])
        ):
            growth_and_slope = np.stack([growth_factors, -durations * growth_factors])
            part_responses = steady_responses[part_slice.start : part_slice.stop - 1]
            envelope_increments = (
                growth_and_slope[:, 1:] - growth_and_slope[:, :-1]
            ) * part_responses
            envelope_increments[1] += envelope_increments[0] * part_responses
            part_envelopes = (
                envelopes[:, [part_slice.start]] + np.cumsum(envelope_increments, axis=1)
            ) / growth_factors[1:]
            part_envelopes[1] += durations[1:] * part_envelopes[0]
            envelopes[:, part_slice.start + 1 : part_slice.stop] = part_envelopes
        envelopes *= -mode_pole.real * np.exp(1j * order * self.arrival_rotor_angles.ravel())
        envelopes[1] *= mode_pole
        return envelopes.reshape(2, *self.arrival_rotor_angles.shape)

    @cached_property
    def _expected_speeds(self) -> np.ndarray:
        """Rotor speed from each arrival without vibration to the next: (R P - 1,) [rad/s]."""
        return np.diff(self.rotor_angles_without_vibration.ravel()) / np.diff(
            self.expected_arrival_times.ravel()
        )

    def _yield_growth_factors_by_part(
        self, order: float, poles: np.ndarray
    ) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        """Yield exp(i p alpha - lambda t), the growth, at the expected arrivals.

        A blade without vibration has the expected arrivals. Used to integrate the envelope of a
        mode over time. To avoid overflow, the arrivals are divided into parts, in which the growth
        stays below about e^300. With a stiffening s, alpha and t are multiplied by 1 - s. The value
        of s is taken at the mean frequency w of ``poles``, and the speed w / p.

        Parameters
        ----------
        order : float
            Engine order p.
        poles : (m,) complex [1/s]
            Values of the pole lambda, at equal distances.

        Yields
        ------
        part_slice : slice
            Positions of the part's n arrivals among all R P arrivals. Each part but the first
            begins with the last arrival of the previous part.
        durations : (n,) [s]
            Times since the part's first arrival, multiplied by 1 - s.
        growths : (m, n) complex
            The growth since the part's first arrival, for each pole.
        """
        mean_omega = float(np.abs(poles).mean())
        angles_and_times = np.stack(
            [self.rotor_angles_without_vibration.ravel(), self.expected_arrival_times.ravel()]
        )
        angles_and_times *= 1.0 - self.record.stiffening(mean_omega / order, mean_omega)
        largest_growth_exponent = -float(poles.real.min()) * float(np.ptp(angles_and_times[1]))
        n_parts = int(largest_growth_exponent // 300.0) + 1
        part_edge_arrival_indices = [
            (self.arrival_rotor_angles.size - 1) * part_index // n_parts
            for part_index in range(n_parts + 1)
        ]
        for first_arrival_index, last_arrival_index in itertools.pairwise(
            part_edge_arrival_indices
        ):
            part_slice = slice(first_arrival_index, last_arrival_index + 1)
            angles, durations = (
                angles_and_times[:, part_slice] - angles_and_times[:, [first_arrival_index]]
            )
            growths_of_first_pole = np.exp(1j * order * angles - poles[0] * durations)
            growth_ratios_of_successive_poles = np.exp(
                (poles[0] - poles[-1]) / max(len(poles) - 1, 1) * durations
            )
            growth_factors = np.cumprod(
                [growths_of_first_pole, *[growth_ratios_of_successive_poles] * (len(poles) - 1)],
                axis=0,
            )
            yield part_slice, durations, growth_factors

    def _compute_orthonormal_drifts(self, sqrt_weights: np.ndarray) -> np.ndarray:
        """Return the drift functions of each probe, weighted and orthonormal: (2, R, P).

        For each probe, a constant and a linear function of the speed are multiplied by
        ``sqrt_weights`` (R, P), square roots of the arrivals' weights. Then both are made
        orthonormal.
        """
        drifts = np.stack([sqrt_weights, sqrt_weights * self.centred_relative_speeds[:, None]])
        constant_drift, slope_drift = drifts
        constant_drift /= np.sqrt(
            np.maximum((constant_drift * constant_drift).sum(axis=0), SMALLEST_NORMAL)
        )
        slope_drift -= constant_drift * (constant_drift * slope_drift).sum(axis=0)
        slope_drift /= np.sqrt(np.maximum((slope_drift * slope_drift).sum(axis=0), SMALLEST_NORMAL))
        return drifts

    def subtract_weighted_drifts(self, waves: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Subtract each probe's drift from waves, and multiply by square roots of weights.

        The drift at a probe is a constant and a slope over the speed, fitted with the arrivals'
        ``weights`` (R, P). The waves and the result have the shape (m, R, P) or (R, P).
        """
        sqrt_weights = np.sqrt(weights)
        weighted_residuals = sqrt_weights * waves
        for drift in self._compute_orthonormal_drifts(sqrt_weights):
            weighted_residuals -= drift * (drift * weighted_residuals).sum(axis=-2, keepdims=True)
        return np.asarray(weighted_residuals)

    def build_equations_by_probe(
        self, wave: np.ndarray, weights: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """Return the least-squares equations for a wave's amplitude at each probe.

        The displacements at each probe are fitted by the wave with any amplitude and phase.

        Parameters
        ----------
        wave, weights : (R, P) complex, (R, P)
            Wave, and weights of the arrivals.

        Returns
        -------
        matrices, vectors : (P, 2, 2), (P, 2)
            Normal equations for real and imaginary part of each probe's complex amplitude.
        wave_parts, weighted_displacements : (2, R, P), (R, P)
            Real and negative imaginary part of the wave, and the displacements. Both are without
            drifts, times the square roots of the weights.
        """
        waves_and_values = np.stack([wave.real, -wave.imag, self.displacements])
        *real_and_imaginary_waves, weighted_displacements = self.subtract_weighted_drifts(
            waves_and_values, weights
        )
        matrices = np.einsum("arp,brp->pab", real_and_imaginary_waves, real_and_imaginary_waves)
        return (
            matrices,
            np.einsum("arp,rp->pa", real_and_imaginary_waves, weighted_displacements),
            np.array(real_and_imaginary_waves),
            weighted_displacements,
        )

    def compute_squares_reductions(
        self, orders: np.ndarray, trial_poles_by_order: np.ndarray, weights: np.ndarray
    ) -> np.ndarray:
        """Return how much single modes reduce the sum of squared residuals: (n, m) [m^2].

        The amplitude and phase of the force on each mode are fitted.

        Parameters
        ----------
        orders : (n,)
            Engine orders.
        trial_poles_by_order : (n, m) complex [1/s]
            Poles lambda of m trial modes for each order, equidistant in a row.
        weights : (R, P)
            Arrival weights.
        """
        sqrt_weights, weight_vector, reductions = np.sqrt(weights), weights.ravel(), []
        weighted_drifts = sqrt_weights * self._compute_orthonormal_drifts(sqrt_weights)
        weighted_residuals = (
            sqrt_weights * self.subtract_weighted_drifts(self.displacements, weights)
        ).ravel()
        for order, order_poles in zip(orders.tolist(), trial_poles_by_order, strict=True):
            waves = self.compute_waves(order, order_poles)
            drift_wave_products = np.einsum("krp,mrp->mkp", weighted_drifts, waves)
            waves = waves.reshape(len(order_poles), -1)
            wave_products = waves @ weighted_residuals
            unconjugated_wave_square_sums = waves**2 @ weight_vector - (drift_wave_products**2).sum(
                axis=(1, 2)
            )
            wave_square_sums = (waves.real**2 + waves.imag**2) @ weight_vector
            wave_square_sums -= (drift_wave_products.real**2 + drift_wave_products.imag**2).sum(
                axis=(1, 2)
            )
            numerators = (
                wave_square_sums * np.abs(wave_products) ** 2
                - (unconjugated_wave_square_sums.conj() * wave_products**2).real
            )
            reductions.append(
                2.0
                * numerators
                / (wave_square_sums**2 - np.abs(unconjugated_wave_square_sums) ** 2)
            )
        return np.array(reductions)


@dataclass(frozen=True)
class ArrivalsWithStiffeningLaw:
    """Hold arrivals, and the stiffening function of the blade.

    ``stiffening`` is s(speed, natural frequency), both in rad/s, with s = d ln w_n / d ln W for the
    natural frequency w_n and the speed W.
    """

    arrivals: ArrivalTimes
    stiffening: StiffeningFunction

    def find_runs(self, displacements: np.ndarray, speed: float) -> list[Run]:
        """Return the runs through a speed [rad/s]; an empty list without any.

        A run has 10 or more revolutions within 3.5 % of the speed, and passes the speed. A gap of
        over 10 revolutions begins a new run. Probes with fewer than 10 arrivals in a run do not
        count in this run. ``displacements`` are (revolutions, probes) [m].
        """
        relative_speed_offsets = self.arrivals.speed / speed - 1.0
        near_rows = np.flatnonzero(
            np.abs(relative_speed_offsets) < FITTED_SPEEDS_RELATIVE_HALF_WIDTH
        )
        runs = []
        for run_rows in np.split(
            near_rows,
            np.flatnonzero(np.diff(near_rows) > MIN_REVOLUTIONS_FOR_SPEED_OR_RESONANCE) + 1,
        ):
            if (
                len(run_rows) >= MIN_REVOLUTIONS_FOR_SPEED_OR_RESONANCE
                and relative_speed_offsets[run_rows].min()
                < 0.0
                < relative_speed_offsets[run_rows].max()
            ):
                run = Run(self, displacements, int(run_rows[0]), int(run_rows[-1]) + 1)
                # Leave out probes that measured too few revolutions of the run.
                run.has_arrival &= (
                    run.has_arrival.sum(axis=0) >= MIN_REVOLUTIONS_FOR_SPEED_OR_RESONANCE
                )
                runs += [run] * bool(np.any(run.has_arrival))
        return runs


def make_stiffening_function(stiffening: float | StiffeningFunction) -> StiffeningFunction:
    """Return the stiffening s as a function of speed and natural frequency [rad/s].

    A number holds at all speeds; InputError unless from -0.9 to 0.9. Values of a function are
    clipped to this range; InputError if a value is nan.
    """
    if callable(stiffening):

        def clipped_function(speed: float, omega: float) -> float:
            stiffening_exponent = float(
                np.clip(stiffening(speed, omega), -MAX_STIFFENING_EXPONENT, MAX_STIFFENING_EXPONENT)
            )
            check_number(f"stiffening({speed:.6g}, {omega:.6g})", stiffening_exponent)
            return stiffening_exponent

        return clipped_function
    check_number("stiffening", stiffening)
    if abs(stiffening_exponent := float(stiffening)) > MAX_STIFFENING_EXPONENT:
        raise InputError(
            "stiffening",
            stiffening,
            f"a number from -{MAX_STIFFENING_EXPONENT} to {MAX_STIFFENING_EXPONENT}",
        )
    return lambda speed, omega: stiffening_exponent


def compute_poles(omegas: np.ndarray, damping_ratio: float) -> np.ndarray:
    """Return poles lambda [1/s] from natural frequencies w_n [rad/s] and a damping ratio.

    lambda = w_n (i sqrt(1 - zeta^2) - zeta).
    """
    return omegas * (1j * np.sqrt(1.0 - damping_ratio**2) - damping_ratio)


@dataclass(frozen=True)
class Mode:
    """Hold an engine order p, and a mode's pole lambda [1/s]."""

    order: float
    pole: complex

    @property
    def omega(self) -> float:
        """Natural frequency [rad/s]."""
        return abs(self.pole)

    @property
    def damping_ratio(self) -> float:
        """Damping ratio zeta."""
        return -self.pole.real / abs(self.pole)

    @property
    def speed(self) -> float:
        """Rotor speed at which the order excites the natural frequency [rad/s]."""
        return self.omega / self.order

    def with_step(self, step: np.ndarray) -> Mode:
        """Return the mode after a step in natural frequency w_n and damping ratio zeta.

        ``step`` (2,) has two changes: of ln w_n, divided by zeta; and of ln zeta.
        """
        omega = self.omega * math.exp(self.damping_ratio * step[0])
        return Mode(
            self.order, complex(compute_poles(omega, self.damping_ratio * math.exp(step[1])))
        )

    def find_step_to(self, omega: float, damping_ratio: float) -> list[float]:
        """Return the step to a natural frequency ``omega`` [rad/s] and a damping ratio.

        The result is the argument ``step`` of :meth:`with_step`.
        """
        frequency_step = math.log(omega / self.omega) / self.damping_ratio
        return [frequency_step, math.log(damping_ratio / self.damping_ratio)]


class Fit:
    """Fit frequencies and damping ratios of modes, with small weights for wrong arrivals.

    The displacement is linear in the forces and the probes' drifts. Both are fitted anew for all
    trial frequencies and damping ratios (variable projection).

    Parameters
    ----------
    runs : sequence of Run
        Runs with common modes; each run has separate forces and drifts.
    modes : sequence of Mode
        Initial modes, all fitted jointly.
    weights : sequence of (R, P)
        Initial arrival weights in each run.

    Attributes
    ----------
    modes : tuple of Mode
        Fitted modes.
    forces : (modes, runs) complex [m]
        Load amplitude F on each mode in each run.
    noise_model : StudentNoise
        Residuals of all arrivals, and their weights.
    """

    def __init__(
        self, runs: Sequence[Run], modes: Sequence[Mode], weights: Sequence[np.ndarray]
    ) -> None:
        self._runs, self.modes = runs, tuple(modes)
        self._initial_omegas = [mode.omega for mode in modes]
        self._cached_waves_function = lru_cache(maxsize=1)(self._list_waves_and_slopes)
        initial_weights = np.concatenate(
            [run_weights[run.has_arrival] for run, run_weights in zip(runs, weights, strict=True)]
        )
        n_unknowns = 2 * len(modes) + sum(2 * len(modes) + 2 * run.n_probes for run in runs)
        self.noise_model = fit_noise_by_reweighting(
            self._refit_modes_and_return_residuals,
            initial_weights,
            n_unknowns,
            runs[0].displacement_rounding,
        )

    def _refit_modes_and_return_residuals(self, weights: np.ndarray) -> np.ndarray:
        """Fit the modes with fixed weights (n,) of the arrivals, and return residuals (n,) [m].

        The fitted values are the attributes ``modes`` and ``forces``.
        """
        initial_modes, run_weights = self.modes, self._split_by_run(weights)
        step_bounds = [
            [
                mode.find_step_to(
                    omega * (1.0 + lower_or_upper_sign * FITTED_SPEEDS_RELATIVE_HALF_WIDTH),
                    DAMPING_RATIO_BOUNDS[lower_or_upper_sign > 0],
                )
                for lower_or_upper_sign in (-1, 1)
            ]
            for mode, omega in zip(initial_modes, self._initial_omegas, strict=True)
        ]

        def residuals_and_slopes(steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            mode_step_pairs = zip(initial_modes, steps.reshape(-1, 2), strict=True)
            self.modes = tuple(
                mode.with_step(mode_step) if any(mode_step) else mode
                for mode, mode_step in mode_step_pairs
            )
            step_units = np.array(
                [step_unit for mode in initial_modes for step_unit in (mode.damping_ratio, 1.0)]
            )
            residual_vector, self._slopes = self._fit_forces_and_return_residuals(run_weights)
            return residual_vector, self._slopes * step_units

        lower_bounds, upper_bounds = np.concatenate(step_bounds, axis=1)
        return find_least_squares_residuals(
            residuals_and_slopes, lower_bounds, upper_bounds
        ) / np.sqrt(weights)

    def _list_waves_and_slopes(self, modes: tuple[Mode, ...]) -> list[np.ndarray]:
        """Return the waves and slopes of all modes in each run: (2 modes, R, P) complex.

        Each mode has two entries in turn, from :meth:`Run.compute_wave_and_slope`.
        """
        return [np.concatenate([*map(run.compute_wave_and_slope, modes)]) for run in self._runs]

    def _fit_forces_and_return_residuals(
        self, weights: Sequence[np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Fit the forces on the modes in the attribute ``modes`` by linear least squares.

        ``weights`` has an array (R, P) for each run-up or run-down: the arrivals' weights in R
        revolutions at P probes. Sets the attribute ``forces``.

        Returns
        -------
        residuals : (n,) [m]
            Residuals of all n arrivals, times square roots of the weights.
        slopes : (n, 2 n_modes) [m]
            Derivatives of the residuals by ln w_n and ln zeta, two columns for each mode in turn.
            Here w_n is the mode's natural frequency, and zeta its damping ratio.
        """
        run_forces, residual_blocks = [], []
        log_pole_slopes = np.array([(1.0, mode.pole.real / mode.pole) for mode in self.modes])
        for run, weighted_waves, run_weights in zip(
            self._runs, self._cached_waves_function(self.modes), weights, strict=True
        ):
            displacements_and_waves = run.subtract_weighted_drifts(
                np.concatenate([run.displacements[None], weighted_waves]), run_weights
            )
            weighted_displacements, *weighted_waves = displacements_and_waves[:, run.has_arrival]
            # Axes: mode; wave or slope; real or negative imaginary part; arrival.
            wave_parts = np.stack([np.real(weighted_waves), -np.imag(weighted_waves)], axis=1)
            wave_parts = wave_parts.reshape(-1, 2, 2, len(weighted_displacements))
            wave_columns = wave_parts[:, 0].reshape(-1, len(weighted_displacements))
            residual_rows = np.vstack(
                [
                    weighted_displacements.real,
                    wave_parts[:, 1].reshape(-1, len(weighted_displacements)),
                ]
            )
            force_parts = np.linalg.lstsq(
                wave_columns @ wave_columns.T, wave_columns @ residual_rows.T, rcond=None
            )[0]
            residual_rows -= force_parts.T @ wave_columns
            run_forces.append(force_parts[0::2, 0] + 1j * force_parts[1::2, 0])
            force_times_log_pole_slopes = (
                run_forces[-1][:, None] * log_pole_slopes
            )  # by ln w_n, and by ln zeta
            residual_slopes = (
                force_times_log_pole_slopes[..., None]
                * (residual_rows[1::2] - 1j * residual_rows[2::2])[:, None]
            )
            residual_blocks.append(
                np.vstack(
                    [
                        residual_rows[:1],
                        -residual_slopes.real.reshape(-1, len(weighted_displacements)),
                    ]
                ).T
            )
        self.forces, residual_columns = np.array(run_forces).T, np.concatenate(residual_blocks)
        return residual_columns[:, 0], residual_columns[:, 1:]

    def _split_by_run(self, values: np.ndarray) -> list[np.ndarray]:
        """Split values (n,) of all arrivals by run: (R, P) for each run, 0 without an arrival."""
        split_indices = np.cumsum([int(run.has_arrival.sum()) for run in self._runs])[:-1]
        run_arrays = [np.zeros(run.rotor_angles_without_vibration.shape) for run in self._runs]
        for run_array, run, arrival_values in zip(
            run_arrays, self._runs, np.split(values, split_indices), strict=True
        ):
            run_array[run.has_arrival] = arrival_values
        return run_arrays

    @property
    def first_mode(self) -> Mode:
        """First of the fitted modes."""
        return self.modes[0]

    @property
    def revolutions_and_probes(self) -> tuple[np.ndarray, np.ndarray]:
        """Indices of revolutions and probes for the n arrivals: two arrays (n,)."""
        places_of_runs = [
            np.add(np.nonzero(run.has_arrival), [[run.begin_revolution], [0]]) for run in self._runs
        ]
        revolution_indices, probe_indices = np.concatenate(places_of_runs, axis=1)
        return revolution_indices, probe_indices

    @cached_property
    def omega_and_damping_errors(self) -> np.ndarray:
        """Standard errors of the first mode: natural frequency [rad/s] and damping ratio, (2,)."""
        unweighted_slopes = self._slopes / np.sqrt(self.noise_model.weights)[:, None]
        covariance = self.noise_model.coefficient_covariance(
            unweighted_slopes, self.revolutions_and_probes
        )
        return np.sqrt(np.diag(covariance)[:2]) * [
            self.first_mode.omega,
            self.first_mode.damping_ratio,
        ]

    @cached_property
    def largest_first_mode_amplitude(self) -> float:
        """Largest amplitude [m] of the first mode in the runs."""
        force_run_pairs = zip(self.forces[0], self._runs, strict=True)
        return float(
            max(
                np.abs(complex_force * run.compute_wave(self.first_mode)).max()
                for complex_force, run in force_run_pairs
            )
        )

    @cached_property
    def displacements_by_mode(self) -> list[np.ndarray]:
        """Displacements by each mode in the whole record: (revolutions, probes) [m] for each.

        A run has the consecutive revolutions near the resonance, and the fitted force of this run.
        Revolutions between two runs are computed, too: the first half with the force of the run
        before, the second half with the force of the run after. Likewise, the first and last run
        are extended to the ends of the record.
        """
        record = self._runs[0].record
        revolutions_halfway_between_runs = [
            (run.end_revolution + next_run.begin_revolution) // 2
            for run, next_run in itertools.pairwise(self._runs)
        ]
        extended_run_edge_revolutions = [0, *revolutions_halfway_between_runs, len(record.arrivals)]
        placeholder_displacements = np.zeros(record.arrivals.time.shape)
        runs_extended_over_record = [
            Run(record, placeholder_displacements, begin_revolution, end_revolution)
            for begin_revolution, end_revolution in itertools.pairwise(
                extended_run_edge_revolutions
            )
        ]
        return [
            np.concatenate(
                [
                    (complex_force * run.compute_wave(mode)).real
                    for run, complex_force in zip(
                        runs_extended_over_record, mode_forces, strict=True
                    )
                ]
            )
            for mode, mode_forces in zip(self.modes, self.forces, strict=True)
        ]

    @property
    def whiteness_p_value(self) -> float:
        """Probability of correlated residuals by errors in arrivals and shaft marks alone.

        A small probability means another vibration or drift in the residuals; nan without a test.
        """
        mark_numbers = np.arange(-4.0, 6.0)  # farther marks hardly change the angle's spline
        arrival_shift_per_mark_error = interpolate_by_splines(
            mark_numbers,
            np.eye(len(mark_numbers)),
            self._runs[0].rotor_angles_without_vibration[0] / RAD_PER_TURN % 1.0,
        ).T
        return self.noise_model.compute_whiteness_p_value(
            self.revolutions_and_probes, arrival_shift_per_mark_error
        )

    @property
    def weights(self) -> list[np.ndarray]:
        """Arrival weights in each run: (R, P), 0 without an arrival."""
        return self._split_by_run(self.noise_model.weights)

    @property
    def blind_probe_indices(self) -> np.ndarray:
        """Indices (n,) of blind probes, which do not measure the blade's vibration.

        At each probe, the first mode's fitted motion is multiplied by a complex factor, to fit the
        displacements. The factor's magnitude is divided by the median over all probes of the
        factors' real parts. This ratio is about 1 at most probes.

        The probes with a ratio below 0.5 are blind, under two conditions. First, the remaining
        probes with arrivals are more numerous. Second, the ratios below 0.5 are clearly apart: the
        smallest deviation from 1 is more than five times as large as the largest deviation among
        the remaining ratios.
        """
        n_probes = self._runs[0].rotor_angles_without_vibration.shape[1]
        matrices, right_hand_sides = np.zeros((n_probes, 2, 2)), np.zeros((n_probes, 2))
        factor_over_median_ratios = np.ones(n_probes)
        for run, complex_force, run_weights in zip(
            self._runs, self.forces[0], self.weights, strict=True
        ):
            run_equations = run.build_equations_by_probe(
                complex_force * run.compute_wave(self.first_mode), run_weights
            )
            matrices, right_hand_sides = (
                matrices + run_equations[0],
                right_hand_sides + run_equations[1],
            )
        has_motion = matrices.any(axis=(1, 2))
        complex_factor_parts_of_probes = np.linalg.solve(
            matrices[has_motion], right_hand_sides[has_motion, :, None]
        )[..., 0]
        factor_over_median_ratios[has_motion] = np.hypot(
            *complex_factor_parts_of_probes.T
        ) / np.median(complex_factor_parts_of_probes[:, 0])
        # Measured: of 200 records with 4 to 8 probes, and a second mode within the width, one had
        # a probe that fulfils these conditions.
        has_small_ratio, factor_ratio_offsets_from_one = (
            factor_over_median_ratios < 0.5,
            np.abs(factor_over_median_ratios - 1.0),
        )
        if (
            not 0
            < np.count_nonzero(has_small_ratio)
            < np.count_nonzero(has_motion & ~has_small_ratio)
        ):
            return np.array([], dtype=int)
        return np.flatnonzero(
            has_small_ratio
            & (
                factor_ratio_offsets_from_one[has_small_ratio].min()
                > 5.0 * factor_ratio_offsets_from_one[~has_small_ratio].max()
            )
        )

    @cached_property
    def likelihood_gain(self) -> float:
        """Reduction of -2 log likelihood by the modes, compared with drifts alone."""

        def solve(weights: np.ndarray) -> np.ndarray:
            run_weight_pairs = zip(self._runs, self._split_by_run(weights), strict=True)
            run_residuals = [
                run.subtract_weighted_drifts(run.displacements, run_weights)[run.has_arrival]
                for run, run_weights in run_weight_pairs
            ]
            return np.asarray(np.concatenate(run_residuals) / np.sqrt(weights))

        n_drift_unknowns = self.noise_model.n_unknowns - 2 * len(self.modes) * (1 + len(self._runs))
        noise_without_modes = fit_noise_by_reweighting(
            solve, self.noise_model.weights, n_drift_unknowns, self._runs[0].displacement_rounding
        )
        return noise_without_modes.cost - self.noise_model.cost
