"""Modes of a bladed disk beyond those of its families: those that move the crack most."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import catch_error
from reference_flow import size_of_motion
from wheels import RING, ring, wheel_of

import fenics_crack as fc

RIGID = fc.UnilateralConstraint()


@pytest.mark.nightly
def test_one_family_and_twelve_modes_have_half_the_error_of_three_families() -> None:
    """24 modes beside 36: of the tip and of the gap, against 96 modes; the gap's is stated."""
    scene = fc.Scene.from_mapping(RING).replace(
        {"mesh.size": 0.012, "disk.deviation": 0.01, "disk.seed": 3}
    )
    wheel = wheel_of(scene)
    chosen_wheel = fc.reduce_wheel(wheel, 1, more=12)
    structures = fc.reduce_wheel(wheel, 8), fc.reduce_wheel(wheel, 3), chosen_wheel
    omega = float(fc.bilinear_frequencies(chosen_wheel).omega_bilinear[0])
    exact, three, one_family_solution = (
        fc.solve_harmonic_balance(structure, omega, RIGID, harmonics=20) for structure in structures
    )
    assert one_family_solution.structure.n_modes == 24  # type: ignore[attr-defined]
    time = np.linspace(0.0, exact.period, 2000, endpoint=False)
    gap, tip = exact.gap(time), exact.amplitude(wheel.watched_dof)
    motion_size = size_of_motion(gap + chosen_wheel.clearance)
    (gap_error, tip_off), (one_family_error, tip_own) = (
        (
            np.linalg.norm(solution.gap(time) - gap) / motion_size,
            abs(solution.amplitude(wheel.watched_dof) / tip - 1.0),
        )
        for solution in (three, one_family_solution)
    )
    assert one_family_error < 0.5 * gap_error and tip_own < 0.5 * tip_off
    assert one_family_error < 1.3 * one_family_solution.report.reduction


def test_more_modes_than_the_basis_has() -> None:
    """They are refused."""
    catch_error(lambda: fc.reduce_wheel(wheel_of(ring()), 1, more=25), "more", 25, names=" 24,")
