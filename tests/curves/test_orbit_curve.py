"""Curves of exact orbits as results: numbers, files, pictures, tables."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import catch_error, oscillator, two_masses

import fenics_crack as fc

LAW = fc.UnilateralPenalty(5.0)
OMEGA = np.linspace(0.9, 1.0, 9)


def orbits(
    structure: fc.Structure, parameter: str = "omega", values: np.ndarray = OMEGA
) -> fc.ResponseCurve:
    """Orbits at some values of a parameter, next to solutions of harmonic balance."""
    columns: dict[str, list] = {"omega": [], "points": [], "multipliers": []}
    for value in values:
        changes = {} if parameter == "omega" else {parameter: value}
        varied_structure, omega = (
            structure.varied(**changes),
            value if parameter == "omega" else 0.95,
        )
        orbit = fc.shoot(
            varied_structure, fc.solve_harmonic_balance(varied_structure, omega, LAW, harmonics=20)
        )
        columns["omega"].append(omega)
        columns["points"].append(orbit.state)
        multiplier = complex(orbit.multipliers[0])
        columns["multipliers"].append(complex(multiplier.real, abs(multiplier.imag)))
    fields = {name: np.array(column) for name, column in columns.items()}
    curve = fc.ResponseCurve(
        structure=structure, contact=LAW, parameter=parameter, values=values, bifurcations=(),
        iterations=np.ones(len(values), dtype=int), complete=True, status="reached the end",
        subharmonic=1, tolerance=1e-3, **fields,
    )  # fmt: skip
    middle = curve.part(np.array([4]))
    special = curve.bifurcation(
        "fold", middle.values[0], middle.omega[0], middle.points[0], middle.multipliers
    )
    return replace(curve, bifurcations=(special,))


@pytest.fixture(scope="module")
def curve() -> fc.ResponseCurve:
    """Over the load frequency."""
    return orbits(oscillator(clearance=0.2))


def test_indicators_are_those_of_solutions(curve: fc.ResponseCurve) -> None:
    """By 256 instants, to what these leave."""
    curve_indicators = curve.indicators()
    assert curve.exact and len(curve_indicators.amplitude) == len(curve)
    for index in (0, 4, 8):
        solution = curve.solution(index)
        assert solution.report.truncation < 1e-3 and solution.converged
        solution_indicators = solution.indicators()
        for name in ("amplitude", "mean", "harmonic_1", "harmonic_2", "opening", "crack_force"):
            exact = pytest.approx(getattr(solution_indicators, name), rel=5e-3)
            assert getattr(curve_indicators, name)[index] == exact, name
    gaps = curve.gap_coefficients[4]
    solution_gaps = curve.solution(4).gap_coefficients
    assert gaps[: len(solution_gaps)] == pytest.approx(solution_gaps, abs=1e-9)


def test_verdicts_are_those_of_the_orbits(curve: fc.ResponseCurve) -> None:
    """None is open but next to the unit circle."""
    sizes = [abs(curve.orbit(index).multipliers[0]) for index in range(len(curve))]
    assert np.abs(curve.multipliers) == pytest.approx(sizes, rel=1e-9)
    assert [*(np.array(sizes) < 1.0)] == [*curve.stable] and not curve.is_undecided.any()
    assert curve.reason(0) == ""
    on_circle = replace(curve, multipliers=np.exp(1j * np.linspace(0.0, 1.0, len(curve))))
    assert set(on_circle.verdicts) == {"undecided"} and "modulus 1" in on_circle.reason(3)


def test_bifurcations_are_exact(curve: fc.ResponseCurve) -> None:
    """They have a solution, and their own points to be measured."""
    [fold] = curve.bifurcations
    assert isinstance(fold, fc.Bifurcation)
    assert fold.orbit.residual < 1e-9
    point_solution = curve.solution(4)
    assert fold.solution.gap_coefficients == pytest.approx(
        point_solution.gap_coefficients, abs=1e-12
    )
    assert len(curve.at_bifurcations) == 3
    assert curve.at_bifurcations.amplitude() == pytest.approx(curve.amplitude()[[0, 4, 8]])
    assert "fold at 0.95" in repr(fold)


def test_tables_and_pictures(curve: fc.ResponseCurve, tmp_path: Path) -> None:
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
    loaded_curve = fc.load(tmp_path / "curve.h5", structure, LAW)
    assert (
        isinstance(loaded_curve, fc.ResponseCurve)
        and loaded_curve.exact
        and loaded_curve.parameter == parameter
    )
    for name in ("values", "omega", "points", "multipliers", "iterations"):
        assert getattr(loaded_curve, name) == pytest.approx(getattr(curve, name), rel=1e-12), name
    assert loaded_curve.at_bifurcations.points == pytest.approx(curve.at_bifurcations.points)
    assert loaded_curve.amplitude() == pytest.approx(curve.amplitude())
    catch_error(
        lambda: fc.load(tmp_path / "curve.h5", oscillator(force=1.1, clearance=0.2), LAW),
        "structure",
        "other load or pairs",
    )
    catch_error(
        lambda: fc.load(tmp_path / "curve.h5", structure, fc.UnilateralPenalty(90.0)), "contact"
    )


# --- followed -------------------------------------------------------------------------------------

STOP = fc.UnilateralPenalty(100.0)


def test_branches_of_equal_masses() -> None:
    """Two with stops, loaded alike, move alike on the curve; at four branch points they part, and
    the branches come back."""
    structure = fc.Structure.from_matrices(
        np.eye(2), np.array([[2.0, -1.0], [-1.0, 2.0]]), gap=np.eye(2), force_sin=np.ones(2),
        clearance=0.3, damping=fc.ModalDamping(0.02),
    )  # fmt: skip
    curve = fc.continue_frequency(structure, 0.9, 2.0, fc.UnilateralPenalty(2.0), tolerance=1e-2)
    points = [
        bifurcation for bifurcation in curve.bifurcations if bifurcation.kind == "branch_point"
    ]
    assert len(points) == 4 and np.ptp(curve.gap_coefficients, axis=2).max() < 1e-6
    for point in points:
        branch = fc.follow_branch(curve, point)
        assert branch.status == "closed loop"
        assert np.ptp(branch.gap_coefficients, axis=2).max() > 0.5


@pytest.mark.parametrize(
    ("key", "wrong"),
    [
        ("tolerance", {"harmonics": 5}),
        ("samples", {"samples": 100}),
        ("tolerance", {"tolerance": 0.0}),
        ("longest_step", {"longest_step": 2.0}),
        ("omega_end", {"omega_end": -1.0}),
    ],
)
def test_arguments_that_cannot_be_used(key: str, wrong: dict[str, float]) -> None:
    """Each is named."""
    arguments = {"omega_start": 0.6, "omega_end": 0.9, "contact": STOP, "tolerance": 1e-2} | wrong
    catch_error(lambda: fc.continue_frequency(two_masses(), **arguments), key, arguments[key])


def test_harmonic_balance_where_there_are_no_orbits() -> None:
    """Of a smooth law, with as many harmonics along the curve as its first point asks for; and
    where harmonics are given."""
    law = fc.SmoothedPenalty(5.0, 10.0)
    coarse_curve, fine_curve = (
        fc.continue_frequency(oscillator(), 0.9, 1.0, law, tolerance=tolerance)
        for tolerance in (0.3, 1e-4)
    )
    assert not coarse_curve.exact and not fine_curve.exact
    assert coarse_curve.harmonics == 5 < fine_curve.harmonics
    balance_curve = fc.continue_frequency(two_masses(), 0.6, 0.9, STOP, harmonics=7)
    assert not balance_curve.exact and balance_curve.harmonics == 7
