"""Derivatives of motions under loads of several harmonics, against differences."""

from __future__ import annotations

from helpers import relative
from motion.test_any_load import LAW, loaded

import fenics_crack as fc
from fenics_crack.balance.problem import Problem
from fenics_crack.curves.orbits import OrbitEquations


def test_orbits_over_the_frequency() -> None:
    """The derivative of a motion by the frequency counts every order."""
    family = OrbitEquations(Problem(loaded(), 0.8, LAW, 5), "omega", 0.8, 0.9)
    orbit = fc.solve_harmonic_balance(loaded(), 0.8, LAW, tolerance=1e-4).orbit
    unknown, step = family.unknown(orbit.state, 0.8), 1e-6
    ends = (family.linearise(unknown, p).residual for p in (step, -step))
    upper_residual, lower_residual = ends
    by_parameter = family.linearise(unknown, 0.0).by_parameter
    assert relative(by_parameter, (upper_residual - lower_residual) / (2.0 * step)) < 1e-7
