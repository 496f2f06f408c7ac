"""Factor of a stiffness whose lip pairs are tied: the relative normal motion of each is zero.

    K x + B mu = r,     B^T x = 0

by Lagrange multipliers, in one symmetric indefinite matrix [[K, B], [B^T, 0]] (a saddle point). It
is the limit of springs k on the pairs, k -> inf, without their rounding,

    x = (K^-1 - K^-1 B (B^T K^-1 B)^-1 B^T K^-1) r,

and exact where K alone is singular. Its negative eigenvalues are those of K on the space of tied
motions, and one for each tie (Benzi, Golub, Liesen, Acta Numerica 14, 2005, 1, section 3.4). MUMPS
factors it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sparse
from petsc4py import PETSc

from fenics_crack.model.factor import Factor
from fenics_crack.model.structure import Structure

__all__ = ["TiedFactor", "independent_ties"]

DEPENDENT = 1e-10
"""Diagonal entries of a pivoted QR of B^T B, relative to the largest, that are none."""


def independent_ties(structure: Structure) -> sparse.csc_matrix:
    """Columns of B that are linearly independent, on this rank: (n_local, n_ties) (collective)."""
    gap = sparse.csc_matrix(structure.gap)
    gram = structure.sum_over_ranks((gap.T @ gap).toarray())
    diagonal = np.diag(gram)
    if np.all(diagonal > 0.0) and np.count_nonzero(gram) == len(gram):
        return gap  # orthogonal: no two pairs share a node
    factor, order = scipy.linalg.qr(gram, mode="r", pivoting=True)
    sizes = np.abs(np.diag(factor))
    return gap[:, np.sort(order[sizes > DEPENDENT * sizes.max(initial=0.0)])]


class TiedFactor:
    """Factor of a symmetric PETSc matrix on the space of tied motions, in the manner of
    :class:`fenics_crack.model.factor.Factor`.

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
