"""The response through the first three resonances, with what is stable and where it changes.

The paper's plate (k = 1e9 N/m, xi = 0.01, contact at the crack's mouth) and the breathing plate
(contact all along the crack, 18 pairs, k = 1e9 N/m, xi = 0.01) are followed over the load's
frequency by arc-length continuation. The paper's plate has 50 degrees of freedom and needs no
reduction; the other one, 4000, is reduced once. Behind the curves: the plate with its crack always
open, and the plate without a crack. Beside the first: direct integration in time, swept up and down
from one frequency to the next.

The curves are stored; ``--again`` draws them anew without solving anything.

    python demos/resonances.py [folder for the results] [--again]
"""

import csv
import sys
import time
from pathlib import Path

import numpy as np

import fenics_crack as fc

FOLDER = Path(__file__).parent
RANGE = (1000.0, 9500.0)  # rad/s; the open plate's third natural frequency is 8579
STIFFNESS = 1e9  # N/m
HARMONICS = {"paper_plate": 20, "breathing_plate": 7}
SWEEP = np.linspace(1500.0, 5000.0, 36)  # rad/s
PERIODS = 80  # of the load at each frequency of the sweep
LINEAR = 800  # frequencies of the responses without contact
CHECKED = 20  # parts of a curve, at which its errors are asked for


def main(output: Path = Path("output/resonances"), *, again: bool = False) -> fc.ResponseCurve:
    """Follow both curves and draw them; return the first."""
    output.mkdir(parents=True, exist_ok=True)
    law = fc.UnilateralPenalty(STIFFNESS)
    curves = {}
    for name, harmonics in HARMONICS.items():
        scene = fc.Scene.load(FOLDER / f"{name}.toml").replace({"damping.ratio": 0.01})
        plate = fc.build_structure(scene)
        structure = plate if name == "paper_plate" else fc.reduce_structure(plate)
        file = output / f"{name}.h5"
        if again:
            curve = fc.load(file, structure, law)
        else:
            curve = follow(structure, law, harmonics, name)
            fc.save(curve, file)
        curves[name] = curve
        assert scene.geometry.width is not None and scene.geometry.height is not None
        corner = (scene.geometry.width, scene.geometry.height)
        whole = fc.build_structure(scene.replace({"crack": None, "contact": None}))
        points = {}
        if name == "paper_plate":
            points = swept(output / "swept.csv", structure, law, corner, again)
        title = f"{name.replace('_', ' ')}: load point, k = {STIFFNESS:.0e} N/m, xi = 0.01"
        dof = plate.find_dof(corner, "x")
        fc.draw_curve(
            curve,
            dof,
            path=output / f"{name}.png",
            title=f"{title}, H = {harmonics}",
            behind={
                "crack always open": linear_response(plate, corner),
                "no crack": linear_response(whole, corner),
            },
            points=points,
        )
        fc.draw_content(curve, dof, path=output / f"{name}_content.png", title=title)
        write(output / f"{name}.csv", curve, dof)
    fc.draw_multipliers(
        curves["paper_plate"],
        path=output / "multipliers.png",
        title="Floquet multipliers, paper plate",
    )
    return curves["paper_plate"]


def follow(
    structure: fc.Structure, law: fc.UnilateralPenalty, harmonics: int, name: str
) -> fc.ResponseCurve:
    """Follow a curve, with its stability where there are few degrees of freedom."""
    started = time.perf_counter()
    curve = fc.continue_frequency(
        structure,
        *RANGE,
        law,
        harmonics=harmonics,
        stability=name == "paper_plate",
        progress=sys.stderr.isatty(),
    )
    seconds = time.perf_counter() - started
    errors = [curve.solution(i).report.total for i in range(0, len(curve), len(curve) // CHECKED)]
    known = [error for error in errors if error < 1.0]
    print(
        f"{name}: {len(curve)} points, {len(curve.bifurcations)} bifurcations, {seconds:.1f} s; "
        f"estimated error at {CHECKED} parts of it: unknown at {len(errors) - len(known)} of "
        f"{len(errors)}"
        + (f", median {np.median(known):.2%}, largest {max(known):.0%}" if known else "")
    )
    return curve


def swept(
    file: Path,
    structure: fc.Structure,
    law: fc.UnilateralPenalty,
    corner: tuple[float, float],
    again: bool,
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Exact integration from frequency to frequency, up and down: half peak-to-peak [m]."""
    if not again:
        dof = structure.find_dof(corner, "x")
        rows = []
        for direction, frequencies in (("up", SWEEP), ("down", SWEEP[::-1])):
            state = None
            for omega in frequencies:
                history = fc.integrate_events(
                    structure, omega, law, periods=PERIODS, initial=state, record_periods=4
                )
                state = history.final_state
                motion = history.displacement([dof])
                rows.append((direction, omega, np.ptp(motion) / 2.0))
        with open(file, "w", newline="") as target:
            writer = csv.writer(target)
            writer.writerow(("direction", "omega_rad_per_s", "half_peak_to_peak_m"))
            writer.writerows(rows)
    with open(file, newline="") as source:
        table = list(csv.DictReader(source))
    points = {}
    for direction in ("up", "down"):
        chosen = [row for row in table if row["direction"] == direction]
        points[f"in time, swept {direction}"] = (
            np.array([float(row["omega_rad_per_s"]) for row in chosen]),
            np.array([float(row["half_peak_to_peak_m"]) for row in chosen]),
        )
    return points


def linear_response(
    structure: fc.Structure, corner: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies, and amplitudes of the corner [m] without contact."""
    dof = structure.find_dof(corner, "x")
    small = structure if structure.n_dofs < 100 else fc.reduce_structure(structure, modes=30)
    omega = np.linspace(*RANGE, LINEAR)
    return omega, fc.linear_response(small, dof, omega)


def write(file: Path, curve: fc.ResponseCurve, dof: int) -> None:
    """Points and bifurcations as CSV."""
    with open(file, "w", newline="") as target:
        writer = csv.writer(target)
        writer.writerow(("omega_rad_per_s", "half_peak_to_peak_m", "largest_multiplier"))
        largest = np.full(len(curve), np.nan)
        if curve.multipliers is not None:
            largest = np.abs(curve.multipliers)
        writer.writerows(zip(curve.omega, curve.amplitude(dof), largest, strict=True))
    with open(file.with_name(f"{file.stem}_bifurcations.csv"), "w", newline="") as target:
        writer = csv.writer(target)
        writer.writerow(("kind", "omega_rad_per_s"))
        writer.writerows((b.kind, b.omega) for b in curve.bifurcations)


if __name__ == "__main__":
    given = [argument for argument in sys.argv[1:] if argument != "--again"]
    folder = Path(given[0]) if given else Path("output/resonances")
    main(folder, again="--again" in sys.argv)
    print(f"results in {folder}/")
