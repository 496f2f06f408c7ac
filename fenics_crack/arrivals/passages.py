"""Find resonances that a rotor passes: natural frequency, damping and engine order.

Each resonance is a mode under an engine order, with the transient motion of :mod:`transient`.
Frequency and damping follow from least squares that begin at the best point of a grid; all passages
through a resonance are fitted together. The order follows from comparing the candidates. For two
neighbours, each order of the first is paired with each order of the second, and both modes are
fitted; the margin of an order is the margin of its best pair. An order is tested by three probes or
more: two probes see only a phase difference, and some order of a mode always comes near to it.
Standard errors are computed as in :mod:`robust`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import ndtri

from fenics_crack.arrivals.arrival_times import MIN_REQUIRED_REVOLUTIONS, ArrivalTimes
from fenics_crack.arrivals.fit_frequency import MIN_RELATIVE_PEAK, find_lines_and_residuals
from fenics_crack.arrivals.harmonics import ORDERS, TipFit, make_orders_and_multiples
from fenics_crack.arrivals.robust import CONFIDENCE_LEVELS, TRIAL_STUDENT_FREEDOMS
from fenics_crack.arrivals.transient import (
    DAMPING_RATIO_BOUNDS,
    RELATIVE_SPEED_HALF_WIDTH,
    Fit,
    Mode,
    Record,
    Run,
    StiffeningFunction,
    compute_poles,
)
from fenics_crack.basics.errors import InputError, check_count, check_number
from fenics_crack.basics.progress import begin_stage as begin_stage
from fenics_crack.basics.suggestions import with_old_names
from fenics_crack.basics.tables import (
    RAD_PER_S_PER_RPM,
    Tabular,
    format_count,
    format_quantity,
    hertz_property,
)
from fenics_crack.numerics.equations import SMALLEST_NORMAL

MAX_REFINED_ORDERS = 4
"""Maximum number of orders with refined fits; half as many for each of two neighbours."""
RELATIVE_SPEED_SPACING, INITIAL_DAMPING_RATIO = 0.003, 0.004
"""Relative spacing of scanned speeds; damping ratio in the scan and at the start of fits."""
MAX_SEARCH_ROUNDS = 5
"""Maximum rounds of refits of neighbours, of pairs of orders, and of weights in a search."""
MAX_STIFFENING = 0.9
"""Maximum of |d ln w_n / d ln W|: orders hardly meet frequencies with a steeper dependence."""


@with_old_names(disagreement="disagreement_in_words")
@dataclass(frozen=True, repr=False)
class PassageFit(Tabular):
    """Hold the fit to all passages through one resonance.

    One mode meets one engine order.

    Attributes
    ----------
    order : float
        Periods of the load in a revolution, for the best candidate.
    omega, omega_error : float [rad/s]
        Natural frequency, and its standard error from the scatter of the arrivals alone. The stated
        error is :attr:`deviation`, in Hz ``frequency_error``.
    damping, damping_error : float
        Ratio of critical damping, and its standard error. A fit without stiffening gives
        a ratio 1 / (1 - s) times as large.
    amplitude : float [m]
        Largest amplitude in the passages.
    forces : (passages,) complex [m]
        Amplitude F of each passage if the rotor stayed at the resonance.
    ends : (passages, 2) int
        First revolution of each passage, and the one after the last, counted from 0.
    omegas, omega_errors : (passages,) [rad/s]
        Natural frequency and error from each passage alone.
    dampings, damping_errors : (passages,)
        Damping ratio and error from each passage alone.
    orders : (n,)
        Candidates.
    margins : (n,)
        Difference in -2 log likelihood from the best order. With a neighbouring resonance in the
        fitted speeds, each order is combined with the neighbour's best order. The order of a
        resonance within this one's width, or the reverse, has 0, too: only one may be real.
    probes : int
        Number of probes with arrivals.
    scatter : float [m]
        Standard deviation of a displacement from the fit.
    whiteness : float
        Probability that errors of arrivals and shaft marks alone correlate residuals as much; nan
        without a test. Standard errors include the correlation, but no bias by another vibration
        nearby (:attr:`in_doubt`).
    asynchronous : tuple of TipFit
        Vibrations with constant frequency in the record, which follow no order.
    blind : tuple of float [rad]
        Angles of omitted probes, which do not measure the vibration seen by the majority.
    stiffening : float
        s = d ln w_n / d ln W, with natural frequency w_n and speed W.
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
    dampings: np.ndarray
    damping_errors: np.ndarray
    orders: np.ndarray
    margins: np.ndarray
    probes: int
    scatter: float
    whiteness: float
    asynchronous: tuple[TipFit, ...]
    blind: tuple[float, ...]
    stiffening: float

    frequency, frequencies = hertz_property(), hertz_property("omegas")
    frequency_error, frequency_errors = hertz_property("deviation"), hertz_property("omega_errors")

    @property
    def speed(self) -> float:
        """Rotor speed at which the order excites the natural frequency [rad/s]."""
        return self.omega / self.order

    @property
    def margin(self) -> float:
        """Difference in -2 log likelihood between the second best order and the best.

        inf for a single candidate.
        """
        return float(np.min(self.margins[self.orders != self.order], initial=np.inf))

    @property
    def untested(self) -> bool:
        """True with several candidate orders and fewer than three probes.

        Some order of a mode always comes near to two probes. The stated frequency then holds only
        if the order is right.
        """
        return self.probes < 3 and len(self.orders) > 1

    @property
    def ambiguous(self) -> tuple[float, ...]:
        """Further orders that explain the arrivals within three standard deviations.

        A margin below 9 is meant. If the fit is :attr:`untested`, all further candidates are
        returned.
        """
        is_other_equal = (
            (self.margins < CONFIDENCE_LEVELS.allowed_cost_difference) | self.untested
        ) & (self.orders != self.order)
        return tuple(self.orders[is_other_equal].tolist())

    @property
    def apart(self) -> float:
        """Range of the frequencies from single passages, over the frequency of the fit."""
        return float(np.ptp(self.omegas)) / self.omega

    @property
    def disagree(self) -> bool:
        """True if passages differ by over three standard errors in frequency or damping.

        Different amplitudes are no disagreement: the load need not be the same.
        """
        return bool(self.disagreement_in_words)

    @property
    def disagreement_in_words(self) -> str:
        """Text on how the passages :attr:`disagree`; "" if they agree."""
        difference_texts = []
        if _differ_significantly(self.omegas, self.omega_errors):
            difference_texts.append(f"by {self.apart:.2%} in frequency")
        if _differ_significantly(self.dampings, self.damping_errors):
            difference_texts.append(
                f"in damping, {self.dampings.min():.2g} to {self.dampings.max():.2g}"
            )
        return (
            f"passages differ by more than their errors: {', '.join(difference_texts)}"
            if difference_texts
            else ""
        )

    @property
    def in_doubt(self) -> bool:
        """True if residuals are correlated between revolutions, or cannot be tested.

        ``whiteness`` is then below 0.001, or nan. Causes are another vibration near this speed,
        drift, or a nonlinear blade. Frequency, damping and order may be wrong by more than their
        errors.
        """
        return not self.whiteness >= CONFIDENCE_LEVELS.misfit_significance_level

    @property
    def deviation(self) -> float:
        """Standard deviation of the frequency, stated as the error [rad/s].

        The largest of three: ``omega_error``; half the range of passages that disagree, as for a
        breathing crack; and for a fit in doubt half the resonance's width, zeta w_n, with damping
        ratio zeta.
        """
        half_frequency_range = 0.5 * float(np.ptp(self.omegas)) if self.disagree else 0.0
        half_resonance_width = self.damping * self.omega if self.in_doubt else 0.0
        return max(self.omega_error, half_frequency_range, half_resonance_width)

    @property
    def in_words(self) -> str:
        """Text with the frequency, its :attr:`deviation`, the engine order and the speed."""
        frequency_text = f"{self.frequency:.6g} ± {self.frequency_error:.2g} Hz"
        return (
            f"{frequency_text}, engine order {self.order:g} at "
            f"{self.speed / RAD_PER_S_PER_RPM:.6g} rpm"
        )

    def compared(self, arrivals: ArrivalTimes) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Return measured and fitted displacements for each passage.

        Probes in ``blind`` are left out.

        Returns
        -------
        list of (speed, measured, fitted)
            Speeds (R,) [rad/s]; displacements (R, P) [m] without drift, nan without an arrival; and
            the fitted displacements (R, P) [m], for R revolutions and P probes.
        """
        arrivals = arrivals.without(np.flatnonzero(np.isin(arrivals.probes, self.blind)))
        mode_pole = complex(compute_poles(self.omega, self.damping / (1.0 - self.stiffening)))
        record = Record(arrivals, _make_stiffening_function(self.stiffening))
        passage_comparisons = []
        for (begin_revolution, end_revolution), complex_force in zip(
            self.ends, self.forces, strict=True
        ):
            run = Run(record, arrivals.displacement, int(begin_revolution), int(end_revolution))
            fitted_motion = (complex_force * run.compute_wave(Mode(self.order, mode_pole))).real
            weighted_residuals = run.subtract_weighted_drifts(
                run.displacements - fitted_motion, run.has_arrival.astype(float)
            )
            passage_comparisons.append(
                (
                    run.revolution_speeds,
                    np.where(run.has_arrival, weighted_residuals + fitted_motion, np.nan),
                    fitted_motion,
                )
            )
        return passage_comparisons

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers of the fit by name.

        "apart" is the relative range of the frequencies from single passages; see also the
        attributes.
        """
        number_names = (
            "order",
            "margin",
            "frequency",
            "frequency_error",
            "damping",
            "damping_error",
        )
        number_by_name = {
            number_name: getattr(self, number_name)
            for number_name in (*number_names, "stiffening", "amplitude")
        }
        number_by_name = {
            "speed": self.speed,
            "rpm": self.speed / RAD_PER_S_PER_RPM,
        } | number_by_name
        statistic_by_name = {
            "passages": len(self.ends),
            "apart": self.apart,
            "whiteness": self.whiteness,
        }
        return number_by_name | statistic_by_name

    def _repr_text(self) -> str:
        frequency_text = f"{self.frequency:.6g} ± {self.frequency_error:.2g} Hz"
        damping_text = f"damping {self.damping:.3g} ± {self.damping_error:.2g}"
        title_parts = [
            f"order {self.order:g}, {self.speed / RAD_PER_S_PER_RPM:.6g} rpm",
            frequency_text,
            damping_text,
        ]
        title_parts.append(format_quantity(self.amplitude, "m"))
        if self.untested:
            title_parts.append(f"order untested by {format_count(self.probes, 'probe')}")
        elif self.ambiguous:
            title_parts.append(f"as well: {', '.join(f'{order:g}' for order in self.ambiguous)}")
        title_parts += ["residuals are correlated"] * self.in_doubt
        return ", ".join(title_parts)


def _differ_significantly(values: np.ndarray, errors: np.ndarray) -> bool:
    """Return True if two values differ by over three standard errors of the difference.

    ``values`` and ``errors`` are (n,).
    """
    pairwise_differences = np.abs(values[:, None] - values)
    return not np.all(
        pairwise_differences
        <= CONFIDENCE_LEVELS.allowed_standard_errors * np.hypot(errors[:, None], errors)
    )


# --- search ---------------------------------------------------------------------------------------


def fit_passage(
    arrivals: ArrivalTimes,
    speed: float,
    orders: Iterable[float] = ORDERS,
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
        s = d ln w_n / d ln W from -0.9 to 0.9: the slope in a Campbell diagram over w_n / W. Or a
        function s(W, w_n) of speed and natural frequency [rad/s], as :meth:`Campbell.stiffening`.
        With a constant frequency, s = 0, dampings are 1 / (1 - s) times the true ones.

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
    record = Record(arrivals, _make_stiffening_function(stiffening))
    runs = record.find_runs(arrivals.displacement, speed)
    if not runs:
        speed_ends = arrivals.speed.min(), arrivals.speed.max()
        allowed_speed_text = (
            f"a speed that {MIN_REQUIRED_REVOLUTIONS} revolutions or more pass through, from "
        )
        raise InputError(
            "speed", speed, f"{allowed_speed_text}{speed_ends[0]:.6g} to {speed_ends[1]:.6g} rad/s"
        )
    resonance = _Resonance(runs, speed, candidate_orders)
    if len(blind_probe_indices := resonance.best_fit.blind_probe_indices):
        reliable_arrivals = arrivals.without(blind_probe_indices)
        reliable_fit = fit_passage(
            reliable_arrivals, speed, candidate_orders, stiffening=stiffening
        )
        return replace(
            reliable_fit,
            blind=(*arrivals.probes[blind_probe_indices].tolist(), *reliable_fit.blind),
        )
    return resonance.to_passage_fit(record, arrivals.displacement)


def find_passages(
    arrivals: ArrivalTimes,
    orders: Iterable[float] = ORDERS,
    *,
    most: int = 8,
    asynchronous: int = 1,
    stiffening: float | StiffeningFunction = 0.0,
) -> tuple[PassageFit, ...]:
    """Find the resonances in a record, about the largest first.

    At speeds 0.3 % apart, a vibration with any phase at each probe is fitted. At the speed with the
    largest reduction of squared residuals, the mode is fitted as by :func:`fit_passage`, and
    subtracted before the next search. The search ends when no significant resonance remains.
    Vibrations with constant frequency are fitted beside the resonances. Probes that do not measure
    the first resonance are left out if a majority agrees (``blind`` in the fit): they would add
    further resonances.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Arrivals in run-ups and run-downs.
    orders : iterable of float
        Candidates: periods of the load in a revolution.
    most : int
        Maximum number of resonances.
    asynchronous : int
        Maximum number of vibrations with constant frequency. Without a fit, they look like
        resonances with little damping.
    stiffening : float or function
        As in :func:`fit_passage`; a number holds for all modes.

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
    record = Record(arrivals, _make_stiffening_function(stiffening))
    displacements = arrivals.displacement
    search = _ResonanceSearch(record, displacements, candidate_orders)
    line_fits: tuple[TipFit, ...] = ()
    # A line looks like a resonance everywhere, and a resonance like a line: beside the clearest of
    # them lines are found, then the others, and lines beside all of them.
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
        line_fits, line_motion = _find_lines_and_motion(
            arrivals, search.residuals, candidate_orders, asynchronous
        )
        if line_fits:
            search = _ResonanceSearch(record, displacements - line_motion, candidate_orders)
        search.add_resonances_up_to(most)
        if len(search.resonances) > 1:
            line_fits, line_motion = _find_lines_and_motion(
                arrivals, search.residuals + line_motion, candidate_orders, asynchronous
            )
            if line_fits:
                search.refit_resonances(displacements - line_motion)
    return tuple(
        resonance.to_passage_fit(record, search.residuals, search.resonances, line_fits)
        for resonance in search.resonances
    )


def _find_lines_and_motion(
    arrivals: ArrivalTimes, displacements: np.ndarray, orders: np.ndarray, max_lines: int
) -> tuple[tuple[TipFit, ...], np.ndarray]:
    """Find vibrations with constant frequency in displacements.

    Parameters
    ----------
    arrivals, displacements : ArrivalTimes, (revolutions, probes) [m]
        Arrival times, and the displacements to search; nan without an arrival.
    orders : (n,)
        Candidate orders, the largest of which bounds the frequencies.
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
    constant_numbers = np.arange(displacements.shape[1]) * np.ones(displacements.shape, dtype=int)
    line_fits, residuals = find_lines_and_residuals(
        arrivals, displacements, constant_numbers, orders.max(), max_lines
    )
    return line_fits, displacements - residuals


def _make_stiffening_function(stiffening: float | StiffeningFunction) -> StiffeningFunction:
    """Return the stiffening s as a function of speed and natural frequency [rad/s].

    A number holds at all speeds; InputError outside -0.9 to 0.9. Values of a function are clipped
    to this range; InputError for nan.
    """
    if callable(stiffening):

        def clipped_function(speed: float, omega: float) -> float:
            stiffening_value = float(
                np.clip(stiffening(speed, omega), -MAX_STIFFENING, MAX_STIFFENING)
            )
            check_number(f"stiffening({speed:.6g}, {omega:.6g})", stiffening_value)
            return stiffening_value

        return clipped_function
    check_number("stiffening", stiffening)
    if abs(stiffening_value := float(stiffening)) > MAX_STIFFENING:
        raise InputError(
            "stiffening", stiffening, f"a number from -{MAX_STIFFENING} to {MAX_STIFFENING}"
        )
    return lambda speed, omega: stiffening_value


class _ResonanceSearch:
    """Search displacements for resonances.

    Parameters
    ----------
    record : Record
        Arrivals, and the stiffening of modes.
    displacements : (revolutions, probes) [m]
        Displacements in the record.
    candidate_orders : (n,)
        Candidates.

    Attributes
    ----------
    resonances : list of _Resonance
        Resonances found until now.
    residuals : (revolutions, probes) [m]
        Displacements without the motion in the resonances.
    """

    def __init__(
        self, record: Record, displacements: np.ndarray, candidate_orders: np.ndarray
    ) -> None:
        self.record, self.residuals, self.orders = record, np.array(displacements), candidate_orders
        self.resonances: list[_Resonance] = []
        lowest_speed, highest_speed = record.revolution_speeds.min(), record.revolution_speeds.max()
        n_centres = int(np.log(highest_speed / lowest_speed) / RELATIVE_SPEED_SPACING)
        self._centre_speeds = lowest_speed * np.exp(
            RELATIVE_SPEED_SPACING * (0.5 + np.arange(n_centres))
        )
        # Of :func:`_compute_gain_and_squares_reduction`; nan: not known yet.
        self._gains_and_reductions = np.full((n_centres, 2), np.nan)

    def add_scaled_motion_to_residuals(self, resonance: _Resonance, factor: float) -> None:
        """Add a resonance's fitted displacements, times a factor, to the residuals.

        The factor is -1 to subtract the motion, 1 to restore it.
        """
        self.residuals += factor * resonance.best_fit.compute_motion(
            self.record, len(self.residuals)
        )

    def add_resonances_up_to(self, max_resonances: int) -> None:
        """Search for further resonances, until ``max_resonances`` are found in all.

        The search ends earlier if no significant resonance remains. Then the orders of resonances
        with new neighbours are compared again.
        """
        centre_speeds, gains_and_reductions = self._centre_speeds, self._gains_and_reductions
        while len(self.resonances) < max_resonances:
            begin_stage("search of the speed range for resonances")
            for centre_index in np.flatnonzero(np.isnan(gains_and_reductions[:, 0])):
                gains_and_reductions[centre_index] = _compute_gain_and_squares_reduction(
                    self.record, self.residuals, centre_speeds[centre_index]
                )
            if not np.any(gains_and_reductions[:, 0] > CONFIDENCE_LEVELS.min_likelihood_gain):
                break
            begin_stage(f"resonance {len(self.resonances) + 1}")
            clearest_speed = centre_speeds[
                int(
                    np.where(
                        gains_and_reductions[:, 0] > CONFIDENCE_LEVELS.min_likelihood_gain,
                        gains_and_reductions[:, 1],
                        0.0,
                    ).argmax()
                )
            ]
            gains_and_reductions[
                np.abs(centre_speeds / clearest_speed - 1.0) < 1.5 * RELATIVE_SPEED_SPACING
            ] = 0.0
            if (
                _compute_gain_and_squares_reduction(
                    self.record, self.residuals, clearest_speed, MAX_SEARCH_ROUNDS
                )[0]
                < CONFIDENCE_LEVELS.min_likelihood_gain
            ):
                continue
            new_resonance = _Resonance(
                self.record.find_runs(self.residuals, clearest_speed), clearest_speed, self.orders
            )
            if not new_resonance.is_clear:
                continue
            self.resonances.append(new_resonance)
            self.add_scaled_motion_to_residuals(new_resonance, -1.0)
            self._compare_orders_with_neighbour(new_resonance)
            self._refit_neighbours_until_settled()
            gains_and_reductions[
                (np.abs(centre_speeds / clearest_speed - 1.0) < 2.0 * RELATIVE_SPEED_HALF_WIDTH)
                & (gains_and_reductions[:, 1] > 0.0)
            ] = np.nan
        for resonance in [*self.resonances]:  # of all orders, beside the others
            if (
                resonance not in self.resonances
                or resonance.compared_neighbours == resonance.list_neighbours(self.resonances)
            ):
                continue
            if not self._compare_orders_with_neighbour(resonance):
                self.add_scaled_motion_to_residuals(resonance, 1.0)
                if runs := self.record.find_runs(self.residuals, resonance.speed):
                    resonance.compare_orders(runs, resonance.speed, self.orders)
                self.add_scaled_motion_to_residuals(resonance, -1.0)
            resonance.compared_neighbours = resonance.list_neighbours(self.resonances)
        self._refit_neighbours_until_settled()

    def refit_resonances(self, displacements: np.ndarray) -> None:
        """Fit the resonances to changed displacements (revolutions, probes) [m].

        Resonances may be dropped, as by :meth:`_refit_or_drop`.
        """
        self.residuals = np.array(displacements)
        for resonance in self.resonances:
            self.add_scaled_motion_to_residuals(resonance, -1.0)
        for resonance in [*self.resonances]:
            self._refit_or_drop(resonance)
        self._refit_neighbours_until_settled()

    def _refit_or_drop(self, resonance: _Resonance) -> None:
        """Refit a resonance beside all others, or drop it.

        The resonance is dropped if it is no longer clear (:attr:`_Resonance.is_clear`), or may be
        the residual of a larger resonance.
        """
        self.add_scaled_motion_to_residuals(resonance, 1.0)
        is_clear = resonance.refit_and_test_clarity(self.record, self.residuals)
        if is_clear and not any(
            resonance.may_be_residual_of(other_resonance) for other_resonance in self.resonances
        ):
            self.add_scaled_motion_to_residuals(resonance, -1.0)
        else:
            self.resonances.remove(resonance)

    def _compare_orders_with_neighbour(self, resonance: _Resonance) -> bool:
        """Compare the orders of a resonance and its largest neighbour jointly.

        The neighbour is within 3.5 % in speed. Resonances within the width of either may be
        residuals of wrong orders, and are dropped.

        Returns
        -------
        bool
            False if nothing is compared: with a single candidate order, without a neighbour, or if
            this resonance is within the width of a larger one.
        """
        resonances = self.resonances
        resonance_amplitude = resonance.best_fit.largest_first_mode_amplitude
        larger_resonances = [
            neighbour
            for neighbour in resonances
            if neighbour.best_fit.largest_first_mode_amplitude > resonance_amplitude
        ]
        if len(self.orders) < 2 or any(
            neighbour.has_within_width(resonance) for neighbour in larger_resonances
        ):
            return False
        neighbours = [
            neighbour
            for neighbour in resonances
            if resonance.is_near(neighbour, RELATIVE_SPEED_HALF_WIDTH)
            and not resonance.has_within_width(neighbour)
        ]
        if not neighbours:
            return False
        resonance_pair = (
            resonance,
            max(neighbours, key=lambda neighbour: neighbour.best_fit.largest_first_mode_amplitude),
        )
        for covered_resonance in [*resonances]:
            if covered_resonance in resonance_pair or any(
                pair_member.has_within_width(covered_resonance) for pair_member in resonance_pair
            ):
                self.add_scaled_motion_to_residuals(covered_resonance, 1.0)
            if covered_resonance not in resonance_pair and any(
                pair_member.has_within_width(covered_resonance) for pair_member in resonance_pair
            ):
                resonances.remove(covered_resonance)
        resonance.compare_order_pairs_with(
            resonance_pair[1], self.record, self.residuals, self.orders
        )
        for pair_member in resonance_pair:
            self.add_scaled_motion_to_residuals(pair_member, -1.0)
            pair_member.compared_neighbours = pair_member.list_neighbours(resonances)
        return True

    def _refit_neighbours_until_settled(self) -> None:
        """Refit resonances with overlapping speeds in turn until their frequencies settle.

        Frequencies have settled with changes below 0.1 standard errors, at the latest after 5
        rounds. :meth:`_refit_or_drop` may drop a resonance.
        """
        crowded_resonances = [
            resonance for resonance in self.resonances if resonance.list_neighbours(self.resonances)
        ]
        for _ in range(MAX_SEARCH_ROUNDS):
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
    record: Record, displacements: np.ndarray, speed: float, n_rounds: int = 1
) -> tuple[float, float]:
    """Measure how well a steady vibration near a speed [rad/s] explains displacements.

    The vibration has any amplitude and phase at each probe, and the default damping ratio 0.004.

    Parameters
    ----------
    record, displacements : Record, (revolutions, probes) [m]
        Record, and the displacements to search.
    speed : float [rad/s]
        Speed of the resonance.
    n_rounds : int
        Rounds of least squares; from the second on, arrivals have the weights of Student's t.

    Returns
    -------
    gain : float
        Reduction in the sum of squares in variances of the noise, less 2 for each probe beyond the
        first. Differences between successive arrivals at a probe give the variance.
    squares_reduction : float [m^2]
        Reduction in the sum of squares.
    """
    total_gain = total_reduction = 0.0
    for run in record.find_runs(displacements, speed):
        probe_series = [
            series[has_arrival]
            for series, has_arrival in zip(run.displacements.T, run.has_arrival.T, strict=True)
        ]
        successive_differences = np.concatenate(
            [series[1:] - series[:-1] for series in probe_series]
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
            matrices, vectors, wave_parts, weighted_displacements = run.build_equations_by_probe(
                steady_wave, weights
            )
            probe_amplitudes = np.linalg.solve(
                matrices + SMALLEST_NORMAL * np.eye(2), vectors[..., None]
            )[..., 0]
            if n_rounds == 1:
                continue
            squared_ratios = (
                weighted_displacements - np.einsum("pa,arp->rp", probe_amplitudes, wave_parts)
            )[run.has_arrival] ** 2
            squared_ratios /= weights[run.has_arrival] * noise_scale**2
            weights[run.has_arrival] = (TRIAL_STUDENT_FREEDOMS[0] + 1.0) / (
                TRIAL_STUDENT_FREEDOMS[0] + squared_ratios
            )
        squares_reduction = float((vectors * probe_amplitudes).sum())
        total_gain += squares_reduction / noise_scale**2 - 2.0 * (run.n_probes - 1)
        total_reduction += squares_reduction
    return total_gain, total_reduction


class _Resonance:
    """Hold fits of several orders to the passages through a resonance.

    Parameters
    ----------
    runs : sequence of Run
        Passages.
    speed : float [rad/s]
        Speed near the resonance.
    orders : (n,)
        Candidates.

    Attributes
    ----------
    best_fit : Fit
        Fit for the most likely order.
    margins : dict of float to float
        Difference in -2 log likelihood between each order and the best; 0 for the best.
    compared_neighbours : list of _Resonance
        Neighbours at the last comparison of orders.
    """

    best_fit: Fit

    def __init__(self, runs: Sequence[Run], speed: float, orders: np.ndarray) -> None:
        self.compared_neighbours: list[_Resonance] = []
        self.compare_orders(runs, speed, orders)

    def compare_orders(self, runs: Sequence[Run], speed: float, orders: np.ndarray) -> None:
        """Fit each order to the passages near a speed [rad/s], and keep the best.

        ``orders`` (n,) are the candidates. Sets the attributes ``best_fit`` and ``margins``.
        """
        self._runs = runs
        weights_of_runs = [run.has_arrival.astype(float) for run in runs]
        fit_by_mode: dict[Mode, Fit] = {}
        # First without weights, where single wrong arrivals may hide the order; then with those of
        # the best fit, until it is the one that they make the best.
        for is_last_round in (False, False, True):
            gain_mode_pairs = _list_best_gains_and_modes(
                zip(runs, weights_of_runs, strict=True), orders, speed, INITIAL_DAMPING_RATIO
            )
            gain_mode_pairs.sort(key=lambda gain_mode_pair: -gain_mode_pair[0])
            is_last_round = is_last_round or (
                len(fit_by_mode) > 0
                and gain_mode_pairs[0][1].order == self.best_fit.first_mode.order
            )
            for gain, mode in gain_mode_pairs[: MAX_REFINED_ORDERS if is_last_round else 1]:
                if gain > MIN_RELATIVE_PEAK * gain_mode_pairs[0][0] and mode not in fit_by_mode:
                    fit_by_mode[mode] = Fit(runs, [mode], weights_of_runs)
            self.best_fit = min(fit_by_mode.values(), key=lambda fit: fit.noise.cost)
            if is_last_round:
                break
            weights_of_runs = self.best_fit.weights
        gain_by_order = {mode.order: gain for gain, mode in gain_mode_pairs}
        self.margins = _compute_margin_by_order(gain_by_order, fit_by_mode.values(), self.best_fit)

    @property
    def is_clear(self) -> bool:
        """True if the resonance is passed, significant, and neither a line nor drift.

        A run has speeds on both sides. The likelihood gain is above 60. The damping ratio is above
        three standard errors (a line has none), and below 0.00875 (drift has more).
        """
        fit = self.best_fit
        is_passed = any(
            run.revolution_speeds.min() < self.speed < run.revolution_speeds.max()
            for run in self._runs
        )
        if not (is_passed and fit.likelihood_gain > CONFIDENCE_LEVELS.min_likelihood_gain):
            return False
        return (
            CONFIDENCE_LEVELS.allowed_standard_errors * float(fit.omega_and_damping_errors[1])
            < fit.first_mode.damping_ratio
            < 0.5 * DAMPING_RATIO_BOUNDS[1]
        )

    @property
    def speed(self) -> float:
        """Rotor speed at which the order excites the natural frequency [rad/s]."""
        return self.best_fit.first_mode.speed

    def is_near(
        self,
        other_resonance: _Resonance,
        allowed_relative_distance: float = 2.0 * RELATIVE_SPEED_HALF_WIDTH,
    ) -> bool:
        """Return True if another resonance is near in speed.

        ``width`` is the maximum difference in speed relative to this resonance, by default 7 %,
        twice the half width of fitted speeds.
        """
        return (
            other_resonance is not self
            and abs(other_resonance.speed / self.speed - 1.0) < allowed_relative_distance
        )

    def list_neighbours(self, resonances: Sequence[_Resonance]) -> list[_Resonance]:
        """Return the resonances whose fitted speeds overlap with those here.

        Neighbours are other resonances within 7 % in speed.
        """
        return [resonance for resonance in resonances if self.is_near(resonance)]

    def has_within_width(self, other_resonance: _Resonance) -> bool:
        """Return True if another resonance is within this resonance's width.

        The width is twice the damping ratio, relative to the speed.
        """
        return self.is_near(other_resonance, 2.0 * self.best_fit.first_mode.damping_ratio)

    def may_be_residual_of(self, other_resonance: _Resonance) -> bool:
        """Return True if this may be the residual of a larger resonance.

        The larger resonance has the same order, and a width that includes this speed.
        """
        larger_fit, own_fit = other_resonance.best_fit, self.best_fit
        is_covered_at_order = (
            other_resonance.has_within_width(self)
            and larger_fit.first_mode.order == own_fit.first_mode.order
        )
        return (
            is_covered_at_order
            and larger_fit.largest_first_mode_amplitude > own_fit.largest_first_mode_amplitude
        )

    def refit_and_test_clarity(
        self, record: Record, displacements: np.ndarray, initial_mode: Mode | None = None
    ) -> bool:
        """Refit the mode to displacements (revolutions, probes) [m].

        The fit begins at ``initial_mode``, by default the best fit's mode. Return True if the
        resonance is clear (:attr:`is_clear`), and False if not, or if no run passes the speed.
        """
        runs = record.find_runs(displacements, self.speed)
        if not runs:
            return False
        self.best_fit = Fit(
            runs, [initial_mode or self.best_fit.first_mode], self._make_initial_weights(runs)
        )
        self._runs = runs
        return self.is_clear

    def _make_initial_weights(self, runs: Sequence[Run]) -> list[np.ndarray]:
        """Return the arrivals' weights at the start of a fit: (R, P) for each run.

        Weights of the best fit if the runs have the same arrivals, otherwise 1; 0 without an
        arrival. Runs have R revolutions and P probes.
        """
        if [run.has_arrival.tobytes() for run in runs] == [
            run.has_arrival.tobytes() for run in self._runs
        ]:
            return self.best_fit.weights
        return [run.has_arrival.astype(float) for run in runs]

    def compare_order_pairs_with(
        self, neighbour: _Resonance, record: Record, displacements: np.ndarray, orders: np.ndarray
    ) -> None:
        """Compare all pairs of orders for two neighbours, and keep the best.

        Both resonances get new fits and margins.

        Parameters
        ----------
        neighbour : _Resonance
            Resonance near in speed.
        record, displacements : Record, (revolutions, probes) [m]
            Record, and displacements with the motion of both resonances, but no further one.
        orders : (n,)
            Candidates.
        """
        resonance_pair = self, neighbour
        runs = record.find_runs(displacements, self.speed)
        weights_of_runs = [run.has_arrival.astype(float) for run in runs]
        best_fit = Fit(
            runs,
            [pair_member.best_fit.first_mode for pair_member in resonance_pair],
            weights_of_runs,
        )
        mode_lists: list[list[Mode]] = []
        for pair_member, pair_partner in (resonance_pair, resonance_pair[::-1]):
            member_displacements = displacements - pair_partner.best_fit.compute_motion(
                record, len(displacements)
            )
            run_weight_pairs = zip(
                record.find_runs(member_displacements, self.speed), best_fit.weights, strict=True
            )
            mode = pair_member.best_fit.first_mode
            gain_mode_pairs = _list_best_gains_and_modes(
                run_weight_pairs, orders, pair_member.speed, mode.damping_ratio
            )
            mode_lists.append(
                [
                    mode if grid_mode.order == mode.order else grid_mode
                    for _, grid_mode in gain_mode_pairs
                ]
            )
        fit_by_modes = {best_fit.modes: best_fit}
        for _ in range(MAX_SEARCH_ROUNDS):
            weights_of_runs, previous_fit = best_fit.weights, best_fit
            pair_gains = _compute_squares_reductions_by_pairs(runs, mode_lists, weights_of_runs)
            for index_pair in _choose_order_index_pairs(pair_gains):
                modes = mode_lists[0][index_pair[0]], mode_lists[1][index_pair[1]]
                if modes not in fit_by_modes:
                    fit_by_modes[modes] = Fit(runs, modes, weights_of_runs)
            best_fit = min(fit_by_modes.values(), key=lambda fit: fit.noise.cost)
            if best_fit is previous_fit:
                break
        for member_index, pair_member in enumerate(resonance_pair):
            max_gain_by_order = dict(
                zip(orders.tolist(), pair_gains.max(axis=1 - member_index).tolist(), strict=True)
            )
            pair_member.margins = _compute_margin_by_order(
                max_gain_by_order, fit_by_modes.values(), best_fit, member_index
            )
            member_displacements = displacements - best_fit.compute_motion(
                record, len(displacements), 1 - member_index
            )
            pair_member.refit_and_test_clarity(
                record, member_displacements, best_fit.modes[member_index]
            )

    def to_passage_fit(
        self,
        record: Record,
        residuals: np.ndarray,
        resonances: Sequence[_Resonance] = (),
        line_fits: tuple[TipFit, ...] = (),
    ) -> PassageFit:
        """Return the result, with a fit for each run through the resonance.

        Resonances within 3.5 % in speed are fitted jointly, so that errors include their
        uncertainty.

        Parameters
        ----------
        record : Record
            Arrivals, and the stiffening of modes.
        residuals : (revolutions, probes) [m]
            Displacements without the motion of ``resonances``.
        resonances : sequence of _Resonance
            All resonances of the record.
        line_fits : tuple of TipFit
            Vibrations with constant frequency, for the result.
        """
        neighbours = [
            other_resonance
            for other_resonance in resonances
            if self.is_near(other_resonance, RELATIVE_SPEED_HALF_WIDTH)
        ]
        best_fit, runs = self.best_fit, self._runs
        modes = [fitted_resonance.best_fit.first_mode for fitted_resonance in (self, *neighbours)]
        if neighbours:
            resonance_motions = [
                fitted_resonance.best_fit.compute_motion(record, len(residuals))
                for fitted_resonance in (self, *neighbours)
            ]
            runs = record.find_runs(residuals + sum(resonance_motions), self.speed)
            best_fit = Fit(runs, modes, self._make_initial_weights(runs))
        mode = best_fit.first_mode
        stiffening = record.stiffening(self.speed, best_fit.first_mode.omega)
        run_weight_pairs = list(zip(runs, best_fit.weights, strict=True))
        single_run_fits = (
            [Fit([run], best_fit.modes, [run_weights]) for run, run_weights in run_weight_pairs]
            if len(runs) > 1
            else [best_fit]
        )
        # Orders that resonate within the width of each other are claims on the same vibration.
        rival_resonances = [
            other_resonance
            for other_resonance in resonances
            if self.has_within_width(other_resonance) or other_resonance.has_within_width(self)
        ]
        margin_by_order = self.margins | {
            rival_resonance.best_fit.first_mode.order: 0.0 for rival_resonance in rival_resonances
        }
        omega_and_damping_errors = best_fit.omega_and_damping_errors
        compared_orders = np.array(sorted(margin_by_order))
        return PassageFit(
            order=mode.order,
            omega=mode.omega,
            omega_error=float(omega_and_damping_errors[0]),
            damping=(1.0 - stiffening) * mode.damping_ratio,
            damping_error=(1.0 - stiffening) * float(omega_and_damping_errors[1]),
            amplitude=best_fit.largest_first_mode_amplitude,
            forces=best_fit.forces[0],
            ends=np.array([(run.begin_revolution, run.end_revolution) for run in runs]),
            omegas=np.array([fit.first_mode.omega for fit in single_run_fits]),
            omega_errors=np.array([fit.omega_and_damping_errors[0] for fit in single_run_fits]),
            dampings=(1.0 - stiffening)
            * np.array([fit.first_mode.damping_ratio for fit in single_run_fits]),
            damping_errors=(1.0 - stiffening)
            * np.array([fit.omega_and_damping_errors[1] for fit in single_run_fits]),
            orders=compared_orders,
            margins=np.array(
                [margin_by_order[compared_order] for compared_order in compared_orders]
            ),
            probes=max(run.n_probes for run in runs),
            scatter=float(np.sqrt(best_fit.noise.variance)),
            whiteness=best_fit.whiteness_p_value,
            asynchronous=line_fits,
            blind=(),
            stiffening=stiffening,
        )


def _list_best_gains_and_modes(
    run_weight_pairs: Iterable[tuple[Run, np.ndarray]],
    orders: np.ndarray,
    speed: float,
    damping_ratio: float,
) -> list[tuple[float, Mode]]:
    """Find the best mode for each order on a grid of frequencies.

    The grid has 11 frequencies around order times speed, spaced by half the damping ratio.

    Parameters
    ----------
    run_weight_pairs : iterable of (Run, (R, P))
        Passages, and the weights of their arrivals.
    orders, speed, damping_ratio : (n,), float [rad/s], float
        Candidates, speed of the resonance, and damping ratio of all modes.

    Returns
    -------
    list of (float, Mode)
        Reduction in the weighted sum of squares [m^2], and the mode, for each order.
    """
    omega_rows = orders[:, None] * speed * (1.0 + damping_ratio * np.linspace(-2.5, 2.5, 11))
    pole_rows = compute_poles(omega_rows, damping_ratio)
    gains = sum(
        run.compute_squares_reductions(orders, pole_rows, weights)
        for run, weights in run_weight_pairs
    )
    best_pole_indices, order_indices = np.argmax(gains, axis=1), np.arange(len(orders))
    best_modes = map(Mode, orders.tolist(), pole_rows[order_indices, best_pole_indices].tolist())
    return list(
        zip(np.asarray(gains)[order_indices, best_pole_indices].tolist(), best_modes, strict=True)
    )


def _compute_squares_reductions_by_pairs(
    runs: Sequence[Run], mode_lists: Sequence[Sequence[Mode]], weights_of_runs: Sequence[np.ndarray]
) -> np.ndarray:
    """Return reductions in the sum of squares by pairs of modes: (n, m) [m^2].

    Both modes of a pair are fitted jointly. ``mode_lists`` has a list of n modes and a list of m;
    ``weights_of_runs`` has (R, P) for each run.
    """
    n_first_modes, all_modes = len(mode_lists[0]), [mode for modes in mode_lists for mode in modes]
    first_indices, second_indices = np.indices((n_first_modes, len(all_modes) - n_first_modes))
    pair_column_indices = np.stack(
        [
            2 * first_indices,
            2 * first_indices + 1,
            2 * (n_first_modes + second_indices),
            2 * (n_first_modes + second_indices) + 1,
        ],
        -1,
    )
    reduction_sums = np.zeros(first_indices.shape)
    for run, run_weights in zip(runs, weights_of_runs, strict=True):
        waves_and_displacements = np.array([*map(run.compute_wave, all_modes), run.displacements])
        *wave_parts, weighted_displacements = run.subtract_weighted_drifts(
            waves_and_displacements, run_weights
        )
        wave_parts = np.stack([np.real(wave_parts), -np.imag(wave_parts)], axis=1)[
            ..., run.has_arrival
        ]
        wave_columns = wave_parts.reshape(2 * len(all_modes), -1)
        gram_matrix = wave_columns @ wave_columns.T
        projections = wave_columns @ weighted_displacements[run.has_arrival].real
        pair_inverses = np.linalg.pinv(
            gram_matrix[pair_column_indices[..., :, None], pair_column_indices[..., None, :]],
            hermitian=True,
        )
        reduction_sums += np.einsum(
            "nmi,nmij,nmj->nm",
            projections[pair_column_indices],
            pair_inverses,
            projections[pair_column_indices],
        )
    return reduction_sums


def _choose_order_index_pairs(squares_reductions: np.ndarray) -> set[tuple[int, int]]:
    """Choose pairs of modes for refined fits: index pairs into an array (n, m).

    The best two modes of either list go with their best partner. Pairs below half the largest of
    ``squares_reductions`` (n, m) [m^2] are left out.
    """
    best_first_indices, best_second_indices = (
        np.argsort(-squares_reductions.max(axis=1 - axis))[: MAX_REFINED_ORDERS // 2]
        for axis in (0, 1)
    )
    index_pairs = [
        (first_index, squares_reductions[first_index].argmax())
        for first_index in best_first_indices
    ]
    index_pairs += [
        (squares_reductions[:, second_index].argmax(), second_index)
        for second_index in best_second_indices
    ]
    return {
        (int(n), int(m))
        for n, m in index_pairs
        if squares_reductions[n, m] > MIN_RELATIVE_PEAK * squares_reductions.max()
    }


def _compute_margin_by_order(
    gain_by_order: Mapping[float, float], fits: Iterable[Fit], best_fit: Fit, mode_index: int = 0
) -> dict[float, float]:
    """Return -2 log likelihood of each order less the best fit's.

    Parameters
    ----------
    gain_by_order : dict of float to float
        Reduction in the sum of squares [m^2] by order: an estimate for orders without a fit.
    fits : iterable of Fit
        Refined fits; the best of an order counts.
    best_fit : Fit
        Fit with the margin 0.
    mode_index : int
        Index of the mode, in the fits, whose orders are compared.
    """
    max_gain = max(gain_by_order.values())
    margin_by_order = {
        order: (max_gain - gain) / best_fit.noise.scale**2 for order, gain in gain_by_order.items()
    }
    for fit in sorted(fits, key=lambda fit: -fit.noise.cost):
        margin_by_order[fit.modes[mode_index].order] = fit.noise.cost - best_fit.noise.cost
    return margin_by_order
