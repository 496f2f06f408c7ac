"""Eigenvalues of K x = lambda M x next to a shift s, by block Lanczos with thick restarts.

With A = (K - s M)^-1 M, a basis V, V^T M V = I, and the next block W,

    A V = V H + W [0 R],      H y = theta y,      |A V y - theta V y| = |R y_last|,

and lambda = s + 1 / theta. A block is made orthogonal to the last two, of which it is, and then to
all, as rounding asks. Where V is full it begins anew with its best V y and W. A factor solves for a
block in less time than for its columns one by one, and products of blocks wait less for the memory.

Sources: Grimes, Lewis and Simon, SIAM Journal on Matrix Analysis 15 (1994) 228; Wu and Simon, the
same 22 (2000) 602.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fenics_crack.errors import ConvergenceError

__all__ = ["Pencil", "nearest_to"]

BLOCK = 4
"""Vectors of a block: of larger ones more are needed (measured with 6 to 400 eigenvalues)."""

Rows = Callable[[np.ndarray], np.ndarray]
"""Of vectors (m, n_local), one a row, to others."""


@dataclass(frozen=True)
class Pencil:
    """K and M as they are used (collective).

    Attributes
    ----------
    solve, mass : (m, n_local) to (m, n_local)
        By the factor of K - s M, and by M.
    sum_over_ranks : array to array
        Of products.
    rows, first : int
        n_local, and the first row here.
    """

    solve: Rows
    mass: Rows
    sum_over_ranks: Rows
    rows: int
    first: int


def nearest_to(
    shift: float, pencil: Pencil, count: int, held: int, tolerance: float
) -> tuple[np.ndarray, np.ndarray]:
    """The eigenvalues closest to a shift, ascending, and their vectors x^T M x = 1, (count,
    n_local), of which more are held at a time; to a residual of A relative to theta (collective).

    Raises
    ------
    ConvergenceError
        There are fewer, or they are not found.
    """
    search = _Lanczos(pencil, max(held, count + 2 * BLOCK))
    for _ in range(held):
        search.fill()
        values, vectors = np.linalg.eigh(search.small)
        order = np.argsort(-np.abs(values))
        values, vectors = values[order], vectors[:, order]
        off = np.linalg.norm(search.left @ vectors[search.last :, :count], axis=0)
        if len(values) < count:
            break
        if np.all(off <= tolerance * np.abs(values[:count])):
            found = shift + 1.0 / values[:count]
            order = np.argsort(found)
            return found[order], vectors[:, order].T @ search.basis
        search.restart(values, vectors, (count + len(values)) // 2)
    raise ConvergenceError(f"modes: {count} did not converge")


class _Lanczos:
    """V, row by row, H, and the next block W.

    Attributes
    ----------
    size, last : int
        Of V, and where its last block begins.
    left : (m, size - last)
        R.
    """

    def __init__(self, pencil: Pencil, held: int) -> None:
        self._pencil, self._random = pencil, np.random.default_rng(pencil.first)
        self._held, self.size, self.last, self._first = held, 0, 0, 0
        self._basis, self._small = np.empty((held, pencil.rows)), np.zeros((held, held))
        self._next = self._moved = self.left = np.empty((0, 0))

    @property
    def basis(self) -> np.ndarray:
        """V: (size, n_local)."""
        return self._basis[: self.size]

    @property
    def small(self) -> np.ndarray:
        """H: (size, size)."""
        return self._small[: self.size, : self.size]

    def fill(self) -> None:
        """Extend V as far as there is room, and new vectors are found."""
        while self.size + len(self._next) <= self._held:
            if not len(self._next):
                self._begin()
                if not len(self._next):
                    return
                continue
            self.last, before = self.size, self._first
            self.size += len(self._next)
            self._basis[self.last : self.size] = self._next
            block = self._pencil.solve(self._moved)
            self._next, self._moved, coupling, self.left = self._new_in(block, before)
            self._small[: self.size, self.last : self.size] = coupling
            self._small[self.last : self.size, : self.size] = coupling.T
            self._first = self.last

    def restart(self, values: np.ndarray, vectors: np.ndarray, count: int) -> None:
        """With the first of the vectors y."""
        self._basis[:count] = vectors[:, :count].T @ self.basis
        self._small[:] = 0.0
        np.fill_diagonal(self._small[:count, :count], values)
        self.size, self.last, self._first = count, count, 0

    def _begin(self) -> None:
        """With a random block, where A V is in V."""
        shape = BLOCK, self._pencil.rows
        block = self._pencil.solve(self._pencil.mass(self._random.standard_normal(shape)))
        self._next, self._moved, *_ = self._new_in(block, 0)
        self.left = np.zeros((len(self._next), self.size - self.last))

    def _new_in(self, block: np.ndarray, first: int) -> tuple[np.ndarray, ...]:
        """What W of a block is new, first to V from a vector on; M W; the parts of the block in V
        (size, m) and W."""
        pencil = self._pencil
        coupling, factors = np.zeros((self.size, len(block))), np.eye(len(block))
        moved = pencil.mass(block)
        for low, least in ((first, 0.0), (0, 0.25)):  # what loses more was rounding
            known = self._basis[low : self.size]
            part = pencil.sum_over_ranks(known @ moved.T)
            block = block - part.T @ known
            coupling[low:] += part @ factors
            moved = pencil.mass(block)
            weights, turned = np.linalg.eigh(pencil.sum_over_ranks(block @ moved.T))
            new = weights > least
            turned, roots = turned[:, new], np.sqrt(weights[new])
            block, moved = (turned / roots).T @ block, (turned / roots).T @ moved
            factors = (turned * roots).T @ factors
        return block, moved, coupling, factors
