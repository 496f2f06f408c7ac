"""Part-through cracks of a solid found again from six frequencies of a finer mesh.

    python benchmarks/solid_cracks.py [folder]

A blade of 30 x 90 x 6 mm with half an ellipse, 20 mm long, from one of its broad faces: its depth
and its distance from the clamp are unknown. The first six natural frequencies, of bending and
torsion, have 0.1 % of noise, with the crack held open and before there was one; they come from a
mesh 1.5 times as fine as the finest of the model, of a blade whose Young's modulus is 0.5 or 1 %
higher or lower. Prints each of ten cracks, at random places 20 to 75 mm from the clamp, 20 to 70 %
deep, and how many are held by the stated regions, with the frequencies from before and without; of
five blades without a crack, measured four times each, how often one is claimed. Under mpirun the
sweeps of the forward model are spread over the ranks.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from identification import NATURAL, Score, before, noisy
from mpi4py import MPI

import fenics_crack as fc
from fenics_crack.monitoring.identification.identify import infer, solve_forward

HEIGHT, THICKNESS = 0.09, 0.006
SEED = 1
"""Written down before it was run."""
CRACKS, DRAWS, MODES = 10, 4, 6
STIFFER = 0.99, 0.995, 1.0, 1.005, 1.01
"""Young's modulus over that of the scene, by turns."""
SCENE = f"""
geometry = {{ kind = "solid", width = 0.03, height = {HEIGHT}, thickness = {THICKNESS} }}
crack = {{ center = 0.015, height = 0.03, length = 0.02, depth = 0.003, front = "elliptical" }}
material = {{ young = 2.1e11, poisson = 0.3, density = 7850.0 }}
damping = {{ ratio = 0.002, modes = 12 }}
excitation = {{ point = [0.0, {HEIGHT}, 0.003], force_sin = [0.0, 0.0, 0.1], frequency = 400.0 }}
contact = {{ law = "unilateral" }}
harmonic_balance = {{ harmonics = 2 }}
reduction = {{ modes = 12 }}
mesh = {{ layout = "graded", order = 2, size = 0.008, lip_elements = 3 }}
[identify.unknown]
"crack.depth" = {{ start = 0.0008, stop = 0.005, count = 6 }}
"crack.height" = {{ start = 0.012, stop = 0.08, count = 7 }}
"""
FINER = {"identify": None, "mesh.size": 0.0053, "mesh.lip_elements": 5}


def exact(scene: fc.Scene) -> list[fc.Measurement]:
    """What would be measured without noise."""
    modes = fc.solve_modes(fc.build_structure(scene, MPI.COMM_SELF), MODES)
    return [
        fc.Measurement("frequency_open", hertz, NATURAL * hertz, mode)
        for mode, hertz in enumerate((modes.omega / (2.0 * np.pi)).tolist(), 1)
    ]


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=Path("output/solid_cracks"))
    folder = parser.parse_args().folder
    scene = fc.Scene.from_text(SCENE)
    forward = solve_forward(scene, (), folder, progress=True)
    if MPI.COMM_WORLD.rank:
        return
    rng, kinds = np.random.default_rng(SEED), ("frequency",)
    depths = rng.uniform(0.2, 0.7, CRACKS) * THICKNESS
    cracks = np.column_stack([depths, rng.uniform(0.02, 0.075, CRACKS)])
    plates = [{"material.young": share * scene.material.young} for share in STIFFER]
    gone = {"crack": None, "contact": None}
    bare = [exact(scene.replace(FINER | plate | gone)) for plate in plates]
    scores = {known: Score({"crack.depth": THICKNESS, "crack.height": HEIGHT}) for known in (1, 0)}
    for number, crack in enumerate(cracks):
        place = number % len(plates)
        own = {"crack.depth": crack[0], "crack.height": crack[1]}
        rows = exact(scene.replace(FINER | plates[place] | own))
        for known, score in scores.items():
            some = noisy([*rows, *(before(bare[place]) if known else [])], kinds, rng)
            found = infer(forward, some)
            score.add(found, crack)
            print(f"{1e3 * crack.round(5)} mm{', and before' * known}: {found}", flush=True)
    for known, score in scores.items():
        print(f"cracks{', and before' * known}: {score}")
    for known in scores:
        claimed = 0
        for rows in bare:
            for _ in range(DRAWS):
                some = noisy([*rows, *(before(rows) if known else [])], kinds, rng)
                claimed += infer(forward, some).verdict == "crack"
        print(f"none{', and before' * known}: claimed {claimed} of {DRAWS * len(bare)}")


if __name__ == "__main__":
    main()
