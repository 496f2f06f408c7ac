"""Error, verdict, time and memory of one solution on large meshes, from the mesh on.

million: the breathing plate with a million dofs, 1 % of damping and 140 patches on the 280 nodes of
its crack faces, a penalty, to 5 %. large: the box that ``new --solid`` writes with 300 thousand
dofs and 100 patches, rigid, to 1 %. Processor times of one thread, each measured once.

    OMP_NUM_THREADS=1 python benchmarks/large_meshes.py [--quick] [--only PART] [folder]
"""

from __future__ import annotations

import resource
import time
from importlib import resources

import common

import fenics_crack as fc

MODES, PER_AREA, FINE = 30, 4.2e11, (0.00048, 140, 4.0)
"""Of the plate: modes; stiffness of contact [N/m^3]; element size away from the crack [m], elements
along a crack face, grading."""
DAMPING, TOLERANCE = 0.01, 0.05
"""Of the plate. With 0.1 % its orbit is unstable (1.08)."""
LARGE = {"mesh.size": 0.00115, "mesh.lip_elements": 10, "mesh.patches": 100, "mesh.error": False}
"""Of the box with 300 thousand dofs."""
BOX_MODES = 20


def main() -> None:
    """Run it."""
    common.run(__doc__, {"million": million, "large": large})


def million(arguments: common.Arguments) -> None:
    """The plate with a million dofs; a coarser one with ``--quick``."""
    size, lips, grading = (0.006, 140, 4.0) if arguments.quick else FINE
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
    text = resources.files("fenics_crack.cli").joinpath("new_solid.toml").read_text("utf-8")
    coarser = {"mesh.size": 0.003, "mesh.lip_elements": 6} if arguments.quick else {}
    changes = {"sweep": None, "curve": None} | LARGE | coarser
    scene = fc.Scene.from_text(text).replace(changes)
    assert scene.harmonic_balance.tolerance is not None
    tolerance = scene.harmonic_balance.tolerance
    with_patches(scene, BOX_MODES, scene.excitation.omega, None, tolerance)


def with_patches(
    scene: fc.Scene, modes: int, omega: float, per_area: float | None, tolerance: float
) -> None:
    """Print report, verdict, time and memory of a scene solved from its mesh on; rigid contact, or
    a stiffness per area [N/m^3]."""
    clock = time.process_time()
    whole_structure = fc.build_structure(scene)
    structure = fc.reduce_structure(whole_structure, modes=modes, method="massless")
    preparation_time, memory = time.process_time() - clock, _memory()
    law: fc.ContactLaw = fc.UnilateralConstraint()
    if per_area is not None:
        assert whole_structure.pair_areas is not None
        law = fc.UnilateralPenalty(per_area * whole_structure.pair_areas)
    solution = fc.solve_harmonic_balance(structure, omega, law, tolerance=tolerance, throw=False)
    report, reason = solution.report, solution.assessment.rejection_reason
    total_time = time.process_time() - clock
    print(
        f"{whole_structure.n_dofs} dofs, {whole_structure.n_pairs} pairs, "
        f"{modes} modes: H = {solution.harmonics}"
    )
    print(
        f"prepared in {preparation_time:.1f} s, {memory:.2f} GiB; "
        f"all {total_time:.1f} s, {_memory():.2f} GiB"
    )
    print(report, reason, sep="\n")
    if solution.orbit is not None:
        print(f"largest multiplier {abs(solution.orbit.multipliers).max():.4f}")


def _memory() -> float:
    """Most memory of this process until now [GiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


if __name__ == "__main__":
    main()
