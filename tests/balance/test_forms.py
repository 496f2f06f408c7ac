"""The three forms of harmonic balance: classical, high-dimensional (collocation), incremental."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers import (
    BILINEAR_ORBITS,
    OMEGA_0,
    Cubic,
    block_system,
    chain,
    classical_amplitudes,
    dense_matrices,
    duffing,
    duffing_system,
    evaluate,
    log_slope,
    newton_roots,
    oscillator,
    relative,
    to_complex,
    true_error,
)
from incremental import incremental_system
from laboratory import solve_form

import fenics_crack as fc
from fenics_crack import ContactLaw, Problem

# --- the high-dimensional form is collocation -----------------------------------------------------


def instants(harmonics: int) -> np.ndarray:
    """2H+1 phases."""
    return 2.0 * np.pi / (2 * harmonics + 1) * np.arange(2 * harmonics + 1)


def differentiation(harmonics: int) -> np.ndarray:
    """D_ij = (-1)^(i-j) / (2 sin((theta_i - theta_j) / 2)), D_ii = 0: d/dtheta of a wave known at
    2H+1 instants."""
    index = np.arange(2 * harmonics + 1)
    difference = index[:, None] - index
    with np.errstate(divide="ignore"):
        matrix = 0.5 * (-1.0) ** difference / np.sin(np.pi * difference / len(index))
    np.fill_diagonal(matrix, 0.0)
    return matrix


LAWS: dict[str, ContactLaw] = {
    "penalty": fc.UnilateralPenalty(np.array([1.0, 20.0, 5.0])),
    "smoothed": fc.SmoothedPenalty(4.0, 30.0),
    "cubic": Cubic(2.0),
}


@pytest.mark.drawn(5)
@pytest.mark.parametrize("form", ["condensed", "block"])
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("subharmonic", [1, 2])
def test_collocation_satisfies_the_equation_of_motion_at_its_instants(
    law: str, subharmonic: int, form: str
) -> None:
    """w^2 M D^2 U + w C D U + K U + B lambda(g) - f = 0 with dense M, C, K and the closed form of
    D, to 1e-9 of the load; the classical solution leaves more than 1e-3."""
    structure, harmonics, omega = chain("matrix"), 6, 0.9
    mass, dashpots, stiffness = dense_matrices(structure)
    pairs, theta, d = structure.gap.toarray(), instants(harmonics), differentiation(harmonics)
    base = omega / subharmonic
    problem = Problem(structure, omega, LAWS[law], harmonics, subharmonic=subharmonic)
    drive = evaluate(problem.load, 1.0, theta)

    def left(solution: fc.PeriodicSolution) -> float:
        u = evaluate(solution.displacement_coefficients, 1.0, theta)
        force = LAWS[law].force(u @ pairs - structure.clearance)
        motion = base**2 * d @ d @ u @ mass + base * d @ u @ dashpots.T + u @ stiffness
        return relative(motion + force @ pairs.T, drive)

    collocation_solution, galerkin_solution = (
        solve_form(problem, balance=balance, form=form, residual_tolerance=1e-12)
        for balance in ("collocation", "galerkin")
    )
    assert left(collocation_solution) < 1e-9
    assert left(galerkin_solution) > 1e-3


# --- spurious solutions: a Duffing oscillator -----------------------------------------------------


def collocation_roots(harmonics: int) -> np.ndarray:
    """All 3^(2H+1) complex roots (roots, 2H+1) of L x + x^3 = f, the collocated equation.

    The leading terms x_i^3 have no common factors: the equations are a Groebner basis as they
    stand. Multiplication by a random linear form maps the monomials with exponents of at most 2,
    reduced by x_i^3 = f_i - (L x)_i, onto themselves; the eigenvectors of this matrix, transposed,
    are the monomials' values at the roots.
    """
    d, unit = differentiation(harmonics), np.eye(2 * harmonics + 1)
    linear, load = 4.0 * d @ d + 0.4 * d + unit, 1.25 * np.sin(instants(harmonics))
    count, shape = len(load), (3,) * len(load)

    @cache
    def reduced(exponents: tuple[int, ...]) -> np.ndarray:
        for i, exponent in enumerate(exponents):
            if exponent > 2:
                rest = np.array(exponents)
                rest[i] -= 3
                terms = [linear[i, j] * reduced(tuple(rest + step)) for j, step in enumerate(steps)]
                return load[i] * reduced(tuple(rest)) - sum(terms)
        place = np.zeros(3**count)
        place[np.ravel_multi_index(exponents, shape)] = 1.0
        return place

    steps = np.eye(count, dtype=int)
    form = np.random.default_rng(0).normal(size=count)
    basis = [np.array(exponents) for exponents in itertools.product(range(3), repeat=count)]
    product = np.array(
        [sum(c * reduced(tuple(e + s)) for c, s in zip(form, steps, strict=True)) for e in basis]
    )
    values = np.linalg.eig(product)[1]
    roots: np.ndarray = (values / values[0])[[np.ravel_multi_index(s, shape) for s in steps]].T
    assert np.abs(roots @ linear.T + roots**3 - load).max() < 1e-6
    return roots


@pytest.mark.verification
def test_duffing_with_spurious_roots() -> None:
    """3 roots by the classical form, 9 by collocation: by algebra, and by the package's equations.

    From 4H+1 = 5 samples on, which give the coefficients of a cube exactly, the 6 others are gone.
    """
    exact = classical_amplitudes()
    for samples in (5, 6, 64):
        solutions = np.array(newton_roots(duffing_system(1, samples)))
        assert np.allclose(
            np.sort(np.hypot(solutions[:, 1, 0], solutions[:, 2, 0])), exact, atol=1e-9
        )
        assert np.abs(solutions[:, 0]).max() < 1e-9
    roots = collocation_roots(1)
    real_roots = roots[np.abs(roots.imag).max(axis=1) < 1e-8].real
    assert len(roots) == 27 and len(real_roots) == 9
    solutions = np.array(newton_roots(duffing_system(1, 3)))
    assert len(solutions) == 9
    values = np.array([evaluate(gap, 1.0, instants(1))[:, 0] for gap in solutions])
    distances = np.abs(values[:, None] - real_roots).max(axis=2)
    assert np.all(distances.min(axis=1) < 1e-9) and len(set(distances.argmin(axis=1))) == 9


@pytest.mark.nightly
def test_spurious_roots_of_two_harmonics() -> None:
    """More harmonics bring more of them: 23 of the 243 complex roots are real; classical 3."""
    roots = collocation_roots(2)
    assert len(roots) == 243 and np.sum(np.abs(roots.imag).max(axis=1) < 1e-7) == 23
    assert len(newton_roots(duffing_system(2, 64))) == 3


def test_the_report_reveals_spurious_solutions() -> None:
    """All 9 roots are returned as solutions; their reports tell them apart.

    One is 2 % off and reports that; the others report 11 % and more, and are 30 % and more off the
    solution to which the classical form leads from there.
    """
    structure, law, exact = duffing(), Cubic(1.0), classical_amplitudes()
    problem = Problem(structure, 2.0, law, 1)
    start = solve_form(problem, balance="collocation")
    reported_errors, true_errors = [], []
    for gap in newton_roots(duffing_system(1, 3)):
        spurious_start = fc.PeriodicSolution(
            structure, 2.0, law, start.displacement_coefficients, gap, start.force_coefficients,
            subharmonic=1,
        )  # fmt: skip
        spurious = solve_form(problem, balance="collocation", initial=spurious_start)
        assert spurious.converged and spurious.iterations == 0
        reported_errors.append(spurious.report.sampling)
        classical = fc.solve_harmonic_balance(structure, 2.0, law, harmonics=1, initial=spurious)
        assert np.abs(exact - np.hypot(*classical.gap_coefficients[1:, 0])).min() < 1e-8
        assert classical.report.sampling < 1e-12
        true_errors.append(true_error(spurious, classical))
    order = np.argsort(reported_errors)
    assert np.allclose(np.array(reported_errors)[order[:2]], [0.0205, 0.1128], rtol=0.01)
    assert np.allclose(np.array(true_errors)[order[0]], 0.0208, rtol=0.01)
    assert np.array(true_errors)[order[1:]].min() > 0.3


# --- spurious solutions: contact ------------------------------------------------------------------


def collocated_states(structure: fc.Structure, omega: float, k: float, harmonics: int) -> int:
    """Number of collocation solutions of one pair: each of the 2^(2H+1) choices of the instants at
    which it is closed has one linear solution, which counts if it has these signs."""
    compliance = Problem(structure, omega, fc.UnilateralPenalty(k), harmonics).compliance_model()
    rows = 2 * harmonics + 1
    value, response = (evaluate(np.eye(rows), 1.0, instants(harmonics)), np.empty((rows, rows)))
    displacements = compliance.matrices[:, :, 0] * to_complex(np.eye(rows))
    response[0], response[1::2], response[2::2] = (
        displacements[0].real,
        displacements[1:].real,
        -displacements[1:].imag,
    )
    in_time = value @ response @ np.linalg.inv(value)
    closed_sets = (np.arange(2**rows)[:, None] >> np.arange(rows)) & 1
    free_gaps = np.broadcast_to(value @ compliance.linear_gap, (2**rows, rows, 1))
    gap = np.linalg.solve(np.eye(rows) + k * in_time * closed_sets[:, None, :], free_gaps)[:, :, 0]
    return int(np.sum(np.all((gap > 0.0) == (closed_sets > 0), axis=1)))


def test_spurious_solutions_of_contact(soft_plate: fc.Structure) -> None:
    """Soft contact has one solution at 2H+1 instants, stiff contact several, more with larger H."""
    for omega in BILINEAR_ORBITS:
        assert collocated_states(oscillator(), omega, 1.0, 5) == 1
    assert collocated_states(oscillator(), 0.5 * OMEGA_0, 1.0, 3) == 3
    assert collocated_states(soft_plate, 2000.0, 1e9, 5) == 1
    counts = [collocated_states(soft_plate, 2000.0, 1e11, harmonics) for harmonics in range(2, 7)]
    assert counts == [1, 3, 3, 7, 9]


def test_contact_needs_more_than_alias_free_samples_of_a_cube(soft_plate: fc.Structure) -> None:
    """k = 1e11, H = 3, from random starts: the 3 solutions of collocation; with 4H+1 samples still
    more than one; with 64, and with exact integrals, a single one."""
    law = fc.UnilateralPenalty(1e11)

    def count(samples: int | None) -> int:
        problem = Problem(soft_plate, 2000.0, law, 3, samples, static_above=np.inf)
        return len(newton_roots(problem.system(problem.compliance_model()), 100))

    assert count(7) == collocated_states(soft_plate, 2000.0, 1e11, 3) == 3
    assert count(13) > 1
    assert count(64) == count(None) == 1


ERRORS = {
    "half": (
        [2.86e-3, 5.43e-4, 2.28e-5, 2.33e-6, 2.00e-7],
        [2.59e-1, 3.04e-2, 3.09e-3, 2.86e-3, 3.05e-4],
        (-3.5, -2.3),
    ),
    "one": (
        [3.01e-4, 3.66e-5, 3.90e-6, 3.85e-7, 3.62e-8],
        [8.66e-3, 4.09e-3, 2.02e-3, 2.64e-4, 1.18e-4],
        (-3.3, -1.6),
    ),
    "plate": (
        [5.03e-2, 1.27e-2, 1.31e-3, 4.51e-4, 5.99e-5],
        [2.16e-1, 1.73e-2, 2.26e-3, 3.19e-3, 2.74e-4],
        (-2.4, -2.2),
    ),
}
"""Errors of the classical form and of collocation, fitted slopes: docs/notebook/algorithms.md."""


@pytest.mark.parametrize("scene", ERRORS)
def test_error_of_collocation_on_contact(scene: str, soft_plate: fc.Structure) -> None:
    """They are those of the notebook; the report has the aliasing within a factor of 1.8."""
    structure, omega, stiffness = {
        "half": (oscillator(), 0.5 * OMEGA_0, 1.0),
        "one": (oscillator(), 1.0, 1.0),
        "plate": (soft_plate, 2000.0, 1e9),
    }[scene]
    law, orders = fc.UnilateralPenalty(stiffness), (5, 10, 20, 40, 80)
    reference = fc.solve_harmonic_balance(structure, omega, law, harmonics=200)
    errors = []
    for harmonics in orders:
        problem = Problem(structure, omega, law, harmonics)
        classical = solve_form(problem)
        # Few instants have other solutions, too: that next to the classical one.
        collocation_solution = solve_form(problem, balance="collocation", initial=classical)
        errors.append(
            [true_error(solution, reference) for solution in (classical, collocation_solution)]
        )
        assert classical.report.sampling == 0.0
        aliasing_error = true_error(collocation_solution, classical)
        assert 0.6 < collocation_solution.report.sampling / aliasing_error < 1.8
    for method_errors, expected_errors, slope in zip(
        np.transpose(errors), ERRORS[scene][:2], ERRORS[scene][2], strict=True
    ):
        assert np.allclose(method_errors, expected_errors, rtol=0.03)
        assert log_slope(orders, method_errors) == pytest.approx(slope, abs=0.06)


# --- the incremental form is Newton's method on the classical one ---------------------------------


CASES = [
    pytest.param("penalty", None, id="exact"),
    pytest.param("penalty", 64, id="sampled"),
    pytest.param("penalty", 11, id="collocation"),
    pytest.param("smoothed", 64, id="smoothed"),
    pytest.param("cubic", None, id="cubic"),
]


@pytest.mark.parametrize(("law", "samples"), CASES)
def test_incremental_iterates_are_the_newton_iterates(law: str, samples: int | None) -> None:
    """Step by step from the linear solution, in all dofs, and on the gaps, to 1e-9; from samples
    those of the sparse block system."""
    structure, harmonics, omega = chain("matrix"), 5, 0.9
    problem = Problem(structure, omega, LAWS[law], harmonics, samples)
    compliance = problem.compliance_model()
    system, linear = problem.system(compliance), compliance.displacement(np.zeros((11, 3)))
    with block_system(problem if samples else replace(problem, samples=64)) as (_, residual, slope):
        incremental = newton = linear
        gap, path_length = system.linear_gap.copy(), 0.0
        for _ in range(5):
            matrix, rhs = incremental_system(
                structure, omega, LAWS[law], incremental, samples=samples
            )
            incremental = incremental + np.linalg.solve(matrix, rhs.ravel()).reshape(rhs.shape)
            step = np.linalg.solve(slope(newton), residual(newton).ravel())
            newton = newton - step.reshape(newton.shape)
            point = system.linearise(gap)
            step = point.solve(point.residual)
            gap, path_length = gap - step, path_length + np.linalg.norm(step)
            if samples:
                assert relative(incremental, newton) < 1e-9
            assert relative(structure.gap_of(incremental), gap) < 1e-9
    assert path_length > 0.1 * np.linalg.norm(gap)
