"""Direct solution of sparse linear systems: MUMPS through PETSc, on arrays of local rows.

A stiffness whose lip pairs are tied, so that the relative normal motion of each is zero,

    K x + B mu = r,     B^T x = 0

is factored with Lagrange multipliers, in one symmetric indefinite matrix [[K, B], [B^T, 0]] (a
saddle point). It is the limit of springs k on the pairs, k -> inf, without their rounding,

    x = (K^-1 - K^-1 B (B^T K^-1 B)^-1 B^T K^-1) r,

and exact where K alone is singular. Its negative eigenvalues are those of K on the space of tied
motions, and one for each tie (Benzi, Golub, Liesen, Acta Numerica 14, 2005, 1, section 3.4).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import scipy.sparse as sparse
from petsc4py import PETSc

__all__ = ["Factor", "TiedFactor", "factored", "factored_sum", "weighted_sum"]


def weighted_sum(first: Any, weight: float, second: Any) -> Any:
    """Return the matrix first + weight * second, whatever their patterns (collective)."""
    total = first.copy()
    total.axpy(weight, second, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    clean = total.copy()  # PETSc's own LU misreads the rows of a pattern that axpy has changed
    total.destroy()
    return clean


class Factor:
    """Factorisation of a real square PETSc matrix.

    Parameters
    ----------
    matrix : PETSc.Mat
        (n, n), assembled.
    symmetric : bool
        Factor as L D L^T, which halves the work and counts the negative eigenvalues.

    Notes
    -----
    Use as a context manager, or call :meth:`destroy`: the factors of a parallel matrix are freed
    by all ranks together. PETSc options with the prefix ``crack_factor_`` reach the solver.
    """

    def __init__(self, matrix: Any, *, symmetric: bool) -> None:
        self._matrix = matrix
        matrix.setOption(PETSc.Mat.Option.SYMMETRIC, symmetric)
        self._pc = PETSc.PC().create(matrix.comm)
        self._pc.setOptionsPrefix("crack_factor_")
        self._pc.setOperators(matrix)
        self._pc.setType("cholesky" if symmetric else "lu")
        self._pc.setFactorSolverType("mumps")
        self._pc.setFactorSetUpSolverType()
        self._factor = self._pc.getFactorMatrix()
        self._factor.setMumpsIcntl(24, 1)  # detect null pivots
        self._pc.setFromOptions()
        self._pc.setUp()

    @property
    def null_pivots(self) -> int:
        """Number of pivots that vanished: the dimension of the null space that was met."""
        return int(self._factor.getMumpsInfog(28))

    @property
    def negative_pivots(self) -> int:
        """Number of negative eigenvalues of a symmetric matrix (Sylvester's law of inertia)."""
        return int(self._factor.getMumpsInfog(12))

    def apply(self, right: Any, solution: Any) -> None:
        """Solve for a PETSc vector (collective)."""
        self._pc.apply(right, solution)

    def solve_sparse(self, columns: sparse.spmatrix) -> np.ndarray:
        """Solve for sparse right-hand sides (n_local, m): (m, n_local) (collective).

        MUMPS passes by the parts of the factor that their zeros do not reach. It takes them all
        from rank 0."""
        local, total = self._matrix.local_size[0], self._matrix.size[0]
        count = columns.shape[1]
        if count == 0:  # MUMPS refuses to solve nothing
            return np.zeros((0, local))
        comm = self._matrix.comm.tompi4py()
        parts = comm.gather(sparse.csc_matrix(columns).T)
        rows = sparse.csr_matrix((0, total)) if parts is None else sparse.hstack(parts, "csr")
        sizes = ((rows.shape[0], count), (total if comm.rank == 0 else 0, total))
        given = PETSc.Mat().createAIJ(
            sizes, csr=(rows.indptr, rows.indices, rows.data), comm=self._matrix.comm
        )
        given.assemble()
        right = PETSc.Mat().createTranspose(given)
        solution = self._dense(local, total, count)
        self._factor.matSolve(right, solution)
        found: np.ndarray = solution.getDenseArray().T.copy()
        for used in (right, given, solution):
            used.destroy()
        return found

    def _dense(self, local: int, total: int, count: int, array: Any = None) -> Any:
        """A dense PETSc matrix of ``count`` columns."""
        sizes = ((local, total), (PETSc.DECIDE, count))
        matrix = PETSc.Mat().createDense(sizes, array=array, comm=self._matrix.comm)
        matrix.setUp()
        matrix.assemble()
        return matrix

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve for real right-hand sides (m, n_local), one a row (collective)."""
        rows = np.atleast_2d(rhs)
        count, local = rows.shape
        if count == 0:
            return np.zeros(np.shape(rhs))
        if count == 1:
            right, solution = self._matrix.createVecs()
            right.array_w[:] = rows[0]
            self.apply(right, solution)
            found = solution.array_r.copy()[None]
        else:
            total = self._matrix.size[0]
            columns = np.asfortranarray(rows.T, dtype=float)
            right = self._dense(local, total, count, columns)
            solution = self._dense(local, total, count)
            self._factor.matSolve(right, solution)
            found = solution.getDenseArray().T.copy()
        right.destroy()
        solution.destroy()
        return found.reshape(np.shape(rhs))

    def destroy(self) -> None:
        """Free the factors (collective)."""
        self._factor.destroy()
        self._pc.destroy()

    def __enter__(self) -> Factor:
        return self

    def __exit__(self, *exception: object) -> None:
        self.destroy()


class TiedFactor:
    """Factor of a symmetric PETSc matrix on the space of tied motions, in the manner of
    :class:`Factor`.

    Parameters
    ----------
    matrix : PETSc.Mat
        K - sigma M: (n, n).
    ties : (n_local, n_ties)
        Independent columns of B.
    """

    def __init__(self, matrix: Any, ties: sparse.csc_matrix) -> None:
        self._local, self._ties = matrix.local_size[0], ties.shape[1]
        self._matrix = _saddle_point(matrix, ties)
        self._factor = Factor(self._matrix, symmetric=True)
        self._vectors = self._matrix.createVecs()

    @property
    def null_pivots(self) -> int:
        """Dimension of the space of tied motions without stiffness."""
        return self._factor.null_pivots

    @property
    def negative_pivots(self) -> int:
        """Number of negative eigenvalues on the space of tied motions."""
        return self._factor.negative_pivots - self._ties

    def apply(self, right: Any, solution: Any) -> None:
        """Solve for a PETSc vector (collective)."""
        source, target = self._vectors
        source.array_w[:] = 0.0
        source.array_w[: self._local] = right.array_r
        self._factor.apply(source, target)
        solution.array_w[:] = target.array_r[: self._local]

    def destroy(self) -> None:
        """Free the factors (collective)."""
        self._factor.destroy()
        for used in (self._matrix, *self._vectors):
            used.destroy()

    def __enter__(self) -> TiedFactor:
        return self

    def __exit__(self, *exception: object) -> None:
        self.destroy()


def factored(matrix: Any, ties: sparse.csc_matrix | None = None) -> Factor | TiedFactor:
    """Factor a symmetric matrix, on the space of tied motions if there are ties (collective)."""
    return Factor(matrix, symmetric=True) if ties is None else TiedFactor(matrix, ties)


@contextmanager
def factored_sum(
    first: Any, weight: float, second: Any, ties: sparse.csc_matrix | None = None
) -> Iterator[Any]:
    """Factor the symmetric matrix first + weight * second, and free both (collective)."""
    matrix = weighted_sum(first, weight, second)
    with factored(matrix, ties) as factor:
        yield factor
    matrix.destroy()


def _saddle_point(matrix: Any, ties: sparse.csc_matrix) -> Any:
    """[[K, s B], [s B^T, 0]], the multipliers on the last rank; s is the size of K (collective)."""
    comm, count = matrix.comm.tompi4py(), ties.shape[1]
    scale = matrix.norm(PETSc.NormType.INFINITY) or 1.0
    starts, columns, values = matrix.getValuesCSR()
    own = sparse.csr_matrix((values, columns, starts), (matrix.local_size[0], matrix.size[1]))
    rows = sparse.hstack([own, scale * ties], "csr")
    whole = sparse.vstack(comm.allgather(ties), "csr")
    last = comm.rank == comm.size - 1
    if last:
        # PETSc wants an entry on the diagonal, even zero.
        ends, shape = sparse.hstack([scale * whole.T, sparse.eye(count)], "csr"), rows.shape[1]
        ends.data[ends.indices >= shape - count] = 0.0
        rows = sparse.vstack([rows, ends], "csr")
    rows.sort_indices()
    local = rows.shape[0]
    found = PETSc.Mat().createAIJ(
        ((local, PETSc.DETERMINE), (local, rows.shape[1])),
        csr=(rows.indptr, rows.indices, rows.data),
        comm=matrix.comm,
    )
    found.assemble()
    return found
