"""Verdicts on stability against exact integration.

verdicts: the paper's plate at five load frequencies, with four contact stiffnesses and three
dampings: 60 orbits by harmonic balance. Each gets its verdict (`floquet`). Then the exact orbit
next to it (`shoot`), with a random disturbance of 1e-6 of its state, is integrated exactly from one
switching instant to the next. Once in a period of the load the distance to the orbit is taken: it
grows or falls by a factor that should be the modulus of the leading multiplier. Where shooting
finds no orbit, integration starts from the state of harmonic balance, and the distance is that
between one period and the next.

    outcome    returns: the distance has fallen by 1000; leaves: it has grown by as much;
               open: neither in the periods allowed
    agrees     stable and returns, or unstable and leaves; "-" where one of both does not say
    rate       the factor per period, measured over the last two thirds of the periods, where these
               are 10 or more

Some of the orbits are integrated by central differences too (`central`), with 8 times the steps
that stability of the integration needs, from 1.01 times the exact state, for 150 periods; the
distance is that of the gap to the exact one, and has to change by a factor of 3.

points: each point of the curves of 160 random chains with 0.1 to 1 % of damping, its verdict on the
curve against that of its own orbit (`floquet`).
"""

from __future__ import annotations

import common
import numpy as np

import fenics_crack as fc
from fenics_crack.motion.flow import ContactFlow, exact_flow
from fenics_crack.time.march import initial_state

OMEGAS = (1300.0, 2000.0, 3300.0, 5200.0, 8700.0)
STIFFNESSES = (1e8, 1e9, 1e10, 1e11)
RATIOS = (0.03, 0.01, 0.001)
DISTURBANCE, FACTOR = 1e-6, 1e3
COLUMNS = (
    "xi", "k [N/m]", "omega [rad/s]", "H", "truncation", "verdict", "refined", "|mu| verdict",
    "|mu| exact", "orbit", "periods", "outcome", "rate", "agrees", "central",
)  # fmt: skip
MARKS = {"stable": ("o", "tab:blue"), "unstable": ("s", "tab:red"), "undecided": ("x", "0.4")}


def main() -> None:
    """Run it."""
    common.run(__doc__, {"verdicts": verdicts, "points": points})


def verdicts(arguments: common.Arguments) -> None:
    """All cases."""
    omegas = OMEGAS[1:4:2] if arguments.quick else OMEGAS
    most = 300 if arguments.quick else 5000
    rows = []
    for ratio in RATIOS:
        plate = common.plate("paper_plate", {"damping.ratio": ratio})
        for stiffness in STIFFNESSES:
            for omega in omegas:
                rows.append((ratio, stiffness, omega, *judged(plate, stiffness, omega, most)))
    common.save_table(arguments.folder / "verdicts.csv", "verdict and motion", COLUMNS, rows)
    decided = [row for row in rows if row[13] != "-"]
    rates = [
        abs(row[12] / row[8] - 1.0) for row in rows if np.isfinite(row[12]) and np.isfinite(row[8])
    ]
    print(
        f"\n{len(rows)} cases: {sum(row[5] == 'undecided' for row in rows)} undecided; of "
        f"{len(decided)} that can be compared {sum(row[13] == 'yes' for row in decided)} agree. "
        f"Measured rate against |mu|: median {np.median(rates):.1e}, largest {max(rates):.1e}."
    )
    draw(rows, arguments.folder / "verdicts.png")


def judged(plate: fc.Structure, stiffness: float, omega: float, most: int) -> tuple:
    """One case."""
    law = fc.UnilateralPenalty(stiffness)
    harmonics = 40 if stiffness < 5e9 else 100
    solution = fc.solve_harmonic_balance(plate, omega, law, harmonics=harmonics, throw=False)
    if not solution.converged:
        nan = float("nan")
        return (
            harmonics, nan, "not solved", False, nan, nan, "none", 0, "open", nan, "-", "-",
        )  # fmt: skip
    found = fc.floquet(plate, solution)
    flow, orbit = exact_flow(plate, law), None
    start, kind, exact = flow.state(*initial_state(plate, law, solution)), "none", float("nan")
    try:
        orbit = fc.shoot(plate, solution)
    except fc.ConvergenceError:
        pass
    else:
        times = np.arange(len(orbit.gap)) * solution.period / len(orbit.gap)
        apart = np.linalg.norm(orbit.gap - solution.gap(times)) / np.linalg.norm(orbit.gap)
        kind = "near" if apart < 0.1 else "another"
        if kind == "near":
            start, exact = orbit.state, abs(orbit.multipliers[0])
    distance = distances(flow, omega, start, kind == "near", most)
    outcome, rate = "open", measured(distance) if kind == "near" else float("nan")
    if distance[-1] > FACTOR * distance[0]:
        outcome = "leaves"
    elif distance[-1] < distance[0] / FACTOR:
        outcome = "returns"
    agrees = "-"
    if found.verdict != "undecided" and outcome != "open":
        agrees = "yes" if (found.verdict == "stable") == (outcome == "returns") else "NO"
    central = "-"
    if orbit is not None and kind == "near" and stiffness == 1e9 and omega in OMEGAS[1:4:2]:
        central = by_central_differences(plate, law, omega, orbit)
    return (
        harmonics, solution.report.truncation, found.verdict, found.refined,
        float(abs(found.multipliers[0])), float(exact), kind, len(distance) - 1, outcome, rate,
        agrees, central,
    )  # fmt: skip


def distances(
    flow: ContactFlow, omega: float, start: np.ndarray, orbit: bool, most: int
) -> np.ndarray:
    """Distance to the orbit once in a period, relative to its state in the norm of the energy,
    until the motion has settled.

    Without an exact orbit: of one period to the next.
    """
    period, weights = 2.0 * np.pi / omega, flow.weights(omega)
    size = np.linalg.norm(weights * start)
    direction = np.random.default_rng(3).normal(size=len(start))
    state = start + DISTURBANCE * size * direction / np.linalg.norm(direction) / weights
    found = [DISTURBANCE] if orbit else []
    for _ in range(most):
        before, state = state, flow.advance(state, omega, period).state
        off = weights * (state - (start if orbit else before))
        found.append(float(np.linalg.norm(off) / size))
        if not found[0] / FACTOR <= found[-1] <= FACTOR * found[0]:
            break
    return np.array(found)


def measured(distance: np.ndarray) -> float:
    """Factor per period over the last two thirds; nan where these are fewer than 10 periods."""
    chosen = np.arange(len(distance) // 3, len(distance))
    if len(chosen) < 10:
        return float("nan")
    return float(np.exp(np.polyfit(chosen, np.log(distance[chosen]), 1)[0]))


def by_central_differences(
    plate: fc.Structure, law: fc.UnilateralPenalty, omega: float, orbit: fc.PeriodicOrbit
) -> str:
    """Whether a disturbance of 1 % returns or leaves, by central differences."""
    count = len(orbit.state) // 2
    displacement = orbit.displacement_at(np.zeros(1))[0]
    velocity = orbit.flow.modes.shapes @ orbit.state[count:]
    # With fewer steps the grid's own error decides where |mu| is within 0.003 of 1.
    steps = 512 * int(np.ceil(8.0 * fc.stable_steps_per_period(plate, omega, law) / 512))
    history = fc.integrate_central_difference(
        plate, omega, law, periods=150, steps_per_period=steps,
        initial=(1.01 * displacement, 1.01 * velocity),
    )  # fmt: skip
    gap = history.by_period(history.gap)[:, :: steps // 512]
    apart = np.linalg.norm(gap - orbit.gap, axis=(1, 2)) / np.linalg.norm(orbit.gap)
    last = apart[-10:].mean()
    if last < apart[0] / 3.0:
        return "returns"
    return "leaves" if last > 3.0 * apart[0] else "open"


def points(arguments: common.Arguments) -> None:
    """Points of curves that have another verdict than by themselves."""
    rows, count = [], 0
    for seed in range(10 if arguments.quick else 160):
        structure, law = random_chain(seed)
        first, second = fc.solve_modes(structure, 2).omega
        curve = fc.continue_frequency(
            structure, 0.8 * first, 1.25 * second, law, harmonics=15, stability=True,
            most_points=400, throw=False,
        )  # fmt: skip
        for place in np.flatnonzero(curve.verdicts != "undecided").tolist():
            solution, count = curve.solution(place, search=False), count + 1
            alone = fc.floquet(structure, solution)
            if alone.verdict not in ("undecided", curve.verdicts[place]):
                size = abs(alone.multipliers[0])
                rows.append((seed, place, curve.values[place], curve.verdicts[place], size))
    common.save_table(
        arguments.folder / "verdicts_points.csv", "Points with another verdict than by themselves",
        ("seed", "point", "omega [rad/s]", "verdict", "|mu| by itself"), rows,
    )  # fmt: skip
    print(f"{len(rows)} of {count} points with a verdict")


def random_chain(seed: int) -> tuple[fc.Structure, fc.UnilateralPenalty]:
    """Three to six masses between springs, the last one and perhaps the middle one with a stop."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 7))
    springs, mass = rng.uniform(0.5, 2.0, n + 1), rng.uniform(0.5, 1.5, n)
    inner = np.diag(springs[1:-1], 1)
    stiffness = np.diag(springs[:-1] + springs[1:]) - inner - inner.T
    pairs = np.eye(n)[:, [n - 1, n // 2]][:, : 1 + (rng.random() < 0.5)]
    ratio = float(10.0 ** rng.uniform(-3.0, -2.0))
    structure = fc.Structure.from_matrices(
        np.diag(mass), stiffness, gap=pairs, force_cos=np.eye(n)[0], damping=fc.ModalDamping(ratio),
        clearance=float(rng.choice([0.0, 0.3, -0.3])),
    )  # fmt: skip
    return structure, fc.UnilateralPenalty(float(10.0 ** rng.uniform(0.0, 1.5)))


def draw(rows: list[tuple], path: object) -> None:
    """The measured rate over the modulus of the exact leading multiplier."""
    figure, (axes, other) = common.figure(2)
    for verdict, (marker, colour) in MARKS.items():
        chosen = [row for row in rows if row[5] == verdict]
        axes.plot(
            [row[8] for row in chosen], [row[12] for row in chosen], marker, color=colour, ms=5,
            label=verdict, mfc="none",
        )  # fmt: skip
        other.plot(
            [row[2] for row in chosen], [row[8] for row in chosen], marker, color=colour, ms=5,
            label=verdict, mfc="none",
        )  # fmt: skip
    values = [row[8] for row in rows if np.isfinite(row[8] * row[12])]
    ends = [min(values), max(values)]
    axes.loglog(ends, ends, "-", color="0.7", lw=1.0)
    axes.axvline(1.0, color="0.7", lw=1.0)
    axes.set_xlabel("modulus of the leading multiplier of the exact orbit [-]")
    axes.set_ylabel("measured growth in a period [-]")
    other.axhline(1.0, color="0.7", lw=1.0)
    other.set_yscale("log")
    other.set_xlabel("load frequency [rad/s]")
    other.set_ylabel("modulus of the leading multiplier [-]")
    axes.legend(title="verdict")
    figure.savefig(path)


if __name__ == "__main__":
    main()
