"""The peak of a curve, what is watched where no dof is named, and tables for pandas."""

from __future__ import annotations

import sys
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers import ROOT, catch_error, oscillator

import fenics_crack as fc

STEEL = ROOT / "benchmarks" / "plate.toml"
POINT = {"output.points": {"corner": [0.0, 0.3]}}
COARSE = {
    "mesh.size": 0.05, "mesh.lip_elements": 3, "reduction.modes": 5, "curve.stop": 780.5,
    "curve.stability": False, "integration.periods": 2,
}  # fmt: skip
XI = 0.02
COLUMNS = ("values", "omega", "points", "iterations")


def followed(first: float, last: float) -> fc.ResponseCurve:
    """Two masses and a stop that is never reached: one linear mode at 100 rad/s is met."""
    structure = fc.Structure.from_matrices(
        np.diag([1.0, 1.0]), np.diag([1e4, 1e6]), gap=np.array([0.0, 1.0]), clearance=1.0,
        force_sin=[1.0, 0.0], damping=fc.ModalDamping(XI),
    )  # fmt: skip
    return fc.continue_frequency(structure, first, last, fc.UnilateralPenalty(1e6), harmonics=1)


@pytest.fixture(scope="module")
def masses() -> fc.ResponseCurve:
    """Over the whole resonance."""
    return followed(80.0, 120.0)


def test_another_status_keeps_what_was_observed(masses: fc.ResponseCurve) -> None:
    """The motion at each point is evaluated once, whatever is said of the curve afterwards."""
    amplitudes = masses.amplitude()
    renamed = masses.with_status("with enough modes")
    assert renamed.status == "with enough modes" and masses.status != renamed.status
    assert renamed.amplitude() is amplitudes


def test_a_linear_mode(masses: fc.ResponseCurve) -> None:
    """Frequency, amplitude and damping are the mode's, though points lie half a width apart."""
    peak = masses.peak()
    omega = 100.0 * np.sqrt(1.0 - 2.0 * XI**2)
    assert np.abs(masses.omega - omega).min() > 0.1
    assert peak.omega == pytest.approx(omega, rel=1e-4)
    exact = 1.0 / np.hypot(1e4 - omega**2, 2.0 * XI * 100.0 * omega)
    assert peak.amplitude == pytest.approx(exact, rel=1e-3)  # of 256 instants
    assert peak.damping == pytest.approx(XI, rel=5e-3)
    assert peak.verdict == "stable" and peak.error < 1e-6
    assert peak.frequency == pytest.approx(peak.omega / (2.0 * np.pi))
    assert "damping 0.02" in str(peak) and "stable" in str(peak)
    assert str(masses.peak(0)) == str(peak) and masses.peak(1).amplitude < 1e-3 * peak.amplitude


@pytest.mark.drawn(2)
@pytest.mark.parametrize("ratio", [1.2, 10.0, 1000.0])
@pytest.mark.parametrize("damping", [5e-3, 1e-3])
@pytest.mark.parametrize("other", [False, True])
def test_no_resonance_is_stepped_over(ratio: float, damping: float, other: bool) -> None:
    """Of one mass before a stop that is so many times its largest amplitude away: steps are parts
    of the vibration, not of the clearance. Also where the way is followed by Python's loop."""
    exact = 1.0 / (2.0 * damping * np.sqrt(1.0 - damping**2))
    structure = oscillator(2.0 * damping, clearance=ratio * exact)
    law: Any = fc.SmoothedPenalty(1.0, 100.0) if other else fc.UnilateralPenalty(1.0)
    curve = fc.continue_frequency(structure, 0.5, 1.6, law, harmonics=5, stability=not other)
    peak = curve.peak()
    assert peak.omega == pytest.approx(np.sqrt(1.0 - 2.0 * damping**2), rel=1e-5)
    assert peak.amplitude == pytest.approx(exact, rel=1e-3)
    assert peak.damping == pytest.approx(damping, rel=1e-2)
    assert other or set(curve.verdicts) == {"stable"}


def test_half_power_whichever_way_the_curve_was_followed(masses: fc.ResponseCurve) -> None:
    """Frequency, height and damping of the mode."""
    peak, expected_peak = followed(120.0, 80.0).peak(), masses.peak()
    assert peak.omega == pytest.approx(expected_peak.omega, rel=1e-4)
    assert peak.amplitude == pytest.approx(expected_peak.amplitude, rel=1e-3)
    assert peak.damping == pytest.approx(XI, rel=5e-3)


def test_a_peak_beside_nothing_has_a_height() -> None:
    """Next to a place without a vibration of this kind the height is that of the point, no nan."""
    absorber = fc.Structure.from_matrices(
        np.eye(2), np.array([[200.0, -100.0], [-100.0, 100.0]]), gap=np.array([0.0, 1.0]),
        clearance=1e3, force_sin=[1.0, 0.0], damping=np.diag([1.0, 0.0]),
    )  # fmt: skip
    curve = fc.continue_frequency(absorber, 10.0, 20.0, fc.UnilateralPenalty(1.0), harmonics=1)
    height = curve.amplitude(0)  # none at 10 rad/s, where the second mass alone moves
    top = int(height.argmax())
    places = [0, top, top + 1]
    peak = replace(curve, **{name: getattr(curve, name)[places] for name in COLUMNS}).peak(0)
    assert height[0] < 1e-12 * height[top] and peak.amplitude == height[top] > height[top + 1]
    assert 10.0 < peak.omega < curve.omega[top + 1] and np.isnan(peak.damping)


def test_half_a_peak_has_no_width() -> None:
    """Nor has one at the end of a curve, or where the curve turns back beside it."""
    half = followed(80.0, 99.0).peak()
    assert half.omega == pytest.approx(99.0, rel=1e-12) and np.isnan(half.damping)
    assert half.at_end and half.to_dict()["at_end"] and "still rising" in str(half)
    assert followed(120.0, 101.0).peak().at_end and followed(101.0, 120.0).peak().at_end
    top = followed(99.5, 100.5).peak()
    assert top.omega == pytest.approx(100.0, rel=1e-3) and np.isnan(top.damping)
    assert not top.at_end and "still rising" not in str(top)
    structure, law = oscillator(0.1, 1.0, clearance=2.0), fc.UnilateralPenalty(5.0)
    curve = fc.continue_frequency(structure, 0.5, 3.0, law, harmonics=5)
    peak = curve.peak()
    fold_index = peak.index + int(np.argmax(np.diff(curve.omega)[peak.index :] < 0.0))
    assert curve.amplitude(0)[fold_index] > peak.amplitude / np.sqrt(2.0)
    assert fold_index > peak.index and np.isnan(peak.damping)


def test_no_width_tells_the_damping_of_a_higher_harmonic() -> None:
    """Next to half of the natural frequency of a breathing crack the width is wrong by a factor of
    40: no damping is told, nor drawn, which the load's own resonance has."""
    xi, law = 0.002, fc.UnilateralPenalty(1.0)
    structure = oscillator(2.0 * xi)
    bilinear_omega = 2.0 / (1.0 + np.sqrt(0.5))  # bilinear
    for order in (1, 2):
        ends = 0.95 * bilinear_omega / order, 1.05 * bilinear_omega / order
        curve = fc.continue_frequency(structure, *ends, law, harmonics=9)
        peak = curve.peak()
        assert peak.omega == pytest.approx(bilinear_omega / order, rel=2e-3)
        legend_labels = fc.draw_curve(curve).axes[0].get_legend_handles_labels()[1]
        is_labelled = any("half-power damping" in words for words in legend_labels)
        if order == 1:
            assert is_labelled and peak.damping == pytest.approx(xi / bilinear_omega, rel=2e-3)
        else:
            assert not is_labelled and np.isnan(peak.damping)
            assert "damping unknown: no half-power width at the load frequency" in str(peak)


@pytest.mark.nightly
def test_the_watched_dof_is_the_default() -> None:
    """That of the scene's first point, else the load's, of every result; and of sweeps the load's
    response stays the load's."""
    scene = fc.Scene.load(STEEL).replace(COARSE | {"sweep.over": {"crack.length": [0.02]}})
    loads = -1
    for changes in ({}, POINT):
        changed_scene = scene.replace(changes)
        solution, curve, history = (
            fc.solve(changed_scene),
            fc.curve(changed_scene),
            fc.integrate(changed_scene),
        )
        dof, peak = solution.watched_dof, curve.peak()
        assert peak.at_end and not peak.without and np.isnan(peak.omega_error)  # it is given
        assert solution.amplitude() == solution.amplitude(dof)
        assert np.all(solution.coefficients_at() == solution.coefficients_at([dof]))
        assert np.all(curve.amplitude() == curve.amplitude(dof))
        assert curve.to_dict()["ratio_2_1"] == curve.indicators(dof).ratio_2_1.tolist()
        assert np.all(history.displacement() == history.displacement([dof]))
        assert history.indicators().amplitude == history.indicators(dof).amplitude
        assert history.indicators().omega == pytest.approx(scene.excitation.omega)
        assert "opening [m]" in history.table().columns
        if changes:
            assert dof == solution.structure.find_dof((0.0, 0.3), "x") != loads
        loads = dof
    plain_sweep, watched_sweep = (fc.run_sweep(scene.replace(changes)) for changes in ({}, POINT))
    assert plain_sweep["response"] == pytest.approx(watched_sweep["response"], rel=1e-14)
    assert watched_sweep["response"] != pytest.approx(
        watched_sweep["corner.ux.amplitude"], rel=1e-3
    )


def test_pandas(masses: fc.ResponseCurve, monkeypatch: pytest.MonkeyPatch) -> None:
    """It gets the columns; where it is not installed one line says what to do."""
    frames: list[Any] = []
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=frames.append))
    masses.to_dataframe()
    assert frames[0]["amplitude"] == masses.amplitude().tolist() and "ratio_2_1" in frames[0]
    monkeypatch.setitem(sys.modules, "pandas", None)
    catch_error(masses.to_dataframe, names=r"pip install pandas.*to_csv", kind=ImportError)


def test_own_axes(masses: fc.ResponseCurve) -> None:
    """By matplotlib's name for one, too; not by both."""
    from matplotlib.figure import Figure

    panel = Figure().subplots()
    assert fc.draw_curve(masses, ax=panel) is panel.figure and panel.lines
    catch_error(lambda: fc.draw_curve(masses, ax=panel, axes=panel), "ax", panel)


def test_short_words() -> None:
    """A scene, a plate and a run in one line each."""
    scene = fc.Scene.load(STEEL)
    assert str(scene) == "Scene(plate of 0.1 x 0.3 m, crack of 0.03 m, unilateral, 800 Hz)"
    chain = fc.Scene.load(ROOT / "demos" / "chain.toml")
    mesh = fc.Scene.load(ROOT / "demos" / "inclined_crack.toml")
    assert "matrices" in str(chain) and "mesh" in str(mesh)
    plate = fc.prepare(scene)
    assert str(plate).startswith("Study(MasslessStructure(20 modes") and len(str(plate)) < 250
