"""Direct solution of sparse linear systems by libraries that PETSc calls, on local rows.

A stiffness whose contact pairs are bonded, so that the relative normal motion of each is zero,

    K x + B mu = r,     B^T x = 0

is factored with Lagrange multipliers, in one symmetric indefinite matrix [[K, B], [B^T, 0]] (a
saddle point). It is the limit of springs k on the pairs, k -> inf, without their rounding,

    x = (K^-1 - K^-1 B (B^T K^-1 B)^-1 B^T K^-1) r,

and exact where K alone is singular. Its negative eigenvalues are those of K on the space of bonded
motions, and one for each tie (Benzi, Golub, Liesen, Acta Numerica 14, 2005, 1, section 3.4).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI
from petsc4py import PETSc

AT_A_TIME = 16
"""Columns that a factor solves for, or a matrix multiplies, at a time: PETSc copies them."""
TOLERATED = 1e-10
"""Asymmetry relative to a matrix's size; eigenvalues of K and M that are none, to K_ii / M_ii; sums
of a mass's rows that are zero, to the largest."""
OF_PLANE = 40
"""Entries of a row from which on a matrix is one of a solid: there they are 45 or more, of a plane
18 to 32. With rows ordered for minimum fill the latter are factored in 0.6 of MUMPS's own time, the
former in more, and larger."""
PREFIX, ORDER, QUIET = "crack_factor_", "mat_mumps_icntl_7", "mat_cholmod_print"


def factor_memory(dofs: float, *, solid: bool) -> float:
    """Memory of the factor of a stiffness with so many dofs, of a plane mesh or of a solid, with
    MUMPS's work space [byte].

    Nested dissection leaves O(n log n) numbers in the plane (George, SIAM Journal on Numerical
    Analysis 10, 1973, 345); the constant here is of 4,000 to a million dofs of quadratic cells. In
    space they are O(n^(4/3)), with a constant that falls with the thickness: of quadratic
    tetrahedra, from 7,000 to 180,000 dofs, it is 95 to 136 in twisted blades, 133 to 203 in plates,
    210 to 233 in cubes.
    """
    if solid:
        return float(130.0 * dofs ** (4.0 / 3.0))
    return float(60.0 * dofs * np.log2(dofs + 1.0))


def distributed(rows: Any, comm: MPI.Comm) -> Any:
    """Square PETSc matrix of the rows on this rank (n_local, n), with a diagonal, even zero: MUMPS
    finds no null pivot where there is no entry (collective)."""
    entries = sparse.coo_matrix(rows)
    local = entries.shape[0]
    place = np.arange(local)
    at = np.append(entries.row, place), np.append(entries.col, (comm.exscan(local) or 0) + place)
    every = sparse.csr_matrix((np.append(entries.data, 0.0 * place), at), entries.shape)
    return square_matrix(every, comm)


def square_matrix(rows: sparse.csr_matrix, comm: MPI.Comm) -> Any:
    """PETSc matrix of the rows on this rank, (n_local, n) (collective)."""
    local, total = rows.shape
    sizes = ((local, PETSc.DETERMINE), (local, total))
    matrix = PETSc.Mat().createAIJ(sizes, csr=(rows.indptr, rows.indices, rows.data), comm=comm)
    matrix.assemble()
    return matrix


def local_rows(matrix: Any) -> sparse.csr_matrix:
    """Rows of a PETSc matrix on this rank, (n_local, n)."""
    starts, columns, values = matrix.getValuesCSR()
    return sparse.csr_matrix((values, columns, starts), (matrix.local_size[0], matrix.size[1]))


def weighted_sum(first: Any, weight: float, second: Any) -> Any:
    """Return the matrix first + weight * second, whatever their patterns (collective)."""
    total = first.copy()
    total.axpy(weight, second, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    clean = total.copy()  # factorisations misread the rows of a pattern that axpy has changed
    total.destroy()
    return clean


class Factor:
    """Factorisation of a real square PETSc matrix A, or of one with a border, [[A, B], [B^T, 0]].

    Parameters
    ----------
    matrix : PETSc.Mat
        (n, n), assembled.
    symmetric : bool
        Factor as L D L^T, which halves the work and counts the negative eigenvalues.
    definite : bool
        x^T A x is nowhere negative: on one rank CHOLMOD, or UMFPACK if A is not symmetric, then
        solves in half the time of MUMPS. MUMPS factors where it meets a pivot of zero, and where
        PETSc has been built without it.
    border : (n_local, m), optional
        Independent columns of B: solutions x have B^T x = 0.

    Attributes
    ----------
    null_pivots : int
        Number of pivots that vanished: the dimension of the null space that was met.
    negative_pivots : int
        Number of negative eigenvalues of a symmetric matrix (Sylvester's law of inertia), on the
        space where B^T x = 0.

    Notes
    -----
    Use as a context manager, or call :meth:`destroy`: the factors of a parallel matrix are freed
    by all ranks together. PETSc options with the prefix ``crack_factor_`` reach the solver.
    """

    null_pivots = negative_pivots = 0

    def __init__(
        self,
        matrix: Any,
        *,
        symmetric: bool = True,
        definite: bool = False,
        border: sparse.spmatrix | None = None,
    ) -> None:
        self._local, self._border = matrix.local_size[0], 0 if border is None else border.shape[1]
        self._matrix = matrix if border is None else _bordered(matrix, border)
        self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, symmetric)
        self._vectors = self._matrix.createVecs()
        self._kind = "cholesky" if symmetric else "lu"
        if definite and border is None and matrix.comm.size == 1:
            try:
                self._set_up("cholmod" if symmetric else "umfpack")
                return
            except PETSc.Error:
                self._free()
        self._set_up("mumps")
        self.null_pivots = int(self._factor.getMumpsInfog(28))
        self.negative_pivots = int(self._factor.getMumpsInfog(12)) - self._border

    def _set_up(self, solver: str) -> None:
        self._pc, self._factor = PETSc.PC().create(self._matrix.comm), PETSc.Mat()
        self._pc.setOptionsPrefix(PREFIX)
        self._pc.setOperators(self._matrix)
        self._pc.setType(self._kind)
        self._pc.setFactorSolverType(solver)
        options, own = PETSc.Options(), {}
        if solver == "cholmod":  # it would warn of each pivot of zero; PETSc reads one of both
            own = {QUIET: 0, PREFIX + QUIET: 0}
        elif solver == "mumps":
            entries = self._matrix.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]
            if entries < OF_PLANE * self._matrix.size[0]:
                own = {PREFIX + ORDER: 2}  # minimum fill; setMumpsIcntl does not last
        own = {name: value for name, value in own.items() if not options.hasName(name)}
        for name, value in own.items():
            options[name] = value
        try:
            self._pc.setFactorSetUpSolverType()
            self._factor = self._pc.getFactorMatrix()
            self._factor.setOptionsPrefix(PREFIX)  # PETSc would set it after it has read them
            if solver == "mumps":
                self._factor.setMumpsIcntl(24, 1)  # detect null pivots
            self._pc.setFromOptions()
            self._pc.setUp()
        finally:
            for name in own:
                options.delValue(name)

    def apply(self, right: Any, solution: Any) -> None:
        """Solve for a PETSc vector (collective)."""
        source, target = self._vectors
        source.array_w[: self._local] = right.array_r
        source.array_w[self._local :] = 0.0
        self._pc.apply(source, target)
        solution.array_w[:] = target.array_r[: self._local]

    def solve(self, rhs: np.ndarray | sparse.spmatrix) -> np.ndarray:
        """Solve for real right-hand sides (m, n_local), one a row (collective)."""
        found = np.empty(rhs.shape)
        for start in range(0, len(found), AT_A_TIME):
            block = rhs[start : start + AT_A_TIME]
            found[start : start + AT_A_TIME] = self._solve(
                block.toarray() if sparse.issparse(block) else block
            )
        return found

    def _solve(self, rhs: np.ndarray) -> np.ndarray:
        """The same of a few (collective)."""
        (count, local), comm = rhs.shape, self._matrix.comm
        own, total = self._matrix.sizes[0]
        columns = np.zeros((own, count), order="F")
        columns[:local] = rhs.T
        right, solution = (
            PETSc.Mat().createDense(((own, total), (PETSc.DECIDE, count)), array=array, comm=comm)
            for array in (columns, None)
        )
        for made in (right, solution):
            made.setUp()
            made.assemble()
        self._factor.matSolve(right, solution)
        found = np.array(solution.getDenseArray()[:local].T)
        right.destroy()
        solution.destroy()
        return found

    def _free(self) -> None:
        self._factor.destroy()
        self._pc.destroy()

    def destroy(self) -> None:
        """Free the factors (collective)."""
        self._free()
        for used in (self._matrix, *self._vectors) if self._border else self._vectors:
            used.destroy()

    def __enter__(self) -> Factor:
        return self

    def __exit__(self, *exception: object) -> None:
        self.destroy()


@contextmanager
def factored_sum(first: Any, weight: float, second: Any, **options: Any) -> Iterator[Factor]:
    """Factor the symmetric matrix first + weight * second, and free both (collective)."""
    matrix = weighted_sum(first, weight, second)
    with Factor(matrix, **options) as factor:
        yield factor
    matrix.destroy()


def _bordered(matrix: Any, border: sparse.spmatrix) -> Any:
    """[[A, s B], [s B^T, 0]], the border on the last rank; s is the size of A (collective)."""
    comm, count = matrix.comm.tompi4py(), border.shape[1]
    scale = matrix.norm(PETSc.NormType.INFINITY) or 1.0
    rows = sparse.hstack([local_rows(matrix), scale * border])
    whole = sparse.vstack(comm.allgather(border), "csr")
    if comm.rank == comm.size - 1:
        rows = sparse.vstack([rows, sparse.hstack([scale * whole.T, np.zeros((count, count))])])
    return distributed(rows, comm)
