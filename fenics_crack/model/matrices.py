"""Matrices and vectors from elsewhere, read and checked: NumPy, SciPy, PETSc, Matrix Market."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI
from petsc4py import PETSc

from fenics_crack.errors import InputError, reading
from fenics_crack.exchange.matrices import read_matrix_market
from fenics_crack.model.factor import TOLERATED, Factor, distributed, factored_sum, weighted_sum
from fenics_crack.parallel import gather_rows, raise_together
from fenics_crack.scene.fields import LARGEST
from fenics_crack.table import counted

__all__ = [
    "checked",
    "lumped_mass",
    "numbers",
    "per_pair",
    "petsc_matrix",
    "read_only",
    "whole_rows",
    "with_springs",
]


def numbers(given: Any) -> np.ndarray:
    """Convert to an array of floats; nan if that is impossible."""
    try:
        return np.asarray(np.nan if np.iscomplexobj(given) else given, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return np.asarray(np.nan)


def read_only(array: np.ndarray) -> np.ndarray:
    """The array itself if it cannot be written to, else a copy that cannot."""
    if array.flags.writeable:
        array = array.copy(order="K")
        array.flags.writeable = False
    return array


def per_pair(name: str, given: Any, pairs: int) -> np.ndarray:
    """One finite number per pair, from one for all or one for each: (pairs,)."""
    values = numbers(given)
    if values.shape not in ((), (pairs,)) or not np.all(np.isfinite(values)):
        raise InputError(name, given, f"one finite number, or {pairs}")
    return np.broadcast_to(values, (pairs,)).copy()


def petsc_matrix(name: str, given: Any, comm: MPI.Comm, n: int | None = None) -> Any:
    """Make a square PETSc matrix of what was given; check shape and entries."""
    made = isinstance(given, PETSc.Mat)
    whole = given if made else sparse.csr_matrix(_read_matrix(name, given, n))
    rows, columns = whole.size if made else whole.shape
    if rows != columns or rows == 0 or n not in (None, rows):
        allowed = "of shape (n, n)" if n is None else f"of shape ({n}, {n})"
        raise InputError(name, (rows, columns), allowed)
    if not made:
        _check_sizes(name, whole.data)
        start, stop = (rows * comm.rank) // comm.size, (rows * (comm.rank + 1)) // comm.size
        return distributed(whole[start:stop], comm)
    comm = given.comm.tompi4py()
    starts, places, values = given.convert("aij", PETSc.Mat()).getValuesCSR()
    error = None
    try:
        _check_sizes(name, values)
    except InputError as found:
        error = found
    raise_together(comm, error)
    own = sparse.csr_matrix((values, places, starts), (given.local_size[0], columns))
    return distributed(own, comm)


def _read_matrix(name: str, given: Any, rows: int | None) -> Any:
    """Read a Matrix Market file, or pass on what is a matrix already."""
    if isinstance(given, str | Path):
        with reading(name, given, "a Matrix Market file"):
            given = read_matrix_market(Path(given), rows)
    try:
        matrix = given if sparse.issparse(given) else np.asarray(given)
        if np.iscomplexobj(matrix):
            raise TypeError
        matrix = matrix.astype(float)
    except (ValueError, TypeError, OverflowError):
        raise InputError(name, type(given).__name__, "a real matrix") from None
    if matrix.ndim > 2:
        raise InputError(name, matrix.shape, "a matrix, two-dimensional")
    return matrix


def whole_rows(name: str, given: Any, n: int) -> sparse.csr_matrix:
    """A vector or a matrix with n rows, given whole or distributed: (n, m) on every rank."""
    if isinstance(given, PETSc.Vec):
        given = gather_rows(given.comm.tompi4py(), given.array_r)
    elif isinstance(given, PETSc.Mat):
        first, last = given.owner_range
        local = given.getValues(range(first, last), range(given.size[1]))
        given = gather_rows(given.comm.tompi4py(), np.atleast_2d(local))
    matrix = _read_matrix(name, given, n)
    if matrix.ndim == 0 or matrix.shape[0] != n:
        raise InputError(name, matrix.shape, f"with {n} rows")
    matrix = sparse.csr_matrix(matrix.reshape(n, -1))
    _check_sizes(name, matrix.data)
    return matrix


def _check_sizes(name: str, values: np.ndarray) -> None:
    """Entries are finite, and the largest is 0 or of a size whose powers are numbers too."""
    sizes = np.abs(values)
    if not np.all(np.isfinite(sizes)):
        bad = values[~np.isfinite(sizes)]
        raise InputError(name, float(bad.ravel()[0]), "finite in every entry")
    largest, most = float(sizes.max(initial=0.0)), LARGEST**2  # a product of two of a scene
    if largest and not 1.0 / most <= largest <= most:
        allowed = f"0 or from {1.0 / most:g} to {most:g} in size"
        raise InputError(name, f"{largest:g}, the largest entry", allowed)


def checked(
    mass: Any, stiffness: Any, gap: Any, forces: Mapping[str, Any], clearance: Any, comm: MPI.Comm
) -> dict[str, Any]:
    """Check and distribute what :meth:`Structure.from_matrices` is given but for the damping
    (collective)."""
    mass = petsc_matrix("mass", mass, comm)
    comm, n, own = mass.comm.tompi4py(), mass.size[0], slice(*mass.owner_range)
    stiffness = petsc_matrix("stiffness", stiffness, comm, n)
    _check_symmetric("mass", mass)
    _check_symmetric("stiffness", stiffness)
    _check_positive_definite("mass", mass)
    _check_semidefinite("stiffness", stiffness, mass)

    gap = sparse.csr_matrix((n, 0)) if gap is None else whole_rows("gap", gap, n)
    if len(empty := np.flatnonzero(abs(gap).sum(axis=0) == 0.0)):
        value = f"zero in column {empty[0] + 1} of {gap.shape[1]}"
        allowed = "a pair in each: a gap that depends on no displacement never opens or closes"
        raise InputError("gap", value, allowed)
    force = np.zeros((3, n))
    for row, (name, part) in zip(force, forces.items(), strict=True):
        if part is not None:
            column = whole_rows(name, part, n)
            if column.shape != (n, 1):
                raise InputError(name, column.shape, f"of shape ({n},)")
            row[:] = column.toarray().ravel()
    return {
        "mass": mass,
        "stiffness": stiffness,
        "gap": gap[own],
        "force": force[:, own],
        "clearance": per_pair("clearance", clearance, gap.shape[1]),
    }


def lumped_mass(mass: Any) -> Any:
    """The diagonal matrix of the row sums; InputError where one is not positive (collective)."""
    ones, sums = mass.createVecs()
    ones.set(1.0)
    mass.mult(ones, sums)
    smallest = sums.min()[1]
    if smallest <= TOLERATED * sums.max()[1]:  # zero at a triangle's corners
        allowed = "lumped only where every row sum is positive"
        raise InputError("mass", f"row sum {smallest:.3g}", allowed)
    shape = mass.local_size[0], mass.size[1]
    return distributed(sparse.diags(sums.array_r, mass.owner_range[0], shape), mass.comm.tompi4py())


def with_springs(stiffness: Any, gap: sparse.csr_matrix, springs: np.ndarray) -> Any:
    """K + B diag(k) B^T of springs k (n_pairs,) (collective)."""
    comm = stiffness.comm.tompi4py()
    whole = sparse.vstack(comm.allgather(gap), format="csr")
    added = distributed(gap @ sparse.diags(springs) @ whole.T, comm)
    matrix = weighted_sum(stiffness, 1.0, added)
    added.destroy()
    return matrix


def _check_symmetric(name: str, matrix: Any) -> None:
    size = matrix.norm(PETSc.NormType.INFINITY)
    difference = matrix.transpose(PETSc.Mat())
    difference.axpy(-1.0, matrix, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    asymmetry = difference.norm(PETSc.NormType.INFINITY)
    difference.destroy()
    if asymmetry > TOLERATED * size:
        raise InputError(name, f"asymmetric by {asymmetry / size:.1e}", "symmetric")


def _check_positive_definite(name: str, matrix: Any) -> None:
    with Factor(matrix) as factor:
        negative, null = factor.negative_pivots, factor.null_pivots
    if negative or null:
        found = f"{negative} negative and {null} zero eigenvalues"
        raise InputError(name, found, "positive definite")


def _check_semidefinite(name: str, matrix: Any, mass: Any) -> None:
    """Raise InputError if a symmetric matrix has an eigenvalue that is negative beyond rounding;
    it has none for motions as a rigid body (collective)."""
    quotients = matrix.getDiagonal()
    quotients.pointwiseDivide(quotients, mass.getDiagonal())
    sizes = quotients.copy()
    sizes.abs()
    with factored_sum(matrix, TOLERATED * sizes.max()[1], mass) as factor:
        negative = factor.negative_pivots
    if negative:
        raise InputError(name, counted(negative, "negative eigenvalue"), "positive semidefinite")
