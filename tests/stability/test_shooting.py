"""Exact orbits by shooting."""

import pytest
from helpers import oscillator

import fenics_crack as fc


def test_failure_names_the_closest_residual() -> None:
    """Where residuals get no further."""
    law = fc.UnilateralPenalty(1.0)
    solution = fc.solve_harmonic_balance(oscillator(), 1.0, law, harmonics=5)
    with pytest.raises(fc.ConvergenceError, match=r"closest (0\.0e\+00|\d\.\de-1[2-9])"):
        fc.shoot(oscillator(), solution, tolerance=-1.0)


def test_path_leads_to_the_nearer_orbit(paper_structure: fc.Structure) -> None:
    """Little damping and stiff contact: Newton's method leads nowhere. Steps that shrink the
    residual lead to an orbit 0.71 % away, the homotopy to one 0.60 % away."""
    law = fc.UnilateralPenalty(1e10)
    solution = fc.solve_harmonic_balance(paper_structure, 1300.0, law, harmonics=100, throw=False)
    orbit = fc.shoot(paper_structure, solution)
    assert orbit.residual < 1e-10
    assert abs(orbit.multipliers[0]) == pytest.approx(1.560060, rel=1e-5)
    assert solution.judged.distance == pytest.approx(5.96e-3, rel=1e-3)
