"""Cracks found from ratios of harmonics alone, at two loads below the first resonance.

    python benchmarks/harmonic_ratios.py [folder]

Ratios 2/1 and 3/1 of the tip of an aluminium plate of 80 x 240 x 6 mm at 430 and 650 Hz, with 5 %
of noise, of 20 cracks in plates exactly as the scene's and 20 in others: Young's
modulus and density off by 1 and 0.5 % (standard deviations), a taper of 2 %, a soft clamp. What is
measured comes from finite elements and a harmonic balance that share nothing with the package's
(own_plates.py). Prints how many are in the stated regions, and how wide these are. ``--example`` is
a crack of 29.1 mm at 156.7 mm, ratios at 800 Hz without noise.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from identification import Score
from own_plates import Plate

import fenics_crack as fc

SEED = 167
"""Written down before it was run."""
WIDTH, HEIGHT, THICKNESS = 0.08, 0.24, 0.006
YOUNG, POISSON, DENSITY, DAMPING, PENALTY = 7.0e10, 0.33, 2700.0, 0.005, 1e14
FORCE, LOADS, CRACKS = (100.0, 30.0), (430.0, 650.0), 20
NOISE = 0.05
SCENE = f"""
geometry = {{ width = {WIDTH}, height = {HEIGHT}, thickness = {THICKNESS} }}
crack = {{ edge = "left", height = 0.12, length = 0.02 }}
material = {{ young = {YOUNG}, poisson = {POISSON}, density = {DENSITY} }}
damping = {{ ratio = {DAMPING}, modes = 12 }}
excitation = {{ point = [{WIDTH}, {HEIGHT}], force_sin = [100.0, 30.0], frequency = 650.0 }}
contact = {{ stiffness_per_area = {PENALTY} }}
harmonic_balance = {{ harmonics = 7 }}
mesh = {{ layout = "graded", order = 2, size = 0.02, lip_elements = 3 }}
[output.points]
tip = [{WIDTH}, {HEIGHT}]
[identify]
finer = 1.5
[identify.unknown]
"crack.length" = {{ start = 0.004, stop = 0.036, count = 8 }}
"crack.height" = {{ start = 0.016, stop = 0.2, count = 8 }}
"""
SIZES = {"crack.length": WIDTH, "crack.height": HEIGHT}


def ratios(
    plate: Plate, loads: tuple[float, ...], points: tuple[str, ...], rng: np.random.Generator | None
) -> fc.Measurements:
    """The ratios 2/1 and 3/1 of a plate."""
    rows = []
    for load in loads:
        seen = plate.ratios(load, FORCE, DAMPING, PENALTY)
        for point in points:
            first, *others = seen[("tip.ux", "tip.uy").index(point)]
            for order, one in enumerate(others, 2):
                deviation = NOISE * one / first
                value = one / first + (rng.normal() * deviation if rng else 0.0)
                rows.append(
                    fc.Measurement(
                        f"ratio_{order}_1", max(value, 0.0), deviation, frequency=load, point=point
                    )
                )
    return fc.Measurements(tuple(rows))


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=Path("output/harmonic_ratios"))
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--cracks", type=int, default=CRACKS)
    parser.add_argument("--example", action="store_true")
    given = parser.parse_args()
    scene, size = fc.Scene.from_text(SCENE), (WIDTH, HEIGHT, THICKNESS)
    if given.example:
        crack = {"crack.length": 0.0291, "crack.height": 0.1567}
        plate = Plate(size, YOUNG, POISSON, DENSITY, *crack.values(), longest=0.012)
        rows = ratios(plate, (800.0,), ("tip.ux", "tip.uy"), None)
        found = fc.identify(scene, rows, folder=given.folder)
        print(found, found.intervals, "held" if found.contains(crack) else "NOT HELD")
        return
    rng = np.random.default_rng(given.seed)
    for name in ("as the scene's", "others"):
        score = Score(SIZES)
        for _ in range(given.cracks):
            length, place = rng.uniform(0.1, 0.4) * WIDTH, rng.uniform(0.1, 0.8) * HEIGHT
            more, young, density = {}, YOUNG, DENSITY
            if name == "others":
                young *= 1.0 + 0.01 * rng.normal()
                density *= 1.0 + 0.005 * rng.normal()
                more = {"taper": rng.uniform(-0.02, 0.02), "clamp": rng.uniform(1e-4, 1e-3)}
            plate = Plate(size, young, POISSON, density, length, place, longest=0.012, **more)
            try:
                rows = ratios(plate, LOADS, ("tip.ux",), rng)
            except ArithmeticError:
                print("  left out: the generator's own Newton method ends nowhere", flush=True)
                continue
            found = fc.identify(scene, rows, folder=given.folder)
            score.add(found, np.array([length, place]))
            truth = dict(zip(SIZES, (length, place), strict=True))
            print(
                f"  {1e3 * length:.1f} mm at {1e3 * place:.1f}: {found},"
                f" {'held' if found.contains(truth) else 'NOT HELD'}",
                flush=True,
            )
        print(f"{name}: {score}", flush=True)


if __name__ == "__main__":
    main()
