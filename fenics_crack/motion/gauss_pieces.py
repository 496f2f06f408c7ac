"""Gauss nodes to interpolate and integrate an exact motion over a period, in pieces.

Between two events no pair opens, closes, sticks or slips, and the motion is smooth. Each interval
between events is cut into pieces. In a piece, a polynomial passes through the motion at n Gauss
nodes. If the motion turns by the angle a in the piece, the relative error is about
(a / 2)^n / (n! 2^(n - 1)):

- 20 nodes for a <= 10 rad: 8e-11.
- 8 nodes for a <= 0.25 rad: 1e-14. Pairs that close one after another leave many such pieces.
"""

from __future__ import annotations

import sys
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy.sparse as sparse

from fenics_crack.kernel import kernel

MAX_SHORT_PIECE_ANGLE = 0.25
"""Maximum angle of a short piece [rad]; a longer piece has up to 10 rad."""
NODE_COUNTS_OF_SHORT_AND_LONG_PIECES = 8, 2 * kernel.MAX_PIECE_ANGLE
"""Gauss nodes in a short piece, and in a longer piece."""


class GaussRule(NamedTuple):
    """Gauss rule with n nodes, for a piece from -1 to 1.

    Attributes
    ----------
    nodes, weights : (n,)
        Node positions, and weights with the sum 2.
    barycentric_weights : (n,)
        Weights to evaluate the polynomial in barycentric form.
    differentiation : (n, n)
        Matrix from values at the nodes to derivatives at the nodes.
    """

    nodes: np.ndarray
    weights: np.ndarray
    barycentric_weights: np.ndarray
    differentiation: np.ndarray


@lru_cache
def gauss_rule(n_nodes: int) -> GaussRule:
    """Return the Gauss-Legendre rule with ``n_nodes`` nodes."""
    nodes, weights = np.polynomial.legendre.leggauss(n_nodes)
    polynomials_at_nodes = np.polynomial.legendre.legvander(nodes, n_nodes - 1)
    derivative_coefficients = np.polynomial.legendre.legder(np.eye(n_nodes))
    derivatives_at_nodes = np.polynomial.legendre.legval(nodes, derivative_coefficients).T
    return GaussRule(
        nodes,
        weights,
        (-1.0) ** np.arange(n_nodes) * np.sqrt((1.0 - nodes**2) * weights),
        np.linalg.solve(polynomials_at_nodes.T, derivatives_at_nodes.T).T,
    )


@lru_cache
def _padded_nodes_and_barycentric_weights() -> tuple[np.ndarray, np.ndarray]:
    """Return nodes and barycentric weights for short and longer pieces: two arrays (2, 20).

    Short rows are filled up with nodes at infinity, with weight 0.
    """
    n_short, n_long = NODE_COUNTS_OF_SHORT_AND_LONG_PIECES
    nodes, barycentric_weights = np.full((2, n_long), np.inf), np.zeros((2, n_long))
    for row, n_nodes in enumerate((n_short, n_long)):
        nodes[row, :n_nodes] = gauss_rule(n_nodes).nodes
        barycentric_weights[row, :n_nodes] = gauss_rule(n_nodes).barycentric_weights
    return nodes, barycentric_weights


class GaussPieces:
    """Cut a period into pieces, each with Gauss nodes.

    Parameters
    ----------
    interval_lengths : (n,) [s]
        Durations of the intervals between events, in order. The first begins at time zero.
    interval_rates : (n,) [rad/s]
        Largest rate at which the motion may turn in each interval.

    Attributes
    ----------
    node_times : (n_nodes,) [s]
        Times of all nodes, ascending.
    node_weights : (n_nodes,) [s]
        Weight at each node in an integral over time.
    """

    def __init__(self, interval_lengths: np.ndarray, interval_rates: np.ndarray) -> None:
        angles = interval_lengths * interval_rates
        piece_counts = np.maximum(np.ceil(angles / kernel.MAX_PIECE_ANGLE), 1).astype(int)
        self._lengths = np.repeat(interval_lengths / piece_counts, piece_counts)
        self._ends = np.cumsum(self._lengths)
        self._is_long = np.repeat(angles > MAX_SHORT_PIECE_ANGLE, piece_counts)
        node_counts = np.where(self._is_long, *NODE_COUNTS_OF_SHORT_AND_LONG_PIECES[::-1])
        self._first_nodes = np.concatenate([[0], np.cumsum(node_counts)])
        self.node_times, self.node_weights = np.empty((2, self._first_nodes[-1]))
        for pieces, rule in self._pieces_and_rules():
            nodes, half_lengths = self._nodes_of(pieces, rule), 0.5 * self._lengths[pieces, None]
            self.node_times[nodes] = self._ends[pieces, None] + half_lengths * (rule.nodes - 1.0)
            self.node_weights[nodes] = half_lengths * rule.weights

    def _pieces_and_rules(self) -> list[tuple[np.ndarray, GaussRule]]:
        """Return the indices of short and of longer pieces, each with their Gauss rule."""
        return [
            (np.flatnonzero(self._is_long == is_long), gauss_rule(n_nodes))
            for is_long, n_nodes in enumerate(NODE_COUNTS_OF_SHORT_AND_LONG_PIECES)
        ]

    def _nodes_of(self, pieces: np.ndarray, rule: GaussRule) -> np.ndarray:
        """Return the node indices in k pieces with the same rule: (k, n)."""
        return np.asarray(self._first_nodes[pieces, None] + np.arange(len(rule.nodes)))

    def interpolate(self, node_values: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Interpolate values at all nodes to k times in the period [s].

        ``node_values`` is (n_nodes, m), the result (k, m).
        """
        pieces = np.minimum(np.searchsorted(self._ends, time), len(self._ends) - 1)
        coordinates = 1.0 + 2.0 * (time - self._ends[pieces]) / self._lengths[pieces]
        nodes, barycentric_weights = _padded_nodes_and_barycentric_weights()
        rule_rows = self._is_long[pieces].astype(int)
        distances = coordinates[:, None] - nodes[rule_rows]
        weights = barycentric_weights[rule_rows] / np.where(
            distances == 0.0, sys.float_info.min, distances
        )
        weights /= weights.sum(axis=1, keepdims=True)
        last_nodes = self._first_nodes[pieces + 1, None] - 1
        node_indices = self._first_nodes[pieces, None] + np.arange(weights.shape[1])
        interpolation_matrix = sparse.csr_matrix(
            (
                weights.ravel(),
                np.minimum(node_indices, last_nodes).ravel(),
                weights.shape[1] * np.arange(len(time) + 1),
            ),
            (len(time), len(node_values)),
        )
        return np.asarray(interpolation_matrix @ node_values)

    def work(self, node_forces: np.ndarray, node_displacements: np.ndarray) -> np.ndarray:
        """Return the work int F x' dt over the period, for each of m columns: (m,) [J].

        ``node_forces`` F and ``node_displacements`` x are (n_nodes, m), at all nodes.
        """
        work = np.zeros(node_forces.shape[1])
        for pieces, rule in self._pieces_and_rules():
            nodes = self._nodes_of(pieces, rule)
            rates = rule.differentiation @ node_displacements[nodes]
            work += np.einsum("k,pkc,pkc->c", rule.weights, node_forces[nodes], rates)
        return work
