"""Exact orbits by shooting."""

import numpy as np
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
    assert solution.assessment.distance == pytest.approx(5.96e-3, rel=1e-3)


@pytest.mark.parametrize(("omega", "verdict"), [(0.5, "stable"), (0.05, "undecided")])
def test_slow_load_beside_high_modes(omega: float, verdict: str) -> None:
    """Modes of 1 and 3e4 rad/s: a period has more pieces than a search had. Where two can be
    followed Newton's method finds the orbit; else more harmonics tell the error, and a line why
    there is no verdict."""
    damping = np.diag([0.04, 1.0])
    slow = fc.Structure.from_matrices(
        np.eye(2), np.diag([1.0, 9e8]), [1.0, 1.0], force_cos=[1.0, 1.0], damping=damping
    )
    found = fc.solve_harmonic_balance(slow, omega, fc.UnilateralPenalty(1.0), tolerance=1e-2)
    stability = fc.floquet(slow, found)
    assert stability.verdict == verdict
    assert found.report.total <= 1e-2
    if verdict == "undecided":
        assert "thousand times in a period" in stability.reason
        assert "keep fewer modes" in stability.reason
    else:
        assert fc.shoot(slow, found).residual <= 1e-10
        product = np.exp(-np.trace(damping) * found.period)  # Liouville
        assert abs(np.prod(stability.multipliers)) == pytest.approx(product, rel=1e-5)
