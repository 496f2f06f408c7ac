"""Newton's method by PETSc SNES, and linear systems whose matrix is not formed by GMRES of KSP.

All solutions but those along a path are found this way; PETSc options with the prefix
``crack_hb_`` reach it, and GMRES with ``crack_krylov_``. One object serves a system for all
attempts at its solution. Where the kernel has the equations, and no such option is given, the same
steps are taken there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenics_crack.errors import ConvergenceError
from fenics_crack.kernel import kernel
from fenics_crack.numerics.equations import Linearisation, System

__all__ = ["FORCING", "RESTART", "DistributedSystem", "Newton", "gmres", "kernel_solves"]

SELF = PETSc.COMM_SELF
RESTART: int = kernel.KRYLOV_MOST
"""Vectors that GMRES keeps."""
OPTIONS_PREFIX = "crack_hb_"
FORCING = 1e-2
"""Relative residual of GMRES in the first steps; later ones are solved as sharply as pays
(Eisenstat and Walker, SIAM Journal on Scientific Computing 17, 1996, 16)."""


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


class DistributedSystem(System, Protocol):
    """A system whose unknowns are spread over the ranks of ``comm``; F in the units of x."""

    comm: MPI.Comm
    global_size: int
    shape: tuple[int, ...]
    """Of the unknowns on this rank."""
    matrix_free: bool
    """Whether it only applies its Jacobian: GMRES solves with it then."""


def kernel_solves(system: DistributedSystem) -> bool:
    """Whether the kernel has a system, and no option is for SNES."""
    has = getattr(system, "compiled", None) is not None
    return has and not PETSc.Options(OPTIONS_PREFIX).getAll()


class Newton:
    """SNES for one system, for all solutions of it; a context manager, which frees it.

    Full steps, unless PETSc options say otherwise: line searches stall at the kinks of the merit
    function where contact is sampled. Converged where |F| <= tolerance |x|.
    """

    def __init__(self, system: DistributedSystem, history: list[float] | None = None) -> None:
        """``history`` is where |F| of every iteration goes."""
        self.system, self._history = system, [] if history is None else history
        self._parameter = self._tolerance = 0.0
        self._at: tuple[np.ndarray, Linearisation] | None = None
        self._failure: ConvergenceError | None = None
        self._tangent: Linearisation
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
        if system.matrix_free:
            solver.setType("gmres")
            solver.setGMRESRestart(RESTART)
            solver.setTolerances(max_it=RESTART)
            solver.getPC().setType("none")
            self._snes.setUseEW(True, version=2, rtol_0=FORCING, rtol_max=FORCING)
            self._snes.setMaxLinearSolveFailures(1000)  # an inexact step is better than none
        else:
            solver.setType("preonly")
            solver.getPC().setType("python")
            solver.getPC().setPythonContext(self)
        self._snes.setFromOptions()
        if choose_search:
            options.delValue("snes_linesearch_type")
        self._snes.setConvergenceTest(self._converged)

    def solve(
        self, start: np.ndarray, parameter: float, tolerance: float, most_iterations: int
    ) -> tuple[Linearisation, bool, int]:
        """The system at the last iterate, whether that converged, and the number of iterations."""
        self._parameter, self._tolerance, self._at = parameter, tolerance, None
        self._unknown.array_w[:] = start.ravel()
        self._snes.setTolerances(max_it=most_iterations)
        self._failure = None
        try:
            self._snes.solve(None, self._unknown)
        except PETSc.Error:
            if self._failure is None:
                raise
        if self._failure is not None:  # whatever PETSc has made of it
            raise self._failure
        found = self._point(self._unknown)
        return found, self._snes.getConvergedReason() > 0, self._snes.getIterationNumber()

    def _point(self, unknown: Any) -> Linearisation:
        """The system at a vector; SNES asks for residual and Jacobian at the same one."""
        values, comm = unknown.array_r, self.system.comm
        known = self._at is not None and bool((values == self._at[0]).all())
        if comm.size > 1:  # a rank alone cannot tell
            known = comm.allreduce(known, MPI.LAND)
        if self._at is None or not known:
            place = values.copy()
            at = self.system.linearise(place.reshape(self.system.shape), self._parameter)
            self._at = place, at
        return self._at[1]

    def _converged(self, snes: Any, count: int, norms: tuple[float, float, float]) -> int:
        """Judge the residual relative to the unknowns themselves."""
        self._history.append(norms[2])
        if not np.isfinite(norms[2]):
            return int(PETSc.SNES.ConvergedReason.DIVERGED_FNORM_NAN)
        if norms[2] <= self._tolerance * self._unknown.norm():
            return int(PETSc.SNES.ConvergedReason.CONVERGED_FNORM_RELATIVE)
        if count >= snes.getTolerances()[3]:
            return int(PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT)
        return int(PETSc.SNES.ConvergedReason.ITERATING)

    def _residual(self, snes: Any, unknown: Any, target: Any) -> None:
        try:
            target.array_w[:] = self._point(unknown).residual.ravel()
        except ConvergenceError as error:
            self._failure = error
            raise

    def _jacobian(self, snes: Any, unknown: Any, matrix: Any, preconditioner: Any) -> None:
        self._tangent = self._point(unknown)

    def mult(self, matrix: Any, source: Any, target: Any) -> None:
        """Jacobian times a vector, called by PETSc."""
        change = source.array_r.reshape(self.system.shape)
        target.array_w[:] = self._tangent.apply(change).ravel()

    def apply(self, preconditioner: Any, source: Any, target: Any) -> None:
        """Inverse of the Jacobian times a vector, called by PETSc."""
        right = source.array_r.reshape(self.system.shape)
        target.array_w[:] = self._tangent.solve(right).ravel()

    def __enter__(self) -> Newton:
        return self

    def __exit__(self, *exception: object) -> None:
        for item in (self._snes, self._matrix, self._unknown, self._target):
            item.destroy()
