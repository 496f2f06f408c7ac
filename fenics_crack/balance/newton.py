"""Newton's method by PETSc SNES, on systems that invert their own Jacobian.

A system is any object with the members of :class:`System`; SNES steers, judges and reports. PETSc
options with the prefix ``crack_hb_`` reach it.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

__all__ = ["Newton", "System"]

OPTIONS_PREFIX = "crack_hb_"


class System(Protocol):
    """F(x) = 0 for unknowns in arrays of a fixed shape, distributed over ``comm``."""

    comm: MPI.Comm
    global_size: int

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the arrays on this rank."""

    def residual(self, unknown: np.ndarray) -> np.ndarray:
        """F(x), in the units of x."""

    def linearise(self, unknown: np.ndarray) -> None:
        """Evaluate the Jacobian J at x."""

    def apply_jacobian(self, change: np.ndarray) -> np.ndarray:
        """J dx."""

    def solve_jacobian(self, residual: np.ndarray) -> np.ndarray:
        """J^-1 r."""


class Newton:
    """SNES for one system; may be used for many solutions.

    Full steps, unless PETSc options say otherwise: line searches stall at the kinks of the merit
    function where contact is sampled. Converged where |F| <= tolerance |x|.

    Attributes
    ----------
    history : list of float
        |F| of every iteration so far.
    """

    def __init__(self, system: System, tolerance: float) -> None:
        self.system = system
        self.tolerance = tolerance
        self.history: list[float] = []
        local = int(np.prod(system.shape))
        sizes = (local, system.global_size)
        self._unknown = PETSc.Vec().createMPI(sizes, comm=system.comm)
        self._target = self._unknown.duplicate()
        self._matrix = PETSc.Mat().createPython((sizes, sizes), self, comm=system.comm)
        self._matrix.setUp()
        self._snes = PETSc.SNES().create(system.comm)
        self._snes.setOptionsPrefix(OPTIONS_PREFIX)
        self._snes.setFunction(self._residual, self._target)
        self._snes.setJacobian(self._jacobian, self._matrix)
        options = PETSc.Options(OPTIONS_PREFIX)
        choose_search = not options.hasName("snes_linesearch_type")
        if choose_search:
            options["snes_linesearch_type"] = "basic"
        solver = self._snes.getKSP()
        solver.setType("preonly")
        solver.getPC().setType("python")
        solver.getPC().setPythonContext(self)
        self._snes.setFromOptions()
        if choose_search:
            options.delValue("snes_linesearch_type")
        self._snes.setConvergenceTest(self._converged)

    def solve(self, start: np.ndarray, most_iterations: int) -> tuple[np.ndarray, bool, int]:
        """Return the last iterate, whether it converged, and the number of iterations."""
        self._unknown.array_w[:] = start.ravel()
        self._snes.setTolerances(max_it=most_iterations)
        self._snes.solve(None, self._unknown)
        found = self._unknown.array_r.reshape(self.system.shape).copy()
        return found, self._snes.getConvergedReason() > 0, self._snes.getIterationNumber()

    def _converged(self, snes: Any, count: int, norms: tuple[float, float, float]) -> int:
        """Judge the residual relative to the unknowns themselves."""
        self.history.append(norms[2])
        if not np.isfinite(norms[2]):
            return int(PETSc.SNES.ConvergedReason.DIVERGED_FNORM_NAN)
        if norms[2] <= self.tolerance * self._unknown.norm():
            return int(PETSc.SNES.ConvergedReason.CONVERGED_FNORM_RELATIVE)
        if count >= snes.getTolerances()[3]:
            return int(PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT)
        return int(PETSc.SNES.ConvergedReason.ITERATING)

    def _residual(self, snes: Any, unknown: Any, target: Any) -> None:
        residual = self.system.residual(unknown.array_r.reshape(self.system.shape))
        target.array_w[:] = residual.ravel()

    def _jacobian(self, snes: Any, unknown: Any, matrix: Any, preconditioner: Any) -> None:
        self.system.linearise(unknown.array_r.reshape(self.system.shape))

    def mult(self, matrix: Any, source: Any, target: Any) -> None:
        """Jacobian times a vector, called by PETSc."""
        product = self.system.apply_jacobian(source.array_r.reshape(self.system.shape))
        target.array_w[:] = product.ravel()

    def apply(self, preconditioner: Any, source: Any, target: Any) -> None:
        """Inverse of the Jacobian times a vector, called by PETSc."""
        found = self.system.solve_jacobian(source.array_r.reshape(self.system.shape))
        target.array_w[:] = found.ravel()

    def free(self) -> None:
        """Free PETSc's objects (collective); ``destroy`` is a name that PETSc calls itself."""
        for item in (self._snes, self._matrix, self._unknown, self._target):
            item.destroy()
