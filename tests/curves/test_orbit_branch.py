"""The branch of exact orbits along a curve."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from helpers import oscillator, two_masses

import fenics_crack as fc
from fenics_crack.curves import orbit_branch
from fenics_crack.curves.exact import _Judge
from fenics_crack.motion.orbit import eigenvalues, find_orbit

SOFT = fc.UnilateralPenalty(1.0)


def test_nodes_are_orbits_of_one_branch() -> None:
    """Each is found again by shooting, with its multipliers; chords agree with tangents, round both
    folds, and r, d and c change where bifurcations are alone."""
    curve = fc.continue_frequency(two_masses(), 0.6, 0.9, fc.UnilateralPenalty(100.0), harmonics=30)
    judge = _Judge(curve)
    crossings, nodes, system = judge.branch.locate(), judge.branch.nodes, judge.system
    assert (
        np.mean(judge.branch.linked) > 0.97
    )  # beside a fold of the curve nodes may come back a little
    for one in [one for one in nodes if one.crossing is None][::5]:  # a fold's M - I is singular
        omega = one.parameter * system.omega
        orbit = find_orbit(system.flow, omega, system.state(one.unknown))
        assert orbit is not None and orbit.flows <= 4
        off = system.unknown(orbit.state) - one.unknown
        assert np.linalg.norm(off) < 1e-5 * np.linalg.norm(one.unknown)
        count = min(len(orbit.multipliers), len(one.leading))
        assert np.abs(one.leading[:count]) == pytest.approx(
            np.abs(orbit.multipliers[:count]), abs=1e-3
        )
    assert all(one.located for one in crossings)
    for first, last in pairwise([one for one in nodes if one.crossing is None]):
        between = [one for one in crossings if first.place <= one.place <= last.place]
        assert (first.outside != last.outside) == bool(between)


def test_doublings_that_the_truncated_equations_lack(soft_plate: fc.Structure) -> None:
    """The paper's plate: a real multiplier goes to -1.0536 and back. Waves of 20 harmonics touch -1
    elsewhere, and were not confirmed."""
    law = fc.UnilateralPenalty(1e9)
    curve = fc.continue_frequency(soft_plate, 2300.0, 2450.0, law, harmonics=20, stability=True)
    assert [one.kind for one in curve.bifurcations] == 2 * ["period_doubling"]
    for one in curve.bifurcations:
        near = fc.solve_harmonic_balance(soft_plate, one.exact, law, harmonics=40)
        assert np.abs(fc.shoot(soft_plate, near).multipliers + 1.0).min() < 1e-6
    middle = fc.solve_harmonic_balance(soft_plate, 2390.0, law, harmonics=20)
    assert fc.shoot(soft_plate, middle).multipliers[0] == pytest.approx(-1.0536, abs=1e-4)
    low, high = (one.exact for one in curve.bifurcations)
    unstable = (curve.omega > low) & (curve.omega < high)
    assert np.array_equal(curve.verdicts == "unstable", unstable)
    assert set(curve.verdicts) == {"stable", "unstable"}


def test_two_bifurcations_next_to_each_other(soft_plate: fc.Structure) -> None:
    """A pair comes back into the unit circle, meets at -1, and one of it leaves again within 0.1
    rad/s: orbits at both frequencies have a multiplier on the circle."""
    law = fc.UnilateralPenalty(1e9)
    curve = fc.continue_frequency(soft_plate, 1700.0, 1725.0, law, harmonics=20, stability=True)
    found = {one.kind: one.exact for one in curve.bifurcations if 1712.0 < one.exact < 1713.0}
    assert set(found) == {"neimark_sacker", "period_doubling"}
    assert 0.05 < found["period_doubling"] - found["neimark_sacker"] < 0.15
    for kind, omega in found.items():
        near = fc.solve_harmonic_balance(soft_plate, omega, law, harmonics=40)
        values = fc.shoot(soft_plate, near).multipliers
        if kind == "period_doubling":
            assert np.abs(values + 1.0).min() < 1e-5
        else:
            assert abs(values[0].imag) > 0.01 and abs(values[0]) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(
    ("parameter", "start", "end", "count"),
    [("damping", 1.0, 8.0, 1), ("stiffness", 0.05, 2.0, 1), ("clearance", -3.0, 0.5, 2)],
)
def test_doublings_over_other_parameters(
    parameter: str, start: float, end: float, count: int
) -> None:
    """Orbits at their exact values have the multiplier -1, and verdicts change there."""
    curve = fc.continue_parameter(
        oscillator(), 2.3, SOFT, parameter, start, end, harmonics=15, stability=True
    )
    found = [one for one in curve.bifurcations if one.kind == "period_doubling"]
    assert len(found) == count and all(one.confirmed for one in found)
    for one in found:
        structure, law = oscillator(), SOFT
        if parameter == "stiffness":
            law = law.scaled(one.exact)
        else:
            structure = structure.varied(**{parameter: one.exact})
        near = fc.solve_harmonic_balance(structure, 2.3, law, harmonics=40, initial=one.solution)
        assert np.abs(fc.shoot(structure, near).multipliers + 1.0).min() < 1e-6
    changes = np.flatnonzero(curve.stable[1:] != curve.stable[:-1])
    assert len(changes) == count
    for change, one in zip(changes, found, strict=True):
        assert curve.values[change] <= one.exact <= curve.values[change + 1]


def test_leading_multipliers_of_a_large_matrix() -> None:
    """Those of all of it, or none where many are alike."""
    rng = np.random.default_rng(1)
    basis = rng.normal(size=(90, 90))
    for radius, known in ((0.9, True), (1.0, False)):
        sizes = radius ** np.arange(45) * 1.05 if known else np.full(45, 0.999)
        blocks = np.zeros((90, 90))
        for place, size in enumerate(sizes):
            angle = rng.uniform(0.1, 3.0)
            turn = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
            blocks[2 * place : 2 * place + 2, 2 * place : 2 * place + 2] = size * np.array(turn)
        matrix = basis @ blocks @ np.linalg.inv(basis)
        found = orbit_branch._leading(matrix)
        assert (found is not None) == known
        if found is not None:
            exact = np.sort(np.abs(eigenvalues(matrix)))[::-1][: len(found)]
            assert np.abs(found) == pytest.approx(exact, abs=1e-6)
