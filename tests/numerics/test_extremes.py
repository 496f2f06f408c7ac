"""Extremes of waves, of orbits and along curves, to rounding."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import DEMOS, two_masses

import fenics_crack as fc
from fenics_crack.numerics.extremes import find_maximum_values

PARTS = np.arange(256) / 256


def test_kinks_and_ties() -> None:
    """A function that bends down has its maximum wherever it falls between the samples; of two
    almost equal ones, of which the lower is nearer to a sample, the larger."""
    random = np.random.default_rng(0)
    for place, *slopes in random.uniform([0.0, 0.3, 0.3], [1.0, 3.0, 3.0], (10, 3)):

        def kink(parts: np.ndarray, place: float = place, slopes: list[float] = slopes) -> Any:
            offset = np.mod(parts - place + 0.5, 1.0) - 0.5
            return np.where(offset < 0.0, slopes[0] * offset, -slopes[1] * offset)[:, None]

        assert abs(find_maximum_values(kink(PARTS), kink)[0]) <= 1.2e-8

    def two(parts: np.ndarray) -> Any:
        return np.cos(4.0 * np.pi * parts - 0.012)[:, None] + 1e-7 * np.cos(2.0 * np.pi * parts)

    assert find_maximum_values(two(PARTS), two)[0] == pytest.approx(
        1.0 + 1e-7 * np.cos(0.006), rel=1e-12
    )
    noise = np.random.default_rng(0).normal

    def noisy(parts: np.ndarray) -> Any:
        return 1.0 + noise(scale=1e-10, size=(len(parts), 1))

    assert find_maximum_values(noisy(PARTS), noisy)[0] == pytest.approx(1.0, abs=1e-9)
    constant_samples = np.full((256, 1), 0.5)
    assert (
        find_maximum_values(constant_samples, lambda parts: np.full((len(parts), 1), 9.0))[0] == 0.5
    )
    assert find_maximum_values(np.zeros((8, 0)), lambda parts: np.zeros((len(parts), 0))).shape == (
        0,
    )


def test_smooth_tops_and_plateaus_are_evaluated_twice() -> None:
    """Next to a smooth maximum, and where a function stays at its largest value."""
    calls = []

    def both(parts: np.ndarray) -> Any:
        calls.append(len(parts))
        wave = np.cos(2.0 * np.pi * parts - 0.3)
        return np.column_stack([wave + 0.1 * np.cos(20.0 * np.pi * parts - 3.0), -np.fmax(wave, 0)])

    maxima = find_maximum_values(both(PARTS), both)
    assert len(calls) == 3
    fine_parts = np.linspace(0.04, 0.06, 400_001)
    assert maxima == pytest.approx([both(fine_parts)[:, 0].max(), 0.0], rel=1e-11)


@pytest.mark.parametrize("harmonics", [1, 3, 12])
def test_random_waves(harmonics: int) -> None:
    """Of 20 waves at once, against Newton's method from a fine grid."""
    random, order = np.random.default_rng(harmonics), np.arange(1, harmonics + 1)
    waves = random.standard_normal((harmonics, 20)) + 1j * random.standard_normal((harmonics, 20))

    def at(parts: np.ndarray, derivative: int = 0) -> Any:
        phases = np.exp(2j * np.pi * np.outer(parts, order)) * (2j * np.pi * order) ** derivative
        return (phases @ waves).real

    grid = np.arange(4096) / 4096
    tops = []
    for sign in (1.0, -1.0):
        place = grid[np.argmax(sign * at(grid), axis=0)]
        for _ in range(6):
            slope, curvature = (np.diag(at(place, derivative)) for derivative in (1, 2))
            place = place - slope / curvature
        tops.append(sign * np.diag(at(place)))
    maxima = (
        find_maximum_values(at(PARTS), at),
        find_maximum_values(-at(PARTS), lambda parts: -at(parts)),
    )
    np.testing.assert_allclose(maxima, tops, rtol=1e-12)


def test_a_sine_has_the_amplitude_of_its_harmonic() -> None:
    """Solutions, curves of harmonic balance and of exact orbits, of pairs that never touch: of
    samples 4e-6 and 8e-5 were missing."""
    law = fc.UnilateralPenalty(10.0)
    open_structure = two_masses().varied(clearance=1e3)
    solution = fc.solve_harmonic_balance(open_structure, 0.7, law, harmonics=3)
    linear = fc.solve_linear(open_structure, 0.7, harmonics=2)
    waves = fc.continue_frequency(open_structure, 0.69, 0.7, law, harmonics=3)
    orbits = fc.continue_frequency(open_structure, 0.69, 0.7, law, tolerance=1e-2)
    assert orbits.exact
    for answer in (solution, linear, waves, orbits):
        indicators = answer.indicators()
        rows = answer.coefficients_at()
        of_curve = np.ndim(indicators.omega) > 0
        mean, cosine, sine = rows.T[:3] if of_curve else rows[:3, 0]
        rtol = 1e-9 if answer is orbits else 1e-12  # to which an orbit closes
        np.testing.assert_allclose(indicators.amplitude, np.hypot(cosine, sine), rtol=rtol)
        np.testing.assert_allclose(answer.amplitude(), indicators.amplitude, rtol=1e-15)
        assert np.all(np.abs(mean) < 1e-9 * indicators.amplitude)
    assert orbits.orbit(0).amplitude() == pytest.approx(orbits.amplitude()[0], rel=1e-12)


def test_a_sweep_has_the_amplitude_of_the_sine(tmp_path: Path) -> None:
    """At the load, of pairs that never touch."""
    changes = {"crack.clearance": 1.0, "contact.stiffness": 1e9, "damping.ratio": 0.02}
    changes |= {"sweep.over": {"damping.ratio": [0.02]}, "harmonic_balance.error": False}
    scene = fc.Scene.load(DEMOS / "paper_plate.toml", changes)
    sweep = fc.run_sweep(scene, tmp_path / "sweep.h5")
    assert sweep["response"][0] == pytest.approx(sweep["harmonic_1"][0], rel=1e-12)


@pytest.mark.parametrize("massless", [False, True])
def test_extremes_of_contact(massless: bool) -> None:
    """No instant of many has more, and the largest of them hardly less; of waves, with their
    quasi-static part."""
    structure, law = two_masses(0.15), fc.UnilateralPenalty(10.0)
    if massless:
        structure = fc.reduce_structure(structure, modes=1)
    solution = fc.solve_harmonic_balance(structure, 0.62, law, harmonics=9)
    curve = fc.continue_frequency(structure, 0.62, 0.63, law, harmonics=9)
    time = np.linspace(0.0, solution.period, 200_001)
    opening, force = (-solution.gap(time)).max(), solution.contact_force(time).max()
    size = np.ptp(solution.displacement(time)) / 2.0
    for indicators in (solution.indicators(), curve.indicators()):
        ends = [
            np.atleast_1d(field)[0]
            for field in (indicators.opening, indicators.contact_force, indicators.amplitude)
        ]
        for exact, sampled_extreme in zip(ends, (opening, force, size), strict=True):
            assert -1e-9 <= exact / sampled_extreme - 1.0 <= 1e-7
    assert solution.indicators().crack_force >= force * (1.0 - 1e-12)


def test_extremes_of_orbits() -> None:
    """At the events, and between: those of the motion itself."""
    structure, law = two_masses(0.15), fc.UnilateralPenalty(10.0)
    curve = fc.continue_frequency(structure, 0.62, 0.63, law, tolerance=1e-2)
    orbit = curve.orbit(0)
    time = np.linspace(0.0, orbit.period, 100_001)
    displacement = structure.values_at(orbit.displacement_at(time), [None])
    gap = orbit.gap_at(time)
    ends = orbit.amplitude(), orbit.to_dict()["opening"], orbit.to_dict()["penetration"]
    for exact, sampled_extreme in zip(
        ends, (np.ptp(displacement) / 2.0, -gap.min(), gap.max()), strict=True
    ):
        assert -1e-9 <= exact / sampled_extreme - 1.0 <= 1e-7
    curve_indicators, orbit_indicators = curve.indicators(), orbit.indicators()
    assert curve_indicators.opening[0] == pytest.approx(ends[1], rel=1e-9)
    assert curve_indicators.ratio_2_1[0] == pytest.approx(orbit_indicators.ratio_2_1, rel=1e-4)
    assert curve_indicators.closed_share[0] == pytest.approx(
        orbit_indicators.closed_share, abs=1.0 / 256
    )
