"""Rayleigh damping: closed forms, the matrix C = a M + b K given as such, and what is damped."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers import catch_error, chain, dense, dense_matrices, relative
from test_reduced import reduced

import fenics_crack as fc

RAYLEIGH = fc.RayleighDamping(0.05, 0.03)
LAW = fc.UnilateralPenalty(4.0)


def with_matrix(structure: fc.Structure) -> fc.Structure:
    """The same structure with C = a M + b K as a matrix."""
    mass, stiffness = dense(structure.mass), dense(structure.stiffness)
    mean, cosine, sine = structure.force
    rule = structure.damping
    return fc.Structure.from_matrices(
        mass, stiffness, gap=structure.gap, force_mean=mean, force_cos=cosine, force_sin=sine,
        clearance=structure.clearance, damping=rule.mass * mass + rule.stiffness * stiffness,
    )  # fmt: skip


# --- coefficients ---------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("ratios", "omegas"),
    [
        ((0.01, 0.02), (1000.0, 5000.0)),
        ((0.02, 0.01), (5000.0, 1000.0)),
        ([0.03, 0.03], np.array([1.0, 7.0])),
        ((0.03, 0.01), (1000.0, 3000.0)),  # of the mass alone
        ((0.01, 0.03), (1000.0, 3000.0)),  # of the stiffness alone
        ((0.1, 0.7), (0.1, 0.7)),
        ((0.01, 0.01), (1000.0, 1000.0 * (1.0 + 1e-15))),
        ((0.0, 0.0), (1.0, 2.0)),
    ],
)
def test_ratios_at_two_frequencies(ratios: Any, omegas: Any) -> None:
    """xi = a/(2 w) + b w/2 gives them back."""
    damping, omega = fc.RayleighDamping.from_ratios(ratios, omegas), np.asarray(omegas)
    rayleigh_ratios = damping.mass / (2.0 * omega) + damping.stiffness * omega / 2.0
    np.testing.assert_allclose(rayleigh_ratios, ratios, rtol=1e-14)
    np.testing.assert_allclose(damping.rate(omega**2), 2.0 * rayleigh_ratios * omega, rtol=1e-14)


def test_one_coefficient_alone() -> None:
    """Where the ratio falls or grows like the frequency, the other is 0."""
    falls = fc.RayleighDamping.from_ratios((0.03, 0.01), (1000.0, 3000.0))
    assert falls.mass == pytest.approx(60.0, rel=1e-14) and falls.stiffness < 1e-20
    grows = fc.RayleighDamping.from_ratios((0.01, 0.03), (1000.0, 3000.0))
    assert grows.stiffness == pytest.approx(2e-5, rel=1e-14) and grows.mass < 1e-12


@pytest.mark.parametrize(
    ("key", "arguments"),
    [
        ("damping mass", (-1.0, 0.0)),
        ("damping mass", (np.nan, 0.0)),
        ("damping mass", ("much", 0.0)),
        ("damping mass", (None, 0.0)),
        ("damping mass", ([1.0], 0.0)),
        ("damping stiffness", (0.0, -1e-9)),
        ("damping stiffness", (0.0, np.inf)),
        ("damping stiffness", (0.0, True)),
    ],
)
def test_wrong_coefficients(key: str, arguments: tuple[Any, Any]) -> None:
    """They are finite and not negative."""
    catch_error(lambda: fc.RayleighDamping(*arguments), key, arguments[key == "damping stiffness"])


@pytest.mark.parametrize(
    ("key", "ratios", "omegas"),
    [
        ("damping ratios", 0.01, (1.0, 2.0)),
        ("damping ratios", (0.01, 0.01, 0.01), (1.0, 2.0)),
        ("damping ratios", (-0.01, 0.01), (1.0, 2.0)),
        ("damping ratios", (np.nan, 0.01), (1.0, 2.0)),
        ("damping ratios", "ab", (1.0, 2.0)),
        ("damping omegas", (0.01, 0.01), (1.0, 1.0)),
        ("damping omegas", (0.01, 0.01), (0.0, 1.0)),
        ("damping omegas", (0.01, 0.01), (-1.0, 1.0)),
        ("damping omegas", (0.01, 0.01), (1.0, np.inf)),
        ("damping omegas", (0.01, 0.01), None),
        # a coefficient would be negative
        ("damping ratios", (0.01, 0.021), (1.0, 2.0)),
        ("damping ratios", (0.021, 0.01), (1.0, 2.0)),
        ("damping ratios", (0.0, 0.01), (1.0, 2.0)),
    ],
)
def test_wrong_ratios(key: str, ratios: Any, omegas: Any) -> None:
    """Two ratios >= 0 at two frequencies > 0, which leave both coefficients >= 0."""
    catch_error(
        lambda: fc.RayleighDamping.from_ratios(ratios, omegas),
        key,
        ratios if key == "damping ratios" else omegas,
    )


def test_message_says_which_ratios_fit() -> None:
    """Between which values the ratio at the higher frequency may be."""
    catch_error(
        lambda: fc.RayleighDamping.from_ratios((0.06, 0.01), (5000.0, 1000.0)),
        "damping ratios",
        (0.06, 0.01),
        names=r"at 1000 rad/s, a ratio from 0\.002 to 0\.05 at 5000 rad/s$",
    )


def test_frozen_scaled_and_in_words() -> None:
    """As the structure prints it; a factor multiplies both coefficients."""
    assert RAYLEIGH.scaled(2.0) == fc.RayleighDamping(0.1, 0.06)
    structure = chain("rayleigh")
    assert repr(structure) == ("Structure(10 dofs, 3 pairs, Rayleigh damping 0.05/s M + 0.03 s K)")
    assert "0.1/s M + 0.06 s K" in repr(structure.varied(damping=2.0))
    with pytest.raises(AttributeError):
        RAYLEIGH.mass = 1.0  # type: ignore[misc]


# --- responses ------------------------------------------------------------------------------------
@pytest.mark.verification
@pytest.mark.parametrize("omega", [0.3, 1.0, 2.0, 10.0])
@pytest.mark.parametrize("rule", [RAYLEIGH, fc.RayleighDamping(0.2), fc.RayleighDamping(0.0, 0.1)])
def test_oscillator(rule: fc.RayleighDamping, omega: float) -> None:
    """m x'' + (a m + b k) x' + k x = f cos(w t) in closed form."""
    mass, stiffness, force = 3.0, 12.0, 0.7
    unit = np.ones((1, 1))
    oscillator = fc.Structure.from_matrices(
        mass * unit, stiffness * unit, gap=None, force_cos=[force], damping=rule
    )
    dashpot = rule.mass * mass + rule.stiffness * stiffness
    exact_amplitude = force / (stiffness - mass * omega**2 + 1j * omega * dashpot)
    coefficients = fc.solve_linear(oscillator, omega).displacement_coefficients[:, 0]
    np.testing.assert_allclose(
        coefficients[1:3], [exact_amplitude.real, -exact_amplitude.imag], rtol=1e-12
    )


def test_equals_the_matrix() -> None:
    """A chain with contact, by harmonic balance, all of its modes and its stability."""
    structure = chain("rayleigh")
    matrix_structure = with_matrix(structure)
    solution, matrix_solution = (
        fc.solve_harmonic_balance(s, 0.9, LAW, harmonics=15) for s in (structure, matrix_structure)
    )
    assert (
        relative(solution.displacement_coefficients, matrix_solution.displacement_coefficients)
        < 1e-10
    )
    assert solution.report.total == pytest.approx(matrix_solution.report.total, rel=1e-6)
    multiplier, matrix_multiplier = (
        fc.floquet(s, solution).multipliers[0] for s in (structure, matrix_structure)
    )
    assert abs(multiplier) == pytest.approx(abs(matrix_multiplier), rel=1e-9)


def test_reduced() -> None:
    """Its coordinates have the same coefficients, exactly; it moves as with the matrix."""
    structure = chain("rayleigh", 60)
    reduced_structure = fc.reduce_structure(structure, modes=20)
    assert reduced_structure.damping == RAYLEIGH and reduced_structure.reference.damping == RAYLEIGH
    project_damping_on_columns = (
        reduced_structure.basis.T @ dense_matrices(structure)[1] @ reduced_structure.basis
    )
    np.testing.assert_allclose(
        project_damping_on_columns, dense(reduced_structure.damping_matrix), atol=1e-12
    )
    reduced_matrix_structure = fc.reduce_structure(with_matrix(structure), modes=20)
    direct_solution, matrix_solution = (
        fc.solve_harmonic_balance(s, 0.4, LAW, harmonics=9)
        for s in (reduced_structure, reduced_matrix_structure)
    )
    assert relative(direct_solution.gap_coefficients, matrix_solution.gap_coefficients) < 1e-9
    later = fc.reduce_structure(structure.damped(None), modes=20).damped(RAYLEIGH)
    np.testing.assert_allclose(dense(later.damping_matrix), project_damping_on_columns, atol=1e-12)
    assert later.varied(damping=2.0).damping == RAYLEIGH.scaled(2.0)


def test_plate_in_its_sparse_matrices(soft_plate: fc.Structure) -> None:
    """C has no entries but those of M and K; it is formed once and belongs to one structure."""
    plate = soft_plate.damped(fc.RayleighDamping.from_ratios((0.01, 0.02), (2000.0, 9000.0)))
    rule, matrix = plate.damping, plate.damping_matrix
    dense_damping = rule.mass * dense(plate.mass) + rule.stiffness * dense(plate.stiffness)
    np.testing.assert_allclose(dense(matrix), dense_damping, rtol=1e-14)
    assert matrix.getInfo()["nz_used"] <= plate.stiffness.getInfo()["nz_used"]
    assert plate.damping_matrix is matrix
    twice = plate.varied(damping=2.0)
    assert twice.damping == rule.scaled(2.0)
    np.testing.assert_allclose(dense(twice.damping_matrix), 2.0 * dense_damping, rtol=1e-14)
    assert dense(plate.varied(damping=0.0).damping_matrix).max() == 0.0
    np.testing.assert_allclose(dense(plate.damping_matrix), dense_damping, rtol=1e-14)


# --- lips without mass ----------------------------------------------------------------------------


def test_damping_matrix_couples_the_modes() -> None:
    """Phi^T C Phi, of dense matrices."""
    structure = chain("matrix", 20)
    _, damping, _ = dense_matrices(structure)
    reduced_model = reduced(structure, 6)
    assert reduced_model.modal_damping.shape == (6, 6)
    assert (
        relative(reduced_model.modal_damping, reduced_model.basis.T @ damping @ reduced_model.basis)
        < 1e-9
    )
