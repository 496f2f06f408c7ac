"""What is seen in place of an unstable solution."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from helpers import catch_error, oscillator, two_masses

import fenics_crack as fc

STOP = fc.UnilateralPenalty(100.0)


@cache
def curve() -> fc.ResponseCurve:
    """A resonance that leans over."""
    return fc.continue_frequency(two_masses(), 0.6, 0.9, STOP, harmonics=15, stability=True)


def solutions(omega: float) -> list[fc.PeriodicSolution]:
    """All of the curve at a frequency, with more harmonics."""
    response = curve()
    places = np.flatnonzero(np.diff(np.sign(response.omega - omega)) != 0)
    curve_solutions = (response.solution(int(place)) for place in places)
    return [
        fc.solve_harmonic_balance(two_masses(), omega, STOP, harmonics=60, initial=curve_solution)
        for curve_solution in curve_solutions
    ]


def sizes_of(history: fc.TimeHistory) -> np.ndarray:
    """Half the peak-to-peak displacement under the load in each period that is kept."""
    return np.ptp(history.by_period(history.displacement()[:, 0]), axis=1) / 2.0


@pytest.mark.parametrize("omega", [0.7, 0.72])
def test_two_that_are_told_apart_by_the_unstable_one(omega: float) -> None:
    """Between the folds motions that leave the middle branch settle to those above and below, which
    harmonic balance has."""
    upper_solution, unstable_solution, lower_solution = solutions(omega)
    assert fc.floquet(two_masses(), unstable_solution).verdict == "unstable"
    motions = fc.attractors(two_masses(), unstable_solution)
    amplitudes = sorted(
        float(size) for motion in motions for size in motion.amplitude_in_each_period()
    )
    assert all(motion.description == "settles to a periodic orbit" for motion in motions)
    assert amplitudes == pytest.approx(
        [lower_solution.amplitude(), upper_solution.amplitude()], rel=2e-3
    )


def test_one_of_twice_the_period() -> None:
    """Beyond a period doubling: central differences from the unstable solution end in a motion as
    large, in both of its periods."""
    [upper_solution, *_] = solutions(0.75)
    [attractor] = fc.attractors(two_masses(), upper_solution)
    assert attractor.description == "settles to an orbit of 2 periods of the load"
    assert attractor.orbit is not None and attractor.orbit.subharmonic == 2
    history = fc.integrate_central_difference(
        two_masses(), 0.75, STOP, periods=300, record_periods=2, steps_per_period=2000,
        initial=upper_solution,
    )  # fmt: skip
    assert np.sort(attractor.amplitude_in_each_period()) == pytest.approx(
        np.sort(sizes_of(history)), rel=1e-3
    )


def test_what_swells_and_falls() -> None:
    """Behind a Neimark-Sacker point: the motion from rest in time has the same range of sizes."""
    [unstable] = solutions(0.614)
    [attractor] = fc.attractors(two_masses(), unstable)
    assert attractor.orbit is None and attractor.description.startswith(
        "does not settle: after 1000"
    )
    history = fc.integrate_events(two_masses(), 0.614, STOP, periods=900, record_periods=300)
    sizes, amplitudes = sizes_of(history), attractor.amplitude_in_each_period()
    assert len(amplitudes) == 100 and np.ptp(amplitudes) > 0.05 * amplitudes.max()
    assert [amplitudes.min(), amplitudes.max()] == pytest.approx(
        [sizes.min(), sizes.max()], rel=2e-3
    )


def test_several_periods() -> None:
    """Where the motion locks to the load it is one of four periods, and so is that from rest."""
    [unstable] = solutions(0.617)
    [attractor] = fc.attractors(two_masses(), unstable)
    assert attractor.orbit is not None and attractor.orbit.subharmonic == 4
    history = fc.integrate_events(two_masses(), 0.617, STOP, periods=900, record_periods=4)
    assert np.sort(attractor.amplitude_in_each_period()) == pytest.approx(
        np.sort(sizes_of(history)), rel=1e-4
    )


def test_of_what_is_not_unstable() -> None:
    """A stable solution, and one of a law without an exact flow, are refused."""
    structure = oscillator(0.1, 1.0)
    stable = fc.solve_harmonic_balance(structure, 0.5, fc.UnilateralPenalty(1.0), harmonics=10)
    catch_error(lambda: fc.attractors(structure, stable), "solution", "stable")
    smoothed_solution = fc.solve_harmonic_balance(
        structure, 0.5, fc.SmoothedPenalty(1.0, 0.1), harmonics=10
    )
    catch_error(lambda: fc.attractors(structure, smoothed_solution), "solution", "no exact flow")
