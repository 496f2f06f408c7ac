"""Cracks with many pairs, lips without mass: error against time, verdicts, large meshes.

plate: breathing_plate with 18 pairs and 1 % of damping on all modes; rigid contact and penalties
of 1e9 and 1e11 N/m, 1000 to 3000 rad/s in steps of 100, every solution from a cold start. The
reference is the whole finite-element model with mass on its lips: all of its modes (LAPACK), H =
REFERENCE; that with half as many harmonics says how far it has converged. Reported: time after
set-up (processor, one thread), iterations, errors of the gap and of the displacement at the load,
true and estimated.

today: the same by the form with mass on the lips (``free_interface``, 50 modes), for the picture.

march: the same plate, rigid, marched from rest at 2000 rad/s to the orbit: exponential steps
against central differences on the whole model with a penalty; steps in all, and error of the gap.

steel: 80 x 200 x 2 mm, edge crack 25 mm, 8 pairs, rigid, 0.2 % of damping, 20 modes; 6000 to 15000
rad/s in steps of 100. Each verdict against a march of the disturbed orbit: does the distance from
one period to the next grow or fall? And a curve from 6000 to 11000 rad/s, with its bifurcations.

large: 62 and 130 pairs, 49,000 and 200,000 dofs: time and memory of the set-up, time and error of
solutions; error against twice the harmonics and half as many modes more.

    OMP_NUM_THREADS=1 python benchmarks/many_pairs.py [--quick] [--only PART] [folder]
"""

from __future__ import annotations

import time
from typing import Any

import common
import numpy as np
import scipy.linalg

import fenics_crack as fc
from fenics_crack.model.reduced import MasslessStructure

REFERENCE = 120
LAWS: dict[str, Any] = {
    "rigid": fc.UnilateralConstraint(),
    "1e9 N/m": fc.UnilateralPenalty(1e9),
    "1e11 N/m": fc.UnilateralPenalty(1e11),
}
SETTINGS = ((50, 10), (110, 20), (110, 40), (300, 40), (300, 80), (600, 80))
"""Modes and harmonics."""
COLUMNS = (
    "law", "omega", "modes", "H", "converged", "ms", "iterations", "gap", "estimate", "displacement",
    "its estimate", "way",
)  # fmt: skip
INSTANTS = 1024


def main() -> None:
    """Run it."""
    common.run(
        __doc__, {"plate": plate, "today": today, "march": march, "steel": steel, "large": large}
    )


# --- error against time ---------------------------------------------------------------------------


def damped_plate() -> fc.Structure:
    """The breathing plate with all modes damped."""
    return common.plate("breathing_plate", {"damping.ratio": 0.01, "damping.modes": "all"})


def all_of_it(whole: fc.Structure, ratio: float) -> MasslessStructure:
    """A whole structure by all of its modes."""
    matrices = [m[:, :] for m in (whole.stiffness, whole.mass)]
    squares, shapes = scipy.linalg.eigh(*matrices)
    return MasslessStructure(
        whole,
        squares,
        fc.ModalDamping(ratio),
        (whole.gap.T @ shapes).T,
        whole.force @ shapes,
        np.zeros((whole.n_pairs + 1,) * 2),
    )


def waves(solution: fc.PeriodicSolution) -> tuple[np.ndarray, np.ndarray]:
    """Gap and displacement at the load over a period."""
    instants = np.arange(INSTANTS) * solution.period / INSTANTS
    structure = solution.structure
    rows = solution.displacement_coefficients @ structure.force[2]
    return solution.gap(instants), fc_evaluate(rows, solution.base_omega, instants)


def fc_evaluate(rows: np.ndarray, omega: float, instants: np.ndarray) -> np.ndarray:
    """A wave from its coefficients."""
    phase = omega * np.multiply.outer(instants, np.arange(1, len(rows) // 2 + 1))
    return rows[0] + np.cos(phase) @ rows[1::2] + np.sin(phase) @ rows[2::2]


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """Relative L2 difference."""
    return float(np.linalg.norm(one - other) / np.linalg.norm(other))


def references(
    whole: MasslessStructure, near: fc.Structure, omegas: np.ndarray
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
    """With mass on the lips."""


def march(arguments: common.Arguments) -> None:
    """In time."""


def steel(arguments: common.Arguments) -> None:
    """Verdicts."""


def large(arguments: common.Arguments) -> None:
    """Many dofs."""


if __name__ == "__main__":
    main()
