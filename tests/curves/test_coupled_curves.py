"""Response curves of pairs that are seen through a static compliance: the slow gap is followed."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from helpers import catch_error, chain, oscillator

import fenics_crack as fc

RIGID = fc.UnilateralConstraint()
STEEL = """
geometry = { width = 0.08, height = 0.2, thickness = 0.002 }
crack = { edge = "left", height = 0.1, length = 0.025 }
material = { young = 2.1e11, poisson = 0.3, density = 7850.0 }
damping = { ratio = 0.002, modes = "all" }
excitation = { point = [0.08, 0.2], force_sin = [1.0, 0.0], omega = 6000.0 }
contact = { law = "unilateral", pairs = "PAIRS" }
harmonic_balance = { harmonics = 5 }

[mesh]
layout = "graded"
cells = "quadrilateral"
order = 2
size = 0.04
lip_elements = 4
grading = 3.0
"""
SPAN = 8650.0, 8950.0
"""Around the first resonance of the plate with its crack breathing, with two folds [rad/s]."""


def steel(pairs: str) -> fc.Structure:
    """A cracked steel plate with a pair at the crack's mouth, or eight."""
    return fc.build_structure(fc.Scene.from_text(STEEL.replace("PAIRS", pairs), "steel"))


@pytest.fixture(scope="module")
def plate() -> fc.Structure:
    """Eight pairs on lips without mass, five modes: all below what harmonics reach."""
    return fc.reduce_structure(steel("all"), modes=5, method="massless")


@pytest.fixture(scope="module")
def curve(plate: fc.Structure) -> fc.ResponseCurve:
    """Through its resonance, rigid."""
    return fc.continue_frequency(plate, *SPAN, RIGID, harmonics=6)


def folds(curve: fc.ResponseCurve) -> list[float]:
    """Frequencies of the folds, in order."""
    return [b.value for b in curve.bifurcations if b.kind == "fold"]


def newton_step(curve: fc.ResponseCurve, index: int) -> float:
    """How far a point would move, relative to it, with the same modes that answer at once."""
    point = curve.solution(index)
    problem = replace(curve.problem.with_harmonics(point.harmonics), omega=point.omega)
    linearisation = problem.system(problem.compliance_model()).linearise(
        point.gap_series_without_static_part
    )
    return float(
        np.abs(linearisation.solve(linearisation.residual)).max()
        / np.abs(linearisation.unknown).max()
    )


def assert_solutions(curve: fc.ResponseCurve, every: int) -> None:
    """A step of Newton's method does not move points."""
    assert all(newton_step(curve, index) < 1e-6 for index in range(0, len(curve), every))


# --- against ordinary structures ------------------------------------------------------------------


@pytest.fixture(scope="module")
def bilinear() -> fc.ResponseCurve:
    """x'' + 0.1 x' + x + max(0, x) = cos(W t)."""
    law = fc.UnilateralPenalty(1.0)
    return fc.continue_frequency(oscillator(0.1, 1.0), 1.5, 3.0, law, harmonics=10)


@pytest.fixture(scope="module")
def behind_a_spring() -> fc.Structure:
    """The same mass, and a spring of stiffness 1 without mass in series with the pair."""
    structure = fc.Structure.from_matrices(
        np.diag([1.0, 0.25]), np.eye(2), gap=[1.0, 1.0], force_cos=[1.0, 0.0],
        damping=fc.ModalDamping(0.05),
    )  # fmt: skip
    return fc.reduce_structure(structure, modes=1, method="massless")


def test_a_rigid_pair_behind_a_spring(
    bilinear: fc.ResponseCurve, behind_a_spring: fc.Structure
) -> None:
    """R_inf = 1/kc: the bilinear oscillator, whose motion is the slow gap."""
    curve = fc.continue_frequency(behind_a_spring, 1.5, 3.0, RIGID, harmonics=10)
    assert curve.omega == pytest.approx(bilinear.omega, rel=1e-7)
    np.testing.assert_allclose(curve.points, bilinear.points, atol=1e-6)
    assert curve.amplitude(0) == pytest.approx(bilinear.amplitude(0), rel=1e-6)
    solution = curve.solution(5)
    time = np.arange(2**17) * solution.period / 2**17
    force = solution.contact_force(time)[:, 0]
    assert curve.amplitude(1)[5] == pytest.approx(np.ptp(force) / 2.0, rel=1e-9)
    assert solution.gap(time).max() < 1e-12
    np.testing.assert_allclose(curve.coefficients_at(1)[5], -solution.force_coefficients[:, 0])


def test_doubled_branch_of_a_rigid_pair(behind_a_spring: fc.Structure) -> None:
    """From one period doubling of the bilinear oscillator to the other one, by exact orbits."""
    law, ends = fc.UnilateralPenalty(1.0), []
    for structure, contact in ((oscillator(0.1, 1.0), law), (behind_a_spring, RIGID)):
        curve = fc.continue_frequency(structure, 1.5, 3.0, contact, tolerance=1e-2)
        assert [bifurcation.kind for bifurcation in curve.bifurcations] == 2 * ["period_doubling"]
        branch = fc.follow_branch(curve, curve.bifurcations[0])
        assert branch.status == "joined the branch that it left" and branch.subharmonic == 2
        ends += [curve.bifurcations[0].omega, float(branch.omega[-1])]
    assert ends[2:] == pytest.approx(ends[:2], rel=1e-6)


def test_all_modes_are_the_structure_itself() -> None:
    """With all modes nothing is without mass: the ordinary curve, point by point."""
    structure, law = chain(n=6, pairs=1, seed=3), fc.UnilateralPenalty(5.0)
    ordinary = fc.continue_frequency(structure, 0.5, 1.2, law, harmonics=6)
    massless_structure = fc.reduce_structure(structure, modes=6, method="massless")
    curve = fc.continue_frequency(massless_structure, 0.5, 1.2, law, harmonics=6)
    assert curve.static_above is not None and ordinary.static_above is None
    np.testing.assert_array_equal(ordinary.gap_coefficients, ordinary.points)
    assert curve.omega == pytest.approx(ordinary.omega, rel=1e-7)
    np.testing.assert_allclose(curve.points, ordinary.points, atol=1e-6)
    for dof in (1, 5):
        assert curve.amplitude(dof) == pytest.approx(ordinary.amplitude(dof), rel=1e-6)


def test_few_modes_come_close_to_the_structure() -> None:
    """The displacement of a lip too, most of which moves without mass."""
    structure, law = chain(n=10, pairs=1, seed=3), fc.UnilateralPenalty(2.0)
    span = 0.2, 0.4  # around the first resonance
    peak = fc.continue_frequency(structure, *span, law, harmonics=12).amplitude(1).max()
    errors = []
    for modes in (2, 7):
        reduced_structure = fc.reduce_structure(structure, modes=modes, method="massless")
        curve = fc.continue_frequency(reduced_structure, *span, law, harmonics=12)
        assert np.abs(curve.points - curve.gap_coefficients).max() > 0.01
        errors.append(abs(curve.amplitude(1).max() / peak - 1.0))
    assert errors[1] < 0.5 * errors[0] < 0.02


def test_displacement_of_a_curve_is_that_of_its_solutions(curve: fc.ResponseCurve) -> None:
    """Of a lip, with what answers at once: coefficients, and the amplitude with its kinks."""
    lip = int(np.flatnonzero(curve.structure.whole.gap.toarray()[:, 0])[0])
    rows, sizes = curve.coefficients_at(lip), curve.amplitude(lip)
    for index in (0, len(curve) // 2):
        solution = curve.solution(index)
        exact = solution.coefficients_at([lip])[:, 0]
        assert np.abs(rows[index] - exact).max() < 1e-9 * np.abs(exact).max()
        assert sizes[index] == pytest.approx(solution.amplitude(lip), rel=1e-3)


# --- rigid contact --------------------------------------------------------------------------------


def test_eight_pairs_over_a_resonance(curve: fc.ResponseCurve) -> None:
    """Two folds, and all points are solutions."""
    assert curve.complete and len(folds(curve)) == 2
    assert all(b.kind == "fold" for b in curve.bifurcations)
    turns = np.sum(np.diff(np.sign(np.diff(curve.omega))) != 0)
    assert turns == 2 and folds(curve)[0] > folds(curve)[1]
    assert_solutions(curve, 25)
    fold = curve.bifurcations[0]
    assert fold.solution.static_above == curve.static_above
    np.testing.assert_allclose(
        fold.single_point_curve.points[0], fold.solution.gap_series_without_static_part, atol=1e-18
    )


def test_small_structure_with_fast_modes() -> None:
    """Modes above the harmonics answer at once: rigid contact without a reduction."""
    curve = fc.continue_frequency(chain(n=8, pairs=1, seed=3), 0.1, 0.16, RIGID, harmonics=4)
    assert curve.complete and curve.static_above == pytest.approx(2 * 4 * 0.16)
    assert_solutions(curve, 9)


# --- other parameters -----------------------------------------------------------------------------


# --- going on, refining, files --------------------------------------------------------------------


# --- structures with many dofs, and what is refused -----------------------------------------------


def test_what_is_refused(plate: fc.Structure) -> None:
    """One error names the argument, and what helps."""
    nothing = fc.reduce_structure(chain(n=6, pairs=1), modes=6, method="massless")
    for structure, parameter, key, value, names in (
        (oscillator(), "omega", "contact", RIGID, "method='massless'"),
        (plate, "stiffness", "parameter", "stiffness", None),
        (nothing, "omega", "contact law", "unilateral", None),
    ):
        call = partial(fc.continue_parameter, structure, 1.5, RIGID, parameter, 1.0, 2.0)
        catch_error(call, key, value, names=names)


def test_bifurcations_are_measured_as_points(curve: fc.ResponseCurve) -> None:
    """The ends as on the curve, and between them what the solutions there say of themselves."""
    exact = fc.continue_frequency(
        oscillator(0.1, 1.0), 1.5, 3.0, fc.UnilateralPenalty(1.0), tolerance=1e-5
    )
    for measured_curve, dof in ((curve, 0), (exact, 0)):
        special = measured_curve.at_bifurcations
        assert len(special) == len(measured_curve.bifurcations) + 2 > 2
        indicators = special.indicators(dof)
        np.testing.assert_allclose(
            indicators.amplitude[[0, -1]], measured_curve.amplitude(dof)[[0, -1]]
        )
        for number, bifurcation in enumerate(measured_curve.bifurcations, 1):
            solution_indicators = bifurcation.solution.indicators(dof)
            assert (
                special.values[number] == bifurcation.value
                and special.omega[number] == bifurcation.omega
            )
            assert indicators.amplitude[number] == pytest.approx(
                solution_indicators.amplitude, rel=1e-3
            )
            assert indicators.harmonic_1[number] == pytest.approx(
                solution_indicators.harmonic_1, rel=1e-9
            )
            assert indicators.opening[number] == pytest.approx(
                solution_indicators.opening, rel=1e-3
            )
