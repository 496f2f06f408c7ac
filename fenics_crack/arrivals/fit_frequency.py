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
every vibration at an engine order.

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
from scipy.linalg import block_diag
from scipy.special import chdtrc

from fenics_crack.arrivals.arrival_times import ArrivalTimes
from fenics_crack.arrivals.harmonics import (
    DEFAULT_TRIAL_ORDERS,
    Candidates,
    TipFit,
    condition_number,
    select_candidate,
)
from fenics_crack.arrivals.robust import (
    SIGNIFICANCE_LIMITS,
    WEIGHT_CHANGE_TOLERANCE,
    find_least_squares_residuals,
    fit_noise_by_reweighting,
    student_variance_ratio,
)
from fenics_crack.basics.errors import InputError, check_count, check_number
from fenics_crack.basics.tables import RAD_PER_TURN
from fenics_crack.numerics.fourier import fourier_basis

MAX_SCANNED_FREQUENCIES = 10**8
"""Maximum number of frequencies in a scan, as for 1e6 revolutions and orders up to 24."""
MAX_REFINED_PEAKS, MIN_RELATIVE_PEAK_POWER = 40, 0.5
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

    If several frequencies fit equally well within errors, the result is the vibration with the
    smallest amplitude. :attr:`TipFit.ambiguous_orders` then has the other frequencies, divided by
    the mean speed. Fit no more harmonics than needed: with two, half the true frequency may fit by
    its second harmonic.

    Parameters
    ----------
    arrivals : ArrivalTimes
        The speed may vary.
    low, high : float [rad/s]
        Lowest and highest frequency of the load to try.
    harmonics : int
        Number of fitted harmonics: 1, 2, ... times the load's frequency.
    angle_deviation : float [rad]
        Probe angles' standard deviation, the same in every revolution.

    Returns
    -------
    TipFit
        Vibration. The order is the frequency divided by the mean speed: any number, with a
        standard error.

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
    has_arrival = np.isfinite(arrivals.time)
    n_arrivals = int(has_arrival.sum())
    n_constants = int(has_arrival.any(axis=0).sum()) if angle_deviation else 1
    if n_arrivals <= (n_unknowns := 2 * harmonics + 1 + n_constants):
        requirement_text = f"more than {n_unknowns}, the unknowns of the fit; fit fewer harmonics"
        raise InputError("arrivals", f"{n_arrivals} arrivals", requirement_text)
    arrivals_shape = arrivals.time.shape
    constant_indices = (
        np.arange(arrivals_shape[1]) * bool(angle_deviation) * np.ones(arrivals_shape, dtype=int)
    )
    displacements, omega_bounds = arrivals.displacement, (low, high)
    fit, noise_probability = _FrequencySearch(
        arrivals, displacements, constant_indices, harmonics, angle_deviation, omega_bounds
    ).find_best_fit_and_noise_probability()
    if (
        len(arrivals.probes) == 1
        and noise_probability > SIGNIFICANCE_LIMITS.vibration_significance_level
    ):
        probe_text = (
            f"one at {np.degrees(arrivals.probes[0]):g} degrees, whose arrivals do not vary"
        )
        requirement_text = (
            "two or more probes: one probe sees a vibration of a whole order as a constant"
        )
        raise InputError("probes", probe_text, requirement_text)
    return fit


def find_lines_and_residuals(
    arrivals: ArrivalTimes,
    displacements: np.ndarray,
    constant_indices: np.ndarray,
    max_order: float,
    max_lines: int = 3,
) -> tuple[tuple[TipFit, ...], np.ndarray]:
    """Find significant vibrations whose frequency is constant while the speed varies.

    The vibration is a line in the spectrum. Constants are fitted together with each vibration:
    every displacement is a constant plus the vibration. Constants also absorb vibrations at engine
    orders, if each probe has a constant for each revolution in the period. After this period, in
    revolutions, all probes see the same motion again.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Times, probes and radius; the speed may vary.
    displacements : (revolutions, probes) [m]
        Displacements to search; nan without an arrival.
    constant_indices : (revolutions, probes) int
        Index of the constant in each displacement. Displacements with the same index share a
        constant.
    max_order : float
        Upper bound of the searched frequencies, divided by the mean speed, less 1. At least 24 is
        used. The lower bound is half the mean speed.
    max_lines : int
        Maximum number of vibrations.

    Returns
    -------
    lines : tuple of TipFit
        Vibrations found; each is subtracted before the next search.
    residuals : (revolutions, probes) [m]
        Displacements without these vibrations, but with the constants.
    """
    line_fits: list[TipFit] = []
    mean_speed = arrivals.mean_speed
    omega_bounds = 0.5 * mean_speed, mean_speed * (max(max_order, DEFAULT_TRIAL_ORDERS[-1]) + 1.0)
    residuals = np.array(displacements)
    n_constants = len(np.unique(constant_indices[np.isfinite(displacements)]))
    while len(line_fits) < max_lines and np.isfinite(residuals).sum() > 2 * (n_constants + 3):
        fit, noise_probability = _FrequencySearch(
            arrivals, residuals, constant_indices, 1, np.inf, omega_bounds
        ).find_best_fit_and_noise_probability()
        if noise_probability > SIGNIFICANCE_LIMITS.vibration_significance_level:
            break
        line_fits.append(fit)
        residuals -= fit.displacement(fit.angles_at_arrivals(arrivals)) - fit.coefficients[0]
    return tuple(line_fits), residuals


class _FrequencySearch:
    """Fit a vibration in time, together with constant displacements, by least squares.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Record with the times and probes.
    displacements : (revolutions, probes) [m]
        Displacements; nan without an arrival.
    constant_indices : (revolutions, probes) int
        Index of the constant for each displacement; equal for displacements with a common constant.
    n_harmonics : int
        Number K of harmonics.
    constants_deviation : float [rad]
        The constants' standard deviation, divided by the tip radius; inf for free constants.
    omega_bounds : (float, float) [rad/s]
        Range of the frequency.

    Attributes
    ----------
    omega : float [rad/s]
        Frequency.
    coefficients : (2K,) [m]
        Cosine and sine coefficients of the harmonics: a1, b1, ....
    columns : (n, 2K+1)
        Derivatives of the displacements at n arrivals by the coefficients and the frequency.
    noise : StudentNoise
        Residuals of the arrivals, and their weights in the fit.
    """

    def __init__(
        self,
        arrivals: ArrivalTimes,
        displacements: np.ndarray,
        constant_indices: np.ndarray,
        n_harmonics: int,
        constants_deviation: float,
        omega_bounds: tuple[float, float],
    ) -> None:
        has_arrival = np.isfinite(displacements)
        self._revolution_and_probe_indices, self._omega_bounds = (
            np.nonzero(has_arrival),
            omega_bounds,
        )
        self._arrivals, self._displacements = arrivals, displacements[has_arrival]
        self._arrival_times = arrivals.time[has_arrival] - arrivals.marks[0]
        self._arrival_times_without_vibration = arrivals.expected[has_arrival] - arrivals.marks[0]
        self._harmonic_orders = np.arange(1.0, n_harmonics + 1.0)
        revolution_indices, _ = self._revolution_and_probe_indices
        self._duration = float(
            arrivals.marks[revolution_indices.max() + 1] - arrivals.marks[revolution_indices.min()]
        )
        self._probe_constant_columns = (
            constant_indices[has_arrival][:, None] == np.unique(constant_indices[has_arrival])
        ).astype(float)
        self._n_unknowns = 2 * n_harmonics + 1 + self._probe_constant_columns.shape[1]
        self._displacement_rounding = arrivals.displacement_rounding
        self._probe_constants_deviation = constants_deviation * arrivals.tip_radius
        self._probe_constants_weight = 0.0
        self._set_probe_constants_weight(
            float(
                np.std(
                    self._subtract_constants(self._displacements, np.ones(len(revolution_indices)))
                )
            )
        )
        self._noise_without_vibration = fit_noise_by_reweighting(
            lambda weights: self._subtract_constants(self._displacements, weights),
            np.ones(len(revolution_indices)), self._probe_constant_columns.shape[1],
            self._displacement_rounding,
        )  # fmt: skip

    def _set_probe_constants_weight(self, displacement_scatter: float) -> None:
        """Set the weight that keeps the fitted constants near their mean.

        An error in a probe's angle adds a constant to all displacements at this probe. The weight
        is (s / d)^2, with the displacements' scatter s, ``displacement_scatter`` [m]. The
        constants' standard deviation d [m] is known. The weight stays 0 for a single constant, and
        is 0 if d is inf.
        """
        if self._probe_constant_columns.shape[1] > 1:
            self._probe_constants_weight = (
                displacement_scatter / self._probe_constants_deviation
            ) ** 2

    def _subtract_constants(self, values: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Fit constants to values by weighted least squares, and subtract the constants.

        Values with the same index in ``constant_indices`` of this class share a constant.

        Parameters
        ----------
        values : (n,) or (n, m)
            One value, or m values, for each arrival. Each column has separate constants.
        weights : (n,)
            Weights of the arrivals.

        Returns
        -------
        (n,) or (n, m)
            Values without the constants.
        """
        weighted_columns = weights[:, None] * self._probe_constant_columns
        n_constants = self._probe_constant_columns.shape[1]
        normal_matrix = (
            self._probe_constant_columns.T @ weighted_columns
            + self._probe_constants_weight * (np.eye(n_constants) - 1.0 / n_constants)
        )
        return np.asarray(
            values
            - self._probe_constant_columns
            @ np.linalg.solve(normal_matrix, weighted_columns.T @ values)
        )

    def _fit_harmonics(
        self, omega: float, weights: np.ndarray, values: np.ndarray, times: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Fit harmonics and constants to displacements at a fixed frequency.

        Parameters
        ----------
        omega : float [rad/s]
            Frequency.
        weights : (n,)
            Arrival weights.
        values, times : (n,) [m], (n,) [s]
            Displacements, and their times.

        Returns
        -------
        coefficients : (2K,) [m]
            Cosine and sine coefficients: a1, b1, ....
        residuals : (n,) [m]
            Values less the fit.
        columns : (n, 2K+1)
            Derivatives of the fit by the coefficients and by the frequency; constants fitted to
            each derivative are subtracted.
        """
        wave_columns = fourier_basis(omega * times, self._harmonic_orders)[:, 1:]
        sqrt_weights = np.sqrt(weights)[:, None]
        columns_and_values = self._subtract_constants(
            np.column_stack([wave_columns, values]), weights
        )
        reduced_columns = columns_and_values[:, :-1]
        reduced_displacements = columns_and_values[:, -1]
        coefficients = np.linalg.lstsq(
            sqrt_weights * reduced_columns, sqrt_weights[:, 0] * reduced_displacements, rcond=1e-10
        )[0]
        harmonic_derivatives_by_phase = (
            wave_columns[:, 0::2] * coefficients[1::2] - wave_columns[:, 1::2] * coefficients[0::2]
        )
        omega_slope = self._subtract_constants(
            times * (harmonic_derivatives_by_phase @ self._harmonic_orders), weights
        )
        return (
            coefficients,
            reduced_displacements - reduced_columns @ coefficients,
            np.column_stack([reduced_columns, omega_slope]),
        )

    def _refine_omega_and_fit(self, omega: float, weights: np.ndarray) -> tuple[float, Any]:
        """Refine a frequency by least squares.

        Parameters
        ----------
        omega : float [rad/s]
            Initial frequency.
        weights : (n,)
            Weights of the arrivals.

        Returns
        -------
        omega : float [rad/s]
            Refined frequency, within ``omega_bounds`` of this class.
        fit : tuple
            Coefficients, residuals and columns at this frequency, from :meth:`_fit_harmonics`.
        """
        omega_unit, sqrt_weights = np.pi / self._duration, np.sqrt(weights)[:, None]
        best_omega, fit = omega, None

        def evaluate(unit_step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            nonlocal best_omega, fit
            best_omega = omega + omega_unit * float(unit_step[0])
            _, residuals, harmonic_columns = fit = self._fit_harmonics(
                best_omega, weights, self._displacements, self._arrival_times
            )
            weighted_columns = sqrt_weights * harmonic_columns[:, :-1]
            omega_slopes = -omega_unit * sqrt_weights * harmonic_columns[:, -1:]
            omega_slopes -= (
                weighted_columns @ np.linalg.lstsq(weighted_columns, omega_slopes, rcond=1e-10)[0]
            )
            return sqrt_weights[:, 0] * residuals, omega_slopes

        lower_step_bounds, upper_step_bounds = (
            [(omega_bound - omega) / omega_unit] for omega_bound in self._omega_bounds
        )
        find_least_squares_residuals(
            evaluate, lower_step_bounds, upper_step_bounds, WEIGHT_CHANGE_TOLERANCE**2
        )  # a small tolerance, since peaks are compared by their sums of squares
        return best_omega, fit

    def find_best_fit_and_noise_probability(self) -> tuple[TipFit, float]:
        """Find the best vibration in the range of frequencies.

        Among vibrations with equally small residuals, the smallest vibration is the best.

        Returns
        -------
        fit : TipFit
            The best vibration.
        chance : float
            Probability that noise alone gives a vibration as significant as this. 1 if the
            constants could explain the vibration, too (:meth:`_constants_absorb_vibration`).
        """
        weights = self._noise_without_vibration.weights
        refined_omegas_and_fits = [
            self._refine_omega_and_fit(initial_omega, weights)
            for initial_omega in self._find_peak_omegas().tolist()
        ]
        refined_peaks = [
            (self._constants_absorb_vibration(columns), float(weights @ residuals**2), omega)
            for omega, (_, residuals, columns) in refined_omegas_and_fits
        ]
        distinct_peak_omegas: list[float] = []
        for _, _, omega in sorted(refined_peaks):  # best first; leave out side lobes of a peak
            if all(
                abs(omega - distinct_peak_omega) >= 2.0 * RAD_PER_TURN / self._duration
                for distinct_peak_omega in distinct_peak_omegas
            ):
                distinct_peak_omegas.append(omega)
        self.omega = distinct_peak_omegas[0]
        self._fit_with_reweighting()
        compared_candidates, self.omega = self._compare_omegas_and_select(
            np.sort([self.omega, *distinct_peak_omegas[1:]])
        )
        self._fit_with_reweighting()
        # The error of a mark is common to all arrivals in a revolution: the likelihood alone would
        # overestimate the significance.
        covariance = self.noise.coefficient_covariance(
            self.columns, self._revolution_and_probe_indices
        )[:-1, :-1]
        wald_statistic = float(
            self.coefficients @ np.linalg.lstsq(covariance, self.coefficients, rcond=1e-10)[0]
        )
        significance_statistic = max(
            min(self._noise_without_vibration.cost - self.noise.cost, wald_statistic), 0.0
        )
        n_resolved_frequencies = max(
            float(np.ptp(self._omega_bounds)) * self._duration / RAD_PER_TURN, 1.0
        )
        chance = min(
            n_resolved_frequencies
            * float(chdtrc(2 * len(self._harmonic_orders) + 1, significance_statistic)),
            1.0,
        )
        return self._build_tip_fit(compared_candidates), 1.0 if self._constants_absorb_vibration(
            self.columns
        ) else chance

    def _constants_absorb_vibration(self, columns: np.ndarray) -> bool:
        """Return True if fitted constants can explain more than half of a vibration.

        Used to reject vibrations that these probes cannot distinguish from constants. The vibration
        has the amplitude 1, and the phase best explained by constants. The result is True if less
        than half the expected sum of squares, n / 2, remains. ``columns`` (n, 2K+1) come from
        :meth:`_fit_harmonics`: cosines and sines of K harmonics at n arrivals, less the constants,
        and the derivative by the frequency (not used).
        """
        reduced_waves = columns[:, :-1]
        return bool(np.linalg.eigvalsh(reduced_waves.T @ reduced_waves)[0] < 0.25 * len(columns))

    def _find_peak_omegas(self) -> np.ndarray:
        """Return the frequencies (n,) [rad/s] at the highest peaks of a spectrum.

        The spectrum is the power of the displacements without constants, summed over the harmonics.
        Returned are at most 40 peaks, all with more than half the highest power. If noise alone
        would give as high a peak, only the highest peak is returned.
        """
        min_omega, max_omega = self._omega_bounds
        omega_step = RAD_PER_TURN / (4.0 * self._duration)  # a quarter of the resolution
        first_frequency_number = int(np.ceil(min_omega / omega_step))
        end_frequency_number = int(np.floor(max_omega / omega_step)) + 1
        if not 0 < end_frequency_number - first_frequency_number < MAX_SCANNED_FREQUENCIES:
            requirement_text = (
                f"between {omega_step:.3g} and {MAX_SCANNED_FREQUENCIES * omega_step:.3g} rad/s "
                "for a record of this duration"
            )
            raise InputError("high - low", max_omega - min_omega, requirement_text)
        noise_psi = self._noise_without_vibration.psi
        power = np.zeros(end_frequency_number - first_frequency_number)
        block_size = 10**6  # frequencies at once, to limit the memory
        for multiple, block_start in itertools.product(
            self._harmonic_orders, range(0, len(power), block_size)
        ):
            power_block = power[block_start : block_start + block_size]
            spectrum = _compute_spectrum(
                multiple * omega_step * self._arrival_times,
                noise_psi,
                first_frequency_number + block_start,
                len(power_block),
            )
            power_block += np.abs(spectrum) ** 2
        padded_power = np.concatenate([[-np.inf], power, [-np.inf]])
        peak_indices = np.flatnonzero((power >= padded_power[:-2]) & (power >= padded_power[2:]))
        peak_indices = peak_indices[np.argsort(-power[peak_indices])[:MAX_REFINED_PEAKS]]
        if power[peak_indices[0]] < np.log(len(power)) * float(noise_psi @ noise_psi):
            peak_indices = peak_indices[:1]  # as high as in noise: exponentially distributed
        is_high = power[peak_indices] > MIN_RELATIVE_PEAK_POWER * power[peak_indices[0]]
        return np.asarray(omega_step * (first_frequency_number + peak_indices[is_high]))

    def _fit_with_reweighting(self) -> None:
        """Fit frequency, harmonics and constants, with small weights for wrong arrivals.

        Fits and new weights from the residuals follow in turn. The fit begins at the frequency in
        the attribute ``omega``. It sets the attributes ``omega``, ``coefficients``, ``columns`` and
        ``noise``.
        """

        def solve(weights: np.ndarray) -> np.ndarray:
            self.omega, (self.coefficients, residuals, self.columns) = self._refine_omega_and_fit(
                self.omega, weights
            )
            return np.asarray(residuals)

        self.noise = fit_noise_by_reweighting(
            solve, np.ones(len(self._displacements)), self._n_unknowns, self._displacement_rounding
        )
        self._set_probe_constants_weight(self.noise.scale)

    def _compare_omegas_and_select(self, omegas: np.ndarray) -> tuple[Candidates, float]:
        """Fit each of several frequencies (n,) [rad/s], and select the best.

        The arrivals have the weights of the last fit.

        Returns
        -------
        candidates : Candidates
            The compared frequencies, divided by the mean speed, with the residual of each.
        omega : float [rad/s]
            Selected frequency: the smallest vibration among equally good ones.
        """
        weights = self.noise.weights
        allowed_difference = SIGNIFICANCE_LIMITS.allowed_cost_difference * self.noise.scale**2
        coefficient_rows, residual_rows, columns_of_omegas = zip(
            *[
                self._fit_harmonics(omega, weights, self._displacements, self._arrival_times)
                for omega in omegas
            ],
            strict=True,
        )
        residual_square_sums = np.square(residual_rows) @ weights
        is_hidden = np.array([*map(self._constants_absorb_vibration, columns_of_omegas)])
        is_equivalent, best_index = select_candidate(
            residual_square_sums,
            np.linalg.norm(coefficient_rows, axis=1),
            allowed_difference,
            ~is_hidden,
        )
        # Displaced arrivals distinguish aliases, but not reliably: compare at expected arrivals.
        best_wave_at_expected_arrivals = (
            fourier_basis(
                omegas[best_index] * self._arrival_times_without_vibration, self._harmonic_orders
            )[:, 1:]
            @ coefficient_rows[best_index]
        )
        wave_residuals = [
            self._fit_harmonics(
                omega,
                weights,
                best_wave_at_expected_arrivals,
                self._arrival_times_without_vibration,
            )[1]
            for omega in omegas
        ]
        is_equivalent |= np.square(wave_residuals) @ weights < allowed_difference
        candidates = Candidates(
            omegas / self._arrivals.mean_speed,
            np.sqrt(residual_square_sums / len(self._displacements)),
            np.array([condition_number(columns[:, :-1]) for columns in columns_of_omegas]),
            is_equivalent,
            is_hidden,
        )
        return candidates, float(omegas[best_index])

    def _build_tip_fit(self, candidates: Candidates) -> TipFit:
        """Return the last fit as a result.

        The last fit has changed the selected frequency slightly since ``candidates`` was made. The
        order is this frequency divided by the mean speed. In the result, this order replaces the
        nearest order in ``candidates``.
        """
        mean_speed = self._arrivals.mean_speed
        order = self.omega / mean_speed
        orders = candidates.orders.copy()
        orders[np.abs(orders - order).argmin()] = order
        n_spare = len(self._displacements) - self._n_unknowns
        fit_covariance = student_variance_ratio(n_spare) * self.noise.coefficient_covariance(
            self.columns, self._revolution_and_probe_indices
        )
        mean_variance = (
            student_variance_ratio(n_spare)
            * self.noise.equivalent_normal_variance
            / len(self._displacements)
        )
        covariance = block_diag(mean_variance, fit_covariance[:-1, :-1])
        fitted_wave_displacements = (
            fourier_basis(self.omega * self._arrival_times, self._harmonic_orders)[:, 1:]
            @ self.coefficients
        )
        weights = self.noise.weights
        mean_displacement = float(
            weights @ (self._displacements - fitted_wave_displacements) / weights.sum()
        )
        return TipFit(
            order=order,
            order_error=float(np.sqrt(fit_covariance[-1, -1])) / mean_speed,
            speed=mean_speed,
            multiples=self._harmonic_orders,
            coefficients=np.append(mean_displacement, self.coefficients),
            covariance=covariance,
            scatter=float(np.sqrt(self.noise.equivalent_normal_variance)),
            misfit=np.nan,
            spare=n_spare,
            candidates=replace(candidates, orders=orders),
            asynchronous=(),
        )


def _compute_spectrum(
    phases: np.ndarray, values: np.ndarray, first_frequency_number: int, n_frequencies: int
) -> np.ndarray:
    """Return the Fourier sums of values at unevenly spaced phases.

    The sum for a whole number m is sum_j values_j exp(-i m phases_j). A Gaussian spreads each value
    over 16 cells of a grid. The grid's spectrum is then divided by the Gaussian's transform.

    Parameters
    ----------
    phases, values : (n,) [rad], (n,)
        Phases, and the values at the phases.
    first_frequency_number, n_frequencies : int
        First number m, and the number of sums.

    Returns
    -------
    (n_frequencies,) complex
        Sums for successive numbers m.
    """
    reach_in_cells = 8  # neighbours on each side, for eleven digits
    n_spectrum_frequencies = 2 * (n_frequencies // 2 + 1)
    middle_mode, n_cells = n_spectrum_frequencies // 2, 2 * n_spectrum_frequencies
    # Width by Greengard and Lee for a grid twice as fine as the spectrum.
    gaussian_width = np.pi * reach_in_cells / (n_spectrum_frequencies**2 * 3.0)
    shifted_terms = values * np.exp(-1j * (first_frequency_number + middle_mode) * phases)
    nearest_cells = np.floor(phases * n_cells / RAD_PER_TURN).astype(int)
    grid = np.zeros(n_cells, dtype=complex)
    for offset_from_nearest_cell in range(1 - reach_in_cells, reach_in_cells + 1):
        phase_cell_indices = nearest_cells + offset_from_nearest_cell
        gaussian_weighted_terms = shifted_terms * np.exp(
            -((phases - RAD_PER_TURN * phase_cell_indices / n_cells) ** 2) / (4.0 * gaussian_width)
        )
        grid += np.bincount(phase_cell_indices % n_cells, gaussian_weighted_terms.real, n_cells)
        grid += 1j * np.bincount(
            phase_cell_indices % n_cells, gaussian_weighted_terms.imag, n_cells
        )
    mode_numbers = np.arange(n_spectrum_frequencies) - middle_mode
    spectrum = np.fft.fft(grid)[mode_numbers] / n_cells
    return np.asarray(
        spectrum * np.sqrt(np.pi / gaussian_width) * np.exp(mode_numbers**2 * gaussian_width)
    )[:n_frequencies]
