"""Indicators of a breathing crack: closed forms, known coefficients, curves against solutions."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import ROOT, chain

import fenics_crack as fc


def test_force_of_a_crack_does_not_depend_on_the_mesh() -> None:
    """Twice the elements along the lips halve the force of the largest pair, not that of all."""
    scene = fc.Scene.load(ROOT / "demos/blade.toml").replace({"excitation.frequency": 600.0})
    indicators = []
    for elements in (3, 6):
        blade = fc.prepare(scene.replace({"mesh.lip_elements": elements}))
        omega = blade.scene.excitation.omega
        solution = fc.solve_harmonic_balance(blade.structure, omega, blade.contact, harmonics=10)
        indicators.append(solution.indicators(0))
    assert indicators[1].crack_force == pytest.approx(indicators[0].crack_force, rel=0.05)
    assert indicators[1].contact_force < 0.75 * indicators[0].contact_force


def bilinear_wave(ratio: float, count: int) -> np.ndarray:
    """A free motion of x'' + x = 0 for x < 0, x'' + r^2 x = 0 for x > 0, over one period."""
    open_share = ratio / (1.0 + ratio)
    time = np.arange(count) / count
    closed_part = np.sin(np.pi * time / (1.0 - open_share)) / ratio
    open_part = -np.sin(np.pi * (time - (1.0 - open_share)) / open_share)
    return np.where(time < 1.0 - open_share, closed_part, open_part)


@pytest.mark.parametrize("massless", [False, True])
def test_curve_has_the_indicators_of_its_solutions(massless: bool) -> None:
    """Point by point, of two dofs at once, with 256 instants instead of 1024."""
    structure: fc.Structure = chain(damping="rayleigh")
    law: fc.ContactLaw = fc.UnilateralPenalty(5.0)
    if massless:
        structure = fc.reduce_structure(structure, modes=6, method="massless")
        law = fc.UnilateralConstraint()
    curve = fc.continue_frequency(structure, 0.5, 0.6, law, harmonics=8)
    for dof, curve_indicators in zip((0, 5), curve.indicators_of_dofs([0, 5]), strict=True):
        assert curve_indicators.to_dict().keys() == curve.indicators(dof).to_dict().keys()
        for index in (0, len(curve) // 2, -1):
            solution_indicators = curve.solution(index).indicators(dof)
            for name, value in solution_indicators.to_dict().items():
                expected_indicator = pytest.approx(
                    value, rel=5e-3, abs=5e-3 * solution_indicators.amplitude, nan_ok=True
                )
                assert getattr(curve_indicators, name)[index] == expected_indicator, name
    assert f"{len(curve)} points" in repr(curve_indicators)
    assert curve_indicators.table().columns[:2] == ["omega [rad/s]", "amplitude [m]"]


def test_a_steady_load_leaves_two_masses_still() -> None:
    """One that varies as little as rounding does not."""
    for size in (0.0, 1e-12):
        structure = fc.Structure.from_matrices(
            np.eye(2), [[2.0, -1.0], [-1.0, 2.0]], gap=[1.0, 0.0], force_mean=[1.0, 0.5],
            force_cos=[size, 0.0], damping=0.1 * np.eye(2),
        )  # fmt: skip
        solution = fc.solve_harmonic_balance(structure, 1.0, fc.UnilateralPenalty(3.0))
        assert solution.is_still == (size == 0.0)
