"""Cracks with many pairs, lips without mass: error against time, verdicts, large meshes.

plate: breathing_plate with 18 pairs and 1 % of damping on all modes; rigid contact and penalties
of 1e9 and 1e11 N/m, 1000 to 3000 rad/s in steps of 100, every solution from a cold start. The
reference is the whole finite-element model with mass on its lips: all of its modes (LAPACK), H =
REFERENCE; that with half as many harmonics says how far it has converged. Reported: time after
set-up (processor, one thread), iterations, errors of the gap and of the displacement at the load,
true and estimated.

today: the same by the form with mass on the lips (``free_interface``, 50 modes), for the picture.

march: the same plate, 1e9 N/m, marched from rest at 2000 rad/s to the orbit: exponential steps
against central differences on the whole model; steps in all, and error of the gap.

steel: 80 x 200 x 2 mm, edge crack 25 mm, 8 pairs, rigid, 0.2 % of damping, 20 modes; 6000 to 15000
rad/s in steps of 100. Each verdict against a march of the disturbed orbit: does the distance from
one period to the next grow or fall? And curves from 6000 to 11000 rad/s, judged by exact orbits.

large: 62 and 130 pairs, 49,000 and 200,000 dofs: time of solutions and their errors, true and
estimated, with few modes and many; the reference has 1000 and 600 modes and 120 harmonics. Only
what pairs and load see of the modes is kept.

unknowns: cold solutions from 18 to 130 pairs and from 10 to 40 harmonics on one coarse mesh with
ever finer lips, 100 modes, rigid and 1e9 N/m: how time grows with the number of unknowns.

curves: the plate that ``new`` writes with 8 and 20 pairs, rigid, 1 %, 30 modes, from 0.75 to 1.25
times its first frequency: what a point of a curve costs in the kernel and, in the same run, by the
loops of Python; how far the two curves are apart at the frequencies of the one.

given: H = 5 to 40, rigid, 150 modes, the plate and the steel plate: time of the search alone, with
the error, and of the verdict; the stated error over the distance to the orbit found from H = 80.
Run with another version it is what the times of this one are compared with.

    OMP_NUM_THREADS=1 python benchmarks/many_pairs.py [--quick] [--only PART] [folder]
"""

from __future__ import annotations

import itertools
import time
from itertools import pairwise
from pathlib import Path
from typing import Any
from unittest.mock import patch

import common
import numpy as np
import scipy.linalg
import scipy.sparse as sparse

import fenics_crack as fc
from fenics_crack.balance.assessment import distance
from fenics_crack.balance.solution import Solver
from fenics_crack.curves.waves import Waves
from fenics_crack.model.factor import Factor
from fenics_crack.numerics.fourier import evaluate
from fenics_crack.time.flows import ExponentialFlow

REFERENCE = 120
NEW = Path(__file__).with_name("plate.toml")
LAWS: dict[str, Any] = {
    "rigid": fc.UnilateralConstraint(),
    "1e9 N/m": fc.UnilateralPenalty(1e9),
    "1e11 N/m": fc.UnilateralPenalty(1e11),
}
SETTINGS = ((50, 10), (110, 20), (110, 40), (300, 40), (300, 80), (600, 80))
"""Modes and harmonics."""
COLUMNS = (
    "law", "omega", "modes", "H", "converged", "ms", "iterations", "gap", "estimate",
    "displacement", "its estimate", "way",
)  # fmt: skip
INSTANTS = 1024


def main() -> None:
    """Run it."""
    common.run(
        __doc__,
        {
            "plate": plate, "today": today, "march": march, "steel": steel, "large": large,
            "unknowns": unknowns, "curves": curves, "given": given,
        },
    )  # fmt: skip


# --- error against time ---------------------------------------------------------------------------


def damped_plate() -> fc.Structure:
    """The breathing plate with all modes damped."""
    return common.plate("breathing_plate", {"damping.ratio": 0.01, "damping.modes": "all"})


def all_of_it(whole: fc.Structure, ratio: float) -> fc.MasslessStructure:
    """A whole structure by all of its modes; those beyond 2 H omega, at most, in their statics."""
    matrices = [m[:, :] for m in (whole.stiffness, whole.mass)]
    squares, shapes = scipy.linalg.eigh(*matrices)
    sources = np.vstack([whole.gap.T @ shapes, whole.force[2] @ shapes]).T
    slow = squares <= (2.0 * REFERENCE * 3000.0) ** 2
    compliance = (sources[~slow].T / squares[~slow]) @ sources[~slow]
    pattern = np.zeros((3, len(compliance)))
    pattern[2, -1] = 1.0  # the load is a sine
    return fc.MasslessStructure(
        whole,
        squares[slow],
        fc.ModalDamping(ratio),
        sources[slow, :-1],
        np.hstack([whole.force @ shapes[:, slow], pattern @ compliance]),
        compliance,
    )


def waves(solution: fc.PeriodicSolution) -> tuple[np.ndarray, np.ndarray]:
    """Gap and displacement at the load over a period."""
    instants = np.arange(INSTANTS) * solution.period / INSTANTS
    structure = solution.structure
    rows = solution.displacement_coefficients @ structure.force[2]
    return solution.gap(instants), evaluate(rows, solution.base_omega, instants)


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """Relative L2 difference."""
    return float(np.linalg.norm(one - other) / np.linalg.norm(other))


def references(
    whole: fc.MasslessStructure, near: fc.Structure, omegas: np.ndarray
) -> dict[tuple[str, float], tuple[np.ndarray, np.ndarray]]:
    """The waves of the whole model, and how far they have converged."""
    found, left = {}, []
    for name, law in LAWS.items():
        for omega in omegas:
            start = fc.solve_harmonic_balance(near, omega, law, harmonics=40)
            both = []
            for harmonics in (REFERENCE // 2, REFERENCE):
                start = fc.solve_harmonic_balance(
                    whole, omega, law, harmonics=harmonics, initial=start
                )
                both.append(waves(start))
            found[name, omega] = both[1]
            left.append([apart(*pair) for pair in zip(*both, strict=True)])
    gap, displacement = np.median(left, axis=0), np.max(left, axis=0)
    print(
        f"reference, H = {REFERENCE // 2} against {REFERENCE}: gap median {gap[0]:.1e} largest "
        f"{displacement[0]:.1e}, displacement median {gap[1]:.1e} largest {displacement[1]:.1e}"
    )
    return found


def plate(arguments: common.Arguments) -> None:
    """Error against time."""
    omegas = np.arange(1000.0, 3001.0, 500.0 if arguments.quick else 100.0)
    structure = damped_plate()
    known = references(
        all_of_it(structure, 0.01), fc.reduce_structure(structure, modes=300, method="massless"),
        omegas,
    )  # fmt: skip
    rows = []
    for modes, harmonics in SETTINGS:
        reduced = fc.reduce_structure(structure, modes=modes, method="massless")
        for name, law in LAWS.items():
            for omega in omegas:
                rows.append(judged(reduced, (name, law), omega, harmonics, known[name, omega]))
    common.write_csv(arguments.folder / "many_pairs.csv", COLUMNS, rows)
    summary = []
    for modes, harmonics in SETTINGS:
        for name in LAWS:
            some = [row for row in rows if row[0] == name and row[2:4] == (modes, harmonics)]
            numbers = np.array([row[5:11] for row in some], dtype=float)
            within = [
                np.mean([1 / 3 <= row[b] / row[a] <= 3 for row in some])
                for a, b in ((7, 8), (9, 10))
            ]
            summary.append(
                (name, modes, harmonics, sum(row[4] for row in some), len(some),
                 *np.median(numbers, axis=0), numbers[:, 2].max(), *within)
            )  # fmt: skip
    common.print_table(
        "Breathing plate, 18 pairs, cold starts: medians over the frequencies",
        ("law", "modes", "H", "converged", "of", "ms", "iterations", "gap", "estimate",
         "displacement", "its estimate", "gap, worst", "within 3", "its"),
        summary,
    )  # fmt: skip


def judged(
    reduced: fc.Structure,
    law: tuple[str, Any],
    omega: float,
    harmonics: int,
    known: tuple[np.ndarray, np.ndarray],
) -> tuple[Any, ...]:
    """One cold start."""
    started = time.process_time()
    found = fc.solve_harmonic_balance(reduced, omega, law[1], harmonics=harmonics, throw=False)
    ms = 1e3 * (time.process_time() - started)
    gap, displacement = (apart(*pair) for pair in zip(waves(found), known, strict=True))
    modes = getattr(reduced, "n_modes", reduced.n_dofs)
    return (
        law[0], omega, modes, harmonics, found.converged, ms, found.iterations, gap,
        found.report.total, displacement, found.report.displacement, found.status,
    )  # fmt: skip


def today(arguments: common.Arguments) -> None:
    """The form with mass on the lips, which truncates the gap itself, beside the new one."""
    omegas = np.arange(1000.0, 3001.0, 1000.0 if arguments.quick else 500.0)
    structure, law = damped_plate(), LAWS["1e9 N/m"]
    near = fc.reduce_structure(structure, modes=300, method="massless")
    known = {
        omega: waves(fc.solve_harmonic_balance(near, omega, law, harmonics=80)) for omega in omegas
    }
    with_mass = fc.reduce_structure(structure, modes=50, method="free_interface")
    curves: dict[str, list[tuple[float, float]]] = {}
    for harmonics in (5, 10, 20, 40):
        measured: dict[str, list[tuple[float, float]]] = {}
        for omega in omegas:
            for name, reduced in (("mass on the lips", with_mass), ("massless", near)):
                row = judged(reduced, (name, law), omega, harmonics, known[omega])
                measured.setdefault(name, []).append((row[5], row[7]))
        for name, points in measured.items():
            curves.setdefault(name, []).append(tuple(np.median(points, axis=0)))
    slow = fc.reduce_structure(structure, modes=50, method="massless")
    for steps in (128, 256, 512, 1024, 2048):
        points = []
        for omega in omegas:
            ms, gap, _ = marched(slow, omega, law, steps)
            points.append((ms, apart(gap, known[omega][0])))
        curves.setdefault("marched from rest, 50 modes", []).append(
            tuple(np.median(points, axis=0))
        )
    rows = [(name, *point) for name, points in curves.items() for point in points]
    common.save_table(
        arguments.folder / "many_pairs_time.csv", "Error against time, 1e9 N/m",
        ("form", "ms", "gap"), rows,
    )  # fmt: skip
    drawing, (axes,) = common.figure()
    for (name, points), mark in zip(curves.items(), "os^", strict=True):
        axes.loglog(*np.array(points).T, marker=mark, label=name)
    axes.set_xlabel("processor time of a cold start [ms]")
    axes.set_ylabel("relative error of the gap")
    axes.set_title("Breathing plate, 18 pairs, 1e9 N/m")
    axes.legend()
    drawing.savefig(arguments.folder / "many_pairs.png")


def marched(
    reduced: fc.Structure, omega: float, law: Any, steps: int
) -> tuple[float, np.ndarray, int]:
    """Time [ms], gap and periods of a march from rest until it repeats to 1e-3."""
    started = time.process_time()
    found = fc.integrate_exponential(
        reduced, omega, law, periods=400, steps_per_period=steps, settle=1e-3, record_periods=1
    )
    ms = 1e3 * (time.process_time() - started)
    instants = np.arange(INSTANTS) * steps / INSTANTS
    columns = [np.interp(instants, np.arange(steps), wave, period=steps) for wave in found.gap.T]
    return ms, np.array(columns).T, found.periods


def march(arguments: common.Arguments) -> None:
    """From rest to the orbit in time: steps and error against central differences."""
    omega, law = 2000.0, LAWS["1e9 N/m"]
    structure = damped_plate()
    near = fc.reduce_structure(structure, modes=300, method="massless")
    known = waves(fc.solve_harmonic_balance(near, omega, law, harmonics=80))[0]
    rows = []
    slow = fc.reduce_structure(structure, modes=50, method="massless")
    for steps in (64, 128, 256, 512, 1024):
        ms, gap, periods = marched(slow, omega, law, steps)
        rows.append(("exponential", steps, periods, steps * periods, 1e-3 * ms,
                     1e3 * ms / steps / periods, apart(gap, known)))  # fmt: skip
    damped = common.plate("breathing_plate", {"damping.ratio": 0.01, "damping.modes": 150})
    steps = 2 * fc.stable_steps_per_period(damped, omega, law)
    periods = 5 if arguments.quick else 200
    started = time.process_time()
    found = fc.integrate_central_difference(
        damped, omega, law, periods=periods, steps_per_period=steps, settle=1e-3, record_periods=1
    )
    seconds = time.process_time() - started
    places = np.linspace(0, steps, INSTANTS, endpoint=False)
    gap = np.array([np.interp(places, np.arange(steps), wave) for wave in found.gap.T]).T
    rows.append(("central differences", steps, found.periods, steps * found.periods, seconds,
                 1e6 * seconds / steps / found.periods, apart(gap, known)))  # fmt: skip
    common.save_table(
        arguments.folder / "many_pairs_march.csv",
        "From rest to the orbit, 2000 rad/s, 1e9 N/m",
        ("scheme", "steps a period", "periods", "steps", "s", "us a step", "gap"),
        rows,
    )


# --- verdicts -------------------------------------------------------------------------------------


def steel_plate(modes: int = 20) -> fc.Structure:
    """80 x 200 x 2 mm, edge crack 25 mm, 8 pairs, 0.2 % of damping."""
    scene = fc.Scene.load(common.DEMOS / "breathing_plate.toml").replace(
        {
            "crack.first_omega": None, "crack.length": 0.025, "crack.height": 0.1,
            "geometry.width": 0.08, "geometry.height": 0.2, "geometry.thickness": 0.002,
            "material.young": 2.1e11, "material.density": 7850.0, "damping.ratio": 0.002,
            "damping.modes": "all", "excitation.point": [0.08, 0.2], "mesh.size": 0.008,
            "mesh.lip_elements": 4,
        }
    )  # fmt: skip
    return fc.reduce_structure(fc.build_structure(scene), modes=modes, method="massless")


def steel(arguments: common.Arguments) -> None:
    """Verdicts, and a curve."""
    reduced, law = steel_plate(), LAWS["rigid"]
    rows = []
    for omega in np.arange(6000.0, 15001.0, 1500.0 if arguments.quick else 100.0):
        started = time.process_time()
        found = fc.solve_harmonic_balance(reduced, omega, law, harmonics=20, throw=False)
        solved = 1e3 * (time.process_time() - started)
        started = time.process_time()
        stability = fc.floquet(reduced, found) if found.converged else None
        judged_in = 1e3 * (time.process_time() - started)
        if stability is None:
            rows.append((omega, solved, judged_in, "-", np.nan, np.nan, np.nan, "-"))
            continue
        rate = disturbed(reduced, found, law)
        decided = stability.verdict != "undecided" and np.isfinite(rate)
        agrees = "-"
        if decided:
            agrees = "yes" if (rate < 1.0) == (stability.verdict == "stable") else "NO"
        size = float(abs(stability.multipliers[0]))
        rows.append((omega, solved, judged_in, stability.verdict, size, stability.uncertainty,
                     rate, agrees))  # fmt: skip
    common.save_table(
        arguments.folder / "many_pairs_steel.csv", "Steel plate, rigid, 0.2 %",
        ("omega", "ms", "verdict ms", "verdict", "|mu|", "uncertainty", "rate", "agrees"), rows,
    )  # fmt: skip
    decided = sum(row[3] in ("stable", "unstable") for row in rows)
    agree = sum(row[7] == "yes" for row in rows)
    compared = sum(row[7] != "-" for row in rows)
    print(f"{decided} of {len(rows)} decided; {agree} of {compared} agree with the disturbed march")
    stop = 7000.0 if arguments.quick else 11000.0
    for harmonics in (10,) if arguments.quick else (10, 20):
        judged_curve(reduced, law, stop, harmonics)


def judged_curve(reduced: fc.Structure, law: Any, stop: float, harmonics: int) -> None:
    """A curve from 6000 rad/s, judged by exact orbits; verdicts of some points by marches."""
    problem = fc.Problem(reduced, 6000.0, law, harmonics)
    started = time.process_time()
    growing = fc.Continuation(problem, "omega", 6000.0, stop)
    growing.run()
    followed = time.process_time() - started
    curve = fc.judge_curve(growing.curve)
    judged = time.process_time() - started - followed
    found = curve.bifurcations
    kinds = [bifurcation.kind for bifurcation in found]
    print(
        f"\ncurve 6000 to {stop:g} rad/s, H = {harmonics}: {curve.status}, {len(curve)} points in "
        f"{followed:.1f} s, judged in {judged:.1f} s, {curve.undecided.sum()} points "
        f"undecided, {len(kinds)} bifurcations: "
        + ", ".join(f"{kinds.count(kind)} {kind}" for kind in sorted(set(kinds)))
    )
    print("  " + ", ".join(f"{one.kind} {one.value:.1f}" for one in found))
    growths = unstable_growths(curve)
    print(
        f"  {len(growths)} unstable stretches between neighbouring ones; |mu| - 1 beyond "
        + ", ".join(f"{least:g}: {np.sum(growths > least)}" for least in (1e-3, 3e-3, 1e-2, 3e-2))
    )
    compared = agree = 0
    for index in range(0, len(curve), max(1, len(curve) // 20)):
        if curve.verdicts[index] == "undecided":
            continue
        rate = disturbed(reduced, curve.solution(index), law)
        if np.isfinite(rate):
            compared += 1
            agree += (rate < 1.0) == (curve.verdicts[index] == "stable")
    print(f"  {agree} of {compared} points agree with the disturbed march")


def unstable_growths(curve: fc.ResponseCurve) -> np.ndarray:
    """|mu| - 1 of the marched orbits half way between neighbouring bifurcations, where
    it is positive."""
    known = curve.bifurcations
    growths = []
    for one, other in pairwise(known):
        middle = 0.5 * (one.value + other.value)
        index = int(np.argmin(np.abs(curve.omega - middle)))
        near = curve.solution(index)
        try:
            found = fc.solve_harmonic_balance(
                curve.structure, middle, curve.contact, harmonics=near.harmonics, initial=near
            )
            orbit = fc.shoot(curve.structure, found, tolerance=1e-8)
        except fc.ConvergenceError:
            continue
        growths.append(abs(orbit.multipliers[0]) - 1.0)
    return np.array([growth for growth in growths if growth > 0.0])


def disturbed(reduced: fc.Structure, solution: fc.PeriodicSolution, law: Any) -> float:
    """Factor per period by which the distance to the marched orbit changes in the norm of energy,
    after a disturbance of 1e-8 and up to 200 periods; nan without an orbit."""
    try:
        orbit = fc.shoot(reduced, solution, tolerance=1e-11)
    except fc.ConvergenceError:
        return float("nan")
    flow = ExponentialFlow(reduced, solution.omega, law, 4096)
    state, omega = orbit.state, np.sqrt(flow.modes.squares)
    energy = np.concatenate([omega, np.ones_like(omega)])
    size = np.linalg.norm(energy * state)
    change = np.random.default_rng(0).normal(size=len(state)) / energy
    moved = state + 1e-8 * size * change / np.linalg.norm(energy * change)
    distances = []
    for _ in range(200):
        moved = flow.advance(moved).states[-1]
        distances.append(np.linalg.norm(energy * (moved - state)))
        if not 1e-11 * size < distances[-1] < 1e-3 * size:
            break
    tail = np.log(distances[len(distances) // 4 :])
    return float(np.exp(np.polyfit(np.arange(len(tail)), tail, 1)[0]))


# --- large meshes ---------------------------------------------------------------------------------


def large(arguments: common.Arguments) -> None:
    """62 and 130 pairs: error against time. Cold with 40 harmonics, from there with 80; the
    reference has more modes, and half as many harmonics more."""
    rows = []
    for size, elements, counts in (
        (0.0021, 31, (120, 300, 450, 600, 1000)), (0.00103, 65, (80, 120, 300, 450, 600))
    ):  # fmt: skip
        if arguments.quick and elements > 31:
            continue
        scene = fc.Scene.load(common.DEMOS / "breathing_plate.toml").replace(
            {
                "crack.first_omega": None, "crack.length": 0.0431, "damping.ratio": 0.01,
                "damping.modes": "all", "mesh.size": size, "mesh.lip_elements": elements,
            }
        )  # fmt: skip
        structure = fc.build_structure(scene)
        memory, started = common.PeakMemory(), time.process_time()
        squares, seen, statics = seen_modes(structure, counts[-1])
        set_up, peak = time.process_time() - started, memory.mib()
        print(f"{structure.n_dofs} dofs: {counts[-1]} modes in {set_up:.0f} s, {peak:.0f} MiB")
        reference = of_seen_modes(structure, squares, seen, statics)
        for name in ("rigid", "1e9 N/m"):
            exact = None
            for harmonics in (40, 80, 120):
                exact = fc.solve_harmonic_balance(
                    reference, 2000.0, LAWS[name], harmonics=harmonics, initial=exact
                )
            assert exact is not None
            known = waves(exact)
            for modes in counts[:-1]:
                more = of_seen_modes(structure, *first(modes + modes // 2, squares, seen), statics)
                reduced = of_seen_modes(structure, *first(modes, squares, seen), statics, more)
                found, seconds = None, 0.0
                for harmonics in (40, 80):
                    started = time.process_time()
                    found = fc.solve_harmonic_balance(
                        reduced, 2000.0, LAWS[name], harmonics=harmonics, initial=found,
                        throw=False,
                    )  # fmt: skip
                    seconds += time.process_time() - started
                    gap, displacement = (
                        apart(*pair) for pair in zip(waves(found), known, strict=True)
                    )
                    report = found.report
                    rows.append((structure.n_dofs, structure.n_pairs, name, modes, harmonics,
                                 found.converged, seconds, gap, displacement,
                                 report.truncation, report.reduction))  # fmt: skip
    common.save_table(
        arguments.folder / "many_pairs_large.csv", "Large meshes, 2000 rad/s",
        ("dofs", "pairs", "law", "modes", "H", "converged", "s", "gap", "displacement",
         "truncation", "reduction"),
        rows,
    )  # fmt: skip


def unknowns(arguments: common.Arguments) -> None:
    """Time of cold solutions against the number of unknowns, and the exponent that fits."""
    rows = []
    for elements in (9, 20, 30, 65):
        scene = fc.Scene.load(common.DEMOS / "breathing_plate.toml").replace(
            {
                "crack.first_omega": None, "crack.length": 0.0431, "damping.ratio": 0.01,
                "damping.modes": "all", "mesh.size": 0.01, "mesh.lip_elements": elements,
            }
        )  # fmt: skip
        reduced = fc.reduce_structure(fc.build_structure(scene), modes=100, method="massless")
        for name, harmonics in itertools.product(("rigid", "1e9 N/m"), (10, 20, 40)):
            for omega in (1400.0, 2000.0) if arguments.quick else (1000.0, 1400.0, 2000.0, 2600.0):
                started = time.process_time()
                found = fc.solve_harmonic_balance(
                    reduced, omega, LAWS[name], harmonics=harmonics, throw=False
                )
                seconds = time.process_time() - started
                size = found.gap_coefficients.size
                rows.append((name, reduced.n_pairs, harmonics, size, omega, found.converged,
                             seconds, found.iterations, found.report.truncation))  # fmt: skip
    common.save_table(
        arguments.folder / "many_pairs_unknowns.csv", "Cold solutions, 100 modes",
        ("law", "pairs", "H", "unknowns", "omega", "converged", "s", "iterations", "truncation"),
        rows,
    )  # fmt: skip
    for name in ("rigid", "1e9 N/m"):
        size, seconds = np.array([(row[3], row[6]) for row in rows if row[0] == name]).T
        exponent = np.polyfit(np.log(size), np.log(seconds), 1)[0]
        print(f"{name}: time like unknowns^{exponent:.2f}, at most {seconds.max():.1f} s")


def seen_modes(structure: fc.Structure, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Squares of the lowest frequencies, and what pairs and load see of the modes: (count,) and
    (count, n_pairs + 1); the static compliance between these."""
    sources = sparse.hstack([structure.gap, structure.force[2:].T]).tocsr()
    with Factor(structure.stiffness, definite=True) as factor:
        columns = [
            sources.T @ factor.solve(sources[:, start : start + 16].T.toarray()).T
            for start in range(0, sources.shape[1], 16)
        ]
    modes = fc.solve_modes(structure, count)
    return modes.omega**2, (sources.T @ modes.shapes).T, np.hstack(columns)


def first(count: int, squares: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The lowest modes."""
    return squares[:count], seen[:count]


def of_seen_modes(
    structure: fc.Structure,
    squares: np.ndarray,
    seen: np.ndarray,
    statics: np.ndarray,
    reference: fc.MasslessStructure | None = None,
) -> fc.MasslessStructure:
    """A reduction of which no displacement but that at the load is asked for."""
    compliance = statics - (seen.T / squares) @ seen
    force = np.zeros((3, len(squares) + len(statics)))
    force[2] = np.concatenate([seen[:, -1], compliance[-1]])
    return fc.MasslessStructure(
        structure, squares, fc.ModalDamping(0.01), seen[:, :-1], force, compliance,
        reference=reference,
    )  # fmt: skip


# --- a point of a curve ---------------------------------------------------------------------------


def curves(arguments: common.Arguments) -> None:
    """In the kernel and in Python, by turns."""
    rows = []
    for elements, harmonics in ((4, 10), (4, 20)) if arguments.quick else (
        (4, 10), (4, 20), (4, 40), (10, 20)
    ):  # fmt: skip
        scene = fc.Scene.load(NEW).replace(
            {"mesh.lip_elements": elements, "damping.ratio": 0.01}
        )  # fmt: skip
        structure = fc.reduce_structure(fc.build_structure(scene), modes=30, method="massless")
        span, found = 0.75 * structure.omega[0], {}

        def follow(structure=structure, span=span, harmonics=harmonics) -> fc.ResponseCurve:
            return fc.continue_frequency(
                structure, span, span / 0.6, LAWS["rigid"], harmonics=harmonics, throw=False
            )

        for name, compiled in (("kernel", Waves.compiled), ("Python", None)):
            with patch.object(Waves, "compiled", compiled):
                follow()
                started = time.process_time()
                found[name] = follow()
                found[name, "ms"] = 1e3 * (time.process_time() - started) / len(found[name])
        one, other = found["kernel"], found["Python"]
        count = min(len(one), len(other))
        apart = np.abs(one.values[:count] / other.values[:count] - 1.0).max()
        rows.append((structure.n_pairs, harmonics, len(one), len(other), found["kernel", "ms"],
                     found["Python", "ms"], apart))  # fmt: skip
    common.save_table(
        arguments.folder / "many_pairs_curves.csv", "A point of a curve",
        ("pairs", "H", "points", "in Python", "ms", "ms in Python", "apart"), rows,
    )  # fmt: skip


# --- H given --------------------------------------------------------------------------------------


def given(arguments: common.Arguments) -> None:
    """The search alone, its error and its verdict."""
    plate = fc.reduce_structure(damped_plate(), modes=150, method="massless")
    some = slice(None, None, 5 if arguments.quick else 1)
    frequencies = {
        "plate": np.arange(1000.0, 3001.0, 100.0),
        "steel": np.arange(6e3, 15001.0, 750.0),
    }
    rows = []
    for name, structure in (("plate", plate), ("steel", steel_plate(150))):
        for omega in frequencies[name][some]:
            orbit = None
            for harmonics in (80, 5, 10, 20, 40):
                problem, times = fc.Problem(structure, omega, LAWS["rigid"], harmonics), []
                if harmonics == 80:
                    orbit = solved(problem).assessment.orbit
                    continue
                started = time.process_time()
                found = solved(problem)
                times.append(1e3 * (time.process_time() - started))
                assert found.report.estimated
                times.append(1e3 * (time.process_time() - started))
                started = time.process_time()
                verdict = fc.floquet(structure, found).verdict if found.converged else "-"
                times.append(1e3 * (time.process_time() - started))
                away = np.nan if orbit is None else distance(found, orbit)
                stated = found.report.truncation
                rows.append((name, omega, harmonics, *times, verdict, stated, away, stated / away))
    common.save_table(
        arguments.folder / "many_pairs_given.csv", "H given, rigid, 150 modes",
        ("case", "omega", "H", "search ms", "with error", "verdict", "is", "stated", "true",
         "ratio"),
        rows,
    )  # fmt: skip
    ratios = np.array([row[-1] for row in rows])
    within = np.mean((ratios >= 0.4) & (ratios <= 3.0))
    print(f"stated over true within .4 to 3: {within:.2f} of {len(rows)}")


def solved(problem: fc.Problem) -> fc.PeriodicSolution:
    """From a cold start."""
    return Solver(problem, throw=False).attempt(None)[1]


if __name__ == "__main__":
    main()
