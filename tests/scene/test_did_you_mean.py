"""What is misspelt, or in the wrong place, is answered with what was meant."""

from __future__ import annotations

from typing import Any

import pytest
from helpers import catch_error
from test_scene import GOOD, changed

import fenics_crack as fc
from fenics_crack import InputError, Scene
from fenics_crack.scene.fields import Table
from fenics_crack.scene.keys import known_keys, suggest_full_keys


@pytest.mark.parametrize(
    ("key", "value", "question"),
    [
        # a key
        ("damping.rato", 0.1, "did you mean damping.ratio? known keys: ratio,"),
        ("material.Young", 1.0, "did you mean material.young? "),
        ("material.densty", 1.0, "did you mean material.density? "),
        ("excitation.freqency", 1.0, "did you mean excitation.frequency? "),
        ("excitation.force", [1.0, 0.0], "did you mean excitation.force_sin or excitation.force"),
        ("harmonic_balance.harmonic", 1, "did you mean harmonic_balance.harmonics? "),
        # a key of another table, misspelt or not
        ("crack.stiffness", 1e9, "did you mean damping.stiffness or contact.stiffness or "),
        ("geometry.lenght", 0.1, "did you mean crack.length? "),
        ("geometry.young", 0.1, "did you mean material.young? "),
        # a table
        ("meshh", {}, "did you mean mesh? "),
        ("Crack", {}, "did you mean crack? "),
        ("harmonic-balance", {}, "did you mean harmonic_balance? "),
        ("harmonics", 5, "did you mean harmonic_balance.harmonics or "),
        # a word
        ("contact.law", "unilatral", "'unilateral'; did you mean 'unilateral'?"),
        ("mesh.layout", "Grid", "did you mean 'grid'?"),
        ("mesh.cells", "quad", "one of 'triangle', 'quadrilateral'"),
        # an axis of a sweep
        ("sweep.over", "excitation.omga", "did you mean excitation.omega?"),
        ("sweep.over", "crak.length", "did you mean crack.length?"),
        ("sweep.over", "crack.young", "did you mean material.young?"),
        ("sweep.over", "omega", "did you mean excitation.omega?"),
    ],
)
def test_in_a_file(key: str, value: Any, question: str) -> None:
    """The question stands in the one line of the error."""
    changes = {"sweep": {"over": {value: [1.0]}}} if key == "sweep.over" else {key: value}
    assert question in str(catch_error(lambda: Scene.from_mapping(changed(changes)), key, value))


@pytest.mark.parametrize(
    ("key", "question"),
    [
        ("crack.lenght", "did you mean crack.length? known keys: edge,"),
        ("crak.length", "did you mean crack.length? known tables: geometry,"),
        ("length", "did you mean crack.length? "),
        ("curve.harmonics", "did you mean harmonic_balance.harmonics or "),
        ("rubbish", "left out; known tables: "),
        ("crack.rubbish", "left out; known keys: "),
    ],
)
def test_in_a_change(key: str, question: str) -> None:
    """As ``--set`` and ``replace`` make it."""
    error = catch_error(lambda: Scene.from_mapping(GOOD).replace({key: 1.0}), key, 1.0)
    assert question in error.allowed


def test_a_proposed_key_is_taken() -> None:
    """Each that is proposed for a key without its table, in another one, misspelt or cut off, as an
    argument of a function or as a change."""
    all_keys, proposed_keys = set(known_keys()), set()
    for key in sorted({key.rpartition(".")[2] for key in all_keys})[::2]:
        for name in (key, key[:-1], key[1:], f"{key}s", f"crak.{key}", f"load.{key}"):
            proposed_keys |= {*suggest_full_keys(name)}
        for table in Table.__subclasses__():
            proposed_keys |= {*table.suggest_keys(key[1:])}
    assert proposed_keys <= all_keys | {*Scene.__dataclass_fields__}
    assert "loads.1.harmonics" in suggest_full_keys("harmonics")
    scene = Scene.from_mapping(GOOD)
    for key in proposed_keys & all_keys:
        try:
            scene.replace({key: object()})
        except InputError as error:
            assert "known keys" not in error.allowed and "known tables" not in error.allowed, key


@pytest.mark.parametrize(
    "verb", ["solve", "modes", "curve", "integrate", "verify", "run_sweep", "campbell", "identify"]
)
def test_a_path_is_not_its_scene(verb: str) -> None:
    """A natural first guess: it is said how a scene is loaded."""
    more_words = {"campbell": [[0.0, 1.0]], "identify": ["measured.csv"]}.get(verb, [])
    catch_error(
        lambda: getattr(fc, verb)("plate.toml", *more_words),
        "scene",
        "plate.toml",
        names=r"fc\.Scene\.load\(path\)",
    )
