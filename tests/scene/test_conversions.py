"""Numbers as people write them: what a key would hold, said in the error that refuses them."""

from __future__ import annotations

import re
import time
from functools import partial

import pytest
from helpers import DEMOS, catch_error

from fenics_crack import Scene


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("0,03", "m", 0.03), ("30 mm", "m", 0.03), ("30mm", "m", 0.03), ("2,5 µm", "m", 2.5e-6),
        ("210 GPa", "Pa", 2.1e11), ("210e3 MPa", "Pa", 2.1e11), ("210000 N/mm²", "Pa", 2.1e11),
        ("7.85 g/cm3", "kg/m^3", 7850.0), ("7850 kg/m³", "kg/m^3", 7850.0),
        ("7.85e-9 t/mm^3", "kg/m^3", 7850.0), ("1,5 kN", "N", 1500.0), ("0.8 kHz", "Hz", 800.0),
        ("0.5 %", "", 0.005), ("1 g", "m/s^2", 9.80665), ("1e3 N/mm", "N/m", 1e6),
        ("steel", "Pa", None), ("30 mm", "Pa", None), ("", "m", None), ("1,2,3", "m", None),
        ("800 Hz", "rad/s", None), ("e", "m", None), ("-", "m", None), (".", "m", None),
        ("1e400 mm", "m", None),
    ],
)  # fmt: skip
def test_converted(text: str, unit: str, value: float | None) -> None:
    """Asked in the unit of the key, or nothing where that is not sure."""
    paired = unit in ("N", "m/s^2")  # components of a vector
    key, text_or_pair = KEYS[unit], [text, 0.0] if paired else text
    error = catch_error(
        lambda: Scene.from_text(PLATE).replace({key: text_or_pair}), key, text_or_pair
    )
    suggested_keys = re.findall(r"did you mean \[?([^],?]+).*\?$", error.allowed)
    assert [float(suggestion) for suggestion in suggested_keys] == pytest.approx(
        [] if value is None else [value]
    )


PLATE = (DEMOS / "paper_plate.toml").read_text()
KEYS = {
    "m": "crack.length", "Pa": "material.young", "kg/m^3": "material.density",
    "N": "excitation.force_sin", "Hz": "excitation.frequency", "": "damping.ratio",
    "m/s^2": "base.acceleration_sin", "N/m": "contact.stiffness", "rad/s": "excitation.omega",
}  # fmt: skip
"""A key of each unit."""


@pytest.mark.parametrize(
    ("old", "new", "suggestion"),
    [
        ("young = 2e9", "young = 210 GPa", r"young = 2\.1e\+11"),
        ("young = 2e9", "young = 210,5 GPa # x", r"young = 2\.105e\+11"),
        ("poisson = 0.3", "poisson = 0,3", r"poisson = 0\.3"),
        ('edge = "left"', "edge = left", 'edge = "left"'),
    ],
)
def test_in_a_file_that_is_no_toml(old: str, new: str, suggestion: str) -> None:
    """TOML itself refuses it: the line is shown as it should be."""
    assert old in PLATE
    names = rf"line.*did you mean {suggestion}\?"
    catch_error(
        partial(Scene.from_text, PLATE.replace(old, new)), "scene", "given as text", names=names
    )


def test_what_is_not_understood_is_not_guessed() -> None:
    """No question after another mistake, or where the number would not do either."""
    text, change = PLATE.replace("poisson = 0.3", "poisson 0.3"), {"crack.length": "-30 mm"}
    errors = [
        catch_error(lambda: Scene.from_text(text), "scene", "given as text"),
        catch_error(lambda: Scene.from_text(PLATE).replace(change), "crack.length", "-30 mm"),
    ]
    assert "did you mean" not in str(errors)


@pytest.mark.parametrize("text", ["[{}]", "{} = 1", "x = {{ {} = 1 }}"])
def test_a_name_of_many_parts_takes_no_time(text: str) -> None:
    """Reading took a time that grew with the square of their number."""
    start_time = time.process_time()
    text = text.format(".".join("a" * 100_000))
    catch_error(lambda: Scene.from_text(text), "scene", names="at most 50 parts")
    assert time.process_time() - start_time < 1.0
