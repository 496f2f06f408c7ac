"""What is seen in place of an unstable solution."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from helpers import oscillator, two_masses

import fenics_crack as fc

STOP = fc.UnilateralPenalty(100.0)


@cache
def curve() -> fc.ResponseCurve:
    """A resonance that leans over."""
    return fc.continue_frequency(two_masses(), 0.6, 0.9, STOP, harmonics=15, stability=True)


def solutions(omega: float) -> list[fc.PeriodicSolution]:
    """All of the curve at a frequency, with more harmonics."""
    found = curve()
    places = np.flatnonzero(np.diff(np.sign(found.omega - omega)) != 0)
    near = (found.solution(int(place)) for place in places)
    return [
        fc.solve_harmonic_balance(two_masses(), omega, STOP, harmonics=60, initial=one)
        for one in near
    ]


def sizes_of(history: fc.TimeHistory) -> np.ndarray:
    """Half the peak-to-peak displacement under the load in each period that is kept."""
    return np.ptp(history.by_period(history.displacement()[:, 0]), axis=1) / 2.0


@pytest.mark.parametrize("omega", [0.7, 0.72])
def test_two_that_are_told_apart_by_the_unstable_one(omega: float) -> None:
    """Between the folds motions that leave the middle branch settle to those above and below, which
    harmonic balance has."""
    above, middle, below = solutions(omega)
    assert fc.floquet(two_masses(), middle).verdict == "unstable"
    found = fc.attractors(two_masses(), middle)
    seen = sorted(float(size) for one in found for size in one.amplitudes())
    assert all(one.description == "settles to a periodic orbit" for one in found)
    assert seen == pytest.approx([below.amplitude(), above.amplitude()], rel=2e-3)


def test_one_of_twice_the_period() -> None:
    """Beyond a period doubling: central differences from the unstable solution end in a motion as
    large, in both of its periods."""
    [above, *_] = solutions(0.75)
    [found] = fc.attractors(two_masses(), above)
    assert found.description == "settles to an orbit of 2 periods of the load"
    assert found.orbit is not None and found.orbit.subharmonic == 2
    history = fc.integrate_central_difference(
        two_masses(), 0.75, STOP, periods=300, record_periods=2, steps_per_period=2000,
        initial=above,
    )  # fmt: skip
    assert np.sort(found.amplitudes()) == pytest.approx(np.sort(sizes_of(history)), rel=1e-3)


def test_what_swells_and_falls() -> None:
    """Behind a Neimark-Sacker point: the motion from rest in time has the same range of sizes."""
    [unstable] = solutions(0.614)
    [found] = fc.attractors(two_masses(), unstable)
    assert found.orbit is None and found.description.startswith(
        "does not settle: followed for 1000"
    )
    history = fc.integrate_events(two_masses(), 0.614, STOP, periods=900, record_periods=300)
    sizes, seen = sizes_of(history), found.amplitudes()
    assert len(seen) == 100 and np.ptp(seen) > 0.05 * seen.max()
    assert [seen.min(), seen.max()] == pytest.approx([sizes.min(), sizes.max()], rel=2e-3)


def test_several_periods() -> None:
    """Where the motion locks to the load it is one of four periods, and so is that from rest."""
    [unstable] = solutions(0.617)
    [found] = fc.attractors(two_masses(), unstable)
    assert found.orbit is not None and found.orbit.subharmonic == 4
    history = fc.integrate_events(two_masses(), 0.617, STOP, periods=900, record_periods=4)
    assert np.sort(found.amplitudes()) == pytest.approx(np.sort(sizes_of(history)), rel=1e-4)


def test_of_what_is_not_unstable() -> None:
    """A stable solution, and one of a law without an exact flow, are refused."""
    structure = oscillator(0.1, 1.0)
    stable = fc.solve_harmonic_balance(structure, 0.5, fc.UnilateralPenalty(1.0), harmonics=10)
    with pytest.raises(fc.InputError, match="solution = 'stable'"):
        fc.attractors(structure, stable)
    smooth = fc.solve_harmonic_balance(structure, 0.5, fc.SmoothedPenalty(1.0, 0.1), harmonics=10)
    with pytest.raises(fc.InputError, match="no exact flow"):
        fc.attractors(structure, smooth)
