"""What a solution's error and verdict cost, over its cold search by harmonic balance.

plates20, plates50: plates as in plate_orbits.py with 8 to 62 rigid pairs and 20 or 50 modes, H =
20. solid: the box that ``new --solid`` writes with about 300 patches on its crack, H = 10. million:
the plate of growth.py with a million dofs, 1 % of damping and 140 patches on the 280 nodes of its
lips, penalty, with a tolerance of 5 %. large: that box with 300 thousand dofs and 100 patches,
rigid, to 1 %. Of these two report, verdict, time and memory are printed.

Error and verdict are: one Newton step of the whole solution on the exact flow, the orbit that
Newton's method leads to from its state, its multipliers where the monodromy matrix is formed, its
distance, and one Newton step on the reference, which has twice the modes. The mesh's part of the
error is left out. Processor times of one thread, each measured once, from a flow that knows nothing
yet. Reported: the three parts and the whole over the search, and how often an error was stated.

    OMP_NUM_THREADS=1 python benchmarks/error_cost.py [--quick] [--only PART] [folder]
"""

from __future__ import annotations

import resource
import time
from dataclasses import dataclass
from functools import partial
from importlib import resources
from typing import Any

import common
import numpy as np
from growth import MESHES, MILLION, MODES, PER_AREA
from plate_orbits import plate

import fenics_crack as fc
from fenics_crack.balance.solution import Solver
from fenics_crack.model.reduced import ReducedStructure
from fenics_crack.motion.orbit import FORMED

SEED, PLATES, FEW = 66, 40, 6
LIPS = 4, 32
"""Elements along a lip: two pairs each."""
PATCHES = {"mesh.lip_elements": 8, "mesh.error": False}
"""Of the box that ``new --solid`` writes: 293 on its crack."""
DAMPING, TOLERANCE = 0.01, 0.05
"""Of the plate with a million dofs. With 0.1 % its orbit is unstable (1.08)."""
LARGE = {"mesh.size": 0.00115, "mesh.lip_elements": 10, "mesh.patches": 100, "mesh.error": False}
"""Of the box with 300 thousand dofs."""
BOX_MODES = 20
COLUMNS = (
    "case", "pairs", "modes", "search ms", "step ms", "orbit ms", "reference ms", "step", "orbit",
    "reference", "error", "predicted", "truncation", "distance", "more modes", "|mu|",
)  # fmt: skip


def main() -> None:
    """Run it."""
    parts: dict[str, common.Part] = {
        "plates20": partial(plates, 20), "plates50": partial(plates, 50), "solid": solid,
        "million": million, "large": large,
    }  # fmt: skip
    common.run(__doc__, parts, seed={"type": int, "default": SEED})


@dataclass
class Assessed:
    """Error and verdict of a solution, nan where not found, and the time of each part [s]."""

    step: float = np.nan
    orbit: float = np.nan
    reference: float = np.nan
    predicted: float = np.nan
    truncation: float = np.nan
    distance: float = np.nan
    more_modes: float = np.nan
    multiplier: float = np.nan


def assessed(solution: fc.PeriodicSolution) -> Assessed:
    """Find error and verdict of a solution."""
    known, found, clock = solution.assessment, Assessed(), time.process_time()
    step = known.prediction
    found.step, clock = time.process_time() - clock, time.process_time()
    found.orbit = found.reference = 0.0
    if step is None:
        return found
    found.predicted, found.truncation = step.error, known.errors()[0]
    if known.orbit is not None:
        found.distance = known.distance
        if known.orbit.flow.size <= FORMED:
            found.multiplier = float(abs(known.orbit.multipliers[0]))
    found.orbit, clock = time.process_time() - clock, time.process_time()
    if (more := known.more_modes) is not None and more.errors is not None:  # as the report does
        found.more_modes = more.errors[0]
    found.reference = time.process_time() - clock
    return found


def measured(
    name: str, structure: ReducedStructure, omega: float, law: fc.ContactLaw, harmonics: int
) -> common.Row:
    """A row of the table."""
    solver = Solver(fc.Problem(structure, omega, law, harmonics), throw=False)
    clock = time.process_time()
    solution = solver.solve()
    search = time.process_time() - clock
    found = assessed(solution)
    parts = np.array([found.step, found.orbit, found.reference])
    return (
        name, structure.n_pairs, structure.n_modes, *(1e3 * np.array([search, *parts])),
        *(parts / search), parts.sum() / search, found.predicted, found.truncation, found.distance,
        found.more_modes, found.multiplier,
    )  # fmt: skip


def plates(modes: int, arguments: common.Arguments) -> None:
    """All plates with so many modes."""
    random, rows = np.random.default_rng(arguments.seed), []
    law = fc.UnilateralConstraint()
    for number in range(FEW if arguments.quick else PLATES):
        structure, omega, _ = plate(random, LIPS, (modes, modes + 1))
        if not number:  # what is compiled and imported at first use is no part of the times
            measured("", structure, omega, law, 5)
        rows.append(measured(str(number), structure, omega, law, 20))
    report(arguments, f"plates with {modes} modes", f"plates{modes}", rows)


def box(changes: dict[str, Any]) -> fc.Scene:
    """The scene that ``new --solid`` writes, for one solution."""
    text = resources.files("fenics_crack.cli").joinpath("new_solid.toml").read_text("utf-8")
    return fc.Scene.from_text(text).replace({"sweep": None, "curve": None} | changes)


def solid(arguments: common.Arguments) -> None:
    """The box with many patches."""
    study = fc.prepare(box(PATCHES))
    omega, law = study.scene.excitation.omega, study.contact
    rows = [measured("solid", study.structure, omega, law, 10)]
    report(arguments, "solid box", "solid", rows)


def million(arguments: common.Arguments) -> None:
    """The plate with a million dofs; a coarser one with ``--quick``."""
    size, lips, grading = (0.006, 140, 4.0) if arguments.quick else MESHES[MILLION][0]
    scene = fc.Scene.load(common.DEMOS / "breathing_plate.toml").replace(
        {
            "crack.length": 0.04284, "crack.first_omega": None, "damping.modes": MODES,
            "damping.ratio": DAMPING, "mesh.size": size, "mesh.lip_elements": lips,
            "mesh.grading": grading, "mesh.patches": lips,
        }
    )  # fmt: skip
    with_patches(scene, MODES, 2000.0, PER_AREA, TOLERANCE)


def large(arguments: common.Arguments) -> None:
    """The box with 300 thousand dofs; with 60 thousand with ``--quick``."""
    scene = box(LARGE | ({"mesh.size": 0.003, "mesh.lip_elements": 6} if arguments.quick else {}))
    assert scene.harmonic_balance.tolerance is not None
    tolerance = scene.harmonic_balance.tolerance
    with_patches(scene, BOX_MODES, scene.excitation.omega, None, tolerance)


def with_patches(
    scene: fc.Scene, modes: int, omega: float, per_area: float | None, tolerance: float
) -> None:
    """Print report, verdict, time and memory of a scene solved from its mesh on; rigid contact, or
    a stiffness per area [N/m^3]."""
    clock = time.process_time()
    whole = fc.build_structure(scene)
    structure = fc.reduce_structure(whole, modes=modes, method="massless")
    prepared, memory = time.process_time() - clock, _memory()
    law: fc.ContactLaw = fc.UnilateralConstraint()
    if per_area is not None:
        assert whole.pair_areas is not None
        law = fc.UnilateralPenalty(per_area * whole.pair_areas)
    found = fc.solve_harmonic_balance(structure, omega, law, tolerance=tolerance, throw=False)
    stated, reason = found.report, found.assessment.reason
    taken = time.process_time() - clock
    print(f"{whole.n_dofs} dofs, {whole.n_pairs} pairs, {modes} modes: H = {found.harmonics}")
    print(f"prepared in {prepared:.1f} s, {memory:.2f} GiB; all {taken:.1f} s, {_memory():.2f} GiB")
    print(stated, reason, sep="\n")
    if found.orbit is not None:
        print(f"largest multiplier {abs(found.orbit.multipliers).max():.4f}")


def _memory() -> float:
    """Most memory of this process until now [GiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def report(arguments: common.Arguments, title: str, name: str, rows: list[common.Row]) -> None:
    """The table, and what it comes to."""
    common.save_table(arguments.folder / f"error_cost_{name}.csv", title, COLUMNS, rows)
    table = np.array([row[3:] for row in rows], dtype=float)
    for column, part in enumerate(COLUMNS[7:11], 4):
        middle, most = np.percentile(table[:, column], [50, 90])
        print(f"{part} / search: median {middle:.2f}, 90 % {most:.2f}")
    stated = (table[:, [9, 11]] < 1.0).all(axis=1)
    print(f"an error stated for {stated.sum()} of {len(rows)}")


if __name__ == "__main__":
    main()
