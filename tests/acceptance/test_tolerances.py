"""What ``tolerance`` promises: the error is below it, and a tighter one is never worse."""

import judged
import numpy as np
import pytest
from helpers import catch_error

import fenics_crack as fc

CASES = {
    "one mass": (judged.oscillator(), fc.UnilateralPenalty(1.0), 1.0),
    "one mass, stiff": (judged.oscillator(), fc.UnilateralPenalty(30.0), 1.3),
    "two masses and a stop": (judged.two_masses(0.3), fc.UnilateralPenalty(100.0), 0.66),
    "three pairs": (judged.chain(), fc.UnilateralPenalty([3.0, 10.0, 30.0]), 1.3),
    "seven pairs": (judged.chain(7, 21, seed=4), fc.UnilateralPenalty(3.0), 0.7),
}
ASKED = [1e-1, 1e-2, 1e-3, 1e-4]


def errors(structure: fc.Structure, law: fc.ContactLaw, omega: float) -> list[float]:
    """The true ones, for each tolerance; all are said to be met."""
    solutions = [
        fc.solve_harmonic_balance(structure, omega, law, tolerance=tolerance) for tolerance in ASKED
    ]
    for solution, tolerance in zip(solutions, ASKED, strict=True):
        assert solution.converged and solution.report.total <= tolerance
        assert f"chosen for an error of {tolerance:g}: H = {solution.harmonics}" in solution.status
    orbit = judged.orbit_of(solutions[-1])
    return [judged.apart(solution, orbit) for solution in solutions]


@pytest.mark.parametrize("name", CASES)
def test_is_met_and_never_worse_than_a_looser_one(name: str) -> None:
    """Against the exact orbit."""
    true_errors = errors(*CASES[name])
    assert np.all(np.array(true_errors) <= ASKED)
    assert np.all(np.diff(true_errors) <= 1e-9)


def test_plate_without_mass() -> None:
    """The modes given limit it, by their reduction's error: without its say, in harmonics alone."""
    structure = judged.plate().reference
    assert structure is not None and structure.n_modes > judged.plate().n_modes
    law = fc.UnilateralConstraint()
    true_errors = []
    for tolerance in (3e-2, 1e-2):
        solution = fc.solve_harmonic_balance(structure, 2000.0, law, tolerance=tolerance)
        true_errors.append(judged.true_error(solution))
        assert true_errors[-1] <= tolerance
    assert true_errors == sorted(true_errors, reverse=True)


@pytest.mark.nightly
def test_modes_given_are_enough() -> None:
    """The error is that of the whole: with twice the modes the orbit is within the tolerance."""
    full_plate, law, tolerance = judged.plate().whole, fc.UnilateralPenalty(1e9), 2e-2
    small_model, large_model = (
        fc.reduce_structure(full_plate, modes=m, method="massless") for m in (40, 80)
    )
    solution = fc.solve_harmonic_balance(small_model, 2000.0, law, tolerance=tolerance)
    large_model_solution = fc.solve_harmonic_balance(
        large_model, 2000.0, law, harmonics=20, initial=solution
    )
    assert judged.apart(solution, judged.orbit_of(large_model_solution)) <= tolerance


def test_what_cannot_be_reached_says_so() -> None:
    """A reduction that leaves more out: an error with the figure, or with throw=False the best
    solution found."""
    law = fc.UnilateralPenalty(1e9)
    catch_error(
        lambda: fc.solve_harmonic_balance(judged.plate(), 2000.0, law, tolerance=1e-7),
        names="1e-05 % was requested; what helps: modes",
        kind=fc.ConvergenceError,
    )
    solution = fc.solve_harmonic_balance(judged.plate(), 2000.0, law, tolerance=1e-7, throw=False)
    assert solution.status.startswith("solved; error") and solution.report.total > 1e-7
    assert judged.true_error(solution) < 3.0 * solution.report.total


def test_plate_of_new_is_never_worse(plate_of_new: fc.Study) -> None:
    """800 Hz: 0.0043, 0.0048, 0.0075 and 0.053 for 1e-2, 1e-3, 1e-4 and 1e-9."""
    structure, omega = plate_of_new.structure, plate_of_new.scene.excitation.omega
    solutions = [
        fc.solve_harmonic_balance(structure, omega, plate_of_new.contact, tolerance=t, throw=False)
        for t in (1e-2, 1e-4, 1e-9)
    ]
    true_errors = [judged.true_error(solution) for solution in solutions]
    assert true_errors == sorted(true_errors, reverse=True)
