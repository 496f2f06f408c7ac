"""The free flow while a set of pairs stays closed, in the basis of its own damped modes.

In the modal coordinates of the open structure, with z = (s q, q'), s a frequency that balances the
two, the flow is exp(A t) = V E(t) V^-1, with a real basis V of the eigenvectors and E made of
decaying rotations, two rows each.

The undamped modes come from a symmetric eigenproblem of half the size, and do not change with the
damping. In their basis, with W their frequencies and a symmetric damping c, an eigenvalue l and its
shape x solve

    Q(l) x = (l^2 + l c + W^2) x = 0,

and shapes are orthogonal in the sense x_i^T (c + l_i + l_j) x_j = 0, i != j, which also gives V^-1
in closed form. From approximate l_j, x_j perturbation theory of first order corrects all of them at
once: with the residuals r_j = Q(l_j) x_j and d_i = x_i^T (2 l_i + c) x_i,

    dl_j = -x_j^T r_j / d_j,
    dx_j = -sum_i x_i (x_i^T r_j) / (d_i (l_j - l_i)) - (its conjugate part),        i != j.

Each time the number of right digits doubles. Where that does not lead to a complete basis (modes
that do not oscillate, the damping of one frequency's modes coupled, a damping that is not
symmetric), LAPACK's eigenvectors of A are taken, at several times the cost.

Sources: Meirovitch, Principles and Techniques of Vibrations, 1997, chapter 4; Lancaster,
Lambda-Matrices and Vibrating Systems, 1966, chapter 7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fenics_crack.model.modal import AllModes, flow_matrix

__all__ = ["Regime", "UndampedModes", "damped_regime", "undamped_modes"]

MOST_CORRECTIONS = 8
LARGEST_LAST = 1e-7
"""Of the corrections relative to the shapes; what these leave is its square."""
ORTHOGONAL = 1e-9
"""V^-1 V differs from I by at most so much."""
ALIKE = 1e-9
"""Relative distance of eigenvalues whose shapes are not corrected by each other."""
WORST_CONDITION = 1e6
"""Of LAPACK's eigenvectors; with worse ones there is no basis."""

UndampedModes = tuple[np.ndarray, np.ndarray]
"""W^2 (n,) and the shapes (n, n) in the modal coordinates of the open structure."""


@dataclass(frozen=True)
class Regime:
    """Real basis in which exp(A t) is made of decaying rotations of two rows each.

    Attributes
    ----------
    decay : (2n,)
        Real parts of the eigenvalues.
    turn : (2n,)
        Imaginary parts, + and - in turn; zero for real eigenvalues, which come last.
    vectors, inverse : (2n, 2n)
        V and V^-1.
    """

    decay: np.ndarray
    turn: np.ndarray
    vectors: np.ndarray
    inverse: np.ndarray

    def advance(self, duration: float, state: np.ndarray) -> np.ndarray:
        """E(duration) times a matrix (2n, m) in this basis."""
        size = np.exp(self.decay * duration)
        along = (size * np.cos(self.turn * duration))[:, None] * state
        swapped = state.reshape(-1, 2, state.shape[1])[:, ::-1].reshape(state.shape)
        along += (size * np.sin(self.turn * duration))[:, None] * swapped
        return along


def undamped_modes(modes: AllModes, stiffness: np.ndarray) -> UndampedModes:
    """Modes without damping, with contact springs (n_pairs,) on the pairs."""
    contact = (modes.pairs * stiffness) @ modes.pairs.T
    return np.linalg.eigh(np.diag(modes.squares) + contact)


def damped_regime(
    modes: AllModes, stiffness: np.ndarray, scale: float, undamped: UndampedModes
) -> Regime | None:
    """The flow with contact springs on the pairs; None where there is no good basis."""
    found = _from_undamped(undamped, modes.damping, scale)
    return found or _by_lapack(flow_matrix(modes, stiffness, scale))


def _from_undamped(undamped: UndampedModes, damping: np.ndarray, scale: float) -> Regime | None:
    """The basis from undamped modes; None where corrections do not lead to a complete one."""
    squares, basis = undamped
    coupled = (basis.T * damping if damping.ndim == 1 else basis.T @ damping) @ basis
    found = _corrected(squares, coupled)
    if found is None:
        return None
    values, shapes = found
    damped = coupled @ shapes
    norms = (shapes * (2.0 * shapes * values + damped)).sum(axis=0)
    right = basis @ shapes
    left = np.vstack([basis @ (shapes * values + damped) / scale, right]) / norms
    right = np.vstack([scale * right, right * values])
    length = np.linalg.norm(right, axis=0)
    right, left = right / length, 2.0 * length * left
    # z = Re sum_j a_j v_j, so that a real basis has rows Re and -Im of those that give a_j.
    vectors = np.stack([right.real, right.imag], axis=-1).reshape(len(right), -1)
    inverse = np.stack([left.real, 0.0 - left.imag], axis=-1).reshape(len(right), -1).T
    if not np.abs(inverse @ vectors - np.eye(len(right))).max() < ORTHOGONAL:
        return None
    turn = np.stack([values.imag, 0.0 - values.imag], axis=-1).ravel()
    return Regime(np.repeat(values.real, 2), turn, vectors, inverse)


def _corrected(squares: np.ndarray, damping: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Eigenvalues with positive imaginary part and shapes (n, n); None where they do not settle."""
    rate = np.diag(damping).copy()
    radicand = squares - 0.25 * rate**2
    size = np.abs(damping).max()
    if not (np.all(radicand > 0.0) and np.abs(damping - damping.T).max() <= 1e-13 * size):
        return None
    values = -0.5 * rate + 1j * np.sqrt(radicand)
    # What the coupling makes of the uncoupled shapes: Q(l_j) x_j = 0 to first order in it.
    impedance = (values + rate[:, None]) * values + squares[:, None]
    shapes = _share(-damping * values, impedance, np.abs(values) ** 2)
    np.fill_diagonal(shapes, 1.0)
    for _ in range(MOST_CORRECTIONS):
        damped, moved = damping @ shapes, shapes * values
        norms = (shapes * (2.0 * moved + damped)).sum(axis=0)[:, None]
        residual = (moved + damped) * values + squares[:, None] * shapes
        own, other = shapes.T @ residual / norms, shapes.conj().T @ residual / norms.conj()
        change = _share(own, values - values[:, None], np.abs(values))
        other /= values - values.conj()[:, None]
        shapes = shapes - shapes @ change - shapes.conj() @ other
        values = values - np.diag(own)
        if max(np.abs(change).max(), np.abs(other).max()) < LARGEST_LAST:
            return values, shapes
        if not np.all(np.isfinite(values)):
            break
    return None


def _share(part: np.ndarray, apart: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Quotients; zero where eigenvalues are alike."""
    zero = np.zeros(part.shape, complex)
    return np.divide(part, apart, out=zero, where=np.abs(apart) > ALIKE * size)


def _by_lapack(matrix: np.ndarray) -> Regime | None:
    """Real and imaginary parts of eigenvectors; None where these are all but dependent."""
    values, vectors = np.linalg.eig(matrix)
    above, real = np.flatnonzero(values.imag > 0.0), np.flatnonzero(values.imag == 0.0)
    # A (x + i y) = (a + i b) (x + i y): (x, y) turn with b, their coordinates with (b, -b).
    basis = np.empty(matrix.shape)
    basis[:, : 2 * len(above) : 2] = vectors[:, above].real
    basis[:, 1 : 2 * len(above) : 2] = vectors[:, above].imag
    basis[:, 2 * len(above) :] = vectors[:, real].real
    if np.linalg.cond(basis) > WORST_CONDITION:
        return None
    decay = np.concatenate([np.repeat(values[above].real, 2), values[real].real])
    turn = np.zeros(len(values))
    turn[: 2 * len(above) : 2] = values[above].imag
    turn[1 : 2 * len(above) : 2] = -values[above].imag
    return Regime(decay, turn, basis, np.linalg.inv(basis))
