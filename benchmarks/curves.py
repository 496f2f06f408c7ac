"""What a point of a response curve costs, and which curves run through without intervention.

oscillator : m = 1, c = 0.02, k = 1, f = 0.1 cos(w t), a stop of kc = 1, 10, 100, 1000 at zero
    clearance, from w = 2 down to 0.3; H = 5, 10, 20.
paper : ``demos/paper_plate.toml``, 1e9 and 1e11 N/m, damping ratios 0.01 and 0.001, 1000 to 9500
    rad/s (past the third natural frequency), H = 20; also with the leading Floquet multiplier.
breathing : ``demos/breathing_plate.toml`` reduced, contact on all 18 pairs, 1e9 and 1e11 N/m,
    1000 to 9063 rad/s (1.1 times the third natural frequency), H = 5.

Times are the process's own. "LAPACK" is one factorisation and solution of a dense real matrix as
large as the condensed equations (dgetrf, dgetrs), measured between the curves. "filled" is the cost
of a point that :func:`refine_curve` puts between two others.

    OMP_NUM_THREADS=1 python benchmarks/curves.py [--quick] [--only PART] [folder]
"""

from __future__ import annotations

import time
from functools import partial

import common
import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs

import fenics_crack as fc
from fenics_crack.draw.figure import COLOURS

COLUMNS = (
    "case", "k", "xi", "H", "unknowns", "complete", "points", "folds", "iterations",
    "ms a point", "LAPACK", "filled / point", "stability / point",
)  # fmt: skip


def main() -> None:
    """Run the parts asked for."""
    common.run(__doc__, {"oscillator": oscillator, "paper": paper, "breathing": breathing})


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


def measure(
    structure: fc.Structure,
    span: tuple[float, float],
    k: float,
    harmonics: int,
    names: tuple[object, ...],
    stability: bool,
) -> tuple[tuple[object, ...], fc.ResponseCurve]:
    """One curve: followed, filled, and followed with its stability."""
    law = fc.UnilateralPenalty(k)
    follow = partial(fc.continue_frequency, structure, *span, law, harmonics=harmonics, throw=False)
    unknowns = (2 * harmonics + 1) * structure.n_pairs
    lapack = solve_once(unknowns)
    started = time.process_time()
    curve = follow()
    point = (time.process_time() - started) / len(curve)
    started = time.process_time()
    filled = fc.refine_curve(curve, 3)
    between = (time.process_time() - started) / (len(filled) - len(curve))
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
