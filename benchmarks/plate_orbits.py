"""Exact periodic orbits of plates as `fenics-crack new` writes them, and what they cost.

Random plates (10 to 26 rigid pairs on lips without mass, 12 to 39 modes, damping of 0.05 to 1 %),
around the first resonance, at a half and a third of it, and up to three times its frequency. Each
is solved by harmonic balance with H harmonics; then

    pred       the error predicted by one Newton step of the whole wave on the exact flow,
    distance   of the solution from the orbit found, in the gaps, relative to that of B^T u,
    closure    |z(T) - z(0)| / |z(0)|,
    ms         processor time of pred, of the orbit, and of its multipliers.

A part of the orbits is compared with the flow of tests/motion/reference.py, which shares no code
with the kernel: the gap over the period and the leading multiplier.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import common
import numpy as np

import fenics_crack as fc
from fenics_crack.motion.flow import ContactFlow, flow_of
from fenics_crack.motion.orbit import PeriodicOrbit, find_orbit, predicted
from fenics_crack.motion.search import wave_states
from fenics_crack.numerics.fourier import evaluate

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "motion"))
from reference import ReferenceFlow

SEED, PLATES, COMPARED = 25, 40, 8
NEW = Path(__file__).with_name("plate.toml")
COLUMNS = (
    "plate", "pairs", "modes", "xi", "omega", "H", "pred", "distance", "|mu|", "events", "flows",
    "closure", "ms pred", "ms orbit", "ms multipliers", "gap error", "multiplier error",
)  # fmt: skip


def main() -> None:
    """Run it."""
    common.run(
        __doc__, {"orbits": orbits}, harmonics={"type": int, "default": 20},
        seed={"type": int, "default": SEED},
    )  # fmt: skip


def orbits(arguments: common.Arguments) -> None:
    """All plates."""
    random = np.random.default_rng(arguments.seed)
    rows = []
    for number in range(PLATES):
        structure, omega, ratio = plate(random)
        if arguments.quick and number >= COMPARED:
            break
        compared = number % (PLATES // COMPARED) == 0
        found = one(structure, omega, arguments.harmonics, compared=compared)
        rows.append((number, structure.n_pairs, structure.n_modes, ratio, omega, *found))
    common.save_table(arguments.folder / "plate_orbits.csv", "orbits", COLUMNS, rows)
    table = np.array([row[5:] for row in rows], dtype=float)
    closed = table[:, 6] < 1e-10
    spent = np.nansum(table[:, 7:10], axis=1)
    print(f"\n{closed.sum()} of {len(rows)} orbits found and closed to 1e-10.")
    for name, values in (
        ("pred", table[:, 7]), ("orbit", table[:, 8]), ("multipliers", table[:, 9]), ("all", spent),
    ):  # fmt: skip
        shares = np.nanpercentile(values, [50, 95, 100])
        print(f"ms {name}: median {shares[0]:.1f}, 95 % {shares[1]:.1f}, most {shares[2]:.1f}")
    share = table[closed, 2] / table[closed, 1]
    print(f"distance / pred: {np.percentile(share, [0, 5, 50, 95, 100]).round(2)}")
    print(f"worst gap {np.nanmax(table[:, 10]):.1e}, multiplier {np.nanmax(table[:, 11]):.1e}")


def plate(
    random: np.random.Generator, lips: tuple[int, int] = (5, 14), modes: tuple[int, int] = (12, 40)
) -> tuple[fc.ReducedStructure, float, float]:
    """Its reduced structure, a frequency [rad/s], and its damping; from ranges of the elements
    along a lip and of the modes, ends excluded."""
    ratio = float(np.exp(random.uniform(np.log(5e-4), np.log(1e-2))))
    scene = fc.Scene.load(NEW).replace(
        {
            "crack.length": float(random.uniform(0.015, 0.06)),
            "mesh.lip_elements": int(random.integers(*lips)),
            "damping.ratio": ratio,
        }
    )
    count = int(random.integers(*modes))
    structure = fc.reduce_structure(fc.build_structure(scene), modes=count, method="massless")
    near = float(random.uniform(0.95, 1.1))
    factor = random.choice([near, near / 2, near / 3, random.uniform(0.2, 3.0)])
    return structure, float(factor * structure.omega[0]), ratio


def one(structure: fc.Structure, omega: float, harmonics: int, *, compared: bool) -> tuple:
    """One case."""
    law = fc.UnilateralConstraint()
    flow = flow_of(structure, law)
    assert flow is not None
    solution = fc.solve_harmonic_balance(structure, omega, law, harmonics=harmonics, throw=False)
    start = time.process_time()
    states = wave_states(flow, solution.displacement_coefficients, omega)
    guess = predicted(flow, omega, states)
    first = time.process_time()
    orbit = find_orbit(flow, omega, states[0])
    second = time.process_time()
    error = np.nan if guess is None else guess.error
    spent = [1e3 * (first - start), 1e3 * (second - first)]
    if orbit is None:
        nothing = [np.nan] * 3
        return harmonics, error, *nothing, 40, np.nan, *spent, *nothing
    multiplier = abs(orbit.multipliers[0])
    spent.append(1e3 * (time.process_time() - second))
    instants = np.arange(512) * solution.period / 512
    size = np.linalg.norm(evaluate(solution.slow_gap_coefficients, omega, instants))
    away = np.linalg.norm(solution.gap(instants) - orbit.gap_at(instants)) / size
    errors = compare(flow, orbit, instants) if compared else (np.nan, np.nan)
    return (
        harmonics, error, float(away), float(multiplier), orbit.events, orbit.flows, orbit.residual,
        *spent, *errors,
    )  # fmt: skip


def compare(flow: ContactFlow, orbit: PeriodicOrbit, instants: np.ndarray) -> tuple[float, float]:
    """Largest difference of the gap over a period, and of the leading multipliers' moduli."""
    reference = ReferenceFlow(flow, orbit.omega)
    _, states, tangent, _ = reference.advance(orbit.state, orbit.period, instants)
    samples = orbit.samples(instants)
    count = flow.size // 2
    exact, found = (one[:, :count] @ flow.modes.pairs for one in (states, samples.states))
    largest = abs(np.linalg.eigvals(tangent)).max()
    error = abs(largest - abs(orbit.multipliers[0])) / largest
    return float(np.abs(exact - found).max() / np.abs(exact).max()), float(error)


if __name__ == "__main__":
    main()
