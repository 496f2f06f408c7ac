"""Guesses at a name: what somebody tries who has not read the reference.

Questions, and natural names of functions for each, written down before the package's names were
looked at.
"""

from __future__ import annotations

import re
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from helpers import catch_error
from surroundings import ROOT

import fenics_crack as fc

GUESSES = {
    "stable?": ("stability",),
    "time integration": (
        "integrate",
        "time_integration",
        "simulate",
        "transient",
        "time_integrate",
    ),
    "save and load": ("load", "save", "read"),
    "own axes": ("plot", "plot_curve", "draw_curve"),
    "modes": ("modes", "eigenmodes", "natural_frequencies", "eigenfrequencies", "modal"),
    "stress at the tip": ("stress_intensity_factor",),
    "sweep": ("run_sweep", "parameter_sweep", "parameter_study"),
}
RIGHT = {
    "stable?": r"stability\.verdict|\.verdicts",
    "time integration": r"fc\.integrate\(",
    "save and load": r"fc\.(save|load_run)\(",
    "own axes": r"fc\.draw_curve",
    "modes": r"fc\.modes\(",
    "stress at the tip": r"fc\.(write_period|stress_intensity)\(",
    "sweep": r"fc\.run_sweep\(",
}
"""What a guess that there is not must lead on to."""
VERBS = {
    "plot_curve": r"fc\.draw_curve",
    "plot_modes": r"fc\.draw_modes",
    "read_scene": r"fc\.Scene\.load\(",
    "load_toml": r"fc\.Scene\.load\(",
    "load_results": r"fc\.load_run\(",
    "read_mesh": r"mesh\.file",
}
"""Names that begin with another program's verb, or are another's, and what they must lead on to."""


COARSE = {
    "mesh.size": 0.05, "mesh.lip_elements": 2, "mesh.error": False, "contact.friction_error": False,
    "harmonic_balance.tolerance": 0.03,
}  # fmt: skip


@pytest.fixture(scope="module")
def things() -> dict[str, Any]:
    """The package, and what its short calls give for a small plate."""
    scene = fc.Scene.load(ROOT / "benchmarks" / "plate.toml")
    scene = scene.replace({"curve.stop": 781.0, "reduction.modes": 5, **COARSE})
    scene = scene.replace({"integration.periods": 2, "sweep.over": {"crack.length": [0.02]}})
    calls = {"solution": fc.solve, "curve": fc.curve, "history": fc.integrate, "modes": fc.modes}
    results = {name: call(scene) for name, call in calls.items()}
    law = {"law": "smoothed", "stiffness_per_area": 1e11, "sharpness": 1e7}
    law_changes = {f"contact.{key}": value for key, value in law.items()}
    unknown = fc.curve(scene.replace({"curve.stability": False, **law_changes}))
    sweep = fc.run_sweep(scene)
    return {"fc": fc, "scene": scene, "sweep": sweep, "unknown stability": unknown, **results}


def outcome(pattern: str, guess: str) -> str:
    """Whether a guess works, leads on, or says nothing that helps."""
    try:
        value = getattr(fc, guess)
    except AttributeError as error:
        question = re.search(r"did you mean .*\?", str(error))
        return "leads on" if question and re.search(pattern, question[0]) else str(error)
    return str(value) if isinstance(value, ModuleType) else "works"


@pytest.mark.parametrize("question", GUESSES)
def test_guesses_work_or_lead_on(question: str) -> None:
    """Each of them."""
    for guess in GUESSES[question]:
        assert outcome(RIGHT[question], guess) in ("works", "leads on"), guess


@pytest.mark.parametrize("guess", VERBS)
def test_verbs_of_others_lead_on(guess: str) -> None:
    """From plot, read and load to the names of this package."""
    assert outcome(VERBS[guess], guess) == "leads on"


def test_hints_name_what_there_is(things: dict[str, Any]) -> None:
    """What is suggested for any of the guesses is a name of the package, or of a result."""
    hints = set()
    for guess in {*VERBS, *(name for names in GUESSES.values() for name in names), "frequencies"}:
        try:
            getattr(fc, guess)
        except AttributeError as error:
            question = re.search(r"did you mean (.*)\?", str(error))
            hints |= set(question[1].split(" or ") if question else [])
    assert len(hints) > 10
    for hint in hints:
        owner, name = re.findall(r"\w+", hint)[:2]
        places = [fc] if owner == "fc" else things.values()
        assert any(hasattr(place, name) for place in places), hint


def test_what_has_omega_has_a_frequency(things: dict[str, Any]) -> None:
    """In Hz: solutions, their indicators, orbits, curves, peaks, modes."""
    curve, solution = things["curve"].result, things["solution"].result
    results = [solution, solution.indicators(), curve, curve.peak(), things["modes"].result]
    results += [curve.orbit(0), fc.bilinear_frequencies(things["solution"].structure)]
    for answer in results:
        names = [name for name in dir(answer) if name.startswith("omega") and "error" not in name]
        assert names
        for name in names:
            hertz = getattr(answer, name.replace("omega", "frequency"))
            assert np.allclose(2.0 * np.pi * np.asarray(hertz), getattr(answer, name))


@pytest.mark.nightly
def test_any_attribute_can_be_asked_for(things: dict[str, Any]) -> None:
    """As tools that complete names do: hasattr is True or False, never another error."""
    for thing in (thing for name, thing in things.items() if name != "scene"):
        owners = [thing] if thing is fc else [thing, getattr(thing, "result", None)]
        for owner in owners:
            assert all(hasattr(owner, name) in (True, False) for name in dir(owner))
            assert not hasattr(owner, "no_such_name")
    unknown = things["unknown stability"]
    assert not hasattr(unknown, "verdicts") and not hasattr(unknown, "stable")
    catch_error(lambda: unknown.verdicts, names="stability is not known", kind=AttributeError)
