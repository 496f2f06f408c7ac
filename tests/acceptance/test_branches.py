"""What branches promise: of twice the period, and where equal masses part."""

from functools import cache

import judged
import numpy as np
import pytest
from helpers import catch_error

import fenics_crack as fc

SOFT = fc.UnilateralPenalty(1.0)


@cache
def found() -> tuple[fc.ResponseCurve, fc.ResponseCurve]:
    """The oscillator's curve, and its branch."""
    curve = fc.continue_frequency(judged.oscillator(), 1.5, 3.0, SOFT, tolerance=1e-3)
    start_point = next(
        bifurcation for bifurcation in curve.bifurcations if bifurcation.kind == "period_doubling"
    )
    return curve, fc.follow_branch(curve, start_point)


def odd(branch: fc.ResponseCurve) -> np.ndarray:
    """Size of the harmonics that twice the period adds, relative to all."""
    rows = branch.gap_coefficients
    part = np.concatenate([rows[:, 1::4], rows[:, 2::4]], axis=1)
    return np.linalg.norm(part, axis=(1, 2)) / np.linalg.norm(rows, axis=(1, 2))


def test_begins_and_ends_where_the_curve_doubles() -> None:
    """At the exact doublings, where the added harmonics vanish."""
    curve, branch = found()
    ends = [bifurcation.value for bifurcation in curve.bifurcations]
    assert branch.complete and branch.status == "joined the branch that it left"
    assert [branch.omega.min(), branch.omega.max()] == pytest.approx(ends, abs=1e-4)
    sizes = odd(branch)
    assert sizes[-1] < 0.02 and sizes.max() > 0.3


def test_meets_the_doubled_motion_of_direct_integration() -> None:
    """From rest, 300 periods at 2 w0: every second one is the same, no two after each other are;
    the branch's point there is that motion."""
    omega = 2.0 * judged.OMEGA_0
    _, branch = found()
    branch_solution = branch.solution(int(np.argmin(np.abs(branch.omega - omega))))
    point = fc.solve_harmonic_balance(
        judged.oscillator(), omega, SOFT, harmonics=60, subharmonic=2, initial=branch_solution
    )
    history = fc.integrate_events(judged.oscillator(), omega, SOFT, periods=300, record_periods=4)
    gap = history.gap[:, 0].reshape(4, -1)
    size = np.ptp(gap)
    assert np.abs(gap[2:] - gap[:2]).max() < 1e-6 * size
    assert np.abs(gap[1] - gap[0]).max() > 0.1 * size
    wave = point.gap(np.arange(512) * point.period / 512)[:, 0]
    march = gap[:2].ravel()
    assert min(np.abs(np.roll(march, shift) - wave).max() for shift in (0, 256)) < 1e-4 * size
    assert point.report.total < 1e-3


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_points_are_next_to_their_orbits(share: float) -> None:
    """Error and verdict of points along it, by the exact orbit of twice the period; ``floquet``
    says the same."""
    _, branch = found()
    place = int(share * (len(branch) - 1))
    point = branch.solution(place)
    orbit = judged.orbit_of(point)
    true_error = judged.apart(point, orbit)
    assert true_error / 3.0 < point.report.total < 3.0 * true_error
    assert np.abs(orbit.multipliers[0]) < 1.0 and branch.verdicts[place] == "stable"
    assert fc.floquet(point.structure, point).verdict == "stable"


def test_no_branch_where_none_begins() -> None:
    """A fold is no place for it."""
    curve = fc.continue_frequency(
        judged.two_masses(), 0.6, 0.9, fc.UnilateralPenalty(100.0), harmonics=15
    )
    fold = next(bifurcation for bifurcation in curve.bifurcations if bifurcation.kind == "fold")
    catch_error(lambda: fc.follow_branch(curve, fold), "bifurcation", "fold")


def test_equal_masses_part_at_a_branch_point() -> None:
    """Two of them with stops, loaded alike, move alike on the curve; on the branch they do not, nor
    in the exact orbit next to a point of it. It closes where it left."""
    structure = fc.Structure.from_matrices(
        np.eye(2), np.array([[2.0, -1.0], [-1.0, 2.0]]), gap=np.eye(2), force_sin=np.ones(2),
        clearance=0.3, damping=fc.ModalDamping(0.02),
    )  # fmt: skip
    curve = fc.continue_frequency(structure, 0.3, 3.0, fc.UnilateralPenalty(2.0), harmonics=10)
    assert np.ptp(curve.gap_coefficients, axis=2).max() < 1e-7
    branch_point = next(
        bifurcation for bifurcation in curve.bifurcations if bifurcation.kind == "branch_point"
    )
    branch = fc.follow_branch(curve, branch_point)
    assert branch.complete and branch.status == "closed loop"
    pair_difference = np.ptp(branch.gap_coefficients, axis=2).max(axis=1)
    point = branch.solution(int(np.argmax(pair_difference)))
    assert judged.apart(point, judged.orbit_of(point)) < 3.0 * point.report.total < 0.03
    gap = fc.shoot(structure, point).gap_at(np.linspace(0.0, point.period, 100))
    assert np.ptp(gap, axis=1).max() > 0.02
    assert abs(branch.omega - branch_point.omega).min() < 1e-3
