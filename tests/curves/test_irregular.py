"""Solutions next to which no orbit is found, and whose exact motion is irregular."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers import DEMOS, oscillator

import fenics_crack as fc
from fenics_crack.balance.assessment import stated_error
from fenics_crack.cli.command_line import main
from fenics_crack.cli.studies import yield_sweep_warnings
from fenics_crack.motion.attractors import find_irregular_motion
from fenics_crack.motion.flow import exact_flow_or_error

LAW = fc.UnilateralPenalty(1e11)
SCENE = DEMOS / "paper_plate.toml"
OMEGA = 6700.0
"""Of the load [rad/s], where a period has few events."""


@cache
def plate() -> fc.Structure:
    """The paper's plate, whose crack faces bounce."""
    return fc.build_structure(fc.Scene.load(SCENE))


def test_disturbance_grows_as_two_motions_part() -> None:
    """Two exact motions 1e-10 apart, without the flow's derivative, part as the growth says."""
    solution = fc.solve_harmonic_balance(plate(), OMEGA, LAW, harmonics=5)
    stability = fc.floquet(plate(), solution)
    assert stability.verdict == "irregular" and "the exact motion is irregular" in stability.reason
    [motion] = fc.attractors(plate(), solution)
    assert motion.growth == stability.multipliers[0] and motion.orbit is None
    flow = exact_flow_or_error(plate(), LAW)
    states = [solution.assessment.states_at_period_parts[0]]
    states.append(states[0] * (1.0 + 1e-10 * np.random.default_rng(2).normal(size=flow.state_size)))
    distances = []
    for _ in range(11):
        distances.append(np.linalg.norm(flow.energy_weights(OMEGA) * (states[1] - states[0])))
        states = [flow.advance(state, OMEGA, solution.period).state for state in states]
    rate = np.log(distances[10] / distances[1]) / 9
    assert rate == pytest.approx(np.log(motion.growth), rel=0.4)


def test_error_without_an_orbit_is_three_times_a_small_prediction() -> None:
    """One rule for all sizes, which rises up to 1; the report is marked."""
    predicted_errors = np.linspace(0.0, 1.0, 101)
    stated_errors = np.array(
        [stated_error(predicted_error) for predicted_error in predicted_errors.tolist()]
    )
    assert (
        np.all(np.diff(stated_errors) > 0.0)
        and stated_errors[0] == 0.0
        and stated_errors[-1] == 1.0
    )
    assert stated_errors[1] == pytest.approx(0.03, rel=0.03) and np.all(
        stated_errors >= predicted_errors
    )
    solution = fc.solve_harmonic_balance(plate(), OMEGA, LAW, harmonics=5)
    report = solution.report
    assert report.truncation == stated_error(solution.assessment.predicted_error)
    assert not report.confirmed and "a prediction that no exact orbit confirms" in str(report)


def test_stable_motion_is_not_irregular() -> None:
    """Nor is what begins beside it."""
    structure, law = oscillator(), fc.UnilateralPenalty(1.0)
    solution = fc.solve_harmonic_balance(structure, 0.8, law, harmonics=5)
    assert fc.floquet(structure, solution).verdict == "stable"
    assessment = solution.assessment
    for factor in (1.0, 1.3):
        assert (
            find_irregular_motion(
                assessment.flow, 0.8, factor * assessment.states_at_period_parts[0]
            )
            is None
        )


def test_curve(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its points between two that are followed, its file, and its pictures."""
    monkeypatch.setattr("fenics_crack.curves.verdicts.MAX_FOLLOWED_POINTS", 2)
    unjudged_curve = fc.continue_frequency(plate(), 5000.0, 5010.0, LAW, harmonics=5)
    curve = fc.judge_curve(unjudged_curve.part(slice(5)))
    assert set(curve.verdicts) == {"irregular"} and not curve.stable.any()
    assert np.all(np.abs(curve.multipliers) > 1.0)
    fc.save(curve, tmp_path / "curve.h5")
    assert list(fc.load(tmp_path / "curve.h5", plate(), LAW).verdicts) == list(curve.verdicts)
    legend = fc.draw_curve(curve).axes[0].get_legend()
    assert legend is not None and "irregular" in [text.get_text() for text in legend.get_texts()]
    legend = fc.draw_multipliers(curve).axes[0].get_legend()
    assert "growth of an irregular motion" in [text.get_text() for text in legend.get_texts()]


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """The exit code is that of a solution with a known error; the file keeps the verdict."""
    words = ["solve", str(SCENE), "--output", str(tmp_path), "--set", f"excitation.omega={OMEGA}"]
    assert main([*words, "--set", "contact.friction_error=false"]) == 0
    messages = capsys.readouterr().err
    assert "no orbit was found, and the exact motion is irregular" in messages
    assert "; --set harmonic_balance.tolerance=1e-2 may find a periodic orbit" in messages
    assert "(a prediction that no exact orbit confirms)" in messages and "unknown" not in messages
    rows = json.loads((tmp_path / "solution.json").read_text())
    assert {row["name"]: row["value"] for row in rows}["verdict"] == "irregular"
    solution = fc.load(tmp_path / "solution.h5", plate(), LAW)
    assert solution.stability.verdict == "irregular" and not solution.report.confirmed


def test_sweep(tmp_path: Path) -> None:
    """Its column, its reason in the status, and its warning."""
    sweep_axes = {"excitation.omega": [OMEGA, 6714.0]}
    changes = {
        "sweep.over": sweep_axes,
        "reduction.method": "free_interface",
        "reduction.modes": 48,
    }
    sweep = fc.run_sweep(fc.Scene.load(SCENE).replace(changes), tmp_path / "sweep.h5")
    assert sweep["verdict"].tolist() == 2 * ["irregular"] and sweep.not_stable.all()
    assert np.all(sweep["multiplier"] > 1.0) and "; irregular: no orbit" in sweep["status"][0]
    assert not sweep.undecided_indices_and_reasons and "stability: 2 irregular of 2 cases" in [
        *yield_sweep_warnings(sweep)
    ]
