"""The plate that a newcomer begins with."""

import pytest
from judged import NEW

import fenics_crack as fc


@pytest.fixture(scope="session")
def plate_of_new() -> fc.Study:
    """Eight rigid pairs without mass, 20 modes, 0.5 %, 800 Hz."""
    return fc.prepare(fc.Scene.load(NEW))
