"""Switching instants of random and grazing trigonometric polynomials, against a fine scan."""

import numpy as np
import pytest
from switching import Switching, switching_instants

HARMONICS = range(1, 61)
DECAYS = (0.0, 1.0, 2.0, 4.0)
"""|G_k| ~ k^-decay."""
SCAN = 1 << 14
"""Points of the fine scan, 270 for each wave of the highest harmonic."""
CLEAR = 1e-12
"""Values below this part of the largest have no certain sign."""


def random_harmonics(count: int, pairs: int, rng: np.random.Generator) -> np.ndarray:
    """Complex harmonics (H+1, pairs) with the decays in turn."""
    table = rng.normal(size=(count + 1, pairs)) + 1j * rng.normal(size=(count + 1, pairs))
    decay = np.array(DECAYS)[np.arange(pairs) % len(DECAYS)]
    table[1:] *= np.arange(1, count + 1)[:, None] ** -decay
    table[0] = table[0].real
    return table


def scan(table: np.ndarray, points: int = SCAN) -> np.ndarray:
    """Values (points, pairs) on an equally spaced grid."""
    spectrum = 0.5 * points * table
    spectrum[0] = points * table[0].real
    return np.fft.irfft(spectrum, n=points, axis=0)


def values_at(table: np.ndarray, pair: np.ndarray, theta: np.ndarray, order: int = 0) -> np.ndarray:
    """Derivatives of the polynomials of some pairs at one phase each."""
    rate = 1j * np.arange(len(table))
    waves = np.exp(np.multiply.outer(theta, rate)) * rate**order
    return (table.T[pair] * waves).real.sum(axis=1)


def states(crossings: Switching, pair: int, theta: np.ndarray) -> np.ndarray:
    """Whether the pair is closed at phases, by counting its sign changes from the start."""
    instants = np.sort(crossings.theta[crossings.pair == pair])
    n_earlier = np.searchsorted(instants, theta)
    return crossings.closed_at_start[pair] ^ (n_earlier % 2 == 1)


def assert_certified(table: np.ndarray, crossings: Switching) -> None:
    """Nothing is missed that the scan sees, signs alternate, and every root is one."""
    values = scan(table)
    max_gap = np.abs(values).max(axis=0)
    assert np.all((crossings.theta >= 0.0) & (crossings.theta <= 2.0 * np.pi))
    assert np.all(
        np.abs(values_at(table, crossings.pair, crossings.theta)) <= 1e-12 * max_gap[crossings.pair]
    )
    grid = 2.0 * np.pi * np.arange(SCAN) / SCAN
    for pair in range(table.shape[1]):
        clear = np.abs(values[:, pair]) > CLEAR * max_gap[pair]
        assert np.array_equal(states(crossings, pair, grid)[clear], values[clear, pair] > 0.0)
        is_of_pair = crossings.pair == pair
        closing_signs = crossings.closing[is_of_pair][
            np.argsort(crossings.theta[is_of_pair], kind="stable")
        ]
        assert len(closing_signs) % 2 == 0
        assert np.all(closing_signs[1:] == -closing_signs[:-1])
        if len(closing_signs):
            assert closing_signs[0] == (-1.0 if crossings.closed_at_start[pair] else 1.0)
        if clear[0]:
            assert crossings.closed_at_start[pair] == (values[0, pair] > 0.0)


def test_random_polynomials() -> None:
    """600 polynomials, H = 1 to 60: the scan finds no sign change that was missed."""
    rng = np.random.default_rng(11)
    changes = 0
    for count in HARMONICS:
        table = random_harmonics(count, 10, rng)
        crossings = switching_instants(table)
        assert_certified(table, crossings)
        changes += len(crossings.theta)
    assert changes > 60 * 10 * 4


def test_grazing_polynomials() -> None:
    """600 polynomials with an extremum 1e-2 to 1e-10 of the amplitude above or below zero.

    Its excursion is shorter than the scan's cells, so the state is checked at the extremum itself.
    """
    rng = np.random.default_rng(12)
    excursions = 0
    for count in HARMONICS:
        table = random_harmonics(count, 10, rng)
        pair_indices = np.arange(10)
        values = scan(table)
        extremal = (values - np.roll(values, 1, axis=0)) * (np.roll(values, -1, axis=0) - values)
        chosen_places = np.array(
            [rng.choice(np.flatnonzero(extremal[:, pair] < 0.0)) for pair in pair_indices]
        )
        theta = 2.0 * np.pi * chosen_places / SCAN
        for _ in range(6):  # Newton's method for g' = 0; at an extremum g' and g'' say all
            slope, curvature = (values_at(table, pair_indices, theta, order) for order in (1, 2))
            theta = theta - slope / curvature
        depth = 10.0 ** -rng.uniform(2.0, 10.0, 10) * rng.choice([-1.0, 1.0], 10)
        amplitude = np.abs(values - table[0].real).max(axis=0)
        table[0] += depth * amplitude - values_at(table, pair_indices, theta)
        assert np.all(
            np.abs(values_at(table, pair_indices, theta, 1)) < 1e-9 * count**2 * amplitude
        )
        crossings = switching_instants(table)
        assert_certified(table, crossings)
        curvature = values_at(table, pair_indices, theta, 2)
        for pair in pair_indices:
            assert states(crossings, pair, theta[pair] % (2.0 * np.pi)) == (depth[pair] > 0.0)
            if depth[pair] * curvature[pair] < 0.0:  # an excursion through zero, not a near miss
                instants = crossings.theta[crossings.pair == pair]
                half = np.sqrt(-2.0 * depth[pair] * amplitude[pair] / curvature[pair])
                distance = (instants - theta[pair] + np.pi) % (2.0 * np.pi) - np.pi
                if half < 0.02 / count:  # short enough for the parabola
                    excursions += 1
                    assert distance[distance > 0.0].min() == pytest.approx(half, rel=0.05)
                    assert -distance[distance < 0.0].max() == pytest.approx(half, rel=0.05)
    assert excursions > 150


def test_known_roots_of_one_harmonic() -> None:
    """m + cos(theta - p) is zero at p +- arccos(-m), rising and falling as the cosine does."""
    mean = np.array([0.0, 0.3, -0.3, 0.999999, -0.999999, -1e-9])
    phase = np.array([0.7, 2.0, 3.0, 1.0, 5.0, 0.1])
    crossings = switching_instants(np.array([mean + 0j, np.exp(-1j * phase)]))
    for pair, (m, p) in enumerate(zip(mean, phase, strict=True)):
        is_of_pair = crossings.pair == pair
        half = np.arccos(-m)
        opening = crossings.theta[is_of_pair & (crossings.closing < 0.0)]
        closing_instants = crossings.theta[is_of_pair & (crossings.closing > 0.0)]
        assert opening == pytest.approx([(p + half) % (2.0 * np.pi)], abs=1e-9)
        assert closing_instants == pytest.approx([(p - half) % (2.0 * np.pi)], abs=1e-9)
        assert crossings.closed_at_start[pair] == (m + np.cos(p) > 0.0)


@pytest.mark.parametrize("distance", [1e-1, 1e-2, 1e-3])
def test_three_roots_close_together(distance: float) -> None:
    """sin^3 x - sin^2(d) sin x, x = m theta - p: roots at multiples of pi and d beside them.

    = (3/4 - sin^2 d) sin x - 1/4 sin 3 x. Between them the sign changes once or three times.
    """
    rng = np.random.default_rng(15)
    for multiple in (1, 4, 20):
        for phase in rng.uniform(0.1, 3.0, 10):
            table = np.zeros((3 * multiple + 1, 1), dtype=complex)
            table[multiple] = -1j * (0.75 - np.sin(distance) ** 2) * np.exp(-1j * phase)
            table[3 * multiple] = 0.25j * np.exp(-3j * phase)
            crossings = switching_instants(table)
            x = np.sort((multiple * crossings.theta - phase) % np.pi)
            expected_roots = np.repeat([0.0, distance, np.pi - distance], 2 * multiple)
            shifted_roots = np.sort((x + 0.5 * np.pi) % np.pi)
            expected_roots = np.sort((expected_roots + 0.5 * np.pi) % np.pi)
            assert shifted_roots == pytest.approx(expected_roots, abs=1e-2 * distance)
            assert_certified(table, crossings)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_without_sign_change(sign: float) -> None:
    """A mean larger than all waves together, or alone: always closed, or always open."""
    rng = np.random.default_rng(13)
    for count in (1, 7, 60):
        table = random_harmonics(count, 20, rng)
        table[0] = sign * (1.0 + 1e-9) * np.abs(table[1:]).sum(axis=0)
        table[1:, 0] = 0.0
        crossings = switching_instants(table)
        assert len(crossings.theta) == len(crossings.pair) == len(crossings.closing) == 0
        assert np.all(crossings.closed_at_start == (sign > 0.0))


def test_zero_polynomial() -> None:
    """A pair that just touches all the time is open and never switches, also beside others."""
    for pairs in (1, 3):
        table = np.zeros((6, pairs), dtype=complex)
        table[1, 1:] = 1.0
        crossings = switching_instants(table)
        assert np.array_equal(np.unique(crossings.pair), np.arange(1, pairs))
        assert not crossings.closed_at_start[0]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e308])
def test_waves_that_are_not_finite(value: float) -> None:
    """A wave that is not finite, or overflows, has no roots; the other pairs keep theirs."""
    table = np.zeros((6, 3), dtype=complex)
    table[1] = 1.0
    table[5, 1] = value
    with np.errstate(over="ignore", invalid="ignore"):
        crossings = switching_instants(table)
    assert np.array_equal(np.unique(crossings.pair), [0, 2])
    assert np.allclose(np.sort(crossings.theta), np.repeat([0.5 * np.pi, 1.5 * np.pi], 2))


@pytest.mark.parametrize("angle", [0.0, np.pi, 0.5 * np.pi, 1.0, 6.0])
@pytest.mark.parametrize("count", [1, 2, 9, 40])
def test_double_roots_exactly_at_zero(angle: float, count: int) -> None:
    """+-(1 - cos(H theta - p)) touches zero H times: always closed (open) but for rounding.

    Whether a pair of sign changes is found there is up to rounding; if so, it is a pair.
    """
    table = np.zeros((count + 1, 2), dtype=complex)
    table[0] = 1.0, -1.0
    table[count] = -np.exp(-1j * angle), np.exp(-1j * angle)
    crossings = switching_instants(table)
    for pair, closed_share in ((0, 1.0), (1, 0.0)):
        is_of_pair = crossings.pair == pair
        theta, closing_signs = crossings.theta[is_of_pair], crossings.closing[is_of_pair]
        assert len(theta) % 2 == 0 and closing_signs.sum() == 0.0
        assert np.all(np.abs(values_at(table, crossings.pair[is_of_pair], theta)) <= 1e-12)
        share = crossings.closed_at_start[pair] - float(closing_signs @ theta) / (2.0 * np.pi)
        assert share == pytest.approx(closed_share, abs=1e-5)
