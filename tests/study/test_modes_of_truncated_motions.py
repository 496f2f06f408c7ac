"""What is stated of truncated modes where no exact orbit shows it, beside orbits of more modes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers import ROOT
from reference_flow import size_of_motion

import fenics_crack as fc
from fenics_crack.balance.more_modes import MoreModesComparison
from fenics_crack.balance.solution import HarmonicBalanceSolver
from fenics_crack.errors.stated import estimate_solution_errors

KEYS = {
    "curve": None, "sweep": None, "mesh.error": False, "contact.friction_error": False,
    "harmonic_balance.tolerance": None, "harmonic_balance.harmonics": 5,
}  # fmt: skip


def prepared(changes: dict[str, Any]) -> fc.Study:
    """The plate of the benchmarks with some keys changed, for few harmonics."""
    return fc.prepare(fc.Scene.load(ROOT / "benchmarks" / "plate.toml").replace(KEYS | changes))


def solved(study: fc.Study, harmonics: int) -> fc.PeriodicSolution:
    """Its solution with some harmonics."""
    omega = study.scene.excitation.omega
    return fc.solve_harmonic_balance(study.structure, omega, study.contact, harmonics=harmonics)


@pytest.fixture(scope="module")
def study() -> fc.Study:
    """Far above the first resonance, where few harmonics are far from any orbit."""
    return prepared({"crack.length": 0.045, "damping.ratio": 0.0025, "excitation.omega": 10100.0})


def orbit_of(study: fc.Study, modes: int) -> fc.PeriodicOrbit:
    """Return the orbit with so many modes by a search to a tolerance, from nothing."""
    larger_study = fc.prepare(study.scene.replace({"reduction.modes": modes}))
    omega = study.scene.excitation.omega
    solution = fc.solve_harmonic_balance(
        larger_study.structure, omega, larger_study.contact, tolerance=0.5
    )
    return solution.orbit


@pytest.fixture(scope="module")
def true(study: fc.Study) -> float:
    """The change of the gap from the orbit of 20 modes to that of 40, over the share that these
    have of what is left out."""
    few_modes_gap, many_modes_gap = (orbit_of(study, modes).gap for modes in (20, 40))
    return float(
        size_of_motion(many_modes_gap - few_modes_gap)
        / size_of_motion(few_modes_gap)
        / study.structure.error_share_removed_by_reference
    )


@pytest.mark.parametrize("harmonics", [5, 10])
def test_modes_by_an_orbit_that_is_far_away(study: fc.Study, true: float, harmonics: int) -> None:
    """Far away from the solution, the nearest orbit shows what modes change: 16 % where
    two truncated solutions differ by less than 1 %."""
    solution = solved(study, harmonics)
    assert solution.assessment.is_accepted and 0.1 < solution.report.truncation < 1.0
    assert solution.report.reduction == pytest.approx(true, rel=0.1)
    plain_solution = solved(replace(study, structure=study.structure.reference), harmonics)
    time = np.arange(512) * solution.period / 512
    change = size_of_motion(plain_solution.gap(time) - solution.gap(time)) / size_of_motion(
        solution.gap(time)
    )
    assert change / study.structure.error_share_removed_by_reference < 0.2 * true


def test_modes_without_any_orbit(
    study: fc.Study, true: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their error is at least the one by harmonics, of the gap as of each number; that the search
    has ended by its budget is said."""
    monkeypatch.setattr("fenics_crack.motion.orbit.MAX_TAYLOR_PIECES_PER_ORBIT_SEARCH", 10)
    monkeypatch.setattr("fenics_crack.motion.orbit.MAX_PERIODS_IN_NEWTON_SEARCH", 0.1)
    solution = solved(study, 10)
    assert solution.assessment.nearest_orbit is None
    expected_text = "an exact orbit ended at its limit of"
    assert (
        expected_text in solution.assessment.rejection_reason
        and expected_text in fc.floquet(solution.structure, solution).reason
    )
    assert true < 1.5 * solution.report.reduction and solution.report.reduction < 1.0
    report = estimate_solution_errors(study, solution)
    assert not {"modes", "harmonics"} & report.unknown.keys()
    for name in ("amplitude", "opening", "ratio_2_1"):
        parts = report.contributions(name)
        assert parts["modes"] >= 0.999 * parts["harmonics"] > 0.0, name


def test_modes_whose_reference_has_no_orbit(
    study: fc.Study, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Solutions with 40 harmonics show of the opening what orbits do, 11 %; with as many as the
    answer has, 13, they show less than 1 %."""
    settings = {"harmonic_balance.harmonics": None, "harmonic_balance.tolerance": 0.1}
    scene = study.scene.replace(settings)

    def part() -> float:
        run = fc.solve(scene)
        assert run.result.harmonics < 20 and run.result.assessment.nearest_orbit is not None
        return estimate_solution_errors(run, run.result, causes=["modes"]).contributions("opening")[
            "modes"
        ]

    true_part = part()
    monkeypatch.setattr(MoreModesComparison, "orbit", None)
    assert part() == pytest.approx(true_part, rel=0.15)


def test_modes_where_no_solution_converges(
    study: fc.Study, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without an orbit and a solution of more modes the predicted motion has the error, not 0."""
    omega, contact = study.scene.excitation.omega, study.contact

    def reduction() -> float:
        solution = fc.solve_harmonic_balance(
            study.structure, omega, contact, tolerance=0.1, throw=False
        )
        return solution.report.reduction

    true_part, attempt = reduction(), HarmonicBalanceSolver.search_and_solution

    def fail(self: HarmonicBalanceSolver, *starts: Any, **options: Any) -> Any:
        search, found = attempt(self, *starts, **options)
        if self.problem.harmonics < 40:
            return search, found
        return search, replace(found, converged=False).reported(fc.ErrorReport(truncation=1.0))

    monkeypatch.setattr(HarmonicBalanceSolver, "search_and_solution", fail)
    monkeypatch.setattr("fenics_crack.balance.more_modes.find_orbit", lambda *_, **__: None)
    assert 0.3 * true_part < reduction() < 3.0 * true_part


def test_modes_that_change_the_orbit_too_much() -> None:
    """Next to a resonance Newton's method leads from the orbit to none of the reference.

    Orbits from a search from nothing change by 8 % of the gap, 15 % over the share. With 40
    harmonics two solutions show it; with few the predicted motion does, up to four times too large.
    """
    study = prepared(
        {
            "mesh.size": 0.03, "mesh.lip_elements": 2, "reduction.modes": 10,
            "damping.ratio": 1e-3, "excitation.frequency": 830.0,
        }
    )  # fmt: skip
    few_modes_solution = solved(study, 10)
    assert few_modes_solution.assessment.is_accepted and few_modes_solution.report.truncation < 0.1
    assert 0.15 < few_modes_solution.report.reduction < 4.0 * 0.15
    report = estimate_solution_errors(study, few_modes_solution)
    assert "modes" not in report.unknown and report.stated("opening")[1] == "modes"
    larger_orbit = orbit_of(study, 20)
    true_change = abs(
        larger_orbit.face_indicators["opening"]
        / few_modes_solution.assessment.nearest_orbit.face_indicators["opening"]
        - 1.0
    )
    assert (
        true_change / study.structure.error_share_removed_by_reference
        < report.stated("opening")[0]
        < 1.0
    )
    assert 0.1 < solved(study, 40).report.reduction < 0.25
