"""Phase resonances against the tops of response curves: plates, solids, rotors and wheels.

    .venv/bin/python benchmarks/resonances.py [NAME ...]

Each structure is prepared as its scene says, and its phase resonance under its own load is compared
with the curve of exact orbits over six half-power widths around it: the distance of the frequencies
over the width, and the amplitude at the watched dof over that of the curve's top. A resonance is
right within a tenth of the width and 2 %; one of several modes says so. Times are of the processor
[s]: of the resonance, and of its curve.
"""

from __future__ import annotations

import math
import sys
import time
from typing import Any

import numpy as np

import fenics_crack as fc
from fenics_crack.curves.resonance import problem_at_small_load, resonance_at

STEEL = {"young": 2.1e11, "poisson": 0.3, "density": 7850.0}
TITANIUM = {"young": 1.14e11, "poisson": 0.33, "density": 4430.0}
ALUMINIUM = {"young": 7e10, "poisson": 0.33, "density": 2700.0}
MESH = {"layout": "graded", "order": 2, "size": 0.01, "lip_elements": 5, "grading": 4.0}
RIGHT = 0.1, 0.02
"""Maximum distance of the frequencies over the width, and of the amplitudes over the top's."""


def plate(
    size: tuple[float, float, float], place: tuple[float, float], material: dict[str, float],
    damping: float, frequency: float, **more: Any,
) -> fc.Scene:  # fmt: skip
    """A plate, or with a load in three directions a solid, with an edge crack of a height and a
    length."""
    width, height, thickness = size
    load = {"frequency": frequency, "point": [width, height], "force_sin": [1.0, 0.0]}
    load |= more.pop("load", {})
    if solid := len(load["force_sin"]) == 3:
        load["point"] = [width, height, 0.5 * thickness]
    order = load.get("order")
    if order is not None and "disk" not in more:
        load.pop("frequency")
    tables = {
        "geometry": {"width": width, "height": height, "thickness": thickness}
        | ({"kind": "solid"} if solid else {}),
        "crack": {"edge": "left", "height": place[0], "length": place[1]} | more.pop("crack", {}),
        "material": material,
        "damping": {"ratio": damping},
        "excitation": load,
        "contact": {"law": "unilateral"} | more.pop("contact", {}),
        "mesh": MESH | more.pop("mesh", {}),
    }
    return fc.Scene.from_mapping(tables | more)


SLIM, SHORT, WIDE = (0.04, 0.2, 0.004), (0.06, 0.12, 0.006), (0.1, 0.1, 0.005)
BLADE, STOUT = (0.04, 0.1, 0.004), (0.03, 0.08, 0.006)
WHEEL = {"disk": {"sectors": 12, "inner_radius": 0.12, "outer_radius": 0.18, "cracked": 3}}


def rotor(rpm: float) -> dict[str, Any]:
    """The table of a rotor."""
    return {"rotation": {"rpm": rpm, "hub_radius": 0.25}}


def force(*parts: float, mean: float = 0.0, **more: Any) -> dict[str, Any]:
    """A load at the tip, whose mean acts along its first direction that is loaded."""
    steady_parts = [mean * float(np.sign(part)) for part in parts]
    return {"force_sin": list(parts)} | ({"force_mean": steady_parts} if mean else {}) | more


STRUCTURES = {
    "plate": plate(SLIM, (0.03, 0.008), STEEL, 0.002, 780.0),
    "plate, deep crack": plate(SLIM, (0.02, 0.02), STEEL, 0.005, 700.0),
    "plate, second mode": plate(SLIM, (0.06, 0.012), STEEL, 0.005, 4500.0),
    "short plate, 2 %": plate(SHORT, (0.03, 0.02), ALUMINIUM, 0.02, 2700.0),
    "square plate": plate(WIDE, (0.05, 0.04), STEEL, 0.01, 3000.0),
    "plate, clearance": plate(
        SLIM, (0.03, 0.012), STEEL, 0.003, 750.0, crack={"clearance": 1e-7}
    ),
    "plate, opened": plate(
        SLIM, (0.03, 0.012), STEEL, 0.002, 750.0,
        load=force(1.0, 0.0, mean=60.0),
    ),
    "plate, pressed": plate(
        SLIM, (0.03, 0.012), STEEL, 0.002, 750.0, load=force(1.0, 0.0, mean=-80.0)
    ),
    "plate, penalty": plate(
        SLIM, (0.04, 0.01), TITANIUM, 0.001, 780.0, contact={"law": "penalty", "stiffness": 1e9}
    ),
    "solid": plate(BLADE, (0.012, 0.008), TITANIUM, 0.003, 340.0, load=force(0.0, 0.0, 0.2)),
    "solid, second mode": plate(
        BLADE, (0.03, 0.012), STEEL, 0.01, 1700.0, load=force(0.0, 0.0, 1.0)
    ),
    "solid, edgewise": plate(STOUT, (0.02, 0.01), STEEL, 0.005, 3300.0, load=force(5.0, 0.0, 0.0)),
    "solid, opened": plate(
        STOUT, (0.015, 0.01), STEEL, 0.002, 3300.0, load=force(5.0, 0.0, 0.0, mean=300.0)
    ),
    "solid, pressed": plate(
        STOUT, (0.015, 0.01), STEEL, 0.004, 3300.0, load=force(5.0, 0.0, 0.0, mean=-300.0)
    ),
    "rotor": plate(
        SLIM, (0.03, 0.01), STEEL, 0.002, 800.0,
        load=force(20.0, 0.0, order=10), **rotor(4900.0),
    ),
    "rotor, pressed": plate(
        SLIM, (0.03, 0.01), STEEL, 0.003, 800.0,
        load=force(10.0, 0.0, mean=-300.0, order=10), **rotor(4900.0)
    ),
    "rotor, solid": plate(
        BLADE, (0.012, 0.004), TITANIUM, 0.001, 390.0,
        load=force(0.0, 0.0, 1.0, order=4), **rotor(6000.0)
    ),
    "wheel": plate(
        (0.02, 0.12, 0.01), (0.008, 0.006), TITANIUM, 0.002, 900.0,
        load=force(2.0, 0.0, order=3), **WHEEL,
    ),
    "wheel, 1 %": plate(
        (0.02, 0.12, 0.01), (0.02, 0.008), STEEL, 0.01, 850.0,
        load=force(2.0, 0.0, order=5), **WHEEL,
    ),
    "wheel, mistuned": plate(
        (0.02, 0.12, 0.01), (0.008, 0.006), TITANIUM, 0.003, 880.0, load=force(2.0, 0.0, order=2),
        disk=WHEEL["disk"] | {"deviation": 0.02, "seed": 4},
    ),
}  # fmt: skip


def main() -> None:
    """Compare all structures, or those that are named."""
    names = sys.argv[1:] or list(STRUCTURES)
    columns = "structure", "f [Hz]", "top [Hz]", "off/width", "A/top - 1", "apart", "s", "curve s"
    print("{:20}{:>10}{:>11}{:>11}{:>11}{:>9}{:>7}{:>9}".format(*columns))
    for name in names:
        print(f"{name:20}", end="", flush=True)
        try:
            print(compared(STRUCTURES[name]), flush=True)
        except (fc.ConvergenceError, fc.InputError) as error:
            print(f"  {error}")


def compared(scene: fc.Scene) -> str:
    """A row of the table."""
    study = fc.prepare(scene)
    structure, law, omega = study.structure, study.contact, scene.excitation.omega
    begun = time.process_time()
    problem, tolerance = fc.Problem(structure, omega, law), scene.harmonic_balance.tolerance
    resonance = resonance_at(problem, tolerance=tolerance)
    spent = time.process_time() - begun
    row = f"{resonance.omega / (2.0 * math.pi):10.3f}"
    begun = time.process_time()
    top, height = top_of_curve(problem, resonance)
    peak_offset = (resonance.omega - top) / resonance.width
    higher = resonance.solution.amplitude() / height - 1.0
    is_right = abs(peak_offset) <= RIGHT[0] and abs(higher) <= RIGHT[1]
    remark = "  several" if resonance.several else "" if is_right else "  WRONG"
    return (
        f"{row}{top / (2.0 * math.pi):11.3f}{peak_offset:11.4f}{higher:11.2e}{resonance.apart:9.4f}"
        f"{spent:7.2f}{time.process_time() - begun:9.1f}{remark}"
    )


def top_of_curve(problem: fc.Problem, found: fc.Resonance) -> tuple[float, float]:
    """Frequency [rad/s] and amplitude of the largest response around a resonance, on the curve from
    below the natural frequency at rest, or from above it, whichever is farther from it."""
    ends = sorted((found.omega, resonance_at(problem_at_small_load(problem), found.omega).omega))
    lower_end, upper_end = ends[0] - 3.0 * found.width, ends[1] + 3.0 * found.width
    way = (lower_end, upper_end) if found.omega == ends[1] else (upper_end, lower_end)
    curve = fc.continue_frequency(
        problem.structure, *way, problem.contact, tolerance=1e-3, longest_step=0.03
    )
    top = curve.top()
    return top.value, top.amplitude


if __name__ == "__main__":
    main()
