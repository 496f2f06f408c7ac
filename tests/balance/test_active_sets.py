"""When which pairs are closed, for contact that couples the pairs: cell by cell."""

import numpy as np
import pytest
from helpers import random_stiffness
from hypothesis import given, settings
from hypothesis import strategies as st
from intervals import Intervals, contact_intervals
from scipy.integrate import quad
from switching import switching_instants
from test_contact_integrals import grazing_gaps, random_gaps

from fenics_crack.model.coupled import ActiveSets
from fenics_crack.numerics.fourier import evaluate, to_complex


def coupled(pairs: int, seed: int = 1) -> ActiveSets:
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
    contact, gap = coupled(pairs, seed), random_gaps(harmonics, pairs, seed)
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
    contact, gap = coupled(3), random_gaps(3, 3, 2)
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
