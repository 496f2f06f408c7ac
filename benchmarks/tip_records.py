"""Generated tip-timing records with the errors of a laboratory, and what the fits find in them.

Every record has jitter of arrivals and marks, a speed that varies by 0.5 %, probes off by 0.01
degree (standard deviation), 20 % of the passages missing, 1 % of them wrong by 1 to 10 mm (10 % in
the last rows), and an asynchronous vibration of 200 micrometres at a frequency that follows no
order. Radius 0.4 m.

steady: 200 revolutions at 6000 rpm, 1 mm at one of the engine orders 2 to 12; a sine, or the wave
of a breathing crack with four harmonics (1, 0.3, 0.06, 0.015 mm), of which some are fitted. The
order is sought among 1 to 24 (`fit_order`); intervals are those of the fit with the order known.

passages: a run-up and a run-down through the resonance of one mass, engine order 2 to 10, damping
0.001 to 0.004, 300 revolutions each for 12 % of the speed, and a drift over the speed of its own at
each probe. Order, frequency and damping are sought by `find_passages`.

Columns: draws; `order` right; `declared`: wrong, and the right one among those said to fit as well;
`covered`: 95 % intervals that hold the truth (first harmonic; natural frequency), which the exact
binomial 99 % interval of the count must allow; `also`: the same of the asynchronous vibration's
frequency, or the damping; `found`: the asynchronous vibration; `unwarned`: harmonics more than
three standard errors off in a fit that is not said to be in doubt; `doubt`: fits that are; `error`:
median of the first harmonic's standard error; `refused`: the fit with the order known, which these
probes cannot measure (nothing else is counted then); `holds`: all of it: order or declared in 98 %,
covered and also within their intervals, found in all, and unwarned no more than chance allows
(0.27 % of the harmonics, 99 % bound).

    OMP_NUM_THREADS=1 python benchmarks/tip_records.py [--quick] [--seed N] [--draws N] [folder]
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import common
import numpy as np
from scipy.stats import binom

import fenics_crack as fc

RADIUS, SPEED = 0.4, 2.0 * np.pi * 100.0
ANGLE_DEVIATION = np.radians(0.01)
VARIATION, MISSING = 0.005, 0.2
ASYNCHRONOUS = 2e-4
REVOLUTIONS, SWEPT = 200, 300
STEPS = 32  # of the rotor's angle in a revolution
PROBES = {
    12: [0, 17, 41, 58, 86, 113, 140, 178, 205, 251, 288, 330],
    7: [0, 20, 41, 63, 88, 117, 150],
    5: [0, 18, 47, 85, 131],
    4: [0, 14, 38, 71],
}
"""Angles [degrees]."""
SINE, BREATHING = (1e-3,), (1e-3, 3e-4, 6e-5, 1.5e-5)
"""Amplitudes of the harmonics [m]."""
COLUMNS = (
    "row", "draws", "order", "declared", "covered", "also", "found", "unwarned", "refused",
    "doubt", "error", "holds",
)  # fmt: skip


@dataclass(frozen=True)
class Row:
    """One kind of record, and how it is fitted."""

    name: str
    probes: int
    jitter: float  # s
    waves: tuple[float, ...] = SINE
    harmonics: int = 1
    sweeps: bool = False
    wrong: float = 0.01  # share of the passages


ROWS = [
    *(
        Row(f"sine, {count} probes, {1e9 * jitter:.0f} ns", count, jitter)
        for count in PROBES
        for jitter in (2e-8, 2e-7)
    ),
    *(
        Row(f"breathing, {count} probes, K = {kept}", count, 2e-8, BREATHING, kept)
        for count, kept in ((12, 2), (12, 3), (12, 4), (7, 2), (7, 3), (5, 1), (5, 2))
    ),
    *(
        Row(f"passage, {count} probes, {1e9 * jitter:.0f} ns", count, jitter, sweeps=True)
        for count in PROBES
        for jitter in (2e-8, 2e-7)
    ),
    *(
        Row(f"passage, {count} probes, 10 % wrong", count, 2e-8, sweeps=True, wrong=0.1)
        for count in PROBES
    ),
]


# --- records --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Record:
    """Arrivals, and what is in them."""

    arrivals: fc.ArrivalTimes
    order: int
    asynchronous: float  # rad/s
    omega: float = 0.0  # of the resonance, rad/s
    damping: float = 0.0


def variation(angle: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Six sines of periods of 5 to 100 revolutions, together from -1/2 to 1/2."""
    periods, phases = rng.uniform(5.0, 100.0, 6), rng.uniform(0.0, 2.0 * np.pi, 6)
    total = np.sin(angle[:, None] / periods + phases).sum(axis=1)
    return np.asarray((total - total.min()) / np.ptp(total) - 0.5)


def draw(row: Row, rng: np.random.Generator) -> Record:
    """A record of a row."""
    turns = 2 * SWEPT if row.sweeps else REVOLUTIONS
    grid = 2.0 * np.pi * np.arange(-STEPS, (turns + 1) * STEPS + 1) / STEPS  # one turn more
    speed = SPEED * (1.0 + VARIATION * variation(grid, rng))
    if row.sweeps:
        path_share = np.clip(grid / (2.0 * np.pi * turns), 0.0, 1.0)
        speed *= 1.0 + 0.12 * (np.minimum(path_share, 1.0 - path_share) * 2.0 - 0.5)
    slow = 0.5 * (1.0 / speed[1:] + 1.0 / speed[:-1]) * np.diff(grid)
    time = np.concatenate([[0.0], np.cumsum(slow)])
    time -= np.interp(0.0, grid, time)
    order = int(rng.integers(2, 11 if row.sweeps else 13))
    line = rng.integers(1, 15) + rng.uniform(0.05, 0.95)  # periods in a revolution
    record = Record(None, order, line * SPEED)  # type: ignore[arg-type]
    phases = rng.uniform(0.0, 2.0 * np.pi, len(row.waves) + 1)
    if row.sweeps:
        omega, damping = order * SPEED * rng.uniform(0.99, 1.01), rng.uniform(1e-3, 4e-3)
        record = replace(record, omega=omega, damping=damping)
        vibration = passage(grid, time, order, omega, damping) * np.exp(1j * phases[0])
        envelopes = [row.waves[0] * vibration / np.abs(vibration).max()]
    else:
        envelopes = [
            size * np.exp(1j * phase) * np.ones(len(grid))
            for size, phase in zip(row.waves, phases, strict=False)
        ]

    errors = ANGLE_DEVIATION * rng.standard_normal(row.probes)
    nominal = np.radians(PROBES[row.probes]).astype(float)
    drift = rng.uniform(-2e-4, 2e-4, row.probes) * row.sweeps
    target = 2.0 * np.pi * np.arange(turns)[:, None] + nominal + errors
    angle = target.copy()
    for _ in range(8):
        drift_displacement = drift * (np.interp(angle, grid, speed) / SPEED - 1.0) / 0.06
        turned = record.asynchronous * np.interp(angle, grid, time) + phases[-1]
        drift_displacement += ASYNCHRONOUS * np.cos(turned)
        for multiple, envelope in enumerate(envelopes, 1):
            local_envelope = np.interp(angle, grid, envelope)
            drift_displacement += (local_envelope * np.exp(1j * multiple * order * angle)).real
        angle = target - drift_displacement / RADIUS

    marks = np.interp(2.0 * np.pi * np.arange(turns + 1), grid, time)
    marks += row.jitter * rng.standard_normal(len(marks))
    arrival_times = np.interp(angle, grid, time) + row.jitter * rng.standard_normal(angle.shape)
    is_wrong = rng.random(angle.shape) < row.wrong
    sides = rng.choice([-1.0, 1.0], angle.shape) * rng.uniform(1e-3, 1e-2, angle.shape)
    arrival_times += is_wrong * sides / (RADIUS * SPEED)
    arrival_times[rng.random(angle.shape) < MISSING] = np.nan
    return replace(record, arrivals=fc.ArrivalTimes(arrival_times, marks, nominal, RADIUS))


def passage(
    grid: np.ndarray, time: np.ndarray, order: int, omega: float, damping: float
) -> np.ndarray:
    """Envelope a(alpha) of a mass under exp(i order alpha), on the rotor's path: exactly, with the
    speed constant within a step; from the steady vibration at the first one."""
    root = omega * (1j * np.sqrt(1.0 - damping**2) - damping)
    steps, turned = np.diff(time), np.diff(grid)
    rate = root - 1j * order * turned / steps
    decay = np.exp(rate * steps)
    gain = (decay - 1.0) / rate
    response = np.empty(len(grid), dtype=complex)
    value = response[0] = -1.0 / rate[0]
    for n, (factor, push) in enumerate(zip(decay.tolist(), gain.tolist(), strict=True), 1):
        value = factor * value + push
        response[n] = value
    return response


# --- what is found in them ------------------------------------------------------------------------


@dataclass
class Count:
    """What is counted over the draws of a row."""

    order: int = 0
    declared: int = 0
    covered: int = 0
    also: int = 0
    found: int = 0
    unwarned: int = 0
    refused: int = 0
    doubt: int = 0
    errors: list[float] = field(default_factory=list)

    def numbers(self) -> list[Any]:
        """All of them, and the median of the errors [m]."""
        *counts, errors = vars(self).values()
        return [*counts, np.median(errors) if errors else np.nan]


def judge(row: Row, record: Record, count: Count) -> None:
    """Fit a record, and count."""
    (judge_passage if row.sweeps else judge_steady)(row, record, count)


def judge_steady(row: Row, record: Record, count: Count) -> None:
    """A vibration at a nearly constant speed."""
    options: dict[str, Any] = {"harmonics": row.harmonics, "angle_deviation": ANGLE_DEVIATION}
    order_fit = fc.fit_order(record.arrivals, range(1, 25), **options)
    count.order += order_fit.order == record.order
    count.declared += order_fit.order != record.order and record.order in order_fit.ambiguous_orders
    fit = order_fit
    if order_fit.order != record.order:
        try:
            fit = fc.fit_order(record.arrivals, [record.order], **options)
        except fc.InputError:  # these probes cannot measure it
            count.refused += 1
            count.declared += record.order not in order_fit.ambiguous_orders
            count.found += 1
            return
    true_waves = np.array(row.waves[: row.harmonics])
    scores = np.abs(fit.amplitudes - true_waves) / fit.amplitude_errors
    count.covered += bool(scores[0] < 1.96)
    count.unwarned += int(np.sum(scores > 3.0)) * (not fit.in_doubt)
    count.doubt += fit.in_doubt
    count.errors.append(float(fit.amplitude_errors[0]))
    for line in fit.asynchronous:
        error = line.order_error * line.speed
        if abs(line.omega - record.asynchronous) < 5.0 * error:
            count.found += 1
            count.also += abs(line.omega - record.asynchronous) < 1.96 * error


def judge_passage(row: Row, record: Record, count: Count) -> None:
    """A resonance that is swept, up and down."""
    passages = fc.find_passages(record.arrivals, range(1, 17), most=2, asynchronous=1)
    if not passages:
        return
    fit = max(passages, key=lambda one: one.amplitude)
    count.order += fit.order == record.order
    count.declared += fit.order != record.order and record.order in fit.ambiguous_orders
    count.covered += abs(fit.omega - record.omega) < 1.96 * fit.omega_error
    count.also += abs(fit.damping - record.damping) < 1.96 * fit.damping_error
    count.doubt += fit.in_doubt
    for line in fit.asynchronous:
        error = line.order_error * line.speed
        count.found += abs(line.omega - record.asynchronous) < 5.0 * error


def holds(row: Row, draws: int, count: Count) -> bool:
    """Return True if a row is as it should be."""
    low, high = binom.interval(0.99, draws - count.refused, 0.95)
    intervals = [count.covered, count.also]
    by_chance = binom.ppf(0.99, draws * row.harmonics, 0.0027)
    return bool(
        count.order + count.declared >= 0.98 * draws
        and all(low <= interval <= high for interval in intervals)
        and count.found == draws
        and count.unwarned <= by_chance
    )


def records(arguments: common.Arguments, *, sweeps: bool) -> None:
    """The rows of one kind."""
    draws, table = 20 if arguments.quick else arguments.draws, []
    for number, row in enumerate(ROWS):
        if row.sweeps != sweeps:
            continue
        count = Count()
        rng = np.random.default_rng([arguments.seed, number])
        for _ in range(draws):
            judge(row, draw(row, rng), count)
        table.append([row.name, draws, *count.numbers(), holds(row, draws, count)])
        print(*table[-1], flush=True)
    name = "passages" if sweeps else "steady"
    common.save_table(arguments.folder / f"tip_records_{name}.csv", name, COLUMNS, table)


def main() -> None:
    """Run it."""
    options = {"seed": {"type": int, "default": 1}, "draws": {"type": int, "default": 500}}
    parts = {"steady": partial(records, sweeps=False), "passages": partial(records, sweeps=True)}
    common.run(__doc__, parts, **options)


if __name__ == "__main__":
    main()
