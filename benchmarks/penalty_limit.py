"""How fast the penalty solution tends to the one without penetration as the stiffness grows.

The penalty law lets the lips overlap by lambda / k, so its error against ``UnilateralConstraint``
should be of first order in 1/k. Both are truncated at the same H, in different ways: the penalty
solution balances the harmonics of its force up to H, the constraint those of its projection. So the
difference first falls like 1/k and then reaches a floor due to truncation, which more harmonics
lower. On ``demos/paper_plate.toml`` (damping 0.01) and on the reduced
``demos/breathing_plate.toml`` (damping 0.01 and 0.001), at 2000 rad/s; k = 1e8 to
1e14 N/m a pair. The error is the relative L2 difference of the gap over the period. The order is
fitted where the error lies below 0.3 and more than three times above its smallest value, if those
are three points or more. Where the constraint does not converge with its default weight, others are
tried, and the solution with fewer harmonics as a start. The penalty solutions are accepted with a
relative residual of 1e-8: with k R of 1e6 rounding alone leaves more than 1e-10.

    OMP_NUM_THREADS=1 python benchmarks/penalty_limit.py [--quick] [folder]
"""

from __future__ import annotations

from typing import Any

import common
import numpy as np

import fenics_crack as fc
from fenics_crack.draw.figure import COLOURS

OMEGA = 2000.0
FACTORS = (1.0, 10.0, 100.0, 0.1)
"""Weights of the constraint, times the default one."""


def main() -> None:
    """Run it."""
    common.run(__doc__, {"limit": run_limit})


def run_limit(arguments: common.Arguments) -> None:
    """Solve, print the table, draw."""
    folder, quick = arguments.folder, arguments.quick
    paper = common.plate("paper_plate", {"damping.ratio": 0.01})
    stiffness = 10.0 ** np.arange(8.0, 14.1, 1.0 if quick else 0.5)
    cases: list[tuple[str, fc.Structure, tuple[int, ...]]] = [
        ("paper plate, damping 0.01", paper, (5, 20) if quick else (5, 10, 20, 40, 80))
    ]
    for damping in (0.01,) if quick else (0.01, 0.001):
        whole = common.plate("breathing_plate", {"damping.ratio": damping})
        counts = (5,) if quick else (5, 10, 20)
        cases.append((f"breathing plate, damping {damping}", fc.reduce_structure(whole), counts))
    rows: list[tuple[Any, ...]] = []
    fits: list[tuple[Any, ...]] = []
    for name, structure, counts in cases:
        start: fc.PeriodicSolution | None = None
        for harmonics in counts:
            constrained = constraint(structure, harmonics, start)
            if constrained is None:
                print(f"{name}, H = {harmonics}: the constraint did not converge")
                continue
            start = constrained
            found = limit(name, structure, constrained, stiffness)
            rows += found
            fits.append(fit(found))
            print(f"{name}, H = {harmonics} done", flush=True)
    columns = (
        "case", "H", "k [N/m]", "error", "penetration", "truncation (penalty)",
        "truncation (constraint)", "converged",
    )  # fmt: skip
    title = "Penalty against no penetration, relative to the gap"
    common.save_table(folder / "penalty_limit.csv", title, columns, rows)
    columns = (
        "case", "H", "order in 1/k", "fitted from k", "to k", "least error", "twice that from k",
        "truncation (constraint)",
    )  # fmt: skip
    title = "Fitted order, and where truncation takes over"
    common.save_table(folder / "penalty_limit_order.csv", title, columns, fits)
    draw(rows, [case[0] for case in cases], folder)


def constraint(
    structure: fc.Structure, harmonics: int, start: fc.PeriodicSolution | None
) -> fc.PeriodicSolution | None:
    """The solution without penetration, by the first way that converges."""
    weight = None
    tries: list[tuple[float, fc.PeriodicSolution | None]] = [(factor, None) for factor in FACTORS]
    if start is not None:
        tries.insert(1, (1.0, start))
    for factor, initial in tries:
        law = fc.UnilateralConstraint(None if weight is None else factor * weight)
        solution = fc.solve_harmonic_balance(
            structure, OMEGA, law, harmonics=harmonics, initial=initial, throw=False
        )
        if solution.converged:
            return solution
        assert isinstance(solution.contact, fc.UnilateralConstraint)
        weight = weight or solution.contact.weight
    return None


def limit(
    name: str, structure: fc.Structure, start: fc.PeriodicSolution, stiffness: np.ndarray
) -> list[tuple[Any, ...]]:
    """Errors of the penalty solutions against the constraint's."""
    harmonics = start.harmonics
    rows = []
    # From the stiffest on, each from the one before: the branch of the constraint.
    neighbour = start
    for k in stiffness[::-1]:
        solution = fc.solve_harmonic_balance(
            structure, OMEGA, fc.UnilateralPenalty(float(k)), harmonics=harmonics,
            initial=neighbour, residual_tolerance=1e-8, throw=False,
        )  # fmt: skip
        if solution.converged:
            neighbour = solution
        rows.append(
            (
                name,
                harmonics,
                float(k),
                common.relative_difference(solution.gap_coefficients, start.gap_coefficients),
                solution.report.penetration,
                solution.report.truncation,
                start.report.truncation,
                solution.converged,
            )
        )
    return rows[::-1]


def fit(rows: list[tuple[Any, ...]]) -> tuple[Any, ...]:
    """The order, its range, and the level and stiffness of the plateau."""
    good = [row for row in rows if row[7]]
    k, error = np.array([row[2] for row in good]), np.array([row[3] for row in good])
    floor = float(error.min())
    chosen = (error < 0.3) & (error > 3.0 * floor)
    over = k[error < 2.0 * floor].min()
    head = rows[0][:2]
    if chosen.sum() < 3 or np.any(np.diff(error[chosen]) > 0.0):
        nan = float("nan")
        return (*head, nan, nan, nan, floor, float(over), rows[0][6])
    order = -float(np.polyfit(np.log(k[chosen]), np.log(error[chosen]), 1)[0])
    return (
        *head, order, float(k[chosen].min()), float(k[chosen].max()), floor, float(over),
        rows[0][6],
    )  # fmt: skip


def draw(rows: list[tuple[Any, ...]], names: list[str], folder: Any) -> None:
    """Error over stiffness."""
    figure, panels = common.figure(len(names))
    colours = dict(zip(sorted({row[1] for row in rows}), COLOURS.values(), strict=False))
    markers = dict(zip(colours, "o^sDv", strict=False))
    for axes, name in zip(panels, names, strict=True):
        for harmonics, colour in colours.items():
            chosen = [row for row in rows if row[:2] == (name, harmonics) and row[7]]
            if chosen:
                axes.loglog(
                    [row[2] for row in chosen],
                    [row[3] for row in chosen],
                    marker=markers[harmonics],
                    color=colour,
                    ms=4.5,
                    lw=1.3,
                    label=f"H = {harmonics}",
                )
        shown = [row for row in rows if row[0] == name and row[7]]
        if shown:
            k = np.array([shown[0][2], 1e14])
            level = 3.0 * max(row[3] for row in shown)
            low = min(row[3] for row in shown)
            k[1] = min(k[1], k[0] * level / (0.3 * low))
            axes.loglog(k, level * k[0] / k, ":", color=COLOURS["grey"], label="first order in 1/k")
        axes.set_xlabel("contact stiffness of a pair k [N/m]")
        axes.set_ylabel("gap: penalty against no penetration, relative L2 [-]")
        axes.set_title(f"{name}, {OMEGA:g} rad/s", fontsize=10)
        axes.legend(fontsize=8)
    figure.savefig(folder / "penalty_limit.png")


if __name__ == "__main__":
    main()
