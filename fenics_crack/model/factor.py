"""Direct solution of sparse linear systems, by the libraries that PETSc calls.

Arrays hold the rows of the calling rank. A stiffness K with bonded contact pairs has no relative
normal motion in any pair, B^T x = 0:

    K x + B mu = r,     B^T x = 0

The symmetric indefinite matrix [[K, B], [B^T, 0]] is factored, a saddle point with the Lagrange
multipliers mu. The solution is

    x = (K^-1 - K^-1 B (B^T K^-1 B)^-1 B^T K^-1) r

Springs k on the pairs have the same limit for k -> inf, but lose digits. The saddle point is exact
even if K alone is singular. Its negative eigenvalues are those of K on the bonded motions, and one
for each tie.

References
----------
Benzi, Golub and Liesen, Acta Numerica 14, 2005, 1, section 3.4 (saddle points).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI
from petsc4py import PETSc

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.basics.ranks import collect_garbage

MAX_BLOCK_COLUMNS = 16
"""Maximum number of columns that are solved or multiplied together: PETSc copies them."""
MATRIX_ZERO_TOLERANCE = 1e-10
"""Relative size that counts as zero in a matrix.

With stiffness K and mass M, it bounds an asymmetry relative to the matrix, a mode's omega^2
relative to K_ii / M_ii, and a row sum of M relative to the largest row sum.
"""
MIN_SOLID_ROW_ENTRIES = 40
"""Minimum mean number of entries in a row of a solid's matrix.

Measured: 45 or more in solids, 18 to 32 in planes. With fewer entries, MUMPS eliminates in the
order of minimum fill. For plane matrices, its own choice would take 1.7 times as long. For solids
this order would be slower, and the factors larger.
"""
WORKSPACE_PERCENTS = (20, 200, 2000)
"""Work space of MUMPS beyond its estimate [%]: each is tried if the one before is too small.

The first is MUMPS's default. On several ranks the need depends on the distribution of the rows, and
on the order in which messages arrive.
"""
OPTIONS_PREFIX = "crack_factor_"
"""Prefix of PETSc options for the factorisations of this module."""
MUMPS_OPTION, PRINT_OPTION = f"{OPTIONS_PREFIX}mat_mumps_icntl_", "mat_cholmod_print"
"""PETSc options for MUMPS, without the number at the end, and for messages of CHOLMOD."""


def estimate_factor_bytes(n_dofs: float, *, solid: bool) -> float:
    """Estimate the memory of a factored stiffness, with MUMPS's work space [byte].

    The estimate is 60 n log2(n + 1) for a plane mesh and 130 n^(4/3) for a solid with n dofs. The
    powers are those of nested dissection. The constants were measured with quadratic elements. For
    solids the constant was 95 to 136 in twisted blades, 133 to 203 in plates, and 210 to 233 in
    cubes.

    Parameters
    ----------
    n_dofs : float
        Number of degrees of freedom.
    solid : bool
        True for a solid, False for a plane mesh.

    References
    ----------
    George, SIAM Journal on Numerical Analysis 10, 1973, 345.
    """
    if solid:
        return float(130.0 * n_dofs ** (4.0 / 3.0))
    return float(60.0 * n_dofs * np.log2(n_dofs + 1.0))


def make_matrix_from_local_rows(rows: Any, comm: MPI.Comm) -> Any:
    """Make a square PETSc matrix from the rows of each rank (collective).

    Every diagonal entry is stored, even a zero: MUMPS finds no null pivot without an entry.

    Parameters
    ----------
    rows : (n_local, n)
        Rows of this rank, sparse or dense.
    """
    local_coo_matrix = sparse.coo_matrix(rows)
    n_local = local_coo_matrix.shape[0]
    diagonal_indices = np.arange(n_local)
    rows_and_columns = (
        np.append(local_coo_matrix.row, diagonal_indices),
        np.append(local_coo_matrix.col, (comm.exscan(n_local) or 0) + diagonal_indices),
    )
    completed_rows = sparse.csr_matrix(
        (np.append(local_coo_matrix.data, 0.0 * diagonal_indices), rows_and_columns),
        local_coo_matrix.shape,
    )
    return make_square_petsc_matrix(completed_rows, comm)


def make_square_petsc_matrix(local_csr_rows: sparse.csr_matrix, comm: MPI.Comm) -> Any:
    """Make a square PETSc matrix from the CSR rows (n_local, n) of each rank (collective).

    No diagonal entry is added, unlike in :func:`make_matrix_from_local_rows`. Matrices that are no
    longer referenced are freed first: many small ones may be made for one mesh.
    """
    collect_garbage(comm)
    n_local, n_columns = local_csr_rows.shape
    row_and_column_sizes = ((n_local, PETSc.DETERMINE), (n_local, n_columns))
    petsc_matrix = PETSc.Mat().createAIJ(
        row_and_column_sizes,
        csr=(local_csr_rows.indptr, local_csr_rows.indices, local_csr_rows.data),
        comm=comm,
    )
    petsc_matrix.assemble()
    return petsc_matrix


def local_rows(matrix: Any) -> sparse.csr_matrix:
    """Return this rank's rows of a PETSc matrix: (n_local, n)."""
    csr_row_pointers, column_indices, entries = matrix.getValuesCSR()
    return sparse.csr_matrix(
        (entries, column_indices, csr_row_pointers), (matrix.local_size[0], matrix.size[1])
    )


def matrix_plus_weighted_matrix(matrix: Any, weight: float, added_matrix: Any) -> Any:
    """Return the PETSc matrix ``matrix + weight * added_matrix`` (collective).

    The patterns of nonzero entries may differ.
    """
    matrix_sum = matrix.copy()
    matrix_sum.axpy(weight, added_matrix, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    compact_matrix_sum = matrix_sum.copy()  # factorisations misread the pattern that axpy leaves
    matrix_sum.destroy()
    return compact_matrix_sum


class Factor:
    """Factorisation of a PETSc matrix A, also with a border B: [[A, B], [B^T, 0]].

    A is real and square. With the border, the system is A x + B y = b, B^T x = 0.

    Parameters
    ----------
    matrix : PETSc.Mat
        A, (n, n), assembled.
    symmetric : bool
        Factor as L D L^T. This halves the work and counts the negative eigenvalues.
    definite : bool
        x^T A x >= 0 for every x. One rank then uses CHOLMOD, or UMFPACK for an unsymmetric A, in
        half the time of MUMPS. MUMPS still factors after a zero pivot, or if PETSc lacks these
        libraries.
    border : (n_local, m), optional
        B, with linearly independent columns. Default: no border.

    Attributes
    ----------
    n_null_pivots : int
        Number of zero pivots, the dimension of the null space.
    n_negative_pivots : int
        Number of negative eigenvalues of a symmetric matrix on the space with B^T x = 0, by
        Sylvester's law of inertia.

    Notes
    -----
    A ConvergenceError is raised if MUMPS cannot factor the matrix, or if a solution is not finite.

    Use it as a context manager, or call :meth:`destroy`: all ranks free the factors of a parallel
    matrix together. PETSc options with the prefix ``crack_factor_`` reach the solver.
    """

    n_null_pivots = n_negative_pivots = 0

    def __init__(
        self,
        matrix: Any,
        *,
        symmetric: bool = True,
        definite: bool = False,
        border: sparse.spmatrix | None = None,
    ) -> None:
        self._n_local = matrix.local_size[0]
        self._n_border = 0 if border is None else border.shape[1]
        self._matrix = matrix if border is None else _make_saddle_point_matrix(matrix, border)
        self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, symmetric)
        self._padded_rhs_and_solution = self._matrix.createVecs()
        self._pc_type = "cholesky" if symmetric else "lu"
        if definite and border is None and matrix.comm.size == 1:
            try:
                self._factorise("cholmod" if symmetric else "umfpack")
                return
            except PETSc.Error:
                self._destroy_factor()
        for self._workspace_percent in WORKSPACE_PERCENTS:
            self._factorise("mumps")
            if (error_number := self._factor.getMumpsInfog(1)) >= 0:  # PETSc raises no error
                break
            self._destroy_factor()
        else:
            raise (MemoryError if error_number == -13 else ConvergenceError)(
                f"MUMPS cannot factor a matrix of {self._matrix.size[0]} rows: INFOG(1) = "
                f"{error_number}, which its guide explains; check the size of the matrix's "
                "entries, or use another number of ranks"
            )
        self.n_null_pivots = int(self._factor.getMumpsInfog(28))
        self.n_negative_pivots = int(self._factor.getMumpsInfog(12)) - self._n_border

    def _factorise(self, package_name: str) -> None:
        """Factor the matrix with a package: "mumps", "cholmod" or "umfpack" (collective).

        A PETSc option of the user overrides the same option that is set here.
        """
        self._pc, self._factor = PETSc.PC().create(self._matrix.comm), PETSc.Mat()
        self._pc.setOptionsPrefix(OPTIONS_PREFIX)
        self._pc.setOperators(self._matrix)
        self._pc.setType(self._pc_type)
        self._pc.setFactorSolverType(package_name)
        options, default_options = PETSc.Options(), {}
        if (
            package_name == "cholmod"
        ):  # no warning for each zero pivot; PETSc reads one of both options
            default_options = {PRINT_OPTION: 0, OPTIONS_PREFIX + PRINT_OPTION: 0}
        elif package_name == "mumps":
            default_options = {
                f"{MUMPS_OPTION}24": 1,  # detect null pivots
                f"{MUMPS_OPTION}14": self._workspace_percent,
            }
            n_matrix_nonzeros = self._matrix.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]
            if n_matrix_nonzeros < MIN_SOLID_ROW_ENTRIES * self._matrix.size[0]:
                default_options[f"{MUMPS_OPTION}7"] = 2  # minimum fill
        default_options = {
            option_name: option_value
            for option_name, option_value in default_options.items()
            if not options.hasName(option_name)
        }
        for option_name, option_value in default_options.items():
            options[option_name] = option_value
        try:
            self._pc.setFactorSetUpSolverType()
            self._factor = self._pc.getFactorMatrix()
            self._factor.setOptionsPrefix(OPTIONS_PREFIX)  # before PETSc reads the options
            self._pc.setFromOptions()
            self._pc.setUp()
        finally:
            for option_name in default_options:
                options.delValue(option_name)

    def apply(self, rhs: Any, solution: Any) -> None:
        """Solve A x = ``rhs`` for one PETSc vector, into ``solution`` (collective)."""
        padded_rhs, padded_solution = self._padded_rhs_and_solution
        padded_rhs.array_w[: self._n_local] = rhs.array_r
        padded_rhs.array_w[self._n_local :] = 0.0
        self._pc.apply(padded_rhs, padded_solution)
        _check_solution(padded_rhs, padded_solution)
        solution.array_w[:] = padded_solution.array_r[: self._n_local]

    def solve(self, rhs: np.ndarray | sparse.spmatrix) -> np.ndarray:
        """Solve A x = b for real right-hand sides b (collective).

        Parameters
        ----------
        rhs : (m, n_local)
            Right-hand sides, one in each row, with the columns of this rank.

        Returns
        -------
        (m, n_local)
            Solutions x, one in each row.
        """
        solutions = np.empty(rhs.shape)
        for start in range(0, len(solutions), MAX_BLOCK_COLUMNS):
            block = rhs[start : start + MAX_BLOCK_COLUMNS]
            solutions[start : start + MAX_BLOCK_COLUMNS] = self._solve_block(
                block.toarray() if sparse.issparse(block) else block
            )
        return solutions

    def _solve_block(self, rhs: np.ndarray) -> np.ndarray:
        """Solve A x = b for a few right-hand sides b, the rows of ``rhs`` (collective).

        ``rhs`` and the result are (m, n_local), with m at most MAX_BLOCK_COLUMNS.
        """
        (n_columns, n_local_dofs), comm = rhs.shape, self._matrix.comm
        n_own_rows, n_rows = self._matrix.sizes[0]
        rhs_array = np.zeros((n_own_rows, n_columns), order="F")
        rhs_array[:n_local_dofs] = rhs.T
        rhs_matrix, solution_matrix = (
            PETSc.Mat().createDense(
                ((n_own_rows, n_rows), (PETSc.DECIDE, n_columns)), array=column_array, comm=comm
            )
            for column_array in (rhs_array, None)
        )
        for dense_matrix in (rhs_matrix, solution_matrix):
            dense_matrix.setUp()
            dense_matrix.assemble()
        self._factor.matSolve(rhs_matrix, solution_matrix)
        _check_solution(rhs_matrix, solution_matrix)
        solutions = np.array(solution_matrix.getDenseArray()[:n_local_dofs].T)
        rhs_matrix.destroy()
        solution_matrix.destroy()
        return solutions

    def _destroy_factor(self) -> None:
        """Free PETSc's factor and preconditioner (collective)."""
        self._factor.destroy()
        self._pc.destroy()

    def destroy(self) -> None:
        """Free the factors and the work vectors (collective)."""
        self._destroy_factor()
        for petsc_object in (
            (self._matrix, *self._padded_rhs_and_solution)
            if self._n_border
            else self._padded_rhs_and_solution
        ):
            petsc_object.destroy()

    def __enter__(self) -> Factor:
        return self

    def __exit__(self, *exception: object) -> None:
        self.destroy()


def _check_solution(rhs: Any, solution: Any) -> None:
    """Raise ConvergenceError if a finite PETSc vector or matrix has no finite solution."""
    if not np.isfinite(solution.norm()) and np.isfinite(rhs.norm()):  # equal on all ranks
        raise ConvergenceError(
            "a factored matrix has no finite solution: its entries are too large or too small, or "
            "options of PETSc spoil the factor"
        )


@contextmanager
def factored_sum(matrix: Any, weight: float, added_matrix: Any, **options: Any) -> Iterator[Factor]:
    """Yield the :class:`Factor` of ``matrix + weight * added_matrix`` (collective).

    ``options`` are keyword arguments of :class:`Factor`. Sum and factor are freed at the end of the
    context.
    """
    matrix_sum = matrix_plus_weighted_matrix(matrix, weight, added_matrix)
    with Factor(matrix_sum, **options) as factored_matrix:
        yield factored_matrix
    matrix_sum.destroy()


def _make_saddle_point_matrix(matrix: Any, border: sparse.spmatrix) -> Any:
    """Return the saddle-point matrix [[A, s B], [s B^T, 0]] (collective).

    ``matrix`` is A, and ``border`` (n_local, m) is B. The scale s is the largest row sum of |A|, so
    entries of A and s B have similar size. The last rank owns the rows of B^T.
    """
    comm, n_border = matrix.comm.tompi4py(), border.shape[1]
    scaled_border = (matrix.norm(PETSc.NormType.INFINITY) or 1.0) * border
    saddle_point_rows = sparse.hstack([local_rows(matrix), scaled_border], "csr")
    border_everywhere = sparse.vstack(comm.allgather(scaled_border), "csr")
    if comm.rank == comm.size - 1:
        border_rows = sparse.hstack([border_everywhere.T, sparse.csr_matrix((n_border, n_border))])
        saddle_point_rows = sparse.vstack([saddle_point_rows, border_rows], "csr")
    return make_matrix_from_local_rows(saddle_point_rows, comm)
