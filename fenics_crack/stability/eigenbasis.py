"""Free motion while a set of pairs stays closed, in the basis of its own damped modes.

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

from dataclasses import dataclass, replace

import numpy as np

from fenics_crack.model.modal import AllModes, between_pairs, flow_matrix

__all__ = ["Eigenbasis", "UndampedModes", "advance_all", "eigenbasis", "undamped_modes"]

MAX_CORRECTIONS = 8
ENOUGH, SMALLEST = 1e-11, 1e-8
"""What the last correction may leave of the shapes' errors; smaller corrections are rounding."""
ORTHOGONAL = 1e-9
"""V^-1 V differs from I by at most so much."""
ALIKE = 1e-8
"""Relative distance of eigenvalues below which corrections by each other's shapes are bounded."""
WORST_CONDITION = 1e6
"""Of LAPACK's eigenvectors; with worse ones there is no basis."""

UndampedModes = tuple[np.ndarray, np.ndarray]
"""Stiffness in undamped modes, W^2 but for rounding, and their shapes in the modal coordinates of
the open structure, both (n, n)."""


@dataclass(frozen=True)
class Eigenbasis:
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
        found: np.ndarray = advance_all([self], np.array([duration]), state[None])[0]
        return found


def advance_all(bases: list[Eigenbasis], durations: np.ndarray, states: np.ndarray) -> np.ndarray:
    """E(duration) times a matrix for each of m bases, of states (m, 2n, k): the same shape."""
    decay = np.array([basis.decay for basis in bases]) * durations[:, None]
    angle = np.array([basis.turn for basis in bases]) * durations[:, None]
    size = np.exp(decay)
    count, rows, columns = states.shape
    swapped = states.reshape(count, -1, 2, columns)[:, :, ::-1].reshape(count, rows, columns)
    along: np.ndarray = (size * np.cos(angle))[:, :, None] * states
    along += (size * np.sin(angle))[:, :, None] * swapped
    return along


def undamped_modes(modes: AllModes, stiffness: np.ndarray) -> UndampedModes:
    """Modes without damping, with contact springs as in :func:`between_pairs`."""
    contact = between_pairs(modes, stiffness)
    _, shapes = np.linalg.eigh(np.diag(modes.squares) + contact)
    # By eigh the lowest W^2 are known to the rounding of the highest, stiff contact's.
    pairs = replace(modes, pairs=shapes.T @ modes.pairs)
    return (shapes.T * modes.squares) @ shapes + between_pairs(pairs, stiffness), shapes


def eigenbasis(
    modes: AllModes, stiffness: np.ndarray, scale: float, undamped: UndampedModes
) -> Eigenbasis | None:
    """Of the flow with contact springs on the pairs; None where there is no good one."""
    found = _from_undamped(undamped, modes.damping, scale)
    return found or _by_lapack(flow_matrix(modes, stiffness, scale))


def _from_undamped(undamped: UndampedModes, damping: np.ndarray, scale: float) -> Eigenbasis | None:
    """The basis from undamped modes; None where corrections do not lead to a complete one."""
    stiffness, basis = undamped
    coupled = (basis.T * damping if damping.ndim == 1 else basis.T @ damping) @ basis
    found = _corrected(stiffness, coupled)
    if found is None:
        return None
    values, shapes = found
    shapes = shapes / (np.linalg.norm(shapes, axis=0) * np.hypot(scale, np.abs(values)))
    damped = _times(coupled, shapes)
    norms = (shapes * (2.0 * shapes * values + damped)).sum(axis=0)
    right, left = _times(basis, shapes), _times(basis, (shapes * values + damped) / norms)
    # z = Re sum_j a_j v_j: the real basis has columns Re v and Im v, its inverse rows Re and -Im.
    vectors = np.vstack([scale * right, right * values]).view(float)
    inverse = np.vstack([2.0 / scale * left, 2.0 / norms * right]).conj().view(float).T
    if not np.abs(inverse @ vectors - np.eye(len(vectors))).max() < ORTHOGONAL:
        return None
    turn = np.repeat(values.imag, 2)
    turn[1::2] *= -1.0
    return Eigenbasis(np.repeat(values.real, 2), turn, vectors, inverse)


def _corrected(stiffness: np.ndarray, damping: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Eigenvalues with positive imaginary part and shapes (n, n); None where they do not settle."""
    squares, rate = np.diag(stiffness), np.diag(damping)
    radicand = squares - 0.25 * rate**2
    size = np.abs(damping).max()
    if not (np.all(radicand > 0.0) and np.abs(damping - damping.T).max() <= 1e-13 * size):
        return None
    values = -0.5 * rate + 1j * np.sqrt(radicand)
    coupling = (np.diag(rate) - damping) * values + (np.diag(squares) - stiffness)
    if not np.any(coupling):  # nothing closed, modal damping
        return values, np.eye(len(values), dtype=complex)
    # What it makes of the uncoupled shapes: Q(l_j) x_j = 0 to first order in it.
    impedance = (values + rate[:, None]) * values + squares[:, None]
    shapes: np.ndarray = np.zeros(damping.shape, complex)
    np.divide(coupling, impedance, out=shapes, where=np.abs(impedance) > np.abs(coupling))
    before = np.abs(shapes).max()
    np.fill_diagonal(shapes, 1.0)
    for _ in range(MAX_CORRECTIONS):
        damped, moved = _times(damping, shapes), shapes * values
        norms = (shapes * (2.0 * moved + damped)).sum(axis=0)[:, None]
        residual = (moved + damped) * values + _times(stiffness, shapes)
        own, other = shapes.T @ residual / norms, shapes.conj().T @ residual / norms.conj()
        apart, alike = values - values[:, None], ALIKE * np.abs(values)
        change = own / np.where(np.abs(apart) > alike, apart, alike)
        np.fill_diagonal(change, 0.0)
        other /= values - values.conj()[:, None]
        shapes = shapes - shapes @ change - shapes.conj() @ other
        values = values - np.diag(own)
        largest = max(np.abs(change).max(), np.abs(other).max())
        # Quadratic convergence: the next correction would be this one squared, over the last one's.
        if largest < SMALLEST or largest**3 < ENOUGH * before**2:
            return values, shapes
        before = largest
    return None


def _times(matrix: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """A real matrix times complex columns."""
    product: np.ndarray = (matrix @ columns.view(float)).view(complex)
    return product


def _by_lapack(matrix: np.ndarray) -> Eigenbasis | None:
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
    return Eigenbasis(decay, turn, basis, np.linalg.inv(basis))
