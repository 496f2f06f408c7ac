"""What Newton's method and path following ask of a system of equations F(x, p) = 0.

A system is linearised at a point, and the answer is a value: residual, solutions with the Jacobian,
derivative by the parameter and orientation belong to that point and to no other, in whatever order
they are asked for, and each is computed when it is first asked for. What
rounding leaves of a residual is known too.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs

__all__ = [
    "DIFFERENCE", "EPSILON", "MAX_ROUNDING", "ROUNDING", "DenseLinearisation", "Linearisation",
    "System", "determinant_sign", "factored", "least_residual", "solve_factored",
]  # fmt: skip

EPSILON, ROUNDING = float(np.finfo(float).eps), 1e-13
DIFFERENCE = EPSILON ** (1.0 / 3.0)
"""Of a parameter, for a derivative by central differences: what they leave out is then as small as
their rounding."""
MAX_ROUNDING = 1e-5
"""|F| / |x| that rounding may leave at most; equations that ask for more are refused."""


def least_residual(slope: float) -> float:
    """What rounding leaves of |F| / |x| where F changes by at most so much times |x|."""
    return max(ROUNDING, min(MAX_ROUNDING, EPSILON * slope))


class Linearisation(ABC):
    """A system at a point (x, p)."""

    unknown: np.ndarray
    """x."""
    residual: np.ndarray
    """F(x, p), of the shape and in the units of x."""

    @abstractmethod
    def solve(self, right: np.ndarray) -> np.ndarray:
        """J^-1 r, with J = dF/dx."""

    def apply(self, change: np.ndarray) -> np.ndarray:
        """J dx, for systems that SNES solves."""
        raise NotImplementedError

    @property
    @abstractmethod
    def by_parameter(self) -> np.ndarray:
        """dF/dp."""

    @property
    @abstractmethod
    def sign(self) -> float:
        """Sign of det J, +1 or -1, which changes at the folds of a path."""


class System(Protocol):
    """F(x, p) = 0 for unknowns in arrays of one shape."""

    def linearise(self, unknown: np.ndarray, parameter: float) -> Linearisation:
        """The system at a point."""

    def inner(self, first: np.ndarray, second: np.ndarray) -> float:
        """Inner product of two unknowns over all ranks."""


class DenseLinearisation(Linearisation):
    """A point whose Jacobian is a dense matrix, factored by LAPACK when it is first needed.

    Derived classes make its parts; none holds a reference to itself, so that matrices are freed at
    once.
    """

    @property
    @abstractmethod
    def jacobian(self) -> np.ndarray:
        """J, (n, n) for the n entries of the residual in their order."""

    def condense(self) -> np.ndarray:
        """Make the matrix that is factored: J, or a smaller one with the same determinant."""
        return self.jacobian

    @cached_property
    def _factors(self) -> tuple[np.ndarray, np.ndarray]:
        return factored(self.condense())

    def solve(self, right: np.ndarray) -> np.ndarray:
        return solve_factored(self._factors, right)

    @property
    def sign(self) -> float:
        return determinant_sign(self._factors)


def factored(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """LU factors of A^T: the transpose is in Fortran's order, which LAPACK takes without a
    transposing copy."""
    factors, pivots, _ = dgetrf(matrix.T)
    return factors, pivots


def solve_factored(factors: tuple[np.ndarray, np.ndarray], right: np.ndarray) -> np.ndarray:
    """A^-1 r from the LU factors of A^T, for a right-hand side of any shape."""
    found: np.ndarray = dgetrs(*factors, right.ravel(), trans=1)[0]
    return found.reshape(right.shape)


def determinant_sign(factors: tuple[np.ndarray, np.ndarray]) -> float:
    """Sign of the determinant of a matrix from its LU factors as LAPACK gives them."""
    matrix, pivots = factors
    swaps = np.count_nonzero(pivots != np.arange(len(pivots)))
    negative = np.count_nonzero(np.diag(matrix) < 0.0)
    return -1.0 if (swaps + negative) % 2 else 1.0
