"""Exact orbits by shooting."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import oscillator

import fenics_crack as fc
from fenics_crack.balance.orbits import FlowOrbits
from fenics_crack.numerics.bordered import PathPoint, solve_in_plane, tangent_of
from fenics_crack.numerics.path import Crossing
from fenics_crack.stability.floquet import orbits_near


def orbits(omega: float = 1.0) -> FlowOrbits:
    """Of the bilinear oscillator next to a solution with few harmonics."""
    law = fc.UnilateralPenalty(1.0)
    solution = fc.solve_harmonic_balance(oscillator(), omega, law, harmonics=5)
    return orbits_near(oscillator(), law, solution)


def test_slopes_against_differences() -> None:
    """M - I and dF/dp at a state that is no orbit."""
    system = orbits()
    x = 1.1 * system.start
    at, step = system.linearise(x, 1.02), 1e-5
    for index, direction in enumerate(np.eye(2)):
        one, other = (system.linearise(x + h * direction, 1.02) for h in (step, -step))
        slope = (one.residual - other.residual) / (2.0 * step)
        assert at.jacobian[:, index] == pytest.approx(slope, abs=1e-8)
    one, other = (system.linearise(x, 1.02 + h) for h in (step, -step))
    assert at.by_parameter == pytest.approx((one.residual - other.residual) / (2 * step), rel=1e-6)


def test_failure_names_the_closest_residual() -> None:
    """Where residuals get no further."""
    law = fc.UnilateralPenalty(1.0)
    solution = fc.solve_harmonic_balance(oscillator(), 1.0, law, harmonics=5)
    with pytest.raises(fc.ConvergenceError, match=r"closest (0\.0e\+00|\d\.\de-1[2-9])"):
        fc.shoot(oscillator(), solution, tolerance=-1.0)


def test_point_between_two_is_judged_once() -> None:
    """Brent's method asks the test function once at each orbit that it meets."""
    system = orbits()
    start = solve_in_plane(system, system.start, 1.0, None, tolerance=1e-12)
    assert start is not None and start.at is not None
    tangent = tangent_of(system, start.unknown, start.at)
    before = replace(start, tangent=tangent)
    after = solve_in_plane(
        system,
        before.unknown + 0.02 * tangent.x,
        before.parameter + 0.02 * tangent.p,
        tangent,
        tolerance=1e-12,
    )
    assert after is not None
    asked: list[float] = []

    def test(point: PathPoint) -> float:
        asked.append(point.parameter)
        return point.parameter - (before.parameter + 0.004 * tangent.p)

    found = Crossing(test).locate(system, (before, after), 1e-12)
    assert found is not None
    assert found.parameter == pytest.approx(before.parameter + 0.004 * tangent.p, rel=1e-11)
    assert len(set(asked)) == len(asked)


def test_path_leads_to_the_nearer_orbit(paper_structure: fc.Structure) -> None:
    """Little damping and stiff contact: Newton's method leads nowhere. Steps that shrink the
    residual lead to an orbit 0.71 % away, the homotopy to one 0.60 % away."""
    law = fc.UnilateralPenalty(1e10)
    solution = fc.solve_harmonic_balance(paper_structure, 1300.0, law, harmonics=100, throw=False)
    orbit = fc.shoot(paper_structure, solution)
    assert orbit.residual < 1e-10
    assert abs(orbit.multipliers[0]) == pytest.approx(1.560060, rel=1e-5)
    assert solution.judged.distance == pytest.approx(5.96e-3, rel=1e-3)
