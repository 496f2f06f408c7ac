"""The plate that a newcomer begins with."""

from __future__ import annotations

import pytest
from surroundings import ROOT

import fenics_crack as fc


@pytest.fixture(scope="session")
def plate_of_new() -> fc.Study:
    """Eight rigid pairs without mass, 20 modes, 0.5 %, 800 Hz."""
    return fc.prepare(fc.Scene.load(ROOT / "benchmarks" / "plate.toml"))
