"""Solutions one after the other: each as it is when it is solved by itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from helpers import chain, oscillator

import fenics_crack as fc
from fenics_crack import ContactLaw
from fenics_crack.balance import neighbours
from fenics_crack.balance.neighbours import Neighbours
from fenics_crack.errors import MOST_HARMONICS
from fenics_crack.numerics.fourier import resized

BLADE = chain("modal")
"""Ten masses, three pairs."""
LIPS = fc.reduce_structure(BLADE, modes=4, method="massless")


@pytest.fixture
def families(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Families that are made from now on."""
    made = []

    def recorded(*given: Any) -> Any:
        made.append(given)
        return whole(*given)

    whole: Callable[..., Any] = neighbours.FrequencyFamily
    monkeypatch.setattr(neighbours, "FrequencyFamily", recorded)
    return made


@pytest.mark.parametrize(
    ("structure", "law"),
    [
        (BLADE, fc.UnilateralPenalty(2.0)),
        (BLADE, fc.SmoothedPenalty(2.0, 30.0)),
        (BLADE, fc.UnilateralConstraint()),
        (LIPS, fc.UnilateralPenalty(50.0)),
        (LIPS, fc.UnilateralConstraint()),
    ],
)
def test_as_solved_alone(structure: fc.Structure, law: ContactLaw, families: list[Any]) -> None:
    """Up and down in frequency; of uncoupled pairs one family serves all."""
    series = Neighbours()
    for omega in (*np.linspace(0.3, 0.4, 5), 0.35):
        found = series.solve(fc.Problem(structure, float(omega), law, 6))
        alone = fc.solve_harmonic_balance(structure, float(omega), law, harmonics=6)
        size = np.abs(alone.gap_coefficients).max()
        np.testing.assert_allclose(
            found.gap_coefficients, alone.gap_coefficients, rtol=0.0, atol=1e-8 * size
        )
        assert found.converged and found.report.residual < 1e-9
        assert found.static_above == alone.static_above and found.omega == omega
        assert found.report.truncation == pytest.approx(alone.report.truncation, rel=1e-4)
        np.testing.assert_allclose(
            found.displacement_coefficients, alone.displacement_coefficients,
            rtol=0.0, atol=1e-7 * np.abs(alone.displacement_coefficients).max(),
        )  # fmt: skip
    if structure is BLADE:
        rigid = isinstance(law, fc.UnilateralConstraint)
        assert len(families) == (0 if rigid else 1)


def test_far_neighbour_does_not_help() -> None:
    """Across a resonance, where Newton's method from the prediction fails, a solution is sought
    without it."""
    structure, law = oscillator(0.1, 100.0), fc.UnilateralPenalty(100.0)
    series = Neighbours()
    statuses = []
    for omega in (0.31, 0.62, 1.1, 0.31):
        found = series.solve(fc.Problem(structure, omega, law, 10))
        assert found.converged and found.report.residual < 1e-9
        again = fc.solve_harmonic_balance(structure, omega, law, harmonics=10, initial=found)
        assert again.iterations <= 1  # it is a solution
        statuses.append(found.status)
    assert any(not status.startswith("from") for status in statuses[1:])


def test_harmonics_follow_the_error() -> None:
    """Each case starts with its neighbour's H; none is above the tolerance."""
    structure, law, tolerance = oscillator(0.1, 1.0), fc.UnilateralPenalty(1.0), 1e-2
    series, counts = Neighbours(tolerance), []
    for omega in np.abs(np.linspace(-2.0, 2.0, 60)) + 0.2:  # down and up
        found = series.solve(fc.Problem(structure, float(omega), law, 3))
        exact = fc.solve_harmonic_balance(
            structure, float(omega), law, harmonics=4 * found.harmonics, initial=found
        )
        change = np.linalg.norm(
            resized(found.gap_coefficients, exact.harmonics) - exact.gap_coefficients
        )
        assert change < 2.0 * tolerance * np.linalg.norm(exact.gap_coefficients)
        counts.append(found.harmonics)
    assert min(counts) == 3 and max(counts) > 5
    assert np.any(np.diff(counts) < 0) and np.any(np.diff(counts) > 0)


def test_a_tolerance_out_of_reach() -> None:
    """Is refused, with the error that there is; the next case is solved without a neighbour."""
    structure, law = oscillator(0.1, 1.0), fc.UnilateralPenalty(1.0)
    series = Neighbours(1e-12)
    with pytest.raises(fc.ConvergenceError, match=f"with H = {MOST_HARMONICS}, stays above 1e-12"):
        series.solve(fc.Problem(structure, 0.5, law, 50))
    series.tolerance = None
    assert series.solve(fc.Problem(structure, 0.51, law, 5)).status.startswith("full Newton")
