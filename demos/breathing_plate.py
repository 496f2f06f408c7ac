"""The paper's plate on a fine mesh, with local contact along its crack.

The plate of ``paper_plate.py`` with quadratic elements graded towards the tip; the crack's length
is the one that gives the paper's first natural frequency, 2300 rad/s. All pairs of nodes on
the crack faces may touch. It runs in seconds, also on several ranks that share the mesh:

    python demos/breathing_plate.py [folder for the results]
    mpirun -n 2 python demos/breathing_plate.py
"""

import json
import resource
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

import fenics_crack as fc

SCENE = Path(__file__).with_suffix(".toml")
MAGNIFICATION = 12000.0
"""Of the displacement in the animation: the crack opens by a micrometre."""


def main(output: Path = Path("output/breathing_plate")) -> dict[str, Any]:
    """Solve the scene and write pictures, ParaView files and summary.json to ``output``.

    The breathing crack itself is in breathing_crack.gif, and for ParaView in breathing_crack.pvd:
    ``paraview --script=breathing_crack_paraview.py``.
    """
    comm = MPI.COMM_WORLD
    scene = fc.Scene.load(SCENE)
    assert scene.contact is not None
    length = fc.find_crack_length(scene)
    scene = scene.replace({"crack.length": length, "crack.first_omega": None})
    plate = fc.build_structure(scene)
    modes = fc.solve_modes(plate, 6)
    fc.write_modes(modes, output / "modes.vtu")
    fc.draw_modes(modes, path=output / "modes.png")

    omega = scene.excitation.omega
    started = time.perf_counter()
    solution = fc.solve_harmonic_balance(
        plate,
        omega,
        fc.contact_law(scene.contact, plate),
        harmonics=scene.harmonic_balance.harmonics,
        samples=scene.harmonic_balance.samples,
    )
    seconds = time.perf_counter() - started
    linear = fc.solve_linear(plate, omega)
    corner = plate.find_dof((0.1, 0.1), "x")
    t = np.linspace(0.0, solution.period, 401)
    gap, corner_motion = solution.gap(t), solution.displacement(t, [corner])[:, 0]
    magnification = fc.write_period(
        solution, output / "breathing_crack.pvd", material=scene.material
    )
    fc.animate_period(
        solution,
        output / "breathing_crack.gif",
        frames=50,
        magnification=MAGNIFICATION,
        material=scene.material,
    )
    at = f"{omega:g} rad/s, H = {solution.harmonics}"
    fc.draw_spectrum(solution, corner, path=output / "spectrum.png", title=f"Harmonics at {at}")
    fc.draw_orbits(solution, corner, path=output / "orbits.png", title=f"Phase planes at {at}")
    summary = {
        "n_dofs": plate.n_dofs,
        "n_pairs": plate.n_pairs,
        "crack_length_m": length,
        "natural_frequencies_rad_per_s": [round(float(value), 3) for value in modes.omega],
        "status": solution.status,
        "errors": asdict(solution.report),
        "seconds": seconds,
        "largest_opening_m": float(-gap.min()),
        "largest_penetration_m": float(gap.max()),
        "corner_largest_m": float(np.abs(corner_motion).max()),
        "peak_memory_MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        "paraview_magnification": magnification,
    }
    if comm.rank == 0:
        fc.draw_waves(
            [
                fc.Wave("mouth", t, gap[:, 0], "blue"),
                fc.Wave("middle of the crack", t, gap[:, plate.n_pairs // 2], "green", "--"),
                fc.Wave("nearest pair to the tip", t, gap[:, -1], "orange", "-."),
                fc.Wave("mouth, crack always open", t, linear.gap(t)[:, 0], "grey", ":"),
            ],
            path=output / "gap.png",
            title=f"Breathing crack, {plate.n_pairs} pairs, H = {solution.harmonics}",
            quantity="closing of the crack faces",
            period=solution.period,
            zero="crack faces touch",
        )
        fc.draw_contact_map(
            solution, path=output / "contact_map.png", title="Where and when the crack is closed"
        )
        (output / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
        print(f"{plate.n_dofs} dofs, {plate.n_pairs} pairs, crack {1e3 * length:.2f} mm")
        print("natural frequencies:", "  ".join(f"{value:.1f}" for value in modes.omega), "rad/s")
        print(f"harmonic balance: {solution.status}, {seconds:.1f} s")
    return summary


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("output/breathing_plate")
    main(folder)
    if MPI.COMM_WORLD.rank == 0:
        print(f"results in {folder}/")
