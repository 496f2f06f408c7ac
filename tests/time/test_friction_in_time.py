"""Integration in time with friction, against exact orbits; friction in files and along curves."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from helpers import catch_error, chain_stiffness
from motion.test_friction import HERTZ, RIGID, plate, solved

import fenics_crack as fc


def test_exponential_steps_are_of_second_order() -> None:
    """Of the inclined crack from the exact orbit on: gaps over the last period; losses."""
    structure, _ = plate("inclined_crack", 0.005)
    omega, law = 3183.0 * HERTZ, fc.CoulombFriction(RIGID, 0.3)
    solution = solved("inclined_crack", 0.005, omega, 0.3)
    orbit, errors = solution.orbit, []
    size = np.ptp(orbit.gap)
    for steps in (256, 512, 1024):
        history = fc.integrate_exponential(
            structure, omega, law, periods=150, steps_per_period=steps, initial=solution,
            record_periods=1,
        )  # fmt: skip
        errors.append(float(np.abs(history.gap - orbit.gap_at(history.time)).max() / size))
        slide = history.tangential_gap - orbit.tangential_gap_at(history.time)
        assert np.abs(slide).max() < 6e-2 * (512 / steps) ** 2 * size
        loss = history.indicators().friction_loss
        assert loss == pytest.approx(
            orbit.energy_budget.friction.sum(), rel=4e-3 * (1024 / steps) ** 2
        )
    assert errors[-1] < 3.2e-4 and all(3.0 < a / b < 5.0 for a, b in pairwise(errors))


def test_events_follow_the_orbit() -> None:
    structure, _ = plate("inclined_crack", 0.005)
    omega, law = 3183.0 * HERTZ, fc.CoulombFriction(RIGID, 0.3)
    solution = solved("inclined_crack", 0.005, omega, 0.3)
    history = fc.integrate_events(
        structure, omega, law, periods=200, steps_per_period=128, initial=solution, record_periods=1
    )
    exact = solution.orbit.gap_at(history.time)
    np.testing.assert_allclose(history.gap, exact, atol=2e-6 * np.ptp(exact))


def chain(unmoved: int = 0) -> fc.Structure:
    """Six masses with two pairs that a mean load presses, and others that nothing moves."""
    random, n = np.random.default_rng(3), 6
    stiffness = np.eye(n + unmoved)
    stiffness[:n, :n] = chain_stiffness(random.uniform(1.0, 3.0, n + 1))
    gap, tangent, force = np.zeros((n + unmoved, 2)), np.zeros((n + unmoved, 2)), np.zeros((3, n))
    gap[[0, 1], [0, 1]], tangent[[2, 4], [0, 1]], tangent[[3, 5], [0, 1]] = 1.0, 1.0, -1.0
    force[:] = random.normal(size=(3, n))
    force[0, :2] = 2.0
    loads = np.pad(force, ((0, 0), (0, unmoved)))
    return fc.Structure.from_matrices(
        np.eye(n + unmoved), stiffness, gap=gap, tangential=tangent,
        damping=fc.RayleighDamping(0.1, 0),
        force_mean=loads[0], force_cos=loads[1], force_sin=loads[2],
    )  # fmt: skip


def test_pairs_with_mass() -> None:
    """Central differences converge to the exact orbit of pairs with springs; those of a large
    structure, step by step, are the same."""
    law, omega, errors = fc.CoulombFriction(fc.UnilateralPenalty(8.0), 0.4, 5.0), 0.9, []
    structure = chain()
    solution = fc.solve_harmonic_balance(structure, omega, law, tolerance=1e-2, throw=False)
    orbit = solution.orbit
    assert orbit is not None and orbit.friction_number_by_name["slip_share"] > 0.02
    for steps in (256, 2048):
        history = fc.integrate_central_difference(
            structure, omega, law, periods=60, steps_per_period=steps, initial=solution
        )
        last_period = slice(-steps, None)
        exact = orbit.gap_at(history.time[last_period])
        errors.append(float(np.abs(history.gap[last_period] - exact).max() / np.ptp(exact)))
    assert errors[1] < 2e-4 and errors[1] < 0.1 * errors[0]
    forces = [
        fc.integrate_central_difference(
            chain_structure, omega, law, periods=2, steps_per_period=64
        ).tangential_force
        for chain_structure in (structure, chain(unmoved=700))
    ]
    np.testing.assert_allclose(*forces, atol=1e-10)
    catch_error(
        lambda: fc.integrate_central_difference(
            structure,
            omega,
            fc.CoulombFriction(fc.UnilateralPenalty(8.0), 0.3),
            periods=1,
            steps_per_period=64,
        ),
        "contact",
    )


@pytest.mark.nightly
@pytest.mark.parametrize("how", [{"tolerance": 0.05}, {"harmonics": 8}])
def test_curves(tmp_path: Path, how: dict[str, float]) -> None:
    """Over the frequency and the coefficient: points are solutions, also when read again."""
    structure, _ = plate("inclined_crack", 0.005)
    omega, law = 3150.0 * HERTZ, fc.CoulombFriction(RIGID, 0.3)
    curve = fc.continue_frequency(structure, omega, 1.02 * omega, law, **how)  # type: ignore[arg-type]
    assert curve.complete
    index = len(curve) // 2
    solution = fc.solve_harmonic_balance(
        structure, float(curve.omega[index]), law, throw=False, **how
    )  # type: ignore[arg-type]
    assert curve.amplitude()[index] == pytest.approx(solution.amplitude(), rel=5e-3)
    loss = curve.indicators().friction_loss
    assert loss[index] == pytest.approx(solution.indicators().friction_loss, rel=2e-2)
    fc.save(curve, tmp_path / "curve.h5")
    loaded_curve = fc.load(tmp_path / "curve.h5", structure, law)
    np.testing.assert_allclose(loaded_curve.indicators().friction_loss, loss, rtol=1e-6)
    friction_curve = fc.continue_parameter(structure, omega, law, "friction", 1.0, 2.0, **how)  # type: ignore[arg-type]
    assert friction_curve.complete
    harder = fc.CoulombFriction(RIGID, 0.6)
    solution = fc.solve_harmonic_balance(structure, omega, harder, throw=False, **how)  # type: ignore[arg-type]
    assert friction_curve.amplitude()[-1] == pytest.approx(solution.amplitude(), rel=5e-3)
    catch_error(
        lambda: fc.continue_parameter(structure, omega, RIGID, "friction", 1.0, 2.0, **how),
        "parameter",
        "friction",
    )
