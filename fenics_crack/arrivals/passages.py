"""Find resonances that a rotor passes: natural frequency, damping and engine order.

Each resonance is a mode under an engine order, with the transient motion of :mod:`transient`.
The speeds of a record are searched for the clearest resonance, which :mod:`resonance` fits and this
module subtracts, until no significant one remains.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtri

from fenics_crack.arrivals.arrival_times import MIN_REVOLUTIONS_FOR_SPEED_OR_RESONANCE, ArrivalTimes
from fenics_crack.arrivals.fit_frequency import find_lines_and_residuals
from fenics_crack.arrivals.harmonics import DEFAULT_TRIAL_ORDERS, TipFit, make_orders_and_multiples
from fenics_crack.arrivals.resonance import (
    INITIAL_DAMPING_RATIO,
    MAX_REFIT_ROUNDS,
    PassageFit,
    Resonance,
)
from fenics_crack.arrivals.robust import SIGNIFICANCE_LIMITS, TRIAL_STUDENT_FREEDOMS
from fenics_crack.arrivals.transient import (
    FITTED_SPEEDS_RELATIVE_HALF_WIDTH,
    ArrivalsWithStiffeningLaw,
    StiffeningFunction,
    make_stiffening_function,
)
from fenics_crack.basics.errors import InputError, check_count, check_number
from fenics_crack.basics.progress import begin_stage
from fenics_crack.numerics.equations import SMALLEST_NORMAL

SCANNED_SPEED_RELATIVE_SPACING = 0.003
"""Relative spacing of scanned speeds."""


def fit_passage(
    arrivals: ArrivalTimes,
    speed: float,
    orders: Iterable[float] = DEFAULT_TRIAL_ORDERS,
    *,
    stiffening: float | StiffeningFunction = 0.0,
) -> PassageFit:
    """Fit a mode to all passages through a resonance near a speed.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Arrivals in run-ups and run-downs.
    speed : float [rad/s]
        Speed near the resonance, to 1 %.
    orders : iterable of float
        Candidates: periods of the load in a revolution.
    stiffening : float or function
        s = d ln w_n / d ln W from -0.9 to 0.9, with natural frequency w_n and rotor speed W. This
        is the slope d w_n / d W in a Campbell diagram, divided by w_n / W. Or a function s(W, w_n),
        both in rad/s, as :meth:`Campbell.stiffening`. If 0 is given for a blade with the stiffening
        s, the fitted damping is 1 / (1 - s) times the true damping.

    Returns
    -------
    PassageFit
        Frequency, damping and order.

    Raises
    ------
    InputError
        A value cannot be used, or the rotor does not pass this speed in 10 revolutions or more.

    Examples
    --------
    >>> fit = fc.fit_passage(record[1], 98.6, range(6, 10))
    """
    check_number("speed", speed, 0.0, excludes_bound=True)
    candidate_orders, _ = make_orders_and_multiples(orders, 1, 1)
    record = ArrivalsWithStiffeningLaw(arrivals, make_stiffening_function(stiffening))
    runs = record.find_runs(arrivals.displacement, speed)
    if not runs:
        recorded_speed_range = arrivals.speed.min(), arrivals.speed.max()
        allowed_speed_text = (
            f"inside the recorded range, {recorded_speed_range[0]:.6g} to "
            f"{recorded_speed_range[1]:.6g} rad/s, with "
            f"{MIN_REVOLUTIONS_FOR_SPEED_OR_RESONANCE} revolutions or more near it"
        )
        raise InputError("speed", speed, allowed_speed_text)
    resonance = Resonance(runs, speed, candidate_orders)
    if len(blind_probe_indices := resonance.best_fit.blind_probe_indices):
        arrivals_without_blind_probes = arrivals.without(blind_probe_indices)
        fit_without_blind_probes = fit_passage(
            arrivals_without_blind_probes, speed, candidate_orders, stiffening=stiffening
        )
        return replace(
            fit_without_blind_probes,
            blind=(*arrivals.probes[blind_probe_indices].tolist(), *fit_without_blind_probes.blind),
        )
    return resonance.to_passage_fit(record, arrivals.displacement)


def find_passages(
    arrivals: ArrivalTimes,
    orders: Iterable[float] = DEFAULT_TRIAL_ORDERS,
    *,
    most: int = 8,
    asynchronous: int = 1,
    stiffening: float | StiffeningFunction = 0.0,
) -> tuple[PassageFit, ...]:
    """Find the resonances in a record, roughly the largest first.

    At speeds 0.3 % apart, a vibration with any phase at each probe is fitted. At the speed with the
    largest reduction of squared residuals, the mode is fitted as by :func:`fit_passage`. The mode's
    motion is subtracted before the next search. The search ends when no significant resonance
    remains. Vibrations with constant frequency are fitted, too.

    Some probes may not measure the first resonance, and would add false resonances. These probes
    are left out if they are a minority, and the remaining probes measure nearly the same amplitude.
    ``blind`` in the results has the angles.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Arrivals in run-ups and run-downs.
    orders : iterable of float
        Candidate orders: periods of the load in a revolution.
    most : int
        Maximum number of resonances.
    asynchronous : int
        Maximum number of vibrations with constant frequency. If they are not fitted, they look like
        resonances with little damping.
    stiffening : float or function
        Stiffening s = d ln w_n / d ln W from -0.9 to 0.9, with natural frequency w_n and rotor
        speed W; a number holds for all modes. Or a function s(W, w_n), both in rad/s.

    Returns
    -------
    tuple of PassageFit
        Empty if no resonance is significant.

    Raises
    ------
    InputError
        A value cannot be used.

    Examples
    --------
    >>> for fit in fc.find_passages(record[1], range(6, 10), most=2):
    ...     print(fit)
    """
    candidate_orders, _ = make_orders_and_multiples(orders, 1, 1)
    check_count("most", most, 1)
    check_count("asynchronous", asynchronous, 0)
    record = ArrivalsWithStiffeningLaw(arrivals, make_stiffening_function(stiffening))
    displacements = arrivals.displacement
    search = _ResonanceSearch(record, displacements, candidate_orders)
    line_fits: tuple[TipFit, ...] = ()
    # A vibration of constant frequency (line) and a resonance may look alike. Therefore find in
    # turn: the clearest resonance, lines, the other resonances, and the lines again.
    search.add_resonances_up_to(1 if asynchronous else most)
    if search.resonances and len(
        blind_probe_indices := search.resonances[0].best_fit.blind_probe_indices
    ):
        fits = find_passages(
            arrivals.without(blind_probe_indices), candidate_orders, most=most,
            asynchronous=asynchronous, stiffening=stiffening,
        )  # fmt: skip
        blind_probe_angles = arrivals.probes[blind_probe_indices].tolist()
        return tuple(replace(fit, blind=(*blind_probe_angles, *fit.blind)) for fit in fits)
    if asynchronous:
        line_fits, spectral_line_motion = _find_lines_and_motion(
            arrivals, search.subtract_resonances(), candidate_orders, asynchronous
        )
        if line_fits:
            search = _ResonanceSearch(
                record, displacements - spectral_line_motion, candidate_orders
            )
        search.add_resonances_up_to(most)
        if len(search.resonances) > 1:
            line_fits, spectral_line_motion = _find_lines_and_motion(
                arrivals,
                search.subtract_resonances() + spectral_line_motion,
                candidate_orders,
                asynchronous,
            )
            if line_fits:
                search.refit_resonances(displacements - spectral_line_motion)
    residuals = search.subtract_resonances()
    return tuple(
        resonance.to_passage_fit(record, residuals, search.resonances, line_fits)
        for resonance in search.resonances
    )


def _find_lines_and_motion(
    arrivals: ArrivalTimes, displacements: np.ndarray, orders: np.ndarray, max_lines: int
) -> tuple[tuple[TipFit, ...], np.ndarray]:
    """Find vibrations whose frequency is constant while the speed varies.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Arrival times and probes.
    displacements : (revolutions, probes) [m]
        Displacements to search; nan without an arrival.
    orders : (n,)
        Candidate engine orders. Frequencies are searched up to the mean speed times p + 1, with the
        largest order p, at least 24.
    max_lines : int
        Maximum number of vibrations.

    Returns
    -------
    lines : tuple of TipFit
        Vibrations.
    motion : (revolutions, probes) [m]
        Sum of their displacements; nan without an arrival.
    """
    begin_stage("vibrations of constant frequency")
    constant_indices = np.arange(displacements.shape[1]) * np.ones(displacements.shape, dtype=int)
    line_fits, residuals = find_lines_and_residuals(
        arrivals, displacements, constant_indices, orders.max(), max_lines
    )
    return line_fits, displacements - residuals


class _ResonanceSearch:
    """Search displacements for resonances.

    Parameters
    ----------
    record : ArrivalsWithStiffeningLaw
        Arrivals, and the stiffening of modes.
    displacements : (revolutions, probes) [m]
        Displacements in the record.
    candidate_orders : (n,)
        Orders to try for each resonance.

    Attributes
    ----------
    resonances : list of Resonance
        Resonances found so far.
    """

    def __init__(
        self,
        record: ArrivalsWithStiffeningLaw,
        displacements: np.ndarray,
        candidate_orders: np.ndarray,
    ) -> None:
        self.record, self.displacements, self.orders = record, displacements, candidate_orders
        self.resonances: list[Resonance] = []
        lowest_speed, highest_speed = record.arrivals.speed.min(), record.arrivals.speed.max()
        n_centres = int(np.log(highest_speed / lowest_speed) / SCANNED_SPEED_RELATIVE_SPACING)
        self._centre_speeds = lowest_speed * np.exp(
            SCANNED_SPEED_RELATIVE_SPACING * (0.5 + np.arange(n_centres))
        )
        # Results of :func:`_compute_gain_and_squares_reduction`; nan: not computed yet.
        self._gains_and_reductions = np.full((n_centres, 2), np.nan)

    def subtract_resonances(
        self, resonances_not_subtracted: Sequence[Resonance] = ()
    ) -> np.ndarray:
        """Return displacements less the fitted motion in resonances: (revolutions, probes) [m].

        The motion in all resonances found so far is subtracted, except in
        ``resonances_not_subtracted``.
        """
        subtracted_motions = [
            resonance.best_fit.displacements_by_mode[0]
            for resonance in self.resonances
            if resonance not in resonances_not_subtracted
        ]
        return np.asarray(self.displacements - sum(subtracted_motions))

    def add_resonances_up_to(self, max_resonances: int) -> None:
        """Search for further resonances, up to ``max_resonances`` in total.

        The search ends earlier if no significant resonance remains. Orders are then compared again
        for each resonance with new or lost neighbours in speed since the last comparison.
        """
        centre_speeds, gains_and_reductions = self._centre_speeds, self._gains_and_reductions
        while len(self.resonances) < max_resonances:
            residuals = self.subtract_resonances()
            begin_stage("search of the speed range for resonances")
            for centre_index in np.flatnonzero(np.isnan(gains_and_reductions[:, 0])):
                gains_and_reductions[centre_index] = _compute_gain_and_squares_reduction(
                    self.record, residuals, centre_speeds[centre_index]
                )
            if not np.any(
                gains_and_reductions[:, 0] > SIGNIFICANCE_LIMITS.min_resonance_likelihood_gain
            ):
                break
            begin_stage(f"resonance {len(self.resonances) + 1}")
            clearest_speed = centre_speeds[
                int(
                    np.where(
                        gains_and_reductions[:, 0]
                        > SIGNIFICANCE_LIMITS.min_resonance_likelihood_gain,
                        gains_and_reductions[:, 1],
                        0.0,
                    ).argmax()
                )
            ]
            gains_and_reductions[
                np.abs(centre_speeds / clearest_speed - 1.0) < 1.5 * SCANNED_SPEED_RELATIVE_SPACING
            ] = 0.0
            if (
                _compute_gain_and_squares_reduction(
                    self.record, residuals, clearest_speed, MAX_REFIT_ROUNDS
                )[0]
                < SIGNIFICANCE_LIMITS.min_resonance_likelihood_gain
            ):
                continue
            new_resonance = Resonance(
                self.record.find_runs(residuals, clearest_speed), clearest_speed, self.orders
            )
            if not new_resonance.is_clear:
                continue
            self.resonances.append(new_resonance)
            self._compare_orders_with_neighbour(new_resonance)
            self._refit_neighbours_until_settled()
            gains_and_reductions[
                (
                    np.abs(centre_speeds / clearest_speed - 1.0)
                    < 2.0 * FITTED_SPEEDS_RELATIVE_HALF_WIDTH
                )
                & (gains_and_reductions[:, 1] > 0.0)
            ] = np.nan
        for resonance in [*self.resonances]:  # compare all orders, with all resonances known
            if (
                resonance not in self.resonances
                or resonance.compared_neighbours == resonance.list_neighbours(self.resonances)
            ):
                continue
            if not self._compare_orders_with_neighbour(resonance):
                residuals = self.subtract_resonances([resonance])
                if runs := self.record.find_runs(residuals, resonance.speed):
                    resonance.compare_orders(runs, resonance.speed, self.orders)
            resonance.compared_neighbours = resonance.list_neighbours(self.resonances)
        self._refit_neighbours_until_settled()

    def refit_resonances(self, displacements: np.ndarray) -> None:
        """Fit the resonances to changed displacements (revolutions, probes) [m].

        Resonances may be dropped, as by :meth:`_refit_or_drop`.
        """
        self.displacements = displacements
        for resonance in [*self.resonances]:
            self._refit_or_drop(resonance)
        self._refit_neighbours_until_settled()

    def _refit_or_drop(self, resonance: Resonance) -> None:
        """Refit a resonance beside all others, or drop it.

        The resonance is dropped if it is no longer clear (:attr:`Resonance.is_clear`), or may be
        the residual of a larger resonance.
        """
        residuals = self.subtract_resonances([resonance])
        if not resonance.refit_and_test_clarity(self.record, residuals) or any(
            resonance.may_be_residual_of(other_resonance) for other_resonance in self.resonances
        ):
            self.resonances.remove(resonance)

    def _compare_orders_with_neighbour(self, resonance: Resonance) -> bool:
        """Find the best pair of orders for a resonance and its largest neighbour.

        Both are fitted jointly, since each motion disturbs the comparison between orders at the
        other resonance. A neighbour is another resonance within 3.5 % in speed, but not within the
        width of this resonance. A third resonance within the width of either is dropped: it may be
        a residual from a wrong order.

        Returns
        -------
        bool
            False if nothing is compared: with a single candidate order, without a neighbour, or if
            this resonance is within the width of a larger one.
        """
        resonance_amplitude = resonance.best_fit.largest_first_mode_amplitude
        larger_resonances = [
            neighbour
            for neighbour in self.resonances
            if neighbour.best_fit.largest_first_mode_amplitude > resonance_amplitude
        ]
        if len(self.orders) < 2 or any(
            neighbour.has_within_width(resonance) for neighbour in larger_resonances
        ):
            return False
        neighbours = [
            neighbour
            for neighbour in self.resonances
            if resonance.is_near(neighbour, FITTED_SPEEDS_RELATIVE_HALF_WIDTH)
            and not resonance.has_within_width(neighbour)
        ]
        if not neighbours:
            return False
        resonance_pair = (
            resonance,
            max(neighbours, key=lambda neighbour: neighbour.best_fit.largest_first_mode_amplitude),
        )
        self.resonances = [
            other_resonance
            for other_resonance in self.resonances
            if other_resonance in resonance_pair
            or not any(
                pair_member.has_within_width(other_resonance) for pair_member in resonance_pair
            )
        ]
        resonance.compare_order_pairs_with(
            resonance_pair[1], self.record, self.subtract_resonances(resonance_pair), self.orders
        )
        for pair_member in resonance_pair:
            pair_member.compared_neighbours = pair_member.list_neighbours(self.resonances)
        return True

    def _refit_neighbours_until_settled(self) -> None:
        """Refit neighbouring resonances in turn until their frequencies settle.

        Neighbours are within 7 % in speed. The rounds end if no frequency or damping changes by
        over 0.1 standard errors of the frequency, or after 5 rounds. :meth:`_refit_or_drop` may
        drop a resonance.
        """
        crowded_resonances = [
            resonance for resonance in self.resonances if resonance.list_neighbours(self.resonances)
        ]
        for _ in range(MAX_REFIT_ROUNDS):
            has_moved = False
            for resonance in sorted(
                crowded_resonances,
                key=lambda resonance: -resonance.best_fit.largest_first_mode_amplitude,
            ):
                previous_pole = resonance.best_fit.first_mode.pole
                self._refit_or_drop(resonance)
                pole_change = abs(resonance.best_fit.first_mode.pole - previous_pole)
                has_moved |= resonance not in self.resonances or pole_change > 0.1 * float(
                    resonance.best_fit.omega_and_damping_errors[0]
                )
            if not has_moved:
                break
            crowded_resonances = [
                resonance for resonance in crowded_resonances if resonance in self.resonances
            ]


def _compute_gain_and_squares_reduction(
    record: ArrivalsWithStiffeningLaw, displacements: np.ndarray, speed: float, n_rounds: int = 1
) -> tuple[float, float]:
    """Measure how well a steady vibration near a speed explains displacements.

    The vibration has any amplitude and phase at each probe, and the default damping ratio 0.004.
    Used to search the speed range for resonances.

    Parameters
    ----------
    record : ArrivalsWithStiffeningLaw
        Arrivals, and the stiffening of modes.
    displacements : (revolutions, probes) [m]
        Displacements to search.
    speed : float [rad/s]
        Speed of the resonance.
    n_rounds : int
        Rounds of least squares. From the second round on, arrivals have the weights of Student's t
        distribution.

    Returns
    -------
    gain : float
        Sum over the runs through the speed: the reduction of squares divided by the noise's
        variance, less 2 for each probe beyond the first. The variance follows from differences
        between successive displacements at a probe.
    squares_reduction : float [m^2]
        Reduction in the sum of squared residuals by the vibration.
    """
    total_gain = total_reduction = 0.0
    for run in record.find_runs(displacements, speed):
        successive_differences = np.concatenate(
            [
                np.diff(series[has_arrival])
                for series, has_arrival in zip(run.displacements.T, run.has_arrival.T, strict=True)
            ]
        )
        # Median of the difference of two normal errors.
        noise_scale = max(
            float(np.median(np.abs(successive_differences))) / (np.sqrt(2.0) * ndtri(0.75)),
            run.displacement_rounding,
        )
        steady_wave = 1.0 / (INITIAL_DAMPING_RATIO + 1j * (run.revolution_speeds / speed - 1.0))
        steady_wave = steady_wave[:, None] * np.ones_like(run.displacements)
        weights = run.has_arrival.astype(float)
        for _ in range(n_rounds):
            matrices, right_hand_sides, real_and_imaginary_waves, weighted_displacements = (
                run.build_equations_by_probe(steady_wave, weights)
            )
            probe_amplitudes = np.linalg.solve(
                matrices + SMALLEST_NORMAL * np.eye(2), right_hand_sides[..., None]
            )[..., 0]
            if n_rounds == 1:
                continue
            squared_ratios = (
                weighted_displacements
                - np.einsum("pa,arp->rp", probe_amplitudes, real_and_imaginary_waves)
            )[run.has_arrival] ** 2
            squared_ratios /= weights[run.has_arrival] * noise_scale**2
            weights[run.has_arrival] = (TRIAL_STUDENT_FREEDOMS[0] + 1.0) / (
                TRIAL_STUDENT_FREEDOMS[0] + squared_ratios
            )
        squares_reduction = float((right_hand_sides * probe_amplitudes).sum())
        total_gain += squares_reduction / noise_scale**2 - 2.0 * (run.n_probes - 1)
        total_reduction += squares_reduction
    return total_gain, total_reduction
