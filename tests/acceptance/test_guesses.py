"""Fifty guesses at a name: what somebody tries who has not read the reference.

Ten questions, five natural names for each, written down before the package's names were looked
at. A guess names the thing it is tried on: the package itself (``fc``) or what one of its calls
gave (``solution``, ``curve``, ``history``, ``scene``, ``sweep``).
"""

from __future__ import annotations

import re
from types import ModuleType
from typing import Any

import pytest
from surroundings import ROOT

import fenics_crack as fc

GUESSES = {
    "peak": ("curve.peak", "curve.max", "curve.resonance", "curve.maximum", "curve.find_peak"),
    "2/1 over length": (
        "sweep.indicators",
        "solution.indicators",
        "solution.ratio",
        "solution.second_harmonic",
        "solution.harmonic_ratio",
    ),
    "stable?": (
        "solution.stable",
        "solution.is_stable",
        "solution.stability",
        "curve.stable",
        "fc.stability",
    ),
    "time integration": (
        "fc.integrate",
        "fc.time_integration",
        "fc.simulate",
        "fc.transient",
        "fc.time_integrate",
    ),
    "save and load": ("solution.save", "fc.load", "fc.save", "curve.save", "fc.read"),
    "pandas": (
        "curve.to_dataframe",
        "curve.to_pandas",
        "curve.dataframe",
        "curve.to_csv",
        "history.to_dataframe",
    ),
    "own axes": ("curve.plot", "fc.plot", "fc.plot_curve", "solution.plot", "fc.draw_curve"),
    "modes": (
        "fc.modes",
        "fc.eigenmodes",
        "fc.natural_frequencies",
        "fc.eigenfrequencies",
        "fc.modal",
    ),
    "stress at the tip": (
        "solution.stress_intensity",
        "fc.stress_intensity_factor",
        "solution.sif",
        "solution.tip_stress",
        "solution.stress",
    ),
    "sweep": ("fc.sweep", "fc.run_sweep", "fc.parameter_sweep", "fc.parameter_study", "fc.study"),
}


RIGHT = {
    "peak": r"peak\(\)",
    "2/1 over length": r"ratio_2_1",
    "stable?": r"stability\.verdict|\.verdicts",
    "time integration": r"fc\.integrate\(",
    "save and load": r"fc\.(save|load_run)\(",
    "pandas": r"to_dataframe\(\)",
    "own axes": r"fc\.draw_curve",
    "modes": r"fc\.modes\(",
    "stress at the tip": r"fc\.(write_period|stress_intensity)\(",
    "sweep": r"fc\.run_sweep\(",
}
"""What a guess that there is not must lead on to."""
ENOUGH = 40
"""Of the fifty."""
VERBS = {
    "fc.plot_curve": r"fc\.draw_curve",
    "fc.plot_modes": r"fc\.draw_modes",
    "fc.read_scene": r"fc\.Scene\.load\(",
    "fc.load_toml": r"fc\.Scene\.load\(",
    "fc.load_results": r"fc\.load_run\(",
    "fc.read_mesh": r"mesh\.file",
    "scene.from_file": r"\.load\(",
    "solution.frequencies": r"\.omega",
    "history.t": r"\.time",
}
"""Names that begin with another program's verb, or are another's, and what they must lead on to."""


@pytest.fixture(scope="module")
def things() -> dict[str, Any]:
    """The package, and what its short calls give for a small plate."""
    scene = fc.Scene.load(ROOT / "benchmarks" / "plate.toml")
    scene = scene.replace({"curve.stop": 781.0, "reduction.modes": 5})
    scene = scene.replace({"integration.periods": 2, "sweep.over": {"crack.length": [0.02]}})
    calls = {"solution": fc.solve, "curve": fc.curve, "history": fc.integrate}
    found = {name: call(scene) for name, call in calls.items()}
    return {"fc": fc, "scene": scene, "sweep": fc.run_sweep(scene), **found}


def outcome(right: str, guess: str, things: dict[str, Any]) -> str:
    """Whether a guess works, leads on, or says nothing that helps."""
    owner, name = guess.split(".")
    try:
        found = getattr(things[owner], name)
    except AttributeError as error:
        asked = re.search(r"did you mean .*\?", str(error))
        return "leads on" if asked and re.search(right, asked[0]) else str(error)
    return str(found) if isinstance(found, ModuleType) else "works"


def test_most_guesses_work_or_lead_on(things: dict[str, Any]) -> None:
    """Five for each question, forty of fifty."""
    assert [len(names) for names in GUESSES.values()] == [5] * 10
    outcomes = {
        guess: outcome(RIGHT[question], guess, things)
        for question, guesses in GUESSES.items()
        for guess in guesses
    }
    lost = {guess: how for guess, how in outcomes.items() if how not in ("works", "leads on")}
    assert len(outcomes) - len(lost) >= ENOUGH, lost


@pytest.mark.parametrize("guess", VERBS)
def test_verbs_of_others_lead_on(guess: str, things: dict[str, Any]) -> None:
    """From plot, read and load to the names of this package."""
    assert outcome(VERBS[guess], guess, things) == "leads on"


def suggested(thing: Any, name: str) -> list[str]:
    """What is suggested in place of a name that a thing does not have."""
    try:
        getattr(thing, name)
    except AttributeError as error:
        asked = re.search(r"did you mean (.*)\?", str(error))
        return asked[1].split(" or ") if asked else []
    return []


def there_is(hint: str, places: list[Any]) -> bool:
    """Whether one of some things has the attribute that a hint begins with, or has entries."""
    first = "__getitem__" if hint.startswith("[") else re.sub(r"\W.*", "", hint.lstrip("."))
    return any(hasattr(place, first) for place in places)


def test_hints_name_what_there_is(things: dict[str, Any]) -> None:
    """Every guess, tried on each thing: what is suggested is an attribute of that thing, or a name
    of the package, or of any result."""
    guesses = {guess.split(".")[1] for names in (*GUESSES.values(), VERBS) for guess in names}
    places = {"fc": [fc], "result": [*things.values()]}
    hints = []
    for owner, thing in things.items():
        for name in guesses:
            for hint in suggested(thing, name):
                begin, _, rest = hint.partition(".")
                fine = there_is(rest, places[begin]) if begin in places else there_is(hint, [thing])
                hints.append((fine, f"{owner}.{name}: {hint}"))
    assert len(hints) > 100 and not [words for fine, words in hints if not fine]
