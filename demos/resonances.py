"""The response through the first three resonances, with what is stable and where it changes.

The paper's plate (k = 1e9 N/m, xi = 0.01) is followed over the load's frequency by arc-length
continuation. Its 50 degrees of freedom need no reduction; a fine mesh would be reduced first
(``reduce_structure``), to modes well above the highest harmonic times the frequency. Behind the
curve: the plate with its crack always open, and the plate without a crack.

    python demos/resonances.py [folder for the results]
"""

import csv
import sys
import time
from pathlib import Path

import numpy as np

import fenics_crack as fc
from fenics_crack.plot import draw_curve

SCENE = Path(__file__).with_name("paper_plate.toml")
RANGE = (1000.0, 9500.0)  # rad/s; the open plate's third natural frequency is 8579
STIFFNESS = 1e9  # N/m
HARMONICS = 20


def main(output: Path = Path("output/resonances")) -> fc.ResponseCurve:
    """Follow the curve, draw it, and write its points and bifurcations as CSV."""
    scene = fc.Scene.load(SCENE).replace({"damping.ratio": 0.01})
    plate = fc.build_structure(scene)
    whole = fc.build_structure(scene.replace({"crack": None, "contact": None}))
    corner = plate.find_dof((0.1, 0.1), "x")
    started = time.perf_counter()
    curve = fc.continue_frequency(
        plate,
        *RANGE,
        fc.UnilateralPenalty(STIFFNESS),
        harmonics=HARMONICS,
        stability=True,
        progress=sys.stderr.isatty(),
    )
    seconds = time.perf_counter() - started

    omega = np.linspace(*RANGE, 800)
    behind = {}
    for label, structure in (("crack always open", plate), ("no crack", whole)):
        dof = structure.find_dof((0.1, 0.1), "x")
        behind[label] = (omega, np.array([linear_amplitude(structure, w, dof) for w in omega]))
    draw_curve(
        output / "response.png",
        curve,
        corner,
        title=f"Force point, k = {STIFFNESS:.0e} N/m, xi = 0.01, H = {HARMONICS}",
        behind=behind,
    )
    amplitude = curve.amplitude(corner)
    with open(output / "curve.csv", "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("omega_rad_per_s", "half_peak_to_peak_m", "largest_multiplier"))
        assert curve.multipliers is not None
        largest = np.abs(curve.multipliers[:, 0])
        writer.writerows(zip(curve.omega, amplitude, largest, strict=True))
    with open(output / "bifurcations.csv", "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("kind", "omega_rad_per_s"))
        writer.writerows((b.kind, b.omega) for b in curve.bifurcations)
    errors = [curve.solution(i).report.total for i in range(0, len(curve.omega), 25)]
    print(f"{len(curve.omega)} points, {len(curve.bifurcations)} bifurcations, {seconds:.1f} s")
    print(
        f"estimated error of every 25th point: median {np.median(errors):.2%}, "
        f"largest {max(errors):.0%} (next to a fold)"
    )
    print(f"peak {1e6 * amplitude.max():.2f} µm at {curve.omega[amplitude.argmax()]:.0f} rad/s")
    return curve


def linear_amplitude(structure: fc.Structure, omega: float, dof: int) -> float:
    """Amplitude of a dof [m] without contact."""
    rows = fc.solve_linear(structure, omega, harmonics=1).coefficients_at([dof])[:, 0]
    return float(np.hypot(rows[1], rows[2]))


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("output/resonances")
    main(folder)
    print(f"results in {folder}/")
