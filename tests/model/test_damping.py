"""Rayleigh damping: closed forms, the matrix C = a M + b K given as such, and what is damped."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers import chain, dense, dense_matrices, relative
from test_reduced import flexibility, reduced

import fenics_crack as fc
from fenics_crack.model.modal import all_modes
from fenics_crack.model.modes import damped_modes, damped_range, projected_damping

RAYLEIGH = fc.RayleighDamping(0.05, 0.03)
LAW = fc.UnilateralPenalty(4.0)


def with_matrix(structure: fc.Structure) -> fc.Structure:
    """The same structure with C = a M + b K as a matrix."""
    mass, stiffness = dense(structure.mass), dense(structure.stiffness)
    mean, cosine, sine = structure.force
    rule = structure.damping
    return fc.Structure.from_matrices(
        mass, stiffness, structure.gap, force_mean=mean, force_cos=cosine, force_sin=sine,
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
    found = damping.mass / (2.0 * omega) + damping.stiffness * omega / 2.0
    np.testing.assert_allclose(found, ratios, rtol=1e-14)
    np.testing.assert_allclose(damping.rate(omega**2), 2.0 * found * omega, rtol=1e-14)


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
    with pytest.raises(fc.InputError) as caught:
        fc.RayleighDamping(*arguments)
    assert caught.value.key == key and caught.value.value is arguments[key == "damping stiffness"]


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
    with pytest.raises(fc.InputError) as caught:
        fc.RayleighDamping.from_ratios(ratios, omegas)
    assert caught.value.key == key and caught.value.allowed


def test_message_says_which_ratios_fit() -> None:
    """Between which values the ratio at the higher frequency may be."""
    with pytest.raises(fc.InputError, match=r"at 1000 rad/s, from 0.002 to 0.05 at 5000 rad/s$"):
        fc.RayleighDamping.from_ratios((0.06, 0.01), (5000.0, 1000.0))


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
    one = np.ones((1, 1))
    oscillator = fc.Structure.from_matrices(
        mass * one, stiffness * one, None, force_cos=[force], damping=rule
    )
    dashpot = rule.mass * mass + rule.stiffness * stiffness
    expected = force / (stiffness - mass * omega**2 + 1j * omega * dashpot)
    found = fc.solve_linear(oscillator, omega).displacement_coefficients[:, 0]
    np.testing.assert_allclose(found[1:3], [expected.real, -expected.imag], rtol=1e-12)


def test_equals_the_matrix() -> None:
    """A chain with contact, by harmonic balance, all of its modes and its stability."""
    structure = chain("rayleigh")
    same = with_matrix(structure)
    one, other = (fc.solve_harmonic_balance(s, 0.9, LAW, harmonics=15) for s in (structure, same))
    assert relative(one.displacement_coefficients, other.displacement_coefficients) < 1e-10
    assert one.report.total == pytest.approx(other.report.total, rel=1e-6)
    modes = all_modes(structure)
    assert modes.damping.ndim == 1
    np.testing.assert_array_equal(modes.damping, RAYLEIGH.rate(modes.squares))
    one, other = (fc.floquet(s, one).multipliers[0] for s in (structure, same))
    assert abs(one) == pytest.approx(abs(other), rel=1e-9)


def test_reduced() -> None:
    """Its coordinates have the same coefficients, exactly; it moves as with the matrix."""
    structure = chain("rayleigh", 60)
    reduced = fc.reduce_structure(structure, modes=20)
    assert reduced.damping == RAYLEIGH and reduced.reference.damping == RAYLEIGH
    modes = all_modes(reduced)
    np.testing.assert_array_equal(modes.damping, RAYLEIGH.rate(modes.squares))
    np.testing.assert_allclose(
        projected_damping(structure, reduced.basis), dense(reduced.damping_matrix), atol=1e-12
    )
    same = fc.reduce_structure(with_matrix(structure), modes=20)
    one, other = (fc.solve_harmonic_balance(s, 0.4, LAW, harmonics=9) for s in (reduced, same))
    assert relative(one.gap_coefficients, other.gap_coefficients) < 1e-9
    later = fc.reduce_structure(structure.damped(None), modes=20).damped(RAYLEIGH)
    np.testing.assert_array_equal(all_modes(later).damping, RAYLEIGH.rate(all_modes(later).squares))
    assert later.varied(damping=2.0).damping == RAYLEIGH.scaled(2.0)


def test_in_time() -> None:
    """Step by step as with the matrix, also without penetration and by a changed factor."""
    structure = chain("rayleigh").varied(damping=2.0)
    for law in (LAW, fc.UnilateralConstraint()):
        one, other = (
            fc.integrate_central_difference(s, 0.8, law, periods=2, steps_per_period=200)
            for s in (structure, with_matrix(structure))
        )
        assert relative(one.gap, other.gap) < 1e-10


def test_events() -> None:
    """Exactly, from one event to the next."""
    structure = chain("rayleigh")
    one, other = (
        fc.integrate_events(s, 0.8, LAW, periods=2, steps_per_period=50)
        for s in (structure, with_matrix(structure))
    )
    assert relative(one.gap, other.gap) < 1e-9


def test_plate_in_its_sparse_matrices(soft_plate: fc.Structure) -> None:
    """C has no entries but those of M and K; it is formed once and belongs to one structure."""
    plate = soft_plate.damped(fc.RayleighDamping.from_ratios((0.01, 0.02), (2000.0, 9000.0)))
    rule, matrix = plate.damping, plate.damping_matrix
    expected = rule.mass * dense(plate.mass) + rule.stiffness * dense(plate.stiffness)
    np.testing.assert_allclose(dense(matrix), expected, rtol=1e-14)
    assert matrix.getInfo()["nz_used"] <= plate.stiffness.getInfo()["nz_used"]
    assert plate.damping_matrix is matrix and damped_modes(plate) is None
    twice = plate.varied(damping=2.0)
    assert twice.damping == rule.scaled(2.0)
    np.testing.assert_allclose(dense(twice.damping_matrix), 2.0 * expected, rtol=1e-14)
    assert dense(plate.varied(damping=0.0).damping_matrix).max() == 0.0
    np.testing.assert_allclose(dense(plate.damping_matrix), expected, rtol=1e-14)


def test_curve_over_the_factor() -> None:
    """Followed from the damping as given to twice as much."""
    structure = chain("rayleigh")
    curve = fc.continue_parameter(structure, 0.9, LAW, "damping", 1.0, 2.0, harmonics=7)
    end = fc.solve_harmonic_balance(structure.varied(damping=2.0), 0.9, LAW, harmonics=7)
    assert curve.complete
    assert relative(curve.solution(-1).gap_coefficients, end.gap_coefficients) < 1e-8


# --- what is damped -------------------------------------------------------------------------------
def test_range_of_damped_modes() -> None:
    """The highest damped mode, where there are others above it."""
    structure = chain("none", 30)
    omega = fc.solve_modes(structure, 30).omega
    ratios = [0.1, 0.0, 0.1, 0.0]
    for damping, expected in (
        (None, (0, 0.0)),
        (fc.ModalDamping(0.0), (0, 0.0)),
        (fc.ModalDamping(0.0, 3), (0, 0.0)),
        (fc.RayleighDamping(), (0, 0.0)),
        (fc.ModalDamping(0.01), None),
        (fc.ModalDamping(0.01, 30), None),
        (fc.ModalDamping([0.01] * 30), None),
        (fc.RayleighDamping(0.1), None),
        (fc.RayleighDamping(0.0, 0.1), None),
        (fc.ModalDamping(0.01, 4), (4, omega[3])),
        (fc.ModalDamping(ratios, 4), (2, omega[2])),
        (fc.ModalDamping([0.01] * 12 + [0.0] * 18), (12, omega[11])),
    ):
        found = damped_range(structure.damped(damping))
        assert found == (expected and pytest.approx(expected, rel=1e-9)), damping
    assert damped_range(chain("matrix")) is None
    assert damped_range(chain("modal").varied(damping=0.0)) == (0, 0.0)


def test_range_of_a_reduced_structure() -> None:
    """That of the whole where its damping is projected; nothing is left out where all is damped."""
    structure = chain("none", 60)
    few = structure.damped(fc.ModalDamping(0.02, 8))
    last = fc.solve_modes(structure, 8).omega[-1]
    for modes in (5, 8, 20):
        reduced = fc.reduce_structure(few, modes=modes)
        assert damped_range(reduced) == pytest.approx((8, last), rel=1e-9)
        assert damped_range(reduced.damped(fc.ModalDamping(0.02))) is None
        assert damped_range(reduced.damped(None)) == (0, 0.0)
    for rule in (fc.ModalDamping(0.02), RAYLEIGH):
        assert damped_range(fc.reduce_structure(structure.damped(rule), modes=8)) is None


# --- lips without mass ----------------------------------------------------------------------------


def three_rigid_modes(damping: Any = None) -> fc.Structure:
    """20 dofs, two pairs, a load on the rigid modes too."""
    rng = np.random.default_rng(0)
    root = rng.normal(size=(20, 17))
    gap = np.zeros((20, 2))
    gap[[3, 7], 0], gap[[11, 2], 1] = (1.0, -1.0), (1.0, -1.0)
    return fc.Structure.from_matrices(
        np.diag(rng.uniform(1.0, 2.0, 20)), root @ root.T, gap, force_cos=rng.normal(size=20),
        damping=damping,
    )  # fmt: skip


def test_damping_matrix_couples_the_modes() -> None:
    """Phi^T C Phi, of dense matrices."""
    structure = chain("matrix", 20)
    _, damping, _ = dense_matrices(structure)
    made = reduced(structure, 6)
    assert made.rate.shape == (6, 6)
    assert relative(made.rate, made.basis.T @ damping @ made.basis) < 1e-9
    assert relative(all_modes(made.varied(damping=3.0)).damping, 3.0 * made.rate) < 1e-12


def test_motions_as_a_rigid_body() -> None:
    """Three of them: kept at frequency zero, with what a matrix damps of them; fewer modes than
    that are refused."""
    structure = three_rigid_modes(0.1 * np.eye(20))
    for modes in (1, 2):
        with pytest.raises(fc.InputError, match=r"^modes = .*at least 3"):
            reduced(structure, modes)
    for modes in (3, 6):
        made = reduced(structure, modes)
        assert np.array_equal(made.omega == 0.0, np.arange(modes) < 3)
        assert all_modes(made).unconstrained
        rate = all_modes(made).damping
        rate = rate if rate.ndim == 2 else np.diag(rate)
        assert relative(rate, 0.1 * made.basis.T @ made.basis) < 1e-8
        gap = structure.gap.toarray()
        assert relative(made.residual, gap.T @ flexibility(structure, modes) @ gap) < 1e-9
        for found, expected in zip(
            (row[1:] for row in made_seen(made)), (row[1:] for row in made_seen(structure)),
            strict=True,
        ):  # fmt: skip
            assert relative(found, expected) < (0.3 if modes == 3 else 0.1)
    assert all_modes(reduced(chain("none", 9, unconstrained=True), 1)).unconstrained


def made_seen(structure: fc.Structure) -> tuple[np.ndarray, np.ndarray]:
    """R_1 and the gap's first harmonic at a low frequency (the mean would fly off), as rows."""
    mass, damping, stiffness = dense_matrices(structure.whole)
    gap, omega = structure.whole.gap.toarray(), 0.1
    if structure is structure.whole:
        solved = np.linalg.solve(
            stiffness - omega**2 * mass + 1j * omega * damping,
            np.column_stack([gap, structure.force[1]]),
        )
        moved = gap.T @ solved
        return np.array([moved[:, :2] * 0.0, moved[:, :2]]), np.array([moved[:, 2], moved[:, 2]])
    modes = all_modes(structure)
    receptance = modes.receptance(np.array([omega]))
    matrix = modes.seen_by_pairs(receptance)[0] + structure.residual  # type: ignore[attr-defined]
    load = structure.force[1] @ modes.shapes
    shape = modes.respond(receptance[0], load + 0j)
    linear = shape @ modes.pairs + structure.force[1] @ modes.static_pairs
    return np.array([0.0 * matrix, matrix]), np.array([linear, linear])
