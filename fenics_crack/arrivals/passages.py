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

from fenics_crack.arrivals.arrival_times import FEWEST_REVOLUTIONS, ArrivalTimes
from fenics_crack.arrivals.fit_frequency import LOWEST, find_lines
from fenics_crack.arrivals.harmonics import ORDERS, TipFit, wanted
from fenics_crack.arrivals.robust import FREEDOMS, LEVELS
from fenics_crack.arrivals.transient import (
    DAMPING_BOUNDS,
    WIDTH,
    Fit,
    Follows,
    Mode,
    Record,
    Run,
    pole,
)
from fenics_crack.basics.errors import InputError, check_count, check_number
from fenics_crack.basics.progress import begin_stage as begin_stage
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
SPEED_SPACING, INITIAL_DAMPING = 0.003, 0.004
"""Relative spacing of scanned speeds; damping ratio in the scan and at the start of fits."""
MAX_ROUNDS = 5
"""Maximum rounds: refits among neighbours, pairs of orders, weights in a search."""
MAX_STIFFENING = 0.9
"""Maximum of |d ln w_n / d ln W|: orders hardly meet frequencies with a steeper dependence."""


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
        Amplitude F of each passage in a resonance without end.
    ends : (passages, 2) int
        First revolution of each passage, and the one after the last, counted from 0.
    omegas, omega_errors : (passages,) [rad/s]
        Natural frequency and error from each passage alone.
    dampings, damping_errors : (passages,)
        Damping ratio and error from each passage alone.
    orders : (n,)
        Candidates.
    margins : (n,)
        Difference in -2 log likelihood from the best order. With a neighbour in the fitted speeds,
        each order is combined with the neighbour's best order. 0 also for the order of a rival
        resonance, nearer than the width of either: at most one of the two need be right.
    probes : int
        Number of probes with arrivals.
    scatter : float [m]
        Standard deviation of a displacement about the fit.
    whiteness : float
        Probability that errors of arrivals and shaft marks alone leave residuals as correlated.
        Standard errors include the correlation, but no bias by another vibration nearby
        (:attr:`in_doubt`).
    asynchronous : tuple of TipFit
        Vibrations of constant frequency in the record, which follow no order.
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
        """Speed at which the order meets the frequency [rad/s]."""
        return self.omega / self.order

    @property
    def margin(self) -> float:
        """Margin of the second best order; inf for a single candidate."""
        return float(np.min(self.margins[self.orders != self.order], initial=np.inf))

    @property
    def untested(self) -> bool:
        """True if several orders are candidates for fewer than three probes.

        Some order of a mode always comes near to two probes. Order and frequency are then
        conditional: a frequency follows only if the order is right.
        """
        return self.probes < 3 and len(self.orders) > 1

    @property
    def ambiguous(self) -> tuple[float, ...]:
        """Other orders that explain the arrivals within three standard deviations.

        All other orders if :attr:`untested`.
        """
        equal = ((self.margins < LEVELS.equal) | self.untested) & (self.orders != self.order)
        return tuple(self.orders[equal].tolist())

    @property
    def apart(self) -> float:
        """Relative range of the frequencies from single passages."""
        return float(np.ptp(self.omegas)) / self.omega

    @property
    def disagree(self) -> bool:
        """True if passages differ by over three errors in frequency or damping.

        Amplitudes may differ: the load need not be the same.
        """
        return bool(self.disagreement)

    @property
    def disagreement(self) -> str:
        """Describe the differences behind :attr:`disagree` in words; "" if there are none."""
        parts = []
        if _differ(self.omegas, self.omega_errors):
            parts.append(f"by {self.apart:.2%} in frequency")
        if _differ(self.dampings, self.damping_errors):
            parts.append(f"in damping, {self.dampings.min():.2g} to {self.dampings.max():.2g}")
        return f"passages differ more than errors do: {', '.join(parts)}" if parts else ""

    @property
    def in_doubt(self) -> bool:
        """True if residuals are correlated, or cannot be tested.

        ``whiteness`` is nan without a test.
        Causes are another vibration near this speed, drift, or a nonlinear blade. Frequency,
        damping and order may then be wrong by more than their errors.
        """
        return not self.whiteness >= LEVELS.misfit

    @property
    def deviation(self) -> float:
        """Stated error of the frequency: its standard deviation [rad/s].

        The largest of three: ``omega_error``; half the range of passages that disagree, as for a
        breathing crack; and for a fit in doubt half the resonance's width, zeta w_n, with damping
        ratio zeta.
        """
        half_range = 0.5 * float(np.ptp(self.omegas)) if self.disagree else 0.0
        half_width = self.damping * self.omega if self.in_doubt else 0.0
        return max(self.omega_error, half_range, half_width)

    @property
    def in_words(self) -> str:
        """Frequency with its :attr:`deviation`, engine order and speed, in words."""
        hertz = f"{self.frequency:.6g} ± {self.frequency_error:.2g} Hz"
        return f"{hertz}, engine order {self.order:g} at {self.speed / RAD_PER_S_PER_RPM:.6g} rpm"

    def compared(self, arrivals: ArrivalTimes) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Return speeds, measured and fitted displacements for each passage.

        Blind probes are left out.

        Returns
        -------
        list of (speed, measured, fitted)
            Speeds (R,) [rad/s]; displacements (R, P) [m] without drift, nan without an arrival; and
            the fitted displacements (R, P) [m], for R revolutions and P probes.
        """
        arrivals = arrivals.without(np.flatnonzero(np.isin(arrivals.probes, self.blind)))
        root = complex(pole(self.omega, self.damping / (1.0 - self.stiffening)))
        record, comparisons = Record(arrivals, _stiffening_function(self.stiffening)), []
        for (begin, end), force in zip(self.ends, self.forces, strict=True):
            run = Run(record, arrivals.displacement, int(begin), int(end))
            motion = (force * run.wave(Mode(self.order, root))).real
            residuals = run.without_drifts(run.values - motion, run.has_arrival.astype(float))
            comparisons.append(
                (run.speed, np.where(run.has_arrival, residuals + motion, np.nan), motion)
            )
        return comparisons

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers by name."""
        names = ("order", "margin", "frequency", "frequency_error", "damping", "damping_error")
        numbers = {name: getattr(self, name) for name in (*names, "stiffening", "amplitude")}
        numbers = {"speed": self.speed, "rpm": self.speed / RAD_PER_S_PER_RPM} | numbers
        statistics = {"passages": len(self.ends), "apart": self.apart, "whiteness": self.whiteness}
        return numbers | statistics

    def _title(self) -> str:
        hertz = f"{self.frequency:.6g} ± {self.frequency_error:.2g} Hz"
        damping = f"damping {self.damping:.3g} ± {self.damping_error:.2g}"
        parts = [f"order {self.order:g}, {self.speed / RAD_PER_S_PER_RPM:.6g} rpm", hertz, damping]
        parts.append(format_quantity(self.amplitude, "m"))
        if self.untested:
            parts.append(f"order untested by {format_count(self.probes, 'probe')}")
        elif self.ambiguous:
            parts.append(f"as well: {', '.join(f'{order:g}' for order in self.ambiguous)}")
        parts += ["residuals are correlated"] * self.in_doubt
        return ", ".join(parts)


def _differ(values: np.ndarray, errors: np.ndarray) -> bool:
    """Return True unless all values (n,) agree within three standard errors."""
    differences = np.abs(values[:, None] - values)
    return not np.all(differences <= LEVELS.deviations * np.hypot(errors[:, None], errors))


# --- search ---------------------------------------------------------------------------------------


def fit_passage(
    arrivals: ArrivalTimes,
    speed: float,
    orders: Iterable[float] = ORDERS,
    *,
    stiffening: float | Follows = 0.0,
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
    candidates, _ = wanted(orders, 1, 1)
    record = Record(arrivals, _stiffening_function(stiffening))
    runs = record.runs(arrivals.displacement, speed)
    if not runs:
        ends = arrivals.speed.min(), arrivals.speed.max()
        allowed_speeds = f"one that is passed in {FEWEST_REVOLUTIONS} revolutions or more, from "
        raise InputError("speed", speed, f"{allowed_speeds}{ends[0]:.6g} to {ends[1]:.6g} rad/s")
    resonance = _Resonance(runs, speed, candidates)
    if len(blind_probes := resonance.best_fit.blind_probes):
        reliable_arrivals = arrivals.without(blind_probes)
        fit = fit_passage(reliable_arrivals, speed, candidates, stiffening=stiffening)
        return replace(fit, blind=(*arrivals.probes[blind_probes].tolist(), *fit.blind))
    return resonance.to_passage_fit(record, arrivals.displacement)


def find_passages(
    arrivals: ArrivalTimes,
    orders: Iterable[float] = ORDERS,
    *,
    most: int = 8,
    asynchronous: int = 1,
    stiffening: float | Follows = 0.0,
) -> tuple[PassageFit, ...]:
    """Find the resonances in a record, about the largest first.

    Along the speed, vibrations with any phase at each probe are fitted. Where they explain most,
    :func:`fit_passage` describes the mode, and its motion is subtracted before the next search. The
    search ends when no significant resonance remains. Vibrations of constant frequency are fitted
    beside the resonances. Probes that do not measure the first resonance are left out if a majority
    agrees (``blind`` in the fit): they would add further resonances.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Arrivals in run-ups and run-downs.
    orders : iterable of float
        Candidates: periods of the load in a revolution.
    most : int
        Maximum number of resonances.
    asynchronous : int
        Maximum number of vibrations of constant frequency. Every order meets them, and they then
        look like resonances with little damping.
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
    candidates, _ = wanted(orders, 1, 1)
    check_count("most", most, 1)
    check_count("asynchronous", asynchronous, 0)
    record, values = Record(arrivals, _stiffening_function(stiffening)), arrivals.displacement
    search = _Search(record, values, candidates)
    lines: tuple[TipFit, ...] = ()
    # A line looks like a resonance everywhere, and a resonance like a line: beside the clearest of
    # them lines are found, then the others, and lines beside all of them.
    search.find_resonances(1 if asynchronous else most)
    if search.resonances and len(blind_probes := search.resonances[0].best_fit.blind_probes):
        fits = find_passages(
            arrivals.without(blind_probes), candidates, most=most, asynchronous=asynchronous,
            stiffening=stiffening,
        )  # fmt: skip
        angles = arrivals.probes[blind_probes].tolist()
        return tuple(replace(fit, blind=(*angles, *fit.blind)) for fit in fits)
    if asynchronous:
        lines, line_motion = _find_line_motion(arrivals, search.residuals, candidates, asynchronous)
        if lines:
            search = _Search(record, values - line_motion, candidates)
        search.find_resonances(most)
        if len(search.resonances) > 1:
            lines, line_motion = _find_line_motion(
                arrivals, search.residuals + line_motion, candidates, asynchronous
            )
            if lines:
                search.refit_all(values - line_motion)
    return tuple(
        resonance.to_passage_fit(record, search.residuals, search.resonances, lines)
        for resonance in search.resonances
    )


def _find_line_motion(
    arrivals: ArrivalTimes, values: np.ndarray, orders: np.ndarray, max_lines: int
) -> tuple[tuple[TipFit, ...], np.ndarray]:
    """Find vibrations of constant frequency in displacements.

    Returns
    -------
    lines : tuple of TipFit
        Vibrations, at most ``max_lines``.
    motion : (revolutions, probes) [m]
        Their displacements; nan where ``values`` are nan.
    """
    begin_stage("vibrations of constant frequency")
    constant_columns = np.arange(values.shape[1]) * np.ones(values.shape, dtype=int)
    lines, residuals = find_lines(arrivals, values, constant_columns, orders.max(), max_lines)
    return lines, values - residuals


def _stiffening_function(stiffening: float | Follows) -> Follows:
    """Return s as a function of speed and natural frequency [rad/s].

    A function is clipped to -0.9 to 0.9; a number outside raises InputError.
    """
    if callable(stiffening):

        def evaluate(speed: float, omega: float) -> float:
            slope = float(np.clip(stiffening(speed, omega), -MAX_STIFFENING, MAX_STIFFENING))
            check_number(f"stiffening({speed:.6g}, {omega:.6g})", slope)
            return slope

        return evaluate
    check_number("stiffening", stiffening)
    if abs(slope := float(stiffening)) > MAX_STIFFENING:
        raise InputError(
            "stiffening", stiffening, f"a number from -{MAX_STIFFENING} to {MAX_STIFFENING}"
        )
    return lambda speed, omega: slope


class _Search:
    """Search displacements for resonances.

    Parameters
    ----------
    record : Record
        Arrivals, and the stiffening of modes.
    values : (revolutions, probes) [m]
        Displacements in the record.
    orders : (n,)
        Candidates.

    Attributes
    ----------
    resonances : list of _Resonance
        Resonances found until now.
    residuals : (revolutions, probes) [m]
        Displacements without the motion in the resonances.
    """

    def __init__(self, record: Record, values: np.ndarray, orders: np.ndarray) -> None:
        self.record, self.residuals, self.orders = record, np.array(values), orders
        self.resonances: list[_Resonance] = []
        lowest_speed, highest_speed = record.speed.min(), record.speed.max()
        count = int(np.log(highest_speed / lowest_speed) / SPEED_SPACING)
        self._centres = lowest_speed * np.exp(SPEED_SPACING * (0.5 + np.arange(count)))
        self._gains = np.full((count, 2), np.nan)  # of :func:`_clearness`; nan: not known yet

    def add_motion(self, resonance: _Resonance, factor: float) -> None:
        """Add a resonance's motion, times a factor, to the residuals."""
        self.residuals += factor * resonance.best_fit.motion(self.record, len(self.residuals))

    def find_resonances(self, max_resonances: int) -> None:
        """Find further resonances, up to a total number."""
        centres, gains = self._centres, self._gains
        while len(self.resonances) < max_resonances:
            begin_stage("scan of the speeds")
            for centre_index in np.flatnonzero(np.isnan(gains[:, 0])):
                gains[centre_index] = _clearness(self.record, self.residuals, centres[centre_index])
            if not np.any(gains[:, 0] > LEVELS.gain):
                break
            begin_stage(f"resonance {len(self.resonances) + 1}")
            centre = centres[int(np.where(gains[:, 0] > LEVELS.gain, gains[:, 1], 0.0).argmax())]
            gains[np.abs(centres / centre - 1.0) < 1.5 * SPEED_SPACING] = 0.0
            if _clearness(self.record, self.residuals, centre, MAX_ROUNDS)[0] < LEVELS.gain:
                continue
            newcomer = _Resonance(self.record.runs(self.residuals, centre), centre, self.orders)
            if not newcomer.is_clear:
                continue
            self.resonances.append(newcomer)
            self.add_motion(newcomer, -1.0)
            self._compare_with_neighbour(newcomer)
            self._settle()
            gains[(np.abs(centres / centre - 1.0) < 2.0 * WIDTH) & (gains[:, 1] > 0.0)] = np.nan
        for resonance in [*self.resonances]:  # of all orders, beside the others
            if (
                resonance not in self.resonances
                or resonance.compared_neighbours == resonance.neighbours(self.resonances)
            ):
                continue
            if not self._compare_with_neighbour(resonance):
                self.add_motion(resonance, 1.0)
                if runs := self.record.runs(self.residuals, resonance.speed):
                    resonance.compare(runs, resonance.speed, self.orders)
                self.add_motion(resonance, -1.0)
            resonance.compared_neighbours = resonance.neighbours(self.resonances)
        self._settle()

    def refit_all(self, values: np.ndarray) -> None:
        """Fit the resonances to other displacements (revolutions, probes) [m]."""
        self.residuals = np.array(values)
        for resonance in self.resonances:
            self.add_motion(resonance, -1.0)
        for resonance in [*self.resonances]:
            self._refit_or_drop(resonance)
        self._settle()

    def _refit_or_drop(self, resonance: _Resonance) -> None:
        """Refit a resonance to displacements without the others, or drop it."""
        self.add_motion(resonance, 1.0)
        is_clear = resonance.refit(self.record, self.residuals)
        if is_clear and not any(
            resonance.may_be_residual_of(other_resonance) for other_resonance in self.resonances
        ):
            self.add_motion(resonance, -1.0)
        else:
            self.resonances.remove(resonance)

    def _compare_with_neighbour(self, resonance: _Resonance) -> bool:
        """Compare the orders of a resonance and its largest neighbour jointly.

        Resonances covered by either may be residuals of wrong orders, and are dropped. Return False
        if nothing is compared: for a single order, without a neighbour, or if a larger resonance
        covers this one.
        """
        resonances, amplitude = self.resonances, resonance.best_fit.amplitude
        larger_resonances = [
            neighbour for neighbour in resonances if neighbour.best_fit.amplitude > amplitude
        ]
        if len(self.orders) < 2 or any(
            neighbour.covers(resonance) for neighbour in larger_resonances
        ):
            return False
        neighbours = [
            neighbour
            for neighbour in resonances
            if resonance.is_near(neighbour, WIDTH) and not resonance.covers(neighbour)
        ]
        if not neighbours:
            return False
        pair = resonance, max(neighbours, key=lambda neighbour: neighbour.best_fit.amplitude)
        for rival in [*resonances]:
            if rival in pair or any(member.covers(rival) for member in pair):
                self.add_motion(rival, 1.0)
            if rival not in pair and any(member.covers(rival) for member in pair):
                resonances.remove(rival)
        resonance.compare_with(pair[1], self.record, self.residuals, self.orders)
        for member in pair:
            self.add_motion(member, -1.0)
            member.compared_neighbours = member.neighbours(resonances)
        return True

    def _settle(self) -> None:
        """Refit neighbours in turn until their frequencies settle.

        A resonance is dropped if it is then not clear, or may be a residual of a larger one.
        """
        crowd = [
            resonance for resonance in self.resonances if resonance.neighbours(self.resonances)
        ]
        for _ in range(MAX_ROUNDS):
            has_moved = False
            for resonance in sorted(crowd, key=lambda resonance: -resonance.best_fit.amplitude):
                previous_root = resonance.best_fit.mode.root
                self._refit_or_drop(resonance)
                root_change = abs(resonance.best_fit.mode.root - previous_root)
                has_moved |= resonance not in self.resonances or root_change > 0.1 * float(
                    resonance.best_fit.errors[0]
                )
            if not has_moved:
                break
            crowd = [resonance for resonance in crowd if resonance in self.resonances]


def _clearness(
    record: Record, values: np.ndarray, speed: float, rounds: int = 1
) -> tuple[float, float]:
    """Return how clearly a steady vibration near a speed reduces squares.

    The vibration has any phase at each probe. From the second round on, arrivals have the weights
    of Student's t.

    Returns
    -------
    gain : float
        Reduction in variances of the noise, less the noise explained by further phases. The noise
        follows from differences between successive arrivals at a probe.
    energy : float [m^2]
        Reduction of the sum of squares.
    """
    total = energy = 0.0
    for run in record.runs(values, speed):
        columns = [
            column[mask] for column, mask in zip(run.values.T, run.has_arrival.T, strict=True)
        ]
        changes = np.concatenate([column[1:] - column[:-1] for column in columns])
        # Median of the difference of two normal errors.
        scale = max(float(np.median(np.abs(changes))) / (np.sqrt(2.0) * ndtri(0.75)), run.rounding)
        wave = 1.0 / (INITIAL_DAMPING + 1j * (run.speed / speed - 1.0))
        wave, weights = wave[:, None] * np.ones_like(run.values), run.has_arrival.astype(float)
        for _ in range(rounds):
            matrices, vectors, parts, motion = run.phase_equations(wave, weights)
            coefficients = np.linalg.solve(
                matrices + SMALLEST_NORMAL * np.eye(2), vectors[..., None]
            )[..., 0]
            if rounds == 1:
                continue
            squares = (motion - np.einsum("pa,arp->rp", coefficients, parts))[run.has_arrival] ** 2
            squares /= weights[run.has_arrival] * scale**2
            weights[run.has_arrival] = (FREEDOMS[0] + 1.0) / (FREEDOMS[0] + squares)
        gain = float((vectors * coefficients).sum())
        total += gain / scale**2 - 2.0 * (run.probes - 1)
        energy += gain
    return total, energy


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
        Difference in -2 log likelihood between each order and the best.
    compared_neighbours : list of _Resonance
        Neighbours at the last comparison of orders.
    """

    best_fit: Fit

    def __init__(self, runs: Sequence[Run], speed: float, orders: np.ndarray) -> None:
        self.compared_neighbours: list[_Resonance] = []
        self.compare(runs, speed, orders)

    def compare(self, runs: Sequence[Run], speed: float, orders: np.ndarray) -> None:
        """Compare orders in passages near a speed [rad/s]."""
        self._runs = runs
        weights = [run.has_arrival.astype(float) for run in runs]
        fits: dict[Mode, Fit] = {}
        # First without weights, where single wrong arrivals may hide the order; then with those of
        # the best fit, until it is the one that they make the best.
        for is_last in (False, False, True):
            options = _find_best_modes(
                zip(runs, weights, strict=True), orders, speed, INITIAL_DAMPING
            )
            options.sort(key=lambda option: -option[0])
            is_last = is_last or (len(fits) > 0 and options[0][1].order == self.best_fit.mode.order)
            for gain, mode in options[: MAX_REFINED_ORDERS if is_last else 1]:
                if gain > LOWEST * options[0][0] and mode not in fits:
                    fits[mode] = Fit(runs, [mode], weights)
            self.best_fit = min(fits.values(), key=lambda fit: fit.noise.cost)
            if is_last:
                break
            weights = self.best_fit.weights
        gains = {mode.order: gain for gain, mode in options}
        self.margins = _margins(gains, fits.values(), self.best_fit)

    @property
    def is_clear(self) -> bool:
        """True if it is passed, significant, and neither a line nor drift.

        A line has no damping within three errors; drift has a damping ratio above half the bound.
        """
        fit = self.best_fit
        is_passed = any(run.speed.min() < self.speed < run.speed.max() for run in self._runs)
        if not (is_passed and fit.gain > LEVELS.gain):
            return False
        return LEVELS.deviations * float(fit.errors[1]) < fit.mode.damping < 0.5 * DAMPING_BOUNDS[1]

    @property
    def speed(self) -> float:
        """Speed at which the order meets the frequency [rad/s]."""
        return self.best_fit.mode.speed

    def is_near(self, resonance: _Resonance, width: float = 2.0 * WIDTH) -> bool:
        """Return True if another resonance is within a relative distance in speed."""
        return resonance is not self and abs(resonance.speed / self.speed - 1.0) < width

    def neighbours(self, resonances: Sequence[_Resonance]) -> list[_Resonance]:
        """Return the other resonances with overlapping fitted speeds."""
        return [resonance for resonance in resonances if self.is_near(resonance)]

    def covers(self, resonance: _Resonance) -> bool:
        """Return True if another resonance is nearer than this one's width."""
        return self.is_near(resonance, 2.0 * self.best_fit.mode.damping)

    def may_be_residual_of(self, resonance: _Resonance) -> bool:
        """Return True if a larger resonance with the same order covers this one."""
        larger_fit, own_fit = resonance.best_fit, self.best_fit
        is_near = resonance.covers(self) and larger_fit.mode.order == own_fit.mode.order
        return is_near and larger_fit.amplitude > own_fit.amplitude

    def refit(self, record: Record, values: np.ndarray, mode: Mode | None = None) -> bool:
        """Refit the mode, or a given one, to displacements (revolutions, probes) [m].

        Return True if the resonance is clear, and False if no run passes the speed.
        """
        runs = record.runs(values, self.speed)
        if not runs:
            return False
        self.best_fit = Fit(runs, [mode or self.best_fit.mode], self._weights(runs))
        self._runs = runs
        return self.is_clear

    def _weights(self, runs: Sequence[Run]) -> list[np.ndarray]:
        """Return initial weights (R, P) for runs.

        They are the best fit's weights for the same arrivals, otherwise 1.
        Runs have R revolutions and P probes; weights are 0 without an arrival.
        """
        if [run.has_arrival.tobytes() for run in runs] == [
            run.has_arrival.tobytes() for run in self._runs
        ]:
            return self.best_fit.weights
        return [run.has_arrival.astype(float) for run in runs]

    def compare_with(
        self, neighbour: _Resonance, record: Record, values: np.ndarray, orders: np.ndarray
    ) -> None:
        """Compare each pair of orders for two neighbours, and keep the best.

        Displacements ``values`` (revolutions, probes) [m] hold the motion of both.
        """
        members = self, neighbour
        runs = record.runs(values, self.speed)
        weights = [run.has_arrival.astype(float) for run in runs]
        best_fit = Fit(runs, [member.best_fit.mode for member in members], weights)
        mode_lists: list[list[Mode]] = []
        for member, partner in (members, members[::-1]):
            member_values = values - partner.best_fit.motion(record, len(values))
            parts = zip(record.runs(member_values, self.speed), best_fit.weights, strict=True)
            mode = member.best_fit.mode
            options = _find_best_modes(parts, orders, member.speed, mode.damping)
            mode_lists.append(
                [mode if grid_mode.order == mode.order else grid_mode for _, grid_mode in options]
            )
        fits = {best_fit.modes: best_fit}
        for _ in range(MAX_ROUNDS):
            weights, previous_fit = best_fit.weights, best_fit
            gains = _reductions_by_pairs(runs, mode_lists, weights)
            for index_pair in _choose_pairs(gains):
                modes = mode_lists[0][index_pair[0]], mode_lists[1][index_pair[1]]
                if modes not in fits:
                    fits[modes] = Fit(runs, modes, weights)
            best_fit = min(fits.values(), key=lambda fit: fit.noise.cost)
            if best_fit is previous_fit:
                break
        for member_index, member in enumerate(members):
            max_gains = dict(
                zip(orders.tolist(), gains.max(axis=1 - member_index).tolist(), strict=True)
            )
            member.margins = _margins(max_gains, fits.values(), best_fit, member_index)
            member_values = values - best_fit.motion(record, len(values), 1 - member_index)
            member.refit(record, member_values, best_fit.modes[member_index])

    def to_passage_fit(
        self,
        record: Record,
        residuals: np.ndarray,
        resonances: Sequence[_Resonance] = (),
        lines: tuple[TipFit, ...] = (),
    ) -> PassageFit:
        """Return the best fit in numbers, with fits of single runs.

        ``residuals`` (revolutions, probes) [m] lack the motion of all ``resonances``. Neighbours
        are fitted together, so that errors include their uncertainty.
        """
        neighbours = [resonance for resonance in resonances if self.is_near(resonance, WIDTH)]
        best_fit, runs = self.best_fit, self._runs
        modes = [resonance.best_fit.mode for resonance in (self, *neighbours)]
        if neighbours:
            motions = [
                resonance.best_fit.motion(record, len(residuals))
                for resonance in (self, *neighbours)
            ]
            runs = record.runs(residuals + sum(motions), self.speed)
            best_fit = Fit(runs, modes, self._weights(runs))
        mode, stiffening = best_fit.mode, record.stiffening(self.speed, best_fit.mode.omega)
        pairs = list(zip(runs, best_fit.weights, strict=True))
        single_fits = (
            [Fit([run], best_fit.modes, [run_weights]) for run, run_weights in pairs]
            if len(runs) > 1
            else [best_fit]
        )
        # Orders that resonate within the width of each other are claims on the same vibration.
        rivals = [
            resonance
            for resonance in resonances
            if self.covers(resonance) or resonance.covers(self)
        ]
        margins = self.margins | {resonance.best_fit.mode.order: 0.0 for resonance in rivals}
        errors, orders = best_fit.errors, np.array(sorted(margins))
        return PassageFit(
            order=mode.order,
            omega=mode.omega,
            omega_error=float(errors[0]),
            damping=(1.0 - stiffening) * mode.damping,
            damping_error=(1.0 - stiffening) * float(errors[1]),
            amplitude=best_fit.amplitude,
            forces=best_fit.forces[0],
            ends=np.array([(run.begin, run.end) for run in runs]),
            omegas=np.array([fit.mode.omega for fit in single_fits]),
            omega_errors=np.array([fit.errors[0] for fit in single_fits]),
            dampings=(1.0 - stiffening) * np.array([fit.mode.damping for fit in single_fits]),
            damping_errors=(1.0 - stiffening) * np.array([fit.errors[1] for fit in single_fits]),
            orders=orders,
            margins=np.array([margins[order] for order in orders]),
            probes=max(run.probes for run in runs),
            scatter=float(np.sqrt(best_fit.noise.variance)),
            whiteness=best_fit.whiteness,
            asynchronous=lines,
            blind=(),
            stiffening=stiffening,
        )


def _find_best_modes(
    runs: Iterable[tuple[Run, np.ndarray]], orders: np.ndarray, speed: float, damping: float
) -> list[tuple[float, Mode]]:
    """Find the best mode for each order.

    The list pairs reductions of the sum of squares [m^2] with modes.
    Frequencies are from a grid about a speed, spaced by half the damping ratio.
    """
    omegas = orders[:, None] * speed * (1.0 + damping * np.linspace(-2.5, 2.5, 11))
    roots = pole(omegas, damping)
    gains = sum(run.gains(orders, roots, weights) for run, weights in runs)
    best_columns, rows = np.argmax(gains, axis=1), np.arange(len(orders))
    modes = map(Mode, orders.tolist(), roots[rows, best_columns].tolist())
    return list(zip(np.asarray(gains)[rows, best_columns].tolist(), modes, strict=True))


def _reductions_by_pairs(
    runs: Sequence[Run], mode_lists: Sequence[Sequence[Mode]], weights: Sequence[np.ndarray]
) -> np.ndarray:
    """Return reductions of the sum of squares by mode pairs: (n, m) [m^2].

    The first list has n modes, the second m.
    """
    count, all_modes = len(mode_lists[0]), [mode for modes in mode_lists for mode in modes]
    row, column = np.indices((count, len(all_modes) - count))
    pairs = np.stack([2 * row, 2 * row + 1, 2 * (count + column), 2 * (count + column) + 1], -1)
    total = np.zeros(row.shape)
    for run, weight in zip(runs, weights, strict=True):
        waves = np.array([*map(run.wave, all_modes), run.values])
        *parts, values = run.without_drifts(waves, weight)
        parts = np.stack([np.real(parts), -np.imag(parts)], axis=1)[..., run.has_arrival]
        columns = parts.reshape(2 * len(all_modes), -1)
        matrix, projections = columns @ columns.T, columns @ values[run.has_arrival].real
        inverse = np.linalg.pinv(matrix[pairs[..., :, None], pairs[..., None, :]], hermitian=True)
        total += np.einsum("nmi,nmij,nmj->nm", projections[pairs], inverse, projections[pairs])
    return total


def _choose_pairs(gains: np.ndarray) -> set[tuple[int, int]]:
    """Choose the index pairs to refine.

    Each of the best few modes has its best partner.
    ``gains`` (n, m) [m^2] are reductions of the sum of squares.
    """
    best_rows, best_columns = (
        np.argsort(-gains.max(axis=1 - axis))[: MAX_REFINED_ORDERS // 2] for axis in (0, 1)
    )
    pairs = [(row, gains[row].argmax()) for row in best_rows]
    pairs += [(gains[:, column].argmax(), column) for column in best_columns]
    return {(int(n), int(m)) for n, m in pairs if gains[n, m] > LOWEST * gains.max()}


def _margins(
    gains: Mapping[float, float], fits: Iterable[Fit], best_fit: Fit, mode_index: int = 0
) -> dict[float, float]:
    """Return each order's -2 log likelihood less that of the best fit.

    An order without a fit has an estimate, from its reduction ``gains`` [m^2] of the sum of
    squares.
    """
    max_gain = max(gains.values())
    margins = {order: (max_gain - gain) / best_fit.noise.scale**2 for order, gain in gains.items()}
    for fit in sorted(fits, key=lambda fit: -fit.noise.cost):
        margins[fit.modes[mode_index].order] = fit.noise.cost - best_fit.noise.cost
    return margins
