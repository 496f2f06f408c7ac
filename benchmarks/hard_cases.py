"""Cases made to break a solver: what converges, how, and whether the answer can be trusted.

Each row is one solution of `solve_harmonic_balance`, held against an independent method:

    exact     the exact orbit next to it, by shooting on the piecewise-linear flow (`shoot`)
    scaled    the same plate in other units or of another size, whose gaps must be the same
    closed    a closed form
    more H    the solution with three times the harmonics, from this one

and judged by its own error report, whose total is `estimate`:

    right       the difference is at most three times the estimate, or below 1e-6
    says so     it did not converge, was refused, or itself estimates an error above 10 %
    open        it converged, and the other method found nothing to compare it with
    WRONG       none of these: a wrong answer that claims to be right

After the table the script prints the counts by group, and every case that is not right, with its
reason.

Groups: penalty stiffness from 1e6 to 1e14 N/m; damping from none to 10 %; load exactly on a natural
frequency and on its fractions; grazing; preload and cracks that hardly open; crack lengths from 1 %
to 95 % of the width; 1 to 200 pairs; 1 to 200 harmonics; smoothed contact from soft to sharp; the
plate in other sizes; undamped blocks next to resonance; two orbits at one frequency.

    OMP_NUM_THREADS=1 python benchmarks/hard_cases.py [--quick] [folder]
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import common
import numpy as np

import fenics_crack as fc

COLUMNS = (
    "group", "case", "converged", "way", "iterations", "ms", "truncation", "estimate", "verdict",
    "against", "difference", "judgement",
)  # fmt: skip
RIGHT, SAYS_SO, OPEN, WRONG = "right", "says so", "open", "WRONG"


@dataclass(frozen=True)
class Case:
    """One thing to solve.

    ``expected`` are coefficients of B^T u on the pairs to compare with, or a function that finds
    them from the solution; ``against`` names the method.
    """

    group: str
    name: str
    structure: fc.Structure
    omega: float
    law: Any
    harmonics: int
    against: str = "exact"
    expected: np.ndarray | Callable[[fc.PeriodicSolution], np.ndarray] | None = None
    initial: fc.PeriodicSolution | None = None


def main() -> None:
    """Run it."""
    common.run(__doc__, {"cases": cases})


def cases(arguments: common.Arguments) -> None:
    """All of them."""
    rows = [judge(case) for case in collect(arguments.quick)]
    common.write_csv(arguments.folder / "hard_cases.csv", COLUMNS, rows)
    short_rows = [(*row[:3], row[3][:20], *row[4:]) for row in rows]
    common.print_table("Hard cases", COLUMNS, short_rows)
    keys = (RIGHT, SAYS_SO, OPEN, WRONG)
    by_group = {group: [row[-1] for row in rows if row[0] == group] for group, *_ in rows}
    common.print_table(
        "By group",
        ("group", "cases", *keys),
        [
            (group, len(group_rows), *map(group_rows.count, keys))
            for group, group_rows in by_group.items()
        ],
    )
    counts = {key: sum(row[-1] == key for row in rows) for key in keys}
    print(f"\n{len(rows)} cases: " + ", ".join(f"{n} {key}" for key, n in counts.items()))
    print("\nNot right:")
    for row in rows:
        if row[-1] != RIGHT:
            print(f"  {row[0]}, {row[1]}: {what_failed(row)}")


def what_failed(row: tuple[Any, ...]) -> str:
    """In words, what kept a case from being right."""
    *_, is_converged, way, _, _, _, estimate, _, reference_name, difference, judgement = row
    if not is_converged:
        return str(way)
    error_text = f"{100 * difference:.3g} % off" if np.isfinite(difference) else "nothing found"
    return (
        f"{judgement}: estimates an error of {100 * estimate:.3g} %; {reference_name}: {error_text}"
    )


def collect(quick: bool) -> Iterator[Case]:
    """The cases, group after group; few of each where it shall be quick."""
    groups = (
        stiffness, damping, on_resonance, grazing, preload, crack_length, many_pairs,
        many_harmonics, smoothing, sizes, next_to_resonance, two_orbits,
    )  # fmt: skip
    for group in groups:
        rows = list(group(quick))
        yield from rows[:: max(1, len(rows) // 3)] if quick else rows


def judge(case: Case) -> tuple[Any, ...]:
    """Solve, compare, and judge."""
    start_time = time.process_time()
    head = (case.group, case.name)
    try:
        solution = fc.solve_harmonic_balance(
            case.structure, case.omega, case.law, harmonics=case.harmonics, initial=case.initial,
            throw=False,
        )  # fmt: skip
    except (fc.InputError, fc.ConvergenceError) as error:
        ms = 1e3 * (time.process_time() - start_time)
        nan = float("nan")
        return (*head, False, str(error), 0, ms, nan, nan, "-", "-", nan, SAYS_SO)
    ms = 1e3 * (time.process_time() - start_time)
    way = "plain" if solution.iterations <= 20 else "path"  # Newton's steps alone end there
    if not solution.converged:
        way = solution.status
    report = solution.report
    verdict, difference = "-", float("nan")
    if solution.converged:
        if case.structure.n_dofs <= 100 and not isinstance(case.law, fc.UnilateralConstraint):
            try:
                verdict = fc.floquet(case.structure, solution).verdict
            except fc.ConvergenceError:
                verdict = "no multipliers"
        difference = compare(case, solution)
    if not solution.converged or report.total > 0.1:
        judgement = SAYS_SO
    elif np.isnan(difference):
        judgement = OPEN
    else:
        judgement = RIGHT if difference <= max(3.0 * report.total, 1e-6) else WRONG
    return (
        *head, solution.converged, way, solution.iterations, ms, report.truncation, report.total,
        verdict, case.against, difference, judgement,
    )  # fmt: skip


def compare(case: Case, solution: fc.PeriodicSolution) -> float:
    """Relative L2 difference of the gap from the independent method's; nan where there is none."""
    if case.against == "exact":
        orbit = exact_orbit(case, solution)
        if orbit is None:
            return float("nan")
        time_ = np.arange(len(orbit.gap)) * solution.period / len(orbit.gap)
        closing = orbit.gap + case.structure.clearance
        return float(np.linalg.norm(solution.gap(time_) - orbit.gap) / np.linalg.norm(closing))
    if case.against == "more H":
        try:
            finer_solution = fc.solve_harmonic_balance(
                case.structure, case.omega, case.law, harmonics=3 * case.harmonics,
                initial=solution,
            )  # fmt: skip
        except (fc.ConvergenceError, fc.InputError):
            return float("nan")
        if finer_solution.iterations > 20:  # found from elsewhere: maybe another orbit
            return float("nan")
        time_ = np.arange(4096) * solution.period / 4096
        gap, closing = (
            finer_solution.gap(time_),
            finer_solution.gap(time_) + case.structure.clearance,
        )
        return float(np.linalg.norm(solution.gap(time_) - gap) / np.linalg.norm(closing))
    expected = case.expected(solution) if callable(case.expected) else case.expected
    assert expected is not None
    closing = solution.gap_coefficients.copy()
    closing[0] += case.structure.clearance
    return common.relative_difference(closing, expected)


def exact_orbit(case: Case, solution: fc.PeriodicSolution) -> fc.PeriodicOrbit | None:
    """The orbit next to a solution, or next to where the motion goes from there."""
    for periods in (0, 10, 30, 60):
        try:
            return fc.shoot(case.structure, solution, settle=periods)
        except (fc.ConvergenceError, fc.InputError):
            continue
    return None


# --- the groups -----------------------------------------------------------------------------------


def paper(ratio: float = 0.01, **changes: Any) -> fc.Structure:
    """The paper's plate."""
    return common.plate("paper_plate", {"damping.ratio": ratio} | changes)


def stiffness(quick: bool) -> Iterator[Case]:
    """Contact from soft to beyond what rounding resolves."""
    plate = paper()
    for k in 10.0 ** np.arange(6, 13 if quick else 15):
        law = fc.UnilateralPenalty(k)
        yield Case("stiffness", f"k = {k:.0e} N/m", plate, 2000.0, law, 20)


def damping(quick: bool) -> Iterator[Case]:
    """From none to a tenth of critical."""
    for ratio in (0.0, 1e-5, 1e-4, 1e-3, 1e-2, 0.1):
        law = fc.UnilateralPenalty(1e9)
        yield Case("damping", f"xi = {ratio:g}", paper(ratio), 2000.0, law, 20)


def on_resonance(quick: bool) -> Iterator[Case]:
    """The load on a natural frequency of the open plate, and on its fractions."""
    for ratio in (0.01, 0.0):
        plate = paper(ratio)
        first_omega = float(fc.solve_modes(plate, 1).omega[0])
        for part in (1, 2, 3, 4):
            law = fc.UnilateralPenalty(1e9)
            name = f"omega_1 / {part}, xi = {ratio:g}"
            yield Case("on resonance", name, plate, first_omega / part, law, 20)


def grazing(quick: bool) -> Iterator[Case]:
    """A stop just where the open motion ends: touched by less and less, or just not."""
    for share in (0.9, 0.99, 1.0 - 1e-4, 1.0 - 1e-8, 1.0, 1.0 + 1e-8, 1.1):
        amplitude = 1.0 / np.hypot(1.0 - 0.64, 0.1 * 0.8)
        structure = fc.Structure.from_matrices(
            [[1.0]],
            [[1.0]],
            gap=[1.0],
            force_cos=[1.0],
            damping=[[0.1]],
            clearance=share * amplitude,
        )
        law = fc.UnilateralPenalty(10.0)
        yield Case("grazing", f"clearance {share:.9g} of amplitude", structure, 0.8, law, 40)


def preload(quick: bool) -> Iterator[Case]:
    """Lips pressed together, or so far apart that they hardly touch."""
    for clearance in (-1e-4, -1e-5, -1e-6, -1e-7, 1e-8, 1e-7, 1e-6, 1e-5):
        plate = paper(**{"crack.clearance": clearance})
        law = fc.UnilateralPenalty(1e9)
        yield Case("preload", f"clearance {clearance:g} m", plate, 2000.0, law, 20)


def crack_length(quick: bool) -> Iterator[Case]:
    """From a scratch to a plate hanging by a thread, contact on all pairs.

    With 80 and 95 % the plate moves without a period. With 80 % there is an unstable orbit, for
    which 20 harmonics are not enough.
    """
    for share in (0.05, 0.2) if quick else (0.01, 0.05, 0.2, 0.5, 0.8, 0.95):
        scene = fc.Scene.load(common.DEMOS / "breathing_plate.toml").replace(
            {"crack.first_omega": None, "crack.length": 0.1 * share, "damping.ratio": 0.01}
        )
        modes = 30 if quick else 60
        plate = fc.reduce_structure(fc.build_structure(scene), modes=modes, method="massless")
        law = fc.UnilateralPenalty(1e9)
        first_omega = float(fc.solve_modes(plate, 1).omega[0])
        name = f"{100 * share:g} % of the width, {plate.n_pairs} pairs"
        harmonics = 60 if share == 0.8 else 20
        yield Case("crack length", name, plate, 0.6 * first_omega, law, harmonics, "more H")


def many_pairs(quick: bool) -> Iterator[Case]:
    """The same crack with more and more pairs, and a stiffness per area."""
    for elements in (1, 3, 10, 30) if quick else (1, 3, 10, 30, 100):
        scene = fc.Scene.load(common.DEMOS / "breathing_plate.toml").replace(
            {
                "crack.first_omega": None,
                "crack.length": 0.0431,
                "damping.ratio": 0.01,
                "mesh.lip_elements": elements,
                "contact.stiffness": None,
                "contact.stiffness_per_area": 4.2e11,
            }
        )
        plate = fc.reduce_structure(fc.build_structure(scene), modes=60, method="massless")
        law = fc.contact_law(scene.contact, plate)
        yield Case("pairs", f"{plate.n_pairs} pairs", plate, 2000.0, law, 20, "more H")


def many_harmonics(quick: bool) -> Iterator[Case]:
    """One to 200, and more than the memory holds."""
    plate = paper()
    law = fc.UnilateralPenalty(1e9)
    for harmonics in (1, 2, 5, 20, 60, 200):
        yield Case("harmonics", f"H = {harmonics}", plate, 2000.0, law, harmonics)
    wide_structure = fc.reduce_structure(
        common.plate("breathing_plate"), modes=10, method="massless"
    )
    max_harmonics = 200 if quick else 2000
    yield Case(
        "harmonics", f"H = {max_harmonics}, 18 pairs", wide_structure, 2000.0, law, max_harmonics
    )


def smoothing(quick: bool) -> Iterator[Case]:
    """The arctangent law from soft to sharp, against itself with more harmonics."""
    plate = paper()
    for sharpness in 10.0 ** np.arange(4, 13, 4 if quick else 2):
        law = fc.SmoothedPenalty(1e9, sharpness)
        yield Case("smoothing", f"s = {sharpness:.0e} 1/m", plate, 2000.0, law, 20, "more H")


def sizes(quick: bool) -> Iterator[Case]:
    """Plane stress of one thickness: gaps do not depend on the size if omega goes like 1/size."""
    law = fc.UnilateralPenalty(1e9)
    reference = fc.solve_harmonic_balance(paper(), 2000.0, law, harmonics=10).gap_coefficients
    for size in (1e-3, 1e-2, 1.0, 10.0, 1e3):
        scaled = {
            "geometry.width": size,
            "geometry.height": size,
            "crack.height": 0.5 * size,
            "crack.length": 0.5 * size,
            "excitation.point": [size, size],
        }
        plate = paper(**scaled)
        name = f"{size:g} m"
        yield Case("size", name, plate, 200.0 / size, law, 10, "scaled", reference)


def next_to_resonance(quick: bool) -> Iterator[Case]:
    """Two undamped masses, driven next to a natural frequency: blocks all but singular.

    The stop is out of reach, so that the linear response is a closed form.
    """
    stiffness_ = np.array([[2.0, -1.0], [-1.0, 2.0]])
    for distance in (1e-2, 1e-6, 1e-10, 0.0):
        structure = fc.Structure.from_matrices(
            np.eye(2), stiffness_, gap=[1.0, 0.0], force_cos=[1.0, 0.0], clearance=1e10
        )
        omega = 1.0 + distance

        def linear(solution: fc.PeriodicSolution, omega: float = omega) -> np.ndarray:
            wave = np.linalg.solve(stiffness_ - omega**2 * np.eye(2), [1.0, 0.0])
            rows = np.zeros_like(solution.gap_coefficients)
            rows[1] = wave[0]
            return rows

        law = fc.UnilateralPenalty(1.0)
        name = f"omega_1 (1 + {distance:g})"
        yield Case("singular blocks", name, structure, omega, law, 5, "closed", linear)


def two_orbits(quick: bool) -> Iterator[Case]:
    """Two masses and a stop: an orbit that touches it, and one that does not."""
    structure, law = common.two_masses(), fc.UnilateralPenalty(100.0)
    curve = fc.continue_frequency(structure, 0.6, 0.9, law, harmonics=41)
    passes = np.flatnonzero((curve.omega[:-1] - 0.7) * (curve.omega[1:] - 0.7) < 0.0)
    for number, index in enumerate(passes):
        name = f"orbit {number + 1} of {len(passes)} at 0.70"
        start = curve.solution(int(index))
        yield Case("two orbits", name, structure, 0.7, law, 41, initial=start)


if __name__ == "__main__":
    main()
