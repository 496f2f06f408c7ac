"""Solutions from a cold start, and the paths that lead to them."""

import numpy as np
import pytest
from helpers import catch_error, oscillator

import fenics_crack as fc

FREQUENCIES = np.linspace(0.3, 2.0, 300)


@pytest.mark.drawn(6)
@pytest.mark.parametrize("harmonics", [5, 10, 20])
@pytest.mark.parametrize("stiffness", [1.0, 10.0, 100.0, 1000.0])
def test_bilinear_oscillator(stiffness: float, harmonics: int) -> None:
    """Every 10th of 300 frequencies, another ten for each case: no failure, residuals < 1e-9.

    The solution also satisfies the balance of the oscillator's own equation, harmonic by harmonic.
    """
    structure = oscillator(0.02, 0.1)
    law = fc.UnilateralPenalty(stiffness)
    first_index = (3 * round(np.log10(stiffness)) + [5, 10, 20].index(harmonics)) % 10
    order = np.arange(harmonics + 1)
    for omega in FREQUENCIES[first_index::10]:
        solution = fc.solve_harmonic_balance(structure, omega, law, harmonics=harmonics)
        assert solution.converged and solution.report.residual < 1e-9
        rows, force = solution.gap_coefficients[:, 0], solution.force_coefficients[:, 0]
        wave = np.concatenate([rows[:1], rows[1::2] - 1j * rows[2::2]])
        contact = np.concatenate([force[:1], force[1::2] - 1j * force[2::2]])
        unbalance = (1.0 - (order * omega) ** 2 + 0.02j * order * omega) * wave + contact
        unbalance[1] -= 0.1
        # The residual is that of the gap, so that of the forces is larger by the stiffnesses.
        assert (
            np.abs(unbalance).max() < 1e-8 * (1.0 + (harmonics * omega) ** 2) * np.abs(wave).max()
        )


def test_many_pairs_climb_from_few_harmonics() -> None:
    """Twenty stops on a chain, 220 and 420 unknowns: full steps with more and more harmonics, each
    time from the solution with about half of them."""
    stiffness = np.diag(np.full(60, 2.0)) - np.eye(60, k=1) - np.eye(60, k=-1)
    stiffness[-1, -1] = 1.0
    stiffness /= np.linalg.eigvalsh(stiffness)[0]
    load = np.zeros(60)
    load[-1] = 0.1
    structure = fc.Structure.from_matrices(
        np.eye(60), stiffness, gap=np.eye(60)[:, 40:], force_cos=load, damping=0.02 * stiffness
    )
    for omega in (1.1, 1.2):
        for harmonics in (5, 10):
            solution = fc.solve_harmonic_balance(
                structure, omega, fc.UnilateralPenalty(25.0), harmonics=harmonics
            )
            assert solution.status.startswith("from fewer harmonics: converged")
            assert solution.converged and solution.iterations < 60


@pytest.mark.drawn(1)
@pytest.mark.parametrize(("stiffness", "omega"), [(1e12, 2500.0), (1e14, 1500.0)])
def test_contact_stiffer_than_rounding_resolves(
    stiffness: float, omega: float, breathing_plate: fc.Structure
) -> None:
    """k R up to 1e8: solved to what rounding allows, and the report says how far that is."""
    reduced_structure = fc.reduce_structure(breathing_plate)
    law = fc.UnilateralPenalty(stiffness)
    solution = fc.solve_harmonic_balance(reduced_structure, omega, law, harmonics=10)
    assert solution.converged and solution.iterations < 500
    assert solution.report.residual < 1e-21 * stiffness
    assert solution.report.penetration < 1e9 / stiffness


def test_stiffness_beyond_all_rounding_is_refused() -> None:
    """k R of 1e16: no digit would be left; the constraint is not loosened by its penalties."""
    structure = oscillator(0.02, 0.1)
    catch_error(
        lambda: fc.solve_harmonic_balance(structure, 0.9, fc.UnilateralPenalty(1e16)),
        "contact stiffness",
        1e16,
        names="UnilateralConstraint",
    )
    rigid = fc.UnilateralConstraint(weight=1e6)
    solution = fc.solve_harmonic_balance(structure, 0.9, rigid, harmonics=5, throw=False)
    assert not solution.converged or solution.report.residual < 1e-8
