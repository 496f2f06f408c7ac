"""Solutions to a tolerance where the truncated equations have none nearby: orbits of the exact
flow, and the harmonics of these that the tolerance asks for."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from reference_flow import size_of_motion

import fenics_crack as fc

OMEGA = {"one mass": 0.39681408867938706, "three masses": 2.165754283399089}


def bouncing(name: str) -> tuple[fc.Structure, fc.UnilateralPenalty]:
    """A mass that bounces off a stop six times in a period, k R_0 = 1800; three masses with two
    pairs, k R_0 = 140, whose motion does not settle to any period."""
    if name == "one mass":
        mass, stiffness, damping = 1.6447776143, 2.4865193799, 0.0145369478
        unit = np.ones((1, 1))
        structure = fc.Structure.from_matrices(
            mass * unit,
            stiffness * unit,
            gap=np.ones(1),
            force_cos=np.ones(1),
            damping=damping * unit,
        )
        return structure, fc.UnilateralPenalty(4453.8415474818)
    stiffness = np.array([
        [292.8451211053, 68.6585675602, -64.5645207776],
        [68.6585675602, 51.8442050433, -2.1178901927],
        [-64.5645207776, -2.1178901927, 20.2086185454],
    ])  # fmt: skip
    damping = np.array([
        [0.1598260966, 0.0149447426, -0.0430966497],
        [0.0149447426, 0.1601879117, 0.0547555275],
        [-0.0430966497, 0.0547555275, 0.0365597523],
    ])  # fmt: skip
    structure = fc.Structure.from_matrices(
        np.eye(3), stiffness, gap=np.array([[0.0, 1.0], [0.0, 0.0], [-1.0, 0.0]]),
        force_cos=np.array([0.0, 1.0, 1.598834433]),
        force_sin=np.array([0.7596521291, 0.5743035972, -1.2578588327]),
        clearance=np.array([0.0052751815, 0.0]), damping=damping,
    )  # fmt: skip
    return structure, fc.UnilateralPenalty(np.array([176.962024195, 1775.7576049751]))


@cache
def solved(name: str, tolerance: float) -> fc.PeriodicSolution:
    """Its motion, known to a tolerance."""
    structure, law = bouncing(name)
    return fc.solve_harmonic_balance(structure, OMEGA[name], law, tolerance=tolerance)


@pytest.mark.drawn(2)
@pytest.mark.verification
@pytest.mark.parametrize(
    ("name", "tolerance"),
    [
        ("one mass", 1e-2), ("three masses", 1e-2), ("three masses", 1e-3),
        pytest.param("one mass", 1e-3, marks=pytest.mark.nightly),
    ],
)  # fmt: skip
def test_error_is_what_was_asked_for(name: str, tolerance: float) -> None:
    """The gap is as far from the orbit as the harmonics left out say, and the orbit repeats itself
    when central differences march it, which know nothing of the exact flow."""
    solution, omega = solved(name, tolerance), OMEGA[name]
    structure, law = solution.structure, solution.contact
    assert solution.converged and solution.status.startswith("exact orbit")
    assert f"chosen for an error of {tolerance:g}: H = {solution.harmonics}" in solution.status
    assert 0.0 < solution.report.truncation <= solution.report.total <= tolerance
    orbit = fc.shoot(structure, solution)
    time = np.arange(len(orbit.gap)) * solution.period / len(orbit.gap)
    motion_size = size_of_motion(orbit.gap + structure.clearance)
    error = np.linalg.norm(solution.gap(time) - orbit.gap) / motion_size
    assert error == pytest.approx(solution.report.truncation, rel=0.3)
    rate = orbit.flow.modal_model.shapes @ orbit.state[orbit.flow.state_size // 2 :]
    initial_state = orbit.displacement_at(np.zeros(1))[0], rate
    history = fc.integrate_central_difference(
        structure, omega, law, periods=1, steps_per_period=512 * 600, initial=initial_state
    )
    # An error of the march grows by the largest multiplier; which orbit the motion passes first,
    # that of 25 or that of 0.93, depends on rounding.
    max_change = 2e-3 * max(1.0, abs(orbit.multipliers[0]))
    for start_rows, end_rows in zip(initial_state, history.final_state, strict=True):
        assert np.linalg.norm(end_rows - start_rows) < max_change * np.linalg.norm(start_rows)
    march_gap = history.gap[:-1] if len(history.gap) % 512 else history.gap
    march_gap = march_gap[:: len(march_gap) // 512]
    assert np.linalg.norm(march_gap - orbit.gap) < 0.5 * max_change * motion_size


@pytest.mark.parametrize("name", OMEGA)
def test_stability_is_known(name: str) -> None:
    """Enough harmonics are kept that who judges the solution finds the orbit again."""
    solution = solved(name, 1e-2)
    stability = fc.floquet(solution.structure, solution)
    assert stability.refined and stability.verdict != "undecided"
    assert stability.distance <= 3.0 * solution.report.total
