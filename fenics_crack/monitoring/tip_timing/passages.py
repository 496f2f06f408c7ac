"""Resonances that a rotor passes, from arrival times: frequency, damping and order of a transient.

Each is that of a mode under an engine order (:mod:`transient`). Frequency and damping are found by
Gauss-Newton from the best of a grid, all passages of a resonance together; the order by comparison.
Of two neighbours, every order of one is compared with every order of the other beside it: the
margin of an order is by how much the best pair that has it fits worse. To two probes a vibration of
any order has one difference of phase, which some order of a mode always comes near, whatever its
margin: an order is tested by three probes or more. Errors are those of :mod:`robust`.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fenics_crack.basics.errors import InputError, check_count, check_number
from fenics_crack.basics.progress import begin as begin_stage
from fenics_crack.basics.tables import RPM, TURN, Tabular, counted, quantity
from fenics_crack.monitoring.tip_timing.arrival_times import FEWEST_REVOLUTIONS, ArrivalTimes
from fenics_crack.monitoring.tip_timing.fit_frequency import LOWEST, find_lines
from fenics_crack.monitoring.tip_timing.harmonics import AS_GOOD, MISFIT, ORDERS, TipFit, wanted
from fenics_crack.monitoring.tip_timing.robust import EPSILON, FREEDOMS, SEEN
from fenics_crack.monitoring.tip_timing.transient import (
    DAMPED,
    TINY,
    WIDTH,
    Fit,
    Follows,
    Mode,
    Record,
    Run,
    pole,
)

SHIFTS = np.linspace(-0.01, 0.01, 11)
"""Relative shifts of the frequency with which the fit begins, by :data:`TYPICAL` damping."""
REFINED = 4
"""Orders whose fits are refined; of each of two neighbours half as many."""
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
TESTING = 3
"""Probes that test an order: they see two differences of phase, which have to fit one."""


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
    dampings, damping_errors : (passages,)
        Damping ratios likewise.
    steady_omegas : (passages,) [rad/s]
        What a fit of steady vibrations finds in each: too high in a run-up, too low in a run-down.
    orders : (n,)
        Candidates.
    margins : (n,)
        By how much each fits worse than the best: difference of -2 log likelihood. Beside a
        neighbour within the speeds that are fitted, of the best order of that for each of these.
    probes : int
        How many see it.
    scatter : float [m]
        Standard deviation of a displacement about the fit.
    whiteness : float
        Probability that errors of arrivals and of the shaft's marks, none of which is like the
        next one, leave what is left. The standard errors hold with the correlation that is seen,
        not with what a vibration beside it shifts (:attr:`in_doubt`).
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
    dampings: np.ndarray
    damping_errors: np.ndarray
    steady_omegas: np.ndarray
    orders: np.ndarray
    margins: np.ndarray
    probes: int
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
    def untested(self) -> bool:
        """Tell whether fewer than three probes see it, to which some order of a mode always comes
        near: order and frequency are then those that follow if it is this one."""
        return self.probes < TESTING and len(self.orders) > 1

    @property
    def ambiguous(self) -> tuple[float, ...]:
        """Other orders that explain the arrivals as well: within three standard deviations; all
        others where orders are :attr:`untested`."""
        alike = ((self.margins < AS_GOOD) | self.untested) & (self.orders != self.order)
        return tuple(self.orders[alike].tolist())

    @property
    def apart(self) -> float:
        """Relative difference of the passages' own frequencies, the largest from the least."""
        return float(np.ptp(self.omegas)) / self.omega

    @property
    def disagree(self) -> bool:
        """Tell whether frequencies or dampings of passages by themselves differ by more than three
        of their errors. Amplitudes may: the load need not be the same."""
        return bool(self.disagreement)

    @property
    def disagreement(self) -> str:
        """By what passages by themselves :attr:`disagree`, in words; "" if they do not."""
        parts = []
        if _differ(self.omegas, self.omega_errors):
            parts.append(f"by {self.apart:.2%} in frequency")
        if _differ(self.dampings, self.damping_errors):
            parts.append(f"in damping, {self.dampings.min():.2g} to {self.dampings.max():.2g}")
        return f"passages differ more than errors do: {', '.join(parts)}" if parts else ""

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
        root = np.array([pole(self.omega, self.damping / (1.0 - self.stiffening))])
        record, found = Record(arrivals, _checked(self.stiffening)), []
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
        if self.untested:
            parts.append(f"order untested by {counted(self.probes, 'probe')}")
        elif self.ambiguous:
            parts.append(f"as well: {', '.join(f'{one:g}' for one in self.ambiguous)}")
        parts += ["something is beside it"] * self.in_doubt
        return ", ".join(parts)


def _differ(values: np.ndarray, errors: np.ndarray) -> bool:
    """True if two of some values (n,) differ by more than three of their errors."""
    apart = np.abs(values[:, None] - values)
    return bool(np.any(apart > 3.0 * np.hypot(errors[:, None], errors)))


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
    record = Record(arrivals, _checked(stiffening))
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
    record, values = Record(arrivals, _checked(stiffening)), arrivals.displacement
    constants = np.arange(values.shape[1]) * np.ones(values.shape, dtype=int)
    found: list[_Compared] = []
    lines: tuple[TipFit, ...] = ()
    steady = np.zeros_like(values)
    # A line looks like a resonance everywhere, and a resonance like a line: beside the clearest of
    # them lines are found, then the others, by turns until they are the same.
    for turn in range(PASSAGE_ROUNDS):
        before = [(one.best.mode.order, one.speed) for one in found]
        if turn < 2:
            few = 1 if asynchronous and not turn else most
            if lines or not turn:  # without lines it goes on
                found, left = [], values - steady
                centres = _centres(record)
                gains = np.full((len(centres), 2), np.nan)
            _search(record, left, tried, few, found, centres, gains)
        else:
            left = _again(record, values - steady, found)
        if found and not turn and len(blind := found[0].best.blind):
            fits = find_passages(
                arrivals.without(blind), tried, most=most, asynchronous=asynchronous,
                stiffening=stiffening,
            )  # fmt: skip
            angles = arrivals.probes[blind].tolist()
            return tuple(replace(fit, blind=(*angles, *fit.blind)) for fit in fits)
        if not asynchronous or turn > 1 or (turn and _alike(found, before)):
            break
        begin_stage("vibrations of constant frequency")
        lines, rest = find_lines(arrivals, left + steady, constants, tried.max(), most=asynchronous)
        steady += left - rest
        if turn and not lines:
            break
    return tuple(one.described(record, left, found, lines) for one in found)


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


def _centres(record: Record) -> np.ndarray:
    """Speeds [rad/s] about which resonances are sought."""
    low, high = record.speed.min(), record.speed.max()
    return low * np.exp(SPACING * (0.5 + np.arange(int(np.log(high / low) / SPACING))))


def _search(
    record: Record,
    left: np.ndarray,
    orders: np.ndarray,
    most: int,
    found: list[_Compared],
    centres: np.ndarray,
    gains: np.ndarray,
) -> None:
    """Find resonances beyond those found in displacements (revolutions, probes), and leave what
    they leave of them; gains (n, 2) are what :func:`_clearness` tells at the centres (n,), nan
    where that is not known yet."""
    while len(found) < most:
        begin_stage("scan of the speeds")
        for place in np.flatnonzero(np.isnan(gains[:, 0])):
            gains[place] = _clearness(record, left, centres[place])
        if not np.any(gains[:, 0] > CLEAR):
            break
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
        _pair(record, left, found, new, orders)
        _settle(record, left, found)
        gains[(np.abs(centres / centre - 1.0) < 2.0 * WIDTH) & (gains[:, 1] > 0.0)] = np.nan
    for one in [*found]:  # of all orders, beside the others
        if one not in found or one.beside == one.neighbours(found):
            continue
        if not _pair(record, left, found, one, orders):
            one.add(record, left, 1.0)
            if runs := record.runs(left, one.speed):
                one.compare(runs, one.speed, orders)
            one.add(record, left, -1.0)
        one.beside = one.neighbours(found)
    _settle(record, left, found)


def _pair(
    record: Record, left: np.ndarray, found: list[_Compared], one: _Compared, orders: np.ndarray
) -> bool:
    """Compare the orders of a resonance and of its largest neighbour together; return whether it
    has one as near as the speeds that are fitted. Others within the width of either may be what
    wrong orders have left, and are taken out."""
    size = one.best.amplitude
    if len(orders) < 2 or any(other.covers(one) and other.best.amplitude > size for other in found):
        return False
    others = [other for other in found if one.near(other, WIDTH) and not one.covers(other)]
    if not others:
        return False
    pair = one, max(others, key=lambda other: other.best.amplitude)
    for each in [*found]:
        if each in pair:
            each.add(record, left, 1.0)
        elif any(of_pair.covers(each) for of_pair in pair):
            each.add(record, left, 1.0)
            found.remove(each)
    one.pair(pair[1], record, left, orders)
    for each in pair:
        each.add(record, left, -1.0)
        each.beside = each.neighbours(found)
    return True


def _settle(record: Record, left: np.ndarray, found: list[_Compared]) -> None:
    """Fit neighbours each beside the others, by turns until their frequencies settle; those that
    are no more then, or one with a larger one, are taken out."""
    crowd = [one for one in found if any(one.near(other) for other in found)]
    for _ in range(PASSAGE_TURNS):
        moved = False
        for one in sorted(crowd, key=lambda one: -one.best.amplitude):
            before = one.best.mode.root
            one.add(record, left, 1.0)
            if not one.again(record, left) or any(one.within(other) for other in found):
                found.remove(one)
                crowd.remove(one)
                moved = True
                continue
            one.add(record, left, -1.0)
            moved |= abs(one.best.mode.root - before) > PASSAGE_SETTLED * float(one.best.errors[0])
        if not moved:
            break


def _again(record: Record, values: np.ndarray, found: list[_Compared]) -> np.ndarray:
    """Fit resonances to other displacements (revolutions, probes), and return what they leave."""
    left = np.array(values)
    for one in found:
        one.add(record, left, -1.0)
    for one in [*found]:
        one.add(record, left, 1.0)
        if one.again(record, left):
            one.add(record, left, -1.0)
        else:
            found.remove(one)
    _settle(record, left, found)
    return left


def _alike(found: Sequence[_Compared], before: Sequence[tuple[float, float]]) -> bool:
    """Tell whether a search has found the resonances of these orders and speeds."""
    places = sorted((one.best.mode.order, one.speed) for one in found)
    pairs = itertools.zip_longest(places, sorted(before), fillvalue=(0.0, 0.0))
    return all(np.allclose(one, other, rtol=SPACING) for one, other in pairs)


def _clearness(
    record: Record, values: np.ndarray, speed: float, turns: int = 1
) -> tuple[float, float]:
    """What a steady vibration of any phase at each probe takes off the sum of squares near a speed,
    in units of the variance of differences from one arrival at a probe to its next, less what the
    further phases take off noise; and in m^2. From the second turn on with the weights that
    arrivals have in Student's t by what is left of them."""
    total = energy = 0.0
    for run in record.runs(values, speed):
        columns = [column[seen] for column, seen in zip(run.values.T, run.seen.T, strict=True)]
        changes = np.concatenate([column[1:] - column[:-1] for column in columns])
        scale = max(float(np.median(np.abs(changes))) / MEDIAN, run.least)
        wave = 1.0 / (TYPICAL + 1j * (run.speed / speed - 1.0))
        given = np.empty((3, *run.values.shape))
        given[0], given[1], given[2] = wave.real[:, None], wave.imag[:, None], run.values
        weights = run.seen.astype(float)
        for _ in range(turns):
            first, second, left = run.without_drifts(given, weights)
            one, both, other = (first**2).sum(0), (first * second).sum(0), (second**2).sum(0)
            seen, also = (first * left).sum(0), (second * left).sum(0)
            size = np.maximum(one * other - both**2, EPSILON * one * other + TINY)
            found, beside = other * seen - both * also, one * also - both * seen
            found, beside = found / size, beside / size
            gain = float((seen * found + also * beside).sum())
            if turns > 1:
                square = (left - first * found - second * beside)[run.seen] ** 2
                square /= weights[run.seen]
                weights[run.seen] = (FREEDOMS[0] + 1.0) / (FREEDOMS[0] + square / scale**2)
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
        About where the resonance is.
    orders : (n,)
        Candidates.

    Attributes
    ----------
    best : Fit
        The order that explains most.
    margins : dict of float to float
        By how much each order fits worse, in -2 log likelihood.
    beside : list of _Compared
        Neighbours beside which orders were compared.
    """

    best: Fit
    margins: dict[float, float]

    def __init__(self, runs: Sequence[Run], speed: float, orders: np.ndarray) -> None:
        self.beside: list[_Compared] = []
        self.compare(runs, speed, orders)

    def compare(self, runs: Sequence[Run], speed: float, orders: np.ndarray) -> None:
        """Compare orders in passages near a speed."""
        self._runs, self.margins = runs, {}
        weights = [run.seen.astype(float) for run in runs]
        fits: dict[Mode, Fit] = {}
        # First without weights, where single wrong arrivals may hide the order; then with those of
        # the best fit, until it is the one that they make the best.
        for last in (False, False, True):
            tried = _begun(runs, weights, orders, speed, TYPICAL)
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
        """Whether it is a resonance: it is passed, no chance, and neither a line, of no damping
        within its errors, nor as wide as drift."""
        best = self.best
        passed = any(run.speed.min() < self.speed < run.speed.max() for run in self._runs)
        if not (passed and best.gain > CLEAR):
            return False
        return SEEN * float(best.errors[1]) < best.mode.damping < 0.5 * DAMPED[1]

    @property
    def speed(self) -> float:
        """At which the order meets the frequency [rad/s]."""
        return self.best.mode.speed

    def near(self, other: _Compared, width: float = 2.0 * WIDTH) -> bool:
        """Whether another one is in the speeds that are fitted."""
        return other is not self and abs(other.speed / self.speed - 1.0) < width

    def neighbours(self, found: Sequence[_Compared]) -> list[_Compared]:
        """Those of others that are in the speeds that are fitted."""
        return [other for other in found if self.near(other)]

    def covers(self, other: _Compared) -> bool:
        """Whether another one is nearer than its width."""
        return self.near(other, 2.0 * self.best.mode.damping)

    def within(self, other: _Compared) -> bool:
        """Whether it is no more than what is left of a larger one: of its order, nearer than its
        width."""
        larger, root = other.best, other.best.mode.root
        near = abs(root.imag - self.best.mode.root.imag) < 2.0 * abs(root.real)
        alike = larger.mode.order == self.best.mode.order
        return near and alike and larger.amplitude > self.best.amplitude

    def again(self, record: Record, values: np.ndarray, mode: Mode | None = None) -> bool:
        """Fit it, or a mode near it, to other displacements (revolutions, probes), and tell whether
        it is clear."""
        runs = record.runs(values, self.speed)
        if not runs:
            return False
        self.best = Fit(runs, [mode or self.best.mode], self._weights(runs))
        self._runs = runs
        return self.clear

    def _weights(self, runs: Sequence[Run]) -> list[np.ndarray]:
        """Weights (R, P) of arrivals that a fit to runs begins with: those of the best fit, if
        these are its arrivals."""
        if [one.seen.tobytes() for one in runs] == [one.seen.tobytes() for one in self._runs]:
            return self.best.weights
        return [run.seen.astype(float) for run in runs]

    def add(self, record: Record, values: np.ndarray, factor: float) -> None:
        """Add the vibration, times a factor, to displacements (revolutions, probes)."""
        values += factor * self.best.motion(record, len(values))

    def pair(
        self, other: _Compared, record: Record, values: np.ndarray, orders: np.ndarray
    ) -> None:
        """Compare all orders of two neighbours, every one of each with every one of the other, in
        displacements (revolutions, probes) that hold both; take the best pair."""
        both = self, other
        runs = record.runs(values, self.speed)
        weights = [run.seen.astype(float) for run in runs]
        best = Fit(runs, [one.best.mode for one in both], weights)
        begun: list[list[Mode]] = []
        for one, beside in (both, both[::-1]):
            alone = np.array(values)
            beside.add(record, alone, -1.0)
            parts, mode = record.runs(alone, self.speed), one.best.mode
            tried = _begun(parts, best.weights, orders, one.speed, mode.damping)
            begun.append([mode if other.order == mode.order else other for _, other in tried])
        fits = {best.modes: best}
        for _ in range(PASSAGE_ROUNDS):
            weights, before = best.weights, best
            gains = _together(runs, begun, weights)
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
            one.again(
                record, values - best.motion(record, len(values), 1 - place), best.modes[place]
            )

    def described(
        self,
        record: Record,
        left: np.ndarray,
        found: Sequence[_Compared] = (),
        lines: tuple[TipFit, ...] = (),
    ) -> PassageFit:
        """The best fit in numbers, beside those of each run by itself, of what all that are found
        leave (revolutions, probes): together with neighbours, whose errors are in its own."""
        beside = [other for other in found if self.near(other, WIDTH)]
        best, runs, modes = self.best, self._runs, [one.best.mode for one in (self, *beside)]
        if beside:
            values = np.array(left)
            for one in (self, *beside):
                one.add(record, values, 1.0)
            runs = record.runs(values, self.speed)
            best = Fit(runs, modes, self._weights(runs))
        mode, stiffening = best.mode, record.stiffening(self.speed, best.mode.omega)
        pairs = list(zip(runs, best.weights, strict=True))
        alone = [Fit([run], best.modes, [own]) for run, own in pairs] if len(runs) > 1 else [best]
        each = zip(self._runs, self.best.weights, strict=True)
        steady = [Fit([run], [mode], [own], steady=True) for run, own in each]
        errors, orders = best.errors, np.array(sorted(self.margins))
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
            steady_omegas=np.array([fit.mode.omega for fit in steady]),
            orders=orders,
            margins=np.array([self.margins[order] for order in orders]),
            probes=max(run.probes for run in runs),
            scatter=float(np.sqrt(best.noise.variance)),
            whiteness=best.whiteness,
            asynchronous=lines,
            stiffening=stiffening,
        )


def _begun(
    runs: Sequence[Run],
    weights: Sequence[np.ndarray],
    orders: np.ndarray,
    speed: float,
    damping: float,
) -> list[tuple[float, Mode]]:
    """What a mode of each order near a speed takes off the sum of squares at most, over a grid of
    frequencies as fine as its width, and this mode."""
    omegas = orders[:, None] * speed * (1.0 + SHIFTS * damping / TYPICAL)
    roots = pole(omegas, damping)
    gains = sum(run.gains(orders, roots, own) for run, own in zip(runs, weights, strict=True))
    best, rows = np.argmax(gains, axis=1), np.arange(len(orders))
    modes = map(Mode, orders.tolist(), roots[rows, best].tolist())
    return list(zip(np.asarray(gains)[rows, best].tolist(), modes, strict=True))


def _together(
    runs: Sequence[Run], begun: Sequence[Sequence[Mode]], weights: Sequence[np.ndarray]
) -> np.ndarray:
    """What each pair of a mode of the first list with one of the second takes off the sum of
    squares: (n, m) [m^2]."""
    count, every = len(begun[0]), [mode for modes in begun for mode in modes]
    first, second = np.indices((count, len(every) - count))
    pairs = np.stack([2 * first, 2 * first + 1, 2 * (count + second), 2 * (count + second) + 1], -1)
    total = np.zeros(first.shape)
    for run, weight in zip(runs, weights, strict=True):
        waves = [run.waves(mode.order, np.array([mode.root]))[0] for mode in every]
        *parts, values = run.without_drifts(np.array([*waves, run.values]), weight)
        parts = np.stack([np.real(parts), -np.imag(parts)], axis=1)[..., run.seen]
        columns = parts.reshape(2 * len(every), -1)
        square, seen = columns @ columns.T, columns @ values[run.seen].real
        inverse = np.linalg.pinv(square[pairs[..., :, None], pairs[..., None, :]], hermitian=True)
        total += np.einsum("nmi,nmij,nmj->nm", seen[pairs], inverse, seen[pairs])
    return total


def _highest(gains: np.ndarray) -> set[tuple[int, int]]:
    """Pairs (n, m) that are refined: the best with each of the first orders, and of the second."""
    found = set()
    for table, turned in ((gains, False), (gains.T, True)):
        for place in np.argsort(-table.max(axis=1))[: REFINED // 2].tolist():
            other = int(table[place].argmax())
            if table[place, other] > LOWEST * gains.max():
                found.add((other, place) if turned else (place, other))
    return found


def _margins(
    gains: Mapping[float, float], fits: Iterable[Fit], best: Fit, place: int = 0
) -> dict[float, float]:
    """By how much each order of the mode in a place fits worse than the best: of fits, or by what
    it takes off the sum of squares."""
    most = max(gains.values())
    found = {order: (most - gain) / best.noise.scale**2 for order, gain in gains.items()}
    for fit in sorted(fits, key=lambda fit: -fit.noise.cost):
        found[fit.modes[place].order] = fit.noise.cost - best.noise.cost
    return found
