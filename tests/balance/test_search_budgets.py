"""What a search with a number of harmonics takes and says: orbits it found, budgets that end it."""

from __future__ import annotations

import time

import numpy as np
import pytest
from helpers import chain

import fenics_crack as fc
from fenics_crack.balance.assessment import relative_gap_distance
from fenics_crack.numerics.fourier import evaluate_series

RIGID = fc.UnilateralConstraint()


@pytest.fixture(scope="module")
def plate(soft_plate: fc.Structure) -> fc.Structure:
    """The paper's plate by ten modes."""
    return fc.reduce_structure(soft_plate, modes=10, method="massless")


def test_the_orbit_of_a_search_is_error_and_verdict(plate: fc.Structure) -> None:
    """Many harmonics are sought from an exact orbit: no step predicts its error, which is the
    distance to an orbit that is found without harmonic balance."""
    solution = fc.solve_harmonic_balance(plate, 2000.0, RIGID, harmonics=48)
    stability = fc.floquet(plate, solution)
    assert "orbit_prediction_by_newton_step" not in vars(solution.assessment)
    orbit = fc.solve_harmonic_balance(plate, 2000.0, RIGID, tolerance=0.5).orbit
    assert orbit is not None and stability.verdict != "undecided"
    assert solution.report.truncation == pytest.approx(
        relative_gap_distance(solution, orbit), rel=1e-3
    )
    assert abs(stability.multipliers[0]) == pytest.approx(abs(orbit.multipliers[0]), rel=1e-6)


def rubbing_masses() -> tuple[fc.Structure, fc.CoulombFriction]:
    """Two dofs pressed against the ground, which slide and open."""
    structure = fc.Structure.from_matrices(
        np.eye(2), np.array([[1.0, 0.2], [0.2, 1.3]]), gap=[0.0, 1.0], tangential=[1.0, 0.0],
        force_cos=[1.0, 0.5], force_mean=[0.0, 0.1], damping=fc.ModalDamping(0.01),
    )  # fmt: skip
    return structure, fc.CoulombFriction(fc.UnilateralPenalty(50.0), 0.4, 30.0)


def test_friction_ends_by_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without iterations for a single guess, and with no orbit: "no solution" and a remedy, the
    iterations as many as the budget has, besides one for each guess."""
    structure, law = rubbing_masses()
    monkeypatch.setattr("fenics_crack.balance.problem.MAX_FRICTION_SEARCH_WORK", 1.0)
    monkeypatch.setattr(
        "fenics_crack.balance.problem.is_orbit_search_affordable", lambda *given: False
    )
    solution = fc.solve_harmonic_balance(structure, 0.9, law, harmonics=10, throw=False)
    assert not solution.converged and solution.report.unknown
    assert "no solution in" in solution.status and "try other harmonics" in solution.status
    monkeypatch.undo()
    assert fc.solve_harmonic_balance(structure, 0.9, law, harmonics=10).converged


@pytest.mark.nightly
def test_steps_that_are_too_long_are_work() -> None:
    """Along a path without damping most steps are halved: of 12 masses at a stiff stop a search to
    a tolerance took 11 s, where iterations of steps along which the path went on were counted."""
    structure = chain("none", 12)
    start = time.process_time()
    solution = fc.solve_harmonic_balance(
        structure, 0.8, fc.UnilateralPenalty(405.0), tolerance=0.01
    )
    assert solution.orbit is not None and time.process_time() - start < 6.0


def test_coefficients_in_blocks(plate: fc.Structure, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sum of an orbit's coefficients, found from a few instants at a time, is its motion."""
    orbit = fc.solve_harmonic_balance(plate, 2000.0, RIGID, tolerance=0.5).orbit
    monkeypatch.setattr("fenics_crack.motion.orbit.INSTANTS_PER_BLOCK", 64)
    rows = orbit.coefficients(200).displacement
    time = np.linspace(0.0, orbit.period, 50)
    displacement = orbit.displacement_at(time)
    distance = np.abs(evaluate_series(rows, orbit.omega, time) - displacement).max()
    assert distance <= 1e-3 * np.abs(displacement).max()


@pytest.mark.nightly
def test_orbits_that_lie_dense(paper_scene: fc.Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """The paper's plate bounces chaotically: at frequencies that differ by 7e-8 Newton's method
    reaches different orbits, both unstable and as near to the solution, or none in its budget."""
    scene = paper_scene.replace({"harmonic_balance.harmonics": 20})
    verdicts = []
    for flows in (20, 80):
        monkeypatch.setattr("fenics_crack.motion.orbit.MAX_PERIODS_IN_NEWTON_SEARCH", flows)
        for omega in (2142.857, 2142.857143):
            solution = fc.solve(scene.replace({"excitation.omega": omega})).result
            if flows == 20:
                verdicts.append(solution.stability.verdict)
                continue
            orbit = solution.assessment.nearest_orbit
            assert orbit is not None and solution.assessment.relative_orbit_distance < 0.01
            assert np.abs(orbit.multipliers).max() > 2.0
    assert set(verdicts) <= {"unstable", "irregular"}
