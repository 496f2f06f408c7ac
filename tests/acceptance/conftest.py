"""The plate that a newcomer begins with."""

from pathlib import Path

import pytest

import fenics_crack as fc

NEW = Path(__file__).parents[2] / "benchmarks" / "plate.toml"


@pytest.fixture(scope="session")
def plate_of_new() -> fc.Study:
    """Eight rigid pairs without mass, 20 modes, 0.5 %, 800 Hz."""
    return fc.prepare(fc.Scene.load(NEW))
