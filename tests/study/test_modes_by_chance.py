"""Errors by modes of numbers that the next modes hardly change, beside four times the modes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from helpers import DEMOS, ROOT

import fenics_crack as fc
from fenics_crack.balance.more_modes import MoreModesComparison
from fenics_crack.errors.numbers import compute_orbit_values_by_name
from fenics_crack.motion.flow import exact_flow_or_none
from fenics_crack.motion.orbit import PeriodicOrbit

ALONE = {
    "curve": None, "sweep": None, "mesh.error": False, "contact.friction_error": False,
    "harmonic_balance.tolerance": 0.05,
}  # fmt: skip
PLATE: dict[str, Any] = {
    "geometry.width": 0.0317, "geometry.height": 0.1046, "geometry.thickness": 0.003,
    "material.young": 1.14e11, "material.poisson": 0.33, "material.density": 4430.0,
    "crack.height": 0.0492, "crack.length": 0.00447, "mesh.size": 0.006, "mesh.lip_elements": 8,
    "damping.ratio": 0.0107, "reduction.modes": 10, "excitation.omega": 62200.0,
    "excitation.point": [0.0317, 0.1046], "excitation.force_sin": [18.0, 0.0],
    "output.points": {"far": [0.0, 0.1046]},
}  # fmt: skip
RUBBING: dict[str, Any] = {
    "contact.friction": 0.383, "damping.ratio": 0.0052, "reduction.modes": 15,
    "excitation.frequency": None, "excitation.omega": 56225.0,
    "excitation.force_sin": [60.6, -79.5],
}  # fmt: skip


def true_changes(run: fc.Run[fc.PeriodicSolution]) -> dict[str, float]:
    """Change of each number from the exact orbit to that of four times the modes."""
    result, orbit = run.result, run.result.assessment.nearest_orbit

    def numbers(orbit: PeriodicOrbit) -> dict[str, float]:
        return compute_orbit_values_by_name(
            replace(run, structure=orbit.structure), result, orbit, 1
        )

    larger_orbit = orbit
    for factor in (2, 4):
        structure = fc.reduce_structure(
            run.structure.whole, modes=factor * orbit.structure.n_modes, method="massless",
            reference=False,
        )  # fmt: skip
        flow = exact_flow_or_none(structure, run.contact)
        next_orbit = MoreModesComparison(flow, result.assessment.wave, larger_orbit).orbit
        larger_orbit = next_orbit
    few_modes_numbers, many_modes_numbers = numbers(orbit), numbers(larger_orbit)
    return {
        name: abs(many_modes_numbers[name] - value)
        for name, value in few_modes_numbers.items()
        if name in many_modes_numbers
    }


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("scene", "changes", "names"),
    [
        (
            ROOT / "benchmarks" / "plate.toml",
            PLATE,
            ("crack_force", "far.ux.ratio_3_1", "far.ux.mean_shift", "far.uy.mean_shift"),
        ),
        (DEMOS / "friction.toml", RUBBING, ("friction_loss",)),
        pytest.param(
            DEMOS / "friction.toml", {}, ("amplitude",),
            marks=pytest.mark.nightly,  # its orbit is sought along a path
        ),
    ],
    ids=["plate", "friction", "demo"],
)  # fmt: skip
def test_modes_that_change_a_number_little_by_chance(
    scene: Path, changes: dict[str, Any], names: tuple[str, ...]
) -> None:
    """Twice the modes change these numbers by a fortieth to a third of what four times do; the size
    of the change of the motion states them."""
    run = fc.solve(fc.Scene.load(scene).replace(ALONE | changes))
    true_numbers = true_changes(run)
    for name in names:
        part = run.errors.parts["modes"][name]
        next_change = abs(part.values[0] - part.values[1])
        assert next_change < true_numbers[name] / 3.0 < part.uncertainty(-1), name
        assert true_numbers[name] < 1.6 * part.uncertainty(-1) < 10.0 * true_numbers[name], name
