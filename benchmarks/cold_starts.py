"""What converges from a cold start, without hand-tuning, and at what cost.

Every solution starts from the linear one; nothing is passed on from a neighbouring frequency.

oscillator : m = 1, c = 0.02, k = 1, f = 0.1 cos(w t), a stop of kc = 1, 10, 100, 1000 at zero
    clearance; 300 frequencies from 0.3 to 2, H = 5, 10, 20: 3,600 solutions.
plate : ``demos/breathing_plate.toml``, contact on all pairs, 1e9 and 1e11 N/m a pair, 1000 to 3000
    rad/s in steps of 100; H = 5, 10, 20, 40 on the reduced structure, H = 5, 10 also with the exact
    dynamic compliance of the whole one. With H = 40 harmonics reach 120,000 rad/s: there 150 modes
    are damped, to 111,000 rad/s, instead of 50, to 60,000 rad/s.
constraint : no penetration at all, the same frequencies and H, on ``demos/paper_plate.toml`` with
    damping ratios 0.001 and 0.01 and on the reduced breathing plate (there H = 5, 10 and every
    fourth frequency with H = 20). Where the default weight fails, the history of the residual is
    printed, and up to H = 10 other weights are tried.

friction : 40 random cases with friction: chains of a few masses with mass at the faces, the plates
of ``demos/`` with one pair, 16 and 18 pairs, up to three times as much mean load that shuts the
crack, mu from 0.05 to 1, H = 5 to 100 or a tolerance. What each took, and its answer.

Converged means |F| <= 1e-10 |x|. Costs are the Newton iterations of all attempts, as counted by the
solution, and milliseconds, the error report included. Milliseconds depend on the machine. The table
also gives their ratio to the median of the solutions that took plain Newton steps alone, or where
there is none, to the quickest solution of that row.

    OMP_NUM_THREADS=1 python benchmarks/cold_starts.py [--quick] [--only PART] [folder]
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import common
import numpy as np

import fenics_crack as fc
from fenics_crack.draw.figure import COLOURS

PLAIN, PATH, FAILED = "plain Newton", "stiffness path", "failed"
WEIGHTS = (0.1, 10.0, 100.0)
"""Times the default weight, where that fails and H <= 10."""


@dataclass(frozen=True)
class Point:
    """One solution: what, where, and what it took."""

    case: str
    stiffness: float
    harmonics: int
    omega: float
    converged: bool
    way: str
    iterations: int
    milliseconds: float
    truncation: float
    weight: float = float("nan")
    status: str = ""


def main() -> None:
    """Run the parts asked for."""
    common.run(
        __doc__,
        {
            "oscillator": run_oscillator,
            "plate": run_plate,
            "constraint": run_constraint,
            "friction": run_friction,
        },
        harmonics={"type": int, "nargs": "+", "help": "of the plate: these H alone"},
    )


def run_oscillator(arguments: common.Arguments) -> None:
    """3,600 solutions of a bilinear oscillator."""
    structure = common.oscillator()
    frequencies = np.linspace(0.3, 2.0, 30 if arguments.quick else 300)
    points = [
        solve(structure, omega, fc.UnilateralPenalty(kc), harmonics, "oscillator")
        for kc in (1.0, 10.0, 100.0, 1000.0)
        for harmonics in (5, 10, 20)
        for omega in frequencies
    ]
    report("Bilinear oscillator, w = 0.3 to 2", points, arguments.folder / "cold_starts_oscillator")


def run_plate(arguments: common.Arguments) -> None:
    """Contact all along the crack of the breathing plate."""
    quick, only = arguments.quick, arguments.harmonics
    whole = common.plate("breathing_plate")
    reduced = fc.reduce_structure(whole)
    frequencies = np.arange(1000.0, 3001.0, 500.0 if quick else 100.0)
    runs = [("reduced", reduced, h) for h in ((5, 10) if quick else (5, 10, 20))]
    runs += [("exact", whole, h) for h in ((5,) if quick else (5, 10))]
    if not quick and (not only or 40 in only):
        damped = common.plate("breathing_plate", {"damping.modes": 150})
        runs.append(("reduced, 150", fc.reduce_structure(damped), 40))
    points: list[Point] = []
    for name, structure, harmonics in runs:
        if only and harmonics not in only:
            continue
        for k in (1e9, 1e11):
            for omega in frequencies:
                points.append(solve(structure, omega, fc.UnilateralPenalty(k), harmonics, name))
                last = points[-1]
                if harmonics >= 40:  # these take a while
                    print(f"H = {harmonics}, k = {k:g}, {omega:g} rad/s: {last.way}", flush=True)
    title = f"Breathing plate, {whole.n_pairs} pairs, 1000 to 3000 rad/s"
    suffix = "_H" + "_".join(map(str, only)) if only else ""
    report(title, points, arguments.folder / f"cold_starts_plate{suffix}")


def run_constraint(arguments: common.Arguments) -> None:
    """No penetration: what converges, and what happens where it does not."""
    folder, quick = arguments.folder, arguments.quick
    cases: list[tuple[str, fc.Structure, Sequence[int]]] = [
        (
            f"paper xi={ratio}",
            common.plate("paper_plate", {"damping.ratio": ratio}),
            (5, 10, 20, 40),
        )
        for ratio in (0.001, 0.01)
    ]
    cases.append(("breathing", fc.reduce_structure(common.plate("breathing_plate")), (5, 10, 20)))
    frequencies = np.arange(1000.0, 3001.0, 500.0 if quick else 100.0)
    points, again = [], []
    for name, structure, counts in cases:
        for harmonics in counts[:2] if quick else counts:
            # 740 unknowns and many attempts: a few frequencies tell enough.
            sparse = name == "breathing" and harmonics == 20 and not quick
            for omega in frequencies[::4] if sparse else frequencies:
                point = solve(structure, omega, fc.UnilateralConstraint(), harmonics, name)
                points.append(point)
                if not point.converged:
                    again.append(point)
                    if harmonics <= 10:  # the paths to stiff starts are long
                        again += other_weights(structure, point)
    report("No penetration, 1000 to 3000 rad/s", points, folder / "cold_starts_constraint")
    if again:
        columns = ("case", "H", "omega", "weight [N/m]", "converged", "how the last attempt went")
        rows = [(p.case, p.harmonics, p.omega, p.weight, p.converged, p.status) for p in again]
        title = "Where the default weight fails (its line first)"
        common.save_table(folder / "cold_starts_constraint_weights.csv", title, columns, rows)


def run_friction(arguments: common.Arguments) -> None:
    """40 random cases."""
    rows = []
    for number in range(8 if arguments.quick else 40):
        name, structure, omega, law, options = friction_case(number)
        started = time.process_time()
        found = fc.solve_harmonic_balance(structure, omega, law, throw=False, **options)
        seconds, report = time.process_time() - started, found.report
        row = number, name, structure.n_dofs, str(options), seconds, found.converged
        rows.append((*row, found.harmonics, report.truncation, report.reduction, found.status))
    title = "Friction, random cases"
    columns = (
        "case",
        "of",
        "dofs",
        "asked",
        "s",
        "converged",
        "H",
        "truncation",
        "modes",
        "status",
    )
    common.save_table(arguments.folder / "cold_starts_friction.csv", title, columns, rows)


def friction_case(
    number: int,
) -> tuple[str, fc.Structure, float, fc.CoulombFriction, dict[str, Any]]:
    """Name, structure, frequency, law and what is asked for."""
    random = np.random.default_rng(4000 + number)
    mu, ratio = (
        float(np.exp(random.uniform(*np.log(ends)))) for ends in ((0.05, 1), (0.001, 0.02))
    )
    name = ("chain", "inclined_crack", "breathing_plate", "paper_plate")[number % 4]
    shut = float(random.choice([0.0, 0.3, 1.0, 3.0]))
    if name == "chain":
        pairs = int(random.integers(1, 4))
        count = 2 * pairs + int(random.integers(0, 5))
        mixed = random.normal(size=(count, count))
        stiffness = np.diag(random.uniform(0.5, 2.0, count)) + 0.3 * mixed @ mixed.T / count
        mass = np.diag(random.uniform(0.5, 2.0, count))
        tangential, gap = np.eye(count)[:, : 2 * pairs : 2], np.eye(count)[:, 1 : 2 * pairs : 2]
        structure: fc.Structure = fc.Structure.from_matrices(
            mass, stiffness, gap=gap, tangential=tangential, force_cos=random.normal(size=count),
            force_mean=shut * gap.sum(axis=1) * np.abs(random.normal(size=count)),
            damping=fc.ModalDamping(ratio),
        )  # fmt: skip
        normal = float(10 ** random.uniform(0.0, 2.5))
        law = fc.CoulombFriction(
            fc.UnilateralPenalty(normal), mu, normal * random.uniform(0.3, 1.0)
        )
        near = np.sqrt(np.linalg.eigvalsh(np.linalg.solve(mass, stiffness)))
    elif name == "paper_plate":
        structure = pressed(name, random.uniform(0.0, 6.28), shut)
        structure = structure.damped(fc.ModalDamping(max(ratio, 0.005)))
        law = fc.CoulombFriction(fc.UnilateralPenalty(1e10), mu, 1e10)
        near = fc.bilinear_frequencies(structure).omega_bilinear
    else:
        modes = int(random.choice([10, 20, 40]))
        structure = pressed(name, random.uniform(0.0, 6.28), shut)
        structure = structure.damped(fc.ModalDamping(ratio, modes))
        structure = fc.reduce_structure(structure, modes=modes, method="massless")
        law = fc.CoulombFriction(fc.UnilateralConstraint(), mu)
        near = fc.bilinear_frequencies(structure).omega_bilinear
    omega = float(near[random.integers(0, 2)] * random.choice([1.0, random.uniform(0.85, 1.15)]))
    options: dict[str, Any]
    if random.random() < 0.6:
        options = {"harmonics": int(random.choice([5, 10, 20, 40, 100]))}
    else:
        options = {"tolerance": float(random.choice([0.05, 1e-2, 1e-3]))}
    return name, structure, omega, law, options


def pressed(name: str, angle: float, shut: float) -> fc.Structure:
    """A plate of ``demos/`` loaded from an angle, with so many times as much mean load in the
    direction that shuts its crack most."""
    scene = fc.Scene.load(common.DEMOS / f"{name}.toml")
    given = scene.excitation
    size = float(np.linalg.norm([*given.force_sin, *given.force_cos]))

    def loaded(force: np.ndarray, mean: np.ndarray) -> fc.Structure:
        forces = {"force_sin": force.tolist(), "force_cos": [0.0, 0.0], "force_mean": mean.tolist()}
        return fc.build_structure(
            scene.replace({f"excitation.{key}": value for key, value in forces.items()})
        )

    still = np.zeros(2)
    closing = np.array([
        fc.solve_linear(loaded(size * way, still), 1.0, harmonics=1).gap_coefficients[2].mean()
        for way in np.eye(2)
    ])  # fmt: skip
    turned = size * np.array([np.cos(angle), np.sin(angle)])
    return loaded(turned, shut * size * closing / np.linalg.norm(closing))


def other_weights(structure: fc.Structure, failed: Point) -> list[Point]:
    """The same solution with other weights."""
    return [
        solve(
            structure,
            failed.omega,
            fc.UnilateralConstraint(factor * failed.weight),
            failed.harmonics,
            failed.case,
        )
        for factor in WEIGHTS
    ]


def solve(
    structure: fc.Structure,
    omega: float,
    contact: fc.UnilateralPenalty | fc.UnilateralConstraint,
    harmonics: int,
    case: str,
) -> Point:
    """One cold start."""
    started = time.process_time()
    history: tuple[float, ...] = ()
    try:
        solution = fc.solve_harmonic_balance(structure, float(omega), contact, harmonics=harmonics)
    except fc.ConvergenceError as error:
        history = error.history
        solution = fc.solve_harmonic_balance(
            structure, float(omega), contact, harmonics=harmonics, throw=False
        )
    milliseconds = 1e3 * (time.process_time() - started)
    way = FAILED
    if solution.converged:
        way = PATH if "path" in solution.status else PLAIN
    point = Point(
        case,
        float(getattr(contact, "stiffness", np.nan)),
        harmonics,
        float(omega),
        solution.converged,
        way,
        solution.iterations,
        milliseconds if solution.converged else 0.5 * milliseconds,  # it was solved twice
        solution.report.truncation,
        float(getattr(solution.contact, "weight", None) or np.nan),
    )
    if solution.converged:
        return replace(point, status=f"{solution.iterations} iterations")
    return replace(point, status=describe(history, solution.status))


def describe(history: Sequence[float], status: str) -> str:
    """How the last attempt of a failure went."""
    attempt = status.split("; then ")[-1]
    if "constraint from penalty" not in attempt:
        return "no penalty solution: " + attempt if "constraint" in status else attempt
    last = np.array(history[-30:])
    repeats = [
        lag
        for lag in range(1, 11)
        if np.allclose(last[-lag:], last[-2 * lag : -lag], rtol=1e-6, atol=0.0)
    ]
    spread = f"|F| {last.min():.1e} to {last.max():.1e} m"
    if repeats:
        return f"Newton cycles with period {repeats[0]}, {spread}"
    return f"Newton wanders, {spread}"


def report(title: str, points: Sequence[Point], stem: Path) -> None:
    """Table of counts and costs, CSV of all points, and a picture."""
    groups: dict[tuple[str, float, int], list[Point]] = {}
    for point in points:
        key = point.case, point.stiffness, point.harmonics
        groups.setdefault((key[0], np.nan_to_num(key[1]), key[2]), []).append(point)
    columns = (
        "case", "stiffness", "H", "converged", "of", "plain %", "path %",
        "iterations mean", "worst", "ms mean", "worst", "mean / plain", "truncation median",
    )  # fmt: skip
    rows = []
    for (case, stiffness, harmonics), group in groups.items():
        good = [p for p in group if p.converged]
        plain = [p.milliseconds for p in good if p.way == PLAIN]
        times = [p.milliseconds for p in good] or [np.nan]
        iterations = [p.iterations for p in good] or [0]
        rows.append(
            (
                case,
                stiffness or "none",
                harmonics,
                len(good),
                len(group),
                100.0 * len(plain) / len(group),
                100.0 * sum(p.way == PATH for p in good) / len(group),
                float(np.mean(iterations)),
                max(iterations),
                float(np.mean(times)),
                max(times),
                float(np.mean(times) / (np.median(plain) if plain else min(times))),
                float(np.median([p.truncation for p in good])) if good else float("nan"),
            )
        )
    common.print_table(title, columns, rows)
    converged = sum(p.converged for p in points)
    times = [p.milliseconds for p in points if p.converged]
    print(
        f"{converged} of {len(points)} converged; mean {np.mean(times):.3g} ms, "
        f"worst {max(times):.3g} ms"
    )
    for point in points:
        if not point.converged and not np.isnan(point.stiffness):
            print(
                f"failed: k = {point.stiffness:g}, H = {point.harmonics}, "
                f"w = {point.omega:.6g}: {point.status}"
            )
    fields = list(Point.__dataclass_fields__)
    common.write_csv(
        stem.with_suffix(".csv"), fields, [[getattr(p, f) for f in fields] for p in points]
    )
    draw(title, points, stem.with_suffix(".png"))


def draw(title: str, points: Sequence[Point], path: Path) -> None:
    """Newton iterations over the frequency; failures as crosses at the top."""
    figure, (axes,) = common.figure(1)
    top = 1.5 * max(p.iterations for p in points)
    looks = {PLAIN: ("blue", "o"), PATH: ("orange", "^"), FAILED: ("grey", "x")}
    for way, (colour, marker) in looks.items():
        chosen = [p for p in points if p.way == way]
        if not chosen:
            continue
        heights = [top if way == FAILED else max(p.iterations, 1) for p in chosen]
        axes.semilogy(
            [p.omega for p in chosen], heights, marker, color=COLOURS[colour], ms=3.5, alpha=0.6,
            ls="none", label=f"{way}: {len(chosen)} of {len(points)}",
        )  # fmt: skip
    axes.set_xlabel("load frequency [rad/s]")
    axes.set_ylabel("Newton iterations, all attempts [-]")
    axes.set_title(f"Cold starts. {title}")
    axes.legend(fontsize=8, framealpha=0.9)
    figure.savefig(path)


if __name__ == "__main__":
    main()
