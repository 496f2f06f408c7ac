"""The resonance of a scene at its own load, as check and campbell name it."""

import json
import math
from dataclasses import replace

import pytest
from helpers import ROOT, titanium_blade
from mpi4py import MPI
from rotating import cracked
from surroundings import RunCommand

import fenics_crack as fc
from fenics_crack.study.key_figures import find_key_figures, propose_curve_or_none
from fenics_crack.study.resonance import (
    SEVERAL_MODES_REASON,
    ResonanceUnderLoad,
    find_study_resonance,
    order_crossing_speed,
)

DEMOS = ROOT / "demos"


def at_load(scene: fc.Scene) -> ResonanceUnderLoad:
    study = fc.prepare(scene, MPI.COMM_SELF, whole=True)
    figures = find_key_figures(study)
    return find_study_resonance(study, figures.omega_bilinear, figures.squared_omega_slopes)


def test_plate() -> None:
    """In ten modes that of all that are kept, and proportional to the load."""
    scene = fc.Scene.load(DEMOS / "blade.toml")
    study = fc.prepare(scene, MPI.COMM_SELF)
    problem = fc.Problem(study.structure, scene.excitation.omega, study.contact)
    whole_resonance = fc.resonance_at(problem, tolerance=0.01)
    resonance = at_load(scene)
    assert resonance.value == pytest.approx(whole_resonance.omega, abs=0.1 * whole_resonance.width)
    assert resonance.amplitude == pytest.approx(whole_resonance.solution.amplitude(), rel=0.02)
    assert (
        resonance.width == pytest.approx(whole_resonance.width, rel=0.05)
        and resonance.verdict == "stable"
    )
    assert resonance.omega_or_speed_under_small_load == pytest.approx(resonance.value, rel=1e-3)
    left_out = "error due to the modes and the mesh and the friction not included"
    assert resonance.amplitude_and_errors_text.endswith(f" %; {left_out}")
    twice = tuple(2.0 * force for force in scene.excitation.force_sin)
    doubled_resonance = at_load(scene.replace({"excitation.force_sin": twice}))
    assert doubled_resonance.value == pytest.approx(resonance.value, rel=1e-9)
    assert doubled_resonance.amplitude == pytest.approx(2.0 * resonance.amplitude, rel=1e-6)


def test_what_is_not_known() -> None:
    """It is said why: several modes, a smooth law, no damping, no crack; friction is left out."""
    resonance = at_load(fc.Scene.load(DEMOS / "paper_plate.toml"))
    assert resonance.amplitude_and_errors_text == SEVERAL_MODES_REASON and resonance.value > 0.0
    plate = fc.Scene.load(DEMOS / "blade.toml")
    smooth_settings = {
        "contact.law": "smoothed",
        "contact.sharpness": 1e9,
        "contact.stiffness": 1e10,
    }
    assert "law" in at_load(plate.replace(smooth_settings)).unknown
    assert "damping" in at_load(plate.replace({"damping.ratio": 0.0})).unknown
    assert at_load(plate.replace({"crack": None, "contact": None})).unknown
    friction_scene = fc.Scene.load(DEMOS / "friction.toml")
    frictionless_scene = friction_scene.replace({"contact.friction": 0.0})
    assert at_load(friction_scene).value == pytest.approx(
        at_load(frictionless_scene).value, rel=1e-9
    )


def test_speed_that_meets_an_order() -> None:
    """Of (n W)^2 = w^2 + S (W^2 - W_0^2); never where it is not real."""
    for slope in (0.0, 1.5, -2.0):
        crossing_speed = order_crossing_speed(4.0, 100.0, 430.0, slope)
        square = 430.0**2 + slope * (crossing_speed**2 - 100.0**2)
        assert crossing_speed == pytest.approx(math.sqrt(square) / 4.0, rel=1e-12)
    assert math.isnan(order_crossing_speed(1.0, 100.0, 430.0, 1.5))


def test_rotor_has_one_answer() -> None:
    """check, from a speed 6 % below, names the resonance of the Campbell diagram."""
    scene = cracked(550.0).replace({"excitation.omega": None, "excitation.order": 12})
    [(_, crossing_point)] = fc.campbell(scene, [570.0, 600.0], 1).met
    resonance = at_load(scene)
    assert resonance.value == pytest.approx(crossing_point.value, rel=1e-5)
    assert resonance.width == pytest.approx(crossing_point.width, rel=1e-3)
    assert resonance.amplitude == pytest.approx(crossing_point.amplitude, rel=1e-3)


@pytest.mark.nightly
@pytest.mark.parametrize("force", [0.2, 0.4, 1.0])
def test_blade_that_its_load_moves(force: float, run_command: RunCommand) -> None:
    """The centrifugal load opens the crack, and the bilinear frequency meets the order at 5,847 rpm
    whatever the load is: check and campbell name the peak of its curve, and check a range with it.
    """
    scene = titanium_blade(force).replace({"mesh.error": False})
    peak = fc.curve(scene, MPI.COMM_SELF).result.peak()
    speed = peak.omega / 4.0
    printed_text = run_command("check", scene.replace({"curve": None}), "--format", "json").out
    rows = {row["what"]: row["value"] for row in json.loads(printed_text)}
    stated_speed = rows["rotor speed at which order 4 meets the resonance at the load [rad/s]"]
    assert stated_speed == pytest.approx(speed, rel=2e-4)
    start, stop = (rows[f"proposed curve.{end} [rpm]"] for end in ("start", "stop"))
    assert start < peak.value * 30.0 / math.pi < stop < 1.03 * start
    [(mode, crossing_point)] = fc.campbell(scene, [600.0, 620.0], 1).met
    assert mode == 1 and crossing_point.value == pytest.approx(speed, rel=2e-4)
    assert crossing_point.amplitude == pytest.approx(peak.amplitude, rel=0.02)


def test_proposed_curve_meets_its_peak() -> None:
    """From three widths below to as many above the resonance and its place at rest."""
    scene = fc.Scene.load(DEMOS / "blade.toml").replace({"curve": None})
    study = fc.prepare(scene, MPI.COMM_SELF, whole=True)
    figures = find_key_figures(study)
    resonance = find_study_resonance(study, figures.omega_bilinear, figures.squared_omega_slopes)
    curve = propose_curve_or_none(study.scene, replace(figures, load_resonance=resonance))
    start, stop = curve.parameter_and_range[1:]
    assert (
        start
        <= resonance.value - 3.0 * resonance.width
        < resonance.value + 3.0 * resonance.width
        <= stop
    )
    keys = {"curve.start": start, "curve.stop": stop, "curve.parameter": "omega"}
    curve_scene = study.scene.replace(keys)
    assert propose_curve_or_none(curve_scene, replace(figures, load_resonance=resonance)) is None
