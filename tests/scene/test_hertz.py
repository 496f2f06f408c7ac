"""Frequencies of a scene in Hz or in rad/s: one of the two is given, and all computes the same."""

from __future__ import annotations

import math
import re
from functools import partial
from typing import Any

import numpy as np
import pytest
from helpers import DEMOS, catch_error
from test_scene import GONE, GOOD, GRADED, changed

import fenics_crack as fc
from fenics_crack import Scene

TURN = 2.0 * math.pi
IN_HERTZ = {"excitation.omega": GONE, "excitation.frequency": 318.25}


def test_a_frequency_in_hertz_is_one_in_radians() -> None:
    """w = 2 pi f for the load, the first natural frequency and the two of Rayleigh's damping."""
    first_settings = {"crack.length": GONE, "crack.first_frequency": 366}
    two = {"damping": {"ratios": [0.01, 0.02], "frequencies": [100.0, 900.0]}}
    scene = Scene.from_mapping(changed(GRADED | IN_HERTZ | first_settings | two))
    assert scene.excitation.omega == TURN * 318.25
    assert scene.crack is not None and scene.crack.first_omega == TURN * 366.0
    assert scene.damping.omegas == (TURN * 100.0, TURN * 900.0)
    text = scene.as_toml()
    assert "frequency = 318.25" in text and "omega" not in text
    assert Scene.from_text(text) == scene and Scene.from_text(text).as_toml() == text


@pytest.mark.parametrize(
    ("key", "twin", "changes"),
    [
        ("excitation.frequency", "excitation.omega", {"excitation.frequency": 318.0}),
        ("excitation.frequency", "excitation.omega", {"excitation.frequency": 2000.0 / TURN}),
        (
            "crack.first_frequency",
            "crack.first_omega",
            GRADED | {"crack.length": GONE, "crack.first_frequency": 1.0, "crack.first_omega": 2.0},
        ),
        (
            "damping.frequencies",
            "damping.omegas",
            {"damping": {"ratios": [0.1, 0.1], "frequencies": [1, 2], "omegas": [1.0, 2.0]}},
        ),
    ],
)
def test_both_twins_are_refused(key: str, twin: str, changes: dict[str, Any]) -> None:
    """The error names both keys, even where the numbers agree."""
    catch_error(lambda: Scene.from_mapping(changed(changes)), key, names=re.escape(twin))


@pytest.mark.parametrize(
    ("key", "changes"),
    [
        *(("excitation.frequency", IN_HERTZ | {"excitation.frequency": v}) for v in (0, -1, "1")),
        ("excitation.frequency", IN_HERTZ | {"excitation.frequency": 1e30}),
        ("excitation.omega", {"excitation.omega": GONE}),
        ("crack.length", GRADED | {"crack.first_frequency": 366.0}),
        ("damping.frequencies", {"damping.frequencies": [1.0, 2.0]}),
        ("damping.frequencies", {"damping": {"ratios": [0.1, 0.1], "frequencies": [2.0, 2.0]}}),
        ("damping.ratios", {"damping": {"frequencies": [1.0, 2.0]}}),
    ],
)
def test_bad_frequencies_are_named(key: str, changes: dict[str, Any]) -> None:
    """As their twins are."""
    catch_error(lambda: Scene.from_mapping(changed(changes)), key)


def test_a_frequency_replaces_its_twin() -> None:
    """Whichever is set last holds; removing both leaves none."""
    scene = Scene.from_mapping(GOOD)
    turned_scene = scene.replace({"excitation.frequency": 100.0})
    assert (turned_scene.excitation.frequency, turned_scene.excitation.omega) == (
        100.0,
        TURN * 100.0,
    )
    assert turned_scene.is_frequency_in_hertz and not scene.is_frequency_in_hertz
    assert turned_scene.replace({"excitation.omega": 2000.0}) == scene
    for key in ("excitation.omega", "excitation.frequency"):
        catch_error(partial(turned_scene.replace, {key: None}), "excitation.omega", None)
    catch_error(
        lambda: scene.replace({"excitation.omega": 1.0, "excitation.frequency": 1.0}),
        "excitation.frequency",
        1.0,
    )
    cracked_scene = Scene.from_mapping(
        changed(GRADED | {"crack.length": GONE, "crack.first_frequency": 366.0})
    )
    found = cracked_scene.replace({"crack.length": 0.02, "crack.first_omega": None})
    assert found.crack is not None and found.crack.first_frequency is None
    two = scene.replace({"damping.ratio": None, "damping.ratios": [0.1, 0.1],
                         "damping.frequencies": [1.0, 2.0]})  # fmt: skip
    assert two.replace({"damping.omegas": [1.0, 2.0]}).damping.frequencies is None


def test_sweeps_in_hertz(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cases are those of the sweep in rad/s; both twins in one sweep are refused."""
    scene = Scene.from_mapping(GOOD).replace({"contact.stiffness": 1e7})
    swept_scene = scene.replace({"sweep.over": {"excitation.frequency": [300.0, 310.0]}})
    assert swept_scene.is_frequency_in_hertz and swept_scene.sweep is not None
    assert swept_scene.swept_omegas == (TURN * 300.0, TURN * 310.0)
    built, prepare_function = [], fc.prepare
    monkeypatch.setattr(
        "fenics_crack.sweep.case.prepare",
        lambda *given, **more: built.append(given) or prepare_function(*given, **more),
    )
    sweep = fc.run_sweep(swept_scene, verdicts=False)
    assert sweep["omega"].tolist() == [TURN * 300.0, TURN * 310.0]
    assert len(built) == 1  # frequencies share one geometry
    over = {"excitation.omega": [1.0, 2.0], "excitation.frequency": [1.0, 2.0]}
    for axes in (over, dict(reversed(over.items()))):
        first_key, second_key = axes
        catch_error(
            partial(scene.replace, {"sweep.over": axes}), "sweep.over", second_key, names=first_key
        )


def test_a_curve_in_hertz() -> None:
    """Start and stop in Hz give the curve in rad/s, point by point."""
    scene = Scene.load(DEMOS / "paper_plate.toml").replace(
        {"contact.stiffness": 1e7, "damping.ratio": 0.02, "crack.length": 0.05,
         "crack.first_omega": None, "harmonic_balance.harmonics": 3}
    )  # fmt: skip
    span = {"curve.start": 300.0, "curve.stop": 330.0, "curve.stability": False}
    turned_scene = scene.replace(span | {"curve.parameter": "frequency"})
    assert turned_scene.is_frequency_in_hertz
    found = fc.curve(turned_scene).result
    assert found.parameter == "omega"
    assert found.values[[0, -1]] == pytest.approx([TURN * 300.0, TURN * 330.0], rel=1e-14)
    table = found.to_dict()
    np.testing.assert_allclose(table["frequency"], found.omega / TURN, rtol=1e-15)
    panel = fc.draw_curve(found, 0, in_hertz=True).axes[0]
    assert panel.get_xlabel() == "load frequency [Hz]"
    assert 290.0 < panel.get_xlim()[0] < panel.get_xlim()[1] < 340.0
    assert fc.draw_curve(found, 0).axes[0].get_xlabel() == "load frequency [rad/s]"
    for key in ("curve.start", "curve.stop"):
        catch_error(partial(turned_scene.replace, {key: -1.0}), key, -1.0)
