"""Is an engine order ever stated wrongly beside a neighbouring mode, or by few probes?

Generated records of 2, 3 and 4 probes at random angles, in which a run-up and a run-down pass two
modes 1.6 % apart: of one engine order, as the modes of a blisk, or of two. Each mode is a mass of
damping 0.001 to 0.004, integrated in time (a filter with a force linear within a step, which shares
nothing with the envelope that is fitted); the larger one reaches 0.3 to 1 mm, the smaller one 0.3
to 1 times that. Errors are those of `tip_records.py`, but arrivals scatter by 5 to 100 micrometres.

A resonance found is of the mode whose speed is nearest. Columns, by probes: `records`; `found`:
resonances; `alone`: orders stated alone, which are right (neither another one listed, nor untested,
nor in doubt), and their share of all `modes`; `wrong`: stated alone, and wrong; `held`: modes whose
frequency is within 1.96 errors, of those whose order is stated alone.

    OMP_NUM_THREADS=1 python benchmarks/neighbouring_modes.py [--quick] [--seed N] [--records N]
"""

from __future__ import annotations

import common
import numpy as np
from scipy.signal import lfilter

import fenics_crack as fc

RADIUS, SPEED = 0.4, 2.0 * np.pi * 100.0  # m, rad/s
SWEPT, REVOLUTIONS = 0.12, 300
"""Relative change of the speed in a run-up, and its revolutions."""
APART = 0.016
CLOSEST = np.radians(8.0)
"""Minimum angle between two probes."""
STEPS = 60
"""Steps in a period of the highest frequency."""
HIGHEST = 12
COLUMNS = ("probes", "records", "modes", "found", "alone", "share", "wrong", "held")


def motion(
    time: np.ndarray, angle: np.ndarray, order: int, omega: float, damping: float, phase: float
) -> np.ndarray:
    """Displacement of a mass of one mode [rad/s] under an engine order, from rest, 1 at most."""
    step = float(time[1] - time[0])
    force = np.cos(order * angle + phase)
    root = omega * complex(-damping, np.sqrt(1.0 - damping**2))
    decay = np.exp(root * step)
    first_weight = (decay - 1.0) / root
    second = (first_weight - step) / (root * step)
    modal_force = first_weight * force[:-1] + second * np.diff(force)
    displacement = np.append(0.0, lfilter([1.0], [1.0, -decay], modal_force).imag)
    return np.asarray(displacement / np.abs(displacement).max())


def probe_angles(count: int, rng: np.random.Generator) -> np.ndarray:
    """Random angles that are not too close, all around or in a part of the casing [rad]."""
    arc = rng.choice([2.0 * np.pi, np.radians(90.0)])
    while True:
        angles = np.sort(rng.uniform(0.0, arc, count))
        if np.diff(angles, append=angles[0] + 2.0 * np.pi).min() > CLOSEST:
            return np.asarray(angles)


def record(
    probes: int, rng: np.random.Generator
) -> tuple[fc.ArrivalTimes, list[tuple[int, float]]]:
    """Arrivals, and order and frequency [rad/s] of each mode in them."""
    orders = rng.integers(2, HIGHEST + 1, 2)
    if rng.random() < 0.5:
        orders[1] = orders[0]
    place = SPEED * rng.uniform(0.99, 1.01)
    speeds = place * np.array([1.0, 1.0 + rng.choice([-APART, APART])])
    duration = 2 * REVOLUTIONS * 2.0 * np.pi / SPEED
    step = 2.0 * np.pi / (STEPS * HIGHEST * SPEED)
    time = np.arange(-0.05 * duration, 1.05 * duration, step)
    path_share = np.clip(time / duration, 0.0, 1.0)
    speed = SPEED * (1.0 + SWEPT * (np.minimum(path_share, 1.0 - path_share) * 2.0 - 0.5))
    periods, phases = rng.uniform(0.05, 1.0, (2, 6))
    variation = np.sin(time[:, None] / periods + 2.0 * np.pi * phases).sum(axis=1)
    speed *= 1.0 + 0.005 * variation / np.ptp(variation)
    angle = np.append(0.0, np.cumsum(0.5 * step * (speed[1:] + speed[:-1])))
    angle -= np.interp(0.0, time, angle)
    displacement = np.zeros(len(time))
    sizes = 1e-3 * rng.uniform(0.3, 1.0) * np.array([1.0, rng.uniform(0.3, 1.0)])
    for order, at, size in zip(orders, speeds, sizes, strict=True):
        damping, phase = rng.uniform(1e-3, 4e-3), rng.uniform(0.0, 2.0 * np.pi)
        displacement += size * motion(time, angle, int(order), order * at, damping, phase)
    line, phase = SPEED * (rng.integers(1, 15) + rng.uniform(0.05, 0.95)), rng.uniform(0.0, 6.28)
    displacement += rng.choice([0.0, 2e-4]) * np.cos(line * time + phase)

    nominal = probe_angles(probes, rng)
    turns = int(np.interp(duration, time, angle) / (2.0 * np.pi))
    places = nominal + np.radians(0.01) * rng.standard_normal(probes)
    drift = rng.uniform(-2e-4, 2e-4, probes)
    target = 2.0 * np.pi * np.arange(turns)[:, None] + places
    passage_times = np.empty_like(target)
    for probe in range(probes):
        total = displacement + drift[probe] * (speed / SPEED - 1.0) / 0.06
        passage_times[:, probe] = np.interp(target[:, probe], angle + total / RADIUS, time)
    scatter = 10.0 ** rng.uniform(-5.3, -4.0) / (RADIUS * SPEED)
    arrival_times = passage_times + scatter * rng.standard_normal(passage_times.shape)
    is_wrong = rng.random(arrival_times.shape) < 0.01
    arrival_times += (
        is_wrong * rng.choice([-1.0, 1.0], arrival_times.shape) * 5e-3 / (RADIUS * SPEED)
    )
    arrival_times[rng.random(arrival_times.shape) < 0.2] = np.nan
    marks = np.interp(2.0 * np.pi * np.arange(turns + 1), angle, time)
    marks += 2e-8 * rng.standard_normal(len(marks))
    arrivals = fc.ArrivalTimes(arrival_times, marks, nominal, RADIUS)
    return arrivals, [(int(p), float(p * at)) for p, at in zip(orders, speeds, strict=True)]


def stated_alone(fit: fc.PassageFit) -> bool:
    """Return True if an order is stated, and nothing is against it."""
    return not (fit.ambiguous_orders or fit.in_doubt)


def main() -> None:
    """Run it."""
    options = {"seed": {"type": int, "default": 67}, "records": {"type": int, "default": 400}}
    common.run(__doc__, {"modes": judge}, **options)


def judge(arguments: common.Arguments) -> None:
    """All records, by the number of probes."""
    n_records, rows = 30 if arguments.quick else arguments.records, []
    shares = [len(part) for part in np.array_split(np.arange(n_records), 3)]
    for probes, records in zip((2, 3, 4), shares, strict=True):
        rng = np.random.default_rng([arguments.seed, probes])
        n_found = n_alone = n_wrong = n_held = 0
        for _ in range(records):
            arrivals, modes = record(probes, rng)
            for fit in fc.find_passages(arrivals, range(1, 17)):
                order, omega = min(modes, key=lambda one: abs(one[1] / one[0] - fit.speed))
                is_right = fit.order == order
                n_found += 1
                n_alone += is_right and stated_alone(fit)
                n_wrong += not is_right and stated_alone(fit)
                frequency_error = abs(fit.omega - omega)
                n_held += (
                    is_right and stated_alone(fit) and frequency_error < 1.96 * fit.omega_error
                )
        share = n_alone / (2 * records)
        rows.append([probes, records, 2 * records, n_found, n_alone, share, n_wrong, n_held])
        print(*rows[-1], flush=True)
    common.save_table(arguments.folder / "neighbouring_modes.csv", "modes", COLUMNS, rows)


if __name__ == "__main__":
    main()
