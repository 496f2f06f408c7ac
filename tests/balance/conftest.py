"""A reference that takes seconds."""

from __future__ import annotations

import pytest

import fenics_crack as fc


@pytest.fixture(scope="session")
def never_penetrating(soft_plate: fc.Structure) -> fc.PeriodicSolution:
    """The paper's plate with 1 % of damping without penetration, H = 100."""
    return fc.solve_harmonic_balance(soft_plate, 2000.0, fc.UnilateralConstraint(), harmonics=100)
