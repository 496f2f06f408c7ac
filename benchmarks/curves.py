"""What a point of a response curve costs, and which curves run through without intervention.

oscillator : m = 1, c = 0.02, k = 1, f = 0.1 cos(w t), a stop of kc = 1, 10, 100, 1000 at zero
    clearance, from w = 2 down to 0.3; H = 5, 10, 20.
paper : ``demos/paper_plate.toml``, 1e9 and 1e11 N/m, damping ratios 0.01 and 0.001, 1000 to 9500
    rad/s (past the third natural frequency), H = 20; also with the leading Floquet multiplier.
breathing : ``demos/breathing_plate.toml`` reduced, contact on all 18 pairs, 1e9 and 1e11 N/m,
    1000 to 9063 rad/s (1.1 times the third natural frequency), H = 5.
newton : PETSc's SNES and the bordered Newton's method of curves at the points of two curves, each
    from the neighbouring point and at its known frequency: time of an iteration.

Times are the process's own, of the oscillator medians of seven turns. "LAPACK" is one factorisation
and solution of a dense real matrix as large as the condensed equations (dgetrf, dgetrs), measured
between the curves.

    OMP_NUM_THREADS=1 python benchmarks/curves.py [--quick] [--only PART] [folder]
"""

from __future__ import annotations

import time
from functools import partial

import common
import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs

import fenics_crack as fc
from fenics_crack.curves.waves import FrequencyWaves
from fenics_crack.draw.figure import COLOURS
from fenics_crack.numerics.newton import Newton, solve_at

Pairs = list[tuple[np.ndarray, float]]
TOLERANCE, MAX_ITERATIONS = 1e-9, 8

COLUMNS = (
    "case", "k", "xi", "H", "unknowns", "complete", "points", "folds", "iterations",
    "ms a point", "LAPACK", "stability / point",
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
                common.oscillator(), (2.0, 0.3), kc, harmonics, ("oscillator", kc, "-"), True, 7
            )
            rows.append(row)
            curves[f"kc = {kc:g}"] = curve
    common.save_table(arguments.folder / "curves_oscillator.csv", "Oscillator", COLUMNS, rows)
    figure, (axes,) = common.figure(1)
    for (label, curve), colour in zip(curves.items(), COLOURS.values(), strict=False):
        axes.semilogy(curve.omega, curve.amplitude(0), color=colour, lw=1.1, label=label)
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


def measure(
    structure: fc.Structure,
    span: tuple[float, float],
    k: float,
    harmonics: int,
    names: tuple[object, ...],
    stability: bool,
    turns: int = 1,
) -> tuple[tuple[object, ...], fc.ResponseCurve]:
    """One curve: followed, refined, and followed with its stability; medians of several turns."""
    law = fc.UnilateralPenalty(k)
    follow = partial(fc.continue_frequency, structure, *span, law, harmonics=harmonics, throw=False)
    unknowns = (2 * harmonics + 1) * structure.n_pairs
    lapack = solve_once(unknowns)
    if turns > 1:
        follow()  # what is used for the first time is loaded
    times = []
    for _ in range(turns):
        started = time.process_time()
        curve = follow()
        followed = time.process_time()
        known = follow(stability=True) if stability else None
        ended = time.process_time()
        point = (followed - started) / len(curve)
        ratio = ((ended - followed) / len(known) - point) / point if known else float("nan")
        times.append((point, ratio))
    point, ratio = np.median(times, axis=0).tolist()
    lapack = 0.5 * (lapack + solve_once(unknowns))
    folds = sum(b.kind == "fold" for b in curve.bifurcations)
    row = (
        *names, harmonics, unknowns, curve.complete, len(curve), folds,
        float(curve.iterations.mean()), 1e3 * point, point / lapack, ratio,
    )  # fmt: skip
    return row, curve


def newton(arguments: common.Arguments) -> None:
    """What SNES costs at the points of a curve, where it has no border to take care of."""
    plate = common.plate("paper_plate", {"damping.ratio": 0.01})
    cases = (
        ("oscillator, kc = 10", common.oscillator(), 10.0, (2.0, 0.3)),
        ("paper's plate, k = 1e9", plate, 1e9, (1000.0, 4000.0)),
    )
    rows = []
    for name, structure, k, span in cases:
        curve = fc.continue_frequency(structure, *span, fc.UnilateralPenalty(k), harmonics=10)
        family = FrequencyWaves(curve.problem, *span)
        places = [family.parameter(value) for value in curve.values.tolist()]
        pairs = [(curve.gap_coefficients[i], place) for i, place in enumerate(places[1:])]
        ways = {"SNES": partial(by_snes, family, pairs), "own": partial(by_own, family, pairs)}
        (iterations, found), same = ways["SNES"](), ways["own"]()
        assert same == (iterations, found)
        times = common.alternate(ways, 3 if arguments.quick else 15, warm=False)
        rows.append(
            (name, 10, len(pairs), found, iterations,
             *(1e6 * float(np.median(times[way])) / iterations for way in ways),
             common.ratio(times, "SNES", "own"))
        )  # fmt: skip
    columns = (
        "case", "H", "points", "converged", "iterations", "SNES us", "own us", "SNES / own",
    )  # fmt: skip
    common.save_table(arguments.folder / "curves_newton.csv", "An iteration", columns, rows)


def by_snes(family: FrequencyWaves, pairs: Pairs) -> tuple[int, int]:
    """Iterations and solutions by SNES."""
    iterations = found = 0
    with Newton(family) as snes:
        for start, place in pairs:
            _, converged, count = snes.solve(start, place, TOLERANCE, MAX_ITERATIONS)
            iterations, found = iterations + count, found + converged
    return iterations, found


def by_own(family: FrequencyWaves, pairs: Pairs) -> tuple[int, int]:
    """The same by the loop of curves."""
    iterations = found = 0
    for start, place in pairs:
        point = solve_at(family, start, place, tolerance=TOLERANCE, iterations=MAX_ITERATIONS)
        iterations += point.iterations if point else MAX_ITERATIONS
        found += point is not None
    return iterations, found


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
