"""What response curves promise: their points, ends, bifurcations and verdicts."""

from functools import cache

import judged
import numpy as np
import pytest

import fenics_crack as fc

SOFT = fc.UnilateralPenalty(1.0)
STOP = fc.UnilateralPenalty(100.0)
EXACT = {
    "period_doubling": (0.7387830254, 0.7555861594),
    "fold": (0.7556273526, 0.6534401345),
    "neimark_sacker": (0.6186068743,),
}
"""Of two masses and a stop, in the order of the curve: by exact orbits."""


@cache
def bilinear() -> fc.ResponseCurve:
    """One mass over its doubled motion."""
    return fc.continue_frequency(judged.oscillator(), 1.5, 3.0, SOFT, harmonics=20, stability=True)


@cache
def stopped() -> fc.ResponseCurve:
    """Two masses and a stop: it turns back twice."""
    return fc.continue_frequency(judged.two_masses(), 0.6, 0.9, STOP, tolerance=1e-3)


def state(curve: fc.ResponseCurve) -> np.ndarray:
    """How large the motion is at each point."""
    return np.linalg.norm(curve.gap_coefficients[:, 1:], axis=(1, 2))


def test_linear_curve_is_that_of_a_resonance() -> None:
    """|X| = 1 / |1 - W^2 + i c W|, from one end to the other."""
    structure = judged.oscillator(clearance=100.0)
    curve = fc.continue_frequency(structure, 0.5, 1.5, SOFT, harmonics=3)
    assert curve.complete and not curve.bifurcations
    assert curve.omega[[0, -1]] == pytest.approx([0.5, 1.5], rel=1e-14)
    exact = 1.0 / np.abs(1.0 - curve.omega**2 + 0.1j * curve.omega)
    assert state(curve) == pytest.approx(exact, rel=1e-6)


def test_points_are_solutions_with_their_errors_and_verdicts() -> None:
    """Solved again at their frequencies they stay; errors and verdicts are those of the exact
    orbits."""
    curve = bilinear()
    assert curve.complete
    for place in np.linspace(0, len(curve) - 1, 8).astype(int):
        found = curve.solution(int(place))
        again = fc.solve_harmonic_balance(
            found.structure, found.omega, SOFT, harmonics=20, initial=found
        )
        moved = np.linalg.norm(again.gap_coefficients - found.gap_coefficients)
        assert moved < 1e-8 * np.linalg.norm(found.gap_coefficients)
        orbit = judged.orbit_of(found)
        true = judged.apart(found, orbit)
        assert true / 3.0 < found.report.total < 3.0 * true
        stable = np.abs(orbit.multipliers[0]) < 1.0
        assert curve.verdicts[place] == ("stable" if stable else "unstable")


def test_bifurcations_are_those_of_exact_orbits() -> None:
    """Two doublings, two folds and a Neimark-Sacker point, all confirmed, to six digits."""
    for kind, expected in EXACT.items():
        found = [one for one in stopped().bifurcations if one.kind == kind and one.confirmed]
        assert [one.exact for one in found] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("kind", EXACT)
def test_multiplier_at_a_bifurcation(kind: str) -> None:
    """Of the exact orbit there, of a fold as refined and else by a flow that is not the package's:
    +1, -1, or a pair on the unit circle."""
    one = next(one for one in stopped().bifurcations if one.kind == kind)
    omega, orbit = fc.refine_bifurcation(one)
    assert omega == pytest.approx(EXACT[kind][0], rel=1e-9)
    values = orbit.multipliers
    if kind != "fold":  # where no Newton's method can be asked
        flow = judged.flow_of(judged.two_masses(), STOP)
        state = flow.states_of(one.solution, judged.START)[0]
        exact = flow.orbit(state, omega, 2.0 * np.pi / omega)
        assert np.linalg.norm(exact.gap - orbit.gap) < 1e-7 * np.linalg.norm(exact.gap)
        values = exact.multipliers
    if kind == "neimark_sacker":
        assert np.abs(np.abs(values[np.abs(values.imag) > 0.1]) - 1.0).min() < 1e-7
    else:
        assert np.abs(values - (1.0 if kind == "fold" else -1.0)).min() < 1e-6


def test_folds_are_turning_points() -> None:
    """The frequency has its extremes there, and between both there are three solutions."""
    curve = stopped()
    folds = [one for one in curve.bifurcations if one.kind == "fold"]
    turns = np.flatnonzero(np.diff(np.sign(np.diff(curve.omega)))) + 1
    assert len(turns) == len(folds) == 2
    for turn, fold in zip(turns, folds, strict=True):
        assert np.ptp([curve.omega[turn], fold.value]) < 1e-3
    low, high = sorted(fold.value for fold in folds)
    crossings = np.diff(np.sign(curve.omega - 0.5 * (low + high)))
    assert np.count_nonzero(crossings) == 3


def test_verdict_changes_where_a_bifurcation_is() -> None:
    """And nowhere else."""
    curve = fc.continue_frequency(judged.oscillator(), 1.5, 3.0, SOFT, tolerance=1e-3)
    stable = curve.stable
    at = np.sort([one.value for one in curve.bifurcations])
    assert [one.kind for one in curve.bifurcations] == ["period_doubling"] * 2
    assert np.array_equal(stable, (curve.omega < at[0]) | (curve.omega > at[1]))


def test_up_and_down_are_one_curve() -> None:
    """The same motions in both directions, read off at a frequency between points."""
    down = fc.continue_frequency(judged.oscillator(), 3.0, 1.5, SOFT, harmonics=20)
    omega = np.linspace(1.6, 2.9, 40)
    up = bilinear()
    one = np.interp(omega, up.omega, state(up))
    other = np.interp(omega, down.omega[::-1], state(down)[::-1])
    assert np.abs(one / other - 1.0).max() < 0.02


@pytest.mark.parametrize(
    ("parameter", "start", "stop"),
    [("load", 0.5, 2.0), ("stiffness", 1.0, 50.0), ("damping", 1.0, 3.0), ("clearance", 0.2, 0.5)],
)
def test_curve_over_another_parameter(parameter: str, start: float, stop: float) -> None:
    """Its ends are the single solutions there."""
    structure, omega = judged.oscillator(clearance=0.3), 1.2
    curve = fc.continue_parameter(structure, omega, SOFT, parameter, start, stop, harmonics=15)
    assert curve.complete and curve.values[[0, -1]] == pytest.approx([start, stop], rel=1e-12)
    law = SOFT.scaled(stop) if parameter == "stiffness" else SOFT
    if parameter != "stiffness":
        structure = structure.varied(**{parameter: stop})
    end = curve.solution(len(curve) - 1)
    alone = fc.solve_harmonic_balance(structure, omega, law, harmonics=15, initial=end)
    moved = np.linalg.norm(alone.gap_coefficients - end.gap_coefficients)
    assert moved < 1e-8 * np.linalg.norm(end.gap_coefficients)


def test_refined_curve_holds_the_old_points() -> None:
    """Four more between each two, which are solutions of the same equations."""
    curve = bilinear()
    fine = fc.refine_curve(curve, 4)
    assert len(fine) == 5 * (len(curve) - 1) + 1
    assert fine.omega[::5] == pytest.approx(curve.omega, rel=1e-12)
    place = len(fine) // 2 + 1
    found = fine.solution(place)
    again = fc.solve_harmonic_balance(
        found.structure, found.omega, SOFT, harmonics=20, initial=found
    )
    assert np.abs(again.gap_coefficients - found.gap_coefficients).max() < 1e-5


def test_curve_that_is_stopped_goes_on() -> None:
    """Point by point, stopped and taken up: what was found stays, and the end is reached."""
    growing = fc.Continuation(fc.Problem(judged.oscillator(), 1.5, SOFT, 10), "omega", 1.5, 3.0)
    points = [point.value for point, _ in zip(growing, range(5), strict=False)]
    assert not growing.curve.complete
    growing.run()
    curve = growing.curve
    assert curve.complete and curve.omega[-1] == pytest.approx(3.0)
    assert curve.omega[:5] == pytest.approx(points, rel=1e-12)


def test_plate_without_mass() -> None:
    """Rigid, next to its first bilinear resonance: points are next to their orbits, and verdicts
    are theirs."""
    structure, law = judged.plate(), fc.UnilateralConstraint()
    bilinear = float(fc.bilinear_frequencies(structure).omega_bilinear[0])
    curve = fc.continue_frequency(
        structure, 0.96 * bilinear, 0.97 * bilinear, law, harmonics=10, stability=True
    )
    assert curve.complete
    for place in (0, len(curve) // 2, len(curve) - 1):
        found = curve.solution(place)
        orbit = judged.orbit_of(found)
        assert judged.apart(found, orbit) < 3.0 * found.report.total
        stable = np.abs(orbit.multipliers[0]) < 1.0
        assert curve.verdicts[place] in ("undecided", "stable" if stable else "unstable")
