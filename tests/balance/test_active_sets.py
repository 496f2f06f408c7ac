"""Contact of all pairs that a compliance couples: at one instant, and event by event."""

from itertools import product

import numpy as np
import pytest
import scipy.optimize
from helpers import random_stiffness, relative
from hypothesis import given, settings
from hypothesis import strategies as st
from intervals import Intervals, contact_intervals
from scipy.integrate import quad
from switching import switching_instants
from test_contact_integrals import grazing_gaps, random_gaps

import fenics_crack as fc
from fenics_crack.model import coupled
from fenics_crack.model.coupled import (
    ActiveSets,
    by_least_squares,
    smooth_forces,
    solve_complementarity,
    solve_forces,
)
from fenics_crack.numerics.fourier import evaluate, to_complex


def badly_conditioned(rng: np.random.Generator, pairs: int, condition: float) -> np.ndarray:
    """Eigenvalues spread evenly in their logarithms, in random directions."""
    basis = np.linalg.qr(rng.normal(size=(pairs, pairs)))[0]
    return (basis * np.geomspace(1.0, 1.0 / condition, pairs)) @ basis.T


def enumerated(compliance: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """lambda of the set, among all 2^p, that violates the conditions least."""
    found, least = gap, np.inf
    for members in product([False, True], repeat=len(gap)):
        closed = np.array(members)
        force = np.zeros(len(gap))
        block = compliance[np.ix_(closed, closed)]
        force[closed] = np.linalg.solve(block, gap[closed])
        opening = compliance @ force - gap
        violation = max(-opening.min(), -force.min() * compliance.max())
        if violation < least:
            found, least = force, violation
    return found


def by_nnls(compliance: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """The minimum of lambda^T D lambda / 2 - lambda^T s for lambda >= 0, by Lawson and Hanson."""
    root = np.linalg.cholesky(compliance)
    force: np.ndarray = scipy.optimize.nnls(root.T, np.linalg.solve(root, gap))[0]
    return force


# --- the constraint and the penalty law -----------------------------------------------------------


@pytest.mark.parametrize("condition", [3.0, 1e3, 1e7])
@pytest.mark.parametrize("pairs", [1, 2, 3, 5])
def test_forces_against_all_sets(pairs: int, condition: float) -> None:
    """Random compliances and gaps: those of the only set that fits."""
    rng = np.random.default_rng(pairs)
    compliance = badly_conditioned(rng, pairs, condition)
    gap = rng.normal(size=(60, pairs))
    force, closed = ActiveSets(compliance).solve(gap)
    expected = np.array([enumerated(compliance, row) for row in gap])
    assert relative(force, expected) < 1e-12 * condition
    assert np.array_equal(closed, expected > 0.0)
    if pairs > 1:
        assert len(np.unique(closed, axis=0)) > pairs  # many sets occur


@pytest.mark.parametrize("pairs", [8, 25])
def test_forces_of_many_pairs_against_least_squares(pairs: int) -> None:
    """scipy.optimize.nnls, with and without a guess of the sets."""
    rng = np.random.default_rng(pairs)
    compliance = np.linalg.inv(random_stiffness(rng, pairs))
    gap = rng.normal(size=(50, pairs))
    expected = np.array([by_nnls(compliance, row) for row in gap])
    for guess in (None, np.zeros(gap.shape, bool), np.ones(gap.shape, bool)):
        assert relative(ActiveSets(compliance).solve(gap, guess)[0], expected) < 1e-9


@pytest.mark.parametrize("condition", [1e2, 1e8])
def test_conditions_of_complementarity(condition: float) -> None:
    """lambda >= 0, opening >= 0, one of both zero, though active sets alone would cycle."""
    rng = np.random.default_rng(7)
    for pairs in (4, 12, 20):
        compliance = badly_conditioned(rng, pairs, condition)
        gap = rng.normal(size=(200, pairs))
        force, closed = ActiveSets(compliance).solve(gap)
        opening = force @ compliance - gap
        assert force.min() >= 0.0 and np.array_equal(closed, force > 0.0)
        assert opening.min() > -1e-9 * np.abs(gap).max()
        assert np.abs(opening[closed]).max() < 1e-9 * np.abs(gap).max()


def test_sets_that_are_not_found_follow_by_least_squares(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two pairs at one place cannot be told apart: their compliance is singular."""
    rng = np.random.default_rng(10)
    twice = np.repeat(np.arange(3), 2)
    compliance, gap = np.linalg.inv(random_stiffness(rng, 3)), rng.normal(size=(40, 3))
    expected = ActiveSets(compliance).solve(gap)[0]
    asked = []

    def counted(matrix: np.ndarray, row: np.ndarray) -> np.ndarray:
        asked.append(row)
        return by_least_squares(matrix, row)

    monkeypatch.setattr(coupled, "by_least_squares", counted)
    force, closed = ActiveSets(compliance[np.ix_(twice, twice)]).solve(gap[:, twice])
    assert len(asked) > 5 and np.array_equal(closed, force > 0.0)
    assert relative(force[:, ::2] + force[:, 1::2], expected) < 1e-9


def test_pairs_that_nothing_couples() -> None:
    """D = diag(1/k): k max(0, s), the penalty law."""
    rng = np.random.default_rng(3)
    stiffness, gap = rng.uniform(1.0, 1e9, 6), rng.normal(size=(40, 6))
    force, _ = ActiveSets(np.diag(1.0 / stiffness)).solve(gap)
    assert relative(force, stiffness * np.maximum(gap, 0.0)) < 1e-14


def test_gaps_at_zero_are_open() -> None:
    """s = 0, all of it or at some pairs: no force, and the pairs count as open."""
    compliance = np.linalg.inv(random_stiffness(np.random.default_rng(1), 3))
    force, closed = ActiveSets(compliance).solve(np.zeros((2, 3)))
    assert not np.any(force) and not np.any(closed)
    # Here the second pair would just touch: D_21 s_1 / D_11 = s_2.
    gap = np.array([[1.0, compliance[1, 0] / compliance[0, 0], -5.0]])
    force, _ = ActiveSets(compliance).solve(gap)
    assert np.allclose(force, [[1.0 / compliance[0, 0], 0.0, 0.0]], rtol=0.0, atol=1e-12)


def test_no_instants_and_no_pairs() -> None:
    """Arrays without rows, and laws of pairs that are not there, come back as they are."""
    sets = ActiveSets(np.eye(2))
    assert [part.shape for part in sets.solve(np.zeros((0, 2)))] == [(0, 2), (0, 2)]
    assert sets.stack(np.zeros((0, 2), bool)).shape == (0, 2, 2)


def test_slope_is_that_of_the_set() -> None:
    """d lambda / ds = (D_AA)^-1, by central differences."""
    rng = np.random.default_rng(5)
    compliance = np.linalg.inv(random_stiffness(rng, 4))
    sets, gap, step = ActiveSets(compliance), rng.normal(size=(20, 4)), 1e-7
    _, closed = sets.solve(gap)
    slopes = sets.stack(closed)
    for pair in range(4):
        change = step * np.eye(4)[pair]
        after, before = (sets.solve(gap + sign * change)[0] for sign in (1.0, -1.0))
        assert relative((after - before) / (2.0 * step), slopes[:, :, pair]) < 1e-7
    assert sets.scale == pytest.approx(np.trace(compliance) / 4.0)


def test_softer_pairs_let_the_gap_in() -> None:
    """With D = R + I/k the gap left is lambda / k, and vanishes with 1/k."""
    rng = np.random.default_rng(2)
    residual, gap = np.linalg.inv(random_stiffness(rng, 5)), rng.normal(size=(30, 5))
    rigid = ActiveSets(residual).solve(gap)[0]
    distances = []
    for stiffness in (1e2, 1e4, 1e6):
        force = ActiveSets(residual + np.eye(5) / stiffness).solve(gap)[0]
        left = gap - force @ residual
        assert np.abs(np.maximum(left, 0.0) - force / stiffness).max() < 1e-13
        distances.append(relative(force, rigid))
    assert distances[2] < 2e-2 * distances[1] < 4e-4 * distances[0]


# --- a smoothed law -------------------------------------------------------------------------------


@pytest.mark.parametrize("sharpness", [0.5, 30.0, 1e4])
@pytest.mark.parametrize("stiffness", [1.0, np.array([3.0, 1e4, 50.0])], ids=["soft", "stiff"])
def test_smoothed_law_against_a_root_finder(stiffness: float, sharpness: float) -> None:
    """lambda = h(s - D lambda) by MINPACK, from the solution of the penalty law."""
    rng = np.random.default_rng(6)
    law = fc.SmoothedPenalty(stiffness, sharpness)
    compliance = np.linalg.inv(random_stiffness(rng, 3))
    gap = rng.normal(size=(25, 3))
    force, _ = smooth_forces(law, compliance, gap)
    for row, found in zip(gap, force, strict=True):
        result = scipy.optimize.root(
            lambda g, s=row: g + compliance @ law.force(g) - s,
            row - compliance @ found + 1e-3,
            jac=lambda g: np.eye(3) + compliance * law.tangent(g),
            tol=1e-13,
        )
        assert np.abs(result.fun).max() < 1e-10
        assert np.allclose(found, law.force(result.x), rtol=1e-6, atol=1e-8)


def test_smoothed_law_alone_against_bisection() -> None:
    """One pair: the only root of g + R h(g) = s, bracketed."""
    law = fc.SmoothedPenalty(200.0, 40.0)
    gap = np.linspace(-2.0, 2.0, 41)[:, None]
    force, _ = smooth_forces(law, np.full((1, 1), 0.3), gap)
    for s, found in zip(gap[:, 0], force[:, 0], strict=True):
        root = scipy.optimize.brentq(
            lambda g, s=s: g + 0.3 * float(law.force(np.array(g))) - s, -10.0, 10.0, xtol=1e-15
        )
        assert found == pytest.approx(float(law.force(np.array(root))), rel=1e-9, abs=1e-10)


@pytest.mark.parametrize("sharpness", [1.0, 100.0])
def test_slope_of_a_smoothed_law(sharpness: float) -> None:
    """By central differences."""
    rng = np.random.default_rng(8)
    law, step = fc.SmoothedPenalty(50.0, sharpness), 1e-6
    compliance, gap = np.linalg.inv(random_stiffness(rng, 3)), rng.normal(size=(15, 3))
    _, slope = smooth_forces(law, compliance, gap)
    for pair in range(3):
        change = step * np.eye(3)[pair]
        after, before = (smooth_forces(law, compliance, gap + s * change)[0] for s in (1.0, -1.0))
        assert relative((after - before) / (2.0 * step), slope[:, :, pair]) < 1e-5


def test_smoothed_law_tends_to_the_penalty_law() -> None:
    """The difference falls with 1/s."""
    rng = np.random.default_rng(9)
    compliance, gap = np.linalg.inv(random_stiffness(rng, 3)), rng.normal(size=(20, 3))
    sharp = ActiveSets(compliance + np.eye(3) / 10.0).solve(gap)[0]
    one, two = (
        relative(smooth_forces(fc.SmoothedPenalty(10.0, s), compliance, gap)[0], sharp)
        for s in (1e3, 1e5)
    )
    assert one < 1e-2 and two < 2e-2 * one


def test_without_compliance_the_law_itself() -> None:
    """D = 0: h(s) and h'(s)."""
    law, gap = fc.SmoothedPenalty(7.0, 3.0), np.linspace(-1.0, 1.0, 20).reshape(10, 2)
    force, slope = smooth_forces(law, np.zeros((2, 2)), gap)
    assert np.allclose(force, law.force(gap), rtol=1e-14)
    assert np.allclose(np.einsum("npp->np", slope), law.tangent(gap), rtol=1e-14)
    assert not np.any(slope[:, 0, 1])


# --- one step of a scheme in time -----------------------------------------------------------------


def by_enumeration(matrix: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """The only set of closed pairs that satisfies all conditions, of all sets."""
    found = []
    for chosen in product([False, True], repeat=len(gap)):
        closed = np.array(chosen)
        force = np.zeros(len(gap))
        force[closed] = np.linalg.solve(matrix[np.ix_(closed, closed)], gap[closed])
        if force.min() >= 0.0 and (matrix @ force - gap).min() >= -1e-12:
            found.append(force)
    assert len(found) == 1
    return found[0]


@pytest.mark.parametrize("seed", range(20))
def test_complementarity_against_enumeration(seed: int) -> None:
    """Random couplings: active sets from any guess, and least squares alone."""
    rng = np.random.default_rng(seed)
    matrix, gap = random_stiffness(rng, 6) - 5.5 * np.eye(6), rng.normal(size=6)
    exact = by_enumeration(matrix, gap)
    for guess in (None, np.zeros(6, dtype=bool), np.ones(6, dtype=bool), rng.normal(size=6) > 0.0):
        assert np.allclose(solve_complementarity(matrix, gap, guess), exact, atol=1e-9)
    assert np.allclose(by_least_squares(matrix, gap), exact, atol=1e-9)


def test_complementarity_where_active_sets_cycle() -> None:
    """A positive definite matrix on which the active sets go round: least squares takes over."""
    rng = np.random.default_rng(0)
    cycled = 0
    for _ in range(3000):
        root = rng.normal(size=(4, 4))
        matrix, gap = root @ root.T + 1e-2 * np.eye(4), rng.normal(size=4)
        closed, seen = gap > 0.0, set()
        while closed.tobytes() not in seen:
            seen.add(closed.tobytes())
            force = np.zeros(4)
            force[closed] = np.linalg.solve(matrix[np.ix_(closed, closed)], gap[closed])
            now = np.where(closed, force > 0.0, matrix @ force - gap < 0.0)
            if np.array_equal(now, closed):
                break
            closed = now
        else:
            cycled += 1
            force = solve_complementarity(matrix, gap)
            opening = matrix @ force - gap
            assert force.min() >= 0.0 and opening.min() > -1e-8
            assert abs(force @ opening) < 1e-7 * (1.0 + np.abs(force).max())
    assert cycled > 0


def test_complementarity_without_solution_is_an_error() -> None:
    """Two opposite pairs on one dof that both penetrate."""
    matrix = np.array([[1.0, -1.0], [-1.0, 1.0]])
    with pytest.raises(fc.ConvergenceError, match="no set of closed pairs"):
        solve_complementarity(matrix, np.ones(2))


@pytest.mark.parametrize("stiffness", [1e-3, 1.0, 1e6])
def test_forces_by_newton(stiffness: float) -> None:
    """A sharp smoothed law, soft to stiff against the compliance, and SciPy's root."""
    rng = np.random.default_rng(7)
    law = fc.SmoothedPenalty(stiffness, 1e3)
    matrix, gap = random_stiffness(rng, 4) / 8.0, rng.normal(size=4)
    force = solve_forces(
        lambda g: (law.force(g), law.tangent(g)), matrix, gap[None], np.zeros((1, 4))
    )[0]
    reached = gap - matrix @ force
    assert np.allclose(law.force(reached), force, rtol=1e-6, atol=1e-8 * stiffness)
    if stiffness <= 1.0:
        root = scipy.optimize.root(lambda y: y - law.force(gap - matrix @ y), force + 1e-3)
        assert root.success and np.allclose(root.x, force, atol=1e-8)


def test_forces_that_do_not_exist_are_an_error() -> None:
    """A force that falls with the gap, faster than the step's compliance allows."""
    with pytest.raises(fc.ConvergenceError, match="Newton"):
        solve_forces(
            lambda g: (1.0 + g**2, 2.0 * g),
            np.ones((1, 1)),
            np.full((1, 1), -5.0),
            np.zeros((1, 1)),
        )


# --- when which pairs are closed ------------------------------------------------------------------


def coupled_sets(pairs: int, seed: int = 1) -> ActiveSets:
    """Of a random compliance that couples all pairs."""
    return ActiveSets(np.linalg.inv(random_stiffness(np.random.default_rng(seed), pairs)))


def closed_at(intervals: Intervals, theta: np.ndarray) -> np.ndarray:
    """The sets of the intervals at phases: (n, n_pairs)."""
    place = np.searchsorted(intervals.theta, theta, side="right") - 1
    return intervals.closed[place]


def means_of(intervals: Intervals, highest: int) -> np.ndarray:
    """Means of exp(i m theta) over each interval: (m, highest + 1)."""
    rests = intervals.rests(highest)
    return rests - np.vstack([rests[1:], 0.0 * rests[:1]])


def closed_for(intervals: Intervals, pair: int = 0) -> float:
    """How long a pair is closed [rad]."""
    lengths = np.diff(np.append(intervals.theta, 2.0 * np.pi))
    return float(lengths[intervals.closed[:, pair]].sum())


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("pairs", "harmonics"), [(1, 6), (2, 9), (5, 5), (24, 4)])
def test_sets_are_those_of_every_instant(pairs: int, harmonics: int, seed: int) -> None:
    """At 4000 random phases, but within 1e-6 of an event; every one of these is a root."""
    contact, gap = coupled_sets(pairs, seed), random_gaps(harmonics, pairs, seed)
    intervals = contact_intervals(gap, contact)
    assert intervals.theta[0] == 0.0 and np.all(np.diff(intervals.theta) >= 0.0)
    theta = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, 4000)
    distance = np.abs(theta[:, None] - intervals.theta).min(axis=1)
    theta = theta[distance > 1e-6]
    _, expected = contact.solve(evaluate(gap, 1.0, theta))
    assert np.array_equal(closed_at(intervals, theta), expected)
    assert len(intervals.theta) > pairs
    # The forces on both sides of an event are the same: they vanish, or begin, there.
    values = evaluate(gap, 1.0, intervals.theta[1:])
    before, after = (
        np.einsum("npq,nq->np", contact.stack(sets), values)
        for sets in (intervals.closed[:-1], intervals.closed[1:])
    )
    largest = np.abs(contact.solve(evaluate(gap, 1.0, theta))[0]).max()
    assert np.abs(before - after).max() < 1e-9 * largest


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 40), st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_stiffness_follows_from_its_changes(pairs: int, harmonics: int, seed: int) -> None:
    """Event after event the inverse of NumPy on the closed pairs, zero outside, to 1e-12."""
    random = np.random.default_rng(seed)
    gap = random.normal(size=(2 * harmonics + 1, pairs))
    compliance = np.linalg.inv(random_stiffness(random, pairs))
    intervals = contact_intervals(gap, ActiveSets(compliance))
    found = intervals.stiffness.copy()
    changes = zip(intervals.gains, intervals.vectors, strict=True)
    for closed, change in zip(intervals.closed, [*changes, None], strict=True):
        expected = np.zeros((pairs, pairs))
        inside = np.ix_(closed, closed)
        expected[inside] = np.linalg.inv(compliance[inside])
        assert np.abs(found - expected).max() <= 1e-12 * max(1.0, np.abs(expected).max())
        if change is not None:
            found += change[0] * np.outer(change[1], change[1])


@pytest.mark.parametrize("stiffness", [1e4, 1e6])
def test_a_compliance_close_to_singular(stiffness: float) -> None:
    """Neighbours that hardly differ, condition numbers of 2e5 and 2e7: rounding is left behind."""
    place = np.linspace(0.0, 3.0, 40)
    compliance = np.exp(-((place[:, None] - place) ** 2)) + np.eye(40) / stiffness
    gap = random_gaps(6, 40, 1)
    intervals = contact_intervals(gap, ActiveSets(compliance))
    theta = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, 200)
    values = evaluate(gap, 1.0, theta)
    for value, closed in zip(values, closed_at(intervals, theta), strict=True):
        force = np.zeros(40)
        force[closed] = np.linalg.solve(compliance[np.ix_(closed, closed)], value[closed])
        assert np.all(force >= 0.0) and np.all((compliance @ force - value)[~closed] > -1e-9)
    last = intervals.stiffness + (intervals.vectors.T * intervals.gains) @ intervals.vectors
    assert np.abs(last - intervals.stiffness).max() < 1e-9 * np.abs(last).max()


def test_events_of_one_pair_are_its_zeros() -> None:
    """The instants of the search for pairs that nothing couples."""
    for seed in range(5):
        gap = random_gaps(8, 1, seed)
        intervals = contact_intervals(gap, ActiveSets(np.full((1, 1), 0.3)))
        switching = switching_instants(to_complex(gap))
        expected = np.sort(np.mod(switching.theta, 2.0 * np.pi))
        assert np.allclose(intervals.theta[1:], expected, rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("depth", [1e-3, 1e-5, 1e-7, 1e-9])
def test_contact_that_comes_and_goes_in_a_cell(depth: float) -> None:
    """A peak that high above zero: 2 (2 d / |g''|)^1/2 long; so high below: no contact; and the
    same upside down."""
    gaps = grazing_gaps(np.full(20, depth))
    phase = np.linspace(0.0, 2.0 * np.pi, 1 << 16, endpoint=False)
    for gap in gaps.T[:, :, None]:
        wave = evaluate(gap, 1.0, phase)[:, 0]
        top = int(np.argmax(wave))
        width = phase[1] - phase[0]
        bend = (wave[top - 1] - 2.0 * wave[top] + wave[(top + 1) % len(wave)]) / width**2
        long = 2.0 * np.sqrt(2.0 * depth / -bend)
        contact = ActiveSets(np.eye(1))
        found = closed_for(contact_intervals(gap, contact))
        assert found == pytest.approx(long, rel=0.2 if depth > 1e-4 else 0.02)
        missing = contact_intervals(-gap, contact)
        assert 2.0 * np.pi - closed_for(missing) == pytest.approx(found, rel=1e-4)
        gap[0] -= 2.0 * depth
        assert closed_for(contact_intervals(gap, contact)) == 0.0


def test_pairs_that_open_and_close_together() -> None:
    """Equal waves on equal pairs, in pairs that differ by rounding: their events coincide."""
    one = random_gaps(6, 1, 3)
    compliance = 2.0 * np.eye(4) + 0.5
    together = ActiveSets(np.array([[compliance.sum(axis=1)[0]]]))
    alone = contact_intervals(one, together)
    for noise in (0.0, 1e-16, 1e-13):
        gap = np.tile(one, 4) * (1.0 + noise * np.arange(4))
        intervals = contact_intervals(gap, ActiveSets(compliance))
        for pair in range(4):
            assert closed_for(intervals, pair) == pytest.approx(closed_for(alone), abs=1e-9)
        theta = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, 500)
        theta = theta[np.abs(theta[:, None] - alone.theta).min(axis=1) > 1e-6]
        assert np.array_equal(closed_at(intervals, theta), np.tile(closed_at(alone, theta), 4))


@pytest.mark.parametrize("harmonics", [1, 3, 8])
@pytest.mark.parametrize("wave", ["sine", "cosine", "both"])
def test_events_at_the_ends_of_cells(wave: str, harmonics: int) -> None:
    """Zeros on the grid: half of the period closed, in pairs that are each other's opposite too."""
    gap = np.zeros((2 * harmonics + 1, 2))
    row = {"sine": [2, 2], "cosine": [1, 1], "both": [1, 2]}[wave]
    gap[row[0], 0], gap[row[1], 1] = 1.0, -1.0
    contact = ActiveSets(np.diag([1.0, 3.0]))
    for sign in (1.0, -1.0):
        intervals = contact_intervals(sign * gap, contact)
        assert closed_for(intervals, 0) == pytest.approx(np.pi, abs=1e-12)
        assert closed_for(intervals, 1) == pytest.approx(np.pi, abs=1e-12)
        theta = np.linspace(0.1, 6.2, 37)
        expected = evaluate(sign * gap, 1.0, theta) > 0.0
        assert np.array_equal(closed_at(intervals, theta), expected)


def test_always_open_and_always_closed() -> None:
    """No event: one set for all of the period."""
    gap = random_gaps(4, 3)
    for mean, closed in ((-100.0, False), (100.0, True)):
        gap[0] = mean
        compliance = np.eye(3) + 0.1
        intervals = contact_intervals(gap, ActiveSets(compliance))
        assert len(intervals.theta) == 1 and np.all(intervals.closed == closed)
        assert np.allclose(means_of(intervals, 8), np.eye(9)[0], rtol=0.0, atol=1e-14)


def test_means_by_quadrature() -> None:
    """QUADPACK between the events, for each interval and each multiple of the phase."""
    contact, gap = coupled_sets(3), random_gaps(3, 3, 2)
    intervals = contact_intervals(gap, contact)
    means, ends = means_of(intervals, 6), np.append(intervals.theta, 2.0 * np.pi)
    assert means[:, 0].real.sum() == pytest.approx(1.0)
    for row in range(len(intervals.theta)):
        for order in (0, 1, 5, 6):
            parts = 0j
            for unit, wave in ((1.0, np.cos), (1j, np.sin)):
                parts += (
                    unit * quad(lambda t, w=wave, m=order: w(m * t), ends[row], ends[row + 1])[0]
                )
            assert means[row, order] == pytest.approx(parts / (2.0 * np.pi), abs=1e-10)
