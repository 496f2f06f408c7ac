"""Keys and values of a scene in words, and by what scenes differ."""

import fenics_crack as fc
from fenics_crack.scene.words import differences, key_in_words, value_in_words


def test_what_differs(paper_scene: fc.Scene) -> None:
    """Each scene with its own values, also where one is the default; units read well."""
    base = {"excitation.force_cos": (0.0, 0.0)}
    scenes = [
        paper_scene.replace(base | {"excitation.force_sin": (size, 0.0)}) for size in (5.0, 20.0)
    ]
    assert differences(scenes) == ["excitation.force_sin = 5 N", "excitation.force_sin = 20 N"]
    closed = paper_scene.replace({"crack.clearance": -2e-7})
    assert differences([paper_scene.replace({"crack.clearance": 0.0}), closed]) == [
        "crack.clearance = 0 m",
        "crack.clearance = -200 nm",
    ]
    assert differences([paper_scene, paper_scene]) == ["", ""]


def test_hertz_and_ranges(paper_scene: fc.Scene) -> None:
    """A frequency in Hz stands for both twins; ranges count where nothing else differs."""
    one, two = (
        paper_scene.replace({"excitation.frequency": f, "curve.start": f, "curve.stop": 9.0})
        for f in (300.0, 310.0)
    )
    assert differences([one, two]) == [
        "excitation.frequency = 300 Hz",
        "excitation.frequency = 310 Hz",
    ]
    ranges = [paper_scene.replace({"curve.start": at, "curve.stop": 9.0}) for at in (1.0, 2.0)]
    assert differences(ranges) == ["curve.start = 1", "curve.start = 2"]


def test_words() -> None:
    """As axes and lines are named."""
    assert key_in_words("crack.length") == "crack length"
    assert key_in_words("excitation.omega") == "load frequency"
    for key, value, words in (
        ("crack.length", 0.035, "35 mm"),
        ("excitation.omega", 4420.0, "4420 rad/s"),
        ("material.young", 2.1e11, "210 GPa"),
        ("excitation.force_sin", (0.0, 3.0), "3 N"),
        ("excitation.point", (0.1, 0.2), "[0.1, 0.2] m"),
        ("harmonic_balance.harmonics", 7, "7"),
        ("contact.law", "unilateral", "unilateral"),
        ("crack.length", None, "none"),
    ):
        assert value_in_words(key, value) == words
