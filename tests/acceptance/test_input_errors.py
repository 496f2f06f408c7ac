"""Bad input of the calls that solve: one InputError, which names the argument."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import judged
import numpy as np
import pytest
from helpers import catch_error

import fenics_crack as fc

ONE, LAW = judged.oscillator(), fc.UnilateralPenalty(1.0)


def found() -> fc.PeriodicSolution:
    """A solution."""
    return fc.solve_harmonic_balance(ONE, 1.0, LAW, harmonics=3)


def orbits() -> Any:
    """A curve of exact orbits."""
    return fc.continue_frequency(ONE, 1.0, 1.1, LAW, tolerance=1e-2)


@dataclass(frozen=True)
class Law:
    """A law of one's own, with whatever forces, a constant tangent and whatever when scaled."""

    forces: Callable[[np.ndarray], np.ndarray]
    slope: float = 1.0
    stiffness: float = 1.0
    other: Callable[[float], Any] | None = None

    def force(self, gap: np.ndarray) -> np.ndarray:
        """Whatever."""
        return self.forces(gap)

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """The same everywhere."""
        return np.full_like(gap, self.slope)

    def scaled(self, factor: float) -> Any:
        """Whatever, or by default the same, so many times as stiff."""
        if self.other is not None:
            return self.other(factor)
        return replace(self, stiffness=factor * self.stiffness)


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
    "stiffness": ("contact stiffness", lambda: fc.UnilateralPenalty(-1.0)),
    "span": ("omega_start", lambda: fc.continue_frequency(ONE, 0.0, 1.0, LAW)),
    "parameter": ("parameter", lambda: fc.continue_parameter(ONE, 1.0, LAW, "colour", 1.0, 2.0)),
    "settle": ("settle", lambda: fc.shoot(ONE, found(), settle=-1)),
    "factors": ("start", lambda: fc.follow_resonance(fc.Problem(ONE, 1.0, LAW), -0.1, 1.0)),
    "method": ("method", lambda: fc.reduce_structure(ONE, modes=1, method="magic")),
    "modes": ("modes", lambda: fc.reduce_structure(ONE, modes=7)),
    "clearance": ("clearance", lambda: ONE.varied(clearance=[1.0, 2.0])),
    "one frequency": ("omega", lambda: fc.linear_response(ONE, 0, 1.0)),  # type: ignore[arg-type]
    "frequencies": ("omega", lambda: fc.linear_response(ONE, 0, np.array([1.0, np.nan]))),
    "no law": ("contact", lambda: fc.shoot(ONE, fc.solve_linear(ONE, 1.0))),
    "no solution": ("solution", lambda: fc.floquet(ONE, None)),  # type: ignore[arg-type]
    "no curve": ("curve", lambda: fc.judge_curve(found())),  # type: ignore[arg-type]
    "no bifurcation": ("bifurcation", lambda: fc.follow_branch(orbits(), found())),  # type: ignore[arg-type]
    "forces of another shape": (
        "contact",
        lambda: fc.continue_frequency(ONE, 1.0, 2.0, Law(lambda gap: np.zeros(3))),
    ),
    "complex forces": (
        "contact",
        lambda: fc.solve_harmonic_balance(ONE, 1.0, Law(lambda gap: 1j * gap), harmonics=3),
    ),
    "scaled to another law": (
        "contact",
        lambda: fc.solve_harmonic_balance(ONE, 1.0, Law(np.array, other=fc.UnilateralPenalty)),
    ),
    "scaled to no law": (
        "contact",
        lambda: fc.continue_parameter(
            ONE, 1.0, Law(np.array, other=float), "stiffness", 1.0, 2.0, harmonics=3
        ),
    ),
    "as stiff when scaled": (
        "contact",
        lambda: fc.continue_frequency(
            ONE, 1.0, 2.0, Law(np.array, other=lambda factor: Law(np.array)), harmonics=3
        ),
    ),
    "softness": ("contact", lambda: fc.continue_frequency(ONE, 1.0, 2.0, Law(np.ones_like, -1.0))),
}


@pytest.mark.parametrize("name", BAD)
def test_argument_is_named(name: str) -> None:
    """By its key, with what was given."""
    key, call = BAD[name]
    catch_error(call, key, names=r"scaled\(factor\)" if "scaled" in name else None)
