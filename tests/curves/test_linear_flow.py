"""Smooth laws: the linear flow along their waves, verdicts of solutions and of curves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import scipy.special
from helpers import Cubic, chain, dense_matrices, oscillator, relative
from scipy.integrate import solve_ivp

import fenics_crack as fc
from fenics_crack.curves.stability import monodromy
from fenics_crack.model.modal import all_modes


def integrated(law: Any, found: fc.PeriodicSolution) -> np.ndarray:
    """M of the modes that move by SciPy's integrator, the law evaluated at its own instants."""
    modes, residual = all_modes(found.structure), found.residual
    if found.static_above is not None:
        modes = modes.below(found.static_above)
    n, unit = len(modes.squares), np.eye(found.structure.n_pairs)
    damping = np.diag(modes.damping) if modes.damping.ndim == 1 else modes.damping

    def rate(time: float, state: np.ndarray) -> np.ndarray:
        moved = state.reshape(2 * n, 2 * n)
        slope = np.diag(law.tangent(found.gap(np.array([time])))[0])
        if residual is not None:  # d lambda / ds of lambda = h(s - R lambda)
            slope = slope @ np.linalg.inv(unit + residual @ slope)
        push = modes.squares[:, None] * moved[:n] + damping @ moved[n:]
        push += modes.pairs @ (slope @ (modes.pairs.T @ moved[:n]))
        return np.concatenate([moved[n:], -push]).ravel()

    run = solve_ivp(
        rate, (0.0, found.period), np.eye(2 * n).ravel(), "DOP853", rtol=1e-9, atol=1e-11
    )
    matrix: np.ndarray = run.y[:, -1].reshape(2 * n, 2 * n)
    return matrix


@pytest.mark.parametrize("damping", ["modal", "matrix", "overdamped"])
def test_against_an_integrator(damping: str) -> None:
    """Three pairs with clearances, and modes that do not oscillate at all."""
    structure = chain("matrix" if damping == "matrix" else "modal")
    if damping == "overdamped":
        mass, _, stiffness = dense_matrices(structure)
        structure = fc.Structure.from_matrices(
            mass, stiffness, structure.gap.toarray(), force_cos=structure.force[1],
            damping=fc.ModalDamping([1.5] * 4 + [0.1] * 6), clearance=structure.clearance,
        )  # fmt: skip
    law = fc.SmoothedPenalty(np.array([3.0, 5.0, 9.0]), 4.0)
    found = fc.solve_harmonic_balance(structure, 1.1, law, harmonics=20)
    exact = integrated(law, found)
    matrix = monodromy(structure, law, found.gap_coefficients, found.base_omega)
    assert relative(matrix, exact) < 2e-6
    stability = fc.floquet(structure, found)
    largest = np.abs(np.linalg.eigvals(exact)).max()
    assert abs(stability.multipliers[0]) == pytest.approx(largest, rel=1e-6)
    assert stability.verdict == ("stable" if largest < 1.0 else "unstable")
    assert stability.uncertainty < 1e-3


@pytest.mark.usefixtures("predicted_errors")
def test_pairs_behind_a_compliance() -> None:
    """Lips without mass: modes alone move, tied by the slopes of lambda(s)."""
    structure = fc.reduce_structure(chain("modal"), modes=4, method="massless")
    law = fc.SmoothedPenalty(20.0, 4.0)
    found = fc.solve_harmonic_balance(structure, 1.1, law, harmonics=8)
    gap, above = found.slow_gap_coefficients, found.static_above
    assert found.residual is not None
    matrix = monodromy(structure, law, gap, found.base_omega, above)
    assert relative(matrix, integrated(law, found)) < 2e-6
    assert fc.floquet(structure, found).verdict != "undecided"


@dataclass(frozen=True)
class Square:
    """lambda = c g^2 / 2, whose stiffness is the gap."""

    stiffness: float = 1.0

    def force(self, gap: np.ndarray) -> np.ndarray:
        """c g^2 / 2."""
        return 0.5 * self.stiffness * gap**2

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """c g."""
        return self.stiffness * gap

    def scaled(self, factor: float) -> Square:
        """The same with another c."""
        return Square(factor * self.stiffness)


@pytest.mark.parametrize(("order", "even"), [(1, True), (2, True), (2, False), (3, False)])
def test_mathieu(order: int, even: bool) -> None:
    """x'' + (a - 2 q cos 2t) x = 0 has at the characteristic values a_r(q), b_r(q) the multiplier
    (-1)^r, twice, in a period pi."""
    q = 5.0
    characteristic = scipy.special.mathieu_a if even else scipy.special.mathieu_b
    one = np.ones((1, 1))
    structure = fc.Structure.from_matrices(one, characteristic(order, q) * one, one)
    gap = np.array([[0.0], [-2.0 * q], [0.0]])
    matrix = monodromy(structure, Square(), gap, 2.0)
    assert np.trace(matrix) == pytest.approx(2.0 * (-1.0) ** order, abs=2e-5)
    assert np.linalg.det(matrix) == pytest.approx(1.0, abs=1e-5)


def test_without_pairs() -> None:
    """The multipliers of the modes, exp(-c T / 2) in size."""
    structure = fc.Structure.from_matrices(
        np.eye(2), np.diag([1.0, 2.0]), np.zeros((2, 0)), force_cos=[1.0, 0.0],
        damping=0.1 * np.eye(2),
    )  # fmt: skip
    linear = fc.solve_linear(structure, 0.7, harmonics=3)
    found = fc.floquet(structure, linear, fc.SmoothedPenalty(1.0, 1.0))
    assert found.verdict == "stable"
    assert np.abs(found.multipliers) == pytest.approx(np.exp(-0.05 * linear.period), rel=1e-9)


def test_many_at_once_are_one_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """However many stretches of the period are advanced together."""
    structure, law = chain("matrix"), fc.SmoothedPenalty(3.0, 4.0)
    gap = fc.solve_harmonic_balance(structure, 1.1, law, harmonics=6).gap_coefficients
    one = monodromy(structure, law, gap, 1.1)
    monkeypatch.setattr("fenics_crack.curves.stability.CACHED", 1)
    assert relative(monodromy(structure, law, gap, 1.1), one) < 1e-10


# --- curves ---------------------------------------------------------------------------------------


def test_points_of_a_duffing_curve_are_judged_as_solutions_are() -> None:
    """Up, back and up again: the middle is unstable, and verdicts change at the folds alone, where
    a multiplier passes 1."""
    structure, law = oscillator(0.05, 1.0), Cubic(0.1)
    curve = fc.continue_frequency(structure, 0.5, 3.0, law, harmonics=10, stability=True)
    assert [one.kind for one in curve.bifurcations] == ["fold", "fold"]
    high, low = (one.value for one in curve.bifurcations)
    turns = np.flatnonzero(np.diff(np.sign(np.diff(curve.omega)))) + 1
    middle = np.arange(turns[0] + 1, turns[1])
    assert set(curve.verdicts[middle]) == {"unstable"}
    others = np.delete(curve.verdicts, np.arange(turns[0] - 1, turns[1] + 2))
    assert set(others) == {"stable"} and low < high
    for one in curve.bifurcations:
        values = fc.floquet(structure, one.solution).multipliers
        assert np.abs(values - 1.0).min() < 1e-3
    for place in range(0, len(curve), 20):
        alone = fc.floquet(structure, curve.solution(place))
        assert curve.verdicts[place] == alone.verdict
        assert abs(curve.multipliers[place]) == pytest.approx(abs(alone.multipliers[0]), rel=1e-9)


@pytest.fixture(scope="module")
def doubling() -> fc.ResponseCurve:
    """A smoothed stop as stiff as the mass's own spring, over twice its frequency."""
    law = fc.SmoothedPenalty(1.0, 20.0)
    return fc.continue_frequency(oscillator(), 1.5, 3.0, law, harmonics=12, stability=True)


def test_period_doublings_of_a_smooth_law(doubling: fc.ResponseCurve) -> None:
    """Between two points: a multiplier is -1 by an integrator, too; verdicts change there."""
    assert [one.kind for one in doubling.bifurcations] == 2 * ["period_doubling"]
    for one in doubling.bifurcations:
        values = np.linalg.eigvals(integrated(doubling.contact, one.solution))
        assert np.abs(values + 1.0).min() < 1e-4
    first, second = (one.value for one in doubling.bifurcations)
    unstable = (doubling.omega > first) & (doubling.omega < second)
    assert np.array_equal(doubling.verdicts == "unstable", unstable)


def test_branch_of_twice_the_period_of_a_smooth_law(doubling: fc.ResponseCurve) -> None:
    """It begins where the multiplier is -1, stable where the old one is not."""
    branch = fc.follow_branch(doubling, doubling.bifurcations[0], stability=True)
    assert branch.status == "joined the branch that it left"
    assert np.mean(branch.verdicts == "stable") > 0.8
    assert branch.omega[-1] == pytest.approx(doubling.bifurcations[1].value, rel=1e-2)


def test_neimark_sacker_point_of_a_smooth_law() -> None:
    """Two masses and a rounded stop: a pair leaves the unit circle, by an integrator, too."""
    stiffness = np.array([[1.0, -1.0], [-1.0, 2.0]])
    structure = fc.Structure.from_matrices(
        np.eye(2), stiffness, [1.0, 0.0], force_cos=[0.0, 0.1], clearance=1.0,
        damping=0.03 * stiffness,
    )  # fmt: skip
    law = fc.SmoothedPenalty(20.0, 30.0)
    curve = fc.continue_frequency(structure, 0.6, 0.9, law, harmonics=20, stability=True)
    found = [one for one in curve.bifurcations if one.kind == "neimark_sacker"]
    assert found
    for one in found:
        values = np.linalg.eigvals(integrated(law, one.solution))
        pair = values[np.abs(values.imag) > 1e-3]
        assert np.abs(np.abs(pair) - 1.0).min() < 1e-4


def test_judged_again(doubling: fc.ResponseCurve) -> None:
    """The same verdicts and bifurcations, each once."""
    again = fc.judge_curve(doubling)
    assert np.array_equal(again.verdicts, doubling.verdicts)
    assert [one.value for one in again.bifurcations] == [one.value for one in doubling.bifurcations]


def test_rigid_contact_of_pairs_with_mass_has_no_verdicts() -> None:
    """Said before anything is followed, with what to do instead."""
    structure, law = chain("modal"), fc.UnilateralConstraint()
    with pytest.raises(fc.InputError, match="massless"):
        fc.Continuation(fc.Problem(structure, 1.0, law), "omega", 1.0, 1.2, stability=True)
    with pytest.raises(fc.InputError, match="massless"):
        fc.continue_frequency(structure, 1.0, 1.2, law, stability=True)
