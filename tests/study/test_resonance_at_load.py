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
from fenics_crack.study.plausibility import find_key_figures, propose_curve
from fenics_crack.study.resonance import (
    SEVERAL_MODES_TEXT,
    LoadResonance,
    find_study_resonance,
    order_crossing_speed,
)

DEMOS = ROOT / "demos"


def at_load(scene: fc.Scene) -> LoadResonance:
    study = fc.prepare(scene, MPI.COMM_SELF, whole=True)
    figures = find_key_figures(study)
    return find_study_resonance(study, figures.omega_bilinear, figures.speed_slopes)


def test_plate() -> None:
    """In ten modes that of all that are kept, and proportional to the load."""
    scene = fc.Scene.load(DEMOS / "blade.toml")
    study = fc.prepare(scene, MPI.COMM_SELF)
    problem = fc.Problem(study.structure, scene.excitation.omega, study.contact)
    whole = fc.resonance_at(problem, tolerance=0.01)
    found = at_load(scene)
    assert found.value == pytest.approx(whole.omega, abs=0.1 * whole.width)
    assert found.amplitude == pytest.approx(whole.solution.amplitude(), rel=0.02)
    assert found.width == pytest.approx(whole.width, rel=0.05) and found.verdict == "stable"
    assert found.rest == pytest.approx(found.value, rel=1e-3)
    left_out = "error due to the modes and the mesh and the friction not included"
    assert found.in_words.endswith(f" %; {left_out}")
    twice = tuple(2.0 * force for force in scene.excitation.force_sin)
    more = at_load(scene.replace({"excitation.force_sin": twice}))
    assert more.value == pytest.approx(found.value, rel=1e-9)
    assert more.amplitude == pytest.approx(2.0 * found.amplitude, rel=1e-6)


def test_what_is_not_known() -> None:
    """It is said why: several modes, a smooth law, no damping, no crack; friction is left out."""
    several = at_load(fc.Scene.load(DEMOS / "paper_plate.toml"))
    assert several.in_words == SEVERAL_MODES_TEXT and several.value > 0.0
    plate = fc.Scene.load(DEMOS / "blade.toml")
    smooth = {"contact.law": "smoothed", "contact.sharpness": 1e9, "contact.stiffness": 1e10}
    assert "law" in at_load(plate.replace(smooth)).unknown
    assert "no damped mode" in at_load(plate.replace({"damping.ratio": 0.0})).unknown
    assert at_load(plate.replace({"crack": None, "contact": None})).unknown
    rubbing = fc.Scene.load(DEMOS / "friction.toml")
    sliding = rubbing.replace({"contact.friction": 0.0})
    assert at_load(rubbing).value == pytest.approx(at_load(sliding).value, rel=1e-9)


def test_speed_that_meets_an_order() -> None:
    """Of (n W)^2 = w^2 + S (W^2 - W_0^2); never where it is not real."""
    for slope in (0.0, 1.5, -2.0):
        met = order_crossing_speed(4.0, 100.0, 430.0, slope)
        square = 430.0**2 + slope * (met**2 - 100.0**2)
        assert met == pytest.approx(math.sqrt(square) / 4.0, rel=1e-12)
    assert math.isnan(order_crossing_speed(1.0, 100.0, 430.0, 1.5))


def test_rotor_has_one_answer() -> None:
    """check, from a speed 6 % below, names the resonance of the Campbell diagram."""
    scene = cracked(550.0).replace({"excitation.omega": None, "excitation.order": 12})
    [(_, met)] = fc.campbell(scene, [570.0, 600.0], 1).met
    found = at_load(scene)
    assert found.value == pytest.approx(met.value, rel=1e-5)
    assert found.width == pytest.approx(met.width, rel=1e-3)
    assert found.amplitude == pytest.approx(met.amplitude, rel=1e-3)


@pytest.mark.nightly
@pytest.mark.parametrize("force", [0.2, 0.4, 1.0])
def test_blade_that_its_load_moves(force: float, run_command: RunCommand) -> None:
    """The centrifugal load opens the crack, and the bilinear frequency meets the order at 5,847 rpm
    whatever the load is: check and campbell name the peak of its curve, and check a range with it.
    """
    scene = titanium_blade(force).replace({"mesh.error": False})
    peak = fc.curve(scene, MPI.COMM_SELF).result.peak()
    speed = peak.omega / 4.0
    checked = run_command("check", scene.replace({"curve": None}), "--format", "json").out
    rows = {row["what"]: row["value"] for row in json.loads(checked)}
    told = rows["order 4 meets the resonance at the load, rotor speed [rad/s]"]
    assert told == pytest.approx(speed, rel=2e-4)
    start, stop = (rows[f"proposed curve.{end} [rpm]"] for end in ("start", "stop"))
    assert start < peak.value * 30.0 / math.pi < stop < 1.03 * start
    [(mode, found)] = fc.campbell(scene, [600.0, 620.0], 1).met
    assert mode == 1 and found.value == pytest.approx(speed, rel=2e-4)
    assert found.amplitude == pytest.approx(peak.amplitude, rel=0.02)


def test_proposed_curve_meets_its_peak() -> None:
    """From three widths below to as many above the resonance and its place at rest."""
    scene = fc.Scene.load(DEMOS / "blade.toml").replace({"curve": None})
    study = fc.prepare(scene, MPI.COMM_SELF, whole=True)
    figures = find_key_figures(study)
    found = find_study_resonance(study, figures.omega_bilinear, figures.speed_slopes)
    curve = propose_curve(study.scene, replace(figures, load_resonance=found))
    start, stop = curve.continuation_range[1:]
    assert start <= found.value - 3.0 * found.width < found.value + 3.0 * found.width <= stop
    keys = {"curve.start": start, "curve.stop": stop, "curve.parameter": "omega"}
    known = study.scene.replace(keys)
    assert propose_curve(known, replace(figures, load_resonance=found)) is None
