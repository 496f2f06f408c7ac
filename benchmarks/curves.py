"""What a point of a response curve costs, and which curves run through without intervention.

oscillator : m = 1, c = 0.02, k = 1, f = 0.1 cos(w t), a stop of kc = 1, 10, 100, 1000 at zero
    clearance, from w = 2 down to 0.3; H = 5, 10, 20.
paper : ``demos/paper_plate.toml``, 1e9 and 1e11 N/m, damping ratios 0.01 and 0.001, 1000 to 9500
    rad/s (past the third natural frequency), H = 20; also with the leading Floquet multiplier.
breathing : ``demos/breathing_plate.toml`` reduced, contact on all 18 pairs, 1e9 and 1e11 N/m,
    1000 to 9063 rad/s (1.1 times the third natural frequency), H = 5.
newton : the same Newton steps by PETSc's SNES and by the loop of curves, at a given frequency, from
    the neighbouring point; on the oscillator and on the paper's plate, H = 5 and 20.

Times are the process's own. "LAPACK" is one factorisation and solution of a dense real matrix as
large as the condensed equations (dgetrf, dgetrs), measured between the curves. "refined" is the
cost of a point that :func:`refine_curve` puts between two others.

    OMP_NUM_THREADS=1 python benchmarks/curves.py [--quick] [--only PART] [folder]
"""

from __future__ import annotations

import time
from functools import partial

import common
import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs

import fenics_crack as fc
from fenics_crack.balance.bordered import solve_at
from fenics_crack.balance.family import FAMILIES, Family
from fenics_crack.balance.newton import Newton
from fenics_crack.draw.figure import COLOURS

COLUMNS = (
    "case", "k", "xi", "H", "unknowns", "complete", "points", "folds", "iterations",
    "ms a point", "LAPACK", "refined / point", "stability / point",
)  # fmt: skip


def main() -> None:
    """Run the parts asked for."""
    parts = {"oscillator": oscillator, "paper": paper, "breathing": breathing, "newton": newton}
    common.run(__doc__, parts)


def oscillator(arguments: common.Arguments) -> None:
    """Twelve curves of the bilinear oscillator."""
    rows = []
    curves = {}
    for kc in (1.0, 100.0) if arguments.quick else (1.0, 10.0, 100.0, 1000.0):
        for harmonics in (5,) if arguments.quick else (5, 10, 20):
            row, curve = measure(
                common.oscillator(), (2.0, 0.3), kc, harmonics, ("oscillator", kc, "-"), True
            )
            rows.append(row)
            curves[f"kc = {kc:g}"] = curve
    common.save_table(arguments.folder / "curves_oscillator.csv", "Oscillator", COLUMNS, rows)
    figure, (axes,) = common.figure(1)
    for (label, curve), colour in zip(curves.items(), COLOURS.values(), strict=False):
        fine = fc.refine_curve(curve, 3)
        axes.semilogy(fine.omega, fine.amplitude(0), color=colour, lw=1.1, label=label)
    axes.set_xlabel("load frequency [rad/s]")
    axes.set_ylabel("half peak-to-peak displacement [m]")
    axes.set_title("Bilinear oscillator, the most harmonics run")
    axes.legend(fontsize=8)
    figure.savefig(arguments.folder / "curves_oscillator.png")


def paper(arguments: common.Arguments) -> None:
    """The paper's plate past its third natural frequency."""
    rows = []
    for ratio in (0.01,) if arguments.quick else (0.01, 0.001):
        plate = common.plate("paper_plate", {"damping.ratio": ratio})
        for k in (1e9, 1e11):
            end = 3000.0 if arguments.quick else 9500.0
            rows.append(measure(plate, (1000.0, end), k, 20, ("paper", k, ratio), True)[0])
    common.save_table(arguments.folder / "curves_paper.csv", "Paper's plate", COLUMNS, rows)


def breathing(arguments: common.Arguments) -> None:
    """Contact all along the crack."""
    whole = common.plate("breathing_plate")
    third = 3000.0 if arguments.quick else 1.1 * fc.solve_modes(whole, 3).omega[2]
    reduced = fc.reduce_structure(whole)
    rows = [
        measure(reduced, (1000.0, third), k, 5, ("breathing", k, 0.001), False)[0]
        for k in (1e9, 1e11)
    ]
    common.save_table(arguments.folder / "curves_breathing.csv", "Breathing plate", COLUMNS, rows)


def newton(arguments: common.Arguments) -> None:
    """SNES against the loop of curves, on the same steps."""
    plate = common.plate("paper_plate", {"damping.ratio": 0.01})
    cases = (("oscillator", common.oscillator(), 2.0, 0.6, 1.0), ("paper", plate, 2e3, 1.5e3, 1e9))
    rows = []
    for name, structure, start, end, k in cases:
        for harmonics in (5,) if arguments.quick else (5, 20):
            problem = fc.Problem(structure, start, fc.UnilateralPenalty(k), harmonics)
            curve = fc.continue_frequency(
                structure, start, end, problem.contact, harmonics=harmonics
            )
            times, steps = race(FAMILIES["omega"](problem, start, end), curve)
            rows.append((
                name, harmonics, steps, *(1e3 * np.median(t) for t in times.values()),
                common.ratio(times, "SNES", "curves"),
            ))  # fmt: skip
    columns = ("case", "H", "steps", "SNES, ms", "curves, ms", "SNES / curves")
    common.save_table(arguments.folder / "curves_newton.csv", "Newton's method", columns, rows)


def race(family: Family, curve: fc.ResponseCurve) -> tuple[dict[str, np.ndarray], float]:
    """Times [s] of a solution by SNES and by the loop of curves, and their mean steps."""
    chosen = range(5, len(curve), max(1, len(curve) // 60))
    tasks = [(curve.gap_coefficients[i - 1], family.parameter(curve.omega[i])) for i in chosen]
    tolerance, steps = 1e-9, []
    with Newton(family) as snes:

        def by_snes() -> None:
            steps[:] = [snes.solve(gap, where, tolerance, 20)[2] for gap, where in tasks]

        def by_loop() -> None:
            found = [solve_at(family, gap, where, tolerance=tolerance) for gap, where in tasks]
            assert [point and point.iterations for point in found] == steps

        times = common.alternate({"SNES": by_snes, "curves": by_loop}, 9)
    return {name: t / len(tasks) for name, t in times.items()}, float(np.mean(steps))


def measure(
    structure: fc.Structure,
    span: tuple[float, float],
    k: float,
    harmonics: int,
    names: tuple[object, ...],
    stability: bool,
) -> tuple[tuple[object, ...], fc.ResponseCurve]:
    """One curve: followed, refined, and followed with its stability."""
    law = fc.UnilateralPenalty(k)
    follow = partial(fc.continue_frequency, structure, *span, law, harmonics=harmonics, throw=False)
    unknowns = (2 * harmonics + 1) * structure.n_pairs
    lapack = solve_once(unknowns)
    started = time.process_time()
    curve = follow()
    point = (time.process_time() - started) / len(curve)
    started = time.process_time()
    fine = fc.refine_curve(curve, 3)
    between = (time.process_time() - started) / (len(fine) - len(curve))
    lapack = 0.5 * (lapack + solve_once(unknowns))
    ratio = float("nan")
    if stability:
        started = time.process_time()
        known = follow(stability=True)
        ratio = ((time.process_time() - started) / len(known) - point) / point
    folds = sum(b.kind == "fold" for b in curve.bifurcations)
    row = (
        *names, harmonics, unknowns, curve.complete, len(curve), folds,
        float(curve.iterations.mean()), 1e3 * point, point / lapack, between / point, ratio,
    )  # fmt: skip
    return row, curve


def solve_once(size: int) -> float:
    """Processor time [s] of a factorisation and solution by LAPACK."""
    rng = np.random.default_rng(0)
    matrix = np.asfortranarray(rng.normal(size=(size, size)) + size * np.eye(size))
    right = rng.normal(size=size)

    def once() -> None:
        factors, pivots, _ = dgetrf(matrix)
        dgetrs(factors, pivots, right)

    count = max(3, int(2e7 / (size**3 + 1e4)))
    started = time.process_time()
    for _ in range(count):
        once()
    return (time.process_time() - started) / count


if __name__ == "__main__":
    main()
