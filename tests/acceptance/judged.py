"""Systems, and the exact motion that answers are held against; of the package the public names."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from helpers import OMEGA_0 as OMEGA_0
from helpers import oscillator as oscillator
from helpers import two_masses as two_masses
from reference_flow import Orbit, ReferenceFlow, size_of_motion

import fenics_crack as fc

NEW = Path(__file__).parents[2] / "benchmarks" / "plate.toml"
"""The plate of `new`."""
START = np.zeros(1)


def chain(pairs: int = 3, count: int = 10, seed: int = 1) -> fc.Structure:
    """Random masses and springs between two walls, pairs between neighbours, loads in both phases
    and in the mean, clearances of both signs, a damping matrix."""
    rng = np.random.default_rng(seed)
    springs = rng.uniform(1.0, 3.0, count + 1)
    stiffness = np.diag(springs[:-1] + springs[1:])
    stiffness -= np.diag(springs[1:-1], 1) + np.diag(springs[1:-1], -1)
    gap = np.zeros((count, pairs))
    for pair in range(pairs):
        gap[3 * pair : 3 * pair + 2, pair] = -1.0, 1.0
    return fc.Structure.from_matrices(
        np.diag(rng.uniform(1.0, 2.0, count)), stiffness, gap=gap,
        force_cos=rng.normal(size=count), force_sin=rng.normal(size=count),
        force_mean=0.3 * rng.normal(size=count), clearance=np.linspace(-0.3, 0.3, pairs),
        damping=0.03 * stiffness,
    )  # fmt: skip


@cache
def plate() -> fc.Structure:
    """Eight pairs without mass on 15 modes of the paper's plate, 1 %."""
    return fc.prepare(
        fc.Scene.from_mapping(
            {
                "geometry": {"width": 0.1, "height": 0.1, "thickness": 1.0},
                "crack": {"edge": "left", "height": 0.05, "length": 0.05},
                "material": {"young": 2e9, "poisson": 0.3, "density": 7800.0},
                "damping": {"ratio": 0.01},
                "excitation": {"omega": 2000.0, "point": [0.1, 0.1], "force_sin": [100.0, 0.0]},
                "contact": {"law": "unilateral"},
                "mesh": {"layout": "grid", "order": 2, "columns": 8, "rows": 8},
                "reduction": {"modes": 15, "method": "massless"},
            }
        )
    ).structure


@cache
def flow_of(structure: fc.Structure, law: Any) -> ReferenceFlow:
    """The exact flow of a structure under a law; sets of closed pairs are kept."""
    return ReferenceFlow(structure, law)


def orbit_of(solution: fc.PeriodicSolution) -> Orbit:
    """The exact orbit next to a solution."""
    flow = ReferenceFlow(solution.structure, solution.contact)
    return flow.orbit(flow.states_of(solution, START)[0], solution.omega, solution.period)


def apart(solution: fc.PeriodicSolution, orbit: Orbit) -> float:
    """Root mean square of the gaps' difference over the period, relative to what of B^T u moves."""
    times = np.arange(len(orbit.gap)) * solution.period / len(orbit.gap)
    size = size_of_motion(orbit.gap + solution.structure.clearance)
    return float(np.linalg.norm(solution.gap(times) - orbit.gap) / size)


def true_error(solution: fc.PeriodicSolution) -> float:
    """The distance of a solution from its orbit."""
    return apart(solution, orbit_of(solution))
