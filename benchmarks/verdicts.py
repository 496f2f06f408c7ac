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

given: solutions with 5, 10, 20 and 40 harmonics of the paper's plate (k = 1e11, 0.1 %) at 15
frequencies from 1000 to 9000 rad/s: the error that is stated and whether an orbit confirms it, and
the verdict with its factor in a period.

massless: 33 plates and blades of the campaign whose crack faces have no mass, with 5, 10 and 20
harmonics: the same.

unconfirmed: the error that would be stated without an orbit, over the distance to the nearest exact
orbit, of 100 solutions with 5 and 10 harmonics. Orbits are sought from eight states along the
solution, and next to those with 4 and 16 times the harmonics. With this search switched off, is the
motion from a solution whose orbit is stable called irregular?

points: each point of the curves of 160 random chains with 0.1 to 1 % of damping, its verdict on the
curve against that of its own orbit (`floquet`).
"""

from __future__ import annotations

import time

import campaign_cases
import common
import numpy as np

import fenics_crack as fc
from fenics_crack.balance.assessment import (
    MAX_ORBIT_DISTANCE_OF_MASSLESS_FACES,
    Assessment,
    relative_gap_distance,
    stated_error,
)
from fenics_crack.motion.attractors import find_irregular_motion
from fenics_crack.motion.flow import ContactFlow, exact_flow_or_error
from fenics_crack.motion.orbit import PeriodicOrbit, find_orbit
from fenics_crack.time.march import make_initial_state_parts

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
    parts = {"verdicts": verdicts, "points": points, "given": given, "massless": massless}
    common.run(__doc__, parts | {"unconfirmed": unconfirmed})


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
    decided_rows = [row for row in rows if row[13] != "-"]
    rates = [
        abs(row[12] / row[8] - 1.0) for row in rows if np.isfinite(row[12]) and np.isfinite(row[8])
    ]
    print(
        f"\n{len(rows)} cases: {sum(row[5] == 'undecided' for row in rows)} undecided; of "
        f"{len(decided_rows)} that can be compared "
        f"{sum(row[13] == 'yes' for row in decided_rows)} agree. "
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
    flow, orbit = exact_flow_or_error(plate, law), None
    start, kind, exact = (
        flow.state(*make_initial_state_parts(plate, law, solution)),
        "none",
        float("nan"),
    )
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
    period, weights = 2.0 * np.pi / omega, flow.energy_weights(omega)
    size = np.linalg.norm(weights * start)
    direction = np.random.default_rng(3).normal(size=len(start))
    state = start + DISTURBANCE * size * direction / np.linalg.norm(direction) / weights
    distance_list = [DISTURBANCE] if orbit else []
    for _ in range(most):
        earlier_state, state = state, flow.advance(state, omega, period).state
        offset = weights * (state - (start if orbit else earlier_state))
        distance_list.append(float(np.linalg.norm(offset) / size))
        if not distance_list[0] / FACTOR <= distance_list[-1] <= FACTOR * distance_list[0]:
            break
    return np.array(distance_list)


def measured(distance: np.ndarray) -> float:
    """Factor per period over the last two thirds; nan where these are fewer than 10 periods."""
    chosen_indices = np.arange(len(distance) // 3, len(distance))
    if len(chosen_indices) < 10:
        return float("nan")
    return float(np.exp(np.polyfit(chosen_indices, np.log(distance[chosen_indices]), 1)[0]))


def by_central_differences(
    plate: fc.Structure, law: fc.UnilateralPenalty, omega: float, orbit: fc.PeriodicOrbit
) -> str:
    """Whether a disturbance of 1 % returns or leaves, by central differences."""
    count = len(orbit.state) // 2
    displacement = orbit.displacement_at(np.zeros(1))[0]
    velocity = orbit.flow.modal_model.shapes @ orbit.state[count:]
    # With fewer steps the grid's own error decides where |mu| is within 0.003 of 1.
    steps = 512 * int(np.ceil(8.0 * fc.stable_steps_per_period(plate, omega, law) / 512))
    history = fc.integrate_central_difference(
        plate, omega, law, periods=150, steps_per_period=steps,
        initial=(1.01 * displacement, 1.01 * velocity),
    )  # fmt: skip
    gap = history.by_period(history.gap)[:, :: steps // 512]
    relative_distances = np.linalg.norm(gap - orbit.gap, axis=(1, 2)) / np.linalg.norm(orbit.gap)
    last_distance = relative_distances[-10:].mean()
    if last_distance < relative_distances[0] / 3.0:
        return "returns"
    return "leaves" if last_distance > 3.0 * relative_distances[0] else "open"


def points(arguments: common.Arguments) -> None:
    """Points of curves that have another verdict than by themselves."""
    rows, count = [], 0
    for seed in range(10 if arguments.quick else 160):
        structure, law = random_chain(seed)
        first_omega, second = fc.solve_modes(structure, 2).omega
        curve = fc.continue_frequency(
            structure, 0.8 * first_omega, 1.25 * second, law, harmonics=15, stability=True,
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


# --- a given number of harmonics ------------------------------------------------------------------


GIVEN_COLUMNS = (
    "case", "omega [rad/s]", "H", "predicted", "stated error", "by an orbit", "verdict",
    "factor in a period", "s",
)  # fmt: skip
FAMILIES = "plate", "cracks", "inner", "rotation"
SEED = 980


def given(arguments: common.Arguments) -> None:
    """The paper's plate, which bounces."""
    plate, law = common.plate("paper_plate", {}), fc.UnilateralPenalty(1e11)
    omegas = np.linspace(1000.0, 9000.0, 15)[:: 5 if arguments.quick else 1]
    cases = [(plate, omega, law, count) for count in (5, 10, 20, 40) for omega in omegas.tolist()]
    answers(arguments, "verdicts_given", [("paper_plate", *case) for case in cases])


def massless(arguments: common.Arguments) -> None:
    """Plates and blades whose crack faces have no mass."""
    drawn_plates = [plate_of(number) for number in range(3 if arguments.quick else 33)]
    cases = [
        (f"{case.family} {case.number}", case.structure, case.omega, case.law, count)
        for case in drawn_plates
        for count in (5, 10, 20)
    ]
    answers(arguments, "verdicts_massless", cases)


def plate_of(number: int) -> campaign_cases.Case:
    """A plate or blade of the campaign; half of them with one crack at an edge."""
    family = FAMILIES[number % 4] if number % 2 else "plate"
    return campaign_cases.draw(SEED, number, "solution", family)


def answers(arguments: common.Arguments, name: str, cases: list[tuple]) -> None:
    """Solve with a given number of harmonics, and count what is said of error and stability."""
    rows = []
    for case, structure, omega, law, harmonics in cases:
        start_time = time.process_time()
        solution = fc.solve_harmonic_balance(
            structure, omega, law, harmonics=harmonics, throw=False
        )
        report, stability = solution.report, fc.floquet(structure, solution)
        rows.append((
            case, omega, harmonics, solution.assessment.predicted_error, report.truncation,
            report.confirmed, stability.verdict, float(abs(stability.multipliers[0])),
            time.process_time() - start_time,
        ))  # fmt: skip
    common.save_table(arguments.folder / f"{name}.csv", name, GIVEN_COLUMNS, rows)
    for count in sorted({row[2] for row in rows}):
        rows_with_count = [row for row in rows if row[2] == count]
        verdicts = [row[6] for row in rows_with_count]
        verdict_counts = ", ".join(
            f"{verdicts.count(verdict)} {verdict}" for verdict in sorted(set(verdicts))
        )
        n_stated = sum(row[4] < 1.0 for row in rows_with_count)
        print(
            f"H = {count}: error stated in {n_stated} of {len(rows_with_count)}; {verdict_counts}"
        )


def unconfirmed(arguments: common.Arguments) -> None:
    """Errors stated without an orbit against true ones, and stable motions called irregular."""
    rows, columns = [], ("case", "H", "predicted", "stated", "true", "true/stated", "|mu|", "grows")
    distant_rows = []
    max_rows = 6 if arguments.quick else 100
    for number in range(10 * max_rows):
        if len(rows) >= max_rows:
            break
        case = plate_of(number // 2)
        if number % 2:
            case = campaign_cases.draw(SEED, number // 2, "solution", "few")
        for harmonics in (5, 10):
            solution = fc.solve_harmonic_balance(
                case.structure, case.omega, case.law, harmonics=harmonics, throw=False
            )
            assessment = Assessment(solution.assessment.wave, n_harmonic_doublings=0)
            orbit = nearest_orbit(solution, assessment) if solution.converged else None
            if (
                orbit is None
                or (true_error := relative_gap_distance(assessment.wave, orbit)) < 1e-6
            ):
                continue
            assert assessment.flow is not None
            motion = find_irregular_motion(
                assessment.flow, case.omega, assessment.states_at_period_parts[0]
            )
            predicted_error = assessment.predicted_error
            (rows if true_error <= MAX_ORBIT_DISTANCE_OF_MASSLESS_FACES else distant_rows).append((
                f"{case.family} {case.number}", harmonics, predicted_error,
                stated_error(predicted_error), true_error,
                true_error / stated_error(predicted_error), float(abs(orbit.multipliers[0])),
                motion.growth if motion else float("nan"),
            ))  # fmt: skip
    name = "verdicts_unconfirmed"
    common.save_table(arguments.folder / f"{name}.csv", name, columns, rows)
    ratios, stable = np.array([row[5] for row in rows]), [row for row in rows if row[6] < 1.0]
    systems, irregular = {row[0] for row in stable}, {row[0] for row in stable if row[7] > 1.0}
    print(
        f"\n{len(rows)} solutions: true over stated median {np.median(ratios):.2f}, largest "
        f"{ratios.max():.2f}, {np.sum(ratios > 1.1)} above 1.1. Of {len(systems)} systems with "
        f"stable orbits {len(irregular)} are called irregular. Of {len(distant_rows)} more "
        f"solutions no orbit is nearer than {MAX_ORBIT_DISTANCE_OF_MASSLESS_FACES:g}."
    )
    common.print_table("No orbit near", columns, distant_rows)


def nearest_orbit(solution: fc.PeriodicSolution, assessment: Assessment) -> PeriodicOrbit | None:
    """The nearest exact orbit of many starts."""
    flow, wave, orbits, finer_solution = assessment.flow, assessment.wave, [], solution
    if flow is None or assessment.orbit_prediction_by_newton_step is None:
        return None
    for place in range(0, len(assessment.states_at_period_parts), 4):
        part = place / len(assessment.states_at_period_parts) * wave.period
        try:
            start = flow.advance(
                assessment.states_at_period_parts[place], wave.omega, wave.period - part, start=part
            )
        except fc.ConvergenceError:
            continue
        orbits.append(find_orbit(flow, wave.omega, start.state))
    for times in (4, 16):
        finer_solution = fc.solve_harmonic_balance(
            wave.structure, wave.omega, wave.contact, harmonics=times * wave.harmonics,
            initial=finer_solution, throw=False,
        )  # fmt: skip
        if not finer_solution.converged:
            break
        orbits.append(
            Assessment(finer_solution.assessment.wave, n_harmonic_doublings=0).nearest_orbit
        )
    exact_orbits = [orbit for orbit in orbits if orbit is not None]
    return min(exact_orbits, key=lambda orbit: relative_gap_distance(wave, orbit), default=None)


def random_chain(seed: int) -> tuple[fc.Structure, fc.UnilateralPenalty]:
    """Three to six masses between springs, the last one and perhaps the middle one with a stop."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 7))
    springs, mass = rng.uniform(0.5, 2.0, n + 1), rng.uniform(0.5, 1.5, n)
    inner_coupling = np.diag(springs[1:-1], 1)
    stiffness = np.diag(springs[:-1] + springs[1:]) - inner_coupling - inner_coupling.T
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
        chosen_rows = [row for row in rows if row[5] == verdict]
        axes.plot(
            [row[8] for row in chosen_rows], [row[12] for row in chosen_rows], marker,
            color=colour, ms=5,
            label=verdict, mfc="none",
        )  # fmt: skip
        other.plot(
            [row[2] for row in chosen_rows], [row[8] for row in chosen_rows], marker,
            color=colour, ms=5,
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
