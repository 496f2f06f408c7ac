"""Friction between the faces of an inclined crack: its resonance with and without.

Response curves of exact orbits, response.png, and the loops of the pairs that lose most at the peak
with friction, loops.png; what friction would change is stated by the scene without it, too.

    python demos/friction.py [folder for the results]
"""

import sys
from pathlib import Path

import numpy as np

import fenics_crack as fc

SCENE = Path(__file__).with_name("friction.toml")


def main(output: Path = Path("output/friction"), scene: fc.Scene | None = None) -> dict[str, float]:
    """Follow both curves, draw them, and solve both peaks; what is printed, by name."""
    scene = scene or fc.Scene.load(SCENE)
    plate, table = fc.prepare(scene), scene.curve
    ends = 2.0 * np.pi * table.start, 2.0 * np.pi * table.stop
    laws = {"without friction": fc.UnilateralConstraint(), "with friction": plate.contact}
    curves, found = {}, {}
    for name, law in laws.items():
        curves[name] = fc.continue_frequency(plate.structure, *ends, law, tolerance=0.1)
        peak = curves[name].peak()
        solution = fc.solve_harmonic_balance(
            plate.structure, peak.omega, law, tolerance=0.1, throw=False
        )
        seen = solution.indicators()
        found[f"peak {name} [m]"] = seen.amplitude
        found[f"its frequency, {name} [Hz]"] = peak.omega / (2.0 * np.pi)
        if name == "with friction":
            work = solution.orbit.energy_budget
            found["loss by friction over that by damping"] = float(
                work.friction.sum() / work.damping.sum()
            )
            found["share of the period in which pairs slip"] = seen.slip_share
            fc.draw_friction_loops(solution, path=output / "loops.png", title="At the peak")
    without, rubbing = curves.values()
    free = {"contact.friction": None, "excitation.omega": without.peak().omega}
    errors = fc.solve(scene.replace(free)).errors
    change = errors.contributions("amplitude")["friction"]
    found["friction left out, part of the peak"] = errors.relative("amplitude", change)
    fc.draw_curve(
        rubbing,
        label="with friction",
        behind={"without friction": (without.omega, without.amplitude())},
        in_hertz=True,
        path=output / "response.png",
        title="An inclined crack with faces that rub",
    )
    for name, value in found.items():
        print(f"{name}: {value:.4g}")
    return found


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("output/friction"))
