"""Points put between those of a curve, all at once."""

import numpy as np
import pytest
from helpers import Cubic, chain, oscillator

import fenics_crack as fc


def assert_solutions(curve: fc.ResponseCurve, every: int) -> None:
    """Each point, solved again from itself, does not move."""
    for index in range(0, len(curve), every):
        solution = curve.solution(index)
        again = fc.solve_harmonic_balance(
            curve.structure,
            solution.omega,
            curve.contact,
            harmonics=solution.harmonics,
            samples=curve.samples,
            subharmonic=curve.subharmonic,
            initial=solution,
        )
        difference = again.gap_coefficients - solution.gap_coefficients
        assert np.abs(difference).max() < 1e-6 * np.abs(solution.gap_coefficients).max()


def test_refined_curve_over_folds() -> None:
    """Nine points between each two of a coarse curve: in order, over both folds, all solutions."""
    structure, law = oscillator(0.02, 0.1), fc.UnilateralPenalty(1.0)
    coarse = fc.continue_frequency(structure, 2.0, 0.3, law, harmonics=6, longest_step=0.2)
    fine = fc.refine_curve(coarse, 9)
    assert len(fine) == 10 * len(coarse) - 9
    assert np.all(np.isin(coarse.omega, fine.omega))
    assert np.mean(fine.iterations) < 3.0
    place = np.hstack([fine.gap_coefficients[:, :, 0], fine.omega[:, None]])
    steps = np.linalg.norm(np.diff(place, axis=0), axis=1) / np.linalg.norm(place[1:], axis=1)
    turns = np.sum(np.diff(np.sign(np.diff(fine.omega))) != 0)
    assert turns == 2 and steps.max() < 0.1
    assert_solutions(fine, 13)
    peak = fc.continue_frequency(structure, 2.0, 0.3, law, harmonics=6, longest_step=0.004)
    assert fine.amplitude(0).max() == pytest.approx(peak.amplitude(0).max(), rel=1e-4)


def test_several_pairs_and_kinds_of_contact() -> None:
    """Stiffness of each pair, coupled damping, clearances, samples, a smoothed law."""
    structure = chain(n=6, pairs=2, seed=3)
    for law, samples in (
        (fc.UnilateralPenalty(np.array([2.0, 5.0])), None),
        (fc.UnilateralPenalty(3.0), 256),
        (fc.SmoothedPenalty(np.array([3.0, 2.0]), 20.0), None),
    ):
        coarse = fc.continue_frequency(
            structure, 0.5, 1.5, law, harmonics=4, samples=samples, longest_step=0.1
        )
        fine = fc.refine_curve(coarse, 3)
        assert len(fine) > 3.5 * len(coarse)
        assert_solutions(fine, 17)


def test_harmonics_and_multipliers_come_along() -> None:
    """Of two neighbours the larger H, and multipliers at the new points too."""
    structure, law = oscillator(0.1, 1.0), fc.UnilateralPenalty(1.0)
    coarse = fc.continue_frequency(
        structure, 0.4, 2.5, law, harmonics=4, tolerance=1e-3, stability=True
    )
    fine = fc.refine_curve(coarse, 2)
    assert set(fine.harmonics) == set(coarse.harmonics)
    assert fine.multipliers is not None and np.all(np.isfinite(fine.multipliers))
    for index in range(0, len(fine), 9):
        largest = abs(fc.floquet(structure, fine.solution(index), refine=False).multipliers[0])
        assert abs(fine.multipliers[index]) == pytest.approx(largest, rel=1e-6)
    assert_solutions(fine, 11)


def test_bad_arguments() -> None:
    """Only curves in frequency, with some points, and laws that can be repeated."""
    structure, law = oscillator(0.1, 1.0), fc.UnilateralPenalty(1.0)
    curve = fc.continue_frequency(structure, 1.0, 1.5, law)
    with pytest.raises(fc.InputError, match="between"):
        fc.refine_curve(curve, 0)
    load = fc.continue_parameter(structure, 1.0, law, "load", 1.0, 2.0)
    with pytest.raises(fc.InputError, match="omega"):
        fc.refine_curve(load, 1)
    short = fc.continue_frequency(structure, 1.0, 1.5, law, most_points=2, throw=False)
    with pytest.raises(fc.InputError, match="points"):
        fc.refine_curve(short, 1)
    each = fc.continue_frequency(structure, 1.0, 1.5, Cubic(np.array([1.0])))
    with pytest.raises(fc.InputError, match="contact"):
        fc.refine_curve(each, 1)
