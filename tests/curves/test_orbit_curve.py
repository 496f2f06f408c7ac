"""Curves of exact orbits as results: numbers, files, pictures, tables."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import oscillator

import fenics_crack as fc
from fenics_crack.curves.orbit_curve import leading

LAW = fc.UnilateralPenalty(5.0)
OMEGA = np.linspace(0.9, 1.0, 9)


def orbits(
    structure: fc.Structure, parameter: str = "omega", values: np.ndarray = OMEGA
) -> fc.OrbitCurve:
    """Orbits at some values of a parameter, next to solutions of harmonic balance."""
    known: dict[str, list] = {"omega": [], "states": [], "multipliers": []}
    for value in values:
        varied = {} if parameter == "omega" else {parameter: value}
        there, omega = structure.varied(**varied), value if parameter == "omega" else 0.95
        orbit = fc.shoot(there, fc.solve_harmonic_balance(there, omega, LAW, harmonics=20))
        known["omega"].append(omega)
        known["states"].append(orbit.state)
        known["multipliers"].append(leading(orbit.multipliers))
    found = {name: np.array(column) for name, column in known.items()}
    curve = fc.OrbitCurve(
        structure=structure, contact=LAW, parameter=parameter, values=values, bifurcations=(),
        iterations=np.ones(len(values), dtype=int), complete=True, status="reached the end",
        subharmonic=1, tolerance=1e-3, **found,
    )  # fmt: skip
    middle = curve.part(np.array([4]))
    special = curve.bifurcation("fold", middle.values[0], middle.states[0], middle.multipliers)
    return replace(curve, bifurcations=(special,))


@pytest.fixture(scope="module")
def curve() -> fc.OrbitCurve:
    """Over the load frequency."""
    return orbits(oscillator(clearance=0.2))


def test_indicators_are_those_of_solutions(curve: fc.OrbitCurve) -> None:
    """By 256 instants, to what these leave."""
    seen = curve.indicators()
    assert isinstance(curve, fc.ResponseCurve) and len(seen.amplitude) == len(curve)
    for index in (0, 4, 8):
        solution = curve.solution(index)
        assert solution.report.truncation < 1e-3 and solution.converged
        alone = solution.indicators()
        for name in ("amplitude", "mean", "harmonic_1", "harmonic_2", "opening", "crack_force"):
            expected = getattr(alone, name)
            assert getattr(seen, name)[index] == pytest.approx(expected, rel=5e-3), name
    gaps = curve.gap_coefficients[4]
    alone = curve.solution(4).gap_coefficients
    assert gaps[: len(alone)] == pytest.approx(alone, abs=1e-9)


def test_verdicts_are_those_of_the_orbits(curve: fc.OrbitCurve) -> None:
    """None is open but next to the unit circle."""
    sizes = [abs(curve.orbit(index).multipliers[0]) for index in range(len(curve))]
    assert np.abs(curve.multipliers) == pytest.approx(sizes, rel=1e-9)
    assert [*(np.array(sizes) < 1.0)] == [*curve.stable] and not curve.undecided.any()
    assert curve.reason(0) == ""
    on_circle = replace(curve, multipliers=np.exp(1j * np.linspace(0.0, 1.0, len(curve))))
    assert set(on_circle.verdicts) == {"undecided"} and "multiplier is 1" in on_circle.reason(3)


def test_bifurcations_are_exact(curve: fc.OrbitCurve) -> None:
    """They have a solution, and their own points to be measured."""
    [fold] = curve.bifurcations
    assert isinstance(fold, fc.Bifurcation) and fold.confirmed and fold.exact == fold.value
    assert fold.orbit.residual < 1e-9
    there = curve.solution(4)
    assert fold.gap_coefficients == pytest.approx(there.gap_coefficients, abs=1e-12)
    assert len(curve.at_bifurcations) == 3
    assert curve.at_bifurcations.amplitude() == pytest.approx(curve.amplitude()[[0, 4, 8]])
    assert "fold at 0.95" in repr(fold)


def test_tables_and_pictures(curve: fc.OrbitCurve, tmp_path: Path) -> None:
    """With the columns that all curves have."""
    columns = curve.to_dict()
    assert {"omega", "frequency", "iterations", "multiplier", "verdict", "amplitude"} <= {*columns}
    assert not {"harmonics", "truncation"} & {*columns}
    assert "9 points, exact orbits, 1 bifurcation" in repr(curve)
    curve.to_csv(tmp_path / "curve.csv")
    assert (tmp_path / "curve.csv").read_text().startswith("omega [rad/s],frequency [Hz],iter")
    assert np.all(curve.displacement_errors < 1e-3)
    for draw in (fc.draw_curve, fc.draw_content, fc.draw_multipliers):
        draw(curve, path=tmp_path / f"{draw.__name__}.png")
    labels = [text.get_text() for text in fc.draw_curve(curve).axes[0].get_legend().get_texts()]
    assert "fold (1)" in " ".join(labels) and not any("hollow" in label for label in labels)


@pytest.mark.parametrize(
    ("parameter", "values"), [("omega", OMEGA), ("load", np.linspace(0.9, 1.3, 9))]
)
def test_saved_and_read(parameter: str, values: np.ndarray, tmp_path: Path) -> None:
    """Every number as it was, and none with another structure."""
    structure = oscillator(clearance=0.2)
    curve = orbits(structure, parameter, values)
    fc.save(curve, tmp_path / "curve.h5")
    again = fc.load(tmp_path / "curve.h5", structure, LAW)
    assert isinstance(again, fc.OrbitCurve) and again.parameter == parameter
    for name in ("values", "omega", "states", "multipliers", "iterations"):
        assert getattr(again, name) == pytest.approx(getattr(curve, name), rel=1e-12), name
    assert again.bifurcations[0].state == pytest.approx(curve.bifurcations[0].state)
    assert again.amplitude() == pytest.approx(curve.amplitude())
    with pytest.raises(fc.InputError, match=r"^structure"):
        fc.load(tmp_path / "curve.h5", oscillator(force=1.1, clearance=0.2), LAW)
    with pytest.raises(fc.InputError, match=r"^contact"):
        fc.load(tmp_path / "curve.h5", structure, fc.UnilateralPenalty(90.0))


def test_more_points(curve: fc.OrbitCurve) -> None:
    """Between the others, each an orbit."""
    finer = fc.refine_curve(curve, between=2)
    assert len(finer) == 25 and np.all(np.diff(finer.omega) > 0.0)
    assert all(finer.orbit(index).residual < 1e-8 for index in range(len(finer)))
    assert finer.omega[::3] == pytest.approx(curve.omega)
