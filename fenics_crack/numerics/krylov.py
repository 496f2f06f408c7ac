"""Linear systems whose matrix is not formed: GMRES by PETSc KSP.

PETSc options with the prefix ``crack_krylov_`` reach it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from petsc4py import PETSc

from fenics_crack.kernel import kernel

__all__ = ["RESTART", "gmres"]

SELF = PETSc.COMM_SELF
RESTART: int = kernel.KRYLOV_MOST
"""Vectors that GMRES keeps."""


class _Operator:
    """A linear map of arrays as PETSc calls it."""

    def __init__(self, apply: Callable[[np.ndarray], np.ndarray], shape: tuple[int, ...]) -> None:
        self._apply, self._shape = apply, shape

    def mult(self, matrix: Any, source: Any, target: Any) -> None:
        """The map of a vector."""
        target.array_w[:] = self._apply(source.array_r.reshape(self._shape)).ravel()


def gmres(
    apply: Callable[[np.ndarray], np.ndarray],
    right: np.ndarray,
    tolerance: float,
    most: int = RESTART,
) -> np.ndarray:
    """x with A x = r to |A x - r| <= tolerance |r|, for arrays of one shape, the same on all ranks;
    or the best that ``most`` iterations find."""
    matrix = PETSc.Mat().createPython((right.size,) * 2, _Operator(apply, right.shape), SELF)
    matrix.setUp()
    solver = PETSc.KSP().create(SELF)
    solver.setOptionsPrefix("crack_krylov_")
    solver.setOperators(matrix)
    solver.setType("gmres")
    solver.setGMRESRestart(RESTART)
    solver.getPC().setType("none")
    solver.setTolerances(rtol=tolerance, atol=0.0, max_it=most)
    solver.setFromOptions()
    source, target = matrix.createVecs()
    source.array_w[:] = right.ravel()
    solver.solve(source, target)
    found: np.ndarray = target.array_r.reshape(right.shape).copy()
    for item in (solver, matrix, source, target):
        item.destroy()
    return found
