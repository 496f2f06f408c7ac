"""Resonances that a rotor passes, from arrival times: frequency, damping and order of a transient.

Each is that of a mode under an engine order (:mod:`transient`). Frequency and damping are found by
least squares from the best of a grid, all passages of a resonance together; the order by
comparison. Of two neighbours, every order of one is compared with every order of the other in a fit
of both: the margin of an order is that of the best pair that has it. To two probes a vibration of
any order has one difference of phase, which some order of a mode always comes near, whatever its
margin: an order is tested by three probes or more. Errors are those of :mod:`robust`.
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
from fenics_crack.basics.progress import begin as begin_stage
from fenics_crack.basics.tables import RPM, Tabular, counted, hertz_of, quantity
from fenics_crack.numerics.equations import SMALLEST_NORMAL

REFINED = 4
"""Orders whose fits are refined; of each of two neighbours half as many."""
SPACING, TYPICAL = 0.003, 0.004
"""Relative distance of the speeds at which resonances are sought, and damping ratio there and where
the fit begins."""
TURNS = 5
"""Maximum rounds of neighbours, each fitted beside the others, and of weights in a search."""
STIFFEST = 0.9
"""Maximum of |d ln w_n / d ln W|: orders hardly meet frequencies that follow them more closely."""


@dataclass(frozen=True, repr=False)
class PassageFit(Tabular):
    """A resonance of one mode with an engine order, from all passages of it in a record.

    Attributes
    ----------
    order : float
        Periods of the load in a revolution, of the candidate that fits best.
    omega, omega_error : float [rad/s]
        Natural frequency, and its standard error by the scatter of the arrivals alone. The stated
        error is :attr:`deviation`, in Hz ``frequency_error``.
    damping, damping_error : float
        Ratio of critical damping, and its standard error. With a constant natural frequency it is
        1 / (1 - s) times as large as with one that follows the speed.
    amplitude : float [m]
        Largest amplitude in the passages.
    forces : (passages,) complex [m]
        Amplitude F of each passage in a resonance that lasts.
    ends : (passages, 2) int
        First revolution of each, and the one after its last, counted from 0.
    omegas, omega_errors : (passages,) [rad/s]
        Frequencies and errors of each passage by itself.
    dampings, damping_errors : (passages,)
        Damping ratios likewise.
    orders : (n,)
        Candidates.
    margins : (n,)
        Difference of -2 log likelihood to the best. With a neighbour within the speeds that are
        fitted, of the best order of that for each of these. 0 for the order of another resonance
        nearer than the width of one of them: at most one of the two need be right.
    probes : int
        Number of probes with arrivals.
    scatter : float [m]
        Standard deviation of a displacement about the fit.
    whiteness : float
        Probability that errors of arrivals and of the shaft's marks alone leave residuals as
        correlated. Standard errors include correlation, not the bias by another vibration nearby
        (:attr:`in_doubt`).
    asynchronous : tuple of TipFit
        Vibrations of constant frequency, which follow no order, found in the record.
    blind : tuple of float [rad]
        Angles of probes that do not measure the vibration that the others agree on; left out.
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

    frequency, frequencies = hertz_of(), hertz_of("omegas")
    frequency_error, frequency_errors = hertz_of("deviation"), hertz_of("omega_errors")

    @property
    def speed(self) -> float:
        """Speed at which the order meets the frequency [rad/s]."""
        return self.omega / self.order

    @property
    def margin(self) -> float:
        """Margin of the second best order; inf where only one was tried."""
        return float(np.min(self.margins[self.orders != self.order], initial=np.inf))

    @property
    def untested(self) -> bool:
        """True if there are fewer than three probes, to which some order of a mode always comes
        near: order and frequency are then those that follow if it is this one."""
        return self.probes < 3 and len(self.orders) > 1

    @property
    def ambiguous(self) -> tuple[float, ...]:
        """Other orders that explain the arrivals as well: within three standard deviations; all
        others where orders are :attr:`untested`."""
        equal = ((self.margins < LEVELS.equal) | self.untested) & (self.orders != self.order)
        return tuple(self.orders[equal].tolist())

    @property
    def apart(self) -> float:
        """Relative range of the frequencies of single passages."""
        return float(np.ptp(self.omegas)) / self.omega

    @property
    def disagree(self) -> bool:
        """True if frequencies or dampings of single passages differ by more than three of their
        errors. Amplitudes may: the load need not be the same."""
        return bool(self.disagreement)

    @property
    def disagreement(self) -> str:
        """Difference of single passages that :attr:`disagree`, in words; "" if they do not."""
        parts = []
        if _differ(self.omegas, self.omega_errors):
            parts.append(f"by {self.apart:.2%} in frequency")
        if _differ(self.dampings, self.damping_errors):
            parts.append(f"in damping, {self.dampings.min():.2g} to {self.dampings.max():.2g}")
        return f"passages differ more than errors do: {', '.join(parts)}" if parts else ""

    @property
    def in_doubt(self) -> bool:
        """True if residuals are correlated: another vibration near this speed, drift, or a blade
        that is no linear mode.

        Frequency, damping and order may then be wrong by more than their errors. So it is where
        nothing tests that (``whiteness`` is nan).
        """
        return not self.whiteness >= LEVELS.misfit

    @property
    def deviation(self) -> float:
        """Stated error of the frequency: its standard deviation [rad/s].

        It is ``omega_error``, at least half of the range of passages that disagree, as those of a
        breathing crack may, and half of the resonance's width, zeta w, where it is in doubt.
        """
        apart = 0.5 * float(np.ptp(self.omegas)) if self.disagree else 0.0
        beside = self.damping * self.omega if self.in_doubt else 0.0
        return max(self.omega_error, apart, beside)

    @property
    def in_words(self) -> str:
        """Frequency with its :attr:`deviation`, engine order and speed, in words."""
        hertz = f"{self.frequency:.6g} ± {self.frequency_error:.2g} Hz"
        return f"{hertz}, engine order {self.order:g} at {self.speed / RPM:.6g} rpm"

    def compared(self, arrivals: ArrivalTimes) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Return for each passage the speeds (R,) [rad/s], and the displacements (R, P) [m],
        measured without drift (nan where none was) and of the fit; without blind probes."""
        arrivals = arrivals.without(np.flatnonzero(np.isin(arrivals.probes, self.blind)))
        root = complex(pole(self.omega, self.damping / (1.0 - self.stiffening)))
        record, found = Record(arrivals, _checked(self.stiffening)), []
        for (begin, end), force in zip(self.ends, self.forces, strict=True):
            run = Run(record, arrivals.displacement, int(begin), int(end))
            motion = (force * run.wave(Mode(self.order, root))).real
            left = run.without_drifts(run.values - motion, run.has_arrival.astype(float))
            found.append((run.speed, np.where(run.has_arrival, left + motion, np.nan), motion))
        return found

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers by name."""
        names = ("order", "margin", "frequency", "frequency_error", "damping", "damping_error")
        found = {name: getattr(self, name) for name in (*names, "stiffening", "amplitude")}
        found = {"speed": self.speed, "rpm": self.speed / RPM} | found
        rest = {"passages": len(self.ends), "apart": self.apart, "whiteness": self.whiteness}
        return found | rest

    def _title(self) -> str:
        hertz = f"{self.frequency:.6g} ± {self.frequency_error:.2g} Hz"
        damping = f"damping {self.damping:.3g} ± {self.damping_error:.2g}"
        parts = [f"order {self.order:g}, {self.speed / RPM:.6g} rpm", hertz, damping]
        parts.append(quantity(self.amplitude, "m"))
        if self.untested:
            parts.append(f"order untested by {counted(self.probes, 'probe')}")
        elif self.ambiguous:
            parts.append(f"as well: {', '.join(f'{one:g}' for one in self.ambiguous)}")
        parts += ["residuals are correlated"] * self.in_doubt
        return ", ".join(parts)


def _differ(values: np.ndarray, errors: np.ndarray) -> bool:
    """True unless some values (n,) are known to differ by no more than three of their errors."""
    apart = np.abs(values[:, None] - values)
    return not np.all(apart <= LEVELS.deviations * np.hypot(errors[:, None], errors))


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
        Arrivals of run-ups and run-downs.
    speed : float [rad/s]
        Speed near the resonance, to 1 %.
    orders : iterable of float
        Candidates: periods of the load in a revolution.
    stiffening : float or function
        s = d ln w_n / d ln W, the slope of a Campbell diagram over w_n / W, from -0.9 to 0.9, or it
        as a function of W and w_n [rad/s], as :meth:`Campbell.stiffening`: with a constant
        frequency dampings are 1 / (1 - s) times the true ones.

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
    record = Record(arrivals, _checked(stiffening))
    runs = record.runs(arrivals.displacement, speed)
    if not runs:
        ends = arrivals.speed.min(), arrivals.speed.max()
        allowed = f"one that is passed in {FEWEST_REVOLUTIONS} revolutions or more, from "
        raise InputError("speed", speed, f"{allowed}{ends[0]:.6g} to {ends[1]:.6g} rad/s")
    found = _Compared(runs, speed, tried)
    if len(blind := found.best.blind_probes):
        others = arrivals.without(blind)
        fit = fit_passage(others, speed, tried, stiffening=stiffening)
        return replace(fit, blind=(*arrivals.probes[blind].tolist(), *fit.blind))
    return found.described(record, arrivals.displacement)


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
    fit of :func:`fit_passage` finds the mode, which is subtracted before the next one is sought,
    while they are significant; beside vibrations of constant frequency, if there are. Probes that
    do not measure the first one, where more others agree on it, are left out (``blind`` of the
    fit): they would add further resonances.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Arrivals of run-ups and run-downs.
    orders : iterable of float
        Candidates: periods of the load in a revolution.
    most : int
        Maximum number of resonances.
    asynchronous : int
        Maximum number of vibrations of constant frequency. They pass every order, and look like
        resonances of little damping there.
    stiffening : float or function
        As of :func:`fit_passage`; a number holds for all modes.

    Returns
    -------
    tuple of PassageFit
        Empty where none is significant.

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
    record, values = Record(arrivals, _checked(stiffening)), arrivals.displacement
    search = _Search(record, values, tried)
    lines: tuple[TipFit, ...] = ()
    # A line looks like a resonance everywhere, and a resonance like a line: beside the clearest of
    # them lines are found, then the others, and lines beside all of them.
    search.run(1 if asynchronous else most)
    if search.found and len(blind := search.found[0].best.blind_probes):
        fits = find_passages(
            arrivals.without(blind), tried, most=most, asynchronous=asynchronous,
            stiffening=stiffening,
        )  # fmt: skip
        angles = arrivals.probes[blind].tolist()
        return tuple(replace(fit, blind=(*angles, *fit.blind)) for fit in fits)
    if asynchronous:
        lines, moved = _lines(arrivals, search.left, tried, asynchronous)
        if lines:
            search = _Search(record, values - moved, tried)
        search.run(most)
        if len(search.found) > 1:
            lines, moved = _lines(arrivals, search.left + moved, tried, asynchronous)
            if lines:
                search.again(values - moved)
    return tuple(one.described(record, search.left, search.found, lines) for one in search.found)


def _lines(
    arrivals: ArrivalTimes, values: np.ndarray, orders: np.ndarray, most: int
) -> tuple[tuple[TipFit, ...], np.ndarray]:
    """Find vibrations of constant frequency in displacements, and return them and their motion."""
    begin_stage("vibrations of constant frequency")
    constants = np.arange(values.shape[1]) * np.ones(values.shape, dtype=int)
    lines, left = find_lines(arrivals, values, constants, orders.max(), most)
    return lines, values - left


def _checked(stiffening: float | Follows) -> Follows:
    """Return s as a function of speed and frequency."""
    if callable(stiffening):

        def checked(speed: float, omega: float) -> float:
            value = float(np.clip(stiffening(speed, omega), -STIFFEST, STIFFEST))
            check_number(f"stiffening({speed:.6g}, {omega:.6g})", value)
            return value

        return checked
    check_number("stiffening", stiffening)
    if abs(value := float(stiffening)) > STIFFEST:
        raise InputError("stiffening", stiffening, f"a number from -{STIFFEST} to {STIFFEST}")
    return lambda speed, omega: value


class _Search:
    """Search of resonances in displacements.

    Parameters
    ----------
    record : Record
        The record.
    values : (revolutions, probes) [m]
        Its displacements.
    orders : (n,)
        Candidates.

    Attributes
    ----------
    found : list of _Compared
        Resonances.
    left : (revolutions, probes) [m]
        Displacements without them.
    """

    def __init__(self, record: Record, values: np.ndarray, orders: np.ndarray) -> None:
        self.record, self.left, self.orders = record, np.array(values), orders
        self.found: list[_Compared] = []
        low, high = record.speed.min(), record.speed.max()
        count = int(np.log(high / low) / SPACING)
        self._centres = low * np.exp(SPACING * (0.5 + np.arange(count)))
        self._gains = np.full((count, 2), np.nan)  # of :func:`_clearness`; nan: not known yet

    def add(self, one: _Compared, factor: float) -> None:
        """Add the vibration of a resonance, times a factor, to the displacements."""
        self.left += factor * one.best.motion(self.record, len(self.left))

    def run(self, most: int) -> None:
        """Find further resonances, up to a number."""
        centres, gains = self._centres, self._gains
        while len(self.found) < most:
            begin_stage("scan of the speeds")
            for place in np.flatnonzero(np.isnan(gains[:, 0])):
                gains[place] = _clearness(self.record, self.left, centres[place])
            if not np.any(gains[:, 0] > LEVELS.gain):
                break
            begin_stage(f"resonance {len(self.found) + 1}")
            centre = centres[int(np.where(gains[:, 0] > LEVELS.gain, gains[:, 1], 0.0).argmax())]
            gains[np.abs(centres / centre - 1.0) < 1.5 * SPACING] = 0.0
            if _clearness(self.record, self.left, centre, TURNS)[0] < LEVELS.gain:
                continue
            new = _Compared(self.record.runs(self.left, centre), centre, self.orders)
            if not new.clear:
                continue
            self.found.append(new)
            self.add(new, -1.0)
            self._pair(new)
            self._settle()
            gains[(np.abs(centres / centre - 1.0) < 2.0 * WIDTH) & (gains[:, 1] > 0.0)] = np.nan
        for one in [*self.found]:  # of all orders, beside the others
            if one not in self.found or one.beside == one.neighbours(self.found):
                continue
            if not self._pair(one):
                self.add(one, 1.0)
                if runs := self.record.runs(self.left, one.speed):
                    one.compare(runs, one.speed, self.orders)
                self.add(one, -1.0)
            one.beside = one.neighbours(self.found)
        self._settle()

    def again(self, values: np.ndarray) -> None:
        """Fit the resonances to other displacements (revolutions, probes)."""
        self.left = np.array(values)
        for one in self.found:
            self.add(one, -1.0)
        for one in [*self.found]:
            self._refit(one)
        self._settle()

    def _refit(self, one: _Compared) -> None:
        """Fit a resonance to the displacements without the others, or drop it."""
        self.add(one, 1.0)
        clear = one.again(self.record, self.left)
        if clear and not any(one.within(other) for other in self.found):
            self.add(one, -1.0)
        else:
            self.found.remove(one)

    def _pair(self, one: _Compared) -> bool:
        """Compare the orders of a resonance and of its largest neighbour together; return whether
        it has one within the speeds that are fitted. Others within the width of either may be
        residuals of wrong orders, and are dropped."""
        found, size = self.found, one.best.amplitude
        larger = [other for other in found if other.best.amplitude > size]
        if len(self.orders) < 2 or any(other.covers(one) for other in larger):
            return False
        others = [other for other in found if one.near(other, WIDTH) and not one.covers(other)]
        if not others:
            return False
        pair = one, max(others, key=lambda other: other.best.amplitude)
        for each in [*found]:
            if each in pair or any(of_pair.covers(each) for of_pair in pair):
                self.add(each, 1.0)
            if each not in pair and any(of_pair.covers(each) for of_pair in pair):
                found.remove(each)
        one.pair(pair[1], self.record, self.left, self.orders)
        for each in pair:
            self.add(each, -1.0)
            each.beside = each.neighbours(found)
        return True

    def _settle(self) -> None:
        """Fit neighbours each beside the others, by turns until their frequencies settle; drop
        those that are not significant then, or one with a larger one."""
        crowd = [one for one in self.found if one.neighbours(self.found)]
        for _ in range(TURNS):
            moved = False
            for one in sorted(crowd, key=lambda one: -one.best.amplitude):
                before = one.best.mode.root
                self._refit(one)
                apart = abs(one.best.mode.root - before)
                moved |= one not in self.found or apart > 0.1 * float(one.best.errors[0])
            if not moved:
                break
            crowd = [one for one in crowd if one in self.found]


def _clearness(
    record: Record, values: np.ndarray, speed: float, turns: int = 1
) -> tuple[float, float]:
    """Return the reduction of the sum of squares near a speed by a steady vibration of any phase.

    It is fitted at each probe; the reduction is in variances of differences from one arrival at a
    probe to its next, less that of noise by further phases; and in m^2. From the second turn on
    arrivals have the weights of Student's t.
    """
    total = energy = 0.0
    for run in record.runs(values, speed):
        columns = [
            column[seen] for column, seen in zip(run.values.T, run.has_arrival.T, strict=True)
        ]
        changes = np.concatenate([column[1:] - column[:-1] for column in columns])
        # Median of the difference of two normal errors.
        scale = max(float(np.median(np.abs(changes))) / (np.sqrt(2.0) * ndtri(0.75)), run.rounding)
        wave = 1.0 / (TYPICAL + 1j * (run.speed / speed - 1.0))
        wave, weights = wave[:, None] * np.ones_like(run.values), run.has_arrival.astype(float)
        for _ in range(turns):
            square, seen, parts, left = run.phase_equations(wave, weights)
            found = np.linalg.solve(square + SMALLEST_NORMAL * np.eye(2), seen[..., None])[..., 0]
            if turns == 1:
                continue
            rest = (left - np.einsum("pa,arp->rp", found, parts))[run.has_arrival] ** 2
            rest /= weights[run.has_arrival] * scale**2
            weights[run.has_arrival] = (FREEDOMS[0] + 1.0) / (FREEDOMS[0] + rest)
        gain = float((seen * found).sum())
        total += gain / scale**2 - 2.0 * (run.probes - 1)
        energy += gain
    return total, energy


class _Compared:
    """Fits of some orders to the passages of a resonance.

    Parameters
    ----------
    runs : sequence of Run
        The passages.
    speed : float [rad/s]
        Speed near the resonance.
    orders : (n,)
        Candidates.

    Attributes
    ----------
    best : Fit
        Fit of the order that explains most.
    margins : dict of float to float
        Difference of -2 log likelihood of each order to the best.
    beside : list of _Compared
        Neighbours with which orders were compared.
    """

    best: Fit

    def __init__(self, runs: Sequence[Run], speed: float, orders: np.ndarray) -> None:
        self.beside: list[_Compared] = []
        self.compare(runs, speed, orders)

    def compare(self, runs: Sequence[Run], speed: float, orders: np.ndarray) -> None:
        """Compare orders in passages near a speed."""
        self._runs = runs
        weights = [run.has_arrival.astype(float) for run in runs]
        fits: dict[Mode, Fit] = {}
        # First without weights, where single wrong arrivals may hide the order; then with those of
        # the best fit, until it is the one that they make the best.
        for last in (False, False, True):
            tried = _begun(zip(runs, weights, strict=True), orders, speed, TYPICAL)
            tried.sort(key=lambda one: -one[0])
            last = last or (len(fits) > 0 and tried[0][1].order == self.best.mode.order)
            for gain, mode in tried[: REFINED if last else 1]:
                if gain > LOWEST * tried[0][0] and mode not in fits:
                    fits[mode] = Fit(runs, [mode], weights)
            self.best = min(fits.values(), key=lambda fit: fit.noise.cost)
            if last:
                break
            weights = self.best.weights
        gains = {mode.order: gain for gain, mode in tried}
        self.margins = _margins(gains, fits.values(), self.best)

    @property
    def clear(self) -> bool:
        """True if it is a resonance: passed, significant, and neither a line, of no damping within
        its errors, nor as wide as drift."""
        best = self.best
        passed = any(run.speed.min() < self.speed < run.speed.max() for run in self._runs)
        if not (passed and best.gain > LEVELS.gain):
            return False
        return (
            LEVELS.deviations * float(best.errors[1]) < best.mode.damping < 0.5 * DAMPING_BOUNDS[1]
        )

    @property
    def speed(self) -> float:
        """Speed at which the order meets the frequency [rad/s]."""
        return self.best.mode.speed

    def near(self, other: _Compared, width: float = 2.0 * WIDTH) -> bool:
        """Return True if another one is within the speeds that are fitted."""
        return other is not self and abs(other.speed / self.speed - 1.0) < width

    def neighbours(self, found: Sequence[_Compared]) -> list[_Compared]:
        """Return the others within the speeds that are fitted."""
        return [other for other in found if self.near(other)]

    def covers(self, other: _Compared) -> bool:
        """Return True if another one is nearer than its width."""
        return self.near(other, 2.0 * self.best.mode.damping)

    def within(self, other: _Compared) -> bool:
        """Return True if it may be the residual of a larger one: of its order, nearer than its
        width."""
        larger, own = other.best, self.best
        near = other.covers(self) and larger.mode.order == own.mode.order
        return near and larger.amplitude > own.amplitude

    def again(self, record: Record, values: np.ndarray, mode: Mode | None = None) -> bool:
        """Fit it, or a mode near it, to other displacements (revolutions, probes); return True if
        it is clear."""
        runs = record.runs(values, self.speed)
        if not runs:
            return False
        self.best = Fit(runs, [mode or self.best.mode], self._weights(runs))
        self._runs = runs
        return self.clear

    def _weights(self, runs: Sequence[Run]) -> list[np.ndarray]:
        """Return weights (R, P) to begin a fit to runs: those of the best fit, if these are its
        arrivals."""
        if [one.has_arrival.tobytes() for one in runs] == [
            one.has_arrival.tobytes() for one in self._runs
        ]:
            return self.best.weights
        return [run.has_arrival.astype(float) for run in runs]

    def pair(
        self, other: _Compared, record: Record, values: np.ndarray, orders: np.ndarray
    ) -> None:
        """Compare all orders of two neighbours, every one of each with every one of the other, in
        displacements (revolutions, probes) that hold both; take the best pair."""
        both = self, other
        runs = record.runs(values, self.speed)
        weights = [run.has_arrival.astype(float) for run in runs]
        best = Fit(runs, [one.best.mode for one in both], weights)
        begun: list[list[Mode]] = []
        for one, beside in (both, both[::-1]):
            alone = values - beside.best.motion(record, len(values))
            parts = zip(record.runs(alone, self.speed), best.weights, strict=True)
            mode = one.best.mode
            tried = _begun(parts, orders, one.speed, mode.damping)
            begun.append([mode if other.order == mode.order else other for _, other in tried])
        fits = {best.modes: best}
        for _ in range(TURNS):
            weights, before = best.weights, best
            gains = _reduction_by_pairs(runs, begun, weights)
            for pair in _highest(gains):
                modes = begun[0][pair[0]], begun[1][pair[1]]
                if modes not in fits:
                    fits[modes] = Fit(runs, modes, weights)
            best = min(fits.values(), key=lambda fit: fit.noise.cost)
            if best is before:
                break
        for place, one in enumerate(both):
            most = dict(zip(orders.tolist(), gains.max(axis=1 - place).tolist(), strict=True))
            one.margins = _margins(most, fits.values(), best, place)
            alone = values - best.motion(record, len(values), 1 - place)
            one.again(record, alone, best.modes[place])

    def described(
        self,
        record: Record,
        left: np.ndarray,
        found: Sequence[_Compared] = (),
        lines: tuple[TipFit, ...] = (),
    ) -> PassageFit:
        """Return the best fit in numbers, with those of single runs, to residuals of all that are
        found (revolutions, probes): together with neighbours, whose errors are in its own."""
        beside = [other for other in found if self.near(other, WIDTH)]
        best, runs, modes = self.best, self._runs, [one.best.mode for one in (self, *beside)]
        if beside:
            motions = [one.best.motion(record, len(left)) for one in (self, *beside)]
            runs = record.runs(left + sum(motions), self.speed)
            best = Fit(runs, modes, self._weights(runs))
        mode, stiffening = best.mode, record.stiffening(self.speed, best.mode.omega)
        pairs = list(zip(runs, best.weights, strict=True))
        alone = [Fit([run], best.modes, [own]) for run, own in pairs] if len(runs) > 1 else [best]
        # Orders that resonate within the width of each other are claims on the same vibration.
        rivals = [one for one in found if self.covers(one) or one.covers(self)]
        margins = self.margins | {one.best.mode.order: 0.0 for one in rivals}
        errors, orders = best.errors, np.array(sorted(margins))
        return PassageFit(
            order=mode.order,
            omega=mode.omega,
            omega_error=float(errors[0]),
            damping=(1.0 - stiffening) * mode.damping,
            damping_error=(1.0 - stiffening) * float(errors[1]),
            amplitude=best.amplitude,
            forces=best.forces[0],
            ends=np.array([(run.begin, run.end) for run in runs]),
            omegas=np.array([fit.mode.omega for fit in alone]),
            omega_errors=np.array([fit.errors[0] for fit in alone]),
            dampings=(1.0 - stiffening) * np.array([fit.mode.damping for fit in alone]),
            damping_errors=(1.0 - stiffening) * np.array([fit.errors[1] for fit in alone]),
            orders=orders,
            margins=np.array([margins[order] for order in orders]),
            probes=max(run.probes for run in runs),
            scatter=float(np.sqrt(best.noise.variance)),
            whiteness=best.whiteness,
            asynchronous=lines,
            blind=(),
            stiffening=stiffening,
        )


def _begun(
    runs: Iterable[tuple[Run, np.ndarray]], orders: np.ndarray, speed: float, damping: float
) -> list[tuple[float, Mode]]:
    """Return the mode of each order near a speed that reduces the sum of squares most, of runs with
    their weights, on a grid of frequencies half a width apart, with this reduction."""
    omegas = orders[:, None] * speed * (1.0 + damping * np.linspace(-2.5, 2.5, 11))
    roots = pole(omegas, damping)
    gains = sum(run.gains(orders, roots, weights) for run, weights in runs)
    best, rows = np.argmax(gains, axis=1), np.arange(len(orders))
    modes = map(Mode, orders.tolist(), roots[rows, best].tolist())
    return list(zip(np.asarray(gains)[rows, best].tolist(), modes, strict=True))


def _reduction_by_pairs(
    runs: Sequence[Run], begun: Sequence[Sequence[Mode]], weights: Sequence[np.ndarray]
) -> np.ndarray:
    """Return the reduction of the sum of squares by each pair of a mode of the first list with one
    of the second: (n, m) [m^2]."""
    count, every = len(begun[0]), [mode for modes in begun for mode in modes]
    first, second = np.indices((count, len(every) - count))
    pairs = np.stack([2 * first, 2 * first + 1, 2 * (count + second), 2 * (count + second) + 1], -1)
    total = np.zeros(first.shape)
    for run, weight in zip(runs, weights, strict=True):
        waves = np.array([*map(run.wave, every), run.values])
        *parts, values = run.without_drifts(waves, weight)
        parts = np.stack([np.real(parts), -np.imag(parts)], axis=1)[..., run.has_arrival]
        columns = parts.reshape(2 * len(every), -1)
        square, seen = columns @ columns.T, columns @ values[run.has_arrival].real
        inverse = np.linalg.pinv(square[pairs[..., :, None], pairs[..., None, :]], hermitian=True)
        total += np.einsum("nmi,nmij,nmj->nm", seen[pairs], inverse, seen[pairs])
    return total


def _highest(gains: np.ndarray) -> set[tuple[int, int]]:
    """Return pairs (n, m) that are refined: the best with each of the first orders, and of the
    second."""
    rows, columns = (np.argsort(-gains.max(axis=1 - axis))[: REFINED // 2] for axis in (0, 1))
    pairs = [(row, gains[row].argmax()) for row in rows]
    pairs += [(gains[:, column].argmax(), column) for column in columns]
    return {(int(n), int(m)) for n, m in pairs if gains[n, m] > LOWEST * gains.max()}


def _margins(
    gains: Mapping[float, float], fits: Iterable[Fit], best: Fit, place: int = 0
) -> dict[float, float]:
    """Return the difference of -2 log likelihood of each order of the mode in a place to the best:
    of fits, or by the reduction of the sum of squares."""
    most = max(gains.values())
    margins = {order: (most - gain) / best.noise.scale**2 for order, gain in gains.items()}
    for fit in sorted(fits, key=lambda fit: -fit.noise.cost):
        margins[fit.modes[place].order] = fit.noise.cost - best.noise.cost
    return margins
