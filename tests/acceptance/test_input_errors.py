"""Bad input of the calls that solve: one InputError, which names the argument."""

from collections.abc import Callable
from typing import Any

import judged
import pytest

import fenics_crack as fc

ONE, LAW = judged.oscillator(), fc.UnilateralPenalty(1.0)


def found() -> fc.PeriodicSolution:
    """A solution."""
    return fc.solve_harmonic_balance(ONE, 1.0, LAW, harmonics=3)


BAD: dict[str, tuple[str, Callable[[], Any]]] = {
    "omega of a solution": ("omega", lambda: fc.solve_harmonic_balance(ONE, -1.0, LAW)),
    "omega that is none": ("omega", lambda: fc.solve_linear(ONE, float("nan"))),
    "harmonics": ("harmonics", lambda: fc.solve_harmonic_balance(ONE, 1.0, LAW, harmonics=0)),
    "both": (
        "tolerance",
        lambda: fc.solve_harmonic_balance(ONE, 1.0, LAW, harmonics=5, tolerance=1e-3),
    ),
    "tolerance": ("tolerance", lambda: fc.solve_harmonic_balance(ONE, 1.0, LAW, tolerance=0.0)),
    "subharmonic": (
        "subharmonic",
        lambda: fc.solve_harmonic_balance(ONE, 1.0, LAW, subharmonic=0, tolerance=1e-2),
    ),
    "initial": (
        "initial",
        lambda: fc.solve_harmonic_balance(judged.two_masses(), 1.0, LAW, initial=found()),
    ),
    "stiffness": ("stiffness", lambda: fc.UnilateralPenalty(-1.0)),
    "span": ("omega", lambda: fc.continue_frequency(ONE, 0.0, 1.0, LAW)),
    "parameter": ("parameter", lambda: fc.continue_parameter(ONE, 1.0, LAW, "colour", 1.0, 2.0)),
    "settle": ("settle", lambda: fc.shoot(ONE, found(), settle=-1)),
    "mode": ("mode", lambda: fc.follow_backbone(ONE, LAW, 5, 0.1, 1.0)),
    "energies": ("energy", lambda: fc.follow_backbone(ONE, LAW, 1, -0.1, 1.0)),
    "method": ("method", lambda: fc.reduce_structure(ONE, modes=1, method="magic")),
    "modes": ("modes", lambda: fc.reduce_structure(ONE, modes=7)),
    "clearance": ("clearance", lambda: ONE.varied(clearance=[1.0, 2.0])),
}


@pytest.mark.parametrize("name", BAD)
def test_argument_is_named(name: str) -> None:
    """By its key, with what was given."""
    key, call = BAD[name]
    with pytest.raises(fc.InputError, match=key) as caught:
        call()
    assert "must be" in str(caught.value)
