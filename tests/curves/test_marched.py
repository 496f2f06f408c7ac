"""Verdicts from marched orbits: pairs that are many, coupled, or rigid."""

import numpy as np
import pytest
from helpers import mean_square

import fenics_crack as fc

RIGID = fc.UnilateralConstraint()


@pytest.mark.parametrize("law", [RIGID, fc.UnilateralPenalty(1e9)], ids=["rigid", "penalty"])
@pytest.mark.parametrize("omega", [1500.0, 2000.0, 2600.0])
def test_verdict_is_that_of_the_disturbed_motion(
    light_lips: fc.Structure, omega: float, law: fc.ContactLaw
) -> None:
    """The distance to the orbit shrinks or grows as the leading multiplier says."""
    solution = fc.solve_harmonic_balance(light_lips, omega, law, harmonics=20)
    found = fc.floquet(light_lips, solution)
    assert found.refined and found.verdict in ("stable", "unstable")
    orbit = fc.shoot(light_lips, solution)
    moved = orbit.state * (1.0 + 1e-7)
    distances = []
    for _ in range(40):
        moved = orbit.flow.advance(moved, omega, orbit.period).state
        distances.append(np.linalg.norm(moved - orbit.state))
    rate = (distances[-1] / distances[9]) ** (1.0 / 30.0)
    assert (rate < 1.0) == (found.verdict == "stable")
    assert rate < abs(found.multipliers[0]) + 0.05


def test_two_ways_to_the_multipliers(light_lips: fc.Structure) -> None:
    """Along the wave of 60 harmonics and on the marched orbit: the leading one to 0.03."""
    solution = fc.solve_harmonic_balance(
        light_lips, 1500.0, fc.UnilateralPenalty(1e9), harmonics=60
    )
    marched = fc.floquet(light_lips, solution)
    waves = fc.floquet(light_lips, solution, refine=False)
    assert marched.refined and not waves.refined
    sizes = [abs(one.multipliers[0]) for one in (marched, waves)]
    assert sizes[0] == pytest.approx(sizes[1], abs=0.03)


def test_a_constraint_of_lips_with_mass_is_refused(soft_plate: fc.Structure) -> None:
    """Its verdict would depend on what is left out."""
    solution = fc.solve_harmonic_balance(soft_plate, 2000.0, RIGID, harmonics=10)
    with pytest.raises(fc.InputError, match="massless"):
        fc.floquet(soft_plate, solution)


def test_displacement_error_is_that_of_the_load(light_lips: fc.Structure) -> None:
    """Within a factor 3 of the difference from four times the harmonics."""
    law = fc.UnilateralPenalty(1e9)
    coarse, fine = (
        fc.solve_harmonic_balance(light_lips, 2000.0, law, harmonics=count) for count in (8, 32)
    )
    waves = [one.displacement_coefficients @ light_lips.force[2] for one in (coarse, fine)]
    change = waves[1].copy()
    change[: len(waves[0])] -= waves[0]
    true = np.sqrt(mean_square(change) / mean_square(waves[1]))
    assert true / 3.0 < coarse.report.displacement < 3.0 * true + 3.0 * coarse.report.reduction


def test_bifurcation_on_marched_orbits(light_lips: fc.Structure) -> None:
    """A period doubling of a rigid curve is one of marched orbits too, 1 % away at most."""
    curve = fc.continue_frequency(light_lips, 1500.0, 1525.0, RIGID, harmonics=10, stability=True)
    [doubling] = [one for one in curve.bifurcations if one.kind == "period_doubling"]
    omega, orbit = fc.refine_bifurcation(doubling, reach=0.03)
    assert omega == pytest.approx(doubling.omega, rel=1e-2)
    assert np.abs(orbit.multipliers + 1.0).min() < 1e-6
