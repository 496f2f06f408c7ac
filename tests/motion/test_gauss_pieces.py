"""Interpolation and integration over pieces of a period, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from fenics_crack.motion.gauss_pieces import GaussPieces


@pytest.mark.parametrize("shortest", [1e-9, 1e-3])
def test_waves_over_short_and_long_pieces(shortest: float) -> None:
    """cos(t) and sin(0.7 t + 1) over 30 short intervals, and of 1, 9 and 25 rad: values to 1e-11 at
    any time, also at nodes and ends; integrals and the work int x x' dt = [x^2] / 2 to 1e-11."""
    rng = np.random.default_rng(0)
    lengths = rng.permutation([*rng.uniform(shortest, 0.2, 30), 1.0, 9.0, 25.0])
    pieces, end = GaussPieces(lengths, np.ones(len(lengths))), lengths.sum()

    def waves(time: np.ndarray) -> np.ndarray:
        return np.stack([np.cos(time), np.sin(0.7 * time + 1.0)], axis=1)

    node_values = waves(pieces.node_times)
    times = np.concatenate([rng.uniform(0.0, end, 1000), [0.0, end], pieces.node_times[::7]])
    assert np.abs(pieces.interpolate(node_values, times) - waves(times)).max() < 1e-11
    integrals = [np.sin(end), (np.cos(1.0) - np.cos(0.7 * end + 1.0)) / 0.7]
    assert pieces.node_weights @ node_values == pytest.approx(integrals, abs=1e-11)
    squares = waves(np.array([0.0, end])) ** 2
    work = pieces.work(node_values, node_values)
    assert work == pytest.approx(0.5 * (squares[1] - squares[0]), abs=1e-10)
    assert np.all(np.diff(pieces.node_times) > 0.0)
    assert pieces.node_weights.sum() == pytest.approx(end, rel=1e-13)
