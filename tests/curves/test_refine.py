"""Points put between those of a curve."""

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
    peak = fc.continue_frequency(structure, 1.3, 1.05, law, harmonics=6, longest_step=0.004)
    assert fine.amplitude(0).max() == pytest.approx(peak.amplitude(0).max(), rel=1e-4)
    with pytest.raises(fc.InputError, match="between = 1000000"):
        fc.refine_curve(coarse, 1_000_000)


def test_as_many_points_as_a_picture_needs() -> None:
    """Where they lie far apart, and no more; the peak comes out as by short steps."""
    structure, law = oscillator(0.02, 0.1), fc.UnilateralPenalty(1.0)
    coarse = fc.continue_frequency(structure, 2.0, 0.3, law, harmonics=6, longest_step=0.4)
    fine = fc.refine_curve(coarse)
    gaps = np.linalg.norm(np.diff(fine.gap_coefficients[:, :, 0], axis=0), axis=1)
    sizes = np.linalg.norm(fine.gap_coefficients[:, :, 0], axis=1)
    assert np.all(gaps < 0.04 * np.maximum(sizes[1:], sizes[:-1]))
    assert np.all(np.abs(np.diff(fine.omega)) < 0.04 * 1.7) and len(fine) < 12 * len(coarse)
    assert_solutions(fine, 13)
    short = fc.continue_frequency(structure, 1.3, 1.05, law, harmonics=6, longest_step=0.008)
    peak = short.amplitude(0).max()
    assert abs(fine.amplitude(0).max() - peak) <= abs(coarse.amplitude(0).max() - peak)
    assert fine.amplitude(0).max() == pytest.approx(peak, rel=2e-3)


def test_several_pairs_and_kinds_of_contact() -> None:
    """Stiffness of each pair, coupled damping, clearances, samples, a smoothed law."""
    structure = chain(n=6, pairs=2, seed=3)
    for law, samples in (
        (fc.UnilateralPenalty(np.array([2.0, 5.0])), None),
        (fc.UnilateralPenalty(3.0), 256),
        (fc.SmoothedPenalty(np.array([3.0, 2.0]), 20.0), None),
        (Cubic(np.array([1.0, 2.0])), None),
    ):
        coarse = fc.continue_frequency(
            structure, 0.5, 1.0, law, harmonics=4, samples=samples, longest_step=0.1
        )
        fine = fc.refine_curve(coarse, 3)
        assert len(fine) > 3.5 * len(coarse)
        assert_solutions(fine, 17)


@pytest.mark.parametrize(("parameter", "end"), [("load", 3.0), ("stiffness", 50.0)])
def test_other_parameters(parameter: str, end: float) -> None:
    """Solutions of the structure or the law at their values."""
    structure, law = oscillator(0.1, 1.0), fc.UnilateralPenalty(1.0)
    curve = fc.continue_parameter(structure, 1.2, law, parameter, 1.0, end, longest_step=0.2)
    fine = fc.refine_curve(curve, 3)
    assert len(fine) == 4 * len(curve) - 3 and np.all(np.diff(fine.values) > 0.0)
    assert np.all(fine.omega == 1.2)
    for index in range(1, len(fine), 5):
        found = fine.solution(index)
        assert found.report.residual < 1e-8


@pytest.mark.parametrize(
    ("law", "span"),
    [(fc.UnilateralPenalty(20.0), (0.8, 1.2)), (fc.SmoothedPenalty(60.0, 20.0), (1.02, 1.4))],
)
def test_verdicts_come_along(
    law: fc.UnilateralPenalty | fc.SmoothedPenalty, span: tuple[float, float]
) -> None:
    """At the new points too: those of single solutions."""
    structure = oscillator(0.05, 1.0)
    growing = fc.Continuation(
        fc.Problem(structure, span[0], law, 12), "omega", *span, stability=True
    )
    growing.run()
    coarse = growing.curve
    fine = fc.refine_curve(coarse, 2)
    assert len(set(coarse.verdicts)) > 1 and len(fine) > 2.5 * len(coarse)
    assert [one.kind for one in fine.bifurcations] == [one.kind for one in coarse.bifurcations]
    assert fine.multipliers is not None and fc.refine_curve(growing.followed, 2).multipliers is None
    for index in range(0, len(fine), 18):
        alone = fc.floquet(structure, fine.solution(index))
        assert fine.verdicts[index] == alone.verdict
        if alone.verdict != "undecided":
            assert abs(fine.multipliers[index]) == pytest.approx(abs(alone.multipliers[0]))
    assert_solutions(fine, 11)


def test_bad_arguments() -> None:
    """Only curves with some points."""
    structure, law = oscillator(0.1, 1.0), fc.UnilateralPenalty(1.0)
    curve = fc.continue_frequency(structure, 1.0, 1.5, law)
    with pytest.raises(fc.InputError, match="between"):
        fc.refine_curve(curve, 0)
    short = fc.continue_frequency(structure, 1.0, 1.5, law, most_points=2, throw=False)
    with pytest.raises(fc.InputError, match="points"):
        fc.refine_curve(short, 1)
    orbits = fc.continue_frequency(structure, 1.0, 1.5, law, tolerance=1e-2)
    with pytest.raises(fc.InputError, match=r"^curve = 'exact orbits'.*longest_step"):
        fc.refine_curve(orbits, 1)
