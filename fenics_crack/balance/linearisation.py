"""What Newton's method and path following ask of a system of equations F(x, p) = 0.

A system is linearised at a point, and the answer is a value: residual, solutions with the Jacobian,
derivative by the parameter and orientation belong to that point and to no other, in whatever order
they are asked for, and each is computed when it is first asked for.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs

__all__ = ["DenseLinearisation", "Linearisation", "System", "determinant_sign"]


class Linearisation(ABC):
    """A system at a point (x, p).

    Attributes
    ----------
    unknown : array
        x.
    residual : array
        F(x, p), of the shape and in the units of x.
    """

    unknown: np.ndarray
    residual: np.ndarray

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
        """Sign of det J, +1 or -1: the orientation of a path, which changes at its folds."""


class System(Protocol):
    """F(x, p) = 0 for unknowns in arrays of one shape."""

    def linearise(self, unknown: np.ndarray, parameter: float) -> Linearisation:
        """The system at a point."""

    def inner(self, first: np.ndarray, second: np.ndarray) -> float:
        """Inner product of two unknowns over all ranks."""


class DenseLinearisation(Linearisation):
    """A point whose Jacobian is a dense matrix, factored by LAPACK when it is first needed.

    Parameters
    ----------
    unknown, residual : array
        x and F(x, p).
    jacobian : callable
        Makes J, (n, n) for the n entries of the residual in their order.
    by_parameter : callable, optional
        Makes dF/dp; without it the system has no parameter.
    """

    def __init__(
        self,
        unknown: np.ndarray,
        residual: np.ndarray,
        jacobian: Callable[[], np.ndarray],
        by_parameter: Callable[[], np.ndarray] | None = None,
    ) -> None:
        self.unknown, self.residual = unknown, residual
        self._make_jacobian = jacobian
        self._make_derivative = by_parameter

    @cached_property
    def jacobian(self) -> np.ndarray:
        """J."""
        return self._make_jacobian()

    @cached_property
    def _factors(self) -> tuple[np.ndarray, np.ndarray]:
        # The transpose is in Fortran's order, which LAPACK takes without a transposing copy.
        matrix, pivots, _ = dgetrf(self.jacobian.T)
        return matrix, pivots

    def apply(self, change: np.ndarray) -> np.ndarray:
        """J dx."""
        product: np.ndarray = self.jacobian @ change.ravel()
        return product.reshape(change.shape)

    def solve(self, right: np.ndarray) -> np.ndarray:
        """J^-1 r."""
        found, _ = dgetrs(*self._factors, right.ravel(), trans=1)
        return np.asarray(found).reshape(right.shape)

    @cached_property
    def by_parameter(self) -> np.ndarray:
        """dF/dp."""
        if self._make_derivative is None:
            raise TypeError("this system has no parameter")
        return self._make_derivative()

    @property
    def sign(self) -> float:
        """Sign of det J."""
        return determinant_sign(self._factors)


def determinant_sign(factors: tuple[np.ndarray, np.ndarray]) -> float:
    """Sign of the determinant of a matrix from its LU factors as LAPACK gives them."""
    matrix, pivots = factors
    swaps = np.count_nonzero(pivots != np.arange(len(pivots)))
    negative = np.count_nonzero(np.diag(matrix) < 0.0)
    return -1.0 if (swaps + negative) % 2 else 1.0
