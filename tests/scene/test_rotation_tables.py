"""The table [rotation] and engine orders of a scene."""

from __future__ import annotations

import math
from typing import Any

import pytest
from helpers import catch_error
from test_scene import GONE, GRADED, changed

from fenics_crack import Scene

RPM = 2.0 * math.pi / 60.0
ROTATING = GRADED | {"rotation": {"rpm": 6000.0, "hub_radius": 0.2}}
ORDERED = ROTATING | {"excitation.omega": GONE, "excitation.order": 3}


def test_revolutions_per_minute_are_a_speed() -> None:
    """W = 2 pi n / 60; the file keeps what was given."""
    scene = Scene.from_mapping(changed(ROTATING))
    assert scene.rotation is not None and scene.rotation.speed == RPM * 6000.0 == scene.speed
    text = scene.as_toml()
    assert "rpm = 6000.0" in text and "speed" not in text
    assert Scene.from_text(text) == scene
    assert scene.replace({"rotation.speed": 10.0}).rotation.rpm is None  # type: ignore[union-attr]
    assert scene.replace({"rotation": None}).speed == 0.0


def test_an_order_gives_the_frequency() -> None:
    """w = order * W, also after either is changed; a frequency takes the place of the order."""
    scene = Scene.from_mapping(changed(ORDERED))
    assert scene.excitation.omega == 3 * RPM * 6000.0
    assert scene.is_frequency_in_hertz and scene.is_speed_in_rpm
    text = scene.as_toml()
    assert "order = 3" in text and "omega" not in text
    assert Scene.from_text(text) == scene and Scene.from_text(text).as_toml() == text
    assert scene.replace({"rotation.speed": 10.0}).excitation.omega == 30.0
    assert scene.replace({"excitation.order": 4}).excitation.omega == 4 * RPM * 6000.0
    for key in ("omega", "frequency"):
        other_excitation = scene.replace({f"excitation.{key}": 50.0}).excitation
        assert other_excitation.order is None and getattr(other_excitation, key) == 50.0
    fixed_scene = Scene.from_mapping(changed(ROTATING))
    assert fixed_scene.replace({"excitation.order": 3}).excitation == scene.excitation
    rest = scene.without_rotation()
    assert rest.speed == 0.0 and rest.excitation.omega == scene.excitation.omega


def test_frequencies_of_a_sweep_over_the_speed() -> None:
    """Those of all orders and speeds."""
    over = {"rotation.speed": [10.0, 20.0], "excitation.order": [2, 3]}
    scene = Scene.from_mapping(changed(ORDERED | {"sweep": {"over": over}}))
    assert sorted(scene.swept_omegas) == [20.0, 30.0, 40.0, 60.0]


def test_a_swept_frequency_takes_the_place_of_the_order() -> None:
    """As in each of its cases."""
    over = {"excitation.omega": [10.0, 20.0]}
    scene = Scene.from_mapping(changed(ORDERED | {"sweep": {"over": over}}))
    assert scene.swept_omegas == (10.0, 20.0)


@pytest.mark.parametrize(
    ("key", "changes"),
    [
        ("rotation.rpm", {"rotation": {"rpm": 1.0, "speed": 2.0, "hub_radius": 0.1}}),
        ("rotation.speed", {"rotation": {"hub_radius": 0.1}}),
        ("rotation.speed", {"rotation": {"hub_radius": 0.1, "speed": -1.0}}),
        ("rotation.hub_radius", {"rotation": {"speed": 1.0}}),
        ("rotation.hub_radius", {"rotation": {"speed": 1.0, "hub_radius": -0.1}}),
        ("excitation.omega", ROTATING | {"excitation.order": 3}),
        ("excitation.frequency", ORDERED | {"excitation.frequency": 10.0}),
        ("excitation.order", GRADED | {"excitation.omega": GONE, "excitation.order": 3}),
        ("excitation.order", ORDERED | {"rotation.rpm": 0.0}),
        ("excitation.order", ORDERED | {"excitation.order": 2.5}),
        ("curve.parameter", ROTATING | {"curve": {"parameter": "load", "start": 1.0, "stop": 2.0}}),
    ],
)
def test_what_cannot_be_is_refused(key: str, changes: dict[str, Any]) -> None:
    """The error names the key."""
    catch_error(lambda: Scene.from_mapping(changed(changes)), key)
