"""Bifurcations on exact orbits."""

from dataclasses import dataclass

import numpy as np
import pytest
from helpers import OMEGA_0, oscillator, two_masses

import fenics_crack as fc

CURVE = {"omega_start": 0.6, "omega_end": 0.9, "contact": fc.UnilateralPenalty(100.0)}
EXACT = {
    "period_doubling": (0.7387830254, 0.7555861594),
    "fold": (0.7556273526, 0.6534401345),
    "neimark_sacker": (0.6186068743,),
}
"""Two masses and a stop: by kind, along the curve; the same from 21, 41, 81 and 121 harmonics."""


def judged(harmonics: int) -> fc.ResponseCurve:
    """The curve of two masses and a stop."""
    return fc.continue_frequency(two_masses(), **CURVE, harmonics=harmonics, stability=True)


def test_what_few_harmonics_put_far_away_is_on_the_curve() -> None:
    """H = 21 has a doubling 8 % below the first one: a judged curve has both true ones alone."""
    curve = judged(21)
    right = [one for one in curve.bifurcations if one.kind == "period_doubling"]
    assert [one.exact for one in right] == pytest.approx(EXACT["period_doubling"], rel=1e-8)
    place = np.argmin(np.linalg.norm(curve.unknowns - right[0].unknown, axis=(1, 2)))
    around = curve.verdicts[place - 2 : place + 3].tolist()
    assert around == sorted(around) and {"stable", "unstable"} == set(around)


@pytest.mark.verification
@pytest.mark.parametrize("harmonics", [21, 61])
def test_bifurcations_of_two_masses_and_a_stop(harmonics: int) -> None:
    """All special points of the contact branch, from solutions with few and with many harmonics."""
    curve = judged(harmonics)
    for kind, expected in EXACT.items():
        special = [b for b in curve.bifurcations if b.kind == kind and b.confirmed]
        assert len(special) == len(expected)
        for bifurcation, exact in zip(special, expected, strict=True):
            omega, orbit = fc.refine_bifurcation(bifurcation, reach=0.2)  # H = 21: 10 % away
            assert omega == pytest.approx(exact, rel=1e-9)
            assert orbit.residual < 1e-11
            if kind == "neimark_sacker":
                pair = orbit.multipliers[orbit.multipliers.imag > 0.1]
                assert np.abs(np.abs(pair) - 1.0).min() < 1e-9
            else:
                # Next to a fold it goes like the root of how far that is.
                critical, off = (1.0, 1e-5) if kind == "fold" else (-1.0, 1e-6)
                assert np.abs(orbit.multipliers - critical).min() < off
    doubling = next(b for b in curve.bifurcations if b.kind == "period_doubling")
    assert fc.refine_bifurcation(doubling, reach=0.2)[0] == pytest.approx(0.7387830, rel=1e-7)


def test_multiplier_seen_in_the_motion() -> None:
    """At the period doubling the critical direction changes its sign each period, undamped."""
    curve = judged(61)
    doubling = next(b for b in curve.bifurcations if b.kind == "period_doubling")
    omega, orbit = fc.refine_bifurcation(doubling)
    values, vectors = np.linalg.eig(orbit.monodromy)
    critical = vectors[:, np.argmin(np.abs(values + 1.0))].real
    offset = 1e-6 * np.linalg.norm(orbit.state) * critical
    state = orbit.state + offset
    for index in range(1, 5):
        state = orbit.flow.advance(state, omega, orbit.period).state
        assert state - orbit.state == pytest.approx((-1.0) ** index * offset, abs=1e-4 * 1e-6)


def test_doublings_of_the_oscillator() -> None:
    """W = 2 w0 lies between them, and the orbit of period 1 is unstable there."""
    structure, law = oscillator(), fc.UnilateralPenalty(1.0)
    found = []
    for harmonics in (5, 20):
        curve = fc.continue_frequency(structure, 1.5, 3.0, law, harmonics=harmonics, stability=True)
        special = [b for b in curve.bifurcations if b.kind == "period_doubling"]
        found.append([fc.refine_bifurcation(b)[0] for b in special])
    assert found[0] == pytest.approx(found[1], rel=1e-10)
    first, second = found[1]
    assert first < 2.0 * OMEGA_0 < second
    for omega, unstable in ((0.999 * first, False), (1.001 * first, True), (1.001 * second, False)):
        solution = fc.solve_harmonic_balance(structure, omega, law, harmonics=40)
        assert (np.abs(fc.shoot(structure, solution).multipliers[0]) > 1.0) == unstable


def test_paper_plate(soft_plate: fc.Structure) -> None:
    """All 50 modes, k = 1e9: 20 and 40 harmonics lead to the same points.

    With 20 harmonics the curve has more folds, and pairs that cross the unit circle between them;
    the exact branch has one fold there.
    """
    law, found = fc.UnilateralPenalty(1e9), []
    for harmonics in (20, 40):
        curve = fc.continue_frequency(
            soft_plate, 1280.0, 1340.0, law, harmonics=harmonics, stability=True
        )
        refined = [
            (b.kind, *fc.refine_bifurcation(b, reach=0.02))
            for b in curve.bifurcations
            if b.kind == "fold" or b.omega < 1310.0
        ]
        assert all(np.abs(np.abs(o.multipliers) - 1.0).min() < 1e-7 for _, _, o in refined)
        found.append({(kind, round(omega, 4)) for kind, omega, _ in refined})
    assert found[0] == found[1]
    assert {kind for kind, _ in found[0]} == {"fold", "neimark_sacker"}
    assert len(found[0]) == 4


@dataclass(frozen=True)
class Special:
    """A kind and a solution."""

    kind: str
    solution: fc.PeriodicSolution


def test_bifurcations_that_do_not_exist() -> None:
    """One error that says what was looked for, or which argument cannot be used."""
    structure, law = oscillator(), fc.UnilateralPenalty(1.0)
    solution = fc.solve_harmonic_balance(structure, 1.0, law, harmonics=10)
    with pytest.raises(fc.ConvergenceError, match="no period doubling of exact orbits within 10 %"):
        fc.refine_bifurcation(Special("period_doubling", solution), reach=0.1)
    with pytest.raises(fc.InputError, match=r"^bifurcation"):
        fc.refine_bifurcation(Special("branch_point", solution))
    for reach in (0.0, 0.6):
        with pytest.raises(fc.InputError, match=r"^reach"):
            fc.refine_bifurcation(Special("fold", solution), reach=reach)
    with pytest.raises(fc.InputError, match=r"^contact"):
        fc.refine_bifurcation(Special("fold", solution), contact=fc.SmoothedPenalty(1.0, 1.0))
