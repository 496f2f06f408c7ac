"""Check matrices and vectors of users, and distribute them over ranks.

Matrices come as NumPy or SciPy arrays, PETSc matrices, or files
(:mod:`fenics_crack.model.matrix_formats`).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI
from petsc4py import PETSc

from fenics_crack.basics.errors import (
    MAX_HARMONIC_ORDER,
    InputError,
    check_count,
    report_read_errors,
)
from fenics_crack.basics.ranks import call_on_each_rank, gather_rows
from fenics_crack.basics.tables import format_count
from fenics_crack.model.factor import (
    MATRIX_ZERO_TOLERANCE,
    Factor,
    factored_sum,
    local_rows,
    make_matrix_from_local_rows,
    matrix_plus_weighted_matrix,
)
from fenics_crack.model.matrix_formats import read_matrix_market
from fenics_crack.numerics.fourier import resize_harmonics
from fenics_crack.scene.fields import MAX_ALLOWED_MAGNITUDE


def floats_or_single_nan(data: Any) -> np.ndarray:
    """Convert data to an array of floats.

    If the data are complex or no numbers, the result is a single nan.
    """
    try:
        return np.asarray(np.nan if np.iscomplexobj(data) else data, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return np.asarray(np.nan)


def read_only_array(array: np.ndarray) -> np.ndarray:
    """Return the array if it is read-only, else a read-only copy."""
    if array.flags.writeable:
        array = array.copy(order="K")
        array.flags.writeable = False
    return array


class ReadOnlyArrays:
    """Base of frozen dataclasses whose array fields become read-only.

    An array that can be written is copied.
    """

    def __post_init__(self) -> None:
        for name, field in vars(self).items():
            if isinstance(field, np.ndarray):
                object.__setattr__(self, name, read_only_array(field))


class AbsentMatrix:
    """Stand-in for a mass or stiffness that a structure's file does not hold.

    Its sizes are those of a PETSc matrix with all rows on rank 0. Any other use raises InputError.
    """

    def __init__(self, n_rows: int, rank: int) -> None:
        self.size, n_local = (n_rows, n_rows), n_rows if rank == 0 else 0  # rank 0 has all rows
        self.local_size = (n_local, n_local)
        self.owner_range = (0, n_rows) if n_local else (n_rows, n_rows)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        raise self.input_error("this result")

    @staticmethod
    def input_error(purpose: str) -> InputError:
        """Return the InputError for a result that needs matrices or a mesh.

        ``purpose`` names this result in the message.
        """
        requirement = (
            f"a structure with matrices, as fc.build_structure(scene) returns, for {purpose}"
        )
        return InputError("structure", "a file of a prepared structure", requirement)


def expand_to_pairs(name: str, data: Any, n_pairs: int) -> np.ndarray:
    """Return one number for each pair: (n_pairs,).

    ``data`` is a single number for all pairs, or has one number for each. InputError with the key
    ``name``: ``data`` has another shape or is not finite.
    """
    pair_values = floats_or_single_nan(data)
    if pair_values.shape not in ((), (n_pairs,)) or not np.all(np.isfinite(pair_values)):
        raise InputError(name, data, f"one finite number, or {n_pairs} with one per pair")
    return np.broadcast_to(pair_values, (n_pairs,)).copy()


def make_petsc_matrix(name: str, data: Any, comm: MPI.Comm, n: int | None = None) -> Any:
    """Make a square PETSc matrix from a matrix of any kind (collective).

    Parameters
    ----------
    name : str
        Name of the matrix in error messages.
    data : array, sparse matrix, PETSc.Mat, or path of a Matrix Market file
        A PETSc matrix keeps the ranks it has. Any other matrix must be whole on every rank.
    comm : MPI.Comm
        Ranks that share the result, unless ``data`` is a PETSc matrix.
    n : int, optional
        Required number of rows.

    Raises
    ------
    InputError
        The matrix is not square, or an entry cannot be used.
    """
    is_petsc = isinstance(data, PETSc.Mat)
    given_matrix = data if is_petsc else sparse.csr_matrix(_load_matrix(name, data, n))
    n_rows, n_columns = given_matrix.size if is_petsc else given_matrix.shape
    if n_rows != n_columns or n_rows == 0 or n not in (None, n_rows):
        requirement = "a square matrix (n, n)" if n is None else f"of shape ({n}, {n})"
        raise InputError(name, (n_rows, n_columns), requirement)
    if is_petsc:
        comm = data.comm.tompi4py()
        own_rows = local_rows(data.convert("aij", PETSc.Mat()))
        call_on_each_rank(comm, lambda: _check_entries(name, own_rows.data))
    else:
        _check_entries(name, given_matrix.data)
        start, stop = n_rows * np.array([comm.rank, comm.rank + 1]) // comm.size
        own_rows = given_matrix[start:stop]
    return make_matrix_from_local_rows(own_rows, comm)


def _load_matrix(name: str, data: Any, n_rows: int | None) -> Any:
    """Return a matrix from memory or from a Matrix Market file, with real entries.

    Parameters
    ----------
    name : str
        Name of the matrix in error messages.
    data : array, sparse matrix, or path of a file
        The matrix.
    n_rows : int or None
        Required number of rows in a file. None: any.

    Raises
    ------
    InputError
        The file cannot be read or has another number of rows. Or the matrix is not real, or has
        more than two dimensions.
    """
    if isinstance(data, str | Path):
        with report_read_errors(name, data, "a Matrix Market file"):
            data = read_matrix_market(Path(data), n_rows)
    try:
        matrix = data if sparse.issparse(data) else np.asarray(data)
        if np.iscomplexobj(matrix):
            raise TypeError
        matrix = matrix.astype(float)
    except (ValueError, TypeError, OverflowError):
        raise InputError(name, type(data).__name__, "a real matrix") from None
    if matrix.ndim > 2:
        raise InputError(name, matrix.shape, "a matrix with two dimensions")
    return matrix


def make_whole_csr_matrix(name: str, data: Any, n: int) -> sparse.csr_matrix:
    """Return a vector or matrix as a sparse matrix (n, m), whole on every rank.

    Parameters
    ----------
    name : str
        Name of the matrix in error messages.
    data : array, sparse matrix, PETSc object, or path of a Matrix Market file
        Vector or matrix with n rows. A PETSc object is gathered from all ranks (collective).
    n : int
        Number of rows.

    Raises
    ------
    InputError
        The number of rows differs, or an entry cannot be used.
    """
    if isinstance(data, PETSc.Vec):
        data = gather_rows(data.comm.tompi4py(), data.array_r)
    elif isinstance(data, PETSc.Mat):
        first_row, end_row = data.owner_range
        own_rows = data.getValues(range(first_row, end_row), range(data.size[1]))
        data = gather_rows(data.comm.tompi4py(), np.atleast_2d(own_rows))
    loaded_matrix = _load_matrix(name, data, n)
    if loaded_matrix.ndim == 0 or loaded_matrix.shape[0] != n:
        raise InputError(
            name, loaded_matrix.shape, f"an array or matrix with {n} rows, one per dof"
        )
    loaded_matrix = sparse.csr_matrix(loaded_matrix.reshape(n, -1))
    _check_entries(name, loaded_matrix.data)
    return loaded_matrix


def _check_entries(name: str, entries: np.ndarray) -> None:
    """Raise InputError unless all entries are finite and well scaled.

    The largest absolute entry must be 0, or between 1e-60 and 1e60. Powers of entries then neither
    overflow nor become zero. ``name`` is the matrix's name in the error message.
    """
    magnitudes = np.abs(entries)
    if not np.all(np.isfinite(magnitudes)):
        invalid_values = entries[~np.isfinite(magnitudes)]
        raise InputError(
            name, float(invalid_values.ravel()[0]), "a matrix whose entries are all finite"
        )
    max_magnitude = float(magnitudes.max(initial=0.0))
    max_allowed_magnitude = MAX_ALLOWED_MAGNITUDE**2  # the product of two numbers in a scene
    if max_magnitude and not 1.0 / max_allowed_magnitude <= max_magnitude <= max_allowed_magnitude:
        requirement = (
            f"0 or from {1.0 / max_allowed_magnitude:g} to {max_allowed_magnitude:g} in size; "
            "check the units"
        )
        raise InputError(name, f"{max_magnitude:g}, the largest entry", requirement)


def check_and_distribute_parts(
    mass: Any, stiffness: Any, gaps: tuple[Any, Any], load_parts: Mapping[str, Any], clearance: Any,
    comm: MPI.Comm,
) -> dict[str, Any]:  # fmt: skip
    """Check a structure's matrices and load, and distribute the rows to the ranks (collective).

    :meth:`Structure.from_matrices` passes its own arguments on, except the damping.

    Parameters
    ----------
    mass, stiffness : (n, n)
        Matrices in any allowed form: in memory, or the path of a file.
    gaps : tuple
        Matrix B of the normal gaps, or None, and matrix B_t of the tangential gaps, or None.
    load_parts : dict
        The load's mean, cosine and sine part, in this order. The keys name them in errors.
    clearance : float or (n_pairs,) [m]
        Clearance of the pairs.
    comm : MPI.Comm
        Ranks that share matrices which are not PETSc's.

    Returns
    -------
    dict
        Fields of a :class:`Body`: mass, stiffness, gap, force, clearance; tangential if given.
    """
    mass = make_petsc_matrix("mass", mass, comm)
    comm, n, own_rows = mass.comm.tompi4py(), mass.size[0], slice(*mass.owner_range)
    stiffness = make_petsc_matrix("stiffness", stiffness, comm, n)
    _check_symmetric("mass", mass)
    _check_symmetric("stiffness", stiffness)
    with Factor(mass) as factored_mass:
        n_negative_pivots_of_mass = factored_mass.n_negative_pivots
        n_zero_pivots_of_mass = factored_mass.n_null_pivots
    if n_negative_pivots_of_mass or n_zero_pivots_of_mass:
        problem = (
            f"{n_negative_pivots_of_mass} negative and {n_zero_pivots_of_mass} zero eigenvalues"
        )
        raise InputError("mass", problem, "positive definite; give each dof a mass > 0")
    _check_semidefinite("stiffness", stiffness, mass)

    given_normal_gap_matrix, tangential = gaps
    gap = (
        sparse.csr_matrix((n, 0))
        if given_normal_gap_matrix is None
        else make_whole_csr_matrix("gap", given_normal_gap_matrix, n)
    )
    if len(zero_gap_column_indices := np.flatnonzero(abs(gap).sum(axis=0) == 0.0)):
        problem = f"zero in column {zero_gap_column_indices[0] + 1} of {gap.shape[1]}"
        requirement = (
            "a matrix whose columns are the gaps of pairs, each with an entry that is not zero"
        )
        raise InputError("gap", problem, requirement)
    part_by_name = {
        "mass": mass,
        "stiffness": stiffness,
        "gap": gap[own_rows],
        "force": _load_rows_from_parts(load_parts, n)[:, own_rows],
        "clearance": expand_to_pairs("clearance", clearance, gap.shape[1]),
    }
    if tangential is not None:
        tangential = make_whole_csr_matrix("tangential", tangential, n)
        if tangential.shape[1] not in (gap.shape[1], 2 * gap.shape[1]):
            requirement = f"of shape {gap.shape}, as gap, or with twice as many columns"
            raise InputError("tangential", tangential.shape, requirement)
        part_by_name["tangential"] = tangential[own_rows]
    return part_by_name


def _load_rows_from_parts(load_parts: Mapping[str, Any], n: int) -> np.ndarray:
    """Combine a load's mean, cosine and sine part into an array of Fourier coefficients.

    Parameters
    ----------
    load_parts : dict of str to (n, K) or None
        Mean, cosine part and sine part, in this order. Column k of the cosine and sine part belongs
        to harmonic k; the mean has a single column. Error messages name a part by the key.
    n : int
        Number of dofs.

    Returns
    -------
    (2K+1, n)
        Mean, then cosine and sine part of each harmonic 1 to K.
    """
    max_n_columns_by_key = {"force_mean": 1}
    load_rows_of_each_part = [
        _read_load_columns_as_rows(key, part, n, max_n_columns_by_key.get(key, MAX_HARMONIC_ORDER))
        for key, part in load_parts.items()
    ]
    load_coefficients = np.zeros((2 * max(map(len, load_rows_of_each_part)) + 1, n))
    for first_load_row, part_rows in enumerate(load_rows_of_each_part):
        load_coefficients[first_load_row::2][: len(part_rows)] = part_rows
    return load_coefficients


def _read_load_columns_as_rows(name: str, data: Any, n: int, max_n_columns: int = 1) -> np.ndarray:
    """Return the columns of a load's part as rows (m, n).

    Parameters
    ----------
    name : str
        Name of the part in error messages.
    data : (n,), (n, m) or None
        Part of the load; None stands for a single column of zeros.
    n : int
        Number of dofs.
    max_n_columns : int
        Largest allowed number m of columns.

    Raises
    ------
    InputError
        The shape does not fit.
    """
    columns = sparse.csr_matrix((n, 1)) if data is None else make_whole_csr_matrix(name, data, n)
    if not 1 <= columns.shape[1] <= max_n_columns:
        requirement = f"of shape ({n},)" + f", or of up to {max_n_columns} columns" * (
            max_n_columns > 1
        )
        raise InputError(name, columns.shape, requirement)
    return np.asarray(columns.toarray().T, dtype=float)


def add_harmonics_to_load(
    load_coefficients: np.ndarray, harmonics: Mapping[int, tuple[Any, Any]], mass: Any
) -> np.ndarray:
    """Return a load with further harmonics, on the dofs of this rank.

    Parameters
    ----------
    load_coefficients : (2K+1, n_local) [N]
        Present load: mean, then cosine and sine parts of harmonics 1 to K.
    harmonics : dict of int to (cosine, sine)
        Cosine and sine part to add, by the order of the harmonic, 1 to 100. Each part is (n,) [N]
        or None.
    mass : PETSc.Mat
        Mass matrix, whose rows tell the dofs of this rank.

    Returns
    -------
    (2K'+1, n_local) [N]
        New load. K' is the highest order in the present load and in ``harmonics``.
    """
    n, own_rows = mass.size[0], slice(*mass.owner_range)
    if not isinstance(harmonics, Mapping):
        raise InputError("harmonics", harmonics, "a dict {order: (cosine, sine)}")
    for order in harmonics:
        check_count("order in harmonics", order, 1, MAX_HARMONIC_ORDER)
    new_coefficients = resize_harmonics(
        load_coefficients, max([len(load_coefficients) // 2, *harmonics])
    )
    for order, cosine_and_sine in harmonics.items():
        key = f"harmonics[{order}]"
        if not isinstance(cosine_and_sine, tuple | list) or len(cosine_and_sine) != 2:
            raise InputError(
                key, cosine_and_sine, f"a tuple (cosine, sine), each None or of shape ({n},)"
            )
        new_coefficients[2 * order - 1 : 2 * order + 1] += [
            _read_load_columns_as_rows(key, cosine_or_sine_part, n)[0, own_rows]
            for cosine_or_sine_part in cosine_and_sine
        ]
    return new_coefficients


def lump_mass(mass: Any) -> Any:
    """Return the diagonal matrix with the row sums of the mass (collective).

    InputError: a row sum is not above 1e-10 of the largest.
    """
    ones_vector, row_sums = mass.createVecs()
    ones_vector.set(1.0)
    mass.mult(ones_vector, row_sums)
    min_row_sum = row_sums.min()[1]
    if min_row_sum <= MATRIX_ZERO_TOLERANCE * row_sums.max()[1]:  # zero at a triangle's corners
        requirement = (
            "a matrix whose row sums are all > 0, so that it can be lumped; "
            "use the structure without lumped()"
        )
        raise InputError("mass", f"row sum {min_row_sum:.3g}", requirement)
    local_shape = mass.local_size[0], mass.size[1]
    return make_matrix_from_local_rows(
        sparse.diags(row_sums.array_r, mass.owner_range[0], local_shape), mass.comm.tompi4py()
    )


def add_springs(stiffness: Any, gap: sparse.csr_matrix, spring_stiffnesses: np.ndarray) -> Any:
    """Return the stiffness with springs, K + B diag(k) B^T (collective).

    The springs connect the contact pairs. B is ``gap`` (n_local, n_pairs), and k is
    ``spring_stiffnesses`` (n_pairs,) [N/m].
    """
    comm = stiffness.comm.tompi4py()
    gap_everywhere = sparse.vstack(comm.allgather(gap), format="csr")
    spring_matrix = make_matrix_from_local_rows(
        gap @ sparse.diags(spring_stiffnesses) @ gap_everywhere.T, comm
    )
    stiffness_with_springs = matrix_plus_weighted_matrix(stiffness, 1.0, spring_matrix)
    spring_matrix.destroy()
    return stiffness_with_springs


def _check_symmetric(name: str, matrix: Any) -> None:
    """Raise InputError unless a matrix is symmetric to 1e-10 of its norm (collective).

    ``name`` is the matrix's name in the error message.
    """
    matrix_norm = matrix.norm(PETSc.NormType.INFINITY)
    difference = matrix.transpose(PETSc.Mat())
    difference.axpy(-1.0, matrix, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    asymmetry_norm = difference.norm(PETSc.NormType.INFINITY)
    difference.destroy()
    if asymmetry_norm > MATRIX_ZERO_TOLERANCE * matrix_norm:
        raise InputError(name, f"asymmetric by {asymmetry_norm / matrix_norm:.1e}", "symmetric")


def _check_semidefinite(name: str, matrix: Any, mass: Any) -> None:
    """Raise InputError if a stiffness K has a negative eigenvalue (collective).

    The eigenvalues are omega^2 in K phi = omega^2 M phi, with the mass M and the shapes phi. Zeros
    are allowed, for rigid-body motions. Negative values by rounding are allowed, too: down to
    -1e-10 times the largest |K_ii| / M_ii.

    Parameters
    ----------
    name : str
        Name of the stiffness in the error message.
    matrix, mass : PETSc.Mat
        K and M.
    """
    diagonal_quotients = matrix.getDiagonal()
    diagonal_quotients.pointwiseDivide(diagonal_quotients, mass.getDiagonal())
    diagonal_quotient_magnitudes = diagonal_quotients.copy()
    diagonal_quotient_magnitudes.abs()
    with factored_sum(
        matrix, MATRIX_ZERO_TOLERANCE * diagonal_quotient_magnitudes.max()[1], mass
    ) as factored_matrix:
        n_negative_pivots = factored_matrix.n_negative_pivots
    if n_negative_pivots:
        raise InputError(
            name,
            format_count(n_negative_pivots, "negative eigenvalue"),
            "positive semidefinite; check its sign, and that no entries are missing",
        )


def read_only_csr_matrix(matrix: Any) -> sparse.csr_matrix:
    """Return a read-only copy of a sparse matrix in CSR format.

    A read-only CSR matrix is returned itself.
    """
    if sparse.isspmatrix_csr(matrix) and matrix.has_canonical_format:
        if not any(part.flags.writeable for part in (matrix.data, matrix.indices, matrix.indptr)):
            return matrix
    copied_matrix = sparse.csr_matrix(matrix, copy=True)
    copied_matrix.sum_duplicates()
    for part in (copied_matrix.data, copied_matrix.indices, copied_matrix.indptr):
        part.flags.writeable = False
    return copied_matrix
