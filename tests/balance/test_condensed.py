"""Harmonic balance condensed onto the pairs: equal to the full block system, and to published
orbits."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from helpers import (
    BILINEAR_ORBITS,
    DAMPINGS,
    OMEGA_0,
    amplitudes,
    catch_error,
    chain,
    dense_matrices,
    oscillator,
    relative,
    to_complex,
)
from laboratory import solve_form

import fenics_crack as fc
from fenics_crack import Problem
from fenics_crack.balance.compliance import FactoredCompliance

# --- condensed and full ---------------------------------------------------------------------------


def test_nothing_is_closed() -> None:
    """Many harmonics, the stop out of reach: the linear solution, as with few."""
    for harmonics in (20, 400):
        solution = fc.solve_harmonic_balance(
            oscillator(clearance=100.0), 0.7, fc.UnilateralPenalty(1.0), harmonics=harmonics
        )
        linear = fc.solve_linear(oscillator(), 0.7, harmonics=harmonics)
        assert np.allclose(solution.displacement_coefficients, linear.displacement_coefficients)


LAWS = {
    "exact": (fc.UnilateralPenalty(4.0), None),
    "per pair": (fc.UnilateralPenalty(np.array([1.0, 20.0, 5.0])), None),
    "sampled": (fc.UnilateralPenalty(4.0), 128),
    "smoothed": (fc.SmoothedPenalty(4.0, 30.0), None),
}


@pytest.mark.drawn(10)
@pytest.mark.usefixtures("predicted_errors")
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("damping", DAMPINGS)
@pytest.mark.parametrize("subharmonic", [1, 2])
def test_condensed_is_the_full_block_on_chains(law: str, damping: str, subharmonic: int) -> None:
    """Gaps, forces and all displacements from the same samples agree to 1e-9, the full ones found
    from forces 1 % larger; every pair opens and closes or presses."""
    structure = chain(damping)
    contact, samples = LAWS[law][0], LAWS[law][1] or 256
    has_contact = np.zeros(3, dtype=bool)
    for omega in (0.37, 1.05):
        problem = Problem(structure, omega, contact, 7, samples, subharmonic)
        sampled_solution = solve_form(replace(problem, samples=LAWS[law][1]))
        solution = solve_form(problem, initial=sampled_solution, residual_tolerance=1e-12)
        farther = replace(solution, force_coefficients=1.01 * solution.force_coefficients)
        block = solve_form(problem, form="block", initial=farther, residual_tolerance=1e-12)
        assert block.iterations > 0
        assert relative(solution.gap_coefficients, block.gap_coefficients) < 1e-9
        assert relative(solution.force_coefficients, block.force_coefficients) < 1e-9
        assert relative(solution.displacement_coefficients, block.displacement_coefficients) < 1e-9
        has_contact |= solution.gap(np.linspace(0.0, solution.period, 500)).max(axis=0) > 0.0
    assert np.all(has_contact)


# --- the two compliances --------------------------------------------------------------------------


@contextmanager
def both(
    structure: fc.Structure, base: float, harmonics: int, subharmonic: int = 1
) -> Iterator[tuple[Any, Any]]:
    """The compliance from all modes, and from factorisations."""
    law = fc.UnilateralPenalty(1.0)
    problem = Problem(structure, base * subharmonic, law, harmonics, subharmonic=subharmonic)
    modal_compliance = problem.compliance_model()
    factored_compliance = FactoredCompliance(structure, base, problem.load)
    assert type(modal_compliance) is not type(factored_compliance)
    yield modal_compliance, factored_compliance
    factored_compliance.destroy()


@pytest.mark.parametrize("structure", [*DAMPINGS, "plate"])
def test_modal_compliance_is_the_factored_one(structure: str, wide_plate: fc.Structure) -> None:
    """Matrices, linear gap and displacement to 1e-9, on and off natural frequencies."""
    plate = structure == "plate"
    model = wide_plate if plate else chain(structure)
    first_omega = fc.solve_modes(model, 1).omega[0]
    rng = np.random.default_rng(3)
    for base in (
        (0.41 * first_omega, first_omega / 3.0) if structure != "none" else (0.41 * first_omega,)
    ):
        for subharmonic in (1, 2):
            with both(model, base, 6, subharmonic) as (modal_sum, factor):
                assert relative(modal_sum.matrices, factor.matrices) < 1e-9
                assert relative(modal_sum.linear_gap, factor.linear_gap) < 1e-9
                force = (100.0 if plate else 1.0) * rng.normal(size=(13, model.n_pairs))
                assert relative(modal_sum.displacement(force), factor.displacement(force)) < 1e-9


@pytest.mark.parametrize("damping", ["modal", "matrix", "few modes"])
def test_compliance_by_dense_arithmetic(damping: str) -> None:
    """R_k = B^T Z_k^-1 B and the linear gap with M, C, K as dense arrays, C by its definition."""
    structure, base = chain(damping), 0.31
    mass, dashpots, stiffness = dense_matrices(structure)
    gap = structure.gap.toarray()
    with both(structure, base, 5) as compliances:
        for k in range(6):
            impedance = stiffness - (k * base) ** 2 * mass + 1j * k * base * dashpots
            matrix = gap.T @ np.linalg.solve(impedance, gap)
            force = [structure.force[0], structure.force[1] - 1j * structure.force[2]]
            free_gap = gap.T @ np.linalg.solve(impedance, force[k]) if k < 2 else np.zeros(3)
            free_gap = free_gap - structure.clearance if k == 0 else free_gap
            for compliance in compliances:
                assert np.allclose(compliance.matrices[k], matrix, rtol=0.0, atol=1e-10)
                linear = to_complex(compliance.linear_gap)[k]
                assert np.allclose(linear, free_gap, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("damping", DAMPINGS)
def test_compliance_beyond_the_harmonics(damping: str) -> None:
    """R_k for k > H: exact from all modes; from the 20 lowest to 5 % below a third of the 21st."""
    structure = chain(damping, n=40)
    base = 0.3 / 16.0 * fc.solve_modes(structure, 21).omega[-1]
    exact = Problem(structure, base, fc.UnilateralPenalty(1.0), 16).compliance_model().matrices[6:]
    with both(structure, base, 5) as (modal_compliance, factored_compliance):
        assert relative(modal_compliance.compliance_of_truncated_harmonics(16), exact) < 1e-10
        errors = np.linalg.norm(
            factored_compliance.compliance_of_truncated_harmonics(16) - exact, axis=(1, 2)
        )
    tolerance = 1e-9 if damping == "modal" else 0.05  # all modes are damped, and so known
    assert np.all(errors < tolerance * np.linalg.norm(exact, axis=(1, 2)))


# --- derivatives ----------------------------------------------------------------------------------


def problem_of(kind: str) -> Problem:
    """Of one chain."""
    penalty = fc.UnilateralPenalty(np.array([2.0, 8.0, 3.0]))
    law: fc.ContactLaw = {
        "smoothed": fc.SmoothedPenalty(3.0, 5.0),
        "constraint": fc.UnilateralConstraint(2.0),
        "weighted": fc.UnilateralConstraint(7.0),
    }.get(kind, penalty)
    return Problem(chain("few modes"), 0.52, law, 4, 64 if kind == "sampled" else None)


def system_of(problem: Problem) -> Any:
    """Its condensed equations."""
    return problem.system(problem.compliance_model())


@pytest.mark.parametrize("kind", ["exact", "sampled", "smoothed", "constraint", "weighted"])
def test_jacobian_against_finite_differences(kind: str) -> None:
    """J to 1e-6, its inverse, the form that is not assembled, and the sign of its determinant."""
    system = system_of(problem_of(kind))
    rng = np.random.default_rng(8)
    for _ in range(5):
        unknown = rng.normal(size=system.shape)
        slopes, step = [], 1e-6
        for column in range(unknown.size):
            change = np.zeros(unknown.size)
            change[column] = step
            change = change.reshape(system.shape)
            sides = [system.linearise(unknown + sign * change) for sign in (1.0, -1.0)]
            slopes.append(sides[0].residual - sides[1].residual)
        jacobian = np.array([slope.ravel() for slope in slopes]).T / (2.0 * step)
        point = system.linearise(unknown)
        assert point.sign == np.linalg.slogdet(jacobian)[0]  # whatever is asked for first
        assert relative(point.jacobian, jacobian) < 1e-6
        assert np.linalg.norm(jacobian - np.eye(len(jacobian))) > 0.1
        direction = rng.normal(size=system.shape)
        product = (point.jacobian @ direction.ravel()).reshape(system.shape)
        assert relative(point.apply(direction), product) < 1e-14
        assert relative(point.solve(product), direction) < 1e-9


@pytest.mark.parametrize("kind", ["exact", "sampled", "smoothed", "constraint", "weighted"])
def test_softness_derivative_against_finite_differences(kind: str) -> None:
    """dF / dp between soft contact and the law."""
    system = system_of(problem_of(kind)).system_along_softness()
    unknown = np.random.default_rng(9).normal(size=system.shape)
    sides = [system.linearise(unknown, 0.5 + step).residual for step in (1e-6, -1e-6)]
    slope = (sides[0] - sides[1]) / 2e-6
    assert relative(system.linearise(unknown, 0.5).by_parameter, slope) < 1e-7


def newton(system: Any, start: np.ndarray) -> Any:
    """Plain Newton steps to rounding, from close by."""
    point = system.linearise(start)
    for _ in range(12):
        point = system.linearise(point.unknown - point.solve(point.residual))
    assert np.linalg.norm(point.residual) < 1e-12 * np.linalg.norm(point.unknown)
    return point


@pytest.mark.parametrize("kind", ["exact", "smoothed", "constraint"])
def test_sensitivity_of_the_gap(kind: str) -> None:
    """Change of the gap with the gap without contact, against solving again, to 1e-5."""
    system = system_of(problem_of(kind))
    start = system.linear_gap if kind != "constraint" else np.zeros(system.shape)
    solution = newton(system, start)
    change = np.random.default_rng(10).normal(size=system.shape)
    gap_slope = solution.gap_change(solution.solve(change))
    linear, gaps = system.linear_gap, []
    for sign in (1.0, -1.0):
        system.linear_gap = linear + sign * 1e-6 * change
        gaps.append(newton(system, solution.unknown).gap)
    assert relative(gap_slope, (gaps[0] - gaps[1]) / 2e-6) < 1e-5
    assert np.linalg.norm(gaps[0] - solution.gap) > 1e-8


# --- published orbits -----------------------------------------------------------------------------


@pytest.mark.verification
@pytest.mark.parametrize("form", ["condensed", "block"])
@pytest.mark.parametrize("omega", BILINEAR_ORBITS, ids=["w0/2", "1"])
def test_bilinear_oscillator(omega: float, form: str) -> None:
    """Event-driven reference values at half and full frequency, H = 20, to 1e-5."""
    mean, harmonics, max_gap, min_gap = BILINEAR_ORBITS[omega]
    solution = solve_form(Problem(oscillator(), omega, fc.UnilateralPenalty(1.0), 20), form=form)
    rows = solution.gap_coefficients[:, 0]
    assert rows[0] == pytest.approx(mean, rel=1e-5)
    assert amplitudes(rows)[:3] == pytest.approx(harmonics, rel=1e-5)
    wave = solution.gap(np.linspace(0.0, solution.period, 100001))
    assert wave.max() == pytest.approx(max_gap, rel=1e-5)
    assert wave.min() == pytest.approx(min_gap, rel=1e-5)


@pytest.mark.verification
def test_twice_the_period() -> None:
    """W = 2 w0, asked for twice the period: the orbit of one, every second harmonic of it zero."""
    law, omega = fc.UnilateralPenalty(1.0), 2.0 * OMEGA_0
    single_solution = fc.solve_harmonic_balance(oscillator(), omega, law, harmonics=20)
    assert amplitudes(single_solution.gap_coefficients[:, 0])[0] == pytest.approx(
        0.2419996, abs=1e-6
    )
    doubled_solution = fc.solve_harmonic_balance(
        oscillator(), omega, law, harmonics=20, subharmonic=2
    )
    half_amplitude, whole_amplitude = amplitudes(doubled_solution.gap_coefficients[:, 0])[:2]
    assert half_amplitude < 1e-10 and whole_amplitude == pytest.approx(0.2419996, rel=1e-4)
    # Ten harmonics of the one are twenty of the other, of which every second one is zero.
    ten = fc.solve_harmonic_balance(oscillator(), omega, law, harmonics=10)
    restarted_solution = fc.solve_harmonic_balance(
        oscillator(), omega, law, harmonics=20, subharmonic=2, initial=ten
    )
    assert restarted_solution.iterations <= 1
    assert relative(restarted_solution.gap_coefficients, doubled_solution.gap_coefficients) < 1e-8


# --- refusals -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("form", "omega"), [("condensed", 1.0), ("block", 1.0)])
def test_undamped_resonance_is_an_error(form: str, omega: float) -> None:
    """W at the natural frequency of a structure without damping."""
    catch_error(
        lambda: solve_form(
            Problem(oscillator(damping=None), omega, fc.UnilateralPenalty(1.0)), form=form
        ),
        names="resonance",
        kind=fc.ConvergenceError,
    )


def test_undamped_resonance_that_the_load_does_not_drive() -> None:
    """3 W at the natural frequency: contact keeps the motion finite; against the exact orbit."""
    structure, law = oscillator(damping=None), fc.UnilateralPenalty(1.0)
    solution = fc.solve_harmonic_balance(structure, 1.0 / 3.0, law, harmonics=40)
    orbit = fc.shoot(structure, solution)
    block = fc.solve_harmonic_balance(structure, 1.0 / 3.0, law, harmonics=40, form="block")
    for answer in (solution, block):
        gap = answer.gap(np.arange(512) * answer.period / 512)
        assert np.linalg.norm(gap - orbit.gap) < 1e-4 * np.linalg.norm(orbit.gap)


@pytest.mark.parametrize("damping", [None, 0.1 * np.eye(2), fc.ModalDamping(0.01)])
def test_unconstrained_structure_is_an_error(damping: object) -> None:
    """Nothing holds the masses: the mean contact force moves them without limit."""
    unfixed_structure = fc.Structure.from_matrices(
        np.eye(2), [[1.0, -1.0], [-1.0, 1.0]], gap=[1.0, 0.0], force_cos=[1.0, 0.0], damping=damping
    )
    for form in ("condensed", "block"):
        catch_error(
            partial(
                solve_form, Problem(unfixed_structure, 0.5, fc.UnilateralPenalty(1.0)), form=form
            ),
            names="rigid body",
            kind=fc.ConvergenceError,
        )


def test_without_any_stiffness_is_an_error() -> None:
    """K = 0: the factorisation meets no zero pivot, and yet there is no static answer."""
    unfixed_structure = fc.Structure.from_matrices(
        np.eye(1), np.zeros((1, 1)), gap=[1.0], force_cos=[1.0]
    )
    for form in ("condensed", "block"):
        catch_error(
            partial(
                solve_form, Problem(unfixed_structure, 0.5, fc.UnilateralPenalty(1.0)), form=form
            ),
            names="singular",
            kind=fc.ConvergenceError,
        )


@pytest.mark.parametrize(
    ("form", "off"),
    [
        ("condensed", 0.0), ("condensed", 1e-14), ("condensed", 1e-8),
        ("block", 0.0), pytest.param("block", 1e-14, marks=pytest.mark.nightly),
    ],
)  # fmt: skip
def test_close_to_an_undamped_resonance(form: str, off: float) -> None:
    """At a resonance except for rounding: the solution with a little damping, or an error."""
    full_structure = chain("none", n=8, pairs=1)
    law = fc.UnilateralPenalty(1.0)
    omega = fc.solve_modes(full_structure, 1).omega[0]
    damped_structure = fc.Structure.from_matrices(
        full_structure.mass,
        full_structure.stiffness,
        gap=full_structure.gap,
        force_mean=full_structure.force[0],
        force_cos=full_structure.force[1],
        force_sin=full_structure.force[2],
        clearance=full_structure.clearance,
        damping=1e-7 * np.eye(8),
    )
    expected_gap = fc.solve_harmonic_balance(
        damped_structure, omega, law, harmonics=3
    ).gap_coefficients
    try:
        solution = solve_form(Problem(full_structure, omega * (1.0 + off), law, 3), form=form)
    except fc.ConvergenceError:
        assert off < 1e-8
    else:
        error = relative(solution.gap_coefficients, expected_gap)
        assert error < max(1e-4, 10.0 * solution.report.residual)


def test_structure_without_pairs_is_refused() -> None:
    """Without pairs there are no equations to condense onto."""
    unit = np.ones((1, 1))
    pairless_structure = fc.Structure.from_matrices(
        unit, unit, gap=None, force_cos=[1.0], damping=0.1 * unit
    )
    for contact in (fc.UnilateralPenalty(1.0), fc.UnilateralConstraint()):
        catch_error(
            partial(fc.solve_harmonic_balance, pairless_structure, 1.0, contact),
            "structure",
            "0 pairs",
        )


def test_without_load_nothing_moves() -> None:
    """The zero solution is found for every law and form, and its report is zero."""
    unloaded_structure = oscillator(force=0.0)
    for contact, form in (
        (fc.UnilateralPenalty(3.0), "condensed"),
        (fc.UnilateralPenalty(3.0), "block"),
        (fc.SmoothedPenalty(3.0, 10.0), "condensed"),
        (fc.UnilateralConstraint(), "condensed"),
    ):
        solution = solve_form(Problem(unloaded_structure, 1.0, contact), form=form)
        assert solution.converged and not np.any(solution.gap_coefficients)
        assert not np.any(solution.force_coefficients) and solution.report.total == 0.0
